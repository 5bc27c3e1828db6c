//! Where the nodes of a scene stand: walks the tree from its roots, in f64.

use glam::{DAffine3, DMat4, DQuat, DVec3, Vec3};
use gltf::json::accessor::Type;
use serde_json::Value;

use super::accessor::Elements;
use super::buffers::Buffers;
use super::document::{Document, Node};
use super::findings::Findings;
use super::properties::{self, Said};
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
    /// The role is its own.
    pub says_role: bool,
}

impl PlacedNode {
    /// The role of the triangles of one material of a mesh on the node; none: "ignore". What a material says counts before
    /// what the node says, that before what the mesh says, that before what the node inherits. An ignored node stays so.
    pub fn role_of(&self, document: &Document, mesh: usize, material: Option<usize>) -> Result<Option<Role>> {
        let Some(role) = self.role else { return Ok(None) };
        let said = |roles: &[Option<Value>], index: usize, what: &str| {
            let value = roles.get(index).and_then(Option::as_ref);
            properties::role(value, || format!("{what} {index}"), |why| document.invalid(why))
        };
        let of_material =
            material.map(|index| said(&document.material_roles, index, "material")).transpose()?.flatten();
        let of_mesh = said(&document.mesh_roles, mesh, "mesh")?.filter(|_| !self.says_role);
        Ok(match of_material.or(of_mesh) {
            None => Some(role),
            Some(Said::Role(role)) => Some(role),
            Some(Said::Ignore) => None,
        })
    }
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
    let (mut hidden, mut lower_detail) = (0, 0);
    let is_lower_detail = lower_details(document);

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
        if is_lower_detail[index] {
            lower_detail += 1;
            continue;
        }

        let transform = above * local_transform(document, node, &label)?;
        if !transform.is_finite() {
            return Err(document.invalid(format!("{label}: its place in the world is not finite")));
        }
        let visible = node.extensions.get("KHR_node_visibility").and_then(|e| e.get("visible"));
        if visible == Some(&Value::Bool(false)) {
            hidden += 1;
            continue;
        }
        let own = properties::role(node.extras.get(properties::ROLE), || label.clone(), |why| document.invalid(why))?;
        let role = match own {
            None => inherited,
            Some(Said::Role(role)) => Some(role),
            Some(Said::Ignore) => None,
        };
        placed.push(PlacedNode { node: index, transform, role, says_role: own.is_some() });
        stack.extend(node.children.iter().rev().map(|&child| Visit {
            node: child as usize,
            parent: Some(index),
            transform,
            role,
        }));
    }
    findings.add("lower-levels-of-detail", lower_detail, || {
        "Nodes that MSFT_lod names as lower levels of detail were left out with their children".into()
    });
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

/// Which nodes MSFT_lod names as lower levels of detail of another, which stands in the level itself.
fn lower_details(document: &Document) -> Vec<bool> {
    let mut is_lower = vec![false; document.nodes.len()];
    for (index, node) in document.nodes.iter().enumerate() {
        let ids = node.extensions.get("MSFT_lod").and_then(|lod| lod.get("ids")).and_then(Value::as_array);
        if is_lower[index] {
            continue;
        }
        for id in ids.into_iter().flatten().filter_map(Value::as_u64) {
            if let Some(flag) = is_lower.get_mut(id as usize).filter(|_| id as usize != index) {
                *flag = true;
            }
        }
    }
    is_lower
}

/// Where nodes stand in the world, whether the scene holds them or not: joints.
pub(super) struct Joints {
    parents: Vec<Option<u32>>,
}

impl Joints {
    /// Of all nodes.
    pub fn new(document: &Document) -> Joints {
        let mut parents = vec![None; document.nodes.len()];
        for (index, node) in document.nodes.iter().enumerate() {
            for child in &node.children {
                if let Some(parent) = parents.get_mut(*child as usize) {
                    *parent = Some(index as u32);
                }
            }
        }
        Joints { parents }
    }

    /// Joint to world, times the inverse bind matrix, for each joint of a skin: mesh to world.
    pub fn transforms(&self, buffers: &Buffers, skin_index: usize, place: &str) -> Result<Vec<DAffine3>> {
        let document = buffers.document;
        let skin = document.get(&document.skins, skin_index, "skin", &place)?;
        let place = format!("{place}: skin {skin_index}");
        let inverse = match skin.inverse_bind_matrices {
            None => None,
            Some(accessor) => {
                let place = format!("{place}: inverseBindMatrices");
                let elements = Elements::open(buffers, accessor as usize, &[Type::Mat4], &place)?;
                if elements.count < skin.joints.len() {
                    return Err(document.invalid(format!(
                        "{place}: {} matrices for {} joints; expected one each",
                        elements.count,
                        skin.joints.len()
                    )));
                }
                Some(elements)
            }
        };
        let transform = |(number, &joint): (usize, &u32)| {
            let world = self.world(document, joint as usize, &place)?;
            let bind = inverse.as_ref().map_or(DAffine3::IDENTITY, |elements| {
                let columns = elements.vector::<16>(number).map(f64::from);
                DAffine3::from_mat4(DMat4::from_cols_array(&columns))
            });
            let transform = world * bind;
            if !transform.is_finite() {
                return Err(
                    document.invalid(format!("{place}: joint {number} (node {joint}): its place is not finite"))
                );
            }
            Ok(transform)
        };
        skin.joints.iter().enumerate().map(transform).collect()
    }

    fn world(&self, document: &Document, node: usize, place: &str) -> Result<DAffine3> {
        let mut transform = DAffine3::IDENTITY;
        let mut next = Some(node);
        for _ in 0..=document.nodes.len() {
            let Some(index) = next else { return Ok(transform) };
            let node = document.get(&document.nodes, index, "node", &place)?;
            transform = local_transform(document, node, &document.node_label(index))? * transform;
            next = self.parents[index].map(|parent| parent as usize);
        }
        Err(document.invalid(format!("{place}: node {node} is its own ancestor; nodes must form trees without cycles")))
    }
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
