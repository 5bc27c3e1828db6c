//! `render`: pictures of the files' light, in the files asked for.

use crate::common::{Folder, Level, Run, solid_of};
use gdibl_baker::import::image::{Imported, ReadOptions, read_image};
use gdibl_baker::panorama::Mapping;
use glam::DVec3;
use serde_json::{Value, json};

/// A room of one colour with a grey cube in its middle.
fn room() -> Folder {
    let folder = Folder::new();
    let mut level = Level::room([-2.0; 3], [2.0; 3]);
    let grey = json!({ "pbrMetallicRoughness": { "metallicFactor": 0.0, "baseColorFactor": [0.5, 0.5, 0.5, 1.0] } });
    let grey = level.material(grey);
    level.scene_object(&solid_of([-0.4; 3], [0.4; 3]), grey);
    // Black walls: the cube does not shade them.
    level.json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = json!([0.0, 0.0, 0.0, 1.0]);
    level.write(&folder, "room.glb");
    folder.constant("probe.exr", [0.1, 1.5, 0.2], [0.25, 1.0, 4.0]);
    folder
}

const INPUT: [&str; 4] = ["render", "room.glb", "--probes", "probe.exr"];
const SMALL: [&str; 4] = ["--size", "24x16", "--samples", "8"];

fn render(folder: &Folder, arguments: &[&str]) -> Run {
    folder.run(&[&INPUT[..], &SMALL, arguments].concat())
}

fn report(folder: &Folder, arguments: &[&str]) -> Value {
    let run = render(folder, &[arguments, &["--json"]].concat());
    assert_eq!(run.code, 0, "{arguments:?}\n{}", run.err);
    serde_json::from_str(&run.out).expect("render --json prints JSON")
}

fn read(folder: &Folder, name: &str) -> Imported {
    read_image(&folder.path(name), &ReadOptions::default()).unwrap()
}

/// Width, height and bit depth of a PNG, from its first chunk.
fn png_header(bytes: &[u8]) -> (u32, u32, u8) {
    assert!(bytes.starts_with(b"\x89PNG\r\n\x1a\n") && &bytes[12..16] == b"IHDR");
    let number = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
    (number(16), number(20), bytes[24])
}

#[test]
fn exr_holds_the_light_and_says_nothing_of_a_mapping() {
    let folder = room();
    let found = report(&folder, &["-o", "out.exr"]);
    assert_eq!((&found["size"], &found["samples"], &found["method"]), (&json!([24, 16]), &json!(8), &json!("gdibl")));
    assert_eq!((&found["exposure_stops"], &found["uncovered"]), (&Value::Null, &json!(0.0)));
    assert_eq!(found["camera"]["target"], json!([0.0, 0.0, 0.0]), "the default camera looks at the middle");
    assert!(found["rays"].as_u64().unwrap() > 24 * 16 * 8);
    let picture = read(&folder, "out.exr");
    assert_eq!((picture.image.width, picture.image.height), (24, 16));
    assert_eq!((picture.mapping, picture.pose.position), (None, None));
    // The corner shows a wall, the middle the cube, which reflects half of it.
    let close =
        |pixel: [f32; 3], expected: [f32; 3]| pixel.iter().zip(expected).all(|(a, b)| (a / b - 1.0).abs() < 1e-3);
    assert!(close(picture.image.pixels[0], [0.25, 1.0, 4.0]), "{:?}", picture.image.pixels[0]);
    let middle = picture.image.pixels[8 * 24 + 12];
    assert!(close(middle, [0.125, 0.5, 2.0]), "{middle:?}");
    assert_eq!(folder.names(), ["out.exr", "probe.exr", "room.glb"], "and no temporary file");
}

#[test]
fn png_is_exposed_by_itself_or_as_asked() {
    let folder = room();
    let found = report(&folder, &["-o", "auto.png"]);
    assert_eq!(png_header(&folder.read("auto.png")), (24, 16, 8));
    // Log-mean luminance: walls of 0.2126·¼ + 0.7152 + 0.0722·4, some cube of half that.
    let stops = found["exposure_stops"].as_f64().unwrap();
    assert!((-2.6..-2.4).contains(&stops), "{stops}");
    // The number that was printed makes the same picture; another one another.
    report(&folder, &["-o", "asked.png", &format!("--exposure={stops}")]);
    assert!(folder.read("asked.png") == folder.read("auto.png"));
    report(&folder, &["-o", "dark.png", "--exposure", "-6"]);
    assert!(folder.read("dark.png") != folder.read("auto.png"));
    // For people, and beside the input.
    let run = render(&folder, &[]);
    assert_eq!(run.code, 0, "{}", run.err);
    assert!(
        run.out.contains(&format!("{stops:+.2} stops (automatic)")) && run.out.contains("--target 0.000"),
        "{}",
        run.out
    );
    assert!(folder.read("room.png") == folder.read("auto.png"));
}

#[test]
fn panorama_as_exr_is_a_probe_with_its_pose() {
    let folder = room();
    folder.panorama("probe.exr", 64, Some([0.1, 1.5, 0.2]), |d| [1.5 + d.x as f32, 1.0, 1.5 + d.z as f32]);
    let camera = ["--panorama", "0.1,1.5,0.2", "--size", "64x32", "--samples", "8", "-o", "pano.exr", "--json"];
    let found: Value = serde_json::from_str(&folder.ok(&[&INPUT[..], &camera].concat())).unwrap();
    assert_eq!(found["camera"], json!({ "panorama": [0.1, 1.5, 0.2] }));
    let (picture, probe) = (read(&folder, "pano.exr"), read(&folder, "probe.exr"));
    assert_eq!(picture.mapping, Some(Mapping::LatLong));
    assert!((picture.pose.position.unwrap() - DVec3::new(0.1, 1.5, 0.2)).length() < 1e-6);
    // From the probe's own place its own picture, but for the cube below.
    let upper = 0..64 * 20;
    let pairs = picture.image.pixels[upper.clone()].iter().zip(&probe.image.pixels[upper]);
    let worst = pairs.flat_map(|(a, b)| [0, 1, 2].map(|c| (a[c] / b[c] - 1.0).abs())).fold(0.0, f32::max);
    assert!(worst < 0.1, "{worst}");
    assert!(picture.image.pixels[..64 * 20].iter().any(|p| p[0] > 2.0 * p[2]), "it has colours");
}

#[test]
fn volume_lights_the_objects_that_an_engine_would_light() {
    let folder = room();
    folder.constant("other.exr", [0.1, 1.5, 0.2], [8.0, 8.0, 8.0]);
    let grid = ["--bounds", "-1,-1,-1,1,1,1", "--counts", "2,2,2", "--samples", "64", "-o", "light.gdibl"];
    folder.bake(&[&["room.glb", "--probes", "other.exr", "--scene", "recurse:1"], &grid[..]].concat());
    report(&folder, &["--volume", "light.gdibl", "--objects-only", "-o", "out.exr"]);
    let picture = read(&folder, "out.exr");
    assert!((picture.image.pixels[0][2] - 4.0).abs() < 1e-3, "the wall is the probe's: {:?}", picture.image.pixels[0]);
    let middle = picture.image.pixels[8 * 24 + 12];
    assert!(middle.iter().all(|v| (v / 4.0 - 1.0).abs() < 0.15), "half of about 8, all colours alike: {middle:?}");
    // A box that is too small is said.
    let grid = ["--bounds", "0.6,0.6,0.6,0.9,0.9,0.9", "--counts", "2,2,2", "--samples", "64", "-o", "small.gdibl"];
    folder.bake(&[&["room.glb", "--probes", "other.exr"], &grid[..]].concat());
    let run = render(&folder, &["--volume", "small.gdibl", "--objects-only", "-o", "out.exr"]);
    assert!(run.code == 0 && run.err.contains("out of the volume's box"), "{}", run.err);
}

#[test]
fn gdibl_without_probes_captures_once_for_pictures_and_bakes() {
    let folder = Folder::new();
    let mut level = Level::room([-2.0; 3], [2.0; 3]);
    let lamp = level.material(json!({ "emissiveFactor": [1.0, 1.0, 1.0] }));
    level.object(&solid_of([-0.2, 1.5, -0.2], [0.2, 1.7, 0.2]), lamp, json!({}));
    level.write(&folder, "room.glb");
    folder.write(
        "BAKE.toml",
        "level = \"room.glb\"\nquality.method = \"gdibl\"\n[capture]\nwidth = 16\nsamples = 4\nmost = 1\n",
    );
    let first = folder.run(&[&["render", "BAKE.toml", "-o", "a.png"], &SMALL[..]].concat());
    assert!(first.code == 0 && first.err.contains("captured 1 probes from the level"), "{}", first.err);
    assert_eq!(folder.names(), ["BAKE.toml", "a.png", "room.glb"]);
    let second = folder.run(&[&["render", "BAKE.toml", "-o", "b.png", "--eye", "1,0,1"], &SMALL[..]].concat());
    assert!(second.code == 0 && !second.err.contains("captured"), "{}", second.err);
    let bake = folder.run(&["bake", "BAKE.toml", "--counts", "2,2,2", "--samples", "16"]);
    assert!(bake.code == 0 && !bake.err.contains("captured"), "{}", bake.err);
    // Unless it is asked for, paths are traced.
    let cached = folder.cached();
    let paths = folder.run(&[&["render", "room.glb", "-o", "c.png"], &SMALL[..]].concat());
    assert!(paths.code == 0 && folder.cached() == cached, "{}", paths.err);
}

#[test]
fn what_cannot_be_rendered_is_refused_before_the_first_ray() {
    let folder = room();
    folder.bake(&["room.glb", "--probes", "probe.exr", "--counts", "2,2,2", "--samples", "16", "-o", "v.gdibl"]);
    let volume = folder.read("v.gdibl");
    folder.write("cut.gdibl", &volume[..volume.len() - 10]);
    let mut newer = volume;
    newer[8] = 9;
    folder.write("newer.gdibl", newer);
    let before = folder.names();
    // 2^32 - 1 samples per pixel: a picture that began would not end.
    let input = "render room.glb --probes probe.exr --samples 4294967295";
    let cases: [(&str, i32, &[&str]); 20] = [
        ("-o out.jpg", 2, &["out.jpg", ".png or .exr"]),
        ("-o out", 2, &["out", ".png or .exr"]),
        ("-o out.exr --exposure 1", 2, &["--exposure", "EXR"]),
        ("-o missing/out.png", 1, &["missing/out.png"]),
        ("-o .png", 2, &[".png"]),
        ("--volume cut.gdibl", 3, &["cut.gdibl"]),
        ("--volume missing.gdibl", 3, &["missing.gdibl"]),
        ("--volume newer.gdibl", 4, &["newer.gdibl", "version"]),
        ("--volume probe.exr", 3, &["probe.exr"]),
        ("--size 640", 2, &["--size", "640x360"]),
        ("--size 0x10", 2, &["--size", "above 0"]),
        ("--size 99999x99999", 2, &["--size", "pixels"]),
        ("--samples 0", 2, &["--samples"]),
        ("--depth 65", 2, &["--depth"]),
        ("--eye 0,0", 2, &["--eye", "x,y,z"]),
        ("--eye 0,0,0", 2, &["looks at itself", "--target"]),
        ("--fov 180", 2, &["--fov", "degrees"]),
        ("--exposure nan", 2, &["--exposure", "stops"]),
        ("--panorama 0,0,1 --eye 1,0,0", 2, &["--panorama", "--eye"]),
        ("--eye 0,0,9 --target 0,0,20 --samples 1", 5, &["nothing was written", "in a wall"]),
    ];
    for (line, code, words) in cases {
        // A later --samples would be given twice.
        let input = if line.contains("--samples") { input.split(" --samples").next().unwrap() } else { input };
        let line = format!("{input} {line}");
        let run = folder.run(&line.split_whitespace().collect::<Vec<_>>());
        assert_eq!(run.code, code, "gdibl {line}\n{}", run.err);
        words.iter().for_each(|word| assert!(run.err.contains(word), "gdibl {line}: no '{word}' in\n{}", run.err));
        assert_eq!(folder.names(), before, "gdibl {line} left something behind");
    }
}
