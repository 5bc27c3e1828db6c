//! Matching exposures: gains of known truth, and probes that are not where they are said to be.

use gdibl_baker::exposure::{ExposureMatch, match_exposure};
use gdibl_baker::import::gltf::{GltfOptions, read_level};
use gdibl_baker::import::image::{ReadOptions, read_image};
use gdibl_baker::panorama::{Mapping, Panorama, to_lat_long};
use gdibl_baker::radiance::gdibl::Probe;
use gdibl_baker::sampling::{Sampler, Stream};
use gdibl_baker::scene::{Role, Scene};
use glam::{DVec3, Quat};
use std::path::Path;

use crate::level::*;

/// The shipped box and its three probes, rightly exposed.
fn shipped_box() -> (Scene, Vec<Probe>) {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets/uffizi-box"));
    let scene = read_level(&folder.join("empty-box.glb"), &GltfOptions::default()).unwrap();
    let read = |index| {
        let name = format!("probe_{index}.exr");
        let imported = read_image(&folder.join(&name), &ReadOptions::default()).unwrap();
        Probe {
            name,
            position: imported.pose.position.unwrap(),
            rotation: imported.pose.rotation.unwrap_or_default().as_quat(),
            exposure_stops: 0.0,
            panorama: to_lat_long(&imported.image, Mapping::LatLong, None),
        }
    };
    (scene, (0..3).map(read).collect())
}

/// As a camera would have taken them.
fn without_distances(probes: &[Probe]) -> Vec<Probe> {
    let plain = |p: &Panorama| Panorama::new(p.width(), p.height(), p.pixels().collect(), None);
    probes.iter().map(|probe| Probe { panorama: plain(&probe.panorama), ..probe.clone() }).collect()
}

fn exposed(probe: &mut Probe, stops: [f32; 3]) {
    let gain = stops.map(f32::exp2);
    probe.panorama = probe.panorama.with_pixels(|_, pixel| [0, 1, 2].map(|c| pixel[c] * gain[c]));
}

/// Largest of |gain · wrong exposure - 1| over probes and channels.
fn worst_gain(matched: &ExposureMatch, wrong: &[[f32; 3]]) -> f64 {
    let product = |probe: usize, c: usize| (matched.probes[probe].stops[c] + f64::from(wrong[probe][c])).exp2();
    let each = (0..wrong.len()).flat_map(|probe| [0, 1, 2].map(|c| (product(probe, c) - 1.0).abs()));
    each.fold(0.0, f64::max)
}

fn suspects(matched: &ExposureMatch) -> Vec<&str> {
    matched.probes.iter().filter(|probe| probe.suspect.is_some()).map(|probe| probe.name.as_str()).collect()
}

/// One for all channels, and one for each. The median of every channel is 0, as the gauge has it.
const WRONG: [[[f32; 3]; 3]; 2] =
    [[[1.0; 3], [-0.5; 3], [0.0; 3]], [[1.0, 0.0, -0.3], [0.0, 0.4, 2.0], [-0.5, -0.2, 0.0]]];

#[test]
fn gains_of_the_shipped_box_are_recovered_per_channel() {
    let (scene, right) = shipped_box();
    for (distances, right) in [(true, right.clone()), (false, without_distances(&right))] {
        for wrong in WRONG {
            let mut probes = right.clone();
            probes.iter_mut().zip(wrong).for_each(|(probe, stops)| exposed(probe, stops));
            let matched = match_exposure(&scene, &probes);
            let worst = worst_gain(&matched, &wrong);
            println!("distances {distances}, {wrong:?}: {:.2} %", worst * 100.0);
            assert!(worst < 0.01, "{worst}");
            assert_eq!(suspects(&matched), [""; 0], "exposure is no misplacement");
            assert_eq!(matched.group_count(), 1);
            assert!(
                matched.pairs.iter().all(|pair| pair.stops_left.iter().all(|left| left.abs() < 0.03)),
                "{matched:?}"
            );
            // Standard errors are honest: no gain is off by more than five of them.
            for (probe, wrong) in matched.probes.iter().zip(wrong) {
                let errors = probe.standard_error_stops.unwrap();
                for c in 0..3 {
                    let off = (probe.stops[c] + f64::from(wrong[c])).abs();
                    assert!(off < 5.0 * errors[c] && errors[c] < 0.02, "{} {off} {}", probe.name, errors[c]);
                }
            }
            // Applied, nothing is left to match.
            matched.apply(&mut probes);
            let again = match_exposure(&scene, &probes);
            assert!(worst_gain(&again, &[[0.0; 3]; 3]) < 1e-4, "{again:?}");
        }
    }
}

#[test]
fn gains_withstand_noise_and_a_tenth_of_wrong_pixels() {
    let (scene, right) = shipped_box();
    let wrong = WRONG[1];
    for (noise, outliers, most) in [(0.02f32, 0.0, 0.01), (0.02, 0.1, 0.02)] {
        let mut probes = without_distances(&right);
        for (index, (probe, stops)) in probes.iter_mut().zip(wrong).enumerate() {
            exposed(probe, stops);
            let stream = Stream::new(Sampler::Random, 11, index as u64, 0);
            probe.panorama = probe.panorama.with_pixels(|i, pixel| {
                let sum = (0..6).flat_map(|pair| stream.point(i as u32, pair)).sum::<f32>();
                let [chance, size] = stream.point(i as u32, 6);
                // Highlights, one-sided: twice to eight times as bright.
                let highlight = if f64::from(chance) < outliers { 2.0 + 6.0 * size } else { 1.0 };
                pixel.map(|v| v * (1.0 + noise * (sum - 6.0)).max(0.0) * highlight)
            });
        }
        let matched = match_exposure(&scene, &probes);
        let worst = worst_gain(&matched, &wrong);
        println!("noise {noise}, outliers {outliers}: {:.2} %, {} points", worst * 100.0, matched.point_count());
        assert!(worst < most, "{worst}");
        assert_eq!(suspects(&matched), [""; 0]);
    }
}

#[test]
fn misplaced_or_turned_probe_is_named_and_no_other() {
    let (scene, right) = shipped_box();
    for (distances, right) in [(true, right.clone()), (false, without_distances(&right))] {
        assert_eq!(suspects(&match_exposure(&scene, &right)), [""; 0]);
        for index in 0..3 {
            let check = |case: String, change: &dyn Fn(&mut Probe)| {
                let mut probes = right.clone();
                // Its exposure is wrong as well.
                exposed(&mut probes[index], [1.0, 0.8, 1.1]);
                change(&mut probes[index]);
                let matched = match_exposure(&scene, &probes);
                let found = suspects(&matched);
                assert_eq!(found, [probes[index].name.as_str()], "{case}, distances {distances}: {:#?}", matched);
            };
            for shift in [DVec3::X, DVec3::Y, DVec3::Z, -DVec3::X, -DVec3::Y, -DVec3::Z] {
                check(format!("moved by {}", 0.5 * shift), &|probe| probe.position += 0.5 * shift);
            }
            for degrees in [5.0f32, -5.0] {
                let turn = Quat::from_rotation_y(degrees.to_radians());
                check(format!("turned by {degrees}"), &|probe| probe.rotation = turn * probe.rotation);
            }
        }
    }
}

#[test]
fn findings_tell_gains_residuals_and_suspects() {
    let (scene, mut probes) = shipped_box();
    exposed(&mut probes[0], [1.0; 3]);
    probes[2].position.z += 0.5;
    let findings = match_exposure(&scene, &probes).findings();
    let of = |id: &str| findings.iter().filter(|f| f.id == id).map(|f| f.message.as_str()).collect::<Vec<_>>();
    assert_eq!(of("matched-exposure").len(), 3);
    assert!(of("matched-exposure")[0].starts_with("probe_0.exr: exposure changed by -0.9"), "{findings:#?}");
    assert!(of("suspect-probe").len() == 1 && of("suspect-probe")[0].starts_with("probe_2.exr: "), "{findings:#?}");
    assert!(of("exposure-residual")[0].contains("probe_1.exr and probe_2.exr"), "{findings:#?}");
    assert!(of("unmatched-exposure").is_empty() && of("exposure-groups").is_empty());
}

#[test]
fn one_wrong_exposure_among_right_ones_moves_alone() {
    let scene = room_with_pillar();
    for count in [3, 4, 5] {
        let places = [[-2.0, 0.2, -1.0], [1.8, 1.1, 1.7], [2.0, -0.3, -1.2], [-1.5, 1.0, 1.5], [0.1, 1.4, -0.7]];
        let mut probes: Vec<Probe> = places[..count].iter().map(|at| single(*at, 64, [0.5, 0.7, 0.2])).collect();
        exposed(&mut probes[1], [-2.0, -1.0, 3.0]);
        let matched = match_exposure(&scene, &probes);
        for (index, probe) in matched.probes.iter().enumerate() {
            let expected = if index == 1 { [2.0, 1.0, -3.0] } else { [0.0; 3] };
            let off = (0..3).map(|c| (probe.stops[c] - expected[c]).abs()).fold(0.0, f64::max);
            assert!(off < 1e-5, "{count} probes: {matched:?}");
        }
        // The mean of the channels is exposure, the rest in the pixels.
        matched.apply(&mut probes);
        assert!(
            probes.iter().all(|probe| (probe.panorama.pixel(3, 5) * probe.exposure_stops.exp2() - 0.5).x.abs() < 1e-5)
        );
        assert!((probes[1].exposure_stops - 0.0).abs() < 1e-5, "2 + 1 - 3 stops: {}", probes[1].exposure_stops);
    }
}

#[test]
fn exposures_are_matched_whatever_the_probes_are() {
    let scene = room_with_pillar();
    let unmatched = |matched: &ExposureMatch| {
        matched.probes.iter().map(|probe| probe.standard_error_stops.is_none()).collect::<Vec<_>>()
    };
    let at = [-2.0, 0.2, -1.0];
    let one = match_exposure(&scene, &[single(at, 64, [0.5; 3])]);
    assert_eq!((unmatched(&one), one.probes[0].stops, one.findings()), (vec![true], [0.0; 3], vec![]));
    assert!(match_exposure(&scene, &[]).probes.is_empty());
    // Two at one place share the difference.
    let twins = match_exposure(&scene, &[single(at, 64, [0.5; 3]), single(at, 64, [2.0; 3])]);
    assert!(worst_gain(&twins, &[[-1.0; 3], [1.0; 3]]) < 1e-5, "{twins:?}");
    // A black probe tells nothing, nor does one channel that is black.
    let others =
        [single(at, 64, [0.5; 3]), single([1.8, 1.1, 1.7], 64, [1.0; 3]), single([2.0, -0.3, -1.2], 64, [0.0; 3])];
    let matched = match_exposure(&scene, &others);
    assert_eq!(unmatched(&matched), [false, false, true]);
    assert!(worst_gain(&matched, &[[-0.5; 3], [0.5; 3], [0.0; 3]]) < 1e-5, "{matched:?}");
    assert_eq!(matched.findings().iter().filter(|f| f.id == "unmatched-exposure").count(), 1);
    let red = match_exposure(&scene, &[single(at, 64, [0.5, 0.0, 0.0]), single([1.8, 1.1, 1.7], 64, [1.0, 0.0, 0.0])]);
    assert!(worst_gain(&red, &[[-0.5; 3], [0.5; 3]]) < 1e-5, "{red:?}");
    assert!(red.pairs[0].stops[1].is_nan());
    // Clipped everywhere; no level.
    let clipped = [single(at, 64, [65_504.0; 3]), single([1.8, 1.1, 1.7], 64, [65_504.0; 3])];
    assert_eq!(unmatched(&match_exposure(&scene, &clipped)), [true, true]);
    assert_eq!(unmatched(&match_exposure(&Scene::default(), &others)), [true, true, true]);
}

#[test]
fn rooms_without_a_view_of_each_other_are_matched_for_themselves() {
    let mut scene = Scene::default();
    for x in [0.0, 10.0] {
        add(&mut scene, Role::Environment, &box_of(DVec3::new(x, 0.0, 0.0), DVec3::new(x + 4.0, 3.0, 4.0)));
    }
    let of = |x: f64, light| single([x, 1.2, 1.7], 64, [light; 3]);
    let probes = [of(1.0, 0.5), of(11.0, 4.0), of(3.0, 1.0), of(13.0, 1.0)];
    let matched = match_exposure(&scene, &probes);
    assert_eq!(
        matched.probes.iter().map(|probe| probe.group).collect::<Vec<_>>(),
        [Some(0), Some(1), Some(0), Some(1)]
    );
    assert!(worst_gain(&matched, &[[-0.5; 3], [1.0; 3], [0.5; 3], [-1.0; 3]]) < 1e-5, "{matched:?}");
    assert!(matched.findings().iter().any(|finding| finding.id == "exposure-groups"));
}

#[test]
fn matching_does_not_depend_on_the_number_of_threads() {
    let (scene, mut probes) = shipped_box();
    exposed(&mut probes[1], [0.3, 0.4, 0.5]);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| match_exposure(&scene, &probes))
    };
    let one = on(1);
    assert_eq!(on(2), one);
    assert_eq!(on(7), one);
}
