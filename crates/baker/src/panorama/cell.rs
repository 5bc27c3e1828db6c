//! Cells of a lat-long panorama: what lies between four pixel centres.

use glam::Vec3;

use crate::angle::arctangent;

/// A cell, and a place in it. Rows of cells: one above the first row of pixels, half as high as the others, one between
/// each two, and one below the last, half as high. Columns: cell `i` lies between pixels `i` and `i + 1`; the last one is
/// the seam.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    /// 0..=height.
    pub(super) row: usize,
    /// 0..width.
    pub(super) column: usize,
    /// Share of the cell to the left, 0..=1.
    pub(super) x: f32,
    /// Share of the cell above, 0..=1.
    pub(super) y: f32,
    /// Cosine of the latitude.
    pub(super) cosine: f32,
}

impl Cell {
    /// The cell of a panorama of `width` × `height` pixels that holds a direction of any length.
    #[inline(always)]
    pub(super) fn of(direction: Vec3, width: usize, height: usize) -> Cell {
        let (u, v) = uv(direction);
        let size = direction.length_squared();
        let level = Vec3::new(direction.x, 0.0, direction.z).length_squared();
        let cosine = if size > 0.0 { (level / size).sqrt() } else { 1.0 };
        Cell::at([u, v], cosine, width, height)
    }

    /// The cell at a place of the panorama. u may be past 1 by half a pixel.
    #[inline(always)]
    pub(super) fn at([u, v]: [f32; 2], cosine: f32, width: usize, height: usize) -> Cell {
        // Pixel centres are at i + ½. Both numbers are at least 0, so that cutting off is rounding down.
        let across = u * width as f32 + 0.5;
        let down = v * height as f32 + 0.5;
        let (after, row) = ((across as usize).min(width), (down as usize).min(height));
        let below = down - row as f32;
        Cell {
            row,
            column: if after == 0 { width - 1 } else { after - 1 },
            x: across - after as f32,
            y: match row {
                0 => (2.0 * below - 1.0).clamp(0.0, 1.0),
                row if row == height => (2.0 * below).min(1.0),
                _ => below,
            },
            cosine,
        }
    }
}

/// u and v of a direction, as a panorama has them.
#[inline(always)]
pub(super) fn uv(direction: Vec3) -> (f32, f32) {
    let largest = direction.abs().max_element();
    // A sum, for a maximum passes over what is no number.
    let d = match direction.abs().element_sum() {
        1e-15..=1e15 => direction,
        // Scaled by the largest component, so that neither 1e-30 nor 1e30 leaves the range of f32.
        _ if largest > 0.0 && direction.is_finite() => direction / largest,
        _ => Vec3::ZERO,
    };
    let longitude = arctangent(d.x, d.z);
    let latitude = arctangent(d.y, (d.x * d.x + d.z * d.z).sqrt());
    let u = 0.5 - longitude * (0.5 * std::f32::consts::FRAC_1_PI);
    let v = 0.5 - latitude * std::f32::consts::FRAC_1_PI;
    (u.clamp(0.0, 1.0), v.clamp(0.0, 1.0))
}
