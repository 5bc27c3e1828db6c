//! What must hold whatever the format.

use gdibl_export::bevy::{Format, voxels};
use gdibl_export::{Engine, SAMPLES, sample_normal, sample_position};
use gdibl_runtime::{RadianceSh, Volume};
use std::f64::consts::PI;

use crate::readers::{bevy, read, three, unity_polynomial, unity_probes};
use crate::volumes::{
    ENGINES, MAX, MIN, SIDES, constant, exported, file, from, grid, grid_with_filled, inside, normals, positions,
    truth, uneven,
};

/// Engines that light nothing outside their box.
fn ends_at_its_box(engine: Engine) -> bool {
    matches!(engine, Engine::Bevy | Engine::Three)
}

#[test]
fn constant_light_is_the_same_constant_everywhere() {
    let radiance = [0.25, 1.0, 3.0];
    let volume = grid([4, 3, 5], 2, |_| constant(radiance));
    for engine in ENGINES {
        let export = exported(&volume, engine);
        let lit = read(engine, &export);
        let mut outside = 0;
        for position in positions() {
            for normal in normals() {
                let e = lit(position, normal);
                // Half a cell beyond the nodes belongs to some boxes.
                if ends_at_its_box(engine) && !inside(position) && e == [0.0; 3] {
                    outside += 1;
                    continue;
                }
                // Godot clamps each weight by itself, so that beyond its points they add up to more than 1.
                let too_much = if engine == Engine::Godot && !inside(position) { e[1] / PI } else { 1.0 };
                assert!(too_much > 0.999, "{too_much}");
                for (e, l) in e.iter().zip(radiance) {
                    let l = too_much * f64::from(l);
                    assert!((e / PI - l).abs() < 2e-3 * l, "{engine:?} at {position:?} facing {normal:?}: {e} {l}");
                }
            }
        }
        assert_eq!(outside > 0, ends_at_its_box(engine), "{engine:?}: {outside} outside");
        assert!(export.report.error.relative_rmse < 1e-3, "{engine:?}: {:?}", export.report.error);
        assert_eq!(export.report.negative.share, 0.0);
    }
}

#[test]
fn light_from_one_side_arrives_at_that_side_only() {
    for (bright, direction) in SIDES.iter().enumerate() {
        let volume = grid([3, 4, 2], 2, |_| from(*direction, [1.0, 2.0, 0.5]));
        for engine in ENGINES {
            let lit = read(engine, &exported(&volume, engine));
            for position in positions().into_iter().filter(|&p| inside(p)).take(20) {
                for (side, normal) in SIDES.iter().enumerate() {
                    let e = lit(position, *normal);
                    for (e, colour) in e.iter().zip([1.0, 2.0, 0.5]) {
                        let e = e / colour;
                        let right = if side == bright { (0.9..1.25).contains(&e) } else { (-0.01..0.16).contains(&e) };
                        assert!(right, "{engine:?}: light from {bright}, side {side}: {e}");
                    }
                }
            }
        }
    }
}

/// All formats interpolate a linear field exactly, however they cut cells; three.js but near the faces of the box, beyond
/// which the field does not go on.
#[test]
fn light_that_grows_along_each_axis_is_found_where_it_is() {
    let field = |[x, y, z]: [f64; 3]| 10.0 + 0.5 * x + 1.1 * y + 0.3 * z;
    let counts = [9, 8, 10];
    let volume = grid(counts, 2, |p| constant([field(p) as f32, 1.0, 1.0]));
    for engine in ENGINES {
        let lit = read(engine, &exported(&volume, engine));
        let mut compared = 0;
        for position in positions() {
            let depth = |k: usize| {
                let spacing = (MAX[k] - MIN[k]) / f64::from(counts[k] - 1);
                (position[k] - MIN[k]).min(MAX[k] - position[k]) / spacing
            };
            let told = match engine {
                Engine::Three => (0..3).all(|k| depth(k) > 1.5),
                // Beyond its points, clamped weights.
                Engine::Godot => inside(position),
                Engine::Bevy => (0..3).all(|k| depth(k) > -0.5),
                _ => true,
            };
            if !told {
                continue;
            }
            compared += 1;
            let e = lit(position, [0.48, -0.6, 0.64])[0] / PI;
            let expected = field(std::array::from_fn(|k| position[k].clamp(MIN[k], MAX[k])));
            assert!((e - expected).abs() < 2e-3 * expected, "{engine:?} at {position:?}: {e}, not {expected}");
        }
        assert!(compared > 25, "{engine:?}: {compared}");
    }
}

#[test]
fn unity_polynomial_gives_e_over_pi_within_1e_5() {
    let volume = grid([3, 2, 4], 2, uneven);
    let export = exported(&volume, Engine::Unity);
    let probes = unity_probes(file(&export, "room.main"));
    assert_eq!(probes.len(), volume.node_count());
    for (node, (position, coefficients)) in probes.iter().enumerate() {
        let [x, y, z] = volume.node_position(node);
        assert!((position[0] + x).abs() + (position[1] - y).abs() + (position[2] - z).abs() < 1e-6);
        for normal in normals() {
            let e = volume.node_sh(node).convolve().evaluate(normal);
            let [x, y, z] = normal.map(f64::from);
            for (c, e) in coefficients.iter().zip(e) {
                let found = unity_polynomial(c, [-x, y, z]);
                assert!((found - f64::from(e) / PI).abs() < 1e-5, "{found} {e}");
            }
        }
    }
}

#[test]
fn three_formula_gives_e_of_all_nine_coefficients() {
    // The same everywhere, so that the shader's step along the normal does not matter.
    let light = uneven([0.3, 0.2, 0.1]);
    let volume = grid([3, 2, 4], 2, |_| light);
    let lit = three(file(&exported(&volume, Engine::Three), "room.main"));
    for position in positions().into_iter().filter(|&p| inside(p)).take(50) {
        for normal in normals() {
            for (found, e) in lit(position, normal).iter().zip(light.convolve().evaluate(normal)) {
                assert!((found - f64::from(e)).abs() < 1e-3 * f64::from(e), "{found} {e}");
            }
        }
    }
}

#[test]
fn undoing_the_step_of_three_along_the_normal_halves_the_error() {
    let slow = |[x, y, z]: [f64; 3]| uneven([0.5 * x, 0.1 * y, 0.5 * z]);
    let export = exported(&grid([9, 7, 13], 2, slow), Engine::Three);
    let [undone, plain] = &export.report.variants[..] else { panic!("{:?}", export.report.variants) };
    assert!(undone.written && !plain.written);
    assert!(undone.error.relative_rmse < 0.5 * plain.error.relative_rmse, "{undone:?} {plain:?}");
    assert_eq!(undone.error, export.report.error);
}

/// The report's figure is what a second reader measures.
#[test]
fn reported_error_is_that_of_what_was_written() {
    let volume = grid([5, 4, 6], 2, uneven);
    for engine in ENGINES {
        let export = exported(&volume, engine);
        let measured = measure(&volume, read(engine, &export));
        let reported = export.report.error.relative_rmse;
        assert!((measured - reported).abs() < 1e-4 + 1e-3 * reported, "{engine:?}: {measured}, reported {reported}");
        let expected = match engine {
            Engine::Exr | Engine::Json => 0.0..1e-5,
            Engine::Bevy => 0.01..0.2,
            _ => 1e-4..0.2,
        };
        assert!(expected.contains(&reported), "{engine:?}: {reported}");
    }
}

fn measure(volume: &Volume, lit: impl Fn([f64; 3], [f32; 3]) -> [f64; 3]) -> f64 {
    let (mut error, mut light) = (0.0, 0.0);
    for i in 0..SAMPLES {
        let (position, normal) = (sample_position(MIN, MAX, i), sample_normal(i));
        let (found, truth) = (lit(position, normal), truth(volume, position, normal));
        for c in 0..3 {
            error += (found[c] - truth[c].max(0.0)).powi(2);
            light += truth[c].max(0.0).powi(2);
        }
    }
    (error / light).sqrt()
}

#[test]
fn both_textures_for_bevy_hold_the_better_of_two_fits() {
    let volume = grid([3, 3, 3], 2, |_| from([0.6, 0.64, 0.48], [1.0, 2.0, 3.0]));
    let export = exported(&volume, Engine::Bevy);
    let variants = &export.report.variants;
    assert_eq!(variants.len(), 4);
    let best = variants.iter().map(|v| v.error.relative_rmse).fold(f64::MAX, f64::min);
    let worst = variants.iter().map(|v| v.error.relative_rmse).fold(0.0, f64::max);
    assert!(worst > 1.01 * best, "fits differ: {variants:?}");
    assert_eq!(variants.iter().filter(|v| v.written).count(), 2);
    assert!(variants.iter().filter(|v| v.written).all(|v| v.error.relative_rmse < 1.01 * best), "{variants:?}");
    for name in ["room.main", "room.rgba16f.ktx2"] {
        let measured = measure(&volume, bevy(&export, name));
        assert!((measured - best).abs() < 0.01 * best, "{name}: {measured} {best}");
    }
    // A light at 45 degrees would make a side negative.
    let spawn = String::from_utf8(file(&export, "room.json").to_vec()).unwrap();
    assert!(spawn.contains("voxels: asset_server.load(\\\"room.main\\\"), intensity: 1.0"), "{spawn}");
}

#[test]
fn voxels_are_what_is_exported_to_bevy() {
    let volume = grid([4, 3, 2], 2, uneven);
    let export = exported(&volume, Engine::Bevy);
    let sidecar: serde_json::Value = serde_json::from_slice(file(&export, "room.json")).unwrap();
    for (name, format) in [("room.main", Format::Rgb9e5), ("room.rgba16f.ktx2", Format::Rgba16f)] {
        let voxels = voxels(&volume, None, format).unwrap();
        assert_eq!((voxels.counts, voxels.size), ([4, 3, 2], [4, 6, 6]));
        let texels = 4 * 6 * 6 * if format == Format::Rgb9e5 { 4 } else { 8 };
        assert_eq!(voxels.bytes.len(), texels);
        assert!(file(&export, name).ends_with(&voxels.bytes), "{name}");
        assert_eq!(sidecar["intensity"].as_f64(), Some(f64::from(voxels.intensity)));
        let number = |key: &str, axis: usize| sidecar[key][axis].as_f64().unwrap();
        for axis in 0..3 {
            assert!((number("translation", axis) - voxels.translation[axis]).abs() < 1e-6, "{sidecar}");
            assert!((number("scale", axis) - voxels.scale[axis]).abs() < 1e-6, "{sidecar}");
        }
        let (position, normal) = ([0.2, 1.1, 3.9], [0.6, -0.48, 0.64]);
        let (formula, read) = (voxels.irradiance(position, normal), bevy(&export, name)(position, normal));
        for c in 0..3 {
            assert!((formula[c] - read[c]).abs() < 1e-5 * read[c].abs(), "{name}: {formula:?} {read:?}");
        }
    }
}

#[test]
fn very_bright_and_very_dark_light_keeps_its_precision_in_bevy() {
    for brightness in [1e-7, 3e-3, 1e6] {
        let volume = grid([2, 2, 2], 2, |_| constant([brightness, 0.5 * brightness, brightness]));
        let export = exported(&volume, Engine::Bevy);
        for name in ["room.main", "room.rgba16f.ktx2"] {
            let e = bevy(&export, name)([0.0, 1.0, 4.0], [0.6, 0.0, 0.8]);
            for (e, share) in e.iter().zip([1.0, 0.5, 1.0]) {
                let l = share * f64::from(brightness);
                assert!((e / PI - l).abs() < 5e-3 * l, "{name}: {e} {l}");
            }
        }
    }
}

#[test]
fn low_bands_are_padded_and_high_ones_left_out() {
    let many = |bands: u32| {
        grid([3, 3, 2], bands, |p| {
            let mut sh = uneven(p);
            sh.bands = bands;
            for (i, coefficient) in sh.coefficients.iter_mut().enumerate() {
                let keep = i < ((bands + 1) * (bands + 1)) as usize;
                *coefficient = if !keep {
                    [0.0; 3]
                } else if i >= 9 {
                    [0.3, 0.2, 0.1]
                } else {
                    *coefficient
                };
            }
            sh
        })
    };
    for bands in [0, 1, 3, 4] {
        let volume = many(bands);
        for engine in [Engine::Three, Engine::Godot, Engine::Unity] {
            let export = exported(&volume, engine);
            let note = export.report.notes.iter().find(|note| note.id == "bands").expect("said");
            assert_eq!(note.message.contains("band 4"), bands == 4, "{}", note.message);
            assert_eq!(note.message.contains("no part in irradiance"), bands > 2);
            // At a node nothing but the bands can differ; three.js reads elsewhere.
            if engine == Engine::Three {
                continue;
            }
            let lit = read(engine, &export);
            for normal in normals() {
                let position = volume.node_position(5);
                let e = volume.node_sh(5).truncate(2).convolve().evaluate(normal);
                for (found, e) in lit(position, normal).iter().zip(e) {
                    assert!((found - f64::from(e)).abs() < 1e-4, "{engine:?} L{bands}: {found} {e}");
                }
            }
        }
    }
}

#[test]
fn irradiance_below_zero_is_counted_and_clamped_where_the_shader_clamps() {
    // Much from +y, less than nothing from the horizon: L2 of a small lamp less its band 0.
    let lamp = || {
        let mut sh = from([0.0, 1.0, 0.0], [1.0; 3]);
        sh.coefficients[0] = sh.coefficients[0].map(|c| 0.6 * c);
        sh
    };
    let volume = grid([2, 2, 2], 2, |_| lamp());
    let side = [0.8, 0.0, 0.6];
    let e = truth(&volume, [0.0, 1.0, 3.0], side)[0];
    assert!(e < -1e-3, "{e}");
    for engine in ENGINES {
        let export = exported(&volume, engine);
        assert!(export.report.negative.share > 0.1 && export.report.negative.least < 0.0);
        let found = read(engine, &export)([0.0, 1.0, 3.0], side)[0];
        if engine == Engine::Godot {
            assert!((found - e).abs() < 1e-5, "{found} {e}");
            assert!(export.report.negative.engine.contains("not clamped"));
        } else {
            assert!(found >= 0.0, "{engine:?}: {found}");
        }
    }
}

#[test]
fn filled_nodes_are_told_and_counts_resample() {
    let volume = grid_with_filled([4, 3, 3], 7, uneven);
    let export = exported(&volume, Engine::Exr);
    assert!(export.report.notes.iter().any(|n| n.id == "filled-nodes" && n.message.starts_with("1 nodes")));
    assert!(export.report.error.relative_rmse > 1e-4, "what the runtime leaves out, this reader takes");

    let volume = grid([4, 3, 3], 2, uneven);
    for (counts, exact) in [([7, 5, 5], true), ([3, 2, 4], false)] {
        let settings = gdibl_export::Settings { name: "room.main".into(), counts: Some(counts) };
        let export = gdibl_export::export(&volume, Engine::Json, &settings).unwrap();
        assert_eq!(export.report.counts, counts);
        // Twice as fine holds all old nodes; others cut corners.
        let error = export.report.error.relative_rmse;
        assert_eq!(error < 1e-5, exact, "{counts:?}: {error}");
        let lit = read(Engine::Json, &export);
        let e = lit(MIN, [0.0, 1.0, 0.0])[0];
        assert!((e - truth(&volume, MIN, [0.0, 1.0, 0.0])[0]).abs() < 1e-4);
    }
}

#[test]
fn darkness_is_exported_as_darkness() {
    let volume = grid([2, 2, 2], 2, |_| RadianceSh::zero(2));
    for engine in ENGINES {
        let export = exported(&volume, engine);
        assert_eq!(export.report.error.relative_rmse, 0.0);
        assert_eq!(read(engine, &export)([0.0, 1.0, 3.0], [0.0, 1.0, 0.0]), [0.0; 3]);
    }
}
