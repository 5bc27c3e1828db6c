//! E(x, n) = ∫ L(x, ω) max(n·ω, 0) dω at one place of a surface, straight over its hemisphere: without spherical
//! harmonics, so that neither bands nor nodes come between a radiance function and what it says. For tables and truth.
//!
//! Estimator: directions of density p leave x, half of them by cosine, half toward what is bright (see
//! [`Guide`](crate::radiance::Guide)); p is that of the mixture (balance heuristic). With w = cosθ/(π p) and coverage c:
//!
//! ```text
//!     E = π Σ w_i L_i / Σ w_i c_i
//! ```
//! A ratio, because Σ w c is known to tend to what is covered of the hemisphere: the uncovered part takes the mean of the
//! covered part, and under constant light E = πL is exact. Its standard error, from replicates r with sums A_r and C_r, is
//! π/ΣC √(R/(R-1) Σ (A_r - C_r ΣA/ΣC)²) (Cochran, "Sampling Techniques", 1977, §6.3).

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::f64::consts::PI;

use super::integrate::share;
use super::pass::Pass;
use crate::blocks::{Found, PassKind};
use crate::radiance::{PathContext, RadianceFunction};
use crate::sampling::{Sampler, Stream, cosine_hemisphere, streams};
use crate::{Control, Interrupted};

/// Independent scrambles per place: the standard error of a value is itself known to 18 %. Noise from what scene geometry does
/// to walls is in four of them together (see `radiance/effects`), and so counts for less than it is.
const REPLICATES: u32 = 16;

/// A place on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePlace {
    /// World metres; a hair off the surface, or half the rays start in it.
    pub position: DVec3,
    /// World unit normal.
    pub normal: Vec3,
}

/// How irradiance is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GatherSettings {
    /// Directions per place, at least 1, at most 2^31.
    pub samples: u64,
    /// Same seed, same numbers.
    pub seed: u64,
    /// Where directions come from.
    pub sampler: Sampler,
    /// Half of the directions go toward what is bright. Without, all go by cosine alone: the report's.
    pub guided: bool,
}

impl Default for GatherSettings {
    fn default() -> Self {
        GatherSettings { samples: 4096, seed: 0, sampler: Sampler::Sobol, guided: true }
    }
}

/// What falls on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gathered {
    /// E of linear R, G, B; 0 where nothing is covered.
    pub irradiance: DVec3,
    /// One standard error of it; infinite with one sample, or where nothing is covered.
    pub standard_error: DVec3,
    /// Share of E's hemisphere, by cosine, that was covered, 0..=1.
    pub coverage: f64,
}

/// Irradiance at every place, in their order.
pub fn irradiance_at(
    places: &[SurfacePlace],
    function: &impl RadianceFunction,
    settings: &GatherSettings,
    control: &Control,
) -> Result<Vec<Gathered>, Interrupted> {
    assert!((1..=1 << 31).contains(&settings.samples), "samples {}", settings.samples);
    let pass = Pass::begin(control, PassKind::Split);
    let gather = |(index, place): (usize, &SurfacePlace)| {
        let find = || {
            let (mut rays, mut found) = (0, Vec::new());
            let Gathered { irradiance, standard_error, coverage } =
                gather(place, index as u64, function, settings, control, (&mut rays, &mut found))?;
            Ok((irradiance.to_array(), standard_error.to_array(), coverage, rays, found))
        };
        let block = pass.block(index, |_| true, find)?.expect("shards end before this");
        let (irradiance, standard_error, coverage, rays, found) = block;
        (control.progress)(1, rays + pass.count(&found));
        Ok(Gathered { irradiance: irradiance.into(), standard_error: standard_error.into(), coverage })
    };
    let gathered = places.par_iter().enumerate().map(gather).collect::<Result<Vec<Gathered>, Interrupted>>()?;
    pass.end()?;
    Ok(gathered)
}

fn gather(
    place: &SurfacePlace,
    index: u64,
    function: &impl RadianceFunction,
    settings: &GatherSettings,
    control: &Control,
    (rays, found): (&mut u64, &mut Vec<Found>),
) -> Result<Gathered, Interrupted> {
    let origin = function.frame().to_trace(place.position);
    let replicates = u64::from(REPLICATES).min(settings.samples) as u32;
    let mut sums = Vec::new();
    for replicate in 0..replicates {
        let stream = Stream::new(settings.sampler, settings.seed, streams::SURFACES | index, replicate);
        let mut context = PathContext::new(stream);
        context.replicate = Some(replicate);
        let mut sum = Sums::default();
        for sample in 0..share(settings.samples, replicates, replicate) {
            if control.cancelled() {
                return Err(Interrupted);
            }
            context.sample = sample;
            let (direction, weight) =
                propose_on_surface(function, origin, place.normal, settings.guided, context.point(0));
            // Guided below the horizon: it counts, and brings nothing.
            if weight > 0.0 {
                let arriving = function.radiance(origin, direction, &mut context);
                sum.light += arriving.value.as_dvec3() * f64::from(weight);
                sum.covered += f64::from(arriving.told()) * f64::from(weight);
                sum.all += f64::from(weight);
            }
        }
        *rays += context.rays;
        found.append(&mut context.found);
        sums.push(sum);
    }
    Ok(estimate(&sums))
}

/// Σ w L, Σ w c and Σ w of a replicate.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    light: DVec3,
    covered: f64,
    all: f64,
}

/// A direction from a surface, and w = cosθ/(π p) of it; 0 below the horizon. `guided`: half go toward what is bright.
pub(crate) fn propose_on_surface(
    function: &impl RadianceFunction,
    origin: Vec3,
    normal: Vec3,
    guided: bool,
    [first, second]: [f32; 2],
) -> (Vec3, f32) {
    let by_cosine = |first| cosine_hemisphere(normal, [first, second]);
    let guide = function.guide();
    // Half, and what is left of the number goes on.
    let bright = if guided { guide.propose_bright(origin, [(2.0 * first - 1.0).max(0.0), second]) } else { None };
    let Some((bright, density)) = bright else { return (by_cosine(first), 1.0) };
    let (direction, density) = if first < 0.5 {
        let direction = by_cosine(2.0 * first);
        (direction, guide.bright_density(origin, direction))
    } else {
        (bright, density)
    };
    let cosine = direction.dot(normal) * std::f32::consts::FRAC_1_PI;
    (direction, if cosine > 0.0 { cosine / (0.5 * cosine + 0.5 * density) } else { 0.0 })
}

fn estimate(sums: &[Sums]) -> Gathered {
    let total = sums.iter().fold(Sums::default(), |total, sum| Sums {
        light: total.light + sum.light,
        covered: total.covered + sum.covered,
        all: total.all + sum.all,
    });
    if total.covered <= 0.0 {
        return Gathered { irradiance: DVec3::ZERO, standard_error: DVec3::INFINITY, coverage: 0.0 };
    }
    let mean = total.light / total.covered;
    let square = |sum: &Sums| {
        let off = sum.light - mean * sum.covered;
        off * off
    };
    let replicates = sums.len() as f64;
    let variance = sums.iter().map(square).sum::<DVec3>() * (replicates / (replicates - 1.0));
    let standard_error = if sums.len() > 1 {
        DVec3::from(variance.to_array().map(f64::sqrt)) * (PI / total.covered)
    } else {
        DVec3::INFINITY
    };
    Gathered { irradiance: mean * PI, standard_error, coverage: (total.covered / total.all).min(1.0) }
}
