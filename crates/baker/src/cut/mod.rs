//! Smaller volumes out of a baked one, from its file alone: coarser ones for small devices, and tiles that an engine loads as it needs
//! them.
//!
//! A cut's nodes are those of the volume where it has one; elsewhere they hold what the volume answers there. So a [tile](tiles()) says
//! what the volume says, and a [coarser](coarser()) one what interpolation over wider cells leaves of that, with walls that are fitted
//! to the volume's light.

mod part;
mod tiles;
mod walls;

use gdibl_runtime::bricks::Bricks;
use gdibl_runtime::{Grid, Volume};
use glam::DVec3;
use rayon::prelude::*;

pub use part::Part;
use part::{Light, node_at};
pub use tiles::{Tile, tiles, whole};

use crate::bake::{self, irradiance_of, root_mean_square};
use crate::job::records::ErrorSummary;
use crate::sampling::{Sampler, Stream};

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
