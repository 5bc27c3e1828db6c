//! Surfaces that no probe sees, or none finely enough: traced by the level's materials where these can be trusted, else filled.

use gdibl_baker::Control;
use gdibl_baker::bake::{BakeSettings, Baked};
use gdibl_baker::capture::{CaptureSettings, capture};
use gdibl_baker::panorama::{Mapping, to_lat_long};
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings, Probe};
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::radiance::unseen::Unseen;
use gdibl_baker::scene::{Material, Role, Scene};
use glam::{DVec3, Quat, Vec3, Vec4};
use std::sync::atomic::AtomicBool;

use crate::level::*;

/// Where the only probes stand: all on one side of the screen.
const PROBES: [DVec3; 2] = [DVec3::new(-1.5, 0.3, -0.9), DVec3::new(-1.2, 0.6, 1.1)];

/// A closed room of dark and bright walls, a lamp under its ceiling, and a screen that hides half of it from both probes.
fn room_with_screen() -> Scene {
    let mut scene = Scene::default();
    let materials = [[0.8, 0.8, 0.8], [0.7, 0.1, 0.1], [0.1, 0.2, 0.6], [0.1, 0.1, 0.1]];
    scene.materials.extend(materials.map(|[r, g, b]| Material {
        base_color: Vec4::new(r, g, b, 1.0),
        metallic: 0.0,
        ..Material::default()
    }));
    scene.materials.push(Material { emission: Vec3::splat(8.0), metallic: 0.0, ..Material::default() });
    let walls = box_of(DVec3::new(-3.0, -1.0, -2.0), DVec3::new(3.0, 2.0, 2.5));
    let screen = solid_of(DVec3::new(0.4, -1.0, -1.2), DVec3::new(0.6, 1.4, 1.6));
    let lamp = solid_of(DVec3::new(-1.0, 1.9, -0.5), DVec3::new(1.0, 1.95, 0.5));
    let parts = [(&walls[..2], 0), (&walls[2..4], 1), (&walls[4..6], 3), (&walls[6..8], 0), (&walls[8..], 2)];
    let parts = parts.into_iter().chain([(&screen[..], 0), (&lamp[4..6], 4)]);
    for (triangles, material) in parts {
        add(&mut scene, Role::Environment, triangles);
        scene.meshes.last_mut().expect("just added").material = material;
    }
    scene
}

fn captured(scene: &Scene) -> Vec<Probe> {
    let path = Path::new(scene, None, PathSettings::default());
    let cancel = AtomicBool::new(false);
    let control = Control { cancel: &cancel, progress: &|_, _| {}, blocks: None };
    let settings = CaptureSettings { width: 96, samples: 64, ..CaptureSettings::default() };
    let capture = |(index, &position): (usize, &DVec3)| {
        let captured = capture(&path, position, index as u64, &settings, &control).expect("nobody interrupts");
        let panorama = to_lat_long(&captured.image, Mapping::LatLong, None);
        Probe { name: index.to_string(), position, rotation: Quat::IDENTITY, exposure_stops: 0.0, panorama }
    };
    PROBES.iter().enumerate().map(capture).collect()
}

/// Behind the screen, and beside it.
fn nodes() -> Vec<DVec3> {
    let place = |i: usize| DVec3::new([1.2, 2.2, 2.7, -0.5][i % 4], [-0.6, 0.5][i / 4 % 2], [-1.3, 0.4, 1.9][i / 8]);
    (0..24).map(place).collect()
}

fn bake_by(function: &Gdibl) -> Baked {
    bake_points(function, &nodes(), &BakeSettings { samples: 2048, seed: 1, ..BakeSettings::default() })
}

fn settings() -> GdiblSettings {
    GdiblSettings { directions: 24 * 2048, coarsest: 0.3, ..GdiblSettings::default() }
}

/// Root mean square error of E over that of the truth, by path tracing.
fn error(scene: &Scene, baked: &Baked) -> f64 {
    let path = Path::new(scene, None, PathSettings::default());
    let truth = bake_points(&path, &nodes(), &BakeSettings { samples: 1 << 14, seed: 9, ..BakeSettings::default() });
    let (mut off, mut all) = (0.0, 0.0);
    for node in 0..nodes().len() {
        let found = sh_of(baked, node).convolve();
        let expected = sh_of(&truth, node).convolve();
        for normal in gdibl_baker::sampling::fibonacci_sphere(26) {
            let pair = [&found, &expected].map(|e| Vec3::from(e.evaluate(normal.to_array())).as_dvec3());
            off += (pair[0] - pair[1]).length_squared();
            all += pair[1].length_squared();
        }
    }
    (off / all).sqrt()
}

#[test]
fn what_no_probe_sees_is_traced_where_materials_agree_with_probes() {
    let scene = room_with_screen();
    let probes = captured(&scene);
    let mut function = Gdibl::new(&scene, &probes, None, settings());
    let filled = bake_by(&function);
    let choice = function.choose_unseen(Unseen::Auto, &nodes()).clone();
    println!("{choice:?}");
    assert!(choice.traced && choice.trusted, "{choice:?}");
    assert!(choice.unseen_share > 0.1, "the screen hides something: {choice:?}");
    assert_eq!(choice.gain, [1.0; 3], "captured probes have the level's own exposure");
    let traced = bake_by(&function);
    assert!(traced.coverage.iter().all(|share| *share > 0.999), "{:?}", traced.coverage);
    assert!(filled.coverage.iter().any(|share| *share < 0.9), "{:?}", filled.coverage);
    let path = Path::new(&scene, None, PathSettings::default());
    let by_paths = bake_points(&path, &nodes(), &BakeSettings { samples: 2048, seed: 1, ..BakeSettings::default() });
    let [filled, traced, by_paths] = [&filled, &traced, &by_paths].map(|baked| error(&scene, baked));
    println!("filled {filled}, traced {traced}, by paths alone {by_paths}");
    assert!(traced < 1.5 * by_paths && filled > 3.0 * traced, "{filled} {traced} {by_paths}");
}

#[test]
fn exposure_of_probes_is_matched_before_paths_stand_in() {
    let scene = room_with_screen();
    let mut probes = captured(&scene);
    // Many paths for each point: with few a gain of 1 fits by chance 5 % worse than the one that is found.
    let settings = || GdiblSettings { directions: 1 << 23, ..settings() };
    let own = Gdibl::new(&scene, &probes, None, settings()).choose_unseen(Unseen::Auto, &nodes()).clone();
    probes.iter_mut().for_each(|probe| probe.exposure_stops = 5.0);
    let choice = Gdibl::new(&scene, &probes, None, settings()).choose_unseen(Unseen::Auto, &nodes()).clone();
    assert!(choice.traced, "{choice:?}");
    let [a, b] = [own, choice].map(|choice| choice.agreement.expect("it was measured"));
    assert!((a - b).abs() < 0.03, "{a} {b}");
    let mut function = Gdibl::new(&scene, &probes, None, settings());
    let gain = function.choose_unseen(Unseen::Auto, &nodes()).gain;
    // The median of ratios over some sixty groups: within a tenth.
    assert!(gain.iter().all(|gain| (gain / 32.0 - 1.0).abs() < 0.1), "{gain:?}");
}

#[test]
fn grey_dummies_and_materials_that_were_not_read_are_filled_around() {
    let scene = room_with_screen();
    let probes = captured(&scene);
    let mut grey = scene.clone();
    grey.materials.iter_mut().for_each(|material| material.base_color = Vec4::new(0.5, 0.5, 0.5, 1.0));
    let choice = Gdibl::new(&grey, &probes, None, settings()).choose_unseen(Unseen::Auto, &nodes()).clone();
    assert!(!choice.traced && !choice.trusted && choice.agreement.is_some(), "{choice:?}");
    let unread = Scene { materials_left_out: true, ..scene.clone() };
    let choice = Gdibl::new(&unread, &probes, None, settings()).choose_unseen(Unseen::Auto, &nodes()).clone();
    assert!(!choice.traced && choice.agreement.is_none() && choice.why.contains("TextureNeeds::All"), "{choice:?}");
    let choice = Gdibl::new(&scene, &probes, None, settings()).choose_unseen(Unseen::Fill, &nodes()).clone();
    assert!(!choice.traced && choice.trusted, "asked for: {choice:?}");
}

/// Paths of darker walls are brought to the probes by a gain. What glows is as bright as before.
#[test]
fn lamps_are_as_bright_as_probes_show_them_where_walls_are_not() {
    let room = |albedo: f32| {
        let mut scene = Scene::default();
        let wall = Vec3::splat(albedo).extend(1.0);
        scene.materials.push(Material { base_color: wall, metallic: 0.0, ..Material::default() });
        scene.materials.push(Material { emission: Vec3::splat(8.0), metallic: 0.0, ..Material::default() });
        add(&mut scene, Role::Environment, &box_of(DVec3::new(-3.0, -1.0, -2.0), DVec3::new(3.0, 2.0, 2.5)));
        let lamp = solid_of(DVec3::new(-1.0, 1.9, -0.5), DVec3::new(1.0, 1.95, 0.5));
        add(&mut scene, Role::Environment, &lamp[4..6]);
        scene.meshes[1].material = 1;
        scene
    };
    let (scene, hidden) = (room(0.65), room(0.5));
    let probes = captured(&scene);
    let mut function = Gdibl::new(&hidden, &probes, None, settings());
    let choice = function.choose_unseen(Unseen::Auto, &nodes()).clone();
    assert!(choice.traced && choice.gain.iter().all(|gain| *gain > 1.3), "{choice:?}");
    let off = error(&scene, &bake_by(&function));
    assert!(off < 0.06, "{off}");
}

#[test]
fn what_probes_see_too_coarsely_is_a_guess_that_does_not_count_as_covered() {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::new(-3.0, -1.0, -2.0), DVec3::new(3.0, 2.0, 2.5)));
    let light = [2.0, 1.0, 0.5];
    let probes = white_probes(light);
    for directions in [0, 1 << 20] {
        let own = GdiblSettings { coarsest: 1e-6, directions, ..GdiblSettings::default() };
        let function = Gdibl::new(&scene, &probes, None, own);
        assert!(furnace_error(&function, &places(), &SMALL, light) < 1e-4);
        assert!(bake_points(&function, &places(), &SMALL).coverage.iter().all(|share| *share < 1e-6));
    }
}

#[test]
fn light_that_hides_from_all_probes_shows_in_the_systematic_error() {
    let scene = room_with_screen();
    let probes = captured(&scene);
    let baked = bake_by(&Gdibl::new(&scene, &probes, None, settings()));
    let by = |is_unseen: bool| {
        let nodes = (0..baked.len()).filter(|node| (baked.coverage[*node] < 0.9) == is_unseen);
        median(nodes.map(|node| f64::from(baked.systematic_error[node])).collect())
    };
    assert!(by(true) > 2.0 * by(false), "{} {}", by(true), by(false));
    assert!(baked.systematic_error.iter().all(|error| error.is_finite()));
}
