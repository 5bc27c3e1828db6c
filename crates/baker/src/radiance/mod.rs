//! Radiance functions: (origin, direction) → radiance or uncovered. The one place where probes and geometry meet.

pub mod blend;
mod candidates;
mod effects;
pub mod gdibl;
mod guide;
pub mod path;
mod probe;
mod punctual;
mod seen;
mod surface_light;

use glam::Vec3;

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

/// Radiance that arrives along a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Radiance {
    /// Linear Rec.709, from the covered share of the ray alone.
    pub value: Vec3,
    /// Share of the ray (0..=1; partly clear surfaces divide it) whose origin some probe, the distant panorama or
    /// a light has told. The rest is *uncovered*: the integrator fills it.
    pub coverage: f32,
}

impl Radiance {
    /// Nothing is known.
    pub const UNCOVERED: Radiance = Radiance { value: Vec3::ZERO, coverage: 0.0 };

    /// Known in full.
    pub fn covered(value: Vec3) -> Radiance {
        Radiance { value, coverage: 1.0 }
    }
}

/// Who sees backs of single-sided triangles in more than this share of directions, or any backs and no light, is inside a
/// solid or outside: it may stand on a floor, and that shows its front. A dark room shows the fronts of its walls.
pub(crate) const SOLID_BACKS: f64 = 0.25;

/// No walk goes on with a greater probability than this: where surfaces take no light and none escapes, it would never end.
/// What goes on has the weight of what does not, so this leaves no light out.
pub(crate) const MOST_SURVIVAL: f32 = 0.999;

/// What one worker carries from ray to ray: random points, scratch memory, counts.
#[derive(Debug)]
pub struct PathContext {
    /// Points of the node and replicate at hand.
    pub stream: Stream,
    /// Sample at hand.
    pub sample: u32,
    /// Replicate of a node at hand; `None`: there are no others to be independent of.
    pub replicate: Option<u32>,
    /// Every ray traced, lines of sight included.
    pub rays: u64,
    /// Trace units to what the ray at hand met first, infinite where it escaped; `None` until it is known.
    pub reach: Option<f32>,
    scratch: Scratch,
}

impl PathContext {
    /// For the given stream of points.
    pub fn new(stream: Stream) -> Self {
        PathContext { stream, sample: 0, replicate: None, rays: 0, reach: None, scratch: Default::default() }
    }

    /// Random numbers `pair` of the sample at hand.
    pub fn point(&self, pair: u32) -> [f32; 2] {
        self.stream.point(self.sample, pair)
    }
}
