//! Reads panoramas: OpenEXR and Radiance `.hdr`, told apart by their first bytes; writes OpenEXR, and PNG to look at.
//!
//! What comes out is checked: finite radiance >= 0, distances >= 0 or infinite, sizes within [`MAX_PIXELS`]. A file
//! is not trusted: sizes are capped before memory is taken, and a panic of a decoder is an invalid file.
//!
//! Findings (stable ids):
//!
//! | id | means |
//! |---|---|
//! | `repaired-pixels` | `repair_pixels` replaced so many samples of R, G or B |
//! | `repaired-distances` | `repair_pixels` let so many pixels escape whose `Z` was NaN or negative |
//! | `half-float-clipping` | so many pixels are at 65504, the largest half float: brighter light was cut off |
//! | `far-distance-escapes` | so many pixels have a finite `Z` beyond 1e9 m, a renderer's "nothing hit" |
//! | `display-window` | the data window is not the display window: cropped, filled with black, or (almost no overlap) read instead of it |
//! | `chromaticities` | the file names primaries other than Rec.709; its numbers are used as they are |
//! | `hdr-gamma` | a `.hdr` header names a GAMMA other than 1; its numbers are used as they are |
//! | `world-to-camera` | the matrix gives no pose (not finite, singular, or mirroring) and was ignored |

mod decoded;
mod exr;
mod exr_write;
mod hdr;
mod png_write;
mod pose;
mod repair;

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use self::decoded::Decoded;
pub use self::decoded::MAX_PIXELS;
pub use self::exr_write::{SampleFormat, write_exr, write_exr_picture};
pub use self::png_write::write_png;
pub use self::pose::Pose;
pub use self::repair::ReadOptions;
pub use crate::panorama::Image;
use crate::panorama::Mapping;
use crate::{Error, Finding, Result};

/// An image and what its file says about it.
#[derive(Debug, Clone)]
pub struct Imported {
    /// Checked pixels, in the file's own layout; `.hdr` EXPOSURE and COLORCORR are applied.
    pub image: Image,
    /// Where the probe stood, as far as the file says.
    pub pose: Pose,
    /// The layout, where the file says (EXR attribute `envmap`).
    pub mapping: Option<Mapping>,
    /// What was repaired, ignored or is suspicious.
    pub findings: Vec<Finding>,
}

/// Reads an EXR or `.hdr` file.
pub fn read_image(path: &Path, options: &ReadOptions) -> Result<Imported> {
    let metadata = std::fs::metadata(path).map_err(|e| Error::io(path, e))?;
    if !metadata.is_file() {
        let found = if metadata.is_dir() { "a folder" } else { "not a regular file" };
        return Err(Error::invalid(path, format!("this is {found}; expected an EXR or HDR image file")));
    }
    let mut file = File::open(path).map_err(|e| Error::io(path, e))?;
    let mut start = Vec::new();
    (&mut file).take(16).read_to_end(&mut start).map_err(|e| Error::io(path, e))?;
    file.seek(SeekFrom::Start(0)).map_err(|e| Error::io(path, e))?;

    let mut decoded = if start.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        exr::decode(path, &file, metadata.len())?
    } else if start.starts_with(b"#?") {
        hdr::decode(path, &file, metadata.len())?
    } else {
        return Err(unknown_type(path, &start));
    };
    repair::check(path, &mut decoded, options)?;
    let Decoded { image, pose, mapping, findings, .. } = decoded;
    Ok(Imported { image, pose, mapping, findings })
}

fn unknown_type(path: &Path, start: &[u8]) -> Error {
    const EXPECTED: &str = "expected OpenEXR (76 2f 31 01) or Radiance HDR (#?RADIANCE)";
    let known = [
        (&b"\x89PNG"[..], "PNG"),
        (b"\xff\xd8\xff", "JPEG"),
        (b"II*\0", "TIFF"),
        (b"MM\0*", "TIFF"),
        (b"RIFF", "WebP"),
        (b"DDS ", "DDS"),
        (b"\xabKTX", "KTX"),
        (b"PF\n", "PFM"),
        (b"\0\0\0\x0cJXL ", "JPEG XL"),
    ];
    if let Some((_, name)) = known.iter().find(|(magic, _)| start.starts_with(magic)) {
        return Error::unsupported(
            path,
            format!("this is a {name} file; {EXPECTED}: save the panorama as one of these, in linear radiance"),
        );
    }
    if start.is_empty() {
        return Error::invalid(path, format!("the file is empty; {EXPECTED}"));
    }
    let bytes: Vec<String> = start.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    Error::invalid(path, format!("the file begins with {}; {EXPECTED}", bytes.join(" ")))
}
