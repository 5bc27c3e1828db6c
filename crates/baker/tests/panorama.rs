//! Laws of the lat-long panorama: directions and pixels, solid angles, and what a lookup may mix.

use std::f64::consts::PI;

use gdibl_baker::panorama::Panorama;
use glam::{DVec3, Vec3};
use proptest::prelude::*;

fn flat(width: usize, height: usize, value: f32) -> Panorama {
    Panorama::new(width, height, vec![[value; 3]; width * height], None)
}

/// A panorama whose pixels are all different.
fn counted(width: usize, height: usize, distance: Option<Vec<f32>>) -> Panorama {
    let pixels = (0..width * height).map(|i| [i as f32, 2.0 * i as f32, 1.0]).collect();
    Panorama::new(width, height, pixels, distance)
}

const SIZES: [(usize, usize); 7] = [(1, 1), (2, 1), (1, 2), (3, 2), (7, 5), (64, 32), (257, 129)];

#[test]
fn pixel_solid_angles_sum_to_the_sphere() {
    for (width, height) in SIZES {
        let panorama = flat(width, height, 1.0);
        let sum: f64 = (0..height).map(|y| width as f64 * panorama.pixel_solid_angle(y)).sum();
        assert!((sum - 4.0 * PI).abs() < 1e-12, "{width} x {height}: {sum}");
    }
    // Far up a pole a pixel is small, but exactly as small as it should be.
    let panorama = flat(8192, 4096, 1.0);
    let exact = 2.0 * PI / 8192.0 * 2.0 * (PI / 8192.0).sin().powi(2); // 1 - cos x = 2 sin²(x/2)
    assert!((panorama.pixel_solid_angle(0) / exact - 1.0).abs() < 1e-9);
}

#[test]
fn directions_follow_the_orientation_of_openexr() {
    // Along the horizon of a 4 × 1 image: centres at u = 1/8, 3/8 …, that is halfway between the axes.
    let panorama = flat(4, 1, 1.0);
    let s = std::f32::consts::FRAC_1_SQRT_2;
    for (x, expected) in [(0, [s, 0.0, -s]), (1, [s, 0.0, s]), (2, [-s, 0.0, s]), (3, [-s, 0.0, -s])] {
        let direction = panorama.pixel_direction(x, 0);
        assert!((direction - Vec3::from_array(expected)).length() < 1e-6, "{x}: {direction}");
    }
    for (direction, u, v) in [
        (Vec3::Z, 0.5, 0.5),
        (Vec3::X, 0.25, 0.5),
        (Vec3::NEG_X, 0.75, 0.5),
        (Vec3::Y, 0.5, 0.0),
        (Vec3::NEG_Y, 0.5, 1.0),
        (Vec3::ZERO, 0.5, 0.5),
        // The largest component of this one is not NaN.
        (Vec3::new(0.0, f32::NAN, 1e-45), 0.5, 0.5),
        (Vec3::new(1.0, f32::NEG_INFINITY, 0.0), 0.5, 0.5),
    ] {
        let uv = Panorama::uv(direction);
        assert!((uv.0 - u).abs() < 1e-6 && (uv.1 - v).abs() < 1e-6, "{direction}: {uv:?}");
    }
}

#[test]
fn pixel_at_inverts_pixel_direction() {
    for (width, height) in SIZES {
        let panorama = flat(width, height, 1.0);
        for y in 0..height {
            for x in 0..width {
                let direction = panorama.pixel_direction(x, y);
                assert!((direction.length() - 1.0).abs() < 1e-6);
                assert_eq!(panorama.pixel_at(direction), (x, y), "{width} x {height}");
                assert_eq!(panorama.pixel_at(direction * 1e-30), (x, y), "length does not matter");
                assert_eq!(panorama.pixel_at(direction * 1e30), (x, y), "length does not matter");
            }
        }
    }
}

#[test]
fn lookup_at_a_pixel_centre_gives_the_pixel() {
    for (width, height) in SIZES {
        let panorama = counted(width, height, None);
        for y in 0..height {
            for x in 0..width {
                let found = panorama.radiance(panorama.pixel_direction(x, y));
                let expected = panorama.pixel(x, y);
                let error = (found - expected).length();
                assert!(error < 2e-4 * (1.0 + (width * height) as f32), "({x}, {y}): {found} {expected}");
            }
        }
    }
}

#[test]
fn lookup_is_continuous_across_the_seam() {
    let panorama = counted(16, 8, None);
    let left = panorama.radiance(Vec3::new(1e-6, 0.1, -1.0));
    let right = panorama.radiance(Vec3::new(-1e-6, 0.1, -1.0));
    assert!((left - right).length() < 1e-3, "{left} {right}");
    // On the seam both sides lend half.
    let on = panorama.radiance(Vec3::new(0.0, 0.0, -1.0));
    let rows = [3, 4].map(|y| (panorama.pixel(0, y) + panorama.pixel(15, y)) / 2.0);
    assert!((on - (rows[0] + rows[1]) / 2.0).length() < 1e-3, "{on}");
}

/// The slow twin: bilinear interpolation written out in f64.
fn radiance_slow(panorama: &Panorama, direction: Vec3) -> DVec3 {
    let d = direction.as_dvec3();
    let (w, h) = (panorama.width() as i64, panorama.height() as i64);
    let px = (0.5 - d.x.atan2(d.z) / (2.0 * PI)) * w as f64 - 0.5;
    let py = (0.5 - (d.y / d.length()).asin() / PI) * h as f64 - 0.5;
    let pixel = |x: f64, y: f64| {
        panorama.pixel((x as i64).rem_euclid(w) as usize, (y as i64).clamp(0, h - 1) as usize).as_dvec3()
    };
    let (x, y) = (px.floor(), py.floor());
    let (fx, fy) = (px - x, py - y);
    (1.0 - fy) * ((1.0 - fx) * pixel(x, y) + fx * pixel(x + 1.0, y))
        + fy * ((1.0 - fx) * pixel(x, y + 1.0) + fx * pixel(x + 1.0, y + 1.0))
}

proptest! {
    #[test]
    fn lookup_equals_its_slow_twin(x in -1.0f32..1.0, y in -1.0f32..1.0, z in -1.0f32..1.0, size in 0usize..7) {
        let direction = Vec3::new(x, y, z);
        prop_assume!(direction.length() > 0.01);
        let panorama = counted(SIZES[size].0, SIZES[size].1, None);
        let (fast, slow) = (panorama.radiance(direction).as_dvec3(), radiance_slow(&panorama, direction));
        let scale = (SIZES[size].0 * SIZES[size].1) as f64;
        prop_assert!((fast - slow).length() < 1e-4 * scale, "{fast} {slow}");
    }

    #[test]
    fn lookups_are_total(bits in any::<[u32; 7]>(), size in 0usize..7, zero in 0usize..4) {
        // Any bit pattern: denormals, infinities, NaN, -0.
        let mut f = bits.map(f32::from_bits);
        for value in f.iter_mut().take(zero) { *value = -0.0; }
        let (width, height) = SIZES[size];
        let distance = (0..width * height).map(|i| if i % 3 == 0 { f32::INFINITY } else { i as f32 }).collect();
        let panorama = counted(width, height, Some(distance));
        let (direction, normal) = (Vec3::new(f[0], f[1], f[2]), Vec3::new(f[3], f[4], f[5]));
        let taps = panorama.taps(direction);
        let sum: f32 = taps.iter().map(|tap| tap.weight).sum();
        prop_assert!((sum - 1.0).abs() < 1e-5 && taps.iter().all(|tap| tap.weight >= 0.0), "{taps:?}");
        prop_assert!(taps.iter().all(|tap| tap.index == tap.y * width + tap.x && tap.index < width * height));
        prop_assert!(panorama.radiance(direction).is_finite());
        prop_assert!(panorama.radiance_escaping(direction).is_none_or(|r| r.is_finite()));
        prop_assert!(panorama.radiance_on_plane(direction, f[6], normal).is_none_or(|r| r.is_finite()));
        let (x, y) = panorama.pixel_at(direction);
        prop_assert!(x < width && y < height);
    }
}

/// Half of the panorama (x > 0) is a wall of radiance 1 at 2 m, half a sky of radiance 1000.
fn wall_and_sky() -> Panorama {
    let (width, height) = (64, 32);
    let is_wall = |i: usize| i % width < width / 2;
    let pixels = (0..width * height).map(|i| if is_wall(i) { [1.0; 3] } else { [1000.0; 3] }).collect();
    let distance = (0..width * height).map(|i| if is_wall(i) { 2.0 } else { f32::INFINITY }).collect();
    Panorama::new(width, height, pixels, Some(distance))
}

#[test]
fn sky_and_wall_do_not_mix() {
    let panorama = wall_and_sky();
    let mut counts = [0; 4];
    for i in 0..1000 {
        // Through the step at +Z (and, every other time, at the seam), a pixel to each side.
        let angle = (i as f32 / 999.0 - 0.5) * 0.3 + if i % 2 == 0 { 0.0 } else { std::f32::consts::PI };
        let direction = Vec3::new(angle.sin(), 0.05, angle.cos()).normalize();
        let escaping = panorama.radiance_escaping(direction);
        let on_wall = panorama.radiance_on_plane(direction, 2.0, -direction);
        counts[0] += usize::from(escaping.is_some());
        counts[1] += usize::from(escaping.is_none());
        counts[2] += usize::from(on_wall.is_some());
        counts[3] += usize::from(on_wall.is_none());
        assert!(escaping.is_none_or(|r| (r - Vec3::splat(1000.0)).length() < 0.01), "{escaping:?}");
        assert!(on_wall.is_none_or(|r| (r - Vec3::ONE).length() < 1e-5), "{on_wall:?}");
        assert!(escaping.is_some() || on_wall.is_some());
    }
    assert!(counts.iter().all(|count| *count > 100), "{counts:?}");
}

#[test]
fn a_near_object_does_not_lend_to_the_wall_behind() {
    // A floor 1 m below with a post in front of a quarter of it.
    let (width, height) = (64, 32);
    let empty = flat(width, height, 0.0);
    let post = |d: Vec3| d.x > 0.0 && d.z > 0.0;
    let directions: Vec<Vec3> = (0..width * height).map(|i| empty.pixel_direction(i % width, i / width)).collect();
    let pixels = directions.iter().map(|d| if post(*d) { [500.0; 3] } else { [1.0; 3] }).collect();
    let floor = |d: Vec3| if d.y < 0.0 { -1.0 / d.y } else { f32::INFINITY };
    let distance = directions.iter().map(|d| if post(*d) { 0.3 } else { floor(*d) }).collect();
    let panorama = Panorama::new(width, height, pixels, Some(distance));
    for i in 0..=1000 {
        // Along the floor, seen at a slant and past the post's edge: distances differ from pixel to pixel.
        let angle = (i as f32 / 1000.0 - 0.5) * 0.4 + 1.5 * std::f32::consts::PI;
        for slant in [-2.0, -0.7, -0.2] {
            let direction = Vec3::new(angle.cos(), slant, angle.sin()).normalize();
            let found = panorama.radiance_on_plane(direction, floor(direction), Vec3::Y).unwrap();
            let expected = if post(direction) { 500.0 } else { 1.0 };
            // Beside the post its neighbours are not the floor; where only they are left, the closest lends.
            let beside = direction.x.abs() < 0.2 || direction.z.abs() < 0.2;
            assert!(beside || (found.x - expected).abs() < 1e-3, "{direction}: {found}");
            // Where one of the four taps saw the floor, the post lends nothing.
            let floor_taps =
                panorama.taps(direction).iter().filter(|tap| panorama.pixel(tap.x, tap.y).x == 1.0).count();
            assert!(floor_taps == 0 || (found.x - 1.0).abs() < 1e-3, "{direction}: {found} {floor_taps}");
        }
    }
}

#[test]
fn a_plane_is_followed_at_grazing_angles() {
    // An endless floor 1 m below: at a slant of 1:40 its distance changes by tens of per cent per pixel, and all the
    // pixels still saw the same surface, so the lookup stays bilinear.
    let (width, height) = (256, 128);
    let empty = flat(width, height, 0.0);
    let direction = |i: usize| empty.pixel_direction(i % width, i / width);
    let distance: Vec<f32> =
        (0..width * height).map(|i| if direction(i).y < 0.0 { -1.0 / direction(i).y } else { f32::INFINITY }).collect();
    let panorama = counted(width, height, Some(distance));
    for i in 0..1000 {
        let angle = i as f32 * 0.1;
        let d = Vec3::new(angle.sin(), -1.0 / (i as f32 / 25.0 + 0.3), angle.cos()).normalize();
        let found = panorama.radiance_on_plane(d, -1.0 / d.y, Vec3::Y).unwrap();
        let bilinear = panorama.radiance(d);
        let all_floor = panorama.taps(d).iter().all(|tap| panorama.pixel_distance(tap.x, tap.y) != Some(f32::INFINITY));
        assert!(all_floor);
        assert!((found - bilinear).length() <= 1e-3 * bilinear.length(), "{d}: {found} {bilinear}");
    }
}

#[test]
fn a_surface_nobody_saw_takes_the_closest_finite_pixel() {
    let panorama = wall_and_sky();
    // The wall is at 2 m; the caller believes 5 m.
    let found = panorama.radiance_on_plane(Vec3::X, 5.0, Vec3::NEG_X);
    assert_eq!(found, Some(Vec3::ONE));
    // Only sky around.
    assert_eq!(panorama.radiance_on_plane(Vec3::NEG_X, 5.0, Vec3::X), None);
    assert_eq!(panorama.radiance_escaping(Vec3::X), None);
    // Without distances everything is bilinear.
    let plain = counted(8, 4, None);
    let d = Vec3::new(0.3, 0.2, 0.9);
    assert_eq!(plain.radiance_on_plane(d, 1.0, Vec3::Y), Some(plain.radiance(d)));
    assert_eq!(plain.radiance_escaping(d), Some(plain.radiance(d)));
}

#[test]
fn bilinear_reconstruction_keeps_a_constant_at_any_size() {
    for (width, height) in SIZES {
        let panorama = flat(width, height, 3.5);
        for i in 0..500 {
            let d = Vec3::new((i as f32).sin(), (i as f32 * 0.7).cos(), (i as f32 * 1.3).sin());
            assert!((panorama.radiance(d) - Vec3::splat(3.5)).length() < 1e-5);
        }
    }
}

#[test]
#[should_panic(expected = "radiance of a 4 x 2 panorama")]
fn new_refuses_a_wrong_number_of_pixels() {
    Panorama::new(4, 2, vec![[0.0; 3]; 7], None);
}

#[test]
fn one_coordinate_that_is_no_number_makes_a_zero_vector() {
    for odd in [f32::NAN, f32::INFINITY] {
        for direction in [Vec3::new(odd, 1.0, 1e-3), Vec3::new(0.5, odd, 0.0), Vec3::new(odd, odd, 2.0)] {
            assert_eq!(Panorama::uv(direction), Panorama::uv(Vec3::ZERO), "{direction}");
        }
    }
}
