//! `gdibl bake`: level and probes in, volume out.

use std::path::PathBuf;
use std::sync::atomic::Ordering;

use gdibl_baker::Finding;
use gdibl_baker::bake::Nodes;
use gdibl_baker::exposure::ExposureMatch;
use gdibl_baker::job::bands::Truncation;
use gdibl_baker::job::records::{PlanRow, SeenParts, SeenSet, StatisticsRecord};
use gdibl_baker::job::{Inputs, Job, Made, Method, Row, Stage, Stop, Volumes, Wanted, Watch, wanted_of};
use gdibl_baker::pack::{Packed, Precision, write_whole};
use serde::Serialize;
use std::path::Path;

use crate::captures::capture_missing;
use crate::config::{Config, FileFlags, file_name, set_threads};
use crate::fault::Fault;
use crate::flags::{OfBakes, SettingFlags};
use crate::inputs::{memory_of, read_inputs};
use crate::progress::Progress;
use crate::report::page::{self, Surroundings};
use crate::session::{Outcome, Session, say};
use crate::stages::Stages;
use crate::volumes::{Entry, VolumeList, list_path};

#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    files: FileFlags,
    #[command(flatten)]
    settings: SettingFlags<OfBakes>,
    /// With --method gdibl: never capture probes from the level, but fill what the given ones and the sky do not show
    #[arg(long)]
    no_capture: bool,
    /// Of a level whose nodes place several volumes, bake this one alone; repeatable [default: all]
    #[arg(long = "volume", value_name = "NAME")]
    volumes: Vec<String>,
    /// Print what would be done and left out, and stop
    #[arg(long)]
    plan: bool,
    /// Write a page to look at, too: the level in the volume's light, where it is wrong, what the bake did
    #[arg(long, value_name = "REPORT.html")]
    report: Option<PathBuf>,
    /// No progress bar
    #[arg(long)]
    quiet: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Report {
    output: String,
    wall_seconds: f64,
    cpu_seconds: f64,
    sh: String,
    bytes: u64,
    seed: u64,
    plan: Vec<PlanRow>,
    /// What fewer bands than were baked would lose, or have lost.
    truncation: Vec<Truncation>,
    exposure: Option<ExposureMatch>,
    #[serde(flatten)]
    statistics: StatisticsRecord,
}

/// What `--plan --json` prints.
#[derive(Serialize)]
struct PlanReport {
    plan: Vec<PlanRow>,
    /// Of the bake on this machine; `None`: probes are still to be captured.
    likely_seconds: Option<f64>,
}

/// What `--json` prints of a level with several volumes.
#[derive(Serialize)]
struct SeveralReport {
    /// The list of all of the level's volumes.
    list: String,
    wall_seconds: f64,
    cpu_seconds: f64,
    /// Those that were baked, in its order.
    volumes: Vec<Named<Report>>,
}

/// What `--plan --json` prints of a level with several volumes.
#[derive(Serialize)]
struct SeveralPlans {
    list: String,
    volumes: Vec<Named<PlanReport>>,
}

/// A volume of a list, and what is said of it.
#[derive(Serialize)]
struct Named<T> {
    #[serde(flatten)]
    entry: Entry,
    #[serde(flatten)]
    of: T,
}

pub fn run(mut arguments: Arguments, session: &Session) -> Result<Outcome, Fault> {
    let stages = Stages::begin("read");
    let mut config = Config::new(arguments.files.clone(), &arguments.settings.given)?;
    set_threads(&config.settings)?;

    // Everything is read and refused before the first ray.
    let inputs = read_inputs(&config, config.textures())?;
    let given = std::mem::take(&mut arguments.settings.given);
    let is_given = |row: &Row| {
        let names: &[&str] = if row.name == "counts" { &["counts", "spacing"] } else { &[row.name] };
        given.iter().any(|given| given.section == row.section && names.contains(&given.name))
    };
    let mut wanted = wanted_of(&inputs.scene, &config.settings, is_given, &inputs.level)?;
    if wanted.len() > 1 {
        if let Some(page) = &arguments.report {
            let page = page.display();
            return Err(Fault::Usage(format!(
                "--report {page}: of several volumes: gdibl inspect A.gdibl B.gdibl -o {page}"
            )));
        }
        return run_several(&arguments, &config, inputs, wanted, &stages, session);
    }
    if let Some(name) = arguments.volumes.first() {
        let level = &inputs.level;
        return Err(Fault::Usage(format!("--volume {name}: {level} places no several volumes to choose from")));
    }
    if let Some(only) = wanted.pop() {
        config.settings = only.settings;
    }
    let mut job = Job::prepare(inputs, config.settings.clone(), memory_of(&config.settings))?;
    if arguments.plan {
        let (plan, likely_seconds) = (job.plan(), likely_seconds(&job, &stages, session)?);
        let text = plan_text(&plan, likely_seconds);
        return Ok(Outcome::new(PlanReport { plan, likely_seconds }, text));
    }
    session.find(&job.inputs.findings);
    job.inputs.check_light(job.method())?;
    super::check_output(&config.output)?;
    arguments.report.iter().try_for_each(|page| super::check_output(page))?;
    if job.wants_capture() && !arguments.no_capture {
        stages.next("capture");
        let read = job.inputs.findings.len();
        capture_missing(&config, &mut job.inputs, &session.cancel, arguments.quiet)?;
        session.find(&job.inputs.findings[read..]);
    }

    let found = job.inputs.findings.len();
    let is_traced = job.method() == Method::Path;
    let surroundings = arguments.report.as_ref().map(|_| Surroundings::of(&job.inputs));
    let made = bake(&mut job, &stages, session, arguments.quiet);
    // What it was made from goes before the file is put together.
    drop(job);
    let mut made = made?;
    let missed = tell_made(&mut made, found, &config, &stages, session);
    let outcome = write(made, &config, &stages, session, is_traced)?;
    if let (Some(page), Some(surroundings)) = (&arguments.report, surroundings) {
        page::write_of_file(page, &config.output, &surroundings)?;
        say(&format!("open {} in a browser to look at it", page.display()));
    }
    Ok(outcome.missing(missed))
}

/// Tells what was found, from the finding `found` on, and returns which bound was missed, if one was.
fn tell_made(made: &mut Made, found: usize, config: &Config, stages: &Stages, session: &Session) -> Option<String> {
    let statistics = made.records.statistics.as_mut().expect("a job fills it in");
    session.find(&statistics.findings[found..]);
    if config.settings.quality.record_times {
        stages.fill(&mut statistics.stages);
    }
    let missed = missed_text(made, config);
    missed.iter().for_each(|text| session.note(&[Finding::new("missed-target", made.baked.missed, text)]));
    let wrong = seen_text(statistics_of(made), config);
    wrong.iter().for_each(|text| session.note(&[Finding::new("missed-seen-error", 1, text)]));
    missed.or(wrong)
}

/// Bakes the volumes of a level, one after another. Files are written once all are baked, and the list last: where it is, they are.
fn run_several(
    arguments: &Arguments,
    config: &Config,
    inputs: Inputs,
    wanted: Vec<Wanted>,
    stages: &Stages,
    session: &Session,
) -> Result<Outcome, Fault> {
    let path = list_path(&config.output);
    let mut volumes = Volumes::prepare(inputs, wanted, memory_of(&config.settings))?;
    let list = VolumeList::of(file_name(&config.level), volumes.list());
    let chosen = chosen(&list, &arguments.volumes, &config.level)?;
    if arguments.plan {
        let plans = plans_of(&mut volumes, &list, &chosen, stages, session)?;
        return Ok(plan_several(plans, path.display().to_string()));
    }
    session.find(&volumes.job(chosen[0]).inputs.findings);
    for volume in &chosen[1..] {
        volumes.job(*volume);
        session.find(volumes.own_findings());
    }
    let job = volumes.job(chosen[0]);
    job.inputs.check_light(job.method())?;
    chosen.iter().try_for_each(|volume| super::check_output(&path.with_file_name(&list.volumes[*volume].file)))?;
    super::check_output(&path)?;
    volumes.check_open(&session.cancel)?;
    let job = volumes.job(chosen[0]);
    if job.wants_capture() && !arguments.no_capture {
        stages.next("capture");
        let read = job.inputs.findings.len();
        capture_missing(config, &mut job.inputs, &session.cancel, arguments.quiet)?;
        session.find(&job.inputs.findings[read..]);
    }

    let (mut all, mut missed) = (Vec::new(), None);
    for (turn, volume) in chosen.iter().enumerate() {
        let own_stages = (turn > 0).then(|| Stages::begin("read"));
        let stages = own_stages.as_ref().unwrap_or(stages);
        let job = volumes.job(*volume);
        let found = job.inputs.findings.len();
        let is_traced = job.method() == Method::Path;
        let output = path.with_file_name(&list.volumes[*volume].file);
        let config = Config { output, settings: job.settings.clone(), ..config.clone() };
        let made = bake(job, stages, session, arguments.quiet);
        let mut made = made.map_err(|stop| Fault::from(volumes.name_stop(*volume, stop)))?;
        let name = &list.volumes[*volume].name;
        let own_missed = tell_made(&mut made, found, &config, stages, session);
        missed = missed.or(own_missed.map(|text| format!("{name}: {text}")));
        all.push((assemble(made), config, is_traced, own_stages));
    }
    if session.cancel.load(Ordering::Relaxed) {
        return Err(Fault::Interrupted);
    }
    for (Assembled { packed, .. }, config, ..) in &all {
        write_whole(&config.output, &packed.bytes).map_err(Fault::from_writing)?;
    }
    write_whole(&path, &list.to_bytes()).map_err(Fault::from_writing)?;

    let (mut reports, mut texts) = (Vec::new(), Vec::new());
    for (volume, (assembled, config, is_traced, own_stages)) in chosen.into_iter().zip(all) {
        let (report, text) = report_of(assembled, &config, own_stages.as_ref().unwrap_or(stages), is_traced);
        texts.push(text);
        reports.push(Named { entry: list.volumes[volume].clone(), of: report });
    }
    let (wall_seconds, cpu_seconds) = stages.total();
    let report = SeveralReport { list: path.display().to_string(), wall_seconds, cpu_seconds, volumes: reports };
    let text = format!("{}\n{}: the list of them", texts.join("\n"), report.list);
    Ok(Outcome::new(report, text).missing(missed))
}

/// The places in the list of the volumes that are to be baked: all, or those of these names.
fn chosen(list: &VolumeList, names: &[String], level: &Path) -> Result<Vec<usize>, Fault> {
    let all = || list.volumes.iter().map(|entry| entry.name.as_str());
    if let Some(name) = names.iter().find(|name| all().all(|other| other != *name)) {
        let there: Vec<&str> = all().collect();
        let level = level.display();
        return Err(Fault::Usage(format!("--volume {name}: {level} has no such volume; it has {}", there.join(", "))));
    }
    let is_chosen = |name: &str| names.is_empty() || names.iter().any(|chosen| chosen == name);
    Ok(all().enumerate().filter(|(_, name)| is_chosen(name)).map(|(place, _)| place).collect())
}

fn plans_of(
    volumes: &mut Volumes,
    list: &VolumeList,
    chosen: &[usize],
    stages: &Stages,
    session: &Session,
) -> Result<Vec<Named<PlanReport>>, Fault> {
    let plan_of = |volume: &usize| {
        let job = volumes.job(*volume);
        let (plan, likely_seconds) = (job.plan(), likely_seconds(job, stages, session)?);
        Ok(Named { entry: list.volumes[*volume].clone(), of: PlanReport { plan, likely_seconds } })
    };
    chosen.iter().map(plan_of).collect()
}

/// A row for each volume, then what will be done for all alike, and then what for each.
fn plan_several(plans: Vec<Named<PlanReport>>, path: String) -> Outcome {
    let is_common = |row: &PlanRow| plans.iter().all(|plan| plan.of.plan.contains(row));
    let head = |Named { entry, of }: &Named<PlanReport>| {
        let [x, y, z] = [0, 1, 2].map(|k| entry.max[k] - entry.min[k]);
        let nodes = of.plan.iter().find(|row| row.stage == "nodes").map_or("", |row| &row.why);
        PlanRow::new(&format!("'{}'", entry.name), true, format!("{x:.3} x {y:.3} x {z:.3} m, {nodes}"))
    };
    let mut rows: Vec<PlanRow> = plans.iter().map(head).collect();
    rows.extend(plans[0].of.plan.iter().filter(|row| is_common(row)).cloned());
    let mut text = rows_text(&rows);
    for Named { entry, of } in &plans {
        let own: Vec<PlanRow> = of.plan.iter().filter(|row| !is_common(row)).cloned().collect();
        text += &format!("\n\n'{}', to {}\n{}", entry.name, entry.file, plan_text(&own, of.likely_seconds));
    }
    Outcome::new(SeveralPlans { list: path, volumes: plans }, text)
}

/// A volume in the bytes of its file, and what is said of it.
struct Assembled {
    packed: Packed,
    place: String,
    sh: String,
    truncation: Vec<Truncation>,
    exposure: Option<ExposureMatch>,
}

fn assemble(mut made: Made) -> Assembled {
    let place = place_text(&made.nodes);
    let (sh, truncation, exposure) = (format!("L{}", made.baked.bands), made.truncations.clone(), made.exposure.take());
    Assembled { packed: made.sections().assemble(), place, sh, truncation, exposure }
}

/// Packs the volume, writes it, and tells what was made. `is_traced`: by paths, of which coverage tells nothing.
fn write(made: Made, config: &Config, stages: &Stages, session: &Session, is_traced: bool) -> Result<Outcome, Fault> {
    let assembled = assemble(made);
    if session.cancel.load(Ordering::Relaxed) {
        return Err(Fault::Interrupted);
    }
    let written = write_whole(&config.output, &assembled.packed.bytes);
    written.map_err(|error| Fault::System(format!("{error}; nothing was written")))?;
    let (report, text) = report_of(assembled, config, stages, is_traced);
    Ok(Outcome::new(report, text))
}

fn report_of(assembled: Assembled, config: &Config, stages: &Stages, is_traced: bool) -> (Report, String) {
    let Assembled { packed: Packed { bytes, records }, place, sh, truncation, exposure } = assembled;
    let mut statistics = records.statistics.expect("it was filled in");
    stages.fill(&mut statistics.stages);
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
        plan: records.plan,
        truncation,
        exposure,
        statistics,
    };
    let text = text(&report, &place, config.settings.quality.precision);
    (report, text)
}

/// How long the bake is likely to take: a few nodes are baked. `None`: it depends on probes that are still to be captured.
fn likely_seconds(job: &Job, stages: &Stages, session: &Session) -> Result<Option<f64>, Fault> {
    if job.wants_capture() {
        return Ok(None);
    }
    let seconds = || stages.total().0;
    let watch = Watch { seconds: &seconds, ..Watch::silent(&session.cancel) };
    Ok(Some(job.likely_seconds(&watch).map_err(|_| Fault::Interrupted)?))
}

/// Runs the job with a progress bar.
fn bake(job: &mut Job, stages: &Stages, session: &Session, quiet: bool) -> Result<Made, Stop> {
    let progress = Progress::new("nodes", job.nodes().len() as u64, quiet);
    let advance = |nodes, rays| progress.advance(nodes, rays);
    let stage = |stage: Stage| stages.next(stage.name());
    let seconds = || stages.total().0;
    let watch = Watch { cancel: &session.cancel, progress: &advance, stage: &stage, seconds: &seconds };
    let made = job.bake(&watch)?;
    stages.next(Stage::Pack.name());
    progress.finish();
    Ok(made)
}

fn statistics_of(made: &Made) -> &StatisticsRecord {
    made.records.statistics.as_ref().expect("a job fills it in")
}

/// Where the error between nodes is over what was asked for, if something was.
fn seen_text(statistics: &StatisticsRecord, config: &Config) -> Option<String> {
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

fn rows_text(rows: &[PlanRow]) -> String {
    let line =
        |row: &PlanRow| format!("{:<16} {:<9} {}", row.stage, if row.kept { "kept" } else { "left out" }, row.why);
    rows.iter().map(line).collect::<Vec<_>>().join("\n")
}

fn plan_text(plan: &[PlanRow], likely_seconds: Option<f64>) -> String {
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
