//! Watching long work, and stopping it.

use crate::blocks::Blocks;
use std::sync::atomic::{AtomicBool, Ordering};

/// Lets a caller watch a bake or a capture and stop it.
pub struct Control<'a> {
    /// Set it to stop: the work returns [`Interrupted`] within a few rays.
    pub cancel: &'a AtomicBool,
    /// Called from worker threads with (nodes, pixels or places finished, rays traced) since the last call.
    pub progress: &'a (dyn Fn(u64, u64) + Sync),
    /// Keeps what is finished. `None`: nothing is kept.
    pub blocks: Option<&'a dyn Blocks>,
}

impl Control<'_> {
    /// The caller wants to stop.
    pub fn cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }

    /// For `?`: an error where the caller wants to stop.
    pub(crate) fn go_on(&self) -> Result<(), Interrupted> {
        if self.cancelled() { Err(Interrupted) } else { Ok(()) }
    }
}

/// The caller cancelled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Interrupted;
