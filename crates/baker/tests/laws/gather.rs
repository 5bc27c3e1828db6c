//! Irradiance at places of surfaces, straight over the hemisphere.

use gdibl_baker::bake::{GatherSettings, Gathered, SurfacePlace, irradiance_at};
use gdibl_baker::panorama::Panorama;
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::sampling::{Sampler, fibonacci_sphere};
use gdibl_baker::scene::{Role, Scene};
use gdibl_baker::{Control, Interrupted};
use glam::{DVec3, Vec3};
use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

use crate::level::*;

fn gather(function: &impl RadianceFunction, places: &[SurfacePlace], settings: &GatherSettings) -> Vec<Gathered> {
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    let found = irradiance_at(places, function, settings, &control).expect("nobody interrupts");
    assert_eq!(found.len(), places.len());
    found
}

/// Places at `position` that face `count` ways.
fn around(position: DVec3, count: usize) -> Vec<SurfacePlace> {
    fibonacci_sphere(count).into_iter().map(|normal| SurfacePlace { position, normal }).collect()
}

#[test]
fn constant_light_gives_pi_l_exactly_with_any_number_of_samples() {
    let light = DVec3::new(0.5, 3.0, 1e4);
    let scene = room_with_pillar();
    let probes = [probe(DVec3::new(1.8, 1.1, 1.7), 16, |_| light.as_vec3().to_array())];
    let sky = distant(panorama(16, |_| light.as_vec3().to_array()));
    let level = gdibl(&scene, &probes, None);
    let empty = Scene::default();
    let open = gdibl(&empty, &[], Some(&sky));
    for (samples, sampler, guided) in [
        (1, Sampler::Sobol, true),
        (50, Sampler::Random, false),
        (50, Sampler::Random, true),
        (256, Sampler::Sobol, true),
    ] {
        let settings = GatherSettings { samples, sampler, guided, ..GatherSettings::default() };
        for found in
            [gather(&open, &around(DVec3::ZERO, 8), &settings), gather(&level, &around(places()[1], 8), &settings)]
        {
            for (i, found) in found.iter().enumerate() {
                // One guided sample may go below the horizon.
                if samples > 1 || found.coverage > 0.0 {
                    let error = (found.irradiance / (light * PI) - 1.0).abs().max_element();
                    assert!(error < 1e-5, "{samples} {sampler:?} {guided}, place {i}: {error:.1e}");
                    let noise = (found.standard_error / found.irradiance).max_element();
                    assert!(if samples > 1 { noise < 1e-5 } else { noise == f64::INFINITY }, "{noise:.1e}");
                }
            }
        }
    }
    // In the room the pillar hides some of the walls from the probe; all of the sky is seen.
    let coverage = |found: Vec<Gathered>| found.iter().map(|f| f.coverage).fold(1.0, f64::min);
    let settings = GatherSettings { samples: 256, ..GatherSettings::default() };
    let hidden = coverage(gather(&level, &around(DVec3::new(-0.5, 0.0, -1.0), 8), &settings));
    assert!((0.2..0.999).contains(&hidden), "{hidden}");
    assert_eq!(coverage(gather(&open, &around(DVec3::ZERO, 8), &settings)), 1.0);
}

/// ∫ L max(n·ω, 0) dω of a panorama as it is reconstructed: midpoints of 16 × 16 parts of every pixel, in f64.
fn exact(panorama: &Panorama, normal: Vec3) -> DVec3 {
    let (width, height) = (panorama.width() * 16, panorama.height() * 16);
    let mut sum = DVec3::ZERO;
    for y in 0..height {
        let latitude = PI * (0.5 - (y as f64 + 0.5) / height as f64);
        let area = latitude.cos() * PI / height as f64 * 2.0 * PI / width as f64;
        for x in 0..width {
            let longitude = 2.0 * PI * (0.5 - (x as f64 + 0.5) / width as f64);
            let direction =
                DVec3::new(longitude.sin() * latitude.cos(), latitude.sin(), longitude.cos() * latitude.cos());
            let cosine = direction.dot(normal.as_dvec3());
            if cosine > 0.0 {
                sum += panorama.radiance(direction.as_vec3()).as_dvec3() * (cosine * area);
            }
        }
    }
    sum
}

#[test]
fn sky_with_a_sun_gives_its_integral() {
    let sky = panorama(32, |d| [1.0 + 0.5 * d.y, 0.8, 1.2 + 0.4 * d.x]);
    let distant = distant(with_pixel(&sky, [21, 4], [5e4, 4e4, 3e4]));
    let scene = Scene::default();
    let settings = GatherSettings { samples: 4096, ..GatherSettings::default() };
    let places = around(DVec3::ZERO, 6);
    let by_probes = gather(&gdibl(&scene, &[], Some(&distant)), &places, &settings);
    // The sun is found by construction: by cosine alone it is a matter of luck.
    let blind = gather(&gdibl(&scene, &[], Some(&distant)), &places, &GatherSettings { guided: false, ..settings });
    let (mut sunny, mut worst_blind) = (0, 0.0f64);
    for ((place, found), blind) in places.iter().zip(&by_probes).zip(&blind) {
        let truth = exact(&distant.panorama, place.normal);
        let error = (found.irradiance / truth - 1.0).abs().max_element();
        println!("{}: {error:.1e}, E {:.1}, by cosine alone {:.1}", place.normal, truth.x, blind.irradiance.x);
        assert!(error < 0.01, "{}: {error}", place.normal);
        // 16 replicates: Student's t of 15 degrees is under 4.9 with a false-alarm rate of 2e-4, 18 times. And the midpoint
        // rule is off by a little.
        let limit = 4.9 * found.standard_error + 1e-4 * truth;
        assert!((found.irradiance - truth).abs().cmple(limit).all(), "{found:?}, {truth}");
        sunny += u32::from(truth.x > 50.0);
        worst_blind = worst_blind.max((blind.irradiance / truth - 1.0).abs().max_element());
    }
    assert!((2..5).contains(&sunny), "{sunny} of 6 see the sun");
    assert!(worst_blind > 0.05, "{worst_blind}");
}

#[test]
fn path_tracing_under_an_even_sky_gives_pi_l_too() {
    // Nothing of albedo 1 is darker or brighter than the sky, though its light is sampled.
    let mut scene = Scene::default();
    add(&mut scene, Role::Scene, &solid_of(DVec3::splat(-0.5), DVec3::splat(0.5)));
    let sky = distant(panorama(16, |_| [1.0; 3]));
    let settings = GatherSettings { samples: 4096, ..GatherSettings::default() };
    let place = [SurfacePlace { position: DVec3::new(0.0, -1.0, 0.0), normal: Vec3::Y }];
    let paths = gather(&Path::new(&scene, Some(&sky), PathSettings::default()), &place, &settings)[0];
    assert!((paths.irradiance.x / PI - 1.0).abs() < 0.01, "{paths:?}");
    assert!(paths.standard_error.x > 0.0 && paths.standard_error.x < 0.02, "the cube's light is sampled: {paths:?}");
}

#[test]
fn place_that_nothing_has_seen_says_so() {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::splat(-1.0), DVec3::splat(1.0)));
    let outside = [probe(DVec3::splat(5.0), 16, |_| [1.0; 3])];
    let found = gather(&gdibl(&scene, &outside, None), &around(DVec3::ZERO, 2), &GatherSettings::default());
    for found in found {
        assert_eq!((found.irradiance, found.coverage), (DVec3::ZERO, 0.0));
        assert_eq!(found.standard_error, DVec3::INFINITY);
    }
}

#[test]
fn cancelled_gathering_is_interrupted() {
    let scene = Scene::default();
    let sky = distant(panorama(16, |_| [1.0; 3]));
    let control = Control { cancel: &AtomicBool::new(true), progress: &|_, _| {}, blocks: None };
    let settings = GatherSettings { samples: 1 << 31, ..GatherSettings::default() };
    let found = irradiance_at(&around(DVec3::ZERO, 1), &gdibl(&scene, &[], Some(&sky)), &settings, &control);
    assert_eq!(found, Err(Interrupted));
}
