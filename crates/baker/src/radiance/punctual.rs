//! Point, spot and directional lights: the irradiance they give, unhidden.
//!
//! Based on: Khronos Group, KHR_lights_punctual: candela for point and spot lights, lux for directional ones; the
//! falloff of cones and ranges is the extension's.

use glam::Vec3;

use crate::scene::{PunctualKind, PunctualLight, Scene};
use crate::trace::Frame;

/// The level's punctual lights in trace space.
#[derive(Debug)]
pub(super) struct Punctual {
    lights: Vec<Placed>,
    /// Metres per trace unit.
    metres: f32,
}

#[derive(Debug)]
struct Placed {
    position: Vec3,
    light: PunctualLight,
}

/// Light of one of them at a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arriving {
    /// Unit direction toward the light.
    pub direction: Vec3,
    /// Where it stands, trace units; `None` at infinity.
    pub position: Option<Vec3>,
    /// On a surface that faces the light.
    pub irradiance: Vec3,
}

impl Punctual {
    pub fn new(scene: &Scene, frame: &Frame) -> Punctual {
        let place = |light: &PunctualLight| Placed { position: frame.to_trace(light.position), light: light.clone() };
        Punctual { lights: scene.lights.iter().map(place).collect(), metres: frame.metres(1.0) }
    }

    /// Every light that reaches `at`, if nothing hides it.
    pub fn arriving(&self, at: Vec3) -> impl Iterator<Item = Arriving> + '_ {
        self.lights.iter().filter_map(move |placed| placed.arriving(at, self.metres))
    }
}

impl Placed {
    /// `None` where nothing arrives, and on the light itself.
    fn arriving(&self, at: Vec3, metres: f32) -> Option<Arriving> {
        let light = &self.light;
        if light.kind == PunctualKind::Directional {
            return Some(Arriving { direction: -light.direction, position: None, irradiance: light.intensity });
        }
        let line = self.position - at;
        let direction = line.try_normalize()?;
        let distance = line.length() * metres;
        let window = (1.0 - (distance / light.range).powi(4)).clamp(0.0, 1.0);
        let cone = match light.kind {
            PunctualKind::Spot { inner_cone_radians, outer_cone_radians } => {
                let (inner, outer) = (inner_cone_radians.cos(), outer_cone_radians.cos());
                let share = (-direction).dot(light.direction) - outer;
                (share / (inner - outer).max(1e-3)).clamp(0.0, 1.0).powi(2)
            }
            _ => 1.0,
        };
        let irradiance = light.intensity * (window * cone / (distance * distance));
        (irradiance != Vec3::ZERO).then_some(Arriving { direction, position: Some(self.position), irradiance })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn at(kind: PunctualKind, range: f32, place: DVec3) -> f32 {
        let light = PunctualLight {
            name: String::new(),
            kind,
            intensity: Vec3::splat(8.0),
            range,
            position: DVec3::new(0.0, 2.0, 0.0),
            direction: Vec3::NEG_Y,
        };
        let scene = Scene { lights: vec![light], ..Scene::default() };
        // Metres count, not trace units.
        let frame = Frame::of_bounds(DVec3::splat(-4.0), DVec3::splat(4.0));
        assert_ne!(frame.scale, 1.0);
        Punctual::new(&scene, &frame).arriving(frame.to_trace(place)).map(|a| a.irradiance.x).sum()
    }

    #[test]
    fn light_falls_off_as_the_extension_says() {
        let below = DVec3::ZERO;
        assert!((at(PunctualKind::Point, f32::INFINITY, below) - 2.0).abs() < 1e-5, "8 cd at 2 m");
        assert!((at(PunctualKind::Point, 4.0, below) - 2.0 * 15.0 / 16.0).abs() < 1e-5, "windowed by its range");
        assert_eq!(at(PunctualKind::Point, 1.0, below), 0.0, "beyond its range");
        assert_eq!(at(PunctualKind::Directional, f32::INFINITY, below), 8.0, "lux do not fall off");
        assert_eq!(at(PunctualKind::Point, f32::INFINITY, DVec3::new(0.0, 2.0, 0.0)), 0.0, "on the light");
        let spot = PunctualKind::Spot { inner_cone_radians: 0.3, outer_cone_radians: 0.6 };
        assert!((at(spot, f32::INFINITY, below) - 2.0).abs() < 1e-5, "inside the inner cone");
        assert_eq!(at(spot, f32::INFINITY, DVec3::new(2.0, 0.0, 0.0)), 0.0, "outside the outer cone");
        let between = at(spot, f32::INFINITY, DVec3::new(2.0 * 0.45f64.tan(), 0.0, 0.0));
        let share = (0.45f32.cos() - 0.6f32.cos()) / (0.3f32.cos() - 0.6f32.cos());
        let distance = 2.0 / 0.45f32.cos();
        assert!((between - 8.0 * share * share / (distance * distance)).abs() < 1e-4, "{between}");
    }
}
