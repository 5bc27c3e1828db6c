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
//! | `exr-layer` | this layer of several was taken, or one whose name does not say that it is the picture |
//! | `distance-not-read` | a part beside the picture holds distances, but not of the picture's pixels |
//! | `chromaticities`, `hdr-primaries`, `hdr-xyz` | the light was converted from these primaries to linear Rec.709 |
//! | `hdr-lumens` | the light of a `.hdr` in XYZ was divided by 179 lumens per watt |
//! | `color-interop-id` | the light was converted from what `colorInteropID` says; or it is not known |
//! | `color-space-conflict` | `colorInteropID` and chromaticities contradict each other; the ID counts |
//! | `outside-gamut` | so many pixels have colours outside of Rec.709: their channels below 0 became 0 |
//! | `hdr-gamma` | a `.hdr` header names a GAMMA other than 1; its numbers are used as they are |
//! | `world-to-camera` | the matrix gives no pose (not finite, singular, or mirroring) and was ignored |

mod decoded;
mod exr;
mod exr_write;
mod hdr;
mod layers;
mod png_write;
mod pose;
mod repair;
mod space;

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::files::{Disk, Files};

use self::decoded::Decoded;
pub use self::decoded::MAX_PIXELS;
pub use self::exr_write::{SampleFormat, write_exr, write_exr_picture};
pub use self::png_write::write_png;
pub use self::pose::Pose;
pub use self::repair::ReadOptions;
pub use crate::panorama::Image;
use crate::panorama::{Mapping, guess_from_aspect};
use crate::{Error, Finding, Result};

/// First bytes of OpenEXR and of Radiance files.
const EXR_MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];
const HDR_MAGIC: &[u8] = b"#?";

/// An image and what its file says about it.
#[derive(Debug, Clone)]
pub struct Imported {
    /// Checked pixels in linear Rec.709, in the file's own layout; `.hdr` EXPOSURE and COLORCORR are applied.
    pub image: Image,
    /// Where the probe stood, as far as the file says.
    pub pose: Pose,
    /// The layout, where the file says (EXR attribute `envmap`).
    pub mapping: Option<Mapping>,
    /// What was repaired, ignored or is suspicious.
    pub findings: Vec<Finding>,
}

impl Imported {
    /// The layout of the image that was read from `path`: what the caller says, else what the file says, else lat-long
    /// if the image has its shape. An error for any other image, which could be anything.
    pub fn layout(&self, path: &Path, said: Option<Mapping>) -> Result<Mapping> {
        let Image { width, height, .. } = self.image;
        // One pixel is the same in all layouts.
        let is_lat_long = width == 2 * height || (width, height) == (1, 1);
        let Some(mapping) = said.or(self.mapping).or(is_lat_long.then_some(Mapping::LatLong)) else {
            let guess = match guess_from_aspect(width, height) {
                Some(guess) => format!("this looks like {}", guess.name()),
                None => "this is the shape of no mapping: was it cropped?".into(),
            };
            return Err(Error::invalid(
                path,
                format!(
                    "the image has {width} x {height} pixels and names no mapping; a lat-long panorama is twice as wide \
                     as high, and {guess}; say which it is: --distant-mapping NAME, or mapping in a BAKE.toml"
                ),
            ));
        };
        mapping.check_shape(width, height).map_err(|why| Error::invalid(path, why))?;
        Ok(mapping)
    }
}

/// Reads an EXR or `.hdr` file.
pub fn read_image(path: &Path, options: &ReadOptions) -> Result<Imported> {
    read_image_from(&Disk, path, options)
}

/// The same with the bytes that `files` gives.
pub fn read_image_from(files: &dyn Files, path: &Path, options: &ReadOptions) -> Result<Imported> {
    // A file need not lie on the disk.
    if let Ok(metadata) = std::fs::metadata(path)
        && !metadata.is_file()
    {
        let found = if metadata.is_dir() { "a folder" } else { "not a regular file" };
        return Err(Error::invalid(path, format!("this is {found}; expected an EXR or HDR image file")));
    }
    let bytes = files.read(path).map_err(|e| Error::io(path, e))?;
    parse_image(&bytes, path, options)
}

/// Reads an image from its bytes. `path` names it in messages.
pub fn parse_image(bytes: &[u8], path: &Path, options: &ReadOptions) -> Result<Imported> {
    let mut decoded = if bytes.starts_with(&EXR_MAGIC) {
        exr::decode(path, bytes, options.layer.as_deref())?
    } else if bytes.starts_with(HDR_MAGIC) {
        hdr::decode(path, bytes)?
    } else {
        return Err(unknown_type(path, &bytes[..bytes.len().min(64)]));
    };
    repair::check(path, &mut decoded, options)?;
    let Decoded { mut image, pose, mapping, conversion, mut findings, .. } = decoded;
    if let Some(conversion) = conversion {
        conversion.apply(path, &mut image, &mut findings)?;
    }
    Ok(Imported { image, pose, mapping, findings })
}

fn unknown_type(path: &Path, start: &[u8]) -> Error {
    const EXPECTED: &str = "expected OpenEXR (76 2f 31 01) or Radiance HDR (#?RADIANCE)";
    if let Some(name) = known_type(start) {
        return Error::unsupported(
            path,
            format!("this is {name} file; {EXPECTED}: save the panorama as one of these, in linear radiance"),
        );
    }
    if start.is_empty() {
        return Error::invalid(path, format!("the file is empty; {EXPECTED}"));
    }
    let bytes: Vec<String> = start.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    Error::invalid(path, format!("the file begins with {}; {EXPECTED}", bytes.join(" ")))
}

/// The type of a file that other programs know, with its article.
fn known_type(start: &[u8]) -> Option<&'static str> {
    // ISO base media: size, "ftyp", brand.
    if start.get(4..8) == Some(b"ftyp") {
        return Some(match start.get(8..12) {
            Some(b"avif" | b"avis") => "an AVIF",
            // Any brand may stand first; the others follow.
            _ if start.windows(4).any(|brand| brand == b"avif") => "an AVIF",
            Some(b"heic" | b"heix" | b"hevc" | b"heim" | b"mif1" | b"msf1") => "a HEIF (HEIC or AVIF)",
            Some(b"jp2 " | b"jpx " | b"jph ") => "a JPEG 2000",
            _ => "an MP4 or other ISO media",
        });
    }
    let known = [
        (&b"\x89PNG"[..], "a PNG"),
        (b"\xff\xd8\xff", "a JPEG"),
        (b"\0\0\0\x0cjP  ", "a JPEG 2000"),
        (b"\xff\x4f\xff\x51", "a JPEG 2000"),
        (b"\0\0\0\x0cJXL ", "a JPEG XL"),
        (b"\xff\x0a", "a JPEG XL"),
        (b"II\xbc\x01", "a JPEG XR"),
        (b"II*\0", "a TIFF"),
        (b"MM\0*", "a TIFF"),
        (b"II+\0", "a TIFF"),
        (b"MM\0+", "a TIFF"),
        (b"RIFF", "a WebP"),
        (b"DDS ", "a DDS"),
        (b"\xabKTX", "a KTX"),
        (b"PF\n", "a PFM"),
        (b"Pf\n", "a PFM"),
        (b"GIF8", "a GIF"),
        (b"8BPS", "a Photoshop"),
        (b"BM", "a BMP"),
        (b"glTF", "a glTF"),
    ];
    known.iter().find(|(magic, _)| start.starts_with(magic)).map(|(_, name)| *name)
}

/// Whether the file at `path` is an image that [`read_image`] knows, by its first bytes.
pub fn is_image(path: &Path) -> Result<bool> {
    let mut start = Vec::new();
    let file = File::open(path).map_err(|e| Error::io(path, e))?;
    file.take(4).read_to_end(&mut start).map_err(|e| Error::io(path, e))?;
    Ok(start == EXR_MAGIC || start.starts_with(HDR_MAGIC))
}
