//! What probes have seen of a level, and how well: of its surfaces, by area and as its free space sees them, and of what
//! lies at infinity.
//!
//! Seen is what has a free line to a probe that stands before it, as in a bake (see [`crate::radiance::gdibl`]); how well, by the
//! probe of the largest footprint weight there. A panorama of N pixels has N cosθ / (4π d²) of them per unit of surface, so
//! one of them covers a square of
//!
//! ```text
//!     size = d √(4π / (N cosθ))
//! ```
//! Free space is places all over the level that stand in no solid (see [`crate::capture::are_free`]); surfaces by area are those
//! that border on it.

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;
use serde::Serialize;
use std::f32::consts::PI;
use std::sync::atomic::AtomicBool;

use crate::Control;
use crate::capture::free_space::{FreeSpace, Looker, Sight};
use crate::radiance::path::Path;
use crate::radiance::{Guide, PathContext, Radiance, RadianceFunction};
use crate::sampling::{Sampler, Stream, streams};
use crate::trace::{Frame, Hit, Level};

/// A probe, as far as coverage asks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Viewpoint {
    /// World metres.
    pub position: DVec3,
    /// Pixels of its panorama, all over the sphere; at least 1.
    pub pixels: usize,
}

/// What probes have seen.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Coverage {
    /// Free places that were looked from; nothing else is known where there is none.
    pub free_places: usize,
    /// Surfaces as the free places see them: whole in sr of a place's sphere, in the mean; pixels in metres.
    pub surfaces_by_solid_angle: Covered,
    /// Surfaces that border on free space, by area: whole in square metres; pixels in metres.
    pub surfaces_by_area: Covered,
    /// What the free places see past all surfaces: whole in sr of a place's sphere, in the mean; pixels in degrees. Covered by
    /// the distant panorama where there is one, else by probes from which the same direction escapes.
    pub distant: Covered,
}

/// A whole, and what of it is seen.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Covered {
    /// In its own unit.
    pub whole: f64,
    /// Share that some probe has seen, 0..=1; 1 where there is nothing to see.
    pub share: f64,
    /// Edge of a pixel of the best probe; `None` where nothing is seen.
    pub pixel_size: Option<PixelSize>,
}

/// Percentiles of the size of a pixel where it is seen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PixelSize {
    /// A twentieth is finer.
    pub p5: f64,
    /// Half.
    pub median: f64,
    /// A twentieth is coarser.
    pub p95: f64,
}

/// Directions in which every free place looks.
const DIRECTIONS: u32 = 64;
/// Places on surfaces.
const SURFACE_PLACES: u32 = 16_384;

/// Probes in the level whose surfaces they may have seen.
#[derive(Debug)]
pub struct CoverageView<'a> {
    path: &'a Path<'a>,
    /// Trace positions, and pixels.
    probes: Vec<(Vec3, f32)>,
}

impl<'a> CoverageView<'a> {
    /// `path`: of the environment alone, whose surfaces probes see.
    pub fn new(path: &'a Path<'a>, probes: &[Viewpoint]) -> CoverageView<'a> {
        let place = |probe: &Viewpoint| (path.frame().to_trace(probe.position), probe.pixels as f32);
        CoverageView { path, probes: probes.iter().map(place).collect() }
    }

    /// Metres that a pixel of the probe covers that sees the surface point best; `None` if none sees it.
    fn pixel_size(&self, point: &Hit) -> Option<f32> {
        let view = |(position, pixels): &(Vec3, f32)| {
            let line = *position - point.position;
            let density = pixels * line.dot(point.normal) / line.length().powi(3);
            (density > 0.0).then_some((density, *position))
        };
        let mut views: Vec<(f32, Vec3)> = self.probes.iter().filter_map(view).collect();
        views.sort_by(|a, b| b.0.total_cmp(&a.0));
        let best = views.iter().find(|(_, position)| self.path.sees(point, *position));
        best.map(|(density, _)| self.path.frame().metres((4.0 * PI / density).sqrt()))
    }

    /// Degrees that a pixel of the best probe covers from which a direction escapes.
    fn distant_pixel_size(&self, direction: Vec3) -> Option<f32> {
        let escapes = |(position, _): &&(Vec3, f32)| self.path.surface(*position, direction).is_none();
        let pixels = self.probes.iter().filter(escapes).map(|(_, pixels)| *pixels).max_by(f32::total_cmp);
        pixels.map(degrees)
    }
}

/// A picture of what the probes have seen, as a radiance function that [`render`](crate::render::render) takes: surfaces from
/// [`CoveragePaint::FINE`] to [`CoveragePaint::COARSE`] by how well the best probe resolves them, and [`CoveragePaint::UNSEEN`]
/// where none sees them.
#[derive(Debug)]
pub struct CoveragePaint<'a> {
    view: &'a CoverageView<'a>,
    /// Metres that a pixel covers at the ends of the scale.
    ends: [f32; 2],
}

impl<'a> CoveragePaint<'a> {
    /// Linear colour of what is seen best; shaded a little by how it faces the camera, as all that is seen.
    pub const FINE: Vec3 = Vec3::new(0.7, 0.7, 0.6);
    /// Of what is seen worst.
    pub const COARSE: Vec3 = Vec3::new(0.0, 0.05, 0.25);
    /// Of what no probe sees: flat, so that it stands out in the dark, too.
    pub const UNSEEN: Vec3 = Vec3::new(0.75, 0.0, 0.4);
    /// Past all surfaces.
    pub const BACKGROUND: Vec3 = Vec3::new(0.05, 0.05, 0.05);

    /// The scale goes from what is finest but for a twentieth to what is coarsest but for one.
    /// Without sizes nothing is seen.
    pub fn new(view: &'a CoverageView<'a>, size: Option<PixelSize>) -> CoveragePaint<'a> {
        CoveragePaint { view, ends: size.map_or([1.0; 2], |size| [size.p5, size.p95].map(|end| end as f32)) }
    }

    fn color(&self, origin: Vec3, direction: Vec3) -> Vec3 {
        let Some(hit) = self.view.path.surface(origin, direction) else { return Self::BACKGROUND };
        let Some(size) = self.view.pixel_size(&hit) else { return Self::UNSEEN };
        let [fine, coarse] = self.ends;
        // Stops above the finest, over those of the whole scale.
        let share = if coarse > fine { (size / fine).log2() / (coarse / fine).log2() } else { 0.0 };
        let facing = hit.normal.dot(direction).abs();
        Self::FINE.lerp(Self::COARSE, share.clamp(0.0, 1.0)) * (0.6 + 0.4 * facing)
    }
}

impl RadianceFunction for CoveragePaint<'_> {
    fn frame(&self) -> &Frame {
        self.view.path.frame()
    }

    fn level(&self) -> Level<'_> {
        self.view.path.level()
    }

    fn guide(&self) -> &Guide {
        self.view.path.guide()
    }

    fn radiance(&self, origin: Vec3, direction: Vec3, context: &mut PathContext) -> Radiance {
        context.rays += 1;
        Radiance::covered(self.color(origin, direction))
    }
}

fn degrees(pixels: f32) -> f32 {
    (4.0 * PI / pixels).sqrt().to_degrees()
}

/// What the probes have seen of the level in `bounds` (world metres). `distant_pixels`: of the distant panorama.
pub fn coverage(view: &CoverageView, bounds: (DVec3, DVec3), distant_pixels: Option<usize>) -> Coverage {
    let looker = Looker::new(view.path);
    let uninterrupted = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    let space = FreeSpace::find(&looker, bounds, &uninterrupted).expect("nobody interrupts");
    let sights = space.sights(view.path, DIRECTIONS, &uninterrupted).expect("nobody interrupts");
    let sphere = 4.0 * std::f64::consts::PI / sights.len().max(1) as f64;
    let surfaces: Vec<Option<f32>> =
        sights.par_iter().filter_map(|sight| sight.hit).map(|hit| view.pixel_size(&hit)).collect();
    let distant = |sight: &Sight| match distant_pixels {
        Some(pixels) => Some(degrees(pixels as f32)),
        None => view.distant_pixel_size(sight.direction),
    };
    let distant: Vec<Option<f32>> = sights.par_iter().filter(|sight| sight.hit.is_none()).map(distant).collect();
    Coverage {
        free_places: space.places.len(),
        surfaces_by_solid_angle: Covered::of(&surfaces, sphere),
        surfaces_by_area: surfaces_by_area(view, &looker),
        distant: Covered::of(&distant, sphere),
    }
}

/// Places on the fronts of all triangles, and on the backs of double-sided ones, that look into free space.
fn surfaces_by_area(view: &CoverageView, looker: &Looker) -> Covered {
    let Some(surfaces) = view.path.surfaces() else { return Covered::of(&[], 0.0) };
    let mut sides = Vec::new();
    let mut cumulative = Vec::new();
    let mut whole = 0.0;
    for triangle in 0..surfaces.len() as u32 {
        let [a, b, c] = *surfaces.corners(triangle);
        let area = f64::from(0.5 * (b - a).cross(c - a).length()) / view.path.frame().scale.powi(2);
        for back in [false, true] {
            if !view.path.is_inside(&surfaces.point(triangle, Vec2::splat(1.0 / 3.0), back)) {
                whole += area;
                cumulative.push(whole);
                sides.push((triangle, back));
            }
        }
    }
    let stream = Stream::new(Sampler::Sobol, 0, streams::COVERAGE, 0);
    let look = |sample: u32| {
        let ([a, b], [c, _]) = (stream.point(sample, 0), stream.point(sample, 1));
        let side = cumulative.partition_point(|sum| *sum <= f64::from(a) * whole).min(sides.len() - 1);
        let (triangle, back) = sides[side];
        let root = f64::from(b).sqrt() as f32;
        let point = surfaces.point(triangle, Vec2::new(1.0 - root, c * root), back);
        looker.is_free(surfaces.leave(&point), u64::from(sample)).then(|| view.pixel_size(&point))
    };
    let sizes: Vec<Option<f32>> = (0..SURFACE_PLACES).into_par_iter().filter_map(look).collect();
    Covered::of(&sizes, whole / f64::from(SURFACE_PLACES))
}

impl Covered {
    /// `unit`: what one of the sizes stands for; `None` is not seen.
    fn of(sizes: &[Option<f32>], unit: f64) -> Covered {
        let mut seen: Vec<f32> = sizes.iter().filter_map(|size| *size).collect();
        seen.sort_by(f32::total_cmp);
        let percentile = |share: f64| f64::from(seen[((seen.len() - 1) as f64 * share).round() as usize]);
        Covered {
            whole: sizes.len() as f64 * unit,
            share: if sizes.is_empty() { 1.0 } else { seen.len() as f64 / sizes.len() as f64 },
            pixel_size: (!seen.is_empty()).then(|| PixelSize {
                p5: percentile(0.05),
                median: percentile(0.5),
                p95: percentile(0.95),
            }),
        }
    }
}
