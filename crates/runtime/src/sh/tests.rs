//! The laws of the basis and of the two types over it. Integrals are exact quadratures in f64, up to rounding of f32.

use super::*;
use alloc::vec::Vec;
use core::f64::consts::PI as PI64;

type Vector = [f64; 3];

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn basis_at(direction: Vector) -> [f64; 25] {
    let mut out = [0.0; 25];
    basis(4, direction.map(|v| v as f32), &mut out);
    out.map(f64::from)
}

/// Legendre polynomial P_l.
fn legendre(l: usize, x: f64) -> f64 {
    let (mut before, mut value) = (1.0, x);
    if l == 0 {
        return 1.0;
    }
    for k in 2..=l {
        let k = k as f64;
        (before, value) = (value, ((2.0 * k - 1.0) * x * value - (k - 1.0) * before) / k);
    }
    value
}

/// Directions and weights that integrate polynomials of degree < 32 over the sphere exactly: Gauss-Legendre in z,
/// evenly in longitude.
fn quadrature() -> Vec<(Vector, f64)> {
    const N: usize = 16;
    let mut rule = Vec::new();
    for i in 0..N {
        // Newton's method to the i-th root of P_N.
        let mut z = (PI64 * (i as f64 + 0.75) / (N as f64 + 0.5)).cos();
        let derivative = |z: f64| N as f64 * (z * legendre(N, z) - legendre(N - 1, z)) / (z * z - 1.0);
        for _ in 0..20 {
            z -= legendre(N, z) / derivative(z);
        }
        let weight = 2.0 / ((1.0 - z * z) * derivative(z) * derivative(z));
        for j in 0..2 * N {
            let longitude = PI64 * (j as f64 + 0.5) / N as f64;
            let r = (1.0 - z * z).sqrt();
            let direction = [r * longitude.cos(), r * longitude.sin(), z];
            rule.push((direction, weight * PI64 / N as f64));
        }
    }
    rule
}

/// Some unit directions without symmetry.
fn directions() -> Vec<Vector> {
    (0..40)
        .map(|i| {
            let z = -0.97 + 1.93 * (i as f64 + 0.3) / 40.0;
            let longitude = 2.399_963 * i as f64;
            let r = (1.0 - z * z).sqrt();
            [r * longitude.cos(), r * longitude.sin(), z]
        })
        .collect()
}

fn project(f: impl Fn(Vector) -> f64) -> RadianceSh {
    let mut sums = [0.0; 25];
    for (direction, weight) in quadrature() {
        let values = basis_at(direction);
        for (sum, value) in sums.iter_mut().zip(values) {
            *sum += weight * f(direction) * value;
        }
    }
    RadianceSh { bands: 4, coefficients: sums.map(|v| [v as f32; 3]) }
}

fn rotate(v: Vector) -> Vector {
    // Rows of a rotation: about z by 0.7, then about x by -1.1, then about y by 2.3.
    let (s, c) = 0.7f64.sin_cos();
    let v = [c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]];
    let (s, c) = (-1.1f64).sin_cos();
    let v = [v[0], c * v[1] - s * v[2], s * v[1] + c * v[2]];
    let (s, c) = 2.3f64.sin_cos();
    [c * v[0] + s * v[2], v[1], -s * v[0] + c * v[2]]
}

#[track_caller]
fn assert_near(found: f64, truth: f64, tolerance: f64) {
    assert!((found - truth).abs() <= tolerance, "found {found}, expected {truth} within {tolerance}");
}

#[test]
fn all_25_functions_are_orthonormal() {
    let mut gram = [[0.0; 25]; 25];
    for (direction, weight) in quadrature() {
        let values = basis_at(direction);
        for i in 0..25 {
            for j in 0..25 {
                gram[i][j] += weight * values[i] * values[j];
            }
        }
    }
    for (i, row) in gram.iter().enumerate() {
        for (j, &product) in row.iter().enumerate() {
            assert_near(product, f64::from(u8::from(i == j)), 1e-6);
        }
    }
}

#[test]
fn order_and_sign_are_those_of_associated_legendre_functions_without_condon_shortley() {
    fn factorial(n: usize) -> f64 {
        (1..=n).map(|k| k as f64).product()
    }
    /// P_l^m without the sign (-1)^m.
    fn associated(l: usize, m: usize, z: f64) -> f64 {
        let mut start = 1.0;
        for k in 0..m {
            start *= (2 * k + 1) as f64 * (1.0 - z * z).sqrt();
        }
        let (mut before, mut value) = (0.0, start);
        for k in m + 1..=l {
            let next = ((2 * k - 1) as f64 * z * value - (k + m - 1) as f64 * before) / (k - m) as f64;
            (before, value) = (value, next);
        }
        value
    }
    for direction in directions() {
        let values = basis_at(direction);
        let longitude = direction[1].atan2(direction[0]);
        for l in 0..=4usize {
            for m in -(l as i64)..=l as i64 {
                let k = m.unsigned_abs() as usize;
                let norm = ((2 * l + 1) as f64 / (4.0 * PI64) * factorial(l - k) / factorial(l + k)).sqrt();
                let turn = match m {
                    0 => 1.0,
                    1.. => 2f64.sqrt() * (m as f64 * longitude).cos(),
                    _ => 2f64.sqrt() * (k as f64 * longitude).sin(),
                };
                let index = (l * (l + 1)) as i64 + m;
                let truth = norm * turn * associated(l, k, direction[2]);
                assert_near(values[index as usize], truth, 2e-6);
            }
        }
    }
}

#[test]
fn constants_and_order_are_pinned() {
    let d = [0.2f32, 0.5, 0.842_614_9];
    let mut v = [0.0; 25];
    basis(2, d, &mut v);
    let [x, y, z] = d;
    let expected = [
        0.2820948,
        0.4886025 * y,
        0.4886025 * z,
        0.4886025 * x,
        1.0925484 * x * y,
        1.0925484 * y * z,
        0.3153916 * (3.0 * z * z - 1.0),
        1.0925484 * x * z,
        0.5462742 * (x * x - y * y),
    ];
    for (found, truth) in v.iter().zip(expected) {
        assert_near(f64::from(*found), f64::from(truth), 1e-6);
    }
    assert_eq!(v[9..], [0.0; 16], "bands above the asked are left alone");
    assert_eq!([0, 1, 2, 3, 4].map(coefficient_count), [1, 4, 9, 16, 25]);
    assert_eq!([0, 1, 3, 4, 8, 9, 15, 16, 24].map(band_of), [0, 1, 1, 2, 2, 3, 3, 4, 4]);
}

#[test]
fn addition_theorem_holds_in_every_band() {
    for a in directions() {
        for b in directions() {
            let (va, vb) = (basis_at(a), basis_at(b));
            for l in 0..=4 {
                let sum: f64 = (l * l..(l + 1) * (l + 1)).map(|i| va[i] * vb[i]).sum();
                let truth = (2 * l + 1) as f64 / (4.0 * PI64) * legendre(l, dot(a, b));
                assert_near(sum, truth, 3e-6);
            }
        }
    }
}

#[test]
fn rotating_a_function_rotates_its_projection_and_keeps_each_bands_energy() {
    let f = |d: Vector| 1.0 + d[0] - 0.5 * d[1] * d[2] + d[0] * d[0] * d[1] + (d[2] - 0.3 * d[0]).powi(4);
    let (plain, rotated) = (project(f), project(|d| f(rotate(d))));
    for d in directions() {
        let found = rotated.evaluate(d.map(|v| v as f32))[0];
        let truth = plain.evaluate(rotate(d).map(|v| v as f32))[0];
        assert_near(f64::from(found), f64::from(truth), 1e-5);
    }
    let energy = |sh: &RadianceSh, l: usize| -> f64 {
        (l * l..(l + 1) * (l + 1)).map(|i| f64::from(sh.coefficients[i][0]).powi(2)).sum()
    };
    for l in 0..=4 {
        assert!(energy(&plain, l) > 1e-3, "band {l} is not tested");
        assert_near(energy(&rotated, l), energy(&plain, l), 1e-5);
    }
}

#[test]
fn sh_to_directions_and_back_is_the_same_sh() {
    let mut sh = RadianceSh::zero(4);
    for (i, coefficient) in sh.coefficients.iter_mut().enumerate() {
        *coefficient = [(i as f32 * 0.7).sin(); 3];
    }
    let back = project(|d| f64::from(sh.evaluate(d.map(|v| v as f32))[0]));
    for (found, truth) in back.coefficients.iter().zip(sh.coefficients) {
        assert_near(f64::from(found[0]), f64::from(truth[0]), 1e-5);
    }
}

#[test]
fn white_furnace_gives_pi_times_radiance() {
    let sh = project(|_| 2.5);
    for d in directions() {
        let e = sh.convolve().evaluate(d.map(|v| v as f32));
        assert_near(f64::from(e[0]), 2.5 * PI64, 1e-5);
        let e = sh.irradiance_l1_nonlinear(d.map(|v| v as f32));
        assert_near(f64::from(e[0]), 2.5 * PI64, 1e-5);
    }
}

#[test]
fn irradiance_of_a_delta_is_the_clamped_cosine_up_to_band_4() {
    // L = delta at `light`, so L_lm = Y_lm(light) and E(n) = the first bands of max(n·light, 0).
    let light = directions()[11];
    let sh = RadianceSh { bands: 4, coefficients: basis_at(light).map(|v| [v as f32; 3]) };
    let irradiance = sh.convolve();
    for n in directions() {
        let t = dot(n, light);
        // The Legendre series of max(t, 0): 1/4 + t/2 + 5/16 P2 - 3/32 P4 + …
        let truth = 0.25 + 0.5 * t + 0.3125 * legendre(2, t) - 0.09375 * legendre(4, t);
        assert_near(f64::from(irradiance.evaluate(n.map(|v| v as f32))[0]), truth, 1e-6);
        assert_near(truth, t.max(0.0), 0.06);
    }
}

#[test]
fn convolution_equals_direct_integration_over_the_hemisphere() {
    // A function of bands 0 to 4, so nothing is cut off. The integral turns the hemisphere about n to z >= 0, where the
    // integrand is smooth: midpoints in cos² (which carries the cosine) and in longitude.
    let f = |d: Vector| 1.0 + 0.7 * d[0] - 0.5 * d[1] * d[2] + d[0] * d[0] * d[1] + (d[2] - 0.3 * d[0]).powi(4);
    let irradiance = project(f).convolve();
    for n in directions().into_iter().step_by(5) {
        let helper = if n[0].abs() < 0.5 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let cross =
            |a: Vector, b: Vector| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
        let t = cross(n, helper);
        let length = dot(t, t).sqrt();
        let t = t.map(|v| v / length);
        let b = cross(n, t);
        let (rings, spokes) = (400, 32);
        let mut sum = 0.0;
        for i in 0..rings {
            let cosine = ((i as f64 + 0.5) / rings as f64).sqrt();
            let sine = (1.0 - cosine * cosine).sqrt();
            for j in 0..spokes {
                let (s, c) = (2.0 * PI64 * j as f64 / spokes as f64).sin_cos();
                let d = core::array::from_fn(|k| sine * (c * t[k] + s * b[k]) + cosine * n[k]);
                sum += f(d) * PI64 / (rings * spokes) as f64;
            }
        }
        assert_near(f64::from(irradiance.evaluate(n.map(|v| v as f32))[0]), sum, 2e-4);
    }
}

#[test]
fn nonlinear_l1_agrees_with_linear_l1_to_first_order() {
    for strength in [0.0, 1e-3, 1e-2] {
        let axis = directions()[7];
        let sh = project(|d| 3.0 * (1.0 + strength * dot(axis, d)));
        for n in directions() {
            let n = n.map(|v| v as f32);
            let (found, truth) = (sh.irradiance_l1_nonlinear(n)[0], sh.convolve().evaluate(n)[0]);
            assert_near(f64::from(found), f64::from(truth), 2e-5 + 10.0 * strength * strength);
        }
    }
}

#[test]
fn nonlinear_l1_keeps_the_mean_and_is_never_negative() {
    for ratio in [0.0, 0.3, 1.0, 1.7, 1.732_050_8, 5.0] {
        let mut sh = RadianceSh::zero(1);
        sh.coefficients[0] = [2.0; 3];
        sh.coefficients[1] = [2.0 * ratio * 0.6; 3];
        sh.coefficients[3] = [2.0 * ratio * -0.8; 3];
        let mut mean = 0.0;
        for (d, weight) in quadrature() {
            let e = sh.irradiance_l1_nonlinear(d.map(|v| v as f32))[0];
            assert!(e >= 0.0, "{e}");
            mean += weight / (4.0 * PI64) * f64::from(e);
        }
        assert_near(mean, 2.0 * 0.282_094_8 * PI64, 1e-4);
    }
}

#[test]
fn nonlinear_l1_of_odd_input_is_defined() {
    let mut sh = RadianceSh::zero(1);
    assert_eq!(sh.irradiance_l1_nonlinear([0.0, 1.0, 0.0]), [0.0; 3]);
    sh.coefficients[0] = [-1.0, 0.0, f32::NAN];
    sh.coefficients[1] = [1.0; 3];
    assert_eq!(sh.irradiance_l1_nonlinear([0.0, 1.0, 0.0]), [0.0; 3]);
    sh.coefficients[0] = [1e-30; 3];
    sh.coefficients[1] = [1e30; 3];
    assert!(sh.irradiance_l1_nonlinear([0.0, 1.0, 0.0])[0].is_finite());
}

#[test]
fn lerp_and_add_scaled_are_linear_and_truncate_cuts() {
    let a = project(|d| 1.0 + d[0]);
    let b = project(|d| d[1] * d[2]).truncate(2);
    assert_eq!(b.bands, 2);
    let mixed = b.lerp(&a, 0.25);
    assert_eq!(mixed.bands, 4);
    for d in directions() {
        let d = d.map(|v| v as f32);
        let truth = 0.75 * b.evaluate(d)[1] + 0.25 * a.evaluate(d)[1];
        assert_near(f64::from(mixed.evaluate(d)[1]), f64::from(truth), 1e-6);
    }
    assert_eq!(a.truncate(1).coefficients[4..], [[0.0; 3]; 21]);
}
