//! What of a surface a point sees, for a whole triangle of it at once: all of it, nothing, or what lines of sight tell.
//!
//! Lines of sight from a point to a triangle (the *patch*) fill a tetrahedron, the *shaft*:
//!
//! ```text
//!         p
//!        /|\         A triangle that lies outside one of the four faces, or that has the whole shaft on one side,
//!       / | \        blocks no line. If that holds for all, the patch is seen whole. A triangle that the lines to
//!      /  |  \       all three corners cross is crossed by all between them: nothing of the patch is seen.
//!     a---b---c
//! ```
//!
//! Other triangles may miss the shaft all the same: then lines of sight are traced. Based on: Haines and Wallace, "Shaft
//! Culling for Efficient Ray-Traced Radiosity", 1991.

use glam::{DVec3, Vec3};

use super::node::{Node, WIDTH};
use super::{Surfaces, off_surface};
use crate::scene::Scene;

/// What of a patch is seen from a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sight {
    /// All of it, nothing between.
    Whole,
    /// Nothing.
    Hidden,
    /// Unknown: lines of sight differ, or it is not proven that they do not.
    Mixed,
}

/// What a point on the outer side of a plane has: `normal · x > offset`.
#[derive(Debug, Clone, Copy)]
struct Plane {
    /// Unit.
    normal: Vec3,
    offset: f32,
}

/// Between a point and a patch.
#[derive(Debug)]
struct Shaft {
    /// The point, and the corners of the patch.
    ends: [Vec3; 4],
    /// Faces, outward; the first is the patch.
    faces: [Plane; 4],
    min: Vec3,
    max: Vec3,
    /// What reaches into the shaft by less than this, trace units, blocks nothing: neighbours of the patch touch it, and
    /// rays that leave it start off it by as much.
    tolerance: f32,
}

impl Surfaces {
    /// What of a patch on triangle `own` is seen from `point` (trace space), which must lie before it.
    pub fn sight(&self, scene: &Scene, point: Vec3, patch: &[Vec3; 3], own: u32) -> Sight {
        let Some(shaft) = Shaft::new(point, patch) else { return Sight::Mixed };
        let is_free = self.tree.all_in(
            |node| shaft.reaches(node),
            |triangle| triangle == own || shaft.is_free_of(&self.corners[triangle as usize]),
        );
        if is_free {
            return Sight::Whole;
        }
        // One that hides the middle may hide all.
        let middle = (patch[0] + patch[1] + patch[2]) / 3.0;
        let mut hidden = false;
        self.tree.any(middle, point - middle, 0.0, 1.0, |hit| {
            hidden = hit.triangle != own
                && !self.material(scene, hit.triangle).is_clear()
                && shaft.is_blocked_by(&self.corners[hit.triangle as usize]);
            !hidden
        });
        if hidden { Sight::Hidden } else { Sight::Mixed }
    }
}

impl Shaft {
    /// `None` where it has no volume, as far as can be told.
    fn new(point: Vec3, patch: &[Vec3; 3]) -> Option<Shaft> {
        let ends = [point, patch[0], patch[1], patch[2]];
        let largest = ends.iter().fold(Vec3::ZERO, |largest, end| largest.max(end.abs()));
        let tolerance = 2.0 * off_surface(largest);
        let face = |corners: [usize; 3], inner: usize| {
            let [a, b, c] = corners.map(|corner| ends[corner].as_dvec3());
            let normal = (b - a).cross(c - a).try_normalize()?;
            let height = normal.dot(ends[inner].as_dvec3() - a);
            let normal = if height > 0.0 { -normal } else { normal };
            (height.abs() > f64::from(tolerance))
                .then(|| Plane { normal: normal.as_vec3(), offset: normal.dot(a) as f32 })
        };
        let faces = [face([1, 2, 3], 0)?, face([0, 1, 2], 3)?, face([0, 2, 3], 1)?, face([0, 3, 1], 2)?];
        let (min, max) = ends.iter().fold((point, point), |(min, max), end| (min.min(*end), max.max(*end)));
        Some(Shaft { ends, faces, min, max, tolerance })
    }

    /// Which children's boxes may lie in it, a bit each.
    fn reaches(&self, node: &Node) -> u32 {
        let mut inside = [true; WIDTH];
        for axis in 0..3 {
            let [low, high] = &node.bounds[axis];
            for ((inside, low), high) in inside.iter_mut().zip(low).zip(high) {
                *inside &= *low <= self.max[axis] && *high >= self.min[axis];
            }
        }
        for face in &self.faces {
            // The innermost corner of each box.
            let side = face.normal.to_array().map(|n| usize::from(n < 0.0));
            for (slot, inside) in inside.iter_mut().enumerate() {
                let along: f32 = (0..3).map(|axis| face.normal[axis] * node.bounds[axis][side[axis]][slot]).sum();
                *inside &= along < face.offset - self.tolerance;
            }
        }
        (0..WIDTH).fold(0, |bits, slot| bits | u32::from(inside[slot]) << slot)
    }

    /// The triangle is proven to block no line.
    fn is_free_of(&self, triangle: &[Vec3; 3]) -> bool {
        let is_outside =
            |face: &Plane| triangle.iter().all(|corner| face.normal.dot(*corner) >= face.offset - self.tolerance);
        if self.faces.iter().any(is_outside) {
            return true;
        }
        let [a, b, c] = triangle.map(|corner| corner.as_dvec3());
        let Some(normal) = (b - a).cross(c - a).try_normalize() else { return false };
        let heights = self.ends.map(|end| normal.dot(end.as_dvec3() - a));
        let tolerance = f64::from(self.tolerance);
        heights.iter().all(|height| *height <= tolerance) || heights.iter().all(|height| *height >= -tolerance)
    }

    /// The triangle is proven to block every line.
    fn is_blocked_by(&self, triangle: &[Vec3; 3]) -> bool {
        let [a, b, c] = triangle.map(|corner| corner.as_dvec3());
        let Some(normal) = (b - a).cross(c - a).try_normalize() else { return false };
        let [point, patch @ ..] = self.ends.map(|end| end.as_dvec3());
        let tolerance = f64::from(self.tolerance);
        let height = normal.dot(point - a);
        patch.iter().all(|corner| {
            let beyond = normal.dot(*corner - a);
            // Well before the point and the patch.
            if height.abs() < tolerance || beyond.abs() < tolerance || (height > 0.0) == (beyond > 0.0) {
                return false;
            }
            let crossing: DVec3 = point + (*corner - point) * (height / (height - beyond));
            let inside = |from: DVec3, to: DVec3| normal.cross(to - from).normalize().dot(crossing - from) > tolerance;
            inside(a, b) && inside(b, c) && inside(c, a)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{Sampler, Stream};
    use crate::scene::Alpha;
    use crate::scene::{Material, Mesh};
    use crate::trace::Frame;
    use glam::Vec2;

    /// A patch at z = 0 under small and large triangles, and points over them.
    fn level(small: u32, large: u32) -> (Scene, Surfaces) {
        let random = |i: u32, pair: u32| {
            let stream = Stream::new(Sampler::Random, 5, u64::from(i), 0);
            let ([x, y], [z, _]) = (stream.point(0, pair), stream.point(1, pair));
            DVec3::new(f64::from(x), f64::from(y), f64::from(z))
        };
        let triangle = |i: u32, size: f64| {
            let middle = random(i, 0) * DVec3::new(4.0, 4.0, 2.0) + DVec3::new(-2.0, -2.0, 0.1);
            [1, 2, 3].map(|pair| middle + (random(i, pair) - 0.5) * size)
        };
        let mut corners = vec![[DVec3::ZERO, DVec3::X, DVec3::Y]];
        corners.extend((0..small).map(|i| triangle(i, 0.2)));
        corners.extend((0..large).map(|i| triangle(1000 + i, 5.0)));
        let mesh = Mesh {
            positions: corners.as_flattened().to_vec(),
            normals: vec![Vec3::Z; 3 * corners.len()],
            triangles: (0..corners.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
            ..Mesh::default()
        };
        let scene = Scene { meshes: vec![mesh], materials: vec![Material::default()], ..Scene::default() };
        let surfaces = Surfaces::new(&scene, |_| true, &Frame::default()).unwrap();
        (scene, surfaces)
    }

    #[test]
    fn what_is_proven_all_lines_of_sight_agree_with() {
        let mut counts = [0; 3];
        for (small, large) in [(0, 0), (3, 0), (30, 0), (0, 1), (0, 3), (20, 2)] {
            let (scene, surfaces) = level(small, large);
            for i in 0..200 {
                let stream = Stream::new(Sampler::Random, 6, i, 0);
                let ([x, y], [z, turn]) = (stream.point(0, 0), stream.point(1, 0));
                let point = Vec3::new(6.0 * x - 3.0, 6.0 * y - 3.0, 0.05 + 3.0 * z);
                let at = |v: f32, w: f32| surfaces.point(0, Vec2::new(v, w), false).position;
                let patch = if turn < 0.5 {
                    [at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0)]
                } else {
                    [at(0.5, 0.5), at(0.0, 0.5), at(0.5, 0.0)]
                };
                let sight = surfaces.sight(&scene, point, &patch, 0);
                counts[sight as usize] += 1;
                let expected = match sight {
                    Sight::Whole => 1.0,
                    Sight::Hidden => 0.0,
                    Sight::Mixed => continue,
                };
                for line in 0..300 {
                    let [a, b] = stream.point(2 + line, 0);
                    let (v, w) = if a + b > 1.0 { (1.0 - a, 1.0 - b) } else { (a, b) };
                    let start = patch[0] * (1.0 - v - w) + patch[1] * v + patch[2] * w + Vec3::Z * 1e-6;
                    let clear = surfaces.transmittance(&scene, start, point, Some(0));
                    assert_eq!(
                        clear,
                        Vec3::splat(expected),
                        "{sight:?} from {point} to {start}, {small} and {large} triangles"
                    );
                }
            }
        }
        assert!(counts.iter().all(|count| *count > 30), "whole, hidden, mixed: {counts:?}");
    }

    #[test]
    fn neighbours_of_a_patch_hide_nothing_of_it_and_clear_surfaces_nothing_for_sure() {
        // A floor of two triangles, a wall on its edge, and a board over all of the floor.
        let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z];
        let quad = |a: DVec3, b: DVec3, c: DVec3, d: DVec3, material: u32| Mesh {
            positions: vec![a, b, c, d],
            normals: vec![Vec3::Z; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            material,
            ..Mesh::default()
        };
        let floor = quad(DVec3::ZERO, x, x + y, y, 0);
        let wall = quad(DVec3::ZERO, y, y + z, z, 0);
        let over = |p: DVec3| p + z * 2.0;
        let board =
            quad(over(x * -9.0 - y * 9.0), over(x * 30.0 - y * 9.0), over(x * 30.0 + y * 30.0), over(y * 30.0), 1);
        for (alpha, above) in [(Alpha::Opaque, Sight::Hidden), (Alpha::Blend, Sight::Mixed)] {
            let scene = Scene {
                meshes: vec![floor.clone(), wall.clone(), board.clone()],
                materials: vec![Material::default(), Material { alpha, ..Material::default() }],
                ..Scene::default()
            };
            let surfaces = Surfaces::new(&scene, |_| true, &Frame::default()).unwrap();
            let of = |point: [f32; 3]| surfaces.sight(&scene, point.into(), surfaces.corners(0), 0);
            assert_eq!(of([0.3, 0.3, 1.5]), Sight::Whole);
            assert_eq!(of([0.01, 0.3, 0.5]), Sight::Whole, "close to the wall");
            assert_eq!(of([4.0, 2.0, 3.0]), above);
            assert_eq!(of([-1.0, 0.5, 0.5]), Sight::Mixed, "behind the wall, of two triangles");
        }
    }
}
