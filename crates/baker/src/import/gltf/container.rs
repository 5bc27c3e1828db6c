//! What kind of file this is, and the two chunks of a binary one.
//!
//! ```text
//! GLB:  "glTF" version:u32 length:u32 | length:u32 "JSON" ... | length:u32 "BIN\0" ... | (unknown chunks)
//! glTF: (byte order mark) (white space) {
//! ```

use std::path::Path;

use super::findings::Findings;
use crate::{Error, Result};

const CHUNK_JSON: u32 = u32::from_le_bytes(*b"JSON");
const CHUNK_BIN: u32 = u32::from_le_bytes(*b"BIN\0");

/// The JSON text of a level and, in a GLB, the bytes of its first buffer.
#[derive(Debug)]
pub(super) struct Container<'a> {
    pub json: &'a [u8],
    pub binary: Option<&'a [u8]>,
}

/// Tells a GLB from a glTF by the first bytes, and takes a GLB apart.
pub(super) fn split<'a>(bytes: &'a [u8], path: &Path, findings: &mut Findings) -> Result<Container<'a>> {
    if bytes.starts_with(b"glTF") {
        return split_glb(bytes, path, findings);
    }
    let json = text_of(bytes);
    match json.iter().find(|b| !b.is_ascii_whitespace()) {
        Some(b'{') => Ok(Container { json, binary: None }),
        None => Err(Error::invalid(path, "the file is empty; expected a glTF or GLB level")),
        Some(_) => {
            let start = bytes[..bytes.len().min(8)].escape_ascii();
            Err(Error::invalid(
                path,
                format!("starts with \"{start}\"; a level starts with \"glTF\" (GLB) or \"{{\" (glTF JSON)"),
            ))
        }
    }
}

/// JSON without a byte order mark, which the specification forbids but lets readers ignore, and without the zeros that some
/// writers pad with in place of spaces.
fn text_of(bytes: &[u8]) -> &[u8] {
    let text = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let end = text.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    &text[..end]
}

fn split_glb<'a>(bytes: &'a [u8], path: &Path, findings: &mut Findings) -> Result<Container<'a>> {
    let invalid = |message: String| Error::invalid(path, message);
    let word = |at: usize| -> Option<u32> {
        let four = bytes.get(at..at.checked_add(4)?)?;
        Some(u32::from_le_bytes([four[0], four[1], four[2], four[3]]))
    };

    // Header.
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        return Err(invalid(format!("GLB header: 12 bytes expected, the file has {}; it is truncated", bytes.len())));
    };
    if version != 2 {
        return Err(Error::unsupported(
            path,
            format!("GLB header: version {version}; gdibl reads version 2. Export the level as glTF 2.0"),
        ));
    }
    let length = length as usize;
    if length > bytes.len() {
        return Err(invalid(format!(
            "GLB header: the length says {length} bytes, the file has {}; it is truncated",
            bytes.len()
        )));
    }
    if length < bytes.len() {
        findings.add("glb-trailing-bytes", (bytes.len() - length) as u64, || {
            format!("The GLB header says {length} bytes; what follows them was ignored")
        });
    }

    // Chunks. JSON comes first, BIN second; others may follow and are skipped.
    let mut container = Container { json: &[], binary: None };
    let mut at = 12;
    let mut chunk = 0;
    while at < length {
        let place = format!("GLB chunk {chunk} at byte {at}");
        let header = (length - at >= 8).then(|| word(at).zip(word(at + 4))).flatten();
        let Some((size, kind)) = header else {
            return Err(invalid(format!(
                "{place}: {} bytes left for its header of 8; the file is damaged",
                length - at
            )));
        };
        let start = at + 8;
        let size = size as usize;
        if size > length - start {
            return Err(invalid(format!(
                "{place}: says {size} bytes, {} are left; the file is truncated or damaged",
                length - start
            )));
        }
        let data = &bytes[start..start + size];
        match (chunk, kind) {
            (0, CHUNK_JSON) => container.json = text_of(data),
            (0, _) => {
                return Err(invalid(format!(
                    "{place}: its type is \"{}\"; the first chunk must be \"JSON\"",
                    kind.to_le_bytes().escape_ascii()
                )));
            }
            (1, CHUNK_BIN) => container.binary = Some(data),
            (_, CHUNK_JSON | CHUNK_BIN) => {
                return Err(invalid(format!(
                    "{place}: a chunk \"{}\" in the wrong place; the order is JSON, BIN, others",
                    kind.to_le_bytes().escape_ascii()
                )));
            }
            _ => {}
        }
        at = start + size;
        chunk += 1;
    }
    if chunk == 0 {
        return Err(invalid("GLB: no chunk after the header; expected a JSON chunk".into()));
    }
    Ok(container)
}
