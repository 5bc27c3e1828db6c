//! De-ringing of whole volumes: lights of known coefficients, baked, packed and read again.

use gdibl_baker::bake::{BakeSettings, Nodes};
use gdibl_baker::pack::{PackSettings, Precision, pack};
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::sampling::{Sampler, Stream, fibonacci_sphere, uniform_sphere};
use gdibl_baker::scene::{PunctualKind, PunctualLight, Role, Scene};
use gdibl_runtime::{IrradianceSh, Volume, sh};
use glam::{DVec3, Vec3};
use std::f64::consts::PI;

use crate::level::*;
use gdibl_baker::job::records::Records;

fn sun(toward: Vec3, irradiance: f32) -> PunctualLight {
    PunctualLight {
        name: String::new(),
        kind: PunctualKind::Directional,
        intensity: Vec3::new(1.0, 0.9, 0.5) * irradiance,
        range: f32::INFINITY,
        position: DVec3::ZERO,
        direction: -toward,
    }
}

/// Legendre's P_l.
fn legendre(l: usize, x: f64) -> f64 {
    match l {
        0 => 1.0,
        1 => x,
        _ => ((2 * l - 1) as f64 * x * legendre(l - 1, x) - (l - 1) as f64 * legendre(l - 2, x)) / l as f64,
    }
}

fn baked_of(scene: &Scene, bands: u32, points: &[DVec3]) -> gdibl_baker::bake::Baked {
    let sky = distant(panorama(4, |_| [0.01, 0.02, 0.03]));
    let path = Path::new(scene, Some(&sky), PathSettings { bounces: Some(0), ..PathSettings::default() });
    bake_points(&path, points, &BakeSettings { bands, samples: 64, punctual: true, ..BakeSettings::default() })
}

fn volume_of(baked: &gdibl_baker::bake::Baked, points: &[DVec3], precision: Precision, dering: bool) -> Volume {
    let settings = PackSettings { precision, dering, ..PackSettings::default() };
    let packed = pack(&Nodes::Points(points.to_vec()), baked, Records::default(), settings);
    Volume::parse(&packed.bytes).expect("what was packed parses")
}

/// The least irradiance of `count` normals and both lights' sides, relative to the channel's mean.
fn least(irradiance: &IrradianceSh, count: u32, toward: Vec3) -> f32 {
    let stream = Stream::new(Sampler::Random, 5, 0, 0);
    let normals = (0..count).map(|i| uniform_sphere(stream.point(i, 0))).chain([toward, -toward]);
    let relative = |n: Vec3| {
        let e = irradiance.evaluate(n.to_array());
        (0..3).map(|c| e[c] / (irradiance.coefficients[0][c] * sh::Y00)).fold(f32::INFINITY, f32::min)
    };
    normals.map(relative).fold(f32::INFINITY, f32::min)
}

#[test]
fn delta_lights_are_projected_exactly_and_deringed_to_no_negative_irradiance() {
    // One light, and two opposite ones, 100 times and more above the sky, from everywhere. Black panels hide
    // them from the second point.
    let points = [DVec3::ZERO, DVec3::new(50.0, 0.0, 0.0)];
    for (number, toward) in fibonacci_sphere(12).into_iter().enumerate() {
        for opposite in [0.0, 1.0, 0.4] {
            let mut scene = Scene::default();
            let (u, v) = toward.as_dvec3().any_orthonormal_pair();
            for side in [-2.0, 2.0] {
                let corner = |a: f64, b: f64| points[1] + toward.as_dvec3() * side + u * a + v * b;
                add(&mut scene, Role::Environment, &[[corner(-3.0, -1.0), corner(3.0, -1.0), corner(0.0, 3.0)]]);
            }
            scene.materials[0].base_color = Vec3::ZERO.extend(1.0);
            scene.lights = vec![sun(toward, 20.0), sun(-toward, 20.0 * opposite)];
            for bands in 0..=4 {
                let baked = baked_of(&scene, bands, &points);
                // The addition theorem: Σ_m L_lm Y_lm(n) = E (2l + 1)/4π P_l(ω·n).
                let node = sh_of(&baked, 0);
                for n in fibonacci_sphere(30) {
                    let cosine = f64::from(toward.dot(n));
                    for (c, colour) in [1.0f64, 0.9, 0.5].into_iter().enumerate() {
                        let band = |l: usize| {
                            let both = legendre(l, cosine) + opposite as f64 * legendre(l, -cosine);
                            20.0 * colour * both * (2 * l + 1) as f64 / (4.0 * PI)
                        };
                        let sky = [0.01, 0.02, 0.03][c];
                        let truth = sky + (0..=bands as usize).map(band).sum::<f64>();
                        let found = f64::from(node.evaluate(n.to_array())[c]);
                        assert!((found - truth).abs() < 2e-5 * 20.0, "L{bands}: {found}, {truth}");
                    }
                }
                // One light rings at L1 and L2; at L0 nothing can.
                let rings = least(&node.convolve(), 2000, toward) < -1e-6;
                assert!(rings || bands == 0 || opposite > 0.0, "L{bands}, light {number}");
                for precision in [Precision::F16, Precision::F32] {
                    let raw = volume_of(&baked, &points, precision, false);
                    let kept = volume_of(&baked, &points, precision, true);
                    assert_eq!(kept.header().is_deringed(), rings);
                    let (before, after) = (raw.node_sh(0), kept.node_sh(0));
                    assert_eq!(before.coefficients[0], after.coefficients[0], "band 0 stays to the bit");
                    assert_eq!(before != after, rings);
                    // One in twelve by 100 000 normals, the others by fewer.
                    let count = if number == 0 { 100_000 } else { 2000 };
                    let least = least(&after.convolve(), count, toward);
                    assert!(least >= -1e-6, "L{bands} {opposite} {precision:?}: {least}");
                    // No more than rounding was given away.
                    assert!(!rings || least < 0.02, "L{bands} {opposite} {precision:?}: {least}");
                    assert_eq!(raw.node_sh(1), kept.node_sh(1), "a node that does not ring");
                }
            }
        }
    }
}

#[test]
fn where_no_node_rings_deringing_leaves_the_light_and_its_tag() {
    let points = [DVec3::ZERO];
    let baked = baked_of(&Scene::default(), 4, &points);
    let settings = PackSettings { precision: Precision::F16, dering: true, ..PackSettings::default() };
    let packed = pack(&Nodes::Points(points.to_vec()), &baked, Records::default(), settings);
    assert_eq!(packed.records.statistics.unwrap().deringing, None);
    let row = packed.records.plan.last().unwrap();
    assert_eq!((row.stage.as_str(), row.kept, row.why.as_str()), ("deringing", false, "no node rings"));
    let volume = Volume::parse(&packed.bytes).unwrap();
    assert!(!volume.header().is_deringed());
    assert_eq!(volume.node_sh(0), volume_of(&baked, &points, Precision::F16, false).node_sh(0));
}
