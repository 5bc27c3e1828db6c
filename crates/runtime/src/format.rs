//! The bytes of a `.gdibl` file, version 1: header, section table, where sections lie. `FORMAT.md` tells the same in
//! prose, section by section.
//!
//! ```text
//! 0    header, 96 bytes: magic, version, kind, counts, bands, encoding, scale, units, section count, box
//! 96   section table, 40 bytes each
//!      crc32 of everything so far, 4 bytes
//!      sections in table order, each from the next multiple of 8; zeros between; nothing after the last
//! ```
//! All numbers are little-endian. A writer fills [`SectionEntry`]s, lets [`place_sections`] set their offsets, writes
//! [`directory_to_bytes`], then each section at its offset. A reader that wants to look at a file without building a
//! [`Volume`](crate::Volume) takes [`parse_header_and_sections`].

mod directory;

pub use crate::crc32::crc32;
pub use crate::shuffle::{byte_shuffle, byte_unshuffle};
pub use directory::{Directory, parse_header_and_sections};

use crate::error::text;
use crate::sh::{MAX_BANDS, coefficient_count};
use crate::{Error, Grid};
use alloc::string::String;
use alloc::vec::Vec;

/// The least and the largest step of packed numbers: with less they would not fit 16 bits, with more nothing would be left of the light.
pub const PACKED_STEPS: core::ops::RangeInclusive<f32> = 1.220_703_1e-4..=1.0;

/// The first eight bytes of every file: no text, no transfer that changes line ends, leaves them whole.
pub const MAGIC: [u8; 8] = *b"\x89GDIBL\n\x1a";
/// The version written and read.
pub const VERSION: u32 = 1;
/// Bytes of the header.
pub const HEADER_SIZE: usize = 96;
/// Bytes of one entry of the section table.
pub const ENTRY_SIZE: usize = 40;
/// The most sections a file may have.
pub const MAX_SECTIONS: usize = 64;
/// Sections begin at multiples of this.
pub const ALIGNMENT: u64 = 8;

/// Radiance coefficients in planes, f16 or f32: element (coefficient * 3 + channel) * node_count + node. Packed: see
/// [`crate::packed`].
pub const RADIANCE: [u8; 4] = *b"RSH ";
/// Validity, u8 per node: 1 baked, 0 filled from neighbours. Absent: all baked.
pub const VALIDITY: [u8; 4] = *b"VALD";
/// Coverage, f16 per node, 0..=1. Absent: everything was covered.
pub const COVERAGE: [u8; 4] = *b"COVR";
/// Relative standard error, f16 per node. Absent: not measured.
pub const STANDARD_ERROR: [u8; 4] = *b"SERR";
/// Relative systematic error, f16 per node; for tools, the runtime does not read it. Absent: nothing tells.
pub const SYSTEMATIC_ERROR: [u8; 4] = *b"BIAS";
/// As [`STANDARD_ERROR`] in the worst direction and channel, f16 per node.
pub const WORST_ERROR: [u8; 4] = *b"WERR";
/// Standard errors of coefficients, in the numbers and the order of [`RADIANCE`].
pub const COEFFICIENT_ERRORS: [u8; 4] = *b"CERR";
/// Positions, three f32 per node, relative to the header's min. Points and vertices only.
pub const POSITIONS: [u8; 4] = *b"POSN";
/// Unit normals, three f32 per node. Vertices only.
pub const NORMALS: [u8; 4] = *b"NORM";
/// Which vertices belong to which mesh: records of five u32. Vertices only; may be absent.
pub const MESHES: [u8; 4] = *b"MESH";
/// Walls between nodes, see [`crate::walls`]. Grids, sparse or not; may be absent.
pub const WALLS: [u8; 4] = *b"WALL";
/// Which places of a fine grid are nodes, see [`crate::bricks`]. Sparse grids only.
pub const BRICKS: [u8; 4] = *b"BRIK";
/// A record: the settings of the bake. The runtime skips it.
pub const SETTINGS: [u8; 4] = *b"SETT";
/// A record: the stages kept and left out. The runtime skips it.
pub const PLAN: [u8; 4] = *b"PLAN";
/// A record: the probes. The runtime skips it.
pub const PROBES: [u8; 4] = *b"PROB";
/// A record: statistics of the bake. The runtime skips it.
pub const STATISTICS: [u8; 4] = *b"STAT";

/// What the nodes are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Kind {
    /// A regular grid.
    Grid = 0,
    /// Listed points.
    Points = 1,
    /// Mesh vertices, with normals.
    Vertices = 2,
    /// Some places of a fine grid, fewer where light is even: see [`crate::bricks`].
    Sparse = 3,
}

/// How a coefficient is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Encoding {
    /// 32-bit float, the value itself.
    F32 = 0,
    /// 16-bit float, times the header's scale.
    F16 = 1,
    /// In few bytes, the header's scale being the step: see [`crate::packed`].
    Packed = 2,
}

/// What the coefficients are of. Both kinds evaluate alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Units {
    /// Radiance, linear Rec.709, as projected.
    Radiance = 0,
    /// The same, de-ringed: where a node's irradiance would turn negative for some normal, bands 1 and up are scaled
    /// down, all alike, until it does not. See `FORMAT.md`.
    RadianceDeringed = 1,
}

/// How a section is compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum Codec {
    /// Not at all.
    Raw = 0,
    /// One zstd frame.
    Zstd = 1,
    /// Whole numbers in as many bits as they need: see [`crate::bits`].
    Bits = 2,
}

/// What was done to a section before compression.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum Filter {
    /// Nothing.
    None = 0,
    /// [`byte_shuffle`] with [`Header::element_size`].
    ByteShuffle = 1,
}

/// What a reader is ready to hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// The most bytes that all sections together may have once decompressed. Reading takes up to three times that.
    pub max_bytes: u64,
}

impl Default for Limits {
    /// 4 GiB.
    fn default() -> Limits {
        Limits { max_bytes: 4 << 30 }
    }
}

/// The fixed part of a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Header {
    /// What the nodes are.
    pub kind: Kind,
    /// Grid: nodes per axis. Otherwise: how many, 1, 1.
    pub counts: [u32; 3],
    /// The highest SH band, 0..=4.
    pub bands: u32,
    /// How coefficients are stored.
    pub encoding: Encoding,
    /// value = stored * scale: a power of two from 2^-100 to 2^100; 1 for [`Encoding::F32`]. For [`Encoding::Packed`] the step,
    /// one of [`PACKED_STEPS`].
    pub scale: f32,
    /// What the coefficients are of.
    pub units: Units,
    /// The box's lowest corner, metres.
    pub min: [f64; 3],
    /// The box's highest corner, metres.
    pub max: [f64; 3],
}

impl Header {
    /// How many nodes the volume has. At most 2³² - 1 in any header that [`Header::parse`] returned.
    pub fn node_count(&self) -> usize {
        self.grid().node_count()
    }

    /// Box and counts as a grid. Of [`Kind::Sparse`] see [`Volume::grid`](crate::Volume::grid).
    pub fn grid(&self) -> Grid {
        Grid { min: self.min, max: self.max, counts: self.counts }
    }

    /// Nodes that would ring have been windowed: irradiance is nowhere negative. The coefficients are then not those of
    /// the raw projection.
    pub fn is_deringed(&self) -> bool {
        self.units == Units::RadianceDeringed
    }

    /// Floats per node: three per coefficient.
    pub fn values_per_node(&self) -> usize {
        3 * coefficient_count(self.bands)
    }

    /// Bytes of one element of a known section of numbers, which is what a byte shuffle shuffles: `RSH ` and `CERR`
    /// 2 or 4 by encoding (packed: 2 and 4); `COVR`, `SERR`, `WERR` 2; `POSN`, `NORM`, `MESH` 4. None for other sections: they are never shuffled.
    pub fn element_size(&self, id: [u8; 4]) -> Option<usize> {
        let of_encoding = match self.encoding {
            Encoding::F32 => [4, 4],
            Encoding::F16 => [2, 2],
            Encoding::Packed => [2, 4],
        };
        let sizes = [
            (RADIANCE, of_encoding[0]),
            (COEFFICIENT_ERRORS, of_encoding[1]),
            (COVERAGE, 2),
            (STANDARD_ERROR, 2),
            (WORST_ERROR, 2),
            (POSITIONS, 4),
            (NORMALS, 4),
            (MESHES, 4),
        ];
        sizes.iter().find(|(known, _)| *known == id).map(|(_, size)| *size)
    }

    /// Bytes that a known section must have once decompressed; None where the header does not tell.
    pub fn raw_size(&self, id: [u8; 4]) -> Option<u64> {
        let nodes = self.node_count() as u64;
        let bytes_per_node = match id {
            RADIANCE if self.encoding == Encoding::Packed => 2 * (self.values_per_node() as u64 + 1),
            RADIANCE | COEFFICIENT_ERRORS => self.values_per_node() as u64 * self.element_size(id)? as u64,
            VALIDITY => 1,
            COVERAGE | STANDARD_ERROR | WORST_ERROR => 2,
            POSITIONS | NORMALS => 12,
            _ => return None,
        };
        Some(nodes.saturating_mul(bytes_per_node))
    }

    /// The header's bytes, for a file of `section_count` sections.
    pub fn to_bytes(&self, section_count: u32) -> [u8; HEADER_SIZE] {
        let mut bytes = [0; HEADER_SIZE];
        bytes[..8].copy_from_slice(&MAGIC);
        let words = [
            VERSION,
            self.kind as u32,
            self.counts[0],
            self.counts[1],
            self.counts[2],
            self.bands,
            self.encoding as u32,
            self.scale.to_bits(),
            self.units as u32,
            section_count,
        ];
        for (place, word) in bytes[8..48].chunks_exact_mut(4).zip(words) {
            place.copy_from_slice(&word.to_le_bytes());
        }
        let corners = self.min.iter().chain(&self.max);
        for (place, value) in bytes[48..].chunks_exact_mut(8).zip(corners) {
            place.copy_from_slice(&value.to_le_bytes());
        }
        bytes
    }

    /// The header in the first [`HEADER_SIZE`] bytes, and the count of sections. Checks every field but no checksum.
    pub fn parse(bytes: &[u8]) -> Result<(Header, u32), Error> {
        parse_magic_and_version(bytes)?;
        if bytes.len() < HEADER_SIZE {
            return Err(truncated(bytes, HEADER_SIZE as u64));
        }
        let word = |at| read_u32(bytes, at);
        let kind = match word(12) {
            0 => Kind::Grid,
            1 => Kind::Points,
            2 => Kind::Vertices,
            3 => Kind::Sparse,
            other => return Err(unknown("header, byte 12: kind", other, "0 to 3")),
        };
        let encoding = match word(32) {
            0 => Encoding::F32,
            1 => Encoding::F16,
            2 => Encoding::Packed,
            other => return Err(unknown("header, byte 32: encoding", other, "0, 1 or 2")),
        };
        if word(28) > MAX_BANDS {
            return Err(unknown("header, byte 28: SH bands", word(28), "0 to 4"));
        }
        let units = match word(40) {
            0 => Units::Radiance,
            1 => Units::RadianceDeringed,
            other => return Err(unknown("header, byte 40: units", other, "0 or 1")),
        };
        let section_count = word(44);
        if section_count as usize > MAX_SECTIONS {
            return Err(Error::invalid(
                "header, byte 44: section count",
                text!("{section_count}"),
                text!("at most {MAX_SECTIONS}"),
            ));
        }
        let float = |at: usize| f64::from_bits(read_u64(bytes, at));
        let header = Header {
            kind,
            counts: [word(16), word(20), word(24)],
            bands: word(28),
            encoding,
            scale: f32::from_bits(word(36)),
            units,
            min: [float(48), float(56), float(64)],
            max: [float(72), float(80), float(88)],
        };
        header.check_counts()?;
        header.check_scale()?;
        header.check_box()?;
        Ok((header, section_count))
    }

    fn check_counts(&self) -> Result<(), Error> {
        let place = "header, byte 16: counts";
        let found = || text!("{:?}", self.counts);
        if self.counts.contains(&0) {
            return Err(Error::invalid(place, found(), "at least one node"));
        }
        if self.kind != Kind::Grid && self.counts[1..] != [1, 1] {
            return Err(Error::invalid(place, found(), "[n, 1, 1] unless this is a grid"));
        }
        let product = self.counts.iter().try_fold(1, |product: u32, &count| product.checked_mul(count));
        if product.is_none() {
            return Err(Error::unsupported(place, found(), "at most 4294967295 nodes"));
        }
        Ok(())
    }

    fn check_scale(&self) -> Result<(), Error> {
        let bits = self.scale.to_bits();
        let power_of_two = bits & 0x807f_ffff == 0 && (27..=227).contains(&(bits >> 23));
        let expected = match self.encoding {
            Encoding::F32 if self.scale != 1.0 => "1 for 32-bit floats",
            Encoding::F16 if !power_of_two => "a power of two from 2^-100 to 2^100",
            Encoding::Packed if !PACKED_STEPS.contains(&self.scale) => "a step from 2^-13 to 1",
            _ => return Ok(()),
        };
        Err(Error::invalid("header, byte 36: scale", text!("{:e}", self.scale), expected))
    }

    fn check_box(&self) -> Result<(), Error> {
        for axis in 0..3 {
            let (min, max) = (self.min[axis], self.max[axis]);
            // An infinite or undefined corner, and a box too large for a float, have no finite extent.
            if !((max - min).is_finite() && min <= max) {
                return Err(Error::invalid(
                    text!("header, bytes 48 and 72: box, axis {axis}"),
                    text!("{min:e} to {max:e}"),
                    "finite numbers, min <= max",
                ));
            }
        }
        Ok(())
    }
}

/// One row of the section table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SectionEntry {
    /// Four ASCII characters.
    pub id: [u8; 4],
    /// How it is compressed.
    pub codec: Codec,
    /// What was done before compression.
    pub filter: Filter,
    /// Where it begins in the file: [`place_sections`] sets it.
    pub offset: u64,
    /// Bytes in the file.
    pub stored_size: u64,
    /// Bytes once decompressed.
    pub raw_size: u64,
    /// [`crc32`] of the stored bytes.
    pub crc32: u32,
}

impl SectionEntry {
    /// The entry's bytes.
    pub fn to_bytes(&self) -> [u8; ENTRY_SIZE] {
        let mut bytes = [0; ENTRY_SIZE];
        bytes[..4].copy_from_slice(&self.id);
        bytes[4..6].copy_from_slice(&(self.codec as u16).to_le_bytes());
        bytes[6..8].copy_from_slice(&(self.filter as u16).to_le_bytes());
        bytes[8..16].copy_from_slice(&self.offset.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.stored_size.to_le_bytes());
        bytes[24..32].copy_from_slice(&self.raw_size.to_le_bytes());
        bytes[32..36].copy_from_slice(&self.crc32.to_le_bytes());
        bytes
    }

    /// The entry in the first [`ENTRY_SIZE`] bytes. Checks codec, filter and the reserved word; sizes and offset are
    /// for whoever knows the file around it.
    ///
    /// # Panics
    /// If there are fewer bytes.
    pub fn parse(bytes: &[u8]) -> Result<SectionEntry, Error> {
        assert!(bytes.len() >= ENTRY_SIZE, "{} bytes of {ENTRY_SIZE}", bytes.len());
        let id = [bytes[0], bytes[1], bytes[2], bytes[3]];
        let place = section_place(id);
        let half = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let codec = match half(4) {
            0 => Codec::Raw,
            1 => Codec::Zstd,
            2 => Codec::Bits,
            other => {
                return Err(Error::unsupported(place, text!("codec {other}"), "0 to 2"));
            }
        };
        let filter = match half(6) {
            0 => Filter::None,
            1 => Filter::ByteShuffle,
            other => {
                return Err(Error::unsupported(place, text!("filter {other}"), "0 or 1"));
            }
        };
        if read_u32(bytes, 36) != 0 {
            let found = text!("reserved word {}", read_u32(bytes, 36));
            return Err(Error::invalid(place, found, "0"));
        }
        Ok(SectionEntry {
            id,
            codec,
            filter,
            offset: read_u64(bytes, 8),
            stored_size: read_u64(bytes, 16),
            raw_size: read_u64(bytes, 24),
            crc32: read_u32(bytes, 32),
        })
    }

    pub(crate) fn place(&self) -> String {
        section_place(self.id)
    }

    fn check_sizes(&self, header: &Header) -> Result<(), Error> {
        if self.codec == Codec::Raw && self.raw_size != self.stored_size {
            return Err(Error::invalid(
                self.place(),
                text!("{} bytes stored for {}", self.stored_size, self.raw_size),
                "as many, since the section is not compressed",
            ));
        }
        match header.raw_size(self.id) {
            Some(expected) if expected != self.raw_size => Err(Error::invalid(
                self.place(),
                text!("{} bytes", self.raw_size),
                text!("{expected} bytes for {} nodes", header.node_count()),
            )),
            _ => Ok(()),
        }
    }
}

/// Sets the offset of every section from the sizes of those before it, as the format demands. The file ends where the
/// last section ends.
pub fn place_sections(sections: &mut [SectionEntry]) {
    let mut end = directory_size(sections.len()) as u64;
    for section in sections {
        section.offset = end.next_multiple_of(ALIGNMENT);
        end = section.offset + section.stored_size;
    }
}

/// Everything before the first section: header, section table, checksum.
///
/// # Panics
/// If there are more than [`MAX_SECTIONS`].
pub fn directory_to_bytes(header: &Header, sections: &[SectionEntry]) -> Vec<u8> {
    assert!(sections.len() <= MAX_SECTIONS, "{} sections of at most {MAX_SECTIONS}", sections.len());
    let mut bytes = header.to_bytes(sections.len() as u32).to_vec();
    for section in sections {
        bytes.extend_from_slice(&section.to_bytes());
    }
    bytes.extend_from_slice(&crc32(&bytes).to_le_bytes());
    bytes
}

fn parse_magic_and_version(bytes: &[u8]) -> Result<(), Error> {
    if !bytes.starts_with(&MAGIC) {
        let found = &bytes[..bytes.len().min(MAGIC.len())];
        return Err(Error::invalid("first bytes", text!("{found:02x?}"), text!("{MAGIC:02x?}: a .gdibl file")));
    }
    if bytes.len() < 12 {
        return Err(truncated(bytes, HEADER_SIZE as u64));
    }
    match read_u32(bytes, 8) {
        VERSION => Ok(()),
        other => Err(unknown("header, byte 8: version", other, "1")),
    }
}

/// Bytes of header, table and checksum.
fn directory_size(section_count: usize) -> usize {
    HEADER_SIZE + section_count * ENTRY_SIZE + 4
}

pub(crate) fn section_place(id: [u8; 4]) -> String {
    let mut place = String::from("section ");
    place.extend(id.map(core::ascii::escape_default).into_iter().flatten().map(char::from));
    place
}

fn truncated(bytes: &[u8], expected: u64) -> Error {
    Error::invalid("end of file", text!("{} bytes", bytes.len()), text!("at least {expected}: the file is cut off"))
}

fn unknown(place: &str, found: u32, expected: &str) -> Error {
    Error::unsupported(place, text!("{found}"), expected)
}

fn read_u32(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(core::array::from_fn(|k| bytes[at + k]))
}

fn read_u64(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(core::array::from_fn(|k| bytes[at + k]))
}
