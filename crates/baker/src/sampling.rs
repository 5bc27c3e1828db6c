//! Points in the unit square and directions on the sphere, as functions of (seed, node, replicate, sample).
//!
//! Based on: Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4), 2020, by the crate `sobol_burley`. Every
//! replicate of every node is its own scramble of the Sobol sequence: independent of the others, so that their
//! spread is an honest standard error (Owen, "Monte Carlo theory, methods and examples", 2013, ch. 17).

use glam::Vec3;

use crate::angle::sine_cosine;

/// Where sample points come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sampler {
    /// Owen-scrambled Sobol points.
    #[default]
    Sobol,
    /// Independent random points: the report's, kept as a baseline.
    Random,
}

/// One stream of points in as many dimensions as a path needs.
#[derive(Debug, Clone, Copy)]
pub struct Stream {
    sampler: Sampler,
    scramble: u32,
}

/// Points of one sobol_burley sequence; longer streams go on under another scramble.
const SEQUENCE: u32 = 1 << 16;

impl Stream {
    /// The stream of one replicate of one node.
    pub fn new(sampler: Sampler, seed: u64, node: u64, replicate: u32) -> Stream {
        let mixed = mix(mix(mix(seed) ^ node) ^ u64::from(replicate));
        Stream { sampler, scramble: (mixed >> 32) as u32 }
    }

    /// Point `sample` of a pair of dimensions, each in 0..1. Pair 0 chooses the direction that leaves the node; later pairs
    /// belong to later bounces. Pairs are independent of each other.
    pub fn point(&self, sample: u32, pair: u32) -> [f32; 2] {
        self.points(sample, pair)[0]
    }

    /// The same and a second point, for two choices at once: all four numbers together are well distributed. No more time than
    /// one takes.
    pub fn points(&self, sample: u32, pair: u32) -> [[f32; 2]; 2] {
        match self.sampler {
            Sampler::Sobol => {
                // Pairs from 2^16 on, of walks of that length, are another stream's.
                let scramble =
                    mix(u64::from(self.scramble) << 32 ^ u64::from(pair) << 16 | u64::from(sample / SEQUENCE));
                let [x, y, z, w] = sobol_burley::sample_4d(sample % SEQUENCE, 0, scramble as u32);
                [[x, y], [z, w]]
            }
            Sampler::Random => {
                let bits = self.bits(sample, pair);
                [bits, mix(bits)]
                    .map(|bits| [bits >> 40, (bits >> 16) & 0xff_ffff].map(|b| b as f32 / (1 << 24) as f32))
            }
        }
    }

    /// An independent random number in 0..1 of its own, whatever the sampler.
    pub fn random(&self, sample: u32, pair: u32) -> f32 {
        // Beside the pairs, of which there are fewer.
        (self.bits(sample, pair | 1 << 31) >> 40) as f32 / (1 << 24) as f32
    }

    fn bits(&self, sample: u32, pair: u32) -> u64 {
        mix(mix(u64::from(self.scramble) << 32 | u64::from(pair)) ^ u64::from(sample))
    }
}

/// Numbers that streams have as their `node`, by who draws from them: nodes have their own index, the others a high bit, so
/// that no two share random numbers.
pub(crate) mod streams {
    /// Texels of what scene geometry does to the environment.
    pub const TEXELS: u64 = 1 << 63;
    /// The same, for those who stand near.
    pub const NEAR_TEXELS: u64 = 3 << 62;
    /// Pixels of captured probes.
    pub const PROBES: u64 = 1 << 62;
    /// Places where a probe could stand.
    pub const CANDIDATES: u64 = 3 << 61;
    /// Pixels of pictures.
    pub const PICTURES: u64 = 1 << 61;
    /// Places whose irradiance is gathered.
    pub const SURFACES: u64 = 1 << 60;
    /// Places, and the rays that leave them, of an energy balance.
    pub const ENERGY: u64 = 1 << 59;
    /// Places on surfaces that are asked whether a probe sees them.
    pub const COVERAGE: u64 = 1 << 58;
    /// Rays that tell whether chance finds what glows.
    pub const GLOW: u64 = 1 << 57;
    /// Walks that tell whether any surface takes light.
    pub const ENDLESS: u64 = 1 << 56;
    /// Points where what probes show and what paths find are compared, and the rays that find them.
    pub const AGREEMENT: u64 = 1 << 55;
}

/// SplitMix64's finaliser (Steele, Lea, Flood, 2014): every input bit moves every output bit.
fn mix(value: u64) -> u64 {
    let mut z = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Uniform direction on the sphere: density 1/4π per steradian (Archimedes: area is height × angle).
pub fn uniform_sphere(point: [f32; 2]) -> Vec3 {
    // Height in f64: near the poles 1 - y² cancels.
    let y = 1.0 - 2.0 * f64::from(point[0]);
    let radius = (1.0 - y * y).max(0.0).sqrt() as f32;
    let (sin, cos) = sine_cosine(f64::from(point[1]));
    Vec3::new(radius * sin as f32, y as f32, radius * cos as f32)
}

/// Direction around unit `normal` with density cosθ/π (Malley: a disk, lifted).
pub fn cosine_hemisphere(normal: Vec3, point: [f32; 2]) -> Vec3 {
    let radius = point[0].sqrt();
    let (sin, cos) = sine_cosine(f64::from(point[1]));
    let (sin, cos) = (sin as f32, cos as f32);
    let (tangent, bitangent) = normal.any_orthonormal_pair();
    let direction = tangent * (radius * cos) + bitangent * (radius * sin) + normal * (1.0 - point[0]).max(0.0).sqrt();
    direction.normalize()
}

/// `count` directions spread evenly over the sphere: the spherical Fibonacci lattice (Swinbank and Purser, 2006).
/// The 26 directions of `relative_error` are these.
pub fn fibonacci_sphere(count: usize) -> Vec<Vec3> {
    let golden = (1.0 + 5f64.sqrt()) / 2.0;
    (0..count)
        .map(|i| {
            let y = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
            let angle = std::f64::consts::TAU * i as f64 / golden;
            let radius = (1.0 - y * y).sqrt();
            Vec3::new((radius * angle.sin()) as f32, y as f32, (radius * angle.cos()) as f32)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_unit_and_balanced() {
        for sampler in [Sampler::Sobol, Sampler::Random] {
            let stream = Stream::new(sampler, 1, 2, 3);
            let count = 1 << 17; // past one sequence
            let mut mean = glam::DVec3::ZERO;
            let mut squares = glam::DVec3::ZERO;
            for sample in 0..count {
                let direction = uniform_sphere(stream.point(sample, 0));
                assert!((direction.length() - 1.0).abs() < 1e-6);
                mean += direction.as_dvec3() / f64::from(count);
                squares += (direction * direction).as_dvec3() / f64::from(count);
            }
            // Random: 4.5 standard errors of 1/sqrt(3·2^17); false alarm under 1e-4.
            assert!(mean.length() < 8e-3, "{sampler:?} {mean}");
            assert!((squares - 1.0 / 3.0).length() < 8e-3, "{sampler:?} {squares}");
        }
    }

    #[test]
    fn cosine_hemisphere_integrates_cosine() {
        let stream = Stream::new(Sampler::Sobol, 0, 0, 0);
        let normal = Vec3::new(0.6, -0.8, 0.0);
        let count = 4096;
        // ∫ cosθ · cosθ/π dω = 2/3
        let mean: f64 = (0..count)
            .map(|i| f64::from(cosine_hemisphere(normal, stream.point(i, 1)).dot(normal)))
            .inspect(|cosine| assert!(*cosine >= 0.0))
            .sum::<f64>()
            / f64::from(count);
        assert!((mean - 2.0 / 3.0).abs() < 1e-4, "{mean}");
    }

    #[test]
    fn replicates_and_nodes_differ() {
        let first = |node, replicate| Stream::new(Sampler::Sobol, 7, node, replicate).point(0, 0);
        assert_ne!(first(0, 0), first(0, 1));
        assert_ne!(first(0, 0), first(1, 0));
        assert_eq!(first(5, 3), first(5, 3));
    }
}
