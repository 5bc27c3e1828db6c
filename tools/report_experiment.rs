//! The report's experiment (its chapter 5): three white spheres in a box that three probes have seen empty.
//!
//! `cargo run --release -p gdibl-tools --bin report_experiment -- LIGHTING OUT_FOLDER [SAMPLES [EMPTY.glb SPHERES.glb]]`
//!
//! LIGHTING holds the probes, the distant panorama and reference.json, and, unless they are named, the levels
//! empty-box.glb and uffizi-box.glb. SAMPLES directions leave every place of the tables, and as many / 512 every pixel of
//! the pictures that are not the report's own.
//!
//! Three ways: *report*, 50 random rays by cosine alone, three surfaces deep, as printed (but for the blend of probes, and
//! the shade of the spheres on the box); *gdibl*, the same light with as many rays as it takes; *path*, path tracing, which asks no probe: the truth. Writes pictures of three views, one
//! exposure for all; prints, as Markdown, light at the spheres' extremes and whether what the report says of it holds.
//! Ends with 1 if something does not.

use gdibl_baker::Control;
use gdibl_baker::analyse::TruthLight;
use gdibl_baker::bake::{GatherSettings, Gathered, SurfacePlace, irradiance_at};
use gdibl_baker::import::image::write_png;
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings, SceneHit};
use gdibl_baker::radiance::path::{Path as Paths, PathSettings};
use gdibl_baker::render::{Camera, Picture, RenderSettings, render, tone};
use gdibl_baker::sampling::Sampler;
use gdibl_tools::{BOX_SPHERES, OFF_THE_SURFACE, SPHERE_RADIUS, read_lighting, read_scene, read_truth};
use glam::{DVec3, Vec3};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// The report's: rays per sample, and levels of recursion.
const REPORT_RAYS: u32 = 50;
const REPORT_DEPTH: u32 = 3;
/// Directions per place when nothing is said.
const SAMPLES: u64 = 65_536;
/// Directions of a place per sample of a pixel.
const PER_PIXEL: u64 = 512;
/// Pictures.
const SIZE: (usize, usize) = (400, 225);
/// The report's views: name, eye, target.
const VIEWS: [(&str, DVec3, DVec3); 3] = [
    ("from-blue-corner", DVec3::new(-0.9, 1.6, 2.95), DVec3::new(0.2, 0.8, 0.0)),
    ("from-red-corner", DVec3::new(0.9, 1.6, -2.95), DVec3::new(-0.2, 0.8, 0.0)),
    ("diagonal", DVec3::new(0.9, 1.85, 2.95), DVec3::new(-0.9, 0.15, -2.95)),
];
const FOV_DEGREES: f64 = 75.0;
const SPHERE_NAMES: [&str; 3] = ["A", "B", "C"];
/// Sides of a sphere.
const EXTREMES: [(&str, Vec3); 6] = [
    ("top", Vec3::Y),
    ("bottom", Vec3::NEG_Y),
    ("+x", Vec3::X),
    ("-x", Vec3::NEG_X),
    ("+z", Vec3::Z),
    ("-z", Vec3::NEG_Z),
];
/// The floor under sphere B: x of places at z = 0, metres.
const FLOOR: [f64; 19] =
    [-0.9, -0.8, -0.7, -0.6, -0.5, -0.4, -0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9];

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (lighting, out, samples, levels) = match &arguments[..] {
        [lighting, out] => (lighting, out, SAMPLES, None),
        [lighting, out, samples] => (lighting, out, samples.parse().expect("a number of samples"), None),
        [lighting, out, samples, empty, spheres] => {
            (lighting, out, samples.parse().expect("a number of samples"), Some([empty, spheres].map(PathBuf::from)))
        }
        _ => {
            eprintln!("usage: report_experiment LIGHTING OUT_FOLDER [SAMPLES [EMPTY.glb SPHERES.glb]]");
            return ExitCode::from(2);
        }
    };
    let (lighting, out) = (Path::new(lighting), Path::new(out));
    let [empty, spheres] =
        levels.unwrap_or_else(|| ["empty-box.glb", "uffizi-box.glb"].map(|name| lighting.join(name)));
    std::fs::create_dir_all(out).expect("the output folder");
    let (empty, spheres) = (read_scene(&empty), read_scene(&spheres));
    let (probes, distant) = read_lighting(lighting);
    let settings = GdiblSettings { scene_hit: SceneHit::Recurse(REPORT_DEPTH), ..GdiblSettings::default() };
    let ways = Ways {
        gdibl: Gdibl::new(&spheres, &probes, Some(&distant), settings),
        path: Paths::new(&spheres, Some(&distant), PathSettings::default()),
        empty: Paths::new(&empty, Some(&distant), PathSettings::default()),
        samples,
    };
    pictures(&ways, out);
    let light = extremes(&ways);
    reference(&ways, lighting);
    let mut claims = Claims::default();
    differences(&light, &mut claims);
    bleeding(&light, &mut claims);
    shadow(&ways, &mut claims);
    println!("\n{} of {} claims hold", claims.made - claims.missed, claims.made);
    if claims.missed == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// The same light, found in several ways.
struct Ways<'a> {
    gdibl: Gdibl<'a>,
    path: Paths<'a>,
    /// Truth without the spheres.
    empty: Paths<'a>,
    samples: u64,
}

impl Ways<'_> {
    fn report_light(&self, places: &[SurfacePlace]) -> Vec<Gathered> {
        let settings = GatherSettings {
            samples: REPORT_RAYS.into(),
            sampler: Sampler::Random,
            guided: false,
            ..GatherSettings::default()
        };
        gather(places, &self.gdibl, &settings)
    }

    fn light(&self, function: &impl RadianceFunction, places: &[SurfacePlace]) -> Vec<Gathered> {
        gather(places, function, &GatherSettings { samples: self.samples, ..GatherSettings::default() })
    }
}

fn gather(places: &[SurfacePlace], function: &impl RadianceFunction, settings: &GatherSettings) -> Vec<Gathered> {
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    irradiance_at(places, function, settings, &control).expect("nobody interrupts a tool")
}

/// The three views in three ways, all by the exposure that the path-traced ones ask for.
fn pictures(ways: &Ways, out: &Path) {
    let (width, height) = SIZE;
    let converged = RenderSettings {
        width,
        height,
        samples: (ways.samples / PER_PIXEL).max(1) as u32,
        depth: REPORT_DEPTH,
        ..RenderSettings::default()
    };
    let report = RenderSettings { samples: REPORT_RAYS, sampler: Sampler::Random, ..converged };
    let mut taken = Vec::new();
    println!("| picture | samples per pixel | M rays | seconds | uncovered |\n|---|---|---|---|---|");
    for (name, eye, target) in VIEWS {
        let camera = Camera::Pinhole { eye, target, vertical_fov_degrees: FOV_DEGREES };
        taken.push((format!("{name}-report"), take(&ways.gdibl, &camera, &report, name, "report")));
        taken.push((format!("{name}-gdibl"), take(&ways.gdibl, &camera, &converged, name, "gdibl")));
        taken.push((format!("{name}-path"), take(&ways.path, &camera, &converged, name, "path")));
    }
    let truths = taken.iter().filter(|(name, _)| name.ends_with("-path"));
    let stops: f32 = truths.map(|(_, picture)| tone::automatic_exposure_stops(&picture.image)).sum::<f32>() / 3.0;
    println!("\nExposure of all: {stops:+.2} stops");
    for (name, picture) in &taken {
        let pixels = tone::display(&picture.image, stops);
        write_png(&out.join(format!("{name}.png")), width, height, &pixels).unwrap_or_else(|e| panic!("{e}"));
    }
}

fn take(
    function: &impl RadianceFunction,
    camera: &Camera,
    settings: &RenderSettings,
    view: &str,
    way: &str,
) -> Picture {
    let started = Instant::now();
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    let picture = render(function, None, camera, settings, &control).expect("nobody interrupts a tool");
    println!(
        "| {view}-{way}.png | {} | {:.1} | {:.1} | {:.2} % |",
        settings.samples,
        picture.rays as f64 / 1e6,
        started.elapsed().as_secs_f64(),
        picture.uncovered * 100.0
    );
    picture
}

/// Light at the extremes of every sphere, `[sphere][side]`.
struct Extremes {
    gdibl: Vec<Vec<Gathered>>,
    path: Vec<Vec<Gathered>>,
}

fn extremes(ways: &Ways) -> Extremes {
    let places: Vec<SurfacePlace> = BOX_SPHERES
        .iter()
        .flat_map(|center| {
            EXTREMES.map(|(_, normal)| {
                let height = f64::from(SPHERE_RADIUS) + OFF_THE_SURFACE;
                SurfacePlace { position: *center + normal.as_dvec3() * height, normal }
            })
        })
        .collect();
    let report = ways.report_light(&places);
    let (gdibl, path) = (ways.light(&ways.gdibl, &places), ways.light(&ways.path, &places));
    println!(
        "\nIrradiance (R G B) at the spheres' extremes: {REPORT_RAYS} random rays, {} directions, and as many paths\n",
        ways.samples
    );
    println!("| sphere | side | report | gdibl | path | ± | report off by | gdibl off by |");
    println!("|---|---|---|---|---|---|---|---|");
    for (i, ((report, gdibl), path)) in report.iter().zip(&gdibl).zip(&path).enumerate() {
        println!(
            "| {} | {} | {} | {} | {} | {} | {:.1} % | {:.1} % |",
            SPHERE_NAMES[i / 6],
            EXTREMES[i % 6].0,
            rgb(report.irradiance),
            rgb(gdibl.irradiance),
            rgb(path.irradiance),
            rgb(path.standard_error),
            off_by(report, path) * 100.0,
            off_by(gdibl, path) * 100.0
        );
    }
    let truth: Vec<DVec3> = path.iter().map(|p| p.irradiance).collect();
    println!();
    summary("report", &report, &path, &truth);
    summary("gdibl", &gdibl, &path, &truth);
    let rows = |all: Vec<Gathered>| all.chunks(6).map(<[Gathered]>::to_vec).collect();
    Extremes { gdibl: rows(gdibl), path: rows(path) }
}

/// One line: how far from the truth, and how much of that is noise.
fn summary(name: &str, found: &[Gathered], truth_noise: &[Gathered], truth: &[DVec3]) {
    let square: f64 = truth.iter().map(|e| e.length_squared()).sum();
    let relative = |sum: f64| (sum / square).sqrt() * 100.0;
    let error: f64 = found.iter().zip(truth).map(|(f, t)| (f.irradiance - *t).length_squared()).sum();
    let noise: f64 = found.iter().chain(truth_noise).map(|f| f.standard_error.length_squared()).sum();
    let total = |all: &mut dyn Iterator<Item = DVec3>| all.map(|e| e.element_sum()).sum::<f64>();
    let bias = total(&mut found.iter().map(|f| f.irradiance)) / total(&mut truth.iter().copied()) - 1.0;
    println!(
        "- {name}: relative RMSE {:.2} % over {} places, of which noise (both sides') explains {:.2} %; bias {:+.2} %",
        relative(error),
        found.len(),
        relative(noise),
        bias * 100.0
    );
}

/// Against the truth that another renderer made, at the places of reference.json.
fn reference(ways: &Ways, lighting: &Path) {
    let set = "sphere_irradiance_with_spheres";
    let truth = read_truth(lighting, &[set]).remove(0);
    let TruthLight::Irradiance(light) = &truth.light else { panic!("{set} holds irradiance") };
    let both = truth.positions.iter().zip(&truth.normals);
    let places: Vec<SurfacePlace> = both
        .map(|(position, normal)| {
            let normal = Vec3::from(*normal);
            SurfacePlace { position: DVec3::from(*position) + normal.as_dvec3() * OFF_THE_SURFACE, normal }
        })
        .collect();
    let light: Vec<DVec3> = light.iter().map(|e| Vec3::from(*e).as_dvec3()).collect();
    println!("\nAgainst reference.json, {set}:\n");
    summary("report", &ways.report_light(&places), &[], &light);
    summary("gdibl", &ways.light(&ways.gdibl, &places), &[], &light);
    summary("path", &ways.light(&ways.path, &places), &[], &light);
}

/// What the report says, and whether it is so.
#[derive(Default)]
struct Claims {
    made: u32,
    missed: u32,
}

impl Claims {
    fn check(&mut self, claim: &str, holds: bool) {
        self.made += 1;
        self.missed += u32::from(!holds);
        println!("- {}: {claim}", if holds { "holds" } else { "DOES NOT HOLD" });
    }
}

/// "The light differs between the spheres, in intensity and in colour."
fn differences(light: &Extremes, claims: &mut Claims) {
    println!("\nMean over a sphere's extremes: luminance of E, and the shares of R, G and B\n");
    println!("| sphere | gdibl | path | gdibl | path |\n|---|---|---|---|---|");
    let mean = |sides: &[Gathered]| sides.iter().map(|s| s.irradiance).sum::<DVec3>() / sides.len() as f64;
    let shares = |e: DVec3| e / e.element_sum();
    for ((name, gdibl), path) in SPHERE_NAMES.iter().zip(&light.gdibl).zip(&light.path) {
        let (gdibl, path) = (mean(gdibl), mean(path));
        println!(
            "| {name} | {:.3} | {:.3} | {} | {} |",
            luminance(gdibl),
            luminance(path),
            rgb(shares(gdibl)),
            rgb(shares(path))
        );
    }
    println!();
    let noise = light.gdibl.iter().flatten().map(|s| luminance(s.standard_error)).fold(0.0, f64::max);
    let spread = |of: &dyn Fn(DVec3) -> f64| {
        let all: Vec<f64> = light.gdibl.iter().map(|sides| of(mean(sides))).collect();
        (all.iter().copied().fold(f64::INFINITY, f64::min), all.iter().copied().fold(0.0, f64::max))
    };
    let (least, most) = spread(&luminance);
    let claim = format!("the brightest sphere gets {:.2} times the light of the dimmest", most / least);
    claims.check(&claim, most - least > 5.0 * noise);
    let (least, most) = spread(&|e| e.z / e.x);
    let claim = format!("B/R of the bluest sphere is {:.2} times that of the reddest", most / least);
    claims.check(&claim, most / least > 1.05);
}

/// "Colour bleeds from the corners onto the spheres." Side +x is 2 and -x is 3 of [`EXTREMES`]; the blue corner is on the
/// -x side of A, the red one on the +x side of C.
fn bleeding(light: &Extremes, claims: &mut Claims) {
    println!("\nColour bleeding\n");
    let ratio = |side: &Gathered, of: &dyn Fn(DVec3) -> f64| of(side.irradiance);
    for (name, sphere, near, far, of) in [
        ("B/R on the side of A that faces the blue corner", 0, 3, 2, (|e| e.z / e.x) as fn(DVec3) -> f64),
        ("R/B on the side of C that faces the red corner", 2, 2, 3, |e| e.x / e.z),
    ] {
        let bleeding = |sides: &[Gathered]| ratio(&sides[near], &of) / ratio(&sides[far], &of);
        let (gdibl, path) = (bleeding(&light.gdibl[sphere]), bleeding(&light.path[sphere]));
        let claim = format!("{name} is {gdibl:.2} times that of the other side; by path tracing {path:.2} times");
        claims.check(&claim, gdibl > 1.1 && (gdibl / path - 1.0).abs() < 0.1);
    }
}

/// "Shadows are soft": the floor under sphere B.
fn shadow(ways: &Ways, claims: &mut Claims) {
    let places = FLOOR.map(|x| SurfacePlace { position: DVec3::new(x, OFF_THE_SURFACE, 0.0), normal: Vec3::Y });
    let gdibl = ways.light(&ways.gdibl, &places);
    let path = ways.light(&ways.path, &places);
    let empty = ways.light(&ways.empty, &places);
    println!(
        "\nThe floor under sphere B: luminance of E along x at z = 0, and the share of the empty box's that is left\n"
    );
    println!("| x | gdibl | path | ± | empty box | left by gdibl | by path |\n|---|---|---|---|---|---|---|");
    let left = |with: &[Gathered]| -> Vec<f64> {
        with.iter().zip(&empty).map(|(w, e)| luminance(w.irradiance) / luminance(e.irradiance)).collect()
    };
    let (left_gdibl, left_path) = (left(&gdibl), left(&path));
    for (i, x) in FLOOR.iter().enumerate() {
        let of = |all: &[Gathered]| luminance(all[i].irradiance);
        println!(
            "| {x:.1} | {:.4} | {:.4} | {:.4} | {:.4} | {:.1} % | {:.1} % |",
            of(&gdibl),
            of(&path),
            luminance(path[i].standard_error),
            of(&empty),
            left_gdibl[i] * 100.0,
            left_path[i] * 100.0
        );
    }
    println!();
    let truth: Vec<DVec3> = path.iter().map(|p| p.irradiance).collect();
    summary("gdibl", &gdibl, &path, &truth);
    let least = left_gdibl.iter().copied().fold(f64::INFINITY, f64::min);
    let steepest = left_gdibl.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
    let depth = 1.0 - least;
    let claim = format!(
        "the shadow takes up to {:.0} % of the light, and changes by no more than {:.0} % of that in 0.1 m: it is soft",
        depth * 100.0,
        steepest / depth * 100.0
    );
    claims.check(&claim, depth > 0.1 && steepest < 0.5 * depth);
}

/// |found - truth| / |truth| over R, G and B.
fn off_by(found: &Gathered, truth: &Gathered) -> f64 {
    (found.irradiance - truth.irradiance).length() / truth.irradiance.length()
}

fn luminance(e: DVec3) -> f64 {
    e.dot(DVec3::new(0.2126, 0.7152, 0.0722))
}

fn rgb(e: DVec3) -> String {
    format!("{:.3} {:.3} {:.3}", e.x, e.y, e.z)
}
