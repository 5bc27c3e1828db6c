//! The path tracer against another renderer's truth, as a Markdown table: how many values of E agree within three standard
//! errors of both and half a per cent, and the mean signed difference.
//!
//! `cargo run --release -p gdibl-tools --bin path_table -- EMPTY_BOX.glb BOX_WITH_SPHERES.glb LIGHTING_FOLDER [SAMPLES]`

use gdibl_baker::Control;
use gdibl_baker::analyse::{Truth, TruthLight, TruthNoise, radiance_sh};
use gdibl_baker::bake::{BakeSettings, GatherSettings, Nodes, SurfacePlace, irradiance_at};
use gdibl_baker::import::gltf::{GltfOptions, TextureNeeds, read_level};
use gdibl_baker::radiance::Distant;
use gdibl_baker::radiance::path::{Path as Paths, PathSettings};
use gdibl_baker::sampling::fibonacci_sphere;
use gdibl_baker::scene::Scene;
use gdibl_runtime::sh;
use gdibl_tools::{bake_all, read_lighting, read_truth};
use glam::{DVec3, Vec3};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Tessellated spheres lie inside the true ones: places leave them by this, metres.
const OFFSET: f64 = 2e-3;
/// The panorama was resampled after the truth was made.
const RESAMPLING: f64 = 5e-3;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [empty, spheres, folder, rest @ ..] = &arguments[..] else {
        eprintln!("usage: path_table EMPTY_BOX.glb BOX_WITH_SPHERES.glb LIGHTING_FOLDER [SAMPLES]");
        std::process::exit(2);
    };
    let samples: u64 = rest.first().map_or(65_536, |s| s.parse().expect("a number of samples"));
    let folder = Path::new(folder);
    let (_, distant) = read_lighting(folder);
    let [empty, spheres] = [empty, spheres].map(|level| {
        let options = GltfOptions { textures: TextureNeeds::All, ..GltfOptions::default() };
        read_level(Path::new(level), &options).unwrap_or_else(|e| panic!("{e}"))
    });
    println!("| set | values | agree | mean signed difference | mean standard error of both |");
    println!("|---|---|---|---|---|");
    for (name, scene) in [
        ("grid", &empty),
        ("scattered", &empty),
        ("sphere_irradiance_empty_box", &empty),
        ("sphere_irradiance_with_spheres", &spheres),
    ] {
        let truth = &read_truth(folder, &[name])[0];
        let values = match &truth.light {
            TruthLight::Radiance(_) => at_nodes(scene, &distant, truth, samples),
            TruthLight::Irradiance(_) => on_surfaces(scene, &distant, truth, samples),
        };
        assert!(!values.is_empty(), "{name}: nothing compared");
        let count = values.len() as f64;
        let agree = values.iter().filter(|v| (v.found - v.truth).abs() <= 3.0 * v.error + RESAMPLING * v.truth.abs());
        let truth: f64 = values.iter().map(|v| v.truth).sum();
        let found: f64 = values.iter().map(|v| v.found).sum();
        println!(
            "| {name} | {} | {:.2} % | {:+.2} % | {:.2} % |",
            values.len(),
            100.0 * agree.count() as f64 / count,
            100.0 * (found / truth - 1.0),
            100.0 * values.iter().map(|v| v.error).sum::<f64>() / truth
        );
    }
}

/// E in one channel, and one standard error of both sides.
struct Value {
    found: f64,
    truth: f64,
    error: f64,
}

/// E in 26 directions at every node, from coefficients to L2 on both sides.
fn at_nodes(scene: &Scene, distant: &Distant, truth: &Truth, samples: u64) -> Vec<Value> {
    let (TruthLight::Radiance(light), TruthNoise::Radiance(noise)) = (&truth.light, &truth.noise) else {
        panic!("{}: expected radiance with standard errors", truth.name)
    };
    let nodes = Nodes::Points(truth.positions.iter().map(|p| DVec3::from(*p)).collect());
    let path = Paths::new(scene, Some(distant), PathSettings::default());
    let baked = bake_all(&path, &nodes, &BakeSettings { samples, ..BakeSettings::default() });
    let median = {
        let mut rms: Vec<f64> = (0..nodes.len()).map(|n| rms_irradiance(&baked, n)).collect();
        rms.sort_by(f64::total_cmp);
        rms[rms.len() / 2]
    };
    let mut values = Vec::new();
    for node in 0..nodes.len() {
        let found = sh_of(&baked, node).convolve();
        // The node's standard error is a mean over directions and channels.
        let own = f64::from(baked.relative_error[node]) * rms_irradiance(&baked, node).max(0.1 * median);
        let expected = light[node].convolve();
        for direction in fibonacci_sphere(26) {
            let theirs = irradiance_error(&noise[node].coefficients, direction);
            let pairs = found.evaluate(direction.to_array()).into_iter().zip(expected.evaluate(direction.to_array()));
            values.extend(pairs.zip(theirs).map(|((found, truth), theirs)| Value {
                found: found.into(),
                truth: truth.into(),
                error: own.hypot(theirs),
            }));
        }
    }
    values
}

fn sh_of(baked: &gdibl_baker::bake::Baked, node: usize) -> gdibl_runtime::RadianceSh {
    radiance_sh(baked.bands, baked.node(node).chunks_exact(3).map(|rgb| [rgb[0], rgb[1], rgb[2]]))
}

/// Root mean square of E over 26 directions and the channels.
fn rms_irradiance(baked: &gdibl_baker::bake::Baked, node: usize) -> f64 {
    let irradiance = sh_of(baked, node).convolve();
    let values = fibonacci_sphere(26).into_iter().flat_map(|d| irradiance.evaluate(d.to_array()));
    (values.map(|v| f64::from(v).powi(2)).sum::<f64>() / 78.0).sqrt()
}

/// Standard error of E in a direction, from those of independent coefficients.
fn irradiance_error(errors: &[[f32; 3]], direction: Vec3) -> [f64; 3] {
    let mut basis = [0.0; sh::MAX_COEFFICIENTS];
    sh::basis(2, direction.to_array(), &mut basis);
    [0, 1, 2].map(|channel| {
        let square = |i: usize| (sh::COSINE[sh::band_of(i)] * basis[i] * errors[i][channel]).powi(2);
        f64::from((0..9).map(square).sum::<f32>()).sqrt()
    })
}

/// E at places with normals, straight over their hemispheres.
fn on_surfaces(scene: &Scene, distant: &Distant, truth: &Truth, samples: u64) -> Vec<Value> {
    let (TruthLight::Irradiance(light), TruthNoise::Irradiance(noise)) = (&truth.light, &truth.noise) else {
        panic!("{}: expected irradiance with standard errors", truth.name)
    };
    let place = |(p, n): (&[f64; 3], &[f32; 3])| {
        let normal = Vec3::from(*n);
        SurfacePlace { position: DVec3::from(*p) + normal.as_dvec3() * OFFSET, normal }
    };
    let places: Vec<_> = truth.positions.iter().zip(&truth.normals).map(place).collect();
    let path = Paths::new(scene, Some(distant), PathSettings::default());
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    let settings = GatherSettings { samples, ..GatherSettings::default() };
    let found = irradiance_at(&places, &path, &settings, &control).expect("nobody interrupts a tool");
    let mut values = Vec::new();
    for ((found, truth), noise) in found.iter().zip(light).zip(noise) {
        values.extend((0..3).map(|channel| Value {
            found: found.irradiance[channel],
            truth: truth[channel].into(),
            error: found.standard_error[channel].hypot(noise[channel].into()),
        }));
    }
    values
}
