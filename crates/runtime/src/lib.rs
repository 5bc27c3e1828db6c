//! Reads `.gdibl` files and reconstructs light from them, in a game, per object or per pixel.
//!
//! ```
//! use gdibl_runtime::Volume;
//!
//! # fn shade(file: &[u8]) -> Result<[f32; 3], gdibl_runtime::Error> {
//! // Once: `file` holds the bytes of level.gdibl, from disk or from an archive.
//! let volume = Volume::parse(file)?;
//!
//! // Per object or per pixel: where it is, and the way its surface faces.
//! let position = [1.0, 1.5, -2.0]; // metres, the level's coordinates
//! let normal = [0.0, 1.0, 0.0]; // unit length
//! let irradiance = volume.irradiance(position, normal);
//!
//! // Here is the 1/pi: a Lambertian surface reflects albedo / pi of what falls on it.
//! let albedo = [0.8, 0.8, 0.8];
//! let diffuse: [f32; 3] =
//!     core::array::from_fn(|c| albedo[c] / core::f32::consts::PI * irradiance[c].max(0.0));
//! # Ok(diffuse)
//! # }
//! ```
//!
//! For many normals at one place (a whole object), sample once and evaluate often:
//! `let light = volume.sample(position, normal).sh.convolve();`, then `light.evaluate(normal)`.
//!
//! For many places at once: [`Volume::irradiance_batch`], the same numbers in two thirds of the time, or half.
//!
//! # Units and axes
//! * World space is glTF's: right-handed, Y up, metres.
//! * Colour is linear Rec.709: red, green, blue.
//! * A volume stores **radiance** as spherical harmonics ([`RadianceSh`]); what falls on a surface is **irradiance**
//!   ([`IrradianceSh`]). [`RadianceSh::convolve`] turns one into the other, and is the only place that does.
//! * White surroundings of radiance L give the irradiance pi L in every direction.
//!
//! # Map of the crate
//! | module | holds |
//! |---|---|
//! | [`sh`] | the basis functions, radiance and irradiance in it |
//! | [`grid`] | where the nodes of a grid are, and which eight surround a position |
//! | [`bricks`] | which nodes a sparse grid has, and which eight surround a position |
//! | [`volume`] | a parsed file: coefficients per node, validity, positions |
//! | [`sample`] | light at a position: trilinear in grids, nearest in points and vertices |
//! | `batch` | the same at many positions at once |
//! | [`set`] | several volumes of one level as one light |
//! | [`walls`] | what keeps light on its side of walls between the nodes of a grid |
//! | [`nearest`] | the nearest of many positions |
//! | [`gpu`] | a grid as the buffers that the shaders in `shaders/` sample |
//! | [`format`](mod@format) | the bytes of a file, shared with the writer; `FORMAT.md` says the same in prose |
//! | [`half`] | 16-bit floats to 32-bit |
//! | [`bits`] | whole numbers in as many bits as they need |
//! | [`packed`] | coefficients in few bytes, with a bound on the error of irradiance |
//!
//! # Features
//! Default are `std`, `messages`, `fast`. `std` takes square roots and powers from the standard library, `libm` from the crate of that
//! name; without either the crate uses its own. With `messages` errors say what was found and what was expected, beside the place. `fast`
//! has code of its own for each number of bands. `zstd` reads compressed sections. There is no other dependency, and no `unsafe`.
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(feature = "messages"),
    allow(clippy::needless_borrow, clippy::op_ref, reason = "what is a `String` with it")
)]

extern crate alloc;
#[cfg(any(feature = "std", test))]
extern crate std;

mod batch;
pub mod bits;
pub mod bricks;
mod codec;
mod coefficients;
mod crc32;
mod error;
pub mod format;
pub mod gpu;
pub mod grid;
pub mod half;
mod math;
pub mod nearest;
pub mod packed;
pub mod sample;
pub mod set;
pub mod sh;
mod shuffle;
pub mod volume;
pub mod walls;

pub use error::Error;
pub use format::{Header, Kind, Limits, Units};
pub use grid::{Cell, Grid};
pub use sample::Sample;
pub use set::VolumeSet;
pub use sh::{IrradianceSh, RadianceSh};
pub use volume::Volume;
