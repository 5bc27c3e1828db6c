//! The sky by flags and by BAKE.toml: without a file, turned, brighter, in another mapping, another layer.

use crate::common::{Folder, Level, csv_of};
use std::f64::consts::PI;

/// A level without triangles is lit by the sky alone.
fn open(folder: &Folder) {
    Level::new().write(folder, "open.glb");
    folder.write("points.csv", csv_of(&[[0.0; 3]]));
}

const UP: [f64; 6] = [0.0, 0.0, 0.0, 0.0, 1.0, 0.0];

fn irradiance(folder: &Folder, sky: &[&str], place: [f64; 6]) -> [f64; 3] {
    let common = ["open.glb", "--nodes", "points:points.csv", "--precision", "f32", "--quiet", "-o", "x.gdibl"];
    folder.bake(&[&common[..], sky].concat());
    let row = folder.irradiance("x.gdibl", &[place])[0];
    [row[0], row[1], row[2]]
}

#[track_caller]
fn assert_near(found: [f64; 3], expected: [f64; 3]) {
    for (f, e) in found.iter().zip(expected) {
        assert!((f - e).abs() < 0.01 * e.max(0.1), "{found:?} for {expected:?}");
    }
}

/// E = π L under a sky of L everywhere.
#[test]
fn constant_sky_needs_no_file() {
    let folder = Folder::new();
    open(&folder);
    assert_near(irradiance(&folder, &["--distant", "1,2,3"], UP), [PI, 2.0 * PI, 3.0 * PI]);
    let brighter = ["--distant", "1,2,3", "--distant-exposure", "1"];
    assert_near(irradiance(&folder, &brighter, UP), [2.0 * PI, 4.0 * PI, 6.0 * PI]);
    for distant in ["[1, 2, 3]", "\"1,2,3\"", "{ image = \"1,2,3\", exposure_stops = 0 }"] {
        folder.write("BAKE.toml", format!("level = \"open.glb\"\ndistant = {distant}\n"));
        folder.bake(&["BAKE.toml", "--nodes", "points:points.csv", "--precision", "f32", "-o", "t.gdibl"]);
        let row = folder.irradiance("t.gdibl", &[UP])[0];
        assert_near([row[0], row[1], row[2]], [PI, 2.0 * PI, 3.0 * PI]);
    }
    let run = folder.run(&["bake", "open.glb", "--distant", "1,-1,1", "-o", "no.gdibl"]);
    assert_eq!(run.code, 2, "{}", run.err);
    let run = folder.run(&["bake", "open.glb", "--distant-yaw", "90", "-o", "no.gdibl"]);
    assert_eq!(run.code, 2, "{}", run.err);
}

/// A sky that is bright toward +Z: a yaw of 90° brings its light to +X.
#[test]
fn yaw_turns_the_sky_counter_clockwise() {
    let folder = Folder::new();
    open(&folder);
    folder.panorama("sky.exr", 64, None, |d| [1.0 + d.z as f32; 3]);
    // E(n) of 1 + d·z is π + 2π/3 n·z.
    let facing = |normal: [f64; 3]| [0.0, 0.0, 0.0, normal[0], normal[1], normal[2]];
    let bright = [PI + 2.0 * PI / 3.0; 3];
    for (yaw, normal) in [("0", [0.0, 0.0, 1.0]), ("90", [1.0, 0.0, 0.0]), ("-90", [-1.0, 0.0, 0.0])] {
        let sky = ["--distant", "sky.exr", "--distant-yaw", yaw];
        assert_near(irradiance(&folder, &sky, facing(normal)), bright);
    }
}

#[test]
fn square_image_is_refused_until_its_mapping_is_named() {
    use gdibl_baker::import::image::{Image, write_exr_picture};
    let folder = Folder::new();
    open(&folder);
    write_exr_picture(&folder.path("ball.exr"), &Image::new(32, 32, vec![[1.0; 3]; 32 * 32])).unwrap();
    let run = folder.run(&["bake", "open.glb", "--distant", "ball.exr", "-o", "no.gdibl"]);
    assert_eq!(run.code, 3, "{}", run.err);
    for word in ["ball.exr", "32 x 32", "angular", "mapping"] {
        assert!(run.err.contains(word), "{}", run.err);
    }
    assert_near(irradiance(&folder, &["--distant", "ball.exr", "--distant-mapping", "angular"], UP), [PI; 3]);
    let run =
        folder.run(&["bake", "open.glb", "--distant", "ball.exr", "--distant-mapping", "round", "-o", "no.gdibl"]);
    assert_eq!(run.code, 2, "{}", run.err);
    assert!(run.err.contains("lat-long"), "{}", run.err);
}
