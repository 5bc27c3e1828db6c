//! Runs the bakes of a study, one at a time, and holds the clock.

use std::cell::{Cell, RefCell};
use std::sync::atomic::AtomicBool;

use gdibl_baker::Control;
use gdibl_baker::analyse::Truth;
use gdibl_baker::analyse::study::{Capture, Cost, Measured, Repeat, Seen, measure};
use gdibl_baker::capture::{CaptureSettings, capture};
use gdibl_baker::job::records::Records;
use gdibl_baker::job::records::SeenRecord;
use gdibl_baker::job::{self, Inputs, Job, Settings, Stage, Watch, bytes_of_light, check_valid};
use gdibl_baker::pack::{PackSettings, Precision, pack};
use gdibl_baker::radiance::path::Path;
use gdibl_baker::sampling::Sampler;
use gdibl_baker::seen::HeldOut;
use gdibl_runtime::Volume;

use super::kept::Kept;
use super::methods::{Circumstances, Method};
use crate::captures;
use crate::fault::Fault;
use crate::progress::{Clock, Progress, Shown};

/// Of the capture that is timed: a second or two for the probes of a room.
const MEASURED_WIDTH: usize = 128;
const MEASURED_SAMPLES: u32 = 8;

/// Tells the random numbers of places between nodes from those of bakes.
const BETWEEN_SEED: u64 = 0xbe7_0000_0000;

/// What the bakes of a study share.
pub struct Runner<'a> {
    pub job: &'a Job,
    pub cancel: &'a AtomicBool,
    /// Light between nodes, once it is known.
    pub between: Option<HeldOut>,
    /// What is finished.
    pub kept: RefCell<Kept>,
}

/// How often, with what, and from which seeds.
pub struct Ladder<'a> {
    pub budgets: &'a [u64],
    pub repeats: usize,
    /// One for every repeat of every budget; methods share them.
    pub seeds: &'a [u64],
    /// In directions.
    pub progress: &'a Progress,
}

impl Runner<'_> {
    /// What decides which methods tell something.
    pub fn circumstances(&self) -> Circumstances {
        let quality = &self.job.settings.quality;
        Circumstances {
            probes: self.job.inputs.probes.len(),
            blend: quality.blend,
            sampler: quality.sampler,
            light: self.job.inputs.has_light(),
        }
    }

    /// Ground truth at the nodes, by the path tracer, and what it took.
    pub fn reference(&self, samples: u64, seed: u64, progress: &Progress) -> Result<(Truth, Cost), Fault> {
        let repeat = self.repeat(Method::Path, samples, seed, progress)?;
        Ok((Truth::of_volume(&repeat.volume), repeat.cost))
    }

    /// Finds out what light is between the nodes, by the path tracer; nothing where no volume is read there.
    pub fn look_between(&mut self, samples: u64) -> Result<(), Fault> {
        let mut settings = self.job.settings.clone();
        settings.quality.method = job::Method::Path;
        // No bake shares its random numbers.
        settings.quality.seed ^= BETWEEN_SEED;
        let watch = Watch::silent(self.cancel);
        self.between = self.job.hold_out(&settings, samples, &watch).map_err(|_| Fault::Interrupted)?;
        Ok(())
    }

    /// Every method with every budget. Methods take turns, so that a machine that slows down does so for all.
    pub fn measure_all(
        &self,
        methods: &[Method],
        circumstances: &Circumstances,
        ladder: &Ladder,
        truths: &[Truth],
    ) -> Result<Vec<Measured>, Fault> {
        let mut measured: Vec<Measured> =
            methods.iter().map(|method| (method.name(), method.about(circumstances), Vec::new())).collect();
        for (&budget, seeds) in ladder.budgets.iter().zip(ladder.seeds.chunks(ladder.repeats)) {
            let mut repeats: Vec<Vec<Repeat>> = vec![Vec::new(); methods.len()];
            for &seed in seeds {
                for (method, repeats) in methods.iter().zip(&mut repeats) {
                    repeats.push(self.repeat(*method, budget, seed, ladder.progress)?);
                }
            }
            for ((_, _, points), repeats) in measured.iter_mut().zip(&repeats) {
                let point = measure(budget, self.job.nodes().len(), truths, repeats);
                points.push(point.map_err(|nothing| Fault::Invalid(format!("--reference: {nothing}")))?);
            }
        }
        Ok(measured)
    }

    /// One bake, unless it is known. All is built anew: what a function finds out on its way is part of what a bake takes.
    fn repeat(&self, method: Method, samples: u64, seed: u64, progress: &Progress) -> Result<Repeat, Fault> {
        if let Some(repeat) = self.kept.borrow().get(&method.name(), samples, seed) {
            progress.advance(self.job.nodes().len() as u64 * samples, 0);
            return Ok(repeat);
        }
        let mut settings: Settings = self.job.settings.clone();
        let quality = &mut settings.quality;
        (quality.samples, quality.seed) = (Some(samples), seed);
        quality.method = match method {
            Method::Path | Method::PathUniform => job::Method::Path,
            _ => job::Method::Gdibl,
        };
        match method {
            Method::Blend(rule) => quality.blend = rule,
            Method::GdiblRandom => quality.sampler = Sampler::Random,
            _ => {}
        }
        // A study compares nodes, at its own reference.
        quality.seen_places = Some(0);
        let advance = |nodes: u64, rays: u64| progress.advance(nodes * samples, rays);
        let (clock, setup) = (Clock::start(), Cell::new([0.0; 2]));
        let stage = |stage| {
            if stage == Stage::Nodes {
                setup.set([clock.wall_seconds(), clock.cpu_seconds()]);
            }
        };
        let watch = Watch { cancel: self.cancel, progress: &advance, stage: &stage, seconds: &|| 0.0, blocks: None };
        let baked = self.job.sample(&settings, method.importance(), &watch).map_err(|_| Fault::Interrupted)?.baked;
        let [setup_wall, setup_cpu] = setup.get();
        let cost = Cost {
            wall_seconds: clock.wall_seconds() - setup_wall,
            cpu_seconds: clock.cpu_seconds() - setup_cpu,
            setup_seconds: setup_cpu,
            rays: baked.rays,
            samples: baked.samples,
        };
        check_valid(&baked).map_err(Fault::Bound)?;
        let nodes = self.job.nodes();
        let bytes = bytes_of_light(nodes, &baked, &settings);
        let seen = self.between.as_ref();
        let seen = seen.and_then(|between| seen_of(&between.errors(nodes, &baked, settings.pack()).0));
        let single = PackSettings { precision: Precision::F32, ..PackSettings::default() };
        let packed = pack(nodes, &baked, Records::default(), single).bytes;
        let volume = Volume::parse(&packed).expect("what was packed parses");
        let repeat = Repeat { volume, cost, seen, bytes };
        self.kept.borrow_mut().put(&method.name(), samples, seed, &repeat, &packed);
        Ok(repeat)
    }

    /// What `gdibl capture` would take for these probes, from a small sample of it. `None` where there is no probe, or
    /// no light to capture.
    pub fn capture_cost(&self) -> Result<Option<Capture>, Fault> {
        let Inputs { scene, probes, distant, captured, .. } = &self.job.inputs;
        if probes.is_empty() || !self.job.inputs.has_light() {
            return Ok(None);
        }
        let asked = &self.job.settings.capture;
        let samples = self.job.settings.capture_probes().samples;
        let (mut cpu_seconds, mut wall_seconds) = (0.0, 0.0);
        let clock = Clock::start();
        let paths = Path::new(scene, distant.as_ref(), self.job.settings.capture_path());
        let placed = *captured && asked.positions.is_empty();
        if placed {
            captures::automatic_placement(scene, &paths, asked, self.cancel, Shown::None)?;
        }
        cpu_seconds += clock.cpu_seconds();
        wall_seconds += clock.wall_seconds();
        let control = Control { cancel: self.cancel, progress: &|_, _| {}, blocks: None };
        for (index, probe) in probes.iter().enumerate() {
            let width = probe.panorama.width();
            let settings = CaptureSettings {
                width: width.min(MEASURED_WIDTH),
                samples: samples.min(MEASURED_SAMPLES),
                emission: !captured,
                ..CaptureSettings::default()
            };
            let clock = Clock::start();
            let found = capture(&paths, probe.position, index as u64, &settings, &control);
            found.map_err(|_| Fault::Interrupted)?;
            let pixels = (width as f64 / settings.width as f64).powi(2);
            let times = pixels * f64::from(samples) / f64::from(settings.samples);
            cpu_seconds += times * clock.cpu_seconds();
            wall_seconds += times * clock.wall_seconds();
        }
        let widths = probes.iter().map(|probe| probe.panorama.width());
        let (least, most) = (widths.clone().min().unwrap_or(0), widths.max().unwrap_or(0));
        let size = if least == most { format!("{most}") } else { format!("{least} to {most}") };
        let about = format!(
            "{} probes, {size} pixels wide, {samples} paths per pixel{}; scaled up from at most {MEASURED_SAMPLES} paths \
             per pixel at {MEASURED_WIDTH} pixels, as the cost is linear in both",
            probes.len(),
            if placed { ", and finding their places" } else { "" },
        );
        Ok(Some(Capture { cpu_seconds, wall_seconds, about }))
    }
}

/// The larger of the errors in the air and on surfaces.
fn seen_of(record: &SeenRecord) -> Option<Seen> {
    let sets = [record.air, record.surfaces].into_iter().flatten();
    let of = |set: job::records::SeenSet| Seen { median: set.error.median, p95: set.error.p95 };
    sets.map(of).reduce(|a, b| Seen { median: a.median.max(b.median), p95: a.p95.max(b.p95) })
}
