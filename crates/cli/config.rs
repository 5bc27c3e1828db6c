//! What to bake: BAKE.toml, overridden by flags. The same settings by the same names in both.

use clap::Args;
use serde::Deserialize;
use std::path::{Path, PathBuf};

use gdibl_baker::import::gltf::TextureNeeds;
use gdibl_baker::radiance::blend::BlendRule;
use gdibl_baker::radiance::gdibl::{GdiblSettings, SceneHit};
use gdibl_baker::radiance::path::PathSettings;
use gdibl_baker::sampling::Sampler;
use gdibl_baker::volume::Precision;

use crate::fault::Fault;

/// Flags that BAKE.toml can hold too. `None`: not said.
#[derive(Args, Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GridFlags {
    /// Where to bake: grid, vertices, or points:FILE.csv (x,y,z with a header line) [default: grid]
    #[arg(long, value_name = "WHERE")]
    pub nodes: Option<NodeKind>,
    /// Box of the grid, world metres: x0,y0,z0,x1,y1,z1 [default: the level's box]
    #[arg(long, value_name = "BOX", value_delimiter = ',', num_args = 1, allow_hyphen_values = true)]
    pub bounds: Option<Vec<f64>>,
    /// Greatest distance between grid nodes, metres [default: 32 nodes along the longest axis]
    #[arg(long, value_name = "M")]
    pub spacing: Option<f64>,
    /// Grid nodes per axis: X,Y,Z
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', num_args = 1)]
    pub counts: Option<Vec<u64>>,
    /// Leave grid nodes out where light between their neighbours is right to this share (0.01 is 1 %); spacing, or counts,
    /// then say how fine the grid may become, and counts grow until coarser cells fit in [default: all are baked]
    #[arg(long, value_name = "F")]
    pub tolerance: Option<f64>,
}

/// Highest band of spherical harmonics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bands {
    /// What the light needs.
    Auto,
    /// This one.
    To(u32),
}

/// Flags that BAKE.toml can hold too. `None`: not said.
#[derive(Args, Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct QualityFlags {
    /// Directions per node; with --target-error the most a node may take [default: 4096; with a target 65536]
    #[arg(long, value_name = "N")]
    pub samples: Option<u64>,
    /// Sample each node until the relative standard error of its irradiance is at most this (0.01 is 1 %)
    #[arg(long, value_name = "F")]
    pub target_error: Option<f64>,
    /// Same seed, same bytes [default: 0]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Worker threads; the result does not depend on it [default: all]
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// sobol, or random (the report's, a baseline) [default: sobol]
    #[arg(long, value_name = "NAME", value_parser = parse_sampler)]
    #[serde(deserialize_with = "text::sampler")]
    pub sampler: Option<Sampler>,
    /// gdibl, or path: path tracing, the ground truth, which needs no probe [default: gdibl]
    #[arg(long, value_name = "NAME", value_parser = parse_method)]
    #[serde(deserialize_with = "text::method")]
    pub method: Option<Method>,
    /// Surfaces that light may leave on its way to a node, by path tracing: 1 is direct light [default: 64, with
    /// roulette]
    #[arg(long, value_name = "N")]
    pub bounces: Option<u32>,
    /// Direct light of point, spot and directional lights: include, or exclude for the engine to add it, moving and
    /// sharp; their bounced light is there in any case [default: exclude]
    #[arg(long, value_name = "WHAT", value_parser = parse_punctual)]
    #[serde(deserialize_with = "text::punctual")]
    pub punctual: Option<Punctual>,
    /// Sun of the distant panorama: extract leaves its direct light out for the engine to add as the directional light that
    /// is reported; its bounced light stays; include leaves all in [default: include]
    #[arg(long, value_name = "WHAT", value_parser = parse_sun)]
    #[serde(deserialize_with = "text::sun")]
    pub sun: Option<Sun>,
    /// Cut every sample's radiance off at this, and say how much light that took [default: off]
    #[arg(long, value_name = "L")]
    pub clamp: Option<f32>,
    /// What a ray does at scene geometry: recurse:DEPTH or occlude [default: recurse:3]
    #[arg(long, value_name = "HOW", value_parser = parse_scene_hit)]
    #[serde(deserialize_with = "text::scene_hit")]
    pub scene: Option<SceneHit>,
    /// Bands of spherical harmonics: L0, L1, L2, L3, L4, or auto: the fewest with which irradiance at 95 % of the nodes is that of L4
    /// to --tolerance, or to 10 % [default: L2]
    #[arg(long, value_name = "BANDS", value_parser = parse_bands)]
    #[serde(deserialize_with = "text::bands")]
    pub sh: Option<Bands>,
    /// Numbers in the file: f16, f32, packed or packed:ERROR, a fifth of f16's bytes with at most this error added to E in 95 %
    /// of the nodes (0.002 to 0.1, by default 0.005), with --zstd unless forbidden [default: f16]
    #[arg(long, value_name = "TYPE", value_parser = parse_precision)]
    #[serde(deserialize_with = "text::precision")]
    pub precision: Option<Precision>,
    /// Compress the file's sections with zstd; readers need a decoder then
    #[arg(long, num_args = 0, default_missing_value = "true")]
    pub zstd: Option<bool>,
    /// Store the standard error of every coefficient and of the worst direction, per node
    #[arg(long, num_args = 0, default_missing_value = "true")]
    pub coefficient_errors: Option<bool>,
    /// Scale down bands 1 and up of nodes whose irradiance turns negative for some normal, by as little as ends that
    #[arg(long, num_args = 0, default_missing_value = "true")]
    pub dering: Option<bool>,
    /// How probes that see a point share it: distance:k, angular:k, angular-smooth:k, nearest, footprint:k
    /// [default: footprint:4]
    #[arg(long, value_name = "RULE", value_parser = parse_blend)]
    #[serde(deserialize_with = "text::blend")]
    pub blend: Option<BlendRule>,
    /// Replace NaN, infinite and negative pixels instead of refusing the image
    #[arg(long, num_args = 0, default_missing_value = "true")]
    pub repair_pixels: Option<bool>,
    /// Match the exposures of photographed probes by surfaces that two or more of them show, and name probes that seem
    /// misplaced
    #[arg(long, num_args = 0, default_missing_value = "true")]
    pub match_exposure: Option<bool>,
    /// Refuse a bake that needs more memory than this, GiB [default: what the machine has free]
    #[arg(long, value_name = "GIB")]
    pub max_memory: Option<f64>,
}

/// How probes are captured: flags of `capture`, and `[capture]` of BAKE.toml. `None`: not said.
#[derive(Args, Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CaptureFlags {
    /// Place probes automatically, at most --most of them
    #[arg(long, num_args = 0, default_missing_value = "true")]
    pub auto: Option<bool>,
    /// A probe's place, world metres: x,y,z; repeatable
    #[arg(long = "position", value_name = "X,Y,Z", value_parser = parse_position, allow_hyphen_values = true)]
    pub positions: Vec<[f64; 3]>,
    /// Most probes that --auto places [default: 32]
    #[arg(long, value_name = "N")]
    pub most: Option<usize>,
    /// Pixels around the horizon [default: 256]
    #[arg(long, value_name = "PIXELS")]
    pub width: Option<usize>,
    /// Paths per pixel; with --target-error the most a pixel may take [default: 64; with a target 65536]
    #[arg(long, value_name = "N")]
    pub samples: Option<u32>,
    /// Sample each pixel until its relative standard error is at most this (0.01 is 1 %)
    #[arg(long, value_name = "F")]
    pub target_error: Option<f64>,
}

impl CaptureFlags {
    fn or(self, file: CaptureFlags) -> CaptureFlags {
        // Places by flag replace the file's.
        let placed = self.auto.is_some() || !self.positions.is_empty();
        CaptureFlags {
            auto: if placed { self.auto } else { file.auto },
            positions: if placed { self.positions } else { file.positions },
            most: self.most.or(file.most),
            width: self.width.or(file.width),
            samples: self.samples.or(file.samples),
            target_error: self.target_error.or(file.target_error),
        }
    }
}

pub fn parse_position(text: &str) -> Result<[f64; 3], String> {
    let numbers: Vec<f64> =
        text.split(',').filter_map(|n| n.trim().parse().ok()).filter(|n: &f64| n.is_finite()).collect();
    <[f64; 3]>::try_from(numbers).ok().filter(|_| text.split(',').count() == 3).ok_or("expected x,y,z".into())
}

/// Flags of the verbs that trace for long, but of `bake`, whose [`QualityFlags`] BAKE.toml holds too.
#[derive(Args)]
pub struct RunFlags {
    /// Replace NaN, infinite and negative pixels instead of refusing the image
    #[arg(long)]
    pub repair_pixels: bool,
    /// Same seed, same bytes [default: 0]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Worker threads; the result does not depend on it [default: all]
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
    /// No progress bar
    #[arg(long)]
    pub quiet: bool,
}

/// The radiance function.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    #[default]
    Gdibl,
    Path,
}

/// The direct light of punctual lights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Punctual {
    Include,
    #[default]
    Exclude,
}

/// The direct light of a sun in the distant panorama.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sun {
    #[default]
    Include,
    Extract,
}

/// Where nodes stand.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(try_from = "String")]
pub enum NodeKind {
    Grid,
    Vertices,
    Points(PathBuf),
}

impl TryFrom<String> for NodeKind {
    type Error = String;
    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl std::str::FromStr for NodeKind {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(':') {
            None if text == "grid" => Ok(NodeKind::Grid),
            None if text == "vertices" => Ok(NodeKind::Vertices),
            Some(("points", file)) if !file.is_empty() => Ok(NodeKind::Points(file.into())),
            _ => Err(format!("'{text}': expected grid, vertices or points:FILE.csv")),
        }
    }
}

/// One `[[probe]]` of BAKE.toml.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProbeEntry {
    pub image: PathBuf,
    /// World metres; wins over the image's own.
    pub position: Option<[f64; 3]>,
    /// Quaternion x y z w, probe to world; wins over the image's own.
    pub rotation: Option<[f64; 4]>,
    #[serde(default)]
    pub exposure_stops: f32,
    /// How the image maps directions, by name (lat-long, angular, cube-strip …).
    pub mapping: Option<String>,
}

/// The distant panorama: a path, or a table like a probe's without position.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
pub enum DistantEntry {
    Image(PathBuf),
    Placed(ProbeEntry),
}

/// A BAKE.toml.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct BakeFile {
    level: Option<PathBuf>,
    output: Option<PathBuf>,
    environment: Option<PathBuf>,
    distant: Option<DistantEntry>,
    probes: Vec<PathBuf>,
    probe: Vec<ProbeEntry>,
    grid: GridFlags,
    quality: QualityFlags,
    capture: CaptureFlags,
}

/// Everything that was asked for, paths resolved.
#[derive(Debug)]
pub struct Config {
    pub level: PathBuf,
    pub output: PathBuf,
    pub environment: Option<PathBuf>,
    pub distant: Option<ProbeEntry>,
    pub probes: Vec<PathBuf>,
    pub placed_probes: Vec<ProbeEntry>,
    pub grid: GridFlags,
    pub quality: QualityFlags,
    pub capture: CaptureFlags,
}

/// Flags of `bake` that name files.
#[derive(Args, Clone, Debug)]
pub struct FileFlags {
    /// LEVEL.glb, LEVEL.gltf or BAKE.toml
    pub input: PathBuf,
    /// The volume to write [default: beside the input, ending in .gdibl]
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// A probe (EXR or HDR with its pose in the header) or a folder of them; repeatable
    #[arg(long, value_name = "PATH")]
    pub probes: Vec<PathBuf>,
    /// Panorama at infinity: the sky, the street outside
    #[arg(long, value_name = "IMAGE")]
    pub distant: Option<PathBuf>,
    /// Other geometry for the environment (a proxy) [default: the level's nodes by role]
    #[arg(long, value_name = "FILE")]
    pub environment: Option<PathBuf>,
}

impl Config {
    /// Reads BAKE.toml if that is the input, and lets flags win.
    pub fn new(
        files: FileFlags,
        grid: GridFlags,
        quality: QualityFlags,
        capture: CaptureFlags,
    ) -> Result<Config, Fault> {
        let input = files.input;
        let (mut file, folder) = if is_level(&input)? {
            (BakeFile { level: Some(input.clone()), ..BakeFile::default() }, PathBuf::new())
        } else {
            let folder = input.parent().unwrap_or(Path::new("")).to_path_buf();
            (BakeFile::read(&input, &folder)?, folder)
        };
        let Some(level) = file.level.take() else {
            return Err(Fault::Invalid(format!("{}: names no level; add: level = \"LEVEL.glb\"", input.display())));
        };
        let distant = file.distant.map(|distant| match distant {
            DistantEntry::Image(image) => ProbeEntry { image: folder.join(image), ..ProbeEntry::default() },
            DistantEntry::Placed(entry) => ProbeEntry { image: folder.join(&entry.image), ..entry },
        });
        // Probes named on the command line replace the file's.
        let by_flag = !files.probes.is_empty();
        Ok(Config {
            output: files.output.or(file.output).unwrap_or_else(|| input.with_extension("gdibl")),
            level,
            environment: files.environment.or(file.environment),
            distant: files.distant.map(|image| ProbeEntry { image, ..ProbeEntry::default() }).or(distant),
            probes: if by_flag { files.probes } else { file.probes },
            placed_probes: if by_flag { Vec::new() } else { file.probe },
            grid: grid.or(file.grid)?,
            quality: quality.or(file.quality),
            capture: capture.or(file.capture),
        })
    }
}

/// Starts as many worker threads as were asked for.
pub fn set_threads(threads: Option<usize>) -> Result<(), Fault> {
    let Some(threads) = threads else { return Ok(()) };
    if !(1..=1024).contains(&threads) {
        return Err(Fault::Usage(format!("--threads {threads}: expected 1 to 1024")));
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    pool.map_err(|error| Fault::System(format!("cannot start {threads} threads: {error}")))
}

/// A target error is a positive share.
pub fn check_target(target: Option<f64>) -> Result<(), Fault> {
    match target.filter(|target| !(*target > 0.0 && target.is_finite())) {
        Some(target) => Err(Fault::Usage(format!("--target-error {target}: expected a positive share, 0.01 for 1 %"))),
        None => Ok(()),
    }
}

/// The most that a sample's radiance may be; infinite where nothing is said.
pub fn clamp(quality: &QualityFlags) -> Result<f32, Fault> {
    match quality.clamp {
        None => Ok(f32::INFINITY),
        Some(clamp) if clamp > 0.0 => Ok(clamp),
        Some(clamp) => Err(Fault::Usage(format!("--clamp {clamp}: expected a radiance above 0"))),
    }
}

/// How the probes' light is computed. `captured`: they were captured for want of others. `directions`: those that will leave
/// nodes, all together, 0 where there are none.
pub fn gdibl_settings(quality: &QualityFlags, captured: bool, directions: u64) -> GdiblSettings {
    let defaults = GdiblSettings::default();
    GdiblSettings {
        blend: quality.blend.unwrap_or(defaults.blend),
        scene_hit: quality.scene.unwrap_or(defaults.scene_hit),
        emission_from_materials: captured,
        walks: quality.samples.map_or(defaults.walks, GdiblSettings::walks_beside),
        seed: quality.seed.unwrap_or(defaults.seed),
        directions,
        ..defaults
    }
}

/// How paths are traced.
pub fn path_settings(quality: &QualityFlags) -> Result<PathSettings, Fault> {
    let bounces = quality.bounces.unwrap_or(PathSettings::default().bounces);
    if bounces > PathSettings::MAX_BOUNCES {
        return Err(Fault::Usage(format!("--bounces {bounces}: expected at most {}", PathSettings::MAX_BOUNCES)));
    }
    Ok(PathSettings { bounces, ..PathSettings::default() })
}

impl Config {
    /// Which textures the method needs; `captures`: probes are captured if none is given.
    pub fn textures(&self, captures: bool) -> TextureNeeds {
        match self.quality.method.unwrap_or_default() {
            Method::Path => TextureNeeds::All,
            Method::Gdibl if captures && self.names_no_probe() => TextureNeeds::Captured,
            Method::Gdibl => TextureNeeds::Gdibl,
        }
    }

    /// Neither flags nor BAKE.toml name a probe; the level's nodes may.
    pub fn names_no_probe(&self) -> bool {
        self.probes.is_empty() && self.placed_probes.is_empty()
    }
}

impl BakeFile {
    fn read(path: &Path, folder: &Path) -> Result<BakeFile, Fault> {
        let bytes = std::fs::read(path).map_err(|error| Fault::reading(path, &error))?;
        let invalid = |message: String| Fault::Invalid(format!("{}: {message}", path.display()));
        let text =
            String::from_utf8(bytes).map_err(|_| invalid("is neither glTF (binary or JSON) nor a BAKE.toml".into()))?;
        let mut file: BakeFile = toml::from_str(&text).map_err(|error| invalid(error.to_string()))?;
        let resolve = |path: &mut PathBuf| *path = folder.join(&*path);
        file.level.iter_mut().for_each(resolve);
        file.output.iter_mut().for_each(resolve);
        file.environment.iter_mut().for_each(resolve);
        file.probes.iter_mut().for_each(resolve);
        file.probe.iter_mut().for_each(|probe| resolve(&mut probe.image));
        if let Some(NodeKind::Points(points)) = &mut file.grid.nodes {
            resolve(points);
        }
        Ok(file)
    }
}

/// Levels are told from BAKE.toml by their first bytes.
fn is_level(path: &Path) -> Result<bool, Fault> {
    use std::io::Read;
    let mut start = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(64).read_to_end(&mut start));
    read.map_err(|error| Fault::reading(path, &error))?;
    let text = start.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&start);
    Ok(start.starts_with(b"glTF") || text.trim_ascii_start().starts_with(b"{"))
}

impl GridFlags {
    fn or(self, file: GridFlags) -> Result<GridFlags, Fault> {
        // A spacing by flag replaces counts of the file, and the other way round; both in one place contradict.
        for one in [&self, &file] {
            if one.spacing.is_some() && one.counts.is_some() {
                return Err(Fault::Usage("spacing and counts contradict each other: give one of them".into()));
            }
        }
        let by_flag = self.spacing.is_some() || self.counts.is_some();
        Ok(GridFlags {
            nodes: self.nodes.or(file.nodes),
            bounds: self.bounds.or(file.bounds),
            spacing: if by_flag { self.spacing } else { file.spacing },
            counts: if by_flag { self.counts } else { file.counts },
            tolerance: self.tolerance.or(file.tolerance),
        })
    }
}

impl QualityFlags {
    fn or(self, file: QualityFlags) -> QualityFlags {
        QualityFlags {
            samples: self.samples.or(file.samples),
            target_error: self.target_error.or(file.target_error),
            seed: self.seed.or(file.seed),
            threads: self.threads.or(file.threads),
            sampler: self.sampler.or(file.sampler),
            method: self.method.or(file.method),
            bounces: self.bounces.or(file.bounces),
            punctual: self.punctual.or(file.punctual),
            sun: self.sun.or(file.sun),
            clamp: self.clamp.or(file.clamp),
            scene: self.scene.or(file.scene),
            sh: self.sh.or(file.sh),
            precision: self.precision.or(file.precision),
            zstd: self.zstd.or(file.zstd),
            coefficient_errors: self.coefficient_errors.or(file.coefficient_errors),
            dering: self.dering.or(file.dering),
            blend: self.blend.or(file.blend),
            repair_pixels: self.repair_pixels.or(file.repair_pixels),
            match_exposure: self.match_exposure.or(file.match_exposure),
            max_memory: self.max_memory.or(file.max_memory),
        }
    }
}

fn parse_sampler(text: &str) -> Result<Sampler, String> {
    match text {
        "sobol" => Ok(Sampler::Sobol),
        "random" => Ok(Sampler::Random),
        _ => Err("expected sobol or random".into()),
    }
}

pub fn parse_method(text: &str) -> Result<Method, String> {
    match text {
        "gdibl" => Ok(Method::Gdibl),
        "path" => Ok(Method::Path),
        _ => Err("expected gdibl or path".into()),
    }
}

fn parse_punctual(text: &str) -> Result<Punctual, String> {
    match text {
        "include" => Ok(Punctual::Include),
        "exclude" => Ok(Punctual::Exclude),
        _ => Err("expected include or exclude".into()),
    }
}

fn parse_sun(text: &str) -> Result<Sun, String> {
    match text {
        "include" => Ok(Sun::Include),
        "extract" => Ok(Sun::Extract),
        _ => Err("expected include or extract".into()),
    }
}

fn parse_scene_hit(text: &str) -> Result<SceneHit, String> {
    match text.split_once(':') {
        None if text == "occlude" => Ok(SceneHit::Occlude),
        None if text == "recurse" => Ok(SceneHit::default()),
        // Deeper than this, what is left of the light is under a millionth even at albedo 0.8.
        Some(("recurse", depth)) => match depth.parse() {
            Ok(depth @ 0..=64) => Ok(SceneHit::Recurse(depth)),
            _ => Err("the depth of recurse:DEPTH must be 0 to 64".into()),
        },
        _ => Err("expected recurse:DEPTH or occlude".into()),
    }
}

pub fn parse_bands(text: &str) -> Result<Bands, String> {
    let bands = text
        .strip_prefix('L')
        .and_then(|digits| digits.parse().ok())
        .filter(|bands| *bands <= gdibl_runtime::sh::MAX_BANDS);
    match bands {
        Some(bands) => Ok(Bands::To(bands)),
        None if text == "auto" => Ok(Bands::Auto),
        None => Err("expected L0, L1, L2, L3, L4 or auto".into()),
    }
}

pub fn parse_precision(text: &str) -> Result<Precision, String> {
    match text {
        "f16" => Ok(Precision::F16),
        "f32" => Ok(Precision::F32),
        "packed" => Ok(Precision::PACKED),
        _ => match text.strip_prefix("packed:").map(str::parse) {
            Some(Ok(error)) if Precision::PACKED_ERRORS.contains(&error) => Ok(Precision::Packed { error }),
            Some(_) => Err("the error of packed:ERROR must be 0.002 to 0.1".into()),
            None => Err("expected f16, f32, packed or packed:ERROR".into()),
        },
    }
}

pub fn parse_blend(text: &str) -> Result<BlendRule, String> {
    text.parse()
}

/// The flags' parsers, for BAKE.toml.
mod text {
    use serde::{Deserialize, Deserializer, de::Error};

    fn parsed<'de, D: Deserializer<'de>, T>(
        deserializer: D,
        parse: impl Fn(&str) -> Result<T, String>,
    ) -> Result<Option<T>, D::Error> {
        let text = String::deserialize(deserializer)?;
        parse(&text).map(Some).map_err(|why| D::Error::custom(format!("'{text}': {why}")))
    }

    macro_rules! parsers {
        ($($name:ident: $type:ty = $parse:ident),+) => {$(
            pub fn $name<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<$type>, D::Error> {
                parsed(deserializer, super::$parse)
            }
        )+};
    }
    parsers! {
        sampler: super::Sampler = parse_sampler,
        method: super::Method = parse_method,
        punctual: super::Punctual = parse_punctual,
        sun: super::Sun = parse_sun,
        scene_hit: super::SceneHit = parse_scene_hit,
        bands: super::Bands = parse_bands,
        precision: super::Precision = parse_precision,
        blend: super::BlendRule = parse_blend
    }
}
