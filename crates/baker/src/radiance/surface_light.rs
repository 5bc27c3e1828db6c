//! The light that probes show of a surface, remembered where many rays will ask for it.
//!
//! By a rule that does not look at the node ([`BlendRule::is_seamless`](super::blend::BlendRule::is_seamless)) the blended
//! radiance of a surface point is the same for all who see it. So it is found once per *knot* of a lattice over each side
//! of a triangle, and interpolated between the three knots around a hit, which costs the same however many probes there
//! are. Knots stand at most a pixel of the best probe apart, and are found when first asked for, by nothing but their
//! place: the result does not depend on who asks first.
//!
//! Where the three differ (the edge of a shadow or of a probe's view, a lamp, one knot that no probe sees), the hit is
//! asked for itself, so nothing is smeared over an edge.

use glam::{Vec2, Vec3};
use std::sync::OnceLock;

use super::Radiance;
use super::gdibl::PlacedProbe;
use crate::trace::{Hit, Surfaces};

/// Rays per knot under which remembering does not pay: a knot costs what a ray asks for that finds it anew. Retuned by
/// `tools/bake_bench`.
const RAYS_PER_KNOT: f64 = 2.0;
/// Knots stand so many pixels of the best probe apart. With 45 captured probes, 1000 nodes of the box differed by 0.04 % from
/// light found anew (the bake is sure to 0.9 %), with 8.6 rays per direction of 27.9; at 1 by 0.08 %, with 3.8. The rays are
/// those that find knots: for 8000 nodes 2.1 are left (`tools/bake_bench`).
const FINEST: f32 = 0.5;
/// Where rays are too few for that, up to so many: noise hides what is lost.
const COARSEST: f32 = 1.0;
/// Knots at most, by area, of all front sides; of all back sides as many again. 80 MB each.
const MOST_KNOTS: f64 = (4 << 20) as f64;
/// The three knots agree when none differs from their mean by more than this share of it. Half: the same rays and difference,
/// within 1 %.
const AGREEMENT: f32 = 0.25;
/// Knots lie in their triangle by this share of a cell, off the surfaces that meet at its edges.
const INSET: f32 = 0.05;

/// Knots of one side of a triangle, made when it is first hit.
type Side = OnceLock<Box<[OnceLock<Radiance>]>>;

/// Remembered radiance of every environment triangle that is worth it.
#[derive(Debug)]
pub struct SurfaceLight {
    /// Cells along each edge of a triangle; 0: its light is not remembered.
    cuts: Vec<[u16; 2]>,
    sides: Vec<[Side; 2]>,
}

impl SurfaceLight {
    /// Nothing is found yet. `rays` will ask, all together; they fall on surfaces by area, about. `None` where no triangle
    /// is worth it.
    pub fn new(environment: &Surfaces, probes: &[PlacedProbe], rays: u64) -> Option<SurfaceLight> {
        let triangles = 0..environment.len() as u32;
        let total: f64 = triangles.clone().map(|t| f64::from(area(environment.corners(t)))).sum();
        let most = (rays as f64 / RAYS_PER_KNOT).min(MOST_KNOTS) / total.max(f64::MIN_POSITIVE);
        let cuts = |triangle| {
            let corners = environment.corners(triangle);
            let most = most * f64::from(area(corners));
            [false, true].map(|back| {
                let normal = environment.point(triangle, Vec2::ZERO, back).normal;
                // Fewer than one cell needs are too few, whatever the probes.
                if most < 3.0 { 0 } else { cuts(corners, finest_pixel(corners, normal, probes), most) }
            })
        };
        let cuts: Vec<_> = triangles.clone().map(cuts).collect();
        let any = cuts.iter().any(|sides| *sides != [0, 0]);
        any.then(|| SurfaceLight { cuts, sides: triangles.map(|_| Default::default()).collect() })
    }

    /// Triangles whose light is remembered, on one side or both.
    pub fn triangle_count(&self) -> usize {
        self.cuts.iter().filter(|sides| **sides != [0, 0]).count()
    }

    /// Radiance at `hit`: interpolated, or `None` where it has to be found for the hit itself. `find` does it for a knot.
    pub fn lookup(
        &self,
        environment: &Surfaces,
        hit: &Hit,
        mut find: impl FnMut(&Hit) -> Radiance,
    ) -> Option<Radiance> {
        let cuts = u32::from(self.cuts[hit.triangle as usize][usize::from(hit.back)]);
        if cuts == 0 {
            return None;
        }
        let side = &self.sides[hit.triangle as usize][usize::from(hit.back)];
        let knots = side.get_or_init(|| (0..knot_count(cuts)).map(|_| OnceLock::new()).collect());
        let around = knots_around(hit.barycentric, cuts);
        let found = around.map(|(i, j, _)| {
            *knots[knot_number(i, j)]
                .get_or_init(|| find(&environment.point(hit.triangle, place(i, j, cuts), hit.back)))
        });
        let mean = (found[0].value + found[1].value + found[2].value) / 3.0;
        let agree = found.iter().all(|knot| {
            knot.coverage == found[0].coverage
                && (knot.value - mean).abs().max_element() <= AGREEMENT * mean.max_element()
        });
        agree.then(|| {
            let value = around.iter().zip(&found).fold(Vec3::ZERO, |sum, ((_, _, w), knot)| sum + knot.value * *w);
            Radiance { value, coverage: found[0].coverage }
        })
    }
}

fn area([a, b, c]: &[Vec3; 3]) -> f32 {
    (b - a).cross(c - a).length() / 2.0
}

/// Edge of the smallest patch, trace units, that a pixel of some probe covers on a triangle: pixels per area are
/// N cosθ / 4π d², of the probe's nearest point.
fn finest_pixel(corners: &[Vec3; 3], normal: Vec3, probes: &[PlacedProbe]) -> f32 {
    let density = |probe: &PlacedProbe| {
        let height = normal.dot(probe.position - corners[0]);
        let distance = nearest_point(corners, probe.position).distance(probe.position).max(height);
        if height > 0.0 { probe.pixels * height / distance.powi(3) } else { 0.0 }
    };
    let densest = probes.iter().map(density).fold(0.0, f32::max);
    (4.0 * std::f32::consts::PI / densest).sqrt()
}

/// Of a triangle. Based on: Ericson, "Real-Time Collision Detection", 2005, §5.1.5.
fn nearest_point(&[a, b, c]: &[Vec3; 3], p: Vec3) -> Vec3 {
    let (ab, ac) = (b - a, c - a);
    let (d1, d2) = (ab.dot(p - a), ac.dot(p - a));
    let (d3, d4) = (ab.dot(p - b), ac.dot(p - b));
    let (d5, d6) = (ab.dot(p - c), ac.dot(p - c));
    let (va, vb, vc) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    let along = |from: Vec3, edge: Vec3| {
        let length = edge.length_squared();
        if length > 0.0 { from + edge * ((p - from).dot(edge) / length).clamp(0.0, 1.0) } else { from }
    };
    if va > 0.0 && vb > 0.0 && vc > 0.0 {
        let sum = va + vb + vc;
        return a + ab * (vb / sum) + ac * (vc / sum);
    }
    let near = |x: &Vec3| x.distance_squared(p);
    [along(a, ab), along(b, c - b), along(a, ac)]
        .into_iter()
        .min_by(|x, y| near(x).total_cmp(&near(y)))
        .expect("three edges")
}

/// Cells along an edge for at most `most` knots; 0: they would stand too far apart, or no probe sees the triangle.
fn cuts(&[a, b, c]: &[Vec3; 3], pixel: f32, most: f64) -> u16 {
    let longest = (b - a).length().max((c - b).length()).max((a - c).length());
    let finest = (longest / (pixel * FINEST)).ceil().clamp(1.0, f32::from(u16::MAX));
    // Knots: (cells + 1)(cells + 2) / 2.
    let affordable = ((0.25 + 2.0 * most).sqrt() - 1.5).floor() as f32;
    let cells = finest.min(affordable);
    if pixel.is_finite() && longest <= cells * pixel * COARSEST { cells as u16 } else { 0 }
}

/// Knot (i, j) of a triangle stands at v = i / cuts, w = j / cuts; they are numbered by diagonals i + j.
fn knot_number(i: u32, j: u32) -> usize {
    let diagonal = (i + j) as usize;
    diagonal * (diagonal + 1) / 2 + j as usize
}

fn knot_count(cuts: u32) -> usize {
    knot_number(0, cuts) + 1
}

/// Barycentric place of a knot, drawn in from the edges.
fn place(i: u32, j: u32, cuts: u32) -> Vec2 {
    let at = Vec2::new(i as f32, j as f32) / cuts as f32;
    at + (Vec2::splat(1.0 / 3.0) - at) * (INSET / cuts as f32)
}

/// The three knots around a place, with weights that sum to 1.
fn knots_around(barycentric: Vec2, cuts: u32) -> [(u32, u32, f32); 3] {
    let scaled = barycentric.clamp(Vec2::ZERO, Vec2::ONE) * cuts as f32;
    let i = (scaled.x as u32).min(cuts - 1);
    let j = (scaled.y as u32).min(cuts - 1 - i);
    let (x, y) = (scaled.x - i as f32, scaled.y - j as f32);
    if x + y <= 1.0 || i + j + 1 >= cuts {
        let x = x.min(1.0);
        let y = y.min(1.0 - x);
        [(i, j, 1.0 - x - y), (i + 1, j, x), (i, j + 1, y)]
    } else {
        let (x, y) = (x.min(1.0), y.min(1.0));
        [(i + 1, j + 1, x + y - 1.0), (i, j + 1, 1.0 - x), (i + 1, j, 1.0 - y)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{Sampler, Stream};

    #[test]
    fn interpolation_is_exact_for_linear_light_and_weights_sum_to_one() {
        let stream = Stream::new(Sampler::Sobol, 0, 0, 0);
        for cuts in [1, 2, 3, 7, 100] {
            let mut numbers = std::collections::BTreeSet::new();
            for sample in 0..20_000 {
                let [a, b] = stream.point(sample, 0);
                let at = if a + b > 1.0 { Vec2::new(1.0 - a, 1.0 - b) } else { Vec2::new(a, b) };
                let around = knots_around(at, cuts);
                let sum = around.iter().fold(Vec2::ZERO, |sum, &(i, j, w)| {
                    assert!(i + j <= cuts, "{i} {j} of {cuts}");
                    assert!((-1e-5..=1.0 + 1e-5).contains(&w), "{w}");
                    numbers.insert(knot_number(i, j));
                    sum + Vec2::new(i as f32, j as f32) / cuts as f32 * w
                });
                assert!((sum - at).length() < 1e-5, "{at} {sum}");
                assert!((around.iter().map(|k| k.2).sum::<f32>() - 1.0).abs() < 1e-5);
            }
            assert!(numbers.iter().all(|n| *n < knot_count(cuts)));
            assert!(cuts > 50 || numbers.len() == knot_count(cuts), "every knot has its number");
        }
    }

    #[test]
    fn nearest_point_is_no_farther_than_any_other() {
        let stream = Stream::new(Sampler::Sobol, 1, 0, 0);
        let corners = [Vec3::new(0.0, 0.0, 0.0), Vec3::new(2.0, 0.0, 0.0), Vec3::new(0.3, 1.0, 0.0)];
        for sample in 0..500 {
            let ([x, y], [z, _]) = (stream.point(sample, 0), stream.point(sample, 1));
            let p = Vec3::new(x, y, z) * 6.0 - 3.0;
            let nearest = nearest_point(&corners, p).distance(p);
            for other in 0..500 {
                let [a, b] = stream.point(other, 2);
                let (v, w) = if a + b > 1.0 { (1.0 - a, 1.0 - b) } else { (a, b) };
                let there = corners[0] * (1.0 - v - w) + corners[1] * v + corners[2] * w;
                assert!(nearest <= there.distance(p) + 1e-5, "{p}");
            }
        }
    }
}
