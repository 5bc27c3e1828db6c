//! Volumes of every kind that a shader can meet, and where to ask them for light.

use crate::common::{File, grid, pattern, raw};
use crate::gpu::Query;
use gdibl_runtime::Grid;
use gdibl_runtime::bricks::Bricks;
use gdibl_runtime::walls::{Plane, WallCell, walls_to_bytes};

/// Numbers that follow from a seed alone.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Random {
        Random(seed)
    }

    /// S. Vigna, "splitmix64" (2015).
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// 0 to `end` - 1.
    fn below(&mut self, end: usize) -> usize {
        (self.bits() % end as u64) as usize
    }

    /// 0..1.
    fn unit(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / (1 << 24) as f32
    }

    /// A direction; one in eight along an axis.
    fn direction(&mut self) -> [f32; 3] {
        if self.below(8) == 0 {
            let mut axis = [0.0; 3];
            axis[self.below(3)] = if self.below(2) == 0 { -1.0 } else { 1.0 };
            return axis;
        }
        loop {
            let v: [f32; 3] = std::array::from_fn(|_| 2.0 * self.unit() - 1.0);
            let squared: f32 = v.iter().map(|v| v * v).sum();
            if (0.01..=1.0).contains(&squared) {
                return v.map(|v| v / squared.sqrt());
            }
        }
    }
}

pub struct Case {
    pub name: &'static str,
    pub file: File,
    /// Places of the grid per axis.
    pub counts: [u32; 3],
    pub planes: Vec<Plane>,
}

/// An empty file of these numbers, its box on the origin.
fn box_of(counts: [u32; 3], bands: u32, encoding: u32) -> File {
    let mut file = grid(counts, bands, encoding, if encoding == 1 { 0.5 } else { 1.0 });
    (file.min, file.max) = ([0.0; 3], [4.0, 1.5, 3.0]);
    file
}

/// One node in five is not valid, and the whole of a corner.
fn some_invalid(file: File) -> File {
    let [width, height, _] = file.counts.map(|count| count as usize);
    file.validity(move |node| {
        let in_corner = node % width < 3 && node / width % height < 3;
        !in_corner && node * 7919 % 5 != 0
    })
}

/// Walls in every third cell: 1 to 3 planes each, with masks that hide a quarter of the corners (of one part in eight all),
/// and in every second ends.
fn with_walls(file: File, seed: u64) -> (File, Vec<Plane>) {
    let grid = Grid { min: file.min, max: file.max, counts: file.counts };
    let cells = (0..grid.node_count() as u32).filter(|&cell| grid.is_cell(cell));
    let cells = cells.map(|cell| (cell, grid.cell_box(cell))).collect();
    with_walls_in(file, cells, seed)
}

/// A cell and its box.
type CellBox = (u32, ([f64; 3], [f64; 3]));

fn with_walls_in(file: File, boxes: Vec<CellBox>, seed: u64) -> (File, Vec<Plane>) {
    let mut random = Random::new(seed);
    let (mut planes, mut cells) = (Vec::new(), Vec::new());
    for (cell, (low, high)) in boxes {
        if random.below(3) != 0 {
            continue;
        }
        let mut indices = [WallCell::NO_PLANE; 3];
        for index in indices.iter_mut().take(1 + random.below(3)) {
            let through: [f32; 3] = std::array::from_fn(|axis| {
                let share = f64::from(random.unit());
                (low[axis] + share * (high[axis] - low[axis]) - file.min[axis]) as f32
            });
            let normal = random.direction();
            *index = planes.len() as u16;
            planes.push(Plane { normal, distance: (0..3).map(|axis| normal[axis] * through[axis]).sum() });
        }
        let masks = std::array::from_fn(|_| match random.below(8) {
            0 => 0,
            _ => (random.bits() | random.bits()) as u8,
        });
        let ends = if random.below(2) == 0 { 0 } else { random.bits() as u8 };
        cells.push(WallCell { cell, planes: indices, masks, ends });
    }
    (file.section(raw(b"WALL", walls_to_bytes(&planes, &cells))), planes)
}

/// A sparse grid whose cells are small around a place, and what walls go through every third of them.
fn sparse(name: &'static str, counts: [u32; 3], bands: u32, around: [f64; 3], is_walled: bool) -> Case {
    // Each step outward is wide enough for cells that touch to differ by one level.
    let reach = [3.0, 6.1, 12.2];
    let bricks = Bricks::new(counts, 3, |level, cell| {
        let middle =
            |axis: usize| if counts[axis] > 1 { (f64::from(cell[axis]) + 0.5) * f64::from(1 << level) } else { 0.0 };
        (0..3).all(|axis| (middle(axis) - around[axis]).abs() < reach[level as usize - 1])
    });
    let mut file = box_of([bricks.node_count() as u32, 1, 1], bands, 1);
    file.kind = 3;
    let file = file.radiance(pattern).section(raw(b"BRIK", bricks.to_bytes()));
    if !is_walled {
        return Case { name, file, counts, planes: Vec::new() };
    }
    let grid = Grid { min: file.min, max: file.max, counts };
    let mut boxes: Vec<CellBox> = bricks
        .leaves()
        .map(|leaf| {
            let [low, high] = [0, 7].map(|corner| grid.place_position(bricks.corner(leaf, corner)));
            (grid.index_of(leaf.origin), (low, high))
        })
        .collect();
    boxes.sort_by_key(|(cell, _)| *cell);
    let (file, planes) = with_walls_in(file.validity(|node| node * 7919 % 5 != 0), boxes, 6);
    Case { name, file, counts, planes }
}

pub fn cases() -> Vec<Case> {
    let case = |name, file: File, planes| Case { name, counts: file.counts, file, planes };
    let plain = |name, file: File| case(name, file.radiance(pattern), Vec::new());
    let invalid = |name, file: File| case(name, some_invalid(file.radiance(pattern)), Vec::new());
    let walled = |name, file: File, seed| {
        let (file, planes) = with_walls(file.radiance(pattern), seed);
        case(name, file, planes)
    };
    let mut far = box_of([7, 5, 6], 2, 1);
    (far.min, far.max) = ([1e6, -2e6, 3e5], [1e6 + 4.0, -2e6 + 1.5, 3e5 + 3.0]);
    let mut flat = box_of([7, 3, 6], 2, 1);
    flat.max[1] = 0.0;
    // Numbers as the packer makes them: number 1 is 0. A dark node in seventy; and one so dim that the CPU, too, unpacks to
    // f32 and not to f16, whose rounding alone comes to the tolerance.
    let numbers = |node: usize, plane: usize| match (node, plane) {
        (_, 0) if node % 70 == 69 => 0,
        (1, 0) => 16384 - 38 * 256,
        (_, 0) => 16384 + (node * 389 % 1500) as i16,
        (_, 1) => 0,
        _ => (node * 131 + plane * 29) as i16 % 51 * 2 - 51,
    };
    let packed = |counts: [u32; 3], bands| File { scale: 0.004, ..box_of(counts, bands, 2) }.packed(numbers);
    vec![
        case("packed, L2", packed([7, 5, 6], 2), Vec::new()),
        case("packed, one node, L1", packed([1, 1, 1], 1), Vec::new()),
        case("packed, some invalid, L0", some_invalid(packed([8, 1, 9], 0)), Vec::new()),
        {
            let (file, planes) = with_walls(packed([7, 5, 6], 1), 1);
            case("packed, walls, L1", file, planes)
        },
        case("packed, L4, of which L2 is used", packed([4, 3, 3], 4), Vec::new()),
        plain("all valid, L2", box_of([7, 5, 6], 2, 1)),
        plain("all valid, L1", box_of([7, 5, 6], 1, 1)),
        plain("all valid, L0", box_of([7, 5, 6], 0, 1)),
        plain("L4, of which L2 is used", box_of([4, 3, 3], 4, 1)),
        plain("f32, L2", box_of([7, 5, 6], 2, 0)),
        plain("one node", box_of([1, 1, 1], 2, 1)),
        plain("one node on x and z", box_of([1, 9, 1], 1, 1)),
        plain("several nodes on an axis without extent", flat),
        invalid("some invalid, L2", box_of([7, 5, 6], 2, 1)),
        invalid("some invalid, one node on y, L0", box_of([8, 1, 9], 0, 1)),
        walled("walls, L2", box_of([7, 5, 6], 2, 1), 1),
        walled("walls, one node on z, L1", box_of([9, 8, 1], 1, 1), 2),
        walled("walls, 53 960 nodes, L0", box_of([71, 20, 38], 0, 1), 3),
        walled("walls, far from the origin, L2", far, 4),
        {
            let (file, planes) = with_walls(some_invalid(box_of([7, 5, 6], 1, 1).radiance(pattern)), 5);
            case("walls, some invalid, L1", file, planes)
        },
        sparse("sparse, L2", [33, 17, 25], 2, [11.0, 5.0, 17.0], false),
        sparse("sparse, one place on y, L1", [33, 1, 25], 1, [11.0, 0.0, 17.0], false),
        sparse("sparse, walls, some invalid, L1", [17, 17, 25], 1, [5.0, 11.0, 9.0], true),
    ]
}

/// Half of the queries lie anywhere in the box. Of the others a quarter each: around it; with a coordinate on a cell's face; on
/// nodes; on walls, facing to one of the wall's sides or wherever.
pub fn queries(case: &Case, count: usize, seed: u64) -> Vec<Query> {
    let mut random = Random::new(seed);
    let extent: [f32; 3] = std::array::from_fn(|axis| (case.file.max[axis] - case.file.min[axis]) as f32);
    let query = |number: usize| {
        let mut position: [f32; 3] = std::array::from_fn(|axis| random.unit() * extent[axis]);
        let mut normal = random.direction();
        let on_node = |axis: usize, random: &mut Random| {
            let count = case.counts[axis] as usize;
            random.below(count) as f32 / (count - 1).max(1) as f32 * extent[axis]
        };
        match number % 8 {
            0 => position = std::array::from_fn(|axis| 2.0 * position[axis] - 0.5 * extent[axis]),
            1 => {
                let axis = random.below(3);
                position[axis] = on_node(axis, &mut random);
            }
            2 => position = [0, 1, 2].map(|axis| on_node(axis, &mut random)),
            3 if !case.planes.is_empty() => {
                let plane = case.planes[random.below(case.planes.len())];
                let height = (0..3).map(|axis| plane.normal[axis] * position[axis]).sum::<f32>() - plane.distance;
                position = std::array::from_fn(|axis| position[axis] - height * plane.normal[axis]);
                match random.below(3) {
                    0 => normal = plane.normal,
                    1 => normal = plane.normal.map(|v| -v),
                    _ => {}
                }
            }
            _ => {}
        }
        Query { position, normal, anywhere: number % 8 >= 4 }
    };
    (0..count).map(query).collect()
}
