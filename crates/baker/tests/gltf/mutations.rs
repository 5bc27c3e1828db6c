//! Damaged files give an error or a scene, never a panic: bytes flipped, words overwritten, ends cut off.

use std::path::Path;

use gdibl_baker::import::gltf::{GltfOptions, TextureNeeds, parse_level};
use serde_json::json;

use crate::builder::{Level, png};

/// PCG's output over a 64-bit congruential generator: small, seeded, the same everywhere.
pub struct Random(pub u64);

impl Random {
    pub fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let shifted = (((self.0 >> 18) ^ self.0) >> 27) as u32;
        let value = shifted.rotate_right((self.0 >> 59) as u32);
        ((u64::from(value) * limit as u64) >> 32) as usize
    }
}

/// Damages `bytes` in one to three places, mostly gently: what fails to parse as JSON tests nothing behind it.
pub fn mutate(bytes: &mut Vec<u8>, random: &mut Random) {
    for _ in 0..1 + random.below(3) {
        if bytes.is_empty() {
            return;
        }
        let at = random.below(bytes.len());
        match random.below(24) {
            0 => bytes.truncate(at),
            1 => {
                bytes.remove(at);
            }
            2 => bytes.insert(at, random.below(256) as u8),
            3 => {
                let words = [0, u32::MAX, 0x7FFF_FFFF, 0x7F80_0000, 1];
                let word: u32 = words[random.below(words.len())];
                for (byte, new) in bytes[at..].iter_mut().zip(word.to_le_bytes()) {
                    *byte = new;
                }
            }
            // JSON lives on its digits.
            4..16 => {
                let mut digits = bytes.iter().enumerate().skip(at).filter(|(_, b)| b.is_ascii_digit()).map(|(i, _)| i);
                if let Some(i) = digits.next() {
                    bytes[i] = b"01234567890123456789-e."[random.below(23)];
                }
            }
            _ => bytes[at] ^= 1 << random.below(8),
        }
    }
}

/// Reads a damaged level with either choice of textures; says whether it was accepted.
pub fn survives(bytes: &[u8], path: &Path) -> bool {
    let textures = if bytes.len().is_multiple_of(2) { TextureNeeds::All } else { TextureNeeds::Gdibl };
    // A million triangles bound the time, too.
    let options = GltfOptions { textures, max_triangles: 1_000_000, ..Default::default() };
    parse_level(bytes, path, &options).is_ok()
}

/// A small level that uses as many features as it can.
fn rich_level() -> Level {
    let material = json!({
        "alphaMode": "BLEND",
        "pbrMetallicRoughness": { "baseColorTexture": { "index": 0, "extensions": {
            "KHR_texture_transform": { "offset": [0.5, 0], "rotation": 1, "scale": [2, 2], "texCoord": 0 },
        } } },
        "emissiveFactor": [1, 1, 1],
        "emissiveTexture": { "index": 0 },
        "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 4 } },
    });
    let image = png(2, 2, &[[1, 2, 3, 4], [5, 6, 7, 8], [9, 10, 11, 12], [13, 14, 15, 16]]);
    let mut level = Level::textured(material, &image);
    let view = level.view(&image);
    level.json["images"] = json!([{ "bufferView": view, "mimeType": "image/png" }]);
    let normal = level.floats("VEC3", &[0., 0., 1., 0., 0., 1., 0., 0., 1.]);
    let color = level.accessor("VEC4", 5121, 3, &[255; 12]);
    let target = level.floats("VEC3", &[0.5; 9]);
    let instances = level.floats("VEC3", &[1., 2., 3., 4., 5., 6.]);
    let indices = level.indices(&[0, 1, 2, 1, 0]);
    let sparse_indices = level.view(&[1, 2]);
    let sparse_values = level.view(&[0; 24]);
    level.json["accessors"][target]["sparse"] = json!({
        "count": 2,
        "indices": { "bufferView": sparse_indices, "componentType": 5121 },
        "values": { "bufferView": sparse_values },
    });
    level.json["accessors"][color]["normalized"] = json!(true);
    let primitive = &mut level.json["meshes"][0]["primitives"][0];
    primitive["attributes"]["NORMAL"] = json!(normal);
    primitive["attributes"]["COLOR_0"] = json!(color);
    primitive["indices"] = json!(indices);
    primitive["mode"] = json!(5);
    primitive["targets"] = json!([{ "POSITION": target, "NORMAL": target }]);
    level.json["meshes"][0]["weights"] = json!([0.5]);
    level.json["extensions"] = json!({ "KHR_lights_punctual": { "lights": [{ "type": "spot", "range": 4 }] } });
    level.json["nodes"] = json!([
        { "children": [1, 2], "rotation": [0, 0, 0.6, 0.8], "extras": { "gdibl_role": "scene" } },
        { "mesh": 0, "scale": [1, -2, 3], "extensions": {
            "EXT_mesh_gpu_instancing": { "attributes": { "TRANSLATION": instances } },
        } },
        { "extensions": { "KHR_lights_punctual": { "light": 0 } }, "extras": { "gdibl_volume": 0.5 } },
        { "extras": { "gdibl_probe": "a.exr" }, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] },
    ]);
    level.json["scenes"] = json!([{ "nodes": [0, 3] }]);
    level
}

#[test]
fn damaged_levels_never_panic() {
    let whole = rich_level().to_glb();
    let path = Path::new("no such folder/level.glb");
    assert!(survives(&whole, path), "{:?}", parse_level(&whole, path, &GltfOptions::default()).err());
    let mut random = Random(1);
    let (mut accepted, count) = (0, 4000);
    for _ in 0..count {
        let mut bytes = whole.clone();
        mutate(&mut bytes, &mut random);
        accepted += usize::from(survives(&bytes, path));
    }
    // Both ways must have been walked, else the mutations are too weak or too strong to test anything.
    assert!(accepted > count / 50 && accepted < count * 49 / 50, "{accepted} of {count} accepted");
}
