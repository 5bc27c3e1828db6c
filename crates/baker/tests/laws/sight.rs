//! Lines of sight that are left out, because nothing can stand between, against those that are traced.

use gdibl_baker::bake::{BakeSettings, Baked};
use gdibl_baker::job::plan::plan;
use gdibl_baker::job::records::PlanRow;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings, Probe};
use gdibl_baker::scene::{Role, Scene};
use glam::DVec3;

use crate::level::*;

const MIN: DVec3 = DVec3::new(-3.0, -1.0, -2.0);
const MAX: DVec3 = DVec3::new(3.0, 2.0, 2.5);

/// The convex room of [`room_with_pillar`], without `left_out` of its triangles, with others.
fn room(left_out: usize, extra: &[Triangle]) -> Scene {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &[&box_of(MIN, MAX)[left_out..], extra].concat());
    scene
}

/// What is baked, the plan's row, and how many probes see all.
fn baked(scene: &Scene, probes: &[Probe], directions: u64) -> (Baked, PlanRow, usize) {
    let function = Gdibl::new(scene, probes, None, GdiblSettings { directions, ..GdiblSettings::default() });
    let baked = bake_points(&function, &places(), &BakeSettings { samples: 2048, ..BakeSettings::default() });
    let row = plan(scene, &function).into_iter().find(|row| row.stage == "lines-of-sight").expect("it is planned");
    (baked, row, function.sees_all_count())
}

#[test]
fn lines_of_sight_that_nothing_can_block_are_left_out_and_change_no_bit() {
    let probes = coloured_probes();
    // Closed, and open at one end.
    for open in [0, 2] {
        // One triangle twice hides nothing, and proves nothing.
        let twice = [box_of(MIN, MAX)[11]];
        let (out, row, all) = baked(&room(open, &[]), &probes, 0);
        assert_eq!((all, row.kept), (3, false), "{row:?}");
        let (traced, row, all) = baked(&room(open, &twice), &probes, 0);
        assert_eq!((all, row.kept), (0, true), "{row:?}");
        let per_direction = |baked: &Baked| baked.rays as f64 / baked.samples as f64;
        println!("{:.3} rays per direction, {:.3} traced", per_direction(&out), per_direction(&traced));
        assert_eq!(out.sh, traced.sh);
        assert!(per_direction(&traced) > 1.9, "{}", per_direction(&traced));
        if open == 0 {
            // Nothing but directions, and the looks around before the bake.
            assert!(per_direction(&out) < 1.1, "{}", per_direction(&out));
        }
        // Remembered light is found by fewer rays, too.
        let [out, traced] = [&[][..], &twice].map(|extra| baked(&room(open, extra), &probes, 1 << 22).0);
        assert!(out.rays < traced.rays, "{} {}", out.rays, traced.rays);
    }
}

#[test]
fn lines_of_sight_are_kept_to_probes_that_something_may_hide_from() {
    let mut probes = coloured_probes();
    let (_, row, all) = baked(&room_with_pillar(), &probes, 0);
    assert_eq!((all, row.kept), (0, true), "{row:?}");
    // One probe outside of the room: it counts, but is not seen through the wall.
    probes[1].position = DVec3::new(3.5, 1.0, 0.0);
    let (_, row, all) = baked(&room(0, &[]), &probes, 0);
    assert_eq!((all, row.kept), (2, true), "{row:?}");
    assert!(row.why.contains("1 of 3"), "{row:?}");
    // Scene geometry never stands between.
    let mut scene = room(0, &[]);
    add(&mut scene, Role::Scene, &solid_of(DVec3::new(0.4, -1.0, 0.3), DVec3::new(0.9, 1.05, 0.8)));
    assert_eq!(baked(&scene, &coloured_probes(), 0).2, 3);
}
