//! What came of a bake, in figures.

use super::records::{
    ErrorSummary, ProbeRecord, QuarterRecord, SeenRecord, StandingRecord, StatisticsRecord, WallsRecord,
};
use crate::Finding;
use crate::bake::{Baked, Quarter, Standing};
use crate::radiance::Distant;
use crate::radiance::gdibl::Probe;

/// Bands that lose this share of irradiance, root mean square over places, lose much of a sun.
const MUCH_OF_A_SUN: f64 = 0.05;

impl StatisticsRecord {
    /// What a volume itself tells: without findings, stages, and what was left out of its light.
    pub fn of(baked: &Baked) -> StatisticsRecord {
        let errors = |all: &[f32]| {
            let known = baked.valid_nodes().filter_map(|node| all.get(node));
            ErrorSummary::of(known.map(|error| f64::from(*error)))
        };
        let valid = baked.valid_nodes().count() as u64;
        let uncovered = count(baked, Standing::Uncovered);
        let covered: f64 = baked.coverage.iter().map(|coverage| f64::from(*coverage)).sum();
        StatisticsRecord {
            nodes: baked.len() as u64,
            nodes_valid: valid,
            rays: baked.rays,
            samples: baked.samples,
            relative_error: errors(&baked.relative_error),
            worst_direction_error: errors(&baked.worst_error),
            coverage: covered / (valid + uncovered).max(1) as f64,
            standing: StandingRecord {
                uncovered,
                solid: count(baked, Standing::Solid),
                outside: count(baked, Standing::Outside),
                moved: baked.moved.len() as u64,
            },
            walls: baked.walls.as_ref().map(WallsRecord::from),
            systematic_error: errors(&baked.systematic_error),
            quarters: quarters(baked),
            ..StatisticsRecord::default()
        }
    }
}

fn quarters(baked: &Baked) -> Vec<QuarterRecord> {
    let all = baked.quarters.into_iter().flatten();
    all.zip(1..)
        .map(|(Quarter { noise, whole }, i)| QuarterRecord { share: f64::from(i) / 4.0, noise, whole, seconds: None })
        .collect()
}

fn count(baked: &Baked, of: Standing) -> u64 {
    baked.standing.iter().filter(|standing| **standing == of).count() as u64
}

/// Without a valid node there is no light.
///
/// # Errors
/// Why no node has light of its own, and what to look at.
pub fn check_valid(baked: &Baked) -> Result<(), String> {
    if baked.valid_nodes().next().is_some() {
        return Ok(());
    }
    let [uncovered, solid, outside] =
        [Standing::Uncovered, Standing::Solid, Standing::Outside].map(|standing| count(baked, standing));
    let advice = match uncovered {
        0 => "are the nodes in the level's rooms, and do its triangles face them (front: counter-clockwise)?",
        _ => "are the probes' positions in the level's metres, inside the same rooms as the nodes, not in a wall?",
    };
    Err(format!(
        "no node of {} has light of its own, so there is nothing to fill from and nothing was written: {uncovered} saw \
         nothing that a probe or the distant panorama has seen, {solid} are in solids, {outside} behind the level's surfaces; \
         {advice}",
        baked.len()
    ))
}

/// The findings of what was baked.
pub fn findings_of(baked: &Baked, clamp: f32) -> Vec<Finding> {
    let clamped = (baked.clamped > 0.0).then(|| {
        let message = format!("--clamp {clamp} took {:.3} % of the light away", baked.clamped * 100.0);
        Finding::new("clamped-light", 1, message)
    });
    let dropped = baked.walls.as_ref().map_or(0, |walls| walls.dropped);
    let dropped = (dropped > 0).then(|| {
        let message = format!(
            "{dropped} cells with walls are left as if they had none: a file holds at most 65535 planes; split the volume, or \
             bake with a larger --spacing"
        );
        Finding::new("dropped-walls", dropped as u64, message)
    });
    let is_dark = baked.valid_nodes().all(|node| baked.node(node).iter().all(|value| *value == 0.0));
    let dark = is_dark.then(|| {
        let message = "no light reaches any node: is the level closed under its sky, or are its lamps outside of it?";
        Finding::new("no-light", 1, message)
    });
    clamped.into_iter().chain(dropped).chain(dark).collect()
}

/// A sun of which the bands that are stored lose much: a finding, with what to do.
pub fn blurred_sun(seen: &SeenRecord, distant: Option<&Distant>) -> Option<Finding> {
    let sets = [seen.air, seen.surfaces].into_iter().flatten();
    let lost = sets.map(|set| set.parts.bands).fold(0.0, f64::max);
    let distant = distant.filter(|distant| lost > MUCH_OF_A_SUN && Distant::clone(distant).extract_sun().is_some())?;
    let message = format!(
        "{}: the bands that are stored blur its sun: irradiance is off by {:.0} % from that (root mean square); --sun extract \
         leaves the sun's direct light to the engine, sharp",
        distant.name,
        100.0 * lost
    );
    Some(Finding::new("sun-blurred", 1, message))
}

/// Probes, then the distant panorama.
pub fn probe_records(probes: &[Probe], distant: Option<&Distant>) -> Vec<ProbeRecord> {
    let probes = probes.iter().map(|probe| ProbeRecord {
        name: probe.name.clone(),
        position: Some(probe.position.into()),
        rotation: probe.rotation.into(),
        exposure_stops: probe.exposure_stops,
        size: [probe.panorama.width() as u32, probe.panorama.height() as u32],
        distance: probe.panorama.distances().is_some(),
    });
    // The black one that stands behind captured probes has no name: nobody gave it.
    let given = distant.filter(|distant| !distant.name.is_empty()).map(|distant| ProbeRecord {
        name: distant.name.clone(),
        position: None,
        rotation: distant.rotation.into(),
        exposure_stops: distant.exposure_stops,
        size: [distant.panorama.width() as u32, distant.panorama.height() as u32],
        distance: distant.panorama.distances().is_some(),
    });
    probes.chain(given).collect()
}
