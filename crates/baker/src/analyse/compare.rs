//! Error of E against a reference.
//!
//! Error of E: evaluate E from the coefficients in 26 directions; root of the mean square difference over directions,
//! channels and nodes, over the root mean square of the truth. Per node the same over its own directions.

use gdibl_runtime::{RadianceSh, sh};
use serde::Serialize;

use crate::records::ErrorSummary;
use crate::sampling::fibonacci_sphere;

/// Normals in which E is compared.
const DIRECTIONS: usize = 26;

/// Error of E over a set of nodes. Shares, not percent.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct IrradianceError {
    /// Nodes compared.
    pub nodes: usize,
    /// Root of the mean square difference over that of the truth.
    pub relative_rmse: f64,
    /// Mean signed difference over the mean of the truth.
    pub bias: f64,
    /// Per node: root mean square difference over the node's own truth.
    pub per_node: ErrorSummary,
}

/// Compares nodes of radiance coefficients; the bands of the lower of both count.
///
/// Panics when there is nothing to compare or the lengths differ.
pub fn compare_irradiance(found: &[RadianceSh], truth: &[RadianceSh]) -> IrradianceError {
    assert_eq!(found.len(), truth.len(), "nodes found and nodes of the truth");
    assert!(!found.is_empty(), "nothing to compare");
    let directions = fibonacci_sphere(DIRECTIONS);
    let (mut difference, mut square, mut signed, mut sum) = (0.0, 0.0, 0.0, 0.0);
    let mut per_node = Vec::with_capacity(found.len());
    for (found, truth) in found.iter().zip(truth) {
        let bands = found.bands.min(truth.bands);
        let [found, truth] = [found, truth].map(|sh| sh.truncate(bands).convolve());
        let (mut node_difference, mut node_square) = (0.0, 0.0);
        for direction in &directions {
            let (a, b) = (found.evaluate(direction.to_array()), truth.evaluate(direction.to_array()));
            for channel in 0..3 {
                let (a, b) = (f64::from(a[channel]), f64::from(b[channel]));
                node_difference += (a - b) * (a - b);
                node_square += b * b;
                signed += a - b;
                sum += b;
            }
        }
        difference += node_difference;
        square += node_square;
        per_node.push((node_difference / node_square).sqrt());
    }
    IrradianceError {
        nodes: found.len(),
        relative_rmse: (difference / square).sqrt(),
        bias: signed / sum,
        per_node: ErrorSummary::of(per_node.into_iter()).unwrap_or(ErrorSummary {
            median: f64::INFINITY,
            p95: f64::INFINITY,
            max: f64::INFINITY,
        }),
    }
}

/// Coefficients `[coefficient][rgb]` as radiance SH.
pub fn radiance_sh(bands: u32, coefficients: impl IntoIterator<Item = [f32; 3]>) -> RadianceSh {
    let mut sh = RadianceSh::zero(bands);
    for (place, value) in sh.coefficients[..sh::coefficient_count(bands)].iter_mut().zip(coefficients) {
        *place = value;
    }
    sh
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scaled_volume_is_wrong_by_its_scale() {
        let truth = [radiance_sh(1, [[1.0, 2.0, 3.0], [0.1; 3], [0.2; 3], [0.3; 3]])];
        let found = [radiance_sh(1, truth[0].coefficients.map(|c| c.map(|v| v * 1.02)))];
        let error = compare_irradiance(&found, &truth);
        assert!((error.relative_rmse - 0.02).abs() < 1e-6, "{error:?}");
        assert!((error.bias - 0.02).abs() < 1e-6);
        assert!((error.per_node.max - 0.02).abs() < 1e-6);
    }

    #[test]
    #[should_panic(expected = "nothing to compare")]
    fn comparing_nothing_fails() {
        compare_irradiance(&[], &[]);
    }
}
