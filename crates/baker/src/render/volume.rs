//! What a picture takes from a baked volume: light of surfaces, as an engine shows it; figures of nodes in its place; and the nodes
//! themselves, as spheres.

use gdibl_runtime::Volume;
use glam::{DVec3, Vec3};
use std::collections::HashMap;
use std::f32::consts::FRAC_1_PI;

use super::heat::Scale;
use crate::trace::Frame;

/// A volume in a picture.
#[derive(Debug, Clone)]
pub struct VolumeLight<'a> {
    /// Reads its light.
    pub volume: &'a Volume,
    /// It lights scene geometry alone, the rest is the radiance function's.
    pub objects_only: bool,
    /// What surfaces show in place of light.
    pub figures: Option<Figures<'a>>,
    /// Spheres to draw.
    pub spheres: Vec<Sphere>,
}

/// One number per node, and its colours.
#[derive(Debug, Clone, Copy)]
pub struct Figures<'a> {
    /// By node; negative: the node has none.
    pub values: &'a [f32],
    /// `None`: the numbers themselves, for tools.
    pub scale: Option<Scale>,
}

/// A sphere in a picture, world metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// Its middle.
    pub centre: DVec3,
    /// Above 0.
    pub radius: f64,
    /// What it shows.
    pub look: SphereLook,
}

/// What a sphere shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SphereLook {
    /// The light of a node on a white surface.
    Light(usize),
    /// One colour, linear.
    Plain([f32; 3]),
}

/// A figure of a node that has none.
const GREY: Vec3 = Vec3::splat(0.2);

impl<'a> VolumeLight<'a> {
    /// Every surface in the volume's light.
    pub fn of(volume: &'a Volume) -> VolumeLight<'a> {
        VolumeLight { volume, objects_only: false, figures: None, spheres: Vec::new() }
    }

    /// What a surface sends to the camera.
    pub(super) fn surface(&self, position: DVec3, normal: Vec3, albedo: Vec3, emission: Vec3) -> Vec3 {
        match &self.figures {
            Some(figures) => figures.shown(figures.at(self.volume, position, normal)),
            None => emission + albedo * self.irradiance(position, normal) * FRAC_1_PI,
        }
    }

    fn irradiance(&self, position: DVec3, normal: Vec3) -> Vec3 {
        // A few bands ring below 0 on the side away from something bright.
        Vec3::from(self.volume.irradiance_f64(position.to_array(), normal.to_array())).max(Vec3::ZERO)
    }

    /// Light without a direction, mean over six normals, on a white surface; or the figure.
    pub(super) fn everywhere(&self, position: DVec3) -> Vec3 {
        if let Some(figures) = &self.figures {
            return figures.shown(figures.at(self.volume, position, Vec3::Y));
        }
        let axes = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
        axes.into_iter().map(|normal| self.irradiance(position, normal)).sum::<Vec3>() * (FRAC_1_PI / 6.0)
    }

    /// What a sphere sends to the camera.
    pub(super) fn sphere(&self, look: SphereLook, normal: Vec3) -> Vec3 {
        match look {
            SphereLook::Plain(colour) => colour.into(),
            SphereLook::Light(node) => {
                let light = self.volume.node_sh(node).convolve().evaluate(normal.to_array());
                Vec3::from(light).max(Vec3::ZERO) * FRAC_1_PI
            }
        }
    }
}

impl Figures<'_> {
    /// Of the nodes around a place, as far as they have one.
    fn at(&self, volume: &Volume, position: DVec3, normal: Vec3) -> f32 {
        let Some(cell) = volume.cell(position.to_array()) else {
            let nearest = volume.nearest_node(position.to_array(), normal.to_array());
            return nearest.map_or(-1.0, |node| self.values[node]);
        };
        let known = cell.nodes.iter().zip(cell.weights).map(|(node, weight)| (self.values[*node as usize], weight));
        let known = known.filter(|(value, _)| *value >= 0.0);
        let (sum, total) =
            known.fold((0.0, 0.0), |(sum, total), (value, weight)| (sum + value * weight, total + weight));
        if total > 1e-3 { sum / total } else { -1.0 }
    }

    /// As a picture holds it, linear.
    pub fn shown(&self, value: f32) -> Vec3 {
        match self.scale {
            None => Vec3::splat(value.max(0.0)),
            Some(_) if value < 0.0 => GREY,
            Some(scale) => scale.colour(value).into(),
        }
    }
}

/// Spheres, ready for rays: each cube of a lattice knows those that reach into it.
#[derive(Debug)]
pub(super) struct Spheres {
    /// Trace units.
    spheres: Vec<(Vec3, f32, SphereLook)>,
    cubes: HashMap<[i32; 3], Vec<u32>>,
    edge: f32,
    low: Vec3,
    high: Vec3,
}

impl Spheres {
    /// `None` of none.
    pub fn new(spheres: &[Sphere], frame: &Frame) -> Option<Spheres> {
        let scale = frame.scale as f32;
        let spheres: Vec<_> =
            spheres.iter().map(|s| (frame.to_trace(s.centre), s.radius as f32 * scale, s.look)).collect();
        let smallest = spheres.iter().map(|sphere| sphere.1).reduce(f32::min)?;
        // As wide as a few of the small ones: most cubes hold one or none.
        let edge = 6.0 * smallest;
        let (mut low, mut high) = (Vec3::MAX, Vec3::MIN);
        let mut cubes: HashMap<[i32; 3], Vec<u32>> = HashMap::new();
        for (number, (centre, radius, _)) in spheres.iter().enumerate() {
            let (from, to) = (*centre - *radius, *centre + *radius);
            (low, high) = (low.min(from), high.max(to));
            let [a, b] = [from, to].map(|corner| cube_of(corner, edge));
            for x in a[0]..=b[0] {
                for y in a[1]..=b[1] {
                    (a[2]..=b[2]).for_each(|z| cubes.entry([x, y, z]).or_default().push(number as u32));
                }
            }
        }
        Some(Spheres { spheres, cubes, edge, low, high })
    }

    /// The nearest sphere along a ray, `direction` of length 1: how far, its normal there, and what it shows.
    pub fn nearest(&self, origin: Vec3, direction: Vec3) -> Option<(f32, Vec3, SphereLook)> {
        // Between where the ray enters the box of all and where it leaves it.
        let inverse = direction.recip();
        let (a, b) = ((self.low - origin) * inverse, (self.high - origin) * inverse);
        let start = a.min(b).max_element().max(0.0);
        let end = a.max(b).min_element();
        if start.is_nan() || end.is_nan() || start > end {
            return None;
        }
        // From cube to cube (Amanatides and Woo, "A Fast Voxel Traversal Algorithm", 1987).
        let mut cube = cube_of(origin + direction * start, self.edge);
        loop {
            let leaves = |axis: usize| {
                let face = if direction[axis] > 0.0 { cube[axis] + 1 } else { cube[axis] };
                let t = (face as f32 * self.edge - origin[axis]) * inverse[axis];
                if t.is_nan() { f32::INFINITY } else { t }
            };
            let axis = (0..3).min_by(|a, b| leaves(*a).total_cmp(&leaves(*b))).unwrap_or(0);
            let next = leaves(axis);
            let own = self.cubes.get(&cube).into_iter().flatten().map(|number| &self.spheres[*number as usize]);
            let hits = own
                .filter_map(|(centre, radius, look)| Some((hit(origin, direction, *centre, *radius)?, centre, look)));
            // A sphere that is met in a later cube waits for it.
            let found = hits.filter(|(t, ..)| *t <= next).min_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((t, centre, look)) = found {
                let normal = (origin + direction * t - *centre).normalize_or(-direction);
                return Some((t, normal, *look));
            }
            if next > end {
                return None;
            }
            cube[axis] += if direction[axis] > 0.0 { 1 } else { -1 };
        }
    }
}

fn cube_of(place: Vec3, edge: f32) -> [i32; 3] {
    (place / edge).floor().to_array().map(|cell| cell as i32)
}

/// How far a ray goes to a sphere from outside.
fn hit(origin: Vec3, direction: Vec3, centre: Vec3, radius: f32) -> Option<f32> {
    let to = centre - origin;
    let along = to.dot(direction);
    let away = (to - direction * along).length_squared();
    let half = radius * radius - away;
    let t = along - half.max(0.0).sqrt();
    (half > 0.0 && t > 0.0).then_some(t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{Sampler, Stream};

    #[test]
    fn rays_meet_the_sphere_that_trying_all_of_them_finds() {
        let stream = Stream::new(Sampler::Random, 7, 0, 0);
        let vector = |i: u32, pair: u32| {
            let [[x, y], [z, _]] = [stream.point(i, pair), stream.point(i, pair + 1)];
            Vec3::new(x, y, z) * 2.0 - 1.0
        };
        let colour = |i: usize| [i as f32, 0.0, 0.0];
        let spheres: Vec<Sphere> = (0..200)
            .map(|i| Sphere {
                centre: (vector(i, 0) * 5.0).as_dvec3(),
                radius: 0.05 + 0.3 * f64::from(stream.point(i, 4)[0]),
                look: SphereLook::Plain(colour(i as usize)),
            })
            .collect();
        let built = Spheres::new(&spheres, &Frame::default()).unwrap();
        let mut met = 0;
        for i in 0..2000 {
            let (origin, direction) = (vector(i, 6) * 8.0, vector(i, 8).normalize_or(Vec3::X));
            let slow = spheres
                .iter()
                .enumerate()
                .filter_map(|(k, s)| Some((hit(origin, direction, s.centre.as_vec3(), s.radius as f32)?, k)))
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let fast = built.nearest(origin, direction).map(|(t, _, look)| (t, look));
            assert_eq!(fast, slow.map(|(t, k)| (t, SphereLook::Plain(colour(k)))), "ray {i}");
            met += usize::from(slow.is_some());
        }
        assert!(met > 50, "{met} rays met a sphere");
    }
}
