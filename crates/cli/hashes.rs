//! What was read, for the record of a volume: names, sizes and BLAKE3 hashes.

use gdibl_baker::import::gltf::files_of;
use gdibl_baker::job::NodeKind;
use gdibl_baker::job::records::InputRecord;
use std::path::{Path, PathBuf};

use crate::config::{Config, ProbeEntry, file_name};
use crate::fault::Fault;

/// All files that a bake reads: of a level also those that it refers to.
pub fn inputs_of(config: &Config, probes: &[ProbeEntry]) -> Result<Vec<InputRecord>, Fault> {
    let mut files: Vec<(&str, PathBuf)> = Vec::new();
    let environment = config.environment.iter().map(|level| ("environment", level));
    for (role, level) in [("level", &config.level)].into_iter().chain(environment) {
        files.push((role, level.clone()));
        files.extend(files_of(level)?.into_iter().map(|file| (role, file)));
    }
    files.extend(config.distant.iter().map(|distant| ("distant", distant.image.clone())));
    files.extend(probes.iter().map(|probe| ("probe", probe.image.clone())));
    if let NodeKind::Points(places) = &config.settings.grid.nodes
        && places != Path::new("-")
    {
        files.push(("points", places.clone()));
    }
    files.iter().filter(|(_, path)| path.is_file()).map(|(role, path)| record(role, path)).collect()
}

/// Read piece by piece: panoramas are large.
fn record(role: &str, path: &Path) -> Result<InputRecord, Fault> {
    let failed = |error| Fault::reading(path, &error);
    let file = std::fs::File::open(path).map_err(failed)?;
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(file).map_err(failed)?;
    Ok(InputRecord {
        role: role.into(),
        name: file_name(path),
        bytes: hasher.count(),
        blake3: *hasher.finalize().as_bytes(),
    })
}
