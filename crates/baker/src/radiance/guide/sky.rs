//! The panorama at infinity.

use glam::{Mat3, Quat, Vec3};

use crate::panorama::{Cell, Drawn, Importance, Panorama, Sun, Tiles, take_out_sun};

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
    /// The image without its sun, which is what nodes see of it; the sun is the engine's, as a directional light. `None`: they
    /// see the whole image. Surfaces, and so what bounces, and cameras always do.
    pub without_sun: Option<Panorama>,
}

impl Distant {
    /// Nothing at infinity, and that is known.
    pub fn black() -> Distant {
        let panorama = Panorama::new(1, 1, vec![[0.0; 3]], None);
        Distant { name: "black".into(), rotation: Quat::IDENTITY, exposure_stops: 0.0, panorama, without_sun: None }
    }

    /// Takes the sun out of what nodes see, and returns it: direction in the world, exposure in its irradiance. `None`
    /// where no sun stands out; then nothing changes.
    pub fn extract_sun(&mut self) -> Option<Sun> {
        let (sun, rest) = take_out_sun(&self.panorama)?;
        self.without_sun = Some(rest);
        Some(Sun {
            direction: (self.rotation * sun.direction).normalize(),
            irradiance: sun.irradiance * self.exposure_stops.exp2(),
            ..sun
        })
    }
}

/// A distant panorama as rays of the world see it.
#[derive(Debug)]
pub(crate) struct Sky<'a> {
    panorama: &'a Panorama,
    from_nodes: &'a Panorama,
    to_local: Mat3,
    gain: f32,
}

impl<'a> Sky<'a> {
    pub fn new(distant: &'a Distant) -> Sky<'a> {
        Sky {
            panorama: &distant.panorama,
            from_nodes: distant.without_sun.as_ref().unwrap_or(&distant.panorama),
            to_local: Mat3::from_quat(distant.rotation.inverse()),
            gain: distant.exposure_stops.exp2(),
        }
    }

    /// Where in the panorama a `direction` (world) points.
    pub fn cell(&self, direction: Vec3) -> Cell {
        self.panorama.cell(self.to_local * direction)
    }

    /// Radiance that arrives from the unit `direction` (world).
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        self.radiance_in(&self.cell(direction))
    }

    /// The same from a direction in a cell.
    pub fn radiance_in(&self, cell: &Cell) -> Vec3 {
        self.panorama.radiance_in(cell) * self.gain
    }

    /// The same at a node: without the sun, if it was taken out.
    pub fn radiance_at_node(&self, direction: Vec3) -> Vec3 {
        self.from_nodes.radiance(self.to_local * direction) * self.gain
    }
}

/// Directions toward what is bright at infinity.
#[derive(Debug)]
pub(crate) struct SkyImportance {
    importance: Importance,
    to_local: Mat3,
    gain: f32,
}

impl SkyImportance {
    /// `None` for a black panorama.
    pub fn new(distant: &Distant) -> Option<SkyImportance> {
        SkyImportance::of(&distant.panorama, distant)
    }

    /// Toward what is bright once the sun is out; `None` where none was taken out, or all that is left is black.
    pub fn at_nodes(distant: &Distant) -> Option<SkyImportance> {
        SkyImportance::of(distant.without_sun.as_ref()?, distant)
    }

    fn of(panorama: &Panorama, distant: &Distant) -> Option<SkyImportance> {
        let importance = Importance::new(panorama)?;
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

    /// A direction (world) for a point of the unit square.
    pub fn sample(&self, point: [f32; 2]) -> Drawn {
        self.to_world(self.importance.sample(point))
    }

    /// A direction (world) in a tile, by the light in it. Its density is that of [`SkyImportance::sample`].
    pub fn sample_in(&self, tile: usize, point: [f64; 2]) -> Drawn {
        self.to_world(self.importance.sample_in(tile, point))
    }

    fn to_world(&self, drawn: Drawn) -> Drawn {
        Drawn { direction: self.to_local.transpose() * drawn.direction, ..drawn }
    }

    /// Density per steradian with which [`SkyImportance::sample`] returns `direction`.
    pub fn density(&self, direction: Vec3) -> f32 {
        self.density_in(&self.tiles().cell(self.to_local * direction))
    }

    /// The same for a direction in a cell.
    pub fn density_in(&self, cell: &Cell) -> f32 {
        self.importance.density(cell)
    }
}
