//! Packed volumes: the error that was asked for is kept, whatever the light.

use gdibl_baker::bake::{BakeSettings, Baked, Nodes};
use gdibl_baker::job::records::{PackingRecord, Records};
use gdibl_baker::pack::{PackSettings, Packed, Precision, pack};
use gdibl_runtime::format::{Codec, parse_header_and_sections};
use gdibl_runtime::{RadianceSh, Volume};

use crate::level::*;

fn packed_of(baked: &Baked, error: f64, dering: bool) -> (Volume, Packed) {
    let settings =
        PackSettings { precision: Precision::Packed { error: Some(error) }, dering, ..PackSettings::default() };
    let packed = pack(&Nodes::Points(places()), baked, Records::default(), settings);
    (Volume::parse(&packed.bytes).expect("what was packed parses"), packed)
}

/// Root mean square over normals and channels of what E is off by, over that of E.
fn error(found: &RadianceSh, truth: &RadianceSh) -> f64 {
    let (found, truth) = (found.convolve().coefficients, truth.convolve().coefficients);
    let pairs = || found.as_flattened().iter().zip(truth.as_flattened()).map(|(&f, &t)| (f64::from(f), f64::from(t)));
    let square: f64 = pairs().map(|(f, t)| (f - t).powi(2)).sum();
    let power: f64 = pairs().map(|(_, t)| t * t).sum();
    if power > 0.0 { (square / power).sqrt() } else { square }
}

/// A few directions per node: much noise, and a pillar that some places lie in.
fn noisy(bands: u32) -> Baked {
    let (scene, probes) = (room_with_pillar(), coloured_probes());
    bake_points(
        &gdibl(&scene, &probes, None),
        &places(),
        &BakeSettings { bands, samples: 16, ..BakeSettings::default() },
    )
}

/// Multiplies the light of each node.
fn scaled(mut baked: Baked, factor: impl Fn(usize, usize) -> f32) -> Baked {
    baked.sh.update(|node, values| {
        values.iter_mut().enumerate().for_each(|(place, value)| *value *= factor(node, place % 3));
    });
    baked
}

fn check(baked: &Baked, asked: f64, what: &str) {
    let (volume, packed) = packed_of(baked, asked, false);
    let PackingRecord { step, added_error } = packed.records.statistics.unwrap().packing.expect("it is packed");
    let mut errors = Vec::new();
    for node in 0..baked.len() {
        let error = error(&volume.node_sh(node), &sh_of(baked, node));
        // The bound for every node, filled ones too, and what f16 adds.
        let numbers = baked.sh.width();
        let most = (0.00136f64.powi(2) + numbers.min(27) as f64 * f64::from(step).powi(2) / 4.0).sqrt();
        assert!(error <= most + 0.5f64.powi(11), "{what}, node {node}: {error} of at most {most}");
        if baked.is_valid(node) {
            errors.push(error);
        }
    }
    errors.sort_by(f64::total_cmp);
    let p95 = errors[(0.95 * errors.len() as f64).ceil() as usize - 1];
    assert!(p95 <= asked * 1.001, "{what}: {p95} of {asked}");
    // As it is reported; the report counts in f16's rounding, which volumes of great contrast are spared.
    let most = errors[errors.len() - 1];
    assert!((added_error.p95 - p95).abs() < 3e-4 && (added_error.max - most).abs() < 3e-4, "{added_error:?}");
    // And no finer than need be.
    assert!(errors.len() < 4 || p95 > 0.5 * asked, "{what}: {p95} of {asked}");
}

#[test]
fn error_asked_for_is_kept_in_every_number_of_bands() {
    for bands in 0..=4 {
        let baked = noisy(bands);
        assert!(baked.valid_nodes().count() > 4);
        for asked in [0.002, 0.005, 0.01, 0.05] {
            check(&baked, asked, &format!("L{bands}"));
        }
    }
}

#[test]
fn error_asked_for_is_kept_in_extreme_light() {
    let baked = || noisy(2);
    let count = baked().len() as i32;
    // From 1e-10 to 1e10 from node to node, all very dark or bright, one channel nearly dark or quite.
    let contrast = |node: usize, _: usize| 10f32.powf(-10.0 + 20.0 * node as f32 / (count - 1) as f32);
    check(&scaled(baked(), contrast), 0.005, "contrast");
    for level in [1e-10, 1e10] {
        check(&scaled(baked(), |_, _| level), 0.005, "level");
    }
    for dark in [0.0, 1e-6] {
        check(&scaled(baked(), |_, channel| if channel == 1 { dark } else { 1.0 }), 0.005, "dark channel");
    }
    // Some nodes black, and all.
    check(&scaled(baked(), |node, _| if node % 3 == 0 { 0.0 } else { 1.0 }), 0.005, "black nodes");
    let (volume, packed) = packed_of(&scaled(baked(), |_, _| 0.0), 0.005, false);
    assert!((0..volume.node_count()).all(|node| volume.node_sh(node) == RadianceSh::zero(2)));
    assert_eq!(packed.records.statistics.unwrap().packing.unwrap().added_error.max, 0.0);
    // Band 0 negative, and gone, as no light leaves it.
    for band_0 in [-1.0, 0.0, 1e-3] {
        let mut odd = baked();
        odd.sh.update(|_, values| values[..3].iter_mut().for_each(|value| *value *= band_0));
        check(&odd, 0.005, "band 0");
    }
}

#[test]
fn packing_twice_gives_the_same_bytes_and_a_larger_error_fewer() {
    let baked = noisy(2);
    let bytes = |precision: Precision| {
        let settings = PackSettings { precision, zstd: true, ..PackSettings::default() };
        pack(&Nodes::Points(places()), &baked, Records::default(), settings).bytes
    };
    let packed = |error: f64| bytes(Precision::Packed { error: Some(error) });
    assert_eq!(packed(0.005), packed(0.005));
    assert!(packed(0.05).len() < packed(0.005).len());
    assert!(packed(0.005).len() < bytes(Precision::F16).len());
}

#[test]
fn a_packed_volume_of_one_node_keeps_the_error() {
    let mut baked = noisy(2);
    let place = (0..baked.len()).find(|&node| baked.is_valid(node)).unwrap();
    let nodes = Nodes::Points(vec![places()[place]]);
    baked.sh = baked.sh.selected([place].into_iter());
    baked.standing = vec![baked.standing[place]];
    baked.moved.clear();
    for all in [&mut baked.coverage, &mut baked.relative_error, &mut baked.worst_error] {
        *all = vec![all[place]];
    }
    let settings = PackSettings { precision: Precision::Packed { error: Some(0.005) }, ..PackSettings::default() };
    let volume = Volume::parse(&pack(&nodes, &baked, Records::default(), settings).bytes).unwrap();
    assert!(error(&volume.node_sh(0), &sh_of(&baked, 0)) <= 0.005);
}

#[test]
fn deringed_light_is_packed_within_the_same_error() {
    // What is directed, three times as strong: it rings.
    let mut baked = noisy(2);
    baked.sh.update(|_, values| values[3..].iter_mut().for_each(|value| *value *= 3.0));
    let exact = {
        let settings = PackSettings { precision: Precision::F32, dering: true, ..PackSettings::default() };
        Volume::parse(&pack(&Nodes::Points(places()), &baked, Records::default(), settings).bytes).unwrap()
    };
    let (volume, packed) = packed_of(&baked, 0.005, true);
    assert!(packed.records.statistics.unwrap().deringing.is_some() && volume.header().is_deringed());
    let mut errors: Vec<f64> =
        baked.valid_nodes().map(|node| error(&volume.node_sh(node), &exact.node_sh(node))).collect();
    errors.sort_by(f64::total_cmp);
    assert!(errors[(0.95 * errors.len() as f64).ceil() as usize - 1] <= 0.005 * 1.001, "{errors:?}");
}

#[test]
fn packing_adds_a_third_of_the_noise_where_nothing_is_asked_for() {
    let mut baked = noisy(2);
    for noise in [0.0, 0.012, 0.03, 0.9] {
        baked.relative_error.fill(noise);
        let packed = pack(&Nodes::Points(places()), &baked, Records::default(), PackSettings::default());
        let added = packed.records.statistics.unwrap().packing.unwrap().added_error.p95;
        let asked = (f64::from(noise) / 3.0).clamp(0.002, 0.1);
        assert!(added <= asked && added > 0.5 * asked, "noise {noise}: {added} of {asked}");
    }
    // Noise that was not measured is taken for that of a good bake.
    assert_eq!(Precision::packed_error(None), 0.005);
}

#[test]
fn packed_files_need_no_library_and_others_no_new_codec() {
    // So many nodes that bits pay.
    let mut baked = noisy(2);
    baked.sh = baked.sh.selected((0..16 * baked.len()).map(|node| node % baked.len()));
    baked.standing = baked.standing.repeat(16);
    baked.moved.clear();
    let Baked { coverage, relative_error, worst_error, systematic_error, .. } = &mut baked;
    for all in [coverage, relative_error, worst_error, systematic_error] {
        *all = all.repeat(16);
    }
    let codecs = |precision: Precision, zstd: bool| {
        let settings = PackSettings { precision, zstd, ..PackSettings::default() };
        let bytes = pack(&Nodes::Points(places().repeat(16)), &baked, Records::default(), settings).bytes;
        let sections = parse_header_and_sections(&bytes).unwrap().sections;
        sections.iter().map(|section| (section.codec, section.stored_size)).collect::<Vec<_>>()
    };
    let bits = codecs(Precision::PACKED, false);
    assert_eq!(bits[0].0, Codec::Bits);
    assert!(bits.iter().all(|(codec, _)| *codec != Codec::Zstd));
    for precision in [Precision::F16, Precision::F32] {
        assert!(codecs(precision, false).iter().all(|(codec, _)| *codec == Codec::Raw));
        assert!(codecs(precision, true).iter().all(|(codec, _)| *codec != Codec::Bits));
    }
    // With zstd each section takes what is smaller.
    for (section, without) in codecs(Precision::PACKED, true).iter().zip(&bits) {
        assert!(section.1 <= without.1, "{section:?} {without:?}");
    }
}

#[test]
fn errors_in_packed_files_are_right_to_a_thirtieth_and_coverage_is_as_it_was() {
    let mut baked = noisy(2);
    for (node, error) in baked.relative_error.iter_mut().enumerate() {
        *error = 10f32.powf((node % 18) as f32 * 0.37 - 3.0);
    }
    baked.relative_error[0] = 0.0;
    baked.relative_error[1] = 65504.0;
    let with = |precision: Precision| {
        let settings = PackSettings { precision, ..PackSettings::default() };
        Volume::parse(&pack(&Nodes::Points(places()), &baked, Records::default(), settings).bytes).unwrap()
    };
    let (packed, exact) = (with(Precision::PACKED), with(Precision::F16));
    for node in 0..baked.len() {
        let [found, truth] = [&packed, &exact].map(|volume| volume.node_relative_error(node).unwrap());
        assert!((found - truth).abs() <= truth / 30.0, "node {node}: {found}, not {truth}");
        assert_eq!(packed.node_coverage(node), exact.node_coverage(node));
    }
    assert_eq!((packed.node_relative_error(0), packed.node_relative_error(1)), (Some(0.0), Some(65504.0)));
}
