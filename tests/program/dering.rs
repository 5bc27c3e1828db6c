//! `bake --dering`: no negative irradiance, said in the file and by every verb that reads it.

use crate::common::{Folder, Level, csv_of, normals, solid_of};
use crate::reader::read_independently;
use gdibl_runtime::Volume;
use serde_json::Value;

/// A stone under a sun in one pixel of a dim sky; one point in the open, one under the stone.
fn stone_in_the_sun() -> Folder {
    let folder = Folder::new();
    let mut level = Level::room([-90.0; 3], [-89.0; 3]);
    level.object(&solid_of([-1.0, 2.0, -1.0], [1.0, 2.5, 1.0]), 0, serde_json::json!({}));
    level.write(&folder, "stone.glb");
    folder.panorama("sky.exr", 64, None, |d| if d.y > 0.998 { [900.0, 800.0, 500.0] } else { [0.05, 0.1, 0.2] });
    folder.write("points.csv", csv_of(&[[6.0, 0.0, 0.0], [0.0, 1.9, 0.0]]));
    folder
}

/// Half floats, in which what does not ring stays to the bit.
const STONE: [&str; 10] = [
    "stone.glb",
    "--distant",
    "sky.exr",
    "--method",
    "path",
    "--nodes",
    "points:points.csv",
    "--quiet",
    "--precision",
    "f16",
];

#[test]
fn dering_leaves_no_negative_irradiance_and_every_verb_says_so() {
    let folder = stone_in_the_sun();
    let raw = folder.bake(&[&STONE[..], &["-o", "raw.gdibl"]].concat());
    assert_eq!(raw["deringing"], Value::Null);
    let report = folder.bake(&[&STONE[..], &["--dering", "-o", "kept.gdibl"]].concat());
    assert_eq!(report["deringing"]["nodes"], 1, "{report}");
    let change = report["deringing"]["relative_change"]["max"].as_f64().unwrap();
    assert!((0.01..0.12).contains(&change), "{change}");
    let row = |report: &Value| {
        let rows = report["plan"].as_array().unwrap().clone();
        rows.into_iter().find(|row| row["stage"] == "deringing")
    };
    assert_eq!(row(&raw), None);
    assert_eq!(row(&report).unwrap()["kept"], true);

    let (before, after) = (folder.inspect("raw.gdibl"), folder.inspect("kept.gdibl"));
    assert_eq!((&before["deringed"], &after["deringed"]), (&false.into(), &true.into()));
    assert_eq!((&before["volume"]["nodes_negative"], &after["volume"]["nodes_negative"]), (&1.into(), &0.into()));
    assert_eq!(after["statistics"]["deringing"], report["deringing"]);
    let text = folder.ok(&["inspect", "kept.gdibl"]);
    assert!(text.contains("de-ringed") && text.contains("1 nodes"), "{text}");

    // The node that does not ring, and band 0, stay to the bit.
    let volume = |name| Volume::parse(&folder.read(name)).unwrap();
    let (before, after) = (volume("raw.gdibl"), volume("kept.gdibl"));
    assert_eq!(before.node_sh(1), after.node_sh(1));
    assert_ne!(before.node_sh(0), after.node_sh(0));
    assert_eq!(before.node_sh(0).coefficients[0], after.node_sh(0).coefficients[0]);

    // By sample, and by the reader that knows FORMAT.md alone.
    let places: Vec<[f64; 6]> = normals().iter().map(|n| [6.0, 0.0, 0.0, n.x, n.y, n.z]).collect();
    let sampled = folder.irradiance("kept.gdibl", &places);
    assert!(sampled.iter().all(|row| row[..3].iter().all(|e| *e >= -1e-5)), "{sampled:?}");
    if let Some(read) = read_independently(&folder, "kept.gdibl", &places) {
        for (ours, theirs) in sampled.iter().zip(&read) {
            assert!((0..3).all(|c| (ours[c] - theirs[c]).abs() < 1e-4), "{ours:?} {theirs:?}");
        }
    }
    folder.write("one.csv", csv_of(&[[6.0, 0.0, 0.0]]));
    let said = folder.run(&["sample", "kept.gdibl", "--at", "one.csv", "--sh"]).err;
    assert!(said.contains("kept.gdibl is de-ringed"), "{said}");
    assert_eq!(folder.run(&["sample", "raw.gdibl", "--at", "one.csv", "--sh"]).err, "");
    let compared = folder.ok(&["compare", "kept.gdibl", "raw.gdibl"]);
    assert!(compared.contains("kept.gdibl is de-ringed") && !compared.contains("raw.gdibl is"), "{compared}");
}

#[test]
fn where_nothing_rings_dering_changes_nothing_but_the_plan() {
    let folder = stone_in_the_sun();
    folder.sky("sky.exr", [0.5, 0.6, 0.7]);
    folder.write(
        "BAKE.toml",
        "level = \"stone.glb\"\ndistant = \"sky.exr\"\n[quality]\ndering = true\nmethod = \"path\"\nprecision = \"f16\"\n[grid]\nnodes = \
         \"points:points.csv\"\n",
    );
    folder.bake(&[&STONE[..], &["-o", "raw.gdibl"]].concat());
    let report = folder.bake(&["BAKE.toml", "-o", "kept.gdibl"]);
    assert_eq!(report["deringing"], Value::Null);
    let row = report["plan"].as_array().unwrap().iter().find(|row| row["stage"] == "deringing").unwrap().clone();
    assert_eq!((&row["kept"], &row["why"]), (&false.into(), &"no node rings".into()));
    assert_eq!(folder.inspect("kept.gdibl")["deringed"], false);
    let volume = |name| Volume::parse(&folder.read(name)).unwrap();
    let (before, after) = (volume("raw.gdibl"), volume("kept.gdibl"));
    assert!((0..2).all(|node| before.node_sh(node) == after.node_sh(node)));
    // Whether a node rings, only the bake can tell.
    let plan = folder.ok(&["bake", "BAKE.toml", "--plan"]);
    assert!(plan.contains("deringing"), "{plan}");
}
