//! A sparse grid that is as fine as its light asks for: baked coarsely, and finer where that is not enough.
//!
//! Round by round every new cell is put to the test: a node is baked in its middle, of larger cells also in the middles of its faces,
//! and if what its corners say there is off by more than the tolerance, the cell is divided, until the grid's own spacing is reached. A
//! difference that noise explains is none. Cells in
//! which triangles stand between corners, or corners in solids, are always divided: light changes at once at surfaces, and there it is
//! read most. What lies in solids and outside of the level all through stays coarse.
//!
//! Tests of cells that are divided are nodes of the next level; others are the price. Where light is right, nearly, between the corners of
//! a cell that surfaces divide, its parts need none: the error falls with the square of the distance.

mod cells;
mod occupied;

use gdibl_runtime::Volume;
use gdibl_runtime::bricks::{Bricks, Corners, Leaf, is_node};
use gdibl_runtime::grid::{Grid, trilinear};
use gdibl_runtime::sh;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashMap;

use cells::{Cell, Flags};
pub use cells::{grid_of_cells, levels_of};
use occupied::occupied;

use super::irradiance::{Irradiance, difference, irradiance_of, root_mean_square};
use super::sample::{Batch, Scale};
use super::standing::{Sites, Standing};
use super::{BakeSettings, Baked, Nodes, SparseGrid, bake, finish};
use crate::job::records::{ErrorSummary, SparseLevel, SparseRecord};
use crate::pack::volume_of;
use crate::radiance::RadianceFunction;
use crate::trace::Level;
use crate::{Control, Interrupted};

/// A difference counts as noise up to the square root of this many times its standard error.
const NOISE: f64 = 2.0;
/// Cells as wide as two of the grid's are not tested if light in the cell they are part of is off by this many tolerances at most.
const EVEN: f64 = 4.0;
/// A share of the nodes, and bounds of it, that middles of small cells of a size are baked for in order to know the error there.
const CHECKED_SHARE: usize = 50;
const LEAST_CHECKED: usize = 16;
const MOST_CHECKED: usize = 512;

/// Bakes a grid as sparsely as `tolerance` allows, the relative error of irradiance between nodes: a sparse one, the grid itself
/// where that is no larger, or one node where light is the same all over. `None` in place of a report if the grid has no coarser
/// cells.
pub fn bake_sparse(
    grid: &Grid,
    tolerance: f64,
    function: &impl RadianceFunction,
    settings: &BakeSettings,
    control: &Control,
) -> Result<(Nodes, Baked, Option<SparseRecord>), Interrupted> {
    let levels = levels_of(grid);
    let nodes = Nodes::Grid(*grid);
    if levels == 0 {
        let baked = bake(&nodes, function, settings, control)?;
        return Ok((nodes, baked, None));
    }
    let mut refiner = Refiner::new(grid, levels, tolerance, function, settings, control);
    let mut frontier = refiner.tree.cells_of(levels);
    loop {
        refiner.bake_places_of(&frontier)?;
        let bricks = refiner.bricks();
        if refiner.tree.is_empty() && refiner.is_even() {
            return refiner.one_node();
        }
        let divided = refiner.divided(&bricks, &frontier)?;
        let mut refined = Vec::new();
        divided.iter().for_each(|cell| refiner.tree.refine(*cell, &mut refined));
        if refined.is_empty() {
            break;
        }
        let tree = &refiner.tree;
        frontier = refined.iter().flat_map(|cell| cell.children(grid)).filter(|cell| !tree.has(*cell)).collect();
    }
    refiner.merge_solid();
    let bricks = refiner.bricks();
    let stride = 2 * 3 * sh::coefficient_count(settings.bands);
    if bricks.node_count() * stride + bricks.to_bytes().len() >= grid.node_count() * stride {
        let all = Bricks::new(grid.counts, levels, |_, _| true);
        return refiner.finish(nodes, &all);
    }
    refiner.finish(Nodes::Sparse(SparseGrid { grid: *grid, bricks: bricks.clone() }), &bricks)
}

/// A bake in progress.
struct Refiner<'a, F> {
    grid: &'a Grid,
    nodes: Nodes,
    /// Cells that are divided.
    tree: Flags,
    /// Cells that triangles reach into.
    occupied: Flags,
    /// Cells whose light is so nearly right that their parts need no test.
    even: Flags,
    tolerance: f64,
    function: &'a F,
    settings: &'a BakeSettings,
    control: &'a Control<'a>,
    /// All that was baked, whether it is a node or not, in the order in which it was.
    batch: Option<Batch>,
    /// Where in it a place of the grid is.
    known: HashMap<u32, u32>,
    /// Traced to see what stands in cells.
    rays: u64,
}

impl<'a, F: RadianceFunction> Refiner<'a, F> {
    fn new(
        grid: &'a Grid,
        levels: u32,
        tolerance: f64,
        function: &'a F,
        settings: &'a BakeSettings,
        control: &'a Control,
    ) -> Refiner<'a, F> {
        Refiner {
            grid,
            nodes: Nodes::Grid(*grid),
            tree: Flags::new(grid.counts, levels),
            occupied: occupied(grid, levels, function),
            even: Flags::new(grid.counts, levels),
            tolerance,
            function,
            settings,
            control,
            batch: None,
            known: HashMap::new(),
            rays: 0,
        }
    }

    fn bricks(&self) -> Bricks {
        Bricks::new(self.grid.counts, self.tree.levels, |level, index| self.tree.has(Cell { level, index }))
    }

    fn batch(&self) -> &Batch {
        self.batch.as_ref().expect("the first round has baked")
    }

    /// Where a cell is tested: places, and where in the cell they are, 0 to 1 per axis. Its middle; where a beam of light might pass
    /// between that and the corners, the middles of its faces, too. Nowhere if it needs no test.
    fn tests(&self, cell: Cell) -> Vec<([u32; 3], [f32; 3])> {
        let half = 1 << cell.level >> 1;
        let origin = cell.origin();
        let is_wide = |axis: usize| self.grid.counts[axis] > 1;
        let at = |halves: [u32; 3]| {
            let halves: [u32; 3] = std::array::from_fn(|axis| if is_wide(axis) { halves[axis] } else { 0 });
            (std::array::from_fn(|axis| origin[axis] + half * halves[axis]), halves.map(|halves| 0.5 * halves as f32))
        };
        let parent = Cell { level: 2, index: cell.index.map(|n| n / 2) };
        if cell.level == 1 && self.tree.levels > 1 && self.even.has(parent) {
            return Vec::new();
        }
        let mut tests = Vec::new();
        if cell.level > 0 {
            tests.push(at([1; 3]));
        }
        if cell.level > 1 {
            for axis in (0..3).filter(|axis| is_wide(*axis)) {
                let face = |halves| at(std::array::from_fn(|other| if other == axis { halves } else { 1 }));
                tests.extend([face(0), face(2)]);
            }
        }
        tests
    }

    /// Bakes the corners of cells that are nodes, and the places where those are tested that could be divided.
    fn bake_places_of(&mut self, cells: &[Cell]) -> Result<(), Interrupted> {
        let Flags { counts, levels, .. } = self.tree;
        let is_refined = |level, index| self.tree.has(Cell { level, index });
        let mut wanted = Vec::new();
        for cell in cells {
            let nodes = cell.places(self.grid).filter(|place| is_node(counts, levels, *place, is_refined));
            let tests = self.tests(*cell).into_iter().map(|(place, _)| place);
            wanted.extend(nodes.chain(tests).map(|place| self.grid.index_of(place)));
        }
        wanted.sort_unstable();
        wanted.dedup();
        self.bake_missing(wanted)
    }

    /// Bakes those of these places that were not.
    fn bake_missing(&mut self, mut places: Vec<u32>) -> Result<(), Interrupted> {
        places.retain(|place| !self.known.contains_key(place));
        if places.is_empty() {
            return Ok(());
        }
        let first = self.known.len() as u32;
        self.known.extend(places.iter().zip(first..).map(|(place, slot)| (*place, slot)));
        let scale = self.batch.as_ref().map(|batch| batch.scale);
        let Refiner { nodes, function, settings, control, .. } = self;
        let more = Batch::sample(nodes, places, scale, *function, settings, control)?;
        match &mut self.batch {
            None => self.batch = Some(more),
            Some(batch) => batch.append(more),
        }
        Ok(())
    }

    fn is_open(&self, place: [u32; 3]) -> Option<bool> {
        let slot = self.known.get(&self.grid.index_of(place))?;
        Some(self.batch().sites.standing[*slot as usize] == Standing::Open)
    }

    /// The cells that have to be divided.
    fn divided(&mut self, bricks: &Bricks, cells: &[Cell]) -> Result<Vec<Cell>, Interrupted> {
        let coarse: Vec<Cell> = cells.iter().copied().filter(|cell| cell.level > 0).collect();
        let look = |level: &mut Level, cell: &Cell| {
            if self.control.cancelled() {
                return Err(Interrupted);
            }
            let is_cut = self.occupied.has(*cell) && self.is_cut(bricks, level, *cell);
            Ok((is_cut, self.excess(bricks, *cell), level.take_rays()))
        };
        let found: Result<Vec<(bool, f64, u64)>, Interrupted> =
            coarse.par_iter().map_init(|| self.function.level(), look).collect();
        let found = found?;
        let rays = found.iter().map(|(_, _, rays)| rays).sum();
        (self.control.progress)(0, rays);
        self.rays += rays;
        let (mut divided, mut whole) = (Vec::new(), Vec::new());
        for (cell, (is_cut, excess, _)) in coarse.into_iter().zip(found) {
            self.even.set(cell, excess <= EVEN);
            if is_cut || excess > 1.0 { &mut divided } else { &mut whole }.push(cell);
        }
        divided.extend(self.with_gaps(whole.into_iter())?);
        Ok(divided)
    }

    /// Those of these cells in a solid, for all that is known, with a place in the open that would be a node if they were divided: a
    /// narrow corridor, say. Of larger ones all that hold triangles have been divided.
    fn with_gaps(&mut self, cells: impl Iterator<Item = Cell>) -> Result<Vec<Cell>, Interrupted> {
        let is_buried = |cell: &Cell| {
            let is_known_open = |place| self.is_open(place) == Some(true);
            cell.level == 1 && self.occupied.has(*cell) && !cell.places(self.grid).any(is_known_open)
        };
        let buried: Vec<Cell> = cells.filter(is_buried).collect();
        let places = |cell: &Cell| cell.places(self.grid).map(|place| self.grid.index_of(place)).collect::<Vec<u32>>();
        let mut unknown: Vec<u32> = buried.iter().flat_map(places).filter(|p| !self.known.contains_key(p)).collect();
        unknown.sort_unstable();
        unknown.dedup();
        let sites = Sites::find(&self.nodes, unknown, self.function, self.control)?;
        (self.control.progress)(0, sites.rays);
        let is_open = |place: &u32| {
            let found = sites.numbers.binary_search(place);
            found.is_ok_and(|found| sites.standing[found] == Standing::Open)
        };
        let with_gaps = buried.into_iter().filter(|cell| places(cell).iter().any(is_open)).collect();
        self.rays += sites.rays;
        Ok(with_gaps)
    }

    /// Triangles in a cell stand between some of its corners and middle, or are those of a solid that some are in.
    fn is_cut(&self, bricks: &Bricks, level: &Level, cell: Cell) -> bool {
        let half = 1 << cell.level >> 1;
        let origin = cell.origin();
        let middle = bricks.middle(cell.level, origin);
        let is_own = |place: &[u32; 3]| {
            *place == middle || (0..3).all(|axis| (place[axis] - origin[axis]).is_multiple_of(2 * half))
        };
        let sites = &self.batch().sites;
        let mut places = Vec::new();
        let mut hidden = 0;
        for place in cell.places(self.grid).filter(is_own) {
            let index = self.grid.index_of(place);
            match self.known.get(&index) {
                Some(&slot) if sites.standing[slot as usize] == Standing::Open => {
                    places.push(sites.place(slot, &self.nodes, self.function));
                }
                Some(_) => hidden += 1,
                // A corner that is no node.
                None => places.push(self.nodes.ray_origin(index as usize, self.function.frame())),
            }
        }
        if hidden > 0 {
            // All of them: a solid's inside, for all that is known. Of larger cells that is not enough.
            return cell.level > 1 || !places.is_empty();
        }
        (0..places.len()).any(|a| (0..a).any(|b| places[a] != places[b] && !level.is_clear(places[a], places[b])))
    }

    /// By how many tolerances what the corners say of places in a cell is off what was baked there, at most.
    fn excess(&self, bricks: &Bricks, cell: Cell) -> f64 {
        let corners = bricks.corners(Leaf { origin: cell.origin(), level: cell.level });
        self.tests(cell)
            .into_iter()
            .map(|(place, share)| self.excess_at(bricks, &corners, place, share))
            .fold(0.0, f64::max)
    }

    fn excess_at(&self, bricks: &Bricks, corners: &Corners, place: [u32; 3], share: [f32; 3]) -> f64 {
        let Batch { sites, sampled, .. } = self.batch();
        let Some(&found) = self.known.get(&self.grid.index_of(place)) else { return 0.0 };
        if sites.standing[found as usize] != Standing::Open {
            return 0.0;
        }
        let mut weights = trilinear(share);
        corners.spread(&mut weights);
        let (mut sum, mut total, mut variance): (Irradiance, f32, f64) = ([0.0; 27], 0.0, 0.0);
        for (node, weight) in corners.nodes.iter().zip(weights) {
            let slot = self.known[&self.grid.index_of(bricks.place_of(*node as usize))] as usize;
            if sites.standing[slot] == Standing::Open {
                let light = irradiance_of(&sampled.node(slot));
                sum.iter_mut().zip(light).for_each(|(sum, light)| *sum += weight * light);
                total += weight;
                variance += (f64::from(weight) * sampled.estimates.first(slot).standard_error).powi(2);
            }
        }
        if total < 1e-6 {
            return f64::INFINITY;
        }
        sum.iter_mut().for_each(|value| *value /= total);
        self.off_by(found as usize, &sum, variance / f64::from(total).powi(2))
    }

    /// By how many tolerances light is off what was baked at a slot, more than noise explains: `variance` is that of E in it.
    fn off_by(&self, slot: usize, light: &Irradiance, variance: f64) -> f64 {
        let Batch { sampled, scale: Scale { median, .. }, .. } = self.batch();
        let estimate = sampled.estimates.first(slot);
        let off = root_mean_square(&difference(light, &irradiance_of(&sampled.node(slot))));
        let noise = NOISE * (variance + estimate.standard_error.powi(2));
        let beyond = (off.powi(2) - noise).max(0.0).sqrt();
        // All black: nothing is off.
        if beyond == 0.0 { 0.0 } else { beyond / (self.tolerance * estimate.rms_irradiance.max(0.1 * median)) }
    }

    /// Everything in the open is lit alike, and there is no surface.
    fn is_even(&self) -> bool {
        let Batch { sites, sampled, .. } = self.batch();
        let open = || (0..sites.standing.len()).filter(|slot| sites.standing[*slot] == Standing::Open);
        let count = open().count() as f32;
        if count == 0.0 || !self.occupied.is_empty() {
            return false;
        }
        let mut mean = [0.0; 27];
        for slot in open() {
            let light = irradiance_of(&sampled.node(slot));
            mean.iter_mut().zip(light).for_each(|(mean, light)| *mean += light / count);
        }
        open().all(|slot| self.off_by(slot, &mean, 0.0) <= 1.0)
    }

    /// Puts cells together again in which nothing is in the open.
    fn merge_solid(&mut self) {
        for level in 1..=self.tree.levels {
            let is_buried = |cell: &Cell| {
                self.tree.has(*cell)
                    && cell.children(self.grid).all(|child| !self.tree.has(child))
                    && cell.places(self.grid).all(|place| self.is_open(place) != Some(true))
            };
            let buried: Vec<Cell> = self.tree.cells_of(level).into_par_iter().filter(is_buried).collect();
            let mut kept = self.tree.clone();
            buried.iter().for_each(|cell| kept.set(*cell, false));
            // What touches smaller cells is needed nevertheless.
            let mut tree = Flags::new(self.grid.counts, self.tree.levels);
            for level in 1..=tree.levels {
                for cell in kept.cells_of(level).into_iter().filter(|cell| kept.has(*cell)) {
                    tree.refine(cell, &mut Vec::new());
                }
            }
            self.tree = tree;
        }
    }

    /// One node says it all.
    fn one_node(self) -> Result<(Nodes, Baked, Option<SparseRecord>), Interrupted> {
        let nodes = Nodes::Grid(Grid { counts: [1; 3], ..*self.grid });
        let mut baked = bake(&nodes, self.function, self.settings, self.control)?;
        let batch = self.batch();
        baked.rays += batch.sites.rays + batch.sampled.rays;
        baked.samples += batch.sampled.samples;
        let bricks = self.bricks();
        let mut record = self.check(&nodes, &mut baked, &bricks)?;
        record.levels.iter_mut().for_each(|level| level.cells = 0);
        Ok((nodes, baked, Some(record)))
    }

    /// The volume of these nodes, all of which are baked.
    fn finish(mut self, nodes: Nodes, bricks: &Bricks) -> Result<(Nodes, Baked, Option<SparseRecord>), Interrupted> {
        let index_of = |node: usize| match &nodes {
            Nodes::Sparse(sparse) => sparse.index_of(node),
            _ => node as u32,
        };
        // Merged cells may have corners where there were none: those are in a solid, too.
        self.bake_missing((0..nodes.len()).map(index_of).collect())?;
        let slots: Vec<u32> = (0..nodes.len()).map(|node| self.known[&index_of(node)]).collect();
        let batch = self.batch().selected(&slots, self.settings);
        let mut baked = finish(&nodes, self.function, self.settings, self.control, batch)?;
        baked.rays += self.rays;
        let record = self.check(&nodes, &mut baked, bricks)?;
        Ok((nodes, baked, Some(record)))
    }

    /// Compares what the volume answers with what was baked and is no node: where cells were tested that could have been divided, and
    /// in the middles of some of those that were not, which are baked for it.
    fn check(&self, nodes: &Nodes, baked: &mut Baked, bricks: &Bricks) -> Result<SparseRecord, Interrupted> {
        let volume = volume_of(nodes, baked);
        let most = (volume.node_count() / CHECKED_SHARE).clamp(LEAST_CHECKED, MOST_CHECKED);
        let cell_of = |leaf: &Leaf| Cell { level: leaf.level, index: leaf.origin.map(|place| place >> leaf.level) };
        let mut levels: Vec<(u64, Vec<Leaf>)> = vec![(0, Vec::new()); self.tree.levels as usize + 1];
        for leaf in bricks.leaves() {
            levels[leaf.level as usize].1.push(leaf);
        }
        // Where the light of some was tested alone, what is off in those says nothing of all.
        for (count, leaves) in &mut levels {
            *count = leaves.len() as u64;
            if leaves.iter().any(|leaf| self.tests(cell_of(leaf)).is_empty()) {
                let every = leaves.len().div_ceil(most);
                *leaves = leaves.iter().copied().skip(every / 2).step_by(every).collect();
            }
        }
        let middle = |leaf: &Leaf| {
            let [low, high] = [0, 7].map(|corner| DVec3::from(self.grid.place_position(bricks.corner(*leaf, corner))));
            (low + high) / 2.0
        };
        let untested = |leaf: &&Leaf| self.tests(cell_of(leaf)).is_empty();
        let places =
            Nodes::Points(levels.iter().flat_map(|(_, leaves)| leaves.iter().filter(untested).map(middle)).collect());
        let scale = self.batch().scale;
        let numbers = (0..places.len() as u32).collect();
        let checks = Batch::sample(&places, numbers, Some(scale), self.function, self.settings, self.control)?;
        baked.rays += checks.sites.rays + checks.sampled.rays;
        baked.samples += checks.sampled.samples;

        let error = |Batch { sites, sampled, .. }: &Batch, slot: usize, position: DVec3| {
            let light = irradiance_of(&sampled.node(slot));
            (sites.standing[slot] == Standing::Open)
                .then(|| error_at(&volume, position.into(), &light, scale.median))
                .flatten()
        };
        let mut checked = 0;
        let mut record =
            SparseRecord { tolerance: self.tolerance, places: self.grid.node_count() as u64, levels: Vec::new() };
        for (cells, leaves) in levels {
            let mut errors = Vec::new();
            for leaf in leaves {
                let tests = self.tests(cell_of(&leaf));
                if tests.is_empty() {
                    errors.extend(error(&checks, checked, middle(&leaf)));
                    checked += 1;
                }
                for (place, _) in tests.into_iter().filter(|(place, _)| bricks.node_at(*place).is_none()) {
                    let slot = self.known.get(&self.grid.index_of(place));
                    let position = DVec3::from(self.grid.place_position(place));
                    errors.extend(slot.and_then(|slot| error(self.batch(), *slot as usize, position)));
                }
            }
            let checked = errors.len() as u64;
            record.levels.push(SparseLevel { cells, checked, error: ErrorSummary::of(errors.into_iter()) });
        }
        Ok(record)
    }
}

/// The relative error of a volume at a place where light was baked; `None` where it has none of its own.
fn error_at(volume: &Volume, position: [f64; 3], light: &Irradiance, median: f64) -> Option<f64> {
    let sample = volume.sample_f64(position, [0.0; 3]);
    let found = irradiance_of(sample.sh.coefficients.as_flattened());
    let off = difference(&found, light);
    let scale = root_mean_square(light).max(0.1 * median);
    (sample.validity > 0.0 && scale > 0.0).then(|| root_mean_square(&off) / scale)
}
