//! Walls between nodes: which parts of a cell which of its corners can see.
//!
//! A cell in which some corner cannot see another is looked at from many places: spread over it, and on the surfaces in it.
//! From each, rays tell which corners it sees. Then up to three planes, of the surfaces that were in the way, cut the cell
//! into parts, so that places of one part agree on what they see as well as can be; a part's mask names the corners that
//! most of it sees. The runtime interpolates between those alone. A wall with two faces is cut in the middle: so places on
//! its faces fall to their own side, however thin it is. What changes light by next to nothing is left out.

use gdibl_runtime::bricks::Corners;
use gdibl_runtime::grid::trilinear;
use gdibl_runtime::walls::{BIAS, MOST_PLANES, Plane, WallCell};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};
use std::sync::atomic::{AtomicU64, Ordering};

use super::baked::{Baked, Walls};
use super::cells::Cells;
use super::irradiance::{Irradiance, irradiance_of, strength};
use crate::radiance::RadianceFunction;
use crate::trace::{Frame, Level};
use crate::{Control, Interrupted};

/// Cells that one worker looks at in a row.
const CELLS_AT_A_TIME: usize = 32;
/// Places per axis from which a cell is looked at.
pub(crate) const PER_AXIS: usize = 4;
/// Places on a surface stand off it by this share of the distance between nodes: the runtime's own bias.
const OFF_SURFACES: f32 = BIAS;
/// At least so far, trace units: some ulps.
const LEAST_OFF: f32 = 5e-4;
/// Places so far beyond a face, as a share of the cell, are in it, too: those on a surface that lies in the face.
const SLACK: f32 = 1e-3;
/// A further plane must take this share of what is wrong without any.
const LEAST_GAIN: f32 = 0.1;
/// A cell is cut if that changes irradiance in it by this, relative and on average.
pub(crate) const LEAST_CHANGE: f64 = 0.01;
/// Places before and beyond a face are off it by this share of half a cell.
const ACROSS: f32 = 0.02;
/// A corner of less weight at a face matters to nobody there.
pub(crate) const LEAST_WEIGHT: f32 = 0.05;
/// Irradiance under this share of the volume's median is black.
pub(crate) const BLACK: f64 = 1e-3;

/// Looks at every cell of a grid, sparse or not, whose nodes' light is taken at `place` (trace space). Walls, and the rays it took.
pub(super) fn find(
    cells: Cells,
    baked: &Baked,
    function: &impl RadianceFunction,
    place: impl Fn(u32) -> Vec3 + Sync,
    control: &Control,
) -> Result<(Option<Walls>, u64), Interrupted> {
    let grid = cells.grid;
    if function.level().is_empty() || baked.len() < 2 {
        return Ok((None, 0));
    }
    let frame = function.frame();
    let spacing = grid.spacing().into_iter().filter(|s| *s > 0.0).fold(f64::INFINITY, f64::min) * frame.scale;
    let off = (spacing as f32 * OFF_SURFACES).max(LEAST_OFF);
    let black = BLACK * median_irradiance(baked);
    let search = || Search { cells, frame, level: function.level(), baked, place: &place, off, black };
    let rays = AtomicU64::new(0);
    let counted = |search: &Search<_>| rays.fetch_add(search.level.take_rays(), Ordering::Relaxed);
    let cut = |search: &mut Search<_>, some: &[u32]| {
        if control.cancelled() {
            return Err(Interrupted);
        }
        let cuts: Vec<(u32, Cut)> = some.iter().filter_map(|&cell| search.cut(cell).map(|cut| (cell, cut))).collect();
        counted(search);
        Ok(cuts)
    };
    let all = cells.all();
    let found: Result<Vec<Vec<(u32, Cut)>>, Interrupted> =
        all.par_chunks(CELLS_AT_A_TIME).map_init(search, cut).collect();
    let found: Vec<(u32, Cut)> = found?.into_iter().flatten().collect();
    if found.is_empty() {
        return Ok((None, rays.into_inner()));
    }
    let walled: HashSet<u32> = found.iter().map(|(cell, _)| *cell).collect();
    let ends = |search: &mut Search<_>, (cell, cut): &(u32, Cut)| {
        let ends = search.ends(*cell, cut, &walled);
        counted(search);
        ends
    };
    let ends: Vec<Vec<u32>> = found.par_iter().map_init(search, ends).collect();
    let walls = collect(cells, frame, off, found, &ends.into_iter().flatten().collect());
    Ok((Some(walls), rays.into_inner()))
}

/// Of nodes that have light of their own.
pub(crate) fn median_irradiance(baked: &Baked) -> f64 {
    let nodes = (0..baked.len()).filter(|node| baked.is_valid(*node));
    let mut all: Vec<f64> = nodes.map(|node| strength(&irradiance_of(&baked.node(node)))).collect();
    if all.is_empty() {
        return 0.0;
    }
    let middle = all.len() / 2;
    *all.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// What all cells share.
struct Search<'a, P> {
    cells: Cells<'a>,
    frame: &'a Frame,
    level: Level<'a>,
    baked: &'a Baked,
    place: &'a P,
    off: f32,
    black: f64,
}

/// A place from which a cell is looked at.
struct Witness {
    /// Relative to the cell's middle, trace units.
    position: Vec3,
    /// Trilinear.
    weights: [f32; 8],
    /// Corners that it sees: bit k for corner k.
    seen: u8,
}

/// A plane through a cell: n·p = d, p relative to the cell's middle, trace units.
#[derive(Debug, Clone, Copy)]
struct Split {
    normal: Vec3,
    distance: f32,
}

/// How a cell is cut.
struct Cut {
    middle: Vec3,
    splits: Vec<Split>,
    masks: [u8; 1 << MOST_PLANES],
}

/// A cell's box and the nodes of its corners.
struct Cell {
    corners: Corners,
    middle: Vec3,
    half: Vec3,
    /// Where each corner's light is taken, trace space.
    places: [Vec3; 8],
    /// Corners with light of their own.
    valid: u8,
}

impl Cell {
    /// `None` outside of the cell.
    fn weights(&self, position: Vec3) -> Option<[f32; 8]> {
        let share = Vec3::from_array(std::array::from_fn(|axis| match self.half[axis] > 0.0 {
            true => 0.5 + 0.5 * position[axis] / self.half[axis],
            false => 0.5,
        }));
        let inside = share.cmpge(Vec3::splat(-SLACK)).all() && share.cmple(Vec3::splat(1.0 + SLACK)).all();
        let share = share.clamp(Vec3::ZERO, Vec3::ONE);
        inside.then(|| {
            let mut weights = trilinear(share.to_array());
            self.corners.spread(&mut weights);
            weights
        })
    }
}

impl<P: Fn(u32) -> Vec3 + Sync> Search<'_, P> {
    fn cell(&self, cell: u32) -> Cell {
        let corners = self.cells.corners(cell);
        let nodes = corners.nodes;
        let is_valid = |corner: &usize| self.baked.is_valid(nodes[*corner] as usize);
        let valid = (0..8).filter(is_valid).map(|corner| 1 << corner).sum();
        let (min, max) = self.cells.bounds(cell);
        let (min, max) = (self.frame.to_trace(min.into()), self.frame.to_trace(max.into()));
        Cell {
            corners,
            middle: (min + max) / 2.0,
            half: (max - min) / 2.0,
            places: nodes.map(|node| (self.place)(node)),
            valid,
        }
    }

    /// How to cut a cell; `None` where there is no need.
    fn cut(&self, cell: u32) -> Option<Cut> {
        let cell = self.cell(cell);
        if !self.has_wall(&cell) {
            return None;
        }
        let light = cell.corners.nodes.map(|node| irradiance_of(&self.baked.node(node as usize)));
        let (witnesses, candidates) = self.look(&cell);
        let splits = choose(&witnesses, cell.valid, candidates);
        let masks = masks(&witnesses, cell.valid, &splits);
        let (mut change, mut count) = (0.0, 0.0);
        for witness in &witnesses {
            let seen = interpolate(&witness.weights, witness.seen, &light);
            let Some(seen) = seen else { continue };
            let scale = strength(&seen).max(self.black).max(f64::MIN_POSITIVE);
            let off = |mask: u8| {
                let there = interpolate(&witness.weights, mask, &light).unwrap_or(seen);
                (strength(&std::array::from_fn(|i| there[i] - seen[i])) / scale).min(1.0)
            };
            change += off(cell.valid) - off(masks[leaf(witness.position, &splits)]);
            count += 1.0;
        }
        (change > LEAST_CHANGE * count).then_some(Cut { middle: cell.middle, splits, masks })
    }

    /// Some corner cannot see another, along the cell's edges or across it.
    fn has_wall(&self, cell: &Cell) -> bool {
        let pairs = (0..8usize).flat_map(|a| [1, 2, 4, 7].map(|bit| (a, a ^ bit)));
        let mut pairs = pairs.filter(|(a, b)| {
            a < b && cell.corners.nodes[*a] != cell.corners.nodes[*b] && cell.valid >> a & cell.valid >> b & 1 == 1
        });
        pairs.any(|(a, b)| !self.level.is_clear(cell.places[a], cell.places[b]))
    }

    /// Places in a cell with what they see, and planes of what they do not see through.
    fn look(&self, cell: &Cell) -> (Vec<Witness>, Vec<Split>) {
        let (mut witnesses, mut splits) = (Vec::new(), Vec::new());
        let mut on_surfaces = Vec::new();
        for index in 0..PER_AXIS.pow(3) {
            let position = cell.half * inner_place(index);
            let Some(witness) = self.witness(cell, position) else { continue };
            // What the runtime would read most of, and should not.
            let hidden = (0..8usize).filter(|corner| cell.valid & !witness.seen & 1 << corner != 0);
            let worst = hidden.max_by(|a, b| witness.weights[*a].total_cmp(&witness.weights[*b]));
            if let Some(worst) = worst {
                let (from, to) = (cell.middle + position, cell.places[worst]);
                let near = self.level.meet(from, to - from, 1.0);
                let far = self.level.meet(to, from - to, 1.0);
                if let (Some(near), Some(far)) = (near, far) {
                    splits.extend(splits_between([near, far].map(|met| (met.position - cell.middle, met.normal))));
                    on_surfaces.extend([near, far].map(|met| met.position - cell.middle + met.normal * self.off));
                }
            }
            witnesses.push(witness);
        }
        witnesses.extend(on_surfaces.into_iter().filter_map(|position| self.witness(cell, position)));
        let own = (0..8).filter(|corner| cell.valid & 1 << corner != 0).map(|corner| cell.places[corner] - cell.middle);
        witnesses.extend(own.filter_map(|position| self.witness(cell, position)));
        (witnesses, splits)
    }

    /// `None` outside of the cell, and where no corner is seen from: in a solid, most likely.
    fn witness(&self, cell: &Cell, position: Vec3) -> Option<Witness> {
        let weights = cell.weights(position)?;
        let from = cell.middle + position;
        let sees = |corner: &usize| {
            let to = cell.places[*corner];
            from == to || self.level.is_clear(from, to)
        };
        let corners = (0..8usize).filter(|corner| cell.valid & 1 << corner != 0);
        let seen = corners.filter(sees).map(|corner| 1 << corner).sum();
        (seen != 0).then_some(Witness { position, weights, seen })
    }

    /// Nodes at which the walls of a cell end: those of its faces to cells that are not `cut`, where it hides some of them
    /// from a place in the open.
    fn ends(&self, number: u32, cut: &Cut, walled: &HashSet<u32>) -> Vec<u32> {
        let cell = self.cell(number);
        let mut ends = Vec::new();
        for (axis, side) in [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)] {
            let beyond = self.cells.beyond(number, axis, side == 1);
            if beyond.iter().all(|beyond| walled.contains(beyond)) {
                continue;
            }
            let corners = (0..8usize).filter(|corner| corner >> axis & 1 == side);
            let hides = |index: usize| {
                // Just before the face and just beyond it, with nothing between.
                let [before, beyond] = [1.0 - ACROSS, 1.0 + ACROSS].map(|share| {
                    let mut place = inner_place(index);
                    place[axis] = if side == 1 { share } else { -share };
                    cell.half * place
                });
                if !self.level.is_clear(cell.middle + before, cell.middle + beyond) {
                    return false;
                }
                let Some(witness) = self.witness(&cell, before) else { return false };
                let mask = cut.masks[leaf(witness.position, &cut.splits)];
                let hidden = |k: usize| cell.valid & !mask & 1 << k != 0 && witness.weights[k] > LEAST_WEIGHT;
                mask != 0 && corners.clone().any(hidden)
            };
            if (0..PER_AXIS * PER_AXIS).any(hides) {
                ends.extend(corners.map(|corner| cell.corners.nodes[corner]));
            }
        }
        ends
    }
}

/// All cuts, with one table of planes. `off`: distances that differ by an eighth of it are one, trace units.
fn collect(cells: Cells, frame: &Frame, off: f32, found: Vec<(u32, Cut)>, ends: &HashSet<u32>) -> Walls {
    let mut walls = Walls::default();
    let mut numbers: HashMap<[i64; 4], u16> = HashMap::new();
    let min = DVec3::from(cells.grid.min);
    for (cell, Cut { middle, splits, masks }) in found {
        let mut planes = [WallCell::NO_PLANE; MOST_PLANES];
        let mut fits = true;
        for (plane, split) in planes.iter_mut().zip(splits) {
            let on_it = frame.to_world(middle + split.normal * split.distance) - min;
            let distance = split.normal.as_dvec3().dot(on_it);
            let quantum = f64::from(off) / frame.scale / 8.0;
            let key = [split.normal.x, split.normal.y, split.normal.z].map(|n| (f64::from(n) * 1e5).round() as i64);
            let key = [key[0], key[1], key[2], (distance / quantum).round() as i64];
            let next = walls.planes.len();
            let number = *numbers.entry(key).or_insert(next.min(usize::from(WallCell::NO_PLANE)) as u16);
            fits &= number != WallCell::NO_PLANE;
            if fits && usize::from(number) == next {
                walls.planes.push(Plane { normal: split.normal.to_array(), distance: distance as f32 });
            }
            *plane = number;
        }
        let nodes = cells.corners(cell).nodes;
        let ends = (0..8).filter(|corner| ends.contains(&nodes[*corner])).map(|corner| 1 << corner).sum();
        match fits {
            true => walls.cells.push(WallCell { cell, planes, masks, ends }),
            false => walls.dropped += 1,
        }
    }
    walls
}

/// Place number `index` of a cell (-1..1 per axis): one in each of its equal parts, jittered by the golden ratio's kin (R.
/// Roberts's R3 sequence), so that they line up with no wall.
fn inner_place(index: usize) -> Vec3 {
    let part = [index % PER_AXIS, index / PER_AXIS % PER_AXIS, index / PER_AXIS / PER_AXIS];
    let jitter = [0.819_172_5, 0.671_043_6, 0.549_700_5];
    Vec3::from_array(std::array::from_fn(|axis| {
        let within = (0.5 + index as f32 * jitter[axis]).fract();
        (part[axis] as f32 + within) / PER_AXIS as f32 * 2.0 - 1.0
    }))
}

/// Planes of the surfaces that a ray met from either end, each a place and the normal that faces its end. The two faces of
/// one wall have one plane, in the middle.
fn splits_between([(near, out), (far, back)]: [(Vec3, Vec3); 2]) -> Vec<Split> {
    let plane = |normal: Vec3, place: Vec3| {
        // Of a plane's two normals the one whose greatest part is positive.
        let largest = normal.abs().max_position();
        let normal = if normal[largest] < 0.0 { -normal } else { normal };
        Split { normal, distance: normal.dot(place) }
    };
    if out.dot(back) < -0.9 {
        let normal = (out - back).normalize_or(out);
        return vec![plane(normal, (near + far) / 2.0)];
    }
    vec![plane(out, near), plane(back, far)]
}

fn leaf(position: Vec3, splits: &[Split]) -> usize {
    let side = |(bit, split): (usize, &Split)| usize::from(split.normal.dot(position) > split.distance) << bit;
    splits.iter().enumerate().map(side).sum()
}

/// Per part of a cell and corner: the trilinear weights of the places there that see it, and of those that do not.
fn votes(witnesses: &[Witness], splits: &[Split]) -> [[[f32; 2]; 8]; 1 << MOST_PLANES] {
    let mut votes = [[[0.0; 2]; 8]; 1 << MOST_PLANES];
    for witness in witnesses {
        let own = &mut votes[leaf(witness.position, splits)];
        for (corner, vote) in own.iter_mut().enumerate() {
            let hidden = witness.seen >> corner & 1 == 0;
            vote[usize::from(hidden)] += witness.weights[corner];
        }
    }
    votes
}

/// The planes that make places of each part agree, the most useful first.
fn choose(witnesses: &[Witness], valid: u8, mut candidates: Vec<Split>) -> Vec<Split> {
    let wrong = |splits: &[Split]| -> f32 {
        let votes = votes(witnesses, splits);
        let corner = |(corner, [seen, hidden]): (usize, &[f32; 2])| match valid >> corner & 1 {
            0 => 0.0,
            _ => seen.min(*hidden),
        };
        votes.iter().map(|votes| votes.iter().enumerate().map(corner).sum::<f32>()).sum()
    };
    let mut splits = Vec::new();
    let without = wrong(&splits);
    let mut left = without;
    let mut distinct: Vec<Split> = Vec::new();
    for candidate in candidates.drain(..) {
        let is_known = |known: &Split| {
            known.normal.dot(candidate.normal) > 0.999_9 && (known.distance - candidate.distance).abs() < 1e-3
        };
        if !distinct.iter().any(is_known) {
            distinct.push(candidate);
        }
    }
    while splits.len() < MOST_PLANES && left > 0.0 {
        let with = |candidate: &Split| wrong(&[&splits[..], &[*candidate]].concat());
        let Some(best) = distinct.iter().map(|c| (with(c), *c)).min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
        if left - best.0 < LEAST_GAIN * without {
            break;
        }
        splits.push(best.1);
        left = best.0;
    }
    splits
}

/// Of each part the corners that most of it sees; if that is none, the one that is seen from most of it. A part that nothing
/// looked from has none.
fn masks(witnesses: &[Witness], valid: u8, splits: &[Split]) -> [u8; 1 << MOST_PLANES] {
    votes(witnesses, splits).map(|votes| {
        let is_seen = |corner: &usize| valid >> corner & 1 == 1 && votes[*corner][0] > votes[*corner][1];
        let mask: u8 = (0..8usize).filter(is_seen).map(|corner| 1 << corner).sum();
        let best = (0..8usize).filter(|corner| valid >> corner & 1 == 1 && votes[*corner][0] > 0.0);
        let best = best.max_by(|a, b| votes[*a][0].total_cmp(&votes[*b][0]).then(b.cmp(a)));
        if mask == 0 { best.map_or(0, |corner| 1 << corner) } else { mask }
    })
}

/// The light of the corners in `mask`; `None` where they have no weight.
fn interpolate(weights: &[f32; 8], mask: u8, light: &[Irradiance; 8]) -> Option<Irradiance> {
    let mut sum = [0.0; 27];
    let mut total = 0.0;
    for corner in (0..8).filter(|corner| mask >> corner & 1 == 1) {
        total += weights[corner];
        sum.iter_mut().zip(&light[corner]).for_each(|(sum, value)| *sum += weights[corner] * value);
    }
    (total > 1e-6).then(|| sum.map(|value| value / total))
}
