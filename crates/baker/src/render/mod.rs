//! Pictures of a level, by the same radiance functions that bakes use: to look at light before an engine does.
//!
//! A pixel is the mean of L over its square, L(eye, ω) being what the radiance function tells of a camera's ray:
//!
//! | the ray meets | and shows |
//! |---|---|
//! | environment geometry | the probes that see it, blended; what scene geometry changes there, by a walk of the ray's own |
//! | scene geometry | emission + albedo/π · E: E by one ray per sample that goes on |
//! | any surface, given a volume | emission + albedo/π · E of the volume, as an engine shows it; see [`VolumeLight`] |
//! | a mirror, see [`Material::is_mirror`](crate::scene::Material::is_mirror) | what lies in the mirror direction, × base colour |
//! | nothing | the distant panorama |
//!
//! By path tracing every surface is lit by walks, and every mirror reflects. Only a camera sees mirrors: light that
//! reaches another surface by way of one is left out, as in bakes. What no probe has seen is black, and counted.
//!
//! Based on: K. Vestergaard, "Geometrically Derived Image Based Lighting", Aalborg University, 2008, chapter 5 (its ray
//! tracer, 50 rays per sample, three levels deep).

mod camera;
mod heat;
mod slice;
pub mod tone;
mod volume;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

pub use camera::Camera;
use camera::Lens;
pub use heat::Scale;
pub use slice::slice;
use std::cell::Cell;
use volume::Spheres;
pub use volume::{Figures, Sphere, SphereLook, VolumeLight};

use crate::panorama::Image;
use crate::radiance::{PathContext, Radiance, RadianceFunction, Seen};
use crate::sampling::{Sampler, Stream, streams};
use crate::scene::Role;
use crate::{Control, Interrupted};

/// How a picture is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RenderSettings {
    /// Columns, at least 1.
    pub width: usize,
    /// Rows, at least 1.
    pub height: usize,
    /// Camera rays per pixel, at least 1.
    pub samples: u32,
    /// Mirrors in a row; behind the last one light is uncovered. How often scene geometry recurses is the radiance
    /// function's affair.
    pub depth: u32,
    /// Same seed, same picture.
    pub seed: u64,
    /// Where random numbers come from.
    pub sampler: Sampler,
}

impl Default for RenderSettings {
    fn default() -> Self {
        RenderSettings { width: 640, height: 360, samples: 64, depth: 3, seed: 0, sampler: Sampler::Sobol }
    }
}

/// A picture, and what it took.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Linear radiance, black where uncovered.
    pub image: Image,
    /// Share of all rays that found nothing that a probe, the sky or a light tells of, 0..=1.
    pub uncovered: f64,
    /// Rays traced.
    pub rays: u64,
}

/// Takes a picture. `volume`: lights dull surfaces instead of the radiance function; all of them where that is path tracing.
pub fn render(
    function: &impl RadianceFunction,
    volume: Option<&VolumeLight>,
    camera: &Camera,
    settings: &RenderSettings,
    control: &Control,
) -> Result<Picture, Interrupted> {
    let RenderSettings { width, height, samples, .. } = *settings;
    assert!(width > 0 && height > 0, "a picture of {width} x {height} pixels");
    assert!(samples > 0, "no sample per pixel");
    let frame = function.frame();
    let spheres = volume.and_then(|volume| Spheres::new(&volume.spheres, frame));
    let renderer = Renderer { function, volume, spheres, lens: camera.lens(width, height, frame), settings, control };
    let pixels: Result<Vec<Pixel>, Interrupted> =
        (0..width * height).into_par_iter().with_max_len(256).map(|number| renderer.pixel(number)).collect();
    let pixels = pixels?;
    let rays = width as f64 * height as f64 * f64::from(samples);
    Ok(Picture {
        uncovered: pixels.iter().map(|pixel| pixel.uncovered).sum::<f64>() / rays,
        rays: pixels.iter().map(|pixel| pixel.rays).sum(),
        image: Image::new(width, height, pixels.iter().map(|pixel| pixel.mean.to_array()).collect()),
    })
}

/// What came of a pixel.
struct Pixel {
    mean: Vec3,
    /// In camera rays.
    uncovered: f64,
    rays: u64,
}

struct Renderer<'a, F> {
    function: &'a F,
    volume: Option<&'a VolumeLight<'a>>,
    spheres: Option<Spheres>,
    lens: Lens,
    settings: &'a RenderSettings,
    control: &'a Control<'a>,
}

/// A ray on its way from the camera.
#[derive(Clone, Copy)]
struct View {
    pixel: usize,
    /// Mirrors it has met.
    mirrors: u32,
}

impl<F: RadianceFunction> Renderer<'_, F> {
    fn pixel(&self, number: usize) -> Result<Pixel, Interrupted> {
        let view = View { pixel: number, mirrors: 0 };
        let mut context = PathContext::new(self.stream(view));
        let mut sum = DVec3::ZERO;
        let mut covered = 0.0;
        for sample in 0..self.settings.samples {
            if self.control.cancelled() {
                return Err(Interrupted);
            }
            context.sample = sample;
            let direction = self.lens.direction(number, context.point(0));
            let light = self.look(view, self.lens.eye, direction, &mut context);
            sum += light.value.as_dvec3();
            covered += f64::from(light.coverage);
        }
        (self.control.progress)(1, context.all_rays());
        let samples = f64::from(self.settings.samples);
        Ok(Pixel { mean: (sum / samples).as_vec3(), uncovered: samples - covered, rays: context.all_rays() })
    }

    /// Random numbers of a pixel; anew behind every mirror, because radiance functions count theirs from the first hit.
    fn stream(&self, view: View) -> Stream {
        let RenderSettings { sampler, seed, .. } = *self.settings;
        Stream::new(sampler, seed, streams::PICTURES | view.pixel as u64, view.mirrors)
    }

    fn look(&self, view: View, origin: Vec3, direction: Vec3, context: &mut PathContext) -> Radiance {
        let sphere = self.spheres.as_ref().and_then(|spheres| spheres.nearest(origin, direction)).zip(self.volume);
        let Some(((far, normal, look), light)) = sphere else {
            return self.function.look(origin, direction, context, |seen, context| self.shade(view, seen, context));
        };
        let shown = light.sphere(look, normal);
        // A surface may stand before it.
        let hidden = Cell::new(false);
        let found = self.function.look(origin, direction, context, |seen, context| {
            hidden.set((seen.position() - origin).dot(direction) < far);
            if hidden.get() { self.shade(view, seen, context) } else { Some(Radiance::covered(shown)) }
        });
        if hidden.get() { found } else { Radiance::covered(shown) }
    }

    /// Mirrors, and what a volume lights; everything else is the radiance function's.
    fn shade(&self, view: View, seen: &Seen, context: &mut PathContext) -> Option<Radiance> {
        if let Some(color) = seen.mirror_color() {
            if view.mirrors == self.settings.depth {
                return Some(Radiance { value: seen.emission(), ..Radiance::UNCOVERED });
            }
            let view = View { mirrors: view.mirrors + 1, ..view };
            let stream = std::mem::replace(&mut context.stream, self.stream(view));
            let (start, direction) = seen.reflected();
            let arriving = self.look(view, start, direction, context);
            context.stream = stream;
            return Some(Radiance { value: seen.emission() + color * arriving.value, ..arriving });
        }
        let light = self.volume.filter(|light| !light.objects_only || seen.role() == Role::Scene)?;
        let position = self.function.frame().to_world(seen.position());
        Some(Radiance::covered(light.surface(position, seen.normal(), seen.albedo(), seen.emission())))
    }
}
