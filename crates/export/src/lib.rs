//! Writes irradiance volumes in engines' own formats, and tells what each of them loses.
//!
//! ```
//! use gdibl_export::{Engine, Settings, export};
//! # fn convert(volume: &gdibl_runtime::Volume) -> Result<(), gdibl_export::Error> {
//! let export = export(volume, Engine::Bevy, &Settings { name: "room.ktx2".into(), counts: None })?;
//! for file in &export.files {
//!     // file.name, file.bytes: all of them belong into one folder.
//! }
//! let lost = export.report.error.relative_rmse; // of irradiance, against the volume itself
//! # Ok(())
//! # }
//! ```
//! | module | engine | light | between nodes | below zero | outside the box |
//! |---|---|---|---|---|---|
//! | [`bevy`] | Bevy 0.13 and later | ambient cube, E/π | trilinear, cell centres | cannot be stored: fitted without | nothing |
//! | [`three`] | three.js r184 and later | radiance SH to L2 | trilinear, half a cell along the normal (undone) | clamped at 0 | nothing from r187, before that the nearest |
//! | [`godot`] | Godot 4 | radiance SH to L2, over π | in tetrahedra, one sample per object | subtracts | weights clamped one by one: too bright |
//! | [`unity`] | Unity, light probes | E/π as a polynomial, L2 | in tetrahedra, one sample per object | clamped at 0 | the nearest on the hull |
//! | [`mod@exr`], [`json`] | everyone else | radiance SH, all bands | the reader's business | as stored | the reader's business |
//!
//! # Conventions
//! World space is glTF's (right-handed, Y up, metres), colour linear Rec.709, coefficients the runtime's. What an engine
//! wants differently (handedness, constants, 1/π, where in a cell a node sits) is converted in that engine's module and
//! nowhere else.
//!
//! # The error
//! Every export is decoded again from the bytes written, as that engine's shader does (formula, filter and clamp
//! transcribed, the source named), at 4096 positions in the box with a normal each, and compared with
//! `max(E, 0)` of the volume. Where there are two ways to write, both are measured, and the better one is written.
#![forbid(unsafe_code)]

pub mod bevy;
mod cube;
mod error;
pub mod exr;
pub mod godot;
pub mod json;
mod ktx2;
mod light;
mod loss;
mod report;
mod rgb9e5;
mod tetrahedra;
mod texture;
pub mod three;
pub mod unity;

pub use error::Error;
pub use loss::{Loss, Negative, SAMPLES, Variant, sample_normal, sample_position};
pub use report::{Export, File, Note, Report, Settings};

use gdibl_runtime::Volume;

/// For whom to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Engine {
    /// `IrradianceVolume` of Bevy: KTX2 textures, and their place as JSON.
    Bevy,
    /// `LightProbeGrid` of three.js: its atlas, and a module that loads it.
    Three,
    /// `LightmapGIData` of Godot 4: a `.tres` resource.
    Godot,
    /// Light probes of Unity: JSON, and a script that imports it.
    Unity,
    /// Coefficients as layers of an OpenEXR image, slice above slice.
    Exr,
    /// All that a volume holds, as JSON.
    Json,
}

/// Converts a volume for an engine. Nothing is written to disk.
///
/// # Errors
/// [`Error::Unsupported`] where the engine cannot hold such a volume: points or vertices (except as JSON), too many
/// nodes, light too bright for its numbers. [`Error::Settings`] where the settings make no sense.
pub fn export(volume: &Volume, engine: Engine, settings: &Settings) -> Result<Export, Error> {
    let export = match engine {
        Engine::Bevy => bevy::export(volume, settings),
        Engine::Three => three::export(volume, settings),
        Engine::Godot => godot::export(volume, settings),
        Engine::Unity => unity::export(volume, settings),
        Engine::Exr => exr::export(volume, settings),
        Engine::Json => json::export(volume, settings),
    }?;
    let mut names: Vec<&str> = export.files.iter().map(|file| file.name.as_str()).collect();
    names.sort_unstable();
    match names.windows(2).find(|pair| pair[0] == pair[1]) {
        Some(pair) => Err(Error::Settings(format!("{}: two files would have this name; choose another", pair[0]))),
        None => Ok(export),
    }
}
