//! Light at a position.
//!
//! **Grid**: trilinear between the eight nodes around, of which only valid ones count; their weights are scaled to add
//! up to 1 again. Where none is valid (or less than [`LEAST_VALID`] of them is), filled values are as good as any:
//! plain trilinear over all eight. Outside the box the answer is that of the nearest position in it, and
//! [`Sample::inside`] is false: a caller with several volumes, or with a fallback, looks there.
//!
//! **Points**: the nearest one. **Vertices**: the nearest one; among those within [`NORMAL_TIE`] of it, the one whose
//! normal matches best (the corners of a box share places, and face three ways). Valid or not: asked at the same
//! places, a volume answers what was baked there.
//!
//! Every input has an answer: a coordinate that is no number counts as the box's min.

use crate::grid::box_contains;
use crate::half::f16_to_f32;
use crate::math::square_root;
use crate::volume::Coefficients;
use crate::{Cell, Kind, RadianceSh, Volume};

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
    /// Light at a position in metres. The unit `normal` of the surface there picks between vertices at the same place;
    /// grids and points do not use it.
    pub fn sample(&self, position: [f32; 3], normal: [f32; 3]) -> Sample {
        self.sample_f64(position.map(f64::from), normal)
    }

    /// The same for levels far from the origin, where an f32 is too coarse for a position.
    pub fn sample_f64(&self, position: [f64; 3], normal: [f32; 3]) -> Sample {
        match self.header.kind {
            Kind::Grid => self.sample_grid(&self.header.grid().locate(position)),
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
    /// [`IrradianceSh::evaluate`](crate::IrradianceSh::evaluate).
    pub fn irradiance(&self, position: [f32; 3], normal: [f32; 3]) -> [f32; 3] {
        self.sample(position, normal).sh.convolve().evaluate(normal)
    }

    /// The point or vertex that [`sample_f64`](Volume::sample_f64) answers with, however far it is; None in a grid, which
    /// answers between its nodes.
    pub fn nearest_node(&self, position: [f64; 3], normal: [f32; 3]) -> Option<usize> {
        (self.header.kind != Kind::Grid).then(|| self.nearest(position, normal))
    }

    fn sample_grid(&self, cell: &Cell) -> Sample {
        let mut weights = cell.weights;
        let mut validity = 1.0;
        if let Some(valid) = &self.validity {
            // Weights of valid nodes alone, and what is left of 1.
            let masked: [f32; 8] = core::array::from_fn(|k| weights[k] * f32::from(valid[cell.nodes[k] as usize]));
            validity = masked.iter().sum::<f32>().min(1.0);
            if validity < LEAST_VALID {
                validity = 0.0;
            } else {
                let scale = 1.0 / validity;
                weights = masked.map(|weight| weight * scale);
            }
        }
        let mut sh = RadianceSh::zero(self.header.bands);
        let out = sh.coefficients.as_flattened_mut();
        // A loop of known length per number of bands: the compiler unrolls it into SIMD.
        match self.header.bands {
            0 => self.blend::<3>(&cell.nodes, &weights, out),
            1 => self.blend::<12>(&cell.nodes, &weights, out),
            2 => self.blend::<27>(&cell.nodes, &weights, out),
            3 => self.blend::<48>(&cell.nodes, &weights, out),
            _ => self.blend::<75>(&cell.nodes, &weights, out),
        }
        Sample { sh, validity, inside: cell.inside }
    }

    /// The weighted sum of the `N` values of eight nodes.
    fn blend<const N: usize>(&self, nodes: &[u32; 8], weights: &[f32; 8], out: &mut [f32]) {
        let mut sum = [0.0; N];
        for (&node, &weight) in nodes.iter().zip(weights) {
            let start = node as usize * N;
            match &self.coefficients {
                Coefficients::F32(all) => {
                    for (sum, &value) in sum.iter_mut().zip(&all[start..start + N]) {
                        *sum += weight * value;
                    }
                }
                Coefficients::F16(all) => {
                    let weight = weight * self.header.scale;
                    for (sum, &bits) in sum.iter_mut().zip(&all[start..start + N]) {
                        *sum += weight * f16_to_f32(bits);
                    }
                }
            }
        }
        out[..N].copy_from_slice(&sum);
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
