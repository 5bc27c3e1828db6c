//! Blending at a surface point, through the whole radiance function.

use gdibl_baker::radiance::blend::BlendRule;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings, Probe};
use glam::{DVec3, Vec3};

use crate::level::*;

#[test]
fn blended_light_is_continuous_over_a_plane_where_the_rule_promises_it() {
    let scene = plane();
    let probes = unlike_probes();
    let viewer = DVec3::new(0.3, -4.0, 2.5);
    // The largest step of the light along a line, in `count` steps.
    let largest_step = |rule, count: u32| {
        let function = Gdibl::new(&scene, &probes, None, GdiblSettings { blend: rule, ..GdiblSettings::default() });
        let at = |i: u32| DVec3::new(-9.0 + 18.0 * f64::from(i) / f64::from(count), 0.37, 0.0);
        let light: Vec<Vec3> = (0..=count).map(|i| seen(&function, viewer, at(i))).collect();
        light.windows(2).map(|pair| (pair[1] - pair[0]).length()).fold(0.0, f32::max)
    };
    for (rule, continuous) in [
        (BlendRule::Distance(2.0), true),
        (BlendRule::Distance(8.0), true),
        (BlendRule::AngularSmooth(2.0), true),
        (BlendRule::Footprint(1.0), true),
        (BlendRule::Footprint(4.0), true),
        (BlendRule::Nearest, false),
        (BlendRule::Angular(2.0), false),
    ] {
        let (coarse, fine) = (largest_step(rule, 4000), largest_step(rule, 64_000));
        println!("{rule}: steps of {coarse:.1e}, then {fine:.1e}");
        // A sixteenth of the step: a sixteenth of the change, or the same jump.
        if continuous {
            assert!(fine < coarse / 8.0, "{rule}: {coarse} to {fine}");
            assert!(coarse < 0.05, "{rule}: {coarse}");
        } else {
            assert!(fine > 0.5 * coarse && fine > 0.05, "{rule}: {coarse} to {fine}");
        }
    }
}

#[test]
fn blended_light_lies_between_that_of_the_probes_in_every_extreme() {
    let scene = plane();
    let mut crowd: Vec<Probe> = (0..64)
        .map(|i| {
            let t = f64::from(i);
            let position = [10.0 * (1.7 * t).sin(), 10.0 * (2.9 * t).cos(), 0.1 + t / 16.0];
            single(position, 8 << (i % 4), [1.0 + i as f32 / 64.0, 1.5, 2.0 - i as f32 / 64.0])
        })
        .collect();
    let viewer = DVec3::new(1.0, 2.0, 1.5);
    // Exactly at the viewer; twice at one place; a hair above the plane; far away.
    crowd.push(single(viewer.into(), 16, [1.0, 1.0, 1.0]));
    crowd.extend([[1.0; 3], [2.0; 3]].map(|light| single([3.0, 3.0, 3.0], 16, light)));
    crowd.push(single([19.0, 19.0, 2e-6], 16, [1.25; 3]));
    crowd.push(single([0.0, 0.0, 1e5], 16, [1.75; 3]));
    for count in [1, 2, 3, 64, crowd.len()] {
        for start in [0, crowd.len() - count] {
            let probes = &crowd[start..start + count];
            for rule in every_rule() {
                let function =
                    Gdibl::new(&scene, probes, None, GdiblSettings { blend: rule, ..GdiblSettings::default() });
                for i in 0..50 {
                    let t = f64::from(i);
                    // One point straight below the viewer and the probe in its place.
                    let target = DVec3::new(1.0 + 0.37 * t * (t * 0.9).sin(), 2.0 + 0.29 * t * (t * 1.3).cos(), 0.0);
                    let light = seen(&function, viewer, target.clamp(DVec3::splat(-19.5), DVec3::splat(19.5)));
                    let within = light.min_element() >= 1.0 - 1e-5 && light.max_element() <= 2.0 + 1e-5;
                    assert!(light.is_finite() && within, "{rule}, {count} probes: {light}");
                }
            }
        }
    }
}

#[test]
fn two_probes_at_one_place_share_and_one_alone_counts_whole() {
    let scene = plane();
    let place = [1.0, 2.0, 3.0];
    let twins = [single(place, 16, [1.0; 3]), single(place, 16, [3.0; 3])];
    let (viewer, target) = (DVec3::new(-2.0, 0.0, 1.0), DVec3::new(0.5, 0.5, 0.0));
    for rule in every_rule() {
        let light = |probes: &[Probe]| {
            let function = Gdibl::new(&scene, probes, None, GdiblSettings { blend: rule, ..GdiblSettings::default() });
            seen(&function, viewer, target).x
        };
        assert_eq!(light(&twins[..1]), 1.0, "{rule}");
        let shared = light(&twins);
        if rule == BlendRule::Nearest {
            assert_eq!(shared, 1.0, "the first of equals");
        } else {
            assert!((shared - 2.0).abs() < 1e-6, "{rule}: {shared}");
        }
    }
}

#[test]
fn footprint_prefers_the_probe_with_more_pixels_on_the_spot() {
    let scene = plane();
    let (viewer, target) = (DVec3::new(0.0, -3.0, 2.0), DVec3::new(0.0, 0.0, 0.0));
    let light = |a: Probe, b: Probe| {
        let probes = [a, b];
        let function = Gdibl::new(
            &scene,
            &probes,
            None,
            GdiblSettings { blend: BlendRule::Footprint(1.0), ..GdiblSettings::default() },
        );
        seen(&function, viewer, target).x
    };
    // (N cosθ / d²): 4 to 1 by pixels, by distance, by angle; then all as the equation says.
    let of = |position, width, value: f32| single(position, width, [value; 3]);
    let straight = [0.0, 0.0, 2.0];
    let close = |found: f32, weights: [f32; 2]| {
        let expected = weights[1] / (weights[0] + weights[1]);
        assert!((found - expected).abs() < 1e-5, "{found} for {expected}");
    };
    close(light(of(straight, 32, 0.0), of(straight, 16, 1.0)), [4.0, 1.0]);
    close(light(of([0.0, 0.0, 1.0], 16, 0.0), of([0.0, 0.0, 2.0], 16, 1.0)), [4.0, 1.0]);
    let tilted = [2.0 * 0.9375f64.sqrt(), 0.0, 0.5];
    close(light(of(straight, 16, 0.0), of(tilted, 16, 1.0)), [4.0, 1.0]);
    let both = [3.0, 4.0, 12.0];
    close(light(of(straight, 16, 0.0), of(both, 64, 1.0)), [128.0 / 4.0, 2048.0 * 12.0 / 13.0 / 169.0]);
}
