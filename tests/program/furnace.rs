//! White surroundings of radiance L give E = πL, wherever they stand.

use crate::common::{Folder, Level, box_of, normals};
use serde_json::json;
use std::f64::consts::PI;

const RADIANCE: [f32; 3] = [0.25, 1.0, 40.0];

/// Largest relative error of E over places × 26 normals.
fn worst_error(folder: &Folder, volume: &str, places: &[[f64; 3]]) -> f64 {
    let rows: Vec<[f64; 6]> =
        places.iter().flat_map(|&[x, y, z]| normals().into_iter().map(move |n| [x, y, z, n.x, n.y, n.z])).collect();
    let mut worst = 0.0f64;
    for found in folder.irradiance(volume, &rows) {
        assert_eq!(found[3], 1.0, "validity");
        for (e, l) in found.iter().zip(RADIANCE) {
            worst = worst.max((e / (PI * f64::from(l)) - 1.0).abs());
        }
    }
    worst
}

#[test]
fn closed_room_of_constant_radiance_gives_pi_l_at_any_distance_from_the_origin() {
    for offset in [[0.0; 3], [1e4, -1e4, 1e4], [1e6, 1e6, -1e6]] {
        let folder = Folder::new();
        let mut level = Level::new();
        level.object(&box_of([-2.0, -1.0, -3.0], [2.0, 2.0, 1.5]), 0, json!({ "translation": offset }));
        level.write(&folder, "room.glb");
        let at = |p: [f64; 3]| [0, 1, 2].map(|axis| offset[axis] + p[axis]);
        // The header's position is single precision, and wrong: BAKE.toml's counts.
        folder.constant("a.exr", [7.0; 3], RADIANCE);
        folder.panorama("b.exr", 512, None, |_| RADIANCE);
        let probe = |image: &str, p| format!("[[probe]]\nimage = \"{image}\"\nposition = {:?}\n", at(p));
        let toml = format!(
            "level = \"room.glb\"\n{}{}[grid]\nbounds = {:?}\ncounts = [3, 2, 2]\n",
            probe("a.exr", [-1.3, 0.2, -2.1]),
            probe("b.exr", [1.1, 1.0, 0.7]),
            [at([-1.5, -0.5, -2.5]), at([1.5, 1.5, 1.0])].concat(),
        );
        folder.write("BAKE.toml", toml);
        // At nodes and between them.
        let places = [[-1.5, -0.5, -2.5], [0.0, 1.5, 1.0], [1.5, -0.5, 1.0], [0.3, 0.1, -0.7], [9.0, 0.0, 0.0]].map(at);
        for (precision, tolerance) in [("f32", 1e-4), ("f16", 6e-4)] {
            let report = folder.bake(&["BAKE.toml", "--precision", precision, "-o", "room.gdibl"]);
            assert!(report["coverage"].as_f64().unwrap() > 0.999, "{offset:?}: {report}");
            assert_eq!((&report["nodes"], &report["nodes_valid"]), (&json!(12), &json!(12)));
            let worst = worst_error(&folder, "room.gdibl", &places);
            println!("furnace {offset:?} {precision}: {worst:.2e}");
            assert!(worst <= tolerance, "{offset:?} {precision}: {worst:.2e}");
        }
    }
}

#[test]
fn level_without_triangles_is_plain_image_based_lighting() {
    let folder = Folder::new();
    Level::new().write(&folder, "empty.glb");
    folder.sky("sky.exr", RADIANCE);
    let arguments = ["empty.glb", "--distant", "sky.exr", "--precision", "f32", "--counts", "2,2,2"];
    let report = folder.bake(&[&arguments[..], &["--bounds", "-1,-1,-1,1,1,1"]].concat());
    assert_eq!((&report["coverage"], &report["nodes_valid"]), (&json!(null), &json!(8)));
    let worst = worst_error(&folder, "empty.gdibl", &[[0.0; 3], [1.0, -1.0, 0.5]]);
    println!("furnace, sky alone: {worst:.2e}");
    assert!(worst <= 1e-4, "{worst:.2e}");

    let without_box = folder.run(&[&["bake"], &arguments[..]].concat());
    assert_eq!(without_box.code, 2, "{}", without_box.err);
    assert!(without_box.err.contains("--bounds") && without_box.err.contains("empty.glb"), "{}", without_box.err);
}
