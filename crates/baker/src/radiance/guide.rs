//! Which directions leave a point: uniform ones, joined by ones toward what is bright.
//!
//! Multiple importance sampling by the one density of the mixture (balance heuristic; Veach, 1997, §9.2): the first
//! coordinate chooses the technique and is stretched again, so that each keeps an even share of an even sequence.

use glam::Vec3;

use super::emitters::Emitters;
use super::sky::{Distant, SkyImportance};
use crate::sampling::uniform_sphere;
use crate::scene::Scene;
use crate::trace::Surfaces;

/// Share of directions that are uniform over the sphere, where there is something bright. Half: the weight of no
/// direction exceeds two, whatever hides the bright ones from a node.
const UNIFORM_SHARE: f32 = 0.5;
/// Density of uniform directions per steradian.
const UNIFORM: f32 = 0.25 * std::f32::consts::FRAC_1_PI;

/// Where light comes from, as far as it is known before the first ray.
#[derive(Debug)]
pub struct Guide {
    sky: Option<SkyImportance>,
    /// What nodes see of the sky, where that is not the whole of it.
    sky_at_nodes: Option<SkyImportance>,
    emitters: Option<Emitters>,
    /// Up to here the first coordinate means uniform, up to there the sky, and then the emitters.
    ends: [f32; 2],
}

impl Guide {
    /// Directions toward what is bright in `distant` and on `surfaces`.
    pub(super) fn new(scene: &Scene, distant: Option<&Distant>, surfaces: &[&Surfaces]) -> Guide {
        let sky = distant.and_then(SkyImportance::new);
        let emitters = Emitters::new(scene, surfaces);
        let ends = match (&sky, &emitters) {
            (None, None) => [1.0, 1.0],
            (Some(_), None) => [UNIFORM_SHARE, 1.0],
            (None, Some(_)) => [UNIFORM_SHARE, UNIFORM_SHARE],
            (Some(_), Some(_)) => [UNIFORM_SHARE, 0.5 * (1.0 + UNIFORM_SHARE)],
        };
        Guide { sky, sky_at_nodes: distant.and_then(SkyImportance::at_nodes), emitters, ends }
    }

    /// Directions go toward the distant panorama.
    pub fn to_sky(&self) -> bool {
        self.sky.is_some()
    }

    /// Emissive triangles toward which directions go.
    pub fn emitter_count(&self) -> usize {
        self.emitters.as_ref().map_or(0, Emitters::len)
    }

    pub(super) fn sky(&self) -> Option<&SkyImportance> {
        self.sky.as_ref()
    }

    pub(super) fn emitters(&self) -> Option<&Emitters> {
        self.emitters.as_ref()
    }

    /// A direction from a node at `origin` (trace space) for a point of the unit square, and w = 1/(4π p) of it;
    /// w = 0 where there is none.
    pub fn propose(&self, origin: Vec3, point: [f32; 2]) -> (Vec3, f32) {
        self.propose_under(self.sky_at_nodes(), origin, point)
    }

    fn propose_under(&self, sky: Option<&SkyImportance>, origin: Vec3, [first, second]: [f32; 2]) -> (Vec3, f32) {
        let [uniform_end, sky_end] = self.ends;
        let (direction, density) = if first < uniform_end {
            let direction = uniform_sphere([first / uniform_end, second]);
            (direction, self.mixed(density_of(sky, direction), || self.emitter_density(origin, direction)))
        } else if let Some(sky) = sky.filter(|_| first < sky_end) {
            let (direction, density) = sky.sample([(first - uniform_end) / (sky_end - uniform_end), second]);
            (direction, self.mixed(density, || self.emitter_density(origin, direction)))
        } else {
            let emitters = self.emitters.as_ref().expect("the last share is the emitters'");
            let point = [(first - sky_end) / (1.0 - sky_end), second];
            let Some((direction, density)) = emitters.sample_direction(origin, point) else {
                // None can light this place; their share of the samples is lost.
                return (Vec3::Y, 0.0);
            };
            (direction, self.mixed(density_of(sky, direction), || density))
        };
        (direction, UNIFORM / density)
    }

    /// Density per steradian with which [`Guide::propose`] returns `direction`.
    pub fn density(&self, origin: Vec3, direction: Vec3) -> f32 {
        self.mixed(density_of(self.sky_at_nodes(), direction), || self.emitter_density(origin, direction))
    }

    /// A direction from a surface toward what is bright, none of them uniform, and its density per steradian (infinite where it is none
    /// after all: weigh it by nothing). `None` where nothing is bright.
    pub fn propose_bright(&self, origin: Vec3, [first, second]: [f32; 2]) -> Option<(Vec3, f32)> {
        let [uniform_end, _] = self.ends;
        if uniform_end == 1.0 {
            return None;
        }
        let (direction, weight) =
            self.propose_under(self.sky(), origin, [uniform_end + first * (1.0 - uniform_end), second]);
        let density = if weight > 0.0 { self.bright_density(origin, direction) } else { f32::INFINITY };
        Some((direction, density))
    }

    /// Density per steradian with which [`Guide::propose_bright`] returns `direction`; 0 where nothing is bright.
    pub fn bright_density(&self, origin: Vec3, direction: Vec3) -> f32 {
        let [uniform_end, sky_end] = self.ends;
        let mut density = 0.0;
        if sky_end > uniform_end {
            density += (sky_end - uniform_end) / (1.0 - uniform_end) * density_of(self.sky(), direction);
        }
        if sky_end < 1.0 {
            density += (1.0 - sky_end) / (1.0 - uniform_end) * self.emitter_density(origin, direction);
        }
        density
    }

    fn mixed(&self, sky: f32, emitters: impl FnOnce() -> f32) -> f32 {
        let [uniform_end, sky_end] = self.ends;
        let mut density = uniform_end * UNIFORM + (sky_end - uniform_end) * sky;
        if sky_end < 1.0 {
            density += (1.0 - sky_end) * emitters();
        }
        density
    }

    fn sky_at_nodes(&self) -> Option<&SkyImportance> {
        self.sky_at_nodes.as_ref().or(self.sky.as_ref())
    }

    fn emitter_density(&self, origin: Vec3, direction: Vec3) -> f32 {
        self.emitters.as_ref().map_or(0.0, |emitters| emitters.density(origin, direction))
    }
}

fn density_of(sky: Option<&SkyImportance>, direction: Vec3) -> f32 {
    sky.map_or(0.0, |sky| sky.density(direction))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::panorama::Panorama;
    use crate::sampling::{Sampler, Stream, fibonacci_sphere};
    use crate::scene::{Material, Mesh};
    use crate::trace::Frame;
    use glam::{DVec3, Quat};

    /// Two lamps of different power around the origin, one behind the other's edge, in a level of dark walls.
    fn scene() -> Scene {
        let quad = |center: DVec3, u: DVec3, v: DVec3, material: u32| Mesh {
            positions: vec![center - u - v, center + u - v, center + u + v, center - u + v],
            normals: vec![Vec3::Y; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            material,
            ..Mesh::default()
        };
        let glow = |emission: f32| Material { emission: Vec3::splat(emission), ..Material::default() };
        Scene {
            meshes: vec![
                quad(DVec3::Z * 8.0, DVec3::X * 10.0, DVec3::Y * 10.0, 0),
                quad(DVec3::new(0.3, 2.0, 0.0), DVec3::X * 0.3, DVec3::Z * 0.2, 1),
                quad(DVec3::new(0.5, 2.5, 0.1), DVec3::X * 0.4, DVec3::new(0.0, 0.1, 0.3), 2),
            ],
            materials: vec![Material::default(), glow(5.0), glow(50.0)],
            ..Scene::default()
        }
    }

    fn distant() -> Distant {
        let mut pixels = vec![[0.1; 3]; 32 * 16];
        pixels[5 * 32 + 9] = [500.0; 3];
        let panorama = Panorama::new(32, 16, pixels, None);
        Distant { rotation: Quat::from_rotation_x(0.5), panorama, ..Distant::black() }
    }

    fn guides() -> Vec<Guide> {
        let scene = scene();
        let surfaces = Surfaces::new(&scene, |_| true, &Frame::default()).unwrap();
        let distant = distant();
        vec![
            Guide::new(&scene, None, &[]),
            Guide::new(&scene, Some(&distant), &[]),
            Guide::new(&scene, None, &[&surfaces]),
            Guide::new(&scene, Some(&distant), &[&surfaces]),
        ]
    }

    #[test]
    fn density_integrates_to_one_and_is_that_of_the_samples() {
        let mut distant = distant();
        distant.extract_sun().expect("one pixel stands out");
        let sunless = Guide::new(&Scene::default(), Some(&distant), &[]);
        for (number, guide) in guides().iter().chain([&sunless]).enumerate() {
            // 1/p over the samples is the sphere; p over the sphere is one.
            let stream = Stream::new(Sampler::Sobol, 0, 0, 0);
            let count = 1 << 14;
            let mut area = 0.0;
            for sample in 0..count {
                let (direction, weight) = guide.propose(Vec3::ZERO, stream.point(sample, 0));
                assert!((direction.length() - 1.0).abs() < 1e-5);
                let density = guide.density(Vec3::ZERO, direction);
                // On the edge of an emitter one of the two may see it and the other not, by rounding.
                if (weight * density / UNIFORM - 1.0).abs() < 1e-3 {
                    area += f64::from(weight) / f64::from(count);
                }
            }
            assert!((area - 1.0).abs() < 0.01, "guide {number}: {area}");
            let directions = fibonacci_sphere(1 << 18);
            let sum: f64 = directions.iter().map(|d| f64::from(guide.density(Vec3::ZERO, *d))).sum();
            let integral = sum * 4.0 * std::f64::consts::PI / directions.len() as f64;
            assert!((integral - 1.0).abs() < 0.01, "guide {number}: {integral}");
        }
    }

    #[test]
    fn bright_density_integrates_to_one_and_is_that_of_the_samples() {
        for (number, guide) in guides().iter().enumerate() {
            let stream = Stream::new(Sampler::Sobol, 0, 0, 0);
            if number == 0 {
                assert_eq!(guide.propose_bright(Vec3::ZERO, stream.point(0, 0)), None, "nothing is bright");
                assert_eq!(guide.bright_density(Vec3::ZERO, Vec3::Y), 0.0);
                continue;
            }
            // Of the mixture with uniform directions it is what is left.
            for direction in fibonacci_sphere(1000) {
                let mixed = guide.density(Vec3::ZERO, direction);
                let own = UNIFORM_SHARE * UNIFORM + (1.0 - UNIFORM_SHARE) * guide.bright_density(Vec3::ZERO, direction);
                assert!((mixed / own - 1.0).abs() < 1e-5, "guide {number}: {mixed} {own}");
            }
            // Most of its samples find a density that is not the uniform's.
            let bright = (0..1000).filter(|&sample| {
                let (direction, density) = guide.propose_bright(Vec3::ZERO, stream.point(sample, 0)).unwrap();
                assert_eq!(density, guide.bright_density(Vec3::ZERO, direction));
                density > UNIFORM
            });
            assert!(bright.count() > 500, "guide {number}");
        }
    }

    #[test]
    fn dim_and_dark_triangles_are_not_drawn() {
        let mut scene = scene();
        let count = |scene: &Scene| {
            let surfaces = Surfaces::new(scene, |_| true, &Frame::default()).unwrap();
            Emitters::new(scene, &[&surfaces]).map_or(0, |emitters| emitters.len())
        };
        assert_eq!(count(&scene), 4);
        scene.materials[0].emission = Vec3::splat(2.0);
        assert_eq!(count(&scene), 2, "the wall glows: only the brighter lamp stands out");
        scene.materials.iter_mut().for_each(|m| m.emission = Vec3::ONE);
        assert_eq!(count(&scene), 0, "all alike");
    }
}
