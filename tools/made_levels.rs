//! Levels made here, in metres, each to be baked under a sky: a terrain with houses, a house without a floor between
//! its storeys, and a dark aisle beside a bright court.

use gdibl_baker::scene::{Material, Mesh, Scene};
use glam::{DVec3, Vec3};

/// Edge of [`terrain`].
const TERRAIN: f64 = 1000.0;
/// Quads along it.
const QUADS: usize = 128;
/// Thickness of walls, floors and roofs.
const WALL: f64 = 0.3;

/// Gentle hills, 1 km by 1 km and 42 m high, with five houses of one room, door and windows.
pub fn terrain() -> Scene {
    let mut level = Level::default();
    let ground = level.material([0.25, 0.3, 0.15]);
    let plaster = level.material([0.7, 0.65, 0.6]);
    level.field(TERRAIN, QUADS, hill, ground);
    let size = [8.0, 3.3, 6.0];
    for [x, z] in HOUSES {
        let corners = [[x, z], [x + size[0], z], [x, z + size[2]], [x + size[0], z + size[2]]];
        let heights = corners.map(|[x, z]| hill(x, z));
        let floor = heights.into_iter().fold(f64::NEG_INFINITY, f64::max) + 0.2;
        let foot = heights.into_iter().fold(f64::INFINITY, f64::min) - 1.0;
        level.solid([x, foot, z], [x + size[0], floor, z + size[2]], plaster);
        let house = Storey { corner: [x, floor, z], size, material: plaster };
        level.walls(&house, [&[DOOR, [5.0, 7.0, 0.9, 2.1]], &[[2.0, 4.0, 0.9, 2.1]], &[[2.0, 4.0, 0.9, 2.1]], &[]]);
        level.ceiling(&house);
    }
    level.scene
}

/// Lower corners of the houses of [`terrain`], x and z.
const HOUSES: [[f64; 2]; 5] = [[0.0, 0.0], [-300.0, 200.0], [350.0, -310.0], [120.0, 250.0], [-220.0, -280.0]];
/// From, to, sill and head of an opening in a wall.
type Opening = [f64; 4];
const DOOR: Opening = [3.0, 4.0, 0.0, 2.1];

fn hill(x: f64, z: f64) -> f64 {
    12.0 * (x / 90.0).sin() + 9.0 * (z / 70.0).cos()
}

/// A house of 10 x 6.3 x 8 m on a plane of 200 m: a hall over both storeys, because the upper of its rooms has no
/// floor, and beside it two rooms, one over the other; the upper has a door into the void.
pub fn two_storey() -> Scene {
    let mut level = Level::default();
    let grass = level.material([0.2, 0.25, 0.1]);
    let plaster = level.material([0.75, 0.72, 0.68]);
    let wood = level.material([0.4, 0.25, 0.12]);
    level.field(200.0, 1, |_, _| 0.0, grass);
    level.solid([0.0, -0.5, 0.0], [10.0, 0.05, 8.0], wood);
    let storey =
        |floor: f64, height: f64| Storey { corner: [0.0, floor, 0.0], size: [10.0, height, 8.0], material: plaster };
    // The walls of the lower end where those of the upper begin.
    let (lower, upper) = (storey(0.05, 3.15 + WALL), storey(3.2, 3.15));
    let window = |from: f64| [from, from + 1.5, 0.9, 2.2];
    level.walls(&lower, [&[DOOR, window(6.5)], &[window(2.0)], &[window(3.0)], &[window(5.0)]]);
    level.walls(&upper, [&[window(1.5), window(6.5)], &[window(1.5), window(5.0)], &[window(3.0)], &[]]);
    level.ceiling(&upper);
    // The hall is at x < 6; the other rooms have a wall to it, and a floor between them.
    let partition = |floor: f64, height: f64, openings: &[Opening]| {
        wall_pieces(8.0 - 2.0 * WALL, height, openings)
            .into_iter()
            .map(move |[from, to, low, high]| {
                ([6.0, floor + low, WALL + from], [6.0 + 0.5 * WALL, floor + high, WALL + to])
            })
            .collect::<Vec<_>>()
    };
    let pieces = [partition(0.05, 3.15, &[DOOR]), partition(3.2, 2.85, &[DOOR])].concat();
    pieces.into_iter().for_each(|(min, max)| level.solid(min, max, plaster));
    level.solid([6.0 + 0.5 * WALL, 2.9, WALL], [10.0 - WALL, 3.2, 8.0 - WALL], wood);
    level.scene
}

/// A court of 20 x 20 m under the sky, and beside it an aisle of dark stone, 20 x 5 x 4 m, that only ten slits in the
/// wall between them light: E is a thousandth there, about.
pub fn aisle() -> Scene {
    let mut level = Level::default();
    let bright = level.material([0.6, 0.55, 0.5]);
    let dark = level.material([0.08, 0.07, 0.06]);
    level.solid([-WALL, -0.5, -WALL], [20.0 + WALL, 0.0, 20.0 + WALL], bright);
    for (min, max) in [
        ([-WALL, 0.0, -WALL], [0.0, 6.0, 20.0 + WALL]),
        ([20.0, 0.0, -WALL], [20.0 + WALL, 6.0, 20.0 + WALL]),
        ([0.0, 0.0, 20.0], [20.0, 6.0, 20.0 + WALL]),
    ] {
        level.solid(min, max, bright);
    }
    // The aisle is at z < 0.
    let slits: Vec<Opening> =
        (0..10).map(|slit| 1.0 + 2.0 * f64::from(slit)).map(|x| [x, x + SLIT[0], 1.5, 1.5 + SLIT[1]]).collect();
    for [from, to, low, high] in wall_pieces(20.0, 6.0, &slits) {
        level.solid([from, low, -WALL], [to, high, 0.0], bright);
    }
    for (min, max) in [
        ([-WALL, -0.5, -4.0 - 2.0 * WALL], [20.0 + WALL, 0.0, -WALL]),
        ([-WALL, 5.0, -4.0 - 2.0 * WALL], [20.0 + WALL, 5.0 + WALL, -WALL]),
        ([-WALL, 0.0, -4.0 - 2.0 * WALL], [20.0 + WALL, 5.0, -4.0 - WALL]),
        ([-WALL, 0.0, -4.0 - WALL], [0.0, 5.0, -WALL]),
        ([20.0, 0.0, -4.0 - WALL], [20.0 + WALL, 5.0, -WALL]),
    ] {
        level.solid(min, max, dark);
    }
    level.scene
}

/// Width and height of a slit in the wall of [`aisle`].
const SLIT: [f64; 2] = [0.2, 0.5];

/// Walls around a room and the slab over it.
struct Storey {
    /// Lower corner of the walls' outside.
    corner: [f64; 3],
    /// Of the outside, the slab included.
    size: [f64; 3],
    material: u32,
}

/// A scene in the making.
#[derive(Default)]
struct Level {
    scene: Scene,
}

impl Level {
    /// Dull, of this colour.
    fn material(&mut self, color: [f32; 3]) -> u32 {
        let base_color = Vec3::from(color).extend(1.0);
        self.scene.materials.push(Material { base_color, metallic: 0.0, ..Material::default() });
        self.scene.materials.len() as u32 - 1
    }

    /// A block, seen from outside.
    fn solid(&mut self, min: [f64; 3], max: [f64; 3], material: u32) {
        let corner =
            |i: usize| DVec3::from_array([0, 1, 2].map(|axis| if i >> axis & 1 == 0 { min[axis] } else { max[axis] }));
        let mut mesh = self.mesh(material);
        for face in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] {
            let first = mesh.positions.len() as u32;
            let corners = face.map(corner);
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize().as_vec3();
            mesh.positions.extend(corners);
            mesh.normals.extend([normal; 4]);
            mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
        self.scene.meshes.push(mesh);
    }

    /// `quads` x `quads` over a square around the origin, seen from above.
    fn field(&mut self, edge: f64, quads: usize, height: fn(f64, f64) -> f64, material: u32) {
        let mut mesh = self.mesh(material);
        let row = quads + 1;
        for index in 0..row * row {
            let [x, z] = [index % row, index / row].map(|i| edge * (i as f64 / quads as f64 - 0.5));
            mesh.positions.push(DVec3::new(x, height(x, z), z));
        }
        mesh.normals = vec![Vec3::ZERO; row * row];
        for index in 0..quads * quads {
            let a = index / quads * row + index % quads;
            let [a, b, c, d] = [a, a + row, a + row + 1, a + 1].map(|vertex| vertex as u32);
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|vertex| mesh.positions[vertex as usize]);
            let normal = (b - a).cross(c - a).as_vec3();
            triangle.iter().for_each(|vertex| mesh.normals[*vertex as usize] += normal);
        }
        mesh.normals.iter_mut().for_each(|normal| *normal = normal.normalize());
        self.scene.meshes.push(mesh);
    }

    /// Four walls with openings: along x at the high and the low end of z, along z at the low and the high end of x.
    fn walls(&mut self, storey: &Storey, openings: [&[Opening]; 4]) {
        let Storey { corner: [x, y, z], size: [width, height, depth], material } = *storey;
        for (side, openings) in openings.into_iter().enumerate() {
            let along_x = side < 2;
            let length = if along_x { width } else { depth - 2.0 * WALL };
            let across = [z + depth - WALL, z, x, x + width - WALL][side];
            for [from, to, low, high] in wall_pieces(length, height - WALL, openings) {
                let (min, max) = if along_x {
                    ([x + from, y + low, across], [x + to, y + high, across + WALL])
                } else {
                    ([across, y + low, z + WALL + from], [across + WALL, y + high, z + WALL + to])
                };
                self.solid(min, max, material);
            }
        }
    }

    fn ceiling(&mut self, storey: &Storey) {
        let Storey { corner: [x, y, z], size: [width, height, depth], material } = *storey;
        self.solid([x, y + height - WALL, z], [x + width, y + height, z + depth], material);
    }

    fn mesh(&self, material: u32) -> Mesh {
        let number = self.scene.meshes.len() as u32;
        Mesh { node: number, mesh: number, material, ..Mesh::default() }
    }
}

/// A wall around its openings, which follow one another: from, to, low and high of each piece.
fn wall_pieces(length: f64, height: f64, openings: &[Opening]) -> Vec<[f64; 4]> {
    let mut pieces = Vec::new();
    let mut end = 0.0;
    for &[from, to, sill, head] in openings {
        pieces.extend([[end, from, 0.0, height], [from, to, 0.0, sill], [from, to, head, height]]);
        end = to;
    }
    pieces.push([end, length, 0.0, height]);
    pieces.retain(|[from, to, low, high]| from < to && low < high);
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;
    use gdibl_baker::air::Air;
    use gdibl_baker::job::{Inputs, Job, Memory, NodeKind, Settings, Watch};
    use gdibl_baker::radiance::Distant;
    use std::sync::atomic::AtomicBool;

    /// The light of the sky in the middle of all directions, red, green and blue together, at some places under an even
    /// sky.
    fn light_at(scene: &Scene, places: &[[f64; 3]]) -> f64 {
        let mut settings = Settings::default();
        settings.grid.nodes = NodeKind::Points("places".into());
        settings.quality.samples = Some(8192);
        let mut sky = Distant::black();
        sky.panorama = sky.panorama.with_pixels(|_, _| [1.0; 3]);
        let places = places.iter().copied().map(DVec3::from).collect();
        let inputs = Inputs { distant: Some(sky), places, ..Inputs::new(scene.clone()) };
        let job = Job::prepare(inputs, settings, Memory::UNBOUNDED).expect("it fits");
        let baked = job.run(&Watch::silent(&AtomicBool::new(false))).expect("light").baked;
        (0..baked.len()).map(|node| f64::from(baked.node(node)[..3].iter().sum::<f32>())).sum::<f64>()
            / baked.len() as f64
    }

    #[test]
    fn the_aisle_has_about_a_thousandth_of_the_light_of_the_court() {
        let court = light_at(&aisle(), &[[5.0, 1.5, 5.0], [10.0, 1.5, 10.0], [15.0, 1.5, 14.0]]);
        let places: Vec<[f64; 3]> = (0..16).map(|i| [1.5 + f64::from(i), 1.5, -2.0 - 0.1 * f64::from(i)]).collect();
        let aisle = light_at(&aisle(), &places);
        // Noise is about a tenth here.
        assert!((400.0..2500.0).contains(&(court / aisle)), "{court} / {aisle}");
    }

    #[test]
    fn a_wall_and_its_openings_fill_a_rectangle() {
        let openings = [[1.0, 2.0, 0.0, 2.1], [3.0, 4.5, 0.9, 2.2]];
        let area = |[from, to, low, high]: [f64; 4]| (to - from) * (high - low);
        let wall: f64 = wall_pieces(8.0, 3.0, &openings).into_iter().map(area).sum();
        let holes: f64 = openings.into_iter().map(area).sum();
        assert!((wall + holes - 24.0).abs() < 1e-12, "{wall} {holes}");
        assert_eq!(wall_pieces(8.0, 3.0, &[]), [[0.0, 8.0, 0.0, 3.0]]);
    }

    #[test]
    fn people_are_in_the_houses_and_on_the_hills() {
        let [terrain, house, aisle] =
            [terrain(), two_storey(), aisle()].map(|scene| Air::of(&scene).expect("triangles"));
        assert_eq!(terrain.bounds.1.x - terrain.bounds.0.x, TERRAIN, "{terrain:?}");
        assert!((house.bounds.1 - house.bounds.0).max_element() < 11.0, "{house:?}");
        assert_eq!(aisle.bounds, aisle.all);
    }
}
