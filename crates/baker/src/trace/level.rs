//! The level as something to stand in: all surfaces, whatever their role, and which places see each other.

use glam::Vec3;
use std::cell::Cell;

use super::{Hit, Surfaces, counts_before, search_limit};
use crate::scene::Scene;

/// All surfaces of a level; none in plain image based lighting. For one thread: it counts its rays.
#[derive(Debug)]
pub struct Level<'a> {
    scene: &'a Scene,
    surfaces: [Option<&'a Surfaces>; 2],
    rays: Cell<u64>,
}

/// The nearest surface along a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Met {
    /// Distance in lengths of the ray's direction.
    pub t: f32,
    /// Trace position.
    pub position: Vec3,
    /// Unit geometric normal, on the ray's side.
    pub normal: Vec3,
    /// The ray met the back of the triangle, by its winding, and no front in the same place.
    pub back: bool,
    /// The triangle has a back only to close a solid: its material is single-sided.
    pub single_sided: bool,
}

impl<'a> Level<'a> {
    /// Of these surfaces of a scene.
    pub fn new(scene: &'a Scene, surfaces: [Option<&'a Surfaces>; 2]) -> Level<'a> {
        Level { scene, surfaces, rays: Cell::new(0) }
    }

    /// Rays traced since it was last asked.
    pub fn take_rays(&self) -> u64 {
        self.rays.take()
    }

    /// Without a surface.
    pub fn is_empty(&self) -> bool {
        self.surfaces.iter().all(Option::is_none)
    }

    /// Corners of all triangles, trace space.
    pub fn triangles(&self) -> impl Iterator<Item = &[Vec3; 3]> {
        self.surfaces.iter().flatten().flat_map(|surfaces| (0..surfaces.len() as u32).map(|i| surfaces.corners(i)))
    }

    /// The nearest surface along a ray (trace space) that shows itself, nearer than `t_max`.
    pub fn meet(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<Met> {
        self.rays.update(|rays| rays + 1);
        let mut nearest: Option<(Hit, &Surfaces)> = None;
        for surfaces in self.surfaces.into_iter().flatten() {
            let limit = nearest.map_or(t_max, |(hit, _)| search_limit(&hit, direction).min(t_max));
            if let Some(hit) = surfaces.shown(self.scene, origin, direction, limit)
                && nearest.is_none_or(|(old, _)| counts_before(&hit, &old))
            {
                nearest = Some((hit, surfaces));
            }
        }
        nearest.map(|(Hit { t, position, normal, back, triangle, .. }, surfaces)| {
            let single_sided = !surfaces.material(self.scene, triangle).double_sided;
            Met { t, position, normal, back, single_sided }
        })
    }

    /// Half of the light or more passes from one place to the other (trace space).
    pub fn is_clear(&self, from: Vec3, to: Vec3) -> bool {
        self.rays.update(|rays| rays + 1);
        let share = |surfaces: &Surfaces| surfaces.transmittance(self.scene, from, to, None);
        self.surfaces.into_iter().flatten().map(share).product::<Vec3>().max_element() >= 0.5
    }
}
