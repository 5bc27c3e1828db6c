//! A regular grid of nodes over a box: where each node is, and which eight surround a position.
//!
//! ```text
//! count 4 on an axis   |----|----|----|      the first node on min, the last on max
//!                     min            max
//! count 1              |      |       |      the one node in the middle: nothing varies along this axis
//! ```
//! The index of node (x, y, z) is `x + counts[0] * (y + counts[1] * z)`: x runs fastest, then y, then z.

use core::array;

/// The nodes of a volume, on a regular grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// The box's lowest corner, metres.
    pub min: [f64; 3],
    /// The box's highest corner, metres.
    pub max: [f64; 3],
    /// Nodes per axis, at least 1; all together at most 2³² - 1.
    pub counts: [u32; 3],
}

/// Eight nodes around a position and how much each counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Node indices; bit 0 of the place in this array says lower or higher in x, bit 1 in y, bit 2 in z. Where an
    /// axis has one node, lower and higher are the same.
    pub nodes: [u32; 8],
    /// Trilinear weights, 0..=1, which add up to 1.
    pub weights: [f32; 8],
    /// Whether the position was in the box; otherwise the weights are those of the nearest position which is.
    pub inside: bool,
}

impl Grid {
    /// How many nodes there are; `usize::MAX` if that does not fit.
    pub fn node_count(&self) -> usize {
        self.counts.iter().fold(1, |product: usize, &count| product.saturating_mul(count as usize))
    }

    /// The distance between neighbouring nodes on each axis, metres; 0 where an axis has one node.
    pub fn spacing(&self) -> [f64; 3] {
        array::from_fn(|axis| match self.counts[axis] {
            0 | 1 => 0.0,
            count => (self.max[axis] - self.min[axis]) / f64::from(count - 1),
        })
    }

    /// Where node `index` is, metres.
    ///
    /// # Panics
    /// If there is no such node.
    pub fn node_position(&self, index: usize) -> [f64; 3] {
        let count = self.node_count();
        assert!(index < count, "node {index} of {count}");
        self.place_position(self.place_of(index as u32))
    }

    /// Node (x, y, z) of an index.
    pub fn place_of(&self, index: u32) -> [u32; 3] {
        let [nx, ny, _] = self.counts;
        [index % nx, index / nx % ny, index / nx / ny]
    }

    /// The index of node (x, y, z).
    pub fn index_of(&self, [x, y, z]: [u32; 3]) -> u32 {
        let [nx, ny, _] = self.counts;
        x.wrapping_add(nx.wrapping_mul(y.wrapping_add(ny.wrapping_mul(z))))
    }

    /// Where node (x, y, z) is, metres.
    pub fn place_position(&self, place: [u32; 3]) -> [f64; 3] {
        array::from_fn(|axis| {
            let (min, max) = (self.min[axis], self.max[axis]);
            match self.counts[axis].max(1) - 1 {
                0 => 0.5 * min + 0.5 * max,
                last if place[axis] == last => max,
                last => min + (max - min) * (f64::from(place[axis]) / f64::from(last)),
            }
        })
    }

    /// Whether a node is the lowest corner of a cell: on no axis the last of several.
    pub fn is_cell(&self, lowest: u32) -> bool {
        let [nx, ny, nz] = self.counts;
        let (x, y, z) = (lowest % nx, lowest / nx % ny, lowest / nx / ny);
        z < nz && [(x, nx), (y, ny), (z, nz)].iter().all(|&(place, count)| count == 1 || place + 1 < count)
    }

    /// The cell beyond a face of the cell whose lowest corner is `lowest`; None where the grid ends.
    pub fn neighbour_cell(&self, lowest: u32, axis: usize, higher: bool) -> Option<u32> {
        let stride = [1, self.counts[0], self.counts[0].wrapping_mul(self.counts[1])][axis];
        let place = lowest / stride % self.counts[axis];
        match higher {
            false => (place > 0).then(|| lowest - stride),
            true => (place + 2 < self.counts[axis]).then(|| lowest + stride),
        }
    }

    /// The corners of the cell whose lowest is `lowest`, as in [`Cell::nodes`].
    pub fn cell_nodes(&self, lowest: u32) -> [u32; 8] {
        let [nx, ny, nz] = self.counts;
        let step = |count: u32, stride: u32| if count > 1 { stride } else { 0 };
        let steps = [step(nx, 1), step(ny, nx), step(nz, nx.wrapping_mul(ny))];
        array::from_fn(|corner| lowest + (0..3).filter(|axis| corner >> axis & 1 == 1).map(|k| steps[k]).sum::<u32>())
    }

    /// The box of that cell, metres; over all of the grid's box on an axis with one node.
    pub fn cell_box(&self, lowest: u32) -> ([f64; 3], [f64; 3]) {
        let low = self.node_position(lowest as usize);
        let high = self.node_position(self.cell_nodes(lowest)[7] as usize);
        let is_flat = |axis: usize| self.counts[axis] <= 1;
        (
            array::from_fn(|axis| if is_flat(axis) { self.min[axis] } else { low[axis] }),
            array::from_fn(|axis| if is_flat(axis) { self.max[axis] } else { high[axis] }),
        )
    }

    /// The eight nodes around a position, in metres, and their trilinear weights.
    ///
    /// Every position has an answer: outside the box that of the nearest position in it, and a coordinate that is no
    /// number counts as the box's min.
    pub fn locate(&self, position: [f64; 3]) -> Cell {
        let (nodes, weights) = self.corners(position);
        Cell { nodes, weights, inside: box_contains(self.min, self.max, position) }
    }

    /// Nodes and weights of [`locate`](Grid::locate).
    #[inline]
    pub(crate) fn corners(&self, position: [f64; 3]) -> ([u32; 8], [f32; 8]) {
        Finder::new(self).corners(position)
    }
}

/// From here on an f64 has no fraction: adding it rounds a smaller number to a whole one, which then stands in the lower half of
/// the sum's bits. So do many in a row, where a conversion to an integer is done one by one.
const TWO_TO_52: f64 = (1u64 << 52) as f64;

/// A whole number below 2^32.
#[inline(always)]
fn whole(number: f64) -> u32 {
    (number + TWO_TO_52).to_bits() as u32
}

/// What finding cells takes, of a grid: so that it takes no division.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Finder {
    min: [f64; 3],
    /// 0 on an axis with one node.
    nodes_per_metre: [f64; 3],
    /// A position in units of nodes is at most this: a hair below the last node, 0 where that is the first.
    most: [f64; 3],
    /// From a node to the next.
    strides: [u32; 3],
    strides_f64: [f64; 3],
    /// The same, but 0 on an axis with one node.
    steps: [u32; 3],
}

impl Finder {
    pub(crate) fn new(grid: &Grid) -> Finder {
        let last = grid.counts.map(|count| f64::from(count.max(1) - 1));
        let strides = [1, grid.counts[0], grid.counts[0].wrapping_mul(grid.counts[1])];
        Finder {
            min: grid.min,
            nodes_per_metre: array::from_fn(|axis| match last[axis] {
                0.0 => 0.0,
                last => last / (grid.max[axis] - grid.min[axis]),
            }),
            most: last.map(|last| last.next_down().max(0.0)),
            strides,
            strides_f64: strides.map(f64::from),
            steps: array::from_fn(|axis| if grid.counts[axis] > 1 { strides[axis] } else { 0 }),
        }
    }

    /// The cell that holds a position, by its lowest node, and where in it the position is: 0 to 1 per axis.
    #[inline(always)]
    pub(crate) fn cell_at(&self, position: [f64; 3]) -> ([u32; 3], [f32; 3]) {
        let (mut lower, mut share) = ([0; 3], [0.0; 3]);
        for axis in 0..3 {
            let (floor, rest) = self.along(axis, position[axis]);
            (lower[axis], share[axis]) = (whole(floor), rest);
        }
        (lower, share)
    }

    /// The lowest nodes of the cells that hold positions, and where in them these are; axis by axis.
    #[inline(always)]
    pub(crate) fn lowest<const N: usize>(&self, positions: &[[f64; N]; 3]) -> ([u32; N], [[f32; N]; 3]) {
        let (mut lowest, mut share) = ([0; N], [[0.0; N]; 3]);
        for k in 0..N {
            // Exact: there are fewer than 2^32 nodes.
            let mut index = 0.0;
            for axis in 0..3 {
                let (floor, rest) = self.along(axis, positions[axis][k]);
                index += floor * self.strides_f64[axis];
                share[axis][k] = rest;
            }
            lowest[k] = whole(index);
        }
        (lowest, share)
    }

    /// Along an axis: the last node below a coordinate, and how far it is from there to the next, 0 to 1.
    #[inline(always)]
    fn along(&self, axis: usize, coordinate: f64) -> (f64, f32) {
        let place = (coordinate - self.min[axis]) * self.nodes_per_metre[axis];
        // As maxima and minima that give the other operand where one is no number; one instruction each.
        let place = if place > 0.0 { place } else { 0.0 };
        let place = if place < self.most[axis] { place } else { self.most[axis] };
        let nearest = (place + TWO_TO_52) - TWO_TO_52;
        let floor = nearest - if nearest > place { 1.0 } else { 0.0 };
        (floor, (place - floor) as f32)
    }

    /// See [`Grid::index_of`].
    #[inline(always)]
    pub(crate) fn index_of(&self, place: [u32; 3]) -> u32 {
        let along = |axis: usize| place[axis].wrapping_mul(self.strides[axis]);
        along(0).wrapping_add(along(1)).wrapping_add(along(2))
    }

    /// Whether the next node in x is the next in memory everywhere in a cell.
    #[inline(always)]
    pub(crate) fn has_pairs(&self) -> bool {
        self.steps[0] == 1
    }

    /// The corners of a cell on the lower side in x.
    #[inline(always)]
    pub(crate) fn pairs(&self, lowest: u32) -> [u32; 4] {
        let [_, y, z] = self.steps;
        let (above, behind) = (lowest.wrapping_add(y), lowest.wrapping_add(z));
        [lowest, above, behind, above.wrapping_add(z)]
    }

    /// From the lowest corner of a cell to each, as in [`Cell::nodes`].
    #[inline(always)]
    pub(crate) fn corner_offsets(&self) -> [u32; 8] {
        let [x, y, z] = self.steps;
        let (xy, yz) = (x.wrapping_add(y), y.wrapping_add(z));
        [0, x, y, xy, z, x.wrapping_add(z), yz, x.wrapping_add(yz)]
    }

    /// See [`Grid::corners`].
    #[inline(always)]
    pub(crate) fn corners(&self, position: [f64; 3]) -> ([u32; 8], [f32; 8]) {
        let ([first], share) = self.lowest(&position.map(|v| [v]));
        let [a, b, c, d, e, f, g, h] = self.corner_offsets();
        let node = |offset: u32| first.wrapping_add(offset);
        ([node(a), node(b), node(c), node(d), node(e), node(f), node(g), node(h)], trilinear(share.map(|[v]| v)))
    }
}

/// Weights of a cell's corners at a place in it, 0 to 1 per axis; 0 on an axis with one node.
#[inline(always)]
pub fn trilinear(share: [f32; 3]) -> [f32; 8] {
    array::from_fn(|corner| corner_weight(corner, share))
}

/// One of them.
#[inline(always)]
pub(crate) fn corner_weight(corner: usize, share: [f32; 3]) -> f32 {
    let along = |axis: usize| {
        if corner >> axis & 1 == 1 { share[axis] } else { 1.0 - share[axis] }
    };
    along(0) * along(1) * along(2)
}

/// Whether a position is in a box, its faces included, give or take a millionth of its size and the rounding of a
/// coordinate to f32: so that a node's own position counts as inside, also after a trip through f32.
pub(crate) fn box_contains(min: [f64; 3], max: [f64; 3], position: [f64; 3]) -> bool {
    let size = (0..3).map(|axis| max[axis] - min[axis]).fold(0.0, f64::max);
    (0..3).all(|axis| {
        let slack = 1e-6 * size + min[axis].abs().max(max[axis].abs()) * f64::from(f32::EPSILON);
        position[axis] >= min[axis] - slack && position[axis] <= max[axis] + slack
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec::Vec;

    const GRID: Grid = Grid { min: [-1.0, 2.0, 10.0], max: [3.0, 2.5, 11.0], counts: [5, 3, 4] };

    fn positions() -> Vec<[f64; 3]> {
        let mut positions = Vec::new();
        for i in 0..500 {
            let t = f64::from(i);
            positions.push([
                1.0 + 2.6 * (t * 0.61).sin(),
                2.25 + 0.3 * (t * 0.37).sin(),
                10.5 + 0.55 * (t * 0.23).sin(),
            ]);
        }
        for odd in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300, 0.0, -0.0] {
            positions.push([odd, 2.2, 10.5]);
            positions.push([odd; 3]);
        }
        positions
    }

    #[test]
    fn first_node_is_on_min_and_last_on_max() {
        assert_eq!(GRID.node_count(), 60);
        assert_eq!(GRID.node_position(0), GRID.min);
        assert_eq!(GRID.node_position(59), GRID.max);
        assert_eq!(GRID.node_position(1), [0.0, 2.0, 10.0]);
        assert_eq!(GRID.node_position(5), [-1.0, 2.25, 10.0]);
        assert_eq!(GRID.spacing(), [1.0, 0.25, 1.0 / 3.0]);
    }

    #[test]
    fn weights_sum_to_one_and_nodes_exist_everywhere() {
        for counts in [[5, 3, 4], [1, 3, 4], [5, 1, 1], [1, 1, 1], [2, 2, 2]] {
            for grid in [Grid { counts, ..GRID }, Grid { counts, max: GRID.min, ..GRID }] {
                for position in positions() {
                    let cell = grid.locate(position);
                    let sum: f32 = cell.weights.iter().sum();
                    assert!((sum - 1.0).abs() < 1e-6, "{position:?}: {sum}");
                    assert!(cell.weights.iter().all(|w| (0.0..=1.0).contains(w)));
                    assert!(cell.nodes.iter().all(|&n| (n as usize) < grid.node_count()));
                }
            }
        }
    }

    #[test]
    fn trilinear_reproduces_positions_inside_and_the_nearest_on_the_box_outside() {
        for position in positions() {
            let cell = GRID.locate(position);
            for axis in 0..3 {
                let found: f64 =
                    (0..8).map(|k| f64::from(cell.weights[k]) * GRID.node_position(cell.nodes[k] as usize)[axis]).sum();
                let truth = position[axis].max(GRID.min[axis]).min(GRID.max[axis]);
                assert!((found - truth).abs() < 1e-5, "{position:?}: {found} {truth}");
            }
        }
    }

    #[test]
    fn a_nodes_own_position_is_inside_and_has_its_whole_weight_also_as_f32() {
        let grid = Grid { min: [0.1, -0.3, 1e5 + 0.1], max: [0.7, 0.9, 1e5 + 0.7], ..GRID };
        for index in 0..grid.node_count() {
            let exact = grid.node_position(index);
            for position in [exact, exact.map(|v| f64::from(v as f32))] {
                let cell = grid.locate(position);
                assert!(cell.inside, "{position:?}");
                if position == exact {
                    let k = (0..8).find(|&k| cell.nodes[k] as usize == index).unwrap();
                    assert!(cell.weights[k] > 0.999_99, "{cell:?}");
                }
            }
        }
        assert!(!grid.locate([0.0999, 0.0, 1e5 + 0.3]).inside);
        assert!(!grid.locate([f64::NAN, 0.0, 1e5 + 0.3]).inside);
    }

    #[test]
    fn one_node_on_an_axis_sits_in_the_middle() {
        let grid = Grid { counts: [5, 1, 4], ..GRID };
        assert_eq!(grid.node_position(0), [-1.0, 2.25, 10.0]);
        assert_eq!(grid.spacing()[1], 0.0);
    }
}
