//! A level as a page draws it: triangles with one colour each, and not too many of them.
//!
//! Light is not in it. A page reads that from the volume.

use glam::{DVec3, Vec2, Vec3};
use std::collections::HashMap;

use crate::panorama::{Image, Panorama};
use crate::scene::{Mesh, Scene};
use crate::trace::{Frame, Surfaces};

/// Triangles to draw. Positions are relative to `origin`, so that 32 bits are enough.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DrawnLevel {
    /// World metres.
    pub origin: [f64; 3],
    /// Metres from `origin`.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals as shading sees them, one per position.
    pub normals: Vec<[f32; 3]>,
    /// Counter-clockwise seen from the front.
    pub triangles: Vec<[u32; 3]>,
    /// Diffuse albedo of each triangle, linear.
    pub albedo: Vec<[f32; 3]>,
    /// Emitted radiance of each triangle; empty where nothing glows.
    pub emission: Vec<[f32; 3]>,
    /// Triangles that show themselves in the level, before any were merged.
    pub triangles_of_level: usize,
}

/// Places on a triangle at which its colour is read: the middle, and toward each corner.
const PLACES: [Vec2; 4] = [Vec2::new(0.333, 0.333), Vec2::new(0.6, 0.2), Vec2::new(0.2, 0.6), Vec2::new(0.2, 0.2)];
/// A triangle that lets more than this share of light pass is not drawn: panes would hide the room.
const MOST_CLEAR: f32 = 0.5;
/// Steps in which the edge of clusters is searched for.
const STEPS: u32 = 12;

impl DrawnLevel {
    /// At most `most` triangles: where a level has more, vertices in one cube of a lattice become one.
    pub fn of(scene: &Scene, most: usize) -> DrawnLevel {
        let whole = whole(scene);
        if whole.triangles.len() <= most {
            return whole;
        }
        // The finest lattice that leaves few enough. Half the level's size always does.
        let (mut fine, mut coarse) = (0.0, half_size(&whole.positions));
        let mut best = whole.merged(coarse);
        for _ in 0..STEPS {
            let edge = if fine == 0.0 { coarse / 4.0 } else { (fine + coarse) / 2.0 };
            let merged = whole.merged(edge);
            if merged.triangles.len() <= most {
                (coarse, best) = (edge, merged);
            } else {
                fine = edge;
            }
        }
        best
    }

    /// Vertices that lie in one cube of this edge and face one way become one, in the middle of them; triangles that lose a
    /// corner go.
    fn merged(&self, edge: f32) -> DrawnLevel {
        let mut clusters: HashMap<[i32; 4], u32> = HashMap::new();
        let mut sums: Vec<(DVec3, Vec3, f64)> = Vec::new();
        let cluster_of: Vec<u32> = (0..self.positions.len())
            .map(|vertex| {
                let (position, normal) = (Vec3::from(self.positions[vertex]), Vec3::from(self.normals[vertex]));
                let [x, y, z] = (position / edge).floor().to_array().map(|cell| cell as i32);
                let cluster = *clusters.entry([x, y, z, side_of(normal)]).or_insert_with(|| {
                    sums.push((DVec3::ZERO, Vec3::ZERO, 0.0));
                    sums.len() as u32 - 1
                });
                let (place, facing, count) = &mut sums[cluster as usize];
                (*place, *facing, *count) = (*place + position.as_dvec3(), *facing + normal, *count + 1.0);
                cluster
            })
            .collect();
        let corners = self.triangles.iter().map(|triangle| triangle.map(|vertex| cluster_of[vertex as usize]));
        let kept: Vec<usize> = corners
            .clone()
            .enumerate()
            .filter(|(_, [a, b, c])| a != b && b != c && c != a)
            .map(|(number, _)| number)
            .collect();
        let corners: Vec<[u32; 3]> = corners.collect();
        let of_kept = |values: &[[f32; 3]]| {
            if values.is_empty() { Vec::new() } else { kept.iter().map(|number| values[*number]).collect() }
        };
        DrawnLevel {
            positions: sums.iter().map(|(place, _, count)| (*place / *count).as_vec3().to_array()).collect(),
            normals: sums.iter().map(|(_, facing, _)| facing.normalize_or(Vec3::Y).to_array()).collect(),
            triangles: kept.iter().map(|number| corners[*number]).collect(),
            albedo: of_kept(&self.albedo),
            emission: of_kept(&self.emission),
            ..*self
        }
    }
}

/// Which of six ways a normal points: corners of thin walls are not merged across the wall.
fn side_of(normal: Vec3) -> i32 {
    let axis = (0..3).max_by(|a, b| normal[*a].abs().total_cmp(&normal[*b].abs())).unwrap_or(0);
    2 * axis as i32 + i32::from(normal[axis] < 0.0)
}

fn half_size(positions: &[[f32; 3]]) -> f32 {
    let (min, max) = positions.iter().fold((Vec3::MAX, Vec3::MIN), |(min, max), position| {
        let position = Vec3::from(*position);
        (min.min(position), max.max(position))
    });
    ((max - min).max_element() / 2.0).max(f32::MIN_POSITIVE)
}

/// All triangles that show themselves.
fn whole(scene: &Scene) -> DrawnLevel {
    let frame = Frame::of_scene(scene);
    let Some(surfaces) = Surfaces::new(scene, |_| true, &frame) else { return DrawnLevel::default() };
    let mut level = DrawnLevel { origin: frame.origin.to_array(), ..DrawnLevel::default() };
    let glows = scene.materials.iter().any(|material| material.emission != Vec3::ZERO);
    let mut first = 0;
    for mesh in &scene.meshes {
        let mut numbers = HashMap::new();
        for (triangle, surface) in mesh.triangles.iter().zip(first..) {
            if clear_share(scene, &surfaces, surface) > MOST_CLEAR {
                continue;
            }
            level.triangles.push(corners_of(
                mesh,
                *triangle,
                &mut numbers,
                &mut level.positions,
                &mut level.normals,
                &frame,
            ));
            let [albedo, emission] = colours_of(scene, &surfaces, surface);
            level.albedo.push(albedo);
            if glows {
                level.emission.push(emission);
            }
        }
        first += mesh.triangles.len() as u32;
    }
    level.triangles_of_level = level.triangles.len();
    level
}

/// The vertices of a triangle. Those of a smooth mesh are shared, those of a flat one are the triangle's own.
fn corners_of(
    mesh: &Mesh,
    triangle: [u32; 3],
    numbers: &mut HashMap<u32, u32>,
    positions: &mut Vec<[f32; 3]>,
    normals: &mut Vec<[f32; 3]>,
    frame: &Frame,
) -> [u32; 3] {
    let place = |vertex: u32| mesh.positions[vertex as usize];
    let [a, b, c] = triangle.map(place);
    let flat = (b - a).cross(c - a).normalize_or(DVec3::Y).as_vec3();
    triangle.map(|vertex| {
        let mut add = || {
            let own = mesh.normals.get(vertex as usize).filter(|_| mesh.smooth);
            positions.push((place(vertex) - frame.origin).as_vec3().to_array());
            normals.push(own.copied().unwrap_or(flat).to_array());
            positions.len() as u32 - 1
        };
        if mesh.smooth { *numbers.entry(vertex).or_insert_with(add) } else { add() }
    })
}

fn clear_share(scene: &Scene, surfaces: &Surfaces, triangle: u32) -> f32 {
    if !surfaces.material(scene, triangle).is_clear() {
        return 0.0;
    }
    let share = |place: &Vec2| {
        let along = -surfaces.point(triangle, *place, false).normal;
        1.0 - surfaces.opacity_at(scene, triangle, *place, along)
    };
    PLACES.iter().map(share).sum::<f32>() / PLACES.len() as f32
}

/// Albedo and emission, means over some places.
fn colours_of(scene: &Scene, surfaces: &Surfaces, triangle: u32) -> [[f32; 3]; 2] {
    let hits = PLACES.map(|place| surfaces.point(triangle, place, false));
    let mean =
        |of: &dyn Fn(&crate::trace::Hit) -> Vec3| (hits.iter().map(of).sum::<Vec3>() / PLACES.len() as f32).to_array();
    [mean(&|hit| surfaces.albedo(scene, hit)), mean(&|hit| surfaces.emission(scene, hit))]
}

/// A picture of a panorama, at most this wide: means over squares of pixels.
pub fn thumbnail(panorama: &Panorama, width: usize) -> Image {
    let step = panorama.width().div_ceil(width.max(1));
    let (columns, rows) = (panorama.width() / step, (panorama.height() / step).max(1));
    let square = |index: usize| {
        let (left, top) = (index % columns * step, index / columns * step);
        let places = (0..step * step).map(|k| (left + k % step, (top + k / step).min(panorama.height() - 1)));
        (places.map(|(x, y)| panorama.pixel(x, y)).sum::<Vec3>() / (step * step) as f32).to_array()
    };
    Image::new(columns, rows, (0..columns * rows).map(square).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Material;

    /// A square of `n` by `n` squares on the floor, two metres wide, a thousand kilometres away.
    fn floor(n: u32) -> Scene {
        let far = DVec3::new(1e6, 0.0, 0.0);
        let place = |i: u32| DVec3::new(f64::from(i % (n + 1)), 0.0, f64::from(i / (n + 1))) * (2.0 / f64::from(n));
        let square = |i: u32| {
            let a = i % n + i / n * (n + 1);
            [[a, a + n + 1, a + 1], [a + 1, a + n + 1, a + n + 2]]
        };
        let positions: Vec<DVec3> = (0..(n + 1) * (n + 1)).map(|i| place(i) + far).collect();
        let mesh = Mesh {
            normals: vec![Vec3::Y; positions.len()],
            smooth: true,
            positions,
            triangles: (0..n * n).flat_map(square).collect(),
            ..Mesh::default()
        };
        let material =
            Material { metallic: 0.0, base_color: glam::Vec4::new(0.5, 0.25, 0.125, 1.0), ..Material::default() };
        Scene { meshes: vec![mesh], materials: vec![material], ..Scene::default() }
    }

    #[test]
    fn a_level_is_drawn_where_it_is_with_its_colour() {
        let level = DrawnLevel::of(&floor(1), 10);
        assert_eq!((level.triangles.len(), level.triangles_of_level), (2, 2));
        let world: Vec<DVec3> =
            level.positions.iter().map(|p| Vec3::from(*p).as_dvec3() + DVec3::from(level.origin)).collect();
        for corner in [DVec3::new(1e6, 0.0, 0.0), DVec3::new(1e6 + 2.0, 0.0, 2.0)] {
            assert!(world.iter().any(|place| place.distance(corner) < 1e-6), "{corner} of {world:?}");
        }
        assert_eq!(level.albedo, [[0.5, 0.25, 0.125]; 2]);
        assert_eq!(level.normals, vec![[0.0, 1.0, 0.0]; level.positions.len()]);
        assert!(level.emission.is_empty());
    }

    #[test]
    fn too_many_triangles_become_few_that_cover_the_same_floor() {
        let level = DrawnLevel::of(&floor(40), 500);
        let count = level.triangles.len();
        assert!((100..=500).contains(&count), "{count} triangles");
        assert_eq!(level.triangles_of_level, 3200);
        let area = |[a, b, c]: &[u32; 3]| {
            let [a, b, c] = [a, b, c].map(|i| Vec3::from(level.positions[*i as usize]));
            (b - a).cross(c - a).y / 2.0
        };
        let total: f32 = level.triangles.iter().map(area).sum();
        // Clusters at the border move it inward by half a cluster.
        assert!((3.2..=4.0).contains(&total), "{total} square metres of 4");
        assert!(level.triangles.iter().all(|t| area(t) >= -1e-6), "no triangle turned round");
    }

    #[test]
    fn a_level_without_triangles_is_drawn_empty() {
        assert_eq!(DrawnLevel::of(&Scene::default(), 10), DrawnLevel::default());
    }
}
