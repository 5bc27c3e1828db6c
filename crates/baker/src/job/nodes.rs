//! Where the settings want nodes.

use glam::DVec3;

use super::settings::{GridSettings, Settings};
use super::stop::Stop;
use super::text::NodeKind;
use crate::bake::{Nodes, grid_of_cells, grid_of_counts, grid_of_spacing};
use crate::scene::Scene;

/// Nodes along the longest axis when nothing is said.
const DEFAULT_NODES: f64 = 32.0;

/// The nodes that the settings ask for. `places` are those of `--nodes points:FILE`, `level` names the level.
pub(super) fn nodes_of(settings: &Settings, scene: &Scene, places: &[DVec3], level: &str) -> Result<Nodes, Stop> {
    let grid = &settings.grid;
    let by_grid = grid.bounds.is_some() || grid.spacing.is_some() || grid.counts.is_some() || grid.tolerance.is_some();
    match &grid.nodes {
        NodeKind::Grid => grid_of(grid, scene, level),
        kind if by_grid => Err(Stop::Usage(format!(
            "--bounds, --spacing, --counts and --tolerance belong to --nodes grid; here it is {kind}"
        ))),
        NodeKind::Vertices => {
            let nodes = Nodes::vertices_of(scene);
            if nodes.is_empty() {
                return Err(Stop::Invalid(format!("{level}: has no vertices to bake")));
            }
            Ok(nodes)
        }
        NodeKind::Points(_) => Ok(Nodes::Points(places.to_vec())),
    }
}

fn grid_of(settings: &GridSettings, scene: &Scene, level: &str) -> Result<Nodes, Stop> {
    let GridSettings { bounds, spacing, counts, tolerance, .. } = settings;
    if spacing.is_some() && counts.is_some() {
        return Err(Stop::Usage("spacing and counts contradict each other: give one of them".into()));
    }
    let marker = match &scene.volume_markers[..] {
        [] => None,
        _ if bounds.is_some() => None,
        [marker] => Some(marker),
        several => {
            return Err(Stop::Usage(format!(
                "{level}: {} nodes carry gdibl_volume, and one bake makes one volume; choose a box with --bounds",
                several.len()
            )));
        }
    };
    let (min, max) = match (bounds, marker) {
        (Some([x0, y0, z0, x1, y1, z1]), _) => (DVec3::new(*x0, *y0, *z0), DVec3::new(*x1, *y1, *z1)),
        (None, Some(marker)) => marker.bounds(),
        (None, None) => scene
            .bounds(|_| true)
            .ok_or_else(|| Stop::Usage(format!("{level}: has no triangles, so no box; give --bounds")))?,
    };
    let grid = match (counts, spacing.or(marker.map(|marker| marker.spacing))) {
        (Some(counts), _) => grid_of_counts(min, max, *counts),
        (None, Some(spacing)) => grid_of_spacing(min, max, spacing),
        (None, None) => grid_of_spacing(min, max, (max - min).max_element() / (DEFAULT_NODES - 1.0)),
    };
    let grid = if tolerance.is_some() { grid_of_cells(grid) } else { grid };
    let [x, y, z] = grid.counts;
    let nodes = f64::from(x) * f64::from(y) * f64::from(z);
    if nodes > f64::from(u32::MAX) {
        let gib = nodes * 324.0 / f64::from(1 << 30);
        return Err(Stop::Memory(format!(
            "a grid of {x} x {y} x {z} = {nodes:.3e} nodes would need about {gib:.1e} GiB; a volume holds at most 2^32 \
             nodes; use a larger --spacing or smaller --bounds"
        )));
    }
    Ok(Nodes::Grid(grid))
}
