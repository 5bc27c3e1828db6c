//! Light probes made from the level itself, by path tracing.
//!
//! A pixel is the mean radiance over the part of its solid angle that sees the surface in its centre (or the outside, if
//! the centre does): a pixel on an edge does not mix what lies before and behind, because who looks it up asks for
//! one of the two. Its distance is that of its centre.

pub(crate) mod free_space;
mod place;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::panorama::{Image, PLANE_TOLERANCE, PixelGrid};
use crate::radiance::path::Path;
use crate::radiance::{PathContext, RadianceFunction};
use crate::sampling::{Sampler, Stream, streams};
use crate::trace::Hit;
use crate::{Control, Interrupted};
pub use free_space::are_free;
pub use place::{FREE_PLACES, PlaceSettings, Placement, Reach, Suggestion, place_probes};

/// How probes are captured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CaptureSettings {
    /// Columns of the lat-long image; it has half as many rows. At least 2.
    pub width: usize,
    /// Paths per pixel; with a target the most of them. At least 1.
    pub samples: u32,
    /// Stop a pixel once its standard error, over the larger of its own radiance and a tenth of the probe's median, is
    /// at most this.
    pub target_error: Option<f64>,
    /// Same seed, same bytes.
    pub seed: u64,
    /// Most that a channel of a path's light may be; infinity leaves all light as it is.
    pub clamp: f32,
    /// Surfaces show what they send out themselves, as a photograph does. Without it, reflected light alone: for bakes
    /// that take emission from the level's materials, where a lamp is no blur of pixels. In a game map whose lamps are
    /// smaller than a pixel, the error of baked irradiance went from 39 % to 19 %.
    pub emission: bool,
}

impl Default for CaptureSettings {
    fn default() -> Self {
        CaptureSettings { width: 256, samples: 64, target_error: None, seed: 0, clamp: f32::INFINITY, emission: true }
    }
}

/// A captured probe.
#[derive(Debug, Clone)]
pub struct Captured {
    /// Lat-long, in the world's axes, with distances.
    pub image: Image,
    /// Paths traced.
    pub samples: u64,
    /// Rays traced.
    pub rays: u64,
    /// Root mean square over pixels of their relative standard errors (see [`CaptureSettings::target_error`]).
    pub relative_error: f64,
    /// Pixels over the target error.
    pub missed: u64,
    /// Share of the light that clamping took, 0..=1.
    pub clamped: f64,
}

/// Paths of a pixel before it is asked for the first time whether they are enough.
const FIRST_ROUND: u32 = 32;
/// Path-traces a probe. `index` tells the random numbers of several probes apart.
pub fn capture(
    path: &Path,
    position: DVec3,
    index: u64,
    settings: &CaptureSettings,
    control: &Control,
) -> Result<Captured, Interrupted> {
    assert!(settings.width >= 2, "a probe {} pixels wide", settings.width);
    assert!(settings.samples >= 1, "no sample per pixel");
    let grid = PixelGrid { width: settings.width, height: settings.width / 2 };
    let camera = Camera { path, origin: path.frame().to_trace(position), grid, index, settings, control };
    let mut pixels: Vec<Pixel> = (0..grid.width * grid.height).into_par_iter().map(|n| camera.look(n)).collect();
    // All pixels a little, then each as long as it needs.
    let first = settings.samples.min(FIRST_ROUND);
    camera.sample(&mut pixels, 0, |pixel| first.max(pixel.traced))?;
    let floor = 0.1 * median(&pixels);
    let target = settings.target_error.unwrap_or(0.0);
    camera.sample(&mut pixels, 1, |pixel| {
        if pixel.relative_error(floor) <= target {
            pixel.traced
        } else {
            pixel.traced.saturating_mul(2).min(settings.samples)
        }
    })?;

    let (kept, clamped) =
        pixels.iter().fold((0.0, 0.0), |(kept, clamped), p| (kept + p.sum.element_sum(), clamped + p.clamped));
    let errors = || pixels.iter().map(|pixel| pixel.relative_error(floor));
    let metres = |pixel: &Pixel| pixel.surface.map_or(f32::INFINITY, |hit| path.frame().metres(hit.t));
    Ok(Captured {
        image: Image {
            width: grid.width,
            height: grid.height,
            pixels: pixels.iter().map(|pixel| pixel.mean().as_vec3().to_array()).collect(),
            distance: Some(pixels.iter().map(metres).collect()),
        },
        samples: pixels.iter().map(|pixel| u64::from(pixel.traced)).sum(),
        rays: pixels.iter().map(|pixel| pixel.rays).sum(),
        relative_error: (errors().map(|e| e * e).sum::<f64>() / pixels.len() as f64).sqrt(),
        missed: settings.target_error.map_or(0, |target| errors().filter(|e| *e > target).count() as u64),
        clamped: if clamped > 0.0 { clamped / (clamped + kept) } else { 0.0 },
    })
}

/// Fills pixels.
struct Camera<'a> {
    path: &'a Path<'a>,
    /// Trace space.
    origin: Vec3,
    grid: PixelGrid,
    index: u64,
    settings: &'a CaptureSettings,
    control: &'a Control<'a>,
}

impl Camera<'_> {
    /// What stands in the middle of a pixel.
    fn look(&self, number: usize) -> Pixel {
        Pixel::new(self.path.surface(self.origin, self.grid.direction(number, [0.5, 0.5])))
    }

    /// Goes on with every pixel until it has as many paths as `enough` wants of it; says so as `done` pixels each.
    fn sample(
        &self,
        pixels: &mut [Pixel],
        done: u64,
        enough: impl Fn(&Pixel) -> u32 + Sync,
    ) -> Result<(), Interrupted> {
        pixels.par_iter_mut().enumerate().with_max_len(256).try_for_each(|(number, pixel)| {
            let stream = streams::PROBES | self.index << 32 | number as u64;
            let mut context = PathContext::new(Stream::new(Sampler::Sobol, self.settings.seed, stream, 0));
            loop {
                let wanted = enough(pixel);
                if wanted <= pixel.traced {
                    break;
                }
                for sample in pixel.traced..wanted {
                    if self.control.cancelled() {
                        return Err(Interrupted);
                    }
                    context.sample = sample;
                    let light = self.one_path(pixel, number, &mut context);
                    pixel.add(light, self.settings.clamp);
                }
                pixel.traced = wanted;
            }
            pixel.rays += context.rays;
            (self.control.progress)(done, context.rays);
            Ok(())
        })
    }

    fn one_path(&self, pixel: &Pixel, number: usize, context: &mut PathContext) -> Vec3 {
        let mut direction = self.grid.direction(number, context.point(0));
        let mut first = self.path.meet(self.origin, direction, context);
        // Past the edge of what the centre sees, the centre itself is looked at again.
        if !pixel.sees(direction, first.hit) {
            direction = self.grid.direction(number, [0.5, 0.5]);
            first = self.path.meet(self.origin, direction, context);
        }
        let light = self.path.light(direction, first, context);
        if self.settings.emission { light } else { light - self.path.emission(first) }
    }
}

/// What a pixel has seen so far.
struct Pixel {
    surface: Option<Hit>,
    sum: DVec3,
    squares: DVec3,
    traced: u32,
    rays: u64,
    clamped: f64,
}

impl Pixel {
    fn new(surface: Option<Hit>) -> Pixel {
        Pixel { surface, sum: DVec3::ZERO, squares: DVec3::ZERO, traced: 0, rays: 1, clamped: 0.0 }
    }

    /// The same surface as in the centre, or like it nothing.
    fn sees(&self, direction: Vec3, first: Option<Hit>) -> bool {
        match (self.surface, first) {
            (None, None) => true,
            (Some(surface), Some(first)) => {
                surface.triangle == first.triangle || {
                    let expected = surface.normal.dot(surface.position - (first.position - direction * first.t))
                        / surface.normal.dot(direction);
                    (first.t / expected - 1.0).abs() < PLANE_TOLERANCE
                }
            }
            _ => false,
        }
    }

    fn add(&mut self, light: Vec3, clamp: f32) {
        let largest = light.max_element();
        let kept = if largest > clamp { light * (clamp / largest) } else { light };
        self.clamped += f64::from((light - kept).element_sum());
        self.sum += kept.as_dvec3();
        self.squares += kept.as_dvec3() * kept.as_dvec3();
    }

    fn mean(&self) -> DVec3 {
        self.sum / f64::from(self.traced.max(1))
    }

    /// Standard error of the mean of R, G and B as of independent samples, over the larger of their mean and `floor`.
    fn relative_error(&self, floor: f64) -> f64 {
        let count = f64::from(self.traced);
        if count < 2.0 {
            return f64::INFINITY;
        }
        let mean = self.mean();
        let variance = (self.squares / count - mean * mean).max(DVec3::ZERO) / (count - 1.0);
        let error = (variance.element_sum() / 3.0).sqrt();
        if error == 0.0 { 0.0 } else { error / (mean.element_sum() / 3.0).max(floor) }
    }
}

/// Median of the pixels' mean of R, G and B.
fn median(pixels: &[Pixel]) -> f64 {
    let mut means: Vec<f64> = pixels.iter().map(|pixel| pixel.mean().element_sum() / 3.0).collect();
    let middle = means.len() / 2;
    *means.select_nth_unstable_by(middle, f64::total_cmp).1
}
