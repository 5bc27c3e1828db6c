//! The small records of a file: settings, plan, probes, statistics. What was asked for and what came of it, for
//! `inspect`; the runtime skips them. Encoded by bincode's legacy fixed-int rules, restated in FORMAT.md in bytes.
//! Nothing here may depend on the clock or the machine: same inputs and settings, same bytes.

use bincode::{Decode, Encode};
use serde::Serialize;

use crate::bake::Walls;
use crate::panorama::Sun;
pub use crate::plan::PlanRow;
use crate::{Error, Finding, Result};

/// What was asked for.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Encode, Decode)]
pub struct SettingsRecord {
    /// `gdibl` and its version.
    pub writer: String,
    /// File name of the level, without folder.
    pub level: String,
    /// The radiance function: `gdibl` or `path`.
    pub method: String,
    /// Blend rule with its power, as on the command line.
    pub blend: String,
    /// What rays do at scene geometry, as on the command line.
    pub scene: String,
    /// `sobol` or `random`.
    pub sampler: String,
    /// Directions per node, or the most of them.
    pub samples: u64,
    /// Relative error at which a node stops.
    pub target_error: Option<f64>,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// One probe, or the distant panorama.
#[derive(Debug, Clone, PartialEq, Serialize, Encode, Decode)]
pub struct ProbeRecord {
    /// File name, without folder.
    pub name: String,
    /// World metres; `None` for the distant panorama.
    pub position: Option<[f64; 3]>,
    /// Quaternion x y z w, probe to world.
    pub rotation: [f32; 4],
    /// Radiance = pixel × 2^exposure_stops.
    pub exposure_stops: f32,
    /// Pixels per row and rows.
    pub size: [u32; 2],
    /// It tells distances.
    pub distance: bool,
}

/// What came of it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Encode, Decode)]
pub struct StatisticsRecord {
    /// Nodes in the volume.
    pub nodes: u64,
    /// Nodes with light of their own.
    pub nodes_valid: u64,
    /// Rays traced, lines of sight included.
    pub rays: u64,
    /// Directions that left nodes.
    pub samples: u64,
    /// Relative standard error of E over valid nodes; `None` where it was not measured (one sample).
    pub relative_error: Option<ErrorSummary>,
    /// The same in the worst direction and channel of each node.
    pub worst_direction_error: Option<ErrorSummary>,
    /// Mean share of the sphere that was covered, over the nodes in the open.
    pub coverage: f64,
    /// Why nodes have no light of their own, or take it elsewhere.
    pub standing: StandingRecord,
    /// What keeps light on its side of walls; `None` where no wall stands between nodes of a grid.
    pub walls: Option<WallsRecord>,
    /// How sparse the grid is and how good; `None` where no tolerance was given, or the grid has no coarser cells.
    pub sparse: Option<SparseRecord>,
    /// What de-ringing did; `None` where it was not asked for, or no node rings.
    pub deringing: Option<DeringingRecord>,
    /// What packed coefficients add to the error; `None` in files of floats.
    pub packing: Option<PackingRecord>,
    /// The sun whose direct light was left out; `None` where that was not asked for, or no sun found.
    pub sun: Option<SunRecord>,
    /// What the inputs had that deserves a look.
    pub findings: Vec<Finding>,
}

/// Where nodes stand.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Encode, Decode)]
pub struct StandingRecord {
    /// In the open, but no probe has seen anything they see.
    pub uncovered: u64,
    /// In solids.
    pub solid: u64,
    /// Behind the level's surfaces, outside of it.
    pub outside: u64,
    /// Stepped off a surface, or out of a solid: their light is that of the place beside.
    pub moved: u64,
}

/// A sparse grid.
#[derive(Debug, Clone, PartialEq, Serialize, Encode, Decode)]
pub struct SparseRecord {
    /// Relative error of E between nodes at which cells were divided.
    pub tolerance: f64,
    /// Places of the fine grid: the nodes it would have without being sparse.
    pub places: u64,
    /// By size, the finest first.
    pub levels: Vec<SparseLevel>,
}

/// The cells of one size.
#[derive(Debug, Clone, PartialEq, Serialize, Encode, Decode)]
pub struct SparseLevel {
    /// How many there are.
    pub cells: u64,
    /// Places in them that were baked and are no nodes: middles, and of larger cells those of faces, too.
    pub checked: u64,
    /// What the volume answers there against what was baked: root mean square over normals and channels, over the larger of the
    /// place's own and a tenth of the volume's median. Noise of both is in it. `None` where nothing was checked.
    pub error: Option<ErrorSummary>,
}

/// Walls between nodes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Encode, Decode)]
pub struct WallsRecord {
    /// Cells that walls go through.
    pub cells: u64,
    /// Planes that cut them.
    pub planes: u64,
}

impl From<&Walls> for WallsRecord {
    fn from(walls: &Walls) -> WallsRecord {
        WallsRecord { cells: walls.cells.len() as u64, planes: walls.planes.len() as u64 }
    }
}

/// A sun that was taken out of the distant panorama: the directional light that an engine adds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Encode, Decode)]
pub struct SunRecord {
    /// Unit vector toward it, world.
    pub direction: [f32; 3],
    /// On a surface that faces it, linear Rec.709.
    pub irradiance: [f32; 3],
    /// Of a disc all as bright as its brightest pixel that gives this irradiance, degrees.
    pub angular_diameter_degrees: f32,
}

impl From<Sun> for SunRecord {
    fn from(sun: Sun) -> SunRecord {
        SunRecord {
            direction: sun.direction.into(),
            irradiance: sun.irradiance.into(),
            angular_diameter_degrees: sun.angular_diameter.to_degrees(),
        }
    }
}

/// What de-ringing did, see [`crate::deringing`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Encode, Decode)]
pub struct DeringingRecord {
    /// Nodes that rang.
    pub nodes: u64,
    /// What it changed in them: root mean square of the change of E over that of E.
    pub relative_change: ErrorSummary,
}

/// What packing did.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Encode, Decode)]
pub struct PackingRecord {
    /// Of the numbers, see [`gdibl_runtime::packed`].
    pub step: f32,
    /// What E of the baked nodes is off by: root mean square over normals and channels, over that of E.
    pub added_error: ErrorSummary,
}

/// Order statistics of a set of errors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Encode, Decode)]
pub struct ErrorSummary {
    /// Half are under it.
    pub median: f64,
    /// 95 % are under it.
    pub p95: f64,
    /// The worst.
    pub max: f64,
}

impl ErrorSummary {
    /// Of finite errors; `None` if there is none or one is not finite.
    pub fn of(errors: impl Iterator<Item = f64>) -> Option<ErrorSummary> {
        let mut sorted: Vec<f64> = errors.collect();
        sorted.sort_by(f64::total_cmp);
        let max = *sorted.last()?;
        // The value at rank ceil(q·n): at least that share lies at or under it.
        let rank = |q: f64| sorted[((q * sorted.len() as f64).ceil() as usize).clamp(1, sorted.len()) - 1];
        max.is_finite().then(|| ErrorSummary { median: rank(0.5), p95: rank(0.95), max })
    }
}

/// Everything beside the light itself.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Records {
    /// What was asked for.
    pub settings: SettingsRecord,
    /// Stages kept and left out.
    pub plan: Vec<PlanRow>,
    /// Probes, then the distant panorama if there is one.
    pub probes: Vec<ProbeRecord>,
    /// What came of it.
    pub statistics: StatisticsRecord,
}

/// What [`decode`] can read.
pub trait Record: Decode<()> {}
impl<T: Decode<()>> Record for T {}

/// A record may not be larger than this: a damaged length must not take the memory.
const LIMIT: usize = 16 << 20;

/// Bytes of one record.
pub fn encode<T: Encode>(record: &T) -> Vec<u8> {
    bincode::encode_to_vec(record, bincode::config::legacy()).expect("records encode into memory")
}

/// One record from its bytes, all of which must be used.
pub fn decode<T: Record>(bytes: &[u8], path: &std::path::Path, section: &str) -> Result<T> {
    let configuration = bincode::config::legacy().with_limit::<LIMIT>();
    match bincode::decode_from_slice(bytes, configuration) {
        Ok((record, used)) if used == bytes.len() => Ok(record),
        Ok((_, used)) => {
            Err(Error::invalid(path, format!("section {section}: {} bytes after the record", bytes.len() - used)))
        }
        Err(error) => Err(Error::invalid(path, format!("section {section}: {error}"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_are_the_bytes_that_format_md_states() {
        let row = PlanRow { stage: "ab".into(), kept: true, why: "c".into() };
        // u64 count, then per row: u64 length + text, u8, u64 length + text.
        let expected = [&1u64.to_le_bytes()[..], &2u64.to_le_bytes(), b"ab", &[1], &1u64.to_le_bytes(), b"c"].concat();
        assert_eq!(encode(&vec![row.clone()]), expected);
        let path = std::path::Path::new("x");
        assert_eq!(decode::<Vec<PlanRow>>(&expected, path, "PLAN").unwrap(), vec![row]);
        for cut in 0..expected.len() {
            assert!(decode::<Vec<PlanRow>>(&expected[..cut], path, "PLAN").is_err());
        }
        // An option is a byte, 0 or 1, then the value.
        assert_eq!(encode(&Some(1.5f64)), [&[1][..], &1.5f64.to_le_bytes()].concat());
        assert_eq!(encode(&None::<f64>), [0]);
        // A length that would fill the memory is refused.
        assert!(decode::<Vec<PlanRow>>(&u64::MAX.to_le_bytes(), path, "PLAN").is_err());
    }

    #[test]
    fn error_summary_takes_ranks() {
        let summary = ErrorSummary::of((1..=100).map(f64::from)).unwrap();
        assert_eq!((summary.median, summary.p95, summary.max), (50.0, 95.0, 100.0));
        assert_eq!(ErrorSummary::of([].into_iter()), None);
        assert_eq!(ErrorSummary::of([1.0, f64::INFINITY].into_iter()), None);
    }
}
