//! Light on surfaces, as an engine would read it from a grid, against path tracing at the same places.
//!
//! ```text
//! surface_table LEVEL [--distant SKY] [--longest N] [--samples N] [--points N]
//! ```
//! The level is baked by path tracing (so that nothing but nodes and what lies between them is to blame) on a grid of N nodes
//! along the longest axis (default 32). Places are spread evenly over the surfaces, on their front sides; those that see
//! backs of triangles in more than a quarter of their hemisphere are in solids or outside, and left out; so are those where next
//! to no light gets, which are hidden where two solids touch. Error: root mean square over RGB of E's difference, over the larger
//! of the truth's and a tenth of its median.

use gdibl_baker::Control;
use gdibl_baker::bake::{BakeSettings, Baked, GatherSettings, Nodes, SurfacePlace, grid_of_spacing, irradiance_at};
use gdibl_baker::import::gltf::{GltfOptions, TextureNeeds, read_level};
use gdibl_baker::pack::volume_of;
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::sampling::{Sampler, Stream, cosine_hemisphere, fibonacci_sphere};
use gdibl_baker::scene::Scene;
use gdibl_runtime::{Grid, RadianceSh, Volume};
use gdibl_tools::{bake_all, read_distant};
use glam::{DVec3, Vec3};
use std::sync::atomic::AtomicBool;

/// Places leave their surface by this share of the level's longest side.
const OFF_THE_SURFACE: f64 = 1e-5;
/// Rays that tell whether a place is in the open.
const LOOKS: u32 = 64;
/// Who sees more backs than this share is in a solid or outside.
const MOST_BACKS: u32 = LOOKS / 4;
/// A node that sees more backs is in a solid.
const MOST_NODE_BACKS: f64 = 0.25;
/// Who gets less than this share of the median is hidden.
const HIDDEN: f64 = 1e-3;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let (mut level, mut distant) = (None, None);
    let (mut longest, mut samples, mut wanted) = (32.0, 4096, 10_000);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().unwrap_or_else(|| panic!("{argument} wants a value"));
        match argument.as_str() {
            "--distant" => distant = Some(read_distant(value().as_ref())),
            "--longest" => longest = value().parse().expect("a number"),
            "--samples" => samples = value().parse().expect("a number"),
            "--points" => wanted = value().parse().expect("a number"),
            _ => level = Some(argument),
        }
    }
    let level = level.expect("surface_table LEVEL [--distant SKY] [--longest N] [--samples N] [--points N]");
    let options = GltfOptions { textures: TextureNeeds::All, ..GltfOptions::default() };
    let scene = read_level(level.as_ref(), &options).unwrap_or_else(|e| panic!("{e}"));
    let function = Path::new(&scene, distant.as_ref(), PathSettings::default());
    let (min, max) = scene.bounds(|_| true).expect("a level with triangles");
    let places = surface_places(&scene, &function, wanted, (max - min).max_element() * OFF_THE_SURFACE);
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    let settings = GatherSettings { samples: 1024, ..GatherSettings::default() };
    let truth = irradiance_at(&places, &function, &settings, &control).expect("nobody interrupts a tool");
    let mut found: Vec<(SurfacePlace, DVec3)> =
        places.into_iter().zip(truth.iter().map(|gathered| gathered.irradiance)).collect();
    let mut sorted: Vec<f64> = found.iter().map(|(_, e)| strength(*e)).collect();
    sorted.sort_by(f64::total_cmp);
    let median = sorted[sorted.len() / 2];
    found.retain(|(_, e)| strength(*e) > HIDDEN * median);
    let hidden = sorted.len() - found.len();
    let (places, truth): (Vec<SurfacePlace>, Vec<DVec3>) = found.into_iter().unzip();

    let grid = grid_of_spacing(min, max, (max - min).max_element() / (longest - 1.0));
    let nodes = Nodes::Grid(grid);
    let started = std::time::Instant::now();
    let baked = bake_all(&function, &nodes, &BakeSettings { samples, ..BakeSettings::default() });
    let seconds = started.elapsed().as_secs_f64();
    let volume = volume_of(&nodes, &baked);
    let [x, y, z] = grid.counts;
    println!(
        "{level}: grid {x} x {y} x {z}, {} of {} valid, {} walled cells, {seconds:.1} s; {} places, {hidden} hidden ones left out\n",
        baked.valid_nodes().count(),
        nodes.len(),
        volume.walled_cells(),
        places.len()
    );
    println!("| reconstruction | median | 90 % | 95 % | 99 % | over 3 x too bright | 3 x too dark |");
    println!("|---|---|---|---|---|---|---|");
    let all = |_: usize| true;
    row("plain trilinear", &places, &truth, |place| weighed(&volume, place, all));
    row("valid nodes", &places, &truth, |place| weighed(&volume, place, |node| volume.is_valid(node)));
    row("valid nodes that are seen (traced)", &places, &truth, |place| {
        let to_trace = |position| function.frame().to_trace(position);
        let sees =
            |node: usize| function.level().is_clear(to_trace(place.position), to_trace(stand(&baked, &grid, node)));
        weighed(&volume, place, |node| volume.is_valid(node) && sees(node))
    });
    row("the runtime", &places, &truth, |place| {
        let normal = place.normal.to_array();
        volume.sample_f64(place.position.to_array(), normal).sh.convolve().evaluate(normal)
    });
    print_jumps(&volume, &function, &baked);
    print_backs(&function, &baked, &grid);
}

/// Where the light of a node was taken.
fn stand(baked: &Baked, grid: &Grid, node: usize) -> DVec3 {
    match baked.moved.binary_search_by_key(&(node as u32), |moved| moved.0) {
        Ok(found) => baked.moved[found].1,
        Err(_) => DVec3::from(grid.node_position(node)),
    }
}

/// Valid nodes that see the backs of triangles all around: nodes in solids.
fn print_backs(function: &Path, baked: &Baked, grid: &Grid) {
    let directions = fibonacci_sphere(1024);
    let level = function.level();
    let (mut single_sided, mut any, mut most) = (0, 0, 0.0f64);
    for node in baked.valid_nodes() {
        let origin = function.frame().to_trace(stand(baked, grid, node));
        let met = directions.iter().filter_map(|direction| level.meet(origin, *direction, f32::INFINITY));
        let backs: Vec<bool> = met.filter(|met| met.back).map(|met| met.single_sided).collect();
        let share = |count: usize| count as f64 / directions.len() as f64;
        let solid = share(backs.iter().filter(|single_sided| **single_sided).count());
        most = most.max(solid);
        single_sided += usize::from(solid > MOST_NODE_BACKS);
        any += usize::from(share(backs.len()) > MOST_NODE_BACKS);
    }
    println!(
        "valid nodes that see backs in more than {MOST_NODE_BACKS} of all directions: {single_sided} of single-sided triangles \
         (at most {most:.3}), {any} of any; {} nodes moved",
        baked.moved.len()
    );
}

/// How far irradiance jumps where one cell ends and the next begins, at places in the open: nothing is there.
fn print_jumps(volume: &Volume, function: &Path, baked: &Baked) {
    let grid = volume.header().grid();
    let spacing = DVec3::from(grid.spacing());
    let to_trace = |position: DVec3| function.frame().to_trace(position);
    let random = Stream::new(Sampler::Sobol, 3, 0, 0);
    let cells: Vec<u32> = (0..grid.node_count() as u32).filter(|node| grid.is_cell(*node)).collect();
    let mut jumps = Vec::new();
    for index in 0..200_000 {
        let [cell, u] = random.point(index, 0);
        let [v, face] = random.point(index, 1);
        let cell = cells[((cell * cells.len() as f32) as usize).min(cells.len() - 1)];
        let axis = ((face * 3.0) as usize).min(2);
        let (low, high) = grid.cell_box(cell);
        let mut share = DVec3::from([f64::from(u), f64::from(v), f64::from(u * 7.0).fract()]);
        share[axis] = 1.0;
        let place = DVec3::from(low) + (DVec3::from(high) - DVec3::from(low)) * share;
        let mut beyond = DVec3::ZERO;
        beyond[axis] = 1e-6 * spacing[axis];
        let corners = grid.cell_nodes(cell).map(|node| node as usize).into_iter().filter(|node| baked.is_valid(*node));
        let is_seen = |node: usize| function.level().is_clear(to_trace(place), to_trace(stand(baked, &grid, node)));
        if !corners.into_iter().any(is_seen) {
            continue;
        }
        let read = |at: DVec3| volume.sample_f64(at.to_array(), [0.0; 3]).sh;
        let (here, there) = (read(place - beyond), read(place + beyond));
        let norm =
            |sh: &RadianceSh| sh.coefficients.as_flattened().iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
        let mut off = here;
        off.coefficients
            .as_flattened_mut()
            .iter_mut()
            .zip(there.coefficients.as_flattened())
            .for_each(|(a, b)| *a -= b);
        jumps.push(norm(&off) / norm(&here).max(norm(&there)).max(f64::MIN_POSITIVE));
    }
    jumps.sort_by(f64::total_cmp);
    let over = |share: f64| 100.0 * jumps.iter().filter(|jump| **jump > share).count() as f64 / jumps.len() as f64;
    println!(
        "\nwhere cells meet in the open: jumps over 1 % at {:.2} % of {} places, over 10 % at {:.2} %, over 50 % at {:.2} %",
        over(0.01),
        jumps.len(),
        over(0.1),
        over(0.5)
    );
}

fn strength(e: DVec3) -> f64 {
    (e.length_squared() / 3.0).sqrt()
}

fn row(name: &str, places: &[SurfacePlace], truth: &[DVec3], read: impl Fn(&SurfacePlace) -> [f32; 3]) {
    let mut sorted: Vec<f64> = truth.iter().map(|e| strength(*e)).collect();
    sorted.sort_by(f64::total_cmp);
    let floor = 0.1 * sorted[sorted.len() / 2];
    let (mut errors, mut bright, mut dark) = (Vec::new(), 0, 0);
    for (place, truth) in places.iter().zip(truth) {
        let read = DVec3::from(read(place).map(|value| f64::from(value).max(0.0)));
        errors.push(strength(read - *truth) / strength(*truth).max(floor));
        bright += usize::from(strength(read).max(floor) > 3.0 * strength(*truth).max(floor));
        dark += usize::from(strength(*truth).max(floor) > 3.0 * strength(read).max(floor));
    }
    errors.sort_by(f64::total_cmp);
    let rank = |share: f64| errors[(share * (errors.len() - 1) as f64) as usize] * 100.0;
    let percent = |count: usize| 100.0 * count as f64 / places.len() as f64;
    println!(
        "| {name} | {:.1} % | {:.1} % | {:.1} % | {:.0} % | {:.2} % | {:.2} % |",
        rank(0.5),
        rank(0.9),
        rank(0.95),
        rank(0.99),
        percent(bright),
        percent(dark)
    );
}

/// Trilinear over those of the eight nodes that count; over all where none does.
fn weighed(volume: &Volume, place: &SurfacePlace, counts: impl Fn(usize) -> bool) -> [f32; 3] {
    let cell = volume.header().grid().locate(place.position.to_array());
    let mut weights = cell.weights;
    for (weight, node) in weights.iter_mut().zip(cell.nodes) {
        *weight *= f32::from(counts(node as usize));
    }
    let sum = weights.iter().sum::<f32>();
    let weights = if sum > 1e-6 { weights.map(|weight| weight / sum) } else { cell.weights };
    let mut light = RadianceSh::zero(volume.header().bands);
    for (node, weight) in cell.nodes.iter().zip(weights) {
        let values = volume.node_sh(*node as usize);
        let values = values.coefficients.as_flattened().iter();
        light.coefficients.as_flattened_mut().iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
    }
    light.convolve().evaluate(place.normal.to_array())
}

/// Evenly over the area of all triangles.
fn surface_places(scene: &Scene, function: &Path, wanted: usize, off: f64) -> Vec<SurfacePlace> {
    let triangles: Vec<[DVec3; 3]> = scene
        .meshes
        .iter()
        .flat_map(|mesh| mesh.triangles.iter().map(|ids| ids.map(|i| mesh.positions[i as usize])))
        .collect();
    let mut up_to = Vec::new();
    let mut area = 0.0;
    for [a, b, c] in &triangles {
        area += 0.5 * (b - a).cross(c - a).length();
        up_to.push(area);
    }
    let random = Stream::new(Sampler::Sobol, 1, 0, 0);
    let mut places = Vec::new();
    for index in 0..20 * wanted as u32 {
        if places.len() == wanted {
            break;
        }
        let [pick, u] = random.point(index, 0);
        let [v, _] = random.point(index, 1);
        let target = f64::from(pick) * area;
        let [a, b, c] = triangles[up_to.partition_point(|sum| *sum <= target).min(triangles.len() - 1)];
        let (root, v) = (f64::from(u).sqrt(), f64::from(v));
        let normal = (b - a).cross(c - a).normalize();
        let position = a * (1.0 - root) + b * (root * (1.0 - v)) + c * (root * v) + normal * off;
        let place = SurfacePlace { position, normal: normal.as_vec3() };
        if is_open(function, &place, index) {
            places.push(place);
        }
    }
    places
}

fn is_open(function: &Path, place: &SurfacePlace, index: u32) -> bool {
    let random = Stream::new(Sampler::Sobol, 2, u64::from(index), 0);
    let origin = function.frame().to_trace(place.position);
    let direction = |look: u32| -> Vec3 { cosine_hemisphere(place.normal, random.point(look, 0)) };
    let is_inside = |look: &u32| function.surface(origin, direction(*look)).is_some_and(|hit| function.is_inside(&hit));
    (0..LOOKS).filter(is_inside).count() as u32 <= MOST_BACKS
}
