//! `bake --match-exposure`: probes of unlike exposures, as from a camera.

use crate::common::{Folder, Level, Run, csv_of, panel, repository};
use serde_json::{Value, json};

/// The shipped box and its probes, exposed by these stops.
fn box_with(stops: [f64; 3]) -> Folder {
    let folder = Folder::new();
    for name in ["empty-box.glb", "distant.exr", "probe_0.exr", "probe_1.exr", "probe_2.exr"] {
        folder.write(name, std::fs::read(repository("assets/uffizi-box").join(name)).unwrap());
    }
    let probe =
        |(i, stops): (usize, f64)| format!("[[probe]]\nimage = \"probe_{i}.exr\"\nexposure_stops = {stops:?}\n");
    let probes: String = stops.into_iter().enumerate().map(probe).collect();
    let rest = "[grid]\nnodes = \"points:points.csv\"\n[quality]\nsamples = 1024\nprecision = \"f32\"\n";
    folder.write("BAKE.toml", format!("level = \"empty-box.glb\"\ndistant = \"distant.exr\"\n{probes}{rest}"));
    folder.write("points.csv", csv_of(&PLACES));
    folder
}

const PLACES: [[f64; 3]; 5] = [[0.0, 1.0, 0.0], [0.5, 0.4, 1.2], [-0.6, 1.6, 2.4], [0.3, 1.3, -1.1], [-0.4, 0.5, -2.6]];

/// E at the places, from six sides.
fn irradiance(folder: &Folder) -> Vec<f64> {
    let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let normals: Vec<[f64; 3]> = axes.iter().flat_map(|&n| [n, n.map(|v: f64| -v)]).collect();
    let rows: Vec<[f64; 6]> =
        PLACES.iter().flat_map(|&[x, y, z]| normals.iter().map(move |&[nx, ny, nz]| [x, y, z, nx, ny, nz])).collect();
    folder.irradiance("BAKE.gdibl", &rows).iter().flat_map(|row| row[..3].to_vec()).collect()
}

fn worst(found: &[f64], expected: &[f64]) -> f64 {
    assert!(!found.is_empty() && found.len() == expected.len());
    found.iter().zip(expected).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max)
}

fn row<'a>(report: &'a Value, stage: &str) -> Option<&'a Value> {
    report["plan"].as_array().unwrap().iter().find(|row| row["stage"] == stage)
}

#[test]
fn matched_exposures_give_the_light_of_right_ones() {
    let right = box_with([0.0; 3]);
    let report = right.bake(&["BAKE.toml"]);
    assert_eq!((row(&report, "match-exposure"), &report["exposure"]), (None, &Value::Null), "off unless asked for");
    let expected = irradiance(&right);

    let wrong = box_with([1.0, -0.5, 0.0]);
    wrong.bake(&["BAKE.toml"]);
    assert!(worst(&irradiance(&wrong), &expected) > 0.2, "exposures matter");
    let report = wrong.bake(&["BAKE.toml", "--match-exposure"]);
    let off = worst(&irradiance(&wrong), &expected);
    println!("E is off by {:.2} % at worst", off * 100.0);
    assert!(off < 0.02, "{off}");

    assert_eq!(row(&report, "match-exposure").unwrap()["kept"], true);
    let stops = |probe: usize, channel: usize| report["exposure"]["probes"][probe]["stops"][channel].as_f64().unwrap();
    for (probe, stops_off) in [1.0, -0.5, 0.0].into_iter().enumerate() {
        for channel in 0..3 {
            assert!((stops(probe, channel) + stops_off).abs() < 0.02, "{}", report["exposure"]);
        }
        assert_eq!(report["exposure"]["probes"][probe]["suspect"], Value::Null);
    }
    assert_eq!(report["exposure"]["pairs"].as_array().unwrap().len(), 3);
    // The volume tells what was used, and how it was found.
    let inspected = wrong.inspect("BAKE.gdibl");
    for probe in 0..3 {
        let used = inspected["probes"][probe]["exposure_stops"].as_f64().unwrap();
        assert!(used.abs() < 0.02, "{used}");
    }
    let findings = inspected["statistics"]["findings"].as_array().unwrap();
    assert_eq!(findings.iter().filter(|finding| finding["id"] == "matched-exposure").count(), 3);
}

#[test]
fn exposure_is_matched_by_bake_toml_with_the_same_bytes_on_any_threads() {
    let folder = box_with([0.3, 0.0, -0.7]);
    let text = String::from_utf8(folder.read("BAKE.toml")).unwrap();
    folder.write("BAKE.toml", format!("{text}match_exposure = true\n"));
    let bytes = ["1", "2", "5"].map(|threads| {
        folder.bake(&["BAKE.toml", "--force", "--threads", threads]);
        folder.read("BAKE.gdibl")
    });
    assert!(bytes[0] == bytes[1] && bytes[0] == bytes[2]);
    let planned: Value = serde_json::from_str(&folder.ok(&["bake", "BAKE.toml", "--plan", "--json"])).unwrap();
    assert_eq!(folder.inspect("BAKE.gdibl")["plan"], planned["plan"], "what is planned is done");
}

#[test]
fn misplaced_probe_is_named_on_stderr_and_in_the_report() {
    let folder = box_with([0.0; 3]);
    let text = String::from_utf8(folder.read("BAKE.toml")).unwrap();
    let moved = text.replace("image = \"probe_1.exr\"", "image = \"probe_1.exr\"\nposition = [0.0, 1.0, 0.5]");
    folder.write("BAKE.toml", moved);
    let Run { code, out, err } = folder.run(&["bake", "BAKE.toml", "--match-exposure", "--json", "--samples", "64"]);
    assert_eq!(code, 0, "{err}");
    let named: Vec<&str> = err.lines().filter(|line| line.contains("suspect-probe")).collect();
    assert!(named.len() == 1 && named[0].contains("probe_1.exr"), "{err}");
    let report: Value = serde_json::from_str(&out).unwrap();
    assert!(report["exposure"]["probes"][1]["suspect"].is_string(), "{}", report["exposure"]);
}

#[test]
fn matching_is_left_out_with_the_reason_where_there_is_nothing_to_match() {
    let folder = Folder::new();
    Level::room([-2.0; 3], [2.0; 3]).write(&folder, "room.glb");
    folder.constant("a.exr", [0.0; 3], [1.0; 3]);
    let mut open = Level::new();
    open.object(&panel(0.5, -3.0), 0, json!({}));
    open.write(&folder, "open.glb");
    folder.sky("sky.exr", [1.0; 3]);
    let common = ["--match-exposure", "--counts", "2,2,2", "--bounds", "-1,-1,-1,1,1,1", "--samples", "64"];
    let left_out = |inputs: &[&str]| {
        let report = folder.bake(&[inputs, &common[..]].concat());
        let row = row(&report, "match-exposure").unwrap().clone();
        assert_eq!((&row["kept"], &report["findings"]), (&json!(false), &json!([])), "{report}");
        row["why"].as_str().unwrap().to_string()
    };
    assert!(left_out(&["room.glb", "--probes", "a.exr"]).contains("one probe"));
    assert!(left_out(&["open.glb", "--distant", "sky.exr", "--method", "gdibl", "--no-capture"]).contains("no probe"));
    assert!(left_out(&["open.glb", "--distant", "sky.exr", "--method", "path"]).contains("path tracing"));
}
