//! Several volumes as one: continuous light, the finer one first, the nearest outside.

mod common;

use common::*;
use gdibl_runtime::{Volume, VolumeSet};

const UP: [f32; 3] = [0.0, 1.0, 0.0];
const COARSE: f64 = 1.0;
const FINE: f64 = 0.25;

/// A box with nodes `spacing` apart, whose light is `level` and a slope.
fn volume(min: [f64; 3], max: [f64; 3], spacing: f64, level: f32) -> Volume {
    let counts = [0, 1, 2].map(|k| ((max[k] - min[k]) / spacing).round() as u32 + 1);
    let file = File { min, max, ..grid(counts, 1, 0, 1.0) };
    let slope = move |node: usize| node as f32 / 500.0;
    Volume::parse(&file.radiance(|node, index, _| if index == 0 { level + slope(node) } else { 0.1 }).to_bytes())
        .unwrap()
}

/// A hall, a fine box in it, a fine one that stands out of it, a fine one in its corner, one beside it and one far off.
fn boxes() -> Vec<([f64; 3], [f64; 3], f64)> {
    vec![
        ([2.0, 1.0, 2.0], [4.0, 3.0, 4.0], FINE),
        ([7.0, 0.0, 3.0], [10.0, 2.0, 5.0], FINE),
        ([0.0, 0.0, 0.0], [1.0, 1.0, 1.0], FINE),
        ([0.0, 0.0, 0.0], [8.0, 4.0, 8.0], COARSE),
        ([0.0, 4.0, 0.0], [8.0, 8.0, 8.0], COARSE),
        ([14.0, 0.0, 0.0], [16.0, 2.0, 2.0], COARSE),
    ]
}

fn volumes() -> Vec<(Volume, f64)> {
    let light = |i: usize| 2.0 + 5.0 * (i as f32 * 2.0 % 5.0);
    boxes()
        .into_iter()
        .enumerate()
        .map(|(i, (min, max, spacing))| (volume(min, max, spacing, light(i)), spacing))
        .collect()
}

fn set() -> VolumeSet {
    VolumeSet::new(volumes()).unwrap()
}

/// All over the boxes and around them.
fn places() -> impl Iterator<Item = [f64; 3]> {
    (0..4000).map(|i| [0, 1, 2].map(|k| -3.0 + 22.0 * f64::from(arbitrary(i, k, 0, 0))))
}

/// Places on all six faces of all boxes, with the axis of the face.
fn borders() -> Vec<([f64; 3], usize)> {
    let mut places = Vec::new();
    for (min, max, _) in boxes() {
        for i in 0..600 {
            let (axis, high) = (i % 3, i / 3 % 2 == 1);
            let mut place = [0, 1, 2].map(|k| min[k] + (max[k] - min[k]) * f64::from(arbitrary(i, k, 1, 0)));
            place[axis] = if high { max[axis] } else { min[axis] };
            places.push((place, axis));
        }
    }
    places
}

fn moved(mut place: [f64; 3], axis: usize, by: f64) -> [f64; 3] {
    place[axis] += by;
    place
}

#[test]
fn light_is_continuous_across_all_borders() {
    let (set, alone) = (set(), volumes());
    let red = |place| set.irradiance_f64(place, UP)[0];
    let mut apart = 0.0f32;
    for (place, axis) in borders() {
        for step in [1e-4, 1e-6] {
            let [below, above] = [-step, step].map(|by| red(moved(place, axis, by)));
            // The least width is an eighth of a metre and lights differ by less than 70; two volumes may give way at once.
            let most = 4.0 * 70.0 / 0.125 * 2.0 * step as f32 + 2e-4;
            assert!((above - below).abs() <= most, "{place:?} along {axis} by {step}: {below} {above}");
        }
        let lights = alone.iter().map(|(volume, _)| volume.irradiance_f64(place, UP)[0]);
        apart = apart.max(lights.clone().fold(0.0, f32::max) - lights.fold(f32::MAX, f32::min));
    }
    assert!(apart > 10.0, "one could tell the volumes apart: {apart}");
}

#[test]
fn light_is_continuous_everywhere_also_far_from_borders() {
    let set = set();
    for (i, place) in places().enumerate() {
        let step = 1e-5;
        let [here, there] = [0.0, step].map(|by| set.irradiance_f64(moved(place, i % 3, by), UP)[0]);
        assert!((there - here).abs() <= 4.0 * 70.0 / 0.125 * step as f32 + 2e-4, "{place:?}: {here} {there}");
    }
}

#[test]
fn shares_are_in_the_sets_order_and_add_up_to_one() {
    let set = set();
    let mut several = 0;
    for place in places().chain(borders().into_iter().map(|(place, _)| place)) {
        let shares: Vec<_> = set.shares(place).collect();
        let sum: f32 = shares.iter().map(|share| share.weight).sum();
        assert!((sum - 1.0).abs() < 1e-6, "{place:?}: {shares:?}");
        assert!(shares.iter().all(|share| share.weight > 0.0));
        assert!(shares.is_sorted_by_key(|share| share.volume));
        several += usize::from(shares.len() > 1);
    }
    assert!(several > 100, "{several} places between volumes");
}

#[test]
fn one_spacing_inside_its_border_the_finer_volume_is_alone_and_on_it_the_coarser() {
    let (set, fine, coarse) = (set(), &volumes()[0].0, &volumes()[3].0);
    let at = |x: f64| [x, 2.0, 3.0];
    for x in [2.0 + FINE, 2.5, 3.0, 4.0 - FINE] {
        assert_eq!(set.irradiance_f64(at(x), UP), fine.irradiance_f64(at(x), UP), "{x}");
    }
    for x in [1.5, 2.0, 4.0, 4.5] {
        assert_eq!(set.irradiance_f64(at(x), UP), coarse.irradiance_f64(at(x), UP), "{x}");
    }
    // Half a spacing inside: half of each.
    let x = 2.0 + 0.5 * FINE;
    let [found, a, b] =
        [set.irradiance_f64(at(x), UP), fine.irradiance_f64(at(x), UP), coarse.irradiance_f64(at(x), UP)]
            .map(|rgb| rgb[0]);
    assert!((found - 0.5 * (a + b)).abs() < 1e-4, "{found} {a} {b}");
}

#[test]
fn at_a_border_that_nothing_reaches_beyond_the_finer_volume_still_wins() {
    let (set, fine) = (set(), &volumes()[2].0);
    for place in [[0.0, 0.5, 0.5], [0.0, 0.0, 0.0], [0.01, 0.3, 0.6], [-1.0, 0.5, 0.5], [-0.1, -0.1, -0.1]] {
        assert_eq!(set.irradiance_f64(place, UP), fine.irradiance_f64(place, UP), "{place:?}");
    }
}

#[test]
fn outside_all_boxes_the_nearest_volume_answers_as_it_does_alone() {
    let (set, alone) = (set(), volumes());
    for (place, nearest) in
        [([20.0, 1.0, 1.0], 5), ([12.0, 1.0, 4.0], 1), ([4.0, 30.0, 4.0], 4), ([13.5, -1.0, 1.0], 5)]
    {
        let sample = set.sample_f64(place, UP);
        assert!(!sample.inside);
        assert_eq!(set.irradiance_f64(place, UP), alone[nearest].0.irradiance_f64(place, UP), "{place:?}");
    }
}

#[test]
fn a_sample_is_the_irradiance_of_all_normals_and_inside_any_box() {
    let set = set();
    for (i, place) in places().enumerate() {
        let normal = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.6, 0.8]][i % 3];
        let sample = set.sample_f64(place, normal);
        let [found, expected] = [sample.sh.convolve().evaluate(normal), set.irradiance_f64(place, normal)];
        assert!(
            found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-4 * (1.0 + b.abs())),
            "{found:?} {expected:?}"
        );
        let inside = boxes().iter().any(|(min, max, _)| (0..3).all(|k| (min[k]..=max[k]).contains(&place[k])));
        assert_eq!(sample.inside, inside, "{place:?}");
        assert_eq!(sample.validity, set.shares(place).map(|share| share.weight).sum::<f32>());
    }
}

#[test]
fn a_set_of_one_is_that_volume_bit_by_bit() {
    let (alone, spacing) = volumes().remove(0);
    let set = VolumeSet::new([(alone.clone(), spacing)]).unwrap();
    let positions: Vec<[f64; 3]> = places().collect();
    let normals = vec![UP; positions.len()];
    let [mut found, mut expected] = [vec![[0.0; 3]; positions.len()], vec![[0.0; 3]; positions.len()]];
    set.irradiance_batch(&positions, &normals, &mut found);
    alone.irradiance_batch(&positions, &normals, &mut expected);
    assert_eq!(found, expected);
    for place in positions {
        assert_eq!(set.irradiance_f64(place, UP), alone.irradiance_f64(place, UP));
        assert_eq!(set.sample_f64(place, UP), alone.sample_f64(place, UP));
    }
}

#[test]
fn many_at_once_are_the_same_as_one_by_one() {
    let set = set();
    let positions: Vec<[f64; 3]> = places().collect();
    let mut found = vec![[0.0; 3]; positions.len()];
    set.irradiance_batch(&positions, &vec![UP; positions.len()], &mut found);
    for (place, found) in positions.into_iter().zip(found) {
        assert_eq!(found, set.irradiance_f64(place, UP));
    }
}

#[test]
fn every_input_has_an_answer() {
    let set = set();
    for odd in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300, f64::MAX, -0.0] {
        for place in [[odd, 1.0, 1.0], [1.0, odd, 1.0], [odd; 3]] {
            let sum: f32 = set.shares(place).map(|share| share.weight).sum();
            assert!((sum - 1.0).abs() < 1e-6, "{place:?}: {sum}");
            assert!(set.irradiance_f64(place, UP).iter().all(|e| e.is_finite()), "{place:?}");
        }
    }
    // A flat box counts on its plane.
    let flat = volume([0.0, 1.0, 0.0], [4.0, 1.0, 4.0], 1.0, 9.0);
    let thick = volume([0.0, 0.0, 0.0], [4.0, 4.0, 4.0], 2.0, 1.0);
    let set = VolumeSet::new([(flat, 1.0), (thick.clone(), 2.0)]).unwrap();
    assert_eq!(set.irradiance_f64([2.0, 2.0, 2.0], UP), thick.irradiance_f64([2.0, 2.0, 2.0], UP));
    assert!(set.shares([2.0, 1.0, 2.0]).all(|share| share.weight.is_finite()));
}

#[test]
fn what_is_no_set_is_refused() {
    let refused = |volumes: Vec<(Volume, f64)>, words: &str| {
        let error = VolumeSet::new(volumes).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    };
    refused(Vec::new(), "at least one");
    let one = || volumes().remove(0).0;
    for spacing in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        refused(vec![(one(), 1.0), (one(), spacing)], "volume 1 of the set");
    }
    let points = Volume::parse(&small_points().to_bytes()).unwrap();
    refused(vec![(points, 1.0)], "Points");
}
