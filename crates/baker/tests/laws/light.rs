//! White furnace, linearity, and light of known coefficients.

use gdibl_baker::bake::BakeSettings;
use gdibl_baker::radiance::blend::BlendRule;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings, Probe, SceneHit};
use gdibl_baker::scene::{Role, Scene};
use glam::{DVec3, Quat, Vec3};
use std::f64::consts::PI;

use crate::level::*;

#[test]
fn white_furnace_holds_for_every_blend_rule_and_number_of_bands() {
    let radiance = [1.0, 1e-3, 2e4];
    let (scene, probes) = (room_with_pillar(), white_probes(radiance));
    let mut worst = 0.0f64;
    for rule in [
        BlendRule::Nearest,
        BlendRule::Distance(0.0),
        BlendRule::Distance(2.0),
        BlendRule::Angular(2.0),
        BlendRule::Angular(1e3),
        BlendRule::AngularSmooth(2.0),
        BlendRule::Footprint(1.0),
        BlendRule::Footprint(4.0),
        BlendRule::Footprint(1e3),
    ] {
        let function = Gdibl::new(&scene, &probes, None, GdiblSettings { blend: rule, ..GdiblSettings::default() });
        for bands in 0..=4 {
            let error = furnace_error(&function, &places(), &BakeSettings { bands, ..SMALL }, radiance);
            assert!(error < 1e-4, "{rule}, L{bands}: {error:.2e}");
            worst = worst.max(error);
        }
    }
    println!("furnace, every rule and band: {worst:.2e}");
}

#[test]
fn white_furnace_holds_through_recursion_off_white_geometry() {
    // A convex object: every ray off it finds the room.
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::splat(-3.0), DVec3::splat(3.0)));
    add(&mut scene, Role::Scene, &solid_of(DVec3::splat(-0.5), DVec3::splat(0.5)));
    let probes = white_probes([0.5; 3]);
    let points = [DVec3::new(1.0, 0.2, 0.1), DVec3::new(0.51, 0.1, -0.3), DVec3::new(-2.0, -2.0, 2.5)];
    let error = |hit| {
        let function = Gdibl::new(&scene, &probes, None, GdiblSettings { scene_hit: hit, ..GdiblSettings::default() });
        furnace_error(&function, &points, &SMALL, [0.5; 3])
    };
    let recursed = error(SceneHit::Recurse(3));
    println!("furnace through recursion: {recursed:.2e}");
    assert!(recursed < 1e-4, "{recursed:.2e}");
    // The object is there: where it occludes, light is missing.
    assert!(error(SceneHit::Occlude) > 0.1);
}

#[test]
fn white_furnace_holds_where_half_of_the_level_was_never_seen() {
    // A screen that hides half of what the node sees; its front no probe has seen.
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::splat(-3.0), DVec3::splat(3.0)));
    let [a, b, c, d] = [[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]].map(|[x, y]| DVec3::new(x, y, 1.0));
    add(&mut scene, Role::Environment, &[[a, b, c], [a, c, d]]);
    scene.materials[0].double_sided = true;
    let probes = [probe(DVec3::new(0.5, 0.5, -2.0), 16, |_| [2.0; 3])];
    let seen = bake_points(&gdibl(&scene, &probes, None), &[DVec3::new(0.0, 0.0, 0.5)], &SMALL);
    assert_eq!(seen.coverage, [1.0]);
    // Now from behind the screen, through a slit at its end: only what lies beyond is covered.
    let behind = [probe(DVec3::new(0.5, 0.5, -2.0), 16, |_| [2.0; 3])];
    let mut open = scene.clone();
    let [a, b, c, d] = [[-3.0, -3.0], [2.5, -3.0], [2.5, 3.0], [-3.0, 3.0]].map(|[x, y]| DVec3::new(x, y, 1.0));
    open.meshes.pop();
    add(&mut open, Role::Environment, &[[a, b, c], [a, c, d]]);
    let function = gdibl(&open, &behind, None);
    let points = [DVec3::new(1.0, 0.0, 2.0)];
    let coverage = bake_points(&function, &points, &SMALL).coverage[0];
    assert!((0.05..0.6).contains(&coverage), "{coverage}");
    let error = furnace_error(&function, &points, &SMALL, [2.0; 3]);
    println!("furnace, coverage {coverage}: {error:.2e}");
    assert!(error < 1e-4, "{error:.2e}");
}

/// Probes of `scale_a` × one light + `scale_b` × another.
fn mixture(scale_a: f32, scale_b: f32) -> Vec<Probe> {
    let (mut probes, other) = (coloured_probes(), coloured_probes());
    for (i, probe) in probes.iter_mut().enumerate() {
        let other: Vec<[f32; 3]> = other[(i + 1) % 3].panorama.pixels().collect();
        probe.panorama = probe.panorama.with_pixels(|k, pixel| {
            let other = other[k * 7 % other.len()];
            [0, 1, 2].map(|c| scale_a * pixel[c] + scale_b * other[(c + 1) % 3])
        });
    }
    probes
}

#[test]
fn baking_is_linear_in_light() {
    let scene = room_with_pillar();
    // The same directions whatever the light.
    let uniform = BakeSettings { importance: false, ..SMALL };
    let bake_of = |a, b| bake_points(&gdibl(&scene, &mixture(a, b), None), &places(), &uniform).sh.to_vec();
    let (only_a, only_b, both) = (bake_of(1.0, 0.0), bake_of(0.0, 1.0), bake_of(2.0, 3.0));
    let sum: Vec<f32> = only_a.iter().zip(&only_b).map(|(a, b)| 2.0 * a + 3.0 * b).collect();
    let error = difference(&both, &sum);
    println!("linearity: {error:.1e}");
    assert!(error < 1e-5, "{error:.1e}");
    assert!(difference(&only_a, &only_b) > 0.1, "the lights differ");
}

#[test]
fn light_times_a_power_of_two_scales_every_coefficient_exactly() {
    let mut scene = room_with_pillar();
    add(&mut scene, Role::Scene, &solid_of(DVec3::new(-1.0, -0.5, -0.5), DVec3::new(-0.6, 0.0, 0.0)));
    // With a sky, too: the proposal follows its brightness.
    let sky = |scale: f32| distant(panorama(32, |d| [scale * (1.5 + d.y), scale, scale * (1.0 + d.x * d.z)]));
    let open =
        |scale: f32| bake_points(&gdibl(&Scene::default(), &[], Some(&sky(scale))), &places(), &SMALL).sh.to_vec();
    let closed = |scale: f32| bake_points(&gdibl(&scene, &mixture(scale, 0.0), None), &places(), &SMALL).sh.to_vec();
    for (name, bake_of) in [("room", &closed as &dyn Fn(f32) -> Vec<f32>), ("sky", &open)] {
        let unit = bake_of(1.0);
        // 2^80: squares of it are no f32, and outlooks once made NaN of them.
        for scale in [2f32.powi(20), 2f32.powi(-20), 2f32.powi(80), 2f32.powi(-80)] {
            let expected: Vec<f32> = unit.iter().map(|v| v * scale).collect();
            assert_eq!(bake_of(scale), expected, "{name} × {scale:e}");
        }
        for scale in [1e6, 1e-6] {
            let expected: Vec<f32> = unit.iter().map(|v| v * scale).collect();
            let error = difference(&bake_of(scale), &expected);
            assert!(error < 1e-5, "{name} × {scale:e}: {error:.1e}");
        }
    }
}

#[test]
fn exposure_stops_are_powers_of_two_on_pixels() {
    let scene = room_with_pillar();
    let mut stops = coloured_probes();
    stops.iter_mut().for_each(|probe| probe.exposure_stops = 3.0);
    let by_pixels = bake_points(&gdibl(&scene, &mixture(8.0, 0.0), None), &places(), &SMALL);
    assert_eq!(bake_points(&gdibl(&scene, &stops, None), &places(), &SMALL).sh, by_pixels.sh);
}

#[test]
fn sky_of_known_light_gives_its_coefficients_turned_as_it_is() {
    // L = 1 + y has L_00 = √4π and √(4π/3) on y. Pixels of 0.7° reconstruct it within 2e-5.
    let mut sky = distant(panorama(512, |d| [1.0 + d.y, 2.0 + 2.0 * d.y, 0.5]));
    let scene = Scene::default();
    let settings = BakeSettings { samples: 65_536, ..SMALL };
    let turn = Quat::from_euler(glam::EulerRot::YXZ, 0.7, -1.1, 0.4);
    for rotation in [Quat::IDENTITY, Quat::from_rotation_z(1.0), turn] {
        sky.rotation = rotation;
        let baked = bake_points(&gdibl(&scene, &[], Some(&sky)), &[DVec3::ZERO], &settings);
        let up = rotation * Vec3::Y;
        let (constant, slope) = ((4.0 * PI).sqrt() as f32, (4.0 * PI / 3.0).sqrt() as f32);
        let mut expected = [[0.0f32; 3]; 9];
        expected[0] = [constant, 2.0 * constant, 0.5 * constant];
        for (index, component) in [(1, up.y), (2, up.z), (3, up.x)] {
            expected[index] = [slope * component, 2.0 * slope * component, 0.0];
        }
        let error = difference(&baked.sh.to_vec(), expected.as_flattened());
        println!("L = 1 + y: {error:.1e}");
        assert!(error < 2e-3, "{rotation}: {error:.1e}");
        assert_eq!(baked.coverage, [1.0]);
    }
}
