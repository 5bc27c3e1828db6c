//! What `bake`, `sample` and `inspect` promise: the same bytes, the same numbers, the promised keys.

use crate::common::{Folder, Level, csv_of, solid_of};
use gdibl_runtime::{Volume, sh};
use serde_json::{Value, json};

/// A room with two coloured probes: no two nodes are alike.
fn coloured_room() -> Folder {
    let folder = Folder::new();
    Level::room([-2.0, -1.0, -3.0], [2.0, 2.0, 1.5]).write(&folder, "room.glb");
    folder.panorama("a.exr", 512, Some([-1.0, 0.0, -2.0]), |d| [1.0 + d.x as f32, 1.5 + d.y as f32, 0.5]);
    folder.panorama("b.exr", 512, Some([1.0, 0.5, 0.5]), |d| [2.0 + d.z as f32, 1.0, 1.0 + d.x as f32 * 0.5]);
    folder
}

const PROBES: [&str; 5] = ["room.glb", "--probes", "a.exr", "--probes", "b.exr"];
/// Two that show unlike light have a systematic error.
const ONE: [&str; 3] = ["room.glb", "--probes", "a.exr"];
/// Nodes on the walls themselves see the outside.
const INSIDE: [&str; 2] = ["--bounds", "-1.5,-0.5,-2.5,1.5,1.5,1"];

fn volume_of(folder: &Folder, name: &str) -> Volume {
    Volume::parse(&folder.read(name)).expect("a volume")
}

#[test]
fn bytes_depend_neither_on_threads_nor_on_the_run_but_on_the_seed() {
    let folder = coloured_room();
    let bake = |output: &str, more: &[&str]| {
        let common = ["--counts", "5,3,4", "--samples", "300", "-o", output, "--quiet"];
        folder.ok(&[&["bake"], &PROBES[..], &common, more].concat());
        folder.read(output)
    };
    let one = bake("1.gdibl", &["--threads", "1"]);
    for (run, threads) in ["1", "2", "7"].iter().enumerate() {
        assert!(one == bake(&format!("again{run}.gdibl"), &["--threads", threads]), "{threads} threads");
    }
    let seeded = |seed| Volume::parse(&bake("seed.gdibl", &["--seed", seed])).unwrap().node_sh(7).coefficients;
    assert_ne!(seeded("1"), Volume::parse(&one).unwrap().node_sh(7).coefficients);
    assert_ne!(seeded("1"), seeded("2"));
}

/// `sample --sh` at the nodes against the coefficients in the file.
fn assert_sampled_as_baked(folder: &Folder, name: &str) {
    let volume = volume_of(folder, name);
    assert!(volume.node_count() > 0);
    let places: Vec<[f64; 3]> = (0..volume.node_count()).map(|node| volume.node_position(node)).collect();
    let sampled = folder.coefficients(name, &places);
    let count = sh::coefficient_count(volume.header().bands);
    for (node, row) in sampled.iter().enumerate() {
        assert_eq!(row.len(), 3 * count + 1, "coefficients and validity");
        let stored = volume.node_sh(node).coefficients;
        for (found, expected) in row.iter().zip(stored[..count].iter().flatten()) {
            // A trilinear weight may be an ulp from 1.
            assert!((found - f64::from(*expected)).abs() < 1e-5, "node {node}: {found} for {expected}");
        }
        assert_eq!(row[3 * count], 1.0);
    }
    assert_ne!(sampled[0], sampled[1], "nodes differ");
}

#[test]
fn sample_returns_at_grid_nodes_what_was_baked() {
    let folder = coloured_room();
    folder.bake(&[&PROBES[..], &["--spacing", "1.6", "--samples", "256", "--sh", "L3", "--precision", "f32"]].concat());
    assert_eq!(folder.inspect("room.gdibl")["grid"]["counts"], json!([4, 3, 4]), "spacing shrinks to fit");
    assert_sampled_as_baked(&folder, "room.gdibl");
}

#[test]
fn sample_returns_at_points_what_was_baked_there() {
    let folder = coloured_room();
    let points = [[0.0, 0.0, 0.0], [1.25, 1.5, -2.0], [-1.75, -0.5, 1.0], [0.3, 0.1, 0.2]];
    folder.write("points.csv", csv_of(&points));
    folder.bake(&[&PROBES[..], &["--nodes", "points:points.csv", "--samples", "256", "--sh", "L4"]].concat());
    let volume = volume_of(&folder, "room.gdibl");
    for (node, point) in points.iter().enumerate() {
        let found = volume.node_position(node);
        assert!((0..3).all(|axis| (found[axis] - point[axis]).abs() < 1e-6), "in the file's order: {found:?}");
    }
    assert_sampled_as_baked(&folder, "room.gdibl");
    // Anywhere else the nearest point answers.
    let near = folder.coefficients("room.gdibl", &[[1.2, 1.4, -1.9], points[1]]);
    assert_eq!(near[0], near[1]);
}

#[test]
fn vertex_sets_follow_the_meshes_and_each_corner_keeps_its_own_side() {
    let folder = coloured_room();
    let mut level = Level::room([-2.0, -1.0, -3.0], [2.0, 2.0, 1.5]);
    level.scene_object(&solid_of([0.2; 3], [0.4; 3]), 0);
    level.write(&folder, "room.glb");
    let report = folder.bake(&[&PROBES[..], &["--nodes", "vertices", "--samples", "1024"]].concat());
    assert_eq!(report["nodes"], 72, "two boxes of 36 corners");
    let volume = volume_of(&folder, "room.gdibl");
    assert_eq!(volume.vertex_sets().len(), 2);
    for (node, mesh) in [(0, 0), (1, 1)] {
        assert_eq!(volume.vertex_set(node, mesh, 0).map(|set| set.len()), Some(36));
    }
    // Three faces meet in a corner: sample tells them apart by normal.
    let places: Vec<[f64; 6]> = (0..36)
        .map(|node| {
            let (p, n) = (volume.node_position(node), volume.node_normal(node).unwrap().map(f64::from));
            [p[0], p[1], p[2], n[0], n[1], n[2]]
        })
        .collect();
    let found = folder.irradiance("room.gdibl", &places);
    for (node, row) in found.iter().enumerate() {
        // Two triangles of a face share a corner with one place and normal; either may answer.
        let same_side = (0..36).filter(|&other| places[other] == places[node]);
        let matches = same_side.filter(|&other| {
            let own = volume.node_sh(other).convolve().evaluate(volume.node_normal(node).unwrap());
            row.iter().zip(own).all(|(e, own)| (e - f64::from(own)).abs() < 1e-5)
        });
        assert_eq!(matches.count(), 1, "vertex {node}: {row:?}");
    }
}

#[test]
fn vertices_of_a_closed_room_see_nothing_of_the_sky() {
    // Corners lie exactly in the planes of the neighbouring walls: rays from there left the room.
    let folder = Folder::new();
    Level::room([-2.0, -1.0, -3.0], [2.0, 2.0, 1.5]).write(&folder, "room.glb");
    folder.sky("sky.exr", [1e4; 3]);
    folder.constant("dark.exr", [0.3, 0.4, 0.5], [0.0; 3]);
    let arguments = ["room.glb", "--distant", "sky.exr", "--probes", "dark.exr", "--nodes", "vertices"];
    let report = folder.bake(&arguments);
    assert_eq!(report["nodes_valid"], 36);
    assert!(report["coverage"].as_f64().unwrap() > 0.9, "{}", report["coverage"]);
    let volume = volume_of(&folder, "room.gdibl");
    for node in 0..36 {
        assert!(volume.node_sh(node).coefficients.iter().flatten().all(|c| *c == 0.0), "vertex {node}");
    }
}

#[test]
fn bake_json_has_the_promised_keys_with_plausible_values() {
    let folder = coloured_room();
    let report =
        folder.bake(&[&PROBES[..], &INSIDE, &["--counts", "2,2,2", "--samples", "512", "--seed", "9"]].concat());
    assert_eq!(report["nodes"], 8);
    assert_eq!(report["nodes_valid"], 8);
    assert_eq!(report["sh"], "L2");
    assert_eq!(report["seed"], 9);
    assert_eq!(report["bytes"], folder.read("room.gdibl").len());
    // Every direction is a ray; both probes see all of the room, so no line of sight is.
    let rays = report["rays"].as_u64().unwrap();
    assert!((8 * 512..2 * 8 * 512).contains(&rays), "{rays}");
    assert!(report["wall_seconds"].as_f64().unwrap() > 0.0);
    assert!(report["cpu_seconds"].as_f64().unwrap() > 0.0);
    assert!(report["coverage"].as_f64().unwrap() > 0.999, "{report}");
    let error = |key: &str| report["relative_error"][key].as_f64().unwrap();
    assert!(0.0 < error("median") && error("median") <= error("p95") && error("p95") <= error("max"));
    assert!(error("max") < 0.05, "{}", error("max"));
    let plan = report["plan"].as_array().unwrap();
    assert!(!plan.is_empty());
    for row in plan {
        assert!(row["stage"].is_string() && row["kept"].is_boolean() && row["why"].is_string(), "{row}");
    }
}

#[test]
fn inspect_json_tells_what_is_in_the_file() {
    let folder = coloured_room();
    folder.bake(&[&PROBES[..], &["--counts", "2,3,2", "--samples", "64", "--blend", "distance:2", "--zstd"]].concat());
    let found = folder.inspect("room.gdibl");
    assert_eq!(found["kind"], "grid");
    assert_eq!(found["version"], 1);
    assert_eq!(found["grid"]["counts"], json!([2, 3, 2]));
    assert_eq!(found["min"], json!([-2.0, -1.0, -3.0]));
    assert_eq!(found["max"], json!([2.0, 2.0, 1.5]));
    assert_eq!((&found["sh"], &found["precision"]), (&json!("L2"), &json!("packed")));
    assert_eq!(found["settings"]["quality.samples"], 64);
    assert_eq!(found["settings"]["quality.blend"], "distance:2");
    assert_eq!(found["inputs"][0]["name"], "room.glb");
    let names: Vec<&Value> = found["probes"].as_array().unwrap().iter().map(|probe| &probe["name"]).collect();
    assert_eq!(names, ["a.exr", "b.exr"]);
    assert_eq!(found["statistics"]["nodes"], 12);
    assert_eq!(found["volume"]["nodes"], 12);
    assert!(found["sections"].as_array().unwrap().iter().any(|s| s["id"] == "RSH"), "{}", found["sections"]);
    // For people: the same, in lines.
    let text = folder.ok(&["inspect", "room.gdibl"]);
    for word in ["grid of 2 x 3 x 2", "a.exr", "distance:2"] {
        assert!(text.contains(word), "{word} in\n{text}");
    }
}

#[test]
fn compressed_file_holds_the_same_light() {
    let folder = coloured_room();
    let common = ["--counts", "3,3,3", "--samples", "64", "-o"];
    folder.bake(&[&PROBES[..], &common, &["plain.gdibl"]].concat());
    folder.bake(&[&PROBES[..], &common, &["small.gdibl", "--zstd"]].concat());
    let (plain, small) = (volume_of(&folder, "plain.gdibl"), volume_of(&folder, "small.gdibl"));
    for node in 0..27 {
        assert_eq!(plain.node_sh(node), small.node_sh(node));
    }
    assert!(folder.read("small.gdibl").len() < folder.read("plain.gdibl").len());
}

#[test]
fn target_error_stops_before_the_cap_and_is_met() {
    let folder = coloured_room();
    let grid = ["--counts", "3,2,2"];
    let report = folder.bake(&[&ONE[..], &grid, &["--target-error", "0.02"]].concat());
    let samples = report["samples"].as_u64().unwrap();
    assert!((12 * 256..12 * 4096).contains(&samples), "{samples} of at most {}", 12 * 65_536);
    assert!(report["relative_error"]["max"].as_f64().unwrap() <= 0.02);
    // A tighter target takes more.
    let tighter = folder.bake(&[&ONE[..], &grid, &["--target-error", "0.002"]].concat());
    assert!(tighter["samples"].as_u64().unwrap() > samples);
    assert!(tighter["relative_error"]["max"].as_f64().unwrap() <= 0.002);
}

#[test]
fn target_error_out_of_reach_ends_with_5_and_writes_the_volume() {
    let folder = coloured_room();
    let arguments = ["--counts", "2,2,2", "--target-error", "1e-6", "--samples", "512"];
    let run = folder.run(&[&["bake"], &PROBES[..], &arguments].concat());
    assert_eq!(run.code, 5, "{}", run.err);
    assert!(run.err.contains("8 of 8 nodes missed the target error of 0.0001 %"), "{}", run.err);
    assert_eq!(folder.inspect("room.gdibl")["statistics"]["samples"], 8 * 512);
}

#[test]
fn an_error_between_nodes_over_what_is_allowed_ends_with_5_and_writes_the_volume() {
    let folder = coloured_room();
    let bake = |more: &[&str]| {
        folder.run(&[&["bake"], &PROBES[..], &["--counts", "4,4,4", "--samples", "256"], more].concat())
    };
    let run = bake(&["--max-seen-error", "0.0001"]);
    assert_eq!(run.code, 5, "{}", run.err);
    assert!(run.err.contains("--max-seen-error allows 0.01 %") && run.err.contains("in the air"), "{}", run.err);
    assert!(run.err.contains("most of it is"), "{}", run.err);
    let seen = &folder.inspect("room.gdibl")["statistics"]["seen"];
    let said =
        seen["air"]["error"]["p95"].as_f64().unwrap().max(seen["surfaces"]["error"]["p95"].as_f64().unwrap_or(0.0));
    assert!(run.err.contains(&format!("{:.1} %", 100.0 * said)), "{said}: {}", run.err);
    // What it came to is allowed.
    let run = bake(&["--max-seen-error", &format!("{}", said + 1e-6)]);
    assert_eq!(run.code, 0, "{}", run.err);
    let run = bake(&["--max-seen-error", "0.5", "--seen-places", "0"]);
    assert_eq!(run.code, 5, "nothing was measured: {}", run.err);
}

#[test]
fn with_a_tolerance_nodes_are_left_out_and_the_error_between_them_is_told() {
    let folder = coloured_room();
    let sparse = ["--counts", "25,17,17", "--samples", "512", "--tolerance", "0.05"];
    let report = folder.bake(&[&PROBES[..], &sparse].concat());
    let found = &report["sparse"];
    assert_eq!(found["places"], 25 * 17 * 17);
    assert!(report["nodes"].as_u64() < Some(25 * 17 * 17 / 2), "{report}");
    let middles = &found["levels"][1];
    assert!(middles["checked"].as_u64() > Some(10) && middles["error"]["median"].as_f64() < Some(0.05), "{found}");
    let inspected = folder.inspect("room.gdibl");
    assert_eq!(inspected["kind"], "sparse grid");
    assert_eq!(inspected["grid"]["counts"], serde_json::json!([25, 17, 17]));
    assert_eq!(inspected["statistics"]["sparse"], *found);
    let row = inspected["plan"].as_array().unwrap().iter().find(|row| row["stage"] == "sparse").unwrap().clone();
    assert_eq!(row["kept"], true);
    // Dense, it is larger, and says the same about light.
    let fewer = folder.read("room.gdibl").len();
    folder.bake(&[&PROBES[..], &["-o", "dense.gdibl"], &sparse[..4]].concat());
    assert!(folder.read("dense.gdibl").len() > 2 * fewer);
    let comparison = folder.ok(&["compare", "room.gdibl", "dense.gdibl", "--json"]);
    let comparison: Value = serde_json::from_str(&comparison).unwrap();
    assert!(comparison["all"]["per_node"]["p95"].as_f64() < Some(0.1), "{comparison}");
    // And nothing about a level that changes nowhere.
    folder.write("empty.gltf", r#"{"asset": {"version": "2.0"}}"#);
    folder.panorama("sky.exr", 16, None, |_| [1.0, 2.0, 3.0]);
    let even =
        ["empty.gltf", "--distant", "sky.exr", "--bounds=0,0,0,9,9,9", "--counts", "9,9,9", "--tolerance", "0.01"];
    let report = folder.bake(&even);
    assert_eq!((&report["nodes"], &report["sparse"]["places"]), (&1.into(), &729.into()));
    for wrong in [&["--tolerance", "0"][..], &["--tolerance", "nan"], &["--tolerance", "0.1", "--nodes", "vertices"]] {
        assert_eq!(folder.run(&[&["bake"], &PROBES[..], wrong].concat()).code, 2, "{wrong:?}");
    }
}

#[test]
fn bands_that_light_does_not_need_are_left_out() {
    let folder = coloured_room();
    let auto = |arguments: &[&str]| {
        folder.bake(
            &[arguments, &["--counts", "3,3,3", "--samples", "256", "--precision", "f32", "--sh", "auto"]].concat(),
        )
    };
    let report = auto(&PROBES);
    let lost = |report: &Value, bands: usize| report["truncation"][bands]["error"]["p95"].as_f64().unwrap();
    // The first that loses no more than 10 %.
    let fewest = (0..3).find(|bands| lost(&report, *bands) <= 0.1).map_or(4, |bands| [0, 1, 2][bands]);
    assert_eq!(report["sh"], format!("L{fewest}"), "{report}");
    assert!(lost(&report, 0) > lost(&report, 1) && lost(&report, 1) > lost(&report, 2));
    let row = report["plan"].as_array().unwrap().iter().find(|row| row["stage"] == "bands").unwrap();
    assert!(row["kept"] == false && row["why"].as_str().unwrap().contains("L2"), "{row}");
    // The light is what a bake of as many bands finds, but for noise.
    let place = [[0.2, 0.1, -0.3, 0.0, 1.0, 0.0]];
    let found = folder.irradiance("room.gdibl", &place);
    let bands = format!("L{fewest}");
    folder.bake(
        &[&PROBES[..], &["--counts", "3,3,3", "--samples", "256", "--precision", "f32", "--sh", &bands]].concat(),
    );
    let expected = folder.irradiance("room.gdibl", &place);
    let is_same = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-2 * b;
    assert!(found[0].iter().zip(&expected[0]).all(is_same), "{found:?} {expected:?}");
    // In a fog band 0 is all there is.
    folder.write("empty.gltf", r#"{"asset": {"version": "2.0"}}"#);
    folder.panorama("fog.exr", 16, None, |_| [1.0, 2.0, 3.0]);
    let report = auto(&["empty.gltf", "--distant", "fog.exr", "--bounds=0,0,0,9,9,9"]);
    assert_eq!(report["sh"], "L0");
    assert_eq!(folder.run(&["bake", "room.glb", "--sh", "L5"]).code, 2);
}

#[test]
fn plan_is_printed_and_nothing_is_written() {
    let folder = coloured_room();
    let before = folder.names();
    let text = folder.ok(&[&["bake"], &PROBES[..], &["--plan"]].concat());
    for stage in [
        "textures",
        "environment",
        "lines-of-sight",
        "blending",
        "surface-light",
        "unseen",
        "distant",
        "recursion",
        "transparency",
    ] {
        assert!(text.lines().any(|line| line.starts_with(stage)), "{stage} in\n{text}");
    }
    assert_eq!(folder.names(), before);
    let one_node = ["--counts", "1,1,1"];
    let rows = folder.ok(&[&["bake"], &PROBES[..], &one_node, &["--plan", "--json"]].concat());
    let report: Value = serde_json::from_str(&rows).unwrap();
    assert!(
        report["likely_seconds"].as_f64().unwrap() > 0.0 && text.lines().last().unwrap().starts_with("time"),
        "{text}"
    );
    let rows = &report["plan"];
    let kept = |stage: &str| {
        let row = rows.as_array().unwrap().iter().find(|row| row["stage"] == stage);
        row.unwrap_or_else(|| panic!("{stage}"))["kept"].as_bool().unwrap()
    };
    assert!(kept("environment") && kept("blending") && !kept("recursion") && !kept("textures"));
    assert!(!kept("lines-of-sight"));
    // The plan that was stored is the plan that was printed: of as many nodes, because it pays to remember light for many.
    folder.bake(&[&PROBES[..], &one_node].concat());
    assert_eq!(&folder.inspect("room.gdibl")["plan"], rows);
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_device_is_an_error_of_the_system_and_is_not_read() {
    let folder = coloured_room();
    let run =
        folder.run(&[&["bake"], &PROBES[..], &["--counts", "2,2,2", "--samples", "16", "-o", "/dev/full"]].concat());
    assert_eq!(run.code, 1, "{}", run.err);
    assert!(run.err.contains("/dev/full: No space left on device"), "{}", run.err);
}

#[test]
fn one_sample_bakes_without_a_standard_error() {
    let folder = coloured_room();
    let report = folder.bake(&[&PROBES[..], &INSIDE, &["--counts", "2,2,2", "--samples", "1"]].concat());
    assert_eq!(report["relative_error"], Value::Null);
    assert_eq!(report["nodes_valid"], 8);
    assert!(folder.inspect("room.gdibl")["volume"]["relative_error"].is_null());
}
