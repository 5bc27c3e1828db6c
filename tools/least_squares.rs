//! Small dense least squares in f64: what the tools fit with. Matrices are rows one behind the other.
//!
//! Based on: C. Lawson and R. Hanson, "Solving Least Squares Problems" (1974), chapter 23; K. Madsen, H. Nielsen and
//! O. Tingleff, "Methods for Non-Linear Least Squares Problems" (2004), algorithm 3.16; G. Golub and C. Van Loan,
//! "Matrix Computations" (2013), algorithm 8.5.2.

/// x of `matrix` x = `right`, the matrix symmetric and positive definite; None where it is not.
pub fn solve(matrix: &[f64], right: &[f64]) -> Option<Vec<f64>> {
    let n = right.len();
    assert_eq!(matrix.len(), n * n, "a square matrix of {n} rows");
    // Cholesky: matrix = L Lᵀ.
    let mut l = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..=i {
            let sum: f64 = (0..j).map(|k| l[i * n + k] * l[j * n + k]).sum();
            let rest = matrix[i * n + j] - sum;
            if i > j {
                l[i * n + j] = rest / l[j * n + j];
            } else if rest > 1e-12 * matrix[i * n + i].abs() {
                l[i * n + i] = rest.sqrt();
            } else {
                return None;
            }
        }
    }
    let mut x = right.to_vec();
    for i in 0..n {
        let sum: f64 = (0..i).map(|k| l[i * n + k] * x[k]).sum();
        x[i] = (x[i] - sum) / l[i * n + i];
    }
    for i in (0..n).rev() {
        let sum: f64 = (i + 1..n).map(|k| l[k * n + i] * x[k]).sum();
        x[i] = (x[i] - sum) / l[i * n + i];
    }
    Some(x)
}

/// The x >= 0 for which |A x - b|² is least, given `gram` = AᵀA and `right` = Aᵀb.
pub fn solve_non_negative(gram: &[f64], right: &[f64]) -> Vec<f64> {
    let n = right.len();
    assert_eq!(gram.len(), n * n, "a square matrix of {n} rows");
    let tolerance = 1e-10 * right.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let mut x = vec![0.0; n];
    // `free` may be positive; the others are held at 0.
    let mut free: Vec<usize> = Vec::new();
    for _ in 0..3 * n {
        // Free the one along which the error falls fastest.
        let slope = |i: usize| right[i] - (0..n).map(|j| gram[i * n + j] * x[j]).sum::<f64>();
        let held = (0..n).filter(|i| !free.contains(i)).map(|i| (slope(i), i));
        let Some((steepest, index)) = held.max_by(|a, b| a.0.total_cmp(&b.0)) else { break };
        if steepest <= tolerance {
            break;
        }
        free.push(index);
        // Go towards the optimum of the free ones; whichever reaches 0 on the way is held again.
        loop {
            let part: Vec<f64> = free.iter().flat_map(|&i| free.iter().map(move |&j| gram[i * n + j])).collect();
            let aim = solve(&part, &free.iter().map(|&i| right[i]).collect::<Vec<f64>>());
            // Dependent on those already free: nothing to gain by it.
            let Some(aim) = aim else { return x };
            let limit = free.iter().zip(&aim).filter(|&(_, &to)| to <= 0.0).map(|(&i, &to)| x[i] / (x[i] - to));
            let share = limit.fold(1.0, f64::min);
            for (&i, &to) in free.iter().zip(&aim) {
                x[i] += share * (to - x[i]);
            }
            if share >= 1.0 {
                break;
            }
            let zero = 1e-14 * x.iter().fold(0.0f64, |m, &v| m.max(v));
            free.retain(|&i| {
                let positive = x[i] > zero;
                x[i] = if positive { x[i] } else { 0.0 };
                positive
            });
        }
    }
    x
}

/// Parameters near `start` for which the sum of squares of `residuals` is least: Levenberg-Marquardt, derivatives by
/// forward differences. Never worse than `start`.
pub fn minimise(start: &[f64], residuals: impl Fn(&[f64]) -> Vec<f64>) -> Vec<f64> {
    const MOST_STEPS: usize = 30;
    const ENOUGH: f64 = 1e-5; // relative gain of a step
    let n = start.len();
    let scale = start.iter().fold(0.0f64, |m, v| m.max(v.abs())).max(f64::MIN_POSITIVE);
    let squares = |r: &[f64]| r.iter().map(|v| v * v).sum::<f64>();
    let mut best = start.to_vec();
    let mut at = residuals(&best);
    let mut error = squares(&at);
    let mut damping = 1e-3;
    for _ in 0..MOST_STEPS {
        let columns: Vec<Vec<f64>> = (0..n)
            .map(|i| {
                let mut aside = best.clone();
                aside[i] += 1e-6 * scale;
                residuals(&aside).iter().zip(&at).map(|(a, b)| (a - b) / (1e-6 * scale)).collect()
            })
            .collect();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let downhill: Vec<f64> = columns.iter().map(|column| -dot(column, &at)).collect();
        let normal: Vec<f64> = columns.iter().flat_map(|a| columns.iter().map(move |b| dot(a, b))).collect();
        let before = error;
        // More damping until a step gains.
        while damping < 1e6 && error == before {
            let mut damped = normal.clone();
            (0..n).for_each(|i| damped[i * n + i] = damped[i * n + i] * (1.0 + damping) + 1e-12 * damping);
            let step = solve(&damped, &downhill).unwrap_or_else(|| vec![0.0; n]);
            let next: Vec<f64> = best.iter().zip(&step).map(|(a, b)| a + b).collect();
            let there = residuals(&next);
            if squares(&there) < error {
                (best, error, at) = (next, squares(&there), there);
                damping *= 0.1;
            } else {
                damping *= 10.0;
            }
        }
        if before - error <= ENOUGH * before {
            break;
        }
    }
    best
}

/// Eigenvectors of a symmetric matrix of `n` rows, unit length, that of the largest eigenvalue first: cyclic Jacobi.
pub fn eigenvectors(matrix: &[f64], n: usize) -> Vec<Vec<f64>> {
    assert_eq!(matrix.len(), n * n, "a square matrix of {n} rows");
    let mut a = matrix.to_vec();
    let mut vectors: Vec<Vec<f64>> = (0..n).map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect()).collect();
    for _sweep in 0..50 {
        let off: f64 = (0..n).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| a[i * n + j].powi(2)).sum();
        let all: f64 = a.iter().map(|v| v * v).sum();
        if off <= 1e-26 * all {
            break;
        }
        for p in 0..n {
            for q in p + 1..n {
                if a[p * n + q] == 0.0 {
                    continue;
                }
                let tau = (a[q * n + q] - a[p * n + p]) / (2.0 * a[p * n + q]);
                let t = 1f64.copysign(tau) / (tau.abs() + (1.0 + tau * tau).sqrt());
                let c = 1.0 / (1.0 + t * t).sqrt();
                let s = t * c;
                for k in 0..n {
                    let (x, y) = (a[k * n + p], a[k * n + q]);
                    (a[k * n + p], a[k * n + q]) = (c * x - s * y, s * x + c * y);
                }
                for k in 0..n {
                    let (x, y) = (a[p * n + k], a[q * n + k]);
                    (a[p * n + k], a[q * n + k]) = (c * x - s * y, s * x + c * y);
                    let (x, y) = (vectors[p][k], vectors[q][k]);
                    (vectors[p][k], vectors[q][k]) = (c * x - s * y, s * x + c * y);
                }
            }
        }
    }
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&i, &j| a[j * n + j].total_cmp(&a[i * n + i]));
    order.into_iter().map(|i| vectors[i].clone()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solve_inverts_and_refuses_singular() {
        let x = solve(&[4.0, 1.0, 1.0, 3.0], &[6.0, 7.0]).unwrap();
        assert!((x[0] - 1.0).abs() < 1e-12 && (x[1] - 2.0).abs() < 1e-12, "{x:?}");
        assert_eq!(solve(&[1.0, 1.0, 1.0, 1.0], &[1.0, 1.0]), None);
    }

    #[test]
    fn non_negative_holds_what_would_be_negative() {
        // Columns (1, 0) and (1, 1), target (2, -1): free optimum (3, -1), held optimum (2, 0).
        let x = solve_non_negative(&[1.0, 1.0, 1.0, 2.0], &[2.0, 1.0]);
        assert!((x[0] - 2.0).abs() < 1e-12 && x[1] == 0.0, "{x:?}");
    }

    #[test]
    fn minimise_finds_an_exponential() {
        let found = minimise(&[1.0, 0.0], |p| {
            (0..9).map(|i| p[0] * (p[1] * f64::from(i)).exp() - 2.0 * (-0.3 * f64::from(i)).exp()).collect()
        });
        assert!((found[0] - 2.0).abs() < 1e-4 && (found[1] + 0.3).abs() < 1e-4, "{found:?}");
    }

    #[test]
    fn eigenvectors_are_orthonormal_and_in_order() {
        let matrix = [2.0, 1.0, 0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 7.0];
        let vectors = eigenvectors(&matrix, 3);
        let value =
            |v: &[f64]| (0..3).map(|i| v[i] * (0..3).map(|j| matrix[3 * i + j] * v[j]).sum::<f64>()).sum::<f64>();
        for (vector, expected) in vectors.iter().zip([7.0, 3.0, 1.0]) {
            assert!((value(vector) - expected).abs() < 1e-12, "{vectors:?}");
            assert!((vector.iter().map(|v| v * v).sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }
}
