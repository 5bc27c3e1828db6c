//! Why a volume cannot be exported.

use std::fmt;

/// Why a volume cannot be exported. The message says what was found, what is possible and what to do; the caller, who
/// knows it, adds the file's name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Error {
    /// The volume is fine, but the engine's format cannot hold it.
    Unsupported(String),
    /// The settings make no sense.
    Settings(String),
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Error::Unsupported(message) | Error::Settings(message) => f.write_str(message),
        }
    }
}

impl std::error::Error for Error {}
