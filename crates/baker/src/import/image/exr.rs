//! Decodes OpenEXR through the `exr` crate's blocks, without trusting a number of the header.
//!
//! Steps: read the metadata; choose the layer ([`layers`]); cap what the header claims; read the blocks of the
//! full-resolution level, a batch at a time; decompress a batch in parallel; copy its lines; require that every
//! pixel came exactly once.

use std::collections::HashSet;
use std::io::{BufRead, Cursor, ErrorKind, Read};
use std::path::Path;

use ::exr::block::UncompressedBlock;
use ::exr::block::chunk::{Chunk, CompressedBlock};
use ::exr::block::reader::ChunksReader;
use ::exr::compression::Compression;
use ::exr::error::{Error as ExrError, Result as ExrResult};
use ::exr::math::Vec2;
use ::exr::meta::attribute::{EnvironmentMap, SampleType};
use ::exr::meta::header::Header;
use ::exr::meta::{BlockDescription, MetaData};
use half::f16;
use rayon::prelude::*;

use super::decoded::{Decoded, check_size, guard};
use super::pose::{self, Pose};
use super::{layers, space};
use crate::panorama::{Image, Mapping};
use crate::{Error, Finding, Result};

/// Bytes of the largest block (some scan lines, or a tile) that is decompressed: 1 GiB. 256 lines of DWAB at
/// 16384 pixels × 4 floats are 64 MiB.
const MAX_BLOCK_BYTES: usize = 1 << 30;

/// Uncompressed bytes that are in flight at once.
const BATCH_BYTES: usize = 32 << 20;

/// A display window this many times as large as the data in it is a mistake.
const MOST_BLACK: u64 = 16;

/// Decodes the picture: the layer that is asked for, or the one that [`layers`] takes.
pub(super) fn decode(path: &Path, file: &[u8], layer: Option<&str>) -> Result<Decoded> {
    guard(path, || decode_unguarded(path, file, layer))
}

fn decode_unguarded(path: &Path, file: &[u8], layer: Option<&str>) -> Result<Decoded> {
    let metadata = MetaData::read_from_buffered(Cursor::new(file), false).map_err(|error| {
        // A compression that the crate does not know looks to it like one that is missing.
        unknown_compression(path, file).unwrap_or_else(|| convert_error(path, "its header", error))
    })?;
    let mut findings = Vec::new();
    let channels = layers::choose(path, &metadata, layer, &mut findings)?;
    let part = channels.part;
    let beside = channels.distance.map(|(part, _)| part).filter(|beside| *beside != part);
    for part in std::iter::once(part).chain(beside) {
        check_claims(path, &metadata, part, file.len() as u64)?;
        refuse_compression(path, metadata.headers[part].compression)?;
    }
    let header = &metadata.headers[part];

    let mapping = header.own_attributes.environment_map.map(|kind| match kind {
        EnvironmentMap::LatitudeLongitude => Mapping::LatLong,
        EnvironmentMap::Cube => Mapping::CubeExr,
    });
    let mapping = mapping.or(pose::mapping(path, header)?);
    let pose: Pose = pose::read(path, header, &mut findings)?;
    let window = Window::new(path, header, mapping, &mut findings)?;
    let conversion = space::of_exr(path, &metadata.headers, part, channels.grey, &mut findings)?;

    let channel = |(part, index): (usize, usize)| &metadata.headers[part].channels.list[index];
    let [r, g, b] = channels.colour.map(|index| channel((part, index)));
    let names = [r, g, b].map(|channel| channel.name.to_string());
    let [red, green, blue] = names;
    let distance_name = channels.distance.map_or(String::new(), |place| channel(place).name.to_string());
    let half_float = [r, g, b].map(|channel| channel.sample_type == SampleType::F16);

    // Zeroed memory costs nothing until it is written: a damaged file fails before it has taken much.
    let count = window.width * window.height;
    let mut image = Image {
        width: window.width,
        height: window.height,
        pixels: vec![[0.0; 3]; count],
        distance: channels.distance.map(|_| vec![0.0; count]),
    };
    let colour = channels.colour.map(Some);
    let own = channels.distance.filter(|_| beside.is_none()).map(|(_, index)| index);
    read_pixels(path, file, part, &[colour[0], colour[1], colour[2], own], &window, &mut image)?;
    if let Some((part, index)) = channels.distance.filter(|_| beside.is_some()) {
        read_pixels(path, file, part, &[None, None, None, Some(index)], &window, &mut image)?;
    }
    Ok(Decoded {
        image,
        channel_names: [red, green, blue, distance_name],
        half_float,
        pose,
        mapping,
        conversion,
        findings,
    })
}

/// Compressions by their number in a file; the crate decodes those below 10.
const COMPRESSIONS: [(u8, &str); 4] = [(10, "HTJ2K256"), (11, "HTJ2K32"), (12, "LJ2K"), (13, "ZSTD")];

fn compression_error(path: &Path, name: &str) -> Error {
    Error::unsupported(
        path,
        format!("its pixels are compressed with {name}: save it with another compression, e.g. ZIP, PIZ or DWAA"),
    )
}

fn refuse_compression(path: &Path, compression: Compression) -> Result<()> {
    match compression {
        Compression::HTJ2K256 => Err(compression_error(path, "HTJ2K256")),
        Compression::HTJ2K32 => Err(compression_error(path, "HTJ2K32")),
        _ => Ok(()),
    }
}

/// Bytes of the longest header that is searched.
const MAX_HEADER_BYTES: u64 = 16 << 20;

/// The refusal of a compression that the crate does not know, from any part of a header that it could not read.
fn unknown_compression(path: &Path, file: &[u8]) -> Option<Error> {
    // Behind the magic number and the version.
    let mut reader = file.get(8..)?.take(MAX_HEADER_BYTES);
    let text = |reader: &mut std::io::Take<&[u8]>| -> Option<Vec<u8>> {
        let mut text = Vec::new();
        reader.take(256).read_until(0, &mut text).ok()?;
        (text.pop() == Some(0)).then_some(text)
    };
    // The attributes of all parts: name, type, size, value; an empty name ends a part, two of them the header.
    let mut ended = false;
    loop {
        let name = text(&mut reader)?;
        if name.is_empty() {
            if ended {
                return None;
            }
            ended = true;
            continue;
        }
        ended = false;
        let kind = text(&mut reader)?;
        let mut size = [0; 4];
        reader.read_exact(&mut size).ok()?;
        let size = u32::from_le_bytes(size);
        if name == b"compression" && kind == b"compression" && size == 1 {
            let mut number = [0];
            reader.read_exact(&mut number).ok()?;
            let [number] = number;
            if number > 9 {
                let known = COMPRESSIONS.iter().find(|(known, _)| *known == number);
                let name = known.map_or(format!("an unknown method, number {number}"), |(_, name)| (*name).into());
                return Some(compression_error(path, &name));
            }
        } else {
            std::io::copy(&mut (&mut reader).take(size.into()), &mut std::io::sink()).ok()?;
        }
    }
}

/// Refuses what the header claims if the file cannot hold it, or if memory should not.
fn check_claims(path: &Path, metadata: &MetaData, part: usize, length: u64) -> Result<()> {
    let header = &metadata.headers[part];
    check_size(path, header.layer_size.width(), header.layer_size.height())?;
    // Every block of every part has an entry of 8 bytes in a table, and at least 8 bytes of its own.
    let blocks = metadata.headers.iter().try_fold(0u64, |sum, h| sum.checked_add(h.chunk_count as u64));
    if blocks.and_then(|blocks| blocks.checked_mul(16)).is_none_or(|bytes| bytes > length) {
        return Err(Error::invalid(
            path,
            format!(
                "the header claims {} x {} pixels, whose blocks do not fit into the file's {length} bytes: the file \
                 is cut off or damaged",
                header.layer_size.width(),
                header.layer_size.height()
            ),
        ));
    }
    for header in &metadata.headers {
        let pixels = match header.blocks {
            BlockDescription::ScanLines => {
                header.compression.scan_lines_per_block().checked_mul(header.layer_size.width())
            }
            BlockDescription::Tiles(tiles) => tiles.tile_size.width().checked_mul(tiles.tile_size.height()),
        };
        let bytes = pixels.and_then(|pixels| pixels.checked_mul(header.channels.bytes_per_pixel));
        if bytes.is_none_or(|bytes| bytes > MAX_BLOCK_BYTES) {
            return Err(Error::unsupported(
                path,
                format!(
                    "one block of the image claims more than {MAX_BLOCK_BYTES} bytes: save it with smaller tiles or \
                     fewer channels, or check whether the file is damaged"
                ),
            ));
        }
    }
    Ok(())
}

/// Which part of the data window is the panorama, and where in it.
struct Window {
    width: usize,
    height: usize,
    /// Position of the panorama's upper left pixel in the data window; negative where there is no data.
    x: i64,
    y: i64,
}

impl Window {
    /// OpenEXR defines its environment maps over the data window. Any other image is what its display window
    /// frames: data beyond it is cropped, and without data it is black. One that frames next to nothing is ignored.
    fn new(path: &Path, header: &Header, mapping: Option<Mapping>, findings: &mut Vec<Finding>) -> Result<Self> {
        let (data, display) = (header.data_window(), header.shared_attributes.display_window);
        if mapping.is_some() || data == display {
            return Ok(Window { width: data.size.width(), height: data.size.height(), x: 0, y: 0 });
        }
        let (width, height) = (display.size.width(), display.size.height());
        let x = i64::from(display.position.x()) - i64::from(data.position.x());
        let y = i64::from(display.position.y()) - i64::from(data.position.y());
        let overlap = |at: i64, size: usize, data: usize| (at + size as i64).min(data as i64) - at.max(0);
        let columns = overlap(x, width, data.size.width());
        let rows = overlap(y, height, data.size.height());
        let place = format!(
            "the display window is {width} x {height} pixels at ({}, {}), the data window {} x {} at ({}, {})",
            display.position.x(),
            display.position.y(),
            data.size.width(),
            data.size.height(),
            data.position.x(),
            data.position.y()
        );
        let all = (width as u64).saturating_mul(height as u64);
        let covered = columns.max(0) as u64 * rows.max(0) as u64;
        // A damaged display window may ask for gigabytes of black; and such a panorama would light nothing.
        if covered * MOST_BLACK < all {
            let message = format!("{place}, so that it frames next to nothing: the data window was read");
            findings.push(Finding::new("display-window", all - covered, message));
            return Ok(Window { width: data.size.width(), height: data.size.height(), x: 0, y: 0 });
        }
        let missing = all - covered;
        check_size(path, width, height)?;
        findings.push(Finding::new(
            "display-window",
            missing,
            format!("{place}: the display window was read, {missing} of its pixels have no data and are black"),
        ));
        Ok(Window { width, height, x, y })
    }
}

/// Reads channels of one part into the image: R, G, B and the distance, as far as they are in this part.
fn read_pixels(
    path: &Path,
    file: &[u8],
    part: usize,
    channels: &[Option<usize>; 4],
    window: &Window,
    image: &mut Image,
) -> Result<()> {
    let in_pixels = |e| convert_error(path, "its pixels", e);
    let reader = ::exr::block::read(Cursor::new(file), false).map_err(|e| convert_error(path, "its header", e))?;
    let mut chunks = reader
        .filter_chunks(false, |_, _, block| block.layer == part && block.level == Vec2(0, 0))
        .map_err(|e| convert_error(path, "its table of blocks", e))?;
    let metadata = chunks.meta_data().clone();
    let header = &metadata.headers[part];
    let (width, height) = (header.layer_size.width(), header.layer_size.height());

    let mut places = HashSet::new();
    let mut area = 0;
    let batch = (BATCH_BYTES / header.max_block_byte_size().max(1)).clamp(1, 1024);
    loop {
        let compressed = chunks.by_ref().take(batch).collect::<ExrResult<Vec<_>>>().map_err(in_pixels)?;
        if compressed.is_empty() {
            break;
        }
        for chunk in &compressed {
            check_dwa_counters(path, &metadata.headers[part], chunk)?;
        }
        // Of several damaged blocks the first one is named, whichever thread was first.
        let blocks: Vec<ExrResult<UncompressedBlock>> = compressed
            .into_par_iter()
            .map(|chunk| UncompressedBlock::decompress_chunk(chunk, &metadata, false))
            .collect();
        let blocks = blocks.into_iter().collect::<ExrResult<Vec<_>>>().map_err(in_pixels)?;
        for block in &blocks {
            // A table entry may point at a block of another part or level, or twice at the same one.
            let index = block.index;
            if index.layer != part || index.level != Vec2(0, 0) || !places.insert(index.pixel_position) {
                return Err(Error::invalid(path, "its table of blocks points at a wrong block: the file is damaged"));
            }
            area += index.pixel_size.area();
            copy_lines(block, header, channels, window, image);
        }
    }
    if area != width * height {
        return Err(Error::invalid(
            path,
            format!("{area} of {} pixels are in the file: it is cut off or damaged", width * height),
        ));
    }
    if channels[3].is_some()
        && let Some(distance) = &mut image.distance
    {
        // Nothing was seen where there is no data.
        let inside = |at: i64, size: usize| (0..size as i64).contains(&at);
        for (index, metres) in distance.iter_mut().enumerate() {
            let (x, y) = ((index % window.width) as i64, (index / window.width) as i64);
            if !(inside(x + window.x, width) && inside(y + window.y, height)) {
                *metres = f32::INFINITY;
            }
        }
    }
    Ok(())
}

/// The `exr` crate (1.74.2) takes as much memory as the eleven counters in front of a DWA block ask for, and more
/// than there is ends the program: no panic that could be caught. Found by mutating a file; so they are checked here.
fn check_dwa_counters(path: &Path, header: &Header, chunk: &Chunk) -> Result<()> {
    if !matches!(header.compression, Compression::DWAA(_) | Compression::DWAB(_)) {
        return Ok(());
    }
    let bytes = match &chunk.compressed_block {
        CompressedBlock::ScanLine(block) => &block.compressed_pixels_le,
        CompressedBlock::Tile(block) => &block.compressed_pixels_le,
        _ => return Ok(()),
    };
    let place = header.get_block_data_indices(&chunk.compressed_block);
    let Ok(place) = place.and_then(|tile| header.get_absolute_block_pixel_coordinates(tile)) else {
        return Ok(()); // the decoder will say so
    };
    // A block that is not compressed has no counters, only samples.
    if bytes.len() == place.size.area() * header.channels.bytes_per_pixel {
        return Ok(());
    }
    // The counters of what the sections hold once decompressed, and how many bytes one counts. All samples of a
    // block padded to 8 × 8 as 32-bit numbers are a bound for each; run-length codes may be twice that.
    let padded = |n: usize| n as u64 / 8 * 8 + 8;
    let most = padded(place.size.width()) * padded(place.size.height()) * header.channels.list.len() as u64 * 4;
    let (raw, _) = bytes.as_chunks::<8>();
    let (unknown, run_length_codes, run_length, ac, dc) = (1, 6, 7, 8, 9);
    for (counter, unit) in [(unknown, 2), (run_length_codes, 1), (run_length, 2), (ac, 4), (dc, 4)] {
        let Some(claimed) = raw.get(counter).map(|bytes| u64::from_le_bytes(*bytes)) else {
            break; // too short: the decoder will say so
        };
        if claimed.checked_mul(unit).is_none_or(|claimed| claimed > 2 * most) {
            return Err(Error::invalid(
                path,
                format!(
                    "a DWA block claims to hold {claimed} values, more than it has pixels for: the file is damaged"
                ),
            ));
        }
    }
    Ok(())
}

/// Copies the lines of one block that lie in the window.
fn copy_lines(
    block: &UncompressedBlock,
    header: &Header,
    channels: &[Option<usize>; 4],
    window: &Window,
    image: &mut Image,
) {
    for line in block.lines(&header.channels) {
        let index = line.location.channel;
        if !channels.contains(&Some(index)) {
            continue;
        }
        let y = line.location.position.y() as i64 - window.y;
        if !(0..window.height as i64).contains(&y) {
            continue;
        }
        let samples = samples_of(line.value, header.channels.list[index].sample_type);
        for (i, value) in samples.enumerate() {
            let x = (line.location.position.x() + i) as i64 - window.x;
            if !(0..window.width as i64).contains(&x) {
                continue;
            }
            let at = y as usize * window.width + x as usize;
            for (sample, channel) in image.pixels[at].iter_mut().zip(channels) {
                if *channel == Some(index) {
                    *sample = value;
                }
            }
            if channels[3] == Some(index)
                && let Some(distance) = &mut image.distance
            {
                distance[at] = value;
            }
        }
    }
}

/// The samples of a line as floats; the crate hands them over in the machine's byte order.
fn samples_of(bytes: &[u8], kind: SampleType) -> impl Iterator<Item = f32> {
    bytes.chunks_exact(kind.bytes_per_sample()).map(move |b| match kind {
        SampleType::F16 => f16::from_ne_bytes([b[0], b[1]]).to_f32(),
        SampleType::F32 => f32::from_ne_bytes([b[0], b[1], b[2], b[3]]),
        SampleType::U32 => u32::from_ne_bytes([b[0], b[1], b[2], b[3]]) as f32,
    })
}

/// An error of the `exr` crate as ours; `place`: the part of the file that was being read.
pub(super) fn convert_error(path: &Path, place: &str, error: ExrError) -> Error {
    match error {
        ExrError::NotSupported(what) => {
            Error::unsupported(path, format!("{place}: {what}; save it as a plain RGB EXR, e.g. with ZIP compression"))
        }
        ExrError::Invalid(what) => Error::invalid(path, format!("{place}: {what}: the file is damaged or cut off")),
        // An offset beyond what any file has: the system refuses to seek there.
        ExrError::Io(source) if source.kind() == ErrorKind::InvalidInput => {
            Error::invalid(path, format!("{place}: a block is said to be beyond all files: the file is damaged"))
        }
        ExrError::Io(source) => Error::io(path, source),
        ExrError::Aborted => Error::invalid(path, format!("{place}: reading was aborted")),
    }
}
