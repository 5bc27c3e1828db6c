//! Writes panoramas as OpenEXR: R, G, B, optional Z, ZIP-compressed, with pose and layout in the header. And pictures,
//! which have neither.

use std::io::{BufWriter, Write};
use std::path::Path;

use ::exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Layer, write::WritableImage};
use ::exr::meta::attribute::{AttributeValue, EnvironmentMap, LineOrder, Text};
use ::exr::meta::header::LayerAttributes;
use ::exr::prelude::{Blocks, Compression, SmallVec};
use glam::DVec3;
use half::f16;

use super::exr::convert_error;
use super::pose::{self, Pose};
use crate::panorama::{Image, Mapping};
use crate::whole::create_beside;
use crate::{Error, Finding, Result};

/// How R, G and B are stored. `Z` is always 32-bit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SampleFormat {
    /// Half floats: half the size, three digits, and 65504 is the brightest light.
    F16,
    /// Exact.
    F32,
}

/// Writes `image` to `path`: first to a temporary file beside it, then renamed, so that a reader finds the whole
/// file or none. The bytes depend on the arguments alone.
///
/// EXR's attribute `envmap` names lat-long and cube-exr; other mappings go into `gdibl:mapping`.
/// Returns the finding `half-float-clipping` where F16 cut light off.
pub fn write_exr(
    path: &Path,
    image: &Image,
    pose: &Pose,
    mapping: Mapping,
    format: SampleFormat,
) -> Result<Vec<Finding>> {
    let environment_map = match mapping {
        Mapping::LatLong => Some(EnvironmentMap::LatitudeLongitude),
        Mapping::CubeExr => Some(EnvironmentMap::Cube),
        _ => None,
    };
    let mut attributes = LayerAttributes { environment_map, ..Default::default() };
    // The crate keeps unknown attributes in hash maps, which have no order: one attribute per map, so that two runs
    // write the same bytes.
    if environment_map.is_none() {
        if pose.rotation.is_some() {
            return Err(Error::unsupported(
                path,
                format!("a turned probe in the mapping {}: write lat-long or cube-exr", mapping.name()),
            ));
        }
        attributes.other.insert(Text::from(pose::MAPPING), AttributeValue::Text(Text::from(mapping.name())));
    }
    if let Some(rotation) = pose.rotation {
        attributes.other.insert(Text::from(pose::ROTATION), pose::rotation_value(rotation));
    }
    write_layer(path, image, attributes, pose.position, format)?;
    Ok(clipping(image, format))
}

/// Writes a picture that is no panorama, exact: nothing in the header says how it maps directions.
pub fn write_exr_picture(path: &Path, image: &Image) -> Result<()> {
    write_layer(path, image, LayerAttributes::default(), None, SampleFormat::F32)
}

/// The whole file or none.
fn write_layer(
    path: &Path,
    image: &Image,
    attributes: LayerAttributes,
    position: Option<DVec3>,
    format: SampleFormat,
) -> Result<()> {
    assert_eq!(image.pixels.len(), image.width * image.height, "pixels of the image");
    assert!(!image.pixels.is_empty(), "an image needs pixels");
    let layer = Layer::new(
        (image.width, image.height),
        attributes,
        Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing },
        AnyChannels::sort(channels(image, format)),
    );
    let mut file = ::exr::image::Image::from_layer(layer);
    if let Some(position) = position {
        file.attributes.other.insert(Text::from(pose::POSITION), pose::position_value(position));
    }

    let mut temporary = create_beside(path)?;
    let mut writer = BufWriter::new(temporary.as_file_mut());
    file.write().to_buffered(&mut writer).map_err(|e| convert_error(path, "writing", e))?;
    writer.flush().map_err(|e| Error::io(path, e))?;
    drop(writer);
    temporary.persist(path).map_err(|e| Error::io(path, e.error))?;
    Ok(())
}

fn channels(image: &Image, format: SampleFormat) -> SmallVec<[AnyChannel<FlatSamples>; 4]> {
    let colour = |c: usize| match format {
        // Beyond the range the largest half float, not infinity: a reader would refuse that.
        SampleFormat::F16 => {
            FlatSamples::F16(image.pixels.iter().map(|p| f16::from_f32(p[c].min(f16::MAX.to_f32()))).collect())
        }
        SampleFormat::F32 => FlatSamples::F32(image.pixels.iter().map(|p| p[c]).collect()),
    };
    let mut channels = SmallVec::new();
    for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
        channels.push(AnyChannel::new(name, colour(c)));
    }
    if let Some(distance) = &image.distance {
        assert_eq!(distance.len(), image.pixels.len(), "distances of the image");
        channels.push(AnyChannel::new("Z", FlatSamples::F32(distance.clone())));
    }
    channels
}

fn clipping(image: &Image, format: SampleFormat) -> Vec<Finding> {
    let limit = f16::MAX.to_f32();
    let clipped = image.pixels.iter().filter(|p| p.iter().any(|v| *v > limit)).count();
    if format == SampleFormat::F32 || clipped == 0 {
        return Vec::new();
    }
    let message = format!("{clipped} pixels are brighter than 65504, where half floats end, and were cut off");
    vec![Finding::new("half-float-clipping", clipped as u64, message)]
}
