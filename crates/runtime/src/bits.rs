//! Bit packing: whole numbers in as many bits as their neighbours need. Nothing but shifts, so that a reader needs no library.
//!
//! ```text
//! 0    u8   bits 0 to 3: shift; bit 4: differences; bit 5: elements of 2 bytes, else of 1; the others 0
//! 1    u8   planes, at least 1
//! 2    blocks of 128 elements of each plane, the last one of what is left; in a block all planes, one after the other:
//!           u16   bits 0 to 4: w, 0 to 16; bits 5 to 8: h - 1; bits 9 to 15: e
//!           numbers    16 rows of 8 lanes, w bits each: see below
//!           e outliers, 7 + h bits each: place p and high part, which is added times 2^w to the number at p; to a whole byte
//! …    three zeros, so that a reader may always load four bytes
//! ```
//! The number of element i of a block stands in lane i / 16 and row i % 16, at place 8 · row + lane. A lane's 16 numbers are a string
//! of 16 w bits, the lowest first, in w words of 16 bits. Words lie next to those of the other lanes: first all lanes' first words, and so
//! on. So a processor unpacks a row of eight numbers with the same few shifts of a vector. A block of few elements has as
//! many lanes as it needs.
//!
//! A plane's elements are the numbers times 2^shift. With differences, number f means that the element (before the shift) is the one before
//! it plus f / 2 if f is even, less (f + 1) / 2 if it is odd, modulo 2^16; the first follows a 0.
//!
//! Bytes per node of section `RSH ` of packed L2 grids, the step by a third of the noise (256 directions), 28 planes:
//!
//! | tried | living room | apartment | pandora | shipped box |
//! |---|---|---|---|---|
//! | **differences, 128 elements, outliers apart** | 11.6 | 12.4 | 14.9 | 13.9 |
//! | 64 elements | 11.3 | 12.3 | 14.6 | 13.8 |
//! | without outliers, 128 elements | 15.9 | 16.1 | 19.3 | 17.5 |
//! | without outliers, 16 elements | 12.7 | 13.8 | 15.8 | 14.5 |
//! | least number and width, 32 elements | 13.1 | 13.6 | 16.6 | 14.9 |
//! | outliers of 12 bits | 12.5 | 13.3 | 15.8 | 14.5 |
//! | difference from the mean of the neighbours along x, y, z | 10.8 | 11.6 | 14.9 | 12.5 |
//!
//! The mean of neighbours is not kept: it holds for full grids alone, and takes the planes' rows to read.
//!
//! Based on: D. Lemire and L. Boytsov, "Decoding billions of integers per second through vectorization" (2015): lanes, patched outliers.

use crate::Error;
use crate::error::text;
use crate::format::{Filter, SectionEntry};
use alloc::vec;
use alloc::vec::Vec;

/// Elements of a plane that are packed together.
pub(crate) const BLOCK: usize = LANES * ROWS;
/// Numbers that are unpacked together.
pub(crate) const LANES: usize = 8;
/// Numbers of a lane.
pub(crate) const ROWS: usize = 16;
/// Bytes before the first block.
const HEAD_SIZE: usize = 2;
/// The planes that a byte can count.
const MAX_PLANES: usize = 255;
/// Zeros after the last.
const TAIL_SIZE: usize = 3;
/// Bits of an outlier's place.
const PLACE_BITS: usize = 7;

/// The numbers of a block at their places: element i at [`place_of`] it.
pub(crate) type Block = [u16; BLOCK];

/// Where number `element` of a block stands.
pub(crate) fn place_of(element: usize) -> usize {
    element % ROWS * LANES + element / ROWS
}

/// What the elements of a section are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Bytes of an element: 1 or 2.
    pub element_size: usize,
    /// Planes of as many elements each, 1 to 255. Blocks go through all of them, so that they can be read together.
    pub planes: usize,
}

impl Layout {
    /// Elements of a plane; None if the bytes do not divide so.
    fn elements(&self, size: u64) -> Option<usize> {
        let row = (self.element_size * self.planes) as u64;
        if row > 0 && size.is_multiple_of(row) { usize::try_from(size / row).ok() } else { None }
    }
}

/// Packs a section. Taken as they are or as differences, whichever is smaller.
///
/// # Panics
/// If the bytes are no whole number of elements in each plane, or the layout is none.
pub fn pack_bits(bytes: &[u8], layout: Layout) -> Vec<u8> {
    let Layout { element_size, planes } = layout;
    let elements = layout.elements(bytes.len() as u64).unwrap_or(0);
    assert!(
        (1..=2).contains(&element_size)
            && (1..=255).contains(&planes)
            && elements * planes * element_size == bytes.len(),
        "{} bytes in {layout:?}",
        bytes.len()
    );
    let element = |place: usize| match element_size {
        1 => bytes[place].into(),
        _ => u16::from_le_bytes([bytes[2 * place], bytes[2 * place + 1]]),
    };
    pack_blocks(element_size, planes, elements, &mut |each| {
        for first in (0..elements).step_by(BLOCK) {
            let count = BLOCK.min(elements - first);
            for plane in 0..planes {
                let mut block = [0; BLOCK];
                let own = block.iter_mut().zip(first..first + count);
                own.for_each(|(found, place)| *found = element(plane * elements + place));
                each(plane, &mut block[..count]);
            }
        }
    })
}

/// Calls back with every block of elements, one plane of it after the other, in order. The callee may change them.
pub(crate) type EachBlock<'a> = dyn FnMut(&mut dyn FnMut(usize, &mut [u16])) + 'a;

/// Packs what `blocks` gives, the same each time: twice to know how, and once more to do it. So there need be no place where all
/// elements are.
pub(crate) fn pack_blocks(element_size: usize, planes: usize, elements: usize, blocks: &mut EachBlock<'_>) -> Vec<u8> {
    let mut all = 0;
    let mut how = How { shift: 0, differences: false, before: vec![0; planes] };
    let mut sizes = size_of(&mut how, &mut all, blocks);
    let shift = if elements == 0 { 0 } else { all.trailing_zeros() % 16 };
    if shift > 0 {
        how.shift = shift;
        sizes = size_of(&mut how, &mut all, blocks);
    }
    let [plain, folded] = sizes;
    how.differences = folded < plain;
    let mut bytes = Vec::with_capacity(HEAD_SIZE + plain.min(folded) + TAIL_SIZE);
    bytes.extend([shift as u8 | u8::from(how.differences) << 4 | u8::from(element_size == 2) << 5, planes as u8]);
    how.before.fill(0);
    blocks(&mut |plane, block| {
        how.apply(plane, block);
        pack_block(block, &mut bytes);
    });
    bytes.extend([0; TAIL_SIZE]);
    bytes
}

/// How elements become numbers.
struct How {
    shift: u32,
    differences: bool,
    /// Of each plane.
    before: Vec<u16>,
}

impl How {
    fn apply(&mut self, plane: usize, block: &mut [u16]) {
        for element in block {
            let number = *element >> self.shift;
            let before = core::mem::replace(&mut self.before[plane], number);
            // Of each number what it is more than the one before it.
            *element = if self.differences { fold(number.wrapping_sub(before) as i16) } else { number };
        }
    }
}

/// Bytes of all blocks as they are and as differences. Adds all elements' bits to `all`.
fn size_of(how: &mut How, all: &mut u16, blocks: &mut EachBlock<'_>) -> [usize; 2] {
    let mut sizes = [0; 2];
    let mut packed = Vec::new();
    let mut size = |block: &[u16]| {
        packed.clear();
        pack_block(block, &mut packed);
        packed.len()
    };
    how.before.fill(0);
    blocks(&mut |plane, block| {
        block.iter().for_each(|element| *all |= element);
        how.differences = true;
        let mut folded = [0; BLOCK];
        let folded = &mut folded[..block.len()];
        folded.copy_from_slice(block);
        how.apply(plane, folded);
        block.iter_mut().for_each(|element| *element >>= how.shift);
        sizes[0] += size(block);
        sizes[1] += size(folded);
    });
    sizes
}

/// 0, -1, 1, -2, … become 0, 1, 2, 3, ….
pub(crate) fn fold(difference: i16) -> u16 {
    (difference << 1 ^ difference >> 15) as u16
}

/// Undoes [`fold`].
fn unfold(folded: u16) -> u16 {
    folded >> 1 ^ (folded & 1).wrapping_neg()
}

/// Appends a block in the fewest bytes.
fn pack_block(numbers: &[u16], bytes: &mut Vec<u8>) {
    let lanes = numbers.len().div_ceil(ROWS);
    // How many take more bits than so many.
    let mut wider = [0; 17];
    for number in numbers {
        wider[..16 - number.leading_zeros() as usize].iter_mut().for_each(|count| *count += 1);
    }
    let most = wider.iter().take_while(|&&count| count > 0).count();
    let size = |width: usize| 2 * width * lanes + (wider[width] * (PLACE_BITS + most - width)).div_ceil(8);
    let widths = (0..=most).filter(|&width| wider[width] < BLOCK);
    let width = widths.min_by_key(|&width| size(width)).unwrap_or(most);
    let (count, high_width) = (wider[width], (most - width).max(1));
    bytes.extend(((width | (high_width - 1) << 5 | count << 9) as u16).to_le_bytes());

    let mut words = [[0u16; LANES]; ROWS];
    let low = |number: u16| u32::from(number) & ((1 << width) - 1);
    for (element, &number) in numbers.iter().enumerate() {
        let (lane, bit) = (element / ROWS, element % ROWS * width);
        let pair = low(number) << (bit % 16);
        for (word, part) in words[bit / 16..].iter_mut().zip([pair as u16, (pair >> 16) as u16]) {
            word[lane] |= part;
        }
    }
    bytes.extend(words[..width].iter().flat_map(|row| &row[..lanes]).flat_map(|word| word.to_le_bytes()));

    // What is not a whole byte yet.
    let (mut rest, mut bits) = (0u64, 0);
    for (element, &number) in numbers.iter().enumerate() {
        let high = u64::from(number) >> width;
        if high > 0 {
            rest |= (place_of(element) as u64 | high << PLACE_BITS) << bits;
            bits += PLACE_BITS + high_width;
        }
        while bits >= 8 {
            bytes.push(rest as u8);
            (rest, bits) = (rest >> 8, bits - 8);
        }
    }
    if bits > 0 {
        bytes.push(rest as u8);
    }
}

/// Reads blocks one after the other.
#[derive(Clone, Copy)]
pub(crate) struct Blocks<'a> {
    bytes: &'a [u8],
    at: usize,
}

/// What a block says of itself.
#[derive(Clone, Copy)]
struct Head {
    width: usize,
    outliers: usize,
    /// Bits of one.
    outlier_bits: usize,
    lanes: usize,
    /// Where the outliers begin.
    middle: usize,
    /// Where the block ends.
    end: usize,
}

/// How the blocks of a section are to be read.
#[derive(Clone, Copy)]
pub(crate) struct Section<'a> {
    pub(crate) blocks: Blocks<'a>,
    layout: Layout,
    /// Elements of a plane.
    elements: usize,
    shift: u32,
    differences: bool,
}

impl<'a> Section<'a> {
    /// Reads the head, walks through all blocks and finds that they are whole: what is read of them needs no memory but its own, and
    /// that is at most 128 times the bytes there are.
    pub(crate) fn parse(entry: &SectionEntry, bytes: &'a [u8]) -> Result<Section<'a>, Error> {
        if entry.filter != Filter::None || bytes.first().is_some_and(|flags| flags >> 6 != 0) {
            return Err(Error::unsupported(entry.place(), "packed bits with a filter or unknown flags", "neither"));
        }
        Section::parse_whole(entry.raw_size, bytes).ok_or_else(|| {
            Error::invalid(
                entry.place(),
                "damaged data, or too much for this machine",
                text!("packed bits of {} bytes", entry.raw_size),
            )
        })
    }

    fn parse_whole(raw_size: u64, bytes: &'a [u8]) -> Option<Section<'a>> {
        let &[flags, planes] = bytes.first_chunk()?;
        let layout = Layout { element_size: 1 + usize::from(flags >> 5), planes: planes.into() };
        let elements = layout.elements(raw_size)?;
        // Each block has a head at least. And what it becomes fits into memory, on 32 bits, too.
        if elements.div_ceil(BLOCK) > bytes.len() / layout.planes || raw_size > isize::MAX as u64 / 4 {
            return None;
        }
        let blocks = Blocks { bytes, at: HEAD_SIZE };
        let mut walk = blocks;
        for first in (0..elements).step_by(BLOCK) {
            for _ in 0..layout.planes {
                walk.skip(elements - first)?;
            }
        }
        let (shift, differences) = (u32::from(flags & 15), flags >> 4 & 1 == 1);
        let is_end = bytes[walk.at..] == [0; TAIL_SIZE];
        is_end.then_some(Section { blocks, layout, elements, shift, differences })
    }

    /// Its numbers are elements of two bytes in so many planes.
    pub(crate) fn is_plain(&self, planes: usize) -> bool {
        self.blocks.bytes.starts_with(&[1 << 5, planes as u8])
    }

    /// The section's bytes.
    pub(crate) fn to_bytes(self) -> Vec<u8> {
        let Layout { element_size, planes } = self.layout;
        let mut bytes = vec![0; self.elements * planes * element_size];
        let mut blocks = self.blocks;
        let mut before = [0; MAX_PLANES];
        let mut block = [0; BLOCK];
        for first in (0..self.elements).step_by(BLOCK) {
            let count = BLOCK.min(self.elements - first);
            for (plane, before) in before.iter_mut().enumerate().take(planes) {
                blocks.read(count, &mut block);
                if self.differences {
                    sum_up(&mut block, before);
                }
                let column = bytes.chunks_exact_mut(element_size).skip(plane * self.elements + first);
                for (element, bytes) in column.take(count).enumerate() {
                    let number = block[place_of(element)] << self.shift;
                    bytes.iter_mut().zip(number.to_le_bytes()).for_each(|(byte, part)| *byte = part);
                }
            }
        }
        bytes
    }
}

impl Blocks<'_> {
    /// The next block's head, once all of the block is there; of at most so many elements.
    #[cfg_attr(not(feature = "fast"), inline(never))]
    fn head(&self, elements: usize) -> Option<Head> {
        let word = usize::from(u16::from_le_bytes(*self.bytes.get(self.at..)?.first_chunk()?));
        let (width, high_width, outliers) = (word & 31, (word >> 5 & 15) + 1, word >> 9);
        let (lanes, outlier_bits) = (elements.min(BLOCK).div_ceil(ROWS), PLACE_BITS + high_width);
        let middle = self.at + 2 + 2 * width * lanes;
        let end = middle + (outliers * outlier_bits).div_ceil(8);
        let fits = width <= 16 && (outliers == 0 || width + high_width <= 16);
        (end + TAIL_SIZE <= self.bytes.len() && fits).then_some(Head {
            width,
            outliers,
            outlier_bits,
            lanes,
            middle,
            end,
        })
    }

    /// Goes to the next block; None if this one is not whole.
    pub(crate) fn skip(&mut self, elements: usize) -> Option<()> {
        self.at = self.head(elements)?.end;
        Some(())
    }

    /// The numbers of the next block, of at most so many elements. Blocks are whole: [`Section::parse`] has walked through them.
    #[cfg_attr(not(feature = "fast"), inline(never))]
    pub(crate) fn read(&mut self, elements: usize, block: &mut Block) {
        let Some(head) = self.head(elements) else { return };
        let Head { width, outliers, outlier_bits, lanes, middle, end } = head;
        let numbers = &self.bytes[self.at + 2..middle];
        let mask = ((1u32 << width) - 1) as u16;
        if cfg!(feature = "fast") && lanes == LANES {
            // A row more, which the last number may reach into.
            let mut words = [[0u16; LANES]; ROWS + 1];
            for (words, row) in words.iter_mut().zip(numbers.as_chunks::<{ 2 * LANES }>().0) {
                for (word, bytes) in words.iter_mut().zip(row.as_chunks().0) {
                    *word = u16::from_le_bytes(*bytes);
                }
            }
            for (row, numbers) in block.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
                let bit = row * width;
                let shift = bit as u32 % 16;
                let [low, high] = [words[bit / 16 % ROWS], words[bit / 16 % ROWS + 1]];
                for lane in 0..LANES {
                    // Twice, since a shift by 16 is none.
                    let high = high[lane].wrapping_shl(1).wrapping_shl(15 - shift);
                    numbers[lane] = (low[lane].wrapping_shr(shift) | high) & mask;
                }
            }
        } else {
            let words = numbers.as_chunks().0;
            let word = |place: usize| words.get(place).map_or(0, |&word| u32::from(u16::from_le_bytes(word)));
            for (place, number) in block.iter_mut().enumerate() {
                let (row, lane) = (place / LANES, place % LANES);
                let first = row * width / 16 * lanes + lane;
                let pair = word(first) | word(first + lanes) << 16;
                *number = if lane < lanes { (pair >> (row * width % 16)) as u16 & mask } else { 0 };
            }
        }
        for outlier in 0..outliers {
            let bit = outlier * outlier_bits;
            let Some(&bytes) = self.bytes[middle + bit / 8..].first_chunk() else { break };
            let found = u32::from_le_bytes(bytes) >> (bit % 8) & ((1 << outlier_bits) - 1);
            block[found as usize % BLOCK] |= ((found >> PLACE_BITS) << width) as u16;
        }
        self.at = end;
    }
}

/// From folded differences to numbers, each following the one before it, the first `before`; which becomes the last.
#[cfg_attr(not(feature = "fast"), inline(never))]
pub(crate) fn sum_up(block: &mut Block, before: &mut u16) {
    if !cfg!(feature = "fast") {
        for element in 0..BLOCK {
            let number = &mut block[place_of(element)];
            *before = before.wrapping_add(unfold(*number));
            *number = *before;
        }
        return;
    }
    let rows = block.as_chunks_mut::<LANES>().0;
    // Each lane from 0, then all by what the lanes before it came to.
    let mut sums = [0u16; LANES];
    for row in rows.iter_mut() {
        for (number, sum) in row.iter_mut().zip(&mut sums) {
            *sum = sum.wrapping_add(unfold(*number));
            *number = *sum;
        }
    }
    let starts = sums.map(|sum| {
        let start = *before;
        *before = start.wrapping_add(sum);
        start
    });
    for row in rows {
        for (number, start) in row.iter_mut().zip(starts) {
            *number = number.wrapping_add(start);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::{Codec, RADIANCE};
    use std::prelude::v1::*;

    fn entry(raw_size: usize, stored_size: usize) -> SectionEntry {
        SectionEntry {
            id: RADIANCE,
            codec: Codec::Bits,
            filter: Filter::None,
            offset: 0,
            stored_size: stored_size as u64,
            raw_size: raw_size as u64,
            crc32: 0,
        }
    }

    fn unpack(raw_size: usize, stored: &[u8]) -> Result<Vec<u8>, Error> {
        Ok(Section::parse(&entry(raw_size, stored.len()), stored)?.to_bytes())
    }

    /// Numbers of about so many bits, every so-manieth of any size.
    fn numbers(count: usize, width: u32, outliers: usize, state: &mut u64) -> Vec<u16> {
        let mut next = || {
            *state ^= *state << 13;
            *state ^= *state >> 7;
            *state ^= *state << 17;
            (*state >> 20) as u32
        };
        let mut number = || match next() {
            draw if (draw as usize).is_multiple_of(outliers) => next() as u16,
            _ => (next() & ((1 << width) - 1)) as u16,
        };
        (0..count).map(|_| number()).collect()
    }

    #[test]
    fn what_is_packed_unpacks_to_the_same_bytes() {
        let mut state = 1;
        for count in [0, 1, 2, 15, 16, 17, 127, 128, 129, 300] {
            for width in 0..=16 {
                for (outliers, planes) in [(0, 1), (2, 1), (9, 3), (40, 28), (1, 2)] {
                    let numbers = numbers(count * planes, width, outliers, &mut state);
                    let wide: Vec<u8> = numbers.iter().flat_map(|n| (n << 3).to_le_bytes()).collect();
                    let narrow: Vec<u8> = numbers.iter().map(|&n| n as u8).collect();
                    for (bytes, element_size) in [(wide, 2), (narrow, 1)] {
                        let packed = pack_bits(&bytes, Layout { element_size, planes });
                        let what = std::format!("{count} of {width} bits, outliers {outliers}, {planes} planes");
                        assert!(unpack(bytes.len(), &packed).as_ref() == Ok(&bytes), "{what}");
                        // Two bytes a block and lanes that are not full are all that it can cost.
                        let blocks = planes * count.div_ceil(BLOCK);
                        assert!(
                            packed.len() <= 5 + planes * count.next_multiple_of(ROWS) * element_size + 2 * blocks,
                            "{what}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn even_sections_take_next_to_nothing() {
        for value in [0u16, 1, 0x3c00, u16::MAX] {
            let bytes: Vec<u8> = (0..1280).flat_map(|_| value.to_le_bytes()).collect();
            let packed = pack_bits(&bytes, Layout { element_size: 2, planes: 1 });
            assert!(packed.len() <= 5 + 10 * 2 + 3, "{value}: {} bytes", packed.len());
            assert_eq!(unpack(bytes.len(), &packed).unwrap(), bytes);
        }
    }

    #[test]
    fn cut_off_and_wrong_sizes_are_errors() {
        let bytes: Vec<u8> = numbers(3 * 300, 7, 20, &mut 5).iter().flat_map(|n| n.to_le_bytes()).collect();
        let packed = pack_bits(&bytes, Layout { element_size: 2, planes: 3 });
        for length in 0..packed.len() {
            assert!(unpack(bytes.len(), &packed[..length]).is_err(), "{length}");
        }
        for size in [0, 2, 6, bytes.len() - 96, bytes.len() + 96, bytes.len() + 1, usize::MAX / 8, usize::MAX] {
            assert!(unpack(size, &packed).is_err(), "{size}");
        }
        assert!(unpack(bytes.len(), &[&packed[..], &[0]].concat()).is_err());
    }
}
