//! Directions toward what is bright in a panorama, with a density proportional to it.
//!
//! The panorama is bilinear between pixel centres, so the density over longitude and latitude is, too: a *cell* lies between
//! four centres (half a cell high above the first and below the last row). A cell is chosen by its integral, a place within
//! by the bilinear function of the light at its corners. So a sun of 1e9 in one pixel is found by construction, and the
//! ratio of radiance to density varies within a cell by what the cosine of the latitude is off a straight line. Based on: Pharr, Jakob, Humphreys, "Physically Based
//! Rendering", 4th ed., 2023, §2.4 and §A.5.

use glam::Vec3;
use std::f64::consts::PI;

use crate::angle::sine_cosine;

use super::tiles::{Cell, TileChoice, Tiles, choose};
use super::{Panorama, brightness};

/// Density over directions, built once per panorama.
#[derive(Debug, Clone)]
pub struct Importance {
    width: usize,
    height: usize,
    /// Mean of R, G and B per pixel, times the cosine of its latitude: the light of equal steps in longitude and latitude. Upper
    /// half of a float: the density is what it is by these numbers, so that all that their 8 binary digits cost is noise of 0.1 % of one
    /// direction, and twice as many lie in the cache.
    light: Vec<u16>,
    tiles: Tiles,
    /// Share of the light in each tile.
    power: Vec<f64>,
    /// Tiles by their light.
    by_power: TileChoice,
    /// Of each tile, one behind the other: share of its light above each of its cell rows; the last is 1.
    rows: Vec<f64>,
    /// Where a tile's begin.
    first_row: Vec<usize>,
    /// Of each cell row and each tile in it: share of that light left of each cell; the last is 1. In its own tile a dim
    /// cell keeps its digits beside a sun of 1e9.
    columns: Vec<f32>,
    /// What all light is divided by: of a panorama so many times as bright it is the same to the last digit or so.
    brightest: f32,
    /// Integral of the density before normalisation.
    total: f64,
}

impl Importance {
    /// `None` for a black panorama: nothing in it is worth a ray.
    pub fn new(panorama: &Panorama) -> Option<Importance> {
        let (width, height) = (panorama.width(), panorama.height());
        let cosine = |row: usize| (PI * (0.5 - (row as f64 + 0.5) / height as f64)).cos() as f32;
        let light = panorama.pixels().enumerate().map(|(i, pixel)| brightness(&pixel) * cosine(i / width));
        let brightest = light.clone().fold(0.0, f32::max).max(f32::MIN_POSITIVE);
        let light = light.map(|light| upper_half(light / brightest)).collect();
        let tiles = Tiles::new(width, height);
        let columns = vec![0.0; (height + 1) * (width + tiles.across())];
        let mut importance = Importance {
            width,
            height,
            light,
            power: vec![0.0; tiles.len()],
            by_power: TileChoice::new(&tiles, &vec![0.0; tiles.len()]),
            rows: Vec::new(),
            first_row: Vec::new(),
            columns,
            brightest,
            total: 0.0,
            tiles,
        };
        for tile in 0..importance.tiles.len() {
            importance.first_row.push(importance.rows.len());
            importance.power[tile] = importance.fill_tile(tile);
        }
        importance.total = importance.power.iter().sum();
        let total = importance.total;
        importance.power.iter_mut().for_each(|power| *power /= total);
        importance.by_power = TileChoice::new(&importance.tiles, &importance.power);
        (total > 0.0 && total.is_finite()).then_some(importance)
    }

    /// Cumulative shares of one tile's rows and columns; returns its integral.
    fn fill_tile(&mut self, tile: usize) -> f64 {
        let mut sum = 0.0;
        let start = self.rows.len();
        self.rows.push(0.0);
        for row in self.tiles.rows(tile) {
            let line = self.line(row, tile);
            let mut along = 0.0;
            let mut cumulative = vec![0.0];
            for column in self.tiles.columns(tile) {
                along += self.corners(row, column).map(f64::from).iter().sum::<f64>();
                cumulative.push(along);
            }
            let scale = if along > 0.0 { 1.0 / along } else { 0.0 };
            let shares = self.columns[line].iter_mut().zip(cumulative);
            shares.for_each(|(share, sum)| *share = (sum * scale).min(1.0) as f32);
            sum += along * 0.25 / self.width as f64 * self.row_height(row);
            self.rows.push(sum);
        }
        let scale = if sum > 0.0 { 1.0 / sum } else { 0.0 };
        self.rows[start..].iter_mut().for_each(|share| *share *= scale);
        sum
    }

    /// Where the columns of a cell row within a tile are kept.
    fn line(&self, row: usize, tile: usize) -> std::ops::Range<usize> {
        let columns = self.tiles.columns(tile);
        let start = row * (self.width + self.tiles.across()) + columns.start + self.tiles.sector(tile);
        start..start + columns.len() + 1
    }

    /// The tiles that the sky is cut into.
    pub fn tiles(&self) -> &Tiles {
        &self.tiles
    }

    /// Share of all light in each tile.
    pub fn power(&self) -> &[f64] {
        &self.power
    }

    /// A direction for a point of the unit square, and its density per steradian.
    pub fn sample(&self, point: [f32; 2]) -> (Vec3, f32) {
        let (tile, point) = self.by_power.choose(point);
        self.sample_in(tile, point)
    }

    /// A direction in a tile, by the light in it, and the density per steradian that [`Importance::sample`] returns it with.
    pub fn sample_in(&self, tile: usize, point: [f64; 2]) -> (Vec3, f32) {
        // The row, then the cell, then the place in it; what is left of each number goes on.
        let rows = self.tiles.rows(tile);
        let shares = &self.rows[self.first_row[tile]..][..=rows.len()];
        let (row, v) = choose(point[0], rows.len(), |i| shares[i]);
        let row = rows.start + row;
        let columns = self.tiles.columns(tile);
        let shares = &self.columns[self.line(row, tile)];
        let (column, u) = choose(point[1], columns.len(), |i| f64::from(shares[i]));
        let column = columns.start + column;
        let [a, b, c, d] = self.corners(row, column).map(f64::from);
        let y = linear(v, a + b, c + d);
        let x = linear(u, a + (c - a) * y, b + (d - b) * y);
        let (top, height) = (self.row_top(row), self.row_height(row));
        let (sin, cos) = sine_cosine(0.25 - 0.5 * (top + y * height));
        let (across, along) = sine_cosine(0.5 - (column as f64 + 0.5 + x) / self.width as f64);
        let direction = glam::DVec3::new(cos * across, sin, cos * along).as_vec3();
        let light = (a + (b - a) * x) * (1.0 - y) + (c + (d - c) * x) * y;
        (direction, self.density_at(cos, light))
    }

    /// Density per steradian with which [`Importance::sample`] returns `direction`.
    pub fn density(&self, direction: Vec3) -> f32 {
        self.density_and_tile(direction).0
    }

    /// The same, and the tile that holds `direction`.
    pub fn density_and_tile(&self, direction: Vec3) -> (f32, usize) {
        let Cell { row, column, x, v } = self.tiles.cell(direction);
        let y = ((v - self.row_top(row)) / self.row_height(row)).clamp(0.0, 1.0);
        let [a, b, c, d] = self.corners(row, column).map(f64::from);
        let light = (a + (b - a) * x) * (1.0 - y) + (c + (d - c) * x) * y;
        let density = self.density_at(sine_cosine(0.25 - 0.5 * v).1, light);
        (density, self.tiles.of_cell(row, column))
    }

    /// Mean of the radiance over the sphere.
    pub fn mean(&self) -> f64 {
        // ∫ L dω = 2π² ∫∫ L cos(latitude) du dv, over 4π.
        0.5 * PI * self.total * f64::from(self.brightest)
    }

    /// p(u, v) = light / total; p(ω) = p(u, v) / (2π² cos(latitude)).
    fn density_at(&self, cosine: f64, light: f64) -> f32 {
        (light / self.total / (2.0 * PI * PI * cosine.max(1e-12))) as f32
    }

    /// Light at the corners of a cell: upper left, upper right, lower left, lower right. At the poles there is none.
    fn corners(&self, row: usize, column: usize) -> [f32; 4] {
        let right = if column + 1 == self.width { 0 } else { column + 1 };
        let line = |row: usize| [row * self.width + column, row * self.width + right].map(|i| whole(self.light[i]));
        let [a, b] = if row > 0 { line(row - 1) } else { [0.0; 2] };
        let [c, d] = if row < self.height { line(row) } else { [0.0; 2] };
        [a, b, c, d]
    }

    /// v where a row of cells begins.
    fn row_top(&self, row: usize) -> f64 {
        if row == 0 { 0.0 } else { (row as f64 - 0.5) / self.height as f64 }
    }

    fn row_height(&self, row: usize) -> f64 {
        let cells = if row == 0 || row == self.height { 0.5 } else { 1.0 };
        cells / self.height as f64
    }
}

/// The half of a float's bits that has its exponent, rounded.
fn upper_half(value: f32) -> u16 {
    ((value.to_bits() + (1 << 15)) >> 16) as u16
}

fn whole(upper_half: u16) -> f32 {
    f32::from_bits(u32::from(upper_half) << 16)
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
