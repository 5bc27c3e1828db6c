//! A plane across a volume, as a picture.

use glam::DVec3;
use rayon::prelude::*;

use super::volume::VolumeLight;
use crate::panorama::Image;

/// The plane on which one coordinate is `at` (world metres), over the volume's box: `longest` pixels along its longer side. Along x
/// the picture shows z to the right and y up, along y x to the right and z down (a plan), along z x to the right and y up. Pixels are
/// light without a direction, or figures.
pub fn slice(light: &VolumeLight, axis: usize, at: f64, longest: usize) -> Image {
    let header = light.volume.header();
    let [min, max] = [header.min, header.max].map(DVec3::from);
    let (across, up) = [(2, 1), (0, 2), (0, 1)][axis];
    let size = max - min;
    let scale = longest as f64 / size[across].max(size[up]).max(f64::MIN_POSITIVE);
    let [width, height] = [across, up].map(|k| ((size[k] * scale).round() as usize).clamp(1, longest));
    let pixel = |index: usize| {
        let (x, y) = ((index % width) as f64 + 0.5, (index / width) as f64 + 0.5);
        let mut share = DVec3::ZERO;
        share[across] = x / width as f64;
        // Rows go down, and so does z in a plan.
        share[up] = if axis == 1 { y / height as f64 } else { 1.0 - y / height as f64 };
        let mut position = min + share * size;
        position[axis] = at;
        light.everywhere(position).to_array()
    };
    Image::new(width, height, (0..width * height).into_par_iter().map(pixel).collect())
}
