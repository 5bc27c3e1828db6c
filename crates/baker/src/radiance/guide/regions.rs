//! Bright surface regions that probes show: small lamps that are in the pixels of probes and nowhere else.
//!
//! A panorama is bilinear between pixel centres, so it is cut into *patches* of four centres each, and those into quarters
//! along each side:
//!
//! ```text
//!      c   c+1            + pixel centre          a bright pixel lights four patches;
//!      +----+----+        |                       what is bright of them, the skirt around
//!      |    |    |  patch c, row j                the pixel too, is found by quarters
//!      +----+----+
//! ```
//!
//! From blocks of patches down to quarters: where all of a block is about as bright and the rays through it meet one
//! plane, the block's corners are projected onto that plane, and are one region; else its four parts are looked at.
//! Regions only say where to look: what they have wrong costs noise, and no light.

use glam::{DVec3, Mat3, Vec3};
use std::f64::consts::PI;

use super::emitters::Emitter;
use crate::panorama::{Panorama, brightness};
use crate::radiance::Surroundings;
use crate::trace::Hit;

/// How many times the mean radiance of the surfaces that its probe shows a place must have to be bright. What is less
/// bright is wider, too, and nodes learn to look there. At 4, the box (soft, 1024 directions, `tools/calibration`) had 1905
/// regions, 3.3 % noise instead of 2.7 %, and took a tenth more time; at 16 it has none.
const BRIGHT: f64 = 16.0;
/// What regions of a probe must add to the noise of uniform directions to be worth others: mean square of their radiance
/// over the surfaces, by the square of the mean. About what the rest of a level adds: noise² × directions was 0.3 to 0.9
/// in the box and two Cornell boxes.
const WORTH: f64 = 0.25;
/// Weight of regions per share that they have of the light in a probe, and the least: nodes may be nearer. With all of the
/// emitters' directions, sun patches of the box (stiff, `tools/calibration`) took more than they gave: noise of
/// a node at 1024 directions was 2.52 % without them, 2.57 with a weight of 1, 2.25 with 0.25 and 2.19 with 0.1. Lamps
/// with a tenth of their room's light want a weight near 1.
const WEIGHT: f32 = 8.0;
const LEAST_WEIGHT: f32 = 0.1;
/// Weight of regions that have all of the light in a probe: half of all directions go there.
const MOST_WEIGHT: f64 = 2.0;
/// Darkest of what one region takes together, over the brightest.
const ALIKE: f32 = 0.5;
/// Parts of a patch's edge.
const PARTS: u32 = 4;
/// Most patches along the edge of a block.
const MOST_PATCHES: u32 = 16;
/// Most regions; the most powerful stay.
const MOST: usize = 4096;
/// About as many rays tell which pixels of a probe show surfaces.
const MOST_TRACED: usize = 1 << 15;
/// A probe that has more is searched again, less finely. With a lamp of half a metre in probes 2048 pixels wide, more than
/// 4096 regions made nodes a quarter slower than none; 1689 left the noise at 0.9 %, 414 at 1.4 %.
const MANY: usize = 2048;
/// A probe that has no more is searched to the finest parts: one pixel is then 64 regions, as bright as its tent is there. With
/// 16, a pixel of 1e5 on a wall left noise of 1.53 % at 1024 directions, one over an edge 1.94 % (`tools/extremes`).
const FEW: usize = 256;
/// How far a surface may be off the plane of a region, by its distance.
const FLATNESS: f32 = 0.01;
/// Least cosine between the normals of one region.
const STRAIGHT: f32 = 0.99;
/// No corner of a region is farther from its probe than so many times the middle.
const STRETCH: f32 = 4.0;

/// A bright quadrilateral on the environment, in front of the probe that shows it.
#[derive(Debug, Clone, Copy)]
struct Region {
    corners: [Vec3; 4],
    /// Mean of R, G, B.
    radiance: f32,
    /// Square trace units.
    area: f32,
    /// Mean of R, G, B as pixels count, without the exposure.
    shown: f32,
    /// Solid angle × the square of that.
    square: f64,
    middle: Hit,
}

/// A square of a panorama; all numbers count parts of patches. Patch row j lies above pixel centre j, column c right of
/// pixel centre c.
#[derive(Debug, Clone, Copy)]
struct Block {
    x: u32,
    y: u32,
    size: u32,
}

/// A probe while its panorama is searched.
struct Search<'a> {
    around: Surroundings<'a>,
    own: usize,
    panorama: &'a Panorama,
    to_trace: Mat3,
    /// What is brighter counts; as pixels count, without the exposure.
    limit: f32,
    /// A block of this size or less is taken whole, however unlike its pixels are, if it is flat.
    finest: u32,
    /// Triangles of the environment that are emitters already.
    drawn: &'a [bool],
    found: Vec<Region>,
    /// What Σ solid angle × radiance² of the regions must exceed; as pixels count.
    worth: f64,
    /// Σ solid angle × radiance of all surfaces, as pixels count.
    light: f64,
}

/// What a probe shows of the environment.
#[derive(Debug, Clone, Copy)]
struct Seen {
    /// sr.
    solid_angle: f64,
    /// Radiance over that.
    mean: f64,
}

/// What is found.
#[derive(Debug, Default)]
pub(crate) struct Regions {
    /// Two triangles for each region.
    pub emitters: Vec<Emitter>,
    /// How many regions.
    pub count: usize,
    /// How much rays toward them count among those toward emitters, 0..=2.
    pub weight: f32,
}

/// The bright regions; on triangles for which `drawn` there are none. A probe has none where they are not worth rays of
/// their own.
pub(crate) fn bright_regions(around: &Surroundings, drawn: &[bool]) -> Regions {
    let searches: Vec<Search> = (0..around.probes.len()).map(|own| Search::of_probe(around, own, drawn)).collect();
    let mut found: Vec<Region> = Vec::new();
    let mut share = 0.0f64;
    for search in &searches {
        let once = |region: &&Region| !searches.iter().any(|other| other.shows_better(search, &region.middle));
        let best: Vec<Region> = search.found.iter().filter(once).copied().collect();
        if best.iter().map(|region| region.square).sum::<f64>() > search.worth {
            share = share
                .max(best.iter().map(|region| region.square / f64::from(region.shown)).sum::<f64>() / search.light);
            found.extend(best);
        }
    }
    found.sort_by(|a, b| (b.radiance * b.area).total_cmp(&(a.radiance * a.area)));
    found.truncate(MOST);
    let halves = found.iter().flat_map(|&Region { corners: [a, b, c, d], radiance, .. }| {
        [[a, b, c], [a, c, d]].map(|corners| Emitter::region(corners, radiance))
    });
    // At a pole two corners are one.
    let emitters = halves.filter(|emitter| emitter.area > 0.0).collect();
    let weight = (f64::from(WEIGHT) * share).clamp(f64::from(LEAST_WEIGHT), 1.0).max(MOST_WEIGHT * share) as f32;
    Regions { emitters, count: found.len(), weight }
}

impl<'a> Search<'a> {
    /// What one probe shows.
    fn of_probe(around: &Surroundings<'a>, own: usize, drawn: &'a [bool]) -> Search<'a> {
        let panorama = &around.probes[own].panorama;
        let to_trace = around.placed[own].to_local.transpose();
        let mut search = Search {
            around: *around,
            own,
            panorama,
            to_trace,
            limit: 0.0,
            finest: 1,
            drawn,
            found: Vec::new(),
            worth: 0.0,
            light: 0.0,
        };
        let seen = search.surfaces();
        search.limit = (BRIGHT * seen.mean) as f32;
        search.worth = WORTH * seen.solid_angle * seen.mean.powi(2);
        search.light = seen.solid_angle * seen.mean;
        // Most probes end here.
        if search.squares_of_pixels() > search.worth {
            search.all();
            // The edge of a lamp that is many pixels wide need not be as fine as that of a small one.
            let most = |finest: u32| if finest == 1 { FEW } else { MANY };
            while search.found.len() > most(search.finest) && search.finest < MOST_PATCHES * PARTS {
                search.finest *= 2;
                search.found.clear();
                search.all();
            }
        }
        search
    }

    /// The environment, by pixels; whole squares of them where there are many.
    fn surfaces(&self) -> Seen {
        let (width, height) = (self.panorama.width(), self.panorama.height());
        let step = 1 + (width * height / MOST_TRACED).isqrt();
        let (mut solid_angle, mut light) = (0.0, 0.0);
        for top in (0..height).step_by(step) {
            for left in (0..width).step_by(step) {
                let (right, bottom) = ((left + step).min(width), (top + step).min(height));
                let middle = [(left + right - 1) / 2, (top + bottom - 1) / 2];
                if self.meet(self.to_trace * self.panorama.pixel_direction(middle[0], middle[1])).is_none() {
                    continue;
                }
                for y in top..bottom {
                    let pixels = (y * width + left..y * width + right).map(|i| self.panorama.pixel_number(i));
                    let own = self.panorama.pixel_solid_angle(y);
                    solid_angle += own * pixels.len() as f64;
                    light += own * pixels.map(|pixel| f64::from(brightness(&pixel))).sum::<f64>();
                }
            }
        }
        Seen { solid_angle, mean: if light > 0.0 { light / solid_angle } else { 0.0 } }
    }

    /// Σ solid angle × radiance² of bright pixels, those that show no surface included.
    fn squares_of_pixels(&self) -> f64 {
        let width = self.panorama.width();
        let squares = (0..self.panorama.height()).map(|y| {
            let row = (y * width..(y + 1) * width).map(|i| brightness(&self.panorama.pixel_number(i)));
            let bright = row.filter(|b| *b > self.limit);
            self.panorama.pixel_solid_angle(y) * bright.map(|b| f64::from(b).powi(2)).sum::<f64>()
        });
        squares.sum()
    }

    fn all(&mut self) {
        let [width, rows] = [self.panorama.width() as u32, self.panorama.height() as u32 + 1];
        // Corners on a parallel stand for the arc between them: so far it bulges by a tenth of a pixel at most.
        let across = ((rows as f32 / 2.0).sqrt() as u32).clamp(1, MOST_PATCHES);
        let size = (1 << across.ilog2()) * PARTS;
        for y in (0..rows * PARTS).step_by(size as usize) {
            for x in (0..width * PARTS).step_by(size as usize) {
                self.visit(Block { x, y, size });
            }
        }
    }

    fn visit(&mut self, block: Block) {
        let Some([darkest, brightest]) = self.extremes(block).filter(|[_, most]| *most > self.limit) else { return };
        let alike = darkest >= ALIKE * brightest || block.size <= self.finest;
        if block.size == 1 || alike {
            let middle = self.meet(self.direction(self.edges(block), [0.5, 0.5]));
            let quad = middle.as_ref().and_then(|hit| self.on_one_plane(block, hit));
            let quad = quad.or_else(|| middle.as_ref().filter(|_| block.size == 1).map(|hit| self.at(block, hit)));
            if let (Some(corners), Some(hit)) = (quad, &middle) {
                return self.add(block, corners, hit);
            }
        }
        if block.size > 1 {
            let size = block.size / 2;
            for [x, y] in [[0, 0], [size, 0], [0, size], [size, size]] {
                self.visit(Block { x: block.x + x, y: block.y + y, size });
            }
        }
    }

    /// Adds the region if it is bright, and no emitter yet.
    fn add(&mut self, block: Block, corners: [Vec3; 4], hit: &Hit) {
        let radiance = self.radiance(block, hit);
        if radiance <= self.limit || self.drawn[hit.triangle as usize] {
            return;
        }
        let [a, b, c, d] = corners;
        let area = 0.5 * (c - a).cross(d - b).length();
        let square = self.solid_angle(block) * f64::from(radiance).powi(2);
        let gain = self.around.placed[self.own].gain;
        self.found.push(Region { corners, radiance: radiance * gain, area, shown: radiance, square, middle: *hit });
    }

    /// Darkest and brightest pixel of the patches of a block; `None` off the panorama.
    fn extremes(&self, block: Block) -> Option<[f32; 2]> {
        let (width, height) = (self.panorama.width(), self.panorama.height());
        let [left, right, top, bottom] = self.edges(block);
        if left >= right || top >= bottom {
            return None;
        }
        let first = [block.x / PARTS, block.y / PARTS].map(|v| v as usize);
        let patches = block.size.div_ceil(PARTS) as usize;
        let mut extremes = [f32::INFINITY, 0.0f32];
        for row in first[1]..=first[1] + patches {
            let row = row.saturating_sub(1).min(height - 1);
            for column in first[0]..=(first[0] + patches).min(width) {
                let value = brightness(&self.panorama.pixel_number(row * width + column % width));
                extremes = [extremes[0].min(value), extremes[1].max(value)];
            }
        }
        Some(extremes)
    }

    /// Left, right, top, bottom in pixels, of which the first has its centre at 0.
    fn edges(&self, block: Block) -> [f64; 4] {
        let of = |parts: u32| f64::from(parts) / f64::from(PARTS);
        let (width, height) = (self.panorama.width() as f64, self.panorama.height() as f64);
        let across = [block.x, block.x + block.size].map(|x| of(x).min(width));
        let down = [block.y, block.y + block.size].map(|y| (of(y) - 1.0).clamp(-0.5, height - 0.5));
        [across[0], across[1], down[0], down[1]]
    }

    fn solid_angle(&self, block: Block) -> f64 {
        let [left, right, top, bottom] = self.edges(block);
        let sine = |y: f64| (PI * (0.5 - (y + 0.5) / self.panorama.height() as f64)).sin();
        2.0 * PI * (right - left) / self.panorama.width() as f64 * (sine(top) - sine(bottom))
    }

    /// Direction (trace space) to a place in a block.
    fn direction(&self, [left, right, top, bottom]: [f64; 4], [x, y]: [f64; 2]) -> Vec3 {
        let across = (left + (right - left) * x + 0.5) / self.panorama.width() as f64;
        let down = (top + (bottom - top) * y + 0.5) / self.panorama.height() as f64;
        let (longitude, latitude) = (2.0 * PI * (0.5 - across), PI * (0.5 - down));
        let (sin, cos) = longitude.sin_cos();
        self.to_trace * DVec3::new(sin * latitude.cos(), latitude.sin(), cos * latitude.cos()).as_vec3()
    }

    /// The surface that the probe shows there.
    fn meet(&self, direction: Vec3) -> Option<Hit> {
        let Surroundings { scene, environment, placed, .. } = self.around;
        environment.shown(scene, placed[self.own].position, direction, f32::INFINITY)
    }

    /// Corners of a block on the plane of `middle`, if what the probe shows in the block lies on it.
    fn on_one_plane(&self, block: Block, middle: &Hit) -> Option<[Vec3; 4]> {
        const INSIDE: [[f64; 2]; 8] = [
            [0.02, 0.02],
            [0.98, 0.02],
            [0.98, 0.98],
            [0.02, 0.98],
            [0.5, 0.02],
            [0.98, 0.5],
            [0.5, 0.98],
            [0.02, 0.5],
        ];
        let edges = self.edges(block);
        let flat = INSIDE[..if block.size > PARTS { 8 } else { 4 }].iter().all(|&place| {
            let direction = self.direction(edges, place);
            self.meet(direction).is_some_and(|hit| {
                let expected = self.distance_to_plane(direction, middle.position, middle.normal);
                hit.normal.dot(middle.normal) > STRAIGHT && (hit.t / expected - 1.0).abs() < FLATNESS
            })
        });
        if flat { self.project(block, middle, middle.normal) } else { None }
    }

    /// Corners of a block about where its middle lies, on a plane that may be anything.
    fn at(&self, block: Block, middle: &Hit) -> [Vec3; 4] {
        let toward_probe = (self.around.placed[self.own].position - middle.position).normalize_or(middle.normal);
        let facing = || self.project(block, middle, toward_probe);
        self.project(block, middle, middle.normal).or_else(facing).unwrap_or([middle.position; 4])
    }

    /// Corners of a block on a plane through `middle`, counter-clockwise seen from the probe; `None` where they lie far
    /// away.
    fn project(&self, block: Block, middle: &Hit, normal: Vec3) -> Option<[Vec3; 4]> {
        let origin = self.around.placed[self.own].position;
        let edges = self.edges(block);
        // Seen from within, u grows to the right and v down.
        let corners = [[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]].map(|corner| {
            let direction = self.direction(edges, corner);
            (direction, self.distance_to_plane(direction, middle.position, normal))
        });
        let near = corners.iter().all(|(_, t)| *t > 0.0 && *t < STRETCH * middle.t);
        near.then(|| corners.map(|(direction, t)| origin + direction * t))
    }

    fn distance_to_plane(&self, direction: Vec3, point: Vec3, normal: Vec3) -> f32 {
        normal.dot(point - self.around.placed[self.own].position) / normal.dot(direction)
    }

    /// What the probe shows in a block on the plane of `middle`: the mean over its patches, or their parts.
    fn radiance(&self, block: Block, middle: &Hit) -> f32 {
        let probe = &self.around.placed[self.own];
        let edges = self.edges(block);
        let normal = probe.to_local * middle.normal;
        let places = (2 * block.size / PARTS).max(1);
        let at = |i: u32| (f64::from(i) + 0.5) / f64::from(places);
        let mut sum = 0.0;
        for (x, y) in (0..places).flat_map(|y| (0..places).map(move |x| (x, y))) {
            let direction = self.direction(edges, [at(x), at(y)]);
            let distance = self.distance_to_plane(direction, middle.position, middle.normal);
            let metres = self.around.frame.metres(distance);
            let radiance = self.panorama.radiance_on_plane(probe.to_local * direction, metres, normal);
            sum += radiance.map_or(0.0, |rgb| rgb.element_sum() / 3.0);
        }
        sum / (places * places) as f32
    }

    /// This probe has more pixels than `other` on a unit of the surface there, and sees it. What is bright to the other alone
    /// (a lamp that fills much of this one's sphere) is left to it.
    fn shows_better(&self, other: &Search, place: &Hit) -> bool {
        let Surroundings { scene, environment, placed, .. } = self.around;
        let merit = |own: usize| {
            let line = placed[own].position - place.position;
            placed[own].pixels * place.normal.dot(line) / line.length().powi(3)
        };
        let (own, others) = (merit(self.own), merit(other.own));
        if own < others || (own == others && self.own >= other.own) {
            return false;
        }
        let probe = &placed[self.own];
        let shown = self.panorama.radiance(probe.to_local * (place.position - probe.position));
        let shown = brightness(&shown.to_array());
        let is_left = shown <= self.limit && shown * probe.gain > other.limit * placed[other.own].gain;
        !is_left
            && environment
                .transmittance(scene, environment.leave(place), probe.position, Some(place.triangle))
                .max_element()
                > 0.5
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::radiance::guide::{Guide, Receiver};
    use crate::radiance::{PlacedProbe, Probe};
    use crate::sampling::fibonacci_sphere;
    use crate::scene::{Material, Mesh, Scene};
    use crate::trace::{Frame, Surfaces};
    use glam::Quat;

    /// A cube with faces inward, 4 on a side, and a post before one wall.
    fn scene() -> Scene {
        let corner = |i: usize, half: DVec3| {
            DVec3::from([0, 1, 2].map(|axis| if i >> axis & 1 == 0 { -half[axis] } else { half[axis] }))
        };
        let faces = [[0, 2, 6, 4], [1, 5, 7, 3], [0, 4, 5, 1], [2, 3, 7, 6], [0, 1, 3, 2], [4, 6, 7, 5]];
        let solid = |middle: DVec3, half: DVec3| {
            let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
            let positions: Vec<_> = triangles.flatten().map(|i| middle + corner(i, half)).collect();
            let count = positions.len() as u32;
            Mesh {
                normals: vec![Vec3::Y; count as usize],
                positions,
                triangles: (0..count / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
                ..Mesh::default()
            }
        };
        Scene {
            meshes: vec![
                solid(DVec3::ZERO, DVec3::splat(2.0)),
                solid(DVec3::new(1.7, 0.0, 0.0), DVec3::new(0.1, 2.0, 0.05)),
            ],
            materials: vec![Material::default()],
            ..Scene::default()
        }
    }

    /// Walls of 1; `radiance` toward within `radius` (radians) of `toward` (world).
    fn probe(position: DVec3, rotation: Quat, width: usize, lamps: &[(Vec3, f32, f32)]) -> Probe {
        let grid = Panorama::new(width, width / 2, vec![[0.0; 3]; width * width / 2], None);
        let pixel = |i: usize| {
            let direction = rotation * grid.pixel_direction(i % width, i / width);
            let lamp = lamps.iter().find(|(toward, radius, _)| direction.angle_between(*toward) < *radius);
            [lamp.map_or(1.0, |(_, _, radiance)| *radiance); 3]
        };
        let panorama = Panorama::new(width, width / 2, (0..width * width / 2).map(pixel).collect(), None);
        Probe { name: String::new(), position, rotation, exposure_stops: 1.0, panorama }
    }

    fn found(probes: &[Probe]) -> (Vec<Emitter>, usize) {
        let (scene, frame) = (scene(), Frame::default());
        let environment = Surfaces::new(&scene, |_| true, &frame).unwrap();
        let placed: Vec<PlacedProbe> = probes.iter().map(|probe| PlacedProbe::new(probe, &frame)).collect();
        let around = Surroundings { scene: &scene, frame: &frame, environment: &environment, probes, placed: &placed };
        let Regions { emitters, count, weight } = bright_regions(&around, &vec![false; environment.len()]);
        assert!((LEAST_WEIGHT..=1.0).contains(&weight), "{weight}");
        (emitters, count)
    }

    fn turn() -> Quat {
        Quat::from_euler(glam::EulerRot::YXZ, 0.7, 0.5, 0.3)
    }

    #[test]
    fn regions_cover_what_is_bright_once_and_nothing_far_from_it() {
        // A wide lamp on a wall, one behind the post's edge, and one in the probe's pole.
        let lamps = [
            (Vec3::new(0.1, 0.2, -1.0).normalize(), 0.15, 100.0),
            (Vec3::new(1.0, 0.1, 0.06).normalize(), 0.05, 200.0),
            (turn() * Vec3::Y, 0.06, 300.0),
        ];
        let probe = probe(DVec3::new(0.1, 0.3, -0.2), turn(), 128, &lamps);
        let origin = probe.position.as_vec3();
        let (emitters, count) = found(std::slice::from_ref(&probe));
        println!("{count} regions");
        assert!(count > 20 && count < 1000, "{count}");
        let guide = Guide::new(None, emitters);
        let tree = guide.emitters().expect("there are regions");
        let (mut bright, mut missed, mut wasted) = (0, 0, 0);
        for direction in fibonacci_sphere(1 << 18) {
            let light = probe.panorama.radiance(probe.rotation.inverse() * direction).x;
            let sent = tree.density(&Receiver::node(origin), direction);
            bright += u32::from(light > 60.0);
            missed += u32::from(light > 60.0 && sent == 0.0);
            wasted += u32::from(light == 1.0 && sent > 0.0);
        }
        println!("{bright} bright directions, {missed} of them missed, {wasted} sent where it is dark");
        // Edges on parallels are cut straight: missed slivers are a tenth of a pixel wide at most.
        assert!(f64::from(missed) < 0.01 * f64::from(bright), "{missed} of {bright}");
        assert!(f64::from(wasted) < 0.05 * f64::from(bright), "{wasted} of {bright}");
    }

    #[test]
    fn regions_lie_on_surfaces_and_face_their_probe() {
        let toward = Vec3::new(0.1, 0.2, -1.0).normalize();
        let probe = probe(DVec3::new(0.1, 0.3, -0.2), turn(), 128, &[(toward, 0.1, 100.0)]);
        let (emitters, _) = found(std::slice::from_ref(&probe));
        let area: f32 = emitters.iter().map(|emitter| emitter.area).sum();
        // A disc of 0.1 at a distance of 1.8 / cosθ, seen at θ; with the skirt of half a pixel more.
        let cosine = -toward.z;
        let disc = std::f32::consts::PI * (0.1 * 1.8 / cosine).powi(2) / cosine;
        assert!(area > disc && area < 1.7 * disc, "{area} {disc}");
        for emitter in &emitters {
            assert!((emitter.normal() - Vec3::Z).length() < 1e-3, "{emitter:?}");
            assert!(emitter.corners.iter().all(|corner| (corner.z + 2.0).abs() < 1e-4), "{emitter:?}");
            // Exposure counts.
            assert!(emitter.radiance > 32.0 && emitter.radiance <= 200.0, "{emitter:?}");
        }
    }

    #[test]
    fn two_probes_show_a_lamp_once() {
        let lamp = Vec3::new(0.3, 0.2, -2.0);
        let near = DVec3::new(0.1, 0.3, -0.8);
        let far = DVec3::new(-0.6, 0.1, 1.0);
        let at = |position: DVec3, radius: f32| {
            let line = lamp - position.as_vec3();
            probe(position, Quat::IDENTITY, 128, &[(line.normalize(), radius / line.length(), 200.0)])
        };
        let both = found(&[at(near, 0.15), at(far, 0.15)]).0;
        let one = found(&[at(near, 0.15)]).0;
        let area = |emitters: &[Emitter]| emitters.iter().map(|emitter| emitter.area).sum::<f32>();
        assert_eq!(area(&both), area(&one), "the far one adds nothing");
        assert!(!one.is_empty());
        // A probe that has it before its nose sees no small lamp, and leaves it to the far one.
        let close = at(DVec3::new(0.3, 0.2, -1.95), 0.15);
        assert_eq!(found(std::slice::from_ref(&close)).1, 0);
        assert_eq!(area(&found(&[close, at(far, 0.15)]).0), area(&found(&[at(far, 0.15)]).0));
        assert!(!found(&[at(far, 0.15)]).0.is_empty());
    }

    #[test]
    fn wide_dim_and_dark_lights_are_no_regions() {
        let toward = Vec3::NEG_Z;
        for (radius, radiance) in [(0.1, 10.0), (1.5, 1000.0), (0.1, 0.0), (0.02, 20.0)] {
            let (emitters, count) = found(&[probe(DVec3::ZERO, turn(), 64, &[(toward, radius, radiance)])]);
            assert!(emitters.is_empty() && count == 0, "{radius} {radiance}: {count}");
        }
        let mut black = probe(DVec3::ZERO, turn(), 64, &[]);
        black.panorama.tint([0.0; 3]);
        assert_eq!(found(&[black]).1, 0);
        assert_eq!(found(&[]).1, 0);
    }
}
