//! What an export loses: irradiance as the engine will show it, against the volume's own.
//!
//! At [`SAMPLES`] positions in the box, one normal each: positions from the R3 sequence (M. Roberts, "The Unreasonable
//! Effectiveness of Quasirandom Sequences", 2018), normals from a Fibonacci spiral. Both are functions of the index, so
//! that figures compare between exports and days. The truth is `max(E, 0)`: no surface reflects less than nothing.

use gdibl_runtime::Volume;
use serde::Serialize;

/// How many places are compared.
pub const SAMPLES: usize = 4096;

/// Error of irradiance over the [`SAMPLES`] places.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Loss {
    /// Root mean square difference over root mean square irradiance, all channels together.
    pub relative_rmse: f64,
    /// Mean difference over mean irradiance; above 0 the export is too bright.
    pub bias: f64,
    /// 95th percentile over the places of: length of the RGB difference over length of E, or over a tenth of its median
    /// where E is darker than that.
    pub p95: f64,
    /// The largest of these.
    pub max: f64,
}

/// Error of one way of writing.
#[derive(Clone, Debug, Serialize)]
pub struct Variant {
    /// What it is.
    pub name: String,
    /// Whether the main file is written so.
    pub written: bool,
    /// Its error.
    pub error: Loss,
}

/// Irradiance below zero: bands that ring.
#[derive(Clone, Debug, Serialize)]
pub struct Negative {
    /// The share of places where E of the volume is below 0 in some channel.
    pub share: f64,
    /// The most negative E found, over the root mean square of all; 0 if none is.
    pub least: f64,
    /// What the engine does with it.
    pub engine: &'static str,
}

/// Position `index`, in a box, metres.
pub fn sample_position(min: [f64; 3], max: [f64; 3], index: usize) -> [f64; 3] {
    // Powers of the inverse of the root of x⁴ = x + 1.
    const STEP: [f64; 3] = [0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_997_5];
    std::array::from_fn(|k| min[k] + (max[k] - min[k]) * (0.5 + STEP[k] * (index + 1) as f64).fract())
}

/// Normal `index`, unit length.
pub fn sample_normal(index: usize) -> [f32; 3] {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    // In another order than the positions, so that height and place have nothing to do with each other.
    let place = index * 1597 % SAMPLES;
    let y = 1.0 - (2 * place + 1) as f64 / SAMPLES as f64;
    let (sine, cosine) = (std::f64::consts::TAU * (place as f64 * GOLDEN).fract()).sin_cos();
    let radius = (1.0 - y * y).max(0.0).sqrt();
    [radius * cosine, y, radius * sine].map(|v| v as f32)
}

/// The volume's own irradiance at the places.
pub(crate) struct Truth {
    places: Vec<([f64; 3], [f32; 3])>,
    irradiance: Vec<[f64; 3]>,
    negative_share: f64,
    negative_least: f64,
}

impl Truth {
    /// At [`SAMPLES`] places in the volume's box.
    pub fn of_volume(volume: &Volume) -> Truth {
        let (min, max) = (volume.header().min, volume.header().max);
        Truth::at(volume, (0..SAMPLES).map(|i| (sample_position(min, max, i), sample_normal(i))).collect())
    }

    /// At the places given, of which there must be one.
    pub fn at(volume: &Volume, places: Vec<([f64; 3], [f32; 3])>) -> Truth {
        assert!(!places.is_empty(), "nothing to compare");
        let raw: Vec<[f64; 3]> = places
            .iter()
            .map(|&(position, normal)| {
                volume.sample_f64(position, normal).sh.convolve().evaluate(normal).map(f64::from)
            })
            .collect();
        let least = raw.iter().flatten().fold(0.0_f64, |least, &e| least.min(e));
        let negative = raw.iter().filter(|e| e.iter().any(|&e| e < 0.0)).count();
        let irradiance: Vec<[f64; 3]> = raw.iter().map(|e| e.map(|e| e.max(0.0))).collect();
        let rms = root_mean_square(&irradiance);
        Truth {
            negative_share: negative as f64 / places.len() as f64,
            negative_least: if rms > 0.0 { least / rms } else { 0.0 },
            places,
            irradiance,
        }
    }

    /// The error of what `decode(position, normal)` says E is.
    pub fn loss(&self, decode: impl Fn([f64; 3], [f32; 3]) -> [f64; 3]) -> Loss {
        let found = self.places.iter().map(|&(position, normal)| decode(position, normal));
        let differences: Vec<[f64; 3]> =
            found.zip(&self.irradiance).map(|(found, truth)| std::array::from_fn(|c| found[c] - truth[c])).collect();
        let length = |v: &[f64; 3]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
        let mut lengths: Vec<f64> = self.irradiance.iter().map(length).collect();
        let ordered = {
            let mut ordered = lengths.clone();
            ordered.sort_unstable_by(f64::total_cmp);
            ordered
        };
        let floor = 0.1 * ordered[ordered.len() / 2];
        lengths.iter_mut().for_each(|length| *length = length.max(floor));
        let mut relative: Vec<f64> =
            differences.iter().zip(&lengths).map(|(d, &truth)| ratio(length(d), truth)).collect();
        relative.sort_unstable_by(f64::total_cmp);
        let total = |all: &[[f64; 3]]| all.iter().flatten().sum::<f64>();
        Loss {
            relative_rmse: ratio(root_mean_square(&differences), root_mean_square(&self.irradiance)),
            bias: ratio(total(&differences), total(&self.irradiance)),
            p95: relative[(relative.len() * 95).div_ceil(100) - 1],
            max: relative[relative.len() - 1],
        }
    }

    /// What is below zero, and what the engine does with it.
    pub fn negative(&self, engine: &'static str) -> Negative {
        Negative { share: self.negative_share, least: self.negative_least, engine }
    }
}

/// 0 over 0 is 0: darkness exported as darkness.
fn ratio(difference: f64, of: f64) -> f64 {
    if difference == 0.0 { 0.0 } else { difference / of }
}

fn root_mean_square(values: &[[f64; 3]]) -> f64 {
    let sum: f64 = values.iter().flatten().map(|v| v * v).sum();
    (sum / (3 * values.len()) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_fill_box_and_sphere_evenly() {
        let (min, max) = ([-1.0, 2.0, 5.0], [1.0, 3.0, 5.0]);
        let mut octants = [0; 8];
        let mut mean = [0.0; 3];
        let mut second = [[0.0; 3]; 3];
        for i in 0..SAMPLES {
            let p = sample_position(min, max, i);
            assert!((0..3).all(|k| p[k] >= min[k] && p[k] <= max[k]), "{p:?}");
            let n = sample_normal(i).map(f64::from);
            assert!((n.iter().map(|v| v * v).sum::<f64>() - 1.0).abs() < 1e-6);
            octants[usize::from(p[0] > 0.0) + 2 * usize::from(p[1] > 2.5) + 4 * usize::from(n[1] > 0.0)] += 1;
            for k in 0..3 {
                mean[k] += n[k] / SAMPLES as f64;
                for j in 0..3 {
                    second[k][j] += n[k] * n[j] / SAMPLES as f64;
                }
            }
        }
        assert!(octants.iter().all(|&count| (count - 512_i32).abs() < 40), "{octants:?}");
        for k in 0..3 {
            assert!(mean[k].abs() < 1e-3, "{mean:?}");
            for j in 0..3 {
                let truth = if j == k { 1.0 / 3.0 } else { 0.0 };
                assert!((second[k][j] - truth).abs() < 1e-3, "{second:?}");
            }
        }
    }
}
