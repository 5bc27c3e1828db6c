//! Cameras, and the rays of their pixels.

use glam::{DVec3, Vec3};

use crate::panorama::PixelGrid;
use crate::trace::Frame;

/// Where a picture is taken from, world metres. Up is +Y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Camera {
    /// A point that looks at another.
    Pinhole {
        /// Where it stands.
        eye: DVec3,
        /// What is in the middle of the picture.
        target: DVec3,
        /// Between the upper and the lower edge, 0..180.
        vertical_fov_degrees: f64,
    },
    /// All directions, lat-long, in the world's axes: the mapping of [`crate::panorama`].
    Panorama {
        /// Where it stands.
        position: DVec3,
    },
}

/// How far towards a corner of the level's box [`Camera::inside`] stands: on the floor plan, and in height.
const TOWARD_CORNER: DVec3 = DVec3::new(0.85, 0.5, 0.85);

impl Camera {
    /// Where it stands, world metres.
    pub fn position(&self) -> DVec3 {
        match self {
            Camera::Pinhole { eye: position, .. } | Camera::Panorama { position } => *position,
        }
    }

    /// A pinhole in the corner of most x, y and z of a box, just inside, that looks at its middle.
    pub fn inside(min: DVec3, max: DVec3, vertical_fov_degrees: f64) -> Camera {
        let (target, half) = ((min + max) / 2.0, (max - min) / 2.0);
        // A box of no size is looked at from a metre away.
        let offset = if half == DVec3::ZERO { DVec3::Z } else { half * TOWARD_CORNER };
        Camera::Pinhole { eye: target + offset, target, vertical_fov_degrees }
    }

    /// Ready to send rays for a picture of this size.
    pub(super) fn lens(&self, width: usize, height: usize, frame: &Frame) -> Lens {
        let grid = PixelGrid { width, height };
        match *self {
            Camera::Panorama { position } => Lens { eye: frame.to_trace(position), grid, plane: None },
            Camera::Pinhole { eye, target, vertical_fov_degrees: fov } => {
                assert!(fov > 0.0 && fov < 180.0, "a vertical field of view of {fov} degrees");
                let forward = (target - eye).try_normalize();
                let forward = forward.unwrap_or_else(|| panic!("the camera at {eye} looks at itself: {target}"));
                // Straight up or down, +X stays on the right.
                let right = forward.cross(DVec3::Y).try_normalize().unwrap_or(DVec3::X);
                let down = forward.cross(right);
                let half = (fov.to_radians() / 2.0).tan();
                let plane = Plane { forward, right: right * (half * width as f64 / height as f64), down: down * half };
                Lens { eye: frame.to_trace(eye), grid, plane: Some(plane) }
            }
        }
    }
}

/// A camera as its rays need it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lens {
    /// Trace position.
    pub eye: Vec3,
    grid: PixelGrid,
    /// `None`: a panorama.
    plane: Option<Plane>,
}

/// The picture at distance 1: its middle, and from there to the middle of its right and lower edge.
#[derive(Debug, Clone, Copy)]
struct Plane {
    forward: DVec3,
    right: DVec3,
    down: DVec3,
}

impl Lens {
    /// Unit direction through a pixel, anywhere in its square for a uniform point of the unit square.
    pub fn direction(&self, pixel: usize, point: [f32; 2]) -> Vec3 {
        let Some(Plane { forward, right, down }) = self.plane else { return self.grid.direction(pixel, point) };
        let PixelGrid { width, height } = self.grid;
        let [across, along] = point.map(f64::from);
        // -1..1 from edge to edge.
        let x = 2.0 * ((pixel % width) as f64 + across) / width as f64 - 1.0;
        let y = 2.0 * ((pixel / width) as f64 + along) / height as f64 - 1.0;
        (forward + right * x + down * y).normalize().as_vec3()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: Frame = Frame { origin: DVec3::new(10.0, 0.0, 0.0), scale: 4.0, half: Vec3::ZERO };

    fn pinhole(eye: DVec3, target: DVec3, vertical_fov_degrees: f64) -> Lens {
        Camera::Pinhole { eye, target, vertical_fov_degrees }.lens(4, 2, &FRAME)
    }

    #[test]
    fn pinhole_looks_at_its_target_with_up_on_top_and_right_on_the_right() {
        let lens = pinhole(DVec3::new(10.0, 1.0, 2.0), DVec3::new(10.0, 1.0, -5.0), 90.0);
        assert_eq!(lens.eye, Vec3::new(0.0, 4.0, 8.0), "trace units");
        // The corner that four pixels share is the middle.
        for (pixel, point) in [(1, [1.0, 1.0]), (2, [0.0, 1.0]), (5, [1.0, 0.0]), (6, [0.0, 0.0])] {
            assert!((lens.direction(pixel, point) - Vec3::NEG_Z).length() < 1e-6, "pixel {pixel}");
        }
        // 90 degrees: up and forward are equal on the upper edge; twice as wide as high.
        let corner = lens.direction(3, [1.0, 0.0]);
        assert!((corner - Vec3::new(2.0, 1.0, -1.0).normalize()).length() < 1e-6, "{corner}");
        let corner = lens.direction(4, [0.0, 1.0]);
        assert!((corner - Vec3::new(-2.0, -1.0, -1.0).normalize()).length() < 1e-6, "{corner}");
    }

    #[test]
    fn pinhole_may_look_straight_up_and_down() {
        for target in [DVec3::Y, DVec3::NEG_Y] {
            let lens = pinhole(DVec3::ZERO, target, 60.0);
            assert!((lens.direction(1, [1.0, 1.0]) - target.as_vec3()).length() < 1e-6);
            assert!(lens.direction(3, [1.0, 1.0]).x > 0.5, "right is +X");
        }
    }

    #[test]
    fn panorama_looks_through_its_pixels() {
        let lens = Camera::Panorama { position: DVec3::new(10.0, 0.5, 0.0) }.lens(8, 4, &FRAME);
        assert_eq!(lens.eye, Vec3::new(0.0, 2.0, 0.0));
        let panorama = crate::panorama::Panorama::new(8, 4, vec![[0.0; 3]; 32], None);
        for pixel in 0..32 {
            let expected = panorama.pixel_direction(pixel % 8, pixel / 8);
            assert!((lens.direction(pixel, [0.5, 0.5]) - expected).length() < 1e-6, "pixel {pixel}");
        }
    }

    #[test]
    fn inside_stands_in_the_box_and_looks_at_its_middle() {
        for (min, max) in [
            (DVec3::new(-1.0, 0.0, -3.0), DVec3::new(1.0, 2.0, 3.0)),
            (DVec3::splat(1e6), DVec3::new(1e6 + 1.0, 1e6, 1e6 + 1.0)),
            (DVec3::ONE, DVec3::ONE),
        ] {
            let Camera::Pinhole { eye, target, .. } = Camera::inside(min, max, 60.0) else { panic!() };
            assert_eq!(target, (min + max) / 2.0);
            assert_ne!(eye, target);
            assert!(max == min || (eye.cmpge(min).all() && eye.cmple(max).all()), "{eye}");
        }
    }
}
