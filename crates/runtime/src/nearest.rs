//! The nearest of many positions: a binary tree of boxes without pointers.
//!
//! ```text
//! order   [            0            ]     node indices; every range is halved along its widest axis,
//!         [     1      |     2      ]     down to ranges of at most LEAF
//!         [  3  |  4   |  5  |  6   ]     box i bounds the positions in range i; its halves are 2i + 1 and 2i + 2
//! ```
//! Built once when a file is read (O(n log n)), 7 to 10 bytes per node; a query visits O(log n) of them and allocates
//! nothing. Surfaces fill little of the space between them: a uniform grid of cells makes a query from the middle of a
//! room walk through all the empty ones, and the half-spaces of a plain k-d tree looked at 9 600 of 60 000 vertices there.
//! Boxes visit 59.
//!
//! The answers do not depend on the tree: the nearest, and among equally near ones the lowest index.
//!
//! Based on: J. H. Friedman, J. L. Bentley, R. A. Finkel, "An algorithm for finding best matches in logarithmic
//! expected time" (1977), with boxes as in N. Roussopoulos, S. Kelley, F. Vincent, "Nearest neighbor queries" (1995).

use alloc::vec::Vec;

/// Ranges up to this many nodes are searched one by one.
const LEAF: usize = 16;

/// The tree over some positions, which it does not own.
#[derive(Clone, Debug, Default)]
pub struct NearestIndex {
    order: Vec<u32>,
    boxes: Vec<Bounds>,
}

#[derive(Clone, Copy, Debug)]
struct Bounds {
    min: [f32; 3],
    max: [f32; 3],
}

/// A node found, and the square of its distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Which one.
    pub index: usize,
    /// In squared units of the positions.
    pub squared_distance: f64,
}

impl NearestIndex {
    /// Builds the tree over finite positions.
    pub fn build(positions: &[[f32; 3]]) -> NearestIndex {
        let mut order: Vec<u32> = (0..positions.len() as u32).collect();
        let mut boxes = Vec::new();
        split(positions, &mut order, 0, &mut boxes);
        NearestIndex { order, boxes }
    }

    /// The nearest position; None if there is none.
    pub fn nearest(&self, positions: &[[f32; 3]], query: [f64; 3]) -> Option<Found> {
        let mut best: Option<Found> = None;
        self.visit(positions, query, f64::INFINITY, &mut |index, squared_distance| {
            let better = best.is_none_or(|best| (squared_distance, index) < (best.squared_distance, best.index));
            if better {
                best = Some(Found { index, squared_distance });
            }
            best.map_or(f64::INFINITY, |best| best.squared_distance)
        });
        best
    }

    /// Calls `found` for every position within a distance, given squared.
    pub fn within(&self, positions: &[[f32; 3]], query: [f64; 3], squared_distance: f64, mut found: impl FnMut(usize)) {
        self.visit(positions, query, squared_distance, &mut |index, squared| {
            if squared <= squared_distance {
                found(index);
            }
            squared_distance
        });
    }

    /// Calls `consider` with the index and squared distance of every node that may be within `limit` (squared), which
    /// `consider` may shrink by what it returns.
    fn visit(&self, positions: &[[f32; 3]], query: [f64; 3], limit: f64, consider: &mut impl FnMut(usize, f64) -> f64) {
        let boxes = &self.boxes;
        if cfg!(feature = "fast") {
            Walk { positions, boxes, query, limit, consider }.range(&self.order, 0);
        } else {
            // One copy of the walk for all callers.
            let mut consider: &mut dyn FnMut(usize, f64) -> f64 = consider;
            Walk { positions, boxes, query, limit, consider: &mut consider }.range(&self.order, 0);
        }
    }
}

struct Walk<'a, F> {
    positions: &'a [[f32; 3]],
    boxes: &'a [Bounds],
    query: [f64; 3],
    limit: f64,
    consider: &'a mut F,
}

impl<F: FnMut(usize, f64) -> f64> Walk<'_, F> {
    fn range(&mut self, order: &[u32], place: usize) {
        if order.len() <= LEAF {
            for &index in order {
                let position = self.positions[index as usize];
                let squared = squared_length(core::array::from_fn(|k| self.query[k] - f64::from(position[k])));
                self.limit = (self.consider)(index as usize, squared);
            }
            return;
        }
        let (lower, higher) = order.split_at(order.len() / 2);
        let [mut near, mut far] = [(lower, 2 * place + 1), (higher, 2 * place + 2)]
            .map(|(order, place)| (self.distance_to_box(place), order, place));
        if far.0 < near.0 {
            core::mem::swap(&mut near, &mut far);
        }
        // The nearer half first: it shrinks the limit for the other.
        for (squared, order, place) in [near, far] {
            if squared <= self.limit {
                self.range(order, place);
            }
        }
    }

    /// The square of the query's distance to a box. Rounding keeps order, so that it is never above that to a position
    /// in the box.
    fn distance_to_box(&self, place: usize) -> f64 {
        let Bounds { min, max } = self.boxes[place];
        squared_length(core::array::from_fn(|k| {
            let below = f64::from(min[k]) - self.query[k];
            let above = self.query[k] - f64::from(max[k]);
            below.max(above).max(0.0)
        }))
    }
}

fn squared_length([x, y, z]: [f64; 3]) -> f64 {
    x * x + y * y + z * z
}

/// Bounds a range and halves it along the axis on which it is widest, and so on in both halves.
fn split(positions: &[[f32; 3]], order: &mut [u32], place: usize, boxes: &mut Vec<Bounds>) {
    let mut bounds = Bounds { min: [f32::INFINITY; 3], max: [f32::NEG_INFINITY; 3] };
    for &index in order.iter() {
        for (k, &coordinate) in positions[index as usize].iter().enumerate() {
            bounds.min[k] = bounds.min[k].min(coordinate);
            bounds.max[k] = bounds.max[k].max(coordinate);
        }
    }
    if boxes.len() <= place {
        boxes.resize(place + 1, bounds);
    }
    boxes[place] = bounds;
    if order.len() <= LEAF {
        return;
    }
    let width = |k: usize| f64::from(bounds.max[k]) - f64::from(bounds.min[k]);
    let mut widest = 0;
    for k in 1..3 {
        if width(k) > width(widest) {
            widest = k;
        }
    }
    let half = order.len() / 2;
    let coordinate = |index: u32| positions[index as usize][widest];
    if cfg!(feature = "fast") {
        order.select_nth_unstable_by(half, |&a, &b| coordinate(a).total_cmp(&coordinate(b)).then(a.cmp(&b)));
    } else {
        let key = |index: u32| u64::from(sortable(coordinate(index))) << 32 | u64::from(index);
        let differing = sortable(bounds.min[widest]) ^ sortable(bounds.max[widest]);
        select(order, half, differing.into(), key);
    }
    let (lower, higher) = order.split_at_mut(half);
    split(positions, lower, 2 * place + 1, boxes);
    split(positions, higher, 2 * place + 2, boxes);
}

/// Bits that are in the order of finite floats.
fn sortable(value: f32) -> u32 {
    // Of the two zeros only one is left.
    let bits = (value + 0.0).to_bits();
    bits ^ ((bits as i32 >> 31) as u32 | 1 << 31)
}

/// Brings the entries with the `half` least keys before the others.
///
/// Halves what is left by one bit of the key after the other, from the highest in `differing` on, which are the key's upper 32:
/// the bits that are not the same in all. Linear in the entries, whatever they are, in a tenth of the code of
/// `select_nth_unstable_by` and 1.1 to 3 times its time.
fn select(order: &mut [u32], half: usize, differing: u64, key: impl Fn(u32) -> u64) {
    let (mut start, mut end) = (0, order.len());
    let mut bit = 1 << (63 - (differing << 32 | u64::from(u32::MAX)).leading_zeros());
    while bit > 0 && end - start > 1 {
        // Entries of the range that lack the bit come first.
        let mut middle = start;
        for place in start..end {
            order.swap(place, middle);
            middle += usize::from(key(order[middle]) & bit == 0);
        }
        if middle > half {
            end = middle
        } else {
            start = middle
        }
        bit >>= 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn positions(count: usize, flat: bool, coarse: bool) -> Vec<[f32; 3]> {
        let mut state = 12345u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let value = (state >> 8) as f32 / (1 << 24) as f32;
            if coarse { (value * 4.0) as u32 as f32 } else { value * 10.0 }
        };
        (0..count).map(|_| [random(), if flat { 1.0 } else { random() }, random()]).collect()
    }

    #[test]
    fn select_brings_the_least_keys_first() {
        for (flat, coarse) in [(false, false), (true, false), (false, true), (true, true)] {
            let positions = positions(1000, flat, coarse);
            for axis in 0..3 {
                let key = |i: u32| u64::from(sortable(positions[i as usize][axis])) << 32 | u64::from(i);
                let mut order: Vec<u32> = (0..1000).collect();
                let least = positions.iter().map(|p| p[axis]).fold(f32::INFINITY, f32::min);
                let most = positions.iter().map(|p| p[axis]).fold(f32::NEG_INFINITY, f32::max);
                select(&mut order, 300, (sortable(least) ^ sortable(most)).into(), key);
                let highest = order[..300].iter().map(|&i| key(i)).max();
                assert!(highest < order[300..].iter().map(|&i| key(i)).min(), "axis {axis}");
            }
        }
    }

    #[test]
    fn tree_finds_what_the_plain_loop_finds() {
        for count in [0, 1, 2, 16, 17, 40, 3000] {
            for (flat, coarse) in [(false, false), (true, false), (false, true), (true, true)] {
                let positions = positions(count, flat, coarse);
                let index = NearestIndex::build(&positions);
                for i in 0..200 {
                    let t = f64::from(i);
                    let query = [5.0 + 9.0 * (t * 0.7).sin(), t * 0.1 - 4.0, 5.0 + 6.0 * (t * 0.3).cos()];
                    let query = if i % 2 == 0 { query } else { query.map(|v| v as i32 as f64) };
                    let squared = |p: [f32; 3]| {
                        let [x, y, z]: [f64; 3] = core::array::from_fn(|k| query[k] - f64::from(p[k]));
                        x * x + y * y + z * z
                    };
                    let mut best: Option<Found> = None;
                    for (index, &position) in positions.iter().enumerate() {
                        let squared_distance = squared(position);
                        if best.is_none_or(|best| squared_distance < best.squared_distance) {
                            best = Some(Found { index, squared_distance });
                        }
                    }
                    let found = index.nearest(&positions, query);
                    assert_eq!(found, best, "{count} positions, {query:?}");

                    let radius = best.map_or(1.0, |best| best.squared_distance * 1.5);
                    let mut found = Vec::new();
                    index.within(&positions, query, radius, |index| found.push(index));
                    found.sort_unstable();
                    let truth: Vec<usize> = (0..count).filter(|&k| squared(positions[k]) <= radius).collect();
                    assert_eq!(found, truth);
                }
            }
        }
    }

    #[test]
    fn a_query_from_the_middle_of_an_empty_room_visits_few_of_many_nodes() {
        // Walls of a room of 10 m, and queries well inside and far outside: where cells of a grid would be empty.
        let mut walls = positions(60_000, false, false);
        for (i, position) in walls.iter_mut().enumerate() {
            position[i % 3] = if i % 2 == 0 { 0.0 } else { 10.0 };
        }
        let index = NearestIndex::build(&walls);
        for query in [[4.0, 5.5, 6.1], [0.1, 3.0, 3.0], [-900.0, 800.0, 3000.0]] {
            let mut visited = 0;
            let mut best = f64::INFINITY;
            index.visit(&walls, query, f64::INFINITY, &mut |_, squared| {
                visited += 1;
                best = f64::min(best, squared);
                best
            });
            assert!(visited < 1000, "{query:?}: {visited} of {}", walls.len());
        }
    }
}
