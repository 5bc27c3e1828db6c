//! Matching the exposures of photographed probes, which differ from capture to capture.
//!
//! A surface that two probes see has one radiance, if it is Lambertian. With gains g and pixels L, for every point x that
//! probes i and j both show, in each channel:
//!
//! ```text
//!   g_i L_i(x) = g_j L_j(x)    ⇒    ln g_i - ln g_j = ln (L_j(x) / L_i(x))
//! ```
//!
//! 1. Points are found along the probes' own directions (`points`).
//! 2. Each pair of probes gets a robust location of its log ratios, and their spread (Tukey's biweight, MAD).
//! 3. Log gains are fitted to these over the graph of pairs (iteratively reweighted least squares, Huber's weights).
//!    Ratios leave one factor open: in each connected group, and each channel, the median of the log gains is 0. So one
//!    wrong exposure among right ones moves alone.
//!
//! What is left of the log ratios checks the assumption, and the poses. A probe that stands or looks elsewhere than is said
//! shows other surfaces than are asked for: whole regions of it are off, by whatever it is compared with. Where a probe tells
//! distances, these are compared with traced ones as well.
//!
//! Only environment surfaces take part: neither the distant panorama nor what probes show of the sky.
//!
//! In the shipped box (256 × 128, 3.7 % noise between two probes' pixels) gains come out within 0.6 %. One probe of the three
//! moved by 0.5 m along any axis, or turned by 5°, is named by its light alone (the tests hold the cases).

mod points;
mod robust;

use glam::Vec3;
use rayon::prelude::*;
use serde::Serialize;

use crate::Finding;
use crate::panorama::PLANE_TOLERANCE;
use crate::radiance::{PlacedProbe, Probe, Surroundings};
use crate::scene::{Role, Scene};
use crate::trace::{Frame, Surfaces};
use points::{FACE_CELLS, SharedPoint, directions_of, shared_points};
use robust::{Difference, Levelled, Location, between_cells, groups, level, location, median};

/// A pair with fewer points tells nothing, channel by channel.
const LEAST_POINTS: usize = 16;
/// Of a pair's log ratio at best, whatever its points say: interpolation and surfaces that shine err alike in all of them.
const LEAST_ERROR: f64 = 0.002;
/// Residual from which a probe deserves a look, and over that of the pairs without it. In the box, of three probes in their
/// places the worst had 0.006 (the shared inputs) to 0.014 (shipped); moved by 0.5 m or turned by 5° it had 0.032 to 0.14,
/// which is 2.0 to 30 times that of the other pair. In a living room, evenly lit, one of four moved by 0.5 m had 0.022, and
/// one turned by 5° 0.013: light alone does not tell that one.
const SUSPECT_RESIDUAL: f64 = 0.02;
const SUSPECT_RATIO: f64 = 1.6;
/// A few hundred points tell no residual better than this.
const LEAST_RESIDUAL: f64 = 0.01;
/// Of two probes alone.
const SUSPECT_PAIR: f64 = 0.05;
/// Share of a probe's distances that may be off the traced ones, and over the median share of the other probes: all are off
/// where the level is a rough model. In the box: 0, and 0.2 to 0.57 for a probe moved across it, or turned.
const SUSPECT_DISTANCES: f64 = 0.1;
const SUSPECT_DISTANCES_RATIO: f64 = 3.0;
/// Pairs that a finding lists; JSON has all.
const LISTED_PAIRS: usize = 6;

/// Exposures as they were matched.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ExposureMatch {
    /// One per probe, in their order.
    pub probes: Vec<ProbeExposure>,
    /// Pairs with enough points in common, in the order of their probes.
    pub pairs: Vec<PairExposure>,
}

/// What matching found out about one probe.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProbeExposure {
    /// Its name.
    pub name: String,
    /// log2 of the gain on R, G, B, on top of the exposure that was given; 0 where it shares no point with any probe.
    pub stops: [f64; 3],
    /// One standard error of these, against the mean of its group, stops; `None` where it shares no point.
    pub standard_error_stops: Option<[f64; 3]>,
    /// Which of the groups that share no point with each other, from 0; `None` where it is alone.
    pub group: Option<usize>,
    /// Points that it has in common with others.
    pub points: u64,
    /// Residual of its pairs, root mean square by their points: see [`PairExposure::residual`].
    pub residual: Option<f64>,
    /// Share, 0..=1, of its distances that differ from the traced ones by more than 3 %; `None` without distances.
    pub distances_off: Option<f64>,
    /// Why its position, its rotation, or what it shows should be looked at.
    pub suspect: Option<String>,
}

/// What matching found out about two probes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PairExposure {
    /// Indices of the probes.
    pub probes: [usize; 2],
    /// Points that both show.
    pub points: u64,
    /// How much brighter the second shows them, R, G, B, in stops, before matching; not finite in a channel that is black.
    pub stops: [f64; 3],
    /// The same after matching: what the gains of all pairs together leave of it.
    pub stops_left: [f64; 3],
    /// Robust spread (1.4826 × median absolute deviation) of what the points have apart after matching, noise of pixels
    /// included: natural logarithms, so about shares of radiance; root mean square of the channels.
    pub spread: f64,
    /// The same between regions of the surfaces (about 25 degrees wide), noise taken off: what surfaces that shine, or a
    /// wrong pose, explain. `None` of too few regions.
    pub residual: Option<f64>,
}

/// Estimates one gain per probe and channel from the environment surfaces that two or more of them see. Total: who shares no
/// point with any keeps its exposure.
pub fn match_exposure(scene: &Scene, probes: &[Probe]) -> ExposureMatch {
    let frame = Frame::of_scene(scene);
    let placed: Vec<PlacedProbe> = probes.iter().map(|probe| PlacedProbe::new(probe, &frame)).collect();
    let environment = Surfaces::new(scene, |mesh| mesh.role == Role::Environment, &frame).filter(|_| probes.len() > 1);
    let Some(environment) = &environment else { return fit(probes, &[], &vec![None; probes.len()]) };
    let around = Surroundings { scene, frame: &frame, environment, probes, placed: &placed };
    let distances_off: Vec<Option<f64>> =
        (0..probes.len()).into_par_iter().map(|probe| distances_off(&around, probe)).collect();
    fit(probes, &shared_points(&around), &distances_off)
}

/// What the points of one pair say in each channel.
struct Pair {
    probes: [usize; 2],
    points: usize,
    channels: [Option<Location>; 3],
    residual: Option<f64>,
}

impl Pair {
    /// `None` where no channel has enough points.
    fn of(points: &[SharedPoint]) -> Option<Pair> {
        let told = [0, 1, 2].map(|channel| {
            let told = points.iter().map(|point| (point.cell, point.log_ratio[channel]));
            let told: Vec<(u8, f64)> = told.filter(|(_, ratio)| ratio.is_finite()).collect();
            if told.len() >= LEAST_POINTS { told } else { Vec::new() }
        });
        // A part is a face of a cube around either probe: light of one part errs together.
        let by_part = |told: &Vec<(u8, f64)>| told.iter().map(|(cell, v)| (cell / FACE_CELLS, *v)).collect::<Vec<_>>();
        let channels = told.each_ref().map(|told| location(&by_part(told)));
        let apart: Vec<f64> = told.iter().filter_map(|told| between_cells(told)).collect();
        let residual = (!apart.is_empty()).then(|| root_mean_square(apart.iter().copied()));
        let probes = points[0].probes.map(|probe| probe as usize);
        let pair = Pair { probes, points: points.len(), channels, residual };
        channels.iter().any(Option::is_some).then_some(pair)
    }

    fn spread(&self) -> f64 {
        root_mean_square(self.channels.iter().flatten().map(|channel| channel.spread))
    }

    fn difference(&self, channel: usize) -> Option<Difference> {
        let Location { value, standard_error, .. } = self.channels[channel]?;
        let [from, to] = self.probes;
        Some(Difference { from, to, value, standard_error: standard_error.hypot(LEAST_ERROR) })
    }
}

fn root_mean_square(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count().max(1);
    (values.map(|v| v.powi(2)).sum::<f64>() / count as f64).sqrt()
}

fn fit(probes: &[Probe], points: &[SharedPoint], distances_off: &[Option<f64>]) -> ExposureMatch {
    let mut points = points.to_vec();
    points.sort_by_key(|point| point.probes);
    let pairs: Vec<Pair> = points.chunk_by(|a, b| a.probes == b.probes).filter_map(Pair::of).collect();
    let channels: [Levelled; 3] = std::array::from_fn(|channel| {
        level(probes.len(), &pairs.iter().filter_map(|pair| pair.difference(channel)).collect::<Vec<_>>())
    });
    let group = groups(probes.len(), pairs.iter().map(|pair| (pair.probes[0], pair.probes[1])));
    let mut names: Vec<usize> = pairs.iter().map(|pair| group[pair.probes[0]]).collect();
    names.sort_unstable();
    names.dedup();
    let of_probe = |index: usize| {
        let own = || pairs.iter().filter(move |pair| pair.probes.contains(&index));
        let linked = [0, 1, 2].map(|channel| own().any(|pair| pair.channels[channel].is_some()));
        let is_matched = linked.contains(&true);
        ProbeExposure {
            name: probes[index].name.clone(),
            stops: stops_of([0, 1, 2].map(|channel| linked[channel].then_some(channels[channel].values[index]))),
            standard_error_stops: is_matched.then(|| {
                stops_of([0, 1, 2].map(|channel| linked[channel].then_some(channels[channel].standard_errors[index])))
            }),
            group: is_matched.then(|| names.iter().position(|name| *name == group[index])).flatten(),
            points: own().map(|pair| pair.points as u64).sum(),
            residual: None,
            distances_off: distances_off[index],
            suspect: None,
        }
    };
    let probes: Vec<ProbeExposure> = (0..probes.len()).map(of_probe).collect();
    let pairs = pairs.iter().map(|pair| PairExposure::of(pair, &probes)).collect();
    let mut matched = ExposureMatch { probes, pairs };
    for (index, probe) in matched.probes.iter_mut().enumerate() {
        probe.residual = pooled(matched.pairs.iter().filter(|pair| pair.probes.contains(&index)));
    }
    matched.suspect_by_light();
    matched.suspect_by_distances();
    matched
}

/// From natural logarithms. A channel that is black wherever the probe meets others follows its other channels.
fn stops_of(logarithms: [Option<f64>; 3]) -> [f64; 3] {
    let told = logarithms.iter().flatten();
    let mean = told.clone().sum::<f64>() / (told.count().max(1)) as f64;
    logarithms.map(|logarithm| logarithm.unwrap_or(mean) / std::f64::consts::LN_2)
}

impl PairExposure {
    fn of(pair: &Pair, probes: &[ProbeExposure]) -> PairExposure {
        let stops = pair.channels.map(|channel| channel.map_or(f64::NAN, |c| c.value / std::f64::consts::LN_2));
        let [first, second] = pair.probes.map(|probe| probes[probe].stops);
        PairExposure {
            probes: pair.probes,
            points: pair.points as u64,
            stops,
            stops_left: std::array::from_fn(|channel| stops[channel] + second[channel] - first[channel]),
            spread: pair.spread(),
            residual: pair.residual,
        }
    }
}

/// Share of the directions in which the probe's distance is not that of the surface there; `None` without distances.
fn distances_off(around: &Surroundings, probe: usize) -> Option<f64> {
    let (panorama, placed) = (&around.probes[probe].panorama, &around.placed[probe]);
    panorama.pixel_distance(0, 0)?;
    let directions = directions_of(placed, around.probes.len());
    let is_off = |direction: &&Vec3| {
        let (x, y) = panorama.pixel_at(placed.to_local * **direction);
        let toward = placed.to_local.transpose() * panorama.pixel_direction(x, y);
        let told = panorama.pixel_distance(x, y).unwrap_or(f32::INFINITY);
        match around.environment.shown(around.scene, placed.position, toward, f32::INFINITY) {
            None => told.is_finite(),
            Some(hit) => {
                let agrees = (told / around.frame.metres(hit.t) - 1.0).abs() <= PLANE_TOLERANCE;
                !agrees
            }
        }
    };
    Some(directions.iter().filter(is_off).count() as f64 / directions.len() as f64)
}

/// The probe whose pairs agree worst, against the pairs of the others: index, residual with it, and without. `None` where
/// no pair is left to tell it from others.
fn worst_of(pairs: &[&PairExposure]) -> Option<(usize, f64, f64)> {
    let mut probes: Vec<usize> = pairs.iter().flat_map(|pair| pair.probes).collect();
    probes.sort_unstable();
    probes.dedup();
    let told = probes.into_iter().filter_map(|probe| {
        let pairs = |with| pairs.iter().copied().filter(move |pair| pair.probes.contains(&probe) == with);
        Some((probe, pooled(pairs(true))?, pooled(pairs(false))?.max(LEAST_RESIDUAL)))
    });
    told.max_by(|a, b| (a.1 * b.2).total_cmp(&(b.1 * a.2)))
}

/// Residual of several pairs, by their points; `None` of none.
fn pooled<'a>(pairs: impl Iterator<Item = &'a PairExposure>) -> Option<f64> {
    let (mut sum, mut points) = (0.0, 0.0);
    for pair in pairs {
        if let Some(residual) = pair.residual {
            sum += pair.points as f64 * residual.powi(2);
            points += pair.points as f64;
        }
    }
    (points > 0.0).then(|| (sum / points).sqrt())
}

impl ExposureMatch {
    /// Probes that share points with others.
    pub fn matched_count(&self) -> usize {
        self.probes.iter().filter(|probe| probe.group.is_some()).count()
    }

    /// Points that two probes share, of all pairs.
    pub fn point_count(&self) -> u64 {
        self.pairs.iter().map(|pair| pair.points).sum()
    }

    /// Groups that share no point with each other.
    pub fn group_count(&self) -> usize {
        self.probes.iter().filter_map(|probe| probe.group).max().map_or(0, |last| last + 1)
    }

    /// Names the probes whose light is another than the others say.
    ///
    /// A misplaced probe spoils every pair it is in, and so the residual of its neighbours; but not the pairs without it. So
    /// the probe is looked for without which the rest agrees best, and the rest is searched again. Of two probes nobody can
    /// say which is wrong.
    fn suspect_by_light(&mut self) {
        for group in 0..self.group_count() {
            let in_group = |pair: &&PairExposure| self.probes[pair.probes[0]].group == Some(group);
            let mut trusted: Vec<&PairExposure> = self.pairs.iter().filter(in_group).collect();
            let mut suspects = Vec::new();
            if let [PairExposure { probes, residual: Some(residual), .. }] = trusted[..]
                && *residual > SUSPECT_PAIR
            {
                let why = format!(
                    "two probes show the same surfaces {:.1} % apart from region to region: one of them may be misplaced",
                    residual * 100.0
                );
                suspects.extend(probes.map(|probe| (probe, why.clone())));
            }
            while let Some((worst, with, without)) = worst_of(&trusted)
                && with > SUSPECT_RESIDUAL.max(SUSPECT_RATIO * without)
            {
                let why = format!(
                    "what it shows of surfaces differs from other probes by {:.1} % from region to region; without it they \
                     agree to {:.1} %",
                    with * 100.0,
                    without * 100.0
                );
                suspects.push((worst, why));
                trusted.retain(|pair| !pair.probes.contains(&worst));
            }
            suspects.into_iter().for_each(|(probe, why)| self.probes[probe].suspect = Some(why));
        }
    }

    /// Names the probes that tell other distances than are traced from where they stand.
    fn suspect_by_distances(&mut self) {
        let shares: Vec<Option<f64>> = self.probes.iter().map(|probe| probe.distances_off).collect();
        for (index, probe) in self.probes.iter_mut().enumerate() {
            let Some(own) = shares[index] else { continue };
            let others = shares.iter().enumerate().filter(|(other, _)| *other != index);
            let usual = median(&mut others.filter_map(|(_, share)| *share).collect::<Vec<_>>()).unwrap_or(0.0);
            if own > SUSPECT_DISTANCES.max(SUSPECT_DISTANCES_RATIO * usual) {
                let why = format!("{:.0} % of its distances are not those of the level", own * 100.0);
                probe.suspect = Some(probe.suspect.take().map_or(why.clone(), |light| format!("{light}; {why}")));
            }
        }
    }

    /// Multiplies the probes' radiance by the gains: the mean of the channels' stops goes into the exposure, what differs
    /// between channels into the pixels.
    pub fn apply(&self, probes: &mut [Probe]) {
        assert_eq!(probes.len(), self.probes.len(), "the probes that were matched");
        for (probe, found) in probes.iter_mut().zip(&self.probes) {
            let mean = found.stops.iter().sum::<f64>() / 3.0;
            probe.exposure_stops = (f64::from(probe.exposure_stops) + mean) as f32;
            let tint = found.stops.map(|stops| (stops - mean).exp2() as f32);
            probe.panorama.tint(tint);
        }
    }

    /// Rows of the report: gains, residuals, and who deserves a look. None of fewer than two probes.
    pub fn findings(&self) -> Vec<Finding> {
        if self.probes.len() < 2 {
            return Vec::new();
        }
        let mut findings: Vec<Finding> = self.probes.iter().map(ProbeExposure::finding).collect();
        let mut worst: Vec<&PairExposure> = self.pairs.iter().filter(|pair| pair.residual.is_some()).collect();
        worst.sort_by(|a, b| b.residual.partial_cmp(&a.residual).expect("residuals are finite"));
        if !worst.is_empty() {
            let text = |pair: &&PairExposure| {
                let [a, b] = pair.probes.map(|probe| &self.probes[probe].name);
                format!("{a} and {b} {:.1} % over {} points", pair.residual.unwrap_or(0.0) * 100.0, pair.points)
            };
            let listed: Vec<String> = worst.iter().take(LISTED_PAIRS).map(text).collect();
            let more = if worst.len() > LISTED_PAIRS { ", and less between others" } else { "" };
            let message = format!("after matching, regions of surfaces differ between {}{more}", listed.join(", "));
            findings.push(Finding::new("exposure-residual", self.pairs.len() as u64, message));
        }
        if self.group_count() > 1 {
            let names = |group| {
                let members = self.probes.iter().filter(|probe| probe.group == Some(group));
                members.map(|probe| probe.name.as_str()).collect::<Vec<_>>().join(", ")
            };
            let groups = (0..self.group_count()).map(names).collect::<Vec<_>>().join("; ");
            let message =
                format!("no surface is shared between these groups, and each is matched for itself: {groups}");
            findings.push(Finding::new("exposure-groups", self.group_count() as u64, message));
        }
        let suspects = self.probes.iter().filter_map(|probe| Some((probe, probe.suspect.as_ref()?)));
        findings.extend(suspects.map(|(probe, why)| {
            let message = format!("{}: {why}; check its position and rotation, and surfaces that shine", probe.name);
            Finding::new("suspect-probe", 1, message)
        }));
        findings
    }
}

impl ProbeExposure {
    fn finding(&self) -> Finding {
        let Some(errors) = self.standard_error_stops else {
            let message = format!("{}: shares no lit surface with another probe, and keeps its exposure", self.name);
            return Finding::new("unmatched-exposure", 1, message);
        };
        let [r, g, b] = self.stops;
        let [er, eg, eb] = errors;
        let residual = self.residual.map_or(String::new(), |r| format!(", residual {:.1} %", r * 100.0));
        let message = format!(
            "{}: exposure changed by {r:+.3} {g:+.3} {b:+.3} stops (R G B; standard errors {er:.3} {eg:.3} {eb:.3}) by {} points\
             {residual}",
            self.name, self.points
        );
        Finding::new("matched-exposure", self.points, message)
    }
}
