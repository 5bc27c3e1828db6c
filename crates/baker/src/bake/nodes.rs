//! Where irradiance is baked: a grid, the level's vertices, or listed points.

use gdibl_runtime::bricks::Bricks;
use gdibl_runtime::grid::Grid;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::collections::HashMap;

use crate::scene::{Mesh, Scene};
use crate::trace::Frame;

/// Vertices, and grid nodes in the walls of the level's box, leave their surface by this share of half the level's size (see `trace::Frame`): enough for f32 rays
/// to start in the open, a tenth of a millimetre in a room.
const VERTEX_OFFSET: f32 = 5e-3;

/// Cells along the longest side of a level by default.
const USUAL_CELLS: u32 = 31;

/// The nodes of a volume.
#[derive(Debug, Clone, PartialEq)]
pub enum Nodes {
    /// Lattice, x fastest.
    Grid(Grid),
    /// Some places of a lattice, in the order of the bricks.
    Sparse(SparseGrid),
    /// Positions, world metres.
    Points(Vec<DVec3>),
    /// Every vertex of every mesh that keeps one.
    Vertices {
        /// World positions, metres, on the surface.
        positions: Vec<DVec3>,
        /// World unit normals.
        normals: Vec<Vec3>,
        /// Mean of the unit directions from the vertex to the middles of its triangles; zero where they surround it.
        inward: Vec<Vec3>,
        /// Which mesh they belong to.
        sets: Vec<VertexSet>,
    },
}

/// A grid some of whose places are nodes.
#[derive(Debug, Clone, PartialEq)]
pub struct SparseGrid {
    /// All places.
    pub grid: Grid,
    /// Which are nodes.
    pub bricks: Bricks,
}

impl SparseGrid {
    /// The index in the grid of a node's place.
    pub fn index_of(&self, node: usize) -> u32 {
        self.grid.index_of(self.bricks.place_of(node))
    }
}

/// The vertices of one primitive of one glTF node, in the file's order, as many as the file has; of instances one after
/// another. Sets of primitives that share the file's vertices are one set of nodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VertexSet {
    /// glTF node index.
    pub node: u32,
    /// glTF mesh index.
    pub mesh: u32,
    /// Primitive index within the mesh.
    pub primitive: u32,
    /// First entry.
    pub first: u32,
    /// Number of entries.
    pub count: u32,
}

impl Nodes {
    /// All vertices of the level, with their normals: those of a primitive in the file's order and as many as the file has.
    /// One that no triangle uses stands where the last one before it stands that some triangle uses, or the first.
    pub fn vertices_of(scene: &Scene) -> Nodes {
        // Primitives of a mesh that share the file's vertices share nodes; instances follow one another. (A few bytes may name
        // a shared accessor of millions: past what a volume holds, only vertices in use count.)
        let all = |mesh: &Mesh| u64::from(mesh.file_count) * (u64::from(mesh.instance) + 1);
        let is_whole = scene.meshes.iter().map(all).sum::<u64>() <= u64::from(u32::MAX);
        let mut blocks: Vec<(VertexSet, u32)> = Vec::new();
        let mut block_of: HashMap<(u32, u32, [u32; 2], u32), usize> = HashMap::new();
        let mut owners = Vec::with_capacity(scene.meshes.len());
        for (index, mesh) in scene.meshes.iter().enumerate() {
            let used = mesh.positions.len() as u32;
            let is_own = mesh.file_count == 0 || !is_whole;
            let (count, own) = if is_own { (used, index as u32) } else { (mesh.file_count.max(used), u32::MAX) };
            let at = *block_of.entry((mesh.node, mesh.mesh, mesh.file_accessors, own)).or_insert_with(|| {
                let VertexSet { node, mesh, primitive, .. } = set_of(mesh);
                blocks.push((VertexSet { node, mesh, primitive, first: 0, count }, 0));
                blocks.len() - 1
            });
            blocks[at].1 = if is_own { 1 } else { blocks[at].1.max(mesh.instance + 1) };
            owners.push(at);
        }
        let mut total = 0;
        for (block, instances) in &mut blocks {
            block.first = total;
            total += block.count * *instances;
        }
        let mut nodes: Vec<Option<(DVec3, Vec3, Vec3)>> = vec![None; total as usize];
        let mut sets: Vec<VertexSet> = Vec::new();
        for (mesh, &owner) in scene.meshes.iter().zip(&owners) {
            let (block, instances) = blocks[owner];
            let first = block.first + mesh.instance.min(instances - 1) * block.count;
            for (vertex, inward) in directions_inward(mesh).into_iter().enumerate() {
                let number = mesh.file_numbers.get(vertex).copied().filter(|_| is_whole).unwrap_or(vertex as u32);
                nodes[(first + number) as usize].get_or_insert((mesh.positions[vertex], mesh.normals[vertex], inward));
            }
            let set = VertexSet { first: block.first, count: block.count * instances, ..set_of(mesh) };
            if sets.last() != Some(&set) {
                sets.push(set);
            }
        }
        let (mut positions, mut normals, mut inward) = (Vec::new(), Vec::new(), Vec::new());
        for (block, instances) in &blocks {
            let own = &nodes[block.first as usize..(block.first + block.count * instances) as usize];
            let mut last = own.iter().flatten().next().copied().unwrap_or_default();
            for node in own {
                last = node.unwrap_or(last);
                positions.push(last.0);
                normals.push(last.1);
                inward.push(last.2);
            }
        }
        Nodes::Vertices { positions, normals, inward, sets }
    }

    /// How many.
    pub fn len(&self) -> usize {
        match self {
            Nodes::Grid(grid) => grid.node_count(),
            Nodes::Sparse(sparse) => sparse.bricks.node_count(),
            Nodes::Points(positions) | Nodes::Vertices { positions, .. } => positions.len(),
        }
    }

    /// The places in this list of node numbers, so ordered that those in a row stand near each other: along a Z-order
    /// curve (Morton, 1966) through their box.
    pub(super) fn neighbourhoods(&self, numbers: &[u32]) -> Vec<u32> {
        let position = |place: usize| self.position(numbers[place] as usize);
        const BITS: u32 = 10;
        let mut bounds = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        (0..numbers.len()).map(position).for_each(|p| bounds = (bounds.0.min(p), bounds.1.max(p)));
        let cell = (bounds.1 - bounds.0).max_element().max(f64::MIN_POSITIVE) / f64::from((1 << BITS) - 1);
        let code = |index: u32| {
            let place = (position(index as usize) - bounds.0) / cell;
            let bits = |number: f64, axis: u32| {
                (0..BITS).map(|bit| (number as u32 >> bit & 1) << (3 * bit + axis)).sum::<u32>()
            };
            u64::from(bits(place.x, 0) | bits(place.y, 1) | bits(place.z, 2)) << u32::BITS | u64::from(index)
        };
        // Codes with the indices behind them: no two are equal.
        let mut order: Vec<u64> = (0..numbers.len() as u32).into_par_iter().map(code).collect();
        order.par_sort_unstable();
        order.into_iter().map(|code| code as u32).collect()
    }

    /// No node at all.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// World position of a node, metres.
    pub fn position(&self, index: usize) -> DVec3 {
        match self {
            Nodes::Grid(grid) => DVec3::from(grid.node_position(index)),
            Nodes::Sparse(SparseGrid { grid, bricks }) => DVec3::from(grid.place_position(bricks.place_of(index))),
            Nodes::Points(positions) | Nodes::Vertices { positions, .. } => positions[index],
        }
    }

    /// World positions of `count` of the nodes, spread evenly over their numbers; of all where there are fewer.
    pub fn some_positions(&self, count: usize) -> Vec<DVec3> {
        let count = count.min(self.len());
        (0..count).map(|number| self.position(number * self.len() / count)).collect()
    }

    /// Edge of the pixel of a probe on a surface, metres, from which on what it shows is too coarse for these nodes in a level of this
    /// size (metres): half the spacing of the grid; of other nodes, that of the default grid. In a living room with 5 probes of 512 x
    /// 256, coarser pixels replaced by paths, RMSE of E was 1.35 % with the whole spacing, 0.32 % with half of it, 0.38 % with a
    /// quarter and 0.50 % with an eighth.
    pub fn coarsest_pixel(&self, size: f64) -> f32 {
        let spacing = match self {
            Nodes::Grid(grid) | Nodes::Sparse(SparseGrid { grid, .. }) => widest_spacing(grid),
            Nodes::Points(_) | Nodes::Vertices { .. } => 0.0,
        };
        let spacing = if spacing > 0.0 { spacing } else { size / f64::from(USUAL_CELLS) };
        (0.5 * spacing.min(size / 4.0)) as f32
    }

    /// Where the rays of a node start, trace units.
    pub fn ray_origin(&self, index: usize, frame: &Frame) -> Vec3 {
        let position = frame.to_trace(self.position(index));
        match self {
            // Inward, too: a corner of the floor lies exactly in the planes of two walls, and half of the rays from
            // there would leave the room through them.
            Nodes::Vertices { normals, inward, .. } => position + (normals[index] + inward[index]) * VERTEX_OFFSET,
            // The outermost nodes of a grid over the whole level lie exactly in its walls.
            Nodes::Grid(_) | Nodes::Sparse(_) => frame.off_the_walls(position, VERTEX_OFFSET),
            Nodes::Points(_) => position,
        }
    }
}

/// Which primitive a mesh is, without its nodes.
fn set_of(mesh: &Mesh) -> VertexSet {
    VertexSet { node: mesh.node, mesh: mesh.mesh, primitive: mesh.primitive, first: 0, count: 0 }
}

/// `inward` of [`Nodes::Vertices`] for one mesh.
fn directions_inward(mesh: &Mesh) -> Vec<Vec3> {
    let mut sums = vec![(DVec3::ZERO, 0.0); mesh.positions.len()];
    for triangle in &mesh.triangles {
        let corners = triangle.map(|i| mesh.positions[i as usize]);
        let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
        for (&vertex, corner) in triangle.iter().zip(corners) {
            let (sum, count) = &mut sums[vertex as usize];
            *sum += (middle - corner).normalize_or_zero();
            *count += 1.0;
        }
    }
    sums.into_iter().map(|(sum, count)| (sum / f64::max(count, 1.0)).as_vec3()).collect()
}

/// A grid over a box: `counts` nodes per axis, the first on `min`, the last on `max`; one node on a flat axis.
pub fn grid_of_counts(min: DVec3, max: DVec3, counts: [u32; 3]) -> Grid {
    let size = max - min;
    let counts = [0, 1, 2].map(|axis| if size[axis] > 0.0 { counts[axis] } else { 1 });
    Grid { min: min.into(), max: max.into(), counts }
}

/// A grid over a box with nodes at most `spacing` metres apart; the spacing shrinks per axis to fit.
pub fn grid_of_spacing(min: DVec3, max: DVec3, spacing: f64) -> Grid {
    let size = max - min;
    let counts = [0, 1, 2].map(|axis| {
        // A spacing that divides the box must not gain a node by rounding.
        let cells = (size[axis] / spacing - 1e-9).ceil().clamp(0.0, f64::from(u32::MAX - 1));
        cells as u32 + 1
    });
    grid_of_counts(min, max, counts)
}

/// The finest grid over a box that has at most so many nodes, about as far apart along each axis.
pub fn grid_of_nodes(min: DVec3, max: DVec3, nodes: u64) -> Grid {
    let count =
        |spacing: f64| grid_of_spacing(min, max, spacing).counts.iter().map(|count| f64::from(*count)).product();
    let fits = |count: f64| count <= nodes as f64;
    let longest = (max - min).max_element();
    if !fits(count(longest)) || longest <= 0.0 {
        return grid_of_counts(min, max, [1; 3]);
    }
    // Halved by geometric means: their roots are the same on every machine.
    let (mut too_fine, mut fine) = (longest * 1e-10, longest);
    for _ in 0..64 {
        let middle = (too_fine * fine).sqrt();
        if fits(count(middle)) { fine = middle } else { too_fine = middle }
    }
    grid_of_spacing(min, max, fine)
}

/// The greatest distance between neighbours, metres; 0 of one node.
pub fn widest_spacing(grid: &Grid) -> f64 {
    (0..3).filter(|axis| grid.counts[*axis] > 1).map(|axis| grid.spacing()[axis]).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spacing_shrinks_to_fit_and_flat_axes_have_one_node() {
        let grid = grid_of_spacing(DVec3::ZERO, DVec3::new(2.0, 0.0, 6.1), 0.2);
        assert_eq!(grid.counts, [11, 1, 32]);
        let grid = grid_of_spacing(DVec3::new(-1.0, 0.0, -3.0), DVec3::new(1.0, 2.0, 3.0), 0.2);
        assert_eq!(grid.counts, [11, 11, 31]);
        assert_eq!(grid_of_spacing(DVec3::ONE, DVec3::ONE, 0.5).counts, [1, 1, 1]);
        assert_eq!(grid_of_spacing(DVec3::ZERO, DVec3::ONE, 1e-30).counts[0], u32::MAX);
    }

    #[test]
    fn a_grid_of_some_nodes_is_the_finest_that_has_no_more() {
        let cube = |nodes| grid_of_nodes(DVec3::ZERO, DVec3::ONE, nodes).counts;
        assert_eq!(cube(1000), [10; 3]);
        assert_eq!(cube(1330), [10; 3]);
        assert_eq!(cube(1331), [11; 3]);
        assert_eq!(cube(8), [2; 3]);
        assert_eq!(cube(7), [1; 3]);
        // A tunnel, a floor, a place.
        assert_eq!(grid_of_nodes(DVec3::ZERO, DVec3::new(1.0, 1.0, 100.0), 44).counts, [2, 2, 11]);
        assert_eq!(grid_of_nodes(DVec3::ZERO, DVec3::new(1.0, 0.0, 1.0), 100).counts, [10, 1, 10]);
        assert_eq!(grid_of_nodes(DVec3::ONE, DVec3::ONE, 100).counts, [1; 3]);
        let many = grid_of_nodes(DVec3::ZERO, DVec3::new(3.0, 2.0, 1.0), 1_000_000);
        assert!((990_000..=1_000_000).contains(&many.node_count()), "{:?}", many.counts);
        // Nodes are about as far apart on every axis.
        let [x, y, z] = many.spacing();
        assert!((x / y - 1.0).abs() < 0.02 && (y / z - 1.0).abs() < 0.02);
    }
}
