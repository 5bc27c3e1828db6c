//! The shaders, run on a GPU, say what the CPU says.
//!
//! A GPU computes in f32 where the CPU takes f64 for positions, so that it answers for a place which is off by at most a few
//! roundings of a coordinate: [`ROUNDING`]. Where light is continuous that changes nothing to speak of. On a wall's plane, at the
//! face of a cell that has walls, and where hardly any weight is valid, light jumps or is steep, and the other side of the
//! jump is as right an answer: such a difference counts as explained if the CPU itself gives that answer within that distance.
//! All other differences have to be below [`TOLERANCE`].

#[path = "../../../runtime/tests/common/mod.rs"]
mod common;
mod gpu;
mod volumes;

use gdibl_runtime::Volume;
use gdibl_runtime::format::Encoding;
use gdibl_shader_tests::{Stage, WORKGROUP, glsl, hlsl, skip, wgsl};
use gpu::{Gpu, Query};
use std::borrow::Cow;
use std::process::Command;
use volumes::{Case, cases, queries};

/// Queries per volume: 1e5, up to a whole number of workgroups.
const COUNT: usize = 100_000_usize.next_multiple_of(WORKGROUP);

/// Of the root mean square of a volume's irradiance.
const TOLERANCE: f64 = 1e-3;

/// Of the box's diagonal: four steps of an f32, for a height above a plane is the sum of three products and a distance.
const ROUNDING: f64 = 4.0 * f32::EPSILON as f64;

/// The most of 1e5 queries that rounding may explain: of those anywhere in the box (half of them), and of all. Measured on
/// the worst of the volumes, 53 960 nodes with up to three planes in every third cell: 0 and 397.
const MOST_EXPLAINED: [usize; 2] = [10, 1000];

/// What the CPU says, bands 0 to 2, at a position relative to min.
fn truth(volume: &Volume, position: [f64; 3], normal: [f32; 3]) -> [f32; 3] {
    let min = volume.header().min;
    let position = std::array::from_fn(|axis| min[axis] + position[axis]);
    volume.sample_f64(position, normal).sh.truncate(2).convolve().evaluate(normal)
}

/// As FORMAT.md says, metres.
fn bias(volume: &Volume) -> f32 {
    let spacing = volume.grid().expect("a grid").spacing().into_iter().filter(|spacing| *spacing > 0.0);
    if volume.walled_cells() > 0 { 1e-4 * spacing.fold(f64::INFINITY, f64::min) as f32 } else { 0.0 }
}

struct Comparison {
    /// Root mean square of the CPU's irradiance.
    mean: f64,
    /// Differences that rounding of the position does not explain, over `mean`, in ascending order.
    differences: Vec<f64>,
    /// Queries whose difference is above [`TOLERANCE`], and explained: of those anywhere in the box, and of all.
    explained: [usize; 2],
}

fn compare(volume: &Volume, queries: &[Query], found: &[[f32; 3]]) -> Comparison {
    assert_eq!((queries.len(), found.len()), (COUNT, COUNT));
    let of = |query: &Query| truth(volume, query.position.map(f64::from), query.normal);
    let truths: Vec<[f32; 3]> = queries.iter().map(of).collect();
    let squares: f64 = truths.as_flattened().iter().map(|&value| f64::from(value) * f64::from(value)).sum();
    let mean = (squares / (3 * COUNT) as f64).sqrt();
    assert!(mean > 0.0);
    let mut explained = [0, 0];
    let of = |((query, found), truth): ((&Query, &[f32; 3]), &[f32; 3])| {
        let difference = beyond([*truth; 2], *found) / mean;
        if difference <= TOLERANCE {
            return difference;
        }
        explained[0] += usize::from(query.anywhere);
        explained[1] += 1;
        let difference = beyond(range_nearby(volume, query), *found) / mean;
        assert!(difference <= TOLERANCE, "{query:?}: {found:?}, not {truth:?}");
        difference
    };
    let mut differences: Vec<f64> = queries.iter().zip(found).zip(&truths).map(of).collect();
    differences.sort_by(f64::total_cmp);
    Comparison { mean, differences, explained }
}

/// The least and the most of each channel at places that rounding cannot tell from this one: at it, at the ends of its
/// range on each axis, and on both sides of the nodes in between, where the next cell begins.
fn range_nearby(volume: &Volume, query: &Query) -> [[f32; 3]; 2] {
    let grid = volume.grid().expect("a grid");
    let extent: [f64; 3] = std::array::from_fn(|axis| grid.max[axis] - grid.min[axis]);
    let reach = ROUNDING * extent.iter().map(|v| v * v).sum::<f64>().sqrt();
    let [xs, ys, zs] = [0, 1, 2].map(|axis| {
        let here = f64::from(query.position[axis]);
        let mut places = vec![here - reach, here, here + reach];
        let spacing = grid.spacing()[axis];
        // In a volume with walls the place that is looked up lies off this one by 1e-4 of the least distance between nodes.
        let bias = f64::from(bias(volume) * query.normal[axis]);
        let node = if spacing > 0.0 { ((here + bias) / spacing).round() * spacing - bias } else { here };
        if (node - here).abs() <= reach {
            places.extend([node - 1e-3 * reach, node + 1e-3 * reach]);
        }
        places
    });
    let mut range = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    for place in 0..xs.len() * ys.len() * zs.len() {
        let (column, z) = (place / zs.len(), zs[place % zs.len()]);
        let there = truth(volume, [xs[column / ys.len()], ys[column % ys.len()], z], query.normal);
        for c in 0..3 {
            range[0][c] = range[0][c].min(there[c]);
            range[1][c] = range[1][c].max(there[c]);
        }
    }
    range
}

/// How far the worst channel is out of a range; infinity if it is no number.
fn beyond(range: [[f32; 3]; 2], found: [f32; 3]) -> f64 {
    let out = |c: usize| f64::from((range[0][c] - found[c]).max(found[c] - range[1][c]).max(0.0));
    if found.iter().any(|value| !value.is_finite()) { f64::INFINITY } else { out(0).max(out(1)).max(out(2)) }
}

/// Runs one language's compute shader over all volumes.
fn run(gpu: &Gpu, language: &str, pipeline: &wgpu::ComputePipeline) {
    for (number, case) in cases().iter().enumerate() {
        let Case { name, file, .. } = case;
        let volume = Volume::parse(&file.to_bytes()).unwrap();
        let queries = queries(case, COUNT, number as u64);
        let buffers = match volume.header().encoding {
            Encoding::Packed => volume.gpu_buffers_packed(volume.header().scale).unwrap(),
            _ => volume.gpu_buffers().unwrap(),
        };
        let found = gpu.irradiance(pipeline, &buffers, &queries);
        let Comparison { mean, differences, explained } = compare(&volume, &queries, &found);
        let words = buffers.coefficients.len() + buffers.marks.len() + 4 * buffers.walls.len();
        let bytes = 4.0 * words as f64 / volume.node_count() as f64;
        println!(
            "{language} on {}, {name}: of {mean:.2} off by at most {:.1e}, 99 % by {:.1e}; {explained:?} of {COUNT} \
             explained by rounding; {bytes:.1} bytes per node",
            gpu.name,
            differences[COUNT - 1],
            differences[COUNT * 99 / 100],
        );
        assert!((0..2).all(|k| explained[k] <= MOST_EXPLAINED[k]), "{name}: {explained:?} of {COUNT}");
    }
}

const NO_GPU: &str = "shaders beside the CPU: no Vulkan adapter here (one in software is Debian's mesa-vulkan-drivers)";

#[test]
fn the_cpus_irradiance_is_what_shaders_are_compared_with() {
    for case in cases().iter().filter(|case| case.file.bands <= 2 && case.file.min == [0.0; 3]) {
        let volume = Volume::parse(&case.file.to_bytes()).unwrap();
        for Query { position, normal, .. } in queries(case, 1000, 9) {
            let (one, other) = (volume.irradiance(position, normal), truth(&volume, position.map(f64::from), normal));
            assert!(beyond([one; 2], other) < 1e-4, "{}: {one:?} {other:?}", case.name);
        }
    }
}

#[test]
fn wgsl_gives_the_cpus_irradiance() {
    let Some(gpu) = Gpu::open() else { return skip(NO_GPU) };
    run(&gpu, "WGSL", &gpu.pipeline(wgpu::ShaderSource::Wgsl(wgsl().into()), "compute"));
}

#[test]
fn glsl_gives_the_cpus_irradiance() {
    let Some(gpu) = Gpu::open() else { return skip(NO_GPU) };
    let options = naga::front::glsl::Options::from(naga::ShaderStage::Compute);
    let module = naga::front::glsl::Frontend::default().parse(&options, &glsl("#version 450", Stage::Compute)).unwrap();
    run(&gpu, "GLSL", &gpu.pipeline(wgpu::ShaderSource::Naga(Cow::Owned(module)), "main"));
}

#[test]
fn hlsl_gives_the_cpus_irradiance() {
    let Some(gpu) = Gpu::open() else { return skip(NO_GPU) };
    let Some(module) = hlsl_module() else { return skip("HLSL beside the CPU: no glslangValidator here") };
    run(&gpu, "HLSL", &gpu.pipeline(wgpu::ShaderSource::Naga(Cow::Owned(module)), "main"));
}

/// By way of SPIR-V; None without a compiler.
fn hlsl_module() -> Option<naga::Module> {
    let folder = tempfile::tempdir().unwrap();
    let (source, binary) = (folder.path().join("shader.hlsl"), folder.path().join("shader.spv"));
    std::fs::write(&source, hlsl(Stage::Compute)).unwrap();
    let mut compiler = Command::new("glslangValidator");
    let output =
        compiler.args(["-D", "-V", "-e", "main", "-S", "comp", "-o"]).args([&binary, &source]).output().ok()?;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
    let options = naga::front::spv::Options::default();
    Some(naga::front::spv::parse_u8_slice(&std::fs::read(binary).unwrap(), &options).unwrap())
}
