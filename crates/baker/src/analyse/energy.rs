//! Where the light of a level goes: what is sent out is absorbed or escapes. A check of path tracing that needs no other
//! renderer.
//!
//! ```text
//!     ∫_A L_e π dA  =  ∫_A (1 - ρ) E dA  +  ∫_sphere ∫ L cosθ dω dA        (both sides of every surface)
//!      emitted            absorbed               escaped, through a sphere around the level
//! ```
//! The left and the right are found by unlike means: emission from the materials, the rest by paths.

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;
use std::f64::consts::PI;

use crate::bake::propose_on_surface;
use crate::radiance::path::{Path, PathSettings};
use crate::radiance::{PathContext, RadianceFunction};
use crate::sampling::{Sampler, Stream, streams, uniform_sphere};
use crate::scene::Scene;
use crate::trace::{Frame, Surfaces};
use crate::{Control, Interrupted};

/// Power of linear R, G and B, in the units of radiance × m² × sr.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EnergyBalance {
    /// Sent out by emissive surfaces.
    pub emitted: DVec3,
    /// Kept by surfaces.
    pub absorbed: DVec3,
    /// Gone for good.
    pub escaped: DVec3,
    /// One standard error of what is absorbed and escaped, both together.
    pub standard_error: DVec3,
}

impl EnergyBalance {
    /// What is absorbed and escapes over what is sent out, less one, summed over the channels.
    pub fn imbalance(&self) -> f64 {
        (self.absorbed + self.escaped).element_sum() / self.emitted.element_sum() - 1.0
    }
}

/// Balances a level of emissive surfaces under no sky, without punctual lights and partly clear surfaces. One ray from
/// each of `places` places on surfaces, and as many on the sphere.
pub fn energy_balance(
    scene: &Scene,
    settings: PathSettings,
    places: u32,
    control: &Control,
) -> Result<EnergyBalance, Interrupted> {
    let path = Path::new(scene, None, settings);
    let frame = Frame::of_scene(scene);
    let Some(surfaces) = Surfaces::new(scene, |_| true, &frame) else { return Ok(EnergyBalance::default()) };
    // Emission, summed.
    let area = |triangle: u32| {
        let [a, b, c] = *surfaces.corners(triangle);
        f64::from(0.5 * (b - a).cross(c - a).length()) / frame.scale.powi(2)
    };
    let middle = Vec2::splat(1.0 / 3.0);
    let mut balance = EnergyBalance::default();
    let mut cumulative = Vec::with_capacity(surfaces.len());
    let mut whole = 0.0;
    for triangle in 0..surfaces.len() as u32 {
        for back in [false, true] {
            let emission = surfaces.emission(scene, &surfaces.point(triangle, middle, back));
            balance.emitted += emission.as_dvec3() * area(triangle) * PI;
        }
        whole += area(triangle);
        cumulative.push(whole);
    }
    // Absorption, at places drawn by area, on either side.
    let stream = Stream::new(Sampler::Sobol, 0, streams::ENERGY, 0);
    let kept = one_ray_each(&path, places, control, |sample| {
        let ([a, b], [c, d]) = (stream.point(sample, 0), stream.point(sample, 1));
        let at = f64::from(a) * whole;
        let triangle = cumulative.partition_point(|&sum| sum <= at).min(surfaces.len() - 1);
        let root = f64::from(b).sqrt() as f32;
        let hit = surfaces.point(triangle as u32, Vec2::new(1.0 - root, c * root), d < 0.5);
        (surfaces.leave(&hit), hit.normal, Vec3::ONE - surfaces.albedo(scene, &hit))
    })?;
    let (absorbed, absorbed_variance) = mean_and_variance(&kept);
    balance.absorbed = absorbed * (2.0 * whole);
    // Escape, through a sphere that holds the level's box.
    let radius = 1.01 * frame.half.length();
    let gone = one_ray_each(&path, places, control, |sample| {
        let outward = uniform_sphere(stream.point(sample, 2));
        (outward * radius, -outward, Vec3::ONE)
    })?;
    let (escaped, escaped_variance) = mean_and_variance(&gone);
    let sphere = 4.0 * PI * (f64::from(radius) / frame.scale).powi(2);
    balance.escaped = escaped * sphere;
    let variance = absorbed_variance * (2.0 * whole).powi(2) + escaped_variance * sphere.powi(2);
    balance.standard_error = variance.map(f64::sqrt);
    Ok(balance)
}

/// `place(sample)` is where (trace space), the normal, and what share counts; the result is that share of E there, by one
/// ray: π w L with w = cosθ/(π p).
fn one_ray_each(
    path: &Path,
    places: u32,
    control: &Control,
    place: impl Fn(u32) -> (Vec3, Vec3, Vec3) + Sync,
) -> Result<Vec<DVec3>, Interrupted> {
    let rays = Stream::new(Sampler::Sobol, 0, streams::ENERGY + 1, 0);
    let one = |sample| {
        if control.cancelled() {
            return Err(Interrupted);
        }
        let (origin, normal, share) = place(sample);
        let mut context = PathContext::new(rays);
        context.sample = sample;
        let (direction, weight) = propose_on_surface(path, origin, normal, true, context.point(0));
        if weight == 0.0 {
            return Ok(DVec3::ZERO);
        }
        let light = path.radiance(origin, direction, &mut context).value * share;
        Ok(light.as_dvec3() * (PI * f64::from(weight)))
    };
    (0..places).into_par_iter().map(one).collect()
}

/// Mean, and the variance of the mean.
fn mean_and_variance(values: &[DVec3]) -> (DVec3, DVec3) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<DVec3>() / count;
    let variance = values.iter().map(|value| (value - mean) * (value - mean)).sum::<DVec3>();
    (mean, variance / (count * (count - 1.0)))
}
