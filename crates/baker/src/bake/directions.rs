//! What a node saw, as a small octahedral map: read where a direction is uncovered.
//!
//! The report gives an uncovered direction the radiance of the nearest successful one; with "nearest so far" the
//! result depends on the order of rays. Here all covered samples are averaged in a map first, its empty cells are
//! filled from coarser and coarser levels (pull-push: Gortler et al., "The Lumigraph", 1996, §3.4), and uncovered
//! directions read the map afterwards. Mapping: Engelhardt and Dachsbacher, "Octahedron Environment Maps", 2008.

use glam::{Vec2, Vec3};

/// Cells along one side; a power of two. 32: cells of about 6°, finer than L4 can tell.
const SIDE: usize = 32;
/// This many samples make a cell trust its own mean alone.
const ENOUGH: f32 = 4.0;

/// Means of covered radiance by direction.
#[derive(Debug, Clone)]
pub struct DirectionMap {
    /// Sum of radiance and, last, of coverage, per cell.
    cells: Vec<[f32; 4]>,
}

impl Default for DirectionMap {
    fn default() -> Self {
        DirectionMap { cells: vec![[0.0; 4]; SIDE * SIDE] }
    }
}

impl DirectionMap {
    /// Forgets everything.
    pub fn clear(&mut self) {
        self.cells.fill([0.0; 4]);
    }

    /// Adds a sample: `value` is radiance × coverage.
    #[inline]
    pub fn add(&mut self, direction: Vec3, value: Vec3, coverage: f32) {
        let cell = &mut self.cells[cell_of(direction)];
        cell[0] += value.x;
        cell[1] += value.y;
        cell[2] += value.z;
        cell[3] += coverage;
    }

    /// Adds what another map has.
    pub fn add_all(&mut self, other: &DirectionMap) {
        self.cells.as_flattened_mut().iter_mut().zip(other.cells.as_flattened()).for_each(|(own, more)| *own += more);
    }

    /// How much what is covered differs from cell to cell: half of what lies between the 5th and the 95th percentile, without small
    /// lamps. In a living room, nodes with more than 1 % unseen lay within 95 % intervals of it in 89 % with the 16th and 84th.
    pub fn spread(&self) -> f64 {
        let cells = self.sorted_light();
        f64::from(percentile(&cells, 0.95) - percentile(&cells, 0.05)) / 2.0
    }

    /// Mean of R, G and B in each covered cell, ascending.
    fn sorted_light(&self) -> Vec<f32> {
        let light = |cell: &[f32; 4]| (cell[0] + cell[1] + cell[2]) / (3.0 * cell[3]);
        let mut cells: Vec<f32> = self.cells.iter().filter(|cell| cell[3] > 0.0).map(light).collect();
        cells.sort_unstable_by(f32::total_cmp);
        cells
    }

    /// Turns sums into radiance everywhere. `false` if nothing was covered: the map is then black.
    ///
    /// What is hidden is taken for no lamp: no cell is brighter than 95 % of the covered ones. The back of a lamp that hung 5 cm under a
    /// ceiling hid a thousandth of it, which took the lamp's own light: E was 6 % too bright.
    pub fn fill(&mut self) -> bool {
        // Pull: each level holds mean and trust (0..=1) of four cells of the finer one.
        let most = percentile(&self.sorted_light(), 0.95);
        let mut levels = vec![self.cells.iter().map(|cell| at_most(mean(cell), most)).collect::<Vec<_>>()];
        let mut side = SIDE;
        while side > 1 {
            side /= 2;
            let fine = &levels[levels.len() - 1];
            let pulled = (0..side * side).map(|i| {
                let (x, y) = (2 * (i % side), 2 * (i / side));
                let mut sum = [0.0; 4];
                for at in [y * 2 * side + x, y * 2 * side + x + 1, (y + 1) * 2 * side + x, (y + 1) * 2 * side + x + 1] {
                    for channel in 0..3 {
                        sum[channel] += fine[at][channel] * fine[at][3];
                    }
                    sum[3] += fine[at][3];
                }
                let weight = sum[3].max(f32::MIN_POSITIVE);
                [sum[0] / weight, sum[1] / weight, sum[2] / weight, sum[3].min(1.0)]
            });
            let pulled: Vec<_> = pulled.collect();
            levels.push(pulled);
        }
        let covered = levels[levels.len() - 1][0][3] > 0.0;
        // Push: what a cell does not know by itself it takes from its parent.
        for level in (0..levels.len() - 1).rev() {
            let side = SIDE >> level;
            let (fine, coarse) = levels.split_at_mut(level + 1);
            for (i, cell) in fine[level].iter_mut().enumerate() {
                let parent = coarse[0][(i / side / 2) * (side / 2) + (i % side) / 2];
                for channel in 0..3 {
                    cell[channel] = cell[channel] * cell[3] + parent[channel] * (1.0 - cell[3]);
                }
            }
        }
        self.cells.copy_from_slice(&levels[0]);
        covered
    }

    /// Radiance of a direction, after [`DirectionMap::fill`].
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        let cell = self.cells[cell_of(direction)];
        Vec3::new(cell[0], cell[1], cell[2])
    }
}

/// Of ascending numbers; 0 without any.
fn percentile(ascending: &[f32], share: f64) -> f32 {
    ascending.get((ascending.len() as f64 * share) as usize).copied().unwrap_or(0.0)
}

/// The same colour with a mean of R, G and B of `most` at most.
fn at_most([r, g, b, trust]: [f32; 4], most: f32) -> [f32; 4] {
    let light = (r + g + b) / 3.0;
    let share = if light > most { most / light } else { 1.0 };
    [r * share, g * share, b * share, trust]
}

fn mean(cell: &[f32; 4]) -> [f32; 4] {
    if cell[3] <= 0.0 {
        return [0.0; 4];
    }
    [cell[0] / cell[3], cell[1] / cell[3], cell[2] / cell[3], (cell[3] / ENOUGH).min(1.0)]
}

/// Octahedral map: the lower half (y < 0) is folded over the corners.
fn cell_of(direction: Vec3) -> usize {
    let scale = direction.abs().element_sum();
    let mut p = Vec2::new(direction.x, direction.z) / scale;
    if direction.y < 0.0 {
        p = (Vec2::ONE - Vec2::new(p.y, p.x).abs()) * Vec2::new(1f32.copysign(p.x), 1f32.copysign(p.y));
    }
    let cell = |p: f32| (((p * 0.5 + 0.5) * SIDE as f32) as usize).min(SIDE - 1);
    cell(p.y) * SIDE + cell(p.x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::fibonacci_sphere;

    #[test]
    fn fill_takes_the_nearest_covered_light_and_keeps_constants() {
        let mut map = DirectionMap::default();
        let directions = fibonacci_sphere(20_000);
        for &direction in directions.iter().filter(|d| d.y > -0.5) {
            map.add(direction, Vec3::new(2.0, 3.0, 4.0), 1.0);
        }
        assert!(map.fill());
        for &direction in &directions {
            assert!((map.radiance(direction) - Vec3::new(2.0, 3.0, 4.0)).length() < 1e-4);
        }
        // Two halves of different light: a hole in one takes that one's.
        map.clear();
        for &direction in directions.iter().filter(|d| d.angle_between(Vec3::X) > 0.3) {
            let value = if direction.x > 0.0 { Vec3::ONE } else { Vec3::ZERO };
            map.add(direction, value, 1.0);
        }
        assert!(map.fill());
        assert!(map.radiance(Vec3::X).x > 0.9, "{}", map.radiance(Vec3::X));
    }

    #[test]
    fn fill_takes_no_hidden_place_for_a_lamp() {
        // A lamp a million times as bright as the wall around it, and half of that wall, the lamp's surroundings, hidden.
        let mut map = DirectionMap::default();
        let lamp = Vec3::new(0.6, 0.0, 0.8);
        for direction in fibonacci_sphere(20_000) {
            let angle = direction.angle_between(lamp);
            if !(0.05..=0.4).contains(&angle) {
                map.add(direction, if angle < 0.05 { Vec3::splat(1e6) } else { Vec3::ONE }, 1.0);
            }
        }
        assert!(map.fill());
        for direction in fibonacci_sphere(1000) {
            assert!((map.radiance(direction) - Vec3::ONE).length() < 1e-4, "{direction}: {}", map.radiance(direction));
        }
    }

    #[test]
    fn fill_of_nothing_is_black_and_says_so() {
        let mut map = DirectionMap::default();
        assert!(!map.fill());
        assert_eq!(map.radiance(Vec3::Z), Vec3::ZERO);
    }

    #[test]
    fn every_direction_has_its_cell() {
        let mut seen = vec![false; SIDE * SIDE];
        for direction in fibonacci_sphere(100_000) {
            seen[cell_of(direction)] = true;
        }
        assert!(seen.iter().all(|s| *s));
        for axis in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z, Vec3::new(-0.0, -1.0, -0.0)] {
            assert!(cell_of(axis) < SIDE * SIDE);
        }
    }
}
