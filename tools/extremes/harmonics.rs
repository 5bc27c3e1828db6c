//! Spherical harmonics of deltas.

use crate::level::*;
use crate::table::Table;
use gdibl_baker::bake::{BakeSettings, Nodes};
use gdibl_baker::job::records::Records;
use gdibl_baker::pack::{PackSettings, Precision, pack};
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::sampling::fibonacci_sphere;
use gdibl_baker::scene::{PunctualKind, PunctualLight, Scene};
use gdibl_runtime::{RadianceSh, Volume, sh};
use glam::{DVec3, Vec3};
use std::f64::consts::PI;

pub fn rows(table: &mut Table) {
    let (mut off, mut least, mut kept) = (0.0f64, f64::INFINITY, true);
    let points = [DVec3::ZERO];
    let search = fibonacci_sphere(20_000);
    for toward in fibonacci_sphere(8) {
        for opposite in [0.0, 1.0] {
            let sun = |toward: Vec3, irradiance: f32| PunctualLight {
                name: String::new(),
                kind: PunctualKind::Directional,
                intensity: Vec3::splat(irradiance),
                range: f32::INFINITY,
                position: DVec3::ZERO,
                direction: -toward,
            };
            let scene = Scene { lights: vec![sun(toward, 20.0), sun(-toward, 20.0 * opposite)], ..Scene::default() };
            let sky = distant(panorama(4, |_| [0.01, 0.02, 0.03]));
            let path = Path::new(&scene, Some(&sky), PathSettings { bounces: Some(0), ..PathSettings::default() });
            for bands in 0..=4 {
                let baked = bake_points(&path, &points, &BakeSettings { bands, samples: 64, punctual: true, ..SMALL });
                let mut expected = RadianceSh::zero(bands);
                for (direction, irradiance) in [(toward, 20.0), (-toward, 20.0 * opposite)] {
                    let mut basis = [0.0; sh::MAX_COEFFICIENTS];
                    sh::basis(bands, direction.to_array(), &mut basis);
                    for (rgb, y) in expected.coefficients.iter_mut().zip(basis) {
                        rgb.iter_mut().for_each(|v| *v += irradiance * y);
                    }
                }
                for (v, sky) in expected.coefficients[0].iter_mut().zip([0.01, 0.02, 0.03]) {
                    *v += sky * (4.0 * PI).sqrt() as f32;
                }
                let raw = sh_of(&baked, 0);
                let errors = raw.coefficients.iter().flatten().zip(expected.coefficients.iter().flatten());
                off = off.max(errors.map(|(a, b)| f64::from((a - b).abs()) / 20.0).fold(0.0, f64::max));
                for precision in [Precision::F16, Precision::F32] {
                    let volume = |dering| {
                        let settings = PackSettings { precision, dering, ..PackSettings::default() };
                        let nodes = Nodes::Points(points.to_vec());
                        Volume::parse(&pack(&nodes, &baked, Records::default(), settings).bytes)
                            .expect("what was packed parses")
                    };
                    let (before, after) = (volume(false).node_sh(0), volume(true).node_sh(0));
                    kept &= before.coefficients[0] == after.coefficients[0];
                    let irradiance = after.convolve();
                    for normal in search.iter().copied().chain([toward, -toward]) {
                        for (c, e) in irradiance.evaluate(normal.to_array()).into_iter().enumerate() {
                            least = least.min(f64::from(e / (irradiance.coefficients[0][c] * sh::Y00)));
                        }
                    }
                }
            }
        }
    }
    let case = "delta light, alone and opposite another; 8 directions, L0 to L4";
    table.at_most(case, "projection off by, over the light's E:", 1e-6, off);
    table.row(
        "the same after opt-in de-ringing; f16, f32",
        "least E over 20 000 normals ≥ -1e-6 of its mean; L0 the same bits",
        &format!("{least:.1e}; L0 {}", if kept { "the same" } else { "CHANGED" }),
        least >= -1e-6 && kept,
    );
}
