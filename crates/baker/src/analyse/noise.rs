//! How much of a difference between two volumes is noise: the variance of E that their standard errors predict.
//!
//! Variance here is the mean over all normals n of Var E(n), and over R, G, B. With E(n) = Σ A_l L_lm Y_lm(n) and the
//! basis orthonormal, that is `1/4π Σ A_l² Var L_lm`: covariances of coefficients drop out, they need not be known.
//!
//! A volume stores `relative_error`: one standard error of E over the larger of the node's RMS of E and a tenth of the
//! volume's median of that. RMS and median are in the coefficients, so the standard error is got back. (With
//! `--target-error` the median was that of a pilot; it matters for nodes under a tenth of it alone.) It is the error of all
//! bands of the volume: where fewer count, it is a little too much, 6 % for L2 of which L1 counts.

use gdibl_runtime::sample::LEAST_VALID;
use gdibl_runtime::{RadianceSh, Volume, sh};
use std::f64::consts::PI;

use super::error::ErrorDirections;

/// Variance of E of every node; `None` where the volume holds no standard errors.
pub(super) fn node_variances(volume: &Volume) -> Option<Vec<f64>> {
    let nodes = 0..volume.node_count();
    let relative: Option<Vec<f32>> = nodes.clone().map(|node| volume.node_relative_error(node)).collect();
    let directions = ErrorDirections::new();
    let rms: Vec<f64> = nodes.clone().map(|node| directions.rms_irradiance(&volume.node_sh(node))).collect();
    // The middle as the baker takes it.
    let mut valid: Vec<f64> = nodes.filter(|&node| volume.is_valid(node)).map(|node| rms[node]).collect();
    let middle = valid.len() / 2;
    let median = if valid.is_empty() { 0.0 } else { *valid.select_nth_unstable_by(middle, f64::total_cmp).1 };
    let variance = |(relative, rms): (f32, &f64)| (f64::from(relative) * rms.max(0.1 * median)).powi(2);
    Some(relative?.into_iter().zip(&rms).map(variance).collect())
}

/// Variance of E of what a grid answers between its nodes, which are independent: Σ w² Var. Filled nodes do not count.
pub(super) fn sample_variance(volume: &Volume, variances: &[f64], position: [f64; 3]) -> f64 {
    let Some(cell) = volume.cell(position) else { return 0.0 };
    let nodes = || cell.nodes.iter().map(|&node| node as usize).zip(cell.weights);
    let valid: f32 = nodes().filter(|(node, _)| volume.is_valid(*node)).map(|(_, weight)| weight).sum();
    if valid < LEAST_VALID {
        return 0.0;
    }
    let share = |weight: f32| f64::from(weight / valid);
    nodes().filter(|(n, _)| volume.is_valid(*n)).map(|(n, weight)| share(weight).powi(2) * variances[n]).sum()
}

/// Variance of E from the standard errors of the coefficients of bands 0 to `bands`.
pub(super) fn coefficient_variance(standard_error: &RadianceSh, bands: u32) -> f64 {
    let count = sh::coefficient_count(bands.min(standard_error.bands));
    let squares = standard_error.coefficients[..count].iter().enumerate().flat_map(|(i, rgb)| {
        let cosine = f64::from(sh::COSINE[sh::band_of(i)]);
        rgb.map(|error| (cosine * f64::from(error)).powi(2))
    });
    squares.sum::<f64>() / (4.0 * PI * 3.0)
}
