//! Where the bytes of files come from.

use std::path::Path;
use std::sync::Arc;

/// Gives the bytes of files. Who wants to know what was read, or to read each file only once, has an own one.
pub trait Files {
    /// All bytes of a file.
    ///
    /// # Errors
    /// The file cannot be read.
    fn read(&self, path: &Path) -> std::io::Result<Arc<Vec<u8>>>;
}

/// Files as they are on disk at the moment.
#[derive(Debug, Clone, Copy, Default)]
pub struct Disk;

impl Files for Disk {
    fn read(&self, path: &Path) -> std::io::Result<Arc<Vec<u8>>> {
        std::fs::read(path).map(Arc::new)
    }
}
