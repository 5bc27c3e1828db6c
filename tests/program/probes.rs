//! `probes coverage` and `probes suggest`.

use crate::common::{Folder, Level, box_of, solid_of};
use serde_json::{Value, json};

/// Two closed rooms, x 0..2 and 2.5..4.5.
fn two_rooms() -> Folder {
    let folder = Folder::new();
    let mut level = Level::room([0.0; 3], [2.0; 3]);
    level.object(&box_of([2.5, 0.0, 0.0], [4.5, 2.0, 2.0]), 0, json!({}));
    level.write(&folder, "rooms.glb");
    folder.constant("first.exr", [1.0, 1.0, 1.0], [1.0; 3]);
    folder
}

fn json_of(folder: &Folder, arguments: &[&str]) -> Value {
    serde_json::from_str(&folder.ok(&[&["probes"], arguments, &["--json"]].concat())).expect("JSON")
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value}"))
}

#[test]
fn suggestions_go_on_where_given_probes_end() {
    let folder = two_rooms();
    let alone = json_of(&folder, &["suggest", "rooms.glb", "--gain", "0.1"]);
    assert_eq!((&alone["probes"], &alone["coverage"]), (&json!(0), &json!(0.0)));
    assert_eq!(alone["suggestions"].as_array().unwrap().len(), 2, "{alone}");
    let found = json_of(&folder, &["suggest", "rooms.glb", "--probes", "first.exr", "--gain", "0.1"]);
    assert_eq!(found["probes"], 1);
    assert!((number(&found["coverage"]) - 0.5).abs() < 0.02, "{found}");
    let suggestions = found["suggestions"].as_array().unwrap();
    assert_eq!(suggestions.len(), 1, "{found}");
    assert!(number(&suggestions[0]["position"][0]) > 2.5, "{found}");
    assert_eq!((&suggestions[0]["coverage"], &suggestions[0]["uncovered_solid_angle"]), (&json!(1.0), &json!(0.0)));
    let drop = number(&suggestions[0]["drop_in_uncovered_solid_angle"]);
    assert_eq!(drop, number(&found["uncovered_solid_angle"]));
    assert!((drop / (2.0 * std::f64::consts::PI) - 1.0).abs() < 0.04, "half of the sphere: {drop}");
    // The same in words, and in a box: the given probe sees all of its room.
    let text = folder.ok(&["probes", "suggest", "rooms.glb", "--probes", "first.exr", "--gain", "0.1"]);
    assert!(text.contains("1 probes see") && text.contains("100.00 %"), "{text}");
    let bounds = ["--bounds", "0,0,0,2,2,2"];
    let text = folder
        .ok(&[&["probes", "suggest", "rooms.glb", "--probes", "first.exr", "--gain", "0.1"], &bounds[..]].concat());
    assert!(text.contains("no further probe"), "{text}");
    assert_eq!(json_of(&folder, &["suggest", "rooms.glb", "--most", "1"])["suggestions"].as_array().unwrap().len(), 1);
}

#[test]
fn capture_stands_where_it_was_suggested() {
    let folder = two_rooms();
    folder.sky("sky.exr", [1.0; 3]);
    let distant = ["--distant", "sky.exr", "--most", "3"];
    let suggested = json_of(&folder, &[&["suggest", "rooms.glb"], &distant[..]].concat());
    let captured = folder.ok(&[
        &["capture", "rooms.glb", "-o", "probes", "--auto", "--width", "4", "--samples", "1", "--json"],
        &distant[..],
    ]
    .concat());
    let captured: Value = serde_json::from_str(&captured).unwrap();
    let positions = |list: &Value| -> Vec<Value> {
        list.as_array().unwrap().iter().map(|probe| probe["position"].clone()).collect()
    };
    assert!(!positions(&captured["probes"]).is_empty());
    assert_eq!(positions(&captured["probes"]), positions(&suggested["suggestions"]));
}

#[test]
fn coverage_tells_and_shows_what_is_seen() {
    let folder = two_rooms();
    let seen = json_of(&folder, &["coverage", "rooms.glb", "--probes", "first.exr"]);
    assert_eq!((&seen["probes"], &seen["output"]), (&json!(1), &Value::Null));
    for weighed in ["surfaces_by_solid_angle", "surfaces_by_area"] {
        assert!((number(&seen[weighed]["share"]) - 0.5).abs() < 0.02, "{seen}");
        assert!(number(&seen[weighed]["pixel_size"]["median"]) > 0.0, "{seen}");
    }
    assert!((number(&seen["surfaces_by_area"]["whole"]) - 48.0).abs() < 0.1, "{seen}");
    assert_eq!(seen["distant"]["whole"], 0.0);
    let picture = |name: &str, x: &str| {
        let eye = format!("{x},1,0.2");
        let camera = ["--eye", &eye, "--target", &format!("{x},1,1"), "--size", "24x16", "-o", name];
        let text = folder.ok(&[&["probes", "coverage", "rooms.glb", "--probes", "first.exr"], &camera[..]].concat());
        assert!(text.contains(name) && text.contains("% seen of"), "{text}");
        folder.read(name)
    };
    let (seen, unseen) = (picture("seen.png", "1"), picture("unseen.png", "3.5"));
    assert!(seen.starts_with(b"\x89PNG\r\n\x1a\n") && unseen.starts_with(b"\x89PNG\r\n\x1a\n"));
    assert_ne!(seen, unseen);
    assert_eq!(folder.names(), ["first.exr", "rooms.glb", "seen.png", "unseen.png"]);
}

#[test]
fn probes_say_what_they_lack() {
    let folder = two_rooms();
    let refused = |arguments: &[&str], code: i32, needle: &str| {
        let run = folder.run(&[&["probes"], arguments].concat());
        assert_eq!(run.code, code, "{arguments:?}: {}", run.err);
        assert!(run.err.contains(needle), "{arguments:?}: {}", run.err);
    };
    Level::new().write(&folder, "empty.glb");
    let mut block = Level::new();
    block.object(&solid_of([-1.0; 3], [1.0; 3]), 0, json!({}));
    block.write(&folder, "block.glb");
    for verb in ["coverage", "suggest"] {
        refused(&[verb, "empty.glb", "--probes", "first.exr"], 3, "empty.glb: has no triangles");
        refused(&[verb, "block.glb", "--probes", "first.exr"], 5, "block.glb: nothing is free");
        refused(&[verb, "none.glb"], 3, "none.glb");
        refused(&[verb, "rooms.glb", "--probes", "none.exr"], 3, "none.exr");
        refused(&[verb, "rooms.glb", "--probes", "first.exr", "--bounds", "0,0,0"], 2, "--bounds");
    }
    refused(&["coverage", "rooms.glb"], 2, "no probe is given");
    refused(&["coverage", "rooms.glb", "--probes", "first.exr", "-o", "out.exr"], 2, ".png");
    refused(&["suggest", "rooms.glb", "--gain", "2"], 2, "--gain");
}
