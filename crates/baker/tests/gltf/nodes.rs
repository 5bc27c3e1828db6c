//! What nodes say: places, scenes, roles, instances, markers, lights.

use gdibl_baker::import::gltf::GltfOptions;
use gdibl_baker::scene::{PunctualKind, Role};
use glam::{DVec3, Vec3};
use serde_json::json;

use crate::builder::{Level, finding, triangle_count};

#[test]
fn transforms_compose_in_f64() {
    let mut level = Level::triangle();
    let half = std::f64::consts::FRAC_1_SQRT_2;
    level.json["nodes"] = json!([
        { "mesh": 0, "translation": [1, 0, 0], "scale": [2, 2, 2] },
        { "children": [0], "rotation": [0, half, 0, half], "translation": [1000000.125, 0, 0] },
        { "children": [1], "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 5, 0, 1] },
    ]);
    level.json["scenes"] = json!([{ "nodes": [2] }]);
    let mesh = level.read().unwrap().meshes.remove(0);
    // Turned by 90 degrees about Y, +X becomes -Z. An f32 would have lost the .125.
    let expected = [DVec3::new(0., 5., -1.), DVec3::new(0., 5., -3.), DVec3::new(0., 7., -1.)];
    for (found, expected) in mesh.positions.iter().zip(expected) {
        let expected = expected + DVec3::X * 1_000_000.125;
        assert!((*found - expected).length() < 1e-9, "{found} {expected}");
    }
    assert!((mesh.normals[0] - Vec3::X).length() < 1e-6);
}

#[test]
fn mirrored_nodes_turn_their_triangles_round() {
    let mut level = Level::triangle();
    level.json["nodes"][0]["scale"] = json!([-1, 1, 1]);
    let mesh = level.read().unwrap().meshes.remove(0);
    assert_eq!(mesh.triangles, [[0, 2, 1]]);
    assert_eq!(mesh.normals, [Vec3::Z; 3]);
}

#[test]
fn the_chosen_scene_is_read() {
    let mut level = Level::triangle();
    level.json["nodes"] = json!([{ "mesh": 0 }, { "mesh": 0, "translation": [0, 0, 1] }, { "mesh": 0 }]);
    level.json["scenes"] = json!([{ "nodes": [0, 2] }, { "nodes": [1] }, {}]);
    let count =
        |level: &Level, scene| level.read_with(&GltfOptions { scene, ..Default::default() }).unwrap().meshes.len();
    assert_eq!(count(&level, None), 2);
    assert_eq!(count(&level, Some(1)), 1);
    // A scene without `nodes` is legal, and empty.
    assert_eq!(count(&level, Some(2)), 0);
    level.json["scene"] = json!(1);
    let scene = level.read().unwrap();
    assert_eq!((scene.meshes.len(), scene.meshes[0].node), (1, 1));
    // Without scenes: all roots.
    let object = level.json.as_object_mut().unwrap();
    object.remove("scene");
    object.remove("scenes");
    level.json["nodes"][0]["children"] = json!([1]);
    let scene = level.read().unwrap();
    assert_eq!(scene.meshes.iter().map(|mesh| mesh.node).collect::<Vec<_>>(), [0, 1, 2]);
}

#[test]
fn a_chain_of_many_nodes_does_not_exhaust_the_stack() {
    let mut level = Level::triangle();
    let count = 100_000;
    let mut nodes: Vec<_> = (1..count).map(|i| json!({ "children": [i] })).collect();
    nodes.push(json!({ "mesh": 0 }));
    level.json["nodes"] = json!(nodes);
    assert_eq!(triangle_count(&level.read().unwrap()), 1);
}

#[test]
fn roles_are_inherited_and_overridden() {
    let mut level = Level::triangle();
    level.json["nodes"] = json!([
        { "mesh": 0, "children": [1, 2, 3] },
        { "mesh": 0, "extras": { "gdibl_role": "scene" }, "children": [4] },
        { "mesh": 0, "extras": { "gdibl_role": "ignore" }, "children": [5, 6] },
        { "mesh": 0, "extras": { "other": 1 } },
        { "mesh": 0 },
        { "mesh": 0 },
        { "mesh": 0, "extras": { "gdibl_role": "environment" } },
    ]);
    let scene = level.read().unwrap();
    let roles: Vec<_> = scene.meshes.iter().map(|mesh| (mesh.node, mesh.role)).collect();
    let (environment, scene) = (Role::Environment, Role::Scene);
    assert_eq!(roles, [(0, environment), (1, scene), (4, scene), (6, environment), (3, environment)]);
}

#[test]
fn instances_are_placed_under_their_node() {
    let mut level = Level::triangle();
    let translation = level.floats("VEC3", &[1., 0., 0., 2., 0., 0.]);
    let scale = level.floats("VEC3", &[1., 1., 1., 1., 1., -1.]);
    let rotation = level.accessor("VEC4", 5120, 2, &[0, 0, 0, 127, 0, 0, 0, 127]);
    level.json["accessors"][rotation]["normalized"] = json!(true);
    level.json["nodes"][0]["translation"] = json!([0, 10, 0]);
    level.json["nodes"][0]["extensions"] = json!({ "EXT_mesh_gpu_instancing": { "attributes": {
        "TRANSLATION": translation, "ROTATION": rotation, "SCALE": scale,
    } } });
    let scene = level.read().unwrap();
    assert_eq!(scene.meshes.len(), 2);
    assert_eq!(scene.meshes[0].positions[0], DVec3::new(1., 10., 0.));
    assert_eq!(scene.meshes[1].positions[0], DVec3::new(2., 10., 0.));
    assert_eq!((scene.meshes[0].triangles[0], scene.meshes[1].triangles[0]), ([0, 1, 2], [0, 2, 1]));
    assert_eq!(scene.meshes[1].normals[0], Vec3::NEG_Z);
}

#[test]
fn hidden_nodes_and_skins_are_findings() {
    let mut level = Level::triangle();
    level.json["nodes"] = json!([
        { "mesh": 0, "skin": 0 },
        { "mesh": 0, "extensions": { "KHR_node_visibility": { "visible": false } }, "children": [2] },
        { "mesh": 0 },
    ]);
    level.json["scenes"] = json!([{ "nodes": [0, 1] }]);
    let scene = level.read().unwrap();
    assert_eq!(triangle_count(&scene), 1);
    assert_eq!((finding(&scene, "hidden-nodes"), finding(&scene, "skinned-meshes")), (1, 1));
}

#[test]
fn probe_and_volume_markers_are_placed() {
    let mut level = Level::new();
    let half = std::f64::consts::FRAC_1_SQRT_2;
    level.json["nodes"] = json!([
        { "children": [1, 2], "translation": [1, 2, 3] },
        { "name": "p", "rotation": [0, half, 0, half], "scale": [2, 3, -4], "extras": { "gdibl_probe": "hdr/p.exr" } },
        { "name": "v", "scale": [2, 3, 4], "extras": { "gdibl_volume": 0.5, "gdibl_role": "ignore" } },
    ]);
    let scene = level.read().unwrap();
    let probe = &scene.probe_markers[0];
    assert_eq!((probe.name.as_str(), probe.position), ("p", DVec3::new(1., 2., 3.)));
    assert_eq!(probe.image, std::path::Path::new("no such folder/hdr/p.exr"));
    assert!((probe.rotation * DVec3::X - DVec3::NEG_Z).length() < 1e-12, "{}", probe.rotation);
    let volume = &scene.volume_markers[0];
    assert_eq!((volume.spacing, volume.center), (0.5, DVec3::new(1., 2., 3.)));
    assert_eq!(volume.half_axes, glam::DMat3::from_diagonal(DVec3::new(2., 3., 4.)));
}

#[test]
fn lights_are_placed_with_range_and_cone() {
    let mut level = Level::new();
    let half = std::f64::consts::FRAC_1_SQRT_2;
    // Blender writes extras into lights.
    level.json["extensions"] = json!({ "KHR_lights_punctual": { "lights": [
        { "type": "point", "color": [1, 0.5, 0], "intensity": 10, "range": 7, "name": "lamp", "extras": { "a": [1] } },
        { "type": "spot", "spot": { "innerConeAngle": 0.1, "outerConeAngle": 0.2 } },
        { "type": "directional", "intensity": 3, "range": 0 },
        { "type": "ambient" },
        { "type": "spot" },
    ] } });
    let light = |i: usize| json!({ "KHR_lights_punctual": { "light": i } });
    level.json["nodes"] = json!([
        { "extensions": light(0), "translation": [1, 2, 3] },
        { "extensions": light(1), "rotation": [0, half, 0, half], "scale": [5, 5, 5], "name": "node" },
        { "extensions": light(2) },
        { "extensions": light(3) },
        { "extensions": light(0), "extras": { "gdibl_role": "ignore" } },
        { "extensions": light(4) },
    ]);
    let scene = level.read().unwrap();
    let [point, spot, sun, default_spot] = &scene.lights[..] else { panic!("{:?}", scene.lights) };
    assert_eq!((point.name.as_str(), point.range, point.position), ("lamp", 7.0, DVec3::new(1., 2., 3.)));
    assert_eq!((point.kind, point.intensity), (PunctualKind::Point, Vec3::new(10., 5., 0.)));
    assert_eq!((spot.name.as_str(), spot.range, spot.intensity), ("node", f32::INFINITY, Vec3::ONE));
    assert_eq!(spot.kind, PunctualKind::Spot { inner_cone_radians: 0.1, outer_cone_radians: 0.2 });
    assert!((spot.direction - Vec3::NEG_X).length() < 1e-6, "{}", spot.direction);
    assert_eq!((sun.kind, sun.direction, sun.range), (PunctualKind::Directional, Vec3::NEG_Z, f32::INFINITY));
    let quarter = std::f32::consts::FRAC_PI_4;
    assert_eq!(default_spot.kind, PunctualKind::Spot { inner_cone_radians: 0.0, outer_cone_radians: quarter });
    assert_eq!((finding(&scene, "unknown-lights"), finding(&scene, "light-ranges")), (1, 1));
}
