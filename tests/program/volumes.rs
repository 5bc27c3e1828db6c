//! Several volumes of a level: boxes on glTF nodes, a file for each, and their list.

use crate::common::{Folder, Level, normals, solid_of};
use gdibl_runtime::{Volume, VolumeSet};
use serde_json::{Value, json};

const SKY: [&str; 4] = ["--distant", "1,0.5,0.25", "--samples", "64"];
const LIST: &str = "level.volumes.json";

/// A box with half edges `half` around `middle`.
fn marker(name: &str, middle: [f64; 3], half: [f64; 3], extras: Value) -> Value {
    json!({ "name": name, "translation": middle, "scale": half, "extras": extras })
}

/// A hall of 8 m, open to the sky, with a block in it, and a level with these markers in it.
fn level(markers: &[Value]) -> Level {
    let mut level = Level::new();
    let mut triangles = solid_of([-4.0, -0.5, -4.0], [4.0, 0.0, 4.0]);
    triangles.extend(solid_of([-1.0, 0.0, -1.0], [1.0, 1.5, 1.0]));
    level.object(&triangles, 0, json!({}));
    markers.iter().for_each(|marker| {
        level.node(marker.clone());
    });
    level
}

fn hall() -> Value {
    marker("hall", [0.0, 1.5, 0.0], [4.0, 1.5, 4.0], json!({ "gdibl_volume": 1.0 }))
}

fn corner() -> Value {
    let extras = json!({ "gdibl_volume": 0.5, "gdibl_sh": "L1", "gdibl_samples": 128.0, "gdibl_zstd": true });
    marker("Corner", [2.5, 1.0, 2.5], [1.5, 1.0, 1.5], extras)
}

/// A folder in which both were baked.
fn baked() -> Folder {
    let folder = Folder::new();
    level(&[hall(), corner()]).write(&folder, "level.glb");
    folder.ok(&[&["bake", "level.glb"], &SKY[..]].concat());
    folder
}

fn list(folder: &Folder) -> Value {
    serde_json::from_slice(&folder.read(LIST)).expect("the list is JSON")
}

#[test]
fn each_box_becomes_a_file_and_the_list_names_them_the_finest_first() {
    let folder = baked();
    assert_eq!(folder.names(), ["Corner.gdibl", "hall.gdibl", "level.glb", LIST]);
    let expected = json!({
        "format": "gdibl-volumes", "version": 1, "level": "level.glb",
        "volumes": [
            { "file": "Corner.gdibl", "name": "Corner", "min": [1.0, 0.0, 1.0], "max": [4.0, 2.0, 4.0], "spacing": 0.5 },
            { "file": "hall.gdibl", "name": "hall", "min": [-4.0, 0.0, -4.0], "max": [4.0, 3.0, 4.0], "spacing": 1.0 },
        ],
    });
    assert_eq!(list(&folder), expected);
    let schema = std::fs::read_to_string(crate::common::repository("docs/volumes.schema.json")).expect("the schema");
    let schema = jsonschema::validator_for(&serde_json::from_str(&schema).unwrap()).expect("a JSON Schema");
    assert!(schema.is_valid(&list(&folder)));
    assert!(!schema.is_valid(&json!({ "format": "gdibl-volumes", "version": 1, "level": "", "volumes": [] })));
}

#[test]
fn nodes_have_settings_of_their_own_which_flags_overrule() {
    let folder = baked();
    let setting = |volume: &str, name: &str| folder.inspect(volume)["settings"][name].clone();
    // --samples was given.
    for (volume, sh, samples, zstd) in [("Corner.gdibl", "L1", 64, true), ("hall.gdibl", "L2", 64, false)] {
        assert_eq!(setting(volume, "quality.sh"), sh);
        assert_eq!(setting(volume, "quality.samples"), samples);
        assert_eq!(setting(volume, "quality.zstd"), zstd);
    }
    folder.write("BAKE.toml", "level = \"level.glb\"\ndistant = [1, 1, 1]\n[quality]\nsamples = 32\nsh = \"L0\"");
    folder.ok(&["bake", "BAKE.toml"]);
    assert_eq!(
        (setting("Corner.gdibl", "quality.samples"), setting("Corner.gdibl", "quality.sh")),
        (128.into(), "L1".into())
    );
    assert_eq!(
        (setting("hall.gdibl", "quality.samples"), setting("hall.gdibl", "quality.sh")),
        (32.into(), "L0".into())
    );
    // Records are whole.
    for volume in ["Corner.gdibl", "hall.gdibl"] {
        let found = folder.inspect(volume);
        assert!(found["statistics"]["stages"].as_array().is_some_and(|stages| !stages.is_empty()), "{found}");
        assert!(found["plan"].as_array().is_some_and(|plan| plan.len() > 5), "{found}");
    }
}

#[test]
fn one_box_stays_one_volume_of_the_outputs_name() {
    let folder = Folder::new();
    level(&[corner()]).write(&folder, "level.glb");
    folder.ok(&["bake", "level.glb", "--distant", "1,1,1", "-o", "light.gdibl"]);
    assert_eq!(folder.names(), ["level.glb", "light.gdibl"]);
    let found = folder.inspect("light.gdibl");
    assert_eq!((&found["sh"], &found["settings"]["quality.samples"]), (&json!("L1"), &json!(128)));
    // And --bounds wins over many.
    level(&[hall(), corner()]).write(&folder, "level.glb");
    let whole = ["bake", "level.glb", "--bounds", "-4,0,-4,4,3,4", "--counts", "2,2,2", "-o", "light.gdibl"];
    folder.ok(&[&whole[..], &SKY].concat());
    assert_eq!(folder.names(), ["level.glb", "light.gdibl"]);
}

#[test]
fn bytes_depend_neither_on_threads_nor_on_what_is_baked_beside() {
    let folder = baked();
    let files = ["Corner.gdibl", "hall.gdibl", LIST];
    let together = files.map(|file| folder.read(file));
    for threads in ["1", "2"] {
        folder.ok(&[&["bake", "level.glb", "--threads", threads], &SKY[..]].concat());
        assert_eq!(files.map(|file| folder.read(file)), together, "{threads} threads");
    }
    for name in ["Corner", "hall"] {
        let apart = Folder::new();
        level(&[hall(), corner()]).write(&apart, "level.glb");
        apart.ok(&[&["bake", "level.glb", "--volume", name], &SKY[..]].concat());
        let file = format!("{name}.gdibl");
        assert_eq!(apart.names().len(), 3, "{:?}", apart.names());
        assert_eq!(apart.read(&file), folder.read(&file));
        assert_eq!(apart.read(LIST), folder.read(LIST));
    }
    // And the same as of a level that has that box alone, but for the record of the level's own bytes.
    let alone = Folder::new();
    level(&[corner()]).write(&alone, "level.glb");
    alone.ok(&[&["bake", "level.glb"], &SKY[..]].concat());
    let light = |bytes: &[u8]| {
        let mut light = Vec::new();
        crate::common::with_sections(bytes, |id, bytes| {
            if id != b"SETT" {
                light.extend_from_slice(bytes)
            }
        });
        light
    };
    assert_eq!(light(&alone.read("level.gdibl")), light(&folder.read("Corner.gdibl")));
}

#[test]
fn volumes_that_are_unchanged_are_not_baked_again() {
    let folder = baked();
    let files = ["Corner.gdibl", "hall.gdibl", LIST];
    let first = files.map(|file| folder.read(file));
    let bake = |more: &[&str]| folder.ok(&[&["bake", "level.glb"], &SKY[..], more].concat());
    for more in [&[][..], &["--threads", "1"], &["--volume", "hall"]] {
        let said = bake(more);
        assert!(said.lines().count() == 1 && said.contains("unchanged"), "{more:?}: {said}");
    }
    // What is missing or damaged is baked, and nothing else.
    let count = |said: &str| said.matches("unchanged").count();
    std::fs::remove_file(folder.path("hall.gdibl")).unwrap();
    assert_eq!(count(&bake(&[])), 1);
    folder.write("Corner.gdibl", &first[0][..first[0].len() / 2]);
    assert_eq!(count(&bake(&[])), 1);
    folder.write(LIST, b"{}");
    assert_eq!(bake(&[]).lines().count(), 1);
    assert_eq!(files.map(|file| folder.read(file)), first);
    // Settings of all, and of one.
    assert_eq!(count(&bake(&["--seed", "1"])), 0);
    assert_eq!(count(&bake(&["--seed", "1", "--force"])), 0);
    let report: Value = serde_json::from_str(&bake(&["--seed", "1", "--json"])).expect("JSON");
    assert_eq!(report["volumes"].as_array().map(Vec::len), Some(2));
    assert!(report["volumes"].as_array().unwrap().iter().all(|volume| volume["unchanged"] == true), "{report}");
    // Boxes that changed: another level.
    level(&[hall(), marker("Corner", [2.0, 1.0, 2.5], [1.5, 1.0, 1.5], json!({ "gdibl_volume": 0.5 }))])
        .write(&folder, "level.glb");
    assert_eq!(count(&bake(&["--seed", "1"])), 0);
}

#[test]
fn a_flag_that_says_what_is_the_default_is_not_taken_for_none() {
    let folder = Folder::new();
    level(&[corner()]).write(&folder, "level.glb");
    let bake = |more: &[&str]| folder.ok(&[&["bake", "level.glb"], &SKY[..], more].concat());
    bake(&[]);
    assert_eq!(folder.inspect("level.gdibl")["sh"], "L1");
    assert!(!bake(&["--sh", "L2"]).contains("unchanged"));
    assert_eq!(folder.inspect("level.gdibl")["sh"], "L2");
    assert!(bake(&["--sh", "L2"]).contains("unchanged"));
}

#[test]
fn sample_reads_the_list_as_the_runtime_does() {
    let folder = baked();
    let read = |file: &str| Volume::parse(&folder.read(file)).unwrap_or_else(|error| panic!("{error}"));
    let volumes = list(&folder)["volumes"].as_array().unwrap().clone();
    let set = volumes.iter().map(|entry| (read(entry["file"].as_str().unwrap()), entry["spacing"].as_f64().unwrap()));
    let set = VolumeSet::new(set).unwrap();
    let mut places = Vec::new();
    for (i, normal) in normals().into_iter().enumerate() {
        for k in 0..20 {
            let t = (20 * i + k) as f64;
            let place = [4.5 * (t * 0.61).sin(), 1.6 + 1.7 * (t * 0.37).sin(), 4.5 * (t * 0.23).cos()];
            places.push([place[0], place[1], place[2], normal.x, normal.y, normal.z]);
        }
    }
    let mut shared = 0;
    for (place, found) in places.iter().zip(folder.irradiance(LIST, &places)) {
        let [x, y, z, u, v, w] = *place;
        let normal = [u as f32, v as f32, w as f32];
        let sample = set.sample_f64([x, y, z], normal);
        let expected = sample.sh.convolve().evaluate(normal);
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - f64::from(expected)).abs() < 1e-5, "{place:?}: {found} {expected}");
        }
        shared += usize::from(set.shares([x, y, z]).count() > 1);
    }
    assert!(shared > 10, "{shared} places between both");
    // With coefficients all rows are as long as those of the volume with most bands.
    let coefficients = folder.coefficients(LIST, &[[3.0, 1.0, 3.0], [-3.0, 1.0, 3.0]]);
    assert!(coefficients.iter().all(|row| row.len() == 27 + 1));
}

#[test]
fn compare_inspect_and_export_read_the_list() {
    let folder = baked();
    let json = |arguments: &[&str]| -> Value {
        serde_json::from_str(&folder.ok(&[arguments, &["--json"]].concat())).expect("JSON")
    };
    let own = json(&["compare", LIST, LIST]);
    assert!(own["all"]["relative_rmse"].as_f64().unwrap() < 1e-6, "{own}");
    assert_eq!(own["sets"].as_array().unwrap().len(), 2, "{own}");
    let against = json(&["compare", LIST, "hall.gdibl"]);
    assert!(against["places"]["compared"].as_u64().unwrap() > 100, "{against}");

    let found = json(&["inspect", LIST]);
    let names: Vec<&str> = found["volumes"].as_array().unwrap().iter().map(|v| v["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["Corner", "hall"]);
    assert_eq!(found["volumes"][0]["sh"], "L1");

    json(&["export", LIST, "--to", "json", "-o", "light.json"]);
    for name in ["light-Corner.json", "light-hall.json"] {
        assert!(folder.exists(name), "{:?}", folder.names());
    }
    // A verb for one volume says which there are.
    let run = folder.run(&["cut", LIST, "--sh", "L1", "-o", "x.gdibl"]);
    assert_eq!(run.code, 2, "{}", run.err);
    assert!(run.err.contains("Corner.gdibl") && run.err.contains("hall.gdibl"), "{}", run.err);
}

#[test]
fn a_list_that_is_not_one_of_its_files_is_refused() {
    let folder = baked();
    folder.write("places.csv", "0,1,0,0,1,0\n");
    let refused = |change: &dyn Fn(&mut Value), code: i32, words: &str| {
        let mut list = list(&folder);
        change(&mut list);
        folder.write("odd.json", list.to_string());
        for verb in [&["sample", "odd.json", "--at", "places.csv"][..], &["compare", "odd.json", "hall.gdibl"]] {
            let run = folder.run(verb);
            assert_eq!(run.code, code, "{verb:?}: {}", run.err);
            assert!(run.err.contains(words) && run.err.contains("odd.json") || run.err.contains("hall"), "{}", run.err);
        }
    };
    refused(&|list| list["version"] = json!(2), 4, "version");
    refused(&|list| list["volumes"] = json!([]), 3, "at least one");
    refused(&|list| list["volumes"][0]["spacing"] = json!(0), 3, "metres over 0");
    refused(&|list| list["volumes"][1]["file"] = json!("halls.gdibl"), 3, "halls.gdibl");
    refused(&|list| list["volumes"][1]["max"][0] = json!(4.5), 3, "hall.gdibl");
    refused(&|list| list["volumes"] = json!(7), 3, "FORMAT.md");
}

#[test]
fn a_plan_has_a_row_per_volume_and_writes_nothing() {
    let folder = Folder::new();
    level(&[hall(), corner()]).write(&folder, "level.glb");
    let plan = folder.ok(&[&["bake", "level.glb", "--plan"], &SKY[..]].concat());
    for words in ["'hall' ", "'Corner' ", "8.000 x 3.000 x 8.000", "3.000 x 2.000 x 3.000", "7 x 5 x 7", "9 x 4 x 9"] {
        assert!(plan.contains(words), "{words}: {plan}");
    }
    assert_eq!(folder.names(), ["level.glb"]);
    let json: Value =
        serde_json::from_str(&folder.ok(&[&["bake", "level.glb", "--plan", "--json"], &SKY[..]].concat())).unwrap();
    assert_eq!(json["volumes"][1]["name"], "hall");
    assert!(json["volumes"][1]["plan"].as_array().unwrap().len() > 5);
}

#[test]
fn boxes_that_make_no_sense_are_refused_with_their_nodes_and_nothing_is_written() {
    let small = |name: &str, extras: Value| marker(name, [-2.5, 1.0, -2.5], [1.0, 1.0, 1.0], extras);
    let fine = json!({ "gdibl_volume": 0.5 });
    let turned = |extras: Value| {
        let mut node = small("turned", extras);
        node["rotation"] = json!([0.0, 0.38268343, 0.0, 0.92387953]);
        node
    };
    let mut skewed_flat = hall();
    skewed_flat["scale"] = json!([4.0, 0.0, 4.0]);
    for (second, words) in [
        (small("HALL", fine.clone()), &["node 1 (hall)", "node 2 (HALL)", "two volumes"][..]),
        (small("", fine.clone()), &["node 2", "name"]),
        (small("up/down", fine.clone()), &["node 2 (up/down)", "'/'"]),
        (small("nul", fine.clone()), &["node 2 (nul)", "Windows"]),
        (skewed_flat, &["node 2 (hall)", "empty"]),
        (
            marker("same", [0.0, 1.5, 0.0], [4.0, 1.5, 4.0], fine.clone()),
            &["node 1 (hall)", "node 2 (same)", "same box"],
        ),
        (
            marker("rock", [0.0, 0.7, 0.0], [0.6, 0.3, 0.6], json!({ "gdibl_volume": 0.3 })),
            &["node 2 (rock)", "in the open"],
        ),
        (small("odd", json!({ "gdibl_volume": 0.5, "gdibl_sample": 3 })), &["node 2 (odd)", "gdibl_sample", "samples"]),
        (
            small("odd", json!({ "gdibl_volume": 0.5, "gdibl_samples": "many" })),
            &["node 2 (odd)", "gdibl_samples", "many"],
        ),
        (small("odd", json!({ "gdibl_volume": 0.5, "gdibl_samples": 0 })), &["node 2 (odd)", "1 to 2147483648"]),
        (small("odd", json!({ "gdibl_volume": 0.5, "gdibl_sun": "extract" })), &["node 2 (odd)", "whole level"]),
        (small("odd", json!({ "gdibl_volume": 0.5, "gdibl_spacing": 1 })), &["node 2 (odd)", "value of gdibl_volume"]),
    ] {
        let folder = Folder::new();
        level(&[hall(), second]).write(&folder, "level.glb");
        let run = folder.run(&[&["bake", "level.glb"], &SKY[..]].concat());
        assert_eq!(run.code, 3, "{words:?}: {}", run.err);
        assert!(run.err.contains("level.glb"), "{}", run.err);
        words.iter().for_each(|word| assert!(run.err.contains(word), "{word}: {}", run.err));
        assert_eq!(folder.names(), ["level.glb"], "{words:?}");
    }
    // A rotated box holds, and is said: the box around it is baked.
    let folder = Folder::new();
    level(&[hall(), turned(fine)]).write(&folder, "level.glb");
    let run = folder.run(&[&["bake", "level.glb"], &SKY[..]].concat());
    assert_eq!(run.code, 0, "{}", run.err);
    assert!(run.err.contains("rotated-volume: node 2 (turned)") && run.err.contains("2.828"), "{}", run.err);
    // What --volume names is there.
    let run = folder.run(&[&["bake", "level.glb", "--volume", "cellar"], &SKY[..]].concat());
    assert_eq!(run.code, 2, "{}", run.err);
    assert!(run.err.contains("turned, hall"), "{}", run.err);
}
