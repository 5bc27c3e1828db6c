//! Tunes `PLANE_TOLERANCE`: an open box with a sphere in it, every surface of another brightness, is looked up from
//! a panorama; what differs from the surface's own brightness came from a neighbour. Prints a table; run with
//! `cargo test -p gdibl-baker plane_tolerance -- --nocapture`.

use glam::Vec3;
use half::f16;

use super::{PLANE_TOLERANCE, Panorama};

const SPHERE: (Vec3, f32) = (Vec3::new(0.3, -0.2, 1.6), 0.5);
const HALF_SIZE: Vec3 = Vec3::new(1.0, 1.0, 3.0);

struct Hit {
    distance: f32,
    normal: Vec3,
    brightness: f32,
}

/// Nearest surface of the scene seen from the origin; the box is open at +Z.
fn trace(direction: Vec3) -> Option<Hit> {
    let b = direction.dot(SPHERE.0);
    let discriminant = b * b - SPHERE.0.length_squared() + SPHERE.1 * SPHERE.1;
    if discriminant > 0.0 && b > 0.0 {
        let distance = b - discriminant.sqrt();
        let point = distance * direction;
        return Some(Hit { distance, normal: (point - SPHERE.0) / SPHERE.1, brightness: 100.0 * texture(point) });
    }
    let t = HALF_SIZE / direction.abs().max(Vec3::splat(1e-9));
    let axis = t.min_position();
    let positive = direction[axis] > 0.0;
    let mut normal = Vec3::ZERO;
    normal[axis] = if positive { -1.0 } else { 1.0 };
    let brightness = [1.0, 10.0, 2.0, 20.0, 4.0, 0.0][2 * axis + usize::from(positive)];
    let brightness = brightness * texture(t[axis] * direction);
    (axis != 2 || !positive).then_some(Hit { distance: t[axis], normal, brightness })
}

/// Waves of half a metre: what a single pixel shows worse than four.
fn texture(point: Vec3) -> f32 {
    1.0 + 0.5 * (12.0 * point.x).sin() * (12.0 * point.y).cos() * (12.0 * point.z).sin()
}

fn panorama(width: usize, noise: f32) -> Panorama {
    let empty = Panorama::new(width, width / 2, vec![[0.0; 3]; width * width / 2], None);
    let mut radiance = Vec::new();
    let mut distance = Vec::new();
    for index in 0..width * width / 2 {
        match trace(empty.pixel_direction(index % width, index / width)) {
            Some(hit) => {
                radiance.push([hit.brightness; 3]);
                // Half-float distances of a surface that is not quite where the model says.
                let off = 1.0 + noise * ((index as f32 * 0.618).fract() * 2.0 - 1.0);
                distance.push(f16::from_f32(hit.distance * off).to_f32());
            }
            None => {
                radiance.push([1000.0; 3]);
                distance.push(f32::INFINITY);
            }
        }
    }
    Panorama::new(width, width / 2, radiance, Some(distance))
}

/// Mean relative error over directions spread evenly over the sphere.
fn error(panorama: &Panorama, tolerance: f32) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for i in 0..100_000 {
        let y = 1.0 - (2.0 * i as f32 + 1.0) / 100_000.0;
        let angle = i as f32 * 2.399_963_2;
        let r = (1.0 - y * y).sqrt();
        let direction = Vec3::new(r * angle.sin(), y, r * angle.cos());
        let Some(hit) = trace(direction) else { continue };
        let Some(found) = panorama.radiance_on_plane_within(direction, hit.distance, hit.normal, tolerance) else {
            continue;
        };
        sum += f64::from((found.x / hit.brightness - 1.0).abs());
        count += 1;
    }
    assert!(count > 80_000);
    sum / f64::from(count)
}

#[test]
fn plane_tolerance_is_near_the_best() {
    const CANDIDATES: [f32; 8] = [1e-3, 3e-3, 0.01, 0.02, PLANE_TOLERANCE, 0.05, 0.15, 1e30];
    eprintln!("mean relative error by tolerance {CANDIDATES:?}");
    let mut means = [0.0; CANDIDATES.len()];
    for width in [128, 512] {
        for noise in [0.0, 0.01, 0.03] {
            let panorama = panorama(width, noise);
            let errors = CANDIDATES.map(|tolerance| error(&panorama, tolerance));
            eprintln!("{width} wide, distances off by {noise}: {errors:.4?}");
            means.iter_mut().zip(errors).for_each(|(mean, error)| *mean += error / 6.0);
        }
    }
    eprintln!("mean of all: {means:.4?}");
    let best = means.into_iter().fold(f64::INFINITY, f64::min);
    assert!(means[4] <= 1.05 * best, "{means:?}");
    // And the rule is worth having: bilinear over any finite pixel is much worse.
    assert!(means[4] < 0.7 * means[7], "{means:?}");
}
