//! How fine a grid has to be, where nobody says: a coarse one is baked first, and its error between nodes measured. Finer ones follow
//! until the error is as small as was asked for, or nodes, bytes or seconds are used up.
//!
//! The coarse grids together take at most a quarter of the work of the finest, and the first. Of a grid that is off by p at the 95th percentile,
//! and ought to be off by q, no grid of fewer than (p/q)^(3/2) times its nodes is good enough: between nodes the error falls with
//! the square of their distance where light is smooth, and slower where it is not. So a grid that cannot be good enough is not
//! baked.

use gdibl_runtime::grid::Grid;
use glam::DVec3;

use super::plan::{digits, length};
use super::records::{PlanRow, SeenRecord};
use super::settings::{GridSettings, Settings};
use super::work::{Decided, Watch, Work};
use crate::bake::{Nodes, bake, grid_of_nodes, widest_spacing};
use crate::radiance::RadianceFunction;
use crate::{Control, Interrupted, seen};

/// Nodes at most when nothing is said.
pub(super) const DEFAULT_NODES: u64 = 8192;
/// What the error between nodes may be at 95 % of the places when nothing is said.
const DEFAULT_ERROR: f64 = 0.05;
/// Nodes of the grid that is baked first.
pub(super) const FIRST: u64 = 128;
/// Grids of so many nodes come next where the first is fine enough.
const COARSER: [u64; 2] = [16, 1];
/// A grid of more than this share of the most nodes is not tried: the finest is baked at once.
const WORTH_TRYING: f64 = 0.125;
/// How the number of nodes grows with the error at best.
const ORDER: f64 = 1.5;

/// What grids may take.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// The most nodes.
    pub nodes: u64,
    /// The most bytes of light.
    pub bytes: Option<u64>,
    /// The error at 95 % of the places that is small enough.
    pub error: f64,
}

impl Limits {
    pub fn of(grid: &GridSettings, error: Option<f64>) -> Limits {
        Limits {
            nodes: grid.max_nodes.unwrap_or(DEFAULT_NODES),
            bytes: grid.max_bytes,
            error: error.unwrap_or(DEFAULT_ERROR),
        }
    }
}

/// A grid that was baked.
#[derive(Debug, Clone)]
pub(super) struct Tried {
    pub grid: Grid,
    /// Error at the 95th percentile, in the air or on surfaces, whichever is larger; infinite where it is not known.
    pub error: f64,
    /// Bytes of its light in the file.
    pub bytes: u64,
}

/// The larger error at the 95th percentile of what was measured.
pub(super) fn error_of(seen: &SeenRecord) -> f64 {
    let sets = [seen.air, seen.surfaces];
    sets.iter().flatten().map(|set| set.error.p95).reduce(f64::max).unwrap_or(f64::INFINITY)
}

/// Chooses grids over one box, coarse ones first.
#[derive(Debug)]
pub(super) struct Search {
    bounds: [DVec3; 2],
    limits: Limits,
    tried: Vec<Tried>,
}

/// What to do next.
#[derive(Debug, PartialEq)]
pub(super) enum Next {
    /// Bakes this grid, and measures it.
    Try(Grid),
    /// Takes the grid of this number among those that were tried.
    Take(usize),
    /// Bakes this grid, and takes it whatever its error.
    Last(Grid),
}

impl Search {
    /// Over the box of the finest grid.
    pub fn new(finest: &Grid, limits: Limits) -> Search {
        Search { bounds: [finest.min, finest.max].map(DVec3::from), limits, tried: Vec::new() }
    }

    fn grid(&self, nodes: u64) -> Grid {
        let [min, max] = self.bounds;
        grid_of_nodes(min, max, nodes)
    }

    /// What a grid turned out to be.
    pub fn tell(&mut self, tried: Tried) {
        self.tried.push(tried);
    }

    fn is_fine(&self, tried: &Tried) -> bool {
        tried.error <= self.limits.error
    }

    /// The most nodes: those that were asked for, and those whose bytes fit. Neighbours in coarser grids differ more, so
    /// a node of a finer one takes no more bytes than one of those.
    fn most(&self) -> u64 {
        let finest = self.tried.iter().max_by_key(|tried| tried.grid.node_count());
        let fitting = self.limits.bytes.zip(finest).map(|(bytes, tried)| {
            let each = tried.bytes as f64 / tried.grid.node_count() as f64;
            (bytes as f64 / each) as u64
        });
        fitting.map_or(self.limits.nodes, |fitting| fitting.min(self.limits.nodes)).max(1)
    }

    /// The next grid, after all that were tried.
    pub fn next(&self) -> Next {
        let most = self.most();
        let Some(last) = self.tried.last() else { return Next::Try(self.grid(FIRST.min(most))) };
        let count = |grid: &Grid| grid.node_count() as u64;
        if self.limits.bytes.is_some_and(|bytes| last.bytes > bytes) {
            return Next::Last(self.grid(most));
        }
        // Towards coarser grids as long as they are fine enough.
        if self.is_fine(&self.tried[0]) {
            let coarser = COARSER.map(|nodes| self.grid(nodes));
            let next = coarser.into_iter().find(|grid| count(grid) < count(&last.grid));
            return match (self.is_fine(last), next) {
                (true, Some(grid)) => Next::Try(grid),
                (true, None) => Next::Take(self.tried.len() - 1),
                (false, _) => Next::Take(self.tried.len() - 2),
            };
        }
        if self.is_fine(last) {
            return Next::Take(self.tried.len() - 1);
        }
        let nodes = count(&last.grid) as f64;
        let wanted = (nodes * (last.error / self.limits.error).powf(ORDER)).max(2.0 * nodes);
        if wanted <= WORTH_TRYING * most as f64 {
            return Next::Try(self.grid(wanted as u64));
        }
        let finest = self.grid(most);
        if count(&finest) <= count(&last.grid) { Next::Take(self.tried.len() - 1) } else { Next::Last(finest) }
    }

    /// Why this grid was taken.
    pub fn row(&self, taken: &Grid) -> PlanRow {
        let percent = |share: f64| format!("{} %", digits(100.0 * share));
        let asked = percent(self.limits.error);
        let too_coarse = |tried: &&Tried| tried.grid != *taken && !self.is_fine(tried) && tried.error.is_finite();
        let mut too_coarse: Vec<&Tried> = self.tried.iter().filter(too_coarse).collect();
        too_coarse.sort_by_key(|tried| tried.grid.node_count());
        let others = too_coarse.iter().map(|tried| format!("; {} off by {}", named(&tried.grid), percent(tried.error)));
        let others: String = others.collect();
        let why = match self.tried.iter().find(|tried| tried.grid == *taken && self.is_fine(tried)) {
            Some(own) => {
                format!("{} enough: off by {}, and {asked} is allowed{others}", named(taken), percent(own.error))
            }
            None => format!("{} the finest that is allowed; {asked} of error is asked for{others}", named(taken)),
        };
        PlanRow::new("spacing", true, why)
    }
}

/// A grid and its verb.
fn named(grid: &Grid) -> String {
    match grid.node_count() {
        1 => "one node is".into(),
        nodes => format!("{nodes} nodes, {} apart, are", length(widest_spacing(grid))),
    }
}

/// Share of the seconds that are left which is planned to be used: no trial tells all.
const PLANNED: f64 = 0.9;
/// Share of the work of the finest grid that coarser ones usually do not exceed.
const COARSER_SHARE: f64 = 0.15;
/// Nodes of the first trial; of a second one at most so many, and so much of the budget.
const TRIAL: usize = 128;
const MOST_OF_SECOND_TRIAL: f64 = 4096.0;
const SECOND_TRIAL: f64 = 0.05;

/// Seconds that a bake takes on this machine.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pace {
    /// Until the first node.
    prepare: f64,
    per_node: f64,
    /// Of a place between nodes, in nodes.
    work_of_a_place: f64,
}

/// Bakes a few of the nodes, spread evenly over all, and looks at the clock.
pub(super) struct Trial<'a, 'b> {
    pub nodes: &'a Nodes,
    /// Seconds that the bake may take: a longer one is worth a second trial.
    pub budget: f64,
    pub settings: &'a Settings,
    /// When the radiance function began to be built.
    pub begun: f64,
    pub watch: &'a Watch<'b>,
}

impl Work for Trial<'_, '_> {
    type Output = Result<Pace, Interrupted>;

    fn run(self, function: &impl RadianceFunction, _: Decided) -> Self::Output {
        let Trial { nodes, budget, settings, begun, watch } = self;
        let control = Control { cancel: watch.cancel, progress: &|_, rays| (watch.progress)(0, rays), blocks: None };
        let time = |count: usize| -> Result<f64, Interrupted> {
            let some = Nodes::Points(nodes.some_positions(count));
            let begun = (watch.seconds)();
            bake(&some, function, &settings.bake(), &control)?;
            Ok(((watch.seconds)() - begun) / some.len() as f64)
        };
        let prepare = (watch.seconds)() - begun;
        let mut per_node = time(TRIAL)?;
        let more = (SECOND_TRIAL * budget / per_node).min(MOST_OF_SECOND_TRIAL) as usize;
        if more > 4 * TRIAL && nodes.len() > 4 * TRIAL {
            per_node = time(more)?;
        }
        Ok(Pace { prepare, per_node, work_of_a_place: seen::work_of_a_place(settings.bake().samples) })
    }
}

impl Pace {
    /// The most nodes of a grid whose bake takes so many seconds. `places`: see `seen_places`.
    pub fn nodes_in(self, seconds: f64, places: Option<u32>) -> u64 {
        affordable((PLANNED * seconds - self.prepare) / self.per_node, places, self.work_of_a_place)
    }

    /// What a bake takes, seconds: at most where a coarser grid may do.
    pub fn seconds_of(self, nodes: &Nodes, searches: bool, places: Option<u32>) -> f64 {
        let places = match (nodes, places) {
            (Nodes::Points(_) | Nodes::Vertices { .. }, _) => 0.0,
            (_, None) => seen::usual_count(nodes.len()) as f64,
            (_, Some(places)) => places.into(),
        };
        let coarser = if searches { FIRST as f64 + COARSER_SHARE * nodes.len() as f64 } else { 0.0 };
        self.prepare + self.per_node * (nodes.len() as f64 + coarser + 2.0 * self.work_of_a_place * places)
    }
}

/// The nodes of the finest grid that the work of so many nodes pays for, a place taking that of so many.
fn affordable(work: f64, places: Option<u32>, work_of_a_place: f64) -> u64 {
    let nodes_for = |places: f64| (work - FIRST as f64 - 2.0 * work_of_a_place * places) / (1.0 + COARSER_SHARE);
    let nodes = match places {
        Some(0) => work,
        Some(places) => nodes_for(places.into()),
        None => nodes_for(seen::usual_count(work as usize) as f64),
    };
    // Also where it is not a number.
    nodes.max(1.0) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { nodes: 8000, bytes: None, error: 0.05 };

    /// The search over a cube of a metre, where a grid of so many nodes is off by so much and takes so many bytes: the nodes of all
    /// grids that were baked, and those of the one that was taken.
    fn search(limits: Limits, error: impl Fn(f64) -> f64, bytes: impl Fn(f64) -> f64) -> (Vec<u64>, u64) {
        let mut search = Search::new(&grid_of_nodes(DVec3::ZERO, DVec3::ONE, limits.nodes), limits);
        let mut baked = Vec::new();
        loop {
            match search.next() {
                Next::Try(grid) => {
                    let nodes = grid.node_count() as f64;
                    baked.push(nodes as u64);
                    search.tell(Tried { grid, error: error(nodes), bytes: bytes(nodes) as u64 });
                }
                Next::Take(number) => return (baked.clone(), baked[number]),
                Next::Last(grid) => {
                    baked.push(grid.node_count() as u64);
                    return (baked, grid.node_count() as u64);
                }
            }
            assert!(baked.len() < 20, "{baked:?}");
        }
    }

    #[test]
    fn even_light_needs_one_node() {
        assert_eq!(search(LIMITS, |_| 0.0, |n| n), (vec![125, 8, 1], 1));
        assert_eq!(search(LIMITS, |n| if n < 8.0 { 0.2 } else { 0.01 }, |n| n), (vec![125, 8, 1], 8));
        assert_eq!(search(LIMITS, |n| if n < 100.0 { 0.2 } else { 0.01 }, |n| n), (vec![125, 8], 125));
    }

    #[test]
    fn the_coarsest_grid_that_is_fine_enough_is_found_where_light_is_smooth() {
        // Of second order: 0.05 at 343 nodes.
        let error = |n: f64| 0.05 * (343.0 / n).powf(2.0 / 3.0);
        let (baked, taken) = search(LIMITS, error, |n| n);
        assert!(error(taken as f64) <= 0.05 && taken < 700, "{baked:?}");
    }

    #[test]
    fn grids_that_cannot_be_fine_enough_are_not_baked() {
        assert_eq!(search(LIMITS, |_| 1.5, |n| n), (vec![125, 8000], 8000));
        // Nothing is known of the error where no light is.
        assert_eq!(search(LIMITS, |_| f64::INFINITY, |n| n), (vec![125, 8000], 8000));
        // Small steps end, too, and coarse grids do not take more work than they may.
        let (baked, taken) = search(LIMITS, |_| 0.0501, |n| n);
        assert_eq!(taken, 8000);
        let coarse: u64 = baked.iter().filter(|nodes| **nodes != 8000).sum();
        assert!(coarse as f64 <= 8000.0 * (2.0 * WORTH_TRYING), "{baked:?}");
    }

    #[test]
    fn nodes_and_bytes_are_within_their_bounds() {
        for nodes in [1, 7, 8, 100, 1000, 50_000] {
            let (baked, taken) = search(Limits { nodes, ..LIMITS }, |_| 1.0, |n| n);
            assert!(baked.iter().all(|n| *n <= nodes), "{nodes}: {baked:?}");
            assert!(2 * taken > nodes || nodes <= 8, "{nodes}: {baked:?}");
        }
        for bytes in [500, 2000, 20_000, 50_000] {
            let (_, taken) = search(Limits { bytes: Some(bytes), ..LIMITS }, |_| 1.0, |n| 300.0 + 17.0 * n);
            assert!(300 + 17 * taken <= bytes, "{bytes}: {taken}");
        }
    }

    #[test]
    fn work_pays_for_the_grid_and_all_else() {
        assert_eq!(affordable(5000.0, Some(0), 0.4), 5000);
        assert_eq!(affordable(0.0, None, 0.4), 1);
        let nodes = affordable(10_000.0, None, 0.4) as f64;
        assert!((7500.0..8500.0).contains(&nodes), "{nodes}");
    }
}
