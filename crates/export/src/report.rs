//! What is asked of an export, and what comes of it.

use serde::Serialize;

use crate::loss::{Loss, Negative, Variant};

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

/// What [`export`](crate::export) returns.
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
    #[serde(rename = "loss")]
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
