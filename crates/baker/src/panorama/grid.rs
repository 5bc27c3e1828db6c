//! Lat-long pixels as cameras look through them.

use glam::{DVec3, Vec3};
use std::f64::consts::{PI, TAU};

/// The pixels of a lat-long image of any size.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PixelGrid {
    pub width: usize,
    pub height: usize,
}

impl PixelGrid {
    /// A direction through a pixel, uniform over its solid angle for a uniform point of the unit square.
    pub fn direction(&self, pixel: usize, [across, down]: [f32; 2]) -> Vec3 {
        let (x, y) = (pixel % self.width, pixel / self.width);
        let longitude = TAU * (0.5 - (x as f64 + f64::from(across)) / self.width as f64);
        let edge = |row: usize| (PI * (0.5 - row as f64 / self.height as f64)).sin();
        let height = edge(y) + (edge(y + 1) - edge(y)) * f64::from(down);
        // The centre of a pixel is the middle of its angle, not of its height.
        let latitude = if down == 0.5 { PI * (0.5 - (y as f64 + 0.5) / self.height as f64) } else { height.asin() };
        let (sin, cos) = latitude.sin_cos();
        DVec3::new(cos * longitude.sin(), sin, cos * longitude.cos()).as_vec3()
    }
}
