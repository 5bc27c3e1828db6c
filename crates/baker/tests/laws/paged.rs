//! Bakes too large for memory: what nodes came to is in a file, and of the volume a few nodes are read.

use gdibl_baker::Control;
use gdibl_baker::bake::{BakeSettings, Nodes, bake};
use gdibl_baker::blocks::{BlockId, Blocks, Found, PassKind};
use gdibl_baker::job::records::Records;
use gdibl_baker::pack::{PackSettings, Precision, frame_of, pack, part_as_read};
use gdibl_runtime::{Grid, Volume};
use std::fs::File;
use std::sync::atomic::AtomicBool;

use crate::level::gdibl;
use crate::walls::{bake_grid, two_rooms};

/// Keeps nothing, and lends a file for every table.
struct Lends;

impl Blocks for Lends {
    fn begin(&self, _: PassKind) -> u32 {
        0
    }
    fn is_own(&self, _: BlockId) -> bool {
        true
    }
    fn known(&self, _: BlockId) -> Option<Vec<u8>> {
        None
    }
    fn keep(&self, _: BlockId, _: &[u8]) {}
    fn count(&self, found: &[Found]) -> u64 {
        found.iter().map(|found| u64::from(found.rays)).sum()
    }
    fn end(&self, _: u32) -> bool {
        true
    }
    fn scratch(&self, _: u64) -> Option<File> {
        tempfile::tempfile().ok()
    }
}

/// Rooms beside a wall, with nodes in it and beyond them.
const GRID: Grid = Grid { min: [-2.85, -1.8, -1.75], max: [2.65, 1.25, 1.75], counts: [12, 7, 8] };

#[test]
fn a_bake_in_a_file_is_that_in_memory() {
    let (scene, probes) = two_rooms(0.1);
    let function = gdibl(&scene, &probes, None);
    let nodes = Nodes::Grid(GRID);
    for target_error in [None, Some(0.05)] {
        let settings = BakeSettings { samples: 512, target_error, coefficient_errors: true, ..BakeSettings::default() };
        let baked_with = |blocks: Option<&dyn Blocks>| {
            let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks };
            bake(&nodes, &function, &settings, &control).expect("nobody interrupts")
        };
        let (held, paged) = (baked_with(None), baked_with(Some(&Lends)));
        assert!(!held.is_all_valid() && held.walls.is_some(), "filled nodes and walls are part of it");
        assert!(held == paged);
        let bytes = |baked| pack(&nodes, baked, Records::default(), PackSettings::default()).bytes;
        assert!(bytes(&held) == bytes(&paged));
    }
}

#[test]
fn part_of_a_volume_reads_as_in_the_whole() {
    let (scene, probes) = two_rooms(0.1);
    let (mut baked, _) = bake_grid(GRID, &gdibl(&scene, &probes, None));
    // Nodes that are bright, dim, and black.
    baked.sh.update(|node, values| {
        let factor = [1.0, 30.0, 1e-4, 0.0][node % 4];
        values.iter_mut().for_each(|value| *value *= factor);
    });
    let nodes = Nodes::Grid(GRID);
    for precision in [Precision::F16, Precision::F32, Precision::PACKED, Precision::Packed { error: Some(0.02) }] {
        for dering in [false, true] {
            let settings = PackSettings { precision, dering, ..PackSettings::default() };
            let whole = Volume::parse(&pack(&nodes, &baked, Records::default(), settings).bytes).unwrap();
            let some: Vec<u32> = (0..nodes.len() as u32).step_by(7).collect();
            let part = part_as_read(&baked, settings, &some);
            for (place, node) in some.iter().enumerate() {
                assert_eq!(part.node_sh(place), whole.node_sh(*node as usize), "{settings:?}, node {node}");
            }
            // And the frame tells which nodes are read.
            let frame = frame_of(&nodes, &baked);
            for place in 0..200u32 {
                let share = [place * 37 % 101, place * 53 % 101, place * 71 % 101].map(|n| f64::from(n) / 100.0);
                let at = std::array::from_fn(|k| GRID.min[k] + share[k] * (GRID.max[k] - GRID.min[k]));
                let normal = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]][place as usize % 2];
                let (nodes, weights) = frame.blended_nodes(at, normal).unwrap();
                let (expected, found) =
                    (whole.irradiance_f64(at, normal), whole.irradiance_of_nodes(&nodes, weights, normal));
                for (expected, found) in expected.into_iter().zip(found) {
                    // Where numbers are tiny the whole scales weights once more.
                    assert!((expected - found).abs() <= 1e-6 * expected.abs(), "{at:?}: {found}, not {expected}");
                }
            }
        }
    }
}
