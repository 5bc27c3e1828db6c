//! From a binary tree to one of eight children a node, at the least cost.
//!
//! Based on: Ylitie, Karras, Laine, "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs", 2017,
//! section 3.1. The cost of a tree is what a random line that meets its root may expect: of each node and each block
//! of triangles its cost times its surface (the surface area heuristic). With C(n, i) the least cost of the triangles
//! under binary node n as a forest of at most i trees, and l, r its children:
//!
//! ```text
//! C(n, 1) = min(leaf(n), surface(n) · NODE_COST + D(n, 8))
//! C(n, i) = min(C(n, i - 1), D(n, i))
//! D(n, i) = min over 0 < k < i of C(l, k) + C(r, i - k)
//! ```

use glam::Vec3;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;

use super::node::{Child, Hierarchy, Node, WIDTH};
use super::triangle::{LANES, TriangleBlock};

/// What a node costs, in blocks of triangles: mostly that nobody can tell how many children the ray enters. From 2.5 to 5
/// `tools/trace_bench` sees little difference but in the size of the tree; at 1, with leaves of one block, any hit took a
/// quarter longer.
const NODE_COST: f32 = 4.0;
/// Nodes from the root down to a leaf as they cost least.
pub const MAX_DEPTH: usize = 18;
/// And with what divides by count below: enough for 2^32 triangles.
pub const DEEPEST: usize = MAX_DEPTH + 10;

/// Triangles that stand together in the binary tree as one, each group under the number of the one.
#[derive(Debug)]
pub struct Groups {
    /// Where each group begins among `ids`, and where the last one ends.
    pub starts: Vec<u32>,
    /// Triangles.
    pub ids: Vec<u32>,
}

impl Groups {
    fn of(&self, number: u32) -> &[u32] {
        let [start, end] = [number, number + 1].map(|at| self.starts[at as usize] as usize);
        &self.ids[start..end]
    }
}

/// The tree in the making.
pub struct Collapse<'a> {
    binary: &'a Bvh2,
    groups: &'a Groups,
    triangles: &'a [[Vec3; 3]],
    max_depth: usize,
    /// C(n, 1..=7) of every binary node.
    costs: Vec<[f32; WIDTH - 1]>,
    /// Triangles under every binary node.
    counts: Vec<u32>,
    nodes: Vec<Node>,
    blocks: Vec<TriangleBlock>,
}

impl Collapse<'_> {
    /// The hierarchy of a tree of groups. From `max_depth` nodes down (at most [`MAX_DEPTH`]), triangles are divided by count.
    pub fn run(binary: &Bvh2, groups: &Groups, triangles: &[[Vec3; 3]], max_depth: usize) -> Hierarchy {
        let (costs, counts) = (vec![[0.0; WIDTH - 1]; binary.nodes.len()], vec![0; binary.nodes.len()]);
        let (nodes, blocks) = (Vec::new(), Vec::new());
        let mut collapse = Collapse { binary, groups, triangles, max_depth, costs, counts, nodes, blocks };
        collapse.find_costs();
        collapse.build();
        Hierarchy { nodes: collapse.nodes, blocks: collapse.blocks }
    }

    /// Bottom up.
    fn find_costs(&mut self) {
        let mut order = vec![0u32];
        let mut at = 0;
        while at < order.len() {
            let node = &self.binary.nodes[order[at] as usize];
            if node.prim_count == 0 {
                order.extend(children(node).map(|child| child as u32));
            }
            at += 1;
        }
        for n in order.into_iter().rev().map(|n| n as usize) {
            let node = &self.binary.nodes[n];
            if node.prim_count > 0 {
                self.counts[n] = self.groups_in(node).map(|ids| ids.len() as u32).sum();
                // Of a group that is too large for a leaf, about that of the nodes that it is divided among.
                let divided = node.aabb().half_area() * (self.blocks_of(n) as f32 + NODE_COST);
                self.costs[n] = [self.leaf_cost(n).min(divided); WIDTH - 1];
                continue;
            }
            self.counts[n] = children(node).map(|child| self.counts[child]).iter().sum();
            let inner = node.aabb().half_area() * NODE_COST + self.divided(n, WIDTH).0;
            self.costs[n][0] = inner.min(self.leaf_cost(n));
            for i in 2..WIDTH {
                self.costs[n][i - 1] = self.costs[n][i - 2].min(self.divided(n, i).0);
            }
        }
    }

    /// leaf(n); +infinity if it would have too many blocks.
    fn leaf_cost(&self, n: usize) -> f32 {
        let blocks = self.blocks_of(n);
        if blocks <= Child::MAX_BLOCKS {
            self.binary.nodes[n].aabb().half_area() * blocks as f32
        } else {
            f32::INFINITY
        }
    }

    fn blocks_of(&self, n: usize) -> usize {
        (self.counts[n] as usize).div_ceil(LANES)
    }

    /// The groups of a leaf of the binary tree.
    fn groups_in(&self, leaf: &Bvh2Node) -> impl Iterator<Item = &[u32]> {
        let first = leaf.first_index as usize;
        let numbers = &self.binary.primitive_indices[first..first + leaf.prim_count as usize];
        numbers.iter().map(|number| self.groups.of(*number))
    }

    /// D(n, i), and its k.
    fn divided(&self, n: usize, i: usize) -> (f32, usize) {
        let [left, right] = children(&self.binary.nodes[n]).map(|child| &self.costs[child]);
        let mut least = (f32::INFINITY, 1);
        for k in 1..i {
            let cost = left[k - 1] + right[i - k - 1];
            if cost < least.0 {
                least = (cost, k);
            }
        }
        least
    }

    /// The roots of the forest that D(n, i) counts.
    fn forest(&self, n: usize, i: usize, roots: &mut Vec<usize>) {
        let (_, k) = self.divided(n, i);
        let [left, right] = children(&self.binary.nodes[n]);
        for (child, mut trees) in [(left, k), (right, i - k)] {
            while trees > 1 && self.costs[child][trees - 1] == self.costs[child][trees - 2] {
                trees -= 1;
            }
            if trees == 1 {
                roots.push(child);
            } else {
                self.forest(child, trees, roots);
            }
        }
    }

    fn is_leaf(&self, n: usize) -> bool {
        self.binary.nodes[n].prim_count > 0 || self.costs[n][0] == self.leaf_cost(n)
    }

    /// Top down.
    fn build(&mut self) {
        self.nodes.push(Node::EMPTY);
        let mut open = vec![(0usize, 0usize, 1usize)]; // (node, binary node, depth)
        let mut roots = Vec::new();
        while let Some((at, n, depth)) = open.pop() {
            roots.clear();
            if self.is_leaf(n) {
                roots.push(n); // the root of all
            } else {
                self.forest(n, WIDTH, &mut roots);
            }
            for (slot, &root) in roots.iter().enumerate() {
                let bounds = self.binary.nodes[root].aabb();
                let bounds = [bounds.min.to_array(), bounds.max.to_array()];
                let child = if self.is_leaf(root) || depth == self.max_depth {
                    self.divide_by_count(&self.triangles_below(root), bounds)
                } else {
                    self.nodes.push(Node::EMPTY);
                    open.push((self.nodes.len() - 1, root, depth + 1));
                    Child::node(self.nodes.len() - 1)
                };
                self.set_child(at, slot, child, bounds);
            }
        }
    }

    fn set_child(&mut self, node: usize, slot: usize, child: Child, [min, max]: [[f32; 3]; 2]) {
        let node = &mut self.nodes[node];
        node.children[slot] = child;
        for axis in 0..3 {
            node.bounds[axis][0][slot] = min[axis];
            node.bounds[axis][1][slot] = max[axis];
        }
    }

    fn leaf(&mut self, ids: &[u32]) -> Child {
        let first = self.blocks.len();
        for ids in ids.chunks(LANES) {
            let mut block = TriangleBlock::EMPTY;
            for (lane, &id) in ids.iter().enumerate() {
                block.set(lane, id, self.triangles[id as usize]);
            }
            self.blocks.push(block);
        }
        Child::leaf(first, self.blocks.len() - first)
    }

    /// A leaf; of too many triangles for one, nodes whose children all have the same box, but fewer triangles each.
    fn divide_by_count(&mut self, ids: &[u32], bounds: [[f32; 3]; 2]) -> Child {
        if ids.len() <= LANES * Child::MAX_BLOCKS {
            return self.leaf(ids);
        }
        let node = self.nodes.len();
        self.nodes.push(Node::EMPTY);
        for (slot, ids) in ids.chunks(ids.len().div_ceil(WIDTH)).enumerate() {
            let child = self.divide_by_count(ids, bounds);
            self.set_child(node, slot, child, bounds);
        }
        Child::node(node)
    }

    /// The triangles in the leaves under a node of the binary tree.
    fn triangles_below(&self, root: usize) -> Vec<u32> {
        let mut ids = Vec::new();
        let mut open = vec![root];
        while let Some(index) = open.pop() {
            let node = &self.binary.nodes[index];
            if node.prim_count == 0 {
                let [left, right] = children(node);
                open.extend([right, left]);
            } else {
                self.groups_in(node).for_each(|group| ids.extend_from_slice(group));
            }
        }
        ids
    }
}

fn children(node: &Bvh2Node) -> [usize; 2] {
    [node.first_index as usize, node.first_index as usize + 1]
}
