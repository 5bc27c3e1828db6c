//! Radiance functions: (origin, direction) → radiance or uncovered. The one place where probes and geometry meet.

pub mod blend;
mod effects;
pub mod gdibl;

use glam::Vec3;

use crate::sampling::Stream;

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

/// What one worker carries from ray to ray: random points, scratch memory, counts.
#[derive(Debug)]
pub struct PathContext {
    /// Points of the node and replicate at hand.
    pub stream: Stream,
    /// Sample at hand.
    pub sample: u32,
    /// Every ray traced, lines of sight included.
    pub rays: u64,
    scratch: gdibl::Scratch,
}

impl PathContext {
    /// For the given stream of points.
    pub fn new(stream: Stream) -> Self {
        PathContext { stream, sample: 0, rays: 0, scratch: Default::default() }
    }
}
