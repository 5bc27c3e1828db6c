//! Reads what a [`Config`] names: level, probes, distant panorama, places.

use glam::{DQuat, DVec3, Quat, Vec3};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use gdibl_baker::Finding;
use gdibl_baker::import::files::Files;
use gdibl_baker::import::gltf::{TextureNeeds, read_level_from};
use gdibl_baker::import::image::{Imported, ReadOptions, is_image, read_image_from};
use gdibl_baker::import::sky::{SkyOptions, read_sky_from};
use gdibl_baker::job::{Inputs, Memory, Method, NodeKind, Settings};
use gdibl_baker::panorama::{Mapping, Panorama, to_lat_long};
use gdibl_baker::radiance::gdibl::Probe;
use gdibl_baker::radiance::path::specular_left_out;
use gdibl_baker::scene::ProbeMarker;

use crate::config::{Config, ProbeEntry, file_name, sky_source};
use crate::fault::Fault;
use crate::hashes::inputs_of;

/// Who bakes: this program, and the commit of its source where that is known.
pub const PROGRAM: [&str; 2] = [
    concat!("gdibl ", env!("CARGO_PKG_VERSION")),
    match option_env!("GDIBL_COMMIT") {
        Some(commit) => commit,
        None => "",
    },
];

/// Level, distant panorama, places, and the probes that are named.
pub fn read_inputs(config: &Config, textures: TextureNeeds) -> Result<Inputs, Fault> {
    let mut inputs = read_level_and_sky(config, textures)?;
    let entries = probe_entries(config, &inputs.scene.probe_markers)?;
    read_probes(&mut inputs, &entries, config)?;
    if let NodeKind::Points(path) = &config.settings.grid.nodes {
        inputs.places = read_places(config.files.as_ref(), path)?.positions;
    }
    inputs.files = inputs_of(config, &entries)?;
    Ok(inputs)
}

/// Level and distant panorama alone.
pub fn read_level_and_sky(config: &Config, textures: TextureNeeds) -> Result<Inputs, Fault> {
    let options = config.settings.gltf(textures);
    let by_probes = config.settings.quality.method != Method::Path && config.names_probes();
    let mut left_out = None;
    let mut scene = match read_level_from(config.files.as_ref(), &config.level, &options) {
        // Probes light the level without its colours, too.
        Err(error) if by_probes && textures == TextureNeeds::All => {
            left_out = Some(error.to_string());
            read_level_from(config.files.as_ref(), &config.level, &config.settings.gltf(TextureNeeds::Gdibl))?
        }
        read => read?,
    };
    let mut findings = std::mem::take(&mut scene.findings);
    findings.extend(left_out.map(|why| {
        let message = format!("not all materials could be read, so what no probe sees is filled and not traced: {why}");
        Finding::new("materials-left-out", 1, message)
    }));
    if let Some(path) = &config.environment {
        let proxy = read_level_from(config.files.as_ref(), path, &options)?;
        findings.extend(proxy.findings.iter().cloned());
        scene.replace_environment(proxy);
    }
    if textures == TextureNeeds::All {
        // Who needs all textures traces paths.
        findings.extend(specular_left_out(&scene));
    }
    let level = config.level.display().to_string();
    let mut inputs = Inputs { findings, level, program: PROGRAM.map(String::from), ..Inputs::new(scene) };
    if let Some(entry) = &config.distant {
        let options = SkyOptions {
            read: read_options(entry, config),
            mapping: mapping_of(entry)?,
            rotation: entry.rotation.map(DQuat::from_array),
            yaw_degrees: entry.yaw,
            exposure_stops: entry.exposure_stops,
        };
        let (distant, findings) = read_sky_from(config.files.as_ref(), &sky_source(&entry.image)?, &options)?;
        inputs.findings.extend(findings);
        inputs.distant = Some(distant);
    }
    Ok(inputs)
}

/// Takes the probes of these files.
pub fn read_probes(inputs: &mut Inputs, entries: &[ProbeEntry], config: &Config) -> Result<(), Fault> {
    for entry in entries {
        let (imported, panorama) = read_panorama(entry, config)?;
        inputs.findings.extend(imported.findings.iter().cloned());
        let position = entry.position.map(DVec3::from).or(imported.pose.position);
        let Some(position) = position else {
            return Err(Fault::Invalid(format!(
                "{}: has no position: it holds neither gdibl:position nor worldToCamera; place it with a \
                 [[probe]] in a BAKE.toml",
                entry.image.display()
            )));
        };
        inputs.probes.push(Probe {
            name: file_name(&entry.image),
            position,
            rotation: rotation_of(entry, &imported)?,
            exposure_stops: entry.exposure_stops,
            panorama,
        });
    }
    Ok(())
}

/// Probes of BAKE.toml, of --probes, and, when neither names one, of the level's own nodes.
pub fn probe_entries(config: &Config, markers: &[ProbeMarker]) -> Result<Vec<ProbeEntry>, Fault> {
    let mut entries = config.placed_probes.clone();
    for path in &config.probes {
        for image in images_of(path)? {
            entries.push(ProbeEntry { image, layer: config.layer.clone(), ..ProbeEntry::default() });
        }
    }
    if entries.is_empty() {
        entries.extend(markers.iter().map(|marker| ProbeEntry {
            image: marker.image.clone(),
            position: Some(marker.position.into()),
            rotation: Some(marker.rotation.into()),
            ..ProbeEntry::default()
        }));
    }
    Ok(entries)
}

/// A file, or the images of a folder by name.
pub fn images_of(path: &Path) -> Result<Vec<PathBuf>, Fault> {
    if !path.is_dir() {
        return Ok(vec![path.to_path_buf()]);
    }
    let failed = |error| Fault::reading(path, &error);
    let mut images = Vec::new();
    for entry in std::fs::read_dir(path).map_err(failed)? {
        let file = entry.map_err(failed)?.path();
        let extension = file.extension().unwrap_or_default().to_ascii_lowercase();
        if extension == "exr" || extension == "hdr" || (file.is_file() && is_image(&file)?) {
            images.push(file);
        }
    }
    images.sort();
    if images.is_empty() {
        return Err(Fault::Invalid(format!("{}: this folder holds no EXR or HDR image", path.display())));
    }
    Ok(images)
}

fn read_options(entry: &ProbeEntry, config: &Config) -> ReadOptions {
    ReadOptions { repair_pixels: config.settings.quality.repair_pixels, layer: entry.layer.clone() }
}

fn mapping_of(entry: &ProbeEntry) -> Result<Option<Mapping>, Fault> {
    let Some(name) = &entry.mapping else { return Ok(None) };
    let mapping = Mapping::parse(name).ok_or_else(|| {
        let names = Mapping::ALL.map(Mapping::name).join(", ");
        Fault::Usage(format!("{}: no mapping is called '{name}'; there are {names}", entry.image.display()))
    })?;
    Ok(Some(mapping))
}

fn read_panorama(entry: &ProbeEntry, config: &Config) -> Result<(Imported, Panorama), Fault> {
    let imported = read_image_from(config.files.as_ref(), &entry.image, &read_options(entry, config))?;
    let mapping = imported.layout(&entry.image, mapping_of(entry)?)?;
    let panorama = to_lat_long(&imported.image, mapping, None);
    Ok((imported, panorama))
}

fn rotation_of(entry: &ProbeEntry, imported: &Imported) -> Result<Quat, Fault> {
    let rotation = entry.rotation.map(DQuat::from_array).or(imported.pose.rotation).unwrap_or(DQuat::IDENTITY);
    let length = rotation.length();
    if !(length.is_finite() && length > 1e-6) {
        return Err(Fault::Invalid(format!(
            "{}: rotation {rotation:?}: expected a quaternion x y z w of length 1",
            entry.image.display()
        )));
    }
    let yaw = DQuat::from_rotation_y(entry.yaw.to_radians());
    Ok((yaw * rotation.normalize()).normalize().as_quat())
}

/// Rows of a CSV of places.
pub struct Places {
    pub positions: Vec<DVec3>,
    /// Empty, or one per position.
    pub normals: Vec<Vec3>,
}

impl Places {
    /// The normal of a place; +Y where the file has none.
    pub fn normal(&self, index: usize) -> [f32; 3] {
        self.normals.get(index).map_or([0.0, 1.0, 0.0], |n| n.to_array())
    }
}

/// Reads `x,y,z[,nx,ny,nz]`, further columns ignored, a header line allowed. `-` is standard input.
pub fn read_places(files: &dyn Files, path: &Path) -> Result<Places, Fault> {
    let bytes = if path == Path::new("-") {
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut std::io::stdin(), &mut bytes).map(|_| Arc::new(bytes))
    } else {
        files.read(path)
    };
    let bytes = bytes.map_err(|error| Fault::reading(path, &error))?;
    let mut reader =
        csv::ReaderBuilder::new().has_headers(false).flexible(true).trim(csv::Trim::All).from_reader(&bytes[..]);
    let mut places = Places { positions: Vec::new(), normals: Vec::new() };
    for (index, record) in reader.records().enumerate() {
        let line = index + 1;
        let invalid = |message: String| Fault::Invalid(format!("{}, line {line}: {message}", path.display()));
        let record = record.map_err(|error| invalid(error.to_string()))?;
        let numbers: Result<Vec<f64>, _> = record.iter().take(6).map(|field| field.parse::<f64>()).collect();
        let numbers = match numbers {
            Ok(numbers) => numbers,
            // Column names.
            Err(_) if index == 0 && record.iter().all(|field| field.parse::<f64>().is_err()) => continue,
            Err(_) => return Err(invalid(format!("expected numbers x,y,z[,nx,ny,nz], found '{}'", record.as_slice()))),
        };
        if numbers.iter().any(|n| !n.is_finite()) {
            return Err(invalid("a number is not finite".into()));
        }
        match numbers[..] {
            [x, y, z] if places.normals.is_empty() => places.positions.push(DVec3::new(x, y, z)),
            [x, y, z, nx, ny, nz] if places.normals.len() == places.positions.len() => {
                let normal =
                    DVec3::new(nx, ny, nz).try_normalize().ok_or_else(|| invalid("the normal has no length".into()))?;
                places.positions.push(DVec3::new(x, y, z));
                places.normals.push(normal.as_vec3());
            }
            _ => return Err(invalid(format!("{} columns; expected 3 or 6, the same in all lines", numbers.len()))),
        }
    }
    if places.positions.is_empty() {
        return Err(Fault::Invalid(format!("{}: holds no place; expected lines of x,y,z[,nx,ny,nz]", path.display())));
    }
    Ok(places)
}

/// What a bake may take: what was asked for, or what the machine has free.
pub fn memory_of(settings: &Settings) -> Memory {
    match settings.quality.max_memory {
        Some(gib) => Memory { bytes: gib * f64::from(1 << 30), is_asked: true, is_paged: true },
        None => Memory { bytes: memory_available().unwrap_or(f64::INFINITY), is_asked: false, is_paged: true },
    }
}

/// Bytes that can still be taken without swapping; `None` where the system does not tell.
fn memory_available() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok().map(|kilobytes| kilobytes * 1024.0)
}
