//! Bright spots of surfaces: what stands out of a probe's panorama, a small lamp or a glint, as triangles where its rays meet
//! the environment, so that rays are sent there as they are to emissive triangles.
//!
//! Nodes learn from about 2000 first rays what is bright around them: enough for what takes some share of the sphere, not for
//! a lamp. With one of 256 × 128 pixels of a probe 1e5 times as bright as the rest, E was off by 95 % at 1024 directions, and
//! its standard error claimed 40 %. With spots it is off by 0.7 % (`tools/extremes`): cells in 4 parts gave 4.0, in 16 parts
//! 1.8 %, because light within a cell goes from one bright pixel to none. Where nothing stands out, nothing changes.

use glam::{Mat3, Vec3};
use std::f64::consts::PI;

use crate::panorama::Panorama;

/// How many times a probe's mean radiance a spot must exceed. A light of the size that 2048 rays find four times, and so
/// bright, would be a sixteenth of all.
const STANDS_OUT: f32 = 32.0;
/// Cells of one probe that may become spots, 128 triangles each: those that bring most light.
const MOST: usize = 64;
/// A cell on an edge or at a grazing angle is cut in four, this many times.
const CUTS: u32 = 3;
/// Corners of a spot may be this many times as far from the probe as its middle, or as near.
const STRETCH: f32 = 2.0;

/// A triangle that is drawn.
#[derive(Debug, Clone, Copy)]
pub(super) struct Spot {
    /// Trace space; the front faces the probe.
    pub corners: [Vec3; 3],
    /// Mean over the triangle and over R, G, B.
    pub radiance: f32,
}

/// A probe, for whom spots are sought.
pub(super) struct Eye<'a> {
    pub panorama: &'a Panorama,
    /// Trace space.
    pub position: Vec3,
    pub to_world: Mat3,
    /// Radiance = pixel × gain.
    pub gain: f32,
}

/// Part of a panorama: u and v of its edges, and brightness in its corners, upper left, upper right, lower left, lower right.
#[derive(Debug, Clone, Copy)]
struct Patch {
    u: [f64; 2],
    v: [f64; 2],
    values: [f32; 4],
}

/// The spots of a probe. `meets(direction)`: place and unit normal of the surface that a ray from the probe meets.
pub(super) fn bright_spots(eye: &Eye, meets: impl Fn(Vec3) -> Option<(Vec3, Vec3)>) -> Vec<Spot> {
    let mut spots = Vec::new();
    // Parts, because light is uneven within a cell: from one bright pixel to none.
    for part in bright_cells(eye.panorama).iter().flat_map(in_parts) {
        add(eye, &part, CUTS, &meets, &mut spots);
    }
    spots
}

/// Cells between pixel centres (half as high above the first and below the last row) that stand out, in their order.
fn bright_cells(panorama: &Panorama) -> Vec<Patch> {
    let (width, height) = (panorama.width(), panorama.height());
    let brightness = |x: usize, y: usize| panorama.pixels()[y * width + x % width].iter().sum::<f32>() / 3.0;
    let of_row =
        |y: usize| (0..width).map(|x| f64::from(brightness(x, y))).sum::<f64>() * panorama.pixel_solid_angle(y);
    let mean = (0..height).map(of_row).sum::<f64>() / (4.0 * PI);
    let limit = (mean * f64::from(STANDS_OUT)) as f32;
    let mut cells = Vec::new();
    for row in 0..=height {
        let (upper, lower) = (row.max(1) - 1, row.min(height - 1));
        let v = [row as f64 - 0.5, row as f64 + 0.5].map(|row| (row / height as f64).clamp(0.0, 1.0));
        let share = (PI * (0.5 - v[0])).sin() - (PI * (0.5 - v[1])).sin();
        for x in 0..width {
            let values = [(x, upper), (x + 1, upper), (x, lower), (x + 1, lower)].map(|(x, y)| brightness(x, y));
            let own = values.iter().sum::<f32>() / 4.0;
            if own > limit {
                let u = [x as f64 + 0.5, x as f64 + 1.5].map(|column| column / width as f64);
                cells.push((f64::from(own) * share, Patch { u, v, values }));
            }
        }
    }
    // Stable: of equals the first.
    cells.sort_by(|a, b| b.0.total_cmp(&a.0));
    cells.truncate(MOST);
    cells.into_iter().map(|(_, patch)| patch).collect()
}

/// Lays a patch on the plane of the surface in its middle; where its corners do not fit there, in four parts.
fn add(eye: &Eye, patch: &Patch, cuts: u32, meets: &impl Fn(Vec3) -> Option<(Vec3, Vec3)>, spots: &mut Vec<Spot>) {
    let [u, v] = [patch.u, patch.v].map(|edges| 0.5 * (edges[0] + edges[1]));
    let corners = meets(direction(eye, u, v)).and_then(|(place, normal)| {
        let height = normal.dot(place - eye.position);
        let middle = (place - eye.position).length();
        let on_plane = |u: f64, v: f64| {
            let direction = direction(eye, u, v);
            let distance = height / normal.dot(direction);
            let fits = distance > middle / STRETCH && distance < middle * STRETCH;
            fits.then(|| eye.position + direction * distance)
        };
        let [left, right] = patch.u;
        let [top, bottom] = patch.v;
        Some([on_plane(left, top)?, on_plane(right, top)?, on_plane(left, bottom)?, on_plane(right, bottom)?])
    });
    let Some(corners) = corners else {
        if cuts > 0 {
            quarters(patch).iter().for_each(|part| add(eye, part, cuts - 1, meets, spots));
        }
        return;
    };
    // Two halves, each with its right angle first and the corner that it lacks last.
    for [a, b, c, d] in [[0, 1, 2, 3], [3, 2, 1, 0]] {
        let [mut p, mut q, r] = [a, b, c].map(|i| corners[i]);
        if (q - p).cross(r - p).dot(eye.position - p) < 0.0 {
            (p, q) = (q, p);
        }
        // The mean of what is bilinear over the patch: by its corners alone a half beside the light would be dark.
        let [near, aside, other, far] = [a, b, c, d].map(|i| patch.values[i]);
        let radiance = (5.0 * near + 3.0 * (aside + other) + far) / 12.0 * eye.gain;
        spots.push(Spot { corners: [p, q, r], radiance });
    }
}

/// 64 parts.
fn in_parts(patch: &Patch) -> impl Iterator<Item = Patch> + use<> {
    let quarters_of = |patch: Patch| quarters(&patch).into_iter();
    quarters_of(*patch).flat_map(quarters_of).flat_map(quarters_of)
}

fn quarters(patch: &Patch) -> [Patch; 4] {
    let [a, b, c, d] = patch.values;
    let [top, left, right, bottom] = [(a, b), (a, c), (b, d), (c, d)].map(|(p, q)| 0.5 * (p + q));
    let middle = 0.5 * (top + bottom);
    let [u, v] = [patch.u, patch.v].map(|[from, to]| [[from, 0.5 * (from + to)], [0.5 * (from + to), to]]);
    [
        Patch { u: u[0], v: v[0], values: [a, top, left, middle] },
        Patch { u: u[1], v: v[0], values: [top, b, middle, right] },
        Patch { u: u[0], v: v[1], values: [left, middle, c, bottom] },
        Patch { u: u[1], v: v[1], values: [middle, right, bottom, d] },
    ]
}

fn direction(eye: &Eye, u: f64, v: f64) -> Vec3 {
    let (longitude, latitude) = (2.0 * PI * (0.5 - u), PI * (0.5 - v));
    let local = [longitude.sin() * latitude.cos(), latitude.sin(), longitude.cos() * latitude.cos()];
    eye.to_world * Vec3::from_array(local.map(|c| c as f32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spots_cover_what_stands_out_as_seen_from_the_probe() {
        // In a room of 2 × 2 × 2: in a wall, over an edge, at both poles, over the seam.
        for (x, y) in [(20, 9), (8, 16), (3, 0), (30, 31), (0, 15), (63, 15)] {
            let mut pixels = vec![[1.0; 3]; 64 * 32];
            pixels[y * 64 + x] = [1e6; 3];
            let panorama = Panorama::new(64, 32, pixels, None);
            let position = Vec3::new(0.3, -0.2, 0.1);
            let eye = Eye { panorama: &panorama, position, to_world: Mat3::from_rotation_y(0.4), gain: 2.0 };
            let spots = bright_spots(&eye, |direction| {
                let walls = (0..3).map(|axis| (1f32.copysign(direction[axis]) - position[axis]) / direction[axis]);
                let (axis, t) = walls.enumerate().min_by(|a, b| a.1.total_cmp(&b.1))?;
                let normal = Vec3::AXES[axis] * -direction[axis].signum();
                Some((position + direction * t, normal))
            });
            // Its light: 2e6 × the solid angle of the pixel. Σ L A cosθ / d².
            let light: f64 = spots
                .iter()
                .map(|spot| {
                    let [a, b, c] = spot.corners;
                    let normal = (b - a).cross(c - a) * 0.5;
                    let line = position - (a + b + c) / 3.0;
                    assert!(normal.dot(line) >= 0.0, "it faces the probe");
                    f64::from(spot.radiance * normal.dot(line) / line.length().powi(3))
                })
                .sum();
            let expected = 2e6 * panorama.pixel_solid_angle(y);
            let tolerance = if y == 0 || y == 31 { 0.5 } else { 0.05 };
            assert!((light / expected - 1.0).abs() < tolerance, "{x} {y}: {light}, expected {expected}");
        }
    }

    #[test]
    fn nothing_stands_out_of_an_even_or_black_panorama() {
        for value in [0.0, 1.0] {
            assert!(bright_cells(&Panorama::new(16, 8, vec![[value; 3]; 128], None)).is_empty());
        }
    }
}
