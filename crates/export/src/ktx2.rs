//! A 3-D texture as a KTX2 file: one level, not compressed.
//!
//! ```text
//! 0     identifier (12), nine u32 of the header, four u32 and two u64 of the index
//! 80    level index: offset, bytes, bytes once decompressed, u64 each
//! 104   data format descriptor
//!       key and value: KTXwriter
//!       level 0, from the next multiple of a texel
//! ```
//! Based on: Khronos, "KTX File Format Specification" 2.0, sections 3 and 4; "Khronos Data Format Specification" 1.3,
//! chapter 5 and the example descriptors of its section 5.18 (shared exponent, half floats).

/// How a texel is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// `VK_FORMAT_E5B9G9R9_UFLOAT_PACK32`.
    Rgb9e5,
    /// `VK_FORMAT_R16G16B16A16_SFLOAT`.
    Rgba16f,
}

impl Format {
    fn vulkan(self) -> u32 {
        match self {
            Format::Rgb9e5 => 123,
            Format::Rgba16f => 97,
        }
    }

    /// Bytes of a unit whose bytes swap together.
    fn type_size(self) -> u32 {
        match self {
            Format::Rgb9e5 => 4,
            Format::Rgba16f => 2,
        }
    }

    fn texel_bytes(self) -> usize {
        match self {
            Format::Rgb9e5 => 4,
            Format::Rgba16f => 8,
        }
    }

    /// (bit offset, bits, channel and qualifiers, lower, upper) of each sample of the descriptor.
    fn samples(self) -> Vec<[u32; 5]> {
        const EXPONENT: u32 = 0x20;
        const SIGNED: u32 = 0x40;
        const FLOAT: u32 = 0x80;
        const ALPHA: u32 = 15;
        match self {
            Format::Rgb9e5 => (0..3)
                .flat_map(|channel| [[9 * channel, 9, channel, 0, 8448], [27, 5, channel | EXPONENT, 15, 31]])
                .collect(),
            Format::Rgba16f => [0, 1, 2, ALPHA]
                .iter()
                .zip(0..)
                .map(|(&channel, place)| {
                    [16 * place, 16, channel | SIGNED | FLOAT, (-1.0_f32).to_bits(), 1.0_f32.to_bits()]
                })
                .collect(),
        }
    }
}

/// The file.
///
/// # Panics
/// If there are not as many bytes as texels need.
pub(crate) fn write(format: Format, size: [u32; 3], texels: &[u8]) -> Vec<u8> {
    let bytes: usize = size.iter().map(|&n| n as usize).product::<usize>() * format.texel_bytes();
    assert_eq!(texels.len(), bytes, "bytes of texels");
    let descriptor = descriptor(format);
    let pair = key_and_value("KTXwriter", concat!("gdibl ", env!("CARGO_PKG_VERSION")));
    let descriptor_at = 104;
    let pair_at = descriptor_at + descriptor.len();
    let level_at = (pair_at + pair.len()).next_multiple_of(format.texel_bytes());
    let mut file = b"\xabKTX 20\xbb\r\n\x1a\n".to_vec();
    let mut words = |words: &[usize]| words.iter().for_each(|&w| file.extend_from_slice(&(w as u32).to_le_bytes()));
    let [width, height, depth] = size.map(|n| n as usize);
    // Format, type size, size, layers, faces, levels, supercompression.
    words(&[format.vulkan() as usize, format.type_size() as usize, width, height, depth, 0, 1, 1, 0]);
    words(&[descriptor_at, descriptor.len(), pair_at, pair.len()]);
    // No supercompression data; then the one level.
    for word in [0, 0, level_at, texels.len(), texels.len()] {
        file.extend_from_slice(&(word as u64).to_le_bytes());
    }
    file.extend_from_slice(&descriptor);
    file.extend_from_slice(&pair);
    file.resize(level_at, 0);
    file.extend_from_slice(texels);
    file
}

/// The basic data format descriptor, with its total size before it.
fn descriptor(format: Format) -> Vec<u8> {
    const RGBSDA: u8 = 1;
    const BT709: u8 = 1;
    const LINEAR: u8 = 1;
    const VERSION_1_3: u32 = 2;
    let samples = format.samples();
    let block = 24 + 16 * samples.len() as u32;
    let mut bytes = Vec::new();
    for word in [block + 4, 0, VERSION_1_3 | block << 16] {
        bytes.extend_from_slice(&word.to_le_bytes());
    }
    bytes.extend_from_slice(&[RGBSDA, BT709, LINEAR, 0]);
    bytes.extend_from_slice(&[0; 4]); // a texel block is one texel
    bytes.extend_from_slice(&[format.texel_bytes() as u8, 0, 0, 0, 0, 0, 0, 0]);
    for [offset, bits, channel, lower, upper] in samples {
        for word in [offset | (bits - 1) << 16 | channel << 24, 0, lower, upper] {
            bytes.extend_from_slice(&word.to_le_bytes());
        }
    }
    bytes
}

/// One entry of the key and value data, padded to four bytes.
fn key_and_value(key: &str, value: &str) -> Vec<u8> {
    let mut bytes = ((key.len() + value.len() + 2) as u32).to_le_bytes().to_vec();
    for text in [key, value] {
        bytes.extend_from_slice(text.as_bytes());
        bytes.push(0);
    }
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    bytes
}
