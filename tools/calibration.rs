//! scratch: noise over seeds
use gdibl_baker::bake::{BakeSettings, Nodes};
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings};
use gdibl_baker::radiance::path::{Path as PathF, PathSettings};
use gdibl_runtime::{RadianceSh, sh};
use gdibl_tools::{bake_all, read_lighting, read_scene, read_truth};
use glam::DVec3;
use std::path::Path;

fn noise(f: &impl RadianceFunction, nodes: &Nodes, samples: u64, seeds: u64) {
    let started = std::time::Instant::now();
    let all: Vec<_> =
        (0..seeds).map(|seed| bake_all(f, nodes, &BakeSettings { samples, seed, ..BakeSettings::default() })).collect();
    let time = started.elapsed().as_secs_f64();
    let n = all[0].sh.len();
    let count = sh::coefficient_count(2);
    let (mut var, mut sq) = (0.0, 0.0);
    let mut per_node = vec![(0.0, 0.0); nodes.len()];
    for i in 0..n {
        let coefficient = i / 3 % count;
        let a = f64::from(sh::COSINE[sh::band_of(coefficient)]);
        let mean = all.iter().map(|b| f64::from(b.sh[i])).sum::<f64>() / seeds as f64;
        let v = all.iter().map(|b| (f64::from(b.sh[i]) - mean).powi(2)).sum::<f64>() / (seeds - 1) as f64;
        var += a * a * v;
        sq += a * a * mean * mean;
        per_node[i / 3 / count].0 += a * a * v;
        per_node[i / 3 / count].1 += a * a * mean * mean;
    }
    let mut rel: Vec<f64> = per_node.iter().map(|(v, s)| (v / s).sqrt()).collect();
    rel.sort_by(f64::total_cmp);
    let claimed: f64 = all.iter().flat_map(|b| b.relative_error.iter().map(|e| f64::from(*e).powi(2))).sum::<f64>()
        / (seeds as usize * nodes.len()) as f64;
    println!(
        "{samples:6}: noise {:.3} %  node rms {:.3} median {:.3} p95 {:.3} max {:.3}  claimed node rms {:.3}  rays/dir {:.2} time/node {:.3} ms (wall, 2 cores)",
        100.0 * (var / sq).sqrt(),
        100.0 * (rel.iter().map(|r| r * r).sum::<f64>() / rel.len() as f64).sqrt(),
        100.0 * rel[rel.len() / 2],
        100.0 * rel[rel.len() * 95 / 100],
        100.0 * rel[rel.len() - 1],
        100.0 * claimed.sqrt(),
        all[0].rays as f64 / all[0].samples as f64,
        time * 1e3 / (seeds as usize * nodes.len()) as f64
    );
}

fn main() {
    let a: Vec<String> = std::env::args().skip(1).collect();
    let scene = read_scene(Path::new(&a[0]));
    let (probes, distant) = read_lighting(Path::new(&a[1]));
    let truth = read_truth(Path::new(&a[1]), &["grid", "scattered"]);
    let nodes = Nodes::Points(truth.iter().flat_map(|set| set.positions.iter().map(|p| DVec3::from(*p))).collect());
    for s in a[2].split(',') {
        let samples: u64 = s.parse().unwrap();
        if a.len() > 3 {
            let f = PathF::new(&scene, Some(&distant), PathSettings::default());
            noise(&f, &nodes, samples, 8);
        } else {
            let f = Gdibl::new(&scene, &probes, Some(&distant), GdiblSettings::default());
            noise(&f, &nodes, samples, 8);
        }
    }
    let _ = RadianceSh { bands: 0, coefficients: [[0.0; 3]; sh::MAX_COEFFICIENTS] };
}
