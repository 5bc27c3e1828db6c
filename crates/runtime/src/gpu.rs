//! A grid, sparse or not, as the buffers that `shaders/gdibl.wgsl`, `gdibl.glsl` and `gdibl.hlsl` sample.
//!
//! Upload the four once; the shaders' `gdibl_irradiance(position, normal)` then gives per pixel what
//! [`Volume::irradiance`] gives. All numbers are little-endian; a word is a u32.
//!
//! ```text
//! header        64 bytes, a uniform buffer
//!    0   f32 × 3  nodes_per_metre   (count - 1) / (max - min) per axis; 0 on an axis with one node
//!   12   f32      scale             coefficient = f16 × scale
//!   16   u32 × 3  counts            nodes per axis; of a sparse grid places
//!   28   u32      bands             0 to 2
//!   32   f32 × 3  extent            max - min, metres
//!   44   f32      bias              metres along the normal before anything is looked up; 0 without walls
//!   48   u32      marked            0: every node is valid and no cell has a wall
//!   52   u32      levels            0: a grid. Else a sparse one, its largest cells 2^levels places wide
//!   56   u32      valid_at          sparse: the first word in `marks` of the bits of valid nodes
//!   60   f32      step              of packed coefficients; 0: they are f16
//! coefficients  2, 6 or 14 words per node (L0, L1, L2): f16 × 3 per coefficient, red green blue, coefficient by
//!               coefficient, two to a word, the first in the lower half; 0 after the last where their number is odd
//!   or packed,  numbers of [`packed`](crate::packed): heads, 3 C + 3 words per 64 nodes (C = 1, 4, 9 coefficients), then rows
//!      word 0   where in `coefficients` the rows of these nodes begin
//!      word 1   bits of a row
//!   words 2 …   of the code of M, then of each number: the least of these nodes, i16 in the lower half; the bits that what is
//!               over it takes, 0 to 16, in the upper half
//!        rows   node by node, and in each number by number, that many bits, low ones first, without gaps; a word of zeros
//!               after the last
//! marks         grid: 3 words per 32 nodes; without meaning if nothing is marked. For node n those at 3 (n / 32), and bit n % 32 of them:
//!      word 0   1: valid
//!      word 1   1: walls go through the cell of which n is the lowest corner
//!      word 2   where in `walls` the record of the first such cell of the 32 is; the others' follow
//!               sparse grid: 38 words per brick of 8 × 8 × 8 places, x fastest
//!      word 0   its first node
//!      word 1   where in `walls` the record of its first cell with walls is; the others' follow
//!   words 2-5   u16 per z: nodes of the brick before it
//!   words 6-21  two per z: bit x + 8 (y % 4) of the first where y < 4, else of the second: a node
//!  words 22-37  the same: walls go through the cell of which it is the lowest place
//!               then, if anything is marked, one word per 32 nodes: bit n % 32 is set if node n is valid
//! walls         4 words each. First the planes: f32 × 3 unit normal, f32 distance. Then the cells:
//!      word 0   u16 × 2 indices of planes in `walls`, the first in the lower half; 65535: none
//!      word 1   u16 index of the third plane; then the ends, bit 16 + k for corner k
//!   words 2, 3  masks of the eight parts, a byte each, the first in the lowest
//! ```
//! No buffer is empty: what a volume does not need is one element of zeros, for most interfaces bind nothing smaller.
//! What these numbers mean is said in FORMAT.md, *Light at a position* and *Walls*.
//!
//! **Positions** in shaders are relative to [`GpuBuffers::min`]: an f32 then keeps a ten-millionth of the box's size however
//! far the box is from the origin. Subtract min where you have f64 (per object, or from the camera's position).
//!
//! **Bands** 3 and 4 are left out: band 3 adds nothing to irradiance (A_3 = 0), and band 4 at most 8 % of its root mean
//! square, under one small lamp in the dark.
//!
//! **Rounding**: f16 files go over bit by bit. An f32 number v is rounded to f16 with a power of two as scale that brings
//! the volume's largest number to 2¹⁴ and more: off by at most |v| 2⁻¹¹, or the largest's 2⁻³⁹ where that is more.
//!
//! **Packed** coefficients take a quarter to a third of the memory of f16, and more work per node: see
//! [`Volume::gpu_buffers_packed`].

use crate::bricks::{BRICK, Bricks};
use crate::coefficients::Coefficients;
use crate::error::text;
use crate::half::f32_to_f16;
use crate::sh::coefficient_count;
use crate::volume::{VALID, WALLED};
use crate::walls::{WallCell, Walls};
use crate::{Error, Grid, RadianceSh, Volume, packed};
use alloc::vec;
use alloc::vec::Vec;

/// The highest band that shaders evaluate.
pub const GPU_BANDS: u32 = 2;

/// Nodes that share three words of marks.
const BLOCK: usize = 32;
/// Nodes that share a head of packed coefficients.
const PACKED_BLOCK: usize = 64;
/// Words of a brick.
const BRICK_WORDS: usize = 38;

/// What the shaders bind. The module's documentation has the layouts.
#[derive(Clone, Debug, PartialEq)]
pub struct GpuBuffers {
    /// The box's lowest corner, metres: positions in shaders are relative to it.
    pub min: [f64; 3],
    /// The uniform buffer.
    pub header: [u8; 64],
    /// Pairs of f16, node by node; or packed.
    pub coefficients: Vec<u32>,
    /// Three words per 32 nodes.
    pub marks: Vec<u32>,
    /// Planes, then cells.
    pub walls: Vec<[u32; 4]>,
}

impl Volume {
    /// The buffers that the shaders sample. [`Error::Unsupported`] if this is no grid, or one so large that a word of its
    /// coefficients has no number that fits a u32 (300 million nodes of L2: 17 GB).
    pub fn gpu_buffers(&self) -> Result<GpuBuffers, Error> {
        let header = &self.header;
        let grid = self.gpu_grid()?;
        let bands = header.bands.min(GPU_BANDS);
        let words = (header.node_count() as u64).saturating_mul(words_per_node(bands) as u64);
        if words > u64::from(u32::MAX) {
            return Err(Error::unsupported("counts", text!("{words} words"), "at most 4294967295, for shaders"));
        }
        let (scale, coefficients) = self.half_coefficients(bands);
        Ok(self.buffers(&grid, Shaded { bands, scale, step: 0.0, coefficients }))
    }

    /// The same with packed coefficients: of a packed file in its own numbers, where `step` is its header's scale; of another
    /// quantised here, E of most nodes being off by 1.5 times the step at L2, once at L1: see [`packed`] for the bound.
    ///
    /// # Panics
    /// If the step is not one of [`packed::STEPS`].
    pub fn gpu_buffers_packed(&self, step: f32) -> Result<GpuBuffers, Error> {
        let grid = self.gpu_grid()?;
        let bands = self.header.bands.min(GPU_BANDS);
        let values = 3 * coefficient_count(bands);
        let coefficients = packed_words(self.node_count(), values, step, |node| self.node_sh(node));
        if coefficients.len() as u64 > u64::from(u32::MAX) {
            let found = text!("{} words", coefficients.len());
            return Err(Error::unsupported("counts", found, "at most 4294967295, for shaders"));
        }
        Ok(self.buffers(&grid, Shaded { bands, scale: 1.0, step, coefficients }))
    }

    fn gpu_grid(&self) -> Result<Grid, Error> {
        let kind = self.header.kind;
        self.grid().ok_or_else(|| Error::unsupported("kind", text!("{kind:?}"), "a grid, for shaders"))
    }

    fn buffers(&self, grid: &Grid, shaded: Shaded) -> GpuBuffers {
        let (planes, cells) = self.walls.as_ref().map_or((&[][..], &[][..]), Walls::tables);
        let is_marked = self.marks.is_some() || self.walls.is_some();
        let first = planes.len() as u32;
        let (marks, valid_at) = match (&self.bricks, &self.marks) {
            (Some(bricks), marks) => {
                let mut words = brick_words(bricks, grid, cells, first);
                let valid_at = words.len() as u32;
                if is_marked {
                    let valid = |block: usize| {
                        let nodes = BLOCK * block..(BLOCK * (block + 1)).min(self.node_count());
                        bits(nodes.map(|node| marks.as_ref().is_none_or(|marks| marks[node] & VALID != 0)))
                    };
                    words.extend((0..self.node_count().div_ceil(BLOCK)).map(valid));
                }
                (words, valid_at)
            }
            (None, Some(marks)) => (packed_marks(marks, first), 0),
            (None, None) => (vec![0; 3], 0),
        };
        let mut walls: Vec<[u32; 4]> = Vec::with_capacity((planes.len() + cells.len()).max(1));
        walls.extend(planes.iter().map(|plane| {
            let [x, y, z] = plane.normal;
            [x, y, z, plane.distance].map(f32::to_bits)
        }));
        match &self.bricks {
            None => walls.extend(cells.iter().map(packed_cell)),
            Some(bricks) => {
                let mut cells = cells.to_vec();
                cells.sort_by_key(|cell| bricks.order(grid, cell.cell));
                walls.extend(cells.iter().map(packed_cell));
            }
        }
        if walls.is_empty() {
            walls.push([0; 4]);
        }
        let bias = self.walls.as_ref().map_or(0.0, |walls| walls.bias);
        let levels = self.bricks.as_ref().map_or(0, Bricks::levels);
        let header = header_bytes(grid, &shaded, bias, [u32::from(is_marked), levels, valid_at]);
        GpuBuffers { min: self.header.min, header, coefficients: shaded.coefficients, marks, walls }
    }

    /// The scale and the words of all nodes.
    fn half_coefficients(&self, bands: u32) -> (f32, Vec<u32>) {
        let (stride, count) = (self.header.values_per_node(), 3 * coefficient_count(bands));
        match &self.coefficients {
            Coefficients::F16(all) => {
                let mut words = Vec::with_capacity(self.node_count() * words_per_node(bands));
                for row in all.chunks_exact(stride.div_ceil(2)) {
                    words.extend_from_slice(&row[..count / 2]);
                    words.extend(row[count / 2..].first().filter(|_| count % 2 == 1).map(|word| word & 0xffff));
                }
                (self.scale, words)
            }
            Coefficients::F32(all) => {
                let rows = || all.chunks_exact(stride);
                let largest = rows().flat_map(|row| &row[..count]).fold(0.0, |most: f32, value| most.max(value.abs()));
                // A power of two 2¹⁴ below that of the largest: none comes near f16's own largest, 65504. Not below
                // 2⁻¹⁰⁰, so that dividing by it overflows nothing.
                let exponent = ((largest.to_bits() >> 23) as i32 - 127 - 14).max(-100);
                let scale = f32::from_bits(((exponent + 127) as u32) << 23);
                (scale, pairs(rows(), count, |value| f32_to_f16(value / scale)))
            }
        }
    }
}

/// Coefficients as shaders get them, and what the header says of them.
struct Shaded {
    bands: u32,
    scale: f32,
    step: f32,
    coefficients: Vec<u32>,
}

const fn words_per_node(bands: u32) -> usize {
    (3 * coefficient_count(bands)).div_ceil(2)
}

/// The first `count` numbers of each row, two to a word.
fn pairs<'a, T: 'a>(rows: impl Iterator<Item = &'a [T]>, count: usize, f16: impl Fn(&T) -> u16) -> Vec<u32> {
    let mut words = Vec::with_capacity(rows.size_hint().0 * count.div_ceil(2));
    for row in rows {
        let half = |value: Option<&T>| value.map_or(0, |value| u32::from(f16(value)));
        words.extend(row[..count].chunks(2).map(|pair| half(pair.first()) | half(pair.get(1)) << 16));
    }
    words
}

/// The words of packed coefficients; the first `values` of each node.
///
/// # Panics
/// If the step is not one of [`packed::STEPS`].
fn packed_words(nodes: usize, values: usize, step: f32, node_sh: impl Fn(usize) -> RadianceSh) -> Vec<u32> {
    assert!(packed::STEPS.contains(&step), "step {step} not in {:?}", packed::STEPS);
    let count = values + 1;
    let head_words = nodes.div_ceil(PACKED_BLOCK) * (count + 2);
    let mut words = vec![0u32; head_words];
    let mut numbers = [0i16; PACKED_BLOCK * packed::MAX_NUMBERS];
    for block in 0..nodes.div_ceil(PACKED_BLOCK) {
        let in_block = PACKED_BLOCK.min(nodes - block * PACKED_BLOCK);
        let numbers = &mut numbers[..in_block * count];
        for (place, numbers) in numbers.chunks_exact_mut(count).enumerate() {
            let sh = node_sh(block * PACKED_BLOCK + place);
            packed::quantise_node(&sh.coefficients.as_flattened()[..values], step, numbers);
        }
        let mut least = [0i32; packed::MAX_NUMBERS];
        let mut widths = [0u32; packed::MAX_NUMBERS];
        for number in 0..count {
            let all = || numbers.iter().skip(number).step_by(count).map(|&q| i32::from(q));
            least[number] = all().min().unwrap_or(0);
            widths[number] = 32 - (all().max().unwrap_or(0) - least[number]).leading_zeros();
        }
        let head = block * (count + 2);
        words[head] = words.len() as u32;
        words[head + 1] = widths.iter().sum();
        for number in 0..count {
            words[head + 2 + number] = least[number] as u32 & 0xffff | widths[number] << 16;
        }
        // What is not a whole word yet.
        let (mut rest, mut bits) = (0u64, 0);
        for (place, &q) in numbers.iter().enumerate() {
            let number = place % count;
            rest |= ((i32::from(q) - least[number]) as u64) << bits;
            bits += widths[number];
            if bits >= 32 {
                words.push(rest as u32);
                (rest, bits) = (rest >> 32, bits - 32);
            }
        }
        if bits > 0 {
            words.push(rest as u32);
        }
    }
    words.push(0);
    words
}

/// The words of the bricks of a sparse grid. `first` is where the record of the first cell with walls will be; there the
/// records have to be in the order of [`Bricks::order`].
fn brick_words(bricks: &Bricks, grid: &Grid, walled: &[WallCell], first: u32) -> Vec<u32> {
    let mut words = Vec::with_capacity(bricks.bricks().len() * BRICK_WORDS);
    let mut walls = vec![[0u64; BRICK as usize]; bricks.bricks().len()];
    for cell in walled {
        let (brick, slice, bit) = bricks.order(grid, cell.cell);
        walls[brick][slice] |= 1 << bit;
    }
    let mut record = first;
    for (brick, walls) in bricks.bricks().iter().zip(&walls) {
        words.extend([brick.first, record]);
        words.extend(brick.before.chunks(2).map(|pair| u32::from(pair[0]) | u32::from(pair[1]) << 16));
        for slices in [&brick.slices, walls] {
            words.extend(slices.iter().flat_map(|slice| [*slice as u32, (*slice >> 32) as u32]));
        }
        record += walls.iter().map(|slice| slice.count_ones()).sum::<u32>();
    }
    words
}

/// Three words per 32 nodes; the first cell's record is `walls[first]`.
fn packed_marks(marks: &[u8], first: u32) -> Vec<u32> {
    let mut words = Vec::with_capacity(3 * marks.len().div_ceil(BLOCK));
    let mut record = first;
    for block in marks.chunks(BLOCK) {
        let having = |mark: u8| bits(block.iter().map(|found| found & mark != 0));
        let walled = having(WALLED);
        words.extend([having(VALID), walled, record]);
        record += walled.count_ones();
    }
    words
}

/// The first bit in the lowest.
fn bits(flags: impl Iterator<Item = bool>) -> u32 {
    flags.enumerate().map(|(place, flag)| u32::from(flag) << place).sum()
}

fn packed_cell(cell: &WallCell) -> [u32; 4] {
    let [a, b, c] = cell.planes.map(u32::from);
    let masks = |first: usize| u32::from_le_bytes(core::array::from_fn(|k| cell.masks[first + k]));
    [a | b << 16, c | u32::from(cell.ends) << 16, masks(0), masks(4)]
}

fn header_bytes(grid: &Grid, shaded: &Shaded, bias: f32, [marked, levels, valid_at]: [u32; 3]) -> [u8; 64] {
    let extent: [f64; 3] = core::array::from_fn(|axis| grid.max[axis] - grid.min[axis]);
    let nodes_per_metre = |axis: usize| match grid.counts[axis] {
        1 => 0.0,
        // Finite also where the box is flat and has several nodes nevertheless.
        count => (f64::from(count - 1) / extent[axis]).min(f64::from(f32::MAX)) as f32,
    };
    let float = f32::to_bits;
    let [width, height, depth] = grid.counts;
    let words = [
        float(nodes_per_metre(0)),
        float(nodes_per_metre(1)),
        float(nodes_per_metre(2)),
        float(shaded.scale),
        width,
        height,
        depth,
        shaded.bands,
        float(extent[0] as f32),
        float(extent[1] as f32),
        float(extent[2] as f32),
        float(bias),
        marked,
        levels,
        valid_at,
        float(shaded.step),
    ];
    let mut bytes = [0; 64];
    for (place, word) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(words) {
        *place = word.to_le_bytes();
    }
    bytes
}
