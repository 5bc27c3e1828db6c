//! `gdibl bake`: level and probes in, volume out.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use gdibl_baker::job::{Inputs, Job, Made, Method, Row, Wanted, wanted_of};
use gdibl_baker::pack::write_whole;

use super::baking::{PlanReport, ShardReport, assemble, bake, likely_seconds, plan_text, report_of, tell_made};
use super::several;
use super::unchanged::{unchanged, unchanged_shard};
use crate::cache::Cache;
use crate::captures::capture_missing;
use crate::config::{Config, FileFlags, set_threads};
use crate::fault::Fault;
use crate::flags::{Given, OfBakes, SettingFlags};
use crate::inputs::{memory_of, read_inputs};
use crate::journal::{Head, Journal, Shard, ShardBlocks, remove_stale};
use crate::progress::Shown;
use crate::report::page::{self, Surroundings};
use crate::request::{Request, hex};
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
    fn of_several(&self) -> several::Asked<'_> {
        several::Asked { names: &self.volumes, no_capture: self.no_capture, force: self.force }
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
                let bake = several::Bake { config: &config, stages: &stages, session, shown };
                return several::plan(&arguments.of_several(), &bake, inputs, wanted);
            }
        };
        let job = Job::prepare(inputs, config.settings.clone(), memory_of(&config.settings))?;
        let (plan, likely_seconds) = (job.plan(), likely_seconds(&job, &stages, session)?);
        let text = plan_text(&plan, likely_seconds);
        return Ok(Outcome::new(PlanReport { plan, likely_seconds }, text));
    }

    // What is there already is not made again.
    let request = Request::of(&config, no_capture, is_given(&arguments.settings.given))?;
    let is_repeatable = Request::is_repeatable(&config);
    if (shard.is_some() || prepare) && (config.settings.grid.budget.is_some() || !is_repeatable) {
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
        None => unchanged(config, &request, &stages, session).map(Outcome::from),
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
            let head = Head { request, shard: None, arguments: command, folder: folder() };
            let bake = several::Bake { config: &config, stages: &stages, session, shown };
            return several::run(&arguments.of_several(), &bake, inputs, wanted, &head);
        }
    };
    inputs.request = if is_repeatable { request.key() } else { [0; 32] };
    let job = Job::prepare(inputs, config.settings.clone(), memory_of(&config.settings))?;
    session.find(&job.inputs.findings);
    job.inputs.check_light(job.method())?;
    let shared = format!("{}-shared", hex(&request.key()));
    let head = Head { request: request.clone(), shard, arguments: command, folder: folder() };
    let mut journal = if prepare {
        Journal::temporary()?
    } else {
        super::check_output(&config.output)?;
        arguments.report.iter().try_for_each(|page| super::check_output(page))?;
        Journal::open(&config.output, &head, is_repeatable, &session.cancel)?
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

/// Where this run was started.
fn folder() -> PathBuf {
    std::env::current_dir().unwrap_or_default()
}

/// Whether a setting was given for this very run.
pub(super) fn is_given(given: &[Given]) -> impl Fn(&Row) -> bool {
    |row| {
        let names: &[&str] = if row.name == "counts" { &["counts", "spacing"] } else { &[row.name] };
        given.iter().any(|given| given.section == row.section && names.contains(&given.name))
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
    let is_given = is_given(&arguments.settings.given);
    let mut wanted = wanted_of(&inputs.scene, &config.settings, is_given, &inputs.level)?;
    if wanted.len() > 1 {
        let Arguments { report, shard, prepare, depfile, .. } = arguments;
        let asked = [
            (
                "--report",
                report.is_some(),
                "gdibl inspect A.gdibl B.gdibl -o PAGE.html makes a page of several volumes",
            ),
            (
                "--shard",
                shard.is_some(),
                "several volumes are not divided; bake each on a machine of its own with --volume NAME",
            ),
            (
                "--prepare",
                *prepare,
                "several volumes are not divided; bake each on a machine of its own with --volume NAME",
            ),
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
