//! Vertical lines through a level, the surfaces that they cross, and the air between these.

use glam::DVec3;

use super::parts::{Parts, is_level, is_sloped};
use crate::scene::Scene;

/// Lines, about: 256 x 256 over a square. A house of 8 m in a terrain of 1 km is met by four.
const LINES: f64 = 65_536.0;
/// Crossings that are kept at most, 32 bytes each: of a level with more, fewer lines are taken.
const MOST_CROSSINGS: usize = 1 << 22;
/// Where in its cell a line stands along x and z: on no edge of a mesh that divides the box evenly, and on no diagonal.
const PLACE_IN_CELL: [f64; 2] = [0.5, 0.382];
/// Rounding does not push a line off the edge of a triangle by more than this share of the distance between lines.
const ON_EDGE: f64 = 1e-6;
/// Heights are one within this share of the size of the box: the faces of a floor without thickness.
const ONE_HEIGHT: f64 = 1e-7;

/// Where a line crosses a surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Crossing {
    /// Which line.
    pub line: u32,
    /// Which part.
    pub part: u32,
    /// World.
    pub height: f64,
    /// `height` in steps of [`ONE_HEIGHT`], from the box.
    step: i64,
    /// The front is above.
    up: bool,
    /// One can stand on it.
    pub is_level: bool,
    /// It is not quite level.
    pub is_sloped: bool,
    /// Either side may be its front.
    double_sided: bool,
}

/// Air of one line between a surface and the next.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gap {
    pub floor: Crossing,
    /// `None`: nothing is above.
    pub ceiling: Option<Crossing>,
}

impl Gap {
    /// Height of a room: from a level floor to the ceiling. `None` under the sky.
    pub fn headroom(&self) -> Option<f64> {
        let ceiling = self.ceiling.filter(|_| self.floor.is_level)?;
        Some(ceiling.height - self.floor.height)
    }
}

/// A lattice of vertical lines over a box.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lattice {
    min: DVec3,
    /// Distance between lines along x and z.
    pub cell: [f64; 2],
    counts: [u32; 2],
    step: f64,
    /// Height of the box.
    height: f64,
}

impl Lattice {
    /// A lattice, and where its lines cross the level: by line and from below; of surfaces at one height those that
    /// face down first.
    pub fn over(min: DVec3, max: DVec3, scene: &Scene, parts: &Parts) -> (Lattice, Vec<Crossing>) {
        let mut lines = LINES;
        loop {
            let lattice = Lattice::of(min, max, lines);
            if let Some(crossings) = lattice.crossings(scene, parts, lines > 1.0) {
                return (lattice, crossings);
            }
            lines /= 4.0;
        }
    }

    fn of(min: DVec3, max: DVec3, lines: f64) -> Lattice {
        let size = [max.x - min.x, max.z - min.z];
        let edge = (size[0] * size[1] / lines).sqrt().max(size[0].max(size[1]) / lines);
        let counts = size.map(|size| (size / edge).round().clamp(1.0, lines) as u32);
        let cell = [0, 1].map(|axis| size[axis] / f64::from(counts[axis]));
        Lattice { min, cell, counts, step: (max - min).max_element() * ONE_HEIGHT, height: max.y - min.y }
    }

    /// Where a line stands: x and z, world.
    pub fn place(&self, line: u32) -> [f64; 2] {
        let [x, z] = [line % self.counts[0], line / self.counts[0]];
        [self.coordinate(0, x) + self.min.x, self.coordinate(1, z) + self.min.z]
    }

    /// From the corner of the box.
    fn coordinate(&self, axis: usize, index: u32) -> f64 {
        (f64::from(index) + PLACE_IN_CELL[axis]) * self.cell[axis]
    }

    /// The lines between two coordinates, from the corner of the box.
    fn between(&self, axis: usize, from: f64, to: f64) -> std::ops::Range<u32> {
        let index = |coordinate: f64| coordinate / self.cell[axis] - PLACE_IN_CELL[axis];
        let most = f64::from(self.counts[axis]);
        index(from).ceil().clamp(0.0, most) as u32..(index(to).floor() + 1.0).clamp(0.0, most) as u32
    }

    /// `None` if there are too many, and that matters.
    fn crossings(&self, scene: &Scene, parts: &Parts, is_bounded: bool) -> Option<Vec<Crossing>> {
        let mut crossings = Vec::new();
        let mut numbers = parts.of_triangle.iter();
        for mesh in &scene.meshes {
            let double_sided = scene.materials[mesh.material as usize].double_sided;
            for (triangle, &part) in mesh.triangles.iter().zip(&mut numbers) {
                let corners = triangle.map(|corner| mesh.positions[corner as usize] - self.min);
                self.cross(corners, part, double_sided, &mut crossings);
                if is_bounded && crossings.len() > MOST_CROSSINGS {
                    return None;
                }
            }
        }
        crossings.sort_unstable_by_key(|crossing| (crossing.line, crossing.step, crossing.up, crossing.part));
        if self.winding_tells(&crossings) {
            crossings.iter_mut().for_each(|crossing| crossing.double_sided = false);
        }
        Some(crossings)
    }

    /// More of the lines lies between fronts than between backs: then double-sided triangles have their fronts outside,
    /// too.
    fn winding_tells(&self, crossings: &[Crossing]) -> bool {
        let inside = |height: f64| (height - self.min.y).clamp(0.0, self.height);
        let (mut fronts, mut backs) = (0.0, 0.0);
        for line in crossings.chunk_by(|a, b| a.line == b.line) {
            for (index, floor) in line.iter().enumerate() {
                let ceiling = line.get(index + 1);
                let length = ceiling.map_or(self.height, |ceiling| inside(ceiling.height)) - inside(floor.height);
                if floor.up && ceiling.is_none_or(|ceiling| !ceiling.up) {
                    fronts += length;
                } else if !floor.up && ceiling.is_some_and(|ceiling| ceiling.up) {
                    backs += length;
                }
            }
        }
        fronts >= backs
    }

    /// Corners are relative to the corner of the box.
    fn cross(&self, [a, b, c]: [DVec3; 3], part: u32, double_sided: bool, crossings: &mut Vec<Crossing>) {
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        let along = self.between(1, low.z, high.z);
        if along.is_empty() || self.between(0, low.x, high.x).is_empty() {
            return;
        }
        let (ab, ac) = (b - a, c - a);
        let normal = ab.cross(ac);
        if normal.y == 0.0 {
            return;
        }
        let is_level = is_level(normal) || double_sided && is_level(-normal);
        let (up, is_sloped) = (normal.y > 0.0, is_sloped(normal));
        for row in along {
            let z = self.coordinate(1, row);
            // Only the columns that the row has in the triangle: of a long sliver hardly any.
            let (mut from, mut to) = (f64::INFINITY, f64::NEG_INFINITY);
            for (p, q) in [(a, b), (b, c), (c, a)] {
                if (p.z - z) * (q.z - z) <= 0.0 {
                    let share = if p.z == q.z { 0.0 } else { (z - p.z) / (q.z - p.z) };
                    let x = p.x + share * (q.x - p.x);
                    (from, to) = (from.min(x), to.max(x));
                }
            }
            let slack = self.cell[0] * ON_EDGE;
            let columns = self.between(0, (from - slack).max(low.x), (to + slack).min(high.x));
            let z = z - a.z;
            for column in columns {
                let x = self.coordinate(0, column) - a.x;
                // Weights of b and c.
                let v = (z * ac.x - x * ac.z) / normal.y;
                let w = (x * ab.z - z * ab.x) / normal.y;
                if v >= 0.0 && w >= 0.0 && v + w <= 1.0 {
                    let height = a.y + v * ab.y + w * ac.y;
                    let step = (height / self.step).round() as i64;
                    let (line, height) = (row * self.counts[0] + column, height + self.min.y);
                    crossings.push(Crossing { line, part, height, step, up, is_level, is_sloped, double_sided });
                }
            }
        }
    }
}

/// The air over the surfaces that one line crosses, from below: what lies between two fronts that face each other, or
/// over the topmost front. What lies behind a single-sided triangle is solid, or outside.
pub(super) fn gaps(line: &[Crossing]) -> impl Iterator<Item = Gap> {
    (0..line.len()).filter_map(|index| {
        let (floor, ceiling) = (line[index], line.get(index + 1).copied());
        let is_air = (floor.up || floor.double_sided)
            && ceiling.is_none_or(|ceiling| (!ceiling.up || ceiling.double_sided) && ceiling.step > floor.step);
        is_air.then_some(Gap { floor, ceiling })
    })
}
