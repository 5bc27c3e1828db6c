//! Light for nodes that have none of their own, from those that have.
//!
//! On a grid, sparse or not: layer by layer from the neighbours, and then smoothed until it is as even as what surrounds it (the solution
//! of Laplace's equation over the filled nodes, by Gauss and Seidel's sweeps). Neighbours count unless a wall stands
//! between; the surface of the solid that a node stands in is none. Of points and vertices: from the nearest.

use gdibl_runtime::grid::Grid;
use gdibl_runtime::nearest::NearestIndex;
use gdibl_runtime::sh;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::cells::{Cells, Neighbours};
use super::{Baked, Nodes, Standing};
use crate::radiance::RadianceFunction;
use crate::trace::Level;
use crate::{Control, Interrupted};

/// Sweeps of the smoothing: light spreads by about its square root of cells.
const SWEEPS: usize = 24;
/// Two rays from either end met one and the same surface if their lengths add up to the whole but for this share.
const SAME: f32 = 1e-3;

/// Fills all nodes that are not valid, of a grid with their light taken at `place` (trace space). If none is valid they stay
/// black, and the caller has to say so. Returns the rays traced.
pub(super) fn fill(
    nodes: &Nodes,
    baked: &mut Baked,
    function: &impl RadianceFunction,
    place: impl Fn(u32) -> Vec3 + Sync,
    control: &Control,
) -> Result<u64, Interrupted> {
    if baked.is_all_valid() || baked.valid_nodes().next().is_none() {
        return Ok(0);
    }
    let Some(cells) = Cells::of(nodes) else {
        fill_from_nearest(nodes, baked);
        return Ok(0);
    };
    let invalid: Vec<u32> = (0..nodes.len() as u32).filter(|node| !baked.is_valid(*node as usize)).collect();
    let link = |level: &mut Level, &node: &u32| match control.cancelled() {
        true => Err(Interrupted),
        false => {
            let in_solid = baked.standing[node as usize] != Standing::Uncovered;
            let passes = |(neighbour, _): &(u32, u32)| passes(level, place(node), place(*neighbour), in_solid);
            let links = cells.neighbours(node).map(|neighbour| neighbour.filter(passes));
            Ok((links, level.take_rays()))
        }
    };
    let links: Result<Vec<_>, Interrupted> = invalid.par_iter().map_init(|| function.level(), link).collect();
    let (mut links, rays): (Vec<Neighbours>, Vec<u64>) = links?.into_iter().unzip();
    let mut known: Vec<bool> = (0..nodes.len()).map(|node| baked.is_valid(node)).collect();
    let mut filled = spread(&invalid, &links, cells.grid, baked, &mut known);
    // Whoever is left stands where walls are all around.
    for (links, &node) in links.iter_mut().zip(&invalid) {
        if !known[node as usize] {
            *links = cells.neighbours(node);
        }
    }
    filled.extend(spread(&invalid, &links, cells.grid, baked, &mut known));
    for _ in 0..SWEEPS {
        for &number in &filled {
            let mean = mean(&links[number], cells.grid, baked, &known);
            set(baked, invalid[number], &mean);
        }
    }
    Ok(rays.iter().sum())
}

/// Nothing stands between two places, or that alone which the first is behind.
fn passes(level: &Level, from: Vec3, to: Vec3, in_solid: bool) -> bool {
    let Some(near) = level.meet(from, to - from, 1.0) else { return true };
    let Some(far) = level.meet(to, from - to, 1.0) else { return true };
    in_solid && (near.t + far.t - 1.0).abs() < SAME
}

/// Gives nodes that are not known the mean of those neighbours that are, layer by layer: each reads the one before alone.
/// Returns the numbers of those it reached, in that order.
fn spread(invalid: &[u32], links: &[Neighbours], grid: &Grid, baked: &mut Baked, known: &mut [bool]) -> Vec<usize> {
    let mut reached = Vec::new();
    let mut rest: Vec<usize> = (0..invalid.len()).filter(|number| !known[invalid[*number] as usize]).collect();
    loop {
        let is_next = |number: &usize| links[*number].iter().flatten().any(|(neighbour, _)| known[*neighbour as usize]);
        let (layer, left): (Vec<usize>, Vec<usize>) = rest.into_iter().partition(is_next);
        if layer.is_empty() {
            return reached;
        }
        let means: Vec<Vec<f32>> = layer.iter().map(|number| mean(&links[*number], grid, baked, known)).collect();
        for (&number, mean) in layer.iter().zip(&means) {
            set(baked, invalid[number], mean);
            known[invalid[number] as usize] = true;
        }
        reached.extend(layer);
        rest = left;
    }
}

/// Of the neighbours that are known, each by the inverse square of its distance.
fn mean(links: &Neighbours, grid: &Grid, baked: &Baked, known: &[bool]) -> Vec<f32> {
    let spacing = grid.spacing();
    let mut sum = vec![0.0f32; 3 * sh::coefficient_count(baked.bands)];
    let mut total = 0.0;
    for (side, neighbour) in links.iter().enumerate() {
        let Some((neighbour, steps)) = neighbour.filter(|(neighbour, _)| known[*neighbour as usize]) else { continue };
        let weight = (1.0 / (spacing[side / 2] * f64::from(steps)).powi(2)) as f32;
        sum.iter_mut().zip(&*baked.node(neighbour as usize)).for_each(|(sum, value)| *sum += weight * value);
        total += weight;
    }
    sum.iter_mut().for_each(|value| *value /= total);
    sum
}

fn set(baked: &mut Baked, node: u32, values: &[f32]) {
    baked.sh.set(node as usize, values);
}

fn fill_from_nearest(nodes: &Nodes, baked: &mut Baked) {
    let valid: Vec<usize> = baked.valid_nodes().collect();
    let origin = nodes.position(valid[0]);
    let positions: Vec<[f32; 3]> =
        valid.iter().map(|node| (nodes.position(*node) - origin).as_vec3().to_array()).collect();
    let index = NearestIndex::build(&positions);
    let nearest = |node: usize| {
        let here: DVec3 = nodes.position(node) - origin;
        valid[index.nearest(&positions, here.to_array()).expect("some node is valid").index]
    };
    let mut light = vec![0.0; baked.sh.width()];
    for node in (0..nodes.len()).filter(|node| !baked.is_valid(*node)).collect::<Vec<_>>() {
        baked.sh.copy(nearest(node), &mut light);
        baked.sh.set(node, &light);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::{BakeSettings, bake, grid_of_counts};
    use crate::radiance::path::{Path, PathSettings};
    use crate::scene::{Material, Mesh, Scene};
    use std::sync::atomic::AtomicBool;

    #[test]
    fn light_does_not_fill_what_lies_behind_a_wall() {
        // A sheet at x = 0 between columns of nodes; those right behind it know nothing, those further behind do.
        let corner = |y: f64, z: f64| DVec3::new(0.0, y, z);
        let mesh = Mesh {
            positions: vec![corner(-9.0, -9.0), corner(9.0, -9.0), corner(9.0, 9.0), corner(-9.0, 9.0)],
            normals: vec![Vec3::X; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        let material = Material { double_sided: true, ..Material::default() };
        for (meshes, expected) in [(vec![mesh], 1.0), (Vec::new(), 3.0)] {
            let scene = Scene { meshes, materials: vec![material.clone()], ..Scene::default() };
            let function = Path::new(&scene, None, PathSettings::default());
            let grid = grid_of_counts(DVec3::new(-1.5, 0.0, 0.0), DVec3::new(1.5, 1.0, 1.0), [4, 2, 2]);
            let nodes = Nodes::Grid(grid);
            let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
            let settings = BakeSettings { bands: 0, samples: 4, ..BakeSettings::default() };
            let mut baked = bake(&nodes, &function, &settings, &control).unwrap();
            for node in 0..16 {
                baked.standing[node] = if node % 4 == 2 { Standing::Uncovered } else { Standing::Open };
                baked.sh.set(node, &[[5.0, 5.0, 0.0, 1.0][node % 4]; 3]);
            }
            let place = |node: u32| function.frame().to_trace(nodes.position(node as usize));
            let rays = fill(&nodes, &mut baked, &function, place, &control).unwrap();
            assert!(rays >= 16, "{rays}");
            for node in (0..16).filter(|node| node % 4 == 2) {
                assert!((baked.node(node)[0] - expected).abs() < 1e-3, "{expected}: {:?}", baked.node(node));
            }
        }
    }
}
