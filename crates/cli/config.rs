//! What to bake: flags over BAKE.toml over defaults, merged once.

use clap::Args;
use serde::Deserialize;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use gdibl_baker::import::files::Files;
use gdibl_baker::import::gltf::TextureNeeds;
use gdibl_baker::import::sky::SkySource;
use gdibl_baker::job::{Method, NodeKind, Settings};
use gdibl_baker::radiance::unseen::Unseen;

use crate::cache::Cache;
use crate::fault::Fault;
use crate::flags::Given;
use crate::read_once::ReadOnce;

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
    /// The layer of an EXR file.
    pub layer: Option<String>,
    /// Degrees around +Y, after the rotation.
    #[serde(default)]
    pub yaw: f64,
}

/// The distant panorama: a path, the radiance of a sky without a file, or a table like a probe's without position.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
enum DistantEntry {
    Image(PathBuf),
    Constant([f32; 3]),
    Placed(ProbeEntry),
}

impl DistantEntry {
    /// As a table, its path resolved. A sky without a file has no folder.
    fn entry(self, folder: &Path) -> Result<ProbeEntry, Fault> {
        let entry = match self {
            DistantEntry::Image(image) => ProbeEntry { image, ..ProbeEntry::default() },
            DistantEntry::Constant([r, g, b]) => {
                ProbeEntry { image: format!("{r},{g},{b}").into(), ..ProbeEntry::default() }
            }
            DistantEntry::Placed(entry) => entry,
        };
        let image = match sky_source(&entry.image)? {
            SkySource::Image(image) => folder.join(image),
            SkySource::Constant(_) => entry.image,
        };
        Ok(ProbeEntry { image, ..entry })
    }
}

/// A sky without a file is three numbers.
pub fn sky_source(image: &Path) -> Result<SkySource, Fault> {
    image.to_string_lossy().parse().map_err(|why| Fault::Usage(format!("--distant {why}")))
}

/// A BAKE.toml. The tables of settings are read by the table of settings.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct BakeFile {
    level: Option<PathBuf>,
    output: Option<PathBuf>,
    environment: Option<PathBuf>,
    distant: Option<DistantEntry>,
    probes: Vec<PathBuf>,
    probe: Vec<ProbeEntry>,
    grid: toml::Table,
    quality: toml::Table,
    capture: toml::Table,
}

/// Everything that was asked for, paths resolved.
#[derive(Clone, Debug)]
pub struct Config {
    pub level: PathBuf,
    pub output: PathBuf,
    pub environment: Option<PathBuf>,
    pub distant: Option<ProbeEntry>,
    /// The layer of all images.
    pub layer: Option<String>,
    pub probes: Vec<PathBuf>,
    pub placed_probes: Vec<ProbeEntry>,
    pub settings: Settings,
    /// What was read of all these.
    pub files: Arc<ReadOnce>,
    /// Where captured probes are kept.
    pub cache: Cache,
}

/// Flags of `bake` that name files.
#[derive(Args, Clone, Debug)]
pub struct FileFlags {
    /// LEVEL.glb, LEVEL.gltf or BAKE.toml
    pub input: PathBuf,
    /// The volume to write [default: beside the input, ending in .gdibl]
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub light: LightFlags,
    /// Other geometry for the environment (a proxy) [default: the level's nodes by role]
    #[arg(long, value_name = "FILE")]
    pub environment: Option<PathBuf>,
}

/// Flags that name images.
#[derive(Args, Clone, Debug, Default)]
pub struct LightFlags {
    /// A probe (EXR or HDR with its pose in the header) or a folder of them; repeatable
    #[arg(long, value_name = "PATH")]
    pub probes: Vec<PathBuf>,
    /// Panorama at infinity: the sky, the street outside; or R,G,B, the same radiance from everywhere
    #[arg(long, value_name = "IMAGE")]
    pub distant: Option<PathBuf>,
    #[command(flatten)]
    pub sky: SkyFlags,
    /// Folder for what bakes have in common: captured probes, and what shards share [default: the user's cache folder]
    #[arg(long, value_name = "FOLDER")]
    pub cache: Option<PathBuf>,
}

/// How images are read and the distant panorama is turned.
#[derive(Args, Clone, Debug, Default)]
pub struct SkyFlags {
    /// Layer of EXR images to read, by its name or the end of it [default: the picture]
    #[arg(long, value_name = "NAME")]
    pub layer: Option<String>,
    /// How the distant panorama maps directions: lat-long, lat-long-three, lat-long-blender, angular, cube-strip …
    /// [default: what its file says, else lat-long if it is twice as wide as high]
    #[arg(long, value_name = "NAME")]
    pub distant_mapping: Option<String>,
    /// Turn the distant panorama around +Y by degrees, counter-clockwise as seen from above [default: 0]
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true)]
    pub distant_yaw: Option<f64>,
    /// Make the distant panorama brighter by stops: 1 doubles its light [default: 0]
    #[arg(long, value_name = "STOPS", allow_hyphen_values = true)]
    pub distant_exposure: Option<f32>,
}

impl SkyFlags {
    /// Lets the flags win.
    fn apply(&self, distant: Option<&mut ProbeEntry>) -> Result<(), Fault> {
        let stray = self.distant_mapping.is_some() || self.distant_yaw.is_some() || self.distant_exposure.is_some();
        let Some(entry) = distant else {
            return match stray {
                true => Err(Fault::Usage("--distant-…: there is no distant panorama; give --distant IMAGE".into())),
                false => Ok(()),
            };
        };
        for (flag, found) in [
            ("yaw", self.distant_yaw.map(|v| v.abs() <= 36000.0)),
            ("exposure", self.distant_exposure.map(|v| v.abs() <= 100.0)),
        ] {
            if found == Some(false) {
                return Err(Fault::Usage(format!("--distant-{flag}: expected up to 36000 degrees or 100 stops")));
            }
        }
        entry.layer = self.layer.clone().or(entry.layer.take());
        entry.mapping = self.distant_mapping.clone().or(entry.mapping.take());
        entry.yaw = self.distant_yaw.unwrap_or(entry.yaw);
        entry.exposure_stops = self.distant_exposure.unwrap_or(entry.exposure_stops);
        Ok(())
    }
}

impl FileFlags {
    /// An input with its light, and nothing else.
    pub fn of(input: &Path, light: LightFlags) -> FileFlags {
        FileFlags { input: input.into(), output: None, light, environment: None }
    }
}

impl Config {
    /// Reads BAKE.toml if that is the input, and lets flags win.
    pub fn new(files: FileFlags, given: &[Given]) -> Result<Config, Fault> {
        let input = files.input;
        let mut settings = Settings::default();
        let files_read = ReadOnce::default();
        let (mut file, folder) = if is_level(&input)? {
            (BakeFile { level: Some(input.clone()), ..BakeFile::default() }, PathBuf::new())
        } else {
            let folder = input.parent().unwrap_or(Path::new("")).to_path_buf();
            (BakeFile::read(&files_read, &input, &folder, &mut settings)?, folder)
        };
        apply(given, &mut settings)?;
        let Some(level) = file.level.take() else {
            return Err(Fault::Invalid(format!("{}: names no level; add: level = \"LEVEL.glb\"", input.display())));
        };
        let LightFlags { probes, distant: by_flag, sky, cache } = files.light;
        let distant = file.distant.map(|distant| distant.entry(&folder)).transpose()?;
        let mut distant = by_flag.map(|image| ProbeEntry { image, ..ProbeEntry::default() }).or(distant);
        sky.apply(distant.as_mut())?;
        for probe in &mut file.probe {
            probe.layer = sky.layer.clone().or(probe.layer.take());
        }
        // Probes named on the command line replace the file's.
        let (probes, placed_probes) = if probes.is_empty() { (file.probes, file.probe) } else { (probes, Vec::new()) };
        Ok(Config {
            output: files.output.or(file.output).unwrap_or_else(|| input.with_extension("gdibl")),
            level,
            environment: files.environment.or(file.environment),
            distant,
            layer: sky.layer,
            probes,
            placed_probes,
            settings,
            files: files_read.into(),
            cache: Cache::new(cache),
        })
    }

    /// Which textures the method needs.
    pub fn textures(&self) -> TextureNeeds {
        let is_filled = self.settings.quality.unseen == Unseen::Fill;
        match self.settings.quality.method {
            Method::Gdibl | Method::Auto if self.names_probes() && is_filled => TextureNeeds::Gdibl,
            // What no probe sees is traced. And the level's own nodes may name probes, which is not known before it is read.
            _ => TextureNeeds::All,
        }
    }

    /// Flags or BAKE.toml name a probe; the level's nodes may, too.
    pub fn names_probes(&self) -> bool {
        !self.probes.is_empty() || !self.placed_probes.is_empty()
    }
}

/// Flags win over what is set.
fn apply(given: &[Given], settings: &mut Settings) -> Result<(), Fault> {
    let is_given = |section, name| given.iter().any(|given| (given.section, given.name) == (section, name));
    // What says how fine a grid is replaces, as a flag, what the file says of that.
    let grid = &mut settings.grid;
    if is_given("grid", "spacing") || is_given("grid", "counts") {
        (grid.spacing, grid.counts) = (None, None);
        (grid.max_nodes, grid.max_bytes, grid.budget) = (None, None, None);
    }
    if ["max_nodes", "max_bytes", "budget"].into_iter().any(|name| is_given("grid", name)) {
        (grid.spacing, grid.counts) = (None, None);
    }
    if is_given("capture", "positions") || is_given("capture", "auto") {
        (settings.capture.positions, settings.capture.auto) = (Vec::new(), false);
    }
    for Given { section, name, texts } in given {
        let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
        let set = settings.set(section, name, &texts);
        set.map_err(|why| Fault::Usage(format!("--{} {}: {why}", name.replace('_', "-"), texts.join(" "))))?;
    }
    settings.check().map_err(|out| Fault::Usage(format!("{} {}", out.flag, out.message)))
}

/// The last part of a path, for records that must not depend on where a level lies.
pub fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// Starts as many worker threads as were asked for.
pub fn set_threads(settings: &Settings) -> Result<(), Fault> {
    let Some(threads) = settings.quality.threads else { return Ok(()) };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    pool.map_err(|error| Fault::System(format!("cannot start {threads} threads: {error}")))
}

impl BakeFile {
    fn read(files: &ReadOnce, path: &Path, folder: &Path, settings: &mut Settings) -> Result<BakeFile, Fault> {
        let bytes = files.read(path).map_err(|error| Fault::reading(path, &error))?.to_vec();
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
        for (section, table) in [("grid", &file.grid), ("quality", &file.quality), ("capture", &file.capture)] {
            for (name, value) in table {
                let texts = texts_of(value);
                let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
                let set = settings.set(section, name, &texts);
                set.map_err(|why| invalid(format!("[{section}] {name} = {value}: {why}")))?;
            }
        }
        settings.check().map_err(|out| invalid(format!("{}: {}", out.row, out.message)))?;
        if let NodeKind::Points(points) = &mut settings.grid.nodes {
            resolve(points);
        }
        Ok(file)
    }
}

/// A value of TOML as the texts of flags: an array of arrays is a list.
fn texts_of(value: &toml::Value) -> Vec<String> {
    let text = |value: &toml::Value| match value {
        toml::Value::String(text) => text.clone(),
        toml::Value::Array(numbers) => numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(","),
        other => other.to_string(),
    };
    match value {
        toml::Value::Array(list) if list.iter().any(|item| item.is_array()) => list.iter().map(text).collect(),
        one => vec![text(one)],
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_of_bake_toml_have_the_texts_of_flags() {
        let texts = |toml: &str| texts_of(&toml::from_str::<toml::Table>(toml).unwrap()["x"]);
        assert_eq!(texts("x = 64"), ["64"]);
        assert_eq!(texts("x = 0.5"), ["0.5"]);
        assert_eq!(texts("x = true"), ["true"]);
        assert_eq!(texts("x = \"angular:2\""), ["angular:2"]);
        assert_eq!(texts("x = [-1, 0.5, 2]"), ["-1,0.5,2"]);
        assert_eq!(texts("x = [[1, 2, 3], [4, 5, 6]]"), ["1,2,3", "4,5,6"]);
    }
}
