//! `gdibl cut`: what it writes, what it says of it, and what it refuses.

use crate::common::{Folder, csv_of, repository};
use gdibl_runtime::Volume;
use serde_json::Value;

/// The shipped box, small.
fn bake_box(folder: &Folder, more: &[&str]) {
    let project = repository("assets/uffizi-box/uffizi-box.bake.toml").display().to_string();
    let all = [&[project.as_str(), "-o", "box.gdibl", "--counts", "9,9,17", "--samples", "512"], more].concat();
    folder.bake(&all);
}

fn cut(folder: &Folder, more: &[&str]) -> Value {
    let out = folder.ok(&[&["cut", "box.gdibl", "--json"], more].concat());
    serde_json::from_str(&out).expect("cut --json prints JSON")
}

fn parse(folder: &Folder, name: &str) -> Volume {
    Volume::parse(&folder.read(name)).unwrap()
}

#[test]
fn cuts_are_volumes_that_tell_what_they_lose() {
    let folder = Folder::new();
    bake_box(&folder, &["--precision", "f16"]);
    let whole = folder.read("box.gdibl").len();
    for (more, nodes, least) in [
        (&["--precision", "packed"][..], 1377, 0.001),
        (&["--coarser", "1"], 225, 0.004),
        (&["--coarser", "2"], 45, 0.01),
        (&["--sh", "L1", "--zstd"], 1377, 0.03),
    ] {
        let report = cut(&folder, &[more, &["-o", "cut.gdibl"]].concat());
        let off = report["difference"]["median"].as_f64().unwrap();
        assert!(off >= least && off < 0.3, "{more:?}: {off}");
        assert_eq!(report["files"][0]["nodes"], nodes, "{more:?}");
        assert_eq!(report["files"][0]["bytes"], folder.read("cut.gdibl").len());
        assert!(folder.read("cut.gdibl").len() < whole, "{more:?}");
        let inspected = folder.inspect("cut.gdibl");
        assert_eq!(inspected["statistics"]["nodes"], nodes);
        assert!(inspected["statistics"]["seen"].is_null(), "it was measured of the whole");
        assert_eq!(inspected["volume"]["nodes_valid"], inspected["statistics"]["nodes_valid"]);
        assert_eq!(inspected["settings"], folder.inspect("box.gdibl")["settings"]);
        let plan = inspected["plan"].as_array().unwrap().last().unwrap().clone();
        assert!(plan["stage"] == "cut" && plan["why"].as_str().unwrap().contains("1377 nodes of box.gdibl"), "{plan}");
    }
}

#[test]
fn tiles_are_listed_and_hold_the_volume() {
    let folder = Folder::new();
    bake_box(&folder, &["--dering"]);
    let report = cut(&folder, &["--tile", "1.0", "-o", "tiles"]);
    let list: Value = serde_json::from_slice(&folder.read("tiles/tiles.json")).unwrap();
    let tiles = list["tiles"].as_array().unwrap();
    assert!(tiles.len() > 4, "{list}");
    assert_eq!(&list["tiles"], &report["files"]);
    assert!(report["difference"]["max"].as_f64().unwrap() < 1e-3, "{report}");
    let whole = parse(&folder, "box.gdibl");
    for tile in tiles {
        let name = format!("tiles/{}", tile["file"].as_str().unwrap());
        let volume = parse(&folder, &name);
        assert_eq!(tile["nodes"], volume.node_count());
        assert_eq!(volume.header().is_deringed(), whole.header().is_deringed());
        let middle = std::array::from_fn(|axis| 0.5 * (volume.header().min[axis] + volume.header().max[axis]));
        assert_eq!(tile["min"][0].as_f64().unwrap(), volume.header().min[0]);
        let (a, b) = (volume.sample_f64(middle, [0.0; 3]), whole.sample_f64(middle, [0.0; 3]));
        assert!(
            a.inside && (a.sh.coefficients[0][1] - b.sh.coefficients[0][1]).abs() <= 1e-3 * b.sh.coefficients[0][1]
        );
    }
    let single = cut(&folder, &["--tile", "100", "--coarser", "1", "-o", "one"]);
    assert_eq!((single["files"].as_array().unwrap().len(), &single["files"][0]["nodes"]), (1, &Value::from(225)));
}

#[test]
fn what_cannot_be_cut_is_refused() {
    let folder = Folder::new();
    folder.write("broken.gdibl", b"\x89GDIBL\n\x1a");
    folder.sky("sky.exr", [1.0; 3]);
    folder.write("nothing.gltf", r#"{ "asset": { "version": "2.0" }, "scene": 0, "scenes": [{}] }"#);
    folder.write("places.csv", csv_of(&[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]));
    folder.bake(&["nothing.gltf", "--distant", "sky.exr", "--nodes", "points:places.csv", "-o", "points.gdibl"]);
    folder.bake(&[
        "nothing.gltf",
        "--distant",
        "sky.exr",
        "--bounds",
        "0,0,0,1,1,1",
        "--counts",
        "3,1,2",
        "-o",
        "flat.gdibl",
    ]);
    let before = folder.names();
    for (code, arguments, said) in [
        (2, &["flat.gdibl", "-o", "out"][..], "--coarser"),
        (2, &["flat.gdibl", "--coarser", "0", "-o", "out"], "coarser"),
        (2, &["flat.gdibl", "--tile", "0", "-o", "out"], "metres"),
        (2, &["flat.gdibl", "--sh", "auto", "-o", "out"], "L0, L1"),
        (4, &["points.gdibl", "--coarser", "1", "-o", "out"], "points"),
        (3, &["broken.gdibl", "--coarser", "1", "-o", "out"], "broken.gdibl"),
        (3, &["missing.gdibl", "--coarser", "1", "-o", "out"], "missing.gdibl"),
        (1, &["flat.gdibl", "--coarser", "1", "-o", "nowhere/out"], "nowhere"),
    ] {
        let run = folder.run(&[&["cut"], arguments].concat());
        assert_eq!(run.code, code, "{arguments:?}: {}", run.err);
        assert!(run.err.contains(said), "{arguments:?}: {}", run.err);
        assert_eq!(folder.names(), before, "{arguments:?} left a file");
    }
    // A flat axis stays as it is.
    let out = folder.ok(&["cut", "flat.gdibl", "--coarser", "1", "-o", "coarse.gdibl"]);
    assert!(out.contains("nodes      4, 66.7 % of 6"), "{out}");
    assert_eq!(folder.inspect("coarse.gdibl")["grid"]["counts"], serde_json::json!([2, 1, 2]));
}
