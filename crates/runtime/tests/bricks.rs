//! Sparse grids: which places are nodes, light between them, and what is refused.

mod common;

use common::{File, raw};
use gdibl_runtime::bricks::{BRICK, Bricks};
use gdibl_runtime::{Error, Volume};
use std::cell::OnceCell;
use std::collections::HashSet;

type Place = [u32; 3];

/// Refined cells, closed under what the format asks for.
struct Tree {
    counts: Place,
    levels: u32,
    refined: HashSet<(u32, Place)>,
    nodes: OnceCell<Vec<Place>>,
}

impl Tree {
    fn cells(&self, level: u32) -> Place {
        self.counts.map(|count| ((count - 1) >> level).max(1))
    }

    fn new(counts: Place, levels: u32) -> Tree {
        Tree { counts, levels, refined: HashSet::new(), nodes: OnceCell::new() }
    }

    /// About one in `rarity` cells of each level is refined, and what must be with it.
    fn random(counts: Place, levels: u32, rarity: u64, seed: u64) -> Tree {
        let mut tree = Tree::new(counts, levels);
        for level in 1..=levels {
            for cell in places(tree.cells(level)) {
                let mut hash = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ u64::from(level);
                for n in cell {
                    hash = (hash ^ u64::from(n)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
                    hash ^= hash >> 29;
                }
                if hash.is_multiple_of(rarity) {
                    tree.refine(level, cell);
                }
            }
        }
        tree
    }

    fn refine(&mut self, level: u32, cell: Place) {
        if !self.refined.insert((level, cell)) || level == self.levels {
            return;
        }
        let cells = self.cells(level);
        for step in places([3; 3]) {
            let near: [i64; 3] = std::array::from_fn(|k| i64::from(cell[k]) + i64::from(step[k]) - 1);
            if (0..3).all(|k| (0..i64::from(cells[k])).contains(&near[k])) {
                self.refine(level + 1, near.map(|n| n as u32 / 2));
            }
        }
    }

    /// Origin and width of the cells that are not refined.
    fn leaves(&self) -> Vec<(Place, u32)> {
        let mut leaves = Vec::new();
        for level in 0..=self.levels {
            for cell in places(self.cells(level)) {
                let exists = level == self.levels || self.refined.contains(&(level + 1, cell.map(|n| n / 2)));
                if exists && !self.refined.contains(&(level, cell)) {
                    leaves.push((cell.map(|n| n << level), 1 << level));
                }
            }
        }
        leaves
    }

    /// Places that all leaves there have as a corner, in the order of the file.
    fn nodes(&self) -> &[Place] {
        self.nodes.get_or_init(|| self.find_nodes())
    }

    fn find_nodes(&self) -> Vec<Place> {
        let leaves = self.leaves();
        let is_corner = |place: Place| {
            leaves.iter().all(|&(origin, width)| {
                let at = |k: usize| if self.counts[k] == 1 { Some(0) } else { place[k].checked_sub(origin[k]) };
                let within = (0..3).all(|k| at(k).is_some_and(|p| p <= width));
                !within || (0..3).all(|k| at(k).is_some_and(|p| p == 0 || p == width))
            })
        };
        let mut nodes: Vec<Place> = places(self.counts).filter(|place| is_corner(*place)).collect();
        nodes.sort_by_key(|&[x, y, z]| [z / BRICK, y / BRICK, x / BRICK, z, y, x]);
        nodes
    }

    /// Section `BRIK`, after FORMAT.md.
    fn section(&self) -> Vec<u8> {
        let nodes: HashSet<Place> = self.nodes().iter().copied().collect();
        let mut bytes: Vec<u8> = self.counts.iter().chain([&self.levels]).flat_map(|w| w.to_le_bytes()).collect();
        let mut masks = Vec::new();
        for brick in places(self.counts.map(|count| count.div_ceil(8))) {
            let mut mask = [0u8; 64];
            let mut plain = true;
            for place in places([8; 3]) {
                let there = std::array::from_fn(|k| 8 * brick[k] + place[k]);
                if nodes.contains(&there) {
                    let [x, y, z] = place.map(|p| p as usize);
                    mask[8 * z + y] |= 1 << x;
                    plain &= there.iter().all(|p| p % (1 << self.levels) == 0);
                }
            }
            bytes.push(u8::from(!plain));
            if !plain {
                masks.extend(mask);
            }
        }
        bytes.extend(masks);
        bytes
    }

    fn file(&self, value: impl Fn(Place) -> f32) -> File {
        let nodes = self.nodes();
        File {
            version: 1,
            kind: 3,
            counts: [nodes.len() as u32, 1, 1],
            bands: 0,
            encoding: 0,
            scale: 1.0,
            units: 0,
            min: [0.0; 3],
            max: self.counts.map(|count| f64::from(count - 1)),
            sections: Vec::new(),
        }
        .radiance(|node, _, _| value(nodes[node]))
        .section(raw(b"BRIK", self.section()))
    }

    fn volume(&self, value: impl Fn(Place) -> f32) -> Volume {
        Volume::parse(&self.file(value).to_bytes()).unwrap()
    }
}

fn places(counts: Place) -> impl Iterator<Item = Place> {
    let [nx, ny, nz] = counts;
    (0..nz).flat_map(move |z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z])))
}

fn trees() -> Vec<Tree> {
    let mut trees = Vec::new();
    for (seed, (counts, levels)) in
        [([17, 9, 17], 3), ([9, 17, 9], 2), ([7, 11, 5], 1), ([17, 1, 25], 3), ([33, 1, 1], 3)].into_iter().enumerate()
    {
        for rarity in [1, 3, 17, 200] {
            trees.push(Tree::random(counts, levels, rarity, seed as u64 + 1));
        }
    }
    trees
}

fn any_value([x, y, z]: Place) -> f32 {
    ((x * 7919 + y * 104_729 + z * 1_299_709) % 1000) as f32 / 1000.0
}

fn band_0(volume: &Volume, position: [f64; 3]) -> f32 {
    volume.sample_f64(position, [0.0, 1.0, 0.0]).sh.coefficients[0][0]
}

#[test]
fn nodes_are_the_places_that_all_cells_there_have_as_a_corner() {
    for tree in trees() {
        let volume = tree.volume(any_value);
        let nodes = tree.nodes();
        assert_eq!(volume.node_count(), nodes.len());
        let bricks = volume.bricks().unwrap();
        for (number, &place) in nodes.iter().enumerate() {
            assert_eq!(bricks.place_of(number), place);
            assert_eq!(bricks.node_at(place), Some(number as u32));
            assert_eq!(volume.node_position(number), place.map(f64::from));
            assert_eq!(band_0(&volume, place.map(f64::from)), any_value(place));
        }
        assert_eq!(places(tree.counts).filter(|place| bricks.node_at(*place).is_some()).count(), nodes.len());
        let leaves: HashSet<(Place, u32)> = bricks.leaves().map(|leaf| (leaf.origin, 1 << leaf.level)).collect();
        assert_eq!(leaves, tree.leaves().into_iter().collect());
    }
}

#[test]
fn the_writer_derives_the_same_bytes() {
    for tree in trees() {
        let bricks = Bricks::new(tree.counts, tree.levels, |level, cell| tree.refined.contains(&(level, cell)));
        assert_eq!(bricks.to_bytes(), tree.section());
    }
}

#[test]
fn light_that_is_linear_comes_out_linear_everywhere() {
    for tree in trees() {
        let light = |[x, y, z]: [f64; 3]| 1.0 + 0.25 * x - 0.5 * y + 0.125 * z;
        let volume = tree.volume(|place| light(place.map(f64::from)) as f32);
        for i in 0..2000 {
            let position = std::array::from_fn(|k| {
                f64::from(tree.counts[k] - 1) * (0.5 + f64::from(i) * [0.754_877, 0.569_840, 0.430_159][k]).fract()
            });
            let found = f64::from(band_0(&volume, position));
            assert!((found - light(position)).abs() < 1e-4, "{position:?}: {found} {}", light(position));
        }
    }
}

#[test]
fn nothing_jumps_at_the_faces_of_cells_of_any_level() {
    let mut mixed = 0;
    for tree in trees() {
        let volume = tree.volume(any_value);
        let bricks = volume.bricks().unwrap();
        // On every face, edge and corner of every cell: from just before to just beyond.
        for (origin, width) in tree.leaves() {
            for step in 0..3 * 27 {
                let side = [step % 27 % 3, step % 27 / 3 % 3, step % 27 / 9];
                let on_it: [f64; 3] = std::array::from_fn(|k| {
                    let within = (f64::from(step) * [0.754_877, 0.569_840, 0.430_159][k]).fract();
                    f64::from(origin[k]) + f64::from(width) * [0.0, within, 1.0][side[k] as usize]
                });
                const STEP: f64 = 1e-6;
                let across = |sign: f64| std::array::from_fn(|k| on_it[k] + sign * STEP * (f64::from(side[k]) - 1.0));
                let (before, beyond): ([f64; 3], [f64; 3]) = (across(-1.0), across(1.0));
                let jump = (band_0(&volume, before) - band_0(&volume, beyond)).abs();
                assert!(jump < 1e-5, "{on_it:?}: {jump}");
                let inside = (0..3).all(|k| beyond[k] >= 0.0 && beyond[k] < f64::from(tree.counts[k] - 1));
                if inside {
                    let level = |p: [f64; 3]| bricks.leaf(p.map(|p| p as u32)).level;
                    mixed += u32::from(level(before) != level(beyond));
                }
            }
        }
    }
    assert!(mixed > 3000, "{mixed}");
}

#[test]
fn a_grid_refined_everywhere_answers_as_the_grid() {
    let tree = Tree::random([9, 17, 5], 2, 1, 1);
    let sparse = tree.volume(any_value);
    let mut dense = tree.file(any_value);
    assert_eq!(tree.nodes().len(), 9 * 17 * 5);
    (dense.kind, dense.counts, dense.sections) = (0, tree.counts, Vec::new());
    let dense = dense.radiance(|node, _, _| any_value([node as u32 % 9, node as u32 / 9 % 17, node as u32 / 153]));
    let dense = Volume::parse(&dense.to_bytes()).unwrap();
    for i in 0..1000 {
        let position = [0.0131, 0.0217, 0.0057].map(|step| f64::from(i) * step - 1.0);
        let [sparse, dense] = [&sparse, &dense].map(|volume| volume.sample_f64(position, [0.0, 1.0, 0.0]));
        assert_eq!(sparse, dense, "{position:?}");
    }
}

#[test]
fn only_valid_nodes_count_and_filled_ones_where_there_is_no_other() {
    let tree = Tree::random([17, 9, 9], 3, 5, 3);
    let nodes = tree.nodes();
    let valid = |place: Place| place[0] < 8;
    let file = tree.file(|place| if valid(place) { 1.0 } else { 5.0 }).validity(|node| valid(nodes[node]));
    let volume = Volume::parse(&file.to_bytes()).unwrap();
    for i in 0..1000 {
        let position = [0.016, 0.0077, 0.0079].map(|step| f64::from(i) * step);
        let sample = volume.sample_f64(position, [0.0, 1.0, 0.0]);
        let expected = if sample.validity > 1e-6 { 1.0 } else { 5.0 };
        assert!((sample.sh.coefficients[0][0] - expected).abs() < 1e-5, "{position:?}: {sample:?}");
        assert!(position[0] >= 8.0 || sample.validity > 0.0);
    }
}

#[test]
fn what_is_no_sparse_grid_is_refused() {
    let tree = Tree::random([17, 9, 25], 3, 17, 1);
    let section = tree.section();
    let with = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut section = section.clone();
        change(&mut section);
        let mut file = tree.file(any_value);
        file.sections[1] = raw(b"BRIK", section);
        Volume::parse(&file.to_bytes())
    };
    assert!(with(&|_| {}).is_ok());
    let refused = |change: &dyn Fn(&mut Vec<u8>), place: &str| {
        let error = with(change).unwrap_err();
        assert!(matches!(error, Error::Invalid { .. }), "{error}");
        assert!(error.to_string().contains(place), "{error}");
    };
    refused(&|b| b.truncate(10), "at least 16");
    refused(&|b| b.truncate(20), "bricks");
    refused(&|b| b.push(0), "bytes after the flags");
    refused(&|b| b[0] = 18, "counts");
    refused(&|b| b[..12].copy_from_slice(&[255; 12]), "counts");
    refused(&|b| b[12] = 0, "levels");
    refused(&|b| b[12] = 4, "levels");
    refused(&|b| b[16] = 2, "brick 0");
    // Any bit of any mask matters.
    let first = 16 + 3 * 2 * 4;
    for bit in (0..8 * (section.len() - first)).step_by(7) {
        refused(&|b| b[first + bit / 8] ^= 1 << (bit % 8), "BRIK");
    }
    // Cells of levels 0 and 2 side by side.
    let mut steep = Tree::new([17; 3], 3);
    for (level, cell) in [(3, [0, 0, 0]), (2, [1, 0, 0]), (1, [3, 0, 0])] {
        steep.refined.insert((level, cell));
    }
    let error = Volume::parse(&steep.file(any_value).to_bytes()).unwrap_err();
    assert!(error.to_string().contains("one level"), "{error}");
    // A grid holds no bricks, and a sparse one some.
    let mut file = tree.file(any_value);
    file.sections.truncate(1);
    assert!(Volume::parse(&file.to_bytes()).unwrap_err().to_string().contains("BRIK"));
    let mut file = tree.file(any_value);
    file.kind = 0;
    assert!(Volume::parse(&file.to_bytes()).unwrap_err().to_string().contains("BRIK"));
}
