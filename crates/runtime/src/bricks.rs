//! Which nodes of a fine grid a sparse volume stores, and which eight of them a position lies between.
//!
//! ```text
//! level 1           level 0 to its right     . is no node: what lies there is the mean of its two neighbours,
//! o-------o---o---o                          as in the large cell's own interpolation, so that nothing jumps
//! |       |   |   |
//! |       .---o---o
//! |       |   |   |
//! o-------o---o---o
//! ```
//! Cells come in levels: one of level l is 2^l cells of the grid wide, the coarsest are those of level
//! [`levels`](Bricks::levels), and a *refined* cell is divided into eight of the level below. Cells that touch differ by one level at
//! most. A place of the grid is a node if all cells that it is a corner of, or in which it lies, have it as a corner: for one in the
//! middle of a larger cell's edge or face the cell's own corners speak.
//!
//! So the middle of a cell is a node exactly if the cell is refined, and one bit per place of the grid tells all. Bits stand in
//! *bricks* of 8 × 8 × 8 places: a lookup costs the same in any level, however large. Nodes are numbered brick by brick.

use crate::error::text;
use crate::grid::{Cell, Finder, box_contains, trilinear};
use crate::{Error, Grid};
use alloc::vec::Vec;
use core::array;

/// Places of a brick along each axis.
pub const BRICK: u32 = 8;
/// The coarsest cells may be 2 to this power cells of the grid wide: as wide as a brick.
pub const MAX_LEVELS: u32 = 3;
/// Bytes of a brick's bits in a file.
const MASK_SIZE: usize = 64;

/// The nodes of a sparse volume.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bricks {
    counts: [u32; 3],
    levels: u32,
    /// Bricks per axis.
    extent: [u32; 3],
    /// x fastest.
    bricks: Vec<Brick>,
    nodes: u32,
}

/// Whether a place is a node, see [`Bricks::new`]: all cells of the next coarser level in or at which it lies are refined.
pub fn is_node(counts: [u32; 3], levels: u32, place: [u32; 3], is_refined: impl Fn(u32, [u32; 3]) -> bool) -> bool {
    // The coarsest level that has the place as a corner.
    let own = place.iter().map(|p| p.trailing_zeros()).min().unwrap_or(0);
    if own >= levels {
        return true;
    }
    let level = own + 1;
    let cells = |axis: usize| {
        let cell = place[axis] >> level;
        // Within a cell, or between two; at an end of the grid there is one.
        let low = if place[axis] & ((1 << level) - 1) == 0 { cell.saturating_sub(1) } else { cell };
        low..cell.min((counts[axis].max(2) - 2) >> level) + 1
    };
    for z in cells(2) {
        for y in cells(1) {
            for x in cells(0) {
                if !is_refined(level, [x, y, z]) {
                    return false;
                }
            }
        }
    }
    true
}

/// 8 × 8 × 8 places.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Brick {
    /// Per z: bit x + 8 y is set if that place is a node.
    pub(crate) slices: [u64; BRICK as usize],
    /// Number of the first node.
    pub(crate) first: u32,
    /// Nodes in the slices before.
    pub(crate) before: [u16; BRICK as usize],
}

/// A cell that is not refined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Leaf {
    /// Its lowest place.
    pub origin: [u32; 3],
    /// It is 2^level cells of the grid wide.
    pub level: u32,
}

/// The nodes that light between the corners of a leaf comes from: of each corner the node itself, or, where that is none, the
/// farther end of the edge, or the farther corner of the face, in whose middle it lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Corners {
    /// As in [`Cell::nodes`].
    pub nodes: [u32; 8],
    /// Bit k is set if corner k is no node.
    pub hanging: u8,
    /// The corner that the cell shares with the larger one which it is an eighth of.
    pub shared: u8,
}

/// A leaf and its nodes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Located {
    pub(crate) leaf: Leaf,
    pub(crate) corners: Corners,
}

impl Located {
    /// Whether a cell of the grid is part of the leaf.
    #[inline]
    pub(crate) fn holds(&self, cell: [u32; 3]) -> bool {
        let Leaf { origin, level } = self.leaf;
        (0..3).all(|axis| cell[axis] >> level << level == origin[axis])
    }

    /// The weights of the nodes at a place within a cell of the leaf, 0 to 1 per axis.
    #[inline]
    pub(crate) fn weights(&self, cell: [u32; 3], within: [f32; 3]) -> [f32; 8] {
        let width = 1.0 / (1 << self.leaf.level) as f32;
        let share = array::from_fn(|axis| ((cell[axis] - self.leaf.origin[axis]) as f32 + within[axis]) * width);
        let mut weights = trilinear(share);
        self.corners.spread(&mut weights);
        weights
    }
}

impl Corners {
    /// Trilinear weights of corners become weights of nodes.
    #[inline]
    pub fn spread(&self, weights: &mut [f32; 8]) {
        if self.hanging == 0 {
            return;
        }
        let shared = usize::from(self.shared);
        let is_hanging = |corner: usize| self.hanging >> corner & 1 == 1;
        for bit in [1, 2, 4] {
            let corner = shared ^ bit;
            if is_hanging(corner) {
                weights[corner] *= 0.5;
                weights[shared] += weights[corner];
            }
        }
        // Both edges of such a face are in the larger cell's, too: their slots are its corners already.
        for [a, b] in [[1, 2], [1, 4], [2, 4]] {
            let corner = shared ^ a ^ b;
            if is_hanging(corner) {
                weights[corner] *= 0.25;
                for other in [shared, shared ^ a, shared ^ b] {
                    weights[other] += weights[corner];
                }
            }
        }
    }
}

impl Bricks {
    /// The nodes of a grid of `counts` places, each axis one, or a multiple of 2^levels and one, whose cells are refined where
    /// `is_refined(level, cell)` says so: cell (x, y, z) of a level has its lowest place at (x, y, z) · 2^level. A refined cell's
    /// parent is refined, and so are the parents of the cells that touch it.
    pub fn new(counts: [u32; 3], levels: u32, is_refined: impl Fn(u32, [u32; 3]) -> bool) -> Bricks {
        let extent = counts.map(|count| count.div_ceil(BRICK));
        let mut bricks = Bricks { counts, levels, extent, bricks: Vec::new(), nodes: 0 };
        let number = extent.iter().map(|&n| n as usize).product();
        bricks.bricks.reserve_exact(number);
        for index in 0..number {
            let slices = bricks.derive(bricks.lowest_of(index), &is_refined);
            bricks.push(slices);
        }
        bricks
    }

    fn push(&mut self, slices: [u64; BRICK as usize]) {
        let mut before = [0; BRICK as usize];
        let mut nodes = 0;
        for (slice, before) in slices.iter().zip(&mut before) {
            *before = nodes as u16;
            nodes += slice.count_ones();
        }
        self.bricks.push(Brick { slices, first: self.nodes, before });
        self.nodes += nodes;
    }

    fn lowest_of(&self, brick: usize) -> [u32; 3] {
        let [nx, ny, _] = self.extent.map(|n| n as usize);
        [brick % nx, brick / nx % ny, brick / nx / ny].map(|n| n as u32 * BRICK)
    }

    /// The bits of a brick.
    fn derive(&self, lowest: [u32; 3], is_refined: &dyn Fn(u32, [u32; 3]) -> bool) -> [u64; BRICK as usize] {
        let size: [u32; 3] = array::from_fn(|k| (self.counts[k] - lowest[k]).min(BRICK));
        let mut slices = [0; BRICK as usize];
        for z in 0..size[2] {
            for y in 0..size[1] {
                for x in 0..size[0] {
                    let place = [lowest[0] + x, lowest[1] + y, lowest[2] + z];
                    if is_node(self.counts, self.levels, place, is_refined) {
                        slices[z as usize] |= 1 << (x + BRICK * y);
                    }
                }
            }
        }
        slices
    }

    /// Places of the grid per axis, nodes or not.
    pub fn counts(&self) -> [u32; 3] {
        self.counts
    }

    /// The coarsest cells are 2^levels cells of the grid wide.
    pub fn levels(&self) -> u32 {
        self.levels
    }

    /// How many nodes there are.
    pub fn node_count(&self) -> usize {
        self.nodes as usize
    }

    #[inline]
    fn brick(&self, place: [u32; 3]) -> &Brick {
        &self.bricks[self.brick_index(place)]
    }

    #[inline]
    fn brick_index(&self, place: [u32; 3]) -> usize {
        let [x, y, z] = place.map(|p| (p / BRICK) as usize);
        let [nx, ny, _] = self.extent.map(|n| n as usize);
        x + nx * (y + ny * z)
    }

    /// The number of the node at a place of the grid; None where none is.
    #[inline]
    pub fn node_at(&self, place: [u32; 3]) -> Option<u32> {
        self.brick(place).node(place)
    }

    /// The place in the middle of a cell of level 1 or more.
    #[inline]
    pub fn middle(&self, level: u32, origin: [u32; 3]) -> [u32; 3] {
        array::from_fn(|axis| if self.counts[axis] > 1 { origin[axis] + (1 << level >> 1) } else { 0 })
    }

    /// Where a node is, in places of the grid.
    ///
    /// # Panics
    /// If there is no such node.
    pub fn place_of(&self, node: usize) -> [u32; 3] {
        assert!(node < self.node_count(), "node {node} of {}", self.node_count());
        let index = self.bricks.partition_point(|brick| brick.first as usize <= node) - 1;
        let brick = &self.bricks[index];
        let mut rest = node as u32 - brick.first;
        let z = brick.before.partition_point(|&before| u32::from(before) <= rest) - 1;
        rest -= u32::from(brick.before[z]);
        let mut slice = brick.slices[z];
        for _ in 0..rest {
            slice &= slice - 1;
        }
        let bit = slice.trailing_zeros();
        let lowest = self.lowest_of(index);
        [lowest[0] + bit % BRICK, lowest[1] + bit / BRICK, lowest[2] + z as u32]
    }

    /// The leaf that a cell of the grid is part of; the cell by its lowest place.
    #[inline]
    pub fn leaf(&self, cell: [u32; 3]) -> Leaf {
        let brick = self.brick(cell);
        let mut level = self.levels;
        loop {
            let origin = cell.map(|p| p >> level << level);
            if level == 0 || !brick.has(self.middle(level, origin)) {
                return Leaf { origin, level };
            }
            level -= 1;
        }
    }

    /// All leaves, brick by brick.
    pub fn leaves(&self) -> impl Iterator<Item = Leaf> {
        let coarsest = self.counts.map(|count| ((count - 1) >> self.levels).max(1));
        let places =
            |[nx, ny, nz]: [u32; 3]| (0..nx * ny * nz).map(move |index| [index % nx, index / nx % ny, index / nx / ny]);
        let width = self.counts.map(|count| if count > 1 { 1 << self.levels } else { 1 });
        places(coarsest).flat_map(move |cell| {
            let lowest: [u32; 3] = array::from_fn(|k| cell[k] << self.levels);
            places(width).filter_map(move |offset| {
                let cell = array::from_fn(|k| lowest[k] + offset[k]);
                let leaf = self.leaf(cell);
                (leaf.origin == cell).then_some(leaf)
            })
        })
    }

    /// The place of a leaf's corner.
    pub fn corner(&self, leaf: Leaf, corner: usize) -> [u32; 3] {
        array::from_fn(|axis| {
            let up = corner >> axis & 1 == 1 && self.counts[axis] > 1;
            leaf.origin[axis] + if up { 1 << leaf.level } else { 0 }
        })
    }

    /// The nodes that a leaf's light comes from.
    #[inline]
    pub fn corners(&self, leaf: Leaf) -> Corners {
        let Leaf { origin, level } = leaf;
        let shared: u8 = (0..3).map(|axis| ((origin[axis] >> level & 1) as u8) << axis).sum();
        let mut hanging = 0;
        let nodes = array::from_fn(|corner| {
            let place = self.corner(leaf, corner);
            self.node_at(place).unwrap_or_else(|| {
                hanging |= 1 << corner;
                let far = array::from_fn(|axis| match place[axis] >> level & 1 {
                    0 => place[axis],
                    // Away from the corner that is the larger cell's, too.
                    _ if shared >> axis & 1 == 1 => place[axis] - (1 << level),
                    _ => place[axis] + (1 << level),
                });
                // In a volume that was checked there is one.
                self.node_at(far).unwrap_or(0)
            })
        });
        Corners { nodes, hanging, shared }
    }

    /// The leaf that a cell of the grid is part of, with its nodes.
    #[inline]
    pub(crate) fn located(&self, cell: [u32; 3]) -> Located {
        let leaf = self.leaf(cell);
        Located { leaf, corners: self.corners(leaf) }
    }

    /// The nodes around a position in a box over which the places are spread, and their weights; `finder` is that of the places. Every
    /// position has an answer, as in [`Grid::locate`].
    pub(crate) fn cell(&self, grid: &Grid, position: [f64; 3]) -> Cell {
        let (cell, within) = Finder::new(grid).cell_at(position);
        let located = self.located(cell);
        let weights = located.weights(cell, within);
        Cell { nodes: located.corners.nodes, weights, inside: box_contains(grid.min, grid.max, position) }
    }

    /// All bricks, x fastest.
    pub(crate) fn bricks(&self) -> &[Brick] {
        &self.bricks
    }

    /// Where the bit of a cell's lowest place is: brick, slice, bit. Sorted by it, cells go brick by brick as nodes do.
    pub(crate) fn order(&self, grid: &Grid, cell: u32) -> (usize, usize, u32) {
        let place = grid.place_of(cell);
        let (slice, bit) = Brick::bit(place);
        (self.brick_index(place), slice, bit)
    }

    /// Section `BRIK`'s bytes, see FORMAT.md.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.counts.iter().chain([&self.levels]).for_each(|word| bytes.extend(word.to_le_bytes()));
        let plain = |index: usize| self.derive(self.lowest_of(index), &|_, _| false);
        let is_refined: Vec<bool> = (0..self.bricks.len()).map(|i| self.bricks[i].slices != plain(i)).collect();
        bytes.extend(is_refined.iter().map(|refined| u8::from(*refined)));
        for brick in self.bricks.iter().zip(&is_refined).filter(|(_, refined)| **refined).map(|(brick, _)| brick) {
            brick.slices.iter().for_each(|slice| bytes.extend(slice.to_le_bytes()));
        }
        bytes
    }

    /// Reads section `BRIK` of a volume of so many nodes.
    pub(crate) fn parse(bytes: &[u8], nodes: usize) -> Result<Bricks, Error> {
        let place = "section BRIK";
        let (head, rest) = bytes
            .split_at_checked(16)
            .ok_or_else(|| Error::invalid(place, text!("{} bytes", bytes.len()), "at least 16"))?;
        let word = |k: usize| u32::from_le_bytes(array::from_fn(|i| head[4 * k + i]));
        let (counts, levels) = ([word(0), word(1), word(2)], word(3));
        if !(1..=MAX_LEVELS).contains(&levels) {
            return Err(Error::invalid(place, text!("{levels} levels"), "1 to 3"));
        }
        let fits = |count: &u32| *count == 1 || (*count > 1 && (count - 1).is_multiple_of(1 << levels));
        if !counts.iter().all(fits) || counts == [1; 3] {
            let expected = text!("multiples of {} and one, or one, and not all one", 1 << levels);
            return Err(Error::invalid(place, text!("counts {counts:?}"), expected));
        }
        let extent = counts.map(|count| count.div_ceil(BRICK));
        let too_short = || {
            let number = extent.iter().map(|&n| u128::from(n)).product::<u128>();
            Error::invalid(place, text!("{} bytes", bytes.len()), text!("16 and one for each of {number} bricks"))
        };
        let number = match counts.iter().try_fold(1, |product: u32, &count| product.checked_mul(count)) {
            Some(_) => extent.iter().product::<u32>() as usize,
            None => return Err(too_short()),
        };
        let (flags, masks) = rest.split_at_checked(number).ok_or_else(too_short)?;
        if let Some(brick) = flags.iter().position(|&flag| flag > 1) {
            return Err(Error::invalid(text!("section BRIK, brick {brick}"), text!("{}", flags[brick]), "0 or 1"));
        }
        let with_mask = flags.iter().filter(|&&flag| flag == 1).count();
        if masks.len() != with_mask * MASK_SIZE {
            let expected = text!("{} for {with_mask} bricks with bits", with_mask * MASK_SIZE);
            return Err(Error::invalid(place, text!("{} bytes after the flags", masks.len()), expected));
        }
        let mut found = Bricks { counts, levels, extent, bricks: Vec::new(), nodes: 0 };
        found.bricks.reserve_exact(number);
        let mut masks = masks.as_chunks::<MASK_SIZE>().0.iter();
        for (index, &flag) in flags.iter().enumerate() {
            let mask = if flag == 1 { masks.next() } else { None };
            let slices = match mask {
                Some(mask) => array::from_fn(|z| u64::from_le_bytes(array::from_fn(|i| mask[8 * z + i]))),
                None => found.derive(found.lowest_of(index), &|_, _| false),
            };
            found.push(slices);
        }
        found.check()?;
        if found.node_count() != nodes {
            let expected = text!("{nodes}, as the header says");
            return Err(Error::invalid(place, text!("{} nodes", found.nodes), expected));
        }
        Ok(found)
    }

    /// The bits are those of cells of which no two that touch differ by more than a level.
    fn check(&self) -> Result<(), Error> {
        let is_refined = |level: u32, cell: [u32; 3]| self.leaf(cell.map(|n| n << level)).level < level;
        let wrong = |index: usize, expected: &str| {
            Err(Error::invalid(text!("section BRIK, brick {index}"), "other bits", expected))
        };
        for (index, brick) in self.bricks.iter().enumerate() {
            if brick.slices != self.derive(self.lowest_of(index), &is_refined) {
                return wrong(index, "those places that all cells there have as a corner");
            }
        }
        for leaf in self.leaves() {
            // Cells of two levels more, that would touch: from each face, edge and corner one step outward.
            let width = 1i64 << leaf.level;
            for step in 0..27 {
                let step = [step % 3, step / 3 % 3, step / 9].map(|s: i64| s - 1);
                let beyond: [i64; 3] =
                    array::from_fn(|axis| i64::from(leaf.origin[axis]) + [-1, 0, width][(step[axis] + 1) as usize]);
                let is_cell = (0..3).all(|axis| {
                    let last = i64::from(self.counts[axis]).max(2) - 2;
                    (0..=last).contains(&beyond[axis])
                });
                if is_cell && self.leaf(beyond.map(|p| p as u32)).level > leaf.level + 1 {
                    return wrong(self.brick_index(leaf.origin), "cells that touch to differ by one level at most");
                }
            }
        }
        Ok(())
    }
}

impl Brick {
    #[inline]
    fn bit(place: [u32; 3]) -> (usize, u32) {
        let [x, y, z] = place.map(|p| p % BRICK);
        (z as usize, x + BRICK * y)
    }

    #[inline]
    fn has(&self, place: [u32; 3]) -> bool {
        let (slice, bit) = Brick::bit(place);
        self.slices[slice] >> bit & 1 == 1
    }

    #[inline]
    fn node(&self, place: [u32; 3]) -> Option<u32> {
        let (slice, bit) = Brick::bit(place);
        let bits = self.slices[slice];
        let before = (bits & ((1 << bit) - 1)).count_ones();
        (bits >> bit & 1 == 1).then(|| self.first + u32::from(self.before[slice]) + before)
    }
}
