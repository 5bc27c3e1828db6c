//! Probes captured from the level: for `capture`, and for a bake or a picture that was given none.

use glam::DVec3;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use gdibl_baker::air::Air;
use gdibl_baker::capture::{CaptureSettings, Captured, FREE_PLACES, PlaceSettings, Placement, capture, place_probes};
use gdibl_baker::import::gltf::TextureNeeds;
use gdibl_baker::import::image::{Pose, SampleFormat, write_exr};
use gdibl_baker::import::sky::SkySource;
use gdibl_baker::job::{CapturePlan, Inputs};
use gdibl_baker::panorama::{Mapping, Panorama, from_lat_long};
use gdibl_baker::radiance::Distant;
use gdibl_baker::radiance::path::{Path as Paths, specular_left_out};
use gdibl_baker::scene::{Role, Scene};
use gdibl_baker::{Control, Finding};

use crate::config::{Config, ProbeEntry, sky_source};
use crate::fault::Fault;
use crate::hashes::inputs_of;
use crate::inputs::{PROGRAM, read_level_and_sky, read_probes};
use crate::progress::{Progress, Shown};
use crate::session::say;

/// A probe that is to be captured.
#[derive(Debug, Clone, PartialEq)]
pub struct Place {
    pub position: DVec3,
    pub file: PathBuf,
}

/// What came of one.
pub struct CapturedProbe {
    pub place: Place,
    pub captured: Captured,
    pub findings: Vec<Finding>,
    pub seconds: f64,
}

/// Pixels around the horizon of probes that nobody asked for. They hold reflected light alone, which is smooth: with 256,
/// at four times the time, the error of the game map of the README went from 20 % to 19 %.
const AUTO_WIDTH: usize = 128;

/// The places that were asked for, by files in `folder`.
pub fn places(
    scene: &Scene,
    paths: &Paths,
    asked: &CapturePlan,
    folder: &Path,
    cancel: &AtomicBool,
    shown: Shown,
) -> Result<Vec<Place>, Fault> {
    let positions: Vec<DVec3> = if asked.positions.is_empty() {
        let placement = automatic_placement(scene, paths, asked, cancel, shown)?;
        if let Some(last) = placement.suggestions.last() {
            let share = last.after.coverage * 100.0;
            let count = placement.suggestions.len();
            say(&format!("{count} probes see {share:.1} % of the surfaces that the free space sees"));
        }
        placement.positions()
    } else {
        asked.positions.iter().map(|p| DVec3::from(*p)).collect()
    };
    let digits = positions.len().saturating_sub(1).to_string().len();
    let file = |i: usize| folder.join(format!("probe_{i:0digits$}.exr"));
    Ok(positions.into_iter().enumerate().map(|(i, position)| Place { position, file: file(i) }).collect())
}

/// Where --auto places probes.
pub fn automatic_placement(
    scene: &Scene,
    paths: &Paths,
    asked: &CapturePlan,
    cancel: &AtomicBool,
    shown: Shown,
) -> Result<Placement, Fault> {
    let settings = PlaceSettings { most: asked.most.unwrap_or(PlaceSettings::default().most), ..Default::default() };
    match box_of_probes(scene) {
        None => Ok(Placement::default()),
        Some(bounds) => place(paths, bounds, &[], &settings, cancel, shown),
    }
}

/// The box in which probes stand by default: that of the air that people can be in. `None`: there is nothing that one could see.
pub fn box_of_probes(scene: &Scene) -> Option<(DVec3, DVec3)> {
    (scene.triangle_count(Role::Environment) > 0).then(|| Air::of(scene)).flatten().map(|air| air.bounds)
}

/// Places probes, with progress, until interrupted.
pub fn place(
    paths: &Paths,
    bounds: (DVec3, DVec3),
    existing: &[DVec3],
    settings: &PlaceSettings,
    cancel: &AtomicBool,
    shown: Shown,
) -> Result<Placement, Fault> {
    let progress = Progress::new("places", FREE_PLACES as u64, shown);
    let control = Control { cancel, progress: &|places, rays| progress.advance(places, rays), blocks: None };
    let placement = place_probes(paths, bounds, existing, settings, &control).map_err(|_| Fault::Interrupted)?;
    progress.finish();
    Ok(placement)
}

/// Captures and writes every place.
pub fn capture_all(
    paths: &Paths,
    places: &[Place],
    mapping: Mapping,
    settings: &CaptureSettings,
    cancel: &AtomicBool,
    shown: Shown,
) -> Result<Vec<CapturedProbe>, Fault> {
    let pixels = (settings.width * (settings.width / 2) * places.len()) as u64;
    let progress = Progress::new("pixels", pixels, shown);
    let control = Control { cancel, progress: &|pixels, rays| progress.advance(pixels, rays), blocks: None };
    let mut outcomes = Vec::new();
    for (index, place) in places.iter().enumerate() {
        let started = Instant::now();
        let captured = capture(paths, place.position, index as u64, settings, &control);
        let captured = captured.map_err(|_| Fault::Interrupted)?;
        let findings = write(place, &captured, mapping)?;
        outcomes.push(CapturedProbe {
            place: place.clone(),
            captured,
            findings,
            seconds: started.elapsed().as_secs_f64(),
        });
    }
    progress.finish();
    Ok(outcomes)
}

/// Half floats where they can hold the light.
fn write(place: &Place, captured: &Captured, mapping: Mapping) -> Result<Vec<Finding>, Fault> {
    let image = &captured.image;
    let brightest = image.pixels.iter().flatten().fold(0.0f32, |m, v| m.max(*v));
    let format = if brightest < half::f16::MAX.to_f32() { SampleFormat::F16 } else { SampleFormat::F32 };
    let pose = Pose { position: Some(place.position), rotation: None };
    let written = if mapping == Mapping::LatLong {
        write_exr(&place.file, image, &pose, mapping, format)
    } else {
        let panorama = Panorama::new(image.width, image.height, image.pixels.clone(), image.distance.clone());
        let size = if mapping == Mapping::AngularMap { image.width } else { image.width / 4 };
        write_exr(&place.file, &from_lat_long(&panorama, mapping, size), &pose, mapping, format)
    };
    written.map_err(Fault::from_writing)
}

/// Captures the probes of an input that lacks them, or takes those of an earlier run. Adds them to the inputs; none where
/// the level has no place for one.
pub fn capture_missing(config: &Config, inputs: &mut Inputs, cancel: &AtomicBool, shown: Shown) -> Result<(), Fault> {
    let captured = auto_capture(config, cancel, shown)?;
    read_probes(inputs, &captured.entries, config)?;
    let count = captured.entries.len();
    if count == 0 {
        return Err(Fault::Bound(format!(
            "{}: no probe was given, and the level's box has no place for one: each stands in a solid or sees nothing; \
             --method path needs none",
            config.level.display()
        )));
    }
    if let Some(seconds) = captured.seconds {
        say(&format!(
            "captured {count} probes from the level in {seconds:.1} s; they are kept in {} for the next time",
            config.cache.folder().display()
        ));
    }
    inputs.findings.extend(specular_left_out(&inputs.scene));
    // The level's own light is all there is: what escapes meets nothing, which is not the same as unknown.
    inputs.distant.get_or_insert_with(Distant::black);
    inputs.captured = true;
    Ok(())
}

/// Probes that stand in for those that nobody gave.
struct AutoCapture {
    entries: Vec<ProbeEntry>,
    /// What it cost; `None`: all were in the cache.
    seconds: Option<f64>,
}

/// Captures probes, or takes those from the cache that an earlier run with the same level, light and settings captured: each is an entry
/// of its own, named by the hash of all these, so that a run that was killed goes on from the last one.
fn auto_capture(config: &Config, cancel: &AtomicBool, shown: Shown) -> Result<AutoCapture, Fault> {
    // Reflected light alone: emission is taken from the level's materials.
    let width = config.settings.capture.width.unwrap_or(AUTO_WIDTH);
    let settings = CaptureSettings { emission: false, width, ..config.settings.capture_probes() };
    let key = content_key(config, &settings)?;
    let cache = &config.cache;
    if let Some(entries) = entries_of(config, &key) {
        return Ok(AutoCapture { entries, seconds: None });
    }
    // Of several bakes at once one captures.
    let _making = cache.make(&key, cancel)?;
    if let Some(entries) = entries_of(config, &key) {
        return Ok(AutoCapture { entries, seconds: None });
    }
    let started = Instant::now();
    let inputs = read_level_and_sky(config, TextureNeeds::All)?;
    let paths = Paths::new(&inputs.scene, inputs.distant.as_ref(), config.settings.capture_path());
    let failed = |error: std::io::Error| Fault::System(format!("{}: {error}", std::env::temp_dir().display()));
    let folder = tempfile::Builder::new().prefix("gdibl-").tempdir().map_err(failed)?;
    let positions = match cache.get(&key).and_then(|bytes| positions_of(&bytes)) {
        Some(positions) => positions,
        None => {
            let places = places(&inputs.scene, &paths, &config.settings.capture, folder.path(), cancel, shown)?;
            let positions: Vec<DVec3> = places.into_iter().map(|place| place.position).collect();
            cache.put(&key, &positions_to_bytes(&positions));
            positions
        }
    };
    let pixels = (settings.width * (settings.width / 2) * positions.len()) as u64;
    let progress = Progress::new("pixels", pixels, shown);
    let control = Control { cancel, progress: &|pixels, rays| progress.advance(pixels, rays), blocks: None };
    let mut entries = Vec::new();
    for (index, &position) in positions.iter().enumerate() {
        let name = name_of(&key, index);
        let bytes = match cache.get(&name) {
            Some(bytes) => bytes,
            None => {
                let captured = capture(&paths, position, index as u64, &settings, &control);
                let captured = captured.map_err(|_| Fault::Interrupted)?;
                let place = Place { position, file: folder.path().join("probe.exr") };
                write(&place, &captured, Mapping::LatLong)?;
                let bytes = std::fs::read(&place.file).map_err(failed)?;
                cache.put(&name, &bytes);
                bytes
            }
        };
        entries.push(entry_of(config, index, positions.len(), bytes));
    }
    progress.finish();
    Ok(AutoCapture { entries, seconds: Some(started.elapsed().as_secs_f64()) })
}

/// All probes of a key; `None` where one is missing or damaged.
fn entries_of(config: &Config, key: &str) -> Option<Vec<ProbeEntry>> {
    let count = positions_of(&config.cache.get(key)?)?.len();
    let entry = |index| Some(entry_of(config, index, count, config.cache.get(&name_of(key, index))?));
    (0..count).map(entry).collect()
}

fn name_of(key: &str, index: usize) -> String {
    format!("{key}-{index}")
}

/// A probe by the bytes of its file, which lies nowhere.
fn entry_of(config: &Config, index: usize, count: usize, bytes: Vec<u8>) -> ProbeEntry {
    let digits = count.saturating_sub(1).to_string().len();
    let image = PathBuf::from(format!("captured probes/probe_{index:0digits$}.exr"));
    config.files.insert(&image, bytes);
    ProbeEntry { image, ..ProbeEntry::default() }
}

fn positions_to_bytes(positions: &[DVec3]) -> Vec<u8> {
    positions.iter().flat_map(|position| position.to_array()).flat_map(f64::to_le_bytes).collect()
}

fn positions_of(bytes: &[u8]) -> Option<Vec<DVec3>> {
    let (numbers, []) = bytes.as_chunks::<8>() else { return None };
    let numbers: Vec<f64> = numbers.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
    let (positions, []) = numbers.as_chunks::<3>() else { return None };
    Some(positions.iter().copied().map(DVec3::from).collect())
}

/// Hexadecimal digits of a key.
const KEY_DIGITS: usize = 32;

/// A hash of all that captured probes depend on.
fn content_key(config: &Config, settings: &CaptureSettings) -> Result<String, Fault> {
    let mut hasher = blake3::Hasher::new();
    // Each part with its length, so that no two lists of parts look alike.
    let mut part = |bytes: &[u8]| {
        hasher.update(&(bytes.len() as u64).to_le_bytes());
        hasher.update(bytes);
    };
    part(format!("{} {}", PROGRAM.join(" "), env!("GDIBL_SOURCE")).as_bytes());
    for input in inputs_of(config, &[])? {
        part(input.role.as_bytes());
        part(&input.blake3);
    }
    if let Some(distant) = &config.distant {
        let ProbeEntry { image, rotation, yaw, exposure_stops, mapping, layer, .. } = distant;
        let constant = matches!(sky_source(image)?, SkySource::Constant(_)).then_some(image);
        part(format!("{constant:?} {rotation:?} {yaw:?} {exposure_stops:?} {mapping:?} {layer:?}").as_bytes());
    }
    let asked = &config.settings.capture;
    let path = config.settings.capture_path();
    part(format!("{settings:?} {path:?} {:?} {:?}", asked.positions, asked.most).as_bytes());
    let read = config.settings.gltf(TextureNeeds::All);
    part(format!("{:?} {read:?}", config.settings.quality.repair_pixels).as_bytes());
    Ok(hasher.finalize().to_hex()[..KEY_DIGITS].to_string())
}
