//! One glTF primitive in its own space: which triangles it has, and the attributes of the vertices they use.

use std::collections::BTreeMap;

use glam::{DAffine3, DVec3, Vec2, Vec3, Vec4};
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::mesh::{Mode, Primitive, Semantic};
use gltf::json::validation::Checked;

use super::accessor::{Elements, attribute};
use super::buffers::Buffers;
use super::document::Document;
use super::findings::Findings;
use super::skin;
use crate::Result;
use crate::scene::UV_SETS;

/// What to read beside positions.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Wanted {
    /// glTF's texture coordinate set for each of `Mesh::uvs`.
    pub uv_sets: [Option<u32>; UV_SETS],
    /// COLOR_0.
    pub colors: bool,
}

/// A primitive's triangles, vertices compacted to those in use. Triangles that are non-finite or have no area are gone.
#[derive(Debug, Default)]
pub(super) struct LocalPrimitive {
    pub positions: Vec<Vec3>,
    /// Empty, or one per position, as in the file.
    pub normals: Vec<Vec3>,
    pub uvs: [Vec<Vec2>; UV_SETS],
    pub colors: Vec<Vec4>,
    pub triangles: Vec<[u32; 3]>,
    /// Mesh to world for each vertex of a skinned mesh; else empty.
    pub transforms: Vec<DAffine3>,
    /// The file's number of each vertex, increasing, and how many vertices the file has.
    pub file_numbers: Vec<u32>,
    pub file_count: u32,
    /// How many were dropped.
    pub non_finite: u64,
    pub zero_area: u64,
}

/// How many triangles `primitive` can have, from accessors whose bytes are there but without reading them: for the cap
/// on triangles.
pub(super) fn count_triangles(buffers: &Buffers, primitive: &Primitive, place: &str) -> Result<u64> {
    let positions = attribute(primitive, Semantic::Positions);
    let (Some(mode), Some(positions)) = (triangle_mode(primitive), positions) else { return Ok(0) };
    let corners = match primitive.indices {
        Some(indices) => Elements::open(buffers, indices.value(), &[Type::Scalar], &format!("{place}: indices"))?,
        None => Elements::open(buffers, positions.value(), &[Type::Vec3], &format!("{place}: POSITION"))?,
    };
    Ok(match mode {
        Mode::Triangles => corners.count as u64 / 3,
        _ => corners.count.saturating_sub(2) as u64,
    })
}

/// The mode, if it makes triangles.
fn triangle_mode(primitive: &Primitive) -> Option<Mode> {
    match primitive.mode {
        Checked::Valid(mode @ (Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan)) => Some(mode),
        _ => None,
    }
}

/// How a mesh is deformed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pose<'a> {
    /// Of the morph targets.
    pub weights: &'a [f32],
    /// Mesh to world by joint, of a skinned mesh.
    pub joints: Option<&'a [DAffine3]>,
}

/// The accessors of positions and normals; `u32::MAX` without.
pub(super) fn accessors(primitive: &Primitive) -> [u32; 2] {
    let number = |semantic| attribute(primitive, semantic).map_or(u32::MAX, |accessor| accessor.value() as u32);
    [number(Semantic::Positions), number(Semantic::Normals)]
}

/// Reads a primitive; none if it makes no triangles (with a finding).
pub(super) fn read(
    buffers: &Buffers,
    primitive: &Primitive,
    place: &str,
    pose: &Pose,
    wanted: Wanted,
    findings: &mut Findings,
) -> Result<Option<LocalPrimitive>> {
    let document = buffers.document;
    if primitive.mode == Checked::Invalid {
        return Err(document.invalid(format!("{place}: unknown mode; expected 0 to 6")));
    }
    let Some(mode) = triangle_mode(primitive) else {
        findings.add("point-and-line-primitives", 1, || {
            format!("Points and lines have no surface and were ignored, first in {place}")
        });
        return Ok(None);
    };
    let Some(position_accessor) = attribute(primitive, Semantic::Positions) else {
        findings.add("primitives-without-positions", 1, || {
            format!("Primitives without POSITION have no shape and were ignored, first in {place}")
        });
        return Ok(None);
    };
    if let Some(extensions) = &primitive.extensions {
        let is_required = document.required.iter().any(|name| name == "KHR_draco_mesh_compression");
        let has_no_fallback =
            document.accessors.get(position_accessor.value()).is_some_and(|accessor| accessor.buffer_view.is_none());
        if extensions.others.contains_key("KHR_draco_mesh_compression") && (is_required || has_no_fallback) {
            return Err(document.unsupported(format!(
                "{place}: compressed with KHR_draco_mesh_compression; decompress the level first (gltf-transform copy \
                 IN OUT), or compress it with EXT_meshopt_compression"
            )));
        }
    }

    let positions = Elements::open(buffers, position_accessor.value(), &[Type::Vec3], &format!("{place}: POSITION"))?;
    let (indices, restart) = read_indices(buffers, primitive, positions.count, place)?;
    let list = assemble(mode, &indices, restart, place, findings);
    if let Some(&index) = list.as_flattened().iter().find(|&&index| index as usize >= positions.count) {
        let from = match primitive.indices {
            Some(accessor) => format!("accessor {} names vertex {index}", accessor.value()),
            None => format!("vertex {index} is used"),
        };
        return Err(document.invalid(format!(
            "{place}: {from}, but POSITION (accessor {}) has {}; the file is damaged",
            position_accessor.value(),
            positions.count
        )));
    }

    // Vertices in use, in the order of the file. A primitive may use few of a buffer that many share.
    let (used, list) = compact(list, positions.count);
    let opened = |semantic: Semantic, name: &str, kinds: &[Type]| -> Result<Option<Elements>> {
        let Some(accessor) = attribute(primitive, semantic) else { return Ok(None) };
        let elements = Elements::open(buffers, accessor.value(), kinds, &format!("{place}: {name}"))?;
        if elements.count != positions.count {
            return Err(document.invalid(format!(
                "{place}: {name} (accessor {}) has {} elements, POSITION {}; expected the same number",
                accessor.value(),
                elements.count,
                positions.count
            )));
        }
        Ok(Some(elements))
    };
    let mut local = LocalPrimitive {
        positions: used.iter().map(|&i| positions.vector(i as usize).into()).collect(),
        ..Default::default()
    };
    if let Some(normals) = opened(Semantic::Normals, "NORMAL", &[Type::Vec3])? {
        local.normals = used.iter().map(|&i| normals.vector(i as usize).into()).collect();
    }
    if wanted.colors
        && let Some(colors) = opened(Semantic::Colors(0), "COLOR_0", &[Type::Vec3, Type::Vec4])?
        && let Some(accessor) = attribute(primitive, Semantic::Colors(0))
    {
        local.colors = read_colors(document, colors, accessor.value(), &used, place, findings)?;
    }
    for (uvs, set) in local.uvs.iter_mut().zip(wanted.uv_sets) {
        let Some(set) = set else { continue };
        *uvs = match opened(Semantic::TexCoords(set), &format!("TEXCOORD_{set}"), &[Type::Vec2])? {
            Some(elements) => used.iter().map(|&i| elements.vector(i as usize).into()).collect(),
            None => {
                findings.add("missing-texture-coordinates", 1, || {
                    format!("A material's texture needs TEXCOORD_{set}, which is missing (read as 0), first in {place}")
                });
                vec![Vec2::ZERO; used.len()]
            }
        };
    }
    apply_morph_targets(buffers, primitive, place, pose.weights, &used, positions.count, &mut local)?;
    if let Some(joints) = pose.joints {
        match skin::vertex_transforms(buffers, primitive, place, &used, positions.count, joints)? {
            Some(transforms) => local.transforms = transforms,
            None => findings.add("skins-without-joints", 1, || {
                format!(
                    "Skinned primitives without JOINTS_0, WEIGHTS_0 or joints stand where their node is, first {place}"
                )
            }),
        }
    }
    local.file_count = u32::try_from(positions.count).map_err(|_| {
        document.unsupported(format!("{place}: {} vertices; at most 2^32 - 1 are read", positions.count))
    })?;
    local.file_numbers = used;

    // Triangles that cannot be hit.
    let (mut non_finite, mut zero_area) = (0, 0);
    local.triangles = list;
    let positions = &local.positions;
    // Joints may give a flat triangle an area.
    let is_skinned = !local.transforms.is_empty();
    local.triangles.retain(|triangle| {
        if is_skinned {
            return true;
        }
        let corners = triangle.map(|i| positions[i as usize].as_dvec3());
        let shape = shape_of(corners);
        non_finite += u64::from(shape == Shape::NonFinite);
        zero_area += u64::from(shape == Shape::ZeroArea);
        shape == Shape::Good
    });
    (local.non_finite, local.zero_area) = (non_finite, zero_area);
    Ok(Some(local))
}

/// COLOR_0 of the vertices in use, 0..=1. The specification has floats, which a reader clamps, and normalised u8 or u16;
/// some exporters forget to say that these are normalised.
fn read_colors(
    document: &Document,
    mut colors: Elements,
    accessor: usize,
    used: &[u32],
    place: &str,
    findings: &mut Findings,
) -> Result<Vec<Vec4>> {
    let place = format!("{place}: COLOR_0 (accessor {accessor})");
    if !matches!(colors.component, ComponentType::F32 | ComponentType::U8 | ComponentType::U16) {
        return Err(
            document.invalid(format!("{place}: its components are {:?}; expected F32, U8 or U16", colors.component))
        );
    }
    findings.add("vertex-colours-not-normalised", u64::from(colors.normalize()), || {
        format!("Vertex colours that are integers were read as normalised, which the accessor does not say, first in {place}")
    });
    let mut clamped = 0;
    let mut first = None;
    let mut read = Vec::with_capacity(used.len());
    for &vertex in used {
        let color: Vec4 = match colors.kind {
            Type::Vec4 => colors.vector(vertex as usize).into(),
            _ => Vec3::from(colors.vector(vertex as usize)).extend(1.0),
        };
        if !color.is_finite() {
            return Err(document.invalid(format!(
                "{place}: the colour of vertex {vertex} is {color}; expected numbers of 0 to 1. Export the level anew, or \
                 remove the vertex colours"
            )));
        }
        let within = color.clamp(Vec4::ZERO, Vec4::ONE);
        if within != color {
            clamped += 1;
            first.get_or_insert((vertex, color));
        }
        read.push(within);
    }
    findings.add("clamped-vertex-colours", clamped, || {
        let (vertex, color) = first.unwrap_or_default();
        format!("Vertex colours outside 0 to 1 were clamped, as glTF says, first {color} of vertex {vertex} in {place}")
    });
    Ok(read)
}

/// Whether a triangle can be hit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shape {
    /// It has a normal; slivers too.
    Good,
    /// A corner is NaN or infinite.
    NonFinite,
    /// The corners are collinear, or so close that there is no normal in f64.
    ZeroArea,
}

/// Judges three corners. In the file's own f32 coordinates this is close to exact: the differences of f32 and the products
/// of these fit f64's 53 bits unless the corners' magnitudes differ wildly.
pub(super) fn shape_of([a, b, c]: [DVec3; 3]) -> Shape {
    if !(a.is_finite() && b.is_finite() && c.is_finite()) {
        return Shape::NonFinite;
    }
    let normal = (b - a).cross(c - a);
    if !normal.is_finite() {
        return Shape::NonFinite;
    }
    // Fails for lengths whose square underflows, too.
    if normal.try_normalize().is_some() { Shape::Good } else { Shape::ZeroArea }
}

/// The index of every corner, and the value that would mean "primitive restart", which glTF forbids, when it is no
/// vertex.
fn read_indices(
    buffers: &Buffers,
    primitive: &Primitive,
    vertices: usize,
    place: &str,
) -> Result<(Vec<u32>, Option<u32>)> {
    let document = buffers.document;
    let Some(accessor) = primitive.indices else {
        let count = u32::try_from(vertices)
            .map_err(|_| document.unsupported(format!("{place}: {vertices} vertices; at most 2^32 - 1 are read")))?;
        return Ok(((0..count).collect(), None));
    };
    let indices = Elements::open(buffers, accessor.value(), &[Type::Scalar], &format!("{place}: indices"))?;
    let restart = match indices.component {
        ComponentType::U8 => 0xFF,
        ComponentType::U16 => 0xFFFF,
        ComponentType::U32 => u32::MAX,
        other => {
            return Err(document.invalid(format!(
                "{place}: indices: accessor {} has components {other:?}; expected U8, U16 or U32",
                accessor.value()
            )));
        }
    };
    let list = (0..indices.count).map(|i| indices.index(i)).collect();
    Ok((list, (restart as usize >= vertices).then_some(restart)))
}

/// Corners to triangles, all counter-clockwise as the first.
fn assemble(mode: Mode, indices: &[u32], restart: Option<u32>, place: &str, findings: &mut Findings) -> Vec<[u32; 3]> {
    let is_restart = |index: &u32| Some(*index) == restart;
    let restarts = indices.iter().filter(|i| is_restart(i)).count();
    findings.add("restart-indices", restarts as u64, || {
        format!("Indices that mean primitive restart, which glTF forbids, were taken as such, first in {place}")
    });

    let mut left_over = 0;
    let mut triangles = Vec::new();
    match mode {
        Mode::TriangleStrip => {
            for run in indices.split(is_restart) {
                left_over += usize::from((1..3).contains(&run.len()));
                // Every second triangle of a strip is wound the other way.
                triangles.extend(
                    run.windows(3).enumerate().map(
                        |(i, w)| {
                            if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[0], w[2], w[1]] }
                        },
                    ),
                );
            }
        }
        Mode::TriangleFan => {
            for run in indices.split(is_restart) {
                left_over += usize::from((1..3).contains(&run.len()));
                if let Some((&hub, rim)) = run.split_first() {
                    triangles.extend(rim.windows(2).map(|w| [w[0], w[1], hub]));
                }
            }
        }
        _ => {
            let (triples, rest) = indices.as_chunks::<3>();
            left_over = usize::from(!rest.is_empty());
            triangles.extend(triples.iter().filter(|triple| !triple.iter().any(is_restart)));
        }
    }
    findings.add("incomplete-primitives", left_over as u64, || {
        format!("Corners that complete no triangle were ignored, first in {place}")
    });
    triangles
}

/// Numbers the vertices that `triangles` use from 0; returns their old numbers, increasing.
pub(super) fn compact(mut triangles: Vec<[u32; 3]>, vertices: usize) -> (Vec<u32>, Vec<[u32; 3]>) {
    // A bound on memory by what is used and not by what the file has: an index may be anything below `vertices`.
    let mut new_number: BTreeMap<u32, u32> = BTreeMap::new();
    if vertices <= 16 * triangles.len() + 1024 {
        let mut is_used = vec![false; vertices];
        triangles.as_flattened().iter().for_each(|&i| is_used[i as usize] = true);
        let mut number = vec![0; vertices];
        let mut used = Vec::new();
        for (i, _) in is_used.iter().enumerate().filter(|&(_, &is_used)| is_used) {
            number[i] = used.len() as u32;
            used.push(i as u32);
        }
        triangles.as_flattened_mut().iter_mut().for_each(|i| *i = number[*i as usize]);
        return (used, triangles);
    }
    triangles.as_flattened().iter().for_each(|&i| {
        new_number.insert(i, 0);
    });
    new_number.values_mut().zip(0..).for_each(|(number, i)| *number = i);
    triangles.as_flattened_mut().iter_mut().for_each(|i| *i = new_number[i]);
    (new_number.into_keys().collect(), triangles)
}

/// Adds `weight × target` to positions and normals.
fn apply_morph_targets(
    buffers: &Buffers,
    primitive: &Primitive,
    place: &str,
    weights: &[f32],
    used: &[u32],
    vertices: usize,
    local: &mut LocalPrimitive,
) -> Result<()> {
    for (i, (target, &weight)) in primitive.targets.iter().flatten().zip(weights).enumerate() {
        if weight == 0.0 {
            continue;
        }
        let streams =
            [("POSITION", target.positions, &mut local.positions), ("NORMAL", target.normals, &mut local.normals)];
        for (name, accessor, values) in streams {
            let Some(accessor) = accessor.filter(|_| !values.is_empty()) else { continue };
            let place = format!("{place}: morph target {i} {name}");
            let deltas = Elements::open(buffers, accessor.value(), &[Type::Vec3], &place)?;
            if deltas.count != vertices {
                return Err(buffers.document.invalid(format!(
                    "{place}: {} elements, POSITION has {vertices}; expected the same number",
                    deltas.count
                )));
            }
            for (value, &vertex) in values.iter_mut().zip(used) {
                *value += weight * Vec3::from(deltas.vector(vertex as usize));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_and_fans_keep_their_winding() {
        let mut findings = Findings::default();
        let strip = assemble(Mode::TriangleStrip, &[0, 1, 2, 3, 4], None, "", &mut findings);
        assert_eq!(strip, [[0, 1, 2], [1, 3, 2], [2, 3, 4]]);
        let fan = assemble(Mode::TriangleFan, &[0, 1, 2, 3], None, "", &mut findings);
        assert_eq!(fan, [[1, 2, 0], [2, 3, 0]]);
        assert!(findings.into_vec().is_empty());
    }

    #[test]
    fn restart_values_split_strips_and_drop_triangles() {
        let mut findings = Findings::default();
        let strip = assemble(Mode::TriangleStrip, &[0, 1, 2, 255, 3, 4, 5], Some(255), "", &mut findings);
        assert_eq!(strip, [[0, 1, 2], [3, 4, 5]]);
        let list = assemble(Mode::Triangles, &[0, 1, 2, 255, 4, 5, 6, 7, 8], Some(255), "", &mut findings);
        assert_eq!(list, [[0, 1, 2], [6, 7, 8]]);
        let findings = findings.into_vec();
        assert_eq!((findings[0].id.as_str(), findings[0].count), ("restart-indices", 2));
    }

    #[test]
    fn compact_gives_the_same_by_both_ways() {
        let triangles = vec![[7, 3, 900], [3, 7, 12]];
        let few = compact(triangles.clone(), 901);
        let many = compact(triangles, 4_000_000_000);
        assert_eq!(few, many);
        assert_eq!(few, (vec![3, 7, 12, 900], vec![[1, 0, 3], [0, 1, 2]]));
    }

    #[test]
    fn slivers_are_kept_and_collinear_corners_dropped() {
        let v = DVec3::new;
        assert_eq!(shape_of([v(0., 0., 0.), v(1., 0., 0.), v(0.5, 1e-30, 0.)]), Shape::Good);
        assert_eq!(shape_of([v(0., 0., 0.), v(1., 2., 3.), v(2., 4., 6.)]), Shape::ZeroArea);
        assert_eq!(shape_of([v(1., 0., 0.), v(1., 0., 0.), v(0.5, 1., 0.)]), Shape::ZeroArea);
        assert_eq!(shape_of([v(0., f64::NAN, 0.), v(1., 0., 0.), v(0.5, 1., 0.)]), Shape::NonFinite);
        assert_eq!(shape_of([v(0., 0., 0.), v(1e300, 0., 0.), v(0., 1e300, 0.)]), Shape::NonFinite);
    }
}
