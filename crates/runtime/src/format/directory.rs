//! Reads header and section table, and finds sections by them.

use super::{
    ALIGNMENT, Codec, ENTRY_SIZE, HEADER_SIZE, Header, Limits, MAX_SECTIONS, SectionEntry, crc32, directory_size,
    parse_magic_and_version, read_u32, truncated,
};
use crate::error::text;
use crate::{Error, bits, codec};
use alloc::borrow::Cow;
use alloc::string::String;
use alloc::vec::Vec;

/// A file whose header and section table have been read and checked, and whose sections have not.
#[derive(Clone, Debug)]
pub struct Directory<'a> {
    /// The fixed part.
    pub header: Header,
    /// The section table, in the order of the file.
    pub sections: Vec<SectionEntry>,
    bytes: &'a [u8],
}

/// Reads header and section table of a file, given all of its bytes. Checks everything but the contents of sections:
/// the table's checksum, that sections lie where they must, that nothing lies between or behind them.
pub fn parse_header_and_sections(bytes: &[u8]) -> Result<Directory<'_>, Error> {
    parse_magic_and_version(bytes)?;
    if bytes.len() < HEADER_SIZE {
        return Err(truncated(bytes, HEADER_SIZE as u64));
    }
    // The checksum comes before any word is believed, so that damage is called damage. Only the count of sections is
    // needed to find it.
    let count = (read_u32(bytes, 44) as usize).min(MAX_SECTIONS);
    let size = directory_size(count);
    if bytes.len() < size {
        return Err(truncated(bytes, size as u64));
    }
    let (found, expected) = (crc32(&bytes[..size - 4]), read_u32(bytes, size - 4));
    if found != expected {
        return Err(Error::invalid(
            "header and section table",
            text!("checksum {found:08x}"),
            text!("{expected:08x}, as written: the file is damaged"),
        ));
    }
    let (header, _) = Header::parse(bytes)?;
    let mut sections: Vec<SectionEntry> = Vec::with_capacity(count);
    let mut end = size as u64;
    for row in bytes[HEADER_SIZE..size - 4].chunks_exact(ENTRY_SIZE) {
        let entry = SectionEntry::parse(row)?;
        if sections.iter().any(|earlier| earlier.id == entry.id) {
            return Err(Error::invalid(entry.place(), "two of them", "one at most"));
        }
        entry.check_sizes(&header)?;
        end = check_place(bytes, &entry, end)?;
        sections.push(entry);
    }
    if end != bytes.len() as u64 {
        return Err(Error::invalid(
            "end of file",
            text!("{} bytes", bytes.len()),
            text!("{end} bytes: nothing after the last section"),
        ));
    }
    Ok(Directory { header, sections, bytes })
}

impl<'a> Directory<'a> {
    /// The table's row of section `id`.
    pub fn section(&self, id: [u8; 4]) -> Option<&SectionEntry> {
        self.sections.iter().find(|entry| entry.id == id)
    }

    /// The contents of section `id`: checksum compared, decompressed, shuffle undone. None if there is no such
    /// section.
    pub fn section_bytes(&self, id: [u8; 4], limits: &Limits) -> Result<Option<Cow<'a, [u8]>>, Error> {
        let Some(entry) = self.section(id) else {
            return Ok(None);
        };
        if entry.raw_size > limits.max_bytes {
            return Err(over_limit(&entry.place(), entry.raw_size, limits));
        }
        self.check_crc32(entry)?;
        self.checked_section_bytes(id)
    }

    /// The same, once [`check_contents`](Directory::check_contents) has passed.
    pub(crate) fn checked_section_bytes(&self, id: [u8; 4]) -> Result<Option<Cow<'a, [u8]>>, Error> {
        let Some(entry) = self.section(id) else {
            return Ok(None);
        };
        codec::decode(&self.header, entry, self.stored_bytes(entry)).map(Some)
    }

    /// Section `id` as packed bits, if it is that. Once [`check_contents`](Directory::check_contents) has passed.
    pub(crate) fn checked_section_bits(&self, id: [u8; 4]) -> Result<Option<bits::Section<'a>>, Error> {
        let entry = self.section(id).filter(|entry| entry.codec == Codec::Bits);
        entry.map(|entry| bits::Section::parse(entry, self.stored_bytes(entry))).transpose()
    }

    /// Compares the checksum of every section, also of those nobody reads.
    pub(crate) fn check_contents(&self, limits: &Limits) -> Result<(), Error> {
        let sizes = self.sections.iter().map(|entry| entry.raw_size);
        let total = sizes.fold(0, u64::saturating_add);
        if total > limits.max_bytes {
            return Err(over_limit("section table", total, limits));
        }
        self.sections.iter().try_for_each(|entry| self.check_crc32(entry))
    }

    fn stored_bytes(&self, entry: &SectionEntry) -> &'a [u8] {
        // `parse_header_and_sections` has seen that these are within the file.
        let start = entry.offset as usize;
        &self.bytes[start..start + entry.stored_size as usize]
    }

    fn check_crc32(&self, entry: &SectionEntry) -> Result<(), Error> {
        let found = crc32(self.stored_bytes(entry));
        if found != entry.crc32 {
            return Err(Error::invalid(
                entry.place(),
                text!("checksum {found:08x}"),
                text!("{:08x}, as written: the file is damaged", entry.crc32),
            ));
        }
        Ok(())
    }
}

/// Checks that a section begins where it must after `end`, with zeros before it, and fits. Returns where it ends.
fn check_place(bytes: &[u8], entry: &SectionEntry, end: u64) -> Result<u64, Error> {
    let start = end.next_multiple_of(ALIGNMENT);
    if entry.offset != start {
        return Err(Error::invalid(
            entry.place(),
            text!("offset {}", entry.offset),
            text!("{start}: right after what is before it"),
        ));
    }
    let Some(next) = start.checked_add(entry.stored_size).filter(|&next| next <= bytes.len() as u64) else {
        return Err(Error::invalid(
            entry.place(),
            text!("{} bytes from {start}", entry.stored_size),
            text!("to end within the file of {} bytes", bytes.len()),
        ));
    };
    if bytes[end as usize..start as usize].iter().any(|&byte| byte != 0) {
        return Err(Error::invalid(String::from("before ") + &entry.place(), "padding other than zeros", "zeros"));
    }
    Ok(next)
}

fn over_limit(place: &str, found: u64, limits: &Limits) -> Error {
    Error::unsupported(
        place,
        text!("{found} bytes once decompressed"),
        text!("at most {}, the reader's limit", limits.max_bytes),
    )
}
