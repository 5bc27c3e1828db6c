//! Small levels made in memory: a JSON value and the bytes of its buffers.

use std::path::Path;

use base64::Engine;
use gdibl_baker::import::gltf::{GltfOptions, TextureNeeds, parse_level};
use gdibl_baker::scene::Scene;
use gdibl_baker::{Error, Result};
use serde_json::{Value, json};

/// A level under construction: `json` may be edited freely, `bytes` is buffer 0.
pub struct Level {
    pub json: Value,
    pub bytes: Vec<u8>,
}

impl Level {
    /// An asset and nothing else.
    pub fn new() -> Self {
        Level { json: json!({ "asset": { "version": "2.0" } }), bytes: Vec::new() }
    }

    /// A node with a mesh of one triangle: (0,0,0), (1,0,0), (0,1,0), facing +Z. Accessor 0 is its POSITION.
    pub fn triangle() -> Self {
        let mut level = Level::new();
        let position = level.floats("VEC3", &[0., 0., 0., 1., 0., 0., 0., 1., 0.]);
        level.json["meshes"] = json!([{ "primitives": [{ "attributes": { "POSITION": position } }] }]);
        level.json["nodes"] = json!([{ "mesh": 0 }]);
        level.json["scenes"] = json!([{ "nodes": [0] }]);
        level
    }

    /// The triangle with material 0 = `material`, texture coordinates, and `png` as texture 0.
    pub fn textured(material: Value, png: &[u8]) -> Self {
        let mut level = Level::triangle();
        let uv = level.floats("VEC2", &[0., 0., 1., 0., 0., 1.]);
        *level.primitive("attributes") = json!({ "POSITION": 0, "TEXCOORD_0": uv });
        *level.primitive("material") = json!(0);
        level.json["materials"] = json!([material]);
        level.json["textures"] = json!([{ "source": 0 }]);
        level.json["images"] = json!([{ "uri": data_uri("image/png", png) }]);
        level
    }

    /// A field of mesh 0's primitive 0.
    pub fn primitive(&mut self, field: &str) -> &mut Value {
        &mut self.json["meshes"][0]["primitives"][0][field]
    }

    /// Appends a buffer view over `bytes`; returns its index.
    pub fn view(&mut self, bytes: &[u8]) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let view = json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() });
        self.bytes.extend_from_slice(bytes);
        push(&mut self.json, "bufferViews", view)
    }

    /// Appends an accessor over `bytes`; returns its index.
    pub fn accessor(&mut self, kind: &str, component_type: u32, count: usize, bytes: &[u8]) -> usize {
        let view = self.view(bytes);
        let accessor = json!({ "bufferView": view, "componentType": component_type, "count": count, "type": kind });
        push(&mut self.json, "accessors", accessor)
    }

    /// Appends an accessor of f32.
    pub fn floats(&mut self, kind: &str, values: &[f32]) -> usize {
        let components = match kind {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            _ => 4,
        };
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.accessor(kind, 5126, values.len() / components, &bytes)
    }

    /// Appends an accessor of u16 scalars.
    pub fn indices(&mut self, values: &[u16]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.accessor("SCALAR", 5123, values.len(), &bytes)
    }

    /// The level as `.gltf` text, buffer 0 in a data URI.
    pub fn to_gltf(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        if !self.bytes.is_empty() && json.get("buffers").is_none() {
            let uri = data_uri("application/octet-stream", &self.bytes);
            json["buffers"] = json!([{ "byteLength": self.bytes.len(), "uri": uri }]);
        }
        serde_json::to_vec(&json).unwrap()
    }

    /// The level as `.glb`.
    pub fn to_glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        if !self.bytes.is_empty() && json.get("buffers").is_none() {
            json["buffers"] = json!([{ "byteLength": self.bytes.len() }]);
        }
        let mut text = serde_json::to_vec(&json).unwrap();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut binary = self.bytes.clone();
        binary.resize(binary.len().next_multiple_of(4), 0);
        glb(&[(*b"JSON", &text), (*b"BIN\0", &binary)])
    }

    /// Reads it with the default options.
    pub fn read(&self) -> Result<Scene> {
        self.read_with(&GltfOptions::default())
    }

    /// Reads it with all textures.
    pub fn read_all(&self) -> Result<Scene> {
        self.read_with(&GltfOptions { textures: TextureNeeds::All, ..Default::default() })
    }

    /// Reads it from a folder that does not exist.
    pub fn read_with(&self, options: &GltfOptions) -> Result<Scene> {
        parse_level(&self.to_gltf(), Path::new("no such folder/level.gltf"), options)
    }
}

/// A GLB of `chunks`.
pub fn glb(chunks: &[([u8; 4], &[u8])]) -> Vec<u8> {
    let mut out = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
    for (kind, data) in chunks {
        out.extend_from_slice(&(data.len() as u32).to_le_bytes());
        out.extend_from_slice(kind);
        out.extend_from_slice(data);
    }
    let length = out.len() as u32;
    out[8..12].copy_from_slice(&length.to_le_bytes());
    out
}

/// A base64 data URI.
pub fn data_uri(media_type: &str, bytes: &[u8]) -> String {
    format!("data:{media_type};base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes))
}

/// A PNG of RGBA pixels.
pub fn png(width: u32, height: u32, pixels: &[[u8; 4]]) -> Vec<u8> {
    encode(
        image::RgbaImage::from_raw(width, height, pixels.as_flattened().to_vec()).unwrap().into(),
        image::ImageFormat::Png,
    )
}

/// An encoded image.
pub fn encode(image: image::DynamicImage, format: image::ImageFormat) -> Vec<u8> {
    let mut out = std::io::Cursor::new(Vec::new());
    image.write_to(&mut out, format).unwrap();
    out.into_inner()
}

/// Appends `value` to the array `key`; returns its index.
pub fn push(json: &mut Value, key: &str, value: Value) -> usize {
    if json.get(key).is_none() {
        json[key] = json!([]);
    }
    let array = json[key].as_array_mut().unwrap();
    array.push(value);
    array.len() - 1
}

/// Triangles in the whole scene.
pub fn triangle_count(scene: &Scene) -> usize {
    scene.meshes.iter().map(|mesh| mesh.triangles.len()).sum()
}

/// The count of finding `id`, 0 without it.
pub fn finding(scene: &Scene, id: &str) -> u64 {
    scene.findings.iter().find(|finding| finding.id == id).map_or(0, |finding| finding.count)
}

/// Asserts that `result` is `Error::Invalid` and its message contains all of `parts`.
#[track_caller]
pub fn assert_invalid(result: Result<Scene>, parts: &[&str]) {
    match result {
        Err(Error::Invalid { message, .. }) => assert_contains(&message, parts),
        other => panic!("expected Error::Invalid with {parts:?}, found {other:?}"),
    }
}

/// Asserts that `result` is `Error::Unsupported` and its message contains all of `parts`.
#[track_caller]
pub fn assert_unsupported(result: Result<Scene>, parts: &[&str]) {
    match result {
        Err(Error::Unsupported { message, .. }) => assert_contains(&message, parts),
        other => panic!("expected Error::Unsupported with {parts:?}, found {other:?}"),
    }
}

#[track_caller]
fn assert_contains(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "\"{message}\" does not contain \"{part}\"");
    }
}
