//! What can go wrong with an input, and what is worth telling about one that works.

use std::path::{Path, PathBuf};

/// Result of the baker's fallible functions.
pub type Result<T> = std::result::Result<T, Error>;

/// Why an input could not be used. A message names the file, the place in it, what was found, what was
/// expected, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file is well formed but asks for something gdibl does not do.
    #[error("{}: not supported: {message}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// Place, what was found, what to do.
        message: String,
    },
    /// The file contradicts its format or itself.
    #[error("{}: {message}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// Place, found, expected, what to do.
        message: String,
    },
    /// The system could not read or write the file.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

impl Error {
    /// An [`Error::Unsupported`] about `path`.
    pub fn unsupported(path: &Path, message: impl Into<String>) -> Self {
        Error::Unsupported { path: path.into(), message: message.into() }
    }
    /// An [`Error::Invalid`] about `path`.
    pub fn invalid(path: &Path, message: impl Into<String>) -> Self {
        Error::Invalid { path: path.into(), message: message.into() }
    }
    /// An [`Error::Io`] about `path`; use as `.map_err(|e| Error::io(path, e))`.
    pub fn io(path: &Path, source: std::io::Error) -> Self {
        Error::Io { path: path.into(), source }
    }
}

/// Something found in an input that is not fatal: a row of the report, with a stable id.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize, bincode::Encode, bincode::Decode)]
pub struct Finding {
    /// Stable, kebab-case, e.g. `non-finite-triangles`.
    pub id: String,
    /// How many times.
    pub count: u64,
    /// One sentence for a person: where and what it means.
    pub message: String,
}

impl Finding {
    /// A finding with a stable `id`.
    pub fn new(id: &str, count: u64, message: impl Into<String>) -> Self {
        Finding { id: id.into(), count, message: message.into() }
    }
}
