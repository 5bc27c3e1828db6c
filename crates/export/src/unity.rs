//! Unity's light probes: JSON of positions and `SphericalHarmonicsL2`, and an editor script that imports them.
//!
//! Unity is left-handed, Y up. As its glTF importers do, x changes sign: of positions, and of the coefficients odd in x
//! (3, 4, 7). A coefficient is `A_l / π · L_lm` times the constant of its basis function, so that
//! ```text
//! (c0 - c6) + c1 y + c2 z + c3 x + c4 xy + c5 yz + 3 c6 z² + c7 xz + c8 (x² - y²) = E/π
//! ```
//! which the shader multiplies by the surface's colour.
//!
//! Unity makes its own tetrahedra between probes, by Delaunay's rule, which on a regular grid leaves several choices; the
//! error is measured with six per cell, one of them.
//!
//! Based on: Unity 6 documentation, `SphericalHarmonicsL2`, `LightProbes.bakedProbes`; Unity Graphics,
//! `SphericalHarmonics.cs` (`kNormalizationConstants`), `EntityLighting.hlsl` (`SampleSH9`), `GlobalIllumination.hlsl`
//! (`SampleSH`, which clamps at 0).

use serde::Serialize;
use std::f64::consts::PI;

use gdibl_runtime::sh::{COSINE, band_of};
use gdibl_runtime::{Grid, RadianceSh, Volume};

use crate::light::{Least, Light, text};
use crate::loss::Truth;
use crate::tetrahedra::{MAX_PROBES, locate};
use crate::{Error, Export, File, Note, Report, Settings};

const IMPORTER: &str = include_str!("GdiblImporter.cs");

/// Constants of the basis functions as polynomials.
const POLYNOMIAL: [f64; 9] = [
    0.282_094_791_773_878_1,
    0.488_602_511_902_919_9,
    0.488_602_511_902_919_9,
    0.488_602_511_902_919_9,
    1.092_548_430_592_079_2,
    1.092_548_430_592_079_2,
    0.315_391_565_252_520_05,
    1.092_548_430_592_079_2,
    0.546_274_215_296_039_6,
];

/// Coefficients that change sign with x.
const ODD_IN_X: [usize; 3] = [3, 4, 7];

/// As `JsonUtility` reads it: flat arrays.
#[derive(Serialize)]
struct Probes {
    format: &'static str,
    version: u32,
    /// Per axis.
    counts: [u32; 3],
    /// x, y, z of each, metres, Unity's axes.
    positions: Vec<f32>,
    /// 27 of each: `SphericalHarmonicsL2[channel, coefficient]`, red's nine first.
    coefficients: Vec<f32>,
}

pub(crate) fn export(volume: &Volume, settings: &Settings) -> Result<Export, Error> {
    let mut light = Light::of_volume(volume, settings.counts, Least::Two)?.truncated();
    if light.nodes.len() > MAX_PROBES {
        return Err(Error::Unsupported(format!(
            "{} are {} probes, and {MAX_PROBES} are as many as Unity is given here: give fewer --counts",
            text(light.grid.counts),
            light.nodes.len()
        )));
    }
    let probes = encode(&light);
    let truth = Truth::of_volume(volume);
    let error = truth.loss(|position, normal| irradiance(&probes, &light.grid, position, normal));
    light.notes.push(Note::new(
        "per-object",
        "Unity looks light up once per object; the error is that of a small object, with tetrahedra of six per cell",
    ));
    Ok(Export {
        files: vec![
            File { name: settings.name.clone(), bytes: serde_json::to_vec(&probes).expect("plain data") },
            File { name: "GdiblImporter.cs".into(), bytes: IMPORTER.into() },
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

fn encode(light: &Light) -> Probes {
    let positions = (0..light.nodes.len()).flat_map(|i| {
        let [x, y, z] = light.grid.node_position(i);
        [-x, y, z].map(|v| v as f32)
    });
    Probes {
        format: "gdibl light probes",
        version: 1,
        counts: light.grid.counts,
        positions: positions.collect(),
        coefficients: light.nodes.iter().flat_map(coefficients).collect(),
    }
}

fn coefficients(radiance: &RadianceSh) -> [f32; 27] {
    std::array::from_fn(|place| {
        let (channel, i) = (place / 9, place % 9);
        let sign = if ODD_IN_X.contains(&i) { -1.0 } else { 1.0 };
        let value = f64::from(radiance.coefficients[i][channel]);
        (sign * f64::from(COSINE[band_of(i)]) / PI * POLYNOMIAL[i] * value) as f32
    })
}

/// E at a place in glTF's axes: the polynomial at the tetrahedron's corners, times π, clamped as the shader does.
fn irradiance(probes: &Probes, grid: &Grid, position: [f64; 3], normal: [f32; 3]) -> [f64; 3] {
    let (nodes, weights) = locate(grid, position);
    let [x, y, z] = normal.map(f64::from);
    let x = -x;
    let terms = [1.0, y, z, x, x * y, y * z, 3.0 * z * z - 1.0, x * z, x * x - y * y];
    std::array::from_fn(|channel| {
        let at = |node: u32| -> f64 {
            let first = 27 * node as usize + 9 * channel;
            probes.coefficients[first..first + 9].iter().zip(terms).map(|(&c, term)| f64::from(c) * term).sum()
        };
        PI * nodes.iter().zip(weights).map(|(&node, weight)| weight * at(node)).sum::<f64>().max(0.0)
    })
}
