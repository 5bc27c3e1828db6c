//! What probes have seen, and where further ones should stand.

use gdibl_baker::analyse::{Coverage, CoveragePaint, CoverageView, Viewpoint, coverage};
use gdibl_baker::capture::{PlaceSettings, Placement, are_free, place_probes};
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::render::{Camera, RenderSettings, render};
use gdibl_baker::scene::{Material, Role, Scene};
use gdibl_baker::{Control, Interrupted};
use glam::{DVec3, Vec3};
use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicBool, AtomicU64};

use crate::level::*;

const PIXELS: usize = 128 * 64;

fn path(scene: &Scene) -> Path<'_> {
    Path::new(scene, None, PathSettings::default())
}

fn suggest(scene: &Scene, existing: &[DVec3], gain: f64) -> Placement {
    let bounds = scene.bounds(|_| true).expect("triangles");
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    let settings = PlaceSettings { most: 8, gain };
    place_probes(&path(scene), bounds, existing, &settings, &control).expect("nobody interrupts")
}

fn seen_from(scene: &Scene, probes: &[DVec3], distant_pixels: Option<usize>) -> Coverage {
    let viewpoints: Vec<Viewpoint> = probes.iter().map(|&position| Viewpoint { position, pixels: PIXELS }).collect();
    let path = path(scene);
    coverage(&CoverageView::new(&path, &viewpoints), scene.bounds(|_| true).expect("triangles"), distant_pixels)
}

/// Two closed rooms, x 0..4 and 5..9, side by side.
fn two_rooms() -> Scene {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::ZERO, DVec3::new(4.0, 3.0, 4.0)));
    add(&mut scene, Role::Environment, &box_of(DVec3::new(5.0, 0.0, 0.0), DVec3::new(9.0, 3.0, 4.0)));
    scene
}

/// A room, x 0..3, y and z 0..1, with a thin wall at x = 1.
fn divided_room() -> Scene {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::ZERO, DVec3::new(3.0, 1.0, 1.0)));
    let corner = |y, z| DVec3::new(1.0, y, z);
    let [a, b, c, d] = [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)];
    add(&mut scene, Role::Environment, &[[a, b, c], [a, c, d]]);
    scene.materials.push(Material { metallic: 0.0, double_sided: true, ..Material::default() });
    scene.meshes[1].material = 1;
    // Backs in the dark are the inside of a solid.
    scene.materials[0].emission = Vec3::ONE;
    scene
}

#[test]
fn each_of_two_rooms_gets_a_probe() {
    let placement = suggest(&two_rooms(), &[], 0.1);
    let positions = placement.positions();
    assert_eq!(positions.len(), 2, "{placement:?}");
    assert_ne!(positions[0].x < 4.5, positions[1].x < 4.5, "{positions:?}");
    let [first, second] = [0, 1].map(|i| placement.suggestions[i].after);
    assert!((first.coverage - 0.5).abs() < 0.02, "{first:?}");
    assert_eq!((second.coverage, second.uncovered), (1.0, 0.0));
    // All directions end at surfaces: what is not covered is that share of the sphere.
    let sphere = 4.0 * std::f64::consts::PI;
    assert!((first.uncovered - sphere * (1.0 - first.coverage)).abs() < 1e-9);
}

#[test]
fn probes_that_stand_are_taken_into_account() {
    let scene = two_rooms();
    let alone = suggest(&scene, &[], 0.1);
    let standing = DVec3::new(2.0, 1.5, 2.0);
    let placement = suggest(&scene, &[standing], 0.1);
    assert!((placement.before.coverage - 0.5).abs() < 0.02, "{placement:?}");
    let positions = placement.positions();
    assert!(positions.len() == 1 && positions[0].x > 5.0, "the other room alone: {positions:?}");
    let gain = |placement: &Placement| placement.suggestions.iter().map(|s| s.gain).sum::<f64>();
    assert!(gain(&placement) < 0.6 * gain(&alone), "{} {}", gain(&placement), gain(&alone));
    // Where all stand that were asked for, none is missing.
    let again = suggest(&scene, &[standing, positions[0]], 0.1);
    assert!(again.suggestions.is_empty() && again.before.coverage == 1.0, "{again:?}");
}

#[test]
fn each_suggestion_says_what_it_adds() {
    let placement = suggest(&room_with_pillar(), &[], 0.001);
    assert!(placement.suggestions.len() > 2, "{placement:?}");
    let mut reach = placement.before;
    assert_eq!(reach.coverage, 0.0);
    let mut sum = 0.0;
    for suggestion in &placement.suggestions {
        assert!(suggestion.gain > 0.0 && suggestion.after.coverage >= reach.coverage, "{placement:?}");
        assert!(suggestion.after.uncovered <= reach.uncovered, "{placement:?}");
        (reach, sum) = (suggestion.after, sum + suggestion.gain);
    }
    assert!(sum <= 1.0 && reach.coverage > 0.999, "{placement:?}");
    let first = placement.suggestions[0].gain;
    assert!(placement.suggestions.iter().all(|s| s.gain <= first), "the most useful first: {placement:?}");
}

#[test]
fn placement_does_not_depend_on_the_number_of_threads() {
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| suggest(&room_with_pillar(), &[], 0.01))
    };
    let one = on(1);
    assert!(!one.suggestions.is_empty());
    assert_eq!(one, on(3));
}

#[test]
fn placing_shows_progress_and_stops_when_asked() {
    let scene = room_with_pillar();
    let bounds = scene.bounds(|_| true).expect("triangles");
    let cancel = AtomicBool::new(false);
    // Whoever asks at the tenth place waits for no other but those that are under way.
    let (places, after) = (AtomicU64::new(0), AtomicU64::new(0));
    let progress = |done, _| {
        if cancel.load(Relaxed) {
            after.fetch_add(done, Relaxed);
        }
        if places.fetch_add(done, Relaxed) + done >= 10 {
            cancel.store(true, Relaxed);
        }
    };
    let control = Control { cancel: &cancel, progress: &progress, blocks: None };
    let placed = place_probes(&path(&scene), bounds, &[], &PlaceSettings::default(), &control);
    assert_eq!(placed, Err(Interrupted));
    assert!(after.load(Relaxed) <= rayon::current_num_threads() as u64, "{after:?}");
}

#[test]
fn solids_have_no_place_for_a_probe() {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &solid_of(DVec3::splat(-1.0), DVec3::splat(1.0)));
    assert_eq!(suggest(&scene, &[], 0.0), Placement::default());
    let found = seen_from(&scene, &[DVec3::splat(3.0)], None);
    assert_eq!(found.free_places, 0);
    assert_eq!(found.surfaces_by_solid_angle.share, 1.0, "nothing to see");
    // By area the outside counts: three of six faces are seen.
    assert!((found.surfaces_by_area.share - 0.5).abs() < 0.01, "{found:?}");
    assert_eq!(are_free(&path(&scene), &[DVec3::ZERO, DVec3::splat(1.5)]), [false, true]);
}

#[test]
fn coverage_of_a_room_with_a_hidden_third_is_the_analytic_one() {
    let found = seen_from(&divided_room(), &[DVec3::new(2.0, 0.5, 0.5)], None);
    // Two thirds of the places are in the probe's part, and see nothing of the other.
    let by_solid_angle = found.surfaces_by_solid_angle;
    assert!((by_solid_angle.share - 2.0 / 3.0).abs() < 0.01, "{found:?}");
    assert!((by_solid_angle.whole - 4.0 * std::f64::consts::PI).abs() < 1e-6, "{found:?}");
    // Faces of 1 and of 2 m²: 10 in the probe's part, 6 in the other.
    let by_area = found.surfaces_by_area;
    assert!((by_area.share - 10.0 / 16.0).abs() < 0.01, "{found:?}");
    assert!((by_area.whole - 16.0).abs() < 0.01, "{found:?}");
    assert_eq!((found.distant.whole, found.distant.share), (0.0, 1.0), "it is closed");
}

#[test]
fn pixel_sizes_are_those_of_the_best_probe() {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::splat(-1.0), DVec3::splat(1.0)));
    // d √(4π / (N cosθ)) with cosθ = 1/d, over a face.
    let mut sizes: Vec<f64> = (0..10_000)
        .map(|i| [i % 100, i / 100].map(|i| (f64::from(i) + 0.5) / 100.0))
        .map(|[x, y]| (4.0 * std::f64::consts::PI / PIXELS as f64).sqrt() * (1.0 + x * x + y * y).powf(0.75))
        .collect();
    sizes.sort_by(f64::total_cmp);
    let size = seen_from(&scene, &[DVec3::ZERO], None).surfaces_by_area.pixel_size.expect("all is seen");
    for (found, share) in [(size.p5, 0.05), (size.median, 0.5), (size.p95, 0.95)] {
        let expected = sizes[(share * 10_000.0) as usize];
        assert!((found / expected - 1.0).abs() < 0.01, "{found} {expected}");
    }
    // One more probe at the same place changes nothing; one in a corner refines that corner.
    let twice = seen_from(&scene, &[DVec3::ZERO; 2], None).surfaces_by_area.pixel_size;
    assert_eq!(twice, Some(size));
    let cornered = seen_from(&scene, &[DVec3::ZERO, DVec3::splat(0.8)], None).surfaces_by_area.pixel_size.unwrap();
    assert!(cornered.p5 < 0.8 * size.p5 && cornered.p95 < size.p95, "{cornered:?} {size:?}");
}

#[test]
fn distance_is_seen_by_the_panorama_or_by_probes_that_look_out() {
    // A well: only its top is open.
    let mut scene = Scene::default();
    let well = box_of(DVec3::ZERO, DVec3::new(1.0, 3.0, 1.0));
    let walls: Vec<Triangle> = well.into_iter().filter(|t| !t.iter().all(|corner| corner.y == 3.0)).collect();
    assert_eq!(walls.len(), 10);
    add(&mut scene, Role::Environment, &walls);
    let high = seen_from(&scene, &[DVec3::new(0.5, 2.999, 0.5)], None).distant;
    let low = seen_from(&scene, &[DVec3::new(0.5, 0.1, 0.5)], None).distant;
    assert!(high.whole > 0.1 && high.share > 0.99, "{high:?}");
    assert!(low.whole == high.whole && low.share > 0.0 && low.share < 0.5, "{low:?}");
    let sky = seen_from(&scene, &[], Some(PIXELS)).distant;
    let degrees = (4.0 * std::f64::consts::PI / PIXELS as f64).sqrt().to_degrees();
    assert_eq!(sky.share, 1.0);
    assert!((sky.pixel_size.unwrap().median / degrees - 1.0).abs() < 1e-5, "{sky:?}");
}

#[test]
fn picture_shows_the_signal_colour_where_nothing_is_seen_and_only_there() {
    let scene = divided_room();
    let path = path(&scene);
    let view = CoverageView::new(&path, &[Viewpoint { position: DVec3::new(2.0, 0.5, 0.5), pixels: PIXELS }]);
    let size = coverage(&view, scene.bounds(|_| true).unwrap(), None).surfaces_by_solid_angle.pixel_size;
    let paint = CoveragePaint::new(&view, size);
    let picture = |x: f64| {
        let camera = Camera::Panorama { position: DVec3::new(x, 0.4, 0.6) };
        let settings = RenderSettings { width: 32, height: 16, samples: 1, ..RenderSettings::default() };
        let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
        render(&paint, None, &camera, &settings, &control).unwrap().image.pixels
    };
    assert!(picture(0.5).iter().all(|pixel| Vec3::from(*pixel) == CoveragePaint::UNSEEN));
    let seen = picture(2.2);
    // Every colour of the scale has as much blue as the signal's green has not.
    assert!(seen.iter().all(|[r, g, b]| *g > 0.0 && *r < 0.75 && *b > 0.1), "{seen:?}");
    let brightness = |p: &[f32; 3]| p[0];
    let [least, most] =
        [f32::min as fn(f32, f32) -> f32, f32::max].map(|f| seen.iter().map(brightness).reduce(f).unwrap());
    assert!(least < 0.1 && most > 0.5, "from coarse to fine: {least} {most}");
}
