//! The JSON part of a level.
//!
//! Elements are those of the `gltf` crate's JSON model where it can read what real files hold. Nodes, scenes and
//! lights are our own, because the crate's
//! - keep a node's place as f32, and a level may stand a thousand kilometres from the origin,
//! - demand `nodes` of a scene, which the specification does not,
//! - fail on `extras` inside an extension (which Blender writes for lights),
//!
//! and its animations and cameras, of which nothing is needed, fail on newer extensions. The crate's
//! validation is not used: it indexes with unchecked numbers, and of 113 test levels it refused five that are fine
//! (required extensions that are read here, a texture without its image that nothing uses). Each element is read
//! by itself, so that an error can say which one is wrong.

use std::path::Path;

use gltf::json;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use super::container::Container;
use super::findings::Findings;
use super::properties;
use super::text;
use crate::import::files::Files;
use crate::{Error, Result};

/// Extensions that a file may *require*: those that are read, and those whose absence does not change where
/// triangles are and what diffuse light does.
const KNOWN_EXTENSIONS: &[&str] = &[
    // Read.
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_emissive_strength",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_node_visibility",
    "KHR_texture_transform",
    "MSFT_lod",
    // Refused where a triangle needs them, with the tool that converts.
    "EXT_texture_avif",
    "KHR_draco_mesh_compression",
    "KHR_texture_basisu",
    "MSFT_texture_dds",
    // Without effect here.
    "KHR_animation_pointer",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_dispersion",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_variants",
    "KHR_xmp",
    "KHR_xmp_json_ld",
];

/// A level's JSON, element by element. Every index in it is still unchecked: use [`Document::get`].
pub(super) struct Document<'a> {
    /// The level, for messages and for the folder of its files.
    pub path: &'a Path,
    /// Gives the bytes of files that the level names.
    pub files: &'a dyn Files,
    /// The GLB's binary chunk.
    pub binary: Option<&'a [u8]>,
    pub accessors: Vec<json::Accessor>,
    pub buffers: Vec<json::Buffer>,
    pub buffer_views: Vec<json::buffer::View>,
    pub images: Vec<json::Image>,
    pub materials: Vec<json::Material>,
    pub meshes: Vec<json::Mesh>,
    pub samplers: Vec<json::texture::Sampler>,
    pub textures: Vec<json::Texture>,
    pub nodes: Vec<Node>,
    pub skins: Vec<Skin>,
    /// `gdibl_role` of the extras of meshes and materials, by their numbers.
    pub mesh_roles: Vec<Option<Value>>,
    pub material_roles: Vec<Option<Value>>,
    pub scenes: Vec<SceneRoots>,
    pub default_scene: Option<u32>,
    pub lights: Vec<Light>,
    /// `extensionsRequired`.
    pub required: Vec<String>,
}

/// A node, as far as a bake needs it, in f64.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Node {
    pub name: Option<String>,
    pub children: Vec<u32>,
    pub mesh: Option<u32>,
    pub skin: Option<u32>,
    pub matrix: Option<[f64; 16]>,
    pub translation: Option<[f64; 3]>,
    pub rotation: Option<[f64; 4]>,
    pub scale: Option<[f64; 3]>,
    pub weights: Option<Vec<f32>>,
    pub extras: Value,
    pub extensions: Map<String, Value>,
}

/// A skin: where its joints are, and where they were when the mesh was made.
#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Skin {
    pub inverse_bind_matrices: Option<u32>,
    pub joints: Vec<u32>,
}

/// The roots of a scene.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct SceneRoots {
    pub nodes: Vec<u32>,
}

/// A light of KHR_lights_punctual.
#[derive(Debug, Deserialize)]
pub(super) struct Light {
    pub name: Option<String>,
    #[serde(rename = "type")]
    pub kind: String,
    #[serde(default = "white")]
    pub color: [f32; 3],
    #[serde(default = "one")]
    pub intensity: f32,
    pub range: Option<f32>,
    #[serde(default)]
    pub spot: Spot,
}

/// The cone of a spot light, half angles in radians.
#[derive(Debug, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Spot {
    pub inner_cone_angle: f32,
    pub outer_cone_angle: f32,
}

impl Default for Spot {
    fn default() -> Self {
        Spot { inner_cone_angle: 0.0, outer_cone_angle: std::f32::consts::FRAC_PI_4 }
    }
}

fn white() -> [f32; 3] {
    [1.0; 3]
}

fn one() -> f32 {
    1.0
}

impl<'a> Document<'a> {
    /// Reads the JSON, checks version and required extensions.
    pub fn read(
        files: &'a dyn Files,
        container: &Container<'a>,
        path: &'a Path,
        findings: &mut Findings,
    ) -> Result<Self> {
        let invalid = |message: String| Error::invalid(path, message);
        let mut json: Value =
            text::parse(container.json, findings).map_err(|e| invalid(format!("JSON: {e}; the file is damaged")))?;
        text::simplify(&mut json);
        let Value::Object(mut root) = json else {
            return Err(invalid("JSON: the outermost value is not an object".into()));
        };

        check_version(&root, path)?;
        let used: Vec<String> = take(&mut root, "extensionsUsed", path)?;
        let required: Vec<String> = take(&mut root, "extensionsRequired", path)?;
        if let Some(name) = required.iter().find(|name| !KNOWN_EXTENSIONS.contains(&name.as_str())) {
            return Err(Error::unsupported(
                path,
                format!(
                    "extensionsRequired: \"{name}\" is not known to gdibl; export without it, or make it optional \
                     (extensionsUsed)"
                ),
            ));
        }
        let ignored: Vec<&str> =
            used.iter().map(String::as_str).filter(|name| !KNOWN_EXTENSIONS.contains(name)).collect();
        findings.add("ignored-extensions", ignored.len() as u64, || {
            format!("Extensions that gdibl does not know were ignored: {}", ignored.join(", "))
        });

        properties::check(&root, findings);

        // Extensions of the root: only the lights matter.
        let lights = match root.get_mut("extensions").and_then(|e| e.get_mut("KHR_lights_punctual")) {
            Some(Value::Object(extension)) => take(extension, "lights", path)?,
            _ => Vec::new(),
        };
        let default_scene = match root.remove("scene") {
            None | Some(Value::Null) => None,
            Some(value) => Some(u32::deserialize(value).map_err(|e| invalid(format!("scene: {e}")))?),
        };
        let mesh_roles = properties::roles(&root, "meshes");
        let material_roles = properties::roles(&root, "materials");
        let nodes = take(&mut root, "nodes", path)?;
        let skins = take(&mut root, "skins", path)?;
        let scenes = take(&mut root, "scenes", path)?;

        // What is left goes to the crate's model, which fails on extras inside extensions, and cuts numbers to 32 bits.
        for (name, value) in root.iter_mut() {
            drop_extras(value);
            check_indices(name, value).map_err(|number| {
                invalid(format!("{name}: {number} is no index and no enumeration value; the file is damaged"))
            })?;
        }
        Ok(Document {
            path,
            files,
            binary: container.binary,
            accessors: take(&mut root, "accessors", path)?,
            buffers: take(&mut root, "buffers", path)?,
            buffer_views: take(&mut root, "bufferViews", path)?,
            images: take(&mut root, "images", path)?,
            materials: take(&mut root, "materials", path)?,
            meshes: take(&mut root, "meshes", path)?,
            samplers: take(&mut root, "samplers", path)?,
            textures: take(&mut root, "textures", path)?,
            nodes,
            skins,
            mesh_roles,
            material_roles,
            scenes,
            default_scene,
            lights,
            required,
        })
    }

    /// `list[index]`, or an error that says who asked for what: "node 3: mesh 7 does not exist; the file has 2".
    pub fn get<'t, T>(&self, list: &'t [T], index: usize, what: &str, place: &dyn std::fmt::Display) -> Result<&'t T> {
        list.get(index).ok_or_else(|| {
            self.invalid(format!("{place}: {what} {index} does not exist; the file has {} of them", list.len()))
        })
    }

    /// An [`Error::Invalid`] about this level.
    pub fn invalid(&self, message: impl Into<String>) -> Error {
        Error::invalid(self.path, message)
    }

    /// An [`Error::Unsupported`] about this level.
    pub fn unsupported(&self, message: impl Into<String>) -> Error {
        Error::unsupported(self.path, message)
    }

    /// "node 5 (Lamp)", for messages.
    pub fn node_label(&self, node: usize) -> String {
        match self.nodes.get(node).and_then(|n| n.name.as_deref()) {
            Some(name) => format!("node {node} ({name})"),
            None => format!("node {node}"),
        }
    }
}

/// Takes the array `key` out of `object`; none is empty. Reads each element by itself to name it in errors.
fn take<T: DeserializeOwned>(object: &mut Map<String, Value>, key: &str, path: &Path) -> Result<Vec<T>> {
    match object.remove(key) {
        None | Some(Value::Null) => Ok(Vec::new()),
        Some(Value::Array(elements)) => elements
            .into_iter()
            .enumerate()
            .map(|(i, element)| {
                serde_json::from_value(element).map_err(|e| Error::invalid(path, format!("{key}[{i}]: {e}")))
            })
            .collect(),
        Some(_) => Err(Error::invalid(path, format!("{key}: expected an array"))),
    }
}

/// Refuses what is not glTF 2.x, or asks for more than 2.0.
fn check_version(root: &Map<String, Value>, path: &Path) -> Result<()> {
    let field = |name: &str| root.get("asset").and_then(|asset| asset.get(name)).and_then(Value::as_str);
    let parse = |version: &str| -> Option<(u32, u32)> {
        let (major, minor) = version.split_once('.')?;
        Some((major.parse().ok()?, minor.parse().ok()?))
    };
    let Some(version) = field("version") else {
        return Err(Error::invalid(path, "asset.version is missing; expected \"2.0\". Is this a glTF file?"));
    };
    let least = field("minVersion");
    match (parse(version), least.map(parse)) {
        (Some((2, _)), None | Some(Some((2, 0)))) => Ok(()),
        (Some(_), None | Some(Some(_))) => Err(Error::unsupported(
            path,
            match least {
                Some(least) => {
                    format!("asset.minVersion is {least}; gdibl reads glTF 2.0. Export the level as glTF 2.0")
                }
                None => format!("asset.version is {version}; gdibl reads glTF 2.0. Export the level as glTF 2.0"),
            },
        )),
        _ => Err(Error::invalid(path, format!("asset.version \"{version}\" or minVersion is not of the form \"2.0\""))),
    }
}

/// Removes every `extras` below `value`. (JSON is at most 128 levels deep: the parser's limit.)
fn drop_extras(value: &mut Value) {
    match value {
        Value::Object(object) => {
            object.remove("extras");
            object.values_mut().for_each(drop_extras);
        }
        Value::Array(elements) => elements.iter_mut().for_each(drop_extras),
        _ => {}
    }
}

/// The crate's model reads indices and enumeration values as u64 and cuts them to 32 bits: 4294967296 would pass as 0.
/// Returns the first number that would be cut.
fn check_indices(key: &str, value: &Value) -> std::result::Result<(), u64> {
    match value {
        Value::Object(object) => object.iter().try_for_each(|(inner, v)| {
            // attributes { POSITION: index } and targets [{ POSITION: index }]
            check_indices(if matches!(key, "attributes" | "targets") { key } else { inner }, v)
        }),
        Value::Array(elements) => elements.iter().try_for_each(|v| check_indices(key, v)),
        Value::Number(number) => {
            let is_cut = matches!(
                key,
                "attributes"
                    | "targets"
                    | "buffer"
                    | "bufferView"
                    | "componentType"
                    | "index"
                    | "indices"
                    | "material"
                    | "mode"
                    | "sampler"
                    | "source"
                    | "target"
                    | "wrapS"
                    | "wrapT"
            );
            match number.as_u64() {
                Some(n) if is_cut && n > u64::from(u32::MAX) => Err(n),
                _ => Ok(()),
            }
        }
        _ => Ok(()),
    }
}
