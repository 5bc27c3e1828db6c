//! `gdibl bake`: level and probes in, volume out.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use gdibl_baker::job::records::{ErrorSummary, SettingsRecord, StatisticsRecord};
use gdibl_baker::job::{Inputs, Job, Made, Method, Row, Wanted, wanted_of};
use gdibl_baker::pack::{Precision, write_whole};
use gdibl_runtime::format::{self, Limits, SectionEntry};
use serde::Serialize;

use super::baking::{PlanReport, Report, assemble, bake, likely_seconds, plan_text, report_of, seen_text, tell_made};
use super::several;
use crate::cache::Cache;
use crate::captures::capture_missing;
use crate::config::{Config, FileFlags, set_threads};
use crate::fault::Fault;
use crate::flags::{Given, OfBakes, SettingFlags};
use crate::inputs::{memory_of, read_inputs};
use crate::journal::{Head, Journal, Shard, ShardBlocks, remove_stale, scan};
use crate::progress::Shown;
use crate::report::page::{self, Surroundings};
use crate::request::{PRECISION, Request, hex};
use crate::session::{Outcome, Session, say};
use crate::stages::Stages;

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
    /// Bake also where the output is that of the same inputs, settings and program
    #[arg(long)]
    force: bool,
    /// Write the files that the volume depends on as a rule for Make and Ninja
    #[arg(long, value_name = "FILE")]
    depfile: Option<PathBuf>,
    /// Bake one of N shards, for `gdibl assemble` [default output: the input's name with the shard's numbers]
    #[arg(long, value_name = "I/N", conflicts_with_all = ["plan", "report"])]
    shard: Option<Shard>,
    /// Do what all shards have in common, keep it in the cache, and stop
    #[arg(long, conflicts_with_all = ["plan", "shard", "output", "report"])]
    prepare: bool,
    /// No progress
    #[arg(long)]
    quiet: bool,
}

impl Arguments {
    fn of_several(&self, shown: Shown) -> several::Asked<'_> {
        several::Asked { names: &self.volumes, plan: self.plan, no_capture: self.no_capture, shown }
    }

    /// Those of the assembly of shards that were baked by these.
    pub fn of_assembly(self, output: PathBuf, depfile: Option<PathBuf>, threads: Option<u32>, quiet: bool) -> Self {
        let Arguments { mut files, mut settings, no_capture, .. } = self;
        files.output = Some(output);
        settings.given.retain(|given| given.name != "threads");
        settings.given.extend(threads.map(|threads| Given::new("quality", "threads", threads)));
        Arguments {
            files,
            settings,
            no_capture,
            plan: false,
            report: None,
            volumes: Vec::new(),
            force: true,
            depfile,
            shard: None,
            prepare: false,
            quiet,
        }
    }
}

/// What `--json` prints of a shard, or of what shards have in common.
#[derive(Serialize)]
struct ShardReport {
    output: Option<String>,
    shard: Option<String>,
    wall_seconds: f64,
    cpu_seconds: f64,
    bytes: u64,
    unchanged: bool,
}

pub fn run(arguments: Arguments, session: &Session) -> Result<Outcome, Fault> {
    let command = std::env::args_os().skip(1).map(|argument| argument.to_string_lossy().into_owned()).collect();
    work(arguments, command, None, session)
}

/// A bake, one shard of it, or the assembly of `shards`. `command` is the command line of the bake.
pub fn work(
    arguments: Arguments,
    command: Vec<String>,
    shards: Option<(Request, Vec<ShardBlocks>)>,
    session: &Session,
) -> Result<Outcome, Fault> {
    let stages = Stages::begin("read");
    let Arguments { no_capture, shard, prepare, force, .. } = arguments;
    let has_output = arguments.files.output.is_some();
    let mut config = Config::new(arguments.files.clone(), &arguments.settings.given)?;
    if let Some(Shard { index, count }) = shard.filter(|_| !has_output) {
        config.output.set_extension(format!("{index}-of-{count}.shard"));
    }
    set_threads(&config.settings)?;
    let shown = session.shown(arguments.quiet);
    if arguments.plan {
        let inputs = read_inputs(&config, config.textures())?;
        let placed = place(&arguments, &mut config, inputs)?;
        let inputs = match placed {
            Placed::One(inputs) => inputs,
            Placed::Several(inputs, wanted) => {
                return several::run(&arguments.of_several(shown), &config, inputs, wanted, &stages, session);
            }
        };
        let job = Job::prepare(inputs, config.settings.clone(), memory_of(&config.settings))?;
        let (plan, likely_seconds) = (job.plan(), likely_seconds(&job, &stages, session)?);
        let text = plan_text(&plan, likely_seconds);
        return Ok(Outcome::new(PlanReport { plan, likely_seconds }, text));
    }

    // What is there already is not made again.
    let request = Request::of(&config, no_capture)?;
    let is_repeatable = Request::is_repeatable(&config);
    // What was found under a budget of time is not found again.
    let is_timed = config.settings.grid.budget.is_some();
    if (shard.is_some() || prepare) && (is_timed || !is_repeatable) {
        let why = "shards are bakes of the same nodes, which neither --budget nor points of standard input give twice";
        return Err(Fault::Usage(format!("--shard, --prepare: {why}")));
    }
    if let Some((of, shards)) = &shards
        && *of != request
    {
        return Err(Fault::Invalid(format!(
            "{}: was baked from other inputs, by another program or with other settings: {} differs; bake the shards again",
            shards[0].path.display(),
            of.difference(&request)
        )));
    }
    let is_there = |config: &Config| match shard {
        _ if force || prepare || !is_repeatable => None,
        Some(shard) => unchanged_shard(config, &request, shard, &stages),
        None => unchanged(config, &request, &stages, session),
    };
    let depfile = |config: &Config, outcome: Outcome, shards: &[PathBuf]| {
        write_depfile(arguments.depfile.as_deref(), config, shards).map(|()| outcome)
    };
    if let Some(outcome) = is_there(&config) {
        remove_stale(&config.output);
        if let Some(page) = &arguments.report {
            let inputs = read_inputs(&config, config.textures())?;
            write_page(page, &config.output, &Surroundings::of(&inputs))?;
        }
        return depfile(&config, outcome, &[]);
    }

    // Everything is read and refused before the first ray.
    let inputs = read_inputs(&config, config.textures())?;
    let mut inputs = match place(&arguments, &mut config, inputs)? {
        Placed::One(inputs) => inputs,
        Placed::Several(inputs, wanted) => {
            return several::run(&arguments.of_several(shown), &config, inputs, wanted, &stages, session);
        }
    };
    inputs.request = if is_repeatable { request.key() } else { [0; 32] };
    let job = Job::prepare(inputs, config.settings.clone(), memory_of(&config.settings))?;
    session.find(&job.inputs.findings);
    job.inputs.check_light(job.method())?;
    let folder = std::env::current_dir().unwrap_or_default();
    let shared = format!("{}-shared", hex(&request.key()));
    let head = Head { request: request.clone(), shard, arguments: command, folder };
    let mut journal = if prepare {
        Journal::temporary()?
    } else {
        super::check_output(&config.output)?;
        arguments.report.iter().try_for_each(|page| super::check_output(page))?;
        Journal::open(&config.output, &head, is_repeatable && !is_timed, &session.cancel)?
    };
    // Another bake may have made it while this one waited.
    if let Some(outcome) = is_there(&config) {
        journal.remove()?;
        return depfile(&config, outcome, &[]);
    }
    let shards = shards.map_or_else(Vec::new, |(_, shards)| shards);
    let read: Vec<PathBuf> = shards.iter().map(|shard| shard.path.clone()).collect();
    journal.add_shards(shards);
    let report = arguments.report.as_deref();
    let run = Run { config: &config, stages: &stages, session, shown, no_capture, report };
    let outcome = match shard.is_some() || prepare {
        true => run.shard(job, &mut journal, shard, &shared),
        false => run.volume(job, &journal),
    };
    match outcome {
        Ok(outcome) => {
            journal.remove()?;
            depfile(&config, outcome, &read)
        }
        // What was stopped goes on later, if there is anything to go on from.
        Err(fault @ (Fault::Interrupted | Fault::System(_))) if journal.has_blocks() => Err(fault),
        Err(fault) => {
            journal.remove()?;
            Err(fault)
        }
    }
}

/// What a level places.
enum Placed {
    /// One volume; the configuration has the settings of its node, if a node places it.
    One(Inputs),
    Several(Inputs, Vec<Wanted>),
}

/// Finds out how many volumes there are to be, and takes the settings of an only one.
fn place(arguments: &Arguments, config: &mut Config, inputs: Inputs) -> Result<Placed, Fault> {
    let given = &arguments.settings.given;
    let is_given = |row: &Row| {
        let names: &[&str] = if row.name == "counts" { &["counts", "spacing"] } else { &[row.name] };
        given.iter().any(|given| given.section == row.section && names.contains(&given.name))
    };
    let mut wanted = wanted_of(&inputs.scene, &config.settings, is_given, &inputs.level)?;
    if wanted.len() > 1 {
        let Arguments { report, shard, prepare, depfile, .. } = arguments;
        let asked = [
            (
                "--report",
                report.is_some(),
                "gdibl inspect A.gdibl B.gdibl -o PAGE.html makes a page of several volumes",
            ),
            ("--shard", shard.is_some(), "several volumes are not divided; choose a box with --bounds"),
            ("--prepare", *prepare, "several volumes are not divided; choose a box with --bounds"),
            ("--depfile", depfile.is_some(), "it is a rule for one volume; choose a box with --bounds"),
        ];
        if let Some((flag, _, why)) = asked.into_iter().find(|(_, is_asked, _)| *is_asked) {
            return Err(Fault::Usage(format!("{flag}: {} places {} volumes: {why}", inputs.level, wanted.len())));
        }
        return Ok(Placed::Several(inputs, wanted));
    }
    if let Some(name) = arguments.volumes.first() {
        let level = &inputs.level;
        return Err(Fault::Usage(format!("--volume {name}: {level} places no several volumes to choose from")));
    }
    if let Some(only) = wanted.pop() {
        config.settings = only.settings;
    }
    Ok(Placed::One(inputs))
}

fn write_page(page: &Path, volume: &Path, surroundings: &Surroundings) -> Result<(), Fault> {
    page::write_of_file(page, volume, surroundings)?;
    say(&format!("open {} in a browser to look at it", page.display()));
    Ok(())
}

/// A bake that has something to do.
struct Run<'a> {
    config: &'a Config,
    stages: &'a Stages,
    session: &'a Session,
    shown: Shown,
    no_capture: bool,
    /// Where a page is to go.
    report: Option<&'a Path>,
}

impl Run<'_> {
    /// Captures probes, if some are needed.
    fn capture(&self, job: &mut Job) -> Result<(), Fault> {
        if job.wants_capture() && !self.no_capture {
            self.stages.next("capture");
            let read = job.inputs.findings.len();
            capture_missing(self.config, &mut job.inputs, &self.session.cancel, self.shown)?;
            self.session.find(&job.inputs.findings[read..]);
        }
        self.config.files.forget();
        Ok(())
    }

    /// The whole, and its file.
    fn volume(&self, mut job: Job, journal: &Journal) -> Result<Outcome, Fault> {
        let Run { config, stages, session, .. } = *self;
        self.capture(&mut job)?;
        let found = job.inputs.findings.len();
        let is_traced = job.method() == Method::Path;
        let surroundings = self.report.map(|page| (page, Surroundings::of(&job.inputs)));
        let made = bake(&mut job, stages, session, self.shown, Some(journal));
        // What it was made from goes before the file is put together.
        drop(job);
        let mut made = made?;
        let missed = tell_made(&mut made, found, config, stages, session);
        let outcome = write(made, config, stages, session, is_traced)?;
        if let Some((page, surroundings)) = surroundings {
            write_page(page, &config.output, &surroundings)?;
        }
        Ok(outcome.missing(missed))
    }

    /// One shard, or, without one, what all have in common, which is called `shared` in the cache.
    fn shard(&self, mut job: Job, journal: &mut Journal, shard: Option<Shard>, shared: &str) -> Result<Outcome, Fault> {
        self.capture(&mut job)?;
        share(journal, &self.config.cache, shared, &self.session.cancel)?;
        journal.only_shared(shard.is_none());
        let baked = bake(&mut job, self.stages, self.session, self.shown, Some(journal));
        // Where coarse grids are good enough nothing is divided: every shard has all.
        if !journal.is_done() {
            baked?;
        }
        journal.share_now();
        write_shard(journal, shard, self.config, self.stages)
    }
}

/// The blocks that all shards need come from the cache, or go there. Of several shards at once one finds them.
fn share(journal: &mut Journal, cache: &Cache, name: &str, cancel: &AtomicBool) -> Result<(), Fault> {
    let take = |journal: &Journal| cache.get(name).map(|bytes| journal.take_shared(&bytes)).is_some();
    if take(journal) {
        return Ok(());
    }
    let making = cache.make(name, cancel)?;
    if take(journal) {
        return Ok(());
    }
    let (cache, name) = (cache.clone(), name.to_string());
    let put = move |shared: Vec<u8>| {
        cache.put(&name, &shared);
        drop(making);
    };
    journal.share(put);
    Ok(())
}

/// Ends a shard and puts it in its place. Without one the cache has all that was to be done.
fn write_shard(
    journal: &mut Journal,
    shard: Option<Shard>,
    config: &Config,
    stages: &Stages,
) -> Result<Outcome, Fault> {
    let output = &config.output;
    let (bytes, text) = match shard {
        Some(shard) => {
            let bytes = journal.finish(output)?;
            (bytes, format!("{}: shard {shard}, {bytes} bytes", output.display()))
        }
        None => (0, format!("{}: has all that the shards have in common", config.cache.folder().display())),
    };
    let (wall_seconds, cpu_seconds) = stages.total();
    let output = shard.map(|_| output.display().to_string());
    let shard = shard.map(|shard| shard.to_string());
    Ok(Outcome::new(ShardReport { output, shard, wall_seconds, cpu_seconds, bytes, unchanged: false }, text))
}

/// The shard is there already, whole.
fn unchanged_shard(config: &Config, request: &Request, shard: Shard, stages: &Stages) -> Option<Outcome> {
    let mut file = config.output.is_file().then(|| std::fs::File::open(&config.output).ok())??;
    let found = scan(&mut file).ok().filter(|found| found.is_whole)?;
    if found.head.request != *request || found.head.shard != Some(shard) {
        return None;
    }
    let output = config.output.display().to_string();
    let text = format!("{output}: unchanged: it is shard {shard} of this bake; --force bakes it again");
    let (wall_seconds, cpu_seconds) = stages.total();
    let bytes = file.metadata().ok()?.len();
    let report = ShardReport {
        output: Some(output),
        shard: Some(shard.to_string()),
        wall_seconds,
        cpu_seconds,
        bytes,
        unchanged: true,
    };
    Some(Outcome::new(report, text))
}

/// The output is there already: whole, and made from an equal request.
fn unchanged(config: &Config, request: &Request, stages: &Stages, session: &Session) -> Option<Outcome> {
    let path = &config.output;
    // A device may have no end.
    let bytes = path.is_file().then(|| std::fs::read(path).ok())??;
    let directory = format::parse_header_and_sections(&bytes).ok()?;
    let settings: SettingsRecord = super::record(&directory, path, format::SETTINGS).ok()??;
    if settings.request != request.key() {
        return None;
    }
    // Every section is as it was written.
    let is_whole = |entry: &SectionEntry| directory.section_bytes(entry.id, &Limits::default()).is_ok();
    if !directory.sections.iter().all(is_whole) {
        return None;
    }
    let mut statistics: StatisticsRecord = super::record(&directory, path, format::STATISTICS).ok()??;
    let plan = super::record(&directory, path, format::PLAN).ok()??;
    // The file says the precision in force: that which was asked for, or which follows from its noise.
    let precision = match config.settings.quality.precision {
        Precision::Packed { error: None } => {
            let error = Precision::packed_error(statistics.relative_error.map(|error| error.median));
            Precision::Packed { error: Some(error) }
        }
        asked => asked,
    };
    let recorded = settings.settings.iter().find(|setting| setting.name == PRECISION)?;
    if recorded.value != Some(precision.to_string()) {
        return None;
    }
    // A bound that was missed is missed. Where the record does not tell, it is baked again.
    let missed = match config.settings.quality.target_error {
        None => None,
        Some(target) => {
            let most = |error: Option<ErrorSummary>| error.map(|error| error.max);
            let noise = most(statistics.relative_error)?;
            let systematic = most(statistics.systematic_error).unwrap_or(0.0);
            let text =
                format!("some nodes miss the target error of {} %; the volume is unchanged", (target * 100.0) as f32);
            match () {
                () if noise.hypot(systematic) <= target => None,
                () if noise.max(systematic) > target => Some(text),
                () => return None,
            }
        }
    };
    let wrong = seen_text(&statistics, config);
    session.note(&std::mem::take(&mut statistics.findings));
    if settings.method == "path" {
        // Null in JSON.
        statistics.coverage = f64::NAN;
    }
    let (wall_seconds, cpu_seconds) = stages.total();
    let output = path.display().to_string();
    let text = format!(
        "{output}: unchanged: inputs, settings and program are those that it was baked by; --force bakes it again"
    );
    let report = Report {
        output,
        wall_seconds,
        cpu_seconds,
        sh: format!("L{}", directory.header.bands),
        bytes: bytes.len() as u64,
        seed: config.settings.quality.seed,
        unchanged: true,
        plan,
        truncation: Vec::new(),
        exposure: None,
        statistics,
    };
    Some(Outcome::new(report, text).missing(missed.or(wrong)))
}

/// `output: input input …`, as Make and Ninja read it.
fn write_depfile(path: Option<&Path>, config: &Config, shards: &[PathBuf]) -> Result<(), Fault> {
    let Some(path) = path else { return Ok(()) };
    let name = |path: &Path| {
        let mut text = String::new();
        for character in path.to_string_lossy().chars() {
            match character {
                ' ' | '#' => text.extend(['\\', character]),
                '$' => text.push_str("$$"),
                other => text.push(other),
            }
        }
        text
    };
    let inputs: Vec<String> = config.files.paths().iter().chain(shards).map(|path| name(path)).collect();
    let rule = format!("{}: {}\n", name(&config.output), inputs.join(" \\\n  "));
    write_whole(path, rule.as_bytes()).map_err(Fault::from_writing)
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
