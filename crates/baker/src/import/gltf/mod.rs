//! Reads a glTF 2.0 level (`.gltf` or `.glb`, told apart by the first bytes) into a [`Scene`].
//!
//! Levels come from many exporters and sometimes from strangers, so no number in a file is believed: every index is
//! looked up checked, every length is checked against the bytes that are there, and sizes are capped before memory is
//! allocated. A file that contradicts itself where the result would be in doubt is [`crate::Error::Invalid`]; what can
//! be left out without doubt (points and lines, an extension that changes no light) is left out and becomes a
//! [`crate::Finding`]. Nothing but the level's own folder is opened.
//!
//! ```text
//! container   GLB or JSON                        accessor    typed, strided, sparse elements
//! document    the JSON, versions, extensions     primitive   triangles and vertices in the mesh's space
//! uri         data: and files                    place       in the world: winding, normals
//! buffers     bytes of buffer views              material    factors, what is needed of textures
//! meshopt     compressed buffer views            texture     decoded pixels
//! hierarchy   nodes, roles, instances            lights, markers
//! ```
//!
//! Based on: Khronos Group, *glTF 2.0 Specification*, 2021, and its extensions' texts.

mod accessor;
mod buffers;
mod container;
mod document;
mod findings;
mod hierarchy;
mod lights;
mod markers;
mod material;
mod meshopt;
mod place;
mod primitive;
mod texture;
mod uri;

use std::path::Path;

use glam::DAffine3;

use crate::scene::{Mesh, Role, Scene};
use crate::{Error, Result};
use buffers::Buffers;
use document::Document;
use findings::Findings;
use hierarchy::PlacedNode;
use material::{Draft, Textures, UsedBy};

/// How to read a level.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GltfOptions {
    /// Which scene of the file; none: its default scene, else scene 0, else all root nodes.
    pub scene: Option<usize>,
    /// More triangles than this, instances counted, are [`Error::Unsupported`].
    pub max_triangles: u64,
    /// Which textures are decoded.
    pub textures: TextureNeeds,
}

impl Default for GltfOptions {
    /// The file's default scene, 100 million triangles, the textures that a GDIBL bake needs.
    fn default() -> Self {
        GltfOptions { scene: None, max_triangles: 100_000_000, textures: TextureNeeds::Gdibl }
    }
}

/// Which textures a method needs. Others are not decoded, and may be missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum TextureNeeds {
    /// Alpha of masked and blended materials; base colour and emission of materials on [`Role::Scene`] geometry. The
    /// environment's colours are in the probes' pixels. Of a level with scene geometry, which throws shadows on the
    /// environment, its base colours too.
    Gdibl,
    /// As for GDIBL, and the environment's emission: GDIBL by probes that were captured from the level itself.
    Captured,
    /// Base colour and emission of every used material: path tracing.
    All,
}

/// Reads the level at `path`, and the files beside it that it names.
///
/// ```no_run
/// # use gdibl_baker::import::gltf::{GltfOptions, read_level};
/// let scene = read_level("level.glb".as_ref(), &GltfOptions::default())?;
/// println!("{} triangles", scene.meshes.iter().map(|mesh| mesh.triangles.len()).sum::<usize>());
/// # Ok::<(), gdibl_baker::Error>(())
/// ```
pub fn read_level(path: &Path, options: &GltfOptions) -> Result<Scene> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    parse_level(&bytes, path, options)
}

/// The bytes of the level at `path` and of every file beside it that it names, in its order: what its light depends on, for
/// recognising it again. A file that is missing counts as empty: it may not be needed.
pub fn read_files(path: &Path) -> Result<Vec<Vec<u8>>> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    let mut findings = Findings::default();
    let mut files = Vec::new();
    {
        let document = Document::read(&container::split(&bytes, path, &mut findings)?, path, &mut findings)?;
        let buffers = document.buffers.iter().filter_map(|buffer| buffer.uri.as_deref());
        let images = document.images.iter().filter_map(|image| image.uri.as_deref());
        for uri in buffers.chain(images).filter(|uri| !uri::is_data(uri)) {
            files.push(uri::load(uri, path, "a file").unwrap_or_default());
        }
    }
    files.insert(0, bytes);
    Ok(files)
}

/// Reads a level from its bytes. `path` names it in messages, and its folder is where files are looked for.
pub fn parse_level(bytes: &[u8], path: &Path, options: &GltfOptions) -> Result<Scene> {
    let mut findings = Findings::default();
    let container = container::split(bytes, path, &mut findings)?;
    let document = Document::read(&container, path, &mut findings)?;
    let buffers = Buffers::new(&document);

    let nodes = hierarchy::place_nodes(&document, options.scene, &mut findings)?;
    let lights = lights::read(&document, &nodes, &mut findings)?;
    let (probe_markers, volume_markers) = markers::read(&document, &nodes)?;

    let drafts = material::read(&document, &mut findings)?;
    let objects = nodes.iter().any(|node| node.role == Some(Role::Scene) && document.nodes[node.node].mesh.is_some());
    let textures = Textures {
        all: options.textures == TextureNeeds::All,
        emission: options.textures == TextureNeeds::Captured,
        objects,
    };
    let mut meshes = read_meshes(&buffers, &nodes, &drafts, options, textures, &mut findings)?;

    // Only now is it known which materials have triangles.
    let mut used = vec![UsedBy::default(); drafts.len()];
    for mesh in &meshes {
        let used = &mut used[mesh.material as usize];
        match mesh.role {
            Role::Environment => used.environment = true,
            Role::Scene => used.scene = true,
        }
    }
    let leaves_out = |(draft, used): (&Draft, &UsedBy)| used.environment && draft.leaves_out(textures);
    let materials_left_out = drafts.iter().zip(&used).any(leaves_out);
    let (materials, textures) = material::finish(&buffers, drafts, &used, textures)?;
    for mesh in &mut meshes {
        let material = &materials[mesh.material as usize];
        for (set, uvs) in mesh.uvs.iter_mut().enumerate() {
            let uses = [material.base_color_texture, material.emission_texture];
            if !uses.iter().flatten().any(|texture| texture.uv_set as usize == set) {
                *uvs = Vec::new();
            }
        }
    }
    Ok(Scene {
        meshes,
        materials,
        textures,
        materials_left_out,
        lights,
        probe_markers,
        volume_markers,
        findings: findings.into_vec(),
    })
}

/// The meshes of all nodes that are not ignored.
fn read_meshes(
    buffers: &Buffers,
    nodes: &[PlacedNode],
    drafts: &[Draft],
    options: &GltfOptions,
    textures: Textures,
    findings: &mut Findings,
) -> Result<Vec<Mesh>> {
    let mut meshes = Vec::new();
    let mut triangles = 0_u64;
    for placed in nodes {
        if let Some(role) = placed.role {
            read_node(buffers, placed, role, drafts, options, textures, &mut triangles, &mut meshes, findings)?;
        }
    }
    Ok(meshes)
}

/// The mesh of one node, once per instance.
#[expect(clippy::too_many_arguments, reason = "one step of read_meshes")]
fn read_node(
    buffers: &Buffers,
    placed: &PlacedNode,
    role: Role,
    drafts: &[Draft],
    options: &GltfOptions,
    textures: Textures,
    triangles: &mut u64,
    meshes: &mut Vec<Mesh>,
    findings: &mut Findings,
) -> Result<()> {
    let document = buffers.document;
    let node = &document.nodes[placed.node];
    let Some(mesh_index) = node.mesh else { return Ok(()) };
    let label = document.node_label(placed.node);
    let mesh = document.get(&document.meshes, mesh_index as usize, "mesh", &label)?;

    // Skins and morph targets: a bake sees one pose.
    findings.add("skinned-meshes", u64::from(node.skin.is_some()), || {
        format!("Skinned meshes stand as they were modelled, without their skeleton's pose, first {label}")
    });
    let weights: &[f32] = node.weights.as_ref().or(mesh.weights.as_ref()).map_or(&[], |weights| weights);
    findings.add("morphed-meshes", u64::from(weights.iter().any(|&weight| weight != 0.0)), || {
        format!("Meshes with morph targets stand as their default weights say, first {label}")
    });

    let instances = hierarchy::Instances::open(buffers, placed.node)?;
    let copies = instances.as_ref().map_or(1, |instances| instances.count) as u64;
    let mut transforms: Option<Vec<DAffine3>> = None;
    for (primitive_index, primitive) in mesh.primitives.iter().enumerate() {
        let place = format!("mesh {mesh_index} primitive {primitive_index}");

        // The cap, before anything is allocated.
        let own = primitive::count_triangles(buffers, primitive, &place)?;
        *triangles = triangles.saturating_add(own.saturating_mul(copies));
        if *triangles > options.max_triangles {
            return Err(document.unsupported(format!(
                "{label}: with {place} the level has {triangles} triangles, instances counted; at most {} are read. \
                 Split the level, or raise the limit",
                options.max_triangles
            )));
        }

        // The default material is number 0.
        let material = match primitive.material {
            None => 0,
            Some(material) => {
                document.get(&document.materials, material.value(), "material", &place)?;
                material.value() + 1
            }
        };
        let wanted = drafts[material].wanted(role, textures);
        let Some(local) = primitive::read(buffers, primitive, &place, weights, wanted, findings)? else { continue };
        let transforms = match &mut transforms {
            Some(transforms) => transforms,
            none => none.insert(match &instances {
                None => vec![placed.transform],
                Some(instances) => {
                    instances.transforms(document)?.into_iter().map(|instance| placed.transform * instance).collect()
                }
            }),
        };
        for transform in transforms.iter() {
            let frame = Mesh {
                node: placed.node as u32,
                mesh: mesh_index,
                primitive: primitive_index as u32,
                role,
                material: material as u32,
                ..Mesh::default()
            };
            let (mesh, losses) = place::place(&local, transform, frame);
            let first = || format!("first in {label}, {place}");
            findings.add("non-finite-triangles", losses.non_finite, || {
                format!("Triangles with a corner that is not finite were dropped, {}", first())
            });
            findings.add("zero-area-triangles", losses.zero_area, || {
                format!("Triangles without area were dropped, {}", first())
            });
            findings.add("repaired-normals", losses.bad_normals, || {
                format!("Normals without a direction were computed from the triangles, {}", first())
            });
            if !mesh.triangles.is_empty() {
                meshes.push(mesh);
            }
        }
    }
    Ok(())
}
