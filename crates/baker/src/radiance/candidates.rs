//! Which probes can lend light to a patch of surface, and which of them see all of it, so that what a point of it costs does
//! not grow with the number of probes.
//!
//! Left out are probes that see nothing of the patch, and those that are [too faint](super::blend::FAINT) anywhere on it beside
//! one that sees all of it; of that one no line of sight is asked. All this is proven, by
//! [bounds of merit](BlendRule::merit_bounds) and by [shafts](Surfaces::sight): radiance is what it is by all probes.

use glam::Vec3;

use super::blend::BlendRule;
use super::probe::PlacedProbe;
use crate::scene::Scene;
use crate::trace::{Sight, Surfaces, nearest_point};

/// Bounds of merit are wider by this share, for rounding.
const ROUNDING: f32 = 1e-3;

/// A probe that may lend light.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Candidate {
    /// Which.
    pub probe: u32,
    /// It sees all of what is asked about: no line of sight needs tracing.
    pub sees_all: bool,
}

/// Memory for the candidates of one surface point, reused from ray to ray.
#[derive(Debug, Default)]
pub struct Scratch {
    /// Probes on the right side of the surface, best first.
    pub candidates: Vec<(f32, Candidate)>,
    /// Of the probes that see it, best first.
    pub merits: Vec<f32>,
    /// What those show there, and the share of the line to each that is clear.
    pub seen: Vec<(Vec3, f32)>,
    /// How they share the point.
    pub weights: Vec<f32>,
}

/// A part of one side of a triangle.
#[derive(Debug, Clone, Copy)]
pub struct Place<'a> {
    /// Trace positions.
    pub corners: &'a [Vec3; 3],
    /// Unit, of the side.
    pub normal: Vec3,
    /// Whose part it is.
    pub triangle: u32,
}

/// Who looks at what.
#[derive(Debug, Clone, Copy)]
pub struct Lookers<'a> {
    /// The level.
    pub scene: &'a Scene,
    /// Its environment geometry.
    pub environment: &'a Surfaces,
    /// All probes.
    pub probes: &'a [PlacedProbe],
    /// How they share a point.
    pub blend: BlendRule,
    /// A probe sees a point finely enough if its pixel covers a square of at most this edge there, trace units.
    pub coarsest: f32,
}

/// Edge of the square that a pixel of a probe covers on a surface `height` under the probe, trace units: pixels per area are
/// N cosθ / 4π d², and cosθ is height / d.
pub fn pixel_size(pixels: f32, height: f32, distance: f32) -> f32 {
    (4.0 * std::f32::consts::PI * distance.powi(3) / (pixels * height)).sqrt()
}

impl Lookers<'_> {
    /// Those among `all` that may lend light to a place. Counts what it traces in `rays`.
    pub fn candidates(&self, all: &[Candidate], place: &Place, rays: &mut u64) -> Box<[Candidate]> {
        let bounds = |candidate: &Candidate| {
            let probe = &self.probes[candidate.probe as usize];
            let height = place.normal.dot(probe.position - place.corners[0]);
            let nearest = nearest_point(place.corners, probe.position).distance(probe.position);
            let farthest = place.corners.iter().map(|corner| corner.distance(probe.position)).fold(0.0, f32::max);
            // Close to the plane of the triangle, rounding may lift it over one point and not over another.
            let is_before = height > -ROUNDING * farthest;
            let bounds = |height: f32| self.blend.merit_bounds(probe.pixels, height.max(0.0), [nearest, farthest]);
            let ([least, _], [_, most]) = (bounds(height - ROUNDING * farthest), bounds(height + ROUNDING * farthest));
            // Who sees a part of the place too coarsely lets no other be left out.
            let is_fine = pixel_size(probe.pixels, (height - ROUNDING * farthest).max(0.0), farthest) <= self.coarsest;
            let least = if is_fine { least * (1.0 - ROUNDING) } else { 0.0 };
            is_before.then_some(([least, most * (1.0 + ROUNDING)], *candidate))
        };
        let mut open: Vec<([f32; 2], Candidate)> = all.iter().filter_map(bounds).collect();
        open.sort_by(|a, b| b.0[1].total_cmp(&a.0[1]));
        // Everywhere on the place some probe that sees it is at least so good.
        let mut best = 0.0f32;
        let mut kept: Vec<(f32, Candidate)> = Vec::new();
        for ([least, most], candidate) in open {
            if self.blend.ratio(most, best) == 0.0 {
                break;
            }
            let sight = match candidate.sees_all {
                true => Sight::Whole,
                false => {
                    *rays += 1;
                    let position = self.probes[candidate.probe as usize].position;
                    self.environment.sight(self.scene, position, place.corners, place.triangle)
                }
            };
            match sight {
                Sight::Hidden => continue,
                Sight::Whole => best = best.max(least),
                Sight::Mixed => {}
            }
            kept.push((most, Candidate { sees_all: sight == Sight::Whole, ..candidate }));
        }
        kept.iter().filter(|(most, _)| self.blend.ratio(*most, best) > 0.0).map(|(_, candidate)| *candidate).collect()
    }

    /// Edge of the smallest square, trace units, that a pixel of one of these probes covers on a place: pixels per area are
    /// N cosθ / 4π d², of its point that is nearest to the probe. Infinite where none stands before it.
    pub fn finest_pixel(&self, candidates: &[Candidate], place: &Place) -> f32 {
        let size = |candidate: &Candidate| {
            let probe = &self.probes[candidate.probe as usize];
            let height = place.normal.dot(probe.position - place.corners[0]);
            let distance = nearest_point(place.corners, probe.position).distance(probe.position).max(height);
            if height > 0.0 { pixel_size(probe.pixels, height, distance) } else { f32::INFINITY }
        };
        candidates.iter().map(size).fold(f32::INFINITY, f32::min)
    }
}
