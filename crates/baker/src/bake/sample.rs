//! Samples nodes until they are known well enough, in batches.

use bincode::{Decode, Encode};
use gdibl_runtime::sh;
use glam::Vec3;
use rayon::prelude::*;
use std::sync::Mutex;

use super::baked::BakeSettings;
use super::integrate::{Integrator, IntegratorSettings, Moments, NodeEstimate, Place, Sequence, Told};
use super::nodes::Nodes;
use super::pass::Pass;
use super::standing::{Sites, Standing};
use super::summary::Summary;
use super::systematic::least_systematic_error;
use crate::blocks::{Found, PassKind};
use crate::radiance::{Audit, PathContext, RadianceFunction, number_of_place};
use crate::rows::{Row, Table};
use crate::sampling::{Sampler, Stream};
use crate::{Control, Interrupted};

/// Samples of the pilot that finds the median irradiance, and of the first round of adaptive sampling.
const PILOT_SAMPLES: u64 = 256;

/// Nodes that stand near each other and tell each other what they see.
const NEIGHBOURS: usize = 8;

/// Nodes that are audited, about, and their share at most; share of their directions; and the random number that chooses these. Squares
/// of systematic error are known best where few nodes are audited much. Retuned by `tools/never_worse`.
const AUDITED_NODES: f64 = 32.0;
const MOST_AUDITED_NODES: f64 = 0.25;
const AUDITED: f32 = 0.25;
const AUDIT: u32 = 0xffff;

/// What a volume's errors are judged by.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scale {
    /// Median irradiance of its nodes.
    pub median: f64,
    /// What more directions do not take away, over the irradiance of a node: so much of it as is certain.
    pub systematic: f64,
}

/// Some nodes, and what was found at them.
pub(super) struct Batch {
    pub sites: Sites,
    pub sampled: Sampled,
    pub scale: Scale,
}

impl Batch {
    /// Samples the nodes of these numbers. `scale` of others that were sampled before; else it is found.
    pub fn sample(
        nodes: &Nodes,
        numbers: Vec<u32>,
        scale: Option<Scale>,
        function: &impl RadianceFunction,
        settings: &BakeSettings,
        control: &Control,
    ) -> Result<Batch, Interrupted> {
        let is_whole = scale.is_none();
        let mut sites = Sites::find(nodes, numbers, function, control)?;
        let count = sites.numbers.len();
        let open = sites.open(nodes.neighbourhoods(&sites.numbers).into_iter());
        (control.progress)((count - open.len()) as u64, sites.rays);
        let job = Job { nodes, sites: &sites, function, settings, control };
        let mut pilot_rays = 0;
        let scale = match settings.target_error {
            Some(_) if settings.samples > PILOT_SAMPLES && scale.is_none() => Some(job.pilot(&open, &mut pilot_rays)?),
            _ => scale,
        };
        let enough = |done: u64, estimate: Option<&NodeEstimate>| match (settings.target_error, scale, estimate) {
            (Some(_), Some(_), None) => PILOT_SAMPLES.min(settings.samples),
            (Some(target), Some(scale), Some(estimate)) => {
                let estimate = Summary::from(estimate);
                let relative = estimate.relative(estimate.standard_error, scale.median);
                let unseen = estimate.relative(estimate.unseen_error, scale.median);
                // Double until noise and systematic error together meet the target; where the latter alone misses it, until noise is
                // no greater.
                let systematic = scale.systematic.hypot(unseen);
                let goal = (target * target - systematic * systematic).max(0.0).sqrt().max(systematic.min(target));
                if relative <= goal { done } else { (2 * done).min(settings.samples) }
            }
            _ => settings.samples,
        };
        let mut sampled = Sampled::new(count, settings, control);
        sampled.rays = pilot_rays;
        job.sample(&open, PassKind::Split, enough, &mut sampled)?;
        let scale = scale.unwrap_or_else(|| sampled.scale(&open));
        let is_dark = |sampled: &Sampled, node: &u32| sampled.estimates.first(*node as usize).is_dark(scale.median);
        let dark: Vec<u32> = sites.suspects.iter().copied().filter(|node| is_dark(&sampled, node)).collect();
        let out = sites.step_out(&dark, nodes, function);
        let silent = Control {
            cancel: control.cancel,
            progress: &|_, rays| (control.progress)(0, rays),
            blocks: control.blocks,
        };
        Job { nodes, sites: &sites, function, settings, control: &silent }.sample(
            &out,
            PassKind::Split,
            enough,
            &mut sampled,
        )?;
        for node in out.into_iter().filter(|node| !is_dark(&sampled, node)) {
            sites.standing[node as usize] = Standing::Open;
        }
        // Where no node is in the open, nothing tells a solid of double-sided walls from a dark room: they are in one.
        if is_whole && !sites.standing.contains(&Standing::Open) {
            dark.iter().for_each(|node| sites.standing[*node as usize] = Standing::Open);
        }
        for (standing, estimate) in sites.standing.iter_mut().zip(sampled.estimates.firsts()) {
            if *standing == Standing::Open && estimate.coverage == 0.0 {
                *standing = Standing::Uncovered;
            }
        }
        Ok(Batch { sites, sampled, scale })
    }

    /// Others behind these.
    pub fn append(&mut self, other: Batch) {
        self.sites.append(other.sites);
        let Sampled { sh, coefficient_error, estimates, rays, samples } = other.sampled;
        self.sampled.sh.append(sh);
        self.sampled.coefficient_error.extend(coefficient_error);
        self.sampled.estimates.append(estimates);
        self.sampled.rays += rays;
        self.sampled.samples += samples;
    }

    /// Those at these places, as the nodes 0 and up. What all took is what these took.
    pub fn selected(&self, places: &[u32], settings: &BakeSettings) -> Batch {
        let stride = 3 * sh::coefficient_count(settings.bands);
        let rows = |all: &[f32]| match all.is_empty() {
            true => Vec::new(),
            false => places.iter().flat_map(|p| &all[*p as usize * stride..][..stride]).copied().collect(),
        };
        let sampled = Sampled {
            sh: self.sampled.sh.selected(places.iter().map(|place| *place as usize)),
            coefficient_error: rows(&self.sampled.coefficient_error),
            estimates: self.sampled.estimates.selected(places.iter().map(|place| *place as usize)),
            rays: self.sampled.rays,
            samples: self.sampled.samples,
        };
        let scale = Scale { median: median_irradiance(&sampled.estimates), ..self.scale };
        Batch { sites: self.sites.selected(places), sampled, scale }
    }
}

fn median_irradiance(estimates: &Table<Summary>) -> f64 {
    let lit = estimates.firsts().filter(|e| e.coverage > 0.0 && e.rms_irradiance > 0.0);
    let mut valid: Vec<f64> = lit.map(|e| e.rms_irradiance).collect();
    if valid.is_empty() {
        return 0.0;
    }
    let middle = valid.len() / 2;
    *valid.select_nth_unstable_by(middle, f64::total_cmp).1
}

pub(super) struct Sampled {
    pub sh: Table,
    /// Empty unless asked for.
    pub coefficient_error: Vec<f32>,
    pub estimates: Table<Summary>,
    pub rays: u64,
    pub samples: u64,
}

impl Sampled {
    /// Of the nodes at these places.
    fn scale(&self, which: &[u32]) -> Scale {
        let median = median_irradiance(&self.estimates);
        Scale { median, systematic: least_systematic_error(which, &self.estimates, median) }
    }

    /// Coefficients of one node.
    pub fn node(&self, place: usize) -> Row<'_> {
        self.sh.row(place)
    }

    /// Takes what the nodes at these places came to.
    fn set(&mut self, places: &[u32], block: &Block, stride: usize) {
        for (at, &place) in places.iter().enumerate() {
            let own = |at: usize| at * stride..(at + 1) * stride;
            self.sh.set(place as usize, &block.sh[own(at)]);
            if !block.coefficient_error.is_empty() {
                self.coefficient_error[own(place as usize)].copy_from_slice(&block.coefficient_error[own(at)]);
            }
            self.estimates.set(place as usize, &block.estimates[at..=at]);
        }
        self.samples += block.samples;
        self.rays += block.rays;
    }

    fn new(nodes: usize, settings: &BakeSettings, control: &Control) -> Sampled {
        let stride = 3 * sh::coefficient_count(settings.bands);
        Sampled {
            sh: Table::zeros(nodes, stride, control.blocks),
            coefficient_error: vec![0.0; if settings.coefficient_errors { stride * nodes } else { 0 }],
            estimates: Table::zeros(nodes, 1, control.blocks),
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
    /// The scale of errors at these nodes, from a few samples each. Counts its rays.
    fn pilot(&self, which: &[u32], rays: &mut u64) -> Result<Scale, Interrupted> {
        let mut sampled = Sampled::new(self.sites.numbers.len(), self.settings, self.control);
        let silent = Control { cancel: self.control.cancel, progress: &|_, _| {}, blocks: self.control.blocks };
        Job { control: &silent, ..*self }.sample(which, PassKind::Shared, |_, _| PILOT_SAMPLES, &mut sampled)?;
        *rays += sampled.rays;
        Ok(sampled.scale(which))
    }

    /// Samples these nodes, of which those in a row stand near each other, until `enough` says so (see
    /// [`Integrator::integrate`]).
    fn sample(
        &self,
        which: &[u32],
        kind: PassKind,
        enough: impl Fn(u64, Option<&NodeEstimate>) -> u64 + Sync,
        sampled: &mut Sampled,
    ) -> Result<(), Interrupted> {
        let Job { function, settings, control, sites, .. } = *self;
        let origin = |which: &[u32]| sites.place(which[0], self.nodes, function).to_array();
        let numbers = |which: &[u32]| -> Vec<u32> { which.iter().map(|&i| sites.numbers[i as usize]).collect() };
        let stride = 3 * sh::coefficient_count(settings.bands);
        let sampled = Mutex::new(sampled);
        let pass = Pass::begin(control, kind);
        let share = (AUDITED_NODES / which.len() as f64).min(MOST_AUDITED_NODES);
        let audited_places = (share * f64::from(u32::MAX)) as u32;
        let integration =
            IntegratorSettings { bands: settings.bands, clamp: settings.clamp, importance: settings.importance };
        let find = |integrator: &mut Integrator, neighbours: &[u32]| {
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
                (!control.cancelled()).then(|| told(function, audited_places, origin, direction, context))
            };
            let estimates = integrator.integrate(function.guide(), &places, radiance, &enough)?;
            let rows = |of: fn(&NodeEstimate) -> &Moments| {
                let mut rows = vec![0.0; stride * estimates.len()];
                rows.chunks_exact_mut(stride).zip(&estimates).for_each(|(row, estimate)| store(row, of(estimate)));
                rows
            };
            Ok(Block {
                numbers: numbers(neighbours),
                origin: origin(neighbours),
                sh: rows(|estimate| &estimate.sh),
                coefficient_error: match settings.coefficient_errors {
                    true => rows(|estimate| &estimate.coefficient_error),
                    false => Vec::new(),
                },
                estimates: estimates.iter().map(Summary::from).collect(),
                samples: estimates.iter().map(|estimate| estimate.samples).sum(),
                rays: known_rays + estimates.iter().map(|estimate| estimate.rays).sum::<u64>(),
                found: estimates.iter().flat_map(|estimate| &estimate.found).copied().collect(),
            })
        };
        let sample = |integrator: &mut Integrator, (number, neighbours): (usize, &[u32])| {
            let fits = |block: &Block| block.origin == origin(neighbours) && block.fits(&numbers(neighbours), settings);
            let Some(mut block) = pass.block(number, fits, || find(integrator, neighbours))? else { return Ok(()) };
            block.rays += pass.count(&block.found);
            sampled.lock().expect("no worker panics").set(neighbours, &block, stride);
            (control.progress)(neighbours.len() as u64, block.rays);
            Ok(())
        };
        let blocks = which.par_chunks(NEIGHBOURS).enumerate().with_max_len(1);
        blocks.try_for_each_init(|| Integrator::new(integration), sample)?;
        pass.end()
    }
}

/// What nodes in a row came to.
#[derive(Debug, Encode, Decode)]
struct Block {
    /// Which nodes, and where the rays of the first one start: of another grid they have the same numbers.
    numbers: Vec<u32>,
    origin: [f32; 3],
    sh: Vec<f32>,
    coefficient_error: Vec<f32>,
    estimates: Vec<Summary>,
    samples: u64,
    /// But those of `found`.
    rays: u64,
    found: Vec<Found>,
}

impl Block {
    /// It is of these nodes, and has all that the settings ask for.
    fn fits(&self, numbers: &[u32], settings: &BakeSettings) -> bool {
        let size = 3 * sh::coefficient_count(settings.bands) * numbers.len();
        let errors = if settings.coefficient_errors { size } else { 0 };
        self.numbers == numbers
            && (self.sh.len(), self.coefficient_error.len(), self.estimates.len()) == (size, errors, numbers.len())
    }
}

/// Light along a ray. Of one that leaves an audited place a share is audited.
fn told(
    function: &impl RadianceFunction,
    audited_places: u32,
    origin: Vec3,
    direction: Vec3,
    context: &mut PathContext,
) -> Told {
    let arriving = function.radiance(origin, direction, context);
    if number_of_place(origin) >= audited_places || context.stream.random(context.sample, AUDIT) >= AUDITED {
        return arriving.into();
    }
    let reach = context.reach;
    let audit = function.audit(origin, direction, context);
    context.reach = reach;
    Told { arriving, audit: audit.map(|audit| Audit { weight: audit.weight / AUDITED, ..audit }) }
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
