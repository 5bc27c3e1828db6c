//! `bake --sun extract`: the sun's direct light is reported instead of baked.

use crate::common::{Folder, Level, csv_of, repository, solid_of};
use glam::DVec3;
use serde_json::{Value, json};
use std::f64::consts::PI;

/// A black stone far below a point in the open; a sky of 0.5, and of `sun` in one pixel.
fn stone_under(sun: f32) -> Folder {
    let folder = Folder::new();
    let mut level = Level::room([-90.0; 3], [-89.0; 3]);
    // Black: it would send the sun's light on.
    level.json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = json!([0.0, 0.0, 0.0, 1.0]);
    level.object(&solid_of([-1.0, -9.0, -1.0], [1.0, -8.0, 1.0]), 0, json!({}));
    level.write(&folder, "stone.glb");
    // Pixel (96, 21) of 128 × 64: its centre.
    let toward = toward();
    folder.panorama("sky.exr", 128, None, |d| {
        let inside = (0..3).all(|k| (d[k] - toward[k]).abs() < 1e-3);
        if inside { [sun, 0.9 * sun, 0.8 * sun] } else { [0.5; 3] }
    });
    folder.write("points.csv", csv_of(&[[0.0; 3]]));
    folder
}

fn toward() -> [f64; 3] {
    let (longitude, latitude) = (2.0 * PI * (0.5 - 96.5 / 128.0), PI * (0.5 - 21.5 / 64.0));
    [longitude.sin() * latitude.cos(), latitude.sin(), longitude.cos() * latitude.cos()]
}

const STONE: [&str; 9] = [
    "stone.glb",
    "--distant",
    "sky.exr",
    "--method",
    "gdibl",
    "--no-capture",
    "--nodes",
    "points:points.csv",
    "--quiet",
];

#[test]
fn extracted_sun_is_reported_and_stored_and_its_direct_light_not_baked() {
    let sun = 2e5;
    let folder = stone_under(sun);
    let with = folder.bake(&[&STONE[..], &["-o", "with.gdibl", "--precision", "f32"]].concat());
    assert_eq!(with["sun"], Value::Null);
    folder.write(
        "BAKE.toml",
        "level = \"stone.glb\"\ndistant = \"sky.exr\"\n[quality]\nsun = \"extract\"\nprecision = \"f32\"\n[grid]\nnodes = \
         \"points:points.csv\"\n",
    );
    for method in ["gdibl", "path"] {
        let report = folder.bake(&["BAKE.toml", "--no-capture", "--method", method, "-o", "less.gdibl"]);
        let found = &report["sun"];
        let number = |value: &Value| value.as_f64().unwrap();
        for (k, expected) in toward().into_iter().enumerate() {
            assert!((number(&found["direction"][k]) - expected).abs() < 1e-3, "{found}");
        }
        // A pixel's solid angle, which is what its bilinear weight has, too.
        let pixel = (2.0 * PI / 128.0) * (PI / 64.0) * toward()[1].asin().cos();
        let irradiance = number(&found["irradiance"][0]);
        assert!((irradiance / (f64::from(sun) * pixel) - 1.0).abs() < 0.01, "{found}");
        let diameter = 2.0 * (pixel / PI).sqrt().to_degrees();
        assert!((number(&found["angular_diameter_degrees"]) / diameter - 1.0).abs() < 0.01, "{found}");
        assert_eq!(&folder.inspect("less.gdibl")["statistics"]["sun"], found);
        // On a surface that faces the sun; the stone is small, and far away.
        let [x, y, z] = toward();
        let facing = |name| folder.irradiance(name, &[[0.0, 0.0, 0.0, x, y, z]])[0][0];
        let (lit, sky) = (facing("with.gdibl"), facing("less.gdibl"));
        // A delta of L2 gives (1/4 + 1/2 + 5/16) E.
        assert!(
            (lit - sky) / (irradiance * 17.0 / 16.0) > 0.97 && lit - sky < irradiance * 1.09,
            "{method}: {lit} {sky}"
        );
        assert!((sky / (0.5 * PI) - 1.0).abs() < 0.02, "{method}: {sky}");
        let text = folder.ok(&["inspect", "less.gdibl"]);
        assert!(text.contains("sun ") && text.contains("irradiance"), "{text}");
    }
}

#[test]
fn sky_without_a_sun_is_a_finding_and_no_sky_a_wrong_use() {
    let folder = stone_under(0.6);
    let report = folder.bake(&[&STONE[..], &["--sun", "extract"]].concat());
    assert_eq!(report["sun"], Value::Null);
    let findings = report["findings"].as_array().unwrap();
    assert!(findings.iter().any(|finding| finding["id"] == "no-sun"), "{findings:?}");
    let run = folder.run(&["bake", "stone.glb", "--sun", "extract"]);
    assert_eq!(run.code, 2, "{}", run.err);
    assert!(run.err.contains("--distant"), "{}", run.err);
    let run = folder.run(&[&["bake"], &STONE[..], &["--sun", "remove"]].concat());
    assert_eq!(run.code, 2, "{}", run.err);
    assert!(run.err.contains("include, extract"), "{}", run.err);
}

#[test]
fn wall_in_the_sun_of_the_shipped_box_still_lights_it() {
    // The sun shines into the box's open end, on its floor and walls. The point is in the shade under the roof.
    let folder = Folder::new();
    folder.write("box.glb", std::fs::read(repository("assets/uffizi-box/empty-box.glb")).unwrap());
    let toward = DVec3::new(0.3, 0.6, 1.0).normalize();
    let sky = |sun: f32| move |d: DVec3| if d.dot(toward) > 0.9999 { [sun; 3] } else { [0.2; 3] };
    folder.panorama("sunny.exr", 512, None, sky(2e4));
    folder.panorama("sunless.exr", 512, None, sky(0.2));
    folder.write("points.csv", csv_of(&[[0.0, 1.5, -1.0]]));
    let mean_light = |distant: &str, more: &[&str]| {
        let common = ["box.glb", "--distant", distant, "--method", "path", "--nodes", "points:points.csv"];
        let report = folder.bake(&[&common[..], &["--samples", "16384", "-o", "out.gdibl"], more].concat());
        let error = report["relative_error"]["max"].as_f64().unwrap();
        (folder.coefficients("out.gdibl", &[[0.0, 1.5, -1.0]])[0][0] / (4.0 * PI).sqrt(), error)
    };
    let (whole, error) = mean_light("sunny.exr", &[]);
    let (extracted, _) = mean_light("sunny.exr", &["--sun", "extract"]);
    let (removed, _) = mean_light("sunless.exr", &[]);
    println!("{whole} {extracted} {removed}, error {error}");
    assert!(extracted > 2.0 * removed, "bounced light is most of it: {extracted}, {removed}");
    assert!((extracted / whole - 1.0).abs() < 6.0 * error, "nothing direct there: {extracted}, {whole}, {error}");
}
