//! Materials as far as diffuse light needs them, and which of their textures a bake needs.
//!
//! Read in two steps. [`read`] takes factors and *lookups* (which texture, which coordinates) from the JSON; then the
//! geometry is read, which says what is used by which role; then [`finish`] decodes what is needed and no more.

use glam::{Mat3, Vec2, Vec3, Vec4};
use gltf::json;
use gltf::json::material::AlphaMode;
use gltf::json::texture::Info;
use gltf::json::validation::Checked;
use serde::Deserialize;
use serde_json::{Map, Value};

use super::buffers::Buffers;
use super::document::Document;
use super::findings::Findings;
use super::primitive::Wanted;
use super::texture::{Decoder, Request};
use crate::Result;
use crate::scene::{Alpha, Material, Role, Texture, TextureUse};

/// A material before its textures are decoded.
#[derive(Debug, Clone, Default)]
pub(super) struct Draft {
    /// Factors; no textures yet.
    material: Material,
    base_color: Option<Lookup>,
    emission: Option<Lookup>,
    /// glTF texture index of the metallic-roughness texture.
    metallic: Option<usize>,
    /// Transmission made an opaque material clear: its texture's alpha still means nothing.
    ignore_texture_alpha: bool,
}

/// Which texture, by which coordinates.
#[derive(Debug, Clone, Copy)]
struct Lookup {
    /// glTF texture index, unchecked.
    texture: usize,
    /// glTF texture coordinate set.
    set: u32,
    transform: Mat3,
}

/// Which roles use a material.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct UsedBy {
    pub environment: bool,
    pub scene: bool,
}

/// [`TextureNeeds`](super::TextureNeeds) of the level at hand.
#[derive(Debug, Clone, Copy)]
pub struct Textures {
    /// Everything that sends light.
    pub all: bool,
    /// Emission of the environment too.
    pub emission: bool,
    /// The level has scene geometry: its shadows need the environment's base colours.
    pub objects: bool,
}

/// What of a material a bake needs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Needs {
    alpha: bool,
    base_color: bool,
    emission: bool,
}

impl Draft {
    fn needs(&self, role: Role, textures: Textures) -> Needs {
        let colour = role == Role::Scene || textures.all;
        Needs {
            alpha: self.material.alpha != Alpha::Opaque,
            base_color: (colour || textures.objects) && !self.material.unlit,
            emission: (colour || textures.emission) && self.material.emission != Vec3::ZERO,
        }
    }

    /// Paths that are traced by the environment need more of the material than is read.
    pub fn leaves_out(&self, textures: Textures) -> bool {
        let needs = |textures| self.needs(Role::Environment, textures);
        needs(textures) != needs(Textures { all: true, ..textures })
    }

    /// Which attributes to read for a primitive of this material. Base colour looks up in the first set of `Mesh::uvs`,
    /// emission too if it names the same glTF set.
    pub fn wanted(&self, role: Role, textures: Textures) -> Wanted {
        let needs = self.needs(role, textures);
        let mut uv_sets = [None; 2];
        if let Some(lookup) = self.base_color.filter(|_| needs.alpha || needs.base_color) {
            uv_sets[0] = Some(lookup.set);
        }
        if let Some(lookup) = self.emission.filter(|_| needs.emission) {
            uv_sets[self.emission_slot()] = Some(lookup.set);
        }
        let colors = needs.alpha || needs.base_color || (needs.emission && self.material.unlit);
        Wanted { uv_sets, colors }
    }

    /// Which of `Mesh::uvs` the emission texture looks up in.
    fn emission_slot(&self) -> usize {
        match (self.base_color, self.emission) {
            (Some(base), Some(emission)) if base.set != emission.set => 1,
            _ => 0,
        }
    }
}

/// Reads all materials; index 0 is glTF's default material.
pub(super) fn read(document: &Document, findings: &mut Findings) -> Result<Vec<Draft>> {
    let mut drafts = vec![Draft::default()];
    for (index, material) in document.materials.iter().enumerate() {
        drafts.push(read_one(document, index, material, findings)?);
    }
    Ok(drafts)
}

fn read_one(document: &Document, index: usize, json: &json::Material, findings: &mut Findings) -> Result<Draft> {
    let place = match &json.name {
        Some(name) => format!("material {index} ({name})"),
        None => format!("material {index}"),
    };
    let extensions = json.extensions.as_ref();
    let other = |name: &str| extensions.and_then(|extensions| extensions.others.get(name));
    let mut clamp = |value: f32, low: f32, high: f32| -> Result<f32> {
        if value.is_nan() {
            return Err(document.invalid(format!("{place}: a factor is not a number")));
        }
        let clamped = value.clamp(low, high);
        findings.add("clamped-material-factors", u64::from(clamped != value), || {
            format!("Factors outside their range were clamped, first {value} to {clamped} in {place}")
        });
        Ok(clamped)
    };

    // Base colour and metallic.
    let pbr = &json.pbr_metallic_roughness;
    let mut factor = pbr.base_color_factor.0;
    let mut base_color = pbr.base_color_texture.as_ref().map(lookup);
    let mut metallic = clamp(pbr.metallic_factor.0, 0.0, 1.0)?;
    let mut metallic_texture = pbr.metallic_roughness_texture.as_ref().map(|info| info.index.value());
    if let Some(value) = other("KHR_materials_pbrSpecularGlossiness") {
        // Its diffuse colour is a dielectric's base colour.
        let old = SpecularGlossiness::deserialize(value)
            .map_err(|e| document.invalid(format!("{place}: KHR_materials_pbrSpecularGlossiness: {e}")))?;
        factor = old.diffuse_factor;
        base_color = old.diffuse_texture.as_ref().map(lookup);
        (metallic, metallic_texture) = (0.0, None);
    }
    for component in &mut factor {
        *component = clamp(*component, 0.0, 1.0)?;
    }

    // Alpha.
    let cutoff = json.alpha_cutoff.map_or(0.5, |cutoff| cutoff.0);
    let mut alpha = match json.alpha_mode {
        Checked::Valid(AlphaMode::Opaque) => Alpha::Opaque,
        Checked::Valid(AlphaMode::Mask) => Alpha::Mask(cutoff),
        Checked::Valid(AlphaMode::Blend) => Alpha::Blend,
        Checked::Invalid => {
            return Err(document.invalid(format!("{place}: unknown alphaMode; expected OPAQUE, MASK or BLEND")));
        }
    };
    let mut ignore_texture_alpha = false;
    if alpha == Alpha::Opaque {
        // Its own alpha means nothing.
        factor[3] = 1.0;
    }
    if let Some(transmission) = other("KHR_materials_transmission").and_then(|e| number(e, "transmissionFactor")) {
        // Glass lets light through: the part that alpha would.
        let transmission = clamp(transmission, 0.0, 1.0)?;
        if transmission > 0.0 {
            ignore_texture_alpha = alpha == Alpha::Opaque;
            factor[3] *= 1.0 - transmission;
            alpha = Alpha::Blend;
        }
    }

    // Emission; an unlit material shows its base colour as it is.
    let unlit = extensions.is_some_and(|extensions| extensions.unlit.is_some());
    let strength = extensions.and_then(|e| e.emissive_strength.as_ref()).map_or(1.0, |e| e.emissive_strength.0);
    let strength = clamp(strength, 0.0, f32::INFINITY)?;
    let mut emission = Vec3::ZERO;
    for (out, component) in emission.as_mut().iter_mut().zip(json.emissive_factor.0) {
        *out = clamp(component, 0.0, f32::INFINITY)? * strength;
    }
    let mut emission_texture = json.emissive_texture.as_ref().map(lookup);
    if unlit {
        emission = Vec3::new(factor[0], factor[1], factor[2]);
        emission_texture = base_color;
    }
    if !emission.is_finite() {
        return Err(document.invalid(format!("{place}: it emits {emission}; expected finite radiance")));
    }

    let material = Material {
        name: json.name.clone().unwrap_or_default(),
        base_color: Vec4::from(factor),
        metallic,
        // No finding where it is out of range: bakes, which store findings, do not use it.
        roughness: pbr.roughness_factor.0.clamp(0.0, 1.0),
        emission,
        alpha,
        double_sided: json.double_sided,
        unlit,
        ..Material::default()
    };
    Ok(Draft { material, base_color, emission: emission_texture, metallic: metallic_texture, ignore_texture_alpha })
}

/// The part of KHR_materials_pbrSpecularGlossiness that is diffuse.
#[derive(Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct SpecularGlossiness {
    diffuse_factor: [f32; 4],
    diffuse_texture: Option<Info>,
}

impl Default for SpecularGlossiness {
    fn default() -> Self {
        SpecularGlossiness { diffuse_factor: [1.0; 4], diffuse_texture: None }
    }
}

fn number(object: &Value, name: &str) -> Option<f32> {
    object.get(name)?.as_f64().map(|value| value as f32)
}

/// Texture, coordinate set and KHR_texture_transform of a texture reference.
fn lookup(info: &Info) -> Lookup {
    let transform = info.extensions.as_ref().and_then(|extensions| extensions.texture_transform.as_ref());
    let (set, transform) = match transform {
        None => (info.tex_coord, Mat3::IDENTITY),
        Some(t) => (
            t.tex_coord.unwrap_or(info.tex_coord),
            // offset · rotation · scale. Positive angles turn counter-clockwise to the eye; v grows downwards, hence -.
            Mat3::from_scale_angle_translation(Vec2::from(t.scale.0), -t.rotation.0, Vec2::from(t.offset.0)),
        ),
    };
    Lookup { texture: info.index.value(), set, transform }
}

/// Decodes the textures that used materials need, and puts them in. `used[i]` is about `drafts[i]`.
pub(super) fn finish(
    buffers: &Buffers,
    drafts: Vec<Draft>,
    used: &[UsedBy],
    textures: Textures,
) -> Result<(Vec<Material>, Vec<Texture>)> {
    // What to decode: a material used by both roles needs what either needs.
    let mut decoder = Decoder::default();
    let mut requests = Vec::new();
    for (draft, used) in drafts.iter().zip(used) {
        let mut needs = Needs::default();
        for (role, is_used) in [(Role::Environment, used.environment), (Role::Scene, used.scene)] {
            if is_used {
                let more = draft.needs(role, textures);
                needs.alpha |= more.alpha;
                needs.base_color |= more.base_color;
                needs.emission |= more.emission;
            }
        }
        let mut request = |texture: Option<usize>, needs_colour: bool| -> Result<Option<Request>> {
            let Some(texture) = texture else { return Ok(None) };
            decoder.request(buffers, texture, needs_colour, draft.ignore_texture_alpha).map(Some)
        };
        let base = draft.base_color.filter(|_| needs.base_color || (needs.alpha && !draft.ignore_texture_alpha));
        requests.push((
            request(base.map(|lookup| lookup.texture), needs.base_color)?,
            request(draft.emission.filter(|_| needs.emission).map(|lookup| lookup.texture), true)?,
            request(draft.metallic.filter(|_| needs.base_color && draft.material.metallic > 0.0), true)?,
        ));
    }
    let decoded = decoder.decode(buffers)?;

    let mut kept = decoded.keep();
    let materials = drafts
        .into_iter()
        .zip(requests)
        .map(|(draft, (base, emission, metallic))| {
            let emission_slot = draft.emission_slot() as u32;
            let mut material = draft.material;
            let mut put = |request: Option<Request>, lookup: Option<Lookup>, uv_set: u32| {
                let (request, lookup) = (request?, lookup?);
                let texture = kept.texture(request)?;
                Some(TextureUse { texture, uv_set, transform: lookup.transform })
            };
            material.base_color_texture = put(base, draft.base_color, 0);
            material.emission_texture = put(emission, draft.emission, emission_slot);
            if let Some(request) = metallic {
                // One number is enough for light this diffuse: the mean over the texture.
                material.metallic *= kept.mean_blue(request);
            }
            material
        })
        .collect();
    Ok((materials, kept.into_textures()))
}

/// The image that an extension of a texture names, e.g. EXT_texture_webp's.
pub(super) fn extension_source(others: Option<&Map<String, Value>>, name: &str) -> Option<usize> {
    usize::try_from(others?.get(name)?.get("source")?.as_u64()?).ok()
}
