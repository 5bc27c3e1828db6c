//! Eight-wide bounding volume hierarchy: obvhs builds a binary tree, `collapse` widens it, `traverse` goes through it.
//!
//! Why not obvhs' own traversal: its triangle tests leak at edges, its boxes are clipped at an absolute distance,
//! and a wide tree of f32 boxes is 1.6 to 3.3 times as fast. Based on: Wald, Benthin, Boulos,
//! "Getting Rid of Packets", 2008 (wide nodes).
//!
//! Where the processor has AVX2, `simd` tests boxes and triangles; else `traverse` and `triangle` do, with the same bits.
//! Against Embree 4: `tools/trace_bench`.

use std::collections::HashMap;

use glam::{Vec3, Vec3A};
use obvhs::{BvhBuildParams, aabb::Aabb, bvh2::builder::build_bvh2};

use super::collapse::{Collapse, Groups, MAX_DEPTH};
use super::node::{Child, Hierarchy, Node, WIDTH};
use super::simd::Avx2;
use super::stack::Stack;
use super::traverse::{STACK, Slabs, traverse};
use super::triangle::{ShearedRay, TreeHit, TriangleBlock};

/// Boxes grow by this share of the largest coordinate, because the triangle test, watertight as it is, rounds
/// corners relative to the ray's origin. At 1e-6: no escape in 1e8 rays (`tools/extremes`).
const BOX_PADDING: f32 = 1e-6;
/// obvhs' slowest build, without its second round of reinsertion: that takes almost as long as all the rest, for 1 to 2 %
/// of the tracing. Three rounds of the first win as much, a twentieth of one loses up to 10 %. Splitting large triangles
/// beforehand won nothing (`tools/trace_bench`).
const BUILD: BvhBuildParams = BvhBuildParams {
    max_prims_per_leaf: 1,
    post_collapse_reinsertion_batch_ratio_multiplier: 0.0,
    ..BvhBuildParams::very_slow_build()
};

/// Boxes that are all reinserted. Of more, so many are; but at least this share. Reinsertion takes time by more than the
/// number of boxes, and little of it brings most: a tree of five million triangles took 9.7 instead of 52 seconds of CPU time, and tracing
/// no more.
const FULLY_REINSERTED: f32 = 250_000.0;
const LEAST_REINSERTED: f32 = 0.05;

/// Triangles in a hierarchy, ready to trace.
#[derive(Debug)]
pub struct Tree {
    hierarchy: Hierarchy,
    avx2: Option<Avx2>,
}

impl Tree {
    /// Builds over finite triangles. Deterministic. An empty list makes a tree that nothing hits.
    pub fn build(triangles: &[[Vec3; 3]]) -> Tree {
        Tree::build_to_depth(triangles, MAX_DEPTH)
    }

    fn build_to_depth(triangles: &[[Vec3; 3]], max_depth: usize) -> Tree {
        let mut tree = Tree { hierarchy: Hierarchy::default(), avx2: Avx2::detect() };
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
        let (boxes, groups) = grouped(&boxes);
        let reinsertion_batch_ratio = (FULLY_REINSERTED / boxes.len() as f32).clamp(LEAST_REINSERTED, 1.0);
        let build = BvhBuildParams { reinsertion_batch_ratio, ..BUILD };
        let binary = build_bvh2(&boxes, build, &mut Default::default());
        tree.hierarchy = Collapse::run(&binary, &groups, triangles, max_depth);
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
            return avx2.closest(&self.hierarchy, (slabs, sheared), (t_min, t_max), accept);
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
            &self.hierarchy,
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
            return avx2.any(&self.hierarchy, (slabs, sheared), (t_min, t_max), visit);
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
            &self.hierarchy,
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
        if !self.hierarchy.nodes.is_empty() {
            stack.push(0);
        }
        while let Some(child) = stack.pop() {
            let child = Child(child as u32);
            if let Some(blocks) = child.blocks() {
                let mut triangles =
                    self.hierarchy.blocks[blocks].iter().flat_map(|block| block.id).filter(|id| *id != u32::MAX);
                if !triangles.all(&mut good) {
                    return false;
                }
                continue;
            }
            let node = &self.hierarchy.nodes[child.0 as usize];
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
        self.hierarchy.nodes.len() * size_of::<Node>() + self.hierarchy.blocks.len() * size_of::<TriangleBlock>()
    }
}

/// Every box once, and the triangles in each. obvhs takes time by the square of the number of equal boxes.
fn grouped(boxes: &[Aabb]) -> (Vec<Aabb>, Groups) {
    let mut numbers = HashMap::with_capacity(boxes.len());
    let mut distinct: Vec<Aabb> = Vec::new();
    let bits = |own: &Aabb| [own.min, own.max].map(|corner| corner.to_array().map(f32::to_bits));
    let number_of = |own: &Aabb| {
        *numbers.entry(bits(own)).or_insert_with(|| {
            distinct.push(*own);
            distinct.len() as u32 - 1
        })
    };
    let group_of: Vec<u32> = boxes.iter().map(number_of).collect();
    // Counting sort.
    let mut starts = vec![0u32; distinct.len() + 1];
    group_of.iter().for_each(|group| starts[*group as usize + 1] += 1);
    for group in 0..distinct.len() {
        starts[group + 1] += starts[group];
    }
    let mut next = starts.clone();
    let mut ids = vec![0; boxes.len()];
    for (id, group) in group_of.iter().enumerate() {
        let place = &mut next[*group as usize];
        ids[*place as usize] = id as u32;
        *place += 1;
    }
    (distinct, Groups { starts, ids })
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

    /// How often each triangle stands in a leaf.
    fn times(tree: &Tree, count: usize) -> Vec<u32> {
        let mut seen = vec![0; count];
        let mut open = vec![Child(0)];
        while let Some(child) = open.pop() {
            let Some(blocks) = child.blocks() else {
                let node = &tree.hierarchy.nodes[child.0 as usize];
                let full = (0..WIDTH).filter(|slot| node.bounds[0][0][*slot] < f32::INFINITY);
                open.extend(full.map(|slot| node.children[slot]));
                continue;
            };
            let ids = tree.hierarchy.blocks[blocks].iter().flat_map(|block| block.id);
            ids.filter(|id| *id != u32::MAX).for_each(|id| seen[id as usize] += 1);
        }
        seen
    }

    #[test]
    fn every_triangle_lies_in_one_lane() {
        for count in [1, 8, 9, 64, 65, 5000] {
            for max_depth in [1, 2, MAX_DEPTH] {
                let tree = Tree::build_to_depth(&soup(count), max_depth);
                let times = times(&tree, count as usize);
                assert!(times.iter().all(|times| *times == 1), "{count} triangles, depth {max_depth}");
            }
        }
    }

    #[test]
    fn triangles_in_one_box_are_each_there_and_the_first_of_equal_ones_is_hit() {
        for (count, copies) in [(1, 100_000), (3, 1000), (500, 7)] {
            let once = soup(count);
            let often = once.repeat(copies);
            let [alone, crowd] = [&once, &often].map(|triangles| Tree::build(triangles));
            assert!(times(&crowd, often.len()).iter().all(|times| *times == 1), "{count} triangles, {copies} times");
            let mut hits = 0;
            for ray in 0..1000 {
                let towards = once[ray as usize % once.len()].iter().sum::<Vec3>() / 3.0;
                let [a, b] = [&alone, &crowd].map(|t| t.closest(Vec3::ONE, towards - Vec3::ONE, 0.0, 9.0, |_| true));
                assert_eq!(a, b, "{count} triangles, ray {ray}");
                hits += u32::from(a.is_some());
            }
            assert_eq!(hits, 1000);
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
