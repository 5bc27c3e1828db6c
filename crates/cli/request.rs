//! All that was asked for in a bake, as names and values: two requests that are equal give the same bytes.

use gdibl_baker::import::gltf::{Named, named_by};
use gdibl_baker::job::records::InputRecord;
use gdibl_baker::job::{NodeKind, ROWS, Row, Settings};
use serde::{Deserialize, Serialize};
use std::path::Path;

use crate::config::{Config, ProbeEntry};
use crate::fault::Fault;
use crate::hashes::inputs_of;
use crate::inputs::{PROGRAM, probe_entries};

/// The setting that a file says as it came out.
pub const PRECISION: &str = "quality.precision";

/// Names and values. Paths are not among them: a level may lie anywhere.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Request(Vec<(String, String)>);

impl Request {
    /// Reads all inputs, and parses none but the level's table of contents. `is_given`: a setting was given for this very run.
    pub fn of(config: &Config, no_capture: bool, is_given: impl Fn(&Row) -> bool) -> Result<Request, Fault> {
        let Named { probe_markers, volume_markers, .. } = named_by(config.files.as_ref(), &config.level)?;
        let probes = probe_entries(config, &probe_markers)?;
        let inputs = inputs_of(config, &probes)?;
        let mut all = vec![("the program".into(), PROGRAM.join(" ") + " " + env!("GDIBL_SOURCE"))];
        for InputRecord { role, name, blake3, .. } in inputs {
            all.push((format!("the {role} {name}"), hex(&blake3)));
        }
        let settings = config.settings.recorded();
        all.extend(settings.into_iter().map(|(name, value)| (name, value.unwrap_or("not set".into()))));
        for (number, probe) in probes.iter().enumerate() {
            all.push((format!("how probe {number} stands"), placement(probe)));
        }
        let asked = &config.settings.capture;
        let sky = config.distant.as_ref().map_or("none".into(), |sky| {
            // A sky without a file is its numbers.
            let constant = if sky.image.is_file() { "" } else { &*sky.image.to_string_lossy() };
            format!("{constant} {}", placement(sky))
        });
        all.push(("the distant panorama".into(), sky));
        all.push(("captured probes".into(), format!("{asked:?}, none: {no_capture}")));
        // It is not recorded: the file says how many nodes came of it.
        all.extend(config.settings.grid.budget.map(|seconds| ("grid.budget".into(), format!("{seconds:?}"))));
        // A flag wins over the setting of a box also where it says what is the default.
        let of_boxes = volume_markers.iter().flat_map(|marker| &marker.settings);
        let overruled = ROWS.iter().filter(|row| row.is_of_volumes() && is_given(row));
        let overruled = overruled.filter(|row| of_boxes.clone().any(|(name, _)| name == row.name));
        all.extend(overruled.map(|row| (row.full_name(), "wins over those of boxes".into())));
        Ok(Request(all))
    }

    /// That of one volume of a level that places several, which has settings of its own.
    pub fn of_volume(&self, name: &str, settings: &Settings) -> Request {
        let own = settings.recorded().into_iter().map(|(name, value)| (name, value.unwrap_or("not set".into())));
        Request(self.0.iter().cloned().chain(own).chain([("the volume".into(), name.into())]).collect())
    }

    /// An equal one is another with the same inputs and settings. Not so where points come from standard input.
    pub fn is_repeatable(config: &Config) -> bool {
        !matches!(&config.settings.grid.nodes, NodeKind::Points(path) if path == Path::new("-"))
    }

    /// BLAKE3 of names and values, but the precision of the file: its record says the one in force, and asking for that gives the same
    /// bytes as asking for the default that it follows from.
    pub fn key(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        // Each part with its length, so that no two lists of parts look alike.
        for part in self.0.iter().filter(|(name, _)| name != PRECISION).flat_map(|(name, value)| [name, value]) {
            hasher.update(&(part.len() as u64).to_le_bytes());
            hasher.update(part.as_bytes());
        }
        *hasher.finalize().as_bytes()
    }

    /// The first thing in which another one differs.
    pub fn difference(&self, other: &Request) -> String {
        let is_in = |all: &Request, entry: &(String, String)| all.0.contains(entry);
        let differing = self.0.iter().find(|entry| !is_in(other, entry)).or(other.0.iter().find(|e| !is_in(self, e)));
        differing.map_or("the order of its inputs".into(), |(name, _)| name.clone())
    }
}

fn placement(probe: &ProbeEntry) -> String {
    let ProbeEntry { image: _, position, rotation, exposure_stops, mapping, layer, yaw } = probe;
    format!("{position:?} {rotation:?} {exposure_stops:?} {mapping:?} {layer:?} {yaw:?}")
}

pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
