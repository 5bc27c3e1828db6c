//! What placing probes is worth: for a level, one Markdown row per number of suggested probes, and one for probes placed by
//! hand: coverage, and error of E, by GDIBL with probes captured there, against path tracing.
//!
//! `cargo run --release -p gdibl-tools --bin placement_table -- LEVEL.glb [--distant SKY] [--bounds x0,y0,z0,x1,y1,z1]
//! [--hand x,y,z]… [--most N] [--gain G]`
//!
//! Points are drawn in the box; those in solids do not count (see `are_free`). `surfaces`: of the surfaces that the free
//! space of the box sees, by solid angle. `coverage`: of all that the points see, the sky counted. Error is relative RMSE of E
//! in 26 directions. Both are at the points, which placement has not seen.

use gdibl_baker::Control;
use gdibl_baker::analyse::{CoverageView, Viewpoint, coverage, radiance_sh};
use gdibl_baker::bake::{BakeSettings, Baked, Nodes};
use gdibl_baker::capture::{CaptureSettings, PlaceSettings, are_free, capture, place_probes};
use gdibl_baker::import::gltf::{GltfOptions, TextureNeeds, read_level};
use gdibl_baker::panorama::{Mapping, to_lat_long};
use gdibl_baker::radiance::Distant;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings, Probe};
use gdibl_baker::radiance::path::{Path as Paths, PathSettings};
use gdibl_baker::sampling::{Sampler, Stream, fibonacci_sphere};
use gdibl_tools::{bake_all, read_distant};
use glam::{DVec3, Quat};
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// Points drawn in the box, and of those that are free so many.
const DRAWN: u32 = 4096;
const POINTS: usize = 128;
/// Directions per point of GDIBL, and of the truth.
const SAMPLES: u64 = 4096;
const TRUTH_SAMPLES: u64 = 32_768;
/// Pixels around, and paths per pixel, of captured probes: a bake's own.
const WIDTH: usize = 128;
const PATHS: u32 = 64;

struct Arguments {
    level: String,
    distant: Option<Distant>,
    bounds: Option<(DVec3, DVec3)>,
    hand: Vec<DVec3>,
    settings: PlaceSettings,
}

fn main() {
    let Arguments { level, distant, bounds, hand, settings } = parse();
    let options = GltfOptions { textures: TextureNeeds::All, ..GltfOptions::default() };
    let scene = read_level(Path::new(&level), &options).unwrap_or_else(|e| panic!("{e}"));
    let environment = PathSettings { scene_geometry: false, ..PathSettings::default() };
    // What escapes a level without a sky meets nothing, which is not the same as unknown.
    let distant = distant.unwrap_or_else(Distant::black);
    let path = Paths::new(&scene, Some(&distant), environment);
    let bounds = bounds.or(scene.bounds(|_| true)).expect("a level with triangles");

    let started = Instant::now();
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    let placement = place_probes(&path, bounds, &[], &settings, &control).expect("nobody interrupts a tool");
    println!(
        "{}: {} probes suggested in {:.1} s, from {} free places, in a box {:.1} to {:.1}",
        level.rsplit('/').next().unwrap_or(&level),
        placement.suggestions.len(),
        started.elapsed().as_secs_f64(),
        placement.places,
        bounds.0,
        bounds.1
    );
    for (number, suggestion) in placement.suggestions.iter().enumerate() {
        eprintln!("{number}: {:.2} gain {:.4}", suggestion.position, suggestion.gain);
    }

    let stream = Stream::new(Sampler::Sobol, 7, 0, 0);
    let place = |sample| {
        let ([x, y], [z, _]) = (stream.point(sample, 0), stream.point(sample, 1));
        bounds.0 + (bounds.1 - bounds.0) * DVec3::new(x.into(), y.into(), z.into())
    };
    let drawn: Vec<DVec3> = (0..DRAWN).map(place).collect();
    let free = drawn.iter().zip(are_free(&path, &drawn)).filter(|(_, free)| *free).map(|(place, _)| *place);
    let points: Vec<DVec3> = free.take(POINTS).collect();
    assert!(!points.is_empty(), "none of {DRAWN} points is free");
    let count = points.len();
    let points = Nodes::Points(points);
    let truth = bake_all(&path, &points, &BakeSettings { samples: TRUTH_SAMPLES, seed: 1, ..BakeSettings::default() });

    println!(
        "| probes | surfaces | coverage | point of least coverage | error of E | by rays alone | the same, median point |"
    );
    println!("|---|---|---|---|---|---|---|");
    let row = |name: String, probes: &[Probe]| {
        let pixels = WIDTH * (WIDTH / 2);
        let viewpoints: Vec<Viewpoint> =
            probes.iter().map(|probe| Viewpoint { position: probe.position, pixels }).collect();
        let seen = coverage(&CoverageView::new(&path, &viewpoints), bounds, None).surfaces_by_solid_angle;
        let settings = GdiblSettings { emission_from_materials: true, ..GdiblSettings::default() };
        let function = Gdibl::new(&scene, probes, Some(&distant), settings);
        let baked = bake_all(&function, &points, &BakeSettings { samples: SAMPLES, ..BakeSettings::default() });
        let covered = baked.coverage.iter().map(|c| f64::from(*c));
        let mut errors: Vec<(f64, f64)> = (0..count).map(|i| squares(&baked, &truth, i)).collect();
        let (off, all) = errors.iter().fold((0.0, 0.0), |(off, all), e| (off + e.0, all + e.1));
        errors.sort_by(|a, b| (a.0 / a.1).total_cmp(&(b.0 / b.1)));
        let median = errors[errors.len() / 2];
        let noise = baked.relative_error.iter().map(|e| f64::from(*e).powi(2)).sum::<f64>() / count as f64;
        println!(
            "| {name} | {:.1} % | {:.1} % | {:.1} % | {:.1} % | {:.1} % | {:.1} % |",
            100.0 * seen.share,
            100.0 * covered.clone().sum::<f64>() / count as f64,
            100.0 * covered.fold(1.0, f64::min),
            100.0 * (off / all).sqrt(),
            100.0 * noise.sqrt(),
            100.0 * (median.0 / median.1).sqrt()
        );
    };
    let probes = capture_at(&path, &placement.positions());
    let few = [1, 2, 3, 4, 6, 8, 12, 16, 24, hand.len()];
    let mut counts: Vec<usize> = few.into_iter().filter(|n| (1..probes.len()).contains(n)).collect();
    counts.push(probes.len());
    counts.sort_unstable();
    counts.dedup();
    for count in counts {
        row(count.to_string(), &probes[..count]);
    }
    if !hand.is_empty() {
        row(format!("{} by hand", hand.len()), &capture_at(&path, &hand));
    }
}

/// Sums over 26 directions and channels: of the squared difference of E, and of the squared truth.
fn squares(baked: &Baked, truth: &Baked, node: usize) -> (f64, f64) {
    let irradiance = |baked: &Baked| {
        let values = baked.node(node);
        radiance_sh(baked.bands, values.chunks_exact(3).map(|rgb| [rgb[0], rgb[1], rgb[2]])).convolve()
    };
    let (found, expected) = (irradiance(baked), irradiance(truth));
    let directions = fibonacci_sphere(26).into_iter().map(|d| d.to_array());
    let pairs = directions.flat_map(|d| found.evaluate(d).into_iter().zip(expected.evaluate(d)));
    pairs.fold((0.0, 0.0), |(off, all), (found, expected)| {
        (off + f64::from(found - expected).powi(2), all + f64::from(expected).powi(2))
    })
}

fn capture_at(path: &Paths, places: &[DVec3]) -> Vec<Probe> {
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    let settings = CaptureSettings { width: WIDTH, samples: PATHS, emission: false, ..CaptureSettings::default() };
    let probe = |(index, &position): (usize, &DVec3)| {
        let captured = capture(path, position, index as u64, &settings, &control).expect("nobody interrupts a tool");
        Probe {
            name: index.to_string(),
            position,
            rotation: Quat::IDENTITY,
            exposure_stops: 0.0,
            panorama: to_lat_long(&captured.image, Mapping::LatLong, None),
        }
    };
    places.iter().enumerate().map(probe).collect()
}

fn parse() -> Arguments {
    let mut words = std::env::args().skip(1);
    let Some(level) = words.next() else {
        eprintln!(
            "usage: placement_table LEVEL.glb [--distant SKY] [--bounds BOX] [--hand x,y,z]… [--most N] [--gain G]"
        );
        std::process::exit(2);
    };
    let mut arguments =
        Arguments { level, distant: None, bounds: None, hand: Vec::new(), settings: PlaceSettings::default() };
    while let Some(flag) = words.next() {
        let value = words.next().unwrap_or_else(|| panic!("{flag} needs a value"));
        let numbers = || -> Vec<f64> { value.split(',').map(|n| n.parse().expect("a number")).collect() };
        match flag.as_str() {
            "--distant" => arguments.distant = Some(read_distant(Path::new(&value))),
            "--bounds" => {
                let numbers = numbers();
                arguments.bounds = Some((DVec3::from_slice(&numbers[..3]), DVec3::from_slice(&numbers[3..])));
            }
            "--hand" => arguments.hand.push(DVec3::from_slice(&numbers())),
            "--most" => arguments.settings.most = value.parse().expect("a number"),
            "--gain" => arguments.settings.gain = value.parse().expect("a share"),
            _ => panic!("no flag is called {flag}"),
        }
    }
    arguments
}
