//! Reads what a [`Config`] names: level, probes, distant panorama, places.

use glam::{DQuat, DVec3, Quat, Vec3};
use std::path::{Path, PathBuf};

use gdibl_baker::Finding;
use gdibl_baker::bake::{Nodes, grid_of_cells, grid_of_counts, grid_of_spacing};
use gdibl_baker::import::gltf::{GltfOptions, TextureNeeds, read_level};
use gdibl_baker::import::image::{Imported, ReadOptions, read_image};
use gdibl_baker::panorama::{Mapping, Panorama, Sun, to_lat_long};
use gdibl_baker::radiance::Distant;
use gdibl_baker::radiance::exposure::{ExposureMatch, match_exposure};
use gdibl_baker::radiance::gdibl::Probe;
use gdibl_baker::radiance::path::specular_left_out;
use gdibl_baker::scene::{Mesh, Role, Scene};

use crate::commands::file_name;
use crate::config::{Config, GridFlags, Method, NodeKind, ProbeEntry};
use crate::fault::Fault;

/// Nodes along the longest axis when nothing is said.
const DEFAULT_NODES: f64 = 32.0;

/// Everything that a bake or a picture reads.
pub struct Inputs {
    pub scene: Scene,
    pub probes: Vec<Probe>,
    pub distant: Option<Distant>,
    pub findings: Vec<Finding>,
    /// The probes were captured from the level for want of others, and show reflected light alone.
    pub captured: bool,
    /// How exposures were matched; `None`: they are as given.
    pub exposure: Option<ExposureMatch>,
}

impl Inputs {
    /// Level, distant panorama, and the probes that are named, their exposures matched where that is asked for.
    pub fn read(config: &Config, textures: TextureNeeds) -> Result<Inputs, Fault> {
        let mut inputs = Inputs::read_level(config, textures)?;
        let entries = probe_entries(config, &inputs.scene)?;
        inputs.read_probes(&entries, config)?;
        let has_use = config.quality.method.unwrap_or_default() == Method::Gdibl;
        if has_use && config.quality.match_exposure == Some(true) {
            let matched = match_exposure(&inputs.scene, &inputs.probes);
            matched.apply(&mut inputs.probes);
            inputs.findings.extend(matched.findings());
            inputs.exposure = Some(matched);
        }
        Ok(inputs)
    }

    /// Level and distant panorama alone.
    pub fn read_level(config: &Config, textures: TextureNeeds) -> Result<Inputs, Fault> {
        let options = GltfOptions { textures, ..GltfOptions::default() };
        let by_probes = config.quality.method.unwrap_or_default() == Method::Gdibl && !config.names_no_probe();
        let mut left_out = None;
        let mut scene = match read_level(&config.level, &options) {
            // Probes light the level without its colours, too.
            Err(error) if by_probes && textures == TextureNeeds::All => {
                left_out = Some(error.to_string());
                read_level(&config.level, &GltfOptions::default())?
            }
            read => read?,
        };
        let mut findings = std::mem::take(&mut scene.findings);
        findings.extend(left_out.map(|why| {
            let message =
                format!("not all materials could be read, so what no probe sees is filled and not traced: {why}");
            Finding::new("materials-left-out", 1, message)
        }));
        if let Some(path) = &config.environment {
            let proxy = read_level(path, &options)?;
            findings.extend(proxy.findings.iter().cloned());
            scene.replace_environment(proxy);
        }
        if textures == TextureNeeds::All {
            // Who needs all textures traces paths.
            findings.extend(specular_left_out(&scene));
        }
        let mut inputs = Inputs { scene, probes: Vec::new(), distant: None, findings, captured: false, exposure: None };
        if let Some(entry) = &config.distant {
            let (imported, panorama) = read_panorama(entry, config)?;
            inputs.findings.extend(imported.findings.iter().cloned());
            inputs.distant = Some(Distant {
                name: file_name(&entry.image),
                rotation: rotation_of(entry, &imported)?,
                exposure_stops: entry.exposure_stops,
                panorama,
                without_sun: None,
            });
        }
        Ok(inputs)
    }

    /// Takes the probes of these files.
    pub fn read_probes(&mut self, entries: &[ProbeEntry], config: &Config) -> Result<(), Fault> {
        for entry in entries {
            let (imported, panorama) = read_panorama(entry, config)?;
            self.findings.extend(imported.findings.iter().cloned());
            let position = entry.position.map(DVec3::from).or(imported.pose.position);
            let Some(position) = position else {
                return Err(Fault::Invalid(format!(
                    "{}: has no position: it holds neither gdibl:position nor worldToCamera; place it with a \
                     [[probe]] in a BAKE.toml",
                    entry.image.display()
                )));
            };
            self.probes.push(Probe {
                name: file_name(&entry.image),
                position,
                rotation: rotation_of(entry, &imported)?,
                exposure_stops: entry.exposure_stops,
                panorama,
            });
        }
        Ok(())
    }

    /// Takes the sun out of what nodes see of the distant panorama; `None`, with a finding, where no sun stands out.
    pub fn extract_sun(&mut self) -> Result<Option<Sun>, Fault> {
        let Some(distant) = &mut self.distant else {
            return Err(Fault::Usage(
                "--sun extract: takes a sun out of the distant panorama; give --distant IMAGE".into(),
            ));
        };
        let sun = distant.extract_sun();
        if sun.is_none() {
            let message = format!("{}: --sun extract finds no sun in it, and takes nothing out", distant.name);
            self.findings.push(Finding::new("no-sun", 1, message));
        }
        Ok(sun)
    }

    /// No probe was given, and there is something that one could see.
    pub fn lacks_probes(&self) -> bool {
        self.probes.is_empty() && self.scene.triangle_count(Role::Environment) > 0
    }

    /// Work without any light is refused.
    pub fn check_light(&self, config: &Config, method: Method) -> Result<(), Fault> {
        let probes = method == Method::Gdibl && !self.probes.is_empty();
        if probes || self.has_light() {
            return Ok(());
        }
        Err(Fault::Bound(format!(
            "{}: nothing gives light: no probe, no distant panorama, no emissive material, no light; give --probes or \
             --distant",
            config.level.display()
        )))
    }

    /// Something gives light that a path can find.
    pub fn has_light(&self) -> bool {
        let glows = |mesh: &Mesh| self.scene.materials[mesh.material as usize].emission != Vec3::ZERO;
        self.distant.is_some() || !self.scene.lights.is_empty() || self.scene.meshes.iter().any(glows)
    }

    /// Findings as lines on stderr.
    pub fn warn(&self) {
        for finding in &self.findings {
            eprintln!("gdibl: {}: {}", finding.id, finding.message);
        }
    }
}

/// Probes of BAKE.toml, of --probes, and, when neither names one, of the level's own nodes.
fn probe_entries(config: &Config, scene: &Scene) -> Result<Vec<ProbeEntry>, Fault> {
    let mut entries = config.placed_probes.clone();
    for path in &config.probes {
        for image in images_of(path)? {
            entries.push(ProbeEntry { image, ..ProbeEntry::default() });
        }
    }
    if entries.is_empty() {
        entries.extend(scene.probe_markers.iter().map(|marker| ProbeEntry {
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
        if extension == "exr" || extension == "hdr" {
            images.push(file);
        }
    }
    images.sort();
    if images.is_empty() {
        return Err(Fault::Invalid(format!("{}: this folder holds no .exr or .hdr file", path.display())));
    }
    Ok(images)
}

fn read_panorama(entry: &ProbeEntry, config: &Config) -> Result<(Imported, Panorama), Fault> {
    let options = ReadOptions { repair_pixels: config.quality.repair_pixels.unwrap_or(false) };
    let imported = read_image(&entry.image, &options)?;
    let mapping = match &entry.mapping {
        Some(name) => Mapping::parse(name).ok_or_else(|| {
            let names = Mapping::ALL.map(Mapping::name).join(", ");
            Fault::Usage(format!("{}: no mapping is called '{name}'; there are {names}", entry.image.display()))
        })?,
        None => imported.mapping.unwrap_or(Mapping::LatLong),
    };
    let (width, height) = (imported.image.width, imported.image.height);
    mapping.check_shape(width, height).map_err(|why| Fault::Invalid(format!("{}: {why}", entry.image.display())))?;
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
    Ok(rotation.normalize().as_quat())
}

/// The nodes that a configuration asks for.
pub fn nodes_of(config: &Config, scene: &Scene) -> Result<Nodes, Fault> {
    let flags = &config.grid;
    match flags.nodes.as_ref().unwrap_or(&NodeKind::Grid) {
        NodeKind::Grid => grid_of(config, scene),
        kind if flags.bounds.is_some()
            || flags.spacing.is_some()
            || flags.counts.is_some()
            || flags.tolerance.is_some() =>
        {
            Err(Fault::Usage(format!(
                "--bounds, --spacing, --counts and --tolerance belong to --nodes grid; here it is {kind:?}"
            )))
        }
        NodeKind::Vertices => {
            let nodes = Nodes::vertices_of(scene);
            if nodes.is_empty() {
                return Err(Fault::Invalid(format!("{}: has no vertices to bake", config.level.display())));
            }
            Ok(nodes)
        }
        NodeKind::Points(path) => Ok(Nodes::Points(read_places(path)?.positions)),
    }
}

fn grid_of(config: &Config, scene: &Scene) -> Result<Nodes, Fault> {
    let GridFlags { bounds, spacing, counts, tolerance, .. } = &config.grid;
    if let Some(tolerance) = tolerance.filter(|tolerance| !(*tolerance > 0.0 && tolerance.is_finite())) {
        return Err(Fault::Usage(format!("--tolerance {tolerance}: expected a positive share, 0.01 for 1 %")));
    }
    let marker = match &scene.volume_markers[..] {
        [] => None,
        _ if bounds.is_some() => None,
        [marker] => Some(marker),
        several => {
            return Err(Fault::Usage(format!(
                "{}: {} nodes carry gdibl_volume, and one bake makes one volume; choose a box with --bounds",
                config.level.display(),
                several.len()
            )));
        }
    };
    let (min, max) = match (bounds, marker) {
        (Some(numbers), _) => parse_bounds(numbers)?,
        (None, Some(marker)) => marker.bounds(),
        (None, None) => scene.bounds(|_| true).ok_or_else(|| {
            Fault::Usage(format!("{}: has no triangles, so no box; give --bounds", config.level.display()))
        })?,
    };
    let grid = match (counts, spacing.or(marker.map(|m| m.spacing))) {
        (Some(counts), _) => grid_of_counts(min, max, parse_counts(counts)?),
        (None, Some(spacing)) if spacing > 0.0 && spacing.is_finite() => grid_of_spacing(min, max, spacing),
        (None, Some(spacing)) => return Err(Fault::Usage(format!("--spacing {spacing}: expected metres above 0"))),
        (None, None) => grid_of_spacing(min, max, (max - min).max_element() / (DEFAULT_NODES - 1.0)),
    };
    let grid = if tolerance.is_some() { grid_of_cells(grid) } else { grid };
    let [x, y, z] = grid.counts;
    let nodes = f64::from(x) * f64::from(y) * f64::from(z);
    if nodes > f64::from(u32::MAX) {
        let gib = nodes * 324.0 / f64::from(1 << 30);
        return Err(Fault::System(format!(
            "a grid of {x} x {y} x {z} = {nodes:.3e} nodes would need about {gib:.1e} GiB; a volume holds at most 2^32 \
             nodes; use a larger --spacing or smaller --bounds"
        )));
    }
    Ok(Nodes::Grid(grid))
}

pub fn parse_bounds(numbers: &[f64]) -> Result<(DVec3, DVec3), Fault> {
    let &[x0, y0, z0, x1, y1, z1] = numbers else {
        return Err(Fault::Usage(format!("--bounds: {} numbers; expected x0,y0,z0,x1,y1,z1", numbers.len())));
    };
    let (min, max) = (DVec3::new(x0, y0, z0), DVec3::new(x1, y1, z1));
    if !(min.is_finite() && max.is_finite()) {
        return Err(Fault::Usage(format!("--bounds {min} to {max}: expected finite numbers")));
    }
    if !min.cmple(max).all() {
        return Err(Fault::Usage(format!(
            "--bounds {min} to {max}: the first corner must be the lower one on each axis"
        )));
    }
    Ok((min, max))
}

fn parse_counts(counts: &[u64]) -> Result<[u32; 3], Fault> {
    let [x, y, z] = counts else {
        return Err(Fault::Usage(format!("--counts: {} numbers; expected X,Y,Z", counts.len())));
    };
    let [x, y, z] = [x, y, z].map(|c| u32::try_from(*c).ok().filter(|c| *c > 0));
    match (x, y, z) {
        (Some(x), Some(y), Some(z)) => Ok([x, y, z]),
        _ => Err(Fault::Usage(format!(
            "--counts {counts:?}: an empty grid, or too many; expected 1 to {} each",
            u32::MAX
        ))),
    }
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
pub fn read_places(path: &Path) -> Result<Places, Fault> {
    let input: Box<dyn std::io::Read> = if path == Path::new("-") {
        Box::new(std::io::stdin())
    } else {
        Box::new(std::fs::File::open(path).map_err(|error| Fault::reading(path, &error))?)
    };
    let mut reader =
        csv::ReaderBuilder::new().has_headers(false).flexible(true).trim(csv::Trim::All).from_reader(input);
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
