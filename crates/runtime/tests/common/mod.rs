//! Small volumes for the tests, written byte by byte after FORMAT.md and not with the crate's own writer.

#![allow(dead_code, reason = "each test file uses its part")]

use gdibl_runtime::format::crc32;

/// A section as it goes into a file.
#[derive(Clone)]
pub struct Section {
    pub id: [u8; 4],
    pub codec: u16,
    pub filter: u16,
    pub raw_size: u64,
    pub stored: Vec<u8>,
}

pub fn raw(id: &[u8; 4], bytes: Vec<u8>) -> Section {
    Section { id: *id, codec: 0, filter: 0, raw_size: bytes.len() as u64, stored: bytes }
}

/// The header's fields, as numbers.
#[derive(Clone)]
pub struct File {
    pub version: u32,
    pub kind: u32,
    pub counts: [u32; 3],
    pub bands: u32,
    pub encoding: u32,
    pub scale: f32,
    pub units: u32,
    pub min: [f64; 3],
    pub max: [f64; 3],
    pub sections: Vec<Section>,
}

impl File {
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = vec![0x89, 0x47, 0x44, 0x49, 0x42, 0x4c, 0x0a, 0x1a];
        let [x, y, z] = self.counts;
        for word in [self.version, self.kind, x, y, z, self.bands, self.encoding] {
            bytes.extend(word.to_le_bytes());
        }
        bytes.extend(self.scale.to_le_bytes());
        bytes.extend(self.units.to_le_bytes());
        bytes.extend((self.sections.len() as u32).to_le_bytes());
        for value in self.min.iter().chain(&self.max) {
            bytes.extend(value.to_le_bytes());
        }
        assert_eq!(bytes.len(), 96);
        let mut end = 96 + 40 * self.sections.len() + 4;
        for section in &self.sections {
            let offset = end.div_ceil(8) * 8;
            end = offset + section.stored.len();
            bytes.extend(section.id);
            bytes.extend(section.codec.to_le_bytes());
            bytes.extend(section.filter.to_le_bytes());
            bytes.extend((offset as u64).to_le_bytes());
            bytes.extend((section.stored.len() as u64).to_le_bytes());
            bytes.extend(section.raw_size.to_le_bytes());
            bytes.extend(crc32(&section.stored).to_le_bytes());
            bytes.extend(0u32.to_le_bytes());
        }
        bytes.extend(crc32(&bytes).to_le_bytes());
        for section in &self.sections {
            bytes.resize(bytes.len().div_ceil(8) * 8, 0);
            bytes.extend(&section.stored);
        }
        bytes
    }

    pub fn nodes(&self) -> usize {
        self.counts.iter().map(|&n| n as usize).product()
    }

    pub fn planes(&self) -> usize {
        3 * (self.bands as usize + 1).pow(2)
    }

    /// Adds the radiance section: `value(node, coefficient, channel)` as it shall come out.
    pub fn radiance(mut self, value: impl Fn(usize, usize, usize) -> f32) -> File {
        let mut bytes = Vec::new();
        for plane in 0..self.planes() {
            for node in 0..self.nodes() {
                let stored = value(node, plane / 3, plane % 3) / self.scale;
                match self.encoding {
                    0 => bytes.extend(stored.to_le_bytes()),
                    _ => bytes.extend(half::f16::from_f32(stored).to_le_bytes()),
                }
            }
        }
        self.sections.push(raw(b"RSH ", bytes));
        self
    }

    /// Adds the radiance section of a packed file: `number(node, plane)`, plane 0 being that of the codes of M.
    pub fn packed(self, number: impl Fn(usize, usize) -> i16) -> File {
        let mut bytes = Vec::new();
        for plane in 0..=self.planes() {
            let mut before = 0i16;
            for node in 0..self.nodes() {
                let difference = i32::from(number(node, plane).wrapping_sub(before));
                let folded = if difference < 0 { -2 * difference - 1 } else { 2 * difference };
                bytes.extend((folded as u16).to_le_bytes());
                before = number(node, plane);
            }
        }
        self.section(raw(b"RSH ", bytes))
    }

    pub fn section(mut self, section: Section) -> File {
        self.sections.push(section);
        self
    }

    pub fn validity(self, valid: impl Fn(usize) -> bool) -> File {
        let bytes = (0..self.nodes()).map(|node| u8::from(valid(node))).collect();
        self.section(raw(b"VALD", bytes))
    }

    /// Packs every section's bits: numbers of two bytes as such, all else byte by byte.
    pub fn bits(mut self) -> File {
        let planes = self.planes() + 1;
        for section in &mut self.sections {
            let (size, planes) = match (&section.id, self.encoding) {
                (b"RSH ", 2) => (2, planes),
                (b"RSH ", 1) | (b"COVR" | b"SERR", _) => (2, 1),
                _ => (1, 1),
            };
            section.stored = bits(&section.stored, size, planes, &section.id != b"RSH ");
            section.codec = 2;
        }
        self
    }

    /// Compresses every section with the reference zstd, sections of floats shuffled.
    pub fn zstd(mut self) -> File {
        for section in &mut self.sections {
            let element_size = match (&section.id, self.encoding) {
                (b"RSH ", 1 | 2) | (b"COVR" | b"SERR", _) => 2,
                (b"RSH ", _) | (b"POSN" | b"NORM" | b"MESH", _) => 4,
                _ => 1,
            };
            let mut bytes = section.stored.clone();
            if element_size > 1 {
                bytes = gdibl_runtime::format::byte_shuffle(&bytes, element_size).collect();
                section.filter = 1;
            }
            section.stored = zstd::encode_all(&bytes[..], 19).unwrap();
            section.codec = 1;
        }
        self
    }
}

/// Numbers of so many bits each, the lowest first, to whole bytes.
fn bit_string(numbers: &[(u32, usize)]) -> Vec<u8> {
    let bits: Vec<u32> = numbers.iter().flat_map(|&(n, width)| (0..width).map(move |bit| n >> bit & 1)).collect();
    bits.chunks(8).map(|bits| bits.iter().enumerate().map(|(k, bit)| (bit << k) as u8).sum()).collect()
}

/// A section as packed bits, two bits narrower than all its numbers need: so there are outliers.
pub fn bits(bytes: &[u8], size: usize, planes: usize, differences: bool) -> Vec<u8> {
    let elements: Vec<u32> =
        bytes.chunks(size).map(|b| b.iter().rev().fold(0, |n, &byte| n << 8 | u32::from(byte))).collect();
    let count = elements.len() / planes;
    let mut result = vec![u8::from(differences) << 4 | (size as u8 - 1) << 5, planes as u8];
    for first in (0..count).step_by(128) {
        for plane in 0..planes {
            let at = |i: usize| elements[plane * count + i];
            let number = |i: usize| match (differences, i) {
                (false, _) => at(i),
                _ => {
                    let before = if i == 0 { 0 } else { at(i - 1) };
                    let difference = i32::from(at(i).wrapping_sub(before) as i16);
                    if difference < 0 { (-1 - 2 * difference) as u32 } else { 2 * difference as u32 }
                }
            };
            let numbers: Vec<u32> = (first..count.min(first + 128)).map(number).collect();
            let most = numbers.iter().map(|n| 32 - n.leading_zeros()).max().unwrap() as usize;
            let width = most.saturating_sub(2);
            let places = (0..numbers.len()).filter(|&i| numbers[i] >> width > 0).take(127);
            let outliers: Vec<(u32, usize)> =
                places.flat_map(|i| [((i % 16 * 8 + i / 16) as u32, 7), (numbers[i] >> width, 2)]).collect();
            result.extend(((width | 1 << 5 | (outliers.len() / 2) << 9) as u16).to_le_bytes());
            // Word by word, of all lanes.
            let lanes: Vec<Vec<u8>> = numbers
                .chunks(16)
                .map(|lane| {
                    let lane: Vec<_> = lane.iter().map(|&n| (n & ((1 << width) - 1), width)).collect();
                    let mut bytes = bit_string(&lane);
                    bytes.resize(2 * width, 0);
                    bytes
                })
                .collect();
            for word in 0..width {
                lanes.iter().for_each(|lane| result.extend(&lane[2 * word..2 * word + 2]));
            }
            result.extend(bit_string(&outliers));
        }
    }
    result.extend([0; 3]);
    result
}

pub fn grid(counts: [u32; 3], bands: u32, encoding: u32, scale: f32) -> File {
    File {
        version: 1,
        kind: 0,
        counts,
        bands,
        encoding,
        scale,
        units: 0,
        min: [-1.0, 0.5, 2.0],
        max: [3.0, 2.0, 5.0],
        sections: Vec::new(),
    }
}

pub fn floats(values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    values.into_iter().flat_map(f32::to_le_bytes).collect()
}

pub fn halves(values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    values.into_iter().flat_map(|v| half::f16::from_f32(v).to_le_bytes()).collect()
}

/// A value that f16 holds exactly, different for every node and plane.
pub fn pattern(node: usize, coefficient: usize, channel: usize) -> f32 {
    let mixed = (node * 131 + coefficient * 29 + channel * 7 + 3) % 1021;
    (mixed as f32 - 400.0) / 64.0 + if coefficient == 0 { 20.0 } else { 0.0 }
}

/// A small L1 grid with every section that a grid may have, and one that nobody knows.
pub fn small_grid() -> File {
    grid([2, 3, 1], 1, 1, 0.5)
        .radiance(pattern)
        .validity(|node| node != 4)
        .section(raw(b"COVR", halves((0..6).map(|i| i as f32 / 8.0))))
        .section(raw(b"SERR", halves((0..6).map(|i| i as f32 / 64.0))))
        .section(raw(b"SETT", b"not for the runtime".to_vec()))
        .section(raw(b"new!", vec![1, 2, 3]))
}

/// Numbers of a packed file, different for every node and plane; node 3 is dark.
pub fn packed_pattern(node: usize, plane: usize) -> i16 {
    match (node, plane) {
        (3, 0) => 0,
        (_, 0) => 16384 + 97 * node as i16,
        _ => ((node * 131 + plane * 29) % 201) as i16 - 100,
    }
}

/// What a file with the step `step` and these numbers holds, after FORMAT.md.
pub fn packed_truth(number: impl Fn(usize, usize) -> i16, step: f32, node: usize, index: usize, channel: usize) -> f64 {
    use std::f64::consts::PI;
    let code = number(node, 0);
    let m = if code > 0 { ((f64::from(code) - 16384.0) / 256.0).exp2() } else { 0.0 };
    let k = [0, 1, 2].map(|c| m * f64::from(step) * f64::from(number(node, 1 + 3 * index + c)));
    let k0 = if index == 0 { m + k[0] } else { k[0] };
    let weight = [PI, 2.0 * PI / 3.0, PI / 4.0, PI / 24.0, PI / 24.0][index.isqrt()];
    let (a, b, c) = (k0 / 3f64.sqrt(), k[1] / 2f64.sqrt(), k[2] / 6f64.sqrt());
    [a + b - c, a + 2.0 * c, a - b - c][channel] / weight
}

/// A small L1 grid, packed.
pub fn small_packed() -> File {
    grid([2, 3, 1], 1, 2, 0.00390625)
        .packed(packed_pattern)
        .validity(|node| node != 4)
        .section(raw(b"COVR", halves((0..6).map(|i| i as f32 / 8.0))))
        .section(raw(b"SERR", halves((0..6).map(|i| i as f32 / 64.0))))
}

/// Five points, L0, f32.
pub fn small_points() -> File {
    let mut file = grid([5, 1, 1], 0, 0, 1.0);
    file.kind = 1;
    let places = (0..5).flat_map(|i| [i as f32 * 0.75, 0.25, 1.0 + (i % 2) as f32]);
    file.radiance(pattern).section(raw(b"POSN", floats(places)))
}

/// The eight corners of a cube, each three times with its three normals: vertices of two primitives, L2, f16.
pub fn small_vertices() -> File {
    let mut file = grid([24, 1, 1], 2, 1, 2.0);
    file.kind = 2;
    let (mut places, mut normals) = (Vec::new(), Vec::new());
    for vertex in 0..24 {
        let corner = vertex / 3;
        for axis in 0..3 {
            let high = corner >> axis & 1 == 1;
            places.push(if high { 1.5 } else { 0.0 });
            let sign = if high { 1.0 } else { -1.0 };
            normals.push(if vertex % 3 == axis { sign } else { 0.0 });
        }
    }
    let records = [[7u32, 1, 1, 12, 12], [7, 1, 0, 0, 12]];
    let records = records.as_flattened().iter().flat_map(|word| word.to_le_bytes()).collect();
    file.radiance(pattern)
        .section(raw(b"POSN", floats(places)))
        .section(raw(b"NORM", floats(normals)))
        .section(raw(b"MESH", records))
}

/// Two cells of which the first is divided into eight: 26 nodes of 5 x 3 x 3 places, L1, f16.
pub fn small_sparse() -> File {
    let mut file = grid([26, 1, 1], 1, 1, 2.0);
    file.kind = 3;
    let mut bricks: Vec<u8> = [5u32, 3, 3, 1].iter().flat_map(|word| word.to_le_bytes()).collect();
    bricks.push(1);
    // In the face between the two only the corners are nodes, and beyond it the far corners.
    let rows = [0b10111, 0b00011, 0b10111, 0, 0, 0, 0, 0];
    let odd_rows = [0b00011, 0b00011, 0b00011, 0, 0, 0, 0, 0];
    for z in [rows, odd_rows, rows, [0; 8], [0; 8], [0; 8], [0; 8], [0; 8]] {
        bricks.extend(z);
    }
    file.radiance(pattern).section(raw(b"BRIK", bricks))
}

/// Section `WALL`, byte by byte.
pub fn walls(planes: &[[f32; 4]], cells: &[(u32, [u16; 3], u8, [u8; 8])]) -> Section {
    let mut bytes = Vec::new();
    bytes.extend((planes.len() as u32).to_le_bytes());
    bytes.extend((cells.len() as u32).to_le_bytes());
    planes.iter().flatten().for_each(|value| bytes.extend(value.to_le_bytes()));
    for (cell, planes, ends, masks) in cells {
        bytes.extend(cell.to_le_bytes());
        planes.iter().for_each(|plane| bytes.extend(plane.to_le_bytes()));
        bytes.extend([*ends, 0]);
        bytes.extend(masks);
    }
    raw(b"WALL", bytes)
}

/// No further plane.
pub const NONE: u16 = u16::MAX;
/// Corners of lower x, and of higher.
pub const LOW: u8 = 0b0101_0101;
pub const HIGH: u8 = !LOW;

/// Arbitrary, as a function of its arguments: 0 to 1.
pub fn arbitrary(seed: usize, node: usize, index: usize, channel: usize) -> f32 {
    let mut bits = (((seed * 1009 + node) * 25 + index) * 3 + channel) as u32;
    for _ in 0..3 {
        bits = (bits ^ bits >> 15).wrapping_mul(0x2c1b_3c6d);
    }
    (bits >> 8) as f32 / (1 << 24) as f32
}

/// All bands and encodings, all numbers of arbitrary magnitude down to f16's subnormals, or none of them subnormal; all
/// nodes valid, or most, or some, or none.
pub fn arbitrary_grids() -> Vec<File> {
    let mut files = Vec::new();
    for seed in 0..60 {
        let (bands, encoding, scale) = [(seed as u32 % 5, 0, 1.0), (seed as u32 % 5, 1, 0.125)][seed / 5 % 2];
        let small = seed / 10 % 2 == 1;
        let value = move |node: usize, index: usize, channel: usize| {
            let [sign, size, exponent] = [0, 1, 2].map(|k| arbitrary(3 * seed + k, node, index, channel));
            let exponent = if small { -23.0 + 36.0 * exponent } else { exponent };
            (0.5 + size).copysign(sign - 0.5) * exponent.exp2() * scale
        };
        let file = grid([4, 3, 3], bands, encoding, scale).radiance(value);
        let valid = |part: f32| file.clone().validity(move |node| arbitrary(seed, node, 0, 0) < part);
        files.extend([file.clone(), valid(0.97), valid(0.7), valid(0.0)]);
    }
    files
}
