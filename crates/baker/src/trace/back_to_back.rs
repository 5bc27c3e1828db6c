//! Faces back to back: triangles in one plane with opposite fronts that cover the same place, as the two skins of a wall
//! have them. The face whose front the ray meets is the one that counts, whichever of the two rounding puts first.
//!
//! A hit on a front is final. A hit on a back asks whether its triangle has a twin at all, which is found once per
//! triangle, at its first hit; only then is the front looked for, by a ray a few ulps long. So rays that meet fronts, and
//! levels without such faces, pay for the look at one byte.

use super::node::{Node, WIDTH};
use super::triangle::TreeHit;
use super::{Hit, Surfaces, geometric_normal, off_surface};
use crate::scene::Scene;
use glam::Vec3;

/// Normals of faces back to back are at least this much opposed: the cosine.
const OPPOSED: f32 = -0.99;
/// Two surfaces are in one place within so many steps off a surface.
const STEPS: f32 = 2.0;

impl Surfaces {
    /// Some triangle may lie back to back with this one.
    #[inline]
    pub(super) fn has_twin(&self, triangle: u32) -> bool {
        self.twins.has(triangle, || self.find_twin(triangle))
    }

    #[cold]
    fn find_twin(&self, triangle: u32) -> bool {
        let corners = &self.corners[triangle as usize];
        let margin = Vec3::splat(tolerance(corners));
        let (min, max) = corners.iter().fold((Vec3::MAX, Vec3::MIN), |(min, max), c| (min.min(*c), max.max(*c)));
        let (min, max) = (min - margin, max + margin);
        let reaches = |node: &Node| {
            let overlaps = |slot: &usize| {
                (0..3).all(|axis| node.bounds[axis][0][*slot] <= max[axis] && node.bounds[axis][1][*slot] >= min[axis])
            };
            (0..WIDTH).filter(overlaps).fold(0, |bits, slot| bits | 1 << slot)
        };
        !self.tree.all_in(reaches, |other| !self.are_back_to_back(triangle, other))
    }

    /// Two triangles lie in one plane, their fronts on opposite sides.
    pub(super) fn are_back_to_back(&self, a: u32, b: u32) -> bool {
        let [a, b] = [a, b].map(|triangle| &self.corners[triangle as usize]);
        let [front_a, front_b] = [a, b].map(geometric_normal);
        let margin = tolerance(a).max(tolerance(b));
        let lies_in = |corners: &[Vec3; 3], point: Vec3, normal: Vec3| {
            corners.iter().all(|corner| (*corner - point).dot(normal).abs() <= margin)
        };
        front_a.dot(front_b) < OPPOSED && (lies_in(b, a[0], front_a) || lies_in(a, b[0], front_b))
    }

    /// The front in the place where a ray met a back, of several that of the lowest index, and its opacity.
    #[cold]
    pub(super) fn front_at(
        &self,
        scene: &Scene,
        origin: Vec3,
        direction: Vec3,
        back: &TreeHit,
    ) -> Option<(TreeHit, f32)> {
        let corners = &self.corners[back.triangle as usize];
        // Along the ray, planes are farther apart the more it grazes them.
        let slope = geometric_normal(corners).dot(direction).abs().max(1e-3 * direction.length());
        let slack = tolerance(corners) / slope;
        let mut front: Option<(TreeHit, f32)> = None;
        self.tree.any(origin, direction, (back.t - slack).max(0.0), back.t + slack, |hit| {
            let first = front.is_none_or(|(front, _)| hit.triangle < front.triangle);
            let faces = geometric_normal(&self.corners[hit.triangle as usize]).dot(direction) < 0.0;
            if first && faces && self.are_back_to_back(back.triangle, hit.triangle) {
                let opacity = self.counting_opacity(scene, hit, direction);
                front = opacity.map(|opacity| (*hit, opacity)).or(front);
            }
            true
        });
        front
    }
}

/// The distance within which a triangle and another are in one place.
fn tolerance(corners: &[Vec3; 3]) -> f32 {
    STEPS * off_surface(corners.iter().fold(Vec3::ZERO, |largest, corner| largest.max(corner.abs())))
}

/// How far along a ray another surface may lie that counts before this one: a front as far as this back.
pub(crate) fn search_limit(hit: &Hit, direction: Vec3) -> f32 {
    if !hit.back {
        return hit.t;
    }
    let slope = hit.normal.dot(direction).abs().max(1e-3 * direction.length());
    hit.t + STEPS * off_surface(hit.position) / slope
}

/// Of two hits of one ray, on different surfaces, the new one counts before the old: it is nearer, or in one place with it
/// and the only front.
pub(crate) fn counts_before(new: &Hit, old: &Hit) -> bool {
    let in_one_place = || {
        let apart = old.normal.dot(new.position - old.position).abs();
        old.normal.dot(new.normal) > -OPPOSED && apart <= STEPS * off_surface(old.position)
    };
    if new.back != old.back && in_one_place() { old.back } else { new.t < old.t }
}
