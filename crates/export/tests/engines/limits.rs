//! What cannot be exported, and what is odd but can.

use gdibl_export::{Engine, Error, Settings, export};
use serde_json::Value;
use std::f64::consts::PI;

use crate::readers::read;
use crate::volumes::{ENGINES, constant, exported, file, flat_grid, grid, points, vertices};

fn refused(volume: &gdibl_runtime::Volume, engine: Engine, name: &str, counts: Option<[u32; 3]>) -> Error {
    let settings = Settings { name: name.into(), counts };
    export(volume, engine, &settings).err().unwrap_or_else(|| panic!("{engine:?} took {name} {counts:?}"))
}

#[test]
fn points_go_into_json_and_nowhere_else() {
    let volume = points(&[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [2.0, 0.5, 3.0]]);
    for engine in ENGINES {
        if engine == Engine::Json {
            continue;
        }
        let Error::Unsupported(message) = refused(&volume, engine, "a.b", None) else { panic!("unsupported") };
        assert!(message.contains("points at 3 places") && message.contains("--to json"), "{message}");
    }
    let exported = exported(&volume, Engine::Json);
    let json: Value = serde_json::from_slice(file(&exported, "room.main")).unwrap();
    assert_eq!((&json["kind"], &json["counts"]), (&"points".into(), &serde_json::json!([3, 1, 1])));
    assert_eq!(json["positions"][2], serde_json::json!([1.0, 1.0, 5.0]));
    let l = json["radiance"][2][0][0].as_f64().unwrap() * f64::from(gdibl_runtime::sh::Y00);
    assert!((l - 3.0).abs() < 1e-5, "{l}");
    assert_eq!(exported.report.error.relative_rmse, 0.0);
    assert!(matches!(refused(&volume, Engine::Json, "a.b", Some([2, 2, 2])), Error::Settings(_)));
    assert_eq!(json.get("vertex_sets"), None);
}

#[test]
fn vertices_go_into_json_with_their_sets() {
    let positions = [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [2.0, 0.5, 3.0]];
    let volume = vertices(&positions, &[[0.0, 1.0, 0.0]; 3], &[[7, 2, 0, 0, 2], [7, 2, 1, 2, 1]]);
    let exported = exported(&volume, Engine::Json);
    let json: Value = serde_json::from_slice(file(&exported, "room.main")).unwrap();
    let set = |primitive: u32, first: u32, count: u32| serde_json::json!({ "node": 7, "mesh": 2, "primitive": primitive, "first": first, "count": count });
    assert_eq!(json["kind"], "vertices");
    assert_eq!(json["vertex_sets"], serde_json::json!([set(0, 0, 2), set(1, 2, 1)]));
}

#[test]
fn too_many_nodes_are_refused_with_what_to_do() {
    let volume = grid([2, 2, 2], 2, |_| constant([1.0; 3]));
    for (engine, counts) in [
        (Engine::Bevy, [2, 1025, 2]),
        (Engine::Bevy, [2, 2, 683]),
        (Engine::Three, [2, 2, 291]),
        (Engine::Godot, [41, 41, 41]),
        (Engine::Unity, [41, 41, 41]),
    ] {
        let Error::Unsupported(message) = refused(&volume, engine, "a.b", Some(counts)) else { panic!("unsupported") };
        assert!(message.contains("give fewer --counts"), "{message}");
    }
    for counts in [[0, 2, 2], [4096, 4096, 4096], [u32::MAX; 3]] {
        assert!(matches!(refused(&volume, Engine::Json, "a.b", Some(counts)), Error::Settings(_)));
    }
}

#[test]
fn light_that_half_floats_cannot_hold_is_refused() {
    let volume = grid([2, 2, 2], 2, |_| constant([1e5; 3]));
    let Error::Unsupported(message) = refused(&volume, Engine::Three, "a.b", None) else { panic!("unsupported") };
    assert!(message.contains("65504") && message.contains("--clamp"), "{message}");
}

/// Of 9 bits and a shared exponent, and of half floats, as Khronos' data format specification describes them.
#[test]
fn textures_describe_their_texels() {
    let volume = grid([3, 2, 4], 2, |_| constant([1.0; 3]));
    let export = exported(&volume, Engine::Bevy);
    for (name, bytes, samples) in [
        ("room.main", 4, &[(0, 9, 0, 0), (27, 5, 0, 2), (9, 9, 1, 0), (27, 5, 1, 2), (18, 9, 2, 0), (27, 5, 2, 2)][..]),
        ("room.rgba16f.ktx2", 8, &[(0, 16, 0, 12), (16, 16, 1, 12), (32, 16, 2, 12), (48, 16, 15, 12)]),
    ] {
        let reader = ktx2::Reader::new(file(&export, name)).unwrap();
        let header = reader.header();
        assert_eq!([header.pixel_width, header.pixel_height, header.pixel_depth], [3, 4, 12]);
        assert_eq!(header.type_size, if bytes == 4 { 4 } else { 2 });
        let [block] = &reader.dfd_blocks().collect::<Vec<_>>()[..] else { panic!("one block") };
        assert_eq!((block.header.vendor_id, block.header.descriptor_type), (0, 0));
        let basic = ktx2::DfdBlockBasic::parse(block.data).unwrap();
        assert_eq!(basic.header.bytes_planes, [bytes, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(basic.header.color_primaries, Some(ktx2::ColorPrimaries::BT709));
        assert_eq!(basic.header.transfer_function, Some(ktx2::TransferFunction::Linear));
        let found: Vec<_> = basic
            .sample_information()
            .map(|s| (s.bit_offset, s.bit_length.get(), s.channel_type, s.channel_type_qualifiers.bits()))
            .collect();
        assert_eq!(found, samples);
        let pairs: Vec<_> = reader.key_value_data().collect();
        assert!(pairs.iter().any(|(key, value)| *key == "KTXwriter" && value.starts_with(b"gdibl ")), "{pairs:?}");
    }
}

#[test]
fn files_that_would_share_a_name_are_refused() {
    let volume = grid([2, 2, 2], 2, |_| constant([1.0; 3]));
    for (engine, name) in
        [(Engine::Bevy, "room.json"), (Engine::Three, "gdibl-light-probe-grid.js"), (Engine::Unity, "GdiblImporter.cs")]
    {
        let Error::Settings(message) = refused(&volume, engine, name, None) else { panic!("settings") };
        assert!(message.contains(name), "{message}");
    }
}

#[test]
fn flat_volumes_become_solid_where_the_engine_wants_it() {
    let volume = flat_grid(constant([1.0, 2.0, 3.0]));
    for engine in [Engine::Bevy, Engine::Three, Engine::Godot, Engine::Unity] {
        let export = exported(&volume, engine);
        let solid = engine != Engine::Bevy;
        assert_eq!(export.report.counts, if solid { [3, 2, 2] } else { [3, 1, 2] });
        assert_eq!(export.report.notes.iter().any(|note| note.id == "flat-box"), solid);
        let lit = read(engine, &export);
        for height in [-0.4, 0.0, 0.4] {
            let e = lit([0.3, 0.5 + height, 4.0], [0.0, 0.6, 0.8]);
            for (e, l) in e.iter().zip([1.0, 2.0, 3.0]) {
                assert!((e / PI - l).abs() < 3e-3 * l, "{engine:?} {height}: {e}");
            }
        }
    }
}

#[test]
fn exports_are_the_same_bytes_every_time() {
    let volume = grid([3, 2, 2], 2, |p| constant([p[0].abs() as f32, 1.0, 2.0]));
    for engine in ENGINES {
        let (a, b) = (exported(&volume, engine), exported(&volume, engine));
        for (a, b) in a.files.iter().zip(&b.files) {
            assert!(a.name == b.name && a.bytes == b.bytes, "{engine:?}: {}", a.name);
        }
    }
}
