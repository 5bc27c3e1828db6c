//! The error that people see: light between nodes, as the runtime reads it, against path tracing at the same places. A Markdown row
//! per level, way to bake, and kind of place; with what the bake itself says of it.
//!
//! ```text
//! seen_table INPUTS [--levels NAME,…] [--sun include] [--samples N] [--truth N] [--places N] [--as NAME SETTING=VALUE,…]…
//! ```
//! INPUTS is the folder of the levels. Each is baked without probes, its sun extracted unless told otherwise, with N directions per
//! node (default 4096), by default settings, over the box of all triangles in f16 by 32 nodes along its longest side (as it was by default once), and as asked: `--as fine
//! grid.spacing=0.2`. Places (default 500 in the air, and as many on surfaces) are in the box of the default bake and have a seed of
//! their own; truth has 65,536 directions each by default, and the square of its noise is subtracted. *Valid* is what engines show that weigh the valid nodes around and know no walls.
//! Errors are relative to the larger of E and a tenth of its median; RMSE is over root mean square of E.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use cpu_time::ProcessTime;
use gdibl_baker::Control;
use gdibl_baker::bake::{GatherSettings, Gathered, Nodes, SparseGrid, SurfacePlace, irradiance_at};
use gdibl_baker::job::records::{SeenErrors, SeenRecord};
use gdibl_baker::job::{Inputs, Job, Memory, Method, Settings, SunLight, Watch};
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::radiance::path::{Path as Paths, PathSettings};
use gdibl_baker::scene::Scene;
use gdibl_baker::seen::places;
use gdibl_runtime::{RadianceSh, Volume};
use gdibl_tools::made_levels::{aisle, terrain, two_storey};
use gdibl_tools::{read_distant, read_scene};
use glam::{DVec3, Vec3};

/// Where a level is from.
#[derive(Clone, Copy)]
enum Source {
    /// Below INPUTS.
    File(&'static str),
    Made(fn() -> Scene),
}

/// Name, and whether it needs a sky.
const LEVELS: [(&str, Source, bool); 8] = [
    ("living room", Source::File("levels/godot/living_room.glb"), true),
    ("apartment", Source::File("levels/dream-apartment-plain/dream-apartment.glb"), true),
    ("pandora", Source::File("levels/cube2/sauerbraten_pandora.glb"), false),
    ("room.glb", Source::File("levels/godot/room.glb"), true),
    ("box", Source::File("uffizi-box/uffizi_box.glb"), true),
    ("terrain", Source::Made(terrain), true),
    ("two storeys", Source::Made(two_storey), true),
    ("aisle", Source::Made(aisle), true),
];
const SKY: &str = "hdr/kloppenheim_05_1k.hdr";
/// Next to no light, as a share of the median: two surfaces touch there.
const HIDDEN: f64 = 1e-3;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let (mut inputs, mut levels, mut sun, mut asked) = (None, String::new(), SunLight::Extract, Vec::new());
    let (mut samples, mut truth, mut places) = (4096, 65_536, 500);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().unwrap_or_else(|| panic!("{argument} wants a value"));
        match argument.as_str() {
            "--levels" => levels = value(),
            "--sun" => sun = if value() == "include" { SunLight::Include } else { SunLight::Extract },
            "--samples" => samples = value().parse().expect("a number"),
            "--truth" => truth = value().parse().expect("a number"),
            "--places" => places = value().parse().expect("a number"),
            "--as" => asked.push((value(), value())),
            _ => inputs = Some(argument),
        }
    }
    let inputs = inputs.expect("seen_table INPUTS [--levels NAME,…] [--as NAME SETTING=VALUE,…]…");
    println!(
        "| level | bake | nodes | bytes | CPU s | places | median | p95 | p99 | RMSE | said: median, p95, p99 | valid: p95, RMSE |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    for (name, source, needs_sky) in LEVELS {
        if !levels.is_empty() && !levels.split(',').any(|part| name.starts_with(part)) {
            continue;
        }
        let scene = match source {
            Source::File(file) => read_scene(&Path::new(&inputs).join(file)),
            Source::Made(make) => make(),
        };
        let (min, max) = scene.bounds(|_| true).expect("a level with triangles");
        let distant = needs_sky.then(|| read_distant(&Path::new(&inputs).join(SKY)));
        let level = Inputs { distant, ..Inputs::new(scene) };
        let mut sets = None;
        let all = [min.to_array(), max.to_array()].concat().iter().map(f64::to_string).collect::<Vec<_>>().join(";");
        let spacing = (max - min).max_element() / 31.0;
        let former = format!("quality.precision=f16,quality.seen_places=0,grid.bounds={all},grid.spacing={spacing}");
        let ways = [("default", ""), ("all triangles, f16", &former[..])].into_iter();
        for (way, texts) in ways.chain(asked.iter().map(|(way, texts)| (&way[..], &texts[..]))) {
            let mut settings = Settings::default();
            (settings.quality.method, settings.quality.samples) = (Method::Path, Some(samples));
            settings.quality.sun = if level.distant.is_some() { sun } else { SunLight::Include };
            for text in texts.split(',').filter(|text| !text.is_empty()) {
                let parts: Vec<&str> = text.splitn(2, '=').collect();
                let (section, name) = parts[0].split_once('.').expect("SECTION.NAME=VALUE");
                settings
                    .set(section, name, &[&parts[1].replace(';', ",")])
                    .unwrap_or_else(|why| panic!("{text}: {why}"));
            }
            let bake = Bake::of(level.clone(), settings);
            let sets = sets.get_or_insert_with(|| Set::both(&bake, places, truth));
            for set in sets.iter() {
                println!("| {name} | {way} | {}", bake.row(set));
            }
        }
    }
}

/// A baked level.
struct Bake {
    scene: Scene,
    distant: Option<gdibl_baker::radiance::Distant>,
    bounds: [DVec3; 2],
    volume: Volume,
    bytes: usize,
    seconds: f64,
    seen: Option<SeenRecord>,
}

impl Bake {
    fn of(inputs: Inputs, settings: Settings) -> Bake {
        let start = ProcessTime::now();
        let job = Job::prepare(inputs, settings, Memory::UNBOUNDED).unwrap_or_else(|stop| panic!("{stop}"));
        let (scene, distant) = (job.inputs.scene.clone(), job.inputs.distant.clone());
        let made = job.run(&Watch::silent(&AtomicBool::new(false))).unwrap_or_else(|stop| panic!("{stop}"));
        let (Nodes::Grid(grid) | Nodes::Sparse(SparseGrid { grid, .. })) = &made.nodes else { panic!("a grid") };
        let bounds = [grid.min, grid.max].map(DVec3::from);
        let seen = made.records.statistics.as_ref().and_then(|statistics| statistics.seen);
        let bytes = made.sections().assemble().bytes;
        let seconds = start.elapsed().as_secs_f64();
        let volume = Volume::parse(&bytes).expect("what was packed parses");
        Bake { scene, distant, bounds, volume, bytes: bytes.len(), seconds, seen }
    }

    fn row(&self, set: &Set) -> String {
        let percent = |share: f64| format!("{:.1} %", 100.0 * share);
        let at =
            |place: &SurfacePlace| Vec3::from(self.volume.irradiance_f64(place.position.into(), place.normal.into()));
        let (found, rmse) = set.errors(at);
        let (valid, valid_rmse) = set.errors(|place| self.by_valid_nodes(place));
        let said =
            self.seen.and_then(|seen| if set.in_the_air { seen.air } else { seen.surfaces }).map(|set| set.error);
        let said = said.map_or("-".into(), |e| [e.median, e.p95, e.p99].map(percent).join(", "));
        let kind = if set.in_the_air { "air" } else { "surfaces" };
        [
            self.volume.node_count().to_string(),
            self.bytes.to_string(),
            format!("{:.1}", self.seconds),
            format!("{} {kind}", set.places.len()),
            percent(found.median),
            percent(found.p95),
            percent(found.p99),
            percent(rmse),
            said,
            format!("{}, {} |", percent(valid.p95), percent(valid_rmse)),
        ]
        .join(" | ")
    }

    fn by_valid_nodes(&self, place: &SurfacePlace) -> Vec3 {
        let cell = self.volume.cell(place.position.into()).expect("a grid");
        let mut sum = RadianceSh::zero(self.volume.header().bands);
        let pairs = || cell.nodes.iter().map(|node| *node as usize).zip(cell.weights);
        let total: f32 = pairs().filter(|(node, _)| self.volume.is_valid(*node)).map(|(_, weight)| weight).sum();
        for (node, weight) in pairs().filter(|(node, _)| total == 0.0 || self.volume.is_valid(*node)) {
            sum.add_scaled(&self.volume.node_sh(node), if total == 0.0 { weight } else { weight / total });
        }
        Vec3::from(sum.convolve().evaluate(place.normal.into()))
    }
}

/// Places with the true light there.
struct Set {
    in_the_air: bool,
    places: Vec<SurfacePlace>,
    truth: Vec<Gathered>,
}

impl Set {
    /// In the air, and on surfaces.
    fn both(bake: &Bake, count: usize, samples: u64) -> [Set; 2] {
        let function = Paths::new(&bake.scene, bake.distant.as_ref(), PathSettings::default());
        [true, false].map(|in_the_air| {
            let tries = 8 * count as u32;
            let places = match in_the_air {
                true => places::in_the_air(bake.bounds, tries, 99),
                false => places::on_surfaces(&bake.scene, bake.bounds, function.frame().metres(5e-3).into(), tries, 99),
            };
            // Those in solids see backs and dark; a few directions tell.
            let pilot = gather(&function, &places, 256);
            let open = Self::open(&function, &places);
            let sizes: Vec<f64> = pilot.iter().map(|found| size(found.irradiance.as_vec3())).collect();
            let lit = (0..places.len()).filter(|place| open[*place]);
            let hidden =
                HIDDEN * SeenErrors::of(lit.clone().map(|place| sizes[place])).expect("some place is lit").median;
            let places: Vec<SurfacePlace> =
                lit.filter(|place| sizes[*place] > hidden).map(|place| places[place]).take(count).collect();
            let truth = gather(&function, &places, samples);
            Set { in_the_air, places, truth }
        })
    }

    /// Few backs of triangles are seen from there.
    fn open(function: &Paths, places: &[SurfacePlace]) -> Vec<bool> {
        let directions = gdibl_baker::sampling::fibonacci_sphere(64);
        let level = function.level();
        let is_open = |place: &SurfacePlace| {
            let origin = function.frame().to_trace(place.position);
            let backs = directions.iter().filter(|direction| {
                let met = level.meet(origin, **direction, f32::INFINITY);
                met.is_some_and(|met| met.back && met.single_sided)
            });
            backs.count() < 16
        };
        places.iter().map(is_open).collect()
    }

    /// Of light that is found at each place; and the relative RMSE.
    fn errors(&self, light: impl Fn(&SurfacePlace) -> Vec3) -> (SeenErrors, f64) {
        let sizes: Vec<f64> = self.truth.iter().map(|found| size(found.irradiance.as_vec3())).collect();
        let floor = 0.1 * SeenErrors::of(sizes.iter().copied()).expect("some place").median;
        let (mut errors, mut square, mut all) = (Vec::new(), 0.0, 0.0);
        for ((place, truth), own) in self.places.iter().zip(&self.truth).zip(&sizes) {
            let noise = size(truth.standard_error.as_vec3());
            let difference = size(light(place) - truth.irradiance.as_vec3());
            let beyond = (difference * difference - noise * noise).max(0.0);
            errors.push(beyond.sqrt() / own.max(floor));
            square += difference * difference - noise * noise;
            all += own * own;
        }
        (SeenErrors::of(errors.into_iter()).expect("some place"), (square.max(0.0) / all).sqrt())
    }
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
