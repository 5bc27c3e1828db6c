//! What is refused, with which kind of error, and that the message names the place.

use gdibl_baker::import::gltf::{GltfOptions, parse_level};
use gdibl_baker::scene::Scene;
use serde_json::{Value, json};

use crate::builder::{Level, assert_invalid, assert_unsupported, glb, png};

fn parse(bytes: &[u8]) -> gdibl_baker::Result<Scene> {
    parse_level(bytes, "level".as_ref(), &GltfOptions::default())
}

/// The triangle level with `json[pointer] = value`.
fn with(pointer: &str, value: Value) -> gdibl_baker::Result<Scene> {
    changed(Level::triangle(), pointer, value)
}

fn changed(mut level: Level, pointer: &str, value: Value) -> gdibl_baker::Result<Scene> {
    let (parent, key) = pointer.rsplit_once('/').unwrap();
    let parent = level.json.pointer_mut(parent).unwrap();
    match parent {
        Value::Array(elements) => elements[key.parse::<usize>().unwrap()] = value,
        object => object[key] = value,
    }
    level.read()
}

#[test]
fn other_file_types_are_named() {
    assert_invalid(parse(b"\x89PNG\r\n\x1a\n...."), &["PNG", "glTF"]);
    assert_invalid(parse(b""), &["empty"]);
    assert_invalid(parse(b" \n\t"), &["empty"]);
    assert_invalid(parse(b"{\"asset\": "), &["JSON", "line 1"]);
    assert_invalid(parse(b"{}"), &["asset.version"]);
    assert_invalid(parse(&[b"{\"a\":".repeat(200), b"}".repeat(200)].concat()), &["recursion"]);
}

#[test]
fn damaged_glbs_are_refused() {
    let whole = Level::triangle().to_glb();
    for length in 1..whole.len() {
        assert!(parse(&whole[..length]).is_err(), "accepted when cut to {length} bytes");
    }
    assert_invalid(parse(&whole[..whole.len() - 1]), &["truncated", &whole.len().to_string()]);
    let patched = |at: usize, bytes: &[u8]| {
        let mut damaged = whole.clone();
        damaged[at..at + bytes.len()].copy_from_slice(bytes);
        parse(&damaged)
    };
    assert_unsupported(patched(4, &[1]), &["version 1"]);
    assert_invalid(patched(8, &[16, 0, 0, 0]), &["chunk 0", "4 bytes left"]);
    assert_invalid(patched(12, &[0xFF; 4]), &["chunk 0", "4294967295"]);
    assert_invalid(patched(16, b"BIN\0"), &["first chunk", "JSON"]);
    assert_invalid(parse(&glb(&[])), &["no chunk"]);
    assert_invalid(parse(&glb(&[(*b"JSON", b"{}  "), (*b"JSON", b"{}  ")])), &["chunk 1", "order"]);
    assert_invalid(parse(&glb(&[(*b"JSON", b"{}  "), (*b"ABCD", b""), (*b"BIN\0", b"")])), &["chunk 2", "order"]);
}

#[test]
fn versions_and_required_extensions_are_checked() {
    assert_unsupported(with("/asset", json!({ "version": "1.0" })), &["1.0"]);
    assert_unsupported(with("/asset", json!({ "version": "2.1", "minVersion": "2.1" })), &["minVersion", "2.1"]);
    assert!(with("/asset", json!({ "version": "2.1", "minVersion": "2.0" })).is_ok());
    assert_invalid(with("/asset", json!({ "version": "two" })), &["two"]);
    assert_invalid(with("/asset", json!({ "version": 2 })), &["asset.version"]);
    assert_unsupported(with("/extensionsRequired", json!(["ACME_thing"])), &["ACME_thing"]);
}

#[test]
fn draco_is_refused_where_a_triangle_needs_it() {
    let mut level = Level::triangle();
    *level.primitive("extensions") = json!({ "KHR_draco_mesh_compression": { "bufferView": 0, "attributes": {} } });
    assert!(level.read().is_ok(), "there is a fallback");
    level.json["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
    assert_unsupported(level.read(), &["mesh 0 primitive 0", "draco", "gltf-transform"]);
}

#[test]
fn accessors_beyond_their_bytes_are_refused() {
    assert_invalid(
        with("/accessors/0/count", json!(4)),
        &["mesh 0 primitive 0", "POSITION", "accessor 0", "0..48", "bufferView 0", "36", "truncated"],
    );
    assert_invalid(with("/accessors/0/byteOffset", json!(4)), &["4..40"]);
    assert_invalid(with("/accessors/0/byteOffset", json!(u64::MAX)), &["accessor 0"]);
    assert_invalid(with("/accessors/0/count", json!(u64::MAX)), &["accessor 0"]);
    assert_invalid(with("/bufferViews/0/byteStride", json!(1_u64 << 63)), &["accessor 0"]);
    assert_invalid(with("/bufferViews/0/byteStride", json!(8)), &["accessor 0", "byteStride 8"]);
    assert_invalid(with("/bufferViews/0/byteOffset", json!(u64::MAX)), &["bufferView 0", "buffer 0"]);
    assert_invalid(with("/bufferViews/0/byteLength", json!(40)), &["bufferView 0", "40", "buffer 0"]);
    let buffer = json!([{ "byteLength": 37, "uri": "data:,ab" }]);
    assert_invalid(with("/buffers", buffer), &["buffer 0", "37", "2 were found"]);
    assert_invalid(with("/buffers", json!([{ "byteLength": 36 }])), &["buffer 0", "no uri"]);
}

#[test]
fn accessors_of_the_wrong_type_are_refused() {
    assert_invalid(with("/accessors/0/type", json!("VEC2")), &["POSITION", "Vec2", "Vec3"]);
    assert_invalid(with("/accessors/0/type", json!("VEC5")), &["accessor 0"]);
    assert_invalid(with("/accessors/0/componentType", json!(1)), &["accessor 0"]);
    assert_invalid(with("/accessors/0/count", json!(-1)), &["accessors[0]"]);
    assert_invalid(with("/accessors/0/count", json!("3")), &["accessors[0]"]);
    let mut level = Level::triangle();
    let indices = level.floats("SCALAR", &[0., 1., 2.]);
    *level.primitive("indices") = json!(indices);
    assert_invalid(level.read(), &["indices", "accessor 1", "F32"]);
    // Billions of zeros without a byte behind them.
    let mut level = Level::triangle();
    level.json["accessors"][0] = json!({ "componentType": 5126, "count": 200_000_000, "type": "VEC3" });
    assert_unsupported(level.read(), &["200000000", "bufferView"]);
}

#[test]
fn sparse_accessors_are_checked() {
    let sparse = |indices: &[u8], count: u64| {
        let mut level = Level::triangle();
        let indices = level.view(indices);
        let values = level.view(&[0; 24]);
        level.json["accessors"][0]["sparse"] = json!({
            "count": count,
            "indices": { "bufferView": indices, "componentType": 5121 },
            "values": { "bufferView": values },
        });
        level.read()
    };
    assert!(sparse(&[0, 1], 2).is_ok());
    assert_invalid(sparse(&[1, 1], 2), &["accessor 0 sparse", "increase"]);
    assert_invalid(sparse(&[1, 3], 2), &["accessor 0 sparse", "index 3"]);
    assert_invalid(sparse(&[0, 1, 2], 3), &["accessor 0 sparse", "0..36"]);
    assert_invalid(sparse(&[0, 1], 3), &["accessor 0 sparse", "0..3"]);
    assert_invalid(sparse(&[0, 1], 4), &["accessor 0 sparse", "4 values"]);
}

#[test]
fn indices_out_of_range_are_named() {
    let mut level = Level::triangle();
    let indices = level.indices(&[0, 1, 3]);
    *level.primitive("indices") = json!(indices);
    assert_invalid(level.read(), &["mesh 0 primitive 0", "accessor 1", "vertex 3", "accessor 0", "has 3"]);
    assert_invalid(with("/nodes/0/mesh", json!(1)), &["node 0", "mesh 1", "has 1"]);
    assert_invalid(with("/scenes/0/nodes", json!([7])), &["scene", "node 7"]);
    assert_invalid(with("/scene", json!(3)), &["scene 3"]);
    assert_invalid(with("/meshes/0/primitives/0/material", json!(0)), &["mesh 0 primitive 0", "material 0"]);
    assert_invalid(with("/meshes/0/primitives/0/attributes/POSITION", json!(9)), &["accessor 9"]);
    assert_invalid(with("/meshes/0/primitives/0/indices", json!(9)), &["accessor 9"]);
    assert_invalid(with("/accessors/0/bufferView", json!(9)), &["accessor 0", "bufferView 9"]);
    assert_invalid(with("/bufferViews/0/buffer", json!(9)), &["bufferView 0", "buffer 9"]);
    assert_invalid(with("/meshes/0/primitives/0/mode", json!(9)), &["mode"]);
    let options = GltfOptions { scene: Some(1), ..Default::default() };
    assert_invalid(Level::triangle().read_with(&options), &["scene 1", "has 1"]);
}

#[test]
fn numbers_that_would_be_cut_to_32_bits_are_refused() {
    let big = 1_u64 << 32;
    assert_invalid(with("/meshes/0/primitives/0/attributes/POSITION", json!(big)), &["meshes", "4294967296"]);
    assert_invalid(with("/bufferViews/0/buffer", json!(big)), &["bufferViews", "4294967296"]);
    assert_invalid(with("/accessors/0/componentType", json!(big + 5126)), &["accessors"]);
    assert_invalid(with("/nodes/0/mesh", json!(big)), &["nodes[0]"]);
    assert_invalid(with("/scene", json!(big)), &["scene"]);
}

#[test]
fn attributes_of_different_length_are_refused() {
    let mut level = Level::triangle();
    let normal = level.floats("VEC3", &[0., 0., 1., 0., 0., 1.]);
    *level.primitive("attributes") = json!({ "POSITION": 0, "NORMAL": normal });
    assert_invalid(level.read(), &["NORMAL", "has 2", "POSITION 3"]);
    *level.primitive("attributes") = json!({ "POSITION": 0 });
    *level.primitive("targets") = json!([{ "POSITION": normal }]);
    level.json["meshes"][0]["weights"] = json!([1]);
    assert_invalid(level.read(), &["morph target 0 POSITION", "2 elements"]);
}

#[test]
fn cycles_and_second_parents_are_refused() {
    let mut level = Level::triangle();
    level.json["nodes"] = json!([{ "children": [1] }, { "children": [0] }]);
    assert_invalid(level.read(), &["node 0", "the scene", "node 1", "cycle"]);
    level.json["nodes"] = json!([{ "children": [0] }]);
    assert_invalid(level.read(), &["node 0", "cycle"]);
    level.json["nodes"] = json!([{ "children": [1, 2] }, { "children": [2], "name": "b" }, {}]);
    assert_invalid(level.read(), &["node 2", "node 1 (b)", "node 0"]);
    level.json["nodes"] = json!([{ "children": [1] }, { "children": [0] }]);
    level.json.as_object_mut().unwrap().remove("scenes");
    assert_invalid(level.read(), &["cycle"]);
}

#[test]
fn broken_transforms_are_refused() {
    let node = |value: Value| with("/nodes/0", value);
    assert_invalid(node(json!({ "rotation": [0, 0, 0, 0] })), &["node 0", "rotation"]);
    assert_invalid(node(json!({ "matrix": vec![0; 16] })), &["node 0", "last row"]);
    assert_invalid(node(json!({ "matrix": [0, 1] })), &["nodes[0]"]);
    let mut level = Level::triangle();
    level.json["nodes"] = json!([{ "scale": [1e200, 1, 1], "children": [1] }, { "scale": [1e200, 1, 1] }]);
    assert_invalid(level.read(), &["node 1", "not finite"]);
}

#[test]
fn artists_marks_are_checked() {
    let extras = |value: Value| with("/nodes/0", json!({ "name": "Crate", "extras": value }));
    assert_invalid(extras(json!({ "gdibl_role": "scenery" })), &["node 0 (Crate)", "scenery", "environment"]);
    assert_invalid(extras(json!({ "gdibl_role": 1 })), &["node 0 (Crate)", "gdibl_role"]);
    assert_invalid(extras(json!({ "gdibl_probe": 1 })), &["node 0 (Crate)", "gdibl_probe"]);
    assert_invalid(extras(json!({ "gdibl_volume": 0 })), &["node 0 (Crate)", "gdibl_volume"]);
    assert_invalid(extras(json!({ "gdibl_volume": "1" })), &["node 0 (Crate)", "gdibl_volume"]);
    let empty = json!({ "name": "Hall", "scale": [4, 0, 4], "extras": { "gdibl_volume": 1 } });
    assert_invalid(with("/nodes/0", empty), &["node 0 (Hall)", "gdibl_volume", "8 x 0 x 8 m", "empty"]);
    let flat = json!({ "scale": [0, 0, 0], "extras": { "gdibl_probe": "a.exr" } });
    assert_invalid(with("/nodes/0", flat), &["node 0", "scale 0"]);
}

#[test]
fn broken_lights_are_refused() {
    let light = |light: Value| {
        let mut level = Level::new();
        level.json["extensions"] = json!({ "KHR_lights_punctual": { "lights": [light] } });
        level.json["nodes"] = json!([{ "extensions": { "KHR_lights_punctual": { "light": 0 } } }]);
        level
    };
    assert_invalid(light(json!({ "type": "point", "intensity": -1 })).read(), &["light 0 on node 0", "intensity"]);
    assert_invalid(light(json!({ "type": "point", "intensity": 1e39 })).read(), &["light 0 on node 0", "intensity"]);
    assert_invalid(light(json!({ "color": [1, 1, 1] })).read(), &["lights[0]", "type"]);
    let spot = |inner: f32, outer: f32| json!({ "type": "spot", "spot": { "innerConeAngle": inner, "outerConeAngle": outer } });
    assert_invalid(light(spot(0.3, 0.2)).read(), &["light 0", "cone"]);
    assert_invalid(light(spot(0.3, 3.0)).read(), &["light 0", "cone"]);
    let mut level = light(json!({ "type": "point" }));
    level.json["nodes"][0]["extensions"]["KHR_lights_punctual"]["light"] = json!(1);
    assert_invalid(level.read(), &["node 0", "light 1"]);
    level.json["nodes"][0]["extensions"]["KHR_lights_punctual"] = json!({});
    assert_invalid(level.read(), &["node 0", "light"]);
}

#[test]
fn broken_instances_are_refused() {
    let mut level = Level::triangle();
    let two = level.floats("VEC3", &[0.; 6]);
    let one = level.floats("VEC4", &[0., 0., 0., 1.]);
    let mut instanced = |attributes: Value| {
        level.json["nodes"][0]["extensions"] = json!({ "EXT_mesh_gpu_instancing": { "attributes": attributes } });
        level.read()
    };
    assert_invalid(instanced(json!({ "TRANSLATION": two, "ROTATION": one })), &["node 0", "[2, 1]"]);
    assert_invalid(instanced(json!({ "TRANSLATION": one })), &["TRANSLATION", "Vec4"]);
    assert_invalid(instanced(json!({ "TRANSLATION": "x" })), &["TRANSLATION", "accessor index"]);
    assert_invalid(instanced(json!({ "SCALE": 99 })), &["SCALE", "accessor 99"]);
}

#[test]
fn too_many_triangles_are_unsupported() {
    let mut level = Level::triangle();
    level.json["nodes"] = json!([{ "mesh": 0 }, { "mesh": 0 }]);
    level.json["scenes"] = json!([{ "nodes": [0, 1] }]);
    let capped = |level: &Level, max_triangles| level.read_with(&GltfOptions { max_triangles, ..Default::default() });
    assert!(capped(&level, 2).is_ok());
    assert_unsupported(capped(&level, 1), &["node 1", "2 triangles", "at most 1"]);
    // A few bytes of instances, times a mesh: refused before anything is made.
    let instances = level.accessor("VEC3", 5126, 1000, &[0; 12_000]);
    level.json["nodes"][0]["extensions"] =
        json!({ "EXT_mesh_gpu_instancing": { "attributes": { "SCALE": instances } } });
    assert_unsupported(capped(&level, 999), &["node 0", "1000 triangles"]);
    level.json["accessors"][instances] = json!({ "componentType": 5126, "count": 1 << 24, "type": "VEC3" });
    assert_unsupported(level.read(), &["node 0", "16777216 instances"]);
}

#[test]
fn broken_materials_and_textures_are_refused() {
    let mask = |texture: usize| json!({ "alphaMode": "MASK", "pbrMetallicRoughness": { "baseColorTexture": { "index": texture } } });
    let level = || Level::textured(mask(0), &png(2, 2, &[[9; 4]; 4]));
    assert!(level().read().is_ok());
    assert_invalid(changed(level(), "/materials/0/alphaMode", json!("GLASS")), &["material 0", "alphaMode"]);
    assert_invalid(changed(level(), "/materials/0/emissiveFactor", json!([1e39, 0, 0])), &["material 0", "emits"]);
    assert_invalid(changed(level(), "/materials/0", mask(5)), &["texture 5"]);
    assert_invalid(changed(level(), "/textures/0", json!({ "source": 4 })), &["texture 0", "image 4"]);
    assert_invalid(changed(level(), "/textures/0", json!({ "source": 0, "sampler": 2 })), &["texture 0", "sampler 2"]);
    assert_invalid(changed(level(), "/textures/0", json!({})), &["texture 0", "names no image"]);
    assert_invalid(changed(level(), "/images/0", json!({ "name": "wood" })), &["image 0 (wood)", "neither"]);
    assert_invalid(changed(level(), "/images/0/uri", json!("gone.png")), &["image 0 (gone.png)", "missing"]);
    assert_invalid(changed(level(), "/images/0/uri", json!("http://a.org/b.png")), &["image 0", "http:"]);
    assert_invalid(changed(level(), "/images/0/uri", json!("../b.png")), &["image 0", "leaves"]);
    assert_invalid(changed(level(), "/images/0/uri", json!("data:,abc")), &["image 0", "abc", "PNG"]);
    let basisu = json!({ "extensions": { "KHR_texture_basisu": { "source": 0 } } });
    assert_unsupported(changed(level(), "/textures/0", basisu), &["texture 0", "KTX2", "convert"]);
    assert_unsupported(changed(level(), "/images/0/uri", json!("data:,%ABKTX 20%BB")), &["image 0", "KTX2", "convert"]);
}

#[test]
fn damaged_images_are_refused() {
    let pixels: Vec<[u8; 4]> = (0..64 * 64).map(|i| [(i * 7) as u8, (i / 3) as u8, i as u8, (i * 13) as u8]).collect();
    let whole = png(64, 64, &pixels);
    let mask = json!({ "alphaMode": "MASK", "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } });
    assert!(Level::textured(mask.clone(), &whole).read().is_ok());
    assert_invalid(Level::textured(mask.clone(), &whole[..whole.len() / 2]).read(), &["image 0", "damaged"]);
    // A header that asks for 4 GB, its checksum made right.
    let mut huge = whole;
    huge[16..24].copy_from_slice(&[0, 0, 0x7F, 0xFF, 0, 0, 0x7F, 0xFF]);
    let checksum = crc32fast::hash(&huge[12..29]).to_be_bytes();
    huge[29..33].copy_from_slice(&checksum);
    assert_unsupported(Level::textured(mask, &huge).read(), &["image 0", "16384"]);
}
