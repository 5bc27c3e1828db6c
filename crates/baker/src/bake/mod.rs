//! From a radiance function and nodes to baked coefficients: samples every node, stops it, fills invalid ones. Beside
//! it [`irradiance_at`]: E at places of surfaces, without coefficients.
//!
//! Parallel over nodes; every result has its own place, so bytes do not depend on the number of threads.

mod cells;
mod directions;
mod fill;
mod finite;
mod gather;
mod integrate;
mod irradiance;
mod nodes;
mod refine;
mod sealed;
mod standing;
pub(crate) mod walls;

use gdibl_runtime::sh;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::sync::Mutex;

pub(crate) use cells::Cells;
pub use finite::check_finite;
pub(crate) use gather::propose_on_surface;
pub use gather::{GatherSettings, Gathered, SurfacePlace, irradiance_at};
pub use integrate::INTERVAL_95;
use integrate::{Integrator, IntegratorSettings, Moments, NodeEstimate, Place, Sequence};
pub(crate) use irradiance::{Irradiance, difference, irradiance_of, root_mean_square, strength};
pub use nodes::{Nodes, SparseGrid, VertexSet, grid_of_counts, grid_of_spacing};
pub use refine::{bake_sparse, grid_of_cells, levels_of};
pub use sealed::is_sealed;
use standing::Sites;
pub use standing::Standing;
pub use walls::{WallCell, Walls};

use crate::radiance::{PathContext, RadianceFunction};
use crate::sampling::{Sampler, Stream};
use crate::{Control, Interrupted};

/// How to bake.
#[derive(Debug, Clone, PartialEq)]
pub struct BakeSettings {
    /// Highest SH band, 0..=4.
    pub bands: u32,
    /// Directions per node; with a target the most a node may take. At least 1, at most 2^31.
    pub samples: u64,
    /// Stop a node once its `relative_error` is at most this.
    pub target_error: Option<f64>,
    /// Same seed, same bytes.
    pub seed: u64,
    /// Where directions come from.
    pub sampler: Sampler,
    /// Directions also go toward what is bright. Without, all are uniform: a baseline for studies.
    pub importance: bool,
    /// Keeps the standard error of every coefficient.
    pub coefficient_errors: bool,
    /// Adds the direct light of punctual lights, of which radiance functions tell nothing.
    pub punctual: bool,
    /// Most that a channel of a sample's radiance may be; infinity leaves all light as it is.
    pub clamp: f32,
}

impl Default for BakeSettings {
    fn default() -> Self {
        BakeSettings {
            bands: 2,
            samples: 4096,
            target_error: None,
            seed: 0,
            sampler: Sampler::Sobol,
            importance: true,
            coefficient_errors: false,
            punctual: false,
            clamp: f32::INFINITY,
        }
    }
}

impl BakeSettings {
    /// The cap of `samples` when a target is given and nothing else is said.
    pub const TARGET_SAMPLES: u64 = 65_536;
    /// The most samples of one node.
    pub const MAX_SAMPLES: u64 = 1 << 31;

    /// Directions that will leave so many nodes, about: with a target, as many as without one by default.
    pub fn directions(&self, nodes: u64) -> u64 {
        let usual = BakeSettings::default().samples;
        nodes.saturating_mul(if self.target_error.is_some() { self.samples.min(usual) } else { self.samples })
    }
}

/// A baked volume in memory. Per-node arrays are in node order.
#[derive(Debug, Clone, PartialEq)]
pub struct Baked {
    /// Highest SH band.
    pub bands: u32,
    /// Radiance coefficients, `[node][coefficient][rgb]` flat.
    pub sh: Vec<f32>,
    /// Only what is open has light of its own; the coefficients of the others come from neighbours.
    pub standing: Vec<Standing>,
    /// Nodes whose light is taken at another place, in order, and where, world metres.
    pub moved: Vec<(u32, DVec3)>,
    /// What keeps light from passing through walls between nodes; `None` where no wall stands between any.
    pub walls: Option<Walls>,
    /// Share of the sphere that was covered, 0..=1.
    pub coverage: Vec<f32>,
    /// Standard error of E over the larger of the node's RMS of E and a tenth of the volume's median; 0 for
    /// invalid nodes, infinite where one sample gave none.
    pub relative_error: Vec<f32>,
    /// The same with the standard error of E in the worst direction and channel.
    pub worst_error: Vec<f32>,
    /// One standard error of each coefficient, as `sh`; empty unless asked for. 0 for invalid nodes.
    pub coefficient_error: Vec<f32>,
    /// Rays traced, lines of sight included.
    pub rays: u64,
    /// Directions that left nodes.
    pub samples: u64,
    /// Valid nodes over the target error.
    pub missed: u64,
    /// Share of the valid nodes' light that clamping took, 0..=1.
    pub clamped: f64,
}

impl Baked {
    /// Coefficients of one node, `[coefficient][rgb]` flat.
    pub fn node(&self, index: usize) -> &[f32] {
        let stride = 3 * sh::coefficient_count(self.bands);
        &self.sh[index * stride..(index + 1) * stride]
    }

    /// How many nodes.
    pub fn len(&self) -> usize {
        self.standing.len()
    }

    /// Never.
    pub fn is_empty(&self) -> bool {
        self.standing.is_empty()
    }

    /// Every node has light of its own.
    pub fn is_all_valid(&self) -> bool {
        self.standing.iter().all(|standing| *standing == Standing::Open)
    }

    /// The nodes that have light of their own, in order.
    pub fn valid_nodes(&self) -> impl Iterator<Item = usize> {
        (0..self.len()).filter(|node| self.is_valid(*node))
    }

    /// The node has light of its own.
    pub fn is_valid(&self, index: usize) -> bool {
        self.standing[index] == Standing::Open
    }
}

/// Bytes that a bake of `nodes` nodes takes at its peak, at most, beside the level: coefficients, figures, and the file's sections
/// beside them. A million L2 nodes take 312 MB by this; 219 were measured in f16, 224 packed (`tools/scaling_bench`).
pub fn memory_needed(nodes: u64, settings: &BakeSettings) -> u64 {
    let coefficients = 3 * sh::coefficient_count(settings.bands) as u64;
    let coefficients = coefficients * if settings.coefficient_errors { 2 } else { 1 };
    let per_node = 2 * coefficients * 4 + size_of::<Summary>() as u64 + 48;
    nodes.saturating_mul(per_node)
}

/// Samples of the pilot that finds the median irradiance, and of the first round of adaptive sampling.
const PILOT_SAMPLES: u64 = 256;

/// Nodes that stand near each other and tell each other what they see.
const NEIGHBOURS: usize = 8;

/// Bakes every node.
pub fn bake(
    nodes: &Nodes,
    function: &impl RadianceFunction,
    settings: &BakeSettings,
    control: &Control,
) -> Result<Baked, Interrupted> {
    assert!(settings.bands <= sh::MAX_BANDS, "bands {} of at most {}", settings.bands, sh::MAX_BANDS);
    assert!((1..=BakeSettings::MAX_SAMPLES).contains(&settings.samples), "samples {}", settings.samples);
    let numbers = (0..nodes.len() as u32).collect();
    let batch = Batch::sample(nodes, numbers, None, function, settings, control)?;
    finish(nodes, function, settings, control, batch)
}

/// Some nodes, and what was found at them.
struct Batch {
    sites: Sites,
    sampled: Sampled,
    /// Irradiance of the volume.
    median: f64,
}

impl Batch {
    /// Samples the nodes of these numbers. `median` of others that were sampled before; else it is found.
    fn sample(
        nodes: &Nodes,
        numbers: Vec<u32>,
        median: Option<f64>,
        function: &impl RadianceFunction,
        settings: &BakeSettings,
        control: &Control,
    ) -> Result<Batch, Interrupted> {
        let is_whole = median.is_none();
        let mut sites = Sites::find(nodes, numbers, function, control)?;
        let count = sites.numbers.len();
        let open = sites.open(nodes.neighbourhoods(&sites.numbers).into_iter());
        (control.progress)((count - open.len()) as u64, sites.rays);
        let job = Job { nodes, sites: &sites, function, settings, control };
        let median = match settings.target_error {
            Some(_) if settings.samples > PILOT_SAMPLES && median.is_none() => Some(job.pilot(&open)?),
            _ => median,
        };
        let enough = |done: u64, estimate: Option<&NodeEstimate>| match (settings.target_error, median, estimate) {
            (Some(_), Some(_), None) => PILOT_SAMPLES.min(settings.samples),
            (Some(target), Some(median), Some(estimate)) => {
                let relative = relative_error(estimate, median);
                // Double until the target is met.
                if relative <= target { done } else { (2 * done).min(settings.samples) }
            }
            _ => settings.samples,
        };
        let mut sampled = Sampled::new(count, settings);
        job.sample(&open, enough, &mut sampled)?;
        let median = median.unwrap_or_else(|| median_irradiance(&sampled.estimates));
        let is_dark = |sampled: &Sampled, node: &u32| sampled.estimates[*node as usize].is_dark(median);
        let dark: Vec<u32> = sites.suspects.iter().copied().filter(|node| is_dark(&sampled, node)).collect();
        let out = sites.step_out(&dark, nodes, function);
        let silent = Control { cancel: control.cancel, progress: &|_, rays| (control.progress)(0, rays) };
        Job { nodes, sites: &sites, function, settings, control: &silent }.sample(&out, enough, &mut sampled)?;
        for node in out.into_iter().filter(|node| !is_dark(&sampled, node)) {
            sites.standing[node as usize] = Standing::Open;
        }
        // Where no node is in the open, nothing tells a solid of double-sided walls from a dark room: they are in one.
        if is_whole && !sites.standing.contains(&Standing::Open) {
            dark.iter().for_each(|node| sites.standing[*node as usize] = Standing::Open);
        }
        for (standing, estimate) in sites.standing.iter_mut().zip(&sampled.estimates) {
            if *standing == Standing::Open && estimate.coverage == 0.0 {
                *standing = Standing::Uncovered;
            }
        }
        Ok(Batch { sites, sampled, median })
    }

    /// Others behind these.
    fn append(&mut self, other: Batch) {
        self.sites.append(other.sites);
        let Sampled { sh, coefficient_error, estimates, rays, samples } = other.sampled;
        self.sampled.sh.extend(sh);
        self.sampled.coefficient_error.extend(coefficient_error);
        self.sampled.estimates.extend(estimates);
        self.sampled.rays += rays;
        self.sampled.samples += samples;
    }

    /// Those at these places, as the nodes 0 and up. What all took is what these took.
    fn selected(&self, places: &[u32], settings: &BakeSettings) -> Batch {
        let stride = 3 * sh::coefficient_count(settings.bands);
        let rows = |all: &[f32]| match all.is_empty() {
            true => Vec::new(),
            false => places.iter().flat_map(|p| &all[*p as usize * stride..][..stride]).copied().collect(),
        };
        let sampled = Sampled {
            sh: rows(&self.sampled.sh),
            coefficient_error: rows(&self.sampled.coefficient_error),
            estimates: places.iter().map(|place| self.sampled.estimates[*place as usize]).collect(),
            rays: self.sampled.rays,
            samples: self.sampled.samples,
        };
        let median = median_irradiance(&sampled.estimates);
        Batch { sites: self.sites.selected(places), sampled, median }
    }
}

/// Figures and what lies between nodes, once all are sampled.
fn finish(
    nodes: &Nodes,
    function: &impl RadianceFunction,
    settings: &BakeSettings,
    control: &Control,
    Batch { sites, sampled, median }: Batch,
) -> Result<Baked, Interrupted> {
    let Sampled { sh, mut coefficient_error, estimates, rays, samples } = sampled;
    let is_open: Vec<bool> = sites.standing.iter().map(|standing| *standing == Standing::Open).collect();
    let valid = || estimates.iter().zip(&is_open).map(|(e, open)| (e, *open));
    let errors = |own: fn(&Summary) -> f64| -> Vec<f32> {
        valid().map(|(e, valid)| if valid { e.relative(own(e), median) as f32 } else { 0.0 }).collect()
    };
    let relative_error = errors(|e| e.standard_error);
    let worst_error = errors(|e| e.worst_error);
    let stride = 3 * sh::coefficient_count(settings.bands);
    for (errors, _) in coefficient_error.chunks_exact_mut(stride).zip(&is_open).filter(|(_, valid)| !**valid) {
        errors.fill(0.0);
    }
    let target = settings.target_error.unwrap_or(f64::INFINITY) as f32;
    let total = |of: fn(&Summary) -> f64| valid().filter(|(_, valid)| *valid).map(|(e, _)| of(e)).sum::<f64>();
    let (clamped, kept) = (total(|e| e.clamped), total(|e| e.kept));
    let moved = sites.moved(function);
    let mut baked = Baked {
        bands: settings.bands,
        sh,
        coverage: valid().map(|(e, valid)| if valid { e.coverage as f32 } else { 0.0 }).collect(),
        missed: relative_error.iter().filter(|e| **e > target).count() as u64,
        relative_error,
        worst_error,
        coefficient_error,
        standing: sites.standing.clone(),
        moved,
        walls: None,
        rays: rays + sites.rays,
        samples,
        clamped: if clamped > 0.0 { clamped / (clamped + kept) } else { 0.0 },
    };
    let place = |node| sites.place(node, nodes, function);
    let mut rays = fill::fill(nodes, &mut baked, function, place, control)?;
    if let Some(cells) = Cells::of(nodes) {
        let (walls, more) = walls::find(cells, &baked, function, place, control)?;
        baked.walls = walls;
        rays += more;
    }
    (control.progress)(0, rays);
    baked.rays += rays;
    Ok(baked)
}

/// What is kept of a node besides its coefficients.
#[derive(Debug, Clone, Copy, Default)]
struct Summary {
    standard_error: f64,
    worst_error: f64,
    rms_irradiance: f64,
    coverage: f64,
    /// ∫ L dω that clamping took, and that is left, over R, G and B.
    clamped: f64,
    kept: f64,
}

/// Light under this share of the volume's median is next to none: a solid's walls may leak a little.
const NEXT_TO_NONE: f64 = 1e-3;

impl Summary {
    /// Next to no light gets there, or none that is known.
    fn is_dark(&self, median: f64) -> bool {
        self.coverage == 0.0 || self.rms_irradiance <= NEXT_TO_NONE * median
    }

    /// An error of E over the larger of the node's own RMS of E and a tenth of the median.
    fn relative(&self, error: f64, median: f64) -> f64 {
        let floor = self.rms_irradiance.max(0.1 * median);
        // All black: nothing is wrong with it.
        if error == 0.0 { 0.0 } else { error / floor }
    }
}

fn relative_error(estimate: &NodeEstimate, median: f64) -> f64 {
    Summary::from(estimate).relative(estimate.standard_error, median)
}

impl From<&NodeEstimate> for Summary {
    fn from(e: &NodeEstimate) -> Self {
        Summary {
            standard_error: e.standard_error,
            worst_error: e.worst_error,
            rms_irradiance: e.rms_irradiance,
            coverage: e.coverage,
            clamped: e.clamped,
            kept: e.sh[0].iter().sum::<f64>() * (4.0 * std::f64::consts::PI).sqrt(),
        }
    }
}

fn median_irradiance(estimates: &[Summary]) -> f64 {
    let lit = estimates.iter().filter(|e| e.coverage > 0.0 && e.rms_irradiance > 0.0);
    let mut valid: Vec<f64> = lit.map(|e| e.rms_irradiance).collect();
    if valid.is_empty() {
        return 0.0;
    }
    let middle = valid.len() / 2;
    *valid.select_nth_unstable_by(middle, f64::total_cmp).1
}

struct Sampled {
    sh: Vec<f32>,
    /// Empty unless asked for.
    coefficient_error: Vec<f32>,
    estimates: Vec<Summary>,
    rays: u64,
    samples: u64,
}

impl Sampled {
    /// Coefficients of one node.
    fn node(&self, place: usize, settings: &BakeSettings) -> &[f32] {
        let stride = 3 * sh::coefficient_count(settings.bands);
        &self.sh[place * stride..][..stride]
    }

    fn new(nodes: usize, settings: &BakeSettings) -> Sampled {
        let stride = 3 * sh::coefficient_count(settings.bands);
        Sampled {
            sh: vec![0.0f32; stride * nodes],
            coefficient_error: vec![0.0; if settings.coefficient_errors { stride * nodes } else { 0 }],
            estimates: vec![Summary::default(); nodes],
            rays: 0,
            samples: 0,
        }
    }
}

/// What is sampled, and how. Nodes go by their places in the lists of `sites`.
struct Job<'a, F> {
    nodes: &'a Nodes,
    sites: &'a Sites,
    function: &'a F,
    settings: &'a BakeSettings,
    control: &'a Control<'a>,
}

impl<F: RadianceFunction> Job<'_, F> {
    /// Median RMS of E over these nodes, from a few samples each: the floor of relative errors.
    fn pilot(&self, which: &[u32]) -> Result<f64, Interrupted> {
        let mut sampled = Sampled::new(self.sites.numbers.len(), self.settings);
        let silent = Control { cancel: self.control.cancel, progress: &|_, _| {} };
        Job { control: &silent, ..*self }.sample(which, |_, _| PILOT_SAMPLES, &mut sampled)?;
        Ok(median_irradiance(&sampled.estimates))
    }

    /// Samples these nodes, of which those in a row stand near each other, until `enough` says so (see
    /// [`Integrator::integrate`]).
    fn sample(
        &self,
        which: &[u32],
        enough: impl Fn(u64, Option<&NodeEstimate>) -> u64 + Sync,
        sampled: &mut Sampled,
    ) -> Result<(), Interrupted> {
        let Job { function, settings, control, .. } = *self;
        let stride = 3 * sh::coefficient_count(settings.bands);
        let sampled = Mutex::new(sampled);
        let integration =
            IntegratorSettings { bands: settings.bands, clamp: settings.clamp, importance: settings.importance };
        which.par_chunks(NEIGHBOURS).with_max_len(1).try_for_each_init(
            || Integrator::new(integration),
            |integrator, neighbours| {
                let mut known_rays = 0;
                let places: Vec<Place> = neighbours
                    .iter()
                    .map(|&index| {
                        let origin = self.sites.place(index, self.nodes, function);
                        let node = u64::from(self.sites.numbers[index as usize]);
                        let sequence = Sequence { sampler: settings.sampler, seed: settings.seed, node };
                        let known = match settings.punctual {
                            true => punctual_light(function, origin, &mut known_rays),
                            false => NO_LIGHT,
                        };
                        Place { sequence, origin, known }
                    })
                    .collect();
                // A node may take minutes: its rays stop, too.
                let radiance = |origin: Vec3, direction: Vec3, context: &mut PathContext| {
                    (!control.cancelled()).then(|| function.radiance(origin, direction, context))
                };
                let estimates = integrator.integrate(function.guide(), &places, radiance, &enough)?;
                let rays = known_rays + estimates.iter().map(|estimate| estimate.rays).sum::<u64>();
                let mut sampled = sampled.lock().expect("no worker panics");
                for (&index, estimate) in neighbours.iter().zip(&estimates) {
                    let index = index as usize;
                    let own = index * stride..(index + 1) * stride;
                    store(&mut sampled.sh[own.clone()], &estimate.sh);
                    if settings.coefficient_errors {
                        store(&mut sampled.coefficient_error[own], &estimate.coefficient_error);
                    }
                    sampled.estimates[index] = Summary::from(estimate);
                    sampled.samples += estimate.samples;
                }
                sampled.rays += rays;
                drop(sampled);
                (control.progress)(estimates.len() as u64, rays);
                Ok(())
            },
        )
    }
}

fn store(out: &mut [f32], moments: &Moments) {
    for (value, sum) in out.chunks_exact_mut(3).zip(moments) {
        value.copy_from_slice(&sum.map(|s| s as f32));
    }
}

const NO_LIGHT: Moments = [[0.0; 3]; sh::MAX_COEFFICIENTS];

/// Coefficients of the direct light of punctual lights: a direction ω that brings irradiance E to a surface facing it
/// has L_lm = E Y_lm(ω).
fn punctual_light(function: &impl RadianceFunction, origin: Vec3, rays: &mut u64) -> Moments {
    let mut moments = NO_LIGHT;
    let mut context = PathContext::new(Stream::new(Sampler::Sobol, 0, 0, 0));
    function.punctual(origin, &mut context, |direction, irradiance| {
        let mut basis = [0.0; sh::MAX_COEFFICIENTS];
        sh::basis(sh::MAX_BANDS, direction.to_array(), &mut basis);
        for (sum, y) in moments.iter_mut().zip(basis) {
            (0..3).for_each(|channel| sum[channel] += f64::from(irradiance[channel]) * f64::from(y));
        }
    });
    *rays += context.rays;
    moments
}
