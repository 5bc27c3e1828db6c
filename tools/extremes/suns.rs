//! Suns of a few pixels where panoramas are awkward: on the seam, between texels, at the pole, on the horizon.

use crate::exact::exact_sh;
use crate::level::*;
use crate::shared::*;
use crate::table::Table;
use gdibl_baker::analyse::radiance_sh;
use gdibl_baker::bake::BakeSettings;
use gdibl_baker::panorama::{Panorama, take_out_sun};
use gdibl_baker::scene::Scene;
use gdibl_runtime::{RadianceSh, sh};
use glam::{DVec3, Vec3};

pub fn rows(table: &mut Table) {
    found_anywhere(table);
    taken_out_anywhere(table);
    set_behind_a_plane(table);
}

/// Columns and rows of the panoramas here.
const WIDTH: usize = 512;
const HEIGHT: usize = WIDTH / 2;

/// A sky with a sun whose light these pixels share.
struct Sunny {
    place: &'static str,
    pixels: Vec<[usize; 2]>,
}

fn places() -> Vec<Sunny> {
    let of = |place, pixels: &[[usize; 2]]| Sunny { place, pixels: pixels.to_vec() };
    vec![
        of("on the edge of two texels", &[[170, 80], [171, 80]]),
        of("on the corner of four texels", &[[170, 80], [171, 80], [170, 81], [171, 81]]),
        of("on the seam", &[[WIDTH - 1, 80], [0, 80]]),
        of("on the seam's corner", &[[WIDTH - 1, 80], [0, 80], [WIDTH - 1, 81], [0, 81]]),
        // All texels of the first row meet there.
        Sunny { place: "at the pole", pixels: (0..WIDTH).map(|x| [x, 0]).collect() },
        of("on the horizon", &[[300, HEIGHT / 2 - 1], [300, HEIGHT / 2], [301, HEIGHT / 2 - 1], [301, HEIGHT / 2]]),
    ]
}

impl Sunny {
    fn sky(&self, sun: f32) -> Panorama {
        let smooth = panorama(WIDTH, |d| [1.0 + d.y, 1.0, 1.2 + d.x * d.z]);
        let light = [sun, 0.9 * sun, 0.7 * sun];
        let is_sun = |index: usize| self.pixels.contains(&[index % WIDTH, index / WIDTH]);
        smooth.with_pixels(|index, pixel| if is_sun(index) { light } else { pixel })
    }
}

fn found_anywhere(table: &mut Table) {
    let scene = Scene::default();
    let nodes = [DVec3::ZERO; 12];
    for sunny in places() {
        let mut worst = [0.0f64; 2];
        for sun in [1e5, 1e9] {
            let image = sunny.sky(sun);
            let truth = exact_sh(&image, 2);
            let sky = distant(image);
            for (i, samples) in [1024, 2048].into_iter().enumerate() {
                let baked = bake_points(&gdibl(&scene, &[], Some(&sky)), &nodes, &BakeSettings { samples, ..SMALL });
                worst[i] = worst[i].max(error_of(&baked, |_| truth).relative_rmse);
            }
        }
        table.row(
            &format!("sun of 1e5 and 1e9 {} of a 512 × 256 sky", sunny.place),
            "relative RMSE of E ≤ 1.5 % at 1024 samples, ≤ 1 % at 2048",
            &format!("{}, {}", percent(worst[0]), percent(worst[1])),
            worst[0] <= 0.015 && worst[1] <= 0.01,
        );
    }
}

fn taken_out_anywhere(table: &mut Table) {
    for sunny in places() {
        let image = sunny.sky(1e5);
        let whole = exact_sh(&image, 2);
        let (measured, holds) = match take_out_sun(&image) {
            None => ("no sun is found".into(), false),
            Some((sun, rest)) => {
                let mut sum = exact_sh(&rest, 2);
                sum.add_scaled(&delta(sun.direction, sun.irradiance), 1.0);
                sum.add_scaled(&whole, -1.0);
                let off = strength(&sum) / strength(&whole);
                let toward = sunny.pixels.iter().map(|[x, y]| image.pixel_direction(*x, *y)).sum::<Vec3>().normalize();
                let angle = f64::from(sun.direction.angle_between(toward)).to_degrees();
                (format!("E off by {}, direction by {angle:.2}°", percent(off)), off <= 0.01 && angle <= 0.36)
            }
        };
        table.row(
            &format!("the same taken out (--sun extract), {}", sunny.place),
            "sun + rest = whole: E within 1 %; direction within half a texel (0.36°)",
            &measured,
            holds,
        );
    }
}

/// Radiance coefficients of a directional light.
fn delta(toward: Vec3, irradiance: Vec3) -> RadianceSh {
    let mut basis = [0.0; sh::MAX_COEFFICIENTS];
    sh::basis(2, toward.to_array(), &mut basis);
    radiance_sh(2, basis[..9].iter().map(|y| (irradiance * *y).to_array()))
}

fn set_behind_a_plane(table: &mut Table) {
    // Half of a sun on the horizon, the other half behind a black plane of 20 km.
    let mut scene = Scene::default();
    let [a, b, c, d] = [[-1e4, -1e4], [-1e4, 1e4], [1e4, 1e4], [1e4, -1e4]].map(|[x, z]| DVec3::new(x, 0.0, z));
    add_of(&mut scene, &[[a, b, c], [a, c, d]], 0.0, 0.0);
    let sunny = places().pop().expect("the last one is on the horizon");
    let image = sunny.sky(1e5);
    // The lower half of the panorama, and of the two rows at the horizon what lies below it, is out of sight.
    let truth = upper_half(&image);
    let sky = distant(image);
    let path = gdibl_baker::radiance::path::Path::new(&scene, Some(&sky), Default::default());
    let points = [DVec3::new(0.0, 1.7, 0.0); 12];
    let baked = bake_points(&path, &points, &BakeSettings { samples: 2048, ..SMALL });
    let error = error_of(&baked, |_| truth).relative_rmse;
    table.at_most(
        "a sun on the horizon, half of it behind a plane of 20 km; 2048 samples",
        "relative RMSE of E",
        0.015,
        error,
    );
}

/// ∫ L Y of directions above the horizon alone, by a million of them per row of the sun, in f64.
fn upper_half(image: &Panorama) -> RadianceSh {
    // Bands of latitude: fine where the sun is.
    const COLUMNS: usize = 8 * WIDTH;
    let (mut sums, rows) = ([[0.0f64; 3]; 9], 8 * HEIGHT / 2);
    for row in 0..rows {
        let latitude = std::f64::consts::FRAC_PI_2 * (row as f64 + 0.5) / rows as f64;
        let area = latitude.cos() * std::f64::consts::FRAC_PI_2 / rows as f64 * std::f64::consts::TAU / COLUMNS as f64;
        for column in 0..COLUMNS {
            let longitude = std::f64::consts::TAU * (column as f64 + 0.5) / COLUMNS as f64;
            let direction =
                DVec3::new(longitude.sin() * latitude.cos(), latitude.sin(), longitude.cos() * latitude.cos())
                    .as_vec3();
            let light = image.radiance(direction);
            let mut basis = [0.0; sh::MAX_COEFFICIENTS];
            sh::basis(2, direction.to_array(), &mut basis);
            for (sum, y) in sums.iter_mut().zip(basis) {
                (0..3).for_each(|c| sum[c] += area * f64::from(light[c] * y));
            }
        }
    }
    radiance_sh(2, sums.map(|rgb| rgb.map(|v| v as f32)))
}
