//! Tetrahedra between the nodes of a grid: six per cell, each a path from the cell's min to its max corner along one
//! axis after another.
//!
//! ```text
//! path (a, b, c): corners min, min + a, min + a + b, max        holds the places with u_a ≥ u_b ≥ u_c,
//! weights: 1 - u_a, u_a - u_b, u_b - u_c, u_c                   u in 0..=1 from corner to corner
//! ```
//! All cells are cut alike, so that neighbours share whole triangles and the light is continuous.
//!
//! Based on: H. Freudenthal, "Simplizialzerlegungen von beschränkter Flachheit" (1942); H. Kuhn, "Some combinatorial
//! lemmas in topology" (1960).

use gdibl_runtime::Grid;

/// The most nodes that an engine with tetrahedra is given: some 400 000 tetrahedra.
pub(crate) const MAX_PROBES: usize = 1 << 16;

/// The orders of axes, by which tetrahedra of a cell are numbered.
pub(crate) const PATHS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

/// Nodes of all tetrahedra: cell by cell, x fastest, in the order of [`PATHS`]. A grid with a count of 1 has none.
pub(crate) fn tetrahedra(counts: [usize; 3]) -> Vec<[u32; 4]> {
    let cells = counts.map(|count| count - 1);
    let mut all = Vec::new();
    for z in 0..cells[2] {
        for y in 0..cells[1] {
            for x in 0..cells[0] {
                all.extend(PATHS.iter().map(|path| corners(counts, [x, y, z], path)));
            }
        }
    }
    all
}

fn corners(counts: [usize; 3], cell: [usize; 3], path: &[usize; 3]) -> [u32; 4] {
    let mut place = cell;
    let index = |p: [usize; 3]| (p[0] + counts[0] * (p[1] + counts[1] * p[2])) as u32;
    let first = index(place);
    let [a, b, c] = path.map(|axis| {
        place[axis] += 1;
        index(place)
    });
    [first, a, b, c]
}

/// The tetrahedron around a position and its weights, which add up to 1; outside the grid's box those of the nearest
/// position in it.
pub(crate) fn locate(grid: &Grid, position: [f64; 3]) -> ([u32; 4], [f64; 4]) {
    let counts = grid.counts.map(|count| count as usize);
    let mut cell = [0; 3];
    let u: [f64; 3] = std::array::from_fn(|k| {
        let last = (counts[k] - 1) as f64;
        let place = ((position[k] - grid.min[k]) / (grid.max[k] - grid.min[k]) * last).max(0.0).min(last);
        cell[k] = (place as usize).min(counts[k] - 2);
        place - cell[k] as f64
    });
    let mut path = [0, 1, 2];
    path.sort_by(|&a, &b| u[b].total_cmp(&u[a]));
    let [a, b, c] = path.map(|axis| u[axis]);
    (corners(counts, cell, &path), [1.0 - a, a - b, b - c, c])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample_position;

    #[test]
    fn locate_reproduces_positions_within_the_grid_and_the_nearest_beyond() {
        let grid = Grid { min: [-1.0, 2.0, 10.0], max: [3.0, 2.5, 11.0], counts: [5, 3, 4] };
        let all = tetrahedra([5, 3, 4]);
        assert_eq!(all.len(), 6 * 4 * 2 * 3);
        for i in 0..2000 {
            let position = sample_position([-2.0, 1.5, 9.5], [4.0, 3.0, 11.5], i);
            let (nodes, weights) = locate(&grid, position);
            assert!(all.contains(&nodes), "{nodes:?}");
            assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12 && weights.iter().all(|&w| w >= 0.0));
            let found: [f64; 3] = std::array::from_fn(|k| {
                nodes.iter().zip(weights).map(|(&n, w)| w * grid.node_position(n as usize)[k]).sum()
            });
            let nearest: [f64; 3] = std::array::from_fn(|k| position[k].clamp(grid.min[k], grid.max[k]));
            assert!((0..3).all(|k| (found[k] - nearest[k]).abs() < 1e-9), "{found:?} {nearest:?}");
        }
    }
}
