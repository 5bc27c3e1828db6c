//! What bakes have in common, in one folder for all of them: named by the hash of all that it depends on, and believed only where the
//! hash of its bytes is the one that was written with them.
//!
//! ```text
//! an entry   FOLDER/NAME.gdibl-cache: "GDIBLCA1"  BLAKE3 of the bytes: 32  bytes
//! a lock     FOLDER/NAME.lock: who makes the entry holds it
//! ```

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, SystemTime};

use gdibl_baker::pack::write_whole;

use crate::fault::Fault;
use crate::locks::open_locked;
use crate::say::say;

const MAGIC: &[u8; 8] = b"GDIBLCA1";
const SUFFIX: &str = "gdibl-cache";
/// Entries together are no larger: those that were used longest ago go.
const MOST_BYTES: u64 = 4 << 30;
const DAY: Duration = Duration::from_secs(24 * 3600);

/// A folder of entries.
#[derive(Debug, Clone)]
pub struct Cache {
    folder: PathBuf,
}

/// The right to make an entry. It ends with the program, however it ends.
pub struct Making {
    path: PathBuf,
    _file: File,
}

impl Drop for Making {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

impl Cache {
    /// In this folder, or in the user's own.
    pub fn new(folder: Option<PathBuf>) -> Cache {
        let variable = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
        let user = || {
            let base = variable("XDG_CACHE_HOME").or_else(|| variable("LOCALAPPDATA"));
            base.or_else(|| Some(variable("HOME")?.join(".cache"))).unwrap_or_else(std::env::temp_dir).join("gdibl")
        };
        Cache { folder: folder.unwrap_or_else(user) }
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name).with_extension(SUFFIX)
    }

    /// An entry; `None` where it is not there, or damaged.
    pub fn get(&self, name: &str) -> Option<Vec<u8>> {
        let path = self.path(name);
        let bytes = std::fs::read(&path).ok()?;
        let entry = bytes.strip_prefix(MAGIC).and_then(|rest| rest.split_at_checked(32));
        let Some((_, entry)) = entry.filter(|(hash, entry)| *hash == blake3::hash(entry).as_bytes()) else {
            say(&format!("{}: is damaged; it is made anew", path.display()));
            return None;
        };
        // It was used now. Where that cannot be told, it goes a little early.
        let _ = std::fs::File::options().append(true).open(&path).and_then(|file| file.set_modified(SystemTime::now()));
        Some(entry.to_vec())
    }

    /// Writes an entry, and removes what is too much. A cache that cannot be written costs time, and nothing else: one line says so.
    pub fn put(&self, name: &str, bytes: &[u8]) {
        let entry = [&MAGIC[..], blake3::hash(bytes).as_bytes(), bytes].concat();
        let written = std::fs::create_dir_all(&self.folder).map_err(|error| error.to_string());
        let written = written.and_then(|()| write_whole(&self.path(name), &entry).map_err(|error| error.to_string()));
        match written {
            Ok(()) => self.trim(),
            Err(why) => say(&format!("nothing is kept for the next time: {why}")),
        }
    }

    /// The right to make what is called so: one program at a time has it. `None`: the folder cannot be written.
    pub fn make(&self, name: &str, cancel: &AtomicBool) -> Result<Option<Making>, Fault> {
        let path = self.folder.join(name).with_extension("lock");
        if std::fs::create_dir_all(&self.folder).is_err() {
            return Ok(None);
        }
        let waiting = format!("{}: another program captures the same; this one waits until it is done", path.display());
        match open_locked(&path, &waiting, cancel) {
            Ok(file) => Ok(Some(Making { path, _file: file })),
            Err(Fault::Interrupted) => Err(Fault::Interrupted),
            Err(_) => Ok(None),
        }
    }

    fn trim(&self) {
        self.remove_locks();
        let entries = std::fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let mut all: Vec<(SystemTime, u64, PathBuf)> = entries
            .filter(|entry| entry.path().extension().is_some_and(|extension| extension == SUFFIX))
            .filter_map(|entry| {
                let found = entry.metadata().ok()?;
                Some((found.modified().ok()?, found.len(), entry.path()))
            })
            .collect();
        all.sort();
        let mut total: u64 = all.iter().map(|(_, size, _)| size).sum();
        for (_, size, path) in all {
            if total <= MOST_BYTES {
                break;
            }
            total -= size;
            let _ = std::fs::remove_file(path);
        }
    }

    /// Locks of programs that were killed go once they are a day old, if nobody holds them.
    fn remove_locks(&self) {
        let entries = std::fs::read_dir(&self.folder).into_iter().flatten().flatten().map(|entry| entry.path());
        for path in entries.filter(|path| path.extension().is_some_and(|extension| extension == "lock")) {
            let is_old = |found: std::fs::Metadata| found.modified().ok()?.elapsed().ok().map(|age| age > DAY);
            let Ok(file) = File::open(&path) else { continue };
            if file.metadata().ok().and_then(is_old).unwrap_or(false) && file.try_lock().is_ok() {
                let _ = std::fs::remove_file(&path);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn locks_of_killed_programs_go_once_they_are_a_day_old() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::new(Some(folder.path().into()));
        let lock = |name: &str, hours: u32| {
            let file = File::create(folder.path().join(name)).unwrap();
            file.set_modified(SystemTime::now() - hours * DAY / 24).unwrap();
            file
        };
        drop(lock("old.lock", 25));
        drop(lock("new.lock", 23));
        let held = lock("held.lock", 25);
        held.lock().unwrap();
        cache.put("entry", b"light");
        let left = |name: &str| folder.path().join(name).exists();
        assert_eq!(["old.lock", "new.lock", "held.lock"].map(left), [false, true, true]);
        assert_eq!(cache.get("entry").as_deref(), Some(&b"light"[..]));
    }
}
