use super::*;
use crate::analyse::{CompareSettings, Truth, TruthLight, TruthNoise, compare, radiance_sh};
use crate::bake::{Baked, Nodes};
use crate::pack::volume_of;
use crate::rows::Table;
use crate::sampling::{Sampler, Stream};
use gdibl_runtime::RadianceSh;
use glam::DVec3;

const PLACES: usize = 400;

/// Normal numbers by Box and Muller, from a fixed sequence.
fn normal_numbers(seed: u64) -> impl FnMut() -> f64 {
    let stream = Stream::new(Sampler::Random, seed, 0, 0);
    let mut sample = 0;
    move || {
        sample += 1;
        let [u, v] = stream.point(sample, 0).map(f64::from);
        (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }
}

fn light(place: usize) -> RadianceSh {
    let value = |i: usize| ((place * 31 + i * 17) % 23) as f32 / 23.0;
    radiance_sh(2, (0..9).map(|i| [0, 1, 2].map(|c| value(3 * i + c) + if i == 0 { 2.0 } else { 0.0 })))
}

/// Light of every place times `scale`, with noise of that standard error in every coefficient, alike in R, G and B (as
/// where white light is noisy).
fn noisy(scale: f32, standard_error: f32, seed: u64) -> Vec<RadianceSh> {
    let mut normal = normal_numbers(seed);
    let place = |place| {
        let light = light(place);
        radiance_sh(
            2,
            (0..9).map(|i| {
                let noise = standard_error * normal() as f32;
                light.coefficients[i].map(|v| scale * v + noise)
            }),
        )
    };
    (0..PLACES).map(place).collect()
}

fn positions() -> Vec<[f64; 3]> {
    (0..PLACES).map(|i| [i as f64, 0.0, 0.0]).collect()
}

fn volume(light: &[RadianceSh]) -> Volume {
    let sh = light.iter().flat_map(|l| l.coefficients[..9].to_vec()).flatten().collect();
    let baked = Baked { relative_error: vec![0.01; PLACES], ..Baked::of_rows(2, Table::held(27, sh)) };
    volume_of(&Nodes::Points(positions().into_iter().map(DVec3::from).collect()), &baked)
}

fn truth(standard_error: f32) -> Truth {
    Truth {
        name: "truth".into(),
        level: String::new(),
        positions: positions(),
        normals: Vec::new(),
        valid: Vec::new(),
        light: TruthLight::Radiance(noisy(1.0, standard_error, 999)),
        noise: TruthNoise::Radiance(vec![radiance_sh(2, [[standard_error; 3]; 9]); PLACES]),
    }
}

fn cost(cpu_seconds: f64) -> Cost {
    Cost { cpu_seconds, wall_seconds: 0.5 * cpu_seconds, setup_seconds: 0.1, rays: 30, samples: 10 }
}

fn repeats(scale: f32, standard_error: f32, count: u64) -> Vec<Repeat> {
    let repeat = |seed| Repeat {
        volume: volume(&noisy(scale, standard_error, seed)),
        cost: cost(1.0 + seed as f64),
        seen: None,
        bytes: 7,
    };
    (0..count).map(repeat).collect()
}

#[test]
fn error_of_each_repeat_is_what_compare_says() {
    let truth = [truth(0.02)];
    let repeats = repeats(1.03, 0.05, 3);
    let point = measure(64, PLACES, &truth, &repeats).unwrap();
    let errors: Vec<f64> = repeats
        .iter()
        .map(|r| compare(&r.volume, &truth, &CompareSettings::default()).unwrap().all.relative_rmse)
        .collect();
    let close = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 1e-9, "{a} {b}");
    close(point.error.least, errors.iter().copied().fold(f64::INFINITY, f64::min));
    close(point.error.most, errors.iter().copied().fold(0.0, f64::max));
    close(point.error.middle.powi(2), errors.iter().map(|e| e * e).sum::<f64>() / 3.0);
    // And what the volumes say of themselves: 1 % each of their own E. Over places as bright as each other.
    let estimated = point.estimated.unwrap();
    assert!((estimated / 0.0103 - 1.0).abs() < 0.02, "{estimated}");
    assert_eq!((point.cpu_seconds.least, point.cpu_seconds.middle, point.cpu_seconds.most), (1.0, 2.0, 3.0));
    assert_eq!((point.rays, point.samples, point.setup_seconds), (30, 10, 0.1));
    close(point.milliseconds_per_node.middle, 2000.0 / PLACES as f64);
    close(point.efficiency, 1.0 / (point.error.middle.powi(2) * 2.0 / PLACES as f64));
}

#[test]
fn noise_and_bias_of_known_size_are_found_apart() {
    // Noise of 2.6 % of E in the repeats, 1 % in the reference.
    let truth = [truth(0.02)];
    for bias in [0.0, 0.005, 0.03] {
        let point = measure(64, PLACES, &truth, &repeats(1.0 + bias, 0.05, 4)).unwrap();
        let reference = point.ground.reference_noise.unwrap();
        let noise = point.noise.middle;
        // noise/reference = 0.05/0.02; noise² is known to sqrt(2 / (3 · 1700)) = 2 %.
        assert!((noise / reference / 2.5 - 1.0).abs() < 0.04, "{noise} {reference}");
        let floor = floor_of(std::slice::from_ref(&point));
        // Two standard deviations: the sequence is fixed.
        assert!(floor.low <= f64::from(bias) && f64::from(bias) <= floor.high, "{bias}: {floor:?}");
        assert!(floor.high - floor.low < 0.009, "{floor:?}");
        let total = noise.powi(2) + point.bias_square + reference.powi(2);
        assert!((point.error.middle.powi(2) / total - 1.0).abs() < 1e-9);
    }
}

/// Spread of bias² over 60 studies of a bias of 1 %, and what is stated, both as variances; `alike` neighbours have the same
/// noise.
fn variance_found_and_stated(repeats: u64, alike: usize) -> [f64; 2] {
    let exact = [Truth {
        light: TruthLight::Radiance((0..PLACES).map(light).collect()),
        noise: TruthNoise::Radiance(vec![RadianceSh::zero(2); PLACES]),
        ..truth(0.0)
    }];
    let study = |study: u64| {
        let repeat = |r: u64| {
            let noisy = noisy(1.01, 0.05, 1000 + study * 8 + r);
            let shared = |place: usize| {
                let first = place / alike * alike;
                let noise =
                    |i: usize, c: usize| noisy[first].coefficients[i][c] - 1.01 * light(first).coefficients[i][c];
                let own = light(place).coefficients;
                radiance_sh(2, (0..9).map(|i| [0, 1, 2].map(|c| 1.01 * own[i][c] + noise(i, c))))
            };
            Repeat {
                volume: volume(&(0..PLACES).map(shared).collect::<Vec<_>>()),
                cost: cost(1.0),
                seen: None,
                bytes: 7,
            }
        };
        let point = measure(64, PLACES, &exact, &(0..repeats).map(repeat).collect::<Vec<_>>()).unwrap();
        let floor = floor_of(std::slice::from_ref(&point));
        (point.bias_square, ((floor.high.powi(2) - point.bias_square) / 2.0).powi(2))
    };
    let studies: Vec<(f64, f64)> = (0..60).map(study).collect();
    let mean = |of: &dyn Fn(&(f64, f64)) -> f64| studies.iter().map(of).sum::<f64>() / 60.0;
    let bias = mean(&|s| s.0);
    let found = mean(&|s| (s.0 - bias).powi(2)) * 60.0 / 59.0;
    assert!((bias - 1e-4).abs() < 4.0 * (found / 60.0).sqrt(), "{bias} {found}");
    [found, mean(&|s| s.1)]
}

#[test]
fn stated_uncertainty_of_the_floor_is_that_of_many_studies() {
    // A variance of 60 is known to 18 %; three of them.
    let [found, stated] = variance_found_and_stated(2, 1);
    assert!((found / stated - 1.0).abs() < 0.54, "{found} {stated}");
    // With three repeats or more, also where nodes are noisy together: stated to 60 % each, 8 % on average.
    let [alone, together] = [1, 10].map(|alike| variance_found_and_stated(4, alike));
    for [found, stated] in [alone, together] {
        assert!((0.4..1.6).contains(&(found / stated)), "{found} {stated}");
    }
    assert!(together[1] > 4.0 * alone[1], "{together:?} {alone:?}");
}

/// A ladder of known noise, cost and bias.
fn ladder(budgets: &[u64], noise: impl Fn(f64) -> f64, milliseconds: impl Fn(f64) -> f64, bias: f64) -> Vec<Point> {
    let one = |value: f64| Spread { middle: value, least: value, most: value };
    let point = |&budget: &u64| {
        let (noise, ms) = (noise(budget as f64), milliseconds(budget as f64));
        Point {
            budget,
            wall_seconds: one(ms),
            cpu_seconds: one(ms),
            setup_seconds: 0.0,
            milliseconds_per_node: one(ms),
            rays: 0,
            samples: 0,
            error: one(noise.hypot(bias)),
            noise: one(noise),
            estimated: None,
            seen: None,
            bytes: 0,
            bias_square: bias * bias,
            efficiency: 1.0 / (noise * noise * ms),
            noise_efficiency: 1.0 / (noise * noise * ms),
            ground: Ground {
                repeats: 4,
                places: 100,
                independent: 430.0,
                product_variance: None,
                reference_noise: Some(0.0),
            },
        }
    };
    budgets.iter().map(point).collect()
}

const BUDGETS: [u64; 4] = [64, 256, 1024, 4096];

fn one_over_root(at_one: f64) -> impl Fn(f64) -> f64 {
    move |budget| at_one / budget.sqrt()
}

fn study(methods: &[(&str, Vec<Point>)], capture_seconds: Option<f64>) -> Study {
    let measured = methods.iter().map(|(name, points)| (name.to_string(), String::new(), points.clone())).collect();
    let capture =
        capture_seconds.map(|cpu_seconds| Capture { cpu_seconds, wall_seconds: cpu_seconds, about: String::new() });
    Study::of(measured, capture, &StudySettings { target: 0.01, nodes: 1000 })
}

#[test]
fn cost_at_an_error_lies_on_the_line_between_points_and_beyond_them() {
    // noise = c/sqrt(N), cost N microseconds: 1 % at N = (100 c)².
    for (at_one, extrapolated) in [(0.3, false), (0.64, false), (0.02, true), (2.0, true)] {
        let found = study(&[("gdibl", ladder(&BUDGETS, one_over_root(at_one), |n| 1e-3 * n, 0.0))], None);
        let (slope, at) = (found.methods[0].slope.unwrap(), found.methods[0].at_noise.unwrap());
        assert!((slope + 0.5).abs() < 1e-12, "{slope}");
        let expected = 1e-3 * (100.0f64 * at_one).powi(2);
        assert!((at.milliseconds_per_node / expected - 1.0).abs() < 1e-9, "{at:?} {expected}");
        assert_eq!(at.extrapolated, extrapolated, "{at_one}");
        assert!((1e-3 * at.directions / expected - 1.0).abs() < 1e-9, "{at:?}");
    }
    // 1000 times the longest bake, and more.
    for (at_one, is_known) in [(20.0, true), (21.0, false)] {
        let found = study(&[("gdibl", ladder(&BUDGETS, one_over_root(at_one), |n| n, 0.0))], None);
        assert_eq!(found.methods[0].at_noise.is_some(), is_known, "{at_one}");
    }
    let of = |points| study(&[("gdibl", points)], None).methods.remove(0);
    // Up and down again: the last crossing.
    let bumpy = |n: f64| [0.02, 0.005, 0.03, 0.004][(n.log2() as usize - 6) / 2];
    let at = of(ladder(&BUDGETS, bumpy, |n| n, 0.0)).at_noise.unwrap();
    assert!(at.milliseconds_per_node > 1024.0 && at.milliseconds_per_node < 4096.0, "{at:?}");
    // Noise that does not fall never gets there; none at all is there with the least.
    let flat = of(ladder(&BUDGETS, |_| 0.02, |n| n, 0.0));
    assert_eq!((flat.at_noise, flat.at_error), (None, None));
    let none = of(ladder(&BUDGETS, |_| 0.0, |n| n, 0.0));
    assert_eq!(none.slope, None);
    assert_eq!(none.at_noise, Some(CostAt { milliseconds_per_node: 64.0, extrapolated: true, directions: 64.0 }));
    // Nor does one that fell at first and has come to a stand.
    let stands = of(ladder(&BUDGETS, |n| (3.0 / n.sqrt()).max(0.05), |n| n, 0.0));
    assert!(stands.slope.unwrap() < -0.4 && stands.at_noise.is_some(), "the last three still fall: {stands:?}");
    let stands = of(ladder(&BUDGETS, |n| (3.0 / n.sqrt()).max(0.15), |n| n, 0.0));
    assert_eq!(stands.at_noise, None);
    // One budget has no slope.
    let single = of(ladder(&[256], one_over_root(1.0), |n| n, 0.0));
    assert_eq!((single.slope, single.at_noise), (None, None));
}

#[test]
fn bias_over_the_target_is_never_met_and_one_under_it_costs_more() {
    let of = |bias| study(&[("gdibl", ladder(&BUDGETS, one_over_root(0.3), |n| n, bias))], None).methods.remove(0);
    let [none, some, most] = [0.0, 0.008, 0.011].map(of);
    assert_eq!(none.at_error, none.at_noise);
    assert!((some.floor.middle - 0.008).abs() < 1e-9, "{:?}", some.floor);
    // 0.6 % of noise are left: 1/0.36 of the directions.
    let times = some.at_error.unwrap().milliseconds_per_node / some.at_noise.unwrap().milliseconds_per_node;
    assert!((times - 1.0 / 0.36).abs() < 1e-6, "{times}");
    assert_eq!((most.at_error, most.at_noise), (None, none.at_noise));
}

#[test]
fn capture_is_shared_by_the_nodes_and_pays_from_some_number_on() {
    let gdibl = ladder(&BUDGETS, one_over_root(0.3), |n| 1e-3 * n, 0.0);
    let path = ladder(&BUDGETS, one_over_root(0.3), |n| 11e-3 * n, 0.0);
    // At 1 %, 900 directions: 0.9 ms and 9.9 ms; 44.999 s of capture are those 9 ms of not quite 5000 nodes.
    let found = study(&[(GDIBL, gdibl.clone()), (PATH, path.clone())], Some(44.999));
    assert_eq!(found.break_even, Some(BreakEven::Nodes(5000)));
    let names: Vec<&str> = found.methods.iter().map(|method| method.name.as_str()).collect();
    assert_eq!(names, [GDIBL, GDIBL_WITH_CAPTURE, PATH]);
    let times: Vec<f64> = found.methods.iter().map(|method| method.times_less.unwrap()).collect();
    let expected = [11.0, 9.9 / 45.899, 1.0];
    assert!(times.iter().zip(expected).all(|(a, b)| (a / b - 1.0).abs() < 1e-9), "{times:?}");
    let first = &found.methods[1].points[0];
    assert!((first.milliseconds_per_node.middle - 45.063).abs() < 1e-9, "{first:?}");
    assert_eq!(first.noise, gdibl[0].noise);
    // The other way round it never does; without one of the two nobody knows.
    let found = study(&[(GDIBL, path.clone()), (PATH, gdibl.clone())], Some(44.999));
    assert_eq!(found.break_even, Some(BreakEven::Never));
    assert_eq!(study(&[(GDIBL, gdibl.clone())], Some(44.999)).break_even, None);
    assert_eq!(study(&[(GDIBL, gdibl), (PATH, path)], None).break_even, None);
}

#[test]
fn black_light_is_no_error() {
    let black = || vec![RadianceSh::zero(2); PLACES];
    let truth = Truth { light: TruthLight::Radiance(black()), noise: TruthNoise::Unknown, ..truth(0.0) };
    let repeats = [0, 1].map(|_| Repeat { volume: volume(&black()), cost: cost(1.0), seen: None, bytes: 7 });
    let point = measure(64, PLACES, &[truth], &repeats).unwrap();
    assert_eq!((point.error.middle, point.noise.middle, point.bias_square), (0.0, 0.0, 0.0));
    assert_eq!((point.estimated, point.ground.reference_noise), (Some(0.0), None));
}

#[test]
fn sun_that_few_bakes_meet_is_no_bias() {
    // With 64 and 1024 directions no repeat met it: little noise, and 60 % of the light are missing. With the others some did.
    let lucky = |n: f64| [0.13, 2.6, 0.03, 0.7][(n.log2() as usize - 6) / 2];
    let mut points = ladder(&BUDGETS, lucky, |n| n, 0.6);
    points[1].bias_square = -0.5;
    points[3].bias_square = 0.1;
    // One node of all had the sun.
    points.iter_mut().for_each(|point| point.ground.product_variance = Some(point.noise.middle.powi(4)));
    let method = study(&[("gdibl", points)], None).methods.remove(0);
    assert!(method.erratic);
    assert!(method.floor.low == 0.0 && method.floor.high > 0.3, "{:?}", method.floor);
    let steady = study(&[("gdibl", ladder(&BUDGETS, one_over_root(0.3), |n| n, 0.0))], None).methods.remove(0);
    assert!(!steady.erratic);
}

#[test]
fn methods_that_take_ten_times_the_best_ones_time_are_far() {
    let of = |times: f64, bias| ladder(&BUDGETS, one_over_root(0.3), move |n| times * 1e-3 * n, bias);
    let methods = [("gdibl", of(1.0, 0.0)), ("near", of(9.0, 0.0)), ("far", of(12.0, 0.0)), ("never", of(1.0, 0.02))];
    let found = study(&methods, None);
    let far: Vec<bool> = found.methods.iter().map(|method| method.is_far).collect();
    assert_eq!(far, [false, false, true, true]);
    // 0.9 ms for each of 1000 nodes.
    assert!((found.methods[0].total_seconds.unwrap() - 0.9).abs() < 1e-9);
    assert_eq!(found.methods[3].total_seconds, None);
    // Where none comes to the target, none is better than the others.
    let none = study(&[("gdibl", of(1.0, 0.02)), ("path", of(50.0, 0.02))], None);
    assert!(none.methods.iter().all(|method| !method.is_far));
}

#[test]
fn claims_that_do_not_hold_are_told() {
    let of = |claims: [Option<f64>; 4]| {
        let mut points = ladder(&BUDGETS, one_over_root(0.3), |n| n, 0.0);
        points
            .iter_mut()
            .zip(claims)
            .for_each(|(point, claim)| point.estimated = claim.map(|c| c * point.noise.middle));
        study(&[("gdibl", points)], None).methods.remove(0)
    };
    let claim = |claims: [f64; 4]| of(claims.map(Some)).claim.expect("bakes state it");
    assert!((claim([1.0, 1.2, 0.9, 1.0]) - 1.2).abs() < 1e-12);
    assert!((claim([1.0, 1.2, 0.1, 1.0]) - 0.1).abs() < 1e-12);
    assert_eq!(
        [[1.0, 1.49, 1.0, 0.68], [1.0, 1.51, 1.0, 1.0]].map(|c| of(c.map(Some)).claims_wrongly()),
        [false, true]
    );
    assert_eq!((of([None; 4]).claim, of([None; 4]).claims_wrongly()), (None, false));
}
