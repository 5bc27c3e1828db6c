//! Finished bakes of a study, beside its page until that is written: a study that was stopped or killed goes on from them.
//!
//! One file, OUT.measured: a line that names the study, then for each bake a line of JSON and the bytes of its volume. What a kill cut
//! off at the end is measured again.

use std::collections::HashMap;
use std::fs::{File, OpenOptions};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use gdibl_baker::analyse::study::{Cost, Repeat, Seen};
use gdibl_runtime::Volume;
use serde::{Deserialize, Serialize};

use crate::fault::Fault;

/// The bakes so far.
pub struct Kept {
    path: PathBuf,
    /// `None`: nothing is kept.
    file: Option<File>,
    /// By method, directions and seed.
    known: HashMap<Name, Repeat>,
}

type Name = (String, u64, u64);

/// What stands before the bytes of a volume.
#[derive(Serialize, Deserialize)]
struct Entry {
    method: String,
    samples: u64,
    seed: u64,
    /// Of the volume that follows.
    length: usize,
    wall_seconds: f64,
    cpu_seconds: f64,
    setup_seconds: f64,
    rays: u64,
    directions: u64,
    /// Median and 95th percentile.
    seen: Option<[f64; 2]>,
    bytes: u64,
}

impl Kept {
    /// Nothing is known, and nothing kept.
    pub fn nothing() -> Kept {
        Kept { path: PathBuf::new(), file: None, known: HashMap::new() }
    }

    /// What another run of the study with this key has finished. A file of another study is begun anew.
    pub fn open(path: &Path, key: &str) -> Result<Kept, Fault> {
        let head = format!("gdibl study {key}\n");
        let bytes = std::fs::read(path).unwrap_or_default();
        let (mut known, mut whole) = (HashMap::new(), 0);
        if bytes.starts_with(head.as_bytes()) {
            whole = head.len();
            while let Some((name, repeat, length)) = next(&bytes[whole..]) {
                known.insert(name, repeat);
                whole += length;
            }
        }
        let fault = |error: std::io::Error| Fault::System(format!("{}: {error}", path.display()));
        let mut file = OpenOptions::new().create(true).truncate(false).write(true).open(path).map_err(fault)?;
        if whole == 0 {
            file.set_len(0).and_then(|()| file.write_all(head.as_bytes())).map_err(fault)?;
        } else {
            // What was cut off goes.
            file.set_len(whole as u64).and_then(|()| file.seek(SeekFrom::End(0)).map(|_| ())).map_err(fault)?;
        }
        Ok(Kept { path: path.into(), file: Some(file), known })
    }

    /// How many are known.
    pub fn len(&self) -> usize {
        self.known.len()
    }

    /// One that is known.
    pub fn get(&self, method: &str, samples: u64, seed: u64) -> Option<Repeat> {
        self.known.get(&(method.to_string(), samples, seed)).cloned()
    }

    /// Keeps one; `volume` are the bytes of its volume. A full disk must not end a study.
    pub fn put(&mut self, method: &str, samples: u64, seed: u64, repeat: &Repeat, volume: &[u8]) {
        let Some(file) = &mut self.file else { return };
        let Cost { wall_seconds, cpu_seconds, setup_seconds, rays, samples: directions } = repeat.cost;
        let entry = Entry {
            method: method.into(),
            samples,
            seed,
            length: volume.len(),
            wall_seconds,
            cpu_seconds,
            setup_seconds,
            rays,
            directions,
            seen: repeat.seen.map(|seen| [seen.median, seen.p95]),
            bytes: repeat.bytes,
        };
        let line = serde_json::to_string(&entry).expect("plain data") + "\n";
        if file.write_all(&[line.as_bytes(), volume].concat()).is_err() {
            self.file = None;
        }
    }

    /// The page is written.
    pub fn remove(self) {
        if !self.path.as_os_str().is_empty() {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// The first bake in these bytes, and how many it takes; `None` where it is not whole.
fn next(bytes: &[u8]) -> Option<(Name, Repeat, usize)> {
    let end = bytes.iter().position(|byte| *byte == b'\n')?;
    let entry: Entry = serde_json::from_slice(&bytes[..end]).ok()?;
    let volume = bytes[end + 1..].get(..entry.length)?;
    let Entry { method, samples, seed, length, wall_seconds, cpu_seconds, setup_seconds, rays, directions, .. } = entry;
    let cost = Cost { wall_seconds, cpu_seconds, setup_seconds, rays, samples: directions };
    let seen = entry.seen.map(|[median, p95]| Seen { median, p95 });
    let repeat = Repeat { volume: Volume::parse(volume).ok()?, cost, seen, bytes: entry.bytes };
    Some(((method, samples, seed), repeat, end + 1 + length))
}
