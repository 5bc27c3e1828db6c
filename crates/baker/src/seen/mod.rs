//! The error that people see: light as the runtime reads it from the file, between nodes, against the bake's own method at the same
//! places. At a node light is as right as its noise; between nodes, where an engine draws, it is not.
//!
//! Places are held out: no node stands there, in the air with normals of all directions, and on surfaces with their own. The true
//! E of a place is summed straight over its hemisphere ([`irradiance_at`]), by as many directions as a node takes. A quarter as many find
//! its light to the bands that are stored, which tells what the other bands would add.
//!
//! The noise of the truth is taken out. With d the difference at a place, t the standard error of the truth there, and v that of
//! the nodes' light, what is left is d √(s² / (s² + t²)), where s² is the square of what is to be expected of the volume's own error:
//! s² = v² + b² + max(d² - 5 (v² + t² + b²), 0). b, relative to the light, is the same for all places: it makes the median of d² what it
//! is, if errors are normal. A great difference stays, and of a small one the volume's share is left. The parts are root mean
//! squares: so their noise can be subtracted as it is.

pub mod places;

use gdibl_runtime::Volume;
use glam::{DVec3, Vec3};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::bake::{
    BakeSettings, Baked, GatherSettings, Gathered, Nodes, SparseGrid, SurfacePlace, bake, irradiance_at, irradiance_of,
    root_mean_square,
};
use crate::blocks::OwnRays;
use crate::job::records::{SeenErrors, SeenParts, SeenPlace, SeenRecord, SeenSet};
use crate::pack::{PackSettings, Precision, frame_of, part_as_read, volume_of};
use crate::radiance::RadianceFunction;
use crate::scene::Scene;
use crate::{Control, Interrupted};
use places::{in_the_air, on_surfaces};

/// The worst places of either kind are kept: 576 bytes of a file. All of them would be a twentieth of a small one.
const WORST: usize = 32;
/// Places of either kind when nothing is said: a share of the nodes, within bounds. With 256 at most the 95th percentile of an
/// apartment's surfaces came from nine places: 92 % was said, and 233 % was. An eighth of the directions at most places, so
/// that there are more of them, brought too much noise that does not show in its own spread: light that few directions meet.
const SHARE: usize = 8;
const LEAST: usize = 8;
const MOST: usize = 512;
/// Places are looked for so many times as often as they are wanted, with a few directions each: some lie in solids, or in the dark.
/// Places that are dim, where errors are greatest, may look dark: these are looked at again, with more.
const TRIES: u32 = 3;
const PILOT: u64 = 64;
const SECOND_PILOT: u64 = 256;
/// The coefficients at a place take the number of directions that E takes, divided by this.
const COEFFICIENTS: u64 = 4;
/// Places lie off their surface by so many trace units, as nodes at vertices do.
const LIFT: f32 = 5e-3;
/// Places with less than this share of the median light are left out: two surfaces touch there, and nobody looks.
const HIDDEN: f64 = 1e-3;
/// The least light that errors are relative to: a tenth of the median; and for those who set their exposure by the room's mean, the
/// share of it that is shown as mid-grey.
const FLOOR: f64 = 0.1;
const MID_GREY: f64 = 0.18;
/// What of a squared difference is over so many times what is to be expected is an error of its own.
const BEYOND: f64 = 5.0;
/// Median of the square of a normal variable of variance 1.
const MEDIAN_SQUARE: f64 = 0.4549;
/// Places have random numbers of their own.
const OWN_SEED: u64 = 0x5ee4_0000_0000;

/// Places in the open, and the light there.
#[derive(Debug)]
pub struct HeldOut {
    air: Places,
    surfaces: Places,
    rays: u64,
}

/// Places of one kind.
#[derive(Debug)]
struct Places {
    places: Vec<SurfacePlace>,
    /// E at each.
    truth: Vec<Gathered>,
    /// The light there as nodes have it.
    baked: Baked,
}

/// How many places of either kind tell the error of so many nodes.
pub fn usual_count(nodes: usize) -> usize {
    (nodes / SHARE).clamp(LEAST, MOST)
}

/// The directions that a place takes for one direction of a node that has so many, places being looked for.
pub fn work_of_a_place(samples: u64) -> f64 {
    1.0 + 1.0 / COEFFICIENTS as f64 + f64::from(TRIES) * PILOT as f64 / samples.max(PILOT) as f64
}

/// Samples up to `count` places in the air, and on surfaces, in the box of a grid, by `samples` directions each. `None`: between
/// nodes nothing is read, or no light reaches any place.
pub fn hold_out(
    nodes: &Nodes,
    scene: &Scene,
    count: usize,
    samples: u64,
    function: &impl RadianceFunction,
    settings: &BakeSettings,
    control: &Control,
) -> Result<Option<HeldOut>, Interrupted> {
    let (Nodes::Grid(grid) | Nodes::Sparse(SparseGrid { grid, .. })) = nodes else { return Ok(None) };
    let bounds = [grid.min, grid.max].map(DVec3::from);
    let tries = TRIES * count as u32;
    let lift = function.frame().metres(LIFT).into();
    let seed = settings.seed ^ OWN_SEED;
    let rays = AtomicU64::new(0);
    let progress = |places, more| {
        rays.fetch_add(more, Ordering::Relaxed);
        (control.progress)(places, more);
    };
    let blocks = OwnRays(control.blocks);
    let counted = Control { cancel: control.cancel, progress: &progress, blocks: Some(&blocks) };
    let bake_at = |places: &[SurfacePlace], samples: u64| {
        let samples = samples.clamp(1, BakeSettings::MAX_SAMPLES);
        let own = BakeSettings { samples, target_error: None, seed, coefficient_errors: false, ..settings.clone() };
        bake(&points_of(places), function, &own, &counted)
    };
    let lit = |places: &[SurfacePlace], samples: u64| -> Result<Vec<bool>, Interrupted> {
        let pilot = bake_at(places, samples)?;
        let is_lit = |node: usize| pilot.is_valid(node) && pilot.node(node).iter().any(|value| *value != 0.0);
        Ok((0..places.len()).map(is_lit).collect())
    };
    let kind = |tried: Vec<SurfacePlace>| -> Result<Places, Interrupted> {
        let mut is_lit = lit(&tried, PILOT.min(samples))?;
        let dark: Vec<usize> = (0..tried.len()).filter(|place| !is_lit[*place]).collect();
        let again: Vec<SurfacePlace> = dark.iter().map(|place| tried[*place]).collect();
        for (place, again) in dark.into_iter().zip(lit(&again, SECOND_PILOT.min(samples))?) {
            is_lit[place] = again;
        }
        let found = tried.into_iter().zip(is_lit).filter(|(_, is_lit)| *is_lit).map(|(place, _)| place);
        let places: Vec<SurfacePlace> = found.take(count).collect();
        let gather = GatherSettings { samples, seed, sampler: settings.sampler, guided: settings.importance };
        let truth = irradiance_at(&places, function, &gather, &counted)?;
        let baked = bake_at(&places, samples / COEFFICIENTS)?;
        Ok(Places { places, truth, baked })
    };
    let air = kind(in_the_air(bounds, tries, seed))?;
    let surfaces = kind(on_surfaces(scene, bounds, lift, tries, seed))?;
    let is_dark = air.places.is_empty() && surfaces.places.is_empty();
    Ok((!is_dark).then_some(HeldOut { air, surfaces, rays: rays.into_inner() }))
}

impl HeldOut {
    /// Rays that it took to know the light there.
    pub fn rays(&self) -> u64 {
        self.rays
    }

    /// The errors of a volume there, packed so, and the places where it is worst, those in the air first. Of its nodes those are looked
    /// at that stand around a place.
    pub fn errors(&self, nodes: &Nodes, baked: &Baked, packing: PackSettings) -> (SeenRecord, Vec<SeenPlace>) {
        let frame = frame_of(nodes, baked);
        let around = [&self.air, &self.surfaces].map(|places| places.around(&frame));
        let mut some: Vec<u32> = around.iter().flatten().flat_map(|(nodes, _)| *nodes).collect();
        some.sort_unstable();
        some.dedup();
        let exact = PackSettings { precision: Precision::F32, ..PackSettings::default() };
        let [file, exact] = [packing, exact].map(|packing| part_as_read(baked, packing, &some));
        let stored = Stored { frame, some, file, exact, floor: floor_of(baked), baked };
        let set = |places: &Places, around: &[Around]| set_of(&places.found(around, &stored)).unzip();
        let [(air, in_the_air), (surfaces, on_surfaces)] =
            [set(&self.air, &around[0]), set(&self.surfaces, &around[1])];
        let gdibl_runtime::format::Header { min, max, .. } = *stored.frame.header();
        let kinds = [(true, in_the_air), (false, on_surfaces)].into_iter();
        let places =
            kinds.flat_map(|(in_the_air, places)| places.into_iter().flatten().map(move |place| (in_the_air, place)));
        let places =
            places.map(|(air, (place, error))| SeenPlace::new(air, place.to_array(), error, min, max)).collect();
        (SeenRecord { air, surfaces }, places)
    }
}

/// The nodes that light is read from at a place, and their weights.
type Around = ([u32; 8], [f32; 8]);

/// A volume whose errors are asked for.
struct Stored<'a> {
    /// All of it but its light.
    frame: Volume,
    /// The nodes around places, in order.
    some: Vec<u32>,
    /// Their light as an engine reads it.
    file: Volume,
    /// The same before it was packed.
    exact: Volume,
    /// Errors of nodes are relative to this E at least.
    floor: f64,
    baked: &'a Baked,
}

impl Places {
    fn around(&self, frame: &Volume) -> Vec<Around> {
        let around = |SurfacePlace { position, normal }: &SurfacePlace| {
            frame.blended_nodes(position.to_array(), normal.to_array()).expect("places are held out of grids")
        };
        self.places.iter().map(around).collect()
    }

    fn found(&self, around: &[Around], stored: &Stored) -> Vec<Found> {
        let Stored { frame, some, file, exact, floor, baked } = stored;
        if self.places.is_empty() {
            return Vec::new();
        }
        let here = volume_of(&points_of(&self.places), &self.baked);
        let floor_here = floor_of(&self.baked);
        let found = |number: usize| {
            let SurfacePlace { position, normal } = self.places[number];
            let Gathered { irradiance: expected, standard_error, .. } = self.truth[number];
            let expected = expected.as_vec3();
            let (own, weights) = around[number];
            let own = own.map(|node| some.binary_search(&node).expect("it is around a place") as u32);
            let [stored_light, as_baked] =
                [file, exact].map(|volume| Vec3::from(volume.irradiance_of_nodes(&own, weights, normal.to_array())));
            let to_bands = here.node_sh(number).truncate(baked.bands).convolve();
            let to_bands = Vec3::from(to_bands.evaluate(normal.to_array()));
            Found {
                position,
                light: size(expected),
                difference: size(stored_light - expected),
                noise_of_truth: size(standard_error.as_vec3()),
                noise: noise_between(frame, baked, |node| error_of(baked, node, *floor), position),
                noise_here: error_of(&self.baked, number, floor_here),
                between: size(as_baked - to_bands),
                bands: size(expected - to_bands),
                packing: size(stored_light - as_baked),
                systematic: systematic_between(frame, baked, position),
            }
        };
        let is_told = |place: &usize| self.truth[*place].standard_error.is_finite();
        (0..self.places.len()).filter(is_told).map(found).collect()
    }
}

fn size_of_node(baked: &Baked, node: usize) -> f64 {
    root_mean_square(&irradiance_of(&baked.node(node)))
}

fn floor_of(baked: &Baked) -> f64 {
    FLOOR * median(baked.valid_nodes().map(|node| size_of_node(baked, node)))
}

/// Standard error of E of a node.
fn error_of(baked: &Baked, node: usize, floor: f64) -> f64 {
    f64::from(baked.relative_error[node]) * size_of_node(baked, node).max(floor)
}

fn points_of(places: &[SurfacePlace]) -> Nodes {
    Nodes::Points(places.iter().map(|place| place.position).collect())
}

/// What was found at a place. Lights and errors are root mean squares of E over red, green and blue.
struct Found {
    position: DVec3,
    light: f64,
    difference: f64,
    noise_of_truth: f64,
    /// Standard error of the light at the place to the bands that are stored.
    noise_here: f64,
    /// Standard error of the nodes' light there.
    noise: f64,
    /// Of the nodes' light against that at the place, to the bands that are stored.
    between: f64,
    bands: f64,
    packing: f64,
    /// Relative.
    systematic: f64,
}

impl Found {
    /// The difference without the noise of the truth; `usual` is the square of what errors usually are beside noise.
    fn error(&self, usual: f64) -> f64 {
        let [difference, noise, of_truth] = [self.difference, self.noise, self.noise_of_truth].map(|e| e * e);
        let expected = noise + usual;
        let own = expected + (difference - BEYOND * (expected + of_truth)).max(0.0);
        if own == 0.0 { 0.0 } else { self.difference * (own / (own + of_truth)).sqrt() }
    }
}

/// Places and their errors.
type PlacesSeen = Vec<(DVec3, f64)>;

/// `None` without a place that light reaches.
fn set_of(all: &[Found]) -> Option<(SeenSet, PlacesSeen)> {
    let hidden = HIDDEN * median(all.iter().map(|found| found.light));
    let lit: Vec<&Found> = all.iter().filter(|found| found.light > hidden).collect();
    let floor = FLOOR * median(lit.iter().map(|found| found.light));
    let mean = lit.iter().map(|found| found.light).sum::<f64>() / lit.len().max(1) as f64;
    let scale = |found: &Found| found.light.max(floor);
    let middle = |square: &dyn Fn(&Found) -> f64| median(lit.iter().map(|found| square(found) / scale(found).powi(2)));
    let noise = middle(&|found| found.noise.powi(2) + found.noise_of_truth.powi(2));
    let usual = (middle(&|found| found.difference.powi(2)) / MEDIAN_SQUARE - noise).max(0.0);
    let error = |found: &Found| found.error(usual * scale(found).powi(2));
    let relative = |found: &Found| error(found) / scale(found);
    let worst = lit.iter().max_by(|a, b| relative(a).total_cmp(&relative(b)))?;
    // Squares of parts without those of their noise, which are right in the mean alone.
    let part = |square: &dyn Fn(&Found) -> f64| {
        let sum: f64 = lit.iter().map(|found| square(found) / scale(found).powi(2)).sum();
        (sum / lit.len() as f64).max(0.0).sqrt()
    };
    let set = SeenSet {
        places: lit.len() as u64,
        error: SeenErrors::of(lit.iter().map(|found| relative(found)))?,
        error_in_grey: SeenErrors::of(lit.iter().map(|found| error(found) / found.light.max(MID_GREY * mean)))?,
        worst: worst.position.to_array(),
        parts: SeenParts {
            noise: part(&|found| found.noise.powi(2)),
            between: part(&|found| found.between.powi(2) - found.noise.powi(2) - found.noise_here.powi(2)),
            bands: part(&|found| found.bands.powi(2) - found.noise_of_truth.powi(2) - found.noise_here.powi(2)),
            packing: part(&|found| found.packing.powi(2)),
            systematic: part(&|found| (found.systematic * scale(found)).powi(2)),
        },
    };
    let mut places: PlacesSeen = lit.iter().map(|found| (found.position, relative(found))).collect();
    places.sort_by(|a, b| b.1.total_cmp(&a.1));
    places.truncate(WORST);
    Some((set, places))
}

fn size(irradiance: Vec3) -> f64 {
    (f64::from(irradiance.length_squared()) / 3.0).sqrt()
}

/// 0 of nothing.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    SeenErrors::of(values).map_or(0.0, |all| all.median)
}

/// The valid nodes around a place, and their weights, which add up to 1; none where no node is valid. Walls are not considered.
fn nodes_around(volume: &Volume, baked: &Baked, position: DVec3) -> Vec<(usize, f64)> {
    let Some(cell) = volume.cell(position.to_array()) else { return Vec::new() };
    let all = cell.nodes.iter().zip(cell.weights).map(|(node, weight)| (*node as usize, f64::from(weight)));
    let mut valid: Vec<(usize, f64)> = all.filter(|(node, _)| baked.is_valid(*node)).collect();
    let total: f64 = valid.iter().map(|(_, weight)| weight).sum();
    valid.iter_mut().for_each(|(_, weight)| *weight /= total.max(f64::MIN_POSITIVE));
    valid
}

/// Standard error of what nodes say between them; `errors` are their own.
fn noise_between(volume: &Volume, baked: &Baked, error: impl Fn(usize) -> f64, position: DVec3) -> f64 {
    let squares = nodes_around(volume, baked, position).into_iter().map(|(node, w)| (w * error(node)).powi(2));
    squares.sum::<f64>().sqrt()
}

/// Systematic error of nodes, which they share.
fn systematic_between(volume: &Volume, baked: &Baked, position: DVec3) -> f64 {
    let shares = nodes_around(volume, baked, position).into_iter();
    shares.map(|(node, w)| w * f64::from(baked.systematic_error[node])).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{Sampler, Stream};

    /// Places of light 1 with normal errors: of nodes, of the truth, and beside noise, where `beyond` tells its size.
    fn found(noise: f64, noise_of_truth: f64, beyond: impl Fn(f64) -> f64) -> (Vec<Found>, Vec<f64>) {
        let stream = Stream::new(Sampler::Random, 3, 0, 0);
        // Box and Muller, "A Note on the Generation of Random Normal Deviates", 1958.
        let normal = |[a, b]: [f32; 2]| {
            (-2.0 * f64::from(1.0 - a).ln()).sqrt() * (2.0 * std::f64::consts::PI * f64::from(b)).cos()
        };
        let place = |i: u32| {
            let size = beyond(stream.point(i, 2)[0].into());
            let own = normal(stream.point(i, 0)) * noise.hypot(size);
            let difference = (own + normal(stream.point(i, 1)) * noise_of_truth).abs();
            let found = Found {
                position: DVec3::ZERO,
                light: 1.0,
                difference,
                noise_of_truth,
                noise_here: 0.0,
                noise,
                between: 0.0,
                bands: 0.0,
                packing: 0.0,
                systematic: 0.0,
            };
            (found, own.abs())
        };
        (0..20_000).map(place).unzip()
    }

    #[test]
    fn the_error_is_the_volumes_own_without_the_noise_of_the_truth() {
        type Size = fn(f64) -> f64;
        let sizes: [(&str, Size); 5] = [
            ("noise alone", |_| 0.0),
            ("small", |_| 0.005),
            ("as large as noise", |_| 0.01),
            ("large", |_| 0.04),
            ("large in places", |u| if u < 0.1 { 0.04 } else { 0.003 }),
        ];
        for (name, size) in sizes {
            for (noise, noise_of_truth) in [(0.0055, 0.007), (0.003, 0.007), (0.0055, 0.01)] {
                let (found, own) = found(noise, noise_of_truth, size);
                let said = set_of(&found).expect("places that are lit").0.error;
                let own = SeenErrors::of(own.into_iter()).expect("as many");
                for (which, said, is) in [("median", said.median, own.median), ("95 %", said.p95, own.p95)] {
                    let ratio = said / is;
                    assert!((1.0 / 1.3..1.3).contains(&ratio), "{name}, {noise} {noise_of_truth}, {which}: {ratio}");
                }
            }
        }
    }
}
