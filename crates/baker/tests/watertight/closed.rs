//! Closed meshes of lattices and spheres, placed anywhere in the world, and rays at what is hard to hit in them. The
//! extremes tool sends more of the same.

use gdibl_baker::sampling::{Sampler, Stream, uniform_sphere};
use gdibl_baker::scene::{Material, Mesh, Role, Scene};
use gdibl_baker::trace::{Frame, Surfaces};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

pub type Triangle = [DVec3; 3];

/// Faces of the lattice cells in `0..size` that `open` picks, where they border on one that it does not: closed, all
/// corners on the lattice, walls made of many coplanar triangles. Diagonals alternate.
pub fn lattice_mesh(size: i32, open: impl Fn([i32; 3]) -> bool) -> Vec<Triangle> {
    let mut triangles = Vec::new();
    let inside = |c: [i32; 3]| c.iter().all(|v| (0..size).contains(v)) && open(c);
    for index in 0..size * size * size {
        let cell = [index % size, index / size % size, index / size / size];
        if !inside(cell) {
            continue;
        }
        for axis in 0..3 {
            for side in 0..2 {
                let mut neighbour = cell;
                neighbour[axis] += 2 * side - 1;
                if inside(neighbour) {
                    continue;
                }
                let corner = |u: i32, v: i32| {
                    let mut c = cell;
                    c[axis] += side;
                    c[(axis + 1) % 3] += u;
                    c[(axis + 2) % 3] += v;
                    DVec3::new(c[0].into(), c[1].into(), c[2].into())
                };
                let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
                triangles.extend(if index % 2 == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] });
            }
        }
    }
    triangles
}

/// An icosahedron, each triangle split in four `splits` times, corners on the sphere of radius 4 around (4, 4, 4).
pub fn sphere_mesh(splits: u32) -> Vec<Triangle> {
    let golden = (1.0 + 5f64.sqrt()) / 2.0;
    let corners: Vec<DVec3> = (0..12)
        .map(|i| {
            let (s, t) = (f64::from(1 - 2 * (i & 1)), golden * f64::from(1 - (i & 2)));
            [DVec3::new(0.0, s, t), DVec3::new(s, t, 0.0), DVec3::new(t, 0.0, s)][i as usize / 4].normalize()
        })
        .collect();
    let edge = 2.0 / (1.0 + golden * golden).sqrt();
    let near = |a: DVec3, b: DVec3| (a.distance(b) - edge).abs() < 1e-9;
    let mut triangles = Vec::new();
    for (i, &a) in corners.iter().enumerate() {
        for (j, &b) in corners.iter().enumerate().skip(i + 1).filter(|(_, b)| near(a, **b)) {
            triangles.extend(corners[j + 1..].iter().filter(|c| near(a, **c) && near(b, **c)).map(|&c| [a, b, c]));
        }
    }
    assert_eq!(triangles.len(), 20);
    for _ in 0..splits {
        let split = |[a, b, c]: Triangle| {
            // The same bits for both triangles of an edge: a + b is b + a.
            let [ab, bc, ca] = [(a + b).normalize(), (b + c).normalize(), (c + a).normalize()];
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        };
        triangles = triangles.into_iter().flat_map(split).collect();
    }
    triangles.into_iter().map(|t| t.map(|p| p * 4.0 + DVec3::splat(4.0))).collect()
}

pub fn scene_of(triangles: &[Triangle]) -> Scene {
    let count = 3 * triangles.len() as u32;
    let mesh = Mesh {
        role: Role::Environment,
        positions: triangles.iter().flatten().copied().collect(),
        normals: vec![Vec3::Y; count as usize],
        triangles: (0..count / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        ..Mesh::default()
    };
    Scene { meshes: vec![mesh], materials: vec![Material::default()], ..Scene::default() }
}

/// A closed mesh, placed in the world, and places strictly inside it.
pub struct Closed {
    pub name: String,
    pub scene: Scene,
    pub surfaces: Surfaces,
    /// Trace positions inside: lattice points and others.
    pub origins: Vec<Vec3>,
    /// Trace positions of corners.
    pub corners: Vec<[Vec3; 3]>,
}

impl Closed {
    pub fn new(name: &str, triangles: &[Triangle], inside: &[DVec3], scale: f64, offset: f64) -> Closed {
        let place = |p: DVec3| p * scale + DVec3::new(offset, -offset, offset);
        let triangles: Vec<Triangle> = triangles.iter().map(|t| t.map(place)).collect();
        let scene = scene_of(&triangles);
        let (min, max) = scene.bounds(|_| true).unwrap();
        let frame = Frame::of_bounds(min, max);
        Closed {
            name: format!("{name}, scale {scale:e}, offset {offset:e}"),
            surfaces: Surfaces::new(&scene, |m| m.role == Role::Environment, &frame).unwrap(),
            origins: inside.iter().map(|&p| frame.to_trace(place(p))).collect(),
            corners: triangles.iter().map(|t| t.map(|p| frame.to_trace(p))).collect(),
            scene,
        }
    }

    /// Ray `index`, from each kind of origin in each kind of direction.
    pub fn ray(&self, index: u32) -> (Vec3, Vec3) {
        let stream = Stream::new(Sampler::Random, 1, u64::from(index), 0);
        let pick = |pair: u32, count: usize| (stream.point(0, pair)[0] * count as f32) as usize % count;
        let origin = self.origins[pick(0, self.origins.len())];
        let [a, b, c] = self.corners[pick(1, self.corners.len())];
        let [u, v] = stream.point(1, 2);
        let sign = |bit: u32| if index >> bit & 1 == 0 { 1.0 } else { -1.0 };
        let target = match index % 8 {
            // Corners, middles of edges, any place of an edge, insides of triangles.
            0 => a,
            1 => (a + b) / 2.0,
            2 => a + (b - a) * u,
            3 => a + (b - a) * (u * (1.0 - v)) + (c - a) * (u * v),
            // Exactly along an axis, with zeros of both signs; along diagonals; anywhere.
            4 => {
                let mut direction = [0.0f32.copysign(sign(3)), 0.0f32.copysign(sign(4)), 0.0f32.copysign(sign(5))];
                direction[pick(3, 3)] = sign(6);
                return (origin, Vec3::from_array(direction));
            }
            5 => {
                let mut direction = [sign(3), sign(4), sign(5)];
                direction[pick(3, 3)] = 0.0f32.copysign(sign(6));
                return (origin, Vec3::from_array(direction));
            }
            6 => return (origin, Vec3::new(sign(3), sign(4), sign(5)) * (1.0 / 3f32.sqrt())),
            _ => return (origin, uniform_sphere([u, v])),
        };
        let direction = target - origin;
        // Aimed exactly, or normalised as every ray of a bake is.
        (origin, if sign(7) > 0.0 { direction } else { direction.normalize() })
    }

    /// Rays that meet nothing, of `count`, asked in both ways.
    pub fn escapes(&self, count: u32) -> u64 {
        let escapes = |index: u32| {
            let (origin, direction) = self.ray(index);
            if direction == Vec3::ZERO || !direction.is_finite() {
                return 0;
            }
            let hit = self.surfaces.closest(&self.scene, origin, direction, 0.0, f32::INFINITY);
            let clear = self.surfaces.escaping(&self.scene, origin, direction);
            if let Some(hit) = hit {
                assert!(hit.t > 0.0 && hit.position.is_finite() && hit.normal.is_normalized(), "{hit:?}");
            }
            u64::from(hit.is_none()) + u64::from(clear != Vec3::ZERO)
        };
        (0..count).into_par_iter().map(escapes).sum()
    }
}

/// Lattice points, middles of cells, and other places, where `inside` says so.
pub fn places_in_lattice(size: i32, inside: impl Fn(DVec3) -> bool) -> Vec<DVec3> {
    let steps = 2 * size;
    let all = (0..steps * steps * steps).map(|i| [i % steps, i / steps % steps, i / steps / steps]);
    let half = all.map(|p| DVec3::new(p[0].into(), p[1].into(), p[2].into()) / 2.0);
    let other = (0..500u32).map(|i| {
        let stream = Stream::new(Sampler::Random, 2, u64::from(i), 0);
        let ([x, y], [z, _]) = (stream.point(0, 0), stream.point(0, 1));
        DVec3::new(x.into(), y.into(), z.into()) * f64::from(size)
    });
    half.chain(other).filter(|p| inside(*p)).collect()
}

/// A staircase up along x under a flat ceiling.
fn is_over_stairs(cell: [i32; 3]) -> bool {
    cell[1] >= cell[0] / 2 && cell[1] < 6
}

pub fn closed_meshes(scale: f64, offset: f64) -> Vec<Closed> {
    let in_box = |p: DVec3| p.min_element() > 0.0 && p.max_element() < 8.0;
    // Strictly inside: a little step any way stays in an open cell.
    let over_stairs = |p: DVec3| {
        (0..8).all(|i| {
            let step = DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)) * 0.02 - 0.01;
            let cell = (p + step).floor().as_ivec3().to_array();
            cell.iter().all(|v| (0..8).contains(v)) && is_over_stairs(cell)
        })
    };
    let in_sphere = |p: DVec3| p.distance(DVec3::splat(4.0)) < 3.9;
    vec![
        Closed::new("box", &lattice_mesh(8, |_| true), &places_in_lattice(8, in_box), scale, offset),
        Closed::new("stairs", &lattice_mesh(8, is_over_stairs), &places_in_lattice(8, over_stairs), scale, offset),
        Closed::new("sphere", &sphere_mesh(3), &places_in_lattice(8, in_sphere), scale, offset),
    ]
}
