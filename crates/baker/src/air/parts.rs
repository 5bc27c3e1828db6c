//! The connected parts of a level: triangles of one mesh that hang together by their corners.

use glam::DVec3;

use crate::disjoint::Disjoint;
use crate::scene::{Mesh, Scene};

/// A surface is level enough to stand on up to this slope, as the cosine: 30 degrees.
const LEVEL: f64 = 0.866_025_403_784_438_6;
/// Ground slopes from this on, as the cosine: half a degree.
const SLOPED: f64 = 0.999_96;
/// What one stands on is flat if its heights differ by no more than this share of the part's size.
const FLAT: f64 = 1e-3;

/// Triangles that hang together.
#[derive(Debug, Clone, Copy)]
pub(super) struct Part {
    /// Which of the scene's meshes they belong to.
    pub mesh: u32,
    /// Lower corner of their box, world.
    pub min: DVec3,
    /// Upper corner.
    pub max: DVec3,
    /// Lowest and highest corner of the triangles that one can stand on; lowest above highest without any.
    ground: (f64, f64),
}

impl Part {
    /// Longest edge of the box.
    pub fn size(&self) -> f64 {
        (self.max - self.min).max_element()
    }

    /// All that one can stand on lies at one height.
    pub fn is_flat(&self) -> bool {
        self.ground.1 - self.ground.0 <= FLAT * self.size()
    }

    /// It has no thickness to speak of.
    pub fn is_plane(&self) -> bool {
        (self.max - self.min).min_element() <= FLAT * self.size()
    }
}

/// All parts of a level.
#[derive(Debug, Default)]
pub(super) struct Parts {
    /// In the order of their first triangles.
    pub list: Vec<Part>,
    /// The part of each triangle, mesh after mesh.
    pub of_triangle: Vec<u32>,
}

impl Parts {
    pub fn of(scene: &Scene) -> Parts {
        let mut parts = Parts::default();
        for (index, mesh) in scene.meshes.iter().enumerate() {
            let double_sided = scene.materials[mesh.material as usize].double_sided;
            let mut joined = joined(mesh);
            let mut numbers = vec![u32::MAX; mesh.positions.len()];
            for triangle in &mesh.triangles {
                let [a, b, c] = triangle.map(|corner| mesh.positions[corner as usize]);
                let (min, max) = (a.min(b).min(c), a.max(b).max(c));
                let number = &mut numbers[joined.first(triangle[0]) as usize];
                if *number == u32::MAX {
                    *number = parts.list.len() as u32;
                    let ground = (f64::INFINITY, f64::NEG_INFINITY);
                    parts.list.push(Part { mesh: index as u32, min, max, ground });
                }
                let part = &mut parts.list[*number as usize];
                (part.min, part.max) = (part.min.min(min), part.max.max(max));
                let normal = (b - a).cross(c - a);
                if is_level(normal) || double_sided && is_level(-normal) {
                    part.ground = (part.ground.0.min(min.y), part.ground.1.max(max.y));
                }
                parts.of_triangle.push(*number);
            }
        }
        parts
    }
}

/// A triangle with this normal (of any length) faces up, and is level enough to stand on.
pub(super) fn is_level(normal: DVec3) -> bool {
    normal.y > 0.0 && normal.y * normal.y >= LEVEL * LEVEL * normal.length_squared()
}

/// A triangle with this normal (of any length) is not quite level.
pub(super) fn is_sloped(normal: DVec3) -> bool {
    normal.y * normal.y < SLOPED * SLOPED * normal.length_squared()
}

/// Vertices of a mesh that triangles or a common place join.
fn joined(mesh: &Mesh) -> Disjoint {
    let mut joined = Disjoint::default();
    joined.grow(mesh.positions.len() as u32);
    join_places(&mut joined, &mesh.positions);
    for &[a, b, c] in &mesh.triangles {
        joined.join(a, b);
        joined.join(a, c);
    }
    joined
}

/// Vertices in one place are one: a table with open addressing, twice as large as what it holds at least.
fn join_places(joined: &mut Disjoint, positions: &[DVec3]) {
    let mask = usize::next_power_of_two(2 * positions.len()) - 1;
    let mut table = vec![u32::MAX; mask + 1];
    for (vertex, &position) in (0..).zip(positions) {
        let mut slot = hash(position) as usize & mask;
        loop {
            match table[slot] {
                u32::MAX => {
                    table[slot] = vertex;
                    break;
                }
                other if positions[other as usize] == position => {
                    joined.join(vertex, other);
                    break;
                }
                _ => slot = (slot + 1) & mask,
            }
        }
    }
}

/// Of a place; both zeros are one.
fn hash(position: DVec3) -> u64 {
    let [x, y, z] = (position + 0.0).to_array().map(f64::to_bits);
    let mixed = (x ^ y.rotate_left(21) ^ z.rotate_left(42)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mixed = (mixed ^ mixed >> 32).wrapping_mul(0xd6e8_feb8_6659_fd93);
    mixed ^ mixed >> 32
}
