//! Robust statistics of log ratios: the location of one pair of probes, and values on a graph of differences.
//!
//! Based on: Mosteller and Tukey, "Data Analysis and Regression", 1977, §10 (biweight) and §8 (jackknife); Huber, "Robust
//! Estimation of a Location Parameter", 1964. All in f64, in the order given: the same bytes on any number of threads.

use std::f64::consts::PI;

/// A normal distribution's standard deviation over its median absolute deviation.
const NORMAL_PER_MAD: f64 = 1.4826;
/// Where the biweight ends and Huber's weights begin to fall, in standard deviations: 95 % efficient where all is normal.
const BIWEIGHT_END: f64 = 4.685;
const HUBER_KNEE: f64 = 1.345;
/// No scale is smaller: constant rooms have none of their own.
const LEAST_SCALE: f64 = 1e-5;
/// Fewer values say nothing of their cell, and fewer cells nothing of what they have apart.
const LEAST_IN_CELL: usize = 6;
const LEAST_CELLS: usize = 5;
/// Steps of reweighting at most; a dozen do.
const STEPS: usize = 60;
/// A step this small ends it.
const CONVERGED: f64 = 1e-10;

/// What many values have in common.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Location {
    pub value: f64,
    /// Of the values about it, as a standard deviation: 1.4826 × median absolute deviation.
    pub spread: f64,
    /// Of `value`, by leaving out one part of the values at a time.
    pub standard_error: f64,
}

/// Robust standard deviation of what several cells have apart, each cell's values taken together, less what the noise within
/// cells explains of that; 0 where it explains all, `None` of too few cells. `values` are (cell, value).
pub fn between_cells(values: &[(u8, f64)]) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by_key(|(cell, _)| *cell);
    let (mut middles, mut within, mut noise) = (Vec::new(), Vec::new(), Vec::new());
    for cell in sorted.chunk_by(|a, b| a.0 == b.0).filter(|cell| cell.len() >= LEAST_IN_CELL) {
        let middle = median(&mut cell.iter().map(|(_, value)| *value).collect::<Vec<_>>()).expect("a cell has values");
        middles.push(middle);
        // n - 1: the middle follows its values.
        let free = (cell.len() as f64 / (cell.len() as f64 - 1.0)).sqrt();
        within.extend(cell.iter().map(|(_, value)| (value - middle) * free));
        noise.push(1.0 / cell.len() as f64);
    }
    if middles.len() < LEAST_CELLS {
        return None;
    }
    // A median's variance is π/2 times a mean's.
    let noise = PI / 2.0 * spread_about(0.0, within.into_iter()).powi(2) * median(&mut noise).unwrap_or(0.0);
    let middle = median(&mut middles).expect("there are cells");
    let apart = spread_about(middle, middles.iter().copied());
    Some((apart.powi(2) - noise).max(0.0).sqrt())
}

/// The one in the middle, or the mean of the two; `None` of none.
pub fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    let half = values.len() / 2;
    match values.len() % 2 {
        _ if values.is_empty() => None,
        1 => Some(values[half]),
        _ => Some((values[half - 1] + values[half]) / 2.0),
    }
}

/// Robust standard deviation about `middle`: 1.4826 × median absolute deviation; 0 of no values.
pub fn spread_about(middle: f64, values: impl Iterator<Item = f64>) -> f64 {
    NORMAL_PER_MAD * median(&mut values.map(|v| (v - middle).abs()).collect::<Vec<_>>()).unwrap_or(0.0)
}

/// Tukey's biweight location of (part, value). Values of one part err together: the standard error is that between parts.
/// `None` without values.
pub fn location(values: &[(u8, f64)]) -> Option<Location> {
    let start = median(&mut values.iter().map(|(_, value)| *value).collect::<Vec<_>>())?;
    let value = biweight(values.iter().map(|(_, value)| *value), start);
    let spread = spread_about(value, values.iter().map(|(_, v)| *v));
    let mut parts: Vec<u8> = values.iter().map(|(part, _)| *part).collect();
    parts.sort_unstable();
    parts.dedup();
    // Jackknife: (G - 1) / G Σ (location without g - mean of these)².
    let without =
        |left_out: &u8| biweight(values.iter().filter(|(part, _)| part != left_out).map(|(_, value)| *value), value);
    let count = parts.len() as f64;
    let standard_error = if parts.len() < 2 {
        spread
    } else {
        let others: Vec<f64> = parts.iter().map(without).collect();
        let mean = others.iter().sum::<f64>() / count;
        ((count - 1.0) / count * others.iter().map(|v| (v - mean).powi(2)).sum::<f64>()).sqrt()
    };
    Some(Location { value, spread, standard_error })
}

/// Reweighted from `start` on, with the scale about it.
fn biweight(values: impl Iterator<Item = f64> + Clone, start: f64) -> f64 {
    let end = BIWEIGHT_END * spread_about(start, values.clone()).max(LEAST_SCALE);
    let mut at = start;
    for _ in 0..STEPS {
        let (mut sum, mut total) = (0.0, 0.0);
        for value in values.clone() {
            let off = (value - at) / end;
            if off.abs() < 1.0 {
                let weight = (1.0 - off * off).powi(2);
                sum += weight * (value - at);
                total += weight;
            }
        }
        let step = if total > 0.0 { sum / total } else { 0.0 };
        at += step;
        if step.abs() < CONVERGED {
            break;
        }
    }
    at
}

/// A measured difference: value of `from` less value of `to`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    pub from: usize,
    pub to: usize,
    pub value: f64,
    pub standard_error: f64,
}

/// Values of the knots of a graph.
#[derive(Debug, Clone, PartialEq)]
pub struct Levelled {
    /// Per knot; the median of each connected group is 0.
    pub values: Vec<f64>,
    /// Per knot, against the mean of its group.
    pub standard_errors: Vec<f64>,
}

/// The connected group of every knot, named by its first knot.
pub fn groups(count: usize, links: impl Iterator<Item = (usize, usize)> + Clone) -> Vec<usize> {
    let mut group: Vec<usize> = (0..count).collect();
    loop {
        let before = group.clone();
        for (a, b) in links.clone() {
            let first = group[a].min(group[b]);
            group[a] = first;
            group[b] = first;
        }
        if group == before {
            return group;
        }
    }
}

/// Values that explain the differences best: min Σ ρ((v_from - v_to - value) / standard error), ρ Huber's, by iteratively
/// reweighted least squares. Knots without a difference stay at 0.
pub fn level(count: usize, differences: &[Difference]) -> Levelled {
    let group = groups(count, differences.iter().map(|d| (d.from, d.to)));
    let members = |name: usize| (0..count).filter(|&knot| group[knot] == name).collect::<Vec<_>>();
    let mut values = vec![0.0; count];
    let mut weights: Vec<f64> = differences.iter().map(|d| d.standard_error.powi(-2)).collect();
    let mut scale = 1.0f64;
    for _ in 0..STEPS {
        let next =
            Cholesky::of(normal_matrix(&group, differences, &weights)).solve(right_side(count, differences, &weights));
        let step = next.iter().zip(&values).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        values = next;
        if step < CONVERGED {
            break;
        }
        let off = |d: &Difference| ((values[d.from] - values[d.to] - d.value) / d.standard_error).abs();
        // Pairs that agree worse than their standard errors say are not believed more than that.
        scale = spread_about(0.0, differences.iter().map(off)).max(1.0);
        for (weight, difference) in weights.iter_mut().zip(differences) {
            let off = off(difference) / scale;
            *weight = difference.standard_error.powi(-2) * if off > HUBER_KNEE { HUBER_KNEE / off } else { 1.0 };
        }
    }
    let matrix = Cholesky::of(normal_matrix(&group, differences, &weights));
    let mut standard_errors = vec![0.0; count];
    for (knot, standard_error) in standard_errors.iter_mut().enumerate() {
        // Diagonal of the pseudo-inverse.
        let unit: Vec<f64> = (0..count).map(|other| f64::from(u8::from(other == knot))).collect();
        let size = members(group[knot]).len() as f64;
        *standard_error = scale * (matrix.solve(unit)[knot] - 1.0 / size).max(0.0).sqrt();
    }
    for name in 0..count {
        let members = members(name);
        if let Some(middle) = median(&mut members.iter().map(|&knot| values[knot]).collect::<Vec<_>>()) {
            members.iter().for_each(|&knot| values[knot] -= middle);
        }
    }
    Levelled { values, standard_errors }
}

/// The graph's Laplacian; with 1/size between all of a group, which fixes the group's mean at 0, it is positive definite.
fn normal_matrix(group: &[usize], differences: &[Difference], weights: &[f64]) -> Vec<Vec<f64>> {
    let count = group.len();
    let mut sizes = vec![0.0; count];
    group.iter().for_each(|&name| sizes[name] += 1.0);
    let entry = |row: usize, column: usize| if group[row] == group[column] { 1.0 / sizes[group[row]] } else { 0.0 };
    let mut matrix: Vec<Vec<f64>> =
        (0..count).map(|row| (0..count).map(|column| entry(row, column)).collect()).collect();
    for (Difference { from, to, .. }, weight) in differences.iter().zip(weights) {
        matrix[*from][*from] += weight;
        matrix[*to][*to] += weight;
        matrix[*from][*to] -= weight;
        matrix[*to][*from] -= weight;
    }
    matrix
}

fn right_side(count: usize, differences: &[Difference], weights: &[f64]) -> Vec<f64> {
    let mut right = vec![0.0; count];
    for (difference, weight) in differences.iter().zip(weights) {
        right[difference.from] += weight * difference.value;
        right[difference.to] -= weight * difference.value;
    }
    right
}

/// A positive definite matrix as L·Lᵀ.
struct Cholesky {
    lower: Vec<Vec<f64>>,
}

impl Cholesky {
    fn of(mut matrix: Vec<Vec<f64>>) -> Cholesky {
        for row in 0..matrix.len() {
            for column in 0..=row {
                let inner: f64 = (0..column).map(|k| matrix[row][k] * matrix[column][k]).sum();
                let rest = matrix[row][column] - inner;
                matrix[row][column] =
                    if row == column { rest.max(f64::MIN_POSITIVE).sqrt() } else { rest / matrix[column][column] };
            }
        }
        Cholesky { lower: matrix }
    }

    fn solve(&self, mut right: Vec<f64>) -> Vec<f64> {
        let lower = &self.lower;
        for row in 0..right.len() {
            let known: f64 = (0..row).map(|k| lower[row][k] * right[k]).sum();
            right[row] = (right[row] - known) / lower[row][row];
        }
        for row in (0..right.len()).rev() {
            let known: f64 = (row + 1..right.len()).map(|k| lower[k][row] * right[k]).sum();
            right[row] = (right[row] - known) / lower[row][row];
        }
        right
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{Sampler, Stream};

    /// `count` values about `middle`, nearly normal with deviation `sigma`, in eight parts.
    fn noisy(count: u32, middle: f64, sigma: f64) -> Vec<(u8, f64)> {
        let stream = Stream::new(Sampler::Random, 7, 0, 0);
        let normal = |i| (0..6).flat_map(|pair| stream.point(i, pair)).map(f64::from).sum::<f64>() - 6.0;
        (0..count).map(|i| ((i % 8) as u8, middle + sigma * normal(i))).collect()
    }

    #[test]
    fn location_is_not_moved_by_a_third_of_wrong_values_on_one_side() {
        let mut values = noisy(3000, 0.7, 0.02);
        let right = location(&values).unwrap();
        assert!((right.value - 0.7).abs() < 4.0 * right.standard_error, "{right:?}");
        assert!((right.spread / 0.02 - 1.0).abs() < 0.1, "{right:?}");
        // σ / √n, within what eight parts tell.
        assert!((0.4..2.5).contains(&(right.standard_error / (0.02 / 3000f64.sqrt()))), "{right:?}");
        values.iter_mut().step_by(3).for_each(|(_, value)| *value += 1.0);
        let found = location(&values).unwrap();
        assert!((found.value - 0.7).abs() < 0.005, "{found:?}");
    }

    #[test]
    fn location_has_an_answer_for_few_and_for_equal_values() {
        assert_eq!(location(&[]), None);
        assert_eq!(location(&[(3, 0.25)]).unwrap().value, 0.25);
        let equal = location(&[(0, -1.0), (1, -1.0), (2, -1.0)]).unwrap();
        assert_eq!(equal, Location { value: -1.0, spread: 0.0, standard_error: 0.0 });
    }

    #[test]
    fn what_cells_have_apart_is_told_from_noise_within_them() {
        // 64 cells of 16 values; normal offsets of the cells, or none.
        let offsets = noisy(64, 0.0, 0.05);
        let of = |scale: f64| {
            let cell = |i: usize| offsets[i % 64].1 * scale;
            let values = noisy(1024, 0.3, 0.04).into_iter().enumerate();
            between_cells(&values.map(|(i, (_, v))| ((i % 64) as u8, v + cell(i))).collect::<Vec<_>>()).unwrap()
        };
        // By noise alone cells are 0.0125 apart.
        assert!(of(0.0) < 0.008, "{}", of(0.0));
        assert!((of(1.0) / 0.05 - 1.0).abs() < 0.35, "{}", of(1.0));
        assert_eq!(between_cells(&noisy(20, 0.0, 1.0)), None, "too few to tell");
    }

    #[test]
    fn level_recovers_values_and_withstands_a_wrong_difference() {
        let truth = [0.3, 0.0, -0.5, 0.0, 2.0];
        let links = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 0), (0, 2), (1, 3), (2, 4), (3, 0), (4, 1)];
        let difference = |&(from, to): &(usize, usize)| Difference {
            from,
            to,
            value: truth[from] - truth[to],
            standard_error: 0.01,
        };
        let mut differences: Vec<Difference> = links.iter().map(difference).collect();
        let close = |found: &[f64], by: f64| {
            assert!(found.iter().zip(truth).all(|(a, b)| (a - b).abs() < by), "{found:?}");
        };
        let exact = level(5, &differences);
        close(&exact.values, 1e-9);
        // All pairs of n: σ / √n against the mean, less what the mean has of it.
        let expected = 0.01 * (4.0 / 25.0f64).sqrt();
        assert!(exact.standard_errors.iter().all(|e| (e - expected).abs() < 1e-9), "{exact:?}");
        differences[3].value += 1.0;
        close(&level(5, &differences).values, 0.02);
    }

    #[test]
    fn level_gives_every_group_its_own_median_and_leaves_the_lonely_at_zero() {
        let difference = |from, to, value| Difference { from, to, value, standard_error: 0.1 };
        let found = level(6, &[difference(0, 1, 1.0), difference(3, 4, 0.0), difference(4, 5, -3.0)]);
        let expected = [0.5, -0.5, 0.0, 0.0, 0.0, 3.0];
        assert!(found.values.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
        assert_eq!(found.standard_errors[2], 0.0);
        assert_eq!(level(0, &[]).values, [0.0; 0]);
        assert_eq!(groups(5, [(3, 4), (1, 3)].into_iter()), [0, 1, 2, 1, 1]);
    }
}
