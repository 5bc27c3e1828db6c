//! From which points are all surfaces seen whole? From there, no line of sight to a surface needs tracing.
//!
//! Seen from a point, a triangle covers a part of the sphere of directions. Triangles with their backs to the point count
//! negative. If every edge that one triangle goes along forth, another goes along back, the surfaces are closed, and the sum over
//! those that cover a direction is the same for every direction: it changes nowhere, for where one triangle ends another goes
//! on. It is the sum of all solid angles over 4π. Where none counts negative and the sum is one, exactly one
//! triangle covers each direction, and so hides no other: the surfaces are *star-shaped* from the point.
//!
//! ```text
//!   +-----------------+        Surfaces with openings are closed first, by fans over
//!   |        .        |        the directions of their edges. Fans are but another part
//!   |       / \       q        of the sphere: they only have to leave the same sum.
//!   |      /   \      |
//!   +-----+     +-----+        .  one that sees all;  q  the tip of a fan
//! ```
//!
//! The test takes all triangles once, and in most levels a few: the first with its back to the point (any solid that stands in
//! the room has some) ends it. It may miss a point that sees all, but errs about no surface that covers more than
//! [`SLIVER`] there. Solid angles: van Oosterom and Strackee, "The Solid Angle of a Plane Triangle", 1983, equation 8.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use super::{Surfaces, off_surface};

/// Corners are one within about this much, trace units: the step with which rays leave the level's farthest surfaces.
const WELD: f64 = 1.0 / 2048.0;
/// So much may count negative, sr: seams where rounding shifted corners on each other's edges. A pixel of a probe 4096 wide.
const SLIVER: f64 = 1e-6;

/// Directed edges that no triangle goes back along, those of an opening together, each so many times.
type Opening = Vec<([DVec3; 2], f64)>;

impl Surfaces {
    /// Which of these points (trace space) see every triangle whole, nothing between, as far as that can be proven.
    pub fn seen_whole_from(&self, points: &[Vec3]) -> Vec<bool> {
        let sides = |point: &Vec3| [1.0, -1.0].into_iter().find_map(|side| Some((side, self.faced(*point, side)?)));
        let faced: Vec<Option<(f64, Covered)>> = points.par_iter().map(sides).collect();
        if faced.iter().all(Option::is_none) {
            return vec![false; points.len()];
        }
        let openings = self.openings();
        let is_whole = |(point, faced): (&Vec3, &Option<(f64, Covered)>)| {
            faced.as_ref().is_some_and(|(side, covered)| covered.is_once(place(*point), *side, &openings))
        };
        points.iter().zip(&faced).map(is_whole).collect()
    }

    /// What all triangles cover, as long as they have this side to the point.
    fn faced(&self, point: Vec3, side: f64) -> Option<Covered> {
        let point = place(point);
        let mut covered = Covered::default();
        for corners in &self.corners {
            let angle = side * solid_angle(corners.map(place), point);
            covered.add(angle);
            if covered.against > SLIVER || (angle < 0.0 && turns_away(corners, point)) {
                return None;
            }
        }
        Some(covered)
    }

    /// Edges of the surfaces, by opening.
    fn openings(&self) -> Vec<Opening> {
        let mut numbers = HashMap::new();
        let mut places: Vec<DVec3> = Vec::new();
        // How often an edge is gone along from the lower number to the higher, less back.
        let mut edges: HashMap<[usize; 2], f64> = HashMap::new();
        for corners in &self.corners {
            let ids = corners.map(|corner| {
                let place = place(corner);
                *numbers.entry((place / WELD).as_i64vec3()).or_insert_with(|| {
                    places.push(place);
                    places.len() - 1
                })
            });
            for [a, b] in [[ids[0], ids[1]], [ids[1], ids[2]], [ids[2], ids[0]]] {
                *edges.entry([a.min(b), a.max(b)]).or_default() += if a < b { 1.0 } else { -1.0 };
            }
        }
        let mut open: Vec<([usize; 2], f64)> = edges.into_iter().filter(|([a, b], n)| a != b && *n != 0.0).collect();
        open.sort_unstable_by_key(|(edge, _)| *edge);
        // The edges of an opening hang together: every corner leads to the first of its opening.
        let mut leads: Vec<usize> = (0..places.len()).collect();
        for ([a, b], _) in &open {
            let (a, b) = (first(&mut leads, *a), first(&mut leads, *b));
            leads[a.max(b)] = a.min(b);
        }
        // None leads higher.
        (0..leads.len()).for_each(|corner| leads[corner] = leads[leads[corner]]);
        open.sort_by_key(|([a, _], _)| leads[*a]);
        let placed = |edges: &[([usize; 2], f64)]| edges.iter().map(|(e, n)| (e.map(|id| places[id]), *n)).collect();
        open.chunk_by(|([a, _], _), ([b, _], _)| leads[*a] == leads[*b]).map(placed).collect()
    }
}

/// A triangle that counts negative does so by more than rounding of its corners. From 35 km away, a room of 10 m covers a tenth of
/// [`SLIVER`], and yet who is in it sees all of it.
fn turns_away(corners: &[Vec3; 3], point: DVec3) -> bool {
    let rounding = 4.0 * f64::from(off_surface(corners.iter().fold(Vec3::ZERO, |m, corner| m.max(corner.abs()))));
    let [a, b, c] = corners.map(place);
    let normal = (b - a).cross(c - a);
    let longest = (b - a).length().max((c - b).length()).max((a - c).length());
    let (height, before) = (normal.length() / longest, (normal.normalize_or_zero().dot(point - a)).abs());
    height > rounding && before > rounding
}

/// Where a corner leads; the way becomes shorter.
fn first(leads: &mut [usize], mut corner: usize) -> usize {
    while leads[corner] != corner {
        leads[corner] = leads[leads[corner]];
        corner = leads[corner];
    }
    corner
}

/// Solid angles, sr.
#[derive(Debug, Clone, Copy, Default)]
struct Covered {
    /// Of all.
    total: f64,
    /// Of what counts negative.
    against: f64,
}

impl Covered {
    fn add(&mut self, solid_angle: f64) {
        self.total += solid_angle;
        self.against += (-solid_angle).max(0.0);
    }

    /// Once all openings are closed, each direction is covered once.
    fn is_once(mut self, point: DVec3, side: f64, openings: &[Opening]) -> bool {
        for opening in openings {
            // The tip lies in the middle of the opening, or, where that is all but the surfaces, opposite.
            let middle: DVec3 =
                opening.iter().flat_map(|(edge, _)| edge).map(|end| (*end - point).normalize_or_zero()).sum();
            let fan = |tip: DVec3| {
                let mut fan = Covered::default();
                opening.iter().for_each(|([a, b], times)| fan.add(times * side * solid_angle([*b, *a, tip], point)));
                fan
            };
            let tip = middle.normalize_or(DVec3::Y);
            let fans = [fan(point + tip), fan(point - tip)];
            let best = if fans[0].against <= fans[1].against { fans[0] } else { fans[1] };
            self.total += best.total;
            self.against += best.against;
        }
        // The sum is a multiple of 4π.
        self.against <= SLIVER && (self.total - 2.0 * TAU).abs() < PI
    }
}

/// Corners within rounding of each other fall together.
fn place(corner: Vec3) -> DVec3 {
    (corner.as_dvec3() / WELD).round() * WELD
}

/// Of a triangle, positive from where it goes round counter-clockwise. Negative from a place in it.
fn solid_angle(corners: [DVec3; 3], from: DVec3) -> f64 {
    let [a, b, c] = corners.map(|corner| corner - from);
    let [x, y, z] = [a, b, c].map(DVec3::length);
    let volume = -a.dot(b.cross(c));
    let rest = x * y * z + a.dot(b) * z + b.dot(c) * x + c.dot(a) * y;
    match volume == 0.0 {
        true if rest <= 0.0 => -TAU,
        true => 0.0,
        false => 2.0 * volume.atan2(rest),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::fibonacci_sphere;
    use crate::scene::{Material, Mesh, Scene};
    use crate::trace::Frame;
    use glam::DQuat;

    /// Twelve triangles that face inward.
    fn cube(middle: DVec3, half: DVec3) -> Vec<[DVec3; 3]> {
        let corner = |i: usize| middle + half * DVec3::from([0, 1, 2].map(|axis| 2.0 * (i >> axis & 1) as f64 - 1.0));
        let faces = [[0, 2, 6, 4], [1, 5, 7, 3], [0, 4, 5, 1], [2, 3, 7, 6], [0, 1, 3, 2], [4, 6, 7, 5]];
        faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]].map(|t| t.map(corner))).collect()
    }

    fn room() -> Vec<[DVec3; 3]> {
        cube(DVec3::ZERO, DVec3::new(3.0, 1.0, 2.0))
    }

    fn reversed(triangles: &[[DVec3; 3]]) -> Vec<[DVec3; 3]> {
        triangles.iter().map(|&[a, b, c]| [a, c, b]).collect()
    }

    /// An L of corridors 2 wide and 2 high; the walls between z = 0 and x = 0 meet at an edge that stands out.
    fn corridors() -> Vec<[DVec3; 3]> {
        let outline = [[-2.0, -2.0], [4.0, -2.0], [4.0, 0.0], [0.0, 0.0], [0.0, 4.0], [-2.0, 4.0]];
        let at = |i: usize, y: f64| DVec3::new(outline[i % 6][0], y, outline[i % 6][1]);
        let mut triangles = Vec::new();
        for i in 0..6 {
            let [a, b, c, d] = [at(i, -1.0), at(i + 1, -1.0), at(i + 1, 1.0), at(i, 1.0)];
            triangles.extend([[a, b, c], [a, c, d]]);
        }
        for [i, j, k] in [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]] {
            triangles.push([at(i, 1.0), at(j, 1.0), at(k, 1.0)]);
            triangles.push([at(i, -1.0), at(k, -1.0), at(j, -1.0)]);
        }
        triangles
    }

    fn surfaces(triangles: &[[DVec3; 3]]) -> (Scene, Surfaces, Frame) {
        let count = triangles.len() as u32;
        let mesh = Mesh {
            positions: triangles.as_flattened().to_vec(),
            normals: vec![Vec3::Y; 3 * triangles.len()],
            triangles: (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
            ..Mesh::default()
        };
        let scene = Scene { meshes: vec![mesh], materials: vec![Material::default()], ..Scene::default() };
        let frame = Frame::of_scene(&scene);
        let surfaces = Surfaces::new(&scene, |_| true, &frame).unwrap();
        (scene, surfaces, frame)
    }

    /// What is proven, as the level stands and turned; and the same by many lines of sight, of which none may be blocked where
    /// it is.
    fn sees_all(triangles: &[[DVec3; 3]], from: DVec3) -> bool {
        let turns = [DQuat::IDENTITY, DQuat::from_euler(glam::EulerRot::YXZ, 0.7, 0.5, 0.3)];
        let proven = turns.map(|turn| {
            let turned: Vec<_> = triangles.iter().map(|t| t.map(|corner| turn * corner)).collect();
            let (scene, surfaces, frame) = surfaces(&turned);
            let point = frame.to_trace(turn * from);
            let proven = surfaces.seen_whole_from(&[point])[0];
            if proven {
                for direction in fibonacci_sphere(10_000) {
                    let Some(first) = surfaces.closest(&scene, point, direction, 0.0, f32::INFINITY) else { continue };
                    let next = surfaces.closest(&scene, point, direction, first.t * 1.001, f32::INFINITY);
                    assert_eq!(next, None, "{from} {direction}");
                }
            }
            proven
        });
        assert_eq!(proven[0], proven[1], "{from}");
        proven[0]
    }

    #[test]
    fn a_room_is_seen_whole_from_inside_whichever_way_its_triangles_face() {
        let corner = DVec3::new(2.999, 0.999, -1.999);
        for room in [room(), reversed(&room())] {
            for from in [DVec3::ZERO, DVec3::new(-2.0, 0.5, 1.0), corner] {
                assert!(sees_all(&room, from), "{from}");
            }
            for from in [DVec3::new(3.1, 0.0, 0.0), DVec3::new(9.0, 9.0, 9.0), DVec3::new(3.001, 0.999, -1.999)] {
                assert!(!sees_all(&room, from), "{from}");
            }
        }
        // Exactly in a wall: on its plane, its diagonal and its corner.
        let (_, surfaces, frame) = surfaces(&room());
        for from in [DVec3::new(3.0, 0.3, 0.1), DVec3::new(3.0, 0.0, 0.0), DVec3::new(3.0, 1.0, 2.0)] {
            assert_eq!(surfaces.seen_whole_from(&[frame.to_trace(from)]), [false], "{from}");
        }
    }

    #[test]
    fn a_room_with_openings_is_seen_whole_too() {
        // Without both ends, as the box of the report; without one; the floor alone; two walls and the floor.
        for kept in [[0, 1, 2, 3].as_slice(), &[0, 1, 2, 3, 4], &[2], &[0, 2, 4]] {
            let open: Vec<_> = kept.iter().flat_map(|face| room()[2 * face..][..2].to_vec()).collect();
            assert!(sees_all(&open, DVec3::new(0.3, 0.1, 0.2)), "{kept:?}");
        }
        // And from beyond the opening, in front of all of it.
        let open = &room()[..10];
        assert!(sees_all(open, DVec3::new(0.0, 0.0, 1.99)));
        assert!(!sees_all(open, DVec3::new(5.0, 0.0, 2.5)));
    }

    #[test]
    fn corridors_are_seen_whole_from_where_they_meet() {
        for (from, all) in [([-1.0, 0.0, -1.0], true), ([-0.01, 0.9, -0.01], true), ([0.1, 0.0, -1.0], false)] {
            assert_eq!(sees_all(&corridors(), from.into()), all, "{from:?}");
        }
        assert!(!sees_all(&corridors(), DVec3::new(1.0, 0.0, 1.0)), "outside");
    }

    #[test]
    fn whatever_stands_in_the_room_may_hide_something() {
        let post = reversed(&cube(DVec3::new(2.0, 0.0, 0.0), DVec3::splat(0.2)));
        let dot = DVec3::new(2.0, 0.0, 0.0);
        let [a, b] = [dot + DVec3::new(0.0, 0.01, 0.0), dot + DVec3::new(0.0, 0.0, 0.01)];
        for extra in [post, vec![[dot, a, b]], vec![[dot, b, a]], room(), reversed(&room()), vec![room()[0]]] {
            let triangles = [room(), extra].concat();
            assert!(!sees_all(&triangles, DVec3::new(0.3, 0.1, 0.2)), "{} triangles", triangles.len());
            assert!(!sees_all(&triangles, DVec3::new(2.5, 0.1, 0.2)), "{} triangles", triangles.len());
        }
    }

    #[test]
    fn seams_where_corners_meet_edges_are_no_openings() {
        // The second wall of three triangles: one corner more on an edge of the floor.
        let mut triangles = room();
        let [a, b, c] = triangles.remove(2);
        let middle = a.lerp(b, 1.0 / 3.0);
        triangles.extend([[a, middle, c], [middle, b, c]]);
        assert!(sees_all(&triangles, DVec3::new(0.3, 0.1, 0.2)));
        // Corners moved by what rounding in two meshes moves them.
        let mut triangles = room();
        triangles[0][1].x *= 1.0 + 1e-8;
        assert!(sees_all(&triangles, DVec3::new(0.3, 0.1, 0.2)));
    }
}
