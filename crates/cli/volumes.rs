//! The list of a level's volumes: `LEVEL.volumes.json`, beside their files. FORMAT.md tells what it holds.

use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

use gdibl_baker::job::Listed;
use gdibl_runtime::{Sample, Volume, VolumeSet};

use crate::fault::Fault;

/// What tells the file from other JSON.
const FORMAT: &str = "gdibl-volumes";
/// It grows by fields; a field that goes or changes makes a new one.
const VERSION: u32 = 1;
/// Corners of boxes are the same within this share: other writers of JSON may round.
const SAME: f64 = 1e-9;

/// All volumes of a level, the finest first.
#[derive(Debug, Serialize, Deserialize)]
pub struct VolumeList {
    format: String,
    version: u32,
    /// File name of the level.
    pub level: String,
    pub volumes: Vec<Entry>,
}

/// One of them.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Entry {
    /// Its file, beside the list.
    pub file: String,
    /// The name of the glTF node that places it.
    pub name: String,
    /// Lowest corner of its box, metres.
    pub min: [f64; 3],
    /// Highest corner.
    pub max: [f64; 3],
    /// Greatest distance between neighbouring nodes of its (finest) grid, metres.
    pub spacing: f64,
}

/// An entry of a list, with its file.
pub struct Listing {
    pub entry: Entry,
    pub path: PathBuf,
    pub bytes: Vec<u8>,
}

/// Whether bytes are a list, and not a volume or other JSON.
pub fn is_list(bytes: &[u8]) -> bool {
    #[derive(Deserialize)]
    struct Kind {
        format: String,
    }
    bytes.trim_ascii_start().starts_with(b"{")
        && serde_json::from_slice::<Kind>(bytes).is_ok_and(|kind| kind.format == FORMAT)
}

/// The file of a list, given the output of the bake.
pub fn list_path(output: &Path) -> PathBuf {
    output.with_extension("volumes.json")
}

impl VolumeList {
    /// Of the volumes of a level, in their order.
    pub fn of(level: String, volumes: &[Listed]) -> VolumeList {
        let entry = |Listed { name, min, max, spacing }: &Listed| Entry {
            file: format!("{name}.gdibl"),
            name: name.clone(),
            min: *min,
            max: *max,
            spacing: *spacing,
        };
        VolumeList { format: FORMAT.into(), version: VERSION, level, volumes: volumes.iter().map(entry).collect() }
    }

    /// As it is written.
    pub fn to_bytes(&self) -> Vec<u8> {
        (serde_json::to_string_pretty(self).expect("plain data") + "\n").into_bytes()
    }

    /// From the bytes of the file at `path`.
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<VolumeList, Fault> {
        #[derive(Deserialize)]
        struct Version {
            version: u32,
        }
        let invalid = |why: String| Fault::Invalid(format!("{}: {why}", path.display()));
        let wrong =
            |error: serde_json::Error| invalid(format!("{error}: expected a list of volumes as FORMAT.md has it"));
        let Version { version } = serde_json::from_slice(bytes).map_err(wrong)?;
        if version != VERSION {
            let path = path.display();
            return Err(Fault::Unsupported(format!("{path}: version: found {version}, this program reads {VERSION}")));
        }
        let list: VolumeList = serde_json::from_slice(bytes).map_err(wrong)?;
        match list.volumes.is_empty() {
            true => Err(invalid("volumes: found none, expected at least one".into())),
            false => Ok(list),
        }
    }

    /// Reads its files. `path` is that of the list.
    pub fn open(self, path: &Path) -> Result<Vec<Listing>, Fault> {
        let open = |entry: Entry| {
            let path = path.with_file_name(&entry.file);
            let bytes = std::fs::read(&path).map_err(|error| Fault::reading(&path, &error))?;
            Ok(Listing { entry, path, bytes })
        };
        self.volumes.into_iter().map(open).collect()
    }
}

impl Listing {
    /// The volume, in the box that the list tells.
    pub fn parse(&self) -> Result<Volume, Fault> {
        let Listing { entry, path, bytes } = self;
        let volume = Volume::parse(bytes).map_err(|error| Fault::of_volume(path, &error))?;
        let corners = [(entry.min, volume.header().min), (entry.max, volume.header().max)];
        let is_same = |(listed, found): &(f64, f64)| (listed - found).abs() <= SAME * (1.0 + found.abs());
        if !corners.iter().all(|(listed, found)| listed.iter().copied().zip(*found).all(|pair| is_same(&pair))) {
            return Err(Fault::Invalid(format!(
                "{}: its box is not that of '{}' in the list: found {:?} to {:?}, expected {:?} to {:?}; bake both again",
                path.display(),
                entry.name,
                corners[0].1,
                corners[1].1,
                entry.min,
                entry.max
            )));
        }
        Ok(volume)
    }
}

/// Several volumes put together. `path` is that of the list.
pub fn set_of(listings: &[Listing], path: &Path) -> Result<VolumeSet, Fault> {
    let volumes = listings.iter().map(|listing| Ok((listing.parse()?, listing.entry.spacing)));
    let volumes: Vec<(Volume, f64)> = volumes.collect::<Result<_, Fault>>()?;
    VolumeSet::new(volumes).map_err(|error| Fault::of_volume(path, &error))
}

/// One volume, or those of a list.
pub enum Light {
    Volume(Box<Volume>),
    Set(VolumeSet),
}

impl Light {
    /// From a volume's file, or from a list and the files that it names.
    pub fn read(path: &Path) -> Result<Light, Fault> {
        let bytes = std::fs::read(path).map_err(|error| Fault::reading(path, &error))?;
        if is_list(&bytes) {
            return Ok(Light::Set(set_of(&VolumeList::parse(path, &bytes)?.open(path)?, path)?));
        }
        let volume = Volume::parse(&bytes).map_err(|error| Fault::of_volume(path, &error))?;
        Ok(Light::Volume(Box::new(volume)))
    }

    pub fn sample_f64(&self, position: [f64; 3], normal: [f32; 3]) -> Sample {
        match self {
            Light::Volume(volume) => volume.sample_f64(position, normal),
            Light::Set(set) => set.sample_f64(position, normal),
        }
    }

    /// The most of any volume.
    pub fn bands(&self) -> u32 {
        match self {
            Light::Volume(volume) => volume.header().bands,
            Light::Set(set) => set.volumes().map(|volume| volume.header().bands).max().unwrap_or(0),
        }
    }

    /// Some volume is.
    pub fn is_deringed(&self) -> bool {
        match self {
            Light::Volume(volume) => volume.header().is_deringed(),
            Light::Set(set) => set.volumes().any(|volume| volume.header().is_deringed()),
        }
    }
}
