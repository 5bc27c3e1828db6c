//! What a file says of each of its nodes, one array for each kind of figure: for tables, pages and pictures.

use gdibl_runtime::format::{self, Directory, Limits};
use gdibl_runtime::{Error, Volume};
use half::f16;
use serde::Serialize;

/// Figures of all nodes, by node. `None`: the file says nothing, so that there is none, or it was not measured.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Figures {
    /// One standard error of irradiance, relative.
    pub noise: Option<Vec<f32>>,
    /// Systematic error of irradiance, relative.
    pub systematic: Option<Vec<f32>>,
    /// Share of what a node sees that some probe has seen, 0..=1.
    pub coverage: Option<Vec<f32>>,
    /// 1: baked; 0: filled from neighbours.
    pub validity: Option<Vec<f32>>,
    /// Edge of the finest cell that a node is a corner of, in places of the finest grid: 1, 2, 4, 8. Sparse grids alone.
    pub cell_size: Option<Vec<f32>>,
}

/// A kind of figure, by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Figure {
    /// [`Figures::noise`].
    Noise,
    /// [`Figures::systematic`].
    Systematic,
    /// [`Figures::coverage`].
    Coverage,
    /// [`Figures::validity`].
    Validity,
    /// [`Figures::cell_size`].
    CellSize,
}

impl Figure {
    /// All kinds.
    pub const ALL: [Figure; 5] =
        [Figure::Noise, Figure::Systematic, Figure::Coverage, Figure::Validity, Figure::CellSize];

    /// Its name, as in [`Figures`].
    pub fn name(self) -> &'static str {
        match self {
            Figure::Noise => "noise",
            Figure::Systematic => "systematic",
            Figure::Coverage => "coverage",
            Figure::Validity => "validity",
            Figure::CellSize => "cell_size",
        }
    }

    /// What is worse is less: of the others, what is worse is more.
    pub fn less_is_worse(self) -> bool {
        matches!(self, Figure::Coverage | Figure::Validity)
    }
}

impl Figures {
    /// Reads what the runtime reads, and the sections that it leaves to tools.
    ///
    /// # Errors
    /// A section is damaged.
    pub fn read(directory: &Directory, volume: &Volume) -> Result<Figures, Error> {
        let nodes = 0..volume.node_count();
        let has = |id| directory.section(id).is_some();
        let noise = nodes.clone().map(|node| volume.node_relative_error(node)).collect();
        let coverage = has(format::COVERAGE).then(|| nodes.clone().map(|node| volume.node_coverage(node)).collect());
        let validity =
            has(format::VALIDITY).then(|| nodes.map(|node| if volume.is_valid(node) { 1.0 } else { 0.0 }).collect());
        let systematic = directory.section_bytes(format::SYSTEMATIC_ERROR, &Limits::default())?.map(|bytes| {
            bytes.as_chunks().0.iter().map(|&half| f16::from_le_bytes(half).to_f32()).collect::<Vec<f32>>()
        });
        let systematic = systematic.filter(|all| all.len() == volume.node_count());
        Ok(Figures { noise, systematic, coverage, validity, cell_size: cell_sizes(volume) })
    }

    /// Errors and coverage of nodes that were filled are nobody's: they become -1.
    pub fn forget_filled(&mut self, volume: &Volume) {
        let Figures { noise, systematic, coverage, .. } = self;
        for values in [noise, systematic, coverage].into_iter().flatten() {
            values
                .iter_mut()
                .enumerate()
                .filter(|(node, _)| !volume.is_valid(*node))
                .for_each(|(_, value)| *value = -1.0);
        }
    }

    /// Those of one kind.
    pub fn of(&self, figure: Figure) -> Option<&[f32]> {
        match figure {
            Figure::Noise => self.noise.as_deref(),
            Figure::Systematic => self.systematic.as_deref(),
            Figure::Coverage => self.coverage.as_deref(),
            Figure::Validity => self.validity.as_deref(),
            Figure::CellSize => self.cell_size.as_deref(),
        }
    }
}

fn cell_sizes(volume: &Volume) -> Option<Vec<f32>> {
    let bricks = volume.bricks()?;
    let mut sizes = vec![f32::INFINITY; volume.node_count()];
    for leaf in bricks.leaves() {
        let size = (1u32 << leaf.level) as f32;
        for node in bricks.corners(leaf).nodes {
            let own = &mut sizes[node as usize];
            *own = own.min(size);
        }
    }
    // A node that only larger cells hang on to is as coarse as it can be.
    let coarsest = (1u32 << bricks.levels()) as f32;
    sizes.iter_mut().for_each(|size| *size = size.min(coarsest));
    Some(sizes)
}

/// Boxes of the cells that walls go through: lower and upper corner, world metres.
pub fn walled_boxes(volume: &Volume) -> Vec<[[f64; 3]; 2]> {
    let Some(grid) = volume.grid() else { return Vec::new() };
    let of_cell = |cell: u32| match volume.bricks() {
        None => {
            let (min, max) = grid.cell_box(cell);
            [min, max]
        }
        Some(bricks) => {
            let leaf = bricks.leaf(grid.place_of(cell));
            [0, 7].map(|corner| grid.place_position(bricks.corner(leaf, corner)))
        }
    };
    volume.wall_tables().1.iter().map(|wall| of_cell(wall.cell)).collect()
}
