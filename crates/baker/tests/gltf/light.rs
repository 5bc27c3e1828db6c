//! Levels as exporters write them give the right light: closed boxes whose irradiance is known.
//!
//! A closed box of albedo a and emission e has E = π e / (1 - a) everywhere; a clear black box under a sky of 1 has E = π × what
//! passes. The values are computed here from the specifications' formulas.

use gdibl_baker::Control;
use gdibl_baker::bake::{BakeSettings, GatherSettings, Nodes, Shells, SurfacePlace, bake, check_finite, irradiance_at};
use gdibl_baker::capture::{CaptureSettings, capture};
use gdibl_baker::import::gltf::{GltfOptions, TextureNeeds};
use gdibl_baker::panorama::Panorama;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings, Probe};
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::radiance::{Distant, RadianceFunction};
use gdibl_baker::scene::{Metals, Scene, rough_metal_share};
use glam::{DQuat, DVec3, Quat, Vec3};
use serde_json::{Value, json};
use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

use crate::builder::{Level, assert_invalid, data_uri, finding, png, push};

const PLACE: DVec3 = DVec3::new(0.1, 0.2, -0.3);

/// A box of 2 m around the origin, its fronts inward: 24 vertices, texture coordinates 0..1 on each side.
struct Room {
    positions: Vec<f32>,
    uvs: Vec<f32>,
    indices: Vec<u16>,
}

impl Room {
    fn new() -> Room {
        let (mut positions, mut uvs, mut indices) = (Vec::new(), Vec::new(), Vec::new());
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                let first = (positions.len() / 3) as u16;
                for (u, v) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                    let mut corner = [0.0; 3];
                    (corner[axis], corner[(axis + 1) % 3], corner[(axis + 2) % 3]) = (side, u, v);
                    positions.extend(corner);
                    uvs.extend([(u + 1.0) / 2.0, (v + 1.0) / 2.0]);
                }
                let quad = if side < 0.0 { [0, 1, 2, 0, 2, 3] } else { [0, 2, 1, 0, 3, 2] };
                indices.extend(quad.map(|corner| first + corner));
            }
        }
        Room { positions, uvs, indices }
    }

    /// The same corners, each triangle the other way round.
    fn inside_out(mut self) -> Room {
        self.indices.as_chunks_mut::<3>().0.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        self
    }

    /// Sides cut along their other diagonals.
    fn other_diagonals(mut self) -> Room {
        for quad in self.indices.as_chunks_mut::<6>().0 {
            let first = quad[0];
            let other = if quad[1] == first + 1 { [1, 2, 3, 1, 3, 0] } else { [3, 2, 1, 3, 1, 0] };
            *quad = other.map(|corner| first + corner);
        }
        self
    }

    /// Adds it as a primitive of a material to mesh 0; returns the primitive's attributes.
    fn add<'a>(&self, level: &'a mut Level, material: Value) -> &'a mut Value {
        let position = level.floats("VEC3", &self.positions);
        let uv = level.floats("VEC2", &self.uvs);
        let indices = level.indices(&self.indices);
        let material = push(&mut level.json, "materials", material);
        if level.json.get("meshes").is_none() {
            level.json["meshes"] = json!([{ "primitives": [] }]);
            level.json["nodes"] = json!([{ "mesh": 0 }]);
            level.json["scenes"] = json!([{ "nodes": [0] }]);
        }
        let primitives = level.json["meshes"][0]["primitives"].as_array_mut().unwrap();
        primitives.push(json!({
            "attributes": { "POSITION": position, "TEXCOORD_0": uv }, "indices": indices, "material": material,
        }));
        &mut primitives.last_mut().unwrap()["attributes"]
    }
}

fn room(material: Value) -> Level {
    let mut level = Level::new();
    Room::new().add(&mut level, material);
    level
}

/// With pictures as textures 0, 1, ...; all looked up by sampler 0.
fn with_textures(mut level: Level, pictures: &[Vec<u8>]) -> Level {
    level.json["samplers"] = json!([{ "magFilter": 9728, "minFilter": 9728 }]);
    for (index, picture) in pictures.iter().enumerate() {
        push(&mut level.json, "images", json!({ "uri": data_uri("image/png", picture) }));
        push(&mut level.json, "textures", json!({ "source": index, "sampler": 0 }));
    }
    level
}

/// Not metal, of this base colour, glowing.
fn glowing(base: [f64; 4], emission: f64) -> Value {
    json!({
        "pbrMetallicRoughness": { "baseColorFactor": base, "metallicFactor": 0 }, "emissiveFactor": [emission, emission, emission],
    })
}

fn grey(albedo: f64, emission: f64) -> Value {
    glowing([albedo, albedo, albedo, 1.0], emission)
}

fn control<T>(work: impl FnOnce(&Control) -> T) -> T {
    work(&Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None })
}

fn irradiance_by(function: &impl RadianceFunction) -> [f64; 3] {
    let settings = GatherSettings { samples: 1 << 14, ..GatherSettings::default() };
    let place = SurfacePlace { position: PLACE, normal: Vec3::Y };
    let found = control(|control| irradiance_at(&[place], function, &settings, control)).expect("nobody interrupts");
    found[0].irradiance.to_array().map(f64::from)
}

/// E in the room, by paths; under a sky of 1 or of nothing.
fn irradiance_of(scene: &Scene, sky: bool) -> [f64; 3] {
    let sky = sky.then(self::sky);
    irradiance_by(&Path::new(scene, sky.as_ref(), PathSettings::default()))
}

fn irradiance(level: &Level, sky: bool) -> [f64; 3] {
    irradiance_of(&level.read_all().unwrap(), sky)
}

/// Within 2 % of the largest channel, or of 0.02.
#[track_caller]
fn assert_light(what: &str, found: [f64; 3], expected: [f64; 3]) {
    let largest = expected.iter().fold(1.0f64, |m, e| m.max(*e));
    let is_right = found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 0.02 * largest);
    assert!(is_right, "{what}: E is {found:?}, expected {expected:?}");
}

fn furnace(albedo: f64, emission: f64) -> [f64; 3] {
    [PI * emission / (1.0 - albedo); 3]
}

#[test]
fn of_faces_back_to_back_the_one_whose_front_is_met_counts() {
    let expected = furnace(0.5, 1.0);
    let black = || grey(0.0, 0.0);
    for (name, skin) in
        [("same corners", Room::new().inside_out()), ("other diagonals", Room::new().inside_out().other_diagonals())]
    {
        for skin_first in [true, false] {
            for place in
                [json!({}), json!({ "rotation": [0.18, 0.37, 0.05, 0.91], "translation": [0.01, 0.02, -0.03] })]
            {
                let mut level = Level::new();
                if skin_first {
                    skin.add(&mut level, black());
                }
                Room::new().add(&mut level, grey(0.5, 1.0));
                if !skin_first {
                    skin.add(&mut level, black());
                }
                level.json["nodes"][0].as_object_mut().unwrap().extend(place.as_object().unwrap().clone());
                assert_light(&format!("{name}, skin first: {skin_first}"), irradiance(&level, false), expected);
            }
        }
    }
}

#[test]
fn a_small_lamp_on_two_skins_lights_all_that_it_faces() {
    // A lamp under the ceiling of a room, a black skin on its back; drawn as a light, and found by chance.
    let mut lit = [0.0; 2];
    for (index, skinned) in [false, true].into_iter().enumerate() {
        let mut level = room(grey(0.5, 0.0));
        let corners = [-0.1, 0.9, -0.1, 0.1, 0.9, -0.1, 0.1, 0.9, 0.1, -0.1, 0.9, 0.1];
        let position = level.floats("VEC3", &corners);
        let down = level.indices(&[0, 1, 2, 0, 2, 3]);
        let up = level.indices(&[0, 2, 1, 0, 3, 2]);
        let lamp = push(&mut level.json, "materials", grey(0.0, 1.0));
        level.json["materials"][lamp]["extensions"] =
            json!({ "KHR_materials_emissive_strength": { "emissiveStrength": 50 } });
        let black = push(&mut level.json, "materials", grey(0.0, 0.0));
        let primitives = level.json["meshes"][0]["primitives"].as_array_mut().unwrap();
        let attributes = json!({ "POSITION": position });
        if skinned {
            primitives.push(json!({ "attributes": attributes, "indices": up, "material": black }));
        }
        primitives.push(json!({ "attributes": attributes, "indices": down, "material": lamp }));
        lit[index] = irradiance(&level, false)[0];
    }
    assert!((lit[1] / lit[0] - 1.0).abs() < 0.02 && lit[0] > 0.5, "{lit:?}");
}

#[test]
fn partly_clear_faces_back_to_back_let_through_what_one_does() {
    for flip in [false, true] {
        let pane = json!({
            "alphaMode": "BLEND", "pbrMetallicRoughness": { "baseColorFactor": [0, 0, 0, 0.5], "metallicFactor": 0 },
        });
        let mut level = Level::new();
        let skins = [Room::new(), Room::new().inside_out().other_diagonals()];
        for skin in if flip { [&skins[1], &skins[0]] } else { [&skins[0], &skins[1]] } {
            skin.add(&mut level, pane.clone());
        }
        assert_light("two panes", irradiance(&level, true), [0.5 * PI; 3]);
    }
}

#[test]
fn vertex_colours_are_normalised_and_clamped() {
    let with = |kind: &str, component: u32, bytes: &[u8]| {
        let mut level = Level::new();
        Room::new().add(&mut level, grey(0.5, 1.0));
        let colors = level.accessor(kind, component, 24, bytes);
        level.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(colors);
        level
    };
    let floats = |color: [f32; 4]| color.map(f32::to_le_bytes).as_flattened().repeat(24);
    // Integers that do not say that they are normalised.
    let level = with("VEC4", 5121, &[128, 128, 128, 255].repeat(24));
    let scene = level.read_all().unwrap();
    assert_eq!(finding(&scene, "vertex-colours-not-normalised"), 1);
    assert_light("u8", irradiance_of(&scene, false), furnace(0.5 * 128.0 / 255.0, 1.0));
    let level = with("VEC3", 5123, &[0, 128, 0, 128, 0, 128].repeat(24));
    assert_light("u16", irradiance(&level, false), furnace(0.5 * 32768.0 / 65535.0, 1.0));
    // Floats outside 0 to 1.
    let scene = with("VEC4", 5126, &floats([50_000.0, 50_000.0, 50_000.0, 1.0])).read_all().unwrap();
    assert_eq!(finding(&scene, "clamped-vertex-colours"), 24);
    assert_light("over 1", irradiance_of(&scene, false), furnace(0.5, 1.0));
    assert_light(
        "negative",
        irradiance(&with("VEC4", 5126, &floats([-3.0, -3.0, -3.0, 1.0])), false),
        furnace(0.0, 1.0),
    );
    // What is no number is refused, with the place.
    for wrong in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let level = with("VEC4", 5126, &floats([0.5, wrong, 0.5, 1.0]));
        assert_invalid(level.read_all(), &["mesh 0 primitive 0: COLOR_0 (accessor 3)", "vertex 0"]);
    }
    let level = with("VEC4", 5125, &[0; 4 * 4 * 24]);
    assert_invalid(level.read_all(), &["COLOR_0", "U32", "F32, U8 or U16"]);
}

#[test]
fn metallic_counts_texel_by_texel() {
    // Left half: no metal; right half: all metal. The walls use the left, then the right.
    let picture = png(2, 1, &[[0, 255, 0, 255], [0, 255, 255, 255]]);
    for (offset, albedo) in [(0.0, 0.5), (0.5, 0.5 * f64::from(rough_metal_share(1.0)))] {
        let mut material = grey(0.5, 1.0);
        material["pbrMetallicRoughness"]["metallicFactor"] = json!(1);
        material["pbrMetallicRoughness"]["metallicRoughnessTexture"] = json!({
            "index": 0, "extensions": { "KHR_texture_transform": { "scale": [0.5, 1], "offset": [offset, 0] } },
        });
        let level = with_textures(room(material), std::slice::from_ref(&picture));
        assert_light(&format!("from {offset}"), irradiance(&level, false), furnace(albedo, 1.0));
    }
}

#[test]
fn metals_reflect_by_their_roughness_or_are_black() {
    for roughness in [0.0, 0.6, 1.0] {
        let material = json!({
            "pbrMetallicRoughness": { "baseColorFactor": [0.9, 0.6, 0.3, 1], "roughnessFactor": roughness },
            "emissiveFactor": [1, 1, 1],
        });
        let level = room(material);
        let share = f64::from(rough_metal_share(roughness));
        let expected = [0.9, 0.6, 0.3].map(|base| furnace(base * share, 1.0)[0]);
        assert_light("diffuse", irradiance(&level, false), expected);
        let options = GltfOptions { textures: TextureNeeds::All, metals: Metals::Black, ..GltfOptions::default() };
        assert_light("black", irradiance_of(&level.read_with(&options).unwrap(), false), [PI; 3]);
    }
    // glTF's default material is a rough, white metal.
    let scene = room(json!({ "emissiveFactor": [1, 1, 1] })).read_all().unwrap();
    assert_light("default", irradiance_of(&scene, false), furnace(f64::from(rough_metal_share(1.0)), 1.0));
}

#[test]
fn specular_glossiness_reflects_what_specular_leaves() {
    let old = |extension: Value| {
        room(json!({ "emissiveFactor": [1, 1, 1], "extensions": { "KHR_materials_pbrSpecularGlossiness": extension } }))
    };
    let diffuse = [0.5, 0.5, 0.5, 1.0];
    // Absent means white: nothing is diffuse.
    let level = old(json!({ "diffuseFactor": diffuse, "glossinessFactor": 0 }));
    assert_light("default", irradiance(&level, false), furnace(0.0, 1.0));
    // c_diff = diffuse × (1 - max(specular)).
    let level = old(json!({ "diffuseFactor": diffuse, "specularFactor": [0.1, 0.4, 0.2] }));
    assert_light("factor", irradiance(&level, false), furnace(0.5 * (1.0 - 0.4), 1.0));
    // Times the texture, which is sRGB: 188 is 0.5029.
    let picture = png(2, 1, &[[188, 0, 188, 0], [188, 188, 0, 255]]);
    let level = old(json!({
        "diffuseFactor": diffuse, "specularFactor": [0.8, 0.2, 0.2], "specularGlossinessTexture": { "index": 0 },
    }));
    let level = with_textures(level, &[picture]);
    assert_light("texture", irradiance(&level, false), furnace(0.5 * (1.0 - 0.8 * 0.5029), 1.0));
}

/// Not metal, without emission, that lets light through.
fn glass(base: [f64; 3], transmission: Value) -> Value {
    let [r, g, b] = base;
    json!({
        "pbrMetallicRoughness": { "baseColorFactor": [r, g, b, 1], "metallicFactor": 0 },
        "extensions": { "KHR_materials_transmission": transmission },
    })
}

#[test]
fn transmission_is_tinted_and_metals_have_none() {
    let full = || json!({ "transmissionFactor": 1 });
    let clear = |level: &Level| irradiance(level, true);
    assert_light("red", clear(&room(glass([1.0, 0.2, 0.1], full()))), [PI, 0.2 * PI, 0.1 * PI]);
    assert_light("black", clear(&room(glass([0.0; 3], full()))), [0.0; 3]);
    assert_light("clear", clear(&room(glass([1.0; 3], full()))), [PI; 3]);
    let mut metal = glass([1.0, 0.2, 0.1], full());
    metal["pbrMetallicRoughness"]["metallicFactor"] = json!(1);
    let options = GltfOptions { textures: TextureNeeds::All, metals: Metals::Black, ..GltfOptions::default() };
    assert_light("metal", irradiance_of(&room(metal).read_with(&options).unwrap(), true), [0.0; 3]);
    // Half goes on, half of what meets the walls stays in: E = π t b / (1 - (1 - t) b).
    let expected = [0.8, 0.4, 0.0].map(|b| PI * 0.5 * b / (1.0 - 0.5 * b));
    assert_light("half", clear(&room(glass([0.8, 0.4, 0.0], json!({ "transmissionFactor": 0.5 })))), expected);
    // Factor × texture R, linear; the base colour's texture tints.
    let pictures = [png(2, 1, &[[51, 0, 0, 255], [255, 0, 0, 255]]), png(1, 1, &[[255, 188, 0, 255]])];
    let half = json!({ "index": 0, "extensions": { "KHR_texture_transform": { "scale": [0.5, 1] } } });
    let mut material = glass([1.0, 1.0, 1.0], json!({ "transmissionFactor": 1, "transmissionTexture": half }));
    material["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": 1 });
    let t = 51.0 / 255.0;
    let expected = [1.0, 0.5029, 0.0].map(|b| if b == 1.0 { PI } else { PI * t * b / (1.0 - (1.0 - t) * b) });
    let found = clear(&with_textures(room(material), &pictures));
    // White walls that lose nothing need more bounces than are traced.
    assert_light("texture", [PI, found[1], found[2]], expected);
}

#[test]
fn coverage_and_transmission_go_together() {
    // Holes let all through, the rest by its colour: T = 1 - α + α t b.
    let mut material = glass([0.5, 1.0, 0.0], json!({ "transmissionFactor": 1 }));
    material["alphaMode"] = json!("BLEND");
    material["pbrMetallicRoughness"]["baseColorFactor"][3] = json!(0.4);
    let expected = [0.5, 1.0, 0.0].map(|b| PI * (0.6 + 0.4 * b));
    assert_light("blend", irradiance(&room(material), true), expected);
}

#[test]
fn glass_that_glows_gives_its_emission() {
    let mut material = glass([1.0; 3], json!({ "transmissionFactor": 1 }));
    material["emissiveFactor"] = json!([0.5, 0.25, 0]);
    assert_light("glowing", irradiance(&room(material), true), [1.5 * PI, 1.25 * PI, PI]);
}

#[test]
fn volumes_attenuate_by_thickness() {
    // color^(thickness / distance).
    let mut material = glass([1.0; 3], json!({ "transmissionFactor": 1 }));
    material["extensions"]["KHR_materials_volume"] =
        json!({ "thicknessFactor": 0.5, "attenuationDistance": 0.25, "attenuationColor": [0.9, 0.5, 0.0] });
    let share = |color: f64, thickness: f64| color.powf(thickness / 0.25);
    assert_light("factor", irradiance(&room(material.clone()), true), [0.9, 0.5, 0.0].map(|c| PI * share(c, 0.5)));
    // A solid shell around the place: in by one face and out by the other, its thickness once.
    let mut shell = room(material.clone());
    let mut outside = Room::new().inside_out();
    outside.positions.iter_mut().for_each(|p| *p *= 1.25);
    outside.add(&mut shell, material.clone());
    assert_light("shell", irradiance(&shell, true), [0.9, 0.5, 0.0].map(|c| PI * share(c, 0.5)));
    // Times the texture's G, linear.
    material["extensions"]["KHR_materials_volume"]["thicknessTexture"] =
        json!({ "index": 0, "extensions": { "KHR_texture_transform": { "scale": [0.5, 1] } } });
    let level = with_textures(room(material), &[png(2, 1, &[[0, 51, 0, 255], [0, 255, 0, 255]])]);
    assert_light("texture", irradiance(&level, true), [0.9, 0.5, 0.0].map(|c| PI * share(c, 0.1)));
}

#[test]
fn diffuse_transmission_sends_light_through() {
    let curtain = |base: f64, emission: f64, extension: Value| {
        let mut material = grey(base, emission);
        material["extensions"] = json!({ "KHR_materials_diffuse_transmission": extension });
        material
    };
    // Under a sky of 1 the outside is lit by π: E = π d c / (1 - (1 - d) b).
    let through = |d: f64, c: f64, b: f64| PI * d * c / (1.0 - (1.0 - d) * b);
    let color = [0.9, 0.5, 0.1];
    for d in [1.0, 0.5] {
        let extension = json!({ "diffuseTransmissionFactor": d, "diffuseTransmissionColorFactor": color });
        let level = room(curtain(0.6, 0.0, extension));
        assert_light(&format!("factor {d}"), irradiance(&level, true), color.map(|c| through(d, c, 0.6)));
    }
    // A volume behind the surface: its colour^(thickness / distance) of it is left.
    let mut thick = curtain(0.0, 0.0, json!({ "diffuseTransmissionFactor": 0.5 }));
    thick["extensions"]["KHR_materials_volume"] =
        json!({ "thicknessFactor": 2, "attenuationDistance": 1, "attenuationColor": color });
    assert_light("volume", irradiance(&room(thick), true), color.map(|c| through(0.5, c * c, 0.0)));
    // Nothing is reflected where all goes through.
    let level = room(curtain(0.5, 1.0, json!({ "diffuseTransmissionFactor": 1 })));
    assert_light("glowing", irradiance(&level, false), [PI; 3]);
    // Factor × A of one texture, colour × sRGB of another.
    let pictures = [png(2, 1, &[[0, 0, 0, 51], [0, 0, 0, 255]]), png(1, 1, &[[255, 188, 0, 255]])];
    let quarter = json!({ "index": 0, "extensions": { "KHR_texture_transform": { "scale": [0.5, 1] } } });
    let extension = json!({
        "diffuseTransmissionFactor": 1, "diffuseTransmissionTexture": quarter,
        "diffuseTransmissionColorTexture": { "index": 1 },
    });
    let level = with_textures(room(curtain(0.6, 0.0, extension)), &pictures);
    let expected = [1.0, 0.5029, 0.0].map(|c| through(0.2, c, 0.6));
    assert_light("textures", irradiance(&level, true), expected);
}

#[test]
fn nearest_samplers_read_one_texel() {
    // A palette of two, looked up beside the border between them: half way, were it blurred.
    let picture = png(2, 1, &[[188, 188, 188, 255], [0, 0, 0, 255]]);
    for (u, albedo) in [(0.49, 0.5029), (0.51, 0.0)] {
        let mut material = grey(1.0, 1.0);
        material["pbrMetallicRoughness"]["baseColorTexture"] = json!({
            "index": 0, "extensions": { "KHR_texture_transform": { "scale": [0, 0], "offset": [u, 0.5] } },
        });
        let level = with_textures(room(material), std::slice::from_ref(&picture));
        assert_light(&format!("u {u}"), irradiance(&level, false), furnace(albedo, 1.0));
    }
}

#[test]
fn unlit_shows_base_colour_times_texture_times_vertex_colour() {
    let mut level = Level::new();
    let attributes = Room::new().add(
        &mut level,
        json!({
            "pbrMetallicRoughness": { "baseColorFactor": [0.8, 0.4, 0.2, 1], "baseColorTexture": { "index": 0 } },
            "extensions": { "KHR_materials_unlit": {} },
        }),
    );
    attributes["COLOR_0"] = json!(3);
    level.floats("VEC3", &[0.5; 72]);
    let level = with_textures(level, &[png(1, 1, &[[255, 188, 255, 255]])]);
    assert_light("unlit", irradiance(&level, false), [0.8 * 0.5, 0.4 * 0.5 * 0.5029, 0.2 * 0.5].map(|e| PI * e));
}

#[test]
fn a_textured_level_is_captured_baked_and_path_traced_with_the_same_albedo() {
    // Every lookup that albedo has: colour, metal and roughness by texel, each from a picture of its own.
    let pictures =
        [png(2, 1, &[[188, 188, 188, 255], [0, 0, 0, 255]]), png(2, 1, &[[0, 128, 102, 255], [0, 255, 255, 255]])];
    let mut material = grey(0.9, 1.0);
    let left =
        |index: usize| json!({ "index": index, "extensions": { "KHR_texture_transform": { "scale": [0.5, 1] } } });
    material["pbrMetallicRoughness"] = json!({
        "baseColorFactor": [0.9, 0.9, 0.9, 1], "baseColorTexture": left(0), "metallicRoughnessTexture": left(1),
    });
    let level = with_textures(room(material), &pictures);
    let metallic = 102.0 / 255.0;
    let share = f64::from(rough_metal_share(128.0 / 255.0));
    let expected = furnace(0.9 * 0.5029 * (1.0 - metallic + metallic * share), 1.0);

    // Path traced.
    let all = level.read_all().unwrap();
    let path = Path::new(&all, None, PathSettings::default());
    assert_light("path traced", irradiance_by(&path), expected);
    // Captured: the probe's pixels, with and without what the walls send out themselves.
    for (emission, needs) in [(true, TextureNeeds::Gdibl), (false, TextureNeeds::Captured)] {
        let settings = CaptureSettings { width: 32, samples: 256, emission, ..CaptureSettings::default() };
        let captured =
            control(|control| capture(&path, DVec3::ZERO, 0, &settings, control)).expect("nobody interrupts");
        let image = captured.image;
        let mean: f64 = image.pixels.iter().map(|p| f64::from(p[0])).sum::<f64>() / image.pixels.len() as f64;
        let own = if emission { 0.0 } else { 1.0 };
        assert_light("captured", [PI * (mean + own); 3], expected);
        // Baked from it.
        let probe = Probe {
            name: "probe".into(),
            position: DVec3::ZERO,
            rotation: Quat::IDENTITY,
            exposure_stops: 0.0,
            panorama: Panorama::new(image.width, image.height, image.pixels.clone(), image.distance.clone()),
        };
        let scene = level.read_with(&GltfOptions { textures: needs, ..GltfOptions::default() }).unwrap();
        let settings = GdiblSettings { emission_from_materials: !emission, ..GdiblSettings::default() };
        let probes = [probe];
        let function = Gdibl::new(&scene, &probes, None, settings);
        assert_light("baked", irradiance_by(&function), expected);
    }
}

fn sky() -> Distant {
    Distant { panorama: Panorama::new(2, 1, vec![[1.0; 3]; 2], None), ..Distant::black() }
}

#[test]
fn scene_geometry_lets_light_through_for_probes_as_for_paths() {
    let curtain = json!({
        "pbrMetallicRoughness": { "baseColorFactor": [0, 0, 0, 1], "metallicFactor": 0 },
        "extensions": { "KHR_materials_diffuse_transmission":
            { "diffuseTransmissionFactor": 0.5, "diffuseTransmissionColorFactor": [1, 0.5, 0.25] } },
    });
    for (name, material, expected) in [
        ("glass", glass([1.0, 0.2, 0.1], json!({ "transmissionFactor": 1 })), [PI, 0.2 * PI, 0.1 * PI]),
        ("curtain", curtain, [0.5 * PI, 0.25 * PI, 0.125 * PI]),
    ] {
        let mut level = room(material);
        level.json["nodes"][0]["extras"] = json!({ "gdibl_role": "scene" });
        let (scene, sky) = (level.read().unwrap(), sky());
        assert_light(name, irradiance_by(&Gdibl::new(&scene, &[], Some(&sky), GdiblSettings::default())), expected);
        assert_light(name, irradiance(&level, true), expected);
    }
}

#[test]
fn a_skin_of_scene_geometry_hides_no_front_of_the_environment() {
    let probe = || Probe {
        name: "probe".into(),
        position: DVec3::ZERO,
        rotation: Quat::IDENTITY,
        exposure_stops: 0.0,
        panorama: Panorama::new(8, 4, vec![[2.0, 1.0, 0.5]; 32], None),
    };
    for skin in [Room::new().inside_out(), Room::new().inside_out().other_diagonals()] {
        let mut level = room(grey(0.5, 0.0));
        let mut black = grey(0.0, 0.0);
        black["extras"] = json!({ "gdibl_role": "scene" });
        skin.add(&mut level, black);
        let (scene, probes) = (level.read().unwrap(), [probe()]);
        let function = Gdibl::new(&scene, &probes, None, GdiblSettings::default());
        assert_light("skin", irradiance_by(&function), [2.0 * PI, PI, 0.5 * PI]);
    }
}

#[test]
fn walls_that_let_light_through_seal_nothing() {
    let nodes = Nodes::Points(vec![PLACE]);
    let is_sealed = |material: Value| Shells::of(&room(material).read_all().unwrap()).seal(&nodes);
    assert!(is_sealed(grey(0.5, 0.0)));
    assert!(!is_sealed(glass([1.0; 3], json!({ "transmissionFactor": 0.1 }))));
    let mut curtain = grey(0.5, 0.0);
    curtain["extensions"] = json!({ "KHR_materials_diffuse_transmission": { "diffuseTransmissionFactor": 0.1 } });
    assert!(!is_sealed(curtain));
}

#[test]
fn light_that_is_not_finite_is_refused_with_its_source() {
    for (strength, is_finite) in [(1e30, true), (3e38, false)] {
        let mut lamp = grey(0.5, 1.0);
        lamp["name"] = json!("lamp");
        lamp["extensions"] = json!({ "KHR_materials_emissive_strength": { "emissiveStrength": strength } });
        let scene = room(lamp).read_all().unwrap();
        let (nodes, path) = (Nodes::Points(vec![PLACE]), Path::new(&scene, None, PathSettings::default()));
        let settings = BakeSettings { samples: 64, ..BakeSettings::default() };
        let baked = control(|control| bake(&nodes, &path, &settings, control)).expect("nobody interrupts");
        match check_finite(&nodes, &baked, &scene) {
            Ok(()) => assert!(is_finite),
            Err(message) => {
                assert!(!is_finite);
                for part in ["node 0", "[0.1, 0.2, -0.3]", "material 0 (lamp)", "3e38", "nothing was written"] {
                    assert!(message.contains(part), "{message}");
                }
            }
        }
    }
}

#[test]
fn a_dark_room_of_double_sided_walls_is_dark_and_a_solid_is_none() {
    for double_sided in [true, false] {
        let mut black = grey(0.0, 0.0);
        black["doubleSided"] = json!(double_sided);
        let mut level = Level::new();
        Room::new().inside_out().add(&mut level, black);
        let (scene, sky) = (level.read_all().unwrap(), sky());
        let path = Path::new(&scene, Some(&sky), PathSettings::default());
        let settings = BakeSettings { samples: 64, ..BakeSettings::default() };
        let baked = control(|control| bake(&Nodes::Points(vec![PLACE]), &path, &settings, control)).expect("nobody");
        assert_eq!(baked.is_valid(0), double_sided);
        assert!(baked.node(0).iter().all(|value| *value == 0.0));
    }
}

/// A skinned room: the file's vertices are `scale` times too large, joint 0 brings them back; half of the weights go to a
/// second joint that stands elsewhere, with an inverse bind matrix that says so.
fn skinned_room(weights: [f32; 2], pose: DVec3) -> Level {
    const SCALE: f64 = 100.0;
    let mut level = Level::new();
    let mut skin = Room::new();
    skin.positions.iter_mut().for_each(|p| *p *= SCALE as f32);
    skin.add(&mut level, grey(0.0, 1.0));
    let joints = level.accessor("VEC4", 5121, 24, &[0, 1, 0, 0].repeat(24));
    let weights = level.floats("VEC4", &[weights[0], weights[1], 0.0, 0.0].repeat(24));
    let attributes = &mut level.json["meshes"][0]["primitives"][0]["attributes"];
    attributes["JOINTS_0"] = json!(joints);
    attributes["WEIGHTS_0"] = json!(weights);
    let bind = |translation: DVec3| {
        let scale = glam::DAffine3::from_scale(DVec3::splat(1.0 / SCALE));
        let inverse = glam::DAffine3::from_translation(translation).inverse() * scale;
        glam::DMat4::from(inverse).to_cols_array().map(|v| v as f32)
    };
    let matrices = [bind(DVec3::ZERO), bind(DVec3::new(5.0, 0.0, 0.0))].concat();
    let matrices = level.floats("MAT4", &matrices);
    level.json["accessors"][matrices]["count"] = json!(2);
    level.json["skins"] = json!([{ "inverseBindMatrices": matrices, "joints": [1, 2] }]);
    let turn = DQuat::from_rotation_y(0.0).to_array();
    level.json["nodes"] = json!([
        // Its own place does not count.
        { "mesh": 0, "skin": 0, "translation": [1000, 0, 0], "scale": [3, 3, 3] },
        { "translation": pose.to_array(), "rotation": turn, "children": [2] },
        { "translation": [5, 0, 0] },
    ]);
    level.json["scenes"] = json!([{ "nodes": [0, 1] }]);
    level
}

#[test]
fn joints_place_skinned_meshes() {
    // In the pose in which it was made, and moved as a whole.
    for weights in [[1.0, 0.0], [0.5, 0.5], [2.0, 2.0], [0.0, 0.0]] {
        for pose in [DVec3::ZERO, DVec3::new(7.0, -2.0, 3.0)] {
            let scene = skinned_room(weights, pose).read_all().unwrap();
            let (min, max) = scene.bounds(|_| true).unwrap();
            assert!((min - pose + 1.0).abs().max_element() < 1e-5, "{weights:?} {pose}: from {min}");
            assert!((max - pose - 1.0).abs().max_element() < 1e-5, "{weights:?} {pose}: to {max}");
        }
    }
    let level = skinned_room([0.5, 0.5], DVec3::ZERO);
    assert_light("skinned", irradiance(&level, false), [PI; 3]);
    let mut level = skinned_room([0.5, 0.5], DVec3::ZERO);
    level.json["skins"][0]["joints"] = json!([1]);
    assert_invalid(level.read_all(), &["mesh 0 primitive 0: JOINTS_0 of vertex 0 names joint 1", "has 1"]);
}
