//! Packs a baked volume into the bytes of a `.gdibl` file (FORMAT.md, version 1).

pub mod deringing;

use gdibl_runtime::bits::{Layout, pack_bits};
use gdibl_runtime::format::{self, Codec, Encoding, Filter, Header, Kind, SectionEntry, Units};
use gdibl_runtime::walls::walls_to_bytes;
use gdibl_runtime::{RadianceSh, Volume, packed};
use half::f16;
use rayon::prelude::*;
use std::io::{BufWriter, Write};

use self::deringing::{Rounding, Search};
use crate::bake::{Baked, Nodes, SparseGrid};
use crate::job::records::{self, DeringingRecord, ErrorSummary, PackingRecord, PlanRow, Records, StatisticsRecord};
pub use crate::whole::write_whole;

/// Numbers of the coefficients.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Precision {
    /// Half floats times one power of two per volume.
    F16,
    /// Single floats.
    F32,
    /// A quarter of the bytes of half floats: see [`gdibl_runtime::packed`] and [`gdibl_runtime::bits`].
    Packed {
        /// What 95 % of the baked nodes may be off by, of E's root mean square: one of [`Precision::PACKED_ERRORS`]. `None`: a third of
        /// the noise of the median node.
        error: Option<f64>,
    },
}

impl Default for Precision {
    fn default() -> Self {
        Precision::PACKED
    }
}

impl Precision {
    /// What can be asked of a packed volume: with less the logarithm of brightness, in steps of 0.3 %, would be off by more.
    pub const PACKED_ERRORS: std::ops::RangeInclusive<f64> = 0.002..=0.1;
    /// By the noise.
    pub const PACKED: Precision = Precision::Packed { error: None };

    /// The error of packing, in whole 1e-5, that follows from the relative error of irradiance of the median node. A third of it adds a
    /// twentieth to the whole. Where noise was not measured, half of that of a good bake.
    pub fn packed_error(noise: Option<f64>) -> f64 {
        let measured = noise.filter(|noise| noise.is_finite());
        let third = measured.map_or(0.005, |noise| (noise / 3.0 * 1e5).floor() / 1e5);
        third.clamp(*Precision::PACKED_ERRORS.start(), *Precision::PACKED_ERRORS.end())
    }
}

impl std::fmt::Display for Precision {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Precision::F16 => f.write_str("f16"),
            Precision::F32 => f.write_str("f32"),
            Precision::Packed { error: None } => f.write_str("packed"),
            Precision::Packed { error: Some(error) } => write!(f, "packed:{error}"),
        }
    }
}

impl std::str::FromStr for Precision {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "f16" => Ok(Precision::F16),
            "f32" => Ok(Precision::F32),
            "packed" => Ok(Precision::PACKED),
            _ => match text.strip_prefix("packed:").map(str::parse) {
                Some(Ok(error)) if Precision::PACKED_ERRORS.contains(&error) => {
                    Ok(Precision::Packed { error: Some(error) })
                }
                Some(_) => Err("the error of packed:ERROR must be 0.002 to 0.1".into()),
                None => Err("expected f16, f32, packed or packed:ERROR".into()),
            },
        }
    }
}

/// How to pack.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PackSettings {
    /// Numbers of the coefficients.
    pub precision: Precision,
    /// Compress sections with zstd where that makes them smaller than they are otherwise. Readers need a decoder then.
    pub zstd: bool,
    /// Leave no node with negative irradiance: see [`deringing`].
    pub dering: bool,
    /// Of a part of a packed volume: that volume's step, with which its nodes become the same numbers again. Otherwise the step
    /// follows from the precision.
    pub step: Option<f32>,
}

/// A packed volume.
#[derive(Debug, Clone, PartialEq)]
pub struct Packed {
    /// The whole file.
    pub bytes: Vec<u8>,
    /// As they stand in it: with what packing did.
    pub records: Records,
}

/// The level of compression: 19 buys little more on half floats.
const ZSTD_LEVEL: i32 = 3;
/// That of packed coefficients, where it buys 10 %.
const ZSTD_LEVEL_PACKED: i32 = 19;

/// A reader keeps 2 to this of what it has read, and the compressor some times that. A million packed nodes take 65 MB less and
/// two thirds of the time than with 23, which the level would take, and half a per cent fewer bytes.
const WINDOW_LOG: u32 = 20;

/// Bytes that are compressed at a time.
const PIECE: usize = 1 << 16;

/// What goes into a file, on its way there. Holds none of what was baked, which may go before the file is put together: it is as
/// large as the file, and compressing takes as much again.
#[derive(Debug)]
pub struct Sections {
    header: Header,
    sections: Vec<([u8; 4], Content)>,
    records: Records,
    zstd: bool,
}

/// What a section holds.
#[derive(Debug)]
enum Content {
    Raw(Vec<u8>),
    /// Packed bits of so many bytes, which would not be smaller as they are.
    Bits {
        bits: Vec<u8>,
        raw_size: u64,
    },
}

impl Sections {
    /// The file, compressed if that was asked for.
    pub fn assemble(self) -> Packed {
        Packed { bytes: assemble(&self.header, self.sections, self.zstd), records: self.records }
    }
}

/// Makes the file, and adds to the records what packing itself does.
pub fn pack(nodes: &Nodes, baked: &Baked, records: Records, settings: PackSettings) -> Packed {
    sections(nodes, baked, records, settings).assemble()
}

/// The same, up to where nothing that was baked is needed any more.
pub fn sections(nodes: &Nodes, baked: &Baked, mut records: Records, settings: PackSettings) -> Sections {
    let mut statistics = records.statistics.take().unwrap_or_else(|| StatisticsRecord::of(baked));
    // De-ringing and standard errors know packed coefficients as floats.
    let numbers = match settings.precision {
        Precision::F32 | Precision::Packed { .. } => Numbers { encoding: Encoding::F32, scale: 1.0 },
        Precision::F16 => Numbers { encoding: Encoding::F16, scale: f16_scale(baked) },
    };
    let mut windows = Vec::new();
    if settings.dering {
        windows = deringing_windows(baked, numbers);
        statistics.deringing = deringing_record(baked, &windows);
        records.plan.push(match &statistics.deringing {
            None => PlanRow::new("deringing", false, "no node rings"),
            Some(DeringingRecord { nodes: n, .. }) => PlanRow::new("deringing", true, format!("{n} nodes ring")),
        });
    }
    let units = match statistics.deringing {
        None => Units::Radiance,
        Some(_) => Units::RadianceDeringed,
    };
    let (kind, counts) = kind_of(nodes);
    let (min, max) = bounds(nodes);
    let Numbers { encoding, scale } = numbers;
    let mut header = Header { kind, counts, bands: baked.bands, encoding, scale, units, min, max };

    // Sections in the order in which a reader wants them. What the level does not need is not there.
    let radiance = match settings.precision {
        Precision::Packed { error } => {
            let noise = statistics.relative_error.as_ref().map(|error| error.median);
            let error = error.unwrap_or_else(|| Precision::packed_error(noise));
            record_error(&mut records, error);
            let packed = pack_coefficients(baked, &windows, error, settings);
            (header.encoding, header.scale) = (Encoding::Packed, packed.step);
            // A part says what the whole says.
            statistics.packing = packed.record.or(statistics.packing);
            packed.content
        }
        _ => {
            let value = |node, plane| baked.node(node)[plane];
            Content::Raw(planes(value, baked.sh.width(), &windows, baked.len(), numbers))
        }
    };
    let mut sections = place_sections(nodes, baked);
    match nodes {
        Nodes::Grid(_) | Nodes::Sparse(_) => {}
        Nodes::Points(_) => sections.push((format::POSITIONS, positions(nodes, min))),
        Nodes::Vertices { normals, sets, .. } => {
            sections.push((format::POSITIONS, positions(nodes, min)));
            sections.push((format::NORMALS, floats(normals.iter().flat_map(|n| n.to_array()))));
            let words = sets.iter().flat_map(|s| [s.node, s.mesh, s.primitive, s.first, s.count]);
            sections.push((format::MESHES, words.flat_map(u32::to_le_bytes).collect()));
        }
    }
    let halves = |values: &[f32]| -> Vec<u8> { values.iter().flat_map(|&v| f16::from_f32(v).to_le_bytes()).collect() };
    // Errors of which a few per cent matter to nobody.
    let is_packed = header.encoding == Encoding::Packed;
    let errors = |values: &[f32]| if is_packed { coarse_halves(values) } else { halves(values) };
    if baked.coverage.iter().any(|&c| c < 1.0) {
        sections.push((format::COVERAGE, halves(&baked.coverage)));
    }
    if baked.relative_error.iter().all(|e| e.is_finite()) {
        sections.push((format::STANDARD_ERROR, errors(&baked.relative_error)));
    }
    if baked.systematic_error.iter().any(|e| *e > 0.0) && baked.systematic_error.iter().all(|e| e.is_finite()) {
        sections.push((format::SYSTEMATIC_ERROR, errors(&baked.systematic_error)));
    }
    if !baked.coefficient_error.is_empty() && baked.coefficient_error.iter().all(|e| e.is_finite()) {
        sections.push((format::WORST_ERROR, errors(&baked.worst_error)));
        let stride = baked.sh.width();
        let value = |node, plane| baked.coefficient_error[node * stride + plane];
        sections.push((format::COEFFICIENT_ERRORS, planes(value, stride, &[], baked.len(), numbers)));
    }
    if let Some(settings) = &records.settings {
        sections.push((format::SETTINGS, records::encode(settings)));
    }
    if !records.plan.is_empty() {
        sections.push((format::PLAN, records::encode(&records.plan)));
    }
    if !records.probes.is_empty() {
        sections.push((format::PROBES, records::encode(&records.probes)));
    }
    sections.push((format::STATISTICS, records::encode(&statistics)));
    records.statistics = Some(statistics);

    let rest = sections.into_iter().map(|(id, bytes)| (id, Content::Raw(bytes)));
    let sections = std::iter::once((format::RADIANCE, radiance)).chain(rest).collect();
    Sections { header, sections, records, zstd: settings.zstd }
}

fn kind_of(nodes: &Nodes) -> (Kind, [u32; 3]) {
    let list = [nodes.len() as u32, 1, 1];
    match nodes {
        Nodes::Grid(grid) => (Kind::Grid, grid.counts),
        Nodes::Sparse(_) => (Kind::Sparse, list),
        Nodes::Points(_) => (Kind::Points, list),
        Nodes::Vertices { .. } => (Kind::Vertices, list),
    }
}

/// Which nodes are there, which were baked, and what walls are between them.
fn place_sections(nodes: &Nodes, baked: &Baked) -> Vec<([u8; 4], Vec<u8>)> {
    let mut sections = Vec::new();
    if !baked.is_all_valid() {
        sections.push((format::VALIDITY, (0..baked.len()).map(|node| u8::from(baked.is_valid(node))).collect()));
    }
    if let Nodes::Sparse(sparse) = nodes {
        sections.push((format::BRICKS, sparse.bricks.to_bytes()));
    }
    if let Some(walls) = &baked.walls {
        sections.push((format::WALLS, walls_to_bytes(&walls.planes, &walls.cells)));
    }
    sections
}

/// To 3 %: five digits of eleven, the others 0. What is too large for f16 stays as it is.
fn coarse_halves(values: &[f32]) -> Vec<u8> {
    let coarse = |value: f32| match f16::from_f32(value).to_bits() {
        bits @ 0x7be0.. => bits,
        bits => (bits + 0x20) & !0x3f,
    };
    values.iter().flat_map(|&value| coarse(value).to_le_bytes()).collect()
}

/// The settings in force repeat the bytes of the file: they name the error that followed from noise.
fn record_error(records: &mut Records, error: f64) {
    for row in records.settings.iter_mut().flat_map(|settings| &mut settings.settings) {
        if row.name == "quality.precision" && row.value == Some(Precision::PACKED.to_string()) {
            row.value = Some(Precision::Packed { error: Some(error) }.to_string());
        }
    }
}

/// Per node the weight of bands 1 and up; `None` leaves it as it is.
fn deringing_windows(baked: &Baked, numbers: Numbers) -> Vec<Option<f32>> {
    let search = Search::default();
    let window = |node| {
        let node = node_sh(baked, node);
        let mut stored = node;
        stored.coefficients.iter_mut().flatten().for_each(|value| *value = numbers.read(*value));
        deringing::window(&node, &stored, numbers.rounding(), &search)
    };
    (0..baked.len()).into_par_iter().map(window).collect()
}

fn deringing_record(baked: &Baked, windows: &[Option<f32>]) -> Option<DeringingRecord> {
    let rang = windows.iter().enumerate().filter_map(|(node, window)| window.map(|w| (node, w)));
    let changes: Vec<f64> = rang.map(|(node, w)| deringing::relative_change(&node_sh(baked, node), w)).collect();
    let relative_change = ErrorSummary::of(changes.iter().copied())?;
    Some(DeringingRecord { nodes: changes.len() as u64, relative_change })
}

fn node_sh(baked: &Baked, node: usize) -> RadianceSh {
    let mut sh = RadianceSh::zero(baked.bands);
    let values = baked.node(node);
    sh.coefficients.as_flattened_mut()[..values.len()].copy_from_slice(&values);
    sh
}

/// How coefficients are stored.
#[derive(Debug, Clone, Copy)]
struct Numbers {
    encoding: Encoding,
    scale: f32,
}

impl Numbers {
    /// What a reader sees of a value.
    fn read(self, value: f32) -> f32 {
        match self.encoding {
            Encoding::F32 | Encoding::Packed => value,
            Encoding::F16 => f16::from_f32(value / self.scale).to_f32() * self.scale,
        }
    }

    /// What storing a product changes: half an ulp of f32 for the product, and half of one of f16.
    fn rounding(self) -> Rounding {
        match self.encoding {
            Encoding::F32 | Encoding::Packed => Rounding { relative: 0.5f64.powi(24), absolute: 0.0 },
            Encoding::F16 => {
                Rounding { relative: 0.5f64.powi(11) * 1.001, absolute: f64::from(self.scale) * 0.5f64.powi(25) }
            }
        }
    }
}

/// Section `RSH ` of a packed volume.
struct PackedCoefficients {
    content: Content,
    step: f32,
    record: Option<PackingRecord>,
}

/// With the step that is given, else with the coarsest of a row, 2 % apart, that leaves 95 % of the baked nodes within `error`.
///
/// A formula would have to know how much of a node's E lies in its band 0: the same error takes steps of 0.0029 to 0.0036.
fn pack_coefficients(baked: &Baked, windows: &[Option<f32>], error: f64, settings: PackSettings) -> PackedCoefficients {
    let count = baked.sh.width();
    let step = settings.step.unwrap_or_else(|| coarsest_step(baked, windows, error));
    let record = settings.step.is_none().then(|| errors_with(baked, windows, step)).flatten();
    let node_numbers = |node: usize, numbers: &mut [i16]| {
        packed::quantise_node(&windowed(baked, windows, node).coefficients.as_flattened()[..count], step, numbers);
    };
    let raw_size = 2 * (baked.len() * (count + 1)) as u64;
    let raw = || Content::Raw(packed::numbers_to_bytes(baked.len(), count + 1, node_numbers));
    let content = match settings.zstd {
        // A compressor wants the bytes themselves.
        true => raw(),
        false => match packed::numbers_to_bits(baked.len(), count + 1, node_numbers) {
            bits if (bits.len() as u64) < raw_size => Content::Bits { bits, raw_size },
            _ => raw(),
        },
    };
    PackedCoefficients { content, step, record: record.map(|added_error| PackingRecord { step, added_error }) }
}

/// What packing with a step adds to the error of baked nodes.
fn errors_with(baked: &Baked, windows: &[Option<f32>], step: f32) -> Option<ErrorSummary> {
    let count = baked.sh.width();
    let baked_nodes = (0..baked.len()).into_par_iter().filter(|&node| baked.is_valid(node));
    let errors: Vec<f64> =
        baked_nodes.map(|node| packing_error(&windowed(baked, windows, node), count, step)).collect();
    ErrorSummary::of(errors.into_iter())
}

/// The coarsest step of a row that leaves 95 % of the baked nodes within `error`.
fn coarsest_step(baked: &Baked, windows: &[Option<f32>], error: f64) -> f32 {
    assert!(Precision::PACKED_ERRORS.contains(&error), "error {error} not in {:?}", Precision::PACKED_ERRORS);
    // A row of steps: L0 in even light takes 2.4 times the error, L2 0.6.
    let step_of = |place: u32| (3.0 * error * (-f64::from(place) / 32.0).exp2()) as f32;
    // `fine` is fine enough, `coarse` and what lies before it is not: halve what is between.
    let (mut coarse, mut fine) =
        (0, (0..).take_while(|&place| step_of(place) >= *packed::STEPS.start()).count() as u32);
    while fine - coarse > 1 {
        let middle = coarse.midpoint(fine);
        match errors_with(baked, windows, step_of(middle)) {
            Some(summary) if summary.p95 > error => coarse = middle,
            _ => fine = middle,
        }
    }
    step_of(fine).max(*packed::STEPS.start())
}

/// What a node's E is off by once packed and read: root mean square over normals and channels, over that of E.
fn packing_error(node: &RadianceSh, count: usize, step: f32) -> f64 {
    let mut numbers = [0; packed::MAX_NUMBERS];
    let mut restored = RadianceSh::zero(node.bands);
    packed::quantise_node(&node.coefficients.as_flattened()[..count], step, &mut numbers[..=count]);
    packed::restore_node(&numbers[..=count], step, &mut restored.coefficients.as_flattened_mut()[..count]);
    // The runtime keeps half floats: eleven digits.
    let half = |value: f32| f32::from_bits(value.to_bits().wrapping_add(1 << 12) & !0x1fff);
    restored.coefficients.as_flattened_mut().iter_mut().for_each(|value| *value = half(*value));
    // Parseval: the basis is orthonormal.
    let (truth, found) = (node.convolve().coefficients, restored.convolve().coefficients);
    let pairs = || truth.as_flattened().iter().zip(found.as_flattened()).map(|(&e, &f)| (f64::from(e), f64::from(f)));
    let power: f64 = pairs().map(|(e, _)| e * e).sum();
    let error: f64 = pairs().map(|(e, f)| (e - f).powi(2)).sum();
    if power > 0.0 { (error / power).sqrt() } else { 0.0 }
}

/// A node as a file holds it: de-ringed where it rang.
fn windowed(baked: &Baked, windows: &[Option<f32>], node: usize) -> RadianceSh {
    let mut sh = node_sh(baked, node);
    if let Some(weight) = windows.get(node).copied().flatten() {
        sh.coefficients[1..].iter_mut().flatten().for_each(|value| *value *= weight);
    }
    sh
}

/// What an engine would load: packed in single floats without records, and parsed again.
pub fn volume_of(nodes: &Nodes, baked: &Baked) -> Volume {
    let settings = PackSettings { precision: Precision::F32, ..PackSettings::default() };
    Volume::parse(&pack(nodes, baked, Records::default(), settings).bytes).expect("what was packed parses")
}

/// Grid, walls and baked nodes of a volume without its light: it tells which nodes' light is read at a position.
pub fn frame_of(nodes: &Nodes, baked: &Baked) -> Volume {
    let (kind, counts) = kind_of(nodes);
    let (min, max) = bounds(nodes);
    let (encoding, scale) = (Encoding::Packed, *packed::STEPS.start());
    let header = Header { kind, counts, bands: 0, encoding, scale, units: Units::Radiance, min, max };
    let count = header.values_per_node() + 1;
    let raw_size = 2 * (nodes.len() * count) as u64;
    let dark = match packed::numbers_to_bits(nodes.len(), count, |_, numbers| numbers.fill(0)) {
        bits if (bits.len() as u64) < raw_size => Content::Bits { bits, raw_size },
        _ => Content::Raw(vec![0; raw_size as usize]),
    };
    let rest = place_sections(nodes, baked).into_iter().map(|(id, bytes)| (id, Content::Raw(bytes)));
    let sections = std::iter::once((format::RADIANCE, dark)).chain(rest).collect();
    Volume::parse(&assemble(&header, sections, false)).expect("what was packed parses")
}

/// Some nodes of a volume as an engine reads them from its file, as points: numbers are those of the whole.
pub fn part_as_read(baked: &Baked, settings: PackSettings, some: &[u32]) -> Volume {
    let numbers = match settings.precision {
        Precision::F32 | Precision::Packed { .. } => Numbers { encoding: Encoding::F32, scale: 1.0 },
        Precision::F16 => Numbers { encoding: Encoding::F16, scale: f16_scale(baked) },
    };
    let windows = if settings.dering { deringing_windows(baked, numbers) } else { Vec::new() };
    let mut step = settings.step;
    // A reader's numbers follow from the largest ones, and from the least: those nodes come along.
    let mut extremes = Vec::new();
    if let Precision::Packed { error } = settings.precision {
        let noise = || StatisticsRecord::of(baked).relative_error.map(|error| error.median);
        let error = error.unwrap_or_else(|| Precision::packed_error(noise()));
        let found = step.unwrap_or_else(|| coarsest_step(baked, &windows, error));
        step = Some(found);
        extremes = packed_extremes(baked, &windows, found);
    } else {
        let sizes = (0..baked.len()).map(|node| (node, largest(&baked.node(node))));
        extremes.extend(sizes.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(node, _)| node));
    }
    let rows = || some.iter().map(|node| *node as usize).chain(extremes.iter().copied());
    let part = Baked::of_rows(baked.bands, baked.sh.selected(rows()));
    let places = (0..part.len()).map(|node| glam::DVec3::X * node as f64).collect();
    let packing = PackSettings { zstd: false, step, ..settings };
    let bytes = pack(&Nodes::Points(places), &part, Records::default(), packing).bytes;
    Volume::parse(&bytes).expect("what was packed parses")
}

/// The nodes with the least brightness and the greatest, and that with the largest number.
fn packed_extremes(baked: &Baked, windows: &[Option<f32>], step: f32) -> Vec<usize> {
    let count = baked.sh.width();
    let figures = |node: usize| {
        let mut numbers = [0; packed::MAX_NUMBERS];
        let mut restored = [0.0; packed::MAX_NUMBERS - 1];
        let sh = windowed(baked, windows, node);
        packed::quantise_node(&sh.coefficients.as_flattened()[..count], step, &mut numbers[..=count]);
        packed::restore_node(&numbers[..=count], step, &mut restored[..count]);
        (numbers[0], largest(&restored[..count]), node)
    };
    let all = || (0..baked.len()).into_par_iter().map(figures);
    let lit = || all().filter(|(code, ..)| *code > 0);
    let least = lit().min_by_key(|(code, _, node)| (*code, *node));
    let most = lit().max_by_key(|(code, _, node)| (*code, *node));
    let large = all().max_by(|a, b| a.1.total_cmp(&b.1).then(a.2.cmp(&b.2)));
    [least, most, large].into_iter().flatten().map(|(.., node)| node).collect()
}

/// Compresses what gains by it, and puts directory and sections one behind the other.
fn assemble(header: &Header, sections: Vec<([u8; 4], Content)>, compress: bool) -> Vec<u8> {
    let (mut entries, stored): (Vec<SectionEntry>, Vec<Vec<u8>>) = sections
        .into_iter()
        .map(|(id, content)| {
            let (raw_size, (codec, filter, bytes)) = match content {
                Content::Raw(raw) => (raw.len() as u64, stored(header, id, raw, compress)),
                Content::Bits { bits, raw_size } => (raw_size, (Codec::Bits, Filter::None, bits)),
            };
            let (stored_size, crc32) = (bytes.len() as u64, crc32fast::hash(&bytes));
            (SectionEntry { id, codec, filter, offset: 0, stored_size, raw_size, crc32 }, bytes)
        })
        .unzip();
    format::place_sections(&mut entries);
    let mut file = format::directory_to_bytes(header, &entries);
    for (number, (entry, mut bytes)) in entries.iter().zip(stored).enumerate() {
        file.resize(entry.offset as usize, 0);
        if number == 0 {
            // The first is by far the largest: the file grows around it.
            bytes.splice(0..0, file);
            file = bytes;
        } else {
            file.append(&mut bytes);
        }
    }
    file
}

/// In the fewest bytes: as they are, as bits in packed volumes, and compressed where that is allowed.
fn stored(header: &Header, id: [u8; 4], raw: Vec<u8>, compress: bool) -> (Codec, Filter, Vec<u8>) {
    let bits = bits_layout(header, id).map(|layout| (Codec::Bits, Filter::None, pack_bits(&raw, layout)));
    let frame = compress.then(|| compressed(header, id, &raw));
    let ways = [Some((Codec::Raw, Filter::None, raw)), bits, frame];
    ways.into_iter().flatten().min_by_key(|(.., bytes)| bytes.len()).expect("as they are is one")
}

/// How a section of a packed volume becomes bits; `None` where it does not. Other volumes are for readers that know no bits.
fn bits_layout(header: &Header, id: [u8; 4]) -> Option<Layout> {
    let (element_size, planes) = match id {
        _ if header.encoding != Encoding::Packed => return None,
        format::RADIANCE => (2, header.values_per_node() + 1),
        format::VALIDITY => (1, 1),
        format::COVERAGE | format::STANDARD_ERROR | format::WORST_ERROR | format::SYSTEMATIC_ERROR => (2, 1),
        _ => return None,
    };
    Some(Layout { element_size, planes })
}

/// One frame. Bytes are shuffled on their way: copies of coefficients are as large as the file.
fn compressed(header: &Header, id: [u8; 4], raw: &[u8]) -> (Codec, Filter, Vec<u8>) {
    let packed = id == format::RADIANCE && header.encoding == Encoding::Packed;
    let level = if packed { ZSTD_LEVEL_PACKED } else { ZSTD_LEVEL };
    let frame = |bytes: &mut dyn Iterator<Item = u8>| -> std::io::Result<Vec<u8>> {
        let mut encoder = zstd::Encoder::new(Vec::new(), level)?;
        encoder.window_log(WINDOW_LOG)?;
        encoder.set_pledged_src_size(Some(raw.len() as u64))?;
        let mut encoder = BufWriter::with_capacity(PIECE, encoder);
        for byte in bytes {
            encoder.write_all(&[byte])?;
        }
        encoder.into_inner()?.finish()
    };
    let (filter, bytes) = match header.element_size(id) {
        Some(size) => (Filter::ByteShuffle, frame(&mut format::byte_shuffle(raw, size))),
        None => (Filter::None, frame(&mut raw.iter().copied())),
    };
    (Codec::Zstd, filter, bytes.expect("zstd compresses into memory"))
}

/// Coefficients, one plane per coefficient and channel. The first three planes are band 0, which no window changes.
/// `value` is that of a node in a plane.
fn planes(
    value: impl Fn(usize, usize) -> f32,
    stride: usize,
    windows: &[Option<f32>],
    nodes: usize,
    numbers: Numbers,
) -> Vec<u8> {
    let weight = |plane: usize, node: usize| windows.get(node).copied().flatten().filter(|_| plane >= 3);
    let windowed = |plane: usize, node: usize| {
        let value = value(node, plane);
        weight(plane, node).map_or(value, |weight| value * weight)
    };
    let places = (0..stride).flat_map(|plane| (0..nodes).map(move |node| (plane, node)));
    match numbers.encoding {
        Encoding::F32 | Encoding::Packed => floats(places.map(|(plane, node)| windowed(plane, node))),
        Encoding::F16 => {
            let inverse = 1.0 / numbers.scale;
            let half = |value: f32| f16::from_f32(value.min(f16::MAX.to_f32()));
            let mut bytes = Vec::with_capacity(2 * stride * nodes);
            places.for_each(|(plane, node)| bytes.extend(half(windowed(plane, node) * inverse).to_le_bytes()));
            bytes
        }
    }
}

/// The power of two that brings the largest coefficient just under half of f16's largest number: nothing
/// overflows, and as little as can be falls into the subnormals.
fn f16_scale(baked: &Baked) -> f32 {
    let largest = (0..baked.len()).fold(0.0f32, |m, node| m.max(largest(&baked.node(node))));
    if largest == 0.0 { 1.0 } else { (largest.log2().ceil() - 15.0).clamp(-100.0, 100.0).exp2() }
}

fn largest(values: &[f32]) -> f32 {
    values.iter().fold(0.0, |m, v| m.max(v.abs()))
}

fn bounds(nodes: &Nodes) -> ([f64; 3], [f64; 3]) {
    match nodes {
        Nodes::Grid(grid) | Nodes::Sparse(SparseGrid { grid, .. }) => (grid.min, grid.max),
        Nodes::Points(positions) | Nodes::Vertices { positions, .. } => {
            let first = positions.first().copied().unwrap_or_default();
            let bounds = positions.iter().fold((first, first), |(min, max), &p| (min.min(p), max.max(p)));
            (bounds.0.into(), bounds.1.into())
        }
    }
}

/// Relative to `min`, so that f32 is enough anywhere in the world.
fn positions(nodes: &Nodes, min: [f64; 3]) -> Vec<u8> {
    floats((0..nodes.len()).flat_map(|i| (nodes.position(i) - glam::DVec3::from(min)).as_vec3().to_array()))
}

fn floats(values: impl Iterator<Item = f32>) -> Vec<u8> {
    values.flat_map(f32::to_le_bytes).collect()
}
