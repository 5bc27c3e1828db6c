//! Coefficients in memory, as files and packed numbers become them.

use alloc::vec::Vec;

/// Node by node.
#[derive(Clone, Debug)]
pub(crate) enum Coefficients {
    /// [`words_of`] each, the first value in the lower half; a zero after an odd number of values. (In words, for what
    /// compilers make of reading 16-bit numbers is slow.)
    F16(Vec<u32>),
    /// `Header::values_per_node` each.
    F32(Vec<f32>),
}

/// How many words so many values take.
pub(crate) fn words_of(values: usize) -> usize {
    values.div_ceil(2)
}

/// 16-bit value `k` of a node's words.
#[inline(always)]
pub(crate) fn half_of(words: &[u32], k: usize) -> u16 {
    (words[k / 2] >> (16 * (k % 2))) as u16
}

/// What section `RSH ` says.
pub(crate) struct Numbers {
    pub(crate) coefficients: Coefficients,
    pub(crate) scale: f32,
    /// The nodes with subnormal f16.
    pub(crate) subnormal: Vec<u32>,
}
