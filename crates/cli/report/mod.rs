//! What `gdibl inspect` tells of a volume: gathered here once, for JSON, for text, and for a page.

pub mod page;
mod repeat;
pub mod text;

use std::path::Path;

use gdibl_baker::analyse::{Figures, VolumeSummary, WorstNodes, summarise, worst_nodes};
use gdibl_baker::job::records::{InputRecord, PlanRow, ProbeRecord, SeenPlace, SettingsRecord, StatisticsRecord};
use gdibl_runtime::format::{self, Codec, Directory, Encoding};
use gdibl_runtime::{Kind, Volume};
use serde::Serialize;
use serde_json::Value;

use crate::commands::{record, volume_fault};
use crate::fault::Fault;

/// How many of the worst places of each kind are told when nothing is said.
pub const WORST: usize = 5;

/// What `inspect --json` prints.
#[derive(Serialize)]
pub struct Report {
    file: String,
    bytes: usize,
    version: u32,
    kind: &'static str,
    grid: Option<GridReport>,
    min: [f64; 3],
    max: [f64; 3],
    sh: String,
    precision: &'static str,
    scale: f32,
    deringed: bool,
    sections: Vec<SectionReport>,
    volume: VolumeSummary,
    /// The worst nodes by each kind of error that the file tells of.
    worst_nodes: Vec<WorstNodes>,
    /// Places between nodes where the error is greatest, the worst first.
    worst_seen: Vec<SeenPlaceReport>,
    /// Who wrote it.
    program: Option<ProgramReport>,
    /// Every setting in force, by its name in BAKE.toml; null: not set.
    settings: Option<serde_json::Map<String, Value>>,
    /// Names of the settings that are not as they are by default.
    settings_changed: Option<Vec<String>>,
    /// The command line that bakes it again; null where the file does not tell how it was made.
    command: Option<String>,
    inputs: Option<Vec<InputReport>>,
    plan: Option<Vec<PlanRow>>,
    probes: Option<Vec<ProbeRecord>>,
    statistics: Option<StatisticsRecord>,
}

#[derive(Serialize)]
struct ProgramReport {
    name: String,
    commit: String,
}

#[derive(Serialize)]
struct InputReport {
    role: String,
    name: String,
    bytes: u64,
    blake3: String,
}

#[derive(Serialize)]
struct GridReport {
    counts: [u32; 3],
    spacing: [f64; 3],
}

#[derive(Serialize)]
struct SectionReport {
    id: String,
    codec: &'static str,
    stored_bytes: u64,
    raw_bytes: u64,
}

/// A place between nodes at which the error was measured.
#[derive(Clone, Serialize)]
struct SeenPlaceReport {
    position: [f64; 3],
    /// In the air; otherwise on a surface.
    in_the_air: bool,
    /// Of irradiance, relative.
    error: f64,
}

/// A volume that was read, with everything that is told of it.
pub struct Inspected {
    pub report: Report,
    pub volume: Volume,
    pub figures: Figures,
    /// The worst places between nodes, as far as the file names them.
    seen: Vec<SeenPlaceReport>,
}

impl Inspected {
    /// Reads a file's bytes; `worst` is how many of the worst places of each kind are told.
    pub fn of(path: &Path, bytes: &[u8], worst: usize) -> Result<Inspected, Fault> {
        let fault = |error: gdibl_runtime::Error| volume_fault(path, &error);
        let directory = format::parse_header_and_sections(bytes).map_err(fault)?;
        let volume = Volume::parse(bytes).map_err(fault)?;
        let figures = Figures::read(&directory, &volume).map_err(fault)?;
        let header = directory.header;
        let settings: Option<SettingsRecord> = record(&directory, path, format::SETTINGS)?;
        let statistics: Option<StatisticsRecord> = record(&directory, path, format::STATISTICS)?;
        let seen = statistics.as_ref().map(|all| seen_places(all, header.min, header.max)).unwrap_or_default();
        let mut worst_seen = seen.clone();
        worst_seen.sort_by(|a, b| b.error.total_cmp(&a.error));
        worst_seen.truncate(worst);
        let report = Report {
            file: path.display().to_string(),
            bytes: bytes.len(),
            version: format::VERSION,
            kind: kind_name(header.kind),
            grid: volume.grid().map(|grid| GridReport { counts: grid.counts, spacing: grid.spacing() }),
            min: header.min,
            max: header.max,
            sh: format!("L{}", header.bands),
            precision: match header.encoding {
                Encoding::F32 => "f32",
                Encoding::F16 => "f16",
                Encoding::Packed => "packed",
            },
            scale: header.scale,
            deringed: header.is_deringed(),
            sections: sections(&directory),
            volume: summarise(&volume),
            worst_nodes: worst_nodes(&volume, &figures, worst),
            worst_seen,
            program: settings.as_ref().map(|s| ProgramReport { name: s.writer.clone(), commit: s.commit.clone() }),
            inputs: settings.as_ref().map(|settings| settings.inputs.iter().map(input_report).collect()),
            settings_changed: settings.as_ref().map(repeat::changed_names),
            command: settings.as_ref().and_then(repeat::command),
            settings: settings.as_ref().map(settings_report),
            plan: record(&directory, path, format::PLAN)?,
            probes: record(&directory, path, format::PROBES)?,
            statistics,
        };
        Ok(Inspected { report, volume, figures, seen })
    }
}

fn seen_places(statistics: &StatisticsRecord, min: [f64; 3], max: [f64; 3]) -> Vec<SeenPlaceReport> {
    let place = |place: &SeenPlace| SeenPlaceReport {
        position: place.position(min, max),
        in_the_air: place.in_the_air,
        error: place.error(),
    };
    statistics.seen_places.iter().map(place).collect()
}

/// By name. Of a file of an earlier version what that tells.
fn settings_report(record: &SettingsRecord) -> serde_json::Map<String, Value> {
    let value = |text: &Option<String>| text.as_ref().map_or(Value::Null, |text| value_of(text));
    if !record.settings.is_empty() {
        return record.settings.iter().map(|setting| (setting.name.clone(), value(&setting.value))).collect();
    }
    let SettingsRecord { method, blend, scene, sampler, samples, target_error, seed, .. } = record;
    let earlier = serde_json::json!({
        "quality.method": method, "quality.blend": blend, "quality.scene": scene, "quality.sampler": sampler,
        "quality.samples": samples, "quality.target_error": target_error, "quality.seed": seed,
    });
    earlier.as_object().cloned().unwrap_or_default()
}

/// Numbers and switches as such.
fn value_of(text: &str) -> Value {
    serde_json::from_str(text)
        .ok()
        .filter(|value: &Value| value.is_number() || value.is_boolean())
        .unwrap_or(text.into())
}

fn input_report(input: &InputRecord) -> InputReport {
    let blake3 = input.blake3.iter().map(|byte| format!("{byte:02x}")).collect();
    InputReport { role: input.role.clone(), name: input.name.clone(), bytes: input.bytes, blake3 }
}

fn kind_name(kind: Kind) -> &'static str {
    match kind {
        Kind::Grid => "grid",
        Kind::Sparse => "sparse grid",
        Kind::Points => "points",
        Kind::Vertices => "vertices",
    }
}

fn sections(directory: &Directory) -> Vec<SectionReport> {
    let row = |entry: &format::SectionEntry| SectionReport {
        id: String::from_utf8_lossy(&entry.id).trim_end().to_string(),
        codec: match entry.codec {
            Codec::Raw => "raw",
            Codec::Zstd => "zstd",
            Codec::Bits => "bits",
        },
        stored_bytes: entry.stored_size,
        raw_bytes: entry.raw_size,
    };
    directory.sections.iter().map(row).collect()
}
