//! Which directions leave a point: uniform ones, joined by ones toward what is bright.
//!
//! Multiple importance sampling by the one density of the mixture (balance heuristic; Veach, 1997, §9.2). A node's
//! directions come by four techniques: uniform; toward surfaces, as bright as they look from there; toward the sky, by
//! its light where it shows; toward emissive triangles and bright regions. How bright and where is an [`Outlook`].

mod emitters;
mod outlook;
mod regions;
mod sky;

use glam::{Mat3, Vec3};

use emitters::Shares;
pub(super) use emitters::{Emitter, Emitters, Receiver, bright_triangles, solid_angle_density};
pub use outlook::{Glance, GlanceSums, Outlook, Technique};
pub(super) use regions::{Regions, bright_regions};
pub use sky::Distant;
pub(super) use sky::Sky;
use sky::SkyImportance;

use crate::panorama::{Drawn, Tiles};
use crate::sampling::uniform_sphere;

/// Share of directions that are uniform over the sphere. The weight of no direction exceeds its inverse, whatever the
/// outlook has wrong.
pub const UNIFORM_SHARE: f32 = 0.25;

/// Where light comes from, as far as it is known before the first ray.
#[derive(Debug)]
pub struct Guide {
    sky: Option<SkyImportance>,
    /// What nodes see of the sky, where that is not the whole of it.
    sky_at_nodes: Option<SkyImportance>,
    emitters: Option<Emitters>,
    /// How much they count, 0..=2.
    emitter_weight: f32,
    /// Of directions turned by `to_local`.
    tiles: Tiles,
    to_local: Mat3,
}

/// A place that directions leave.
#[derive(Debug)]
pub struct Vantage {
    /// Trace space.
    origin: Vec3,
    /// What the emitters are to it.
    shares: Option<Shares>,
}

impl Vantage {
    fn receiver(&self) -> Receiver<'_> {
        Receiver { shares: self.shares.as_ref(), ..Receiver::node(self.origin) }
    }
}

impl Guide {
    /// Directions toward what is bright in `distant` and toward `emitters`.
    pub(super) fn new(distant: Option<&Distant>, emitters: Vec<Emitter>) -> Guide {
        let sky = distant.and_then(SkyImportance::new);
        let emitters = Emitters::new(emitters);
        let tiles = sky.as_ref().map_or_else(|| Tiles::new(64, 32), |sky| sky.tiles().clone());
        let to_local = sky.as_ref().map_or(Mat3::IDENTITY, SkyImportance::to_local);
        let emitter_weight = if emitters.is_some() { 1.0 } else { 0.0 };
        Guide {
            sky,
            sky_at_nodes: distant.and_then(SkyImportance::at_nodes),
            emitters,
            emitter_weight,
            tiles,
            to_local,
        }
    }

    /// With other numbers of directions toward emitters, if there are any: `weight`, 0..=2, times as many.
    pub(super) fn with_emitter_weight(self, weight: f32) -> Guide {
        Guide { emitter_weight: self.emitter_weight * weight, ..self }
    }

    /// Nothing is known to be bright.
    #[cfg(test)]
    pub(crate) fn nothing() -> Guide {
        Guide::new(None, Vec::new())
    }

    /// Directions go toward the distant panorama.
    pub fn to_sky(&self) -> bool {
        self.sky.is_some()
    }

    /// Triangles toward which directions go: emissive ones, and bright regions of two each.
    pub fn emitter_count(&self) -> usize {
        self.emitters.as_ref().map_or(0, Emitters::len)
    }

    /// Those that are emissive triangles.
    pub fn emissive_count(&self) -> usize {
        self.emitters.as_ref().map_or(0, Emitters::emissive_count)
    }

    pub(super) fn sky(&self) -> Option<&SkyImportance> {
        self.sky.as_ref()
    }

    pub(super) fn emitters(&self) -> Option<&Emitters> {
        self.emitters.as_ref()
    }

    /// Nothing glanced at.
    pub fn no_glances(&self) -> GlanceSums {
        GlanceSums::new(&self.tiles)
    }

    /// Adds to what is known at `place` (trace space) a glance from there or from near it.
    pub fn add_glance(&self, sums: &mut GlanceSums, place: Vec3, glance: &Glance) {
        let met = glance.origin + glance.direction * glance.distance;
        let escaped = glance.distance == f32::INFINITY;
        let direction = if escaped { glance.direction } else { (met - place).normalize_or(glance.direction) };
        let tile = self.tiles.of(&self.tiles.cell(self.to_local * direction));
        sums.add(tile, glance.brightness, escaped && self.sky.is_some());
    }

    /// All directions uniform.
    pub fn uniform_outlook(&self) -> Outlook {
        let mut outlook = self.outlook(&self.no_glances());
        outlook.share(1.0, false, 0.0);
        outlook
    }

    /// What glances tell.
    pub fn outlook(&self, glances: &GlanceSums) -> Outlook {
        let sky = self.sky_at_nodes().into_iter().flat_map(SkyImportance::light);
        let none = std::iter::repeat_n(0.0, if self.sky.is_some() { 0 } else { self.tiles.len() });
        let mut outlook = glances.outlook(&self.tiles, sky.chain(none));
        outlook.share(UNIFORM_SHARE, self.sky.is_some(), self.emitter_weight);
        outlook
    }

    /// A place (trace space) that about so many directions leave.
    pub fn vantage(&self, origin: Vec3, directions: u64) -> Vantage {
        let asked = self.emitters.as_ref().filter(|emitters| emitters.len() as u64 <= directions);
        Vantage { origin, shares: asked.map(|emitters| emitters.shares(&Receiver::node(origin))) }
    }

    /// A direction by one technique, for a point of the unit square, and w = 1/(4π p) of it, p being the density of all
    /// techniques together; w = 0 where there is none.
    pub fn propose(&self, outlook: &Outlook, technique: Technique, from: &Vantage, point: [f32; 2]) -> (Vec3, f32) {
        let direction = match technique {
            Technique::Uniform => uniform_sphere(point),
            Technique::Surfaces => {
                let (tile, point) = outlook.surfaces.choose(point);
                self.to_local.transpose() * self.tiles.uniform_in(tile, point)
            }
            Technique::Sky => {
                let sky = self.sky_at_nodes().expect("without a sky no direction goes there");
                let (tile, point) = outlook.sky.choose(point);
                let Drawn { direction, density, .. } = sky.sample_in(tile, point);
                return (direction, outlook.weight(tile, density, self.emitters_density(&from.receiver(), direction)));
            }
            Technique::Emitters => {
                let emitters = self.emitters.as_ref().expect("without emitters no direction goes there");
                let Some((direction, density)) = emitters.sample_direction(&from.receiver(), point) else {
                    // None can light this place; their share of the samples is lost.
                    return (Vec3::Y, 0.0);
                };
                let (sky, tile) = self.sky_density_and_tile(direction);
                return (direction, outlook.weight(tile, sky, density));
            }
        };
        (direction, self.weight(outlook, from, direction))
    }

    /// w = 1/(4π p) of a direction, by whatever technique it came.
    pub fn weight(&self, outlook: &Outlook, from: &Vantage, direction: Vec3) -> f32 {
        let (sky, tile) = self.sky_density_and_tile(direction);
        outlook.weight(tile, sky, self.emitters_density(&from.receiver(), direction))
    }

    fn sky_density_and_tile(&self, direction: Vec3) -> (f32, usize) {
        let cell = self.tiles.cell(self.to_local * direction);
        (self.sky_at_nodes().map_or(0.0, |sky| sky.density_in(&cell)), self.tiles.of(&cell))
    }

    /// A direction toward what is bright, whatever hides it, and its density per steradian (infinite where it is none after
    /// all: weigh it by nothing). `None` where nothing is bright.
    pub fn propose_bright(&self, origin: Vec3, [first, second]: [f32; 2]) -> Option<(Vec3, f32)> {
        let receiver = Receiver::node(origin);
        match (&self.sky, &self.emitters) {
            (None, None) => None,
            (Some(sky), None) => {
                let Drawn { direction, density, .. } = sky.sample([first, second]);
                Some((direction, density))
            }
            (None, Some(emitters)) => {
                let found = emitters.sample_direction(&receiver, [first, second]);
                Some(found.unwrap_or((Vec3::Y, f32::INFINITY)))
            }
            // Half each; what is left of the number goes on.
            (Some(sky), Some(_)) if first < 0.5 => {
                let Drawn { direction, density, .. } = sky.sample([2.0 * first, second]);
                Some((direction, 0.5 * density + 0.5 * self.emitters_density(&receiver, direction)))
            }
            (Some(sky), Some(emitters)) => {
                let found = emitters.sample_direction(&receiver, [2.0 * first - 1.0, second]);
                let both = found.map(|(direction, density)| (direction, 0.5 * density + 0.5 * sky.density(direction)));
                Some(both.unwrap_or((Vec3::Y, f32::INFINITY)))
            }
        }
    }

    /// Density per steradian with which [`Guide::propose_bright`] returns `direction`; 0 where nothing is bright.
    pub fn bright_density(&self, origin: Vec3, direction: Vec3) -> f32 {
        let sky = self.sky.as_ref().map_or(0.0, |sky| sky.density(direction));
        let emitters = self.emitters_density(&Receiver::node(origin), direction);
        if self.sky.is_some() && self.emitters.is_some() { 0.5 * (sky + emitters) } else { sky + emitters }
    }

    fn sky_at_nodes(&self) -> Option<&SkyImportance> {
        self.sky_at_nodes.as_ref().or(self.sky.as_ref())
    }

    fn emitters_density(&self, receiver: &Receiver, direction: Vec3) -> f32 {
        self.emitters.as_ref().map_or(0.0, |emitters| emitters.density(receiver, direction))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::panorama::Panorama;
    use crate::sampling::{Sampler, Stream, fibonacci_sphere};
    use crate::scene::{Material, Mesh, Scene};
    use crate::trace::{Frame, Surfaces};
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

    /// Two that overlap on one plane, and one that shines away from the origin.
    fn regions() -> Vec<Emitter> {
        let quad = |[a, b, c, d]: [Vec3; 4], radiance: f32| {
            [[a, b, c], [a, c, d]].map(|corners| Emitter::region(corners, radiance))
        };
        let on_wall = |x: f32, radiance: f32| {
            let corners = [[x, 0.2], [x, -0.3], [x + 0.4, -0.3], [x + 0.4, 0.2]];
            quad(corners.map(|[x, y]| Vec3::new(x, y, -2.0)), radiance)
        };
        let mut away = on_wall(-1.5, 300.0);
        away.iter_mut().for_each(|emitter| emitter.corners.swap(1, 2));
        [on_wall(0.1, 200.0), on_wall(0.4, 50.0), away].concat()
    }

    fn guides() -> Vec<Guide> {
        let scene = scene();
        let surfaces = Surfaces::new(&scene, |_| true, &Frame::default()).unwrap();
        let distant = distant();
        let mut sunless = distant.clone();
        sunless.extract_sun().expect("one pixel stands out");
        let lamps = || bright_triangles(&scene, &[&surfaces]).remove(0);
        vec![
            Guide::new(None, Vec::new()),
            Guide::new(Some(&sunless), Vec::new()),
            Guide::new(Some(&distant), Vec::new()),
            Guide::new(None, lamps()),
            Guide::new(Some(&distant), lamps()),
            Guide::new(Some(&distant), regions()).with_emitter_weight(0.3),
            Guide::new(None, lamps().into_iter().chain(regions()).collect()),
        ]
    }

    /// Nothing seen yet; a few glances, and those from aside; a wall all around but for one window.
    fn outlooks(guide: &Guide) -> Vec<Outlook> {
        let mut few = guide.no_glances();
        let mut window = guide.no_glances();
        for (number, direction) in fibonacci_sphere(300).into_iter().enumerate() {
            let glance =
                Glance { origin: Vec3::new(0.2, 0.0, 0.1), direction, distance: 3.0, brightness: direction.y + 1.0 };
            if number < 20 {
                guide.add_glance(&mut few, Vec3::ZERO, &glance);
            }
            let distance = if direction.z < -0.8 { f32::INFINITY } else { 1.0 };
            guide.add_glance(&mut window, Vec3::ZERO, &Glance { distance, ..glance });
        }
        [guide.no_glances(), few, window]
            .iter()
            .map(|sums| guide.outlook(sums))
            .chain([guide.uniform_outlook()])
            .collect()
    }

    #[test]
    fn density_of_all_techniques_together_integrates_to_one() {
        let directions = fibonacci_sphere(1 << 18);
        for (number, guide) in guides().iter().enumerate() {
            // With what the emitters are to it asked, and not.
            for (outlook, draws) in outlooks(guide).iter().zip([1000, 0].into_iter().cycle()) {
                let from = guide.vantage(Vec3::ZERO, draws);
                let inverse = |direction: &Vec3| 1.0 / f64::from(guide.weight(outlook, &from, *direction));
                let integral = directions.iter().map(inverse).sum::<f64>() / directions.len() as f64;
                assert!((integral - 1.0).abs() < 0.01, "guide {number}, {:?}: {integral}", outlook.shares());
            }
        }
    }

    #[test]
    fn each_technique_draws_what_its_share_of_the_density_says() {
        // Σ w over the samples of all techniques, in their shares, is the sphere, and of any part of it that part. A share
        // that its technique does not keep shows in the half where it is bright.
        for (number, guide) in guides().iter().enumerate() {
            for (outlook, draws) in outlooks(guide).iter().zip([1000, 0].into_iter().cycle()) {
                let from = guide.vantage(Vec3::ZERO, draws);
                let count = 1 << 14;
                let (mut area, mut upper) = (0.0, 0.0);
                for technique in Technique::ALL {
                    let share = f64::from(outlook.shares()[technique as usize]);
                    let stream = Stream::new(Sampler::Sobol, 0, 0, technique as u32);
                    for sample in 0..if share > 0.0 { count } else { 0 } {
                        let (direction, weight) = guide.propose(outlook, technique, &from, stream.point(sample, 0));
                        assert!((direction.length() - 1.0).abs() < 1e-5);
                        area += share * f64::from(weight) / f64::from(count);
                        upper += if direction.y > 0.0 { share * f64::from(weight) / f64::from(count) } else { 0.0 };
                    }
                }
                assert!((area - 1.0).abs() < 0.01, "guide {number}, {:?}: {area}", outlook.shares());
                assert!((upper - 0.5).abs() < 0.01, "guide {number}, {:?}: {upper}", outlook.shares());
            }
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
            let directions = fibonacci_sphere(1 << 18);
            let sum: f64 = directions.iter().map(|d| f64::from(guide.bright_density(Vec3::ZERO, *d))).sum();
            let integral = sum * 4.0 * std::f64::consts::PI / directions.len() as f64;
            assert!((integral - 1.0).abs() < 0.01, "guide {number}: {integral}");
            // Most of its samples find a density that is not the uniform's.
            let bright = (0..1000).filter(|&sample| {
                let (direction, density) = guide.propose_bright(Vec3::ZERO, stream.point(sample, 0)).unwrap();
                // On the edge of an emitter one of the two may see it and the other not, by rounding; near a sun a
                // direction of f32 moves.
                let again = guide.bright_density(Vec3::ZERO, direction);
                assert!((density / again - 1.0).abs() < 0.02, "guide {number}: {density} {again}");
                density > 0.25 * std::f32::consts::FRAC_1_PI
            });
            assert!(bright.count() > 500, "guide {number}");
        }
    }

    #[test]
    fn triangles_are_drawn_where_they_stand_out_or_chance_would_miss_them() {
        let mut scene = scene();
        let count = |scene: &Scene| {
            let surfaces = Surfaces::new(scene, |_| true, &Frame::default()).unwrap();
            bright_triangles(scene, &[&surfaces])[0].len()
        };
        assert_eq!(count(&scene), 4);
        scene.materials[0].emission = Vec3::splat(2.0);
        assert_eq!(count(&scene), 6, "most light is the wall's, and no ray from there meets what glows");
        // Another wall close before it, which glows as much.
        let mut other = scene.meshes[0].clone();
        other.positions.iter_mut().for_each(|p| *p = DVec3::new(p.y, p.x, 9.0));
        scene.meshes.push(other);
        assert_eq!(count(&scene), 2, "only the brighter lamp stands out");
        scene.materials.iter_mut().for_each(|m| m.emission = Vec3::ONE);
        assert_eq!(count(&scene), 0, "all alike");
    }
}
