//! three.js' `LightProbeGrid`: its atlas in half floats, with counts and box, as one binary file; and a module of
//! JavaScript that loads it.
//!
//! ```text
//! 0    "gdiblLPG", version (u32, 1), counts nx, ny, nz (u32 each)
//! 24   first node, last node (three f32 each), metres
//! 48   RGBA half floats of nx × ny × 7 (nz + 2) texels: seven blocks of nz + 2 slices, of which the first and last
//!      repeat their neighbours, since the filter reads across
//! ```
//! The blocks hold the nine coefficients one after the other, c0.rgb c1.r | c1.gb c2.rg | c2.b c3.rgb | c4.rgb c5.r |
//! c5.gb c6.rg | c6.b c7.rgb | c8.rgb 1: radiance as it stands in a `.gdibl`, neither convolved nor over π.
//!
//! Until r186 the first node is on the box's face, from r187 amid its cell; the file tells where nodes are, and the
//! module asks the class which it wants. Both have the shader read half a spacing along the normal, against light that
//! leaks through walls: for a lone object this is a loss, and the report says of what size.
//!
//! Based on: three.js r187, `lightprobes_pars_fragment.glsl.js`, `LightProbeGridWebGL.js`, `LightProbeGridNode.js`.

use half::f16;

use gdibl_runtime::Volume;

use crate::light::{Least, Light, text};
use crate::loss::Truth;
use crate::texture::Texture;
use crate::{Error, Export, File, Note, Report, Settings};

const LOADER: &str = include_str!("gdibl-light-probe-grid.js");
const MAGIC: &[u8; 8] = b"gdiblLPG";
const BLOCKS: usize = 7;

/// The largest side of a 3-D texture where most devices end, and what WebGL 2 promises.
const MAX_SIDE: usize = 2048;
const PROMISED_SIDE: usize = 256;

pub(crate) fn export(volume: &Volume, settings: &Settings) -> Result<Export, Error> {
    let mut light = Light::of_volume(volume, settings.counts, Least::Two)?.truncated();
    let atlas = Atlas::encode(&light)?;
    let truth = Truth::of_volume(volume);
    let error = truth.loss(|position, normal| atlas.irradiance(position, normal, 0.5));
    let unmoved = truth.loss(|position, normal| atlas.irradiance(position, normal, 0.0));
    light.notes.push(Note::new(
        "normal-offset",
        format!(
            "three.js reads half a spacing along the normal; without that the error would be {:.2} %. More --counts make \
             the spacing, and this, smaller",
            100.0 * unmoved.relative_rmse
        ),
    ));
    let largest = atlas.texture.size.into_iter().max().unwrap_or(0);
    if largest > PROMISED_SIDE {
        light.notes.push(Note::new(
            "texture-size",
            format!(
                "the atlas is {largest} texels long; WebGL 2 promises {PROMISED_SIDE}, most devices have {MAX_SIDE}"
            ),
        ));
    }
    Ok(Export {
        files: vec![
            File { name: settings.name.clone(), bytes: atlas.file(&light) },
            File { name: "gdibl-light-probe-grid.js".into(), bytes: LOADER.into() },
        ],
        report: Report {
            counts: light.grid.counts,
            bands_of_volume: volume.header().bands,
            bands: Some(crate::light::ENGINE_BANDS),
            error,
            variants: Vec::new(),
            negative: truth.negative("the shader clamps at 0"),
            notes: light.notes,
        },
    })
}

/// The atlas, with the box whose cells have nodes in their middle.
struct Atlas {
    texture: Texture,
    halves: Vec<u16>,
    counts: [usize; 3],
    min: [f64; 3],
    max: [f64; 3],
}

impl Atlas {
    fn encode(light: &Light) -> Result<Atlas, Error> {
        let counts = light.counts();
        let [nx, ny, nz] = counts;
        let size = [nx, ny, BLOCKS * (nz + 2)];
        if size.iter().any(|&side| side > MAX_SIDE) {
            return Err(Error::Unsupported(format!(
                "{} nodes make an atlas of {nx} x {ny} x {}, over the {MAX_SIDE} of a 3-D texture: give fewer --counts",
                text(light.grid.counts),
                size[2]
            )));
        }
        let largest = light.largest();
        if f16::from_f32(largest).is_infinite() {
            return Err(Error::Unsupported(format!(
                "holds a coefficient of {largest:e}, and half floats end at {}: bake with --clamp or --sun extract",
                f16::MAX
            )));
        }
        let mut halves = Vec::with_capacity(4 * size.iter().product::<usize>());
        for block in 0..BLOCKS {
            for slice in 0..nz + 2 {
                let z = slice.saturating_sub(1).min(nz - 1);
                for node in nx * ny * z..nx * ny * (z + 1) {
                    let values = light.nodes[node].coefficients[..9].as_flattened();
                    let texel = (4 * block..4 * block + 4).map(|i| values.get(i).copied().unwrap_or(1.0));
                    halves.extend(texel.map(|value| f16::from_f32(value).to_bits()));
                }
            }
        }
        let texels = halves.as_chunks::<4>().0.iter().map(|t| t.map(|bits| f16::from_bits(bits).to_f32()));
        let texture = Texture { size, texels: texels.collect() };
        let (min, max) = light.cell_box();
        Ok(Atlas { texture, halves, counts, min, max })
    }

    fn file(&self, light: &Light) -> Vec<u8> {
        let mut file = MAGIC.to_vec();
        let words = [1, self.counts[0], self.counts[1], self.counts[2]].map(|n| (n as u32).to_le_bytes());
        file.extend(words.as_flattened());
        let corners = [light.grid.min, light.grid.max].map(|p| p.map(|v| (v as f32).to_le_bytes()));
        file.extend(corners.as_flattened().as_flattened());
        file.extend(self.halves.iter().flat_map(|bits| bits.to_le_bytes()));
        file
    }

    /// E: `getLightProbeGridIrradiance`, and 0 where `isInsideLightProbeGrid` finds no grid. The shader's `offset` along
    /// the normal is 0.5 spacings.
    fn irradiance(&self, position: [f64; 3], normal: [f32; 3], offset: f64) -> [f64; 3] {
        let res = self.counts.map(|n| n as f64);
        let range: [f64; 3] = std::array::from_fn(|k| self.max[k] - self.min[k]);
        let spacing: [f64; 3] = std::array::from_fn(|k| range[k] / res[k]);
        let place: [f64; 3] = std::array::from_fn(|k| position[k] + f64::from(normal[k]) * spacing[k] * offset);
        let margin = 0.01;
        if (0..3).any(|k| place[k] < self.min[k] - margin * spacing[k] || place[k] > self.max[k] + margin * spacing[k])
        {
            return [0.0; 3];
        }
        let uvw: [f64; 3] =
            std::array::from_fn(|k| ((place[k] - self.min[k]) / range[k]).max(0.5 / res[k]).min(1.0 - 0.5 / res[k]));
        let padded = res[2] + 2.0;
        let depth = BLOCKS as f64 * padded;
        let base = uvw[2] * res[2] + 1.0;
        let blocks: [[f64; 4]; BLOCKS] =
            std::array::from_fn(|t| self.texture.sample([uvw[0], uvw[1], (base + t as f64 * padded) / depth]));
        let values = blocks.as_flattened();
        let [x, y, z] = normal.map(f64::from);
        let factors = [
            0.886227,
            2.0 * 0.511664 * y,
            2.0 * 0.511664 * z,
            2.0 * 0.511664 * x,
            2.0 * 0.429043 * x * y,
            2.0 * 0.429043 * y * z,
            0.743125 * z * z - 0.247708,
            2.0 * 0.429043 * x * z,
            0.429043 * (x * x - y * y),
        ];
        std::array::from_fn(|c| (0..9).map(|i| values[3 * i + c] * factors[i]).sum::<f64>().max(0.0))
    }
}
