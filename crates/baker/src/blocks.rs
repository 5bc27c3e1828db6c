//! Long work in blocks that are kept as they are finished: work that was killed goes on from them, and several machines can share
//! it.
//!
//! A bake goes through passes, one after another, the same ones in every run with the same inputs and settings. The blocks of a pass
//! do not depend on each other, and what follows depends on nothing but what they came to: so a run that takes blocks of an earlier
//! one gives the same bytes.
//!
//! ```text
//!     shared   whether materials explain what probes show; coarse grids that tell the spacing; where nodes stand; the pilot
//!     split    nodes
//!     ...      nodes that stepped out of solids, finer nodes of a sparse grid, places between nodes
//! ```
//! One shard of a bake finds all blocks of the shared passes and its own of the first split one, and stops there.

use bincode::{Decode, Encode};
use std::fs::File;

/// Which block of which pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BlockId {
    /// Passes count from 0, in the order in which they begin.
    pub pass: u32,
    /// Blocks count from 0.
    pub block: u32,
}

/// Who needs the blocks of a pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PassKind {
    /// Every shard needs all of them. They take little time.
    Shared,
    /// Shards divide them.
    Split,
}

/// Keeps blocks. The caller owns the memory, or the file, that they are kept in.
pub trait Blocks: Sync {
    /// The next pass begins; returns its number.
    fn begin(&self, kind: PassKind) -> u32;
    /// This run has to find the block, if it is not known.
    fn is_own(&self, id: BlockId) -> bool;
    /// What a block came to, if that is known.
    fn known(&self, id: BlockId) -> Option<Vec<u8>>;
    /// Keeps what a block came to.
    fn keep(&self, id: BlockId, bytes: &[u8]);
    /// Rays of what was found on the way, as far as no block before has found it: of several runs each may have found the same.
    fn count(&self, found: &[Found]) -> u64;
    /// All blocks of a pass are done that this run has to do. `false`: the run is to stop here.
    fn end(&self, pass: u32) -> bool;
    /// An empty file, to be read and written, for a table of so many bytes. `None`: it is to be held in memory.
    fn scratch(&self, _bytes: u64) -> Option<File> {
        None
    }
}

/// Something that is found once and remembered: a place on a surface, by its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Encode, Decode)]
pub struct Found {
    /// Its own, among all that a radiance function remembers.
    pub id: u64,
    /// Traced to find it.
    pub rays: u32,
}

/// Blocks whose passes are all shared.
pub(crate) struct AllShared<'a>(pub &'a dyn Blocks);

impl Blocks for AllShared<'_> {
    fn begin(&self, _: PassKind) -> u32 {
        self.0.begin(PassKind::Shared)
    }

    fn is_own(&self, id: BlockId) -> bool {
        self.0.is_own(id)
    }

    fn known(&self, id: BlockId) -> Option<Vec<u8>> {
        self.0.known(id)
    }

    fn keep(&self, id: BlockId, bytes: &[u8]) {
        self.0.keep(id, bytes);
    }

    fn count(&self, found: &[Found]) -> u64 {
        self.0.count(found)
    }

    fn end(&self, pass: u32) -> bool {
        self.0.end(pass)
    }

    fn scratch(&self, bytes: u64) -> Option<File> {
        self.0.scratch(bytes)
    }
}

/// Blocks, if there are any, that do not count rays of what is found on the way. For passes that whoever puts shards together makes
/// itself: there it finds again what the nodes of other runs have found.
pub(crate) struct OwnRays<'a>(pub Option<&'a dyn Blocks>);

impl Blocks for OwnRays<'_> {
    fn begin(&self, kind: PassKind) -> u32 {
        self.0.map_or(0, |blocks| blocks.begin(kind))
    }

    fn is_own(&self, id: BlockId) -> bool {
        self.0.is_none_or(|blocks| blocks.is_own(id))
    }

    fn known(&self, id: BlockId) -> Option<Vec<u8>> {
        self.0?.known(id)
    }

    fn keep(&self, id: BlockId, bytes: &[u8]) {
        if let Some(blocks) = self.0 {
            blocks.keep(id, bytes);
        }
    }

    fn count(&self, _: &[Found]) -> u64 {
        0
    }

    fn end(&self, pass: u32) -> bool {
        self.0.is_none_or(|blocks| blocks.end(pass))
    }

    fn scratch(&self, bytes: u64) -> Option<File> {
        self.0?.scratch(bytes)
    }
}
