//! A volume in pieces, each a volume of its own: an engine loads those around the camera.

use gdibl_runtime::bricks::{Bricks, Leaf};
use gdibl_runtime::walls::{Plane, WallCell};
use gdibl_runtime::{Grid, Volume};
use std::collections::HashMap;

use super::part::{Light, Part, node_at};
use crate::bake::Walls;

/// A piece of a volume. Inside it says what the volume says; nodes in the face between two tiles are in both.
#[derive(Debug, Clone, PartialEq)]
pub struct Tile {
    /// Which it is, along x, y, z.
    pub index: [u32; 3],
    /// Its nodes.
    pub part: Part,
}

/// The tiles of a volume, x fastest, about `width` metres wide: of a sparse grid whole coarsest cells. Those without light of their own
/// are left out. `None` if the volume is no grid.
pub fn tiles(volume: &Volume, width: f64) -> Option<impl Iterator<Item = Tile>> {
    let grid = volume.grid()?;
    let levels = volume.bricks().map_or(0, Bricks::levels);
    let spacing = grid.spacing();
    let ends: [Vec<u32>; 3] = std::array::from_fn(|axis| {
        let cells = (grid.counts[axis] - 1) >> levels;
        let wanted = (spacing[axis] * f64::from(grid.counts[axis] - 1) / width).round();
        // Casts saturate.
        let tiles = (wanted as u32).clamp(1, cells.max(1));
        (0..=tiles)
            .map(|tile| (u64::from(cells) * u64::from(tile) / u64::from(tiles)) as u32)
            .map(|n| n << levels)
            .collect()
    });
    let [nx, ny, nz] = [0, 1, 2].map(|axis| ends[axis].len() as u32 - 1);
    let indices = (0..nz).flat_map(move |z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z])));
    Some(indices.filter_map(move |index| {
        let place = |step: u32| std::array::from_fn(|axis: usize| ends[axis][(index[axis] + step) as usize]);
        let part = between(volume, &grid, place(0), place(1));
        let is_lit = part.baked.valid_nodes().next().is_some();
        is_lit.then_some(Tile { index, part })
    }))
}

/// All of a volume's nodes. `None` if it is no grid.
pub fn whole(volume: &Volume) -> Option<Part> {
    let grid = volume.grid()?;
    Some(between(volume, &grid, [0; 3], grid.counts.map(|count| count - 1)))
}

/// The nodes between two places, both included.
fn between(volume: &Volume, whole: &Grid, low: [u32; 3], high: [u32; 3]) -> Part {
    let grid = Grid {
        counts: std::array::from_fn(|axis| high[axis] - low[axis] + 1),
        min: axes(whole, low, whole.min),
        max: axes(whole, high, whole.max),
    };
    let place_in_whole = |place: [u32; 3]| std::array::from_fn(|axis| place[axis] + low[axis]);
    let light = |place: [u32; 3]| {
        let place = place_in_whole(place);
        match (node_at(volume, whole, place), volume.bricks()) {
            (Some(node), _) => Light::of(volume, node as usize),
            (None, Some(bricks)) => hanging(volume, bricks, place, low, high),
            (None, None) => unreachable!("all places of a grid are nodes"),
        }
    };
    let bricks = volume.bricks().map(|bricks| {
        let is_refined =
            |level: u32, cell: [u32; 3]| bricks.leaf(place_in_whole(cell.map(|n| n << level))).level < level;
        Bricks::new(grid.counts, bricks.levels(), is_refined)
    });
    let mut part = Part::new(grid, bricks, volume.header().bands, light);
    part.baked.walls = walls(volume, whole, &grid, low);
    part
}

/// The position of a place; on a flat axis `flat`, an end of the box.
fn axes(whole: &Grid, place: [u32; 3], flat: [f64; 3]) -> [f64; 3] {
    let position = whole.place_position(place);
    std::array::from_fn(|axis| if whole.counts[axis] > 1 { position[axis] } else { flat[axis] })
}

/// What a tile's own cells say at a corner that is no node of the volume, because larger cells are beyond the tile.
fn hanging(volume: &Volume, bricks: &Bricks, place: [u32; 3], low: [u32; 3], high: [u32; 3]) -> Light {
    let cell = std::array::from_fn(|axis| {
        if place[axis] == high[axis] && high[axis] > low[axis] { place[axis] - 1 } else { place[axis] }
    });
    let leaf: Leaf = bricks.leaf(cell);
    let corners = bricks.corners(leaf);
    let corner =
        (0..8).find(|corner| bricks.corner(leaf, *corner) == place).expect("nodes are corners of all cells around");
    let mut weights = [0.0; 8];
    weights[corner] = 1.0;
    corners.spread(&mut weights);
    Light::blended(volume, &corners.nodes, &weights)
}

/// Those in a tile.
fn walls(volume: &Volume, whole: &Grid, grid: &Grid, low: [u32; 3]) -> Option<Walls> {
    let (planes, cells) = volume.wall_tables();
    let mut walls = Walls::default();
    let mut known: HashMap<u16, u16> = HashMap::new();
    let shift: [f64; 3] = std::array::from_fn(|axis| grid.min[axis] - whole.min[axis]);
    for wall in cells {
        let place = whole.place_of(wall.cell);
        let is_in = |axis: usize| {
            let last = grid.counts[axis].max(2) - 2;
            (low[axis]..=low[axis] + last).contains(&place[axis])
        };
        if !(0..3).all(is_in) {
            continue;
        }
        let planes = wall.planes.map(|plane| match plane {
            WallCell::NO_PLANE => plane,
            _ => *known.entry(plane).or_insert_with(|| {
                let Plane { normal, distance } = planes[usize::from(plane)];
                let along: f64 = (0..3).map(|axis| f64::from(normal[axis]) * shift[axis]).sum();
                walls.planes.push(Plane { normal, distance: (f64::from(distance) - along) as f32 });
                walls.planes.len() as u16 - 1
            }),
        });
        let cell = grid.index_of(std::array::from_fn(|axis| place[axis] - low[axis]));
        walls.cells.push(WallCell { cell, planes, ..*wall });
    }
    walls.cells.sort_by_key(|wall| wall.cell);
    (!walls.cells.is_empty()).then_some(walls)
}
