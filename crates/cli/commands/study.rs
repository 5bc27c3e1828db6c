//! `gdibl study`: error against run time.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use gdibl_baker::Finding;
use gdibl_baker::analyse::Truth;
use gdibl_baker::analyse::study::{Method, Study, StudySettings};
use gdibl_baker::bake::{BakeSettings, Nodes, SparseGrid};
use gdibl_baker::import::gltf::TextureNeeds;
use gdibl_baker::job::{self, Bands, Inputs, Job, NodeKind, Settings};
use gdibl_baker::pack::write_whole;
use glam::DVec3;
use serde::Serialize;

use super::bake::is_given;
use super::compare::{Kind, other_levels, read};
use crate::captures::capture_missing;
use crate::config::{Config, FileFlags, LightFlags, file_name, set_threads};
use crate::fault::Fault;
use crate::flags::{OfBakes, SettingFlags};
use crate::inputs::{memory_of, read_inputs};
use crate::progress::{Clock, Progress};
use crate::request::{Request, hex};
use crate::session::{Outcome, Session, say};
use crate::study::kept::Kept;
use crate::study::methods::{self, Circumstances, LeftOut};
use crate::study::report::{ReferenceReport, Report};
use crate::study::runner::{Ladder, Runner};
use crate::study::{page, plot, words};

#[derive(clap::Args)]
pub struct Arguments {
    /// LEVEL.glb, LEVEL.gltf or BAKE.toml
    input: PathBuf,
    /// Where to write: OUT.html, a page to read, OUT.csv, OUT.json and OUT.svg [default: beside the input, ending in
    /// .study.html …]
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,
    #[command(flatten)]
    light: LightFlags,
    /// Other geometry for the environment (a proxy) [default: the level's nodes by role]
    #[arg(long, value_name = "FILE")]
    environment: Option<PathBuf>,
    /// Directions per node to try, ascending
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1, default_value = "64,256,1024,4096,16384")]
    budgets: Vec<u64>,
    /// Bakes of each method with each budget, by different seeds
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(2..=1000))]
    repeats: u32,
    /// Methods to try, by name [default: all that tell something here]
    #[arg(long, value_name = "NAME,NAME,…", value_delimiter = ',', num_args = 1)]
    methods: Vec<String>,
    /// What is true, as for `compare`: a volume, or a JSON of places with their light, which are then the nodes unless
    /// flags say where to bake [default: made by path tracing]
    #[arg(long, value_name = "FILE")]
    reference: Option<PathBuf>,
    /// Take this set of the reference JSON alone; repeatable [default: all sets of SH]
    #[arg(long = "set", value_name = "NAME", requires = "reference")]
    sets: Vec<String>,
    /// Directions per node of a reference made by path tracing [default: 16 times the largest budget]
    #[arg(long, value_name = "N", conflicts_with = "reference")]
    reference_samples: Option<u64>,
    /// The error at which methods are compared (0.01 is 1 %)
    #[arg(long, value_name = "F", default_value_t = 0.01)]
    at: f64,
    #[command(flatten)]
    settings: SettingFlags<OfBakes>,
    /// Never capture probes from the level: study with what is given
    #[arg(long)]
    no_capture: bool,
    /// No progress bar
    #[arg(long)]
    quiet: bool,
}

pub fn run(arguments: Arguments, session: &Session) -> Result<Outcome, Fault> {
    let clock = Clock::start();
    let asked = check_arguments(&arguments)?;
    let Arguments { budgets, quiet, at, .. } = &arguments;
    let stem = arguments.output.as_deref().map(stem_of);
    let files = FileFlags {
        input: arguments.input.clone(),
        output: stem.as_deref().map(|stem| with_ending(stem, "gdibl")),
        light: arguments.light.clone(),
        environment: arguments.environment.clone(),
    };
    let config = Config::new(files, &arguments.settings.given)?;
    set_threads(&config.settings)?;
    let stem = stem.unwrap_or_else(|| config.output.with_extension("study"));

    // Everything is read and refused before the first ray.
    let inputs = read_inputs(&config, TextureNeeds::All)?;
    let given = arguments.reference.as_deref().map(|path| read_reference(path, &arguments.sets)).transpose()?;
    let (mut job, places) = prepare(&arguments, &config, inputs, given.as_ref())?;
    session.find(&job.inputs.findings);
    job.inputs.check_light(job::Method::Gdibl)?;
    super::check_output(&with_ending(&stem, "html"))?;
    if !arguments.no_capture && job.inputs.lacks_probes() {
        let read = job.inputs.findings.len();
        capture_missing(&config, &mut job.inputs, &session.cancel, session.shown(*quiet))?;
        session.find(&job.inputs.findings[read..]);
    }
    if given.is_none() && !job.inputs.has_light() {
        return Err(Fault::Usage(format!(
            "{}: nothing in it gives light, so path tracing knows no truth: give --reference, or --distant",
            config.level.display()
        )));
    }

    let mut runner = Runner { job: &job, cancel: &session.cancel, between: None, kept: RefCell::new(Kept::nothing()) };
    let work = plan_work(&arguments, &runner, asked, given.as_ref())?;
    say(&format!("{places}; {}", work.text(&arguments)));
    if Request::is_repeatable(&config) {
        let key = key_of(&arguments, &config, &work)?;
        runner.kept = RefCell::new(Kept::open(&with_ending(&stem, "measured"), &key)?);
        match runner.kept.borrow().len() {
            0 => {}
            known => say(&format!("{known} bakes are known from a run of this study that was stopped")),
        }
    }
    let progress = Progress::new("directions", work.directions, session.shown(*quiet));
    let truths = given.as_ref().map_or(&[][..], |given| &given.truths);
    session.find(&other_levels("the study", &file_name(&config.level), truths));
    let (truths, reference) = match given {
        Some(given) => (given.truths, given.report),
        None => make_reference(&runner, work.reference_samples, &progress)?,
    };
    if job.inputs.has_light() {
        runner.look_between(work.between_samples)?;
    }
    let repeats = arguments.repeats as usize;
    let ladder = Ladder { budgets, repeats, seeds: &work.seeds, progress: &progress };
    let measured = runner.measure_all(&work.methods, &work.circumstances, &ladder, &truths)?;
    let capture = runner.capture_cost()?;
    progress.finish();
    let study = Study::of(measured, capture, &StudySettings { target: *at, nodes: job.nodes().len() });

    let report = Report {
        program: concat!("gdibl ", env!("CARGO_PKG_VERSION")),
        level: file_name(&config.level),
        places,
        light: light_text(&job.inputs),
        captured: job.inputs.captured,
        all_drawn: !arguments.methods.is_empty(),
        sh: format!("L{}", job.settings.bake().bands),
        budgets: budgets.clone(),
        repeats,
        seeds: [work.seeds[0], work.seeds[work.seeds.len() - 1]],
        reference,
        threads: rayon::current_num_threads(),
        processor: processor(),
        left_out: work.left_out,
        study,
        wall_seconds: clock.wall_seconds(),
        cpu_seconds: clock.cpu_seconds(),
    };
    if session.cancel.load(Ordering::Relaxed) {
        return Err(Fault::Interrupted);
    }
    let written = write_files(&report, &job.inputs.findings, &stem)?;
    runner.kept.into_inner().remove();
    let written: Vec<String> = written.iter().map(|path| format!("  written    {}", path.display())).collect();
    let text = format!("{}\n\n{}", words::report(&report), written.join("\n"));
    Ok(Outcome::new(report, text))
}

/// A bake divides directions in so many, to know its noise.
const LEAST_BUDGET: u64 = 4;

/// What makes no sense is refused before anything is read; returns the methods.
fn check_arguments(arguments: &Arguments) -> Result<Vec<methods::Method>, Fault> {
    let Arguments { budgets, reference_samples, settings, at, .. } = arguments;
    for (name, instead) in [
        ("samples", "--budgets says how many directions"),
        ("target_error", "--budgets says how many directions, --at the error to look at"),
        ("method", "--methods says which"),
    ] {
        if settings.given.iter().any(|given| given.name == name) {
            let flag = name.replace('_', "-");
            return Err(Fault::Usage(format!("--{flag}: does not belong to study: {instead}")));
        }
    }
    let allowed = 1..=BakeSettings::MAX_SAMPLES;
    if !budgets.iter().chain(reference_samples).all(|budget| allowed.contains(budget)) {
        return Err(Fault::Usage(format!(
            "--budgets {budgets:?}, --reference-samples: expected 1 to {} directions per node",
            BakeSettings::MAX_SAMPLES
        )));
    }
    if let Some(few) = budgets.iter().find(|budget| **budget < LEAST_BUDGET) {
        return Err(Fault::Usage(format!(
            "--budgets {few}: a bake with fewer than {LEAST_BUDGET} directions per node does not know its noise; give budgets that differ \
             much, such as 64,256,1024"
        )));
    }
    if !budgets.is_sorted_by(|a, b| a < b) {
        return Err(Fault::Usage(format!("--budgets {budgets:?}: expected them in ascending order, each once")));
    }
    if !(*at > 0.0 && at.is_finite()) {
        return Err(Fault::Usage(format!("--at {at}: expected a positive share, 0.01 for 1 %")));
    }
    match &arguments.methods[..] {
        [] => Ok(methods::Method::all()),
        names => methods::Method::parse_all(names),
    }
}

/// What is to be run.
struct Work {
    methods: Vec<methods::Method>,
    left_out: Vec<LeftOut>,
    circumstances: Circumstances,
    /// One for every repeat of every budget.
    seeds: Vec<u64>,
    /// 0: the reference is given.
    reference_samples: u64,
    /// Of a place between nodes.
    between_samples: u64,
    /// That leave nodes, in all.
    directions: u64,
}

fn plan_work(
    arguments: &Arguments,
    runner: &Runner,
    asked: Vec<methods::Method>,
    given: Option<&Given>,
) -> Result<Work, Fault> {
    let circumstances = runner.circumstances();
    let (methods, left_out) = methods::choose(asked, &circumstances);
    if methods.is_empty() {
        let reasons: Vec<String> = left_out.iter().map(|l| format!("{}: {}", l.method, l.why)).collect();
        return Err(Fault::Usage(format!("--methods: none is left: {}", reasons.join("; "))));
    }
    let Arguments { budgets, reference_samples, .. } = arguments;
    let usual = reference_samples.unwrap_or(16 * budgets[budgets.len() - 1]).min(BakeSettings::MAX_SAMPLES);
    let reference_samples = if given.is_some() { 0 } else { usual };
    // Nobody shares random numbers with the reference.
    let own = runner.job.settings.quality.seed;
    let taken = given.map_or(Some(own), |given| given.seed);
    let seeds = (1..).map(|i| own.wrapping_add(i)).filter(|seed| Some(*seed) != taken);
    let repeats = arguments.repeats as usize;
    let per_node = (methods.len() * repeats) as u64 * budgets.iter().sum::<u64>() + reference_samples;
    Ok(Work {
        methods,
        left_out,
        circumstances,
        seeds: seeds.take(repeats * budgets.len()).collect(),
        reference_samples,
        between_samples: usual,
        directions: per_node.saturating_mul(runner.job.nodes().len() as u64),
    })
}

/// What bakes of a study depend on, beside their method, directions and seed; and what their times do.
fn key_of(arguments: &Arguments, config: &Config, work: &Work) -> Result<String, Fault> {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&Request::of(config, arguments.no_capture, is_given(&arguments.settings.given))?.key());
    // Light between nodes and bytes depend on it.
    hasher.update(config.settings.quality.precision.to_string().as_bytes());
    if let Some(reference) = &arguments.reference {
        hasher.update(&std::fs::read(reference).map_err(|error| Fault::reading(reference, &error))?);
        for set in &arguments.sets {
            hasher.update(set.as_bytes());
        }
    }
    hasher.update(&work.between_samples.to_le_bytes());
    hasher.update(&rayon::current_num_threads().to_le_bytes());
    Ok(hex(hasher.finalize().as_bytes()))
}

impl Work {
    fn text(&self, arguments: &Arguments) -> String {
        let Arguments { budgets, repeats, .. } = arguments;
        let (methods, millions) = (self.methods.len(), self.directions as f64 / 1e6);
        format!("{methods} methods, {} budgets, {repeats} repeats: {millions:.0} M directions", budgets.len())
    }
}

/// Ground truth by path tracing.
fn make_reference(runner: &Runner, samples: u64, progress: &Progress) -> Result<(Vec<Truth>, ReferenceReport), Fault> {
    let seed = runner.job.settings.quality.seed;
    let (truth, cost) = runner.reference(samples, seed, progress)?;
    let about = format!(
        "path tracing with {samples} directions per node, in {:.1} s ({:.1} s of CPU); its seed is none of the repeats'",
        cost.wall_seconds, cost.cpu_seconds
    );
    let report = ReferenceReport {
        about,
        samples: Some(samples),
        seed: Some(seed),
        wall_seconds: Some(cost.wall_seconds),
        cpu_seconds: Some(cost.cpu_seconds),
    };
    Ok((vec![truth], report))
}

/// What was given as true.
struct Given {
    truths: Vec<Truth>,
    /// It is a list of places, not a volume of its own.
    listed: bool,
    seed: Option<u64>,
    name: String,
    report: ReferenceReport,
}

fn read_reference(path: &Path, sets: &[String]) -> Result<Given, Fault> {
    let input = read(path)?;
    let (listed, seed) = (matches!(input.light, Kind::Reference(_)), input.seed);
    let truths = input.truths(sets, path)?;
    let name = file_name(path);
    let names: Vec<&str> = truths.iter().map(|truth| truth.name.as_str()).collect();
    let about = if listed { format!("{name}: {}", names.join(", ")) } else { name.clone() };
    let report = ReferenceReport { about, samples: None, seed, wall_seconds: None, cpu_seconds: None };
    Ok(Given { truths, listed, seed, name, report })
}

/// The job, and where its nodes are in words.
fn prepare(
    arguments: &Arguments,
    config: &Config,
    mut inputs: Inputs,
    given: Option<&Given>,
) -> Result<(Job, String), Fault> {
    let mut settings: Settings = config.settings.clone();
    settings.quality.target_error = None;
    if settings.quality.sh == Bands::Auto {
        return Err(Fault::Usage("--sh auto: a study compares bakes of the same bands; say which".into()));
    }
    if settings.grid.tolerance.is_some() {
        return Err(Fault::Usage("--tolerance: a study bakes every place of a grid".into()));
    }
    let said = arguments.settings.given.iter().any(|given| given.section == "grid");
    let listed = given.filter(|given| given.listed && !said);
    if let Some(given) = listed {
        let positions = given.truths.iter().flat_map(|truth| &truth.positions).map(|p| DVec3::from(*p));
        inputs.places = positions.collect();
        settings.grid.nodes = NodeKind::Points(given.name.clone().into());
        (settings.grid.bounds, settings.grid.spacing, settings.grid.counts) = (None, None, None);
    }
    let memory = memory_of(&settings);
    let job = Job::prepare(inputs, settings, memory)?;
    let text = match (job.nodes(), listed) {
        (Nodes::Grid(grid) | Nodes::Sparse(SparseGrid { grid, .. }), _) => {
            let [x, y, z] = grid.counts;
            format!("grid of {x} × {y} × {z} nodes")
        }
        (Nodes::Points(positions), Some(given)) => format!("{} places of {}", positions.len(), given.name),
        (Nodes::Points(positions), None) => format!("{} points", positions.len()),
        (Nodes::Vertices { positions, .. }, _) => format!("{} vertices", positions.len()),
    };
    Ok((job, text))
}

fn light_text(inputs: &Inputs) -> String {
    let probes = match inputs.probes.len() {
        0 => "no probe".into(),
        1 => "1 probe".into(),
        n => format!("{n} probes"),
    };
    let captured = if inputs.captured { " captured from the level" } else { "" };
    let distant = match &inputs.distant {
        Some(distant) if !inputs.captured || !distant.name.is_empty() => format!(", distant panorama {}", distant.name),
        _ => String::new(),
    };
    format!("{probes}{captured}{distant}")
}

/// Its name as the system tells it, and how many of it.
fn processor() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    name.map_or(std::env::consts::ARCH.into(), |(_, name)| name.trim().to_string())
}

/// OUT of OUT, OUT.html, OUT.csv …
fn stem_of(output: &Path) -> PathBuf {
    let ours = output.extension().is_some_and(|e| ENDINGS.iter().any(|ending| e == *ending));
    if ours { output.with_extension("") } else { output.to_path_buf() }
}

const ENDINGS: [&str; 4] = ["html", "csv", "json", "svg"];

/// Behind a dot in the name, too.
fn with_ending(stem: &Path, ending: &str) -> PathBuf {
    let mut name = stem.as_os_str().to_os_string();
    name.push(".");
    name.push(ending);
    name.into()
}

/// What OUT.json holds.
#[derive(Serialize)]
struct Filed<'a> {
    #[serde(flatten)]
    report: &'a Report,
    findings: &'a [Finding],
}

fn write_files(report: &Report, findings: &[Finding], stem: &Path) -> Result<Vec<PathBuf>, Fault> {
    let is_drawn = |method: &Method| report.all_drawn || !method.is_far;
    let methods = report.study.methods.iter().filter(|method| is_drawn(method)).cloned().collect();
    let figure = plot::figure(&Study { methods, ..report.study.clone() });
    let json = serde_json::to_string_pretty(&Filed { report, findings }).expect("reports are plain data") + "\n";
    let texts = [page::html(report, &figure, findings), page::csv(&report.study), json, figure];
    let mut written = Vec::new();
    for (ending, text) in ENDINGS.iter().zip(texts) {
        let path = with_ending(stem, ending);
        write_whole(&path, text.as_bytes()).map_err(Fault::from_writing)?;
        written.push(path);
    }
    Ok(written)
}
