//! Where probes should stand, given those that stand already.
//!
//! What the level's free space sees ([`FreeSpace`]) is what nodes there will ask probes for. A surface point counts by how
//! finely its best probe resolves it, and the gain of a set of probes is the sum over the points:
//!
//! ```text
//!     F(P) = 1/N Σ_x max_{p ∈ P} q(p, x)
//!     q(p, x) = 0 where p does not see x, else SEEN + (1 - SEEN) min(1, cosθ d0²/d²)^(1/4)
//! ```
//! Candidates are the free places themselves, so that for every point there is one that sees it. Greedily, the candidate that
//! adds most to F joins; F is monotone and submodular, so that reaches 63 % of the optimum or more (Nemhauser, Wolsey,
//! Fisher, "An analysis of approximations for maximizing submodular set functions", 1978). Then each probe in turn goes to where
//! it adds most beside the others (their interchange heuristic), among the candidates and around them, and probes
//! that the others have made superfluous go.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::f64::consts::PI;

pub use super::free_space::FREE_PLACES;
use super::free_space::{FreeSpace, Looker};
use crate::radiance::RadianceFunction;
use crate::radiance::path::Path;
use crate::trace::Hit;
use crate::{Control, Interrupted};

/// How probes are placed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaceSettings {
    /// At most so many new ones.
    pub most: usize,
    /// A further probe must add at least this share of all that could be gained. Small, because a corner that no probe sees
    /// costs more than a probe: in the README's living room E is off by 5.7 % with 8 probes, by 0.5 % with 12
    /// (`tools/placement_table`).
    pub gain: f64,
}

impl Default for PlaceSettings {
    fn default() -> Self {
        PlaceSettings { most: 32, gain: 0.003 }
    }
}

/// Where probes should stand.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Placement {
    /// Free places that the level was looked at from; none where all is solid.
    pub places: usize,
    /// What the probes see that stand already.
    pub before: Reach,
    /// The most useful first. Empty where nothing is to be gained.
    pub suggestions: Vec<Suggestion>,
}

/// A place for a probe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Suggestion {
    /// World metres.
    pub position: DVec3,
    /// What it adds to F, 0..=1, to the probes before it.
    pub gain: f64,
    /// What it and the probes before it see.
    pub after: Reach,
}

/// How much of what the free space sees probes see, well or badly.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Reach {
    /// Share of the surfaces, by solid angle, 0..=1.
    pub coverage: f64,
    /// Surfaces that no probe sees, sr of the sphere of a free place, in the mean.
    pub uncovered: f64,
}

impl Placement {
    /// World positions of the suggested probes.
    pub fn positions(&self) -> Vec<DVec3> {
        self.suggestions.iter().map(|suggestion| suggestion.position).collect()
    }
}

/// Rays of the free space against which probes are weighed, about.
const SIGHTS: usize = 8192;
/// What of a point's worth is to be seen at all. With 0.8 fewer probes see 98 % of a level than with 0.5: in the README's
/// apartment 10 instead of 14, among candidates on a lattice.
const SEEN: f32 = 0.8;
/// Rounds in which probes make way for each other.
const ROUNDS: usize = 3;
/// A probe moves for a gain of this share of F at least.
const WORTH_MOVING: f64 = 1e-4;

/// Suggests probes beside those at `existing` (world metres), for what `path` traces in the box (world metres). All probes are
/// taken to have as many pixels. Tells its progress in free places, of which there are about [`FREE_PLACES`].
pub fn place_probes(
    path: &Path,
    bounds: (DVec3, DVec3),
    existing: &[DVec3],
    settings: &PlaceSettings,
    control: &Control,
) -> Result<Placement, Interrupted> {
    let looker = Looker::new(path);
    let space = FreeSpace::find(&looker, bounds, control)?;
    let Some(view) = View::of(&space, &looker, bounds, control)? else {
        return Ok(Placement { places: space.places.len(), ..Placement::default() });
    };
    let mut given = vec![0.0; view.points.len()];
    for position in existing {
        join(&mut given, &view.qualities(path.frame().to_trace(*position)));
    }
    let candidate = |place: &Vec3| {
        control.go_on()?;
        let candidate = view.stand(*place);
        (control.progress)(1, view.points.len() as u64);
        Ok(candidate)
    };
    let candidates: Vec<Chosen> = space.places.par_iter().map(candidate).collect::<Result<_, _>>()?;
    let mut chosen = Vec::new();
    view.add(&mut chosen, &candidates, &given, settings, control)?;
    for _ in 0..ROUNDS {
        let (count, before) = (chosen.len(), view.worth(&chosen, &given));
        view.exchange(&mut chosen, &candidates, &given, control)?;
        view.drop_superfluous(&mut chosen, &given, settings, control)?;
        view.add(&mut chosen, &candidates, &given, settings, control)?;
        if chosen.len() == count && view.worth(&chosen, &given) < before + WORTH_MOVING {
            break;
        }
    }
    Ok(Placement {
        places: space.places.len(),
        before: view.reach(&given),
        suggestions: view.in_order(chosen, given, path),
    })
}

/// A place with how well a probe there resolves each point, 0..=1.
#[derive(Clone)]
struct Chosen {
    /// Trace space.
    place: Vec3,
    qualities: Vec<f32>,
}

/// What the free space sees.
struct View<'a> {
    looker: &'a Looker<'a>,
    /// The box of the free space, trace space.
    bounds: (Vec3, Vec3),
    /// Between candidates, about, trace units.
    spacing: f32,
    points: Vec<Hit>,
    /// Points and rays that escape.
    directions: usize,
    /// d0: from here a probe that looks straight at a surface resolves it well enough, trace units.
    enough: f32,
}

impl<'a> View<'a> {
    /// `None` where there is no surface to see.
    fn of(
        space: &FreeSpace,
        looker: &'a Looker<'a>,
        (min, max): (DVec3, DVec3),
        control: &Control,
    ) -> Result<Option<View<'a>>, Interrupted> {
        let each = SIGHTS.div_ceil(space.places.len().max(1)) as u32;
        let sights = space.sights(looker.path, each, control)?;
        let points: Vec<Hit> = sights.iter().filter_map(|sight| sight.hit).collect();
        if points.is_empty() {
            return Ok(None);
        }
        // As near as the free space itself is to what it sees, in the median.
        let mut distances: Vec<f32> = points.iter().map(|point| point.t).collect();
        let middle = distances.len() / 2;
        let enough = *distances.select_nth_unstable_by(middle, f32::total_cmp).1;
        let frame = looker.path.frame();
        let bounds = (frame.to_trace(min), frame.to_trace(max));
        Ok(Some(View { looker, bounds, spacing: space.spacing, points, directions: sights.len(), enough }))
    }

    fn stand(&self, place: Vec3) -> Chosen {
        Chosen { place, qualities: self.qualities(place) }
    }

    fn qualities(&self, place: Vec3) -> Vec<f32> {
        self.points.iter().map(|point| self.quality(place, point)).collect()
    }

    /// q(p, x). The fourth root: a wall seen at a tenth of the resolution is not ten times as bad.
    fn quality(&self, place: Vec3, point: &Hit) -> f32 {
        let line = place - point.position;
        let squared = line.length_squared();
        let resolution = line.dot(point.normal) / squared.sqrt() * self.enough * self.enough / squared;
        if resolution > 0.0 && self.looker.path.sees(point, place) {
            SEEN + (1.0 - SEEN) * resolution.min(1.0).sqrt().sqrt()
        } else {
            0.0
        }
    }

    /// What a probe adds to F.
    fn gain(&self, qualities: &[f32], best: &[f32]) -> f64 {
        let gain: f64 = qualities.iter().zip(best).map(|(q, b)| f64::from((q - b).max(0.0))).sum();
        gain / self.points.len() as f64
    }

    /// The candidate that adds most, and how much.
    fn most_useful(&self, candidates: &[Chosen], best: &[f32]) -> Option<(usize, f64)> {
        let gains: Vec<f64> = candidates.par_iter().map(|c| self.gain(&c.qualities, best)).collect();
        // Of equal ones the first.
        (0..gains.len()).max_by(|&a, &b| gains[a].total_cmp(&gains[b]).then(b.cmp(&a))).map(|i| (i, gains[i]))
    }

    /// Greedily, as long as it pays.
    fn add(
        &self,
        chosen: &mut Vec<Chosen>,
        candidates: &[Chosen],
        given: &[f32],
        settings: &PlaceSettings,
        control: &Control,
    ) -> Result<(), Interrupted> {
        let mut best = best_of(chosen.iter(), given);
        while chosen.len() < settings.most
            && let Some((index, gain)) = self.most_useful(candidates, &best)
            && gain > 0.0
            && gain >= settings.gain
        {
            control.go_on()?;
            join(&mut best, &candidates[index].qualities);
            chosen.push(candidates[index].clone());
        }
        Ok(())
    }

    /// Each probe goes to where it adds most beside the others.
    fn exchange(
        &self,
        chosen: &mut [Chosen],
        candidates: &[Chosen],
        given: &[f32],
        control: &Control,
    ) -> Result<(), Interrupted> {
        for index in 0..chosen.len() {
            control.go_on()?;
            let others = best_of(chosen.iter().enumerate().filter(|(i, _)| *i != index).map(|(_, c)| c), given);
            let mut own = chosen[index].clone();
            let mut gain = self.gain(&own.qualities, &others);
            if let Some((better, more)) = self.most_useful(candidates, &others)
                && more > gain + WORTH_MOVING
            {
                (own, gain) = (candidates[better].clone(), more);
            }
            for step in [0.5, 0.25] {
                let places = [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z]
                    .map(|axis| own.place + axis * (step * self.spacing));
                let near: Vec<Chosen> = places
                    .par_iter()
                    .filter(|place| self.is_inside(**place) && self.looker.is_free(**place, 0))
                    .map(|place| self.stand(*place))
                    .collect();
                (control.progress)(0, (near.len() * self.points.len()) as u64);
                if let Some((better, more)) = self.most_useful(&near, &others)
                    && more > gain + WORTH_MOVING
                {
                    (own, gain) = (near[better].clone(), more);
                }
            }
            chosen[index] = own;
        }
        Ok(())
    }

    fn is_inside(&self, place: Vec3) -> bool {
        place.cmpge(self.bounds.0).all() && place.cmple(self.bounds.1).all()
    }

    /// The least useful first, those go without which too little is lost.
    fn drop_superfluous(
        &self,
        chosen: &mut Vec<Chosen>,
        given: &[f32],
        settings: &PlaceSettings,
        control: &Control,
    ) -> Result<(), Interrupted> {
        let loss = |chosen: &[Chosen], index: usize| {
            let others = best_of(chosen.iter().enumerate().filter(|(i, _)| *i != index).map(|(_, c)| c), given);
            self.gain(&chosen[index].qualities, &others)
        };
        while let Some((index, least)) =
            (0..chosen.len()).map(|i| (i, loss(chosen, i))).min_by(|a, b| a.1.total_cmp(&b.1))
            && least < settings.gain
        {
            control.go_on()?;
            chosen.remove(index);
        }
        Ok(())
    }

    /// F.
    fn worth(&self, chosen: &[Chosen], given: &[f32]) -> f64 {
        best_of(chosen, given).iter().map(|q| f64::from(*q)).sum::<f64>() / self.points.len() as f64
    }

    /// The most useful first.
    fn in_order(&self, mut chosen: Vec<Chosen>, given: Vec<f32>, path: &Path) -> Vec<Suggestion> {
        let mut best = given;
        let mut ordered = Vec::new();
        while let Some((index, gain)) = self.most_useful(&chosen, &best) {
            let next = chosen.remove(index);
            join(&mut best, &next.qualities);
            let position = path.frame().to_world(next.place);
            ordered.push(Suggestion { position, gain, after: self.reach(&best) });
        }
        ordered
    }

    fn reach(&self, best: &[f32]) -> Reach {
        let seen = best.iter().filter(|q| **q > 0.0).count();
        Reach {
            coverage: seen as f64 / self.points.len() as f64,
            uncovered: 4.0 * PI * (self.points.len() - seen) as f64 / self.directions as f64,
        }
    }
}

fn join(best: &mut [f32], qualities: &[f32]) {
    best.iter_mut().zip(qualities).for_each(|(b, q)| *b = b.max(*q));
}

fn best_of<'a>(chosen: impl IntoIterator<Item = &'a Chosen>, given: &[f32]) -> Vec<f32> {
    let mut best = given.to_vec();
    chosen.into_iter().for_each(|chosen| join(&mut best, &chosen.qualities));
    best
}
