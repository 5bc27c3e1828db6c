//! What a study tells.

use gdibl_baker::analyse::study::Study;
use serde::Serialize;

use super::methods::LeftOut;

/// What OUT.json holds and `--json` prints.
#[derive(Serialize)]
pub struct Report {
    pub program: &'static str,
    pub level: String,
    /// Where the nodes are, for a person.
    pub places: String,
    /// For a person.
    pub light: String,
    /// Its probes were captured from the level.
    pub captured: bool,
    /// Methods were asked for by name, so each of them is drawn.
    #[serde(skip)]
    pub all_drawn: bool,
    pub sh: String,
    pub budgets: Vec<u64>,
    pub repeats: usize,
    /// Of the first and of the last repeat; every budget has its own.
    pub seeds: [u64; 2],
    pub reference: ReferenceReport,
    pub threads: usize,
    pub processor: String,
    pub left_out: Vec<LeftOut>,
    pub study: Study,
    pub wall_seconds: f64,
    pub cpu_seconds: f64,
}

#[derive(Serialize)]
pub struct ReferenceReport {
    /// For a person.
    pub about: String,
    /// Directions per node, of one that was made.
    pub samples: Option<u64>,
    pub seed: Option<u64>,
    /// What it took to make it.
    pub wall_seconds: Option<f64>,
    pub cpu_seconds: Option<f64>,
}
