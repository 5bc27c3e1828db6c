//! What the tools share: the uffizi box with its truth, and baking it; levels made here; ways to keep light in few numbers.

pub mod decoders;
pub mod encodings;
pub mod least_squares;
pub mod made_levels;

use gdibl_baker::Control;
use gdibl_baker::analyse::{Truth, choose_sets};
use gdibl_baker::bake::{BakeSettings, Baked, Nodes, bake};
use gdibl_baker::import::gltf::{GltfOptions, TextureNeeds, read_level};
use gdibl_baker::import::image::{ReadOptions, read_image};
use gdibl_baker::import::reference::read_reference;
use gdibl_baker::panorama::{Panorama, to_lat_long};
use gdibl_baker::radiance::gdibl::Probe;
use gdibl_baker::radiance::{Distant, RadianceFunction};
use gdibl_baker::scene::Scene;
use glam::{DVec3, Quat};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Where the three probes of the box were taken, world metres.
pub const BOX_PROBES: [DVec3; 3] =
    [DVec3::new(0.0, 1.0, 2.999), DVec3::new(0.0, 1.0, 0.0), DVec3::new(0.0, 1.0, -2.999)];
/// Centres of the report's three spheres, world metres.
pub const BOX_SPHERES: [DVec3; 3] = [DVec3::new(0.0, 1.0, 2.0), DVec3::new(0.0, 1.0, 0.0), DVec3::new(0.0, 1.0, -2.0)];
/// Their radius, metres.
pub const SPHERE_RADIUS: f32 = 0.5;
/// Points leave the exact sphere by this much, metres: the level's spheres are polyhedra.
pub const OFF_THE_SURFACE: f64 = 1e-3;

/// The sets of a lighting's `reference.json` that have these names.
pub fn read_truth(lighting: &Path, names: &[&str]) -> Vec<Truth> {
    let truths = read_reference(&lighting.join("reference.json")).unwrap_or_else(|e| panic!("{e}"));
    let names: Vec<String> = names.iter().map(ToString::to_string).collect();
    choose_sets(truths, &names).unwrap_or_else(|name| panic!("no set '{name}' in the reference"))
}

/// A panorama in its own orientation.
pub fn read_panorama(path: &Path) -> Panorama {
    let imported = read_image(path, &ReadOptions::default()).unwrap_or_else(|e| panic!("{e}"));
    let mapping = imported.layout(path, None).unwrap_or_else(|e| panic!("{e}"));
    to_lat_long(&imported.image, mapping, None)
}

/// A level with all its textures, because tools trace paths in it, or the end of the tool.
pub fn read_scene(path: &Path) -> Scene {
    let options = GltfOptions { textures: TextureNeeds::All, ..GltfOptions::default() };
    read_level(path, &options).unwrap_or_else(|e| panic!("{e}"))
}

/// `probe_0.exr` to `probe_2.exr` and `distant.exr` of a lighting of the box.
pub fn read_lighting(folder: &Path) -> (Vec<Probe>, Distant) {
    let probes = BOX_PROBES.iter().enumerate().map(|(i, &position)| Probe {
        name: format!("probe_{i}.exr"),
        position,
        rotation: Quat::IDENTITY,
        exposure_stops: 0.0,
        panorama: read_panorama(&folder.join(format!("probe_{i}.exr"))),
    });
    (probes.collect(), read_distant(&folder.join("distant.exr")))
}

/// A distant panorama as it stands in its file.
pub fn read_distant(path: &Path) -> Distant {
    Distant {
        name: path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        rotation: Quat::IDENTITY,
        exposure_stops: 0.0,
        panorama: read_panorama(path),
        without_sun: None,
    }
}

/// Bakes to the end.
pub fn bake_all(function: &impl RadianceFunction, nodes: &Nodes, settings: &BakeSettings) -> Baked {
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
    bake(nodes, function, settings, &control).expect("nobody interrupts a tool")
}
