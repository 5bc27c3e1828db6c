//! The traversal by AVX2 and its portable twin: the same bits of every hit, in the same order.

use crate::closed::{Closed, closed_meshes, lattice_mesh, places_in_lattice};
use crate::soup;
use gdibl_baker::sampling::{Sampler, Stream, uniform_sphere};
use gdibl_baker::trace::{Tree, TreeHit};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// A tree by AVX2 and its twin; `None`, and says so, where there is nothing to compare.
fn twins(triangles: &[[Vec3; 3]]) -> Option<[Tree; 2]> {
    let tree = Tree::build(triangles);
    if !tree.uses_avx2() {
        eprintln!("SKIPPED: this processor has no AVX2, only the portable traversal runs");
        return None;
    }
    let twin = Tree::build(triangles).portable();
    assert!(!twin.uses_avx2());
    Some([tree, twin])
}

fn bits(hit: &TreeHit) -> [u32; 4] {
    [hit.t.to_bits(), hit.triangle, hit.v.to_bits(), hit.w.to_bits()]
}

/// All that a tree can be asked about a ray, and all that it asks: as bits.
fn answers(tree: &Tree, origin: Vec3, direction: Vec3, (t_min, t_max): (f32, f32)) -> Vec<[u32; 4]> {
    let mut all = Vec::new();
    let mut end = |hit: Option<TreeHit>| all.push(hit.map_or([u32::MAX; 4], |hit| bits(&hit)));
    end(tree.closest(origin, direction, t_min, t_max, |_| true));
    // Holes: every other triangle.
    let mut asked = Vec::new();
    end(tree.closest(origin, direction, t_min, t_max, |hit| {
        asked.push(*hit);
        hit.triangle % 2 == 0
    }));
    tree.any(origin, direction, t_min, t_max, |hit| {
        asked.push(*hit);
        true
    });
    // Ends at the third.
    let mut left = 3;
    tree.any(origin, direction, t_min, t_max, |hit| {
        asked.push(*hit);
        left -= 1;
        left > 0
    });
    all.extend(asked.iter().map(bits));
    let ignore = asked.last().map_or(u32::MAX, |hit| hit.triangle);
    all.push([u32::from(tree.is_hit(origin, direction, t_min, t_max, ignore)); 4]);
    all
}

/// Compares the twins on rays; returns how many hits were compared.
fn compare(name: &str, triangles: &[[Vec3; 3]], rays: u32, ray: impl Fn(u32) -> (Vec3, Vec3) + Sync) -> Option<usize> {
    let [tree, twin] = &twins(triangles)?;
    let compared = |index: u32| {
        let (origin, direction) = ray(index);
        if direction == Vec3::ZERO || !direction.is_finite() {
            return 0;
        }
        // Without bounds; between bounds; up to a hit and from a hit on, exactly.
        let nearest = tree.closest(origin, direction, 0.0, f32::INFINITY, |_| true).map_or(1.0, |hit| hit.t);
        let ranges = [(0.0, f32::INFINITY), (0.5 * nearest, 2.0 * nearest), (0.0, nearest), (nearest, f32::INFINITY)];
        let count = |range: (f32, f32)| {
            let [a, b] = [tree, twin].map(|tree| answers(tree, origin, direction, range));
            assert_eq!(a, b, "{name}: ray {index}, {origin} {direction}, t in {range:?}");
            a.len() - 3
        };
        ranges.into_iter().map(count).sum()
    };
    Some((0..rays).into_par_iter().map(compared).sum())
}

#[test]
fn avx2_and_the_portable_twin_agree_to_the_bit_in_soups() {
    for seed in 0..12u64 {
        let triangles = soup(1 + 173 * seed as u32, seed);
        let ray = |index: u32| {
            let stream = Stream::new(Sampler::Random, 78, seed, index);
            let ([x, y], [z, _]) = (stream.point(0, 0), stream.point(0, 1));
            let origin = Vec3::new(x, y, z) * 300.0 - 150.0;
            // Anywhere; at a corner; at an edge.
            let [a, b, _] = triangles[index as usize % triangles.len()];
            let target = [origin + uniform_sphere(stream.point(0, 2)), a, (a + b) / 2.0][index as usize % 3];
            (origin, target - origin)
        };
        let Some(compared) = compare(&format!("soup {seed}"), &triangles, 5000, ray) else { return };
        assert!(compared > 1000, "soup {seed}: {compared}");
    }
}

#[test]
fn avx2_and_the_portable_twin_agree_to_the_bit_in_closed_meshes() {
    // Rays at corners and edges, along axes and diagonals, with zeros of both signs: see `Closed::ray`.
    for (scale, offset) in [(1.0, 0.0), (0.3, 1e4), (1e-3, 1e6)] {
        for closed in closed_meshes(scale, offset) {
            let Some(compared) = compare(&closed.name, &closed.corners, 40_000, |i| closed.ray(i)) else { return };
            assert!(compared > 100_000, "{}: {compared}", closed.name);
        }
    }
}

#[test]
fn avx2_and_the_portable_twin_agree_to_the_bit_on_slivers_and_degenerate_triangles() {
    let mut triangles = lattice_mesh(8, |_| true);
    triangles.extend(triangles.clone());
    for i in 0..8 {
        let at = f64::from(i);
        let point = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
        triangles.push([point(0.0, at, 8.0), point(8.0, at, 8.0), point(8.0, at + 8e-6, 8.0)]);
        triangles.push([point(at, 0.0, 4.0), point(at, 8e-6, 4.0), point(at, 8.0, 4.0)]);
        triangles.push([point(at, 4.0, 4.0); 3]);
        triangles.push([point(0.0, at, 4.0), point(4.0, at, 4.0), point(8.0, at, 4.0)]);
    }
    let inside = places_in_lattice(8, |p| p.min_element() > 0.0 && p.max_element() < 8.0);
    for (scale, offset) in [(1.0, 0.0), (0.7, 1e4)] {
        let closed = Closed::new("with rubbish", &triangles, &inside, scale, offset);
        let Some(compared) = compare(&closed.name, &closed.corners, 60_000, |i| closed.ray(i)) else { return };
        assert!(compared > 200_000, "{compared}");
    }
}

#[test]
fn avx2_and_the_portable_twin_agree_to_the_bit_on_what_numbers_cannot_hold() {
    // Origins far out, huge and tiny directions: overflow in boxes and edge functions must not tell the twins apart.
    let triangles = soup(700, 5);
    let ray = |index: u32| {
        let stream = Stream::new(Sampler::Random, 79, 0, index);
        let [far, size] = [[1.0, 1e6, 1e12, 1e20, 1e30][index as usize % 5], [1.0, 1e-36, 1e30][index as usize % 3]];
        let away = uniform_sphere(stream.point(0, 0));
        let to = if index.is_multiple_of(2) { uniform_sphere(stream.point(0, 1)) } else { -away };
        (away * far, to * size)
    };
    let Some(compared) = compare("far out", &triangles, 30_000, ray) else { return };
    assert!(compared > 1000, "{compared}");
}
