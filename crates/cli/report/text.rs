//! The text of `gdibl inspect`: what is wrong and where comes first, then what it took, then what is in the file.

use gdibl_baker::analyse::{Figure, VolumeSummary, WorstNodes};
use gdibl_baker::job::records::StatisticsRecord;
use gdibl_runtime::format::Encoding;
use gdibl_runtime::{Header, Kind};
use serde_json::Value;

use super::{Inspected, ProgramReport, Report, SectionReport};
use crate::commands;

/// Lines with a name in front; a line without one goes on.
struct Lines(Vec<String>);

impl Lines {
    fn row(&mut self, name: &str, text: impl AsRef<str>) {
        self.0.push(format!("  {name:<11} {}", text.as_ref()));
    }

    /// The name stands before the first of them.
    fn rows(&mut self, name: &str, texts: impl IntoIterator<Item = String>) {
        texts.into_iter().enumerate().for_each(|(i, text)| self.row(if i == 0 { name } else { "" }, text));
    }
}

/// All of it.
pub fn text(inspected: &Inspected) -> String {
    let (report, header) = (&inspected.report, inspected.volume.header());
    let mut lines = Lines(vec![format!("{}: version {}, {} bytes", report.file, report.version, report.bytes)]);
    let statistics = report.statistics.as_ref();
    statistics.into_iter().for_each(|statistics| findings(&mut lines, statistics));
    errors(&mut lines, report);
    worst(&mut lines, report);
    statistics.into_iter().for_each(|statistics| work(&mut lines, statistics));
    nodes(&mut lines, report, header);
    light(&mut lines, &report.volume);
    sections(&mut lines, report, header);
    made_by(&mut lines, report);
    lines.0.join("\n")
}

fn findings(lines: &mut Lines, statistics: &StatisticsRecord) {
    let texts = statistics.findings.iter();
    lines.rows("finding", texts.map(|finding| format!("{} ({}): {}", finding.id, finding.count, finding.message)));
}

fn errors(lines: &mut Lines, report: &Report) {
    let seen = report.statistics.as_ref().and_then(|statistics| statistics.seen.as_ref());
    seen.into_iter().flat_map(commands::seen_lines).for_each(|(name, text)| lines.row(name, text));
    if let Some(error) = &report.volume.relative_error {
        let [median, p95, max] = [error.median, error.p95, error.max].map(|e| e * 100.0);
        let text = format!("{median:.2} % median, {p95:.2} % 95th percentile, {max:.2} % worst (standard error of E)");
        lines.row("error", text);
    }
    if let Some(statistics) = &report.statistics {
        commands::systematic_text(statistics).into_iter().for_each(|text| lines.row("bias", text));
        lines.rows("progress", commands::quarter_lines(statistics));
        if let Some(error) = &statistics.worst_direction_error {
            let [median, p95, max] = [error.median, error.p95, error.max].map(|e| e * 100.0);
            let text = format!("{median:.2} % median, {p95:.2} % 95th percentile, {max:.2} % worst");
            lines.row("direction", format!("{text} (the same in the worst direction and channel)"));
        }
    }
    let coverage = &report.volume.coverage;
    lines.row("coverage", format!("{:.1} % mean, {:.1} % least", coverage.mean * 100.0, coverage.min * 100.0));
}

/// The worst places of each kind.
fn worst(lines: &mut Lines, report: &Report) {
    let place = |[x, y, z]: [f64; 3]| format!("({x:.3} {y:.3} {z:.3})");
    let seen = report.worst_seen.iter().map(|seen| {
        let where_ = if seen.in_the_air { "in the air" } else { "on a surface" };
        format!("{:.1} % seen {where_} {}", seen.error * 100.0, place(seen.position))
    });
    lines.rows("worst", seen);
    for WorstNodes { figure, nodes } in &report.worst_nodes {
        let what = match figure {
            Figure::Noise => "noise",
            Figure::Systematic => "bias",
            _ => "covered",
        };
        let text = |node: &gdibl_baker::analyse::WorstNode| {
            format!("{:.2} % {what} at node {} {}", node.value * 100.0, node.node, place(node.position))
        };
        lines.rows(if report.worst_seen.is_empty() { "worst" } else { "" }, nodes.iter().map(text));
    }
}

fn work(lines: &mut Lines, statistics: &StatisticsRecord) {
    let (rays, samples) = (statistics.rays as f64 / 1e6, statistics.samples as f64 / 1e6);
    lines.row("work", format!("{rays:.1} M rays for {samples:.1} M directions"));
    if !statistics.stages.is_empty() {
        lines.row("stages", commands::stages_text(&statistics.stages));
    }
}

fn nodes(lines: &mut Lines, report: &Report, header: &Header) {
    lines.row("kind", kind_text(report, header));
    let [a, b] = [report.min, report.max].map(|p| format!("{:.3} {:.3} {:.3}", p[0], p[1], p[2]));
    lines.row("box", format!("{a}  to  {b}"));
    let volume = &report.volume;
    lines.row("valid", format!("{} of {} nodes", volume.nodes_valid, volume.nodes));
    let Some(statistics) = &report.statistics else { return };
    lines.row("standing", commands::standing_text(&statistics.standing, statistics.walls.as_ref()));
    lines.rows("between", statistics.sparse.iter().flat_map(commands::sparse_lines));
}

fn light(lines: &mut Lines, volume: &VolumeSummary) {
    for (name, range) in ["red", "green", "blue"].iter().zip(&volume.irradiance) {
        lines.row(name, format!("mean irradiance {:.4} to {:.4}, mean {:.4}", range.min, range.max, range.mean));
    }
    lines.row("negative", format!("{} nodes ring below zero for some normal", volume.nodes_negative));
    let histogram = &volume.luminance_stops;
    let widest = histogram.counts.iter().copied().max().unwrap_or(1).max(1);
    let bins = histogram.counts.iter().enumerate().map(|(bin, &count)| {
        let bar = "#".repeat((count * 40).div_ceil(widest));
        format!("2^{:<4} {count:>8} {bar}", histogram.first + bin as i32)
    });
    lines.rows("luminance", bins);
    if histogram.black > 0 {
        lines.row("", format!("black  {:>8}", histogram.black));
    }
}

fn sections(lines: &mut Lines, report: &Report, header: &Header) {
    let how = if report.deringed { ", de-ringed" } else { "" };
    let scale = if header.encoding == Encoding::Packed { "in steps of" } else { "times" };
    lines.row("light", format!("radiance to {} in {}, {scale} {}{how}", report.sh, report.precision, report.scale));
    if let Some(statistics) = &report.statistics {
        statistics.sun.iter().for_each(|sun| lines.row("sun", commands::sun_text(sun)));
        statistics.packing.iter().for_each(|packing| lines.row("packed", commands::packing_text(packing)));
        let deringing = statistics.deringing.iter();
        deringing.for_each(|deringing| lines.row("de-ringed", commands::deringing_text(deringing)));
    }
    for SectionReport { id, codec, stored_bytes, .. } in &report.sections {
        let per_node = *stored_bytes as f64 / report.volume.nodes as f64;
        lines.row("section", format!("{id:<5} {stored_bytes:>10} bytes {codec:<4} {per_node:>6.2} per node"));
    }
}

/// Who made it, from what, and how to make it again.
fn made_by(lines: &mut Lines, report: &Report) {
    if let Some(ProgramReport { name, commit }) = &report.program {
        let commit = if commit.is_empty() { String::new() } else { format!(", commit {commit}") };
        lines.row("program", format!("{name}{commit}"));
    }
    report.command.iter().for_each(|command| lines.row("again", command));
    lines.rows("settings", changed_settings(report));
    let input = |input: &super::InputReport| {
        format!("{} {}, {} bytes, {}", input.role, input.name, input.bytes, &input.blake3[..16])
    };
    lines.rows("inputs", report.inputs.iter().flatten().map(input));
    for probe in report.probes.iter().flatten() {
        let place = match probe.position {
            Some([x, y, z]) => format!("at {x:.3} {y:.3} {z:.3}"),
            None => "at infinity".into(),
        };
        let distance = if probe.distance { ", with distances" } else { "" };
        lines.row("probe", format!("{} {} x {} {place}{distance}", probe.name, probe.size[0], probe.size[1]));
    }
    for plan in report.plan.iter().flatten() {
        lines
            .row("plan", format!("{:<15} {:<9} {}", plan.stage, if plan.kept { "kept" } else { "left out" }, plan.why));
    }
}

/// What differs from defaults; of a file of an earlier version everything.
fn changed_settings(report: &Report) -> Vec<String> {
    let Some(settings) = &report.settings else { return Vec::new() };
    let changed = report.settings_changed.as_ref().filter(|_| report.command.is_some());
    let is_told = |name: &String, value: &Value| match changed {
        Some(changed) => changed.contains(name),
        None => !value.is_null() && *value != Value::Bool(false),
    };
    let told = settings.iter().filter(|(name, value)| is_told(name, value));
    told.map(|(name, value)| format!("{name} = {}", value.as_str().map_or_else(|| value.to_string(), str::to_owned)))
        .collect()
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
