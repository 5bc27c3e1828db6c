//! Lines through points: how fast noise falls, what is left, and what an error costs.

use serde::Serialize;

use super::point::Point;

/// A noise that falls slower than this, as a slope of logarithms, is not extrapolated: it comes to nothing.
const LEAST_FALL: f64 = 0.1;
/// Points at an end of the ladder that tell how it goes on: noise that has come to a stand does so for good.
const END: usize = 3;
/// Noise that grows by more than this with more directions does not do so by chance.
const JUMP: f64 = 1.5;
/// Nothing is said of bakes that take more than this many times the longest that was measured.
const FARTHEST: f64 = 1000.0;
/// Variance of bias² under this is that of rounding.
const LEAST_VARIANCE: f64 = 1e-24;

/// What is left of the error with any number of directions, a share of the RMS of E.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Floor {
    /// Most likely; 0 where noise explains all.
    pub middle: f64,
    /// Two standard deviations of bias² less,
    pub low: f64,
    /// and more.
    pub high: f64,
}

/// What it takes to come to an error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CostAt {
    /// CPU milliseconds per node.
    pub milliseconds_per_node: f64,
    /// The error lies outside those measured.
    pub extrapolated: bool,
    /// Directions per node.
    pub directions: f64,
}

/// Slope of log noise over log directions, by least squares.
pub(super) fn slope_of(points: &[Point]) -> Option<f64> {
    let logs = || {
        let noisy = points.iter().filter(|point| point.noise.middle > 0.0);
        noisy.map(|point| [(point.budget as f64).ln(), point.noise.middle.ln()])
    };
    let count = logs().count();
    let mean = |axis: usize| logs().map(|log| log[axis]).sum::<f64>() / count as f64;
    let (x, y) = (mean(0), mean(1));
    let sum = |of: fn(f64, f64) -> f64| logs().map(|log| of(log[0] - x, log[1] - y)).sum::<f64>();
    (count >= 2).then(|| sum(|x, y| x * y) / sum(|x, _| x * x))
}

/// Noise of every point as more directions tell it: with fewer it is not less. Where a sun is met by luck, a small budget
/// that never met it knows nothing of its noise.
fn least_noise(points: &[Point]) -> Vec<f64> {
    let mut noise: Vec<f64> = points.iter().map(|point| point.noise.middle).collect();
    for i in (1..noise.len()).rev() {
        noise[i - 1] = noise[i - 1].max(noise[i]);
    }
    noise
}

/// More directions brought much more noise: rare ones decide, and what is known of noise and bias is known by luck.
pub(super) fn is_erratic(points: &[Point]) -> bool {
    points.iter().zip(least_noise(points)).any(|(point, least)| least > JUMP * point.noise.middle)
}

/// The bias of all budgets together, each weighed by one over the variance of its bias².
pub(super) fn floor_of(points: &[Point]) -> Floor {
    let Some(first) = points.first() else { return Floor { middle: 0.0, low: 0.0, high: 0.0 } };
    let repeats = first.ground.repeats as f64;
    let reference = first.ground.reference_noise.unwrap_or(0.0).powi(2);
    let noise = least_noise(points);
    // Per independent number.
    let variance = |noise: f64, bias_square: f64| {
        let noise = noise.powi(2);
        let by_noise = 2.0 * noise * noise / (repeats * (repeats - 1.0));
        (by_noise + 4.0 * (bias_square + reference) * noise / repeats).max(LEAST_VARIANCE)
    };
    let pooled = |bias_square: f64| {
        let weights = || noise.iter().map(|&noise| 1.0 / variance(noise, bias_square));
        let sum: f64 = weights().zip(points).map(|(weight, point)| weight * point.bias_square).sum();
        let total = weights().sum::<f64>();
        (sum / total, 1.0 / total)
    };
    // The weights take a first guess of the bias: noise matters more beside one.
    let guess = pooled(0.0).0.max(0.0);
    let (square, by_repeats) = pooled(guess);
    let by_reference = 2.0 * reference * reference + 4.0 * square.max(0.0) * reference;
    let strangers = first.ground.independent.max(1.0);
    let independent = independent_of(points, guess + reference).map_or(strangers, |found| found.clamp(1.0, strangers));
    let deviation = (by_repeats / independent + by_reference / strangers).sqrt();
    let root = |square: f64| square.max(0.0).sqrt();
    Floor { middle: root(square), low: root(square - 2.0 * deviation), high: root(square + 2.0 * deviation) }
}

/// Independent numbers, from how much the products of different repeats differ. With n of them and a fixed difference of
/// square `fixed` beside the noise, their sample variance is `(noise⁴ + 2 fixed noise² (R-1)/(R+1))/n`: each repeat is in
/// R - 1 products. `None` with fewer than three repeats, or without noise.
fn independent_of(points: &[Point], fixed: f64) -> Option<f64> {
    let shares = points.iter().filter_map(|point| {
        let (noise, repeats) = (point.noise.middle.powi(2), point.ground.repeats as f64);
        let expected = noise * noise + 2.0 * fixed * noise * (repeats - 1.0) / (repeats + 1.0);
        Some(point.ground.product_variance.filter(|_| expected > LEAST_VARIANCE)? / expected)
    });
    let shares: Vec<f64> = shares.collect();
    let mean = shares.iter().sum::<f64>() / shares.len() as f64;
    (mean > 0.0).then(|| 1.0 / mean)
}

/// What the noise `target` costs: between the two points around it on a straight line of logarithms; past the last by the
/// slope of the last three, before the first by that of the first three, cost growing with directions. Of several crossings
/// the last: with more, noise stays under. `None`: it never comes there, or not within [`FARTHEST`] times the longest bake.
pub(super) fn cost_at(points: &[Point], target: f64) -> Option<CostAt> {
    let cost = |point: &Point| point.milliseconds_per_node.middle;
    let outside = |point: &Point, end: &[Point]| {
        let fall = -slope_of(end).filter(|slope| -slope >= LEAST_FALL)?;
        let times = (point.noise.middle / target).powf(1.0 / fall);
        let directions = point.budget as f64 * times;
        Some(CostAt { milliseconds_per_node: cost(point) * times, extrapolated: true, directions })
            .filter(|_| times <= FARTHEST)
    };
    let Some(over) = points.iter().rposition(|point| point.noise.middle > target) else {
        // Less than the least that was tried; how much less, only a slope tells.
        let first = points.first()?;
        let tried = CostAt { milliseconds_per_node: cost(first), extrapolated: true, directions: first.budget as f64 };
        let end = &points[..points.len().min(END)];
        return Some(outside(first, end).filter(|at| at.milliseconds_per_node > 0.0).unwrap_or(tried));
    };
    let [a, b] = match points.get(over..over + 2) {
        Some([a, b]) => [a, b],
        _ => return outside(&points[over], &points[points.len().saturating_sub(END)..]),
    };
    let [from, to] = [a, b].map(|point| point.noise.middle.ln());
    // Down to no noise at all: no line of logarithms.
    let share = if to.is_finite() { (from - target.ln()) / (from - to) } else { 1.0 };
    let between = |of: &dyn Fn(&Point) -> f64| {
        let logs = [a, b].map(|point| of(point).ln());
        (logs[0] + share * (logs[1] - logs[0])).exp()
    };
    let directions = between(&|point| point.budget as f64);
    Some(CostAt { milliseconds_per_node: between(&cost), extrapolated: false, directions })
}
