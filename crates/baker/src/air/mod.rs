//! The air of a level that people can be in, and the box around it: the default box of a grid.
//!
//! 1. *Parts* are triangles of a mesh that hang together. A part that is far larger than all smaller ones together, as
//!    a ground plane, a sky dome or a shell of rock, is left out, unless it is a place to be: it has relief to walk on
//!    there, or a ceiling of ordinary height.
//! 2. Vertical lines cross what is left. Air lies between a front that faces up and the next front above it or the sky.
//! 3. The box of that air goes out to the surfaces around it. A side moves only if that saves a tenth.
//!
//! Where one can stand hardly anywhere, the box is that of all triangles. Nothing is in metres: a level of another
//! scale has the same box, scaled. Up is +Y. Air between the surfaces of a line is that of the heightfields of Recast
//! (Mononen, 2009), which finds where characters can walk.

mod lines;
mod parts;

use glam::DVec3;

use crate::scene::Scene;
use lines::{Crossing, Gap, Lattice, gaps};
use parts::Parts;

/// A part is far larger than others if it is so many times as large: over both, a grid of 32 nodes would have four over
/// them.
const FAR_LARGER: f64 = 8.0;
/// A ceiling is a sky if it is so many times as high as rooms are: halls are up to ten times as high, domes hundreds of
/// times.
const SKY: f64 = 32.0;
/// A part can be a sky if its top is over all else by so many times the height of that.
const SKY_OVER: f64 = 4.0;
/// Ground around what is left is looked at to this share of its size on each side.
const AROUND: f64 = 0.25;
/// One can stand in a level if that holds of so many of the lines that cross it. From above, it holds of a quarter of a
/// sphere.
const STANDING: f64 = 1.0 / 3.0;
/// Or if it holds of so many under a ceiling: rooms in rock.
const SHELTERED: f64 = 1.0 / 32.0;
/// Open air over ground counts if it is so high, as a share of the height of the level: a flat roof on top of all has
/// none.
const LEAST_OPEN: f64 = 1.0 / 64.0;
/// A side of the box moves only if that saves this share.
const LEAST_SAVED: f64 = 0.1;

/// The air of a level.
#[derive(Debug, Clone, PartialEq)]
pub struct Air {
    /// Its box, world metres; that of all triangles where one can stand nowhere.
    pub bounds: (DVec3, DVec3),
    /// The box of all triangles, world metres.
    pub all: (DVec3, DVec3),
    /// What is left out, largest first.
    pub left_out: Vec<LeftOut>,
    /// How high rooms are, metres: lines under a ceiling have more at three of four places. `None` without a ceiling.
    pub headroom: Option<f64>,
    /// Half of the places where one can stand are under a ceiling, or more.
    pub is_indoors: bool,
    /// One can stand somewhere.
    pub is_standable: bool,
}

/// A part that the box leaves out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeftOut {
    /// Which of the scene's meshes it belongs to.
    pub mesh: u32,
    /// Longest edge of its box, metres.
    pub size: f64,
    /// It has no thickness to speak of.
    pub is_plane: bool,
}

impl Air {
    /// The air of a level; `None` without triangles.
    pub fn of(scene: &Scene) -> Option<Air> {
        let parts = Parts::of(scene);
        let level = Level::new(scene, &parts)?;
        let all = level.rest_bounds[0];
        // The innermost of what can be left out and leaves a place to stand.
        let fits = |&cut: &usize| level.may_leave_out(cut).then(|| level.space(cut)).filter(|space| space.is_standable);
        let cut = level.cuts().into_iter().rev().find_map(|cut| Some((cut, fits(&cut)?)));
        let (cut, space) = cut.unwrap_or_else(|| (0, level.space(0)));
        let left_out = level.order[..cut].iter().map(|part| {
            let part = &parts.list[*part as usize];
            LeftOut { mesh: part.mesh, size: part.size(), is_plane: part.is_plane() }
        });
        Some(Air {
            bounds: if space.is_standable { space.bounds } else { all },
            all,
            left_out: left_out.collect(),
            headroom: space.headroom,
            is_indoors: space.is_indoors,
            is_standable: space.is_standable,
        })
    }

    /// Volume of the box over that of the box of all triangles, 0..=1 and a little more; axes on which that is flat do
    /// not count.
    pub fn share(&self) -> f64 {
        let [own, all] = [self.bounds, self.all].map(|(min, max)| max - min);
        (0..3).filter(|axis| all[*axis] > 0.0).map(|axis| own[axis] / all[axis]).product()
    }
}

/// A level whose largest parts may be left out.
struct Level<'a> {
    scene: &'a Scene,
    parts: &'a Parts,
    /// Parts, the largest first.
    order: Vec<u32>,
    /// Place in `order` of each part.
    ranks: Vec<u32>,
    /// The box of what is left without so many of the largest.
    rest_bounds: Vec<(DVec3, DVec3)>,
}

/// What was found between surfaces.
struct Space {
    bounds: (DVec3, DVec3),
    headroom: Option<f64>,
    is_indoors: bool,
    is_standable: bool,
}

impl<'a> Level<'a> {
    fn new(scene: &'a Scene, parts: &'a Parts) -> Option<Level<'a>> {
        let list = &parts.list;
        let mut order: Vec<u32> = (0..list.len() as u32).collect();
        order.sort_by(|a, b| list[*b as usize].size().total_cmp(&list[*a as usize].size()).then(a.cmp(b)));
        let mut ranks = vec![0; list.len()];
        order.iter().zip(0..).for_each(|(part, rank)| ranks[*part as usize] = rank);
        let last = list[*order.last()? as usize];
        let mut bounds = (last.min, last.max);
        let mut rest_bounds: Vec<(DVec3, DVec3)> = order
            .iter()
            .rev()
            .map(|part| {
                let part = &list[*part as usize];
                bounds = (bounds.0.min(part.min), bounds.1.max(part.max));
                bounds
            })
            .collect();
        rest_bounds.reverse();
        Some(Level { scene, parts, order, ranks, rest_bounds })
    }

    /// How many of the largest parts could be left out: each is far larger than the rest, or could be a sky over it.
    /// Sizes fall by as much from one cut to the next, so there are few.
    fn cuts(&self) -> Vec<usize> {
        let is_cut = |&cut: &usize| {
            let (min, max) = self.rest_bounds[cut];
            let least = &self.parts.list[self.order[cut - 1] as usize];
            let is_over = (least.min.x < min.x && least.min.z < min.z)
                && (least.max.x > max.x && least.max.z > max.z)
                && least.max.y - max.y > SKY_OVER * (max.y - min.y);
            least.size() >= FAR_LARGER * (max - min).max_element() || is_over
        };
        (1..self.order.len()).filter(is_cut).collect()
    }

    fn is_left_out(&self, crossing: &Crossing, cut: usize) -> bool {
        (self.ranks[crossing.part as usize] as usize) < cut
    }

    /// None of the largest parts is a place to be, as far as is seen from around the rest.
    fn may_leave_out(&self, cut: usize) -> bool {
        let (min, max) = self.rest_bounds[cut];
        let around = DVec3::splat(AROUND * (max - min).max_element());
        let (min, max) = (min - around, max + around);
        let (_, crossings) = Lattice::over(min, max, self.scene, self.parts);
        let is_left_out = |crossing: &Crossing| self.is_left_out(crossing, cut);
        let headroom = self.headroom(&crossings, cut);
        let near = |gap: &Gap| gap.floor.height < max.y && gap.ceiling.is_none_or(|ceiling| ceiling.height > min.y);
        let gaps = || crossings.chunk_by(|a, b| a.line == b.line).flat_map(gaps).filter(near);
        // A part is a sky where it is a ceiling at most places too high for one.
        let mut skies = vec![0i64; cut];
        for gap in gaps() {
            if let Some(ceiling) = gap.ceiling.filter(is_left_out) {
                let is_high = headroom.is_some_and(|h| ceiling.height - gap.floor.height >= SKY * h);
                skies[self.ranks[ceiling.part as usize] as usize] += if is_high { 1 } else { -1 };
            }
        }
        // Nobody walks on a sky, and a flat ground does not tell where people are.
        let is_place = |gap: Gap| {
            let part = gap.floor.part as usize;
            is_left_out(&gap.floor) && skies[self.ranks[part] as usize] <= 0 && !self.parts.list[part].is_flat()
        };
        skies.iter().all(|votes| *votes >= 0) && !gaps().any(is_place)
    }

    /// The air in the box of what is left without so many of the largest parts.
    fn space(&self, cut: usize) -> Space {
        let (min, max) = self.rest_bounds[cut];
        let (lattice, crossings) = Lattice::over(min, max, self.scene, self.parts);
        let headroom = self.headroom(&crossings, cut);
        let mut air = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        // Lines that meet something, those on which one can stand, and those on which one can stand under a ceiling.
        let [mut met, mut standing, mut sheltered] = [0; 3];
        let (mut sloped, mut highest_open) = (0, f64::NEG_INFINITY);
        for line in crossings.chunk_by(|a, b| a.line == b.line) {
            let own = |crossing: &Crossing| !self.is_left_out(crossing, cut);
            met += usize::from(line.iter().any(own));
            let [x, z] = lattice.place(line[0].line);
            let (mut lowest, mut is_sheltered) = (None, false);
            for gap in gaps(line) {
                let ceiling = gap.ceiling.filter(own);
                let bottom = gap.floor.height.max(min.y);
                let top = ceiling.map_or(max.y, |ceiling| ceiling.height);
                if ceiling.is_none() && gap.floor.is_level && gap.floor.height <= max.y {
                    highest_open = f64::max(highest_open, gap.floor.height);
                }
                let least = if ceiling.is_none() { LEAST_OPEN * (max.y - min.y) } else { 0.0 };
                if top - bottom <= least {
                    continue;
                }
                if gap.floor.is_level {
                    lowest = lowest.or(Some(ceiling.is_none() && gap.floor.is_sloped));
                    is_sheltered |= ceiling.is_some();
                }
                air.0 = air.0.min(DVec3::new(x - lattice.cell[0], bottom, z - lattice.cell[1]));
                air.1 = air.1.max(DVec3::new(x + lattice.cell[0], top, z + lattice.cell[1]));
            }
            standing += usize::from(lowest.is_some());
            sheltered += usize::from(is_sheltered);
            sloped += usize::from(lowest == Some(true));
        }
        // Where most ground is open and slopes, people stand on top of all hills and houses. Where it is level, the
        // tops of walls are no place to be.
        let is_hilly = 2 * sloped > standing;
        let above = headroom.filter(|_| is_hilly).map(|headroom| highest_open + headroom);
        air.1.y = above.unwrap_or(air.1.y);
        let saved = (max - min) * LEAST_SAVED;
        let low = DVec3::select(air.0.cmpge(min + saved), air.0, min);
        let high = DVec3::select(air.1.cmple(max - saved), air.1, max);
        let high = DVec3 { y: above.map_or(high.y, |above| high.y.max(above)), ..high };
        let share = |lines: usize| lines as f64 / f64::max(met as f64, 1.0);
        let is_standable = share(standing) >= STANDING || share(sheltered) >= SHELTERED;
        Space { bounds: (low, high), headroom, is_indoors: 2 * sheltered >= standing, is_standable }
    }

    /// How high rooms are: of the highest gap of each line under a ceiling that is kept, the lowest but a quarter.
    fn headroom(&self, crossings: &[Crossing], cut: usize) -> Option<f64> {
        let is_ground = |floor: &Crossing| self.parts.list[floor.part as usize].is_flat();
        let is_room = |gap: &Gap| {
            gap.ceiling.is_some_and(|ceiling| !self.is_left_out(&ceiling, cut))
                && (!self.is_left_out(&gap.floor, cut) || is_ground(&gap.floor))
        };
        let highest = |line| gaps(line).filter(is_room).filter_map(|gap| gap.headroom()).max_by(f64::total_cmp);
        let mut heights: Vec<f64> = crossings.chunk_by(|a, b| a.line == b.line).filter_map(highest).collect();
        let quarter = heights.len() / 4;
        (!heights.is_empty()).then(|| *heights.select_nth_unstable_by(quarter, f64::total_cmp).1)
    }
}
