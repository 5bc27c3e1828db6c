//! Lat-long panoramas, and how radiance is read from them.
//!
//! Orientation (OpenEXR's), directions in the probe's own axes, right-handed with Y up:
//!
//! ```text
//!            u = 0.5 - atan2(x, z) / 2π,   v = 0.5 - asin(y) / π,   pixel centres at ((i + ½) / W, (j + ½) / H)
//!
//!    u: 0        0.25       0.5       0.75        1
//!       +----------+----------+----------+--------+  v = 0    +Y (the whole upper edge)
//!      -Z         +X         +Z         -X       -Z  v = 0.5  the horizon
//!       +----------+----------+----------+--------+  v = 1    -Y
//! ```
//!
//! Between pixel centres radiance is bilinear; u wraps, v clamps. This reconstruction *is* the panorama: truth,
//! importance and solid angles use it. Where the panorama has a distance per pixel, a lookup of a surface mixes
//! only pixels that saw that surface ([`Panorama::radiance_on_plane`]), and a lookup of the outside only pixels
//! that see the outside ([`Panorama::radiance_escaping`]).
//!
//! Other layouts ([`Mapping`]) are converted once, at import, by [`to_lat_long`].

mod cell;
mod convert;
mod grid;
mod image;
mod importance;
mod mapping;
mod sun;
mod texels;
mod tiles;
#[cfg(test)]
mod tolerance;

use std::f64::consts::PI;

use glam::{Vec3, Vec4};

pub use cell::Cell;
pub use convert::{from_lat_long, to_lat_long};
pub(crate) use grid::PixelGrid;
pub use image::Image;
pub use importance::{Drawn, Importance};
pub use mapping::{Mapping, guess_from_aspect};
pub use sun::{Sun, take_out_sun};
pub use tiles::{TileChoice, Tiles};

use texels::Texels;

/// Mean of R, G and B.
pub(crate) fn brightness(rgb: &[f32; 3]) -> f32 {
    (rgb[0] + rgb[1] + rgb[2]) / 3.0
}

/// A lat-long panorama in gdibl's orientation; see the module for the mapping.
#[derive(Debug, Clone)]
pub struct Panorama {
    width: usize,
    height: usize,
    /// Row by row from +Y down.
    texels: Texels,
    has_distances: bool,
    /// (sin, cos) of the longitude atan2(x, z) at the centre of each column.
    longitude: Vec<[f32; 2]>,
    /// (sin, cos) of the latitude asin(y) at the centre of each row.
    latitude: Vec<[f32; 2]>,
}

/// One pixel of a bilinear lookup.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tap {
    /// `y * width + x`.
    pub index: usize,
    /// Column.
    pub x: usize,
    /// Row.
    pub y: usize,
    /// 0..=1; the four weights of a lookup sum to 1.
    pub weight: f32,
}

/// How far a pixel's distance may lie from the tangent plane of the surface that is looked up, relative, for the
/// pixel to count as having seen that surface. Tuned, by the test in `tolerance.rs`, for panoramas 128 to 512 wide
/// of a textured box with a sphere, half-float distances, and geometry that is up to 3 % off: mean error of a lookup
/// was 6.6 % at 0.001, 4.4 % at 0.01, 3.8 % at 0.02, **3.6 % at 0.03**, 3.9 % at 0.05, 4.4 % at 0.15, and 5.8 % when
/// every finite pixel lends.
pub(crate) const PLANE_TOLERANCE: f32 = 0.03;

impl Panorama {
    /// A panorama of `width` × `height` pixels, rows from +Y down. `radiance`: linear Rec.709, finite, >= 0.
    /// `distance`: metres along the ray of each pixel, +infinity where it escapes, or `None` where unknown.
    ///
    /// Panics when a size is zero or a length does not match: files are checked at import.
    pub fn new(width: usize, height: usize, radiance: Vec<[f32; 3]>, distance: Option<Vec<f32>>) -> Self {
        Self::of(&Image { width, height, pixels: radiance, distance })
    }

    /// The same of an image in this layout.
    fn of(Image { width, height, pixels, distance }: &Image) -> Self {
        let (width, height) = (*width, *height);
        assert!(width > 0 && height > 0, "a panorama needs pixels: {width} x {height}");
        assert_eq!(pixels.len(), width * height, "radiance of a {width} x {height} panorama");
        if let Some(distance) = distance {
            assert_eq!(distance.len(), width * height, "distance of a {width} x {height} panorama");
            debug_assert!(distance.iter().all(|z| *z >= 0.0), "a distance is negative or NaN");
        }
        debug_assert!(
            pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0),
            "a radiance is negative or not finite"
        );
        let sin_cos = |angle: f64| [angle.sin() as f32, angle.cos() as f32];
        let longitude = (0..width).map(|x| sin_cos(2.0 * PI * (0.5 - (x as f64 + 0.5) / width as f64))).collect();
        let latitude = (0..height).map(|y| sin_cos(PI * (0.5 - (y as f64 + 0.5) / height as f64))).collect();
        let texels = Texels::new(pixels, distance.as_deref());
        Panorama { width, height, texels, has_distances: distance.is_some(), longitude, latitude }
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row by row from +Y down; linear Rec.709 radiance.
    pub fn pixels(&self) -> impl ExactSizeIterator<Item = [f32; 3]> + Clone {
        (0..self.width * self.height).map(|index| self.pixel_number(index))
    }

    /// The same panorama with other pixels: what `change` makes of each. They must be finite and >= 0.
    pub fn with_pixels(&self, mut change: impl FnMut(usize, [f32; 3]) -> [f32; 3]) -> Panorama {
        let radiance = self.pixels().enumerate().map(|(index, pixel)| change(index, pixel)).collect();
        Panorama::new(self.width, self.height, radiance, self.distances().map(Iterator::collect))
    }

    /// Multiplies all pixels, channel by channel.
    pub fn tint(&mut self, gains: [f32; 3]) {
        self.texels.tint(gains);
    }

    /// Metres along the ray per pixel, +infinity where it escapes; `None` for a panorama without distance.
    pub fn distances(&self) -> Option<impl ExactSizeIterator<Item = f32> + Clone> {
        self.has_distances.then(|| (0..self.width * self.height).map(|index| self.texel(index).w))
    }

    /// Radiance of pixel (x, y).
    pub fn pixel(&self, x: usize, y: usize) -> Vec3 {
        self.texel(y * self.width + x).truncate()
    }

    /// Distance of pixel (x, y), metres along its ray; `None` for a panorama without distance.
    pub fn pixel_distance(&self, x: usize, y: usize) -> Option<f32> {
        self.has_distances.then(|| self.texel(y * self.width + x).w)
    }

    /// Radiance of a pixel by its place among all.
    pub(crate) fn pixel_number(&self, index: usize) -> [f32; 3] {
        self.texel(index).truncate().to_array()
    }

    fn texel(&self, index: usize) -> Vec4 {
        self.texels.at([index])[0]
    }

    /// Unit direction through the centre of pixel (x, y).
    pub fn pixel_direction(&self, x: usize, y: usize) -> Vec3 {
        let [sin_longitude, cos_longitude] = self.longitude[x];
        let [sin_latitude, cos_latitude] = self.latitude[y];
        Vec3::new(sin_longitude * cos_latitude, sin_latitude, cos_longitude * cos_latitude)
    }

    /// Solid angle of a pixel of row `y`, sr: exact, and the same for the whole row. All pixels sum to 4π.
    ///
    /// Ω = 2π/W (sin θ_upper - sin θ_lower) = 2π/W · 2 cos θ_centre sin(π / 2H): no cancellation at the poles.
    pub fn pixel_solid_angle(&self, y: usize) -> f64 {
        let centre = PI * (0.5 - (y as f64 + 0.5) / self.height as f64);
        2.0 * PI / self.width as f64 * 2.0 * centre.cos() * (PI / (2.0 * self.height as f64)).sin()
    }

    /// (u, v) of a direction of any length, u and v in 0..=1 (u = 1 is the seam again). Total: a pole has u = 0.5,
    /// and so has the zero vector, with v = 0.5; a vector that is not finite counts as zero.
    pub fn uv(direction: Vec3) -> (f32, f32) {
        cell::uv(direction)
    }

    /// The pixel that holds `direction`.
    pub fn pixel_at(&self, direction: Vec3) -> (usize, usize) {
        let (u, v) = Self::uv(direction);
        let x = (u * self.width as f32) as usize % self.width; // u = 1 is column 0
        let y = ((v * self.height as f32) as usize).min(self.height - 1);
        (x, y)
    }

    /// The four pixels around `direction` and their bilinear weights; u wraps, v clamps.
    pub fn taps(&self, direction: Vec3) -> [Tap; 4] {
        let (u, v) = Self::uv(direction);
        // Pixel centres are at i + ½.
        let px = u * self.width as f32 - 0.5;
        let py = (v * self.height as f32 - 0.5).clamp(0.0, (self.height - 1) as f32);
        // Both are at least 0 here, so that cutting off is rounding down: for that processors have an instruction from the start.
        let (after, y0) = ((px + 1.0) as usize, py as usize);
        let (fx, fy) = ((px + 1.0) - after as f32, py - y0 as f32);
        let x0 = if after == 0 { self.width - 1 } else { (after - 1).min(self.width - 1) };
        let x1 = if x0 + 1 == self.width { 0 } else { x0 + 1 };
        let y1 = (y0 + 1).min(self.height - 1);
        let tap = |x: usize, y: usize, weight: f32| Tap { index: y * self.width + x, x, y, weight };
        [
            tap(x0, y0, (1.0 - fx) * (1.0 - fy)),
            tap(x1, y0, fx * (1.0 - fy)),
            tap(x0, y1, (1.0 - fx) * fy),
            tap(x1, y1, fx * fy),
        ]
    }

    /// The cell that holds a direction of any length.
    pub fn cell(&self, direction: Vec3) -> Cell {
        Cell::of(direction, self.width, self.height)
    }

    /// Radiance along `direction`, bilinear, whatever the distances: for panoramas at infinity.
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        self.radiance_in(&self.cell(direction))
    }

    /// The same along a direction in a cell.
    pub fn radiance_in(&self, cell: &Cell) -> Vec3 {
        let Cell { row, column, x, y, .. } = *cell;
        let right = if column + 1 == self.width { 0 } else { column + 1 };
        // Past the first and the last row nothing changes.
        let [above, below] = [row.saturating_sub(1), row.min(self.height - 1)].map(|row| row * self.width);
        let [a, b, c, d] = self.texels.at([above + column, above + right, below + column, below + right]);
        let mean = |left: Vec4, right: Vec4, share: f32| left.truncate() * (1.0 - share) + right.truncate() * share;
        mean(a, b, x) * (1.0 - y) + mean(c, d, x) * y
    }

    /// Radiance that comes along `direction` from outside: only pixels whose ray escapes lend, so that an opening
    /// does not take on the colour of its frame. `None` where none of the four pixels escapes. Without distances:
    /// [`Panorama::radiance`].
    pub fn radiance_escaping(&self, direction: Vec3) -> Option<Vec3> {
        if !self.has_distances {
            return Some(self.radiance(direction));
        }
        let (taps, texels) = self.taps_and_texels(direction);
        mean_of(&taps, &texels, texels.map(|texel| texel.w == f32::INFINITY))
    }

    /// Radiance of a surface point that this panorama sees along the unit `direction`, `distance` metres away, where
    /// the surface has the unit `normal` (either side; both vectors in the probe's own axes).
    ///
    /// Only pixels that saw the same surface lend. The ray of a pixel with direction `t` meets the tangent plane at
    /// `expected = distance · (n·direction) / (n·t)`; the pixel saw the surface if its own distance is within
    /// `PLANE_TOLERANCE` of that. If no pixel did, the finite one that comes closest lends alone; `None` if all
    /// four escape. Without distances: [`Panorama::radiance`].
    pub fn radiance_on_plane(&self, direction: Vec3, distance: f32, normal: Vec3) -> Option<Vec3> {
        self.radiance_on_plane_within(direction, distance, normal, PLANE_TOLERANCE)
    }

    fn radiance_on_plane_within(&self, direction: Vec3, distance: f32, normal: Vec3, tolerance: f32) -> Option<Vec3> {
        if !self.has_distances {
            return Some(self.radiance(direction));
        }
        let (taps, texels) = self.taps_and_texels(direction);
        let along = distance * normal.dot(direction);
        let expected = along / self.dot_directions(&taps, normal);
        // At a grazing angle a neighbour's ray may miss the plane: then only the distances themselves compare.
        let meets = expected.cmpgt(Vec4::ZERO) & expected.is_finite_mask();
        let reference = Vec4::select(meets, expected, Vec4::splat(distance));
        let seen = Vec4::from(texels.map(|texel| texel.w));
        let off = (seen / reference - 1.0).abs();
        // How far each pixel is from having seen the surface; infinity for a pixel that escapes. A reference of zero, or NaN
        // from the caller, still has to leave an order; f32::MAX is "worst".
        let error = Vec4::select(off.is_finite_mask(), off, Vec4::splat(f32::MAX));
        let error = Vec4::select(seen.cmpeq(Vec4::INFINITY), Vec4::INFINITY, error).to_array();
        if let Some(mean) = mean_of(&taps, &texels, error.map(|error| error < tolerance)) {
            return Some(mean);
        }
        let closest = (0..4).filter(|&i| error[i] < f32::INFINITY).min_by(|&a, &b| {
            // Ties go to the heavier tap.
            error[a].total_cmp(&error[b]).then(taps[b].weight.total_cmp(&taps[a].weight))
        })?;
        Some(texels[closest].truncate())
    }

    /// The cosine, for a unit `normal`, with the directions of the four pixels.
    #[inline(always)]
    fn dot_directions(&self, taps: &[Tap; 4], normal: Vec3) -> Vec4 {
        let [left, right] = [taps[0].x, taps[1].x].map(|x| self.longitude[x]);
        let [upper, lower] = [taps[0].y, taps[2].y].map(|y| self.latitude[y]);
        let level = Vec4::new(upper[1], upper[1], lower[1], lower[1]);
        let x = Vec4::new(left[0], right[0], left[0], right[0]) * level;
        let y = Vec4::new(upper[0], upper[0], lower[0], lower[0]);
        let z = Vec4::new(left[1], right[1], left[1], right[1]) * level;
        normal.x * x + normal.y * y + normal.z * z
    }

    #[inline(always)]
    fn taps_and_texels(&self, direction: Vec3) -> ([Tap; 4], [Vec4; 4]) {
        let taps = self.taps(direction);
        (taps, self.texels.at(taps.map(|tap| tap.index)))
    }
}

/// Weighted mean over the taps that count, their weights renormalised; `None` if none counts.
#[inline(always)]
fn mean_of(taps: &[Tap; 4], texels: &[Vec4; 4], counts: [bool; 4]) -> Option<Vec3> {
    let weights: [f32; 4] = std::array::from_fn(|i| if counts[i] { taps[i].weight } else { 0.0 });
    let sum_by = |weights: [f32; 4]| {
        weights.iter().zip(texels).fold(Vec3::ZERO, |sum, (weight, texel)| sum + *weight * texel.truncate())
    };
    let weight = weights[0] + weights[1] + weights[2] + weights[3];
    if weight > f32::MIN_POSITIVE {
        return Some(sum_by(weights) / weight);
    }
    // The direction is exactly that of a pixel which does not count: its neighbours lend equally. Quarters, so that four of the
    // largest number do not overflow.
    let quarters = counts.map(|counts| if counts { 0.25 } else { 0.0 });
    let count: f32 = quarters.iter().sum();
    (count > 0.0).then(|| sum_by(quarters) / count)
}
