//! The byte shuffle: first the first byte of every element, then every second byte, and so on. The high bytes of
//! neighbouring floats are alike, so a compressor finds more to say less about.
//!
//! ```text
//! elements   a0 a1 | b0 b1 | c0 c1
//! shuffled   a0 b0 c0 a1 b1 c1
//! ```
//! Based on: the shuffle filter of HDF5 and Blosc. It runs over a whole section.

use alloc::vec;
use alloc::vec::Vec;

/// The bytes of elements of `element_size` bytes, shuffled: a compressor takes them piece by piece.
///
/// # Panics
/// If the length is no multiple of `element_size`, or that is 0.
pub fn byte_shuffle(bytes: &[u8], element_size: usize) -> impl Iterator<Item = u8> {
    element_count(bytes, element_size);
    (0..element_size).flat_map(move |k| bytes.iter().skip(k).step_by(element_size).copied())
}

/// Undoes [`byte_shuffle`].
///
/// # Panics
/// As [`byte_shuffle`].
pub fn byte_unshuffle(bytes: &[u8], element_size: usize) -> Vec<u8> {
    let count = element_count(bytes, element_size);
    let mut elements = vec![0; bytes.len()];
    if count == 0 {
        return elements;
    }
    for (k, plane) in bytes.chunks_exact(count).enumerate() {
        for (byte, element) in plane.iter().zip(elements.chunks_exact_mut(element_size)) {
            element[k] = *byte;
        }
    }
    elements
}

fn element_count(bytes: &[u8], element_size: usize) -> usize {
    assert!(
        element_size > 0 && bytes.len().is_multiple_of(element_size),
        "{} bytes are not whole elements of {element_size}",
        bytes.len()
    );
    bytes.len() / element_size
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shuffle_puts_first_bytes_first() {
        assert_eq!(byte_shuffle(b"aAbBcC", 2).collect::<Vec<u8>>(), b"abcABC");
        assert_eq!(byte_shuffle(b"abcdABCD", 4).collect::<Vec<u8>>(), b"aAbBcCdD");
    }

    #[test]
    fn unshuffle_undoes_shuffle() {
        for element_size in [1, 2, 4] {
            for count in [0, 1, 2, 3, 100] {
                let bytes: Vec<u8> = (0..element_size * count).map(|i| (i * 37) as u8).collect();
                let shuffled: Vec<u8> = byte_shuffle(&bytes, element_size).collect();
                assert_eq!(byte_unshuffle(&shuffled, element_size), bytes);
            }
        }
    }
}
