//! L_lm(x) = ∫ L(x,ω) Y_lm(ω) dω, estimated at one node.
//!
//! Estimator: 1/N Σ L(x,ω_i) Y_lm(ω_i) / p(ω_i), the ω_i split into independent replicates of a randomised
//! low-discrepancy sequence.  p mixes the uniform density with one that follows what is bright (see
//! [`Guide`](crate::radiance::Guide)). With w = 1/(4π p): 4π/N Σ w_i L(x,ω_i) Y_lm(ω_i). The spread of the replicates is the standard
//! error. Accumulated in f64: a sun of 1e9 beside a shadow of 1e-6 keeps its digits.
//!
//! A constant is taken out of the noise: B_lm = 4π/N Σ w_i Y_lm(ω_i) is known to be √4π δ_l0, so what it is off by
//! tells what L_lm is off by. Control variate (Owen, "Monte Carlo theory, methods and examples", 2013, §8.9):
//! L_lm - β (B_lm - √4π δ_l0), one β per channel, the regression of L_lm on B_lm over replicates and coefficients. Under
//! constant light β is that light, and E = πL is exact; without it E was off by up to 2e-3 at 4096 samples.

use gdibl_runtime::sh;
use glam::Vec3;
use std::f64::consts::PI;

use super::directions::DirectionMap;
use crate::Interrupted;
use crate::radiance::{PathContext, Radiance};
use crate::sampling::{Sampler, Stream, fibonacci_sphere};

/// Independent scrambles per node. 16: the standard error is itself known to 18 %.
pub const REPLICATES: u32 = 16;
/// Directions in which `relative_error` looks at E.
const ERROR_DIRECTIONS: usize = 26;

/// Sums of L·Y of one replicate.
pub type Moments = [[f64; 3]; sh::MAX_COEFFICIENTS];

/// What one node came to.
#[derive(Debug, Clone)]
pub struct NodeEstimate {
    /// Radiance coefficients, linear RGB.
    pub sh: Moments,
    /// One standard error of E, root mean square over 26 directions and RGB. Infinite with too few replicates
    /// to tell: one, or for L0 three.
    pub standard_error: f64,
    /// Root mean square of E over the same.
    pub rms_irradiance: f64,
    /// Share of the sphere, 0..=1, that was covered.
    pub coverage: f64,
    /// What clamping took: ∫ L dω, summed over R, G and B.
    pub clamped: f64,
    /// Share of the samples that first met the back of a triangle, 0..=1.
    pub backs: f64,
}

/// Names the random points of one node.
#[derive(Debug, Clone, Copy)]
pub struct Sequence {
    /// Sobol or random.
    pub sampler: Sampler,
    /// The bake's seed.
    pub seed: u64,
    /// Index of the node.
    pub node: u64,
}

impl Sequence {
    fn replicate(&self, replicate: u32) -> Stream {
        Stream::new(self.sampler, self.seed, self.node, replicate)
    }
}

/// Memory and tables that one worker reuses from node to node.
#[derive(Debug)]
pub struct Integrator {
    bands: u32,
    /// Most that a channel of a sample's radiance may be.
    clamp: f32,
    clamped: f64,
    /// `irradiance[k][i]`: what coefficient i adds to E in direction k.
    irradiance: Vec<[f64; sh::MAX_COEFFICIENTS]>,
    moments: Vec<Moments>,
    /// Σ w Y of each replicate: the moments of a light of 1.
    controls: Vec<[f64; sh::MAX_COEFFICIENTS]>,
    map: DirectionMap,
    /// (replicate, sample, uncovered share) of every direction that is not fully covered.
    uncovered: Vec<(u32, u32, f32)>,
}

impl Integrator {
    /// For volumes up to band `bands` (0..=4); no channel of a sample's radiance exceeds `clamp` (infinity: as it is).
    pub fn new(bands: u32, clamp: f32) -> Self {
        let irradiance = fibonacci_sphere(ERROR_DIRECTIONS).into_iter().map(|direction| {
            let mut basis = [0.0; sh::MAX_COEFFICIENTS];
            sh::basis(bands, direction.to_array(), &mut basis);
            let mut row = [0.0; sh::MAX_COEFFICIENTS];
            for (i, value) in row.iter_mut().enumerate().take(sh::coefficient_count(bands)) {
                let band = sh::band_of(i);
                *value = f64::from(sh::COSINE[band]) * f64::from(basis[i]);
            }
            row
        });
        Integrator {
            bands,
            clamp,
            clamped: 0.0,
            irradiance: irradiance.collect(),
            moments: Vec::new(),
            controls: Vec::new(),
            map: DirectionMap::default(),
            uncovered: Vec::new(),
        }
    }

    /// Samples until `enough` says so. `enough(samples so far, estimate)` returns the total wanted next; when that
    /// is no more than there are, the estimate is returned. It is first asked with 0 samples and no estimate; who
    /// wants a second round starts with at least [`REPLICATES`].
    ///
    /// `propose(point)` is a direction for a point of the unit square, and w = 1/(4π p) of it.
    /// `radiance(direction, context)` is L(x, ω), or `None` to give up at once. `known` is light whose coefficients are
    /// known without sampling, and are added. `rays` grows by the rays traced.
    pub fn integrate(
        &mut self,
        sequence: Sequence,
        propose: impl Fn([f32; 2]) -> (Vec3, f32),
        known: &Moments,
        rays: &mut u64,
        radiance: impl Fn(Vec3, &mut PathContext) -> Option<Radiance>,
        mut enough: impl FnMut(u64, Option<&NodeEstimate>) -> u64,
    ) -> Result<NodeEstimate, Interrupted> {
        let count = sh::coefficient_count(self.bands);
        self.map.clear();
        self.uncovered.clear();
        self.moments.clear();
        self.controls.clear();
        self.clamped = 0.0;
        let mut context = PathContext::new(sequence.replicate(0));
        let mut estimate = None;
        let mut done = 0u64;
        loop {
            let target = enough(done, estimate.as_ref());
            if target <= done {
                *rays += context.rays;
                return Ok(estimate.expect("at least one sample"));
            }
            let replicates = u64::from(REPLICATES).min(target) as u32;
            self.moments.resize(replicates as usize, [[0.0; 3]; sh::MAX_COEFFICIENTS]);
            self.controls.resize(replicates as usize, [0.0; sh::MAX_COEFFICIENTS]);
            for replicate in 0..replicates {
                context.stream = sequence.replicate(replicate);
                let range = share(done, replicates, replicate)..share(target, replicates, replicate);
                let moments = &mut self.moments[replicate as usize];
                let control = &mut self.controls[replicate as usize];
                let mut basis = [0.0f32; sh::MAX_COEFFICIENTS];
                for sample in range {
                    context.sample = sample;
                    let (direction, weight) = propose(context.point(0));
                    if weight == 0.0 {
                        continue;
                    }
                    let mut arriving = radiance(direction, &mut context).ok_or(Interrupted)?;
                    if arriving.value.max_element() > self.clamp {
                        let kept = arriving.value * (self.clamp / arriving.value.max_element());
                        self.clamped += f64::from((arriving.value - kept).element_sum() * weight);
                        arriving.value = kept;
                    }
                    self.map.add(direction, arriving.value * weight, arriving.coverage * weight);
                    if arriving.coverage < 1.0 {
                        self.uncovered.push((replicate, sample, 1.0 - arriving.coverage));
                    }
                    sh::basis(self.bands, direction.to_array(), &mut basis);
                    accumulate(&mut moments[..count], &basis, arriving.value, weight);
                    for (sum, &y) in control[..count].iter_mut().zip(&basis) {
                        *sum += f64::from(weight) * f64::from(y);
                    }
                }
            }
            done = target;
            let backs = context.backs as f64 / done as f64;
            estimate = Some(NodeEstimate { backs, ..self.estimate(sequence, &propose, known, done) });
        }
    }

    /// Fills what is uncovered, and sums up.
    fn estimate(
        &mut self,
        sequence: Sequence,
        propose: &impl Fn([f32; 2]) -> (Vec3, f32),
        known: &Moments,
        samples: u64,
    ) -> NodeEstimate {
        let count = sh::coefficient_count(self.bands);
        let mut uncovered = 0.0;
        let mut any_covered = true;
        let mut filled = None;
        if !self.uncovered.is_empty() {
            let mut map = self.map.clone();
            any_covered = map.fill();
            let mut moments = self.moments.clone();
            let mut basis = [0.0f32; sh::MAX_COEFFICIENTS];
            for &(replicate, sample, share) in &self.uncovered {
                let (direction, weight) = propose(sequence.replicate(replicate).point(sample, 0));
                sh::basis(self.bands, direction.to_array(), &mut basis);
                accumulate(&mut moments[replicate as usize][..count], &basis, map.radiance(direction), weight * share);
                uncovered += f64::from(weight * share);
            }
            filled = Some(moments);
        }
        // Each replicate's own estimate of L_lm and of B_lm, and those of all together.
        let sums = filled.as_ref().unwrap_or(&self.moments);
        let replicates = sums.len() as u32;
        let own = |replicate: usize| 4.0 * PI / f64::from(share(samples, replicates, replicate as u32));
        let mut estimates: Vec<Moments> =
            sums.iter().enumerate().map(|(i, m)| m.map(|rgb| rgb.map(|v| v * own(i)))).collect();
        let controls: Vec<_> = self.controls.iter().enumerate().map(|(i, b)| b.map(|v| v * own(i))).collect();
        let mut mean = [[0.0; 3]; sh::MAX_COEFFICIENTS];
        let mut control_mean = [0.0; sh::MAX_COEFFICIENTS];
        for (moments, control) in sums.iter().zip(&self.controls) {
            for i in 0..count {
                for channel in 0..3 {
                    mean[i][channel] += moments[i][channel] * 4.0 * PI / samples as f64;
                }
                control_mean[i] += control[i] * 4.0 * PI / samples as f64;
            }
        }
        let share_covered = 1.0 - uncovered / (control_mean[0] * samples as f64 / (4.0 * PI * f64::from(sh::Y00)));

        let slopes = control_slopes(&estimates, &mean, &controls, &control_mean, count);
        let light = slopes.unwrap_or_default();
        for (estimate, control) in estimates.iter_mut().zip(&controls).chain([(&mut mean, &control_mean)]) {
            for i in 0..count {
                let unit = if i == 0 { (4.0 * PI).sqrt() } else { 0.0 };
                for channel in 0..3 {
                    estimate[i][channel] += known[i][channel] - light[channel] * (control[i] - unit);
                }
            }
        }
        // E of every replicate in every direction; their variance over the mean's.
        let (mut variance, mut square) = (0.0, 0.0);
        for row in &self.irradiance {
            for channel in 0..3 {
                let irradiance = |m: &Moments| row[..count].iter().zip(m).map(|(a, m)| a * m[channel]).sum::<f64>();
                let of_all = irradiance(&mean);
                square += of_all * of_all;
                for replicate in &estimates {
                    let difference = irradiance(replicate) - of_all;
                    variance += difference * difference;
                }
            }
        }
        let values = (3 * ERROR_DIRECTIONS) as f64;
        // A slope takes one degree of freedom of its channel, and its own error costs as much again.
        let taken = if slopes.is_some() { 2.0 / count as f64 } else { 0.0 };
        let freedom = f64::from(replicates) - 1.0 - taken;
        NodeEstimate {
            sh: mean,
            standard_error: if freedom > 0.0 {
                (variance / freedom / f64::from(replicates) / values).sqrt()
            } else {
                f64::INFINITY
            },
            rms_irradiance: (square / values).sqrt(),
            backs: 0.0,
            clamped: self.clamped * 4.0 * PI / samples as f64,
            coverage: if any_covered { share_covered.clamp(f64::MIN_POSITIVE, 1.0) } else { 0.0 },
        }
    }
}

/// β of each channel: the slope of L_lm over B_lm among replicates, coefficients weighted as they count in E.
/// `None` where there is nothing to learn from: one replicate, or all agree on B (L0 alone, uniform directions).
fn control_slopes(
    estimates: &[Moments],
    mean: &Moments,
    controls: &[[f64; sh::MAX_COEFFICIENTS]],
    control_mean: &[f64; sh::MAX_COEFFICIENTS],
    count: usize,
) -> Option<[f64; 3]> {
    let (mut together, mut alone) = ([0.0; 3], 0.0);
    for (estimate, control) in estimates.iter().zip(controls) {
        for i in 0..count {
            let cosine = f64::from(sh::COSINE[sh::band_of(i)]);
            let off = (control[i] - control_mean[i]) * cosine * cosine;
            alone += off * (control[i] - control_mean[i]);
            for channel in 0..3 {
                together[channel] += off * (estimate[i][channel] - mean[i][channel]);
            }
        }
    }
    // B is about 1: less than this is rounding.
    (alone > 1e-20).then(|| together.map(|sum| sum / alone))
}

#[inline]
fn accumulate(moments: &mut [[f64; 3]], basis: &[f32], value: Vec3, weight: f32) {
    let value = value.as_dvec3() * f64::from(weight);
    for (sum, &y) in moments.iter_mut().zip(basis) {
        let y = f64::from(y);
        sum[0] += value.x * y;
        sum[1] += value.y * y;
        sum[2] += value.z * y;
    }
}

/// How many of `samples` fall to a replicate: as even as can be, the first ones take the rest.
pub fn share(samples: u64, replicates: u32, replicate: u32) -> u32 {
    let (samples, replicates) = (samples as u32, u64::from(replicates) as u32);
    samples / replicates + u32::from(replicate < samples % replicates)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::uniform_sphere;

    const NOTHING: Moments = [[0.0; 3]; sh::MAX_COEFFICIENTS];

    fn uniform(point: [f32; 2]) -> (Vec3, f32) {
        (uniform_sphere(point), 1.0)
    }

    /// Integrates with uniform directions and no interruption; every light here is whole.
    fn integrate(
        bands: u32,
        sequence: Sequence,
        light: impl Fn(Vec3) -> Radiance,
        enough: impl FnMut(u64, Option<&NodeEstimate>) -> u64,
    ) -> NodeEstimate {
        let mut rays = 0;
        let mut integrator = Integrator::new(bands, f32::INFINITY);
        integrator.integrate(sequence, uniform, &NOTHING, &mut rays, |d, _| Some(light(d)), enough).unwrap()
    }

    fn sobol(seed: u64, node: u64) -> Sequence {
        Sequence { sampler: Sampler::Sobol, seed, node }
    }

    fn fixed(samples: u64) -> impl FnMut(u64, Option<&NodeEstimate>) -> u64 {
        move |_, _| samples
    }

    #[test]
    fn constant_light_gives_pi_l_and_no_error() {
        for bands in 0..=4 {
            let light = |_| Radiance::covered(Vec3::new(1.0, 2.0, 1e6));
            let estimate = integrate(bands, sobol(0, 0), light, fixed(4096));
            let sqrt_4_pi = (4.0 * PI).sqrt();
            assert!((estimate.sh[0][0] / sqrt_4_pi - 1.0).abs() < 1e-6);
            assert!((estimate.sh[0][2] / sqrt_4_pi - 1e6).abs() < 1.0);
            assert!(estimate.sh[1..].iter().all(|rgb| rgb[0].abs() < 1e-6), "{:?}", estimate.sh);
            assert!(estimate.standard_error / estimate.rms_irradiance < 1e-6);
            assert_eq!(estimate.coverage, 1.0);
        }
    }

    #[test]
    fn standard_error_covers_the_truth_over_nodes() {
        // L = max(0, z)² has ∫ L Y_00 = 2π/3 · Y_00; 400 nodes of 64 random samples. z = error/se follows Student's
        // t with 15 degrees: 95 % within 2.131. Of 400, 365 to 392 with a false-alarm rate of 1e-3.
        let mut inside = 0;
        for node in 0..400 {
            let sequence = Sequence { sampler: Sampler::Random, seed: 9, node };
            let light = |d: Vec3| Radiance::covered(Vec3::splat(d.z.max(0.0).powi(2)));
            let estimate = integrate(0, sequence, light, fixed(64));
            let truth = 2.0 * PI / 3.0 * 0.282_094_8;
            // With L0 alone, E = π Y_00 L_00 in every direction.
            let error = (estimate.sh[0][0] - truth) * PI * 0.282_094_8;
            inside += u32::from(error.abs() < 2.131 * estimate.standard_error);
        }
        assert!((365..=392).contains(&inside), "{inside} of 400");
    }

    #[test]
    fn rounds_continue_the_same_sequence() {
        let light = |d: Vec3| Radiance::covered(Vec3::splat(d.y.max(0.1)));
        let whole = integrate(2, sobol(3, 5), light, fixed(4096));
        let rounds = integrate(2, sobol(3, 5), light, |done, _| (done * 2).clamp(256, 4096));
        for (a, b) in whole.sh.iter().zip(&rounds.sh) {
            assert!((a[0] - b[0]).abs() < 1e-12);
        }
    }

    #[test]
    fn uncovered_directions_are_filled_and_counted() {
        // A third of the sphere is uncovered: the cap with cosθ > 1/3.
        let light = |d: Vec3| if d.y > 1.0 / 3.0 { Radiance::UNCOVERED } else { Radiance::covered(Vec3::ONE) };
        let estimate = integrate(2, sobol(0, 0), light, fixed(4096));
        assert!((estimate.coverage - 2.0 / 3.0).abs() < 1e-3, "{}", estimate.coverage);
        assert!((estimate.sh[0][0] / (4.0 * PI).sqrt() - 1.0).abs() < 1e-5);
    }

    #[test]
    fn clamped_light_is_counted() {
        // An eighth of the sphere is brighter than allowed; what is cut is 9 in one channel, and in the others in proportion.
        let light = |d: Vec3, _: &mut PathContext| {
            Some(Radiance::covered(if d.y > 0.75 { Vec3::new(10.0, 5.0, 0.0) } else { Vec3::ONE }))
        };
        let mut integrator = Integrator::new(0, 1.0);
        let estimate = integrator.integrate(sobol(0, 0), uniform, &NOTHING, &mut 0, light, fixed(4096)).unwrap();
        assert!((estimate.clamped / (0.125 * 4.0 * PI) - 13.5).abs() < 1e-4, "{}", estimate.clamped);
        assert!((estimate.sh[0][0] / (4.0 * PI).sqrt() - 1.0).abs() < 1e-5, "{:?}", estimate.sh[0]);
    }

    #[test]
    fn known_light_is_added_and_costs_no_error() {
        let mut known = NOTHING;
        known[0] = [3.0, 2.0, 1.0];
        let mut integrator = Integrator::new(0, f32::INFINITY);
        let light = |_: Vec3, _: &mut PathContext| Some(Radiance::covered(Vec3::ONE));
        let estimate = integrator.integrate(sobol(0, 0), uniform, &known, &mut 0, light, fixed(256)).unwrap();
        assert!((estimate.sh[0][0] - (4.0 * PI).sqrt() - 3.0).abs() < 1e-6);
        assert!(estimate.standard_error < 1e-6);
    }

    #[test]
    fn one_sample_has_no_standard_error() {
        let estimate = integrate(2, sobol(0, 0), |_| Radiance::covered(Vec3::ONE), fixed(1));
        assert!(estimate.standard_error.is_infinite());
        assert!(estimate.sh[0][0].is_finite());
    }

    #[test]
    fn interrupted_node_gives_up_at_the_next_ray() {
        // It went on to the last of its samples, and kept each as uncovered: 2^31 of them took the machine's memory.
        let calls = std::cell::Cell::new(0);
        let light = |_, _: &mut PathContext| {
            calls.set(calls.get() + 1);
            (calls.get() < 100).then_some(Radiance::UNCOVERED)
        };
        let mut rays = 0;
        let mut integrator = Integrator::new(2, f32::INFINITY);
        let found = integrator.integrate(sobol(0, 0), uniform, &NOTHING, &mut rays, light, fixed(1 << 31));
        assert!(found.is_err());
        assert_eq!(calls.get(), 100);
    }
}
