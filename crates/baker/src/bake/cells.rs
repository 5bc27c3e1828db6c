//! A grid, sparse or not, as cells with eight nodes each, and as nodes with neighbours.

use gdibl_runtime::bricks::{Bricks, Corners, Leaf};
use gdibl_runtime::grid::Grid;

use super::{Nodes, SparseGrid};

/// Cells are known by the index of their lowest place in the grid.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cells<'a> {
    pub grid: &'a Grid,
    bricks: Option<&'a Bricks>,
}

/// Along -x, +x, -y, +y, -z, +z: a node, and how many places of the grid it is away.
pub(crate) type Neighbours = [Option<(u32, u32)>; 6];

impl<'a> Cells<'a> {
    /// `None` where nothing lies between nodes.
    pub fn of(nodes: &'a Nodes) -> Option<Cells<'a>> {
        match nodes {
            Nodes::Grid(grid) => Some(Cells { grid, bricks: None }),
            Nodes::Sparse(SparseGrid { grid, bricks }) => Some(Cells { grid, bricks: Some(bricks) }),
            Nodes::Points(_) | Nodes::Vertices { .. } => None,
        }
    }

    /// All cells in order.
    pub fn all(&self) -> Vec<u32> {
        match self.bricks {
            None => (0..self.grid.node_count() as u32).filter(|node| self.grid.is_cell(*node)).collect(),
            Some(bricks) => {
                let mut cells: Vec<u32> = bricks.leaves().map(|leaf| self.grid.index_of(leaf.origin)).collect();
                cells.sort_unstable();
                cells
            }
        }
    }

    /// The cell that the grid's own cell at a place is part of.
    pub fn cell_of(&self, place: [u32; 3]) -> u32 {
        self.grid.index_of(self.bricks.map_or(place, |bricks| bricks.leaf(place).origin))
    }

    fn leaf(&self, cell: u32) -> Leaf {
        let origin = self.grid.place_of(cell);
        self.bricks.map_or(Leaf { origin, level: 0 }, |bricks| bricks.leaf(origin))
    }

    /// The nodes that a cell's light comes from.
    pub fn corners(&self, cell: u32) -> Corners {
        match self.bricks {
            None => Corners { nodes: self.grid.cell_nodes(cell), hanging: 0, shared: 0 },
            Some(bricks) => bricks.corners(self.leaf(cell)),
        }
    }

    /// Its box, metres; over all of the grid's box on an axis with one node.
    pub fn bounds(&self, cell: u32) -> ([f64; 3], [f64; 3]) {
        let Leaf { origin, level } = self.leaf(cell);
        let is_flat = |axis: usize| self.grid.counts[axis] <= 1;
        let end = std::array::from_fn(|axis| origin[axis] + if is_flat(axis) { 0 } else { 1 << level });
        let (low, high) = (self.grid.place_position(origin), self.grid.place_position(end));
        (
            std::array::from_fn(|axis| if is_flat(axis) { self.grid.min[axis] } else { low[axis] }),
            std::array::from_fn(|axis| if is_flat(axis) { self.grid.max[axis] } else { high[axis] }),
        )
    }

    /// The cells beyond a face; none where the grid ends.
    pub fn beyond(&self, cell: u32, axis: usize, higher: bool) -> Vec<u32> {
        let Some(bricks) = self.bricks else {
            return self.grid.neighbour_cell(cell, axis, higher).into_iter().collect();
        };
        let Leaf { origin, level } = self.leaf(cell);
        let last = self.grid.counts[axis].max(2) - 2;
        let place = match higher {
            false => origin[axis].checked_sub(1),
            true => Some(origin[axis] + (1 << level)).filter(|place| *place <= last),
        };
        let Some(place) = place else { return Vec::new() };
        // Smaller ones are half as wide.
        let half = 1 << level >> 1;
        let parts = (0..4).map(|part| {
            let mut there = origin;
            there[axis] = place;
            for (bit, other) in (0..3).filter(|other| *other != axis).enumerate() {
                there[other] += (part >> bit & 1) * if self.grid.counts[other] > 1 { half } else { 0 };
            }
            self.grid.index_of(bricks.leaf(there).origin)
        });
        let mut cells: Vec<u32> = parts.collect();
        cells.sort_unstable();
        cells.dedup();
        cells
    }

    /// The nodes next to a node.
    pub fn neighbours(&self, node: u32) -> Neighbours {
        let place = match self.bricks {
            None => self.grid.place_of(node),
            Some(bricks) => bricks.place_of(node as usize),
        };
        let steps = self.bricks.map_or(1, |bricks| 1 << bricks.levels());
        std::array::from_fn(|side| {
            let (axis, higher) = (side / 2, side % 2 == 1);
            let mut step = 1;
            while step <= steps {
                let mut there = place;
                there[axis] = match higher {
                    false => place[axis].checked_sub(step)?,
                    true => Some(place[axis] + step).filter(|place| *place < self.grid.counts[axis])?,
                };
                let found = match self.bricks {
                    None => Some(self.grid.index_of(there)),
                    Some(bricks) => bricks.node_at(there),
                };
                if let Some(node) = found {
                    return Some((node, step));
                }
                step *= 2;
            }
            None
        })
    }
}
