//! Figures of one volume, for `inspect`.

use gdibl_runtime::Volume;
use serde::Serialize;

use crate::job::records::ErrorSummary;
use crate::sampling::fibonacci_sphere;

/// Directions in which a node is searched for negative irradiance.
const RINGING_DIRECTIONS: usize = 128;
/// Irradiance under this share of the node's mean counts as negative; above, it is rounding.
const RINGING: f32 = -1e-3;
/// Nodes listed as worst.
const WORST: usize = 5;

/// Figures over the valid nodes of a volume. Irradiance here is E averaged over all normals (π · L_00 · Y_00 per
/// channel), so one figure per node.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct VolumeSummary {
    /// Nodes in all.
    pub nodes: usize,
    /// Nodes with light of their own.
    pub nodes_valid: usize,
    /// Mean irradiance of linear R, G, B.
    pub irradiance: [Range; 3],
    /// Rec.709 luminance of the mean irradiance in stops (powers of two).
    pub luminance_stops: Histogram,
    /// Nodes whose irradiance turns negative for some normal (ringing of few bands).
    pub nodes_negative: usize,
    /// Coverage of valid nodes.
    pub coverage: Range,
    /// Relative standard error of E; `None` where the file holds none.
    pub relative_error: Option<ErrorSummary>,
    /// The nodes of greatest relative error, worst first.
    pub worst: Vec<NodeFigure>,
}

/// Spread of a figure; zeros over no node.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Range {
    /// Least.
    pub min: f64,
    /// Mean.
    pub mean: f64,
    /// Greatest.
    pub max: f64,
}

/// Counts per stop.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Histogram {
    /// Lower end of the first bin: 2^first.
    pub first: i32,
    /// Nodes per bin, one stop each.
    pub counts: Vec<usize>,
    /// Nodes without any light.
    pub black: usize,
}

/// A node and its error.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NodeFigure {
    /// Index in the file.
    pub node: usize,
    /// World metres.
    pub position: [f64; 3],
    /// Its relative standard error.
    pub relative_error: f64,
}

/// Looks at every node.
pub fn summarise(volume: &Volume) -> VolumeSummary {
    let valid: Vec<usize> = (0..volume.node_count()).filter(|&n| volume.is_valid(n)).collect();
    let directions: Vec<[f32; 3]> = fibonacci_sphere(RINGING_DIRECTIONS).iter().map(|d| d.to_array()).collect();
    let mut means = Vec::with_capacity(valid.len());
    let mut nodes_negative = 0;
    for &node in &valid {
        let irradiance = volume.node_sh(node).convolve();
        let mean = irradiance.coefficients[0].map(|c| c * gdibl_runtime::sh::Y00);
        let floor = mean.map(|m| RINGING * m.abs());
        let negative = |d: &[f32; 3]| irradiance.evaluate(*d).iter().zip(&floor).any(|(e, floor)| e < floor);
        nodes_negative += usize::from(directions.iter().any(negative));
        means.push(mean);
    }
    let errors: Option<Vec<f64>> = valid.iter().map(|&n| volume.node_relative_error(n).map(f64::from)).collect();
    let errors = errors.unwrap_or_default();
    let mut by_error: Vec<usize> = (0..errors.len()).collect();
    by_error.sort_by(|&a, &b| errors[b].total_cmp(&errors[a]).then(a.cmp(&b)));
    VolumeSummary {
        nodes: volume.node_count(),
        nodes_valid: valid.len(),
        irradiance: [0, 1, 2].map(|channel| Range::of(means.iter().map(|m| f64::from(m[channel])))),
        luminance_stops: Histogram::of(means.iter().map(|m| 0.2126 * m[0] + 0.7152 * m[1] + 0.0722 * m[2])),
        nodes_negative,
        coverage: Range::of(valid.iter().map(|&n| f64::from(volume.node_coverage(n)))),
        relative_error: ErrorSummary::of(errors.iter().copied()),
        worst: by_error
            .iter()
            .take(WORST)
            .map(|&i| NodeFigure {
                node: valid[i],
                position: volume.node_position(valid[i]),
                relative_error: errors[i],
            })
            .collect(),
    }
}

impl Range {
    fn of(values: impl Iterator<Item = f64>) -> Range {
        let (mut range, mut count) = (Range { min: f64::INFINITY, mean: 0.0, max: f64::NEG_INFINITY }, 0.0);
        for value in values {
            range = Range { min: range.min.min(value), mean: range.mean + value, max: range.max.max(value) };
            count += 1.0;
        }
        if count == 0.0 { Range::default() } else { Range { mean: range.mean / count, ..range } }
    }
}

impl Histogram {
    fn of(luminances: impl Iterator<Item = f32>) -> Histogram {
        let (mut stops, mut black) = (Vec::new(), 0);
        for luminance in luminances {
            if luminance > 0.0 { stops.push(luminance.log2().floor() as i32) } else { black += 1 }
        }
        let first = stops.iter().copied().min().unwrap_or(0);
        let last = stops.iter().copied().max().unwrap_or(-1);
        let mut counts = vec![0; (last - first + 1).max(0) as usize];
        stops.iter().for_each(|stop| counts[(stop - first) as usize] += 1);
        Histogram { first, counts, black }
    }
}
