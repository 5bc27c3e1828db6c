//! How probes share a point.

use crate::level::*;
use crate::table::Table;
use gdibl_baker::bake::BakeSettings;
use gdibl_baker::radiance::blend::{BlendRule, View};
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings, Probe};
use glam::{DVec3, Vec3};

pub fn rows(table: &mut Table) {
    let at = |distance, cosine, angle, pixels| View { distance, cosine, angle, pixels };
    let crowd: Vec<View> = (0..64).map(|i| at(1.0 + i as f32, 0.5, 0.05 * i as f32, (8 << (i % 8)) as f32)).collect();
    let cases: [(&str, Vec<View>); 8] = [
        ("one probe", vec![at(2.0, 0.3, 1.0, 512.0)]),
        ("64 probes", crowd),
        ("two at one place", vec![at(2.0, 0.5, 0.7, 512.0); 2]),
        ("all angles equal", (1..9).map(|i| at(i as f32, 0.5, 0.7, 512.0)).collect()),
        ("zero angle", vec![at(1.0, 0.5, 0.0, 512.0), at(1.0, 0.5, 0.0, 512.0), at(2.0, 0.5, 0.5, 512.0)]),
        ("grazing to 1e-7", vec![at(1.0, 1e-7, 1.5, 512.0), at(2.0, 1e-7, 1.0, 512.0), at(3.0, 1e-6, 0.5, 512.0)]),
        ("mixed resolutions", [2.0, 128.0, 1.3e8].map(|pixels| at(1.0, 0.5, 0.3, pixels)).into()),
        ("from 1e-30 to 1e6 away", vec![at(1e-30, 0.5, 3.1, 512.0), at(1e6, 1.0, 1e-20, 512.0)]),
    ];
    for (case, views) in cases {
        let (mut sum_off, mut broken) = (0.0f64, 0);
        for rule in every_rule() {
            let weights = weigh(rule, &views);
            broken += weights.iter().filter(|w| !(w.is_finite() && **w >= 0.0)).count();
            sum_off = sum_off.max((weights.iter().map(|w| f64::from(*w)).sum::<f64>() - 1.0).abs());
        }
        table.row(
            &format!("{case}; {} rules, k of 0, 1, 4, 1e3", every_rule().len()),
            "weights finite, ≥ 0, sum 1 within 1e-6",
            &format!("{broken} broken, sum off by {sum_off:.1e}"),
            broken == 0 && sum_off <= 1e-6,
        );
    }
    coincident(table);
    continuity(table);
}

/// Weights of probes as a surface point blends them, best first.
fn weigh(rule: BlendRule, views: &[View]) -> Vec<f32> {
    let mut merits: Vec<f32> = views.iter().map(|view| rule.merit(view)).collect();
    merits.sort_by(|a, b| b.total_cmp(a));
    merits.truncate(rule.reach());
    let mut weights = Vec::new();
    rule.weights(&merits, &mut weights);
    let sum: f32 = weights.iter().sum();
    weights.iter().map(|w| w / sum).collect()
}

fn continuity(table: &mut Table) {
    let scene = plane();
    let probes = unlike_probes();
    for rule in [BlendRule::Distance(2.0), BlendRule::AngularSmooth(2.0), BlendRule::Footprint(4.0)] {
        let function = Gdibl::new(&scene, &probes, None, GdiblSettings { blend: rule, ..GdiblSettings::default() });
        let largest_step = |count: u32| {
            let at = |i: u32| DVec3::new(-9.0 + 18.0 * f64::from(i) / f64::from(count), 0.37, 0.0);
            let viewer = DVec3::new(0.3, -4.0, 2.5);
            let light: Vec<Vec3> = (0..=count).map(|i| seen(&function, viewer, at(i))).collect();
            f64::from(light.windows(2).map(|pair| (pair[1] - pair[0]).length()).fold(0.0, f32::max))
        };
        let [coarse, fine] = [4000, 64_000].map(largest_step);
        table.row(
            &format!("{rule} over a plane, 5 probes of unlike colours"),
            "steps of ε/16 change light by about 1/16 (≤ 1/8) of what ε does",
            &format!("{coarse:.1e}, then {fine:.1e}: 1/{:.1}", coarse / fine),
            fine <= coarse / 8.0,
        );
    }
}

fn coincident(table: &mut Table) {
    let scene = room_with_pillar();
    let of = |lights: &[[f32; 3]]| -> Vec<Probe> {
        lights
            .iter()
            .map(|light| probe(DVec3::new(-2.0, 0.2, -1.0), 32, |d| light.map(|l| l * (1.0 + 0.5 * d.x))))
            .collect()
    };
    let (mut same, mut mean) = (0.0f64, 0.0f64);
    for blend in every_rule() {
        let bake = |lights: &[[f32; 3]]| {
            let probes = of(lights);
            let function = Gdibl::new(&scene, &probes, None, GdiblSettings { blend, ..GdiblSettings::default() });
            bake_points(&function, &places(), &BakeSettings { importance: false, ..SMALL })
        };
        let one = bake(&[[2.0, 1.0, 3.0]]);
        same = same.max(difference(&bake(&[[2.0, 1.0, 3.0]; 3]).sh.to_vec(), &one.sh.to_vec()));
        // The nearest alone is one of them; every other rule takes their mean.
        if blend != BlendRule::Nearest {
            mean = mean.max(difference(&bake(&[[1.0, 1.0, 2.0], [3.0, 1.0, 4.0]]).sh.to_vec(), &one.sh.to_vec()));
        }
    }
    table.row(
        "coincident probes, all rules: three alike; two of unlike light",
        "the light of one; the mean of both; within 1e-5 of the largest coefficient",
        &format!("{same:.1e}; {mean:.1e}"),
        same <= 1e-5 && mean <= 1e-5,
    );
}
