//! Levels made of boxes, probes made of functions, and bakes of a few points. The extremes tool builds with them, too.

use gdibl_baker::Control;
use gdibl_baker::analyse::radiance_sh;
use gdibl_baker::bake::{BakeSettings, Baked, Nodes, bake};
use gdibl_baker::job::records::Records;
use gdibl_baker::pack::{PackSettings, Precision, pack};
use gdibl_baker::panorama::Panorama;
use gdibl_baker::radiance::blend::BlendRule;
use gdibl_baker::radiance::gdibl::{Gdibl, GdiblSettings, Probe};
use gdibl_baker::radiance::{Distant, PathContext, RadianceFunction};
use gdibl_baker::sampling::{Sampler, Stream, fibonacci_sphere};
use gdibl_baker::scene::{Material, Mesh, Role, Scene};
use gdibl_runtime::{RadianceSh, Volume};
use glam::{DQuat, DVec3, Quat, Vec3};
use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

pub type Triangle = [DVec3; 3];

/// Twelve triangles that face inward.
pub fn box_of(min: DVec3, max: DVec3) -> Vec<Triangle> {
    let corner = |i: usize| DVec3::from([0, 1, 2].map(|axis| if i >> axis & 1 == 0 { min[axis] } else { max[axis] }));
    let faces = [[0, 2, 6, 4], [1, 5, 7, 3], [0, 4, 5, 1], [2, 3, 7, 6], [0, 1, 3, 2], [4, 6, 7, 5]];
    faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]].map(|t| t.map(corner))).collect()
}

/// Twelve triangles that face outward.
pub fn solid_of(min: DVec3, max: DVec3) -> Vec<Triangle> {
    box_of(min, max).into_iter().map(|[a, b, c]| [a, c, b]).collect()
}

/// Adds triangles; material 0 is white with albedo 1.
pub fn add(scene: &mut Scene, role: Role, triangles: &[Triangle]) {
    if scene.materials.is_empty() {
        scene.materials.push(Material { metallic: 0.0, ..Material::default() });
    }
    let count = 3 * triangles.len() as u32;
    scene.meshes.push(Mesh {
        role,
        positions: triangles.iter().flatten().copied().collect(),
        normals: vec![Vec3::Y; count as usize],
        triangles: (0..count / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        ..Mesh::default()
    });
}

/// A closed room with a pillar that hides parts of it from every probe. No probe of [`coloured_probes`] stands exactly
/// in the plane of one of its faces: whether it sees that face would be up to rounding.
pub fn room_with_pillar() -> Scene {
    let mut scene = Scene::default();
    add(&mut scene, Role::Environment, &box_of(DVec3::new(-3.0, -1.0, -2.0), DVec3::new(3.0, 2.0, 2.5)));
    add(&mut scene, Role::Environment, &solid_of(DVec3::new(0.4, -1.0, 0.3), DVec3::new(0.9, 1.05, 0.8)));
    scene
}

/// Places in that room.
pub fn places() -> Vec<DVec3> {
    (0..8)
        .map(|i| {
            let i = f64::from(i);
            DVec3::new((2.7 * i).sin() * 2.5, 0.5 + (1.3 * i).cos(), 0.25 - 1.6 * (1.9 * i + 1.0).cos())
        })
        .collect()
}

/// A panorama of `width` × `width`/2 pixels.
pub fn panorama(width: usize, light: impl Fn(Vec3) -> [f32; 3]) -> Panorama {
    let height = width / 2;
    let grid = Panorama::new(width, height, vec![[0.0; 3]; width * height], None);
    let pixels = (0..width * height).map(|i| light(grid.pixel_direction(i % width, i / width))).collect();
    Panorama::new(width, height, pixels, None)
}

pub fn probe(position: DVec3, width: usize, light: impl Fn(Vec3) -> [f32; 3]) -> Probe {
    Probe {
        name: "probe".into(),
        position,
        rotation: Quat::IDENTITY,
        exposure_stops: 0.0,
        panorama: panorama(width, light),
    }
}

pub fn distant(panorama: Panorama) -> Distant {
    Distant { name: "sky".into(), panorama, ..Distant::black() }
}

/// Three probes of unlike, smooth light in [`room_with_pillar`].
pub fn coloured_probes() -> Vec<Probe> {
    vec![
        probe(DVec3::new(-2.0, 0.2, -1.0), 64, |d| [1.0 + d.x, 1.2 + d.y * d.z, 0.4]),
        probe(DVec3::new(1.8, 1.1, 1.7), 32, |d| [0.3, 1.5 + d.z, 1.0 + d.x * d.x]),
        probe(DVec3::new(2.0, -0.3, -1.2), 48, |d| [2.0, 1.0, 1.5 + d.y]),
    ]
}

/// The square |x|, |y| <= 20 at z = 0.
pub fn plane() -> Scene {
    let mut scene = Scene::default();
    let [a, b, c, d] = [[-20.0, -20.0], [20.0, -20.0], [20.0, 20.0], [-20.0, 20.0]].map(|[x, y]| DVec3::new(x, y, 0.0));
    add(&mut scene, Role::Environment, &[[a, b, c], [a, c, d]]);
    scene
}

/// A probe of one colour.
pub fn single(position: [f64; 3], width: usize, light: [f32; 3]) -> Probe {
    probe(position.into(), width, |_| light)
}

/// Radiance of the surface point `to` as seen from `from`.
pub fn seen(function: &Gdibl, from: DVec3, to: DVec3) -> Vec3 {
    let [from, to] = [from, to].map(|p| function.frame().to_trace(p));
    let mut context = PathContext::new(Stream::new(Sampler::Random, 0, 0, 0));
    let found = function.radiance(from, (to - from).normalize(), &mut context);
    assert_eq!(found.coverage, 1.0);
    found.value
}

/// Every blend rule, at the ends of its power.
pub fn every_rule() -> Vec<BlendRule> {
    let powers = [0.0, 1.0, 4.0, 1e3];
    let of = |k| [BlendRule::Distance(k), BlendRule::Angular(k), BlendRule::AngularSmooth(k), BlendRule::Footprint(k)];
    powers.into_iter().flat_map(of).chain([BlendRule::Nearest]).collect()
}

/// The whole input under x → scale · rotation · x + offset.
pub struct Placement {
    pub scale: f64,
    pub rotation: DQuat,
    pub offset: DVec3,
}

impl Placement {
    pub fn point(&self, p: DVec3) -> DVec3 {
        self.rotation * (p * self.scale) + self.offset
    }

    pub fn scene(&self, scene: &Scene) -> Scene {
        let mut placed = scene.clone();
        placed.meshes.iter_mut().flat_map(|m| &mut m.positions).for_each(|p| *p = self.point(*p));
        placed
    }

    pub fn probes(&self, probes: &[Probe]) -> Vec<Probe> {
        let place = |probe: &Probe| Probe {
            position: self.point(probe.position),
            rotation: self.rotation.as_quat() * probe.rotation,
            ..probe.clone()
        };
        probes.iter().map(place).collect()
    }

    pub fn points(&self, points: &[DVec3]) -> Vec<DVec3> {
        points.iter().map(|p| self.point(*p)).collect()
    }
}

/// GDIBL by the defaults.
pub fn gdibl<'a>(scene: &'a Scene, probes: &'a [Probe], distant: Option<&'a Distant>) -> Gdibl<'a> {
    Gdibl::new(scene, probes, distant, GdiblSettings::default())
}

pub fn bake_points(function: &impl RadianceFunction, points: &[DVec3], settings: &BakeSettings) -> Baked {
    let nodes = Nodes::Points(points.to_vec());
    let cancel = AtomicBool::new(false);
    bake(&nodes, function, settings, &Control { cancel: &cancel, progress: &|_, _| {}, blocks: None })
        .expect("nobody interrupts")
}

/// Largest relative error of E = πL over nodes and 100 normals.
pub fn furnace_error(function: &Gdibl, points: &[DVec3], settings: &BakeSettings, radiance: [f32; 3]) -> f64 {
    let baked = bake_points(function, points, settings);
    assert!(baked.is_all_valid());
    let mut worst = 0.0f64;
    for node in 0..points.len() {
        let irradiance = sh_of(&baked, node).convolve();
        for normal in fibonacci_sphere(100) {
            for (e, l) in irradiance.evaluate(normal.to_array()).iter().zip(radiance) {
                worst = worst.max((f64::from(*e) / (PI * f64::from(l)) - 1.0).abs());
            }
        }
    }
    worst
}

/// [`coloured_probes`] that all show one constant radiance.
pub fn white_probes(radiance: [f32; 3]) -> Vec<Probe> {
    let mut probes = coloured_probes();
    for probe in &mut probes {
        probe.panorama = probe.panorama.with_pixels(|_, _| radiance);
    }
    probes
}

/// What an engine would load of a bake: packed in single floats and parsed again.
pub fn volume_of(nodes: &Nodes, function: &Gdibl, settings: &BakeSettings) -> Volume {
    let cancel = AtomicBool::new(false);
    let control = Control { cancel: &cancel, progress: &|_, _| {}, blocks: None };
    let baked = bake(nodes, function, settings, &control).expect("nobody interrupts");
    let bytes =
        pack(nodes, &baked, Records::default(), PackSettings { precision: Precision::F32, ..PackSettings::default() })
            .bytes;
    Volume::parse(&bytes).expect("what was packed parses")
}

/// Coefficients of a node.
pub fn sh_of(baked: &Baked, node: usize) -> RadianceSh {
    radiance_sh(baked.bands, baked.node(node).chunks_exact(3).map(|rgb| [rgb[0], rgb[1], rgb[2]]))
}

/// Root mean square of E over 26 normals and RGB.
pub fn strength(sh: &RadianceSh) -> f64 {
    let irradiance = sh.convolve();
    let squares = fibonacci_sphere(26).into_iter().flat_map(|n| irradiance.evaluate(n.to_array()));
    (squares.map(|e| f64::from(e).powi(2)).sum::<f64>() / 78.0).sqrt()
}

/// Standard errors of E as the bake claims them: its relative errors are over a tenth of the median at least.
pub fn standard_errors(baked: &Baked) -> Vec<f64> {
    let strengths: Vec<f64> = (0..baked.len()).map(|node| strength(&sh_of(baked, node))).collect();
    let floor = 0.1 * median(strengths.clone());
    strengths.iter().zip(&baked.relative_error).map(|(e, error)| f64::from(*error) * e.max(floor)).collect()
}

/// The one in the middle.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Root of the mean square of all coefficients.
pub fn rms(values: &[f32]) -> f64 {
    (values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}

/// Largest difference of coefficients over their RMS.
pub fn difference(found: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(found.len(), expected.len());
    assert!(!found.is_empty());
    let largest = found.iter().zip(expected).map(|(a, b)| (f64::from(*a) - f64::from(*b)).abs()).fold(0.0, f64::max);
    largest / rms(expected)
}

/// Where a sun of one pixel is hard to find: name, column, row, in a panorama of `width` × half of it.
pub fn sun_places(width: usize) -> [(&'static str, usize, usize); 6] {
    let height = width / 2;
    [
        ("middle", width / 3, height / 3),
        ("horizon", width / 2, height / 2),
        ("north pole", 5, 0),
        ("south pole", width / 2, height - 1),
        ("left of the seam", 0, height / 2),
        ("right of the seam", width - 1, height / 4),
    ]
}

/// A sky with one bright pixel.
pub fn sky_with_sun(width: usize, pixel: [usize; 2], sun: f32) -> Panorama {
    with_pixel(&panorama(width, |d| [1.0 + d.y, 1.0, 1.2 + d.x * d.z]), pixel, [sun, 0.9 * sun, 0.7 * sun])
}

/// The panorama with one pixel changed.
pub fn with_pixel(panorama: &Panorama, [x, y]: [usize; 2], radiance: [f32; 3]) -> Panorama {
    let changed = y * panorama.width() + x;
    panorama.with_pixels(|index, pixel| if index == changed { radiance } else { pixel })
}

/// Five probes of unlike colours and sizes before [`plane`].
pub fn unlike_probes() -> [Probe; 5] {
    [
        single([-5.0, 1.0, 2.0], 16, [1.0, 0.0, 0.0]),
        single([-1.5, -2.0, 1.0], 32, [0.0, 1.0, 0.0]),
        single([1.0, 3.0, 3.0], 16, [0.0, 0.0, 1.0]),
        single([4.0, -1.0, 0.7], 64, [1.0, 1.0, 0.0]),
        single([7.0, 2.0, 5.0], 16, [0.0, 1.0, 1.0]),
    ]
}

pub const SMALL: BakeSettings = BakeSettings {
    bands: 2,
    samples: 512,
    target_error: None,
    seed: 3,
    sampler: Sampler::Sobol,
    importance: true,
    coefficient_errors: false,
    punctual: false,
    clamp: f32::INFINITY,
};
