//! Part of a volume, and what it takes over of it.

use gdibl_runtime::bricks::Bricks;
use gdibl_runtime::{Grid, RadianceSh, Volume, sh};

use crate::bake::{Baked, Nodes, SparseGrid, Standing};
use crate::job::records::{ErrorSummary, Records, WallsRecord};
use crate::rows::Table;

/// Nodes with their light, ready to be packed.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// Where they are.
    pub nodes: Nodes,
    /// Their light.
    pub baked: Baked,
}

/// What a cut takes over of a node, or of a place between nodes.
pub(super) struct Light {
    pub sh: RadianceSh,
    pub is_valid: bool,
    pub coverage: f32,
    pub relative_error: f32,
}

impl Light {
    /// That of a node.
    pub fn of(volume: &Volume, node: usize) -> Light {
        Light {
            sh: volume.node_sh(node),
            is_valid: volume.is_valid(node),
            coverage: volume.node_coverage(node),
            relative_error: volume.node_relative_error(node).unwrap_or(f32::INFINITY),
        }
    }

    /// Blended of nodes, of which valid ones count, if there are any. Weights add up to 1.
    pub fn blended(volume: &Volume, nodes: &[u32; 8], weights: &[f32; 8]) -> Light {
        let valid = |k: &usize| weights[*k] > 0.0 && volume.is_valid(nodes[*k] as usize);
        let share: f32 = (0..8).filter(valid).map(|k| weights[k]).sum();
        let (is_valid, total) = if share > 0.0 { (true, share) } else { (false, 1.0) };
        let mut light =
            Light { sh: RadianceSh::zero(volume.header().bands), is_valid, coverage: 0.0, relative_error: 0.0 };
        for k in (0..8).filter(|k| weights[*k] > 0.0 && (!is_valid || valid(k))) {
            let (node, weight) = (Light::of(volume, nodes[k] as usize), weights[k] / total);
            light.sh.add_scaled(&node.sh, weight);
            light.coverage += weight * node.coverage;
            light.relative_error += weight * node.relative_error;
        }
        light
    }
}

impl Part {
    /// Takes `light` at every node of a grid, or of the places in it that are nodes.
    pub(super) fn new(grid: Grid, bricks: Option<Bricks>, bands: u32, light: impl Fn([u32; 3]) -> Light) -> Part {
        let nodes = match bricks {
            None => Nodes::Grid(grid),
            Some(bricks) => Nodes::Sparse(SparseGrid { grid, bricks }),
        };
        let count = 3 * sh::coefficient_count(bands);
        let mut baked = Baked::of_rows(bands, Table::zeros(nodes.len(), count, None));
        for node in 0..nodes.len() {
            let light = light(match &nodes {
                Nodes::Sparse(sparse) => sparse.bricks.place_of(node),
                _ => grid.place_of(node as u32),
            });
            baked.sh.set(node, &light.sh.coefficients.as_flattened()[..count]);
            baked.standing[node] = if light.is_valid { Standing::Open } else { Standing::Uncovered };
            baked.coverage[node] = light.coverage;
            baked.relative_error[node] = light.relative_error;
        }
        Part { nodes, baked }
    }

    /// The records of the volume that this was cut from, with its own figures in place of those that are others now.
    pub fn records(&self, mut records: Records) -> Records {
        let Baked { walls, relative_error, .. } = &self.baked;
        let Some(statistics) = &mut records.statistics else { return records };
        let valid = || self.baked.valid_nodes();
        statistics.nodes = self.nodes.len() as u64;
        statistics.nodes_valid = valid().count() as u64;
        statistics.relative_error = ErrorSummary::of(valid().map(|node| f64::from(relative_error[node])));
        statistics.coverage =
            valid().map(|node| f64::from(self.baked.coverage[node])).sum::<f64>() / valid().count().max(1) as f64;
        statistics.walls = walls.as_ref().map(WallsRecord::from);
        (statistics.worst_direction_error, statistics.sparse, statistics.packing) = (None, None, None);
        (statistics.systematic_error, statistics.seen) = (None, None);
        statistics.seen_places.clear();
        statistics.quarters.clear();
        records
    }
}

/// The node at a place of a volume's grid.
pub(super) fn node_at(volume: &Volume, grid: &Grid, place: [u32; 3]) -> Option<u32> {
    match volume.bricks() {
        None => Some(grid.index_of(place)),
        Some(bricks) => bricks.node_at(place),
    }
}
