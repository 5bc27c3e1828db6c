//! The panorama at infinity.

use glam::{Mat3, Quat, Vec3};

use crate::panorama::{Importance, Panorama, Tiles};

/// A panorama at infinity.
#[derive(Debug, Clone)]
pub struct Distant {
    /// Where to find it again: the file's name.
    pub name: String,
    /// Panorama to world.
    pub rotation: Quat,
    /// Radiance = pixel × 2^exposure_stops.
    pub exposure_stops: f32,
    /// The image.
    pub panorama: Panorama,
}

impl Distant {
    /// Nothing at infinity, and that is known.
    pub fn black() -> Distant {
        let panorama = Panorama::new(1, 1, vec![[0.0; 3]], None);
        Distant { name: "black".into(), rotation: Quat::IDENTITY, exposure_stops: 0.0, panorama }
    }
}

/// A distant panorama as rays of the world see it.
#[derive(Debug)]
pub(super) struct Sky<'a> {
    panorama: &'a Panorama,
    to_local: Mat3,
    gain: f32,
}

impl<'a> Sky<'a> {
    pub fn new(distant: &'a Distant) -> Sky<'a> {
        Sky {
            panorama: &distant.panorama,
            to_local: Mat3::from_quat(distant.rotation.inverse()),
            gain: distant.exposure_stops.exp2(),
        }
    }

    /// Radiance that arrives from the unit `direction` (world).
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        self.panorama.radiance(self.to_local * direction) * self.gain
    }
}

/// Directions toward what is bright at infinity.
#[derive(Debug)]
pub(super) struct SkyImportance {
    importance: Importance,
    to_local: Mat3,
    gain: f32,
}

impl SkyImportance {
    /// `None` for a black panorama.
    pub fn new(distant: &Distant) -> Option<SkyImportance> {
        let importance = Importance::new(&distant.panorama)?;
        let to_local = Mat3::from_quat(distant.rotation.inverse());
        Some(SkyImportance { importance, to_local, gain: distant.exposure_stops.exp2() })
    }

    /// Its tiles are of directions turned by [`SkyImportance::to_local`].
    pub fn tiles(&self) -> &Tiles {
        self.importance.tiles()
    }

    /// World to panorama.
    pub fn to_local(&self) -> Mat3 {
        self.to_local
    }

    /// Mean radiance over the sphere that comes from each tile.
    pub fn light(&self) -> impl Iterator<Item = f64> {
        let mean = self.importance.mean() * f64::from(self.gain);
        self.importance.power().iter().map(move |power| power * mean)
    }

    /// A direction (world) for a point of the unit square, and its density per steradian.
    pub fn sample(&self, point: [f32; 2]) -> (Vec3, f32) {
        let (local, density) = self.importance.sample(point);
        (self.to_local.transpose() * local, density)
    }

    /// A direction (world) in a tile, by the light in it.
    pub fn sample_in(&self, tile: usize, point: [f64; 2]) -> Vec3 {
        self.to_local.transpose() * self.importance.sample_in(tile, point).0
    }

    /// Density per steradian with which [`SkyImportance::sample`] returns `direction`.
    pub fn density(&self, direction: Vec3) -> f32 {
        self.importance.density(self.to_local * direction)
    }

    /// The same, and the tile that holds `direction`.
    pub fn density_and_tile(&self, direction: Vec3) -> (f32, usize) {
        self.importance.density_and_tile(self.to_local * direction)
    }
}
