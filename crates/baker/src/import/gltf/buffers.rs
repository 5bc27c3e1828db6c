//! Buffers and buffer views: the bytes that accessors and images lie in. Loaded when first asked for, so that a buffer
//! that only an animation uses may be missing.

use std::borrow::Cow;
use std::cell::OnceCell;

use gltf::json;

use super::document::Document;
use super::{meshopt, uri};
use crate::Result;

/// The bytes of a level.
pub(super) struct Buffers<'a> {
    pub document: &'a Document<'a>,
    /// What was loaded, per buffer.
    loaded: Vec<OnceCell<Cow<'a, [u8]>>>,
    /// What was decompressed, per buffer view.
    decoded: Vec<OnceCell<Vec<u8>>>,
}

/// The bytes of one buffer view.
#[derive(Clone, Copy)]
pub(super) struct View<'b> {
    pub bytes: &'b [u8],
    /// Bytes from one element to the next, if the view says so.
    pub stride: Option<usize>,
}

impl<'a> Buffers<'a> {
    /// Nothing is loaded yet.
    pub fn new(document: &'a Document<'a>) -> Self {
        Buffers {
            document,
            loaded: document.buffers.iter().map(|_| OnceCell::new()).collect(),
            decoded: document.buffer_views.iter().map(|_| OnceCell::new()).collect(),
        }
    }

    /// The bytes of buffer view `index`, decompressed where needed; `place` says who asks.
    pub fn view(&self, index: usize, place: &dyn std::fmt::Display) -> Result<View<'_>> {
        let view = self.document.get(&self.document.buffer_views, index, "bufferView", place)?;
        let place = format!("bufferView {index}");
        let stride = view.byte_stride.as_ref().map(|stride| stride.0).filter(|&stride| stride > 0);
        // A build without the decoder takes the plain copy, if the file brings one.
        if let Some(compressed) = meshopt::extension_of(self.document, view, &place)?
            && (cfg!(feature = "meshopt") || !self.has_fallback(view))
        {
            let bytes = match self.decoded[index].get() {
                Some(bytes) => bytes,
                None => {
                    let encoded =
                        self.slice(compressed.buffer, compressed.byte_offset, compressed.byte_length, &place)?;
                    let bytes = meshopt::decode(self.document, &compressed, encoded, &place)?;
                    self.decoded[index].get_or_init(|| bytes)
                }
            };
            return Ok(View { bytes, stride });
        }
        let offset = view.byte_offset.map_or(0, |offset| offset.0);
        let bytes = self.slice(view.buffer.value(), offset, view.byte_length.0, &place)?;
        Ok(View { bytes, stride })
    }

    /// Whether a compressed view also lies in a buffer that has bytes.
    fn has_fallback(&self, view: &json::buffer::View) -> bool {
        self.document.buffers.get(view.buffer.value()).is_some_and(|buffer| buffer.uri.is_some())
    }

    /// `length` bytes of a buffer from `offset`.
    fn slice(&self, buffer: usize, offset: u64, length: u64, place: &str) -> Result<&[u8]> {
        let bytes = self.buffer(buffer, place)?;
        let end = offset.checked_add(length);
        end.and_then(|end| bytes.get(usize::try_from(offset).ok()?..usize::try_from(end).ok()?)).ok_or_else(|| {
            self.document.invalid(format!(
                "{place}: needs {length} bytes from byte {offset} of buffer {buffer}, which has {}; the file is \
                 truncated or damaged",
                bytes.len()
            ))
        })
    }

    /// The bytes of a buffer, cut to its `byteLength`.
    fn buffer(&self, index: usize, place: &str) -> Result<&[u8]> {
        let buffer = self.document.get(&self.document.buffers, index, "buffer", &place)?;
        let cell = &self.loaded[index];
        let bytes: &Cow<[u8]> = match cell.get() {
            Some(bytes) => bytes,
            None => {
                let bytes = self.load(index, buffer)?;
                cell.get_or_init(|| bytes)
            }
        };
        let length = buffer.byte_length.0;
        usize::try_from(length).ok().and_then(|length| bytes.get(..length)).ok_or_else(|| {
            self.document.invalid(format!(
                "buffer {index}: byteLength says {length} bytes, {} were found; the file is truncated",
                bytes.len()
            ))
        })
    }

    fn load(&self, index: usize, buffer: &json::Buffer) -> Result<Cow<'a, [u8]>> {
        match (&buffer.uri, self.document.binary) {
            (Some(uri), _) => Ok(Cow::Owned(uri::load(uri, self.document, &format!("buffer {index}"))?)),
            (None, Some(binary)) if index == 0 => Ok(Cow::Borrowed(binary)),
            (None, _) => Err(self.document.invalid(format!(
                "buffer {index}: it has no uri{}",
                if index == 0 {
                    ", and the file has no binary chunk"
                } else {
                    "; only buffer 0 of a GLB may have none"
                }
            ))),
        }
    }
}
