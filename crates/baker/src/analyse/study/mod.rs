//! Error against run time: what repeated bakes, by several methods and with several budgets, tell of each other.
//!
//! Means are over places, which count alike, and there over 26 normals (or the one of the reference), R, G and B. E_r is
//! what repeat r of R found, Ē their mean, E the reference, v the reference's own variance. All as shares of the RMS of E:
//!
//! ```text
//! error²     = mean (E_r - E)²                       what `compare` says of that repeat
//! noise²     = Σ_r mean (E_r - Ē)² / (R - 1)         no reference is needed
//! estimated² = mean Var E_r                          what the repeats say of themselves
//! bias²      = mean over r ≠ s of P_rs - v           P_rs = mean (E_r - E)(E_s - E)
//! ```
//! Repeats do not know of each other: their noise drops out of the products P_rs, so bias² is right on average and may come
//! out negative where there is no bias. With n independent numbers in all, its variance is
//! `(2 noise⁴/R(R-1) + 4 (bias² + v) noise²/R)/n` by the repeats, and `(2 v² + 4 bias² v)/n` by the reference. Were all nodes
//! equally noisy and strangers to each other, n would be known; how much the P_rs of three or more repeats differ tells
//! whether it is less. More directions do not make bias less, so the budgets are pooled, each weighed by how sure it is, to a
//! **floor**: the error that is left with any number of directions.
//!
//! Who runs the bakes, and holds the clock, is the caller.

mod fit;
mod measure;
mod point;

use gdibl_runtime::Volume;
use serde::Serialize;

pub use fit::{CostAt, Floor};
use fit::{cost_at, floor_of, is_erratic, slope_of};
pub use measure::measure;
pub use point::{Ground, Point, Seen, Spread};

/// The method that the others are measured by.
pub const PATH: &str = "path";
/// The method that is studied.
pub const GDIBL: &str = "gdibl";
/// The same, with the cost of capturing its probes.
pub const GDIBL_WITH_CAPTURE: &str = "gdibl with capture";

/// What a bake took.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Cost {
    /// From start to end of the bake.
    pub wall_seconds: f64,
    /// Of all threads.
    pub cpu_seconds: f64,
    /// CPU seconds before: hierarchies, importance, line-of-sight tables. Not in the others.
    pub setup_seconds: f64,
    /// Rays traced, lines of sight included.
    pub rays: u64,
    /// Directions that left nodes.
    pub samples: u64,
}

/// One bake of several that differ in their seeds alone.
#[derive(Debug, Clone)]
pub struct Repeat {
    /// What it found.
    pub volume: Volume,
    /// What it took.
    pub cost: Cost,
    /// The error between its nodes, where it was measured.
    pub seen: Option<Seen>,
    /// Bytes of its light in the file.
    pub bytes: u64,
}

/// One method.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Method {
    /// Its name.
    pub name: String,
    /// What it is, for a person.
    pub about: String,
    /// By budget, ascending.
    pub points: Vec<Point>,
    /// Slope of log noise over log directions: -1/2 for random directions. `None` with fewer than two budgets, or
    /// without noise.
    pub slope: Option<f64>,
    /// Its noise jumps: rare, very bright directions decide, and its noise and floor are known by luck alone.
    pub erratic: bool,
    /// What no number of directions takes away.
    pub floor: Floor,
    /// When its noise is as low as [`StudySettings::target`]; `None`: never.
    pub at_noise: Option<CostAt>,
    /// When its error is, noise² + floor²; a floor that chance alone could make counts as none. `None`: never.
    pub at_error: Option<CostAt>,
    /// How many times less it takes than [`PATH`] for the same noise; under 1 where it takes more.
    pub times_less: Option<f64>,
    /// CPU seconds before a bake.
    pub setup_seconds: f64,
    /// CPU seconds of a bake with its set-up whose error is as low as [`StudySettings::target`].
    pub total_seconds: Option<f64>,
    /// The noise that its bakes expect over the noise that repeats show, where that is farthest from 1; `None` where they do not
    /// know.
    pub claim: Option<f64>,
    /// For the same true error it takes more than [`FAR`] times the time of the best method.
    pub is_far: bool,
}

/// A claim that is off by more than this factor is wrong.
pub const HONEST: f64 = 1.5;
/// Methods that take more than so many times the best one's time are no choice.
pub const FAR: f64 = 10.0;

impl Method {
    /// What its bakes say of their noise is off by more than [`HONEST`].
    pub fn claims_wrongly(&self) -> bool {
        self.claim.is_some_and(|claim| !(1.0 / HONEST..=HONEST).contains(&claim))
    }
}

/// What capturing the probes takes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Capture {
    /// CPU seconds for all of them.
    pub cpu_seconds: f64,
    /// The same on the wall.
    pub wall_seconds: f64,
    /// How that is known, for a person.
    pub about: String,
}

/// From how many nodes on capturing pays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum BreakEven {
    /// Path tracing takes less per node, even without the capture.
    Never,
    /// From so many nodes on.
    Nodes(u64),
}

/// What to ask of the measurements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StudySettings {
    /// The error at which methods are compared, a share of E.
    pub target: f64,
    /// Nodes of each bake.
    pub nodes: usize,
}

/// All methods beside each other.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Study {
    /// The error at which methods are compared, a share of E.
    pub target: f64,
    /// Nodes of each bake.
    pub nodes: usize,
    /// Places at which they were compared with the reference.
    pub places: usize,
    /// Noise of the reference, a share of the RMS of E; `None` where it is not known.
    pub reference_noise: Option<f64>,
    /// `None`: no probe is used, or nothing to capture it from.
    pub capture: Option<Capture>,
    /// As they were asked for.
    pub methods: Vec<Method>,
    /// `None`: without capture, without one of the two methods, or one of them never comes to the target.
    pub break_even: Option<BreakEven>,
}

/// One method's name, what it is, and its points by ascending budget.
pub type Measured = (String, String, Vec<Point>);

impl Study {
    /// Fits every method, adds [`GDIBL_WITH_CAPTURE`] behind [`GDIBL`] where the capture's cost is known, and sets them
    /// beside [`PATH`].
    pub fn of(measured: Vec<Measured>, capture: Option<Capture>, settings: &StudySettings) -> Study {
        let ground = measured.iter().flat_map(|(_, _, points)| points).map(|point| point.ground).next();
        let ground = ground.unwrap_or_default();
        let mut methods = Vec::new();
        for (name, about, points) in measured {
            let method = Method::of(name, about, points, settings.target);
            let with =
                capture.as_ref().filter(|_| method.name == GDIBL).map(|c| method.with_capture(c, settings.nodes));
            methods.push(method);
            methods.extend(with);
        }
        let at = |methods: &[Method], name: &str| {
            methods.iter().find(|method| method.name == name)?.at_noise.map(|at| at.milliseconds_per_node)
        };
        let path = at(&methods, PATH);
        for method in &mut methods {
            method.times_less = path.zip(method.at_noise).map(|(path, own)| path / own.milliseconds_per_node);
        }
        for method in &mut methods {
            let error = method.at_error.map(|at| 1e-3 * at.milliseconds_per_node * settings.nodes as f64);
            method.total_seconds = error.map(|seconds| seconds + method.setup_seconds);
        }
        let best = methods.iter().filter_map(|method| method.total_seconds).reduce(f64::min);
        for method in &mut methods {
            method.is_far = best.is_some_and(|best| method.total_seconds.is_none_or(|own| own > FAR * best));
        }
        let break_even = match (&capture, at(&methods, GDIBL), path) {
            (Some(capture), Some(own), Some(path)) => Some(break_even(1e3 * capture.cpu_seconds, own, path)),
            _ => None,
        };
        Study {
            target: settings.target,
            nodes: settings.nodes,
            places: ground.places,
            reference_noise: ground.reference_noise,
            capture,
            methods,
            break_even,
        }
    }
}

impl Method {
    fn of(name: String, about: String, points: Vec<Point>, target: f64) -> Method {
        let slope = slope_of(&points);
        let floor = floor_of(&points);
        // Noise that leaves room for the floor, where that is more than chance.
        let bias = if floor.low > 0.0 { floor.middle } else { 0.0 };
        let room = target.powi(2) - bias.powi(2);
        Method {
            name,
            about,
            at_noise: cost_at(&points, target),
            at_error: (room > 0.0).then(|| cost_at(&points, room.sqrt())).flatten(),
            erratic: is_erratic(&points),
            setup_seconds: points.last().map_or(0.0, |point| point.setup_seconds),
            claim: claim_of(&points),
            points,
            slope,
            floor,
            times_less: None,
            total_seconds: None,
            is_far: false,
        }
    }

    /// The same light at the cost of capturing its probes, too, which all nodes share.
    fn with_capture(&self, capture: &Capture, nodes: usize) -> Method {
        let more = 1e3 * capture.cpu_seconds / nodes as f64;
        let dearer = |point: &Point| {
            let milliseconds_per_node = point.milliseconds_per_node.map(|ms| ms + more);
            let times = milliseconds_per_node.middle / point.milliseconds_per_node.middle;
            Point {
                wall_seconds: point.wall_seconds.map(|seconds| seconds + capture.wall_seconds),
                cpu_seconds: point.cpu_seconds.map(|seconds| seconds + capture.cpu_seconds),
                milliseconds_per_node,
                efficiency: point.efficiency / times,
                noise_efficiency: point.noise_efficiency / times,
                ..point.clone()
            }
        };
        let later = |at: CostAt| CostAt { milliseconds_per_node: at.milliseconds_per_node + more, ..at };
        Method {
            name: GDIBL_WITH_CAPTURE.into(),
            about: "gdibl, and what capturing its probes costs, shared by all nodes".into(),
            points: self.points.iter().map(dearer).collect(),
            at_noise: self.at_noise.map(later),
            at_error: self.at_error.map(later),
            ..self.clone()
        }
    }
}

/// Of the noise that bakes expect over that which repeats show, the one farthest from 1.
fn claim_of(points: &[Point]) -> Option<f64> {
    let noisy = points.iter().filter(|point| point.noise.middle > 0.0);
    let claims = noisy.filter_map(|point| Some(point.estimated? / point.noise.middle));
    claims.filter(|claim| *claim > 0.0).max_by(|a, b| a.ln().abs().total_cmp(&b.ln().abs()))
}

/// `capture` in all; `own` and `path` per node, in the same unit.
fn break_even(capture: f64, own: f64, path: f64) -> BreakEven {
    if own < path { BreakEven::Nodes((capture / (path - own)).ceil() as u64) } else { BreakEven::Never }
}

#[cfg(test)]
mod tests;
