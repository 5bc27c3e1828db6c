//! Cells of a grid in several sizes, each of eight of the next smaller one.

use gdibl_runtime::bricks::MAX_LEVELS;
use gdibl_runtime::grid::Grid;

/// No axis of a grid grows by more than this to make whole coarse cells.
const MOST_GROWTH: f64 = 1.25;

/// The grid that a sparse volume is made of, for a grid that is asked for: counts grow until coarse cells fit in. The same where that
/// would take too much.
pub fn grid_of_cells(grid: Grid) -> Grid {
    let cells = grid.counts.map(|count| count.saturating_sub(1));
    let grown = |levels: u32| cells.map(|cells| cells.div_ceil(1 << levels) << levels);
    let fits = |levels: &u32| {
        grown(*levels).iter().zip(cells).all(|(grown, cells)| f64::from(*grown) <= MOST_GROWTH * f64::from(cells))
    };
    let levels = (0..=MAX_LEVELS).rev().find(fits).unwrap_or(0);
    Grid { counts: grown(levels).map(|cells| cells + 1), ..grid }
}

/// How often cells of a grid can be put together, eight to one; 0 where they cannot.
pub fn levels_of(grid: &Grid) -> u32 {
    let cells = grid.counts.iter().map(|count| count - 1).filter(|cells| *cells > 0);
    cells.map(|cells| cells.trailing_zeros()).min().unwrap_or(0).min(MAX_LEVELS)
}

/// A cell of some level: its lowest place is `index` times 2^level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Cell {
    pub level: u32,
    pub index: [u32; 3],
}

impl Cell {
    pub fn origin(self) -> [u32; 3] {
        self.index.map(|n| n << self.level)
    }

    /// Its eighths; fewer where the grid is flat.
    pub fn children(self, grid: &Grid) -> impl Iterator<Item = Cell> {
        let flat = grid.counts.map(|count| count == 1);
        let parts = (0..8u32).filter(move |part| (0..3).all(|axis| !flat[axis] || part >> axis & 1 == 0));
        parts.map(move |part| Cell {
            level: self.level - 1,
            index: std::array::from_fn(|axis| 2 * self.index[axis] + (part >> axis & 1)),
        })
    }

    /// Its corners, and those of its children if it may have any: 27 places, fewer where the grid is flat.
    pub fn places(self, grid: &Grid) -> impl Iterator<Item = [u32; 3]> {
        let origin = self.origin();
        let (half, most) = if self.level == 0 { (1, 2) } else { (1 << self.level >> 1, 3) };
        let steps = grid.counts.map(|count| if count > 1 { most } else { 1 });
        let all =
            (0..steps[2]).flat_map(move |z| (0..steps[1]).flat_map(move |y| (0..steps[0]).map(move |x| [x, y, z])));
        all.map(move |step: [u32; 3]| std::array::from_fn(|axis| origin[axis] + half * step[axis]))
    }
}

/// A flag for every cell of the levels 1 and up.
#[derive(Debug, Clone)]
pub(super) struct Flags {
    pub counts: [u32; 3],
    pub levels: u32,
    flags: Vec<Vec<bool>>,
}

impl Flags {
    pub fn new(counts: [u32; 3], levels: u32) -> Flags {
        let mut tree = Flags { counts, levels, flags: Vec::new() };
        tree.flags =
            (1..=levels).map(|level| vec![false; tree.extent(level).iter().map(|n| *n as usize).product()]).collect();
        tree
    }

    /// Cells per axis.
    pub fn extent(&self, level: u32) -> [u32; 3] {
        self.counts.map(|count| ((count - 1) >> level).max(1))
    }

    fn place(&self, Cell { level, index: [x, y, z] }: Cell) -> usize {
        let [nx, ny, _] = self.extent(level).map(|n| n as usize);
        x as usize + nx * (y as usize + ny * z as usize)
    }

    /// Not of level 0.
    pub fn has(&self, cell: Cell) -> bool {
        cell.level > 0 && self.flags[cell.level as usize - 1][self.place(cell)]
    }

    pub fn set(&mut self, cell: Cell, flag: bool) {
        let place = self.place(cell);
        self.flags[cell.level as usize - 1][place] = flag;
    }

    /// None is set.
    pub fn is_empty(&self) -> bool {
        self.flags.iter().flatten().all(|flag| !flag)
    }

    /// All cells of a level.
    pub fn cells_of(&self, level: u32) -> Vec<Cell> {
        let [nx, ny, nz] = self.extent(level);
        let places = (0..nz).flat_map(|z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z])));
        places.map(|index| Cell { level, index }).collect()
    }

    /// Refines a cell, and what must be with it: the parents of all cells that touch it. Adds those that were not to `refined`.
    pub fn refine(&mut self, cell: Cell, refined: &mut Vec<Cell>) {
        if self.has(cell) {
            return;
        }
        self.set(cell, true);
        refined.push(cell);
        if cell.level == self.levels {
            return;
        }
        let extent = self.extent(cell.level);
        for step in 0..27 {
            let near: [i64; 3] = std::array::from_fn(|axis| {
                i64::from(cell.index[axis]) + i64::from([step % 3, step / 3 % 3, step / 9][axis]) - 1
            });
            if (0..3).all(|axis| (0..i64::from(extent[axis])).contains(&near[axis])) {
                self.refine(Cell { level: cell.level + 1, index: near.map(|n| n as u32 / 2) }, refined);
            }
        }
    }
}
