//! Accessors and primitives.

use gdibl_baker::bake::Nodes;
use glam::{DVec3, Vec3};
use serde_json::json;

use crate::builder::{Level, finding, triangle_count};

#[test]
fn strided_and_offset_accessors_read_their_own_bytes() {
    let mut level = Level::triangle();
    // Per vertex: one stray float, position, one stray float.
    let corner = |x: f32, y: f32| [9.0, x, y, 0.0, 9.0];
    let values = [corner(0., 0.), corner(2., 0.), corner(0., 2.)].concat();
    let accessor = level.floats("SCALAR", &values);
    level.json["bufferViews"][1]["byteStride"] = json!(20);
    level.json["accessors"][accessor] =
        json!({ "bufferView": 1, "byteOffset": 4, "componentType": 5126, "count": 3, "type": "VEC3" });
    *level.primitive("attributes") = json!({ "POSITION": accessor });
    assert_eq!(level.read().unwrap().meshes[0].positions, [DVec3::ZERO, DVec3::X * 2.0, DVec3::Y * 2.0]);
}

#[test]
fn sparse_values_replace_elements_with_and_without_a_base() {
    let mut level = Level::triangle();
    let indices = level.view(&[1, 2]);
    let bytes: Vec<u8> = [5.0_f32, 0., 0., 0., 6., 0.].iter().flat_map(|v| v.to_le_bytes()).collect();
    let values = level.view(&bytes);
    level.json["accessors"][0]["sparse"] = json!({
        "count": 2,
        "indices": { "bufferView": indices, "componentType": 5121 },
        "values": { "bufferView": values },
    });
    let expected = [DVec3::ZERO, DVec3::X * 5.0, DVec3::Y * 6.0];
    assert_eq!(level.read().unwrap().meshes[0].positions, expected);
    level.json["accessors"][0].as_object_mut().unwrap().remove("bufferView");
    assert_eq!(level.read().unwrap().meshes[0].positions, expected);
}

#[test]
fn quantised_positions_and_normals_read_as_numbers() {
    let mut level = Level::triangle();
    let bytes = [0, 0, 0, 0, 127, 0, 0, 0, 0, 127, 0, 0_i8].map(|v| v as u8);
    let position = level.accessor("VEC3", 5120, 3, &bytes);
    level.json["accessors"][position]["normalized"] = json!(true);
    let view = level.json["accessors"][position]["bufferView"].as_u64().unwrap() as usize;
    level.json["bufferViews"][view]["byteStride"] = json!(4);
    // -32768 and -32767 are both -1.
    let shorts: Vec<u8> =
        [0, 0, -32768, 0, 0, -32767, 0, 0, -32768_i16].iter().flat_map(|v: &i16| v.to_le_bytes()).collect();
    let normal = level.accessor("VEC3", 5122, 3, &shorts);
    level.json["accessors"][normal]["normalized"] = json!(true);
    *level.primitive("attributes") = json!({ "POSITION": position, "NORMAL": normal });
    level.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    let mesh = &level.read().unwrap().meshes[0];
    assert_eq!(mesh.positions, [DVec3::ZERO, DVec3::X, DVec3::Y]);
    assert_eq!(mesh.normals, [Vec3::NEG_Z; 3]);

    // Not normalised: the integers themselves.
    let shorts: Vec<u8> = [0, 0, 0, 300, 0, 0, 0, 7, 0_u16].iter().flat_map(|v| v.to_le_bytes()).collect();
    let position = level.accessor("VEC3", 5123, 3, &shorts);
    *level.primitive("attributes") = json!({ "POSITION": position });
    assert_eq!(level.read().unwrap().meshes[0].positions, [DVec3::ZERO, DVec3::X * 300.0, DVec3::Y * 7.0]);
}

#[test]
fn indices_may_be_bytes_shorts_and_words() {
    for (component_type, bytes) in
        [(5121, vec![2, 0, 1]), (5123, vec![2, 0, 0, 0, 1, 0]), (5125, vec![2, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0])]
    {
        let mut level = Level::triangle();
        let indices = level.accessor("SCALAR", component_type, 3, &bytes);
        *level.primitive("indices") = json!(indices);
        assert_eq!(level.read().unwrap().meshes[0].triangles, [[2, 0, 1]], "{component_type}");
    }
}

/// A unit square as a strip or fan of 4, by `mode`, with or without indices.
#[test]
fn all_triangle_modes_make_the_same_square() {
    let corners = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.0_f32]];
    for (mode, order) in [(4, &[0, 1, 2, 0, 2, 3][..]), (5, &[1, 2, 0, 3]), (6, &[0, 1, 2, 3])] {
        for indexed in [false, true] {
            let mut level = Level::triangle();
            let values: Vec<[f32; 3]> =
                if indexed { corners.to_vec() } else { order.iter().map(|&i| corners[i as usize]).collect() };
            let position = level.floats("VEC3", values.as_flattened());
            *level.primitive("attributes") = json!({ "POSITION": position });
            *level.primitive("mode") = json!(mode);
            if indexed {
                let indices = level.indices(order);
                *level.primitive("indices") = json!(indices);
            }
            let mesh = level.read().unwrap().meshes.remove(0);
            assert_eq!(mesh.triangles.len(), 2, "mode {mode} indexed {indexed}");
            let mut area = DVec3::ZERO;
            for triangle in &mesh.triangles {
                let [a, b, c] = triangle.map(|i| mesh.positions[i as usize]);
                let cross = (b - a).cross(c - a);
                assert!(cross.z > 0.0, "mode {mode} indexed {indexed}: a triangle faces away");
                area += cross / 2.0;
            }
            assert_eq!(area, DVec3::Z);
        }
    }
}

#[test]
fn points_lines_and_shapeless_primitives_are_findings() {
    let mut level = Level::triangle();
    let triangle = level.json["meshes"][0]["primitives"][0].clone();
    let mut primitives = vec![triangle.clone()];
    for mode in 0..4 {
        let mut primitive = triangle.clone();
        primitive["mode"] = json!(mode);
        primitives.push(primitive);
    }
    primitives.push(json!({ "attributes": { "NORMAL": 0 } }));
    level.json["meshes"][0]["primitives"] = json!(primitives);
    let scene = level.read().unwrap();
    assert_eq!(triangle_count(&scene), 1);
    assert_eq!(finding(&scene, "point-and-line-primitives"), 4);
    assert_eq!(finding(&scene, "primitives-without-positions"), 1);
}

#[test]
fn non_finite_and_zero_area_triangles_are_dropped_and_counted() {
    let mut level = Level::triangle();
    let nan = f32::NAN;
    #[rustfmt::skip]
    let position = level.floats("VEC3", &[
        0., 0., 0.,  1., 0., 0.,  0., 1., 0.,       // good
        0., 0., 0.,  1., 0., 0.,  0., nan, 0.,
        0., 0., 0.,  f32::INFINITY, 0., 0.,  0., 1., 0.,
        0., 0., 0.,  1., 1., 1.,  3., 3., 3.,       // collinear
        0., 0., 0.,  1., 0., 0.,  0.5, 1e-30, 0.,   // a sliver stays
    ]);
    *level.primitive("attributes") = json!({ "POSITION": position });
    let scene = level.read().unwrap();
    assert_eq!(finding(&scene, "non-finite-triangles"), 2);
    assert_eq!(finding(&scene, "zero-area-triangles"), 1);
    assert_eq!(triangle_count(&scene), 2);
    assert!(scene.meshes[0].positions.iter().all(|p| p.is_finite()));
}

#[test]
fn vertices_that_nobody_uses_are_left_out() {
    let mut level = Level::triangle();
    let position = level.floats("VEC3", &[9., 9., 9., 0., 0., 0., f32::NAN, 0., 0., 1., 0., 0., 0., 1., 0.]);
    let indices = level.indices(&[1, 3, 4]);
    *level.primitive("attributes") = json!({ "POSITION": position });
    *level.primitive("indices") = json!(indices);
    let scene = level.read().unwrap();
    assert_eq!(scene.meshes[0].positions, [DVec3::ZERO, DVec3::X, DVec3::Y]);
    assert!(scene.findings.is_empty());
    // Their numbers are kept.
    assert_eq!((scene.meshes[0].file_count, &scene.meshes[0].file_numbers[..]), (5, &[1, 3, 4][..]));
}

/// Positions and sets of the vertices of a level.
fn vertices_of(level: &Level) -> (Vec<DVec3>, Vec<[u32; 5]>) {
    let Nodes::Vertices { positions, normals, inward, sets } = Nodes::vertices_of(&level.read().unwrap()) else {
        panic!("vertices")
    };
    assert_eq!([normals.len(), inward.len()], [positions.len(); 2]);
    let sets = sets.iter().map(|set| [set.node, set.mesh, set.primitive, set.first, set.count]);
    (positions, sets.collect())
}

#[test]
fn vertices_keep_the_files_order_and_count() {
    let mut level = Level::triangle();
    let position =
        level.floats("VEC3", &[9., 9., 9., 0., 1., 0., f32::NAN, 0., 0., 1., 0., 0., 0., 0., 0., 7., 7., 7.]);
    let indices = level.indices(&[4, 3, 1]);
    *level.primitive("attributes") = json!({ "POSITION": position });
    *level.primitive("indices") = json!(indices);
    let (positions, sets) = vertices_of(&level);
    assert_eq!(sets, [[0, 0, 0, 0, 6]]);
    // Those without a triangle stand where another does.
    assert_eq!(positions, [DVec3::Y, DVec3::Y, DVec3::Y, DVec3::X, DVec3::ZERO, DVec3::ZERO]);
}

#[test]
fn primitives_that_share_vertices_share_nodes_and_instances_follow_one_another() {
    let mut level = Level::triangle();
    let position = level.floats("VEC3", &[0., 0., 0., 1., 0., 0., 0., 1., 0., 5., 5., 5., 1., 1., 0.]);
    let (first, second) = (level.indices(&[0, 1, 2]), level.indices(&[1, 4, 2]));
    let own = level.floats("VEC3", &[0., 0., 1., 1., 0., 1., 0., 1., 1.]);
    level.json["meshes"][0]["primitives"] = json!([
        { "attributes": { "POSITION": position }, "indices": first },
        { "attributes": { "POSITION": own } },
        { "attributes": { "POSITION": position }, "indices": second },
    ]);
    let (positions, sets) = vertices_of(&level);
    assert_eq!(sets, [[0, 0, 0, 0, 5], [0, 0, 1, 5, 3], [0, 0, 2, 0, 5]]);
    let corner = DVec3::new(1.0, 1.0, 0.0);
    assert_eq!(positions[..5], [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Y, corner]);
    // Three instances.
    let moves = level.floats("VEC3", &[0., 0., 0., 0., 0., 2., 0., 0., 4.]);
    level.json["nodes"][0]["extensions"] =
        json!({ "EXT_mesh_gpu_instancing": { "attributes": { "TRANSLATION": moves } } });
    let (positions, sets) = vertices_of(&level);
    assert_eq!(sets, [[0, 0, 0, 0, 15], [0, 0, 1, 15, 9], [0, 0, 2, 0, 15]]);
    for instance in 0..3 {
        let place = DVec3::Z * 2.0 * instance as f64;
        assert_eq!([positions[5 * instance + 4], positions[15 + 3 * instance]], [corner + place, DVec3::Z + place]);
    }
    // Two nodes of one mesh have vertices of their own.
    level.json["nodes"] = json!([{ "mesh": 0 }, { "mesh": 0 }]);
    level.json["scenes"] = json!([{ "nodes": [0, 1] }]);
    assert_eq!(vertices_of(&level).1[3..], [[1, 0, 0, 8, 5], [1, 0, 1, 13, 3], [1, 0, 2, 8, 5]]);
}

#[test]
fn left_over_corners_are_a_finding() {
    let mut level = Level::triangle();
    let indices = level.indices(&[0, 1, 2, 0]);
    *level.primitive("indices") = json!(indices);
    let scene = level.read().unwrap();
    assert_eq!((triangle_count(&scene), finding(&scene, "incomplete-primitives")), (1, 1));
}

#[test]
fn morph_targets_apply_with_their_weights() {
    let mut level = Level::triangle();
    let target = level.floats("VEC3", &[0., 0., 2., 0., 0., 2., 0., 0., 2.]);
    *level.primitive("targets") = json!([{ "POSITION": target }]);
    assert!(level.read().unwrap().findings.is_empty());
    level.json["meshes"][0]["weights"] = json!([0.5]);
    let scene = level.read().unwrap();
    assert_eq!(scene.meshes[0].positions[0], DVec3::Z);
    assert_eq!(finding(&scene, "morphed-meshes"), 1);
    level.json["nodes"][0]["weights"] = json!([2.0]);
    assert_eq!(level.read().unwrap().meshes[0].positions[0], DVec3::Z * 4.0);
    level.json["nodes"][0]["weights"] = json!([0.0]);
    assert_eq!(level.read().unwrap().meshes[0].positions[0], DVec3::ZERO);
}
