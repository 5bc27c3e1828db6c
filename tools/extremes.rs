//! The stiff and extreme cases, as a Markdown table: what must hold, and what was measured.
//!
//! `cargo run --release -p gdibl-tools --bin extremes [-- AREA…]`; ends with 1 where a row does not hold. Levels and
//! panoramas are made here, but for the box of `assets/`. About four minutes on two cores; most rows have a smaller twin among
//! the tests.

use gdibl_baker::Control;
use gdibl_baker::analyse::{IrradianceError, Light, Pair, radiance_sh};
use gdibl_baker::bake::{BakeSettings, Baked, Nodes, memory_needed};
use gdibl_baker::capture::{CaptureSettings, capture};
use gdibl_baker::import::gltf::{GltfOptions, parse_level};
use gdibl_baker::import::image::{Pose, ReadOptions, SampleFormat, read_image, write_exr};
use gdibl_baker::job::records::Records;
use gdibl_baker::pack::{PackSettings, Precision, pack};
use gdibl_baker::panorama::{Image, Mapping, Panorama};
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::radiance::blend::{BlendRule, View};
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings, Probe};
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::sampling::{Sampler, Stream, fibonacci_sphere};
use gdibl_baker::scene::{Material, PunctualKind, PunctualLight, Role, Scene};
use gdibl_runtime::grid::Grid;
use gdibl_runtime::{RadianceSh, Volume, sh};
use gdibl_tools::{bake_all, read_lighting, read_scene, read_truth};
use glam::{DMat3, DQuat, DVec3, Quat, Vec3};
use std::f64::consts::PI;
use std::path::{Path as FilePath, PathBuf};
use std::sync::atomic::AtomicBool;

#[path = "../crates/baker/tests/watertight/closed.rs"]
#[allow(dead_code, reason = "the tests use the rest")]
mod closed;
#[path = "../crates/baker/tests/laws/exact.rs"]
mod exact;
#[path = "../crates/baker/tests/laws/level.rs"]
#[allow(dead_code, reason = "the tests use the rest")]
mod level;

use exact::{exact_sh, pixel_on_walls};
use level::*;

/// What is not said otherwise: 4096 samples.
const USUAL: BakeSettings = BakeSettings { samples: 4096, ..SMALL };

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    let areas: [(&'static str, Cases); 7] = [
        ("laws", laws),
        ("geometry", geometry),
        ("light", light),
        ("blending", blending),
        ("SH", harmonics),
        ("statistics", statistics),
        ("limits", limits),
    ];
    println!("| area | case | must hold | measured | holds |");
    println!("|---|---|---|---|---|");
    let mut table = Table { area: "", failed: 0 };
    for (area, cases) in areas.into_iter().filter(|(area, _)| wanted.is_empty() || wanted.iter().any(|w| w == area)) {
        table.area = area;
        cases(&mut table);
    }
    std::process::exit(i32::from(table.failed > 0));
}

/// Adds the rows of an area.
type Cases = fn(&mut Table);

/// Prints its rows as they come.
struct Table {
    area: &'static str,
    failed: u32,
}

impl Table {
    fn row(&mut self, case: &str, must: &str, measured: &str, holds: bool) {
        self.failed += u32::from(!holds);
        println!("| {} | {case} | {must} | {measured} | {} |", self.area, if holds { "yes" } else { "NO" });
    }

    /// A row whose measure is one number.
    fn at_most(&mut self, case: &str, what: &str, bound: f64, measured: f64) {
        self.row(case, &format!("{what} ≤ {bound}"), &format!("{measured:.1e}"), measured <= bound);
    }
}

fn percent(share: f64) -> String {
    format!("{:.2} %", share * 100.0)
}

fn quiet<T>(work: impl FnOnce(&Control) -> T) -> T {
    work(&Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None })
}

/// Error of E at all nodes.
fn error_of(baked: &Baked, truth: impl Fn(usize) -> RadianceSh) -> IrradianceError {
    let pair = |node| Pair { found: sh_of(baked, node), truth: Light::Radiance(truth(node)), variance: None };
    IrradianceError::of(&(0..baked.len()).map(pair).collect::<Vec<_>>())
}

/// Largest relative error of E = πL over 100 normals.
fn off_the_furnace(sh: &RadianceSh, radiance: [f32; 3]) -> f64 {
    let irradiance = sh.convolve();
    let errors = fibonacci_sphere(100).into_iter().flat_map(|n| {
        let e = irradiance.evaluate(n.to_array());
        [0, 1, 2].map(|c| (f64::from(e[c]) / (PI * f64::from(radiance[c])) - 1.0).abs())
    });
    errors.fold(0.0, f64::max)
}

/// Places all over a box, by the golden ratio's generalisation (Roberts, 2018).
fn spread(min: DVec3, max: DVec3, count: usize) -> Vec<DVec3> {
    let steps = DVec3::new(0.819_172_513_396_164, 0.671_043_606_703_789, 0.549_700_477_901_970);
    (1..=count).map(|i| min + (max - min) * (steps * i as f64).fract()).collect()
}

// ---- laws ----

fn laws(table: &mut Table) {
    let radiance = [1.0, 1e-3, 2e4];
    let (scene, probes) = (room_with_pillar(), white_probes(radiance));
    let (mut single, mut half) = (0.0f64, 0.0f64);
    for rule in every_rule() {
        let function = Gdibl::new(&scene, &probes, None, GdiblSettings { blend: rule, ..GdiblSettings::default() });
        for bands in 0..=4 {
            let nodes = Nodes::Points(places());
            let baked = bake_all(&function, &nodes, &BakeSettings { bands, ..USUAL });
            let packed = pack(
                &nodes,
                &baked,
                Records::default(),
                PackSettings { precision: Precision::F16, ..Default::default() },
            );
            let volume = Volume::parse(&packed.bytes).expect("what was packed parses");
            for node in 0..nodes.len() {
                single = single.max(off_the_furnace(&sh_of(&baked, node), radiance));
                half = half.max(off_the_furnace(&volume.node_sh(node), radiance));
            }
        }
    }
    let case = format!("furnace: room and probes of radiance L; {} blend rules, L0 to L4", every_rule().len());
    table.at_most(&format!("{case}; f32"), "E = πL: relative error", 1e-4, single);
    table.at_most("the same; f16, radiance of R, G, B 1, 1e-3, 2e4", "E = πL: relative error", 6e-4, half);

    let probes = coloured_probes();
    let uniform = BakeSettings { importance: false, ..USUAL };
    let bake_placed = |placement: &Placement, settings| {
        let (scene, probes) = (placement.scene(&scene), placement.probes(&probes));
        bake_points(&gdibl(&scene, &probes, None), &placement.points(&places()), settings)
    };
    let reference = bake_points(&gdibl(&scene, &probes, None), &places(), &uniform);
    let usual = bake_points(&gdibl(&scene, &probes, None), &places(), &USUAL);
    let (mut same, mut default) = (0.0f64, 0.0f64);
    for scale in [1e-3, 1.0, 1e3, 1e5] {
        for offset in [0.0, 1e4, 1e6] {
            let offset = DVec3::new(offset, -offset, offset / 3.0);
            let placement = Placement { scale, rotation: DQuat::IDENTITY, offset };
            same = same.max(difference(&bake_placed(&placement, &uniform).sh.to_vec(), &reference.sh.to_vec()));
            let moved = bake_placed(&placement, &USUAL);
            default = default.max(error_of(&moved, |node| sh_of(&usual, node)).relative_rmse);
        }
    }
    let case = "scale 1e-3, 1, 1e3, 1e5 × moved by 0, 1e4, 1e6 m";
    table.at_most(&format!("{case}; the same directions"), "change of the largest coefficient", 1e-3, same);
    table.at_most(&format!("{case}; default directions"), "relative RMSE of the change of E", 1e-3, default);

    let points = spread(DVec3::new(-2.9, -0.9, -1.9), DVec3::new(0.3, 1.9, 2.4), 96);
    let here = bake_points(&gdibl(&scene, &probes, None), &points, &USUAL);
    let mut ratios = Vec::new();
    for turn in 0..6 {
        let stream = Stream::new(Sampler::Random, 21, turn, 0);
        let ([a, b], [c, d]) = (stream.point(0, 0), stream.point(0, 1));
        let rotation =
            DQuat::from_xyzw(a.into(), b.into(), c.into(), d.into()) * 2.0 - DQuat::from_xyzw(1.0, 1.0, 1.0, 1.0);
        let rotation = rotation.normalize();
        let placement = Placement { scale: 1.0, rotation, offset: DVec3::ZERO };
        let (scene, probes) = (placement.scene(&scene), placement.probes(&probes));
        let seed = BakeSettings { seed: 100 + turn, ..USUAL };
        let there = bake_points(&gdibl(&scene, &probes, None), &placement.points(&points), &seed);
        ratios.push(turned_ratio(&here, &there, rotation));
    }
    let worst = ratios.iter().copied().fold(0.0, f64::max);
    table.row(
        "the whole input turned by 6 rotations, 96 nodes",
        "RMS difference of E over what standard errors promise ≤ 1.25",
        &format!("{:.2} to {worst:.2}", ratios.iter().copied().fold(f64::INFINITY, f64::min)),
        worst <= 1.25,
    );

    let scaled = |scale: f32| {
        let mut probes = coloured_probes();
        probes.iter_mut().for_each(|probe| probe.panorama.tint([scale; 3]));
        let sky = distant(panorama(32, |d| [1.5 + d.y, 1.0, 1.0 + d.x * d.z].map(|v| v * scale)));
        let mut open = scene.clone();
        remove_ceiling(&mut open);
        bake_points(&gdibl(&open, &probes, Some(&sky)), &places(), &USUAL).sh.to_vec()
    };
    let unit = scaled(1.0);
    let change = [1e-6f32, 1e6].map(|scale| {
        let expected: Vec<f32> = unit.iter().map(|v| v * scale).collect();
        difference(&scaled(scale), &expected)
    });
    table.at_most(
        "light × 1e-6, 1e6; probes and sky",
        "change of the largest coefficient",
        1e-5,
        change[0].max(change[1]),
    );
}

/// Root mean square difference of E between nodes and their turned twins over that of the standard errors.
fn turned_ratio(here: &Baked, there: &Baked, rotation: DQuat) -> f64 {
    let turn = DMat3::from_quat(rotation).as_mat3();
    let errors = [here, there].map(standard_errors);
    let promised: f64 = errors.iter().flatten().map(|error| error * error).sum();
    let mut found = 0.0;
    for node in 0..here.len() {
        let (a, b) = (sh_of(here, node), sh_of(there, node));
        let (e, turned) = (a.convolve(), b.convolve());
        for normal in fibonacci_sphere(26) {
            let (e, turned) = (e.evaluate(normal.to_array()), turned.evaluate((turn * normal).to_array()));
            found += (0..3).map(|c| f64::from(e[c] - turned[c]).powi(2)).sum::<f64>() / 78.0;
        }
    }
    (found / promised).sqrt()
}

fn remove_ceiling(scene: &mut Scene) {
    let room = &mut scene.meshes[0];
    let top = room.positions.iter().fold(f64::NEG_INFINITY, |m, p| m.max(p.y));
    room.triangles.retain(|t| t.iter().any(|&i| room.positions[i as usize].y < top));
}

// ---- geometry ----

fn geometry(table: &mut Table) {
    let (mut rays, mut escapes) = (0, 0);
    for offset in [0.0, 1e4, 1e6] {
        for scale in [1e-3, 1.0, 0.3, 1e5] {
            for mesh in closed::closed_meshes(scale, offset) {
                const COUNT: u32 = 1_400_000;
                rays += 2 * u64::from(COUNT);
                escapes += mesh.escapes(COUNT);
            }
        }
    }
    table.row(
        "rays at vertices, edges, along axes, with -0.0, from lattice points in closed meshes; scales 1e-3 to 1e5, to 1e6 m away",
        "no escape",
        &format!("{escapes} of {rays:.1e}", rays = rays as f64),
        escapes == 0,
    );
    broken_triangles(table);
    few_triangles(table);
    many_triangles(table);
    nodes_and_probes_in_bad_places(table);
    two_rooms(table);
}

/// A glTF file of one mesh.
fn glb(triangles: &[[[f32; 3]; 3]]) -> Vec<u8> {
    let bytes: Vec<u8> = triangles.iter().flatten().flatten().flat_map(|v| v.to_le_bytes()).collect();
    let json = serde_json::json!({
        "asset": { "version": "2.0" },
        "buffers": [{ "byteLength": bytes.len() }],
        "bufferViews": [{ "buffer": 0, "byteLength": bytes.len() }],
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3 * triangles.len(), "type": "VEC3" }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "nodes": [{ "mesh": 0 }],
        "scenes": [{ "nodes": [0] }],
    });
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let word = |number: usize| (number as u32).to_le_bytes();
    let length = 28 + text.len() + bytes.len();
    [&b"glTF"[..], &word(2), &word(length), &word(text.len()), b"JSON", &text, &word(bytes.len()), b"BIN\0", &bytes]
        .concat()
}

fn broken_triangles(table: &mut Table) {
    let float = |t: &Triangle| t.map(|p| p.as_vec3().to_array());
    let room: Vec<_> = box_of(DVec3::splat(-2.0), DVec3::splat(2.0)).iter().map(float).collect();
    let mut triangles = room.clone();
    triangles.extend_from_slice(&room);
    triangles.extend([
        [[0.0, 0.0, 0.0], [1.0, 0.0, f32::NAN], [0.0, 1.0, 0.0]],
        [[f32::INFINITY, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        [[0.0; 3], [0.0; 3], [1.0, 0.0, 0.0]],
        [[0.0; 3], [0.5; 3], [1.0; 3]],
        // Coplanar with a wall; a sliver of 1e6 to 1.
        [[-2.0, -2.0, 2.0], [1.0, -2.0, 2.0], [-1.0, 1.5, 2.0]],
        [[-2.0, -1.9, 1.5], [2.0, -1.9, 1.5], [2.0, -1.899_996, 1.5]],
    ]);
    let scene = parse_level(&glb(&triangles), FilePath::new("broken.glb"), &GltfOptions::default()).expect("it reads");
    let count = |id: &str| scene.findings.iter().find(|f| f.id == id).map_or(0, |f| f.count);
    let counts = [count("non-finite-triangles"), count("zero-area-triangles")];
    let probes = [probe(DVec3::new(0.1, 0.5, -0.2), 16, |_| [1.0; 3])];
    let baked = bake_points(&gdibl(&scene, &probes, None), &[DVec3::new(0.3, 0.2, 0.1), DVec3::splat(-1.0)], &USUAL);
    let off = (0..2).map(|node| off_the_furnace(&sh_of(&baked, node), [1.0; 3])).fold(0.0, f64::max);
    table.row(
        "2 non-finite, 2 zero-area, 12 duplicated, 1 coplanar, 1 sliver of 1e6:1 in a room",
        "counted; E = πL within 1e-4",
        &format!("{} non-finite, {} zero-area; {off:.1e}, coverage {}", counts[0], counts[1], baked.coverage[0]),
        counts == [2, 2] && off <= 1e-4,
    );
}

fn few_triangles(table: &mut Table) {
    let sky = distant(panorama(64, |d| [1.0 + d.y, 1.2 + d.x * d.z, 0.8]));
    let truth = exact_sh(&sky.panorama, 2);
    let none = Scene::default();
    let baked = bake_points(&gdibl(&none, &[], Some(&sky)), &[DVec3::ZERO], &USUAL);
    table.at_most(
        "no triangle: plain image based lighting",
        "relative RMSE of E",
        1e-2,
        error_of(&baked, |_| truth).relative_rmse,
    );
    // Of a square's half, a solid angle of Ω/2, nothing is known.
    let mut one = Scene::default();
    add(
        &mut one,
        Role::Environment,
        &[[DVec3::new(-1.0, 1.0, -1.0), DVec3::new(1.0, 1.0, -1.0), DVec3::new(1.0, 1.0, 1.0)]],
    );
    let white = distant(panorama(16, |_| [2.0; 3]));
    let baked = bake_points(&gdibl(&one, &[], Some(&white)), &[DVec3::ZERO], &USUAL);
    let expected = 1.0 - square_solid_angle(1.0, 1.0) / 2.0 / (4.0 * PI);
    let coverage = f64::from(baked.coverage[0]);
    let off = off_the_furnace(&sh_of(&baked, 0), [2.0; 3]);
    table.row(
        "one triangle that no probe has seen",
        "coverage within 1 %, E = πL within 1e-4",
        &format!("coverage {coverage:.4} for {expected:.4}; {off:.1e}"),
        (coverage - expected).abs() <= 0.01 && off <= 1e-4,
    );
}

/// Solid angle, sr, of a square of half side `half`, seen from `distance` over its centre.
fn square_solid_angle(half: f64, distance: f64) -> f64 {
    4.0 * (half * half / (half * half + distance * distance)).asin()
}

fn many_triangles(table: &mut Table) {
    let mut scene = Scene::default();
    let middle = DVec3::splat(4.0);
    // The tests' sphere minds no winding; this one is to be stood in.
    let inward = |[a, b, c]: Triangle| {
        if (b - a).cross(c - a).dot(a - middle) > 0.0 { [a, c, b] } else { [a, b, c] }
    };
    add(&mut scene, Role::Environment, &closed::sphere_mesh(9).into_iter().map(inward).collect::<Vec<_>>());
    let count = scene.triangle_count(Role::Environment);
    let probes = [probe(middle + DVec3::X, 16, |_| [1.0; 3])];
    let points = [middle, middle - DVec3::Y * 3.9];
    let started = std::time::Instant::now();
    let baked = bake_points(&gdibl(&scene, &probes, None), &points, &USUAL);
    let off = (0..2).map(|node| off_the_furnace(&sh_of(&baked, node), [1.0; 3])).fold(0.0, f64::max);
    table.row(
        &format!("{:.1} M triangles", count as f64 * 1e-6),
        "baked; E = πL within 1e-4",
        &format!("{off:.1e}, coverage {:.4}; {:.0} s", baked.coverage[0], started.elapsed().as_secs_f64()),
        off <= 1e-4,
    );
}

fn nodes_and_probes_in_bad_places(table: &mut Table) {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::splat(-2.0), DVec3::splat(2.0)));
    add(&mut scene, Role::Environment, &solid_of(DVec3::new(-1.5, -1.5, -1.5), DVec3::new(-0.5, -0.5, -0.5)));
    let white = |p: [f64; 3]| probe(p.into(), 16, |_| [1.0; 3]);
    let good = white([0.5, 0.5, 0.5]);
    let places = [
        ("on a wall", [2.0, 0.0, 0.0]),
        ("on an edge", [2.0, 2.0, 0.0]),
        ("in a corner", [2.0, 2.0, 2.0]),
        ("on a solid", [-0.5, -1.0, -1.0]),
        ("exactly at the probe", [0.5, 0.5, 0.5]),
        ("inside a solid", [-1.0, -1.0, -1.1]),
    ];
    let points = places.map(|(_, p)| DVec3::from(p));
    let probes = [good.clone()];
    let baked = bake_points(&gdibl(&scene, &probes, None), &points, &USUAL);
    for (node, (place, _)) in places.iter().enumerate() {
        let off = off_the_furnace(&sh_of(&baked, node), [1.0; 3]);
        let solid = *place == "inside a solid";
        let state = if baked.is_valid(node) { "valid" } else { "invalid, filled" };
        let must = if solid { "invalid, and filled with E = πL within 1e-3" } else { "valid; E = πL within 1e-3" };
        let holds = off <= 1e-3 && baked.is_valid(node) != solid;
        table.row(
            &format!("node {place}"),
            must,
            &format!("{state}; {off:.1e}, coverage {:.3}", baked.coverage[node]),
            holds,
        );
    }
    for (place, position) in
        [("on a wall", [0.0, 0.0, 2.0]), ("in a corner", [2.0, 2.0, 2.0]), ("inside a solid", [-1.0, -1.0, -0.9])]
    {
        let mut other = white(position);
        let with = [good.clone(), other.clone()];
        let both = bake_points(&gdibl(&scene, &with, None), &[DVec3::new(1.0, 0.0, 0.3)], &USUAL);
        let off = off_the_furnace(&sh_of(&both, 0), [1.0; 3]);
        // Alone, with light that would show where it does not belong.
        other.panorama = other.panorama.with_pixels(|_, _| [7.0; 3]);
        let alone = [other];
        let baked = bake_points(&gdibl(&scene, &alone, None), &[DVec3::new(1.0, 0.0, 0.3)], &USUAL);
        let lit = off_the_furnace(&sh_of(&baked, 0), [7.0; 3]);
        let holds = if baked.is_valid(0) { lit <= 1e-3 } else { place == "inside a solid" };
        table.row(
            &format!("probe {place}"),
            "beside another one E = πL within 1e-3; alone the node is valid, with the share it has seen as coverage, or invalid",
            &format!(
                "{off:.1e}; alone {}, coverage {:.3}",
                if baked.is_valid(0) { format!("valid, {lit:.1e}") } else { "invalid".into() },
                baked.coverage[0]
            ),
            off <= 1e-3 && holds,
        );
    }
}

fn two_rooms(table: &mut Table) {
    for wall in [1e-3, 1e-2, 0.1] {
        let mut scene = Scene::default();
        add(&mut scene, Role::Environment, &box_of(DVec3::new(-4.0, -1.5, -2.0), DVec3::new(0.0, 1.5, 2.0)));
        add(&mut scene, Role::Environment, &box_of(DVec3::new(wall, -1.5, -2.0), DVec3::new(4.0, 1.5, 2.0)));
        let probes =
            [probe(DVec3::new(-1.0, 0.1, 0.2), 16, |_| [1.0; 3]), probe(DVec3::new(1.0, -0.1, 0.3), 16, |_| [0.0; 3])];
        let function = gdibl(&scene, &probes, None);
        let mut points = Vec::new();
        for x in [wall + 1e-4, wall + 1e-3, wall + 0.02, 0.5, 3.999] {
            points.extend([[0.0, 0.0], [1.49, 1.99], [-1.4999, 0.5]].map(|[y, z]| DVec3::new(x, y, z)));
        }
        let baked = bake_points(&function, &points, &USUAL);
        let brightest = (0..points.len()).map(|node| strength(&sh_of(&baked, node))).fold(0.0, f64::max) / PI;
        let valid = baked.is_all_valid();
        table.row(
            &format!("dark room behind a wall of {wall} m: its nodes"),
            "valid, E ≤ 1e-3 of the bright room's",
            &format!("{brightest:.1e} of the bright room's"),
            valid && brightest <= 1e-3,
        );
        // A grid over both rooms, with nodes 0.5 m apart; read on both sides of the wall, on it, and facing either way.
        let grid = Grid { min: [-3.75, -1.25, -1.75], max: [3.75, 1.25, 1.75], counts: [16, 6, 8] };
        let volume = volume_of(&Nodes::Grid(grid), &function, &USUAL);
        let light = |x: f64, read: &dyn Fn([f64; 3], [f32; 3]) -> RadianceSh| {
            let place = |i: usize| [x, -1.5 + 3.0 * (i % 7) as f64 / 6.0, -2.0 + 4.0 * (i / 7) as f64 / 6.0];
            let normals = [Vec3::X, -Vec3::X, Vec3::Y, Vec3::new(0.0, -0.6, 0.8)];
            let all = (0..49).flat_map(move |i| normals.map(|n| (place(i), n.to_array())));
            let light = all.map(|(place, normal)| f64::from(read(place, normal).convolve().evaluate(normal)[1]) / PI);
            light.fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), e| (min.min(e), max.max(e)))
        };
        let sampled = |place: [f64; 3], normal: [f32; 3]| volume.sample_f64(place, normal).sh;
        let plain = |place: [f64; 3], _: [f32; 3]| {
            let cell = grid.locate(place);
            let mut sum = RadianceSh::zero(volume.header().bands);
            for (node, weight) in cell.nodes.iter().zip(cell.weights) {
                let node = volume.node_sh(*node as usize);
                let values = sum.coefficients.as_flattened_mut().iter_mut().zip(node.coefficients.as_flattened());
                values.for_each(|(sum, value)| *sum += weight * value);
            }
            sum
        };
        let away = [0.0, 1e-4, 1e-3, 0.02, 0.1, 0.25, 0.4, 0.6, 2.0];
        let dark = |read| away.iter().map(|d| light(wall + d, read).1).fold(0.0, f64::max);
        let bright = |read| away.iter().map(|d| light(-d, read).0).fold(1.0, f64::min);
        let (lit, shaded) = (dark(&sampled), 1.0 - bright(&sampled));
        table.row(
            &format!("two rooms, a wall of {wall} m between: the runtime's samples beside it, grid of 0.5 m over both"),
            "dark room: E ≤ 1e-3 of the bright one's; bright room: ≤ 2 % too dark",
            &format!(
                "{lit:.1e}, {:.2} % too dark; plain trilinear {:.2}, {:.0} %",
                shaded * 100.0,
                dark(&plain),
                100.0 - 100.0 * bright(&plain)
            ),
            lit <= 1e-3 && shaded <= 0.02,
        );
    }
}

// ---- light ----

fn light(table: &mut Table) {
    sun_in_one_pixel(table);
    fireflies(table);
    bright_pixel_of_a_probe(table);
    lamp_through_a_slit(table);
    third_bounce(table);
    strange_images(table);
}

fn sun_in_one_pixel(table: &mut Table) {
    let scene = Scene::default();
    let nodes = [DVec3::ZERO; 24];
    for sun in [1e5, 1e9] {
        let mut worst = [[(0.0f64, ""); 2]; 2];
        let mut firefly = 0.0f64;
        for width in [64usize, 512] {
            for (place, x, y) in sun_places(width) {
                let image = sky_with_sun(width, [x, y], sun);
                let truth = exact_sh(&image, 2);
                let sky = distant(image);
                for (i, samples) in [1024, 2048].into_iter().enumerate() {
                    let baked =
                        bake_points(&gdibl(&scene, &[], Some(&sky)), &nodes, &BakeSettings { samples, ..SMALL });
                    let error = error_of(&baked, |_| truth);
                    for (kind, value) in [error.relative_rmse, error.per_node.max].into_iter().enumerate() {
                        if value > worst[i][kind].0 {
                            worst[i][kind] = (value, place);
                        }
                    }
                    let strengths: Vec<f64> = (0..nodes.len()).map(|node| strength(&sh_of(&baked, node))).collect();
                    firefly = firefly.max(strengths.iter().copied().fold(0.0, f64::max) / median(strengths));
                }
            }
        }
        for (i, (samples, bound)) in [(1024, 0.015), (2048, 0.01)].into_iter().enumerate() {
            let [(rms, place), (node, _)] = worst[i];
            table.row(
                &format!("sun of {sun:.0e} in one pixel, 6 places (poles, seam) × 64, 512 columns; {samples} samples"),
                &format!("relative RMSE of E ≤ {}", percent(bound)),
                &format!("{} ({place}); worst of 24 nodes {}", percent(rms), percent(node)),
                rms <= bound,
            );
        }
        table.row(
            &format!("the same, sun of {sun:.0e}"),
            "brightest node ≤ 1.2 × the median",
            &format!("{firefly:.3}"),
            firefly <= 1.2,
        );
    }
}

/// The largest of a grid node over the median of its neighbours.
fn largest_over_neighbours(baked: &Baked, grid: &Grid) -> f64 {
    let [nx, ny, nz] = grid.counts.map(|c| c as i64);
    let strengths: Vec<f64> = (0..baked.len()).map(|node| strength(&sh_of(baked, node))).collect();
    let at = |x: i64, y: i64, z: i64| strengths[(x + nx * (y + ny * z)) as usize];
    let inside = |p: [i64; 3]| (0..nx).contains(&p[0]) && (0..ny).contains(&p[1]) && (0..nz).contains(&p[2]);
    let mut largest = 0.0f64;
    for index in 0..nx * ny * nz {
        let [x, y, z] = [index % nx, index / nx % ny, index / nx / ny];
        let around = (0..27).map(|i| [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1]);
        let around = around.filter(|p| inside(*p) && *p != [x, y, z]).map(|[x, y, z]| at(x, y, z)).collect();
        largest = largest.max(at(x, y, z) / median(around));
    }
    largest
}

fn fireflies(table: &mut Table) {
    let mut scene = room_with_pillar();
    remove_ceiling(&mut scene);
    let grid = Grid { min: [-2.8, -0.8, -1.8], max: [2.8, 1.8, 2.3], counts: [6, 4, 6] };
    let probes = coloured_probes();
    for sun in [1e5, 1e9] {
        let image = panorama(256, |d| [1.0 + d.y, 1.0, 1.2 + d.x * d.z]);
        let sky = distant(with_pixel(&image, [70, 30], [sun; 3]));
        let function = gdibl(&scene, &probes, Some(&sky));
        let nodes = Nodes::Grid(grid);
        let [few, many] = [1024, 16_384].map(|samples| bake_all(&function, &nodes, &BakeSettings { samples, ..SMALL }));
        let [found, converged] = [&few, &many].map(|baked| largest_over_neighbours(baked, &grid));
        let own = |node: usize| strength(&sh_of(&few, node)) / strength(&sh_of(&many, node));
        let worst = (0..nodes.len()).map(own).fold(0.0, f64::max);
        table.row(
            &format!("sun of {sun:.0e} over a room without ceiling, 144 nodes, 1024 samples: no firefly"),
            "brightest over its neighbours' median ≤ 1.2 × that of 16384 samples",
            &format!("{found:.3}, converged {converged:.3}; a node against itself converged ≤ {worst:.3}"),
            found <= 1.2 * converged && worst <= 1.2,
        );
    }
}

fn bright_pixel_of_a_probe(table: &mut Table) {
    let walls = [DVec3::new(-3.0, -1.0, -2.0), DVec3::new(3.0, 2.0, 2.5)];
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(walls[0], walls[1]));
    let points = spread(DVec3::new(-2.5, -0.5, -1.5), DVec3::new(2.5, 1.5, 2.0), 24);
    let plain = [probe(DVec3::new(0.3, 0.4, 0.2), 256, |d| [1.0 + d.y, 1.0, 1.2 + d.x * d.z])];
    let rest = bake_points(&gdibl(&scene, &plain, None), &points, &BakeSettings { samples: 1 << 17, ..SMALL });
    // On a wall, over an edge of the room, high up.
    for (place, pixel) in [("on a wall", [70usize, 50usize]), ("over an edge", [17, 70]), ("near a pole", [100, 4])] {
        for bright in [1e5, 1e9] {
            let mut probes = plain.clone();
            let image = &mut probes[0].panorama;
            let before = image.pixel(pixel[0], pixel[1]).x;
            *image = with_pixel(image, pixel, [bright; 3]);
            let truth: Vec<RadianceSh> = (0..points.len())
                .map(|node| {
                    let light = f64::from(bright - before);
                    let mut sum = pixel_on_walls(walls, probes[0].position, 256, pixel, light, points[node]);
                    sum.add_scaled(&sh_of(&rest, node), 1.0);
                    sum
                })
                .collect();
            let function = gdibl(&scene, &probes, None);
            for (samples, bound) in [(1024, 0.015), (2048, 0.01)] {
                let baked = bake_points(&function, &points, &BakeSettings { samples, ..SMALL });
                let error = error_of(&baked, |node| truth[node]);
                let claims = standard_errors(&baked);
                let [claimed, light] = [claims, truth.iter().map(strength).collect()]
                    .map(|values: Vec<f64>| values.iter().map(|v| v * v).sum::<f64>());
                table.row(
                    &format!("{bright:.0e} in one of 256 × 128 pixels of a probe in a room, {place}, 24 nodes; {samples} samples"),
                    &format!("relative RMSE of E ≤ {}", percent(bound)),
                    &format!(
                        "{}, worst node {}; claimed {}",
                        percent(error.relative_rmse),
                        percent(error.per_node.max),
                        percent((claimed / light).sqrt())
                    ),
                    error.relative_rmse <= bound,
                );
            }
        }
    }
}

/// Adds triangles of a material of their own.
fn add_of(scene: &mut Scene, triangles: &[Triangle], albedo: f32, emission: f32) {
    add(scene, Role::Environment, triangles);
    let base_color = Vec3::splat(albedo).extend(1.0);
    let material = Material { base_color, metallic: 0.0, emission: Vec3::splat(emission), ..Material::default() };
    scene.materials.push(material);
    scene.meshes.last_mut().expect("just added").material = scene.materials.len() as u32 - 1;
}

/// A square that shines down.
fn lamp(middle: DVec3, half: f64) -> Vec<Triangle> {
    let corner = |x: f64, z: f64| middle + DVec3::new(x * half, 0.0, z * half);
    let [a, b, c, d] = [corner(-1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0)];
    vec![[a, c, b], [a, d, c]]
}

fn captured(path: &Path, position: DVec3, settings: &CaptureSettings) -> Probe {
    let image = quiet(|control| capture(path, position, 0, settings, control)).expect("nobody interrupts").image;
    Probe {
        name: "captured".into(),
        position,
        rotation: Quat::IDENTITY,
        exposure_stops: 0.0,
        panorama: Panorama::new(image.width, image.height, image.pixels, image.distance),
    }
}

/// How often standard errors cover the truth.
struct Covered {
    /// Of all nodes and seeds.
    share: f64,
    /// Of the node where they do least.
    worst: f64,
    /// RMS of the claimed errors over that of the true ones.
    ratio: f64,
}

/// How often 3.18 standard errors (Student's t of 3 degrees, 95 %) cover the truth, over nodes and seeds.
fn covered(function: &impl RadianceFunction, points: &[DVec3], samples: u64, seeds: u64) -> Covered {
    let nodes = Nodes::Points(points.to_vec());
    let of = |samples, seed| bake_all(function, &nodes, &BakeSettings { samples, seed, ..SMALL });
    let truth = of(samples * 256, 1 << 40);
    let (mut inside, mut claimed, mut found) = (vec![0; points.len()], 0.0, 0.0);
    for seed in 0..seeds {
        let baked = of(samples, seed);
        let claims = standard_errors(&baked);
        for (node, claim) in claims.into_iter().enumerate() {
            let mut difference = sh_of(&baked, node);
            difference.add_scaled(&sh_of(&truth, node), -1.0);
            let (error, light) = (strength(&difference), strength(&sh_of(&baked, node)));
            inside[node] += u32::from(error <= 3.18 * claim);
            // Each node counts alike.
            claimed += (claim / light).powi(2);
            found += (error / light).powi(2);
        }
    }
    let share = |inside: u32| f64::from(inside) / seeds as f64;
    let worst = inside.iter().copied().min().map_or(0.0, share);
    Covered { share: share(inside.iter().sum()) / points.len() as f64, worst, ratio: (claimed / found).sqrt() }
}

fn covered_row(table: &mut Table, case: &str, found: Covered) {
    let Covered { share, worst, ratio } = found;
    let measured = format!(
        "{} covered, worst node {}; RMS of claimed over true errors {ratio:.2}",
        percent(share),
        percent(worst)
    );
    table.row(case, "3.18 standard errors of E cover the truth at ≥ 95 % of nodes and seeds", &measured, share >= 0.95);
}

fn lamp_through_a_slit(table: &mut Table) {
    // Two rooms of 2 m with a slit of 2 cm, and a lamp of 1 cm² close behind it.
    let mut scene = Scene::default();
    add_of(&mut scene, &box_of(DVec3::new(-2.0, 0.0, -1.0), DVec3::new(2.0, 2.0, 1.0)), 0.5, 0.0);
    for side in [[-1.0, -0.01], [0.01, 1.0]] {
        add_of(&mut scene, &solid_of(DVec3::new(-0.05, 0.0, side[0]), DVec3::new(0.05, 2.0, side[1])), 0.5, 0.0);
    }
    add_of(&mut scene, &lamp(DVec3::new(-0.5, 1.5, 0.0), 0.005), 0.0, 1e5);
    // In the beam, at its edge, and out of it.
    let points =
        [[0.5, 0.5, 0.0], [1.0, 0.7, 0.01], [0.4, 0.9, 0.02], [1.0, 1.0, 0.5], [1.8, 0.2, -0.8], [0.2, 1.9, 0.9]]
            .map(DVec3::from);
    let path = Path::new(&scene, None, PathSettings::default());
    covered_row(
        table,
        "lamp of 1 cm² through a slit of 2 cm; path tracing, 6 nodes × 40 seeds",
        covered(&path, &points, 1024, 40),
    );
    let settings = CaptureSettings { width: 128, samples: 64, emission: false, ..CaptureSettings::default() };
    let probes =
        [DVec3::new(-1.0, 1.0, 0.1), DVec3::new(1.0, 1.0, 0.0)].map(|position| captured(&path, position, &settings));
    let settings = GdiblSettings { emission_from_materials: true, ..GdiblSettings::default() };
    let function = Gdibl::new(&scene, &probes, None, settings);
    covered_row(table, "the same; GDIBL with two captured probes", covered(&function, &points, 1024, 40));
    let photographed = CaptureSettings { width: 512, samples: 64, ..CaptureSettings::default() };
    let probes = [DVec3::new(-1.0, 1.0, 0.1), DVec3::new(1.0, 1.0, 0.0)]
        .map(|position| captured(&path, position, &photographed));
    let function = gdibl(&scene, &probes, None);
    covered_row(table, "the same; the lamp only in the probes' pixels", covered(&function, &points, 4096, 40));
}

fn third_bounce(table: &mut Table) {
    // A corridor with three baffles: what reaches its end has left three surfaces.
    let mut scene = Scene::default();
    add_of(&mut scene, &box_of(DVec3::ZERO, DVec3::new(8.0, 3.0, 3.0)), 0.7, 0.0);
    for (x, from, to) in [(2.0, 0.0, 2.0), (4.0, 1.0, 3.0), (6.0, 0.0, 2.0)] {
        add_of(&mut scene, &solid_of(DVec3::new(x, 0.0, from), DVec3::new(x + 0.02, 3.0, to)), 0.7, 0.0);
    }
    add_of(&mut scene, &lamp(DVec3::new(0.5, 2.9, 0.5), 0.05), 0.0, 1e4);
    let points = [[7.5, 1.0, 0.5], [7.2, 2.0, 1.5], [7.9, 0.1, 2.8], [7.3, 1.5, 0.3]].map(DVec3::from);
    let light = |bounces| {
        let path = Path::new(&scene, None, PathSettings { bounces, ..PathSettings::default() });
        strength(&sh_of(&bake_points(&path, &points[..1], &BakeSettings { samples: 1 << 14, ..SMALL }), 0))
    };
    let share = light(Some(2)) / light(None);
    let path = Path::new(&scene, None, PathSettings::default());
    let settings = CaptureSettings { width: 64, samples: 256, ..CaptureSettings::default() };
    let probes = [captured(&path, DVec3::new(7.4, 1.5, 1.2), &settings)];
    let case =
        format!("light by three bounces and more alone ({} by two) in a probe, 4 nodes × 60 seeds", percent(share));
    covered_row(table, &case, covered(&gdibl(&scene, &probes, None), &points, 1024, 60));
}

fn strange_images(table: &mut Table) {
    let scene = Scene::default();
    let bake_sky = |image: Panorama| {
        let truth = exact_sh(&image, 2);
        let sky = distant(image);
        let baked = bake_points(&gdibl(&scene, &[], Some(&sky)), &[DVec3::ZERO; 8], &USUAL);
        (baked, truth)
    };
    let (baked, truth) = bake_sky(panorama(128, |d| [d.x, d.y, d.z].map(|t| 10f32.powf(6.0 * t))));
    table.at_most("1e-6 to 1e6 in one image", "relative RMSE of E", 0.01, error_of(&baked, |_| truth).relative_rmse);
    let (baked, _) = bake_sky(panorama(16, |_| [0.0; 3]));
    let black = baked.sh.to_vec().iter().all(|v| *v == 0.0) && baked.is_all_valid() && baked.relative_error == [0.0; 8];
    table.row("all black", "E = 0, valid, no error", if black { "so" } else { "not so" }, black);

    let mut worst = (0.0f64, [0, 0]);
    for [width, height] in [[1, 1], [2, 1], [1, 2], [3, 1], [5, 3], [7, 7], [17, 9], [333, 111]] {
        let pixels = (0..width * height).map(|i| [1.0 + i as f32 % 7.0, 2.0, 1.0 + i as f32 % 3.0]).collect();
        let image = Panorama::new(width, height, pixels, None);
        // Cells of many degrees are too much for the quadrature of larger images.
        let truth = dense_sh(&image);
        let (baked, _) = bake_sky(image);
        let error = error_of(&baked, |_| truth).relative_rmse;
        if error > worst.0 {
            worst = (error, [width, height]);
        }
    }
    let [width, height] = worst.1;
    table.row(
        "images of 1 × 1, 2 × 1, odd sizes",
        "relative RMSE of E ≤ 1 %",
        &format!("{} ({width} × {height})", percent(worst.0)),
        worst.0 <= 0.01,
    );
    let folder = Folder::new();
    unusable_pixels(table, &folder);
    half_floats(table, &folder);
    sixteen_k(table, &folder);
}

/// Coefficients of a panorama by a million directions.
fn dense_sh(panorama: &Panorama) -> RadianceSh {
    const COUNT: usize = 1 << 20;
    let mut sums = [[0.0f64; 3]; 9];
    for direction in fibonacci_sphere(COUNT) {
        let radiance = panorama.radiance(direction);
        let mut basis = [0.0; sh::MAX_COEFFICIENTS];
        sh::basis(2, direction.to_array(), &mut basis);
        for (sum, y) in sums.iter_mut().zip(basis) {
            (0..3).for_each(|c| sum[c] += f64::from(radiance[c] * y));
        }
    }
    radiance_sh(2, sums.map(|rgb| rgb.map(|v| (v * 4.0 * PI / COUNT as f64) as f32)))
}

/// A folder that goes with the tool.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Folder {
        let path = std::env::temp_dir().join(format!("gdibl-extremes-{}", std::process::id()));
        std::fs::create_dir_all(&path).expect("a temporary folder");
        Folder(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn unusable_pixels(table: &mut Table, folder: &Folder) {
    let path = folder.0.join("bad.exr");
    let mut told = Vec::new();
    let mut holds = true;
    for (name, bad) in [("NaN", f32::NAN), ("inf", f32::INFINITY), ("-1", -1.0)] {
        let mut image = Image::new(16, 8, vec![[1.0; 3]; 128]);
        image.pixels[3 * 16 + 5][1] = bad;
        write_exr(&path, &image, &Pose::default(), Mapping::LatLong, SampleFormat::F32).expect("it writes");
        let message = read_image(&path, &ReadOptions::default()).err().map_or(String::new(), |e| e.to_string());
        let refused = message.contains("x 5, y 3") && message.contains("--repair-pixels");
        let repaired = read_image(&path, &ReadOptions { repair_pixels: true, layer: None }).expect("it repairs");
        let clean = repaired.image.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0);
        let counted = repaired.findings.iter().any(|f| f.id == "repaired-pixels" && f.count == 1);
        holds &= refused && clean && counted;
        told.push(format!("{name} {}", if refused && clean && counted { "so" } else { "not so" }));
    }
    let must = "refused with x and y; repaired and counted when asked";
    table.row("negative, NaN, infinite pixels", must, &told.join(", "), holds);
}

fn half_floats(table: &mut Table, folder: &Folder) {
    let path = folder.0.join("half.exr");
    let mut image = Image::new(16, 8, vec![[1.0; 3]; 128]);
    image.pixels[40] = [1e6, 65_504.0, 1.0];
    let found = |findings: &[gdibl_baker::Finding]| findings.iter().any(|f| f.id == "half-float-clipping");
    let written =
        found(&write_exr(&path, &image, &Pose::default(), Mapping::LatLong, SampleFormat::F16).expect("it writes"));
    let read = found(&read_image(&path, &ReadOptions::default()).expect("it reads").findings);
    let measured = format!("written {written}, read {read}");
    table.row("half floats at 65504", "a finding where it is written and read", &measured, written && read);
}

fn sixteen_k(table: &mut Table, folder: &Folder) {
    const WIDTH: usize = 16_384;
    let path = folder.0.join("16k.exr");
    let (x, y) = (5000, 2500);
    let sun = 6e4f32;
    let mut image = {
        let light = panorama(WIDTH, |_| [1.0; 3]);
        Image::new(WIDTH, WIDTH / 2, light.pixels().collect())
    };
    image.pixels[y * WIDTH + x] = [sun; 3];
    let started = std::time::Instant::now();
    write_exr(&path, &image, &Pose::default(), Mapping::LatLong, SampleFormat::F16).expect("it writes");
    drop(image);
    let image = read_image(&path, &ReadOptions::default()).expect("it reads").image;
    let _ = std::fs::remove_file(&path);
    let sky = distant(Panorama::new(image.width, image.height, image.pixels, None));
    // Light of 1 from everywhere, and the sun: what its pixel adds, over the pixel's solid angle.
    let direction = sky.panorama.pixel_direction(x, y);
    let mut basis = [0.0; sh::MAX_COEFFICIENTS];
    sh::basis(2, direction.to_array(), &mut basis);
    let area = f64::from(sun - 1.0) * sky.panorama.pixel_solid_angle(y);
    let coefficients = basis[..9]
        .iter()
        .enumerate()
        .map(|(i, basis)| [(if i == 0 { (4.0 * PI).sqrt() } else { 0.0 } + area * f64::from(*basis)) as f32; 3]);
    let truth = radiance_sh(2, coefficients);
    let scene = Scene::default();
    let baked =
        bake_points(&gdibl(&scene, &[], Some(&sky)), &[DVec3::ZERO; 24], &BakeSettings { samples: 2048, ..SMALL });
    let error = error_of(&baked, |_| truth).relative_rmse;
    table.row(
        "16384 × 8192 pixels, one of them 6e4, written, read and baked",
        "relative RMSE of E ≤ 1 % at 2048 samples",
        &format!("{}; {:.0} s in all", percent(error), started.elapsed().as_secs_f64()),
        error <= 0.01,
    );
}

// ---- blending ----

fn blending(table: &mut Table) {
    let at = |distance, cosine, angle, pixels| View { distance, cosine, angle, pixels };
    let crowd: Vec<View> = (0..64).map(|i| at(1.0 + i as f32, 0.5, 0.05 * i as f32, (8 << (i % 8)) as f32)).collect();
    let cases: [(&str, Vec<View>); 8] = [
        ("one probe", vec![at(2.0, 0.3, 1.0, 512.0)]),
        ("64 probes", crowd),
        ("two at one place", vec![at(2.0, 0.5, 0.7, 512.0); 2]),
        ("all angles equal", (1..9).map(|i| at(i as f32, 0.5, 0.7, 512.0)).collect()),
        ("zero angle", vec![at(1.0, 0.5, 0.0, 512.0), at(1.0, 0.5, 0.0, 512.0), at(2.0, 0.5, 0.5, 512.0)]),
        ("grazing to 1e-7", vec![at(1.0, 1e-7, 1.5, 512.0), at(2.0, 1e-7, 1.0, 512.0), at(3.0, 1e-6, 0.5, 512.0)]),
        ("mixed resolutions", [2.0, 128.0, 1.3e8].map(|pixels| at(1.0, 0.5, 0.3, pixels)).into()),
        ("from 1e-30 to 1e6 away", vec![at(1e-30, 0.5, 3.1, 512.0), at(1e6, 1.0, 1e-20, 512.0)]),
    ];
    for (case, views) in cases {
        let (mut sum_off, mut broken) = (0.0f64, 0);
        for rule in every_rule() {
            let weights = weigh(rule, &views);
            broken += weights.iter().filter(|w| !(w.is_finite() && **w >= 0.0)).count();
            sum_off = sum_off.max((weights.iter().map(|w| f64::from(*w)).sum::<f64>() - 1.0).abs());
        }
        table.row(
            &format!("{case}; {} rules, k of 0, 1, 4, 1e3", every_rule().len()),
            "weights finite, ≥ 0, sum 1 within 1e-6",
            &format!("{broken} broken, sum off by {sum_off:.1e}"),
            broken == 0 && sum_off <= 1e-6,
        );
    }
    continuity(table);
    third_unseen(table);
}

/// Weights of probes as a surface point blends them, best first.
fn weigh(rule: BlendRule, views: &[View]) -> Vec<f32> {
    let mut merits: Vec<f32> = views.iter().map(|view| rule.merit(view)).collect();
    merits.sort_by(|a, b| b.total_cmp(a));
    merits.truncate(rule.reach());
    let mut weights = Vec::new();
    rule.weights(&merits, &mut weights);
    let sum: f32 = weights.iter().sum();
    weights.iter().map(|w| w / sum).collect()
}

fn continuity(table: &mut Table) {
    let scene = plane();
    let probes = unlike_probes();
    for rule in [BlendRule::Distance(2.0), BlendRule::AngularSmooth(2.0), BlendRule::Footprint(4.0)] {
        let function = Gdibl::new(&scene, &probes, None, GdiblSettings { blend: rule, ..GdiblSettings::default() });
        let largest_step = |count: u32| {
            let at = |i: u32| DVec3::new(-9.0 + 18.0 * f64::from(i) / f64::from(count), 0.37, 0.0);
            let viewer = DVec3::new(0.3, -4.0, 2.5);
            let light: Vec<Vec3> = (0..=count).map(|i| seen(&function, viewer, at(i))).collect();
            f64::from(light.windows(2).map(|pair| (pair[1] - pair[0]).length()).fold(0.0, f32::max))
        };
        let [coarse, fine] = [4000, 64_000].map(largest_step);
        table.row(
            &format!("{rule} over a plane, 5 probes of unlike colours"),
            "steps of ε/16 change light by about 1/16 (≤ 1/8) of what ε does",
            &format!("{coarse:.1e}, then {fine:.1e}: 1/{:.1}", coarse / fine),
            fine <= coarse / 8.0,
        );
    }
}

fn third_unseen(table: &mut Table) {
    // A square that no probe has seen takes a third of what a node at the origin sees.
    let half = (1.0 / (1.0 / (PI / 3.0).sin() - 1.0)).sqrt();
    let mut scene = Scene::default();
    let [a, b, c, d] = [[-half, -half], [half, -half], [half, half], [-half, half]].map(|[x, y]| DVec3::new(x, y, 1.0));
    add(&mut scene, Role::Environment, &[[a, c, b], [a, d, c]]);
    let sky = distant(panorama(64, |d| [1.5 + d.y, 1.2 + d.x, 1.0 - 0.5 * d.z]));
    let function = gdibl(&scene, &[], Some(&sky));
    let line: Vec<DVec3> = (0..41).map(|i| DVec3::X * (0.01 * f64::from(i))).collect();
    let baked = bake_points(&function, &line, &USUAL);
    let coverage = f64::from(baked.coverage[0]);
    table.row(
        "no probe has seen a third of the level",
        "coverage within 1 % of 2/3",
        &format!("{coverage:.4}"),
        (coverage - 2.0 / 3.0).abs() <= 0.01,
    );
    let same = bake_points(&function, &line, &USUAL) == baked;
    let other = bake_points(&function, &line, &BakeSettings { seed: 9, samples: 16_384, ..SMALL });
    let change = error_of(&other, |node| sh_of(&baked, node)).relative_rmse;
    let step = |node: usize| {
        let mut step = sh_of(&baked, node + 1);
        step.add_scaled(&sh_of(&baked, node), -1.0);
        strength(&step) / strength(&sh_of(&baked, node))
    };
    let largest = (0..line.len() - 1).map(step).fold(0.0, f64::max);
    table.row(
        "the same: fill",
        "same bits again; other seed and four times the samples change E by ≤ 2 %; nodes 1 cm apart by ≤ 2 %",
        &format!("{}; {}; {}", if same { "same" } else { "other" }, percent(change), percent(largest)),
        same && change <= 0.02 && largest <= 0.02,
    );
}

// ---- SH ----

fn harmonics(table: &mut Table) {
    let (mut off, mut least, mut kept) = (0.0f64, f64::INFINITY, true);
    let points = [DVec3::ZERO];
    let search = fibonacci_sphere(20_000);
    for toward in fibonacci_sphere(8) {
        for opposite in [0.0, 1.0] {
            let sun = |toward: Vec3, irradiance: f32| PunctualLight {
                name: String::new(),
                kind: PunctualKind::Directional,
                intensity: Vec3::splat(irradiance),
                range: f32::INFINITY,
                position: DVec3::ZERO,
                direction: -toward,
            };
            let scene = Scene { lights: vec![sun(toward, 20.0), sun(-toward, 20.0 * opposite)], ..Scene::default() };
            let sky = distant(panorama(4, |_| [0.01, 0.02, 0.03]));
            let path = Path::new(&scene, Some(&sky), PathSettings { bounces: Some(0), ..PathSettings::default() });
            for bands in 0..=4 {
                let baked = bake_points(&path, &points, &BakeSettings { bands, samples: 64, punctual: true, ..SMALL });
                let mut expected = RadianceSh::zero(bands);
                for (direction, irradiance) in [(toward, 20.0), (-toward, 20.0 * opposite)] {
                    let mut basis = [0.0; sh::MAX_COEFFICIENTS];
                    sh::basis(bands, direction.to_array(), &mut basis);
                    for (rgb, y) in expected.coefficients.iter_mut().zip(basis) {
                        rgb.iter_mut().for_each(|v| *v += irradiance * y);
                    }
                }
                for (v, sky) in expected.coefficients[0].iter_mut().zip([0.01, 0.02, 0.03]) {
                    *v += sky * (4.0 * PI).sqrt() as f32;
                }
                let raw = sh_of(&baked, 0);
                let errors = raw.coefficients.iter().flatten().zip(expected.coefficients.iter().flatten());
                off = off.max(errors.map(|(a, b)| f64::from((a - b).abs()) / 20.0).fold(0.0, f64::max));
                for precision in [Precision::F16, Precision::F32] {
                    let volume = |dering| {
                        let settings = PackSettings { precision, dering, ..PackSettings::default() };
                        let nodes = Nodes::Points(points.to_vec());
                        Volume::parse(&pack(&nodes, &baked, Records::default(), settings).bytes)
                            .expect("what was packed parses")
                    };
                    let (before, after) = (volume(false).node_sh(0), volume(true).node_sh(0));
                    kept &= before.coefficients[0] == after.coefficients[0];
                    let irradiance = after.convolve();
                    for normal in search.iter().copied().chain([toward, -toward]) {
                        for (c, e) in irradiance.evaluate(normal.to_array()).into_iter().enumerate() {
                            least = least.min(f64::from(e / (irradiance.coefficients[0][c] * sh::Y00)));
                        }
                    }
                }
            }
        }
    }
    let case = "delta light, alone and opposite another; 8 directions, L0 to L4";
    table.at_most(case, "projection off by, over the light's E:", 1e-6, off);
    table.row(
        "the same after opt-in de-ringing; f16, f32",
        "least E over 20 000 normals ≥ -1e-6 of its mean; L0 the same bits",
        &format!("{least:.1e}; L0 {}", if kept { "the same" } else { "CHANGED" }),
        least >= -1e-6 && kept,
    );
}

// ---- statistics ----

fn statistics(table: &mut Table) {
    let assets = FilePath::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/uffizi-box"));
    let scene = read_scene(&assets.join("empty-box.glb"));
    let (probes, distant) = read_lighting(assets);
    let function = gdibl(&scene, &probes, Some(&distant));
    let truth = read_truth(assets, &["grid"]);
    let points: Vec<DVec3> =
        truth.iter().flat_map(|set| set.positions.iter().map(|p| DVec3::from(*p))).take(64).collect();
    let nodes = Nodes::Points(points.clone());
    for samples in [256, 1024, 4096] {
        let seeds = if samples == 4096 { 8 } else { 24 };
        let of = |seed| bake_all(&function, &nodes, &BakeSettings { samples, seed, ..SMALL });
        let all: Vec<Baked> = (0..seeds).map(of).collect();
        // The mean over seeds; each deviates from it by a little less than from the truth.
        let mut mean = all[0].clone();
        mean.sh.update(|node, values| {
            for (i, value) in values.iter_mut().enumerate() {
                *value = (all.iter().map(|baked| f64::from(baked.node(node)[i])).sum::<f64>() / seeds as f64) as f32;
            }
        });
        let (mut claimed, mut found) = (0.0, 0.0);
        for baked in &all {
            for (node, error) in standard_errors(baked).into_iter().enumerate() {
                let truth = sh_of(&mean, node);
                let mut difference = sh_of(baked, node);
                difference.add_scaled(&truth, -1.0);
                found += (strength(&difference) / strength(&truth)).powi(2) * seeds as f64 / (seeds - 1) as f64;
                claimed += (error / strength(&truth)).powi(2);
            }
        }
        let count = (seeds as usize * points.len()) as f64;
        let ratio = (claimed / found).sqrt();
        table.row(
            &format!("standard error in the box, {} nodes × {seeds} seeds, {samples} samples", points.len()),
            "RMS of claimed over true errors 0.85 to 1.18",
            &format!(
                "{ratio:.3}: claimed {}, true {}",
                percent((claimed / count).sqrt()),
                percent((found / count).sqrt())
            ),
            (0.85..1.18).contains(&ratio),
        );
    }
    let converged = bake_all(&function, &nodes, &BakeSettings { samples: 1 << 17, seed: 1 << 40, ..SMALL });
    let budgets = [64, 256, 1024, 4096, 16_384];
    let error = |samples: &u64| {
        let baked = bake_all(&function, &nodes, &BakeSettings { samples: *samples, seed: 1, ..SMALL });
        error_of(&baked, |node| sh_of(&converged, node)).relative_rmse
    };
    let errors: Vec<f64> = budgets.iter().map(error).collect();
    let slope = (errors[4] / errors[0]).ln() / (16_384f64 / 64.0).ln();
    let falls = errors.windows(2).all(|pair| pair[1] < 0.75 * pair[0]);
    table.row(
        "error against samples in the box, 64 to 16384, against 2^17",
        "log-log slope ≤ -0.5; four times the samples leave < 0.75 of the error",
        &format!("slope {slope:.2}: {}", errors.iter().map(|e| percent(*e)).collect::<Vec<_>>().join(", ")),
        slope <= -0.5 && falls,
    );
}

// ---- limits ----

fn limits(table: &mut Table) {
    let (scene, probes) = (room_with_pillar(), coloured_probes());
    let function = gdibl(&scene, &probes, None);
    let one = bake_points(&function, &places(), &BakeSettings { samples: 1, ..SMALL });
    let finite = one.sh.to_vec().iter().all(|v| v.is_finite());
    let unknown = one.valid_nodes().all(|node| one.relative_error[node] == f32::INFINITY);
    table.row(
        "1 sample",
        "finite; the error is said to be unknown",
        &format!("{}; {}", if finite { "finite" } else { "not finite" }, if unknown { "unknown" } else { "a number" }),
        finite && unknown,
    );
    let started = std::time::Instant::now();
    let most = bake_points(&function, &places()[..1], &BakeSettings { samples: 1 << 24, ..SMALL });
    let seconds = started.elapsed().as_secs_f64();
    let fewer = bake_points(&function, &places()[..1], &BakeSettings { samples: 1 << 18, seed: 8, ..SMALL });
    let difference = error_of(&fewer, |node| sh_of(&most, node)).relative_rmse;
    let (claimed, more) = (f64::from(fewer.relative_error[0]), f64::from(most.relative_error[0]));
    table.row(
        "2^24 samples on one node",
        "finite; 2^18 differ by ≤ 3.18 of their standard errors",
        &format!("{difference:.1e} for a standard error of {claimed:.1e}, then {more:.1e}; {seconds:.0} s"),
        most.sh.to_vec().iter().all(|v| v.is_finite()) && difference <= 3.18 * claimed && more < claimed,
    );
    let settings = BakeSettings { samples: 4096, target_error: Some(1e-6), ..SMALL };
    let capped = bake_points(&function, &places(), &settings);
    table.row(
        "target 1e-6 under a cap of 4096",
        "ends at the cap; all missed nodes counted",
        &format!("{} samples at {} nodes, {} missed", capped.samples, places().len(), capped.missed),
        capped.samples == 4096 * places().len() as u64 && capped.missed == places().len() as u64,
    );
    let lonely = Grid { min: [-1.0, 0.0, 0.0], max: [1.0, 1.0, 1.0], counts: [1; 3] };
    let volume = volume_of(&Nodes::Grid(lonely), &function, &USUAL);
    let [here, far] = [[0.0, 0.5, 0.5], [-9.0, 0.2, 3.0]].map(|p| volume.sample_f64(p, [0.0, 1.0, 0.0]).sh);
    let alike = here == far && strength(&here) > 0.1 && volume.node_count() == 1;
    table.row("a grid of 1 node", "baked, and the same light everywhere", if alike { "so" } else { "not so" }, alike);
    program(table, &BakeSettings::default());
}

/// What only the command itself decides.
fn program(table: &mut Table, settings: &BakeSettings) {
    let root = FilePath::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    let folder = Folder::new();
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let run = |arguments: &str| {
        let mut command = std::process::Command::new(&cargo);
        command.current_dir(root).args(["run", "--release", "--quiet", "--bin", "gdibl", "--", "bake"]);
        command.arg("assets/uffizi-box/empty-box.glb");
        (0..3).for_each(|i| {
            command.args(["--probes", &format!("assets/uffizi-box/probe_{i}.exr")]);
        });
        command.args(["--distant", "assets/uffizi-box/distant.exr", "-o"]).arg(folder.0.join("out.gdibl"));
        let output = command.args(arguments.split(' ')).output().expect("cargo runs");
        let text = String::from_utf8_lossy(&output.stderr).lines().last().unwrap_or_default().to_string();
        (output.status.code(), text, folder.0.join("out.gdibl").exists())
    };
    let gib = |nodes: u64| memory_needed(nodes, settings, true) as f64 / f64::from(1 << 30);
    for (case, arguments, nodes) in [
        ("1e8 nodes, --max-memory 8", "--counts 500,500,400 --max-memory 8", 100_000_000),
        ("1e12 nodes", "--counts 10000,10000,10000", 1_000_000_000_000),
    ] {
        let (code, said, written) = run(arguments);
        let holds = code == Some(1) && said.contains("GiB") && !written && gib(nodes) > 8.0;
        let measured = format!("exit {}: {}", code.unwrap_or(-1), said.replace('|', "/"));
        table.row(
            case,
            &format!("memory said ({:.0} GiB), refused with exit 1, nothing written", gib(nodes)),
            &measured,
            holds,
        );
    }
    let (code, said, written) = run("--counts 2,2,2 --target-error 1e-6 --samples 4096");
    table.row(
        "the command: target 1e-6 under a cap of 4096",
        "exit 5, missed nodes counted, volume written",
        &format!("exit {}: {}", code.unwrap_or(-1), said.replace('|', "/")),
        code == Some(5) && written,
    );
}
