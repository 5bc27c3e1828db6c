//! Why a job came to no volume.

use crate::Interrupted;

/// Why there is no volume.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Stop {
    /// The settings make no sense, by themselves or for this level.
    #[error("{0}")]
    Usage(String),
    /// The level cannot be baked like this.
    #[error("{0}")]
    Invalid(String),
    /// It would take more memory than there is, or than is allowed.
    #[error("{0}")]
    Memory(String),
    /// No node has light.
    #[error("{0}")]
    Nothing(String),
    /// Cancelled.
    #[error("interrupted")]
    Interrupted,
}

impl From<Interrupted> for Stop {
    fn from(Interrupted: Interrupted) -> Stop {
        Stop::Interrupted
    }
}
