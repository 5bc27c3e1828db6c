//! Error of E over places: size, sign, and how much of it is noise.
//!
//! E is evaluated from the coefficients in 26 directions (or, where the truth is irradiance, at its one normal). Every
//! mean is over directions, then channels, then nodes, so that all nodes count alike. With d = E found - E of truth:
//!
//! ```text
//! relative RMSE = sqrt(mean d² / mean E²)          bias = mean d / mean E
//! noise²        = mean Var(E found) + Var(E)       systematic² = max(0, mean d² - noise²)
//! ```
//! The last one because noise and what is systematically wrong do not know of each other: their squares add up. Over N
//! nodes chance moves mean d² by noise² sqrt(2 / kN), k being how many independent numbers there are in E of a node; so
//! a small systematic share may be chance, and [`IrradianceError::systematic_by_chance`] says how small.

use gdibl_runtime::{RadianceSh, sh};
use serde::Serialize;

use crate::job::records::ErrorSummary;
use crate::sampling::fibonacci_sphere;

/// Normals in which E is compared.
const DIRECTIONS: usize = 26;

/// Error of E over a set of nodes. Shares, not percent. Where the truth is black and what was found is not, a share is
/// infinite.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct IrradianceError {
    /// Nodes compared.
    pub nodes: usize,
    /// Root of the mean square difference over that of the truth.
    pub relative_rmse: f64,
    /// Root of the mean square difference, in units of E.
    pub rmse: f64,
    /// Mean signed difference over the mean of the truth.
    pub bias: f64,
    /// Mean signed difference, in units of E.
    pub mean_difference: f64,
    /// The same of linear R, G, B, over the truth of that channel.
    pub channels: [ChannelError; 3],
    /// Band by band; empty where the truth is irradiance.
    pub bands: Vec<BandError>,
    /// What the standard errors of both sides make of it, over the RMS of the truth; `None` where one is not known.
    pub noise: Option<f64>,
    /// What noise does not explain, over the RMS of the truth; `None` where noise is not known.
    pub systematic: Option<f64>,
    /// What chance makes of `systematic` where nothing is: two standard deviations. Nodes count as independent, R, G and
    /// B as one.
    pub systematic_by_chance: Option<f64>,
    /// Per node: root mean square difference over the RMS of its own truth, or a tenth of the median of that if it is
    /// more: a black node does not divide by zero.
    pub per_node: ErrorSummary,
}

/// Error of one channel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ChannelError {
    /// Root of the mean square difference over that of the truth.
    pub relative_rmse: f64,
    /// Root of the mean square difference, in units of E.
    pub rmse: f64,
    /// Mean signed difference over the mean of the truth.
    pub bias: f64,
    /// Mean signed difference, in units of E.
    pub mean_difference: f64,
}

/// Error of one band: RMS of its difference over RMS of all bands of the truth, over the sphere and not 26 directions
/// (Parseval), so that the squares of all bands add up to that of the whole.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BandError {
    /// l.
    pub band: u32,
    /// Of E: 0 for band 3, which irradiance does not see.
    pub irradiance: f64,
    /// Of radiance.
    pub radiance: f64,
}

/// What is known of the light at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "few live at a time, and a box would take Copy from pairs")]
pub enum Light {
    /// From all directions.
    Radiance(RadianceSh),
    /// E of linear R, G, B on a surface.
    Irradiance {
        /// Unit normal.
        normal: [f32; 3],
        /// What falls on it.
        irradiance: [f32; 3],
    },
}

/// One place, seen by both sides. The bands of the lower of both count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// What is judged.
    pub found: RadianceSh,
    /// What it should be.
    pub truth: Light,
    /// Variance of E, mean over normals and channels, of both sides together; `None` where one is not known.
    pub variance: Option<f64>,
}

impl IrradianceError {
    /// Error over all pairs.
    ///
    /// Panics when there is nothing to compare.
    pub fn of(pairs: &[Pair]) -> IrradianceError {
        let directions = ErrorDirections::new();
        let mut tally = Tally::default();
        pairs.iter().for_each(|pair| tally.add(&directions.compare(pair)));
        tally.finish().0
    }
}

/// `irradiance[k][i]`: what coefficient i adds to E in direction k.
pub(super) struct ErrorDirections {
    irradiance: Vec<[f64; sh::MAX_COEFFICIENTS]>,
}

/// Differences at one node: means over directions.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct NodeSums {
    channels: [Sums; 3],
    /// Σ over m and channels of (found - truth)² and truth², radiance.
    bands: [Sums; sh::MAX_BANDS as usize + 1],
    /// How many bands there are.
    band_count: usize,
    variance: Option<f64>,
}

/// Sums of differences and of the truth.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    difference: f64,
    truth: f64,
    square_difference: f64,
    square_truth: f64,
}

impl Sums {
    fn add(&mut self, found: f64, truth: f64, weight: f64) {
        *self = self.plus(&Sums {
            difference: weight * (found - truth),
            truth: weight * truth,
            square_difference: weight * (found - truth) * (found - truth),
            square_truth: weight * truth * truth,
        });
    }

    fn plus(&self, other: &Sums) -> Sums {
        Sums {
            difference: self.difference + other.difference,
            truth: self.truth + other.truth,
            square_difference: self.square_difference + other.square_difference,
            square_truth: self.square_truth + other.square_truth,
        }
    }

    /// `values` is how many differences were summed up.
    fn error(&self, values: f64) -> ChannelError {
        ChannelError {
            relative_rmse: share(self.square_difference, self.square_truth).sqrt(),
            rmse: (self.square_difference / values).sqrt(),
            bias: share(self.difference, self.truth),
            mean_difference: self.difference / values,
        }
    }
}

/// No difference is no error, also where there is nothing.
fn share(difference: f64, truth: f64) -> f64 {
    if difference == 0.0 { 0.0 } else { difference / truth }
}

impl ErrorDirections {
    pub(super) fn new() -> ErrorDirections {
        let irradiance = fibonacci_sphere(DIRECTIONS).into_iter().map(|d| irradiance_row(d.to_array()));
        ErrorDirections { irradiance: irradiance.collect() }
    }

    /// Root mean square of E over directions and channels.
    pub(super) fn rms_irradiance(&self, radiance: &RadianceSh) -> f64 {
        let values = self.irradiance.iter().flat_map(|row| evaluate(row, radiance));
        (values.map(|e| e * e).sum::<f64>() / (3 * DIRECTIONS) as f64).sqrt()
    }

    /// E found and E of the truth, channel by channel in every direction (or at the truth's normal), in the bands of both.
    pub(super) fn both(&self, found: &RadianceSh, truth: &Light) -> [Vec<f64>; 2] {
        match truth {
            Light::Irradiance { normal, irradiance } => {
                [evaluate(&irradiance_row(*normal), found).to_vec(), irradiance.map(f64::from).to_vec()]
            }
            Light::Radiance(truth) => {
                let bands = found.bands.min(truth.bands);
                [found, truth].map(|radiance| {
                    let radiance = radiance.truncate(bands);
                    self.irradiance.iter().flat_map(|row| evaluate(row, &radiance)).collect()
                })
            }
        }
    }

    pub(super) fn compare(&self, pair: &Pair) -> NodeSums {
        let mut node = NodeSums { variance: pair.variance, ..NodeSums::default() };
        match &pair.truth {
            Light::Irradiance { normal, irradiance } => {
                let found = evaluate(&irradiance_row(*normal), &pair.found);
                for (channel, sums) in node.channels.iter_mut().enumerate() {
                    sums.add(found[channel], f64::from(irradiance[channel]), 1.0);
                }
            }
            Light::Radiance(truth) => {
                let bands = pair.found.bands.min(truth.bands);
                let [found, truth] = [&pair.found, truth].map(|radiance| radiance.truncate(bands));
                for row in &self.irradiance {
                    let (found, truth) = (evaluate(row, &found), evaluate(row, &truth));
                    for (channel, sums) in node.channels.iter_mut().enumerate() {
                        sums.add(found[channel], truth[channel], 1.0 / DIRECTIONS as f64);
                    }
                }
                node.band_count = bands as usize + 1;
                let both = found.coefficients.iter().zip(&truth.coefficients);
                for (i, (found, truth)) in both.enumerate().take(sh::coefficient_count(bands)) {
                    let sums = &mut node.bands[sh::band_of(i)];
                    found.iter().zip(truth).for_each(|(&f, &t)| sums.add(f64::from(f), f64::from(t), 1.0));
                }
            }
        }
        node
    }
}

/// E at a normal is this row times the coefficients.
fn irradiance_row(normal: [f32; 3]) -> [f64; sh::MAX_COEFFICIENTS] {
    let mut basis = [0.0; sh::MAX_COEFFICIENTS];
    sh::basis(sh::MAX_BANDS, normal, &mut basis);
    std::array::from_fn(|i| f64::from(sh::COSINE[sh::band_of(i)]) * f64::from(basis[i]))
}

fn evaluate(row: &[f64; sh::MAX_COEFFICIENTS], radiance: &RadianceSh) -> [f64; 3] {
    let mut sum = [0.0; 3];
    let count = sh::coefficient_count(radiance.bands);
    for (factor, rgb) in row.iter().zip(&radiance.coefficients[..count]) {
        sum.iter_mut().zip(rgb).for_each(|(sum, &value)| *sum += factor * f64::from(value));
    }
    sum
}

/// Sums over nodes.
#[derive(Debug, Clone, Default)]
pub(super) struct Tally {
    channels: [Sums; 3],
    bands: [Sums; sh::MAX_BANDS as usize + 1],
    band_count: usize,
    variance: f64,
    /// Nodes whose variance is not known.
    variance_unknown: usize,
    /// Mean square difference and mean square truth of each node.
    nodes: Vec<[f64; 2]>,
}

impl Tally {
    pub(super) fn add(&mut self, node: &NodeSums) {
        let add = |sums: &mut Sums, more: &Sums| *sums = sums.plus(more);
        self.channels.iter_mut().zip(&node.channels).for_each(|(sums, more)| add(sums, more));
        self.bands.iter_mut().zip(&node.bands).for_each(|(sums, more)| add(sums, more));
        self.band_count = self.band_count.max(node.band_count);
        self.variance += node.variance.unwrap_or(0.0);
        self.variance_unknown += usize::from(node.variance.is_none());
        let mean = |of: fn(&Sums) -> f64| node.channels.iter().map(of).sum::<f64>() / 3.0;
        self.nodes.push([mean(|sums| sums.square_difference), mean(|sums| sums.square_truth)]);
    }

    pub(super) fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// The error of all, and that of each node.
    pub(super) fn finish(&self) -> (IrradianceError, Vec<f64>) {
        assert!(!self.is_empty(), "nothing to compare");
        let nodes = self.nodes.len() as f64;
        let all = self.channels.iter().fold(Sums::default(), |sum, channel| sum.plus(channel));
        let ChannelError { relative_rmse, rmse, bias, mean_difference } = all.error(3.0 * nodes);
        // Per node the variance is a mean over channels already.
        let variance = (self.variance_unknown == 0).then_some(3.0 * self.variance);
        let left = |variance: f64| (all.square_difference - variance).max(0.0);
        let per_node = self.relative_errors();
        let error = IrradianceError {
            nodes: self.nodes.len(),
            relative_rmse,
            rmse,
            bias,
            mean_difference,
            channels: self.channels.map(|channel| channel.error(nodes)),
            bands: self.band_errors(),
            noise: variance.map(|v| share(v, all.square_truth).sqrt()),
            systematic: variance.map(|v| share(left(v), all.square_truth).sqrt()),
            systematic_by_chance: variance.map(|v| {
                share(v * 2.0 * (2.0 / (independent_numbers(self.band_count) * nodes)).sqrt(), all.square_truth).sqrt()
            }),
            per_node: summary(&per_node),
        };
        (error, per_node)
    }

    fn band_errors(&self) -> Vec<BandError> {
        let weight = |band: usize| f64::from(sh::COSINE[band]).powi(2);
        let bands = || self.bands.iter().enumerate().take(self.band_count);
        let irradiance: f64 = bands().map(|(band, sums)| weight(band) * sums.square_truth).sum();
        let radiance: f64 = bands().map(|(_, sums)| sums.square_truth).sum();
        let error = |(band, sums): (usize, &Sums)| BandError {
            band: band as u32,
            irradiance: share(weight(band) * sums.square_difference, irradiance).sqrt(),
            radiance: share(sums.square_difference, radiance).sqrt(),
        };
        bands().map(error).collect()
    }

    fn relative_errors(&self) -> Vec<f64> {
        let mut squares: Vec<f64> = self.nodes.iter().map(|node| node[1]).collect();
        let mean = squares.iter().sum::<f64>() / squares.len() as f64;
        let middle = squares.len() / 2;
        let median = *squares.select_nth_unstable_by(middle, f64::total_cmp).1;
        // Squares here: a tenth is a hundredth. With most nodes black the median is too: then the mean stands in.
        let floor = 0.01 * if median > 0.0 { median } else { mean };
        self.nodes.iter().map(|[difference, truth]| share(*difference, truth.max(floor)).sqrt()).collect()
    }
}

/// Independent numbers in E of a node whose coefficients are equally noisy: (Σ A_l²)² / Σ A_l⁴, 4.3 for three bands. One
/// without bands: E at a normal.
pub(super) fn independent_numbers(band_count: usize) -> f64 {
    let sum = |power: i32| {
        let bands = sh::COSINE.iter().take(band_count.max(1)).enumerate();
        bands.map(|(l, &a)| (2 * l + 1) as f64 * f64::from(a).powi(power)).sum::<f64>()
    };
    sum(2).powi(2) / sum(4)
}

fn summary(errors: &[f64]) -> ErrorSummary {
    let infinite = ErrorSummary { median: f64::INFINITY, p95: f64::INFINITY, max: f64::INFINITY };
    ErrorSummary::of(errors.iter().copied()).unwrap_or(infinite)
}

/// Coefficients `[coefficient][rgb]` as radiance SH.
pub fn radiance_sh(bands: u32, coefficients: impl IntoIterator<Item = [f32; 3]>) -> RadianceSh {
    let mut sh = RadianceSh::zero(bands);
    for (place, value) in sh.coefficients[..sh::coefficient_count(bands)].iter_mut().zip(coefficients) {
        *place = value;
    }
    sh
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::noise::coefficient_variance;

    /// Some light, another one for every seed; L_00 is over the rest.
    fn light(bands: u32, seed: u32) -> RadianceSh {
        let value = |i: u32| f64::from((seed * 31 + i * 17) % 23) / 23.0;
        radiance_sh(bands, (0..25).map(|i| [0, 1, 2].map(|c| value(3 * i + c) as f32 + if i == 0 { 2.0 } else { 0.0 })))
    }

    fn scaled(radiance: &RadianceSh, factor: f32) -> RadianceSh {
        radiance_sh(radiance.bands, radiance.coefficients.map(|rgb| rgb.map(|v| v * factor)))
    }

    fn pair(found: RadianceSh, truth: RadianceSh) -> Pair {
        Pair { found, truth: Light::Radiance(truth), variance: None }
    }

    #[test]
    fn light_against_itself_has_no_error() {
        let pairs: Vec<Pair> = (0..9).map(|seed| pair(light(4, seed), light(4, seed))).collect();
        let error = IrradianceError::of(&pairs);
        assert_eq!((error.nodes, error.relative_rmse, error.rmse, error.bias), (9, 0.0, 0.0, 0.0));
        assert_eq!(error.per_node, ErrorSummary { median: 0.0, p95: 0.0, max: 0.0 });
        assert_eq!(error.bands.len(), 5);
        assert!(error.bands.iter().all(|band| band.irradiance == 0.0 && band.radiance == 0.0));
        assert_eq!((error.noise, error.systematic), (None, None));
    }

    #[test]
    fn scaled_light_is_wrong_by_its_scale() {
        for bands in 0..=4 {
            let pairs: Vec<Pair> =
                (0..9).map(|seed| pair(scaled(&light(bands, seed), 1.02), light(bands, seed))).collect();
            let error = IrradianceError::of(&pairs);
            let channels = error.channels.iter().flat_map(|c| [c.relative_rmse, c.bias]);
            let nodes = [error.per_node.median, error.per_node.max];
            for found in [error.relative_rmse, error.bias].into_iter().chain(channels).chain(nodes) {
                assert!((found - 0.02).abs() < 1e-6, "L{bands} {error:?}");
            }
            // Bands: their squares add up.
            for of in [|band: &BandError| band.irradiance, |band: &BandError| band.radiance] {
                let whole = error.bands.iter().map(|band| of(band).powi(2)).sum::<f64>().sqrt();
                assert!((whole - 0.02).abs() < 1e-6, "L{bands} {whole}");
            }
        }
    }

    #[test]
    fn difference_of_one_band_and_channel_is_found_there() {
        let truth = light(2, 3);
        let mut found = truth;
        found.coefficients[2][1] += 0.1;
        let error = IrradianceError::of(&[pair(found, truth)]);
        let of = |figures: [f64; 3]| figures.map(|figure| figure > 1e-4);
        assert_eq!(of([0, 1, 2].map(|l| error.bands[l].irradiance)), [false, true, false]);
        assert_eq!(of([0, 1, 2].map(|c| error.channels[c].relative_rmse)), [false, true, false]);
    }

    #[test]
    fn bands_of_the_lower_of_both_count() {
        let truth = light(4, 1);
        for error in [pair(truth.truncate(1), truth), pair(truth, truth.truncate(1))].map(|p| IrradianceError::of(&[p]))
        {
            assert_eq!(error.relative_rmse, 0.0);
            assert_eq!(error.bands.len(), 2);
        }
    }

    #[test]
    fn irradiance_at_a_normal_is_compared_there_alone() {
        let found = light(2, 7);
        let normal = [0.6, 0.0, -0.8];
        let irradiance = found.convolve().evaluate(normal);
        let at = |scale: f32| Light::Irradiance { normal, irradiance: irradiance.map(|e| e / scale) };
        let error = IrradianceError::of(&[Pair { found, truth: at(1.0), variance: None }]);
        assert!(error.relative_rmse < 1e-6 && error.bands.is_empty(), "{error:?}");
        let error = IrradianceError::of(&[Pair { found, truth: at(1.02), variance: None }]);
        assert!((error.bias - 0.02).abs() < 1e-6, "{error:?}");
    }

    #[test]
    fn black_nodes_do_not_divide_by_zero() {
        // A black node among lit ones gave 0/0.
        let black = RadianceSh::zero(2);
        let mut pairs: Vec<Pair> = (0..9).map(|seed| pair(scaled(&light(2, seed), 1.01), light(2, seed))).collect();
        pairs.push(pair(black, black));
        let error = IrradianceError::of(&pairs);
        assert!((error.per_node.max - 0.01).abs() < 1e-6, "{error:?}");
        // Light in the dark is an error over the floor, finite.
        pairs.push(pair(scaled(&light(2, 0), 0.01), black));
        let max = IrradianceError::of(&pairs).per_node.max;
        assert!((0.01..1.0).contains(&max), "{max}");
        // Mostly black.
        let mostly = [&pairs[..1], &[pair(black, black); 5], &pairs[10..]].concat();
        assert!(IrradianceError::of(&mostly).per_node.max.is_finite());
        // All black.
        let error = IrradianceError::of(&[pair(black, black)]);
        assert_eq!((error.relative_rmse, error.bias, error.per_node.max), (0.0, 0.0, 0.0));
        let error = IrradianceError::of(&[pair(light(2, 0), black)]);
        assert_eq!((error.relative_rmse, error.per_node.max), (f64::INFINITY, f64::INFINITY));
    }

    /// Normal numbers by Box and Muller, from a fixed sequence.
    fn normal_numbers() -> impl FnMut() -> f64 {
        use crate::sampling::{Sampler, Stream};
        let stream = Stream::new(Sampler::Random, 1, 0, 0);
        let mut sample = 0;
        move || {
            sample += 1;
            let [u, v] = stream.point(sample, 0).map(f64::from);
            (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
        }
    }

    /// Truth plus noise of known standard error; the found side is off by `bias` besides.
    fn noisy_pairs(standard_error: f32, bias: f32) -> Vec<Pair> {
        let mut normal = normal_numbers();
        let errors = radiance_sh(2, [[standard_error; 3]; 9]);
        let mut noisy = |radiance: &RadianceSh| {
            radiance_sh(2, radiance.coefficients.map(|rgb| rgb.map(|v| v + standard_error * normal() as f32)))
        };
        (0..500)
            .map(|seed| {
                let radiance = light(2, seed);
                let (found, truth) = (noisy(&scaled(&radiance, 1.0 + bias)), noisy(&radiance));
                let variance = Some(2.0 * coefficient_variance(&errors, 2));
                Pair { found, truth: Light::Radiance(truth), variance }
            })
            .collect()
    }

    #[test]
    fn noise_alone_leaves_nothing_systematic() {
        // The channels' noise is independent here: over 500 nodes mean d² is known to sqrt(2 / (3 · 4.3 · 500)) = 1.8 %.
        // Four of them: false alarm 6e-5, were the sequence not fixed.
        let error = IrradianceError::of(&noisy_pairs(0.05, 0.0));
        let (noise, systematic) = (error.noise.unwrap(), error.systematic.unwrap());
        let ratio = (error.relative_rmse / noise).powi(2);
        assert!((ratio - 1.0).abs() < 4.0 * 0.018, "mean square difference over noise² {ratio}");
        let chance = error.systematic_by_chance.unwrap();
        assert!(systematic <= chance && chance < 0.3 * noise, "{systematic}, chance {chance}, noise {noise}");
    }

    #[test]
    fn systematic_error_is_found_under_noise_of_its_size() {
        // 3 % under noise of a comparable size; as above, the square is known to four times 1.8 % of mean d².
        let error = IrradianceError::of(&noisy_pairs(0.05, 0.03));
        let (noise, systematic) = (error.noise.unwrap(), error.systematic.unwrap());
        assert!((0.5..2.0).contains(&(noise / 0.03)), "{noise}");
        assert!(systematic > 2.0 * error.systematic_by_chance.unwrap(), "{error:?}");
        let tolerance = 4.0 * 0.018 * error.relative_rmse.powi(2);
        assert!((systematic.powi(2) - 0.03f64.powi(2)).abs() < tolerance, "{systematic}, noise {noise}");
    }

    #[test]
    fn noise_is_not_known_where_one_node_does_not_know() {
        let mut pairs = noisy_pairs(0.05, 0.0);
        pairs[7].variance = None;
        let error = IrradianceError::of(&pairs);
        assert_eq!((error.noise, error.systematic), (None, None));
    }

    #[test]
    #[should_panic(expected = "nothing to compare")]
    fn comparing_nothing_fails() {
        IrradianceError::of(&[]);
    }
}
