//! Walls of a coarser volume, fitted to what the finer one says.
//!
//! There is no level to look at, but there is its light: in every cell that walls of the finer volume reach into, planes are taken of
//! those walls, and masks for the parts between them, so that the cell says what the finer volume says at places spread over it.

use gdibl_runtime::Volume;
use gdibl_runtime::grid::trilinear;
use gdibl_runtime::walls::{MOST_PLANES, Plane, WallCell};
use glam::DVec3;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap, HashSet};

use super::part::Part;
use crate::bake::walls::{BLACK, LEAST_CHANGE, LEAST_WEIGHT, PER_AXIS, median_irradiance};
use crate::bake::{Cells, Irradiance, Walls, difference, irradiance_of, strength};

/// A further plane must take this share of what is off without any.
const LEAST_GAIN: f64 = 0.1;
/// A fine cell reaches into the coarse ones that its corners lie in, drawn in by this share of its half.
const INSET: f64 = 0.02;
/// What is off must fall by this for each corner that is hidden.
const HIDING: f32 = 1e-3;
/// Places beside planes are off them by this share of the cell.
const OFF_PLANES: f64 = 2e-3;
/// Places before and beyond a face are off it by this share of half a cell.
const ACROSS: f64 = 0.02;
/// Between them is no wall if light differs by less.
const ALIKE: f64 = 0.1;

/// Walls of `part`, a coarser `volume`. `None` where none are needed.
pub(super) fn fit(part: &Part, volume: &Volume) -> Option<Walls> {
    let (planes, walled) = volume.wall_tables();
    let cells = Cells::of(&part.nodes).filter(|_| !walled.is_empty())?;
    let fit = Fit { part, volume, cells, planes, black: BLACK * median_irradiance(&part.baked) };
    let cuts: Vec<(u32, Cut)> = fit
        .candidates(walled)
        .into_par_iter()
        .filter_map(|(cell, candidates)| fit.cut(cell, candidates).map(|cut| (cell, cut)))
        .collect();
    let numbers: HashSet<u32> = cuts.iter().map(|(cell, _)| *cell).collect();
    let ends: HashSet<u32> = cuts.par_iter().flat_map_iter(|(cell, cut)| fit.ends(*cell, cut, &numbers)).collect();
    if cuts.is_empty() {
        return None;
    }
    let mut walls = Walls::default();
    let mut known: HashMap<u16, u16> = HashMap::new();
    for (cell, cut) in cuts {
        let mut own = [WallCell::NO_PLANE; MOST_PLANES];
        for (own, plane) in own.iter_mut().zip(&cut.planes) {
            *own = *known.entry(*plane).or_insert_with(|| {
                walls.planes.push(planes[usize::from(*plane)]);
                walls.planes.len() as u16 - 1
            });
        }
        let nodes = cells.corners(cell).nodes;
        let ends = (0..8).filter(|corner| ends.contains(&nodes[*corner])).map(|corner| 1 << corner).sum();
        walls.cells.push(WallCell { cell, planes: own, masks: cut.masks, ends });
    }
    Some(walls)
}

/// How a cell is cut.
struct Cut {
    planes: Vec<u16>,
    masks: [u8; 1 << MOST_PLANES],
}

/// A place in a cell.
struct Witness {
    /// Relative to the box's min.
    place: DVec3,
    /// By mask: what those corners say there is off what the finer volume does, 0..=1.
    off: [f32; 256],
}

struct Fit<'a> {
    part: &'a Part,
    volume: &'a Volume,
    cells: Cells<'a>,
    planes: &'a [Plane],
    black: f64,
}

impl Fit<'_> {
    /// The cells that walls of the finer volume reach into, and the planes of those.
    fn candidates(&self, walled: &[WallCell]) -> Vec<(u32, Vec<u16>)> {
        let mut found: BTreeMap<u32, Vec<u16>> = BTreeMap::new();
        let fine = self.volume.grid().expect("walls stand in grids");
        for wall in walled {
            let width = self.volume.bricks().map_or(1, |bricks| 1 << bricks.leaf(fine.place_of(wall.cell)).level);
            let place = fine.place_of(wall.cell);
            let is_flat = |axis: usize| fine.counts[axis] == 1;
            let end = std::array::from_fn(|axis| place[axis] + if is_flat(axis) { 0 } else { width });
            let [low, high] = [place, end].map(|place| DVec3::from(fine.place_position(place)));
            let mut inside: Vec<u32> = (0..8)
                .map(|corner| {
                    let side = DVec3::from_array(std::array::from_fn(|axis| f64::from(corner >> axis & 1)));
                    self.cell_at(low + (high - low) * (INSET / 2.0 + (1.0 - INSET) * side))
                })
                .collect();
            inside.sort_unstable();
            inside.dedup();
            for cell in inside {
                found.entry(cell).or_default().extend(wall.planes.iter().filter(|plane| **plane != WallCell::NO_PLANE));
            }
        }
        found.values_mut().for_each(|planes| {
            planes.sort_unstable();
            planes.dedup();
        });
        found.into_iter().collect()
    }

    /// The cell that a position in the box lies in.
    fn cell_at(&self, position: DVec3) -> u32 {
        let grid = self.cells.grid;
        let place = std::array::from_fn(|axis| {
            let extent = grid.max[axis] - grid.min[axis];
            let last = grid.counts[axis].max(2) - 2;
            let share = if extent > 0.0 { (position[axis] - grid.min[axis]) / extent } else { 0.0 };
            // Casts saturate.
            ((share * f64::from(grid.counts[axis] - 1)) as u32).min(last)
        });
        self.cells.cell_of(place)
    }

    /// How to cut a cell; `None` where there is no need.
    fn cut(&self, cell: u32, candidates: Vec<u16>) -> Option<Cut> {
        let valid = self.valid(cell);
        let witnesses = self.witnesses(cell, valid, &candidates);
        let without = off(&witnesses, |_| valid);
        let fitted = |planes: &[u16]| {
            let masks = self.masks(&witnesses, valid, planes);
            (off(&witnesses, |witness| masks[self.side(witness, planes)]), masks)
        };
        let (mut planes, mut best) = (Vec::new(), fitted(&[]));
        while planes.len() < MOST_PLANES {
            let with = |plane: &u16| [&planes[..], &[*plane]].concat();
            let all = candidates.iter().map(|plane| (fitted(&with(plane)), *plane));
            let Some((next, plane)) = all.min_by(|a, b| a.0.0.total_cmp(&b.0.0)) else { break };
            if best.0 - next.0 < LEAST_GAIN * without {
                break;
            }
            planes.push(plane);
            best = next;
        }
        (without - best.0 > LEAST_CHANGE * witnesses.len() as f64).then_some(Cut { planes, masks: best.1 })
    }

    /// Corners whose nodes have light of their own.
    fn valid(&self, cell: u32) -> u8 {
        let nodes = self.cells.corners(cell).nodes;
        (0..8).filter(|k| self.part.baked.is_valid(nodes[*k] as usize)).map(|k| 1 << k).sum()
    }

    fn witnesses(&self, cell: u32, valid: u8, candidates: &[u16]) -> Vec<Witness> {
        let nodes = self.cells.corners(cell).nodes;
        let lights = nodes.map(|node| irradiance_of(&self.part.baked.node(node as usize)));
        let product = |a: &Irradiance, b: &Irradiance| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
        let gram: [[f32; 8]; 8] = std::array::from_fn(|a| std::array::from_fn(|b| product(&lights[a], &lights[b])));
        let witness = |share: DVec3| {
            let (position, weights) = self.within(cell, share);
            let truth = self.truth(position)?;
            let scale = strength(&truth).max(self.black).max(f64::MIN_POSITIVE);
            let square = product(&truth, &truth);
            let toward: [f32; 8] = std::array::from_fn(|k| weights[k] * product(&lights[k], &truth));
            let one = |mask: u8| {
                let counts = |k: &usize| mask >> k & 1 == 1;
                let total: f32 = (0..8).filter(counts).map(|k| weights[k]).sum();
                if total < 1e-6 {
                    return 1.0;
                }
                let along: f32 = (0..8).filter(counts).map(|k| toward[k]).sum();
                let rows = (0..8)
                    .filter(counts)
                    .map(|a| weights[a] * (0..8).filter(counts).map(|b| weights[b] * gram[a][b]).sum::<f32>());
                let squared = rows.sum::<f32>() / (total * total) - 2.0 * along / total + square;
                (f64::from(squared.max(0.0)).sqrt() / scale).min(1.0) as f32
            };
            let mut off = [1.0; 256];
            (1..=255u8).filter(|mask| mask & !valid == 0).for_each(|mask| off[usize::from(mask)] = one(mask));
            Some(Witness { place: position - DVec3::from(self.cells.grid.min), off })
        };
        let middles = (0..PER_AXIS.pow(3)).map(inner_place);
        middles.chain(candidates.iter().flat_map(|plane| self.beside(cell, *plane))).filter_map(witness).collect()
    }

    /// Places in a cell just off a plane, to either side, 0 to 1 per axis: what surfaces in it ask for.
    fn beside(&self, cell: u32, plane: u16) -> impl Iterator<Item = DVec3> {
        let (low, high) = self.cells.bounds(cell);
        let (low, extent) = (DVec3::from(low), DVec3::from(high) - DVec3::from(low));
        let Plane { normal, distance } = self.planes[usize::from(plane)];
        // n·p = d in the cell's own measure.
        let normal = DVec3::from(normal.map(f64::from));
        let along = normal * extent;
        let rest = f64::from(distance) - normal.dot(low - DVec3::from(self.cells.grid.min));
        let axis = along.abs().max_position();
        let places = (0..PER_AXIS * PER_AXIS).flat_map(move |index| {
            let mut place = on_face(index, axis, 0.0);
            let middle = (rest - along.dot(place)) / along[axis];
            [-OFF_PLANES, OFF_PLANES].map(|off| {
                place[axis] = middle + off;
                place
            })
        });
        places.filter(move |place| along[axis] != 0.0 && (0.0..=1.0).contains(&place[axis]))
    }

    /// A place in a cell, 0 to 1 per axis, and what its corners weigh there.
    fn within(&self, cell: u32, share: DVec3) -> (DVec3, [f32; 8]) {
        let (low, high) = self.cells.bounds(cell);
        let (low, high) = (DVec3::from(low), DVec3::from(high));
        let mut weights = trilinear(share.as_vec3().to_array());
        self.cells.corners(cell).spread(&mut weights);
        (low + (high - low) * share, weights)
    }

    /// What the finer volume says; `None` where it has no light of its own.
    fn truth(&self, position: DVec3) -> Option<Irradiance> {
        let sample = self.volume.sample_f64(position.into(), [0.0; 3]);
        (sample.validity > 0.0).then(|| irradiance_of(sample.sh.coefficients.as_flattened()))
    }

    fn side(&self, witness: &Witness, planes: &[u16]) -> usize {
        let is_above = |plane: &u16| {
            let Plane { normal, distance } = self.planes[usize::from(*plane)];
            DVec3::from(normal.map(f64::from)).dot(witness.place) > f64::from(distance)
        };
        planes.iter().enumerate().map(|(bit, plane)| usize::from(is_above(plane)) << bit).sum()
    }

    /// The best of each part; 0 where there is no place in it.
    fn masks(&self, witnesses: &[Witness], valid: u8, planes: &[u16]) -> [u8; 1 << MOST_PLANES] {
        let mut sums = [[0.0f32; 256]; 1 << MOST_PLANES];
        let mut count = [0.0; 1 << MOST_PLANES];
        for witness in witnesses {
            let side = self.side(witness, planes);
            count[side] += 1.0;
            sums[side].iter_mut().zip(&witness.off).for_each(|(sum, off)| *sum += off);
        }
        std::array::from_fn(|side| {
            let masks = (1..=255u8).filter(|mask| count[side] > 0.0 && mask & !valid == 0);
            let hidden = |mask: u8| (valid & !mask).count_ones() as f32;
            let cost = |mask: u8| sums[side][usize::from(mask)] + HIDING * count[side] * hidden(mask);
            let best = masks.min_by(|a, b| cost(*a).total_cmp(&cost(*b)));
            best.unwrap_or(0)
        })
    }

    /// Nodes at which the walls of a cell end: those of its faces to cells that are not cut, where it hides some of them from a
    /// place in the open.
    fn ends(&self, cell: u32, cut: &Cut, walled: &HashSet<u32>) -> Vec<u32> {
        let (nodes, valid) = (self.cells.corners(cell).nodes, self.valid(cell));
        let mut ends = Vec::new();
        for (axis, up) in [(0, false), (0, true), (1, false), (1, true), (2, false), (2, true)] {
            if self.cells.beyond(cell, axis, up).iter().all(|beyond| walled.contains(beyond)) {
                continue;
            }
            let corners = (0..8usize).filter(|corner| (corner >> axis & 1 == 1) == up);
            let hides = |index: usize| {
                let share = |off: f64| on_face(index, axis, if up { 1.0 - off } else { off });
                let (before, weights) = self.within(cell, share(ACROSS / 2.0));
                let (beyond, _) = self.within(cell, share(-ACROSS / 2.0));
                let (Some(here), Some(there)) = (self.truth(before), self.truth(beyond)) else { return false };
                if strength(&difference(&here, &there)) > ALIKE * strength(&here).max(self.black) {
                    return false;
                }
                let witness = Witness { place: before - DVec3::from(self.cells.grid.min), off: [0.0; 256] };
                let mask = cut.masks[self.side(&witness, &cut.planes)];
                let hidden = |k: usize| valid & !mask >> k & 1 == 1 && weights[k] > LEAST_WEIGHT;
                mask != 0 && corners.clone().any(hidden)
            };
            if (0..PER_AXIS * PER_AXIS).any(hides) {
                ends.extend(corners.map(|corner| nodes[corner]));
            }
        }
        ends
    }
}

/// Place number `index` of a cell, 0 to 1 per axis: the middle of one of its equal parts.
fn inner_place(index: usize) -> DVec3 {
    let part = |axis: u32| (index / PER_AXIS.pow(axis) % PER_AXIS) as f64;
    DVec3::from_array([0, 1, 2].map(|axis| (part(axis) + 0.5) / PER_AXIS as f64))
}

/// The same of a face, at `height` along the axis that it faces.
fn on_face(index: usize, axis: usize, height: f64) -> DVec3 {
    let mut place = DVec3::ZERO;
    place[axis] = height;
    place[(axis + 1) % 3] = ((index % PER_AXIS) as f64 + 0.5) / PER_AXIS as f64;
    place[(axis + 2) % 3] = ((index / PER_AXIS) as f64 + 0.5) / PER_AXIS as f64;
    place
}

/// Of all places together.
fn off(witnesses: &[Witness], mask: impl Fn(&Witness) -> u8) -> f64 {
    witnesses.iter().map(|witness| f64::from(witness.off[usize::from(mask(witness))])).sum()
}
