//! `gdibl capture`: light probes from the level itself.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use gdibl_baker::import::gltf::TextureNeeds;
use gdibl_baker::job::Inputs;
use gdibl_baker::panorama::Mapping;
use gdibl_baker::radiance::path::{Path as Paths, light_without_end};
use glam::DVec3;
use serde::Serialize;

use crate::captures::{CapturedProbe, Place, capture_all, places};
use crate::config::{Config, FileFlags, LightFlags, SkyFlags, set_threads};
use crate::fault::Fault;
use crate::flags::{OfCaptures, SettingFlags};
use crate::inputs::read_level_and_sky;
use crate::progress::Shown;
use crate::session::{Outcome, Session, say};

#[derive(clap::Args)]
pub struct Arguments {
    /// LEVEL.glb, LEVEL.gltf or BAKE.toml
    input: PathBuf,
    /// Folder for the probes [default: beside the input, ending in .probes; probes that the level marks
    /// (extras.gdibl_probe) go where it names them]
    #[arg(short, long, value_name = "FOLDER")]
    output: Option<PathBuf>,
    /// Panorama at infinity: the sky, the street outside; or R,G,B, the same radiance from everywhere
    #[arg(long, value_name = "IMAGE")]
    distant: Option<PathBuf>,
    #[command(flatten)]
    sky: SkyFlags,
    #[command(flatten)]
    settings: SettingFlags<OfCaptures>,
    /// Layout of the images: lat-long, angular, cube-exr, cube-strip, cube-cross-horizontal, cube-cross-vertical …
    #[arg(long, value_name = "NAME", default_value = "lat-long", value_parser = parse_mapping)]
    mapping: Mapping,
    /// No progress bar
    #[arg(long)]
    quiet: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Report {
    probes: Vec<ProbeReport>,
    wall_seconds: f64,
    cpu_seconds: f64,
}

#[derive(Serialize)]
struct ProbeReport {
    file: String,
    position: [f64; 3],
    size: [usize; 2],
    /// Root mean square over pixels.
    relative_error: Option<f64>,
    samples: u64,
    rays: u64,
    /// Share of light that --clamp took.
    clamped: f64,
    seconds: f64,
}

fn parse_mapping(text: &str) -> Result<Mapping, String> {
    Mapping::parse(text).ok_or_else(|| format!("expected one of {}", Mapping::ALL.map(Mapping::name).join(", ")))
}

pub fn run(arguments: Arguments, session: &Session) -> Result<Outcome, Fault> {
    let started = Instant::now();
    let light = LightFlags { probes: Vec::new(), distant: arguments.distant, sky: arguments.sky, cache: None };
    let config = Config::new(FileFlags::of(&arguments.input, light), &arguments.settings.given)?;
    set_threads(&config.settings)?;
    let settings = config.settings.capture_probes();

    let inputs = read_level_and_sky(&config, TextureNeeds::All)?;
    session.find(&inputs.findings);
    if !inputs.has_light() {
        return Err(Fault::Bound(format!(
            "{}: nothing gives light: no emissive material, no light, no distant panorama; give --distant",
            config.level.display()
        )));
    }
    let paths = Paths::new(&inputs.scene, inputs.distant.as_ref(), config.settings.capture_path());
    let folder = arguments.output.clone();
    let places = choose_places(
        &inputs,
        &paths,
        &config,
        folder.as_deref(),
        &arguments.input,
        (&session.cancel, session.shown(arguments.quiet)),
    )?;
    for folder in places.iter().filter_map(|place| place.file.parent()) {
        std::fs::create_dir_all(folder).map_err(|error| Fault::writing(folder, &error))?;
    }
    let outcomes =
        capture_all(&paths, &places, arguments.mapping, &settings, &session.cancel, session.shown(arguments.quiet))?;

    session.find(light_without_end(&inputs.scene, &paths).as_slice());
    outcomes.iter().for_each(|outcome| session.find(&outcome.findings));
    let report = Report {
        probes: outcomes.iter().map(|outcome| probe_report(outcome, settings.width)).collect(),
        wall_seconds: started.elapsed().as_secs_f64(),
        cpu_seconds: cpu_time::ProcessTime::now().as_duration().as_secs_f64(),
    };
    let missed: u64 = outcomes.iter().map(|outcome| outcome.captured.missed).sum();
    let missed = settings.target_error.filter(|_| missed > 0).map(|target| {
        let (target, samples) = ((target * 100.0) as f32, settings.samples);
        format!("{missed} pixels missed the target error of {target} % within {samples} paths; the probes were written")
    });
    let text = text(&report);
    Ok(Outcome::new(report, text).missing(missed))
}

/// By --position, by --auto, or where the level marks them.
fn choose_places(
    inputs: &Inputs,
    paths: &Paths,
    config: &Config,
    folder: Option<&Path>,
    input: &Path,
    (cancel, shown): (&AtomicBool, Shown),
) -> Result<Vec<Place>, Fault> {
    let default_folder = input.with_extension("probes");
    let asked = &config.settings.capture;
    if !asked.positions.is_empty() || asked.auto {
        let places = places(&inputs.scene, paths, asked, folder.unwrap_or(&default_folder), cancel, shown)?;
        if places.is_empty() {
            return Err(Fault::Bound(format!(
                "{}: --auto found no place for a probe: every place tried stands in a solid or sees nothing; give \
                 --position",
                config.level.display()
            )));
        }
        return Ok(places);
    }
    if inputs.scene.probe_markers.is_empty() {
        return Err(Fault::Usage(format!(
            "{}: where? Give --position X,Y,Z (repeatable) or --auto, or mark nodes of the level with extras.gdibl_probe \
             = \"FILE.exr\"",
            input.display()
        )));
    }
    if inputs.scene.probe_markers.iter().any(|marker| marker.rotation.angle_between(glam::DQuat::IDENTITY) > 1e-3) {
        say(
            "marked probes that are turned are captured in the world's axes: bake them with --probes, or turn their nodes back",
        );
    }
    Ok(inputs
        .scene
        .probe_markers
        .iter()
        .map(|marker| place_of_marker(marker.position, &marker.image, folder))
        .collect())
}

fn place_of_marker(position: DVec3, image: &Path, folder: Option<&Path>) -> Place {
    let file = match (folder, image.file_name()) {
        (Some(folder), Some(name)) => folder.join(name),
        _ => image.to_path_buf(),
    };
    Place { position, file }
}

fn probe_report(outcome: &CapturedProbe, width: usize) -> ProbeReport {
    let captured = &outcome.captured;
    ProbeReport {
        file: outcome.place.file.display().to_string(),
        position: outcome.place.position.into(),
        size: [width, width / 2],
        relative_error: Some(captured.relative_error).filter(|e| e.is_finite()),
        samples: captured.samples,
        rays: captured.rays,
        clamped: captured.clamped,
        seconds: outcome.seconds,
    }
}

fn text(report: &Report) -> String {
    let line = |probe: &ProbeReport| {
        let [x, y, z] = probe.position;
        let error = probe.relative_error.map_or("unknown".into(), |e| format!("{:.1} %", e * 100.0));
        let clamped = if probe.clamped > 0.0 {
            format!(", {:.2} % of the light clamped away", probe.clamped * 100.0)
        } else {
            String::new()
        };
        format!(
            "{}  at {x:.3} {y:.3} {z:.3}, {} x {}, standard error of a pixel {error}{clamped}, {:.1} M rays in {:.1} s",
            probe.file,
            probe.size[0],
            probe.size[1],
            probe.rays as f64 / 1e6,
            probe.seconds
        )
    };
    report.probes.iter().map(line).collect::<Vec<_>>().join("\n")
}
