//! The one place where a bake is put together: inputs and [`Settings`] in; nodes with their light, the plan and all
//! records out, ready to be packed.
//!
//! A job is prepared first: everything that makes no sense is refused before the first ray. Its plan can be asked for, and
//! comes from the stages that decide. Then it runs. [`Volumes`] are the jobs of a level whose nodes place several boxes.

pub mod bands;
mod inputs;
mod nodes;
pub mod plan;
pub mod records;
mod settings;
mod spacing;
mod statistics;
mod stop;
mod text;
mod volumes;
mod work;

use gdibl_runtime::grid::Grid;
use std::cell::LazyCell;

use crate::bake::pass::Pass;
use crate::bake::{self, Baked, Nodes, Shells};
use crate::blocks::{AllShared, Blocks, PassKind};
use crate::exposure::{ExposureMatch, match_exposure};
use crate::pack::{PackSettings, Sections, pack, sections};
use crate::radiance::RadianceFunction;
use crate::radiance::unseen::UNSEEN_PLACES;
use crate::scene::VolumeMarker;
use crate::seen::{self, HeldOut};
use crate::{Control, Finding, Interrupted};
use bands::Truncation;
pub use inputs::Inputs;
use nodes::Placed;
use records::{InputRecord, PlanRow, Records, SettingRecord, SettingsRecord, StageRecord, StatisticsRecord, SunRecord};
pub use settings::{CapturePlan, GridSettings, OutOfRange, QualitySettings, ROWS, Row, Settings};
use spacing::{Limits, Next, Pace, Search, Trial, Tried};
pub use statistics::check_valid;
use statistics::{blurred_sun, findings_of, probe_records};
pub use stop::Stop;
pub use text::{Bands, Method, NodeKind, Punctual, SunLight, Text};
pub use volumes::{Listed, Volumes, Wanted, wanted_of};
pub use work::{Decided, Stage, Viewers, Watch, Work, with_function};

/// What `--sh auto` allows fewer bands to lose where no tolerance is given.
const BANDS_TOLERANCE: f64 = 0.1;
/// What a sparse grid is taken to have of its places, before anything is known of it. Rooms have less.
const SPARSE_SHARE: u64 = 2;

/// A bake whose inputs and settings fit together.
#[derive(Debug)]
pub struct Job {
    /// As they are baked: exposures matched, the sun taken out.
    pub inputs: Inputs,
    /// As they were asked for.
    pub settings: Settings,
    memory: Memory,
    nodes: Nodes,
    /// The nodes are a grid as fine as is allowed: light may need fewer.
    is_open: bool,
    /// Where the box of a grid is from.
    bounds: PlanRow,
    sun: Option<SunRecord>,
    exposure: Option<ExposureMatch>,
    /// A distant panorama that no node can see.
    sealed: Option<PlanRow>,
}

/// What a job has of its own, beside what it shares with those of the level's other volumes.
#[derive(Debug)]
struct Own {
    settings: Settings,
    nodes: Nodes,
    is_open: bool,
    bounds: PlanRow,
    sealed: Option<PlanRow>,
    /// What is wrong with where its nodes are.
    findings: Vec<Finding>,
}

impl Own {
    /// Places the nodes, in the box of one of the `markers` where these are not overruled.
    fn place(
        inputs: &Inputs,
        settings: Settings,
        markers: &[VolumeMarker],
        shells: &LazyCell<Shells, impl FnOnce() -> Shells>,
        memory: Memory,
    ) -> Result<Own, Stop> {
        let Placed { nodes, is_open, row: bounds, findings } =
            nodes::nodes_of(&settings, &inputs.scene, markers, &inputs.places, &inputs.level)?;
        memory.check(&nodes, &settings)?;
        // Nothing asks for what no node can see.
        let sealed = inputs.distant.as_ref().filter(|_| shells.seal(&nodes));
        let sealed = sealed.map(|distant| plan::sealed_distant(&distant.name));
        Ok(Own { settings, nodes, is_open, bounds, sealed, findings })
    }
}

/// A baked volume with everything that is told about it.
#[derive(Debug)]
pub struct Made {
    /// Where nodes are: sparser than was asked for, where that was asked for.
    pub nodes: Nodes,
    /// Their light.
    pub baked: Baked,
    /// Settings, plan, probes, statistics.
    pub records: Records,
    /// What fewer bands than were baked would lose, or have lost.
    pub truncations: Vec<Truncation>,
    /// How exposures were matched; `None`: they are as given.
    pub exposure: Option<ExposureMatch>,
    settings: Settings,
}

impl Job {
    /// Checks the settings, places the nodes, takes out a sun, and matches exposures. `memory` is what it may take.
    ///
    /// # Errors
    /// What makes no sense, before anything long has begun.
    pub fn prepare(mut inputs: Inputs, settings: Settings, memory: Memory) -> Result<Job, Stop> {
        let light = prepare_light(&mut inputs, &settings)?;
        let scene = &inputs.scene;
        let shells = LazyCell::new(|| Shells::of(scene));
        let own = Own::place(&inputs, settings, &scene.volume_markers, &shells, memory)?;
        Ok(Job::of(inputs, light, own, memory))
    }

    fn of(mut inputs: Inputs, (sun, exposure): PreparedLight, own: Own, memory: Memory) -> Job {
        let Own { settings, nodes, is_open, bounds, sealed, findings } = own;
        inputs.findings.extend(findings);
        Job { inputs, settings, memory, nodes, is_open, bounds, sun, exposure, sealed }
    }

    /// Where light will be baked.
    pub fn nodes(&self) -> &Nodes {
        &self.nodes
    }

    /// The method in force.
    pub fn method(&self) -> Method {
        self.inputs.method(&self.settings)
    }

    /// Probes have to be captured from the level before it can run.
    pub fn wants_capture(&self) -> bool {
        self.method() == Method::Gdibl && self.inputs.lacks_probes()
    }

    /// What will be done and left out, and why. No ray is traced.
    pub fn plan(&self) -> Vec<PlanRow> {
        let mut rows = self.first_rows();
        rows.extend(self.with_function(&self.settings, None, RowsOf));
        if self.searches() {
            rows.push(PlanRow::new(
                "spacing",
                true,
                "coarse grids first, until the error between nodes is small enough",
            ));
        }
        rows.push(plan::sparse(&self.nodes, self.settings.grid.tolerance, None));
        rows.push(plan::walls(&self.nodes, &self.inputs.scene, None));
        if self.settings.quality.sh == Bands::Auto {
            let why = "all to L4 are baked, and those that light does not need left out";
            rows.push(PlanRow::new("bands", true, why));
        }
        // What was baked tells whether any does.
        if self.settings.quality.dering {
            rows.push(PlanRow::new("deringing", true, "nodes that ring are windowed"));
        }
        if self.wants_capture() { plan::before_capture(rows) } else { rows }
    }

    /// Bakes.
    ///
    /// # Errors
    /// No node has light of its own, or the caller cancelled.
    pub fn run(mut self, watch: &Watch) -> Result<Made, Stop> {
        self.bake(watch)
    }

    /// The same, of a job whose inputs are needed again. Its settings become those that a budget came to.
    ///
    /// # Errors
    /// No node has light of its own, or the caller cancelled.
    pub fn bake(&mut self, watch: &Watch) -> Result<Made, Stop> {
        if let Some(budget) = self.settings.grid.budget {
            self.fit(budget, watch)?;
        }
        let (method, mut rows) = (self.method(), self.first_rows());
        (watch.stage)(Stage::Prepare);
        let sample = Sample { job: self, settings: &self.settings, importance: true, searches: self.searches(), watch };
        let sampled = self.with_function(&self.settings, watch.blocks, sample)?;
        let Sampled { nodes, mut baked, sparse, held_out, decided, stages } = sampled;
        check_valid(&baked).map_err(Stop::Nothing)?;
        bake::check_finite(nodes.as_ref().unwrap_or(&self.nodes), &baked, &self.inputs.scene)
            .map_err(|why| Stop::Invalid(format!("{}: {why}", self.inputs.level)))?;
        rows.extend(decided.rows);
        let nodes = nodes.unwrap_or_else(|| self.nodes.clone());
        let Settings { grid, quality, .. } = &self.settings;
        let truncations = bands::truncations(&baked);
        if quality.sh == Bands::Auto {
            let within = grid.tolerance.unwrap_or(BANDS_TOLERANCE);
            let fewest = bands::fewest(&truncations, within, baked.bands);
            rows.push(plan::bands(&truncations, within, fewest));
            bands::truncate(&mut baked, fewest);
        }
        rows.push(plan::sparse(&nodes, grid.tolerance, sparse.as_ref()));
        rows.push(plan::walls(&nodes, &self.inputs.scene, Some(&baked)));
        let mut findings = self.inputs.findings.clone();
        findings.extend(decided.findings);
        findings.extend(findings_of(&baked, quality.clamp.unwrap_or(f32::INFINITY)));
        let stage = |(stage, rays): (Stage, u64)| StageRecord { stage: stage.name().into(), rays, seconds: None };
        let stages = stages.into_iter().map(stage).collect();
        let seen = held_out.map(|held_out| held_out.errors(&nodes, &baked, self.settings.pack()));
        let (seen, seen_places) = seen.unzip();
        let seen_places = seen_places.unwrap_or_default();
        let distant = self.inputs.distant.as_ref().filter(|_| self.sealed.is_none());
        findings.extend(seen.and_then(|seen| blurred_sun(&seen, distant.filter(|_| self.sun.is_none()))));
        let statistics = StatisticsRecord {
            sun: self.sun,
            sparse,
            findings,
            stages,
            seen,
            seen_places,
            ..StatisticsRecord::of(&baked)
        };
        let probes = probe_records(&self.inputs.probes, distant);
        let Inputs { level, files, program, request, .. } = &self.inputs;
        let settings = settings_record(&self.settings, method, &nodes, level, files.clone(), program.clone());
        let records = Records {
            settings: Some(SettingsRecord { request: *request, ..settings }),
            probes,
            statistics: Some(statistics),
            plan: rows,
        };
        let (exposure, settings) = (self.exposure.clone(), self.settings.clone());
        Ok(Made { nodes, baked, records, truncations, exposure, settings })
    }

    /// Samples the nodes by the method and with the numbers of `settings`, which may differ from the job's in what does
    /// not change where nodes are. Without `importance` all directions are uniform: a baseline for studies.
    ///
    /// # Errors
    /// The caller cancelled.
    pub fn sample(&self, settings: &Settings, importance: bool, watch: &Watch) -> Result<Sampled, Interrupted> {
        (watch.stage)(Stage::Prepare);
        self.with_function(settings, watch.blocks, Sample { job: self, settings, importance, searches: false, watch })
    }

    /// Light at places between the nodes, by the method of `settings` and so many directions each. `None`: between the nodes
    /// nothing is read, or no light reaches any place.
    ///
    /// # Errors
    /// The caller cancelled.
    pub fn hold_out(&self, settings: &Settings, samples: u64, watch: &Watch) -> Result<Option<HeldOut>, Interrupted> {
        let hold_out = HoldOut { job: self, nodes: &self.nodes, settings, samples, watch, blocks: watch.blocks };
        self.with_function(settings, watch.blocks, hold_out)
    }

    /// Coarser grids are tried first.
    fn searches(&self) -> bool {
        self.is_open && self.settings.quality.seen_places != Some(0)
    }

    /// Lets the grid have as many nodes as can be baked in so many seconds since the run began. A bake that goes on has as many as the
    /// one before had chosen.
    fn fit(&mut self, budget: f64, watch: &Watch) -> Result<(), Stop> {
        let Nodes::Grid(grid) = &self.nodes else { return Ok(()) };
        (watch.stage)(Stage::Spacing);
        let choose = || {
            let pace = self.pace(budget, watch)?;
            let nodes = pace.nodes_in(budget - (watch.seconds)(), self.settings.quality.seen_places);
            // A volume holds no more than 2^32 nodes.
            let asked = self.settings.grid.max_nodes.unwrap_or(u32::MAX.into());
            Ok(nodes.min(asked).min(self.memory.most_nodes(&self.settings)).max(1))
        };
        let pass = Pass::of(watch.blocks, PassKind::Shared);
        let nodes = pass.block(0, |nodes: &u64| *nodes > 0, choose)?.expect("every run has a number of nodes");
        pass.end()?;
        self.nodes = Nodes::Grid(bake::grid_of_nodes(grid.min.into(), grid.max.into(), nodes));
        self.settings.grid = GridSettings { max_nodes: Some(nodes), budget: None, ..self.settings.grid.clone() };
        Ok(())
    }

    fn pace(&self, budget: f64, watch: &Watch) -> Result<Pace, Interrupted> {
        let begun = (watch.seconds)();
        let trial = Trial { nodes: &self.nodes, budget, settings: &self.settings, begun, watch };
        self.with_function(&self.settings, None, trial)
    }

    /// Seconds that the bake is likely to take on this machine, without the capture of probes; a few nodes are baked to know.
    ///
    /// # Errors
    /// The caller cancelled.
    pub fn likely_seconds(&self, watch: &Watch) -> Result<f64, Interrupted> {
        let pace = self.pace(0.0, watch)?;
        Ok(pace.seconds_of(&self.nodes, self.searches(), self.settings.quality.seen_places))
    }

    /// Calls `work` with the radiance function of the method in force.
    fn with_function<W: Work>(&self, settings: &Settings, blocks: Option<&dyn Blocks>, work: W) -> W::Output {
        let distant = self.inputs.distant.as_ref().filter(|_| self.sealed.is_none());
        let directions = settings.bake().directions(self.nodes.len() as u64);
        let (min, max) = self.inputs.scene.bounds(|_| true).unwrap_or_default();
        let viewers = Viewers {
            directions,
            coarsest: self.nodes.coarsest_pixel((max - min).max_element()),
            places: self.nodes.some_positions(UNSEEN_PLACES),
        };
        with_function(&self.inputs, distant, settings, &viewers, blocks, work)
    }

    /// What was decided before there was a radiance function.
    fn first_rows(&self) -> Vec<PlanRow> {
        let Job { inputs, settings, .. } = self;
        let mut rows = vec![plan::method(settings.quality.method, self.method(), inputs)];
        rows.push(plan::capture(inputs, self.method()));
        rows.extend(match &self.exposure {
            Some(matched) => Some(plan::match_exposure(matched)),
            None if settings.quality.match_exposure => {
                Some(PlanRow::new("match-exposure", false, "path tracing needs no probe"))
            }
            None => None,
        });
        rows.extend(self.sealed.clone());
        rows.push(self.bounds.clone());
        let is_at_most = self.is_open || settings.grid.tolerance.is_some();
        rows.push(plan::nodes(&self.nodes, is_at_most, settings, self.memory.is_paged));
        match (&self.nodes, self.searches()) {
            (_, true) => {}
            (Nodes::Grid(_), _) if self.is_open => {
                rows.push(PlanRow::new("spacing", false, "no error is measured: the finest that is allowed"))
            }
            (Nodes::Grid(_), _) => rows.push(PlanRow::new("spacing", false, "it is given")),
            _ => rows.push(PlanRow::new("spacing", false, "nodes are no grid")),
        }
        rows
    }
}

/// The plan alone.
struct RowsOf;

impl Work for RowsOf {
    type Output = Vec<PlanRow>;

    fn run(self, _: &impl RadianceFunction, decided: Decided) -> Vec<PlanRow> {
        decided.rows
    }
}

/// What was baked.
#[derive(Debug)]
pub struct Sampled {
    /// Other nodes than the job's, where its grid became sparse.
    pub nodes: Option<Nodes>,
    /// Their light.
    pub baked: Baked,
    /// How sparse the grid is.
    pub sparse: Option<records::SparseRecord>,
    /// Light between nodes.
    pub held_out: Option<HeldOut>,
    /// What the radiance function decided, and how fine the grid has to be.
    pub decided: Decided,
    /// What was done, with its rays.
    pub stages: Vec<(Stage, u64)>,
}

/// Bakes the nodes of a job.
struct Sample<'a, 'b> {
    job: &'a Job,
    settings: &'a Settings,
    importance: bool,
    /// Coarser grids first.
    searches: bool,
    watch: &'a Watch<'b>,
}

impl Work for Sample<'_, '_> {
    type Output = Result<Sampled, Interrupted>;

    fn run(self, function: &impl RadianceFunction, decided: Decided) -> Self::Output {
        match &self.job.nodes {
            Nodes::Grid(finest) if self.searches => self.search(finest, function, decided),
            _ => self.bake(function, decided),
        }
    }
}

impl Sample<'_, '_> {
    fn bake_settings(&self) -> bake::BakeSettings {
        bake::BakeSettings { importance: self.importance, ..self.settings.bake() }
    }

    /// Bakes the nodes that the job says.
    fn bake(&self, function: &impl RadianceFunction, decided: Decided) -> Result<Sampled, Interrupted> {
        let Sample { job, settings, watch, .. } = self;
        (watch.stage)(Stage::Nodes);
        let control = Control { cancel: watch.cancel, progress: watch.progress, blocks: watch.blocks };
        let bake_settings = self.bake_settings();
        let (nodes, baked, sparse) = match (&job.nodes, settings.grid.tolerance) {
            (Nodes::Grid(grid), Some(tolerance)) => {
                let (nodes, baked, record) = bake::bake_sparse(grid, tolerance, function, &bake_settings, &control)?;
                (Some(nodes), baked, record)
            }
            _ => (None, bake::bake(&job.nodes, function, &bake_settings, &control)?, None),
        };
        let mut stages = vec![(Stage::Nodes, baked.rays)];
        let all = nodes.as_ref().unwrap_or(&job.nodes);
        let mut held_out = None;
        if settings.quality.seen_places != Some(0) && matches!(all, Nodes::Grid(_) | Nodes::Sparse(_)) {
            (watch.stage)(Stage::Seen);
            held_out = self.hold_out(all, &baked, function, watch.blocks)?;
            stages.extend(held_out.as_ref().map(|held_out| (Stage::Seen, held_out.rays())));
        }
        Ok(Sampled { nodes, baked, sparse, held_out, decided, stages })
    }

    /// Bakes grids over the box of the finest, until one is fine enough.
    fn search(
        &self,
        finest: &Grid,
        function: &impl RadianceFunction,
        mut decided: Decided,
    ) -> Result<Sampled, Interrupted> {
        let Sample { job, settings, watch, .. } = self;
        (watch.stage)(Stage::Spacing);
        let bake_settings = self.bake_settings();
        // Every shard tries the same coarse grids; the last one is divided.
        let shared = watch.blocks.map(AllShared);
        let blocks = shared.as_ref().map(|shared| shared as &dyn Blocks);
        let silent = Control { cancel: watch.cancel, progress: &|_, rays| (watch.progress)(0, rays), blocks };
        let mut search = Search::new(finest, Limits::of(&settings.grid, settings.quality.max_seen_error));
        let (mut bakes, mut held_out) = (Vec::new(), None);
        let (grid, baked, stage) = loop {
            match search.next() {
                Next::Try(grid) => {
                    let nodes = Nodes::Grid(grid);
                    let baked = bake::bake(&nodes, function, &bake_settings, &silent)?;
                    if bakes.is_empty() {
                        held_out = self.hold_out(&job.nodes, &baked, function, blocks)?;
                    }
                    let bytes = bytes_of_light(&nodes, &baked, settings);
                    let seen = held_out.as_ref().map(|held_out| held_out.errors(&nodes, &baked, settings.pack()).0);
                    let error = seen.as_ref().map_or(f64::INFINITY, spacing::error_of);
                    search.tell(Tried { grid, error, bytes });
                    bakes.push((grid, baked));
                }
                Next::Take(number) => {
                    let (grid, baked) = bakes.swap_remove(number);
                    break (grid, baked, Stage::Spacing);
                }
                Next::Last(grid) => {
                    (watch.stage)(Stage::Nodes);
                    let control = Control { cancel: watch.cancel, progress: watch.progress, blocks: watch.blocks };
                    let baked = bake::bake(&Nodes::Grid(grid), function, &bake_settings, &control)?;
                    break (grid, baked, Stage::Nodes);
                }
            }
        };
        let before = bakes.iter().map(|(_, baked): &(Grid, Baked)| baked.rays).sum::<u64>()
            + held_out.as_ref().map_or(0, HeldOut::rays);
        let stages = match stage {
            Stage::Spacing => vec![(stage, before + baked.rays)],
            _ => vec![(Stage::Spacing, before), (stage, baked.rays)],
        };

        decided.rows.push(search.row(&grid));
        Ok(Sampled { nodes: Some(Nodes::Grid(grid)), baked, sparse: None, held_out, decided, stages })
    }

    /// Light between nodes, by as many directions as one of these takes. `None`: no light reaches any place, or none of these.
    fn hold_out(
        &self,
        nodes: &Nodes,
        baked: &Baked,
        function: &impl RadianceFunction,
        blocks: Option<&dyn Blocks>,
    ) -> Result<Option<HeldOut>, Interrupted> {
        let valid = baked.valid_nodes().count() as u64;
        if valid == 0 {
            return Ok(None);
        }
        let samples = baked.samples.div_ceil(valid);
        let hold_out = HoldOut { job: self.job, nodes, settings: self.settings, samples, watch: self.watch, blocks };
        hold_out.by(function)
    }
}

/// Samples light between nodes.
struct HoldOut<'a, 'b> {
    job: &'a Job,
    nodes: &'a Nodes,
    settings: &'a Settings,
    samples: u64,
    watch: &'a Watch<'b>,
    blocks: Option<&'a dyn Blocks>,
}

impl Work for HoldOut<'_, '_> {
    type Output = Result<Option<HeldOut>, Interrupted>;

    fn run(self, function: &impl RadianceFunction, _: Decided) -> Self::Output {
        self.by(function)
    }
}

impl HoldOut<'_, '_> {
    fn by(&self, function: &impl RadianceFunction) -> Result<Option<HeldOut>, Interrupted> {
        let HoldOut { job, nodes, settings, samples, watch, blocks } = self;
        let usual = || seen::usual_count(nodes.len());
        let count = settings.quality.seen_places.map_or_else(usual, |count| count as usize);
        let control = Control { cancel: watch.cancel, progress: &|_, rays| (watch.progress)(0, rays), blocks: *blocks };
        seen::hold_out(nodes, &job.inputs.scene, count, *samples, function, &settings.bake(), &control)
    }
}

impl Made {
    /// The sections of the file. What was baked goes before they are put together: it is as large as the file.
    pub fn sections(self) -> Sections {
        sections(&self.nodes, &self.baked, self.records, self.settings.pack())
    }
}

/// Bytes of a volume's file without what is told about it.
pub fn bytes_of_light(nodes: &Nodes, baked: &Baked, settings: &Settings) -> u64 {
    let packing = PackSettings { zstd: false, ..settings.pack() };
    pack(nodes, baked, Records::default(), packing).bytes.len() as u64
}

/// What a job may take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Memory {
    /// Bytes; infinite: no bound is known.
    pub bytes: f64,
    /// It was asked for, and is not what the machine has.
    pub is_asked: bool,
    /// There is a file for what is large: see [`Blocks::scratch`].
    pub is_paged: bool,
}

impl Memory {
    /// No bound.
    pub const UNBOUNDED: Memory = Memory { bytes: f64::INFINITY, is_asked: false, is_paged: false };

    /// The most nodes that fit in.
    fn most_nodes(self, settings: &Settings) -> u64 {
        let needed = |nodes: u64| bake::memory_needed(nodes, &settings.bake(), self.is_paged) as f64;
        // By halves: it grows with nodes.
        let (mut few, mut many) = (0u64, 1 << 32);
        while many - few > 1 {
            let middle = few.midpoint(many);
            if needed(middle) <= self.bytes { few = middle } else { many = middle }
        }
        few
    }

    /// Says what a bake needs before any of it is taken.
    fn check(self, nodes: &Nodes, settings: &Settings) -> Result<(), Stop> {
        let is_sparse = settings.grid.tolerance.is_some();
        let count = nodes.len() as u64 / if is_sparse { SPARSE_SHARE } else { 1 };
        let needed = bake::memory_needed(count, &settings.bake(), self.is_paged);
        if needed as f64 <= self.bytes {
            return Ok(());
        }
        let gib = f64::from(1 << 30);
        let what = if is_sparse { "places of a sparse grid may" } else { "nodes" };
        let whose = if self.is_asked { "--max-memory allows" } else { "this machine has free" };
        Err(Stop::Memory(format!(
            "{} {what} need about {:.1} GiB, {whose} {:.1} GiB; use a larger --spacing or smaller --bounds",
            nodes.len(),
            needed as f64 / gib,
            self.bytes / gib
        )))
    }
}

/// The sun that was taken out, and how exposures were matched.
type PreparedLight = (Option<SunRecord>, Option<ExposureMatch>);

/// Checks the settings, and prepares the light as they say: takes out a sun, and matches exposures.
fn prepare_light(inputs: &mut Inputs, settings: &Settings) -> Result<PreparedLight, Stop> {
    settings.check().map_err(|out| Stop::Usage(format!("{} {}", out.flag, out.message)))?;
    let mut exposure = None;
    if inputs.method(settings) == Method::Gdibl && settings.quality.match_exposure {
        let matched = match_exposure(&inputs.scene, &inputs.probes);
        matched.apply(&mut inputs.probes);
        inputs.findings.extend(matched.findings());
        exposure = Some(matched);
    }
    let sun = match settings.quality.sun {
        SunLight::Include => None,
        SunLight::Extract => extract_sun(inputs)?,
    };
    Ok((sun, exposure))
}

/// Takes the sun out of what nodes see of the distant panorama; `None`, with a finding, where no sun stands out.
fn extract_sun(inputs: &mut Inputs) -> Result<Option<SunRecord>, Stop> {
    let Some(distant) = &mut inputs.distant else {
        return Err(Stop::Usage("--sun extract: takes a sun out of the distant panorama; give --distant IMAGE".into()));
    };
    let sun = distant.extract_sun();
    if sun.is_none() {
        let message = format!("{}: --sun extract finds no sun in it, and takes nothing out", distant.name);
        inputs.findings.push(Finding::new("no-sun", 1, message));
    }
    Ok(sun.map(SunRecord::from))
}

/// All settings in force, and what they were applied to.
fn settings_record(
    settings: &Settings,
    method: Method,
    nodes: &Nodes,
    level: &str,
    inputs: Vec<InputRecord>,
    [writer, commit]: [String; 2],
) -> SettingsRecord {
    let mut in_force = settings.clone();
    in_force.quality.method = method;
    if let Nodes::Grid(grid) | Nodes::Sparse(bake::SparseGrid { grid, .. }) = nodes {
        let ([x0, y0, z0], [x1, y1, z1]) = (grid.min, grid.max);
        in_force.grid.bounds = Some([x0, y0, z0, x1, y1, z1]);
    }
    let quality = &settings.quality;
    // Records must not depend on where a level lies.
    let level = std::path::Path::new(level).file_name().unwrap_or_default().to_string_lossy().into_owned();
    SettingsRecord {
        writer,
        level,
        method: method.text().unwrap_or_default(),
        blend: quality.blend.to_string(),
        scene: quality.scene.to_string(),
        sampler: quality.sampler.text().unwrap_or_default(),
        samples: settings.samples(),
        target_error: quality.target_error,
        seed: quality.seed,
        commit,
        settings: in_force.recorded().into_iter().map(|(name, value)| SettingRecord { name, value }).collect(),
        inputs,
        request: [0; 32],
    }
}
