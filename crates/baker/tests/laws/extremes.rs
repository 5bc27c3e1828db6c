//! Smaller twins of the rows of `tools/extremes` that no other law covers.

use gdibl_baker::Control;
use gdibl_baker::analyse::{IrradianceError, Light, Pair};
use gdibl_baker::bake::{BakeSettings, Baked, Nodes};
use gdibl_baker::capture::{CaptureSettings, capture};
use gdibl_baker::job::records::Records;
use gdibl_baker::pack::{PackSettings, Precision, pack};
use gdibl_baker::panorama::Panorama;
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings};
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::scene::{Material, Role, Scene};
use gdibl_runtime::grid::Grid;
use gdibl_runtime::{RadianceSh, Volume};
use glam::{DVec3, Vec3};
use std::sync::atomic::AtomicBool;

use crate::exact::{exact_sh, pixel_on_walls};
use crate::level::*;

fn error_of(baked: &Baked, truth: impl Fn(usize) -> RadianceSh) -> IrradianceError {
    let pair = |node| Pair { found: sh_of(baked, node), truth: Light::Radiance(truth(node)), variance: None };
    IrradianceError::of(&(0..baked.len()).map(pair).collect::<Vec<_>>())
}

#[test]
fn half_floats_keep_the_furnace_in_every_number_of_bands() {
    let (scene, probes) = (room_with_pillar(), white_probes([1.0, 1e-3, 2e4]));
    let nodes = Nodes::Points(places());
    for bands in 0..=4 {
        let baked = bake_points(&gdibl(&scene, &probes, None), &places(), &BakeSettings { bands, ..SMALL });
        let settings = PackSettings { precision: Precision::F16, ..PackSettings::default() };
        let volume = Volume::parse(&pack(&nodes, &baked, Records::default(), settings).bytes).unwrap();
        for node in 0..nodes.len() {
            let pair =
                Pair { found: volume.node_sh(node), truth: Light::Radiance(sh_of(&baked, node)), variance: None };
            for channel in IrradianceError::of(&[pair]).channels {
                assert!(channel.relative_rmse < 6e-4, "L{bands}: {:.1e}", channel.relative_rmse);
            }
        }
    }
}

#[test]
fn one_triangle_that_nobody_has_seen_is_uncovered_and_filled() {
    let mut scene = Scene::default();
    let corners = [[-1.0, 1.0, -1.0], [1.0, 1.0, -1.0], [1.0, 1.0, 1.0]].map(DVec3::from);
    add(&mut scene, Role::Environment, &[corners]);
    let sky = distant(panorama(16, |_| [2.0; 3]));
    let baked = bake_points(&gdibl(&scene, &[], Some(&sky)), &[DVec3::ZERO], &BakeSettings { samples: 4096, ..SMALL });
    // Half of a face of a cube around the node: a twelfth of the sphere.
    assert!((baked.coverage[0] - 11.0 / 12.0).abs() < 5e-3, "{:?}", baked.coverage);
    assert!((baked.node(0)[0] / (2.0 * (4.0 * std::f32::consts::PI).sqrt()) - 1.0).abs() < 1e-4);
}

#[test]
fn bright_pixel_of_a_probe_is_found_on_walls_and_over_edges() {
    let walls = [DVec3::new(-3.0, -1.0, -2.0), DVec3::new(3.0, 2.0, 2.5)];
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(walls[0], walls[1]));
    let points = [[1.5, 0.8, 0.4], [2.0, -0.4, -0.4], [-1.5, 0.9, 0.2], [0.2, 1.4, 1.9]].map(DVec3::from);
    let plain = [probe(DVec3::new(0.3, 0.4, 0.2), 256, |d| [1.0 + d.y, 1.0, 1.2 + d.x * d.z])];
    let rest = bake_points(&gdibl(&scene, &plain, None), &points, &BakeSettings { samples: 1 << 15, ..SMALL });
    for pixel in [[70usize, 50usize], [17, 70], [100, 4]] {
        for bright in [1e5f32, 1e9] {
            let mut probes = plain.clone();
            probes[0].panorama = with_pixel(&probes[0].panorama, pixel, [bright; 3]);
            let truth = |node: usize| {
                let mut sum = pixel_on_walls(walls, probes[0].position, 256, pixel, bright.into(), points[node]);
                sum.add_scaled(&sh_of(&rest, node), 1.0);
                sum
            };
            let settings = BakeSettings { samples: 4096, ..SMALL };
            let baked = bake_points(&gdibl(&scene, &probes, None), &points, &settings);
            let error = error_of(&baked, truth).relative_rmse;
            println!("{pixel:?}, {bright:e}: {error:.1e}");
            // Without regions it was 0.9.
            assert!(error < 0.015, "{pixel:?}, {bright:e}: {error:.3}");
        }
    }
}

#[test]
fn sun_over_a_room_makes_no_firefly() {
    let mut scene = room_with_pillar();
    let room = &mut scene.meshes[0];
    room.triangles.retain(|t| t.iter().any(|&i| room.positions[i as usize].y < 2.0));
    let probes = coloured_probes();
    let points: Vec<DVec3> = (0..64)
        .map(|i| DVec3::new(f64::from(i % 4), f64::from(i / 4 % 4), f64::from(i / 16)))
        .map(|p| DVec3::new(-2.8, -0.8, -1.8) + p * DVec3::new(1.8, 0.85, 1.35))
        .collect();
    for sun in [1e5, 1e9] {
        let image = panorama(256, |d| [1.0 + d.y, 1.0, 1.2 + d.x * d.z]);
        let sky = distant(with_pixel(&image, [70, 30], [sun; 3]));
        let function = gdibl(&scene, &probes, Some(&sky));
        let [few, many] =
            [1024, 8192].map(|samples| bake_points(&function, &points, &BakeSettings { samples, ..SMALL }));
        for node in 0..points.len() {
            let [few, many] = [&few, &many].map(|baked| baked.node(node)[0]);
            assert!(few < 1.2 * many, "sun {sun:e}, node {node}: {few}, converged {many}");
        }
    }
}

#[test]
fn strange_images_bake_to_their_own_integral() {
    let scene = Scene::default();
    let check = |name: &str, image: Panorama, truth: RadianceSh| {
        let sky = distant(image);
        let settings = BakeSettings { samples: 4096, ..SMALL };
        let baked = bake_points(&gdibl(&scene, &[], Some(&sky)), &[DVec3::ZERO; 4], &settings);
        assert!(baked.is_all_valid() && baked.sh.to_vec().iter().all(|v| v.is_finite()), "{name}");
        let error = error_of(&baked, |_| truth);
        println!("{name}: {:.1e}", error.rmse);
        assert!(error.relative_rmse < 0.01 || error.rmse == 0.0, "{name}: {}", error.relative_rmse);
    };
    let wide = panorama(128, |d| [d.x, d.y, d.z].map(|t| 10f32.powf(6.0 * t)));
    check("1e-6 to 1e6", wide.clone(), exact_sh(&wide, 2));
    let black = panorama(16, |_| [0.0; 3]);
    check("black", black.clone(), exact_sh(&black, 2));
    let odd = Panorama::new(333, 111, (0..333 * 111).map(|i| [1.0 + (i % 7) as f32, 2.0, 3.0]).collect(), None);
    check("333 × 111", odd.clone(), exact_sh(&odd, 2));
    // Between two pixels side by side, or with one, light is a constant or a ramp round the equator: L_00 is the mean.
    for (width, height) in [(1, 1), (2, 1), (1, 2)] {
        let pixels = (0..width * height).map(|i| [1.0 + i as f32, 2.0, 2.0 - i as f32]).collect();
        let sky = distant(Panorama::new(width, height, pixels, None));
        let baked =
            bake_points(&gdibl(&scene, &[], Some(&sky)), &[DVec3::ZERO], &BakeSettings { samples: 4096, ..SMALL });
        let mean = if width * height == 2 { [1.5, 2.0, 1.5] } else { [1.0, 2.0, 2.0] };
        for (found, mean) in baked.node(0).iter().zip(mean) {
            let found = found / (4.0 * std::f32::consts::PI).sqrt();
            assert!((found / mean - 1.0).abs() < 5e-3, "{width} × {height}: {found}, mean {mean}");
        }
    }
}

#[test]
fn fill_of_a_third_is_smooth_and_the_same_again() {
    let half = (1.0 / (1.0 / (std::f64::consts::PI / 3.0).sin() - 1.0)).sqrt();
    let mut scene = Scene::default();
    let [a, b, c, d] = [[-half, -half], [half, -half], [half, half], [-half, half]].map(|[x, y]| DVec3::new(x, y, 1.0));
    add(&mut scene, Role::Environment, &[[a, b, c], [a, c, d]]);
    scene.materials[0].double_sided = true;
    let sky = distant(panorama(64, |d| [1.5 + d.y, 1.2 + d.x, 1.0 - 0.5 * d.z]));
    let function = gdibl(&scene, &[], Some(&sky));
    let line: Vec<DVec3> = (0..9).map(|i| DVec3::X * (0.01 * f64::from(i))).collect();
    let settings = BakeSettings { samples: 4096, ..SMALL };
    let baked = bake_points(&function, &line, &settings);
    assert!((baked.coverage[0] - 2.0 / 3.0).abs() < 0.01, "{:?}", baked.coverage);
    assert_eq!(bake_points(&function, &line, &settings), baked);
    let mut shifted = baked.clone();
    shifted.sh = baked.sh.selected((1..=line.len()).map(|node| node % line.len()));
    for node in 0..line.len() - 1 {
        let pair = Pair { found: sh_of(&shifted, node), truth: Light::Radiance(sh_of(&baked, node)), variance: None };
        let step = IrradianceError::of(&[pair]).relative_rmse;
        assert!(step < 0.02, "{node}: {step}");
    }
}

#[test]
fn volume_of_one_node_is_the_same_light_everywhere() {
    let (scene, probes) = (room_with_pillar(), coloured_probes());
    let grid = Grid { min: [-1.0, 0.0, 0.0], max: [1.0, 1.0, 1.0], counts: [1; 3] };
    let volume = volume_of(&Nodes::Grid(grid), &gdibl(&scene, &probes, None), &SMALL);
    let [here, far] = [[0.0, 0.5, 0.5], [-9.0, 0.2, 3.0]].map(|p| volume.sample_f64(p, [0.0, 1.0, 0.0]));
    assert_eq!((here.sh, volume.node_count()), (far.sh, 1));
    assert!(here.sh.coefficients[0][0] > 0.1 && here.inside && !far.inside);
}

/// Adds triangles of a material of their own.
fn add_of(scene: &mut Scene, triangles: &[Triangle], albedo: f32, emission: f32) {
    add(scene, Role::Environment, triangles);
    let base_color = Vec3::splat(albedo).extend(1.0);
    let material = Material { base_color, metallic: 0.0, emission: Vec3::splat(emission), ..Material::default() };
    scene.materials.push(material);
    scene.meshes.last_mut().unwrap().material = scene.materials.len() as u32 - 1;
}

/// At how many of 4 nodes × 25 seeds the interval of a bake with 512 samples (by samples and seed) holds what a long one
/// comes to.
fn covered_of_100(of: impl Fn(u64, u64) -> Baked) -> u32 {
    let truth = of(1 << 16, 1000);
    let mut inside = 0;
    for seed in 0..25 {
        let baked = of(512, seed);
        for (node, claim) in standard_errors(&baked).into_iter().enumerate() {
            let mut difference = sh_of(&baked, node);
            difference.add_scaled(&sh_of(&truth, node), -1.0);
            inside += u32::from(strength(&difference) <= 3.18 * claim);
        }
    }
    inside
}

#[test]
fn error_bar_covers_a_small_lamp_behind_a_slit() {
    // Two rooms of 2 m with a slit of 2 cm, and a lamp of 1 cm² close behind it.
    let mut scene = Scene::default();
    add_of(&mut scene, &box_of(DVec3::new(-2.0, 0.0, -1.0), DVec3::new(2.0, 2.0, 1.0)), 0.5, 0.0);
    for side in [[-1.0, -0.01], [0.01, 1.0]] {
        add_of(&mut scene, &solid_of(DVec3::new(-0.05, 0.0, side[0]), DVec3::new(0.05, 2.0, side[1])), 0.5, 0.0);
    }
    let [a, b, c, d] =
        [[-0.505, -0.005], [-0.505, 0.005], [-0.495, 0.005], [-0.495, -0.005]].map(|[x, z]| DVec3::new(x, 1.5, z));
    add_of(&mut scene, &[[a, c, b], [a, d, c]], 0.0, 1e5);
    let path = Path::new(&scene, None, PathSettings::default());
    assert_eq!(path.guide().emitter_count(), 2);
    let points = [[0.5, 0.5, 0.0], [1.0, 0.7, 0.01], [1.0, 1.0, 0.5], [0.2, 1.9, 0.9]].map(DVec3::from);
    let inside = covered_of_100(|samples, seed| bake_points(&path, &points, &BakeSettings { samples, seed, ..SMALL }));
    // Student's t of 3 degrees: 95 %. Measured 96 %; heavy tails. Of 100 fewer than 80 by chance less than once in 1e4, were
    // it 93 %.
    println!("{inside} of 100");
    assert!(inside >= 80, "{inside} of 100");
}

#[test]
fn error_bar_covers_light_of_three_bounces_in_a_probe() {
    // A corridor with three baffles, a lamp at one end, the probe and the nodes at the other.
    let mut scene = Scene::default();
    add_of(&mut scene, &box_of(DVec3::ZERO, DVec3::new(8.0, 3.0, 3.0)), 0.7, 0.0);
    for (x, from, to) in [(2.0, 0.0, 2.0), (4.0, 1.0, 3.0), (6.0, 0.0, 2.0)] {
        add_of(&mut scene, &solid_of(DVec3::new(x, 0.0, from), DVec3::new(x + 0.02, 3.0, to)), 0.7, 0.0);
    }
    let [a, b, c, d] = [[0.45, 0.45], [0.45, 0.55], [0.55, 0.55], [0.55, 0.45]].map(|[x, z]| DVec3::new(x, 2.9, z));
    add_of(&mut scene, &[[a, c, b], [a, d, c]], 0.0, 1e4);
    let points = [[7.5, 1.0, 0.5], [7.2, 2.0, 1.5], [7.9, 0.1, 2.8], [7.3, 1.5, 0.3]].map(DVec3::from);
    let two = Path::new(&scene, None, PathSettings { bounces: Some(2), ..PathSettings::default() });
    assert!(bake_points(&two, &points, &SMALL).sh.to_vec().iter().all(|v| *v == 0.0), "no light by two bounces");
    let path = Path::new(&scene, None, PathSettings::default());
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    let position = DVec3::new(7.4, 1.5, 1.2);
    let settings = CaptureSettings { width: 32, samples: 64, ..CaptureSettings::default() };
    let image = capture(&path, position, 0, &settings, &control).expect("nobody interrupts").image;
    let mut probes = [probe(position, 2, |_| [0.0; 3])];
    probes[0].panorama = Panorama::new(image.width, image.height, image.pixels, image.distance);
    let function = gdibl(&scene, &probes, None);
    let inside =
        covered_of_100(|samples, seed| bake_points(&function, &points, &BakeSettings { samples, seed, ..SMALL }));
    // As above; measured 98 %.
    println!("{inside} of 100");
    assert!(inside >= 85, "{inside} of 100");
}

#[test]
fn rooms_in_rooms_a_million_times_as_large_keep_their_own_light() {
    // A box of 10 cm in a room of 1 m in a hall of 10 m in a city of 100 km. Nodes beside a wall of the small ones went through it.
    let (edges, radiance) = ([0.1, 1.0, 10.0, 1e5], [8.0f32, 4.0, 2.0, 1.0]);
    let middle = |room: usize| if room == 3 { DVec3::ZERO } else { DVec3::new(10.0, 0.3, -10.0) };
    let mut scene = Scene::default();
    for (room, edge) in edges.into_iter().enumerate() {
        let half = DVec3::splat(0.5 * edge);
        add(&mut scene, Role::Environment, &box_of(middle(room) - half, middle(room) + half));
        if room < 3 {
            add(&mut scene, Role::Environment, &solid_of(middle(room) - half * 1.2, middle(room) + half * 1.2));
        }
    }
    let place = |room: usize, share: f64| middle(room) + DVec3::new(0.42, 0.3, -0.1) * edges[room] * share;
    let rooms = [0, 1, 2, 3];
    let probes = rooms.map(|room| probe(place(room, 0.8), 32, |_| [radiance[room]; 3]));
    let function = gdibl(&scene, &probes, None);
    let points = rooms.map(|room| place(room, 1.0));
    for room in rooms {
        let error = furnace_error(&function, &points[room..=room], &SMALL, [radiance[room]; 3]);
        assert!(error < 1e-3, "room of {} m: {error:.1e}", edges[room]);
    }
}

#[test]
fn walls_a_thousand_times_as_long_as_wide_lose_no_light() {
    // 2 m wide, 3 m high, 2 km long; every wall sends out 1/2 and reflects 1/2: light of 1 everywhere. Rays met the walls that they left
    // again, from behind, and the middle was 5 % too dark.
    let mut scene = Scene::default();
    add_of(&mut scene, &box_of(DVec3::ZERO, DVec3::new(2.0, 3.0, 2000.0)), 0.5, 0.5);
    let points = [250.0, 1000.0, 1000.3].map(|z| DVec3::new(0.7, 1.2, z));
    let path = Path::new(&scene, None, PathSettings::default());
    let baked = bake_points(&path, &points, &BakeSettings { samples: 1 << 14, ..SMALL });
    let mean =
        (0..3).map(|node| f64::from(baked.node(node)[0])).sum::<f64>() / 3.0 / (4.0 * std::f64::consts::PI).sqrt();
    // Of one node the standard error is 0.3 %; all three see the same light.
    assert!((mean - 1.0).abs() < 0.01, "{mean}");
}

#[test]
fn what_hides_behind_a_lamp_is_not_filled_with_its_light() {
    // A lamp of 40 cm hangs 5 cm under the ceiling. The black probe tells nothing but what it sees: E is that of the lamp alone.
    let mut scene = Scene::default();
    add_of(&mut scene, &box_of(DVec3::new(-3.0, 0.0, -2.0), DVec3::new(3.0, 3.0, 2.5)), 0.5, 0.0);
    let [a, b, c, d] = [[-0.2, -0.2], [-0.2, 0.2], [0.2, 0.2], [0.2, -0.2]].map(|[x, z]| DVec3::new(x, 2.95, z));
    add_of(&mut scene, &[[a, c, b], [a, d, c]], 0.0, 50.0);
    let probes = [probe(DVec3::new(-1.0, 1.5, 0.3), 64, |_| [0.0; 3])];
    let settings = GdiblSettings { emission_from_materials: true, ..GdiblSettings::default() };
    let function = Gdibl::new(&scene, &probes, None, settings);
    let points = [[1.5, 1.0, 0.4], [2.0, 2.4, -0.4], [0.2, 0.4, 1.9]].map(DVec3::from);
    let settings = BakeSettings { samples: 8192, ..SMALL };
    let baked = bake_points(&function, &points, &settings);
    let direct = Path::new(&scene, None, PathSettings { bounces: Some(0), ..PathSettings::default() });
    let truth = bake_points(&direct, &points, &settings);
    assert!(
        baked.coverage.iter().all(|coverage| *coverage < 0.99999),
        "some of the ceiling is hidden: {:?}",
        baked.coverage
    );
    let error = error_of(&baked, |node| sh_of(&truth, node)).relative_rmse;
    // It was 12 %.
    assert!(error < 0.01, "{error}");
}
