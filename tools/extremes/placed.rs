//! Two real levels, at other scales and far away.

use crate::level::*;
use crate::shared::*;
use crate::table::Table;
use gdibl_baker::bake::{BakeSettings, Baked};
use gdibl_baker::radiance::Distant;
use gdibl_baker::radiance::path::{Path, PathSettings};
use gdibl_baker::scene::Scene;
use gdibl_tools::made_levels::{aisle, two_storey};
use gdibl_tools::read_scene;
use glam::{DQuat, DVec3};
use std::path::PathBuf;

/// Below GDIBL_INPUTS.
const LEVELS: [(&str, &str, Make); 2] = [
    ("living room", "levels/godot/living_room.glb", two_storey),
    ("pandora", "levels/cube2/sauerbraten_pandora.glb", aisle),
];
/// What stands in where the real level is not there.
type Make = fn() -> Scene;

pub fn rows(table: &mut Table) {
    let inputs = std::env::var_os("GDIBL_INPUTS").map(PathBuf::from);
    let sky = distant(panorama(64, |d| [1.5 + d.y, 1.2 + 0.5 * d.x, 1.0 - 0.5 * d.z]));
    for (name, file, make) in LEVELS {
        let path = inputs.as_ref().map(|folder| folder.join(file)).filter(|path| path.exists());
        match path {
            Some(path) => level(table, name, read_scene(&path), &sky),
            None => {
                let why = format!("no {file} below GDIBL_INPUTS; a made level stands in");
                table.skip(&format!("{name} at other scales, far away"), "as below", &why);
                level(table, &format!("a made level for {name}"), make(), &sky);
            }
        }
    }
}

fn level(table: &mut Table, name: &str, mut scene: Scene, sky: &Distant) {
    // Their lights would need other intensities at other scales.
    scene.lights.clear();
    let (min, max) = scene.bounds(|_| true).expect("a level with triangles");
    let points = spread(min.lerp(max, 0.1), min.lerp(max, 0.9), 48);
    let bake = |placement: &Placement, settings: &BakeSettings| {
        let placed = placement.scene(&scene);
        let path = Path::new(&placed, Some(sky), PathSettings::default());
        bake_points(&path, &placement.points(&points), settings)
    };
    let here = Placement { scale: 1.0, rotation: DQuat::IDENTITY, offset: DVec3::ZERO };
    let usual = BakeSettings { samples: 1024, ..SMALL };
    let reference = bake(&here, &usual);
    for (scale, offset) in [(1e-3, 0.0), (1e3, 0.0), (1.0, 1e6), (1e-3, 1e6), (1e3, 1e6)] {
        let offset = DVec3::new(offset, -offset, offset / 3.0);
        let placed = bake(&Placement { scale, rotation: DQuat::IDENTITY, offset }, &usual);
        let same = reference.standing.iter().zip(&placed.standing).filter(|(a, b)| a == b).count();
        let change = change_of_valid(&placed, &reference);
        let claims = standard_errors(&reference);
        let lit: Vec<usize> = reference.valid_nodes().collect();
        let square = |values: &dyn Fn(usize) -> f64| lit.iter().map(|node| values(*node).powi(2)).sum::<f64>();
        let noise = (square(&|node| claims[node]) / square(&|node| strength(&sh_of(&reference, node)))).sqrt();
        table.row(
            &format!("{name} × {scale}, moved by {:.0e} m, {} triangles, 48 nodes", offset.x, triangles(&scene)),
            "the same nodes valid, for the same reason; E changes by less than the noise it claims",
            &format!("{same} of 48 stand alike; {} for a noise of {}", percent(change), percent(noise)),
            same == points.len() && change <= noise,
        );
    }
}

fn triangles(scene: &Scene) -> usize {
    scene.meshes.iter().map(|mesh| mesh.triangles.len()).sum()
}

/// Relative RMSE of the change of E at nodes that are valid in both.
fn change_of_valid(found: &Baked, expected: &Baked) -> f64 {
    let valid = |node: &usize| found.is_valid(*node) && expected.is_valid(*node);
    let pairs = (0..found.len()).filter(valid).map(|node| {
        let mut off = sh_of(found, node);
        off.add_scaled(&sh_of(expected, node), -1.0);
        (strength(&off).powi(2), strength(&sh_of(expected, node)).powi(2))
    });
    let (off, all) = pairs.fold((0.0, 0.0), |(a, b), (x, y)| (a + x, b + y));
    (off / all).sqrt()
}
