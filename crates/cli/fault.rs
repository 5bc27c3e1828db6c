//! Why a verb failed, and the exit code it ends with.

use std::io::ErrorKind;
use std::path::Path;

/// Each variant is an exit code.
#[derive(Debug)]
pub enum Fault {
    /// 1: disk, memory.
    System(String),
    /// 2: the command line or BAKE.toml asks for something that makes no sense.
    Usage(String),
    /// 3: a file is missing, damaged or contradicts itself.
    Invalid(String),
    /// 4: a file is fine, but gdibl does not read its kind.
    Unsupported(String),
    /// 5: done, but a bound that was asked for was not met.
    Bound(String),
    /// 130: the user stopped it.
    Interrupted,
}

impl Fault {
    pub fn exit_code(&self) -> u8 {
        match self {
            Fault::System(_) => 1,
            Fault::Usage(_) => 2,
            Fault::Invalid(_) => 3,
            Fault::Unsupported(_) => 4,
            Fault::Bound(_) => 5,
            Fault::Interrupted => 130,
        }
    }

    /// An input file could not be read: missing ones are the caller's mistake, the rest the system's.
    pub fn reading(path: &Path, error: &std::io::Error) -> Fault {
        let message = format!("{}: {error}", path.display());
        match error.kind() {
            ErrorKind::NotFound | ErrorKind::IsADirectory | ErrorKind::NotADirectory | ErrorKind::InvalidData => {
                Fault::Invalid(message)
            }
            _ => Fault::System(message),
        }
    }

    /// What the runtime said of a file.
    pub fn of_volume(path: &Path, error: &gdibl_runtime::Error) -> Fault {
        let message = format!("{}: {error}", path.display());
        match error {
            gdibl_runtime::Error::Unsupported { .. } => Fault::Unsupported(message),
            _ => Fault::Invalid(message),
        }
    }

    /// What the library said when it wrote a file.
    pub fn from_writing(error: gdibl_baker::Error) -> Fault {
        match error {
            gdibl_baker::Error::Io { path, source } => Fault::writing(&path, &source),
            other => other.into(),
        }
    }

    /// An output could not be written.
    pub fn writing(path: &Path, error: &std::io::Error) -> Fault {
        Fault::System(format!("{}: cannot write: {error}", path.display()))
    }
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Fault::System(message)
            | Fault::Usage(message)
            | Fault::Invalid(message)
            | Fault::Unsupported(message)
            | Fault::Bound(message) => f.write_str(message),
            Fault::Interrupted => f.write_str("interrupted; no file was left half written"),
        }
    }
}

impl From<gdibl_baker::Error> for Fault {
    fn from(error: gdibl_baker::Error) -> Self {
        match &error {
            gdibl_baker::Error::Unsupported { .. } => Fault::Unsupported(error.to_string()),
            gdibl_baker::Error::Invalid { .. } => Fault::Invalid(error.to_string()),
            gdibl_baker::Error::Io { path, source } => Fault::reading(path, source),
        }
    }
}

impl From<gdibl_baker::job::Stop> for Fault {
    fn from(stop: gdibl_baker::job::Stop) -> Self {
        use gdibl_baker::job::Stop;
        match stop {
            Stop::Usage(message) => Fault::Usage(message),
            Stop::Invalid(message) => Fault::Invalid(message),
            Stop::Memory(message) => Fault::System(message),
            Stop::Nothing(message) => Fault::Bound(message),
            Stop::Interrupted => Fault::Interrupted,
        }
    }
}
