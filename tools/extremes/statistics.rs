//! Standard errors, and error against directions.

use crate::level::*;
use crate::shared::*;
use crate::table::Table;
use gdibl_baker::bake::{BakeSettings, Baked, Nodes};
use gdibl_tools::{bake_all, read_lighting, read_scene, read_truth};
use glam::DVec3;
use std::path::Path;

pub fn rows(table: &mut Table) {
    let assets = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/uffizi-box"));
    let scene = read_scene(&assets.join("empty-box.glb"));
    let (probes, distant) = read_lighting(assets);
    let function = gdibl(&scene, &probes, Some(&distant));
    let truth = read_truth(assets, &["grid"]);
    let points: Vec<DVec3> =
        truth.iter().flat_map(|set| set.positions.iter().map(|p| DVec3::from(*p))).take(64).collect();
    let nodes = Nodes::Points(points.clone());
    for samples in [256, 1024, 4096] {
        let seeds = if samples == 4096 { 8 } else { 24 };
        let of = |seed| bake_all(&function, &nodes, &BakeSettings { samples, seed, ..SMALL });
        let all: Vec<Baked> = (0..seeds).map(of).collect();
        // The mean over seeds; each deviates from it by a little less than from the truth.
        let mut mean = all[0].clone();
        mean.sh.update(|node, values| {
            for (i, value) in values.iter_mut().enumerate() {
                *value = (all.iter().map(|baked| f64::from(baked.node(node)[i])).sum::<f64>() / seeds as f64) as f32;
            }
        });
        let (mut claimed, mut found) = (0.0, 0.0);
        for baked in &all {
            for (node, error) in standard_errors(baked).into_iter().enumerate() {
                let truth = sh_of(&mean, node);
                let mut difference = sh_of(baked, node);
                difference.add_scaled(&truth, -1.0);
                found += (strength(&difference) / strength(&truth)).powi(2) * seeds as f64 / (seeds - 1) as f64;
                claimed += (error / strength(&truth)).powi(2);
            }
        }
        let count = (seeds as usize * points.len()) as f64;
        let ratio = (claimed / found).sqrt();
        table.row(
            &format!("standard error in the box, {} nodes × {seeds} seeds, {samples} samples", points.len()),
            "RMS of claimed over true errors 0.85 to 1.18",
            &format!(
                "{ratio:.3}: claimed {}, true {}",
                percent((claimed / count).sqrt()),
                percent((found / count).sqrt())
            ),
            (0.85..1.18).contains(&ratio),
        );
    }
    let converged = bake_all(&function, &nodes, &BakeSettings { samples: 1 << 17, seed: 1 << 40, ..SMALL });
    let budgets = [64, 256, 1024, 4096, 16_384];
    let error = |samples: &u64| {
        let baked = bake_all(&function, &nodes, &BakeSettings { samples: *samples, seed: 1, ..SMALL });
        error_of(&baked, |node| sh_of(&converged, node)).relative_rmse
    };
    let errors: Vec<f64> = budgets.iter().map(error).collect();
    let slope = (errors[4] / errors[0]).ln() / (16_384f64 / 64.0).ln();
    let falls = errors.windows(2).all(|pair| pair[1] < 0.75 * pair[0]);
    table.row(
        "error against samples in the box, 64 to 16384, against 2^17",
        "log-log slope ≤ -0.5; four times the samples leave < 0.75 of the error",
        &format!("slope {slope:.2}: {}", errors.iter().map(|e| percent(*e)).collect::<Vec<_>>().join(", ")),
        slope <= -0.5 && falls,
    );
}
