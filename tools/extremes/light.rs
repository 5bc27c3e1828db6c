//! Bright pixels of skies and probes.

use crate::exact::{exact_sh, pixel_on_walls};
use crate::level::*;
use crate::shared::*;
use crate::table::Table;
use gdibl_baker::bake::{BakeSettings, Baked, Nodes};
use gdibl_baker::scene::{Role, Scene};
use gdibl_runtime::RadianceSh;
use gdibl_runtime::grid::Grid;
use gdibl_tools::bake_all;
use glam::DVec3;

pub fn rows(table: &mut Table) {
    sun_in_one_pixel(table);
    fireflies(table);
    bright_pixel_of_a_probe(table);
}

fn sun_in_one_pixel(table: &mut Table) {
    let scene = Scene::default();
    let nodes = [DVec3::ZERO; 24];
    for sun in [1e5, 1e9] {
        let mut worst = [[(0.0f64, ""); 2]; 2];
        let mut firefly = 0.0f64;
        for width in [64usize, 512] {
            for (place, x, y) in sun_places(width) {
                let image = sky_with_sun(width, [x, y], sun);
                let truth = exact_sh(&image, 2);
                let sky = distant(image);
                for (i, samples) in [1024, 2048].into_iter().enumerate() {
                    let baked =
                        bake_points(&gdibl(&scene, &[], Some(&sky)), &nodes, &BakeSettings { samples, ..SMALL });
                    let error = error_of(&baked, |_| truth);
                    for (kind, value) in [error.relative_rmse, error.per_node.max].into_iter().enumerate() {
                        if value > worst[i][kind].0 {
                            worst[i][kind] = (value, place);
                        }
                    }
                    let strengths: Vec<f64> = (0..nodes.len()).map(|node| strength(&sh_of(&baked, node))).collect();
                    firefly = firefly.max(strengths.iter().copied().fold(0.0, f64::max) / median(strengths));
                }
            }
        }
        for (i, (samples, bound)) in [(1024, 0.015), (2048, 0.01)].into_iter().enumerate() {
            let [(rms, place), (node, _)] = worst[i];
            table.row(
                &format!("sun of {sun:.0e} in one pixel, 6 places (poles, seam) × 64, 512 columns; {samples} samples"),
                &format!("relative RMSE of E ≤ {}", percent(bound)),
                &format!("{} ({place}); worst of 24 nodes {}", percent(rms), percent(node)),
                rms <= bound,
            );
        }
        table.row(
            &format!("the same, sun of {sun:.0e}"),
            "brightest node ≤ 1.2 × the median",
            &format!("{firefly:.3}"),
            firefly <= 1.2,
        );
    }
}

/// The largest of a grid node over the median of its neighbours.
fn largest_over_neighbours(baked: &Baked, grid: &Grid) -> f64 {
    let [nx, ny, nz] = grid.counts.map(|c| c as i64);
    let strengths: Vec<f64> = (0..baked.len()).map(|node| strength(&sh_of(baked, node))).collect();
    let at = |x: i64, y: i64, z: i64| strengths[(x + nx * (y + ny * z)) as usize];
    let inside = |p: [i64; 3]| (0..nx).contains(&p[0]) && (0..ny).contains(&p[1]) && (0..nz).contains(&p[2]);
    let mut largest = 0.0f64;
    for index in 0..nx * ny * nz {
        let [x, y, z] = [index % nx, index / nx % ny, index / nx / ny];
        let around = (0..27).map(|i| [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1]);
        let around = around.filter(|p| inside(*p) && *p != [x, y, z]).map(|[x, y, z]| at(x, y, z)).collect();
        largest = largest.max(at(x, y, z) / median(around));
    }
    largest
}

fn fireflies(table: &mut Table) {
    let mut scene = room_with_pillar();
    remove_ceiling(&mut scene);
    let grid = Grid { min: [-2.8, -0.8, -1.8], max: [2.8, 1.8, 2.3], counts: [6, 4, 6] };
    let probes = coloured_probes();
    for sun in [1e5, 1e9] {
        let image = panorama(256, |d| [1.0 + d.y, 1.0, 1.2 + d.x * d.z]);
        let sky = distant(with_pixel(&image, [70, 30], [sun; 3]));
        let function = gdibl(&scene, &probes, Some(&sky));
        let nodes = Nodes::Grid(grid);
        let [few, many] = [1024, 16_384].map(|samples| bake_all(&function, &nodes, &BakeSettings { samples, ..SMALL }));
        let [found, converged] = [&few, &many].map(|baked| largest_over_neighbours(baked, &grid));
        let own = |node: usize| strength(&sh_of(&few, node)) / strength(&sh_of(&many, node));
        let worst = (0..nodes.len()).map(own).fold(0.0, f64::max);
        table.row(
            &format!("sun of {sun:.0e} over a room without ceiling, 144 nodes, 1024 samples: no firefly"),
            "brightest over its neighbours' median ≤ 1.2 × that of 16384 samples",
            &format!("{found:.3}, converged {converged:.3}; a node against itself converged ≤ {worst:.3}"),
            found <= 1.2 * converged && worst <= 1.2,
        );
    }
}

/// Bakes whose errors are put together.
const SEEDS: u64 = 4;

fn bright_pixel_of_a_probe(table: &mut Table) {
    let walls = [DVec3::new(-3.0, -1.0, -2.0), DVec3::new(3.0, 2.0, 2.5)];
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(walls[0], walls[1]));
    let points = spread(DVec3::new(-2.5, -0.5, -1.5), DVec3::new(2.5, 1.5, 2.0), 24);
    let plain = [probe(DVec3::new(0.3, 0.4, 0.2), 256, |d| [1.0 + d.y, 1.0, 1.2 + d.x * d.z])];
    let rest = bake_points(&gdibl(&scene, &plain, None), &points, &BakeSettings { samples: 1 << 17, ..SMALL });
    // On a wall, over an edge of the room, high up.
    for (place, pixel) in [("on a wall", [70usize, 50usize]), ("over an edge", [17, 70]), ("near a pole", [100, 4])] {
        for bright in [1e5, 1e9] {
            let mut probes = plain.clone();
            let image = &mut probes[0].panorama;
            let before = image.pixel(pixel[0], pixel[1]).x;
            *image = with_pixel(image, pixel, [bright; 3]);
            let truth: Vec<RadianceSh> = (0..points.len())
                .map(|node| {
                    let light = f64::from(bright - before);
                    let mut sum = pixel_on_walls(walls, probes[0].position, 256, pixel, light, points[node]);
                    sum.add_scaled(&sh_of(&rest, node), 1.0);
                    sum
                })
                .collect();
            let function = gdibl(&scene, &probes, None);
            for (samples, bound) in [(1024, 0.015), (2048, 0.01)] {
                // One seed alone tells the RMSE of 24 nodes to a seventh.
                let (mut square, mut claimed, mut worst) = (0.0, 0.0, 0.0f64);
                let light: f64 = truth.iter().map(|truth| strength(truth).powi(2)).sum();
                for seed in 0..SEEDS {
                    let baked = bake_points(&function, &points, &BakeSettings { samples, seed, ..SMALL });
                    let error = error_of(&baked, |node| truth[node]);
                    square += error.relative_rmse.powi(2) / SEEDS as f64;
                    worst = worst.max(error.per_node.max);
                    claimed += standard_errors(&baked).iter().map(|v| v * v).sum::<f64>() / light / SEEDS as f64;
                }
                let found = square.sqrt();
                table.row(
                    &format!("{bright:.0e} in one of 256 × 128 pixels of a probe in a room, {place}, 24 nodes × {SEEDS} seeds; {samples} samples"),
                    &format!("relative RMSE of E ≤ {}", percent(bound)),
                    &format!(
                        "{}, worst node {}; claimed {}",
                        percent(found),
                        percent(worst),
                        percent(claimed.sqrt())
                    ),
                    found <= bound,
                );
            }
        }
    }
}
