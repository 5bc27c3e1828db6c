//! Output files that are whole or not there: written beside their place, then renamed.

use std::io::Write;
use std::path::Path;

use crate::{Error, Result};

/// Names of temporary files.
const PREFIX: &str = ".gdibl-";
const SUFFIX: &str = ".tmp";
const DAY: std::time::Duration = std::time::Duration::from_secs(24 * 3600);

/// A temporary file in the folder of `path`, to be renamed to it. It will have the permissions of any file that a program
/// creates (temporary files are private by default).
pub(crate) fn create_beside(path: &Path) -> Result<tempfile::NamedTempFile> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    remove_leftovers(folder);
    let mut builder = tempfile::Builder::new();
    builder.prefix(PREFIX).suffix(SUFFIX);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666)); // less the umask
    }
    builder.tempfile_in(folder).map_err(|error| Error::io(path, error))
}

/// Temporary files of programs that were killed go at the next write beside them, once they are a day old: none is in use so long.
fn remove_leftovers(folder: &Path) {
    let is_own = |entry: &std::fs::DirEntry| {
        let name = entry.file_name();
        name.to_str().is_some_and(|name| name.starts_with(PREFIX) && name.ends_with(SUFFIX))
    };
    let is_old = |entry: &std::fs::DirEntry| {
        let age = entry.metadata().ok().and_then(|found| found.modified().ok()?.elapsed().ok());
        age.is_some_and(|age| age > DAY)
    };
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    for entry in entries.filter(|entry| is_own(entry) && is_old(entry)) {
        // Who may not remove it leaves it.
        let _ = std::fs::remove_file(entry.path());
    }
}

/// Writes a file whole or not at all: to a temporary file in the same folder, then renamed. A device or a pipe is written to as it
/// is: to rename would put a file in the place of `/dev/null`.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    let failed = |error| Error::io(path, error);
    if std::fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir()) {
        let opened = std::fs::OpenOptions::new().write(true).open(path);
        return opened.and_then(|mut file| file.write_all(bytes)).map_err(failed);
    }
    let mut file = create_beside(path)?;
    file.write_all(bytes).and_then(|()| file.as_file().sync_all()).map_err(failed)?;
    file.persist(path).map_err(|error| failed(error.error))?;
    Ok(())
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::os::unix::fs::FileTypeExt;

    #[test]
    fn leftovers_go_once_they_are_a_day_old_and_nothing_else_does() {
        let folder = tempfile::tempdir().unwrap();
        let made = |name: &str, hours: u32| {
            let file = std::fs::File::create(folder.path().join(name)).unwrap();
            file.set_modified(std::time::SystemTime::now() - hours * DAY / 24).unwrap();
        };
        made(".gdibl-old.tmp", 25);
        made(".gdibl-new.tmp", 23);
        made("other.tmp", 48);
        write_whole(&folder.path().join("a.gdibl"), b"light").unwrap();
        let mut names: Vec<String> = std::fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        assert_eq!(names, [".gdibl-new.tmp", "a.gdibl", "other.tmp"]);
    }

    #[test]
    fn a_pipe_is_written_to_and_stays_a_pipe() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let reader = std::thread::spawn({
            let pipe = pipe.clone();
            move || std::fs::read(pipe).unwrap()
        });
        write_whole(&pipe, b"light").unwrap();
        assert!(std::fs::metadata(&pipe).unwrap().file_type().is_fifo());
        assert_eq!(reader.join().unwrap(), b"light");
    }
}
