//! The report's own case: irradiance on the three spheres of the box, against path-traced truth.
//!
//! `cargo run --release -p gdibl-tools --bin sphere_table -- EMPTY_BOX.glb BOX_WITH_SPHERES.glb LIGHTING [SAMPLES]`
//!
//! Rows: the empty box on a grid of 0.2 m; the box with spheres (recursion), on the same grid and at the places
//! themselves. Bands tell truncation, the empty box at the places themselves tells interpolation.

use gdibl_baker::analyse::{CompareSettings, Truth, compare};
use gdibl_baker::bake::{BakeSettings, Nodes, grid_of_spacing};
use gdibl_baker::pack::volume_of;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings};
use gdibl_tools::{OFF_THE_SURFACE, bake_all, read_lighting, read_scene, read_truth};
use glam::{DVec3, Vec3};
use std::path::Path;

/// Nodes of the grid, metres apart.
const SPACING: f64 = 0.2;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [empty, spheres, lighting, rest @ ..] = &arguments[..] else {
        eprintln!("usage: sphere_table EMPTY_BOX.glb BOX_WITH_SPHERES.glb LIGHTING_FOLDER [SAMPLES]");
        std::process::exit(2);
    };
    let samples: u64 = rest.first().map_or(4096, |s| s.parse().expect("a number of samples"));
    let (probes, distant) = read_lighting(Path::new(lighting));
    println!("| scene | nodes | SH | relative RMSE of E | bias |");
    println!("|---|---|---|---|---|");
    let cases = [
        ("empty box", empty, "sphere_irradiance_empty_box"),
        ("with spheres", spheres, "sphere_irradiance_with_spheres"),
    ];
    for (name, level, set) in cases {
        let scene = read_scene(Path::new(level));
        let function = Gdibl::new(&scene, &probes, Some(&distant), GdiblSettings::default());
        let (min, max) = scene.bounds(|_| true).expect("triangles");
        let exact = read_truth(Path::new(lighting), &[set]);
        let off: Vec<Truth> = exact.iter().map(off_the_surface).collect();
        let points = off[0].positions.iter().map(|p| DVec3::from(*p)).collect();
        let kinds = [
            ("grid 0.2 m", Nodes::Grid(grid_of_spacing(min, max, SPACING)), exact),
            ("at the places", Nodes::Points(points), off),
        ];
        for (kind, nodes, truth) in kinds {
            for bands in [1, 2, 4] {
                let settings = BakeSettings { samples, bands, ..BakeSettings::default() };
                let volume = volume_of(&nodes, &bake_all(&function, &nodes, &settings));
                let comparison = compare(&volume, &truth, &CompareSettings::default());
                let comparison = comparison.unwrap_or_else(|nothing| panic!("{nothing}"));
                assert_eq!(comparison.places.compared, truth[0].positions.len(), "every place is in the box");
                let (error, bias) = (comparison.all.relative_rmse, comparison.all.bias);
                println!("| {name} | {kind} | L{bands} | {:.2} % | {:+.2} % |", error * 100.0, bias * 100.0);
            }
        }
    }
}

/// The same light, where the points are baked.
fn off_the_surface(truth: &Truth) -> Truth {
    let both = truth.positions.iter().zip(&truth.normals);
    let moved =
        |(p, n): (&[f64; 3], &[f32; 3])| (DVec3::from(*p) + Vec3::from(*n).as_dvec3() * OFF_THE_SURFACE).to_array();
    Truth { positions: both.map(moved).collect(), ..truth.clone() }
}
