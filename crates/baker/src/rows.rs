//! A table with a row per node: in memory, or in a file where one is lent for it, of which some pages are in memory.
//!
//! ```text
//! file   page 0, page 1, …: PAGE_ROWS rows each, their elements as bytes; a page that was never written is zeros
//! slots  SLOTS pages that were read or changed last: a page has one slot, by a hash of its number, and is written when another one
//!        takes that
//! ```
//! Nodes are baked along a Z-order curve, cube by cube. A cube of 32³ nodes lies in some 3000 pages, of which few share a slot. All else
//! goes through nodes in order.

use std::collections::HashMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::ops::Deref;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use gdibl_runtime::sh;

use crate::blocks::Blocks;

const PAGE_ROWS: usize = 16;
const SLOT_BITS: u32 = 14;
/// The most numbers of a node.
const MOST: usize = 3 * sh::MAX_COEFFICIENTS;

/// What a table holds. The default is that of zero bytes.
pub trait Element: Copy + Default {
    /// Bytes of one.
    const BYTES: usize;
    /// As bytes.
    fn to_bytes(self, bytes: &mut [u8]);
    /// From bytes that [`to_bytes`](Element::to_bytes) wrote.
    fn from_bytes(bytes: &[u8]) -> Self;
}

impl Element for f32 {
    const BYTES: usize = 4;

    fn to_bytes(self, bytes: &mut [u8]) {
        bytes.copy_from_slice(&self.to_le_bytes());
    }

    fn from_bytes(bytes: &[u8]) -> f32 {
        f32::from_le_bytes(bytes.try_into().expect("four bytes"))
    }
}

/// Rows of elements, all of one width.
#[derive(Debug)]
pub struct Table<T = f32> {
    rows: usize,
    width: usize,
    store: Store<T>,
}

#[derive(Debug)]
enum Store<T> {
    /// Row by row.
    Held(Vec<T>),
    Paged(Paged<T>),
}

impl<T: Element> Table<T> {
    /// Rows of zeros, in a file if `blocks` lends one.
    pub fn zeros(rows: usize, width: usize, blocks: Option<&dyn Blocks>) -> Table<T> {
        let bytes = (rows * width * T::BYTES) as u64;
        let store = match blocks.and_then(|blocks| blocks.scratch(bytes)) {
            Some(file) => Store::Paged(Paged::new(file, width)),
            None => Store::Held(vec![T::default(); rows * width]),
        };
        Table { rows, width, store }
    }

    /// Those of a list, row by row, in memory.
    ///
    /// # Panics
    /// If they are no whole number of rows.
    pub fn held(width: usize, all: Vec<T>) -> Table<T> {
        assert!(width > 0 && all.len().is_multiple_of(width), "{} elements in rows of {width}", all.len());
        Table { rows: all.len() / width, width, store: Store::Held(all) }
    }

    /// How many rows.
    pub fn len(&self) -> usize {
        self.rows
    }

    /// No row at all.
    pub fn is_empty(&self) -> bool {
        self.rows == 0
    }

    /// Elements of a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Copies a row.
    ///
    /// # Panics
    /// If there is no such row, as all that take its number; and if the file can no longer be read.
    pub fn copy(&self, row: usize, to: &mut [T]) {
        match &self.store {
            Store::Held(all) => to.copy_from_slice(&all[row * self.width..][..to.len()]),
            Store::Paged(pages) => {
                assert!(row < self.rows, "row {row} of {}", self.rows);
                pages.with(row, |own, _| to.copy_from_slice(&own[..to.len()]));
            }
        }
    }

    /// The first element of a row.
    pub fn first(&self, row: usize) -> T {
        let mut one = [T::default()];
        self.copy(row, &mut one);
        one[0]
    }

    /// The first elements of all rows, in order.
    pub fn firsts(&self) -> impl Iterator<Item = T> {
        (0..self.rows).map(|row| self.first(row))
    }

    /// Writes a row.
    pub fn set(&mut self, row: usize, values: &[T]) {
        match &mut self.store {
            Store::Held(all) => all[row * self.width..][..self.width].copy_from_slice(values),
            Store::Paged(pages) => {
                assert!(row < self.rows, "row {row} of {}", self.rows);
                let width = self.width;
                pages.with(row, |own, is_changed| {
                    own[..width].copy_from_slice(values);
                    *is_changed = true;
                });
            }
        }
    }

    /// Rows of another one behind these.
    pub fn append(&mut self, other: Table<T>) {
        assert!(self.width == other.width, "rows of {} and {}", self.width, other.width);
        let mut all = std::mem::replace(&mut self.store, Store::Held(Vec::new())).into_held(self.rows, self.width);
        all.extend(other.store.into_held(other.rows, other.width));
        *self = Table::held(self.width, all);
    }

    /// Some rows, in this order.
    pub fn selected(&self, rows: impl Iterator<Item = usize>) -> Table<T> {
        let mut all = Vec::new();
        for row in rows {
            let first = all.len();
            all.resize(first + self.width, T::default());
            self.copy(row, &mut all[first..]);
        }
        Table::held(self.width, all)
    }

    /// The first columns alone.
    pub fn narrowed(self, width: usize) -> Table<T> {
        assert!(width <= self.width, "{width} of {} columns", self.width);
        let store = match self.store {
            Store::Held(all) => {
                Store::Held(all.chunks_exact(self.width).flat_map(|row| &row[..width]).copied().collect())
            }
            paged => paged,
        };
        Table { width, store, ..self }
    }

    /// Changes rows in place, one after the other.
    pub fn update(&mut self, mut change: impl FnMut(usize, &mut [T])) {
        let mut values = vec![T::default(); self.width];
        for row in 0..self.rows {
            self.copy(row, &mut values);
            change(row, &mut values);
            self.set(row, &values);
        }
    }

    /// All elements, row by row.
    pub fn to_vec(&self) -> Vec<T> {
        self.selected(0..self.rows).store.into_held(self.rows, self.width)
    }
}

impl Table {
    /// A row of numbers.
    pub fn row(&self, row: usize) -> Row<'_> {
        match &self.store {
            Store::Held(all) => Row::Held(&all[row * self.width..][..self.width]),
            Store::Paged(_) => {
                let mut values = [0.0; MOST];
                self.copy(row, &mut values[..self.width]);
                Row::Copied(values, self.width)
            }
        }
    }
}

impl<T: Element> Clone for Table<T> {
    /// In memory.
    fn clone(&self) -> Table<T> {
        self.selected(0..self.rows)
    }
}

impl<T: Element + PartialEq> PartialEq for Table<T> {
    fn eq(&self, other: &Table<T>) -> bool {
        let mut pair = [vec![T::default(); self.width], vec![T::default(); self.width]];
        let mut is_same = |row: usize| {
            self.copy(row, &mut pair[0]);
            other.copy(row, &mut pair[1]);
            pair[0] == pair[1]
        };
        (self.rows, self.width) == (other.rows, other.width) && (0..self.rows).all(&mut is_same)
    }
}

/// Numbers of a row.
#[derive(Debug, Clone)]
#[expect(clippy::large_enum_variant, reason = "a box would be an allocation per node")]
pub enum Row<'a> {
    /// Where they are.
    Held(&'a [f32]),
    /// Of a file: so many of these.
    Copied([f32; MOST], usize),
}

impl Deref for Row<'_> {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        match self {
            Row::Held(values) => values,
            Row::Copied(values, width) => &values[..*width],
        }
    }
}

impl<T: Element> Store<T> {
    fn into_held(self, rows: usize, width: usize) -> Vec<T> {
        match self {
            Store::Held(all) => all,
            paged => Table { rows, width, store: paged }.to_vec(),
        }
    }
}

/// Pages of a file.
#[derive(Debug)]
struct Paged<T> {
    /// With room for the bytes of a page.
    file: Mutex<(File, Vec<u8>)>,
    slots: Vec<Mutex<Slot<T>>>,
    /// Elements of a row in the file.
    width: usize,
    /// Pages that the file did not take: its disk is full.
    kept: Mutex<HashMap<usize, Vec<T>>>,
    has_kept: AtomicBool,
}

#[derive(Debug, Clone)]
struct Slot<T> {
    /// `None`: no page yet.
    page: Option<usize>,
    is_changed: bool,
    values: Vec<T>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<T: Element> Paged<T> {
    fn new(file: File, width: usize) -> Paged<T> {
        let bytes = vec![0; PAGE_ROWS * width * T::BYTES];
        let slot = || Mutex::new(Slot { page: None, is_changed: false, values: Vec::new() });
        Paged {
            file: Mutex::new((file, bytes)),
            slots: std::iter::repeat_with(slot).take(1 << SLOT_BITS).collect(),
            width,
            kept: Mutex::default(),
            has_kept: AtomicBool::new(false),
        }
    }

    /// Calls `with` a row, and with whether its page differs from the file's.
    fn with(&self, row: usize, with: impl FnOnce(&mut [T], &mut bool)) {
        let page = row / PAGE_ROWS;
        // Knuth's multiplicative hash: the golden ratio.
        let slot = (page as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (u64::BITS - SLOT_BITS);
        let mut slot = locked(&self.slots[slot as usize]);
        if slot.page != Some(page) {
            self.write(&mut slot);
            self.read(page, &mut slot);
        }
        let Slot { is_changed, values, .. } = &mut *slot;
        with(&mut values[row % PAGE_ROWS * self.width..][..self.width], is_changed);
    }

    /// Brings a page that was changed to the file. One that it does not take stays in memory.
    fn write(&self, slot: &mut Slot<T>) {
        let Some(page) = slot.page.filter(|_| slot.is_changed) else { return };
        let mut file = locked(&self.file);
        let (file, bytes) = &mut *file;
        let parts = bytes.chunks_exact_mut(T::BYTES);
        parts.zip(&slot.values).for_each(|(bytes, value)| value.to_bytes(bytes));
        let place = SeekFrom::Start((page * bytes.len()) as u64);
        if file.seek(place).and_then(|_| file.write_all(bytes)).is_err() {
            locked(&self.kept).insert(page, slot.values.clone());
            self.has_kept.store(true, Ordering::Release);
        }
        slot.is_changed = false;
    }

    fn read(&self, page: usize, slot: &mut Slot<T>) {
        slot.page = Some(page);
        slot.values.resize(PAGE_ROWS * self.width, T::default());
        let kept = self.has_kept.load(Ordering::Acquire).then(|| locked(&self.kept).remove(&page)).flatten();
        if let Some(kept) = kept {
            (slot.values, slot.is_changed) = (kept, true);
            return;
        }
        let mut file = locked(&self.file);
        let (file, bytes) = &mut *file;
        let place = SeekFrom::Start((page * bytes.len()) as u64);
        let read = file.seek(place).and_then(|_| read_or_zeros(file, bytes));
        read.unwrap_or_else(|error| panic!("a temporary file can no longer be read: {error}"));
        let parts = bytes.chunks_exact(T::BYTES);
        parts.zip(&mut slot.values).for_each(|(bytes, value)| *value = T::from_bytes(bytes));
    }
}

/// Fills the bytes; with zeros from where the file ends.
fn read_or_zeros(file: &mut File, bytes: &mut [u8]) -> std::io::Result<()> {
    let mut filled = 0;
    while filled < bytes.len() {
        match file.read(&mut bytes[filled..]) {
            Ok(0) => break,
            Ok(count) => filled += count,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    bytes[filled..].fill(0);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blocks::{BlockId, Found, PassKind};
    use rayon::prelude::*;

    /// Lends a file for every table; one that cannot be written, if asked to.
    struct Lends {
        is_read_only: bool,
    }

    impl Blocks for Lends {
        fn begin(&self, _: PassKind) -> u32 {
            0
        }
        fn is_own(&self, _: BlockId) -> bool {
            true
        }
        fn known(&self, _: BlockId) -> Option<Vec<u8>> {
            None
        }
        fn keep(&self, _: BlockId, _: &[u8]) {}
        fn count(&self, _: &[Found]) -> u64 {
            0
        }
        fn end(&self, _: u32) -> bool {
            true
        }
        fn scratch(&self, _: u64) -> Option<File> {
            let file = tempfile::NamedTempFile::new().unwrap();
            Some(if self.is_read_only { File::open(file.path()).unwrap() } else { file.into_file() })
        }
    }

    /// More pages than there are slots.
    const ROWS: usize = (3 * PAGE_ROWS) << SLOT_BITS;

    fn value(row: usize, column: usize) -> f32 {
        (row * 7 + column) as f32
    }

    #[test]
    fn a_table_in_a_file_is_the_same_as_one_in_memory_also_on_a_full_disk() {
        for is_read_only in [false, true] {
            let lends = Lends { is_read_only };
            let mut paged: Table = Table::zeros(ROWS, 3, Some(&lends));
            assert!(matches!(paged.store, Store::Paged(_)));
            let mut held = Table::zeros(ROWS, 3, None);
            // Every other row, in an order that jumps between pages.
            for number in (0..ROWS).step_by(2) {
                let row = number * 40_503 % ROWS;
                let values = [0, 1, 2].map(|column| value(row, column));
                paged.set(row, &values);
                held.set(row, &values);
            }
            assert!(paged == held, "read only: {is_read_only}");
            let differs = |row: &usize| *paged.row(*row) != *held.row(*row);
            assert_eq!((0..ROWS).into_par_iter().find_any(differs), None);
            let (paged, held) = (paged.narrowed(2), held.narrowed(2));
            assert_eq!((paged.width(), &*paged.row(2)), (2, &*held.row(2)));
            assert!(paged.clone() == held);
        }
    }

    #[test]
    fn tables_append_select_and_change_rows() {
        let mut table = Table::held(2, vec![1.0, 2.0, 3.0, 4.0]);
        table.append(Table::held(2, vec![5.0, 6.0]));
        table.update(|row, values| values[1] += row as f32);
        assert_eq!(table.to_vec(), [1.0, 2.0, 3.0, 5.0, 5.0, 8.0]);
        assert_eq!(table.selected([2, 0].into_iter()).to_vec(), [5.0, 8.0, 1.0, 2.0]);
        assert_eq!(table.firsts().collect::<Vec<f32>>(), [1.0, 3.0, 5.0]);
    }
}
