//! How the cost of a bake grows: with nodes (time and memory), threads, triangles; and what its parts cost.
//!
//! `cargo build --release && cargo run --release -p gdibl-tools --bin scaling_bench -- [GDIBL [LEVEL.glb LIGHTING]]`; six
//! minutes. GDIBL is the program whose bakes are timed (`target/release/gdibl`), LEVEL the shipped box, LIGHTING a folder
//! with its three probes and `distant.exr`. Memory is read from `/proc`: Linux.

use cpu_time::ProcessTime;
use gdibl_baker::bake::{BakeSettings, Nodes};
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings, Probe};
use gdibl_baker::radiance::{Distant, Guide, PathContext, Radiance, RadianceFunction};
use gdibl_baker::scene::{Mesh, Scene};
use gdibl_baker::trace::{Frame, Level};
use gdibl_runtime::sh;
use gdibl_tools::{BOX_PROBES, bake_all, read_lighting, read_scene};
use glam::{DVec3, Vec3};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

/// Directions per node where nodes are counted: enough that each has all of what a node has.
const FEW: u64 = 64;

fn main() {
    let arguments: Vec<PathBuf> = std::env::args().skip(1).map(PathBuf::from).collect();
    let at = |i: usize, or: &str| arguments.get(i).cloned().unwrap_or_else(|| PathBuf::from(or));
    let program = at(0, "target/release/gdibl");
    let (level, lighting) = (at(1, "assets/uffizi-box/empty-box.glb"), at(2, "assets/uffizi-box"));
    let folder = std::env::temp_dir().join(format!("scaling_bench_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("room for files");
    let toml = folder.join("level.bake.toml");
    std::fs::write(&toml, settings(&level, &lighting)).expect("room for files");
    let bake = Bake { program, toml, output: folder.join("out.gdibl") };
    by_nodes(&bake);
    by_threads(&bake);
    std::fs::remove_dir_all(&folder).expect("what was made here");
    let (scene, (probes, distant)) = (read_scene(&level), read_lighting(&lighting));
    by_triangles(&scene, &probes, &distant);
    by_parts(&scene, &probes, &distant);
}

fn settings(level: &Path, lighting: &Path) -> String {
    let absolute = |path: &Path| std::path::absolute(path).expect("a path").display().to_string();
    let mut toml = format!("level = {:?}\n", absolute(level));
    toml += &format!("distant = {:?}\n", absolute(&lighting.join("distant.exr")));
    for (i, [x, y, z]) in BOX_PROBES.map(|p| p.to_array()).into_iter().enumerate() {
        let image = absolute(&lighting.join(format!("probe_{i}.exr")));
        toml += &format!("[[probe]]\nimage = {image:?}\nposition = [{x:?}, {y:?}, {z:?}]\n");
    }
    toml
}

/// The program, and what it bakes.
struct Bake {
    program: PathBuf,
    toml: PathBuf,
    output: PathBuf,
}

/// What a run took.
struct Cost {
    cpu_seconds: f64,
    wall_seconds: f64,
    /// Most memory at any time.
    peak: f64,
    file: Vec<u8>,
}

impl Bake {
    fn run(&self, arguments: &[&str]) -> Cost {
        let mut child = Command::new(&self.program)
            .arg("bake")
            .arg(&self.toml)
            .args(["--json", "--quiet", "-o"])
            .arg(&self.output)
            .args(arguments)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap_or_else(|e| panic!("{}: {e}", self.program.display()));
        let mut peak = 0.0;
        while child.try_wait().expect("a child").is_none() {
            peak = peak_of(child.id()).unwrap_or(peak);
            std::thread::sleep(Duration::from_millis(2));
        }
        let output = child.wait_with_output().expect("a child");
        assert!(output.status.success(), "{arguments:?}: {}", output.status);
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("a report");
        let seconds = |key: &str| report[key].as_f64().expect("seconds");
        Cost {
            cpu_seconds: seconds("cpu_seconds"),
            wall_seconds: seconds("wall_seconds"),
            peak,
            file: std::fs::read(&self.output).expect("a volume"),
        }
    }
}

/// Bytes; `None` once the process has ended.
fn peak_of(process: u32) -> Option<f64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(1024.0 * line.trim().strip_suffix(" kB")?.parse::<f64>().ok()?)
}

fn by_nodes(bake: &Bake) {
    let few = FEW.to_string();
    let cost = |side: u32, how: &[&str]| {
        bake.run(&[&["--counts", &format!("{side},{side},{side}"), "--samples", &few], how].concat())
    };
    let setup = cost(2, &[]);
    println!(
        "| nodes, {FEW} directions each | CPU us per node | over the first | peak less setup and coefficients: f16 | `--zstd` | packed |"
    );
    println!("|---|---|---|---|---|---|");
    let mut first = None;
    for side in [22u32, 46, 100] {
        let nodes = f64::from(side.pow(3));
        let f16 = ["--precision", "f16"];
        let costs = [&f16[..], &["--precision", "f16", "--zstd"], &[]].map(|how| cost(side, how));
        let per_node = 1e6 * (costs[0].cpu_seconds - setup.cpu_seconds) / nodes;
        let coefficients = nodes * 54.0;
        let [f16, zstd, packed] = costs.map(|cost| 1e-6 * (cost.peak - setup.peak - coefficients));
        println!(
            "| {nodes} | {per_node:.1} | {:.2} | {f16:.0} MB | {zstd:.0} MB | {packed:.0} MB |",
            per_node / *first.get_or_insert(per_node)
        );
    }
    println!();
}

fn by_threads(bake: &Bake) {
    println!("| threads | time over one's, three times | same bytes |");
    println!("|---|---|---|");
    let cost = |threads: usize| bake.run(&["--counts", "12,12,24", "--threads", &threads.to_string()]);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    for threads in [2, 4, 8, 16].into_iter().filter(|&threads| threads <= cores) {
        let mut faster = Vec::new();
        let mut same = true;
        for _ in 0..3 {
            let [one, many] = [1, threads].map(cost);
            faster.push(format!("{:.2}", one.wall_seconds / many.wall_seconds));
            same &= one.file == many.file;
        }
        println!("| {threads} | {} | {} |", faster.join(", "), if same { "yes" } else { "NO" });
    }
    println!();
}

fn by_triangles(scene: &Scene, probes: &[Probe], distant: &Distant) {
    println!("| triangles | CPU ns per direction | over the first |");
    println!("|---|---|---|");
    let mut first = None;
    for cuts in [1, 4, 10] {
        let scene = Scene { meshes: scene.meshes.iter().map(|mesh| cut(mesh, cuts)).collect(), ..scene.clone() };
        let function = Gdibl::new(&scene, probes, Some(distant), GdiblSettings::default());
        let nanoseconds = cost_of(&function, 2);
        println!(
            "| {} | {nanoseconds:.0} | {:.2} |",
            scene.meshes.iter().map(|mesh| mesh.triangles.len()).sum::<usize>(),
            nanoseconds / *first.get_or_insert(nanoseconds)
        );
    }
    println!();
}

/// Every triangle in `cuts`².
fn cut(mesh: &Mesh, cuts: u32) -> Mesh {
    let mut cut = Mesh { positions: Vec::new(), normals: Vec::new(), triangles: Vec::new(), ..mesh.clone() };
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| mesh.positions[i as usize]);
        let normal = (b - a).cross(c - a).normalize_or(DVec3::Y).as_vec3();
        let first = cut.positions.len() as u32;
        // Rows from the corner a to the edge from b to c.
        for row in 0..=cuts {
            for along in 0..=row {
                let (v, w) = (f64::from(row - along) / f64::from(cuts), f64::from(along) / f64::from(cuts));
                cut.positions.push(a + (b - a) * v + (c - a) * w);
                cut.normals.push(normal);
            }
        }
        let number = |row: u32, along: u32| first + row * (row + 1) / 2 + along;
        for row in 0..cuts {
            for along in 0..=row {
                cut.triangles.push([number(row, along), number(row + 1, along), number(row + 1, along + 1)]);
                if along < row {
                    cut.triangles.push([number(row, along), number(row + 1, along + 1), number(row, along + 1)]);
                }
            }
        }
    }
    cut
}

/// Light of 1 from everywhere, for which nothing is traced.
struct Constant<'a>(&'a Gdibl<'a>);

impl RadianceFunction for Constant<'_> {
    fn frame(&self) -> &Frame {
        self.0.frame()
    }

    fn level(&self) -> Level<'_> {
        self.0.level()
    }

    fn guide(&self) -> &Guide {
        self.0.guide()
    }

    fn radiance(&self, _: Vec3, _: Vec3, _: &mut PathContext) -> Radiance {
        Radiance::covered(Vec3::ONE)
    }
}

fn by_parts(scene: &Scene, probes: &[Probe], distant: &Distant) {
    let gdibl =
        |directions| Gdibl::new(scene, probes, Some(distant), GdiblSettings { directions, ..GdiblSettings::default() });
    let anew = gdibl(0);
    let whole = cost_of(&anew, 2);
    println!("| part of a bake | share of the whole |");
    println!("|---|---|");
    let share = |what: &str, cost: f64| println!("| {what} | {:.1} % |", 100.0 * cost / whole);
    let constant = [0, 2, 4].map(|bands| cost_of(&Constant(&anew), bands));
    share("choosing and weighing directions, L0", constant[0]);
    share("projection on SH: L2 instead of L0", constant[1] - constant[0]);
    share("L4 instead of L2", constant[2] - constant[1]);
    share("a ray, and light of surfaces found anew (lines of sight, blend)", whole - constant[1]);
    share("a ray, and light of surfaces remembered", cost_of(&gdibl(DIRECTIONS), 2) - constant[1]);
}

/// Nodes and directions of bakes in this process.
const SIDE: u32 = 8;
const SAMPLES: u64 = 2048;
const DIRECTIONS: u64 = SIDE as u64 * SIDE as u64 * SIDE as u64 * SAMPLES;

/// CPU nanoseconds per direction, the least of three.
fn cost_of(function: &impl RadianceFunction, bands: u32) -> f64 {
    assert!(bands <= sh::MAX_BANDS, "bands {bands}");
    let share = |i: u32| 2.0 * (f64::from(i) + 0.5) / f64::from(SIDE) - 1.0;
    let places = (0..SIDE.pow(3)).map(|i| DVec3::new(share(i % SIDE), share(i / SIDE % SIDE), share(i / SIDE / SIDE)));
    // The box: 2 x 2 x 6 metres, its floor at 0.
    let nodes = Nodes::Points(places.map(|p| DVec3::new(0.9 * p.x, 1.0 + 0.9 * p.y, 2.9 * p.z)).collect());
    let settings = BakeSettings { samples: SAMPLES, bands, ..BakeSettings::default() };
    let run = || {
        let start = ProcessTime::now();
        bake_all(function, &nodes, &settings);
        1e9 * start.elapsed().as_secs_f64() / DIRECTIONS as f64
    };
    (0..3).map(|_| run()).fold(f64::INFINITY, f64::min)
}
