//! Light probes, and what those who look through them need at hand.

use glam::{DVec3, Mat3, Quat, Vec3};

use crate::panorama::Panorama;
use crate::scene::Scene;
use crate::trace::{Frame, Surfaces};

/// A light probe, placed in the world.
#[derive(Debug, Clone)]
pub struct Probe {
    /// Where to find it again: the file's name.
    pub name: String,
    /// World position, metres.
    pub position: DVec3,
    /// Probe to world.
    pub rotation: Quat,
    /// Radiance = pixel × 2^exposure_stops.
    pub exposure_stops: f32,
    /// The image.
    pub panorama: Panorama,
}

/// A probe as the function uses it: in trace space, rotation turned round.
#[derive(Debug)]
pub(crate) struct PlacedProbe {
    pub position: Vec3,
    pub to_local: Mat3,
    pub gain: f32,
    /// How many.
    pub pixels: f32,
}

impl PlacedProbe {
    pub fn new(probe: &Probe, frame: &Frame) -> PlacedProbe {
        PlacedProbe {
            position: frame.to_trace(probe.position),
            to_local: Mat3::from_quat(probe.rotation.inverse()),
            gain: probe.exposure_stops.exp2(),
            pixels: (probe.panorama.width() * probe.panorama.height()) as f32,
        }
    }
}

/// Where probes and surfaces are.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Surroundings<'a> {
    pub scene: &'a Scene,
    pub frame: &'a Frame,
    pub environment: &'a Surfaces,
    pub probes: &'a [Probe],
    pub placed: &'a [PlacedProbe],
}
