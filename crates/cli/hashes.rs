//! What was read, for the record of a volume: names, sizes and BLAKE3 hashes.

use gdibl_baker::import::gltf::named_by;
use gdibl_baker::job::NodeKind;
use gdibl_baker::job::records::InputRecord;
use std::path::{Path, PathBuf};

use crate::config::{Config, ProbeEntry};
use crate::fault::Fault;

/// All files that a bake reads: of a level also those that it refers to.
pub fn inputs_of(config: &Config, probes: &[ProbeEntry]) -> Result<Vec<InputRecord>, Fault> {
    let mut files: Vec<(&str, PathBuf)> = Vec::new();
    let environment = config.environment.iter().map(|level| ("environment", level));
    for (role, level) in [("level", &config.level)].into_iter().chain(environment) {
        files.push((role, level.clone()));
        files.extend(named_by(config.files.as_ref(), level)?.files.into_iter().map(|file| (role, file)));
    }
    files.extend(config.distant.iter().map(|distant| ("distant", distant.image.clone())));
    files.extend(probes.iter().map(|probe| ("probe", probe.image.clone())));
    if let NodeKind::Points(places) = &config.settings.grid.nodes
        && places != Path::new("-")
    {
        files.push(("points", places.clone()));
    }
    let record =
        |(role, path): &(&str, PathBuf)| config.files.record(role, path).map_err(|error| Fault::reading(path, &error));
    files.iter().filter(|(_, path)| path.is_file()).map(record).collect()
}
