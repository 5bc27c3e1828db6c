//! Error of every blend rule against path-traced truth, as a Markdown table.
//!
//! `cargo run --release -p gdibl-tools --bin blend_table -- FOLDER [SAMPLES]`; FOLDER holds `level.glb` or is a
//! lighting of the box beside it: probe_0..2.exr, distant.exr, reference.json, and the empty box as LEVEL.

use gdibl_baker::analyse::{CompareSettings, compare};
use gdibl_baker::bake::{BakeSettings, Nodes};
use gdibl_baker::pack::volume_of;
use gdibl_baker::radiance::blend::BlendRule;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings};
use gdibl_tools::{bake_all, read_lighting, read_scene, read_truth};
use glam::DVec3;
use std::path::Path;

const RULES: [&str; 10] = [
    "distance:2",
    "angular:2",
    "angular:4",
    "angular-smooth:2",
    "angular-smooth:4",
    "nearest",
    "footprint:1",
    "footprint:2",
    "footprint:4",
    "footprint:8",
];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [level, folder, rest @ ..] = &arguments[..] else {
        eprintln!("usage: blend_table LEVEL.glb LIGHTING_FOLDER [SAMPLES [RULE…]]");
        std::process::exit(2);
    };
    let samples: u64 = rest.first().map_or(4096, |s| s.parse().expect("a number of samples"));
    let rules: Vec<&str> = if rest.len() > 1 { rest[1..].iter().map(String::as_str).collect() } else { RULES.into() };
    let scene = read_scene(Path::new(level));
    let (probes, distant) = read_lighting(Path::new(folder));
    let truth = read_truth(Path::new(folder), &["grid", "scattered"]);
    let nodes = Nodes::Points(truth.iter().flat_map(|set| set.positions.iter().map(|p| DVec3::from(*p))).collect());
    let settings = BakeSettings { samples, ..BakeSettings::default() };
    println!("| blend | relative RMSE | median node | 95th percentile | worst node | bias | rays per direction |");
    println!("|---|---|---|---|---|---|---|");
    for rule in rules {
        let blend: BlendRule = rule.parse().expect("a blend rule");
        let function = Gdibl::new(&scene, &probes, Some(&distant), GdiblSettings { blend, ..GdiblSettings::default() });
        let baked = bake_all(&function, &nodes, &settings);
        let comparison = compare(&volume_of(&nodes, &baked), &truth, &CompareSettings::default());
        let comparison = comparison.unwrap_or_else(|nothing| panic!("{nothing}"));
        let error = comparison.all;
        let places = comparison.places;
        assert_eq!(places.compared, places.truth, "every place was baked");
        let percent = |share: f64| format!("{:.2} %", share * 100.0);
        println!(
            "| {rule} | {} | {} | {} | {} | {:+.2} % | {:.2} |",
            percent(error.relative_rmse),
            percent(error.per_node.median),
            percent(error.per_node.p95),
            percent(error.per_node.max),
            error.bias * 100.0,
            baked.rays as f64 / baked.samples as f64
        );
    }
}
