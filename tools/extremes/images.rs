//! Images of every size, and pixels that are no light.

use crate::exact::exact_sh;
use crate::level::*;
use crate::shared::*;
use crate::table::Table;
use gdibl_baker::analyse::radiance_sh;
use gdibl_baker::bake::BakeSettings;
use gdibl_baker::import::image::{Pose, ReadOptions, SampleFormat, read_image, write_exr};
use gdibl_baker::panorama::{Image, Mapping, Panorama};
use gdibl_baker::sampling::fibonacci_sphere;
use gdibl_baker::scene::Scene;
use gdibl_runtime::{RadianceSh, sh};
use glam::DVec3;
use std::f64::consts::PI;

pub fn rows(table: &mut Table) {
    let scene = Scene::default();
    let bake_sky = |image: Panorama| {
        let truth = exact_sh(&image, 2);
        let sky = distant(image);
        let baked = bake_points(&gdibl(&scene, &[], Some(&sky)), &[DVec3::ZERO; 8], &USUAL);
        (baked, truth)
    };
    let (baked, truth) = bake_sky(panorama(128, |d| [d.x, d.y, d.z].map(|t| 10f32.powf(6.0 * t))));
    table.at_most("1e-6 to 1e6 in one image", "relative RMSE of E", 0.01, error_of(&baked, |_| truth).relative_rmse);
    let (baked, _) = bake_sky(panorama(16, |_| [0.0; 3]));
    let black = baked.sh.to_vec().iter().all(|v| *v == 0.0) && baked.is_all_valid() && baked.relative_error == [0.0; 8];
    table.row("all black", "E = 0, valid, no error", if black { "so" } else { "not so" }, black);

    let mut worst = (0.0f64, [0, 0]);
    for [width, height] in [[1, 1], [2, 1], [1, 2], [3, 1], [5, 3], [7, 7], [17, 9], [333, 111]] {
        let pixels = (0..width * height).map(|i| [1.0 + i as f32 % 7.0, 2.0, 1.0 + i as f32 % 3.0]).collect();
        let image = Panorama::new(width, height, pixels, None);
        // Cells of many degrees are too much for the quadrature of larger images.
        let truth = dense_sh(&image);
        let (baked, _) = bake_sky(image);
        let error = error_of(&baked, |_| truth).relative_rmse;
        if error > worst.0 {
            worst = (error, [width, height]);
        }
    }
    let [width, height] = worst.1;
    table.row(
        "images of 1 × 1, 2 × 1, odd sizes",
        "relative RMSE of E ≤ 1 %",
        &format!("{} ({width} × {height})", percent(worst.0)),
        worst.0 <= 0.01,
    );
    let folder = Folder::new();
    unusable_pixels(table, &folder);
    half_floats(table, &folder);
    sixteen_k(table, &folder);
}

/// Coefficients of a panorama by a million directions.
fn dense_sh(panorama: &Panorama) -> RadianceSh {
    const COUNT: usize = 1 << 20;
    let mut sums = [[0.0f64; 3]; 9];
    for direction in fibonacci_sphere(COUNT) {
        let radiance = panorama.radiance(direction);
        let mut basis = [0.0; sh::MAX_COEFFICIENTS];
        sh::basis(2, direction.to_array(), &mut basis);
        for (sum, y) in sums.iter_mut().zip(basis) {
            (0..3).for_each(|c| sum[c] += f64::from(radiance[c] * y));
        }
    }
    radiance_sh(2, sums.map(|rgb| rgb.map(|v| (v * 4.0 * PI / COUNT as f64) as f32)))
}

fn unusable_pixels(table: &mut Table, folder: &Folder) {
    let path = folder.0.join("bad.exr");
    let mut told = Vec::new();
    let mut holds = true;
    for (name, bad) in [("NaN", f32::NAN), ("inf", f32::INFINITY), ("-1", -1.0)] {
        let mut image = Image::new(16, 8, vec![[1.0; 3]; 128]);
        image.pixels[3 * 16 + 5][1] = bad;
        write_exr(&path, &image, &Pose::default(), Mapping::LatLong, SampleFormat::F32).expect("it writes");
        let message = read_image(&path, &ReadOptions::default()).err().map_or(String::new(), |e| e.to_string());
        let refused = message.contains("x 5, y 3") && message.contains("--repair-pixels");
        let repaired = read_image(&path, &ReadOptions { repair_pixels: true, layer: None }).expect("it repairs");
        let clean = repaired.image.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0);
        let counted = repaired.findings.iter().any(|f| f.id == "repaired-pixels" && f.count == 1);
        holds &= refused && clean && counted;
        told.push(format!("{name} {}", if refused && clean && counted { "so" } else { "not so" }));
    }
    let must = "refused with x and y; repaired and counted when asked";
    table.row("negative, NaN, infinite pixels", must, &told.join(", "), holds);
}

fn half_floats(table: &mut Table, folder: &Folder) {
    let path = folder.0.join("half.exr");
    let mut image = Image::new(16, 8, vec![[1.0; 3]; 128]);
    image.pixels[40] = [1e6, 65_504.0, 1.0];
    let found = |findings: &[gdibl_baker::Finding]| findings.iter().any(|f| f.id == "half-float-clipping");
    let written =
        found(&write_exr(&path, &image, &Pose::default(), Mapping::LatLong, SampleFormat::F16).expect("it writes"));
    let read = found(&read_image(&path, &ReadOptions::default()).expect("it reads").findings);
    let measured = format!("written {written}, read {read}");
    table.row("half floats at 65504", "a finding where it is written and read", &measured, written && read);
}

fn sixteen_k(table: &mut Table, folder: &Folder) {
    const WIDTH: usize = 16_384;
    let path = folder.0.join("16k.exr");
    let (x, y) = (5000, 2500);
    let sun = 6e4f32;
    let mut image = {
        let light = panorama(WIDTH, |_| [1.0; 3]);
        Image::new(WIDTH, WIDTH / 2, light.pixels().collect())
    };
    image.pixels[y * WIDTH + x] = [sun; 3];
    let started = std::time::Instant::now();
    write_exr(&path, &image, &Pose::default(), Mapping::LatLong, SampleFormat::F16).expect("it writes");
    drop(image);
    let image = read_image(&path, &ReadOptions::default()).expect("it reads").image;
    let _ = std::fs::remove_file(&path);
    let sky = distant(Panorama::new(image.width, image.height, image.pixels, None));
    // Light of 1 from everywhere, and the sun: what its pixel adds, over the pixel's solid angle.
    let direction = sky.panorama.pixel_direction(x, y);
    let mut basis = [0.0; sh::MAX_COEFFICIENTS];
    sh::basis(2, direction.to_array(), &mut basis);
    let area = f64::from(sun - 1.0) * sky.panorama.pixel_solid_angle(y);
    let coefficients = basis[..9]
        .iter()
        .enumerate()
        .map(|(i, basis)| [(if i == 0 { (4.0 * PI).sqrt() } else { 0.0 } + area * f64::from(*basis)) as f32; 3]);
    let truth = radiance_sh(2, coefficients);
    let scene = Scene::default();
    let baked =
        bake_points(&gdibl(&scene, &[], Some(&sky)), &[DVec3::ZERO; 24], &BakeSettings { samples: 2048, ..SMALL });
    let error = error_of(&baked, |_| truth).relative_rmse;
    table.row(
        "16384 × 8192 pixels, one of them 6e4, written, read and baked",
        "relative RMSE of E ≤ 1 % at 2048 samples",
        &format!("{}; {:.0} s in all", percent(error), started.elapsed().as_secs_f64()),
        error <= 0.01,
    );
}
