//! Do the error bars hold? Bakes the nodes of the box's truth with many seeds, and counts how often the 95 % interval of a
//! coefficient covers what a long bake of the same method converges to.
//!
//! `cargo run --release -p gdibl-tools --bin calibration -- LEVEL.glb LIGHTING_FOLDER [SAMPLES,… [SEEDS [path]]]`; the
//! folder as for `blend_table`. Exit code 1 if a share is not within 92 to 98 %.

use gdibl_baker::analyse::{Calibration, calibrate};
use gdibl_baker::bake::{BakeSettings, Nodes};
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings};
use gdibl_baker::radiance::path::{Path as PathTracer, PathSettings};
use gdibl_tools::{bake_all, read_lighting, read_scene, read_truth};
use glam::DVec3;
use std::path::Path;

/// The long bake takes so many times the directions of the longest short one.
const LONGER: u64 = 64;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [level, folder, rest @ ..] = &arguments[..] else {
        eprintln!("usage: calibration LEVEL.glb LIGHTING_FOLDER [SAMPLES,… [SEEDS [path]]]");
        std::process::exit(2);
    };
    let samples: Vec<u64> = rest
        .first()
        .map_or("256,1024,4096", String::as_str)
        .split(',')
        .map(|s| s.parse().expect("numbers of samples"))
        .collect();
    let seeds: u64 = rest.get(1).map_or(32, |s| s.parse().expect("a number of seeds"));
    let scene = read_scene(Path::new(level));
    let (probes, distant) = read_lighting(Path::new(folder));
    let truth = read_truth(Path::new(folder), &["grid", "scattered"]);
    let nodes = Nodes::Points(truth.iter().flat_map(|set| set.positions.iter().map(|p| DVec3::from(*p))).collect());
    println!(
        "| directions | noise of E | median node | 95th percentile | claimed / found | 95 % intervals cover | values |"
    );
    println!("|---|---|---|---|---|---|---|");
    let holds = if rest.get(2).is_some_and(|method| method == "path") {
        let function = PathTracer::new(&scene, Some(&distant), PathSettings::default());
        table(&function, &nodes, &samples, seeds)
    } else {
        let function = Gdibl::new(&scene, &probes, Some(&distant), GdiblSettings::default());
        table(&function, &nodes, &samples, seeds)
    };
    std::process::exit(i32::from(!holds));
}

fn table(function: &impl RadianceFunction, nodes: &Nodes, samples: &[u64], seeds: u64) -> bool {
    let settings = BakeSettings { coefficient_errors: true, ..BakeSettings::default() };
    let longest = samples.iter().max().expect("a number of samples") * LONGER;
    let converged = bake_all(function, nodes, &BakeSettings { samples: longest, seed: u64::MAX, ..settings.clone() });
    let mut holds = true;
    for &samples in samples {
        let bake = |seed| bake_all(function, nodes, &BakeSettings { samples, seed, ..settings.clone() });
        let bakes: Vec<_> = (0..seeds).map(bake).collect();
        let Calibration { noise, node_noise, claimed_over_found, covered, values } = calibrate(&converged, &bakes);
        holds &= (0.92..=0.98).contains(&covered);
        println!(
            "| {samples} | {:.2} % | {:.2} % | {:.2} % | {claimed_over_found:.3} | {:.1} % | {values} |",
            noise * 100.0,
            node_noise.median * 100.0,
            node_noise.p95 * 100.0,
            covered * 100.0,
        );
    }
    holds
}
