//! Where probes should stand: a first placement that covers what the level's free space sees.
//!
//! Candidates are a lattice over the level, without those that stand in solids. Each looks around; what they see
//! together, weighed by how much of their view it fills, is what nodes there will ask probes for. Then greedily: the
//! candidate that adds most joins, where a surface point counts by how finely its best probe resolves it. The sum is
//! submodular, so greedy reaches 63 % of the optimum or more (Nemhauser, Wolsey, Fisher, 1978).

use glam::{DVec3, UVec3, Vec3};
use rayon::prelude::*;

use crate::radiance::path::Path;
use crate::radiance::{PathContext, RadianceFunction, SOLID_BACKS};
use crate::sampling::{Sampler, Stream, fibonacci_sphere, streams};
use crate::trace::Hit;

/// How probes are placed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaceSettings {
    /// At most so many.
    pub most: usize,
    /// A further probe must add at least this share of all that could be covered.
    pub gain: f64,
}

impl Default for PlaceSettings {
    fn default() -> Self {
        PlaceSettings { most: 32, gain: 0.005 }
    }
}

/// Where probes should stand.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Placement {
    /// World metres, the most useful first. Empty where there is nothing to see.
    pub positions: Vec<DVec3>,
    /// `coverage[i]`: share of what the free space sees that one of the first i + 1 probes sees at all, 0..=1.
    pub coverage: Vec<f64>,
}

/// Candidates wanted, about, and places tried for them at most: of a level with much rock or much sky few are free.
const CANDIDATES: usize = 1000;
const MOST_PLACES: usize = 16_000;
/// Directions in which a candidate looks around.
const VIEWS: usize = 256;
/// Surface points against which candidates are weighed, about.
const SURFACE_POINTS: usize = 4096;
/// A candidate that sees more backs of single-sided triangles than this share stands in a solid or outside.
const MOST_BACKS: f64 = 0.1;
/// Distance, as a share of the level's longest side, from which a probe that looks straight at a surface resolves it well
/// enough. A fifth: three probes for the report's box, as its author placed by hand.
const WELL_RESOLVED: f32 = 0.2;

/// Places probes for what `path` traces.
pub fn place_probes(path: &Path, bounds: (DVec3, DVec3), settings: &PlaceSettings) -> Placement {
    let mut placement = Placement::default();
    let directions = fibonacci_sphere(VIEWS);
    let mut places = CANDIDATES;
    let mut candidates = look_around(path, &lattice(bounds, places), &directions);
    while candidates.len() < CANDIDATES / 2 && !candidates.is_empty() && places < MOST_PLACES {
        places = (places * CANDIDATES / candidates.len()).min(MOST_PLACES);
        candidates = look_around(path, &lattice(bounds, places), &directions);
    }
    let seen: usize = candidates.iter().map(|candidate| candidate.hits.len()).sum();
    // Every so-manieth hit, so that every part of the view keeps its weight.
    let points: Vec<Hit> =
        candidates.iter().flat_map(|c| &c.hits).copied().step_by(seen.div_ceil(SURFACE_POINTS).max(1)).collect();
    if points.is_empty() {
        return placement;
    }
    let enough = WELL_RESOLVED * (path.frame().half.max_element() * 2.0);
    // How well each candidate resolves each point, 0..=1.
    let quality: Vec<Vec<f32>> = candidates
        .par_iter()
        .map(|candidate| points.iter().map(|point| candidate.quality(path, point, enough)).collect())
        .collect();
    let mut best = vec![0.0f32; points.len()];
    while placement.positions.len() < settings.most {
        let gain = |candidate: usize| -> f64 {
            quality[candidate].iter().zip(&best).map(|(q, b)| f64::from((q - b).max(0.0))).sum()
        };
        let gains: Vec<f64> = (0..candidates.len()).into_par_iter().map(gain).collect();
        // Of equal ones the first.
        let chosen = (0..gains.len()).max_by(|&a, &b| gains[a].total_cmp(&gains[b]).then(b.cmp(&a)));
        let Some(chosen) = chosen.filter(|&c| gains[c] > settings.gain * points.len() as f64) else { break };
        best.iter_mut().zip(&quality[chosen]).for_each(|(b, q)| *b = b.max(*q));
        placement.positions.push(path.frame().to_world(candidates[chosen].position));
        let covered = best.iter().filter(|b| **b > 0.0).count();
        placement.coverage.push(covered as f64 / points.len() as f64);
    }
    placement
}

/// Those of the places that are not in solids.
fn look_around(path: &Path, places: &[DVec3], directions: &[Vec3]) -> Vec<Candidate> {
    let look = |(index, place): (usize, &DVec3)| {
        Candidate::look_around(path, path.frame().to_trace(*place), directions, index as u64)
    };
    places.par_iter().enumerate().filter_map(look).collect()
}

/// About `places` places: the middles of like cells that fill the box.
fn lattice((min, max): (DVec3, DVec3), places: usize) -> Vec<DVec3> {
    let size = (max - min).max(DVec3::splat(1e-3 * (max - min).max_element()));
    let spacing = (size.element_product() / places as f64).cbrt();
    let counts = (size / spacing).round().max(DVec3::ONE).as_uvec3();
    let cell = (max - min) / counts.as_dvec3();
    let place = |x, y, z| min + (UVec3::new(x, y, z).as_dvec3() + 0.5) * cell;
    let columns = (0..counts.z).flat_map(|z| (0..counts.y).map(move |y| (y, z)));
    columns.flat_map(|(y, z)| (0..counts.x).map(move |x| place(x, y, z))).collect()
}

/// A place that a probe could have.
struct Candidate {
    /// Trace space.
    position: Vec3,
    /// What it sees.
    hits: Vec<Hit>,
}

impl Candidate {
    /// `None` in a solid.
    fn look_around(path: &Path, position: Vec3, directions: &[Vec3], index: u64) -> Option<Candidate> {
        let hits: Vec<Hit> = directions.iter().filter_map(|direction| path.surface(position, *direction)).collect();
        let backs = hits.iter().filter(|hit| path.is_inside(hit)).count();
        let free = backs as f64 <= MOST_BACKS * directions.len() as f64;
        (free && !is_dark_solid(path, position, directions, index)).then_some(Candidate { position, hits })
    }

    /// What a surface point gains by a probe here: 0 where it does not see it, a half where it barely does, 1 where it
    /// resolves it well. Resolution is pixels per unit of surface, cosθ/d², against those at `enough` straight ahead; its
    /// fourth root, because a wall seen at a tenth of the resolution is not ten times as bad.
    fn quality(&self, path: &Path, point: &Hit, enough: f32) -> f32 {
        let line = self.position - point.position;
        let squared = line.length_squared();
        let resolution = line.dot(point.normal) / squared.sqrt() * enough * enough / squared;
        if resolution > 0.0 && path.sees(point, self.position) {
            0.5 + 0.5 * resolution.min(1.0).sqrt().sqrt()
        } else {
            0.0
        }
    }
}

/// No light, and backs around, single-sided or not.
fn is_dark_solid(path: &Path, position: Vec3, directions: &[Vec3], index: u64) -> bool {
    let mut context = PathContext::new(Stream::new(Sampler::Sobol, 0, streams::CANDIDATES | index, 0));
    let lit = directions.iter().zip(0..).any(|(direction, sample)| {
        context.sample = sample;
        path.radiance(position, *direction, &mut context).value != Vec3::ZERO
    });
    !lit && context.backs as f64 > SOLID_BACKS * directions.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lattice_fills_the_box_with_like_cells() {
        let places = lattice((DVec3::ZERO, DVec3::new(10.0, 10.0, 10.0)), 1000);
        assert_eq!(places.len(), 1000);
        assert_eq!(places[0], DVec3::splat(0.5));
        let flat = lattice((DVec3::ZERO, DVec3::new(10.0, 0.0, 10.0)), 1000);
        assert!(flat.len() > 500 && flat.iter().all(|p| p.y == 0.0), "{}", flat.len());
        assert_eq!(lattice((DVec3::ONE, DVec3::ONE), 1000), [DVec3::ONE]);
    }
}
