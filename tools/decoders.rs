//! Ways to keep the irradiance at one place in few numbers, and to read it back for a normal.
//!
//! Each decoder is given all there is to know ([`Light`]: radiance to L4 and irradiance in many normals), keeps
//! [`Decoder::numbers`] of it, and answers with the irradiance in the same normals. What is fitted is fitted in those
//! normals, uniformly over the sphere.
//!
//! A linear decode of L1 or L2 has no fit to gain by: the basis is orthonormal, so that truncation *is* the least
//! squares fit to E over the sphere. Only a non-linear decode, or a bound such as E >= 0, has a better one.
//!
//! Based on: G. McTaggart, "Half-Life 2 / Valve Source Shading" (2004), for the ambient cube; G. Hazel,
//! "Reconstructing diffuse lighting from spherical harmonic data" (2018); T. Roughton, P.-P. Sloan, A. Silvennoinen,
//! M. Iwanicki and P. Shirley, "ZH3: Quadratic Zonal Harmonics" (2024), for an L2 of one axis, and its guess from L1.

use crate::least_squares::{minimise, solve, solve_non_negative};
use gdibl_baker::sampling::fibonacci_sphere;
use gdibl_runtime::RadianceSh;
use gdibl_runtime::sh::{COSINE, MAX_BANDS, MAX_COEFFICIENTS, band_of, basis, coefficient_count};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Directions evenly over the sphere, and the basis functions in them.
pub struct Normals {
    /// Unit length.
    pub directions: Vec<[f64; 3]>,
    /// A_l Y_lm per direction: times radiance coefficients, E.
    kernels: Vec<[f64; MAX_COEFFICIENTS]>,
    /// Of Y_lm to L2 per pair of directions, their product.
    products: Vec<f64>,
}

impl Normals {
    /// `count` of them.
    pub fn new(count: usize) -> Normals {
        let directions: Vec<[f64; 3]> =
            fibonacci_sphere(count).iter().map(|d| d.as_dvec3().normalize().to_array()).collect();
        let kernels: Vec<[f64; MAX_COEFFICIENTS]> = directions.iter().map(|&d| kernel(d)).collect();
        let l2 = |k: &[f64; MAX_COEFFICIENTS]| -> [f64; 9] { std::array::from_fn(|i| k[i] / cosine(i)) };
        let rows: Vec<[f64; 9]> = kernels.iter().map(l2).collect();
        let products = rows.iter().flat_map(|a| rows.iter().map(move |b| dot(a, b))).collect();
        Normals { directions, kernels, products }
    }
}

/// The light at one place, per channel.
pub struct Light {
    /// Radiance to L4.
    pub radiance: [[f64; MAX_COEFFICIENTS]; 3],
    /// E in each of the normals: the truth.
    pub irradiance: [Vec<f64>; 3],
    /// E along +x, +y, +z, -x, -y, -z.
    pub axes: [[f64; 6]; 3],
}

/// The directions of [`Light::axes`].
pub const AXES: [[f64; 3]; 6] =
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]];

impl Light {
    /// Of radiance arriving as `(direction, radiance times solid angle)`: E by direct integration.
    pub fn of_samples(samples: &[([f64; 3], [f64; 3])], normals: &Normals) -> Light {
        let mut radiance = [[0.0; MAX_COEFFICIENTS]; 3];
        for &(direction, power) in samples {
            let values = kernel(direction);
            for (c, sums) in radiance.iter_mut().enumerate() {
                (0..MAX_COEFFICIENTS)
                    .filter(|&i| band_of(i) != 3)
                    .for_each(|i| sums[i] += power[c] * values[i] / cosine(i));
            }
        }
        // E(n) = Σ L max(n·ω, 0) Δω
        let integrate = |normal: &[f64; 3]| {
            let mut sum = [0.0; 3];
            for (direction, power) in samples {
                let weight = dot(normal, direction).max(0.0);
                (0..3).for_each(|c| sum[c] += weight * power[c]);
            }
            sum
        };
        let irradiance: Vec<[f64; 3]> = normals.directions.par_iter().map(integrate).collect();
        let axes: Vec<[f64; 3]> = AXES.par_iter().map(integrate).collect();
        Light {
            radiance,
            irradiance: std::array::from_fn(|c| irradiance.iter().map(|e| e[c]).collect()),
            axes: std::array::from_fn(|c| std::array::from_fn(|k| axes[k][c])),
        }
    }

    /// Of coefficients: E is what they say.
    pub fn of_sh(sh: &RadianceSh, normals: &Normals) -> Light {
        let radiance: [[f64; MAX_COEFFICIENTS]; 3] =
            std::array::from_fn(|c| std::array::from_fn(|i| f64::from(sh.coefficients[i][c])));
        let axes = AXES.map(kernel);
        Light {
            irradiance: radiance.map(|channel| linear(&channel, MAX_BANDS, normals)),
            axes: radiance.map(|channel| std::array::from_fn(|k| dot(&axes[k], &channel))),
            radiance,
        }
    }
}

/// What to keep, and how to read it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decoder {
    /// One colour for all normals.
    L0,
    /// E = Σ n_k² E_k over the three axes that the normal leans to; E_k as it is along the axis.
    CubeAtAxes,
    /// The same, E_k fitted.
    CubeFitted,
    /// The same, E_k fitted and >= 0.
    CubeNonNegative,
    /// L1, linear.
    L1,
    /// L1, linear, negative E cut off.
    L1Clamped,
    /// L1 read by [`RadianceSh::irradiance_l1_nonlinear`].
    L1Nonlinear,
    /// The same, with coefficients for which that is closest to E.
    L1NonlinearFitted,
    /// L1, and a zonal L2 about its direction, guessed from it.
    Zh3Guessed,
    /// L1, and the part of L2 that is zonal about its direction: one more number per channel.
    Zh3,
    /// The same, all numbers fitted.
    Zh3Fitted,
    /// L2, linear.
    L2,
    /// The L2 nearest to it that is nowhere negative.
    L2NonNegative,
    /// L4, linear.
    L4,
}

impl Decoder {
    /// Each.
    pub const ALL: [Decoder; 14] = [
        Decoder::L0,
        Decoder::CubeAtAxes,
        Decoder::CubeFitted,
        Decoder::CubeNonNegative,
        Decoder::L1,
        Decoder::L1Clamped,
        Decoder::L1Nonlinear,
        Decoder::L1NonlinearFitted,
        Decoder::Zh3Guessed,
        Decoder::Zh3,
        Decoder::Zh3Fitted,
        Decoder::L2,
        Decoder::L2NonNegative,
        Decoder::L4,
    ];

    /// For a table.
    pub fn name(self) -> &'static str {
        match self {
            Decoder::L0 => "L0",
            Decoder::CubeAtAxes => "ambient cube, E at 6 axes",
            Decoder::CubeFitted => "ambient cube, least squares",
            Decoder::CubeNonNegative => "ambient cube, non-negative",
            Decoder::L1 => "L1 linear",
            Decoder::L1Clamped => "L1 linear, clamped",
            Decoder::L1Nonlinear => "L1 non-linear",
            Decoder::L1NonlinearFitted => "L1 non-linear, fitted",
            Decoder::Zh3Guessed => "ZH3 guessed from L1",
            Decoder::Zh3 => "ZH3",
            Decoder::Zh3Fitted => "ZH3, fitted",
            Decoder::L2 => "L2 linear",
            Decoder::L2NonNegative => "L2 non-negative",
            Decoder::L4 => "L4 linear",
        }
    }

    /// How many are kept for the three channels.
    pub fn numbers(self) -> usize {
        match self {
            Decoder::L0 => 3,
            Decoder::CubeAtAxes | Decoder::CubeFitted | Decoder::CubeNonNegative => 18,
            Decoder::L1 | Decoder::L1Clamped | Decoder::L1Nonlinear | Decoder::L1NonlinearFitted => 12,
            Decoder::Zh3Guessed => 12,
            Decoder::Zh3 | Decoder::Zh3Fitted => 15,
            Decoder::L2 | Decoder::L2NonNegative => 27,
            Decoder::L4 => 75,
        }
    }

    /// E per channel and normal.
    pub fn decode(self, light: &Light, normals: &Normals) -> [Vec<f64>; 3] {
        let per_channel = |f: &dyn Fn(usize) -> Vec<f64>| std::array::from_fn(f);
        let bands = |bands| light.radiance.map(|channel| linear(&channel, bands, normals));
        match self {
            Decoder::L0 => bands(0),
            Decoder::CubeAtAxes => light.axes.map(|axes| ambient_cube(&axes, normals)),
            Decoder::CubeFitted => {
                per_channel(&|c| ambient_cube(&fit_cube(&light.irradiance[c], normals, false), normals))
            }
            Decoder::CubeNonNegative => {
                per_channel(&|c| ambient_cube(&fit_cube(&light.irradiance[c], normals, true), normals))
            }
            Decoder::L1 => bands(1),
            Decoder::L1Clamped => bands(1).map(|e| e.iter().map(|v| v.max(0.0)).collect()),
            Decoder::L1Nonlinear => light.radiance.map(|channel| nonlinear(&channel[..4], normals)),
            Decoder::L1NonlinearFitted => per_channel(&|c| {
                let fitted = fit_nonlinear(&light.radiance[c][..4], &light.irradiance[c], normals);
                nonlinear(&fitted, normals)
            }),
            Decoder::Zh3Guessed => zh3(&with_zonal(light, guess_zonal), normals),
            Decoder::Zh3 => zh3(&with_zonal(light, project_zonal), normals),
            Decoder::Zh3Fitted => zh3(&fit_zh3(light, normals), normals),
            Decoder::L2 => bands(2),
            Decoder::L2NonNegative => light.radiance.map(|channel| non_negative_l2(&channel, normals)),
            Decoder::L4 => bands(4),
        }
    }
}

/// How far off E is.
#[derive(Clone, Copy, Debug)]
pub struct Score {
    /// sqrt(Σ (v - r)² / Σ r²) over normals and channels.
    pub relative_rmse: f64,
    /// Mean of |v - r| / (|v| + |r|).
    pub smape: f64,
    /// The least E of any normal and channel, in means of the channel.
    pub lowest: f64,
}

impl Score {
    /// Of `found` against the truth. Of darkness 0 where it was found, infinite else.
    pub fn of(found: &[Vec<f64>; 3], truth: &[Vec<f64>; 3]) -> Score {
        let pairs = || found.iter().flatten().zip(truth.iter().flatten()).map(|(&v, &r)| (v, r));
        let error: f64 = pairs().map(|(v, r)| (v - r).powi(2)).sum();
        let power: f64 = pairs().map(|(_, r)| r * r).sum();
        let share = |(v, r): (f64, f64)| if v == r { 0.0 } else { (v - r).abs() / (v.abs() + r.abs()) };
        let lowest = found.iter().zip(truth).map(|(v, r)| {
            let mean = r.iter().sum::<f64>() / r.len() as f64;
            v.iter().copied().fold(f64::INFINITY, f64::min) / mean.max(f64::MIN_POSITIVE)
        });
        Score {
            relative_rmse: if error == 0.0 { 0.0 } else { (error / power).sqrt() },
            smape: pairs().map(share).sum::<f64>() / pairs().count() as f64,
            lowest: lowest.fold(f64::INFINITY, f64::min),
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// A_l of a coefficient; 1 for L3, which the cosine takes out: its kernel is 0 all the same.
fn cosine(index: usize) -> f64 {
    match band_of(index) {
        0 => PI,
        1 => 2.0 * PI / 3.0,
        2 => PI / 4.0,
        3 => 1.0,
        _ => f64::from(COSINE[4]),
    }
}

/// A_l Y_lm in a direction.
fn kernel(direction: [f64; 3]) -> [f64; MAX_COEFFICIENTS] {
    let mut values = [0.0; MAX_COEFFICIENTS];
    basis(MAX_BANDS, direction.map(|v| v as f32), &mut values);
    std::array::from_fn(|i| if band_of(i) == 3 { 0.0 } else { cosine(i) * f64::from(values[i]) })
}

fn linear(channel: &[f64; MAX_COEFFICIENTS], bands: u32, normals: &Normals) -> Vec<f64> {
    let count = coefficient_count(bands);
    normals.kernels.iter().map(|kernel| dot(&kernel[..count], &channel[..count])).collect()
}

/// n_k² for each of the six axes that the normal leans to, 0 for the other three.
fn cube_weights(normal: &[f64; 3]) -> [f64; 6] {
    std::array::from_fn(|k| (normal[k % 3] * AXES[k][k % 3]).max(0.0).powi(2))
}

fn ambient_cube(axes: &[f64], normals: &Normals) -> Vec<f64> {
    normals.directions.iter().map(|normal| dot(&cube_weights(normal), axes)).collect()
}

fn fit_cube(irradiance: &[f64], normals: &Normals, non_negative: bool) -> Vec<f64> {
    let (mut gram, mut right) = (vec![0.0; 36], vec![0.0; 6]);
    for (normal, e) in normals.directions.iter().zip(irradiance) {
        let weights = cube_weights(normal);
        for i in 0..6 {
            right[i] += weights[i] * e;
            (0..6).for_each(|j| gram[6 * i + j] += weights[i] * weights[j]);
        }
    }
    if non_negative {
        solve_non_negative(&gram, &right)
    } else {
        solve(&gram, &right).expect("normals lean to all six axes")
    }
}

/// [`RadianceSh::irradiance_l1_nonlinear`] of one channel, in f64.
fn nonlinear(channel: &[f64], normals: &Normals) -> Vec<f64> {
    let c1 = [channel[3], channel[1], channel[2]];
    let length = dot(&c1, &c1).sqrt();
    if channel[0] <= 0.0 {
        return vec![0.0; normals.directions.len()];
    }
    let mean = (PI / 4.0).sqrt() * channel[0]; // π Y00 C0
    let r = (length / (3f64.sqrt() * channel[0])).min(1.0);
    let (p, a) = (1.0 + 2.0 * r, (1.0 - r) / (1.0 + r));
    let axis = c1.map(|v| if length > 0.0 { v / length } else { 0.0 });
    let lobe = |normal: &[f64; 3]| {
        let q = 0.5 * (1.0 + dot(&axis, normal));
        mean * (a + (1.0 - a) * (p + 1.0) * q.clamp(0.0, 1.0).powf(p))
    };
    normals.directions.iter().map(lobe).collect()
}

fn fit_nonlinear(channel: &[f64], irradiance: &[f64], normals: &Normals) -> Vec<f64> {
    minimise(channel, |c| nonlinear(c, normals).iter().zip(irradiance).map(|(v, r)| v - r).collect())
}

/// Per channel C0, C1 in the order of the basis, and the zonal coefficient of L2 about the shared axis.
type Zh3 = [[f64; 5]; 3];

/// The direction of the luminance of L1.
fn zh3_axis(c1: [[f64; 3]; 3]) -> [f64; 3] {
    const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];
    let sum: [f64; 3] = std::array::from_fn(|k| (0..3).map(|c| LUMINANCE[c] * c1[c][k]).sum());
    let length = dot(&sum, &sum).sqrt();
    // y, z, x are the order of the basis.
    [2, 0, 1].map(|k| if length > 0.0 { sum[k] / length } else { 0.0 })
}

fn with_zonal(light: &Light, zonal: fn(&[f64; MAX_COEFFICIENTS], [f64; 3]) -> f64) -> Zh3 {
    let axis = zh3_axis(light.radiance.map(|channel| [channel[1], channel[2], channel[3]]));
    light.radiance.map(|channel| [channel[0], channel[1], channel[2], channel[3], zonal(&channel, axis)])
}

/// C0 (0.08 t + 0.6 t²), t = |C1·axis| / C0.
fn guess_zonal(channel: &[f64; MAX_COEFFICIENTS], axis: [f64; 3]) -> f64 {
    if channel[0] <= 0.0 {
        return 0.0;
    }
    let t = dot(&[channel[3], channel[1], channel[2]], &axis).abs() / channel[0];
    channel[0] * (0.08 * t + 0.6 * t * t)
}

/// Zonal function about `axis`: Z(n) = sqrt(5/16π) (3 (axis·n)² - 1) = sqrt(4π/5) Σ Y_2m(axis) Y_2m(n), so that the
/// nearest one to an L2 has the coefficient sqrt(4π/5) Σ L_2m Y_2m(axis).
fn project_zonal(channel: &[f64; MAX_COEFFICIENTS], axis: [f64; 3]) -> f64 {
    (4.0 * PI / 5.0).sqrt() * dot(&channel[4..9], &kernel(axis)[4..9]) / (PI / 4.0)
}

fn zh3(light: &Zh3, normals: &Normals) -> [Vec<f64>; 3] {
    let axis = zh3_axis(light.map(|[_, y, z, x, _]| [y, z, x]));
    let zonal = |normal: &[f64; 3]| {
        PI / 4.0 * (5.0 / (16.0 * PI)).sqrt() * (3.0 * dot(&axis, normal).powi(2) - dot(&axis, &axis))
    };
    light.map(|channel| {
        let kernels = normals.directions.iter().zip(&normals.kernels);
        kernels.map(|(normal, kernel)| dot(&kernel[..4], &channel[..4]) + channel[4] * zonal(normal)).collect()
    })
}

fn fit_zh3(light: &Light, normals: &Normals) -> Zh3 {
    let start = with_zonal(light, project_zonal);
    let residuals = |numbers: &[f64]| {
        let found = zh3(&std::array::from_fn(|c| std::array::from_fn(|k| numbers[5 * c + k])), normals);
        found.iter().flatten().zip(light.irradiance.iter().flatten()).map(|(v, r)| v - r).collect()
    };
    let fitted = minimise(start.as_flattened(), residuals);
    std::array::from_fn(|c| std::array::from_fn(|k| fitted[5 * c + k]))
}

/// The nearest function e + Σ λ_j Y(n_j) with E >= 0 in all normals n_j: by Moreau, λ >= 0 is the least squares solution
/// of |e + Σ λ_j Y(n_j)| = min, all in E's coefficients, where the basis is orthonormal.
fn non_negative_l2(channel: &[f64; MAX_COEFFICIENTS], normals: &Normals) -> Vec<f64> {
    let e = linear(channel, 2, normals);
    if e.iter().all(|&v| v >= 0.0) {
        return e;
    }
    let lambda = solve_non_negative(&normals.products, &e.iter().map(|v| -v).collect::<Vec<f64>>());
    let raised = |(row, e): (&[f64], &f64)| e + dot(row, &lambda);
    normals.products.chunks_exact(e.len()).zip(&e).map(raised).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(radiance: impl Fn([f64; 3]) -> [f64; 3]) -> Vec<([f64; 3], [f64; 3])> {
        let directions = Normals::new(20_000).directions;
        let solid_angle = 4.0 * PI / directions.len() as f64;
        directions.into_iter().map(|d| (d, radiance(d).map(|v| v * solid_angle))).collect()
    }

    #[test]
    fn constant_light_is_exact_in_every_decoder() {
        let normals = Normals::new(256);
        let light = Light::of_samples(&samples(|_| [1.0, 2.0, 0.5]), &normals);
        for decoder in Decoder::ALL {
            let found = decoder.decode(&light, &normals);
            for (c, expected) in [PI, 2.0 * PI, 0.5 * PI].into_iter().enumerate() {
                for e in &found[c] {
                    assert!((e / expected - 1.0).abs() < 1e-3, "{}: {e} for {expected}", decoder.name());
                }
            }
        }
    }

    #[test]
    fn one_direction_has_the_values_of_theory() {
        // Light of power 1 from +y: E is 1 towards it, 0 from the equator down.
        let normals = Normals::new(2048);
        let light = Light::of_samples(&[([0.0, 1.0, 0.0], [1.0; 3])], &normals);
        // Facing it: L1 1/4 + 1/2, L2 another 5/16, ZH3 the same as L2 as the light is zonal, L1 non-linear 1.
        let facing = |decoder: Decoder| decoder.decode(&light, &normals)[1][0];
        for (decoder, expected) in [
            (Decoder::L0, 0.25),
            (Decoder::CubeAtAxes, 1.0),
            (Decoder::L1, 0.75),
            (Decoder::L1Nonlinear, 1.0),
            (Decoder::Zh3, 1.0625),
            (Decoder::L2, 1.0625),
            (Decoder::L4, 1.0625 - 3.0 / 32.0),
        ] {
            assert!((facing(decoder) - expected).abs() < 4e-3, "{}: {}", decoder.name(), facing(decoder));
        }
        // As far below 0 on the other side as the mean is above it.
        let lowest = Score::of(&Decoder::L1.decode(&light, &normals), &light.irradiance).lowest;
        assert!((lowest + 1.0).abs() < 1e-2, "{lowest}");
    }

    #[test]
    fn constrained_fits_are_nowhere_negative() {
        let normals = Normals::new(256);
        let light = Light::of_samples(&[([0.6, 0.0, 0.8], [1.0, 3.0, 0.2])], &normals);
        for decoder in [Decoder::CubeNonNegative, Decoder::L1NonlinearFitted, Decoder::L2NonNegative] {
            let score = Score::of(&decoder.decode(&light, &normals), &light.irradiance);
            assert!(score.lowest > -1e-6, "{}: {score:?}", decoder.name());
        }
        let free = Score::of(&Decoder::L2.decode(&light, &normals), &light.irradiance);
        assert!(free.lowest < -0.1, "{free:?}");
    }

    #[test]
    fn fits_are_at_least_as_near_as_what_they_start_from() {
        let normals = Normals::new(256);
        let sky = |d: [f64; 3]| [d[1].max(0.0) + 0.1, (3.0 * d[0]).exp(), if d[2] > 0.3 { 4.0 } else { 0.2 }];
        let light = Light::of_samples(&samples(sky), &normals);
        let rmse = |decoder: Decoder| Score::of(&decoder.decode(&light, &normals), &light.irradiance).relative_rmse;
        for (fitted, plain) in [
            (Decoder::L1NonlinearFitted, Decoder::L1Nonlinear),
            (Decoder::Zh3Fitted, Decoder::Zh3),
            (Decoder::CubeFitted, Decoder::CubeAtAxes),
        ] {
            assert!(rmse(fitted) < rmse(plain), "{}: {} {}", fitted.name(), rmse(fitted), rmse(plain));
        }
    }

    #[test]
    fn nonlinear_is_the_runtimes() {
        let normals = Normals::new(64);
        let mut sh = RadianceSh::zero(4);
        sh.coefficients[..4].copy_from_slice(&[[1.0, 2.0, 0.5], [0.3, -1.0, 0.9], [0.1, 0.2, -0.3], [-0.4, 2.0, 0.0]]);
        let light = Light::of_sh(&sh, &normals);
        let found = Decoder::L1Nonlinear.decode(&light, &normals);
        for (i, normal) in normals.directions.iter().enumerate() {
            let expected = sh.irradiance_l1_nonlinear(normal.map(|v| v as f32));
            (0..3).for_each(|c| assert!((found[c][i] - f64::from(expected[c])).abs() < 1e-4));
        }
    }
}
