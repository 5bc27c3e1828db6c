//! Directions toward what is bright in a panorama, with a density proportional to it.
//!
//! The panorama is bilinear between pixel centres, so the density is, too: a *cell* lies between four centres (half
//! a cell high above the first and below the last row). A cell is chosen by its integral, a place within by the
//! bilinear function of its corners. So a sun of 1e9 in one pixel is found by construction, and the ratio of
//! radiance to density varies by the tilt of one cell alone. Based on: Pharr, Jakob, Humphreys, "Physically Based
//! Rendering", 4th ed., 2023, §2.4 and §A.5.

use glam::Vec3;
use std::f64::consts::PI;

use super::Panorama;

/// Density over directions, built once per panorama.
#[derive(Debug, Clone)]
pub struct Importance {
    width: usize,
    height: usize,
    /// Mean of R, G and B per pixel.
    brightness: Vec<f32>,
    /// `rows[j]`: share of all light above cell row j; `height + 2` entries, the last is 1.
    rows: Vec<f64>,
    /// `columns[j][i]`: share of row j's light left of cell i; `width + 1` entries per row.
    columns: Vec<f32>,
    /// Integral of the density before normalisation.
    total: f64,
}

impl Importance {
    /// `None` for a black panorama: nothing in it is worth a ray.
    pub fn new(panorama: &Panorama) -> Option<Importance> {
        let (width, height) = (panorama.width(), panorama.height());
        let brightness: Vec<f32> = panorama.pixels().iter().map(|p| (p[0] + p[1] + p[2]) / 3.0).collect();
        let mut importance = Importance { width, height, brightness, rows: vec![0.0], columns: Vec::new(), total: 0.0 };
        let mut sum = 0.0;
        for row in 0..=height {
            let mut along = 0.0;
            importance.columns.push(0.0);
            let start = importance.columns.len();
            for column in 0..width {
                let [a, b, c, d] = importance.corners(row, column);
                along += f64::from(a) + f64::from(b) + f64::from(c) + f64::from(d);
                importance.columns.push(along as f32);
            }
            let scale = if along > 0.0 { 1.0 / along } else { 0.0 };
            importance.columns[start..].iter_mut().for_each(|c| *c = (f64::from(*c) * scale).min(1.0) as f32);
            sum += along * 0.25 / width as f64 * importance.row_height(row) * importance.row_cosine(row);
            importance.rows.push(sum);
        }
        importance.rows.iter_mut().for_each(|r| *r /= sum);
        importance.total = sum;
        (sum > 0.0 && sum.is_finite()).then_some(importance)
    }

    /// A direction for a point of the unit square, and its density per steradian.
    pub fn sample(&self, point: [f32; 2]) -> (Vec3, f32) {
        // The row, then the cell, then the place in it; what is left of each number goes on.
        let (row, v) = choose(point[0].into(), self.height + 1, |i| self.rows[i]);
        let line = &self.columns[row * (self.width + 1)..(row + 1) * (self.width + 1)];
        let (column, u) = choose(point[1].into(), self.width, |i| f64::from(line[i]));
        let [a, b, c, d] = self.corners(row, column).map(f64::from);
        let y = linear(v, a + b, c + d);
        let x = linear(u, a + (c - a) * y, b + (d - b) * y);
        let (top, height) = (self.row_top(row), self.row_height(row));
        let latitude = PI * (0.5 - (top + y * height));
        let longitude = 2.0 * PI * (0.5 - (column as f64 + 0.5 + x) / self.width as f64);
        let (sin, cos) = latitude.sin_cos();
        let direction = glam::DVec3::new(cos * longitude.sin(), sin, cos * longitude.cos()).as_vec3();
        let brightness = (a + (b - a) * x) * (1.0 - y) + (c + (d - c) * x) * y;
        (direction, self.density_at(row, cos, brightness))
    }

    /// Density per steradian with which [`Importance::sample`] returns `direction`.
    pub fn density(&self, direction: Vec3) -> f32 {
        let (u, v) = Panorama::uv(direction);
        let row = ((f64::from(v) * self.height as f64 + 0.5) as usize).min(self.height);
        let px = f64::from(u) * self.width as f64 - 0.5;
        let column = px.floor().rem_euclid(self.width as f64) as usize % self.width;
        let x = px - px.floor();
        let y = ((f64::from(v) - self.row_top(row)) / self.row_height(row)).clamp(0.0, 1.0);
        let [a, b, c, d] = self.corners(row, column).map(f64::from);
        let brightness = (a + (b - a) * x) * (1.0 - y) + (c + (d - c) * x) * y;
        self.density_at(row, (PI * (0.5 - f64::from(v))).cos(), brightness)
    }

    /// p(u, v) = brightness · cos(latitude of the row's middle) / total; p(ω) = p(u, v) / (2π² cos(latitude)).
    fn density_at(&self, row: usize, cosine: f64, brightness: f64) -> f32 {
        let flat = brightness * self.row_cosine(row) / self.total;
        (flat / (2.0 * PI * PI * cosine.max(1e-12))) as f32
    }

    /// Brightness at the corners of a cell: upper left, upper right, lower left, lower right.
    fn corners(&self, row: usize, column: usize) -> [f32; 4] {
        let upper = row.max(1) - 1;
        let lower = row.min(self.height - 1);
        let right = if column + 1 == self.width { 0 } else { column + 1 };
        [
            upper * self.width + column,
            upper * self.width + right,
            lower * self.width + column,
            lower * self.width + right,
        ]
        .map(|i| self.brightness[i])
    }

    /// v where a row of cells begins.
    fn row_top(&self, row: usize) -> f64 {
        if row == 0 { 0.0 } else { (row as f64 - 0.5) / self.height as f64 }
    }

    fn row_height(&self, row: usize) -> f64 {
        let cells = if row == 0 || row == self.height { 0.5 } else { 1.0 };
        cells / self.height as f64
    }

    fn row_cosine(&self, row: usize) -> f64 {
        (PI * (0.5 - (self.row_top(row) + self.row_height(row) / 2.0))).cos()
    }
}

/// The interval of a cumulative distribution (`cumulative(0) = 0` … `cumulative(count) = 1`) that holds `point`, and
/// where in it, 0..1. Never an empty interval.
fn choose(point: f64, count: usize, cumulative: impl Fn(usize) -> f64) -> (usize, f64) {
    // First index whose upper end lies beyond the point.
    let (mut low, mut high) = (0, count - 1);
    while low < high {
        let middle = (low + high) / 2;
        if cumulative(middle + 1) > point { high = middle } else { low = middle + 1 }
    }
    let (start, end) = (cumulative(low), cumulative(low + 1));
    (low, if end > start { ((point - start) / (end - start)).clamp(0.0, 1.0) } else { 0.5 })
}

/// Inverse of the cumulative of a density that runs linearly from `a` to `b` over 0..=1.
fn linear(point: f64, a: f64, b: f64) -> f64 {
    if a + b <= 0.0 {
        return point;
    }
    // x = u (a + b) / (a + sqrt((1-u) a² + u b²)): stable for a = b and for a = 0.
    let root = ((1.0 - point) * a * a + point * b * b).sqrt();
    if a + root <= 0.0 { 0.0 } else { (point * (a + b) / (a + root)).clamp(0.0, 1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{Sampler, Stream, uniform_sphere};

    fn panorama(width: usize, height: usize, bright: &[(usize, usize, f32)]) -> Panorama {
        let mut pixels: Vec<[f32; 3]> =
            (0..width * height).map(|i| [0.5 + (i % 7) as f32, 0.2, (i % 3) as f32]).collect();
        for &(x, y, value) in bright {
            pixels[y * width + x] = [value; 3];
        }
        Panorama::new(width, height, pixels, None)
    }

    fn cases() -> Vec<Panorama> {
        vec![
            panorama(1, 1, &[]),
            panorama(2, 1, &[(1, 0, 100.0)]),
            panorama(5, 3, &[(0, 0, 1e3), (4, 2, 1e4)]),
            panorama(64, 32, &[(0, 0, 1e5), (63, 31, 1e5)]),
            panorama(64, 32, &[(0, 16, 1e9)]),
            panorama(64, 32, &[(63, 16, 1e5), (20, 1, 50.0)]),
        ]
    }

    #[test]
    fn density_integrates_to_one_over_the_sphere() {
        for panorama in cases() {
            let importance = Importance::new(&panorama).unwrap();
            // Midpoint rule in (cos-weighted) latitude and longitude, finer than the cells by 16.
            let (nu, nv) = (panorama.width() * 16, panorama.height() * 32);
            let mut sum = 0.0;
            for j in 0..nv {
                let latitude = PI * (0.5 - (j as f64 + 0.5) / nv as f64);
                for i in 0..nu {
                    let longitude = 2.0 * PI * (0.5 - (i as f64 + 0.5) / nu as f64);
                    let (sin, cos) = latitude.sin_cos();
                    let d = glam::DVec3::new(cos * longitude.sin(), sin, cos * longitude.cos()).as_vec3();
                    sum += f64::from(importance.density(d)) * cos * PI / nv as f64 * 2.0 * PI / nu as f64;
                }
            }
            assert!((sum - 1.0).abs() < 2e-3, "{sum} for {} x {}", panorama.width(), panorama.height());
        }
    }

    #[test]
    fn samples_have_the_density_they_state() {
        for panorama in cases() {
            let importance = Importance::new(&panorama).unwrap();
            let stream = Stream::new(Sampler::Sobol, 0, 0, 0);
            for i in 0..2000 {
                let (direction, density) = importance.sample(stream.point(i, 0));
                let again = importance.density(direction);
                assert!(density > 0.0 && density.is_finite());
                // In f32 a direction moves by 1e-7, which beside a sun of 1e9 in one pixel counts.
                assert!((again / density - 1.0).abs() < 0.02 || density < 1e-3, "{density} {again}");
            }
        }
    }

    #[test]
    fn importance_and_uniform_sampling_agree() {
        // ∫ L dω by both; Sobol, 2^16 points each.
        for panorama in [panorama(64, 32, &[(20, 9, 300.0)]), panorama(5, 3, &[(0, 0, 40.0)])] {
            let importance = Importance::new(&panorama).unwrap();
            let stream = Stream::new(Sampler::Sobol, 1, 0, 0);
            let count = 1 << 16;
            let (mut uniform, mut important) = (0.0, 0.0);
            for i in 0..count {
                let point = stream.point(i, 0);
                uniform += f64::from(panorama.radiance(uniform_sphere(point)).y) * 4.0 * PI / f64::from(count);
                let (direction, density) = importance.sample(point);
                important += f64::from(panorama.radiance(direction).y / density) / f64::from(count);
            }
            assert!((uniform / important - 1.0).abs() < 5e-3, "{uniform} {important}");
        }
    }

    #[test]
    fn black_has_no_importance() {
        assert!(Importance::new(&Panorama::new(4, 2, vec![[0.0; 3]; 8], None)).is_none());
    }
}
