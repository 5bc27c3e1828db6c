//! What rows of several areas are made with.

use crate::level::*;
use crate::table::Table;
use gdibl_baker::Control;
use gdibl_baker::analyse::{IrradianceError, Light, Pair};
use gdibl_baker::bake::{BakeSettings, Baked, Nodes};
use gdibl_baker::capture::{CaptureSettings, capture};
use gdibl_baker::panorama::Panorama;
use gdibl_baker::radiance::RadianceFunction;
use gdibl_baker::radiance::gdibl::Probe;
use gdibl_baker::radiance::path::Path;
use gdibl_baker::sampling::fibonacci_sphere;
use gdibl_baker::scene::{Material, Role, Scene};
use gdibl_runtime::RadianceSh;
use gdibl_tools::bake_all;
use glam::{DVec3, Quat, Vec3};
use std::f64::consts::PI;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

/// What is not said otherwise: 4096 samples.
pub const USUAL: BakeSettings = BakeSettings { samples: 4096, ..SMALL };

pub fn percent(share: f64) -> String {
    format!("{:.2} %", share * 100.0)
}

pub fn quiet<T>(work: impl FnOnce(&Control) -> T) -> T {
    work(&Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None })
}

/// Error of E at all nodes.
pub fn error_of(baked: &Baked, truth: impl Fn(usize) -> RadianceSh) -> IrradianceError {
    let pair = |node| Pair { found: sh_of(baked, node), truth: Light::Radiance(truth(node)), variance: None };
    IrradianceError::of(&(0..baked.len()).map(pair).collect::<Vec<_>>())
}

/// Largest relative error of E = πL over 100 normals.
pub fn off_the_furnace(sh: &RadianceSh, radiance: [f32; 3]) -> f64 {
    let irradiance = sh.convolve();
    let errors = fibonacci_sphere(100).into_iter().flat_map(|n| {
        let e = irradiance.evaluate(n.to_array());
        [0, 1, 2].map(|c| (f64::from(e[c]) / (PI * f64::from(radiance[c])) - 1.0).abs())
    });
    errors.fold(0.0, f64::max)
}

/// Places all over a box, by the golden ratio's generalisation (Roberts, 2018).
pub fn spread(min: DVec3, max: DVec3, count: usize) -> Vec<DVec3> {
    let steps = DVec3::new(0.819_172_513_396_164, 0.671_043_606_703_789, 0.549_700_477_901_970);
    (1..=count).map(|i| min + (max - min) * (steps * i as f64).fract()).collect()
}

pub fn remove_ceiling(scene: &mut Scene) {
    let room = &mut scene.meshes[0];
    let top = room.positions.iter().fold(f64::NEG_INFINITY, |m, p| m.max(p.y));
    room.triangles.retain(|t| t.iter().any(|&i| room.positions[i as usize].y < top));
}

/// Adds triangles of a material of their own.
pub fn add_of(scene: &mut Scene, triangles: &[Triangle], albedo: f32, emission: f32) {
    add(scene, Role::Environment, triangles);
    let base_color = Vec3::splat(albedo).extend(1.0);
    let material = Material { base_color, metallic: 0.0, emission: Vec3::splat(emission), ..Material::default() };
    scene.materials.push(material);
    scene.meshes.last_mut().expect("just added").material = scene.materials.len() as u32 - 1;
}

/// A square that shines down.
pub fn lamp(middle: DVec3, half: f64) -> Vec<Triangle> {
    let corner = |x: f64, z: f64| middle + DVec3::new(x * half, 0.0, z * half);
    let [a, b, c, d] = [corner(-1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0)];
    vec![[a, c, b], [a, d, c]]
}

pub fn captured(path: &Path, position: DVec3, settings: &CaptureSettings) -> Probe {
    let image = quiet(|control| capture(path, position, 0, settings, control)).expect("nobody interrupts").image;
    Probe {
        name: "captured".into(),
        position,
        rotation: Quat::IDENTITY,
        exposure_stops: 0.0,
        panorama: Panorama::new(image.width, image.height, image.pixels, image.distance),
    }
}

/// How often standard errors cover the truth.
pub struct Covered {
    /// Of all nodes and seeds.
    pub share: f64,
    /// Of the node where they do least.
    pub worst: f64,
    /// RMS of the claimed errors over that of the true ones.
    pub ratio: f64,
}

/// How often 3.18 standard errors (Student's t of 3 degrees, 95 %) cover the truth, over nodes and seeds.
pub fn covered(function: &impl RadianceFunction, points: &[DVec3], samples: u64, seeds: u64) -> Covered {
    let nodes = Nodes::Points(points.to_vec());
    let of = |samples, seed| bake_all(function, &nodes, &BakeSettings { samples, seed, ..SMALL });
    let truth = of(samples * 256, 1 << 40);
    let (mut inside, mut claimed, mut found) = (vec![0; points.len()], 0.0, 0.0);
    for seed in 0..seeds {
        let baked = of(samples, seed);
        let claims = standard_errors(&baked);
        for (node, claim) in claims.into_iter().enumerate() {
            let mut difference = sh_of(&baked, node);
            difference.add_scaled(&sh_of(&truth, node), -1.0);
            let (error, light) = (strength(&difference), strength(&sh_of(&baked, node)));
            inside[node] += u32::from(error <= 3.18 * claim);
            // Each node counts alike.
            claimed += (claim / light).powi(2);
            found += (error / light).powi(2);
        }
    }
    let share = |inside: u32| f64::from(inside) / seeds as f64;
    let worst = inside.iter().copied().min().map_or(0.0, share);
    Covered { share: share(inside.iter().sum()) / points.len() as f64, worst, ratio: (claimed / found).sqrt() }
}

pub fn covered_row(table: &mut Table, case: &str, found: Covered) {
    let Covered { share, worst, ratio } = found;
    let measured = format!(
        "{} covered, worst node {}; RMS of claimed over true errors {ratio:.2}",
        percent(share),
        percent(worst)
    );
    table.row(case, "3.18 standard errors of E cover the truth at ≥ 92 % of nodes and seeds", &measured, share >= 0.92);
}

/// A folder that goes with the tool.
pub struct Folder(pub PathBuf);

impl Folder {
    pub fn new() -> Folder {
        let path = std::env::temp_dir().join(format!("gdibl-extremes-{}", std::process::id()));
        std::fs::create_dir_all(&path).expect("a temporary folder");
        Folder(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A furnace with light of 1 whose bake has noise: how far E is off, and what the bake claims of that.
pub fn noisy_furnace_row(table: &mut Table, case: &str, baked: &Baked, bound: f64) {
    let mut white = RadianceSh::zero(baked.bands);
    white.coefficients[0] = [(4.0 * PI).sqrt() as f32; 3];
    let found = error_of(baked, |_| white).relative_rmse;
    let claimed = standard_errors(baked).iter().map(|error| (error / PI).powi(2)).sum::<f64>();
    let claimed = (claimed / baked.len() as f64).sqrt();
    table.row(
        case,
        &format!("E = πL: relative RMSE ≤ {}, and ≤ 1.5 of what is claimed", percent(bound)),
        &format!(
            "{}, claimed {}; {} of {} valid",
            percent(found),
            percent(claimed),
            baked.valid_nodes().count(),
            baked.len()
        ),
        baked.is_all_valid() && found <= bound && found <= 1.5 * claimed,
    );
}
