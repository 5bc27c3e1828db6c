//! The light that probes show of a surface, remembered where many rays will ask for it.
//!
//! Triangles are cut into *patches*, as many as the rays that will ask pay for. The first ray to hit a patch (one side) has
//! its list of [candidates](Candidate) made: who can lend light there at all.
//!
//! By a rule that does not look at the node ([`BlendRule::is_seamless`](super::blend::BlendRule::is_seamless)) the blended
//! radiance of a surface point is the same for all who see it. So it is found once per *knot* of a lattice over the
//! patch, and interpolated between the three knots around a hit, which costs the same however many probes there
//! are. Knots stand at most a pixel of the best candidate apart. Lists and knots are found when first asked for, by nothing but
//! their place: the result does not depend on who asks first.
//!
//! Where the three differ (the edge of a shadow or of a probe's view, a lamp, one knot that no probe sees), the hit is
//! asked for itself, so nothing is smeared over an edge.

use glam::{Vec2, Vec3};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

use super::candidates::{Candidate, Lookers, Place};
use super::{FOUND_KNOT, FOUND_PATCH, PathContext, Radiance};
use crate::trace::{Hit, Surfaces};

/// Rays per patch that pay for its list, which costs as much as some tens of rays. Retuned by `tools/bake_bench`.
const RAYS_PER_PATCH: f64 = 256.0;
/// Patches at most, of all front sides; of all back sides as many again.
const MOST_PATCHES: f64 = (1 << 17) as f64;
/// No patch need be smaller than so many pixels of the best probe: merits hardly differ over it.
const PATCH_PIXELS: f32 = 8.0;
/// Rays per knot at which knots stand as close as they pay; and under which remembering does not pay: a knot costs what a
/// ray asks for that finds it anew. Retuned by `tools/bake_bench`.
const RAYS_PER_KNOT: [f64; 2] = [16.0, 2.0];
/// Knots stand so many pixels of the best candidate apart, where rays pay for it.
const FINEST: f32 = 0.5;
/// Where rays are too few for that, up to so many: noise hides what is lost. 1000 nodes of the box by 60 captured probes,
/// sure to 0.98 %, differed by 0.11 % from light found anew at 1, and by 0.18 % at 4, where a hundredth of the hits more were
/// remembered (`tools/bake_bench`).
const COARSEST: f32 = 0.9;
/// Knots at most, by area, of all front sides; of all back sides as many again. 32 MB each.
const MOST_KNOTS: f64 = (4 << 20) as f64;
/// The three knots agree when none differs from their mean by more than this share of it. Half: the same rays and difference,
/// within 1 %.
const AGREEMENT: f32 = 0.25;
/// Knots lie in their patch by this share of a cell, off the surfaces that meet at its edges.
const INSET: f32 = 0.05;

/// All patches of the environment.
#[derive(Debug)]
pub struct SurfaceLight {
    /// Per triangle: patches along each edge; 0: rays there ask all probes.
    cuts: Vec<u16>,
    /// Per triangle: its first patch.
    first: Vec<u32>,
    patches: Vec<[OnceLock<Patch>; 2]>,
    /// Rays that will ask, per square trace unit.
    rays: f64,
    /// Knots per square trace unit, at most.
    most_knots: f64,
}

/// One side of a patch.
#[derive(Debug)]
struct Patch {
    candidates: Box<[Candidate]>,
    /// Cells of the lattice along each edge; 0: light is not remembered.
    cells: u32,
    knots: Box<[Knot]>,
}

/// Radiance found once and read by all, in one word: nothing (0), uncovered (1), or red, green and blue in units of a common
/// power of two, that power, and whether it is a guess.
#[derive(Debug, Default)]
struct Knot(AtomicU64);

/// Binary digits of each channel: the greatest is off by at most 2^-18 of itself, and the others by as much.
const DIGITS: u32 = 18;
const UNCOVERED: u64 = 1;
/// Behind three channels and the power's 8 digits.
const GUESSED: u64 = 1 << (3 * DIGITS + 8);

/// Where a hit lies.
#[derive(Debug, Clone, Copy)]
pub struct Spot<'a> {
    patch: &'a Patch,
    /// Its number.
    id: u64,
    corner: PatchCorners,
    /// Barycentric, in the patch.
    inner: Vec2,
}

impl SurfaceLight {
    /// Nothing is found yet. `rays` will ask, all together; they fall on surfaces by area, about.
    pub fn new(lookers: &Lookers, all: &[Candidate], rays: u64) -> SurfaceLight {
        let environment = lookers.environment;
        let triangles = 0..environment.len() as u32;
        let total: f64 = triangles.clone().map(|t| f64::from(area(environment.corners(t)))).sum();
        let total = total.max(f64::MIN_POSITIVE);
        let density = (rays as f64 / RAYS_PER_PATCH).min(MOST_PATCHES) / total;
        let cuts = |triangle| {
            let corners = environment.corners(triangle);
            let most = (density * f64::from(area(corners))).sqrt().round() as u16;
            if most < 2 {
                return most;
            }
            let finest = |back| {
                let normal = environment.point(triangle, Vec2::ZERO, back).normal;
                lookers.finest_pixel(all, &Place { corners, normal, triangle })
            };
            let smallest = PATCH_PIXELS * finest(false).min(finest(true));
            most.min((longest_edge(corners) / smallest).ceil().max(1.0) as u16)
        };
        let cuts: Vec<u16> = triangles.map(cuts).collect();
        let mut count = 0;
        let mut first = Vec::with_capacity(cuts.len());
        for cuts in &cuts {
            first.push(count);
            count += u32::from(*cuts).pow(2);
        }
        let patches = (0..count).map(|_| Default::default()).collect();
        SurfaceLight { cuts, first, patches, rays: rays as f64 / total, most_knots: MOST_KNOTS / total }
    }

    /// Triangles that have patches.
    pub fn triangle_count(&self) -> usize {
        self.cuts.iter().filter(|cuts| **cuts > 0).count()
    }

    /// The patch that holds `hit`; `None` on a triangle that has none. Counts what it traces in the context.
    pub fn at(&self, hit: &Hit, lookers: &Lookers, all: &[Candidate], context: &mut PathContext) -> Option<Spot<'_>> {
        let cuts = u32::from(self.cuts[hit.triangle as usize]);
        if cuts == 0 {
            return None;
        }
        let (corner, inner) = PatchCorners::around(hit.barycentric, cuts);
        let number = self.first[hit.triangle as usize] + corner.number();
        let id = u64::from(number) << 1 | u64::from(hit.back);
        let patch = self.patches[number as usize][usize::from(hit.back)].get_or_init(|| {
            let corners = [Vec2::ZERO, Vec2::X, Vec2::Y]
                .map(|inner| lookers.environment.point(hit.triangle, corner.place(inner), hit.back).position);
            let place = Place { corners: &corners, normal: hit.normal, triangle: hit.triangle };
            context.finding(FOUND_PATCH | id, |context| self.find(lookers, all, &place, &mut context.rays))
        });
        Some(Spot { patch, id, corner, inner })
    }

    fn find(&self, lookers: &Lookers, all: &[Candidate], place: &Place, rays: &mut u64) -> Patch {
        let candidates = lookers.candidates(all, place, rays);
        let area = f64::from(area(place.corners));
        let most = RAYS_PER_KNOT.map(|rays| (self.rays / rays).min(self.most_knots) * area);
        let pixel = lookers.finest_pixel(&candidates, place);
        let cells = if lookers.blend.is_seamless() { cells(place.corners, pixel, most) } else { 0 };
        let count = if cells > 0 { knot_count(cells) } else { 0 };
        Patch { candidates, cells, knots: (0..count).map(|_| Knot::default()).collect() }
    }
}

impl Knot {
    /// What is known there, or else what `find` finds; that counts what it traces in the context, once for each knot, whoever
    /// else was about to find the same. `id` is its number.
    fn get_or_find(
        &self,
        id: u64,
        context: &mut PathContext,
        find: impl FnOnce(&mut PathContext) -> Radiance,
    ) -> Radiance {
        // Relaxed: the word is all there is.
        let known = self.0.load(Ordering::Relaxed);
        if known != 0 {
            return unpack(known);
        }
        let before = context.found.len();
        let found = pack(context.finding(id, find));
        if self.0.swap(found, Ordering::Relaxed) != 0 {
            context.found.truncate(before);
        }
        unpack(found)
    }
}

fn pack(radiance: Radiance) -> u64 {
    debug_assert!([0.0, 1.0].contains(&radiance.told()), "a surface point is seen or it is not");
    if radiance.told() == 0.0 {
        return UNCOVERED;
    }
    let value = radiance.value.clamp(Vec3::ZERO, Vec3::MAX);
    // The power of two over the greatest, by its exponent; no smaller than that the unit is an ordinary number.
    let exponent = (value.max_element().to_bits() >> 23).max(DIGITS) + 1 - DIGITS;
    let unit = f32::from_bits(exponent << 23);
    let channel = |value: f32| u64::from(((value / unit + 0.5) as u32).min((1 << DIGITS) - 1));
    channel(value.x)
        | channel(value.y) << DIGITS
        | channel(value.z) << (2 * DIGITS)
        | u64::from(exponent) << (3 * DIGITS)
        | if radiance.guessed > 0.0 { GUESSED } else { 0 }
}

fn unpack(word: u64) -> Radiance {
    if word == UNCOVERED {
        return Radiance::UNCOVERED;
    }
    let unit = f32::from_bits(((word >> (3 * DIGITS)) as u32 & 0xff) << 23);
    let channel = |number: u32| (word >> (number * DIGITS) & ((1 << DIGITS) - 1)) as f32;
    let value = Vec3::new(channel(0), channel(1), channel(2)) * unit;
    let guessed = if word & GUESSED != 0 { 1.0 } else { 0.0 };
    Radiance { value, coverage: 1.0 - guessed, guessed }
}

impl<'a> Spot<'a> {
    /// Who can lend light there.
    pub fn candidates(&self) -> &'a [Candidate] {
        &self.patch.candidates
    }

    /// Radiance at `hit`, which lies there: interpolated, or `None` where it has to be found for the hit itself. `find` does
    /// it for a knot, and counts what it traces.
    pub fn remembered(
        &self,
        environment: &Surfaces,
        hit: &Hit,
        context: &mut PathContext,
        find: impl Fn(&Hit, &mut PathContext) -> Radiance,
    ) -> Option<Radiance> {
        let Patch { cells, knots, .. } = self.patch;
        if *cells == 0 {
            return None;
        }
        let around = knots_around(self.inner, *cells);
        let found = around.map(|(i, j, _)| {
            let number = knot_number(i, j);
            let id = FOUND_KNOT | self.id << 24 | number as u64;
            knots[number].get_or_find(id, context, |context| {
                let place = self.corner.place(place(i, j, *cells));
                find(&environment.point(hit.triangle, place, hit.back), context)
            })
        });
        let mean = (found[0].value + found[1].value + found[2].value) / 3.0;
        let agree = found.iter().all(|knot| {
            (knot.coverage, knot.guessed) == (found[0].coverage, found[0].guessed)
                && (knot.value - mean).abs().max_element() <= AGREEMENT * mean.max_element()
        });
        agree.then(|| {
            let value = around.iter().zip(&found).fold(Vec3::ZERO, |sum, ((_, _, w), knot)| sum + knot.value * *w);
            Radiance { value, ..found[0] }
        })
    }
}

/// One of the equal triangles that a triangle is cut into. Lower ones have their first corner at (column, row); upper ones,
/// turned round, opposite.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct PatchCorners {
    cuts: u32,
    column: u32,
    row: u32,
    is_upper: bool,
}

impl PatchCorners {
    /// The patch around a place of the triangle, and where in the patch that is (both barycentric).
    fn around(barycentric: Vec2, cuts: u32) -> (PatchCorners, Vec2) {
        let scaled = barycentric.clamp(Vec2::ZERO, Vec2::ONE) * cuts as f32;
        let column = (scaled.x as u32).min(cuts - 1);
        let row = (scaled.y as u32).min(cuts - 1 - column);
        let inner = scaled - Vec2::new(column as f32, row as f32);
        let is_upper = inner.x + inner.y > 1.0 && column + row + 1 < cuts;
        (PatchCorners { cuts, column, row, is_upper }, if is_upper { Vec2::ONE - inner } else { inner })
    }

    /// Row by row.
    fn number(self) -> u32 {
        let above = self.cuts - self.row;
        self.cuts.pow(2) - above.pow(2) + 2 * self.column + u32::from(self.is_upper)
    }

    /// From places in the patch to places in the triangle.
    fn place(self, inner: Vec2) -> Vec2 {
        let inner = if self.is_upper { Vec2::ONE - inner } else { inner };
        (Vec2::new(self.column as f32, self.row as f32) + inner) / self.cuts as f32
    }
}

fn area([a, b, c]: &[Vec3; 3]) -> f32 {
    (b - a).cross(c - a).length() / 2.0
}

fn longest_edge([a, b, c]: &[Vec3; 3]) -> f32 {
    (b - a).length().max((c - b).length()).max((a - c).length())
}

/// Cells along an edge: as close as `most[0]` knots allow, and if that is too far apart, as few of `most[1]` as do; 0: those
/// are too few, or no probe sees the patch.
fn cells(corners: &[Vec3; 3], pixel: f32, most: [f64; 2]) -> u32 {
    let at_spacing = |pixels: f32| (longest_edge(corners) / (pixel * pixels)).ceil().max(1.0);
    // Knots: (cells + 1)(cells + 2) / 2.
    let [paid, affordable] = most.map(|most| ((0.25 + 2.0 * most).sqrt() - 1.5).floor() as f32);
    let cells = at_spacing(FINEST).min(paid).max(at_spacing(COARSEST));
    if pixel.is_finite() && cells <= affordable { cells as u32 } else { 0 }
}

/// Knot (i, j) of a patch stands at v = i / cells, w = j / cells; they are numbered by diagonals i + j.
fn knot_number(i: u32, j: u32) -> usize {
    let diagonal = (i + j) as usize;
    diagonal * (diagonal + 1) / 2 + j as usize
}

fn knot_count(cells: u32) -> usize {
    knot_number(0, cells) + 1
}

/// Barycentric place of a knot, drawn in from the edges.
fn place(i: u32, j: u32, cells: u32) -> Vec2 {
    let at = Vec2::new(i as f32, j as f32) / cells as f32;
    at + (Vec2::splat(1.0 / 3.0) - at) * (INSET / cells as f32)
}

/// The three knots around a place, with weights that sum to 1.
fn knots_around(barycentric: Vec2, cells: u32) -> [(u32, u32, f32); 3] {
    let scaled = barycentric.clamp(Vec2::ZERO, Vec2::ONE) * cells as f32;
    let i = (scaled.x as u32).min(cells - 1);
    let j = (scaled.y as u32).min(cells - 1 - i);
    let (x, y) = (scaled.x - i as f32, scaled.y - j as f32);
    if x + y <= 1.0 || i + j + 1 >= cells {
        let x = x.min(1.0);
        let y = y.min(1.0 - x);
        [(i, j, 1.0 - x - y), (i + 1, j, x), (i, j + 1, y)]
    } else {
        let (x, y) = (x.min(1.0), y.min(1.0));
        [(i + 1, j + 1, x + y - 1.0), (i, j + 1, 1.0 - x), (i + 1, j, 1.0 - y)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blocks::Found;
    use crate::sampling::{Sampler, Stream};

    #[test]
    fn a_word_holds_radiance_of_any_size() {
        assert_eq!(unpack(pack(Radiance::UNCOVERED)), Radiance::UNCOVERED);
        let mut numbers = vec![0.0, 1e-38, 1.0, 1.999_999_9, 2.0, f32::MAX];
        numbers.extend((-125..128).map(|power| 1.7 * (power as f32).exp2()));
        for &most in &numbers {
            for share in [0.0, 1e-6, 0.3, 0.999_999, 1.0] {
                let value = Vec3::new(most * share, most, 0.25 * most);
                for value in [value, Vec3::new(value.y, value.z, value.x), Vec3::new(value.z, value.x, value.y)] {
                    let word = pack(Radiance::covered(value));
                    assert!(word != 0 && word != UNCOVERED, "{value}");
                    let held = unpack(word);
                    assert_eq!(held.coverage, 1.0);
                    let off = (held.value / 4.0 - value / 4.0).abs().max_element() * 4.0;
                    assert!(off <= most * (0.5f32).powi(18) + 1e-38, "{value}: {}", held.value);
                }
            }
        }
    }

    #[test]
    fn a_knot_is_counted_once_whoever_finds_it() {
        let context = || PathContext::new(Stream::new(Sampler::Sobol, 0, 0, 0));
        let (mut first, mut second) = (context(), context());
        let knot = Knot::default();
        let light = Radiance::covered(Vec3::new(1.0, 0.5, 0.25));
        let found = knot.get_or_find(5, &mut first, |first| {
            // Another is faster.
            knot.get_or_find(5, &mut second, |second| {
                second.rays += 3;
                light
            });
            first.rays += 3;
            light
        });
        assert_eq!((found, first.all_rays(), second.all_rays()), (light, 0, 3));
        assert_eq!(second.found, [Found { id: 5, rays: 3 }]);
        assert_eq!(knot.get_or_find(5, &mut first, |_| unreachable!("it is known")), light);
    }

    #[test]
    fn every_place_lies_in_a_patch_of_its_own_number() {
        let stream = Stream::new(Sampler::Sobol, 0, 0, 0);
        for cuts in [1, 2, 3, 7] {
            let mut numbers = std::collections::BTreeMap::new();
            for sample in 0..20_000 {
                let [a, b] = stream.point(sample, 0);
                let at = if a + b > 1.0 { Vec2::new(1.0 - a, 1.0 - b) } else { Vec2::new(a, b) };
                let (patch, inner) = PatchCorners::around(at, cuts);
                assert!(inner.min_element() >= 0.0 && inner.element_sum() <= 1.0 + 1e-5, "{inner}");
                assert!((patch.place(inner) - at).length() < 1e-6, "{at} {patch:?} {inner}");
                assert_eq!(*numbers.entry(patch.number()).or_insert(patch), patch);
            }
            assert_eq!(numbers.into_keys().collect::<Vec<_>>(), (0..cuts * cuts).collect::<Vec<_>>());
        }
    }

    #[test]
    fn knots_stand_as_close_as_rays_pay_for_and_no_farther_apart_than_they_may() {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let pixel = 2.0f32.sqrt() / 10.0;
        assert_eq!(cells(&corners, pixel, [1e9, 1e9]), 20, "half a pixel");
        assert_eq!(cells(&corners, pixel, [153.0, 1e9]), 16, "153 knots are 16 cells");
        assert_eq!(cells(&corners, pixel, [1.0, 1e9]), 12, "0.9 pixels");
        assert_eq!(cells(&corners, pixel, [1.0, 90.0]), 0, "12 cells have 91 knots");
        assert_eq!(cells(&corners, f32::INFINITY, [1e9, 1e9]), 0, "nobody sees it");
    }

    #[test]
    fn interpolation_is_exact_for_linear_light_and_weights_sum_to_one() {
        let stream = Stream::new(Sampler::Sobol, 0, 0, 0);
        for cells in [1, 2, 3, 7, 100] {
            let mut numbers = std::collections::BTreeSet::new();
            for sample in 0..20_000 {
                let [a, b] = stream.point(sample, 0);
                let at = if a + b > 1.0 { Vec2::new(1.0 - a, 1.0 - b) } else { Vec2::new(a, b) };
                let around = knots_around(at, cells);
                let sum = around.iter().fold(Vec2::ZERO, |sum, &(i, j, w)| {
                    assert!(i + j <= cells, "{i} {j} of {cells}");
                    assert!((-1e-5..=1.0 + 1e-5).contains(&w), "{w}");
                    numbers.insert(knot_number(i, j));
                    sum + Vec2::new(i as f32, j as f32) / cells as f32 * w
                });
                assert!((sum - at).length() < 1e-5, "{at} {sum}");
                assert!((around.iter().map(|k| k.2).sum::<f32>() - 1.0).abs() < 1e-5);
            }
            assert!(numbers.iter().all(|n| *n < knot_count(cells)));
            assert!(cells > 50 || numbers.len() == knot_count(cells), "every knot has its number");
        }
    }
}
