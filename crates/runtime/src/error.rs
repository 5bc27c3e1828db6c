//! Why a file cannot be read. The message names the place in the file, what was found there and what was expected; the
//! caller, who knows it, adds the file's name. Without the feature `messages` it names the place alone, without numbers:
//! numbers as text would be two fifths of a small module.

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
    /// What was found there. With the feature `messages`.
    #[cfg(feature = "messages")]
    pub found: String,
    /// What was expected instead. With the feature `messages`.
    #[cfg(feature = "messages")]
    pub expected: String,
}

/// `format!` of what a message says.
#[cfg(feature = "messages")]
macro_rules! text {
    ($format:literal $($argument:tt)*) => {
        alloc::format!($format $($argument)*)
    };
}
/// What is left of it: a place up to its first number.
#[cfg(not(feature = "messages"))]
macro_rules! text {
    ($format:literal $($argument:tt)*) => {{
        let _ = || alloc::format!($format $($argument)*);
        const { $crate::error::before_numbers($format) }
    }};
}
pub(crate) use text;

/// The part of a format before its first argument, less what leads to that: "section RSH " of "section RSH , node {node}".
#[cfg(any(not(feature = "messages"), test))]
pub(crate) const fn before_numbers(format: &str) -> &str {
    let bytes = format.as_bytes();
    let (mut end, mut comma) = (0, None);
    while end < bytes.len() && bytes[end] != b'{' {
        if bytes[end] == b',' {
            comma = Some(end);
        }
        end += 1;
    }
    match comma {
        Some(comma) if end < bytes.len() => format.split_at(comma).0,
        _ => format.split_at(end).0,
    }
}

impl Error {
    #[cold]
    #[inline(never)]
    pub(crate) fn invalid(place: impl Into<String>, found: impl Into<String>, expected: impl Into<String>) -> Error {
        Error::Invalid(Finding::new(place.into(), found, expected))
    }

    #[cold]
    #[inline(never)]
    pub(crate) fn unsupported(
        place: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Error {
        Error::Unsupported(Finding::new(place.into(), found, expected))
    }

    /// The message in parts, one after the other: for programs that do without `core::fmt`.
    pub fn parts(&self) -> [&str; 7] {
        let (what, finding) = match self {
            Error::Unsupported(finding) => ("unsupported", finding),
            Error::Invalid(finding) => ("invalid", finding),
        };
        #[cfg(feature = "messages")]
        let [found, expected] = [[": found ", &*finding.found], [", expected ", &*finding.expected]];
        #[cfg(not(feature = "messages"))]
        let [found, expected] = [[""; 2]; 2];
        [what, " volume: ", &finding.place, found[0], found[1], expected[0], expected[1]]
    }
}

impl Finding {
    #[cfg(feature = "messages")]
    fn new(place: String, found: impl Into<String>, expected: impl Into<String>) -> Finding {
        Finding { place, found: found.into(), expected: expected.into() }
    }

    #[cfg(not(feature = "messages"))]
    fn new(place: String, _: impl Into<String>, _: impl Into<String>) -> Finding {
        Finding { place }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.parts().into_iter().try_for_each(|part| f.write_str(part))
    }
}

impl core::error::Error for Error {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_without_numbers_ends_before_the_first() {
        for (format, place) in [
            ("section RSH , node {node}, plane {}", "section RSH "),
            ("header, bytes 48 and 72: box, axis {axis}", "header, bytes 48 and 72: box"),
            (", node {}", ""),
            ("header, byte 12: kind", "header, byte 12: kind"),
        ] {
            assert_eq!(before_numbers(format), place);
        }
    }
}
