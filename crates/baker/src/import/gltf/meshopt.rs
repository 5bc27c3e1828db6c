//! EXT_meshopt_compression (and KHR_meshopt_compression, the same with one more filter): buffer views compressed
//! with meshoptimizer's codecs.
//!
//! The decoder is meshoptimizer's own; it bears hostile bytes, but asserts on sizes, so those are checked here first.

use gltf::json;
use serde::Deserialize;

use super::document::Document;
use crate::Result;

/// The extension on a buffer view.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Compressed {
    pub buffer: usize,
    #[serde(default)]
    pub byte_offset: u64,
    pub byte_length: u64,
    pub byte_stride: u64,
    pub count: u64,
    pub mode: Mode,
    #[serde(default)]
    pub filter: Filter,
}

/// What is compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub(super) enum Mode {
    Attributes,
    Triangles,
    Indices,
}

/// What was done to attributes before compression.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub(super) enum Filter {
    #[default]
    None,
    Octahedral,
    Quaternion,
    Exponential,
    Color,
}

/// The best that the codec can do: a block of 256 vertices of 4 bytes in one control byte. A file that claims
/// more is broken, and must not make us allocate what it claims.
const MAX_RATIO: u64 = 1024;

/// The extension of `view`, if it has one, with its sizes checked.
pub(super) fn extension_of(document: &Document, view: &json::buffer::View, place: &str) -> Result<Option<Compressed>> {
    let others = view.extensions.as_ref().map(|extensions| &extensions.others);
    let Some(value) =
        others.and_then(|o| o.get("EXT_meshopt_compression").or_else(|| o.get("KHR_meshopt_compression")))
    else {
        return Ok(None);
    };
    let invalid = |message: String| document.invalid(format!("{place}: meshopt compression: {message}"));
    let compressed = Compressed::deserialize(value).map_err(|e| invalid(e.to_string()))?;
    let Compressed { byte_length, byte_stride: stride, count, mode, filter, .. } = compressed;

    let stride_is_good = match (mode, filter) {
        (Mode::Attributes, Filter::None | Filter::Exponential) => stride % 4 == 0 && (4..=256).contains(&stride),
        (Mode::Attributes, Filter::Octahedral | Filter::Color) => stride == 4 || stride == 8,
        (Mode::Attributes, Filter::Quaternion) => stride == 8,
        (Mode::Triangles | Mode::Indices, Filter::None) => stride == 2 || stride == 4,
        (Mode::Triangles | Mode::Indices, _) => {
            return Err(invalid(format!("filter {filter:?} on mode {mode:?}; only attributes have filters")));
        }
    };
    if !stride_is_good {
        return Err(invalid(format!("byteStride {stride} is not possible for mode {mode:?} with filter {filter:?}")));
    }
    if mode == Mode::Triangles && count % 3 != 0 {
        return Err(invalid(format!("count {count} of mode Triangles is not a multiple of 3")));
    }
    let size = count.checked_mul(stride).filter(|&size| size <= byte_length.saturating_mul(MAX_RATIO));
    if size.is_none_or(|size| size != view.byte_length.0) {
        return Err(invalid(format!(
            "{count} elements of {stride} bytes do not fit: the bufferView says {} bytes, and {byte_length} are \
             compressed",
            view.byte_length.0
        )));
    }
    Ok(Some(compressed))
}

/// Without the decoder.
#[cfg(not(feature = "meshopt"))]
pub(super) fn decode(document: &Document, _: &Compressed, _: &[u8], place: &str) -> Result<Vec<u8>> {
    Err(document.unsupported(format!(
        "{place}: compressed with EXT_meshopt_compression, which this build leaves out; build with feature \
         `meshopt`, or decompress the level (gltf-transform copy IN OUT)"
    )))
}

/// Decompresses a view: `count × byteStride` bytes.
#[cfg(feature = "meshopt")]
pub(super) fn decode(document: &Document, compressed: &Compressed, encoded: &[u8], place: &str) -> Result<Vec<u8>> {
    let count = usize::try_from(compressed.count).map_err(|e| document.invalid(format!("{place}: count: {e}")))?;
    let stride = compressed.byte_stride as usize;
    let decoded = match (compressed.mode, stride) {
        (Mode::Attributes, _) => decode_vertices(encoded, count, stride).map(|mut bytes| {
            unfilter(&mut bytes, stride, compressed.filter);
            bytes
        }),
        (Mode::Triangles, 2) => ::meshopt::decode_index_buffer::<u16>(encoded, count).map(|v| bytes_of_u16(&v)),
        (Mode::Triangles, _) => ::meshopt::decode_index_buffer::<u32>(encoded, count).map(|v| bytes_of_u32(&v)),
        (Mode::Indices, 2) => ::meshopt::decode_index_sequence::<u16>(encoded, count).map(|v| bytes_of_u16(&v)),
        (Mode::Indices, _) => ::meshopt::decode_index_sequence::<u32>(encoded, count).map(|v| bytes_of_u32(&v)),
    };
    decoded.map_err(|e| {
        document.invalid(format!(
            "{place}: meshopt compression: {:?} do not decode ({e}); the file is damaged",
            compressed.mode
        ))
    })
}

#[cfg(feature = "meshopt")]
fn bytes_of_u16(values: &[u16]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

#[cfg(feature = "meshopt")]
fn bytes_of_u32(values: &[u32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// The crate's decoder takes the vertex size from a type, so there is one instance per size.
#[cfg(feature = "meshopt")]
fn decode_vertices(encoded: &[u8], count: usize, stride: usize) -> ::meshopt::Result<Vec<u8>> {
    #[derive(Clone, Copy)]
    #[repr(transparent)]
    struct Vertex<const N: usize>([u8; N]);
    impl<const N: usize> Default for Vertex<N> {
        fn default() -> Self {
            Vertex([0; N])
        }
    }
    macro_rules! by_stride {
        ($($n:literal)*) => {
            match stride {
                $($n => ::meshopt::decode_vertex_buffer::<Vertex<$n>>(encoded, count)
                    .map(|vertices| vertices.iter().flat_map(|vertex| vertex.0).collect()),)*
                _ => panic!("byteStride {stride} was checked to be a multiple of 4 in 4..=256"),
            }
        };
    }
    by_stride!(4 8 12 16 20 24 28 32 36 40 44 48 52 56 60 64 68 72 76 80 84 88 92 96 100 104 108 112 116 120 124 128
        132 136 140 144 148 152 156 160 164 168 172 176 180 184 188 192 196 200 204 208 212 216 220 224 228 232 236 240
        244 248 252 256)
}

/// Undoes the filter in place.
#[cfg(feature = "meshopt")]
fn unfilter(bytes: &mut [u8], stride: usize, filter: Filter) {
    // The filters want typed elements: copy in, undo, copy out.
    macro_rules! typed {
        ($component:ty, $count:literal, $undo:path) => {{
            const SIZE: usize = size_of::<$component>();
            let mut elements: Vec<[$component; $count]> = bytes
                .chunks_exact(SIZE * $count)
                .map(|e| std::array::from_fn(|i| <$component>::from_le_bytes(std::array::from_fn(|j| e[i * SIZE + j]))))
                .collect();
            $undo(&mut elements);
            for (out, component) in bytes.chunks_exact_mut(SIZE).zip(elements.as_flattened()) {
                out.copy_from_slice(&component.to_le_bytes());
            }
        }};
    }
    use ::meshopt::{decode_filter_color, decode_filter_exp, decode_filter_oct, decode_filter_quat};
    match (filter, stride) {
        (Filter::None, _) => {}
        (Filter::Octahedral, 4) => typed!(i8, 4, decode_filter_oct),
        (Filter::Octahedral, _) => typed!(i16, 4, decode_filter_oct),
        (Filter::Quaternion, _) => typed!(i16, 4, decode_filter_quat),
        (Filter::Exponential, _) => typed!(u32, 1, decode_filter_exp),
        (Filter::Color, 4) => typed!(u8, 4, decode_filter_color),
        (Filter::Color, _) => typed!(u16, 4, decode_filter_color),
    }
}
