//! What a level's free space sees: places all over it that stand in no solid, and what lies around them. They stand for the
//! nodes of any bake: every place counts alike, and so does every direction from it.

use glam::{DVec3, UVec3, Vec3};
use rayon::prelude::*;

use crate::radiance::path::Path;
use crate::radiance::{PathContext, RadianceFunction, SOLID_BACKS};
use crate::sampling::{Sampler, Stream, fibonacci_sphere, streams, uniform_sphere};
use crate::trace::Hit;
use crate::{Control, Interrupted};

/// Places wanted, about.
pub const FREE_PLACES: usize = 2000;
/// Places tried for them at most: of a level with much rock few are free.
const MOST_TRIED: usize = 32_000;
/// Directions in which a place looks around to know whether it is free.
const LOOKS: usize = 64;
/// A place that sees more backs of single-sided triangles than this share stands in a solid or outside.
const MOST_BACKS: f64 = 0.1;

/// Free places of a level.
#[derive(Debug, Clone, Default)]
pub struct FreeSpace {
    /// Trace positions.
    pub places: Vec<Vec3>,
    /// Distance between neighbours, about, trace units.
    pub spacing: f32,
}

/// A ray from a free place.
#[derive(Debug, Clone, Copy)]
pub struct Sight {
    /// Unit.
    pub direction: Vec3,
    /// The surface it ends at, turned to face the place; `None`: it escapes.
    pub hit: Option<Hit>,
}

/// Whether each of the `positions` (world metres) stands in free space, as placing probes and coverage mean it: it sees hardly
/// any backs of single-sided triangles, and light, or else fronts.
pub fn are_free(path: &Path, positions: &[DVec3]) -> Vec<bool> {
    let looker = Looker::new(path);
    let is_free = |(index, position): (usize, &DVec3)| looker.is_free(path.frame().to_trace(*position), index as u64);
    positions.par_iter().enumerate().map(is_free).collect()
}

impl FreeSpace {
    /// The free places of a box, world metres.
    pub fn find(looker: &Looker, bounds: (DVec3, DVec3), control: &Control) -> Result<FreeSpace, Interrupted> {
        let frame = looker.path.frame();
        let mut tried = FREE_PLACES;
        loop {
            let (places, spacing) = strata(bounds, tried);
            let spacing = (spacing * frame.scale) as f32;
            let is_free = |(index, place): (usize, &DVec3)| {
                let place = frame.to_trace(*place);
                let is_free = control.go_on().map(|()| looker.is_free(place, index as u64));
                (control.progress)(0, LOOKS as u64);
                is_free.map(|is_free| is_free.then_some(place)).transpose()
            };
            let places: Vec<Vec3> = places.par_iter().enumerate().filter_map(is_free).collect::<Result<_, _>>()?;
            if places.len() >= FREE_PLACES / 2 || tried >= MOST_TRIED {
                return Ok(FreeSpace { places, spacing });
            }
            // Of rock all through, a sixteenth at least.
            tried = (tried * FREE_PLACES / places.len().max(FREE_PLACES / 16)).min(MOST_TRIED);
        }
    }

    /// What the places see, in so many directions each, by place.
    pub fn sights(&self, path: &Path, directions: u32, control: &Control) -> Result<Vec<Sight>, Interrupted> {
        let look = |(index, place): (usize, &Vec3)| {
            control.go_on()?;
            let stream = Stream::new(Sampler::Sobol, 0, streams::CANDIDATES | index as u64, 1);
            let sight = |sample| {
                let direction = uniform_sphere(stream.point(sample, 0));
                Sight { direction, hit: path.surface(*place, direction) }
            };
            let sights: Vec<Sight> = (0..directions).map(sight).collect();
            (control.progress)(0, u64::from(directions));
            Ok(sights)
        };
        let sights: Vec<Vec<Sight>> = self.places.par_iter().enumerate().map(look).collect::<Result<_, _>>()?;
        Ok(sights.into_iter().flatten().collect())
    }
}

/// Tells places in the open from places in solids.
#[derive(Debug)]
pub struct Looker<'a> {
    /// What it traces.
    pub path: &'a Path<'a>,
    directions: Vec<Vec3>,
}

impl<'a> Looker<'a> {
    /// For what `path` traces.
    pub fn new(path: &'a Path<'a>) -> Looker<'a> {
        Looker { path, directions: fibonacci_sphere(LOOKS) }
    }

    /// Whether a place (trace space) stands in no solid; `index` tells the random numbers of several apart.
    pub fn is_free(&self, place: Vec3, index: u64) -> bool {
        let (mut insides, mut backs) = (0, 0);
        for direction in &self.directions {
            if let Some(hit) = self.path.surface(place, *direction) {
                insides += usize::from(self.path.is_inside(&hit));
                backs += usize::from(hit.back);
                if insides as f64 > MOST_BACKS * LOOKS as f64 {
                    return false;
                }
            }
        }
        // Among fronts no path is traced: in a white level without light all of them would be long.
        backs as f64 <= SOLID_BACKS * LOOKS as f64 || self.is_lit(place, index)
    }

    /// Some light arrives: among backs of double-sided triangles, what tells the outside from the inside.
    fn is_lit(&self, place: Vec3, index: u64) -> bool {
        let mut context = PathContext::new(Stream::new(Sampler::Sobol, 0, streams::CANDIDATES | index, 0));
        self.directions.iter().zip(0..).any(|(direction, sample)| {
            context.sample = sample;
            self.path.radiance(place, *direction, &mut context).value != Vec3::ZERO
        })
    }
}

/// About `places` places, one anywhere in each of as many like cells that fill the box, and the edge of a cell. Not in the
/// middles: a room's share of the places is its share of the box, wherever its walls stand.
fn strata((min, max): (DVec3, DVec3), places: usize) -> (Vec<DVec3>, f64) {
    let size = (max - min).max(DVec3::splat(1e-3 * (max - min).max_element()));
    let spacing = (size.element_product() / places as f64).cbrt();
    let counts = (size / spacing).round().max(DVec3::ONE).as_uvec3();
    let cell = (max - min) / counts.as_dvec3();
    let place = |index: u32| {
        let corner = UVec3::new(index % counts.x, index / counts.x % counts.y, index / counts.x / counts.y);
        let stream = Stream::new(Sampler::Sobol, 0, streams::CANDIDATES | u64::from(index), 2);
        let ([x, y], [z, _]) = (stream.point(0, 0), stream.point(0, 1));
        min + (corner.as_dvec3() + Vec3::new(x, y, z).as_dvec3()) * cell
    };
    ((0..counts.element_product()).map(place).collect(), spacing)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strata_fill_the_box_with_a_place_in_each_cell() {
        let (places, spacing) = strata((DVec3::ZERO, DVec3::splat(10.0)), 1000);
        assert!((spacing - 1.0).abs() < 1e-12);
        let cells: Vec<[f64; 3]> = places.iter().map(|place| place.floor().to_array()).collect();
        let expected: Vec<[f64; 3]> = (0..1000).map(|i| [i % 10, i / 10 % 10, i / 100].map(f64::from)).collect();
        assert_eq!(cells, expected);
        let (flat, _) = strata((DVec3::ZERO, DVec3::new(10.0, 0.0, 10.0)), 1000);
        assert!(flat.len() > 500 && flat.iter().all(|p| p.y == 0.0), "{}", flat.len());
        assert_eq!(strata((DVec3::ONE, DVec3::ONE), 1000).0, [DVec3::ONE]);
    }
}
