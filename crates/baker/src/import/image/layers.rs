//! Which layer of an EXR file is the picture, and where the distance of its pixels is.
//!
//! A layer is named by its part and by what stands before the last dot of its channels: part `ViewLayer.Combined` with
//! the channel `ViewLayer.Combined.R`, or part `beauty` with the channel `R`. No specification says which layer is the
//! picture, so names decide, as programs write them; the last segment that says something counts:
//!
//! | class | names, among others |
//! |---|---|
//! | picture | R, G, B without a layer; `rgba`, `beauty`, `Combined`, `Composite`, `Ci`, `FinalImage` |
//! | like one | a picture's name and more: `rgba_key`, `beauty_denoised`, `Noisy Image` |
//! | unknown | any other, `Environment`, `left` |
//! | a share of the light | `diffuse`, `Emission`, `direct`: never taken unasked |
//! | no light | normals, occlusion, albedo, position, ids, masks: never taken unasked |
//!
//! Of the best class there is, the best name, then the first in the file. Where another layer could be meant, a finding
//! says which was taken.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use ::exr::math::Vec2;
use ::exr::meta::MetaData;
use ::exr::meta::header::Header;

use super::space;
use crate::{Error, Finding, Result};

/// Layers that a message names.
const MOST_NAMES: usize = 20;

/// Channels of the picture: part and index in its channel list.
pub(super) struct Channels {
    pub part: usize,
    /// R, G and B; the same one three times for luminance.
    pub colour: [usize; 3],
    /// Metres per pixel, in this part or in one beside it.
    pub distance: Option<(usize, usize)>,
    /// There is one channel, luminance.
    pub grey: bool,
}

/// How sure a name makes that a layer is the picture, the surest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Class {
    /// By the place of its name in the list of such names.
    Picture(u8),
    LikePicture,
    Unknown,
    Share,
    NoLight,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Colour,
    Luminance,
    /// Luminance beside chroma at half the resolution.
    LuminanceChroma,
}

/// Channels that can be read as a picture.
struct Candidate {
    part: usize,
    /// Part and layer, without the channel; empty where neither has a name.
    layer: String,
    /// What stands before the channels' own names, with the dot.
    prefix: String,
    colour: [usize; 3],
    kind: Kind,
    class: Class,
}

/// The picture of the file: the layer that is asked for, or the one that is it most likely.
pub(super) fn choose(
    path: &Path,
    metadata: &MetaData,
    asked: Option<&str>,
    findings: &mut Vec<Finding>,
) -> Result<Channels> {
    let headers = &metadata.headers[..];
    let candidates: Vec<Candidate> = (0..headers.len()).flat_map(|part| candidates_of(headers, part)).collect();
    let chosen = match asked {
        Some(name) => named(path, &candidates, name)?,
        None => most_likely(path, headers, &candidates, findings)?,
    };
    let header = &headers[chosen.part];
    if header.deep {
        return Err(Error::unsupported(
            path,
            "this is a deep EXR (many samples per pixel): flatten it before, e.g. in the compositor that wrote it",
        ));
    }
    if chosen.kind == Kind::LuminanceChroma {
        return Err(Error::unsupported(
            path,
            "this is a luminance-chroma EXR (channels Y, RY, BY): save it again with the channels R, G and B",
        ));
    }
    refuse_subsampled(path, header)?;
    let distance = distance_of(headers, chosen, findings);
    if let Some((part, _)) = distance {
        refuse_subsampled(path, &headers[part])?;
    }
    Ok(Channels { part: chosen.part, colour: chosen.colour, distance, grey: chosen.kind == Kind::Luminance })
}

fn refuse_subsampled(path: &Path, header: &Header) -> Result<()> {
    match header.channels.list.iter().find(|c| c.sampling != Vec2(1, 1)) {
        None => Ok(()),
        Some(channel) => Err(Error::unsupported(
            path,
            format!(
                "channel {} stores fewer samples than the image has pixels: save all channels at full resolution",
                channel.name
            ),
        )),
    }
}

/// The layer of that name: in full, in any case, or its last segments.
fn named<'a>(path: &Path, candidates: &'a [Candidate], name: &str) -> Result<&'a Candidate> {
    let wanted = name.to_lowercase();
    let ends = |layer: &str| layer.strip_suffix(&wanted).is_some_and(|rest| rest.is_empty() || rest.ends_with('.'));
    let rules: [&dyn Fn(&str) -> bool; 3] =
        [&|layer| layer == name, &|layer| layer.to_lowercase() == wanted, &|layer| ends(&layer.to_lowercase())];
    for rule in rules {
        let found: Vec<&Candidate> = candidates.iter().filter(|candidate| rule(&candidate.layer)).collect();
        match found[..] {
            [] => {}
            [one] => return Ok(one),
            _ => {
                let names = named_list(found.iter().map(|candidate| candidate.shown()));
                return Err(Error::unsupported(
                    path,
                    format!("the layer {name} is asked for, and several are called so: {names}; give the whole name"),
                ));
            }
        }
    }
    // Where there is but one picture and it has no name, no other can be meant.
    match candidates {
        [one] if one.layer.is_empty() => Ok(one),
        [] => {
            Err(Error::unsupported(path, format!("the layer {name} is asked for; the file has no layer with colour")))
        }
        _ => Err(Error::unsupported(
            path,
            format!("the layer {name} is asked for, and none is called so; the file has {}", list(candidates)),
        )),
    }
}

fn most_likely<'a>(
    path: &Path,
    headers: &[Header],
    candidates: &'a [Candidate],
    findings: &mut Vec<Finding>,
) -> Result<&'a Candidate> {
    // Deep and chroma images are refused, so anything else goes first.
    let refused = |candidate: &Candidate| headers[candidate.part].deep || candidate.kind == Kind::LuminanceChroma;
    let order = |candidate: &&Candidate| (refused(candidate), candidate.class, candidate.kind != Kind::Colour);
    let Some(chosen) = candidates.iter().min_by_key(order) else {
        let channels = headers.iter().flat_map(|header| &header.channels.list);
        let found: Vec<String> = channels.map(|channel| channel.name.to_string()).take(20).collect();
        return Err(Error::unsupported(
            path,
            format!(
                "no channels R, G and B (alone or as layer.R, layer.G, layer.B) and no luminance Y; found {}: save the \
                 panorama with R, G and B",
                if found.is_empty() { "none".into() } else { found.join(", ") }
            ),
        ));
    };
    if chosen.class >= Class::Share {
        return Err(Error::unsupported(
            path,
            format!(
                "none of its layers is the whole light; found {}: save the panorama with R, G and B without a layer, \
                 or take one all the same by its name (--layer NAME)",
                list(candidates)
            ),
        ));
    }
    // The picture without a name is what all programs show; a share of light is not meant by who saves a picture beside
    // it.
    let rival = |other: &&Candidate| {
        let most = if chosen.class == Class::Picture(0) { Class::Unknown } else { Class::Share };
        !std::ptr::eq(*other, chosen)
            && other.class <= most
            && (other.kind == Kind::Colour || chosen.kind != Kind::Colour)
    };
    let rivals: Vec<String> = candidates.iter().filter(rival).map(Candidate::shown).collect();
    if !rivals.is_empty() || chosen.class >= Class::LikePicture {
        let others = match rivals.len() {
            0 => "it is the only one that can be light".into(),
            _ => format!("there are also {}", named_list(rivals.iter().cloned())),
        };
        let message =
            format!("the layer {} was taken as the picture; {others}; --layer NAME takes another", chosen.shown());
        findings.push(Finding::new("exr-layer", rivals.len().max(1) as u64, message));
    }
    Ok(chosen)
}

impl Candidate {
    fn shown(&self) -> String {
        if self.layer.is_empty() { "R, G, B without a name".into() } else { self.layer.clone() }
    }
}

/// All layers with colour, and what they seem to be.
fn list(candidates: &[Candidate]) -> String {
    let describe = |candidate: &Candidate| match candidate.class {
        Class::Share => format!("{} (a share of the light)", candidate.shown()),
        Class::NoLight => format!("{} (no light)", candidate.shown()),
        _ => candidate.shown(),
    };
    named_list(candidates.iter().map(describe))
}

/// The first names, and that there are more.
fn named_list(names: impl Iterator<Item = String>) -> String {
    let mut names: Vec<String> = names.take(MOST_NAMES + 1).collect();
    if names.len() > MOST_NAMES {
        names[MOST_NAMES] = "…".into();
    }
    names.join(", ")
}

/// The layers of a part that have R, G and B, or luminance.
fn candidates_of(headers: &[Header], part: usize) -> Vec<Candidate> {
    let header = &headers[part];
    let names: Vec<String> = header.channels.list.iter().map(|c| c.name.to_string()).collect();
    let places: HashMap<&str, usize> = names.iter().enumerate().map(|(index, name)| (&name[..], index)).collect();
    let lower: HashSet<String> = names.iter().map(|name| name.to_lowercase()).collect();
    // In the order of the file, the one without a name first.
    let mut known = HashSet::from([""]);
    let layers = names.iter().map(|name| name.rfind('.').map_or("", |dot| &name[..=dot]));
    let layers: Vec<&str> = layers.filter(|layer| known.insert(layer)).collect();
    let part_name = header.own_attributes.layer_name.as_ref().map(ToString::to_string).unwrap_or_default();
    let mut candidates = Vec::new();
    for prefix in std::iter::once("").chain(layers) {
        let find = |own: &str| places.get(&format!("{prefix}{own}")[..]).copied();
        let has = |own: &str| lower.contains(&format!("{prefix}{own}").to_lowercase());
        let three = |names: [&str; 3]| {
            let [r, g, b] = names.map(find);
            Some([r?, g?, b?])
        };
        let colour = [["R", "G", "B"], ["r", "g", "b"], ["red", "green", "blue"], ["Red", "Green", "Blue"]];
        // Y beside X is a coordinate.
        let luminance = || find("Y").filter(|_| !has("X")).map(|y| [y; 3]);
        let xyz = || three(["X", "Y", "Z"]).filter(|_| space::is_xyz(header));
        let (colour, kind) = if let Some(colour) = colour.into_iter().find_map(three).or_else(xyz) {
            (colour, Kind::Colour)
        } else if let Some(luminance) = luminance() {
            let chroma = has("RY") || has("BY");
            (luminance, if chroma { Kind::LuminanceChroma } else { Kind::Luminance })
        } else {
            continue;
        };
        let layer = joined(&part_name, prefix.trim_end_matches('.'));
        let mut class = class_of(&layer);
        // A file of one part has no reason to name it after what it shows.
        if class == Class::Unknown && headers.len() == 1 && prefix.is_empty() {
            class = Class::Picture(0);
        }
        if headers.len() > 1 && space::is_data(header) {
            class = Class::NoLight;
        }
        candidates.push(Candidate { part, layer, prefix: prefix.into(), colour, kind, class });
    }
    candidates
}

/// Name of a layer in a part; programs that write one part per layer often say it twice.
fn joined(part: &str, layer: &str) -> String {
    let repeats = layer == part || layer.strip_prefix(part).is_some_and(|rest| rest.starts_with('.'));
    match (part, layer) {
        ("", name) | (name, "") => name.into(),
        _ if repeats => layer.into(),
        _ if part.strip_suffix(layer).is_some_and(|rest| rest.ends_with('.')) => part.into(),
        _ => format!("{part}.{layer}"),
    }
}

/// Names of whole pictures, by how sure they are.
const PICTURES: [&[&str]; 6] = [
    &[],
    &["rgba", "rgb"],
    &["beauty", "masterbeauty"],
    &["combined"],
    &["composite", "composited"],
    &["color", "colour", "c", "ci", "image", "final", "default", "master", "radiance", "result"],
];
/// Words of layers that are no light.
const NO_LIGHT: &[&str] = &[
    "normal",
    "normals",
    "n",
    "ng",
    "ns",
    "nn",
    "nx",
    "ao",
    "occ",
    "occlusion",
    "albedo",
    "position",
    "positions",
    "pos",
    "p",
    "pworld",
    "pref",
    "crypto",
    "cryptomatte",
    "depth",
    "z",
    "zdepth",
    "uv",
    "uvs",
    "uvw",
    "st",
    "velocity",
    "vector",
    "vectors",
    "motion",
    "mv",
    "id",
    "ids",
    "mask",
    "masks",
    "matte",
    "mattes",
    "mist",
    "index",
    "basecolor",
    "basecolour",
    "diffcol",
    "glosscol",
    "transcol",
    "subsurfacecol",
    "metallic",
    "metalness",
    "roughness",
    "tangent",
    "tangents",
    "variance",
    "samples",
    "facing",
    "fresnel",
    "alpha",
    "opacity",
    "coverage",
    "shadow",
    "shadows",
    "wireframe",
    "barycentric",
    "ior",
    "curvature",
    "thickness",
    "stencil",
    "hitproxy",
    "deep",
    "debug",
    "sample",
    "count",
];
/// The same where they are a piece of a longer word: `worldnormal`, `motionvectors`.
const NO_LIGHT_PIECES: &[&str] = &[
    "normal",
    "occlusion",
    "albedo",
    "position",
    "crypto",
    "depth",
    "velocity",
    "motionvec",
    "roughness",
    "metalness",
    "objectid",
    "materialid",
    "instanceid",
    "basecol",
];
/// Words of layers that are a share of the light.
const SHARES: &[&str] = &[
    "diffuse",
    "diff",
    "specular",
    "spec",
    "glossy",
    "gloss",
    "transmission",
    "trans",
    "transmit",
    "sss",
    "subsurface",
    "coat",
    "sheen",
    "emission",
    "emit",
    "emissive",
    "direct",
    "indirect",
    "dir",
    "ind",
    "diffdir",
    "diffind",
    "glossdir",
    "glossind",
    "transdir",
    "transind",
    "volume",
    "vol",
    "reflection",
    "reflections",
    "reflect",
    "refraction",
    "refractions",
    "refract",
    "gi",
    "caustics",
    "lighting",
    "illumination",
    "illum",
    "selfillum",
    "globalillumination",
];
/// The same where they are a piece of a longer word: `rawdiffuse`, `selfillumination`.
const SHARE_PIECES: &[&str] =
    &["diffuse", "specular", "glossy", "subsurface", "emission", "indirect", "reflect", "refract", "illumin"];
/// Words that make a surface's colour of what would be its share of the light.
const COLOURS: &[&str] = &["color", "colour", "col", "filter", "base"];
/// Words that say which of several alike it is.
const VIEWS: &[&str] = &["left", "right", "center", "centre", "l", "r"];

/// What a layer's name says of it.
fn class_of(layer: &str) -> Class {
    if layer.is_empty() {
        return Class::Picture(0);
    }
    layer.rsplit('.').map(class_of_segment).find(|class| *class != Class::Unknown).unwrap_or(Class::Unknown)
}

fn class_of_segment(segment: &str) -> Class {
    let words = words_of(segment);
    let has = |list: &[&str]| words.iter().any(|word| list.contains(&word.as_str()));
    let pieces = |list: &[&str]| words.iter().any(|word| list.iter().any(|piece| word.contains(piece)));
    let share = has(SHARES) || pieces(SHARE_PIECES);
    let ends = |word: &String| COLOURS.iter().any(|colour| word.ends_with(colour));
    if has(NO_LIGHT) || pieces(NO_LIGHT_PIECES) || has(&["base"]) || (share && words.iter().any(ends)) {
        return Class::NoLight;
    }
    if share {
        return Class::Share;
    }
    // Words that name a picture, by the surest of them.
    let said: Vec<&String> = words.iter().filter(|word| !VIEWS.contains(&word.as_str())).collect();
    let rank = |word: &&String| PICTURES.iter().position(|names| names.contains(&word.as_str()));
    let ranks: Vec<usize> = said.iter().filter_map(rank).collect();
    match ranks.iter().min() {
        Some(rank) if ranks.len() == said.len() => Class::Picture(*rank as u8),
        Some(_) => Class::LikePicture,
        None => Class::Unknown,
    }
}

/// The words of a name in lower case: `DiffCol` is diff, col; `CryptoObject00` is crypto, object; `rgba_left` is rgba,
/// left.
fn words_of(segment: &str) -> Vec<String> {
    let mut words: Vec<String> = vec![String::new()];
    let mut before = ' ';
    for c in segment.chars() {
        let starts = c.is_uppercase() && before.is_lowercase();
        if !c.is_alphabetic() || starts {
            words.push(String::new());
        }
        if c.is_alphabetic() {
            words.last_mut().expect("it begins with one").extend(c.to_lowercase());
        }
        before = c;
    }
    words.retain(|word| !word.is_empty());
    words
}

/// Where the distance of the picture's pixels is: in its layer, in its part, or in a part beside it that shows the
/// same.
fn distance_of(headers: &[Header], chosen: &Candidate, findings: &mut Vec<Finding>) -> Option<(usize, usize)> {
    let header = &headers[chosen.part];
    let names: Vec<String> = header.channels.list.iter().map(|c| c.name.to_string()).collect();
    let any_case = |wanted: &str| names.iter().position(|name| name.eq_ignore_ascii_case(wanted));
    // Z beside X and Y is a coordinate.
    let alone = |prefix: &str| {
        let coordinate = any_case(&format!("{prefix}X")).is_some() && any_case(&format!("{prefix}Y")).is_some();
        any_case(&format!("{prefix}Z")).filter(|_| !coordinate)
    };
    // Z of the layer itself, of the image, or of a depth layer beside it (Blender: ViewLayer.Combined.R,
    // ViewLayer.Depth.Z).
    let layer = chosen.prefix.as_str();
    let above = layer.trim_end_matches('.').rfind('.').map_or("", |dot| &layer[..=dot]);
    let own =
        alone(layer).or_else(|| alone("")).or_else(|| alone(&format!("{above}depth."))).or_else(|| alone("depth."));
    if let Some(own) = own {
        return Some((chosen.part, own));
    }
    beside(headers, chosen, findings)
}

/// A part that holds the distance of what another part shows (Blender 5 writes one part per layer).
fn beside(headers: &[Header], chosen: &Candidate, findings: &mut Vec<Finding>) -> Option<(usize, usize)> {
    let above = |layer: &str| layer.rfind('.').map_or(String::new(), |dot| layer[..dot].to_lowercase());
    let view = |header: &Header, layer: &str| {
        let words = words_of(layer.rsplit('.').next().unwrap_or_default());
        let named = words.into_iter().find(|word| word == "left" || word == "right");
        header.own_attributes.view_name.as_ref().map(|name| name.to_string().to_lowercase()).or(named)
    };
    let colour_view = view(&headers[chosen.part], &chosen.layer);
    let mut elsewhere = None;
    for (part, header) in headers.iter().enumerate().filter(|(part, header)| *part != chosen.part && !header.deep) {
        let part_name = header.own_attributes.layer_name.as_ref().map(ToString::to_string).unwrap_or_default();
        for (index, channel) in header.channels.list.iter().enumerate() {
            let name = channel.name.to_string();
            let (prefix, own) = name.rfind('.').map_or(("", &name[..]), |dot| (&name[..dot], &name[dot + 1..]));
            let layer = joined(&part_name, prefix);
            let words = words_of(layer.rsplit('.').next().unwrap_or_default());
            let is_depth = |word: &String| matches!(word.as_str(), "depth" | "z" | "zdepth" | "distance");
            let of_depth =
                words.iter().any(is_depth) && words.iter().all(|word| is_depth(word) || VIEWS.contains(&word.as_str()));
            let lone = header.channels.list.len() == 1;
            let depth = own.eq_ignore_ascii_case("Z") && (of_depth || lone && class_of(&layer) == Class::Unknown)
                || lone && of_depth;
            let belongs = above(&layer).is_empty() || above(&layer) == above(&chosen.layer);
            let depth_view = view(header, &layer);
            let same_view = colour_view.is_none() || depth_view.is_none() || colour_view == depth_view;
            if !(depth && belongs && same_view) {
                continue;
            }
            if header.data_window() == headers[chosen.part].data_window() {
                return Some((part, index));
            }
            elsewhere.get_or_insert(layer);
        }
    }
    if let Some(layer) = elsewhere {
        let message =
            format!("the distances of {layer} are not of the picture's own pixels (data window), and were not read");
        findings.push(Finding::new("distance-not-read", 1, message));
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_tell_pictures_from_what_is_no_light() {
        let picture = |name: &str| matches!(class_of(name), Class::Picture(_));
        for name in [
            "",
            "RGBA",
            "rgb",
            "beauty",
            "Beauty",
            "Combined",
            "ViewLayer.Combined",
            "View Layer.Combined.left",
            "Composite",
            "C",
            "Ci",
            "FinalImage",
            "rgba_left",
            "Normals.Combined",
            "RGB_color",
            "color",
        ] {
            assert!(picture(name), "{name}: {:?}", class_of(name));
        }
        for (name, expected) in [
            ("RGBA_key", Class::LikePicture),
            ("Combined_Fill", Class::LikePicture),
            ("beauty_denoised", Class::LikePicture),
            ("ViewLayer.Noisy Image", Class::LikePicture),
            ("left", Class::Unknown),
            ("mm", Class::Unknown),
            ("ViewLayer.Env", Class::Unknown),
            ("ViewLayer.Environment", Class::Unknown),
            ("subimage00", Class::Unknown),
            ("diffuse", Class::Share),
            ("ViewLayer.Emit", Class::Share),
            ("ViewLayer.DiffDir", Class::Share),
            ("RGBA_specular", Class::Share),
            ("Glossy Indirect", Class::Share),
            ("VRayGlobalIllumination", Class::Share),
            ("Volume Direct", Class::Share),
            ("N", Class::NoLight),
            ("Normal", Class::NoLight),
            ("ViewLayer.AO", Class::NoLight),
            ("ViewLayer.Ambient Occlusion", Class::NoLight),
            ("albedo", Class::NoLight),
            ("ViewLayer.DiffCol", Class::NoLight),
            ("ViewLayer.Diffuse Color", Class::NoLight),
            ("Glossy Color", Class::NoLight),
            ("BaseColor", Class::NoLight),
            ("ViewLayer.Denoising Albedo", Class::NoLight),
            ("ViewLayer.Denoising Normal", Class::NoLight),
            ("ViewLayer.Position", Class::NoLight),
            ("P", Class::NoLight),
            ("CryptoObject00", Class::NoLight),
            ("ViewLayer.CryptoMaterial01", Class::NoLight),
            ("crypto_asset", Class::NoLight),
            ("cryptomatte", Class::NoLight),
            ("WorldNormal", Class::NoLight),
            ("worldnormal", Class::NoLight),
            ("motionvectors", Class::NoLight),
            ("diffusecolor", Class::NoLight),
            ("rawdiffuse", Class::Share),
            ("UV", Class::NoLight),
            ("MotionVectors", Class::NoLight),
            ("objectID", Class::NoLight),
            ("IndexOB", Class::NoLight),
            ("Depth", Class::NoLight),
            ("Shadow", Class::NoLight),
        ] {
            assert_eq!(class_of(name), expected, "{name}");
        }
    }

    #[test]
    fn parts_and_layers_are_named_once() {
        for (part, layer, expected) in [
            ("", "", ""),
            ("albedo", "", "albedo"),
            ("", "beauty", "beauty"),
            ("left", "beauty", "left.beauty"),
            ("ViewLayer.Combined", "ViewLayer.Combined", "ViewLayer.Combined"),
            ("ViewLayer", "ViewLayer.AO", "ViewLayer.AO"),
            ("ViewLayer.AO", "AO", "ViewLayer.AO"),
        ] {
            assert_eq!(joined(part, layer), expected);
        }
    }
}
