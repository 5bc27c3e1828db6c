//! Refuses or repairs samples that are not light: NaN, infinity, negative numbers.

use std::path::Path;

use super::decoded::Decoded;
use crate::panorama::Image;
use crate::{Error, Finding, Result};

/// How an image is read.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ReadOptions {
    /// Replace unusable samples instead of refusing the file: NaN and infinity by the mean of their valid
    /// neighbours, negative radiance by 0, an unusable distance by infinity.
    pub repair_pixels: bool,
    /// The layer of an EXR file to read, by its whole name or its last segments, in any case; `None`: the picture. A
    /// file whose only picture has no name is read as it is.
    pub layer: Option<String>,
}

/// The largest finite half float.
const HALF_MAX: f32 = 65504.0;

/// Beyond this many metres a finite distance means that nothing was hit (Blender writes 1e10).
const FAR: f32 = 1e9;

/// Checks every sample; repairs it if asked to, else refuses the file at the first bad one.
pub(super) fn check(path: &Path, decoded: &mut Decoded, options: &ReadOptions) -> Result<()> {
    check_radiance(path, decoded, options)?;
    check_distance(path, decoded, options)?;
    let half = decoded.half_float;
    let clipped = |pixel: &&[f32; 3]| (0..3).any(|c| half[c] && pixel[c] >= HALF_MAX);
    let count = if half == [false; 3] { 0 } else { decoded.image.pixels.iter().filter(clipped).count() };
    if count > 0 {
        decoded.findings.push(Finding::new(
            "half-float-clipping",
            count as u64,
            format!(
                "{count} pixels are at 65504, where half floats end: brighter light was cut off; use 32-bit floats"
            ),
        ));
    }
    Ok(())
}

/// Bad samples by kind, and the first of them in reading order.
#[derive(Default)]
struct Bad {
    nan: usize,
    infinite: usize,
    negative: usize,
    first: Option<(usize, usize)>,
}

impl Bad {
    fn count(&self) -> usize {
        self.nan + self.infinite + self.negative
    }

    fn add(&mut self, index: usize, channel: usize, value: f32) {
        if value.is_nan() {
            self.nan += 1;
        } else if value < 0.0 && value.is_finite() {
            self.negative += 1;
        } else {
            self.infinite += 1;
        }
        self.first.get_or_insert((index, channel));
    }

    fn refuse(&self, path: &Path, image: &Image, names: &[String; 4], expected: &str) -> Error {
        let (index, channel) = self.first.unwrap_or_default();
        let value = match channel {
            3 => image.distance.as_ref().map_or(f32::NAN, |distance| distance[index]),
            _ => image.pixels[index][channel],
        };
        Error::invalid(
            path,
            format!(
                "channel {} at x {}, y {} is {value}; expected {expected}; in all {} samples are unusable ({} NaN, \
                 {} infinite, {} negative): correct them, or replace them with --repair-pixels",
                names[channel],
                index % image.width,
                index / image.width,
                self.count(),
                self.nan,
                self.infinite,
                self.negative,
            ),
        )
    }
}

fn check_radiance(path: &Path, decoded: &mut Decoded, options: &ReadOptions) -> Result<()> {
    let mut bad = Bad::default();
    for (index, pixel) in decoded.image.pixels.iter().enumerate() {
        for (channel, &value) in pixel.iter().enumerate() {
            if !(value.is_finite() && value >= 0.0) {
                bad.add(index, channel, value);
            }
        }
    }
    if bad.count() == 0 {
        return Ok(());
    }
    if !options.repair_pixels {
        return Err(bad.refuse(path, &decoded.image, &decoded.channel_names, "a finite number >= 0"));
    }
    // Negatives first: a 0 is a valid neighbour.
    for value in decoded.image.pixels.iter_mut().flatten() {
        if value.is_finite() && *value < 0.0 {
            *value = 0.0;
        }
    }
    for channel in 0..3 {
        fill_from_neighbours(&mut decoded.image, channel);
    }
    decoded.findings.push(Finding::new(
        "repaired-pixels",
        bad.count() as u64,
        format!(
            "{} NaN and {} infinite samples took the mean of their neighbours, {} negative ones became 0",
            bad.nan, bad.infinite, bad.negative
        ),
    ));
    Ok(())
}

fn check_distance(path: &Path, decoded: &mut Decoded, options: &ReadOptions) -> Result<()> {
    let Some(distance) = &mut decoded.image.distance else { return Ok(()) };
    let mut bad = Bad::default();
    let mut far = 0;
    for (index, metres) in distance.iter_mut().enumerate() {
        // +infinity is a valid distance: the ray escapes.
        if metres.is_nan() || *metres < 0.0 {
            bad.add(index, 3, *metres);
            if options.repair_pixels {
                *metres = f32::INFINITY;
            }
        } else if *metres >= FAR && *metres < f32::INFINITY {
            far += 1;
            *metres = f32::INFINITY;
        }
    }
    if bad.count() > 0 && !options.repair_pixels {
        let expected = "metres >= 0, or infinity where the ray escapes";
        return Err(bad.refuse(path, &decoded.image, &decoded.channel_names, expected));
    }
    if bad.count() > 0 {
        decoded.findings.push(Finding::new(
            "repaired-distances",
            bad.count() as u64,
            format!("{} distances were NaN or negative and now escape", bad.count()),
        ));
    }
    if far > 0 {
        decoded.findings.push(Finding::new(
            "far-distance-escapes",
            far,
            format!("{far} distances beyond 1e9 m are taken as rays that escape"),
        ));
    }
    Ok(())
}

/// Gives every non-finite sample of a channel the mean of the valid ones in its 3 × 3 neighbourhood. Samples without
/// a valid neighbour wait until their neighbours have a value: the repair grows inwards ring by ring, in time
/// linear in the number of bad samples. A channel without any valid sample becomes 0.
fn fill_from_neighbours(image: &mut Image, channel: usize) {
    const WAITING: u8 = 0;
    const QUEUED: u8 = 1;
    const VALID: u8 = 2;
    let (width, height) = (image.width, image.height);
    let mut state: Vec<u8> =
        image.pixels.iter().map(|p| if p[channel].is_finite() { VALID } else { WAITING }).collect();
    let neighbours = |index: usize| {
        let (x, y) = (index % width, index / width);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        rows.flat_map(move |y| columns.clone().map(move |x| y * width + x))
    };
    // The first ring: bad samples with a valid neighbour.
    let mut ring: Vec<usize> =
        (0..state.len()).filter(|&i| state[i] == WAITING && neighbours(i).any(|n| state[n] == VALID)).collect();
    ring.iter().for_each(|&i| state[i] = QUEUED);
    while !ring.is_empty() {
        // All means of a ring use only what was valid before it.
        let means: Vec<f32> = ring
            .iter()
            .map(|&i| {
                let valid = || neighbours(i).filter(|&n| state[n] == VALID);
                let sum: f64 = valid().map(|n| f64::from(image.pixels[n][channel])).sum();
                (sum / valid().count() as f64) as f32
            })
            .collect();
        for (&i, mean) in ring.iter().zip(means) {
            image.pixels[i][channel] = mean;
            state[i] = VALID;
        }
        let mut next = Vec::new();
        for n in ring.iter().flat_map(|&i| neighbours(i)) {
            if state[n] == WAITING {
                state[n] = QUEUED;
                next.push(n);
            }
        }
        ring = next;
    }
    for (pixel, state) in image.pixels.iter_mut().zip(state) {
        if state == WAITING {
            pixel[channel] = 0.0;
        }
    }
}
