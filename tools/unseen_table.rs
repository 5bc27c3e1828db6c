//! Error and claims of GDIBL by given probes in levels where some surfaces are unseen or seen coarsely, against path tracing.
//!
//! `unseen_table LEVEL.glb PROBES_FOLDER DISTANT|- TRUTH_FILE [MODES [NODES [SAMPLES [SEEDS]]]]`. Modes: path, auto, trace, fill, grey (the
//! same with all materials hidden from the bake: grey). The truth is path tracing with 16 times the directions; it is kept in the file.

use std::path::Path;

use cpu_time::ProcessTime;
use gdibl_baker::bake::{BakeSettings, Baked, Nodes, Standing, WHOLE_INTERVAL_95};
use gdibl_baker::import::gltf::{GltfOptions, TextureNeeds, read_level};
use gdibl_baker::import::image::{ReadOptions, read_image};
use gdibl_baker::panorama::{Mapping, to_lat_long};
use gdibl_baker::radiance::Distant;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings, Probe};
use gdibl_baker::radiance::path::{Path as Paths, PathSettings};
use gdibl_baker::radiance::unseen::Unseen;
use gdibl_baker::sampling::{Sampler, Stream, fibonacci_sphere};
use gdibl_baker::scene::{Material, Scene};
use gdibl_runtime::sh;
use gdibl_tools::{bake_all, read_distant};
use glam::{DVec3, Quat, Vec4};

/// Truth has so many times the directions.
const LONGER: u64 = 16;
fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [level, folder, distant, kept, rest @ ..] = &arguments[..] else {
        eprintln!(
            "usage: unseen_table LEVEL PROBES_FOLDER DISTANT|- TRUTH_FILE [MODES [NODES [SAMPLES [SEEDS [FACTOR]]]]]"
        );
        std::process::exit(2);
    };
    let modes = rest.first().map_or("path,trace,fill", String::as_str);
    let number = |place: usize, usual: u64| rest.get(place).map_or(usual, |s| s.parse().expect("a number"));
    let (count, samples, seeds) = (number(1, 128), number(2, 4096), number(3, 3));
    let factor: f32 = rest.get(4).map_or(1.0, |s| s.parse().expect("a number"));
    let options = GltfOptions { textures: TextureNeeds::All, ..GltfOptions::default() };
    let scene = read_level(Path::new(level), &options).unwrap_or_else(|e| panic!("{e}"));
    let distant = (distant != "-").then(|| read_distant(Path::new(distant)));
    let probes = read_probes(Path::new(folder));
    let truth = truth(&scene, distant.as_ref(), Path::new(kept), count as usize, samples * LONGER);
    let nodes = Nodes::Points(truth.positions.clone());
    let (min, max) = scene.bounds(|_| true).expect("triangles");
    let size = (max - min).max_element();
    let spacing = factor * nodes.coarsest_pixel(size);
    println!("{level}: {} probes, {count} nodes, {samples} directions, coarsest pixel {spacing:.3} m", probes.len());
    println!(
        "| mode | CPU s | RMSE | bias | node median | p95 | worst | noise claim median, p95 | whole claim | within 2, 2.23 | where unseen > 1 % | rays |"
    );
    for mode in modes.split(',') {
        let mut table = Table::default();
        for seed in 1..=seeds {
            let settings = BakeSettings { samples, seed, ..BakeSettings::default() };
            let start = ProcessTime::now();
            let baked = if mode == "path" {
                bake_all(&Paths::new(&scene, distant.as_ref(), PathSettings::default()), &nodes, &settings)
            } else {
                let grey = (mode == "grey").then(|| grey(&scene));
                let scene = grey.as_ref().unwrap_or(&scene);
                let directions = settings.directions(count);
                let coarsest = spacing;
                let own = GdiblSettings {
                    seed,
                    directions,
                    coarsest,
                    walks: GdiblSettings::walks_beside(samples),
                    ..Default::default()
                };
                let mut function = Gdibl::new(scene, &probes, distant.as_ref(), own);
                let unseen = match mode {
                    "trace" => Unseen::Trace,
                    "fill" => Unseen::Fill,
                    _ => Unseen::Auto,
                };
                let choice = function.choose_unseen(unseen, &nodes.some_positions(256));
                if seed == 1 {
                    eprintln!("{mode}: {choice:?}; {:.2} s", start.elapsed().as_secs_f64());
                }
                bake_all(&function, &nodes, &settings)
            };
            table.cpu.push(start.elapsed().as_secs_f64());
            table.add(&truth, &baked);
        }
        table.print(mode);
    }
}

/// All materials hidden: grey, and what glows stays.
fn grey(scene: &Scene) -> Scene {
    let hide = |m: &Material| Material {
        base_color: Vec4::new(0.5, 0.5, 0.5, m.base_color.w),
        base_color_texture: None,
        metallic: 0.0,
        ..m.clone()
    };
    let mut hidden = Scene { materials: scene.materials.iter().map(hide).collect(), ..scene.clone() };
    hidden.meshes.iter_mut().for_each(|mesh| mesh.colors.clear());
    hidden
}

struct TruthOf {
    positions: Vec<DVec3>,
    sh: Vec<f32>,
    /// Standard error over the RMS of E.
    error: Vec<f32>,
}

fn truth(scene: &Scene, distant: Option<&Distant>, kept: &Path, count: usize, samples: u64) -> TruthOf {
    let stride = 3 * sh::coefficient_count(2);
    if let Ok(text) = std::fs::read_to_string(kept) {
        let numbers: Vec<f64> = serde_json::from_str(&text).expect("numbers");
        let mut truth = TruthOf { positions: Vec::new(), sh: Vec::new(), error: Vec::new() };
        for row in numbers.chunks_exact(4 + stride).take(count) {
            truth.positions.push(DVec3::new(row[0], row[1], row[2]));
            truth.error.push(row[3] as f32);
            truth.sh.extend(row[4..].iter().map(|v| *v as f32));
        }
        return truth;
    }
    let (min, max) = scene.bounds(|_| true).expect("triangles");
    let stream = Stream::new(Sampler::Sobol, 77, 0, 0);
    let place = |i: u32| {
        let ([x, y], [z, _]) = (stream.point(i, 0), stream.point(i, 1));
        min + (max - min) * DVec3::new(x.into(), y.into(), z.into())
    };
    let all: Vec<DVec3> = (0..16 * count as u32).map(place).collect();
    let function = Paths::new(scene, distant, PathSettings::default());
    let pilot = BakeSettings { samples: 64, ..BakeSettings::default() };
    let pilot = bake_all(&function, &Nodes::Points(all.clone()), &pilot);
    let norm = |node: usize| pilot.node(node).iter().map(|v| v * v).sum::<f32>();
    let mut norms: Vec<f32> = pilot.valid_nodes().map(norm).collect();
    norms.sort_by(f32::total_cmp);
    let floor = 1e-4 * norms[norms.len() / 2];
    let open = |node: &usize| pilot.standing[*node] == Standing::Open && norm(*node) > floor;
    let positions: Vec<DVec3> = (0..all.len()).filter(open).map(|node| all[node]).take(count).collect();
    let settings = BakeSettings { samples, seed: 999, ..BakeSettings::default() };
    let baked = bake_all(&function, &Nodes::Points(positions.clone()), &settings);
    let mut numbers = Vec::new();
    for (node, p) in positions.iter().enumerate() {
        numbers.extend(p.to_array());
        numbers.push(f64::from(baked.relative_error[node]));
        numbers.extend(baked.node(node).iter().map(|v| f64::from(*v)));
    }
    std::fs::write(kept, serde_json::to_string(&numbers).expect("numbers")).expect("a file");
    TruthOf { positions, sh: baked.sh, error: baked.relative_error }
}

fn read_probes(folder: &Path) -> Vec<Probe> {
    let mut files: Vec<_> = std::fs::read_dir(folder).expect("a folder").map(|f| f.expect("a file").path()).collect();
    files.retain(|file| file.extension().is_some_and(|e| e == "exr"));
    files.sort();
    let read = |file: &std::path::PathBuf| {
        let imported = read_image(file, &ReadOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        Probe {
            name: file.display().to_string(),
            position: imported.pose.position.expect("a pose"),
            rotation: imported.pose.rotation.map_or(Quat::IDENTITY, |r| r.as_quat()),
            exposure_stops: 0.0,
            panorama: to_lat_long(&imported.image, imported.mapping.unwrap_or(Mapping::LatLong), None),
        }
    };
    files.iter().map(read).collect()
}

#[derive(Default)]
struct Table {
    cpu: Vec<f64>,
    /// Per node and seed: relative error, claims of noise and of the whole.
    nodes: Vec<[f64; 3]>,
    square: f64,
    truth_square: f64,
    truth_noise: f64,
    difference: f64,
    truth_sum: f64,
    values: [u64; 3],
    values_unseen: [u64; 3],
    rays: u64,
}

impl Table {
    fn add(&mut self, truth: &TruthOf, baked: &Baked) {
        let directions = fibonacci_sphere(26);
        let stride = 3 * sh::coefficient_count(2);
        self.rays += baked.rays;
        let mut all = Vec::new();
        for node in 0..truth.positions.len() {
            let own = &truth.sh[node * stride..][..stride];
            let mut pairs = Vec::new();
            for direction in &directions {
                let mut basis = [0.0; sh::MAX_COEFFICIENTS];
                sh::basis(2, direction.to_array(), &mut basis);
                for channel in 0..3 {
                    let e = |values: &[f32]| {
                        (0..stride / 3)
                            .map(|i| f64::from(sh::COSINE[sh::band_of(i)] * basis[i] * values[3 * i + channel]))
                            .sum::<f64>()
                    };
                    pairs.push((e(baked.node(node)), e(own)));
                }
            }
            let mean = |of: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>() / pairs.len() as f64;
            all.push((
                pairs.clone(),
                mean(&|p| (p.0 - p.1).powi(2)),
                mean(&|p| p.1 * p.1),
                mean(&|p| p.0 - p.1),
                mean(&|p| p.1),
            ));
        }
        let mut rms: Vec<f64> = all.iter().map(|a| a.2.sqrt()).collect();
        rms.sort_by(f64::total_cmp);
        let floor = 0.1 * rms[rms.len() / 2];
        for (node, (pairs, square, truth_square, difference, mean)) in all.iter().enumerate() {
            let scale = truth_square.sqrt().max(floor);
            let noise = f64::from(baked.relative_error[node]);
            let whole = noise.hypot(f64::from(baked.systematic_error[node]));
            let of_truth = f64::from(truth.error[node]);
            self.square += square;
            self.truth_square += truth_square;
            self.truth_noise += (of_truth * scale).powi(2);
            self.difference += difference;
            self.truth_sum += mean;
            self.nodes.push([square.sqrt() / scale, noise, whole]);
            for (found, own) in pairs {
                let off = (found - own).abs();
                let claim = whole.hypot(of_truth) * scale;
                let found = [1, u64::from(off <= 2.0 * claim), u64::from(off <= WHOLE_INTERVAL_95 * claim)];
                let is_unseen = baked.coverage[node] < 0.99;
                (0..3).for_each(|i| self.values[i] += found[i]);
                (0..3).for_each(|i| self.values_unseen[i] += if is_unseen { found[i] } else { 0 });
            }
        }
    }

    fn print(mut self, mode: &str) {
        self.cpu.sort_by(f64::total_cmp);
        let mut quantile = |of: usize, share: f64| {
            self.nodes.sort_by(|a, b| a[of].total_cmp(&b[of]));
            100.0 * self.nodes[((self.nodes.len() - 1) as f64 * share) as usize][of]
        };
        let [median, p95, worst] = [0.5, 0.95, 1.0].map(|share| quantile(0, share));
        let claims = [1, 2].map(|of| format!("{:.2}, {:.2}", quantile(of, 0.5), quantile(of, 0.95)));
        let share = |values: [u64; 3]| match values[0] {
            0 => "-".to_string(),
            n => format!("{:.1}, {:.1}", 100.0 * values[1] as f64 / n as f64, 100.0 * values[2] as f64 / n as f64),
        };
        println!(
            "| {mode} | {:.1} | {:.2} | {:.2} | {median:.2} | {p95:.2} | {worst:.1} | {} | {} | {} | {} ({}) | {:.1} M |",
            self.cpu[self.cpu.len() / 2],
            100.0 * ((self.square - self.truth_noise).max(0.0) / self.truth_square).sqrt(),
            100.0 * self.difference / self.truth_sum,
            claims[0],
            claims[1],
            share(self.values),
            share(self.values_unseen),
            self.values_unseen[0] / 78,
            self.rays as f64 * 1e-6 / self.cpu.len() as f64,
        );
    }
}
