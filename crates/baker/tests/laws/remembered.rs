//! Light of surfaces that is remembered against light that is found anew.

use gdibl_baker::bake::BakeSettings;
use gdibl_baker::radiance::blend::BlendRule;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings};
use glam::DVec3;

use crate::level::*;

#[test]
fn remembered_light_is_that_which_is_found_anew() {
    let scene = room_with_pillar();
    let probes = coloured_probes();
    let bake_with = |directions, blend| {
        let function = Gdibl::new(&scene, &probes, None, GdiblSettings { directions, blend, ..Default::default() });
        // The same directions for both.
        let settings = BakeSettings { samples: 1024, importance: false, ..BakeSettings::default() };
        (bake_points(&function, &places(), &settings), function.remembered_count())
    };
    for (blend, seamless) in [
        (BlendRule::Footprint(4.0), true),
        (BlendRule::Distance(2.0), true),
        (BlendRule::Angular(2.0), false),
        (BlendRule::AngularSmooth(2.0), false),
        (BlendRule::Nearest, false),
    ] {
        let (anew, none) = bake_with(0, blend);
        let (remembered, some) = bake_with(1 << 26, blend);
        assert_eq!((none, some > 0), (0, seamless), "{blend}");
        if !seamless {
            // Lists of probes save rays and change nothing.
            assert_eq!(anew.sh, remembered.sh, "{blend}");
            continue;
        }
        let difference = difference(&remembered.sh.to_vec(), &anew.sh.to_vec());
        println!("{blend}: {difference:.1e}");
        assert!(difference > 0.0, "{blend}: nothing was remembered");
        assert!(difference < 3e-3, "{blend}: {difference}");
    }
}

#[test]
fn remembered_light_saves_most_rays_where_many_probes_see_a_surface() {
    let scene = room_with_pillar();
    let all = coloured_probes();
    // Places as many again, a little beside: all see nearly the same.
    let many: Vec<_> = (0..16)
        .flat_map(|i| {
            all.iter().cloned().map(move |mut probe| {
                probe.position += DVec3::new(f64::from(i % 4), f64::from(i / 4), 0.0) * 0.02;
                probe
            })
        })
        .collect();
    let rays = |probes: &[_], samples, directions| {
        let function = Gdibl::new(&scene, probes, None, GdiblSettings { directions, ..Default::default() });
        let baked = bake_points(&function, &places(), &BakeSettings { samples, ..BakeSettings::default() });
        baked.rays as f64 / baked.samples as f64
    };
    let samples = 32_768;
    let directions = samples * places().len() as u64;
    let (few, lots) = (rays(&all, samples, directions), rays(&many, samples, directions));
    let without = rays(&many, 1024, 0);
    println!("{} probes: {few:.2} rays, {}: {lots:.2}, and {without:.2} if found anew", all.len(), many.len());
    assert!(lots < without / 2.0, "{lots} {without}");
}
