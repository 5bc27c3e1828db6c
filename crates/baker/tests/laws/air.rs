//! The default box of a grid: where people can be, whatever stands around it.

use gdibl_baker::air::Air;
use gdibl_baker::bake::{Baked, Nodes};
use gdibl_baker::job::{Inputs, Job, Memory, NodeKind, Settings, Watch};
use gdibl_baker::scene::{Material, Role, Scene, VolumeMarker};
use glam::{DMat3, DQuat, DVec3, Vec3, Vec4};
use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::atomic::AtomicBool;

use crate::level::{Placement, Triangle, add, box_of, solid_of};

type Bounds = (DVec3, DVec3);

fn scene_of(meshes: &[Vec<Triangle>]) -> Scene {
    let mut scene = Scene::default();
    for triangles in meshes {
        add(&mut scene, Role::Environment, triangles);
        scene.meshes.last_mut().unwrap().mesh = scene.meshes.len() as u32 - 1;
    }
    scene
}

fn air(meshes: &[Vec<Triangle>]) -> Air {
    Air::of(&scene_of(meshes)).expect("triangles")
}

/// 6 x 3 x 6 m, seen from within.
fn room() -> Vec<Triangle> {
    box_of(DVec3::new(-3.0, 0.0, -2.0), DVec3::new(3.0, 3.0, 4.0))
}

fn room_bounds() -> Bounds {
    (DVec3::new(-3.0, 0.0, -2.0), DVec3::new(3.0, 3.0, 4.0))
}

/// `n` x `n` quads over a square of so many metres; `height` by x and z.
fn field(n: usize, edge: f64, height: impl Fn(f64, f64) -> f64) -> Vec<Triangle> {
    let place = |i: usize, j: usize| {
        let [x, z] = [i, j].map(|index| edge * (index as f64 / n as f64 - 0.5));
        DVec3::new(x, height(x, z), z)
    };
    let quad = |i: usize, j: usize| {
        let [a, b, c, d] = [place(i, j), place(i, j + 1), place(i + 1, j + 1), place(i + 1, j)];
        [[a, b, c], [a, c, d]]
    };
    (0..n * n).flat_map(|index| quad(index % n, index / n)).collect()
}

/// A sphere of 40 x 26 faces that face inward.
fn sphere(radius: f64) -> Vec<Triangle> {
    let place = |i: usize, j: usize| {
        let (around, down) = (PI * (i % 40) as f64 / 20.0, PI * j as f64 / 26.0);
        radius * DVec3::new(down.sin() * around.cos(), down.cos(), down.sin() * around.sin())
    };
    let mut triangles = Vec::new();
    for (i, j) in (0..40).flat_map(|i| (0..26).map(move |j| (i, j))) {
        let [a, b, c, d] = [place(i, j), place(i + 1, j), place(i + 1, j + 1), place(i, j + 1)];
        triangles.extend((j > 0).then_some([a, c, b]));
        triangles.extend((j < 25).then_some([a, d, c]));
    }
    triangles
}

/// A house of 8 x 3.3 x 6 m with thick walls, a door, and its floor at this height.
fn house(x: f64, floor: f64, z: f64) -> Vec<Triangle> {
    let blocks = [
        ([0.0, -0.3, 0.0], [8.0, 0.0, 6.0]),
        ([0.0, 2.7, 0.0], [8.0, 3.0, 6.0]),
        ([0.0, 0.0, 0.0], [0.3, 2.7, 6.0]),
        ([7.7, 0.0, 0.0], [8.0, 2.7, 6.0]),
        ([0.3, 0.0, 0.0], [7.7, 2.7, 0.3]),
        ([0.3, 0.0, 5.7], [3.0, 2.7, 6.0]),
        ([4.0, 0.0, 5.7], [7.7, 2.7, 6.0]),
        ([3.0, 2.1, 5.7], [4.0, 2.7, 6.0]),
    ];
    let corner = DVec3::new(x, floor, z);
    blocks.iter().flat_map(|(min, max)| solid_of(corner + DVec3::from(*min), corner + DVec3::from(*max))).collect()
}

fn plane() -> Vec<Triangle> {
    field(64, 1000.0, |_, _| 0.0)
}

fn hills(x: f64, z: f64) -> f64 {
    12.0 * (x / 90.0).sin() + 9.0 * (z / 70.0).cos()
}

/// A terrain of 1 km with five houses.
fn village() -> Vec<Vec<Triangle>> {
    let places = [(0.0, 0.0), (-300.0, 200.0), (350.0, -310.0), (120.0, 250.0), (-220.0, -280.0)];
    let houses = places.map(|(x, z)| house(x, hills(x, z) + 1.0, z));
    [field(128, 1000.0, hills)].into_iter().chain(houses).collect()
}

/// Each side within a tenth of the box's size, per axis.
fn is_about(found: Bounds, expected: Bounds) -> bool {
    let slack = (expected.1 - expected.0) * 0.1;
    (found.0 - expected.0).abs().cmple(slack).all() && (found.1 - expected.1).abs().cmple(slack).all()
}

fn encloses(outer: Bounds, inner: Bounds) -> bool {
    outer.0.cmple(inner.0).all() && outer.1.cmpge(inner.1).all()
}

#[test]
fn a_ground_plane_and_a_sky_dome_do_not_change_the_box_of_a_room() {
    assert_eq!(air(&[room()]).bounds, room_bounds());
    let solid = || house(-3.0, 0.0, -2.0);
    let house_bounds = air(&[solid()]).bounds;
    assert_eq!(house_bounds, (DVec3::new(-3.0, -0.3, -2.0), DVec3::new(5.0, 3.0, 4.0)));
    let below = || field(1, 1000.0, |_, _| -0.01);
    let around: [Vec<Vec<Triangle>>; 6] = [
        vec![below()],
        vec![plane()],
        vec![sphere(1000.0)],
        vec![sphere(1000.0), below()],
        vec![plane(), sphere(1000.0)],
        vec![box_of(DVec3::new(-2e3, -0.02, -2e3), DVec3::splat(2e3))],
    ];
    for (case, around) in around.into_iter().enumerate() {
        for double_sided in [false, true] {
            for (inside, expected) in [(room(), room_bounds()), (solid(), house_bounds)] {
                let mut scene = scene_of(&[around.clone(), vec![inside]].concat());
                scene.materials[0].double_sided = double_sided;
                let found = Air::of(&scene).expect("triangles");
                let message = format!("{case}, double-sided {double_sided}: {found:?}");
                assert!(found.is_standable && is_about(found.bounds, expected), "{message}");
                assert_eq!(found.left_out.len(), around.len(), "{message}");
            }
        }
    }
}

#[test]
fn the_light_of_a_room_is_that_of_the_room_without_a_plane_around_it() {
    let bake = |around: &[Vec<Triangle>]| {
        let mut scene = scene_of(&[vec![room()], around.to_vec()].concat());
        scene.materials[0].base_color = Vec4::new(0.5, 0.5, 0.5, 1.0);
        add(&mut scene, Role::Environment, &solid_of(DVec3::new(-1.0, 2.9, -1.0), DVec3::new(1.0, 2.95, 1.0)));
        scene.materials.push(Material { emission: Vec3::ONE, ..scene.materials[0].clone() });
        scene.meshes.last_mut().unwrap().material = 1;
        let mut settings = Settings::default();
        (settings.quality.samples, settings.grid.counts) = (Some(256), Some([7, 5, 7]));
        let job = Job::prepare(Inputs::new(scene), settings, Memory::UNBOUNDED).expect("it fits");
        job.run(&Watch::silent(&AtomicBool::new(false))).expect("light").baked
    };
    let (alone, with) = (bake(&[]), bake(&[field(1, 1000.0, |_, _| -0.01)]));
    assert!(alone.is_all_valid() && with.is_all_valid());
    let mean = |baked: &Baked| (0..baked.len()).map(|node| f64::from(baked.node(node)[0])).sum::<f64>();
    // Noise of the mean of 245 nodes is under a thousandth.
    assert!((mean(&with) / mean(&alone) - 1.0).abs() < 0.01, "{} {}", mean(&with), mean(&alone));
}

#[test]
fn all_rooms_and_huts_are_in_the_box() {
    let flat = |min: [f64; 3], max: [f64; 3]| box_of(min.into(), max.into());
    // Two rooms and a corridor, open to each other: the walls between them are left out.
    let open = |triangles: Vec<Triangle>, x: &[f64]| -> Vec<Triangle> {
        let in_wall = |t: &Triangle| x.iter().any(|x| t.iter().all(|corner| corner.x == *x));
        triangles.into_iter().filter(|t| !in_wall(t)).collect()
    };
    let rooms = vec![
        open(flat([0.0, 0.0, 0.0], [6.0, 3.0, 6.0]), &[6.0]),
        open(flat([6.0, 0.0, 2.0], [14.0, 2.4, 3.5]), &[6.0, 14.0]),
        open(flat([14.0, 0.0, 0.0], [20.0, 3.0, 6.0]), &[14.0]),
    ];
    assert_eq!(air(&rooms).bounds, (DVec3::ZERO, DVec3::new(20.0, 3.0, 6.0)));
    let huts = vec![plane(), house(0.0, 0.0, 0.0), house(28.0, 0.0, 0.0)];
    let found = air(&huts);
    assert!(encloses(found.bounds, (DVec3::ZERO, DVec3::new(36.0, 2.7, 6.0))), "{found:?}");
    assert!((found.bounds.1 - found.bounds.0).max_element() < 50.0, "{found:?}");
}

#[test]
fn terrain_is_a_place_to_be_up_to_a_few_metres_over_its_highest_hill() {
    let expected = air(&village());
    let (min, max) = expected.all;
    let bounds = expected.bounds;
    assert_eq!((bounds.0.x, bounds.0.z, bounds.1.x, bounds.1.z), (min.x, min.z, max.x, max.z));
    assert!((max.y + 1.0..max.y + 5.0).contains(&bounds.1.y), "{expected:?}");
    // Rock below the terrain, and a dome over it.
    let rock = solid_of(DVec3::new(-500.0, -200.0, -500.0), DVec3::new(500.0, -25.0, 500.0));
    let rock: Vec<Triangle> = rock.into_iter().filter(|t| !t.iter().all(|corner| corner.y == -25.0)).collect();
    for around in [rock, sphere(1000.0)] {
        let found = air(&[village(), vec![around]].concat());
        assert!(is_about(found.bounds, bounds), "{found:?}");
    }
    // One house alone does not turn its terrain into a backdrop.
    let lonely = [field(128, 1000.0, hills), house(0.0, hills(0.0, 0.0) + 1.0, 0.0)];
    assert!(is_about(air(&lonely).bounds, bounds));
}

#[test]
fn rock_around_rooms_is_left_out() {
    for (half, offset) in [(50.0, 0.0), (50.0, 45.0), (10.0, 0.0)] {
        let shell = solid_of(DVec3::new(-half, -half - offset, -half), DVec3::new(half, half - offset, half));
        let found = air(&[shell, room()]);
        assert!(is_about(found.bounds, room_bounds()), "{half} {offset}: {found:?}");
    }
}

#[test]
fn a_hall_stays_around_the_few_things_that_stand_in_it() {
    let hall = box_of(DVec3::new(-100.0, 0.0, -100.0), DVec3::new(100.0, 20.0, 100.0));
    // In one piece, and of six that do not hang together.
    let pieces: Vec<Vec<Triangle>> = hall.chunks(2).map(<[Triangle]>::to_vec).collect();
    for hall in [vec![hall], pieces] {
        for inside in [house(0.0, 0.3, 0.0), solid_of(DVec3::ZERO, DVec3::splat(1.0))] {
            let found = air(&[hall.clone(), vec![inside]].concat());
            assert_eq!(found.bounds, found.all, "{found:?}");
        }
    }
}

#[test]
fn where_one_can_stand_nowhere_the_box_is_that_of_all_triangles() {
    let walls: Vec<Triangle> = room().into_iter().filter(|[a, b, c]| a.y != b.y || b.y != c.y).collect();
    let outward = sphere(3.0).into_iter().map(|[a, b, c]| [a, c, b]).collect();
    let turned = Placement { scale: 1.0, rotation: DQuat::from_rotation_x(FRAC_PI_2), offset: DVec3::ZERO };
    let on_its_side = turned.scene(&scene_of(&village()));
    let triangle = vec![[DVec3::ZERO, DVec3::Z, DVec3::X]];
    let scenes = [scene_of(&[walls]), scene_of(&[outward]), scene_of(&[triangle]), on_its_side];
    for (case, scene) in scenes.iter().enumerate() {
        let found = Air::of(scene).expect("triangles");
        assert!(!found.is_standable && found.left_out.is_empty(), "{case}: {found:?}");
        assert_eq!(Some(found.bounds), scene.bounds(|_| true), "{case}");
        let job = Job::prepare(Inputs::new(scene.clone()), Settings::default(), Memory::UNBOUNDED).expect("it fits");
        let row = job.plan().into_iter().find(|row| row.stage == "bounds").expect("a row");
        assert!(!row.kept && row.why.contains("hardly anywhere"), "{row:?}");
    }
    assert_eq!(Air::of(&Scene::default()), None);
}

#[test]
fn open_boxes_keep_their_box() {
    // Without one side each, and as the box of the report without both ends.
    for open in [&[0][..], &[1], &[3], &[4], &[5], &[4, 5]] {
        let triangles: Vec<Triangle> = room()
            .chunks(2)
            .enumerate()
            .filter(|(side, _)| !open.contains(side))
            .flat_map(|(_, side)| side.to_vec())
            .collect();
        let found = air(&[triangles]);
        assert!(found.is_standable && found.bounds == room_bounds(), "{open:?}: {found:?}");
    }
}

#[test]
fn what_stands_on_a_level_floor_makes_no_hills() {
    let mut flat: Vec<Triangle> = room().into_iter().filter(|t| !t.iter().all(|corner| corner.y == 3.0)).collect();
    // A shelf and a cupboard.
    flat.extend(solid_of(DVec3::new(-2.9, 0.4, -1.9), DVec3::new(0.0, 0.5, 0.0)));
    flat.extend(solid_of(DVec3::new(1.0, 0.0, 1.0), DVec3::new(2.9, 1.9, 3.9)));
    assert_eq!(air(&[flat]).bounds, room_bounds());
}

#[test]
fn the_box_goes_with_the_level() {
    let levels = [
        vec![plane(), room(), sphere(1000.0)],
        village(),
        vec![solid_of(DVec3::splat(-10.0), DVec3::splat(10.0)), room()],
    ];
    for (case, level) in levels.iter().enumerate() {
        let scene = scene_of(level);
        let expected = Air::of(&scene).expect("triangles");
        for (scale, offset) in [(1e-3, 0.0), (1e3, 0.0), (1.0, 1e6), (1.0, -1e6)] {
            let offset = DVec3::new(offset, 0.5 * offset, -offset);
            let placement = Placement { scale, rotation: DQuat::IDENTITY, offset };
            let found = Air::of(&placement.scene(&scene)).expect("triangles");
            let back = |corner: DVec3| (corner - offset) / scale;
            let off =
                (back(found.bounds.0) - expected.bounds.0).abs().max((back(found.bounds.1) - expected.bounds.1).abs());
            let size = (expected.bounds.1 - expected.bounds.0).max_element();
            assert!(off.max_element() < 0.01 * size, "{case}, {scale}, {offset}: {found:?}, {expected:?}");
        }
        // Whichever mesh comes first.
        let mut reversed = scene.clone();
        reversed.meshes.reverse();
        let found = Air::of(&reversed).expect("triangles");
        assert_eq!((found.bounds, found.headroom), (expected.bounds, expected.headroom), "{case}");
    }
}

#[test]
fn a_level_of_a_great_many_layers_takes_no_more_memory_than_others() {
    // Each line would cross all of them.
    let layers: Vec<Triangle> = (0..400).flat_map(|layer| field(1, 6.0, move |_, _| 0.01 * f64::from(layer))).collect();
    let found = air(&[layers, room()]);
    assert_eq!(found.bounds.0.x, -3.0, "{found:?}");
}

#[test]
fn a_box_that_is_given_wins() {
    let mut settings = Settings::default();
    settings.grid.bounds = Some([-9.0, 0.0, -9.0, 9.0, 5.0, 9.0]);
    let marker = VolumeMarker {
        name: "hall".into(),
        node: "node 1 (hall)".into(),
        spacing: 1.0,
        center: DVec3::ZERO,
        half_axes: DMat3::from_diagonal(DVec3::splat(20.0)),
        settings: Vec::new(),
    };
    let scene = scene_of(&[plane(), room()]);
    let marked = Scene { volume_markers: vec![marker], ..scene.clone() };
    let bounds = |scene: &Scene, settings: &Settings| {
        let job = Job::prepare(Inputs::new(scene.clone()), settings.clone(), Memory::UNBOUNDED).expect("it fits");
        let Nodes::Grid(grid) = job.nodes() else { panic!("a grid") };
        let row = job.plan().into_iter().find(|row| row.stage == "bounds").expect("a row");
        ((DVec3::from(grid.min), DVec3::from(grid.max)), row)
    };
    let (given, row) = bounds(&scene, &settings);
    assert_eq!((given, row.kept), ((DVec3::new(-9.0, 0.0, -9.0), DVec3::new(9.0, 5.0, 9.0)), false));
    let (given, row) = bounds(&marked, &Settings::default());
    assert_eq!((given, row.kept), ((DVec3::splat(-20.0), DVec3::splat(20.0)), false));
    assert!(row.why.contains("'hall'"), "{row:?}");
    let (found, row) = bounds(&scene, &Settings::default());
    assert_eq!((found, row.kept), (room_bounds(), true));
    assert!(row.why.contains("6 x 3 x 6 m") && row.why.contains("a plane of 1000 m (mesh 0)"), "{row:?}");
    settings.grid = Default::default();
    settings.grid.nodes = NodeKind::Vertices;
    let job = Job::prepare(Inputs::new(scene), settings, Memory::UNBOUNDED).expect("it fits");
    assert!(job.plan().iter().any(|row| row.stage == "bounds" && !row.kept));
}

#[test]
fn units_that_look_wrong_and_wide_spacings_are_found() {
    let findings = |scene: &Scene, spacing: Option<f64>| -> Vec<String> {
        let mut settings = Settings::default();
        settings.grid.spacing = spacing;
        let job = Job::prepare(Inputs::new(scene.clone()), settings, Memory::UNBOUNDED).expect("it fits");
        job.inputs.findings.into_iter().map(|finding| finding.id).collect()
    };
    let room = scene_of(&[room()]);
    let none: [String; 0] = [];
    assert_eq!(findings(&room, None), none);
    assert_eq!(findings(&room, Some(1.4)), none);
    assert_eq!(findings(&room, Some(2.0)), ["spacing-wide"]);
    let scaled = |scale: f64| Placement { scale, rotation: DQuat::IDENTITY, offset: DVec3::ZERO }.scene(&room);
    assert_eq!(findings(&scaled(1000.0), None), none);
    assert_eq!(findings(&scaled(2000.0), None), ["units"]);
    assert_eq!(findings(&scaled(0.001), None), ["units"]);
    assert_eq!(findings(&scene_of(&village()), None), ["spacing-wide"]);
}
