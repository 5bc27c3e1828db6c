//! What a level does not need is not done, and not in the file; and light is the same.

use crate::common::{Folder, Level, Triangle, box_of, normals, solid_of};
use serde_json::{Value, json};

/// A white room with two probes of unlike light, at the places of the room's own file.
fn room(folder: &Folder, change: impl FnOnce(&mut Level)) {
    let mut level = Level::room([-2.0, -1.0, -3.0], [2.0, 2.0, 1.5]);
    change(&mut level);
    level.write(folder, "room.glb");
    folder.panorama("a.exr", 512, Some([-1.0, 0.0, -2.0]), |d| [1.0 + d.x as f32, 1.5 + d.y as f32, 0.5]);
    folder.panorama("b.exr", 512, Some([1.0, 0.5, 0.5]), |d| [2.0 + d.z as f32, 1.0, 1.0 + 0.5 * d.x as f32]);
    folder.sky("sky.exr", [3.0, 2.0, 1.0]);
}

const PROBES: [&str; 5] = ["room.glb", "--probes", "a.exr", "--probes", "b.exr"];
/// Two that show unlike light have a systematic error.
const ONE: [&str; 3] = ["room.glb", "--probes", "a.exr"];
const FEW: [&str; 4] = ["--counts", "4,4,4", "--samples", "256"];

fn kept(report: &Value, stage: &str) -> bool {
    let row = report["plan"].as_array().unwrap().iter().find(|row| row["stage"] == stage);
    row.unwrap_or_else(|| panic!("{stage} in {report}"))["kept"].as_bool().unwrap()
}

/// E at a few places, every way round.
fn light(folder: &Folder) -> Vec<[f64; 4]> {
    let places = [[0.3, 0.2, -0.4], [-1.2, 1.1, 0.9], [1.4, -0.6, -2.2]];
    let of = |[x, y, z]: [f64; 3]| normals().into_iter().map(move |n| [x, y, z, n.x, n.y, n.z]);
    folder.irradiance("room.gdibl", &places.into_iter().flat_map(of).collect::<Vec<_>>())
}

/// Greatest difference of E over the mean of E.
fn difference(a: &[[f64; 4]], b: &[[f64; 4]]) -> f64 {
    let rgb = |all: &[[f64; 4]]| all.iter().flat_map(|e| e[..3].to_vec()).collect::<Vec<f64>>();
    let (a, b) = (rgb(a), rgb(b));
    let mean = a.iter().sum::<f64>() / a.len() as f64;
    a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / mean
}

fn section_ids(folder: &Folder) -> Vec<String> {
    let report = folder.inspect("room.gdibl");
    report["sections"].as_array().unwrap().iter().map(|row| row["id"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn a_closed_level_has_no_distant_panorama() {
    let folder = Folder::new();
    room(&folder, |level| {
        level.object(&solid_of([0.5, -0.5, -1.0], [1.0, 0.5, 0.2]), 0, json!({}));
    });
    let bake = |arguments: &[&str]| folder.bake(&[&PROBES[..], &FEW, arguments].concat());
    let without = bake(&[]);
    let expected = light(&folder);
    let with = bake(&["--distant", "sky.exr"]);
    assert!(!kept(&with, "distant"));
    assert_eq!((&with["rays"], light(&folder)), (&without["rays"], expected));
    let names = |folder: &Folder| {
        let probes = folder.inspect("room.gdibl")["probes"].clone();
        probes.as_array().unwrap().iter().map(|probe| probe["name"].as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(names(&folder), ["a.exr", "b.exr"]);
    // By path tracing, too; and one triangle less is a window.
    let path = bake(&["--distant", "sky.exr", "--method", "path"]);
    assert!(!kept(&path, "distant"), "{path}");
    let mut open: Vec<Triangle> = box_of([-2.0, -1.0, -3.0], [2.0, 2.0, 1.5]);
    open.pop();
    let mut level = Level::new();
    level.object(&open, 0, json!({}));
    level.write(&folder, "room.glb");
    let open = bake(&["--distant", "sky.exr"]);
    assert!(kept(&open, "distant"));
    assert_eq!(names(&folder), ["a.exr", "b.exr", "sky.exr"]);
}

#[test]
fn one_probe_is_not_blended_and_without_objects_nothing_recurs() {
    let folder = Folder::new();
    room(&folder, |_| {});
    let one = folder.bake(&[&["room.glb", "--probes", "a.exr"], &FEW[..]].concat());
    assert!(!kept(&one, "blending") && !kept(&one, "recursion"), "{one}");
    let alone = light(&folder);
    // The same probe twice: blended, and the same light.
    folder.write("again.exr", folder.read("a.exr"));
    let two = folder.bake(&[&["room.glb", "--probes", "a.exr", "--probes", "again.exr"], &FEW[..]].concat());
    assert!(kept(&two, "blending"));
    assert!(difference(&alone, &light(&folder)) < 1e-3);
    // With an object, rays go on from it.
    room(&folder, |level| {
        level.scene_object(&solid_of([0.2, -1.0, -0.5], [0.8, 0.0, 0.3]), 0);
    });
    let with = folder.bake(&[&["room.glb", "--probes", "a.exr"], &FEW[..]].concat());
    assert!(kept(&with, "recursion"));
    assert!(with["rays"].as_u64() > one["rays"].as_u64(), "{with} {one}");
}

#[test]
fn opaque_materials_decode_no_texture() {
    let folder = Folder::new();
    // An image that is none: whoever decodes it fails.
    let textured = |alpha: &str| {
        json!({
            "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "metallicFactor": 0.0 },
            "alphaMode": alpha,
        })
    };
    let write = |alpha: &str| {
        let mut level = Level::room([-2.0, -1.0, -3.0], [2.0, 2.0, 1.5]);
        let material = level.material(textured(alpha));
        level.object(&solid_of([0.5, -0.5, -1.0], [1.0, 0.5, 0.2]), material, json!({}));
        level.json["textures"] = json!([{ "source": 0 }]);
        level.json["images"] = json!([{ "uri": "no.png" }]);
        level.write(&folder, "room.glb");
    };
    room(&folder, |_| {});
    folder.write("no.png", b"no picture");
    write("OPAQUE");
    let report = folder.bake(&[&PROBES[..], &FEW[..]].concat());
    assert!(!kept(&report, "textures") && !kept(&report, "transparency"), "{report}");
    write("MASK");
    let masked = folder.run(&[&["bake"], &PROBES[..], &FEW].concat());
    assert_eq!(masked.code, 3, "{}", masked.err);
}

#[test]
fn a_small_file_holds_nothing_for_what_it_does_not_have() {
    let folder = Folder::new();
    room(&folder, |_| {});
    folder.bake(&[&ONE[..], &FEW].concat());
    let always = ["RSH", "SERR", "SETT", "PLAN", "PROB", "STAT"];
    assert_eq!(section_ids(&folder), always);
    let dense = folder.read("room.gdibl").len();
    // Three cells an axis are no place for coarser ones: the tolerance costs a few bytes of records, and no section.
    folder.bake(&[&ONE[..], &FEW, &["--tolerance", "0.01"]].concat());
    assert_eq!(section_ids(&folder), always);
    assert!(folder.read("room.gdibl").len() < dense + 200);
    // A level of even light: one node, and nothing of a grid.
    folder.write("empty.gltf", r#"{"asset": {"version": "2.0"}}"#);
    let even =
        ["empty.gltf", "--distant", "sky.exr", "--bounds=0,0,0,9,9,9", "--counts", "9,9,9", "--tolerance", "0.01"];
    let report = folder.bake(&[&even[..], &["-o", "room.gdibl"]].concat());
    assert_eq!(report["nodes"], 1);
    assert!(!kept(&report, "bounces") && !kept(&report, "capture") && !kept(&report, "walls"));
    assert_eq!(section_ids(&folder), always);
}
