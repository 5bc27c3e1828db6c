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
use crate::inputs::{images_of, read_level_and_sky, read_probes};
use crate::progress::Progress;
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
    quiet: bool,
) -> Result<Vec<Place>, Fault> {
    let positions: Vec<DVec3> = if asked.positions.is_empty() {
        let placement = automatic_placement(scene, paths, asked, cancel, quiet)?;
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
    quiet: bool,
) -> Result<Placement, Fault> {
    let settings = PlaceSettings { most: asked.most.unwrap_or(PlaceSettings::default().most), ..Default::default() };
    match box_of_probes(scene) {
        None => Ok(Placement::default()),
        Some(bounds) => place(paths, bounds, &[], &settings, cancel, quiet),
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
    quiet: bool,
) -> Result<Placement, Fault> {
    let progress = Progress::new("places", FREE_PLACES as u64, quiet);
    let control = Control { cancel, progress: &|places, rays| progress.advance(places, rays) };
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
    quiet: bool,
) -> Result<Vec<CapturedProbe>, Fault> {
    let pixels = (settings.width * (settings.width / 2) * places.len()) as u64;
    let progress = Progress::new("pixels", pixels, quiet);
    let control = Control { cancel, progress: &|pixels, rays| progress.advance(pixels, rays) };
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
pub fn capture_missing(config: &Config, inputs: &mut Inputs, cancel: &AtomicBool, quiet: bool) -> Result<(), Fault> {
    let captured = auto_capture(config, cancel, quiet)?;
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
            captured.folder.display()
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
    folder: PathBuf,
    /// What it cost; `None`: they were there already.
    seconds: Option<f64>,
}

/// Captures probes into a folder beside the volume that a bake writes, or finds them there from an earlier run with the
/// same level, light and settings. The folder's name is the hash of all these, so what lies in it is never out of date.
fn auto_capture(config: &Config, cancel: &AtomicBool, quiet: bool) -> Result<AutoCapture, Fault> {
    // Reflected light alone: emission is taken from the level's materials.
    let width = config.settings.capture.width.unwrap_or(AUTO_WIDTH);
    let settings = CaptureSettings { emission: false, width, ..config.settings.capture_probes() };
    let parent = config.output.with_extension("captured");
    let folder = parent.join(content_key(config, &settings)?);
    if folder.is_dir() {
        return Ok(AutoCapture { entries: entries_of(&folder)?, folder, seconds: None });
    }
    let started = Instant::now();
    let inputs = read_level_and_sky(config, TextureNeeds::All)?;
    let paths = Paths::new(&inputs.scene, inputs.distant.as_ref(), config.settings.capture_path());
    let writing = |error: std::io::Error| Fault::writing(&parent, &error);
    std::fs::create_dir_all(&parent).map_err(writing)?;
    // Filled beside, then renamed: a folder that is there is whole.
    let filling = tempfile::Builder::new().prefix(".filling-").tempdir_in(&parent).map_err(writing)?;
    let places = match places(&inputs.scene, &paths, &config.settings.capture, filling.path(), cancel, quiet) {
        Ok(places) => places,
        Err(fault) => {
            drop(filling);
            let _ = std::fs::remove_dir(&parent); // if it holds nothing else
            return Err(fault);
        }
    };
    if places.is_empty() {
        drop(filling);
        let _ = std::fs::remove_dir(&parent); // if it holds nothing else
        return Ok(AutoCapture { entries: Vec::new(), folder, seconds: None });
    }
    if let Err(fault) = capture_all(&paths, &places, Mapping::LatLong, &settings, cancel, quiet) {
        drop(filling);
        let _ = std::fs::remove_dir(&parent); // if it holds nothing else
        return Err(fault);
    }
    // What earlier levels or settings left.
    for entry in std::fs::read_dir(&parent).map_err(writing)?.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.len() == KEY_DIGITS && name.bytes().all(|b| b.is_ascii_hexdigit()) {
            std::fs::remove_dir_all(entry.path()).map_err(writing)?;
        }
    }
    std::fs::rename(filling.keep(), &folder).map_err(writing)?;
    Ok(AutoCapture { entries: entries_of(&folder)?, folder, seconds: Some(started.elapsed().as_secs_f64()) })
}

fn entries_of(folder: &Path) -> Result<Vec<ProbeEntry>, Fault> {
    let images = images_of(folder)?;
    Ok(images.into_iter().map(|image| ProbeEntry { image, ..ProbeEntry::default() }).collect())
}

/// Hexadecimal digits of a folder's name.
const KEY_DIGITS: usize = 16;

/// A hash of all that captured probes depend on.
fn content_key(config: &Config, settings: &CaptureSettings) -> Result<String, Fault> {
    let mut hasher = blake3::Hasher::new();
    // Each part with its length, so that no two lists of parts look alike.
    let mut part = |bytes: &[u8]| {
        hasher.update(&(bytes.len() as u64).to_le_bytes());
        hasher.update(bytes);
    };
    part(concat!("gdibl ", env!("CARGO_PKG_VERSION")).as_bytes());
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
