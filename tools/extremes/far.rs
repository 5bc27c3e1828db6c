//! Sizes far apart in one level: planes of 20 km, an aisle 1000 times as long as wide, a dolls' house in a city; grids that are lines.

use crate::level::*;
use crate::shared::*;
use crate::table::Table;
use gdibl_baker::bake::{BakeSettings, Nodes, grid_of_counts};
use gdibl_baker::job::{Inputs, Job, Memory, Settings, Watch};
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::scene::{Role, Scene};
use gdibl_runtime::RadianceSh;
use glam::DVec3;
use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

pub fn rows(table: &mut Table) {
    wide_plane(table);
    wide_plane_by_default(table);
    aisle(table);
    lines_of_nodes(table);
    dolls_house(table);
}

/// A ground of 20 by 20 km with albedo 1/2.
fn ground() -> Scene {
    let mut scene = Scene::default();
    let [a, b, c, d] = [[-1e4, -1e4], [-1e4, 1e4], [1e4, 1e4], [1e4, -1e4]].map(|[x, z]| DVec3::new(x, 0.0, z));
    add_of(&mut scene, &[[a, b, c], [a, c, d]], 0.5, 0.0);
    scene
}

/// Light of 1 from above and of 1/2 from below: E(n) = π (3 + n_y)/4, which L2 tells exactly.
fn above_ground() -> RadianceSh {
    let mut light = RadianceSh::zero(2);
    light.coefficients[0] = [(0.75 * (4.0 * PI).sqrt()) as f32; 3];
    // ∫ Y_1y over a hemisphere is √(3/4π) π, and (1 - 1/2) of it is left.
    light.coefficients[1] = [(0.5 * PI * (3.0 / (4.0 * PI)).sqrt()) as f32; 3];
    light
}

fn wide_plane(table: &mut Table) {
    let (scene, truth) = (ground(), above_ground());
    let sky = distant(panorama(16, |_| [1.0; 3]));
    let points = [[0.0, 1e-3], [0.0, 1.0], [5e3, 1.7], [-8e3, 1e-2], [9.9e3, 0.3]].map(|[x, y]| DVec3::new(x, y, 0.1));
    let path = Path::new(&scene, Some(&sky), PathSettings::default());
    let baked = bake_points(&path, &points, &USUAL);
    let error = error_of(&baked, |_| truth);
    table.row(
        "plane of 20 × 20 km, albedo 1/2, under a white sky; nodes 1 mm to 1.7 m over it, to 9.9 km from its middle",
        "path tracing: valid; every node's E within 1 %",
        &format!("{} of 5 valid; worst node {}", baked.valid_nodes().count(), percent(error.per_node.max)),
        baked.is_all_valid() && error.per_node.max <= 0.01,
    );
    // A probe of 512 × 256 pixels; half a pixel above and below the horizon mixes ground and sky.
    let probes = [probe(DVec3::new(0.0, 1.7, 0.0), 512, |d| [if d.y > 0.0 { 1.0 } else { 0.5 }; 3])];
    let points = [[0.0, 0.1], [3.0, 1.0], [20.0, 1.7], [100.0, 1.7]].map(|[x, y]| DVec3::new(x, y, 0.1));
    let baked = bake_points(&gdibl(&scene, &probes, Some(&sky)), &points, &USUAL);
    let error = error_of(&baked, |_| truth);
    table.row(
        "the same, by one probe 1.7 m over it; nodes to 100 m from the probe",
        "valid; every node's E within 1 %",
        &format!("{} of 4 valid; worst node {}", baked.valid_nodes().count(), percent(error.per_node.max)),
        baked.is_all_valid() && error.per_node.max <= 0.01,
    );
}

fn wide_plane_by_default(table: &mut Table) {
    let mut scene = ground();
    add_of(&mut scene, &solid_of(DVec3::new(-4.0, 0.0, -3.0), DVec3::new(4.0, 5.0, 3.0)), 0.5, 0.0);
    let inputs = Inputs { distant: Some(distant(panorama(16, |_| [1.0; 3]))), ..Inputs::new(scene) };
    let mut settings = Settings::default();
    settings.quality.samples = Some(256);
    let job = Job::prepare(inputs, settings, Memory::UNBOUNDED).unwrap_or_else(|stop| panic!("{stop}"));
    let made = job.run(&Watch::silent(&AtomicBool::new(false))).unwrap_or_else(|stop| panic!("{stop}"));
    let nodes = made.nodes.len();
    let seen = made.records.statistics.as_ref().and_then(|statistics| statistics.seen);
    let far = seen.and_then(|seen| seen.surfaces).map_or(f64::NAN, |set| set.error.median);
    table.row(
        "a house of 8 m on a plane of 20 km, default nodes, 256 directions",
        "ends; ≤ 8192 nodes; the error between nodes is told",
        &format!("{nodes} nodes; on surfaces E is said to be off by {} at the median", percent(far)),
        nodes <= 8192 && far.is_finite(),
    );
}

fn aisle(table: &mut Table) {
    // 2 m wide, 3 m high, 2 km long; every wall sends out 1/2 and reflects 1/2: light of 1 everywhere.
    let mut scene = Scene::default();
    add_of(&mut scene, &box_of(DVec3::ZERO, DVec3::new(2.0, 3.0, 2000.0)), 0.5, 0.5);
    let points = [0.01, 1.0, 250.0, 1000.3, 1990.0, 1999.99].map(|z| DVec3::new(0.7, 1.2, z));
    let baked = bake_points(&Path::new(&scene, None, PathSettings::default()), &points, &USUAL);
    noisy_furnace_row(table, "furnace 2 m wide, 3 m high and 2 km long; path tracing", &baked, 0.03);
    let probes = [probe(DVec3::new(1.0, 1.5, 1000.0), 256, |_| [1.0; 3])];
    let function = gdibl(&scene, &probes, None);
    let baked = bake_points(&function, &points, &USUAL);
    let off = (0..points.len()).map(|node| off_the_furnace(&sh_of(&baked, node), [1.0; 3])).fold(0.0, f64::max);
    let least = baked.coverage.iter().copied().fold(1.0, f32::min);
    table.row(
        "the same, by one probe in its middle",
        "valid, covered; E = πL within 1e-4",
        &format!("{} of 6 valid, coverage ≥ {least:.4}; {off:.1e}", baked.valid_nodes().count()),
        baked.is_all_valid() && off <= 1e-4 && least > 0.99,
    );
    let grid = grid_of_counts(DVec3::new(0.5, 0.5, 0.5), DVec3::new(1.5, 2.5, 1999.5), [2, 2, 500]);
    let volume = volume_of(&Nodes::Grid(grid), &function, &BakeSettings { samples: 256, ..SMALL });
    let reads = (0..2000).map(|i| [1.9, 2.9, f64::from(i) + 0.37]);
    let off = reads.map(|place| off_the_furnace(&volume.sample_f64(place, [0.0, 1.0, 0.0]).sh, [1.0; 3]));
    table.at_most(
        "the same, read by the runtime each metre, 2 × 2 × 500 nodes",
        "E = πL: relative error",
        1e-4,
        off.fold(0.0, f64::max),
    );
}

fn lines_of_nodes(table: &mut Table) {
    let mut scene = Scene::default();
    let [min, max] = [DVec3::new(-3.0, -1.0, -2.0), DVec3::new(3.0, 2.0, 2.5)];
    add(&mut scene, Role::Environment, &box_of(min, max));
    let probes = coloured_probes();
    let function = gdibl(&scene, &probes, None);
    let (mut at_nodes, mut between, mut beside) = (0.0f64, 0.0f64, 0.0f64);
    for axis in 0..3 {
        let mut counts = [1; 3];
        counts[axis] = 9;
        let grid = grid_of_counts(min + DVec3::splat(0.3), max - DVec3::splat(0.3), counts);
        let volume = volume_of(&Nodes::Grid(grid), &function, &SMALL);
        let place = |node: f64, off: f64| {
            let mut place = DVec3::from(grid.min).lerp(grid.max.into(), 0.5);
            place[axis] = grid.min[axis] + (grid.max[axis] - grid.min[axis]) * node / 8.0;
            place[(axis + 1) % 3] += off;
            place.to_array()
        };
        for node in 0..8 {
            let [here, next] = [node, node + 1].map(|node| volume.node_sh(node));
            let mut middle = RadianceSh::zero(2);
            [here, next].iter().for_each(|sh| middle.add_scaled(sh, 0.5));
            let read = |node: f64, off: f64| volume.sample_f64(place(node, off), [0.6, 0.0, 0.8]).sh;
            let change = |found: RadianceSh, expected: &RadianceSh| {
                difference(found.coefficients.as_flattened(), expected.coefficients.as_flattened())
            };
            at_nodes = at_nodes.max(change(read(node as f64, 0.0), &here));
            between = between.max(change(read(node as f64 + 0.5, 0.0), &middle));
            beside = beside.max(change(read(node as f64 + 0.5, 0.7), &middle));
        }
    }
    table.row(
        "counts 9,1,1, 1,9,1 and 1,1,9",
        "at nodes, midway and 0.7 m beside the line: the nodes' light, linear along it, constant across, within 1e-5",
        &format!("{at_nodes:.1e}, {between:.1e}, {beside:.1e}"),
        at_nodes.max(between).max(beside) <= 1e-5,
    );
}

/// Closed rooms, one in the other, each with light of its own.
fn dolls_house(table: &mut Table) {
    // The edge of a room, and where it is: a box of 1 mm in a dolls' house of 1 m in a house of 10 m in a city of 100 km.
    let edges = [1e-3, 1.0, 10.0, 1e5];
    let radiance = [8.0f32, 4.0, 2.0, 1.0];
    let measure = |away: f64| {
        let middle = |room: usize| if room == 3 { DVec3::ZERO } else { DVec3::new(away, 0.3, -away) };
        let mut scene = Scene::default();
        for (room, edge) in edges.into_iter().enumerate() {
            let half = DVec3::splat(0.5 * edge);
            add(&mut scene, Role::Environment, &box_of(middle(room) - half, middle(room) + half));
            if room < 3 {
                // The outside of its walls.
                let half = half * 1.2;
                add(&mut scene, Role::Environment, &solid_of(middle(room) - half, middle(room) + half));
            }
        }
        // Beside the room within.
        let place = |room: usize, share: f64| middle(room) + DVec3::new(0.42, 0.3, -0.1) * edges[room] * share;
        let rooms = [0, 1, 2, 3];
        let probes = rooms.map(|room| probe(place(room, 0.8), 32, |_| [radiance[room]; 3]));
        let points = rooms.map(|room| place(room, 1.0));
        let baked = bake_points(&gdibl(&scene, &probes, None), &points, &USUAL);
        let off = rooms.map(|room| off_the_furnace(&sh_of(&baked, room), [radiance[room]; 3]));
        let told = rooms.map(|room| if baked.is_valid(room) { format!("{:.1e}", off[room]) } else { "invalid".into() });
        let right = (0..4).filter(|room| baked.is_valid(*room) && off[*room] <= 1e-3).count();
        (told.join(", "), right)
    };
    for away in [0.0, 10.0] {
        let (told, right) = measure(away);
        table.row(
            &format!("closed rooms of 1 mm, 1 m, 10 m, 100 km in one file, the small ones {away} m from its middle"),
            "each room's node valid, E = πL of its own light within 1e-3",
            &told,
            right == 4,
        );
    }
    // Rays are single floats from the level's middle on: 100 m away they are 8 µm apart, and rays leave surfaces by 8 steps more; 40 km
    // away they are 4 mm apart. So a room of 1 mm is lost at 100 m and one of 1 m at 40 km: they would need 2^24 times finer numbers than
    // the level is large, and have a file of their own. Rooms a hundred times as large as the steps must hold all the same.
    for (away, lost) in [(100.0, 1), (4e4, 2)] {
        let (told, right) = measure(away);
        table.row(
            &format!("the same, {away:.0} m from its middle, where single floats are {:.0e} m apart", away * 7.6e-8),
            &format!("all but the smallest {lost} right; of those nothing can be asked of single floats"),
            &told,
            right >= 4 - lost,
        );
    }
}
