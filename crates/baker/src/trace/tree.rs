//! Eight-wide bounding volume hierarchy: obvhs builds a binary tree, this collapses it and traverses it.
//!
//! Why not obvhs' own traversal: its triangle tests leak at edges, its boxes are clipped at an absolute distance,
//! and it is two to eight times slower than a wide tree of f32 boxes on the same build. Based on: Wald, Benthin,
//! Boulos, "Getting Rid of Packets", 2008 (wide nodes); Ize, "Robust BVH Ray Traversal", JCGT 2(2), 2013 (the
//! far distance of a box grows by a few ulps, so that rounding never loses a box the ray touches).

use glam::{Vec3, Vec3A};
use obvhs::{BvhBuildParams, aabb::Aabb, bvh2::Bvh2, bvh2::builder::build_bvh2};

use super::triangle::{LANES, ShearedRay, TriangleBlock};

/// Children per node.
const WIDTH: usize = 8;
/// 1 + 2·γ(3) of Ize 2013: makes the box test conservative in f32.
const FAR_MARGIN: f32 = 1.000_000_5;
/// Boxes grow by this share of the largest coordinate, because the triangle test, watertight as it is, rounds
/// corners relative to the ray's origin. At 1e-6: no escape in 1e8 rays (`tools/extremes`).
const BOX_PADDING: f32 = 1e-6;
/// Levels of wide nodes; what lies deeper becomes one leaf (a balanced tree of 2^32 triangles has 10 levels).
const MAX_DEPTH: usize = 18;
/// Every level leaves at most seven siblings behind.
const STACK: usize = MAX_DEPTH * (WIDTH - 1) + 1;

/// A child: an inner node, or `count` blocks of triangles from `first`.
#[derive(Debug, Clone, Copy)]
struct Child {
    first: u32,
    /// 0: inner node.
    count: u32,
}

#[derive(Debug, Clone)]
#[repr(align(64))]
struct Node {
    /// `bounds[0][axis]` minimum, `bounds[1][axis]` maximum, per child. Empty children: min = +inf, max = -inf.
    bounds: [[[f32; WIDTH]; 3]; 2],
    children: [Child; WIDTH],
}

/// A hit as the tree knows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TreeHit {
    /// In lengths of the ray's direction.
    pub t: f32,
    /// Index of the triangle as given to [`Tree::build`].
    pub triangle: u32,
    /// Weight of corner 1.
    pub v: f32,
    /// Weight of corner 2.
    pub w: f32,
}

/// Triangles in a hierarchy, ready to trace.
#[derive(Debug)]
pub struct Tree {
    nodes: Vec<Node>,
    blocks: Vec<TriangleBlock>,
}

impl Tree {
    /// Builds over finite triangles. Deterministic. An empty list makes a tree that nothing hits.
    pub fn build(triangles: &[[Vec3; 3]]) -> Tree {
        let mut tree = Tree { nodes: Vec::new(), blocks: Vec::new() };
        if triangles.is_empty() {
            return tree;
        }
        let largest = triangles.iter().flatten().fold(0.0f32, |m, c| m.max(c.abs().max_element()));
        let padding = Vec3A::splat((largest * BOX_PADDING).max(f32::MIN_POSITIVE));
        let boxes: Vec<Aabb> = triangles
            .iter()
            .map(|corners| {
                let [a, b, c] = corners.map(Vec3A::from);
                Aabb::new(a.min(b).min(c) - padding, a.max(b).max(c) + padding)
            })
            .collect();
        let parameters = BvhBuildParams { max_prims_per_leaf: LANES as u32, ..BvhBuildParams::very_slow_build() };
        let binary = build_bvh2(&boxes, parameters, &mut Default::default());
        tree.collapse(&binary, triangles);
        tree
    }

    /// Turns the binary tree into eight-wide nodes: the child with the largest surface is opened until eight
    /// stand side by side.
    fn collapse(&mut self, binary: &Bvh2, triangles: &[[Vec3; 3]]) {
        self.nodes.push(Node::EMPTY);
        let mut open = vec![(0usize, 0usize, 1usize)]; // (wide node, binary node, depth)
        while let Some((wide, root, depth)) = open.pop() {
            let mut children = vec![root];
            if binary.nodes[root].prim_count == 0 {
                let first = binary.nodes[root].first_index as usize;
                children = vec![first, first + 1];
            }
            while children.len() < WIDTH {
                let inner = children.iter().enumerate().filter(|(_, n)| binary.nodes[**n].prim_count == 0);
                let largest = inner.max_by(|(i, a), (j, b)| {
                    let area = |n: usize| binary.nodes[n].aabb().half_area();
                    area(**a).total_cmp(&area(**b)).then(j.cmp(i))
                });
                let Some((slot, &node)) = largest else { break };
                let first = binary.nodes[node].first_index as usize;
                children[slot] = first;
                children.insert(slot + 1, first + 1);
            }
            for (slot, &child) in children.iter().enumerate() {
                let node = &binary.nodes[child];
                let bounds = node.aabb();
                for axis in 0..3 {
                    self.nodes[wide].bounds[0][axis][slot] = bounds.min[axis];
                    self.nodes[wide].bounds[1][axis][slot] = bounds.max[axis];
                }
                self.nodes[wide].children[slot] = if node.prim_count == 0 && depth < MAX_DEPTH {
                    self.nodes.push(Node::EMPTY);
                    open.push((self.nodes.len() - 1, child, depth + 1));
                    Child { first: self.nodes.len() as u32 - 1, count: 0 }
                } else {
                    let first = self.blocks.len() as u32;
                    for ids in triangles_below(binary, child).chunks(LANES) {
                        let mut block = TriangleBlock::EMPTY;
                        for (lane, &id) in ids.iter().enumerate() {
                            block.set(lane, id, triangles[id as usize]);
                        }
                        self.blocks.push(block);
                    }
                    Child { first, count: self.blocks.len() as u32 - first }
                };
            }
        }
    }

    /// The nearest hit with `t_min < t < t_max` (of equal ones, the triangle of the lowest index) that `accept`
    /// (hit → bool) lets count.
    pub fn closest(
        &self,
        origin: Vec3,
        direction: Vec3,
        t_min: f32,
        t_max: f32,
        mut accept: impl FnMut(&TreeHit) -> bool,
    ) -> Option<TreeHit> {
        let mut best: Option<TreeHit> = None;
        self.traverse(origin, direction, t_max, |ray, block, nearest| {
            let hit = ray.intersect(block);
            for lane in 0..LANES {
                let t = hit.t[lane];
                if t > t_min && t <= *nearest && t < t_max {
                    let candidate = TreeHit { t, triangle: block.id[lane], v: hit.v[lane], w: hit.w[lane] };
                    let nearer = best.is_none_or(|b| t < b.t || candidate.triangle < b.triangle);
                    if nearer && accept(&candidate) {
                        best = Some(candidate);
                        *nearest = t;
                    }
                }
            }
            true
        });
        best
    }

    /// Calls `visit` for the hits with `t_min < t < t_max`, in no useful order, each triangle once, until it
    /// returns false.
    pub fn any(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32, mut visit: impl FnMut(&TreeHit) -> bool) {
        self.traverse(origin, direction, t_max, |ray, block, _| {
            let hit = ray.intersect(block);
            for lane in 0..LANES {
                let t = hit.t[lane];
                if t > t_min
                    && t < t_max
                    && !visit(&TreeHit { t, triangle: block.id[lane], v: hit.v[lane], w: hit.w[lane] })
                {
                    return false;
                }
            }
            true
        });
    }

    /// Hands every block whose boxes the ray touches before `nearest` to `leaf`, near ones first, until it
    /// returns false.
    #[inline(always)]
    fn traverse(
        &self,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        mut leaf: impl FnMut(&ShearedRay, &TriangleBlock, &mut f32) -> bool,
    ) {
        if self.nodes.is_empty() {
            return;
        }
        let sheared = ShearedRay::new(origin, direction);
        let slabs = Slabs::new(origin, direction);
        let mut nearest = t_max;
        let mut stack = [(0.0f32, Child { first: 0, count: 0 }); STACK];
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let (entry, child) = stack[top];
            if entry > nearest {
                continue;
            }
            if child.count > 0 {
                for block in &self.blocks[child.first as usize..(child.first + child.count) as usize] {
                    if !leaf(&sheared, block, &mut nearest) {
                        return;
                    }
                }
                continue;
            }
            let node = &self.nodes[child.first as usize];
            let entries = slabs.entries(node, nearest);
            let base = top;
            for (slot, &entry) in entries.iter().enumerate() {
                if entry <= nearest {
                    // Insertion keeps the nearest on top.
                    let mut at = top;
                    while at > base && stack[at - 1].0 < entry {
                        stack[at] = stack[at - 1];
                        at -= 1;
                    }
                    stack[at] = (entry, node.children[slot]);
                    top += 1;
                }
            }
        }
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<Node>() + self.blocks.len() * size_of::<TriangleBlock>()
    }
}

/// The triangles in the leaves under a node of the binary tree.
fn triangles_below(binary: &Bvh2, root: usize) -> Vec<u32> {
    let mut ids = Vec::new();
    let mut open = vec![root];
    while let Some(index) = open.pop() {
        let node = &binary.nodes[index];
        let first = node.first_index as usize;
        if node.prim_count == 0 {
            open.extend([first + 1, first]);
        } else {
            ids.extend_from_slice(&binary.primitive_indices[first..first + node.prim_count as usize]);
        }
    }
    ids
}

impl Node {
    const EMPTY: Node = Node {
        bounds: [[[f32::INFINITY; WIDTH]; 3], [[f32::NEG_INFINITY; WIDTH]; 3]],
        children: [Child { first: 0, count: 0 }; WIDTH],
    };
}

/// A ray prepared for box tests.
struct Slabs {
    origin: [f32; 3],
    reciprocal: [f32; 3],
    /// Which of `bounds` is nearer, per axis.
    near: [usize; 3],
}

impl Slabs {
    fn new(origin: Vec3, direction: Vec3) -> Self {
        // A zero component would make 0·∞ = NaN on a box face; the smallest slope with a finite reciprocal keeps
        // a ray in its slab just as well.
        let reciprocal = direction.to_array().map(|d| if d.abs() < 1e-30 { 1e30f32.copysign(d) } else { 1.0 / d });
        let near = reciprocal.map(|r| usize::from(r < 0.0));
        Slabs { origin: origin.to_array(), reciprocal, near }
    }

    /// Where the ray enters each child's box; NaN where it misses.
    #[inline(always)]
    fn entries(&self, node: &Node, nearest: f32) -> [f32; WIDTH] {
        let mut entry = [0.0f32; WIDTH];
        let mut exit = [nearest; WIDTH];
        for axis in 0..3 {
            let near = &node.bounds[self.near[axis]][axis];
            let far = &node.bounds[1 - self.near[axis]][axis];
            let (origin, reciprocal) = (self.origin[axis], self.reciprocal[axis]);
            for slot in 0..WIDTH {
                let t0 = (near[slot] - origin) * reciprocal;
                let t1 = (far[slot] - origin) * reciprocal * FAR_MARGIN;
                entry[slot] = if t0 > entry[slot] { t0 } else { entry[slot] };
                exit[slot] = if t1 < exit[slot] { t1 } else { exit[slot] };
            }
        }
        for slot in 0..WIDTH {
            entry[slot] = if entry[slot] <= exit[slot] { entry[slot] } else { f32::NAN };
        }
        entry
    }
}
