//! `capture`, a bake that captures, and a bake by path tracing.

use crate::common::{Folder, Level, box_of, solid_of};
use gdibl_baker::import::image::{Imported, ReadOptions, read_image};
use gdibl_baker::panorama::Mapping;
use glam::DVec3;
use serde_json::{Value, json};

/// A grey room with a lamp under its ceiling; `node` are further fields of the room's node.
pub fn lamp_room(extra: impl FnOnce(&mut Level)) -> Folder {
    let folder = Folder::new();
    let mut level = Level::room([-2.0, 0.0, -2.0], [2.0, 3.0, 2.0]);
    level.json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = json!([0.5, 0.5, 0.5, 1.0]);
    let lamp = level.material(json!({
        "pbrMetallicRoughness": { "metallicFactor": 0.0, "baseColorFactor": [0.0, 0.0, 0.0, 1.0] },
        "emissiveFactor": [1.0, 0.5, 0.25]
    }));
    let (a, b, y) = (-0.5, 0.5, 2.9);
    // Facing down.
    level.object(&[[[a, y, a], [b, y, a], [b, y, b]], [[a, y, a], [b, y, b], [a, y, b]]], lamp, json!({}));
    extra(&mut level);
    level.write(&folder, "room.glb");
    folder
}

fn read(folder: &Folder, name: &str) -> Imported {
    read_image(&folder.path(name), &ReadOptions::default()).unwrap()
}

const QUICK: [&str; 4] = ["--width", "32", "--samples", "16"];

#[test]
fn captured_probe_holds_light_distance_and_place() {
    let folder = lamp_room(|_| {});
    let place = ["--position", "0.25,1.25,-0.125"];
    folder.ok(&[&["capture", "room.glb", "-o", "probes"], &place[..], &QUICK].concat());
    let probe = read(&folder, "probes/probe_0.exr");
    assert_eq!((probe.image.width, probe.image.height, probe.mapping), (32, 16, Some(Mapping::LatLong)));
    assert_eq!(probe.pose.position, Some(DVec3::new(0.25, 1.25, -0.125)));
    assert!(probe.findings.is_empty(), "{:?}", probe.findings);
    let distance = probe.image.distance.unwrap();
    // Straight down, and near enough straight up the lamp, which shows its own light.
    assert!((distance[15 * 32] - 1.25).abs() < 0.02 && (distance[0] - 1.65).abs() < 0.02, "{}", distance[0]);
    let up = probe.image.pixels[0];
    assert!(up.iter().zip([1.0, 0.5, 0.25]).all(|(a, b)| (a / b - 1.0f32).abs() < 2e-3), "{up:?}");
    let floor = probe.image.pixels[15 * 32 + 3];
    assert!(floor[0] > 0.01 && floor[0] < 0.5 && (floor[0] / floor[2] - 4.0).abs() < 0.01, "{floor:?}");
    // The same bytes again, on one thread.
    folder.ok(&[&["capture", "room.glb", "-o", "again", "--threads", "1"], &place[..], &QUICK].concat());
    assert_eq!(folder.read("probes/probe_0.exr"), folder.read("again/probe_0.exr"));
}

#[test]
fn captured_probes_bake_and_agree_with_path_tracing() {
    let folder = lamp_room(|_| {});
    folder.ok(&["capture", "room.glb", "-o", "probes", "--auto", "--most", "3", "--width", "128", "--samples", "64"]);
    let grid = ["--bounds=-1.5,0.4,-1.5,1.5,2.4,1.5", "--counts", "3,3,3", "--samples", "16384"];
    let given = folder.bake(&[&["room.glb", "--probes", "probes", "-o", "probes.gdibl"], &grid[..]].concat());
    assert_eq!(given["plan"][1], json!({ "stage": "capture", "kept": false, "why": "probes are given" }));
    let traced =
        folder.bake(&[&["room.glb", "--method", "path", "--seed", "9", "-o", "path.gdibl"], &grid[..]].concat());
    assert_eq!((&traced["nodes_valid"], &traced["coverage"]), (&json!(27), &json!(null)));
    assert_eq!(folder.inspect("path.gdibl")["settings"]["quality.method"], "path");
    folder.bake(&[&["room.glb", "--method", "gdibl", "-o", "captured.gdibl"], &grid[..]].concat());
    // By probes that were captured for it a bake is better: it knows the lamp itself.
    for (volume, bound) in [("probes.gdibl", 0.06), ("captured.gdibl", 0.02)] {
        let run = folder.ok(&["compare", volume, "path.gdibl", "--json"]);
        let found: Value = serde_json::from_str(&run).unwrap();
        let error = found["all"]["relative_rmse"].as_f64().unwrap_or_else(|| panic!("{found}"));
        println!("{volume}: {error}");
        assert!(error > 0.0 && error < bound, "{volume}: {error}");
    }
}

#[test]
fn gdibl_without_a_probe_captures_once_and_writes_the_same_bytes() {
    let folder = lamp_room(|_| {});
    folder.write("BAKE.toml", "level = \"room.glb\"\n[capture]\nwidth = 16\nsamples = 4\nmost = 2\n");
    let bake = |extra: &[&str]| {
        let run = folder.run(
            &[&["bake", "BAKE.toml", "--force", "--method", "gdibl", "--counts", "2,2,2", "--samples", "64"], extra]
                .concat(),
        );
        assert_eq!(run.code, 0, "{}", run.err);
        (folder.read("BAKE.gdibl"), run.err)
    };
    let (first, said) = bake(&[]);
    assert!(said.contains("captured 2 probes from the level"), "{said}");
    // Their places, and each of them.
    let entries = folder.cached();
    assert_eq!(entries.len(), 3);
    let (second, said) = bake(&[]);
    assert!(!said.contains("captured"), "{said}");
    assert_eq!(first, second);
    assert_eq!(folder.cached(), entries);
    // One that is gone, damaged or cut off is captured anew, and gives the same bytes.
    let probe = entries.iter().find(|path| path.to_string_lossy().contains("-1.")).unwrap();
    let whole = std::fs::read(probe).unwrap();
    let mut damaged = whole.clone();
    damaged[100] ^= 1;
    for (bytes, word) in
        [(None, ""), (Some(&damaged[..]), "damaged"), (Some(&whole[..50]), "damaged"), (Some(&[]), "damaged")]
    {
        match bytes {
            None => std::fs::remove_file(probe).unwrap(),
            Some(bytes) => std::fs::write(probe, bytes).unwrap(),
        }
        let (again, said) = bake(&[]);
        assert!(said.contains("captured 2") && said.contains(word), "{said}");
        assert!(again == first && std::fs::read(probe).unwrap() == whole);
    }
    // A cache that cannot be written costs time alone.
    let (again, said) = bake(&["--cache", "room.glb/cache"]);
    assert!(again == first && said.contains("nothing is kept for the next time"), "{said}");
    // Another seed, or another level, is captured anew.
    let (_, said) = bake(&["--seed", "1"]);
    assert!(said.contains("captured 2"), "{said}");
    assert_eq!(folder.cached().len(), 6);
    let other = lamp_room(|level| {
        level.object(&solid_of([1.0, 0.0, 1.0], [1.5, 1.0, 1.5]), 0, json!({}));
    });
    folder.write("room.glb", other.read("room.glb"));
    let (_, said) = bake(&[]);
    assert!(said.contains("captured 2"), "{said}");
    assert_eq!(folder.cached().len(), 9);
    // Forbidden, nothing is covered.
    let run =
        folder.run(&["bake", "BAKE.toml", "--method", "gdibl", "--no-capture", "--counts", "2,2,2", "--samples", "64"]);
    assert_eq!(run.code, 5, "{}", run.err);
}

#[test]
fn marked_probes_are_captured_where_the_level_names_them() {
    let folder = lamp_room(|level| {
        level.node(json!({ "translation": [0.5, 1.0, 0.5], "extras": { "gdibl_probe": "light/middle.exr" } }));
    });
    folder.write("light/keep.txt", "");
    folder.ok(&[&["capture", "room.glb"][..], &QUICK].concat());
    assert_eq!(read(&folder, "light/middle.exr").pose.position, Some(DVec3::new(0.5, 1.0, 0.5)));
    // And a bake finds it there.
    let report = folder.bake(&["room.glb", "--counts", "2,2,2", "--samples", "64"]);
    assert_eq!((&report["plan"][0]["stage"], &report["plan"][1]["kept"]), (&json!("method"), &json!(false)));
    assert!(report["coverage"].as_f64().unwrap() > 0.99, "{report}");
    assert_eq!(folder.inspect("room.gdibl")["probes"][0]["name"], "middle.exr");
}

#[test]
fn other_layouts_come_back_as_they_went() {
    let folder = lamp_room(|_| {});
    let place = ["--position", "0,1.5,0"];
    for (mapping, kind, size) in [
        ("angular", Mapping::AngularMap, (32, 32)),
        ("cube-exr", Mapping::CubeExr, (8, 48)),
        ("lat-long", Mapping::LatLong, (32, 16)),
    ] {
        folder.ok(&[&["capture", "room.glb", "-o", mapping, "--mapping", mapping], &place[..], &QUICK].concat());
        let probe = read(&folder, &format!("{mapping}/probe_0.exr"));
        assert_eq!((probe.mapping, (probe.image.width, probe.image.height)), (Some(kind), size), "{mapping}");
        let report = folder.bake(&["room.glb", "--probes", mapping, "--counts", "2,2,2", "--samples", "256"]);
        assert!(report["coverage"].as_f64().unwrap() > 0.98, "{mapping}: {report}");
    }
}

#[test]
fn capture_says_what_it_lacks() {
    let folder = lamp_room(|_| {});
    let refused = |arguments: &[&str], code: i32, needle: &str| {
        let run = folder.run(&[&["capture"], arguments].concat());
        assert_eq!(run.code, code, "{arguments:?}: {}", run.err);
        assert!(run.err.contains(needle), "{arguments:?}: {}", run.err);
    };
    refused(&["room.glb"], 2, "--position");
    refused(&["room.glb", "--position", "1,2"], 2, "x,y,z");
    refused(&["room.glb", "--auto", "--width", "7"], 2, "--width 7");
    refused(&["room.glb", "--auto", "--samples", "0"], 2, "--samples 0");
    refused(&["none.glb", "--auto"], 3, "none.glb");
    Level::room([-1.0; 3], [1.0; 3]).write(&folder, "dark.glb");
    refused(&["dark.glb", "--auto"], 5, "nothing gives light");
    // A target that cannot be met is said after the probes are written.
    let hard =
        ["room.glb", "-o", "hard", "--position", "0,1,0", "--width", "8", "--samples", "32", "--target-error", "1e-9"];
    refused(&hard, 5, "missed the target error");
    assert!(folder.exists("hard/probe_0.exr"));
}

#[test]
fn level_without_a_place_for_a_probe_bakes_with_what_is_given() {
    let folder = Folder::new();
    let mut level = Level::new();
    level.object(&solid_of([-1.0; 3], [1.0; 3]), 0, json!({}));
    level.write(&folder, "block.glb");
    folder.sky("sky.exr", [2.0; 3]);
    let grid = ["--bounds=-2,-2,-2,2,2,2", "--counts", "3,3,3", "--samples", "64"];
    let report = folder.bake(&[&["block.glb", "--distant", "sky.exr"], &grid[..]].concat());
    assert_eq!((&report["nodes_valid"], &report["plan"][1]["kept"]), (&json!(26), &json!(false)), "{report}");
    assert_eq!(folder.names(), ["block.gdibl", "block.glb", "sky.exr"]);
}

#[test]
fn metals_and_clamped_light_are_told() {
    let folder = lamp_room(|level| {
        let gold = level.material(json!({ "pbrMetallicRoughness": { "baseColorFactor": [1.0, 0.8, 0.2, 1.0] } }));
        level.object(&box_of([1.0, 0.1, 1.0], [1.5, 0.6, 1.5]), gold, json!({}));
    });
    let arguments = ["room.glb", "--method", "path", "--counts", "2,2,2", "--samples", "256", "--clamp", "0.3"];
    let report = folder.bake(&arguments);
    let finding = |id: &str| {
        let findings = report["findings"].as_array().unwrap();
        findings.iter().find(|f| f["id"] == id).unwrap_or_else(|| panic!("{id} in {findings:?}"))["message"].to_string()
    };
    assert!(finding("specular-left-out").contains("in 1 materials"), "{}", finding("specular-left-out"));
    assert!(finding("clamped-light").contains("--clamp 0.3"), "{}", finding("clamped-light"));
}
