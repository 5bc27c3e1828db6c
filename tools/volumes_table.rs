//! What several volumes of a level are worth: the two-storey house as one volume and as two, light between nodes as the runtime reads
//! it, against path tracing at the same places. A Markdown row per way to bake, and kind of place.
//!
//! `cargo run --release -p gdibl-tools --bin volumes_table -- SKY.hdr`; some minutes. The sun is extracted. Truth has 32,768
//! directions per place, and the square of its noise is subtracted. Errors are relative to the larger of E and a tenth of its median;
//! RMSE is over root mean square of E.

use std::sync::atomic::AtomicBool;

use gdibl_baker::Control;
use gdibl_baker::bake::{GatherSettings, Gathered, SurfacePlace, irradiance_at};
use gdibl_baker::job::records::SeenErrors;
use gdibl_baker::job::{Inputs, Memory, Settings, SunLight, Volumes, Wanted, Watch};
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::radiance::path::{Path as Paths, PathSettings};
use gdibl_baker::scene::VolumeMarker;
use gdibl_baker::seen::places;
use gdibl_runtime::{Volume, VolumeSet};
use gdibl_tools::made_levels::two_storey;
use gdibl_tools::read_distant;
use glam::{DMat3, DVec3, Vec3};

/// Places in the air, and on surfaces.
const PLACES: usize = 500;
const TRUTH: u64 = 32_768;
/// Next to no light, as a share of the median: two surfaces touch there.
const HIDDEN: f64 = 1e-3;
/// Corners of the house's inside, metres.
const HOUSE: [[f64; 3]; 2] = [[0.3, 0.06, 0.3], [9.7, 6.05, 7.7]];

/// A box and its spacing, metres.
type Box = ([f64; 3], [f64; 3], f64);

fn main() {
    let sky = std::env::args().nth(1).expect("volumes_table SKY.hdr");
    let [low, high] = HOUSE;
    let whole = |spacing: f64| (low, high, spacing);
    // Beside the partition at x = 6 and around the floor at y = 2.9 to 3.2.
    let lower = |spacing: f64| (low, [high[0], 3.05, high[2]], spacing);
    let upper = |spacing: f64| ([low[0], 3.05, low[2]], high, spacing);
    let rooms = |spacing: f64| ([6.0, low[1], low[2]], high, spacing);
    let ways: [(&str, Vec<Box>); 6] = [
        ("one, 0.5 m", vec![whole(0.5)]),
        ("one, 0.35 m", vec![whole(0.35)]),
        ("one, 0.25 m", vec![whole(0.25)]),
        ("by storey, 0.35 m", vec![lower(0.35), upper(0.35)]),
        ("rooms 0.25 m, all 0.5 m", vec![rooms(0.25), whole(0.5)]),
        ("lower storey 0.25 m, all 0.5 m", vec![lower(0.25), whole(0.5)]),
    ];
    let mut settings = Settings::default();
    settings.quality.sun = SunLight::Extract;
    let inputs = Inputs { distant: Some(read_distant(sky.as_ref())), ..Inputs::new(two_storey()) };
    let mut sets = None;
    println!("| volumes | nodes | bytes | places | median | p95 | p99 | RMSE |");
    println!("|---|---|---|---|---|---|---|---|");
    for (name, boxes) in ways {
        let wanted = boxes.iter().enumerate().map(|(number, given)| wanted(number, given, &settings)).collect();
        let mut volumes =
            Volumes::prepare(inputs.clone(), wanted, Memory::UNBOUNDED).unwrap_or_else(|stop| panic!("{stop}"));
        let sets = sets.get_or_insert_with(|| Set::both(&volumes.job(0).inputs));
        let spacings: Vec<f64> = volumes.list().iter().map(|listed| listed.spacing).collect();
        let (mut baked, mut bytes, mut nodes) = (Vec::new(), 0, 0);
        for (number, spacing) in spacings.into_iter().enumerate() {
            let made = volumes.job(number).bake(&Watch::silent(&AtomicBool::new(false)));
            let file = made.unwrap_or_else(|stop| panic!("{stop}")).sections().assemble().bytes;
            let volume = Volume::parse(&file).expect("what was packed parses");
            (bytes, nodes) = (bytes + file.len(), nodes + volume.node_count());
            baked.push((volume, spacing));
        }
        let light = VolumeSet::new(baked).expect("grids");
        for set in sets.iter() {
            let (found, rmse) = set.errors(&light);
            let percent = |share: f64| format!("{:.1} %", 100.0 * share);
            let [median, p95, p99, rmse] = [found.median, found.p95, found.p99, rmse].map(percent);
            let kind = if set.in_the_air { "air" } else { "surfaces" };
            let count = set.places.len();
            println!("| {name} | {nodes} | {bytes} | {count} {kind} | {median} | {p95} | {p99} | {rmse} |");
        }
    }
}

fn wanted(number: usize, (min, max, spacing): &Box, settings: &Settings) -> Wanted {
    let (min, max) = (DVec3::from(*min), DVec3::from(*max));
    let marker = VolumeMarker {
        name: format!("volume {number}"),
        node: format!("box {number}"),
        spacing: *spacing,
        center: (min + max) / 2.0,
        half_axes: DMat3::from_diagonal((max - min) / 2.0),
        settings: Vec::new(),
    };
    Wanted { marker, settings: settings.clone() }
}

/// Places in the house with the true light there.
struct Set {
    in_the_air: bool,
    places: Vec<SurfacePlace>,
    truth: Vec<Gathered>,
}

impl Set {
    /// In the air, and on surfaces. `inputs` are without their sun.
    fn both(inputs: &Inputs) -> [Set; 2] {
        let function = Paths::new(&inputs.scene, inputs.distant.as_ref(), PathSettings::default());
        let (bounds, tries) = (HOUSE.map(DVec3::from), 8 * PLACES as u32);
        [true, false].map(|in_the_air| {
            let places = match in_the_air {
                true => places::in_the_air(bounds, tries, 99),
                false => places::on_surfaces(&inputs.scene, bounds, function.frame().metres(5e-3).into(), tries, 99),
            };
            let pilot = gather(&function, &places, 256);
            let sizes: Vec<f64> = pilot.iter().map(|found| size(found.irradiance.as_vec3())).collect();
            let open = (0..places.len()).filter(|place| is_open(&function, &places[*place]));
            let open: Vec<usize> = open.collect();
            let median = SeenErrors::of(open.iter().map(|place| sizes[*place])).expect("some place is lit").median;
            let lit = open.into_iter().filter(|place| sizes[*place] > HIDDEN * median);
            let places: Vec<SurfacePlace> = lit.map(|place| places[place]).take(PLACES).collect();
            let truth = gather(&function, &places, TRUTH);
            Set { in_the_air, places, truth }
        })
    }

    /// Of light at each place; and the relative RMSE.
    fn errors(&self, light: &VolumeSet) -> (SeenErrors, f64) {
        let sizes: Vec<f64> = self.truth.iter().map(|found| size(found.irradiance.as_vec3())).collect();
        let floor = 0.1 * SeenErrors::of(sizes.iter().copied()).expect("some place").median;
        let (mut errors, mut square, mut all) = (Vec::new(), 0.0, 0.0);
        for ((place, truth), own) in self.places.iter().zip(&self.truth).zip(&sizes) {
            let noise = size(truth.standard_error.as_vec3());
            let found = Vec3::from(light.irradiance_f64(place.position.into(), place.normal.into()));
            let beyond = size(found - truth.irradiance.as_vec3()).powi(2) - noise * noise;
            errors.push(beyond.max(0.0).sqrt() / own.max(floor));
            square += beyond;
            all += own * own;
        }
        (SeenErrors::of(errors.into_iter()).expect("some place"), (square.max(0.0) / all).sqrt())
    }
}

/// Few backs of triangles are seen from there.
fn is_open(function: &Paths, place: &SurfacePlace) -> bool {
    let level = function.level();
    let origin = function.frame().to_trace(place.position);
    let directions = gdibl_baker::sampling::fibonacci_sphere(64);
    let is_back = |direction: &&Vec3| level.meet(origin, **direction, f32::INFINITY).is_some_and(|met| met.back);
    directions.iter().filter(is_back).count() < 16
}

fn gather(function: &Paths, places: &[SurfacePlace], samples: u64) -> Vec<Gathered> {
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    let settings = GatherSettings { samples, seed: 99, ..GatherSettings::default() };
    irradiance_at(places, function, &settings, &control).expect("nobody interrupts a tool")
}

/// Root mean square over red, green and blue.
fn size(light: Vec3) -> f64 {
    (f64::from(light.length_squared()) / 3.0).sqrt()
}
