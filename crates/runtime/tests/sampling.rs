//! Light at a position: grids, points, vertices, and the odd corners of each.

mod common;

use common::*;
use gdibl_runtime::{RadianceSh, Volume};
use std::f32::consts::PI;

const UP: [f32; 3] = [0.0, 1.0, 0.0];

fn parse(file: &File) -> Volume {
    Volume::parse(&file.to_bytes()).unwrap()
}

fn positions() -> impl Iterator<Item = [f32; 3]> {
    (0..400).map(|i| {
        let t = i as f32;
        [1.0 + 2.0 * (t * 0.61).sin(), 1.25 + 0.75 * (t * 0.37).sin(), 3.5 + 1.5 * (t * 0.23).cos()]
    })
}

#[track_caller]
fn assert_near(found: f32, truth: f32, tolerance: f32) {
    assert!((found - truth).abs() <= tolerance, "found {found}, expected {truth}");
}

#[test]
fn trilinear_reproduces_a_linear_field_in_all_bands_and_encodings() {
    for bands in 0..=4 {
        for (encoding, scale, tolerance) in [(0, 1.0, 2e-5), (1, 0.25, 2e-2)] {
            let file = grid([5, 4, 3], bands, encoding, scale);
            let places = parse(&file.clone().radiance(|_, _, _| 0.0));
            let field = |p: [f64; 3], index: usize, channel: usize| {
                let k = index as f64;
                (3.0 + k + p[0] * (1.0 + channel as f64) - p[1] * k * 0.5 + 2.0 * p[2]) as f32
            };
            let volume = parse(&file.radiance(|node, i, c| field(places.node_position(node), i, c)));
            for position in positions() {
                let sample = volume.sample(position, UP);
                assert!(sample.inside);
                assert_eq!(sample.validity, 1.0);
                assert_eq!(sample.sh.bands, bands);
                for (index, coefficient) in sample.sh.coefficients.iter().enumerate() {
                    for (channel, &found) in coefficient.iter().enumerate() {
                        let within = index < (bands as usize + 1).pow(2);
                        let truth = field(position.map(f64::from), index, channel);
                        assert_near(found, if within { truth } else { 0.0 }, tolerance);
                    }
                }
            }
        }
    }
}

#[test]
fn nodes_that_are_blended_give_the_irradiance_of_their_position() {
    for file in arbitrary_grids() {
        let volume = parse(&file);
        for position in positions() {
            let (nodes, weights) = volume.blended_nodes(position.map(f64::from), UP).expect("it is a grid");
            assert_eq!(volume.irradiance_of_nodes(&nodes, weights, UP), volume.irradiance(position, UP));
        }
    }
    assert_eq!(parse(&small_points()).blended_nodes([0.0; 3], UP), None);
}

#[test]
fn a_sample_at_a_node_is_the_node() {
    let volume = parse(&grid([4, 3, 2], 2, 1, 0.5).radiance(pattern));
    for node in 0..volume.node_count() {
        let sample = volume.sample_f64(volume.node_position(node), UP);
        for (found, truth) in sample.sh.coefficients.iter().zip(volume.node_sh(node).coefficients) {
            assert_near(found[0], truth[0], 1e-5);
        }
    }
}

#[test]
fn white_furnace_gives_pi_everywhere() {
    let volume = parse(
        &grid([3, 3, 3], 2, 1, 1.0)
            .radiance(|_, index, _| if index == 0 { (4.0 * PI).sqrt() } else { 0.0 })
            .validity(|node| node % 3 != 0),
    );
    for position in positions() {
        for channel in volume.irradiance(position, [0.6, 0.0, 0.8]) {
            assert_near(channel, PI, 2e-3);
        }
    }
}

#[test]
fn only_valid_nodes_count() {
    // Valid nodes hold 1, filled ones 100: no sample with a valid node near may see them.
    let valid = |node: usize| node % 4 != 1;
    let file = grid([4, 3, 3], 0, 0, 1.0).radiance(|node, _, _| if valid(node) { 1.0 } else { 100.0 }).validity(valid);
    let volume = parse(&file);
    let mut partly = 0;
    for position in positions() {
        let sample = volume.sample(position, UP);
        let cell = volume.header().grid().locate(position.map(f64::from));
        let truth: f32 = (0..8).filter(|&k| valid(cell.nodes[k] as usize)).map(|k| cell.weights[k]).sum();
        assert_near(sample.validity, truth, 1e-6);
        assert_near(sample.sh.coefficients[0][0], 1.0, 1e-5);
        partly += usize::from(sample.validity < 0.99);
    }
    assert!(partly > 50);
}

#[test]
fn where_no_node_is_valid_filled_values_are_interpolated() {
    let file = grid([4, 3, 3], 0, 0, 1.0).radiance(|node, _, _| (node % 4) as f32);
    let volume = parse(&file.validity(|_| false));
    for position in positions() {
        let sample = volume.sample(position, UP);
        assert_eq!(sample.validity, 0.0);
        assert_near(sample.sh.coefficients[0][2], (position[0] + 1.0) * 0.75, 1e-5);
    }
    // All weight on a filled node, a hair's breadth from valid ones.
    let file = grid([2, 1, 1], 0, 0, 1.0).radiance(|node, _, _| 5.0 + node as f32);
    let volume = parse(&file.validity(|node| node == 1));
    for (x, value, validity) in [(-1.0, 5.0, 0.0), (-1.0 + 1e-30, 5.0, 0.0), (-0.9999, 6.0, 2.5e-5)] {
        let sample = volume.sample_f64([x, 1.0, 3.0], UP);
        assert_near(sample.sh.coefficients[0][0], value, 1e-5);
        assert_near(sample.validity, validity, 1e-6);
    }
}

#[test]
fn outside_the_box_is_the_nearest_place_in_it_and_says_so() {
    let volume = parse(&grid([4, 3, 2], 1, 0, 1.0).radiance(pattern));
    for position in positions() {
        let away = [position[0], position[1], position[2] + 10.0];
        let (found, truth) = (volume.sample(away, UP), volume.sample([position[0], position[1], 5.0], UP));
        assert_eq!(found.sh, truth.sh);
        assert!(truth.inside && !found.inside);
    }
    for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX] {
        for position in [[odd; 3], [0.0, odd, 3.0]] {
            for volume in [&volume, &parse(&small_points()), &parse(&small_vertices())] {
                let sample = volume.sample(position, [odd; 3]);
                assert!(!sample.inside);
                assert!(sample.sh.coefficients.as_flattened().iter().all(|v| v.is_finite()));
            }
        }
    }
}

#[test]
fn one_node_and_flat_boxes_light_everything_alike() {
    let mut file = grid([1, 1, 1], 1, 0, 1.0).radiance(pattern);
    for max in [file.max, file.min] {
        file.max = max;
        let volume = parse(&file);
        for position in positions() {
            assert_eq!(volume.sample(position, UP).sh, volume.node_sh(0));
        }
    }
}

#[test]
fn f64_positions_reach_far_from_the_origin() {
    let mut file = grid([2, 2, 2], 0, 0, 1.0).radiance(|node, _, _| (node % 2) as f32);
    for (min, max) in file.min.iter_mut().zip(&mut file.max) {
        (*min, *max) = (1e9, 1e9 + 1.0);
    }
    let volume = parse(&file);
    let sample = volume.sample_f64([1e9 + 0.25, 1e9 + 0.5, 1e9 + 0.5], UP);
    assert_near(sample.sh.coefficients[0][0], 0.25, 1e-6);
    assert!(sample.inside);
}

#[test]
fn points_answer_with_the_nearest_point() {
    let volume = parse(&small_points().validity(|node| node != 2));
    for node in 0..5 {
        let place = volume.node_position(node);
        let near = [place[0] + 0.2, place[1] - 0.3, place[2] + 0.2];
        for position in [place, near] {
            let sample = volume.sample_f64(position, UP);
            assert_eq!(sample.sh, volume.node_sh(node));
            assert_eq!(volume.nearest_node(position, UP), Some(node));
            assert_eq!(sample.validity, if node == 2 { 0.0 } else { 1.0 });
        }
    }
}

#[test]
fn vertices_at_one_place_are_told_apart_by_normal() {
    let volume = parse(&small_vertices());
    for node in 0..24 {
        let place = volume.node_position(node).map(|v| v + 1e-7);
        let mut normal = volume.node_normal(node).unwrap();
        normal[(node + 1) % 3] += 0.3;
        assert_eq!(volume.sample_f64(place, normal).sh, volume.node_sh(node));
    }
    // No normal at all: the first vertex there.
    let sample = volume.sample_f64(volume.node_position(14), [0.0; 3]);
    assert_eq!(sample.sh, volume.node_sh(12));
}

#[test]
fn a_sample_is_the_weighted_sum_of_nodes() {
    for volume in arbitrary_grids().iter().map(parse) {
        for position in positions().step_by(9) {
            let sample = volume.sample(position, UP);
            let cell = volume.header().grid().locate(position.map(f64::from));
            let valid: f64 =
                (0..8).filter(|&k| volume.is_valid(cell.nodes[k] as usize)).map(|k| f64::from(cell.weights[k])).sum();
            for index in 0..25 {
                for channel in 0..3 {
                    let (mut truth, mut size) = (0.0, 0.0);
                    for k in 0..8 {
                        let node = cell.nodes[k] as usize;
                        if valid < 1e-6 || volume.is_valid(node) {
                            let weight = f64::from(cell.weights[k]) / if valid < 1e-6 { 1.0 } else { valid };
                            let term = weight * f64::from(volume.node_sh(node).coefficients[index][channel]);
                            (truth, size) = (truth + term, size + term.abs());
                        }
                    }
                    let found = f64::from(sample.sh.coefficients[index][channel]);
                    assert!((found - truth).abs() <= 1e-6 * size, "found {found}, expected {truth}");
                }
            }
        }
    }
}

#[test]
fn irradiance_is_that_of_the_sample() {
    let normals = [UP, [0.6, 0.0, 0.8], [-0.48, -0.8, 0.36]];
    let flat = [[1, 3, 3], [4, 1, 3], [4, 3, 1]].map(|counts| parse(&grid(counts, 2, 1, 0.5).radiance(pattern)));
    let others = [small_points(), small_vertices(), small_sparse()].map(|file| parse(&file));
    for volume in arbitrary_grids().iter().map(parse).chain(flat).chain(others) {
        for (position, normal) in positions().step_by(3).zip(normals.into_iter().cycle()) {
            let sh: RadianceSh = volume.sample(position, normal).sh;
            let size: f32 = sh.coefficients.as_flattened().iter().map(|value| value.abs()).sum();
            for (found, truth) in volume.irradiance(position, normal).into_iter().zip(sh.convolve().evaluate(normal)) {
                assert_near(found, truth, 1e-6 * size);
            }
        }
    }
    let volume = parse(&grid([4, 3, 2], 2, 1, 0.5).radiance(pattern));
    for position in positions() {
        assert_eq!(volume.nearest_node(position.map(f64::from), UP), None, "a grid answers between its nodes");
    }
}
