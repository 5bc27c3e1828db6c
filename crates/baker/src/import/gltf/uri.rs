//! URIs of a level: `data:` ones, and files inside the level's own folder. Nothing else is opened.

use std::borrow::Cow;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use base64::Engine;
use base64::alphabet;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use percent_encoding::percent_decode_str;

use super::document::Document;
use crate::{Error, Result};

/// Exporters disagree on `=` at the end.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &alphabet::STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// It holds its bytes itself.
pub(super) fn is_data(uri: &str) -> bool {
    uri.get(..5).is_some_and(|scheme| scheme.eq_ignore_ascii_case("data:"))
}

/// The file that `uri` names; `None` where it holds its bytes itself, or leaves the level's folder.
pub(super) fn file(uri: &str, level: &Path) -> Option<PathBuf> {
    let relative = relative_path(uri).ok().filter(|_| !is_data(uri))?;
    Some(level.parent().unwrap_or(Path::new("")).join(relative))
}

/// Reads what `uri` of a level names; `place` says who asks ("buffer 0").
pub(super) fn load(uri: &str, document: &Document, place: &str) -> Result<Vec<u8>> {
    let level = document.path;
    if is_data(uri) {
        return decode_data(&uri[5..]).map_err(|found| Error::invalid(level, format!("{place}: its data URI {found}")));
    }
    let relative = relative_path(uri).map_err(|found| {
        Error::invalid(
            level,
            format!(
                "{place}: its URI \"{}\" {found}; only data URIs and files inside the level's folder are read",
                shorten(uri)
            ),
        )
    })?;
    let file = level.parent().unwrap_or(Path::new("")).join(relative);
    match std::fs::metadata(&file) {
        Ok(metadata) if metadata.is_file() => {
            let bytes = document.files.read(&file).map_err(|e| Error::io(&file, e))?;
            Ok(Arc::try_unwrap(bytes).unwrap_or_else(|shared| shared.to_vec()))
        }
        Ok(_) => Err(Error::invalid(level, format!("{place}: \"{}\" is not a file", shorten(uri)))),
        Err(_) => Err(Error::invalid(
            level,
            format!("{place}: the file \"{}\" is missing (looked for {})", shorten(uri), file.display()),
        )),
    }
}

/// The bytes behind `data:`: `[media type][;base64],DATA`. `Err` says what is wrong with it.
fn decode_data(rest: &str) -> std::result::Result<Vec<u8>, String> {
    let (head, data) = rest.split_once(',').ok_or("has no comma before its data")?;
    let bytes: Cow<[u8]> = percent_decode_str(data).into();
    if head.to_ascii_lowercase().ends_with(";base64") {
        BASE64.decode(bytes).map_err(|e| format!("is not valid base64: {e}"))
    } else {
        Ok(bytes.into_owned())
    }
}

/// The path below the level's folder that `uri` names. `..` is followed by name, and may not leave the folder.
/// (A symbolic link in the folder is followed: who made the folder made the link.)
fn relative_path(uri: &str) -> std::result::Result<PathBuf, String> {
    let scheme = uri.split_once(':').map(|(s, _)| s).filter(|s| {
        s.starts_with(|c: char| c.is_ascii_alphabetic())
            && s.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '+' | '-' | '.'))
    });
    if let Some(scheme) = scheme {
        return Err(format!("has the scheme \"{scheme}:\""));
    }
    let decoded = percent_decode_str(uri).decode_utf8().map_err(|_| "is not UTF-8 when percent-decoded")?;
    if decoded.contains('\0') {
        return Err("contains a zero byte".into());
    }
    // Some exporters write Windows' separator.
    if decoded.starts_with(['/', '\\']) {
        return Err("is absolute".into());
    }
    let mut path = PathBuf::new();
    for part in decoded.split(['/', '\\']) {
        match part {
            "" | "." => {}
            ".." => {
                if !path.pop() {
                    return Err("leaves the level's folder".into());
                }
            }
            name => {
                let mut components = Path::new(name).components();
                if !matches!((components.next(), components.next()), (Some(Component::Normal(_)), None)) {
                    return Err(format!("has the part \"{name}\""));
                }
                path.push(name);
            }
        }
    }
    if path.as_os_str().is_empty() { Err("names no file".into()) } else { Ok(path) }
}

/// At most 80 characters of a URI, for messages.
pub(super) fn shorten(uri: &str) -> String {
    match uri.char_indices().nth(80) {
        Some((end, _)) => format!("{}...", &uri[..end]),
        None => uri.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn relative_paths_stay_inside_the_folder() {
        let good = [
            ("a.bin", "a.bin"),
            ("a%20b.bin", "a b.bin"),
            ("textures/wood.png", "textures/wood.png"),
            ("./textures//wood.png", "textures/wood.png"),
            ("textures\\wood.png", "textures/wood.png"),
            ("textures/../a.bin", "a.bin"),
            ("%C3%A9.bin", "é.bin"),
        ];
        for (uri, path) in good {
            assert_eq!(relative_path(uri).as_deref(), Ok(Path::new(path)), "{uri}");
        }
        let bad = [
            "/etc/passwd",
            "\\share\\x",
            "../a.bin",
            "a/../../a.bin",
            "%2e%2e/a.bin",
            "%2e%2e%2fa.bin",
            "..\\a.bin",
            "%2Fetc/passwd",
            "http://example.org/a.bin",
            "file:///etc/passwd",
            "C:/a.bin",
            "a%00.bin",
            "%ff.bin",
            "",
            ".",
            "a/..",
        ];
        for uri in bad {
            assert!(relative_path(uri).is_err(), "{uri} was accepted as {:?}", relative_path(uri));
        }
    }

    #[test]
    fn data_uris_decode_base64_and_percent() {
        assert_eq!(decode_data("application/octet-stream;base64,AQIDBA==").unwrap(), [1, 2, 3, 4]);
        assert_eq!(decode_data(";base64,AQIDBA").unwrap(), [1, 2, 3, 4]);
        assert_eq!(decode_data(";base64,AQIDBA%3D%3D").unwrap(), [1, 2, 3, 4]);
        assert_eq!(decode_data(",a%00b").unwrap(), [b'a', 0, b'b']);
        assert!(decode_data(";base64,****").is_err());
        assert!(decode_data(";base64").is_err());
    }

    #[test]
    fn shorten_cuts_between_characters() {
        assert_eq!(shorten("é"), "é");
        assert_eq!(shorten(&"é".repeat(100)), "é".repeat(80) + "...");
    }
}
