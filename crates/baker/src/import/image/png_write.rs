//! Writes PNG: 8 bit, sRGB.

use std::io::Cursor;
use std::path::Path;

use ::image::{DynamicImage, ImageFormat, RgbImage};

use crate::pack::write_whole;
use crate::{Error, Result};

/// Writes `pixels`, row by row from the top, to `path`: the whole file or none.
pub fn write_png(path: &Path, width: usize, height: usize, pixels: &[[u8; 3]]) -> Result<()> {
    assert_eq!(pixels.len(), width * height, "pixels of a {width} x {height} image");
    let image = RgbImage::from_raw(width as u32, height as u32, pixels.as_flattened().to_vec());
    let image = DynamicImage::ImageRgb8(image.expect("three bytes per pixel"));
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Png).map_err(|error| Error::io(path, std::io::Error::other(error)))?;
    write_whole(path, bytes.get_ref())
}
