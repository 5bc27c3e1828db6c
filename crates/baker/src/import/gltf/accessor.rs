//! Accessors: typed elements in a buffer view, possibly strided, normalised or sparse.
//!
//! [`Elements::open`] checks that every byte of every element is there; after that reading cannot fail.

use gltf::json::accessor::{ComponentType, Type};
use gltf::json::mesh::{Primitive, Semantic};
use gltf::json::validation::Checked;

use super::buffers::{Buffers, View};
use crate::Result;

/// An accessor without a buffer view is all zeros, whatever it counts: a file of 300 bytes may claim billions. No real
/// morph target comes near this.
const MAX_COUNT_WITHOUT_DATA: u64 = 1 << 24;

pub(super) type AccessorIndex = gltf::json::Index<gltf::json::Accessor>;

/// The accessor of an attribute.
pub(super) fn attribute(primitive: &Primitive, semantic: Semantic) -> Option<AccessorIndex> {
    primitive.attributes.get(&Checked::Valid(semantic)).copied()
}

/// The elements of one accessor.
pub(super) struct Elements<'b> {
    /// How many.
    pub count: usize,
    /// SCALAR, VEC3, ...
    pub kind: Type,
    /// u8, f32, ...
    pub component: ComponentType,
    normalized: bool,
    stride: usize,
    /// From the first byte of the first element; none: all zeros.
    bytes: Option<&'b [u8]>,
    /// Element indices, strictly increasing, and their values, tightly packed.
    sparse: Option<(Vec<u32>, &'b [u8])>,
}

impl<'b> Elements<'b> {
    /// Opens accessor `index`, which must be one of `kinds`; `place` says who asks ("mesh 0 primitive 1: POSITION").
    pub fn open(buffers: &'b Buffers, index: usize, kinds: &[Type], place: &str) -> Result<Self> {
        let document = buffers.document;
        let accessor = document.get(&document.accessors, index, "accessor", &place)?;
        let place = format!("{place}: accessor {index}");
        let (Checked::Valid(kind), Checked::Valid(component)) = (accessor.type_, accessor.component_type) else {
            return Err(document.invalid(format!("{place}: unknown type or componentType; the file is damaged")));
        };
        if !kinds.contains(&kind) {
            return Err(document.invalid(format!("{place}: its type is {kind:?}; expected {kinds:?}")));
        }
        let component = component.0;
        let size = component.size() * kind.multiplicity();
        let declared = accessor.count.0;
        if accessor.buffer_view.is_none() && declared > MAX_COUNT_WITHOUT_DATA {
            return Err(document.unsupported(format!(
                "{place}: {declared} elements without a bufferView; at most {MAX_COUNT_WITHOUT_DATA} are read"
            )));
        }
        let count = usize::try_from(declared)
            .map_err(|_| document.invalid(format!("{place}: a count of {declared} cannot be; the file is damaged")))?;

        let (bytes, stride) = match accessor.buffer_view {
            None => (None, size),
            Some(view) => {
                let offset = accessor.byte_offset.map_or(0, |offset| offset.0);
                let view_index = view.value();
                let view = buffers.view(view_index, &place)?;
                let (bytes, stride) = slice(buffers, view, view_index, offset, count, size, &place)?;
                (Some(bytes), stride)
            }
        };
        let sparse = match &accessor.sparse {
            None => None,
            Some(sparse) => Some(open_sparse(buffers, sparse, count, size, &place)?),
        };
        Ok(Elements { count, kind, component, normalized: accessor.normalized, stride, bytes, sparse })
    }

    /// Reads integers as normalised ones, whatever the accessor says; returns whether that changes what is read.
    pub fn normalize(&mut self) -> bool {
        let changes = !self.normalized && self.component != ComponentType::F32;
        self.normalized |= changes;
        changes
    }

    /// Whether a buffer view lies behind it, so that its count is bounded by bytes.
    pub fn has_data(&self) -> bool {
        self.bytes.is_some()
    }

    /// The bytes of element `i`; none means zeros.
    fn element(&self, i: usize) -> Option<&'b [u8]> {
        assert!(i < self.count, "element {i} of {}", self.count);
        let size = self.component.size() * self.kind.multiplicity();
        if let Some((indices, values)) = &self.sparse {
            // `indices` are u32, so an element beyond has no sparse value.
            if let Ok(at) = indices.binary_search_by(|&index| (index as usize).cmp(&i)) {
                return Some(&values[at * size..(at + 1) * size]);
            }
        }
        self.bytes.map(|bytes| &bytes[i * self.stride..i * self.stride + size])
    }

    /// The first `N` components of element `i` as real numbers; normalised integers become 0..=1 or -1..=1.
    /// `N` must not exceed the components it has.
    pub fn vector<const N: usize>(&self, i: usize) -> [f32; N] {
        assert!(N <= self.kind.multiplicity(), "{N} components of {:?}", self.kind);
        let Some(bytes) = self.element(i) else { return [0.0; N] };
        let size = self.component.size();
        std::array::from_fn(|c| {
            let b = &bytes[c * size..];
            let (value, one) = match self.component {
                ComponentType::I8 => (f32::from(b[0] as i8), 127.0),
                ComponentType::U8 => (f32::from(b[0]), 255.0),
                ComponentType::I16 => (f32::from(i16::from_le_bytes([b[0], b[1]])), 32767.0),
                ComponentType::U16 => (f32::from(u16::from_le_bytes([b[0], b[1]])), 65535.0),
                ComponentType::U32 => (u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f32, u32::MAX as f32),
                ComponentType::F32 => return f32::from_le_bytes([b[0], b[1], b[2], b[3]]),
            };
            if self.normalized { (value / one).max(-1.0) } else { value }
        })
    }

    /// Element `i` as an index (unsigned components only; 0 otherwise).
    pub fn index(&self, i: usize) -> u32 {
        match (self.element(i), self.component) {
            (Some(b), ComponentType::U8) => u32::from(b[0]),
            (Some(b), ComponentType::U16) => u32::from(u16::from_le_bytes([b[0], b[1]])),
            (Some(b), ComponentType::U32) => u32::from_le_bytes([b[0], b[1], b[2], b[3]]),
            _ => 0,
        }
    }
}

/// The bytes of `count` elements of `size` bytes in a view, and the stride between them.
fn slice<'b>(
    buffers: &Buffers,
    view: View<'b>,
    view_index: usize,
    offset: u64,
    count: usize,
    size: usize,
    place: &str,
) -> Result<(&'b [u8], usize)> {
    let stride = view.stride.unwrap_or(size);
    if stride < size {
        return Err(buffers.document.invalid(format!(
            "{place}: elements of {size} bytes in bufferView {view_index} with byteStride {stride}; expected at least \
             {size}"
        )));
    }
    // offset + (count - 1) * stride + size, in numbers that hold it.
    let length = match count {
        0 => 0,
        count => (count as u128 - 1) * stride as u128 + size as u128,
    };
    let end = u128::from(offset) + length;
    if end > view.bytes.len() as u128 {
        return Err(buffers.document.invalid(format!(
            "{place}: needs bytes {offset}..{end} of bufferView {view_index}, which has {}; the file is truncated or \
             damaged",
            view.bytes.len()
        )));
    }
    Ok((&view.bytes[offset as usize..end as usize], stride))
}

/// Reads sparse indices and finds their values.
fn open_sparse<'b>(
    buffers: &'b Buffers,
    sparse: &gltf::json::accessor::sparse::Sparse,
    count: usize,
    size: usize,
    place: &str,
) -> Result<(Vec<u32>, &'b [u8])> {
    let document = buffers.document;
    let place = format!("{place} sparse");
    let Checked::Valid(component) = sparse.indices.component_type else {
        return Err(document.invalid(format!("{place}: unknown componentType of its indices; the file is damaged")));
    };
    let component = component.0;
    let number = usize::try_from(sparse.count.0).ok().filter(|&number| number <= count).ok_or_else(|| {
        document.invalid(format!("{place}: {} values for {count} elements; the file is damaged", sparse.count.0))
    })?;

    let index_view = buffers.view(sparse.indices.buffer_view.value(), &place)?;
    let index_view = View { stride: None, ..index_view };
    let (index_bytes, stride) = slice(
        buffers,
        index_view,
        sparse.indices.buffer_view.value(),
        sparse.indices.byte_offset.0,
        number,
        component.size(),
        &place,
    )?;
    let reader = Elements {
        count: number,
        kind: Type::Scalar,
        component,
        normalized: false,
        stride,
        bytes: Some(index_bytes),
        sparse: None,
    };
    let indices: Vec<u32> = (0..number).map(|i| reader.index(i)).collect();
    if let Some(i) = (1..number).find(|&i| indices[i] <= indices[i - 1]) {
        return Err(document.invalid(format!(
            "{place}: index {} after {}; they must increase strictly",
            indices[i],
            indices[i - 1]
        )));
    }
    if let Some(&last) = indices.last().filter(|&&last| last as usize >= count) {
        return Err(document.invalid(format!("{place}: index {last} of {count} elements; the file is damaged")));
    }

    let value_view = buffers.view(sparse.values.buffer_view.value(), &place)?;
    let value_view = View { stride: None, ..value_view };
    let (values, _) = slice(
        buffers,
        value_view,
        sparse.values.buffer_view.value(),
        sparse.values.byte_offset.0,
        number,
        size,
        &place,
    )?;
    Ok((indices, values))
}
