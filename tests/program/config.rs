//! BAKE.toml, and what artists write on glTF nodes.

use crate::common::{Folder, Level, solid_of};
use serde_json::json;

const ROOM: ([f32; 3], [f32; 3]) = ([-2.0; 3], [2.0; 3]);

/// `project/` with BAKE.toml's inputs in sub-folders of it.
fn project(toml: &str) -> Folder {
    let folder = Folder::new();
    folder.write("project/level/room.glb", Level::room(ROOM.0, ROOM.1).glb());
    folder.panorama("project/light/a.exr", 512, Some([50.0, 0.0, 0.0]), |_| [1.0; 3]);
    folder.write("project/points.csv", "0,0,0\n1,1,1\n");
    folder.write("project/BAKE.toml", toml);
    folder
}

const PLACED: &str = "level = \"level/room.glb\"\noutput = \"out.gdibl\"\n\
                      [[probe]]\nimage = \"light/a.exr\"\nposition = [0.5, 0.25, -0.75]\n\
                      rotation = [0, 0.6, 0, 0.8]\nexposure_stops = 1\n";

#[test]
fn pose_in_bake_toml_wins_over_the_header_and_exposure_counts() {
    // By its header the probe is outside, and nothing would be covered.
    let grid = "[grid]\ncounts = [2, 2, 2]\nbounds = [-1, -1, -1, 1, 1, 1]\n";
    let folder = project(&format!("{PLACED}{grid}"));
    let report = folder.bake(&["project/BAKE.toml"]);
    assert!(report["coverage"].as_f64().unwrap() > 0.999, "{report}");
    let probe = &folder.inspect("project/out.gdibl")["probes"][0];
    assert_eq!(probe["position"], json!([0.5, 0.25, -0.75]));
    let rotation: Vec<f64> = probe["rotation"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    assert!((rotation[1] - 0.6).abs() < 1e-6 && (rotation[3] - 0.8).abs() < 1e-6, "{rotation:?}");
    // One stop: twice the light.
    let mean = folder.coefficients("project/out.gdibl", &[[0.0; 3]])[0][0] / (4.0 * std::f64::consts::PI).sqrt();
    assert!((mean - 2.0).abs() < 2e-3, "{mean}");

    let by_header = project(&format!("level = \"level/room.glb\"\nprobes = [\"light\"]\n{grid}"));
    assert_eq!(by_header.run(&["bake", "project/BAKE.toml"]).code, 5);
}

#[test]
fn settings_go_by_the_names_of_the_flags_and_flags_win() {
    let quality = "[quality]\nsamples = 64\nseed = 5\nsh = \"L1\"\nprecision = \"f32\"\nblend = \"distance:3\"\n\
                   scene = \"occlude\"\nsampler = \"random\"\nthreads = 1\nrepair_pixels = false\nzstd = false\n";
    let folder = project(&format!("{PLACED}[grid]\nspacing = 4.0\nbounds = [-1, -1, -1, 1, 1, 1]\n{quality}"));
    folder.bake(&["project/BAKE.toml"]);
    let found = folder.inspect("project/out.gdibl");
    assert_eq!((&found["sh"], &found["precision"]), (&json!("L1"), &json!("f32")));
    assert_eq!(found["grid"]["counts"], json!([2, 2, 2]));
    assert_eq!(found["max"], json!([1.0, 1.0, 1.0]));
    let settings = &found["settings"];
    let expected = json!({ "samples": 64, "seed": 5, "blend": "distance:3", "scene": "occlude", "sampler": "random" });
    for (key, value) in expected.as_object().unwrap() {
        assert_eq!(&settings[format!("quality.{key}")], value, "{key}");
    }

    let flags = ["--precision", "packed", "-o", "packed.gdibl"];
    folder.bake(&[&["project/BAKE.toml"], &flags[..]].concat());
    assert_eq!(folder.inspect("packed.gdibl")["precision"], "packed");
    let packed =
        project(&format!("{PLACED}[grid]\nspacing = 4.0\n[quality]\nsamples = 64\nprecision = \"packed:0.02\"\n"));
    packed.bake(&["project/BAKE.toml"]);
    let error = packed.inspect("project/out.gdibl")["statistics"]["packing"]["added_error"]["p95"].as_f64().unwrap();
    assert!(error > 0.0 && error <= 0.02, "{error}");

    let flags = ["--samples", "32", "--sh", "L0", "--blend", "nearest", "--counts", "3,1,1", "-o", "flags.gdibl"];
    folder.bake(&[&["project/BAKE.toml"], &flags[..]].concat());
    let found = folder.inspect("flags.gdibl");
    assert_eq!(found["sh"], "L0");
    assert_eq!(
        (&found["settings"]["quality.samples"], &found["settings"]["quality.blend"]),
        (&json!(32), &json!("nearest"))
    );
    assert_eq!(found["settings"]["quality.seed"], 5, "what no flag says stays");
    assert_eq!(found["grid"]["counts"], json!([3, 1, 1]), "counts by flag replace the file's spacing");
}

#[test]
fn paths_are_relative_to_the_folder_of_bake_toml() {
    let folder = project(&format!("{PLACED}[grid]\nnodes = \"points:points.csv\"\n"));
    let report = folder.bake(&["project/BAKE.toml"]);
    assert_eq!(report["nodes"], 2);
    assert!(folder.exists("project/out.gdibl") && !folder.exists("out.gdibl"));
}

#[test]
fn unknown_keys_are_errors_that_name_them() {
    let bad = [
        ("levle = \"x\"\n", "levle"),
        ("level = \"level/room.glb\"\n[quality]\nsample = 64\n", "sample"),
        ("level = \"level/room.glb\"\n[grid]\nspaceing = 1\n", "spaceing"),
        ("level = \"level/room.glb\"\n[[probe]]\nimage = \"light/a.exr\"\nplace = [0, 0, 0]\n", "place"),
        ("level = \"level/room.glb\"\n[quality]\nsh = \"L7\"\n", "L7"),
        ("level = \"level/room.glb\"\n[quality]\nblend = \"best\"\n", "best"),
        ("[quality]\nsamples = 1\n", "level"),
    ];
    for (toml, word) in bad {
        let folder = project(toml);
        let run = folder.run(&["bake", "project/BAKE.toml"]);
        assert_eq!(run.code, 3, "{toml}\n{}", run.err);
        assert!(run.err.contains("BAKE.toml") && run.err.contains(word), "{word} in {}", run.err);
    }
}

#[test]
fn distant_table_turns_the_panorama() {
    // Light from above, turned to come from +X: a quarter turn around Z takes +Y to -X, so back by -90°.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let folder = Folder::new();
    Level::new().write(&folder, "empty.glb");
    folder.panorama("sky.exr", 32, None, |d| [1.0 + d.y as f32; 3]);
    let toml = format!(
        "level = \"empty.glb\"\n[distant]\nimage = \"sky.exr\"\nrotation = [0, 0, {}, {half}]\n\
         [grid]\nbounds = [0, 0, 0, 1, 1, 1]\ncounts = [1, 1, 1]\n",
        -half
    );
    folder.write("BAKE.toml", toml);
    folder.bake(&["BAKE.toml"]);
    let sh = &folder.coefficients("BAKE.gdibl", &[[0.0; 3]])[0];
    // sqrt(4π/3) on x (index 3), none on y and z (1 and 2), to the steps of packed coefficients.
    let expected = (4.0 * std::f64::consts::PI / 3.0).sqrt();
    assert!((sh[9] - expected).abs() < 0.03 && sh[3].abs() < 0.03 && sh[6].abs() < 0.03, "{sh:?}");
}

#[test]
fn roles_on_nodes_say_what_part_geometry_plays() {
    let probe = |folder: &Folder| folder.constant("a.exr", [0.0, 0.0, 1.5], [1.0; 3]);
    let wall = solid_of([-0.5; 3], [0.5; 3]);
    let coverage_and_light = |role: &str, scene: &str| {
        let folder = Folder::new();
        let mut level = Level::room(ROOM.0, ROOM.1);
        level.object(&wall, 0, json!({ "extras": { "gdibl_role": role } }));
        level.write(&folder, "level.glb");
        probe(&folder);
        folder.write("points.csv", "0,0,-1.5\n");
        let arguments = ["level.glb", "--probes", "a.exr", "--nodes", "points:points.csv", "--scene", scene];
        let report = folder.bake(&arguments);
        let light = folder.coefficients("level.gdibl", &[[0.0, 0.0, -1.5]])[0][0];
        (report["coverage"].as_f64().unwrap(), light / (4.0 * std::f64::consts::PI).sqrt())
    };
    // Environment: it hides walls from the probe, and its own back is unseen.
    let (coverage, _) = coverage_and_light("environment", "recurse:3");
    assert!((0.5..0.9).contains(&coverage), "{coverage}");
    // Scene: the probe looks through it; rays do not.
    let (coverage, light) = coverage_and_light("scene", "occlude");
    assert!(coverage > 0.9, "{coverage}");
    assert!((0.8..0.95).contains(&light), "{light}");
    // Ignored: as if it were not there.
    let (coverage, light) = coverage_and_light("ignore", "occlude");
    assert!(coverage > 0.9, "{coverage}");
    assert!((light - 1.0).abs() < 1e-3, "{light}");

    let folder = Folder::new();
    let mut level = Level::room(ROOM.0, ROOM.1);
    level.object(&wall, 0, json!({ "name": "crate", "extras": { "gdibl_role": "props" } }));
    level.write(&folder, "level.glb");
    probe(&folder);
    let run = folder.run(&["bake", "level.glb", "--probes", "a.exr"]);
    assert_eq!(run.code, 3, "{}", run.err);
    assert!(run.err.contains("props") && run.err.contains("level.glb"), "{}", run.err);
}

#[test]
fn markers_on_nodes_place_probes_and_the_volume() {
    let folder = Folder::new();
    let mut level = Level::room(ROOM.0, ROOM.1);
    let probe = json!({ "translation": [0.5, 0.25, -0.5], "extras": { "gdibl_probe": "light/a.exr" } });
    level.node(probe);
    let volume = json!({ "translation": [0, 0.5, 0], "scale": [1.5, 1, 0.75], "extras": { "gdibl_volume": 1.0 } });
    level.node(volume);
    level.write(&folder, "level.glb");
    // Without a position of its own.
    folder.panorama("light/a.exr", 1024, None, |_| [1.0; 3]);
    let report = folder.bake(&["level.glb"]);
    assert!(report["coverage"].as_f64().unwrap() > 0.999, "{report}");
    let found = folder.inspect("level.gdibl");
    assert_eq!(found["probes"][0]["position"], json!([0.5, 0.25, -0.5]));
    assert_eq!((&found["min"], &found["max"]), (&json!([-1.5, -0.5, -0.75]), &json!([1.5, 1.5, 0.75])));
    assert_eq!(found["grid"]["counts"], json!([4, 3, 3]));
}
