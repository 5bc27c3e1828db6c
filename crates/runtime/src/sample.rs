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

use crate::bricks::Bricks;
use crate::grid::box_contains;
use crate::half::{f16_to_f32, plain_f16_to_scaled_f32};
use crate::math::square_root;
use crate::sh::{COSINE_OF, MAX_COEFFICIENTS, basis};
use crate::volume::{Coefficients, SUBNORMAL, VALID, WALLED};
use crate::{Grid, Kind, RadianceSh, Volume};
use alloc::vec::Vec;
use core::array;

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
                self.blended(&nodes, &weights, |_, radiance| {
                    sh.coefficients.as_flattened_mut()[..radiance.len()].copy_from_slice(radiance);
                });
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
    pub fn irradiance_f64(&self, position: [f64; 3], normal: [f32; 3]) -> [f32; 3] {
        match self.header.kind {
            Kind::Grid | Kind::Sparse if cfg!(feature = "fast") => {
                let (nodes, weights, _) = self.weights(position, normal);
                self.blended(&nodes, &weights, |bands, radiance| irradiance(bands, radiance, normal))
            }
            _ => self.sample_f64(position, normal).sh.convolve().evaluate(normal),
        }
    }

    /// The point or vertex that [`sample_f64`](Volume::sample_f64) answers with, however far it is; None in a grid, which
    /// answers between its nodes.
    pub fn nearest_node(&self, position: [f64; 3], normal: [f32; 3]) -> Option<usize> {
        matches!(self.header.kind, Kind::Points | Kind::Vertices).then(|| self.nearest(position, normal))
    }

    /// The nodes around a position, their weights, which add up to 1, and the share of valid nodes in them.
    #[inline(always)]
    fn weights(&self, mut position: [f64; 3], normal: [f32; 3]) -> ([u32; 8], [f32; 8], f32) {
        if let Some(walls) = &self.walls {
            position = walls.off_surface(position, normal);
        }
        if let Some(bricks) = &self.bricks {
            return self.sparse_weights(bricks, position);
        }
        let (nodes, mut weights) = self.header.grid().corners(position);
        let mut validity = 1.0;
        if let Some(marks) = &self.marks {
            let wall_cell = (marks[nodes[0] as usize] & WALLED != 0).then_some(nodes[0]);
            validity = self.mark_weights(marks, position, &nodes, &mut weights, wall_cell);
        }
        (nodes, weights, validity)
    }

    /// The same in a sparse grid.
    #[inline(never)]
    fn sparse_weights(&self, bricks: &Bricks, position: [f64; 3]) -> ([u32; 8], [f32; 8], f32) {
        let grid = Grid { counts: bricks.counts(), ..self.header.grid() };
        let (nodes, mut weights, leaf) = bricks.locate(&grid, position);
        let mut validity = 1.0;
        if self.marks.is_some() || self.walls.is_some() {
            let marks = self.marks.as_deref().unwrap_or_default();
            let cell = self.walls.is_some().then(|| grid.index_of(leaf.origin));
            validity = self.mark_weights(marks, position, &nodes, &mut weights, cell);
        }
        (nodes, weights, validity)
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

    /// What `then(bands, values)` makes of the weighted sum of the values of eight nodes. One arm per number of bands, so that
    /// the compiler knows all lengths.
    #[inline(always)]
    fn blended<R>(&self, nodes: &[u32; 8], weights: &[f32; 8], then: impl FnOnce(u32, &[f32]) -> R) -> R {
        if cfg!(not(feature = "fast")) {
            let mut sum = [0.0; 3 * MAX_COEFFICIENTS];
            self.blend_any(nodes, weights, &mut sum);
            return then(self.header.bands, &sum);
        }
        match self.header.bands {
            0 => then(0, &self.blend::<4>(nodes, weights)[..3]),
            1 => then(1, &self.blend::<12>(nodes, weights)),
            2 => then(2, &self.blend::<28>(nodes, weights)[..27]),
            3 => then(3, &self.blend::<48>(nodes, weights)),
            _ => then(4, &self.blend::<76>(nodes, weights)[..75]),
        }
    }

    /// The weighted sum of the values of eight nodes.
    ///
    /// `N` is the number of values per node, and one more where that is odd: so rows are read in whole vectors of four.
    /// The one more is of no meaning.
    #[inline(never)]
    fn blend<const N: usize>(&self, nodes: &[u32; 8], weights: &[f32; 8]) -> [f32; N] {
        let count = N / 3 * 3;
        match &self.coefficients {
            Coefficients::F16(all) if !self.any_subnormal(nodes) => {
                const TWO_TO_112: f32 = f32::from_bits((112 + 127) << 23);
                let rows = nodes.map(|node| all[node as usize * count..].first_chunk().expect("one value at the end"));
                blend_plain(rows, weights.map(|weight| weight * TWO_TO_112), self.scale)
            }
            _ => {
                let mut sum = [0.0; N];
                self.blend_any(nodes, weights, &mut sum);
                sum
            }
        }
    }

    /// The same of whatever numbers.
    #[inline(never)]
    fn blend_any(&self, nodes: &[u32; 8], weights: &[f32; 8], sum: &mut [f32]) {
        let count = self.header.values_per_node();
        for (&node, weight) in nodes.iter().zip(weights) {
            let row = node as usize * count..(node as usize + 1) * count;
            match &self.coefficients {
                Coefficients::F16(all) => {
                    let values = all[row].iter().map(|&bits| f16_to_f32(bits) * self.scale);
                    sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
                }
                Coefficients::F32(all) => {
                    sum.iter_mut().zip(&all[row]).for_each(|(sum, value)| *sum += weight * value);
                }
            }
        }
    }

    #[inline]
    fn any_subnormal(&self, nodes: &[u32; 8]) -> bool {
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

/// The weighted sum of rows of f16 that are all zero or normal, times `scale`.
#[inline(always)]
fn blend_plain<const N: usize>(rows: [&[u16; N]; 8], weights: [f32; 8], scale: f32) -> [f32; N] {
    let mut out = [0.0; N];
    for (k, out) in out.as_chunks_mut::<4>().0.iter_mut().enumerate() {
        let mut sum = [0.0; 4];
        for (row, weight) in rows.iter().zip(weights) {
            for (lane, sum) in sum.iter_mut().enumerate() {
                *sum += weight * plain_f16_to_scaled_f32(row[4 * k + lane]);
            }
        }
        *out = sum.map(|value| value * scale);
    }
    out
}

/// `convolve().evaluate(normal)` of radiance, RGB per coefficient.
#[inline(always)]
fn irradiance(bands: u32, radiance: &[f32], normal: [f32; 3]) -> [f32; 3] {
    let mut factors = [0.0; MAX_COEFFICIENTS];
    basis(bands, normal, &mut factors);
    let mut sum = [0.0; 3];
    for (index, value) in radiance.as_chunks::<3>().0.iter().enumerate() {
        let factor = COSINE_OF[index] * factors[index];
        for c in 0..3 {
            sum[c] += value[c] * factor;
        }
    }
    sum
}
