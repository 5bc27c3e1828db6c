//! Work on the radiance function of the method in force: how it is built, and who watches.

use glam::DVec3;
use std::sync::atomic::AtomicBool;

use super::inputs::Inputs;
use super::plan;
use super::records::PlanRow;
use super::settings::Settings;
use super::text::Method;
use crate::Finding;
use crate::blocks::Blocks;
use crate::radiance::gdibl::Gdibl;
use crate::radiance::path::{Path, light_without_end};
use crate::radiance::{Distant, RadianceFunction};

/// What a job does, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Trees, tables and what probes see are built.
    Prepare,
    /// Coarse grids are sampled, and light between their nodes.
    Spacing,
    /// Nodes are sampled, filled, and what stands between them is found.
    Nodes,
    /// Light is sampled between nodes.
    Seen,
    /// Bands, numbers and sections of the file.
    Pack,
}

impl Stage {
    /// Its name in records.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Prepare => "prepare",
            Stage::Spacing => "spacing",
            Stage::Nodes => "nodes",
            Stage::Seen => "seen",
            Stage::Pack => "pack",
        }
    }
}

/// Lets a caller watch a job and stop it. The library reads no clock: who watches does.
pub struct Watch<'a> {
    /// Set it to stop.
    pub cancel: &'a AtomicBool,
    /// Called from worker threads with (nodes finished, rays traced) since the last call.
    pub progress: &'a (dyn Fn(u64, u64) + Sync),
    /// A stage begins.
    pub stage: &'a dyn Fn(Stage),
    /// Seconds since the run began; asked where a budget is given.
    pub seconds: &'a dyn Fn() -> f64,
    /// Keeps what is finished of the nodes and of what lies between them. `None`: nothing is kept.
    pub blocks: Option<&'a dyn Blocks>,
}

impl<'a> Watch<'a> {
    /// Looks at nothing.
    pub fn silent(cancel: &'a AtomicBool) -> Watch<'a> {
        Watch { cancel, progress: &|_, _| {}, stage: &|_| {}, seconds: &|| 0.0, blocks: None }
    }
}

/// Work on a radiance function, whichever it is.
pub trait Work {
    /// What comes of it.
    type Output;

    /// `decided`: what the function does and leaves out, and what it found.
    fn run(self, function: &impl RadianceFunction, decided: Decided) -> Self::Output;
}

/// What a radiance function decided when it was built.
#[derive(Debug, Clone, Default)]
pub struct Decided {
    /// What it does and leaves out.
    pub rows: Vec<PlanRow>,
    /// What deserves a look.
    pub findings: Vec<Finding>,
}

/// Who will ask for light, as far as the radiance function depends on it.
#[derive(Debug, Clone)]
pub struct Viewers {
    /// Directions, all together; 0: not known, and nothing is remembered.
    pub directions: u64,
    /// A probe counts where its pixel covers a square of at most this edge, metres.
    pub coarsest: f32,
    /// Some of the places, world metres: from there it is found what probes do not see.
    pub places: Vec<DVec3>,
}

/// Calls `work` with the radiance function of the method in force. What it takes long to find out first is kept in `blocks`.
pub fn with_function<W: Work>(
    inputs: &Inputs,
    distant: Option<&Distant>,
    settings: &Settings,
    viewers: &Viewers,
    blocks: Option<&dyn Blocks>,
    work: W,
) -> W::Output {
    let scene = &inputs.scene;
    // Of a panorama that no node can see the job says so itself.
    let without_sealed = |mut rows: Vec<PlanRow>| {
        if inputs.distant.is_some() && distant.is_none() {
            rows.retain(|row| row.stage != "distant");
        }
        rows
    };
    if inputs.method(settings) == Method::Gdibl {
        let own = settings.gdibl(inputs.captured, viewers.directions, viewers.coarsest);
        let mut function = Gdibl::sharing(&inputs.trees, scene, &inputs.probes, distant, own);
        if !inputs.probes.is_empty() {
            function.choose_unseen_by(settings.quality.unseen, &viewers.places, blocks);
        }
        let rows = without_sealed(plan::plan(scene, &function));
        work.run(&function, Decided { rows, findings: Vec::new() })
    } else {
        let function = Path::sharing(&inputs.trees, scene, distant, settings.path());
        let rows = without_sealed(plan::plan_path(scene, &function));
        let findings = light_without_end(scene, &function).into_iter().collect();
        work.run(&function, Decided { rows, findings })
    }
}
