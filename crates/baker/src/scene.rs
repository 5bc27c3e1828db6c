//! The level as the baker sees it: triangles in world space, materials as far as light needs them, lights, and
//! what artists marked. World = glTF: right-handed, Y up, metres.
//!
//! Positions are f64: a level may stand a thousand kilometres from the origin. Tracing re-centres and rescales
//! them to f32 (see `trace`).

use glam::{DMat3, DQuat, DVec3, Vec2, Vec3, Vec4};
use std::path::PathBuf;
use std::sync::LazyLock;

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
    /// Colours or emission of some environment materials were not read, see
    /// [`TextureNeeds`](crate::import::gltf::TextureNeeds): paths cannot be traced by them.
    pub materials_left_out: bool,
    /// KHR_lights_punctual, placed in the world.
    pub lights: Vec<PunctualLight>,
    /// Nodes with `extras.gdibl_probe`.
    pub probe_markers: Vec<ProbeMarker>,
    /// Nodes with `extras.gdibl_volume`.
    pub volume_markers: Vec<VolumeMarker>,
    /// What was dropped or ignored.
    pub findings: Vec<Finding>,
}

impl Scene {
    /// The box around the triangles of the meshes that `keep` picks, world metres; `None` without triangles.
    pub fn bounds(&self, keep: impl Fn(&Mesh) -> bool) -> Option<(DVec3, DVec3)> {
        let mut bounds: Option<(DVec3, DVec3)> = None;
        for mesh in self.meshes.iter().filter(|m| keep(m)) {
            for &index in mesh.triangles.iter().flatten() {
                let p = mesh.positions[index as usize];
                bounds = Some(bounds.map_or((p, p), |(min, max)| (min.min(p), max.max(p))));
            }
        }
        bounds
    }

    /// Takes all triangles of `proxy` as environment geometry in place of the own ones. Materials and textures of
    /// both stay; the proxy's lights and markers are left out.
    pub fn replace_environment(&mut self, proxy: Scene) {
        self.materials_left_out = proxy.materials_left_out;
        let (materials, textures) = (self.materials.len() as u32, self.textures.len() as u32);
        self.meshes.retain(|mesh| mesh.role != Role::Environment);
        self.meshes.extend(proxy.meshes.into_iter().map(|mesh| Mesh {
            role: Role::Environment,
            material: mesh.material + materials,
            ..mesh
        }));
        let shift = |texture: Option<TextureUse>| texture.map(|t| TextureUse { texture: t.texture + textures, ..t });
        self.materials.extend(proxy.materials.into_iter().map(|material| Material {
            base_color_texture: shift(material.base_color_texture),
            emission_texture: shift(material.emission_texture),
            ..material
        }));
        self.textures.extend(proxy.textures);
    }

    /// Something in the level glows where rays can find it.
    pub fn emits(&self) -> bool {
        let mut scene = self.meshes.iter().filter(|m| m.role == Role::Scene && !m.triangles.is_empty());
        scene.any(|m| self.materials[m.material as usize].emission != Vec3::ZERO)
    }

    /// Triangles of a role.
    pub fn triangle_count(&self, role: Role) -> usize {
        self.meshes.iter().filter(|m| m.role == role).map(|m| m.triangles.len()).sum()
    }
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
    /// The file gives the normals: a picture shades by them. Without, glTF means flat triangles.
    pub smooth: bool,
    /// Texture coordinates for each [`TextureUse::uv_set`] of the material; empty, or one per position. Only kept when
    /// a decoded texture uses them. (Numbered anew: the file's sets may be any.)
    pub uvs: [Vec<Vec2>; 2],
    /// Linear vertex colours (COLOR_0), which multiply the base colour; empty, or one per position. Only kept where base
    /// colour or alpha matter (see [`TextureNeeds`](crate::import::gltf::TextureNeeds)).
    pub colors: Vec<Vec4>,
    /// Indices into `positions`, counter-clockwise seen from the front (already turned round for nodes of
    /// negative scale).
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Area of the triangle of these three positions, square metres.
    pub fn area(&self, triangle: [u32; 3]) -> f64 {
        let [a, b, c] = triangle.map(|i| self.positions[i as usize]);
        0.5 * (b - a).cross(c - a).length()
    }
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
    /// 0..=1; diffuse albedo is base colour × (1 - metallic). Where base colour matters and the file has a
    /// metallic-roughness texture: times that texture's mean.
    pub metallic: f32,
    /// 0..=1, 0 is polished: the factor alone. Pictures ask for it ([`Material::is_mirror`]), bakes do not.
    pub roughness: f32,
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
    /// glTF's default material: white, metallic and roughness 1 as glTF defines it, opaque, single-sided, no emission.
    fn default() -> Self {
        Material {
            name: String::new(),
            base_color: Vec4::ONE,
            base_color_texture: None,
            metallic: 1.0,
            roughness: 1.0,
            emission: Vec3::ZERO,
            emission_texture: None,
            alpha: Alpha::Opaque,
            double_sided: false,
            unlit: false,
        }
    }
}

impl Material {
    /// A polished metal: a picture shows what lies in the mirror direction, times base colour. What is less polished, or
    /// less of a metal, is as dull in a picture as it is in a bake.
    pub fn is_mirror(&self) -> bool {
        !self.unlit && self.metallic >= 0.5 && self.roughness <= 0.1
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

impl TextureUse {
    /// Where in the texture the mesh's coordinate `uv` is.
    pub fn transform(&self, uv: Vec2) -> Vec2 {
        self.transform.transform_point2(uv)
    }
}

impl Texture {
    /// Linear colour and alpha at `uv`: bilinear between pixel centres, wrapped. A texture without pixels is white.
    pub fn sample(&self, uv: Vec2) -> Vec4 {
        if self.rgba8.is_empty() {
            return Vec4::ONE;
        }
        // The two columns, the two rows, and how far it is to the second.
        let ([x0, x1], fx) = taps(uv.x, self.width, self.wrap[0]);
        let ([y0, y1], fy) = taps(uv.y, self.height, self.wrap[1]);
        let top = self.pixel(x0, y0).lerp(self.pixel(x1, y0), fx);
        let bottom = self.pixel(x0, y1).lerp(self.pixel(x1, y1), fx);
        top.lerp(bottom, fy)
    }

    /// The pixel in column `x` of row `y`, linear.
    fn pixel(&self, x: u32, y: u32) -> Vec4 {
        let [r, g, b, a] = self.rgba8[y as usize * self.width as usize + x as usize];
        let linear = |byte: u8| SRGB_TO_LINEAR[byte as usize];
        Vec4::new(linear(r), linear(g), linear(b), f32::from(a) / 255.0)
    }
}

/// The two pixels whose centres lie around `u`, and the share of the second, 0..1.
fn taps(u: f32, size: u32, wrap: Wrap) -> ([u32; 2], f32) {
    // Wrap first, in f64: a coordinate may be in the thousands. One that is not finite reads the first pixel.
    let u = if u.is_finite() { f64::from(u) } else { 0.0 };
    let u = match wrap {
        Wrap::Repeat => u.rem_euclid(1.0),
        Wrap::MirroredRepeat => 1.0 - (u.rem_euclid(2.0) - 1.0).abs(),
        Wrap::ClampToEdge => u.clamp(0.0, 1.0),
    };
    let x = u * f64::from(size) - 0.5;
    let first = x.floor();
    // -1 ..= size: the neighbour across the edge is the far pixel when tiled, else the edge pixel itself.
    let across = |i: i64| match wrap {
        Wrap::Repeat => i.rem_euclid(i64::from(size)) as u32,
        Wrap::MirroredRepeat | Wrap::ClampToEdge => i.clamp(0, i64::from(size) - 1) as u32,
    };
    ([across(first as i64), across(first as i64 + 1)], (x - first) as f32)
}

/// The sRGB transfer function (IEC 61966-2-1) of each byte.
static SRGB_TO_LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|byte| {
        let encoded = byte as f64 / 255.0;
        let linear = if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) };
        linear as f32
    })
});

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

impl VolumeMarker {
    /// The world box around the marker's box.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let axes = [self.half_axes.x_axis, self.half_axes.y_axis, self.half_axes.z_axis];
        let reach = axes.iter().fold(DVec3::ZERO, |sum, axis| sum + axis.abs());
        (self.center - reach, self.center + reach)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Black and white, side by side.
    fn black_white(wrap: Wrap) -> Texture {
        Texture { width: 2, height: 1, rgba8: vec![[0, 0, 0, 0], [255; 4]], wrap: [wrap; 2] }
    }

    #[test]
    fn sample_reproduces_pixels_at_their_centres() {
        let rgba8: Vec<[u8; 4]> = (0..12).map(|i| [i * 20, 255 - i * 20, i, i * 10]).collect();
        for wrap in [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge] {
            let texture = Texture { width: 4, height: 3, rgba8: rgba8.clone(), wrap: [wrap; 2] };
            for (i, pixel) in rgba8.iter().enumerate() {
                let uv = Vec2::new(((i % 4) as f32 + 0.5) / 4.0, ((i / 4) as f32 + 0.5) / 3.0);
                let expected = Vec4::new(
                    SRGB_TO_LINEAR[pixel[0] as usize],
                    SRGB_TO_LINEAR[pixel[1] as usize],
                    SRGB_TO_LINEAR[pixel[2] as usize],
                    f32::from(pixel[3]) / 255.0,
                );
                assert!((texture.sample(uv) - expected).abs().max_element() < 1e-5, "{wrap:?} {i}");
            }
        }
    }

    #[test]
    fn sample_wraps_as_the_sampler_says() {
        let red = |wrap: Wrap, u: f32| black_white(wrap).sample(Vec2::new(u, 0.5)).x;
        // On the seam, tiled: half black, half white. Mirrored and clamped: the edge pixel.
        assert_eq!(red(Wrap::Repeat, 1.0), 0.5);
        assert_eq!(red(Wrap::MirroredRepeat, 1.0), 1.0);
        assert_eq!(red(Wrap::ClampToEdge, 1.0), 1.0);
        // One tile on, and one back.
        assert_eq!(red(Wrap::Repeat, 1.25), 0.0);
        assert_eq!(red(Wrap::Repeat, -0.25), 1.0);
        assert_eq!(red(Wrap::MirroredRepeat, 1.25), 1.0);
        assert_eq!(red(Wrap::MirroredRepeat, -0.25), 0.0);
        assert_eq!(red(Wrap::MirroredRepeat, 2.25), 0.0);
        assert_eq!(red(Wrap::ClampToEdge, 7.0), 1.0);
        assert_eq!(red(Wrap::ClampToEdge, -7.0), 0.0);
    }

    #[test]
    fn sample_interpolates_light_and_not_bytes() {
        // Half way between black and white is half the light; alpha is linear.
        let middle = black_white(Wrap::ClampToEdge).sample(Vec2::new(0.5, 0.5));
        assert!((middle - Vec4::splat(0.5)).abs().max_element() < 1e-6, "{middle}");
        let grey = Texture { width: 1, height: 1, rgba8: vec![[188, 128, 10, 128]], wrap: [Wrap::Repeat; 2] };
        let grey = grey.sample(Vec2::ZERO);
        assert!(
            (grey - Vec4::new(0.502_886, 0.215_861, 0.003_035, 128.0 / 255.0)).abs().max_element() < 1e-5,
            "{grey}"
        );
    }

    #[test]
    fn polished_metals_alone_are_mirrors() {
        let material = |metallic, roughness, unlit| Material { metallic, roughness, unlit, ..Material::default() };
        assert!(material(1.0, 0.0, false).is_mirror() && material(0.5, 0.1, false).is_mirror());
        assert!(!material(0.4, 0.0, false).is_mirror(), "plastic");
        assert!(!material(1.0, 0.2, false).is_mirror(), "brushed");
        assert!(!material(1.0, 0.0, true).is_mirror(), "a picture of a mirror");
        assert!(!Material::default().is_mirror());
    }

    #[test]
    fn sample_has_an_answer_for_every_coordinate() {
        for wrap in [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge] {
            for u in
                [f32::NAN, f32::INFINITY, -f32::INFINITY, f32::MAX, f32::MIN, -f32::MIN_POSITIVE, -1e-9, 0.999_999_94]
            {
                let texel = black_white(wrap).sample(Vec2::new(u, -u));
                assert!(texel.is_finite() && (0.0..=1.0).contains(&texel.x), "{wrap:?} {u}: {texel}");
            }
        }
        assert_eq!(
            Texture { width: 0, height: 0, rgba8: vec![], wrap: [Wrap::Repeat; 2] }.sample(Vec2::ZERO),
            Vec4::ONE
        );
    }
}
