//! `gdibl inspect`: what is in a volume.

use std::path::{Path, PathBuf};

use gdibl_baker::analyse::{VolumeSummary, summarise};
use gdibl_baker::job::records::{InputRecord, PlanRow, ProbeRecord, SettingsRecord, StatisticsRecord};
use gdibl_runtime::format::{self, Codec, Directory, Encoding};
use gdibl_runtime::{Header, Kind, Volume};
use serde::Serialize;
use serde_json::Value;

use crate::fault::Fault;
use crate::session::Outcome;
use crate::volumes::{Listing, VolumeList, is_list, set_of};

#[derive(clap::Args)]
pub struct Arguments {
    /// The volume, or a list of volumes
    file: PathBuf,
}

#[derive(Serialize)]
struct Report {
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
    /// Who wrote it.
    program: Option<ProgramReport>,
    /// Every setting in force, by its name in BAKE.toml; null: not set.
    settings: Option<serde_json::Map<String, Value>>,
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

/// What `--json` prints of a list.
#[derive(Serialize)]
struct ListReport {
    list: String,
    /// File name of the level.
    level: String,
    /// In the order of the list, the finest first.
    volumes: Vec<ListedReport>,
}

#[derive(Serialize)]
struct ListedReport {
    name: String,
    #[serde(flatten)]
    report: Report,
}

pub fn run(arguments: Arguments) -> Result<Outcome, Fault> {
    let path = &arguments.file;
    let bytes = super::read_bytes(path)?;
    if is_list(&bytes) {
        return inspect_list(VolumeList::parse(path, &bytes)?, path);
    }
    let (report, text) = inspect(path, &bytes)?;
    Ok(Outcome::new(report, text))
}

/// Each volume of a list, one after another.
fn inspect_list(list: VolumeList, path: &Path) -> Result<Outcome, Fault> {
    let level = list.level.clone();
    let listings = list.open(path)?;
    // They fit together.
    set_of(&listings, path)?;
    let mut text = format!("{}: {} volumes of {level}, the finest first", path.display(), listings.len());
    let mut volumes = Vec::new();
    for Listing { entry, path, bytes } in listings {
        let (report, own) = inspect(&path, &bytes)?;
        text += &format!("\n\n'{}', blended over {:.3} m\n{own}", entry.name, entry.spacing);
        volumes.push(ListedReport { name: entry.name, report });
    }
    Ok(Outcome::new(ListReport { list: path.display().to_string(), level, volumes }, text))
}

fn inspect(path: &Path, bytes: &[u8]) -> Result<(Report, String), Fault> {
    let fault = |error: gdibl_runtime::Error| super::volume_fault(path, &error);
    let directory = format::parse_header_and_sections(bytes).map_err(fault)?;
    let volume = Volume::parse(bytes).map_err(fault)?;
    let header = directory.header;
    let settings: Option<SettingsRecord> = super::record(&directory, path, format::SETTINGS)?;
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
        program: settings.as_ref().map(|s| ProgramReport { name: s.writer.clone(), commit: s.commit.clone() }),
        inputs: settings.as_ref().map(|settings| settings.inputs.iter().map(input_report).collect()),
        settings: settings.as_ref().map(settings_report),
        plan: super::record(&directory, path, format::PLAN)?,
        probes: super::record(&directory, path, format::PROBES)?,
        statistics: super::record(&directory, path, format::STATISTICS)?,
    };
    let text = text(&report, &header);
    Ok((report, text))
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

fn text(report: &Report, header: &Header) -> String {
    let mut lines = vec![format!("{}: version {}, {} bytes", report.file, report.version, report.bytes)];
    let mut row = |name: &str, text: String| lines.push(format!("  {name:<11} {text}"));
    let seen = report.statistics.as_ref().and_then(|statistics| statistics.seen.as_ref());
    seen.into_iter().flat_map(super::seen_lines).for_each(|(name, text)| row(name, text));
    row("kind", kind_text(report, header));
    let [a, b] = [report.min, report.max].map(|p| format!("{:.3} {:.3} {:.3}", p[0], p[1], p[2]));
    row("box", format!("{a}  to  {b}"));
    let how = if report.deringed { ", de-ringed" } else { "" };
    let scale = if header.encoding == Encoding::Packed { "in steps of" } else { "times" };
    row("light", format!("radiance to {} in {}, {scale} {}{how}", report.sh, report.precision, report.scale));
    let volume = &report.volume;
    row("valid", format!("{} of {} nodes", volume.nodes_valid, volume.nodes));
    if let Some(statistics) = &report.statistics {
        row("standing", super::standing_text(&statistics.standing, statistics.walls.as_ref()));
    }
    if let Some(sparse) = report.statistics.as_ref().and_then(|statistics| statistics.sparse.as_ref()) {
        super::sparse_lines(sparse).into_iter().for_each(|line| row("between", line));
    }
    for (name, range) in ["red", "green", "blue"].iter().zip(&volume.irradiance) {
        row(name, format!("mean irradiance {:.4} to {:.4}, mean {:.4}", range.min, range.max, range.mean));
    }
    row("negative", format!("{} nodes ring below zero for some normal", volume.nodes_negative));
    let coverage = &volume.coverage;
    row("coverage", format!("{:.1} % mean, {:.1} % least", coverage.mean * 100.0, coverage.min * 100.0));
    if let Some(e) = &volume.relative_error {
        let [median, p95, max] = [e.median, e.p95, e.max].map(|e| e * 100.0);
        row(
            "error",
            format!("{median:.2} % median, {p95:.2} % 95th percentile, {max:.2} % worst (standard error of E)"),
        );
    }
    for worst in &volume.worst {
        let [x, y, z] = worst.position;
        row("", format!("{:.2} % at node {} ({x:.3} {y:.3} {z:.3})", worst.relative_error * 100.0, worst.node));
    }
    let histogram = &volume.luminance_stops;
    let widest = histogram.counts.iter().copied().max().unwrap_or(1).max(1);
    for (bin, &count) in histogram.counts.iter().enumerate() {
        let bar = "#".repeat((count * 40).div_ceil(widest));
        row(if bin == 0 { "luminance" } else { "" }, format!("2^{:<4} {count:>8} {bar}", histogram.first + bin as i32));
    }
    if histogram.black > 0 {
        row("", format!("black  {:>8}", histogram.black));
    }
    for section in &report.sections {
        let per_node = section.stored_bytes as f64 / volume.nodes as f64;
        let SectionReport { id, codec, stored_bytes, .. } = section;
        row("section", format!("{id:<5} {stored_bytes:>10} bytes {codec:<4} {per_node:>6.2} per node"));
    }
    if let Some(ProgramReport { name, commit }) = &report.program {
        let commit = if commit.is_empty() { String::new() } else { format!(", commit {commit}") };
        row("program", format!("{name}{commit}"));
    }
    // What is not set says nothing.
    let set = report.settings.iter().flatten().filter(|(_, value)| !value.is_null() && **value != Value::Bool(false));
    for (i, (name, value)) in set.enumerate() {
        let text = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        row(if i == 0 { "settings" } else { "" }, format!("{name} = {text}"));
    }
    for (i, input) in report.inputs.iter().flatten().enumerate() {
        let text = format!("{} {}, {} bytes, {}", input.role, input.name, input.bytes, &input.blake3[..16]);
        row(if i == 0 { "inputs" } else { "" }, text);
    }
    for plan in report.plan.iter().flatten() {
        row("plan", format!("{:<15} {:<9} {}", plan.stage, if plan.kept { "kept" } else { "left out" }, plan.why));
    }
    for probe in report.probes.iter().flatten() {
        let place = match probe.position {
            Some([x, y, z]) => format!("at {x:.3} {y:.3} {z:.3}"),
            None => "at infinity".into(),
        };
        let distance = if probe.distance { ", with distances" } else { "" };
        row("probe", format!("{} {} x {} {place}{distance}", probe.name, probe.size[0], probe.size[1]));
    }
    if let Some(statistics) = &report.statistics {
        let (rays, samples) = (statistics.rays as f64 / 1e6, statistics.samples as f64 / 1e6);
        if let Some(sun) = &statistics.sun {
            row("sun", super::sun_text(sun));
        }
        if let Some(packing) = &statistics.packing {
            row("packed", super::packing_text(packing));
        }
        if let Some(deringing) = &statistics.deringing {
            row("de-ringed", super::deringing_text(deringing));
        }
        if let Some(e) = &statistics.worst_direction_error {
            let [median, p95, max] = [e.median, e.p95, e.max].map(|e| e * 100.0);
            let text = format!("{median:.2} % median, {p95:.2} % 95th percentile, {max:.2} % worst");
            row("direction", format!("{text} (the same in the worst direction and channel)"));
        }
        super::systematic_text(statistics).into_iter().for_each(|text| row("bias", text));
        row("work", format!("{rays:.1} M rays for {samples:.1} M directions"));
        if !statistics.stages.is_empty() {
            row("stages", super::stages_text(&statistics.stages));
        }
        for finding in &statistics.findings {
            row("finding", format!("{} ({}): {}", finding.id, finding.count, finding.message));
        }
    }
    lines.join("\n")
}

fn kind_text(report: &Report, header: &Header) -> String {
    match &report.grid {
        Some(grid) => {
            let [x, y, z] = grid.counts;
            let [sx, sy, sz] = grid.spacing;
            let nodes = match header.kind {
                Kind::Sparse => format!("{} nodes of {x} x {y} x {z} places", header.counts[0]),
                _ => format!("{x} x {y} x {z} nodes"),
            };
            format!("{} of {nodes}, {sx:.3} x {sy:.3} x {sz:.3} m apart", report.kind)
        }
        None => format!("{} ({})", report.kind, header.counts[0]),
    }
}
