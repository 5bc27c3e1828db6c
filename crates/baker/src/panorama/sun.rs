//! A sun in a panorama: found, measured, and taken out.
//!
//! A sun is one small, very bright cluster of pixels: all of it within [`RADIUS`] of its middle, brighter than
//! [`FAR_ABOVE`] times the ring around it, and worth [`NOTABLE`] of what falls on a surface that faces it. The brightest
//! places are asked first, and the one that gives most is taken: a glint may be brighter than a clipped sun.
//!
//! ```text
//!        . . . . . .                 pixels of the cluster turn into the light of its rim, by distance:
//!        . r r r r .                 what is left has no hole and no step
//!        . r S S r .   r  rim
//!        . r S S r .                 E = Σ Ω_i (L_i - rim_i) cosθ_i,   Ω_i = ∫ of pixel i's bilinear weight
//!        . r r r r .
//! ```
//! The solid angle of a pixel is that of the panorama's own reconstruction: bilinear, clamped at the poles.

use glam::Vec3;
use std::collections::{BTreeSet, HashMap, HashSet, VecDeque};
use std::f64::consts::PI;

use super::{Panorama, brightness};

/// No part of a sun is farther than this from its middle, radians: 2.5°. The sun itself has 0.27°; clipped and veiled ones
/// look larger.
const RADIUS: f32 = 0.0436;
/// In a coarse panorama, in pixels: 2 × 2 fit, 3 × 3 do not.
const RADIUS_PIXELS: f32 = 1.25;
/// Times the median brightness of the ring from one to two radii. Of a clear day's sun (kloppenheim_05, 1k) the cluster is
/// then 0.6° in radius; 1° would add 1 % to its irradiance and 2.5° 2 %, which is the sky's own glow.
const FAR_ABOVE: f32 = 10.0;
/// Share of E on a surface that faces it. That sun has 80 %, the brightest lamp of a square at night 10 %.
const NOTABLE: f64 = 0.2;
/// Bright places that are looked at.
const CANDIDATES: usize = 8;

/// A sun as a directional light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sun {
    /// Unit vector toward it.
    pub direction: Vec3,
    /// On a surface that faces it, linear Rec.709.
    pub irradiance: Vec3,
    /// Of a disc all as bright as its brightest pixel that gives this irradiance, radians.
    pub angular_diameter: f32,
}

/// The sun, in the panorama's own axes, and the panorama without it. `None` where nothing is one.
pub fn take_out_sun(panorama: &Panorama) -> Option<(Sun, Panorama)> {
    let search = Search::new(panorama);
    let best = search.brightest_cluster()?;
    let all: f64 = search.irradiance(best.sun.direction, |index| search.brightness[index]);
    if f64::from(brightness(&best.sun.irradiance.to_array())) < NOTABLE * all {
        return None;
    }
    let behind: HashMap<usize, [f32; 3]> = best.behind.into_iter().collect();
    let rest = panorama.with_pixels(|index, pixel| behind.get(&index).copied().unwrap_or(pixel));
    Some((best.sun, rest))
}

/// A cluster, and what its pixels show once it is gone.
struct Cluster {
    sun: Sun,
    behind: Vec<(usize, [f32; 3])>,
}

struct Search<'a> {
    panorama: &'a Panorama,
    /// Mean of R, G and B.
    brightness: Vec<f32>,
    /// Solid angle of a pixel of each row.
    solid_angles: Vec<f64>,
    radius: f32,
}

impl<'a> Search<'a> {
    fn new(panorama: &'a Panorama) -> Search<'a> {
        let height = panorama.height();
        let pixel = PI as f32 / height as f32;
        Search {
            panorama,
            brightness: panorama.pixels().map(|pixel| brightness(&pixel)).collect(),
            solid_angles: (0..height).map(|row| solid_angle(panorama.width(), height, row)).collect(),
            radius: RADIUS.max(RADIUS_PIXELS * pixel),
        }
    }

    /// The cluster of most irradiance.
    fn brightest_cluster(&self) -> Option<Cluster> {
        let mut best: Option<Cluster> = None;
        // Looked at already.
        let mut spent = vec![false; self.brightness.len()];
        for _ in 0..CANDIDATES {
            let left = (0..self.brightness.len()).filter(|&i| !spent[i] && self.brightness[i] > 0.0);
            // Of equally bright ones the first.
            let Some(peak) = left.reduce(|a, b| if self.brightness[b] > self.brightness[a] { b } else { a }) else {
                break;
            };
            let found = self.cluster_at(peak);
            for (index, _) in self.disc(self.direction(peak), self.radius) {
                spent[index] = true;
            }
            if let Some(found) = found {
                found.behind.iter().for_each(|(index, _)| spent[*index] = true);
                let given = |cluster: &Cluster| brightness(&cluster.sun.irradiance.to_array());
                if best.as_ref().is_none_or(|best| given(&found) > given(best)) {
                    best = Some(found);
                }
            }
        }
        best
    }

    /// The cluster around a bright pixel; `None` where it is no small one.
    fn cluster_at(&self, peak: usize) -> Option<Cluster> {
        // From the peak, which may be on its edge, to its middle; then strictly.
        let loose = self.grow(peak, self.direction(peak), 2.0 * self.radius)?;
        let middle = self.middle(loose.iter().map(|&i| (i, self.brightness[i])))?;
        let cluster = self.grow(peak, middle, self.radius)?;
        let rim = self.rim(&cluster);
        if rim.is_empty() {
            return None;
        }
        let behind: Vec<(usize, [f32; 3])> = cluster.iter().map(|&index| (index, self.behind(index, &rim))).collect();
        let taken = |(index, behind): &(usize, [f32; 3])| (*index, self.brightness[*index] - brightness(behind));
        let direction = self.middle(behind.iter().map(taken))?;
        let mut irradiance = [0.0f64; 3];
        let (mut total, mut brightest) = (0.0, 0.0f32);
        for (index, light) in &behind {
            let facing =
                self.solid_angles[index / self.panorama.width()] * f64::from(self.direction(*index).dot(direction));
            let pixel = self.panorama.pixel_number(*index);
            (0..3).for_each(|c| irradiance[c] += facing * f64::from(pixel[c] - light[c]));
            total += facing * f64::from(self.brightness[*index] - brightness(light));
            brightest = brightest.max(self.brightness[*index] - brightness(light));
        }
        let disc = total / f64::from(brightest);
        let sun = Sun {
            direction,
            irradiance: Vec3::from_array(irradiance.map(|e| e as f32)),
            angular_diameter: 2.0 * (disc / PI).sqrt() as f32,
        };
        (total > 0.0).then_some(Cluster { sun, behind })
    }

    /// Pixels far above the ring around `middle` that hang together with `peak`; `None` if they reach farther than `limit`.
    fn grow(&self, peak: usize, middle: Vec3, limit: f32) -> Option<Vec<usize>> {
        let inside = self.radius.cos();
        let mut ring: Vec<f32> = self
            .disc(middle, 2.0 * self.radius)
            .filter(|(_, cosine)| *cosine < inside)
            .map(|(index, _)| self.brightness[index])
            .collect();
        if ring.is_empty() {
            return None;
        }
        let half = ring.len() / 2;
        let threshold = FAR_ABOVE * *ring.select_nth_unstable_by(half, f32::total_cmp).1;
        if self.brightness[peak] <= threshold {
            return None;
        }
        let limit = limit.cos();
        let mut cluster = vec![peak];
        let mut known = HashSet::from([peak]);
        let mut next = VecDeque::from([peak]);
        while let Some(index) = next.pop_front() {
            for neighbour in self.neighbours(index) {
                if self.brightness[neighbour] > threshold && known.insert(neighbour) {
                    if self.direction(neighbour).dot(middle) < limit {
                        return None;
                    }
                    cluster.push(neighbour);
                    next.push_back(neighbour);
                }
            }
        }
        Some(cluster)
    }

    /// Pixels beside the cluster.
    fn rim(&self, cluster: &[usize]) -> Vec<usize> {
        let inside: HashSet<usize> = cluster.iter().copied().collect();
        let beside = cluster.iter().flat_map(|&index| self.neighbours(index)).filter(|index| !inside.contains(index));
        // In the order of pixels, so that sums are the same on every run.
        beside.collect::<BTreeSet<usize>>().into_iter().collect()
    }

    /// What a pixel of the cluster shows without it: the rim by solid angle over squared distance; never more than it did.
    fn behind(&self, index: usize, rim: &[usize]) -> [f32; 3] {
        let here = self.direction(index);
        let (mut sum, mut weights) = ([0.0f64; 3], 0.0);
        for &other in rim {
            let distance = f64::from(self.direction(other).distance_squared(here)).max(1e-12);
            let weight = self.solid_angles[other / self.panorama.width()] / distance;
            let pixel = self.panorama.pixel_number(other);
            (0..3).for_each(|c| sum[c] += weight * f64::from(pixel[c]));
            weights += weight;
        }
        let pixel = self.panorama.pixel_number(index);
        std::array::from_fn(|c| ((sum[c] / weights) as f32).min(pixel[c]))
    }

    /// The mean direction of pixels by light; `None` without any.
    fn middle(&self, light: impl Iterator<Item = (usize, f32)>) -> Option<Vec3> {
        let weigh = |(index, light): (usize, f32)| {
            self.direction(index).as_dvec3() * (self.solid_angles[index / self.panorama.width()] * f64::from(light))
        };
        light.map(weigh).sum::<glam::DVec3>().try_normalize().map(|d| d.as_vec3())
    }

    /// ∫ light max(cosθ, 0) dω on a surface that faces `direction`.
    fn irradiance(&self, direction: Vec3, light: impl Fn(usize) -> f32) -> f64 {
        let pixel = |index: usize| {
            let cosine = self.direction(index).dot(direction).max(0.0);
            self.solid_angles[index / self.panorama.width()] * f64::from(light(index) * cosine)
        };
        (0..self.brightness.len()).map(pixel).sum()
    }

    fn direction(&self, index: usize) -> Vec3 {
        self.panorama.pixel_direction(index % self.panorama.width(), index / self.panorama.width())
    }

    /// Pixels whose centre is within `radius` of `middle`, with the cosine of their angle to it.
    fn disc(&self, middle: Vec3, radius: f32) -> impl Iterator<Item = (usize, f32)> + '_ {
        let (width, height) = (self.panorama.width(), self.panorama.height());
        let row = |latitude: f32| (0.5 - f64::from(latitude) / PI) * height as f64;
        let latitude = middle.y.clamp(-1.0, 1.0).asin();
        let first = row(latitude + radius).floor().max(0.0) as usize;
        let last = (row(latitude - radius).ceil().max(0.0) as usize).min(height);
        let least = radius.cos();
        let pixels = (first..last).flat_map(move |y| (0..width).map(move |x| y * width + x));
        pixels.map(move |index| (index, self.direction(index).dot(middle))).filter(move |(_, cosine)| *cosine >= least)
    }

    /// The eight pixels around one; u wraps, and beyond a pole is its other side.
    fn neighbours(&self, index: usize) -> impl Iterator<Item = usize> + use<> {
        let (width, height) = (self.panorama.width(), self.panorama.height());
        let (x, y) = (index % width, index / width);
        let places = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1), (2, 2)];
        places.into_iter().map(move |(across, down)| {
            let x = x + width + across - 1;
            match (y + down).checked_sub(1) {
                None => (x + width / 2) % width,
                Some(y) if y == height => (height - 1) * width + (x + width / 2) % width,
                Some(y) => y * width + x % width,
            }
        })
    }
}

/// Solid angle, sr, of the bilinear weight of a pixel of row `row`: 2π/W ∫ tent cos dlatitude, and all of what lies
/// between the first or last row and the pole.
fn solid_angle(width: usize, height: usize, row: usize) -> f64 {
    let step = PI / height as f64;
    let latitude = PI * 0.5 - step * (row as f64 + 0.5);
    // ∫_0^h (1 - t/h) cos(latitude ± t) dt = even cos(latitude) ∓ odd sin(latitude)
    let (even, odd) = ((1.0 - step.cos()) / step, 1.0 - step.sin() / step);
    let up = match row {
        0 => 1.0 - latitude.sin(),
        _ => even * latitude.cos() - odd * latitude.sin(),
    };
    let down = match row + 1 == height {
        true => 1.0 + latitude.sin(),
        false => even * latitude.cos() + odd * latitude.sin(),
    };
    2.0 * PI / width as f64 * (up + down)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::fibonacci_sphere;

    const SKY: [f32; 3] = [0.3, 0.5, 0.9];

    fn sky(width: usize, light: impl Fn(Vec3) -> [f32; 3]) -> Panorama {
        let grid = Panorama::new(width, width / 2, vec![[0.0; 3]; width * width / 2], None);
        let pixels = (0..width * width / 2).map(|i| light(grid.pixel_direction(i % width, i / width))).collect();
        Panorama::new(width, width / 2, pixels, None)
    }

    /// Adds a sun of one pixel.
    fn with_pixel(panorama: Panorama, x: usize, y: usize, radiance: f32) -> Panorama {
        let bright = y * panorama.width() + x;
        let sun = [radiance, 0.9 * radiance, 0.8 * radiance];
        panorama.with_pixels(|index, pixel| if index == bright { sun } else { pixel })
    }

    /// ∫ (L - sky) dω of the reconstruction, by brute force around (x, y).
    fn integral(panorama: &Panorama) -> f64 {
        let (nu, nv) = (panorama.width() * 8, panorama.height() * 16);
        let mut sum = 0.0;
        for j in 0..nv {
            let latitude = PI * (0.5 - (j as f64 + 0.5) / nv as f64);
            let (sin, cos) = latitude.sin_cos();
            for i in 0..nu {
                let longitude = 2.0 * PI * (0.5 - (i as f64 + 0.5) / nu as f64);
                let d = glam::DVec3::new(cos * longitude.sin(), sin, cos * longitude.cos()).as_vec3();
                sum += f64::from(panorama.radiance(d).x - SKY[0]) * cos;
            }
        }
        sum * PI / nv as f64 * 2.0 * PI / nu as f64
    }

    #[test]
    fn solid_angles_of_the_reconstruction_fill_the_sphere() {
        for height in [1, 2, 3, 16, 511] {
            let sum: f64 = (0..height).map(|row| 7.0 * solid_angle(7, height, row)).sum();
            assert!((sum / (4.0 * PI) - 1.0).abs() < 1e-9, "{height}: {sum}");
        }
    }

    #[test]
    fn sun_in_one_pixel_is_measured_anywhere() {
        // Seam, poles, in between; weak and unclipped. What it gives is the integral of its pixel's bilinear weight.
        for (x, y) in [(0, 20), (127, 33), (64, 1), (40, 0), (3, 63), (77, 40)] {
            for radiance in [1e5, 1e9] {
                let panorama = with_pixel(sky(128, |_| SKY), x, y, radiance);
                let (sun, rest) = take_out_sun(&panorama).unwrap_or_else(|| panic!("({x}, {y}) {radiance}"));
                let truth = integral(&panorama);
                assert!((f64::from(sun.irradiance.x) / truth - 1.0).abs() < 0.01, "({x}, {y}): {sun:?}, {truth}");
                assert!((sun.irradiance.z / sun.irradiance.x - 0.8).abs() < 1e-3);
                let away = sun.direction.angle_between(panorama.pixel_direction(x, y)).to_degrees();
                assert!(away < 0.1, "({x}, {y}): {away}°");
                assert!(rest.pixels().flatten().zip(SKY.iter().cycle()).all(|(a, b)| (a - b).abs() < 1e-5));
            }
        }
    }

    #[test]
    fn round_sun_is_measured_anywhere_whatever_the_sky_around() {
        // Half a degree wide, brighter upward, clipped in its middle, in a sky that is brighter at the horizon.
        let half_width = 0.6f32.to_radians();
        let places = [Vec3::Y, Vec3::NEG_Y, Vec3::NEG_Z, Vec3::new(1e-3, 0.3, -1.0).normalize()];
        for toward in fibonacci_sphere(20).into_iter().chain(places) {
            let dim = |d: Vec3| [0.3 + 0.2 * d.y, 0.4, 0.9 - 0.4 * d.y * d.y];
            let disc = |d: Vec3| {
                let angle = d.angle_between(toward);
                (6e4 * (1.0 - angle / half_width)).clamp(0.0, 3e4)
            };
            let panorama = sky(1024, |d| dim(d).map(|l| l + disc(d)));
            let (sun, rest) = take_out_sun(&panorama).expect("a sun");
            let step = PI as f32 / 512.0;
            assert!(sun.direction.angle_between(toward) < step, "{toward}: {}", sun.direction);
            let search = Search::new(&panorama);
            let truth = search.irradiance(toward, |i| disc(search.direction(i)));
            assert!((f64::from(sun.irradiance.y) / truth - 1.0).abs() < 0.01, "{toward}: {sun:?}, {truth}");
            assert!((0.6..1.1).contains(&sun.angular_diameter.to_degrees()), "{sun:?}");
            // No hole, and nothing far above the sky.
            let ratio = |(i, rgb): (usize, [f32; 3])| rgb[1] / dim(search.direction(i))[1];
            assert!(rest.pixels().enumerate().map(ratio).all(|r| (0.99..FAR_ABOVE).contains(&r)), "{toward}");
        }
    }

    #[test]
    fn overcast_skies_softboxes_and_black_have_no_sun() {
        let none = |panorama: Panorama| take_out_sun(&panorama).is_none();
        assert!(none(sky(64, |_| SKY)));
        assert!(none(sky(64, |_| [0.0; 3])));
        assert!(none(Panorama::new(1, 1, vec![[5.0; 3]], None)));
        // Brightest where the sun is behind the clouds.
        assert!(none(sky(512, |d| [1.0 + 300.0 * (d.dot(Vec3::ONE.normalize())).max(0.0).powi(200); 3])));
        // 20° and 8° of one brightness.
        for degrees in [10.0f32, 4.0] {
            let edge = degrees.to_radians().cos();
            assert!(none(sky(512, |d| if d.z > edge { [500.0; 3] } else { [0.1; 3] })), "{degrees}");
        }
        // A glint that gives next to nothing.
        assert!(none(with_pixel(sky(512, |_| SKY), 100, 100, 20.0)));
    }

    #[test]
    fn of_several_lamps_the_one_that_gives_most_is_taken_or_none() {
        let lamp = |d: Vec3, toward: Vec3, degrees: f32| d.angle_between(toward) < degrees.to_radians();
        let [a, b] = [Vec3::new(1.0, 0.4, 0.2).normalize(), Vec3::new(-0.3, 0.5, 1.0).normalize()];
        // The larger one is less bright.
        let two = sky(1024, |d| {
            if lamp(d, a, 0.3) {
                [9e3; 3]
            } else if lamp(d, b, 1.5) {
                [3e3; 3]
            } else {
                [0.2; 3]
            }
        });
        let (sun, rest) = take_out_sun(&two).expect("the larger one");
        assert!(sun.direction.dot(b) > 0.9999, "{sun:?}");
        let (x, y) = rest.pixel_at(a);
        assert_eq!(rest.pixel(x, y), Vec3::splat(9e3), "the other one stays");
        // A market: none of twenty outshines the rest.
        let lamps: Vec<Vec3> = fibonacci_sphere(40).into_iter().filter(|d| d.y > 0.0).collect();
        let market = sky(1024, |d| if lamps.iter().any(|l| lamp(d, *l, 0.5)) { [2e3; 3] } else { [0.05; 3] });
        assert_eq!(take_out_sun(&market).map(|(sun, _)| sun), None);
    }
}
