//! A sun in one pixel, anywhere: found by construction, not by luck.

use gdibl_baker::analyse::{IrradianceError, Light, Pair, radiance_sh};
use gdibl_baker::bake::BakeSettings;
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::radiance::{Distant, PathContext, RadianceFunction};
use gdibl_baker::sampling::{Sampler, Stream};
use gdibl_baker::scene::{Role, Scene};
use gdibl_runtime::{RadianceSh, sh};
use glam::{DVec3, Quat, Vec3};
use std::f64::consts::PI;

use crate::exact::exact_sh;
use crate::level::*;

#[test]
fn exact_integral_of_known_light_is_exact() {
    let white = exact_sh(&panorama(16, |_| [1.0, 2.0, 3.0]), 4).coefficients;
    for (i, rgb) in white.iter().enumerate() {
        for (c, value) in rgb.iter().enumerate() {
            let expected = if i == 0 { (4.0 * PI).sqrt() * (c + 1) as f64 } else { 0.0 };
            assert!((f64::from(*value) - expected).abs() < 1e-5, "{i} {c}: {value}");
        }
    }
}

#[test]
fn sun_in_one_pixel_is_found_wherever_it_stands() {
    let scene = Scene::default();
    let nodes = [DVec3::ZERO; 24];
    let mut table = Vec::new();
    for width in [64, 512] {
        for (place, x, y) in sun_places(width) {
            for sun in [1e5, 1e9] {
                let image = sky_with_sun(width, [x, y], sun);
                let truth = exact_sh(&image, 2);
                let sky = distant(image);
                let function = gdibl(&scene, &[], Some(&sky));
                for (samples, bound) in [(1024, 0.015), (2048, 0.01)] {
                    let baked = bake_points(&function, &nodes, &BakeSettings { samples, ..SMALL });
                    let pair =
                        |node| Pair { found: sh_of(&baked, node), truth: Light::Radiance(truth), variance: None };
                    let error = IrradianceError::of(&(0..nodes.len()).map(pair).collect::<Vec<_>>());
                    table.push((error.per_node.max, error.relative_rmse, samples));
                    let case = format!("{place}, {width} wide, sun {sun:e}, {samples} samples");
                    println!("{case}: {:.2e} rms, {:.2e} worst of 24", error.relative_rmse, error.per_node.max);
                    assert!(error.relative_rmse <= bound, "{case}: {:.4}", error.per_node.max);
                }
            }
        }
    }
    for of in [1024, 2048] {
        let worst = table.iter().filter(|t| t.2 == of).fold((0.0f64, 0.0f64), |m, t| (m.0.max(t.0), m.1.max(t.1)));
        println!("{of} samples: worst node {:.2e}, worst rms {:.2e}", worst.0, worst.1);
    }
}

/// A smooth sky with a sun of four pixels, turned and exposed.
fn sunny() -> Distant {
    let mut image = panorama(256, |d| [1.0 + d.y, 1.0, 1.2 + d.x * d.z]);
    for (x, y, share) in [(40, 50, 1.0), (41, 50, 0.8), (40, 51, 0.5), (41, 51, 0.4)] {
        image = with_pixel(&image, [x, y], [3e4, 2.5e4, 1.5e4].map(|l| l * share));
    }
    Distant { rotation: Quat::from_rotation_y(0.7), exposure_stops: -1.0, ..distant(image) }
}

/// Radiance coefficients of a directional light.
fn delta(toward: Vec3, irradiance: Vec3) -> RadianceSh {
    let mut basis = [0.0; sh::MAX_COEFFICIENTS];
    sh::basis(2, toward.to_array(), &mut basis);
    radiance_sh(2, basis[..9].iter().map(|y| (irradiance * *y).to_array()))
}

fn less(a: RadianceSh, b: &RadianceSh) -> RadianceSh {
    let mut difference = a;
    difference.add_scaled(b, -1.0);
    difference
}

#[test]
fn extracting_the_sun_takes_away_its_directional_light_and_nothing_else() {
    let whole = sunny();
    let mut extracted = whole.clone();
    let sun = extracted.extract_sun().expect("there is one");
    // One node in the open; one in the shade of a black disc that covers the sun.
    let nodes = [DVec3::ZERO, DVec3::new(50.0, 0.0, 0.0)];
    let mut scene = Scene::default();
    let (u, v) = sun.direction.as_dvec3().any_orthonormal_pair();
    let corner = |a: f64, b: f64| nodes[1] + sun.direction.as_dvec3() * 3.0 + u * a + v * b;
    add(&mut scene, Role::Scene, &[[corner(-2.0, -1.0), corner(2.0, -1.0), corner(0.0, 2.0)]]);
    scene.materials[0].base_color = Vec3::ZERO.extend(1.0);
    let settings = BakeSettings { samples: 4096, ..SMALL };
    let path = |sky| bake_points(&Path::new(&scene, Some(sky), PathSettings::default()), &nodes, &settings);
    let gdibl = |sky| bake_points(&gdibl(&scene, &[], Some(sky)), &nodes, &settings);
    for (name, [with, without]) in
        [("path", [path(&whole), path(&extracted)]), ("gdibl", [gdibl(&whole), gdibl(&extracted)])]
    {
        let pair = Pair {
            found: less(sh_of(&with, 0), &sh_of(&without, 0)),
            truth: Light::Radiance(delta(sun.direction, sun.irradiance)),
            variance: None,
        };
        let error = IrradianceError::of(&[pair]).relative_rmse;
        // What is taken away is most of the light, so that errors relative to all of it count for it, too. 4 of them, and
        // 0.1 % because the sun is no point.
        let bound = 4.0 * f64::from(with.relative_error[0].hypot(without.relative_error[0])) + 1e-3;
        println!("{name}: {error:.2e} of {bound:.2e}");
        assert!(error < bound && bound < 0.04, "{name}: {error:.2e}, {bound:.2e}");
        // In the shade both are the sky.
        let pair = Pair { found: sh_of(&with, 1), truth: Light::Radiance(sh_of(&without, 1)), variance: None };
        let error = IrradianceError::of(&[pair]).relative_rmse;
        assert!(error < 0.03, "{name}, in the shade: {error:.2e}");
    }
}

#[test]
fn light_of_an_extracted_sun_still_bounces_and_cameras_see_it() {
    let whole = sunny();
    let mut extracted = whole.clone();
    let sun = extracted.extract_sun().expect("there is one");
    let removed = Distant { panorama: extracted.without_sun.clone().expect("it was taken out"), ..whole.clone() };
    // Close over a large floor of albedo 0.6 below the sun: the floor is all that a surface that faces down sees.
    let up = sun.direction.as_dvec3();
    let (u, v) = up.any_orthonormal_pair();
    let corner = |a: f64, b: f64| u * a + v * b - up * 0.01;
    let floor = [
        [corner(-9.0, -9.0), corner(9.0, -9.0), corner(9.0, 9.0)],
        [corner(-9.0, -9.0), corner(9.0, 9.0), corner(-9.0, 9.0)],
    ];
    for role in [Role::Scene, Role::Environment] {
        let mut scene = Scene::default();
        add(&mut scene, role, &floor);
        scene.materials[0].base_color = Vec3::splat(0.6).extend(1.0);
        let settings = BakeSettings { samples: 8192, bands: 2, ..SMALL };
        let bake = |sky: &Distant| match role {
            // No probe has seen an object: its rays go on.
            Role::Scene => bake_points(&gdibl(&scene, &[], Some(sky)), &[DVec3::ZERO], &settings),
            _ => bake_points(&Path::new(&scene, Some(sky), PathSettings::default()), &[DVec3::ZERO], &settings),
        };
        let [with, without, never] = [&whole, &extracted, &removed].map(bake);
        // Bounced light of the sun: a radiance of 0.6/π E from the lower half of the sphere.
        let bounced = less(sh_of(&without, 0), &sh_of(&never, 0));
        let expected = 0.6 * sun.irradiance / std::f32::consts::PI * 2.0 * std::f32::consts::PI * sh::Y00;
        let found = Vec3::from_array(bounced.coefficients[0]);
        assert!((found / expected - 1.0).abs().max_element() < 0.03, "{role:?}: {found}, expected {expected}");
        // And its direct light is gone.
        let direct = Vec3::from_array(less(sh_of(&with, 0), &sh_of(&without, 0)).coefficients[0]);
        assert!((direct / (sun.irradiance * sh::Y00) - 1.0).abs().max_element() < 0.03, "{role:?}: {direct}");
    }
    // A ray of a node into the sun finds sky, one of a camera the sun.
    let scene = Scene::default();
    let seen = |function: &dyn Fn(&mut PathContext) -> f32| {
        function(&mut PathContext::new(Stream::new(Sampler::Sobol, 0, 0, 0)))
    };
    let (gdibl, path) =
        (gdibl(&scene, &[], Some(&extracted)), Path::new(&scene, Some(&extracted), PathSettings::default()));
    for (node, camera) in [
        (
            seen(&|context| gdibl.radiance(Vec3::ZERO, sun.direction, context).value.x),
            seen(&|context| gdibl.look(Vec3::ZERO, sun.direction, context, |_, _| None).value.x),
        ),
        (
            seen(&|context| path.radiance(Vec3::ZERO, sun.direction, context).value.x),
            seen(&|context| path.look(Vec3::ZERO, sun.direction, context, |_, _| None).value.x),
        ),
    ] {
        assert!(node < 2.0 && camera > 1e3, "{node} {camera}");
    }
}
