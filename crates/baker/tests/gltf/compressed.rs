//! Compressed buffer views (EXT_meshopt_compression), with and without the decoder.

use serde_json::json;

use crate::builder::{Level, data_uri};

/// The triangle, its positions compressed as `mode`/`filter` from `encoded`.
fn level(encoded: &[u8], stride: usize, filter: &str) -> Level {
    let mut level = Level::triangle();
    let offset = level.bytes.len();
    level.bytes.extend_from_slice(encoded);
    // The view's own buffer is the fallback, which has no bytes.
    level.json["bufferViews"][0] = json!({
        "buffer": 1, "byteLength": 3 * stride, "byteStride": stride,
        "extensions": { "EXT_meshopt_compression": {
            "buffer": 0, "byteOffset": offset, "byteLength": encoded.len(), "byteStride": stride, "count": 3,
            "mode": "ATTRIBUTES", "filter": filter,
        } },
    });
    let uri = data_uri("application/octet-stream", &level.bytes);
    level.json["buffers"] = json!([
        { "byteLength": level.bytes.len(), "uri": uri },
        { "byteLength": 3 * stride, "extensions": { "EXT_meshopt_compression": { "fallback": true } } },
    ]);
    level.json["extensionsRequired"] = json!(["EXT_meshopt_compression"]);
    level
}

#[cfg(not(feature = "meshopt"))]
#[test]
fn without_the_feature_it_is_unsupported_unless_there_is_a_fallback() {
    use crate::builder::{assert_unsupported, triangle_count};
    let mut level = level(&[0xa0; 60], 12, "NONE");
    assert_unsupported(level.read(), &["EXT_meshopt_compression", "gltf-transform"]);
    let plain: Vec<u8> = [0., 0., 0., 1., 0., 0., 0., 1., 0.0_f32].iter().flat_map(|v| v.to_le_bytes()).collect();
    level.json["buffers"][1] = json!({ "byteLength": 36, "uri": data_uri("", &plain) });
    assert_eq!(triangle_count(&level.read().unwrap()), 1);
}

#[cfg(feature = "meshopt")]
mod decoded {
    use super::*;
    use crate::builder::{assert_invalid, push};
    use glam::{DVec3, Vec3};

    #[test]
    fn attributes_of_every_stride_decode() {
        let mut positions = [[0.0_f32; 16]; 3];
        (positions[1][0], positions[2][1]) = (1.0, 1.0);
        let encoded = meshopt::encode_vertex_buffer(&positions).unwrap();
        let scene = level(&encoded, 64, "NONE").read().unwrap();
        assert_eq!(scene.meshes[0].positions, [DVec3::ZERO, DVec3::X, DVec3::Y]);

        let positions = positions.map(|p| [p[0], p[1], p[2]]);
        let encoded = meshopt::encode_vertex_buffer(&positions).unwrap();
        let scene = level(&encoded, 12, "NONE").read().unwrap();
        assert_eq!(scene.meshes[0].positions, [DVec3::ZERO, DVec3::X, DVec3::Y]);
    }

    #[test]
    fn exponential_attributes_decode() {
        let positions = [[0.0_f32, 0., 0.], [1., 0., 0.], [0., -23.5, 0.]];
        let filtered = meshopt::encode_filter_exp(&positions, 15, meshopt::EncodeExpMode::Separate);
        let encoded = meshopt::encode_vertex_buffer(&filtered).unwrap();
        let found = level(&encoded, 12, "EXPONENTIAL").read().unwrap().meshes.remove(0).positions;
        assert!((found[2] - DVec3::new(0., -23.5, 0.)).length() < 1e-3, "{found:?}");
        assert!((found[1] - DVec3::X).length() < 1e-3, "{found:?}");
    }

    #[test]
    fn octahedral_normals_decode() {
        let normals = [[0.6_f32, 0., 0.8, 0.], [0., -1., 0., 0.], [-0.6, 0.48, -0.64, 0.]];
        for (bits, component_type, tolerance) in [(8, 5120, 0.02), (16, 5122, 1e-3)] {
            let (encoded, stride) = if bits == 8 {
                let filtered: Vec<[i8; 4]> = meshopt::encode_filter_oct(&normals, 8);
                (meshopt::encode_vertex_buffer(&filtered).unwrap(), 4)
            } else {
                let filtered: Vec<[i16; 4]> = meshopt::encode_filter_oct(&normals, 16);
                (meshopt::encode_vertex_buffer(&filtered).unwrap(), 8)
            };
            let mut level = level(&encoded, stride, "OCTAHEDRAL");
            let position = {
                let values = [0., 0., 0., 1., 0., 0., 0., 1., 0.0_f32];
                let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
                push(&mut level.json, "buffers", json!({ "byteLength": 36, "uri": data_uri("", &bytes) }));
                let view = push(&mut level.json, "bufferViews", json!({ "buffer": 2, "byteLength": 36 }));
                let accessor = json!({ "bufferView": view, "componentType": 5126, "count": 3, "type": "VEC3" });
                push(&mut level.json, "accessors", accessor)
            };
            let normal = json!({
                "bufferView": 0, "componentType": component_type, "normalized": true, "count": 3, "type": "VEC3",
            });
            level.json["accessors"][0] = normal;
            *level.primitive("attributes") = json!({ "POSITION": position, "NORMAL": 0 });
            let found = level.read().unwrap().meshes.remove(0).normals;
            for (found, expected) in found.iter().zip(normals) {
                assert!((*found - Vec3::from_slice(&expected)).length() < tolerance, "{found} {expected:?}");
            }
        }
    }

    #[test]
    fn damaged_streams_and_sizes_are_refused() {
        let encoded = meshopt::encode_vertex_buffer(&[[0.0_f32; 3]; 3]).unwrap();
        let good = level(&encoded, 12, "NONE");
        assert!(good.read().is_ok());
        let with = |field: &str, value: serde_json::Value| {
            let mut level = level(&encoded, 12, "NONE");
            level.json["bufferViews"][0]["extensions"]["EXT_meshopt_compression"][field] = value;
            level.read()
        };
        assert_invalid(with("byteLength", json!(encoded.len() - 1)), &["bufferView 0", "meshopt", "damaged"]);
        assert_invalid(with("byteOffset", json!(1_u64 << 40)), &["bufferView 0", "truncated"]);
        assert_invalid(with("byteStride", json!(10)), &["byteStride 10"]);
        assert_invalid(with("byteStride", json!(260)), &["byteStride 260"]);
        assert_invalid(with("count", json!(1_u64 << 62)), &["do not fit"]);
        assert_invalid(with("mode", json!("TRIANGLES")), &["byteStride 12"]);
        assert_invalid(with("mode", json!("SPHERES")), &["SPHERES"]);
        assert_invalid(with("filter", json!("QUATERNION")), &["byteStride 12"]);
        assert_invalid(with("buffer", json!(7)), &["buffer 7"]);
    }
}
