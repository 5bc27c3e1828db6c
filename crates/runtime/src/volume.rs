//! A parsed file: coefficients per node, and what is known of each node.
//!
//! A file holds coefficients in planes (all nodes' first value, then all nodes' second, …), which compress well. A
//! sample wants all values of few nodes, so that parsing turns the planes round: here every node's values lie
//! together, coefficient by coefficient, red green blue. They stay 16-bit where the file's are, two to a word; packed ones become
//! that, too.

use crate::bricks::Bricks;
use crate::coefficients::{Coefficients, Numbers, half_of, words_of};
use crate::error::text;
use crate::format::{
    self, BRICKS, COVERAGE, Directory, Encoding, Header, Kind, Limits, MESHES, NORMALS, POSITIONS, RADIANCE,
    STANDARD_ERROR, VALIDITY, WALLS,
};
use crate::grid::Finder;
use crate::half::{f16_is_finite, f16_is_subnormal, f16_to_f32};
use crate::nearest::NearestIndex;
use crate::walls::{Plane, WallCell, Walls};
use crate::{Cell, Error, Grid, RadianceSh, packed};
use alloc::collections::BinaryHeap;
use alloc::vec;
use alloc::vec::Vec;
use core::ops::Range;

/// Irradiance volume, ready to sample: see [`sample`](crate::sample) for that.
#[derive(Clone, Debug)]
pub struct Volume {
    pub(crate) header: Header,
    /// Of [`grid`](Volume::grid): finds cells in it.
    pub(crate) finder: Finder,
    pub(crate) coefficients: Coefficients,
    /// Coefficient = number × scale.
    pub(crate) scale: f32,
    /// [`VALID`] and [`SUBNORMAL`] of each node; None where all are valid and none is subnormal.
    pub(crate) marks: Option<Vec<u8>>,
    pub(crate) walls: Option<Walls>,
    /// Of a sparse grid.
    pub(crate) bricks: Option<Bricks>,
    coverage: Option<Vec<u16>>,
    relative_error: Option<Vec<u16>>,
    /// Points and vertices; relative to the header's min.
    pub(crate) positions: Vec<[f32; 3]>,
    pub(crate) index: NearestIndex,
    /// Vertices.
    pub(crate) normals: Vec<[f32; 3]>,
    meshes: Vec<VertexSet>,
}

/// A node's mark: it was baked.
pub(crate) const VALID: u8 = 1;
/// A node's mark: some of its numbers are subnormal f16, too small for the fast way to decode them. Rare: a writer's scale
/// brings the largest numbers near f16's largest, and 10⁹ lies between that and these.
pub(crate) const SUBNORMAL: u8 = 2;
/// A node's mark: walls go through the cell of which it is the lowest corner. Not in a sparse grid, where that may be no node.
pub(crate) const WALLED: u8 = 4;
/// A node's mark: of the cell of which it is the lowest corner some corner is not [`VALID`], or is [`SUBNORMAL`], or it is
/// [`WALLED`]. Not in a sparse grid. One mark to look at, where there are eight, in four places far apart. With the feature `fast` alone.
pub(crate) const MIXED: u8 = 8;

/// Which nodes are the vertices of which part of the level.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct VertexSet {
    /// Index of the glTF node.
    pub node: u32,
    /// Index of the glTF mesh.
    pub mesh: u32,
    /// Index of the primitive in the mesh.
    pub primitive: u32,
    /// The first of its nodes in the volume; the others follow in the order of the primitive's vertices.
    pub first: u32,
    /// How many there are.
    pub count: u32,
}

impl Volume {
    /// Reads a file, given all of its bytes, with the default [`Limits`].
    pub fn parse(bytes: &[u8]) -> Result<Volume, Error> {
        Volume::parse_with_limits(bytes, &Limits::default())
    }

    /// Reads a file, given all of its bytes. Checks all of it, also sections that it does not use.
    pub fn parse_with_limits(bytes: &[u8], limits: &Limits) -> Result<Volume, Error> {
        let directory = format::parse_header_and_sections(bytes)?;
        directory.check_contents(limits)?;
        let mut volume = Volume {
            header: directory.header,
            finder: Finder::new(&directory.header.grid()),
            coefficients: Coefficients::F16(Vec::new()),
            scale: 1.0,
            marks: None,
            walls: None,
            bricks: None,
            coverage: None,
            relative_error: None,
            positions: Vec::new(),
            index: NearestIndex::default(),
            normals: Vec::new(),
            meshes: Vec::new(),
        };
        volume.read(&Sections { directory })?;
        Ok(volume)
    }

    /// Fills in what the sections say. (Field by field: so no error on the way has anything to give back, which is a lot of
    /// code.)
    fn read(&mut self, sections: &Sections<'_>) -> Result<(), Error> {
        sections.check_kind()?;
        let numbers = sections.coefficients()?;
        (self.coefficients, self.scale) = (numbers.coefficients, numbers.scale);
        self.bricks = sections.bricks()?;
        if let Some(bricks) = &self.bricks {
            self.finder = Finder::new(&Grid { counts: bricks.counts(), ..self.header.grid() });
        }
        self.walls = sections.walls(self.bricks.as_ref())?;
        self.marks = marks(sections.validity()?, &numbers.subnormal, self.header.node_count());
        if let Some(marks) = self.marks.as_mut().filter(|_| cfg!(feature = "fast") && self.header.kind == Kind::Grid) {
            mark_mixed_cells(marks, &self.finder);
        }
        for cell in self.walls.iter().filter(|_| self.bricks.is_none()).flat_map(Walls::cells) {
            self.marks.get_or_insert_with(|| vec![VALID; self.header.node_count()])[cell as usize] |= WALLED | MIXED;
        }
        self.positions = sections.vectors(POSITIONS)?;
        self.coverage = sections.fractions(COVERAGE, 1.0)?;
        self.relative_error = sections.fractions(STANDARD_ERROR, f32::MAX)?;
        self.index = NearestIndex::build(&self.positions);
        self.normals = sections.vectors(NORMALS)?;
        self.meshes = sections.meshes()?;
        Ok(())
    }

    /// The fixed part of the file: kind, box, counts, bands.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// How many nodes there are; at least 1.
    pub fn node_count(&self) -> usize {
        self.header.node_count()
    }

    /// The radiance at node `node`, as stored.
    ///
    /// # Panics
    /// If there is no such node, as all accessors by node.
    pub fn node_sh(&self, node: usize) -> RadianceSh {
        self.check_node(node);
        let mut sh = RadianceSh::zero(self.header.bands);
        let values = sh.coefficients.as_flattened_mut();
        let count = self.header.values_per_node();
        match &self.coefficients {
            Coefficients::F32(all) => values[..count].copy_from_slice(&all[node * count..(node + 1) * count]),
            Coefficients::F16(all) => {
                let words = &all[node * words_of(count)..];
                for (k, value) in values[..count].iter_mut().enumerate() {
                    *value = f16_to_f32(half_of(words, k)) * self.scale;
                }
            }
        }
        sh
    }

    /// Whether node `node` was baked; otherwise it is filled from its neighbours.
    pub fn is_valid(&self, node: usize) -> bool {
        self.check_node(node);
        self.marks.as_ref().is_none_or(|marks| marks[node] & VALID != 0)
    }

    /// How many cells of a grid have walls in them that keep light on its side.
    pub fn walled_cells(&self) -> usize {
        self.walls.as_ref().map_or(0, Walls::len)
    }

    /// The walls in a grid's cells, and their planes; empty where there are none.
    pub fn wall_tables(&self) -> (&[Plane], &[WallCell]) {
        self.walls.as_ref().map_or((&[], &[]), Walls::tables)
    }

    /// The share of what node `node` sees (by solid angle) that some probe has seen, 0..=1.
    pub fn node_coverage(&self, node: usize) -> f32 {
        self.check_node(node);
        self.coverage.as_ref().map_or(1.0, |all| f16_to_f32(all[node]))
    }

    /// One standard error of irradiance at node `node`, relative; None if it was not measured.
    pub fn node_relative_error(&self, node: usize) -> Option<f32> {
        self.check_node(node);
        self.relative_error.as_ref().map(|all| f16_to_f32(all[node]))
    }

    /// The grid between whose nodes light is read; of a sparse one the finest, of which some places are no nodes. None for points and
    /// vertices.
    pub fn grid(&self) -> Option<Grid> {
        let Header { kind, min, max, .. } = self.header;
        match (kind, &self.bricks) {
            (Kind::Grid, _) => Some(self.header.grid()),
            (Kind::Sparse, Some(bricks)) => Some(Grid { min, max, counts: bricks.counts() }),
            _ => None,
        }
    }

    /// Which places of [`grid`](Volume::grid) are nodes, in a sparse grid; None where all are.
    pub fn bricks(&self) -> Option<&Bricks> {
        self.bricks.as_ref()
    }

    /// The nodes around a position and their weights, all of them valid and no wall in between; None for points and vertices.
    pub fn cell(&self, position: [f64; 3]) -> Option<Cell> {
        let grid = self.grid()?;
        Some(match &self.bricks {
            None => grid.locate(position),
            Some(bricks) => bricks.cell(&grid, position),
        })
    }

    /// Where node `node` is, metres.
    pub fn node_position(&self, node: usize) -> [f64; 3] {
        self.check_node(node);
        if let Some(grid) = self.grid() {
            let place = match &self.bricks {
                None => grid.place_of(node as u32),
                Some(bricks) => bricks.place_of(node),
            };
            return grid.place_position(place);
        }
        core::array::from_fn(|axis| self.header.min[axis] + f64::from(self.positions[node][axis]))
    }

    /// The normal of vertex `node`, unit length; None for grids and points, which have none.
    pub fn node_normal(&self, node: usize) -> Option<[f32; 3]> {
        self.check_node(node);
        self.normals.get(node).copied()
    }

    /// The nodes at the vertices of one primitive of one mesh on one glTF node, in the order of its vertices; None if
    /// the volume has none there.
    pub fn vertex_set(&self, node: u32, mesh: u32, primitive: u32) -> Option<Range<usize>> {
        let place = self
            .meshes
            .binary_search_by_key(&(node, mesh, primitive), |set| (set.node, set.mesh, set.primitive))
            .ok()?;
        let VertexSet { first, count, .. } = self.meshes[place];
        Some(first as usize..first as usize + count as usize)
    }

    /// All vertex sets, in order of node, mesh and primitive. Empty unless the volume holds vertices.
    pub fn vertex_sets(&self) -> &[VertexSet] {
        &self.meshes
    }

    fn check_node(&self, node: usize) {
        assert!(node < self.node_count(), "node {node} of {}", self.node_count());
    }
}

/// The sections of one file, their checksums compared, on their way into a volume.
struct Sections<'a> {
    directory: Directory<'a>,
}

impl Sections<'_> {
    /// Checks that the sections there are fit the kind of volume.
    fn check_kind(&self) -> Result<(), Error> {
        let kind = self.directory.header.kind;
        let placed = matches!(kind, Kind::Points | Kind::Vertices);
        let sparse = kind == Kind::Sparse;
        let vertices = kind == Kind::Vertices;
        for (id, allowed, required) in [
            (RADIANCE, true, true),
            (POSITIONS, placed, placed),
            (NORMALS, vertices, vertices),
            (MESHES, vertices, false),
            (WALLS, !placed, false),
            (BRICKS, sparse, sparse),
        ] {
            let present = self.directory.section(id).is_some();
            let (found, expected) = match (present, allowed) {
                (true, false) => ("one", "none"),
                (false, _) if required => ("none", "one"),
                _ => continue,
            };
            return Err(Error::invalid(
                format::section_place(id),
                found,
                text!("{expected} in a volume of kind {kind:?}"),
            ));
        }
        Ok(())
    }

    /// Node by node.
    fn coefficients(&self) -> Result<Numbers, Error> {
        let header = &self.directory.header;
        let (nodes, planes) = (header.node_count(), header.values_per_node());
        // In a small module they become plain numbers first, as all sections do.
        if cfg!(feature = "fast")
            && header.encoding == Encoding::Packed
            && let Some(bits) = self.directory.checked_section_bits(RADIANCE)?
            && let Some(numbers) = packed::Planes::of_bits(bits, planes + 1)
        {
            return packed::parse(numbers, nodes, planes, header.scale);
        }
        let bytes = self.directory.checked_section_bytes(RADIANCE)?;
        let bytes = bytes.unwrap_or_default();
        let (coefficients, subnormal, odd) = match header.encoding {
            Encoding::F16 => {
                let (words, subnormal, all_finite) = interleave_halves(&bytes, nodes, planes);
                let odd = || {
                    (0..nodes * planes)
                        .find(|k| !f16_is_finite(half_of(&words[k / planes * words_of(planes)..], k % planes)))
                };
                let odd = if all_finite { None } else { odd() };
                (Coefficients::F16(words), subnormal, odd)
            }
            Encoding::F32 => {
                let values = interleave(&bytes, nodes, planes);
                let odd = first_odd(&values);
                (Coefficients::F32(values), Vec::new(), odd)
            }
            Encoding::Packed => {
                let elements = packed::Planes::Elements(bytes.as_chunks().0);
                return packed::parse(elements, nodes, planes, header.scale);
            }
        };
        match odd {
            None => Ok(Numbers { coefficients, scale: header.scale, subnormal }),
            Some(place) => Err(Error::invalid(
                text!("section RSH , node {}, plane {}", place / planes, place % planes),
                "infinity or NaN",
                "a finite number",
            )),
        }
    }

    fn validity(&self) -> Result<Option<Vec<u8>>, Error> {
        let Some(bytes) = self.directory.checked_section_bytes(VALIDITY)? else {
            return Ok(None);
        };
        if let Some(node) = bytes.iter().position(|&byte| byte > 1) {
            return Err(Error::invalid(text!("section VALD, node {node}"), text!("{}", bytes[node]), "0 or 1"));
        }
        Ok(Some(bytes.into_owned()))
    }

    fn bricks(&self) -> Result<Option<Bricks>, Error> {
        let Some(bytes) = self.directory.checked_section_bytes(BRICKS)? else {
            return Ok(None);
        };
        Bricks::parse(&bytes, self.directory.header.node_count()).map(Some)
    }

    fn walls(&self, bricks: Option<&Bricks>) -> Result<Option<Walls>, Error> {
        let Some(bytes) = self.directory.checked_section_bytes(WALLS)? else {
            return Ok(None);
        };
        let grid = self.directory.header.grid();
        let grid = bricks.map_or(grid, |bricks| Grid { counts: bricks.counts(), ..grid });
        Walls::parse(&bytes, &grid, bricks).map(Some)
    }

    /// 16-bit floats from 0 to `max`.
    fn fractions(&self, id: [u8; 4], max: f32) -> Result<Option<Vec<u16>>, Error> {
        let Some(bytes) = self.directory.checked_section_bytes(id)? else {
            return Ok(None);
        };
        let values: Vec<u16> = bytes.as_chunks().0.iter().map(|&b| u16::from_le_bytes(b)).collect();
        let odd = values.iter().position(|&bits| !(0.0..=max).contains(&f16_to_f32(bits)));
        match odd {
            None => Ok(Some(values)),
            Some(node) => Err(Error::invalid(
                format::section_place(id) + &text!(", node {node}"),
                text!("{}", f16_to_f32(values[node])),
                if max == 1.0 { "0 to 1" } else { "a finite number, at least 0" },
            )),
        }
    }

    /// Three finite floats per node; empty where there is no such section.
    fn vectors(&self, id: [u8; 4]) -> Result<Vec<[f32; 3]>, Error> {
        let bytes = self.directory.checked_section_bytes(id)?.unwrap_or_default();
        let floats = bytes.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b));
        let floats: Vec<f32> = floats.collect();
        if let Some(place) = floats.iter().position(|value| !value.is_finite()) {
            return Err(Error::invalid(
                format::section_place(id) + &text!(", node {}", place / 3),
                "infinity or NaN",
                "a finite number",
            ));
        }
        Ok(floats.as_chunks::<3>().0.to_vec())
    }

    fn meshes(&self) -> Result<Vec<VertexSet>, Error> {
        let bytes = self.directory.checked_section_bytes(MESHES)?.unwrap_or_default();
        let (records, rest) = bytes.as_chunks::<20>();
        if !rest.is_empty() {
            return Err(Error::invalid("section MESH", text!("{} bytes", bytes.len()), "whole records of 20 bytes"));
        }
        let nodes = self.directory.header.node_count() as u64;
        let mut sets = Vec::with_capacity(records.len());
        for (place, record) in records.iter().enumerate() {
            let word = |k: usize| u32::from_le_bytes(core::array::from_fn(|i| record[4 * k + i]));
            let set = VertexSet { node: word(0), mesh: word(1), primitive: word(2), first: word(3), count: word(4) };
            if u64::from(set.first) + u64::from(set.count) > nodes {
                return Err(Error::invalid(
                    text!("section MESH, record {place}"),
                    text!("{} vertices from {}", set.count, set.first),
                    text!("to end within the {nodes} of the volume"),
                ));
            }
            sets.push(set);
        }
        let key = |set: &VertexSet| (set.node, set.mesh, set.primitive);
        // Writers sort them. A heap's sort, for that is little code.
        if !sets.is_sorted() {
            sets = BinaryHeap::from(sets).into_sorted_vec();
        }
        if let Some(pair) = sets.windows(2).find(|pair| key(&pair[0]) == key(&pair[1])) {
            return Err(Error::invalid(
                "section MESH",
                text!("two records for node, mesh, primitive {:?}", key(&pair[0])),
                "one",
            ));
        }
        Ok(sets)
    }
}

/// The first value that is not finite.
fn first_odd(values: &[f32]) -> Option<usize> {
    let is_odd = |value: &f32| !value.is_finite();
    // Without a branch over many, since in a whole file none is.
    let block = values.chunks(1024).position(|block| block.iter().fold(false, |any, value| any | is_odd(value)))?;
    values[block * 1024..].iter().position(is_odd).map(|place| block * 1024 + place)
}

/// The marks of all nodes, from section `VALD` and the numbers.
fn marks(validity: Option<Vec<u8>>, subnormal: &[u32], nodes: usize) -> Option<Vec<u8>> {
    let mut marks = validity;
    for &node in subnormal {
        marks.get_or_insert_with(|| vec![VALID; nodes])[node as usize] |= SUBNORMAL;
    }
    marks
}

/// Marks the cells around nodes that are not valid, or subnormal, as [`MIXED`].
fn mark_mixed_cells(marks: &mut [u8], finder: &Finder) {
    for node in 0..marks.len() {
        if marks[node] & !MIXED != VALID {
            // Where there is no such cell that node is the lowest of none: what is marked there has no meaning.
            for offset in finder.corner_offsets() {
                if let Some(mark) = marks.get_mut(node.wrapping_sub(offset as usize)) {
                    *mark |= MIXED;
                }
            }
        }
    }
}

/// Nodes that are turned round together. With fewer, a plane's part is so short that processors do not fetch the next one ahead.
const BLOCK: usize = 256;

/// From planes of `nodes` 32-bit floats to `planes` values per node.
///
/// Node by node would touch as many cache lines as there are planes for each; plane by plane as many as there are
/// nodes. In blocks of nodes, what is written stays in a near cache and what is read comes in whole lines.
fn interleave(bytes: &[u8], nodes: usize, planes: usize) -> Vec<f32> {
    let elements = bytes.as_chunks::<4>().0;
    let mut values = vec![0.0; nodes * planes];
    for (block, rows) in values.chunks_mut(BLOCK * planes).enumerate() {
        for plane in 0..planes {
            let column = &elements[plane * nodes + block * BLOCK..];
            for (row, &element) in rows.chunks_exact_mut(planes).zip(column) {
                row[plane] = f32::from_le_bytes(element);
            }
        }
    }
    values
}

/// Words of a node that are written together.
const TOGETHER: usize = 4;

/// The same of 16-bit floats, to [`words_of`]; with the nodes that have subnormal ones, and whether all are finite.
fn interleave_halves(bytes: &[u8], nodes: usize, planes: usize) -> (Vec<u32>, Vec<u32>, bool) {
    let elements = bytes.as_chunks::<2>().0;
    let per_node = words_of(planes);
    let (mut words, mut subnormal, mut all_finite) = (vec![0; nodes * per_node], Vec::new(), true);
    // The same word of many nodes, for some words.
    let mut columns = [[0u32; BLOCK]; TOGETHER];
    for (block, rows) in words.chunks_mut(BLOCK * per_node).enumerate() {
        let count = rows.len() / per_node;
        let plane = |plane: usize| &elements[plane * nodes + block * BLOCK..][..count];
        let (mut most, mut least) = (0, i16::MAX);
        for first in (0..per_node).step_by(TOGETHER) {
            let columns = &mut columns[..TOGETHER.min(per_node - first)];
            for (k, column) in columns.iter_mut().enumerate() {
                let lower = 2 * (first + k);
                // After the last plane of an odd number comes none.
                let (upper, mask) = if lower + 1 < planes { (lower + 1, u32::MAX) } else { (lower, 0xffff) };
                for ((word, lower), upper) in column.iter_mut().zip(plane(lower)).zip(plane(upper)) {
                    let halves = [lower, upper].map(|bytes| u16::from_le_bytes(*bytes));
                    for magnitude in halves.map(|half| (half & 0x7fff) as i16) {
                        most = most.max(magnitude);
                        // 0, which is not subnormal, becomes the largest.
                        least = least.min((magnitude - 1) & 0x7fff);
                    }
                    *word = (u32::from(halves[0]) | u32::from(halves[1]) << 16) & mask;
                }
            }
            if let [a, b, c, d] = columns {
                for ((((row, a), b), c), d) in rows.chunks_exact_mut(per_node).zip(a).zip(b).zip(c).zip(d) {
                    row[first..first + 4].copy_from_slice(&[*a, *b, *c, *d]);
                }
            } else {
                for (k, column) in columns.iter().enumerate() {
                    for (row, word) in rows.chunks_exact_mut(per_node).zip(column) {
                        row[first + k] = *word;
                    }
                }
            }
        }
        all_finite &= f16_is_finite(most as u16);
        // The smallest number but 0 is one more.
        if f16_is_subnormal(least as u16 + 1) {
            let is_subnormal = |word: &u32| f16_is_subnormal(*word as u16) || f16_is_subnormal((word >> 16) as u16);
            let rows = rows.chunks_exact(per_node).enumerate();
            let found = rows.filter(|(_, row)| row.iter().any(is_subnormal));
            subnormal.extend(found.map(|(node, _)| (block * BLOCK + node) as u32));
        }
    }
    (words, subnormal, all_finite)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interleave_turns_planes_into_nodes() {
        for nodes in [1, 3, BLOCK - 1, BLOCK, BLOCK + 1, 600] {
            for planes in [3, 12, 27] {
                let value = |plane: usize, node: usize| (plane * 700 + node) as u16;
                let (mut halves, mut floats) = (Vec::new(), Vec::new());
                for plane in 0..planes {
                    for node in 0..nodes {
                        halves.extend_from_slice(&value(plane, node).to_le_bytes());
                        floats.extend_from_slice(&f32::from(value(plane, node)).to_le_bytes());
                    }
                }
                let (words, ..) = interleave_halves(&halves, nodes, planes);
                let values = interleave(&floats, nodes, planes);
                let per_node = words_of(planes);
                assert_eq!((words.len(), values.len()), (nodes * per_node, nodes * planes));
                for node in 0..nodes {
                    for plane in 0..planes {
                        assert_eq!(half_of(&words[node * per_node..], plane), value(plane, node));
                        assert_eq!(values[node * planes + plane], f32::from(value(plane, node)));
                    }
                    assert!(planes % 2 == 0 || half_of(&words[node * per_node..], planes) == 0);
                }
            }
        }
    }
}
