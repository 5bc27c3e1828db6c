//! Materials, and which textures are decoded.

use gdibl_baker::import::gltf::{GltfOptions, TextureNeeds};
use gdibl_baker::radiance::path::specular_left_out;
use gdibl_baker::scene::{Alpha, Metals, Scene, Wrap};
use glam::{Vec2, Vec3, Vec4};
use serde_json::json;

use crate::builder::{Level, assert_unsupported, data_uri, encode, finding, png, push};

const WHITE: [u8; 4] = [255; 4];

#[test]
fn material_factors_are_read() {
    let mut level = Level::triangle();
    level.json["materials"] = json!([
        {
            "name": "lamp", "alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": true,
            "pbrMetallicRoughness":
                { "baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.5, "roughnessFactor": 0.25 },
            "emissiveFactor": [1, 0.5, 0],
            "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 8 } },
        },
        { "pbrMetallicRoughness": { "baseColorFactor": [0.1, 0.2, 0.3, 0.4] } },
        { "extensions": { "KHR_materials_transmission": { "transmissionFactor": 0.75 } } },
        { "pbrMetallicRoughness": { "baseColorFactor": [0.1, 0.2, 0.3, 1] }, "extensions": { "KHR_materials_unlit": {} } },
        { "extensions": { "KHR_materials_pbrSpecularGlossiness": { "diffuseFactor": [0.5, 0.6, 0.7, 1], "extras": 1 } } },
        { "pbrMetallicRoughness": { "baseColorFactor": [2, -1, 0.5, 1] } },
    ]);
    let scene = level.read().unwrap();
    let [default, lamp, opaque, glass, unlit, old, wild] = &scene.materials[..] else { panic!() };
    assert_eq!((default.base_color, default.metallic, default.alpha), (Vec4::ONE, 1.0, Alpha::Opaque));
    assert_eq!((lamp.name.as_str(), lamp.alpha, lamp.double_sided), ("lamp", Alpha::Mask(0.25), true));
    assert_eq!((lamp.base_color, lamp.metallic, lamp.roughness), (Vec4::new(0.1, 0.2, 0.3, 0.4), 0.5, 0.25));
    assert_eq!((default.roughness, opaque.roughness), (1.0, 1.0));
    assert_eq!(lamp.emission, Vec3::new(8., 4., 0.));
    assert_eq!((opaque.alpha, opaque.base_color.w), (Alpha::Opaque, 1.0));
    assert_eq!((glass.alpha, glass.base_color.w, glass.transmission), (Alpha::Opaque, 1.0, 0.75));
    assert!(glass.is_clear() && !opaque.is_clear());
    assert!(unlit.unlit && unlit.emission == Vec3::new(0.1, 0.2, 0.3));
    // Absent, specular is white, and leaves nothing to diffuse reflection.
    assert_eq!((old.base_color, old.metallic, old.metals), (Vec4::new(0.5, 0.6, 0.7, 1.0), 1.0, Metals::Black));
    assert_eq!((default.metals, lamp.metals), (Metals::Diffuse, Metals::Diffuse));
    assert_eq!(wild.base_color, Vec4::new(1.0, 0.0, 0.5, 1.0));
    assert_eq!(finding(&scene, "clamped-material-factors"), 2);
    assert_eq!(scene.meshes[0].material, 0);
}

#[test]
fn vertex_colours_come_in_all_formats() {
    for (kind, component_type, bytes, alpha) in [
        ("VEC4", 5121, [255, 0, 51, 102].repeat(3), 0.4),
        ("VEC4", 5123, [255, 255, 0, 0, 51, 51, 102, 102].repeat(3), 0.4),
        ("VEC3", 5126, [1.0_f32, 0.0, 0.2].map(f32::to_le_bytes).as_flattened().repeat(3), 1.0),
    ] {
        let mut level = Level::triangle();
        let color = level.accessor(kind, component_type, 3, &bytes);
        level.json["accessors"][color]["normalized"] = json!(component_type != 5126);
        *level.primitive("attributes") = json!({ "POSITION": 0, "COLOR_0": color });
        let colors = level.read_all().unwrap().meshes.remove(0).colors;
        assert_eq!(colors.len(), 3);
        assert!((colors[2] - Vec4::new(1.0, 0.0, 0.2, alpha)).abs().max_element() < 1e-6, "{kind} {colors:?}");
        // The environment's colours are in the probes' pixels.
        assert!(level.read().unwrap().meshes[0].colors.is_empty());
    }
}

#[test]
fn only_needed_textures_are_decoded() {
    let opaque = json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } });
    let mask = json!({ "alphaMode": "MASK", "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } });
    let lamp = json!({ "emissiveFactor": [1, 1, 1], "emissiveTexture": { "index": 0 } });
    let dark = json!({ "emissiveTexture": { "index": 0 } });
    let image = png(1, 1, &[[255, 0, 0, 128]]);
    //                                        environment  scene  all
    for (material, decoded) in [(opaque, [0, 1, 1]), (mask, [1, 1, 1]), (lamp, [0, 1, 1]), (dark, [0, 0, 0])] {
        let mut level = Level::textured(material.clone(), &image);
        let environment = level.read().unwrap();
        let all = level.read_all().unwrap();
        level.json["nodes"][0]["extras"] = json!({ "gdibl_role": "scene" });
        let scene = level.read().unwrap();
        for (scene, decoded) in [environment, scene, all].into_iter().zip(decoded) {
            assert_eq!(scene.textures.len(), decoded, "{material}");
            assert_eq!(scene.meshes[0].uvs[0].len(), 3 * decoded, "{material}");
        }
    }
}

#[test]
fn textures_that_nothing_needs_may_be_missing_or_damaged() {
    let opaque = json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } });
    let mut level = Level::textured(opaque, b"no image");
    assert!(level.read().is_ok());
    level.json["images"] = json!([{ "uri": "missing.png" }]);
    assert!(level.read().is_ok());
    level.json["textures"] = json!([{ "extensions": { "KHR_texture_basisu": { "source": 0 } } }]);
    level.json["extensionsRequired"] = json!(["KHR_texture_basisu"]);
    assert!(level.read().is_ok());
    // A material without triangles needs nothing either.
    let indices = level.indices(&[0, 0, 0]);
    *level.primitive("indices") = json!(indices);
    assert!(level.read_all().is_ok());
}

#[test]
fn textures_decode_from_every_format_and_place() {
    let red = image::RgbaImage::from_pixel(8, 8, image::Rgba([255, 0, 0, 255]));
    let red: image::DynamicImage = red.into();
    let mask = json!({ "alphaMode": "MASK", "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } });
    let jpeg = encode(red.to_rgb8().into(), image::ImageFormat::Jpeg);
    let formats =
        [encode(red.clone(), image::ImageFormat::Png), encode(red.clone(), image::ImageFormat::WebP), jpeg.clone()];
    for bytes in formats {
        let mut level = Level::textured(mask.clone(), &bytes);
        let by_uri = level.read_all().unwrap();
        let sample = by_uri.textures[0].sample(Vec2::new(0.3, 0.6));
        assert!((sample - Vec4::new(1., 0., 0., 1.)).abs().max_element() < 0.02, "{sample}");
        let view = level.view(&bytes);
        level.json["images"] = json!([{ "bufferView": view, "mimeType": "image/wrong" }]);
        assert_eq!(level.read_all().unwrap().textures, by_uri.textures);
    }
    // A mask by an image that cannot have alpha: nothing to keep.
    assert_eq!(Level::textured(mask, &jpeg).read().unwrap().textures.len(), 0);
}

#[test]
fn texture_lookups_carry_set_transform_and_wrap() {
    let material = json!({
        "pbrMetallicRoughness": { "baseColorTexture": { "index": 0, "texCoord": 3, "extensions": {
            "KHR_texture_transform": {
                "offset": [0.5, 0.25], "rotation": std::f64::consts::FRAC_PI_2, "scale": [2, 3], "extras": { "a": 1 },
            },
        } } },
        "emissiveFactor": [1, 1, 1],
        "emissiveTexture": { "index": 1 },
    });
    let mut level = Level::textured(material, &png(1, 1, &[WHITE]));
    let uv3 = level.floats("VEC2", &[0., 0., 1., 0., 0., 1.]);
    level.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_3"] = json!(uv3);
    level.json["samplers"] = json!([{ "wrapS": 33071, "wrapT": 33648 }]);
    level.json["textures"] = json!([{ "source": 0, "sampler": 0 }, { "source": 0 }]);
    let scene = level.read_all().unwrap();
    let material = &scene.materials[1];
    let (base, emission) = (material.base_color_texture.unwrap(), material.emission_texture.unwrap());
    assert_eq!((base.uv_set, emission.uv_set), (0, 1));
    assert_eq!((scene.meshes[0].uvs[0].len(), scene.meshes[0].uvs[1].len()), (3, 3));
    assert_eq!(scene.textures[base.texture as usize].sampler.wrap, [Wrap::ClampToEdge, Wrap::MirroredRepeat]);
    assert_eq!(scene.textures[emission.texture as usize].sampler.wrap, [Wrap::Repeat; 2]);
    // offset · rotation · scale: (1,0) → (2,0) → (0,-2), counter-clockwise where v grows downwards.
    assert!((base.transform(Vec2::X) - Vec2::new(0.5, -1.75)).length() < 1e-6, "{}", base.transform(Vec2::X));
    assert!((base.transform(Vec2::Y) - Vec2::new(3.5, 0.25)).length() < 1e-6, "{}", base.transform(Vec2::Y));
    assert_eq!(emission.transform(Vec2::new(0.3, 0.4)), Vec2::new(0.3, 0.4));
}

#[test]
fn shared_images_are_decoded_once() {
    let mask = json!({ "alphaMode": "MASK", "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } });
    let mut level = Level::textured(mask.clone(), &png(1, 1, &[[0; 4]]));
    level.json["materials"] =
        json!([mask, { "alphaMode": "BLEND", "pbrMetallicRoughness": { "baseColorTexture": { "index": 1 } } }]);
    push(&mut level.json, "textures", json!({ "source": 0 }));
    let mut second = level.json["meshes"][0]["primitives"][0].clone();
    second["material"] = json!(1);
    level.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(second);
    let scene = level.read().unwrap();
    assert_eq!(scene.textures.len(), 1);
    assert!(scene.materials[1..].iter().all(|material| material.base_color_texture.is_some()));
}

#[test]
fn transmission_does_not_wake_the_alpha_of_an_opaque_texture() {
    let glass = json!({
        "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } },
        "extensions": { "KHR_materials_transmission": { "transmissionFactor": 0.5 } },
    });
    let level = Level::textured(glass, &png(1, 1, &[[255, 255, 255, 0]]));
    let scene = level.read_all().unwrap();
    assert_eq!(scene.textures[0].sample(Vec2::ZERO), Vec4::ONE);
    assert_eq!((scene.materials[1].transmission, scene.materials[1].alpha), (0.5, Alpha::Opaque));
    // Its colour tints what goes through, whoever bakes.
    assert_eq!(level.read().unwrap().textures, scene.textures);
}

#[test]
fn metallic_maps_are_kept_where_they_vary_and_are_needed() {
    // Most exporters write factor 1 and let the texture say "not metal": without it every wall would be a metal.
    let material = json!({ "pbrMetallicRoughness": { "metallicRoughnessTexture": { "index": 0 } } });
    let varied = Level::textured(material.clone(), &png(2, 1, &[[255, 255, 0, 255], [0, 0, 51, 255]]));
    let scene = varied.read_all().unwrap();
    let map = scene.materials[1].metallic_map.unwrap();
    assert_eq!((scene.materials[1].metallic, &scene.maps[map.texture as usize].values[..]), (1.0, &[0, 51][..]));
    let map = scene.materials[1].roughness_map.unwrap();
    assert_eq!(scene.maps[map.texture as usize].values, [255, 0]);
    assert!(scene.textures.is_empty() && !scene.meshes[0].uvs[0].is_empty());
    // One value all over is a factor.
    let even = Level::textured(material, &png(2, 1, &[[255, 102, 51, 255]; 2])).read_all().unwrap();
    let material = &even.materials[1];
    assert!((material.metallic - 0.2).abs() < 1e-6 && (material.roughness - 0.4).abs() < 1e-6);
    assert!(even.maps.is_empty() && material.metallic_map.is_none() && even.meshes[0].uvs[0].is_empty());
    // A bake by probes needs none of it, and knows that it does not know.
    let scene = varied.read().unwrap();
    assert!(scene.maps.is_empty() && scene.materials[1].metallic_unknown);
}

#[test]
fn metals_are_told_of_by_what_is_known() {
    let material = json!({ "pbrMetallicRoughness": { "metallicRoughnessTexture": { "index": 0 } } });
    let picture = [[0, 255, 0, 255], [0, 255, 51, 255]];
    let level = Level::textured(material, &png(2, 1, &picture));
    let told = |scene: &Scene| specular_left_out(scene).map(|finding| finding.message);
    // A tenth, by the mean of the texture.
    let message = told(&level.read_all().unwrap()).unwrap();
    assert!(message.contains("reflect 10 % of") && message.contains("--metals black"), "{message}");
    let message = told(&level.read().unwrap()).unwrap();
    assert!(message.contains("may reflect") && !message.contains("100 %"), "{message}");
    let black = GltfOptions { textures: TextureNeeds::All, metals: Metals::Black, ..Default::default() };
    assert!(told(&level.read_with(&black).unwrap()).unwrap().contains("they are black here"));
    let plain = json!({ "pbrMetallicRoughness": { "metallicFactor": 0 } });
    assert_eq!(told(&Level::textured(plain, &png(1, 1, &[WHITE])).read_all().unwrap()), None);
}

#[test]
fn missing_textures_are_grey_and_told_where_that_is_allowed() {
    let material = json!({ "pbrMetallicRoughness": {
        "baseColorTexture": { "index": 0 }, "metallicRoughnessTexture": { "index": 1 },
    } });
    let mut level = Level::textured(material, b"no image");
    level.json["images"] = json!([{ "uri": "missing.png" }, { "uri": "missing too.png" }]);
    push(&mut level.json, "textures", json!({ "source": 1 }));
    assert!(level.read_all().is_err());
    let options = GltfOptions { textures: TextureNeeds::All, allow_missing_textures: true, ..Default::default() };
    let scene = level.read_with(&options).unwrap();
    assert_eq!(finding(&scene, "missing-textures"), 2);
    let grey = scene.textures[0].sample(Vec2::splat(0.5));
    assert!((grey - Vec4::new(0.18, 0.18, 0.18, 1.0)).abs().max_element() < 0.005, "{grey}");
    assert_eq!(scene.materials[1].metallic, 0.0);
    // Damaged, or of a format that is not read: the same.
    for bytes in [&b"no image"[..], b"\0\0\0\x1Cftypavif\0\0\0\0"] {
        level.json["images"] = json!([{ "uri": data_uri("image/png", bytes) }, { "uri": "missing too.png" }]);
        assert_eq!(finding(&level.read_with(&options).unwrap(), "missing-textures"), 2);
    }
    level.json["textures"] = json!([{ "extensions": { "KHR_texture_basisu": { "source": 0 } } }, { "source": 1 }]);
    assert_eq!(finding(&level.read_with(&options).unwrap(), "missing-textures"), 2);
}

#[test]
fn images_in_formats_that_are_not_read_are_named_with_what_converts_them() {
    let material = || json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } });
    let avif = "gltf-transform png IN OUT --formats \"*\"";
    for (bytes, name, tool) in [
        (&b"\0\0\0\x1Cftypavif\0\0\0\0"[..], "AVIF", avif),
        (b"\0\0\0\x0CjP  \r\n\x87\n\0\0\0\x14ftypjp2 ", "JPEG 2000", "an image converter"),
        (b"\0\0\0\x0CJXL \r\n\x87\n", "JPEG XL", "an image converter"),
    ] {
        assert_unsupported(Level::textured(material(), bytes).read_all(), &["image 0", name, tool]);
    }
    let mut level = Level::textured(material(), b"");
    level.json["textures"] = json!([{ "extensions": { "EXT_texture_avif": { "source": 0 } } }]);
    assert_unsupported(level.read_all(), &["texture 0", "AVIF", avif]);
}

#[test]
fn missing_texture_coordinates_are_zero_and_a_finding() {
    let mask = json!({ "alphaMode": "MASK", "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } });
    let mut level = Level::textured(mask, &png(1, 1, &[[0; 4]]));
    *level.primitive("attributes") = json!({ "POSITION": 0 });
    let scene = level.read().unwrap();
    assert_eq!(scene.meshes[0].uvs[0], [Vec2::ZERO; 3]);
    assert_eq!(finding(&scene, "missing-texture-coordinates"), 1);
}

#[test]
fn both_choices_of_textures_give_the_same_geometry() {
    let opaque = json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } });
    let level = Level::textured(opaque, &png(1, 1, &[WHITE]));
    let read = |textures| level.read_with(&GltfOptions { textures, ..Default::default() }).unwrap();
    let (few, all) = (read(TextureNeeds::Gdibl), read(TextureNeeds::All));
    assert_eq!(few.meshes[0].positions, all.meshes[0].positions);
    assert_eq!((few.textures.len(), all.textures.len()), (0, 1));
}
