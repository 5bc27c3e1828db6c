//! De-ringing: the smallest windowing of a node that leaves its irradiance non-negative for all normals.
//!
//! Few bands ring: beside a sun the sum of L2 falls under zero on the side away from it, by up to 16 % of the mean.
//! A window scales bands down. Here bands 1 and up of a node share one weight w, so that irradiance is mixed with its own
//! mean, and w has a closed form in the least irradiance over the sphere:
//!
//! ```text
//!     E'(n) = E_0 + w (E(n) - E_0),   E_0 = A_0 L_00 Y_00,   w = min over R, G, B of E_0 / (E_0 - min_n E(n))
//! ```
//! Band 0 stays, to the bit; a node that does not ring stays as it is. Mixtures of non-negative nodes are non-negative, so
//! nothing is lost between them.
//!
//! Tried, over the nodes that ring of the empty box of `assets/` in full size under an unclipped sun (540 nodes), and over one and two delta
//! lights with up to 40 % of light from all sides; relative RMSE of the change of E, by a
//! prototype that is not kept (the laws hold what the kept one promises):
//!
//! | window | box L2 | box L4 | deltas L2 | deltas L4 |
//! |---|---|---|---|---|
//! | **one weight for all bands but 0** | **3.8 %** | **1.3 %** | **7.9 %** | **6.1 %** |
//! | the best of all weights per band (a quadratic programme) | 3.8 % | 1.2 % | 7.7 % | 4.5 % |
//! | 1/(1 + λ l(l+1)) | 4.9 % | 1.4 % | 11.5 % | 13.6 % |
//! | exp(-λ l(l+1)) | 5.0 % | 1.5 % | 13.5 % | 15.1 % |
//! | Hann | 5.8 % | 1.7 % | 37.8 % | 37.9 % |
//! | 1/(1 + λ l²(l+1)²) | 11.6 % | 4.2 % | 38.2 % | 39.1 % |
//! | bands from 2 up first, then band 1 | 37.9 % | 38.3 % | 46.6 % | 47.0 % |
//!
//! Windows that take high bands first do harm: away from a light it is band 2 that holds band 1 above zero. One weight
//! per channel changes less (box L2 2.7 %, deltas L2 7.5 %) but shifts the hue: shares of R, G and B moved by up to
//! 18 % of their sum on the deltas, where one for the node moves them by up to 11 %.
//!
//! Based on: P.-P. Sloan, "Deringing Spherical Harmonics", SIGGRAPH Asia 2017 (one window per function, as weak as it can
//! be; his windows lost above).

use gdibl_runtime::{IrradianceSh, RadianceSh, sh};
use glam::{DMat2, DVec2, Vec3};

use crate::sampling::fibonacci_sphere;

/// A node rings where a channel's E is under this share of its mean; above, it is rounding of an evaluation in f32.
pub const RINGING: f32 = -1e-6;

/// What storing a number may change it by: half a unit in its last place, or of the smallest number there is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rounding {
    /// Of the number itself.
    pub relative: f64,
    /// In the number's units.
    pub absolute: f64,
}

/// The weight w, 0..=1, of bands 1 and up of `node`. `stored` is the node as a reader will see it; `None` where that does
/// not ring. Otherwise no reader will find it ringing after `w * coefficient`, rounded. Channels without light
/// (L_00 not above 0) are not looked at.
pub fn window(node: &RadianceSh, stored: &RadianceSh, rounding: Rounding, search: &Search) -> Option<f32> {
    let least = search.least(&stored.convolve());
    let mean = mean_irradiance(stored);
    let rings = |c: usize| mean[c] > 0.0 && least[c] < RINGING * mean[c];
    if !(0..3).any(rings) {
        return None;
    }
    let least = search.least(&node.convolve());
    let (mean, margin) = (mean_irradiance(node), rounding_of_irradiance(node, rounding));
    let weight = |c: usize| {
        let mean = f64::from(mean[c]);
        (mean - margin[c]).max(0.0) / (mean - f64::from(least[c]))
    };
    // A channel that rings after rounding alone still needs its margin.
    let lit = (0..3).filter(|&c| mean[c] > 0.0 && f64::from(least[c]) < margin[c]);
    lit.map(weight).reduce(f64::min).map(|w| (w as f32).min(1.0).next_down().max(0.0))
}

/// What the weight `w` changes in E: root mean square over all normals and R, G, B, over that of E.
pub fn relative_change(node: &RadianceSh, w: f32) -> f64 {
    let irradiance = node.convolve().coefficients;
    let power = |all: &[[f32; 3]]| all.iter().flatten().map(|&e| f64::from(e).powi(2)).sum::<f64>();
    // Parseval: the basis is orthonormal.
    let all = power(&irradiance);
    if all > 0.0 { f64::from(1.0 - w) * (power(&irradiance[1..]) / all).sqrt() } else { 0.0 }
}

/// E averaged over all normals.
fn mean_irradiance(node: &RadianceSh) -> [f32; 3] {
    node.convolve().coefficients[0].map(|e| e * sh::Y00)
}

/// The most that rounding all coefficients can change E by, whatever the normal:
/// Σ_l A_l √((2l+1)/4π) |δ_l|, since |Σ_m δ_lm Y_lm| ≤ |δ_l| √((2l+1)/4π) (the addition theorem).
fn rounding_of_irradiance(node: &RadianceSh, rounding: Rounding) -> [f64; 3] {
    let convolved = |l: usize| f64::from(sh::COSINE[l].abs());
    std::array::from_fn(|c| {
        let change = |value: f32| (rounding.relative * f64::from(value).abs()).max(rounding.absolute);
        (0..=node.bands as usize).map(|l| convolved(l) * largest(l) * length(node, l, |rgb| change(rgb[c]))).sum()
    })
}

/// The most that a function of band `l` whose coefficients have the length 1 can reach.
fn largest(l: usize) -> f64 {
    ((2 * l + 1) as f64 / (4.0 * std::f64::consts::PI)).sqrt()
}

/// √Σ v² over the coefficients of band `l`.
fn length(node: &RadianceSh, l: usize, value: impl Fn(&[f32; 3]) -> f64) -> f64 {
    node.coefficients[l * l..(l + 1) * (l + 1)].iter().map(|rgb| value(rgb).powi(2)).sum::<f64>().sqrt()
}

/// Directions of the lattice.
const LATTICE: usize = 1024;
/// No direction is farther than this from one of the lattice, radians (a test looks).
const RADIUS: f64 = 0.1;
/// Step of the finite differences, radians: a larger one is off by the third derivative, a smaller one by rounding.
const STEP: f64 = 0.01;
/// Newton's steps per start; three are enough as a rule.
const NEWTON: usize = 8;

/// Finds the least irradiance over all normals.
///
/// A function of band l bends by at most l² times its largest value (Bernstein's inequality along a great circle), so with
/// B = Σ_l l² √((2l+1)/4π) |E_l| the lattice direction nearest to the minimum, at most r away, is at most ½ r² B above
/// it: Newton's method starts from every direction so close to the lattice's own minimum.
#[derive(Debug)]
pub struct Search {
    directions: Vec<Vec3>,
}

impl Default for Search {
    fn default() -> Self {
        Search { directions: fibonacci_sphere(LATTICE) }
    }
}

impl Search {
    /// The least E over all normals, per channel. Where it is surely above 0 the lattice's own minimum is enough.
    pub fn least(&self, irradiance: &IrradianceSh) -> [f32; 3] {
        let values: Vec<[f32; 3]> = self.directions.iter().map(|d| irradiance.evaluate(d.to_array())).collect();
        std::array::from_fn(|c| {
            let lowest = values.iter().fold(f32::INFINITY, |least, rgb| least.min(rgb[c]));
            let bend = bend(irradiance, c);
            let slack = (0.5 * RADIUS * RADIUS * bend) as f32;
            if lowest > slack {
                return lowest;
            }
            let starts = self.directions.iter().zip(&values).filter(|(_, rgb)| rgb[c] <= lowest + slack);
            starts.map(|(start, rgb)| descend(irradiance, c, bend, *start, rgb[c])).fold(lowest, f32::min)
        })
    }
}

/// The most by which E bends, per radian squared.
fn bend(irradiance: &IrradianceSh, c: usize) -> f64 {
    let length = |l: usize| {
        let band = &irradiance.coefficients[l * l..(l + 1) * (l + 1)];
        band.iter().map(|rgb| f64::from(rgb[c]).powi(2)).sum::<f64>().sqrt()
    };
    (1..=irradiance.bands as usize).map(|l| (l * l) as f64 * largest(l) * length(l)).sum()
}

/// The minimum that Newton's method finds from `start`, where E is `value`.
fn descend(irradiance: &IrradianceSh, c: usize, bend: f64, start: Vec3, value: f32) -> f32 {
    let (mut here, mut value) = (start, value);
    for _ in 0..NEWTON {
        let (tangent, bitangent) = here.any_orthonormal_pair();
        let place = |at: DVec2| (here + tangent * at.x as f32 + bitangent * at.y as f32).normalize();
        let at = |x: f64, y: f64| f64::from(irradiance.evaluate(place(DVec2::new(x, y) * STEP).to_array())[c]);
        let [left, right, down, up] = [at(-1.0, 0.0), at(1.0, 0.0), at(0.0, -1.0), at(0.0, 1.0)];
        let gradient = DVec2::new(right - left, up - down) / (2.0 * STEP);
        let middle = f64::from(value);
        let (xx, yy) = (left + right - 2.0 * middle, up + down - 2.0 * middle);
        let xy = at(1.0, 1.0) - right - up + middle;
        let hessian = DMat2::from_cols(DVec2::new(xx, xy), DVec2::new(xy, yy)) * (1.0 / (STEP * STEP));
        // Made convex where it is not, or hardly: on a ring of minima only the way across matters.
        let spread = (0.5 * (hessian.x_axis.x - hessian.y_axis.y)).hypot(hessian.x_axis.y);
        let smallest = 0.5 * (hessian.x_axis.x + hessian.y_axis.y) - spread;
        let convex = hessian + DMat2::IDENTITY * (0.01 * bend - smallest).max(0.0);
        let step = (-(convex.inverse() * gradient)).clamp_length_max(RADIUS);
        // Half the way, and half again, while that leads up.
        let tries = [1.0, 0.5, 0.25].map(|share| place(step * share));
        let found = tries.map(|to| (to, irradiance.evaluate(to.to_array())[c])).into_iter().find(|(_, e)| *e < value);
        let Some((to, lower)) = found else { break };
        (here, value) = (to, lower);
        if step.length() < 1e-4 {
            break;
        }
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{Sampler, Stream, uniform_sphere};
    use glam::Quat;

    const F32: Rounding = Rounding { relative: 1.0 / 16_777_216.0, absolute: 0.0 };

    fn directions(count: u32) -> impl Iterator<Item = Vec3> {
        let stream = Stream::new(Sampler::Random, 7, 0, 0);
        (0..count).map(move |i| uniform_sphere(stream.point(i, 0)))
    }

    fn lights(bands: u32, lights: &[(Vec3, [f32; 3])], even: f32) -> RadianceSh {
        let mut node = RadianceSh::zero(bands);
        for (direction, rgb) in lights {
            let mut basis = [0.0; sh::MAX_COEFFICIENTS];
            sh::basis(bands, direction.to_array(), &mut basis);
            for (sum, y) in node.coefficients.iter_mut().zip(basis) {
                (0..3).for_each(|c| sum[c] += rgb[c] * y);
            }
        }
        node.coefficients[0] = node.coefficients[0].map(|v| v + even);
        node
    }

    fn scaled(node: &RadianceSh, w: f32) -> RadianceSh {
        let mut scaled = *node;
        scaled.coefficients[1..].iter_mut().flatten().for_each(|v| *v *= w);
        scaled
    }

    #[test]
    fn no_direction_is_farther_from_the_lattice_than_assumed() {
        let search = Search::default();
        let nearest = |d: Vec3| search.directions.iter().map(|l| l.dot(d)).fold(-1.0, f32::max).min(1.0).acos();
        let farthest = directions(20_000).chain([Vec3::Y, Vec3::NEG_Y]).map(nearest).fold(0.0, f32::max);
        assert!((0.05..RADIUS as f32).contains(&farthest), "{farthest}");
    }

    #[test]
    fn least_irradiance_is_that_of_a_brute_search() {
        // 200 nodes of random lights at all bands; 50 000 directions come within a thousandth of the bend.
        let search = Search::default();
        let stream = Stream::new(Sampler::Random, 3, 0, 0);
        for number in 0..200u32 {
            let light = |i: u32| {
                let [a, b] = stream.point(number, 2 * i + 1);
                (uniform_sphere(stream.point(number, 2 * i)), [a, b, a * b])
            };
            let node = lights(1 + number % 4, &[light(0), light(1), light(2)], 0.1 * (number % 5) as f32).convolve();
            let least = search.least(&node);
            let mut brute = [f32::INFINITY; 3];
            for direction in directions(50_000) {
                let found = node.evaluate(direction.to_array());
                (0..3).for_each(|c| brute[c] = brute[c].min(found[c]));
            }
            for c in 0..3 {
                // Never above what someone finds; where positive, the lattice's own is within its slack.
                let bend = bend(&node, c) as f32;
                assert!(least[c] <= brute[c] + 1e-6 * bend || brute[c] > 0.0, "{number}: {least:?} {brute:?}");
                assert!(least[c] >= brute[c] - 1e-3 * bend, "{number}: {least:?} {brute:?}");
            }
        }
    }

    #[test]
    fn window_is_the_largest_weight_that_leaves_no_negative_irradiance() {
        let search = Search::default();
        for (number, direction) in directions(24).enumerate() {
            let rotation = Quat::from_rotation_arc(Vec3::Z, direction);
            for bands in 1..=4 {
                for other in [0.0, 0.3, 1.0] {
                    let two = [(direction, [3.0, 2.0, 1.0]), (rotation * Vec3::NEG_Z, [other, other, 2.0 * other])];
                    let node = lights(bands, &two, 0.01 * number as f32);
                    let found = window(&node, &node, F32, &search);
                    let least = |node: &RadianceSh| {
                        let (irradiance, mean) = (node.convolve(), mean_irradiance(node));
                        let relative = |d: Vec3| {
                            let e = irradiance.evaluate(d.to_array());
                            (0..3).map(|c| e[c] / mean[c]).fold(f32::INFINITY, f32::min)
                        };
                        // Behind the lights, where the minimum is or is not, and everywhere.
                        directions(4000).chain([direction, -direction]).map(relative).fold(f32::INFINITY, f32::min)
                    };
                    match found {
                        None => assert!(least(&node) >= -1e-6, "{bands} {other}: {}", least(&node)),
                        Some(w) => {
                            assert!(least(&node) < 0.0, "{bands} {other}: it does ring");
                            let kept = scaled(&node, w);
                            assert!(search.least(&kept.convolve()).iter().all(|e| *e >= -1e-6));
                            assert!(least(&kept) >= -1e-6, "{bands} {other}: {}", least(&kept));
                            let more = search.least(&scaled(&node, w + 1e-4).convolve());
                            assert!(more.iter().any(|e| *e < 0.0), "{bands} {other}: {w} is not the largest, {more:?}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn one_delta_light_has_the_windows_of_theory() {
        // L1: E = 1/4 + cosθ/2, so w = 1/2. L2: least is 1/4 - 4/15 + 5/32 (64/75 - 1) at cosθ = -8/15.
        let search = Search::default();
        for direction in directions(10) {
            let w = |bands| {
                let node = lights(bands, &[(direction, [2.0; 3])], 0.0);
                window(&node, &node, F32, &search)
            };
            assert_eq!(w(0), None);
            assert!((w(1).unwrap() - 0.5).abs() < 1e-5, "{:?}", w(1));
            let least = 0.25 - 4.0 / 15.0 + 5.0 / 32.0 * (64.0 / 75.0 - 1.0);
            assert!((w(2).unwrap() - 0.25 / (0.25 - least)).abs() < 1e-5, "{:?}", w(2));
            assert_eq!(w(3), w(2), "band 3 gives no irradiance");
        }
    }

    #[test]
    fn nodes_without_light_or_without_ringing_have_no_window() {
        let search = Search::default();
        let none = |node: &RadianceSh| window(node, node, F32, &search).is_none();
        assert!(none(&RadianceSh::zero(4)));
        assert!(none(&lights(4, &[(Vec3::X, [1.0; 3])], 2.0)));
        assert!(none(&lights(2, &[(Vec3::X, [0.0; 3])], 1.0)));
        // A channel without light of its own is not looked at, and neither hides nor stops the others.
        let mut node = lights(2, &[(Vec3::Y, [1.0, 1.0, 0.0])], 0.0);
        node.coefficients[1][2] = -1.0;
        let w = window(&node, &node, F32, &search);
        node.coefficients[1][2] = 0.0;
        assert_eq!(w, window(&node, &node, F32, &search));
        assert!(w.is_some());
    }
}
