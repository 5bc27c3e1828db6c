//! Radiance functions: (origin, direction) → radiance or uncovered. The one place where probes and geometry meet.

pub mod blend;
mod candidates;
mod effects;
pub mod gdibl;
mod guide;
mod lamps;
pub mod path;
mod probe;
mod punctual;
mod seen;
mod surface_light;
pub mod unseen;

use glam::Vec3;

use crate::blocks::Found;
use crate::sampling::Stream;
use crate::trace::{Frame, Level};
use candidates::Scratch;
pub use guide::{Distant, Glance, GlanceSums, Guide, Outlook, Technique, UNIFORM_SHARE, Vantage};
pub(crate) use probe::{PlacedProbe, Probe, Surroundings};
pub use seen::Seen;

/// Light that arrives at a point, by direction. GDIBL and path tracing differ in this alone.
pub trait RadianceFunction: Sync {
    /// World ↔ trace positions.
    fn frame(&self) -> &Frame;

    /// All surfaces that rays meet.
    fn level(&self) -> Level<'_>;

    /// Which directions are worth a ray.
    fn guide(&self) -> &Guide;

    /// Radiance that arrives at `origin` (trace space) from the unit `direction`, without the sun that was taken out of the
    /// distant panorama ([`Distant::extract_sun`]) where the ray meets it first: light that bounces saw the whole. Pair 0 of the context's random numbers
    /// has chosen the direction; the function takes its own from the later ones.
    fn radiance(&self, origin: Vec3, direction: Vec3, context: &mut PathContext) -> Radiance;

    /// The same light told in another way, so that the difference tells how wrong [`RadianceFunction::radiance`] is beside noise:
    /// on average over directions, by the same random numbers. Called right after it for a random share of the directions. `None`:
    /// nothing is wrong beside noise, or nothing can be said.
    fn audit(&self, _origin: Vec3, _direction: Vec3, _context: &mut PathContext) -> Option<Audit> {
        None
    }

    /// The same for a ray of a camera. `shade` is asked first about every surface that the ray meets, as far as light is
    /// computed there: not about environment geometry that shows its probes. Where it has no answer, the function has, by the
    /// shading normal of that surface. Unless the function says otherwise nothing is shaded, and a camera sees what nodes do.
    fn look(
        &self,
        origin: Vec3,
        direction: Vec3,
        context: &mut PathContext,
        _shade: impl Fn(&Seen, &mut PathContext) -> Option<Radiance>,
    ) -> Radiance {
        self.radiance(origin, direction, context)
    }

    /// Calls `add(direction, irradiance)` for every punctual light that is seen from `origin`: the direct light, of which
    /// [`RadianceFunction::radiance`] tells nothing. Unless the function says otherwise there are none.
    fn punctual(&self, _origin: Vec3, _context: &mut PathContext, _add: impl FnMut(Vec3, Vec3)) {}
}

/// What an audit of a direction found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Audit {
    /// Light along the same ray.
    pub arriving: Radiance,
    /// What the difference counts.
    pub weight: f32,
    /// Other probes told it, with little noise; else paths, which know the truth.
    pub by_probes: bool,
}

/// Radiance that arrives along a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Radiance {
    /// Linear Rec.709, from the covered share of the ray alone.
    pub value: Vec3,
    /// Share of the ray (0..=1; partly clear surfaces divide it) whose origin some probe, the distant panorama, a light or
    /// a path has told.
    pub coverage: f32,
    /// Share of the ray that probes show too coarsely to count: their light is a guess. What is neither covered nor guessed is
    /// *uncovered*: the integrator fills it.
    pub guessed: f32,
}

impl Radiance {
    /// Nothing is known.
    pub const UNCOVERED: Radiance = Radiance { value: Vec3::ZERO, coverage: 0.0, guessed: 0.0 };

    /// Known in full.
    pub fn covered(value: Vec3) -> Radiance {
        Radiance { value, coverage: 1.0, guessed: 0.0 }
    }

    /// Share of the ray that has a value, 0..=1.
    pub fn told(&self) -> f32 {
        self.coverage + self.guessed
    }
}

/// Who sees backs of single-sided triangles in more than this share of directions, or any backs and no light, is inside a
/// solid or outside: it may stand on a floor, and that shows its front. A dark room shows the fronts of its walls.
pub(crate) const SOLID_BACKS: f64 = 0.25;

/// No walk goes on with a greater probability than this: where surfaces take no light and none escapes, it would never end.
/// What goes on has the weight of what does not, so this leaves no light out.
pub(crate) const MOST_SURVIVAL: f32 = 0.999;

/// A number that is random from place to place and the same at one.
pub(crate) fn number_of_place(place: Vec3) -> u32 {
    // 2^64 over the golden ratio mixes the digits.
    let mix = |sum: u64, digits: u32| (sum ^ u64::from(digits)).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_right(29);
    (place.to_array().map(f32::to_bits).into_iter().fold(1, mix) >> 32) as u32
}

/// Kinds of what is remembered, in the highest bits of their numbers.
pub(crate) const FOUND_PATCH: u64 = 0;
pub(crate) const FOUND_KNOT: u64 = 1 << 62;
pub(crate) const FOUND_TEXEL: u64 = 2 << 62;

/// What one worker carries from ray to ray: random points, scratch memory, counts.
#[derive(Debug)]
pub struct PathContext {
    /// Points of the node and replicate at hand.
    pub stream: Stream,
    /// Sample at hand.
    pub sample: u32,
    /// Replicate of a node at hand; `None`: there are no others to be independent of.
    pub replicate: Option<u32>,
    /// Every ray traced, lines of sight included, but those of `found`.
    pub rays: u64,
    /// What was found on the way and is remembered for all who ask later, each with the rays that it took: no other context has it.
    pub found: Vec<Found>,
    /// Trace units to what the ray at hand met first, infinite where it escaped; `None` until it is known.
    pub reach: Option<f32>,
    scratch: Scratch,
}

impl PathContext {
    /// For the given stream of points.
    pub fn new(stream: Stream) -> Self {
        PathContext {
            stream,
            sample: 0,
            replicate: None,
            rays: 0,
            found: Vec::new(),
            reach: None,
            scratch: Default::default(),
        }
    }

    /// Every ray traced.
    pub fn all_rays(&self) -> u64 {
        self.rays + self.found.iter().map(|found| u64::from(found.rays)).sum::<u64>()
    }

    /// What `work` traces is that of something that is remembered, and not of who asks. Without rays it costs nothing.
    pub(crate) fn finding<T>(&mut self, id: u64, work: impl FnOnce(&mut PathContext) -> T) -> T {
        let before = self.rays;
        let result = work(self);
        let rays = (self.rays - before) as u32;
        self.rays = before;
        if rays > 0 {
            self.found.push(Found { id, rays });
        }
        result
    }

    /// Random numbers `pair` of the sample at hand.
    pub fn point(&self, pair: u32) -> [f32; 2] {
        self.stream.point(self.sample, pair)
    }

    /// The same and a second point, see [`Stream::points`].
    pub fn points(&self, pair: u32) -> [[f32; 2]; 2] {
        self.stream.points(self.sample, pair)
    }
}
