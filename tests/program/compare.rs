//! What `compare` promises: the right error at the right places, and an exit code that a build can go by.

use crate::common::{Folder, Level, csv_of, repository};
use serde_json::{Value, json};

/// A room in the light of one probe of given brightness.
fn room(folder: &Folder, volume: &str, light: f32, more: &[&str]) {
    Level::room([-2.0; 3], [2.0; 3]).write(folder, "room.glb");
    folder.panorama("probe.exr", 32, Some([0.0; 3]), |d| [1.0 + d.x as f32, 1.5, 1.0 + d.y as f32].map(|v| v * light));
    let common = ["room.glb", "--probes", "probe.exr", "--precision", "f32", "-o", volume];
    folder.bake(&[&common[..], more].concat());
}

const GRID: [&str; 5] = ["--bounds", "-1,-1,-1,1,1,1", "--counts", "3,3,3", "--samples"];

fn compare(folder: &Folder, arguments: &[&str]) -> Value {
    let out = folder.ok(&[&["compare"], arguments, &["--json"]].concat());
    serde_json::from_str(&out).expect("compare --json prints JSON")
}

fn number(value: &Value, pointer: &str) -> f64 {
    let found = value.pointer(pointer).and_then(Value::as_f64);
    found.unwrap_or_else(|| panic!("no number {pointer} in {value}"))
}

/// The truth of the shipped box, and a volume of its empty room at the truth's 128 nodes.
fn shipped_box(folder: &Folder, more: &[&str]) -> String {
    let asset = |name: &str| repository("assets/uffizi-box").join(name).display().to_string();
    let reference = asset("reference.json");
    let sets: Value = serde_json::from_slice(&std::fs::read(&reference).unwrap()).unwrap();
    let places = ["grid", "scattered"].iter().flat_map(|set| sets[set]["position"].as_array().unwrap());
    let places: Vec<[f64; 3]> = places.map(|p| [0, 1, 2].map(|axis| p[axis].as_f64().unwrap())).collect();
    folder.write("truth.csv", csv_of(&places));
    let inputs = [asset("empty-box.glb"), asset("probe_0.exr"), asset("probe_1.exr"), asset("probe_2.exr")];
    let [level, a, b, c] = inputs.each_ref().map(String::as_str);
    let distant = asset("distant.exr");
    let common = [level, "--probes", a, "--probes", b, "--probes", c, "--distant", &distant, "-o", "box.gdibl"];
    folder.bake(&[&common[..], more].concat());
    reference
}

#[test]
fn volume_against_itself_has_no_error() {
    let folder = Folder::new();
    room(&folder, "a.gdibl", 1.0, &[&GRID[..], &["64"]].concat());
    let report = compare(&folder, &["a.gdibl", "a.gdibl", "--tolerance", "0"]);
    assert_eq!((number(&report, "/all/relative_rmse"), number(&report, "/all/bias")), (0.0, 0.0));
    assert_eq!(report["places"]["compared"], 27);
    assert_eq!(report["noise_unknown"], json!(["common-seed"]));
    assert_eq!((&report["within_tolerance"], &report["worst"]), (&json!(true), &json!([])));
    let text = folder.ok(&["compare", "a.gdibl", "a.gdibl"]);
    for words in ["27 of 27 compared", "0.00 % relative RMSE of E", "node against node", "same --seed"] {
        assert!(text.contains(words), "{words} in\n{text}");
    }
}

#[test]
fn brighter_volume_is_off_by_its_brightness_and_misses_a_tolerance_under_it() {
    let folder = Folder::new();
    room(&folder, "truth.gdibl", 1.0, &[&GRID[..], &["64"]].concat());
    room(&folder, "bright.gdibl", 1.02, &[&GRID[..], &["64"]].concat());
    let report = compare(&folder, &["bright.gdibl", "truth.gdibl", "--tolerance", "0.021"]);
    for pointer in ["/all/relative_rmse", "/all/bias", "/all/channels/2/bias", "/all/per_node/max", "/sets/0/bias"] {
        assert!((number(&report, pointer) - 0.02).abs() < 1e-5, "{pointer} in {report}");
    }
    assert_eq!(report["worst"].as_array().unwrap().len(), 5);
    let run = folder.run(&["compare", "bright.gdibl", "truth.gdibl", "--tolerance", "0.019"]);
    assert_eq!(run.code, 5, "{}", run.err);
    assert!(run.out.contains("2.00 % relative RMSE of E"), "the report comes first: {}", run.out);
    for words in ["bright.gdibl", "2.00 %", "--tolerance 0.019"] {
        assert!(run.err.contains(words), "{words} in {}", run.err);
    }
    let run = folder.run(&["compare", "bright.gdibl", "truth.gdibl", "--tolerance", "0.019", "--json"]);
    assert_eq!(run.code, 5);
    assert_eq!(serde_json::from_str::<Value>(&run.out).unwrap()["within_tolerance"], false);
}

#[test]
fn other_seed_is_noise_and_nothing_systematic() {
    let folder = Folder::new();
    room(&folder, "a.gdibl", 1.0, &[&GRID[..], &["64", "--sampler", "random"]].concat());
    room(&folder, "b.gdibl", 1.0, &[&GRID[..], &["64", "--sampler", "random", "--seed", "1"]].concat());
    let report = compare(&folder, &["a.gdibl", "b.gdibl"]);
    let of = |figure: &str| number(&report, &format!("/all/{figure}"));
    assert!(of("noise") > 0.01, "{report}");
    // mean d² of 27 nodes is known to sqrt(2 / (4.3 · 27)) = 13 %, noise² to about as much: three standard deviations
    // of both, a false alarm in 300, were the seeds not fixed.
    assert!(of("systematic") < 0.75 * of("noise"), "{report}");
    assert!((of("relative_rmse") / of("noise") - 1.0).abs() < 0.3, "{report}");
}

#[test]
fn shipped_truth_is_met_at_its_nodes() {
    let folder = Folder::new();
    let reference = shipped_box(&folder, &["--nodes", "points:truth.csv", "--samples", "4096"]);
    let report = compare(&folder, &["box.gdibl", &reference]);
    assert_eq!(
        report["places"],
        json!({ "truth": 128, "compared": 128, "filled": 0, "invalid": 0, "outside": 0,
                                         "not_held": 0 })
    );
    assert_eq!(report["sets"][0]["name"], "grid");
    assert_eq!((&report["sets"][1]["name"], &report["sets"][1]["nodes"]), (&json!("scattered"), &json!(64)));
    assert_eq!(report["sets"][1]["answer"], "held");
    assert_eq!(report["all"]["bands"].as_array().unwrap().len(), 3);
    // 1.58 % at 4096 directions, and the noise predicts 1.58 %.
    assert!((0.0..0.02).contains(&number(&report, "/all/relative_rmse")), "{report}");
    assert!(number(&report, "/all/systematic") < 0.01, "{report}");
    assert!(number(&report, "/all/noise") > number(&report, "/all/systematic"), "{report}");
    assert!(number(&report, "/all/bias").abs() < 0.01, "{report}");
    for pointer in ["/all/rmse", "/all/mean_difference", "/all/per_node/p95", "/worst/4/relative_error"] {
        assert!(number(&report, pointer).is_finite());
    }
    assert_eq!(report["worst"][0]["position"].as_array().unwrap().len(), 3);
    let one = compare(&folder, &["box.gdibl", &reference, "--set", "scattered"]);
    assert_eq!(one["all"]["relative_rmse"], report["sets"][1]["relative_rmse"]);
    // At the spheres it was not baked.
    let run = folder.run(&["compare", "box.gdibl", &reference, "--set", "sphere_irradiance_empty_box"]);
    assert_eq!(run.code, 3, "{}", run.err);
    for words in ["box.gdibl", "192", "--nodes points:FILE.csv"] {
        assert!(run.err.contains(words), "{words} in {}", run.err);
    }
}

#[test]
fn grid_is_compared_between_its_nodes_also_on_surfaces() {
    let folder = Folder::new();
    let bounds = ["--bounds", "-1,0,-3,1,2,1.5", "--spacing", "0.5", "--samples", "1024"];
    let reference = shipped_box(&folder, &bounds);
    let sets = ["--set", "grid", "--set", "sphere_irradiance_empty_box"];
    let report = compare(&folder, &[&["box.gdibl", &reference], &sets[..]].concat());
    let places = &report["places"];
    let [compared, outside] = ["compared", "outside"].map(|key| places[key].as_u64().unwrap());
    assert_eq!(compared + outside, 64 + 192, "{places}");
    assert!(outside > 64, "what lies at z > 1.5 is left out: {places}");
    assert_eq!(report["sets"][0]["answer"], "interpolated");
    assert_eq!(report["sets"][1]["bands"], json!([]), "irradiance at a normal has no bands");
    assert!((0.01..0.15).contains(&number(&report, "/sets/1/relative_rmse")), "{report}");
    let text = folder.ok(&["compare", "box.gdibl", &reference, "--set", "sphere_irradiance_empty_box"]);
    for words in ["irradiance at normals", "outside the box", "interpolated"] {
        assert!(text.contains(words), "{words} in\n{text}");
    }
}

#[test]
fn lower_of_both_bands_counts_and_the_report_says_so() {
    let folder = Folder::new();
    room(&folder, "high.gdibl", 1.0, &[&GRID[..], &["256", "--sh", "L4"]].concat());
    room(&folder, "low.gdibl", 1.0, &[&GRID[..], &["256", "--sh", "L1", "--seed", "1"]].concat());
    for (a, b) in [("high.gdibl", "low.gdibl"), ("low.gdibl", "high.gdibl")] {
        let report = compare(&folder, &[a, b]);
        assert_eq!(report["all"]["bands"].as_array().unwrap().len(), 2, "{report}");
        assert!(number(&report, "/all/relative_rmse") < 0.05, "{report}");
        let text = folder.ok(&["compare", a, b]);
        let both =
            if a == "low.gdibl" { "low.gdibl holds L1, high.gdibl L4" } else { "high.gdibl holds L4, low.gdibl L1" };
        assert!(text.contains("radiance to L1") && text.contains(both), "{text}");
    }
}

#[test]
fn without_standard_errors_noise_is_not_known_and_the_report_says_whose() {
    let folder = Folder::new();
    room(&folder, "a.gdibl", 1.0, &[&GRID[..], &["64"]].concat());
    let one = json!({ "one": { "position": [[0, 0, 0]], "sh": [[[3.545, 5.317, 3.545]]] } });
    folder.write("truth.json", one.to_string());
    let report = compare(&folder, &["a.gdibl", "truth.json"]);
    assert_eq!((&report["all"]["noise"], &report["all"]["systematic"]), (&Value::Null, &Value::Null));
    assert_eq!(report["noise_unknown"], json!(["truth"]));
    assert_eq!(report["bands"], json!({ "found": 2, "truth": 0 }));
    assert!(number(&report, "/all/relative_rmse") < 0.05, "{report}");
    let text = folder.ok(&["compare", "a.gdibl", "truth.json"]);
    assert!(text.contains("not known: truth.json holds no standard errors"), "{text}");
}

#[test]
fn truth_of_another_level_is_said() {
    let folder = Folder::new();
    room(&folder, "a.gdibl", 1.0, &[&GRID[..], &["16"]].concat());
    let reference = |level: &str| {
        let set = json!({ "position": [[0, 0, 0]], "sh": [[[1, 1, 1]]] });
        let mut reference = json!({ "what": "one place", "set": set });
        if !level.is_empty() {
            reference["level"] = json!(level);
        }
        folder.write("truth.json", reference.to_string());
    };
    for (level, said) in [("", false), ("room.glb", false), ("hall.glb", true)] {
        reference(level);
        let run = folder.run(&["compare", "a.gdibl", "truth.json", "--json"]);
        let report: Value = serde_json::from_str(&run.out).unwrap();
        assert_eq!(
            (report["findings"][0]["id"] == "other-level", run.err.contains("other-level")),
            (said, said),
            "{level}"
        );
    }
    let said = folder.run(&["compare", "a.gdibl", "truth.json"]).err;
    assert!(said.contains("room.glb") && said.contains("hall.glb"), "{said}");
    // A volume remembers its level.
    folder.write("hall.glb", folder.read("room.glb"));
    let common = ["hall.glb", "--probes", "probe.exr", "--precision", "f32", "-o", "b.gdibl"];
    folder.bake(&[&common[..], &GRID, &["16"]].concat());
    assert_eq!(compare(&folder, &["a.gdibl", "b.gdibl"])["findings"][0]["id"], "other-level");
    assert_eq!(compare(&folder, &["a.gdibl", "a.gdibl"])["findings"], json!([]));
    // The shipped reference knows the levels of its sets.
    let reference = shipped_box(&folder, &["--nodes", "points:truth.csv", "--samples", "16"]);
    assert_eq!(compare(&folder, &["box.gdibl", &reference])["findings"], json!([]));
    let spheres = compare(&folder, &["box.gdibl", &reference, "--set", "grid", "--set", "scattered"]);
    assert_eq!(spheres["findings"], json!([]));
}
