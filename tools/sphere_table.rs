//! The report's own case: irradiance on the three spheres of the box, against path-traced truth.
//!
//! `cargo run --release -p gdibl-tools --bin sphere_table -- EMPTY_BOX.glb BOX_WITH_SPHERES.glb LIGHTING [SAMPLES]`
//!
//! Rows: the empty box on a grid of 0.2 m; the box with spheres (recursion), on the same grid and at the places
//! themselves. Bands tell truncation, the empty box at the places themselves tells interpolation.

use gdibl_baker::bake::{BakeSettings, Nodes, grid_of_spacing};

use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings};
use gdibl_tools::{Reference, ReferenceIrradiance, bake_all, read_lighting, read_scene, volume_of};
use glam::{DVec3, Vec3};
use std::path::Path;

/// Nodes of the grid, metres apart.
const SPACING: f64 = 0.2;
/// Points leave the exact sphere by this much, metres: the level's spheres are polyhedra.
const OFFSET: f64 = 1e-3;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [empty, spheres, lighting, rest @ ..] = &arguments[..] else {
        eprintln!("usage: sphere_table EMPTY_BOX.glb BOX_WITH_SPHERES.glb LIGHTING_FOLDER [SAMPLES]");
        std::process::exit(2);
    };
    let samples: u64 = rest.first().map_or(4096, |s| s.parse().expect("a number of samples"));
    let (probes, distant) = read_lighting(Path::new(lighting));
    let reference = Reference::read(&Path::new(lighting).join("reference.json"));
    println!("| scene | nodes | SH | relative RMSE of E | bias |");
    println!("|---|---|---|---|---|");
    let cases = [
        ("empty box", empty, &reference.sphere_irradiance_empty_box),
        ("with spheres", spheres, &reference.sphere_irradiance_with_spheres),
    ];
    for (name, level, truth) in cases {
        let scene = read_scene(Path::new(level));
        let function = Gdibl::new(&scene, &probes, Some(&distant), GdiblSettings::default());
        let (min, max) = scene.bounds(|_| true).expect("triangles");
        let places = truth.position.iter().zip(&truth.normal);
        let points = places.map(|(p, n)| DVec3::from(*p) + Vec3::from(*n).as_dvec3() * OFFSET).collect();
        let kinds =
            [("grid 0.2 m", Nodes::Grid(grid_of_spacing(min, max, SPACING))), ("at the places", Nodes::Points(points))];
        for (kind, nodes) in kinds {
            for bands in [1, 2, 4] {
                let settings = BakeSettings { samples, bands, ..BakeSettings::default() };
                let volume = volume_of(&nodes, &bake_all(&function, &nodes, &settings));
                let (error, bias) = compare(truth, |position, normal| {
                    volume.sample_f64(position, normal).sh.convolve().evaluate(normal)
                });
                println!("| {name} | {kind} | L{bands} | {:.2} % | {:+.2} % |", error * 100.0, bias * 100.0);
            }
        }
    }
}

/// Relative RMSE and bias over places and channels.
fn compare(truth: &ReferenceIrradiance, irradiance: impl Fn([f64; 3], [f32; 3]) -> [f32; 3]) -> (f64, f64) {
    let (mut difference, mut square, mut signed, mut sum) = (0.0, 0.0, 0.0, 0.0);
    for ((position, normal), expected) in truth.position.iter().zip(&truth.normal).zip(&truth.irradiance) {
        for (found, expected) in irradiance(*position, *normal).into_iter().zip(expected) {
            let (found, expected) = (f64::from(found), f64::from(*expected));
            difference += (found - expected).powi(2);
            square += expected * expected;
            signed += found - expected;
            sum += expected;
        }
    }
    ((difference / square).sqrt(), signed / sum)
}
