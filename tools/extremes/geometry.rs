//! Triangles: closed, broken, few, many.

use crate::closed;
use crate::exact::exact_sh;
use crate::level::*;
use crate::shared::*;
use crate::table::Table;
use gdibl_baker::import::gltf::{GltfOptions, parse_level};
use gdibl_baker::scene::{Role, Scene};
use glam::DVec3;
use std::f64::consts::PI;
use std::path::Path;

pub fn rows(table: &mut Table) {
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
    let scene = parse_level(&glb(&triangles), Path::new("broken.glb"), &GltfOptions::default()).expect("it reads");
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
