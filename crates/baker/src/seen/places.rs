//! Places at which an engine may ask a volume for light.

use glam::DVec3;

use crate::bake::SurfacePlace;
use crate::sampling::{Sampler, Stream, uniform_sphere};
use crate::scene::Scene;

/// Places anywhere in a box, with normals of all directions: where moving objects are.
pub fn in_the_air([min, max]: [DVec3; 2], count: u32, seed: u64) -> Vec<SurfacePlace> {
    let stream = Stream::new(Sampler::Sobol, seed, 0, 0);
    let place = |number: u32| {
        let ([x, y], [z, _]) = (stream.point(number, 0), stream.point(number, 1));
        let position = min + (max - min) * DVec3::new(x.into(), y.into(), z.into());
        SurfacePlace { position, normal: uniform_sphere(stream.point(number, 2)) }
    };
    (0..count).map(place).collect()
}

/// Places on the front sides of what surfaces a box holds, evenly by area, lifted off them by so many metres. Of a two-sided
/// surface either side may be the front. At most `count`: those that lie outside of the box, lifted, are left out.
pub fn on_surfaces(scene: &Scene, bounds: [DVec3; 2], lift: f64, count: u32, seed: u64) -> Vec<SurfacePlace> {
    let stream = Stream::new(Sampler::Sobol, seed, 1, 0);
    let mut triangles = Vec::new();
    let mut total = 0.0;
    for (number, mesh) in scene.meshes.iter().enumerate() {
        for ids in &mesh.triangles {
            let area = area_of(&clipped(ids.map(|id| mesh.positions[id as usize]), bounds));
            if area > 0.0 {
                total += area;
                triangles.push((total, number, *ids));
            }
        }
    }
    let place = |number: u32| {
        let ([along, side], [first, second]) = (stream.point(number, 0), stream.point(number, 1));
        let wanted = f64::from(along) * total;
        let found = triangles.partition_point(|(until, ..)| *until <= wanted).min(triangles.len() - 1);
        let (_, mesh, ids) = triangles[found];
        let mesh = &scene.meshes[mesh];
        let corners = ids.map(|id| mesh.positions[id as usize]);
        let [a, b, c] = corners;
        let front = (b - a).cross(c - a).normalize();
        let is_turned = scene.materials[mesh.material as usize].double_sided && side < 0.5;
        let normal = if is_turned { -front } else { front };
        let position = place_in(&clipped(corners, bounds), first.into(), second.into());
        SurfacePlace { position: position + normal * lift, normal: normal.as_vec3() }
    };
    let [min, max] = bounds;
    let inside = |place: &SurfacePlace| place.position.cmpge(min).all() && place.position.cmple(max).all();
    if triangles.is_empty() { Vec::new() } else { (0..count).map(place).filter(inside).collect() }
}

/// The part of a triangle that lies in a box, a convex polygon. Based on: Sutherland and Hodgman, "Reentrant Polygon Clipping",
/// 1974.
fn clipped(corners: [DVec3; 3], [min, max]: [DVec3; 2]) -> Vec<DVec3> {
    let mut polygon = corners.to_vec();
    for axis in 0..3 {
        for (border, way) in [(min[axis], 1.0), (max[axis], -1.0)] {
            let inside = |corner: DVec3| (corner[axis] - border) * way;
            let mut kept = Vec::with_capacity(polygon.len() + 1);
            for (number, &to) in polygon.iter().enumerate() {
                let from = polygon[(number + polygon.len() - 1) % polygon.len()];
                let (before, after) = (inside(from), inside(to));
                if (before < 0.0) != (after < 0.0) {
                    kept.push(from.lerp(to, before / (before - after)));
                }
                if after >= 0.0 {
                    kept.push(to);
                }
            }
            polygon = kept;
        }
    }
    polygon
}

/// The triangles of a convex polygon, each with its area.
fn fan(polygon: &[DVec3]) -> impl Iterator<Item = ([DVec3; 3], f64)> {
    let triangles = (2..polygon.len()).map(|last| [polygon[0], polygon[last - 1], polygon[last]]);
    triangles.map(|[a, b, c]| ([a, b, c], 0.5 * (b - a).cross(c - a).length()))
}

fn area_of(polygon: &[DVec3]) -> f64 {
    fan(polygon).map(|(_, area)| area).sum()
}

/// A place in a polygon with some area, even over it for two even numbers, 0 to 1.
fn place_in(polygon: &[DVec3], first: f64, second: f64) -> DVec3 {
    let mut left = first * area_of(polygon);
    let mut place = polygon[0];
    for ([a, b, c], area) in fan(polygon).filter(|(_, area)| *area > 0.0) {
        // Osada et al., "Shape Distributions", 2002, eq. 1.
        let root = (left / area).clamp(0.0, 1.0).sqrt();
        place = a * (1.0 - root) + b * (root * (1.0 - second)) + c * (root * second);
        if left <= area {
            break;
        }
        left -= area;
    }
    place
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Material, Mesh};
    use glam::Vec3;

    const UNIT: [DVec3; 2] = [DVec3::ZERO, DVec3::ONE];

    fn scene_of(positions: Vec<DVec3>, double_sided: bool) -> Scene {
        let triangles = (0..positions.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let normals = vec![Vec3::Y; positions.len()];
        let mesh = Mesh { positions, normals, triangles, ..Mesh::default() };
        let material = Material { double_sided, ..Material::default() };
        Scene { meshes: vec![mesh], materials: vec![material], ..Scene::default() }
    }

    #[test]
    fn a_triangle_is_cut_to_the_area_that_lies_in_the_box() {
        let at = |x: f64, z: f64| DVec3::new(x, 0.5, z);
        let around = |size: f64| [at(-size, -size), at(-size, 3.0 * size), at(3.0 * size, -size)];
        // Half of the unit square lies under x + z = 1; the whole of it well within a large triangle.
        assert!((area_of(&clipped([at(0.0, 0.0), at(0.0, 1.0), at(1.0, 0.0)], UNIT)) - 0.5).abs() < 1e-12);
        assert!((area_of(&clipped(around(1000.0), UNIT)) - 1.0).abs() < 1e-9);
        assert_eq!(area_of(&clipped(around(1.0).map(|corner| corner + DVec3::Y), UNIT)), 0.0);
    }

    #[test]
    fn places_spread_evenly_over_what_lies_in_the_box_on_its_front() {
        // A plane of a kilometre, facing up, and a small one below it, facing down.
        let plane = [(-1e3, -1e3), (-1e3, 1e3), (1e3, -1e3), (1e3, -1e3), (-1e3, 1e3), (1e3, 1e3)];
        let small = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)];
        let mut positions: Vec<DVec3> = plane.iter().map(|(x, z)| DVec3::new(*x, 0.5, *z)).collect();
        positions.extend(small.iter().map(|(x, z)| DVec3::new(*x, 0.25, *z)));
        let places = on_surfaces(&scene_of(positions, false), UNIT, 1e-3, 4096, 7);
        let (above, below): (Vec<SurfacePlace>, Vec<SurfacePlace>) =
            places.iter().partition(|place| place.position.y > 0.4);
        // Areas are 1 and 0.5.
        assert!((above.len() as f64 / 4096.0 - 2.0 / 3.0).abs() < 0.01, "{}", above.len());
        for place in &above {
            assert_eq!(place.normal, Vec3::Y);
            assert!((place.position.y - 0.501).abs() < 1e-9);
        }
        for place in &below {
            assert_eq!(place.normal, Vec3::NEG_Y);
            assert!((place.position.y - 0.249).abs() < 1e-9 && place.position.x + place.position.z < 1.0 + 1e-9);
        }
        let quarter = above.iter().filter(|place| place.position.x < 0.5 && place.position.z < 0.5).count();
        assert!((quarter as f64 / above.len() as f64 - 0.25).abs() < 0.02, "{quarter} of {}", above.len());
    }

    #[test]
    fn two_sided_surfaces_are_asked_for_on_both_sides() {
        let positions = vec![DVec3::Y * 0.5, DVec3::new(0.0, 0.5, 1.0), DVec3::new(1.0, 0.5, 0.0)];
        let places = on_surfaces(&scene_of(positions, true), UNIT, 1e-3, 1024, 7);
        let up = places.iter().filter(|place| place.normal == Vec3::Y).count();
        assert!((400..=624).contains(&up), "{up} of 1024");
        assert!(places.iter().all(|place| (place.position.y - 0.5) * f64::from(place.normal.y) > 0.0));
    }

    #[test]
    fn the_outside_of_a_box_is_not_asked_for() {
        // A floor with two sides, in the face of the box.
        let floor = vec![DVec3::ZERO, DVec3::Z, DVec3::X];
        let places = on_surfaces(&scene_of(floor, true), UNIT, 1e-3, 1024, 7);
        assert!((400..=624).contains(&places.len()), "{} of 1024", places.len());
        assert!(places.iter().all(|place| place.normal == Vec3::Y));
    }

    #[test]
    fn a_box_without_surfaces_has_no_place_on_one() {
        let positions = vec![DVec3::Y * 5.0, DVec3::new(0.0, 5.0, 1.0), DVec3::new(1.0, 5.0, 0.0)];
        assert!(on_surfaces(&scene_of(positions, false), UNIT, 1e-3, 8, 7).is_empty());
        assert!(on_surfaces(&Scene::default(), UNIT, 1e-3, 8, 7).is_empty());
        assert_eq!(in_the_air(UNIT, 8, 7).len(), 8);
    }
}
