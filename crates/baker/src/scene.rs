//! The level as the baker sees it: triangles in world space, materials as far as light needs them, lights, and
//! what artists marked. World = glTF: right-handed, Y up, metres.
//!
//! Positions are f64: a level may stand a thousand kilometres from the origin. Tracing re-centres and rescales
//! them to f32 (see `trace`).

use glam::{DMat3, DQuat, DVec3, Vec2, Vec3, Vec4};
use std::path::PathBuf;

use crate::Finding;

/// Everything imported from a level.
#[derive(Debug, Clone, Default)]
pub struct Scene {
    /// One entry per glTF primitive per node (and per instance of EXT_mesh_gpu_instancing) that has triangles.
    pub meshes: Vec<Mesh>,
    /// Index 0 is glTF's default material; the level's own follow.
    pub materials: Vec<Material>,
    /// Decoded only where a material that needs them is used by a triangle; see [`TextureUse`].
    pub textures: Vec<Texture>,
    /// KHR_lights_punctual, placed in the world.
    pub lights: Vec<PunctualLight>,
    /// Nodes with `extras.gdibl_probe`.
    pub probe_markers: Vec<ProbeMarker>,
    /// Nodes with `extras.gdibl_volume`.
    pub volume_markers: Vec<VolumeMarker>,
    /// What was dropped or ignored.
    pub findings: Vec<Finding>,
}

/// What part a piece of geometry plays (design: `extras.gdibl_role` on the glTF node; children inherit it).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Role {
    /// The probes have seen it: it carries their radiance and blocks their lines of sight.
    #[default]
    Environment,
    /// The probes have not seen it: it blocks query rays and reflects, but never disqualifies a probe.
    Scene,
}

/// One primitive instance, in world space, with non-finite and zero-area triangles already dropped.
#[derive(Debug, Clone, Default)]
pub struct Mesh {
    /// glTF node index.
    pub node: u32,
    /// glTF mesh index.
    pub mesh: u32,
    /// Primitive index within the glTF mesh.
    pub primitive: u32,
    /// Environment or scene geometry.
    pub role: Role,
    /// Index into [`Scene::materials`].
    pub material: u32,
    /// World positions, metres.
    pub positions: Vec<DVec3>,
    /// World unit normals, one per position; computed (area-weighted) where the file has none.
    pub normals: Vec<Vec3>,
    /// Texture coordinates, sets 0 and 1; empty, or one per position. Only kept when a decoded texture uses them.
    pub uvs: [Vec<Vec2>; 2],
    /// Linear vertex colours (COLOR_0); empty, or one per position.
    pub colors: Vec<Vec4>,
    /// Indices into `positions`, counter-clockwise seen from the front (already turned round for nodes of
    /// negative scale).
    pub triangles: Vec<[u32; 3]>,
}

/// A material, as far as diffuse light needs it.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// The file's name for it, or empty.
    pub name: String,
    /// Linear base colour factor, 0..=1, alpha last.
    pub base_color: Vec4,
    /// Base colour texture (sRGB), if it had to be decoded.
    pub base_color_texture: Option<TextureUse>,
    /// 0..=1; diffuse albedo is base colour × (1 - metallic).
    pub metallic: f32,
    /// Linear emitted radiance: factor × KHR_materials_emissive_strength; for unlit materials the base colour.
    pub emission: Vec3,
    /// Emission texture (sRGB), if it had to be decoded.
    pub emission_texture: Option<TextureUse>,
    /// How alpha acts on rays.
    pub alpha: Alpha,
    /// Emission leaves from both sides when set; rays are blocked from both sides in any case.
    pub double_sided: bool,
    /// KHR_materials_unlit: reflects nothing, `emission` is its colour.
    pub unlit: bool,
}

impl Default for Material {
    /// glTF's default material: white, metallic 1 as glTF defines it, opaque, single-sided, no emission.
    fn default() -> Self {
        Material {
            name: String::new(),
            base_color: Vec4::ONE,
            base_color_texture: None,
            metallic: 1.0,
            emission: Vec3::ZERO,
            emission_texture: None,
            alpha: Alpha::Opaque,
            double_sided: false,
            unlit: false,
        }
    }
}

/// What alpha does to a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Alpha {
    /// Blocks fully.
    Opaque,
    /// Texels under the cutoff (0..=1) are holes.
    Mask(f32),
    /// Lets `1 - alpha` through.
    Blend,
}

/// A texture and how a material looks it up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TextureUse {
    /// Index into [`Scene::textures`].
    pub texture: u32,
    /// Which of [`Mesh::uvs`].
    pub uv_set: u32,
    /// `uv' = transform * (u, v, 1)` (KHR_texture_transform; identity without it).
    pub transform: glam::Mat3,
}

/// A decoded texture, linear, row 0 at v = 0.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// sRGB-encoded colour and linear alpha, 8 bit, row by row; [`Texture::sample`] decodes.
    pub rgba8: Vec<[u8; 4]>,
    /// Wrapping of u and v.
    pub wrap: [Wrap; 2],
}

/// Texture wrapping, as in glTF samplers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wrap {
    /// Tile.
    Repeat,
    /// Tile, every second one mirrored.
    MirroredRepeat,
    /// The edge pixel goes on.
    ClampToEdge,
}

/// A light of KHR_lights_punctual, in the world.
#[derive(Debug, Clone, PartialEq)]
pub struct PunctualLight {
    /// The node's or light's name.
    pub name: String,
    /// Kind with its angles.
    pub kind: PunctualKind,
    /// Linear colour × intensity: candela for point and spot, lux for directional.
    pub intensity: Vec3,
    /// Metres; infinite where the file gives none.
    pub range: f32,
    /// World position.
    pub position: DVec3,
    /// Unit direction in which it shines (the node's -Z).
    pub direction: Vec3,
}

/// Kinds of punctual light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PunctualKind {
    /// Shines everywhere.
    Point,
    /// Cone, half angles in radians.
    Spot {
        /// Full intensity inside.
        inner_cone_radians: f32,
        /// Nothing outside.
        outer_cone_radians: f32,
    },
    /// Parallel light.
    Directional,
}

/// A probe that an artist placed: `extras.gdibl_probe = "file.exr"` on a node.
#[derive(Debug, Clone, PartialEq)]
pub struct ProbeMarker {
    /// The node's name.
    pub name: String,
    /// The image, resolved against the level's folder.
    pub image: PathBuf,
    /// World position of the node.
    pub position: DVec3,
    /// World rotation of the node, probe to world.
    pub rotation: DQuat,
}

/// A volume that an artist placed: `extras.gdibl_volume = spacing` on a node; the unit cube (±1, as a Blender
/// empty is drawn) under the node's transform is its box.
#[derive(Debug, Clone, PartialEq)]
pub struct VolumeMarker {
    /// The node's name.
    pub name: String,
    /// Node spacing, metres.
    pub spacing: f64,
    /// World position of the node.
    pub center: DVec3,
    /// Columns: half axes of the box in the world.
    pub half_axes: DMat3,
}
