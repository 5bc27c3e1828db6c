//! What a bake costs by the number of probes, and what remembering the light of surfaces saves and changes.
//!
//! `cargo run --release -p gdibl-tools --bin bake_bench -- LEVEL.glb [NODES [SAMPLES [SKY.hdr]]]`: captures up to 64 small
//! probes of the level (lit by its own lamps and SKY), and bakes NODES nodes (1000) on a lattice with SAMPLES directions each
//! (as many as `gdibl bake` takes).

use cpu_time::ProcessTime;
use gdibl_baker::Control;
use gdibl_baker::bake::{BakeSettings, Baked, Nodes};
use gdibl_baker::capture::{CaptureSettings, PlaceSettings, capture, place_probes};
use gdibl_baker::panorama::{Mapping, to_lat_long};
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings, Probe};
use gdibl_baker::radiance::path::{Path as PathTracer, PathSettings};
use gdibl_runtime::sh;
use gdibl_tools::{bake_all, read_distant, read_scene};
use glam::{DVec3, Quat};
use half::f16;
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Of each captured probe, pixels.
const WIDTH: usize = 128;
const PROBES: usize = 64;
const TURNS: usize = 3;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let Some(level) = arguments.first() else {
        eprintln!("usage: bake_bench LEVEL.glb [NODES [SAMPLES [SKY.hdr]]]");
        std::process::exit(2);
    };
    let number = |i: usize, or| arguments.get(i).map_or(or, |s| s.parse().expect("a number"));
    let (nodes, samples) = (number(1, 1000), number(2, BakeSettings::default().samples));
    let scene = read_scene(Path::new(level));
    let distant = arguments.get(3).map(|path| read_distant(Path::new(path)));
    let (min, max) = scene.bounds(|_| true).expect("a level with triangles");
    let path = PathTracer::new(&scene, distant.as_ref(), PathSettings::default());
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    let most = PlaceSettings { most: PROBES, gain: 0.0 };
    let places = place_probes(&path, (min, max), &[], &most, &control).expect("nobody interrupts").positions();
    let settings = CaptureSettings { width: WIDTH, samples: 128, emission: false, ..CaptureSettings::default() };
    let probe = |(i, &position): (usize, &DVec3)| {
        let mut image = capture(&path, position, i as u64, &settings, &control).expect("nobody interrupts").image;
        // As the file has them that `gdibl capture` writes.
        let halve = |value: &mut f32| *value = f16::from_f32(*value).to_f32();
        image.pixels.iter_mut().flatten().for_each(halve);
        image.distance.iter_mut().flatten().for_each(halve);
        Probe {
            name: i.to_string(),
            position,
            rotation: Quat::IDENTITY,
            exposure_stops: 0.0,
            panorama: to_lat_long(&image, Mapping::LatLong, None),
        }
    };
    let probes: Vec<Probe> = places.iter().enumerate().map(probe).collect();
    println!(
        "{} triangles, {} probes of {WIDTH} x {}",
        scene.meshes.iter().map(|m| m.triangles.len()).sum::<usize>(),
        probes.len(),
        WIDTH / 2
    );

    let side = (nodes as f64).cbrt().round() as u32;
    let share = |i: u32| (f64::from(i) + 0.5) / f64::from(side);
    let places = (0..side.pow(3)).map(|i| DVec3::new(share(i % side), share(i / side % side), share(i / side / side)));
    let nodes = Nodes::Points(places.map(|share| min + (max - min) * share).collect());
    let run = |probes: &[Probe], directions: u64, importance: bool| {
        let start = ProcessTime::now();
        let settings = GdiblSettings { emission_from_materials: true, directions, ..GdiblSettings::default() };
        let function = Gdibl::new(&scene, probes, distant.as_ref(), settings);
        let baked = bake_all(&function, &nodes, &BakeSettings { samples, importance, ..BakeSettings::default() });
        (baked, start.elapsed().as_secs_f64())
    };
    let directions = nodes.len() as u64 * samples;
    let cases: Vec<(usize, &str, u64)> = [3, probes.len()]
        .into_iter()
        .flat_map(|count| [(count, "found anew", 0), (count, "remembered", directions)])
        .collect();
    // In turns, for a machine that others use is now faster, now slower. The least is what the work itself takes.
    let mut seconds = vec![f64::INFINITY; cases.len()];
    let mut bakes = Vec::new();
    for _ in 0..TURNS {
        bakes.clear();
        for ((count, _, directions), least) in cases.iter().zip(&mut seconds) {
            let (baked, seconds) = run(&probes[..*count], *directions, true);
            *least = least.min(seconds);
            bakes.push(baked);
        }
    }
    println!(
        "| probes | light of surfaces | CPU s, the least of {TURNS} | of that found anew | of 3 probes | rays per direction | \
         relative error | differs |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for (case, (count, words, directions)) in cases.iter().enumerate() {
        let baked = &bakes[case];
        let valid = baked.valid_nodes().map(|node| baked.relative_error[node]);
        let noise = rms(valid.map(f64::from));
        // With the same uniform directions: importance learns from what it sees, and then looks elsewhere.
        let difference = match directions {
            0 => "-".to_owned(),
            n => {
                let [anew, remembered] = [0, *n].map(|directions| run(&probes[..*count], directions, false).0);
                format!("{:.3} %", 100.0 * rms(differences(&anew, &remembered).into_iter()))
            }
        };
        println!(
            "| {count} | {words} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} % | {difference} |",
            seconds[case],
            seconds[case] / seconds[case / 2 * 2],
            seconds[case] / seconds[case % 2],
            baked.rays as f64 / baked.samples as f64,
            100.0 * noise
        );
    }
}

/// Of each valid node: RMS of the difference of coefficients, as they count in E, over the RMS of the first.
fn differences(a: &Baked, b: &Baked) -> Vec<f64> {
    let cosine = |i: usize| f64::from(sh::COSINE[sh::band_of(i / 3)]);
    let values = 0..3 * sh::coefficient_count(a.bands);
    let norm = |of: &dyn Fn(usize) -> f64| values.clone().map(|i| (of(i) * cosine(i)).powi(2)).sum::<f64>().sqrt();
    (0..a.len())
        .filter(|&n| a.is_valid(n) && b.is_valid(n))
        .map(|n| {
            let (x, y) = (a.node(n), b.node(n));
            norm(&|i| f64::from(x[i] - y[i])) / norm(&|i| f64::from(x[i])).max(f64::MIN_POSITIVE)
        })
        .collect()
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    values.for_each(|v| (sum, count) = (sum + v * v, count + 1.0));
    (sum / f64::max(count, 1.0)).sqrt()
}
