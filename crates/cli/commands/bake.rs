//! `gdibl bake`: level and probes in, volume out.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use gdibl_baker::bake::{self, BakeSettings, Baked, Nodes, Standing};
use gdibl_baker::bands::{self, Truncation};
use gdibl_baker::import::gltf::TextureNeeds;
use gdibl_baker::plan::{self, PlanRow};
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::radiance::exposure::ExposureMatch;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings, SceneHit};
use gdibl_baker::radiance::path::Path;
use gdibl_baker::radiance::unseen::{UNSEEN_PLACES, Unseen};
use gdibl_baker::records::{
    DeringingRecord, ErrorSummary, PackingRecord, ProbeRecord, Records, SettingsRecord, SparseRecord, StandingRecord,
    StatisticsRecord, SunRecord, WallsRecord,
};
use gdibl_baker::sampling::Sampler;
use gdibl_baker::volume::{PackSettings, Packed, Precision, sections, write_whole};
use gdibl_baker::{Control, Finding};
use gdibl_runtime::sh::MAX_BANDS;
use serde::Serialize;

use crate::captures::capture_missing;
use crate::config::{
    Bands, CaptureFlags, Config, FileFlags, GridFlags, Method, Punctual, QualityFlags, Sun, check_target, clamp,
    gdibl_settings, path_settings, set_threads,
};
use crate::fault::Fault;
use crate::inputs::{Inputs, nodes_of};
use crate::progress::{Progress, cancel_on_interrupt};

#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    files: FileFlags,
    #[command(flatten)]
    grid: GridFlags,
    #[command(flatten)]
    quality: QualityFlags,
    /// Never capture probes from the level: bake with what is given, uncovered directions are filled
    #[arg(long)]
    no_capture: bool,
    /// Print what would be done and left out, and stop
    #[arg(long)]
    plan: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    /// No progress bar
    #[arg(long)]
    quiet: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Report<'a> {
    output: String,
    nodes: u64,
    nodes_valid: u64,
    rays: u64,
    wall_seconds: f64,
    cpu_seconds: f64,
    sh: String,
    relative_error: Option<ErrorSummary>,
    worst_direction_error: Option<ErrorSummary>,
    coverage: f64,
    standing: StandingRecord,
    walls: Option<WallsRecord>,
    sparse: Option<&'a SparseRecord>,
    /// What fewer bands than were baked would lose, or have lost.
    truncation: &'a [Truncation],
    deringing: Option<DeringingRecord>,
    packing: Option<PackingRecord>,
    sun: Option<SunRecord>,
    exposure: Option<&'a ExposureMatch>,
    bytes: u64,
    plan: &'a [PlanRow],
    seed: u64,
    samples: u64,
    findings: &'a [gdibl_baker::Finding],
}

/// What `--sh auto` allows fewer bands to lose where no tolerance is given.
const BANDS_TOLERANCE: f64 = 0.1;

pub fn run(arguments: Arguments) -> Result<(), Fault> {
    let started = Instant::now();
    let cancel = cancel_on_interrupt();
    let config = Config::new(arguments.files, arguments.grid, arguments.quality, CaptureFlags::default())?;
    set_threads(config.quality.threads)?;
    let settings = bake_settings(&config)?;
    let method = config.quality.method.unwrap_or_default();

    // Everything is read and refused before the first ray.
    // Where no probe counts paths are traced.
    let mut inputs = Inputs::read(&config, TextureNeeds::All)?;
    let sun = match config.quality.sun.unwrap_or_default() {
        Sun::Include => None,
        Sun::Extract => inputs.extract_sun()?.map(SunRecord::from),
    };
    let mut nodes = nodes_of(&config, &inputs.scene)?;
    let tolerance = config.grid.tolerance;
    check_memory(&nodes, tolerance.is_some(), &settings, config.quality.max_memory)?;
    // Nothing asks for what no node can see.
    let sealed = inputs.distant.as_ref().filter(|_| bake::is_sealed(&nodes, &inputs.scene));
    let sealed = sealed.map(|distant| plan::sealed_distant(&distant.name));
    let captures = method == Method::Gdibl && !arguments.no_capture && inputs.lacks_probes();
    if !arguments.plan {
        inputs.warn();
        inputs.check_light(&config, method)?;
        super::check_output(&config.output)?;
    }
    if sealed.is_some() {
        inputs.distant = None;
    }
    let capture = match captures {
        true if arguments.plan => PlanRow::new("capture", true, "no probe is given: they are captured from the level"),
        // The same whether they were there already: same inputs, same bytes.
        true => match capture_missing(&config, &mut inputs, &cancel, arguments.quiet)? {
            0 => PlanRow::new("capture", false, "no probe is given, and the level's box has no place for one"),
            n => PlanRow::new("capture", true, format!("no probe is given: {n} captured from the level")),
        },
        false => PlanRow::new("capture", false, no_capture_reason(&inputs, method, arguments.no_capture)),
    };
    let mut plan = vec![capture];
    plan.extend(match &inputs.exposure {
        Some(matched) => Some(plan::match_exposure(matched)),
        None if config.quality.match_exposure == Some(true) => {
            Some(PlanRow::new("match-exposure", false, "path tracing needs no probe"))
        }
        None => None,
    });

    let job = Job { nodes: &nodes, tolerance, settings: &settings, cancel: &cancel, quiet: arguments.quiet };
    let between = vec![plan::sparse(&nodes, tolerance, None), plan::walls(&nodes, &inputs.scene, None)];
    let (mut plan, found) = match method {
        Method::Gdibl => {
            let gdibl = gdibl_settings(&config.quality, inputs.captured, settings.directions(nodes.len() as u64));
            let size = inputs.scene.bounds(|_| true).map_or(0.0, |(min, max)| (max - min).max_element());
            let gdibl = GdiblSettings { coarsest: nodes.coarsest_pixel(size), ..gdibl };
            let mut function = Gdibl::new(&inputs.scene, &inputs.probes, inputs.distant.as_ref(), gdibl);
            function.choose_unseen(Unseen::Auto, &nodes.some_positions(UNSEEN_PLACES));
            let plan = [plan, plan::plan(&inputs.scene, &function)].concat();
            let plan = with_sealed(plan, sealed);
            if arguments.plan {
                return print_plan([plan, between].concat(), &config, arguments.json);
            }
            (plan, job.bake(&function)?)
        }
        Method::Path => {
            let path = Path::new(&inputs.scene, inputs.distant.as_ref(), path_settings(&config.quality)?);
            let plan = [plan, plan::plan_path(&inputs.scene, &path)].concat();
            let plan = with_sealed(plan, sealed);
            if arguments.plan {
                return print_plan([plan, between].concat(), &config, arguments.json);
            }
            (plan, job.bake(&path)?)
        }
    };
    let (sparse_nodes, mut baked, sparse) = found;
    nodes = sparse_nodes.unwrap_or(nodes);
    let truncations = bands::truncations(&baked);
    if config.quality.sh == Some(Bands::Auto) {
        let within = tolerance.unwrap_or(BANDS_TOLERANCE);
        let fewest = bands::fewest(&truncations, within, baked.bands);
        plan.push(plan::bands(&truncations, within, fewest));
        bands::truncate(&mut baked, fewest);
    }
    inputs.findings.extend(clamped_light(&baked, &settings));
    inputs.findings.extend(dropped_walls(&baked));
    plan.push(plan::sparse(&nodes, tolerance, sparse.as_ref()));
    plan.push(plan::walls(&nodes, &inputs.scene, Some(&baked)));
    let records = Records {
        settings: settings_record(&config, &settings, method),
        probes: probe_records(&inputs),
        statistics: StatisticsRecord { sun, sparse, ..statistics(&baked, &inputs) },
        plan,
    };
    let precision = config.quality.precision.unwrap_or_default();
    let packing = PackSettings {
        precision,
        zstd: config.quality.zstd.unwrap_or(matches!(precision, Precision::Packed { .. })),
        dering: config.quality.dering.unwrap_or(false),
    };
    let sections = sections(&nodes, &baked, records, packing);
    let (rays, samples, missed, bands) = (baked.rays, baked.samples, baked.missed, baked.bands);
    // As large as the file, which is put together next.
    drop(baked);
    let Packed { bytes, records } = sections.assemble();
    if cancel.load(Ordering::Relaxed) {
        return Err(Fault::Interrupted);
    }
    write_whole(&config.output, &bytes).map_err(|error| Fault::System(format!("{error}; nothing was written")))?;

    let report = Report {
        output: config.output.display().to_string(),
        nodes: nodes.len() as u64,
        nodes_valid: records.statistics.nodes_valid,
        rays,
        wall_seconds: started.elapsed().as_secs_f64(),
        cpu_seconds: cpu_time::ProcessTime::now().as_duration().as_secs_f64(),
        sh: format!("L{bands}"),
        relative_error: records.statistics.relative_error,
        worst_direction_error: records.statistics.worst_direction_error,
        coverage: records.statistics.coverage,
        standing: records.statistics.standing,
        walls: records.statistics.walls,
        sparse: records.statistics.sparse.as_ref(),
        truncation: &truncations,
        deringing: records.statistics.deringing,
        packing: records.statistics.packing,
        sun: records.statistics.sun,
        exposure: inputs.exposure.as_ref(),
        bytes: bytes.len() as u64,
        plan: &records.plan,
        seed: settings.seed,
        samples,
        findings: &records.statistics.findings,
    };
    if arguments.json {
        super::print_json(&report)?;
    } else {
        print_report(&report, &nodes, packing.precision)?;
    }
    match settings.target_error {
        Some(target) if missed > 0 => Err(Fault::Bound(format!(
            "{} of {} nodes missed the target error of {} % within {} samples; the volume was written",
            missed,
            nodes.len(),
            // Rounded: 1e-6 is 0.0001 %, and not 0.00009999999999999999 %.
            (target * 100.0) as f32,
            settings.samples
        ))),
        _ => Ok(()),
    }
}

/// What the steps of a bake share.
struct Job<'a> {
    nodes: &'a Nodes,
    tolerance: Option<f64>,
    settings: &'a BakeSettings,
    cancel: &'a AtomicBool,
    quiet: bool,
}

/// Other nodes than were given, if the grid became sparse; what was baked at them, and how sparse it is.
type Found = (Option<Nodes>, Baked, Option<SparseRecord>);

impl Job<'_> {
    fn bake(&self, function: &impl RadianceFunction) -> Result<Found, Fault> {
        let progress = Progress::new("nodes", self.nodes.len() as u64, self.quiet);
        let control = Control { cancel: self.cancel, progress: &|nodes, rays| progress.advance(nodes, rays) };
        let found = match (self.nodes, self.tolerance) {
            (Nodes::Grid(grid), Some(tolerance)) => {
                bake::bake_sparse(grid, tolerance, function, self.settings, &control)
                    .map(|(nodes, baked, record)| (Some(nodes), baked, record))
            }
            _ => bake::bake(self.nodes, function, self.settings, &control).map(|baked| (None, baked, None)),
        };
        let found = found.map_err(|_| Fault::Interrupted)?;
        progress.finish();
        check_valid(&found.1)?;
        Ok(found)
    }
}

/// Without a valid node there is no light.
pub fn check_valid(baked: &Baked) -> Result<(), Fault> {
    if baked.valid_nodes().next().is_some() {
        return Ok(());
    }
    let count = |of: Standing| baked.standing.iter().filter(|standing| **standing == of).count();
    let [uncovered, solid, outside] = [Standing::Uncovered, Standing::Solid, Standing::Outside].map(count);
    let advice = match uncovered {
        0 => "are the nodes in the level's rooms, and do its triangles face them (front: counter-clockwise)?",
        _ => "are the probes' positions in the level's metres, inside the same rooms as the nodes, not in a wall?",
    };
    Err(Fault::Bound(format!(
        "no node of {} has light of its own, so there is nothing to fill from and nothing was written: {uncovered} saw \
         nothing that a probe or the distant panorama has seen, {solid} are in solids, {outside} behind the level's surfaces; \
         {advice}",
        baked.len()
    )))
}

fn no_capture_reason(inputs: &Inputs, method: Method, forbidden: bool) -> &'static str {
    if method == Method::Path {
        "path tracing needs no probe"
    } else if !inputs.probes.is_empty() {
        "probes are given"
    } else if forbidden {
        "forbidden by --no-capture"
    } else {
        "no environment geometry that a probe could see"
    }
}

fn clamped_light(baked: &Baked, settings: &BakeSettings) -> Option<Finding> {
    (baked.clamped > 0.0).then(|| {
        let message = format!("--clamp {} took {:.3} % of the light away", settings.clamp, baked.clamped * 100.0);
        Finding::new("clamped-light", 1, message)
    })
}

fn dropped_walls(baked: &Baked) -> Option<Finding> {
    let dropped = baked.walls.as_ref().map_or(0, |walls| walls.dropped);
    (dropped > 0).then(|| {
        let message = format!(
            "{dropped} cells with walls are left as if they had none: a file holds at most 65535 planes; split the volume, or \
             bake with a larger --spacing"
        );
        Finding::new("dropped-walls", dropped as u64, message)
    })
}

pub fn bake_settings(config: &Config) -> Result<BakeSettings, Fault> {
    let quality = &config.quality;
    let defaults = BakeSettings::default();
    let samples = match (quality.samples, quality.target_error) {
        (Some(samples), _) => samples,
        (None, Some(_)) => BakeSettings::TARGET_SAMPLES,
        (None, None) => defaults.samples,
    };
    if !(1..=BakeSettings::MAX_SAMPLES).contains(&samples) {
        return Err(Fault::Usage(format!("--samples {samples}: expected 1 to {}", BakeSettings::MAX_SAMPLES)));
    }
    check_target(quality.target_error)?;
    Ok(BakeSettings {
        bands: match quality.sh {
            None => defaults.bands,
            Some(Bands::To(bands)) => bands,
            // Those that are not needed are left out once they are known.
            Some(Bands::Auto) => MAX_BANDS,
        },
        samples,
        target_error: quality.target_error,
        seed: quality.seed.unwrap_or(defaults.seed),
        sampler: quality.sampler.unwrap_or(defaults.sampler),
        importance: true,
        coefficient_errors: quality.coefficient_errors.unwrap_or(false),
        punctual: quality.punctual == Some(Punctual::Include),
        clamp: clamp(quality)?,
    })
}

/// What a sparse grid is taken to have of its places, before anything is known of it. Rooms have less.
const SPARSE_SHARE: u64 = 2;

/// Says what a bake needs before any of it is taken.
pub fn check_memory(
    nodes: &Nodes,
    is_sparse: bool,
    settings: &BakeSettings,
    limit_gib: Option<f64>,
) -> Result<(), Fault> {
    let count = nodes.len() as u64 / if is_sparse { SPARSE_SHARE } else { 1 };
    let needed = bake::memory_needed(count, settings);
    let gib = f64::from(1 << 30);
    let (limit, whose) = match limit_gib {
        Some(limit) => (limit * gib, "--max-memory allows"),
        None => (super::memory_available().unwrap_or(f64::INFINITY), "this machine has free"),
    };
    if needed as f64 > limit {
        let what = if is_sparse { "places of a sparse grid may" } else { "nodes" };
        return Err(Fault::System(format!(
            "{} {what} need about {:.1} GiB, {whose} {:.1} GiB; use a larger --spacing or smaller --bounds",
            nodes.len(),
            needed as f64 / gib,
            limit / gib
        )));
    }
    Ok(())
}

fn settings_record(config: &Config, settings: &BakeSettings, method: Method) -> SettingsRecord {
    SettingsRecord {
        writer: concat!("gdibl ", env!("CARGO_PKG_VERSION")).into(),
        level: super::file_name(&config.level),
        method: match method {
            Method::Gdibl => "gdibl".into(),
            Method::Path => "path".into(),
        },
        blend: config.quality.blend.unwrap_or_default().to_string(),
        scene: match config.quality.scene.unwrap_or_default() {
            SceneHit::Recurse(depth) => format!("recurse:{depth}"),
            SceneHit::Occlude => "occlude".into(),
        },
        sampler: match settings.sampler {
            Sampler::Sobol => "sobol".into(),
            Sampler::Random => "random".into(),
        },
        samples: settings.samples,
        target_error: settings.target_error,
        seed: settings.seed,
    }
}

fn probe_records(inputs: &Inputs) -> Vec<ProbeRecord> {
    let probes = inputs.probes.iter().map(|probe| ProbeRecord {
        name: probe.name.clone(),
        position: Some(probe.position.into()),
        rotation: probe.rotation.into(),
        exposure_stops: probe.exposure_stops,
        size: [probe.panorama.width() as u32, probe.panorama.height() as u32],
        distance: probe.panorama.distances().is_some(),
    });
    // The black one that stands behind captured probes has no name: nobody gave it.
    let given = inputs.distant.iter().filter(|distant| !distant.name.is_empty());
    let distant = given.map(|distant| ProbeRecord {
        name: distant.name.clone(),
        position: None,
        rotation: distant.rotation.into(),
        exposure_stops: distant.exposure_stops,
        size: [distant.panorama.width() as u32, distant.panorama.height() as u32],
        distance: distant.panorama.distances().is_some(),
    });
    probes.chain(distant).collect()
}

fn statistics(baked: &Baked, inputs: &Inputs) -> StatisticsRecord {
    let errors = |all: &[f32]| ErrorSummary::of(baked.valid_nodes().map(|node| f64::from(all[node])));
    let count = |of: Standing| baked.standing.iter().filter(|standing| **standing == of).count() as u64;
    let in_the_open = baked.valid_nodes().count() as u64 + count(Standing::Uncovered);
    StatisticsRecord {
        nodes: baked.len() as u64,
        nodes_valid: baked.valid_nodes().count() as u64,
        rays: baked.rays,
        samples: baked.samples,
        relative_error: errors(&baked.relative_error),
        worst_direction_error: errors(&baked.worst_error),
        coverage: baked.coverage.iter().map(|c| f64::from(*c)).sum::<f64>() / in_the_open.max(1) as f64,
        standing: StandingRecord {
            uncovered: count(Standing::Uncovered),
            solid: count(Standing::Solid),
            outside: count(Standing::Outside),
            moved: baked.moved.len() as u64,
        },
        walls: baked.walls.as_ref().map(WallsRecord::from),
        sparse: None,
        deringing: None,
        packing: None,
        sun: None,
        findings: inputs.findings.clone(),
    }
}

/// The plan with the row on a distant panorama that is left out in place of that of none.
fn with_sealed(mut plan: Vec<PlanRow>, sealed: Option<PlanRow>) -> Vec<PlanRow> {
    if let Some(sealed) = sealed {
        plan.retain(|row| row.stage != sealed.stage);
        plan.push(sealed);
    }
    plan
}

fn print_plan(mut plan: Vec<PlanRow>, config: &Config, json: bool) -> Result<(), Fault> {
    if config.quality.sh == Some(Bands::Auto) {
        plan.push(PlanRow::new("bands", true, "all to L4 are baked, and those that light does not need left out"));
    }
    // What was baked tells whether any does.
    if config.quality.dering == Some(true) {
        plan.push(PlanRow::new("deringing", true, "nodes that ring are windowed"));
    }
    if json {
        return super::print_json(&plan);
    }
    for row in &plan {
        super::print_line(&format!("{:<16} {:<9} {}", row.stage, if row.kept { "kept" } else { "left out" }, row.why))?;
    }
    Ok(())
}

fn print_report(report: &Report, nodes: &Nodes, precision: Precision) -> Result<(), Fault> {
    let kind = match nodes {
        Nodes::Grid(grid) => {
            let [x, y, z] = grid.counts;
            format!("grid {x} x {y} x {z}")
        }
        Nodes::Sparse(sparse) => {
            let [x, y, z] = sparse.grid.counts;
            format!(
                "sparse grid {x} x {y} x {z}, {:.1} %",
                100.0 * report.nodes as f64 / sparse.grid.node_count() as f64
            )
        }
        Nodes::Points(_) => "points".into(),
        Nodes::Vertices { sets, .. } => format!("vertices of {} meshes", sets.len()),
    };
    let precision = match precision {
        Precision::F16 => "f16",
        Precision::F32 => "f32",
        Precision::Packed { .. } => "packed numbers",
    };
    let mut lines = vec![
        report.output.clone(),
        format!("  nodes     {} ({kind}), {} valid", report.nodes, report.nodes_valid),
        format!("  standing  {}", super::standing_text(&report.standing, report.walls.as_ref())),
        format!("  light     {} in {precision}, {} bytes", report.sh, report.bytes),
        format!(
            "  work      {:.1} M rays for {:.1} M directions in {:.2} s ({:.2} s of CPU)",
            report.rays as f64 / 1e6,
            report.samples as f64 / 1e6,
            report.wall_seconds,
            report.cpu_seconds
        ),
        format!("  coverage  {:.1} % of what the nodes see, some probe has seen", report.coverage * 100.0),
        match report.relative_error {
            Some(e) => format!(
                "  error     {:.2} % median, {:.2} % 95th percentile, {:.2} % worst node (standard error of irradiance)",
                e.median * 100.0,
                e.p95 * 100.0,
                e.max * 100.0
            ),
            None => "  error     not measured: that takes at least two samples per node".into(),
        },
    ];
    if let Some(sparse) = report.sparse {
        lines.extend(super::sparse_lines(sparse).into_iter().map(|line| format!("  between   {line}")));
    }
    if let Some(sun) = &report.sun {
        lines.push(format!("  sun       {}", super::sun_text(sun)));
    }
    if let Some(packing) = &report.packing {
        lines.push(format!("  packed    {}", super::packing_text(packing)));
    }
    if let Some(deringing) = &report.deringing {
        lines.push(format!("  de-ringed {}", super::deringing_text(deringing)));
    }
    let left_out = report.plan.iter().filter(|row| !row.kept);
    lines.extend(left_out.map(|row| format!("  left out  {}: {}", row.stage, row.why)));
    super::print_line(&lines.join("\n"))
}
