//! Smaller volumes out of a baked one, from its file alone: coarser ones for small devices, and tiles that an engine loads as it needs
//! them.
//!
//! A cut's nodes are those of the volume where it has one; elsewhere they hold what the volume answers there. So a [tile](tiles()) says
//! what the volume says, and a [coarser](coarser()) one what interpolation over wider cells leaves of that, with walls that are fitted
//! to the volume's light.

mod tiles;
mod walls;

use gdibl_runtime::bricks::Bricks;
use gdibl_runtime::{Grid, RadianceSh, Volume, sh};
use glam::DVec3;
use rayon::prelude::*;

pub use tiles::{Tile, tiles, whole};

use crate::bake::{self, Baked, Nodes, SparseGrid, Standing, irradiance_of, root_mean_square};
use crate::records::{ErrorSummary, Records, WallsRecord};
use crate::sampling::{Sampler, Stream};

/// Nodes with their light, ready to be packed.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// Where they are.
    pub nodes: Nodes,
    /// Their light.
    pub baked: Baked,
}

/// What a cut takes over of a node, or of a place between nodes.
struct Light {
    sh: RadianceSh,
    is_valid: bool,
    coverage: f32,
    relative_error: f32,
}

impl Light {
    /// That of a node.
    fn of(volume: &Volume, node: usize) -> Light {
        Light {
            sh: volume.node_sh(node),
            is_valid: volume.is_valid(node),
            coverage: volume.node_coverage(node),
            relative_error: volume.node_relative_error(node).unwrap_or(f32::INFINITY),
        }
    }

    /// Blended of nodes, of which valid ones count, if there are any. Weights add up to 1.
    fn blended(volume: &Volume, nodes: &[u32; 8], weights: &[f32; 8]) -> Light {
        let valid = |k: &usize| weights[*k] > 0.0 && volume.is_valid(nodes[*k] as usize);
        let share: f32 = (0..8).filter(valid).map(|k| weights[k]).sum();
        let (is_valid, total) = if share > 0.0 { (true, share) } else { (false, 1.0) };
        let mut light =
            Light { sh: RadianceSh::zero(volume.header().bands), is_valid, coverage: 0.0, relative_error: 0.0 };
        for k in (0..8).filter(|k| weights[*k] > 0.0 && (!is_valid || valid(k))) {
            let (node, weight) = (Light::of(volume, nodes[k] as usize), weights[k] / total);
            light.sh.add_scaled(&node.sh, weight);
            light.coverage += weight * node.coverage;
            light.relative_error += weight * node.relative_error;
        }
        light
    }
}

impl Part {
    /// Takes `light` at every node of a grid, or of the places in it that are nodes.
    fn new(grid: Grid, bricks: Option<Bricks>, bands: u32, light: impl Fn([u32; 3]) -> Light) -> Part {
        let nodes = match bricks {
            None => Nodes::Grid(grid),
            Some(bricks) => Nodes::Sparse(SparseGrid { grid, bricks }),
        };
        let count = 3 * sh::coefficient_count(bands);
        let mut baked = Baked {
            bands,
            sh: Vec::with_capacity(nodes.len() * count),
            standing: Vec::new(),
            moved: Vec::new(),
            walls: None,
            coverage: Vec::new(),
            relative_error: Vec::new(),
            systematic_error: Vec::new(),
            worst_error: Vec::new(),
            coefficient_error: Vec::new(),
            rays: 0,
            samples: 0,
            missed: 0,
            missed_by_systematic: 0,
            clamped: 0.0,
        };
        for node in 0..nodes.len() {
            let light = light(match &nodes {
                Nodes::Sparse(sparse) => sparse.bricks.place_of(node),
                _ => grid.place_of(node as u32),
            });
            baked.sh.extend(&light.sh.coefficients.as_flattened()[..count]);
            baked.standing.push(if light.is_valid { Standing::Open } else { Standing::Uncovered });
            baked.coverage.push(light.coverage);
            baked.relative_error.push(light.relative_error);
        }
        Part { nodes, baked }
    }

    /// The records of the volume that this was cut from, with its own figures in place of those that are others now.
    pub fn records(&self, mut records: Records) -> Records {
        let Baked { walls, relative_error, .. } = &self.baked;
        let statistics = &mut records.statistics;
        let valid = || self.baked.valid_nodes();
        statistics.nodes = self.nodes.len() as u64;
        statistics.nodes_valid = valid().count() as u64;
        statistics.relative_error = ErrorSummary::of(valid().map(|node| f64::from(relative_error[node])));
        statistics.coverage =
            valid().map(|node| f64::from(self.baked.coverage[node])).sum::<f64>() / valid().count().max(1) as f64;
        statistics.walls = walls.as_ref().map(WallsRecord::from);
        (statistics.worst_direction_error, statistics.sparse, statistics.packing) = (None, None, None);
        records
    }
}

/// The volume with cells 2^steps times as wide, or a little less where that does not divide its box. `None` if it is no grid, or has
/// one node.
pub fn coarser(volume: &Volume, steps: u32) -> Option<Part> {
    let grid = volume.grid().filter(|grid| grid.counts != [1; 3])?;
    let counts = grid.counts.map(|count| (count - 1).div_ceil(1 << steps) + 1);
    let coarse = Grid { counts, ..grid };
    let divides = grid.counts.iter().all(|count| (count - 1).is_multiple_of(1 << steps));
    let light = |place: [u32; 3]| {
        let node = divides.then(|| node_at(volume, &grid, place.map(|p| p << steps))).flatten();
        match node {
            Some(node) => Light::of(volume, node as usize),
            None => {
                let position = coarse.place_position(place);
                let cell = volume.cell(position).expect("a grid has cells");
                let sample = volume.sample_f64(position, [0.0; 3]);
                let between = Light::blended(volume, &cell.nodes, &cell.weights);
                // Walls are known to the sample alone. A node that is in a solid by half or more has no light of its own.
                Light { sh: sample.sh, is_valid: sample.validity > 0.5, ..between }
            }
        }
    };
    let bricks = volume.bricks().filter(|bricks| divides && bricks.levels() > steps).map(|bricks| {
        let is_refined = |level: u32, cell: [u32; 3]| {
            let level = level + steps;
            bricks.leaf(cell.map(|n| n << level)).level < level
        };
        Bricks::new(counts, bricks.levels() - steps, is_refined)
    });
    let mut part = Part::new(coarse, bricks, volume.header().bands, light);
    part.baked.walls = walls::fit(&part, volume);
    Some(part)
}

/// The node at a place of a volume's grid.
fn node_at(volume: &Volume, grid: &Grid, place: [u32; 3]) -> Option<u32> {
    match volume.bricks() {
        None => Some(grid.index_of(place)),
        Some(bricks) => bricks.node_at(place),
    }
}

/// What parts of a volume are off it, at `count` places spread over its box where it has light of its own: root mean square of the
/// difference of E over normals and channels, over the larger of the volume's own and a tenth of the median. `None` where it has none.
pub fn difference(volume: &Volume, parts: &[Volume], count: u32) -> Option<ErrorSummary> {
    let (min, max) = (DVec3::from(volume.header().min), DVec3::from(volume.header().max));
    let stream = Stream::new(Sampler::Sobol, 0, 0, 0);
    let found: Vec<(f64, f64)> = (0..count)
        .into_par_iter()
        .filter_map(|index| {
            let ([x, y], [z, _]) = (stream.point(index, 0), stream.point(index, 1));
            let position = (min + DVec3::new(x.into(), y.into(), z.into()) * (max - min)).to_array();
            let whole = volume.sample_f64(position, [0.0; 3]);
            let part = parts.iter().map(|part| part.sample_f64(position, [0.0; 3])).find(|sample| sample.inside)?;
            let [e, f] = [&whole, &part].map(|sample| irradiance_of(sample.sh.coefficients.as_flattened()));
            (whole.validity > 0.0).then(|| (root_mean_square(&e), root_mean_square(&bake::difference(&e, &f))))
        })
        .collect();
    let mut sizes: Vec<f64> = found.iter().map(|(size, _)| *size).collect();
    sizes.sort_by(f64::total_cmp);
    let floor = 0.1 * sizes.get(sizes.len() / 2)?;
    // All black: nothing is off.
    ErrorSummary::of(found.into_iter().map(|(size, off)| if off == 0.0 { 0.0 } else { off / size.max(floor) }))
}
