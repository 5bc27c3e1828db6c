//! Output files that are whole or not there: written beside their place, then renamed.

use std::io::Write;
use std::path::Path;

use crate::{Error, Result};

/// A temporary file in the folder of `path`, to be renamed to it. It will have the permissions of any file that a program
/// creates (temporary files are private by default).
pub(crate) fn create_beside(path: &Path) -> Result<tempfile::NamedTempFile> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    builder.prefix(".gdibl-").suffix(".tmp");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666)); // less the umask
    }
    builder.tempfile_in(folder).map_err(|error| Error::io(path, error))
}

/// Writes a file whole or not at all: to a temporary file in the same folder, then renamed.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    let failed = |error| Error::io(path, error);
    let mut file = create_beside(path)?;
    file.write_all(bytes).and_then(|()| file.as_file().sync_all()).map_err(failed)?;
    file.persist(path).map_err(|error| failed(error.error))?;
    Ok(())
}
