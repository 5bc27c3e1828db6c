//! What a place sees, tile by tile of the sphere: how bright the surfaces are there, and how much of the sky shows.
//!
//! Learned from rays that the place and its neighbours have sent already, all over the sphere. It guides further rays and
//! no more: what it has wrong costs noise, and no light.

use glam::Vec3;

use crate::panorama::{TileChoice, Tiles};

/// Rays that a tile is thought to have had beside its own: so many of the sphere's mean brightness, and so many that saw
/// the sky. A tile without a ray keeps a density that way.
const PRIOR: f64 = 0.2;
/// What a ray counts in the tiles around its own: a few hundred rays leave many tiles empty. Noise of the box (stiff) at
/// 1024 directions per node was 1.74 %, and 1.85 % with half of it.
const BLUR: f64 = 0.5;

/// A way to choose a direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Technique {
    /// Uniform over the sphere.
    Uniform,
    /// Toward bright surfaces.
    Surfaces,
    /// Toward a bright sky.
    Sky,
    /// Toward emissive triangles, and bright regions that probes show.
    Emitters,
}

impl Technique {
    /// All, in the order of [`Outlook`]'s shares.
    pub const ALL: [Technique; 4] = [Technique::Uniform, Technique::Surfaces, Technique::Sky, Technique::Emitters];
}

/// What a ray from a place met.
#[derive(Debug, Clone, Copy)]
pub struct Glance {
    /// Where it started, trace space.
    pub origin: Vec3,
    /// Unit.
    pub direction: Vec3,
    /// Trace units; infinite where it escaped.
    pub distance: f32,
    /// Mean of R, G and B of what arrived.
    pub brightness: f32,
}

/// Glances by tile: squares of the brightness of surfaces, views of the sky, and all of them. In f64: the square of 1e20 is
/// no f32.
#[derive(Debug, Clone)]
pub struct GlanceSums {
    tiles: Vec<[f64; 3]>,
}

/// What is learned.
#[derive(Debug)]
pub struct Outlook {
    /// Of each tile: density of directions toward surfaces over that of uniform ones.
    pub(super) surface_density: Vec<f32>,
    pub(super) surfaces: TileChoice,
    /// Of each tile: density of directions toward the sky over that by the sky's light alone.
    pub(super) sky_density: Vec<f32>,
    pub(super) sky: TileChoice,
    /// Light of surfaces and of the sky that is thought to arrive: mean radiance over the sphere.
    surface_light: f64,
    sky_light: f64,
    /// Share of each technique in all directions.
    shares: [f32; Technique::ALL.len()],
}

impl GlanceSums {
    /// None yet.
    pub fn new(tiles: &Tiles) -> GlanceSums {
        GlanceSums { tiles: vec![[0.0; 3]; tiles.len()] }
    }

    /// Adds one. `escaped`: the light came from the sky.
    pub(super) fn add(&mut self, tile: usize, brightness: f32, escaped: bool) {
        let square = f64::from(brightness).powi(2);
        let own = if escaped { [0.0, 1.0, 1.0] } else { [square, 0.0, 1.0] };
        self.tiles[tile].iter_mut().zip(own).for_each(|(sum, more)| *sum += more);
    }

    /// Adds those of others.
    pub fn add_all(&mut self, others: &GlanceSums) {
        for (sums, more) in self.tiles.iter_mut().zip(&others.tiles) {
            sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
        }
    }

    /// What these tell; `sky` is the mean radiance over the sphere that comes from each tile.
    pub(super) fn outlook(&self, tiles: &Tiles, sky: impl Iterator<Item = f64>) -> Outlook {
        let total = self.tiles.iter().fold([0.0; 3], |sum: [f64; 3], own| std::array::from_fn(|i| sum[i] + own[i]));
        let mean = if total[2] > 0.0 { total[0] / total[2] } else { 1.0 };
        // What a share of the samples leaves of their variance is least when it follows the root mean square.
        let learned = tiles.blur(&self.tiles, BLUR).into_iter().map(|[squares, sky, all]| {
            let scale = 1.0 / (all + PRIOR);
            (((squares + PRIOR * mean) * scale).sqrt(), (sky + PRIOR) * scale)
        });
        let (brightness, clear): (Vec<f64>, Vec<f64>) = learned.unzip();
        let surfaces: Vec<f64> =
            brightness.iter().zip(tiles.solid_angle_shares()).map(|(b, share)| b * share).collect();
        let whole: Vec<f64> = sky.collect();
        let sky: Vec<f64> = whole.iter().zip(&clear).map(|(light, clear)| light * clear).collect();
        let [surface_light, sky_light, whole] = [&surfaces, &sky, &whole].map(|light| light.iter().sum::<f64>());
        let per_light = if surface_light > 0.0 { 1.0 / surface_light } else { 0.0 };
        // Without a sky none.
        let per_sky = if whole > 0.0 { whole / sky_light } else { 0.0 };
        Outlook {
            surface_density: brightness.iter().map(|b| (b * per_light) as f32).collect(),
            surfaces: TileChoice::new(tiles, &surfaces),
            sky_density: clear.iter().map(|c| (c * per_sky) as f32).collect(),
            sky: TileChoice::new(tiles, &sky),
            surface_light,
            sky_light,
            shares: [1.0, 0.0, 0.0, 0.0],
        }
    }
}

impl Outlook {
    /// Divides directions among techniques. `emitters`, 0..=2: how much they count; at 1 they have a third of what is not
    /// uniform, at 2 two thirds.
    pub(super) fn share(&mut self, uniform: f32, sky: bool, emitters: f32) {
        let left = 1.0 - uniform;
        let emitters = emitters * left / 3.0;
        let left = left - emitters;
        let surface_root = self.surface_light.sqrt();
        let sky_root = if sky { self.sky_light.sqrt() } else { 0.0 };
        // Neither: all dark, as far as one can see.
        let share = |root: f64| if root > 0.0 { left * (root / (sky_root + surface_root)) as f32 } else { 0.0 };
        let (surfaces, sky) = (share(surface_root), share(sky_root));
        self.shares = [1.0 - surfaces - sky - emitters, surfaces, sky, emitters];
    }

    /// Share of a technique in all directions, 0..=1; they add up to 1.
    pub fn shares(&self) -> [f32; Technique::ALL.len()] {
        self.shares
    }

    /// 1/(4π p) from the densities per steradian of the sky's light and of emitters.
    pub(super) fn weight(&self, tile: usize, sky: f32, emitters: f32) -> f32 {
        const SPHERE: f32 = 4.0 * std::f32::consts::PI;
        let [uniform, surfaces, to_sky, to_emitters] = self.shares;
        let bright = to_sky * sky * self.sky_density[tile] + to_emitters * emitters;
        1.0 / (uniform + surfaces * self.surface_density[tile] + SPHERE * bright)
    }
}
