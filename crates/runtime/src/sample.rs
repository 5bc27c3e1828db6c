//! Light at a position.
//!
//! **Grid**: trilinear between the eight nodes around, of which only valid ones count; their weights are scaled to add
//! up to 1 again. Where none is valid (or less than [`LEAST_VALID`] of them is), filled values are as good as any:
//! plain trilinear over all eight. In a file with walls only nodes count that are seen from the position, moved a hair
//! along the normal: see [`walls`](crate::walls). Outside the box the answer is that of the nearest position in it, and
//! [`Sample::inside`] is false: a caller with several volumes, or with a fallback, looks there.
//!
//! **Sparse grid**: the same in cells of several sizes, see [`bricks`](crate::bricks).
//!
//! **Points**: the nearest one. **Vertices**: the nearest one; among those within [`NORMAL_TIE`] of it, the one whose
//! normal matches best (the corners of a box share places, and face three ways). Valid or not: asked at the same
//! places, a volume answers what was baked there.
//!
//! Every input has an answer: a coordinate that is no number counts as the box's min.

use crate::bricks::{Bricks, Located};
use crate::coefficients::{Coefficients, half_of, words_of};
use crate::grid::{box_contains, trilinear};
use crate::half::{f16_to_f32, upper_f16_to_scaled_f32};
use crate::math::square_root;
use crate::sh::{COSINE_OF, MAX_COEFFICIENTS, basis};
use crate::volume::{MIXED, SUBNORMAL, VALID, WALLED};
use crate::{Kind, RadianceSh, Volume};
use alloc::vec::Vec;
use core::array;
use core::hint::black_box;

/// The share of the eight nodes' weights that must be valid for the others to be left out.
pub const LEAST_VALID: f32 = 1e-6;

/// Vertices whose distances differ by less than this, in diagonals of the header's box, are at the same place.
pub const NORMAL_TIE: f64 = 1e-5;

/// Light at a position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Radiance from all directions: `sh.convolve().evaluate(normal)` is the irradiance on a surface there.
    pub sh: RadianceSh,
    /// The share of this that was baked rather than filled, 0..=1: the weights of valid nodes. 0 says that all of it
    /// was filled.
    pub validity: f32,
    /// Whether the position is in the volume's box.
    pub inside: bool,
}

impl Volume {
    /// Light at a position in metres. The unit `normal` of the surface there picks between vertices at the same place, and in
    /// a grid with walls the side of a wall that the position lies on. Points, and grids without walls, do not use it.
    pub fn sample(&self, position: [f32; 3], normal: [f32; 3]) -> Sample {
        self.sample_f64(position.map(f64::from), normal)
    }

    /// The same for levels far from the origin, where an f32 is too coarse for a position.
    pub fn sample_f64(&self, position: [f64; 3], normal: [f32; 3]) -> Sample {
        match self.header.kind {
            Kind::Grid | Kind::Sparse => {
                let (nodes, weights, validity) = self.weights(position, normal);
                let mut sh = RadianceSh::zero(self.header.bands);
                let count = self.header.values_per_node();
                self.blend(&nodes, &weights, &mut sh.coefficients.as_flattened_mut()[..count]);
                Sample { sh, validity, inside: box_contains(self.header.min, self.header.max, position) }
            }
            Kind::Points | Kind::Vertices => {
                let node = self.nearest(position, normal);
                Sample {
                    sh: self.node_sh(node),
                    validity: if self.is_valid(node) { 1.0 } else { 0.0 },
                    inside: box_contains(self.header.min, self.header.max, position),
                }
            }
        }
    }

    /// What falls on a surface: `diffuse = albedo / PI * irradiance`. Not clamped, see
    /// [`IrradianceSh::evaluate`](crate::IrradianceSh::evaluate). The same as `sample(position, normal).sh.convolve()
    /// .evaluate(normal)` but for rounding, in less time.
    #[inline]
    pub fn irradiance(&self, position: [f32; 3], normal: [f32; 3]) -> [f32; 3] {
        self.irradiance_f64(position.map(f64::from), normal)
    }

    /// The same for levels far from the origin.
    #[inline]
    pub fn irradiance_f64(&self, [x, y, z]: [f64; 3], [u, v, w]: [f32; 3]) -> [f32; 3] {
        self.irradiance_at(x, y, z, u, v, w)
    }

    /// The same. Numbers come in registers; an array would come in memory, where reading two numbers at once stalls while they
    /// have just been written one by one. One arm per number of bands, so that the compiler knows all lengths.
    fn irradiance_at(&self, x: f64, y: f64, z: f64, u: f32, v: f32, w: f32) -> [f32; 3] {
        match (self.header.kind, &self.coefficients, self.header.bands) {
            (Kind::Points | Kind::Vertices, ..) | (_, Coefficients::F32(_), _) => {
                self.irradiance_of_sample(x, y, z, u, v, w)
            }
            _ if cfg!(not(feature = "fast")) => self.irradiance_of_sample(x, y, z, u, v, w),
            (_, _, 0) => self.irradiance_of_halves::<2, 1>(x, y, z, u, v, w),
            (_, _, 1) => self.irradiance_of_halves::<6, 3>(x, y, z, u, v, w),
            (_, _, 2) => self.irradiance_of_halves::<14, 7>(x, y, z, u, v, w),
            (_, _, 3) => self.irradiance_of_halves::<24, 12>(x, y, z, u, v, w),
            _ => self.irradiance_of_halves::<38, 19>(x, y, z, u, v, w),
        }
    }

    /// Of whatever numbers, in whatever volume.
    #[inline(never)]
    fn irradiance_of_sample(&self, x: f64, y: f64, z: f64, u: f32, v: f32, w: f32) -> [f32; 3] {
        self.sample_f64([x, y, z], [u, v, w]).sh.convolve().evaluate([u, v, w])
    }

    /// In a cell of a grid whose corners are all plain; elsewhere what takes longer. `W` words and `V` vectors are a node's values.
    #[inline(never)]
    fn irradiance_of_halves<const W: usize, const V: usize>(
        &self,
        x: f64,
        y: f64,
        z: f64,
        u: f32,
        v: f32,
        w: f32,
    ) -> [f32; 3] {
        let Coefficients::F16(all) = &self.coefficients else {
            return self.irradiance_of_sample(x, y, z, u, v, w);
        };
        if self.header.kind != Kind::Grid || !self.finder.has_pairs() {
            return self.irradiance_of_mixed::<W, V>(x, y, z, u, v, w);
        }
        let position = match &self.walls {
            None => [x, y, z],
            Some(walls) => walls.off_surface([x, y, z], [u, v, w]),
        };
        let ([lowest], share) = self.finder.lowest(&position.map(|v| [v]));
        if self.marks.as_ref().is_some_and(|marks| marks[lowest as usize] & MIXED != 0) {
            return self.irradiance_of_mixed::<W, V>(x, y, z, u, v, w);
        }
        let pairs = pairs_of::<W>(all, self.finder.pairs(lowest));
        let factors = factors::<W, V>([u, v, w]);
        irradiance(&blend_pairs(&pairs, &times_2_to_112(trilinear(share.map(|[v]| v)))), &factors, self.scale)
    }

    /// In any cell, also of a sparse grid.
    #[inline(never)]
    fn irradiance_of_mixed<const W: usize, const V: usize>(
        &self,
        x: f64,
        y: f64,
        z: f64,
        u: f32,
        v: f32,
        w: f32,
    ) -> [f32; 3] {
        if let (Coefficients::F16(all), Kind::Grid | Kind::Sparse) = (&self.coefficients, self.header.kind) {
            let (nodes, weights, _) = self.weights([x, y, z], [u, v, w]);
            if !self.any_subnormal(&nodes) {
                return self.irradiance_of_rows::<W, V>(all, &nodes, weights, [u, v, w]);
            }
        }
        self.irradiance_of_sample(x, y, z, u, v, w)
    }

    /// Of nodes without subnormal numbers.
    #[inline(always)]
    fn irradiance_of_rows<const W: usize, const V: usize>(
        &self,
        all: &[u32],
        nodes: &[u32; 8],
        weights: [f32; 8],
        normal: [f32; 3],
    ) -> [f32; 3] {
        let rows = rows_of::<W>(all, nodes);
        irradiance(&blend_plain(&rows, &times_2_to_112(weights)), &factors::<W, V>(normal), self.scale)
    }

    /// The nodes that [`sample_f64`](Volume::sample_f64) blends at a position, and their weights, which add up to 1; None for points
    /// and vertices. [`cell`](Volume::cell) knows no walls, and no node that was not baked.
    pub fn blended_nodes(&self, position: [f64; 3], normal: [f32; 3]) -> Option<([u32; 8], [f32; 8])> {
        let is_grid = matches!(self.header.kind, Kind::Grid | Kind::Sparse);
        is_grid.then(|| self.weights(position, normal)).map(|(nodes, weights, _)| (nodes, weights))
    }

    /// What falls on a surface in the light of these nodes with these weights: as [`irradiance_f64`](Volume::irradiance_f64) at the
    /// position that they are of, in a volume that may hold other nodes beside.
    ///
    /// # Panics
    /// If there is no such node.
    pub fn irradiance_of_nodes(&self, nodes: &[u32; 8], weights: [f32; 8], normal: [f32; 3]) -> [f32; 3] {
        if let Coefficients::F16(all) = &self.coefficients
            && cfg!(feature = "fast")
            && !self.any_subnormal(nodes)
        {
            return match self.header.bands {
                0 => self.irradiance_of_rows::<2, 1>(all, nodes, weights, normal),
                1 => self.irradiance_of_rows::<6, 3>(all, nodes, weights, normal),
                2 => self.irradiance_of_rows::<14, 7>(all, nodes, weights, normal),
                3 => self.irradiance_of_rows::<24, 12>(all, nodes, weights, normal),
                _ => self.irradiance_of_rows::<38, 19>(all, nodes, weights, normal),
            };
        }
        let mut sh = RadianceSh::zero(self.header.bands);
        let count = self.header.values_per_node();
        self.blend(nodes, &weights, &mut sh.coefficients.as_flattened_mut()[..count]);
        sh.convolve().evaluate(normal)
    }

    /// The point or vertex that [`sample_f64`](Volume::sample_f64) answers with, however far it is; None in a grid, which
    /// answers between its nodes.
    pub fn nearest_node(&self, position: [f64; 3], normal: [f32; 3]) -> Option<usize> {
        matches!(self.header.kind, Kind::Points | Kind::Vertices).then(|| self.nearest(position, normal))
    }

    /// The nodes around a position, their weights, which add up to 1, and the share of valid nodes in them.
    #[inline(always)]
    pub(crate) fn weights(&self, mut position: [f64; 3], normal: [f32; 3]) -> ([u32; 8], [f32; 8], f32) {
        if let Some(walls) = &self.walls {
            position = walls.off_surface(position, normal);
        }
        if let Some(bricks) = &self.bricks {
            return self.sparse_weights(bricks, position);
        }
        let (nodes, mut weights) = self.finder.corners(position);
        let mut validity = 1.0;
        if let Some(marks) = &self.marks
            && (cfg!(not(feature = "fast")) || marks[nodes[0] as usize] & MIXED != 0)
        {
            let wall_cell = (marks[nodes[0] as usize] & WALLED != 0).then_some(nodes[0]);
            validity = self.mark_weights(marks, position, &nodes, &mut weights, wall_cell);
        }
        (nodes, weights, validity)
    }

    /// The same in a sparse grid.
    #[inline(never)]
    fn sparse_weights(&self, bricks: &Bricks, position: [f64; 3]) -> ([u32; 8], [f32; 8], f32) {
        let (cell, within) = self.finder.cell_at(position);
        let located = bricks.located(cell);
        let (weights, validity) = self.located_weights(&located, cell, within, position);
        (located.corners.nodes, weights, validity)
    }

    /// The weights of a leaf's nodes at a position in it, off its surface, and the share of valid nodes in them.
    #[inline]
    pub(crate) fn located_weights(
        &self,
        located: &Located,
        cell: [u32; 3],
        within: [f32; 3],
        position: [f64; 3],
    ) -> ([f32; 8], f32) {
        let mut weights = located.weights(cell, within);
        let mut validity = 1.0;
        if self.marks.is_some() || self.walls.is_some() {
            let marks = self.marks.as_deref().unwrap_or_default();
            let cell = self.walls.is_some().then(|| self.finder.index_of(located.leaf.origin));
            validity = self.mark_weights(marks, position, &located.corners.nodes, &mut weights, cell);
        }
        (weights, validity)
    }

    /// Changes the weights to those of valid nodes, that are seen where there are walls in the cell; returns the share of valid
    /// ones. No marks: all are valid.
    #[inline]
    fn mark_weights(
        &self,
        marks: &[u8],
        position: [f64; 3],
        nodes: &[u32; 8],
        weights: &mut [f32; 8],
        wall_cell: Option<u32>,
    ) -> f32 {
        let is_valid = |node: u32| marks.get(node as usize).map_or(1.0, |mark| f32::from(mark & VALID));
        let valid: [f32; 8] = array::from_fn(|k| weights[k] * is_valid(nodes[k]));
        let validity = valid.iter().sum::<f32>().min(1.0);
        if let Some(cell) = wall_cell {
            let seen = self.seen_weights(cell, weights, &valid, position);
            if let Some(seen) = seen {
                *weights = seen;
                return validity;
            }
        }
        if validity < LEAST_VALID {
            return 0.0;
        }
        let scale = 1.0 / validity;
        *weights = valid.map(|weight| weight * scale);
        validity
    }

    /// The weights of the nodes that are seen from a position in a cell with walls, which add up to 1; None where there is
    /// none.
    #[inline(never)]
    fn seen_weights(&self, cell: u32, weights: &[f32; 8], valid: &[f32; 8], position: [f64; 3]) -> Option<[f32; 8]> {
        let (min, max) = (self.header.min, self.header.max);
        let place = array::from_fn(|k| position[k].max(min[k]).min(max[k]) - min[k]);
        let shares = self.walls.as_ref()?.shares(cell, place, weights);
        let seen: [f32; 8] = array::from_fn(|k| valid[k] * shares[k]);
        let sum = seen.iter().sum::<f32>();
        (sum >= LEAST_VALID).then(|| seen.map(|weight| weight / sum))
    }

    /// The weighted sum of the values of eight nodes.
    fn blend(&self, nodes: &[u32; 8], weights: &[f32; 8], sum: &mut [f32]) {
        match &self.coefficients {
            Coefficients::F16(all) if cfg!(feature = "fast") && !self.any_subnormal(nodes) => match self.header.bands {
                0 => self.blend_halves::<2, 1>(all, nodes, weights, sum),
                1 => self.blend_halves::<6, 3>(all, nodes, weights, sum),
                2 => self.blend_halves::<14, 7>(all, nodes, weights, sum),
                3 => self.blend_halves::<24, 12>(all, nodes, weights, sum),
                _ => self.blend_halves::<38, 19>(all, nodes, weights, sum),
            },
            _ => self.blend_any(nodes, weights, sum),
        }
    }

    /// The same of f16 that are all zero or normal.
    fn blend_halves<const W: usize, const V: usize>(
        &self,
        all: &[u32],
        nodes: &[u32; 8],
        weights: &[f32; 8],
        sum: &mut [f32],
    ) {
        let vectors: [[f32; 4]; V] = blend_plain(&rows_of::<W>(all, nodes), &times_2_to_112(*weights));
        let (pairs, last) = vectors.as_chunks::<2>();
        let (eights, rest) = sum.split_at_mut(8 * pairs.len());
        for (out, [even, odd]) in eights.as_chunks_mut::<8>().0.iter_mut().zip(pairs) {
            for lane in 0..4 {
                out[2 * lane] = even[lane] * self.scale;
                out[2 * lane + 1] = odd[lane] * self.scale;
            }
        }
        for (k, out) in rest.iter_mut().enumerate() {
            *out = last[0][[0, 2, 1, 3][k]] * self.scale;
        }
    }

    /// The same of whatever numbers.
    #[inline(never)]
    fn blend_any(&self, nodes: &[u32; 8], weights: &[f32; 8], sum: &mut [f32]) {
        let count = self.header.values_per_node();
        for (&node, weight) in nodes.iter().zip(weights) {
            let value = |k: usize| match &self.coefficients {
                Coefficients::F16(all) => f16_to_f32(half_of(&all[node as usize * words_of(count)..], k)) * self.scale,
                Coefficients::F32(all) => all[node as usize * count + k],
            };
            for (k, sum) in sum[..count].iter_mut().enumerate() {
                *sum += weight * value(k);
            }
        }
    }

    #[inline]
    pub(crate) fn any_subnormal(&self, nodes: &[u32; 8]) -> bool {
        let mark = |marks: &Vec<u8>| nodes.iter().fold(0, |any, &node| any | marks[node as usize]);
        self.marks.as_ref().is_some_and(|marks| mark(marks) & SUBNORMAL != 0)
    }

    /// The nearest point or vertex.
    fn nearest(&self, position: [f64; 3], normal: [f32; 3]) -> usize {
        let query = core::array::from_fn(|axis| {
            let offset = position[axis] - self.header.min[axis];
            if offset.is_finite() { offset } else { 0.0 }
        });
        // A parsed volume has at least one node.
        let Some(nearest) = self.index.nearest(&self.positions, query) else {
            return 0;
        };
        if self.normals.is_empty() {
            return nearest.index;
        }
        let extent: [f64; 3] = core::array::from_fn(|k| self.header.max[k] - self.header.min[k]);
        let diagonal = square_root(extent.iter().map(|v| v * v).sum());
        let radius = square_root(nearest.squared_distance) + NORMAL_TIE * diagonal;
        // The best match; among equally good ones the lowest index, whatever order they come in.
        let mut best = (f64::NEG_INFINITY, nearest.index);
        self.index.within(&self.positions, query, radius * radius, |index| {
            let there = self.normals[index];
            let product = |k: usize| f64::from(there[k]) * f64::from(normal[k]);
            let cosine = product(0) + product(1) + product(2);
            if cosine > best.0 || (cosine == best.0 && index < best.1) {
                best = (cosine, index);
            }
        });
        best.1
    }
}

/// The words of a node.
#[inline(always)]
pub(crate) fn row_of<const W: usize>(all: &[u32], node: u32) -> &[u32; W] {
    &all.as_chunks::<W>().0[node as usize]
}

/// The words of eight nodes.
#[inline(always)]
fn rows_of<'a, const W: usize>(all: &'a [u32], nodes: &[u32; 8]) -> [&'a [u32; W]; 8] {
    let row = |k: usize| row_of(all, nodes[k]);
    let rows = [row(0), row(1), row(2), row(3), row(4), row(5), row(6), row(7)];
    touch(rows.iter().fold(0, |all, row| all ^ row[0] ^ row[W - 1]));
    rows
}

/// The words of four nodes, and of those that follow them.
#[inline(always)]
fn pairs_of<const W: usize>(all: &[u32], nodes: [u32; 4]) -> [&[[u32; W]; 2]; 4] {
    let rows = all.as_chunks::<W>().0;
    let pair = |k: usize| rows[nodes[k] as usize..nodes[k] as usize + 2].first_chunk().expect("two");
    let pairs = [pair(0), pair(1), pair(2), pair(3)];
    touch(pairs.iter().fold(0, |all, [a, b]| all ^ a[0] ^ a[W - 1] ^ b[W - 1]));
    pairs
}

/// Takes what has been read at the ends of rows, so that it is read: then all rows come from memory at once. Left to the arithmetic, the
/// first rows' fills the processor's window before it sees that others are needed: at random places that took half as long again.
#[inline(always)]
fn touch(word: u32) {
    black_box(word);
}

/// The weighted sum of rows of f16 that are all zero or normal, two to a word, in vectors of four:
/// ```text
/// of four words          values 0 2 4 6, then 1 3 5 7
/// of two, at the end     values 0 2 1 3
/// ```
/// The weights come [`times_2_to_112`].
#[inline(never)]
fn blend_plain<const W: usize, const V: usize>(rows: &[&[u32; W]; 8], weights: &[f32; 8]) -> [[f32; 4]; V] {
    let mut sums = [[0.0; 4]; V];
    for (row, weight) in rows.iter().zip(weights) {
        add_row(&mut sums, row, *weight);
    }
    sums
}

/// The same of pairs of rows. (Not inlined, as above: where a compiler sees what becomes of the sums, it takes the vectors apart.)
#[inline(never)]
fn blend_pairs<const W: usize, const V: usize>(pairs: &[&[[u32; W]; 2]; 4], weights: &[f32; 8]) -> [[f32; 4]; V] {
    let mut sums = [[0.0; 4]; V];
    for ([a, b], [p, q]) in pairs.iter().zip(weights.as_chunks::<2>().0) {
        add_row(&mut sums, a, *p);
        add_row(&mut sums, b, *q);
    }
    sums
}

/// What [`upper_f16_to_scaled_f32`] leaves to weights.
pub(crate) const TWO_TO_112: f32 = f32::from_bits((112 + 127) << 23);

/// Weights for values that [`upper_f16_to_scaled_f32`] decoded.
#[inline(always)]
pub(crate) fn times_2_to_112(mut weights: [f32; 8]) -> [f32; 8] {
    weights.iter_mut().for_each(|weight| *weight *= TWO_TO_112);
    weights
}

#[inline(always)]
pub(crate) fn add_row<const W: usize, const V: usize>(sums: &mut [[f32; 4]; V], row: &[u32; W], weight: f32) {
    each_vector(row, sums, |sum, value| *sum += weight * value);
}

/// A row's values, times 2^-112, in the vectors of [`blend_plain`].
#[inline(always)]
pub(crate) fn decode_row<const W: usize, const V: usize>(row: &[u32; W], values: &mut [[f32; 4]; V]) {
    each_vector(row, values, |to, value| *to = value);
}

/// Each of a row's values with what stands in its lane.
#[inline(always)]
fn each_vector<const W: usize, const V: usize>(
    row: &[u32; W],
    vectors: &mut [[f32; 4]; V],
    then: impl Fn(&mut f32, f32),
) {
    let (fours, rest) = row.as_chunks::<4>();
    let (pairs, last) = vectors.as_chunks_mut::<2>();
    for (words, [even, odd]) in fours.iter().zip(pairs) {
        for lane in 0..4 {
            then(&mut even[lane], upper_f16_to_scaled_f32(words[lane] << 16));
            then(&mut odd[lane], upper_f16_to_scaled_f32(words[lane]));
        }
    }
    if let ([a, b], [last]) = (rest, last) {
        let words = [a << 16, b << 16, *a, *b];
        for lane in 0..4 {
            then(&mut last[lane], upper_f16_to_scaled_f32(words[lane]));
        }
    }
}

/// What the values in [`blend_plain`]'s vectors are multiplied by in `convolve().evaluate(normal)`.
#[inline(always)]
fn factors<const W: usize, const V: usize>(normal: [f32; 3]) -> [[f32; 4]; V] {
    let count = 2 * W / 3;
    let mut f = [0.0; MAX_COEFFICIENTS];
    basis(count.isqrt() as u32 - 1, normal, &mut f);
    for k in 0..count {
        f[k] *= COSINE_OF[k];
    }
    in_lanes(&f)
}

/// The same of the convolved basis.
#[inline(always)]
pub(crate) fn in_lanes<const V: usize>(f: &[f32; MAX_COEFFICIENTS]) -> [[f32; 4]; V] {
    let mut factors = [[0.0; 4]; V];
    let (sixes, rest) = factors.as_chunks_mut::<6>();
    for (six, f) in sixes.iter_mut().zip(f.as_chunks::<8>().0) {
        // Vectors from here on; otherwise compilers make each of the factors a number of its own.
        let (low, high) = (black_box([f[0], f[1], f[2], f[3]]), black_box([f[4], f[5], f[6], f[7]]));
        let f = &[low[0], low[1], low[2], low[3], high[0], high[1], high[2], high[3]];
        six[0] = pick(f, [0, 0, 1, 2]);
        six[1] = pick(f, [0, 1, 1, 2]);
        six[2] = pick(f, [2, 3, 4, 4]);
        six[3] = pick(f, [3, 3, 4, 5]);
        six[4] = pick(f, [5, 6, 6, 7]);
        six[5] = pick(f, [5, 6, 7, 7]);
    }
    let f = &f[V / 6 * 8..];
    match rest {
        // One coefficient, and nothing.
        [last] => *last = [f[0], f[0], f[0], 0.0],
        // Four.
        [even, odd, last] => {
            let f: &[f32; 4] = f.first_chunk().expect("four coefficients");
            *even = pick(f, [0, 0, 1, 2]);
            *odd = pick(f, [0, 1, 1, 2]);
            *last = pick(f, [2, 3, 3, 3]);
        }
        _ => {}
    }
    factors
}

/// `convolve().evaluate(normal)` of radiance as [`blend_plain`] makes it, times `scale`.
#[inline(always)]
fn irradiance<const V: usize>(radiance: &[[f32; 4]; V], factors: &[[f32; 4]; V], scale: f32) -> [f32; 3] {
    sum_of_lanes(&products(radiance, factors).map(black_box), scale)
}

/// The sums of every third vector's products: lanes of one vector after the other are r b g r, g r b g, b g r b, and again.
#[inline(always)]
pub(crate) fn products<const V: usize>(radiance: &[[f32; 4]; V], factors: &[[f32; 4]; V]) -> [[f32; 4]; 3] {
    let mut sums = [[0.0; 4]; 3];
    for (k, (radiance, factors)) in radiance.iter().zip(factors).enumerate() {
        for lane in 0..4 {
            sums[k % 3][lane] += radiance[lane] * factors[lane];
        }
    }
    sums
}

/// What [`products`] come to, red green blue, times `scale`.
#[inline(always)]
pub(crate) fn sum_of_lanes([a, b, c]: &[[f32; 4]; 3], scale: f32) -> [f32; 3] {
    [
        scale * ((a[0] + a[3]) + (b[1] + c[2])),
        scale * ((a[2] + b[0]) + (b[3] + c[1])),
        scale * ((a[1] + b[2]) + (c[0] + c[3])),
    ]
}

#[inline(always)]
fn pick<const N: usize>(f: &[f32; N], [a, b, c, d]: [usize; 4]) -> [f32; 4] {
    [f[a], f[b], f[c], f[d]]
}
