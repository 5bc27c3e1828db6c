//! Volumes cut out of volumes.

use gdibl_baker::Control;
use gdibl_baker::bake::{BakeSettings, Nodes, SparseGrid, bake_sparse};
use gdibl_baker::cut::{Part, Tile, coarser, difference, tiles, whole};
use gdibl_baker::pack::volume_of;
use gdibl_runtime::{Grid, Volume};
use std::sync::atomic::AtomicBool;

use crate::level::gdibl;
use crate::walls::{bake_grid, range, two_rooms};

fn volume(part: &Part) -> Volume {
    volume_of(&part.nodes, &part.baked)
}

/// Two rooms with a wall between them, off the places of the grid.
fn dense(counts: [u32; 3]) -> Volume {
    let (scene, probes) = two_rooms(0.01);
    let grid = Grid { min: [-2.7, -1.25, -1.75], max: [2.8, 1.25, 1.75], counts };
    bake_grid(grid, &gdibl(&scene, &probes, None)).1
}

/// The same, sparse.
fn sparse() -> Volume {
    let (scene, probes) = two_rooms(0.01);
    let grid = Grid { min: [-2.7, -1.25, -1.75], max: [2.8, 1.25, 1.75], counts: [33, 17, 25] };
    let settings = BakeSettings { samples: 256, ..BakeSettings::default() };
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    let function = gdibl(&scene, &probes, None);
    let (nodes, baked, record) = bake_sparse(&grid, 0.05, &function, &settings, &control).expect("nobody interrupts");
    assert!(matches!(nodes, Nodes::Sparse(_)), "{record:?}");
    volume_of(&nodes, &baked)
}

#[test]
fn tiles_say_what_the_volume_says() {
    for volume in [dense([12, 6, 8]), sparse()] {
        assert!(volume.walled_cells() > 0);
        let found: Vec<Tile> = tiles(&volume, 1.9).expect("a grid").collect();
        let last = found.last().expect("tiles").index;
        assert!(found.len() == 6 && last == [2, 0, 1], "{} {last:?}", found.len());
        let parts: Vec<Volume> = found.iter().map(|tile| self::volume(&tile.part)).collect();
        assert_eq!(parts.iter().map(Volume::walled_cells).sum::<usize>(), volume.walled_cells());
        let off = difference(&volume, &parts, 20_000).expect("places with light");
        assert!(off.max < 1e-4, "{off:?}");
        // Nodes in faces are in both tiles, and nothing else is.
        let nodes: usize = parts.iter().map(Volume::node_count).sum();
        assert!(nodes > volume.node_count() && nodes < volume.node_count() * 7 / 4, "{nodes} {}", volume.node_count());
    }
}

#[test]
fn the_whole_is_the_volume() {
    for volume in [dense([12, 6, 8]), sparse()] {
        let all = self::volume(&whole(&volume).expect("a grid"));
        assert_eq!((all.node_count(), all.walled_cells()), (volume.node_count(), volume.walled_cells()));
        assert_eq!(difference(&volume, &[all], 2000).expect("light").max, 0.0);
    }
}

#[test]
fn nodes_of_a_coarser_volume_are_those_of_the_finer_one_at_their_places() {
    for volume in [dense([13, 5, 9]), sparse()] {
        let fine = volume.grid().expect("a grid");
        for steps in [1, 2, 3] {
            if fine.counts.iter().any(|n| (n - 1) % (1 << steps) != 0) {
                assert!(steps > 2, "{:?}", fine.counts);
                continue;
            }
            let part = coarser(&volume, steps).expect("a grid");
            let (grid, place_of): (Grid, Box<dyn Fn(usize) -> [u32; 3]>) = match part.nodes.clone() {
                Nodes::Grid(grid) => (grid, Box::new(move |node| grid.place_of(node as u32))),
                Nodes::Sparse(SparseGrid { grid, bricks }) => (grid, Box::new(move |node| bricks.place_of(node))),
                other => panic!("{other:?}"),
            };
            assert_eq!(grid.counts, fine.counts.map(|n| (n - 1) / (1 << steps) + 1));
            assert!(part.nodes.len() < volume.node_count());
            for node in 0..part.nodes.len() {
                let place = place_of(node).map(|p| p << steps);
                let own = volume.bricks().map_or(Some(fine.index_of(place)), |bricks| bricks.node_at(place));
                let own = volume.node_sh(own.expect("a node of the finer one") as usize);
                assert_eq!(*part.baked.node(node), own.coefficients.as_flattened()[..part.baked.node(node).len()]);
            }
        }
    }
}

#[test]
fn light_of_a_coarser_volume_stays_in_its_room() {
    // 11 cells in x: twice as wide, they do not divide the box.
    for volume in [dense([12, 6, 8]), dense([13, 5, 9]), sparse()] {
        let part = coarser(&volume, 1).expect("a grid");
        let coarse = self::volume(&part);
        assert!(coarse.walled_cells() > 0);
        let (_, dark) = range(&coarse, &[0.01 + 1e-4, 0.02, 0.3, 0.55, 2.0]);
        let (bright, _) = range(&coarse, &[-2.0, -0.6, -0.3, -0.01, -1e-4]);
        assert!(dark < 0.01 && bright > 0.95, "{dark} {bright}");
        // The walls are what does it.
        let mut open = part;
        open.baked.walls = None;
        let (_, leaks) = range(&self::volume(&open), &[0.02]);
        assert!(leaks > 0.03, "{leaks}");
    }
}
