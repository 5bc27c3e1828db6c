//! Systematic error of nodes: what more directions do not take away.
//!
//! Audits of some nodes (see [`RadianceFunction::audit`](crate::radiance::RadianceFunction::audit)) tell the square of each node's, right
//! on average and much noisier than what is asked for. So one number is taken from all: the mean, in which a node with little noise counts
//! more. What makes light systematically wrong (surfaces that probes show coarsely, their own noise) counts most where light is hard to
//! find, in the same places that are noisy. So the mean is shared out among nodes in proportion to the variance of their noise, which
//! each of them knows. Audits by paths know the truth, but where paths are noisy they do not tell; then those by leaving out a probe
//! count, which are nearly free of noise and say how far probes differ. Beside it stands the light of directions that nobody has seen, which each node knows for itself.

use super::summary::Summary;
use crate::rows::Table;

/// Independent numbers in E of a node, about: the square of a mean of audits varies by its variance times √(2 / this).
const FREEDOM: f64 = 2.0;
/// A mean square that is less than so many of its standard errors is none: noise explains it.
const CERTAIN: f64 = 2.0;

/// What audits found, over the square of nodes' irradiance.
#[derive(Debug, Clone, Copy, Default)]
struct Found {
    square: f64,
    standard_error: f64,
    /// Mean variance of the noise of the same nodes, weighted alike.
    noise: f64,
}

impl Found {
    fn is_certain(&self) -> bool {
        self.square > CERTAIN * self.standard_error
    }
}

/// By paths if that is certain, or else by probes if that is, or nothing.
fn found(places: &[u32], estimates: &Table<Summary>, median: f64) -> Found {
    let both = [false, true].map(|by_probes| found_by(by_probes, places, estimates, median));
    both.into_iter().find(Found::is_certain).unwrap_or_default()
}

fn found_by(by_probes: bool, places: &[u32], estimates: &Table<Summary>, median: f64) -> Found {
    let (mut square, mut noise, mut total, mut spread) = (0.0, 0.0, 0.0, 0.0);
    for place in places {
        let estimate = estimates.first(*place as usize);
        let own = |of: f64| estimate.relative_square(of, median);
        let variance = own(estimate.bias.noise);
        if variance > 0.0 && estimate.standard_error.is_finite() && estimate.bias.by_probes == by_probes {
            // By probes noise is next to none, and least where the one that is left out shows nothing.
            let weight = if by_probes { 1.0 } else { 1.0 / variance };
            square += weight * own(estimate.bias.square);
            noise += weight * own(estimate.standard_error.powi(2));
            spread += (weight * variance).powi(2) * 2.0 / FREEDOM;
            total += weight;
        }
    }
    match total > 0.0 {
        true => Found { square: square / total, standard_error: spread.sqrt() / total, noise: noise / total },
        false => Found::default(),
    }
}

/// Root mean square systematic error of each of these places, over its irradiance; 0 for other nodes.
pub(super) fn systematic_errors(places: &[u32], estimates: &Table<Summary>, median: f64) -> Vec<f32> {
    let mut errors = vec![0.0; estimates.len()];
    let Found { square, noise, .. } = found(places, estimates, median);
    for place in places {
        let estimate = estimates.first(*place as usize);
        let own = estimate.relative_square(estimate.standard_error.powi(2), median);
        let audited = match noise > 0.0 && own.is_finite() {
            true => square * own / noise,
            false => square,
        };
        let unseen = estimate.relative_square(estimate.unseen_error.powi(2), median);
        errors[*place as usize] = (audited + unseen).sqrt() as f32;
    }
    errors
}

/// The volume's systematic error, as far as it is certain: its square less one standard error of that.
pub(super) fn least_systematic_error(places: &[u32], estimates: &Table<Summary>, median: f64) -> f64 {
    let Found { square, standard_error, .. } = found(places, estimates, median);
    (square - standard_error).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::integrate::Bias;
    use crate::sampling::{Sampler, Stream};

    /// Nodes whose audits are `noise` off, of a systematic error of `error`; both over an irradiance of 1.
    fn nodes(count: u32, noise: f64, error: f64) -> Table<Summary> {
        let stream = Stream::new(Sampler::Random, 0, 0, 0);
        let node = |place: u32| {
            let normal = |n: u32| (0..12).map(|i| f64::from(stream.random(place, 12 * n + i))).sum::<f64>() - 6.0;
            // Four independent numbers, each by the product of two replicates, whose variance is twice that of their mean.
            let of = |n: u32| normal(n) * std::f64::consts::SQRT_2 * noise + error;
            let square = (0..4).map(|n| of(2 * n) * of(2 * n + 1)).sum::<f64>() / 4.0;
            let bias = Bias { square, noise: noise * noise, by_probes: false };
            Summary { bias, standard_error: 0.005, rms_irradiance: 1.0, coverage: 1.0, ..Summary::default() }
        };
        Table::held(1, (0..count).map(node).collect())
    }

    #[test]
    fn an_error_under_the_noise_of_every_node_is_found_by_many() {
        // The square is 1e-4, that of the noise 4e-4 at each of 1024 nodes.
        let estimates = nodes(1024, 0.02, 0.01);
        let places: Vec<u32> = (0..1024).collect();
        let errors = systematic_errors(&places, &estimates, 1.0);
        assert!(errors.iter().all(|error| (error / 0.01 - 1.0).abs() < 0.3), "{}", errors[0]);
        assert!(least_systematic_error(&places, &estimates, 1.0) < f64::from(errors[0]));
    }

    #[test]
    fn nodes_that_are_noisier_have_more_of_it() {
        let mut estimates = nodes(1024, 0.02, 0.01);
        let noisy = estimates.first(3);
        estimates.set(3, &[Summary { standard_error: 4.0 * noisy.standard_error, ..noisy }]);
        let errors = systematic_errors(&(0..1024).collect::<Vec<_>>(), &estimates, 1.0);
        assert!((errors[3] / errors[4] - 4.0).abs() < 1e-3, "{} {}", errors[3], errors[4]);
    }

    #[test]
    fn unseen_light_counts_at_its_node_alone_and_nothing_is_wrong_without_audits() {
        let lit = Summary { rms_irradiance: 2.0, coverage: 1.0, ..Summary::default() };
        let mut estimates = Table::held(1, vec![lit; 20]);
        estimates.set(7, &[Summary { unseen_error: 0.5, ..lit }]);
        let errors = systematic_errors(&(0..20).collect::<Vec<_>>(), &estimates, 1.0);
        for (place, error) in errors.iter().enumerate() {
            assert_eq!(*error, if place == 7 { 0.25 } else { 0.0 });
        }
    }
}
