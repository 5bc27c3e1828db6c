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
//! text        JSON as others write it            properties  custom properties: which are understood
//! skin        vertices by joints
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
mod properties;
mod skin;
mod text;
mod texture;
mod uri;

use std::path::{Path, PathBuf};

use glam::DAffine3;

use super::files::{Disk, Files};
use crate::scene::{Mesh, Metals, ProbeMarker, Role, Scene, VolumeMarker};
use crate::{Error, Result};
use buffers::Buffers;
use document::Document;
use findings::Findings;
use hierarchy::{Joints, PlacedNode};
use material::{Draft, Textures, UsedBy};
use primitive::Pose;

/// How to read a level.
#[derive(Debug, Clone, PartialEq)]
pub struct GltfOptions {
    /// Which scene of the file; none: its default scene, else scene 0, else all root nodes.
    pub scene: Option<usize>,
    /// More triangles than this, instances counted, are [`Error::Unsupported`].
    pub max_triangles: u64,
    /// Which textures are decoded.
    pub textures: TextureNeeds,
    /// What metals reflect.
    pub metals: Metals,
    /// Intensities of KHR_lights_punctual are divided by this, which an exporter multiplied watts by (Blender: 683); over 0.
    pub lumens_per_watt: Option<f32>,
    /// A needed texture that is missing, damaged or in a format that is not read is mid-grey and a finding, instead of an
    /// error.
    pub allow_missing_textures: bool,
}

impl Default for GltfOptions {
    /// The file's default scene, 100 million triangles, the textures that a GDIBL bake needs, metals that reflect.
    fn default() -> Self {
        GltfOptions {
            scene: None,
            max_triangles: 100_000_000,
            textures: TextureNeeds::Gdibl,
            metals: Metals::Diffuse,
            lumens_per_watt: None,
            allow_missing_textures: false,
        }
    }
}

/// Which textures a method needs. Others are not decoded, and may be missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum TextureNeeds {
    /// Alpha of masked and blended materials, and what tints light that goes through; all of materials on
    /// [`Role::Scene`] geometry that changes light. The
    /// environment's colours are in the probes' pixels. Of a level with scene geometry, which throws shadows on the
    /// environment, what the environment reflects too.
    Gdibl,
    /// As for GDIBL, and the environment's emission: GDIBL by probes that were captured from the level itself.
    Captured,
    /// All that changes light, of every used material: path tracing.
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
    read_level_from(&Disk, path, options)
}

/// The same with the bytes that `files` gives.
pub fn read_level_from(files: &dyn Files, path: &Path, options: &GltfOptions) -> Result<Scene> {
    let bytes = files.read(path).map_err(|e| Error::io(path, e))?;
    parse(files, &bytes, path, options)
}

/// What a level names beside itself.
#[derive(Debug, Clone)]
pub struct Named {
    /// The files that it refers to and that are there, in its order: with the level itself, all that its light depends on.
    pub files: Vec<PathBuf>,
    /// The probes that its nodes mark.
    pub probe_markers: Vec<ProbeMarker>,
    /// The boxes of volumes that its nodes place.
    pub volume_markers: Vec<VolumeMarker>,
}

/// What the level at `path` names.
pub fn named_by(files: &dyn Files, path: &Path) -> Result<Named> {
    let bytes = files.read(path).map_err(|e| Error::io(path, e))?;
    let mut findings = Findings::default();
    let document = Document::read(files, &container::split(&bytes, path, &mut findings)?, path, &mut findings)?;
    let nodes = hierarchy::place_nodes(&document, None, &mut findings)?;
    let (probe_markers, volume_markers) = markers::read(&document, &nodes, &mut findings)?;
    let buffers = document.buffers.iter().filter_map(|buffer| buffer.uri.as_deref());
    let images = document.images.iter().filter_map(|image| image.uri.as_deref());
    let named = buffers.chain(images).filter_map(|uri| uri::file(uri, path));
    Ok(Named { files: named.filter(|file| file.is_file()).collect(), probe_markers, volume_markers })
}

/// Reads a level from its bytes. `path` names it in messages, and its folder is where files are looked for.
pub fn parse_level(bytes: &[u8], path: &Path, options: &GltfOptions) -> Result<Scene> {
    parse(&Disk, bytes, path, options)
}

fn parse(files: &dyn Files, bytes: &[u8], path: &Path, options: &GltfOptions) -> Result<Scene> {
    let mut findings = Findings::default();
    let container = container::split(bytes, path, &mut findings)?;
    let document = Document::read(files, &container, path, &mut findings)?;
    let buffers = Buffers::new(&document);

    let nodes = hierarchy::place_nodes(&document, options.scene, &mut findings)?;
    let lights = lights::read(&document, &nodes, options.lumens_per_watt, &mut findings)?;
    let (probe_markers, volume_markers) = markers::read(&document, &nodes, &mut findings)?;

    let drafts = material::read(&document, options.metals, &mut findings)?;
    let objects = has_objects(&document, &nodes)?;
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
    let allow = options.allow_missing_textures;
    let (materials, textures, maps) = material::finish(&buffers, drafts, &used, textures, allow, &mut findings)?;
    for mesh in &mut meshes {
        let material = &materials[mesh.material as usize];
        for (set, uvs) in mesh.uvs.iter_mut().enumerate() {
            let mut uses = material.textures().into_iter().chain(material.maps()).flatten();
            if !uses.any(|texture| texture.uv_set as usize == set) {
                *uvs = Vec::new();
            }
        }
    }
    let mut scene = Scene {
        meshes,
        materials,
        textures,
        maps,
        materials_left_out,
        lights,
        probe_markers,
        volume_markers,
        findings: Vec::new(),
    };
    if options.lumens_per_watt.is_none() {
        lights::compare_with_emitters(&scene, &mut findings);
    }
    scene.findings = findings.into_vec();
    Ok(scene)
}

/// Some mesh is scene geometry.
fn has_objects(document: &Document, nodes: &[PlacedNode]) -> Result<bool> {
    for placed in nodes {
        let Some(index) = document.nodes[placed.node].mesh else { continue };
        let Some(mesh) = document.meshes.get(index as usize) else { continue };
        for primitive in &mesh.primitives {
            let material = primitive.material.map(|material| material.value());
            if placed.role_of(document, index as usize, material)? == Some(Role::Scene) {
                return Ok(true);
            }
        }
    }
    Ok(false)
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
    let mut joints = None;
    for placed in nodes.iter().filter(|placed| placed.role.is_some()) {
        read_node(buffers, placed, drafts, options, textures, &mut joints, &mut triangles, &mut meshes, findings)?;
    }
    Ok(meshes)
}

/// The mesh of one node, once per instance.
#[expect(clippy::too_many_arguments, reason = "one step of read_meshes")]
fn read_node(
    buffers: &Buffers,
    placed: &PlacedNode,
    drafts: &[Draft],
    options: &GltfOptions,
    textures: Textures,
    joints: &mut Option<Joints>,
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
    let skin = match node.skin {
        None => None,
        Some(skin) => {
            let joints = joints.get_or_insert_with(|| Joints::new(document));
            Some(joints.transforms(buffers, skin as usize, &label)?)
        }
    };
    findings.add("skinned-meshes", u64::from(skin.is_some()), || {
        format!("Skinned meshes stand in the one pose that the file's nodes give their joints, first {label}")
    });
    let weights: &[f32] = node.weights.as_ref().or(mesh.weights.as_ref()).map_or(&[], |weights| weights);
    findings.add("morphed-meshes", u64::from(weights.iter().any(|&weight| weight != 0.0)), || {
        format!("Meshes with morph targets stand as their default weights say, first {label}")
    });

    let pose = Pose { weights, joints: skin.as_deref() };

    // Joints place a skinned mesh, once.
    let instances = match &skin {
        None => hierarchy::Instances::open(buffers, placed.node)?,
        Some(_) => None,
    };
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

        let said = primitive.material.map(|material| material.value());
        let Some(role) = placed.role_of(document, mesh_index as usize, said)? else { continue };

        // The default material is number 0.
        let material = match primitive.material {
            None => 0,
            Some(material) => {
                document.get(&document.materials, material.value(), "material", &place)?;
                material.value() + 1
            }
        };
        let wanted = drafts[material].wanted(role, textures);
        let Some(local) = primitive::read(buffers, primitive, &place, &pose, wanted, findings)? else { continue };
        let transforms = match &mut transforms {
            Some(transforms) => transforms,
            none => none.insert(match &instances {
                None => vec![placed.transform],
                Some(instances) => {
                    instances.transforms(document)?.into_iter().map(|instance| placed.transform * instance).collect()
                }
            }),
        };
        for (instance, transform) in transforms.iter().enumerate() {
            let frame = Mesh {
                node: placed.node as u32,
                mesh: mesh_index,
                primitive: primitive_index as u32,
                role,
                material: material as u32,
                file_accessors: primitive::accessors(primitive),
                instance: instance as u32,
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
