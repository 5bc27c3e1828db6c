//! Lamps: small, hidden, many, alone.

use crate::level::*;
use crate::shared::*;
use crate::table::Table;
use gdibl_baker::analyse::{energy_balance, radiance_sh};
use gdibl_baker::bake::BakeSettings;
use gdibl_baker::capture::CaptureSettings;
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings};
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::scene::{PunctualKind, PunctualLight, Scene};
use gdibl_runtime::{RadianceSh, sh};
use glam::{DVec3, Vec3};
use std::f64::consts::PI;

pub fn rows(table: &mut Table) {
    lamp_through_a_slit(table);
    third_bounce(table);
    white_walls(table);
    lamp_alone(table);
    black_room(table);
    million_lamps(table);
    million_point_lights(table);
}

fn lamp_through_a_slit(table: &mut Table) {
    // Two rooms of 2 m with a slit of 2 cm, and a lamp of 1 cm² close behind it.
    let mut scene = Scene::default();
    add_of(&mut scene, &box_of(DVec3::new(-2.0, 0.0, -1.0), DVec3::new(2.0, 2.0, 1.0)), 0.5, 0.0);
    for side in [[-1.0, -0.01], [0.01, 1.0]] {
        add_of(&mut scene, &solid_of(DVec3::new(-0.05, 0.0, side[0]), DVec3::new(0.05, 2.0, side[1])), 0.5, 0.0);
    }
    add_of(&mut scene, &lamp(DVec3::new(-0.5, 1.5, 0.0), 0.005), 0.0, 1e5);
    // In the beam, at its edge, and out of it.
    let points =
        [[0.5, 0.5, 0.0], [1.0, 0.7, 0.01], [0.4, 0.9, 0.02], [1.0, 1.0, 0.5], [1.8, 0.2, -0.8], [0.2, 1.9, 0.9]]
            .map(DVec3::from);
    let path = Path::new(&scene, None, PathSettings::default());
    covered_row(
        table,
        "lamp of 1 cm² through a slit of 2 cm; path tracing, 6 nodes × 40 seeds",
        covered(&path, &points, 1024, 40),
    );
    let settings = CaptureSettings { width: 128, samples: 64, emission: false, ..CaptureSettings::default() };
    let probes =
        [DVec3::new(-1.0, 1.0, 0.1), DVec3::new(1.0, 1.0, 0.0)].map(|position| captured(&path, position, &settings));
    let settings = GdiblSettings { emission_from_materials: true, ..GdiblSettings::default() };
    let function = Gdibl::new(&scene, &probes, None, settings);
    covered_row(table, "the same; GDIBL with two captured probes", covered(&function, &points, 1024, 40));
    let photographed = CaptureSettings { width: 512, samples: 64, ..CaptureSettings::default() };
    let probes = [DVec3::new(-1.0, 1.0, 0.1), DVec3::new(1.0, 1.0, 0.0)]
        .map(|position| captured(&path, position, &photographed));
    let function = gdibl(&scene, &probes, None);
    covered_row(table, "the same; the lamp only in the probes' pixels", covered(&function, &points, 4096, 40));
}

fn third_bounce(table: &mut Table) {
    // A corridor with three baffles: what reaches its end has left three surfaces.
    let mut scene = Scene::default();
    add_of(&mut scene, &box_of(DVec3::ZERO, DVec3::new(8.0, 3.0, 3.0)), 0.7, 0.0);
    for (x, from, to) in [(2.0, 0.0, 2.0), (4.0, 1.0, 3.0), (6.0, 0.0, 2.0)] {
        add_of(&mut scene, &solid_of(DVec3::new(x, 0.0, from), DVec3::new(x + 0.02, 3.0, to)), 0.7, 0.0);
    }
    add_of(&mut scene, &lamp(DVec3::new(0.5, 2.9, 0.5), 0.05), 0.0, 1e4);
    let points = [[7.5, 1.0, 0.5], [7.2, 2.0, 1.5], [7.9, 0.1, 2.8], [7.3, 1.5, 0.3]].map(DVec3::from);
    let light = |bounces| {
        let path = Path::new(&scene, None, PathSettings { bounces, ..PathSettings::default() });
        strength(&sh_of(&bake_points(&path, &points[..1], &BakeSettings { samples: 1 << 14, ..SMALL }), 0))
    };
    let share = light(Some(2)) / light(None);
    let path = Path::new(&scene, None, PathSettings::default());
    let settings = CaptureSettings { width: 64, samples: 256, ..CaptureSettings::default() };
    let probes = [captured(&path, DVec3::new(7.4, 1.5, 1.2), &settings)];
    let case =
        format!("light by three bounces and more alone ({} by two) in a probe, 4 nodes × 60 seeds", percent(share));
    covered_row(table, &case, covered(&gdibl(&scene, &probes, None), &points, 1024, 60));
}

/// A closed room whose walls have this albedo and emission, and places in it.
fn room(albedo: f32, emission: f32) -> (Scene, Vec<DVec3>) {
    let (min, max) = (DVec3::new(-3.0, 0.0, -2.0), DVec3::new(3.0, 3.0, 2.5));
    let mut scene = Scene::default();
    add_of(&mut scene, &box_of(min, max), albedo, emission);
    (scene, spread(min + DVec3::splat(0.3), max - DVec3::splat(0.3), 12))
}

fn white_walls(table: &mut Table) {
    // L = emission + albedo L = 1.
    let (scene, points) = room(0.99, 0.01);
    let path = Path::new(&scene, None, PathSettings::default());
    let baked = bake_points(&path, &points, &USUAL);
    noisy_furnace_row(table, "albedo 0.99: walls that send out 0.01; path tracing", &baked, 0.03);
    let balance =
        quiet(|control| energy_balance(&scene, PathSettings::default(), 1 << 16, control)).expect("no one interrupts");
    let (off, error) =
        (balance.imbalance(), balance.standard_error.element_sum() / 3.0 / balance.emitted.element_sum() * 3.0);
    table.row(
        "the same: emitted = absorbed + escaped",
        "off by ≤ 3.3 standard errors, these ≤ 2 %",
        &format!("{} ± {}", percent(off), percent(error)),
        off.abs() <= 3.3 * error && error <= 0.02,
    );
    // Nothing is absorbed, and light comes in from a sky of 1: light is 1 everywhere.
    let (mut scene, points) = room(1.0, 0.0);
    remove_ceiling(&mut scene);
    let sky = distant(panorama(16, |_| [1.0; 3]));
    let baked = bake_points(&Path::new(&scene, Some(&sky), PathSettings::default()), &points, &USUAL);
    noisy_furnace_row(table, "albedo 1 under a white sky, no ceiling; path tracing", &baked, 0.015);
    // Closed, a black lamp of area A takes in on both sides what it gives on one: A π = 2 A π L.
    let (closed, points) = room(1.0, 0.0);
    let mut scene = closed.clone();
    add_of(&mut scene, &lamp(DVec3::new(0.0, 2.0, 0.0), 0.3), 0.0, 1.0);
    let baked = bake_points(&Path::new(&scene, None, PathSettings::default()), &points, &USUAL);
    let levels: Vec<f64> = (0..points.len()).map(|node| strength(&sh_of(&baked, node)) / PI).collect();
    let level = levels.iter().sum::<f64>() / levels.len() as f64;
    table.row(
        "albedo 1, closed, one black lamp of 0.36 m² that sends out 1; path tracing",
        "ends; mean L within 5 % of 1/2, with which the lamp takes in what it gives",
        &format!("mean L {level:.3}"),
        (level / 0.5 - 1.0).abs() <= 0.05,
    );
    // A white lamp there: light is without end, and no number is right. A bake ends, with numbers.
    let mut scene = closed;
    add_of(&mut scene, &lamp(DVec3::new(0.0, 2.0, 0.0), 0.3), 1.0, 1.0);
    let baked = bake_points(&Path::new(&scene, None, PathSettings::default()), &points[..2], &SMALL);
    let finite = baked.sh.to_vec().iter().all(|v| v.is_finite());
    table.row(
        "the same with a white lamp: nothing absorbs, light is without end",
        "ends; finite numbers (none is right: roulette ends one bounce in a thousand)",
        if finite { "finite" } else { "NOT finite" },
        finite,
    );
}

fn lamp_alone(table: &mut Table) {
    let (mut scene, points) = room(0.5, 0.0);
    add_of(&mut scene, &lamp(DVec3::new(0.5, 2.95, 0.2), 0.2), 0.5, 50.0);
    let path = Path::new(&scene, None, PathSettings::default());
    let truth = bake_points(&path, &points, &BakeSettings { samples: 1 << 16, seed: 77, ..SMALL });
    let by_path = error_of(&bake_points(&path, &points, &USUAL), |node| sh_of(&truth, node)).relative_rmse;
    let settings = CaptureSettings { width: 256, samples: 64, emission: false, ..CaptureSettings::default() };
    let probes = [captured(&path, DVec3::new(-0.5, 1.5, 0.3), &settings)];
    let settings = GdiblSettings { emission_from_materials: true, ..GdiblSettings::default() };
    let function = Gdibl::new(&scene, &probes, None, settings);
    let by_probe = error_of(&bake_points(&function, &points, &USUAL), |node| sh_of(&truth, node)).relative_rmse;
    table.row(
        "one lamp and nothing else, walls of albedo 1/2, 12 nodes; against 65536 paths",
        "relative RMSE of E: path tracing ≤ 1 %, by one captured probe ≤ 2 %",
        &format!("{}, {}", percent(by_path), percent(by_probe)),
        by_path <= 0.01 && by_probe <= 0.02,
    );
}

/// Coefficients of a horizontal square that sends `radiance` down, by midpoints of its parts: L Y cosθ / d² dA.
fn square_light(middle: DVec3, half: f64, radiance: f64, node: DVec3) -> RadianceSh {
    const PARTS: usize = 512;
    let (mut sums, area) = ([0.0f64; 9], (2.0 * half / PARTS as f64).powi(2));
    for part in 0..PARTS * PARTS {
        let [x, z] = [part % PARTS, part / PARTS].map(|i| half * (2.0 * (i as f64 + 0.5) / PARTS as f64 - 1.0));
        let line = middle + DVec3::new(x, 0.0, z) - node;
        let seen = area * (line.y / line.length()).max(0.0) / line.length_squared();
        let mut basis = [0.0; sh::MAX_COEFFICIENTS];
        sh::basis(2, line.normalize().as_vec3().to_array(), &mut basis);
        sums.iter_mut().zip(basis).for_each(|(sum, y)| *sum += radiance * seen * f64::from(y));
    }
    radiance_sh(2, sums.map(|v| [v as f32; 3]))
}

fn black_room(table: &mut Table) {
    let (mut scene, points) = room(0.0, 0.0);
    let (middle, half) = (DVec3::new(0.5, 2.95, 0.2), 0.2);
    add_of(&mut scene, &lamp(middle, half), 0.0, 50.0);
    let path = Path::new(&scene, None, PathSettings::default());
    let baked = bake_points(&path, &points, &BakeSettings { samples: 1024, ..SMALL });
    let truth: Vec<RadianceSh> = points.iter().map(|node| square_light(middle, half, 50.0, *node)).collect();
    let error = error_of(&baked, |node| truth[node]);
    table.row(
        "black room with a lamp, 1024 samples, against the lamp's integral",
        "valid (a black room is no solid); relative RMSE of E ≤ 1 %",
        &format!("{} of 12 valid; {}", baked.valid_nodes().count(), percent(error.relative_rmse)),
        baked.is_all_valid() && error.relative_rmse <= 0.01,
    );
}

fn million_lamps(table: &mut Table) {
    // A ceiling of 707 × 707 squares of two triangles, each a lamp: every second one three times as bright.
    const SIDE: usize = 707;
    let (half, height) = (5.0, 3.0);
    let mut scene = Scene::default();
    let step = 2.0 * half / SIDE as f64;
    for (odd, emission) in [(0, 1.0), (1, 3.0)] {
        let squares = (0..SIDE * SIDE).filter(|i| (i % SIDE + i / SIDE) % 2 == odd);
        let middle = |i: usize| {
            let [x, z] = [i % SIDE, i / SIDE].map(|i| (i as f64 + 0.5) * step - half);
            DVec3::new(x, height, z)
        };
        let triangles: Vec<Triangle> = squares.flat_map(|i| lamp(middle(i), 0.5 * step)).collect();
        add_of(&mut scene, &triangles, 0.0, emission);
    }
    add_of(&mut scene, &solid_of(DVec3::new(-9.0, -1.0, -9.0), DVec3::new(9.0, 0.0, 9.0)), 0.0, 0.0);
    let path = Path::new(&scene, None, PathSettings::default());
    let points = spread(DVec3::new(-4.0, 0.3, -4.0), DVec3::new(4.0, 2.5, 4.0), 6);
    let baked = bake_points(&path, &points, &USUAL);
    let middle = DVec3::new(0.0, height, 0.0);
    let truth: Vec<RadianceSh> = points.iter().map(|node| square_light(middle, half, 2.0, *node)).collect();
    let error = error_of(&baked, |node| truth[node]).relative_rmse;
    table.row(
        &format!("{} lamps in a ceiling, one half three times as bright", path.guide().emitter_count()),
        "all are lamps; relative RMSE of E ≤ 1.5 %",
        &percent(error),
        path.guide().emitter_count() == 2 * SIDE * SIDE && error <= 0.015,
    );
}

fn million_point_lights(table: &mut Table) {
    let light = |position: DVec3| PunctualLight {
        name: String::new(),
        kind: PunctualKind::Point,
        intensity: Vec3::splat(1e-4),
        range: f32::INFINITY,
        position,
        direction: Vec3::NEG_Y,
    };
    let places = spread(DVec3::new(-50.0, 3.0, -50.0), DVec3::new(50.0, 6.0, 50.0), 1_000_000);
    let scene = Scene { lights: places.iter().copied().map(light).collect(), ..Scene::default() };
    let path = Path::new(&scene, None, PathSettings::default());
    let node = DVec3::new(0.3, 1.0, -0.2);
    let baked = bake_points(&path, &[node], &BakeSettings { samples: 64, punctual: true, ..SMALL });
    let mut sums = [0.0f64; 9];
    for place in places {
        let line = place - node;
        let mut basis = [0.0; sh::MAX_COEFFICIENTS];
        sh::basis(2, line.normalize().as_vec3().to_array(), &mut basis);
        sums.iter_mut().zip(basis).for_each(|(sum, y)| *sum += 1e-4 / line.length_squared() * f64::from(y));
    }
    let expected: Vec<f32> = sums.iter().flat_map(|v| [*v as f32; 3]).collect();
    let change = difference(&baked.sh.to_vec(), &expected);
    table.at_most("1e6 point lights, included", "coefficients off by, of the largest", 1e-4, change);
}
