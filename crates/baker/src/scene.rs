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
    /// One number per texel: metallic, transmission and the like. Decoded only where needed, too.
    pub maps: Vec<Map>,
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
        let (materials, textures, maps) =
            (self.materials.len() as u32, self.textures.len() as u32, self.maps.len() as u32);
        self.meshes.retain(|mesh| mesh.role != Role::Environment);
        self.meshes.extend(proxy.meshes.into_iter().map(|mesh| Mesh {
            role: Role::Environment,
            material: mesh.material + materials,
            ..mesh
        }));
        self.materials.extend(proxy.materials.into_iter().map(|mut material| {
            material.textures_mut().into_iter().flatten().for_each(|texture| texture.texture += textures);
            material.maps_mut().into_iter().flatten().for_each(|map| map.texture += maps);
            material
        }));
        self.textures.extend(proxy.textures);
        self.maps.extend(proxy.maps);
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

/// Sets of texture coordinates that one material may use.
pub const UV_SETS: usize = 4;

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
    pub uvs: [Vec<Vec2>; UV_SETS],
    /// Linear vertex colours (COLOR_0), 0..=1, which multiply the base colour; empty, or one per position. Only kept where
    /// base colour or alpha matter (see [`TextureNeeds`](crate::import::gltf::TextureNeeds)).
    pub colors: Vec<Vec4>,
    /// Indices into `positions`, counter-clockwise seen from the front (already turned round for nodes of
    /// negative scale).
    pub triangles: Vec<[u32; 3]>,
    /// The file's number of each vertex, increasing: empty where triangles use all that the file has.
    pub file_numbers: Vec<u32>,
    /// Vertices that the file has; 0 for a mesh that is from no file.
    pub file_count: u32,
    /// The file's accessors of POSITION and NORMAL (`u32::MAX` without): primitives of one mesh that share them share their
    /// vertices.
    pub file_accessors: [u32; 2],
    /// Which instance of EXT_mesh_gpu_instancing it is; 0 without.
    pub instance: u32,
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
    /// 0..=1; the factor of `metallic_map`. Of a specular-glossiness material: the largest specular component, which
    /// diffuse reflection is short of in the same way.
    pub metallic: f32,
    /// Into [`Scene::maps`], if it had to be decoded.
    pub metallic_map: Option<TextureUse>,
    /// The file has a metallic texture, and it was not decoded: `metallic` is its factor alone.
    pub metallic_unknown: bool,
    /// 0..=1, 0 is polished; the factor of `roughness_map`. Pictures ask for the factor alone ([`Material::is_mirror`]),
    /// bakes for both, where metals reflect.
    pub roughness: f32,
    /// Into [`Scene::maps`], if it had to be decoded.
    pub roughness_map: Option<TextureUse>,
    /// What metals reflect.
    pub metals: Metals,
    /// KHR_materials_pbrSpecularGlossiness.
    pub specular_glossiness: bool,
    /// KHR_materials_transmission: share of what is neither metal nor hole that light passes straight on, tinted by base
    /// colour, 0..=1; the factor of `transmission_map`.
    pub transmission: f32,
    /// Into [`Scene::maps`], if it had to be decoded.
    pub transmission_map: Option<TextureUse>,
    /// KHR_materials_volume: share of light that passes the whole thickness, by colour, 0..=1.
    pub attenuation: Vec3,
    /// Into [`Scene::maps`]: the exponent of `attenuation`.
    pub thickness_map: Option<TextureUse>,
    /// KHR_materials_diffuse_transmission: share of diffuse light that goes through, 0..=1; the factor of its map.
    pub diffuse_transmission: f32,
    /// Into [`Scene::maps`], if it had to be decoded.
    pub diffuse_transmission_map: Option<TextureUse>,
    /// What goes through is multiplied by this, linear.
    pub diffuse_transmission_color: Vec3,
    /// Texture (sRGB) of it, if it had to be decoded.
    pub diffuse_transmission_color_texture: Option<TextureUse>,
    /// Linear emitted radiance: factor × KHR_materials_emissive_strength; for unlit materials the base colour, which
    /// vertex colours multiply.
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
    /// glTF's default material: white, metallic and roughness 1 as glTF defines it, opaque, single-sided, no emission; its
    /// metal is black.
    fn default() -> Self {
        Material {
            name: String::new(),
            base_color: Vec4::ONE,
            base_color_texture: None,
            metallic: 1.0,
            metallic_map: None,
            metallic_unknown: false,
            roughness: 1.0,
            roughness_map: None,
            metals: Metals::Black,
            specular_glossiness: false,
            transmission: 0.0,
            transmission_map: None,
            attenuation: Vec3::ONE,
            thickness_map: None,
            diffuse_transmission: 0.0,
            diffuse_transmission_map: None,
            diffuse_transmission_color: Vec3::ONE,
            diffuse_transmission_color_texture: None,
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
        !self.unlit && !self.specular_glossiness && self.metallic >= 0.5 && self.roughness <= 0.1
    }

    /// Some light may pass straight on: it has holes, or is partly clear.
    pub fn is_clear(&self) -> bool {
        self.alpha != Alpha::Opaque || self.transmission > 0.0
    }

    /// Some light may reach the other side, straight or diffusely.
    pub fn lets_light_through(&self) -> bool {
        self.is_clear() || self.diffuse_transmission > 0.0
    }

    /// Light goes through what is no hole.
    pub fn is_transmissive(&self) -> bool {
        self.transmission > 0.0 || self.diffuse_transmission > 0.0
    }

    /// The textures it looks up.
    pub fn textures(&self) -> [Option<TextureUse>; 3] {
        [self.base_color_texture, self.emission_texture, self.diffuse_transmission_color_texture]
    }

    /// The maps it looks up.
    pub fn maps(&self) -> [Option<TextureUse>; 5] {
        [
            self.metallic_map,
            self.roughness_map,
            self.transmission_map,
            self.thickness_map,
            self.diffuse_transmission_map,
        ]
    }

    fn textures_mut(&mut self) -> [&mut Option<TextureUse>; 3] {
        [&mut self.base_color_texture, &mut self.emission_texture, &mut self.diffuse_transmission_color_texture]
    }

    fn maps_mut(&mut self) -> [&mut Option<TextureUse>; 5] {
        [
            &mut self.metallic_map,
            &mut self.roughness_map,
            &mut self.transmission_map,
            &mut self.thickness_map,
            &mut self.diffuse_transmission_map,
        ]
    }
}

/// What metals reflect: a bake has no specular lobes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Metals {
    /// Diffusely, the energy that glTF's metal of that roughness reflects of white light from all sides:
    /// [`rough_metal_share`] of base colour. Unity's lightmapper takes half of the specular colour × roughness, Unreal's 0.45
    /// of it.
    #[default]
    Diffuse,
    /// Nothing.
    Black,
}

/// Share of even light that glTF's metal of white base colour reflects, by roughness 0..=1: 1 - 0.59 for the roughest, whose
/// facets hide each other.
///
/// ∫∫ D(h) V(l, v) (n·l) dl 2 (n·v) d(n·v) with the GGX of glTF 2.0, appendix B.3.2, alpha = roughness². The polynomial is
/// within 0.004 of the integral; a test computes it.
pub fn rough_metal_share(roughness: f32) -> f32 {
    let r = roughness.clamp(0.0, 1.0);
    1.0 - r * r * r * (METAL_LOSS[0] + r * (METAL_LOSS[1] + r * METAL_LOSS[2]))
}

/// Fitted by least squares at 20 roughnesses.
const METAL_LOSS: [f32; 3] = [0.946, 0.355, -0.714];

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

/// A texture or a map, and how a material looks it up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TextureUse {
    /// Index into [`Scene::textures`], or, of a map, into [`Scene::maps`].
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
    /// How it is looked up.
    pub sampler: TextureSampler,
}

/// One number per texel, row 0 at v = 0.
#[derive(Debug, Clone, PartialEq)]
pub struct Map {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// 0 for 0 to 255 for 1, row by row.
    pub values: Vec<u8>,
    /// How it is looked up.
    pub sampler: TextureSampler,
}

/// How texels are looked up, as in glTF samplers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TextureSampler {
    /// Wrapping of u and v.
    pub wrap: [Wrap; 2],
    /// The pixel around the place alone, instead of the four that it lies between.
    pub nearest: bool,
}

impl TextureUse {
    /// Where in the texture the mesh's coordinate `uv` is.
    pub fn transform(&self, uv: Vec2) -> Vec2 {
        self.transform.transform_point2(uv)
    }
}

impl Texture {
    /// Linear colour and alpha at `uv`: bilinear between pixel centres, or the nearest pixel, wrapped. A texture without
    /// pixels is white.
    pub fn sample(&self, uv: Vec2) -> Vec4 {
        if self.rgba8.is_empty() {
            return Vec4::ONE;
        }
        self.sampler.sample(uv, self.width, self.height, |x, y| self.pixel(x, y), Vec4::lerp)
    }

    /// The pixel in column `x` of row `y`, linear.
    fn pixel(&self, x: u32, y: u32) -> Vec4 {
        let [r, g, b, a] = self.rgba8[y as usize * self.width as usize + x as usize];
        let linear = |byte: u8| SRGB_TO_LINEAR[byte as usize];
        Vec4::new(linear(r), linear(g), linear(b), f32::from(a) / 255.0)
    }
}

impl Map {
    /// The number at `uv`, 0..=1, looked up as in a texture. A map without pixels is 1.
    pub fn sample(&self, uv: Vec2) -> f32 {
        if self.values.is_empty() {
            return 1.0;
        }
        let pixel = |x: u32, y: u32| f32::from(self.values[y as usize * self.width as usize + x as usize]) / 255.0;
        self.sampler.sample(uv, self.width, self.height, pixel, |a, b, share| a + (b - a) * share)
    }

    /// The mean of all pixels; 1 without any.
    pub fn mean(&self) -> f64 {
        let sum: u64 = self.values.iter().map(|value| u64::from(*value)).sum();
        if self.values.is_empty() { 1.0 } else { sum as f64 / (255.0 * self.values.len() as f64) }
    }
}

/// The number that stands for an sRGB-encoded byte, 0..=1.
pub fn linear_of_srgb(byte: u8) -> f32 {
    SRGB_TO_LINEAR[byte as usize]
}

impl TextureSampler {
    /// The value at `uv` of an image of at least one pixel.
    fn sample<T: Copy>(
        &self,
        uv: Vec2,
        width: u32,
        height: u32,
        pixel: impl Fn(u32, u32) -> T,
        lerp: impl Fn(T, T, f32) -> T,
    ) -> T {
        if self.nearest {
            let column = nearest_tap(uv.x, width, self.wrap[0]);
            return pixel(column, nearest_tap(uv.y, height, self.wrap[1]));
        }
        // The two columns, the two rows, and how far it is to the second.
        let ([x0, x1], fx) = taps(uv.x, width, self.wrap[0]);
        let ([y0, y1], fy) = taps(uv.y, height, self.wrap[1]);
        let top = lerp(pixel(x0, y0), pixel(x1, y0), fx);
        let bottom = lerp(pixel(x0, y1), pixel(x1, y1), fx);
        lerp(top, bottom, fy)
    }
}

/// `u` wrapped into 0..=1, in f64: a coordinate may be in the thousands. One that is not finite reads the first pixel.
fn wrapped(u: f32, wrap: Wrap) -> f64 {
    let u = if u.is_finite() { f64::from(u) } else { 0.0 };
    match wrap {
        Wrap::Repeat => u.rem_euclid(1.0),
        Wrap::MirroredRepeat => 1.0 - (u.rem_euclid(2.0) - 1.0).abs(),
        Wrap::ClampToEdge => u.clamp(0.0, 1.0),
    }
}

/// The pixel that `u` lies in.
fn nearest_tap(u: f32, size: u32, wrap: Wrap) -> u32 {
    ((wrapped(u, wrap) * f64::from(size)) as u32).min(size - 1)
}

/// The two pixels whose centres lie around `u`, and the share of the second, 0..1.
fn taps(u: f32, size: u32, wrap: Wrap) -> ([u32; 2], f32) {
    let x = wrapped(u, wrap) * f64::from(size) - 0.5;
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Wrap {
    /// Tile.
    #[default]
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
    /// The node as messages call it, by its index and name.
    pub node: String,
    /// Node spacing, metres.
    pub spacing: f64,
    /// World position of the node.
    pub center: DVec3,
    /// Columns: half axes of the box in the world.
    pub half_axes: DMat3,
    /// Its other `gdibl_*` properties, settings of its own: names without `gdibl_`, and values as the text of a flag.
    pub settings: Vec<(String, String)>,
}

impl VolumeMarker {
    /// The world box around the marker's box.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let axes = [self.half_axes.x_axis, self.half_axes.y_axis, self.half_axes.z_axis];
        let reach = axes.iter().fold(DVec3::ZERO, |sum, axis| sum + axis.abs());
        (self.center - reach, self.center + reach)
    }

    /// The box's edges lie along the world's axes, so that [`bounds`](Self::bounds) is the box itself. Rounding of a quarter
    /// turn does not count.
    pub fn is_upright(&self) -> bool {
        let axes = [self.half_axes.x_axis, self.half_axes.y_axis, self.half_axes.z_axis];
        axes.iter().all(|axis| axis.abs().max_element() >= (1.0 - 1e-9) * axis.length())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wrapping(wrap: Wrap) -> TextureSampler {
        TextureSampler { wrap: [wrap; 2], nearest: false }
    }

    #[test]
    fn nearest_samplers_read_the_pixel_around_the_place() {
        for wrap in [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge] {
            let mut texture = black_white(wrap);
            texture.sampler.nearest = true;
            for (u, white) in [(0.0, 0.0), (0.499, 0.0), (0.501, 1.0), (0.999, 1.0)] {
                assert_eq!(texture.sample(Vec2::new(u, 0.5)).x, white, "{wrap:?} {u}");
            }
            // Outside: as wrapping says.
            let after = if wrap == Wrap::Repeat { 0.0 } else { 1.0 };
            assert_eq!(texture.sample(Vec2::new(1.1, 0.5)).x, after, "{wrap:?}");
            assert!(texture.sample(Vec2::new(f32::NAN, -1e-9)).is_finite());
            let map = Map { width: 2, height: 1, values: vec![0, 255], sampler: texture.sampler };
            assert_eq!([map.sample(Vec2::new(0.49, 0.0)), map.sample(Vec2::new(0.51, 1.0))], [0.0, 1.0]);
        }
    }

    /// By half vectors h drawn with density D (n·h): the mean of 4 V (n·l) (v·h) / (n·h), over n·v by its cosine.
    fn share_by_integration(roughness: f64) -> f64 {
        let alpha = (roughness * roughness).max(1e-4);
        let smith = |cosine: f64| (alpha * alpha + (1.0 - alpha * alpha) * cosine * cosine).sqrt();
        const STEPS: usize = 96;
        let middle = |i: usize| (i as f64 + 0.5) / STEPS as f64;
        let mut sum = 0.0;
        for (i, j, k) in (0..STEPS.pow(3)).map(|n| (n % STEPS, n / STEPS % STEPS, n / STEPS / STEPS)) {
            let (view, u, turn) = (middle(i), middle(j), std::f64::consts::PI * middle(k));
            let squared = (1.0 - u) / (1.0 + (alpha * alpha - 1.0) * u);
            let (height, across) = (squared.sqrt(), (1.0 - squared).sqrt());
            let facing = across * turn.cos() * (1.0 - view * view).sqrt() + height * view;
            let light = 2.0 * facing * height - view;
            if facing > 0.0 && light > 0.0 {
                let visibility = 0.5 / (light * smith(view) + view * smith(light));
                sum += 2.0 * view * 4.0 * visibility * light * facing / height;
            }
        }
        sum / STEPS.pow(3) as f64
    }

    #[test]
    fn metals_reflect_the_energy_of_gltfs_rough_metal() {
        for roughness in [0.0, 0.2, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0] {
            let (fitted, integral) = (rough_metal_share(roughness as f32), share_by_integration(roughness));
            assert!((f64::from(fitted) - integral).abs() < 0.006, "{roughness}: {fitted} for {integral}");
        }
        assert_eq!((rough_metal_share(-1.0), rough_metal_share(0.0)), (1.0, 1.0));
        assert_eq!(rough_metal_share(2.0), rough_metal_share(1.0));
    }

    /// Black and white, side by side.
    fn black_white(wrap: Wrap) -> Texture {
        Texture { width: 2, height: 1, rgba8: vec![[0, 0, 0, 0], [255; 4]], sampler: wrapping(wrap) }
    }

    #[test]
    fn sample_reproduces_pixels_at_their_centres() {
        let rgba8: Vec<[u8; 4]> = (0..12).map(|i| [i * 20, 255 - i * 20, i, i * 10]).collect();
        for wrap in [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge] {
            let texture = Texture { width: 4, height: 3, rgba8: rgba8.clone(), sampler: wrapping(wrap) };
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
        let grey = Texture { width: 1, height: 1, rgba8: vec![[188, 128, 10, 128]], sampler: wrapping(Wrap::Repeat) };
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
            Texture { width: 0, height: 0, rgba8: vec![], sampler: wrapping(Wrap::Repeat) }.sample(Vec2::ZERO),
            Vec4::ONE
        );
    }
}
