//! A second opinion on files: `format_reader.py`, written from FORMAT.md alone.

use crate::common::{Folder, Level, csv_of, normals, python, repository, solid_of};
use gdibl_runtime::Volume;
use std::io::Write;
use std::process::{Command, Stdio};

/// E by the independent reader.
pub fn read_independently(folder: &Folder, volume: &str, places: &[[f64; 6]]) -> Option<Vec<[f64; 3]>> {
    let mut command = Command::new(python()?);
    command.arg(repository("tests/format_reader.py")).arg(folder.path(volume));
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let queries = csv_of(places);
    let queries = queries.split_once('\n').unwrap().1.to_owned();
    let mut stdin = child.stdin.take().unwrap();
    let writer = std::thread::spawn(move || stdin.write_all(queries.as_bytes()).unwrap());
    let output = child.wait_with_output().unwrap();
    writer.join().unwrap();
    assert!(output.status.success(), "{volume}: the reader refused it");
    let text = String::from_utf8(output.stdout).unwrap();
    let rows: Vec<[f64; 3]> = text
        .lines()
        .map(|line| line.split(',').map(|v| v.parse().unwrap()).collect::<Vec<f64>>().try_into().unwrap())
        .collect();
    assert_eq!(rows.len(), places.len());
    Some(rows)
}

#[test]
fn independent_reader_finds_the_light_that_sample_prints() {
    let folder = Folder::new();
    let mut level = Level::room([-2.0, -1.0, -3.0], [2.0, 2.0, 1.5]);
    level.object(&solid_of([0.1, 0.2, 0.3], [1.0; 3]), 0, serde_json::json!({}));
    level.write(&folder, "room.glb");
    folder.panorama("a.exr", 32, Some([-1.0, 0.0, -2.0]), |d| [1.0 + d.x as f32, 1.5 + d.y as f32, 0.5]);
    folder.panorama("b.exr", 16, Some([-1.0, 0.5, 0.5]), |d| [20.0 + d.z as f32, 1.0, 1.0 + d.x as f32 * 0.5]);
    folder.write("points.csv", "0,0,0\n-1,1,1\n-1.5,1.75,-2.5\n0.5,0.5,0.6\n-0.1,-0.9,0.7\n");
    let mut compared = 0;
    for (name, arguments) in [
        ("grid L2 packed", &["--counts", "5,4,3", "--precision", "packed"][..]),
        ("points L4 packed", &["--nodes", "points:points.csv", "--sh", "L4", "--precision", "packed:0.02"]),
        ("grid L2 f16", &["--counts", "5,4,3", "--precision", "f16"]),
        ("grid L1 f32", &["--counts", "3,3,4", "--sh", "L1", "--precision", "f32"]),
        ("grid, one layer, packed", &["--counts", "3,1,2", "--sh", "L0"]),
        ("sparse grid", &["--counts", "17,13,17", "--tolerance", "0.2", "--precision", "f16"]),
        ("sparse grid, packed", &["--counts", "17,13,17", "--tolerance", "0.2"]),
        ("points L4", &["--nodes", "points:points.csv", "--sh", "L4", "--precision", "f16"]),
        ("vertices", &["--nodes", "vertices", "--precision", "f32"]),
    ] {
        folder.bake(&[&["room.glb", "--probes", "a.exr", "--probes", "b.exr", "--samples", "200"], arguments].concat());
        // We keep what is packed as half floats, the reader as doubles: each of the terms that E is the sum of is off by up to 2^-11.
        let tolerance = if name.contains("packed") { 1.5e-3 } else { 1e-5 };
        // Inside, on nodes, outside; and in every direction. On vertices: their own places and normals.
        let volume = Volume::parse(&folder.read("room.gdibl")).unwrap();
        let mut places: Vec<[f64; 6]> = Vec::new();
        let spots = [[0.1, 0.2, 0.3], [-2.0, -1.0, -3.0], [2.0, 2.0, 1.5], [-1.37, 1.9, 0.77], [9.0, -9.0, 0.1]];
        for ([x, y, z], n) in spots.iter().flat_map(|p| normals().into_iter().map(move |n| (p, n))) {
            places.push([*x, *y, *z, n.x, n.y, n.z]);
        }
        for node in 0..volume.node_count() {
            let (p, n) = (volume.node_position(node), volume.node_normal(node).unwrap_or([0.0, 0.0, 1.0]));
            places.push([p[0], p[1], p[2], n[0].into(), n[1].into(), n[2].into()]);
        }
        let ours = folder.irradiance("room.gdibl", &places);
        let Some(theirs) = read_independently(&folder, "room.gdibl", &places) else { return };
        let rms = (theirs.iter().flatten().map(|e| e * e).sum::<f64>() / (3 * theirs.len()) as f64).sqrt();
        assert!(rms > 1.0, "there is light");
        for ((place, ours), theirs) in places.iter().zip(&ours).zip(&theirs) {
            for (ours, theirs) in ours.iter().zip(theirs) {
                assert!(
                    (ours - theirs).abs() <= tolerance * rms.max(theirs.abs()),
                    "{name}, {place:?}: {ours}, reader {theirs}"
                );
                compared += 1;
            }
        }
    }
    assert!(compared > 1000, "{compared} numbers compared");
}

#[test]
fn independent_reader_finds_the_same_light_beside_walls() {
    let folder = Folder::new();
    let mut level = Level::room([-2.0, -1.0, -3.0], [2.0, 2.0, 1.5]);
    // A wall that ends before the ceiling, and one across it.
    level.object(&solid_of([0.3, -1.0, -3.0], [0.33, 1.4, 1.5]), 0, serde_json::json!({}));
    level.object(&solid_of([-2.0, -1.0, -0.8], [0.3, 2.0, -0.7]), 0, serde_json::json!({}));
    level.write(&folder, "room.glb");
    for (name, at, light) in [("a", [-1.0, 0.0, -2.0], 0.1), ("b", [-1.0, 0.5, 0.5], 9.0), ("c", [1.2, 0.0, 0.0], 2.0)]
    {
        folder.panorama(&format!("{name}.exr"), 16, Some(at), |d| [light, light * (1.0 + 0.3 * d.x as f32), 1.0]);
    }
    let probes = ["a.exr", "b.exr", "c.exr"].iter().flat_map(|name| ["--probes", *name]);
    for (kind, grid) in
        [("grid", &["--counts", "7,5,8"][..]), ("sparse grid", &["--counts", "25,17,25", "--tolerance", "0.3"])]
    {
        let arguments = [&["room.glb", "--samples", "200", "--precision", "f32"], grid].concat();
        folder.bake(&arguments.into_iter().chain(probes.clone()).collect::<Vec<_>>());
        let report = folder.inspect("room.gdibl");
        assert_eq!(report["kind"], kind);
        let walls = &report["statistics"]["walls"];
        assert!(walls["cells"].as_u64() > Some(20) && walls["planes"].as_u64() > Some(1), "{walls}");
        compare_beside_walls(&folder);
    }
}

fn compare_beside_walls(folder: &Folder) {
    let mut places: Vec<[f64; 6]> = Vec::new();
    for (i, n) in (0..40).flat_map(|i| normals().into_iter().map(move |n| (f64::from(i), n))) {
        let spread = |step: f64, low: f64, high: f64| low + (high - low) * (0.5 + i * step).fract();
        places.push([spread(0.819, -2.0, 2.0), spread(0.671, -1.0, 2.0), spread(0.55, -3.0, 1.5), n.x, n.y, n.z]);
        places.push([0.3 + 0.015 * (i % 4.0), spread(0.671, -1.0, 2.0), spread(0.55, -3.0, 1.5), n.x, n.y, n.z]);
    }
    let ours = folder.irradiance("room.gdibl", &places);
    let Some(theirs) = read_independently(folder, "room.gdibl", &places) else { return };
    let rms = (theirs.iter().flatten().map(|e| e * e).sum::<f64>() / (3 * theirs.len()) as f64).sqrt();
    for ((place, ours), theirs) in places.iter().zip(&ours).zip(&theirs) {
        for (ours, theirs) in ours.iter().zip(theirs) {
            assert!((ours - theirs).abs() <= 1e-5 * rms, "{place:?}: {ours}, reader {theirs}");
        }
    }
}
