//! Whether no light from infinity can reach any node: each stands in a closed, opaque shell.
//!
//! A proof, not a guess by rays, for a keyhole is enough to let a sun in. Parts of the level that hang together by their corners are
//! shells if each of their edges is passed as often one way as the other, so that they have no rim. Who stands in one is wound round by
//! it: a ray outward crosses it more often one way than the other, and nothing gets through.

use glam::Vec3;
use rayon::prelude::*;
use std::collections::HashMap;

use super::Nodes;
use crate::disjoint::Disjoint;
use crate::scene::Scene;
use crate::trace::{Frame, Tree};

/// Directions that have to agree, along no edge of anything.
const DIRECTIONS: [Vec3; 3] =
    [Vec3::new(0.7312, 0.4121, 0.5437), Vec3::new(-0.3127, 0.8219, -0.4762), Vec3::new(0.2911, -0.6173, 0.7309)];

/// The triangles of closed, opaque parts of a level.
#[derive(Debug)]
pub struct Shells {
    frame: Frame,
    tree: Tree,
    corners: Vec<[Vec3; 3]>,
    of_triangle: Vec<u32>,
    count: usize,
}

impl Shells {
    /// Those of a level.
    pub fn of(scene: &Scene) -> Shells {
        // Corners that lie in one place are one.
        let mut places: HashMap<[u64; 3], u32> = HashMap::new();
        let mut parts = Disjoint::default();
        let mut triangles = Vec::new();
        let mut clear = Vec::new();
        for mesh in &scene.meshes {
            let is_clear = scene.materials[mesh.material as usize].lets_light_through();
            for ids in &mesh.triangles {
                let positions = ids.map(|id| mesh.positions[id as usize]);
                // Plus zero, so that both zeros are one.
                let corners = positions.map(|p| {
                    let next = places.len() as u32;
                    *places.entry((p + 0.0).to_array().map(f64::to_bits)).or_insert(next)
                });
                parts.grow(places.len() as u32);
                parts.join(corners[0], corners[1]);
                parts.join(corners[0], corners[2]);
                if is_clear {
                    clear.push(corners[0]);
                }
                triangles.push((corners, positions));
            }
        }
        // Each edge, passed one way and the other.
        let mut balance: HashMap<(u32, u32), i32> = HashMap::new();
        for ([a, b, c], _) in &triangles {
            for (from, to) in [(*a, *b), (*b, *c), (*c, *a)] {
                *balance.entry((from.min(to), from.max(to))).or_default() += if from < to { 1 } else { -1 };
            }
        }
        let open = balance.iter().filter(|(_, balance)| **balance != 0).map(|((corner, _), _)| *corner);
        let leaky: Vec<u32> = open.chain(clear).map(|corner| parts.first(corner)).collect();
        let mut is_shell = vec![true; places.len()];
        leaky.into_iter().for_each(|part| is_shell[part as usize] = false);

        let frame = Frame::of_scene(scene);
        let mut numbers: HashMap<u32, u32> = HashMap::new();
        let (mut corners, mut of_triangle) = (Vec::new(), Vec::new());
        for (ids, positions) in &triangles {
            let part = parts.first(ids[0]);
            if is_shell[part as usize] {
                let next = numbers.len() as u32;
                of_triangle.push(*numbers.entry(part).or_insert(next));
                corners.push(positions.map(|position| frame.to_trace(position)));
            }
        }
        Shells { frame, tree: Tree::build(&corners), corners, of_triangle, count: numbers.len() }
    }

    /// No node sees what is beyond the level.
    pub fn seal(&self, nodes: &Nodes) -> bool {
        !self.of_triangle.is_empty()
            && (0..nodes.len()).into_par_iter().all(|node| self.enclose(nodes.ray_origin(node, &self.frame)))
    }

    /// One of them winds round a place (trace space), whichever way one looks.
    fn enclose(&self, place: Vec3) -> bool {
        let mut windings = vec![0; self.count];
        let mut around = vec![true; self.count];
        for direction in DIRECTIONS {
            windings.fill(0);
            self.tree.any(place, direction, 0.0, f32::INFINITY, |hit| {
                let [a, b, c] = self.corners[hit.triangle as usize];
                let is_back = (b - a).cross(c - a).dot(direction) > 0.0;
                windings[self.of_triangle[hit.triangle as usize] as usize] += if is_back { 1 } else { -1 };
                true
            });
            around.iter_mut().zip(&windings).for_each(|(around, winding)| *around &= *winding != 0);
        }
        around.contains(&true)
    }
}
