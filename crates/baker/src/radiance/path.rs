//! Path tracing: the radiance function that needs no probe. Ground truth, and what captures probes.
//!
//! Rendering equation over Lambertian surfaces, L(x, ω) = L_e + albedo/π ∫ L cosθ dω, estimated by walks: at every
//! surface one direction by cosine goes on, and one ray each asks the emitters, the sky and a punctual light (next-event
//! estimation). What both the walk and a light's ray can find is weighed by the balance heuristic. Based on: Kajiya,
//! "The Rendering Equation", 1986; Veach, "Robust Monte Carlo Methods for Light Transport Simulation", 1997, ch. 9
//! and 10; Pharr, Jakob, Humphreys, "Physically Based Rendering", 4th ed., 2023, ch. 13.
//!
//! Both sides of every triangle block and reflect. Specular lobes are left out: metals are black.

use glam::Vec3;
use std::sync::Arc;

use super::emitters::{Receiver, bright_triangles, solid_angle_density};
use super::guide::Guide;
use super::punctual::{Arriving, Punctual};
use super::sky::{Distant, Sky};
use super::{PathContext, Radiance, RadianceFunction, Seen};
use crate::Finding;
use crate::sampling::cosine_hemisphere;
use crate::scene::{Role, Scene};
use crate::trace::{Frame, Hit, Level, MAX_LAYERS, Surfaces};

/// How paths are traced.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PathSettings {
    /// Surfaces that light may leave on its way, the one that is seen counted: 1 is direct light. At most
    /// [`PathSettings::MAX_BOUNCES`].
    pub bounces: u32,
    /// Geometry that is there: for captures the environment alone, because probes have not seen the rest.
    pub scene_geometry: bool,
}

impl PathSettings {
    /// The most bounces.
    pub const MAX_BOUNCES: u32 = 4096;
}

impl Default for PathSettings {
    fn default() -> Self {
        PathSettings { bounces: 64, scene_geometry: true }
    }
}

/// From this surface on a walk may end by roulette.
const ROULETTE_FROM: u32 = 2;
/// Pairs of random numbers of one surface; those of the node or pixel come first.
const PAIRS: u32 = 4;

/// The function, ready to be called from any thread.
#[derive(Debug)]
pub struct Path<'a> {
    scene: &'a Scene,
    frame: Frame,
    surfaces: Option<Arc<Surfaces>>,
    sky: Option<Sky<'a>>,
    guide: Guide,
    /// Which emitter each triangle is; `u32::MAX`: none that is drawn.
    emitters: Vec<u32>,
    punctual: Punctual,
    settings: PathSettings,
}

impl<'a> Path<'a> {
    /// Builds the hierarchy. `scene` must have been read with
    /// [`TextureNeeds::All`](crate::import::gltf::TextureNeeds::All).
    pub fn new(scene: &'a Scene, distant: Option<&'a Distant>, settings: PathSettings) -> Path<'a> {
        assert!(settings.bounces <= PathSettings::MAX_BOUNCES, "bounces {}", settings.bounces);
        let frame = Frame::of_scene(scene);
        let surfaces = Surfaces::new(scene, |mesh| settings.scene_geometry || mesh.role == Role::Environment, &frame);
        Path::over(surfaces.map(Arc::new), scene, distant, settings)
    }

    /// Over surfaces of the scene that are there already, in the frame of all of it.
    pub(super) fn over(
        surfaces: Option<Arc<Surfaces>>,
        scene: &'a Scene,
        distant: Option<&'a Distant>,
        settings: PathSettings,
    ) -> Path<'a> {
        let frame = Frame::of_scene(scene);
        let bright =
            surfaces.as_deref().into_iter().flat_map(|surfaces| bright_triangles(scene, &[surfaces])).flatten();
        let guide = Guide::new(distant, bright.collect());
        let emitters = match (guide.emitters(), &surfaces) {
            (Some(emitters), Some(surfaces)) => emitters.numbers(surfaces),
            _ => Vec::new(),
        };
        Path {
            scene,
            frame,
            surfaces,
            sky: distant.map(Sky::new),
            guide,
            emitters,
            punctual: Punctual::new(scene, &frame),
            settings,
        }
    }

    /// Surfaces that light may leave on its way.
    pub fn bounces(&self) -> u32 {
        self.settings.bounces
    }

    /// What is traced.
    pub(crate) fn surfaces(&self) -> Option<&Surfaces> {
        self.surfaces.as_deref()
    }

    /// The nearest surface along a ray (trace space) that shows itself: what lets half through or more does not.
    pub fn surface(&self, origin: Vec3, direction: Vec3) -> Option<Hit> {
        self.surfaces.as_ref()?.shown(self.scene, origin, direction, f32::INFINITY)
    }

    /// The hit is on the back of a single-sided triangle: who sees it stands in a solid, or outside of the level.
    pub fn is_inside(&self, hit: &Hit) -> bool {
        let material = |surfaces: &Surfaces| surfaces.material(self.scene, hit.triangle).double_sided;
        hit.back && !self.surfaces.as_deref().is_some_and(material)
    }

    /// Something of the light that leaves a surface point reaches `place` (trace space).
    pub fn sees(&self, point: &Hit, place: Vec3) -> bool {
        self.surfaces.as_ref().is_none_or(|surfaces| {
            surfaces.transmittance(self.scene, surfaces.leave(point), place, Some(point.triangle)) > 0.0
        })
    }

    /// Where a path that starts along this ray first stops: a partly clear surface stops it with the probability of
    /// its opacity. `None`: it escapes.
    pub fn meet(&self, origin: Vec3, direction: Vec3, context: &mut PathContext) -> Option<Hit> {
        self.nearest(origin, direction, 1, context)
    }

    /// What the surface that a ray first met sends out itself; nothing where it escaped.
    pub fn emission(&self, first: Option<Hit>) -> Vec3 {
        let emission = |hit: Hit| self.surfaces.as_ref().map(|surfaces| surfaces.emission(self.scene, &hit));
        first.and_then(emission).unwrap_or(Vec3::ZERO)
    }

    /// Light along a ray in the unit `direction` that first met `first`, [`Path::emission`] included.
    pub fn light(&self, direction: Vec3, first: Option<Hit>, context: &mut PathContext) -> Vec3 {
        self.light_by(direction, first, 0, context)
    }

    /// The same by random numbers behind the first `pairs`.
    pub(super) fn light_by(&self, direction: Vec3, first: Option<Hit>, pairs: u32, context: &mut PathContext) -> Vec3 {
        let mut light = Vec3::ZERO;
        let mut throughput = Vec3::ONE;
        let (mut met, mut direction) = (first, direction);
        // The surface that was left, and the density of the direction there; the first ray was paid for by who sent it.
        let mut left: Option<(Receiver, f32)> = None;
        for bounce in 0..=self.settings.bounces {
            let pair = pairs + 1 + PAIRS * bounce;
            let Some(hit) = met else {
                let sky = self.sky.as_ref().map_or(Vec3::ZERO, |sky| sky.radiance(direction));
                let drawn = || self.guide.sky().map_or(0.0, |sky| sky.density(direction));
                light += throughput * sky * left.map_or(1.0, |(_, density)| balance(density, drawn()));
                break;
            };
            let surfaces = self.surfaces.as_ref().expect("something was hit");
            let emission = surfaces.emission(self.scene, &hit);
            if emission != Vec3::ZERO {
                let weight = left.map_or(1.0, |(left, density)| balance(density, self.drawn(&left, &hit, direction)));
                light += throughput * emission * weight;
            }
            // The last surface only glows.
            throughput *= surfaces.albedo(self.scene, &hit);
            if bounce == self.settings.bounces || throughput == Vec3::ZERO {
                break;
            }
            let start = surfaces.leave(&hit);
            light += throughput * self.direct(start, hit.normal, pair, context);
            // Roulette: what survives goes on with the weight of what does not.
            let survival = throughput.max_element().min(1.0);
            if bounce >= ROULETTE_FROM {
                if context.point(pair + 3)[0] >= survival {
                    break;
                }
                throughput /= survival;
            }
            direction = cosine_hemisphere(hit.normal, context.point(pair));
            let receiver = Receiver::surface(start, hit.normal);
            left = Some((receiver, direction.dot(hit.normal) * std::f32::consts::FRAC_1_PI));
            met = self.nearest(start, direction, pair + PAIRS, context);
        }
        light
    }

    /// Density per steradian with which a receiver's own ray toward an emitter finds this hit.
    fn drawn(&self, receiver: &Receiver, hit: &Hit, direction: Vec3) -> f32 {
        let number = self.emitters.get(hit.triangle as usize).copied().filter(|number| *number != u32::MAX);
        let (Some(number), Some(emitters)) = (number, self.guide.emitters()) else { return 0.0 };
        solid_angle_density(emitters.density_on(number, receiver), direction * hit.t, hit.normal)
    }

    /// Light that arrives at a surface straight from lights, over π: what a white surface sends on. Next-event
    /// estimation, one ray each toward an emitter, the sky and a punctual light.
    fn direct(&self, start: Vec3, normal: Vec3, pair: u32, context: &mut PathContext) -> Vec3 {
        const FRAC_1_PI: f32 = std::f32::consts::FRAC_1_PI;
        let mut sum = Vec3::ZERO;
        if let (Some(emitters), Some(surfaces)) = (self.guide.emitters(), &self.surfaces) {
            let receiver = Receiver::surface(start, normal);
            let drawn = emitters.draw(&receiver, context.point(pair + 1));
            let line = drawn.map_or(Vec3::ZERO, |point| point.position - start);
            let direction = line.normalize_or_zero();
            let cosine = direction.dot(normal);
            if let Some(point) = drawn.filter(|_| cosine > 0.0) {
                let back = direction.dot(point.normal) > 0.0;
                let triangle = point.triangle.expect("without probes there are no regions");
                let place = surfaces.point(triangle, point.barycentric, back);
                let emission = surfaces.emission(self.scene, &place)
                    * surfaces.opacity_at(self.scene, triangle, point.barycentric);
                let density = solid_angle_density(point.density, line, point.normal);
                if emission != Vec3::ZERO && density.is_finite() && density > 0.0 {
                    context.rays += 1;
                    let clear = surfaces.transmittance(self.scene, start, point.position, point.triangle);
                    sum += emission * (clear * cosine * FRAC_1_PI / (density + cosine * FRAC_1_PI));
                }
            }
        }
        if let (Some(importance), Some(sky)) = (self.guide.sky(), &self.sky) {
            let (direction, density) = importance.sample(context.point(pair + 2));
            let cosine = direction.dot(normal);
            if cosine > 0.0 && density > 0.0 {
                let clear = self.escaping(start, direction, context);
                if clear > 0.0 {
                    sum += sky.radiance(direction) * (clear * cosine * FRAC_1_PI / (density + cosine * FRAC_1_PI));
                }
            }
        }
        sum + self.direct_punctual(start, normal, pair, context) * FRAC_1_PI
    }

    /// Irradiance by punctual lights: one of them, drawn by what it would give unhidden.
    fn direct_punctual(&self, start: Vec3, normal: Vec3, pair: u32, context: &mut PathContext) -> Vec3 {
        let given = |arriving: &Arriving| arriving.irradiance * arriving.direction.dot(normal).max(0.0);
        let total: f32 = self.punctual.arriving(start).map(|arriving| given(&arriving).element_sum()).sum();
        if total <= 0.0 {
            return Vec3::ZERO;
        }
        let mut left = context.point(pair + 3)[1] * total;
        let mut chosen = None;
        for arriving in self.punctual.arriving(start) {
            let share = given(&arriving).element_sum();
            if share > 0.0 {
                chosen = Some((arriving, share));
                left -= share;
                if left < 0.0 {
                    break;
                }
            }
        }
        let Some((arriving, share)) = chosen else { return Vec3::ZERO };
        given(&arriving) * (total / share * self.clear_toward(start, &arriving, context))
    }

    /// Share of a punctual light that arrives.
    fn clear_toward(&self, from: Vec3, arriving: &Arriving, context: &mut PathContext) -> f32 {
        match (arriving.position, &self.surfaces) {
            (None, _) => self.escaping(from, arriving.direction, context),
            (Some(_), None) => 1.0,
            (Some(position), Some(surfaces)) => {
                context.rays += 1;
                surfaces.transmittance(self.scene, from, position, None)
            }
        }
    }

    fn escaping(&self, from: Vec3, direction: Vec3, context: &mut PathContext) -> f32 {
        let Some(surfaces) = &self.surfaces else { return 1.0 };
        context.rays += 1;
        surfaces.escaping(self.scene, from, direction)
    }

    /// The nearest surface that stops the ray: a partly clear one does so with the probability of its opacity.
    fn nearest(&self, origin: Vec3, direction: Vec3, pair: u32, context: &mut PathContext) -> Option<Hit> {
        let surfaces = self.surfaces.as_ref()?;
        let mut passed = 0.0;
        let mut chance = None;
        for _ in 0..MAX_LAYERS {
            context.rays += 1;
            let hit = surfaces.closest(self.scene, origin, direction, passed, f32::INFINITY)?;
            if hit.opacity >= 1.0 {
                return Some(hit);
            }
            // One number for all layers: what is left of it above the opacity is stretched again.
            let left = *chance.get_or_insert_with(|| context.stream.random(context.sample, pair));
            if left < hit.opacity {
                return Some(hit);
            }
            chance = Some((left - hit.opacity) / (1.0 - hit.opacity));
            passed = hit.t;
        }
        None
    }
}

impl RadianceFunction for Path<'_> {
    fn frame(&self) -> &Frame {
        &self.frame
    }

    fn level(&self) -> Level<'_> {
        Level::new(self.scene, [self.surfaces.as_deref(), None])
    }

    fn guide(&self) -> &Guide {
        &self.guide
    }

    fn radiance(&self, origin: Vec3, direction: Vec3, context: &mut PathContext) -> Radiance {
        let first = self.meet(origin, direction, context);
        context.reach = Some(first.map_or(f32::INFINITY, |hit| hit.t));
        if let (None, Some(sky)) = (first, &self.sky) {
            return Radiance::covered(sky.radiance_at_node(direction));
        }
        Radiance::covered(self.light(direction, first, context))
    }

    fn look(
        &self,
        origin: Vec3,
        direction: Vec3,
        context: &mut PathContext,
        shade: impl Fn(&Seen, &mut PathContext) -> Option<Radiance>,
    ) -> Radiance {
        let first = self.meet(origin, direction, context);
        let (Some(hit), Some(surfaces)) = (first, &self.surfaces) else {
            return Radiance::covered(self.light(direction, first, context));
        };
        let shaded = shade(&Seen { scene: self.scene, surfaces, hit: &hit, direction }, context);
        shaded.unwrap_or_else(|| {
            let first = surfaces.smooth(self.scene, hit);
            Radiance::covered(self.light(direction, Some(first), context))
        })
    }

    fn punctual(&self, origin: Vec3, context: &mut PathContext, mut add: impl FnMut(Vec3, Vec3)) {
        for arriving in self.punctual.arriving(origin) {
            let clear = self.clear_toward(origin, &arriving, context);
            add(arriving.direction, arriving.irradiance * clear);
        }
    }
}

/// What Lambertian surfaces leave out of the level's light, where it has metals: `specular-left-out`, counted in
/// materials, with the share of energy.
pub fn specular_left_out(scene: &Scene) -> Option<Finding> {
    // Reflected from white light that comes from all sides, by area: diffusely, and by metals.
    let (mut diffuse, mut specular) = (0.0, 0.0);
    let mut metals = std::collections::BTreeSet::new();
    for mesh in &scene.meshes {
        let material = &scene.materials[mesh.material as usize];
        if material.unlit || material.base_color.truncate() == Vec3::ZERO {
            continue;
        }
        let area: f64 = mesh.triangles.iter().map(|ids| mesh.area(*ids)).sum();
        let reflected = area * f64::from(material.base_color.truncate().element_sum() / 3.0);
        diffuse += reflected * f64::from(1.0 - material.metallic);
        specular += reflected * f64::from(material.metallic);
        if material.metallic > 0.0 {
            metals.insert(mesh.material);
        }
    }
    let share = 100.0 * specular / (diffuse + specular);
    (!metals.is_empty()).then(|| {
        let message = format!(
            "metals, in {} materials, reflect {share:.0} % of what the level's surfaces reflect under even light (by base \
             colour and area); they are black here: specular lobes are left out, and so is the gloss of other surfaces, \
             about 4 % of what meets them",
            metals.len()
        );
        Finding::new("specular-left-out", metals.len() as u64, message)
    })
}

/// Weight of light that the walk found with density `walk`, and a light's own ray could have found with `drawn`.
fn balance(walk: f32, drawn: f32) -> f32 {
    walk / (walk + drawn)
}
