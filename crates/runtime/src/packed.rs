//! Coefficients in few bytes: a node's brightness as a logarithm, and all else as ratios to it in equal steps.
//!
//! The bound is on irradiance. In its coefficients e_lm = A_l L_lm the basis is orthonormal, so that an error of the
//! coefficients *is* the error of E over all normals; colour goes through an orthonormal basis, too. Of each coefficient
//!
//! ```text
//!     k_0 = (r + g + b) / √3,   k_1 = (r - b) / √2,   k_2 = (2 g - r - b) / √6
//!     M   = 2^((code - 16384) / 256)                        code 1 to 32767; 0: the node is dark, all of it is 0
//!     k   = M s q   with integers q; the first of all, band 0's k_0, is M (1 + s q)
//! ```
//! With the step s, M is band 0's k_0 in nodes that light can make: the first q is 0 there, and takes no room. Where noise has
//! brought band 0 far down, M is the length of all k together, so that no q is large and the bound holds there as well:
//! of n numbers of L0 to L2 all are off by at most half a step of s M, and the first by at most 2^(1/512) - 1 of M, so that E is
//! off by no more than `√(0.00136² + n s²/4)` of its own root mean square, and by about `√(0.0008² + n s²/12)` as a rule.
//!
//! In a file the numbers lie in planes, each as the difference from the node before, in as many bits as they need (see [`crate::bits`]) or
//! compressed. Bytes per node of L2, on two rooms (noise 1.4 and 0.8 %) and two noisy volumes (18 and 3 %), 95 % of the baked nodes
//! off by 0.5 %, filled nodes counted, too:
//!
//! | tried | rooms | noisy |
//! |---|---|---|
//! | **differences, byte shuffle, zstd -19** (-3) | 10.5, 9.8 (11.3, 10.7) | 23.3, 15.2 (24.3, 15.6) |
//! | Rice codes of the differences, per 64 nodes | 12.6, 11.6 | 24.1, 14.2 |
//! | M is the length of all k everywhere | 10.6, 10.0 | 22.9, 15.8 |
//! | 128 steps of M per octave | 10.4, 9.8 | 23.4, 15.3 |
//! | steps per node that follow a quarter of its noise, powers of two | 10.4 | 19.2, 13.9 |
//! | on a GPU: **widths per run of 64 nodes** of the file's order | 17.3, 15.9 | 28.9, 19.0 |
//! | on a GPU: widths per box of 4×4×4 nodes | 15.0, 13.1 | 27.2, 18.7 |
//!
//! Steps that follow the noise are not kept: one step for 2 % brings the volume of 18 % to 17.2, and adds 0.2 % to the whole
//! error of its median node. Nor are boxes, since not all files are full grids.

use crate::bits::{self, BLOCK, Block, LANES, ROWS, fold, place_of, sum_up};
use crate::coefficients::{Coefficients, Numbers, words_of};
use crate::error::{Error, text};
use crate::half::{f16_is_finite, f16_is_subnormal, f32_to_f16};
use crate::math::square_root;
use crate::sh::{COSINE, MAX_COEFFICIENTS, band_of};
use alloc::vec;
use alloc::vec::Vec;
use core::ops::Range;

pub use crate::format::PACKED_STEPS as STEPS;

/// The most numbers of a node: the code of M, and three per coefficient.
pub const MAX_NUMBERS: usize = 1 + 3 * MAX_COEFFICIENTS;

/// Steps of log2 M per octave.
const PER_OCTAVE: i32 = 256;
/// The code of M = 1.
const CODE_OF_1: i32 = 64 * PER_OCTAVE;

/// 2^(i / 512), i from 0 to 511: the codes' values, and the middles between them.
const POWERS: [f64; 512] = {
    // 2^(1/512), 2^(1/256), … 2^(1/2).
    const ROOTS: [f64; 9] = [
        1.001_354_719_892_108_2,
        1.002_711_275_050_202_5,
        1.005_429_901_112_802_7,
        1.010_889_286_051_700_5,
        1.021_897_148_654_116_7,
        1.044_273_782_427_413_8,
        1.090_507_732_665_257_7,
        1.189_207_115_002_721,
        core::f64::consts::SQRT_2,
    ];
    let mut powers = [1.0; 512];
    let mut i = 0;
    while i < 512 {
        let mut bit = 0;
        while bit < 9 {
            if i >> bit & 1 == 1 {
                powers[i] *= ROOTS[bit];
            }
            bit += 1;
        }
        i += 1;
    }
    powers
};

/// 2^(i / 16) and 2^(i / 256), i from 0 to 15: what [`magnitude`] is made of, in a sixteenth of the room.
const COARSE_POWERS: [f64; 16] = every(32);
const FINE_POWERS: [f64; 16] = every(2);

const fn every(step: usize) -> [f64; 16] {
    let mut powers = [0.0; 16];
    let mut i = 0;
    while i < 16 {
        powers[i] = POWERS[step * i];
        i += 1;
    }
    powers
}

/// What a coefficient of radiance is multiplied with before its steps are counted: |A_l|, and band 4's for band 3, too,
/// which irradiance has no part in.
const WEIGHTS: [f64; MAX_COEFFICIENTS] = {
    let mut weights = [0.0; MAX_COEFFICIENTS];
    let mut index = 0;
    while index < MAX_COEFFICIENTS {
        let band = band_of(index);
        weights[index] = (if band < 3 { COSINE[band] } else { -COSINE[4] }) as f64;
        index += 1;
    }
    weights
};

/// What [`WEIGHTS`] are divided out by.
const INVERSE_WEIGHTS: [f32; MAX_COEFFICIENTS] = {
    let mut inverse = [0.0; MAX_COEFFICIENTS];
    let mut index = 0;
    while index < MAX_COEFFICIENTS {
        inverse[index] = (1.0 / WEIGHTS[index]) as f32;
        index += 1;
    }
    inverse
};

const ROOT_2: f64 = core::f64::consts::FRAC_1_SQRT_2;
const ROOT_3: f64 = 0.577_350_269_189_625_8;
const ROOT_6: f64 = 0.408_248_290_463_863;

/// Quantises a node: `values` are its radiance coefficients, red green blue each, `numbers` one more.
///
/// Off by what the module's documentation says, whatever the values, as long as they are finite and the node's M lies within
/// 2^±63.9: what is darker becomes dark, what is brighter is clipped.
pub fn quantise_node(values: &[f32], step: f32, numbers: &mut [i16]) {
    assert!(numbers.len() == values.len() + 1, "{} numbers for {} values", numbers.len(), values.len());
    let mut k = [0.0f64; MAX_NUMBERS - 1];
    let mut squares = 0.0;
    for ((k, rgb), weight) in k.as_chunks_mut::<3>().0.iter_mut().zip(values.as_chunks::<3>().0).zip(WEIGHTS) {
        let [r, g, b] = rgb.map(|value| f64::from(value) * weight);
        *k = [ROOT_3 * (r + g + b), ROOT_2 * (r - b), ROOT_6 * (2.0 * g - r - b)];
        squares += k.iter().map(|v| v * v).sum::<f64>();
    }
    // Light that is nowhere negative comes to 2.83 times its own band 0 at the most: all of it from one direction, in one
    // channel. Then band 0's sum is M; otherwise the whole length.
    let is_light = k[0] > 0.0 && squares <= 9.0 * k[0] * k[0];
    let code = nearest_code(if is_light { k[0] } else { square_root(squares) });
    numbers.fill(0);
    numbers[0] = code;
    if code == 0 {
        return;
    }
    let m = f64::from(magnitude(code));
    let per_step = 1.0 / (m * f64::from(step));
    for (number, k) in numbers[1..].iter_mut().zip(k) {
        *number = rounded(k * per_step);
    }
    numbers[1] = if is_light { 0 } else { rounded((k[0] - m) * per_step) };
}

/// Undoes [`quantise_node`]. A code of M below 1 is dark.
pub fn restore_node(numbers: &[i16], step: f32, values: &mut [f32]) {
    let (code, numbers) = numbers.split_first().expect("a node has numbers");
    let m = magnitude(*code);
    let triples = values.as_chunks_mut::<3>().0.iter_mut().zip(numbers.as_chunks::<3>().0).zip(INVERSE_WEIGHTS);
    for (index, ((rgb, numbers), weight)) in triples.enumerate() {
        *rgb = restore_coefficient(*numbers, m * step, if index == 0 { m } else { 0.0 }, weight);
    }
}

/// M of a code; 0 of those below 1.
fn magnitude(code: i16) -> f32 {
    if code < 1 {
        return 0.0;
    }
    let steps = i32::from(code) - CODE_OF_1;
    let part = steps.rem_euclid(PER_OCTAVE) as usize;
    let power = (COARSE_POWERS[part / 16] * FINE_POWERS[part % 16]) as f32;
    power * f32::from_bits(((steps.div_euclid(PER_OCTAVE) + 127) as u32) << 23)
}

/// The code whose M is nearest in ratio; 0 below the least.
fn nearest_code(m: f64) -> i16 {
    if m.is_nan() || m <= 0.0 {
        return 0;
    }
    let exponent = (m.to_bits() >> 52) as i32 - 1023;
    let mantissa = f64::from_bits(m.to_bits() & (u64::MAX >> 12) | 1023 << 52);
    // Half steps below it, then the nearest whole one.
    let halves = POWERS.partition_point(|&power| power <= mantissa) as i32 - 1;
    let code = CODE_OF_1 + exponent * PER_OCTAVE + (halves + 1) / 2;
    if code < 1 { 0 } else { code.min(i32::from(i16::MAX)) as i16 }
}

/// To the nearest, of two equally near ones away from 0; what does not fit becomes what is nearest to it.
fn rounded(value: f64) -> i16 {
    (value + if value < 0.0 { -0.5 } else { 0.5 }) as i16
}

/// Section `RSH ` of `nodes` nodes with `count` numbers each, which `numbers_of` a node writes: planes of differences from the node
/// before, folded so that small ones are small numbers (0, -1, 1, -2, … become 0, 1, 2, 3, …).
pub fn numbers_to_bytes(nodes: usize, count: usize, mut numbers_of: impl FnMut(usize, &mut [i16])) -> Vec<u8> {
    let mut bytes = vec![0; 2 * nodes * count];
    let elements = bytes.as_chunks_mut::<2>().0;
    each_element(0..nodes, &mut [0; MAX_NUMBERS][..count], &mut numbers_of, |node, plane, element| {
        elements[plane * nodes + node] = element.to_le_bytes();
    });
    bytes
}

/// The same section in packed bits, as [`pack_bits`](bits::pack_bits) makes them of those bytes, which are nowhere: they are 4 times as
/// many. Asks for all nodes some times over, in order.
pub fn numbers_to_bits(nodes: usize, count: usize, mut numbers_of: impl FnMut(usize, &mut [i16])) -> Vec<u8> {
    let mut block = vec![0; count * BLOCK];
    bits::pack_blocks(2, count, nodes, &mut |each| {
        let mut before = [0; MAX_NUMBERS];
        for first in (0..nodes).step_by(BLOCK) {
            let end = nodes.min(first + BLOCK);
            each_element(first..end, &mut before[..count], &mut numbers_of, |node, plane, element| {
                block[plane * BLOCK + node - first] = element;
            });
            for (plane, elements) in block.chunks_exact_mut(BLOCK).enumerate() {
                each(plane, &mut elements[..end - first]);
            }
        }
    })
}

/// Calls `then` with nodes, planes and elements: what each number is more than the same one of the node before, folded. `before` are
/// the numbers of the node before the first, and become those of the last.
fn each_element(
    nodes: Range<usize>,
    before: &mut [i16],
    numbers_of: &mut impl FnMut(usize, &mut [i16]),
    mut then: impl FnMut(usize, usize, u16),
) {
    let mut numbers = [0i16; MAX_NUMBERS];
    for node in nodes {
        let numbers = &mut numbers[..before.len()];
        numbers_of(node, numbers);
        let is_dark = numbers[0] < 1;
        for (plane, (&number, before)) in numbers.iter().zip(&mut *before).enumerate() {
            // In the dark all numbers but the code may be what they want: the node before's.
            let number = if is_dark && plane > 0 { *before } else { number };
            then(node, plane, fold(number.wrapping_sub(*before)));
            *before = number;
        }
    }
}

/// Section `RSH ` as it is stored: where its numbers come from, block by block and plane by plane.
#[derive(Clone, Copy)]
pub(crate) enum Planes<'a> {
    /// Plane by plane, a folded difference per node; the next block and plane.
    Elements(&'a [[u8; 2]]),
    /// The same in blocks.
    Bits(bits::Blocks<'a>),
}

impl<'a> Planes<'a> {
    /// Packed bits as they are usually written; None if they are of another layout.
    pub(crate) fn of_bits(section: bits::Section<'a>, planes: usize) -> Option<Planes<'a>> {
        section.is_plain(planes).then_some(Planes::Bits(section.blocks))
    }
}

/// Red, green and blue of a coefficient of a block's nodes.
type Rgb = [[f32; BLOCK]; 3];

/// The numbers of packed coefficients, read block by block.
#[derive(Clone, Copy)]
struct Reader<'a> {
    planes: Planes<'a>,
    nodes: usize,
    /// Numbers per node.
    count: usize,
    step: f32,
}

impl Reader<'_> {
    /// The next numbers of a plane: those of the nodes from `first` on, the number before them being `before`, which becomes the last.
    #[cfg_attr(not(feature = "fast"), inline(never))]
    fn read(&mut self, first: usize, plane: usize, before: &mut u16, block: &mut Block) {
        let in_block = BLOCK.min(self.nodes - first);
        match &mut self.planes {
            Planes::Bits(blocks) if cfg!(feature = "fast") => blocks.read(in_block, block),
            Planes::Bits(_) => {}
            Planes::Elements(elements) => {
                *block = [0; BLOCK];
                for (node, folded) in elements[plane * self.nodes + first..][..in_block].iter().enumerate() {
                    block[place_of(node)] = u16::from_le_bytes(*folded);
                }
            }
        }
        sum_up(block, before);
    }

    /// Calls `then` with the values of a coefficient of a block's nodes, at their [`place_of`], one after the other; with
    /// the first node and the coefficient's index. Times `factor`.
    fn restore(mut self, factor: f32, then: &mut dyn FnMut(usize, usize, &Rgb)) {
        let (mut numbers, mut values) = ([[0; BLOCK]; 3], [[0.0; BLOCK]; 3]);
        let mut magnitudes = [0.0; BLOCK];
        let mut before = [0; MAX_NUMBERS];
        for first in (0..self.nodes).step_by(BLOCK) {
            self.read(first, 0, &mut before[0], &mut numbers[0]);
            for (m, code) in magnitudes.iter_mut().zip(numbers[0]) {
                *m = magnitude(code as i16) * factor;
            }
            for (index, &weight) in INVERSE_WEIGHTS.iter().enumerate().take(self.count / 3) {
                for (k, numbers) in numbers.iter_mut().enumerate() {
                    let plane = 1 + 3 * index + k;
                    self.read(first, plane, &mut before[plane], numbers);
                }
                let step = self.step;
                let [q0, q1, q2] = &numbers;
                let [r, g, b] = &mut values;
                // Band 0's first number counts from M.
                let share = if index == 0 { 1.0 } else { 0.0 };
                for place in 0..BLOCK {
                    let m = magnitudes[place];
                    let q = [q0[place], q1[place], q2[place]].map(|q| q as i16);
                    [r[place], g[place], b[place]] = restore_coefficient(q, m * step, m * share, weight);
                }
                then(first, index, &values);
            }
        }
    }
}

/// Red, green and blue of a coefficient.
#[inline(always)]
fn restore_coefficient(numbers: [i16; 3], unit: f32, start: f32, weight: f32) -> [f32; 3] {
    const ROOTS: [f32; 3] = [ROOT_3 as f32, ROOT_2 as f32, ROOT_6 as f32];
    let [k0, k1, k2] = numbers.map(|q| f32::from(q) * unit);
    let [k0, k1, k2] = [ROOTS[0] * (k0 + start), ROOTS[1] * k1, ROOTS[2] * k2];
    [k0 + k1 - k2, k0 + 2.0 * k2, k0 - k1 - k2].map(|value| value * weight)
}

/// The coefficients in section `RSH ` of `nodes` nodes with `values` values each, and the scale of those that become f16.
///
/// They become f16 with a power of two as scale that puts the brightest M to 2^11, so that no light overflows. From 2^-25 of that on
/// f16 adds at most 2^-11 to the relative error, to darker nodes 2^-36 of the brightest. In volumes of more contrast than that, and where
/// a number overflows all the same, f32. (Below 2^-25 lie 55 of pandora's 6688 nodes; in f32 all would take twice the memory, and slower
/// samples.)
pub(crate) fn parse(planes: Planes, nodes: usize, values: usize, step: f32) -> Result<Numbers, Error> {
    let reader = Reader { planes, nodes, count: values + 1, step };
    let (least, most) = range_of_codes(reader)?;
    let exponent = (most - CODE_OF_1).div_euclid(PER_OCTAVE) + 1 - 11;
    let scale = f32::from_bits(((exponent + 127) as u32) << 23);
    if most - least <= 36 * PER_OCTAVE
        && let Some((words, subnormal)) = halves(reader, 1.0 / scale)
    {
        return Ok(Numbers { coefficients: Coefficients::F16(words), scale, subnormal });
    }
    let mut all = vec![0.0; nodes * values];
    reader.restore(1.0, &mut |first, index, rgb| {
        for (node, row) in all[first * values..].chunks_exact_mut(values).take(BLOCK).enumerate() {
            for (value, channel) in row[3 * index..].iter_mut().zip(rgb) {
                *value = channel[place_of(node)];
            }
        }
    });
    Ok(Numbers { coefficients: Coefficients::F32(all), scale: 1.0, subnormal: Vec::new() })
}

/// The coefficients times `factor`, as words of two f16, and the nodes that have subnormal ones; None if one overflows.
fn halves(reader: Reader, factor: f32) -> Option<(Vec<u32>, Vec<u32>)> {
    let (values, nodes) = (reader.count - 1, reader.nodes);
    let per_node = words_of(values);
    let mut words = vec![0; nodes * per_node];
    let mut subnormal = Vec::new();
    let (mut all_finite, mut any_small) = (true, false);
    // Of two coefficients, since six values are three words.
    let mut pairs = [[0; BLOCK]; 3];
    reader.restore(factor, &mut |first, index, rgb| {
        let rows = &mut words[first * per_node..nodes.min(first + BLOCK) * per_node];
        let is_last = 3 * index + 3 == values;
        if cfg!(feature = "fast") {
            for (channel, values) in rgb.iter().enumerate() {
                let k = 3 * (index % 2) + channel;
                let words = &mut pairs[k / 2];
                let found = if k % 2 == 0 { round::<0>(values, words) } else { round::<16>(values, words) };
                all_finite &= found.is_finite;
                any_small |= found.any_small;
            }
            if index % 2 == 1 || is_last {
                let column = 3 * (index / 2);
                write_columns(&pairs, rows, per_node, column..per_node.min(column + 3));
            }
        } else {
            for (node, row) in rows.chunks_exact_mut(per_node).enumerate() {
                for (channel, values) in rgb.iter().enumerate() {
                    let k = 3 * index + channel;
                    let half = f32_to_f16(values[place_of(node)]);
                    all_finite &= f16_is_finite(half);
                    any_small |= f16_is_subnormal(half);
                    row[k / 2] |= u32::from(half) << (16 * (k % 2));
                }
            }
        }
        if is_last && any_small {
            // Without a branch for each.
            let is_subnormal = |word: &u32| f16_is_subnormal(*word as u16) | f16_is_subnormal((word >> 16) as u16);
            for (node, row) in rows.chunks_exact(per_node).enumerate() {
                if row.iter().fold(false, |any, word| any | is_subnormal(word)) {
                    subnormal.push((first + node) as u32);
                }
            }
            any_small = false;
        }
    });
    all_finite.then_some((words, subnormal))
}

/// Writes some words of a block's nodes, three at most.
fn write_columns(columns: &[[u32; BLOCK]; 3], rows: &mut [u32], per_node: usize, range: Range<usize>) {
    for (lane, rows) in rows.chunks_mut(ROWS * per_node).enumerate() {
        for (row, words) in rows.chunks_exact_mut(per_node).enumerate() {
            let place = (LANES * row + lane) % BLOCK;
            match &mut words[range.clone()] {
                [a, b, c] => [*a, *b, *c] = [columns[0][place], columns[1][place], columns[2][place]],
                words => words.iter_mut().zip(columns).for_each(|(word, column)| *word = column[place]),
            }
        }
    }
}

/// What became of values that were rounded to f16.
struct Rounded {
    is_finite: bool,
    /// Some are subnormal, or were.
    any_small: bool,
}

/// As [`f32_to_f16`], but without a branch for each. To the lower halves of words, SHIFT being 0, or to the upper, it being 16; the
/// lower come first.
fn round<const SHIFT: u32>(values: &[f32; BLOCK], words: &mut [u32; BLOCK]) -> Rounded {
    const SMALLEST_NORMAL: u32 = 113 << 23;
    /// From here on it would become infinity.
    const OVERFLOW: u32 = 0x477f_f000;
    let (mut small, mut large) = (0, 0);
    // All ones where it is too small for the first way.
    let is_small = |magnitude: u32| (magnitude.wrapping_sub(SMALLEST_NORMAL) as i32 >> 31) as u32;
    for (word, value) in words.iter_mut().zip(values) {
        let bits = value.to_bits();
        let magnitude = bits & 0x7fff_ffff;
        small |= magnitude & is_small(magnitude);
        large |= (OVERFLOW - 1).wrapping_sub(magnitude);
        let rounded = magnitude.wrapping_sub(112 << 23).wrapping_add(0x0fff + (magnitude >> 13 & 1)) >> 13;
        let half = rounded & !is_small(magnitude) | bits >> 16 & 0x8000;
        *word = if SHIFT == 0 { half } else { *word | half << SHIFT };
    }
    if small != 0 {
        // Those are 0 so far, but for the sign. Below 2^-14 f16's step is 2^-24, which is f32's between 1/2 and 1: adding 1/2 rounds.
        for (word, value) in words.iter_mut().zip(values) {
            let magnitude = value.to_bits() & 0x7fff_ffff;
            let rounded = (f32::from_bits(magnitude) + 0.5).to_bits().wrapping_sub(0.5f32.to_bits());
            *word |= (rounded & is_small(magnitude)) << SHIFT;
        }
    }
    Rounded { is_finite: large >> 31 == 0, any_small: small != 0 }
}

/// The least and the largest code of M of nodes that are not dark; [`CODE_OF_1`] twice if there is none.
fn range_of_codes(mut reader: Reader) -> Result<(i32, i32), Error> {
    let (mut least, mut most) = (i32::MAX, i32::MIN);
    let (mut before, mut block) = (0, [0; BLOCK]);
    for first in (0..reader.nodes).step_by(BLOCK) {
        reader.read(first, 0, &mut before, &mut block);
        let in_block = BLOCK.min(reader.nodes - first);
        for node in 0..in_block {
            let code = block[place_of(node)] as i16;
            if code < 0 {
                return Err(Error::invalid(
                    text!("section RSH , node {}, plane 0", first + node),
                    text!("the code {code}"),
                    "0 to 32767",
                ));
            }
            if code > 0 {
                (least, most) = (least.min(code.into()), most.max(code.into()));
            }
        }
        if cfg!(feature = "fast")
            && let Planes::Bits(blocks) = &mut reader.planes
        {
            // The other planes.
            for _ in 1..reader.count {
                blocks.skip(in_block);
            }
        }
    }
    Ok(if most > 0 { (least, most) } else { (CODE_OF_1, CODE_OF_1) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::prelude::v1::*;

    fn random(state: &mut u64) -> f64 {
        *state ^= *state << 13;
        *state ^= *state >> 7;
        *state ^= *state << 17;
        (*state >> 11) as f64 / (1u64 << 53) as f64
    }

    /// What the module's documentation promises at most of E's root mean square, for numbers of E and the step.
    fn bound(numbers: usize, step: f32) -> f64 {
        (0.00136f64.powi(2) + numbers as f64 * f64::from(step).powi(2) / 4.0).sqrt()
    }

    /// The root mean square over normals and channels of what E is off by, over that of E.
    fn error_of_irradiance(values: &[f32], restored: &[f32]) -> f64 {
        let (mut error, mut power) = (0.0, 0.0);
        for (i, (value, restored)) in values.iter().zip(restored).enumerate() {
            let factor = f64::from(COSINE[band_of(i / 3)]);
            error += (factor * (f64::from(*value) - f64::from(*restored))).powi(2);
            power += (factor * f64::from(*value)).powi(2);
        }
        if power > 0.0 { (error / power).sqrt() } else { error }
    }

    fn check(values: &[f32], step: f32, what: &str) -> f64 {
        let mut numbers = vec![0; values.len() + 1];
        quantise_node(values, step, &mut numbers);
        let mut restored = vec![0.0; values.len()];
        restore_node(&numbers, step, &mut restored);
        let error = error_of_irradiance(values, &restored);
        assert!(error <= bound(values.len(), step), "{what}, step {step}: {error} of {}", bound(values.len(), step));
        error
    }

    #[test]
    fn error_of_irradiance_stays_within_the_bound_for_any_node() {
        let mut state = 1;
        let mut total = [0.0; 2];
        for round in 0..20_000 {
            let count = [1, 4, 9][round % 3];
            let step = [2e-4, 1e-3, 3.4e-3, 0.01, 0.05][round / 3 % 5];
            // Numbers alike or of very different sizes, of either sign, of any brightness; a channel nearly dark; band 0 all
            // but gone, or negative, as noise may leave it.
            let level = 10f64.powf(-10.0 + 20.0 * random(&mut state));
            let spread = [0.0, 1.0, 6.0][round / 15 % 3];
            let channels = [[1.0, 1.0, 1.0], [1.0, 1e-6, 0.3], [0.0, 0.0, 1.0]][round / 45 % 3];
            let band_0 = [1.0, 3.0, 0.01, -0.5, 0.0][round / 135 % 5];
            let mut values = vec![0.0f32; 3 * count];
            for (i, value) in values.iter_mut().enumerate() {
                let size = level * 10f64.powf(-spread * random(&mut state)) * channels[i % 3];
                let sign = if i < 3 { band_0 } else { 2.0 * random(&mut state) - 1.0 };
                *value = (size * sign) as f32;
            }
            let error = check(&values, step, "random");
            if step == 3.4e-3 && count == 9 {
                total = [total[0] + error * error, total[1] + 1.0];
            }
        }
        // As a rule much less than at most.
        let typical = (total[0] / total[1]).sqrt();
        assert!(typical < (0.0008f64.powi(2) + 27.0 * 3.4e-3f64.powi(2) / 12.0).sqrt(), "{typical}");
    }

    #[test]
    fn bits_without_bytes_between_are_those_of_the_bytes() {
        let mut state = 5;
        for nodes in [0, 1, 127, 128, 129, 1000] {
            for (count, shift) in [(4, 0), (28, 0), (28, 2)] {
                let all: Vec<i16> =
                    (0..nodes * count).map(|_| ((random(&mut state) * 900.0) as i16) << shift).collect();
                // Some nodes are dark.
                let numbers_of = |node: usize, numbers: &mut [i16]| {
                    numbers.copy_from_slice(&all[node * count..][..count]);
                    numbers[0] *= i16::from(!node.is_multiple_of(7));
                };
                let bytes = numbers_to_bytes(nodes, count, numbers_of);
                let layout = bits::Layout { element_size: 2, planes: count };
                assert!(
                    numbers_to_bits(nodes, count, numbers_of) == bits::pack_bits(&bytes, layout),
                    "{nodes} {count}"
                );
            }
        }
    }

    #[test]
    fn light_from_one_direction_in_one_channel_leaves_the_first_number_0() {
        let mut state = 2;
        for _ in 0..1000 {
            let direction = [0, 1, 2].map(|_| 2.0 * random(&mut state) - 1.0);
            let length = direction.iter().map(|v| v * v).sum::<f64>().sqrt();
            let mut functions = [0.0; MAX_COEFFICIENTS];
            crate::sh::basis(4, direction.map(|v| (v / length) as f32), &mut functions);
            for bands in 0..=4 {
                let values: Vec<f32> =
                    functions[..crate::sh::coefficient_count(bands)].iter().flat_map(|&f| [0.0, f, 0.0]).collect();
                let mut numbers = vec![0; values.len() + 1];
                quantise_node(&values, 0.003, &mut numbers);
                assert_eq!(numbers[1], 0, "L{bands}, {direction:?}");
                check(&values, 0.003, "one direction");
            }
        }
    }

    #[test]
    fn dark_too_dark_and_too_bright_nodes_stay_finite() {
        for (value, expected) in [(0.0, 0.0), (1e-30, 0.0), (-1e-30, 0.0), (f32::MAX, 1e18), (f32::MIN, -1e18)] {
            let mut numbers = [0; 28];
            quantise_node(&[value; 27], 0.003, &mut numbers);
            let mut restored = [0.0; 27];
            restore_node(&numbers, 0.003, &mut restored);
            for value in restored {
                let in_order = if expected == 0.0 { value == 0.0 } else { value / expected > 1.0 };
                assert!(value.is_finite() && in_order, "{value} for {expected}");
            }
        }
    }

    #[test]
    fn every_code_is_the_nearest_of_its_own_magnitude() {
        assert_eq!(magnitude(CODE_OF_1 as i16), 1.0);
        assert_eq!(magnitude(0), 0.0);
        for code in 1..=i16::MAX {
            let m = f64::from(magnitude(code));
            let truth = (f64::from(code) / 256.0 - 64.0).exp2();
            assert!((m / truth - 1.0).abs() < 1e-7, "{code}: {m}, not {truth}");
            // As from the table of all powers: files do not change their light.
            let steps = i32::from(code) - CODE_OF_1;
            let power = POWERS[2 * steps.rem_euclid(PER_OCTAVE) as usize] as f32;
            let octave = f32::from_bits(((steps.div_euclid(PER_OCTAVE) + 127) as u32) << 23);
            assert_eq!(m, f64::from(power * octave));
            for factor in [1.0, 1.0013, 0.9987] {
                assert_eq!(nearest_code(m * factor), code);
            }
        }
    }

    #[test]
    fn what_was_restored_is_quantised_to_the_same_numbers() {
        let mut state = 3;
        for _ in 0..1000 {
            let mut values = [0.0; 27].map(|_| (random(&mut state) - 0.5) as f32);
            values[..3].copy_from_slice(&[1.0, 0.5, 2.0]);
            let mut numbers = [[0; 28]; 2];
            quantise_node(&values, 0.0034, &mut numbers[0]);
            // Rounded to f16 in between, as a volume in memory is.
            restore_node(&numbers[0], 0.0034, &mut values);
            values = values.map(|value| crate::half::f16_to_f32(f32_to_f16(value)));
            quantise_node(&values, 0.0034, &mut numbers[1]);
            assert_eq!(numbers[0], numbers[1]);
        }
    }
}
