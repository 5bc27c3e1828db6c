//! Nodes and probes in bad places, and light behind walls.

use crate::level::*;
use crate::shared::*;
use crate::table::Table;
use gdibl_baker::bake::{BakeSettings, Baked, Nodes};
use gdibl_baker::job::records::Records;
use gdibl_baker::pack::{PackSettings, Precision, pack};
use gdibl_baker::scene::{Role, Scene};
use gdibl_runtime::grid::Grid;
use gdibl_runtime::{RadianceSh, Volume};
use gdibl_tools::bake_all;
use glam::{DVec3, Vec3};
use std::f64::consts::PI;

pub fn rows(table: &mut Table) {
    nodes_and_probes_in_bad_places(table);
    probe_at_a_wall(table);
    two_rooms(table);
    bright_beside_dark(table);
}

fn nodes_and_probes_in_bad_places(table: &mut Table) {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::splat(-2.0), DVec3::splat(2.0)));
    add(&mut scene, Role::Environment, &solid_of(DVec3::new(-1.5, -1.5, -1.5), DVec3::new(-0.5, -0.5, -0.5)));
    let white = |p: [f64; 3]| probe(p.into(), 16, |_| [1.0; 3]);
    let good = white([0.5, 0.5, 0.5]);
    let places = [
        ("on a wall", [2.0, 0.0, 0.0]),
        ("on an edge", [2.0, 2.0, 0.0]),
        ("in a corner", [2.0, 2.0, 2.0]),
        ("on a solid", [-0.5, -1.0, -1.0]),
        ("exactly at the probe", [0.5, 0.5, 0.5]),
        ("inside a solid", [-1.0, -1.0, -1.1]),
    ];
    let points = places.map(|(_, p)| DVec3::from(p));
    let probes = [good.clone()];
    let baked = bake_points(&gdibl(&scene, &probes, None), &points, &USUAL);
    for (node, (place, _)) in places.iter().enumerate() {
        let off = off_the_furnace(&sh_of(&baked, node), [1.0; 3]);
        let solid = *place == "inside a solid";
        let state = if baked.is_valid(node) { "valid" } else { "invalid, filled" };
        let must = if solid { "invalid, and filled with E = πL within 1e-3" } else { "valid; E = πL within 1e-3" };
        let holds = off <= 1e-3 && baked.is_valid(node) != solid;
        table.row(
            &format!("node {place}"),
            must,
            &format!("{state}; {off:.1e}, coverage {:.3}", baked.coverage[node]),
            holds,
        );
    }
    for (place, position) in
        [("on a wall", [0.0, 0.0, 2.0]), ("in a corner", [2.0, 2.0, 2.0]), ("inside a solid", [-1.0, -1.0, -0.9])]
    {
        let mut other = white(position);
        let with = [good.clone(), other.clone()];
        let both = bake_points(&gdibl(&scene, &with, None), &[DVec3::new(1.0, 0.0, 0.3)], &USUAL);
        let off = off_the_furnace(&sh_of(&both, 0), [1.0; 3]);
        // Alone, with light that would show where it does not belong.
        other.panorama = other.panorama.with_pixels(|_, _| [7.0; 3]);
        let alone = [other];
        let baked = bake_points(&gdibl(&scene, &alone, None), &[DVec3::new(1.0, 0.0, 0.3)], &USUAL);
        let lit = off_the_furnace(&sh_of(&baked, 0), [7.0; 3]);
        let holds = if baked.is_valid(0) { lit <= 1e-3 } else { place == "inside a solid" };
        table.row(
            &format!("probe {place}"),
            "beside another one E = πL within 1e-3; alone the node is valid, with the share it has seen as coverage, or invalid",
            &format!(
                "{off:.1e}; alone {}, coverage {:.3}",
                if baked.is_valid(0) { format!("valid, {lit:.1e}") } else { "invalid".into() },
                baked.coverage[0]
            ),
            off <= 1e-3 && holds,
        );
    }
}

fn two_rooms(table: &mut Table) {
    for wall in [1e-3, 1e-2, 0.1] {
        let mut scene = Scene::default();
        add(&mut scene, Role::Environment, &box_of(DVec3::new(-4.0, -1.5, -2.0), DVec3::new(0.0, 1.5, 2.0)));
        add(&mut scene, Role::Environment, &box_of(DVec3::new(wall, -1.5, -2.0), DVec3::new(4.0, 1.5, 2.0)));
        let probes =
            [probe(DVec3::new(-1.0, 0.1, 0.2), 16, |_| [1.0; 3]), probe(DVec3::new(1.0, -0.1, 0.3), 16, |_| [0.0; 3])];
        let function = gdibl(&scene, &probes, None);
        let mut points = Vec::new();
        for x in [wall + 1e-4, wall + 1e-3, wall + 0.02, 0.5, 3.999] {
            points.extend([[0.0, 0.0], [1.49, 1.99], [-1.4999, 0.5]].map(|[y, z]| DVec3::new(x, y, z)));
        }
        let baked = bake_points(&function, &points, &USUAL);
        let brightest = (0..points.len()).map(|node| strength(&sh_of(&baked, node))).fold(0.0, f64::max) / PI;
        let valid = baked.is_all_valid();
        table.row(
            &format!("dark room behind a wall of {wall} m: its nodes"),
            "valid, E ≤ 1e-3 of the bright room's",
            &format!("{brightest:.1e} of the bright room's"),
            valid && brightest <= 1e-3,
        );
        // A grid over both rooms, with nodes 0.5 m apart; read on both sides of the wall, on it, and facing either way.
        let grid = Grid { min: [-3.75, -1.25, -1.75], max: [3.75, 1.25, 1.75], counts: [16, 6, 8] };
        let volume = volume_of(&Nodes::Grid(grid), &function, &USUAL);
        let light = |x: f64, read: &dyn Fn([f64; 3], [f32; 3]) -> RadianceSh| {
            let place = |i: usize| [x, -1.5 + 3.0 * (i % 7) as f64 / 6.0, -2.0 + 4.0 * (i / 7) as f64 / 6.0];
            let normals = [Vec3::X, -Vec3::X, Vec3::Y, Vec3::new(0.0, -0.6, 0.8)];
            let all = (0..49).flat_map(move |i| normals.map(|n| (place(i), n.to_array())));
            let light = all.map(|(place, normal)| f64::from(read(place, normal).convolve().evaluate(normal)[1]) / PI);
            light.fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), e| (min.min(e), max.max(e)))
        };
        let sampled = |place: [f64; 3], normal: [f32; 3]| volume.sample_f64(place, normal).sh;
        let plain = |place: [f64; 3], _: [f32; 3]| {
            let cell = grid.locate(place);
            let mut sum = RadianceSh::zero(volume.header().bands);
            for (node, weight) in cell.nodes.iter().zip(cell.weights) {
                let node = volume.node_sh(*node as usize);
                let values = sum.coefficients.as_flattened_mut().iter_mut().zip(node.coefficients.as_flattened());
                values.for_each(|(sum, value)| *sum += weight * value);
            }
            sum
        };
        let away = [0.0, 1e-4, 1e-3, 0.02, 0.1, 0.25, 0.4, 0.6, 2.0];
        let dark = |read| away.iter().map(|d| light(wall + d, read).1).fold(0.0, f64::max);
        let bright = |read| away.iter().map(|d| light(-d, read).0).fold(1.0, f64::min);
        let (lit, shaded) = (dark(&sampled), 1.0 - bright(&sampled));
        table.row(
            &format!("two rooms, a wall of {wall} m between: the runtime's samples beside it, grid of 0.5 m over both"),
            "dark room: E ≤ 1e-3 of the bright one's; bright room: ≤ 2 % too dark",
            &format!(
                "{lit:.1e}, {:.2} % too dark; plain trilinear {:.2}, {:.0} %",
                shaded * 100.0,
                dark(&plain),
                100.0 - 100.0 * bright(&plain)
            ),
            lit <= 1e-3 && shaded <= 0.02,
        );
    }
}

fn probe_at_a_wall(table: &mut Table) {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::splat(-2.0), DVec3::splat(2.0)));
    let point = [DVec3::new(1.0, 0.2, 0.3), DVec3::new(-1.5, 1.0, -1.9)];
    // Light of 1 from all walls but the one behind the probe: before it by 1 mm it sees that one at grazing angles.
    let bake = |z: f64| {
        let probes = [probe(DVec3::new(0.1, 0.2, z), 64, |d| [1.0 + 0.5 * d.x; 3])];
        bake_points(&gdibl(&scene, &probes, None), &point, &USUAL)
    };
    let [on, before] = [2.0, 1.999].map(bake);
    let change = error_of(&on, |node| sh_of(&before, node)).relative_rmse;
    let coverage = |baked: &Baked| baked.coverage.iter().copied().fold(1.0, f32::min);
    table.row(
        "a probe on a wall, and 1 mm before it",
        "both: nodes valid; the wall behind it seen from 1 mm before it; the same light within 3 %",
        &format!("coverage ≥ {:.3} and ≥ {:.3}; E differs by {}", coverage(&on), coverage(&before), percent(change)),
        on.is_all_valid() && before.is_all_valid() && coverage(&before) > 0.999 && change <= 0.03,
    );
}

fn bright_beside_dark(table: &mut Table) {
    const LIGHT: [f32; 2] = [1e9, 1e-6];
    let wall = 0.1;
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::new(-4.0, -1.5, -2.0), DVec3::new(0.0, 1.5, 2.0)));
    add(&mut scene, Role::Environment, &box_of(DVec3::new(wall, -1.5, -2.0), DVec3::new(4.0, 1.5, 2.0)));
    let at = [DVec3::new(-1.0, 0.1, 0.2), DVec3::new(1.0, -0.1, 0.3)];
    let probes = [0, 1].map(|room| probe(at[room], 16, |_| [LIGHT[room]; 3]));
    let grid = Grid { min: [-3.75, -1.25, -1.75], max: [3.75, 1.25, 1.75], counts: [16, 6, 8] };
    let nodes = Nodes::Grid(grid);
    let baked = bake_all(&gdibl(&scene, &probes, None), &nodes, &BakeSettings { samples: 512, ..SMALL });
    for (precision, bound) in [(Precision::Packed { error: Some(0.005) }, 0.01), (Precision::F32, 1e-4)] {
        let packed = pack(&nodes, &baked, Records::default(), PackSettings { precision, ..Default::default() });
        let volume = Volume::parse(&packed.bytes).expect("what was packed parses");
        let off = |room: usize| {
            let side = if room == 0 { -1.0 } else { 1.0 };
            let places = (0..60).map(|i| [side * (0.2 + 0.06 * f64::from(i)), 0.4, 0.2 - 0.03 * f64::from(i)]);
            let reads = places.map(|place| volume.sample_f64(place, [0.0, 1.0, 0.0]).sh);
            reads.map(|sh| off_the_furnace(&sh, [LIGHT[room]; 3])).fold(0.0, f64::max)
        };
        let [bright, dark] = [0, 1].map(off);
        table.row(
            &format!(
                "rooms of light 1e9 and 1e-6 in one volume, a wall of 10 cm between, read by the runtime; {precision}"
            ),
            &format!("E = πL of each room's own light within {bound}"),
            &format!("bright {bright:.1e}, dark {dark:.1e}"),
            bright <= bound && dark <= bound,
        );
    }
}
