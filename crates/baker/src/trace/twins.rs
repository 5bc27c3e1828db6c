//! Whether triangles have twins: faces back to back, see [`super::back_to_back`].

use std::sync::atomic::{AtomicU8, Ordering};

/// Whether triangles have twins, each found when first asked for.
#[derive(Debug)]
pub(super) struct Twins(Vec<AtomicU8>);

const UNKNOWN: u8 = 0;
const NONE: u8 = 1;
const SOME: u8 = 2;

impl Twins {
    /// Of so many triangles.
    pub fn new(count: usize) -> Twins {
        Twins((0..count).map(|_| AtomicU8::new(UNKNOWN)).collect())
    }

    /// Of this triangle; `find` tells if nobody has asked before. Whoever else looks finds the same.
    #[inline]
    pub fn has(&self, triangle: u32, find: impl FnOnce() -> bool) -> bool {
        let own = &self.0[triangle as usize];
        match own.load(Ordering::Relaxed) {
            UNKNOWN => {
                let found = find();
                own.store(if found { SOME } else { NONE }, Ordering::Relaxed);
                found
            }
            found => found == SOME,
        }
    }
}
