//! Ambient cubes: six colours, one per side of a cube, blended by the squares of the normal's components.
//!
//! `E(n) = c(±x) n_x² + c(±y) n_y² + c(±z) n_z²`, of each axis the side that n points to. Sides come in the order
//! +x, -x, +y, -y, +z, -z.
//!
//! Two ways to get the six: E along the axes, or the cube nearest to E over all normals,
//! `min ∫ (Σ c_i φ_i(n) - E(n))² dn`, φ_i(n) = max(±n_k, 0)². With G_ij = ∫ φ_i φ_j and b_i = ∫ φ_i E this is
//! `min ½ cᵀGc - bᵀc`, and since a texture may be unsigned, with c ≥ 0.
//!
//! Based on: J. Mitchell, G. McTaggart, C. Green, "Shading in Valve's Source Engine" (2006), "Ambient Cube Basis";
//! C. Lawson and R. Hanson, "Solving Least Squares Problems" (1974), chapter 23: the active set method for c ≥ 0.

use gdibl_runtime::IrradianceSh;
use gdibl_runtime::sh::{MAX_BANDS, MAX_COEFFICIENTS, basis};

/// The sides' directions.
pub(crate) const SIDES: [[f32; 3]; 6] =
    [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];

/// RGB of each side.
pub(crate) type Cube = [[f32; 3]; 6];

/// E along the axes, never below 0.
pub(crate) fn cube_of_axes(irradiance: &IrradianceSh) -> Cube {
    SIDES.map(|side| irradiance.evaluate(side).map(|e| e.max(0.0)))
}

/// Fits cubes by non-negative least squares.
pub(crate) struct CubeFit {
    /// G.
    products: [[f64; 6]; 6],
    /// ∫ φ_i Y_lm, so that b is a weighted sum of coefficients.
    projections: [[f64; MAX_COEFFICIENTS]; 6],
}

impl CubeFit {
    /// Integrates by the midpoint rule, in steps that respect the edges between octants. The same rule for G and b makes
    /// what a cube can hold come out exactly, constant light above all.
    pub fn new() -> CubeFit {
        const HEIGHTS: usize = 128;
        const TURNS: usize = 256;
        let mut fit = CubeFit { products: [[0.0; 6]; 6], projections: [[0.0; MAX_COEFFICIENTS]; 6] };
        let area = 4.0 * std::f64::consts::PI / (HEIGHTS * TURNS) as f64;
        for index in 0..HEIGHTS * TURNS {
            let z = (2 * (index / TURNS) + 1) as f64 / HEIGHTS as f64 - 1.0;
            let turn = std::f64::consts::TAU * ((index % TURNS) as f64 + 0.5) / TURNS as f64;
            let radius = (1.0 - z * z).sqrt();
            let normal = [radius * turn.cos(), radius * turn.sin(), z];
            let weights = side_weights(normal);
            let mut functions = [0.0; MAX_COEFFICIENTS];
            basis(MAX_BANDS, normal.map(|v| v as f32), &mut functions);
            for i in 0..6 {
                for j in 0..6 {
                    fit.products[i][j] += area * weights[i] * weights[j];
                }
                for (sum, function) in fit.projections[i].iter_mut().zip(functions) {
                    *sum += area * weights[i] * f64::from(function);
                }
            }
        }
        fit
    }

    /// The nearest cube without a negative side.
    pub fn fit(&self, irradiance: &IrradianceSh) -> Cube {
        let mut cube = [[0.0; 3]; 6];
        for channel in 0..3 {
            let target = self.projections.map(|projection| {
                let terms = projection.iter().zip(&irradiance.coefficients);
                terms.map(|(p, coefficient)| p * f64::from(coefficient[channel])).sum()
            });
            for (side, value) in cube.iter_mut().zip(non_negative_least_squares(&self.products, &target)) {
                side[channel] = value as f32;
            }
        }
        cube
    }
}

/// φ of the six sides.
fn side_weights(normal: [f64; 3]) -> [f64; 6] {
    std::array::from_fn(|side| {
        let along = normal[side / 2] * if side % 2 == 0 { 1.0 } else { -1.0 };
        along.max(0.0).powi(2)
    })
}

/// min ½ cᵀGc - bᵀc with c ≥ 0, for a positive definite G.
fn non_negative_least_squares(products: &[[f64; 6]; 6], target: &[f64; 6]) -> [f64; 6] {
    let tolerance = 1e-12 * target.iter().fold(0.0_f64, |largest, b| largest.max(b.abs()));
    let mut free = [false; 6];
    let mut values = [0.0; 6];
    // Each round frees the side that gains most; in six unknowns a handful suffices, and 64 sets are all there are.
    for _ in 0..64 {
        let gain = |i: usize| target[i] - (0..6).map(|j| products[i][j] * values[j]).sum::<f64>();
        let best = (0..6).filter(|&i| !free[i]).max_by(|&a, &b| gain(a).total_cmp(&gain(b)));
        let Some(best) = best.filter(|&i| gain(i) > tolerance) else { break };
        free[best] = true;
        loop {
            let wanted = solve(products, target, &free);
            // Go toward the solution as far as all stay above 0; what reaches 0 is held there.
            let blocking = (0..6).filter(|&i| free[i] && wanted[i] <= 0.0);
            let step = blocking.map(|i| values[i] / (values[i] - wanted[i])).min_by(f64::total_cmp);
            let Some(step) = step.filter(|step| step.is_finite()) else {
                values = std::array::from_fn(|i| wanted[i].max(0.0));
                break;
            };
            values = std::array::from_fn(|i| values[i] + step * (wanted[i] - values[i]));
            for i in 0..6 {
                if free[i] && wanted[i] <= 0.0 && values[i] <= tolerance {
                    free[i] = false;
                    values[i] = 0.0;
                }
            }
        }
    }
    values
}

/// The solution of Gc = b over the free unknowns, 0 at the others. By Gaussian elimination: G is positive definite.
fn solve(products: &[[f64; 6]; 6], target: &[f64; 6], free: &[bool; 6]) -> [f64; 6] {
    let mut rows: [[f64; 7]; 6] = std::array::from_fn(|i| {
        std::array::from_fn(|j| match (free[i], j) {
            (false, 6) => 0.0,
            (false, j) => f64::from(u8::from(i == j)),
            (true, 6) => target[i],
            (true, j) => {
                if free[j] {
                    products[i][j]
                } else {
                    0.0
                }
            }
        })
    });
    for pivot in 0..6 {
        for row in pivot + 1..6 {
            let factor = rows[row][pivot] / rows[pivot][pivot];
            let above = rows[pivot];
            for (value, above) in rows[row][pivot..].iter_mut().zip(&above[pivot..]) {
                *value -= factor * above;
            }
        }
    }
    let mut solution = [0.0; 6];
    for row in (0..6).rev() {
        let known: f64 = (row + 1..6).map(|j| rows[row][j] * solution[j]).sum();
        solution[row] = (rows[row][6] - known) / rows[row][row];
    }
    solution
}

#[cfg(test)]
mod tests {
    use super::*;
    use gdibl_runtime::RadianceSh;

    fn some_sh(seed: usize) -> IrradianceSh {
        let mut sh = RadianceSh::zero(2);
        for (i, coefficient) in sh.coefficients[..9].iter_mut().enumerate() {
            *coefficient = std::array::from_fn(|c| ((seed * 31 + i * 7 + c) as f32 * 1.7).sin() * 2.0);
        }
        sh.convolve()
    }

    #[test]
    fn products_are_the_integrals_known_in_closed_form() {
        let fit = CubeFit::new();
        let pi = std::f64::consts::PI;
        for i in 0..6 {
            for j in 0..6 {
                let truth = match (i == j, i / 2 == j / 2) {
                    (true, _) => 2.0 * pi / 5.0,
                    (false, true) => 0.0,
                    _ => pi / 15.0,
                };
                assert!((fit.products[i][j] - truth).abs() < 1e-3, "{i} {j}: {} {truth}", fit.products[i][j]);
            }
        }
    }

    #[test]
    fn fit_is_the_best_of_all_64_sets_of_free_sides() {
        let fit = CubeFit::new();
        let mut held = 0;
        for seed in 0..200 {
            let irradiance = some_sh(seed);
            let target: [f64; 6] = fit.projections.map(|projection| {
                projection.iter().zip(&irradiance.coefficients).map(|(p, c)| p * f64::from(c[0])).sum()
            });
            let cost = |c: &[f64; 6]| -> f64 {
                let quadratic: f64 =
                    (0..6).map(|i| (0..6).map(|j| c[i] * fit.products[i][j] * c[j]).sum::<f64>()).sum();
                0.5 * quadratic - c.iter().zip(&target).map(|(c, b)| c * b).sum::<f64>()
            };
            let best = (0..64_u32)
                .map(|set| solve(&fit.products, &target, &std::array::from_fn(|i| set >> i & 1 == 1)))
                .filter(|c| c.iter().all(|&c| c >= 0.0))
                .min_by(|a, b| cost(a).total_cmp(&cost(b)))
                .unwrap();
            let found = non_negative_least_squares(&fit.products, &target);
            assert!(found.iter().all(|&c| c >= 0.0), "{found:?}");
            assert!((cost(&found) - cost(&best)).abs() < 1e-9, "{seed}: {found:?} {best:?}");
            held += found.iter().filter(|&&c| c == 0.0).count();
        }
        assert!(held > 100, "the bound was at work: {held}");
    }

    #[test]
    fn constant_light_is_the_same_on_all_sides() {
        let mut sh = RadianceSh::zero(0);
        sh.coefficients[0] = [1.0, 2.0, 3.0].map(|l| l / gdibl_runtime::sh::Y00);
        let pi = std::f32::consts::PI;
        for cube in [CubeFit::new().fit(&sh.convolve()), cube_of_axes(&sh.convolve())] {
            for side in cube {
                for (c, e) in side.iter().enumerate() {
                    assert!((e / pi - (c + 1) as f32).abs() < 1e-4, "{cube:?}");
                }
            }
        }
    }

    #[test]
    fn darkness_fits_darkness() {
        assert_eq!(CubeFit::new().fit(&IrradianceSh::zero(2)), [[0.0; 3]; 6]);
    }
}
