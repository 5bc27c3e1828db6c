//! Irradiance at many positions in one call.
//!
//! The answers are those of [`irradiance`](Volume::irradiance), bit by bit, in less time. In groups of [`GROUP`]:
//!
//! 1. All positions' cells are found, four or two positions to an instruction, and their corners' rows touched, so that these come
//!    from memory at once.
//! 2. One position after the other, the corners are blended. Where several in a row lie in a cell, what its rows hold is decoded once.

use crate::bricks::{Bricks, Located};
use crate::coefficients::Coefficients;
use crate::grid::corner_weight;
use crate::sample::{TWO_TO_112, add_row, decode_row, in_lanes, products, row_of, sum_of_lanes, times_2_to_112};
use crate::sh::{COSINE_OF, MAX_COEFFICIENTS, basis};
use crate::volume::MIXED;
use crate::{Kind, Volume};
use core::hint::black_box;

/// Positions whose cells are found together. Along a path 8 took a tenth longer, 64 as long.
const GROUP: usize = 32;

/// Whether it pays. In WebAssembly it takes longer than one by one, without SIMD and (places at random) with it.
const PAYS: bool = cfg!(all(feature = "fast", not(target_arch = "wasm32")));

impl Volume {
    /// [`irradiance`](Volume::irradiance) at positions in metres, each with the unit normal of its index: the same bits, in
    /// less time. Positions are f32, or f64 for levels far from the origin. Fastest in an order in which those in one cell
    /// follow each other.
    ///
    /// # Panics
    /// If the three slices differ in length.
    pub fn irradiance_batch<P: Copy + Into<f64>>(
        &self,
        positions: &[[P; 3]],
        normals: &[[f32; 3]],
        irradiance: &mut [[f32; 3]],
    ) {
        let counts = [positions.len(), normals.len(), irradiance.len()];
        assert!(counts == [counts[0]; 3], "{} positions, {} normals, {} answers", counts[0], counts[1], counts[2]);
        if let (Coefficients::F16(all), Kind::Grid | Kind::Sparse, true) = (&self.coefficients, self.header.kind, PAYS)
        {
            return match self.header.bands {
                0 => self.batch_of_halves::<2, 1, P>(all, positions, normals, irradiance),
                1 => self.batch_of_halves::<6, 3, P>(all, positions, normals, irradiance),
                2 => self.batch_of_halves::<14, 7, P>(all, positions, normals, irradiance),
                3 => self.batch_of_halves::<24, 12, P>(all, positions, normals, irradiance),
                _ => self.batch_of_halves::<38, 19, P>(all, positions, normals, irradiance),
            };
        }
        for ((position, normal), irradiance) in positions.iter().zip(normals).zip(irradiance) {
            *irradiance = self.irradiance_f64(position.map(Into::into), *normal);
        }
    }

    /// `W` words and `V` vectors are a node's values.
    fn batch_of_halves<const W: usize, const V: usize, P: Copy + Into<f64>>(
        &self,
        all: &[u32],
        positions: &[[P; 3]],
        normals: &[[f32; 3]],
        irradiance: &mut [[f32; 3]],
    ) {
        let mut places = Places { positions: [[0.0; GROUP]; 3], normals: [[0.0; GROUP]; 3] };
        let mut cells = Cells { located: None, lowest: [0; GROUP], nodes: [[0; 8]; GROUP], weights: [[0.0; GROUP]; 8] };
        let mut blending = Blending {
            lowest: None,
            rows: [[[0.0; 4]; V]; 8],
            factors: [[0.0; MAX_COEFFICIENTS]; GROUP],
            products: [[[0.0; 4]; 3]; GROUP],
        };
        let groups = positions.chunks(GROUP).zip(normals.chunks(GROUP)).zip(irradiance.chunks_mut(GROUP));
        for ((positions, normals), irradiance) in groups {
            for (k, (position, normal)) in positions.iter().zip(normals).enumerate() {
                for axis in 0..3 {
                    places.positions[axis][k] = position[axis].into();
                    places.normals[axis][k] = normal[axis];
                }
            }
            let count = irradiance.len();
            match &self.bricks {
                None => self.find_cells(&places, count, &mut cells),
                Some(bricks) => self.find_leaves(bricks, &places, count, &mut cells),
            }
            touch_rows::<W>(all, &cells, count);
            self.blend_cells::<W, V>(all, &places, &cells, &mut blending, irradiance);
        }
    }

    /// In a grid.
    #[inline(never)]
    fn find_cells(&self, places: &Places, count: usize, cells: &mut Cells) {
        let (lowest, share) = match &self.walls {
            None => self.finder.lowest(&places.positions),
            Some(walls) => {
                let mut moved = places.positions;
                for k in 0..count {
                    let position = walls.off_surface(places.position(k), places.normal(k));
                    moved.iter_mut().zip(position).for_each(|(along, coordinate)| along[k] = coordinate);
                }
                self.finder.lowest(&moved)
            }
        };
        cells.lowest = lowest;
        for (corner, of_corner) in cells.weights.iter_mut().enumerate() {
            for k in 0..GROUP {
                of_corner[k] = corner_weight(corner, [share[0][k], share[1][k], share[2][k]]) * TWO_TO_112;
            }
        }
        let offsets = self.finder.corner_offsets();
        for (k, lowest) in lowest.into_iter().enumerate().take(count) {
            if !cells.goes_on(k) {
                cells.nodes[k] = offsets.map(|offset| lowest.wrapping_add(offset));
            }
        }
        if let Some(marks) = &self.marks {
            for (k, lowest) in lowest.into_iter().enumerate().take(count) {
                if marks[lowest as usize] & MIXED != 0 {
                    let (_, weights, _) = self.weights(places.position(k), places.normal(k));
                    cells.set_weights(k, weights);
                }
            }
        }
    }

    /// In a sparse grid.
    #[inline(never)]
    fn find_leaves(&self, bricks: &Bricks, places: &Places, count: usize, cells: &mut Cells) {
        for k in 0..count {
            let mut position = places.position(k);
            if let Some(walls) = &self.walls {
                position = walls.off_surface(position, places.normal(k));
            }
            let (cell, within) = self.finder.cell_at(position);
            let located = match cells.located {
                Some(located) if located.holds(cell) => located,
                _ => bricks.located(cell),
            };
            let (weights, _) = self.located_weights(&located, cell, within, position);
            cells.set_weights(k, weights);
            cells.lowest[k] = self.finder.index_of(located.leaf.origin);
            cells.nodes[k] = located.corners.nodes;
            cells.located = Some(located);
        }
    }

    #[inline(never)]
    fn blend_cells<const W: usize, const V: usize>(
        &self,
        all: &[u32],
        places: &Places,
        cells: &Cells,
        blending: &mut Blending<V>,
        irradiance: &mut [[f32; 3]],
    ) {
        factors::<W>(&places.normals, &mut blending.factors);
        let count = irradiance.len();
        let (mut subnormal, mut is_subnormal) = (0u32, false);
        for k in 0..count {
            let nodes = &cells.nodes[k];
            if !cells.goes_on(k) {
                is_subnormal = self.any_subnormal(nodes);
            }
            subnormal |= u32::from(is_subnormal) << k;
            let lowest = cells.lowest[k];
            let radiance = if blending.lowest == Some(lowest) || (k + 1 < count && cells.goes_on(k + 1)) {
                if blending.lowest != Some(lowest) {
                    blending.lowest = Some(lowest);
                    decode::<W, V>(all, nodes, &mut blending.rows);
                }
                blend(&blending.rows, &cells.weights, k)
            } else {
                blend_rows::<W, V>(all, nodes, &cells.weights, k)
            };
            blending.products[k] = products(&radiance, &in_lanes(&blending.factors[k]));
        }
        // In a loop of its own: reading lanes one by one waits where they have just been written together.
        for (irradiance, products) in irradiance.iter_mut().zip(&blending.products) {
            *irradiance = sum_of_lanes(products, self.scale);
        }
        while subnormal != 0 {
            let k = subnormal.trailing_zeros() as usize;
            irradiance[k] = self.irradiance_f64(places.position(k), places.normal(k));
            subnormal &= subnormal - 1;
        }
    }
}

/// Axis by axis. Where a group is not full, earlier places stand behind its own.
struct Places {
    positions: [[f64; GROUP]; 3],
    normals: [[f32; GROUP]; 3],
}

impl Places {
    fn position(&self, k: usize) -> [f64; 3] {
        self.positions.map(|along| along[k])
    }

    fn normal(&self, k: usize) -> [f32; 3] {
        self.normals.map(|along| along[k])
    }
}

/// Where the places are.
struct Cells {
    /// Of a sparse grid, the last place's leaf.
    located: Option<Located>,
    /// The index of the lowest corner of a place's cell, or leaf. No two have the same.
    lowest: [u32; GROUP],
    nodes: [[u32; 8]; GROUP],
    /// Corner by corner, [`times_2_to_112`].
    weights: [[f32; GROUP]; 8],
}

impl Cells {
    fn set_weights(&mut self, k: usize, weights: [f32; 8]) {
        for (of_corner, weight) in self.weights.iter_mut().zip(times_2_to_112(weights)) {
            of_corner[k] = weight;
        }
    }

    /// Whether a place lies in the cell of the one before.
    fn goes_on(&self, k: usize) -> bool {
        k > 0 && self.lowest[k] == self.lowest[k - 1]
    }
}

/// A cell's rows, and room to work in.
struct Blending<const V: usize> {
    /// Of the cell.
    lowest: Option<u32>,
    rows: [[[f32; 4]; V]; 8],
    factors: [[f32; MAX_COEFFICIENTS]; GROUP],
    products: [[[f32; 4]; 3]; GROUP],
}

/// Reads both ends of rows, so that these are on their way.
#[inline(never)]
fn touch_rows<const W: usize>(all: &[u32], cells: &Cells, count: usize) {
    let mut touched = 0;
    for (k, nodes) in cells.nodes.iter().enumerate().take(count) {
        if !cells.goes_on(k) {
            for &node in nodes {
                let row = row_of::<W>(all, node);
                touched ^= row[0] ^ row[W - 1];
            }
        }
    }
    black_box(touched);
}

/// The basis in normals, convolved.
#[inline(never)]
fn factors<const W: usize>(normals: &[[f32; GROUP]; 3], factors: &mut [[f32; MAX_COEFFICIENTS]; GROUP]) {
    let count = 2 * W / 3;
    for k in 0..GROUP {
        let mut values = [0.0; MAX_COEFFICIENTS];
        basis(count.isqrt() as u32 - 1, [normals[0][k], normals[1][k], normals[2][k]], &mut values);
        for i in 0..count {
            factors[k][i] = values[i] * COSINE_OF[i];
        }
    }
}

#[inline(never)]
fn decode<const W: usize, const V: usize>(all: &[u32], nodes: &[u32; 8], rows: &mut [[[f32; 4]; V]; 8]) {
    for (row, &node) in rows.iter_mut().zip(nodes) {
        decode_row::<W, V>(row_of(all, node), row);
    }
}

/// The weighted sum of nodes' rows. Weights are read where they lie: gathered into an array first, reading that in vectors
/// waits for its single numbers, and all took a third longer.
#[inline(never)]
fn blend_rows<const W: usize, const V: usize>(
    all: &[u32],
    nodes: &[u32; 8],
    weights: &[[f32; GROUP]; 8],
    k: usize,
) -> [[f32; 4]; V] {
    let mut sums = [[0.0; 4]; V];
    for (&node, weights) in nodes.iter().zip(weights) {
        add_row::<W, V>(&mut sums, row_of(all, node), weights[k]);
    }
    sums
}

/// The same of decoded rows. (Not inlined: where a compiler sees what becomes of the sums, it takes the vectors apart.)
#[inline(never)]
fn blend<const V: usize>(rows: &[[[f32; 4]; V]; 8], weights: &[[f32; GROUP]; 8], k: usize) -> [[f32; 4]; V] {
    let mut sums = [[0.0; 4]; V];
    for (row, weights) in rows.iter().zip(weights) {
        for (sum, values) in sums.iter_mut().zip(row) {
            for lane in 0..4 {
                sum[lane] += weights[k] * values[lane];
            }
        }
    }
    sums
}
