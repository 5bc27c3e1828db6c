//! Decodes OpenEXR through the `exr` crate's blocks, without trusting a number of the header.
//!
//! Steps: read the metadata; choose the part and the channels; cap what the header claims; read the blocks of the
//! full-resolution level, a batch at a time; decompress a batch in parallel; copy its lines; require that every
//! pixel came exactly once.

use std::collections::HashSet;
use std::fs::File;
use std::io::{BufReader, ErrorKind, Seek, SeekFrom};
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
use crate::panorama::{Image, Mapping};
use crate::{Error, Finding, Result};

/// Bytes of the largest block (some scan lines, or a tile) that is decompressed: 1 GiB. 256 lines of DWAB at
/// 16384 pixels × 4 floats are 64 MiB.
const MAX_BLOCK_BYTES: usize = 1 << 30;

/// Uncompressed bytes that are in flight at once.
const BATCH_BYTES: usize = 32 << 20;

/// A display window this many times as large as the data in it is a mistake.
const MOST_BLACK: u64 = 16;

/// Decodes the first part that has R, G and B (or only Y).
pub(super) fn decode(path: &Path, file: &File, length: u64) -> Result<Decoded> {
    guard(path, || decode_unguarded(path, file, length))
}

fn decode_unguarded(path: &Path, mut file: &File, length: u64) -> Result<Decoded> {
    let metadata =
        MetaData::read_from_buffered(BufReader::new(file), false).map_err(|e| convert_error(path, "its header", e))?;
    let (part, channels) = choose_channels(path, &metadata)?;
    check_claims(path, &metadata, part, length)?;
    let header = &metadata.headers[part];

    let mut findings = Vec::new();
    let mapping = header.own_attributes.environment_map.map(|kind| match kind {
        EnvironmentMap::LatitudeLongitude => Mapping::LatLong,
        EnvironmentMap::Cube => Mapping::CubeExr,
    });
    let mapping = mapping.or(pose::mapping(path, header)?);
    let pose: Pose = pose::read(path, header, &mut findings)?;
    let window = Window::new(path, header, mapping, &mut findings)?;
    note_chromaticities(header, &mut findings);

    let names = channels.indices.map(|index| match index {
        Some(index) => header.channels.list[index].name.to_string(),
        None => String::new(),
    });
    let half_float = std::array::from_fn(|c| {
        channels.indices[c].is_some_and(|i| header.channels.list[i].sample_type == SampleType::F16)
    });
    file.seek(SeekFrom::Start(0)).map_err(|e| Error::io(path, e))?;
    let image = read_pixels(path, file, part, &channels, &window)?;
    Ok(Decoded { image, channel_names: names, half_float, pose, mapping, findings })
}

/// Indices of R, G, B and Z in the channel list of the part; R, G and B are the same for an image of only Y.
struct Channels {
    indices: [Option<usize>; 4],
}

/// The first part with colour. Channel names are `R`, `layer.R`, in capitals or not.
fn choose_channels(path: &Path, metadata: &MetaData) -> Result<(usize, Channels)> {
    for (part, header) in metadata.headers.iter().enumerate() {
        let Some(channels) = channels_of(header) else { continue };
        if header.deep {
            return Err(Error::unsupported(
                path,
                "this is a deep EXR (many samples per pixel): flatten it before, e.g. in the compositor that wrote it",
            ));
        }
        // With chroma channels a Y is not the whole picture.
        if channels.indices[0] == channels.indices[1] && has_chroma(header) {
            break;
        }
        let subsampled = header.channels.list.iter().find(|c| c.sampling != Vec2(1, 1));
        if let Some(channel) = subsampled {
            return Err(Error::unsupported(
                path,
                format!(
                    "channel {} stores fewer samples than the image has pixels: save all channels at full resolution",
                    channel.name
                ),
            ));
        }
        return Ok((part, channels));
    }
    let found: Vec<String> =
        metadata.headers.iter().flat_map(|header| &header.channels.list).map(|c| c.name.to_string()).take(20).collect();
    if metadata.headers.iter().any(has_chroma) {
        return Err(Error::unsupported(
            path,
            "this is a luminance-chroma EXR (channels Y, RY, BY): save it again with the channels R, G and B",
        ));
    }
    Err(Error::unsupported(
        path,
        format!(
            "no channels R, G and B (alone or as layer.R, layer.G, layer.B) and no luminance Y; found {}: save the \
             panorama with R, G and B",
            if found.is_empty() { "none".into() } else { found.join(", ") }
        ),
    ))
}

fn has_chroma(header: &Header) -> bool {
    let has = |suffix: &str| header.channels.list.iter().any(|c| c.name.to_string().rsplit('.').next() == Some(suffix));
    has("RY") || has("BY")
}

fn channels_of(header: &Header) -> Option<Channels> {
    let names: Vec<String> = header.channels.list.iter().map(|c| c.name.to_string()).collect();
    let exact = |wanted: &str| names.iter().position(|name| name == wanted);
    let any_case = |wanted: &str| names.iter().position(|name| name.eq_ignore_ascii_case(wanted));
    // Without a layer first, then the layers in the order of the list.
    let layers = names.iter().filter_map(|name| name.rfind('.').map(|dot| &name[..=dot]));
    for layer in std::iter::once("").chain(layers) {
        let find = |suffix: &str| exact(&format!("{layer}{suffix}"));
        let colour = |names: [&str; 3]| {
            let [r, g, b] = names.map(find);
            Some([r?, g?, b?])
        };
        let grey = || find("Y").map(|y| [y; 3]);
        let Some([r, g, b]) = colour(["R", "G", "B"]).or_else(|| colour(["r", "g", "b"])).or_else(grey) else {
            continue;
        };
        // Z of the layer itself, of the image, or of a depth layer beside it (Blender: ViewLayer.Combined.R,
        // ViewLayer.Depth.Z).
        let above = layer.trim_end_matches('.').rfind('.').map_or("", |dot| &layer[..=dot]);
        let z = any_case(&format!("{layer}Z"))
            .or_else(|| any_case("Z"))
            .or_else(|| any_case(&format!("{above}depth.Z")))
            .or_else(|| any_case("depth.Z"));
        return Some(Channels { indices: [Some(r), Some(g), Some(b), z] });
    }
    None
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

fn note_chromaticities(header: &Header, findings: &mut Vec<Finding>) {
    let Some(c) = header.shared_attributes.chromaticities else { return };
    let found = [c.red, c.green, c.blue, c.white].map(|v| [v.x(), v.y()]);
    let rec709 = [[0.64, 0.33], [0.30, 0.60], [0.15, 0.06], [0.3127, 0.3290]];
    let differs = found.as_flattened().iter().zip(rec709.as_flattened()).any(|(a, b)| (a - b).abs() > 2e-3);
    if differs {
        findings.push(Finding::new(
            "chromaticities",
            1,
            format!("the primaries and white point are {found:?}, not Rec.709's; the numbers are used as they are"),
        ));
    }
}

fn read_pixels(path: &Path, file: &File, part: usize, channels: &Channels, window: &Window) -> Result<Image> {
    let in_pixels = |e| convert_error(path, "its pixels", e);
    let reader = ::exr::block::read(BufReader::new(file), false).map_err(|e| convert_error(path, "its header", e))?;
    let mut chunks = reader
        .filter_chunks(false, |_, _, block| block.layer == part && block.level == Vec2(0, 0))
        .map_err(|e| convert_error(path, "its table of blocks", e))?;
    let metadata = chunks.meta_data().clone();
    let header = &metadata.headers[part];
    let (width, height) = (header.layer_size.width(), header.layer_size.height());

    // Zeroed memory costs nothing until it is written: a damaged file fails before it has taken much.
    let count = window.width * window.height;
    let mut image = Image {
        width: window.width,
        height: window.height,
        pixels: vec![[0.0; 3]; count],
        distance: channels.indices[3].map(|_| vec![0.0; count]),
    };
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
        let blocks: Vec<UncompressedBlock> = compressed
            .into_par_iter()
            .map(|chunk| UncompressedBlock::decompress_chunk(chunk, &metadata, false))
            .collect::<ExrResult<_>>()
            .map_err(in_pixels)?;
        for block in &blocks {
            // A table entry may point at a block of another part or level, or twice at the same one.
            let index = block.index;
            if index.layer != part || index.level != Vec2(0, 0) || !places.insert(index.pixel_position) {
                return Err(Error::invalid(path, "its table of blocks points at a wrong block: the file is damaged"));
            }
            area += index.pixel_size.area();
            copy_lines(block, header, channels, window, &mut image);
        }
    }
    if area != width * height {
        return Err(Error::invalid(
            path,
            format!("{area} of {} pixels are in the file: it is cut off or damaged", width * height),
        ));
    }
    if let Some(distance) = &mut image.distance {
        // Nothing was seen where there is no data.
        let inside = |at: i64, size: usize| (0..size as i64).contains(&at);
        for (index, metres) in distance.iter_mut().enumerate() {
            let (x, y) = ((index % window.width) as i64, (index / window.width) as i64);
            if !(inside(x + window.x, width) && inside(y + window.y, height)) {
                *metres = f32::INFINITY;
            }
        }
    }
    Ok(image)
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
fn copy_lines(block: &UncompressedBlock, header: &Header, channels: &Channels, window: &Window, image: &mut Image) {
    for line in block.lines(&header.channels) {
        let index = line.location.channel;
        if !channels.indices.contains(&Some(index)) {
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
            for c in 0..3 {
                if channels.indices[c] == Some(index) {
                    image.pixels[at][c] = value;
                }
            }
            if channels.indices[3] == Some(index)
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
