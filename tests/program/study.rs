//! What `study` promises: every method with every budget in all its files, and a page that needs nothing else. Times are
//! not tested, and neither is who wins.

use crate::capture::lamp_room;
use crate::common::{Folder, Level, repository};
use serde_json::{Value, json};

const METHODS: [&str; 10] = [
    "gdibl",
    "gdibl with capture",
    "gdibl distance:2",
    "gdibl angular:2",
    "gdibl angular-smooth:2",
    "gdibl nearest",
    "gdibl without importance",
    "gdibl random",
    "path",
    "path without importance",
];

/// Few nodes of the shipped box, few directions.
fn study(folder: &Folder, more: &[&str]) -> String {
    let bake = repository("assets/uffizi-box/uffizi-box.bake.toml").display().to_string();
    let quick = ["--counts", "2,2,2", "--budgets", "16,64", "--repeats", "2"];
    folder.ok(&[&["study", &bake, "-o", "out.html"], &quick[..], more].concat())
}

fn json(folder: &Folder) -> Value {
    serde_json::from_slice(&folder.read("out.json")).expect("OUT.json is JSON")
}

fn names(report: &Value) -> Vec<&str> {
    report["study"]["methods"].as_array().unwrap().iter().map(|method| method["name"].as_str().unwrap()).collect()
}

#[test]
fn every_method_and_budget_is_in_every_file() {
    let folder = Folder::new();
    let text = study(&folder, &["--reference-samples", "256"]);
    let report = json(&folder);
    assert_eq!(names(&report), METHODS);
    assert_eq!(report["left_out"], json!([{ "method": "gdibl footprint:4", "why": "is what gdibl does here" }]));
    assert_eq!(folder.names(), ["out.csv", "out.html", "out.json", "out.svg"]);
    for method in report["study"]["methods"].as_array().unwrap() {
        let points = method["points"].as_array().unwrap();
        assert_eq!(points.iter().map(|p| p["budget"].as_u64().unwrap()).collect::<Vec<_>>(), [16, 64]);
        for point in points {
            assert_eq!(point["samples"].as_u64().unwrap(), 8 * point["budget"].as_u64().unwrap());
            for figure in ["error", "noise"] {
                let [least, middle, most] = ["least", "middle", "most"].map(|of| point[figure][of].as_f64().unwrap());
                assert!(0.0 < least && least <= middle && middle <= most, "{point}");
            }
            assert!(
                point["cpu_seconds"]["middle"].as_f64().unwrap() > 0.0 && point["estimated"].is_number(),
                "{point}"
            );
            // Between the nodes errors are larger than at them, and a file has some bytes for each node.
            let [median, p95] = ["median", "p95"].map(|of| point["seen"][of].as_f64().unwrap());
            assert!(0.0 < median && median <= p95 && point["bytes"].as_u64().unwrap() > 8 * 9, "{point}");
        }
    }
    // The reference shares no random numbers with the rest.
    assert_eq!((&report["seeds"], &report["reference"]["seed"]), (&json!([1, 4]), &json!(0)));
    assert!(report["study"]["capture"]["cpu_seconds"].as_f64().unwrap() > 0.0);

    let csv = String::from_utf8(folder.read("out.csv")).unwrap();
    let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 1 + METHODS.len() * 2);
    assert!(rows.iter().all(|row| row.len() == rows[0].len()));
    assert_eq!(rows[1][..2], ["gdibl", "16"]);

    let [page, figure] = ["out.html", "out.svg"].map(|name| String::from_utf8(folder.read(name)).unwrap());
    for (name, method) in METHODS.iter().zip(report["study"]["methods"].as_array().unwrap()) {
        assert!(page.contains(name) && text.contains(name), "{name}");
        // Those that take too long are named, not drawn.
        let is_drawn = figure.contains(&format!(">{name}<"));
        assert_eq!(is_drawn, !method["is_far"].as_bool().unwrap(), "{name}");
        let is_wrong = method["claim"].as_f64().is_some_and(|claim| !(1.0 / 1.5..=1.5).contains(&claim));
        let claim = format!("{:.2}", method["claim"].as_f64().unwrap());
        assert_eq!(page.contains(&format!("<span class=\"wrong\">{claim}</span>")), is_wrong, "{name}");
    }
    let advice = text.lines().find(|line| line.contains("advice: ")).expect("advice").trim();
    assert!(page.contains(&advice.replace('<', "&lt;")), "{advice}");
    for words in ["<svg", "</svg>", "slope", "bias floor", "break-even", "gdibl footprint:4", "2 repeats"] {
        assert!(page.contains(words), "{words}");
    }
    for resource in ["http", "src=", "href=", "<script", "@import", "NaN", ">inf"] {
        assert!(!page.contains(resource), "'{resource}' in the page");
    }
    assert!(text.contains("left out: gdibl footprint:4"), "{text}");
}

#[test]
fn the_advice_is_flags_that_bake_takes() {
    let folder = Folder::new();
    let text = study(&folder, &["--reference-samples", "1024", "--methods", "path,gdibl", "--at", "0.5"]);
    let advice = text.lines().find(|line| line.contains("advice: ")).expect("advice");
    let flags = advice.split("use ").nth(1).expect("a method comes to 50 %").split(": 50 % of error at 8 nodes").next();
    let bake = repository("assets/uffizi-box/uffizi-box.bake.toml").display().to_string();
    let flags: Vec<&str> = flags.unwrap().split(' ').collect();
    folder.ok(&[&["bake", &bake, "-o", "advised.gdibl", "--counts", "2,2,2"], &flags[..]].concat());
    // Asked for by name, all are drawn.
    let figure = String::from_utf8(folder.read("out.svg")).unwrap();
    assert!(figure.contains(">path<") && figure.contains(">gdibl<"));
}

#[test]
fn a_stopped_study_goes_on_from_the_bakes_that_are_finished() {
    let folder = Folder::new();
    let quick = ["--reference-samples", "64", "--methods", "gdibl,path"];
    study(&folder, &quick);
    assert!(!folder.exists("out.measured"), "nothing is left beside the page");
    let errors = |folder: &Folder| json(folder)["study"]["methods"][0]["points"][0]["error"].clone();
    let whole = errors(&folder);
    // A study that cannot write its page keeps what it measured; what is cut off at the end is measured again.
    let stopped = Folder::new();
    std::fs::create_dir(stopped.path("out.csv")).unwrap();
    let bake = repository("assets/uffizi-box/uffizi-box.bake.toml").display().to_string();
    let arguments = ["study", &bake, "-o", "out", "--counts", "2,2,2", "--budgets", "16,64", "--repeats", "2"];
    assert_ne!(stopped.run(&[&arguments[..], &quick].concat()).code, 0);
    std::fs::remove_dir(stopped.path("out.csv")).unwrap();
    let bytes = stopped.read("out.measured");
    stopped.write("out.measured", &bytes[..bytes.len() - 7]);
    // Other numbers in the file are another study.
    let others = Folder::new();
    others.write("out.measured", &bytes);
    let run = others.run(&[&arguments[..], &quick, &["--precision", "f32"]].concat());
    assert!(run.code == 0 && !run.err.contains("are known"), "{}", run.err);
    study(&stopped, &quick);
    assert_eq!(errors(&stopped), whole);
}

#[test]
fn same_seed_finds_the_same_errors() {
    let errors = |more: &[&str]| {
        let folder = Folder::new();
        let quick = [&["--methods", "gdibl,path", "--reference-samples", "64"], more].concat();
        study(&folder, &quick);
        let report = json(&folder);
        assert_eq!(names(&report), ["gdibl", "gdibl with capture", "path"]);
        let points =
            report["study"]["methods"].as_array().unwrap().iter().flat_map(|m| m["points"].as_array().unwrap());
        points.map(|p| [&p["error"], &p["noise"], &p["bias_square"]].map(Value::clone)).collect::<Vec<_>>()
    };
    let first = errors(&[]);
    assert_eq!(first, errors(&["--threads", "1"]));
    assert_ne!(first, errors(&["--seed", "100"]));
}

#[test]
fn places_of_a_reference_are_the_nodes_unless_flags_say_where() {
    let folder = Folder::new();
    let asset = |name: &str| repository("assets/uffizi-box").join(name).display().to_string();
    let inputs = ["empty-box.glb", "probe_1.exr", "distant.exr", "reference.json"].map(asset);
    let [level, probe, distant, reference] = inputs.each_ref().map(String::as_str);
    let common = ["study", level, "--probes", probe, "--distant", distant, "--reference", reference, "-o", "out"];
    let quick = ["--budgets", "16,64", "--repeats", "2", "--set", "grid", "--methods", "gdibl,gdibl nearest,path"];
    let text = folder.ok(&[&common[..], &quick].concat());
    let report = json(&folder);
    assert_eq!((&report["study"]["nodes"], &report["study"]["places"]), (&json!(64), &json!(64)));
    assert_eq!(names(&report), ["gdibl", "gdibl with capture", "path"]);
    // One probe: nothing is blended, and that is said.
    assert_eq!(report["left_out"][0]["method"], "gdibl nearest");
    assert!(text.contains("left out: gdibl nearest: with fewer than two probes"), "{text}");
    assert!(report["study"]["reference_noise"].as_f64().unwrap() > 0.0);
    // A grid around them is asked between its nodes; a volume is as good a reference.
    let grid = ["--bounds=-1,0,-3,1,2,3", "--counts", "3,3,5"];
    folder.ok(&[&common[..], &quick, &grid].concat());
    let report = json(&folder);
    assert_eq!((&report["study"]["nodes"], &report["study"]["places"]), (&json!(45), &json!(64)));
    let light = ["--distant", distant, "--method", "path", "--samples", "64"];
    folder.bake(&[&[level, "-o", "truth.gdibl", "--seed", "1"], &light[..], &grid].concat());
    let again = ["study", level, "--probes", probe, "--distant", distant, "--reference", "truth.gdibl", "-o", "out"];
    folder.ok(&[&again[..], &grid, &["--budgets", "16", "--repeats", "2", "--methods", "path"]].concat());
    let report = json(&folder);
    assert_eq!((&report["seeds"], &report["reference"]["seed"]), (&json!([2, 3]), &json!(1)), "no seed in common");
}

#[test]
fn level_without_probes_is_captured_as_a_bake_does_and_without_light_there_is_no_truth() {
    let folder = lamp_room(|_| {});
    folder.write("BAKE.toml", "level = \"room.glb\"\n[capture]\nwidth = 16\nsamples = 4\nmost = 2\n");
    let quick = ["--counts", "2,2,2", "--budgets", "16,64", "--repeats", "2", "--methods", "gdibl,path"];
    folder.ok(&[&["study", "BAKE.toml"], &quick[..], &["--quiet"]].concat());
    assert!(!folder.cached().is_empty() && folder.exists("BAKE.study.html"), "{:?}", folder.names());
    let report: Value = serde_json::from_slice(&folder.read("BAKE.study.json")).unwrap();
    assert_eq!(names(&report), ["gdibl", "gdibl with capture", "path"]);
    let about = report["study"]["capture"]["about"].as_str().unwrap();
    assert!(about.starts_with("2 probes, 16 pixels wide, 4 paths per pixel, and finding their places"), "{about}");
    // Probes show light whose source is not in the level.
    Level::room([-2.0; 3], [2.0; 3]).write(&folder, "dark.glb");
    folder.constant("probe.exr", [0.0; 3], [1.0; 3]);
    let dark = [&["study", "dark.glb", "--probes", "probe.exr"], &quick[..6]].concat();
    let run = folder.run(&dark);
    assert_eq!(run.code, 2, "{}", run.err);
    assert!(run.err.contains("path tracing knows no truth") && run.err.contains("--reference"), "{}", run.err);
    // With a given truth it can be studied, and noise is nothing: the furnace.
    folder.bake(&["dark.glb", "--probes", "probe.exr", "--counts", "2,2,2", "--samples", "64", "-o", "truth.gdibl"]);
    folder.ok(&[&dark[..], &["--reference", "truth.gdibl", "-o", "dark"]].concat());
    let report: Value = serde_json::from_slice(&folder.read("dark.json")).unwrap();
    assert_eq!(names(&report), ["gdibl", "gdibl without importance", "gdibl random"]);
    assert_eq!(report["study"]["capture"], Value::Null);
    let left_out = report["left_out"].as_array().unwrap();
    assert!(left_out.iter().any(|l| l["method"] == "path"), "{left_out:?}");
}

#[test]
fn what_makes_no_sense_is_refused_before_anything_is_read() {
    let folder = Folder::new();
    let bake = repository("assets/uffizi-box/uffizi-box.bake.toml").display().to_string();
    for (arguments, words) in [
        (&["--methods", "gdibl,teapot"][..], &["teapot", "gdibl angular:2", "path without importance"][..]),
        (&["--methods", "path,path"], &["path", "twice"]),
        (&["--repeats", "1"], &["--repeats"]),
        (&["--budgets", "64,64"], &["ascending"]),
        (&["--budgets", "0,64"], &["expected 1 to"]),
        (&["--budgets", "1"], &["--budgets 1", "does not know its noise", "64,256,1024"]),
        (&["--at", "0"], &["--at 0"]),
        (&["--samples", "64"], &["--samples", "--budgets"]),
        (&["--method", "path"], &["--method", "--methods"]),
        (&["--set", "grid"], &["--reference"]),
        (&["--methods", "gdibl footprint:4"], &["none is left", "is what gdibl does here"]),
    ] {
        let run = folder.run(&[&["study", &bake, "-o", "out"], arguments].concat());
        assert_eq!(run.code, 2, "{arguments:?}: {}", run.err);
        words.iter().for_each(|word| assert!(run.err.contains(word), "{arguments:?}: no '{word}' in {}", run.err));
    }
    assert!(folder.names().is_empty());
}
