//! `gdibl render`: a picture of a level in its probes' light, by path tracing, or of what a volume shows and says.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Instant;

use gdibl_baker::analyse::{Figure, Figures};
use gdibl_baker::import::gltf::TextureNeeds;
use gdibl_baker::import::image::{MAX_PIXELS, Pose, SampleFormat, write_exr, write_exr_picture, write_png};
use gdibl_baker::job::records::{SeenPlace, StatisticsRecord};
use gdibl_baker::job::{Decided, Method, Viewers, Work, with_function};
use gdibl_baker::panorama::{Image, Mapping};
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::render::{self, Camera, Picture, RenderSettings, Scale, Sphere, SphereLook, VolumeLight, slice, tone};
use gdibl_baker::scene::{Role, Scene};
use gdibl_baker::{Control, Finding};
use gdibl_runtime::{Volume, format};
use glam::DVec3;
use serde::Serialize;

use crate::captures::capture_missing;
use crate::config::{Config, FileFlags, LightFlags, set_threads};
use crate::fault::Fault;
use crate::flags::{Given, OfPictures, SettingFlags};
use crate::inputs::read_inputs;
use crate::progress::{Progress, Shown};
use crate::session::{Outcome, Session};

#[derive(clap::Args)]
pub struct Arguments {
    /// LEVEL.glb, LEVEL.gltf or BAKE.toml
    input: PathBuf,
    /// The picture to write: .png (tone-mapped, sRGB) or .exr (linear radiance) [default: beside the input, ending in
    /// .png]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    camera: CameraFlags,
    /// Pixels [default: 640x360; a panorama 512x256]
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    size: Option<[usize; 2]>,
    /// Camera rays per pixel [default: 64]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    samples: Option<u32>,
    /// Scene geometry, and mirrors, that light may come by way of; what is left then is black [default: 3]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=64))]
    depth: Option<u32>,
    #[command(flatten)]
    shown: ShownFlags,
    #[command(flatten)]
    light: LightFlags,
    #[command(flatten)]
    settings: SettingFlags<OfPictures>,
    /// Stops by which a PNG is brightened (negative: darkened) [default: so that the log-mean is middle grey]
    #[arg(long, value_name = "STOPS", value_parser = parse_stops, allow_hyphen_values = true)]
    exposure: Option<f32>,
    /// No progress bar
    #[arg(long)]
    quiet: bool,
}

/// What is shown of a volume.
#[derive(clap::Args)]
pub struct ShownFlags {
    /// Light every surface from this volume, as an engine shows it
    #[arg(long, value_name = "FILE.gdibl")]
    volume: Option<PathBuf>,
    /// Light scene geometry (gdibl_role = "scene") alone from the volume, all else by rays
    #[arg(long, requires = "volume", conflicts_with_all = ["nodes", "show", "slice"])]
    objects_only: bool,
    /// Draw the volume's nodes as white spheres in their own light, or in the colours of what is shown
    #[arg(long, requires = "volume")]
    nodes: bool,
    /// Show in place of light what nodes say of themselves: noise, systematic, coverage; or seen: the error at the worst places
    /// between nodes. A PNG has colours, an EXR the numbers
    #[arg(long, value_name = "WHAT", requires = "volume")]
    show: Option<Show>,
    /// A plane across the volume instead of a camera's picture: x=1.5, y=1.6, z=-2, metres
    #[arg(long, value_name = "AXIS=AT", requires = "volume", value_parser = parse_slice,
          conflicts_with_all = ["nodes", "eye", "target", "fov", "panorama"])]
    slice: Option<(usize, f64)>,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Show {
    Noise,
    Systematic,
    Seen,
    Coverage,
}

#[derive(clap::Args)]
pub struct CameraFlags {
    /// Where the camera stands, world metres [default: just inside a corner of the level's box]
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_place, allow_hyphen_values = true)]
    eye: Option<[f64; 3]>,
    /// What it looks at, world metres [default: the middle of the level's box]
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_place, allow_hyphen_values = true)]
    target: Option<[f64; 3]>,
    /// Vertical field of view, degrees [default: 60]
    #[arg(long, value_name = "DEGREES", value_parser = parse_fov)]
    fov: Option<f64>,
    /// A lat-long panorama from this place instead, in the world's axes; as EXR it is a probe with its pose
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_place, allow_hyphen_values = true,
          conflicts_with_all = ["eye", "target", "fov"])]
    panorama: Option<[f64; 3]>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Report {
    output: String,
    size: [usize; 2],
    camera: CameraReport,
    method: &'static str,
    samples: u32,
    /// Of a PNG.
    exposure_stops: Option<f32>,
    /// Of a PNG of numbers: those shown darkest and brightest.
    scale: Option<[f32; 2]>,
    /// Share of the light that nothing tells of; it is black.
    uncovered: f64,
    rays: u64,
    wall_seconds: f64,
    cpu_seconds: f64,
    seed: u64,
}

#[derive(Serialize)]
#[serde(untagged)]
enum CameraReport {
    Pinhole { eye: [f64; 3], target: [f64; 3], fov: f64 },
    Panorama { panorama: [f64; 3] },
}

/// File types, told by the output's extension.
#[derive(Clone, Copy, PartialEq, Eq)]
enum FileType {
    Png,
    Exr,
}

pub fn run(arguments: Arguments, session: &Session) -> Result<Outcome, Fault> {
    let started = Instant::now();
    let output = arguments.output.clone().unwrap_or_else(|| arguments.input.with_extension("png"));
    let file_type = file_type(&output)?;
    if file_type == FileType::Exr && arguments.exposure.is_some() {
        return Err(Fault::Usage("--exposure: an EXR holds radiance as it is; write a .png, or leave it out".into()));
    }
    let config = config_of(&arguments, &output)?;
    set_threads(&config.settings)?;

    // Everything is read and refused before the first ray.
    let shown = &arguments.shown;
    let volume = shown.volume.as_deref().map(read_volume).transpose()?;
    let light = volume.as_ref().map(|volume| light_of(volume, shown, file_type)).transpose()?;
    let scale = light.as_ref().and_then(|light| light.scale);
    let light = light.map(|light| light.light);
    if let (Some((axis, at)), Some(light)) = (shown.slice, &light) {
        return write_slice(light, scale, [axis as f64, at], &arguments, &output);
    }
    // A picture shows the level's own surfaces from near.
    let mut inputs = read_inputs(&config, TextureNeeds::All)?;
    let method = inputs.method(&config.settings);
    let camera = camera_of(&arguments.camera, &inputs.scene)?;
    let settings = settings_of(&arguments, &config, &camera);
    if let Some(volume) = &volume {
        inputs.findings.extend(findings_of_volume(&volume.volume, shown.objects_only, &inputs.scene));
    }
    session.find(&inputs.findings);
    if !shown.lights_all() {
        inputs.check_light(method)?;
    }
    super::check_output(&output)?;
    if method == Method::Gdibl && inputs.lacks_probes() {
        capture_missing(&config, &mut inputs, &session.cancel, session.shown(arguments.quiet))?;
    }

    let shot = Shot {
        volume: light.as_ref(),
        camera: &camera,
        settings: &settings,
        session,
        shown: session.shown(arguments.quiet),
    };
    // A picture shows every pixel of a probe as it is; what probes do not see is found from where it is taken.
    let place = camera.position();
    let viewers = Viewers { directions: 0, coarsest: f32::INFINITY, places: vec![place] };
    let picture = with_function(&inputs, inputs.distant.as_ref(), &config.settings, &viewers, None, shot)?;
    let exposure_stops = match file_type {
        FileType::Png if scale.is_some() => None,
        FileType::Png => Some(arguments.exposure.unwrap_or_else(|| tone::automatic_exposure_stops(&picture.image))),
        FileType::Exr => None,
    };
    if session.cancel.load(Ordering::Relaxed) {
        return Err(Fault::Interrupted);
    }
    match scale {
        Some(_) => write_plain(&output, &picture.image)?,
        None => write(&output, &picture.image, &camera, exposure_stops)?,
    }

    let report = Report {
        output: output.display().to_string(),
        size: [settings.width, settings.height],
        camera: CameraReport::of(&camera),
        method: match method {
            _ if shown.lights_all() => "volume",
            Method::Path => "path",
            _ => "gdibl",
        },
        scale: scale.map(|scale| [scale.good, scale.bad]),
        samples: settings.samples,
        exposure_stops,
        uncovered: picture.uncovered,
        rays: picture.rays,
        wall_seconds: started.elapsed().as_secs_f64(),
        cpu_seconds: cpu_time::ProcessTime::now().as_duration().as_secs_f64(),
        seed: settings.seed,
    };
    let text = text(&report, arguments.exposure.is_none());
    Ok(Outcome::new(report, text))
}

/// The command line and BAKE.toml together. A picture's samples and depth are its own.
fn config_of(arguments: &Arguments, output: &Path) -> Result<Config, Fault> {
    let mut given = arguments.settings.given.clone();
    if arguments.shown.lights_all() {
        // No light but the volume's is asked for: what probes show would only be read.
        given.push(Given::new("quality", "method", "path"));
    }
    given.extend(arguments.depth.map(|depth| Given::new("quality", "scene", format!("recurse:{depth}"))));
    let stem = arguments.input.file_stem().unwrap_or_default();
    let beside = output.with_file_name(stem).with_extension("gdibl");
    let files = FileFlags { output: Some(beside), ..FileFlags::of(&arguments.input, arguments.light.clone()) };
    Config::new(files, &given)
}

fn settings_of(arguments: &Arguments, config: &Config, camera: &Camera) -> RenderSettings {
    let defaults = RenderSettings::default();
    let default_size = match camera {
        Camera::Pinhole { .. } => [defaults.width, defaults.height],
        Camera::Panorama { .. } => [512, 256],
    };
    let [width, height] = arguments.size.unwrap_or(default_size);
    RenderSettings {
        width,
        height,
        samples: arguments.samples.unwrap_or(defaults.samples),
        depth: arguments.depth.unwrap_or(defaults.depth),
        seed: config.settings.quality.seed,
        sampler: config.settings.quality.sampler,
    }
}

pub fn camera_of(flags: &CameraFlags, scene: &Scene) -> Result<Camera, Fault> {
    if let Some(position) = flags.panorama {
        return Ok(Camera::Panorama { position: position.into() });
    }
    let (min, max) = scene.bounds(|_| true).unwrap_or_default();
    let mut camera = Camera::inside(min, max, flags.fov.unwrap_or(60.0));
    if let Camera::Pinhole { eye, target, .. } = &mut camera {
        *eye = flags.eye.map_or(*eye, DVec3::from);
        *target = flags.target.map_or(*target, DVec3::from);
        if (*target - *eye).try_normalize().is_none() {
            return Err(Fault::Usage(format!("the camera at {eye} looks at itself; give --eye and --target apart")));
        }
    }
    Ok(camera)
}

/// A picture to be taken.
struct Shot<'a> {
    volume: Option<&'a VolumeLight<'a>>,
    camera: &'a Camera,
    settings: &'a RenderSettings,
    session: &'a Session,
    shown: Shown,
}

impl Work for Shot<'_> {
    type Output = Result<Picture, Fault>;

    fn run(self, function: &impl RadianceFunction, _: Decided) -> Result<Picture, Fault> {
        let progress = Progress::new("pixels", (self.settings.width * self.settings.height) as u64, self.shown);
        let advance = |pixels, rays| progress.advance(pixels, rays);
        let control = Control { cancel: &self.session.cancel, progress: &advance, blocks: None };
        let picture = render::render(function, self.volume, self.camera, self.settings, &control);
        let picture = picture.map_err(|_| Fault::Interrupted)?;
        progress.finish();
        if picture.uncovered >= 1.0 {
            return Err(Fault::Bound(
                "the camera sees nothing that a probe or the distant panorama has seen, so nothing was written; does it \
                 stand in a wall, or outside of the level? Are the probes' positions in the level's metres?"
                    .into(),
            ));
        }
        Ok(picture)
    }
}

/// A volume, and what it says of its nodes.
struct ReadVolume {
    volume: Volume,
    figures: Figures,
    seen: Vec<SeenPlace>,
}

fn read_volume(path: &Path) -> Result<ReadVolume, Fault> {
    let bytes = super::read_volume_bytes(path)?;
    let fault = |error: gdibl_runtime::Error| super::volume_fault(path, &error);
    let directory = format::parse_header_and_sections(&bytes).map_err(fault)?;
    let volume = Volume::parse(&bytes).map_err(fault)?;
    let mut figures = Figures::read(&directory, &volume).map_err(fault)?;
    figures.forget_filled(&volume);
    let statistics: Option<StatisticsRecord> = super::record(&directory, path, format::STATISTICS)?;
    Ok(ReadVolume { figures, seen: statistics.map(|all| all.seen_places).unwrap_or_default(), volume })
}

/// What a picture takes from a volume, and the scale of its colours.
struct Light<'a> {
    light: VolumeLight<'a>,
    scale: Option<Scale>,
}

impl ShownFlags {
    /// Surfaces show the volume, and nothing else.
    fn lights_all(&self) -> bool {
        self.volume.is_some() && !self.objects_only
    }
}

/// Spheres of nodes are so large, of the distance to the next node.
const NODE_RADIUS: f64 = 0.08;
/// And those of places between nodes.
const PLACE_RADIUS: f64 = 0.2;

fn light_of<'a>(read: &'a ReadVolume, shown: &ShownFlags, file_type: FileType) -> Result<Light<'a>, Fault> {
    let ReadVolume { volume, figures, seen } = read;
    let mut light = VolumeLight { objects_only: shown.objects_only, ..VolumeLight::of(volume) };
    let spacing =
        volume.grid().map(|grid| grid.spacing().into_iter().filter(|s| *s > 0.0).fold(f64::INFINITY, f64::min));
    let spacing = spacing.filter(|spacing| spacing.is_finite()).unwrap_or(1.0);
    let missing = |what: &str| Fault::Usage(format!("--show {what}: the volume says nothing of it"));
    let mut scale = None;
    match shown.show {
        None => {}
        Some(Show::Seen) => {
            let errors: Vec<f32> = seen.iter().map(|place| place.error() as f32).collect();
            let own = Scale::of_errors(&errors);
            scale = (file_type == FileType::Png).then_some(own);
            let header = volume.header();
            light.spheres.extend(seen.iter().zip(&errors).map(|(place, error)| Sphere {
                centre: place.position(header.min, header.max).into(),
                radius: PLACE_RADIUS * spacing,
                look: SphereLook::Plain(scale.map_or([*error; 3], |scale| scale.colour(*error))),
            }));
            if seen.is_empty() {
                return Err(missing("seen"));
            }
        }
        Some(show) => {
            let (name, figure) = match show {
                Show::Noise => ("noise", Figure::Noise),
                Show::Systematic => ("systematic", Figure::Systematic),
                _ => ("coverage", Figure::Coverage),
            };
            let values = figures.of(figure).ok_or_else(|| missing(name))?;
            let own = if figure == Figure::Coverage { Scale { good: 1.0, bad: 0.0 } } else { Scale::of_errors(values) };
            scale = (file_type == FileType::Png).then_some(own);
            light.figures = Some(render::Figures { values, scale });
        }
    }
    if shown.nodes {
        let look = |node: usize| match &light.figures {
            None => SphereLook::Light(node),
            Some(figures) => SphereLook::Plain(figures.shown(figures.values[node]).to_array()),
        };
        let size = |node: usize| figures.of(Figure::CellSize).map_or(1.0, |sizes| f64::from(sizes[node]));
        let sphere = |node: usize| Sphere {
            centre: volume.node_position(node).into(),
            radius: NODE_RADIUS * spacing * size(node),
            look: look(node),
        };
        light.spheres.extend((0..volume.node_count()).map(sphere));
    }
    Ok(Light { light, scale })
}

/// A plane across the volume: no ray is traced.
fn write_slice(
    light: &VolumeLight,
    scale: Option<Scale>,
    [axis, at]: [f64; 2],
    arguments: &Arguments,
    output: &Path,
) -> Result<Outcome, Fault> {
    super::check_output(output)?;
    let longest = arguments.size.map_or(LONGEST_SLICE, |[width, height]| width.max(height));
    let image = slice(light, axis as usize, at, longest);
    let is_png = file_type(output)? == FileType::Png;
    let exposure_stops = (is_png && scale.is_none())
        .then(|| arguments.exposure.unwrap_or_else(|| tone::automatic_exposure_stops(&image)));
    match scale {
        Some(_) => write_plain(output, &image)?,
        None => write(output, &image, &Camera::inside(DVec3::ZERO, DVec3::ONE, 60.0), exposure_stops)?,
    }
    let report = SliceReport {
        output: output.display().to_string(),
        size: [image.width, image.height],
        slice: format!("{}={at}", ["x", "y", "z"][axis as usize]),
        exposure_stops,
        scale: scale.map(|scale| [scale.good, scale.bad]),
    };
    let mut text = format!("{}\n  slice      {}, {} x {}", report.output, report.slice, image.width, image.height);
    text += &report.scale.map_or(String::new(), scale_text);
    Ok(Outcome::new(report, text))
}

/// Pixels along the longer side of a slice when nothing is said.
const LONGEST_SLICE: usize = 512;

/// What `--json` prints of a slice.
#[derive(Serialize)]
struct SliceReport {
    output: String,
    size: [usize; 2],
    slice: String,
    exposure_stops: Option<f32>,
    scale: Option<[f32; 2]>,
}

fn scale_text([good, bad]: [f32; 2]) -> String {
    format!("\n  colours    from dark, {:.3} %, to bright, {:.3} %", good * 100.0, bad * 100.0)
}

/// Says where the volume has nothing to do, or not everything.
fn findings_of_volume(volume: &Volume, objects_only: bool, scene: &Scene) -> Option<Finding> {
    let finding = |message: String| Some(Finding::new("volume-of-picture", 1, message));
    let what = if objects_only { "scene geometry reaches" } else { "surfaces reach" };
    let Some((min, max)) = scene.bounds(|mesh| !objects_only || mesh.role == Role::Scene) else {
        let why = "--objects-only lights scene geometry (gdibl_role = \"scene\"), and the level has none";
        return objects_only.then(|| finding(why.into())).flatten();
    };
    let header = volume.header();
    let inside = DVec3::from(header.min).cmple(min).all() && DVec3::from(header.max).cmpge(max).all();
    if inside {
        return None;
    }
    finding(format!("{what} out of the volume's box; there the nearest light of the box is shown"))
}

fn file_type(output: &Path) -> Result<FileType, Fault> {
    match output.extension().unwrap_or_default().to_ascii_lowercase().to_str() {
        Some("png") => Ok(FileType::Png),
        Some("exr") => Ok(FileType::Exr),
        _ => Err(Fault::Usage(format!("{}: expected a picture ending in .png or .exr", output.display()))),
    }
}

/// A PNG where there is an exposure for it, else an EXR.
fn write(output: &Path, image: &Image, camera: &Camera, exposure_stops: Option<f32>) -> Result<(), Fault> {
    let written = match (exposure_stops, camera) {
        (Some(stops), _) => write_png(output, image.width, image.height, &tone::display(image, stops)),
        (None, Camera::Pinhole { .. }) => write_exr_picture(output, image),
        (None, Camera::Panorama { position }) => {
            let pose = Pose { position: Some(*position), rotation: None };
            write_exr(output, image, &pose, Mapping::LatLong, SampleFormat::F32).map(drop)
        }
    };
    written.map_err(Fault::from_writing)
}

/// Colours as they are meant.
fn write_plain(output: &Path, image: &Image) -> Result<(), Fault> {
    write_png(output, image.width, image.height, &tone::plain(image)).map_err(Fault::from_writing)
}

fn parse_slice(text: &str) -> Result<(usize, f64), String> {
    let (axis, at) = text.split_once('=').ok_or("expected an axis and a place on it, such as y=1.6")?;
    let axis = ["x", "y", "z"].iter().position(|name| *name == axis).ok_or("expected x, y or z before the =")?;
    let at = at.parse().ok().filter(|at: &f64| at.is_finite());
    Ok((axis, at.ok_or("expected metres after the =")?))
}

pub fn parse_size(text: &str) -> Result<[usize; 2], String> {
    let numbers = text.split_once(['x', 'X']).and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    let size = numbers.filter(|[w, h]: &[usize; 2]| *w > 0 && w.checked_mul(*h).is_some_and(|n| n > 0));
    let size = size.ok_or("expected WIDTHxHEIGHT, both above 0, such as 640x360")?;
    if size[0] * size[1] > MAX_PIXELS {
        return Err(format!("expected at most {MAX_PIXELS} pixels (16384 x 8192)"));
    }
    Ok(size)
}

fn parse_place(text: &str) -> Result<[f64; 3], String> {
    let places: Vec<[f64; 3]> = gdibl_baker::job::Text::parse(&[text])?;
    Ok(places[0])
}

fn parse_fov(text: &str) -> Result<f64, String> {
    let degrees = text.parse().ok().filter(|degrees| *degrees > 0.0 && *degrees < 180.0);
    degrees.ok_or("expected degrees between 0 and 180".into())
}

fn parse_stops(text: &str) -> Result<f32, String> {
    text.parse().ok().filter(|stops: &f32| stops.abs() <= 100.0).ok_or("expected stops from -100 to 100".into())
}

impl CameraReport {
    fn of(camera: &Camera) -> CameraReport {
        match *camera {
            Camera::Pinhole { eye, target, vertical_fov_degrees: fov } => {
                CameraReport::Pinhole { eye: eye.into(), target: target.into(), fov }
            }
            Camera::Panorama { position } => CameraReport::Panorama { panorama: position.into() },
        }
    }
}

fn text(report: &Report, automatic: bool) -> String {
    let place = |[x, y, z]: [f64; 3]| format!("{x:.3},{y:.3},{z:.3}");
    let camera = match report.camera {
        CameraReport::Pinhole { eye, target, fov } => {
            format!("--eye {} --target {} --fov {fov}", place(eye), place(target))
        }
        CameraReport::Panorama { panorama } => format!("--panorama {}", place(panorama)),
    };
    let [width, height] = report.size;
    let mut lines = vec![
        report.output.clone(),
        format!("  picture    {width} x {height}, {} samples per pixel, by {}", report.samples, report.method),
        format!("  camera     {camera}"),
        format!(
            "  work       {:.1} M rays in {:.2} s ({:.2} s of CPU)",
            report.rays as f64 / 1e6,
            report.wall_seconds,
            report.cpu_seconds
        ),
    ];
    if let Some(stops) = report.exposure_stops {
        let why = if automatic { " (automatic)" } else { "" };
        lines.push(format!("  exposure   {stops:+.2} stops{why}"));
    }
    lines.extend(report.scale.map(|scale| scale_text(scale).trim_start_matches('\n').to_owned()));
    // What rounds to nothing is nothing.
    if report.uncovered >= 5e-5 {
        let share = report.uncovered * 100.0;
        lines.push(format!("  uncovered  {share:.2} % of the light: no probe has seen where it comes from; black"));
    }
    lines.join("\n")
}
