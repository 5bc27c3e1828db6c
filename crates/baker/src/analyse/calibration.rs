//! Whether standard errors are honest: many bakes of the same nodes, which differ by their seed, against one long bake.

use gdibl_runtime::sh;

use crate::bake::{Baked, INTERVAL_95};
use crate::job::records::ErrorSummary;

/// How bakes lie around what they converge to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    /// Root mean square difference of E over the RMS of E, over nodes, normals, R, G and B: what chance makes of it.
    pub noise: f64,
    /// The same of each node, over its own E.
    pub node_noise: ErrorSummary,
    /// Root mean square of the standard errors of coefficients, as they count in E, over that of their differences.
    pub claimed_over_found: f64,
    /// Share of the coefficients whose 95 % interval ([`INTERVAL_95`]) holds the converged value.
    pub covered: f64,
    /// Coefficients looked at: nodes × bakes × coefficients × 3.
    pub values: u64,
}

/// Compares bakes that hold the errors of their coefficients with a long one of the same nodes and settings. Nodes that
/// are not valid in all of them do not count.
///
/// Panics without a bake, or where none holds a valid node.
pub fn calibrate(converged: &Baked, bakes: &[Baked]) -> Calibration {
    let bands = converged.bands;
    let stride = 3 * sh::coefficient_count(bands);
    let (mut covered, mut values) = (0u64, 0u64);
    let (mut found, mut claimed, mut light) = (0.0, 0.0, 0.0);
    let mut nodes = Vec::new();
    for node in (0..converged.len()).filter(|&node| converged.is_valid(node) && bakes.iter().all(|b| b.is_valid(node)))
    {
        let (mut own_found, mut own_light) = (0.0, 0.0);
        let truths = converged.node(node);
        for place in node * stride..(node + 1) * stride {
            let cosine = f64::from(sh::COSINE[sh::band_of((place - node * stride) / 3)]);
            let truth = f64::from(truths[place - node * stride]);
            own_light += (cosine * truth).powi(2);
            for bake in bakes {
                let error = f64::from(bake.coefficient_error[place]);
                let off = (f64::from(bake.node(node)[place - node * stride]) - truth).abs();
                covered += u64::from(off <= INTERVAL_95 * error);
                values += 1;
                own_found += (cosine * off).powi(2) / bakes.len() as f64;
                claimed += (cosine * error).powi(2) / bakes.len() as f64;
            }
        }
        nodes.push((own_found / own_light).sqrt());
        found += own_found;
        light += own_light;
    }
    Calibration {
        noise: (found / light).sqrt(),
        node_noise: ErrorSummary::of(nodes.into_iter()).expect("a valid node"),
        claimed_over_found: (claimed / found).sqrt(),
        covered: covered as f64 / values as f64,
        values,
    }
}
