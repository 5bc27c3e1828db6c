//! Why a file cannot be read. The message names the place in the file, what was found there and what was expected; the
//! caller, who knows it, adds the file's name.

use alloc::string::String;
use core::fmt;

/// Why a file cannot be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Error {
    /// The file may be whole, but this reader does not know what it uses: a newer version, another encoding, a codec
    /// that was left out of this build.
    Unsupported(Finding),
    /// The file is damaged, or was never a volume.
    Invalid(Finding),
}

/// What was found where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The place in the file: "header, byte 12: kind", "section RSH , node 17".
    pub place: String,
    /// What was found there.
    pub found: String,
    /// What was expected instead.
    pub expected: String,
}

impl Error {
    pub(crate) fn invalid(place: impl Into<String>, found: impl Into<String>, expected: impl Into<String>) -> Error {
        Error::Invalid(Finding { place: place.into(), found: found.into(), expected: expected.into() })
    }

    pub(crate) fn unsupported(
        place: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Error {
        Error::Unsupported(Finding { place: place.into(), found: found.into(), expected: expected.into() })
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (what, finding) = match self {
            Error::Unsupported(finding) => ("unsupported", finding),
            Error::Invalid(finding) => ("invalid", finding),
        };
        let Finding { place, found, expected } = finding;
        write!(f, "{what} volume: {place}: found {found}, expected {expected}")
    }
}

impl core::error::Error for Error {}
