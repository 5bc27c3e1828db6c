//! A surface as a camera's ray sees it: where it is, which way it faces, what it is made of.

use glam::Vec3;

use crate::scene::{Role, Scene};
use crate::trace::{Hit, Surfaces};

/// A surface that a camera's ray has met.
#[derive(Debug, Clone, Copy)]
pub struct Seen<'a> {
    pub(super) scene: &'a Scene,
    pub(super) surfaces: &'a Surfaces,
    pub(super) hit: &'a Hit,
    /// Unit direction of the ray.
    pub(super) direction: Vec3,
}

impl Seen<'_> {
    /// Trace position.
    pub fn position(&self) -> Vec3 {
        self.hit.position
    }

    /// Environment or scene geometry.
    pub fn role(&self) -> Role {
        self.surfaces.mesh(self.scene, self.hit.triangle).role
    }

    /// Unit normal as shading sees it, on the camera's side.
    pub fn normal(&self) -> Vec3 {
        self.surfaces.shading_normal(self.scene, self.hit)
    }

    /// Emitted radiance toward the camera.
    pub fn emission(&self) -> Vec3 {
        self.surfaces.emission(self.scene, self.hit)
    }

    /// Diffuse albedo.
    pub fn albedo(&self) -> Vec3 {
        self.surfaces.albedo(self.scene, self.hit)
    }

    /// What a mirror there does to the light it reflects; `None` where there is none.
    pub fn mirror_color(&self) -> Option<Vec3> {
        self.surfaces.mirror_color(self.scene, self.hit)
    }

    /// Start (trace position) and unit direction of the ray that a mirror sends on. It leaves the triangle, whatever the
    /// shading normal says at grazing angles.
    pub fn reflected(&self) -> (Vec3, Vec3) {
        let about = |normal: Vec3| self.direction - 2.0 * self.direction.dot(normal) * normal;
        let direction = Some(about(self.normal())).filter(|d| d.dot(self.hit.normal) > 0.0);
        let direction = direction.unwrap_or_else(|| about(self.hit.normal));
        (self.surfaces.leave(self.hit), direction.normalize())
    }
}
