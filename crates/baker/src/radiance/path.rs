//! Path tracing: the radiance function that needs no probe. Ground truth, and what captures probes.
//!
//! Rendering equation over Lambertian surfaces, L(x, ω) = L_e + albedo/π ∫ L cosθ dω, estimated by walks: at every
//! surface one direction by cosine goes on, and one ray each asks the emitters, the sky and a punctual light (next-event
//! estimation). What both the walk and a light's ray can find is weighed by the balance heuristic. Based on: Kajiya,
//! "The Rendering Equation", 1986; Veach, "Robust Monte Carlo Methods for Light Transport Simulation", 1997, ch. 9
//! and 10; Pharr, Jakob, Humphreys, "Physically Based Rendering", 4th ed., 2023, ch. 13.
//!
//! Both sides of every triangle block and reflect. Specular lobes are left out: metals reflect diffusely, or are black (see
//! [`Metals`]). What lets light through straight lets paths pass by chance, tinted; what lets it
//! through diffusely sends some on from its other side.

use glam::{Vec2, Vec3};
use std::collections::BTreeSet;
use std::sync::Arc;

use super::guide::{Distant, Guide, Receiver, Sky, bright_triangles, solid_angle_density};
use super::punctual::{Arriving, Punctual};
use super::{MOST_SURVIVAL, PathContext, Radiance, RadianceFunction, Seen};
use crate::Finding;
use crate::panorama::Drawn;
use crate::sampling::{Sampler, Stream, cosine_hemisphere, streams};
use crate::scene::{Material, Metals, Role, Scene};
use crate::trace::{Frame, Hit, Level, MAX_LAYERS, Surfaces, Trees};

/// How paths are traced.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PathSettings {
    /// Surfaces that light may leave on its way, the one that is seen counted: 1 is direct light. `None`: any number;
    /// roulette alone ends a walk, and no light is left out.
    pub bounces: Option<u32>,
    /// Geometry that is there: for captures the environment alone, because probes have not seen the rest.
    pub scene_geometry: bool,
}

impl Default for PathSettings {
    fn default() -> Self {
        PathSettings { bounces: None, scene_geometry: true }
    }
}

/// Where a ray first stopped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct First {
    /// `None`: it escaped.
    pub hit: Option<Hit>,
    /// What its light is multiplied by for what it passed on the way.
    pub tint: Vec3,
}

impl First {
    /// A surface that a ray met at once.
    pub fn of(hit: Hit) -> First {
        First { hit: Some(hit), tint: Vec3::ONE }
    }
}

/// From this surface on a walk may end by roulette.
const ROULETTE_FROM: u32 = 2;
/// Pairs of random numbers of one surface; those of the node or pixel come first: where to go on and where in the sky to
/// look, toward which emitter, roulette and punctual light.
const PAIRS: u32 = 3;

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
        Path::sharing(&Trees::default(), scene, distant, settings)
    }

    /// The same by the hierarchy of the scene that is among `trees`, where it is kept.
    pub fn sharing(trees: &Trees, scene: &'a Scene, distant: Option<&'a Distant>, settings: PathSettings) -> Path<'a> {
        let role = (!settings.scene_geometry).then_some(Role::Environment);
        Path::over(trees.surfaces(scene, role, &Frame::of_scene(scene)), scene, distant, settings)
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

    /// Surfaces that light may leave on its way; `None`: any number.
    pub fn bounces(&self) -> Option<u32> {
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
            surfaces.transmittance(self.scene, surfaces.leave(point), place, Some(point.triangle)) != Vec3::ZERO
        })
    }

    /// Where a path that starts along this ray first stops: a partly clear surface stops it with the probability of
    /// its opacity.
    pub fn meet(&self, origin: Vec3, direction: Vec3, context: &mut PathContext) -> First {
        self.nearest(origin, direction, 1, context)
    }

    /// What the surface that a ray first met sends out itself; nothing where it escaped.
    pub fn emission(&self, first: First) -> Vec3 {
        let emission = |hit: Hit| self.surfaces.as_ref().map(|surfaces| surfaces.emission(self.scene, &hit));
        first.hit.and_then(emission).unwrap_or(Vec3::ZERO) * first.tint
    }

    /// Light along a ray in the unit `direction` that first met `first`, [`Path::emission`] included.
    pub fn light(&self, direction: Vec3, first: First, context: &mut PathContext) -> Vec3 {
        self.light_by(direction, first, 0, context)
    }

    /// The same by random numbers behind the first `pairs`.
    pub(super) fn light_by(&self, direction: Vec3, first: First, pairs: u32, context: &mut PathContext) -> Vec3 {
        let mut light = Vec3::ZERO;
        let mut throughput = first.tint;
        let (mut met, mut direction) = (first.hit, direction);
        // The surface that was left, and the density of the direction there; the first ray was paid for by who sent it.
        let mut left: Option<(Receiver, f32)> = None;
        for bounce in 0.. {
            let pair = pairs + 1 + PAIRS * bounce;
            let Some(hit) = met else {
                if let Some(sky) = &self.sky {
                    let cell = sky.cell(direction);
                    let drawn = || self.guide.sky().map_or(0.0, |importance| importance.density_in(&cell));
                    let weight = left.map_or(1.0, |(_, density)| balance(density, drawn()));
                    light += throughput * sky.radiance_in(&cell) * weight;
                }
                break;
            };
            let surfaces = self.surfaces.as_ref().expect("something was hit");
            let emission = surfaces.emission(self.scene, &hit);
            if emission != Vec3::ZERO {
                let weight = left.map_or(1.0, |(left, density)| balance(density, self.drawn(&left, &hit, direction)));
                light += throughput * emission * weight;
            }
            // The last surface only glows.
            let scattered = surfaces.scatter(self.scene, &hit, || context.stream.random(context.sample, pair + 1));
            let hit = scattered.hit;
            throughput *= scattered.albedo;
            if self.settings.bounces == Some(bounce) || throughput == Vec3::ZERO {
                break;
            }
            let start = surfaces.leave(&hit);
            let [onward, to_sky] = context.points(pair);
            light += throughput * self.direct(start, hit.normal, to_sky, pair, context);
            // Roulette: what survives goes on with the weight of what does not.
            let survival = throughput.max_element().min(MOST_SURVIVAL);
            if bounce >= ROULETTE_FROM {
                if context.point(pair + 2)[0] >= survival {
                    break;
                }
                throughput /= survival;
            }
            direction = cosine_hemisphere(hit.normal, onward);
            let receiver = Receiver::surface(start, hit.normal);
            left = Some((receiver, direction.dot(hit.normal) * std::f32::consts::FRAC_1_PI));
            let next = self.nearest(start, direction, pair + PAIRS, context);
            throughput *= next.tint;
            met = next.hit;
        }
        light
    }

    /// The materials that a walk from here met, if light came by and it was taken neither by them nor by escape.
    fn endless_walk(&self, start: Hit, context: &mut PathContext) -> Option<BTreeSet<u32>> {
        let surfaces = self.surfaces.as_ref()?;
        let (mut hit, mut kept, mut is_lit) = (start, Vec3::ONE, false);
        let mut materials = BTreeSet::new();
        for bounce in 0..REFLECTIONS {
            let pair = 2 + PAIRS * bounce;
            kept *= surfaces.albedo(self.scene, &hit);
            if kept.max_element() < KEPT {
                return None;
            }
            materials.insert(surfaces.mesh(self.scene, hit.triangle).material);
            let start = surfaces.leave(&hit);
            let [onward, to_sky] = context.points(pair);
            if !is_lit && bounce < ASKED {
                is_lit = surfaces.emission(self.scene, &hit) != Vec3::ZERO
                    || self.direct(start, hit.normal, to_sky, pair, context) != Vec3::ZERO;
            }
            let direction = cosine_hemisphere(hit.normal, onward);
            hit = self.nearest(start, direction, pair + PAIRS, context).hit?;
        }
        is_lit.then_some(materials)
    }

    /// Density per steradian with which a receiver's own ray toward an emitter finds this hit.
    fn drawn(&self, receiver: &Receiver, hit: &Hit, direction: Vec3) -> f32 {
        let number = self.emitters.get(hit.triangle as usize).copied().filter(|number| *number != u32::MAX);
        let (Some(number), Some(emitters)) = (number, self.guide.emitters()) else { return 0.0 };
        solid_angle_density(emitters.density_on(number, receiver), direction * hit.t, hit.normal)
    }

    /// Light that arrives at a surface straight from lights, over π: what a white surface sends on. Next-event
    /// estimation, one ray each toward an emitter, the sky (by the point `to_sky`) and a punctual light.
    fn direct(&self, start: Vec3, normal: Vec3, to_sky: [f32; 2], pair: u32, context: &mut PathContext) -> Vec3 {
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
                    * surfaces.opacity_at(self.scene, triangle, point.barycentric, direction);
                let density = solid_angle_density(point.density, line, point.normal);
                if emission != Vec3::ZERO && density.is_finite() && density > 0.0 {
                    context.rays += 1;
                    let clear = surfaces.transmittance(self.scene, start, point.position, point.triangle);
                    sum += emission * clear * (cosine * FRAC_1_PI / (density + cosine * FRAC_1_PI));
                }
            }
        }
        if let (Some(importance), Some(sky)) = (self.guide.sky(), &self.sky) {
            let Drawn { direction, density, cell } = importance.sample(to_sky);
            let cosine = direction.dot(normal);
            if cosine > 0.0 && density > 0.0 {
                let clear = self.escaping(start, direction, context);
                if clear != Vec3::ZERO {
                    sum += sky.radiance_in(&cell) * clear * (cosine * FRAC_1_PI / (density + cosine * FRAC_1_PI));
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
        let mut left = context.point(pair + 2)[1] * total;
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
        given(&arriving) * (total / share) * self.clear_toward(start, &arriving, context)
    }

    /// Share of a punctual light that arrives, by colour.
    fn clear_toward(&self, from: Vec3, arriving: &Arriving, context: &mut PathContext) -> Vec3 {
        match (arriving.position, &self.surfaces) {
            (None, _) => self.escaping(from, arriving.direction, context),
            (Some(_), None) => Vec3::ONE,
            (Some(position), Some(surfaces)) => {
                context.rays += 1;
                surfaces.transmittance(self.scene, from, position, None)
            }
        }
    }

    fn escaping(&self, from: Vec3, direction: Vec3, context: &mut PathContext) -> Vec3 {
        let Some(surfaces) = &self.surfaces else { return Vec3::ONE };
        context.rays += 1;
        surfaces.escaping(self.scene, from, direction)
    }

    /// The nearest surface that stops the ray: a partly clear one does so with the probability of its opacity.
    fn nearest(&self, origin: Vec3, direction: Vec3, pair: u32, context: &mut PathContext) -> First {
        let mut first = First { hit: None, tint: Vec3::ONE };
        let Some(surfaces) = &self.surfaces else { return first };
        let mut passed = 0.0;
        let mut chance = None;
        for _ in 0..MAX_LAYERS {
            context.rays += 1;
            let Some(hit) = surfaces.closest(self.scene, origin, direction, passed, f32::INFINITY) else {
                return first;
            };
            if hit.opacity >= 1.0 {
                first.hit = Some(hit);
                return first;
            }
            // One number for all layers: what is left of it above the opacity is stretched again.
            let left = *chance.get_or_insert_with(|| context.stream.random(context.sample, pair));
            if left < hit.opacity {
                first.hit = Some(hit);
                return first;
            }
            chance = Some((left - hit.opacity) / (1.0 - hit.opacity));
            first.tint *= surfaces.tint(self.scene, &hit);
            passed = hit.t;
        }
        // Past so many layers the rest is lost.
        First { hit: None, tint: Vec3::ZERO }
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
        context.reach = Some(first.hit.map_or(f32::INFINITY, |hit| hit.t));
        if let (None, Some(sky)) = (first.hit, &self.sky) {
            return Radiance::covered(sky.radiance_at_node(direction) * first.tint);
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
        let (Some(hit), Some(surfaces)) = (first.hit, &self.surfaces) else {
            return Radiance::covered(self.light(direction, first, context));
        };
        let shaded = shade(&Seen { scene: self.scene, surfaces, hit: &hit, direction }, context);
        match shaded {
            Some(shaded) => Radiance { value: shaded.value * first.tint, ..shaded },
            None => {
                let first = First { hit: Some(surfaces.smooth(self.scene, hit)), ..first };
                Radiance::covered(self.light(direction, first, context))
            }
        }
    }

    fn punctual(&self, origin: Vec3, context: &mut PathContext, mut add: impl FnMut(Vec3, Vec3)) {
        for arriving in self.punctual.arriving(origin) {
            let clear = self.clear_toward(origin, &arriving, context);
            add(arriving.direction, arriving.irradiance * clear);
        }
    }
}

/// What Lambertian surfaces make of the level's metals, where it has some: `specular-left-out`, counted in materials, with
/// the share of energy where the metals' textures were read.
pub fn specular_left_out(scene: &Scene) -> Option<Finding> {
    // Reflected from white light that comes from all sides, by area: diffusely, and by metals.
    let (mut diffuse, mut specular) = (0.0, 0.0);
    let mut metals = BTreeSet::new();
    let mut unknown = 0;
    let mut kinds = [false; 2];
    let metallic: Vec<f64> = scene.materials.iter().map(|material| mean_metallic(scene, material)).collect();
    for mesh in &scene.meshes {
        let material = &scene.materials[mesh.material as usize];
        if material.unlit || material.specular_glossiness || material.base_color.truncate() == Vec3::ZERO {
            continue;
        }
        let metallic = metallic[mesh.material as usize];
        let area: f64 = mesh.triangles.iter().map(|ids| mesh.area(*ids)).sum();
        let reflected = area * f64::from(material.base_color.truncate().element_sum() / 3.0);
        diffuse += reflected * (1.0 - metallic);
        specular += reflected * metallic;
        if metallic > 0.0 && metals.insert(mesh.material) {
            unknown += usize::from(material.metallic_unknown);
            kinds[usize::from(material.metals == Metals::Black)] = true;
        }
    }
    let share = match unknown {
        0 => format!("reflect {:.0} % of", 100.0 * specular / (diffuse + specular)),
        // Most files say "metal" by factor and "no metal" by texture.
        _ => "may reflect some of".into(),
    };
    let fate = match kinds {
        [true, false] => {
            "they do so diffusely here, by the share of base colour that a metal of their roughness reflects (--metals black \
             leaves it out)"
        }
        [false, true] => "they are black here (--metals diffuse lets them reflect)",
        _ => "some of them do so diffusely here, others are black",
    };
    let unread = match unknown {
        0 => String::new(),
        n => format!(", as far as is known: the textures of {n} of them were not read"),
    };
    (!metals.is_empty()).then(|| {
        let message = format!(
            "metals, in {} materials, {share} what the level's surfaces reflect under even light (by base colour and \
             area){unread}; {fate}; specular lobes are left out, and so is the gloss of other surfaces, about 4 % of what \
             meets them",
            metals.len()
        );
        Finding::new("specular-left-out", metals.len() as u64, message)
    })
}

/// The mean over its texture.
fn mean_metallic(scene: &Scene, material: &Material) -> f64 {
    let map = material.metallic_map.map_or(1.0, |map| scene.maps[map.texture as usize].mean());
    f64::from(material.metallic) * map
}

/// Walks that look for light without end, how often each is reflected, and the least share of its light that it must keep.
const WALKS: u32 = 64;
const REFLECTIONS: u32 = 1024;
const KEPT: f32 = 0.9;
/// Of the first so many surfaces each walk asks whether they are lit.
const ASKED: u32 = 32;

/// Lit places where light is reflected on and on, because no surface takes any of it and it does not escape:
/// `light-without-end`, counted in walks of 64, with the materials. What is baked there is noise: the sum of the light has no
/// end. Nothing is traced unless some material is as good as white.
pub fn light_without_end(scene: &Scene, path: &Path) -> Option<Finding> {
    let surfaces = path.surfaces.as_ref()?;
    let takes_nothing = |material: &Material| {
        !material.unlit && material.base_color.truncate().max_element() * (1.0 - material.metallic) > 0.9999
    };
    scene.meshes.iter().find(|mesh| takes_nothing(&scene.materials[mesh.material as usize]))?;
    let mut whole = 0.0;
    let area = |triangle: u32| {
        let [a, b, c] = surfaces.corners(triangle);
        whole += f64::from((*b - *a).cross(*c - *a).length());
        whole
    };
    let cumulative: Vec<f64> = (0..surfaces.len() as u32).map(area).collect();
    let mut context = PathContext::new(Stream::new(Sampler::Sobol, 0, streams::ENDLESS, 0));
    let mut count = 0;
    let mut names = BTreeSet::new();
    for walk in 0..WALKS {
        context.sample = walk;
        let ([a, b], [c, _]) = (context.point(0), context.point(1));
        let triangle = cumulative.partition_point(|sum| *sum <= f64::from(a) * whole).min(surfaces.len() - 1);
        let place = Vec2::new(1.0 - b.sqrt(), c * b.sqrt());
        if let Some(materials) = path.endless_walk(surfaces.point(triangle as u32, place, false), &mut context) {
            count += 1;
            names.extend(materials.iter().map(|material| scene.materials[*material as usize].name.as_str()));
        }
    }
    (count > 0).then(|| {
        let names: Vec<String> = names.into_iter().take(3).map(|name| format!("\"{name}\"")).collect();
        let message = format!(
            "of {WALKS} walks through the level, {count} kept {} % of their light over {REFLECTIONS} reflections: surfaces of \
             albedo 1 all around take none, so the sum of the light there has no end, and what is baked is noise (materials {}); \
             give them a base colour under 1: white paint has 0.8",
            KEPT * 100.0,
            names.join(", ")
        );
        Finding::new("light-without-end", count, message)
    })
}

/// Weight of light that the walk found with density `walk`, and a light's own ray could have found with `drawn`.
fn balance(walk: f32, drawn: f32) -> f32 {
    walk / (walk + drawn)
}
