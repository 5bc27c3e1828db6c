//! What a decoder hands over, and the checks that both decoders share.

use std::path::Path;

use super::pose::Pose;
use super::space::Conversion;
use crate::panorama::{Image, Mapping};
use crate::{Error, Finding, Result};

/// Pixels of the largest image that is read: 16384 × 8192.
pub const MAX_PIXELS: usize = 16384 * 8192;

/// What a decoder hands over, not yet checked.
pub(super) struct Decoded {
    pub image: Image,
    /// The file's names of the samples, for messages: R, G, B, and Z.
    pub channel_names: [String; 4],
    /// Which of R, G, B the file stores as half floats.
    pub half_float: [bool; 3],
    pub pose: Pose,
    pub mapping: Option<Mapping>,
    /// What makes linear Rec.709 of the pixels; `None` where they are.
    pub conversion: Option<Conversion>,
    pub findings: Vec<Finding>,
}

/// Refuses an image of no pixels, or of more than [`MAX_PIXELS`], before any memory is taken for it.
pub(super) fn check_size(path: &Path, width: usize, height: usize) -> Result<()> {
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
pub(super) fn guard<T>(path: &Path, decode: impl FnOnce() -> Result<T>) -> Result<T> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(decode)).unwrap_or_else(|payload| {
        let reason = payload
            .downcast_ref::<String>()
            .map(String::as_str)
            .or_else(|| payload.downcast_ref::<&str>().copied())
            .unwrap_or("no message");
        Err(Error::invalid(path, format!("the decoder gave up: {reason}; the file is damaged: save it again")))
    })
}
