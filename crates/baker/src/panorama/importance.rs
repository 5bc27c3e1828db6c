//! Directions toward what is bright in a panorama, with a density proportional to it.
//!
//! The panorama is bilinear between pixel centres: a [`Cell`] lies between four of them. Cells stand together in blocks, about
//! 2° on a side. Over most blocks the density is even in longitude and latitude, by the mean of their light: so few numbers
//! are read that they stay in the cache. Over the others, those with a sun or an edge, it is bilinear as the light is: so a sun of
//! 1e9 in one pixel is found by construction, and radiance over density varies within a cell by what the cosine of the latitude is
//! off a straight line. Based on: Pharr, Jakob, Humphreys, "Physically Based Rendering", 4th ed., 2023, §2.4 and §A.5.
//!
//! With a bilinear density everywhere a living room under a sky of 1024 x 512 pixels took a seventh more time at the same
//! noise: it waited for memory.

use glam::Vec3;
use std::f64::consts::PI;
use std::ops::Range;

use crate::angle::sine_cosine;

use super::tiles::{TileChoice, Tiles, choose};
use super::{Cell, Panorama, brightness};

/// About so many blocks.
const BLOCKS: usize = 1 << 14;
/// Relative variance of light over density, over all directions, that even blocks may have. At 0.01 that room had 2 % more noise.
const UNEVEN: f64 = 0.003;
/// Number of a block that is even.
const EVEN: u32 = u32::MAX;

/// Density over directions, built once per panorama.
#[derive(Debug, Clone)]
pub struct Importance {
    width: usize,
    height: usize,
    /// Mean of R, G and B per pixel, times the cosine of its latitude: the light of equal steps in longitude and latitude. Upper
    /// half of a float: the density is what it is by these numbers, so that all that their 8 binary digits cost is noise of
    /// 0.1 % of one direction.
    light: Vec<u16>,
    tiles: Tiles,
    /// Share of the light in each tile.
    power: Vec<f64>,
    /// Tiles by their light.
    by_power: TileChoice,
    /// Rows and columns of blocks; no block lies in two tiles.
    down: Cuts,
    across: Cuts,
    /// Of each tile, one behind the other: share of its light above each of its rows of blocks; the last is 1.
    rows: Vec<f64>,
    /// Where a tile's begin.
    first_row: Vec<usize>,
    /// Row by row.
    blocks: Vec<Block>,
    /// Of each block that is not even: share of its light above each of its rows of cells; the last is 1.
    fine_rows: Vec<f64>,
    /// So many shares each.
    fine_stride: usize,
    /// What all light is divided by: of a panorama so many times as bright it is the same to the last digit or so.
    brightest: f32,
    /// Integral of the density before normalisation.
    total: f64,
}

/// A direction that was drawn.
#[derive(Debug, Clone, Copy)]
pub struct Drawn {
    /// Unit.
    pub direction: Vec3,
    /// Per steradian, over all that can be drawn.
    pub density: f32,
    /// Where in the panorama it points.
    pub cell: Cell,
}

/// Cells in a row, cut into the blocks of each tile.
#[derive(Debug, Clone)]
struct Cuts {
    /// Where each block begins, and where the last one ends.
    starts: Vec<u32>,
    /// The block of each cell.
    block_of: Vec<u16>,
    /// The first block of each tile in a row, and the end.
    first_of: Vec<u16>,
}

impl Cuts {
    /// Blocks of at most so many cells.
    fn new(tiles: impl Iterator<Item = Range<usize>>, most: usize) -> Cuts {
        let mut cuts = Cuts { starts: vec![0], block_of: Vec::new(), first_of: vec![0] };
        for cells in tiles {
            let count = cells.len().div_ceil(most);
            for number in 0..count {
                let end = cells.start + (number + 1) * cells.len() / count;
                let block = (cuts.starts.len() - 1) as u16;
                cuts.block_of.resize(end, block);
                cuts.starts.push(end as u32);
            }
            cuts.first_of.push((cuts.starts.len() - 1) as u16);
        }
        cuts
    }

    fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// Cells of a block.
    fn cells(&self, block: usize) -> Range<usize> {
        self.starts[block] as usize..self.starts[block + 1] as usize
    }

    /// Blocks of the tile that stands so far along.
    fn blocks(&self, tile: usize) -> Range<usize> {
        self.first_of[tile].into()..self.first_of[tile + 1].into()
    }
}

/// Some cells that stand together.
#[derive(Debug, Clone, Copy)]
struct Block {
    /// Share of the light of its row of blocks in its tile that lies left of its right edge; of the last block 1. In its own tile
    /// a dim block keeps its digits beside a sun of 1e9.
    share: f32,
    /// Mean light.
    light: f32,
    /// Its number among those that are not even, or [`EVEN`].
    fine: u32,
}

impl Importance {
    /// `None` for a black panorama: nothing in it is worth a ray.
    pub fn new(panorama: &Panorama) -> Option<Importance> {
        let (width, height) = (panorama.width(), panorama.height());
        let cosine = |row: usize| (PI * (0.5 - (row as f64 + 0.5) / height as f64)).cos() as f32;
        let light = panorama.pixels().enumerate().map(|(i, pixel)| brightness(&pixel) * cosine(i / width));
        let brightest = light.clone().fold(0.0, f32::max).max(f32::MIN_POSITIVE);
        let light: Vec<u16> = light.map(|light| upper_half(light / brightest)).collect();
        let tiles = Tiles::new(width, height);
        let most = ((width * height) as f64 / BLOCKS as f64).sqrt().ceil() as usize;
        let mut importance = Importance {
            width,
            height,
            light,
            power: vec![0.0; tiles.len()],
            by_power: TileChoice::new(&tiles, &vec![0.0; tiles.len()]),
            down: Cuts::new((0..tiles.down()).map(|band| tiles.rows(band * tiles.across())), most),
            across: Cuts::new((0..tiles.across()).map(|sector| tiles.columns(sector)), most),
            rows: Vec::new(),
            first_row: Vec::new(),
            blocks: Vec::new(),
            fine_rows: Vec::new(),
            fine_stride: most + 1,
            brightest,
            total: 0.0,
            tiles,
        };
        let integrals = importance.fill_blocks();
        for tile in 0..importance.tiles.len() {
            importance.first_row.push(importance.rows.len());
            importance.power[tile] = importance.fill_tile(tile, &integrals);
        }
        importance.total = importance.power.iter().sum();
        let total = importance.total;
        importance.power.iter_mut().for_each(|power| *power /= total);
        importance.by_power = TileChoice::new(&importance.tiles, &importance.power);
        (total > 0.0 && total.is_finite()).then_some(importance)
    }

    /// Makes all blocks, but for their shares; returns the integral of the light over each.
    fn fill_blocks(&mut self) -> Vec<f64> {
        let mut integrals = Vec::new();
        // What each adds to the variance as long as it is even.
        let mut uneven = Vec::new();
        for row in 0..self.down.len() {
            let rows = self.down.cells(row);
            let height = self.row_top(rows.end) - self.row_top(rows.start);
            for column in 0..self.across.len() {
                let columns = self.across.cells(column);
                let (mut sum, mut squares) = (0.0, 0.0);
                for cell_row in rows.clone() {
                    for cell_column in columns.clone() {
                        let [a, b, c, d] = self.corners(cell_row, cell_column);
                        let mean = 0.25 * (a + b + c + d);
                        // Of the bilinear function: of its mean, its two slopes and its twist.
                        let (x, y, twist) = (b + d - a - c, c + d - a - b, a - b - c + d);
                        let square = mean * mean + (x * x + y * y) / 48.0 + twist * twist / 144.0;
                        let size = self.row_height(cell_row);
                        sum += mean * size;
                        squares += square * size;
                    }
                }
                let [sum, squares] = [sum, squares].map(|sum| sum / self.width as f64);
                let area = height * columns.len() as f64 / self.width as f64;
                let mean = sum / area;
                if sum > 0.0 {
                    uneven.push((squares / mean - sum, self.blocks.len()));
                }
                self.blocks.push(Block { share: 0.0, light: mean as f32, fine: EVEN });
                integrals.push(sum);
            }
        }
        uneven.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let total: f64 = integrals.iter().sum();
        let mut rest: f64 = uneven.iter().map(|(variance, _)| variance).sum();
        for (number, (variance, block)) in uneven.into_iter().enumerate() {
            if rest <= UNEVEN * total {
                break;
            }
            rest -= variance;
            self.blocks[block].fine = number as u32;
            self.fill_fine(block);
        }
        integrals
    }

    /// Shares of the rows of cells of a block.
    fn fill_fine(&mut self, block: usize) {
        let (rows, columns) = self.cells(block / self.across.len(), block % self.across.len());
        let start = self.fine_rows.len();
        let mut sum = 0.0;
        self.fine_rows.push(0.0);
        for row in rows.clone() {
            let line: f64 = columns.clone().map(|column| self.corners(row, column).iter().sum::<f64>()).sum();
            sum += line * self.row_height(row);
            self.fine_rows.push(sum);
        }
        self.fine_rows[start..].iter_mut().for_each(|share| *share /= sum);
        // As many of each.
        self.fine_rows.resize(start + self.fine_stride, 1.0);
    }

    /// Cumulative shares of one tile's rows and columns of blocks; returns its integral.
    fn fill_tile(&mut self, tile: usize, integrals: &[f64]) -> f64 {
        let mut sum = 0.0;
        let start = self.rows.len();
        self.rows.push(0.0);
        for row in self.down.blocks(tile / self.tiles.across()) {
            let line = self.line(row, tile);
            let whole: f64 = integrals[line.clone()].iter().sum();
            let scale = if whole > 0.0 { 1.0 / whole } else { 0.0 };
            let mut along = 0.0;
            for (block, integral) in self.blocks[line.clone()].iter_mut().zip(&integrals[line.clone()]) {
                along += integral;
                block.share = (along * scale).min(1.0) as f32;
            }
            self.blocks[line.end - 1].share = 1.0;
            sum += whole;
            self.rows.push(sum);
        }
        let scale = if sum > 0.0 { 1.0 / sum } else { 0.0 };
        self.rows[start..].iter_mut().for_each(|share| *share *= scale);
        sum
    }

    /// The blocks of a row within a tile.
    fn line(&self, row: usize, tile: usize) -> Range<usize> {
        let columns = self.across.blocks(self.tiles.sector(tile));
        let start = row * self.across.len();
        start + columns.start..start + columns.end
    }

    /// Rows and columns of the cells of a block.
    fn cells(&self, row: usize, column: usize) -> (Range<usize>, Range<usize>) {
        (self.down.cells(row), self.across.cells(column))
    }

    /// The tiles that the sky is cut into.
    pub fn tiles(&self) -> &Tiles {
        &self.tiles
    }

    /// Share of all light in each tile.
    pub fn power(&self) -> &[f64] {
        &self.power
    }

    /// A direction for a point of the unit square.
    pub fn sample(&self, point: [f32; 2]) -> Drawn {
        let (tile, point) = self.by_power.choose(point);
        self.sample_in(tile, point)
    }

    /// A direction in a tile, by the light in it. Its density is that of [`Importance::sample`].
    pub fn sample_in(&self, tile: usize, point: [f64; 2]) -> Drawn {
        // The row, then the block, then the place in it; what is left of each number goes on.
        let rows = self.down.blocks(tile / self.tiles.across());
        let shares = &self.rows[self.first_row[tile]..][..=rows.len()];
        let (row, down) = choose(point[0], rows.len(), |i| shares[i]);
        let row = rows.start + row;
        let line = self.line(row, tile);
        let blocks = &self.blocks[line.clone()];
        let left_of = |i: usize| if i == 0 { 0.0 } else { f64::from(blocks[i - 1].share) };
        let (number, along) = choose(point[1], blocks.len(), left_of);
        let block = blocks[number];
        let (rows, columns) = self.cells(row, line.start + number - row * self.across.len());
        if block.fine != EVEN {
            return self.sample_fine(block.fine, rows, columns, [down, along]);
        }
        let (top, bottom) = (self.row_top(rows.start), self.row_top(rows.end));
        let v = top + (bottom - top) * down;
        let u = (columns.start as f64 + 0.5 + columns.len() as f64 * along) / self.width as f64;
        let (direction, cosine) = direction(u, v);
        Drawn {
            direction,
            density: self.density_at(cosine, block.light.into()),
            cell: Cell::at([u as f32, v as f32], cosine as f32, self.width, self.height),
        }
    }

    /// The same within a block that is not even.
    fn sample_fine(&self, fine: u32, rows: Range<usize>, columns: Range<usize>, [down, along]: [f64; 2]) -> Drawn {
        let shares = &self.fine_rows[fine as usize * self.fine_stride..][..=rows.len()];
        let (row, v) = choose(down, rows.len(), |i| shares[i]);
        let row = rows.start + row;
        let light = |column: usize| self.corners(row, column).iter().sum::<f64>();
        let mut left = along * columns.clone().map(light).sum::<f64>();
        let (mut column, mut u) = (columns.start, 0.5);
        for (next, light) in columns.map(|column| (column, light(column))).filter(|(_, light)| *light > 0.0) {
            (column, u) = (next, (left / light).min(1.0));
            left -= light;
            if left < 0.0 {
                break;
            }
        }
        let [a, b, c, d] = self.corners(row, column);
        let y = linear(v, a + b, c + d);
        let x = linear(u, a + (c - a) * y, b + (d - b) * y);
        let (direction, cosine) =
            direction((column as f64 + 0.5 + x) / self.width as f64, self.row_top(row) + y * self.row_height(row));
        let light = (a + (b - a) * x) * (1.0 - y) + (c + (d - c) * x) * y;
        Drawn {
            direction,
            density: self.density_at(cosine, light),
            cell: Cell { row, column, x: x as f32, y: y as f32, cosine: cosine as f32 },
        }
    }

    /// Density per steradian with which [`Importance::sample`] returns a direction in a cell.
    pub fn density(&self, cell: &Cell) -> f32 {
        let row = usize::from(self.down.block_of[cell.row]);
        let block = self.blocks[row * self.across.len() + usize::from(self.across.block_of[cell.column])];
        let light = if block.fine == EVEN {
            f64::from(block.light)
        } else {
            let [a, b, c, d] = self.corners(cell.row, cell.column);
            let (x, y) = (f64::from(cell.x), f64::from(cell.y));
            (a + (b - a) * x) * (1.0 - y) + (c + (d - c) * x) * y
        };
        self.density_at(cell.cosine.into(), light)
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
    fn corners(&self, row: usize, column: usize) -> [f64; 4] {
        let right = if column + 1 == self.width { 0 } else { column + 1 };
        let line = |row: usize| [column, right].map(|column| f64::from(whole(self.light[row * self.width + column])));
        let [a, b] = if row > 0 { line(row - 1) } else { [0.0; 2] };
        let [c, d] = if row < self.height { line(row) } else { [0.0; 2] };
        [a, b, c, d]
    }

    /// v where a row of cells begins; of the row past the last, where that ends.
    fn row_top(&self, row: usize) -> f64 {
        ((row as f64 - 0.5) / self.height as f64).clamp(0.0, 1.0)
    }

    fn row_height(&self, row: usize) -> f64 {
        self.row_top(row + 1) - self.row_top(row)
    }
}

/// The direction at a place of the panorama, and the cosine of its latitude.
fn direction(u: f64, v: f64) -> (Vec3, f64) {
    let (sin, cos) = sine_cosine(0.25 - 0.5 * v);
    let (across, along) = sine_cosine(0.5 - u);
    (glam::DVec3::new(cos * across, sin, cos * along).as_vec3(), cos)
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
                    sum +=
                        f64::from(importance.density(&panorama.cell(d))) * cos * PI / nv as f64 * 2.0 * PI / nu as f64;
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
                let Drawn { direction, density, cell } = importance.sample(stream.point(i, 0));
                let again = importance.density(&panorama.cell(direction));
                assert!((importance.density(&cell) / density - 1.0).abs() < 1e-4, "{cell:?}");
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
                let Drawn { density, cell, .. } = importance.sample(point);
                important += f64::from(panorama.radiance_in(&cell).y / density) / f64::from(count);
            }
            assert!((uniform / important - 1.0).abs() < 5e-3, "{uniform} {important}");
        }
    }

    #[test]
    fn black_has_no_importance() {
        assert!(Importance::new(&Panorama::new(4, 2, vec![[0.0; 3]; 8], None)).is_none());
    }
}
