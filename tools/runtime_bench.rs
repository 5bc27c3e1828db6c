//! How close the runtime's samples and its parsing come to what the machine can do, as Markdown tables.
//!
//! `cargo run --release -p gdibl-tools --bin runtime_bench`; a minute. Volumes are made here: L2, f16, grids.
//!
//! Samples, of 64 MB: `Volume::irradiance_batch` of 4096 places and `Volume::irradiance` of one, with a normal, against two
//! floors measured at the same places.
//! * **floor**: finds the cell and blends the 8 × 27 halves in AVX with the processor's own f16 conversion (f16c).
//! * **touch**: finds the cell and adds up the 8 × 27 raw words. Nothing that reads them can be faster.
//!
//! Both with walls in every eighth cell and in all, against none; as sparse grids with cells of one size and of two; and as sets of one
//! volume, of two where the first answers everywhere, and of two that both answer everywhere.
//!
//! Parsing, of 100 MB without compression: `Volume::parse`, against a copy and the CRC-32 of the same bytes. And of the same
//! nodes packed, as bits and as plain numbers, against f16.
//! `cargo run --release -p gdibl-tools --bin runtime_bench -- FILE.gdibl…` does that with volumes of yours instead, repeated to 100 MB.
//!
//! All that is compared takes turns in short rounds. What is printed are medians: of a round's time, and of the ratio of
//! times within a round.

#![allow(unsafe_code, reason = "calls functions compiled for f16c and AVX, once the processor is known to have them")]

use gdibl_baker::sampling::fibonacci_sphere;
use gdibl_runtime::bits::{Layout, pack_bits};
use gdibl_runtime::bricks::Bricks;
use gdibl_runtime::format::{
    self, BRICKS, Codec, Encoding, Filter, Header, Kind, RADIANCE, SectionEntry, Units, WALLS,
};
use gdibl_runtime::walls::{Plane, WallCell, walls_to_bytes};
use gdibl_runtime::{Limits, Volume, VolumeSet, packed};
use half::f16;
use std::hint::black_box;
use std::time::Instant;

/// Values of an L2 node.
const VALUES: usize = 27;
/// Bytes of a node.
const NODE_BYTES: usize = 2 * VALUES;
/// Samples per round: few enough that a disturbance spoils one round, and of other places than the rounds around it.
const BATCH: usize = 4096;
/// Rounds of samples, each at places of its own.
const BATCHES: usize = 240;
/// Metres between samples along a path, where nodes are one metre apart: a frame's way at 3 m/s.
const STEP: f32 = 0.05;
/// Rounds of parsing.
const PARSES: usize = 15;

/// Positions, and a normal for each.
struct Places<'a> {
    positions: &'a [[f32; 3]],
    normals: &'a [[f32; 3]],
}

/// What is done at places.
type Work<'a> = &'a dyn Fn(&Places);

fn main() {
    let files: Vec<String> = std::env::args().skip(1).collect();
    if !files.is_empty() {
        print_packed_head();
        for file in &files {
            let bytes = std::fs::read(file).unwrap_or_else(|e| panic!("{file}: {e}"));
            let volume = Volume::parse(&bytes).unwrap_or_else(|e| panic!("{file}: {e}"));
            let is_packed = volume.header().encoding == Encoding::Packed;
            print_packed(file, &volume, if is_packed { volume.header().scale } else { 0.005 });
        }
        return;
    }
    println!(
        "| L2 f16 samples, 64 MB | batch / floor | irradiance / floor | batch / touch | batch | irradiance | floor | touch |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let counts = counts_of(64_000_000);
    let bytes = file(counts, 0);
    let volume = Volume::parse(&bytes).expect("a volume");
    let floor = Floor::new(&bytes);
    for (name, places) in [("random places", random_places(counts)), ("along a path", path(counts))] {
        let [in_batches, sample, blend, touch] = sampling_rounds(
            &places,
            [
                &|places: &Places| batch(&volume, places),
                &|places: &Places| irradiance(&volume, places),
                &|places: &Places| floor.blend(places),
                &|places: &Places| floor.touch(places),
            ],
        );
        println!(
            "| {name} | {:.2} | {:.2} | {:.2} | {:.1} ns | {:.1} ns | {:.1} ns | {:.1} ns |",
            median_ratio(&in_batches, &blend),
            median_ratio(&sample, &blend),
            median_ratio(&in_batches, &touch),
            median(&in_batches),
            median(&sample),
            median(&blend),
            median(&touch)
        );
    }

    println!();
    println!("| with walls, over without | in one of 8 cells | in all | without |");
    println!("|---|---|---|---|");
    let walled = [8, 1].map(|every| Volume::parse(&file(counts, every)).expect("a volume"));
    compare([&volume, &walled[0], &walled[1]], counts);

    println!();
    println!(
        "| sets, over the volume alone | of one | of two, the first everywhere | of two, both everywhere | volume |"
    );
    println!("|---|---|---|---|---|");
    let wide = f64::from(counts);
    let sets = [vec![1.0], vec![1.0, 1.0]].map(|spacings| set(&volume, &spacings));
    compare_sets(&volume, [&sets[0], &sets[1], &both_everywhere(&bytes, wide)], counts);

    println!();
    println!("| sparse, over a grid | every place a node | cells of two sizes | grid |");
    println!("|---|---|---|---|");
    // Whole cells of the largest size.
    let counts = (counts - 1) / 8 * 8 + 1;
    let volume = Volume::parse(&file(counts, 0)).expect("a volume");
    let sparse = [true, false].map(|all| Volume::parse(&sparse_file(counts, all)).expect("a volume"));
    compare([&volume, &sparse[0], &sparse[1]], counts);

    let bytes = file(counts_of(100_000_000), 0);
    let mut target = vec![0; bytes.len()];
    let mut seconds: [Vec<f64>; 3] = Default::default();
    for _ in 0..PARSES {
        seconds[0].push(time(|| drop(black_box(Volume::parse(&bytes).expect("a volume")))));
        seconds[1].push(time(|| black_box(&mut target).copy_from_slice(&bytes)));
        seconds[2].push(time(|| _ = black_box(format::crc32(&bytes))));
    }
    let [parse, copy, crc32] = &seconds;
    let rate = |seconds: &[f64]| 1e-9 * bytes.len() as f64 / median(seconds);
    println!();
    println!(
        "| parsing, {:.1} MB raw | parse / copy | parse / crc32 | parse | copy | crc32 |",
        1e-6 * bytes.len() as f64
    );
    println!("|---|---|---|---|---|---|");
    println!(
        "| times, and GB/s | {:.2} | {:.2} | {:.2} GB/s | {:.2} GB/s | {:.2} GB/s |",
        median_ratio(parse, copy),
        median_ratio(parse, crc32),
        rate(parse),
        rate(copy),
        rate(crc32)
    );
    println!();
    print_packed_head();
    print_packed("random numbers", &Volume::parse(&bytes).expect("a volume"), 0.003);
}

fn print_packed_head() {
    println!(
        "| parsing packed nodes | over f16: as bits | as plain numbers | f16 | as bits | plain | bytes per node, as bits |"
    );
    println!("|---|---|---|---|---|---|---|");
}

/// What parsing a volume's nodes, repeated to 100 MB of f16, takes in each form.
fn print_packed(name: &str, volume: &Volume, step: f32) {
    let nodes = volume.node_count().max(100_000_000 / NODE_BYTES);
    let values = volume.header().values_per_node();
    let header = Header {
        kind: Kind::Grid,
        counts: [nodes as u32, 1, 1],
        min: [0.0; 3],
        max: [1.0; 3],
        encoding: Encoding::Packed,
        scale: step,
        ..*volume.header()
    };
    let node_sh = |node: usize| volume.node_sh(node % volume.node_count()).coefficients;
    let numbers = packed::numbers_to_bytes(nodes, values + 1, |node, numbers| {
        packed::quantise_node(&node_sh(node).as_flattened()[..values], step, numbers);
    });
    let bits = pack_bits(&numbers, Layout { element_size: 2, planes: values + 1 });
    let per_node = bits.len() as f64 / nodes as f64;
    // What the baker's scale does: the largest number just below half of f16's largest.
    let largest = (0..volume.node_count()).flat_map(&node_sh).flatten().fold(0.0f32, |m, v| m.max(v.abs()));
    let scale = (largest.log2().ceil() - 15.0).exp2();
    let mut halves = vec![0; 2 * nodes * values];
    for node in 0..nodes {
        for (plane, value) in node_sh(node).as_flattened()[..values].iter().enumerate() {
            halves[2 * (plane * nodes + node)..][..2].copy_from_slice(&f16::from_f32(value / scale).to_le_bytes());
        }
    }
    let size = numbers.len();
    let files = [
        assemble(&Header { encoding: Encoding::F16, scale, ..header }, &[(RADIANCE, halves)]),
        assemble_stored(&header, &[(RADIANCE, Codec::Bits, size, bits)]),
        assemble(&header, &[(RADIANCE, numbers)]),
    ];
    let mut seconds: [Vec<f64>; 3] = Default::default();
    for _ in 0..PARSES {
        for (seconds, file) in seconds.iter_mut().zip(&files) {
            seconds.push(time(|| drop(black_box(Volume::parse(file).expect("a volume")))));
        }
    }
    let [f16, bits, plain] = &seconds;
    let [a, b, c] = [f16, bits, plain].map(|seconds| 1e9 * median(seconds) / nodes as f64);
    println!(
        "| {name} | {:.2} | {:.2} | {a:.0} ns | {b:.0} ns | {c:.0} ns | {per_node:.1} |",
        median_ratio(bits, f16),
        median_ratio(plain, f16)
    );
}

/// Prints what samples of two volumes cost over those of the first.
fn compare(volumes: [&Volume; 3], counts: u32) {
    for (name, places) in [("random places", random_places(counts)), ("along a path", path(counts))] {
        for (how, read) in [("in a batch", batch as fn(&Volume, &Places)), ("one by one", irradiance)] {
            let [a, b, c] = volumes.map(|volume| move |places: &Places| read(volume, places));
            let [first, second, third] = sampling_rounds(&places, [&a, &b, &c]);
            let [second, third] = [second, third].map(|times| median_ratio(&times, &first));
            println!("| {name}, {how} | {second:.2} | {third:.2} | {:.1} ns |", median(&first));
        }
    }
}

/// As often the same volume as there are spacings.
fn set(volume: &Volume, spacings: &[f64]) -> VolumeSet {
    VolumeSet::new(spacings.iter().map(|spacing| (volume.clone(), *spacing))).expect("grids")
}

/// Two volumes of which the first gives way all over its box, to one of which it is a small part.
fn both_everywhere(bytes: &[u8], wide: f64) -> VolumeSet {
    let directory = format::parse_header_and_sections(bytes).expect("a volume");
    let Header { min, max, .. } = directory.header;
    let larger = Header { min: min.map(|m| m - 2.0 * wide), max: max.map(|m| m + 2.0 * wide), ..directory.header };
    let mut moved = format::directory_to_bytes(&larger, &directory.sections);
    moved.extend_from_slice(&bytes[moved.len()..]);
    let volumes = [bytes, &moved].map(|bytes| Volume::parse(bytes).expect("a volume"));
    VolumeSet::new(volumes.into_iter().map(|volume| (volume, wide))).expect("grids")
}

/// Prints how long samples of sets take, over samples of the volume.
fn compare_sets(volume: &Volume, sets: [&VolumeSet; 3], counts: u32) {
    for (name, places) in [("random places", random_places(counts)), ("along a path", path(counts))] {
        for in_batches in [true, false] {
            let alone =
                move |places: &Places| if in_batches { batch(volume, places) } else { irradiance(volume, places) };
            let [a, b, c] = sets.map(|set| move |places: &Places| irradiance_of_set(set, places, in_batches));
            let [first, one, two, both] = sampling_rounds(&places, [&alone, &a, &b, &c]);
            let [one, two, both] = [one, two, both].map(|times| median_ratio(&times, &first));
            let how = if in_batches { "in a batch" } else { "one by one" };
            println!("| {name}, {how} | {one:.2} | {two:.2} | {both:.2} | {:.1} ns |", median(&first));
        }
    }
}

fn irradiance_of_set(set: &VolumeSet, places: &Places, in_batches: bool) {
    if in_batches {
        let mut found = [[0.0; 3]; BATCH];
        set.irradiance_batch(places.positions, places.normals, &mut found);
        black_box(found);
        return;
    }
    let mut sum = [0.0; 3];
    for (position, normal) in places.positions.iter().zip(places.normals) {
        let found = set.irradiance(*position, *normal);
        (0..3).for_each(|c| sum[c] += found[c]);
    }
    black_box(sum);
}

fn irradiance(volume: &Volume, places: &Places) {
    let mut sum = [0.0; 3];
    for (position, normal) in places.positions.iter().zip(places.normals) {
        let found = volume.irradiance(*position, *normal);
        (0..3).for_each(|c| sum[c] += found[c]);
    }
    black_box(sum);
}

fn batch(volume: &Volume, places: &Places) {
    let mut found = [[0.0; 3]; BATCH];
    volume.irradiance_batch(places.positions, places.normals, &mut found);
    black_box(found);
}

/// Nanoseconds per sample of each of several, round by round. In a round each has other places, so that none finds in the
/// cache what another has fetched; over all rounds each has them all.
fn sampling_rounds<const N: usize>(
    (positions, normals): &(Vec<[f32; 3]>, Vec<[f32; 3]>),
    run: [Work; N],
) -> [Vec<f64>; N] {
    let mut nanoseconds = [const { Vec::new() }; N];
    for round in 0..BATCHES {
        for (k, run) in run.iter().enumerate() {
            let first = (round + k * BATCHES / N) % BATCHES * BATCH;
            let positions = &positions[first..first + BATCH];
            let places = Places { positions, normals: &normals[first..first + BATCH] };
            nanoseconds[k].push(1e9 * time(|| run(&places)) / BATCH as f64);
        }
    }
    nanoseconds
}

fn time(run: impl FnOnce()) -> f64 {
    let start = Instant::now();
    run();
    start.elapsed().as_secs_f64()
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

fn median_ratio(above: &[f64], below: &[f64]) -> f64 {
    median(&above.iter().zip(below).map(|(a, b)| a / b).collect::<Vec<f64>>())
}

/// Nodes per axis of a cube of so many bytes.
fn counts_of(bytes: usize) -> u32 {
    (bytes as f64 / NODE_BYTES as f64).cbrt().round() as u32
}

/// A grid of nodes one metre apart, of values evenly between -1 and 1, stored as the baker would: the largest just below
/// half of f16's largest number. With walls in every so-manieth cell, 0: in none.
fn file(counts: u32, walled: u32) -> Vec<u8> {
    let header = header(Kind::Grid, [counts; 3], counts);
    let mut sections = vec![(RADIANCE, radiance(header.node_count()))];
    if walled > 0 {
        sections.push((WALLS, walls(&header, walled)));
    }
    assemble(&header, &sections)
}

/// The same as a sparse grid, its cells all divided to the end, or every second one of the last but one not.
fn sparse_file(counts: u32, all: bool) -> Vec<u8> {
    let bricks = Bricks::new([counts; 3], 3, |level, [x, y, z]| all || level > 1 || (x / 2 + y / 2 + z / 2) % 2 == 0);
    let header = header(Kind::Sparse, [bricks.node_count() as u32, 1, 1], counts);
    assemble(&header, &[(RADIANCE, radiance(bricks.node_count())), (BRICKS, bricks.to_bytes())])
}

fn radiance(nodes: usize) -> Vec<u8> {
    let mut random = Random(1);
    let mut stored = || f16::from_f32(32_767.0 * (2.0 * random.unit() - 1.0));
    (0..nodes * VALUES).flat_map(|_| stored().to_le_bytes()).collect()
}

/// Of a cube of so many places along each side.
fn header(kind: Kind, counts: [u32; 3], places: u32) -> Header {
    Header {
        kind,
        counts,
        bands: 2,
        encoding: Encoding::F16,
        scale: (-15f32).exp2(),
        units: Units::Radiance,
        min: [0.0; 3],
        max: [f64::from(places - 1); 3],
    }
}

fn assemble(header: &Header, sections: &[([u8; 4], Vec<u8>)]) -> Vec<u8> {
    let raw = |(id, bytes): &([u8; 4], Vec<u8>)| (*id, Codec::Raw, bytes.len(), bytes.clone());
    assemble_stored(header, &sections.iter().map(raw).collect::<Vec<_>>())
}

/// From sections as they are stored, and their size once unpacked.
fn assemble_stored(header: &Header, sections: &[([u8; 4], Codec, usize, Vec<u8>)]) -> Vec<u8> {
    let entry = |(id, codec, raw_size, stored): &([u8; 4], Codec, usize, Vec<u8>)| SectionEntry {
        id: *id,
        codec: *codec,
        filter: Filter::None,
        offset: 0,
        stored_size: stored.len() as u64,
        raw_size: *raw_size as u64,
        crc32: format::crc32(stored),
    };
    let mut entries: Vec<SectionEntry> = sections.iter().map(entry).collect();
    format::place_sections(&mut entries);
    let mut bytes = format::directory_to_bytes(header, &entries);
    for (entry, (.., section)) in entries.iter().zip(sections) {
        bytes.resize(entry.offset as usize, 0);
        bytes.extend(section);
    }
    bytes
}

/// One wall across the middle of the cells' x, and half of the corners on either side.
fn walls(header: &Header, every: u32) -> Vec<u8> {
    const LOW: u8 = 0b0101_0101;
    let grid = header.grid();
    let count = header.counts[0];
    let planes: Vec<Plane> = (0..count).map(|x| Plane { normal: [1.0, 0.0, 0.0], distance: x as f32 + 0.5 }).collect();
    let cell = |cell: u32| WallCell {
        cell,
        planes: [(cell % count) as u16, WallCell::NO_PLANE, WallCell::NO_PLANE],
        masks: [LOW, !LOW, 0, 0, 0, 0, 0, 0],
        ends: 0,
    };
    let cells = (0..header.node_count() as u32).filter(|node| node % every == 0 && grid.is_cell(*node));
    walls_to_bytes(&planes, &cells.map(cell).collect::<Vec<_>>())
}

fn random_places(counts: u32) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let mut random = Random(2);
    let positions = (0..BATCHES * BATCH).map(|_| [(); 3].map(|()| random.unit() * (counts - 1) as f32));
    with_normals(positions)
}

/// A smooth curve which fills the box.
fn path(counts: u32) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let radius = 0.5 * (counts - 1) as f32;
    let positions = (0..BATCHES * BATCH).map(|i| {
        // Mean speed of the three sines together: about 1.5 radii per unit of time.
        let time = i as f64 * f64::from(STEP / (1.5 * radius));
        [1.0, 1.237, 0.871].map(|speed| radius * (1.0 + (speed * time).sin() as f32))
    });
    with_normals(positions)
}

fn with_normals(positions: impl Iterator<Item = [f32; 3]>) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let normals: Vec<[f32; 3]> = fibonacci_sphere(1021).iter().map(|n| n.to_array()).collect();
    positions.zip(normals.iter().copied().cycle()).unzip()
}

/// The numbers of a volume, node by node, and the least that can be done with them.
struct Floor {
    /// With a few zeros at the end, so that the last node can be read in whole vectors.
    halves: Vec<u16>,
    counts: u32,
}

impl Floor {
    fn new(file: &[u8]) -> Floor {
        let directory = format::parse_header_and_sections(file).expect("a volume");
        let section = directory.section_bytes(RADIANCE, &Limits::default()).expect("a volume").expect("radiance");
        let nodes = directory.header.node_count();
        let mut halves = vec![0; nodes * VALUES + 32 - VALUES];
        for (place, element) in section.as_chunks::<2>().0.iter().enumerate() {
            halves[place % nodes * VALUES + place / nodes] = u16::from_le_bytes(*element);
        }
        Floor { halves, counts: directory.header.counts[0] }
    }

    /// Where the halves of the eight nodes around a position begin, and their trilinear weights. Knows that nodes lie one
    /// metre apart, from the origin.
    #[inline(always)]
    fn locate(&self, position: [f32; 3]) -> ([usize; 8], [f32; 8]) {
        let lower = position.map(|v| (v as u32).min(self.counts - 2));
        let [x, y, z] = lower.map(|v| v as usize);
        let [u, v, w] = [0, 1, 2].map(|axis| position[axis] - lower[axis] as f32);
        let (row, layer) = (VALUES * self.counts as usize, VALUES * self.counts as usize * self.counts as usize);
        let first = x * VALUES + y * row + z * layer;
        let starts = [0, VALUES, row, row + VALUES].map(|start| first + start);
        let [a, b, c, d] = starts;
        let [p, q, r, s] = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
        let n = 1.0 - w;
        (
            [a, b, c, d, a + layer, b + layer, c + layer, d + layer],
            [p * n, q * n, r * n, s * n, p * w, q * w, r * w, s * w],
        )
    }

    #[cfg(target_arch = "x86_64")]
    fn blend(&self, places: &Places) {
        assert_processor();
        // SAFETY: the processor has what the function was compiled for.
        unsafe { self.blend_f16c(places) }
    }

    #[cfg(target_arch = "x86_64")]
    fn touch(&self, places: &Places) {
        assert_processor();
        // SAFETY: as above.
        unsafe { self.touch_avx2(places) }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma,f16c")]
    fn blend_f16c(&self, places: &Places) {
        use std::arch::x86_64::*;
        let mut total = [_mm256_setzero_ps(); 4];
        for position in places.positions {
            let (starts, weights) = self.locate(*position);
            let mut sum = [_mm256_setzero_ps(); 4];
            for (start, weight) in starts.into_iter().zip(weights) {
                let halves = &self.halves[start..start + 32];
                let weight = _mm256_set1_ps(weight);
                for (k, sum) in sum.iter_mut().enumerate() {
                    // SAFETY: reads 8 halves of the slice's 32, wherever they lie.
                    let eight = unsafe { _mm_loadu_si128(halves.as_ptr().add(8 * k).cast()) };
                    *sum = _mm256_fmadd_ps(_mm256_cvtph_ps(eight), weight, *sum);
                }
            }
            for (total, sum) in total.iter_mut().zip(sum) {
                *total = _mm256_add_ps(*total, sum);
            }
        }
        black_box(total);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn touch_avx2(&self, places: &Places) {
        let mut total = [0u16; 32];
        for position in places.positions {
            for start in self.locate(*position).0 {
                for (total, half) in total.iter_mut().zip(&self.halves[start..start + 32]) {
                    *total = total.wrapping_add(*half);
                }
            }
        }
        black_box(total);
    }

    #[cfg(not(target_arch = "x86_64"))]
    fn blend(&self, places: &Places) {
        panic!("no floor for {} places: it is written for x86-64 alone", places.positions.len());
    }

    #[cfg(not(target_arch = "x86_64"))]
    fn touch(&self, places: &Places) {
        black_box(places.positions.iter().map(|position| self.locate(*position)).last());
        black_box(&self.halves);
    }
}

#[cfg(target_arch = "x86_64")]
fn assert_processor() {
    let [avx2, fma, f16c] =
        [is_x86_feature_detected!("avx2"), is_x86_feature_detected!("fma"), is_x86_feature_detected!("f16c")];
    assert!(avx2 && fma && f16c, "the floors need AVX2, FMA and f16c");
}

/// xorshift64* of Marsaglia and Vigna.
struct Random(u64);

impl Random {
    fn bits(&mut self) -> u32 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 32) as u32
    }

    /// 0 to 1.
    fn unit(&mut self) -> f32 {
        (self.bits() >> 8) as f32 / (1 << 24) as f32
    }
}
