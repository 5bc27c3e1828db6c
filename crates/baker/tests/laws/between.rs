//! The error that people see: what the runtime reads between nodes, and what a bake says of it.

use gdibl_baker::Control;
use gdibl_baker::bake::{GatherSettings, SurfacePlace, irradiance_at};
use gdibl_baker::job::records::{SeenRecord, SeenSet};
use gdibl_baker::job::{Inputs, Job, Made, Memory, NodeKind, Settings, Watch};
use gdibl_baker::pack::Precision;
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::sampling::{Sampler, Stream, fibonacci_sphere, uniform_sphere};
use gdibl_baker::scene::{Role, Scene};
use gdibl_runtime::Volume;
use glam::{DVec3, Vec3};
use std::sync::atomic::AtomicBool;

use crate::level::*;

const BOX: [f64; 6] = [-1.0, -1.0, -1.0, 1.0, 1.0, 1.0];

fn settings(counts: [u32; 3], samples: u64) -> Settings {
    let mut settings = Settings::default();
    (settings.grid.bounds, settings.grid.counts) = (Some(BOX), Some(counts));
    settings.quality.samples = Some(samples);
    settings
}

fn bake(scene: &Scene, sky: impl Fn(Vec3) -> [f32; 3], settings: &Settings) -> Made {
    let inputs = Inputs { distant: Some(distant(panorama(64, sky))), ..Inputs::new(scene.clone()) };
    let job = Job::prepare(inputs, settings.clone(), Memory::UNBOUNDED).expect("it makes sense");
    job.run(&Watch::silent(&AtomicBool::new(false))).expect("nobody interrupts")
}

fn seen(made: &Made) -> Option<SeenRecord> {
    made.records.statistics.as_ref().expect("a job fills it in").seen
}

/// A wall in the box that hides half of a bright sky from the other half of the air.
fn wall() -> Scene {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &solid_of(DVec3::new(-0.1, -1.0, -0.6), DVec3::new(0.1, 0.7, 1.0)));
    scene
}

fn bright_on_one_side(direction: Vec3) -> [f32; 3] {
    if direction.x > 0.6 { [20.0, 15.0, 10.0] } else { [0.2, 0.3, 0.4] }
}

#[test]
fn light_that_is_the_same_everywhere_is_right_between_nodes() {
    let mut settings = settings([3, 3, 3], 256);
    settings.quality.seen_places = Some(64);
    let record = seen(&bake(&Scene::default(), |_| [1.0, 2.0, 3.0], &settings)).expect("a grid");
    let air: SeenSet = record.air.expect("it is lit");
    assert_eq!((air.places, record.surfaces), (64, None), "there is no surface");
    // What is left are the numbers of the file.
    assert!(air.error.max < 2e-3 && air.parts.packing < 2e-3, "{air:?}");
    assert!(air.parts.between < 2e-3 && air.parts.bands < 2e-3 && air.parts.noise < 2e-3, "{air:?}");
}

#[test]
fn what_is_said_is_what_is_measured_at_other_places() {
    let scene = wall();
    let sky = distant(panorama(64, bright_on_one_side));
    let mut settings = settings([5, 5, 5], 512);
    settings.quality.seen_places = Some(2000);
    let made = bake(&scene, bright_on_one_side, &settings);
    let said = seen(&made).and_then(|seen| seen.air).expect("air that is lit").error;
    let volume = Volume::parse(&made.sections().assemble().bytes).expect("what was packed parses");
    // Places of this test's own, by another stream of random numbers.
    let function = Path::new(&scene, Some(&sky), PathSettings::default());
    let stream = Stream::new(Sampler::Sobol, 123, 0, 0);
    let place = |i: u32| {
        let ([x, y], [z, _]) = (stream.point(i, 0), stream.point(i, 1));
        let position = DVec3::new(x.into(), y.into(), z.into()) * 2.0 - 1.0;
        SurfacePlace { position, normal: uniform_sphere(stream.point(i, 2)) }
    };
    let solid = |p: DVec3| p.x.abs() < 0.1 && p.y < 0.7 && p.z > -0.6;
    let places: Vec<SurfacePlace> = (0..4000).map(place).filter(|place| !solid(place.position)).collect();
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    let gather = GatherSettings { samples: 2048, seed: 5, ..GatherSettings::default() };
    let truth = irradiance_at(&places, &function, &gather, &control).expect("nobody interrupts");
    let size = |light: Vec3| f64::from(light.length()) / 3f64.sqrt();
    let floor = 0.1 * median(truth.iter().map(|truth| size(truth.irradiance.as_vec3())).collect());
    let error = |(place, truth): (&SurfacePlace, &gdibl_baker::bake::Gathered)| {
        let truth = truth.irradiance.as_vec3();
        let found = Vec3::from(volume.irradiance_f64(place.position.into(), place.normal.into()));
        size(found - truth) / size(truth).max(floor)
    };
    let mut errors: Vec<f64> = places.iter().zip(&truth).map(error).collect();
    errors.sort_by(f64::total_cmp);
    let measured = [0.5, 0.95].map(|share| errors[(share * errors.len() as f64) as usize]);
    for (said, measured) in [said.median, said.p95].into_iter().zip(measured) {
        assert!(measured > 0.02 && (1.0 / 1.3..=1.3).contains(&(said / measured)), "{said} is said, {measured} is");
    }
}

#[test]
fn a_sun_is_blurred_by_the_bands_and_by_nothing_else() {
    // Of a light from one direction E is max(cos, 0), and by bands to L2 1/4 + cos/2 + 5/32 (3 cos² - 1).
    let sky = |direction: Vec3| {
        let sun = direction.dot(Vec3::new(0.36, 0.48, 0.8)) > 0.995;
        if sun { [300.0; 3] } else { [0.3; 3] }
    };
    let mut settings = settings([2, 2, 2], 4096);
    settings.quality.seen_places = Some(512);
    let made = bake(&Scene::default(), sky, &settings);
    let air = seen(&made).and_then(|seen| seen.air).expect("it is lit");
    assert!(air.parts.between < 0.01 && air.parts.packing < 0.01 && air.parts.noise < 0.01, "{:?}", air.parts);
    // The panorama's own sun: E by sums over its pixels.
    let (width, panorama) = (64, panorama(64, sky));
    let pixels: Vec<(Vec3, f64)> = (0..width * width / 2)
        .map(|i| {
            let (x, y) = (i % width, i / width);
            let rows = (width / 2) as f64;
            let edge = |row: usize| (std::f64::consts::PI * row as f64 / rows).cos();
            let area = (edge(y) - edge(y + 1)) * 2.0 * std::f64::consts::PI / width as f64;
            (panorama.pixel_direction(x, y), area * f64::from(panorama.pixel(x, y).x))
        })
        .collect();
    let irradiance = |normal: Vec3| {
        pixels.iter().fold([0.0, 0.0], |[exact, bands], (direction, flux)| {
            let cosine = f64::from(direction.dot(normal));
            [
                exact + flux * cosine.max(0.0),
                bands + flux * (0.25 + cosine / 2.0 + 5.0 / 32.0 * (3.0 * cosine * cosine - 1.0)),
            ]
        })
    };
    let lights: Vec<[f64; 2]> = fibonacci_sphere(512).into_iter().map(irradiance).collect();
    let floor = 0.1 * median(lights.iter().map(|[exact, _]| *exact).collect());
    let squares = lights.iter().map(|[exact, bands]| ((bands - exact) / exact.max(floor)).powi(2));
    let expected = (squares.sum::<f64>() / 512.0).sqrt();
    assert!(expected > 0.1 && (0.8..1.25).contains(&(air.parts.bands / expected)), "{} of {expected}", air.parts.bands);
    let findings = &made.records.statistics.as_ref().expect("a job fills it in").findings;
    assert!(findings.iter().any(|finding| finding.id == "sun-blurred"), "{findings:?}");
}

#[test]
fn numbers_of_the_file_count() {
    let parts = |precision| {
        let mut settings = settings([3, 3, 3], 256);
        settings.quality.seen_places = Some(64);
        settings.quality.precision = precision;
        seen(&bake(&Scene::default(), bright_on_one_side, &settings)).and_then(|seen| seen.air).expect("lit").parts
    };
    let [exact, packed] = [Precision::F32, Precision::Packed { error: Some(0.05) }].map(parts);
    assert_eq!(exact.packing, 0.0);
    assert!((0.005..0.2).contains(&packed.packing), "{packed:?}");
    assert_eq!(exact.between, packed.between, "the light that was baked is the same");
}

#[test]
fn nothing_is_measured_where_nothing_is_read_between_nodes_or_nobody_asks() {
    let mut none = settings([3, 3, 3], 64);
    none.quality.seen_places = Some(0);
    assert_eq!(seen(&bake(&wall(), bright_on_one_side, &none)), None);
    let mut vertices = settings([3, 3, 3], 64);
    vertices.grid = Default::default();
    vertices.grid.nodes = NodeKind::Vertices;
    assert_eq!(seen(&bake(&wall(), bright_on_one_side, &vertices)), None);
}
