//! Walls between nodes: who counts on which side, what is continuous, and what is refused.

mod common;

use common::*;
use gdibl_runtime::{Error, Volume};
use std::f32::consts::PI;

const UP: [f32; 3] = [0.0, 1.0, 0.0];

/// Four nodes along x at -1, 1/3, 5/3, 3, two on each other axis. Light 1 in the first two columns, 5 in the others.
fn two_rooms() -> File {
    grid([4, 2, 2], 0, 0, 1.0).radiance(|node, _, _| if node % 4 < 2 { 1.0 } else { 5.0 } * (4.0 * PI).sqrt())
}

/// With a wall at x = 1, in the middle of the second cell.
fn walled() -> File {
    two_rooms().section(walls(&[[1.0, 0.0, 0.0, 2.0]], &[(1, [0, NONE, NONE], 0, [LOW, HIGH, 0, 0, 0, 0, 0, 0])]))
}

fn parse(file: &File) -> Volume {
    Volume::parse(&file.to_bytes()).unwrap()
}

fn light(volume: &Volume, x: f32, normal: [f32; 3]) -> f32 {
    let position = [x, 1.1, 3.3];
    let red = volume.irradiance(position, normal)[0] / PI;
    let sample = volume.sample(position, normal);
    assert!((sample.sh.convolve().evaluate(normal)[0] / PI - red).abs() < 1e-5);
    assert!(sample.validity > 0.999_999);
    red
}

#[test]
fn light_stays_on_its_side_of_a_wall() {
    let (plain, walled) = (parse(&two_rooms()), parse(&walled()));
    assert_eq!((plain.walled_cells(), walled.walled_cells()), (0, 1));
    for i in 0..=400 {
        let x = -1.0 + 0.01 * i as f32;
        let truth = if x < 1.0 { 1.0 } else { 5.0 };
        // On the plane itself the normal tells the side.
        let normal = [if x < 1.0 { -1.0 } else { 1.0 }, 0.0, 0.0];
        assert!((light(&walled, x, normal) - truth).abs() < 1e-4, "{x}");
    }
    assert!(light(&plain, 0.99, UP) > 2.9);
    for (side, truth) in [(-1.0, 1.0), (1.0, 5.0)] {
        assert!((light(&walled, 1.0, [side, 0.0, 0.0]) - truth).abs() < 1e-4);
    }
}

#[test]
fn nodes_that_are_not_valid_do_not_count_behind_walls_either() {
    let volume = parse(&walled().validity(|node| node != 2));
    let sample = volume.sample([1.1, 1.1, 3.3], UP);
    assert!((sample.sh.convolve().evaluate(UP)[0] / PI - 5.0).abs() < 1e-4);
    assert!(sample.validity < 1.0);
    // None of a side is: what is left of the cell counts as if it had no wall.
    let volume = parse(&walled().validity(|node| node % 4 != 2));
    let red = volume.irradiance([1.1, 1.1, 3.3], UP)[0] / PI;
    assert!((red - 1.0).abs() < 1e-4, "{red}");
}

#[test]
fn three_planes_cut_a_cell_into_eight_parts() {
    // Each eighth of the one cell has the light of its own corner.
    let file = grid([2, 2, 2], 0, 0, 1.0).radiance(|node, _, _| (1.0 + node as f32) * (4.0 * PI).sqrt());
    let planes = [[1.0, 0.0, 0.0, 2.0], [0.0, 1.0, 0.0, 0.75], [0.0, 0.0, 1.0, 1.5]];
    let masks = std::array::from_fn(|part| 1 << part);
    let volume = parse(&file.section(walls(&planes, &[(0, [0, 1, 2], 0, masks)])));
    for part in 0..8 {
        let place = |axis: usize| [(-0.7, 2.9), (0.6, 1.9), (2.1, 4.9)][axis];
        let position = [0, 1, 2].map(|axis| if part >> axis & 1 == 1 { place(axis).1 } else { place(axis).0 });
        let red = volume.irradiance(position, UP)[0] / PI;
        assert!((red - 1.0 - part as f32).abs() < 1e-4, "{part}: {red}");
    }
}

#[test]
fn light_is_continuous_where_a_wall_ends() {
    // The wall at x = 1 goes through the first of two cells along z, and ends where the second begins.
    let file = |ends: u8| {
        let light = |node: usize| if node % 4 < 2 { 1.0 } else { 5.0 };
        let file = grid([4, 2, 3], 0, 0, 1.0).radiance(|node, _, _| light(node) * (4.0 * PI).sqrt());
        let cell = (1, [0, NONE, NONE], ends, [LOW, HIGH, 0, 0, 0, 0, 0, 0]);
        parse(&file.section(walls(&[[1.0, 0.0, 0.0, 2.0]], &[cell])))
    };
    let step = |volume: &Volume, x: f32| {
        let [a, b] = [3.499_9, 3.500_1].map(|z| volume.irradiance([x, 1.0, z], UP)[0] / PI);
        (a - b).abs()
    };
    let (sharp, soft) = (file(0), file(0b1111_0000));
    for x in [0.4, 0.7, 0.9, 1.2, 1.6] {
        assert!(step(&sharp, x) > 0.1, "{x}");
        assert!(step(&soft, x) < 0.01, "{x}: {}", step(&soft, x));
        // And far from its end the wall is as dense as before.
        let truth = if x < 1.0 { 1.0 } else { 5.0 };
        assert!((soft.irradiance([x, 1.0, 2.5], UP)[0] / PI - truth).abs() < 1e-4);
    }
}

#[test]
fn walls_have_an_answer_everywhere() {
    let volume = parse(&walled());
    for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30, 0.0] {
        for normal in [UP, [odd; 3], [0.0; 3]] {
            let found = volume.irradiance([odd, 1.0, 3.0], normal);
            let rest = normal.iter().any(|value| !value.is_finite());
            assert!(rest || found.iter().all(|value| value.is_finite()), "{odd} {normal:?}: {found:?}");
            assert!(volume.sample([odd; 3], normal).sh.coefficients[0][0].is_finite());
        }
    }
}

#[test]
fn parse_refuses_walls_that_are_none() {
    let plane = [1.0, 0.0, 0.0, 2.0];
    let cell = (1, [0, NONE, NONE], 0, [1; 8]);
    let with = |section: Section| two_rooms().section(section);
    let mut reserved = walls(&[plane], &[cell]);
    reserved.stored[8 + 16 + 11] = 1;
    let mut short = walls(&[plane], &[cell]);
    short.stored.pop();
    short.raw_size -= 1;
    for (section, words) in [
        (walls(&[[f32::NAN, 0.0, 0.0, 1.0]], &[cell]), "plane 0"),
        (walls(&[[0.0, 0.0, 1.0, f32::INFINITY]], &[cell]), "plane 0"),
        (walls(&[plane], &[(1, [1, NONE, NONE], 0, [1; 8])]), "record 0"),
        (walls(&[plane], &[(1, [NONE, 0, NONE], 0, [1; 8])]), "record 0"),
        // The last in x is no cell's lowest node; nor is one in the second layer of two, or one that is not there.
        (walls(&[plane], &[(3, [0, NONE, NONE], 0, [1; 8])]), "cell 3"),
        (walls(&[plane], &[(8, [0, NONE, NONE], 0, [1; 8])]), "cell 8"),
        (walls(&[plane], &[(u32::MAX, [0, NONE, NONE], 0, [1; 8])]), "cell 4294967295"),
        (walls(&[plane], &[cell, cell]), "record 1"),
        (walls(&[plane], &[(2, [0, NONE, NONE], 0, [1; 8]), cell]), "record 1"),
        (reserved, "byte 11"),
        (short, "bytes"),
        (raw(b"WALL", vec![0; 7]), "7 bytes"),
        (raw(b"WALL", [0xff; 8].to_vec()), "8 bytes"),
    ] {
        match Volume::parse(&with(section).to_bytes()) {
            Err(error @ Error::Invalid(_)) => assert!(error.to_string().contains(words), "{error}, not {words}"),
            other => panic!("{words}: {other:?}"),
        }
    }
    let points = small_points().section(walls(&[plane], &[]));
    assert!(Volume::parse(&points.to_bytes()).unwrap_err().to_string().contains("Points"));
    assert!(Volume::parse(&with(walls(&[], &[])).to_bytes()).is_ok());
}
