//! Textures: from a glTF texture to decoded pixels, each image once per way of wrapping.

use std::io::Cursor;

use glam::Vec3;
use gltf::json::texture::{MagFilter, MinFilter, WrappingMode};
use gltf::json::validation::Checked;
use image::{ImageDecoder, ImageReader};
use rayon::prelude::*;
use serde_json::{Map as Object, Value};

use super::buffers::Buffers;
use super::findings::Findings;
use super::uri;
use crate::scene::{Map, Texture, TextureSampler, Wrap, linear_of_srgb};
use crate::{Error, Result};

/// Pixels per side, and bytes a decoder may allocate: 16384² RGBA of 16 bits is 2 GiB.
const MAX_SIDE: u32 = 16384;
const MAX_BYTES: u64 = 2 << 30;

/// What stands in for a texture that is missing: 18 % grey, opaque.
const MID_GREY: [u8; 4] = [118, 118, 118, 255];

/// A requested texture: a number in [`Decoder`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Request(usize);

/// What a texture is decoded to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Put {
    /// Colour and alpha, or alpha alone: an image without it need not be kept then. `ignore_alpha` sets it to 1.
    Texture { ignore_alpha: bool, alpha_only: bool },
    /// Numbers of which [`Kept::map`] takes one per pixel.
    Map,
}

/// The number of a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Channel {
    Red,
    Green,
    Blue,
    Alpha,
    /// The largest of R, G, B, decoded from sRGB, times these.
    LargestSrgb(Vec3),
}

/// Collects what to decode.
#[derive(Default)]
pub(super) struct Decoder {
    jobs: Vec<Job>,
    allow_missing: bool,
    missing: Missing,
}

/// Textures that could not be had.
#[derive(Default)]
struct Missing {
    count: u64,
    first: Option<String>,
}

impl Missing {
    fn add(&mut self, error: &Error) {
        self.count += 1;
        self.first.get_or_insert_with(|| error.to_string());
    }
}

/// An image to decode, and how.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Job {
    /// `None`: there is none, and that is allowed.
    image: Option<usize>,
    sampler: TextureSampler,
    put: Put,
}

impl Decoder {
    /// With nothing to decode. `allow_missing`: what cannot be had is mid-grey, and a finding.
    pub fn new(allow_missing: bool) -> Decoder {
        Decoder { allow_missing, ..Decoder::default() }
    }

    /// Asks for glTF texture `index`.
    pub fn request(&mut self, buffers: &Buffers, index: usize, put: Put) -> Result<Request> {
        let document = buffers.document;
        let texture = document.get(&document.textures, index, "texture", &"a material")?;
        let place = format!("texture {index}");
        let image = match image_of(buffers, texture, &place) {
            Ok(image) => Some(image),
            Err(error) if self.allow_missing => {
                self.missing.add(&error);
                None
            }
            Err(error) => return Err(error),
        };
        let sampler = sampler_of(buffers, texture, &place)?;
        let same = |old: &Job| {
            let puts = match (old.put, put) {
                (Put::Texture { ignore_alpha: a, .. }, Put::Texture { ignore_alpha: b, .. }) => a == b,
                (old, new) => old == new,
            };
            old.image == image && old.sampler == sampler && puts
        };
        let at = self.jobs.iter().position(same);
        let Some(at) = at else {
            self.jobs.push(Job { image, sampler, put });
            return Ok(Request(self.jobs.len() - 1));
        };
        if let (Put::Texture { alpha_only: old, .. }, Put::Texture { alpha_only, .. }) = (&mut self.jobs[at].put, put) {
            *old &= alpha_only;
        }
        Ok(Request(at))
    }

    /// Decodes everything that was asked for, in parallel; the first error in the order of requests wins.
    pub fn decode(mut self, buffers: &Buffers, findings: &mut Findings) -> Result<Decoded> {
        let document = buffers.document;
        let mut encoded = Vec::new();
        for job in &self.jobs {
            let bytes = match job.image {
                None => None,
                Some(image) => match read_image(buffers, image) {
                    Ok(bytes) => Some((image_label(buffers, image), bytes)),
                    Err(error) if self.allow_missing => {
                        self.missing.add(&error);
                        None
                    }
                    Err(error) => return Err(error),
                },
            };
            encoded.push((*job, bytes));
        }
        let path = document.path;
        let decoded: Vec<Result<Image>> = encoded
            .into_par_iter()
            .map(|(job, bytes)| {
                let Some((label, bytes)) = bytes else { return Ok(Image::missing(job)) };
                let texture = decode_image(&bytes, job).map_err(|problem| match problem {
                    Problem::Damaged(message) => Error::invalid(path, format!("{label}: {message}")),
                    Problem::Unsupported(message) => Error::unsupported(path, format!("{label}: {message}")),
                })?;
                Ok(Image { texture, is_missing: false })
            })
            .collect();
        let mut images = Vec::with_capacity(decoded.len());
        for (image, job) in decoded.into_iter().zip(&self.jobs) {
            match image {
                Err(error) if self.allow_missing => {
                    self.missing.add(&error);
                    images.push(Image::missing(*job));
                }
                image => images.push(image?),
            }
        }
        findings.add("missing-textures", self.missing.count, || {
            format!(
                "Textures that could not be read were taken as mid-grey (18 %), and those of metallic, specular and \
                 transmission as 0, because missing ones are allowed, first: {}",
                self.missing.first.unwrap_or_default()
            )
        });
        Ok(Decoded { images })
    }
}

/// The image of a texture.
fn image_of(buffers: &Buffers, texture: &gltf::json::Texture, place: &str) -> Result<usize> {
    let document = buffers.document;
    let others = texture.extensions.as_ref().map(|extensions| &extensions.others);
    // Extensions name an image in a format that core glTF does not have; `source` is then the fallback.
    let source = Some(texture.source.value()).filter(|&source| source != u32::MAX as usize);
    let source = extension_source(others, "EXT_texture_webp").or(source);
    let Some(image) = source else {
        let converter = [
            ("KHR_texture_basisu", "KTX2", KTX2_ADVICE),
            ("EXT_texture_avif", "AVIF", ADVICE),
            ("MSFT_texture_dds", "DDS", "an image converter"),
        ];
        return Err(match converter.iter().find(|(name, ..)| others.is_some_and(|o| o.contains_key(*name))) {
            Some((name, format, tool)) => document.unsupported(format!(
                "{place}: its only image is {format} ({name}); convert it to PNG, JPEG or WebP ({tool})"
            )),
            None => document.invalid(format!("{place}: it names no image (source)")),
        });
    };
    document.get(&document.images, image, "image", &place)?;
    Ok(image)
}

/// What turns all textures of a level into PNG. Without `--formats` it looks at no AVIF.
const ADVICE: &str = "gltf-transform png IN OUT --formats \"*\"";
const KTX2_ADVICE: &str = "ktx extract, then name the PNG";

/// How a texture is looked up. A sampler that says how to make it smaller, and not how to make it larger, means both.
fn sampler_of(buffers: &Buffers, texture: &gltf::json::Texture, place: &str) -> Result<TextureSampler> {
    let document = buffers.document;
    let Some(sampler) = texture.sampler else { return Ok(TextureSampler::default()) };
    let sampler = document.get(&document.samplers, sampler.value(), "sampler", &place)?;
    let wrap = [sampler.wrap_s, sampler.wrap_t].map(|mode| match mode {
        Checked::Valid(WrappingMode::ClampToEdge) => Wrap::ClampToEdge,
        Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::MirroredRepeat,
        Checked::Valid(WrappingMode::Repeat) | Checked::Invalid => Wrap::Repeat,
    });
    let nearest = match (sampler.mag_filter, sampler.min_filter) {
        (Some(Checked::Valid(mag)), _) => mag == MagFilter::Nearest,
        (_, Some(Checked::Valid(min))) => {
            matches!(min, MinFilter::Nearest | MinFilter::NearestMipmapNearest | MinFilter::NearestMipmapLinear)
        }
        _ => false,
    };
    Ok(TextureSampler { wrap, nearest })
}

/// A decoded image.
struct Image {
    /// None where only alpha was asked for and there is none.
    texture: Option<Texture>,
    is_missing: bool,
}

impl Image {
    fn missing(job: Job) -> Image {
        let texture = Texture { width: 1, height: 1, rgba8: vec![MID_GREY], sampler: job.sampler };
        Image { texture: Some(texture), is_missing: true }
    }
}

/// Decoded images by request.
pub(super) struct Decoded {
    images: Vec<Image>,
}

impl Decoded {
    /// Starts to number those that materials look up.
    pub fn keep(self) -> Kept {
        Kept {
            number: vec![None; self.images.len()],
            order: Vec::new(),
            images: self.images,
            maps: Vec::new(),
            made: Vec::new(),
        }
    }
}

/// Decoded images, and which of them are looked up as textures, which as maps.
pub(super) struct Kept {
    images: Vec<Image>,
    number: Vec<Option<u32>>,
    order: Vec<usize>,
    maps: Vec<Map>,
    made: Vec<(Request, Channel, (f32, Option<u32>))>,
}

impl Kept {
    /// The index in `Scene::textures` of a request.
    pub fn texture(&mut self, request: Request) -> Option<u32> {
        self.images[request.0].texture.as_ref()?;
        Some(*self.number[request.0].get_or_insert_with(|| {
            self.order.push(request.0);
            self.order.len() as u32 - 1
        }))
    }

    /// A channel of a request: what is the same all over, and the index in `Scene::maps` of what that is to be multiplied by,
    /// if anything.
    pub fn map(&mut self, request: Request, channel: Channel) -> (f32, Option<u32>) {
        if let Some((.., found)) = self.made.iter().find(|made| (made.0, made.1) == (request, channel)) {
            return *found;
        }
        let found = self.make_map(request, channel);
        self.made.push((request, channel, found));
        found
    }

    fn make_map(&mut self, request: Request, channel: Channel) -> (f32, Option<u32>) {
        let Image { texture, is_missing } = &self.images[request.0];
        if *is_missing {
            // Rough, and of full thickness; no metal, and nothing goes through.
            return (if channel == Channel::Green { 1.0 } else { 0.0 }, None);
        }
        let Some(texture) = texture.as_ref().filter(|texture| !texture.rgba8.is_empty()) else { return (1.0, None) };
        let value = |pixel: &[u8; 4]| match channel {
            Channel::Red => pixel[0],
            Channel::Green => pixel[1],
            Channel::Blue => pixel[2],
            Channel::Alpha => pixel[3],
            Channel::LargestSrgb(factor) => {
                let linear = Vec3::new(pixel[0].into(), pixel[1].into(), pixel[2].into());
                let linear = Vec3::from(linear.to_array().map(|byte| linear_of_srgb(byte as u8)));
                ((linear * factor).max_element() * 255.0).round() as u8
            }
        };
        let first = value(&texture.rgba8[0]);
        if texture.rgba8.iter().all(|pixel| value(pixel) == first) {
            return (f32::from(first) / 255.0, None);
        }
        let values = texture.rgba8.iter().map(value).collect();
        let Texture { width, height, sampler, .. } = *texture;
        self.maps.push(Map { width, height, values, sampler });
        (1.0, Some(self.maps.len() as u32 - 1))
    }

    /// The textures and the maps in the order of their numbers.
    pub fn into_parts(mut self) -> (Vec<Texture>, Vec<Map>) {
        let textures = self.order.iter().filter_map(|&request| self.images[request].texture.take()).collect();
        (textures, self.maps)
    }
}

/// The image that an extension of a texture names, e.g. EXT_texture_webp's.
fn extension_source(others: Option<&Object<String, Value>>, name: &str) -> Option<usize> {
    usize::try_from(others?.get(name)?.get("source")?.as_u64()?).ok()
}

/// "image 2 (wood.png)".
fn image_label(buffers: &Buffers, index: usize) -> String {
    let image = &buffers.document.images[index];
    match (&image.name, &image.uri) {
        (_, Some(uri)) if uri.get(..5).is_none_or(|scheme| !scheme.eq_ignore_ascii_case("data:")) => {
            format!("image {index} ({})", uri::shorten(uri))
        }
        (Some(name), _) => format!("image {index} ({name})"),
        _ => format!("image {index}"),
    }
}

/// The file's bytes of an image.
fn read_image(buffers: &Buffers, index: usize) -> Result<Vec<u8>> {
    let image = &buffers.document.images[index];
    let label = image_label(buffers, index);
    match (&image.uri, image.buffer_view) {
        (Some(uri), _) => uri::load(uri, buffers.document, &label),
        (None, Some(view)) => Ok(buffers.view(view.value(), &label)?.bytes.to_vec()),
        (None, None) => Err(buffers.document.invalid(format!("{label}: neither uri nor bufferView"))),
    }
}

/// Why an image does not decode.
enum Problem {
    Damaged(String),
    Unsupported(String),
}

fn decode_image(bytes: &[u8], job: Job) -> std::result::Result<Option<Texture>, Problem> {
    // By the first bytes, whatever name and media type say.
    let foreign = [
        (&b"\xABKTX 20\xBB"[..], 0, "KTX2", KTX2_ADVICE),
        (&b"\xABKTX 11\xBB"[..], 0, "KTX", KTX2_ADVICE),
        (&b"DDS "[..], 0, "DDS", "an image converter"),
        (&b"ftypavif"[..], 4, "AVIF", ADVICE),
        (&b"ftypavis"[..], 4, "AVIF", ADVICE),
        (&b"ftyphei"[..], 4, "HEIC", "an image converter"),
        (&b"ftypmif1"[..], 4, "HEIF", "an image converter"),
        (&b"\0\0\0\x0CjP  \r\n\x87\n"[..], 0, "JPEG 2000", "an image converter"),
        (&b"\xFF\x4F\xFF\x51"[..], 0, "JPEG 2000", "an image converter"),
        (&b"\0\0\0\x0CJXL \r\n\x87\n"[..], 0, "JPEG XL", "an image converter"),
        (&b"\xFF\x0A"[..], 0, "JPEG XL", "an image converter"),
    ];
    for (magic, at, format, tool) in foreign {
        if bytes.get(at..).is_some_and(|rest| rest.starts_with(magic)) {
            return Err(Problem::Unsupported(format!("{format}; convert it to PNG, JPEG or WebP ({tool})")));
        }
    }
    let damaged = |e: image::ImageError| match e {
        image::ImageError::Limits(e) => {
            Problem::Unsupported(format!("over the limit of {MAX_SIDE} pixels per side ({e}); make it smaller"))
        }
        image::ImageError::Unsupported(e) => Problem::Unsupported(format!("{e}; convert it to PNG, JPEG or WebP")),
        e => Problem::Damaged(format!("{e}; the image is damaged")),
    };
    let reader = ImageReader::new(Cursor::new(bytes));
    let mut reader = reader.with_guessed_format().map_err(|e| Problem::Damaged(e.to_string()))?;
    if reader.format().is_none() {
        let start = bytes[..bytes.len().min(8)].escape_ascii();
        return Err(Problem::Damaged(format!("starts with \"{start}\"; expected PNG, JPEG or WebP")));
    }
    let mut limits = image::Limits::default();
    (limits.max_image_width, limits.max_image_height) = (Some(MAX_SIDE), Some(MAX_SIDE));
    limits.max_alloc = Some(MAX_BYTES);
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(damaged)?;
    let (ignore_alpha, alpha_only) = match job.put {
        Put::Texture { ignore_alpha, alpha_only } => (ignore_alpha, alpha_only),
        Put::Map => (false, false),
    };
    if alpha_only && !decoder.color_type().has_alpha() {
        return Ok(None);
    }
    let mut image = image::DynamicImage::from_decoder(decoder).map_err(damaged)?.into_rgba8();
    if ignore_alpha {
        image.pixels_mut().for_each(|pixel| pixel.0[3] = 255);
    }
    let (width, height) = image.dimensions();
    let rgba8 = image.pixels().map(|pixel| pixel.0).collect();
    Ok(Some(Texture { width, height, rgba8, sampler: job.sampler }))
}
