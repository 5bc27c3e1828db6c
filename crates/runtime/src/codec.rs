//! From the bytes stored in a section to the bytes meant: decompress, then undo the byte shuffle.
//!
//! Nothing is allocated on a length's word: output grows as data arrives, and stops at the size the table announces; packed bits are
//! walked through first.

use crate::Error;
use crate::bits::Section;
use crate::error::text;
use crate::format::{Codec, Filter, Header, SectionEntry};
use crate::shuffle::byte_unshuffle;
use alloc::borrow::Cow;

/// The bytes of a section, whose checksum has been compared.
pub(crate) fn decode<'a>(header: &Header, entry: &SectionEntry, stored: &'a [u8]) -> Result<Cow<'a, [u8]>, Error> {
    let bytes = match entry.codec {
        Codec::Raw => Cow::Borrowed(stored),
        Codec::Zstd => Cow::Owned(decompress(entry, stored)?),
        Codec::Bits => Cow::Owned(Section::parse(entry, stored)?.to_bytes()),
    };
    match entry.filter {
        Filter::None => Ok(bytes),
        Filter::ByteShuffle => {
            let Some(element_size) = header.element_size(entry.id) else {
                return Err(Error::unsupported(
                    entry.place(),
                    "a byte shuffle of elements of unknown size",
                    "no filter",
                ));
            };
            if !bytes.len().is_multiple_of(element_size) {
                return Err(Error::invalid(
                    entry.place(),
                    text!("{} bytes", bytes.len()),
                    text!("whole elements of {element_size} bytes"),
                ));
            }
            Ok(Cow::Owned(byte_unshuffle(&bytes, element_size)))
        }
    }
}

#[cfg(not(feature = "zstd"))]
fn decompress(entry: &SectionEntry, _: &[u8]) -> Result<alloc::vec::Vec<u8>, Error> {
    Err(Error::unsupported(
        entry.place(),
        "codec 1 (zstd)",
        "codec 0: this program was built without the feature `zstd` of gdibl-runtime",
    ))
}

/// One zstd frame which fills `stored` and gives exactly `raw_size` bytes.
#[cfg(feature = "zstd")]
fn decompress(entry: &SectionEntry, mut stored: &[u8]) -> Result<alloc::vec::Vec<u8>, Error> {
    use alloc::vec::Vec;
    use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder};
    use ruzstd::io::Read;

    /// The window that every zstd decoder is asked to support (RFC 8878, 3.1.1.1.2), bytes.
    const USUAL_WINDOW: u64 = 8 << 20;
    let raw_size = entry.raw_size;
    let damaged = |reason: &dyn core::fmt::Display| {
        Error::invalid(entry.place(), text!("damaged data ({reason})"), "one whole zstd frame")
    };
    let wrong_size = |found: &str| Error::invalid(entry.place(), found, text!("{raw_size} bytes once decompressed"));

    let mut decoder = FrameDecoder::new();
    // The decoder holds back one window of output, so the window is capped as the output is.
    decoder.set_max_window_size(raw_size.max(USUAL_WINDOW));
    decoder.init(&mut stored).map_err(|e| damaged(&e))?;
    let mut output = Vec::new();
    let mut piece = [0; 16 << 10];
    while !decoder.is_finished() {
        decoder.decode_blocks(&mut stored, BlockDecodingStrategy::UptoBlocks(1)).map_err(|e| damaged(&e))?;
        loop {
            let length = decoder.read(&mut piece).map_err(|e| damaged(&e))?;
            if length == 0 {
                break;
            }
            if (output.len() + length) as u64 > raw_size {
                return Err(wrong_size(&text!("more than {raw_size} bytes")));
            }
            output.extend_from_slice(&piece[..length]);
        }
    }
    if !stored.is_empty() {
        return Err(damaged(&text!("{} bytes after the frame", stored.len())));
    }
    if output.len() as u64 != raw_size {
        return Err(wrong_size(&text!("{} bytes", output.len())));
    }
    Ok(output)
}
