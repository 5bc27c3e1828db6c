//! Pixels of probes in which something glows.
//!
//! A pixel mixes what it covers. In one that a small lamp is part of, the wall beside it is as bright as their mean, and the lamp as
//! dim: a game map lit by lamps smaller than a pixel was 30 % off by such pixels where path tracing was 1.6 %. Where the level's
//! materials are trusted, what glows and what shares a pixel with it is better traced. So these pixels are marked.

use glam::Vec3;
use std::f32::consts::PI;

use super::probe::{PlacedProbe, Probe};
use crate::panorama::Panorama;
use crate::scene::Scene;
use crate::trace::{Frame, Surfaces};

/// A pixel shows a triangle if its distance is within the triangle's, but for this share.
const DISTANCE_SLACK: f32 = 0.02;

/// Marks of one probe's pixels, and of all pixels beside them: between two of them radiance is bilinear.
#[derive(Debug)]
struct Marks(Vec<bool>);

/// Which pixels of each probe show what glows, and which triangles do.
#[derive(Debug)]
pub(super) struct Lamps {
    marks: Vec<Marks>,
    glows: Vec<bool>,
}

impl Lamps {
    /// `None` where no environment triangle glows.
    pub fn find(
        scene: &Scene,
        environment: &Surfaces,
        frame: &Frame,
        probes: &[Probe],
        placed: &[PlacedProbe],
    ) -> Option<Lamps> {
        let is_glowing = |triangle: u32| environment.material(scene, triangle).emission != Vec3::ZERO;
        let glows: Vec<bool> = (0..environment.len() as u32).map(is_glowing).collect();
        if !glows.contains(&true) {
            return None;
        }
        let glowing: Vec<u32> = (0..).zip(&glows).filter(|(_, glows)| **glows).map(|(triangle, _)| triangle).collect();
        let marks = probes.iter().zip(placed).map(|(probe, placed)| {
            let mut core = vec![false; probe.panorama.width() * probe.panorama.height()];
            for &triangle in &glowing {
                mark(&mut core, scene, environment, frame, &probe.panorama, placed, triangle);
            }
            Marks(widened(&core, probe.panorama.width()))
        });
        Some(Lamps { marks: marks.collect(), glows })
    }

    /// The triangle of the environment glows.
    pub fn glows(&self, triangle: u32) -> bool {
        self.glows[triangle as usize]
    }

    /// Something that glows is in the pixels around a direction, in the probe's own axes.
    pub fn is_in_pixel(&self, probe: usize, panorama: &Panorama, direction: Vec3) -> bool {
        let (x, y) = panorama.pixel_at(direction);
        self.marks[probe].0[y * panorama.width() + x]
    }
}

/// Marks the pixels that a triangle is in: those within the cone around it whose distance is the triangle's.
fn mark(
    core: &mut [bool],
    scene: &Scene,
    environment: &Surfaces,
    frame: &Frame,
    panorama: &Panorama,
    probe: &PlacedProbe,
    triangle: u32,
) {
    let corners = environment.corners(triangle).map(|corner| corner - probe.position);
    let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
    let axis = (probe.to_local * middle).normalize_or(Vec3::Y);
    let radius = corners.iter().map(|corner| corner.angle_between(middle)).fold(0.0, f32::max);
    let (width, height) = (panorama.width(), panorama.height());
    let pixel = PI / height as f32;
    // A lamp smaller than a pixel may be in it, and not in what its distance is of: then one ray tells whether it is seen.
    let is_small = radius < pixel;
    if is_small {
        let point = environment.point(triangle, glam::Vec2::splat(1.0 / 3.0), false);
        let front = environment.leave(&point);
        let back = environment.leave(&environment.point(triangle, glam::Vec2::splat(1.0 / 3.0), true));
        let sees = |from| environment.transmittance(scene, from, probe.position, Some(triangle)).max_element() > 0.0;
        if !sees(front) && !sees(back) {
            return;
        }
    }
    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
    let nearest = frame.metres(normal.dot(corners[0]).abs()) * (1.0 - DISTANCE_SLACK);
    let farthest =
        corners.iter().map(|corner| frame.metres(corner.length())).fold(0.0, f32::max) * (1.0 + DISTANCE_SLACK);
    // A pixel's corner is 0.71 pixels from its middle.
    let reach = (radius + 0.71 * pixel).min(PI);
    let latitude = axis.y.clamp(-1.0, 1.0).asin();
    let row = |latitude: f32| ((0.5 - latitude / PI) * height as f32).clamp(0.0, (height - 1) as f32) as usize;
    for y in row(latitude + reach)..=row(latitude - reach) {
        for x in columns(width, axis, latitude, reach) {
            let index = y * width + x;
            let is_within = panorama.pixel_direction(x, y).dot(axis) >= reach.cos();
            let shows =
                || panorama.pixel_distance(x, y).is_none_or(|distance| (nearest..=farthest).contains(&distance));
            if is_within && !core[index] && (is_small || shows()) {
                core[index] = true;
            }
        }
    }
}

/// Columns that a cone of this reach (radians) around `axis` can be in; all where it is near a pole.
fn columns(width: usize, axis: Vec3, latitude: f32, reach: f32) -> impl Iterator<Item = usize> {
    let half = match latitude.abs() + reach < 1.5 {
        true => (reach.sin() / latitude.cos()).clamp(-1.0, 1.0).asin(),
        false => PI,
    };
    let half = if reach < 1.5 { half } else { PI };
    let longitude = axis.x.atan2(axis.z);
    let middle = (0.5 - longitude / (2.0 * PI)) * width as f32;
    let span = ((half / PI * 0.5 * width as f32).ceil() as usize + 1).min(width / 2);
    let first = middle as usize + width - span;
    (first..=first + 2 * span).take(width).map(move |column| column % width)
}

/// Marks widened by a pixel on all sides; columns wrap.
fn widened(core: &[bool], width: usize) -> Vec<bool> {
    let height = core.len() / width;
    let is_near = |index: usize| {
        let (x, y) = (index % width, index / width);
        let rows = y.saturating_sub(1)..=(y + 1).min(height - 1);
        let columns = [x, (x + 1) % width, (x + width - 1) % width];
        rows.into_iter().any(|y| columns.iter().any(|x| core[y * width + x]))
    };
    (0..core.len()).map(is_near).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Material, Mesh, Role};
    use glam::{DVec3, Quat};

    /// A square lamp of this half side at z = 2, seen from the origin, in a black room.
    fn marked(half: f64, with_distance: bool, wall_before: bool) -> (Lamps, Vec<Probe>) {
        let square = |half: f64, z: f64, material: u32| Mesh {
            material,
            role: Role::Environment,
            positions: [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)]
                .map(|(x, y)| DVec3::new(half * x, half * y, z))
                .to_vec(),
            normals: vec![Vec3::NEG_Z; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        let mut meshes = vec![square(half, 2.0, 1)];
        if wall_before {
            meshes.push(square(1.5, 1.0, 0));
        }
        let glowing = Material { emission: Vec3::ONE, ..Material::default() };
        let scene = Scene { meshes, materials: vec![Material::default(), glowing], ..Scene::default() };
        let (width, height) = (64, 32);
        let frame = Frame::of_scene(&scene);
        let environment = Surfaces::new(&scene, |_| true, &frame).expect("triangles");
        let empty = Panorama::new(width, height, vec![[0.0; 3]; width * height], None);
        let distance = (0..width * height).map(|i| {
            let direction = empty.pixel_direction(i % width, i / width);
            let hit = environment.closest(&scene, frame.to_trace(DVec3::ZERO), direction, 0.0, f32::INFINITY);
            hit.map_or(f32::INFINITY, |hit| frame.metres(hit.t))
        });
        let distance = with_distance.then(|| distance.collect());
        let probe = Probe {
            name: String::new(),
            position: DVec3::ZERO,
            rotation: Quat::IDENTITY,
            exposure_stops: 0.0,
            panorama: Panorama::new(width, height, vec![[0.0; 3]; width * height], distance),
        };
        let probes = vec![probe];
        let placed = [PlacedProbe::new(&probes[0], &frame)];
        (Lamps::find(&scene, &environment, &frame, &probes, &placed).expect("it glows"), probes)
    }

    #[test]
    fn pixels_of_lamps_and_those_beside_them_are_marked_and_no_others() {
        for (half, with_distance) in [(0.5, true), (0.5, false), (0.01, true), (0.01, false)] {
            let (lamps, probes) = marked(half, with_distance, false);
            let panorama = &probes[0].panorama;
            let pixel = PI / 32.0;
            for y in 0..32 {
                for x in 0..64 {
                    let direction = panorama.pixel_direction(x, y);
                    let found = lamps.is_in_pixel(0, panorama, direction);
                    // The lamp as a disc: within its inner circle all pixels show it, outside of its outer one none does.
                    let angle = direction.angle_between(Vec3::Z);
                    let (inner, outer) = ((half / 2.0).atan() as f32, (half * 2f64.sqrt() / 2.0).atan() as f32);
                    assert!(angle > inner || found, "half {half}: {angle} is in the lamp");
                    assert!(angle < outer + 3.5 * pixel || !found, "half {half}: {angle} is far from it");
                }
            }
            assert!(lamps.glows(0) && lamps.glows(1));
        }
    }

    #[test]
    fn hidden_lamps_mark_nothing() {
        for half in [0.5, 0.01] {
            let (lamps, probes) = marked(half, true, true);
            let panorama = &probes[0].panorama;
            let all = (0..64 * 32).map(|i| panorama.pixel_direction(i % 64, i / 64));
            assert!(all.into_iter().all(|direction| !lamps.is_in_pixel(0, panorama, direction)), "half {half}");
        }
    }
}
