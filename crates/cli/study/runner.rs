//! Runs the bakes of a study, one at a time, and holds the clock.

use cpu_time::ProcessTime;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use gdibl_baker::Control;
use gdibl_baker::analyse::Truth;
use gdibl_baker::analyse::study::{Capture, Cost, Measured, Repeat, measure};
use gdibl_baker::bake::{BakeSettings, Baked, Nodes, bake};
use gdibl_baker::capture::{CaptureSettings, capture};
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings};
use gdibl_baker::radiance::path::Path;
use gdibl_baker::sampling::Sampler;
use gdibl_baker::volume::volume_of;

use super::methods::{Circumstances, Method};
use crate::captures;
use crate::commands::bake::check_valid;
use crate::config::{Config, gdibl_settings, path_settings};
use crate::fault::Fault;
use crate::inputs::Inputs;
use crate::progress::Progress;

/// Of the capture that is timed: a second or two for the probes of a room.
const MEASURED_WIDTH: usize = 128;
const MEASURED_SAMPLES: u32 = 8;

/// Wall and CPU seconds since it was started.
struct Clock {
    wall: Instant,
    cpu: ProcessTime,
}

impl Clock {
    fn start() -> Clock {
        Clock { wall: Instant::now(), cpu: ProcessTime::now() }
    }

    fn cpu_seconds(&self) -> f64 {
        self.cpu.elapsed().as_secs_f64()
    }

    fn wall_seconds(&self) -> f64 {
        self.wall.elapsed().as_secs_f64()
    }
}

/// What the bakes of a study share.
pub struct Runner<'a> {
    pub config: &'a Config,
    pub inputs: &'a Inputs,
    pub nodes: &'a Nodes,
    pub settings: &'a BakeSettings,
    pub cancel: &'a AtomicBool,
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
    /// The probes' function.
    pub fn gdibl(&self, method: Method, samples: u64, seed: u64) -> Gdibl<'_> {
        let settings = BakeSettings { samples, ..self.settings.clone() };
        let directions = settings.directions(self.nodes.len() as u64);
        let own = gdibl_settings(&self.config.quality, self.inputs.captured, directions);
        let blend = if let Method::Blend(rule) = method { rule } else { own.blend };
        let settings = GdiblSettings { blend, seed, walks: GdiblSettings::walks_beside(samples), ..own };
        Gdibl::new(&self.inputs.scene, &self.inputs.probes, self.inputs.distant.as_ref(), settings)
    }

    /// The path tracer.
    pub fn path(&self) -> Result<Path<'_>, Fault> {
        Ok(Path::new(&self.inputs.scene, self.inputs.distant.as_ref(), path_settings(&self.config.quality)?))
    }

    /// What decides which methods tell something.
    pub fn circumstances(&self) -> Circumstances {
        Circumstances {
            probes: self.inputs.probes.len(),
            blend: gdibl_settings(&self.config.quality, self.inputs.captured, 0).blend,
            sampler: self.settings.sampler,
            light: self.inputs.has_light(),
        }
    }

    /// Ground truth at the nodes, by the path tracer, and what it took.
    pub fn reference(&self, samples: u64, seed: u64, progress: &Progress) -> Result<(Truth, Cost), Fault> {
        let settings = BakeSettings { samples, seed, ..self.settings.clone() };
        let repeat = self.timed(&self.path()?, &settings, 0.0, progress)?;
        Ok((Truth::of_volume(&repeat.volume), repeat.cost))
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
                let point = measure(budget, self.nodes.len(), truths, repeats);
                points.push(point.map_err(|nothing| Fault::Invalid(format!("--reference: {nothing}")))?);
            }
        }
        Ok(measured)
    }

    fn repeat(&self, method: Method, samples: u64, seed: u64, progress: &Progress) -> Result<Repeat, Fault> {
        let sampler = if method == Method::GdiblRandom { Sampler::Random } else { self.settings.sampler };
        let importance = method.importance();
        let settings = BakeSettings { samples, seed, sampler, importance, ..self.settings.clone() };
        // Built anew: what a function finds out on its way is part of what a bake takes.
        let clock = Clock::start();
        if let Method::Path | Method::PathUniform = method {
            let path = self.path()?;
            return self.timed(&path, &settings, clock.cpu_seconds(), progress);
        }
        let gdibl = self.gdibl(method, settings.samples, seed);
        self.timed(&gdibl, &settings, clock.cpu_seconds(), progress)
    }

    fn timed(
        &self,
        function: &impl RadianceFunction,
        settings: &BakeSettings,
        setup_seconds: f64,
        progress: &Progress,
    ) -> Result<Repeat, Fault> {
        let progress = |nodes: u64, rays: u64| progress.advance(nodes * settings.samples, rays);
        let control = Control { cancel: self.cancel, progress: &progress };
        let clock = Clock::start();
        let baked: Baked = bake(self.nodes, function, settings, &control).map_err(|_| Fault::Interrupted)?;
        let (wall_seconds, cpu_seconds) = (clock.wall_seconds(), clock.cpu_seconds());
        check_valid(&baked)?;
        let cost = Cost { wall_seconds, cpu_seconds, setup_seconds, rays: baked.rays, samples: baked.samples };
        Ok(Repeat { volume: volume_of(self.nodes, &baked), cost })
    }

    /// What `gdibl capture` would take for these probes, from a small sample of it. `None` where there is no probe, or
    /// no light to capture.
    pub fn capture_cost(&self) -> Result<Option<Capture>, Fault> {
        let Inputs { scene, probes, distant, captured, .. } = self.inputs;
        if probes.is_empty() || !self.inputs.has_light() {
            return Ok(None);
        }
        let flags = &self.config.capture;
        let samples = flags.samples.unwrap_or(CaptureSettings::default().samples);
        let (mut cpu_seconds, mut wall_seconds) = (0.0, 0.0);
        let clock = Clock::start();
        let paths = Path::new(scene, distant.as_ref(), captures::path_settings(self.config)?);
        let placed = *captured && flags.positions.is_empty();
        if placed {
            captures::automatic_placement(scene, &paths, flags, self.cancel, true)?;
        }
        cpu_seconds += clock.cpu_seconds();
        wall_seconds += clock.wall_seconds();
        let control = Control { cancel: self.cancel, progress: &|_, _| {} };
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
