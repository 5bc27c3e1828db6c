//! Pixels in any layout, before or after conversion.

/// An image as a file holds it: rows from the top, linear Rec.709 radiance, optionally a distance per pixel.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Image {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width * height` pixels, row by row from the top.
    pub pixels: Vec<[f32; 3]>,
    /// Metres along the ray per pixel, +infinity where it escapes.
    pub distance: Option<Vec<f32>>,
}

impl Image {
    /// An image without distances. Panics when the number of pixels does not match.
    pub fn new(width: usize, height: usize, pixels: Vec<[f32; 3]>) -> Self {
        assert_eq!(pixels.len(), width * height, "pixels of a {width} x {height} image");
        Image { width, height, pixels, distance: None }
    }
}
