//! No ray leaves a closed mesh, wherever it is aimed; and the tree finds what brute force in f64 finds.
//!
//! 1.6e7 rays in all. The meshes are stored in f64 at world offsets to 1e6 m and scales 1e-3 to 1e5, as levels are.

mod closed;
mod twins;

use closed::*;
use gdibl_baker::sampling::{Sampler, Stream, uniform_sphere};
use gdibl_baker::scene::{Role, Scene};
use gdibl_baker::trace::{Frame, Surfaces, Tree};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

#[test]
fn no_ray_escapes_a_closed_mesh_at_any_scale_and_offset() {
    let mut rays = 0u64;
    for offset in [0.0, 1e4, 1e6] {
        for scale in [1e-3, 1.0, 0.3, 1e5] {
            for closed in closed_meshes(scale, offset) {
                let count = 220_000;
                let escapes = closed.escapes(count);
                assert_eq!(escapes, 0, "{}: of {count} rays", closed.name);
                rays += 2 * u64::from(count);
            }
        }
    }
    println!("{rays} rays, 0 escapes");
    assert!(rays >= 10_000_000);
}

#[test]
fn hits_in_a_box_lie_on_its_walls() {
    for (scale, offset) in [(1.0, 0.0), (1e-3, 1e4), (1e5, 1e6)] {
        let closed = &closed_meshes(scale, offset)[0];
        let far = closed.corners.iter().flatten().fold(0.0f32, |m, c| m.max(c.abs().max_element()));
        (0..100_000u32).into_par_iter().for_each(|index| {
            let (origin, direction) = closed.ray(index);
            let (o, d) = (origin.as_dvec3(), direction.as_dvec3());
            // Where the ray leaves the cube |x|, |y|, |z| <= far.
            let expected = (0..3)
                .map(|axis| (f64::from(far).copysign(d[axis]) - o[axis]) / d[axis])
                .filter(|t| t.is_finite())
                .fold(f64::INFINITY, f64::min);
            let hit = closed.surfaces.closest(&closed.scene, origin, direction, 0.0, f32::INFINITY).unwrap();
            // Along the ray: a corner of the box is near in space, but may belong to either wall.
            let off = (f64::from(hit.t) - expected).abs() * d.length();
            assert!(off < 2e-3, "{}: ray {index} {origin} {direction}: {} for {expected}", closed.name, hit.t);
            let depth = far - hit.position.abs().max_element();
            assert!(depth.abs() < 1e-3, "{}: ray {index}: {} off the wall", closed.name, depth);
        });
    }
}

#[test]
fn slivers_duplicates_and_flat_triangles_open_no_gap() {
    let mut triangles = lattice_mesh(8, |_| true);
    // Everything twice; each wall once more in two large triangles; slivers of 1e6 to 1 along edges; and what has no
    // area at all: points, lines.
    triangles.extend(triangles.clone());
    let wall = |a: [f64; 3], b: [f64; 3], c: [f64; 3]| [DVec3::from(a), DVec3::from(b), DVec3::from(c)];
    triangles.push(wall([0.0, 0.0, 0.0], [8.0, 0.0, 0.0], [8.0, 8.0, 0.0]));
    triangles.push(wall([0.0, 0.0, 0.0], [8.0, 8.0, 0.0], [0.0, 8.0, 0.0]));
    for i in 0..8 {
        let at = f64::from(i);
        triangles.push(wall([0.0, at, 8.0], [8.0, at, 8.0], [8.0, at + 8e-6, 8.0]));
        triangles.push(wall([at, 0.0, 0.0], [at, 8e-6, 0.0], [at, 8.0, 0.0]));
        triangles.push(wall([at, 4.0, 4.0], [at, 4.0, 4.0], [at, 4.0, 4.0]));
        triangles.push(wall([0.0, at, 4.0], [4.0, at, 4.0], [8.0, at, 4.0]));
    }
    let inside = places_in_lattice(8, |p| p.min_element() > 0.0 && p.max_element() < 8.0);
    for (scale, offset) in [(1.0, 0.0), (1e-3, 1e6), (0.7, 1e4)] {
        let closed = Closed::new("with rubbish", &triangles, &inside, scale, offset);
        assert_eq!(closed.escapes(200_000), 0, "{}", closed.name);
    }
}

#[test]
fn many_small_triangles_open_no_gap() {
    // 330 000 of them; the extremes tool does it with 5 million.
    let inside = places_in_lattice(8, |p| p.distance(DVec3::splat(4.0)) < 3.9);
    let closed = Closed::new("fine sphere", &sphere_mesh(7), &inside, 1.0, 1e4);
    assert_eq!(closed.surfaces.len(), 327_680);
    assert_eq!(closed.escapes(200_000), 0);
}

/// Random triangles of all sizes in a cube of 200 units.
fn soup(count: u32, seed: u64) -> Vec<[Vec3; 3]> {
    (0..count)
        .map(|i| {
            let stream = Stream::new(Sampler::Random, seed, u64::from(i), 0);
            let point = |pair| {
                let ([x, y], [z, _]) = (stream.point(0, pair), stream.point(1, pair));
                Vec3::new(x, y, z) * 200.0 - 100.0
            };
            let size = 10f32.powf(-3.0 * stream.point(2, 0)[0]);
            let center = point(1);
            [2, 3, 4].map(|pair| center + point(pair) * size)
        })
        .collect()
}

/// Ray against triangle in f64 (Möller and Trumbore, 1997): t, and how far inside the triangle the hit is (the least
/// of the three weights; negative outside).
fn intersect_f64(origin: DVec3, direction: DVec3, triangle: &[Vec3; 3]) -> Option<(f64, f64)> {
    let [a, b, c] = triangle.map(|p| p.as_dvec3());
    let (edge1, edge2) = (b - a, c - a);
    let p = direction.cross(edge2);
    let determinant = edge1.dot(p);
    if determinant == 0.0 {
        return None;
    }
    let s = origin - a;
    let v = s.dot(p) / determinant;
    let q = s.cross(edge1);
    let w = direction.dot(q) / determinant;
    Some((edge2.dot(q) / determinant, v.min(w).min(1.0 - v - w)))
}

#[test]
fn tree_finds_what_brute_force_in_f64_finds() {
    /// Hits whose weights are nearer to an edge than this may round to either side.
    const EDGE: f64 = 1e-4;
    let compared: u64 = (0..24u64)
        .into_par_iter()
        .map(|seed| {
            let triangles = soup(1 + 50 * seed as u32, seed);
            let trees = [Tree::build(&triangles), Tree::build(&triangles).portable()];
            let mut compared = 0;
            for ray in 0..2000u32 {
                let tree = &trees[ray as usize % 2];
                let stream = Stream::new(Sampler::Random, 77, seed, ray);
                let ([x, y], [z, _]) = (stream.point(0, 0), stream.point(0, 1));
                let origin = Vec3::new(x, y, z) * 300.0 - 150.0;
                let direction = uniform_sphere(stream.point(0, 2));
                let (o, d) = (origin.as_dvec3(), direction.as_dvec3());
                let hits = triangles.iter().filter_map(|t| intersect_f64(o, d, t)).filter(|h| h.0 > 0.0);
                let (mut sure, mut possible) = (f64::INFINITY, f64::INFINITY);
                for (t, depth) in hits {
                    if depth > EDGE {
                        sure = sure.min(t);
                    }
                    if depth > -EDGE {
                        possible = possible.min(t);
                    }
                }
                let found = tree.closest(origin, direction, 0.0, f32::INFINITY, |_| true);
                let t = found.map_or(f64::INFINITY, |hit| f64::from(hit.t));
                let tolerance = 1e-3 + 1e-5 * sure.min(1e9);
                assert!(t <= sure + tolerance, "soup {seed}, ray {ray}: {t} missed {sure}");
                assert!(t >= possible - tolerance, "soup {seed}, ray {ray}: {t} where nothing is before {possible}");
                // Any-hit agrees with nearest-hit.
                let mut any = false;
                tree.any(origin, direction, 0.0, f32::INFINITY, |_| {
                    any = true;
                    false
                });
                assert_eq!(any, found.is_some());
                compared += u64::from(sure.is_finite());
            }
            compared
        })
        .sum();
    assert!(compared > 10_000, "{compared} hits compared");
}

#[test]
fn any_hit_visits_every_triangle_once() {
    let triangles = soup(400, 5);
    let tree = Tree::build(&triangles);
    let mut visited = 0;
    for ray in 0..2000u32 {
        let stream = Stream::new(Sampler::Random, 3, 0, ray);
        let direction = uniform_sphere(stream.point(0, 0));
        let mut seen = Vec::new();
        tree.any(Vec3::ZERO, direction, 0.0, f32::INFINITY, |hit| {
            seen.push(hit.triangle);
            true
        });
        let count = seen.len();
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), count, "ray {ray}");
        visited += count;
        // What is surely hit is among them.
        for (index, triangle) in triangles.iter().enumerate() {
            let sure = intersect_f64(DVec3::ZERO, direction.as_dvec3(), triangle);
            if sure.is_some_and(|(t, depth)| t > 1e-3 && depth > 1e-4) {
                assert!(seen.binary_search(&(index as u32)).is_ok(), "ray {ray}: triangle {index}");
            }
        }
    }
    assert!(visited > 2000, "{visited}");
}

#[test]
fn of_equally_near_triangles_the_first_is_hit_in_any_order() {
    // Every triangle four times; the copies stand in different places of the list.
    let base = soup(60, 9);
    let mut triangles: Vec<[Vec3; 3]> = Vec::new();
    for copy in 0..4 {
        triangles.extend((0..60).map(|i| base[(i * 7 + copy * 13) % 60]));
    }
    let tree = Tree::build(&triangles);
    let again = Tree::build(&triangles);
    let mut hits = 0;
    for ray in 0..20_000u32 {
        let stream = Stream::new(Sampler::Random, 4, 0, ray);
        let direction = uniform_sphere(stream.point(0, 0));
        let found = tree.closest(Vec3::ZERO, direction, 0.0, f32::INFINITY, |_| true);
        assert_eq!(found, again.closest(Vec3::ZERO, direction, 0.0, f32::INFINITY, |_| true));
        let Some(hit) = found else { continue };
        let first = triangles.iter().position(|t| *t == triangles[hit.triangle as usize]);
        assert_eq!(first, Some(hit.triangle as usize), "ray {ray}");
        hits += 1;
    }
    assert!(hits > 500, "{hits}");
}

#[test]
fn one_triangle_blocks_from_both_sides_up_to_its_edges() {
    let triangle = [DVec3::new(0.0, 0.0, 5.0), DVec3::new(4.0, 0.0, 5.0), DVec3::new(0.0, 4.0, 5.0)];
    let scene = scene_of(&[triangle]);
    let frame = Frame::default();
    let surfaces = Surfaces::new(&scene, |m| m.role == Role::Environment, &frame).unwrap();
    assert_eq!(surfaces.len(), 1);
    for (x, y, hit) in [
        (1.0, 1.0, true),
        (0.0, 0.0, true),
        (4.0, 0.0, true),
        (2.0, 2.0, true),
        (2.0, 0.0, true),
        (2.1, 2.1, false),
        (-1e-6, 1.0, false),
        (1.0, -1e-6, false),
    ] {
        for (z, direction) in [(0.0, Vec3::Z), (10.0, Vec3::NEG_Z)] {
            let found = surfaces.closest(&scene, Vec3::new(x, y, z), direction, 0.0, f32::INFINITY);
            assert_eq!(found.is_some(), hit, "{x} {y} from {z}");
            assert_eq!(surfaces.escaping(&scene, Vec3::new(x, y, z), direction), Vec3::splat(f32::from(!hit)));
            if let Some(found) = found {
                assert_eq!((found.t, found.normal), (5.0, -direction), "the normal faces the ray");
                assert_eq!(found.back, direction == Vec3::Z, "by its winding it faces +z");
            }
        }
    }
    let [below, above] = [Vec3::new(1.0, 1.0, 0.0), Vec3::new(1.0, 1.0, 9.0)];
    assert_eq!(surfaces.transmittance(&scene, below, above, None), Vec3::ZERO);
    assert_eq!(surfaces.transmittance(&scene, below, above, Some(0)), Vec3::ONE);
    // Up to the surface and away from it, exactly: not hidden by it.
    let on = Vec3::new(1.0, 1.0, 5.0);
    for other in [below, above] {
        assert_eq!(surfaces.transmittance(&scene, other, on, None), Vec3::ONE);
    }
    // Along its plane it has no extent.
    assert_eq!(surfaces.closest(&scene, Vec3::new(-1.0, 1.0, 5.0), Vec3::X, 0.0, f32::INFINITY), None);
}

#[test]
fn no_triangle_is_no_surface() {
    assert!(Surfaces::new(&Scene::default(), |_| true, &Frame::default()).is_none());
    let scene = scene_of(&lattice_mesh(1, |_| true));
    assert!(Surfaces::new(&scene, |m| m.role == Role::Scene, &Frame::default()).is_none(), "none of that role");
    let tree = Tree::build(&[]);
    assert_eq!(tree.closest(Vec3::ZERO, Vec3::X, 0.0, f32::INFINITY, |_| true), None);
    tree.any(Vec3::ZERO, Vec3::X, 0.0, f32::INFINITY, |_| panic!("a hit on nothing"));
}
