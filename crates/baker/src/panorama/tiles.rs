//! The sphere cut into tiles: bands of latitude times sectors of longitude, along the cells of a lat-long panorama.
//!
//! Coarse enough to learn something about each from a few hundred rays, so that what a place sees can be told tile by tile.

use glam::{DVec3, Vec3};
use std::f64::consts::PI;
use std::ops::Range;

use super::Panorama;
use crate::angle::sine_cosine;

/// Most sectors and bands. About 11° on a side: L2 tells no finer, and 2048 rays are four to a tile.
const MOST: [usize; 2] = [32, 16];

/// A cut of the sphere. Cells are those of [`Importance`](super::Importance): between pixel centres, and half as high
/// above the first and below the last row.
#[derive(Debug, Clone)]
pub struct Tiles {
    /// Pixels per row of the panorama, rows of it.
    width: usize,
    height: usize,
    across: usize,
    down: usize,
    /// Sector of every cell column, band of every cell row.
    sectors: Vec<u8>,
    bands: Vec<u8>,
    /// Sine of the latitude at the upper and the lower edge of every band.
    edges: Vec<[f64; 2]>,
}

/// A cell, and a place in it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cell {
    pub row: usize,
    pub column: usize,
    /// Share of the cell to the left, 0..=1.
    pub x: f64,
    /// Of the whole panorama, 0..=1 from the top.
    pub v: f64,
}

impl Tiles {
    /// For a panorama of `width` × `height` pixels.
    pub fn new(width: usize, height: usize) -> Tiles {
        let (across, down) = (MOST[0].min(width), MOST[1].min(height + 1));
        let of = |cells: usize, parts: usize| {
            (0..parts).flat_map(move |part| std::iter::repeat_n(part as u8, range(part, cells, parts).len())).collect()
        };
        let edge = |row: usize| match row {
            0 => 1.0,
            row if row > height => -1.0,
            row => (PI * (0.5 - (row as f64 - 0.5) / height as f64)).sin(),
        };
        let edges = (0..down).map(|band| range(band, height + 1, down)).map(|rows| [edge(rows.start), edge(rows.end)]);
        Tiles {
            width,
            height,
            across,
            down,
            sectors: of(width, across),
            bands: of(height + 1, down),
            edges: edges.collect(),
        }
    }

    /// How many.
    pub fn len(&self) -> usize {
        self.across * self.down
    }

    /// Never.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// How many sectors.
    pub fn across(&self) -> usize {
        self.across
    }

    /// The sector of a tile.
    pub fn sector(&self, tile: usize) -> usize {
        tile % self.across
    }

    /// Cell rows of a tile.
    pub fn rows(&self, tile: usize) -> Range<usize> {
        range(tile / self.across, self.height + 1, self.down)
    }

    /// Cell columns of a tile.
    pub fn columns(&self, tile: usize) -> Range<usize> {
        range(tile % self.across, self.width, self.across)
    }

    /// The tile that holds a direction.
    pub fn of(&self, direction: Vec3) -> usize {
        let cell = self.cell(direction);
        self.of_cell(cell.row, cell.column)
    }

    /// The tile that holds a cell.
    pub(super) fn of_cell(&self, row: usize, column: usize) -> usize {
        self.bands[row] as usize * self.across + self.sectors[column] as usize
    }

    /// The cell that holds a direction.
    pub(super) fn cell(&self, direction: Vec3) -> Cell {
        let (u, v) = Panorama::uv(direction);
        let v = f64::from(v);
        let px = f64::from(u) * self.width as f64 - 0.5;
        // At least -1/2.
        let after = (px + 1.0) as usize;
        Cell {
            row: ((v * self.height as f64 + 0.5) as usize).min(self.height),
            column: if after == 0 { self.width - 1 } else { (after - 1) % self.width },
            x: (px + 1.0) - after as f64,
            v,
        }
    }

    /// Share of the sphere, 0..=1: sectors times heights (Archimedes).
    pub fn solid_angle_share(&self, tile: usize) -> f64 {
        let [top, bottom] = self.edges[tile / self.across];
        (top - bottom) * 0.5 * self.columns(tile).len() as f64 / self.width as f64
    }

    /// A direction in a tile, uniform over its solid angle.
    pub fn uniform_in(&self, tile: usize, [down, across]: [f64; 2]) -> Vec3 {
        let [top, bottom] = self.edges[tile / self.across];
        let sin = top + (bottom - top) * down;
        let cos = (1.0 - sin * sin).max(0.0).sqrt();
        let columns = self.columns(tile);
        let column = columns.start as f64 + 0.5 + columns.len() as f64 * across;
        let (across, along) = sine_cosine(0.5 - column / self.width as f64);
        DVec3::new(cos * across, sin, cos * along).as_vec3()
    }

    /// Tiles that share an edge with one; over the poles there is none.
    pub fn neighbours(&self, tile: usize) -> impl Iterator<Item = usize> {
        let (x, y) = (tile % self.across, tile / self.across);
        let at = move |x: usize, y: usize| y * self.across + x % self.across;
        let aside = (self.across > 1).then(|| [at(x + 1, y), at(x + self.across - 1, y)]);
        let above = (y > 0).then(|| at(x, y - 1));
        let below = (y + 1 < self.down).then(|| at(x, y + 1));
        aside.into_iter().flatten().chain(above).chain(below)
    }
}

/// The cells of one part of several.
fn range(part: usize, cells: usize, parts: usize) -> Range<usize> {
    part * cells / parts..(part + 1) * cells / parts
}

/// A choice among tiles, each with a probability of its own.
#[derive(Debug, Clone)]
pub struct TileChoice {
    across: usize,
    /// `bands[j]`: probability of all bands above band j; the last is 1.
    bands: Vec<f64>,
    /// Of each band: probability, given the band, of the sectors left of each; the last is 1.
    sectors: Vec<f64>,
}

impl TileChoice {
    /// Probabilities in proportion to `weights`, one per tile, none negative. If all are zero, `choose` may not be asked.
    pub fn new(tiles: &Tiles, weights: &[f64]) -> TileChoice {
        let mut choice = TileChoice { across: tiles.across, bands: vec![0.0], sectors: Vec::new() };
        let mut sum = 0.0;
        for band in weights.chunks_exact(tiles.across) {
            let total: f64 = band.iter().sum();
            sum += total;
            choice.bands.push(sum);
            let mut along = 0.0;
            choice.sectors.push(0.0);
            choice.sectors.extend(band.iter().map(|weight| {
                along += weight;
                if total > 0.0 { (along / total).min(1.0) } else { 0.0 }
            }));
        }
        if sum > 0.0 {
            choice.bands.iter_mut().for_each(|band| *band /= sum);
        }
        choice
    }

    /// The tile for a point of the unit square, and what is left of the point within it.
    pub fn choose(&self, point: [f32; 2]) -> (usize, [f64; 2]) {
        let (band, down) = choose(point[0].into(), self.bands.len() - 1, |i| self.bands[i]);
        let sectors = &self.sectors[band * (self.across + 1)..][..=self.across];
        let (sector, along) = choose(point[1].into(), self.across, |i| sectors[i]);
        (band * self.across + sector, [down, along])
    }
}

/// The interval of a cumulative distribution (`cumulative(0) = 0` … `cumulative(count) = 1`) that holds `point`, and
/// where in it, 0..1. Never an empty interval.
pub(super) fn choose(point: f64, count: usize, cumulative: impl Fn(usize) -> f64) -> (usize, f64) {
    // First index whose upper end lies beyond the point.
    let (mut low, mut high) = (0, count - 1);
    while low < high {
        let middle = (low + high) / 2;
        if cumulative(middle + 1) > point { high = middle } else { low = middle + 1 }
    }
    let (start, end) = (cumulative(low), cumulative(low + 1));
    (low, if end > start { ((point - start) / (end - start)).clamp(0.0, 1.0) } else { 0.5 })
}
