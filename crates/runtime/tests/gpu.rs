//! A volume as buffers for shaders: every number is where the module's documentation says. That shaders make light of them
//! is shown in crates/shader-tests.

mod common;

use common::*;
use gdibl_runtime::gpu::GpuBuffers;
use gdibl_runtime::half::f16_to_f32;
use gdibl_runtime::walls::{Plane, WallCell, walls_to_bytes};
use gdibl_runtime::{Error, Volume};

fn buffers(file: &File) -> (Volume, GpuBuffers) {
    let volume = Volume::parse(&file.to_bytes()).unwrap();
    let buffers = volume.gpu_buffers().unwrap();
    (volume, buffers)
}

/// Number `value` of node `node`, where rows have so many words.
fn coefficient(buffers: &GpuBuffers, words: usize, node: usize, value: usize) -> f32 {
    let word = buffers.coefficients[node * words + value / 2];
    let scale = f32::from_le_bytes(buffers.header[12..16].try_into().unwrap());
    f16_to_f32((word >> (16 * (value % 2))) as u16) * scale
}

#[test]
fn header_has_the_documented_bytes() {
    let (_, buffers) = buffers(&small_grid());
    let mut expected = floats([0.25, 2.0 / 1.5, 0.0, 0.5]);
    [2u32, 3, 1, 1].iter().for_each(|word| expected.extend(word.to_le_bytes()));
    expected.extend(floats([4.0, 1.5, 3.0, 0.0]));
    expected.extend([1, 0, 0, 0]);
    expected.extend([0; 12]); // no sparse grid, and no step
    assert_eq!(buffers.header[..], expected);
    assert_eq!(buffers.min, [-1.0, 0.5, 2.0]);
}

#[test]
fn coefficients_of_f16_files_go_over_bit_by_bit_and_bands_above_2_are_left_out() {
    for (bands, words) in [(0, 2), (1, 6), (2, 14), (3, 14), (4, 14)] {
        let (volume, buffers) = buffers(&grid([3, 2, 2], bands, 1, 0.25).radiance(pattern));
        assert_eq!(buffers.coefficients.len(), 12 * words);
        assert_eq!(buffers.header[28], bands.min(2) as u8);
        let count = 3 * (bands.min(2) as usize + 1).pow(2);
        for node in 0..12 {
            let truth = volume.node_sh(node);
            for (value, truth) in truth.coefficients.as_flattened()[..count].iter().enumerate() {
                assert_eq!(coefficient(&buffers, words, node, value), *truth, "L{bands}, node {node}, value {value}");
            }
            if count % 2 == 1 {
                assert_eq!(coefficient(&buffers, words, node, count), 0.0);
            }
        }
    }
}

#[test]
fn coefficients_of_f32_files_are_off_by_no_more_than_stated() {
    // From 1e-30 of the largest to the largest, of either sign; all dark; hardly any light; as much as an f32 holds.
    let spread = |node: usize, i: usize, c: usize| {
        let value = 10f32.powi(-(((node * 27 + i * 3 + c) % 31) as i32)) * 1.234_567;
        if c == 1 { -value } else { value }
    };
    for factor in [1.0, 3e4, 0.0, 1e-38, f32::MAX / 2.0] {
        let file = grid([3, 3, 2], 2, 0, 1.0).radiance(|node, i, c| factor * spread(node, i, c));
        let (volume, buffers) = buffers(&file);
        let all = |node: usize| volume.node_sh(node).coefficients;
        let largest = (0..18).flat_map(|node| all(node).as_flattened().to_vec()).fold(0.0, |a: f32, b| a.max(b.abs()));
        for node in 0..18 {
            for (value, &truth) in all(node).as_flattened()[..27].iter().enumerate() {
                let error = f64::from(coefficient(&buffers, 14, node, value)) - f64::from(truth);
                // Below 2⁻¹⁰⁰ the scale follows no more: f16's least step times that.
                let floor = (f64::from(largest) * 0.5f64.powi(39)).max(0.5f64.powi(125));
                let bound = (f64::from(truth.abs()) * 0.5f64.powi(11)).max(floor);
                assert!(error.abs() <= bound, "{truth:e}, off by {error:e} of {bound:e}");
            }
        }
    }
}

/// Numbers as the packer makes them: number 1 is 0. Node 70 is dark.
fn numbers(node: usize, plane: usize) -> i16 {
    match (node, plane) {
        (70, 0) => 0,
        (_, 0) => 16384 + (node * 389 % 1500) as i16,
        (_, 1) => 0,
        _ => (node * 131 + plane * 29) as i16 % 101 * 2 - 101,
    }
}

#[test]
fn packed_coefficients_are_the_files_numbers_in_the_documented_bits() {
    for (bands, counts) in [(0, [5, 5, 4]), (1, [1, 1, 1]), (2, [5, 5, 4]), (2, [8, 8, 2]), (4, [9, 1, 1])] {
        let file = grid(counts, bands, 2, 0.004).packed(numbers);
        let volume = Volume::parse(&file.to_bytes()).unwrap();
        let buffers = volume.gpu_buffers_packed(volume.header().scale).unwrap();
        assert_eq!(buffers.header[60..64], 0.004f32.to_le_bytes());
        assert_eq!(buffers.header[12..16], 1f32.to_le_bytes());
        let words = &buffers.coefficients;
        let count = 1 + 3 * (bands.min(2) as usize + 1).pow(2);
        let mut end = file.nodes().div_ceil(64) * (count + 2);
        for node in 0..file.nodes() {
            let head = &words[node / 64 * (count + 2)..][..count + 2];
            if node % 64 == 0 {
                assert_eq!(head[0] as usize, end);
                end += (head[1] as usize * (file.nodes() - node).min(64)).div_ceil(32);
            }
            let mut at = 32 * head[0] as usize + node % 64 * head[1] as usize;
            for plane in 0..count {
                let (least, width) = (head[2 + plane] as i16, head[2 + plane] >> 16);
                let bits: u32 = (0..width as usize).map(|k| (words[(at + k) / 32] >> ((at + k) % 32) & 1) << k).sum();
                at += width as usize;
                let expected = if numbers(node, 0) > 0 { numbers(node, plane) } else { 0 };
                assert_eq!(i32::from(least) + bits as i32, i32::from(expected), "L{bands}, node {node}, plane {plane}");
            }
        }
        assert_eq!((words.len(), words[end]), (end + 1, 0));
    }
}

#[test]
fn marks_and_walls_have_the_documented_bits() {
    // 90 nodes: three blocks of 32. Cells with walls in the first and the second block.
    let plane = |x: f32| Plane { normal: [1.0, 0.0, 0.0], distance: x };
    let cell = |cell: u32, planes: [u16; 3]| WallCell {
        cell,
        planes,
        masks: [1, 2, 3, 4, 5, 6, 7, 8 + cell as u8],
        ends: 0x80 | cell as u8,
    };
    let none = WallCell::NO_PLANE;
    let cells = [cell(2, [0, none, none]), cell(31, [1, 0, none]), cell(32, [0, 1, 1]), cell(46, [1, none, none])];
    let is_valid = |node: usize| node != 5 && node != 31 && node != 64;
    let file = grid([6, 5, 3], 0, 1, 1.0)
        .radiance(pattern)
        .validity(is_valid)
        .section(raw(b"WALL", walls_to_bytes(&[plane(0.25), plane(2.0)], &cells)));
    let (volume, buffers) = buffers(&file);
    assert_eq!(volume.walled_cells(), 4);
    assert_eq!(buffers.header[48], 1);
    // 1e-4 of the least distance between nodes: 1.5 m / 4.
    assert_eq!(buffers.header[44..48], (0.375f32 * 1e-4).to_le_bytes());

    assert_eq!(buffers.marks.len(), 9);
    for node in 0..90 {
        let bit = |word: usize| buffers.marks[node / 32 * 3 + word] >> (node % 32) & 1 == 1;
        assert_eq!(bit(0), is_valid(node), "{node}");
        assert_eq!(bit(1), [2, 31, 32, 46].contains(&node), "{node}");
    }
    assert_eq!([2, 5, 8].map(|word| buffers.marks[word]), [2, 4, 6]);

    assert_eq!(buffers.walls.len(), 6);
    assert_eq!(buffers.walls[1].map(f32::from_bits), [1.0, 0.0, 0.0, 2.0]);
    assert_eq!(buffers.walls[2], [0xffff_0000, 0x0082_ffff, 0x0403_0201, 0x0a07_0605]);
    assert_eq!(buffers.walls[4], [0x0001_0000, 0x00a0_0001, 0x0403_0201, 0x2807_0605]);
}

#[test]
fn no_buffer_is_empty_and_nothing_is_marked_where_all_are_valid() {
    let (_, buffers) = buffers(&grid([1, 1, 1], 0, 1, 1.0).radiance(pattern));
    assert_eq!(buffers.header[48], 0);
    assert_eq!((buffers.coefficients.len(), buffers.marks.len(), buffers.walls.len()), (2, 3, 1));
    assert_eq!(buffers.header[..12], [0; 12]);
}

#[test]
fn points_and_vertices_are_refused() {
    for file in [small_points(), small_vertices()] {
        let volume = Volume::parse(&file.to_bytes()).unwrap();
        for error in [volume.gpu_buffers(), volume.gpu_buffers_packed(0.01)].map(Result::unwrap_err) {
            assert!(matches!(error, Error::Unsupported(_)) && error.to_string().contains("a grid"), "{error}");
        }
    }
}
