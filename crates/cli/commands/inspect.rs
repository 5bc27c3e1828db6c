//! `gdibl inspect`: what is in a volume.

use std::path::PathBuf;

use gdibl_baker::analyse::{VolumeSummary, summarise};
use gdibl_baker::records::{PlanRow, ProbeRecord, SettingsRecord, StatisticsRecord};
use gdibl_runtime::format::{self, Codec, Directory, Encoding};
use gdibl_runtime::{Header, Kind, Volume};
use serde::Serialize;

use crate::fault::Fault;

#[derive(clap::Args)]
pub struct Arguments {
    /// The volume
    file: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
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
    settings: Option<SettingsRecord>,
    plan: Option<Vec<PlanRow>>,
    probes: Option<Vec<ProbeRecord>>,
    statistics: Option<StatisticsRecord>,
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

pub fn run(arguments: Arguments) -> Result<(), Fault> {
    let path = &arguments.file;
    let bytes = super::read_volume_bytes(path)?;
    let fault = |error: gdibl_runtime::Error| super::volume_fault(path, &error);
    let directory = format::parse_header_and_sections(&bytes).map_err(fault)?;
    let volume = Volume::parse(&bytes).map_err(fault)?;
    let header = directory.header;
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
        settings: super::record(&directory, path, format::SETTINGS)?,
        plan: super::record(&directory, path, format::PLAN)?,
        probes: super::record(&directory, path, format::PROBES)?,
        statistics: super::record(&directory, path, format::STATISTICS)?,
    };
    if arguments.json { super::print_json(&report) } else { print(&report, &header) }
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
        codec: if entry.codec == Codec::Zstd { "zstd" } else { "raw" },
        stored_bytes: entry.stored_size,
        raw_bytes: entry.raw_size,
    };
    directory.sections.iter().map(row).collect()
}

fn print(report: &Report, header: &Header) -> Result<(), Fault> {
    let mut lines = vec![format!("{}: version {}, {} bytes", report.file, report.version, report.bytes)];
    let mut row = |name: &str, text: String| lines.push(format!("  {name:<11} {text}"));
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
        row("section", format!("{:<5} {:>10} bytes {}", section.id, section.stored_bytes, section.codec));
    }
    if let Some(s) = &report.settings {
        let target = s.target_error.map_or(String::new(), |t| format!(", target error {} %", (t * 100.0) as f32));
        row("settings", format!("{}: {} of {}", s.writer, s.method, s.level));
        row(
            "",
            format!(
                "{} samples ({}), seed {}{target}, blend {}, scene {}",
                s.samples, s.sampler, s.seed, s.blend, s.scene
            ),
        );
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
        row("work", format!("{rays:.1} M rays for {samples:.1} M directions"));
        for finding in &statistics.findings {
            row("finding", format!("{} ({}): {}", finding.id, finding.count, finding.message));
        }
    }
    super::print_line(&lines.join("\n"))
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
