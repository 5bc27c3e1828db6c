//! Emissive triangles as lights: which, how strong, and points on them.
//!
//! A triangle is drawn by its power (area × mean emitted radiance), a point on it uniformly. Based on: Pharr, Jakob,
//! Humphreys, "Physically Based Rendering", 4th ed., 2023, §12.6 (power light sampler) and §6.5.4. Only what is
//! brighter than [`BRIGHT`] times the level's mean is drawn: a level that glows all over (unlit materials) is found by
//! any ray, and its whole geometry as a list of lights would cost more than it saves.

use glam::{Vec2, Vec3};

use crate::scene::Scene;
use crate::trace::{Surfaces, Tree};

/// How many times the area-weighted mean emitted radiance of all surfaces a triangle must exceed to be drawn.
const BRIGHT: f32 = 4.0;
/// Places along an edge where a textured triangle's emission is looked up for its mean.
const TAPS: u32 = 8;

/// A triangle that is drawn.
#[derive(Debug, Clone, Copy)]
struct Emitter {
    corners: [Vec3; 3],
    /// Index into the surfaces it was found in.
    triangle: u32,
    /// Probability of the triangle over its area, per square trace unit.
    density: f32,
}

/// The emissive triangles of some surfaces.
#[derive(Debug)]
pub(super) struct Emitters {
    emitters: Vec<Emitter>,
    /// `cumulative[i]`: share of the power of the emitters up to `i`; the last is 1.
    cumulative: Vec<f64>,
    tree: Tree,
}

/// A point that was drawn.
#[derive(Debug, Clone, Copy)]
pub(super) struct EmitterPoint {
    /// Trace position.
    pub position: Vec3,
    /// Unit normal of the front.
    pub normal: Vec3,
    /// Triangle in the surfaces.
    pub triangle: u32,
    /// Weights of corners 1 and 2.
    pub barycentric: Vec2,
    /// Probability density per square trace unit.
    pub density: f32,
}

impl Emitters {
    /// The bright triangles of `all` (several sets of surfaces of one scene); `None` if there are none. Triangle indices
    /// are those of their own set.
    pub fn new(scene: &Scene, all: &[&Surfaces]) -> Option<Emitters> {
        let (mut area, mut power) = (0.0, 0.0);
        let mut glowing = Vec::new();
        for surfaces in all {
            for triangle in 0..surfaces.len() as u32 {
                let corners = *surfaces.corners(triangle);
                let own_area = f64::from(area_of(&corners));
                area += own_area;
                if surfaces.material(scene, triangle).emission == Vec3::ZERO {
                    continue;
                }
                let radiance = mean_emission(scene, surfaces, triangle);
                power += own_area * f64::from(radiance);
                glowing.push((corners, triangle, radiance, own_area));
            }
        }
        let limit = f64::from(BRIGHT) * power / area;
        glowing.retain(|&(_, _, radiance, area)| f64::from(radiance) > limit && area > 0.0);
        let total: f64 = glowing.iter().map(|&(_, _, radiance, area)| f64::from(radiance) * area).sum();
        if !(total > 0.0 && total.is_finite()) {
            return None;
        }
        let mut sum = 0.0;
        let mut cumulative = Vec::with_capacity(glowing.len());
        let emitters: Vec<Emitter> = glowing
            .into_iter()
            .map(|(corners, triangle, radiance, area)| {
                sum += f64::from(radiance) * area;
                cumulative.push(sum / total);
                Emitter { corners, triangle, density: (f64::from(radiance) / total) as f32 }
            })
            .collect();
        let corners: Vec<[Vec3; 3]> = emitters.iter().map(|e| e.corners).collect();
        Some(Emitters { tree: Tree::build(&corners), emitters, cumulative })
    }

    /// How many.
    pub fn len(&self) -> usize {
        self.emitters.len()
    }

    /// Per triangle of the surfaces (there must be one set): the probability per square trace unit with which
    /// [`Emitters::draw`] returns a point of it; 0 where it never does.
    pub fn densities(&self, surfaces: &Surfaces) -> Vec<f32> {
        let mut densities = vec![0.0; surfaces.len()];
        for emitter in &self.emitters {
            densities[emitter.triangle as usize] = emitter.density;
        }
        densities
    }

    /// A point for a point of the unit square.
    pub fn draw(&self, [first, second]: [f32; 2]) -> EmitterPoint {
        self.draw_indexed([first, second]).1
    }

    fn draw_indexed(&self, [first, second]: [f32; 2]) -> (usize, EmitterPoint) {
        // The triangle; what is left of the number goes on.
        let first = f64::from(first);
        let index = self.cumulative.partition_point(|&c| c <= first).min(self.emitters.len() - 1);
        let start = if index == 0 { 0.0 } else { self.cumulative[index - 1] };
        let first = ((first - start) / (self.cumulative[index] - start)).clamp(0.0, 1.0) as f32;
        // Uniform over a triangle: (1 - √ξ1, ξ2 √ξ1) (Turk, "Generating Random Points in Triangles", 1990).
        let root = first.sqrt();
        let barycentric = Vec2::new(1.0 - root, second * root);
        let emitter = &self.emitters[index];
        let [a, b, c] = emitter.corners;
        let point = EmitterPoint {
            position: a * (1.0 - barycentric.x - barycentric.y) + b * barycentric.x + c * barycentric.y,
            normal: normal_of(&emitter.corners),
            triangle: emitter.triangle,
            barycentric,
            density: emitter.density,
        };
        (index, point)
    }

    /// A direction from `origin` toward an emitter, and the density per steradian of all that lie along it, hidden ones
    /// too.
    pub fn sample_direction(&self, origin: Vec3, point: [f32; 2]) -> (Vec3, f32) {
        let (index, drawn) = self.draw_indexed(point);
        let Some(direction) = (drawn.position - origin).try_normalize() else { return (drawn.normal, 0.0) };
        // Its own share is computed, not traced: a point on its edge may be missed by rounding.
        let own = solid_angle_density(drawn.density, drawn.position - origin, drawn.normal);
        (direction, own + self.direction_density(origin, direction, Some(index as u32)))
    }

    /// Density per steradian with which [`Emitters::sample_direction`] returns `direction`.
    pub fn density(&self, origin: Vec3, direction: Vec3) -> f32 {
        self.direction_density(origin, direction, None)
    }

    fn direction_density(&self, origin: Vec3, direction: Vec3, except: Option<u32>) -> f32 {
        let mut sum = 0.0;
        self.tree.any(origin, direction, 0.0, f32::INFINITY, |hit| {
            if Some(hit.triangle) != except {
                let emitter = &self.emitters[hit.triangle as usize];
                sum += solid_angle_density(emitter.density, direction * hit.t, normal_of(&emitter.corners));
            }
            true
        });
        sum
    }
}

/// Per area → per solid angle: p d² / cosθ. `line`: from the observer to the point.
pub(super) fn solid_angle_density(density: f32, line: Vec3, normal: Vec3) -> f32 {
    let squared = line.length_squared();
    let cosine = line.dot(normal).abs() / squared.sqrt();
    if squared == 0.0 { 0.0 } else { density * squared / cosine }
}

/// Mean over a triangle of the mean of R, G and B that its front emits.
fn mean_emission(scene: &Scene, surfaces: &Surfaces, triangle: u32) -> f32 {
    if surfaces.material(scene, triangle).emission_texture.is_none() {
        return surfaces.emission(scene, &surfaces.point(triangle, Vec2::splat(1.0 / 3.0), false)).element_sum() / 3.0;
    }
    let (mut sum, mut count) = (0.0, 0.0);
    for j in 0..TAPS {
        for i in 0..TAPS - j {
            let place = (Vec2::new(i as f32, j as f32) + 1.0 / 3.0) / TAPS as f32;
            sum += surfaces.emission(scene, &surfaces.point(triangle, place, false)).element_sum() / 3.0;
            count += 1.0;
        }
    }
    sum / count
}

fn area_of([a, b, c]: &[Vec3; 3]) -> f32 {
    0.5 * (b - a).cross(c - a).length()
}

fn normal_of([a, b, c]: &[Vec3; 3]) -> Vec3 {
    (b - a).cross(c - a).normalize_or(Vec3::Y)
}
