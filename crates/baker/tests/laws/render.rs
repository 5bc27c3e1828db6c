//! Pictures: what every camera must see.

use gdibl_baker::bake::{BakeSettings, Nodes, grid_of_counts};
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings, SceneHit};
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::render::{Camera, Picture, RenderSettings, Sphere, SphereLook, VolumeLight, render};
use gdibl_baker::sampling::fibonacci_sphere;
use gdibl_baker::scene::{Material, Mesh, Role, Scene};
use gdibl_baker::{Control, Interrupted};
use gdibl_runtime::Volume;
use glam::{DVec3, Vec3, Vec4};
use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

use crate::level::*;

const SETTINGS: RenderSettings = RenderSettings {
    width: 16,
    height: 12,
    samples: 16,
    depth: 3,
    seed: 5,
    sampler: gdibl_baker::sampling::Sampler::Sobol,
};

fn look(eye: DVec3, target: DVec3, vertical_fov_degrees: f64) -> Camera {
    Camera::Pinhole { eye, target, vertical_fov_degrees }
}

fn picture(function: &impl RadianceFunction, camera: &Camera, settings: &RenderSettings) -> Picture {
    picture_by(function, None, camera, settings)
}

fn picture_by(
    function: &impl RadianceFunction,
    volume: Option<&VolumeLight>,
    camera: &Camera,
    settings: &RenderSettings,
) -> Picture {
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    let picture = render(function, volume, camera, settings, &control).expect("nobody interrupts");
    assert_eq!(picture.image.pixels.len(), settings.width * settings.height);
    picture
}

/// As the report's experiment has it.
fn objects_by(volume: &Volume) -> VolumeLight<'_> {
    VolumeLight { objects_only: true, ..VolumeLight::of(volume) }
}

/// Adds triangles of their own material.
fn add_of(scene: &mut Scene, role: Role, triangles: &[Triangle], material: Material) {
    add(scene, role, triangles);
    scene.materials.push(material);
    scene.meshes.last_mut().unwrap().material = scene.materials.len() as u32 - 1;
}

fn dull(albedo: f32) -> Material {
    Material { base_color: Vec3::splat(albedo).extend(1.0), metallic: 0.0, ..Material::default() }
}

const BRASS: Vec3 = Vec3::new(0.9, 0.7, 0.2);

fn mirror() -> Material {
    Material { base_color: BRASS.extend(1.0), roughness: 0.05, ..Material::default() }
}

/// Largest relative difference of a channel of a pixel from what is expected there.
fn worst(picture: &Picture, expected: impl Fn(usize, usize) -> Vec3) -> f32 {
    let width = picture.image.width;
    let pixels = picture.image.pixels.iter().enumerate();
    pixels
        .map(|(i, found)| {
            let expected = expected(i % width, i / width);
            ((Vec3::from(*found) - expected) / expected).abs().max_element()
        })
        .fold(0.0, f32::max)
}

/// A closed room of albedo 1 with a white cube in it.
fn room_with_cube() -> Scene {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::splat(-3.0), DVec3::splat(3.0)));
    add(&mut scene, Role::Scene, &solid_of(DVec3::splat(-0.5), DVec3::splat(0.5)));
    scene
}

#[test]
fn white_furnace_is_a_picture_of_one_colour() {
    let scene = room_with_cube();
    let light = Vec3::new(0.5, 20.0, 1e-3);
    let probes = [probe(DVec3::new(1.0, 1.5, 2.0), 16, |_| light.to_array())];
    let of = |scene_hit| Gdibl::new(&scene, &probes, None, GdiblSettings { scene_hit, ..GdiblSettings::default() });
    let cameras =
        [look(DVec3::new(2.0, 1.0, 2.5), DVec3::ZERO, 70.0), Camera::Panorama { position: DVec3::new(0.0, 1.2, 0.6) }];
    for camera in cameras {
        let found = picture(&of(SceneHit::Recurse(3)), &camera, &SETTINGS);
        let error = worst(&found, |_, _| light);
        println!("furnace: {error:.1e}");
        assert!(error < 1e-4, "{camera:?}: {error:.1e}");
        assert!(found.uncovered.abs() < 1e-6, "{}", found.uncovered);
        // The cube is in the picture.
        let black = picture(&of(SceneHit::Occlude), &camera, &SETTINGS);
        let pixels = black.image.pixels.iter().filter(|pixel| **pixel == [0.0; 3]).count();
        assert!((4..150).contains(&pixels), "{camera:?}: {pixels} pixels of cube");
    }
}

#[test]
fn white_furnace_holds_by_path_tracing() {
    let mut scene = Scene::default();
    add(&mut scene, Role::Scene, &solid_of(DVec3::splat(-0.5), DVec3::splat(0.5)));
    let sky = distant(panorama(16, |_| [2.0, 0.5, 1.0]));
    let function = Path::new(&scene, Some(&sky), PathSettings::default());
    let settings = RenderSettings { width: 8, height: 8, samples: 1024, ..SETTINGS };
    let found = picture(&function, &look(DVec3::new(1.0, 1.2, 1.5), DVec3::ZERO, 45.0), &settings);
    let error = worst(&found, |_, _| Vec3::new(2.0, 0.5, 1.0));
    println!("furnace by paths: {error:.1e}");
    assert!(error < 0.05, "{error}");
    assert!(error > 1e-6, "some pixels show the cube, which is sampled");
    assert_eq!(found.uncovered, 0.0);
}

/// Smooth light, unlike in all directions.
fn sky_light(d: Vec3) -> Vec3 {
    Vec3::new(1.5 + d.x, 1.5 + d.y, 1.5 + d.z)
}

fn smooth_sky() -> gdibl_baker::radiance::Distant {
    distant(panorama(128, |d| sky_light(d).to_array()))
}

/// The direction of a pixel's centre, of a camera at the origin that looks along -Z.
fn forward_direction(settings: &RenderSettings, fov: f64, x: usize, y: usize) -> Vec3 {
    let half = (fov.to_radians() / 2.0).tan() as f32;
    let (w, h) = (settings.width as f32, settings.height as f32);
    let right = (2.0 * (x as f32 + 0.5) / w - 1.0) * half * w / h;
    let up = (1.0 - 2.0 * (y as f32 + 0.5) / h) * half;
    Vec3::new(right, up, -1.0).normalize()
}

#[test]
fn mirror_shows_what_lies_behind_the_camera() {
    let sky = smooth_sky();
    // A wall across the view; its normals are not the file's, so they do not count.
    let wall = [
        [DVec3::new(-9.0, -9.0, -2.0), DVec3::new(9.0, -9.0, -2.0), DVec3::new(9.0, 9.0, -2.0)],
        [DVec3::new(-9.0, -9.0, -2.0), DVec3::new(9.0, 9.0, -2.0), DVec3::new(-9.0, 9.0, -2.0)],
    ];
    let mut scene = Scene::default();
    add_of(&mut scene, Role::Scene, &wall, mirror());
    let camera = look(DVec3::ZERO, DVec3::NEG_Z, 60.0);
    let expected = |x, y| {
        let d = forward_direction(&SETTINGS, 60.0, x, y);
        BRASS * sky_light(Vec3::new(d.x, d.y, -d.z))
    };
    let by_probes = picture(&gdibl(&scene, &[], Some(&sky)), &camera, &SETTINGS);
    let by_paths = picture(&Path::new(&scene, Some(&sky), PathSettings::default()), &camera, &SETTINGS);
    for found in [&by_probes, &by_paths] {
        let error = worst(found, expected);
        println!("mirror: {error:.1e}");
        assert!(error < 0.02, "{error}");
        assert_eq!(found.uncovered, 0.0);
    }
    // Rough metal is black, and without a bounce left a mirror is uncovered.
    scene.materials[1].roughness = 0.5;
    let rough = picture(&gdibl(&scene, &[], Some(&sky)), &camera, &SETTINGS);
    assert!(rough.image.pixels.iter().all(|pixel| *pixel == [0.0; 3]) && rough.uncovered == 0.0);
    scene.materials[1].roughness = 0.0;
    let none = picture(&gdibl(&scene, &[], Some(&sky)), &camera, &RenderSettings { depth: 0, ..SETTINGS });
    assert!(none.image.pixels.iter().all(|pixel| *pixel == [0.0; 3]) && none.uncovered == 1.0);
}

/// A unit sphere of some 1000 triangles around `center`; `smooth` as its exact normals.
fn sphere(center: DVec3, smooth: bool) -> Mesh {
    let (rows, columns) = (20u32, 30u32);
    let normal = |i: u32| {
        let (row, column) = (i / columns, i % columns);
        let (sin, cos) = (PI * f64::from(row) / f64::from(rows)).sin_cos();
        let longitude = 2.0 * PI * f64::from(column) / f64::from(columns);
        DVec3::new(sin * longitude.cos(), cos, -sin * longitude.sin())
    };
    let normals: Vec<DVec3> = (0..(rows + 1) * columns).map(normal).collect();
    let quads = (0..rows * columns).map(|i| {
        let right = i / columns * columns + (i + 1) % columns;
        [i, i + columns, right + columns, right]
    });
    let triangles = quads.flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]);
    let has_area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| normals[i as usize]);
        (b - a).cross(c - a).length() > 1e-9
    };
    Mesh {
        role: Role::Scene,
        triangles: triangles.filter(has_area).collect(),
        positions: normals.iter().map(|n| center + *n).collect(),
        normals: normals.iter().map(|n| n.as_vec3()).collect(),
        smooth,
        ..Mesh::default()
    }
}

#[test]
fn mirror_sphere_reflects_by_its_smooth_normals() {
    let sky = smooth_sky();
    let center = Vec3::new(0.0, 0.0, -3.0);
    let settings = RenderSettings { samples: 64, ..SETTINGS };
    let error = |smooth: bool| {
        let scene = Scene {
            meshes: vec![sphere(center.as_dvec3(), smooth)],
            materials: vec![Material { base_color: Vec4::ONE, ..mirror() }],
            ..Scene::default()
        };
        let function = gdibl(&scene, &[], Some(&sky));
        // Only the middle of the sphere is in the picture.
        let found = picture(&function, &look(DVec3::ZERO, DVec3::NEG_Z, 20.0), &settings);
        worst(&found, |x, y| {
            let d = forward_direction(&settings, 20.0, x, y);
            let along = d.dot(center);
            let t = along - (along * along - center.length_squared() + 1.0).sqrt();
            let n = d * t - center;
            sky_light(d - 2.0 * d.dot(n) * n)
        })
    };
    let (smooth, flat) = (error(true), error(false));
    println!("mirror sphere: {smooth:.1e} smooth, {flat:.1e} flat");
    assert!(smooth < 0.05 && flat > 2.0 * smooth, "{smooth} smooth, {flat} flat");
}

#[test]
fn mirrors_that_face_each_other_end_in_uncovered_light() {
    let mut scene = Scene::default();
    add_of(&mut scene, Role::Scene, &box_of(DVec3::splat(-1.0), DVec3::splat(1.0)), mirror());
    let found = picture(&gdibl(&scene, &[], Some(&smooth_sky())), &look(DVec3::ZERO, DVec3::X, 60.0), &SETTINGS);
    assert!(found.image.pixels.iter().all(|pixel| *pixel == [0.0; 3]));
    assert_eq!(found.uncovered, 1.0);
    assert_eq!(found.rays, 16 * 12 * 16 * 4, "the camera's ray and three mirrors");
}

#[test]
fn panorama_of_an_empty_level_is_the_distant_panorama() {
    let sky = smooth_sky();
    let scene = Scene::default();
    let settings = RenderSettings { width: 32, height: 16, samples: 64, ..SETTINGS };
    let camera = Camera::Panorama { position: DVec3::new(3.0, 1.0, -2.0) };
    let found = picture(&gdibl(&scene, &[], Some(&sky)), &camera, &settings);
    // A pixel is the mean of the four by four that it covers.
    let full = &sky.panorama;
    let mean = |x: usize, y: usize| {
        let all = (0..16).map(|i| (4 * x + i % 4, 4 * y + i / 4));
        let weigh = |(x, y): (usize, usize)| {
            let weight = full.pixel_solid_angle(y) as f32;
            (full.pixel(x, y) * weight).extend(weight)
        };
        let sum: Vec4 = all.map(weigh).sum();
        sum.truncate() / sum.w
    };
    let error = worst(&found, mean);
    println!("panorama: {error:.1e}");
    assert!(error < 2e-3, "{error}");
    // Not by way of a mirror or a turn.
    assert!(worst(&found, |x, y| mean(31 - x, y)) > 0.5);
}

#[test]
fn picture_does_not_depend_on_threads_but_on_the_seed() {
    let mut scene = room_with_pillar();
    add(&mut scene, Role::Scene, &solid_of(DVec3::new(-1.0, -0.5, -0.5), DVec3::new(-0.6, 0.0, 0.0)));
    add_of(&mut scene, Role::Scene, &solid_of(DVec3::new(-0.4, 0.0, -1.5), DVec3::new(0.2, 0.6, -1.0)), mirror());
    let probes = coloured_probes();
    let camera = look(DVec3::new(-2.5, 1.5, 2.0), DVec3::new(-0.3, 0.0, -0.8), 60.0);
    let take = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        // A new function each time: its texels must not depend on who asks first.
        pool.install(|| picture(&gdibl(&scene, &probes, None), &camera, &RenderSettings { seed, ..SETTINGS }))
    };
    let one = take(1, 0);
    assert_eq!(one, take(3, 0));
    assert_ne!(one.image, take(3, 1).image);
}

#[test]
fn dull_objects_are_lit_by_the_volume_where_one_is_given() {
    // The volume knows L = 1 + y, so E(n) = π (1 + ⅔ n.y); the probes know darkness.
    let sky = distant(panorama(256, |d| [1.0 + d.y, 3.0 + 3.0 * d.y, 0.5]));
    let nodes = Nodes::Grid(grid_of_counts(DVec3::splat(-2.0), DVec3::splat(2.0), [2; 3]));
    let volume = volume_of(&nodes, &gdibl(&Scene::default(), &[], Some(&sky)), &BakeSettings { bands: 1, ..SMALL });
    let mut scene = Scene::default();
    add_of(&mut scene, Role::Environment, &box_of(DVec3::splat(-3.0), DVec3::splat(3.0)), dull(0.0));
    add_of(&mut scene, Role::Scene, &solid_of(DVec3::splat(-0.5), DVec3::splat(0.5)), dull(0.4));
    let probes = [probe(DVec3::new(1.0, 1.5, 2.0), 16, |_| [0.0; 3])];
    let function = gdibl(&scene, &probes, None);
    for (eye, lobe) in [(DVec3::Y, 1.0 + 2.0 / 3.0), (DVec3::NEG_Y, 1.0 - 2.0 / 3.0), (DVec3::X, 1.0)] {
        // One face fills the picture.
        let camera = look(eye * 1.5, DVec3::ZERO, 30.0);
        let found = picture_by(&function, Some(&objects_by(&volume)), &camera, &SETTINGS);
        let expected = 0.4 * Vec3::new(lobe, 3.0 * lobe, 0.5);
        let error = worst(&found, |_, _| expected);
        println!("volume from {eye}: {error:.1e}");
        assert!(error < 0.02, "from {eye}: {error}, {:?}", found.image.pixels[0]);
        assert_eq!(found.uncovered, 0.0);
        let without = picture(&function, &camera, &SETTINGS);
        assert!(without.image.pixels.iter().all(|pixel| *pixel == [0.0; 3]), "the probes are black");
    }
    // Environment geometry shows its probes in any case.
    let wall =
        picture_by(&function, Some(&objects_by(&volume)), &look(DVec3::splat(2.0), DVec3::splat(2.5), 30.0), &SETTINGS);
    assert!(wall.image.pixels.iter().all(|pixel| *pixel == [0.0; 3]));
}

#[test]
fn every_surface_is_lit_by_the_volume_as_an_engine_shows_it() {
    // As above: E(n) = π (1 + ⅔ n.y). No other light is there, and none is needed.
    let sky = distant(panorama(256, |d| [1.0 + d.y, 3.0 + 3.0 * d.y, 0.5]));
    let nodes = Nodes::Grid(grid_of_counts(DVec3::splat(-2.0), DVec3::splat(2.0), [2; 3]));
    let volume = volume_of(&nodes, &gdibl(&Scene::default(), &[], Some(&sky)), &BakeSettings { bands: 1, ..SMALL });
    let mut scene = Scene::default();
    add_of(&mut scene, Role::Environment, &box_of(DVec3::splat(-3.0), DVec3::splat(3.0)), dull(0.4));
    let function = Path::new(&scene, None, PathSettings::default());
    let light = VolumeLight::of(&volume);
    for (target, lobe) in [(DVec3::Y, 1.0 - 2.0 / 3.0), (DVec3::NEG_Y, 1.0 + 2.0 / 3.0), (DVec3::X, 1.0)] {
        let camera = look(DVec3::ZERO, target, 30.0);
        let expected = 0.4 * Vec3::new(lobe, 3.0 * lobe, 0.5);
        let error = worst(&picture_by(&function, Some(&light), &camera, &SETTINGS), |_, _| expected);
        assert!(error < 0.02, "toward {target}: {error}");
    }
    // A node before a wall is seen, one behind it is not.
    let node = (0..8).find(|node| volume.node_position(*node) == [-2.0; 3]).expect("a corner");
    for (distance, is_seen) in [(2.0, true), (4.0, false)] {
        let sphere = Sphere { centre: DVec3::X * distance, radius: 0.5, look: SphereLook::Light(node) };
        let light = VolumeLight { spheres: vec![sphere], ..light.clone() };
        let found = picture_by(&function, Some(&light), &look(DVec3::ZERO, DVec3::X, 5.0), &SETTINGS);
        // The sphere is white, the wall not.
        let expected = if is_seen { 1.0 } else { 0.4 } * Vec3::new(1.0, 3.0, 0.5);
        let error = worst(&found, |_, _| expected);
        assert!(error < 0.1, "a node {distance} m away: {error}");
    }
}

#[test]
fn shadow_on_a_wall_is_seen_where_it_falls() {
    // A black square over the middle of a floor of albedo ρ under light of 1: 1 - ρ F, F its form factor from the floor.
    let (albedo, half, height) = (0.2f32, 0.4, 0.8);
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::splat(-3.0), DVec3::splat(3.0)));
    scene.materials[0] = dull(albedo);
    let at = |x: f64, z: f64| DVec3::new(x * half, height - 3.0, z * half);
    let square = [[at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0)], [at(-1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)]];
    add_of(&mut scene, Role::Scene, &square, dull(0.0));
    let probes = [probe(DVec3::new(0.3, 1.5, 0.2), 16, |_| [1.0; 3])];
    let settings = RenderSettings { width: 4, height: 4, samples: 1024, ..SETTINGS };
    let light = |target: DVec3| {
        let found = picture(&gdibl(&scene, &probes, None), &look(DVec3::new(2.0, -2.9, 0.0), target, 0.5), &settings);
        found.image.pixels.iter().map(|pixel| pixel[0]).sum::<f32>() / 16.0
    };
    let a = (half / height) as f32;
    let form = 4.0 / PI as f32 * (a / (1.0 + a * a).sqrt()) * (a / (1.0 + a * a).sqrt()).atan();
    let (under, beside) = (light(DVec3::new(0.0, -3.0, 0.0)), light(DVec3::new(-2.5, -3.0, 0.0)));
    println!("shadow: {under}, expected {}", 1.0 - albedo * form);
    // Light that comes back by way of other shaded walls is left out of the expectation: less than ρ times as much.
    assert!((under - (1.0 - albedo * form)).abs() < 0.005, "{under}, expected {}", 1.0 - albedo * form);
    assert!(beside > 0.99 && beside < 1.0, "{beside}");
}

#[test]
fn light_on_objects_is_found_where_it_is_bright_and_counted_once() {
    // A plate under a sky with a bright patch, of a thirtieth of the directions by cosine: those alone would be off by half
    // at 64 samples.
    let mut scene = Scene::default();
    let corners = [[-3.0, -3.0], [-3.0, 3.0], [3.0, 3.0], [3.0, -3.0]].map(|[x, z]| DVec3::new(x, 0.0, z));
    let plate = [[corners[0], corners[1], corners[2]], [corners[0], corners[2], corners[3]]];
    add_of(&mut scene, Role::Scene, &plate, dull(0.7));
    let bright = Vec3::new(0.5, 0.7, 0.3).normalize();
    let sky = distant(panorama(64, |d| if d.angle_between(bright) < 0.2 { [60.0, 30.0, 20.0] } else { [0.5; 3] }));
    let directions = fibonacci_sphere(1 << 18);
    let irradiance: f64 =
        directions.iter().map(|d| f64::from(sky.panorama.radiance(*d).x * d.y.max(0.0))).sum::<f64>() * 4.0 * PI
            / directions.len() as f64;
    let expected = (0.7 / PI * irradiance) as f32;
    let camera = look(DVec3::new(-2.0, 2.0, 2.5), DVec3::ZERO, 10.0);
    let off = |samples: u32| {
        let settings = RenderSettings { width: 6, height: 4, samples, ..SETTINGS };
        let pixels = picture(&gdibl(&scene, &[], Some(&sky)), &camera, &settings).image.pixels;
        let offs: Vec<f32> = pixels.iter().map(|pixel| pixel[0] / expected - 1.0).collect();
        (offs.iter().sum::<f32>() / offs.len() as f32, rms(&offs))
    };
    let (bias, _) = off(4096);
    let (_, noise) = off(64);
    println!("bias {bias:.1e}, noise of 64 samples {noise:.3}");
    assert!(bias.abs() < 2e-3, "{bias}");
    assert!(noise < 0.15, "{noise}");
}

#[test]
fn cancelled_picture_is_interrupted() {
    let scene = room_with_cube();
    let probes = [probe(DVec3::new(1.0, 1.5, 2.0), 16, |_| [1.0; 3])];
    let control = Control { cancel: &AtomicBool::new(true), progress: &|_, _| {}, blocks: None };
    let settings = RenderSettings { samples: 1 << 31, ..SETTINGS };
    let camera = look(DVec3::new(2.0, 1.0, 2.5), DVec3::ZERO, 70.0);
    assert_eq!(render(&gdibl(&scene, &probes, None), None, &camera, &settings, &control), Err(Interrupted));
}
