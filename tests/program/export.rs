//! `gdibl export`: from panorama to an engine's file, and what cannot be exported.

use crate::common::{Folder, Level, csv_of};
use serde_json::{Value, json};
use std::f64::consts::PI;

/// A volume of nothing but distant light, baked as `light.gdibl`.
fn in_the_open(light: impl Fn(glam::DVec3) -> [f32; 3]) -> Folder {
    let folder = Folder::new();
    folder.write("nothing.gltf", json!({ "asset": { "version": "2.0" }, "scene": 0, "scenes": [{}] }).to_string());
    folder.panorama("sky.exr", 256, None, light);
    folder.bake(&[
        "nothing.gltf",
        "--distant",
        "sky.exr",
        "--bounds",
        "-3,-2,-1,3,2,1",
        "--counts",
        "3,2,2",
        "-o",
        "light.gdibl",
    ]);
    folder
}

fn export(folder: &Folder, engine: &str, output: &str) -> Value {
    let out = folder.ok(&["export", "light.gdibl", "--to", engine, "-o", output, "--json"]);
    serde_json::from_str(&out).expect("export --json prints JSON")
}

/// E/π facing each side, ±x ±y ±z in glTF's axes, of the probe in the middle of a Unity file.
fn by_unity(folder: &Folder) -> [f64; 6] {
    let json: Value = serde_json::from_slice(&folder.read("unity.json")).unwrap();
    let c: [f64; 9] = std::array::from_fn(|k| json["coefficients"][27 + k].as_f64().unwrap());
    let axes =
        [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];
    axes.map(|[x, y, z]: [f64; 3]| {
        let x = -x;
        (c[0] - c[6]) + c[1] * y + c[2] * z + c[3] * x + 3.0 * c[6] * z * z + c[8] * (x * x - y * y)
    })
}

/// The same of a Godot resource, whose second point is meant.
fn by_godot(folder: &Folder) -> [f64; 6] {
    let text = String::from_utf8(folder.read("godot.tres")).unwrap();
    let (_, sh) = text.split_once("\"sh\": PackedColorArray(").unwrap();
    let numbers: Vec<f64> = sh.split_once(')').unwrap().0.split(", ").map(|n| n.parse().unwrap()).collect();
    let c: [f64; 9] = std::array::from_fn(|k| numbers[36 + 4 * k]);
    radiance_to_irradiance(&c)
}

/// The same of a three.js atlas, whose second texel of the first slice with light is meant: over π.
fn by_three(folder: &Folder) -> [f64; 6] {
    let bytes = folder.read("three.bin");
    let word = |at: usize| u32::from_le_bytes(std::array::from_fn(|k| bytes[at + k])) as usize;
    let [nx, ny, nz] = [12, 16, 20].map(word);
    assert_eq!([nx, ny, nz], [3, 2, 2]);
    let value = |k: usize| {
        let texel = 1 + nx * ny * (1 + (k / 4) * (nz + 2));
        let at = 48 + 2 * (4 * texel + k % 4);
        half::f16::from_le_bytes([bytes[at], bytes[at + 1]]).to_f64() / PI
    };
    radiance_to_irradiance(&std::array::from_fn(|i| value(3 * i)))
}

fn radiance_to_irradiance(c: &[f64; 9]) -> [f64; 6] {
    let mean = 0.886227 * c[0];
    let (x, y, z) = (1.023327 * c[3], 1.023327 * c[1], 1.023327 * c[2]);
    let (across, along) = (mean - 0.247708 * c[6], mean + 0.495417 * c[6]);
    let d = 0.429043 * c[8];
    [across + d + x, across + d - x, across - d + y, across - d - y, along + z, along - z]
}

/// The same of a Bevy texture: half floats behind whatever precedes the level, which the level index tells.
fn by_bevy(folder: &Folder) -> [f64; 6] {
    let bytes = folder.read("bevy.rgba16f.ktx2");
    let offset = u64::from_le_bytes(std::array::from_fn(|k| bytes[80 + k])) as usize;
    let [nx, ny, nz] = [3, 2, 2];
    std::array::from_fn(|side| {
        let (axis, negative) = (side / 2, side % 2);
        let texel = 1 + nx * (ny * negative + 2 * ny * nz * axis);
        half::f16::from_le_bytes([bytes[offset + 8 * texel], bytes[offset + 8 * texel + 1]]).to_f64()
    })
}

#[test]
fn light_from_one_side_of_a_panorama_arrives_at_that_side_in_every_engine() {
    for bright in 0..6 {
        let axis = bright / 2;
        let sign = if bright % 2 == 0 { 1.0 } else { -1.0 };
        let folder = in_the_open(|d| if sign * d.to_array()[axis] > 0.9 { [5.0, 4.0, 3.0] } else { [0.0; 3] });
        for (engine, output) in
            [("bevy", "bevy.ktx2"), ("three", "three.bin"), ("godot", "godot.tres"), ("unity", "unity.json")]
        {
            export(&folder, engine, output);
        }
        for (engine, sides) in [
            ("bevy", by_bevy(&folder)),
            ("three", by_three(&folder)),
            ("godot", by_godot(&folder)),
            ("unity", by_unity(&folder)),
        ] {
            // The cap's own E/π: radiance times 1 - 0.9².
            let own = sides[bright];
            // A cube that fits all normals best overshoots at a lamp as narrow as this.
            let most = if engine == "bevy" { 1.45 } else { 1.2 };
            assert!((0.85..most).contains(&(own / (5.0 * (1.0 - 0.81)))), "{engine}, side {bright}: {sides:?}");
            let other = (0..6).filter(|&side| side != bright).map(|side| sides[side]).fold(0.0, f64::max);
            assert!(other < 0.2 * own, "{engine}, side {bright}: {sides:?}");
        }
    }
}

#[test]
fn constant_light_is_the_same_number_in_every_engine_and_loses_nothing() {
    let folder = in_the_open(|_| [2.0, 1.0, 0.5]);
    for (engine, output, companions) in [
        ("bevy", "bevy.ktx2", &["bevy.rgba16f.ktx2", "bevy.json"][..]),
        ("three", "three.bin", &["gdibl-light-probe-grid.js"]),
        ("godot", "godot.tres", &[]),
        ("unity", "unity.json", &["GdiblImporter.cs"]),
        ("exr", "light.exr", &[]),
        ("json", "light.json", &[]),
    ] {
        let report = export(&folder, engine, output);
        assert_eq!(report["counts"], json!([3, 2, 2]));
        assert!(report["loss"]["relative_rmse"].as_f64().unwrap() < 2e-3, "{engine}: {report}");
        let names: Vec<&str> =
            report["files"].as_array().unwrap().iter().map(|f| f["path"].as_str().unwrap()).collect();
        assert_eq!(names, [&[output], companions].concat());
        for file in report["files"].as_array().unwrap() {
            assert_eq!(folder.read(file["path"].as_str().unwrap()).len() as u64, file["bytes"].as_u64().unwrap());
        }
    }
    for sides in [by_bevy(&folder), by_three(&folder), by_godot(&folder), by_unity(&folder)] {
        assert!(sides.iter().all(|l| (l - 2.0).abs() < 4e-3), "{sides:?}");
    }
    let text = folder.ok(&["export", "light.gdibl", "--to", "three", "-o", "fine.bin", "--counts", "5,3,4"]);
    assert!(text.contains("5 x 3 x 4") && text.contains("relative RMSE of E") && text.contains("sampled"), "{text}");
    let volume = folder.names().into_iter().filter(|name| name.ends_with(".tmp")).count();
    assert_eq!(volume, 0, "nothing half written");
}

#[test]
fn what_cannot_be_exported_ends_with_the_right_code_and_without_a_file() {
    let folder = in_the_open(|_| [1.0; 3]);
    folder.write("points.csv", csv_of(&[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]));
    Level::room([-2.0; 3], [2.0; 3]).write(&folder, "room.glb");
    folder.constant("probe.exr", [0.0; 3], [1.0; 3]);
    folder.bake(&["room.glb", "--probes", "probe.exr", "--nodes", "points:points.csv", "-o", "points.gdibl"]);
    folder.write("broken.gdibl", b"\x89GDIBL\n\x1a");
    std::fs::create_dir(folder.path("folder")).unwrap();
    let before = folder.names();
    for (code, arguments, said) in [
        (4, &["points.gdibl", "--to", "bevy", "-o", "out"][..], "--to json"),
        (4, &["light.gdibl", "--to", "godot", "-o", "out", "--counts", "100,100,100"], "give fewer --counts"),
        (3, &["missing.gdibl", "--to", "bevy", "-o", "out"], "missing.gdibl"),
        (3, &["broken.gdibl", "--to", "bevy", "-o", "out"], "broken.gdibl"),
        (2, &["light.gdibl", "--to", "unreal", "-o", "out"], "unreal"),
        (2, &["light.gdibl", "--to", "bevy", "-o", "out", "--counts", "3,0,2"], "1 or more"),
        (2, &["light.gdibl", "--to", "bevy", "-o", "out", "--counts", "3,2"], "three whole numbers"),
        (2, &["light.gdibl", "--to", "bevy", "-o", "out.json"], "out.json"),
        (2, &["light.gdibl", "--to", "bevy", "-o", "folder"], "is a folder"),
        (2, &["light.gdibl", "--to", "bevy"], "--output"),
        (1, &["light.gdibl", "--to", "bevy", "-o", "nowhere/out"], "nowhere/out"),
    ] {
        let run = folder.run(&[&["export"], arguments].concat());
        assert_eq!(run.code, code, "{arguments:?}: {}", run.err);
        assert!(run.err.contains(said), "{arguments:?}: {}", run.err);
        assert_eq!(folder.names(), before, "{arguments:?} left a file");
    }
    let json = folder.ok(&["export", "points.gdibl", "--to", "json", "-o", "points.json", "--json"]);
    let report: Value = serde_json::from_str(&json).unwrap();
    assert_eq!((&report["counts"], &report["loss"]["relative_rmse"]), (&json!([2, 1, 1]), &json!(0.0)));
}
