//! The laws of light, at every scale, place and turn.

use crate::level::*;
use crate::shared::*;
use crate::table::Table;
use gdibl_baker::bake::{BakeSettings, Baked, Nodes};
use gdibl_baker::job::records::Records;
use gdibl_baker::pack::{PackSettings, Precision, pack};
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings};
use gdibl_baker::sampling::{Sampler, Stream, fibonacci_sphere};
use gdibl_runtime::Volume;
use gdibl_tools::bake_all;
use glam::{DMat3, DQuat, DVec3};

pub fn rows(table: &mut Table) {
    let radiance = [1.0, 1e-3, 2e4];
    let (scene, probes) = (room_with_pillar(), white_probes(radiance));
    let (mut single, mut half) = (0.0f64, 0.0f64);
    for rule in every_rule() {
        let function = Gdibl::new(&scene, &probes, None, GdiblSettings { blend: rule, ..GdiblSettings::default() });
        for bands in 0..=4 {
            let nodes = Nodes::Points(places());
            let baked = bake_all(&function, &nodes, &BakeSettings { bands, ..USUAL });
            let packed = pack(
                &nodes,
                &baked,
                Records::default(),
                PackSettings { precision: Precision::F16, ..Default::default() },
            );
            let volume = Volume::parse(&packed.bytes).expect("what was packed parses");
            for node in 0..nodes.len() {
                single = single.max(off_the_furnace(&sh_of(&baked, node), radiance));
                half = half.max(off_the_furnace(&volume.node_sh(node), radiance));
            }
        }
    }
    let case = format!("furnace: room and probes of radiance L; {} blend rules, L0 to L4", every_rule().len());
    table.at_most(&format!("{case}; f32"), "E = πL: relative error", 1e-4, single);
    table.at_most("the same; f16, radiance of R, G, B 1, 1e-3, 2e4", "E = πL: relative error", 6e-4, half);

    let probes = coloured_probes();
    let uniform = BakeSettings { importance: false, ..USUAL };
    let bake_placed = |placement: &Placement, settings| {
        let (scene, probes) = (placement.scene(&scene), placement.probes(&probes));
        bake_points(&gdibl(&scene, &probes, None), &placement.points(&places()), settings)
    };
    let reference = bake_points(&gdibl(&scene, &probes, None), &places(), &uniform);
    let usual = bake_points(&gdibl(&scene, &probes, None), &places(), &USUAL);
    let (mut same, mut default) = (0.0f64, 0.0f64);
    for scale in [1e-3, 1.0, 1e3, 1e5] {
        for offset in [0.0, 1e4, 1e6] {
            let offset = DVec3::new(offset, -offset, offset / 3.0);
            let placement = Placement { scale, rotation: DQuat::IDENTITY, offset };
            same = same.max(difference(&bake_placed(&placement, &uniform).sh.to_vec(), &reference.sh.to_vec()));
            let moved = bake_placed(&placement, &USUAL);
            default = default.max(error_of(&moved, |node| sh_of(&usual, node)).relative_rmse);
        }
    }
    let case = "scale 1e-3, 1, 1e3, 1e5 × moved by 0, 1e4, 1e6 m";
    table.at_most(&format!("{case}; the same directions"), "change of the largest coefficient", 1e-3, same);
    table.at_most(&format!("{case}; default directions"), "relative RMSE of the change of E", 1e-3, default);

    let points = spread(DVec3::new(-2.9, -0.9, -1.9), DVec3::new(0.3, 1.9, 2.4), 96);
    let here = bake_points(&gdibl(&scene, &probes, None), &points, &USUAL);
    let mut ratios = Vec::new();
    for turn in 0..6 {
        let stream = Stream::new(Sampler::Random, 21, turn, 0);
        let ([a, b], [c, d]) = (stream.point(0, 0), stream.point(0, 1));
        let rotation =
            DQuat::from_xyzw(a.into(), b.into(), c.into(), d.into()) * 2.0 - DQuat::from_xyzw(1.0, 1.0, 1.0, 1.0);
        let rotation = rotation.normalize();
        let placement = Placement { scale: 1.0, rotation, offset: DVec3::ZERO };
        let (scene, probes) = (placement.scene(&scene), placement.probes(&probes));
        let seed = BakeSettings { seed: 100 + turn, ..USUAL };
        let there = bake_points(&gdibl(&scene, &probes, None), &placement.points(&points), &seed);
        ratios.push(turned_ratio(&here, &there, rotation));
    }
    let worst = ratios.iter().copied().fold(0.0, f64::max);
    table.row(
        "the whole input turned by 6 rotations, 96 nodes",
        "RMS difference of E over what standard errors promise ≤ 1.25",
        &format!("{:.2} to {worst:.2}", ratios.iter().copied().fold(f64::INFINITY, f64::min)),
        worst <= 1.25,
    );

    let scaled = |scale: f32| {
        let mut probes = coloured_probes();
        probes.iter_mut().for_each(|probe| probe.panorama.tint([scale; 3]));
        let sky = distant(panorama(32, |d| [1.5 + d.y, 1.0, 1.0 + d.x * d.z].map(|v| v * scale)));
        let mut open = scene.clone();
        remove_ceiling(&mut open);
        bake_points(&gdibl(&open, &probes, Some(&sky)), &places(), &USUAL).sh.to_vec()
    };
    let unit = scaled(1.0);
    let change = [1e-6f32, 1e6].map(|scale| {
        let expected: Vec<f32> = unit.iter().map(|v| v * scale).collect();
        difference(&scaled(scale), &expected)
    });
    table.at_most(
        "light × 1e-6, 1e6; probes and sky",
        "change of the largest coefficient",
        1e-5,
        change[0].max(change[1]),
    );
}

/// Root mean square difference of E between nodes and their turned twins over that of the standard errors.
fn turned_ratio(here: &Baked, there: &Baked, rotation: DQuat) -> f64 {
    let turn = DMat3::from_quat(rotation).as_mat3();
    let errors = [here, there].map(standard_errors);
    let promised: f64 = errors.iter().flatten().map(|error| error * error).sum();
    let mut found = 0.0;
    for node in 0..here.len() {
        let (a, b) = (sh_of(here, node), sh_of(there, node));
        let (e, turned) = (a.convolve(), b.convolve());
        for normal in fibonacci_sphere(26) {
            let (e, turned) = (e.evaluate(normal.to_array()), turned.evaluate((turn * normal).to_array()));
            found += (0..3).map(|c| f64::from(e[c] - turned[c]).powi(2)).sum::<f64>() / 78.0;
        }
    }
    (found / promised).sqrt()
}
