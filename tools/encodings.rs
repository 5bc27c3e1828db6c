//! Ways to write the coefficients of a grid in few bytes: quantise to integers in planes, predict those, compress.
//!
//! All work on the coefficients of irradiance, e_lm = A_l L_lm. There the basis is orthonormal, so that an error of the
//! coefficients *is* the error of E: sqrt(Σ Δe² / Σ e²) over coefficients and channels equals the relative RMSE of E
//! over all normals and channels; and band 2 needs a quarter of the precision that its radiance would. Reading E from
//! them is the dot product with Y_lm.
//!
//! Based on: L. Ibarria, P. Lindstrom, J. Rossignac and A. Szymczak, "Out-of-core Compression and Decompression of Large
//! n-dimensional Scalar Fields" (2003), for the Lorenzo predictor; Khronos, `EXT_texture_shared_exponent` (2006).

use crate::least_squares::{eigenvectors, solve};
use gdibl_runtime::Volume;
use gdibl_runtime::format::{Kind, byte_shuffle};
use gdibl_runtime::sh::{COSINE, band_of, coefficient_count};
use half::f16;
use std::collections::BTreeMap;

/// Coefficients of irradiance at the nodes of a grid, x fastest.
pub struct Field {
    /// Nodes per axis.
    pub counts: [usize; 3],
    /// Whether a node was baked. The others are not stored.
    pub valid: Vec<bool>,
    /// Per node: red, green, blue of coefficient 0, of coefficient 1, …
    pub nodes: Vec<Vec<f64>>,
}

impl Field {
    /// Bands 0 to `bands` of a volume.
    ///
    /// # Panics
    /// If it is no grid, or has fewer bands.
    pub fn of_volume(volume: &Volume, bands: u32) -> Field {
        let header = volume.header();
        assert!(header.kind == Kind::Grid, "nodes of kind {:?}, not a grid", header.kind);
        assert!(header.bands >= bands, "L{}, not L{bands} or more", header.bands);
        let node = |index: usize| -> Vec<f64> {
            let sh = volume.node_sh(index);
            let scaled = sh.coefficients[..coefficient_count(bands)].iter().enumerate();
            scaled.flat_map(|(i, rgb)| rgb.map(|v| f64::from(v) * f64::from(COSINE[band_of(i)]))).collect()
        };
        let nodes: Vec<Vec<f64>> = (0..volume.node_count()).map(node).collect();
        Field { counts: header.counts.map(|count| count as usize), valid: lit_nodes(volume), nodes }
    }

    /// How many nodes are stored.
    pub fn stored(&self) -> usize {
        self.valid.iter().filter(|&&valid| valid).count()
    }

    fn baked(&self) -> impl Iterator<Item = &Vec<f64>> {
        self.nodes.iter().zip(&self.valid).filter(|&(_, &valid)| valid).map(|(node, _)| node)
    }
}

/// Whether a node was baked, and is not dark: above 2^-30 of the brightest. A relative error of the dark means nothing.
pub fn lit_nodes(volume: &Volume) -> Vec<bool> {
    let brightness: Vec<f32> =
        (0..volume.node_count()).map(|node| volume.node_sh(node).coefficients[0].iter().sum()).collect();
    let least = brightness.iter().copied().fold(0.0, f32::max) * (-30f32).exp2();
    (0..brightness.len()).map(|node| volume.is_valid(node) && brightness[node] > least).collect()
}

/// How coefficients become integers.
#[derive(Clone, Debug)]
pub enum Quantiser {
    /// Half floats of every coefficient over `scale`.
    Half {
        /// A power of two.
        scale: f64,
    },
    /// Band 0 in RGB9E5; above, per channel the ratio to band 0 in so many bits, -bound to bound: what light that is
    /// nowhere negative can reach.
    Ratio {
        /// 2 to 16.
        bits: u32,
        /// What RGB9E5's largest numbers stand for, a power of two.
        scale: f64,
    },
    /// The logarithm of band 0's sum of channels; the other components of all coefficients over that sum, in an
    /// orthonormal basis of colour (sum, Co, Cg), in equal steps.
    Opponent {
        /// Of sums, in sums of band 0.
        step: f64,
        /// Steps of Co and Cg, in steps of sums.
        chroma: f64,
    },
    /// The same, those components in the basis that decorrelates the volume's (Karhunen-Loève).
    Fitted {
        /// In sums of band 0.
        step: f64,
        /// What is subtracted first.
        mean: Vec<f64>,
        /// Orthonormal; the largest variance first.
        basis: Vec<Vec<f64>>,
    },
}

/// Steps of log2 of band 0's sum per octave: 0.16 % RMS.
const STEPS_PER_OCTAVE: f64 = 128.0;
/// Orthonormal: (R + G + B) / √3, R - B and 2G - R - B, which are YCoCg's Co and Cg but for scale.
const COLOURS: [[f64; 3]; 3] = [
    [0.577_350_269_189_625_8, 0.577_350_269_189_625_8, 0.577_350_269_189_625_8],
    [0.707_106_781_186_547_5, 0.0, -0.707_106_781_186_547_5],
    [-0.408_248_290_463_863, 0.816_496_580_927_726, -0.408_248_290_463_863],
];

impl Quantiser {
    /// For a table.
    pub fn name(&self) -> String {
        match self {
            Quantiser::Half { .. } => "f16".into(),
            Quantiser::Ratio { bits, .. } => format!("RGB9E5, ratios in {bits} bits"),
            Quantiser::Opponent { step, chroma } => format!("log sum, Co and Cg, step {step:.4}, chroma {chroma:.0} x"),
            Quantiser::Fitted { step, .. } => format!("log sum, fitted basis, step {step:.4}"),
        }
    }

    /// Half floats.
    pub fn half(field: &Field) -> Quantiser {
        Quantiser::Half { scale: float_scale(field) }
    }

    /// Ratios in so many bits.
    pub fn ratio(field: &Field, bits: u32) -> Quantiser {
        Quantiser::Ratio { bits, scale: float_scale(field) }
    }

    /// The basis that decorrelates the field.
    pub fn fitted(field: &Field, step: f64) -> Quantiser {
        let vectors: Vec<Vec<f64>> = field.baked().map(|node| opponent(node)[1..].to_vec()).collect();
        let n = vectors.first().map_or(0, Vec::len);
        let count = vectors.len().max(1) as f64;
        let mean: Vec<f64> = (0..n).map(|i| vectors.iter().map(|v| v[i]).sum::<f64>() / count).collect();
        let mut covariance = vec![0.0; n * n];
        for vector in &vectors {
            let centred: Vec<f64> = vector.iter().zip(&mean).map(|(v, m)| v - m).collect();
            for i in 0..n {
                (0..n).for_each(|j| covariance[n * i + j] += centred[i] * centred[j]);
            }
        }
        Quantiser::Fitted { step, mean, basis: eigenvectors(&covariance, n) }
    }

    fn quantise(&self, node: &[f64]) -> Vec<i32> {
        match self {
            Quantiser::Half { scale } => node.iter().map(|v| ordered(f16::from_f64(v / scale))).collect(),
            Quantiser::Ratio { bits, scale } => {
                let shared = encode_rgb9e5([node[0], node[1], node[2]].map(|v| v / scale));
                let band_0 = decode_rgb9e5(shared).map(|v| v * scale);
                let ratio = |(i, v): (usize, &f64)| {
                    let most = f64::from((1 << (bits - 1)) - 1);
                    let ratio = if band_0[i % 3] > 0.0 { v / band_0[i % 3] / bound(i / 3) } else { 0.0 };
                    (ratio.clamp(-1.0, 1.0) * most).round() as i32
                };
                shared.into_iter().chain(node.iter().enumerate().skip(3).map(ratio)).collect()
            }
            Quantiser::Opponent { step, chroma } => {
                let parts = opponent(node);
                let steps =
                    parts[1..].iter().enumerate().map(|(i, v)| (v / chroma_step(i, *step, *chroma)).round() as i32);
                std::iter::once(log_steps(parts[0])).chain(steps).collect()
            }
            Quantiser::Fitted { step, mean, basis } => {
                let parts = opponent(node);
                let along =
                    |axis: &Vec<f64>| -> f64 { (0..mean.len()).map(|i| axis[i] * (parts[i + 1] - mean[i])).sum() };
                let steps = basis.iter().map(|axis| (along(axis) / step).round() as i32);
                std::iter::once(log_steps(parts[0])).chain(steps).collect()
            }
        }
    }

    fn restore(&self, integers: &[i32]) -> Vec<f64> {
        let sum = || (f64::from(integers[0]) / STEPS_PER_OCTAVE).exp2();
        match self {
            Quantiser::Half { scale } => integers.iter().map(|&i| from_ordered(i).to_f64() * scale).collect(),
            Quantiser::Ratio { bits, scale } => {
                let shared = [integers[0], integers[1], integers[2], integers[3]];
                let band_0 = decode_rgb9e5(shared).map(|v| v * scale);
                let most = f64::from((1 << (bits - 1)) - 1);
                let ratios = integers[4..].iter().enumerate();
                let above = ratios.map(|(i, &q)| f64::from(q) / most * bound(i / 3 + 1) * band_0[i % 3]);
                band_0.into_iter().chain(above).collect()
            }
            Quantiser::Opponent { step, chroma } => {
                let steps = integers[1..].iter().enumerate();
                let parts: Vec<f64> = steps.map(|(i, &q)| f64::from(q) * chroma_step(i, *step, *chroma)).collect();
                from_opponent(sum(), &parts)
            }
            Quantiser::Fitted { step, mean, basis } => {
                let mut parts = mean.clone();
                for (axis, &q) in basis.iter().zip(&integers[1..]) {
                    parts.iter_mut().zip(axis).for_each(|(part, along)| *part += f64::from(q) * step * along);
                }
                from_opponent(sum(), &parts)
            }
        }
    }

    /// What a reader needs besides the planes, bytes: mean and basis in f16, of the axes that are ever used.
    fn side_bytes(&self, planes: &[Vec<i32>]) -> usize {
        match self {
            Quantiser::Fitted { mean, .. } => {
                let used = planes[1..].iter().filter(|plane| plane.iter().any(|&q| q != 0)).count();
                2 * mean.len() * (1 + used)
            }
            _ => 0,
        }
    }

    /// Bits that a plane needs where each node's numbers lie at fixed places, as a GPU wants them.
    fn bits(&self, plane: usize, values: &[i32]) -> u32 {
        match self {
            Quantiser::Half { .. } => 16,
            Quantiser::Ratio { .. } if plane < 3 => 9,
            Quantiser::Ratio { .. } if plane == 3 => 5,
            Quantiser::Ratio { bits, .. } => *bits,
            Quantiser::Opponent { .. } | Quantiser::Fitted { .. } => width(values.iter().copied()),
        }
    }
}

/// As the packer does: brings the largest coefficient just under half of the largest number of f16, and of RGB9E5.
fn float_scale(field: &Field) -> f64 {
    let largest = field.baked().flatten().fold(f64::MIN_POSITIVE, |m, v| m.max(v.abs()));
    (largest.log2().ceil() - 15.0).exp2()
}

/// Largest |e_lm| / e_00 of light that is nowhere negative: A_l sqrt(2l + 1) / A_0.
fn bound(coefficient: usize) -> f64 {
    let band = band_of(coefficient);
    f64::from(COSINE[band]) / f64::from(COSINE[0]) * ((2 * band + 1) as f64).sqrt()
}

/// Band 0's sum, then the other components over it: band 0's Co and Cg, band 1's …
fn opponent(node: &[f64]) -> Vec<f64> {
    let mut parts: Vec<f64> = Vec::with_capacity(node.len());
    for rgb in node.chunks_exact(3) {
        parts.extend(COLOURS.iter().map(|colour| (0..3).map(|c| colour[c] * rgb[c]).sum::<f64>()));
    }
    let sum = parts[0].max(f64::MIN_POSITIVE);
    parts[1..].iter_mut().for_each(|v| *v /= sum);
    parts
}

/// The step of component `index` after band 0's sum: each third one is a sum.
fn chroma_step(index: usize, step: f64, chroma: f64) -> f64 {
    if index % 3 == 2 { step } else { step * chroma }
}

/// Undoes [`opponent`].
fn from_opponent(sum: f64, parts: &[f64]) -> Vec<f64> {
    let all: Vec<f64> = std::iter::once(1.0).chain(parts.iter().copied()).collect();
    let rgb = |triple: &[f64]| -> [f64; 3] {
        std::array::from_fn(|c| sum * (0..3).map(|k| COLOURS[k][c] * triple[k]).sum::<f64>())
    };
    all.chunks_exact(3).flat_map(rgb).collect()
}

fn log_steps(sum: f64) -> i32 {
    (sum.max(1e-30).log2() * STEPS_PER_OCTAVE).round() as i32
}

/// Half floats as integers in the order of their values.
fn ordered(value: f16) -> i32 {
    let bits = i32::from(value.to_bits());
    if bits & 0x8000 == 0 { bits } else { -(bits & 0x7fff) }
}

fn from_ordered(integer: i32) -> f16 {
    let bits = integer.unsigned_abs() as u16;
    f16::from_bits(if integer < 0 { bits | 0x8000 } else { bits })
}

/// Red, green, blue in 9 bits, and their exponent in 5.
///
/// Value = mantissa · 2^(exponent - 9), exponent -15 to 16.
fn encode_rgb9e5(rgb: [f64; 3]) -> [i32; 4] {
    let largest = rgb.iter().copied().fold(0.0, f64::max);
    let mut exponent = if largest > 0.0 { largest.log2().floor() as i32 + 1 } else { -15 };
    exponent = exponent.clamp(-15, 16);
    if (largest / f64::from(exponent - 9).exp2()).round() >= 512.0 {
        exponent += 1;
    }
    let unit = f64::from(exponent - 9).exp2();
    let [r, g, b] = rgb.map(|v| (v / unit).round().clamp(0.0, 511.0) as i32);
    [r, g, b, exponent]
}

fn decode_rgb9e5([r, g, b, exponent]: [i32; 4]) -> [f64; 3] {
    [r, g, b].map(|mantissa| f64::from(mantissa) * f64::from(exponent - 9).exp2())
}

/// What is subtracted from an integer before it is compressed: from those of nodes already read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Predictor {
    /// Nothing.
    None,
    /// The neighbour in x; where a row begins that in y, where a slice begins that in z.
    DeltaX,
    /// x + y + z - xy - xz - yz + xyz of the neighbours: exact for sums of functions of two axes each.
    Lorenzo,
    /// A weighted sum of the same seven, as differences from the plane's mean; the weights fitted per plane, and apart for
    /// the grid's faces.
    Fitted,
}

impl Predictor {
    /// Each.
    pub const ALL: [Predictor; 4] = [Predictor::None, Predictor::DeltaX, Predictor::Lorenzo, Predictor::Fitted];
}

/// The units in 1 of a fitted weight, which is a byte: -2 to 2.
const WEIGHT_ONE: i64 = 64;

/// Which of x, y, z each of the seven neighbours steps back along, as bits.
const NEIGHBOURS: [usize; 7] = [1, 2, 4, 3, 5, 6, 7];

/// A field in integers.
pub struct Quantised {
    /// One per plane; nodes that are not stored hold 0.
    planes: Vec<Vec<i32>>,
    /// Bytes per node at fixed places, whole words of 4: what a GPU reads without thinking.
    pub bytes_in_memory: usize,
    /// Bytes per node of bricks of 4x4x4 nodes, each plane of each brick in as many bits as its own range needs, for all
    /// of the brick's nodes alike: still read in any order. A brick's header says base (16 bits) and width (4) of each.
    pub bytes_in_bricks: f64,
    /// Bytes per volume that a reader needs besides.
    pub side_bytes: usize,
    /// What a reader gets, per stored node: sqrt(Σ Δe² / Σ e²), in the order of the nodes.
    pub errors: Vec<f64>,
    /// The same over all nodes together.
    pub relative_rmse: f64,
}

/// Quantises and restores.
pub fn quantise(field: &Field, quantiser: &Quantiser) -> Quantised {
    let stored: Vec<Vec<i32>> = field.baked().map(|node| quantiser.quantise(node)).collect();
    let (mut errors, mut all_error, mut all_power) = (Vec::new(), 0.0, 0.0);
    for (node, integers) in field.baked().zip(&stored) {
        let restored = quantiser.restore(integers);
        let error: f64 = node.iter().zip(&restored).map(|(a, b)| (a - b).powi(2)).sum();
        let power: f64 = node.iter().map(|v| v * v).sum();
        errors.push((error / power).sqrt());
        (all_error, all_power) = (all_error + error, all_power + power);
    }
    let count = stored.first().map_or(0, Vec::len);
    let compact: Vec<Vec<i32>> = (0..count).map(|p| stored.iter().map(|node| node[p]).collect()).collect();
    let bits: u32 = compact.iter().enumerate().map(|(p, plane)| quantiser.bits(p, plane)).sum();
    let spread = |plane: &Vec<i32>| {
        let mut values = plane.iter();
        field.valid.iter().map(|&valid| if valid { *values.next().expect("one each") } else { 0 }).collect()
    };
    let planes: Vec<Vec<i32>> = compact.iter().map(spread).collect();
    Quantised {
        bytes_in_bricks: brick_bits(field, &planes) as f64 / 8.0 / field.stored().max(1) as f64,
        planes,
        bytes_in_memory: bits.div_ceil(32) as usize * 4,
        side_bytes: quantiser.side_bytes(&compact),
        errors,
        relative_rmse: (all_error / all_power).sqrt(),
    }
}

/// How many bits separate the values' least from their most.
fn width(values: impl Iterator<Item = i32> + Clone) -> u32 {
    let least = values.clone().min().unwrap_or(0);
    let most = values.max().unwrap_or(0);
    32 - ((most - least) as u32).leading_zeros()
}

fn brick_bits(field: &Field, planes: &[Vec<i32>]) -> usize {
    const HEADER: usize = 16 + 4;
    let [nx, ny, _] = field.counts;
    let mut bricks = BTreeMap::<[usize; 3], Vec<usize>>::new();
    for node in (0..field.valid.len()).filter(|&node| field.valid[node]) {
        bricks.entry([node % nx / 4, node / nx % ny / 4, node / nx / ny / 4]).or_default().push(node);
    }
    let bits = |brick: &Vec<usize>, plane: &Vec<i32>| {
        HEADER + brick.len() * width(brick.iter().map(|&node| plane[node])) as usize
    };
    bricks.values().map(|brick| planes.iter().map(|plane| bits(brick, plane)).sum::<usize>()).sum()
}

/// Planes as a compressor gets them.
pub struct Stream {
    /// What is compressed.
    pub bytes: Vec<u8>,
    /// What the same integers take at the least where each is coded by how often its plane has it, bytes.
    pub entropy: f64,
}

/// Predicts, and lays the rest out in bytes: per plane, low bytes then high ones where there are any.
pub fn predict(field: &Field, quantised: &Quantised, predictor: Predictor) -> Stream {
    let mut stream = Stream { bytes: Vec::new(), entropy: 0.0 };
    for plane in &quantised.planes {
        let (side, rest) = residuals(field, plane, predictor);
        // One byte each where that is enough.
        let small = rest.iter().all(|&r| r < 256);
        let bytes: Vec<u8> = rest.iter().flat_map(|r| r.to_le_bytes()).collect();
        let split = byte_shuffle(&bytes, 2).collect::<Vec<u8>>();
        stream.entropy += side.len() as f64 + entropy_bytes(&rest);
        stream.bytes.extend(side);
        stream.bytes.extend(&split[..if small { rest.len() } else { split.len() }]);
    }
    stream
}

/// What a reader makes of [`residuals`]: the plane, 0 where nothing is stored.
#[cfg(test)]
fn unpredict(field: &Field, side: &[u8], rest: &[u16], predictor: Predictor) -> Vec<i32> {
    walk(field, predictor, side, |_, place, prediction| {
        let folded = rest[place];
        prediction.wrapping_add(((folded >> 1) as i16) ^ -((folded & 1) as i16))
    })
}

/// Per stored node the integer less its prediction, folded (0, -1, 1, -2, … become 0, 1, 2, 3, …); before that, what
/// [`fit_weights`] found.
fn residuals(field: &Field, plane: &[i32], predictor: Predictor) -> (Vec<u8>, Vec<u16>) {
    let side = match predictor {
        Predictor::Fitted => fit_weights(field, plane),
        _ => Vec::new(),
    };
    let mut rest = Vec::with_capacity(plane.len());
    walk(field, predictor, &side, |node, _, prediction| {
        let value = plane[node] as i16;
        let difference = value.wrapping_sub(prediction);
        rest.push(((difference << 1) ^ (difference >> 15)) as u16);
        value
    });
    (side, rest)
}

/// Goes through the stored nodes in order: `visit` gets the node, its place among the stored and its prediction, and
/// says its value. Nodes that are not stored take their prediction, so that those beyond have something to go by.
fn walk(field: &Field, predictor: Predictor, side: &[u8], mut visit: impl FnMut(usize, usize, i16) -> i16) -> Vec<i32> {
    let mut values = vec![0i32; field.valid.len()];
    let mut stored = 0;
    for node in 0..values.len() {
        let face = face_of(field, node);
        let around = neighbours(field, &values, node, face);
        let lorenzo =
            || around.iter().zip(NEIGHBOURS).map(|(v, steps)| if steps.count_ones() == 2 { -v } else { *v }).sum();
        let prediction: i64 = match predictor {
            Predictor::None => 0,
            Predictor::DeltaX => around[(face.trailing_zeros() as usize).min(2)],
            Predictor::Lorenzo => lorenzo(),
            Predictor::Fitted => {
                let mean = mean_of(side);
                let weights = &side[2 + 7 * face..][..7];
                let sum: i64 = around.iter().zip(weights).map(|(v, &w)| (v - mean) * i64::from(w as i8)).sum();
                mean + (sum + WEIGHT_ONE / 2).div_euclid(WEIGHT_ONE)
            }
        };
        let prediction = prediction as i16;
        values[node] = i32::from(if field.valid[node] {
            stored += 1;
            visit(node, stored - 1, prediction)
        } else {
            prediction
        });
    }
    values
}

/// Along which axes a node has a neighbour before it, as bits.
fn face_of(field: &Field, node: usize) -> usize {
    let [nx, ny, _] = field.counts;
    let place = [node % nx, node / nx % ny, node / nx / ny];
    (0..3).map(|axis| usize::from(place[axis] > 0) << axis).sum()
}

/// The seven neighbours; 0 for those beyond a face.
fn neighbours(field: &Field, values: &[i32], node: usize, face: usize) -> [i64; 7] {
    let [nx, ny, _] = field.counts;
    let stride = [1, nx, nx * ny];
    NEIGHBOURS.map(|steps| {
        let back: usize = (0..3).map(|axis| (steps >> axis & 1) * stride[axis]).sum();
        if steps & face == steps { i64::from(values[node - back]) } else { 0 }
    })
}

/// What [`fit_weights`] begins with.
fn mean_of(side: &[u8]) -> i64 {
    i64::from(i16::from_le_bytes([side[0], side[1]]))
}

/// The mean of the plane in two bytes; least squares weights per face class, 7 bytes each.
fn fit_weights(field: &Field, plane: &[i32]) -> Vec<u8> {
    // As a reader finds them where nothing is stored: near enough, what is before it in x.
    let mut filled = plane.to_vec();
    (1..filled.len()).filter(|&i| !field.valid[i]).for_each(|i| filled[i] = filled[i - 1]);
    let total: i64 = (0..plane.len()).filter(|&i| field.valid[i]).map(|i| i64::from(plane[i])).sum();
    let mean = (total / field.stored().max(1) as i64) as i16;
    let mut side = mean.to_le_bytes().to_vec();
    let mean = i64::from(mean);
    for class in 0..8 {
        let used: Vec<usize> = (0..7).filter(|&k| NEIGHBOURS[k] & class == NEIGHBOURS[k]).collect();
        let n = used.len();
        let (mut gram, mut right) = (vec![0.0; n * n], vec![0.0; n]);
        for node in (0..filled.len()).filter(|&node| field.valid[node] && face_of(field, node) == class) {
            let around = neighbours(field, &filled, node, class).map(|v| (v - mean) as f64);
            for (i, &a) in used.iter().enumerate() {
                right[i] += around[a] * (i64::from(plane[node]) - mean) as f64;
                used.iter().enumerate().for_each(|(j, &b)| gram[n * i + j] += around[a] * around[b]);
            }
        }
        // A little towards 0, so that few nodes do not fit themselves.
        let level = 1.0 + 1e-4 * (0..n).map(|i| gram[n * i + i]).sum::<f64>();
        (0..n).for_each(|i| gram[n * i + i] += level);
        let found = solve(&gram, &right).unwrap_or_else(|| vec![0.0; n]);
        let mut bytes = [0u8; 7];
        for (&k, weight) in used.iter().zip(found) {
            bytes[k] = (weight * WEIGHT_ONE as f64).round().clamp(-128.0, 127.0) as i8 as u8;
        }
        side.extend(bytes);
    }
    side
}

/// -Σ n log2(n / all) / 8 over the values that occur.
fn entropy_bytes(values: &[u16]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable();
    let all = values.len() as f64;
    let bits = |run: &[u16]| -(run.len() as f64) * (run.len() as f64 / all).log2();
    sorted.chunk_by(|a, b| a == b).map(bits).sum::<f64>() / 8.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Smooth light in a box, a few nodes not baked.
    fn field() -> Field {
        let counts = [6, 5, 4];
        let node = |i: usize| -> Vec<f64> {
            let (x, y, z) = ((i % 6) as f64, (i / 6 % 5) as f64, (i / 30) as f64);
            let level = 0.5 + 0.3 * x + 0.1 * y * z;
            (0..27)
                .map(|k| {
                    level
                        * (1.0 + 0.1 * (k % 3) as f64)
                        * if k < 3 { 1.0 } else { 0.5 * bound(k / 3) * (k as f64 + 0.2 * x + 0.1 * z).sin() }
                })
                .collect()
        };
        Field { counts, valid: (0..120).map(|i| i % 17 != 3).collect(), nodes: (0..120).map(node).collect() }
    }

    #[test]
    fn every_quantiser_restores_within_its_steps() {
        let field = field();
        for (quantiser, most) in [
            (Quantiser::half(&field), 5e-4),
            (Quantiser::ratio(&field, 8), 6e-3),
            (Quantiser::ratio(&field, 11), 2e-3),
            (Quantiser::Opponent { step: 1e-3, chroma: 1.0 }, 4e-3),
            (Quantiser::fitted(&field, 1e-3), 4e-3),
        ] {
            let quantised = quantise(&field, &quantiser);
            assert_eq!(quantised.errors.len(), field.stored());
            let worst = quantised.errors.iter().copied().fold(0.0, f64::max);
            assert!(worst < most && worst > 0.0, "{}: {worst}", quantiser.name());
        }
    }

    #[test]
    fn ratios_never_clamp_light_from_one_direction() {
        let mut values = [0.0; gdibl_runtime::sh::MAX_COEFFICIENTS];
        gdibl_runtime::sh::basis(2, [0.0, 0.0, 1.0], &mut values);
        for i in 1..9 {
            let ratio = f64::from(COSINE[band_of(i)] / COSINE[0] * values[i] / values[0]);
            assert!(ratio.abs() <= bound(i) * 1.000_001, "coefficient {i}: {ratio}");
        }
    }

    #[test]
    fn every_predictor_can_be_undone() {
        let field = field();
        let quantised = quantise(&field, &Quantiser::half(&field));
        for predictor in Predictor::ALL {
            for plane in &quantised.planes {
                let (side, rest) = residuals(&field, plane, predictor);
                let found = unpredict(&field, &side, &rest, predictor);
                for node in (0..120).filter(|&node| field.valid[node]) {
                    assert_eq!(found[node], plane[node], "{predictor:?}, node {node}");
                }
            }
        }
    }

    #[test]
    fn lorenzo_leaves_nothing_of_a_sum_of_functions_of_two_axes() {
        let mut field = field();
        field.valid.fill(true);
        let plane: Vec<i32> = (0..120).map(|i| (i % 6) * (i / 6 % 5) + 3 * (i / 30) * (i % 6)).collect();
        let (_, rest) = residuals(&field, &plane, Predictor::Lorenzo);
        let inner = (0..120).filter(|&node| face_of(&field, node) == 7);
        assert!(inner.map(|node| rest[node]).all(|r| r == 0), "{rest:?}");
    }

    #[test]
    fn a_brick_has_the_bits_of_its_own_range() {
        let field = Field { counts: [8, 1, 1], valid: vec![true; 8], nodes: vec![vec![1.0; 3]; 8] };
        // Alike in the first brick, two bits in the second.
        assert_eq!(brick_bits(&field, &[vec![9, 9, 9, 9, 1000, 1001, 1002, 1003]]), 20 + 20 + 4 * 2);
    }

    #[test]
    fn entropy_of_two_values_alike_is_a_bit_each() {
        assert_eq!(entropy_bytes(&[7, 9, 9, 7, 7, 9, 9, 7]), 1.0);
        assert_eq!(entropy_bytes(&[5; 100]), 0.0);
    }
}
