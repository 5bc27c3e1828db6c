//! What nodes say: places, scenes, roles, instances, markers, lights.

use gdibl_baker::import::gltf::GltfOptions;
use gdibl_baker::scene::{PunctualKind, Role};
use glam::{DVec3, Vec3};
use serde_json::{Value, json};

use crate::builder::{Level, assert_invalid, finding, push, triangle_count};

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
    level.json["skins"] = json!([{ "joints": [2] }]);
    let scene = level.read().unwrap();
    assert_eq!(triangle_count(&scene), 1);
    assert_eq!((finding(&scene, "hidden-nodes"), finding(&scene, "skinned-meshes")), (1, 1));
    assert_eq!(finding(&scene, "skins-without-joints"), 1, "its vertices name none");
    level.json["skins"] = json!([]);
    assert_invalid(level.read(), &["node 0", "skin 0 does not exist"]);
}

#[test]
fn probe_and_volume_markers_are_placed() {
    let mut level = Level::new();
    let half = std::f64::consts::FRAC_1_SQRT_2;
    level.json["nodes"] = json!([
        { "children": [1, 2], "translation": [1, 2, 3] },
        { "name": "p", "rotation": [0, half, 0, half], "scale": [2, 3, -4], "extras": { "gdibl_probe": "hdr/p.exr" } },
        { "name": "v", "scale": [2, 3, 4], "extras": { "gdibl_volume": 0.5, "gdibl_role": "ignore", "gdibl_sh": "L1",
            "gdibl_samples": 64.0, "gdibl_counts": [3, 4, 5], "gdibl_zstd": true, "gdibl_tolerance": 0.05, "other": 1 } },
    ]);
    let scene = level.read().unwrap();
    let probe = &scene.probe_markers[0];
    assert_eq!((probe.name.as_str(), probe.position), ("p", DVec3::new(1., 2., 3.)));
    assert_eq!(probe.image, std::path::Path::new("no such folder/hdr/p.exr"));
    assert!((probe.rotation * DVec3::X - DVec3::NEG_Z).length() < 1e-12, "{}", probe.rotation);
    let volume = &scene.volume_markers[0];
    assert_eq!((volume.spacing, volume.center), (0.5, DVec3::new(1., 2., 3.)));
    assert_eq!(volume.half_axes, glam::DMat3::from_diagonal(DVec3::new(2., 3., 4.)));
    assert_eq!((volume.name.as_str(), volume.node.as_str()), ("v", "node 2 (v)"));
    let settings: Vec<_> = volume.settings.iter().map(|(name, text)| (name.as_str(), text.as_str())).collect();
    let expected = [("counts", "3,4,5"), ("samples", "64"), ("sh", "L1"), ("tolerance", "0.05"), ("zstd", "true")];
    assert_eq!(settings, expected);
    assert_eq!(finding(&scene, "unknown-properties"), 0, "{:?}", scene.findings);
}

#[test]
fn a_volume_that_is_not_upright_is_found_and_its_box_lies_around_it() {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let eighth = std::f64::consts::FRAC_PI_8;
    let rotated = |rotation: [f64; 4]| {
        let mut level = Level::new();
        let volume = json!({ "gdibl_volume": 0.5 });
        level.json["nodes"] = json!([{ "rotation": rotation, "scale": [2, 3, 4], "extras": volume }]);
        let scene = level.read().unwrap();
        (scene.volume_markers[0].bounds().1, finding(&scene, "rotated-volume"))
    };
    // A quarter turn about Y swaps X and Z.
    let (corner, found) = rotated([0.0, half, 0.0, half]);
    assert!((corner - DVec3::new(4., 3., 2.)).length() < 1e-12, "{corner}");
    assert_eq!(found, 0);
    let (corner, found) = rotated([0.0, eighth.sin(), 0.0, eighth.cos()]);
    assert!((corner - DVec3::new(6. * half, 3., 6. * half)).length() < 1e-12, "{corner}");
    assert_eq!(found, 1);
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

#[test]
fn roles_of_meshes_and_materials_count() {
    let read = |node: Value, mesh: Value, material: Value| {
        let mut level = Level::triangle();
        level.json["nodes"] = json!([{ "extras": node, "children": [1] }, { "mesh": 0 }]);
        level.json["meshes"][0]["extras"] = mesh;
        level.json["materials"] = json!([{ "extras": material }]);
        *level.primitive("material") = json!(0);
        level.read().unwrap().meshes.first().map(|mesh| mesh.role)
    };
    let role = |role: &str| json!({ "gdibl_role": role });
    let nothing = || json!({});
    assert_eq!(read(nothing(), role("scene"), nothing()), Some(Role::Scene));
    assert_eq!(read(nothing(), nothing(), role("scene")), Some(Role::Scene));
    assert_eq!(read(nothing(), role("ignore"), nothing()), None);
    assert_eq!(read(nothing(), nothing(), role("ignore")), None);
    // What is inherited counts least, what the material says most; an ignored node stays ignored.
    assert_eq!(read(role("scene"), role("environment"), nothing()), Some(Role::Environment));
    assert_eq!(read(nothing(), role("environment"), role("scene")), Some(Role::Scene));
    assert_eq!(read(role("ignore"), role("scene"), role("scene")), None);
    let mut level = Level::triangle();
    level.json["nodes"] = json!([{ "mesh": 0, "extras": role("environment") }]);
    level.json["meshes"][0]["extras"] = role("scene");
    assert_eq!(level.read().unwrap().meshes[0].role, Role::Environment, "the node's own counts before the mesh's");
    level.json["meshes"][0]["extras"] = json!({ "gdibl_role": "prop" });
    level.json["nodes"] = json!([{ "mesh": 0 }]);
    assert_invalid(level.read(), &["mesh 0", "gdibl_role", "prop", "environment"]);
}

#[test]
fn properties_that_are_not_understood_are_findings() {
    let mut level = Level::triangle();
    level.json["nodes"][0]["extras"] =
        json!({ "gdibl_rol": "scene", "GDIBL_role": 1, "gdibl_role": "scene", "other": 1 });
    level.json["meshes"][0]["extras"] = json!({ "gdibl_probe": "a.exr" });
    level.json["scenes"][0]["extras"] = json!({ "gdibl_role": "scene" });
    level.json["extensions"] =
        json!({ "KHR_lights_punctual": { "lights": [{ "type": "point", "extras": { "gdibl_x": 1 } }] } });
    let scene = level.read().unwrap();
    assert_eq!(finding(&scene, "unknown-properties"), 5);
    let message = &scene.findings.iter().find(|finding| finding.id == "unknown-properties").unwrap().message;
    for place in ["nodes[0].extras.gdibl_rol ", "nodes[0].extras.GDIBL_role", "meshes[0].extras.gdibl_probe"] {
        assert!(message.contains(place), "{message}");
    }
    assert!(
        message.contains("scenes[0].extras.gdibl_role") && message.contains("lights[0].extras.gdibl_x"),
        "{message}"
    );
    assert!(finding(&Level::triangle().read().unwrap(), "unknown-properties") == 0);
}

#[test]
fn lower_levels_of_detail_are_left_out() {
    let mut level = Level::triangle();
    level.json["nodes"] = json!([
        { "mesh": 0, "extensions": { "MSFT_lod": { "ids": [1, 2] } } },
        { "mesh": 0, "children": [3] },
        { "mesh": 0, "extensions": { "MSFT_lod": { "ids": [0, 2] } } },
        { "mesh": 0 },
    ]);
    level.json["extensionsRequired"] = json!(["MSFT_lod"]);
    // Beside it in the scene, as some exporters have them, or only named.
    for (roots, left_out) in [(json!([0, 1, 2]), 2), (json!([0]), 0)] {
        level.json["scenes"] = json!([{ "nodes": roots }]);
        let scene = level.read().unwrap();
        assert_eq!((scene.meshes.len(), scene.meshes[0].node), (1, 0));
        assert_eq!(finding(&scene, "lower-levels-of-detail"), left_out);
    }
}

#[test]
fn lamps_in_lumens_beside_emitters_in_watts_are_told() {
    // A lamp of P watts has P / 4π candela at one lumen per watt; a square metre that emits π W at a radiance of 1.
    let watts = 10.0;
    let level = |lumens: f64, emission: f64| {
        let mut level = Level::triangle();
        level.json["materials"] = json!([{ "emissiveFactor": [emission, emission, emission] }]);
        *level.primitive("material") = json!(0);
        let intensity = watts * lumens / (4.0 * std::f64::consts::PI);
        level.json["extensions"] =
            json!({ "KHR_lights_punctual": { "lights": [{ "type": "point", "intensity": intensity }] } });
        push(&mut level.json, "nodes", json!({ "extensions": { "KHR_lights_punctual": { "light": 0 } } }));
        level.json["scenes"] = json!([{ "nodes": [0, 1] }]);
        level
    };
    let told =
        |level: &Level, options: &GltfOptions| finding(&level.read_with(options).unwrap(), "lamps-outshine-emitters");
    let plain = GltfOptions::default();
    assert_eq!(told(&level(683.0, 1.0), &plain), 1);
    assert_eq!(told(&level(1.0, 1.0), &plain), 0);
    assert_eq!(told(&level(683.0, 0.0), &plain), 0, "nothing to compare with");
    let divided = GltfOptions { lumens_per_watt: Some(683.0), ..GltfOptions::default() };
    assert_eq!(told(&level(683.0, 1.0), &divided), 0);
    let [blender, unitless] = [(683.0, &divided), (1.0, &plain)]
        .map(|(lumens, options)| level(lumens, 1.0).read_with(options).unwrap().lights[0].intensity);
    assert!((blender - unitless).abs().max_element() < 1e-6, "{blender} {unitless}");
}
