//! Packed files as they are read: every number where FORMAT.md says, whatever the numbers.

mod common;

use common::*;
use gdibl_runtime::Volume;

/// The volume, and how far its numbers are off at the most, in half units of f16 of the largest of red, green and blue.
fn check(file: &File, number: impl Fn(usize, usize) -> i16 + Copy) -> (Volume, f64) {
    let volume = Volume::parse(&file.to_bytes()).unwrap();
    let of_bits = Volume::parse(&file.clone().bits().to_bytes()).unwrap();
    let mut worst = 0.0f64;
    for node in 0..file.nodes() {
        let sh = volume.node_sh(node);
        assert_eq!(sh, of_bits.node_sh(node), "node {node}, from packed bits");
        for index in 0..file.planes() / 3 {
            let truth = [0, 1, 2].map(|channel| packed_truth(number, file.scale, node, index, channel));
            let largest = truth.iter().fold(0.0f64, |largest, value| largest.max(value.abs()));
            for (found, truth) in sh.coefficients[index].map(f64::from).into_iter().zip(truth) {
                assert!(found.is_finite());
                assert!(largest > 0.0 || found == 0.0);
                worst = worst.max((found - truth).abs() / largest.max(f64::MIN_POSITIVE) * 2f64.powi(11));
            }
        }
    }
    (volume, worst)
}

#[test]
fn numbers_come_out_as_the_format_says_in_every_number_of_bands_and_block() {
    for bands in 0..=4 {
        for counts in [[1, 1, 1], [63, 1, 1], [8, 16, 1], [13, 5, 1], [9, 5, 6]] {
            let (_, worst) = check(&grid(counts, bands, 2, 0.003).packed(packed_small), packed_small);
            assert!(worst <= 1.001, "L{bands}, {counts:?}: {worst}");
        }
    }
}

/// Of a few octaves, no number 0 but in the dark.
fn packed_small(node: usize, plane: usize) -> i16 {
    match (node, plane) {
        (7, 0) => 0,
        (_, 0) => 16384 + (node * 389 % 1500) as i16,
        _ => ((node * 131 + plane * 29) % 101) as i16 * 2 - 101,
    }
}

#[test]
fn volumes_of_great_contrast_keep_all_of_it() {
    // 2^-60 to 2^60: no f16 with one scale holds that.
    let number = |node: usize, plane: usize| match plane {
        0 => 1024 + 1024 * node as i16,
        _ => packed_small(node, plane),
    };
    let (_, worst) = check(&grid([31, 1, 1], 2, 2, 0.003).packed(number), number);
    assert!(worst < 0.01, "{worst}");
}

#[test]
fn numbers_that_no_light_makes_are_read_all_the_same() {
    // As large as they come, where f16 would overflow.
    let number = |node: usize, plane: usize| match plane {
        0 => [1, 16384, 32767][node],
        _ => [i16::MAX, i16::MIN][(node + plane) % 2],
    };
    for step in [0.5f32.powi(13), 0.01, 1.0] {
        for nodes in [0, 1, 2] {
            let one = move |_: usize, plane: usize| number(nodes, plane);
            check(&grid([1, 1, 1], 4, 2, step).packed(one), one);
        }
        check(&grid([3, 1, 1], 4, 2, step).packed(number), number);
    }
}

#[test]
fn a_dark_volume_is_dark() {
    let number = |_: usize, plane: usize| if plane == 0 { 0 } else { 5 };
    let (volume, _) = check(&grid([3, 3, 3], 2, 2, 0.003).packed(number), number);
    assert_eq!(volume.irradiance([0.0, 1.0, 3.0], [0.0, 1.0, 0.0]), [0.0; 3]);
}
