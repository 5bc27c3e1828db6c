//! Makes `assets/uffizi-box` from the full-size box: a smaller lighting, low-polygon spheres, reference in few digits.
//!
//! `cargo run --release -p gdibl-tools --bin make_assets -- UFFIZI_FOLDER LIGHTING assets/uffizi-box`

use gdibl_baker::import::image::{Image, Pose, SampleFormat, write_exr};
use gdibl_baker::panorama::{Mapping, Panorama};
use gdibl_baker::scene::{Role, Scene};
use gdibl_baker::trace::{Frame, Surfaces};
use gdibl_tools::{BOX_PROBES, BOX_SPHERES, SPHERE_RADIUS, read_panorama, read_scene};
use glam::{DVec3, Vec3};
use serde_json::{Value, json};
use std::path::Path;

/// Width of a shipped probe, and of the distant panorama.
const PROBE_WIDTH: usize = 256;
const DISTANT_WIDTH: usize = 512;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [source, lighting, target] = &arguments[..] else {
        eprintln!("usage: make_assets UFFIZI_FOLDER LIGHTING TARGET_FOLDER");
        std::process::exit(2);
    };
    let (source, target) = (Path::new(source), Path::new(target));
    std::fs::create_dir_all(target).expect("the target folder");
    let empty_box = source.join("uffizi_box_nospheres.glb");
    std::fs::copy(&empty_box, target.join("empty-box.glb")).expect("the empty box");
    std::fs::write(target.join("uffizi-box.glb"), with_spheres(&std::fs::read(&empty_box).expect("the empty box")))
        .expect("the box with spheres");
    let scene = read_scene(&empty_box);
    for (i, &position) in BOX_PROBES.iter().enumerate() {
        let name = format!("probe_{i}.exr");
        let full = read_panorama(&source.join(lighting).join(&name));
        let distance = distances(&scene, position, PROBE_WIDTH);
        let image = Image { distance: Some(distance), ..halved(&full, PROBE_WIDTH) };
        let pose = Pose { position: Some(position), rotation: None };
        write(&target.join(name), &image, &pose);
    }
    let distant = read_panorama(&source.join(lighting).join("distant.exr"));
    write(&target.join("distant.exr"), &halved(&distant, DISTANT_WIDTH), &Pose { position: None, rotation: None });
    let reference = std::fs::read_to_string(source.join(lighting).join("reference.json")).expect("the reference");
    let mut reference = few_digits(serde_json::from_str(&reference).expect("JSON"));
    for (name, level) in [
        ("grid", "empty-box.glb"),
        ("scattered", "empty-box.glb"),
        ("sphere_irradiance_empty_box", "empty-box.glb"),
        ("sphere_irradiance_with_spheres", "uffizi-box.glb"),
    ] {
        reference[name]["level"] = level.into();
    }
    std::fs::write(target.join("reference.json"), reference.to_string()).expect("the reference");
}

fn write(path: &Path, image: &Image, pose: &Pose) {
    let findings = write_exr(path, image, pose, Mapping::LatLong, SampleFormat::F16).unwrap_or_else(|e| panic!("{e}"));
    assert!(findings.is_empty(), "{findings:?}");
}

/// Box-filtered to `width`. A pixel that looks out takes from pixels that look out alone, and the other way round.
fn halved(full: &Panorama, width: usize) -> Image {
    let factor = full.width() / width;
    assert_eq!(full.width(), width * factor, "a whole factor");
    let height = full.height() / factor;
    let escapes = |x: usize, y: usize| full.pixel_distance(x, y) == Some(f32::INFINITY);
    let pixels = (0..width * height).map(|i| {
        let (x, y) = (i % width * factor, i / width * factor);
        // The lower right of the four in the middle stands for the centre.
        let outside = escapes(x + factor / 2, y + factor / 2);
        let (mut sum, mut count) = (Vec3::ZERO, 0.0);
        for (dx, dy) in (0..factor * factor).map(|k| (k % factor, k / factor)) {
            if escapes(x + dx, y + dy) == outside {
                sum += full.pixel(x + dx, y + dy);
                count += 1.0;
            }
        }
        (sum / count).to_array()
    });
    Image::new(width, height, pixels.collect())
}

/// Metres along the ray of every pixel centre, +infinity where it leaves the box.
fn distances(scene: &Scene, position: DVec3, width: usize) -> Vec<f32> {
    let (min, max) = scene.bounds(|_| true).expect("triangles");
    let frame = Frame::of_bounds(min, max);
    let surfaces = Surfaces::new(scene, |m| m.role == Role::Environment, &frame).expect("triangles");
    let height = width / 2;
    let panorama = Panorama::new(width, height, vec![[0.0; 3]; width * height], None);
    let distance = |i: usize| {
        let direction = panorama.pixel_direction(i % width, i / width);
        let hit = surfaces.closest(scene, frame.to_trace(position), direction, 0.0, f32::INFINITY);
        hit.map_or(f32::INFINITY, |hit| frame.metres(hit.t))
    };
    (0..width * height).map(distance).collect()
}

/// The box's GLB with three spheres of role `scene` appended.
fn with_spheres(glb: &[u8]) -> Vec<u8> {
    let length = u32::from_le_bytes(glb[12..16].try_into().expect("four bytes")) as usize;
    let mut root: Value = serde_json::from_slice(&glb[20..20 + length]).expect("JSON");
    let mut binary = glb[20 + length + 8..].to_vec();
    let (directions, triangles) = icosphere(3);
    let mut append = |bytes: Vec<u8>| {
        binary.resize(binary.len().next_multiple_of(4), 0);
        let offset = binary.len();
        binary.extend_from_slice(&bytes);
        json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes.len() })
    };
    let floats = |scale: f32| directions.iter().flat_map(move |d| (*d * scale).to_array()).flat_map(f32::to_le_bytes);
    let views = [
        append(floats(SPHERE_RADIUS).collect()),
        append(floats(1.0).collect()),
        append(triangles.iter().flatten().flat_map(|i| i.to_le_bytes()).collect()),
    ];
    let list = |root: &mut Value, name: &str, value: Value| {
        let list = root[name].as_array_mut().expect("a list");
        list.push(value);
        list.len() - 1
    };
    let views = views.map(|view| list(&mut root, "bufferViews", view));
    let vector = json!({ "bufferView": views[0], "componentType": 5126, "count": directions.len(), "type": "VEC3",
                         "min": [-SPHERE_RADIUS, -SPHERE_RADIUS, -SPHERE_RADIUS],
                         "max": [SPHERE_RADIUS, SPHERE_RADIUS, SPHERE_RADIUS] });
    let position = list(&mut root, "accessors", vector);
    let vector = json!({ "bufferView": views[1], "componentType": 5126, "count": directions.len(), "type": "VEC3" });
    let normal = list(&mut root, "accessors", vector);
    let scalar =
        json!({ "bufferView": views[2], "componentType": 5123, "count": triangles.len() * 3, "type": "SCALAR" });
    let indices = list(&mut root, "accessors", scalar);
    let white = json!({ "name": "sphere", "pbrMetallicRoughness":
                        { "baseColorFactor": [0.8, 0.8, 0.8, 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0 } });
    let material = list(&mut root, "materials", white);
    let primitive = json!({ "attributes": { "POSITION": position, "NORMAL": normal }, "indices": indices,
                            "material": material });
    let mesh = list(&mut root, "meshes", json!({ "name": "sphere", "primitives": [primitive] }));
    for (i, center) in BOX_SPHERES.iter().enumerate() {
        let node = json!({ "name": format!("sphere{i}"), "mesh": mesh, "translation": center.to_array(),
                           "extras": { "gdibl_role": "scene" } });
        let node = list(&mut root, "nodes", node);
        root["scenes"][0]["nodes"].as_array_mut().expect("a list").push(node.into());
    }
    root["buffers"][0]["byteLength"] = binary.len().into();
    glb_bytes(&root, binary)
}

fn glb_bytes(root: &Value, mut binary: Vec<u8>) -> Vec<u8> {
    let mut text = root.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let word = |n: usize| (n as u32).to_le_bytes();
    let total = 12 + 8 + text.len() + 8 + binary.len();
    [
        b"glTF" as &[u8],
        &word(2),
        &word(total),
        &word(text.len()),
        b"JSON",
        &text,
        &word(binary.len()),
        b"BIN\0",
        &binary,
    ]
    .concat()
}

/// Unit directions and triangles, counter-clockwise from outside: an icosahedron, every triangle split in four.
fn icosphere(levels: u32) -> (Vec<Vec3>, Vec<[u16; 3]>) {
    let golden = (1.0 + 5f32.sqrt()) / 2.0;
    let mut corners: Vec<Vec3> = [(-1.0, golden), (1.0, golden), (-1.0, -golden), (1.0, -golden)]
        .iter()
        .flat_map(|&(a, b)| [Vec3::new(a, b, 0.0), Vec3::new(0.0, a, b), Vec3::new(b, 0.0, a)])
        .map(Vec3::normalize)
        .collect();
    // The twenty triples of mutual neighbours, turned outward.
    let edge = corners[1..].iter().map(|c| (*c - corners[0]).length()).fold(f32::INFINITY, f32::min);
    let near = |a: usize, b: usize| ((corners[a] - corners[b]).length() / edge - 1.0).abs() < 1e-3;
    let mut triangles = Vec::new();
    for (a, b, c) in (0..12).flat_map(|a| (a + 1..12).flat_map(move |b| (b + 1..12).map(move |c| (a, b, c)))) {
        if near(a, b) && near(b, c) && near(a, c) {
            let outward = (corners[b] - corners[a]).cross(corners[c] - corners[a]).dot(corners[a]) > 0.0;
            triangles.push(if outward { [a, b, c] } else { [a, c, b] }.map(|i| i as u16));
        }
    }
    assert_eq!(triangles.len(), 20, "an icosahedron has 20 triangles");
    for _ in 0..levels {
        let mut middles = std::collections::BTreeMap::new();
        let mut middle = |a: u16, b: u16| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                corners.push((corners[a as usize] + corners[b as usize]).normalize());
                corners.len() as u16 - 1
            })
        };
        triangles = triangles
            .iter()
            .flat_map(|&[a, b, c]| {
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
            })
            .collect();
    }
    (corners, triangles)
}

/// Six digits: a tenth of the reference's own standard error.
fn few_digits(value: Value) -> Value {
    match value {
        Value::Number(number) => {
            let text = format!("{:.5e}", number.as_f64().expect("a float"));
            json!(text.parse::<f64>().expect("a float"))
        }
        Value::Array(values) => values.into_iter().map(few_digits).collect(),
        Value::Object(fields) => fields.into_iter().map(|(name, value)| (name, few_digits(value))).collect(),
        other => other,
    }
}
