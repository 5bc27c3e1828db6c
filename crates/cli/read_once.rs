//! Files as they were read: each once, and its hash is that of the bytes that were parsed. A level that is saved during a bake is
//! told from the one that was baked.

use gdibl_baker::import::files::Files;
use gdibl_baker::job::records::InputRecord;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// All that was read so far.
#[derive(Default)]
pub struct ReadOnce {
    read: Mutex<BTreeMap<PathBuf, FileRead>>,
}

#[derive(Clone)]
struct FileRead {
    /// `None`: given back.
    bytes: Option<Arc<Vec<u8>>>,
    size: u64,
    hash: [u8; 32],
}

impl ReadOnce {
    /// The bytes of a file, and what is known of it.
    fn file(&self, path: &Path) -> std::io::Result<(Arc<Vec<u8>>, FileRead)> {
        let mut read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        let known = read.get(path);
        if let Some((bytes, known)) = known.and_then(|known| Some((known.bytes.clone()?, known))) {
            return Ok((bytes, known.clone()));
        }
        let bytes = Arc::new(std::fs::read(path)?);
        let hash = *blake3::hash(&bytes).as_bytes();
        if known.is_some_and(|known| known.hash != hash) {
            return Err(std::io::Error::other("the file changed since this run read it; run it again"));
        }
        let file = FileRead { size: bytes.len() as u64, bytes: Some(bytes.clone()), hash };
        read.insert(path.into(), file.clone());
        Ok((bytes, file))
    }

    /// Name, size and hash of a file.
    pub fn record(&self, role: &str, path: &Path) -> std::io::Result<InputRecord> {
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        let (_, FileRead { size, hash, .. }) = self.file(path)?;
        Ok(InputRecord { role: role.into(), name, bytes: size, blake3: hash })
    }

    /// A file that lies nowhere, by its bytes.
    pub fn insert(&self, path: &Path, bytes: Vec<u8>) {
        let hash = *blake3::hash(&bytes).as_bytes();
        let file = FileRead { size: bytes.len() as u64, bytes: Some(Arc::new(bytes)), hash };
        self.read.lock().unwrap_or_else(PoisonError::into_inner).insert(path.into(), file);
    }

    /// All files that were read, in the order of their paths.
    pub fn paths(&self) -> Vec<PathBuf> {
        self.read.lock().unwrap_or_else(PoisonError::into_inner).keys().cloned().collect()
    }

    /// Gives the memory back: everything is read.
    pub fn forget(&self) {
        let mut read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        read.values_mut().for_each(|file| file.bytes = None);
    }
}

impl Files for ReadOnce {
    fn read(&self, path: &Path) -> std::io::Result<Arc<Vec<u8>>> {
        Ok(self.file(path)?.0)
    }
}

impl std::fmt::Debug for ReadOnce {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.paths()).finish()
    }
}
