//! Where a volume is worst, and how good each part of it is.

use gdibl_runtime::Volume;
use serde::Serialize;

use super::figures::{Figure, Figures};
use crate::job::records::ErrorSummary;

/// A node that stands out.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorstNode {
    /// Index in the file.
    pub node: usize,
    /// World metres.
    pub position: [f64; 3],
    /// The figure there.
    pub value: f64,
}

/// The worst nodes by one kind of figure, the worst first.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorstNodes {
    /// Which.
    pub figure: Figure,
    /// Baked nodes alone.
    pub nodes: Vec<WorstNode>,
}

/// Kinds of error that nodes are ranked by.
const RANKED: [Figure; 3] = [Figure::Noise, Figure::Systematic, Figure::Coverage];

/// At most `count` nodes of each kind of error that the file tells of. A figure that is nowhere wrong is left out.
pub fn worst_nodes(volume: &Volume, figures: &Figures, count: usize) -> Vec<WorstNodes> {
    RANKED.into_iter().filter_map(|figure| worst_of(volume, figures, figure, count)).collect()
}

fn worst_of(volume: &Volume, figures: &Figures, figure: Figure, count: usize) -> Option<WorstNodes> {
    let values = figures.of(figure)?;
    let perfect = if figure.less_is_worse() { 1.0 } else { 0.0 };
    let mut order: Vec<usize> = (0..values.len()).filter(|n| volume.is_valid(*n) && values[*n] != perfect).collect();
    let worse_first = |a: &usize, b: &usize| {
        let rising = values[*a].total_cmp(&values[*b]);
        (if figure.less_is_worse() { rising } else { rising.reverse() }).then(a.cmp(b))
    };
    if order.len() > count && count > 0 {
        order.select_nth_unstable_by(count - 1, worse_first);
        order.truncate(count);
    }
    order.sort_by(worse_first);
    let node = |node: usize| WorstNode { node, position: volume.node_position(node), value: f64::from(values[node]) };
    let nodes: Vec<WorstNode> = order.into_iter().take(count).map(node).collect();
    (!nodes.is_empty()).then_some(WorstNodes { figure, nodes })
}

/// A part of a volume: the nodes in a box of the lattice that divides it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Region {
    /// Lower corner of its nodes, world metres.
    pub min: [f64; 3],
    /// Upper corner.
    pub max: [f64; 3],
    /// How many.
    pub nodes: usize,
    /// Baked ones. The figures below are theirs.
    pub nodes_valid: usize,
    /// Mean irradiance over all directions and nodes, linear RGB.
    pub irradiance: [f64; 3],
    /// `None` where it was not measured.
    pub noise: Option<ErrorSummary>,
    /// `None` where nothing tells.
    pub systematic: Option<ErrorSummary>,
    /// Least.
    pub coverage: f64,
}

/// Boxes along the longest axis.
const REGIONS: f64 = 8.0;

/// The volume by the boxes of a lattice of cubes, eight along its longest axis; those without a node are left out. In order of
/// z, y, x.
pub fn regions(volume: &Volume, figures: &Figures) -> Vec<Region> {
    let header = volume.header();
    let size = (0..3).map(|axis| header.max[axis] - header.min[axis]).fold(0.0, f64::max);
    let edge = if size > 0.0 { size / REGIONS } else { 1.0 };
    let cube_of = |position: [f64; 3]| -> [i64; 3] {
        // The last node of an axis belongs to the last cube.
        let along = |axis: usize| {
            let last = (((header.max[axis] - header.min[axis]) / edge).ceil() as i64 - 1).max(0);
            (((position[axis] - header.min[axis]) / edge) as i64).clamp(0, last)
        };
        [along(2), along(1), along(0)]
    };
    let mut cubes: std::collections::BTreeMap<[i64; 3], Vec<usize>> = Default::default();
    for node in 0..volume.node_count() {
        cubes.entry(cube_of(volume.node_position(node))).or_default().push(node);
    }
    cubes.into_values().map(|nodes| region(volume, figures, &nodes)).collect()
}

fn region(volume: &Volume, figures: &Figures, nodes: &[usize]) -> Region {
    let corner = |pick: fn(f64, f64) -> f64| {
        let positions = nodes.iter().map(|node| volume.node_position(*node));
        positions.reduce(|a, b| [0, 1, 2].map(|axis| pick(a[axis], b[axis]))).unwrap_or_default()
    };
    let valid: Vec<usize> = nodes.iter().copied().filter(|node| volume.is_valid(*node)).collect();
    let summary = |figure: Figure| {
        let values = figures.of(figure)?;
        ErrorSummary::of(valid.iter().map(|node| f64::from(values[*node])))
    };
    let mut irradiance = [0.0; 3];
    for &node in &valid {
        let mean = volume.node_sh(node).convolve().coefficients[0];
        (0..3).for_each(|c| irradiance[c] += f64::from(mean[c] * gdibl_runtime::sh::Y00) / valid.len() as f64);
    }
    Region {
        min: corner(f64::min),
        max: corner(f64::max),
        nodes: nodes.len(),
        nodes_valid: valid.len(),
        irradiance,
        noise: summary(Figure::Noise),
        systematic: summary(Figure::Systematic),
        coverage: valid.iter().map(|node| f64::from(volume.node_coverage(*node))).fold(1.0, f64::min),
    }
}
