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
//! leaks through walls. A `.gdibl` tells the light where it is asked, and its fill keeps walls out; so the coefficients
//! are chosen such that the shader, after its step, gets the light where it started, as far as its bands can.
//!
//! Based on: three.js r187, `lightprobes_pars_fragment.glsl.js`, `LightProbeGridWebGL.js`, `LightProbeGridNode.js`.

use half::f16;
use std::array;
use std::f64::consts::TAU;

use gdibl_runtime::sh::{COSINE, MAX_COEFFICIENTS, band_of, basis};
use gdibl_runtime::{RadianceSh, Volume};

use crate::light::{ENGINE_BANDS, Least, Light, text};
use crate::loss::{Truth, Variant};
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
    check_size(&light)?;
    let truth = Truth::of_volume(volume);
    let candidates =
        [("offset undone", undo_offset(volume, &light)), ("light of the nodes as it is", light.nodes.clone())];
    let mut tried = Vec::new();
    for (name, nodes) in candidates {
        let atlas = Atlas::encode(&light, &nodes)?;
        let error = truth.loss(|position, normal| atlas.irradiance(position, normal));
        tried.push((name, atlas, error));
    }
    let best = usize::from(tried[1].2.relative_rmse <= tried[0].2.relative_rmse);
    let (_, atlas, error) = &tried[best];
    let largest = atlas.texture.size.into_iter().max().unwrap_or(0);
    if largest > PROMISED_SIDE {
        light.notes.push(Note::new(
            "texture-size",
            format!(
                "the atlas is {largest} texels long; WebGL 2 promises {PROMISED_SIDE}, most devices have {MAX_SIDE}"
            ),
        ));
    }
    let variants = tried.iter().enumerate();
    Ok(Export {
        files: vec![
            File { name: settings.name.clone(), bytes: atlas.file(&light) },
            File { name: "gdibl-light-probe-grid.js".into(), bytes: LOADER.into() },
        ],
        report: Report {
            counts: light.grid.counts,
            bands_of_volume: volume.header().bands,
            bands: Some(ENGINE_BANDS),
            error: *error,
            variants: variants
                .map(|(i, (name, _, error))| Variant { name: (*name).into(), written: i == best, error: *error })
                .collect(),
            negative: truth.negative("the shader clamps at 0"),
            notes: light.notes,
        },
    })
}

fn check_size(light: &Light) -> Result<(), Error> {
    let [nx, ny, nz] = light.counts();
    let depth = BLOCKS * (nz + 2);
    if nx.max(ny).max(depth) <= MAX_SIDE {
        return Ok(());
    }
    Err(Error::Unsupported(format!(
        "{} nodes make an atlas of {nx} x {ny} x {depth}, over the {MAX_SIDE} of a 3-D texture: give fewer --counts",
        text(light.grid.counts)
    )))
}

/// Coefficients from which the shader, going half a spacing s along the normal, gets the light where it started:
/// `E'(p, n) = E(p - n s / 2, n)` at each node p, projected on the bands the engine has. Exact where E is linear in
/// place and of bands 0 and 1 in n.
///
/// The integral over n is a sum: Gauss and Legendre's six heights, twelve turns, exact up to degree 11.
fn undo_offset(volume: &Volume, light: &Light) -> Vec<RadianceSh> {
    const HEIGHTS: [(f64, f64); 3] = [
        (0.238_619_186_083_196_9, 0.467_913_934_572_691),
        (0.661_209_386_466_264_5, 0.360_761_573_048_138_6),
        (0.932_469_514_203_152, 0.171_324_492_379_170_3),
    ];
    const TURNS: usize = 12;
    let mut normals = Vec::new();
    for (height, weight) in HEIGHTS.iter().flat_map(|&(z, w)| [(z, w), (-z, w)]) {
        for turn in 0..TURNS {
            let (sine, cosine) = (TAU * (turn as f64 + 0.5) / TURNS as f64).sin_cos();
            let radius = (1.0 - height * height).sqrt();
            let normal = [radius * cosine, radius * sine, height].map(|v| v as f32);
            let mut functions = [0.0; MAX_COEFFICIENTS];
            basis(ENGINE_BANDS, normal, &mut functions);
            normals.push((normal, weight * TAU / TURNS as f64, functions));
        }
    }
    let spacing = light.grid.spacing();
    let at = |node: usize| {
        let place = light.grid.node_position(node);
        let mut sums = [[0.0_f64; 3]; 9];
        for (normal, weight, functions) in &normals {
            let start = array::from_fn(|k| place[k] - 0.5 * spacing[k] * f64::from(normal[k]));
            let irradiance = volume.sample_f64(start, *normal).sh.convolve().evaluate(*normal);
            for (sum, function) in sums.iter_mut().zip(functions) {
                for (sum, e) in sum.iter_mut().zip(irradiance) {
                    *sum += weight * f64::from(*function) * f64::from(e);
                }
            }
        }
        let mut sh = RadianceSh::zero(ENGINE_BANDS);
        for (i, (coefficient, sum)) in sh.coefficients.iter_mut().zip(sums).enumerate() {
            *coefficient = sum.map(|e| (e / f64::from(COSINE[band_of(i)])) as f32);
        }
        sh
    };
    (0..light.nodes.len()).map(at).collect()
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
    fn encode(light: &Light, nodes: &[RadianceSh]) -> Result<Atlas, Error> {
        let counts = light.counts();
        let [nx, ny, nz] = counts;
        let size = [nx, ny, BLOCKS * (nz + 2)];
        let values = nodes.iter().flat_map(|sh| sh.coefficients[..9].as_flattened());
        let largest = values.fold(0.0, |largest: f32, value| largest.max(value.abs()));
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
                for node in &nodes[nx * ny * z..nx * ny * (z + 1)] {
                    let values = node.coefficients[..9].as_flattened();
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

    /// E: `getLightProbeGridIrradiance`, and 0 where `isInsideLightProbeGrid` finds no grid.
    fn irradiance(&self, position: [f64; 3], normal: [f32; 3]) -> [f64; 3] {
        let res = self.counts.map(|n| n as f64);
        let range: [f64; 3] = array::from_fn(|k| self.max[k] - self.min[k]);
        let spacing: [f64; 3] = array::from_fn(|k| range[k] / res[k]);
        let place: [f64; 3] = array::from_fn(|k| position[k] + f64::from(normal[k]) * spacing[k] * 0.5);
        let margin = 0.01;
        if (0..3).any(|k| place[k] < self.min[k] - margin * spacing[k] || place[k] > self.max[k] + margin * spacing[k])
        {
            return [0.0; 3];
        }
        let uvw: [f64; 3] =
            array::from_fn(|k| ((place[k] - self.min[k]) / range[k]).max(0.5 / res[k]).min(1.0 - 0.5 / res[k]));
        let padded = res[2] + 2.0;
        let depth = BLOCKS as f64 * padded;
        let base = uvw[2] * res[2] + 1.0;
        let blocks: [[f64; 4]; BLOCKS] =
            array::from_fn(|t| self.texture.sample([uvw[0], uvw[1], (base + t as f64 * padded) / depth]));
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
        array::from_fn(|c| (0..9).map(|i| values[3 * i + c] * factors[i]).sum::<f64>().max(0.0))
    }
}
