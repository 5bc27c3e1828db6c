//! Scene geometry, walls, holes, and what no probe has seen.

use crate::common::{Folder, Level, box_of, csv_of, panel, solid_of, square_solid_angle};
use serde_json::{Value, json};
use std::f64::consts::PI;

/// Bakes the points and returns, per point, the mean radiance over the sphere (red) and validity.
fn mean_light(folder: &Folder, level: &Level, points: &[[f64; 3]], arguments: &[&str]) -> (Value, Vec<[f64; 2]>) {
    level.write(folder, "level.glb");
    folder.write("points.csv", csv_of(points));
    let common = ["level.glb", "--nodes", "points:points.csv", "--precision", "f32", "--sh", "L0"];
    let report = folder.bake(&[&common, arguments].concat());
    let rows = folder.coefficients("level.gdibl", points);
    (report, rows.iter().map(|row| [row[0] / (4.0 * PI).sqrt(), row[3]]).collect())
}

/// A closed room of radiance `light`, seen from its upper half, with the cube |x|, |y|, |z| <= 0.5 in it.
fn room_with_cube(light: f32, material: Value) -> (Folder, Level) {
    let folder = Folder::new();
    let mut level = Level::room([-3.0; 3], [3.0; 3]);
    // Black walls: the cube neither shades nor lights them.
    level.json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = json!([0.0, 0.0, 0.0, 1.0]);
    let material = level.material(material);
    level.scene_object(&solid_of([-0.5; 3], [0.5; 3]), material);
    folder.constant("probe.exr", [0.0, 2.0, 0.0], [light; 3]);
    (folder, level)
}

/// What the cube covers of the sphere around `NODE`: its front face alone is seen.
fn cube_share() -> f64 {
    square_solid_angle(0.5, 1.5) / (4.0 * PI)
}
const NODE: [f64; 3] = [0.0, 0.0, -2.0];

#[test]
fn scene_geometry_occludes_or_reflects_its_albedo() {
    let dull = |albedo: f64| json!({ "pbrMetallicRoughness": { "metallicFactor": 0.0, "baseColorFactor": [albedo, 1.0, 1.0, 1.0] } });
    // A ray off a convex object finds the room: one bounce, albedo × 1. 4096 samples of a share known to a few 1e-4.
    // At depth 0 what the cube reflects is unknown: filled from the room, and counted as uncovered.
    for (albedo, scene, expected, coverage) in [
        (1.0, "recurse:3", 1.0, 1.0),
        (0.5, "recurse:1", 1.0 - 0.5 * cube_share(), 1.0),
        (0.5, "recurse:0", 1.0, 1.0 - cube_share()),
        (0.5, "occlude", 1.0 - cube_share(), 1.0),
    ] {
        let (folder, level) = room_with_cube(1.0, dull(albedo));
        let (report, found) = mean_light(&folder, &level, &[NODE], &["--probes", "probe.exr", "--scene", scene]);
        assert!((found[0][0] - expected).abs() < 2e-3, "{albedo} {scene}: {found:?}, expected {expected}");
        // Scene geometry hides nothing from the probe.
        assert!((report["coverage"].as_f64().unwrap() - coverage).abs() < 2e-3, "{scene}: {}", report["coverage"]);
    }
}

#[test]
fn glowing_scene_geometry_lights_nodes() {
    let lamp = json!({ "emissiveFactor": [1.0, 1.0, 1.0], "pbrMetallicRoughness": { "baseColorFactor": [0, 0, 0, 1] },
        "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 50.0 } } });
    let (folder, mut level) = room_with_cube(0.0, lamp);
    level.json["extensionsUsed"] = json!(["KHR_materials_emissive_strength"]);
    let (_, found) = mean_light(&folder, &level, &[NODE], &["--probes", "probe.exr", "--samples", "65536"]);
    let expected = 50.0 * cube_share();
    assert!((found[0][0] / expected - 1.0).abs() < 5e-3, "{found:?}, expected {expected}");
    // It occludes in the report's own manner: black.
    let (_, found) = mean_light(&folder, &level, &[NODE], &["--probes", "probe.exr", "--scene", "occlude"]);
    assert_eq!(found[0][0], 0.0);
}

/// Alpha of a box around the node, of scene geometry that reflects nothing, under a sky of radiance 1.
fn light_through(material: Value) -> f64 {
    let folder = Folder::new();
    folder.sky("sky.exr", [1.0; 3]);
    let mut level = Level::new();
    let material = level.material(material);
    level.scene_object(&box_of([-1.0; 3], [1.0; 3]), material);
    let (_, found) =
        mean_light(&folder, &level, &[[0.1, 0.2, 0.3]], &["--distant", "sky.exr", "--method", "gdibl", "--no-capture"]);
    found[0][0]
}

#[test]
fn masked_holes_let_light_through_and_blended_surfaces_a_share_of_it() {
    let black = |alpha: f64| json!({ "baseColorFactor": [0.0, 0.0, 0.0, alpha] });
    let masked = |alpha: f64| json!({ "alphaMode": "MASK", "alphaCutoff": 0.5, "pbrMetallicRoughness": black(alpha) });
    let blended = |alpha: f64| json!({ "alphaMode": "BLEND", "pbrMetallicRoughness": black(alpha) });
    for (name, material, expected) in [
        ("opaque", json!({ "pbrMetallicRoughness": black(0.3) }), 0.0),
        ("hole", masked(0.3), 1.0),
        ("no hole", masked(0.7), 0.0),
        ("half", blended(0.5), 0.5),
        ("nearly clear", blended(0.125), 0.875),
        ("clear", blended(0.0), 1.0),
    ] {
        let found = light_through(material);
        assert!((found - expected).abs() < 1e-4, "{name}: {found}, expected {expected}");
    }
}

#[test]
fn lines_of_sight_pass_holes_and_clear_surfaces_and_no_others() {
    // A partition across the room; the probe stands behind it and the node before it.
    let found = |alpha_mode: &str| {
        let folder = Folder::new();
        let mut level = Level::room([-2.0; 3], [2.0; 3]);
        let glass = level.material(json!({ "alphaMode": alpha_mode, "alphaCutoff": 0.5,
            "pbrMetallicRoughness": { "baseColorFactor": [1.0, 1.0, 1.0, 0.25] } }));
        level.object(&panel(2.0, 0.0), glass, json!({}));
        folder.constant("probe.exr", [0.0, 0.0, 1.0], [3.0; 3]);
        level.write(&folder, "level.glb");
        folder.write("points.csv", "0,0,-1\n");
        let run = folder.run(&["bake", "level.glb", "--nodes", "points:points.csv", "--probes", "probe.exr", "--json"]);
        (run.code, serde_json::from_str::<Value>(&run.out).ok().and_then(|report| report["coverage"].as_f64()))
    };
    assert_eq!(found("OPAQUE"), (5, None), "the probe has seen nothing that the node sees");
    assert_eq!(found("MASK"), (0, Some(1.0)), "the partition is all hole");
    let (code, coverage) = found("BLEND");
    // The walls count in full; the quarter that the partition holds back comes from its front, unseen by the probe.
    let partition = square_solid_angle(2.0, 1.0) / (4.0 * PI);
    assert_eq!(code, 0);
    assert!((coverage.unwrap() - (1.0 - 0.25 * partition)).abs() < 2e-3, "{coverage:?}");
}

#[test]
fn node_behind_glass_on_all_sides_is_valid_and_partly_covered() {
    // Every direction is covered by three quarters: what the glass holds back comes from its inside, which no probe
    // has seen. (A node without one fully covered direction was marked invalid.)
    let folder = Folder::new();
    folder.sky("sky.exr", [1.0; 3]);
    let mut level = Level::new();
    let glass = level.material(json!({ "alphaMode": "BLEND",
        "pbrMetallicRoughness": { "baseColorFactor": [1.0, 1.0, 1.0, 0.25] } }));
    level.object(&box_of([-0.5; 3], [0.5; 3]), glass, json!({}));
    let (report, found) =
        mean_light(&folder, &level, &[[0.0; 3]], &["--distant", "sky.exr", "--method", "gdibl", "--no-capture"]);
    assert_eq!(report["nodes_valid"], 1);
    assert!((report["coverage"].as_f64().unwrap() - 0.75).abs() < 1e-3, "{}", report["coverage"]);
    assert!((found[0][0] - 1.0).abs() < 1e-3 && found[0][1] == 1.0, "{found:?}");
}

#[test]
fn bright_room_does_not_shine_into_the_dark_room_behind_the_wall() {
    // Two closed rooms side by side along x, `wall` apart; 0 is one sheet of triangles, shared.
    for wall in [0.1f32, 0.01, 0.001, 0.0] {
        for offset in [[0.0, 0.0, 0.0], [1e4, 0.0, -1e4]] {
            let folder = Folder::new();
            let mut level = Level::new();
            let node = json!({ "translation": offset });
            level.object(&box_of([-4.0, -1.5, -2.0], [0.0, 1.5, 2.0]), 0, node.clone());
            level.object(&box_of([wall, -1.5, -2.0], [4.0, 1.5, 2.0]), 0, node);
            let at = |p: [f64; 3]| [0, 1, 2].map(|axis| p[axis] + offset[axis]);
            folder.constant("bright.exr", at([-1.0, 0.0, 0.0]), [1.0; 3]);
            folder.constant("dark.exr", at([1.0, 0.0, 0.0]), [0.0; 3]);
            let near = f64::from(wall);
            // Close to the wall, in corners, far away; and across, the bright room.
            let mut points: Vec<[f64; 3]> = Vec::new();
            for x in [near + 1e-3, near + 0.02, 0.5, 2.0, 3.99] {
                points.extend([[x, 0.0, 0.0], [x, 1.49, 1.99], [x, -1.49, 0.5]].map(at));
            }
            let dark = points.len();
            points.extend([[-0.001, 0.0, 0.0], [-2.0, 1.0, 1.0], [-3.99, -1.49, -1.99]].map(at));
            let probes = ["--probes", "bright.exr", "--probes", "dark.exr", "--samples", "2048"];
            let (_, found) = mean_light(&folder, &level, &points, &probes);
            for (point, [light, valid]) in points.iter().zip(&found).take(dark) {
                assert!(*light < 1e-3 && *valid == 1.0, "wall {wall}, {point:?}: {light}, valid {valid}");
            }
            for (point, [light, _]) in points.iter().zip(&found).skip(dark) {
                assert!((light - 1.0).abs() < 1e-3, "wall {wall}, {point:?}: {light}");
            }
        }
    }
}

#[test]
fn probe_beyond_the_wall_lends_nothing_and_the_room_without_one_is_invalid() {
    let folder = Folder::new();
    let mut level = Level::room([-4.0, -1.5, -2.0], [0.0, 1.5, 2.0]);
    level.object(&box_of([0.01, -1.5, -2.0], [4.0, 1.5, 2.0]), 0, json!({}));
    folder.constant("bright.exr", [-1.0, 0.0, 0.0], [1.0; 3]);
    // Alone in the dark room: nothing to bake, said so, and no file.
    level.write(&folder, "level.glb");
    folder.write("points.csv", "1,0,0\n3,1,1\n");
    let arguments = ["bake", "level.glb", "--nodes", "points:points.csv", "--probes", "bright.exr"];
    let run = folder.run(&arguments);
    assert_eq!(run.code, 5, "{}", run.err);
    assert!(run.err.contains("nothing was written"), "{}", run.err);
    assert!(!folder.exists("level.gdibl"));
    // Beside nodes of the bright room: marked invalid, filled, and counted.
    let points = [[1.0, 0.0, 0.0], [-2.0, 0.0, 0.0]];
    let (report, found) = mean_light(&folder, &level, &points, &["--probes", "bright.exr"]);
    assert_eq!((&report["nodes"], &report["nodes_valid"]), (&json!(2), &json!(1)));
    assert!((report["coverage"].as_f64().unwrap() - 0.5).abs() < 1e-6);
    assert_eq!([found[0][1], found[1][1]], [0.0, 1.0], "validity");
    assert!((found[0][0] - 1.0).abs() < 1e-3, "filled from the valid node: {found:?}");
}

#[test]
fn uncovered_part_is_filled_from_what_is_seen_and_its_share_reported() {
    // A square before the node that no probe has seen, under a sky of constant light.
    for half in [0.2f32, 1.0, 5.0] {
        let folder = Folder::new();
        folder.sky("sky.exr", [2.0; 3]);
        let mut level = Level::new();
        level.object(&panel(half, 1.0), 0, json!({}));
        let (report, found) =
            mean_light(&folder, &level, &[[0.0; 3]], &["--distant", "sky.exr", "--method", "gdibl", "--no-capture"]);
        let expected = 1.0 - square_solid_angle(half.into(), 1.0) / (4.0 * PI);
        let coverage = report["coverage"].as_f64().unwrap();
        println!("coverage {coverage:.5}, expected {expected:.5}");
        assert!((coverage - expected).abs() < 5e-3, "half {half}: {coverage}, expected {expected}");
        assert!((found[0][0] / 2.0 - 1.0).abs() < 1e-3, "half {half}: {found:?}");
    }
}

#[test]
fn closed_level_under_a_sky_without_probe_is_refused_or_said_to_be_dark() {
    let folder = Folder::new();
    Level::room([-2.0; 3], [2.0; 3]).write(&folder, "level.glb");
    folder.sky("sky.exr", [1.0; 3]);
    let grid = ["--counts", "3,3,3", "--bounds", "-1,-1,-1,1,1,1", "--samples", "64"];
    let forbidden = ["bake", "level.glb", "--distant", "sky.exr", "--method", "gdibl", "--no-capture"];
    let run = folder.run(&[&forbidden[..], &grid[..]].concat());
    assert_eq!(run.code, 5, "{}", run.err);
    assert!(run.err.contains("27 saw nothing that a probe"), "{}", run.err);
    assert_eq!(folder.names(), ["level.glb", "sky.exr"]);
    // Captured probes are black, and so is the volume: it says so.
    folder.write(
        "BAKE.toml",
        "level = \"level.glb\"\ndistant = \"sky.exr\"\nquality.method = \"gdibl\"\n[capture]\nwidth = 8\nsamples = 1\nmost = 1",
    );
    for method in ["gdibl", "path"] {
        let run = folder.run(&[&["bake", "BAKE.toml", "--method", method], &grid[..]].concat());
        assert_eq!(run.code, 0, "{}", run.err);
        assert!(run.err.contains("no light reaches"), "{}", run.err);
    }
    // Without any light at all it is said before baking.
    let run = folder.run(&["bake", "level.glb"]);
    assert_eq!(run.code, 5, "{}", run.err);
    assert!(run.err.contains("nothing gives light"), "{}", run.err);
}

#[test]
fn nodes_in_solids_are_invalid_and_probes_in_solids_lend_nothing() {
    let folder = Folder::new();
    let mut level = Level::room([-3.0; 3], [3.0; 3]);
    level.object(&solid_of([-0.5; 3], [0.5; 3]), 0, json!({}));
    folder.constant("good.exr", [0.0, 2.0, 0.0], [1.0; 3]);
    folder.constant("buried.exr", [0.0, 0.1, 0.0], [1e6; 3]);
    let points = [[0.0, 2.9, 0.0], [0.1, -0.2, 0.3]];
    // A node in the solid: invalid and filled, never silently dark.
    let (report, found) = mean_light(&folder, &level, &points, &["--probes", "good.exr"]);
    assert_eq!(report["nodes_valid"], 1);
    assert_eq!(found[1][1], 0.0);
    assert!((found[1][0] - 1.0).abs() < 1e-3, "{found:?}");
    // A buried probe sees the solid's inside only: it lends the room nothing, and in the solid nobody asks.
    let both = ["--probes", "good.exr", "--probes", "buried.exr"];
    let (report, found) = mean_light(&folder, &level, &points, &both);
    assert_eq!(report["nodes_valid"], 1);
    assert_eq!(report["standing"], json!({ "uncovered": 0, "solid": 1, "outside": 0, "moved": 0 }));
    assert!(found.iter().all(|[light, _]| (light - 1.0).abs() < 1e-3), "{found:?}");
    // Alone, it can light no node of the room: said, not baked black.
    folder.write("points.csv", csv_of(&points[..1]));
    let arguments = ["bake", "level.glb", "--nodes", "points:points.csv", "--probes", "buried.exr", "-o", "x.gdibl"];
    let run = folder.run(&arguments);
    assert_eq!(run.code, 5, "{}", run.err);
    assert!(run.err.contains("not in a wall") && !folder.exists("x.gdibl"), "{}", run.err);
}

#[test]
fn nodes_and_probes_on_walls_in_corners_and_at_one_place_are_lit() {
    let folder = Folder::new();
    let level = Level::room([-2.0; 3], [2.0; 3]);
    folder.constant("on_wall.exr", [0.0, 0.0, 2.0], [1.0; 3]);
    folder.constant("inside.exr", [0.5, 0.5, 0.5], [1.0; 3]);
    let points = [[2.0, 0.0, 0.0], [-2.0, -2.0, -2.0], [2.0, 2.0, 0.0], [0.5, 0.5, 0.5], [0.0, 0.0, 2.0]];
    let (report, found) = mean_light(&folder, &level, &points, &["--probes", "inside.exr"]);
    assert_eq!(report["nodes_valid"], 5);
    for (point, [light, _]) in points.iter().zip(&found) {
        assert!((light - 1.0).abs() < 1e-3, "{point:?}: {light}");
    }
    // A probe on a wall has not seen that wall: coverage says so, light is filled.
    let (report, found) = mean_light(&folder, &level, &[[0.0; 3]], &["--probes", "on_wall.exr"]);
    let coverage = report["coverage"].as_f64().unwrap();
    assert!((coverage - 5.0 / 6.0).abs() < 0.03, "{coverage}");
    assert!((found[0][0] - 1.0).abs() < 1e-3, "{found:?}");
}

#[test]
fn broken_triangles_are_counted_and_change_nothing() {
    let folder = Folder::new();
    let mut level = Level::room([-2.0; 3], [2.0; 3]);
    let nan = f32::NAN;
    let bad = [
        [[0.0, 0.0, 0.0], [1.0, 0.0, nan], [0.0, 1.0, 0.0]],
        [[f32::INFINITY, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        [[0.0; 3], [0.0; 3], [1.0, 0.0, 0.0]],
        [[0.0; 3], [0.5, 0.5, 0.5], [1.0, 1.0, 1.0]],
    ];
    level.object(&bad, 0, json!({}));
    // The bounds of an accessor with NaN are not the point here.
    level.json["accessors"][1].as_object_mut().unwrap().retain(|key, _| key != "min" && key != "max");
    // A wall once more, and a sliver of a micrometre along it.
    level.object(&panel(2.0, 2.0), 0, json!({}));
    level.object(&[[[-2.0, -2.0, 1.9], [2.0, -2.0, 1.9], [2.0, -1.999_999, 1.9]]], 0, json!({}));
    folder.constant("probe.exr", [0.0, 0.5, 0.0], [1.0; 3]);
    let (report, found) = mean_light(&folder, &level, &[[0.3, 0.2, 0.1]], &["--probes", "probe.exr"]);
    assert!((found[0][0] - 1.0).abs() < 1e-4, "{found:?}");
    assert!(report["coverage"].as_f64().unwrap() > 0.999);
    let count = |id: &str| {
        let findings = report["findings"].as_array().unwrap();
        findings.iter().find(|f| f["id"] == id).map(|f| f["count"].as_u64().unwrap())
    };
    assert_eq!((count("non-finite-triangles"), count("zero-area-triangles")), (Some(2), Some(2)));
}

#[test]
fn scene_geometry_shades_the_walls_around_it() {
    // White walls of radiance 1 and a black cube: light that came by way of the cube is missing on the walls, so the
    // node sees less than the cube alone hides. Grey walls miss less of it.
    let black = json!({ "pbrMetallicRoughness": { "metallicFactor": 0.0, "baseColorFactor": [0, 0, 0, 1] } });
    let light = |wall: f64| {
        let (folder, mut level) = room_with_cube(1.0, black.clone());
        level.json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = json!([wall, wall, wall, 1.0]);
        mean_light(&folder, &level, &[NODE], &["--probes", "probe.exr"]).1[0][0]
    };
    let [none, half, most] = [0.0, 0.5, 0.8].map(light);
    assert!((none - (1.0 - cube_share())).abs() < 2e-3, "{none}");
    assert!(half < none - 0.005 && most < half - 0.01, "{none} {half} {most}");
}

#[test]
fn outermost_nodes_of_a_grid_stay_in_the_room() {
    // The default grid's outer nodes lie in the walls of a dark closed room under a bright sky.
    let folder = Folder::new();
    Level::room([-1.0; 3], [1.0; 3]).write(&folder, "level.glb");
    folder.constant("probe.exr", [0.1, 0.2, 0.3], [0.0; 3]);
    folder.sky("sky.exr", [1.0; 3]);
    let arguments =
        ["level.glb", "--probes", "probe.exr", "--distant", "sky.exr", "--counts", "3,3,3", "--samples", "512"];
    folder.bake(&[&arguments[..], &["--precision", "f32"]].concat());
    let places: Vec<[f64; 3]> = (0..27).map(|i| [i % 3, i / 3 % 3, i / 9].map(|k| f64::from(k) - 1.0)).collect();
    for row in folder.coefficients("level.gdibl", &places) {
        assert!(row[0].abs() < 1e-6, "{row:?}");
    }
}
