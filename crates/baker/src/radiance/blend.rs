//! How much each probe that sees a surface point counts: the blend rules.
//!
//! Based on: K. Vestergaard, "Geometrically Derived Image Based Lighting", 2008, eqs. 3.2 to 3.4; Franke and
//! Nielson, modified Shepard weights, 1980 (`angular-smooth`). The default, `footprint:4`, is this project's: a
//! probe counts by the number of its pixels that cover a unit of surface there. A probe that sees a wall at a
//! grazing angle smears its light over metres, and the angle at which the *node* looks does not tell.
//!
//! Weights are computed in ratios to the best probe, so no power overflows and a zero angle is an ordinary case.

use serde::{Deserialize, Serialize};

/// A blend rule with its power k ≥ 0.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, bincode::Encode, bincode::Decode)]
pub enum BlendRule {
    /// 1/d^k over all probes (report, eq. 3.2).
    Distance(f32),
    /// 1/angle^k over the two smallest angles between the directions to the probe and to the node (eqs. 3.3, 3.4).
    Angular(f32),
    /// ((R-angle)/(R·angle))^k over the two smallest, R the third smallest (π if there is none).
    AngularSmooth(f32),
    /// The smallest angle alone.
    Nearest,
    /// (N cosθ/d²)^k over all probes: pixels of the probe per unit of surface.
    Footprint(f32),
}

impl Default for BlendRule {
    fn default() -> Self {
        BlendRule::Footprint(4.0)
    }
}

/// How one probe stands to a surface point x_e.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// ‖p - x_e‖ > 0, trace units.
    pub distance: f32,
    /// Cosine between the surface normal and the direction to the probe, 0..=1.
    pub cosine: f32,
    /// Angle at x_e between the directions to the probe and to the node, radians 0..=π; of no account to a
    /// [seamless](BlendRule::is_seamless) rule.
    pub angle: f32,
    /// Pixels of the probe's panorama.
    pub pixels: f32,
}

impl BlendRule {
    /// How well a probe stands, 0 to +infinity: the greatest is the best. Weights are powers of ratios of it, but
    /// for `angular-smooth`.
    pub fn merit(&self, view: &View) -> f32 {
        match self {
            BlendRule::Distance(_) => 1.0 / view.distance,
            BlendRule::Angular(_) | BlendRule::AngularSmooth(_) | BlendRule::Nearest => 1.0 / view.angle,
            BlendRule::Footprint(_) => view.pixels * view.cosine / (view.distance * view.distance),
        }
    }

    /// Between what a probe's merit lies, least first, on points of a plane that are `distances` (the least, the greatest) from
    /// it, if it stands `height` over the plane.
    pub fn merit_bounds(&self, pixels: f32, height: f32, distances: [f32; 2]) -> [f32; 2] {
        if !self.is_seamless() {
            return [0.0, f32::INFINITY];
        }
        let [most, least] =
            distances.map(|distance| self.merit(&View { distance, cosine: height / distance, angle: 0.0, pixels }));
        [least, most]
    }

    /// Weights depend on the surface point alone, not on where the node stands: its radiance is the same for all nodes.
    pub fn is_seamless(&self) -> bool {
        matches!(self, BlendRule::Distance(_) | BlendRule::Footprint(_))
    }

    /// How many of the best probes can have a weight at all.
    pub fn reach(&self) -> usize {
        match self {
            BlendRule::Nearest => 1,
            BlendRule::Angular(_) => 2,
            // The third only says where the second's weight ends.
            BlendRule::AngularSmooth(_) => 3,
            BlendRule::Distance(_) | BlendRule::Footprint(_) => usize::MAX,
        }
    }

    /// The weight of a probe of merit `merit` as a share of that of the best, 0..=1; 0 below half of [`FAINT`]. Not for
    /// `angular-smooth`, whose weights depend on a third probe.
    pub fn ratio(&self, merit: f32, best: f32) -> f32 {
        let power = match *self {
            BlendRule::Distance(k) | BlendRule::Angular(k) | BlendRule::Footprint(k) => k,
            BlendRule::AngularSmooth(_) | BlendRule::Nearest => return 1.0,
        };
        // Equal first: that covers two infinite merits (zero angles) and two zero ones.
        if merit == best { 1.0 } else { fade((merit / best).powf(power)) }
    }

    /// Weights ≥ 0, at least one of them positive, of probes given by merit, best first. `merits` must have at
    /// least one entry and at most [`BlendRule::reach`].
    pub fn weights(&self, merits: &[f32], weights: &mut Vec<f32>) {
        weights.clear();
        let best = merits[0];
        let BlendRule::AngularSmooth(power) = *self else {
            weights.extend(merits.iter().map(|&merit| self.ratio(merit, best)));
            return;
        };
        // ((R - a)/(R·a))^k = (1/a - 1/R)^k, and merit = 1/a.
        let ends = merits.get(2).copied().unwrap_or(1.0 / std::f32::consts::PI);
        let shares = merits.iter().take(2).map(|&merit| {
            if merit == best || best == f32::INFINITY {
                f32::from(merit == best)
            } else {
                (((merit - ends) / (best - ends)).max(0.0)).powf(power)
            }
        });
        weights.extend(shares);
        weights.resize(merits.len(), 0.0);
        if merits.len() == 3 && merits[2] == best {
            // All three tie: equal weights.
            weights[2] = 1.0;
        }
    }
}

/// Weights under this share of the best one fade, to nothing at half of it: light stays continuous, and probes that would
/// change it by less than noise need no line of sight. What n probes lose that way is less than n × FAINT of the whole, and
/// changes radiance by at most that share of what probes differ by. Against 1e-3, E by 60 probes changed by 0.006 % in the box
/// and by 0.005 % in a living room, root mean square, and bakes took a seventh less time; 3e-2 saved no more.
pub const FAINT: f32 = 1e-2;

fn fade(weight: f32) -> f32 {
    weight * (2.0 * weight / FAINT - 1.0).clamp(0.0, 1.0)
}

impl std::fmt::Display for BlendRule {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            BlendRule::Distance(k) => write!(f, "distance:{k}"),
            BlendRule::Angular(k) => write!(f, "angular:{k}"),
            BlendRule::AngularSmooth(k) => write!(f, "angular-smooth:{k}"),
            BlendRule::Nearest => write!(f, "nearest"),
            BlendRule::Footprint(k) => write!(f, "footprint:{k}"),
        }
    }
}

impl std::str::FromStr for BlendRule {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, power) = match text.split_once(':') {
            None => (text, None),
            Some((name, k)) => {
                let k: f32 = k.parse().map_err(|_| format!("the power in '{text}' is not a number"))?;
                if !(k >= 0.0 && k.is_finite()) {
                    return Err(format!("the power in '{text}' must be finite and at least 0"));
                }
                (name, Some(k))
            }
        };
        match (name, power) {
            ("distance", k) => Ok(BlendRule::Distance(k.unwrap_or(2.0))),
            ("angular", k) => Ok(BlendRule::Angular(k.unwrap_or(2.0))),
            ("angular-smooth", k) => Ok(BlendRule::AngularSmooth(k.unwrap_or(2.0))),
            ("nearest", None) => Ok(BlendRule::Nearest),
            ("footprint", k) => Ok(BlendRule::Footprint(k.unwrap_or(4.0))),
            _ => Err(format!(
                "'{text}' is no blend rule; there are distance:k, angular:k, angular-smooth:k, nearest, footprint:k"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn weigh(rule: BlendRule, views: &[View]) -> Vec<f32> {
        let mut merits: Vec<f32> = views.iter().map(|v| rule.merit(v)).collect();
        merits.sort_by(|a, b| b.total_cmp(a));
        merits.truncate(rule.reach());
        let mut weights = Vec::new();
        rule.weights(&merits, &mut weights);
        let sum: f32 = weights.iter().sum();
        weights.iter().map(|w| w / sum).collect()
    }

    fn at(distance: f32, cosine: f32, angle: f32) -> View {
        View { distance, cosine, angle, pixels: 1024.0 }
    }

    fn every_rule() -> Vec<BlendRule> {
        let powers = [0.0, 0.5, 1.0, 4.0, 1e3];
        let mut rules = vec![BlendRule::Nearest];
        for k in powers {
            rules.extend([
                BlendRule::Distance(k),
                BlendRule::Angular(k),
                BlendRule::AngularSmooth(k),
                BlendRule::Footprint(k),
            ]);
        }
        rules
    }

    #[test]
    fn weights_are_finite_and_sum_to_one_in_every_extreme() {
        let views =
            [at(1.0, 1.0, 0.0), at(1.0, 1.0, 0.0), at(1e-30, 1e-7, 3.2), at(1e6, 1.0, 1e-20), at(3.0, 1e-7, 1.0)];
        for rule in every_rule() {
            for count in 1..=views.len() {
                for start in 0..=views.len() - count {
                    let weights = weigh(rule, &views[start..start + count]);
                    assert!(weights.iter().all(|w| *w >= 0.0 && w.is_finite()), "{rule} {weights:?}");
                    assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-5, "{rule} {weights:?}");
                }
            }
            let many: Vec<View> = (0..64).map(|i| at(1.0 + i as f32, 0.5, 0.1 * i as f32)).collect();
            assert!((weigh(rule, &many).iter().sum::<f32>() - 1.0).abs() < 1e-5);
        }
    }

    #[test]
    fn rules_follow_their_equations() {
        let views = [at(1.0, 0.5, 0.2), at(2.0, 1.0, 0.4), at(4.0, 1.0, 0.8)];
        let close = |rule, expected: &[f32]| {
            let weights = weigh(rule, &views);
            for (w, e) in weights.iter().zip(expected) {
                assert!((w - e).abs() < 1e-6, "{rule} {weights:?} {expected:?}");
            }
        };
        close(BlendRule::Distance(1.0), &[4.0 / 7.0, 2.0 / 7.0, 1.0 / 7.0]);
        close(BlendRule::Angular(1.0), &[2.0 / 3.0, 1.0 / 3.0]);
        close(BlendRule::Nearest, &[1.0]);
        // N cos/d²: 0.5, 0.25, 0.0625
        close(BlendRule::Footprint(1.0), &[8.0 / 13.0, 4.0 / 13.0, 1.0 / 13.0]);
        // (R-a)/(R·a), R = 0.8: 0.6/0.16 = 3.75 and 0.4/0.32 = 1.25
        close(BlendRule::AngularSmooth(1.0), &[0.75, 0.25, 0.0]);
    }

    #[test]
    fn angular_smooth_does_not_jump_when_the_second_probe_changes() {
        let before =
            weigh(BlendRule::AngularSmooth(2.0), &[at(1.0, 1.0, 0.2), at(1.0, 1.0, 0.5), at(1.0, 1.0, 0.500001)]);
        assert!(before[1] < 1e-6, "the second fades as the third comes near: {before:?}");
        let tie = weigh(BlendRule::AngularSmooth(2.0), &[at(1.0, 1.0, 0.5); 3]);
        assert_eq!(tie, vec![1.0 / 3.0; 3]);
    }

    #[test]
    fn rules_parse_and_print() {
        for rule in every_rule() {
            assert_eq!(rule.to_string().parse::<BlendRule>(), Ok(rule));
        }
        for bad in ["", "foot", "footprint:x", "footprint:-1", "footprint:inf", "nearest:2"] {
            assert!(bad.parse::<BlendRule>().is_err(), "{bad}");
        }
    }

    #[test]
    fn faint_probes_change_light_by_less_than_their_bound_and_without_a_step() {
        // One black probe near, 63 that see white recede from it: the worst contrast there is.
        let rule = BlendRule::Footprint(4.0);
        let light = |weights: &[f64]| weights[1..].iter().sum::<f64>() / weights.iter().sum::<f64>();
        let mut before: Option<f64> = None;
        let (mut most, mut least_faded) = (0.0f64, usize::MAX);
        for step in 0..20_000 {
            let distance = 1.0 + f64::from(step) * 2e-4;
            let views: Vec<View> = (0..64)
                .map(|i| at(if i == 0 { 1.0 } else { (distance * (1.0 + 0.01 * f64::from(i))) as f32 }, 0.5, 0.0))
                .collect();
            let merits: Vec<f32> = views.iter().map(|view| rule.merit(view)).collect();
            let mut faded = Vec::new();
            rule.weights(&merits, &mut faded);
            let whole: Vec<f64> = merits.iter().map(|m| f64::from(m / merits[0]).powi(4)).collect();
            let faded: Vec<f64> = faded.iter().map(|w| f64::from(*w)).collect();
            let (shown, full) = (light(&faded), light(&whole));
            most = most.max((shown - full).abs());
            least_faded = least_faded.min(faded.iter().filter(|w| **w > 0.0).count());
            assert!(before.is_none_or(|before| (before - shown).abs() < 0.02), "a step at {distance}");
            before = Some(shown);
        }
        assert_eq!(least_faded, 1, "far away all have faded");
        let bound = 63.0 * f64::from(FAINT);
        assert!(most < bound && most > bound / 100.0, "{most} {bound}");
    }

    #[test]
    fn bounds_of_merit_hold() {
        for rule in every_rule() {
            let [least, most] = rule.merit_bounds(1024.0, 0.5, [1.0, 3.0]);
            for distance in [1.0, 1.5, 3.0] {
                let merit = rule.merit(&at(distance, 0.5 / distance, 0.3));
                assert!(least <= merit && merit <= most, "{rule} {distance}: {least} {merit} {most}");
            }
        }
    }
}
