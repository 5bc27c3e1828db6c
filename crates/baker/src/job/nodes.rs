//! Where the settings want nodes, and the box of a grid.

use gdibl_runtime::grid::Grid;
use glam::DVec3;

use super::plan;
use super::records::PlanRow;
use super::settings::{GridSettings, Settings};
use super::spacing::Limits;
use super::stop::Stop;
use super::text::NodeKind;
use crate::Finding;
use crate::air::Air;
use crate::bake::{Nodes, grid_of_cells, grid_of_counts, grid_of_nodes, grid_of_spacing, widest_spacing};
use crate::scene::{Scene, VolumeMarker};

/// Nodes farther apart than this share of the height of rooms miss what light does in them.
const WIDE_INDOORS: f64 = 0.5;
/// The same where most is in the open: what is under a ceiling there may be under a table.
const WIDE_OUTDOORS: f64 = 4.0;
/// Longest edges of boxes that are likely to be in metres.
const LIKELY: std::ops::RangeInclusive<f64> = 0.01..=10_000.0;

/// Where light is baked, and how that was chosen.
#[derive(Debug)]
pub(super) struct Placed {
    pub nodes: Nodes,
    /// Nobody says how fine the grid is: it is the finest that is allowed.
    pub is_open: bool,
    /// Where the box of a grid is from.
    pub row: PlanRow,
    /// What is wrong with box or spacing.
    pub findings: Vec<Finding>,
}

/// The nodes that the settings ask for, in the box of a marker where there is one. `places` are those of `--nodes points:FILE`,
/// `level` names the level.
pub(super) fn nodes_of(
    settings: &Settings,
    scene: &Scene,
    markers: &[VolumeMarker],
    places: &[DVec3],
    level: &str,
) -> Result<Placed, Stop> {
    let grid = &settings.grid;
    let by_grid = [&grid.max_nodes, &grid.max_bytes].into_iter().any(Option::is_some)
        || [&grid.spacing, &grid.tolerance, &grid.budget].into_iter().any(Option::is_some)
        || grid.bounds.is_some()
        || grid.counts.is_some();
    let without_box =
        |nodes| Placed { nodes, is_open: false, row: plan::bounds_given("nodes are no grid"), findings: Vec::new() };
    match &grid.nodes {
        NodeKind::Grid => grid_of(grid, scene, markers, level),
        kind if by_grid => Err(Stop::Usage(format!(
            "--bounds, --spacing, --counts, --max-nodes, --max-bytes, --budget and --tolerance belong to --nodes grid; \
             here it is {kind}"
        ))),
        NodeKind::Vertices => {
            let nodes = Nodes::vertices_of(scene);
            if nodes.is_empty() {
                return Err(Stop::Invalid(format!("{level}: has no vertices to bake")));
            }
            Ok(without_box(nodes))
        }
        NodeKind::Points(_) => Ok(without_box(Nodes::Points(places.to_vec()))),
    }
}

fn grid_of(settings: &GridSettings, scene: &Scene, markers: &[VolumeMarker], level: &str) -> Result<Placed, Stop> {
    let GridSettings { bounds, spacing, counts, tolerance, .. } = settings;
    if spacing.is_some() && counts.is_some() {
        return Err(Stop::Usage("spacing and counts contradict each other: give one of them".into()));
    }
    let is_bounded = settings.max_nodes.is_some() || settings.max_bytes.is_some() || settings.budget.is_some();
    if is_bounded && (spacing.is_some() || counts.is_some()) {
        return Err(Stop::Usage(
            "--max-nodes, --max-bytes and --budget choose the spacing; leave out --spacing and --counts".into(),
        ));
    }
    if tolerance.is_some() && (settings.max_bytes.is_some() || settings.budget.is_some()) {
        return Err(Stop::Usage(
            "--max-bytes and --budget choose the spacing of a dense grid; leave out --tolerance".into(),
        ));
    }
    let marker = match markers {
        [] => None,
        _ if bounds.is_some() => None,
        [marker] => Some(marker),
        several => {
            return Err(Stop::Usage(format!(
                "{level}: {} nodes carry gdibl_volume, and this makes one volume; choose a box with --bounds",
                several.len()
            )));
        }
    };
    // A box that is given always wins.
    let mut air = None;
    let (min, max) = match (bounds, marker) {
        (Some([x0, y0, z0, x1, y1, z1]), _) => (DVec3::new(*x0, *y0, *z0), DVec3::new(*x1, *y1, *z1)),
        (None, Some(marker)) => marker.bounds(),
        (None, None) => {
            let none = || Stop::Usage(format!("{level}: has no triangles, so no box; give --bounds"));
            air.insert(Air::of(scene).ok_or_else(none)?).bounds
        }
    };
    let row = match (&air, marker) {
        (Some(air), _) => plan::bounds(air, scene),
        (None, Some(marker)) => plan::bounds_given(&format!("the box is that of the node '{}'", marker.name)),
        (None, None) => plan::bounds_given("the box is given"),
    };
    let grid = match (counts, spacing.or(marker.map(|marker| marker.spacing))) {
        (Some(counts), _) => grid_of_counts(min, max, *counts),
        (None, Some(spacing)) => grid_of_spacing(min, max, spacing),
        (None, None) => grid_of_nodes(min, max, Limits::of(settings, None).nodes),
    };
    let is_open = counts.is_none() && spacing.is_none() && marker.is_none() && tolerance.is_none();
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
    let findings = air.map_or_else(Vec::new, |air| findings_of(&air, &grid));
    Ok(Placed { nodes: Nodes::Grid(grid), is_open, row, findings })
}

/// What is wrong with the box of a level and the spacing of nodes in it.
fn findings_of(air: &Air, grid: &Grid) -> Vec<Finding> {
    let length = plan::length;
    let size = (air.bounds.1 - air.bounds.0).max_element();
    let units = (size > 0.0 && !LIKELY.contains(&size)).then(|| {
        let message = format!("a level of {}: are its units metres, as glTF means them?", length(size));
        Finding::new("units", 1, message)
    });
    let spacing = widest_spacing(grid);
    let wide = if air.is_indoors { WIDE_INDOORS } else { WIDE_OUTDOORS };
    let spacing_wide = air.headroom.filter(|headroom| spacing > wide * headroom).map(|headroom| {
        let message = format!(
            "nodes are {} apart, and ceilings {} high: what light does under them is lost; use a smaller --spacing, {} \
             say, or the box of the rooms by --bounds",
            length(spacing),
            length(headroom),
            length(WIDE_INDOORS * headroom)
        );
        Finding::new("spacing-wide", 1, message)
    });
    units.into_iter().chain(spacing_wide).collect()
}
