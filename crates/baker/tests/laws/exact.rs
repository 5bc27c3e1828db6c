//! What a panorama's light comes to, without sampling.

use gdibl_baker::analyse::radiance_sh;
use gdibl_baker::panorama::Panorama;
use gdibl_runtime::{RadianceSh, sh};
use glam::DVec3;
use std::f64::consts::PI;

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
    let pixel = |x: usize, y: usize| panorama.pixel(x % width, y).to_array().map(f64::from);
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

/// Coefficients at `node`, in an empty box, of what pixel (x, y) of a probe in it shows beyond the rest of its image: a tent
/// of `radiance` over the four cells around the pixel's centre, as it lies on the walls. Midpoints of 64 × 64 parts of each
/// cell: L Y cosθ_node / d_node² dA, where dA = d_probe² / cosθ_probe dω.
pub fn pixel_on_walls(
    [min, max]: [DVec3; 2],
    probe: DVec3,
    width: usize,
    [x, y]: [usize; 2],
    radiance: f64,
    node: DVec3,
) -> RadianceSh {
    const PARTS: usize = 64;
    let height = width / 2;
    let mut sums = [0.0f64; 9];
    for part in 0..4 * PARTS * PARTS {
        // From -1 to 1 pixels off the centre.
        let [dx, dy] = [part % (2 * PARTS), part / (2 * PARTS)].map(|i| (i as f64 + 0.5) / PARTS as f64 - 1.0);
        let longitude = 2.0 * PI * (0.5 - (x as f64 + 0.5 + dx) / width as f64);
        let latitude = PI * (0.5 - (y as f64 + 0.5 + dy) / height as f64);
        let direction = DVec3::new(longitude.sin() * latitude.cos(), latitude.sin(), longitude.cos() * latitude.cos());
        let solid_angle = latitude.cos() * (2.0 * PI / width as f64) * (PI / height as f64) / (PARTS * PARTS) as f64;
        let wall = |axis: usize| {
            let wall = if direction[axis] > 0.0 { max[axis] } else { min[axis] };
            ((wall - probe[axis]) / direction[axis], axis)
        };
        let (distance, axis) =
            [wall(0), wall(1), wall(2)].into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).expect("three");
        let line = probe + direction * distance - node;
        let area = solid_angle * distance * distance / direction[axis].abs();
        let seen = area * (line[axis].abs() / line.length()) / line.length_squared();
        let light = radiance * (1.0 - dx.abs()) * (1.0 - dy.abs()) * seen;
        let mut basis = [0.0; sh::MAX_COEFFICIENTS];
        sh::basis(2, line.normalize().as_vec3().to_array(), &mut basis);
        sums.iter_mut().zip(basis).for_each(|(sum, y)| *sum += light * f64::from(y));
    }
    radiance_sh(2, sums.map(|v| [v as f32; 3]))
}
