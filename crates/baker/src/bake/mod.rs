//! From a radiance function and nodes to baked coefficients: samples every node, stops it, fills invalid ones. Beside
//! it [`irradiance_at`]: E at places of surfaces, without coefficients.
//!
//! Parallel over nodes; every result has its own place, so bytes do not depend on the number of threads.

mod baked;
mod cells;
mod directions;
mod fill;
mod finite;
mod gather;
mod integrate;
mod irradiance;
mod nodes;
pub(crate) mod pass;
mod sample;
mod sealed;
mod sparse;
mod standing;
mod summary;
mod systematic;
pub(crate) mod walls;

use gdibl_runtime::sh;

pub use baked::{BakeSettings, Baked, Quarter, Walls};
pub(crate) use cells::Cells;
pub use finite::check_finite;
pub(crate) use gather::propose_on_surface;
pub use gather::{GatherSettings, Gathered, SurfacePlace, irradiance_at};
pub use gdibl_runtime::walls::WallCell;
pub use integrate::{INTERVAL_95, WHOLE_INTERVAL_95};
pub(crate) use irradiance::{Irradiance, difference, irradiance_of, root_mean_square, strength};
pub use nodes::{Nodes, SparseGrid, VertexSet, grid_of_counts, grid_of_nodes, grid_of_spacing, widest_spacing};
use sample::{Batch, Sampled, Scale};
pub use sealed::Shells;
pub use sparse::{bake_sparse, grid_of_cells, levels_of};
pub use standing::{Standing, any_open};
use summary::Summary;
use systematic::systematic_errors;

use crate::radiance::RadianceFunction;
use crate::rows::Table;
use crate::{Control, Interrupted};

/// Bytes that a bake of `nodes` nodes takes at its peak, at most, beside the level: coefficients, figures, and the file's sections
/// beside them. A million L2 nodes take 312 MB by this; 219 were measured in f16, 224 packed (`tools/scaling_bench`). `is_paged`: what
/// nodes come to is in a file once it is large.
pub fn memory_needed(nodes: u64, settings: &BakeSettings, is_paged: bool) -> u64 {
    let coefficients = 4 * 3 * sh::coefficient_count(settings.bands) as u64;
    let errors = if settings.coefficient_errors { coefficients } else { 0 };
    let held = nodes.saturating_mul(2 * (coefficients + errors) + size_of::<Summary>() as u64 + 48);
    // The sections of an f32 file, figures, and where blocks are in the journal.
    let paged = nodes.saturating_mul(coefficients + 2 * errors + 48).saturating_add(PAGES);
    if is_paged { held.min(paged) } else { held }
}

/// Pages of tables in memory, and tables that are not large.
const PAGES: u64 = 256 << 20;

/// Bakes every node.
pub fn bake(
    nodes: &Nodes,
    function: &impl RadianceFunction,
    settings: &BakeSettings,
    control: &Control,
) -> Result<Baked, Interrupted> {
    assert!(settings.bands <= sh::MAX_BANDS, "bands {} of at most {}", settings.bands, sh::MAX_BANDS);
    assert!((1..=BakeSettings::MAX_SAMPLES).contains(&settings.samples), "samples {}", settings.samples);
    let numbers = (0..nodes.len() as u32).collect();
    let batch = Batch::sample(nodes, numbers, None, function, settings, control)?;
    finish(nodes, function, settings, control, batch)
}

/// Figures and what lies between nodes, once all are sampled.
fn finish(
    nodes: &Nodes,
    function: &impl RadianceFunction,
    settings: &BakeSettings,
    control: &Control,
    Batch { sites, sampled, scale: Scale { median, .. } }: Batch,
) -> Result<Baked, Interrupted> {
    let Sampled { sh, mut coefficient_error, estimates, rays, samples } = sampled;
    let is_open: Vec<bool> = sites.standing.iter().map(|standing| *standing == Standing::Open).collect();
    let valid = || estimates.firsts().zip(&is_open).map(|(e, open)| (e, *open));
    let errors = |own: fn(&Summary) -> f64| -> Vec<f32> {
        valid().map(|(e, valid)| if valid { e.relative(own(&e), median) as f32 } else { 0.0 }).collect()
    };
    let relative_error = errors(|e| e.standard_error);
    let worst_error = errors(|e| e.worst_error);
    let open: Vec<u32> = (0..is_open.len() as u32).filter(|place| is_open[*place as usize]).collect();
    let systematic_error = systematic_errors(&open, &estimates, median);
    let stride = 3 * sh::coefficient_count(settings.bands);
    for (errors, _) in coefficient_error.chunks_exact_mut(stride).zip(&is_open).filter(|(_, valid)| !**valid) {
        errors.fill(0.0);
    }
    let quarters = quarters(&open, &estimates, &systematic_error, median);
    let target = settings.target_error.unwrap_or(f64::INFINITY) as f32;
    let total = |of: fn(&Summary) -> f64| valid().filter(|(_, valid)| *valid).map(|(e, _)| of(&e)).sum::<f64>();
    let (clamped, kept) = (total(|e| e.clamped), total(|e| e.kept));
    let moved = sites.moved(function);
    let mut baked = Baked {
        bands: settings.bands,
        sh,
        coverage: valid().map(|(e, valid)| if valid { e.coverage as f32 } else { 0.0 }).collect(),
        missed: relative_error.iter().zip(&systematic_error).filter(|(n, s)| n.hypot(**s) > target).count() as u64,
        missed_by_systematic: systematic_error.iter().filter(|e| **e > target).count() as u64,
        systematic_error,
        relative_error,
        worst_error,
        coefficient_error,
        standing: sites.standing.clone(),
        moved,
        walls: None,
        rays: rays + sites.rays,
        samples,
        clamped: if clamped > 0.0 { clamped / (clamped + kept) } else { 0.0 },
        quarters,
    };
    let place = |node| sites.place(node, nodes, function);
    let mut rays = fill::fill(nodes, &mut baked, function, place, control)?;
    if let Some(cells) = Cells::of(nodes) {
        let (walls, more) = walls::find(cells, &baked, function, place, control)?;
        baked.walls = walls;
        rays += more;
    }
    (control.progress)(0, rays);
    baked.rays += rays;
    Ok(baked)
}

/// Errors after each quarter of the directions, over those nodes at which they were looked at.
fn quarters(open: &[u32], estimates: &Table<Summary>, systematic: &[f32], median: f64) -> Option<[Quarter; 4]> {
    let all = open.iter().map(|node| (estimates.first(*node as usize), systematic[*node as usize]));
    let watched: Vec<(Summary, f32)> =
        all.filter(|(estimate, _)| estimate.quarters.iter().all(|error| *error > 0.0)).collect();
    let middle = |of: &dyn Fn(&(Summary, f32)) -> f64| {
        let mut values: Vec<f64> = watched.iter().map(of).collect();
        let middle = values.len() / 2;
        (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
    };
    let after = |quarter: usize| {
        let noise = |(estimate, _): &(Summary, f32)| {
            let error = estimate.quarters.get(quarter).copied().unwrap_or(estimate.standard_error);
            estimate.relative(error, median)
        };
        let whole = |node: &(Summary, f32)| noise(node).hypot(f64::from(node.1));
        Some(Quarter { noise: middle(&noise)?, whole: middle(&whole)? })
    };
    Some([after(0)?, after(1)?, after(2)?, after(3)?])
}
