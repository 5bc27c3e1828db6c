//! Small lamps that are in the pixels of probes and nowhere else: found by construction, and no light is made up.

use gdibl_baker::bake::{BakeSettings, Baked};
use gdibl_baker::job::plan::plan;
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::radiance::gdibl::{Gdibl, Probe};
use gdibl_baker::sampling::fibonacci_sphere;
use gdibl_baker::scene::{Role, Scene};
use glam::{DVec3, Vec3};

use crate::level::*;

/// A lamp of 10 cm on the ceiling of [`room`].
const LAMP: DVec3 = DVec3::new(1.0, 1.5, 0.5);
const LAMP_RADIUS: f64 = 0.05;
const LAMP_RADIANCE: f32 = 1e4;

fn room() -> Scene {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::new(-3.0, -1.5, -2.0), DVec3::new(3.0, 1.5, 2.0)));
    scene
}

/// The room's light from a place: walls of 1, the lamp in the pixels whose centres see it.
fn lit_probe(position: DVec3, lamp: f32) -> Probe {
    probe(position, 128, |direction| {
        let direction = direction.as_dvec3();
        let met = position + direction * ((LAMP.y - position.y) / direction.y);
        let on_lamp = direction.y > 0.0 && met.distance(LAMP) < LAMP_RADIUS;
        [if on_lamp { lamp } else { 1.0 }; 3]
    })
}

fn probes(lamp: f32) -> [Probe; 2] {
    [lit_probe(DVec3::new(0.8, 0.4, 0.3), lamp), lit_probe(DVec3::new(-1.5, 0.1, -0.3), lamp)]
}

/// Root of the mean square of E over 26 normals, of coefficients.
fn rms_irradiance(baked: &[f32]) -> f64 {
    let sh = gdibl_baker::analyse::radiance_sh(2, baked.chunks_exact(3).map(|rgb| [rgb[0], rgb[1], rgb[2]])).convolve();
    let squares: f64 = fibonacci_sphere(26).iter().map(|n| f64::from(sh.evaluate(n.to_array())[0]).powi(2)).sum();
    (squares / 26.0).sqrt()
}

fn difference_of(a: &[f32], b: &[f32]) -> f64 {
    rms_irradiance(&a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<f32>>())
}

fn bake_at(function: &Gdibl, points: &[DVec3], samples: u64, importance: bool, seed: u64) -> Baked {
    bake_points(function, points, &BakeSettings { samples, importance, seed, ..SMALL })
}

const POINTS: [DVec3; 3] = [DVec3::new(-0.5, 0.2, -0.4), DVec3::new(1.1, 0.9, 0.4), DVec3::new(2.0, -1.0, -1.5)];

#[test]
fn small_lamp_in_pixels_is_found_and_tells_what_uniform_directions_tell() {
    let (scene, probes) = (room(), probes(LAMP_RADIANCE));
    let function = gdibl(&scene, &probes, None);
    assert!((4..500).contains(&function.region_count()), "{}", function.region_count());
    assert!(plan(&scene, &function).iter().any(|row| row.stage == "bright-regions" && row.kept));
    // The same light within 3 standard errors of both, by directions of which none knows of the lamp.
    let slow = bake_at(&function, &POINTS, 1 << 21, false, 1);
    let fast = bake_at(&function, &POINTS, 1 << 14, true, 2);
    for node in 0..POINTS.len() {
        let light = rms_irradiance(&fast.node(node));
        let off = difference_of(&slow.node(node), &fast.node(node)) / light;
        let error = f64::hypot(slow.relative_error[node].into(), fast.relative_error[node].into());
        println!("node {node}: E {light:.3}, off by {:.2} %, {:.2} standard errors", 100.0 * off, off / error);
        assert!(light > 1.2 * std::f64::consts::PI, "node {node}: the lamp counts");
        assert!(off < 3.0 * error && error < 0.05, "node {node}: {off} {error}");
    }
    // Noise over 8 seeds, relative. 1024 uniform directions meet the lamp less than once from two of the places.
    let noise = |importance| {
        let squares = (0..8).flat_map(|seed| {
            let baked = bake_at(&function, &POINTS, 1024, importance, seed);
            let off = |n: usize| difference_of(&baked.node(n), &fast.node(n)) / rms_irradiance(&fast.node(n));
            [0, 1, 2].map(|node| off(node).powi(2))
        });
        (squares.sum::<f64>() / 24.0).sqrt()
    };
    let (with, without) = (noise(true), noise(false));
    println!("noise of E at 1024 directions: {:.2} % with, {:.2} % without", 100.0 * with, 100.0 * without);
    // 1.3 % and 78 %; of 24 squares each, known to a third.
    assert!(with < 0.1 * without, "{with} {without}");
}

#[test]
fn lamp_behind_a_wall_adds_no_light() {
    // The lamp is on one side of the wall, with the first probe; nodes are on the other, with the second.
    let mut scene = room();
    let [a, b, c, d] = [[-1.5, -2.0], [1.5, -2.0], [1.5, 2.0], [-1.5, 2.0]].map(|[y, z]| DVec3::new(-0.1, y, z));
    add(&mut scene, Role::Environment, &[[a, b, c], [a, c, d]]);
    let probes = probes(LAMP_RADIANCE);
    let probes = [probes[0].clone(), lit_probe(probes[1].position, 1.0)];
    let function = gdibl(&scene, &probes, None);
    assert!(function.region_count() > 0);
    let points = [DVec3::new(-0.5, 0.2, -0.4), DVec3::new(-2.0, 1.3, 1.2)];
    let baked = bake_at(&function, &points, 1024, true, 0);
    for node in 0..points.len() {
        for normal in fibonacci_sphere(26) {
            let irradiance = f64::from(sh_of(&baked, node).convolve().evaluate(normal.to_array())[0]);
            assert!((irradiance / std::f64::consts::PI - 1.0).abs() < 1e-4, "node {node}: {irradiance}");
        }
    }
}

#[test]
fn light_all_alike_has_no_bright_regions() {
    let (scene, probes) = (room_with_pillar(), coloured_probes());
    let function = gdibl(&scene, &probes, None);
    assert_eq!((function.region_count(), function.guide().emitter_count()), (0, 0));
    assert!(plan(&scene, &function).iter().any(|row| row.stage == "bright-regions" && !row.kept));
    // Nor has what escapes: a sun in the pixels of a probe is no surface.
    let mut open = Scene::default();
    let [a, b, c] = [[-9.0, -9.0], [0.0, 9.0], [9.0, -9.0]].map(|[x, z]| DVec3::new(x, -1.0, z));
    add(&mut open, Role::Environment, &[[a, b, c]]);
    let sun = Vec3::new(0.3, 0.9, 0.1).normalize();
    let sunny = [probe(DVec3::ZERO, 64, |d| [if d.dot(sun) > 0.99 { 1e4 } else { 1.0 }; 3])];
    assert_eq!(gdibl(&open, &sunny, None).region_count(), 0);
}
