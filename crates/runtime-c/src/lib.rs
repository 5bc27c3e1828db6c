//! The C interface of [`gdibl_runtime`], and, built for wasm32, that of its WebAssembly module.
//!
//! `include/gdibl.h` is written from this file by cbindgen (`tests/header.rs`), so documentation here is C's, too: it
//! speaks of NULL and of arrays. Units, ownership, threads, errors are on the header's first screen.
//!
//! What each pointer must be is said at each function; NULL is refused everywhere. Results are written through the
//! pointer and never borrowed, so that arrays of a caller may overlap and need not be initialised. A panic would be
//! caught in `guarded`; on wasm32 it is a trap, which JavaScript sees as an exception.
#![cfg_attr(target_arch = "wasm32", no_std)]
#![allow(rustdoc::broken_intra_doc_links, reason = "annotations for cbindgen look like links")]

extern crate alloc;

#[cfg(target_arch = "wasm32")]
mod wasm;

use alloc::boxed::Box;
use core::ffi::c_char;
use core::slice;
use gdibl_runtime::sh::{MAX_BANDS, MAX_COEFFICIENTS};
use gdibl_runtime::volume::VertexSet;
use gdibl_runtime::{Error, Kind, RadianceSh, Sample, Volume, VolumeSet};

/// Most spherical harmonics coefficients of a volume: those of bands 0 to 4.
pub const GDIBL_MAX_COEFFICIENTS: usize = 25;

const _: () = assert!(GDIBL_MAX_COEFFICIENTS == MAX_COEFFICIENTS);

/// A parsed file. Only ever behind a pointer that gdibl_parse made.
pub struct GdiblVolume(Volume);

/// Several volumes of a level. Only ever behind a pointer that gdibl_set made.
pub struct GdiblSet(VolumeSet);

// Any number of threads may ask one volume, and any may free it.
const _: () = {
    const fn is_shared<T: Send + Sync>() {}
    is_shared::<GdiblVolume>();
    is_shared::<GdiblSet>();
};

/// How a call went.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GdiblStatus {
    /// Well.
    Ok = 0,
    /// The file may be whole, but this library does not know what it uses: a newer version, another encoding, a codec
    /// that was left out of this build.
    Unsupported = 1,
    /// The file is damaged, or was never a volume.
    Invalid = 2,
    /// A pointer is NULL that must not be.
    NullPointer = 3,
    /// A number is too large: a node that the volume does not have, bands above 4. Or it makes no sense, see gdibl_set.
    OutOfRange = 4,
    /// A mistake of this library: please report it.
    Internal = 5,
}

/// What the nodes of a volume are.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GdiblKind {
    /// A regular grid; light between the nodes is interpolated.
    Grid = 0,
    /// Listed points; the nearest one answers.
    Points = 1,
    /// Mesh vertices; the nearest one answers, among those at one place the one whose normal fits best.
    Vertices = 2,
    /// Some places of a fine grid, fewer where light is even; interpolated as in a grid.
    Sparse = 3,
}

/// The fixed part of a file.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GdiblHeader {
    /// What the nodes are.
    pub kind: GdiblKind,
    /// Grid: nodes per axis, the first on min and the last on max; x runs fastest, then y, then z. Otherwise: how
    /// many, 1, 1.
    pub counts: [u32; 3],
    /// The highest band of spherical harmonics, 0 to 4: (bands + 1)^2 coefficients.
    pub bands: u32,
    /// Nodes that would ring have been windowed: irradiance is nowhere negative.
    pub is_deringed: bool,
    /// The box's lowest corner, metres.
    pub min: [f64; 3],
    /// The box's highest corner, metres.
    pub max: [f64; 3],
}

/// Which nodes are the vertices of which part of the level.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GdiblVertexSet {
    /// Index of the glTF node.
    pub node: u32,
    /// Index of the glTF mesh.
    pub mesh: u32,
    /// Index of the primitive in the mesh.
    pub primitive: u32,
    /// The first of its nodes in the volume; the others follow in the order of the primitive's vertices.
    pub first: u32,
    /// How many there are.
    pub count: u32,
}

/// Light at a position, or at a node.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GdiblSample {
    /// The highest band, 0 to 4.
    pub bands: u32,
    /// Radiance (not irradiance: gdibl_evaluate convolves) in spherical harmonics: red, green, blue of coefficient
    /// l(l+1)+m; 0 above bands. Orthonormal real basis without the Condon-Shortley sign: 1, y, z, x, xy, yz, 3zz-1, xz,
    /// xx-yy, then bands 3 and 4.
    pub radiance: [[f32; 3]; GDIBL_MAX_COEFFICIENTS],
    /// The share of this that was baked rather than filled from neighbours, 0 to 1.
    pub validity: f32,
    /// Whether the position is in the volume's box; otherwise this is the light at the nearest position in it.
    pub inside: bool,
}

/// Reads a file, given all of its bytes, and checks all of it.
///
/// On success *volume is to be given to gdibl_free once. Otherwise *volume is NULL, and message says where in the file
/// what was found and what was expected: at most message_size bytes of UTF-8 with the final 0, cut off where it is
/// longer; 256 are enough. On success it is empty. message may be NULL.
///
/// # Safety
/// `bytes` is NULL or has `byte_count` bytes; `volume` is NULL or can be written; `message` is NULL or has
/// `message_size` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_parse(
    bytes: *const u8,
    byte_count: usize,
    volume: *mut *mut GdiblVolume,
    message: *mut c_char,
    message_size: usize,
) -> GdiblStatus {
    let mut found = None;
    let status = guarded(|| {
        // SAFETY: `volume` is NULL, which is refused, or can be written.
        unsafe { write(volume, core::ptr::null_mut())? };
        // No bytes at all are an empty file, which is invalid, wherever they are.
        let bytes = match byte_count {
            0 => &[],
            _ if bytes.is_null() => return Err(GdiblStatus::NullPointer),
            // SAFETY: not NULL, so there are `byte_count` bytes, which nobody changes during the call.
            _ => unsafe { slice::from_raw_parts(bytes, byte_count) },
        };
        let parsed = Volume::parse(bytes).map_err(|error| {
            let status = match error {
                Error::Unsupported(_) => GdiblStatus::Unsupported,
                Error::Invalid(_) => GdiblStatus::Invalid,
            };
            found = Some(error);
            status
        })?;
        // SAFETY: as above.
        unsafe { write(volume, Box::into_raw(Box::new(GdiblVolume(parsed)))) }
    });
    let parts = match (&found, status) {
        (Some(error), _) => &error.parts()[..],
        (None, GdiblStatus::NullPointer) => &["a pointer is NULL that must not be"],
        (None, GdiblStatus::Internal) => &["a mistake of this library: please report it"],
        (None, _) => &[],
    };
    // SAFETY: `message` is NULL, to which nothing is written, or has `message_size` bytes.
    unsafe { write_message(parts, message.cast(), message_size) };
    status
}

/// Ends a volume, which must not be used afterwards. NULL is fine.
///
/// # Safety
/// `volume` is NULL or came from `gdibl_parse`, was not freed yet, and nobody else uses it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_free(volume: *mut GdiblVolume) {
    if !volume.is_null() {
        // SAFETY: `gdibl_parse` made it with `Box::into_raw`, and this is the one time that it is turned back.
        drop(unsafe { Box::from_raw(volume) });
    }
}

/// The fixed part of the file.
///
/// # Safety
/// `volume` is NULL or alive; `header` is NULL or can be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_header(volume: *const GdiblVolume, header: *mut GdiblHeader) -> GdiblStatus {
    guarded(|| {
        // SAFETY: `volume` is NULL, which is refused, or alive.
        let found = unsafe { volume_at(volume)? }.header();
        let found = GdiblHeader {
            kind: match found.kind {
                Kind::Grid => GdiblKind::Grid,
                Kind::Points => GdiblKind::Points,
                Kind::Vertices => GdiblKind::Vertices,
                Kind::Sparse => GdiblKind::Sparse,
            },
            counts: found.counts,
            bands: found.bands,
            is_deringed: found.is_deringed(),
            min: found.min,
            max: found.max,
        };
        // SAFETY: `header` is NULL, which is refused, or can be written.
        unsafe { write(header, found) }
    })
}

/// How many nodes there are, at least 1; 0 for NULL.
///
/// # Safety
/// `volume` is NULL or alive.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_node_count(volume: *const GdiblVolume) -> usize {
    // SAFETY: `volume` is NULL, which has no nodes, or alive.
    unsafe { volume_at(volume) }.map_or(0, Volume::node_count)
}

/// Node number node, from 0: where it is, metres, and what is stored there. For engines that upload a volume.
///
/// # Safety
/// `volume` is NULL or alive; `position` is NULL or has three numbers; `sample` is NULL or can be written.
///
/// cbindgen:ptrs-as-arrays=[[position;3]]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_node(
    volume: *const GdiblVolume,
    node: usize,
    position: *mut f64,
    sample: *mut GdiblSample,
) -> GdiblStatus {
    guarded(|| {
        // SAFETY: `volume` is NULL, which is refused, or alive.
        let volume = unsafe { volume_at(volume)? };
        if node >= volume.node_count() {
            return Err(GdiblStatus::OutOfRange);
        }
        if position.is_null() || sample.is_null() {
            return Err(GdiblStatus::NullPointer);
        }
        let validity = if volume.is_valid(node) { 1.0 } else { 0.0 };
        let found = Sample { sh: volume.node_sh(node), validity, inside: true };
        // SAFETY: neither is NULL, so the first has three numbers and the second can be written.
        unsafe {
            write(position.cast(), volume.node_position(node))?;
            write(sample, sample_for_c(&found))
        }
    })
}

/// How many vertex sets there are; 0 for NULL, and unless the volume holds vertices.
///
/// # Safety
/// `volume` is NULL or alive.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_vertex_set_count(volume: *const GdiblVolume) -> usize {
    // SAFETY: `volume` is NULL, which has no vertex sets, or alive.
    unsafe { volume_at(volume) }.map_or(0, |volume| volume.vertex_sets().len())
}

/// Vertex set number index, from 0, in order of glTF node, mesh and primitive. For engines that give the vertices of a mesh
/// their light.
///
/// # Safety
/// `volume` is NULL or alive; `set` is NULL or can be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_vertex_set(
    volume: *const GdiblVolume,
    index: usize,
    set: *mut GdiblVertexSet,
) -> GdiblStatus {
    guarded(|| {
        // SAFETY: `volume` is NULL, which is refused, or alive.
        let sets = unsafe { volume_at(volume)? }.vertex_sets();
        let &VertexSet { node, mesh, primitive, first, count } = sets.get(index).ok_or(GdiblStatus::OutOfRange)?;
        // SAFETY: `set` is NULL, which is refused, or can be written.
        unsafe { write(set, GdiblVertexSet { node, mesh, primitive, first, count }) }
    })
}

/// Irradiance on a surface at a position in metres with a unit normal: diffuse = albedo / pi * irradiance. Not clamped.
///
/// # Safety
/// `volume` is NULL or alive; the others are NULL or have three numbers. They may overlap.
///
/// cbindgen:ptrs-as-arrays=[[position;3],[normal;3],[irradiance;3]]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_irradiance(
    volume: *const GdiblVolume,
    position: *const f32,
    normal: *const f32,
    irradiance: *mut f32,
) -> GdiblStatus {
    guarded(|| {
        // SAFETY: each is NULL, which is refused, or alive, or has three numbers.
        unsafe {
            let found = volume_at(volume)?.irradiance(three(position)?, three(normal)?);
            write(irradiance.cast(), found)
        }
    })
}

/// The same for levels far from the origin, where a float is too coarse for a position.
///
/// # Safety
/// As for `gdibl_irradiance`.
///
/// cbindgen:ptrs-as-arrays=[[position;3],[normal;3],[irradiance;3]]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_irradiance_f64(
    volume: *const GdiblVolume,
    position: *const f64,
    normal: *const f32,
    irradiance: *mut f32,
) -> GdiblStatus {
    guarded(|| {
        // SAFETY: each is NULL, which is refused, or alive, or has three numbers.
        unsafe {
            let found = volume_at(volume)?.irradiance_f64(three(position)?, three(normal)?);
            write(irradiance.cast(), found)
        }
    })
}

/// Places that are copied together.
const PIECE: usize = 256;

/// Irradiance at count positions with as many normals, x y z after x y z, into count times red green blue. The result may
/// be the array of positions or that of normals. Arrays of a count of 0 may be NULL. The same numbers as one call each, in less
/// time, and fastest where places in one cell of the volume follow each other.
///
/// # Safety
/// `volume` is NULL or alive; the others are NULL or have `3 * count` numbers. They are the same or do not overlap.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_irradiance_batch(
    volume: *const GdiblVolume,
    count: usize,
    positions: *const f32,
    normals: *const f32,
    irradiance: *mut f32,
) -> GdiblStatus {
    guarded(|| {
        // SAFETY: `volume` is NULL, which is refused, or alive.
        let volume = unsafe { volume_at(volume)? };
        // SAFETY: the caller's promise.
        unsafe { in_pieces(count, positions, normals, irradiance, |p, n, e| volume.irradiance_batch(p, n, e)) }
    })
}

/// Asks `answer` for irradiance at `count` places, a piece at a time: copied, since the arrays may be the same.
///
/// # Safety
/// Each is NULL or has `3 * count` numbers. They are the same or do not overlap.
unsafe fn in_pieces(
    count: usize,
    positions: *const f32,
    normals: *const f32,
    irradiance: *mut f32,
    answer: impl Fn(&[[f32; 3]], &[[f32; 3]], &mut [[f32; 3]]),
) -> Result<(), GdiblStatus> {
    if count > 0 && (positions.is_null() || normals.is_null() || irradiance.is_null()) {
        return Err(GdiblStatus::NullPointer);
    }
    let (mut some_positions, mut some_normals, mut found) = ([[0.0; 3]; PIECE], [[0.0; 3]; PIECE], [[0.0; 3]; PIECE]);
    for first in (0..count).step_by(PIECE) {
        let piece = PIECE.min(count - first);
        for k in 0..piece {
            // SAFETY: no array is NULL, so each has `3 * count` numbers, of which `first + k` is not the end.
            unsafe {
                some_positions[k] = three(positions.add(3 * (first + k)))?;
                some_normals[k] = three(normals.add(3 * (first + k)))?;
            }
        }
        answer(&some_positions[..piece], &some_normals[..piece], &mut found[..piece]);
        for (k, found) in found[..piece].iter().enumerate() {
            // SAFETY: as above. What was written before belongs to smaller indices.
            unsafe { write(irradiance.add(3 * (first + k)).cast(), *found)? };
        }
    }
    Ok(())
}

/// Light from all around at a position in metres: gdibl_evaluate turns it into irradiance for any number of normals. The
/// unit normal picks between vertices at one place, and between the two sides of a wall.
///
/// # Safety
/// `volume` is NULL or alive; `position` and `normal` are NULL or have three numbers; `sample` is NULL or can be written.
///
/// cbindgen:ptrs-as-arrays=[[position;3],[normal;3]]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_sample(
    volume: *const GdiblVolume,
    position: *const f32,
    normal: *const f32,
    sample: *mut GdiblSample,
) -> GdiblStatus {
    guarded(|| {
        // SAFETY: each is NULL, which is refused, or alive, or has three numbers, or can be written.
        unsafe {
            let found = volume_at(volume)?.sample(three(position)?, three(normal)?);
            write(sample, sample_for_c(&found))
        }
    })
}

/// The same for levels far from the origin.
///
/// # Safety
/// As for `gdibl_sample`.
///
/// cbindgen:ptrs-as-arrays=[[position;3],[normal;3]]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_sample_f64(
    volume: *const GdiblVolume,
    position: *const f64,
    normal: *const f32,
    sample: *mut GdiblSample,
) -> GdiblStatus {
    guarded(|| {
        // SAFETY: each is NULL, which is refused, or alive, or has three numbers, or can be written.
        unsafe {
            let found = volume_at(volume)?.sample_f64(three(position)?, three(normal)?);
            write(sample, sample_for_c(&found))
        }
    })
}

/// Irradiance on a surface with a unit normal in the light of a sample.
///
/// # Safety
/// `sample` is NULL or was written by this library; the others are NULL or have three numbers.
///
/// cbindgen:ptrs-as-arrays=[[normal;3],[irradiance;3]]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_evaluate(
    sample: *const GdiblSample,
    normal: *const f32,
    irradiance: *mut f32,
) -> GdiblStatus {
    guarded(|| {
        if sample.is_null() {
            return Err(GdiblStatus::NullPointer);
        }
        // SAFETY: not NULL, so it is a sample. Only its numbers are read, of which all bits are some value.
        let (bands, coefficients) = unsafe { ((*sample).bands, (*sample).radiance) };
        if bands > MAX_BANDS {
            return Err(GdiblStatus::OutOfRange);
        }
        let light = RadianceSh { bands, coefficients }.convolve();
        // SAFETY: each is NULL, which is refused, or has three numbers.
        unsafe { write(irradiance.cast(), light.evaluate(three(normal)?)) }
    })
}

/// Puts count volumes of a level together, in the order of its list (FORMAT.md, *Several volumes of a level*), each with
/// its spacing of there, metres: an earlier one wins over a later one.
///
/// On success *set is to be given to gdibl_set_free once, and the volumes are its own: nobody may use or free them any
/// more. Otherwise *set is NULL, and the volumes stay the caller's. Only grids can be in a set (else
/// GDIBL_STATUS_INVALID), there is at least one, each is given once, and spacings are numbers over 0 (else
/// GDIBL_STATUS_OUT_OF_RANGE).
///
/// # Safety
/// `volumes` is NULL or has `count` pointers from `gdibl_parse`, which nobody else uses; `spacings` is NULL or has
/// `count` numbers; `set` is NULL or can be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_set(
    volumes: *const *mut GdiblVolume,
    spacings: *const f64,
    count: usize,
    set: *mut *mut GdiblSet,
) -> GdiblStatus {
    guarded(|| {
        // SAFETY: `set` is NULL, which is refused, or can be written.
        unsafe { write(set, core::ptr::null_mut())? };
        if count == 0 {
            return Err(GdiblStatus::OutOfRange);
        }
        if volumes.is_null() || spacings.is_null() {
            return Err(GdiblStatus::NullPointer);
        }
        // SAFETY: neither is NULL, so there are `count` of each, which nobody changes during the call.
        let (volumes, spacings) =
            unsafe { (slice::from_raw_parts(volumes, count), slice::from_raw_parts(spacings, count)) };
        // All is checked before any volume is taken.
        for (index, (&volume, &spacing)) in volumes.iter().zip(spacings).enumerate() {
            // SAFETY: NULL, which is refused, or alive.
            let kind = unsafe { volume_at(volume)? }.header().kind;
            if !matches!(kind, Kind::Grid | Kind::Sparse) {
                return Err(GdiblStatus::Invalid);
            }
            if !(spacing > 0.0 && spacing.is_finite()) || volumes[..index].contains(&volume) {
                return Err(GdiblStatus::OutOfRange);
            }
        }
        // SAFETY: `gdibl_parse` made each with `Box::into_raw`, and this is the one time that it is turned back.
        let taken = volumes.iter().map(|&volume| unsafe { Box::from_raw(volume) }.0);
        let found = VolumeSet::new(taken.zip(spacings.iter().copied())).map_err(|_| GdiblStatus::Internal)?;
        // SAFETY: as above.
        unsafe { write(set, Box::into_raw(Box::new(GdiblSet(found)))) }
    })
}

/// Ends a set and its volumes, which must not be used afterwards. NULL is fine.
///
/// # Safety
/// `set` is NULL or came from `gdibl_set`, was not freed yet, and nobody else uses it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_set_free(set: *mut GdiblSet) {
    if !set.is_null() {
        // SAFETY: `gdibl_set` made it with `Box::into_raw`, and this is the one time that it is turned back.
        drop(unsafe { Box::from_raw(set) });
    }
}

/// As gdibl_irradiance, of a set.
///
/// # Safety
/// `set` is NULL or alive; the others are NULL or have three numbers. They may overlap.
///
/// cbindgen:ptrs-as-arrays=[[position;3],[normal;3],[irradiance;3]]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_set_irradiance(
    set: *const GdiblSet,
    position: *const f32,
    normal: *const f32,
    irradiance: *mut f32,
) -> GdiblStatus {
    guarded(|| {
        // SAFETY: each is NULL, which is refused, or alive, or has three numbers.
        unsafe {
            let found = set_at(set)?.irradiance(three(position)?, three(normal)?);
            write(irradiance.cast(), found)
        }
    })
}

/// The same for levels far from the origin.
///
/// # Safety
/// As for `gdibl_set_irradiance`.
///
/// cbindgen:ptrs-as-arrays=[[position;3],[normal;3],[irradiance;3]]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_set_irradiance_f64(
    set: *const GdiblSet,
    position: *const f64,
    normal: *const f32,
    irradiance: *mut f32,
) -> GdiblStatus {
    guarded(|| {
        // SAFETY: each is NULL, which is refused, or alive, or has three numbers.
        unsafe {
            let found = set_at(set)?.irradiance_f64(three(position)?, three(normal)?);
            write(irradiance.cast(), found)
        }
    })
}

/// As gdibl_irradiance_batch, of a set.
///
/// # Safety
/// `set` is NULL or alive; the others are NULL or have `3 * count` numbers. They are the same or do not overlap.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_set_irradiance_batch(
    set: *const GdiblSet,
    count: usize,
    positions: *const f32,
    normals: *const f32,
    irradiance: *mut f32,
) -> GdiblStatus {
    guarded(|| {
        // SAFETY: `set` is NULL, which is refused, or alive.
        let set = unsafe { set_at(set)? };
        // SAFETY: the caller's promise.
        unsafe { in_pieces(count, positions, normals, irradiance, |p, n, e| set.irradiance_batch(p, n, e)) }
    })
}

/// As gdibl_sample_f64, of a set. Its bands are those of the volume that has most, of those that count at the position.
///
/// # Safety
/// `set` is NULL or alive; `position` and `normal` are NULL or have three numbers; `sample` is NULL or can be written.
///
/// cbindgen:ptrs-as-arrays=[[position;3],[normal;3]]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_set_sample_f64(
    set: *const GdiblSet,
    position: *const f64,
    normal: *const f32,
    sample: *mut GdiblSample,
) -> GdiblStatus {
    guarded(|| {
        // SAFETY: each is NULL, which is refused, or alive, or has three numbers, or can be written.
        unsafe {
            let found = set_at(set)?.sample_f64(three(position)?, three(normal)?);
            write(sample, sample_for_c(&found))
        }
    })
}

fn sample_for_c(sample: &Sample) -> GdiblSample {
    let Sample { sh, validity, inside } = *sample;
    GdiblSample { bands: sh.bands, radiance: sh.coefficients, validity, inside }
}

/// How `work` went. Its panic ends here.
#[cfg(not(target_arch = "wasm32"))]
#[inline]
fn guarded(work: impl FnOnce() -> Result<(), GdiblStatus>) -> GdiblStatus {
    // Volumes do not change, so that a panic cannot leave one half changed.
    match std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)) {
        Ok(Ok(())) => GdiblStatus::Ok,
        Ok(Err(status)) => status,
        Err(_) => GdiblStatus::Internal,
    }
}

#[cfg(target_arch = "wasm32")]
fn guarded(work: impl FnOnce() -> Result<(), GdiblStatus>) -> GdiblStatus {
    work().map_or_else(|status| status, |()| GdiblStatus::Ok)
}

/// # Safety
/// `volume` is NULL or alive for `'a`.
#[inline]
unsafe fn volume_at<'a>(volume: *const GdiblVolume) -> Result<&'a Volume, GdiblStatus> {
    // SAFETY: the caller's promise.
    unsafe { volume.as_ref() }.map(|volume| &volume.0).ok_or(GdiblStatus::NullPointer)
}

/// # Safety
/// `set` is NULL or alive for `'a`.
#[inline]
unsafe fn set_at<'a>(set: *const GdiblSet) -> Result<&'a VolumeSet, GdiblStatus> {
    // SAFETY: the caller's promise.
    unsafe { set.as_ref() }.map(|set| &set.0).ok_or(GdiblStatus::NullPointer)
}

/// # Safety
/// `numbers` is NULL or has three of them.
#[inline]
unsafe fn three<T: Copy>(numbers: *const T) -> Result<[T; 3], GdiblStatus> {
    if numbers.is_null() {
        return Err(GdiblStatus::NullPointer);
    }
    // SAFETY: not NULL, so there are three; an array of three is aligned as one.
    Ok(unsafe { numbers.cast::<[T; 3]>().read() })
}

/// # Safety
/// `place` is NULL or can be written.
#[inline]
unsafe fn write<T>(place: *mut T, value: T) -> Result<(), GdiblStatus> {
    if place.is_null() {
        return Err(GdiblStatus::NullPointer);
    }
    // SAFETY: not NULL, so it can be written. What was there is not dropped: no T here has anything to drop.
    unsafe { place.write(value) };
    Ok(())
}

/// Writes a text in parts and a final 0, cut off between characters to fit into `size` bytes.
///
/// # Safety
/// `message` is NULL or has `size` bytes.
unsafe fn write_message(parts: &[&str], message: *mut u8, size: usize) {
    if message.is_null() || size == 0 {
        return;
    }
    let mut end = 0;
    for part in parts {
        let length = part.floor_char_boundary(size - 1 - end);
        // SAFETY: `end + length` is at most `size - 1`, and `part` is not in the caller's buffer.
        unsafe { message.add(end).copy_from_nonoverlapping(part.as_ptr(), length) };
        end += length;
        if length < part.len() {
            break;
        }
    }
    // SAFETY: `end` is at most `size - 1`.
    unsafe { message.add(end).write(0) };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_a_status() {
        let status = guarded(|| panic!("on purpose"));
        assert_eq!(status, GdiblStatus::Internal);
    }

    #[test]
    fn a_message_is_cut_between_characters_and_ends_with_zero() {
        for (size, expected) in
            [(1, &b"\0"[..]), (2, b"a\0"), (3, b"a\0"), (4, "aé\0".as_bytes()), (9, "aé\0".as_bytes())]
        {
            let mut buffer = [7u8; 9];
            // SAFETY: the buffer has nine bytes.
            unsafe { write_message(&["a", "é"], buffer.as_mut_ptr(), size) };
            assert_eq!(&buffer[..expected.len()], expected);
            assert!(buffer[expected.len()..].iter().all(|&byte| byte == 7));
        }
    }
}
