//! Where the nodes of a scene stand: walks the tree from its roots, in f64.

use glam::{DAffine3, DMat4, DQuat, DVec3, Vec3};
use gltf::json::accessor::Type;
use serde_json::Value;

use super::accessor::Elements;
use super::buffers::Buffers;
use super::document::{Document, Node};
use super::findings::Findings;
use crate::Result;
use crate::scene::Role;

/// A node of the scene in the world.
#[derive(Debug, Clone, Copy)]
pub(super) struct PlacedNode {
    /// Its index in the file.
    pub node: usize,
    /// Node to world.
    pub transform: DAffine3,
    /// `extras.gdibl_role`, its own or inherited; none: "ignore".
    pub role: Option<Role>,
}

/// The nodes of `scene` (else the file's default scene, else scene 0; a file without scenes: all roots), parents
/// before children, in the file's order.
pub(super) fn place_nodes(
    document: &Document,
    scene: Option<usize>,
    findings: &mut Findings,
) -> Result<Vec<PlacedNode>> {
    let roots = roots(document, scene)?;
    let mut placed = Vec::new();
    // Who led to a node, to tell a second visit: the trees of a scene are disjoint.
    let mut reached_from: Vec<Option<String>> = vec![None; document.nodes.len()];
    let mut hidden = 0;

    // An explicit stack: a chain of a million nodes is a legal file.
    struct Visit {
        node: usize,
        parent: Option<usize>,
        transform: DAffine3,
        role: Option<Role>,
    }
    let root_visit =
        |node: usize| Visit { node, parent: None, transform: DAffine3::IDENTITY, role: Some(Role::Environment) };
    let mut stack: Vec<Visit> = roots.into_iter().rev().map(root_visit).collect();
    while let Some(Visit { node: index, parent, transform: above, role: inherited }) = stack.pop() {
        let from = match parent {
            Some(parent) => document.node_label(parent),
            None => "the scene".to_owned(),
        };
        let node = document.get(&document.nodes, index, "node", &from)?;
        let label = document.node_label(index);
        if let Some(first) = &reached_from[index] {
            return Err(document.invalid(format!(
                "{label}: reached from {first} and again from {from}; nodes must form trees without cycles"
            )));
        }
        reached_from[index] = Some(from);

        let transform = above * local_transform(document, node, &label)?;
        if !transform.is_finite() {
            return Err(document.invalid(format!("{label}: its place in the world is not finite")));
        }
        let visible = node.extensions.get("KHR_node_visibility").and_then(|e| e.get("visible"));
        if visible == Some(&Value::Bool(false)) {
            hidden += 1;
            continue;
        }
        let role = match node.extras.get("gdibl_role") {
            None => inherited,
            Some(value) => match value.as_str() {
                Some("environment") => Some(Role::Environment),
                Some("scene") => Some(Role::Scene),
                Some("ignore") => None,
                _ => {
                    return Err(document.invalid(format!(
                        "{label}: extras.gdibl_role is {value}; expected \"environment\", \"scene\" or \"ignore\""
                    )));
                }
            },
        };
        placed.push(PlacedNode { node: index, transform, role });
        stack.extend(node.children.iter().rev().map(|&child| Visit {
            node: child as usize,
            parent: Some(index),
            transform,
            role,
        }));
    }
    findings.add("hidden-nodes", hidden, || {
        "Nodes that KHR_node_visibility hides were left out with their children".into()
    });
    Ok(placed)
}

/// The roots of the scene that was asked for.
fn roots(document: &Document, asked: Option<usize>) -> Result<Vec<usize>> {
    if document.scenes.is_empty() && asked.is_none() {
        let mut has_parent = vec![false; document.nodes.len()];
        for child in document.nodes.iter().flat_map(|node| &node.children) {
            if let Some(flag) = has_parent.get_mut(*child as usize) {
                *flag = true;
            }
        }
        let roots: Vec<usize> = (0..document.nodes.len()).filter(|&node| !has_parent[node]).collect();
        if roots.is_empty() && !document.nodes.is_empty() {
            return Err(document.invalid("every node is a child of another; nodes must form trees without cycles"));
        }
        return Ok(roots);
    }
    let (index, place) = match asked {
        Some(index) => (index, "the scene asked for"),
        None => (document.default_scene.unwrap_or(0) as usize, "the default scene"),
    };
    let scene = document.get(&document.scenes, index, "scene", &place)?;
    Ok(scene.nodes.iter().map(|&node| node as usize).collect())
}

/// Node to parent.
fn local_transform(document: &Document, node: &Node, label: &str) -> Result<DAffine3> {
    if let Some(columns) = node.matrix {
        let matrix = DMat4::from_cols_array(&columns);
        let last_row = matrix.row(3).to_array();
        if last_row.iter().zip([0.0, 0.0, 0.0, 1.0]).any(|(found, expected)| (found - expected).abs() > 1e-6) {
            return Err(
                document.invalid(format!("{label}: the last row of its matrix is {last_row:?}; expected 0, 0, 0, 1"))
            );
        }
        return Ok(DAffine3::from_mat4(matrix));
    }
    let rotation = match node.rotation {
        None => DQuat::IDENTITY,
        Some(xyzw) => rotation(xyzw).ok_or_else(|| {
            document.invalid(format!("{label}: its rotation {xyzw:?} is no rotation; expected a unit quaternion"))
        })?,
    };
    Ok(DAffine3::from_scale_rotation_translation(
        node.scale.map_or(DVec3::ONE, DVec3::from),
        rotation,
        node.translation.map_or(DVec3::ZERO, DVec3::from),
    ))
}

/// A quaternion of any length but zero; exporters round.
fn rotation(xyzw: [f64; 4]) -> Option<DQuat> {
    let quaternion = DQuat::from_array(xyzw);
    let length = quaternion.length();
    (length.is_finite() && length > 1e-6).then(|| quaternion.normalize())
}

/// EXT_mesh_gpu_instancing: where a node's mesh stands, once per instance.
pub(super) struct Instances<'b> {
    /// How many.
    pub count: usize,
    label: String,
    translations: Option<Elements<'b>>,
    rotations: Option<Elements<'b>>,
    scales: Option<Elements<'b>>,
}

impl<'b> Instances<'b> {
    /// Opens a node's extension; none without it. Nothing is allocated per instance yet.
    pub fn open(buffers: &'b Buffers, node: usize) -> Result<Option<Self>> {
        let document = buffers.document;
        let Some(extension) = document.nodes[node].extensions.get("EXT_mesh_gpu_instancing") else { return Ok(None) };
        let label = document.node_label(node);
        let open = |name: &str, kind: Type| -> Result<Option<Elements>> {
            let Some(value) = extension.get("attributes").and_then(|attributes| attributes.get(name)) else {
                return Ok(None);
            };
            let place = format!("{label}: EXT_mesh_gpu_instancing {name}");
            let index = value.as_u64().and_then(|index| usize::try_from(index).ok());
            let index =
                index.ok_or_else(|| document.invalid(format!("{place} is {value}; expected an accessor index")))?;
            Elements::open(buffers, index, &[kind], &place).map(Some)
        };
        let translations = open("TRANSLATION", Type::Vec3)?;
        let rotations = open("ROTATION", Type::Vec4)?;
        let scales = open("SCALE", Type::Vec3)?;

        let all = || [&translations, &rotations, &scales].into_iter().flatten();
        let Some(count) = all().map(|elements| elements.count).next() else { return Ok(None) };
        if all().any(|elements| elements.count != count) {
            let counts: Vec<usize> = all().map(|elements| elements.count).collect();
            return Err(document.invalid(format!(
                "{label}: EXT_mesh_gpu_instancing: its attributes have {counts:?} elements; expected the same number"
            )));
        }
        // Else a few bytes could ask for millions of meshes.
        if all().all(|elements| !elements.has_data()) {
            return Err(document.unsupported(format!(
                "{label}: EXT_mesh_gpu_instancing: {count} instances without a bufferView all stand in one place"
            )));
        }
        Ok(Some(Instances { count, label, translations, rotations, scales }))
    }

    /// Instance to node, for each instance.
    pub fn transforms(&self, document: &Document) -> Result<Vec<DAffine3>> {
        let vec3 = |elements: &Elements, i| Vec3::from(elements.vector::<3>(i)).as_dvec3();
        let transform = |i: usize| {
            let xyzw = self.rotations.as_ref().map_or([0.0, 0.0, 0.0, 1.0], |e| e.vector::<4>(i)).map(f64::from);
            let rotation = rotation(xyzw).ok_or_else(|| {
                document.invalid(format!("{}: instance {i}: its rotation {xyzw:?} is no rotation", self.label))
            })?;
            Ok(DAffine3::from_scale_rotation_translation(
                self.scales.as_ref().map_or(DVec3::ONE, |e| vec3(e, i)),
                rotation,
                self.translations.as_ref().map_or(DVec3::ZERO, |e| vec3(e, i)),
            ))
        };
        (0..self.count).map(transform).collect()
    }
}
