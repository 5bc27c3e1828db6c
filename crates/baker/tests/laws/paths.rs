//! Laws of path tracing: furnaces, energy, lights found by either technique, bounces, clear surfaces.

use gdibl_baker::analyse::energy_balance;
use gdibl_baker::bake::{BakeSettings, GatherSettings, Gathered, SurfacePlace, irradiance_at};
use gdibl_baker::capture::{CaptureSettings, capture};
use gdibl_baker::panorama::Panorama;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings, Probe};
use gdibl_baker::radiance::path::{Path, PathSettings, light_without_end};
use gdibl_baker::radiance::{Distant, RadianceFunction};
use gdibl_baker::scene::{Alpha, Material, PunctualKind, PunctualLight, Role, Scene};
use gdibl_baker::{Control, Interrupted};
use glam::{DVec3, Vec3, Vec4};
use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

use crate::level::*;

fn quiet<T>(work: impl FnOnce(&Control) -> Result<T, Interrupted>) -> T {
    work(&Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None }).expect("nobody interrupts")
}

/// Grey, and glowing.
fn grey(albedo: f32, emission: f32) -> Material {
    let base_color = Vec3::splat(albedo).extend(1.0);
    Material { base_color, metallic: 0.0, emission: Vec3::splat(emission), ..Material::default() }
}

/// Adds triangles of a material of their own.
fn add_of(scene: &mut Scene, triangles: &[Triangle], material: Material) {
    add(scene, Role::Environment, triangles);
    scene.materials.push(material);
    scene.meshes.last_mut().unwrap().material = scene.materials.len() as u32 - 1;
}

/// A horizontal square with its front up, or down.
fn square(middle: DVec3, half: f64, up: bool) -> Vec<Triangle> {
    let corner = |x: f64, z: f64| middle + DVec3::new(x * half, 0.0, z * half);
    let [a, b, c, d] = [corner(-1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0)];
    let triangles = vec![[a, b, c], [a, c, d]];
    if up { triangles } else { triangles.into_iter().map(|[a, b, c]| [a, c, b]).collect() }
}

fn irradiance(function: &impl RadianceFunction, position: DVec3, normal: Vec3, samples: u64) -> Gathered {
    let settings = GatherSettings { samples, ..GatherSettings::default() };
    quiet(|control| irradiance_at(&[SurfacePlace { position, normal }], function, &settings, control))[0]
}

#[test]
fn closed_furnace_reaches_the_sum_of_all_bounces() {
    // L = L_e + ρ L: L_e / (1 - ρ). With 64 bounces half of it was missing at ρ = 0.99, and the error claimed was 2.5 %.
    for albedo in [0.5, 0.9, 0.99] {
        let mut scene = Scene::default();
        add_of(&mut scene, &box_of(DVec3::splat(-1.0), DVec3::splat(2.0)), grey(albedo, 0.5));
        let path = Path::new(&scene, None, PathSettings::default());
        let samples = 1 << 16;
        let found = bake_points(&path, &[DVec3::new(0.3, 0.7, 1.1)], &BakeSettings { samples, ..SMALL });
        let mean = f64::from(found.node(0)[0]) / (4.0 * PI).sqrt();
        let expected = 0.5 / (1.0 - f64::from(albedo));
        // A walk's number of surfaces is geometric: its standard deviation over its mean is √ρ, less what the first three do
        // without roulette. E is known to about twice that of the mean light.
        let error = f64::from(albedo).sqrt() / (samples as f64).sqrt();
        println!("{albedo}: {mean} of {expected}, {error}");
        assert!((mean / expected - 1.0).abs() < 4.0 * error, "{albedo}: {mean} of {expected}");
        let claimed = f64::from(found.relative_error[0]);
        assert!((0.1..4.0).contains(&(claimed / error)), "{albedo}: {claimed}, {error}");
    }
}

#[test]
fn walks_end_where_surfaces_take_no_light() {
    // White walls of albedo 1 around a black lamp that takes what comes back: E is finite, and found. The lamp fills 1/96 of
    // the room's surface, so that a walk meets a hundred walls.
    let mut scene = Scene::default();
    add_of(&mut scene, &box_of(DVec3::splat(-1.0), DVec3::splat(1.0)), grey(1.0, 0.0));
    let lamp = Material { double_sided: true, ..grey(0.0, 1.0) };
    add_of(&mut scene, &square(DVec3::new(0.0, 0.99, 0.0), 0.25, false), lamp);
    let path = Path::new(&scene, None, PathSettings::default());
    let samples = 1 << 14;
    let found = bake_points(&path, &[DVec3::new(0.3, -0.2, 0.1)], &BakeSettings { samples, ..SMALL });
    // Nothing else takes light: it becomes as bright as the lamp everywhere.
    let mean = f64::from(found.node(0)[0]) / (4.0 * PI).sqrt();
    println!("{mean}, {:?}", found.relative_error);
    assert!((mean - 1.0).abs() < 4.0 * f64::from(found.relative_error[0]).max(0.01), "{mean}");
    assert!(found.relative_error[0] < 0.05, "{:?}", found.relative_error);
    assert_eq!(light_without_end(&scene, &path), None, "the lamp takes it");
    // Without anything that takes light it is said which surfaces do not.
    let mut endless = Scene::default();
    let white = Material { name: "snow".into(), ..grey(1.0, 0.1) };
    add_of(&mut endless, &box_of(DVec3::splat(-1.0), DVec3::splat(1.0)), white);
    let path = Path::new(&endless, None, PathSettings::default());
    let finding = light_without_end(&endless, &path).expect("it has no end");
    assert!(finding.id == "light-without-end" && finding.message.contains("snow"), "{finding:?}");
    // Neither where light escapes, nor in the dark.
    endless.meshes[0].triangles.truncate(10);
    let path = Path::new(&endless, None, PathSettings::default());
    assert_eq!(light_without_end(&endless, &path), None, "it escapes");
    let mut dark = Scene::default();
    add_of(&mut dark, &box_of(DVec3::splat(-1.0), DVec3::splat(1.0)), grey(1.0, 0.0));
    assert_eq!(light_without_end(&dark, &Path::new(&dark, None, PathSettings::default())), None, "there is none");
}

#[test]
fn a_level_that_is_nearly_all_lamp_gives_light() {
    // From 40 m it fills a 5000th of the view: by chance 256 directions mostly miss it, and E was 0 with an error of 0.
    let mut scene = Scene::default();
    add_of(&mut scene, &square(DVec3::ZERO, 0.5, true), grey(0.0, 3.0));
    let path = Path::new(&scene, None, PathSettings::default());
    let found = bake_points(&path, &[DVec3::new(0.0, 40.0, 0.0)], &BakeSettings { samples: 256, ..SMALL });
    // ∫ L dω: of a square of half side a at height h, 4 asin(a²/(a²+h²)) of solid angle.
    let expected = 3.0 * 4.0 * (0.25f64 / (0.25 + 1600.0)).asin();
    let light = f64::from(found.node(0)[0]) * (4.0 * PI).sqrt();
    assert!((light / expected - 1.0).abs() < 0.02, "{light} of {expected}");
}

#[test]
fn what_a_box_with_a_lamp_sends_out_is_absorbed_or_escapes() {
    // Open to +x by a missing wall; the lamp shines down alone.
    let mut scene = Scene::default();
    let walls: Vec<Triangle> = box_of(DVec3::ZERO, DVec3::new(2.0, 2.0, 3.0));
    let open: Vec<Triangle> =
        walls.into_iter().filter(|triangle| !triangle.iter().all(|corner| corner.x == 2.0)).collect();
    assert_eq!(open.len(), 10);
    add_of(&mut scene, &open, grey(0.7, 0.0));
    add_of(&mut scene, &solid_of(DVec3::new(0.4, 0.0, 0.5), DVec3::new(0.9, 1.1, 1.2)), grey(0.3, 0.0));
    add_of(&mut scene, &square(DVec3::new(1.0, 1.9, 2.0), 0.2, false), grey(0.5, 20.0));
    let balance = quiet(|control| energy_balance(&scene, PathSettings::default(), 1 << 19, control));
    println!("{balance:?}");
    let emitted = 0.16 * PI * 20.0;
    assert!((balance.emitted - emitted).abs().max_element() < 1e-4 * emitted);
    assert!(balance.escaped.x > 0.05 * emitted && balance.absorbed.x > 0.3 * emitted);
    // 4 standard errors, of which one is under half a per cent.
    let error = balance.standard_error.x / emitted;
    assert!(error < 5e-3 && balance.imbalance().abs() < 4.0 * error, "{} ± {error}", balance.imbalance());
}

#[test]
fn irradiance_under_a_lamp_is_the_closed_form_by_either_technique() {
    // A square lamp of half side a at height h over a point: E = 4 L a/√(a²+h²) atan(a/√(a²+h²)).
    let (half, height, radiance) = (0.5, 1.5, 8.0);
    let a = half / f64::hypot(half, height);
    let expected = 4.0 * radiance * a * a.atan();
    // A bright lamp is drawn. In a level where most of what glows is found by chance (here a gap below the floor, between two
    // walls that glow as much), it is not.
    let lamp = square(DVec3::new(0.0, height, 0.0), half, false);
    let floor = square(DVec3::new(0.0, -1e-3, 0.0), 30.0, true);
    let mut drawn = Scene::default();
    add_of(&mut drawn, &lamp, grey(0.0, radiance as f32));
    add_of(&mut drawn, &floor, grey(0.5, 0.0));
    let mut by_chance = drawn.clone();
    for (height, up) in [(-5.0, true), (-4.0, false)] {
        add_of(&mut by_chance, &square(DVec3::new(0.0, height, 0.0), 30.0, up), grey(0.0, radiance as f32));
    }
    for (scene, samples, tolerance) in [(&drawn, 1 << 12, 2e-3), (&by_chance, 1 << 18, 4e-3)] {
        let path = Path::new(scene, None, PathSettings::default());
        assert_eq!(path.guide().emitter_count(), if samples == 1 << 12 { 2 } else { 0 });
        let found = irradiance(&path, DVec3::ZERO, Vec3::Y, samples).irradiance.x;
        assert!((found / expected - 1.0).abs() < tolerance, "{found}, expected {expected}");
        // From the floor itself, by way of the surface's own rays: albedo/π E, seen from above.
        let seen = irradiance(&path, DVec3::new(0.0, 1e-4, 0.0), Vec3::NEG_Y, samples.max(1 << 14)).irradiance.x / PI;
        let reflected = seen / (0.5 / PI * expected);
        assert!((reflected - 1.0).abs() < 0.02, "{reflected}");
    }
}

#[test]
fn bounces_are_counted_from_the_surface_that_is_seen() {
    // A furnace of ρ = 0.5: the sum of L_e ρ^i to the number of bounces.
    let mut scene = Scene::default();
    add_of(&mut scene, &box_of(DVec3::splat(-1.0), DVec3::splat(1.0)), grey(0.5, 1.0));
    for bounces in 0..5 {
        let path = Path::new(&scene, None, PathSettings { bounces: Some(bounces), ..PathSettings::default() });
        let found = irradiance(&path, DVec3::new(0.2, 0.1, -0.3), Vec3::X, 1 << 14).irradiance.x / PI;
        let expected = 2.0 - 0.5f64.powi(bounces as i32);
        assert!((found / expected - 1.0).abs() < 4e-3, "{bounces} bounces: {found}, expected {expected}");
    }
}

#[test]
fn clear_surfaces_let_their_share_through_both_ways() {
    // A sheet of opacity 0.25, black, between the place and the lamp, and between the floor and the lamp.
    let lamp = square(DVec3::new(0.0, 2.0, 0.0), 0.5, false);
    let floor = square(DVec3::ZERO, 40.0, true);
    let with = |opacity: f32| {
        let mut scene = Scene::default();
        add_of(&mut scene, &lamp, grey(0.0, 5.0));
        add_of(&mut scene, &floor, grey(0.6, 0.0));
        let base_color = Vec4::new(0.0, 0.0, 0.0, opacity);
        let sheet = Material { alpha: Alpha::Blend, base_color, metallic: 0.0, ..Material::default() };
        add_of(&mut scene, &square(DVec3::new(0.0, 1.0, 0.0), 50.0, true), sheet);
        let path = Path::new(&scene, None, PathSettings { bounces: Some(1), ..PathSettings::default() });
        // What the floor reflects passes no sheet on its way here.
        [Vec3::Y, Vec3::NEG_Y].map(|n| irradiance(&path, DVec3::new(0.0, 0.5, 0.0), n, 1 << 15).irradiance.x)
    };
    let (clear, quarter) = (with(0.0), with(0.25));
    for (clear, quarter) in clear.iter().zip(quarter) {
        assert!((quarter / clear / 0.75 - 1.0).abs() < 0.01, "{quarter} of {clear}");
    }
}

/// A light of 5 candela or lux, 2 m over a large floor.
fn lit_floor(kind: PunctualKind) -> Scene {
    let mut scene = Scene::default();
    add_of(&mut scene, &square(DVec3::ZERO, 20.0, true), grey(0.8, 0.0));
    scene.lights.push(PunctualLight {
        name: String::new(),
        kind,
        intensity: Vec3::splat(5.0),
        range: f32::INFINITY,
        position: DVec3::new(0.0, 2.0, 0.0),
        direction: Vec3::NEG_Y,
    });
    scene
}

#[test]
fn punctual_lights_bounce_always_and_shine_directly_when_asked() {
    for (kind, irradiance_below) in [(PunctualKind::Point, 5.0 / 4.0), (PunctualKind::Directional, 5.0)] {
        let scene = lit_floor(kind);
        let path = Path::new(&scene, None, PathSettings::default());
        // Reflected by the floor right below.
        let seen = irradiance(&path, DVec3::new(0.0, 1e-3, 0.0), Vec3::NEG_Y, 1 << 10).irradiance.x;
        assert!((seen / (0.8 * irradiance_below) - 1.0).abs() < 2e-3, "{kind:?}: {seen}");
        // A node a metre below the light: the direct part is a delta of radiance.
        let points = [DVec3::new(0.0, 1.0, 0.0)];
        let bake = |punctual| bake_points(&path, &points, &BakeSettings { punctual, ..SMALL }).node(0).to_vec();
        let (with, without) = (bake(true), bake(false));
        let direct = f64::from(with[0] - without[0]) / f64::from(gdibl_runtime::sh::Y00);
        assert!((direct / 5.0 - 1.0).abs() < 1e-4, "{kind:?}: {direct}");
        // Behind the floor nothing shines.
        let dark = bake_points(&path, &[DVec3::new(0.0, -1.0, 0.0)], &BakeSettings { punctual: true, ..SMALL });
        assert!(dark.node(0).iter().all(|v| *v == 0.0), "{kind:?}");
    }
}

#[test]
fn captures_leave_scene_geometry_out() {
    let mut scene = Scene::default();
    add(&mut scene, Role::Scene, &solid_of(DVec3::splat(-1.0), DVec3::splat(1.0)));
    let sky = Distant { name: String::new(), ..distant(panorama(8, |_| [3.0, 2.0, 1.0])) };
    let without = Path::new(&scene, Some(&sky), PathSettings { scene_geometry: false, ..PathSettings::default() });
    let with = Path::new(&scene, Some(&sky), PathSettings::default());
    assert!(without.surface(Vec3::splat(-600.0), Vec3::ONE.normalize()).is_none());
    assert!(with.surface(Vec3::splat(-600.0), Vec3::ONE.normalize()).is_some());
}

#[test]
fn inside_of_a_dark_solid_is_no_valid_node_and_a_dark_room_is() {
    let mut scene = Scene::default();
    add_of(&mut scene, &box_of(DVec3::splat(-3.0), DVec3::splat(3.0)), grey(0.5, 1.0));
    add_of(&mut scene, &solid_of(DVec3::new(-2.0, -2.5, -2.0), DVec3::new(-1.0, 0.0, -1.0)), grey(0.5, 0.0));
    add_of(&mut scene, &box_of(DVec3::new(1.0, -1.0, -1.0), DVec3::new(2.0, 1.0, 1.0)), grey(0.5, 0.0));
    scene.materials.iter_mut().for_each(|material| material.double_sided = true);
    let path = Path::new(&scene, None, PathSettings::default());
    let points = [DVec3::ZERO, DVec3::new(-1.5, -1.5, -1.5), DVec3::new(1.5, 0.0, 0.0)];
    let baked = bake_points(&path, &points, &SMALL);
    assert_eq!([0, 1, 2].map(|node| baked.is_valid(node)), [true, false, true]);
    assert!(baked.node(2).iter().all(|v| *v == 0.0), "dark, and known to be");
    assert_eq!(*baked.node(1), *baked.node(0), "filled");
}

#[test]
fn captured_probes_of_a_closed_furnace_lend_the_sum_of_all_bounces() {
    for albedo in [0.5, 0.9, 0.99] {
        let mut scene = Scene::default();
        add_of(&mut scene, &box_of(DVec3::splat(-1.0), DVec3::splat(2.0)), grey(albedo, 0.5));
        let path = Path::new(&scene, None, PathSettings::default());
        let settings = CaptureSettings { width: 32, samples: 64, ..CaptureSettings::default() };
        let position = DVec3::new(0.4, 0.5, 0.6);
        let image = quiet(|control| capture(&path, position, 0, &settings, control)).image;
        let panorama = Panorama::new(image.width, image.height, image.pixels, image.distance);
        let probes = [Probe { panorama, ..probe(position, 2, |_| [0.0; 3]) }];
        let function = Gdibl::new(&scene, &probes, None, GdiblSettings::default());
        let found = bake_points(&function, &[DVec3::new(0.3, 0.7, 1.1)], &SMALL);
        let mean = f64::from(found.node(0)[0]) / (4.0 * PI).sqrt();
        let expected = 0.5 / (1.0 - f64::from(albedo));
        // 2^15 paths, whose standard deviation is √ρ of their mean at most; the node weighs their pixels unevenly.
        let error = 1.5 * f64::from(albedo).sqrt() / f64::from(32 * 16 * 64).sqrt();
        assert!((mean / expected - 1.0).abs() < 4.0 * error, "{albedo}: {mean} of {expected} ± {error}");
    }
}
