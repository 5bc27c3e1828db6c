//! The small records of a file: settings, plan, probes, statistics. What was asked for and what came of it, for
//! `inspect`; the runtime skips them. Encoded by bincode's legacy fixed-int rules, restated in FORMAT.md in bytes.
//! Nothing here may depend on the clock or the machine unless that was asked for: same inputs and settings, same bytes.
//!
//! Records grow at their end. A reader ignores bytes behind the fields that it knows, and takes later fields that are
//! missing as absent: so older and newer programs read each other's files.

use bincode::error::DecodeError;
use bincode::{Decode, Encode};
use serde::Serialize;

use crate::bake::Walls;
use crate::panorama::Sun;
use crate::{Error, Finding, Result};

/// A record that can grow: a struct whose fields behind `later` came in later versions.
macro_rules! record {
    (
        $(#[$about:meta])* $name:ident {
            $( $(#[$field_about:meta])* $field:ident: $kind:ty, )*
        }
        later {
            $( $(#[$later_about:meta])* $later:ident: $later_kind:ty, )*
        }
    ) => {
        $(#[$about])*
        #[derive(Debug, Clone, Default, PartialEq, Serialize, Encode)]
        pub struct $name {
            $( $(#[$field_about])* pub $field: $kind, )*
            $( $(#[$later_about])* pub $later: $later_kind, )*
        }

        impl Record for $name {
            fn read(fields: &mut Fields) -> std::result::Result<Self, DecodeError> {
                Ok($name {
                    $( $field: fields.next()?, )*
                    $( $later: fields.later()?, )*
                })
            }
        }
    };
}

record! {
/// How a volume was made.
SettingsRecord {
    /// The program that wrote it, and its version.
    writer: String,
    /// File name of the level, without folder.
    level: String,
    /// The radiance function in force: `gdibl` or `path`.
    method: String,
    /// Blend rule with its power, as on the command line.
    blend: String,
    /// What rays do at scene geometry, as on the command line.
    scene: String,
    /// `sobol` or `random`.
    sampler: String,
    /// Directions per node, or the most of them.
    samples: u64,
    /// Relative error at which a node stops.
    target_error: Option<f64>,
    /// Seed of all random numbers.
    seed: u64,
}
later {
    /// Of the program's source; empty where it is not known.
    commit: String,
    /// Every setting in force, by its name in BAKE.toml: `quality.samples`.
    settings: Vec<SettingRecord>,
    /// What was read.
    inputs: Vec<InputRecord>,
    /// BLAKE3 hash of all that was asked for, with the inputs and the program: an equal one gives the same bytes. Zeros: not known.
    request: [u8; 32],
}
}

/// One setting.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Encode, Decode)]
pub struct SettingRecord {
    /// Its table and name in BAKE.toml: `quality.samples`.
    pub name: String,
    /// Its text form, as on the command line; `None`: not set.
    pub value: Option<String>,
}

/// One file that was read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Encode, Decode)]
pub struct InputRecord {
    /// `level`, `environment`, `distant`, `probe` or `points`. Files that a level refers to have its role.
    pub role: String,
    /// File name, without folder.
    pub name: String,
    /// Size.
    pub bytes: u64,
    /// BLAKE3 hash of its bytes.
    pub blake3: [u8; 32],
}

/// One stage of the bake.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Encode, Decode)]
pub struct PlanRow {
    /// Stable name of the stage.
    pub stage: String,
    /// Done, or left out.
    pub kept: bool,
    /// One sentence.
    pub why: String,
}

impl PlanRow {
    /// A row; `why` is one sentence.
    pub fn new(stage: &str, kept: bool, why: impl Into<String>) -> PlanRow {
        PlanRow { stage: stage.into(), kept, why: why.into() }
    }
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

record! {
/// What came of it.
StatisticsRecord {
    /// Nodes in the volume.
    nodes: u64,
    /// Nodes with light of their own.
    nodes_valid: u64,
    /// Rays traced, lines of sight included.
    rays: u64,
    /// Directions that left nodes.
    samples: u64,
    /// Relative standard error of E over valid nodes; `None` where it was not measured (one sample).
    relative_error: Option<ErrorSummary>,
    /// The same in the worst direction and channel of each node.
    worst_direction_error: Option<ErrorSummary>,
    /// Mean share of the sphere that was covered, over the nodes in the open.
    coverage: f64,
    /// Why nodes have no light of their own, or take it elsewhere.
    standing: StandingRecord,
    /// What keeps light on its side of walls; `None` where no wall stands between nodes of a grid.
    walls: Option<WallsRecord>,
    /// How sparse the grid is and how good; `None` where no tolerance was given, or the grid has no coarser cells.
    sparse: Option<SparseRecord>,
    /// What de-ringing did; `None` where it was not asked for, or no node rings.
    deringing: Option<DeringingRecord>,
    /// What packed coefficients add to the error; `None` in files of floats.
    packing: Option<PackingRecord>,
    /// The sun whose direct light was left out; `None` where that was not asked for, or no sun found.
    sun: Option<SunRecord>,
    /// What the inputs had that deserves a look.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    findings: Vec<Finding>,
}
later {
    /// What was done, in order, and what it took.
    stages: Vec<StageRecord>,
    /// Relative systematic error of E over valid nodes, what more directions do not take away; `None` where nothing tells.
    systematic_error: Option<ErrorSummary>,
    /// Error where an engine reads light; `None` where nothing is read between nodes, or it was not measured.
    seen: Option<SeenRecord>,
    /// The worst places at which that was measured, up to 32 in the air and as many on surfaces: to show where the error is.
    #[serde(skip)]
    seen_places: Vec<SeenPlace>,
    /// Errors after a quarter, a half, three quarters and all of the directions; empty where nothing tells.
    quarters: Vec<QuarterRecord>,
}
}

/// Error of E after a share of the bake's directions: medians over an eighth of the nodes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Encode, Decode)]
pub struct QuarterRecord {
    /// Of the directions of each node, 0..=1.
    pub share: f64,
    /// Standard error.
    pub noise: f64,
    /// With the systematic error, which more directions do not take away.
    pub whole: f64,
    /// What the bake takes with so many. `None` in files, unless times were asked for: the same inputs give the same bytes.
    pub seconds: Option<StageSeconds>,
}

/// A held-out place in the box of a grid, and the error there: nine bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Encode, Decode)]
pub struct SeenPlace {
    /// In the air; otherwise on a surface.
    pub in_the_air: bool,
    /// From the box's lowest corner to its highest, in 65535ths.
    pub place: [u16; 3],
    /// As [`SeenSet::error`]: a 16-bit float.
    pub error: u16,
}

impl SeenPlace {
    /// A place in the box from `min` to `max`, world metres.
    pub fn new(in_the_air: bool, position: [f64; 3], error: f64, min: [f64; 3], max: [f64; 3]) -> SeenPlace {
        let share = |axis: usize| {
            let size = max[axis] - min[axis];
            if size > 0.0 { (position[axis] - min[axis]) / size } else { 0.0 }
        };
        // A cast clips.
        let place = [0, 1, 2].map(|axis| (share(axis) * f64::from(u16::MAX)).round() as u16);
        SeenPlace { in_the_air, place, error: half::f16::from_f64(error.min(f64::from(half::f16::MAX))).to_bits() }
    }

    /// World metres, in that box.
    pub fn position(&self, min: [f64; 3], max: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|axis| min[axis] + (max[axis] - min[axis]) * f64::from(self.place[axis]) / f64::from(u16::MAX))
    }

    /// The relative error.
    pub fn error(&self) -> f64 {
        half::f16::from_bits(self.error).to_f64()
    }
}

/// Error of irradiance at held-out places, as the runtime reads the file, against the bake's own method: see [`crate::seen`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Encode, Decode)]
pub struct SeenRecord {
    /// Anywhere in the open, with normals of all directions; `None` where no such place is lit.
    pub air: Option<SeenSet>,
    /// On surfaces, with their normals; `None` where no such place is lit.
    pub surfaces: Option<SeenSet>,
}

/// Errors at some places.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Encode, Decode)]
pub struct SeenSet {
    /// How many places.
    pub places: u64,
    /// Over the larger of E there and a tenth of the median of E: root mean square over red, green and blue.
    pub error: SeenErrors,
    /// Over the larger of E there and 18 % of the mean of E: as an eye sees it whose mid-grey is the room's mean.
    pub error_in_grey: SeenErrors,
    /// Where `error` is greatest, world metres.
    pub worst: [f64; 3],
    /// What it is made of.
    pub parts: SeenParts,
}

/// Root mean square of each part of an error over all places, over the same as [`SeenSet::error`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Encode, Decode)]
pub struct SeenParts {
    /// Noise of the nodes around.
    pub noise: f64,
    /// Light between nodes is not what nodes say.
    pub between: f64,
    /// Bands that are not stored.
    pub bands: f64,
    /// Numbers in the file, and de-ringing.
    pub packing: f64,
    /// Systematic error of the nodes around, which the truth here shares: not in `error`.
    pub systematic: f64,
}

/// Order statistics of errors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Encode, Decode)]
pub struct SeenErrors {
    /// Half are under it.
    pub median: f64,
    /// 95 % are under it.
    pub p95: f64,
    /// 99 % are under it.
    pub p99: f64,
    /// The worst.
    pub max: f64,
}

impl SeenErrors {
    /// Of finite errors; `None` if there is none or one is not finite.
    pub fn of(errors: impl Iterator<Item = f64>) -> Option<SeenErrors> {
        let [median, p95, p99, max] = ranks(errors, [0.5, 0.95, 0.99, 1.0])?;
        Some(SeenErrors { median, p95, p99, max })
    }
}

/// The values at ranks ceil(q n) of finite numbers: at least the share q lies at or under each.
fn ranks<const N: usize>(numbers: impl Iterator<Item = f64>, shares: [f64; N]) -> Option<[f64; N]> {
    let mut sorted: Vec<f64> = numbers.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.last().filter(|last| last.is_finite())?;
    Some(shares.map(|q| sorted[((q * sorted.len() as f64).ceil() as usize).clamp(1, sorted.len()) - 1]))
}

/// One stage of a bake.
#[derive(Debug, Clone, PartialEq, Serialize, Encode, Decode)]
pub struct StageRecord {
    /// Stable name: `read`, `prepare`, `nodes` ...
    pub stage: String,
    /// Rays traced in it.
    pub rays: u64,
    /// `None` in files, unless times were asked for: the same inputs give the same bytes.
    pub seconds: Option<StageSeconds>,
}

/// What a stage took.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Encode, Decode)]
pub struct StageSeconds {
    /// On the clock.
    pub wall: f64,
    /// Of all processors together.
    pub cpu: f64,
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

/// What de-ringing did, see [`crate::pack::deringing`].
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
        let [median, p95, max] = ranks(errors, [0.5, 0.95, 1.0])?;
        Some(ErrorSummary { median, p95, max })
    }
}

/// Everything beside the light itself. What is not known is not there.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Records {
    /// How the volume was made.
    pub settings: Option<SettingsRecord>,
    /// Stages kept and left out.
    pub plan: Vec<PlanRow>,
    /// Probes, then the distant panorama if there is one.
    pub probes: Vec<ProbeRecord>,
    /// What came of it. Of a volume that was packed without, what the volume itself tells.
    pub statistics: Option<StatisticsRecord>,
}

/// What [`decode`] can read.
pub trait Record: Sized {
    /// Reads the fields one after another.
    ///
    /// # Errors
    /// One of the fields of the first version is missing, or a field contradicts the encoding.
    fn read(fields: &mut Fields) -> std::result::Result<Self, DecodeError>;
}

impl Record for Vec<PlanRow> {
    fn read(fields: &mut Fields) -> std::result::Result<Self, DecodeError> {
        fields.next()
    }
}

impl Record for Vec<ProbeRecord> {
    fn read(fields: &mut Fields) -> std::result::Result<Self, DecodeError> {
        fields.next()
    }
}

/// The fields of a record that are still to be read.
pub struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    /// A field that has always been there.
    fn next<T: Decode<()>>(&mut self) -> std::result::Result<T, DecodeError> {
        let configuration = bincode::config::legacy().with_limit::<LIMIT>();
        let (field, used) = bincode::decode_from_slice(self.0, configuration)?;
        self.0 = &self.0[used..];
        Ok(field)
    }

    /// A field of a later version: absent where the record ends before it.
    fn later<T: Decode<()> + Default>(&mut self) -> std::result::Result<T, DecodeError> {
        if self.0.is_empty() { Ok(T::default()) } else { self.next() }
    }
}

/// A field may not be larger than this: a damaged length must not take the memory.
const LIMIT: usize = 16 << 20;

/// Bytes of one record.
pub fn encode<T: Encode>(record: &T) -> Vec<u8> {
    bincode::encode_to_vec(record, bincode::config::legacy()).expect("records encode into memory")
}

/// One record from its bytes. Bytes behind the fields that are known are ignored.
///
/// # Errors
/// The record ends within a field, or before one that has always been there.
pub fn decode<T: Record>(bytes: &[u8], path: &std::path::Path, section: &str) -> Result<T> {
    T::read(&mut Fields(bytes)).map_err(|error| Error::invalid(path, format!("section {section}: {error}")))
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
        assert_eq!(decode::<Vec<PlanRow>>(&expected, path, "PLAN").unwrap(), std::slice::from_ref(&row));
        for cut in 0..expected.len() {
            assert!(decode::<Vec<PlanRow>>(&expected[..cut], path, "PLAN").is_err());
        }
        // A later version has more behind it.
        let grown = [&expected[..], &[0; 9]].concat();
        assert_eq!(decode::<Vec<PlanRow>>(&grown, path, "PLAN").unwrap(), vec![row]);
        // An option is a byte, 0 or 1, then the value.
        assert_eq!(encode(&Some(1.5f64)), [&[1][..], &1.5f64.to_le_bytes()].concat());
        assert_eq!(encode(&None::<f64>), [0]);
        // A length that would fill the memory is refused.
        assert!(decode::<Vec<PlanRow>>(&u64::MAX.to_le_bytes(), path, "PLAN").is_err());
    }

    #[test]
    fn records_of_older_and_newer_programs_read() {
        let record = SettingsRecord {
            writer: "gdibl 0.1.0".into(),
            target_error: Some(0.01),
            settings: vec![SettingRecord { name: "grid.spacing".into(), value: None }],
            inputs: vec![InputRecord { role: "level".into(), name: "a.glb".into(), bytes: 7, blake3: [3; 32] }],
            ..SettingsRecord::default()
        };
        let bytes = encode(&record);
        let path = std::path::Path::new("x");
        let read = |bytes: &[u8]| decode::<SettingsRecord>(bytes, path, "SETT");
        assert_eq!(read(&bytes).unwrap(), record);
        assert_eq!(read(&[&bytes[..], &[1; 9]].concat()).unwrap(), record, "one more field");
        // Where each of the later fields begins. A cut at any other place is damage.
        let ends = [
            0,
            encode(&record.commit).len(),
            encode(&record.settings).len(),
            encode(&record.inputs).len(),
            encode(&record.request).len(),
        ];
        let first = bytes.len() - ends.iter().sum::<usize>();
        let borders: Vec<usize> = ends
            .iter()
            .scan(first, |sum, end| {
                Some({
                    *sum += end;
                    *sum
                })
            })
            .collect();
        for cut in 0..bytes.len() {
            assert_eq!(read(&bytes[..cut]).is_ok(), borders.contains(&cut), "{cut} of {borders:?}");
        }
        let older = SettingsRecord { settings: Vec::new(), inputs: Vec::new(), request: [0; 32], ..record };
        assert_eq!(read(&bytes[..borders[0]]).unwrap(), older);
    }

    #[test]
    fn seen_places_keep_their_place_and_error() {
        let (min, max) = ([-1.0, 5.0, 1e6], [3.0, 5.0, 1e6 + 8.0]);
        let position = [0.3, 5.0, 1e6 + 7.9];
        let place = SeenPlace::new(true, position, 0.25, min, max);
        assert_eq!(encode(&place).len(), 9);
        assert_eq!(place.error(), 0.25);
        for (found, expected) in place.position(min, max).into_iter().zip(position) {
            assert!((found - expected).abs() <= 8.0 / 65535.0, "{found}, expected {expected}");
        }
        assert!(SeenPlace::new(false, position, 1e9, min, max).error().is_finite());
    }

    #[test]
    fn error_summary_takes_ranks() {
        let summary = ErrorSummary::of((1..=100).map(f64::from)).unwrap();
        assert_eq!((summary.median, summary.p95, summary.max), (50.0, 95.0, 100.0));
        assert_eq!(ErrorSummary::of([].into_iter()), None);
        assert_eq!(ErrorSummary::of([1.0, f64::INFINITY].into_iter()), None);
    }
}
