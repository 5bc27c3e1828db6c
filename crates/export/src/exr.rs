//! An OpenEXR image of coefficients, for whoever has a reader of images: 32-bit, all bands, one layer per coefficient.
//!
//! Width nx, height ny · nz: slices of constant z one above the other, the first node in the top left corner, x to the
//! right, y downward within a slice. Channels `sh0.R`, `sh0.G`, `sh0.B`, `sh1.R` … and `validity` (the share that was
//! baked). The attribute `gdibl:grid` is text of nine numbers: nodes per axis, where the first is, where the last (metres).

use ::exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, write::WritableImage};
use ::exr::meta::attribute::{AttributeValue, LineOrder, Text};
use ::exr::meta::header::LayerAttributes;
use ::exr::prelude::{Blocks, Compression, SmallVec};
use std::io::Cursor;

use gdibl_runtime::sh::coefficient_count;
use gdibl_runtime::{Grid, RadianceSh, Volume};

use crate::light::{Least, Light};
use crate::loss::Truth;
use crate::{Error, Export, File, Report, Settings};

pub(crate) fn export(volume: &Volume, settings: &Settings) -> Result<Export, Error> {
    let light = Light::of_volume(volume, settings.counts, Least::One)?;
    let truth = Truth::of_volume(volume);
    let error = truth.loss(|position, normal| irradiance(&light, position, normal));
    Ok(Export {
        files: vec![File { name: settings.name.clone(), bytes: image(&light) }],
        report: Report {
            counts: light.grid.counts,
            bands_of_volume: volume.header().bands,
            bands: Some(volume.header().bands),
            error,
            variants: Vec::new(),
            negative: truth.negative("kept"),
            notes: light.notes,
        },
    })
}

fn image(light: &Light) -> Vec<u8> {
    let [nx, ny, nz] = light.counts();
    let mut channels = SmallVec::new();
    let count = light.nodes.first().map_or(0, |sh| coefficient_count(sh.bands));
    for coefficient in 0..count {
        for (c, name) in ["R", "G", "B"].iter().enumerate() {
            let values = light.nodes.iter().map(|sh| sh.coefficients[coefficient][c]).collect();
            channels.push(AnyChannel::new(format!("sh{coefficient}.{name}").as_str(), FlatSamples::F32(values)));
        }
    }
    channels.push(AnyChannel::new("validity", FlatSamples::F32(light.validity.clone())));
    let encoding =
        Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let layer = Layer::new((nx, ny * nz), LayerAttributes::default(), encoding, AnyChannels::sort(channels));
    let mut image = Image::from_layer(layer);
    // One attribute: the crate keeps several in a hash map, which has no order, and bytes shall not depend on it.
    let numbers = |values: [f64; 3]| values.map(|v| v.to_string()).join(" ");
    let Grid { min, max, counts } = light.grid;
    let grid = [counts.map(f64::from), min, max].map(numbers).join(" ");
    image.attributes.other.insert(Text::from("gdibl:grid"), AttributeValue::Text(Text::from(grid.as_str())));
    let mut bytes = Cursor::new(Vec::new());
    image.write().to_buffered(&mut bytes).expect("memory takes all that is written");
    bytes.into_inner()
}

/// E as a reader has it that interpolates between all nodes, clamped at 0.
pub(crate) fn irradiance(light: &Light, position: [f64; 3], normal: [f32; 3]) -> [f64; 3] {
    let cell = light.grid.locate(position);
    let mut sh = RadianceSh::zero(0);
    for (&node, weight) in cell.nodes.iter().zip(cell.weights) {
        sh.add_scaled(&light.nodes[node as usize], weight);
    }
    sh.convolve().evaluate(normal).map(|e| f64::from(e.max(0.0)))
}
