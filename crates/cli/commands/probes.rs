//! `gdibl probes`: what probes have seen of a level, and where further ones should stand.

use std::path::PathBuf;
use std::time::Instant;

use gdibl_baker::Control;
use gdibl_baker::analyse::{Coverage, CoveragePaint, CoverageView, Covered, Viewpoint, coverage};
use gdibl_baker::capture::{PlaceSettings, Placement};
use gdibl_baker::import::gltf::TextureNeeds;
use gdibl_baker::import::image::write_png;
use gdibl_baker::job::Inputs;
use gdibl_baker::radiance::path::Path as Paths;
use gdibl_baker::render::{RenderSettings, render, tone};
use glam::DVec3;
use serde::Serialize;

use super::render::{CameraFlags, camera_of, parse_size};
use crate::captures::{box_of_probes, place};
use crate::config::{Config, FileFlags, LightFlags, set_threads};
use crate::fault::Fault;
use crate::flags::{Given, OfReading, SettingFlags};
use crate::inputs::read_inputs;
use crate::session::{Outcome, Session};

#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(clap::Subcommand)]
enum Verb {
    /// Tell what share of a level's surfaces and of the distance the probes have seen, and how finely
    Coverage(CoverageArguments),
    /// Tell where further probes should stand, the most useful first
    Suggest(SuggestArguments),
}

/// What both look at.
#[derive(clap::Args)]
struct LevelFlags {
    /// LEVEL.glb, LEVEL.gltf or BAKE.toml
    input: PathBuf,
    #[command(flatten)]
    light: LightFlags,
    /// Box whose free space looks around, world metres: x0,y0,z0,x1,y1,z1 [default: the level's box]
    #[arg(long, value_name = "BOX", allow_hyphen_values = true)]
    bounds: Option<String>,
    #[command(flatten)]
    settings: SettingFlags<OfReading>,
}

#[derive(clap::Args)]
struct CoverageArguments {
    #[command(flatten)]
    level: LevelFlags,
    /// A picture to write, .png: surfaces from light (seen finely) to dark blue (coarsely), and magenta where no probe sees
    /// them
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    camera: CameraFlags,
    /// Pixels of the picture
    #[arg(long, value_name = "WxH", value_parser = parse_size, default_value = "640x360")]
    size: [usize; 2],
}

#[derive(clap::Args)]
struct SuggestArguments {
    #[command(flatten)]
    level: LevelFlags,
    /// Most places to suggest [default: 32]
    #[arg(long, value_name = "N")]
    most: Option<usize>,
    /// Suggest a place only if it adds at least this share of all that could be gained [default: 0.003]
    #[arg(long, value_name = "G", value_parser = parse_gain)]
    gain: Option<f64>,
}

/// What `coverage --json` prints.
#[derive(Serialize)]
struct CoverageReport {
    level: String,
    probes: usize,
    #[serde(flatten)]
    coverage: Coverage,
    output: Option<String>,
    wall_seconds: f64,
    cpu_seconds: f64,
}

/// What `suggest --json` prints.
#[derive(Serialize)]
struct SuggestReport {
    level: String,
    probes: usize,
    free_places: usize,
    /// Share of the surfaces that the free space sees, by solid angle, that the given probes see.
    coverage: f64,
    /// Surfaces that they do not see, sr of the sphere of a free place, in the mean.
    uncovered_solid_angle: f64,
    suggestions: Vec<SuggestionReport>,
    wall_seconds: f64,
    cpu_seconds: f64,
}

#[derive(Serialize)]
struct SuggestionReport {
    position: [f64; 3],
    /// Share of all that could be gained.
    gain: f64,
    /// As above, with this probe and those before it.
    coverage: f64,
    uncovered_solid_angle: f64,
    /// By this probe.
    drop_in_uncovered_solid_angle: f64,
}

pub fn run(arguments: Arguments, session: &Session) -> Result<Outcome, Fault> {
    match arguments.verb {
        Verb::Coverage(arguments) => run_coverage(&arguments, session),
        Verb::Suggest(arguments) => run_suggest(&arguments, session),
    }
}

/// A level that was read.
struct Level {
    config: Config,
    inputs: Inputs,
    bounds: (DVec3, DVec3),
}

impl Level {
    fn read(flags: &LevelFlags) -> Result<Level, Fault> {
        let mut given = flags.settings.given.clone();
        given.extend(flags.bounds.iter().map(|bounds| Given::new("grid", "bounds", bounds)));
        let config = Config::new(FileFlags::of(&flags.input, flags.light.clone()), &given)?;
        set_threads(&config.settings)?;
        let inputs = read_inputs(&config, TextureNeeds::All)?;
        let environment = box_of_probes(&inputs.scene).ok_or_else(|| {
            let level = config.level.display();
            Fault::Invalid(format!(
                "{level}: has no triangles of environment geometry, so nothing that a probe could see"
            ))
        })?;
        let bounds = config
            .settings
            .grid
            .bounds
            .map_or(environment, |[x0, y0, z0, x1, y1, z1]| (DVec3::new(x0, y0, z0), DVec3::new(x1, y1, z1)));
        Ok(Level { config, inputs, bounds })
    }

    fn nothing_free(&self) -> Fault {
        Fault::Bound(format!(
            "{}: nothing is free in the box {} to {}: every place tried stands in a solid or sees the backs of triangles; are \
             the level's triangles turned the right way? Give --bounds",
            self.config.level.display(),
            self.bounds.0,
            self.bounds.1
        ))
    }

    fn name(&self) -> String {
        self.config.level.display().to_string()
    }
}

fn run_coverage(arguments: &CoverageArguments, session: &Session) -> Result<Outcome, Fault> {
    let started = Instant::now();
    let level = Level::read(&arguments.level)?;
    if level.inputs.probes.is_empty() {
        let name = level.name();
        return Err(Fault::Usage(format!("{name}: no probe is given; give --probes, or ask gdibl probes suggest")));
    }
    let camera = camera_of(&arguments.camera, &level.inputs.scene)?;
    if let Some(output) = &arguments.output {
        if !output.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png")) {
            return Err(Fault::Usage(format!("{}: expected a picture ending in .png", output.display())));
        }
        super::check_output(output)?;
    }
    session.find(&level.inputs.findings);
    let paths = Paths::new(&level.inputs.scene, level.inputs.distant.as_ref(), level.config.settings.capture_path());
    let viewpoint = |probe: &gdibl_baker::radiance::gdibl::Probe| Viewpoint {
        position: probe.position,
        pixels: probe.panorama.width() * probe.panorama.height(),
    };
    let viewpoints: Vec<Viewpoint> = level.inputs.probes.iter().map(viewpoint).collect();
    let view = CoverageView::new(&paths, &viewpoints);
    let distant = level.inputs.distant.as_ref().map(|distant| distant.panorama.width() * distant.panorama.height());
    let found = coverage(&view, level.bounds, distant);
    if found.free_places == 0 {
        return Err(level.nothing_free());
    }
    if let Some(output) = &arguments.output {
        let [width, height] = arguments.size;
        let settings = RenderSettings { width, height, samples: 16, ..RenderSettings::default() };
        let paint = CoveragePaint::new(&view, found.surfaces_by_solid_angle.pixel_size);
        let control = Control { cancel: &session.cancel, progress: &|_, _| {}, blocks: None };
        let picture = render(&paint, None, &camera, &settings, &control).map_err(|_| Fault::Interrupted)?;
        write_png(output, width, height, &tone::display(&picture.image, 0.0)).map_err(Fault::from_writing)?;
    }
    let report = CoverageReport {
        level: level.name(),
        probes: viewpoints.len(),
        coverage: found,
        output: arguments.output.as_ref().map(|output| output.display().to_string()),
        wall_seconds: started.elapsed().as_secs_f64(),
        cpu_seconds: cpu_time::ProcessTime::now().as_duration().as_secs_f64(),
    };
    let text = coverage_text(&report);
    Ok(Outcome::new(report, text))
}

fn coverage_text(report: &CoverageReport) -> String {
    let Coverage { free_places, surfaces_by_solid_angle, surfaces_by_area, distant } = &report.coverage;
    let mut lines = vec![
        report.level.clone(),
        format!("  probes      {}, from {free_places} free places", report.probes),
        format!("  surfaces    {}", covered_text(surfaces_by_solid_angle, "sr of what a place sees", "m")),
        format!("  by area     {}", covered_text(surfaces_by_area, "m²", "m")),
    ];
    if distant.whole > 0.0 {
        lines.push(format!("  distance    {}", covered_text(distant, "sr of what a place sees", "°")));
    }
    if let (Some(output), Some(size)) = (&report.output, surfaces_by_solid_angle.pixel_size) {
        lines.push(format!(
            "  picture     {output}: light where a pixel covers {} m or less, dark blue from {} m on, magenta where none sees",
            figure(size.p5),
            figure(size.p95)
        ));
    }
    lines.push(format!("  work        {:.2} s ({:.2} s of CPU)", report.wall_seconds, report.cpu_seconds));
    lines.join("\n")
}

fn covered_text(covered: &Covered, unit: &str, pixel: &str) -> String {
    let share = format!("{:.2} % seen of {:.2} {unit}", covered.share * 100.0, covered.whole);
    match covered.pixel_size {
        Some(size) => format!(
            "{share}; a pixel covers {} {pixel} in the median, {} to {} from the 5th to the 95th percentile",
            figure(size.median),
            figure(size.p5),
            figure(size.p95)
        ),
        None => share,
    }
}

/// Three digits.
fn figure(value: f64) -> String {
    let decimals = 2 - value.log10().floor() as i32;
    match decimals {
        0..=5 => format!("{value:.*}", decimals as usize),
        _ => format!("{value:.2e}"),
    }
}

fn run_suggest(arguments: &SuggestArguments, session: &Session) -> Result<Outcome, Fault> {
    let started = Instant::now();
    let level = Level::read(&arguments.level)?;
    session.find(&level.inputs.findings);
    let defaults = PlaceSettings::default();
    let most = arguments.most.or(level.config.settings.capture.most).unwrap_or(defaults.most);
    let settings = PlaceSettings { most, gain: arguments.gain.unwrap_or(defaults.gain) };
    let paths = Paths::new(&level.inputs.scene, level.inputs.distant.as_ref(), level.config.settings.capture_path());
    let existing: Vec<DVec3> = level.inputs.probes.iter().map(|probe| probe.position).collect();
    let placement = place(&paths, level.bounds, &existing, &settings, &session.cancel, session.shown(false))?;
    if placement.places == 0 {
        return Err(level.nothing_free());
    }
    let report = SuggestReport {
        level: level.name(),
        probes: existing.len(),
        free_places: placement.places,
        coverage: placement.before.coverage,
        uncovered_solid_angle: placement.before.uncovered,
        suggestions: suggestions(&placement),
        wall_seconds: started.elapsed().as_secs_f64(),
        cpu_seconds: cpu_time::ProcessTime::now().as_duration().as_secs_f64(),
    };
    let text = suggestions_text(&report);
    Ok(Outcome::new(report, text))
}

fn suggestions(placement: &Placement) -> Vec<SuggestionReport> {
    let mut uncovered = placement.before.uncovered;
    let report = |suggestion: &gdibl_baker::capture::Suggestion| {
        let before = std::mem::replace(&mut uncovered, suggestion.after.uncovered);
        SuggestionReport {
            position: suggestion.position.into(),
            gain: suggestion.gain,
            coverage: suggestion.after.coverage,
            uncovered_solid_angle: suggestion.after.uncovered,
            drop_in_uncovered_solid_angle: before - suggestion.after.uncovered,
        }
    };
    placement.suggestions.iter().map(report).collect()
}

fn suggestions_text(report: &SuggestReport) -> String {
    let mut lines = vec![
        report.level.clone(),
        format!(
            "  {} probes see {:.1} % of the surfaces that {} free places see; {:.3} sr of a place's sphere are uncovered",
            report.probes,
            report.coverage * 100.0,
            report.free_places,
            report.uncovered_solid_angle
        ),
    ];
    match report.suggestions.is_empty() {
        true => lines.push("  no further probe gains enough".into()),
        false => lines.push("         x        y        z   surfaces seen   uncovered sr     drop sr".into()),
    }
    lines.extend(report.suggestions.iter().map(|suggestion| {
        let [x, y, z] = suggestion.position;
        format!(
            "  {x:8.3} {y:8.3} {z:8.3} {:13.2} % {:14.3} {:11.3}",
            suggestion.coverage * 100.0,
            suggestion.uncovered_solid_angle,
            suggestion.drop_in_uncovered_solid_angle
        )
    }));
    lines.push(format!("  {:.2} s ({:.2} s of CPU)", report.wall_seconds, report.cpu_seconds));
    lines.join("\n")
}

fn parse_gain(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|gain| (0.0..=1.0).contains(gain)).ok_or("expected a share from 0 to 1".into())
}
