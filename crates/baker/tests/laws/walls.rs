//! Where nodes stand, and walls between them.

use gdibl_baker::Control;
use gdibl_baker::bake::{BakeSettings, Baked, Nodes, Standing, bake};
use gdibl_baker::pack::volume_of;
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::radiance::gdibl::Probe;
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::scene::{Role, Scene};
use gdibl_runtime::{Grid, Volume};
use glam::{DVec3, Vec3};
use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

use crate::level::{add, box_of, distant, gdibl, panorama, probe, single, solid_of};

pub fn bake_grid(grid: Grid, function: &impl RadianceFunction) -> (Baked, Volume) {
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    let nodes = Nodes::Grid(grid);
    let settings = BakeSettings { samples: 256, ..BakeSettings::default() };
    let baked = bake(&nodes, function, &settings, &control).expect("nobody interrupts");
    let volume = volume_of(&nodes, &baked);
    (baked, volume)
}

/// A bright room at x < 0, and a black one behind a wall.
pub fn two_rooms(wall: f64) -> (Scene, [Probe; 2]) {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::new(-3.0, -1.5, -2.0), DVec3::new(0.0, 1.5, 2.0)));
    add(&mut scene, Role::Environment, &box_of(DVec3::new(wall, -1.5, -2.0), DVec3::new(3.0, 1.5, 2.0)));
    (scene, [single([-1.0, 0.1, 0.2], 16, [1.0; 3]), single([1.0, -0.1, 0.3], 16, [0.0; 3])])
}

/// Least and greatest E over π in planes of constant x, over the whole height and width of the rooms, with every normal.
pub fn range(volume: &Volume, planes: &[f64]) -> (f64, f64) {
    let mut range = (f64::INFINITY, f64::NEG_INFINITY);
    for x in planes {
        for [y, z] in (0..=8).flat_map(|i| (0..=8).map(move |k| [i, k])) {
            let place = [*x, -1.5 + 0.375 * f64::from(y), -2.0 + 0.5 * f64::from(z)];
            for normal in [Vec3::X, -Vec3::X, Vec3::Y, -Vec3::Z, Vec3::new(-0.6, 0.8, 0.0)] {
                let sh = volume.sample_f64(place, normal.to_array()).sh;
                let e = f64::from(sh.convolve().evaluate(normal.to_array())[1]) / PI;
                range = (range.0.min(e), range.1.max(e));
            }
        }
    }
    range
}

#[test]
fn light_stays_in_its_room_however_thin_the_wall() {
    // The wall between nodes, off the middle of their cells; and nodes exactly in its bright face, in it, in its dark face.
    for (wall, first) in
        [(1e-3, -2.85), (1e-2, -2.7), (0.1, -2.6), (1e-3, -2.5), (1e-3, -2.4995), (0.1, -2.45), (0.1, -2.4)]
    {
        let (scene, probes) = two_rooms(wall);
        let grid = Grid { min: [first, -1.25, -1.75], max: [first + 5.5, 1.25, 1.75], counts: [12, 6, 8] };
        let (baked, volume) = bake_grid(grid, &gdibl(&scene, &probes, None));
        assert!(baked.is_all_valid(), "{wall} {first}: {:?}", baked.standing);
        assert!(volume.walled_cells() > 0);
        let (_, dark) = range(&volume, &[wall, wall + 1e-4, wall + 0.01, 0.3, 0.55, 2.0]);
        assert!(dark <= 1e-3, "{wall} {first}: {dark} in the dark room");
        let (bright, _) = range(&volume, &[-2.0, -0.6, -0.3, -0.01, -1e-4, 0.0]);
        assert!(bright >= 0.98, "{wall} {first}: {bright} in the bright room");
    }
}

#[test]
fn sheet_without_thickness_parts_light_too() {
    // A square in the middle of a room, seen from both sides: only what faces it tells the side in its plane.
    let sheet = |double_sided: bool| {
        let mut scene = Scene::default();
        add(&mut scene, Role::Environment, &box_of(DVec3::new(-3.0, -1.5, -2.0), DVec3::new(3.0, 1.5, 2.0)));
        let [a, b, c, d] = [[-1.5, -2.0], [1.5, -2.0], [1.5, 2.0], [-1.5, 2.0]].map(|[y, z]| DVec3::new(0.0, y, z));
        add(&mut scene, Role::Environment, &[[a, b, c], [a, c, d]]);
        scene.materials.iter_mut().for_each(|material| material.double_sided = double_sided);
        scene
    };
    let probes = [single([-1.0, 0.1, 0.2], 16, [1.0; 3]), single([1.0, -0.1, 0.3], 16, [0.0; 3])];
    let scene = sheet(true);
    let grid = Grid { min: [-2.75, -1.25, -1.75], max: [2.75, 1.25, 1.75], counts: [12, 6, 8] };
    let (baked, volume) = bake_grid(grid, &gdibl(&scene, &probes, None));
    assert!(baked.is_all_valid());
    let (_, dark) = range(&volume, &[0.01, 0.3, 2.0]);
    let (bright, _) = range(&volume, &[-0.01, -0.3, -2.0]);
    assert!(dark <= 1e-3 && bright >= 0.98, "{dark} {bright}");
    for (normal, truth) in [(Vec3::X, 0.0), (-Vec3::X, 1.0)] {
        let e = volume.irradiance([0.0, 0.1, 0.1], normal.to_array())[0] / std::f32::consts::PI;
        assert!((e - truth).abs() <= 0.02, "{normal}: {e}");
    }
    // Of one side, whoever stands close behind it looks at backs, and has no light.
    let scene = sheet(false);
    let (baked, _) = bake_grid(grid, &gdibl(&scene, &probes, None));
    let row = |x: usize| baked.standing[x + 12 * (2 + 6 * 4)];
    assert_eq!([4, 5].map(row), [Standing::Solid; 2]);
    assert!((6..12).all(|x| row(x) == Standing::Open));
}

#[test]
fn level_without_walls_between_nodes_has_no_section_for_them() {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::new(-3.0, -1.5, -2.0), DVec3::new(3.0, 1.5, 2.0)));
    let probes = [single([-1.0, 0.1, 0.2], 16, [1.0; 3])];
    let grid = Grid { min: [-3.0, -1.5, -2.0], max: [3.0, 1.5, 2.0], counts: [7, 4, 5] };
    let (baked, volume) = bake_grid(grid, &gdibl(&scene, &probes, None));
    assert!(baked.is_all_valid());
    assert_eq!((baked.walls, volume.walled_cells()), (None, 0));
    // A pillar that is lit as the rest changes nothing either.
    add(&mut scene, Role::Environment, &solid_of(DVec3::new(0.2, -1.5, 0.3), DVec3::new(0.7, 1.5, 0.8)));
    let (baked, _) = bake_grid(grid, &gdibl(&scene, &probes, None));
    assert_eq!(baked.walls, None);
}

#[test]
fn node_in_a_solid_steps_out_or_is_left_out() {
    // A solid of half a metre whose middle holds a node, and one so large that some nodes cannot leave it.
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::splat(-3.0), DVec3::splat(3.0)));
    add(&mut scene, Role::Environment, &solid_of(DVec3::new(-1.2, -0.2, -0.3), DVec3::new(-0.8, 0.3, 0.2)));
    add(&mut scene, Role::Environment, &solid_of(DVec3::splat(0.7), DVec3::splat(2.6)));
    let sky = distant(panorama(16, |_| [1.0; 3]));
    let grid = Grid { min: [-2.0; 3], max: [2.0; 3], counts: [5; 3] };
    for double_sided in [false, true] {
        for material in &mut scene.materials {
            material.double_sided = double_sided;
            material.emission = Vec3::ZERO;
        }
        // A lamp in the room, for the light of path tracing.
        let mut lit = scene.clone();
        let lamp = lit.materials.len() as u32;
        lit.materials.push(gdibl_baker::scene::Material { emission: Vec3::splat(9.0), ..lit.materials[0].clone() });
        add(&mut lit, Role::Environment, &solid_of(DVec3::new(-2.9, 2.5, -2.9), DVec3::new(0.5, 2.9, 2.0)));
        lit.meshes.last_mut().unwrap().material = lamp;
        let function = Path::new(&lit, Some(&sky), PathSettings { bounces: Some(4), ..PathSettings::default() });
        let (baked, _) = bake_grid(grid, &function);
        let node = |x: usize, y: usize, z: usize| x + 5 * (y + 5 * z);
        // In the middle of the small solid, x = -1, y = 0, z = 0.
        let small = node(1, 2, 2);
        assert_eq!(baked.standing[small], Standing::Open, "double-sided {double_sided}");
        let moved = baked.moved.iter().find(|(moved, _)| *moved as usize == small).expect("it stepped out").1;
        assert!((moved - DVec3::new(-1.0, 0.0, 0.0)).abs().max_element() <= 0.5, "{moved}");
        let inside =
            |p: DVec3| p.cmpgt(DVec3::new(-1.2, -0.2, -0.3)).all() && p.cmplt(DVec3::new(-0.8, 0.3, 0.2)).all();
        assert!(!inside(moved), "{moved}");
        // The large one: its innermost node, 1.6 m from its surface but for three sides of 0.3 and 0.6 m.
        assert_eq!(baked.standing[node(4, 4, 4)], Standing::Solid, "double-sided {double_sided}");
        assert!(baked.sh.to_vec().iter().all(|value| value.is_finite()));
        for (moved, place) in &baked.moved {
            assert!(baked.is_valid(*moved as usize), "{moved} at {place}");
        }
    }
}

#[test]
fn no_valid_node_sees_backs_in_more_than_a_quarter_of_its_view() {
    // Solids at odd places in a room, and a floor that stands over nodes beneath it.
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::splat(-3.0), DVec3::splat(3.0)));
    for i in 0..12 {
        let t = f64::from(i);
        let middle = DVec3::new((t * 1.7).sin(), (t * 2.3).sin(), (t * 0.9).cos()) * 2.3;
        let half = DVec3::new(0.1 + 0.07 * t, 0.8 - 0.04 * t, 0.5);
        add(&mut scene, Role::Environment, &solid_of(middle - half, middle + half));
    }
    let probes = [probe(DVec3::new(0.2, 0.1, -0.1), 16, |d| [1.0 + d.x, 1.0, 1.0])];
    let function = gdibl(&scene, &probes, None);
    let grid = Grid { min: [-3.5; 3], max: [3.5; 3], counts: [11; 3] };
    let (baked, _) = bake_grid(grid, &function);
    let place = |node: usize| match baked.moved.binary_search_by_key(&(node as u32), |moved| moved.0) {
        Ok(found) => baked.moved[found].1,
        Err(_) => grid.node_position(node).into(),
    };
    let directions = gdibl_baker::sampling::fibonacci_sphere(1500);
    let mut valid = 0;
    for node in baked.valid_nodes() {
        let origin = function.frame().to_trace(place(node));
        let met = directions.iter().filter_map(|d| function.level().meet(origin, *d, f32::INFINITY));
        let backs = met.filter(|met| met.back).count();
        assert!(backs as f64 <= 0.25 * 1500.0 + 8.0, "node {node}: {backs} of 1500");
        valid += 1;
    }
    assert!((300..900).contains(&valid), "{valid} of 1331");
    let count = |of: Standing| baked.standing.iter().filter(|standing| **standing == of).count();
    let counts = (count(Standing::Solid), count(Standing::Outside), baked.moved.len());
    assert!(counts.0 > 0 && counts.1 > 300 && counts.2 > 5, "{counts:?}");
}

#[test]
fn fill_goes_evenly_from_light_to_light() {
    // Between a bright room and a black one a wall of a metre, with two layers of nodes in it that cannot leave it.
    let (scene, probes) = two_rooms(1.0);
    let grid = Grid { min: [-1.98, -1.25, -1.75], max: [2.97, 1.25, 1.75], counts: [16, 6, 8] };
    let (baked, _) = bake_grid(grid, &gdibl(&scene, &probes, None));
    let row = |x: usize| x + 16 * (3 + 6 * 4);
    let light = |x: usize| f64::from(baked.node(row(x))[0]) / (4.0 * PI).sqrt();
    let place = |x: usize| grid.node_position(row(x))[0];
    let inside: Vec<usize> = (0..16).filter(|x| !baked.is_valid(row(*x))).collect();
    assert!(inside.len() == 2 && inside.iter().all(|x| (0.0..1.0).contains(&place(*x))), "{inside:?}");
    // From one room's light to the other's, evenly.
    let [a, b] = [inside[0], inside[1]].map(light);
    assert!((a - 2.0 / 3.0).abs() < 0.01 && (b - 1.0 / 3.0).abs() < 0.01, "{a} {b}");
}

#[test]
fn same_light_and_walls_on_any_number_of_threads() {
    let (scene, probes) = two_rooms(0.1);
    let grid = Grid { min: [-2.6, -1.25, -1.75], max: [2.9, 1.25, 1.75], counts: [12, 6, 8] };
    let bake_on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bake_grid(grid, &gdibl(&scene, &probes, None)).0)
    };
    let one = bake_on(1);
    assert!(one.walls.is_some());
    assert_eq!(bake_on(3), one);
}
