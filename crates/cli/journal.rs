//! What is finished of a bake, in a file beside its output: a bake that was killed goes on from there. A shard is the same kind of file
//! with an end, and a bake of all shards' blocks is their assembly.
//!
//! ```text
//! head     "GDIBLPA1"  key: 32 bytes  length: u32  head as JSON  crc32: u32 of all of this
//! blocks   pass: u32  block: u32  length: u32  bytes  crc32: u32 of all of this
//! end      pass: u32::MAX  block: count of blocks  length: 0  crc32          (of shards alone)
//! ```
//! Numbers are little-endian. The key is the BLAKE3 hash of the request, so that only blocks of an equal bake are taken. What follows a
//! damaged block is not believed.

use gdibl_baker::blocks::{BlockId, Blocks, Found, PassKind};
use gdibl_runtime::format::crc32;
use serde::{Deserialize, Serialize};
use std::collections::{HashMap, HashSet};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use crate::fault::Fault;
use crate::locks::open_locked;
use crate::request::Request;
use crate::say::say;

const MAGIC: &[u8; 8] = b"GDIBLPA1";
/// No block is larger.
const MOST_BYTES: u32 = 64 << 20;
/// Larger tables of what nodes came to go to a file without a name, beside the output.
const MOST_IN_MEMORY: u64 = 64 << 20;
/// The pass of the record that ends a shard.
const END: u32 = u32::MAX;
/// No pass has this number.
const NO_PASS: u32 = u32::MAX;

/// A part of a bake: one of so many.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shard {
    /// 1..=count.
    pub index: u32,
    pub count: u32,
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl std::str::FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let shard = text.split_once('/').and_then(|(index, count)| {
            Some(Shard { index: index.trim().parse().ok()?, count: count.trim().parse().ok()? })
        });
        shard.filter(|shard| (1..=shard.count).contains(&shard.index)).ok_or("expected I/N, I from 1 to N".into())
    }
}

/// What a file says of the bake that its blocks are of.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Head {
    pub request: Request,
    /// `None`: a whole bake.
    pub shard: Option<Shard>,
    /// The command line, without the program, the shard and the output.
    pub arguments: Vec<String>,
    /// The folder in which it was given.
    pub folder: PathBuf,
}

/// Blocks of a shard: its path, the file, and where they are in it.
pub struct ShardBlocks {
    pub path: PathBuf,
    pub file: File,
    pub blocks: Vec<(BlockId, u64, u32)>,
}

/// Takes the blocks of the shared passes.
type Share = Box<dyn FnOnce(Vec<u8>) + Send>;

/// Where the bytes of a block are.
#[derive(Debug, Clone, Copy)]
struct Place {
    file: u32,
    length: u32,
    offset: u64,
}

/// Blocks in files: the own journal, to which new ones go, and shards.
pub struct Journal {
    /// The own one, which is locked, and its path. `None`: nothing is kept.
    own: Option<(Mutex<File>, PathBuf)>,
    shards: Vec<Mutex<File>>,
    known: Mutex<HashMap<BlockId, Place>>,
    /// Where the own file ends.
    end: AtomicU64,
    shard: Option<Shard>,
    passes: AtomicU32,
    /// The pass that shards divide.
    divided: AtomicU32,
    /// Takes the blocks of the shared passes once these are over.
    share: Mutex<Option<Share>>,
    /// What blocks have found on the way.
    counted: Mutex<HashSet<u64>>,
    /// The run stops behind the shared passes.
    only_shared: bool,
    is_broken: AtomicBool,
    is_done: AtomicBool,
}

/// The file beside an output that its bake goes on from.
pub fn path_beside(output: &Path) -> PathBuf {
    let mut name = output.as_os_str().to_owned();
    name.push(".partial");
    name.into()
}

/// One that is there is of no use any more; `None`: another program has it.
pub fn remove_stale(output: &Path) {
    let path = path_beside(output);
    if let Ok(file) = File::open(&path)
        && file.try_lock().is_ok()
    {
        let _ = std::fs::remove_file(&path);
    }
}

impl Journal {
    /// Keeps nothing.
    fn nowhere(shard: Option<Shard>) -> Journal {
        Journal {
            own: None,
            shards: Vec::new(),
            known: Mutex::default(),
            end: AtomicU64::new(0),
            shard,
            passes: AtomicU32::new(0),
            divided: AtomicU32::new(NO_PASS),
            share: Mutex::new(None),
            counted: Mutex::default(),
            only_shared: false,
            is_broken: AtomicBool::new(false),
            is_done: AtomicBool::new(false),
        }
    }

    /// Keeps blocks as long as it lives, in a file without a name.
    pub fn temporary() -> Result<Journal, Fault> {
        let failed = |error: std::io::Error| Fault::writing(&std::env::temp_dir(), &error);
        let file = tempfile::Builder::new().append(true).tempfile().map_err(failed)?.into_file();
        Ok(Journal { own: Some((Mutex::new(file), std::env::temp_dir())), ..Journal::nowhere(None) })
    }

    /// Opens the journal of an output, and waits for another bake that writes it. What lies there of an equal bake is taken, unless
    /// there is no other equal one.
    pub fn open(output: &Path, head: &Head, is_repeatable: bool, cancel: &AtomicBool) -> Result<Journal, Fault> {
        let mut journal = Journal::nowhere(head.shard);
        // Beside a device or a pipe nothing is kept.
        if std::fs::metadata(output).is_ok_and(|found| !found.is_file()) {
            return Ok(journal);
        }
        let path = path_beside(output);
        let waiting = format!("{}: another bake writes it; this one waits until it is done", output.display());
        let mut file = open_locked(&path, &waiting, cancel)?;
        let failed = |error: std::io::Error| Fault::writing(&path, &error);
        let size = file.metadata().map_err(failed)?.len();
        let end = match scan(&mut file) {
            Ok(found) if is_repeatable && found.head.request == head.request && found.head.shard == head.shard => {
                let blocks = found.blocks.len();
                let map = journal.known.get_mut().unwrap_or_else(PoisonError::into_inner);
                map.extend(
                    found.blocks.into_iter().map(|(id, offset, length)| (id, Place { file: 0, offset, length })),
                );
                if blocks > 0 {
                    say(&format!("{}: goes on from {blocks} blocks of a bake that was stopped", path.display()));
                }
                found.end
            }
            Ok(found) => {
                let what = found.head.request.difference(&head.request);
                let what = if found.head.request == head.request { "the shard".into() } else { what };
                say(&format!("{}: is of another bake, which differs in {what}; starts anew", path.display()));
                0
            }
            Err(why) => {
                if size > 0 {
                    say(&format!("{}: {why}; starts anew", path.display()));
                }
                0
            }
        };
        file.set_len(end).map_err(failed)?;
        let end = if end == 0 {
            let bytes = head_bytes(head);
            file.write_all(&bytes).map_err(failed)?;
            bytes.len() as u64
        } else {
            end
        };
        journal.end = AtomicU64::new(end);
        journal.own = Some((Mutex::new(file), path));
        Ok(journal)
    }

    /// Takes the blocks of shards, too.
    pub fn add_shards(&mut self, shards: Vec<ShardBlocks>) {
        let map = self.known.get_mut().unwrap_or_else(PoisonError::into_inner);
        for ShardBlocks { file, blocks, .. } in shards {
            self.shards.push(Mutex::new(file));
            let file = self.shards.len() as u32;
            map.extend(blocks.into_iter().map(|(id, offset, length)| (id, Place { file, offset, length })));
        }
    }

    /// Gives the blocks of the shared passes to `put` once these are over.
    pub fn share(&mut self, put: impl FnOnce(Vec<u8>) + Send + 'static) {
        self.share = Mutex::new(Some(Box::new(put)));
    }

    /// Gives the blocks of the shared passes away, if that is still to be done.
    pub fn share_now(&self) {
        let share = self.share.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(put) = share {
            put(self.shared());
        }
    }

    /// `only`: stops behind the shared passes.
    pub fn only_shared(&mut self, only: bool) {
        self.only_shared = only;
    }

    /// Blocks of the shared passes that are known, as the bytes of a file without a head.
    fn shared(&self) -> Vec<u8> {
        let divided = self.divided.load(Ordering::Relaxed);
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let mut ids: Vec<BlockId> = known.keys().copied().filter(|id| id.pass < divided).collect();
        drop(known);
        ids.sort();
        let blocks = ids.into_iter().filter_map(|id| Some(record_bytes(id, &self.read(id)?)));
        blocks.flatten().collect()
    }

    /// Keeps blocks that another run shares, as [`shared`](Journal::shared) gave them.
    pub fn take_shared(&self, mut bytes: &[u8]) {
        while let Some((id, length)) = record_head(bytes) {
            let Some(block) = bytes.get(12..12 + length as usize) else { return };
            if self.read(id).is_none() {
                self.keep(id, block);
            }
            bytes = bytes.get(16 + length as usize..).unwrap_or_default();
        }
    }

    /// A shard has all its blocks.
    pub fn is_done(&self) -> bool {
        self.is_done.load(Ordering::Relaxed)
    }

    /// Something is kept in the own file.
    pub fn has_blocks(&self) -> bool {
        self.known.lock().unwrap_or_else(PoisonError::into_inner).values().any(|place| place.file == 0)
    }

    /// Nothing is left to go on from: the output is written, or will never be.
    pub fn remove(self) -> Result<(), Fault> {
        let Some((_, path)) = self.own.filter(|(_, path)| path.is_file()) else { return Ok(()) };
        std::fs::remove_file(&path).map_err(|error| Fault::writing(&path, &error))
    }

    /// Ends a shard, and puts it in the place of the output.
    pub fn finish(&mut self, output: &Path) -> Result<u64, Fault> {
        let failed = |error: std::io::Error| Fault::writing(output, &error);
        let Some((file, path)) = &self.own else {
            return Err(Fault::Usage(format!("{}: a shard is written to a file", output.display())));
        };
        if self.is_broken.load(Ordering::Relaxed) {
            return Err(Fault::System(format!("{}: the shard could not be written whole", output.display())));
        }
        let count = self.known.lock().unwrap_or_else(PoisonError::into_inner).len() as u32;
        let mut file = file.lock().unwrap_or_else(PoisonError::into_inner);
        file.write_all(&record_bytes(BlockId { pass: END, block: count }, &[])).map_err(failed)?;
        file.sync_all().map_err(failed)?;
        std::fs::rename(path, output).map_err(failed)?;
        file.metadata().map(|found| found.len()).map_err(failed)
    }

    fn read(&self, id: BlockId) -> Option<Vec<u8>> {
        let place = *self.known.lock().unwrap_or_else(PoisonError::into_inner).get(&id)?;
        let file = match place.file {
            0 => &self.own.as_ref()?.0,
            shard => &self.shards[shard as usize - 1],
        };
        let mut bytes = vec![0; place.length as usize + 16];
        let mut file = file.lock().unwrap_or_else(PoisonError::into_inner);
        file.seek(SeekFrom::Start(place.offset)).and_then(|_| file.read_exact(&mut bytes)).ok()?;
        drop(file);
        record_block(&bytes)
    }
}

impl Blocks for Journal {
    fn begin(&self, kind: PassKind) -> u32 {
        let pass = self.passes.fetch_add(1, Ordering::Relaxed);
        if kind == PassKind::Split {
            let is_first = self.divided.compare_exchange(NO_PASS, pass, Ordering::Relaxed, Ordering::Relaxed).is_ok();
            if is_first {
                self.share_now();
            }
        }
        pass
    }

    fn is_own(&self, id: BlockId) -> bool {
        // Blocks in a row stand near each other and cost about the same: every shard has some of each region.
        let is_divided = id.pass == self.divided.load(Ordering::Relaxed);
        let is_mine = |Shard { index, count }| id.block % count == index - 1;
        !is_divided || (!self.only_shared && self.shard.is_none_or(is_mine))
    }

    fn known(&self, id: BlockId) -> Option<Vec<u8>> {
        self.read(id)
    }

    fn keep(&self, id: BlockId, bytes: &[u8]) {
        let Some((file, path)) = &self.own else { return };
        if self.is_broken.load(Ordering::Relaxed) {
            return;
        }
        let record = record_bytes(id, bytes);
        let mut file = file.lock().unwrap_or_else(PoisonError::into_inner);
        // One piece: a program that is killed leaves it whole, or its beginning at the end of the file.
        if let Err(error) = file.write_all(&record) {
            self.is_broken.store(true, Ordering::Relaxed);
            say(&format!(
                "{}: {error}; the bake goes on, and could not go on from here if it were stopped",
                path.display()
            ));
            return;
        }
        let offset = self.end.fetch_add(record.len() as u64, Ordering::Relaxed);
        let place = Place { file: 0, offset, length: bytes.len() as u32 };
        self.known.lock().unwrap_or_else(PoisonError::into_inner).insert(id, place);
    }

    fn count(&self, found: &[Found]) -> u64 {
        let mut counted = self.counted.lock().unwrap_or_else(PoisonError::into_inner);
        found.iter().filter(|found| counted.insert(found.id)).map(|found| u64::from(found.rays)).sum()
    }

    fn end(&self, pass: u32) -> bool {
        let stops = (self.shard.is_some() || self.only_shared) && pass == self.divided.load(Ordering::Relaxed);
        self.is_done.fetch_or(stops, Ordering::Relaxed);
        !stops
    }

    fn scratch(&self, bytes: u64) -> Option<File> {
        let (_, path) = self.own.as_ref().filter(|_| bytes > MOST_IN_MEMORY)?;
        let folder = if path.is_dir() { path } else { path.parent()? };
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        // Where none can be made, memory has to do.
        tempfile::tempfile_in(folder).ok()
    }
}

/// What is in a file of blocks.
pub struct Scanned {
    pub head: Head,
    /// Block, where its record begins, length of its bytes.
    pub blocks: Vec<(BlockId, u64, u32)>,
    /// Where the last whole record ends.
    pub end: u64,
    /// The last record is that of the end of a shard, and tells the right number of blocks.
    pub is_whole: bool,
}

/// Reads a file of blocks, up to the first damage. `Err`: not even its head can be read, and why.
pub fn scan(file: &mut File) -> Result<Scanned, String> {
    let unreadable = |error: std::io::Error| format!("cannot be read: {error}");
    let size = file.metadata().map_err(unreadable)?.len();
    file.seek(SeekFrom::Start(0)).map_err(unreadable)?;
    let mut reader = BufReader::new(file);
    let mut start = [0; 44];
    reader.read_exact(&mut start).map_err(|_| "is cut off in its head")?;
    if &start[..8] != MAGIC {
        return Err("is no part of a bake".into());
    }
    let length = u32::from_le_bytes([start[40], start[41], start[42], start[43]]);
    if u64::from(length) + 48 > size {
        return Err("is cut off in its head".into());
    }
    let mut rest = vec![0; length as usize + 4];
    reader.read_exact(&mut rest).map_err(unreadable)?;
    let (json, crc) = rest.split_at(length as usize);
    if crc32(&[&start[..], json].concat()).to_le_bytes() != crc {
        return Err("its head is damaged".into());
    }
    let head: Head = serde_json::from_slice(json).map_err(|error| format!("its head cannot be read: {error}"))?;
    if head.request.key() != start[8..40] {
        return Err("its head contradicts itself".into());
    }
    let mut end = 48 + u64::from(length);
    let mut blocks = Vec::new();
    let mut is_whole = false;
    let mut record = Vec::new();
    loop {
        record.resize(12, 0);
        if reader.read_exact(&mut record).is_err() {
            break;
        }
        let Some((id, length)) = record_head(&record) else { break };
        if u64::from(length) + 16 > size - end {
            break;
        }
        record.resize(length as usize + 16, 0);
        if reader.read_exact(&mut record[12..]).is_err() || record_block(&record).is_none() {
            break;
        }
        if id.pass == END {
            is_whole = id.block as usize == blocks.len() && end + 16 == size;
            break;
        }
        blocks.push((id, end, length));
        end += u64::from(length) + 16;
    }
    Ok(Scanned { head, blocks, end, is_whole })
}

fn head_bytes(head: &Head) -> Vec<u8> {
    let json = serde_json::to_vec(head).expect("a head is plain data");
    let mut bytes = [&MAGIC[..], &head.request.key(), &(json.len() as u32).to_le_bytes(), &json].concat();
    bytes.extend(crc32(&bytes).to_le_bytes());
    bytes
}

fn record_bytes(id: BlockId, block: &[u8]) -> Vec<u8> {
    let numbers = [id.pass, id.block, block.len() as u32].map(u32::to_le_bytes);
    let mut bytes = [numbers.as_flattened(), block].concat();
    bytes.extend(crc32(&bytes).to_le_bytes());
    bytes
}

/// The first numbers of a record.
fn record_head(record: &[u8]) -> Option<(BlockId, u32)> {
    let number = |at: usize| Some(u32::from_le_bytes(record.get(4 * at..4 * at + 4)?.try_into().ok()?));
    let length = number(2)?;
    (length <= MOST_BYTES).then_some((BlockId { pass: number(0)?, block: number(1)? }, length))
}

/// The block of a whole record.
fn record_block(record: &[u8]) -> Option<Vec<u8>> {
    let (body, crc) = record.split_at_checked(record.len().checked_sub(4)?)?;
    (crc32(body).to_le_bytes() == crc).then(|| body[12..].to_vec())
}
