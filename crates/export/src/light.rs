//! Light on a regular grid, as every engine's exporter starts from: the volume's own nodes, or sampled anew.
//!
//! ```text
//! nodes at corners    |----|----|----|       box from the first node to the last
//! the same, centres |--|--|--|--|--|--|--|   box half a spacing larger on each side: every node amid its cell
//! ```
//! Both hold the same nodes at the same places, so that no engine's placement costs anything.

use gdibl_runtime::{Grid, Kind, RadianceSh, Volume};

use crate::{Error, Note};

/// The most nodes: 1.3 GB of them.
const MAX_NODES: u64 = 1 << 22;

/// What a box without extent gets along that axis, metres, where an engine wants a solid one.
const THICKNESS: f64 = 1.0;

/// The highest band that the engines know.
pub(crate) const ENGINE_BANDS: u32 = 2;

/// Radiance at the nodes of a grid.
pub(crate) struct Light {
    /// Where the nodes are.
    pub grid: Grid,
    /// Radiance at each.
    pub nodes: Vec<RadianceSh>,
    /// The share of each that was baked rather than filled.
    pub validity: Vec<f32>,
    pub notes: Vec<Note>,
}

/// How few nodes an axis may have.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Least {
    /// One: nothing varies along it.
    One,
    /// Two, as tetrahedra need, and a solid box. An axis of one node gets two alike.
    Two,
}

impl Light {
    /// The light of a grid volume.
    pub fn of_volume(volume: &Volume, counts: Option<[u32; 3]>, least: Least) -> Result<Light, Error> {
        let Some(own) = volume.grid() else {
            return Err(Error::Unsupported(format!(
                "holds {} at {} places, and this format a grid: bake with --nodes grid, or export --to json",
                if volume.header().kind == Kind::Points { "points" } else { "vertices" },
                volume.node_count()
            )));
        };
        let (grid, mut notes) = target_grid(own, counts, least)?;
        let same = grid == own && volume.bricks().is_none();
        let (mut nodes, mut validity) = (Vec::new(), Vec::new());
        for index in 0..grid.node_count() {
            if same {
                nodes.push(volume.node_sh(index));
                validity.push(if volume.is_valid(index) { 1.0 } else { 0.0 });
            } else {
                let sample = volume.sample_f64(grid.node_position(index), [0.0, 1.0, 0.0]);
                nodes.push(sample.sh);
                validity.push(sample.validity);
            }
        }
        if volume.bricks().is_some() {
            let (nodes, to) = (volume.node_count(), text(grid.counts));
            notes.push(Note::new("resampled", format!("{nodes} nodes of a sparse grid were sampled at {to} places")));
        } else if counts.is_some_and(|counts| counts != own.counts) {
            let (from, to) = (text(own.counts), text(grid.counts));
            notes.push(Note::new("resampled", format!("{from} nodes were sampled at {to} places")));
        }
        let filled = validity.iter().filter(|&&share| share < 1.0).count();
        if filled > 0 {
            notes.push(Note::new(
                "filled-nodes",
                format!(
                    "{filled} nodes are filled from neighbours, not baked; the runtime leaves them out between nodes, \
                     this format does not tell them apart"
                ),
            ));
        }
        Ok(Light { grid, nodes, validity, notes })
    }

    /// The same without bands that engines do not know.
    #[must_use]
    pub fn truncated(mut self) -> Light {
        let bands = self.nodes.first().map_or(0, |sh| sh.bands);
        if bands > ENGINE_BANDS {
            self.nodes = self.nodes.iter().map(|sh| sh.truncate(ENGINE_BANDS)).collect();
            let what = match bands {
                3 => "band 3 was left out: it has no part in irradiance",
                _ => "bands 3 and 4 were left out: band 3 has no part in irradiance, band 4 a small one",
            };
            self.notes.push(Note::new("bands", what));
        } else if bands < ENGINE_BANDS {
            self.notes.push(Note::new("bands", format!("the volume holds L{bands}; bands above are zero")));
        }
        self
    }

    /// Nodes per axis.
    pub fn counts(&self) -> [usize; 3] {
        self.grid.counts.map(|count| count as usize)
    }

    /// The box whose cells have the nodes in their middle: min and max, metres. Solid also where the grid is flat.
    pub fn cell_box(&self) -> ([f64; 3], [f64; 3]) {
        let Grid { min, max, counts } = self.grid;
        let spacing = self.grid.spacing();
        let margin: [f64; 3] = std::array::from_fn(|axis| match (counts[axis], max[axis] - min[axis]) {
            (1, 0.0) => 0.5 * THICKNESS,
            (1, _) => 0.0,
            _ if spacing[axis] == 0.0 => 0.5 * THICKNESS,
            _ => 0.5 * spacing[axis],
        });
        (std::array::from_fn(|k| min[k] - margin[k]), std::array::from_fn(|k| max[k] + margin[k]))
    }
}

/// Where nodes shall be.
fn target_grid(own: Grid, counts: Option<[u32; 3]>, least: Least) -> Result<(Grid, Vec<Note>), Error> {
    let mut grid = Grid { counts: counts.unwrap_or(own.counts), ..own };
    let mut notes = Vec::new();
    if grid.counts.contains(&0) {
        return Err(Error::Settings(format!("--counts {}: every axis has at least one node", text(grid.counts))));
    }
    for axis in 0..3 {
        let name = ["x", "y", "z"][axis];
        if least == Least::Two && grid.counts[axis] == 1 {
            grid.counts[axis] = 2;
            notes.push(Note::new("flat-axis", format!("one node along {name} was written as two alike")));
        }
        if least == Least::Two && grid.min[axis] == grid.max[axis] {
            grid.min[axis] -= 0.5 * THICKNESS;
            grid.max[axis] += 0.5 * THICKNESS;
            notes.push(Note::new(
                "flat-box",
                format!("the box has no extent along {name}; written {THICKNESS} m thick"),
            ));
        }
    }
    let nodes = grid.counts.iter().map(|&count| u128::from(count)).product::<u128>();
    if nodes > u128::from(MAX_NODES) {
        let message =
            format!("{} are {nodes} nodes; exports hold up to {MAX_NODES}: give fewer --counts", text(grid.counts));
        return Err(if counts.is_some() { Error::Settings(message) } else { Error::Unsupported(message) });
    }
    Ok((grid, notes))
}

/// "8 x 4 x 2".
pub(crate) fn text(counts: [u32; 3]) -> String {
    let [x, y, z] = counts;
    format!("{x} x {y} x {z}")
}
