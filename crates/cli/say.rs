//! Lines for a person, on stderr.

use std::io::Write;

/// A line for a person on stderr.
pub fn say(line: &str) {
    // Where nobody reads it, nobody misses it.
    let _ = writeln!(std::io::stderr(), "gdibl: {line}");
}
