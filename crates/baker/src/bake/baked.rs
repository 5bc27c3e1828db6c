//! How to bake, and what a bake gives.

use gdibl_runtime::walls::{Plane, WallCell};
use glam::DVec3;

use super::standing::Standing;
use crate::rows::{Row, Table};
use crate::sampling::Sampler;

/// How to bake.
#[derive(Debug, Clone, PartialEq)]
pub struct BakeSettings {
    /// Highest SH band, 0..=4.
    pub bands: u32,
    /// Directions per node; with a target the most a node may take. At least 1, at most 2^31.
    pub samples: u64,
    /// Stop a node once its `relative_error` is at most this.
    pub target_error: Option<f64>,
    /// Same seed, same bytes.
    pub seed: u64,
    /// Where directions come from.
    pub sampler: Sampler,
    /// Directions also go toward what is bright. Without, all are uniform: a baseline for studies.
    pub importance: bool,
    /// Keeps the standard error of every coefficient.
    pub coefficient_errors: bool,
    /// Adds the direct light of punctual lights, of which radiance functions tell nothing.
    pub punctual: bool,
    /// Most that a channel of a sample's radiance may be; infinity leaves all light as it is.
    pub clamp: f32,
}

impl Default for BakeSettings {
    fn default() -> Self {
        BakeSettings {
            bands: 2,
            samples: 4096,
            target_error: None,
            seed: 0,
            sampler: Sampler::Sobol,
            importance: true,
            coefficient_errors: false,
            punctual: false,
            clamp: f32::INFINITY,
        }
    }
}

impl BakeSettings {
    /// The cap of `samples` when a target is given and nothing else is said.
    pub const TARGET_SAMPLES: u64 = 65_536;
    /// The most samples of one node.
    pub const MAX_SAMPLES: u64 = 1 << 31;

    /// Directions that will leave so many nodes, about: with a target, as many as without one by default.
    pub fn directions(&self, nodes: u64) -> u64 {
        let usual = BakeSettings::default().samples;
        nodes.saturating_mul(if self.target_error.is_some() { self.samples.min(usual) } else { self.samples })
    }
}

/// A baked volume in memory. Per-node arrays are in node order.
#[derive(Debug, Clone, PartialEq)]
pub struct Baked {
    /// Highest SH band.
    pub bands: u32,
    /// Radiance coefficients, a row per node: `[coefficient][rgb]` flat.
    pub sh: Table,
    /// Only what is open has light of its own; the coefficients of the others come from neighbours.
    pub standing: Vec<Standing>,
    /// Nodes whose light is taken at another place, in order, and where, world metres.
    pub moved: Vec<(u32, DVec3)>,
    /// What keeps light from passing through walls between nodes; `None` where no wall stands between any.
    pub walls: Option<Walls>,
    /// Share of the sphere that was covered, 0..=1.
    pub coverage: Vec<f32>,
    /// Standard error of E over the larger of the node's RMS of E and a tenth of the volume's median; 0 for
    /// invalid nodes, infinite where one sample gave none.
    pub relative_error: Vec<f32>,
    /// Estimate of the systematic error of E, root mean square, over the same: what more directions do not take away. By audits
    /// where the level's materials explain what probes show (a share of the directions is traced as paths, too), else by leaving out
    /// one probe at a time; shared out among nodes in proportion to their noise. With it what light may be missing from directions that nobody has seen. 0 for
    /// invalid nodes, and by path tracing. The whole error is the root of the sum of its square and that of `relative_error`.
    pub systematic_error: Vec<f32>,
    /// `relative_error` with the standard error of E in the worst direction and channel.
    pub worst_error: Vec<f32>,
    /// One standard error of each coefficient, `[node][coefficient][rgb]` flat; empty unless asked for. 0 for invalid nodes.
    pub coefficient_error: Vec<f32>,
    /// Rays traced, lines of sight included.
    pub rays: u64,
    /// Directions that left nodes.
    pub samples: u64,
    /// Valid nodes whose whole error is over the target.
    pub missed: u64,
    /// Those of them whose systematic error alone is: more directions would not help.
    pub missed_by_systematic: u64,
    /// Share of the valid nodes' light that clamping took, 0..=1.
    pub clamped: f64,
    /// What the error was on the way; `None` where no node was looked at, or none has noise.
    pub quarters: Option<[Quarter; 4]>,
}

/// Errors of E after some quarters of a bake's directions, medians over some of its nodes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quarter {
    /// As `relative_error`.
    pub noise: f64,
    /// With the systematic error, which more directions do not take away.
    pub whole: f64,
}

impl Baked {
    /// Nodes that all have light of their own, of which nothing else is known.
    pub(crate) fn of_rows(bands: u32, sh: Table) -> Baked {
        let count = sh.len();
        Baked {
            bands,
            sh,
            standing: vec![Standing::Open; count],
            moved: Vec::new(),
            walls: None,
            coverage: vec![1.0; count],
            relative_error: vec![0.0; count],
            systematic_error: vec![0.0; count],
            worst_error: vec![0.0; count],
            coefficient_error: Vec::new(),
            rays: 0,
            samples: 0,
            missed: 0,
            missed_by_systematic: 0,
            clamped: 0.0,
            quarters: None,
        }
    }

    /// Coefficients of one node, `[coefficient][rgb]` flat.
    pub fn node(&self, index: usize) -> Row<'_> {
        self.sh.row(index)
    }

    /// How many nodes.
    pub fn len(&self) -> usize {
        self.standing.len()
    }

    /// Never.
    pub fn is_empty(&self) -> bool {
        self.standing.is_empty()
    }

    /// Every node has light of its own.
    pub fn is_all_valid(&self) -> bool {
        self.standing.iter().all(|standing| *standing == Standing::Open)
    }

    /// The nodes that have light of their own, in order.
    pub fn valid_nodes(&self) -> impl Iterator<Item = usize> {
        (0..self.len()).filter(|node| self.is_valid(*node))
    }

    /// The node has light of its own.
    pub fn is_valid(&self, index: usize) -> bool {
        self.standing[index] == Standing::Open
    }
}

/// What the runtime needs to keep light on its side of walls.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Walls {
    /// A position p, relative to the grid's min, is on the positive side if normal·p > distance.
    pub planes: Vec<Plane>,
    /// In order of their cells.
    pub cells: Vec<WallCell>,
    /// Cells with walls that need more planes than there may be in a file.
    pub dropped: usize,
}
