//! Godot's tetrahedra and the tree that finds them.

use gdibl_export::{Engine, sample_position};

use crate::readers::godot;
use crate::volumes::{MAX, MIN, constant, exported, file, grid};

#[test]
fn every_point_of_the_box_lies_in_exactly_one_tetrahedron_and_the_tree_finds_it() {
    for counts in [[4, 3, 5], [2, 2, 2], [2, 7, 3]] {
        let volume = grid(counts, 2, |_| constant([1.0; 3]));
        let data = godot(file(&exported(&volume, Engine::Godot), "room.main"));
        let cells: u32 = counts.iter().map(|n| n - 1).product();
        assert_eq!(data.tetrahedra.len(), 6 * cells as usize);
        for i in 0..2000 {
            let p = sample_position(MIN, MAX, i);
            let holds = |t: &usize| data.weights(*t, p).iter().all(|&w| w > 0.0);
            let holding: Vec<usize> = (0..data.tetrahedra.len()).filter(holds).collect();
            assert_eq!(holding.len(), 1, "{counts:?}, {p:?}: in {holding:?}");
            let weights = data.weights(holding[0], p);
            assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-9, "{weights:?}");
            let found = data.find(p);
            // Within rounding of a face, either side will do.
            let near = data.weights(found, p).iter().all(|&w| w > -1e-5);
            assert!(found == holding[0] || near, "{p:?}: tree {found}, in {}", holding[0]);
        }
    }
}

#[test]
fn tetrahedra_fill_the_box_and_share_whole_faces() {
    let volume = grid([4, 3, 3], 2, |_| constant([1.0; 3]));
    let data = godot(file(&exported(&volume, Engine::Godot), "room.main"));
    let mut faces = std::collections::HashMap::<[usize; 3], u32>::new();
    let mut volume = 0.0;
    for t in &data.tetrahedra {
        let [a, b, c, d] = t.map(|n| data.points[n]);
        let e = |q: [f64; 3]| -> [f64; 3] { std::array::from_fn(|k| q[k] - a[k]) };
        let (u, v, w) = (e(b), e(c), e(d));
        volume += (u[0] * (v[1] * w[2] - v[2] * w[1]) - u[1] * (v[0] * w[2] - v[2] * w[0])
            + u[2] * (v[0] * w[1] - v[1] * w[0]))
            .abs()
            / 6.0;
        for left_out in 0..4 {
            let mut face: Vec<usize> = (0..4).filter(|&k| k != left_out).map(|k| t[k]).collect();
            face.sort_unstable();
            *faces.entry([face[0], face[1], face[2]]).or_default() += 1;
        }
    }
    let size: f64 = (0..3).map(|k| MAX[k] - MIN[k]).product();
    assert!((volume - size).abs() < 1e-4 * size, "{volume} {size}");
    // Inner faces belong to two; outer ones, two triangles per cell's side, to one.
    let outer = faces.values().filter(|&&count| count == 1).count();
    assert!(faces.values().all(|&count| count <= 2));
    assert_eq!(outer, 2 * 2 * (3 * 2 + 3 * 2 + 2 * 2));
}

#[test]
fn bounds_are_the_box_and_points_its_nodes() {
    let volume = grid([3, 2, 4], 2, |_| constant([1.0; 3]));
    let data = godot(file(&exported(&volume, Engine::Godot), "room.main"));
    let expected: Vec<f64> = MIN.into_iter().chain((0..3).map(|k| MAX[k] - MIN[k])).collect();
    assert_eq!(data.bounds, expected);
    for (node, point) in data.points.iter().enumerate() {
        let position = volume.node_position(node);
        assert!((0..3).all(|k| (position[k] - point[k]).abs() < 1e-6), "{position:?} {point:?}");
    }
    // Every leaf is reached once.
    let mut leaves: Vec<i32> = data.bsp.iter().flat_map(|b| [b.1, b.2]).filter(|&c| c < 0).map(|c| -1 - c).collect();
    leaves.sort_unstable();
    let mut unique = leaves.clone();
    unique.dedup();
    assert_eq!(unique.len(), data.tetrahedra.len());
    assert_eq!(leaves.len(), unique.len());
}
