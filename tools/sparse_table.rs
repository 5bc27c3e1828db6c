//! What a sparse grid leaves out, and what that costs: a Markdown row per tolerance.
//!
//! ```text
//! sparse_table LEVEL --spacing M --tolerance F… [--distant SKY] [--bounds x0,y0,z0,x1,y1,z1] [--samples N] [--points N]
//! ```
//! The level is baked by path tracing: dense, at the spacing; sparse, down to that spacing, with each tolerance; and with four times
//! the samples (default 1024) at points (default 10 000) anywhere in the box, in the open: the truth. Error of E: root mean square over
//! normals and channels, over the larger of the truth's own and a tenth of its median. *Added* compares sparse with dense at the
//! points: their noise is in it, and most of it is of the same nodes. Time is CPU time of the whole bake, of both in this run.

use cpu_time::ProcessTime;
use gdibl_baker::Control;
use gdibl_baker::bake::{BakeSettings, Baked, Nodes, bake_sparse, grid_of_cells, grid_of_spacing};
use gdibl_baker::pack::{PackSettings, pack, volume_of};
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::sampling::{Sampler, Stream};
use gdibl_runtime::{RadianceSh, Volume, sh};
use gdibl_tools::{bake_all, read_distant, read_scene};
use glam::DVec3;
use std::sync::atomic::AtomicBool;

const USAGE: &str =
    "sparse_table LEVEL --spacing M --tolerance F... [--distant SKY] [--bounds BOX] [--samples N] [--points N]";

fn main() {
    let mut arguments = std::env::args().skip(1);
    let (mut level, mut distant, mut bounds, mut spacing) = (None, None, None, None);
    let (mut samples, mut wanted, mut tolerances) = (1024, 10_000, Vec::new());
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().unwrap_or_else(|| panic!("{argument} wants a value"));
        match argument.as_str() {
            "--distant" => distant = Some(read_distant(value().as_ref())),
            "--bounds" => bounds = Some(value().split(',').map(|n| n.parse().expect("a number")).collect::<Vec<f64>>()),
            "--spacing" => spacing = Some(value().parse::<f64>().expect("a number")),
            "--tolerance" => tolerances.push(value().parse::<f64>().expect("a number")),
            "--samples" => samples = value().parse().expect("a number"),
            "--points" => wanted = value().parse().expect("a number"),
            _ => level = Some(argument),
        }
    }
    let scene = read_scene(level.expect(USAGE).as_ref());
    let (min, max) = match bounds {
        Some(numbers) => (DVec3::from_slice(&numbers), DVec3::from_slice(&numbers[3..])),
        None => scene.bounds(|_| true).expect("a level with triangles"),
    };
    let grid = grid_of_cells(grid_of_spacing(min, max, spacing.expect(USAGE)));
    let function = Path::new(&scene, distant.as_ref(), PathSettings::default());
    let settings = BakeSettings { samples, ..BakeSettings::default() };

    let points = |index| {
        let stream = Stream::new(Sampler::Sobol, 1, 0, 0);
        let ([x, y], [z, _]) = (stream.point(index, 0), stream.point(index, 1));
        min + DVec3::new(x.into(), y.into(), z.into()) * (max - min)
    };
    let points = Nodes::Points((0..wanted).map(points).collect());
    let truth = bake_all(&function, &points, &BakeSettings { samples: 4 * samples, ..settings.clone() });
    let open: Vec<usize> = truth.valid_nodes().collect();
    let truth_volume = volume_of(&points, &truth);
    let lights: Vec<RadianceSh> = open.iter().map(|point| truth_volume.node_sh(*point)).collect();
    let mut sizes: Vec<f64> = lights.iter().map(strength).collect();
    sizes.sort_by(f64::total_cmp);
    let floor = 0.1 * sizes[sizes.len() / 2];
    let errors = |found: &dyn Fn(usize) -> RadianceSh, expected: &dyn Fn(usize) -> RadianceSh| {
        let mut errors: Vec<f64> = (0..open.len())
            .map(|place| {
                let (mut difference, expected) = (found(place), expected(place));
                difference.add_scaled(&expected, -1.0);
                strength(&difference) / strength(&expected).max(floor)
            })
            .collect();
        errors.sort_by(f64::total_cmp);
        [0.5, 0.95].map(|share| format!("{:.1} %", 100.0 * errors[(share * errors.len() as f64) as usize])).join(", ")
    };
    let at = |volume: &Volume, place: usize| volume.sample_f64(points.position(open[place]).into(), [0.0; 3]).sh;

    let started = ProcessTime::now();
    let nodes = Nodes::Grid(grid);
    let full = bake_all(&function, &nodes, &settings);
    let full_seconds = started.elapsed().as_secs_f64();
    let dense = volume_of(&nodes, &full);
    let dense_error = errors(&|place| at(&dense, place), &|place| lights[place]);
    let bytes =
        |nodes: &Nodes, baked: &Baked| pack(nodes, baked, Default::default(), PackSettings::default()).bytes.len();
    println!(
        "{} of {wanted} points in the open; grid {:?}, {} nodes, {} valid, {full_seconds:.0} s, {:.1} M rays",
        open.len(),
        grid.counts,
        nodes.len(),
        full.valid_nodes().count(),
        full.rays as f64 / 1e6
    );
    println!("| tolerance | nodes | rays | CPU time | bytes | added: median, 95 % | error | of the dense grid |");
    println!("|---|---|---|---|---|---|---|---|");
    for tolerance in tolerances {
        let started = ProcessTime::now();
        let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
        let (sparse_nodes, baked, record) =
            bake_sparse(&grid, tolerance, &function, &settings, &control).expect("nobody interrupts a tool");
        let seconds = started.elapsed().as_secs_f64();
        let sparse = volume_of(&sparse_nodes, &baked);
        let share = |part: f64, whole: f64| format!("{:.1} %", 100.0 * part / whole);
        println!(
            "| {} | {} | {} | {} | {} | {} | {} | {dense_error} |",
            share(tolerance, 1.0),
            share(sparse_nodes.len() as f64, nodes.len() as f64),
            share(baked.rays as f64, full.rays as f64),
            share(seconds, full_seconds),
            share(bytes(&sparse_nodes, &baked) as f64, bytes(&nodes, &full) as f64),
            errors(&|place| at(&sparse, place), &|place| at(&dense, place)),
            errors(&|place| at(&sparse, place), &|place| lights[place]),
        );
        eprintln!("{record:?}");
    }
}

/// Root sum of squares of E's coefficients.
fn strength(light: &RadianceSh) -> f64 {
    let values = light.coefficients.iter().enumerate().flat_map(|(index, rgb)| {
        let cosine = f64::from(sh::COSINE[sh::band_of(index)]);
        rgb.map(|value| (cosine * f64::from(value)).powi(2))
    });
    values.sum::<f64>().sqrt()
}
