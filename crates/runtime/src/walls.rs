//! Walls between the nodes of a grid: which corners of a cell count in which part of it.
//!
//! Up to three planes cut a cell into parts, and each part has a mask of the corners that are seen from there. Cells without
//! a record have no wall in them. All of a file's planes are in one table, for a wall goes through many cells.

use crate::bricks::Bricks;
use crate::error::text;
use crate::{Error, Grid};
use alloc::vec;
use alloc::vec::Vec;
use core::array;

/// Most planes that cut a cell.
pub const MOST_PLANES: usize = 3;
/// A position moves by this share of the distance between nodes along the surface's normal before it is looked up: so a
/// surface that lies in a wall's plane falls to the side that it faces.
pub const BIAS: f32 = 1e-4;

/// A position p, relative to the header's min, is on the positive side if normal·p > distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Unit vector.
    pub normal: [f32; 3],
    /// Metres.
    pub distance: f32,
}

/// A cell that walls go through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WallCell {
    /// Index of the cell's lowest node; in a sparse grid, of its lowest place in the grid.
    pub cell: u32,
    /// Indices of planes; [`WallCell::NO_PLANE`] after the last one.
    pub planes: [u16; MOST_PLANES],
    /// Bit k of the place in this array is set on the positive side of plane k. Bit k of a mask is set if corner k of the
    /// cell counts there (see [`Cell::nodes`](crate::Cell::nodes)); where none is, all do.
    pub masks: [u8; 1 << MOST_PLANES],
    /// Corners at which a wall ends: bit k for corner k. The nearer to them, the more the hidden corners count, so that
    /// nothing jumps where the next cell has no wall.
    pub ends: u8,
}

impl WallCell {
    /// In place of a plane: there is none.
    pub const NO_PLANE: u16 = u16::MAX;
    /// Bytes of one in a file.
    pub const SIZE: usize = 20;
}

/// Bytes of a plane in a file.
const PLANE_SIZE: usize = 16;

/// Section `WALL`'s bytes, see FORMAT.md.
pub fn walls_to_bytes(planes: &[Plane], cells: &[WallCell]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(8 + PLANE_SIZE * planes.len() + WallCell::SIZE * cells.len());
    bytes.extend((planes.len() as u32).to_le_bytes());
    bytes.extend((cells.len() as u32).to_le_bytes());
    for plane in planes {
        plane.normal.iter().chain([&plane.distance]).for_each(|value| bytes.extend(value.to_le_bytes()));
    }
    for cell in cells {
        bytes.extend(cell.cell.to_le_bytes());
        cell.planes.iter().for_each(|plane| bytes.extend(plane.to_le_bytes()));
        bytes.extend([cell.ends, 0]);
        bytes.extend(cell.masks);
    }
    bytes
}

/// All of a volume's.
#[derive(Clone, Debug)]
pub(crate) struct Walls {
    planes: Vec<Plane>,
    /// In order of their cells.
    cells: Vec<WallCell>,
    /// `first[b]`: the first whose cell is at least 64 b.
    first: Vec<u32>,
    /// Metres along the normal, before anything is looked up.
    pub bias: f32,
}

impl Walls {
    /// Reads section `WALL` of a grid, or of a sparse one in it.
    pub fn parse(bytes: &[u8], grid: &Grid, bricks: Option<&Bricks>) -> Result<Walls, Error> {
        let place = "section WALL";
        let word = |at: usize| u32::from_le_bytes(array::from_fn(|k| bytes[at + k]));
        let (plane_count, cell_count) = match bytes.len() {
            8.. => (word(0) as usize, word(4) as usize),
            found => return Err(Error::invalid(place, text!("{found} bytes"), "at least 8")),
        };
        let expected = 8 + plane_count as u64 * PLANE_SIZE as u64 + cell_count as u64 * WallCell::SIZE as u64;
        if expected != bytes.len() as u64 {
            let expected = text!("{expected} for {plane_count} planes and {cell_count} cells");
            return Err(Error::invalid(place, text!("{} bytes", bytes.len()), expected));
        }
        let (planes, cells) = bytes[8..].split_at(plane_count * PLANE_SIZE);
        let planes: Vec<Plane> = planes.as_chunks::<PLANE_SIZE>().0.iter().map(plane_from).collect();
        let records = cells.as_chunks::<{ WallCell::SIZE }>().0;
        let cells: Vec<WallCell> = records.iter().map(cell_from).collect();
        let is_finite = |plane: &Plane| plane.normal.iter().chain([&plane.distance]).all(|value| value.is_finite());
        if let Some(number) = planes.iter().position(|plane| !is_finite(plane)) {
            return Err(Error::invalid(text!("section WALL, plane {number}"), "infinity or NaN", "finite numbers"));
        }
        let is_cell = |cell: u32| {
            let place = grid.place_of(cell);
            grid.is_cell(cell) && bricks.is_none_or(|bricks| bricks.leaf(place).origin == place)
        };
        let mut next = 0u64;
        for (number, (cell, cell_bytes)) in cells.iter().zip(records).enumerate() {
            let place = || text!("section WALL, record {number}");
            if u64::from(cell.cell) < next || !is_cell(cell.cell) {
                return Err(Error::invalid(place(), text!("cell {}", cell.cell), "a cell after the one before"));
            }
            next = u64::from(cell.cell) + 1;
            let used = cell.planes.iter().position(|plane| *plane == WallCell::NO_PLANE).unwrap_or(MOST_PLANES);
            let (named, rest) = cell.planes.split_at(used);
            let known = named.iter().all(|plane| usize::from(*plane) < planes.len());
            if cell_bytes[11] != 0 {
                return Err(Error::invalid(place(), text!("byte 11: {}", cell_bytes[11]), "0"));
            }
            if !known || rest.iter().any(|plane| *plane != WallCell::NO_PLANE) {
                let expected = text!("some of the {} planes, then 65535", planes.len());
                return Err(Error::invalid(place(), text!("planes {:?}", cell.planes), expected));
            }
        }
        let blocks = grid.node_count() / BLOCK + 1;
        let mut first = vec![0; blocks + 1];
        for cell in &cells {
            first[cell.cell as usize / BLOCK + 1] += 1;
        }
        (0..blocks).for_each(|block| first[block + 1] += first[block]);
        Ok(Walls { planes, cells, first, bias: bias(grid) })
    }

    /// Cells that have a record.
    pub fn cells(&self) -> impl Iterator<Item = u32> {
        self.cells.iter().map(|cell| cell.cell)
    }

    /// All planes, and all cells in order.
    pub fn tables(&self) -> (&[Plane], &[WallCell]) {
        (&self.planes, &self.cells)
    }

    /// How many cells have a record.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// A position on a surface, on the side that it faces.
    #[inline(always)]
    pub fn off_surface(&self, position: [f64; 3], normal: [f32; 3]) -> [f64; 3] {
        // What is no unit vector moves nothing.
        let along = |k: usize| if normal[k].abs() < 1.5 { normal[k] } else { 0.0 };
        array::from_fn(|k| position[k] + f64::from(self.bias * along(k)))
    }

    /// How much each corner of a cell counts at a position, relative to the header's min, where the cell's trilinear weights
    /// are these; all in full where the cell has no record.
    pub fn shares(&self, cell: u32, position: [f64; 3], weights: &[f32; 8]) -> [f32; 8] {
        let block = cell as usize / BLOCK;
        let cells = &self.cells[self.first[block] as usize..self.first[block + 1] as usize];
        let Some(found) = cells.iter().find(|found| found.cell == cell) else { return [1.0; 8] };
        let mut part = 0;
        for (bit, plane) in found.planes.iter().enumerate() {
            let Some(plane) = self.planes.get(usize::from(*plane)) else { break };
            let [x, y, z] = plane.normal.map(f64::from);
            let height = x * position[0] + y * position[1] + z * position[2] - f64::from(plane.distance);
            part |= usize::from(height > 0.0) << bit;
        }
        let mask = found.masks[part];
        let at_ends: f32 = (0..8).filter(|k| found.ends >> k & 1 == 1).map(|k| weights[k]).sum();
        let hidden = (2.0 * at_ends - 1.0).max(0.0);
        array::from_fn(|k| if mask >> k & 1 == 1 { 1.0 } else { hidden })
    }
}

/// Nodes per entry of the index.
const BLOCK: usize = 64;

fn bias(grid: &Grid) -> f32 {
    let least = grid.spacing().into_iter().filter(|spacing| *spacing > 0.0).fold(f64::INFINITY, f64::min);
    if least.is_finite() { least as f32 * BIAS } else { 0.0 }
}

fn plane_from(bytes: &[u8; PLANE_SIZE]) -> Plane {
    let float = |k: usize| f32::from_le_bytes(array::from_fn(|i| bytes[4 * k + i]));
    Plane { normal: [float(0), float(1), float(2)], distance: float(3) }
}

fn cell_from(bytes: &[u8; WallCell::SIZE]) -> WallCell {
    let half = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
    WallCell {
        cell: u32::from_le_bytes(array::from_fn(|i| bytes[i])),
        planes: [half(4), half(6), half(8)],
        masks: array::from_fn(|i| bytes[12 + i]),
        ends: bytes[10],
    }
}
