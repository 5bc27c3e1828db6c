//! Files that one program at a time may use.

use std::fs::{File, OpenOptions, TryLockError};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::fault::Fault;
use crate::say::say;

/// How often it is looked whether another program is done.
const EVERY: Duration = Duration::from_millis(100);

/// Opens a file to read it and to write at its end, creates it where it is not there, and locks it for this program alone. Waits for
/// another program that has it, with one line that says `waiting`. The lock ends with the program, however it ends.
pub fn open_locked(path: &Path, waiting: &str, cancel: &AtomicBool) -> Result<File, Fault> {
    let failed = |error: std::io::Error| Fault::writing(path, &error);
    let mut is_said = false;
    loop {
        let file = OpenOptions::new().read(true).append(true).create(true).open(path).map_err(failed)?;
        match file.try_lock() {
            Ok(()) if is_in_place(&file, path) => return Ok(file),
            // Its last owner removed it in the meantime.
            Ok(()) => continue,
            Err(TryLockError::WouldBlock) => {}
            // A file system without locks: as good as alone.
            Err(TryLockError::Error(error)) if error.kind() == std::io::ErrorKind::Unsupported => return Ok(file),
            Err(TryLockError::Error(error)) => return Err(failed(error)),
        }
        if !is_said {
            say(waiting);
            is_said = true;
        }
        if cancel.load(Ordering::Relaxed) {
            return Err(Fault::Interrupted);
        }
        std::thread::sleep(EVERY);
    }
}

/// The path still names this file.
#[cfg(unix)]
fn is_in_place(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let same = |(a, b): (std::fs::Metadata, std::fs::Metadata)| (a.dev(), a.ino()) == (b.dev(), b.ino());
    file.metadata().ok().zip(std::fs::metadata(path).ok()).is_some_and(same)
}

/// Other systems keep a file that is open in its place.
#[cfg(not(unix))]
fn is_in_place(_: &File, _: &Path) -> bool {
    true
}
