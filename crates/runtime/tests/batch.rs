//! Many positions in one call: the bits of one call each.

mod common;

use common::*;
use gdibl_runtime::bricks::Bricks;
use gdibl_runtime::{Kind, Volume};

/// Places in and around the box, some odd; several in a row close together, as along a path.
fn places(volume: &Volume) -> Vec<([f64; 3], [f32; 3])> {
    let (min, max) = (volume.header().min, volume.header().max);
    let mut places = Vec::new();
    for run in 0..60 {
        let start = [0, 1, 2].map(|axis| f64::from(arbitrary(1, run, 0, axis)));
        for step in 0..1 + run % 7 {
            let along = start.map(|v| -0.1 + 1.2 * v + 0.01 * step as f64);
            let position = [0, 1, 2].map(|k| min[k] + along[k] * (max[k] - min[k]));
            let normal = [[0.0, 1.0, 0.0], [0.6, 0.0, 0.8], [-0.48, -0.8, 0.36]][(run + step) % 3];
            places.push((position, normal));
        }
    }
    for odd in [f64::NAN, f64::INFINITY, -1e300] {
        places.push(([odd; 3], [0.0, 0.0, -1.0]));
        places.push(([min[0], odd, max[2]], [f32::NAN; 3]));
    }
    places.extend((0..volume.node_count()).map(|node| (volume.node_position(node), [1.0, 0.0, 0.0])));
    places
}

fn assert_batches_equal_singles(volume: &Volume) {
    let places = places(volume);
    let bits = |irradiance: [f32; 3]| irradiance.map(f32::to_bits);
    let normals: Vec<[f32; 3]> = places.iter().map(|place| place.1).collect();
    let exact: Vec<[f64; 3]> = places.iter().map(|place| place.0).collect();
    let rounded: Vec<[f32; 3]> = exact.iter().map(|position| position.map(|v| v as f32)).collect();
    // Groups that are full, and not.
    for count in [0, 1, 31, 32, 33, places.len()] {
        let mut found = vec![[7.0; 3]; count];
        volume.irradiance_batch(&exact[..count], &normals[..count], &mut found);
        for (k, found) in found.iter().enumerate() {
            let truth = volume.irradiance_f64(exact[k], normals[k]);
            assert_eq!(bits(*found), bits(truth), "{:?}: {found:?}, {truth:?}", places[k]);
        }
        volume.irradiance_batch(&rounded[..count], &normals[..count], &mut found);
        for (k, found) in found.iter().enumerate() {
            let truth = volume.irradiance(rounded[k], normals[k]);
            assert_eq!(bits(*found), bits(truth), "{:?}: {found:?}, {truth:?}", rounded[k]);
        }
    }
}

fn parse(file: &File) -> Volume {
    Volume::parse(&file.to_bytes()).unwrap()
}

#[test]
fn grids_of_all_bands_and_encodings() {
    let flat = [[1, 3, 3], [4, 1, 3], [4, 3, 1], [1, 1, 1]].map(|counts| grid(counts, 2, 1, 0.5).radiance(pattern));
    for file in arbitrary_grids().iter().chain(&flat).chain([&small_packed()]) {
        assert_batches_equal_singles(&parse(file));
    }
}

#[test]
fn points_and_vertices() {
    for file in [small_points(), small_vertices()] {
        assert_batches_equal_singles(&parse(&file));
    }
}

#[test]
fn grids_with_walls() {
    let cells = [(1, [0, NONE, NONE], 0, [LOW, HIGH, 0, 0, 0, 0, 0, 0]), (5, [0, 1, NONE], 0b1111_0000, [LOW; 8])];
    let walls = walls(&[[1.0, 0.0, 0.0, 2.0], [0.0, 0.6, 0.8, 1.0]], &cells);
    let file = grid([4, 3, 3], 2, 1, 0.5).radiance(pattern).section(walls);
    let volume = parse(&file);
    assert_eq!(volume.walled_cells(), 2);
    assert_batches_equal_singles(&volume);
    assert_batches_equal_singles(&parse(&file.validity(|node| node % 3 > 0)));
}

#[test]
fn sparse_grids() {
    assert_batches_equal_singles(&parse(&small_sparse()));
    for (counts, levels) in [([17, 9, 17], 3), ([17, 1, 9], 2)] {
        let bricks = Bricks::new(counts, levels, |level, cell| {
            level > 1 || arbitrary(levels as usize, cell[0] as usize, cell[1] as usize, cell[2] as usize) < 0.4
        });
        let mut file = grid([bricks.node_count() as u32, 1, 1], 2, 1, 0.5);
        file.kind = 3;
        let file = file.radiance(pattern).section(raw(b"BRIK", bricks.to_bytes()));
        let walls = walls(&[[1.0, 0.0, 0.0, 1.3]], &[(0, [0, NONE, NONE], 0, [LOW, HIGH, 0, 0, 0, 0, 0, 0])]);
        for file in [file.clone(), file.clone().validity(|node| node % 5 > 0), file.section(walls)] {
            let volume = parse(&file);
            assert_eq!(volume.header().kind, Kind::Sparse);
            assert_batches_equal_singles(&volume);
        }
    }
}

#[test]
#[should_panic(expected = "2 positions, 1 normals, 2 answers")]
fn slices_of_different_lengths_panic() {
    let volume = parse(&small_grid());
    volume.irradiance_batch(&[[0.0f32; 3]; 2], &[[0.0; 3]], &mut [[0.0; 3]; 2]);
}
