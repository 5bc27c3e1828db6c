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

mod exr;
mod exr_write;
mod hdr;
mod png_write;
mod pose;
mod repair;

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

pub use self::exr_write::{SampleFormat, write_exr, write_exr_picture};
pub use self::png_write::write_png;
pub use self::pose::Pose;
pub use crate::panorama::Image;
use crate::panorama::Mapping;
use crate::{Error, Finding, Result};

/// Pixels of the largest image that is read: 16384 × 8192.
pub const MAX_PIXELS: usize = 16384 * 8192;

/// How an image is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ReadOptions {
    /// Replace unusable samples instead of refusing the file: NaN and infinity by the mean of their valid
    /// neighbours, negative radiance by 0, an unusable distance by infinity.
    pub repair_pixels: bool,
}

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

/// What a decoder hands over, not yet checked.
struct Decoded {
    image: Image,
    /// The file's names of the samples, for messages: R, G, B, and Z.
    channel_names: [String; 4],
    /// Which of R, G, B the file stores as half floats.
    half_float: [bool; 3],
    pose: Pose,
    mapping: Option<Mapping>,
    findings: Vec<Finding>,
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

/// Refuses an image of no pixels, or of more than [`MAX_PIXELS`], before any memory is taken for it.
fn check_size(path: &Path, width: usize, height: usize) -> Result<()> {
    if width == 0 || height == 0 {
        return Err(Error::invalid(path, format!("the image has {width} x {height} pixels; expected at least 1 x 1")));
    }
    if width.checked_mul(height).is_none_or(|pixels| pixels > MAX_PIXELS) {
        return Err(Error::unsupported(
            path,
            format!(
                "the header claims {width} x {height} pixels; at most {MAX_PIXELS} (16384 x 8192) are read: \
                 scale the panorama down, or check whether the file is damaged"
            ),
        ));
    }
    Ok(())
}

/// Runs a decoder that must not be able to end the program. Both decoders are fuzzed here and by others, but
/// assertions in them are reachable from damaged files; a panic is one, and is reported as such. (Whoever runs the
/// program still sees the panic hook's line on stderr: a library does not replace the hook.)
fn guard<T>(path: &Path, decode: impl FnOnce() -> Result<T>) -> Result<T> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(decode)).unwrap_or_else(|payload| {
        let reason = payload
            .downcast_ref::<String>()
            .map(String::as_str)
            .or_else(|| payload.downcast_ref::<&str>().copied())
            .unwrap_or("no message");
        Err(Error::invalid(path, format!("the decoder gave up: {reason}; the file is damaged: save it again")))
    })
}
