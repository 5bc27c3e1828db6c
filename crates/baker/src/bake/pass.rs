//! One pass of a bake, whose blocks are kept as they are finished: see [`crate::blocks`].

use bincode::{Decode, Encode};

use crate::blocks::{BlockId, Blocks, Found, PassKind};
use crate::{Control, Interrupted};

/// One pass of a bake.
pub(crate) struct Pass<'a> {
    blocks: Option<&'a dyn Blocks>,
    number: u32,
}

impl<'a> Pass<'a> {
    pub fn begin(control: &Control<'a>, kind: PassKind) -> Pass<'a> {
        Pass::of(control.blocks, kind)
    }

    /// A pass that is not interrupted.
    pub fn of(blocks: Option<&'a dyn Blocks>, kind: PassKind) -> Pass<'a> {
        Pass { blocks, number: blocks.map_or(0, |blocks| blocks.begin(kind)) }
    }

    /// What a block came to: what is known of it and `fits`, else what `find` finds. `None`: another run finds it.
    pub fn block<T: Encode + Decode<()>>(
        &self,
        block: usize,
        fits: impl FnOnce(&T) -> bool,
        find: impl FnOnce() -> Result<T, Interrupted>,
    ) -> Result<Option<T>, Interrupted> {
        let Some(blocks) = self.blocks else { return find().map(Some) };
        let id = BlockId { pass: self.number, block: block as u32 };
        if let Some(known) = blocks.known(id).and_then(|bytes| decode::<T>(&bytes)).filter(fits) {
            return Ok(Some(known));
        }
        if !blocks.is_own(id) {
            return Ok(None);
        }
        let found = find()?;
        blocks.keep(id, &encode(&found));
        Ok(Some(found))
    }

    /// Rays of what a block found, as far as no other one has found it.
    pub fn count(&self, found: &[Found]) -> u64 {
        match self.blocks {
            Some(blocks) => blocks.count(found),
            None => found.iter().map(|found| u64::from(found.rays)).sum(),
        }
    }

    /// All is done.
    ///
    /// # Errors
    /// The run is one of a shard, and stops here.
    pub fn end(self) -> Result<(), Interrupted> {
        if self.blocks.is_none_or(|blocks| blocks.end(self.number)) { Ok(()) } else { Err(Interrupted) }
    }
}

/// A block may not be larger than this: a damaged length must not take the memory.
const LIMIT: usize = 64 << 20;

fn encode<T: Encode>(block: &T) -> Vec<u8> {
    bincode::encode_to_vec(block, bincode::config::legacy()).expect("blocks encode into memory")
}

fn decode<T: Decode<()>>(bytes: &[u8]) -> Option<T> {
    let configuration = bincode::config::legacy().with_limit::<LIMIT>();
    let (block, used) = bincode::decode_from_slice(bytes, configuration).ok()?;
    (used == bytes.len()).then_some(block)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;
    use std::sync::Mutex;
    use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

    #[derive(Default)]
    struct Memory {
        passes: AtomicU32,
        kept: Mutex<BTreeMap<BlockId, Vec<u8>>>,
    }

    impl Blocks for Memory {
        fn begin(&self, _: PassKind) -> u32 {
            self.passes.fetch_add(1, Ordering::Relaxed)
        }
        fn is_own(&self, id: BlockId) -> bool {
            id.block != 7
        }
        fn known(&self, id: BlockId) -> Option<Vec<u8>> {
            self.kept.lock().unwrap().get(&id).cloned()
        }
        fn keep(&self, id: BlockId, bytes: &[u8]) {
            self.kept.lock().unwrap().insert(id, bytes.to_vec());
        }
        fn count(&self, _: &[Found]) -> u64 {
            0
        }
        fn end(&self, pass: u32) -> bool {
            pass == 0
        }
    }

    #[test]
    fn a_block_is_found_once_and_again_only_where_what_is_kept_does_not_fit() {
        let memory = Memory::default();
        let cancel = AtomicBool::new(false);
        let control = Control { cancel: &cancel, progress: &|_, _| {}, blocks: Some(&memory) };
        let pass = Pass::begin(&control, PassKind::Split);
        let numbers = |value: f64| pass.block(3, |all: &Vec<f64>| all.len() == 2, || Ok(vec![value, f64::NAN]));
        let bits = |found: Result<Option<Vec<f64>>, Interrupted>| found.unwrap().unwrap().into_iter().map(f64::to_bits);
        assert!(bits(numbers(1.0)).eq(bits(numbers(2.0))), "the second is what the first one kept");
        // Damage: found anew.
        memory.kept.lock().unwrap().values_mut().for_each(|bytes| bytes.truncate(5));
        assert_eq!(numbers(3.0).unwrap().unwrap()[0], 3.0);
        // It does not fit: found anew.
        assert_eq!(pass.block(3, |all: &Vec<f64>| all.len() == 1, || Ok(vec![4.0])), Ok(Some(vec![4.0])));
        // Another run's.
        assert_eq!(pass.block(7, |_: &u8| true, || Ok(5)), Ok(None));
        assert_eq!(pass.end(), Ok(()));
        assert_eq!(Pass::begin(&control, PassKind::Shared).end(), Err(Interrupted));
    }
}
