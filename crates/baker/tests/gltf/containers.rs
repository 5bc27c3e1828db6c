//! Files, chunks, versions of what is there: how a level is opened.

use gdibl_baker::Error;
use gdibl_baker::import::gltf::{GltfOptions, parse_level, read_level};
use glam::{DVec3, Vec3};
use serde_json::json;

use crate::builder::{Level, data_uri, finding, glb, triangle_count};

#[test]
fn gltf_and_glb_read_the_same() {
    let level = Level::triangle();
    let from_json = level.read().unwrap();
    let from_glb = parse_level(&level.to_glb(), "a.glb".as_ref(), &GltfOptions::default()).unwrap();
    assert_eq!(from_json.meshes[0].positions, [DVec3::ZERO, DVec3::X, DVec3::Y]);
    assert_eq!(from_json.meshes[0].normals, [Vec3::Z; 3]);
    assert_eq!(from_json.meshes[0].triangles, [[0, 1, 2]]);
    assert_eq!(from_glb.meshes[0].positions, from_json.meshes[0].positions);
    assert_eq!(from_json.findings, []);
}

#[test]
fn byte_order_mark_and_white_space_are_skipped() {
    let text = [b"\xEF\xBB\xBF \n".as_slice(), &Level::triangle().to_gltf()].concat();
    let scene = parse_level(&text, "a.gltf".as_ref(), &GltfOptions::default()).unwrap();
    assert_eq!(triangle_count(&scene), 1);
}

#[test]
fn json_that_others_read_is_read() {
    let level = Level::triangle();
    let text = String::from_utf8(level.to_gltf()).unwrap();
    let read = |text: &[u8]| parse_level(text, "a.gltf".as_ref(), &GltfOptions::default()).unwrap();
    // Integers with a fraction of 0, in every place where there is an integer.
    let spread = text.replace(":0,", ":0.0,").replace(":3,", ":3.0,").replace(":5126,", ":5.126e3,");
    let spread = spread.replace("[0]", "[0.0]").replace(":36,", ":36.0,").replace(":36}", ":36.0}");
    assert!(spread.matches(".0").count() > 6 && spread.contains("5.126e3"), "{spread}");
    assert_eq!(read(spread.as_bytes()).meshes[0].positions, level.read().unwrap().meshes[0].positions);
    // Members that are null are absent.
    let nulls =
        text.replace("{\"mesh\":", "{\"children\":null,\"skin\":null,\"matrix\":null,\"extras\":null,\"mesh\":");
    assert!(nulls.contains("null"));
    assert_eq!(triangle_count(&read(nulls.as_bytes())), 1);
    // Padding by zeros, as text and as chunk.
    assert_eq!(triangle_count(&read(&[text.as_bytes(), &[0; 5]].concat())), 1);
    let mut json = level.json.clone();
    json["buffers"] = json!([{ "byteLength": level.bytes.len() }]);
    let mut chunk = serde_json::to_vec(&json).unwrap();
    chunk.resize(chunk.len().next_multiple_of(4) + 4, 0);
    assert_eq!(triangle_count(&read(&glb(&[(*b"JSON", &chunk), (*b"BIN\0", &level.bytes)]))), 1);
    // Names in Latin-1, and cut between surrogates.
    let named = |name: &[u8]| {
        let at = text.find("{\"mesh\":").unwrap() + 1;
        let name = [b"\"name\":\"".as_slice(), name, b"\","].concat();
        read(&[&text.as_bytes()[..at], &name, &text.as_bytes()[at..]].concat())
    };
    assert_eq!(finding(&named(b"W\xE4nde"), "json-not-utf8"), 1);
    assert_eq!(finding(&named(br"W\ud83d"), "json-lone-surrogates"), 1);
    assert!(named("Wände".as_bytes()).findings.is_empty());
}

#[test]
fn glb_skips_unknown_chunks_and_tells_of_trailing_bytes() {
    let level = Level::triangle();
    let mut json = level.json.clone();
    json["buffers"] = json!([{ "byteLength": level.bytes.len() }]);
    let json = serde_json::to_vec(&json).unwrap();
    let mut bytes = glb(&[(*b"JSON", &json), (*b"BIN\0", &level.bytes), (*b"ABCD", &[1, 2, 3, 4])]);
    bytes.extend_from_slice(b"tail");
    let scene = parse_level(&bytes, "a.glb".as_ref(), &GltfOptions::default()).unwrap();
    assert_eq!(triangle_count(&scene), 1);
    assert_eq!(finding(&scene, "glb-trailing-bytes"), 4);
}

#[test]
fn a_level_without_anything_is_a_level() {
    let scene = Level::new().read().unwrap();
    assert_eq!((scene.meshes.len(), scene.materials.len()), (0, 1));
    assert!(scene.findings.is_empty());
}

#[test]
fn files_beside_the_level_are_read_by_decoded_names() {
    let folder = tempfile::tempdir().unwrap();
    let mut level = Level::triangle();
    std::fs::create_dir(folder.path().join("sub")).unwrap();
    std::fs::write(folder.path().join("sub/geo metry.bin"), &level.bytes).unwrap();
    level.json["buffers"] = json!([{ "byteLength": level.bytes.len(), "uri": "sub/geo%20metry.bin" }]);
    let path = folder.path().join("level.gltf");
    std::fs::write(&path, serde_json::to_vec(&level.json).unwrap()).unwrap();
    assert_eq!(triangle_count(&read_level(&path, &GltfOptions::default()).unwrap()), 1);

    std::fs::remove_file(folder.path().join("sub/geo metry.bin")).unwrap();
    let error = read_level(&path, &GltfOptions::default()).unwrap_err();
    assert!(matches!(&error, Error::Invalid { message, .. } if message.contains("geo%20metry.bin")), "{error}");
    std::fs::remove_file(&path).unwrap();
    assert!(matches!(read_level(&path, &GltfOptions::default()), Err(Error::Io { .. })));
}

#[test]
fn data_uris_need_no_folder() {
    let mut level = Level::triangle();
    let uri = data_uri("application/octet-stream", &level.bytes).replace('=', "%3D");
    level.json["buffers"] = json!([{ "byteLength": level.bytes.len(), "uri": uri }]);
    assert_eq!(triangle_count(&level.read().unwrap()), 1);
}

#[test]
fn optional_extensions_are_ignored_with_a_finding() {
    let mut level = Level::triangle();
    level.json["extensionsUsed"] = json!(["NV_materials_mdl", "KHR_materials_unlit", "ACME_thing"]);
    // Newer animations that the JSON model cannot read do not matter.
    level.json["animations"] = json!([{ "channels": [{ "target": { "path": "pointer" } }] }]);
    level.json["cameras"] = json!([{ "type": "hologram" }]);
    let scene = level.read().unwrap();
    assert_eq!(finding(&scene, "ignored-extensions"), 2);
}
