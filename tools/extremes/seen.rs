//! What no probe has seen.

use crate::level::*;
use crate::shared::*;
use crate::table::Table;
use gdibl_baker::bake::{BakeSettings, Baked, INTERVAL_95, WHOLE_INTERVAL_95};
use gdibl_baker::capture::CaptureSettings;
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::radiance::unseen::Unseen;
use gdibl_baker::scene::{Role, Scene};
use glam::DVec3;
use std::f64::consts::PI;

pub fn rows(table: &mut Table) {
    third_unseen(table);
    half_seen(table);
}

fn third_unseen(table: &mut Table) {
    // A square that no probe has seen takes a third of what a node at the origin sees.
    let half = (1.0 / (1.0 / (PI / 3.0).sin() - 1.0)).sqrt();
    let mut scene = Scene::default();
    let [a, b, c, d] = [[-half, -half], [half, -half], [half, half], [-half, half]].map(|[x, y]| DVec3::new(x, y, 1.0));
    add(&mut scene, Role::Environment, &[[a, c, b], [a, d, c]]);
    let sky = distant(panorama(64, |d| [1.5 + d.y, 1.2 + d.x, 1.0 - 0.5 * d.z]));
    let function = gdibl(&scene, &[], Some(&sky));
    let line: Vec<DVec3> = (0..41).map(|i| DVec3::X * (0.01 * f64::from(i))).collect();
    let baked = bake_points(&function, &line, &USUAL);
    let coverage = f64::from(baked.coverage[0]);
    table.row(
        "no probe has seen a third of the level",
        "coverage within 1 % of 2/3",
        &format!("{coverage:.4}"),
        (coverage - 2.0 / 3.0).abs() <= 0.01,
    );
    let same = bake_points(&function, &line, &USUAL) == baked;
    let other = bake_points(&function, &line, &BakeSettings { seed: 9, samples: 16_384, ..SMALL });
    let change = error_of(&other, |node| sh_of(&baked, node)).relative_rmse;
    let step = |node: usize| {
        let mut step = sh_of(&baked, node + 1);
        step.add_scaled(&sh_of(&baked, node), -1.0);
        strength(&step) / strength(&sh_of(&baked, node))
    };
    let largest = (0..line.len() - 1).map(step).fold(0.0, f64::max);
    table.row(
        "the same: fill",
        "same bits again; other seed and four times the samples change E by ≤ 2 %; nodes 1 cm apart by ≤ 2 %",
        &format!("{}; {}; {}", if same { "same" } else { "other" }, percent(change), percent(largest)),
        same && change <= 0.02 && largest <= 0.02,
    );
}

/// Half of a room is hidden from the only probe. Nodes near the screen's edge see about as much of one half as of the other.
fn half_seen(table: &mut Table) {
    let (min, max) = (DVec3::new(-3.0, 0.0, -2.0), DVec3::new(3.0, 3.0, 2.0));
    let mut scene = Scene::default();
    add_of(&mut scene, &box_of(min, max), 0.6, 0.0);
    add_of(&mut scene, &solid_of(DVec3::new(-0.05, 0.0, -2.0), DVec3::new(0.05, 3.0, 0.6)), 0.6, 0.0);
    add_of(&mut scene, &lamp(DVec3::new(-1.5, 2.9, -0.5), 0.4), 0.0, 20.0);
    add_of(&mut scene, &lamp(DVec3::new(1.5, 2.9, -0.5), 0.3), 0.0, 20.0);
    let path = Path::new(&scene, None, PathSettings::default());
    let settings = CaptureSettings { width: 128, samples: 64, ..CaptureSettings::default() };
    let probes = [captured(&path, DVec3::new(-1.8, 1.5, -1.0), &settings)];
    let points: Vec<DVec3> = spread(DVec3::new(-0.4, 0.4, 0.7), DVec3::new(0.5, 2.6, 1.8), 16);
    let truth = bake_points(&path, &points, &BakeSettings { samples: 1 << 16, seed: 99, ..SMALL });
    for unseen in [Unseen::Fill, Unseen::Trace] {
        let mut function = gdibl(&scene, &probes, None);
        function.choose_unseen(unseen, &points);
        let seeds = 12;
        let bakes: Vec<Baked> = (0..seeds)
            .map(|seed| bake_points(&function, &points, &BakeSettings { samples: 1024, seed, ..SMALL }))
            .collect();
        let (mut inside, mut between) = (0, 0);
        let covered = bakes[0].coverage.iter().sum::<f32>() / points.len() as f32;
        for (i, baked) in bakes.iter().enumerate() {
            let (noise, next) = (standard_errors(baked), &bakes[(i + 1) % bakes.len()]);
            let next_noise = standard_errors(next);
            let floor = 0.1 * median((0..points.len()).map(|node| strength(&sh_of(baked, node))).collect());
            for node in 0..points.len() {
                let off = |other: &Baked| {
                    let mut off = sh_of(baked, node);
                    off.add_scaled(&sh_of(other, node), -1.0);
                    strength(&off)
                };
                let bias = f64::from(baked.systematic_error[node]) * strength(&sh_of(baked, node)).max(floor);
                inside += u32::from(off(&truth) <= WHOLE_INTERVAL_95 * noise[node].hypot(bias));
                between += u32::from(off(next) <= INTERVAL_95 * noise[node].hypot(next_noise[node]));
            }
        }
        let count = f64::from(seeds as u32) * points.len() as f64;
        let [inside, between] = [inside, between].map(|n| f64::from(n) / count);
        let error = error_of(&bakes[0], |node| sh_of(&truth, node)).relative_rmse;
        table.row(
            &format!("half-seen nodes (coverage {covered:.2}), {unseen:?}, 16 nodes × {seeds} seeds"),
            "whole errors cover the truth at ≥ 92 %; noise covers the difference of two seeds at ≥ 92 %",
            &format!("{}; {}; off by {}", percent(inside), percent(between), percent(error)),
            inside >= 0.92 && between >= 0.92,
        );
    }
}
