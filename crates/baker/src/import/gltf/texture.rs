//! Textures: from a glTF texture to decoded pixels, each image once per way of wrapping.

use std::io::Cursor;

use gltf::json::texture::WrappingMode;
use gltf::json::validation::Checked;
use image::{ImageDecoder, ImageReader};
use rayon::prelude::*;
use serde_json::{Map, Value};

use super::buffers::Buffers;
use super::uri;
use crate::scene::{Texture, Wrap};
use crate::{Error, Result};

/// Pixels per side, and bytes a decoder may allocate: 16384² RGBA of 16 bits is 2 GiB.
const MAX_SIDE: u32 = 16384;
const MAX_BYTES: u64 = 2 << 30;

/// A requested texture: a number in [`Decoder`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Request(usize);

/// Collects what to decode.
#[derive(Default)]
pub(super) struct Decoder {
    jobs: Vec<Job>,
}

/// An image to decode, and how.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Job {
    image: usize,
    wrap: [Wrap; 2],
    /// Set alpha to 1.
    ignore_alpha: bool,
    /// Only alpha is asked for: an image without it need not be kept.
    alpha_only: bool,
}

impl Decoder {
    /// Asks for glTF texture `index`.
    pub fn request(
        &mut self,
        buffers: &Buffers,
        index: usize,
        needs_colour: bool,
        ignore_alpha: bool,
    ) -> Result<Request> {
        let document = buffers.document;
        let texture = document.get(&document.textures, index, "texture", &"a material")?;
        let place = format!("texture {index}");
        let others = texture.extensions.as_ref().map(|extensions| &extensions.others);

        // Extensions name an image in a format that core glTF does not have; `source` is then the fallback.
        let source = Some(texture.source.value()).filter(|&source| source != u32::MAX as usize);
        let source = extension_source(others, "EXT_texture_webp").or(source);
        let Some(image) = source else {
            let converter = [
                ("KHR_texture_basisu", "KTX2", "ktx extract, then name the PNG"),
                ("EXT_texture_avif", "AVIF", "gltf-transform png"),
                ("MSFT_texture_dds", "DDS", "an image converter"),
            ];
            return Err(match converter.iter().find(|(name, ..)| others.is_some_and(|o| o.contains_key(*name))) {
                Some((name, format, tool)) => document.unsupported(format!(
                    "{place}: its only image is {format} ({name}); convert it to PNG, JPEG or WebP ({tool})"
                )),
                None => document.invalid(format!("{place}: it names no image (source)")),
            });
        };
        let wrap = match texture.sampler {
            None => [Wrap::Repeat; 2],
            Some(sampler) => {
                let sampler = document.get(&document.samplers, sampler.value(), "sampler", &place)?;
                [sampler.wrap_s, sampler.wrap_t].map(|mode| match mode {
                    Checked::Valid(WrappingMode::ClampToEdge) => Wrap::ClampToEdge,
                    Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::MirroredRepeat,
                    Checked::Valid(WrappingMode::Repeat) | Checked::Invalid => Wrap::Repeat,
                })
            }
        };
        document.get(&document.images, image, "image", &place)?;

        let job = Job { image, wrap, ignore_alpha, alpha_only: !needs_colour };
        let same = |old: &Job| Job { alpha_only: job.alpha_only, ..*old } == job;
        match self.jobs.iter().position(same) {
            Some(at) => {
                self.jobs[at].alpha_only &= job.alpha_only;
                Ok(Request(at))
            }
            None => {
                self.jobs.push(job);
                Ok(Request(self.jobs.len() - 1))
            }
        }
    }

    /// Decodes everything that was asked for, in parallel; the first error in the order of requests wins.
    pub fn decode(self, buffers: &Buffers) -> Result<Decoded> {
        let document = buffers.document;
        let mut encoded = Vec::new();
        for job in &self.jobs {
            encoded.push((*job, image_label(buffers, job.image), read_image(buffers, job.image)?));
        }
        let path = document.path;
        let decoded: Vec<Result<Option<Texture>>> = encoded
            .into_par_iter()
            .map(|(job, label, bytes)| {
                decode_image(&bytes, job).map_err(|problem| match problem {
                    Problem::Damaged(message) => Error::invalid(path, format!("{label}: {message}")),
                    Problem::Unsupported(message) => Error::unsupported(path, format!("{label}: {message}")),
                })
            })
            .collect();
        Ok(Decoded { textures: decoded.into_iter().collect::<Result<_>>()? })
    }
}

/// Decoded textures by request; none where only alpha was asked for and there is none.
pub(super) struct Decoded {
    textures: Vec<Option<Texture>>,
}

impl Decoded {
    /// Starts to number those that materials look up.
    pub fn keep(self) -> Kept {
        Kept { number: vec![None; self.textures.len()], order: Vec::new(), decoded: self.textures }
    }
}

/// Decoded textures, and which of them are looked up (rather than averaged).
pub(super) struct Kept {
    decoded: Vec<Option<Texture>>,
    number: Vec<Option<u32>>,
    order: Vec<usize>,
}

impl Kept {
    /// The index in `Scene::textures` of a request.
    pub fn texture(&mut self, request: Request) -> Option<u32> {
        self.decoded[request.0].as_ref()?;
        Some(*self.number[request.0].get_or_insert_with(|| {
            self.order.push(request.0);
            self.order.len() as u32 - 1
        }))
    }

    /// The mean of the blue channel, taken as linear: metallic.
    pub fn mean_blue(&self, request: Request) -> f32 {
        match &self.decoded[request.0] {
            Some(texture) if !texture.rgba8.is_empty() => {
                let sum: u64 = texture.rgba8.iter().map(|pixel| u64::from(pixel[2])).sum();
                (sum as f64 / (255.0 * texture.rgba8.len() as f64)) as f32
            }
            _ => 1.0,
        }
    }

    /// The textures in the order of their numbers.
    pub fn into_textures(mut self) -> Vec<Texture> {
        self.order.iter().filter_map(|&request| self.decoded[request].take()).collect()
    }
}

/// The image that an extension of a texture names, e.g. EXT_texture_webp's.
fn extension_source(others: Option<&Map<String, Value>>, name: &str) -> Option<usize> {
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
        (Some(uri), _) => uri::load(uri, buffers.document.path, &label),
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
        (&b"\xABKTX 20\xBB"[..], 0, "KTX2", "ktx extract"),
        (&b"\xABKTX 11\xBB"[..], 0, "KTX", "ktx extract"),
        (&b"DDS "[..], 0, "DDS", "an image converter"),
        (&b"ftypavif"[..], 4, "AVIF", "gltf-transform png"),
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
    if job.alpha_only && !decoder.color_type().has_alpha() {
        return Ok(None);
    }
    let mut image = image::DynamicImage::from_decoder(decoder).map_err(damaged)?.into_rgba8();
    if job.ignore_alpha {
        image.pixels_mut().for_each(|pixel| pixel.0[3] = 255);
    }
    let (width, height) = image.dimensions();
    let rgba8 = image.pixels().map(|pixel| pixel.0).collect();
    Ok(Some(Texture { width, height, rgba8, wrap: job.wrap }))
}
