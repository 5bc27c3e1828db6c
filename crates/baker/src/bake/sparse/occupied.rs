//! Which cells of a grid triangles reach into.

use gdibl_runtime::grid::Grid;
use glam::{DVec3, Vec3};

use super::cells::{Cell, Flags};
use crate::radiance::RadianceFunction;

/// A cell holds a triangle if that reaches so far into it, as a share of its half: walls that lie in the faces of cells are in none.
const WITHIN: f32 = 0.998;

/// Cells of the levels 1 and up that triangles reach into.
pub(super) fn occupied(grid: &Grid, levels: u32, function: &impl RadianceFunction) -> Flags {
    let mut tree = Flags::new(grid.counts, levels);
    let frame = function.frame();
    let coarsest = tree.extent(levels);
    let box_of = |cell: Cell| {
        let end =
            std::array::from_fn(|axis| cell.origin()[axis] + if grid.counts[axis] > 1 { 1 << cell.level } else { 0 });
        let corner = |place| frame.to_trace(DVec3::from(grid.place_position(place)));
        let (low, high) = (corner(cell.origin()), corner(end));
        // A flat axis is all of the grid's box.
        let is_flat = |axis: usize| grid.counts[axis] == 1;
        let (min, max) = (frame.to_trace(grid.min.into()), frame.to_trace(grid.max.into()));
        let low = Vec3::from_array(std::array::from_fn(|axis| if is_flat(axis) { min[axis] } else { low[axis] }));
        let high = Vec3::from_array(std::array::from_fn(|axis| if is_flat(axis) { max[axis] } else { high[axis] }));
        ((low + high) / 2.0, (high - low) / 2.0)
    };
    let spacing = grid.spacing();
    let level = function.level();
    let mut stack = Vec::new();
    for triangle in level.triangles() {
        let [a, b, c] = triangle.map(|corner| frame.to_world(corner));
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        let cell_at = |position: DVec3, axis: usize| match spacing[axis] > 0.0 {
            true => (position[axis] - grid.min[axis]) / (spacing[axis] * f64::from(1 << levels)),
            false => 0.0,
        };
        let range = |axis: usize| {
            let (first, last) = (cell_at(low, axis).floor(), cell_at(high, axis).floor());
            // Casts saturate.
            first.max(0.0) as u32..(last.min(f64::from(coarsest[axis]) - 1.0) + 1.0) as u32
        };
        for z in range(2) {
            for y in range(1) {
                stack.extend(range(0).map(|x| Cell { level: levels, index: [x, y, z] }));
            }
        }
        while let Some(cell) = stack.pop() {
            let (middle, half) = box_of(cell);
            if overlaps(triangle.map(|corner| corner - middle), half * WITHIN) {
                tree.set(cell, true);
                if cell.level > 1 {
                    stack.extend(cell.children(grid));
                }
            }
        }
    }
    tree
}

/// Whether a triangle reaches into a box around the origin. Based on: Akenine-Möller, "Fast 3D Triangle-Box Overlap Testing",
/// 2001: no axis separates them.
fn overlaps(triangle: [Vec3; 3], half: Vec3) -> bool {
    let [a, b, c] = triangle;
    let edges = [b - a, c - b, a - c];
    let separates = |axis: Vec3| {
        let [a, b, c] = triangle.map(|corner| corner.dot(axis));
        let reach = half.dot(axis.abs());
        a.min(b).min(c) > reach || a.max(b).max(c) < -reach
    };
    let units = [Vec3::X, Vec3::Y, Vec3::Z];
    !(units.into_iter().any(separates)
        || separates(edges[0].cross(edges[1]))
        || units.iter().any(|unit| edges.iter().any(|edge| separates(unit.cross(*edge)))))
}
