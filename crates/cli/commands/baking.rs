//! Runs a job, and tells what came of it.

use gdibl_baker::Finding;
use gdibl_baker::bake::Nodes;
use gdibl_baker::blocks::Blocks;
use gdibl_baker::exposure::ExposureMatch;
use gdibl_baker::job::bands::Truncation;
use gdibl_baker::job::records::{PlanRow, SeenParts, SeenSet, StatisticsRecord};
use gdibl_baker::job::{Job, Made, Stage, Stop, Watch};
use gdibl_baker::pack::{Packed, Precision};
use serde::Serialize;

use crate::config::Config;
use crate::fault::Fault;
use crate::journal::Journal;
use crate::progress::{Progress, Shown};
use crate::session::Session;
use crate::stages::Stages;

/// What `--json` prints.
#[derive(Serialize)]
pub struct Report {
    pub output: String,
    pub wall_seconds: f64,
    pub cpu_seconds: f64,
    pub sh: String,
    pub bytes: u64,
    pub seed: u64,
    /// Nothing was done: the output is that of the same inputs, settings and program.
    pub unchanged: bool,
    pub plan: Vec<PlanRow>,
    /// What fewer bands than were baked would lose, or have lost.
    pub truncation: Vec<Truncation>,
    pub exposure: Option<ExposureMatch>,
    #[serde(flatten)]
    pub statistics: StatisticsRecord,
}

/// What `--json` prints of a shard, or of what shards have in common.
#[derive(Serialize)]
pub struct ShardReport {
    pub output: Option<String>,
    pub shard: Option<String>,
    pub wall_seconds: f64,
    pub cpu_seconds: f64,
    pub bytes: u64,
    pub unchanged: bool,
}

/// What `--plan --json` prints.
#[derive(Serialize)]
pub struct PlanReport {
    pub plan: Vec<PlanRow>,
    /// Of the bake on this machine; `None`: probes are still to be captured.
    pub likely_seconds: Option<f64>,
}

/// How long the bake is likely to take: a few nodes are baked. `None`: it depends on probes that are still to be captured.
pub fn likely_seconds(job: &Job, stages: &Stages, session: &Session) -> Result<Option<f64>, Fault> {
    if job.wants_capture() {
        return Ok(None);
    }
    let seconds = || stages.total().0;
    let watch = Watch { seconds: &seconds, ..Watch::silent(&session.cancel) };
    Ok(Some(job.likely_seconds(&watch).map_err(|_| Fault::Interrupted)?))
}

/// Runs the job with a progress bar.
pub fn bake(
    job: &mut Job,
    stages: &Stages,
    session: &Session,
    shown: Shown,
    journal: Option<&Journal>,
) -> Result<Made, Stop> {
    let target = job.settings.quality.target_error;
    let aim = target.map(|target| format!("target error {} %:", (target * 100.0) as f32));
    let progress = Progress::new("nodes", job.nodes().len() as u64, shown).toward(aim);
    let advance = |nodes, rays| progress.advance(nodes, rays);
    let stage = |stage: Stage| stages.next(stage.name());
    let seconds = || stages.total().0;
    let blocks = journal.map(|journal| journal as &dyn Blocks);
    let watch = Watch { cancel: &session.cancel, progress: &advance, stage: &stage, seconds: &seconds, blocks };
    let made = job.bake(&watch)?;
    stages.next(Stage::Pack.name());
    progress.finish();
    Ok(made)
}

/// Tells what was found, from the finding `found` on, and returns which bound was missed, if one was.
pub fn tell_made(made: &mut Made, found: usize, config: &Config, stages: &Stages, session: &Session) -> Option<String> {
    let statistics = made.records.statistics.as_mut().expect("a job fills it in");
    session.find(&statistics.findings[found..]);
    if config.settings.quality.record_times {
        stages.fill(statistics);
    }
    let missed = missed_text(made, config);
    missed.iter().for_each(|text| session.note(&[Finding::new("missed-target", made.baked.missed, text)]));
    let wrong = seen_text(statistics_of(made), config);
    wrong.iter().for_each(|text| session.note(&[Finding::new("missed-seen-error", 1, text)]));
    missed.or(wrong)
}

/// A volume in the bytes of its file, and what is said of it.
pub struct Assembled {
    pub packed: Packed,
    pub place: String,
    pub sh: String,
    pub truncation: Vec<Truncation>,
    pub exposure: Option<ExposureMatch>,
}

pub fn assemble(mut made: Made) -> Assembled {
    let place = place_text(&made.nodes);
    let (sh, truncation, exposure) = (format!("L{}", made.baked.bands), made.truncations.clone(), made.exposure.take());
    Assembled { packed: made.sections().assemble(), place, sh, truncation, exposure }
}

/// What is said of a volume. `is_traced`: by paths, of which coverage tells nothing.
pub fn report_of(assembled: Assembled, config: &Config, stages: &Stages, is_traced: bool) -> (Report, String) {
    let Assembled { packed: Packed { bytes, records }, place, sh, truncation, exposure } = assembled;
    let mut statistics = records.statistics.expect("it was filled in");
    stages.fill(&mut statistics);
    // The report's own findings are those of the whole run.
    statistics.findings.clear();
    if is_traced {
        // Null in JSON.
        statistics.coverage = f64::NAN;
    }
    let (wall_seconds, cpu_seconds) = stages.total();
    let report = Report {
        output: config.output.display().to_string(),
        wall_seconds,
        cpu_seconds,
        sh,
        bytes: bytes.len() as u64,
        seed: config.settings.quality.seed,
        unchanged: false,
        plan: records.plan,
        truncation,
        exposure,
        statistics,
    };
    let text = text(&report, &place, config.settings.quality.precision);
    (report, text)
}

fn statistics_of(made: &Made) -> &StatisticsRecord {
    made.records.statistics.as_ref().expect("a job fills it in")
}

/// Where the error between nodes is over what was asked for, if something was.
pub fn seen_text(statistics: &StatisticsRecord, config: &Config) -> Option<String> {
    let most = config.settings.quality.max_seen_error?;
    let percent = |share: f64| (share * 100.0) as f32;
    let Some(seen) = &statistics.seen else {
        return Some("--max-seen-error: between these nodes no error was measured; the volume was written".into());
    };
    let sets = [("in the air", seen.air), ("on surfaces", seen.surfaces)];
    let over = |(name, set): (&'static str, Option<SeenSet>)| Some((name, set.filter(|set| set.error.p95 > most)?));
    let over: Vec<(&str, SeenSet)> = sets.into_iter().filter_map(over).collect();
    let worst = over.iter().max_by(|(_, a), (_, b)| a.error.p95.total_cmp(&b.error.p95))?;
    let found: Vec<String> = over.iter().map(|(name, set)| format!("{:.1} % {name}", percent(set.error.p95))).collect();
    Some(format!(
        "the error between nodes is {} at the 95th percentile, --max-seen-error allows {} %; {}; the volume was written",
        found.join(" and "),
        percent(most),
        remedy(&worst.1.parts)
    ))
}

/// What helps against the largest part of an error.
fn remedy(parts: &SeenParts) -> &'static str {
    let SeenParts { noise, between, bands, packing, .. } = *parts;
    let remedies = [
        (noise, "most of it is noise: use more --samples"),
        (between, "most of it is between nodes: use a smaller --spacing"),
        (bands, "most of it is what bands leave out: use --sun extract, or --sh L3 or L4"),
        (packing, "most of it is by the numbers of the file: use --precision f16"),
    ];
    remedies.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)).map_or("", |(_, text)| text)
}

/// Which nodes missed the target error, if one was asked for.
fn missed_text(made: &Made, config: &Config) -> Option<String> {
    let target = config.settings.quality.target_error.filter(|_| made.baked.missed > 0)?;
    Some(format!(
        "{} of {} nodes missed the target error of {} % within {} samples{}; the volume was written",
        made.baked.missed,
        made.nodes.len(),
        // Rounded: 1e-6 is 0.0001 %, and not 0.00009999999999999999 %.
        (target * 100.0) as f32,
        config.settings.samples(),
        match made.baked.missed_by_systematic {
            0 => String::new(),
            nodes => format!(", {nodes} of them by their systematic error alone, which more samples do not lessen"),
        }
    ))
}

pub fn rows_text(rows: &[PlanRow]) -> String {
    let line =
        |row: &PlanRow| format!("{:<16} {:<9} {}", row.stage, if row.kept { "kept" } else { "left out" }, row.why);
    rows.iter().map(line).collect::<Vec<_>>().join("\n")
}

pub fn plan_text(plan: &[PlanRow], likely_seconds: Option<f64>) -> String {
    let time = likely_seconds.map_or_else(
        || "is not known before probes are captured".into(),
        |seconds| format!("about {seconds:.1} s on this machine, as a few nodes took"),
    );
    format!("{}\n{:<16} {time}", rows_text(plan), "time")
}

/// Where the nodes are, in words.
fn place_text(nodes: &Nodes) -> String {
    match nodes {
        Nodes::Grid(grid) => {
            let [x, y, z] = grid.counts;
            format!("grid {x} x {y} x {z}")
        }
        Nodes::Sparse(sparse) => {
            let [x, y, z] = sparse.grid.counts;
            let share = 100.0 * nodes.len() as f64 / sparse.grid.node_count() as f64;
            format!("sparse grid {x} x {y} x {z}, {share:.1} %")
        }
        Nodes::Points(_) => "points".into(),
        Nodes::Vertices { sets, .. } => format!("vertices of {} meshes", sets.len()),
    }
}

fn text(report: &Report, place: &str, precision: Precision) -> String {
    let numbers = match precision {
        Precision::F16 => "f16",
        Precision::F32 => "f32",
        Precision::Packed { .. } => "packed numbers",
    };
    let statistics = &report.statistics;
    let millions = |count: u64| count as f64 / 1e6;
    let mut lines = vec![report.output.clone()];
    let seen = statistics.seen.iter().flat_map(super::seen_lines);
    lines.extend(seen.map(|(name, text)| format!("  {name:<9} {text}")));
    lines.extend([
        format!("  nodes     {} ({}), {} valid", statistics.nodes, place, statistics.nodes_valid),
        format!("  standing  {}", super::standing_text(&statistics.standing, statistics.walls.as_ref())),
        format!("  light     {} in {numbers}, {} bytes", report.sh, report.bytes),
        format!(
            "  work      {:.1} M rays for {:.1} M directions in {:.2} s ({:.2} s of CPU)",
            millions(statistics.rays),
            millions(statistics.samples),
            report.wall_seconds,
            report.cpu_seconds
        ),
        format!("  stages    {}", super::stages_text(&statistics.stages)),
        format!("  noise     {}", super::noise_text(statistics)),
    ]);
    let mut row = |name: &str, text: String| lines.push(format!("  {name:<9} {text}"));
    super::systematic_text(statistics).into_iter().for_each(|text| row("bias", text));
    super::quarter_lines(statistics).into_iter().for_each(|text| row("progress", text));
    if !statistics.coverage.is_nan() {
        row("coverage", format!("{:.1} % of what the nodes see, some probe has seen", statistics.coverage * 100.0));
    }
    statistics.sparse.iter().flat_map(super::sparse_lines).for_each(|line| row("between", line));
    statistics.sun.iter().for_each(|sun| row("sun", super::sun_text(sun)));
    statistics.packing.iter().for_each(|packing| row("packed", super::packing_text(packing)));
    statistics.deringing.iter().for_each(|deringing| row("de-ringed", super::deringing_text(deringing)));
    let left_out = report.plan.iter().filter(|row| !row.kept);
    left_out.for_each(|left| row("left out", format!("{}: {}", left.stage, left.why)));
    lines.join("\n")
}
