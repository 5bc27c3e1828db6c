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
use serde_json::Value;

use super::buffers::Buffers;
use super::document::Document;
use super::findings::Findings;
use super::primitive::Wanted;
use super::texture::{Channel, Decoder, Kept, Put, Request};
use crate::Result;
use crate::scene::{Alpha, Map, Material, Metals, Role, Texture, TextureUse, UV_SETS};

/// A material before its textures are decoded.
#[derive(Debug, Clone, Default)]
pub(super) struct Draft {
    /// Factors; no textures yet.
    material: Material,
    lookups: [Option<Lookup>; LOOKUPS],
    /// glTF's texture coordinate set for each of `Mesh::uvs`.
    uv_sets: [Option<u32>; UV_SETS],
    /// Of a specular-glossiness material, whose texture it multiplies.
    specular: Vec3,
    /// The texture's alpha means nothing, although something lets light through: the material is opaque.
    ignore_texture_alpha: bool,
}

/// What a texture of a material says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    BaseColor,
    Emission,
    /// Of specular-glossiness materials: specular.
    Metallic,
    Transmission,
    Thickness,
    DiffuseTransmission,
    DiffuseTransmissionColor,
}

const LOOKUPS: usize = 7;

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
    /// What a ray loses at it.
    clear: bool,
    /// What it reflects, and lets through diffusely.
    reflected: bool,
    emission: bool,
}

impl Draft {
    fn needs(&self, role: Role, textures: Textures) -> Needs {
        let colour = role == Role::Scene || textures.all;
        Needs {
            clear: self.material.is_clear(),
            reflected: (colour || textures.objects) && !self.material.unlit,
            emission: (colour || textures.emission) && self.material.emission != Vec3::ZERO,
        }
    }

    /// Paths that are traced by the environment need more of the material than is read.
    pub fn leaves_out(&self, textures: Textures) -> bool {
        let needs = |textures| self.needs(Role::Environment, textures);
        needs(textures) != needs(Textures { all: true, ..textures })
    }

    /// A texture is asked for what is needed.
    fn needs_texture(&self, kind: Kind, needs: Needs) -> bool {
        let Needs { clear, reflected, emission } = needs;
        let material = &self.material;
        let tints = clear && material.transmission > 0.0;
        match kind {
            Kind::BaseColor => reflected || tints || (clear && !self.ignore_texture_alpha),
            Kind::Emission => emission,
            Kind::Metallic => (reflected || tints) && material.metallic > 0.0,
            Kind::Transmission => (reflected || tints) && material.transmission > 0.0,
            Kind::Thickness => {
                let passes = tints || (reflected && material.diffuse_transmission > 0.0);
                passes && material.attenuation != Vec3::ONE
            }
            Kind::DiffuseTransmission | Kind::DiffuseTransmissionColor => {
                reflected && material.diffuse_transmission > 0.0
            }
        }
    }

    /// Which attributes to read for a primitive of this material.
    pub fn wanted(&self, role: Role, textures: Textures) -> Wanted {
        let needs = self.needs(role, textures);
        let is_wanted = |set: u32| {
            let of_set = |kind: &Kind| self.lookup(*kind).is_some_and(|lookup| lookup.set == set);
            KINDS.iter().filter(|kind| of_set(kind)).any(|kind| self.needs_texture(*kind, needs))
        };
        let colors = needs.clear || needs.reflected || (needs.emission && self.material.unlit);
        Wanted { uv_sets: self.uv_sets.map(|set| set.filter(|set| is_wanted(*set))), colors }
    }

    fn lookup(&self, kind: Kind) -> Option<Lookup> {
        self.lookups[kind as usize]
    }

    /// Numbers the sets of coordinates that the lookups name, in their order; an error names one too many.
    fn number_sets(&mut self) -> std::result::Result<(), u32> {
        for lookup in self.lookups.iter().flatten() {
            if self.uv_sets.contains(&Some(lookup.set)) {
                continue;
            }
            let free = self.uv_sets.iter_mut().find(|set| set.is_none()).ok_or(lookup.set)?;
            *free = Some(lookup.set);
        }
        Ok(())
    }
}

/// In the order of their numbers.
const KINDS: [Kind; LOOKUPS] = [
    Kind::BaseColor,
    Kind::Emission,
    Kind::Metallic,
    Kind::Transmission,
    Kind::Thickness,
    Kind::DiffuseTransmission,
    Kind::DiffuseTransmissionColor,
];

/// Reads all materials; index 0 is glTF's default material.
pub(super) fn read(document: &Document, metals: Metals, findings: &mut Findings) -> Result<Vec<Draft>> {
    let default = Material { metals, ..Material::default() };
    let mut drafts = vec![Draft { material: default, ..Draft::default() }];
    for (index, material) in document.materials.iter().enumerate() {
        drafts.push(read_one(document, index, material, metals, findings)?);
    }
    Ok(drafts)
}

fn read_one(
    document: &Document,
    index: usize,
    json: &json::Material,
    metals: Metals,
    findings: &mut Findings,
) -> Result<Draft> {
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

    let extension = |name: &str| other(name).filter(|value| value.is_object());
    let unlit = extensions.is_some_and(|extensions| extensions.unlit.is_some());
    let texture = |object: &Value, name: &str| -> Result<Option<Lookup>> {
        let Some(value) = object.get(name) else { return Ok(None) };
        let info = Info::deserialize(value).map_err(|e| document.invalid(format!("{place}: {name}: {e}")))?;
        Ok(Some(lookup(&info)))
    };
    let mut lookups = [None; LOOKUPS];

    // Base colour and metallic.
    let pbr = &json.pbr_metallic_roughness;
    let mut factor = pbr.base_color_factor.0;
    lookups[Kind::BaseColor as usize] = pbr.base_color_texture.as_ref().map(lookup);
    let mut metallic = clamp(pbr.metallic_factor.0, 0.0, 1.0)?;
    lookups[Kind::Metallic as usize] = pbr.metallic_roughness_texture.as_ref().map(lookup);
    let mut specular = Vec3::ONE;
    let old = extension("KHR_materials_pbrSpecularGlossiness");
    if let Some(value) = old {
        // c_diff = diffuse × (1 - max(specular)): what metallic does to a base colour.
        let old = SpecularGlossiness::deserialize(value)
            .map_err(|e| document.invalid(format!("{place}: KHR_materials_pbrSpecularGlossiness: {e}")))?;
        factor = old.diffuse_factor;
        for (out, component) in specular.as_mut().iter_mut().zip(old.specular_factor) {
            *out = clamp(component, 0.0, 1.0)?;
        }
        metallic = specular.max_element();
        lookups[Kind::BaseColor as usize] = old.diffuse_texture.as_ref().map(lookup);
        lookups[Kind::Metallic as usize] = old.specular_glossiness_texture.as_ref().map(lookup);
    }
    for component in &mut factor {
        *component = clamp(*component, 0.0, 1.0)?;
    }

    // Alpha.
    let cutoff = json.alpha_cutoff.map_or(0.5, |cutoff| cutoff.0);
    let alpha = match json.alpha_mode {
        Checked::Valid(AlphaMode::Opaque) => Alpha::Opaque,
        Checked::Valid(AlphaMode::Mask) => Alpha::Mask(cutoff),
        Checked::Valid(AlphaMode::Blend) => Alpha::Blend,
        Checked::Invalid => {
            return Err(document.invalid(format!("{place}: unknown alphaMode; expected OPAQUE, MASK or BLEND")));
        }
    };
    if alpha == Alpha::Opaque {
        // Its own alpha means nothing.
        factor[3] = 1.0;
    }

    // Light that goes through. An unlit material has no such extension.
    let (mut transmission, mut diffuse_transmission) = (0.0, 0.0);
    let (mut attenuation, mut through) = (Vec3::ONE, Vec3::ONE);
    if let Some(value) = extension("KHR_materials_transmission").filter(|_| !unlit) {
        transmission = clamp(number(value, "transmissionFactor").unwrap_or(0.0), 0.0, 1.0)?;
        lookups[Kind::Transmission as usize] = texture(value, "transmissionTexture")?;
    }
    if let Some(value) = extension("KHR_materials_diffuse_transmission").filter(|_| !unlit) {
        diffuse_transmission = clamp(number(value, "diffuseTransmissionFactor").unwrap_or(0.0), 0.0, 1.0)?;
        for (out, component) in
            through.as_mut().iter_mut().zip(vec3(value, "diffuseTransmissionColorFactor").to_array())
        {
            *out = clamp(component, 0.0, 1.0)?;
        }
        lookups[Kind::DiffuseTransmission as usize] = texture(value, "diffuseTransmissionTexture")?;
        lookups[Kind::DiffuseTransmissionColor as usize] = texture(value, "diffuseTransmissionColorTexture")?;
    }
    let is_transmissive = transmission > 0.0 || diffuse_transmission > 0.0;
    if let Some(volume) = extension("KHR_materials_volume").filter(|_| is_transmissive) {
        // Over a distance x the share color^(x / distance) is left.
        let thickness = clamp(number(volume, "thicknessFactor").unwrap_or(0.0), 0.0, f32::INFINITY)?;
        let distance = number(volume, "attenuationDistance").unwrap_or(f32::INFINITY);
        if distance.is_nan() || distance <= 0.0 {
            return Err(document.invalid(format!(
                "{place}: KHR_materials_volume: attenuationDistance is {distance}; expected metres over 0"
            )));
        }
        let color = vec3(volume, "attenuationColor");
        for (out, component) in attenuation.as_mut().iter_mut().zip(color.to_array()) {
            let component = clamp(component, 0.0, 1.0)?;
            // 0^0 is 1: no thickness, no loss.
            *out = component.powf((thickness / distance).min(f32::MAX));
        }
        lookups[Kind::Thickness as usize] = texture(volume, "thicknessTexture")?;
    }

    // Emission; an unlit material shows its base colour as it is.
    let strength = extensions.and_then(|e| e.emissive_strength.as_ref()).map_or(1.0, |e| e.emissive_strength.0);
    let strength = clamp(strength, 0.0, f32::INFINITY)?;
    let mut emission = Vec3::ZERO;
    for (out, component) in emission.as_mut().iter_mut().zip(json.emissive_factor.0) {
        *out = clamp(component, 0.0, f32::INFINITY)? * strength;
    }
    lookups[Kind::Emission as usize] = json.emissive_texture.as_ref().map(lookup);
    if unlit {
        emission = Vec3::new(factor[0], factor[1], factor[2]);
        lookups[Kind::Emission as usize] = lookups[Kind::BaseColor as usize];
    }
    if !emission.is_finite() {
        return Err(document.invalid(format!("{place}: it emits {emission}; expected finite radiance")));
    }

    let material = Material {
        name: json.name.clone().unwrap_or_default(),
        base_color: Vec4::from(factor),
        metallic,
        // Specular-glossiness says how much is diffuse, and of what is not nothing is.
        metals: if old.is_some() { Metals::Black } else { metals },
        specular_glossiness: old.is_some(),
        // No finding where it is out of range: most bakes do not use it.
        roughness: pbr.roughness_factor.0.clamp(0.0, 1.0),
        transmission,
        attenuation,
        diffuse_transmission,
        diffuse_transmission_color: through,
        emission,
        alpha,
        double_sided: json.double_sided,
        unlit,
        ..Material::default()
    };
    let ignore_texture_alpha = alpha == Alpha::Opaque;
    let mut draft = Draft { material, lookups, specular, ignore_texture_alpha, ..Draft::default() };
    draft.number_sets().map_err(|set| {
        document.unsupported(format!(
            "{place}: its textures use TEXCOORD_{set} and {UV_SETS} other sets; at most {UV_SETS} are read. Let some textures \
             share a set"
        ))
    })?;
    Ok(draft)
}

/// KHR_materials_pbrSpecularGlossiness without its gloss.
#[derive(Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct SpecularGlossiness {
    diffuse_factor: [f32; 4],
    diffuse_texture: Option<Info>,
    specular_factor: [f32; 3],
    specular_glossiness_texture: Option<Info>,
}

impl Default for SpecularGlossiness {
    fn default() -> Self {
        SpecularGlossiness {
            diffuse_factor: [1.0; 4],
            diffuse_texture: None,
            specular_factor: [1.0; 3],
            specular_glossiness_texture: None,
        }
    }
}

fn number(object: &Value, name: &str) -> Option<f32> {
    object.get(name)?.as_f64().map(|value| value as f32)
}

/// Three numbers; white without them.
fn vec3(object: &Value, name: &str) -> Vec3 {
    let number = |at: usize| object.get(name).and_then(|list| list.get(at)?.as_f64()).map_or(1.0, |value| value as f32);
    Vec3::new(number(0), number(1), number(2))
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
    allow_missing: bool,
    findings: &mut Findings,
) -> Result<(Vec<Material>, Vec<Texture>, Vec<Map>)> {
    // What to decode: a material used by both roles needs what either needs.
    let mut decoder = Decoder::new(allow_missing);
    let mut requests = Vec::new();
    for (draft, used) in drafts.iter().zip(used) {
        let mut needs = Needs::default();
        for (role, is_used) in [(Role::Environment, used.environment), (Role::Scene, used.scene)] {
            if is_used {
                let more = draft.needs(role, textures);
                needs.clear |= more.clear;
                needs.reflected |= more.reflected;
                needs.emission |= more.emission;
            }
        }
        let mut wanted = [None; LOOKUPS];
        for kind in KINDS {
            let Some(lookup) = draft.lookup(kind).filter(|_| draft.needs_texture(kind, needs)) else { continue };
            let put = match kind {
                Kind::BaseColor => Put::Texture {
                    ignore_alpha: draft.ignore_texture_alpha && draft.material.is_clear(),
                    alpha_only: !needs.reflected && draft.material.transmission == 0.0,
                },
                Kind::Emission | Kind::DiffuseTransmissionColor => Put::Texture {
                    ignore_alpha: draft.ignore_texture_alpha && draft.material.is_clear(),
                    alpha_only: false,
                },
                _ => Put::Map,
            };
            wanted[kind as usize] = Some(decoder.request(buffers, lookup.texture, put)?);
        }
        requests.push(wanted);
    }
    let mut kept = decoder.decode(buffers, findings)?.keep();
    let materials = drafts.into_iter().zip(requests).map(|(draft, requests)| with_textures(draft, requests, &mut kept));
    let materials = materials.collect();
    let (textures, maps) = kept.into_parts();
    Ok((materials, textures, maps))
}

/// The material of a draft, with what was decoded for it.
fn with_textures(draft: Draft, requests: [Option<Request>; LOOKUPS], kept: &mut Kept) -> Material {
    let mut material = draft.material.clone();
    let place_of = |kind: Kind| {
        let lookup = draft.lookup(kind)?;
        let uv_set = draft.uv_sets.iter().position(|set| *set == Some(lookup.set))? as u32;
        Some(TextureUse { texture: 0, uv_set, transform: lookup.transform })
    };
    let mut texture = |kind: Kind| {
        let texture = kept.texture(requests[kind as usize]?)?;
        Some(TextureUse { texture, ..place_of(kind)? })
    };
    material.base_color_texture = texture(Kind::BaseColor);
    material.emission_texture = texture(Kind::Emission);
    material.diffuse_transmission_color_texture = texture(Kind::DiffuseTransmissionColor);

    // A map that has one value all over becomes part of the factor.
    let mut map = |kind: Kind, channel: Channel, factor: f32| -> (f32, Option<TextureUse>) {
        let Some(request) = requests[kind as usize] else { return (factor, None) };
        let (value, map) = kept.map(request, channel);
        (factor * value, map.zip(place_of(kind)).map(|(texture, place)| TextureUse { texture, ..place }))
    };
    let channel = match material.specular_glossiness {
        true => Channel::LargestSrgb(draft.specular),
        false => Channel::Blue,
    };
    material.metallic_unknown = draft.lookup(Kind::Metallic).is_some()
        && requests[Kind::Metallic as usize].is_none()
        && material.metallic > 0.0;
    (material.metallic, material.metallic_map) = match channel {
        // The factor is in it.
        Channel::LargestSrgb(_) if requests[Kind::Metallic as usize].is_some() => map(Kind::Metallic, channel, 1.0),
        _ => map(Kind::Metallic, channel, material.metallic),
    };
    if material.metallic > 0.0 && material.metals == Metals::Diffuse {
        (material.roughness, material.roughness_map) = map(Kind::Metallic, Channel::Green, material.roughness);
    }
    (material.transmission, material.transmission_map) = map(Kind::Transmission, Channel::Red, material.transmission);
    let thickness;
    (thickness, material.thickness_map) = map(Kind::Thickness, Channel::Green, 1.0);
    if thickness != 1.0 {
        material.attenuation = material.attenuation.powf(thickness);
    }
    (material.diffuse_transmission, material.diffuse_transmission_map) =
        map(Kind::DiffuseTransmission, Channel::Alpha, material.diffuse_transmission);
    material
}
