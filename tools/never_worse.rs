//! Is a bake ever worse than path tracing? One line per level: without probes, by 8 to 12 rendered probes at equal CPU time, with
//! the level's materials hidden from the bake, and whether the error bars hold.
//!
//! `cargo run --release -p gdibl-tools --bin never_worse -- INPUTS PROBES [NODES [SAMPLES [SEEDS [LEVEL,…]]]]`: INPUTS is the
//! folder of the levels, PROBES a folder in which the probes of each level are kept (captured where they are missing, 512 x 256
//! pixels). Truth is path tracing with 16 times the directions and a seed of its own; its noise is subtracted.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use cpu_time::ProcessTime;
use gdibl_baker::Control;
use gdibl_baker::bake::Baked;
use gdibl_baker::capture::{CaptureSettings, PlaceSettings, capture, place_probes};
use gdibl_baker::import::gltf::{GltfOptions, TextureNeeds, read_level};
use gdibl_baker::import::image::{Pose, ReadOptions, SampleFormat, read_image, write_exr};
use gdibl_baker::job::{Inputs, Job, Memory, Method, NodeKind, Settings, Watch};
use gdibl_baker::panorama::{Mapping, to_lat_long};
use gdibl_baker::radiance::Distant;
use gdibl_baker::radiance::gdibl::Probe;
use gdibl_baker::radiance::path::{Path as Paths, PathSettings};
use gdibl_baker::sampling::{Sampler, Stream, fibonacci_sphere};
use gdibl_baker::scene::{Material, Mesh, Scene};
use gdibl_runtime::sh;
use gdibl_tools::read_distant;
use glam::{DVec3, Quat, Vec3, Vec4};

/// Name, file below INPUTS, and whether it needs a sky.
const LEVELS: [(&str, &str, bool); 7] = [
    ("living room", "levels/godot/living_room.glb", true),
    ("apartment", "levels/dream-apartment-plain/dream-apartment.glb", true),
    ("pandora", "levels/cube2/sauerbraten_pandora.glb", false),
    ("room.glb", "levels/godot/room.glb", true),
    ("Cornell (Bevy)", "levels/bevy/CornellBox/CornellBox.glb", false),
    ("Cornell (nvpro)", "levels/nvpro-cornell/cornellBox.gltf", false),
    // Made here: a crate that hides floor from all four probes.
    ("crate", "", false),
];
const SKY: &str = "hdr/kloppenheim_05_1k.hdr";
/// Truth has so many times the directions.
const LONGER: u64 = 16;
/// Of each level.
const PROBES: usize = 10;
const PROBE_WIDTH: usize = 512;
const PROBE_SAMPLES: u32 = 64;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [inputs, probes, rest @ ..] = &arguments[..] else {
        eprintln!("usage: never_worse INPUTS PROBES [NODES [SAMPLES [SEEDS [LEVEL,…]]]]");
        std::process::exit(2);
    };
    let number = |place: usize, usual: u64| rest.get(place).map_or(usual, |text| text.parse().expect("a number"));
    let (count, samples, seeds) = (number(0, 256) as usize, number(1, 4096), number(2, 3));
    let chosen = rest.get(3).map_or("", String::as_str);
    println!(
        "| level | CPU s: default, path | RMSE: default, path | {PROBES} probes: CPU s | RMSE: probes, path | median | p95 | claimed \
         median: noise, whole | intervals cover, where unseen | grey: RMSE, p95, claimed p95 |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for (name, file, needs_sky) in LEVELS {
        if !chosen.is_empty() && !chosen.split(',').any(|part| name.starts_with(part)) {
            continue;
        }
        let mut level = Case::read(Path::new(inputs), name, file, needs_sky);
        level.probes = level.probes(&Path::new(probes).join(name.replace(' ', "-")));
        level.places = level.places(count);
        println!("{}", level.row(samples, seeds));
    }
}

/// A level with what lights it.
struct Case {
    name: &'static str,
    scene: Scene,
    distant: Option<Distant>,
    probes: Vec<Probe>,
    places: Vec<DVec3>,
}

impl Case {
    fn read(inputs: &Path, name: &'static str, file: &str, needs_sky: bool) -> Case {
        let options = GltfOptions { textures: TextureNeeds::All, ..GltfOptions::default() };
        let scene = match file {
            "" => crate_room(),
            file => read_level(&inputs.join(file), &options).unwrap_or_else(|error| panic!("{error}")),
        };
        let distant = needs_sky.then(|| read_distant(&inputs.join(SKY)));
        Case { name, scene, distant, probes: Vec::new(), places: Vec::new() }
    }

    fn paths(&self) -> Paths<'_> {
        Paths::new(&self.scene, self.distant.as_ref(), PathSettings::default())
    }

    /// The probes kept in a folder; captured there first if it holds none.
    fn probes(&self, folder: &Path) -> Vec<Probe> {
        std::fs::create_dir_all(folder).expect("a folder for probes");
        let files = || -> Vec<PathBuf> {
            let entries = std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("a file").path());
            let mut files: Vec<PathBuf> = entries.filter(|f| f.extension().is_some_and(|e| e == "exr")).collect();
            files.sort();
            files
        };
        if files().is_empty() {
            self.capture(folder);
        }
        let read = |file: &PathBuf| {
            let imported = read_image(file, &ReadOptions::default()).unwrap_or_else(|error| panic!("{error}"));
            Probe {
                name: file.file_name().unwrap_or_default().to_string_lossy().into_owned(),
                position: imported.pose.position.expect("it was captured with its place"),
                rotation: Quat::IDENTITY,
                exposure_stops: 0.0,
                panorama: to_lat_long(&imported.image, imported.mapping.unwrap_or(Mapping::LatLong), None),
            }
        };
        files().iter().map(read).collect()
    }

    fn capture(&self, folder: &Path) {
        let cancel = AtomicBool::new(false);
        let control = Control { cancel: &cancel, progress: &|_, _| {}, blocks: None };
        let paths = self.paths();
        let bounds = self.scene.bounds(|_| true).expect("a level with triangles");
        let positions = match self.name {
            "crate" => [(0.7, 0.7), (5.3, 0.7), (0.7, 5.3), (5.3, 5.3)].map(|(x, z)| DVec3::new(x, 0.6, z)).to_vec(),
            _ => {
                let settings = PlaceSettings { most: PROBES, ..PlaceSettings::default() };
                place_probes(&paths, bounds, &[], &settings, &control).expect("nobody interrupts").positions()
            }
        };
        let settings =
            CaptureSettings { width: PROBE_WIDTH, samples: PROBE_SAMPLES, seed: 5, ..CaptureSettings::default() };
        for (index, position) in positions.into_iter().enumerate() {
            let captured = capture(&paths, position, index as u64, &settings, &control).expect("nobody interrupts");
            let pose = Pose { position: Some(position), rotation: None };
            let file = folder.join(format!("probe_{index:02}.exr"));
            write_exr(&file, &captured.image, &pose, Mapping::LatLong, SampleFormat::F32).expect("a file");
        }
    }

    /// Seeded places in the open that light reaches.
    fn places(&self, count: usize) -> Vec<DVec3> {
        let (min, max) = self.scene.bounds(|_| true).expect("a level with triangles");
        let stream = Stream::new(Sampler::Sobol, 77, 0, 0);
        let place = |i: u32| {
            let ([x, y], [z, _]) = (stream.point(i, 0), stream.point(i, 1));
            min + (max - min) * DVec3::new(x.into(), y.into(), z.into())
        };
        let all: Vec<DVec3> = (0..16 * count as u32).map(place).collect();
        let (pilot, _) = self.bake(&self.scene, &[], &all, Method::Path, 64, 0);
        let open = |node: &usize| pilot.is_valid(*node) && pilot.node(*node)[..3].iter().sum::<f32>() > 0.0;
        (0..all.len()).filter(open).map(|node| all[node]).take(count).collect()
    }

    /// A bake as `gdibl bake` does it, and its CPU seconds.
    fn bake(
        &self,
        scene: &Scene,
        probes: &[Probe],
        places: &[DVec3],
        method: Method,
        samples: u64,
        seed: u64,
    ) -> (Baked, f64) {
        let mut settings = Settings::default();
        settings.grid.nodes = NodeKind::Points("places".into());
        (settings.quality.method, settings.quality.samples, settings.quality.seed) = (method, Some(samples), seed);
        let inputs = Inputs {
            probes: probes.to_vec(),
            distant: self.distant.clone(),
            places: places.to_vec(),
            ..Inputs::new(scene.clone())
        };
        let start = ProcessTime::now();
        let job = Job::prepare(inputs, settings, Memory::UNBOUNDED).unwrap_or_else(|stop| panic!("{stop}"));
        let made = job.run(&Watch::silent(&AtomicBool::new(false))).unwrap_or_else(|stop| panic!("{stop}"));
        (made.baked, start.elapsed().as_secs_f64())
    }

    fn row(&self, samples: u64, seeds: u64) -> String {
        let bake = |scene: &Scene, probes: &[Probe], method, samples, seed| {
            self.bake(scene, probes, &self.places, method, samples, seed)
        };
        let (truth, _) = bake(&self.scene, &[], Method::Path, LONGER * samples, 999);
        let grey = grey(&self.scene);
        let [mut default, mut path, mut by_probes, mut equal, mut hidden] = [(); 5].map(|()| Errors::default());
        for seed in 1..=seeds {
            // In turns: a machine that others use is now faster, now slower.
            default.add(&truth, bake(&self.scene, &[], Method::Auto, samples, seed));
            path.add(&truth, bake(&self.scene, &[], Method::Path, samples, seed));
            by_probes.add(&truth, bake(&self.scene, &self.probes, Method::Auto, samples, seed));
            let times = by_probes.cpu.last().expect("one") / path.cpu.last().expect("one");
            let as_many = (samples as f64 * times).round().max(64.0) as u64;
            equal.add(&truth, bake(&self.scene, &[], Method::Path, as_many, seed + 100));
            hidden.add(&truth, bake(&grey, &self.probes, Method::Auto, samples, seed));
        }
        let percent = |share: f64| format!("{:.2} %", 100.0 * share);
        let cover = |of: [u64; 2]| match of {
            [0, _] => "-".to_string(),
            [all, within] => format!("{:.1} %", 100.0 * within as f64 / all as f64),
        };
        format!(
            "| {} | {:.1}, {:.1} | {}, {} | {:.1} | {}, {} | {}, {} | {}, {} | {}, {} | {}, {} | {}, {}, {} |",
            self.name,
            median(&default.cpu),
            median(&path.cpu),
            percent(default.rmse()),
            percent(path.rmse()),
            median(&by_probes.cpu),
            percent(by_probes.rmse()),
            percent(equal.rmse()),
            percent(by_probes.quantile(0, 0.5)),
            percent(equal.quantile(0, 0.5)),
            percent(by_probes.quantile(0, 0.95)),
            percent(equal.quantile(0, 0.95)),
            percent(by_probes.quantile(1, 0.5)),
            percent(by_probes.quantile(2, 0.5)),
            cover(by_probes.covered),
            cover(by_probes.covered_where_unseen),
            percent(hidden.rmse()),
            percent(hidden.quantile(0, 0.95)),
            percent(hidden.quantile(2, 0.95)),
        )
    }
}

/// Errors of E of some bakes.
#[derive(Default)]
struct Errors {
    cpu: Vec<f64>,
    /// Per node and bake: error, claimed noise, claimed whole; relative.
    nodes: Vec<[f64; 3]>,
    square: f64,
    truth_square: f64,
    truth_noise: f64,
    /// Values of E, and those within the interval.
    covered: [u64; 2],
    covered_where_unseen: [u64; 2],
}

impl Errors {
    fn add(&mut self, truth: &Baked, (baked, cpu): (Baked, f64)) {
        self.cpu.push(cpu);
        let pairs: Vec<Vec<[f64; 2]>> =
            (0..truth.len()).map(|node| pairs_of(&baked.node(node), &truth.node(node))).collect();
        let mean_square = |pairs: &[[f64; 2]], of: fn(&[f64; 2]) -> f64| {
            pairs.iter().map(|pair| of(pair).powi(2)).sum::<f64>() / pairs.len() as f64
        };
        let mut sizes: Vec<f64> = pairs.iter().map(|pairs| mean_square(pairs, |[_, e]| *e).sqrt()).collect();
        sizes.sort_by(f64::total_cmp);
        let floor = 0.1 * sizes[sizes.len() / 2];
        for (node, pairs) in pairs.iter().enumerate().filter(|(node, _)| truth.is_valid(*node)) {
            let (square, truth_square) = (mean_square(pairs, |[f, e]| f - e), mean_square(pairs, |[_, e]| *e));
            let scale = truth_square.sqrt().max(floor);
            let noise = f64::from(baked.relative_error[node]);
            let whole = noise.hypot(f64::from(baked.systematic_error[node]));
            let of_truth = f64::from(truth.relative_error[node]);
            self.square += square;
            self.truth_square += truth_square;
            self.truth_noise += (of_truth * scale).powi(2);
            self.nodes.push([square.sqrt() / scale, noise, whole]);
            let claim = gdibl_baker::bake::WHOLE_INTERVAL_95 * whole.hypot(of_truth) * scale;
            let within = pairs.iter().filter(|[found, truth]| (found - truth).abs() <= claim).count() as u64;
            let of = [pairs.len() as u64, within];
            (0..2).for_each(|i| self.covered[i] += of[i]);
            if baked.coverage[node] < 0.99 {
                (0..2).for_each(|i| self.covered_where_unseen[i] += of[i]);
            }
        }
    }

    /// Relative, without the noise of the truth.
    fn rmse(&self) -> f64 {
        ((self.square - self.truth_noise).max(0.0) / self.truth_square).sqrt()
    }

    fn quantile(&self, of: usize, share: f64) -> f64 {
        let mut values: Vec<f64> = self.nodes.iter().map(|node| node[of]).collect();
        values.sort_by(f64::total_cmp);
        values[((values.len() - 1) as f64 * share) as usize]
    }
}

/// E in 26 directions and three channels, of two nodes.
fn pairs_of(found: &[f32], truth: &[f32]) -> Vec<[f64; 2]> {
    let bands = 2;
    let mut pairs = Vec::new();
    for direction in fibonacci_sphere(26) {
        let mut basis = [0.0; sh::MAX_COEFFICIENTS];
        sh::basis(bands, direction.to_array(), &mut basis);
        for channel in 0..3 {
            pairs.push([found, truth].map(|values| {
                let terms = (0..sh::coefficient_count(bands))
                    .map(|i| f64::from(sh::COSINE[sh::band_of(i)] * basis[i] * values[3 * i + channel]));
                terms.sum::<f64>()
            }));
        }
    }
    pairs
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

/// The level with its materials hidden: all grey. What glows still does.
fn grey(scene: &Scene) -> Scene {
    let hide = |material: &Material| Material {
        base_color: Vec4::new(0.5, 0.5, 0.5, material.base_color.w),
        base_color_texture: None,
        metallic: 0.0,
        ..material.clone()
    };
    let mut hidden = Scene { materials: scene.materials.iter().map(hide).collect(), ..scene.clone() };
    hidden.meshes.iter_mut().for_each(|mesh| mesh.colors.clear());
    hidden
}

/// A room of 6 x 3 x 6 m with a lamp in its ceiling and a crate that hides floor from four probes in the corners.
fn crate_room() -> Scene {
    let faces = [[0, 2, 6, 4], [1, 5, 7, 3], [0, 4, 5, 1], [2, 3, 7, 6], [0, 1, 3, 2], [4, 6, 7, 5]];
    let cuboid = |min: [f64; 3], max: [f64; 3], outward: bool, material: u32| {
        let corner =
            |i: usize| DVec3::from_array([0, 1, 2].map(|axis| if i >> axis & 1 == 0 { min[axis] } else { max[axis] }));
        let mut mesh = Mesh { material, ..Mesh::default() };
        for [a, b, c, d] in faces {
            let first = mesh.positions.len() as u32;
            let corners = if outward { [a, d, c, b] } else { [a, b, c, d] }.map(corner);
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize().as_vec3();
            mesh.positions.extend(corners);
            mesh.normals.extend([normal; 4]);
            mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
        mesh
    };
    let dull = |color: [f32; 3], emission: f32| Material {
        base_color: Vec3::from(color).extend(1.0),
        metallic: 0.0,
        emission: Vec3::splat(emission),
        ..Material::default()
    };
    Scene {
        meshes: vec![
            cuboid([0.0; 3], [6.0, 3.0, 6.0], false, 0),
            // Its sides lean on nothing: it hides a ring of floor, and the floor behind it from each probe.
            cuboid([2.0, 0.25, 2.0], [4.0, 1.4, 4.0], true, 1),
            cuboid([2.5, 2.9, 2.5], [3.5, 2.95, 3.5], true, 2),
        ],
        materials: vec![dull([0.7, 0.6, 0.5], 0.0), dull([0.3, 0.5, 0.2], 0.0), dull([0.0; 3], 10.0)],
        ..Scene::default()
    }
}
