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
mod rgb9e5;
mod tetrahedra;
mod texture;
pub mod three;
pub mod unity;

pub use error::Error;
pub use loss::{Loss, Negative, SAMPLES, Variant, sample_normal, sample_position};

use gdibl_runtime::Volume;
use serde::Serialize;

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

/// What to write.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Name of the main file, without a folder: "room.ktx2". Files that come with it are named after it.
    pub name: String,
    /// Nodes per axis, the first on the box's min and the last on its max; None: those of the volume. More of them
    /// lessen what three.js, Godot and Unity lose, which cut or move what the volume interpolates.
    pub counts: Option<[u32; 3]>,
}

/// A file to be written.
#[derive(Clone, Debug)]
pub struct File {
    /// Its name, without a folder.
    pub name: String,
    /// All of its bytes.
    pub bytes: Vec<u8>,
}

/// What [`export`] returns.
#[derive(Clone, Debug)]
pub struct Export {
    /// The main file first.
    pub files: Vec<File>,
    /// What was lost.
    pub report: Report,
}

/// What was written, and what it lost.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Nodes per axis in the file; of points and vertices: how many, 1, 1.
    pub counts: [u32; 3],
    /// The highest band of the volume.
    pub bands_of_volume: u32,
    /// The highest band of the file; an ambient cube has none.
    pub bands: Option<u32>,
    /// Error of what the main file says, as the engine reads it.
    pub error: Loss,
    /// Error of every way of writing that was tried, the main file's too. Empty where there is one way only.
    pub variants: Vec<Variant>,
    /// Irradiance below zero in the volume, and what the engine does with it.
    pub negative: Negative,
    /// What else is worth knowing.
    pub notes: Vec<Note>,
}

/// A finding that is not fatal.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Note {
    /// Stable, kebab-case.
    pub id: &'static str,
    /// One sentence for a person.
    pub message: String,
}

impl Note {
    pub(crate) fn new(id: &'static str, message: impl Into<String>) -> Note {
        Note { id, message: message.into() }
    }
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

/// "room.ktx2" and ".json" give "room.json".
pub(crate) fn beside(name: &str, ending: &str) -> String {
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    let stem = if stem.is_empty() { name } else { stem };
    format!("{stem}{ending}")
}
