//! Sparse grids: as fine as light asks for, and no finer.

use gdibl_baker::Control;
use gdibl_baker::bake::{BakeSettings, Baked, Nodes, bake, bake_sparse, grid_of_cells, grid_of_counts};
use gdibl_baker::job::records::SparseRecord;
use gdibl_baker::pack::volume_of;
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::scene::{Role, Scene};
use gdibl_runtime::{Grid, Volume};
use glam::DVec3;
use std::sync::atomic::AtomicBool;

use crate::level::{add, box_of, distant, gdibl, panorama, probe, solid_of};

const SETTINGS: BakeSettings = BakeSettings {
    bands: 2,
    samples: 512,
    target_error: None,
    seed: 0,
    sampler: gdibl_baker::sampling::Sampler::Sobol,
    importance: true,
    coefficient_errors: false,
    punctual: false,
    clamp: f32::INFINITY,
};

fn sparse(grid: Grid, tolerance: f64, function: &impl RadianceFunction) -> (Nodes, Baked, SparseRecord) {
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    let (nodes, baked, record) = bake_sparse(&grid, tolerance, function, &SETTINGS, &control).expect("not interrupted");
    (nodes, baked, record.expect("the grid has coarser cells"))
}

fn dense(grid: Grid, function: &impl RadianceFunction) -> Baked {
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    bake(&Nodes::Grid(grid), function, &SETTINGS, &control).expect("not interrupted")
}

/// A room with a bright wall: light changes fast beside it, and hardly at the other end.
fn room() -> (Scene, [gdibl_baker::radiance::gdibl::Probe; 1]) {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::new(0.0, 0.0, 0.0), DVec3::new(8.0, 4.0, 4.0)));
    let bright = probe(DVec3::new(4.0, 2.0, 2.0), 32, |d| if d.x < -0.9 { [9.0, 6.0, 3.0] } else { [0.5, 0.5, 0.6] });
    (scene, [bright])
}

#[test]
fn cells_are_small_where_light_changes_and_the_error_between_nodes_is_near_the_tolerance() {
    let (scene, probes) = room();
    let function = gdibl(&scene, &probes, None);
    let grid = grid_of_counts(DVec3::splat(0.1), DVec3::new(7.9, 3.9, 3.9), [33, 17, 17]);
    let (nodes, baked, record) = sparse(grid, 0.03, &function);
    let Nodes::Sparse(found) = &nodes else { panic!("{record:?}") };
    assert!(nodes.len() < 33 * 17 * 17 / 2, "{}", nodes.len());
    // Beside the bright wall cells are smaller than at the other end.
    let share = |low: u32, high: u32| {
        let count = (0..nodes.len()).filter(|node| (low..high).contains(&found.bricks.place_of(*node)[0])).count();
        count as f64 / f64::from((high - low) * 17 * 17)
    };
    assert!(share(0, 8) > 2.0 * share(25, 33), "{} {}", share(0, 8), share(25, 33));
    // Against the dense grid, everywhere: what is left out is not missed.
    let full = dense(grid, &function);
    let (sparse, full) = (volume_of(&nodes, &baked), volume_of(&Nodes::Grid(grid), &full));
    let mut errors: Vec<f64> =
        (0..full.node_count()).map(|node| error(&sparse, &full, full.node_position(node))).collect();
    errors.sort_by(f64::total_cmp);
    assert!(errors[errors.len() * 95 / 100] < 0.05, "{}", errors[errors.len() * 95 / 100]);
    let reported = record.levels[1].error.expect("cells were checked");
    assert!(reported.p95 < 0.06 && record.levels[1].checked > 15, "{record:?}");
    assert!(record.levels.iter().map(|level| level.cells).sum::<u64>() > 0);
}

/// Of E up at a place.
fn error(found: &Volume, truth: &Volume, place: [f64; 3]) -> f64 {
    let up = [0.0, 1.0, 0.0];
    let [found, truth] = [found, truth].map(|volume| f64::from(volume.irradiance_f64(place, up)[1]));
    (found - truth).abs() / truth
}

#[test]
fn an_evenly_lit_field_has_one_node() {
    let scene = Scene::default();
    let sky = distant(panorama(8, |_| [1.0, 2.0, 3.0]));
    let function = Path::new(&scene, Some(&sky), PathSettings::default());
    let grid = grid_of_counts(DVec3::ZERO, DVec3::splat(8.0), [9; 3]);
    let (nodes, baked, record) = sparse(grid, 0.01, &function);
    assert_eq!((nodes.len(), record.places), (1, 729));
    let volume = volume_of(&nodes, &baked);
    let e = volume.irradiance([3.0, 1.0, 7.0], [0.0, 1.0, 0.0]);
    assert!((f64::from(e[1]) / (2.0 * std::f64::consts::PI) - 1.0).abs() < 1e-3, "{e:?}");
    assert!(record.levels.iter().filter_map(|level| level.error).all(|error| error.max < 1e-3), "{record:?}");
}

#[test]
fn a_node_has_the_light_of_its_place_in_the_dense_grid() {
    let (scene, probes) = room();
    let function = gdibl(&scene, &probes, None);
    let grid = grid_of_counts(DVec3::splat(0.1), DVec3::new(7.9, 3.9, 3.9), [17, 9, 9]);
    let (nodes, baked, _) = sparse(grid, 0.02, &function);
    let full = dense(grid, &function);
    let Nodes::Sparse(found) = &nodes else { panic!("{}", nodes.len()) };
    assert!(nodes.len() > 200, "{}", nodes.len());
    for node in 0..nodes.len() {
        let (a, b) = (baked.node(node)[0], full.node(found.index_of(node) as usize)[0]);
        // Neighbours that tell each other what they see are others: the same light but for noise.
        let error = baked.relative_error[node] + full.relative_error[found.index_of(node) as usize];
        assert!((a - b).abs() < 4.0 * error * b, "{node}: {a} {b}, {error}");
    }
}

#[test]
fn solids_stay_coarse_and_their_surfaces_and_gaps_do_not() {
    let mut scene = Scene::default();
    // A great block, with a corridor through it that is narrower than two places of the grid.
    add(&mut scene, Role::Environment, &solid_of(DVec3::new(4.6, 0.0, 4.0), DVec3::new(12.4, 16.0, 8.7)));
    add(&mut scene, Role::Environment, &solid_of(DVec3::new(4.6, 0.0, 9.3), DVec3::new(12.4, 16.0, 14.0)));
    let sky = distant(panorama(8, |_| [1.0; 3]));
    let function = Path::new(&scene, Some(&sky), PathSettings { bounces: Some(1), ..PathSettings::default() });
    let grid = grid_of_counts(DVec3::splat(0.01), DVec3::splat(15.99), [17; 3]);
    let (nodes, _, _) = sparse(grid, 0.2, &function);
    let Nodes::Sparse(found) = &nodes else { panic!("{}", nodes.len()) };
    let is_node = |place: [u32; 3]| found.bricks.node_at(place).is_some();
    assert!(!is_node([7, 7, 6]) && !is_node([9, 9, 11]), "in the solids");
    assert!(is_node([7, 7, 9]), "in the corridor");
    assert!(is_node([5, 7, 6]) && is_node([5, 7, 7]), "at the surface");
}

#[test]
fn counts_grow_until_coarse_cells_fit() {
    let grid = |counts| Grid { min: [0.0; 3], max: [1.0; 3], counts };
    assert_eq!(grid_of_cells(grid([32, 9, 30])).counts, [33, 9, 33]);
    assert_eq!(grid_of_cells(grid([33, 1, 30])).counts, [33, 1, 33]);
    // 5 cells become 6, not 8.
    assert_eq!(grid_of_cells(grid([33, 6, 33])).counts, [33, 7, 33]);
    assert_eq!(grid_of_cells(grid([33, 2, 33])).counts, [33, 2, 33]);
    assert_eq!(grid_of_cells(grid([1; 3])).counts, [1; 3]);
}
