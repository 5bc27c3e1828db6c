//! What is done where no probe counts: paths by the level's own materials, where these can be trusted, or nothing.
//!
//! Materials can be trusted where they explain what probes show. That is measured at surface points that probes see and that rays
//! from nodes meet, so that surfaces count as nodes see them: radiance by probes, and by paths through the level. Photographs have
//! an exposure and a white balance of their own; so a gain per channel, the median ratio of the two, brings paths to the probes'
//! scale. What is left between them tells materials and lights that are the place's own from dummies.
//!
//! A path at one point is far noisier than what is asked for. So points are put together in groups, each of one material and of
//! neighbours, and sums are compared.

use glam::Vec3;
use serde::Serialize;

/// What is done where no probe counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Unseen {
    /// Paths, where the level's materials agree with what probes show; else nothing.
    #[default]
    Auto,
    /// Paths by the level's materials.
    Trace,
    /// Nothing: the integrator fills directions from those that are covered.
    Fill,
}

/// What was chosen, and why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UnseenChoice {
    /// The level's materials explain what probes show: paths may stand in for probes, or judge them.
    pub trusted: bool,
    /// Paths are traced where no probe counts.
    pub traced: bool,
    /// Median difference between probes and paths over the surfaces that both were asked about, exposure matched, as a share of
    /// their mean; `None` where it was not measured.
    pub agreement: Option<f64>,
    /// Surface points at which they were compared.
    pub points: u64,
    /// Share of the surface points met by rays from nodes that no probe counts at, 0..=1.
    pub unseen_share: f64,
    /// Factor of traced light on R, G, B: 1 where exposures agree.
    pub gain: [f32; 3],
    /// One sentence.
    pub why: String,
}

impl UnseenChoice {
    /// Nothing is traced, for this reason.
    pub(super) fn fill(why: &str) -> UnseenChoice {
        UnseenChoice {
            trusted: false,
            traced: false,
            agreement: None,
            points: 0,
            unseen_share: 0.0,
            gain: [1.0; 3],
            why: why.into(),
        }
    }
}

/// So many of the nodes, spread evenly, are places enough to look from.
pub const UNSEEN_PLACES: usize = 256;

/// Probes and paths must agree this well, median and upper quartile. Retuned by `tools/never_worse`.
pub const TRUSTED: [f64; 2] = [0.15, 0.35];
/// Points of a group.
const GROUP: usize = 32;
/// Fewer groups tell nothing.
const LEAST_GROUPS: usize = 4;
/// Gains of channels this near to each other, natural logarithm, are the same.
const SAME_GAIN: f64 = 0.05;

/// A surface point, as both tell it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Compared {
    /// Points that lie together, and share a material, stand together by this.
    pub order: (u32, u64),
    /// Radiance by probes.
    pub shown: Vec3,
    /// Radiance by paths, the mean of some.
    pub traced: Vec3,
}

/// Points of one material that lie together: sums over every other of them, and over the rest.
#[derive(Debug, Clone, Copy)]
struct Group {
    weight: f64,
    shown: [Vec3; 2],
    traced: [Vec3; 2],
}

impl Group {
    fn of(points: &[Compared]) -> Group {
        let mut group = Group { weight: points.len() as f64, shown: [Vec3::ZERO; 2], traced: [Vec3::ZERO; 2] };
        for (number, point) in points.iter().enumerate() {
            group.shown[number % 2] += point.shown;
            group.traced[number % 2] += point.traced;
        }
        group
    }

    /// Differences over the mean of both: of what probes and paths say, and of what chance alone makes of that, by its halves.
    fn differences(&self, gain: Vec3) -> [f64; 2] {
        let [first, second] = [0, 1].map(|half| self.shown[half] - self.traced[half] * gain);
        let both = self.shown[0] + self.shown[1] + (self.traced[0] + self.traced[1]) * gain;
        let both = f64::from(both.element_sum()) / 2.0;
        let over_both = |apart: Vec3| if both > 0.0 { f64::from(apart.abs().element_sum()) / both } else { 0.0 };
        [over_both(first + second), over_both(first - second)]
    }
}

/// How well probes and paths agree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// Difference over the mean of both, of the median group and of three quarters, less what chance makes of it (noise of paths and of
    /// probes, a pixel against a point of a texture): squares of the two add up.
    pub quartiles: [f64; 2],
    /// The same of chance.
    pub noise: [f64; 2],
    /// What brings paths to the probes' scale.
    pub gain: Vec3,
}

impl Agreement {
    /// The level's materials can be trusted: they agree, and chance does not hide that they do not.
    pub fn is_trusted(&self) -> bool {
        !self.is_drowned() && self.quartiles.iter().zip(TRUSTED).all(|(found, most)| *found <= most)
    }

    /// Chance hides what there may be.
    pub fn is_drowned(&self) -> bool {
        self.noise[0] > 2.0 * TRUSTED[0]
    }

    /// Of points in any order. `None` where too few are lit by both.
    pub fn of(mut points: Vec<Compared>) -> Option<Agreement> {
        points.sort_by_key(|point| point.order);
        let of_material = points.chunk_by(|a, b| a.order.0 == b.order.0);
        let groups: Vec<Group> = of_material.flat_map(|points| points.chunks(GROUP)).map(Group::of).collect();
        let gain = gain(&groups)?;
        // Rendered probes share the level's own exposure, and then no chance shall change it.
        let same = Agreement::with(&groups, Vec3::ONE);
        Some(if same.is_trusted() { same } else { Agreement::with(&groups, gain) })
    }

    fn with(groups: &[Group], gain: Vec3) -> Agreement {
        let quartiles = |of: usize| {
            let own = groups.iter().map(|group| (group.differences(gain)[of], group.weight));
            let mut own: Vec<(f64, f64)> = own.collect();
            [0.5, 0.75].map(|share| quantile(&mut own, share))
        };
        let (found, noise) = (quartiles(0), quartiles(1));
        let quartiles = std::array::from_fn(|i| (found[i].powi(2) - noise[i].powi(2)).max(0.0).sqrt());
        Agreement { quartiles, noise, gain }
    }
}

/// The median ratio of each channel, or one of all where these hardly differ.
fn gain(groups: &[Group]) -> Option<Vec3> {
    let ratios = |channel: usize| {
        let of = move |group: &Group| {
            let [shown, traced] =
                [group.shown, group.traced].map(|halves| f64::from(halves[0][channel] + halves[1][channel]));
            (shown > 0.0 && traced > 0.0).then(|| ((shown / traced).ln(), group.weight))
        };
        groups.iter().filter_map(of).collect::<Vec<_>>()
    };
    let mut all: Vec<(f64, f64)> = (0..3).flat_map(ratios).collect();
    if all.len() < 3 * LEAST_GROUPS {
        return None;
    }
    let common = quantile(&mut all, 0.5);
    let of_channel = |channel: usize| {
        let mut own = ratios(channel);
        if own.len() < LEAST_GROUPS { common } else { quantile(&mut own, 0.5) }
    };
    let channels = [0, 1, 2].map(of_channel);
    let is_common = channels.iter().all(|gain| (gain - common).abs() <= SAME_GAIN);
    let channels = if is_common { [common; 3] } else { channels };
    Some(Vec3::from(channels.map(|gain| gain.exp() as f32)))
}

/// Of weighted values, the one below which this share of the weight lies.
fn quantile(values: &mut [(f64, f64)], share: f64) -> f64 {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = values.iter().map(|(_, weight)| weight).sum();
    let mut below = 0.0;
    for (value, weight) in values.iter() {
        below += weight;
        if below >= share * total {
            return *value;
        }
    }
    values.last().map_or(0.0, |(value, _)| *value)
}

/// Place of a position on a curve through the level's box that keeps neighbours together (Morton, 1966); `place`: 0..=1 per axis.
pub fn curve_of(place: Vec3) -> u64 {
    const BITS: u32 = 10;
    let bits = |number: f32, axis: u32| {
        let number = (number.clamp(0.0, 1.0) * ((1 << BITS) - 1) as f32) as u64;
        (0..BITS).map(|bit| (number >> bit & 1) << (3 * bit + axis)).sum::<u64>()
    };
    bits(place.x, 0) | bits(place.y, 1) | bits(place.z, 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{Sampler, Stream};

    /// 32 groups on a line; paths find each point's light within a factor of e^±0.5, uniform in the logarithm.
    fn points(light: impl Fn(u32) -> [Vec3; 2]) -> Vec<Compared> {
        let stream = Stream::new(Sampler::Random, 0, 0, 0);
        let point = |i: u32| {
            let [shown, traced] = light(i / 32);
            let traced = traced * (stream.random(i, 0) - 0.5).exp();
            Compared { order: (0, u64::from(i)), shown, traced }
        };
        // In another order than they lie.
        (0..1024).map(|i| point(i * 37 % 1024)).collect()
    }

    #[test]
    fn exposure_and_white_balance_are_taken_out() {
        // A group's noise: a factor's spread of 0.29 over 32 points, 5 %; the median of a gain over 32 groups, under 2 %, and the mean
        // of the factor is 4 % over 1.
        let gain = Vec3::new(8.0, 4.0, 2.0);
        let shown = |group: u32| Vec3::new(1.0, 0.5, 0.1) * (1.0 + group as f32);
        let found = Agreement::of(points(|group| [shown(group) * gain, shown(group)])).unwrap();
        assert!((found.gain / gain - Vec3::ONE).abs().max_element() < 0.06, "{}", found.gain);
        assert!(found.is_trusted(), "{found:?}");
        let same = Agreement::of(points(|group| [shown(group), shown(group)])).unwrap();
        assert_eq!(same.gain, Vec3::ONE, "no gain within noise");
    }

    #[test]
    fn other_albedos_are_not_trusted() {
        // Surfaces of albedo 0.1 to 0.9 under the same light, against grey.
        let shown = |group: u32| Vec3::splat(0.1 + 0.8 * (group * 13 % 32) as f32 / 32.0);
        let found = Agreement::of(points(|group| [shown(group), Vec3::splat(0.5)])).unwrap();
        assert!(!found.is_trusted(), "{found:?}");
    }

    #[test]
    fn noise_is_no_disagreement_and_too_much_of_it_no_agreement() {
        let stream = Stream::new(Sampler::Random, 1, 0, 0);
        // One path in so many finds all of the light.
        let found = |rare: f32| {
            let traced = |i: u32| if stream.random(i, 0) < 1.0 / rare { Vec3::splat(rare) } else { Vec3::ZERO };
            let point = |i: u32| Compared { order: (0, u64::from(i)), shown: Vec3::ONE, traced: traced(i) };
            Agreement::of((0..1024).map(point).collect()).unwrap()
        };
        let some = found(2.0);
        assert!(some.is_trusted() && some.gain == Vec3::ONE && some.noise[0] > 0.05, "{some:?}");
        let much = found(20.0);
        assert!(much.is_drowned() && !much.is_trusted(), "{much:?}");
    }

    #[test]
    fn darkness_and_nothing_tell_nothing() {
        assert_eq!(Agreement::of(Vec::new()), None);
        assert_eq!(Agreement::of(points(|_| [Vec3::ONE, Vec3::ZERO])), None);
    }
}
