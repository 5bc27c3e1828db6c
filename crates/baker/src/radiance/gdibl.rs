//! GDIBL's radiance function: trace, then ask the probes that see the hit.
//!
//! Based on: K. Vestergaard, "Geometrically Derived Image Based Lighting", Aalborg University, 2008, Algorithm 1.
//! Departures, each with its reason: blend rules (see [`blend`](super::blend)); lines of sight start a few ulps off
//! the surface instead of a share of the ray's length (that made thin walls leak); partly clear surfaces divide a
//! ray; uncovered directions are filled by the integrator, so that the result does not depend on the order of rays.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::f32::consts::FRAC_1_PI;
use std::sync::Arc;

use super::blend::{BlendRule, View};
use super::candidates::{Candidate, Lookers, pixel_size};
use super::effects::{EffectCache, Filled, PARTS, Texel};
use super::guide::{Distant, Emitter, Emitters, Guide, Receiver, Regions, Sky, bright_regions, bright_triangles};
use super::lamps::Lamps;
use super::path::{First, Path, PathSettings};
use super::probe::{PlacedProbe, Surroundings};
use super::punctual::Punctual;
use super::surface_light::SurfaceLight;
use super::unseen::{Agreement, Compared, Unseen, UnseenChoice, curve_of};
use super::{Audit, FOUND_TEXEL, PathContext, Radiance, RadianceFunction, Seen, number_of_place};
use crate::bake::pass::Pass;
use crate::blocks::{Blocks, Found, PassKind};
use crate::sampling::{Sampler, Stream, cosine_hemisphere, streams, uniform_sphere};
use crate::scene::{Role, Scene};
use crate::trace::{Frame, Hit, Level, MAX_LAYERS, Scattered, Surfaces, Trees, counts_before, search_limit};

pub use super::probe::Probe;

/// What a ray does at scene geometry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SceneHit {
    /// One continuation ray per hit, at most this many in a row; then uncovered.
    Recurse(u32),
    /// Black: the report's listing. Backs of single-sided triangles (the inside of a solid) are uncovered.
    Occlude,
}

impl Default for SceneHit {
    fn default() -> Self {
        SceneHit::Recurse(3)
    }
}

impl std::fmt::Display for SceneHit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            SceneHit::Recurse(depth) => write!(f, "recurse:{depth}"),
            SceneHit::Occlude => f.write_str("occlude"),
        }
    }
}

impl std::str::FromStr for SceneHit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(':') {
            None if text == "occlude" => Ok(SceneHit::Occlude),
            None if text == "recurse" => Ok(SceneHit::default()),
            // Deeper than this, what is left of the light is under a millionth even at albedo 0.8.
            Some(("recurse", depth)) => match depth.parse() {
                Ok(depth @ 0..=64) => Ok(SceneHit::Recurse(depth)),
                _ => Err("the depth of recurse:DEPTH must be 0 to 64".into()),
            },
            _ => Err("expected recurse:DEPTH or occlude".into()),
        }
    }
}

/// How the radiance function works.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GdiblSettings {
    /// How probes that see a point share it.
    pub blend: BlendRule,
    /// What rays do at scene geometry.
    pub scene_hit: SceneHit,
    /// The probes show reflected light alone (see [`crate::capture::CaptureSettings::emission`]): what environment
    /// surfaces send out themselves is taken from their materials, sharp and exact.
    pub emission_from_materials: bool,
    /// Random walks that find what scene geometry does to the environment, per texel of a thirtieth of the level; where a node
    /// stands near, twice as many more.
    pub walks: u32,
    /// Of the random walks that find what scene geometry does to the environment; the bake's.
    pub seed: u64,
    /// Directions that will leave nodes, all together, about: what they ask for again and again is remembered. 0: nothing is.
    pub directions: u64,
    /// A probe counts where its pixel covers a square of at most this edge on the surface, metres; about the spacing of nodes,
    /// which tell no more. Infinity: it counts wherever it sees.
    pub coarsest: f32,
}

impl Default for GdiblSettings {
    fn default() -> Self {
        GdiblSettings {
            blend: BlendRule::default(),
            scene_hit: SceneHit::default(),
            emission_from_materials: false,
            walks: 64,
            seed: 0,
            directions: 0,
            coarsest: f32::INFINITY,
        }
    }
}

impl GdiblSettings {
    /// Walks per texel beside so many directions per node. Interior nodes see hundreds of texels, whose noise averages out;
    /// nodes on walls see few, and more directions bring nothing without more walks.
    pub fn walks_beside(samples: u64) -> u32 {
        (samples / 64).clamp(64, 1024) as u32
    }
}

/// A ray that has lost all but this share is not followed further.
const CLEAR_ENOUGH: f32 = 1.0 / 1024.0;

/// Where a path of a sample stands.
#[derive(Debug, Clone, Copy, Default)]
struct Walk {
    /// Continuation rays so far: each has its own pair of random numbers.
    step: u32,
    /// Scene geometry hit so far, in a row.
    objects: u32,
    /// Which texels of effects it may read.
    texels: Texels,
    source: Source,
}

/// Where the light of environment geometry comes from.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
enum Source {
    /// Probes, and what stands in for them.
    #[default]
    Probes,
    /// Paths everywhere: an audit.
    Paths,
    /// Probes without this one: an audit.
    Without(u32),
}

/// Texels of effects that a walk may read.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum Texels {
    /// Those of far places, and of near ones where it has just left its node.
    #[default]
    All,
    /// Those of far places: it fills one of a near place.
    Far,
    /// None: it fills one of a far place, which may be among them.
    None,
}

/// Pairs of random numbers of one continuation ray; those of the node or pixel come first.
const PAIRS: u32 = 4;
/// Which of them chooses the direction by cosine, ends the walk, chooses a direction toward what is bright, and one toward
/// scene geometry.
const BY_COSINE: u32 = 0;
const ROULETTE: u32 = 1;
const TO_BRIGHT: u32 = 2;
const TO_OBJECTS: u32 = 3;
/// Which random number of its own chooses a side of what lets light through diffusely.
const SIDE: u32 = 0;
/// Random numbers of paths where no probe counts come after those of the walks before them, so many for each step.
const PATHS: u32 = 256;
const PAIRS_PER_PATH: u32 = 1024;

/// Places of nodes, and rays that leave them, which find surfaces where probes and paths are compared.
const LOOKS: u32 = 2048;
/// Light past all surfaces is none if it is less than this share of what surfaces show.
const DARK: f32 = 1e-3;
/// A larger gain than this says that the materials are not the probes'. It may hold for what reflects and not for what glows, so
/// lamps are not traced then: a room whose albedo was 0.5 instead of 0.7 had lamps of twice their light.
const LAMP_GAIN: f32 = 1.25;
/// Surface points at most, and paths of each: so many that all are a 64th of the bake's directions, within these.
const MOST_POINTS: usize = 1024;
const PATHS_PER_POINT: [u64; 2] = [6, 96];

/// No walk that looks for effects of objects goes on with a greater probability. Objects on its way begin further walks: between walls
/// of albedo 1 with that of paths a room of 300 nodes took minutes.
const EFFECT_SURVIVAL: f32 = 0.9;
/// Share of the rays from an object to a wall that look for other objects' effects there.
const SECOND: f32 = 0.25;
/// Triangles of scene geometry toward which directions are drawn, at most: they are kept a second time.
const MOST_DRAWN: usize = 1 << 18;

impl Walk {
    /// Random numbers of the ray that the walk goes on with.
    fn point(&self, which: u32, context: &PathContext) -> [f32; 2] {
        context.point(PAIRS * self.step + which)
    }
}

/// The function, ready to be called from any thread.
#[derive(Debug)]
pub struct Gdibl<'a> {
    scene: &'a Scene,
    frame: Frame,
    environment: Option<Arc<Surfaces>>,
    objects: Option<Arc<Surfaces>>,
    trees: Trees,
    /// Trace units; see [`GdiblSettings::coarsest`].
    coarsest: f32,
    distant: Option<&'a Distant>,
    unseen: UnseenChoice,
    /// `None`: where no probe counts nothing is known.
    tracer: Option<Tracer<'a>>,
    probes: &'a [Probe],
    placed: Vec<PlacedProbe>,
    /// All probes, and whether each sees all of the environment whole, as far as that can be proven.
    all: Vec<Candidate>,
    region_count: usize,
    sky: Option<Sky<'a>>,
    guide: Guide,
    punctual: Punctual,
    settings: GdiblSettings,
    effects: Option<EffectCache>,
    /// Scene geometry that rays go to from walls; `None` where there is none, or too much.
    targets: Option<Emitters>,
    /// `None` where no ray will ask.
    surface_light: Option<SurfaceLight>,
    /// What glows, where it is traced and not asked of probes.
    lamps: Option<Lamps>,
}

/// Points in a row that are compared with paths together.
const COMPARED_TOGETHER: usize = 16;
/// Texels of effects that are kept together: 4 MB.
const TEXELS_TOGETHER: usize = 1 << 16;
/// Effects are looked for by a ray for so many that nodes will send, and by so many at most: a texel of a room is met by some 20.
const DIRECTIONS_PER_LOOK: u64 = 128;
const MOST_LOOKS: u64 = 1 << 16;

/// Paths for where no probe counts.
#[derive(Debug)]
struct Tracer<'a> {
    path: Path<'a>,
    /// Brings light to the probes' scale.
    gain: Vec3,
    /// No probe shows light past all surfaces, and there is no distant panorama: what escapes is black.
    dark_outside: bool,
    /// Of triangles of environment and of scene geometry, among all; `None` where there is environment alone.
    numbers: Option<[Vec<u32>; 2]>,
}

/// What a ray meets.
enum Met {
    Object(Hit),
    Environment(Hit),
    Nothing,
}

/// What scene geometry changes in the light along a ray that leaves the environment.
enum Change {
    /// Light with the object less light without it, and the share of the ray that it changes, 0..=1.
    Object { difference: Vec3, share: f32 },
    /// Nothing; the ray meets the environment here.
    Behind(Hit),
    /// Nothing; the ray escapes.
    None,
}

impl<'a> Gdibl<'a> {
    /// Builds the hierarchies. `scene` must outlive the function; its non-finite triangles are already dropped.
    pub fn new(
        scene: &'a Scene,
        probes: &'a [Probe],
        distant: Option<&'a Distant>,
        settings: GdiblSettings,
    ) -> Gdibl<'a> {
        Gdibl::sharing(&Trees::default(), scene, probes, distant, settings)
    }

    /// The same by the hierarchies of the scene that are among `trees`, where they are kept.
    pub fn sharing(
        trees: &Trees,
        scene: &'a Scene,
        probes: &'a [Probe],
        distant: Option<&'a Distant>,
        settings: GdiblSettings,
    ) -> Gdibl<'a> {
        let frame = Frame::of_scene(scene);
        let placed: Vec<PlacedProbe> = probes.iter().map(|probe| PlacedProbe::new(probe, &frame)).collect();
        let [environment, objects] =
            [Role::Environment, Role::Scene].map(|role| trees.surfaces(scene, Some(role), &frame));
        let coarsest = (f64::from(settings.coarsest) * frame.scale) as f32;
        let positions: Vec<Vec3> = placed.iter().map(|probe| probe.position).collect();
        let sees_all = environment.as_ref().map_or_else(Vec::new, |surfaces| surfaces.seen_whole_from(&positions));
        let all: Vec<Candidate> =
            sees_all.iter().zip(0..).map(|(&sees_all, probe)| Candidate { probe, sees_all }).collect();
        let effects = match (&environment, &objects, settings.scene_hit) {
            (Some(environment), Some(_), SceneHit::Recurse(_)) => Some(EffectCache::new(environment, settings.walks)),
            _ => None,
        };
        let targets = objects.as_ref().filter(|objects| effects.is_some() && objects.len() <= MOST_DRAWN);
        let targets = targets.and_then(|objects| Emitters::new(targets_of(scene, objects)));
        let mut emitters =
            bright_triangles(scene, &environment.as_deref().into_iter().chain(objects.as_deref()).collect::<Vec<_>>());
        let is_emissive = emitters.iter().any(|own| !own.is_empty());
        let mut regions = Regions::default();
        if let Some(environment) = &environment {
            // An emissive triangle is not drawn again by what probes show of it. Regions instead of the triangles, where the
            // light was all in the probes' pixels, had a sixth more noise in a Cornell box at 1024 directions.
            let mut drawn = vec![false; environment.len()];
            emitters[0].iter().filter_map(|emitter| emitter.triangle).for_each(|t| drawn[t as usize] = true);
            let around = Surroundings { scene, frame: &frame, environment, probes, placed: &placed };
            regions = bright_regions(&around, &drawn);
        }
        emitters.push(regions.emitters);
        let guide = Guide::new(distant, emitters.into_iter().flatten().collect());
        let guide = if is_emissive { guide } else { guide.with_emitter_weight(regions.weight) };
        let mut function = Gdibl {
            scene,
            frame,
            environment,
            objects,
            trees: trees.clone(),
            coarsest,
            distant,
            unseen: UnseenChoice::fill("not chosen"),
            tracer: None,
            probes,
            placed,
            all,
            region_count: regions.count,
            sky: distant.map(Sky::new),
            guide,
            punctual: Punctual::new(scene, &frame),
            settings,
            effects,
            targets,
            surface_light: None,
            lamps: None,
        };
        function.surface_light = function.empty_surface_light();
        function
    }

    /// Nothing is remembered yet.
    fn empty_surface_light(&self) -> Option<SurfaceLight> {
        let Gdibl { scene, placed, coarsest, settings, .. } = self;
        self.environment.as_ref().filter(|_| settings.directions > 0).map(|environment| {
            let lookers = Lookers { scene, environment, probes: placed, blend: settings.blend, coarsest: *coarsest };
            SurfaceLight::new(&lookers, &self.all, settings.directions)
        })
    }

    /// How many probes may lend light.
    pub fn probe_count(&self) -> usize {
        self.probes.len()
    }

    /// How many of them see all of the environment: no line of sight to them is traced.
    pub fn sees_all_count(&self) -> usize {
        self.all.iter().filter(|probe| probe.sees_all).count()
    }

    /// Bright regions that probes show and that rays go to.
    pub fn region_count(&self) -> usize {
        self.region_count
    }

    /// A distant panorama lights what escapes.
    pub fn has_distant(&self) -> bool {
        self.sky.is_some()
    }

    /// The rule in force.
    pub fn blend_rule(&self) -> BlendRule {
        self.settings.blend
    }

    /// What is done where no probe counts; nothing until [`Gdibl::choose_unseen`] is called.
    pub fn unseen(&self) -> &UnseenChoice {
        &self.unseen
    }

    /// Chooses what is done where no probe counts. `places`: nodes, world metres; some of them are looked from. Deterministic; paths
    /// for a comparison are a 64th of [`GdiblSettings::directions`], and some thousands; more where these are too noisy.
    pub fn choose_unseen(&mut self, unseen: Unseen, places: &[DVec3]) -> &UnseenChoice {
        self.choose_unseen_by(unseen, places, None)
    }

    /// The same, and what paths come to is kept in `blocks`.
    pub fn choose_unseen_by(&mut self, unseen: Unseen, places: &[DVec3], blocks: Option<&dyn Blocks>) -> &UnseenChoice {
        self.tracer = None;
        self.lamps = None;
        let may_trace =
            unseen != Unseen::Fill && !self.scene.materials_left_out && !self.settings.emission_from_materials;
        if let Some(environment) = self.environment.as_ref().filter(|_| may_trace) {
            self.lamps = Lamps::find(self.scene, environment, &self.frame, self.probes, &self.placed);
        }
        let (choice, tracer) = self.weigh_unseen(unseen, places, blocks);
        let is_known = choice.traced && choice.gain.iter().all(|gain| (1.0 / LAMP_GAIN..=LAMP_GAIN).contains(gain));
        if !is_known && self.lamps.take().is_some() {
            // What was found while lamps did not count must not be remembered.
            self.surface_light = self.empty_surface_light();
        }
        self.unseen = choice;
        self.tracer = tracer;
        &self.unseen
    }

    fn weigh_unseen(
        &self,
        unseen: Unseen,
        places: &[DVec3],
        blocks: Option<&dyn Blocks>,
    ) -> (UnseenChoice, Option<Tracer<'a>>) {
        let mut choice = UnseenChoice::fill("no environment geometry");
        let leave = |choice: UnseenChoice, why: &str| (UnseenChoice { why: why.into(), ..choice }, None);
        let Some(environment) = &self.environment else { return (choice, None) };
        let (met, seen) = self.look_around_by(places, blocks);
        choice.unseen_share = if met > 0 { 1.0 - seen.len() as f64 / met as f64 } else { 0.0 };
        if self.scene.materials_left_out {
            let why = "the level's materials were not read: paths need all textures (TextureNeeds::All)";
            return leave(choice, why);
        }
        let all = match &self.objects {
            None => Some(environment.clone()),
            Some(_) => self.trees.surfaces(self.scene, None, &self.frame),
        };
        let numbers = self.objects.as_ref().zip(all.as_deref());
        let numbers = numbers.map(|(objects, all)| [environment.as_ref(), objects].map(|own| own.numbers_among(all)));
        let path = Path::over(all, self.scene, self.distant, PathSettings::default());
        let is_lit = path.guide().to_sky() || path.guide().emissive_count() > 0 || !self.scene.lights.is_empty();
        if !is_lit {
            return leave(choice, "the level has no light of its own: no emission, no lamp, no distant panorama");
        }
        let dark_outside = self.sky.is_none() && self.is_dark_outside(places, &seen);
        let tracer = Tracer { path, gain: Vec3::ONE, dark_outside, numbers };
        let seen = &seen[..seen.len().min(MOST_POINTS)];
        choice.points = seen.len() as u64;
        // More paths where noise hides what is asked for.
        let usual = self.settings.directions / 64 / seen.len().max(1) as u64;
        let mut paths = usual.clamp(PATHS_PER_POINT[0], PATHS_PER_POINT[1]);
        let agreement = loop {
            let agreement =
                Agreement::of(self.compare(&tracer, seen, paths as u32, &Pass::of(blocks, PassKind::Shared)));
            paths *= 4;
            if paths > PATHS_PER_POINT[1] || agreement.is_none_or(|agreement| !agreement.is_drowned()) {
                break agreement;
            }
        };
        let Some(agreement) = agreement else {
            let why = "too few surface points are lit both in probes and by the level's own lights to compare them";
            choice.traced = unseen == Unseen::Trace;
            return (UnseenChoice { why: why.into(), ..choice }, choice.traced.then_some(tracer));
        };
        let [median, upper] = agreement.quartiles;
        choice.agreement = Some(median);
        choice.trusted = agreement.is_trusted();
        choice.traced = unseen == Unseen::Trace || (unseen == Unseen::Auto && choice.trusted);
        choice.gain = agreement.gain.to_array();
        choice.why = match agreement.is_drowned() {
            true => "paths are too noisy to tell whether the level's materials explain what probes show".into(),
            false => format!(
                "probes and paths by the level's materials differ by {:.1} % beside noise (median; a quarter by more than {:.0} %)",
                100.0 * median,
                100.0 * upper
            ),
        };
        let tracer = (choice.traced || choice.trusted).then_some(Tracer { gain: agreement.gain, ..tracer });
        (choice, tracer)
    }

    /// [`look_around`](Gdibl::look_around). What it finds of the effects of objects, which takes nearly all of its time, is kept in `blocks`.
    fn look_around_by(&self, places: &[DVec3], blocks: Option<&dyn Blocks>) -> (usize, Vec<(Hit, Vec3)>) {
        let (Some(effects), Some(environment)) = (&self.effects, &self.environment) else {
            return self.look_around(places);
        };
        if blocks.is_none() {
            self.look_for_effects(places);
            return self.look_around(places);
        }
        let pass = Pass::of(blocks, PassKind::Shared);
        let mut looked = None;
        for block in 0.. {
            let find = || {
                let (beside, _) =
                    looked.get_or_insert_with(|| (self.look_for_effects(places), self.look_around(places)));
                let beside = if block == 0 { beside.clone() } else { Vec::new() };
                let filled = effects.filled().into_iter().skip(block * TEXELS_TOGETHER).take(TEXELS_TOGETHER);
                Ok((filled.collect(), beside))
            };
            let found: Option<(Vec<Filled>, Vec<Found>)> = pass.block(block, |_| true, find).ok().flatten();
            let (filled, beside) = found.expect("every run looks around, and nothing interrupts it");
            effects.fill(environment, &filled);
            // Not counted here, nor where another run finds it again.
            pass.count(&beside);
            if filled.len() < TEXELS_TOGETHER {
                break;
            }
        }
        looked.map_or_else(|| self.look_around(places), |(_, around)| around)
    }

    /// Finds the effects of objects where many rays will ask for them: what nodes find on their way each shard would find again.
    /// Returns what was found beside them.
    fn look_for_effects(&self, places: &[DVec3]) -> Vec<Found> {
        let environment = self.environment.as_ref().expect("asked only with one");
        let looks = if places.is_empty() { 0 } else { self.settings.directions / DIRECTIONS_PER_LOOK };
        let stream = Stream::new(Sampler::Sobol, self.settings.seed, streams::AGREEMENT, 0);
        let look = |number: u32| {
            let origin = self.frame.to_trace(places[number as usize % places.len()]);
            let direction = uniform_sphere(stream.point(number, 0));
            let hit = environment.shown(self.scene, origin, direction, f32::INFINITY)?;
            let mut context = PathContext::new(stream);
            self.effect(&hit, Walk::default(), &mut context);
            Some(context.found)
        };
        (0..looks.min(MOST_LOOKS) as u32).into_par_iter().filter_map(look).flatten_iter().collect()
    }

    /// How many surface points rays from these places meet, and those of them that probes count at, with what they show.
    fn look_around(&self, places: &[DVec3]) -> (usize, Vec<(Hit, Vec3)>) {
        let environment = self.environment.as_ref().expect("asked only with one");
        if places.is_empty() {
            return (0, Vec::new());
        }
        let stream = Stream::new(Sampler::Sobol, self.settings.seed, streams::AGREEMENT, 0);
        let look = |number: u32| {
            let place = places[(u64::from(number) * places.len() as u64 / u64::from(LOOKS)) as usize];
            let origin = self.frame.to_trace(place);
            let direction = uniform_sphere(stream.point(number, 0));
            let hit = environment.shown(self.scene, origin, direction, f32::INFINITY)?;
            // Who sees backs stands in a solid.
            if hit.back && !environment.material(self.scene, hit.triangle).double_sided {
                return None;
            }
            let mut context = PathContext::new(stream);
            context.sample = number;
            let mut shown = self.environment_radiance(&hit, origin, &mut context);
            shown.value += self.effect(&hit, Walk::default(), &mut context);
            Some((hit, shown))
        };
        let met: Vec<(Hit, Radiance)> = (0..LOOKS).into_par_iter().filter_map(look).collect();
        let seen = met.iter().filter(|(_, shown)| shown.coverage == 1.0);
        (met.len(), seen.map(|(hit, shown)| (*hit, shown.value)).collect())
    }

    /// Probes show next to no light where they look past all surfaces.
    fn is_dark_outside(&self, places: &[DVec3], seen: &[(Hit, Vec3)]) -> bool {
        let stream = Stream::new(Sampler::Sobol, self.settings.seed, streams::AGREEMENT, 0);
        let mut context = PathContext::new(stream);
        let shown =
            (0..LOOKS).map(|number| self.escaping_radiance(uniform_sphere(stream.point(number, 0)), &mut context));
        let outside: f32 = shown.map(|light| light.value.element_sum()).sum();
        let inside: f32 = seen.iter().map(|(_, light)| light.element_sum()).sum();
        !places.is_empty() && outside <= DARK * inside
    }

    /// The same points by paths, so many each.
    fn compare(&self, tracer: &Tracer, seen: &[(Hit, Vec3)], paths: u32, pass: &Pass) -> Vec<Compared> {
        let environment = self.environment.as_ref().expect("asked only with one");
        let trace = |number: usize| {
            let (hit, _) = &seen[number];
            let node = streams::AGREEMENT | (number as u64 + 1);
            let mut context = PathContext::new(Stream::new(Sampler::Sobol, self.settings.seed, node, 0));
            let triangle = tracer.numbers.as_ref().map_or(hit.triangle, |numbers| numbers[0][hit.triangle as usize]);
            let mut traced = Vec3::ZERO;
            for sample in 0..paths {
                context.sample = sample;
                traced += tracer.path.light(-hit.normal, First::of(Hit { triangle, ..*hit }), &mut context);
            }
            (traced / paths as f32).to_array()
        };
        let block = |number: usize| {
            let first = number * COMPARED_TOGETHER;
            let numbers = first..seen.len().min(first + COMPARED_TOGETHER);
            let fits = |traced: &Vec<[f32; 3]>| traced.len() == numbers.len();
            let traced = pass.block(number, fits, || Ok(numbers.clone().map(trace).collect()));
            traced.ok().flatten().expect("every run compares, and nothing interrupts it")
        };
        let blocks: Vec<Vec<[f32; 3]>> =
            (0..seen.len().div_ceil(COMPARED_TOGETHER)).into_par_iter().map(block).collect();
        let point = |((hit, shown), traced): (&(Hit, Vec3), [f32; 3])| {
            let place = (hit.position / self.frame.half.max(Vec3::splat(f32::MIN_POSITIVE)) + 1.0) / 2.0;
            let order = (environment.mesh(self.scene, hit.triangle).material, curve_of(place));
            Compared { order, shown: *shown, traced: traced.into() }
        };
        seen.iter().zip(blocks.into_iter().flatten()).map(point).collect()
    }

    /// Triangles whose light is remembered.
    pub fn remembered_count(&self) -> usize {
        let light = self.surface_light.as_ref().filter(|_| self.settings.blend.is_seamless());
        light.map_or(0, SurfaceLight::triangle_count)
    }

    /// What rays do at scene geometry.
    pub fn scene_hit(&self) -> SceneHit {
        self.settings.scene_hit
    }

    fn radiance_along(&self, origin: Vec3, direction: Vec3, walk: Walk, context: &mut PathContext) -> Radiance {
        self.sum_along(origin, direction, context, |met, context| match met {
            Met::Object(hit) => self.object_radiance(&hit, walk, context),
            Met::Environment(hit) => {
                let mut part = match (walk.source, &self.tracer) {
                    (Source::Paths, Some(tracer)) => {
                        return self.traced(tracer, Role::Environment, &hit, origin, walk, context);
                    }
                    (Source::Without(probe), _) => self.radiance_without(probe, &hit, origin, context),
                    _ => self.environment_radiance(&hit, origin, context),
                };
                if let Some(traced) = self.traced_instead(part, &hit, origin, walk, context) {
                    return traced;
                }
                part.value += self.effect(&hit, walk, context) * part.told();
                part
            }
            Met::Nothing => match &self.sky {
                Some(sky) if walk.step == 0 => Radiance::covered(sky.radiance_at_node(direction)),
                _ => self.escaping_or_dark(direction, context),
            },
        })
    }

    /// 1. The nearest hit wins; what a partly clear surface lets through goes on. `radiance` tells what each shows.
    fn sum_along(
        &self,
        origin: Vec3,
        direction: Vec3,
        context: &mut PathContext,
        radiance: impl Fn(Met, &mut PathContext) -> Radiance,
    ) -> Radiance {
        let mut sum = Radiance::UNCOVERED;
        // Share of the ray that is left, and by colour what its light is multiplied by.
        let mut left = 1.0;
        let mut tint = Vec3::ONE;
        let mut passed = 0.0;
        for _ in 0..MAX_LAYERS {
            context.rays += 1;
            let near =
                self.environment.as_ref().and_then(|s| s.closest(self.scene, origin, direction, passed, f32::INFINITY));
            let limit = near.map_or(f32::INFINITY, |hit| search_limit(&hit, direction));
            let object = self.objects.as_ref().and_then(|s| s.closest(self.scene, origin, direction, passed, limit));
            let is_first = |object: &Hit| near.is_none_or(|near| counts_before(object, &near));
            let (met, opacity, t) = match (object, near) {
                (Some(hit), _) if is_first(&hit) => (Met::Object(hit), hit.opacity, hit.t),
                (_, Some(hit)) => (Met::Environment(hit), hit.opacity, hit.t),
                _ => (Met::Nothing, 1.0, f32::INFINITY),
            };
            context.reach.get_or_insert(t);
            let next_tint = match &met {
                Met::Object(hit) => self.objects.as_ref().map(|s| s.tint(self.scene, hit)),
                Met::Environment(hit) => self.environment.as_ref().map(|s| s.tint(self.scene, hit)),
                Met::Nothing => None,
            };
            if opacity > 0.0 {
                let part = radiance(met, context);
                sum.value += part.value * tint * (left * opacity);
                sum.coverage += part.coverage * (left * opacity);
                sum.guessed += part.guessed * (left * opacity);
            }
            left *= 1.0 - opacity;
            if left < CLEAR_ENOUGH {
                break;
            }
            tint *= next_tint.unwrap_or(Vec3::ONE);
            // Past what lies in one place with it, too.
            passed = near.filter(|near| near.back && near.t < t).map_or(t, |near| near.t.max(t));
        }
        sum
    }

    /// 2. Scene geometry: no probe has seen it. It glows, and reflects what one more ray finds. The report ends at
    ///    its depth in black; here the rest is uncovered, and so filled.
    fn object_radiance(&self, hit: &Hit, walk: Walk, context: &mut PathContext) -> Radiance {
        let objects = self.objects.as_ref().expect("an object was hit");
        let SceneHit::Recurse(limit) = self.settings.scene_hit else {
            // The inside of a solid is not dark, it is nowhere.
            let inside = hit.back && !objects.material(self.scene, hit.triangle).double_sided;
            return if inside { Radiance::UNCOVERED } else { Radiance::covered(Vec3::ZERO) };
        };
        let emission = objects.emission(self.scene, hit);
        let chance = || context.stream.random(context.sample, PAIRS * walk.step + SIDE);
        let Scattered { hit, albedo } = objects.scatter(self.scene, hit, chance);
        let hit = &hit;
        if albedo == Vec3::ZERO {
            return Radiance::covered(emission);
        }
        if walk.objects >= limit {
            // What it reflects is unknown, not black: so nodes inside a solid are invalid instead of dark.
            return match &self.tracer {
                Some(tracer) if self.unseen.traced => {
                    self.traced(tracer, Role::Scene, hit, hit.position + hit.normal, walk, context)
                }
                _ => Radiance { value: emission, ..Radiance::UNCOVERED },
            };
        }
        // ∫ albedo/π · L · cosθ dω with density cosθ/π: albedo × L of one direction.
        let first = walk.objects == 0;
        let walk = Walk { step: walk.step + 1, objects: walk.objects + 1, ..walk };
        let start = objects.leave(hit);
        let direction = cosine_hemisphere(hit.normal, walk.point(BY_COSINE, context));
        let arriving = self.radiance_along(start, direction, walk, context);
        let mut value = emission + albedo * arriving.value * self.cosine_weight(start, hit.normal, direction);
        // Once per ray: at every object the rays would double.
        if first && let Some((direction, weight)) = self.toward_light(start, hit.normal, walk, context) {
            value += albedo * self.radiance_along(start, direction, walk, context).value * weight;
        }
        Radiance { value, ..arriving }
    }

    /// Next-event estimation: a direction from a surface toward what is bright, and the weight of its light,
    /// cosθ/π over the densities of all that could have found it. `None` where nothing is bright.
    ///
    /// At 64 samples per pixel, pictures of the box with its spheres were off by 40 % by cosine alone, and by 9 % with this;
    /// irradiance on the spheres at 1024 directions by 7.1 % and 4.8 %, for a tenth more time (`tools/sphere_table`).
    fn toward_light(&self, start: Vec3, normal: Vec3, walk: Walk, context: &PathContext) -> Option<(Vec3, f32)> {
        let (direction, density) = self.guide.propose_bright(start, walk.point(TO_BRIGHT, context))?;
        let by_cosine = direction.dot(normal) * FRAC_1_PI;
        (by_cosine > 0.0).then(|| (direction, by_cosine / (by_cosine + density)))
    }

    /// Weight of light that a direction by cosine found: 1, less what [`Gdibl::toward_light`] has of it.
    fn cosine_weight(&self, start: Vec3, normal: Vec3, direction: Vec3) -> f32 {
        let by_cosine = direction.dot(normal) * FRAC_1_PI;
        by_cosine / (by_cosine + self.guide.bright_density(start, direction))
    }

    /// 3. Environment geometry: what it sends out itself, if that is known, and what probes have seen of it.
    fn environment_radiance(&self, hit: &Hit, viewer: Vec3, context: &mut PathContext) -> Radiance {
        let environment = self.environment.as_ref().expect("the environment was hit");
        let lookers = Lookers {
            scene: self.scene,
            environment,
            probes: &self.placed,
            blend: self.settings.blend,
            coarsest: self.coarsest,
        };
        let light = self.surface_light.as_ref();
        let spot = light.and_then(|light| light.at(hit, &lookers, &self.all, context));
        let candidates = spot.map_or(&self.all[..], |spot| spot.candidates());
        let find =
            |place: &Hit, context: &mut PathContext| self.blended_by(candidates, &self.all, place, viewer, context);
        let remembered = spot.and_then(|spot| spot.remembered(environment, hit, context, find));
        let seen = remembered.unwrap_or_else(|| find(hit, context));
        self.with_emission(seen, hit)
    }

    fn with_emission(&self, mut seen: Radiance, hit: &Hit) -> Radiance {
        if let Some(environment) = self.environment.as_ref().filter(|_| self.settings.emission_from_materials) {
            seen.value += environment.emission(self.scene, hit);
        }
        seen
    }

    /// Environment geometry by all probes but one.
    fn radiance_without(&self, probe: u32, hit: &Hit, viewer: Vec3, context: &mut PathContext) -> Radiance {
        let others: Vec<Candidate> = self.all.iter().copied().filter(|candidate| candidate.probe != probe).collect();
        self.with_emission(self.blended_by(&others, &others, hit, viewer, context), hit)
    }

    /// 5. Light by paths, where a surface is met that no probe counts at and materials are trusted; else `None`.
    fn traced_instead(
        &self,
        shown: Radiance,
        hit: &Hit,
        from: Vec3,
        walk: Walk,
        context: &mut PathContext,
    ) -> Option<Radiance> {
        let tracer = self.tracer.as_ref().filter(|_| shown.coverage == 0.0 && self.unseen.traced)?;
        Some(self.traced(tracer, Role::Environment, hit, from, walk, context))
    }

    /// Light that a path finds to leave a surface, `hit` among those of its role. To let it end where it meets a surface that probes
    /// count at, and take their light, was no gain: a living room had 3 % less noise for 10 % more rays, lines of sight.
    fn traced(
        &self,
        tracer: &Tracer,
        role: Role,
        hit: &Hit,
        from: Vec3,
        walk: Walk,
        context: &mut PathContext,
    ) -> Radiance {
        let triangle = match &tracer.numbers {
            Some(numbers) => numbers[usize::from(role == Role::Scene)][hit.triangle as usize],
            None => hit.triangle,
        };
        let direction = (hit.position - from).normalize_or(-hit.normal);
        let pairs = PATHS + walk.step * PAIRS_PER_PATH;
        let light = tracer.path.light_by(direction, First::of(Hit { triangle, ..*hit }), pairs, context);
        Radiance::covered(light * tracer.gain)
    }

    /// Those of the candidates, some of `all`, that see the point lend their pixels. A guess where none sees it finely enough.
    fn blended_by(
        &self,
        candidates: &[Candidate],
        all: &[Candidate],
        hit: &Hit,
        viewer: Vec3,
        context: &mut PathContext,
    ) -> Radiance {
        let is_all = candidates.len() == all.len();
        // Others were left out for the sake of probes that see the point.
        let fine = self.blend(candidates, is_all, self.coarsest, hit, viewer, context).unwrap_or_else(|| {
            let by_all = self.blend(all, true, self.coarsest, hit, viewer, context);
            by_all.expect("nobody is left out")
        });
        if fine.coverage > 0.0 || self.coarsest == f32::INFINITY {
            return fine;
        }
        let coarse = self.blend(all, true, f32::INFINITY, hit, viewer, context).expect("nobody is left out");
        Radiance { coverage: 0.0, guessed: coarse.coverage, ..coarse }
    }

    /// Radiance by these probes. `None` where one that sees the point has no pixel that shows it, and others may have been left
    /// out.
    fn blend(
        &self,
        candidates: &[Candidate],
        is_all: bool,
        coarsest: f32,
        hit: &Hit,
        viewer: Vec3,
        context: &mut PathContext,
    ) -> Option<Radiance> {
        let environment = self.environment.as_ref().expect("the environment was hit");
        // A guess takes what there is.
        let lamps = self.lamps.as_ref().filter(|_| coarsest == self.coarsest);
        if lamps.is_some_and(|lamps| lamps.glows(hit.triangle)) {
            return Some(Radiance::UNCOVERED);
        }
        let scratch = &mut context.scratch;
        // Candidates stand on the side from which the ray came.
        scratch.candidates.clear();
        let to_viewer = viewer - hit.position;
        let seamless = self.settings.blend.is_seamless();
        for &candidate in candidates {
            let probe = &self.placed[candidate.probe as usize];
            let to_probe = probe.position - hit.position;
            let height = hit.normal.dot(to_probe);
            let distance = to_probe.length();
            if height > 0.0 && pixel_size(probe.pixels, height, distance) <= coarsest {
                let view = View {
                    distance,
                    cosine: height / distance,
                    angle: match seamless {
                        true => 0.0,
                        false => to_probe.cross(to_viewer).length().atan2(to_probe.dot(to_viewer)),
                    },
                    pixels: probe.pixels,
                };
                scratch.candidates.push((self.settings.blend.merit(&view), candidate));
            }
        }
        scratch.candidates.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.probe.cmp(&b.1.probe)));
        // Lines of sight, best first, until no further probe can have a weight.
        scratch.merits.clear();
        scratch.seen.clear();
        let start = environment.leave(hit);
        for &(merit, Candidate { probe: index, sees_all }) in &scratch.candidates {
            if scratch.merits.first().is_some_and(|&best| self.settings.blend.ratio(merit, best) == 0.0) {
                break;
            }
            let probe = &self.placed[index as usize];
            let clear = match sees_all {
                true => 1.0,
                false => {
                    context.rays += 1;
                    environment.transmittance(self.scene, start, probe.position, Some(hit.triangle)).max_element()
                }
            };
            if clear <= 0.0 {
                continue;
            }
            let toward_point = hit.position - probe.position;
            let panorama = &self.probes[index as usize].panorama;
            let distance = toward_point.length();
            let direction = probe.to_local * (toward_point / distance);
            let pixel = match lamps.is_some_and(|lamps| lamps.is_in_pixel(index as usize, panorama, direction)) {
                true => None,
                false => {
                    panorama.radiance_on_plane(direction, self.frame.metres(distance), probe.to_local * hit.normal)
                }
            };
            if let Some(pixel) = pixel {
                scratch.merits.push(merit);
                scratch.seen.push((pixel * probe.gain, clear));
                if scratch.merits.len() == self.settings.blend.reach() {
                    break;
                }
            } else if sees_all && !is_all {
                return None;
            }
        }
        if scratch.merits.is_empty() {
            return Some(Radiance::UNCOVERED);
        }
        self.settings.blend.weights(&scratch.merits, &mut scratch.weights);
        let mut sum = Vec3::ZERO;
        let mut total = 0.0;
        for (&weight, &(radiance, clear)) in scratch.weights.iter().zip(&scratch.seen) {
            sum += radiance * (weight * clear);
            total += weight * clear;
        }
        Some(Radiance::covered(sum / total))
    }

    /// What scene geometry changes in the light of an environment point, from the texel it lies in.
    fn effect(&self, hit: &Hit, walk: Walk, context: &mut PathContext) -> Vec3 {
        let (Some(cache), Some(environment)) = (&self.effects, &self.environment) else { return Vec3::ZERO };
        if walk.texels == Texels::None {
            // What objects do to the light that falls on objects: few walks tell it well enough.
            let chance = if walk.objects > 0 { SECOND } else { 1.0 };
            return match walk.point(ROULETTE, context)[1] < chance {
                true => self.effect_of_objects(hit, walk, context) / chance,
                false => Vec3::ZERO,
            };
        }
        let distance = if walk.texels == Texels::All && walk.step == 0 { hit.t } else { f32::INFINITY };
        let replicate = context.replicate;
        let fill = |texel: Texel| {
            let side = u64::from(hit.triangle) << 1 | u64::from(hit.back);
            let id = FOUND_TEXEL | side << 16 | u64::from(texel.index) << 1 | u64::from(texel.is_near);
            context
                .finding(id, |context| std::array::from_fn(|part| self.mean_effect(hit, texel, part as u32, context)))
        };
        cache.lookup(environment, hit, distance, replicate, fill)
    }

    /// The mean effect of one part of a texel, around `hit`: of walks from all over it.
    fn mean_effect(&self, hit: &Hit, texel: Texel, part: u32, asks: &mut PathContext) -> Vec3 {
        let environment = self.environment.as_ref().expect("the environment was hit");
        let texels = if texel.is_near { streams::NEAR_TEXELS } else { streams::TEXELS };
        let node = texels | u64::from(hit.triangle) << 1 | u64::from(hit.back);
        let stream = Stream::new(Sampler::Sobol, self.settings.seed, node, texel.index * PARTS + part);
        let mut context = PathContext::new(stream);
        // What a part reads of other texels is of the same part: the parts stay independent.
        context.replicate = Some(part);
        let texels = if texel.is_near { Texels::Far } else { Texels::None };
        let walk = Walk { texels, ..Walk::default() };
        let mut sum = DVec3::ZERO;
        for sample in 0..texel.walks {
            context.sample = sample;
            let start = environment.point(hit.triangle, texel.place(context.point(0)), hit.back);
            sum += self.effect_of_objects(&start, walk, &mut context).as_dvec3();
        }
        asks.rays += context.rays;
        asks.found.append(&mut context.found);
        (sum / f64::from(texel.walks)).as_vec3()
    }

    /// What scene geometry changes in the light of an environment point: its shadow and its reflection, which no
    /// probe has seen. A walk over environment surfaces, along which that light came:
    ///
    /// Δ(x) = albedo/π ∫ (L_with - L_without) cosθ dω, where only a ray that meets an object, here or bounces
    /// later, makes a difference. Based on: Debevec, "Rendering Synthetic Objects into Real Scenes", 1998, §6
    /// (differential rendering). Walls around a sphere are darker than the empty box's that the probes saw: without
    /// this, irradiance on the three spheres of the box is 10 % too bright; with it, 1 % (`tools/sphere_table`).
    ///
    /// At each surface one ray goes by cosine, one toward the objects, and one toward what is bright, which they may hide;
    /// what more than one can find is weighed by the balance heuristic. The ray by cosine goes on where it meets no object.
    fn effect_of_objects(&self, hit: &Hit, mut walk: Walk, context: &mut PathContext) -> Vec3 {
        let environment = self.environment.as_ref().expect("the environment was hit");
        let mut effect = Vec3::ZERO;
        let mut throughput = Vec3::ONE;
        let mut hit = *hit;
        loop {
            let chance = || context.stream.random(context.sample, PAIRS * walk.step + SIDE);
            let scattered = environment.scatter(self.scene, &hit, chance);
            hit = scattered.hit;
            throughput *= scattered.albedo;
            if throughput == Vec3::ZERO {
                return effect;
            }
            walk.step += 1;
            let start = environment.leave(&hit);
            let wall = Wall { start, normal: hit.normal, targets: self.targets.as_ref().filter(|_| walk.objects == 0) };
            let direction = cosine_hemisphere(hit.normal, walk.point(BY_COSINE, context));
            let mut behind = None;
            match self.change_along(start, direction, walk, context) {
                Change::Object { difference, share } => {
                    let others = wall.target_density(direction) + self.guide.bright_density(start, direction);
                    effect += throughput * difference * (share * wall.weight(direction, others));
                }
                Change::Behind(hit) => behind = Some(hit),
                Change::None => {}
            }
            let receiver = wall.receiver();
            let drawn = wall.targets.and_then(|t| t.sample_direction(&receiver, walk.point(TO_OBJECTS, context)));
            if let Some((direction, density)) = drawn.filter(|(direction, _)| direction.dot(hit.normal) > 0.0)
                && let Some((difference, share)) = self.change_by_object(start, direction, walk, context)
            {
                let others = density + self.guide.bright_density(start, direction);
                effect += throughput * difference * (share * wall.weight(direction, others));
            }
            let bright = self.guide.propose_bright(start, walk.point(TO_BRIGHT, context));
            if let Some((direction, density)) = bright.filter(|(direction, _)| direction.dot(hit.normal) > 0.0)
                && let Some((difference, share)) = self.change_by_object(start, direction, walk, context)
            {
                let others = density + wall.target_density(direction);
                effect += throughput * difference * (share * wall.weight(direction, others));
            }
            let Some(next) = behind else { return effect };
            if walk.texels == Texels::Far {
                return effect + throughput * self.effect(&next, walk, context);
            }
            // Roulette: what survives goes on with the weight of what does not.
            let survival = throughput.max_element().min(EFFECT_SURVIVAL);
            if walk.point(ROULETTE, context)[0] >= survival {
                return effect;
            }
            throughput /= survival;
            hit = next;
        }
    }

    /// What scene geometry changes in the light that arrives at an environment point `start` from `direction`.
    fn change_along(&self, start: Vec3, direction: Vec3, walk: Walk, context: &mut PathContext) -> Change {
        let objects = self.objects.as_ref().expect("only scene geometry has an effect");
        let environment = self.environment.as_ref().expect("the environment was hit");
        context.rays += 1;
        let behind = environment.closest(self.scene, start, direction, 0.0, f32::INFINITY);
        let limit = behind.map_or(f32::INFINITY, |hit| search_limit(&hit, direction));
        let object = objects
            .closest(self.scene, start, direction, 0.0, limit)
            .filter(|object| behind.is_none_or(|behind| counts_before(object, &behind)));
        let Some(object) = object else {
            return behind.map_or(Change::None, Change::Behind);
        };
        let (difference, share) = self.difference(&object, behind, start, direction, walk, context);
        Change::Object { difference, share }
    }

    /// [`Gdibl::change_along`] for who does not ask what lies behind: most rays toward what is bright meet no object, and
    /// need not meet the environment.
    fn change_by_object(
        &self,
        start: Vec3,
        direction: Vec3,
        walk: Walk,
        context: &mut PathContext,
    ) -> Option<(Vec3, f32)> {
        let objects = self.objects.as_ref().expect("only scene geometry has an effect");
        let environment = self.environment.as_ref().expect("the environment was hit");
        context.rays += 1;
        let object = objects.closest(self.scene, start, direction, 0.0, f32::INFINITY)?;
        let behind = environment.closest(self.scene, start, direction, 0.0, f32::INFINITY);
        if behind.is_some_and(|behind| !counts_before(&object, &behind)) {
            return None;
        }
        Some(self.difference(&object, behind, start, direction, walk, context))
    }

    /// Light with an object less light without it, and the share of the ray that it changes, 0..=1.
    fn difference(
        &self,
        object: &Hit,
        behind: Option<Hit>,
        start: Vec3,
        direction: Vec3,
        walk: Walk,
        context: &mut PathContext,
    ) -> (Vec3, f32) {
        let with = self.object_radiance(object, walk, context);
        let without = match behind {
            Some(hit) => self.environment_radiance(&hit, start, context),
            None => self.escaping_radiance(direction, context),
        };
        // Where one of the two is unknown, so is the difference.
        (with.value - without.value, object.opacity * with.told().min(without.told()))
    }

    /// What escapes, where no probe looks out the same way: as paths have it.
    fn escaping_or_dark(&self, direction: Vec3, context: &mut PathContext) -> Radiance {
        let escaping = self.escaping_radiance(direction, context);
        let is_dark = self.unseen.traced && self.tracer.as_ref().is_some_and(|tracer| tracer.dark_outside);
        if escaping.coverage == 0.0 && is_dark { Radiance::covered(Vec3::ZERO) } else { escaping }
    }

    /// 4. Nothing hit: the distant panorama, or else the probes that look out in the same direction.
    fn escaping_radiance(&self, direction: Vec3, context: &mut PathContext) -> Radiance {
        if let Some(sky) = &self.sky {
            return Radiance::covered(sky.radiance(direction));
        }
        let mut sum = Vec3::ZERO;
        let mut total = 0.0;
        for (probe, placed) in self.probes.iter().zip(&self.placed) {
            let Some(pixel) = probe.panorama.radiance_escaping(placed.to_local * direction) else { continue };
            let clear = self.environment.as_ref().map_or(1.0, |environment| {
                context.rays += 1;
                environment.escaping(self.scene, placed.position, direction).max_element()
            });
            sum += pixel * (placed.gain * placed.pixels * clear);
            total += placed.pixels * clear;
        }
        if total > 0.0 { Radiance::covered(sum / total) } else { Radiance::UNCOVERED }
    }
}

/// Where a walk leaves the environment.
struct Wall<'a> {
    start: Vec3,
    normal: Vec3,
    /// What rays go to beside those by cosine.
    targets: Option<&'a Emitters>,
}

impl Wall<'_> {
    fn receiver(&self) -> Receiver<'static> {
        Receiver::surface(self.start, self.normal)
    }

    /// Density per steradian with which rays toward objects find a direction.
    fn target_density(&self, direction: Vec3) -> f32 {
        self.targets.map_or(0.0, |targets| targets.density(&self.receiver(), direction))
    }

    /// Weight of what was found in a direction: cosθ/π over the densities of all that could have found it.
    fn weight(&self, direction: Vec3, others: f32) -> f32 {
        let by_cosine = direction.dot(self.normal) * FRAC_1_PI;
        by_cosine / (by_cosine + others)
    }
}

/// Scene geometry as something to draw directions toward.
fn targets_of(scene: &Scene, objects: &Surfaces) -> Vec<Emitter> {
    let triangles = (0..objects.len() as u32).map(|triangle| {
        let double_sided = objects.material(scene, triangle).double_sided;
        Emitter::target(*objects.corners(triangle), double_sided)
    });
    triangles.filter(|target| target.area > 0.0).collect()
}

impl RadianceFunction for Gdibl<'_> {
    fn frame(&self) -> &Frame {
        &self.frame
    }

    fn level(&self) -> Level<'_> {
        Level::new(self.scene, [self.environment.as_deref(), self.objects.as_deref()])
    }

    fn guide(&self) -> &Guide {
        &self.guide
    }

    fn radiance(&self, origin: Vec3, direction: Vec3, context: &mut PathContext) -> Radiance {
        context.reach = None;
        self.radiance_along(origin, direction, Walk::default(), context)
    }

    /// By paths at every other place, where materials are trusted. Else without one of the probes, the same for all directions of a
    /// place: the jackknife, in
    /// which the variance of what n probes say is (n - 1) times the mean square of what one more or less makes of it (Efron and
    /// Stein, "The jackknife estimate of variance", 1981).
    fn audit(&self, origin: Vec3, direction: Vec3, context: &mut PathContext) -> Option<Audit> {
        let place = number_of_place(origin);
        let others = self.probes.len().saturating_sub(1);
        let by_paths = self.tracer.is_some() && self.unseen.trusted && (others == 0 || place.is_multiple_of(2));
        let (source, weight) = match (by_paths, others) {
            (true, _) => (Source::Paths, 1.0),
            (false, 0) => return None,
            (false, _) => (Source::Without(place / 2 % self.probes.len() as u32), (others as f32).sqrt()),
        };
        let arriving = self.radiance_along(origin, direction, Walk { source, ..Walk::default() }, context);
        // What one probe alone has seen, the others cannot judge.
        let is_told = source == Source::Paths || arriving.coverage > 1.0 - CLEAR_ENOUGH;
        is_told.then_some(Audit { arriving, weight, by_probes: !by_paths })
    }

    fn look(
        &self,
        origin: Vec3,
        direction: Vec3,
        context: &mut PathContext,
        shade: impl Fn(&Seen, &mut PathContext) -> Option<Radiance>,
    ) -> Radiance {
        let walk = Walk::default();
        self.sum_along(origin, direction, context, |met, context| match met {
            Met::Object(hit) => {
                let surfaces = self.objects.as_ref().expect("an object was hit");
                let shaded = shade(&Seen { scene: self.scene, surfaces, hit: &hit, direction }, context);
                shaded.unwrap_or_else(|| self.object_radiance(&surfaces.smooth(self.scene, hit), walk, context))
            }
            Met::Environment(hit) => {
                let mut part = self.environment_radiance(&hit, origin, context);
                if let Some(traced) = self.traced_instead(part, &hit, origin, walk, context) {
                    return traced;
                }
                // The point's own walk: texels, good enough for what comes by way of another surface, would be seen.
                if self.effects.is_some() {
                    let walk = Walk { texels: Texels::None, ..walk };
                    part.value += self.effect_of_objects(&hit, walk, context) * part.told();
                }
                part
            }
            Met::Nothing => self.escaping_or_dark(direction, context),
        })
    }

    fn punctual(&self, origin: Vec3, context: &mut PathContext, mut add: impl FnMut(Vec3, Vec3)) {
        for arriving in self.punctual.arriving(origin) {
            let mut clear = Vec3::ONE;
            for surfaces in self.environment.as_deref().into_iter().chain(self.objects.as_deref()) {
                context.rays += 1;
                clear *= match arriving.position {
                    Some(position) => surfaces.transmittance(self.scene, origin, position, None),
                    None => surfaces.escaping(self.scene, origin, arriving.direction),
                };
            }
            add(arriving.direction, arriving.irradiance * clear);
        }
    }
}
