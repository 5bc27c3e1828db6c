//! Every setting is in the record of a file, by its name in BAKE.toml.

use crate::common::{Folder, Level};
use gdibl_baker::job::{ROWS, Row};
use serde_json::Value;

/// Another value than the default for a setting, as a flag gives it; the flags that it needs beside it.
fn other(row: &Row) -> (&'static str, &'static [&'static str]) {
    match row.name {
        "nodes" => ("points:points.csv", &[]),
        "bounds" => ("-1,-1,-1,1,1,0.5", &[]),
        "spacing" => ("1.5", &[]),
        "counts" => ("3,2,2", &[]),
        "max_nodes" => ("8", &[]),
        "max_bytes" => ("5000", &[]),
        "tolerance" => ("0.5", &[]),
        "samples" if row.section == "quality" => ("32", &[]),
        "target_error" if row.section == "quality" => ("0.5", &[]),
        "seen_places" => ("3", &[]),
        "max_seen_error" => ("1000", &[]),
        "seed" => ("7", &[]),
        "sampler" => ("random", &[]),
        "method" => ("path", &[]),
        "bounces" => ("2", &[]),
        "punctual" => ("include", &[]),
        "sun" => ("extract", &[]),
        "clamp" => ("3", &[]),
        "scene" => ("occlude", &[]),
        "sh" => ("L1", &[]),
        "precision" => ("f32", &[]),
        "zstd" | "coefficient_errors" | "dering" | "repair_pixels" | "match_exposure" | "record_times" => ("true", &[]),
        "unseen" => ("fill", &[]),
        "metals" => ("black", &[]),
        "lumens_per_watt" => ("683", &[]),
        "allow_missing_textures" => ("true", &[]),
        "blend" => ("nearest", &[]),
        // Those of captures are in BAKE.toml.
        "auto" => ("true", &[]),
        "positions" => ("[[0.5, 0.5, 0.5]]", &[]),
        "most" => ("3", &[]),
        "width" => ("16", &[]),
        "samples" => ("3", &[]),
        "target_error" => ("0.25", &[]),
        name => panic!("{name} is new: give another value for it here"),
    }
}

#[test]
fn a_file_says_every_setting_and_two_bakes_that_differ_in_one_differ_in_that_one() {
    let folder = Folder::new();
    let level = Level::room([-2.0; 3], [2.0; 3]);
    level.write(&folder, "room.glb");
    folder.constant("a.exr", [0.0; 3], [1.0; 3]);
    folder.sky("sky.exr", [1.0; 3]);
    folder.write("points.csv", "0,0,0\n");
    let settings = |toml: &str, flags: &[String]| -> Value {
        folder.write("BAKE.toml", format!("level = \"room.glb\"\ndistant = \"sky.exr\"\nprobes = [\"a.exr\"]\n{toml}"));
        let base = ["bake", "BAKE.toml", "--samples", "64", "-o", "x.gdibl"];
        let own = flags.iter().map(String::as_str);
        // A flag that is given twice is a usage error: one that is tried replaces the base's.
        let base = base.into_iter().take(if flags.iter().any(|flag| flag.starts_with("--samples")) { 2 } else { 4 });
        let arguments: Vec<&str> = base.chain(["-o", "x.gdibl"]).chain(own).collect();
        folder.ok(&arguments);
        folder.inspect("x.gdibl")["settings"].clone()
    };
    let grid = "[grid]\nbounds = [-1, -1, -1, 1, 1, 1]\nspacing = 1.0\n";
    let base = settings(grid, &[]);
    for row in ROWS.iter().filter(|row| row.is_recorded) {
        let name = row.full_name();
        assert!(base.get(&name).is_some(), "{name} in {base}");
        let (value, more) = other(row);
        let mut flags: Vec<String> = more.iter().map(ToString::to_string).collect();
        let toml = match (row.section, row.name) {
            ("capture", _) => format!("{grid}[capture]\n{} = {value}\n", row.name),
            // Points have no box.
            (_, "nodes") => String::new(),
            _ => grid.to_owned(),
        };
        if row.section != "capture" {
            flags.push(format!("--{}={value}", row.flag()));
        }
        let found = settings(&toml, &flags);
        let differing: Vec<&String> = found
            .as_object()
            .unwrap()
            .iter()
            .filter(|(key, value)| base[key.as_str()] != **value)
            .map(|(key, _)| key)
            // Only a grid has a box.
            .filter(|key| !(row.name == "nodes" && key.starts_with("grid.b")))
            // Counts and bounds of nodes and bytes stand in for a spacing.
            .filter(|key| {
                !(matches!(row.name, "nodes" | "counts" | "max_nodes" | "max_bytes") && *key == "grid.spacing")
            })
            .collect();
        assert_eq!(differing, [&name], "{value}: {found}");
    }
}

#[test]
fn what_the_machine_may_use_is_not_recorded_and_changes_nothing() {
    let folder = Folder::new();
    Level::room([-2.0; 3], [2.0; 3]).write(&folder, "room.glb");
    folder.constant("a.exr", [0.0; 3], [1.0; 3]);
    let bake = |flags: &[&str]| {
        let common = ["room.glb", "--force", "--probes", "a.exr", "--counts", "2,2,2", "--samples", "64"];
        folder.bake(&[&common[..], flags].concat());
        folder.read("room.gdibl")
    };
    let unrecorded: Vec<&str> = ROWS.iter().filter(|row| !row.is_recorded).map(|row| row.name).collect();
    assert_eq!(unrecorded, ["budget", "threads", "max_memory"]);
    assert!(bake(&[]) == bake(&["--threads", "1", "--max-memory", "4"]));
}

#[test]
fn times_are_stored_only_if_asked_for() {
    let folder = Folder::new();
    Level::room([-2.0; 3], [2.0; 3]).write(&folder, "room.glb");
    folder.constant("a.exr", [0.0; 3], [1.0; 3]);
    let stages = |flags: &[&str]| {
        let common = ["room.glb", "--probes", "a.exr", "--counts", "2,2,2", "--samples", "64"];
        let report = folder.bake(&[&common[..], flags].concat());
        let told = report["stages"].as_array().unwrap().clone();
        assert!(told.iter().all(|stage| stage["seconds"]["wall"].as_f64().unwrap() >= 0.0), "{report}");
        let names: Vec<&str> = told.iter().map(|stage| stage["stage"].as_str().unwrap()).collect();
        assert_eq!(names, ["read", "prepare", "nodes", "seen", "pack"]);
        folder.inspect("room.gdibl")["statistics"]["stages"].as_array().unwrap().clone()
    };
    assert!(stages(&[]).iter().all(|stage| stage["seconds"].is_null()));
    let stored = stages(&["--record-times"]);
    assert!(stored.len() >= 3 && stored.iter().all(|stage| stage["seconds"]["cpu"].is_number()), "{stored:?}");
}

#[test]
fn inputs_are_recorded_with_size_and_hash() {
    let folder = Folder::new();
    Level::room([-2.0; 3], [2.0; 3]).write(&folder, "room.glb");
    folder.constant("a.exr", [0.0; 3], [1.0; 3]);
    folder.sky("sky.exr", [1.0; 3]);
    folder.bake(&["room.glb", "--probes", "a.exr", "--distant", "sky.exr", "--counts", "2,2,2", "--samples", "64"]);
    let inputs = folder.inspect("room.gdibl")["inputs"].as_array().unwrap().clone();
    let rows: Vec<(&str, &str)> =
        inputs.iter().map(|row| (row["role"].as_str().unwrap(), row["name"].as_str().unwrap())).collect();
    assert_eq!(rows, [("level", "room.glb"), ("distant", "sky.exr"), ("probe", "a.exr")]);
    for row in &inputs {
        let bytes = folder.read(row["name"].as_str().unwrap());
        assert_eq!(row["bytes"], bytes.len());
        assert_eq!(row["blake3"], blake3::hash(&bytes).to_hex().to_string());
    }
}
