//! Eight-wide bounding volume hierarchy: obvhs builds a binary tree, `collapse` widens it, this traverses it.
//!
//! Why not obvhs' own traversal: its triangle tests leak at edges, its boxes are clipped at an absolute distance,
//! and a wide tree of f32 boxes is 1.6 to 3.3 times as fast. Based on: Wald, Benthin, Boulos,
//! "Getting Rid of Packets", 2008 (wide nodes); Ize, "Robust BVH Ray Traversal", JCGT 2(2), 2013 (the far distance
//! of a box grows by a few ulps, so that rounding never loses a box the ray touches).
//!
//! Where the processor has AVX2, `simd` tests boxes and triangles, with the same bits as what stands here. Against
//! Embree 4: `tools/trace_bench`.

use glam::{Vec3, Vec3A};
use obvhs::{BvhBuildParams, aabb::Aabb, bvh2::builder::build_bvh2};

use super::collapse::{Collapse, DEEPEST, MAX_DEPTH};
use super::simd::{Avx2, Stack};
use super::triangle::{ShearedRay, TriangleBlock};

/// Children per node.
pub const WIDTH: usize = 8;
/// 1 + 2·γ(3) of Ize 2013: makes the box test conservative in f32.
pub const FAR_MARGIN: f32 = 1.000_000_5;
/// Boxes grow by this share of the largest coordinate, because the triangle test, watertight as it is, rounds
/// corners relative to the ray's origin. At 1e-6: no escape in 1e8 rays (`tools/extremes`).
const BOX_PADDING: f32 = 1e-6;
/// Every level leaves at most seven siblings behind.
const STACK: usize = DEEPEST * (WIDTH - 1) + 1;
/// obvhs' slowest build, without its second round of reinsertion: that takes almost as long as all the rest, for 1 to 2 %
/// of the tracing. Three rounds of the first win as much, a twentieth of one loses up to 10 %. Splitting large triangles
/// beforehand won nothing (`tools/trace_bench`).
const BUILD: BvhBuildParams = BvhBuildParams {
    max_prims_per_leaf: 1,
    post_collapse_reinsertion_batch_ratio_multiplier: 0.0,
    ..BvhBuildParams::very_slow_build()
};

/// A node, or the blocks of a leaf, in 32 bits: the index of the node; or the highest bit, three bits of how many
/// blocks less one, and the index of the first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Child(u32);

impl Child {
    const LEAF: u32 = 1 << 31;
    const INDEX_BITS: u32 = 28;
    /// Most blocks of a leaf.
    pub const MAX_BLOCKS: usize = 8;

    /// An inner node.
    pub fn node(index: usize) -> Child {
        assert!(index < Child::LEAF as usize, "{index} nodes");
        Child(index as u32)
    }

    /// A leaf of 1..=8 blocks.
    pub fn leaf(first: usize, count: usize) -> Child {
        assert!(
            (1..=Child::MAX_BLOCKS).contains(&count) && first < 1 << Child::INDEX_BITS,
            "{count} blocks at {first}"
        );
        Child(Child::LEAF | ((count - 1) as u32) << Child::INDEX_BITS | first as u32)
    }

    /// The blocks of a leaf.
    #[inline(always)]
    fn blocks(self) -> Option<std::ops::Range<usize>> {
        let first = (self.0 & ((1 << Child::INDEX_BITS) - 1)) as usize;
        let count = (self.0 >> Child::INDEX_BITS & 7) as usize + 1;
        (self.0 & Child::LEAF != 0).then_some(first..first + count)
    }
}

/// Eight boxes and what is in them.
#[derive(Debug, Clone)]
#[repr(C, align(64))]
pub struct Node {
    /// `bounds[axis][0]` minimum, `bounds[axis][1]` maximum, per child. Empty children: min = +inf, max = -inf.
    pub bounds: [[[f32; WIDTH]; 2]; 3],
    pub children: [Child; WIDTH],
}

impl Node {
    pub const EMPTY: Node =
        Node { bounds: [[[f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]]; 3], children: [Child(0); WIDTH] };
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

impl TreeHit {
    /// Takes the place of `best` if it is nearer, of equally near ones the triangle of the lower index, and `accept` lets
    /// it count.
    #[inline(always)]
    pub(super) fn keep_nearest(
        self,
        t_max: f32,
        accept: &mut impl FnMut(&TreeHit) -> bool,
        best: &mut Option<TreeHit>,
        nearest: &mut f32,
    ) {
        let nearer = best.is_none_or(|b| self.t < b.t || (self.t == b.t && self.triangle < b.triangle));
        if nearer && self.t < t_max && accept(&self) {
            *best = Some(self);
            *nearest = self.t;
        }
    }
}

/// Triangles in a hierarchy, ready to trace.
#[derive(Debug)]
pub struct Tree {
    nodes: Vec<Node>,
    blocks: Vec<TriangleBlock>,
    avx2: Option<Avx2>,
}

impl Tree {
    /// Builds over finite triangles. Deterministic. An empty list makes a tree that nothing hits.
    pub fn build(triangles: &[[Vec3; 3]]) -> Tree {
        Tree::build_to_depth(triangles, MAX_DEPTH)
    }

    fn build_to_depth(triangles: &[[Vec3; 3]], max_depth: usize) -> Tree {
        let mut tree = Tree { nodes: Vec::new(), blocks: Vec::new(), avx2: Avx2::detect() };
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
        let binary = build_bvh2(&boxes, BUILD, &mut Default::default());
        (tree.nodes, tree.blocks) = Collapse::run(&binary, triangles, max_depth);
        tree
    }

    /// The same tree, traced without AVX2, as on other processors: slower, to the same bits.
    pub fn portable(self) -> Tree {
        Tree { avx2: None, ..self }
    }

    /// Rays go through by AVX2.
    pub fn uses_avx2(&self) -> bool {
        self.avx2.is_some()
    }

    /// The nearest hit with `t_min < t < t_max` (of equal ones, the triangle of the lowest index) that `accept`
    /// (hit → bool) lets count.
    #[inline]
    pub fn closest(
        &self,
        origin: Vec3,
        direction: Vec3,
        t_min: f32,
        t_max: f32,
        accept: impl FnMut(&TreeHit) -> bool,
    ) -> Option<TreeHit> {
        let (slabs, sheared) = (Slabs::new(origin, direction), ShearedRay::new(origin, direction));
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = self.avx2 {
            return avx2.closest(self, (slabs, sheared), (t_min, t_max), accept);
        }
        self.closest_portable((slabs, sheared), (t_min, t_max), accept)
    }

    #[inline(never)]
    fn closest_portable(
        &self,
        (slabs, sheared): (Slabs, ShearedRay),
        (t_min, t_max): (f32, f32),
        mut accept: impl FnMut(&TreeHit) -> bool,
    ) -> Option<TreeHit> {
        let mut best = None;
        traverse::<true>(
            self,
            t_max,
            |node, nearest| slabs.entries(node, nearest),
            |block, nearest| {
                for hit in sheared.intersect(block) {
                    if hit.t > t_min && hit.t <= *nearest {
                        hit.keep_nearest(t_max, &mut accept, &mut best, nearest);
                    }
                }
                true
            },
        );
        best
    }

    /// Calls `visit` for the hits with `t_min < t < t_max`, in no useful order, each triangle once, until it
    /// returns false.
    #[inline]
    pub fn any(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32, visit: impl FnMut(&TreeHit) -> bool) {
        let (slabs, sheared) = (Slabs::new(origin, direction), ShearedRay::new(origin, direction));
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = self.avx2 {
            return avx2.any(self, (slabs, sheared), (t_min, t_max), visit);
        }
        self.any_portable((slabs, sheared), (t_min, t_max), visit);
    }

    #[inline(never)]
    fn any_portable(
        &self,
        (slabs, sheared): (Slabs, ShearedRay),
        (t_min, t_max): (f32, f32),
        mut visit: impl FnMut(&TreeHit) -> bool,
    ) {
        traverse::<false>(
            self,
            t_max,
            |node, nearest| slabs.entries(node, nearest),
            |block, _| sheared.intersect(block).all(|hit| !(hit.t > t_min && hit.t < t_max) || visit(&hit)),
        );
    }

    /// Whether a triangle other than `ignore` (`u32::MAX`: any) is hit with `t_min < t < t_max`.
    pub fn is_hit(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32, ignore: u32) -> bool {
        let mut is_hit = false;
        self.any(origin, direction, t_min, t_max, |hit| {
            is_hit = hit.triangle != ignore;
            !is_hit
        });
        is_hit
    }

    /// Every triangle that lies, as far as boxes tell, in some space is `good`. `reaches` says which boxes of a node do,
    /// a bit each.
    pub fn all_in(&self, reaches: impl Fn(&Node) -> u32, mut good: impl FnMut(u32) -> bool) -> bool {
        let mut stack = Stack::<STACK>::new();
        if !self.nodes.is_empty() {
            stack.push(0);
        }
        while let Some(child) = stack.pop() {
            let child = Child(child as u32);
            if let Some(blocks) = child.blocks() {
                let mut triangles = self.blocks[blocks].iter().flat_map(|block| block.id).filter(|id| *id != u32::MAX);
                if !triangles.all(&mut good) {
                    return false;
                }
                continue;
            }
            let node = &self.nodes[child.0 as usize];
            let mut inside = reaches(node);
            while inside != 0 {
                stack.push(u64::from(node.children[inside.trailing_zeros() as usize % WIDTH].0));
                inside &= inside - 1;
            }
        }
        true
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<Node>() + self.blocks.len() * size_of::<TriangleBlock>()
    }
}

/// Hands every block whose boxes the ray touches before `nearest` to `leaf`, until it returns false. `boxes` says which
/// children of a node the ray enters (a bit each), and where (none negative). Near ones come first: all, where `ORDERED`;
/// else the nearest child of a node, and the rest as they stand, which finds some hit 1 to 4 % faster.
#[inline(always)]
pub fn traverse<const ORDERED: bool>(
    tree: &Tree,
    t_max: f32,
    boxes: impl Fn(&Node, f32) -> (u32, [f32; WIDTH]),
    mut leaf: impl FnMut(&TriangleBlock, &mut f32) -> bool,
) {
    if tree.nodes.is_empty() {
        return;
    }
    let mut nearest = t_max;
    // A key: where the ray enters, then the child. Floats that are not negative sort as their bits do.
    let mut stack = Stack::<STACK>::new();
    let mut child = Child(0);
    loop {
        // Down to a leaf, by the nearest child of each node.
        let blocks = loop {
            if let Some(blocks) = child.blocks() {
                break blocks;
            }
            let node = &tree.nodes[child.0 as usize];
            let (mut entered, entries) = boxes(node, nearest);
            if entered == 0 {
                break 0..0;
            }
            let mut next = || {
                let slot = entered.trailing_zeros() as usize % WIDTH;
                entered &= entered - 1;
                (slot, entered == 0)
            };
            let (slot, is_only) = next();
            if is_only {
                child = node.children[slot];
                continue;
            }
            let key = |slot: usize| u64::from(entries[slot].to_bits()) << 32 | u64::from(node.children[slot].0);
            let base = stack.len();
            let mut first = key(slot);
            loop {
                let (slot, is_last) = next();
                let key = key(slot);
                if ORDERED {
                    stack.insert(base, key.max(first));
                } else {
                    stack.push(key.max(first));
                }
                first = key.min(first);
                if is_last {
                    break;
                }
            }
            child = Child(first as u32);
        };
        for block in &tree.blocks[blocks] {
            if !leaf(block, &mut nearest) {
                return;
            }
        }
        // Up to what is still near enough.
        child = loop {
            let Some(key) = stack.pop() else { return };
            if f32::from_bits((key >> 32) as u32) <= nearest {
                break Child(key as u32);
            }
        };
    }
}

/// A ray prepared for box tests.
#[derive(Debug)]
pub struct Slabs {
    pub origin: [f32; 3],
    pub reciprocal: [f32; 3],
    /// Which of `bounds` is nearer, per axis.
    pub near: [usize; 3],
}

impl Slabs {
    #[inline(always)]
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        // A zero component would make 0·∞ = NaN on a box face; the smallest slope with a finite reciprocal keeps
        // a ray in its slab just as well.
        let reciprocal = direction.to_array().map(|d| if d.abs() < 1e-30 { 1e30f32.copysign(d) } else { 1.0 / d });
        let near = reciprocal.map(|r| usize::from(r < 0.0));
        Slabs { origin: origin.to_array(), reciprocal, near }
    }

    /// Which children's boxes the ray enters before `nearest`, a bit each, and where it does.
    #[inline(always)]
    fn entries(&self, node: &Node, nearest: f32) -> (u32, [f32; WIDTH]) {
        let mut entry = [[0.0f32; WIDTH]; 3];
        let mut exit = [[0.0f32; WIDTH]; 3];
        for axis in 0..3 {
            let near = &node.bounds[axis][self.near[axis]];
            let far = &node.bounds[axis][1 - self.near[axis]];
            for slot in 0..WIDTH {
                entry[axis][slot] = (near[slot] - self.origin[axis]) * self.reciprocal[axis];
                exit[axis][slot] = (far[slot] - self.origin[axis]) * self.reciprocal[axis];
            }
        }
        // As the instructions have it, and so the same bits of zeros.
        let max = |a: f32, b: f32| if a > b { a } else { b };
        let min = |a: f32, b: f32| if a < b { a } else { b };
        let mut entries = [0.0f32; WIDTH];
        let mut bits = [0u32; WIDTH];
        for slot in 0..WIDTH {
            entries[slot] = max(max(entry[0][slot], entry[1][slot]), max(entry[2][slot], 0.0));
            let exit = min(min(exit[0][slot], exit[1][slot]), exit[2][slot]);
            bits[slot] = if entries[slot] <= min(exit * FAR_MARGIN, nearest) { 1 << slot } else { 0 };
        }
        let entered = bits.iter().fold(0, |all, bit| all | bit);
        (entered, entries)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{Sampler, Stream, uniform_sphere};

    fn soup(count: u32) -> Vec<[Vec3; 3]> {
        let point = |i: u32, pair: u32| {
            let stream = Stream::new(Sampler::Random, 3, u64::from(i), 0);
            let ([x, y], [z, _]) = (stream.point(0, pair), stream.point(1, pair));
            Vec3::new(x, y, z)
        };
        (0..count).map(|i| [1, 2, 3].map(|pair| point(i, 0) * 100.0 - 50.0 + point(i, pair) * 10.0)).collect()
    }

    #[test]
    fn every_triangle_lies_in_one_lane() {
        for count in [1, 8, 9, 64, 65, 5000] {
            for max_depth in [1, 2, MAX_DEPTH] {
                let tree = Tree::build_to_depth(&soup(count), max_depth);
                let mut seen = vec![0; count as usize];
                let mut open = vec![Child(0)];
                while let Some(child) = open.pop() {
                    let Some(blocks) = child.blocks() else {
                        let node = &tree.nodes[child.0 as usize];
                        let full = (0..WIDTH).filter(|slot| node.bounds[0][0][*slot] < f32::INFINITY);
                        open.extend(full.map(|slot| node.children[slot]));
                        continue;
                    };
                    let ids = tree.blocks[blocks].iter().flat_map(|block| block.id);
                    ids.filter(|id| *id != u32::MAX).for_each(|id| seen[id as usize] += 1);
                }
                assert!(seen.iter().all(|times| *times == 1), "{count} triangles, depth {max_depth}");
            }
        }
    }

    #[test]
    fn what_lies_too_deep_is_found_all_the_same() {
        let triangles = soup(5000);
        let [usual, flat] = [MAX_DEPTH, 1].map(|depth| Tree::build_to_depth(&triangles, depth));
        let mut hits = 0;
        for ray in 0..1000 {
            let direction = uniform_sphere(Stream::new(Sampler::Random, 4, 0, ray).point(0, 0));
            let [a, b] = [&usual, &flat].map(|t| t.closest(Vec3::ZERO, direction, 0.0, f32::INFINITY, |_| true));
            assert_eq!(a, b, "ray {ray}");
            hits += u32::from(a.is_some());
        }
        assert!(hits > 500, "{hits}");
    }
}
