//! How fine a grid becomes where nobody says: as light needs it, within nodes, bytes and seconds.

use gdibl_baker::bake::Nodes;
use gdibl_baker::job::records::{PlanRow, SeenRecord};
use gdibl_baker::job::{Inputs, Job, Made, Memory, Settings, Stop, Watch};
use gdibl_baker::scene::{Role, Scene};
use glam::{DVec3, Vec3};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crate::level::*;

/// Seconds that a ray takes: the clock of these tests.
const SECONDS_PER_RAY: f64 = 1e-5;

fn settings() -> Settings {
    let mut settings = Settings::default();
    settings.grid.bounds = Some([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0]);
    settings.quality.samples = Some(64);
    settings
}

fn job(scene: &Scene, sky: impl Fn(Vec3) -> [f32; 3], settings: &Settings) -> Result<Job, Stop> {
    let inputs = Inputs { distant: Some(distant(panorama(32, sky))), ..Inputs::new(scene.clone()) };
    Job::prepare(inputs, settings.clone(), Memory::UNBOUNDED)
}

/// What was baked, and what a clock that counts rays said at the end.
fn bake(scene: &Scene, sky: impl Fn(Vec3) -> [f32; 3], settings: &Settings) -> (Made, f64) {
    let rays = AtomicU64::new(0);
    let count = |_, traced| {
        rays.fetch_add(traced, Ordering::Relaxed);
    };
    let seconds = || rays.load(Ordering::Relaxed) as f64 * SECONDS_PER_RAY;
    let cancel = AtomicBool::new(false);
    let watch = Watch { progress: &count, seconds: &seconds, ..Watch::silent(&cancel) };
    let made = job(scene, sky, settings).expect("it makes sense").run(&watch).expect("nobody interrupts");
    (made, seconds())
}

fn counts(made: &Made) -> [u32; 3] {
    let Nodes::Grid(grid) = &made.nodes else { panic!("{:?}", made.nodes) };
    grid.counts
}

fn row(made: &Made) -> &PlanRow {
    made.records.plan.iter().find(|row| row.stage == "spacing").expect("a row")
}

fn seen(made: &Made) -> SeenRecord {
    made.records.statistics.as_ref().expect("a job fills it in").seen.expect("it was measured")
}

fn even(_: Vec3) -> [f32; 3] {
    [1.0, 2.0, 3.0]
}

fn bright_on_one_side(direction: Vec3) -> [f32; 3] {
    if direction.x > 0.6 { [20.0, 15.0, 10.0] } else { [0.2, 0.3, 0.4] }
}

/// A wall in the box that hides half of a bright sky from the other half of the air.
fn wall() -> Scene {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &solid_of(DVec3::new(-0.1, -1.0, -0.6), DVec3::new(0.1, 0.7, 1.0)));
    scene
}

#[test]
fn light_that_is_the_same_everywhere_is_one_node() {
    let (made, _) = bake(&Scene::default(), even, &settings());
    assert_eq!(counts(&made), [1, 1, 1], "{:?}", row(&made));
    assert!(seen(&made).air.expect("it is lit").error.max < 2e-3);
}

#[test]
fn a_grid_is_as_fine_as_its_error_needs() {
    let with = |error| {
        let mut settings = settings();
        (settings.quality.samples, settings.quality.seen_places) = (Some(256), Some(64));
        settings.quality.max_seen_error = Some(error);
        settings.grid.max_nodes = Some(4096);
        bake(&wall(), bright_on_one_side, &settings).0
    };
    let (rough, finest) = (with(2.0), with(1e-4));
    assert!(rough.nodes.len() < 200, "{:?}", row(&rough));
    let air = seen(&rough).air.expect("it is lit").error.p95;
    let surfaces = seen(&rough).surfaces.expect("it is lit").error.p95;
    assert!(air.max(surfaces) <= 2.0, "{air} {surfaces}");
    assert_eq!(counts(&finest), [16; 3], "{:?}", row(&finest));
    assert!(seen(&finest).air.expect("it is lit").error.p95 < air);
    assert!(row(&finest).why.contains("0.01 % of error is asked for"), "{:?}", row(&finest));
}

#[test]
fn the_grid_that_was_chosen_has_the_light_of_the_same_grid_asked_for() {
    let chosen = bake(&wall(), bright_on_one_side, &settings()).0;
    let mut asked = settings();
    asked.grid.counts = Some(counts(&chosen));
    let asked = bake(&wall(), bright_on_one_side, &asked).0;
    assert_eq!(chosen.baked.sh, asked.baked.sh);
    assert_eq!(row(&asked).why, "it is given");
}

#[test]
fn a_budget_is_kept_and_what_it_came_to_is_recorded() {
    for budget in [10.0, 40.0] {
        let mut settings = settings();
        (settings.grid.budget, settings.quality.samples) = (Some(budget), Some(512));
        settings.quality.seen_places = Some(32);
        let (made, seconds) = bake(&wall(), bright_on_one_side, &settings);
        assert!((0.5 * budget..=1.1 * budget).contains(&seconds), "{seconds} of {budget}: {:?}", counts(&made));
        let recorded = made.records.settings.as_ref().expect("a job fills it in");
        let value = |name: &str| recorded.settings.iter().find(|setting| setting.name == name);
        assert!(value("grid.budget").is_none(), "it depends on the machine");
        // The same nodes again, without a clock.
        settings.grid.budget = None;
        let most = value("grid.max_nodes").and_then(|setting| setting.value.clone()).expect("it is recorded");
        settings.set("grid", "max_nodes", &[&most]).expect("a number");
        let again = bake(&wall(), bright_on_one_side, &settings).0;
        assert_eq!((counts(&made), &made.baked.sh), (counts(&again), &again.baked.sh));
    }
    // There is always something.
    let mut aside = Scene::default();
    add(&mut aside, Role::Environment, &solid_of(DVec3::new(0.5, -1.0, -1.0), DVec3::new(0.9, -0.5, 1.0)));
    let mut settings = settings();
    settings.grid.budget = Some(1e-9);
    assert_eq!(bake(&aside, bright_on_one_side, &settings).0.nodes.len(), 1);
}

#[test]
fn bounds_that_make_no_sense_are_refused() {
    let refused = |change: &dyn Fn(&mut Settings)| {
        let mut settings = settings();
        change(&mut settings);
        let stop = job(&wall(), even, &settings).expect_err("it makes no sense");
        assert!(matches!(stop, Stop::Usage(_)), "{stop:?}");
        stop.to_string()
    };
    assert!(refused(&|s| s.grid.budget = Some(0.0)).contains("--budget 0: expected seconds above 0"));
    assert!(refused(&|s| s.grid.max_nodes = Some(0)).contains("--max-nodes 0: expected 1 or more"));
    let both = refused(&|s| (s.grid.max_nodes, s.grid.spacing) = (Some(8), Some(0.5)));
    assert!(both.contains("leave out --spacing"), "{both}");
    let both = refused(&|s| (s.grid.budget, s.grid.counts) = (Some(8.0), Some([2; 3])));
    assert!(both.contains("leave out --spacing"), "{both}");
    let both = refused(&|s| (s.grid.max_bytes, s.grid.tolerance) = (Some(8), Some(0.5)));
    assert!(both.contains("leave out --tolerance"), "{both}");
}
