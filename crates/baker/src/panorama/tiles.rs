//! The sphere cut into tiles: bands of latitude times sectors of longitude, along the cells of a lat-long panorama.
//!
//! Coarse enough to learn something about each from a few hundred rays, so that what a place sees can be told tile by tile.

use glam::{DVec3, Vec3};
use std::f64::consts::PI;
use std::ops::Range;

use super::Cell;
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
    solid_angle_shares: Vec<f64>,
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
        let edges: Vec<[f64; 2]> = edges.collect();
        // Sectors times heights (Archimedes).
        let share = |tile: usize| {
            let [top, bottom] = edges[tile / across];
            (top - bottom) * 0.5 * range(tile % across, width, across).len() as f64 / width as f64
        };
        Tiles {
            width,
            height,
            across,
            down,
            sectors: of(width, across),
            bands: of(height + 1, down),
            solid_angle_shares: (0..across * down).map(share).collect(),
            edges,
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

    /// How many bands.
    pub fn down(&self) -> usize {
        self.down
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

    /// The cell that holds a direction of any length.
    pub fn cell(&self, direction: Vec3) -> Cell {
        Cell::of(direction, self.width, self.height)
    }

    /// The tile that holds a cell.
    pub fn of(&self, cell: &Cell) -> usize {
        self.bands[cell.row] as usize * self.across + self.sectors[cell.column] as usize
    }

    /// Share of the sphere, 0..=1, of every tile.
    pub fn solid_angle_shares(&self) -> &[f64] {
        &self.solid_angle_shares
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

    /// Of every tile what it has, and `share` of what the tiles have that share an edge with it; over the poles there is none.
    pub fn blur(&self, values: &[[f64; 3]], share: f64) -> Vec<[f64; 3]> {
        let mut blurred = values.to_vec();
        let mut add = |to: usize, from: &[f64; 3]| {
            blurred[to].iter_mut().zip(from).for_each(|(sum, more)| *sum += share * more);
        };
        for (row, band) in values.chunks_exact(self.across).enumerate() {
            let first = row * self.across;
            for (sector, own) in band.iter().enumerate() {
                if self.across > 1 {
                    add(first + if sector + 1 == self.across { 0 } else { sector + 1 }, own);
                    add(first + if sector == 0 { self.across - 1 } else { sector - 1 }, own);
                }
                if row > 0 {
                    add(first + sector - self.across, own);
                }
                if row + 1 < self.down {
                    add(first + sector + self.across, own);
                }
            }
        }
        blurred
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
        let mut bands = Vec::with_capacity(tiles.down + 1);
        let mut sectors = Vec::with_capacity(tiles.down * (tiles.across + 1));
        let mut sum = 0.0;
        for band in weights.chunks_exact(tiles.across) {
            bands.push(sum);
            let total: f64 = band.iter().sum();
            sum += total;
            let scale = if total > 0.0 { 1.0 / total } else { 0.0 };
            let mut along = 0.0;
            sectors.extend(band.iter().map(|weight| {
                let left = along;
                along += weight;
                left * scale
            }));
            sectors.push(1.0);
        }
        bands.push(sum);
        if sum > 0.0 {
            bands.iter_mut().for_each(|band| *band /= sum);
        }
        TileChoice { across: tiles.across, bands, sectors }
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
