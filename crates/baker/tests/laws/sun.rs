//! A sun in one pixel, anywhere: found by construction, not by luck.

use gdibl_baker::analyse::{IrradianceError, Light, Pair, radiance_sh};
use gdibl_baker::bake::BakeSettings;
use gdibl_baker::panorama::Panorama;
use gdibl_baker::scene::Scene;
use gdibl_runtime::{RadianceSh, sh};
use glam::DVec3;
use std::f64::consts::PI;

use crate::level::*;

/// Gauss and Legendre's points and weights on 0..1, exact to degree 7.
const GAUSS: [(f64, f64); 4] = [
    (0.069_431_844_202_973_71, 0.173_927_422_568_726_93),
    (0.330_009_478_207_571_87, 0.326_072_577_431_273_07),
    (0.669_990_521_792_428_1, 0.326_072_577_431_273_07),
    (0.930_568_155_797_026_3, 0.173_927_422_568_726_93),
];

/// ∫ L Y_lm of a panorama as it is reconstructed: bilinear between pixel centres, u wraps, v clamps. Each cell between
/// four centres (half a cell above the first and below the last row) by Gauss' rule, in f64.
pub fn exact_sh(panorama: &Panorama, bands: u32) -> RadianceSh {
    let (width, height) = (panorama.width(), panorama.height());
    let pixel = |x: usize, y: usize| panorama.pixels()[y * width + x % width].map(f64::from);
    let mut sums = [[0.0f64; 3]; sh::MAX_COEFFICIENTS];
    for row in 0..=height {
        let (upper, lower) = (row.max(1) - 1, row.min(height - 1));
        // v of the cell's edges, and how bilinear weights run in it.
        let top = if row == 0 { 0.0 } else { (row as f64 - 0.5) / height as f64 };
        let bottom = if row == height { 1.0 } else { (row as f64 + 0.5) / height as f64 };
        for column in 0..width {
            let [a, b, c, d] =
                [(column, upper), (column + 1, upper), (column, lower), (column + 1, lower)].map(|(x, y)| pixel(x, y));
            for (ty, wy) in GAUSS {
                let latitude = PI * (0.5 - (top + (bottom - top) * ty));
                for (tx, wx) in GAUSS {
                    let longitude = 2.0 * PI * (0.5 - (column as f64 + 0.5 + tx) / width as f64);
                    let direction =
                        DVec3::new(longitude.sin() * latitude.cos(), latitude.sin(), longitude.cos() * latitude.cos());
                    let area = wx * wy * (2.0 * PI / width as f64) * PI * (bottom - top) * latitude.cos();
                    let mut basis = [0.0; sh::MAX_COEFFICIENTS];
                    sh::basis(bands, direction.as_vec3().to_array(), &mut basis);
                    for channel in 0..3 {
                        let upper = a[channel] * (1.0 - tx) + b[channel] * tx;
                        let lower = c[channel] * (1.0 - tx) + d[channel] * tx;
                        let light = area * (upper * (1.0 - ty) + lower * ty);
                        for (sum, y) in sums.iter_mut().zip(basis) {
                            sum[channel] += light * f64::from(y);
                        }
                    }
                }
            }
        }
    }
    radiance_sh(bands, sums[..sh::coefficient_count(bands)].iter().map(|rgb| rgb.map(|v| v as f32)))
}

#[test]
fn exact_integral_of_known_light_is_exact() {
    let white = exact_sh(&panorama(16, |_| [1.0, 2.0, 3.0]), 4).coefficients;
    for (i, rgb) in white.iter().enumerate() {
        for (c, value) in rgb.iter().enumerate() {
            let expected = if i == 0 { (4.0 * PI).sqrt() * (c + 1) as f64 } else { 0.0 };
            assert!((f64::from(*value) - expected).abs() < 1e-5, "{i} {c}: {value}");
        }
    }
}

#[test]
fn sun_in_one_pixel_is_found_wherever_it_stands() {
    let scene = Scene::default();
    let nodes = [DVec3::ZERO; 24];
    let mut table = Vec::new();
    for width in [64, 512] {
        let height = width / 2;
        for (place, x, y) in [
            ("middle", width / 3, height / 3),
            ("horizon", width / 2, height / 2),
            ("north pole", 5, 0),
            ("south pole", width / 2, height - 1),
            ("seam, left", 0, height / 2),
            ("seam, right", width - 1, height / 4),
        ] {
            for sun in [1e5, 1e9] {
                let mut image = panorama(width, |d| [1.0 + d.y, 1.0, 1.2 + d.x * d.z]);
                image.pixels_mut()[y * width + x] = [sun, 0.9 * sun, 0.7 * sun];
                let truth = exact_sh(&image, 2);
                let sky = distant(image);
                let function = gdibl(&scene, &[], Some(&sky));
                for (samples, bound) in [(1024, 0.015), (2048, 0.01)] {
                    let baked = bake_points(&function, &nodes, &BakeSettings { samples, ..SMALL });
                    let pair =
                        |node| Pair { found: sh_of(&baked, node), truth: Light::Radiance(truth), variance: None };
                    let error = IrradianceError::of(&(0..nodes.len()).map(pair).collect::<Vec<_>>());
                    table.push((error.per_node.max, error.relative_rmse, samples));
                    let case = format!("{place}, {width} wide, sun {sun:e}, {samples} samples");
                    println!("{case}: {:.2e} rms, {:.2e} worst of 24", error.relative_rmse, error.per_node.max);
                    assert!(error.relative_rmse <= bound, "{case}: {:.4}", error.per_node.max);
                }
            }
        }
    }
    for of in [1024, 2048] {
        let worst = table.iter().filter(|t| t.2 == of).fold((0.0f64, 0.0f64), |m, t| (m.0.max(t.0), m.1.max(t.1)));
        println!("{of} samples: worst node {:.2e}, worst rms {:.2e}", worst.0, worst.1);
    }
}
