//! Volumes for the tests, and light of which the answer is known.

use gdibl_export::{Engine, Export, Settings, export};
use gdibl_runtime::format::{
    Codec, Encoding, Filter, Kind, MESHES, NORMALS, POSITIONS, RADIANCE, SectionEntry, Units, VALIDITY, crc32,
    directory_to_bytes, place_sections,
};
use gdibl_runtime::sh::{MAX_COEFFICIENTS, Y00, basis, coefficient_count};
use gdibl_runtime::{Header, RadianceSh, Volume};

pub const MIN: [f64; 3] = [-1.0, 0.5, 2.0];
pub const MAX: [f64; 3] = [3.0, 2.5, 8.0];

pub const ENGINES: [Engine; 6] = [Engine::Bevy, Engine::Three, Engine::Godot, Engine::Unity, Engine::Exr, Engine::Json];

/// The six sides, +x, -x, +y, -y, +z, -z.
pub const SIDES: [[f32; 3]; 6] =
    [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];

/// A grid over [`MIN`] to [`MAX`] with light by position, exact.
pub fn grid(counts: [u32; 3], bands: u32, light: impl Fn([f64; 3]) -> RadianceSh) -> Volume {
    let header = header(Kind::Grid, counts, bands, MAX);
    let nodes: Vec<RadianceSh> = (0..header.node_count()).map(|i| light(header.grid().node_position(i))).collect();
    parse(header, &[(RADIANCE, planes(bands, &nodes))])
}

/// A grid of which node `invalid` was filled.
pub fn grid_with_filled(counts: [u32; 3], invalid: usize, light: impl Fn([f64; 3]) -> RadianceSh) -> Volume {
    let header = header(Kind::Grid, counts, 2, MAX);
    let count = header.node_count();
    let nodes: Vec<RadianceSh> = (0..count).map(|i| light(header.grid().node_position(i))).collect();
    let validity = (0..count).map(|i| u8::from(i != invalid)).collect();
    parse(header, &[(RADIANCE, planes(2, &nodes)), (VALIDITY, validity)])
}

/// A grid flat along y.
pub fn flat_grid(light: RadianceSh) -> Volume {
    let header = header(Kind::Grid, [3, 1, 2], 2, [MAX[0], MIN[1], MAX[2]]);
    parse(header, &[(RADIANCE, planes(2, &[light; 6]))])
}

/// Points, each with its own brightness.
pub fn points(positions: &[[f32; 3]]) -> Volume {
    let nodes: Vec<RadianceSh> = (0..positions.len()).map(|i| constant([1.0 + i as f32, 2.0, 3.0])).collect();
    let bytes = positions.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
    let header = header(Kind::Points, [positions.len() as u32, 1, 1], 2, MAX);
    parse(header, &[(RADIANCE, planes(2, &nodes)), (POSITIONS, bytes)])
}

/// Vertices with their normals, `sets` of glTF node, mesh, primitive, first and count.
pub fn vertices(positions: &[[f32; 3]], normals: &[[f32; 3]], sets: &[[u32; 5]]) -> Volume {
    let nodes: Vec<RadianceSh> = (0..positions.len()).map(|i| constant([1.0 + i as f32, 2.0, 3.0])).collect();
    let bytes = |vectors: &[[f32; 3]]| vectors.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
    let sets = sets.as_flattened().iter().flat_map(|word| word.to_le_bytes()).collect();
    let header = header(Kind::Vertices, [positions.len() as u32, 1, 1], 2, MAX);
    let places = [(POSITIONS, bytes(positions)), (NORMALS, bytes(normals)), (MESHES, sets)];
    parse(header, &[vec![(RADIANCE, planes(2, &nodes))], places.to_vec()].concat())
}

fn header(kind: Kind, counts: [u32; 3], bands: u32, max: [f64; 3]) -> Header {
    let (encoding, units) = (Encoding::F32, Units::Radiance);
    Header { kind, counts, bands, encoding, scale: 1.0, units, min: MIN, max }
}

fn planes(bands: u32, nodes: &[RadianceSh]) -> Vec<u8> {
    let places = 0..coefficient_count(bands) * 3;
    places.flat_map(|k| nodes.iter().flat_map(move |sh| sh.coefficients[k / 3][k % 3].to_le_bytes())).collect()
}

fn parse(header: Header, sections: &[([u8; 4], Vec<u8>)]) -> Volume {
    let entry = |(id, bytes): &([u8; 4], Vec<u8>)| SectionEntry {
        id: *id,
        codec: Codec::Raw,
        filter: Filter::None,
        offset: 0,
        stored_size: bytes.len() as u64,
        raw_size: bytes.len() as u64,
        crc32: crc32(bytes),
    };
    let mut entries: Vec<SectionEntry> = sections.iter().map(entry).collect();
    place_sections(&mut entries);
    let mut file = directory_to_bytes(&header, &entries);
    for (entry, (_, bytes)) in entries.iter().zip(sections) {
        file.resize(entry.offset as usize, 0);
        file.extend_from_slice(bytes);
    }
    Volume::parse(&file).expect("a volume")
}

/// The same radiance from everywhere.
pub fn constant(radiance: [f32; 3]) -> RadianceSh {
    let mut sh = RadianceSh::zero(2);
    sh.coefficients[0] = radiance.map(|l| l / Y00);
    sh
}

/// Light from one direction alone: E is 1.0625 facing it and 0.0625 facing away, to L2.
pub fn from(direction: [f32; 3], rgb: [f32; 3]) -> RadianceSh {
    let mut functions = [0.0; MAX_COEFFICIENTS];
    basis(2, direction, &mut functions);
    let mut sh = RadianceSh::zero(2);
    for (coefficient, value) in sh.coefficients[..9].iter_mut().zip(functions) {
        *coefficient = rgb.map(|c| c * value);
    }
    sh
}

/// Light that differs in every coefficient and channel, and by place; E stays above 0.
pub fn uneven([x, y, z]: [f64; 3]) -> RadianceSh {
    let mut sh = constant([2.0, 3.0, 4.0]);
    for (i, coefficient) in sh.coefficients[..9].iter_mut().enumerate() {
        for (c, value) in coefficient.iter_mut().enumerate() {
            let phase = 0.9 * x + 0.7 * y * i as f64 + 0.4 * z * (c + 1) as f64 + 2.1 * i as f64 + c as f64;
            *value += 0.6 * phase.sin() as f32;
        }
    }
    sh
}

/// Directions all over the sphere, none along an axis.
pub fn normals() -> Vec<[f32; 3]> {
    (0..64).map(|i| gdibl_export::sample_normal(i * 61 + 7)).collect()
}

/// Positions in the box; every fourth up to a fifth of its size outside.
pub fn positions() -> Vec<[f64; 3]> {
    let place = |i: usize| {
        let margin = if i % 4 == 3 { 0.2 } else { 0.0 };
        let (low, high): ([f64; 3], [f64; 3]) = (
            std::array::from_fn(|k| MIN[k] - margin * (MAX[k] - MIN[k])),
            std::array::from_fn(|k| MAX[k] + margin * (MAX[k] - MIN[k])),
        );
        gdibl_export::sample_position(low, high, i)
    };
    (0..200).map(place).collect()
}

pub fn inside(p: [f64; 3]) -> bool {
    (0..3).all(|k| (MIN[k]..=MAX[k]).contains(&p[k]))
}

pub fn exported(volume: &Volume, engine: Engine) -> Export {
    export(volume, engine, &Settings { name: "room.main".into(), counts: None }).unwrap_or_else(|e| panic!("{e}"))
}

pub fn file<'a>(export: &'a Export, name: &str) -> &'a [u8] {
    let found = export.files.iter().find(|file| file.name == name);
    &found
        .unwrap_or_else(|| panic!("{name} among {:?}", export.files.iter().map(|f| &f.name).collect::<Vec<_>>()))
        .bytes
}

/// E of the volume, in f64.
pub fn truth(volume: &Volume, position: [f64; 3], normal: [f32; 3]) -> [f64; 3] {
    volume.sample_f64(position, normal).sh.convolve().evaluate(normal).map(f64::from)
}
