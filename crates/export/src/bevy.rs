//! Bevy's `IrradianceVolume`: a 3-D texture of ambient cubes as KTX2, and a JSON file that says where it goes.
//!
//! ```text
//! texture of nx × 2 ny × 3 nz texels      t = 0..ny        t = ny..2 ny
//!                          p = 0..nz       +x               -x
//!                          p = nz..2 nz    +y               -y
//!                          p = 2 nz..3 nz  +z               -z
//! ```
//! Voxel (x, y, z) of side S is texel (x, y + ny if S is negative, z + nz · axis). A texel holds E/π along S over
//! `intensity`, since the shader multiplies by the surface's colour without 1/π. Voxels are amid their cells: the box
//! reaches half a spacing beyond the volume's. In Bevy, unlike what its `irradiance_volume` documentation says, the
//! positive sides come first: the shader adds half the height where the normal is negative. Checked in Bevy itself by
//! `integrations/bevy`.
//!
//! Based on: Bevy 0.19, `bevy_pbr/src/light_probe/irradiance_volume.wgsl`, `light_probe.wgsl`.

use half::f16;
use serde::Serialize;
use std::f64::consts::PI;

use gdibl_runtime::{RadianceSh, Volume};

use crate::cube::{Cube, CubeFit, cube_of_axes};
use crate::ktx2;
use crate::light::{Least, Light, text};
use crate::loss::{Loss, Truth, Variant};
use crate::texture::Texture;
use crate::{Error, Export, File, Report, Settings, rgb9e5};

pub use crate::ktx2::Format;

/// The largest side of a 3-D texture that WebGPU promises.
const MAX_SIDE: u32 = 2048;

/// Where the texture goes: what an `IrradianceVolume` and its `Transform` want.
#[derive(Serialize)]
struct Sidecar<'a> {
    /// The texture of 32 bits per texel, and that of 64.
    rgb9e5: &'a str,
    rgba16f: &'a str,
    /// Voxels per axis.
    counts: [u32; 3],
    /// Brings texels to E/π in the units of the panoramas; where those are not in cd/m², times what one unit is in these.
    intensity: f32,
    /// Of the unit cube: metres.
    translation: [f32; 3],
    scale: [f32; 3],
    /// Rust, to be pasted.
    spawn: String,
}

/// The texture of a volume, by the better of two fits, and its place: for programs that draw it themselves.
///
/// # Errors
/// As [`crate::export`].
pub fn voxels(volume: &Volume, counts: Option<[u32; 3]>, format: Format) -> Result<Voxels, Error> {
    let [axes, squares] = fits(&light_of_volume(volume, counts)?, &Truth::of_volume(volume), format);
    Ok(if squares.error.relative_rmse < axes.error.relative_rmse { squares.voxels } else { axes.voxels })
}

pub(crate) fn export(volume: &Volume, settings: &Settings) -> Result<Export, Error> {
    let light = light_of_volume(volume, settings.counts)?;
    let truth = Truth::of_volume(volume);
    // Both fits in both formats; the better fit is written.
    let small = fits(&light, &truth, Format::Rgb9e5);
    let half = fits(&light, &truth, Format::Rgba16f);
    let best = usize::from(small[1].error.relative_rmse < small[0].error.relative_rmse);
    let half_name = beside(&settings.name, ".rgba16f.ktx2");
    let sidecar = &small[best].voxels.sidecar(&settings.name, &half_name);
    let files = vec![
        File { name: settings.name.clone(), bytes: small[best].voxels.ktx2() },
        File { name: half_name.clone(), bytes: half[best].voxels.ktx2() },
        File { name: beside(&settings.name, ".json"), bytes: serde_json::to_vec_pretty(sidecar).expect("plain data") },
    ];
    let variant = |fit: usize, of: &Fit, format: &str| Variant {
        name: format!("{}, {format}", of.name),
        written: fit == best,
        error: of.error,
    };
    let report = Report {
        counts: light.grid.counts,
        bands_of_volume: volume.header().bands,
        bands: None,
        error: small[best].error,
        variants: (0..2)
            .flat_map(|fit| [variant(fit, &small[fit], "RGB9E5"), variant(fit, &half[fit], "RGBA16F")])
            .collect(),
        negative: truth.negative("cannot be stored: sides are fitted with 0 as the lower bound"),
        notes: light.notes,
    };
    Ok(Export { files, report })
}

/// The light at the voxels, if a texture can hold as many.
fn light_of_volume(volume: &Volume, counts: Option<[u32; 3]>) -> Result<Light, Error> {
    let light = Light::of_volume(volume, counts, Least::One)?;
    let [nx, ny, nz] = light.grid.counts;
    if nx.max(ny.saturating_mul(2)).max(nz.saturating_mul(3)) > MAX_SIDE {
        return Err(Error::Unsupported(format!(
            "{} voxels make a texture of {nx} x {} x {}, over the {MAX_SIDE} of a 3-D texture: give fewer --counts",
            text(light.grid.counts),
            2 * u64::from(ny),
            3 * u64::from(nz)
        )));
    }
    Ok(light)
}

/// One way to fill a texture, and its error.
struct Fit {
    name: &'static str,
    voxels: Voxels,
    error: Loss,
}

/// Both ways.
fn fits(light: &Light, truth: &Truth, format: Format) -> [Fit; 2] {
    let squares = CubeFit::new();
    let fit = |name, cube: &dyn Fn(&RadianceSh) -> Cube| {
        let voxels = Voxels::encode(light, &light.nodes.iter().map(cube).collect::<Vec<Cube>>(), format);
        let error = truth.loss(|position, normal| voxels.irradiance(position, normal));
        Fit { name, voxels, error }
    };
    [
        fit("E along the axes", &|sh| cube_of_axes(&sh.convolve())),
        fit("least squares, no side below 0", &|sh| squares.fit(&sh.convolve())),
    ]
}

/// A texture of ambient cubes with its place in the world: what an `IrradianceVolume` and its `Transform` want.
pub struct Voxels {
    /// How a texel is written.
    pub format: Format,
    /// Voxels per axis.
    pub counts: [u32; 3],
    /// Texels per axis.
    pub size: [u32; 3],
    /// The texels, little-endian; x runs fastest, then y, then z.
    pub bytes: Vec<u8>,
    /// Brings texels to E/π in the units of the panoramas.
    pub intensity: f32,
    /// Centre of the box, metres.
    pub translation: [f64; 3],
    /// Size of the box, metres.
    pub scale: [f64; 3],
    /// As read back.
    texture: Texture,
}

impl Voxels {
    fn encode(light: &Light, cubes: &[Cube], format: Format) -> Voxels {
        let largest = cubes.iter().flatten().flatten().fold(0.0_f32, |largest, e| largest.max(*e)) / PI as f32;
        let intensity = intensity_for(largest);
        let [nx, ny, nz] = light.counts();
        let size = [nx, 2 * ny, 3 * nz];
        let mut texels = vec![[0.0; 4]; nx * 2 * ny * 3 * nz];
        for (node, cube) in cubes.iter().enumerate() {
            let (x, y, z) = (node % nx, node / nx % ny, node / nx / ny);
            for (side, rgb) in cube.iter().enumerate() {
                let (axis, negative) = (side / 2, side % 2);
                let [r, g, b] = rgb.map(|e| e / PI as f32 / intensity);
                texels[x + nx * (y + ny * negative + 2 * ny * (z + nz * axis))] = [r, g, b, 1.0];
            }
        }
        let mut bytes = Vec::new();
        for texel in &mut texels {
            *texel = match format {
                Format::Rgb9e5 => {
                    let bits = rgb9e5::encode([texel[0], texel[1], texel[2]]);
                    bytes.extend_from_slice(&bits.to_le_bytes());
                    let [r, g, b] = rgb9e5::decode(bits);
                    [r, g, b, 1.0]
                }
                Format::Rgba16f => texel.map(|v| {
                    let value = f16::from_f32(v);
                    bytes.extend_from_slice(&value.to_le_bytes());
                    value.to_f32()
                }),
            };
        }
        let (min, max) = light.cell_box();
        Voxels {
            format,
            counts: light.grid.counts,
            size: size.map(|n| n as u32),
            bytes,
            intensity,
            translation: std::array::from_fn(|k| 0.5 * min[k] + 0.5 * max[k]),
            scale: std::array::from_fn(|k| max[k] - min[k]),
            texture: Texture { size, texels },
        }
    }

    fn ktx2(&self) -> Vec<u8> {
        ktx2::write(self.format, self.size, &self.bytes)
    }

    /// E as the shader has it, `irradiance_volume_light` times π: at a position, metres, for a normal of unit length. 0
    /// outside the box.
    pub fn irradiance(&self, position: [f64; 3], normal: [f32; 3]) -> [f64; 3] {
        let unit: [f64; 3] = std::array::from_fn(|k| (position[k] - self.translation[k]) / self.scale[k]);
        // `light_probe_iterator_next`: outside the cube there is nothing.
        if unit.iter().any(|u| u.abs() > 0.5) {
            return [0.0; 3];
        }
        let atlas = self.texture.size.map(|n| n as f64);
        let resolution = [atlas[0], atlas[1] / 2.0, atlas[2] / 3.0];
        let stp: [f64; 3] =
            std::array::from_fn(|k| ((unit[k] + 0.5) * resolution[k]).max(0.5).min(resolution[k] - 0.5));
        let uvw: [f64; 3] = std::array::from_fn(|k| stp[k] / atlas[k]);
        let mut sum = [0.0; 3];
        for (axis, n) in normal.map(f64::from).into_iter().enumerate() {
            let negative = if n < 0.0 { 0.5 } else { 0.0 };
            let rgb = self.texture.sample([uvw[0], uvw[1] + negative, uvw[2] + axis as f64 / 3.0]);
            for c in 0..3 {
                sum[c] += rgb[c] * n * n * f64::from(self.intensity) * PI;
            }
        }
        sum
    }

    fn sidecar<'a>(&self, rgb9e5: &'a str, rgba16f: &'a str) -> Sidecar<'a> {
        let (translation, scale) = (self.translation.map(|v| v as f32), self.scale.map(|v| v as f32));
        let vector = |[x, y, z]: [f32; 3]| format!("Vec3::new({x:?}, {y:?}, {z:?})");
        let spawn = format!(
            "commands.spawn((LightProbe::default(), IrradianceVolume {{ voxels: asset_server.load({rgb9e5:?}), \
             intensity: {:?}, ..default() }}, Transform {{ translation: {}, scale: {}, ..default() }}));",
            self.intensity,
            vector(translation),
            vector(scale)
        );
        Sidecar { rgb9e5, rgba16f, counts: self.counts, intensity: self.intensity, translation, scale, spawn }
    }
}

/// 1 where texels fit both formats well; else the power of two that brings the largest to 1 to 2. RGB9E5 ends at 65 408
/// and has its nine bits from 2^-15 up, so that 2^-6 leaves a dark node nine stops.
fn intensity_for(largest: f32) -> f32 {
    if largest == 0.0 || (2.0_f32.powi(-6)..=60_000.0).contains(&largest) {
        return 1.0;
    }
    2.0_f32.powi(largest.log2().floor() as i32)
}

/// "room.ktx2" and ".json" give "room.json".
fn beside(name: &str, ending: &str) -> String {
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    let stem = if stem.is_empty() { name } else { stem };
    format!("{stem}{ending}")
}
