//! Draws volumes in Bevy, without a window, and compares every pixel of three white spheres with `gdibl sample` at the
//! same points: albedo / π · E, exposed, in sRGB. Bound: 3 % of white on average, in the shipped box seen from both
//! ends. So for both textures that `gdibl export --to bevy` writes, and for the plugin.
//!
//! ```sh
//! cargo build --release          # in the repository
//! cargo run --example check      # here; pictures go into out/
//! ```
//! An ambient cube cannot hold what L2 does, so each picture is also compared with what the exporter says Bevy shows:
//! what is off there is layout or placement, and the rest is the cube's loss. Then the same in light from one side
//! alone, for each of the six: that side, and no other, must be bright; in constant light, which must be that constant;
//! and with a file that is baked anew while it is shown. In light from one side a cube is a quarter of white off on its
//! far sides: grey where L2 is black, and sRGB is steep there.
//!
//! GDIBL names the program [../../target/release/gdibl]. Any Vulkan driver will do; software is enough
//! (`VK_ICD_FILENAMES` of lavapipe).

use std::error::Error;
use std::f64::consts::PI;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::{Duration, Instant};

use bevy::asset::{AssetPlugin, RenderAssetUsages, UntypedAssetId};
use bevy::camera::{Exposure, RenderTarget};
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::light::{GlobalAmbientLight, IrradianceVolume, LightProbe};
use bevy::log::{Level, LogPlugin};
use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::gpu_readback::{Readback, ReadbackComplete};
use bevy::render::render_resource::{Extent3d, TextureDimension, TextureFormat, TextureUsages};
use bevy::render::renderer::RenderAdapterInfo;
use bevy::window::ExitCondition;
use gdibl_bevy::{GdiblAsset, GdiblPlugin, GdiblVolume};
use gdibl_export::bevy::{Format, voxels};
use gdibl_runtime::Volume;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
const ALBEDO: f64 = 0.8;

/// Mean absolute difference from the volume's light over both pictures of the box, share of white.
const BOUND: f64 = 0.03;

/// The same of any picture from what the exporter says Bevy shows: there are 8 bits in the picture, and 8 in the
/// filter's weights. 0.13 % was measured.
const BOUND_OF_FORMULA: f64 = 0.005;

const SIDES: [(&str, [f64; 3]); 6] = [
    ("+x", [1.0, 0.0, 0.0]),
    ("-x", [-1.0, 0.0, 0.0]),
    ("+y", [0.0, 1.0, 0.0]),
    ("-y", [0.0, -1.0, 0.0]),
    ("+z", [0.0, 0.0, 1.0]),
    ("-z", [0.0, 0.0, -1.0]),
];

/// How a volume comes into Bevy.
#[derive(Clone, Copy, PartialEq)]
enum Way {
    /// `gdibl export --to bevy`: texture and place.
    Export(Format),
    /// The plugin, by the file itself.
    Plugin,
}

const WAYS: [(&str, Way); 3] = [
    ("export-rgb9e5", Way::Export(Format::Rgb9e5)),
    ("export-rgba16f", Way::Export(Format::Rgba16f)),
    ("plugin", Way::Plugin),
];

/// What is looked at, and from where.
struct View {
    spheres: [[f64; 3]; 3],
    radius: f64,
    eye: [f64; 3],
    target: [f64; 3],
    /// From the top of the picture to its bottom.
    fov_degrees: f64,
    /// Whether the level is shown around the spheres.
    level: bool,
}

/// From both ends.
const IN_BOX: [View; 2] =
    [in_the_box([0.85, 1.8, 3.6], [-0.1, 0.8, 0.0]), in_the_box([-0.85, 1.8, -3.6], [0.1, 0.8, 0.0])];

const fn in_the_box(eye: [f64; 3], target: [f64; 3]) -> View {
    View {
        spheres: [[0.0, 1.0, 2.0], [0.0, 1.0, 0.0], [0.0, 1.0, -2.0]],
        radius: 0.5,
        eye,
        target,
        fov_degrees: 50.0,
        level: true,
    }
}

/// From two opposite corners: each shows three sides whole.
const CORNERS: [View; 2] = [in_the_open([4.0, 3.2, 3.6]), in_the_open([-4.0, -3.2, -3.6])];

const fn in_the_open(eye: [f64; 3]) -> View {
    View {
        spheres: [[-1.3, 0.0, 0.0], [0.0, 0.0, 0.0], [1.3, 0.0, 0.0]],
        radius: 0.6,
        eye,
        target: [0.0; 3],
        fov_degrees: 36.0,
        level: false,
    }
}

fn main() -> ExitCode {
    match check() {
        Ok(0) => ExitCode::SUCCESS,
        Ok(_) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

/// How many checks failed.
fn check() -> Result<usize> {
    let files = Files::prepare()?;
    let mut studio = Studio::new(&files.out);
    let mut failed = 0;
    let mut verdict = |good: bool, text: String| {
        println!("{} {text}", if good { "ok    " } else { "FAILED" });
        failed += usize::from(!good);
    };

    for (name, way) in WAYS {
        let (mut sum, mut count, mut formula) = (0.0, 0.0, 0.0_f64);
        for (end, view) in IN_BOX.iter().enumerate() {
            let seen = studio.compare(&files, &format!("box.{end}.{name}"), view, "box", way)?;
            println!("       {name}, box from end {end}: {seen}; spheres: {}", seen.spheres.map(percent).join(", "));
            sum += seen.exact * seen.points.len() as f64;
            count += seen.points.len() as f64;
            formula = formula.max(seen.formula);
        }
        verdict(
            sum / count <= BOUND && formula <= BOUND_OF_FORMULA,
            format!("{name}, box: off by {} of white from the volume over {count} pixels", percent(sum / count)),
        );
    }

    for (name, way) in WAYS {
        for (side, direction) in SIDES {
            let mut found = [0.0; 6];
            let mut worst: Option<Seen> = None;
            for (corner, view) in CORNERS.iter().enumerate() {
                let volume = format!("side{side}");
                let seen = studio.compare(&files, &format!("{volume}.{corner}.{name}"), view, &volume, way)?;
                for (brightness, (_, there)) in found.iter_mut().zip(SIDES) {
                    if dot(there, view.eye) > 0.0 {
                        *brightness = seen.light(there);
                    }
                }
                if worst.as_ref().is_none_or(|worst| seen.formula > worst.formula) {
                    worst = Some(seen);
                }
            }
            let worst = worst.ok_or("no picture")?;
            let lit = SIDES.iter().zip(found).find(|((_, there), _)| *there == direction).map_or(0.0, |(_, b)| b);
            let others = SIDES.iter().zip(found).filter(|((_, there), _)| *there != direction).map(|(_, b)| b);
            let others = others.fold(0.0, f64::max);
            verdict(
                lit > 0.8 && others < 0.3 && worst.formula <= BOUND_OF_FORMULA,
                format!(
                    "{name}, light from {side}: that side {} of full light, the brightest other {}; {worst}",
                    percent(lit),
                    percent(others)
                ),
            );
        }
    }

    for (name, way) in WAYS {
        for (corner, view) in CORNERS.iter().enumerate() {
            let seen = studio.compare(&files, &format!("constant.{corner}.{name}"), view, "constant", way)?;
            verdict(
                seen.largest <= 1.0 / 255.0,
                format!("{name}, constant light: no pixel off by more than {} of white", percent(seen.largest)),
            );
        }
    }

    let seen = studio.compare_reloaded(&files)?;
    verdict(seen.formula <= BOUND_OF_FORMULA, format!("baked anew while shown: {seen}"));
    Ok(failed)
}

fn percent(share: f64) -> String {
    format!("{:.2} %", 100.0 * share)
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| a[k] - b[k])
}

fn unit(a: [f64; 3]) -> [f64; 3] {
    a.map(|v| v / dot(a, a).sqrt())
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// 0..=1 in sRGB, of a linear value, clamped as the picture's format does.
fn srgb(linear: f64) -> f64 {
    let v = linear.clamp(0.0, 1.0);
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

/// A place on a sphere that a pixel shows.
struct Point {
    pixel: usize,
    sphere: usize,
    position: [f64; 3],
    normal: [f64; 3],
}

impl View {
    /// Where each pixel's ray meets the nearest sphere. Pixels at a rim are left out: there one picture may see the
    /// sphere, and the other what is behind.
    fn points(&self) -> Vec<Point> {
        let forward = unit(minus(self.target, self.eye));
        let right = unit(cross(forward, [0.0, 1.0, 0.0]));
        let up = cross(right, forward);
        let scale = (self.fov_degrees.to_radians() / 2.0).tan();
        let hit = |pixel: usize| {
            let x = (2.0 * ((pixel % WIDTH) as f64 + 0.5) / WIDTH as f64 - 1.0) * scale * WIDTH as f64 / HEIGHT as f64;
            let y = (1.0 - 2.0 * ((pixel / WIDTH) as f64 + 0.5) / HEIGHT as f64) * scale;
            let direction = unit(std::array::from_fn(|k| forward[k] + x * right[k] + y * up[k]));
            let distance = |sphere: usize| {
                let to = minus(self.eye, self.spheres[sphere]);
                let b = dot(to, direction);
                let d = b * b - dot(to, to) + self.radius * self.radius;
                (d > 0.0).then(|| -b - d.sqrt()).filter(|t| *t > 0.0)
            };
            let hits = (0..3).filter_map(|sphere| distance(sphere).map(|t| (sphere, t)));
            let (sphere, t) = hits.min_by(|a, b| a.1.total_cmp(&b.1))?;
            let position = std::array::from_fn(|k| self.eye[k] + t * direction[k]);
            Some(Point { pixel, sphere, position, normal: unit(minus(position, self.spheres[sphere])) })
        };
        let hits: Vec<Option<Point>> = (0..WIDTH * HEIGHT).map(hit).collect();
        let spheres: Vec<Option<usize>> = hits.iter().map(|hit| hit.as_ref().map(|point| point.sphere)).collect();
        let inner = |point: &Point| {
            let neighbours = [point.pixel - 1, point.pixel + 1, point.pixel - WIDTH, point.pixel + WIDTH];
            neighbours.iter().all(|&pixel| spheres[pixel] == Some(point.sphere))
        };
        hits.into_iter().flatten().filter(inner).collect()
    }
}

/// A picture against the light of the volume. Differences are mean and absolute, shares of white.
struct Seen {
    /// RGBA, sRGB.
    pixels: Vec<u8>,
    points: Vec<Point>,
    /// Of the picture from `gdibl sample`: of all spheres, and of each.
    exact: f64,
    spheres: [f64; 3],
    /// Of the picture from what the exporter says Bevy shows.
    formula: f64,
    /// Of the latter from `gdibl sample`: what an ambient cube loses, whoever shows it.
    cube: f64,
    /// The largest difference of the picture from `gdibl sample`.
    largest: f64,
}

impl std::fmt::Display for Seen {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "off by {} of white from the volume, by {} from the exporter's formula, whose cubes lose {}",
            percent(self.exact),
            percent(self.formula),
            percent(self.cube)
        )
    }
}

impl Seen {
    /// Mean light of the pixels that face a side within 25°: linear, 0..=1 at white.
    fn light(&self, side: [f64; 3]) -> f64 {
        let cosine = 25.0_f64.to_radians().cos();
        let facing: Vec<f64> = self
            .points
            .iter()
            .filter(|point| dot(point.normal, side) > cosine)
            .map(|point| f64::from(Srgba::gamma_function(f32::from(self.pixels[4 * point.pixel]) / 255.0)))
            .collect();
        facing.iter().sum::<f64>() / facing.len() as f64
    }
}

/// The volumes and their exports, in a folder that is also Bevy's for assets.
struct Files {
    out: PathBuf,
    gdibl: PathBuf,
    repository: PathBuf,
}

impl Files {
    fn prepare() -> Result<Files> {
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        let repository = here.join("../..").canonicalize()?;
        let gdibl = std::env::var_os("GDIBL").map_or(repository.join("target/release/gdibl"), PathBuf::from);
        let files = Files { out: here.join("out"), gdibl, repository };
        fs::create_dir_all(&files.out)?;
        files.bake_box("box.gdibl")?;
        files.export("box")?;
        fs::copy(files.repository.join("assets/uffizi-box/uffizi-box.glb"), files.out.join("box.glb"))?;
        fs::write(files.out.join("nothing.gltf"), r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{}]}"#)?;
        for (side, direction) in SIDES {
            files.bake_panorama(&format!("side{side}"), |there| dot(there, direction) > (PI / 6.0).cos())?;
        }
        files.bake_panorama("constant", |_| true)?;
        Ok(files)
    }

    fn run(&self, arguments: &[&str]) -> Result<String> {
        let output = Command::new(&self.gdibl)
            .args(arguments)
            .current_dir(&self.out)
            .output()
            .map_err(|error| format!("{}: {error}: build it, or name it as GDIBL", self.gdibl.display()))?;
        if !output.status.success() {
            return Err(format!("gdibl {arguments:?}: {}", String::from_utf8_lossy(&output.stderr)).into());
        }
        Ok(String::from_utf8(output.stdout)?)
    }

    fn bake_box(&self, name: &str) -> Result<()> {
        let toml = self.repository.join("assets/uffizi-box/uffizi-box.bake.toml");
        self.run(&["bake", &toml.to_string_lossy(), "-o", name, "--quiet"])?;
        Ok(())
    }

    fn export(&self, volume: &str) -> Result<()> {
        self.run(&["export", &format!("{volume}.gdibl"), "--to", "bevy", "-o", &format!("{volume}.ktx2")])?;
        Ok(())
    }

    /// A volume that is lit from afar alone, by radiance 1 where `bright` says so, and its export. 4 x 3 x 2 nodes, so
    /// that no axis can pass for another.
    fn bake_panorama(&self, volume: &str, bright: impl Fn([f64; 3]) -> bool) -> Result<()> {
        const W: usize = 128;
        const H: usize = 64;
        let mut bytes = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {H} +X {W}\n").into_bytes();
        for i in 0..W * H {
            let longitude = 2.0 * PI * (0.5 - ((i % W) as f64 + 0.5) / W as f64);
            let latitude = PI * (0.5 - ((i / W) as f64 + 0.5) / H as f64);
            let radius = latitude.cos();
            let there = [longitude.sin() * radius, latitude.sin(), longitude.cos() * radius];
            bytes.extend_from_slice(if bright(there) { &[128, 128, 128, 129] } else { &[0; 4] });
        }
        fs::write(self.out.join("lamp.hdr"), bytes)?;
        let name = format!("{volume}.gdibl");
        let bounds = ["--bounds", "-3,-2,-2,3,2,2", "--counts", "4,3,2"];
        self.run(&[&["bake", "nothing.gltf", "--distant", "lamp.hdr", "-o", &name, "--quiet"], &bounds[..]].concat())?;
        self.export(volume)
    }

    /// E of gdibl itself.
    fn irradiance(&self, volume: &str, points: &[Point]) -> Result<Vec<[f64; 3]>> {
        let row = |point: &Point| {
            let ([x, y, z], [nx, ny, nz]) = (point.position, point.normal);
            format!("{x},{y},{z},{nx},{ny},{nz}")
        };
        fs::write(self.out.join("points.csv"), points.iter().map(row).collect::<Vec<_>>().join("\n"))?;
        let table = self.run(&["sample", &format!("{volume}.gdibl"), "--at", "points.csv"])?;
        let numbers = |row: &str| -> Result<[f64; 3]> {
            let numbers =
                row.split(',').skip(6).take(3).map(str::parse).collect::<std::result::Result<Vec<f64>, _>>()?;
            numbers.try_into().map_err(|_| format!("no irradiance in {row:?}").into())
        };
        let rows: Vec<[f64; 3]> = table.trim().lines().skip(1).map(numbers).collect::<Result<_>>()?;
        if rows.len() != points.len() {
            return Err(format!("{} answers for {} points", rows.len(), points.len()).into());
        }
        Ok(rows)
    }
}

/// The last picture read back.
#[derive(Resource, Default)]
struct Pixels(Option<Vec<u8>>);

/// Goes when the picture is taken.
#[derive(Component)]
struct Shown;

/// Bevy without a window.
struct Studio {
    app: App,
    target: Handle<Image>,
}

impl Studio {
    fn new(assets: &Path) -> Studio {
        let mut app = App::new();
        app.add_plugins(
            DefaultPlugins
                .set(WindowPlugin { primary_window: None, exit_condition: ExitCondition::DontExit, ..default() })
                .set(AssetPlugin {
                    file_path: assets.to_string_lossy().into_owned(),
                    watch_for_changes_override: Some(true),
                    ..default()
                })
                .set(LogPlugin { level: Level::WARN, ..default() })
                // Else the first frames lack what is not compiled yet.
                .set(RenderPlugin { synchronous_pipeline_compilation: true, ..default() })
                .disable::<bevy::render::pipelined_rendering::PipelinedRenderingPlugin>(),
        )
        .add_plugins(GdiblPlugin)
        // Bevy's default would be added to the volume's.
        .insert_resource(GlobalAmbientLight::NONE)
        .insert_resource(ClearColor(Color::BLACK))
        .init_resource::<Pixels>();
        app.finish();
        app.cleanup();
        let size = Extent3d { width: WIDTH as u32, height: HEIGHT as u32, depth_or_array_layers: 1 };
        let (format, usage) = (TextureFormat::Rgba8UnormSrgb, RenderAssetUsages::default());
        let mut target = Image::new_fill(size, TextureDimension::D2, &[0; 4], format, usage);
        target.texture_descriptor.usage |= TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_SRC;
        let target = app.world_mut().resource_mut::<Assets<Image>>().add(target);
        let adapter = app.world().resource::<RenderAdapterInfo>();
        println!("Bevy on {} ({})", adapter.name, adapter.driver_info);
        Studio { app, target }
    }

    fn load<A: Asset>(&self, name: String) -> Handle<A> {
        self.app.world().resource::<AssetServer>().load(name)
    }

    /// Frames until a condition holds.
    fn update_until(&mut self, what: &str, mut holds: impl FnMut(&World) -> bool) -> Result<()> {
        let start = Instant::now();
        while !holds(self.app.world()) {
            if start.elapsed() > Duration::from_secs(60) {
                return Err(format!("waited a minute for {what}").into());
            }
            self.app.update();
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(())
    }

    /// Sets up spheres, camera, and the volume's light, and waits until all of it is loaded.
    fn set_up(&mut self, files: &Files, view: &View, exposure: f64, volume: &str, way: Way) -> Result<()> {
        let vector = |v: [f64; 3]| Vec3::from_array(v.map(|v| v as f32));
        let mut wanted: Vec<UntypedAssetId> = Vec::new();
        // A volume gives diffuse light alone, so that these two change nothing here; they say what is compared.
        let material = self.app.world_mut().resource_mut::<Assets<StandardMaterial>>().add(StandardMaterial {
            base_color: Color::linear_rgb(ALBEDO as f32, ALBEDO as f32, ALBEDO as f32),
            perceptual_roughness: 1.0,
            reflectance: 0.0,
            ..default()
        });
        let sphere = Sphere::new(view.radius as f32).mesh().uv(256, 128);
        let mesh = self.app.world_mut().resource_mut::<Assets<Mesh>>().add(sphere);
        for centre in view.spheres {
            let place = Transform::from_translation(vector(centre));
            self.app.world_mut().spawn((Shown, Mesh3d(mesh.clone()), MeshMaterial3d(material.clone()), place));
        }
        if view.level {
            // The walls. The level's own spheres are polyhedra; those above stand for them.
            for index in 0..3 {
                let wall: Handle<Mesh> = self.load(format!("box.glb#Mesh{index}/Primitive0"));
                let paint: Handle<StandardMaterial> = self.load(format!("box.glb#Material{index}/std"));
                wanted.extend([wall.id().untyped(), paint.id().untyped()]);
                self.app.world_mut().spawn((Shown, Mesh3d(wall), MeshMaterial3d(paint)));
            }
        }
        self.app.world_mut().spawn((
            Shown,
            Camera3d::default(),
            Projection::from(PerspectiveProjection {
                fov: view.fov_degrees.to_radians() as f32,
                near: 0.01,
                ..default()
            }),
            RenderTarget::Image(self.target.clone().into()),
            Transform::from_translation(vector(view.eye)).looking_at(vector(view.target), Vec3::Y),
            Tonemapping::None,
            Msaa::Off,
            // What Bevy multiplies light by is 2^-ev100 / 1.2.
            Exposure { ev100: -(1.2 * exposure).log2() as f32 },
        ));
        match way {
            Way::Plugin => {
                let asset: Handle<GdiblAsset> = self.load(format!("{volume}.gdibl"));
                wanted.push(asset.id().untyped());
                self.app.world_mut().spawn((Shown, GdiblVolume { asset, intensity: 1.0 }));
            }
            Way::Export(format) => {
                let sidecar: serde_json::Value =
                    serde_json::from_slice(&fs::read(files.out.join(format!("{volume}.json")))?)?;
                let number = |value: &serde_json::Value| value.as_f64().map(|v| v as f32).ok_or("no number in sidecar");
                let vector = |value: &serde_json::Value| -> Result<Vec3> {
                    Ok(Vec3::new(number(&value[0])?, number(&value[1])?, number(&value[2])?))
                };
                let key = if format == Format::Rgb9e5 { "rgb9e5" } else { "rgba16f" };
                let voxels: Handle<Image> = self.load(sidecar[key].as_str().ok_or("no texture in sidecar")?.to_owned());
                wanted.push(voxels.id().untyped());
                let light = IrradianceVolume { voxels, intensity: number(&sidecar["intensity"])?, ..default() };
                let place = Transform {
                    translation: vector(&sidecar["translation"])?,
                    scale: vector(&sidecar["scale"])?,
                    ..default()
                };
                self.app.world_mut().spawn((Shown, LightProbe::default(), light, place));
            }
        }
        self.update_until("assets", |world| {
            let server = world.resource::<AssetServer>();
            wanted.iter().all(|id| server.is_loaded_with_dependencies(*id))
        })
    }

    /// Some frames: what one gives to the next (places, visibility, clusters of lights) has arrived.
    fn frames(&mut self) {
        (0..6).for_each(|_| self.app.update());
    }

    /// RGBA in sRGB, the top row first.
    fn picture(&mut self) -> Result<Vec<u8>> {
        self.frames();
        self.app.world_mut().resource_mut::<Pixels>().0 = None;
        let readback = Readback::texture(self.target.clone());
        let reader = self
            .app
            .world_mut()
            .spawn(readback)
            .observe(|read: On<ReadbackComplete>, mut pixels: ResMut<Pixels>| pixels.0 = Some(read.data.clone()))
            .id();
        self.update_until("pixels", |world| world.resource::<Pixels>().0.is_some())?;
        self.app.world_mut().despawn(reader);
        // A read under way may still come.
        self.frames();
        let pixels = self.app.world_mut().resource_mut::<Pixels>().0.take().ok_or("no pixels")?;
        assert_eq!(pixels.len(), 4 * WIDTH * HEIGHT, "rows of a multiple of 256 bytes are not padded");
        Ok(pixels)
    }

    fn clear(&mut self) {
        let world = self.app.world_mut();
        let shown: Vec<Entity> = world.query_filtered::<Entity, With<Shown>>().iter(world).collect();
        shown.into_iter().for_each(|entity| {
            world.despawn(entity);
        });
    }

    fn compare(&mut self, files: &Files, name: &str, view: &View, volume: &str, way: Way) -> Result<Seen> {
        let expected = Expected::new(files, view, volume, way)?;
        self.set_up(files, view, expected.exposure, volume, way)?;
        let pixels = self.picture()?;
        self.clear();
        expected.compare(files, name, pixels)
    }

    /// Shows the box by a file of side light, then has `gdibl bake` write the box's light over it.
    fn compare_reloaded(&mut self, files: &Files) -> Result<Seen> {
        fs::copy(files.out.join("side+x.gdibl"), files.out.join("live.gdibl"))?;
        let expected = Expected::new(files, &IN_BOX[0], "box", Way::Plugin)?;
        self.set_up(files, &IN_BOX[0], expected.exposure, "live", Way::Plugin)?;
        let before = self.picture()?;
        files.bake_box("live.gdibl")?;
        let nodes = |world: &World| -> Vec<usize> {
            world.resource::<Assets<GdiblAsset>>().iter().map(|(_, asset)| asset.volume.node_count()).collect()
        };
        self.update_until("the new file", |world| !nodes(world).contains(&24))?;
        let after = self.picture()?;
        self.clear();
        if before == after {
            return Err("the picture stayed as it was".into());
        }
        expected.compare(files, "reloaded.plugin", after)
    }
}

/// What a picture should show.
struct Expected {
    points: Vec<Point>,
    /// E by `gdibl sample`, and by the exporter's formula of Bevy.
    exact: Vec<[f64; 3]>,
    formula: Vec<[f64; 3]>,
    /// Takes the brightest hundredth of the spheres to 95 % of white.
    exposure: f64,
}

impl Expected {
    fn new(files: &Files, view: &View, volume: &str, way: Way) -> Result<Expected> {
        let points = view.points();
        let exact = files.irradiance(volume, &points)?;
        let parsed = Volume::parse(&fs::read(files.out.join(format!("{volume}.gdibl")))?)?;
        let format = match way {
            Way::Export(format) => format,
            Way::Plugin => Format::Rgb9e5,
        };
        let cubes = voxels(&parsed, None, format)?;
        let formula =
            points.iter().map(|point| cubes.irradiance(point.position, point.normal.map(|n| n as f32))).collect();
        let mut ordered: Vec<f64> = exact.iter().flatten().copied().collect();
        ordered.sort_unstable_by(f64::total_cmp);
        let bright = ordered[ordered.len() * 99 / 100];
        Ok(Expected { points, exact, formula, exposure: 0.95 / (ALBEDO / PI * bright) })
    }

    /// Compares, and writes both pictures.
    fn compare(self, files: &Files, name: &str, pixels: Vec<u8>) -> Result<Seen> {
        let shade = |irradiance: f64| srgb(self.exposure * ALBEDO / PI * irradiance);
        let mut expected = vec![0; pixels.len()];
        let (mut sums, mut counts) = ([0.0; 3], [0.0; 3]);
        let (mut formula, mut cube, mut largest) = (0.0, 0.0, 0.0_f64);
        for (i, point) in self.points.iter().enumerate() {
            for c in 0..3 {
                let place = 4 * point.pixel + c;
                let (shown, exact) = (f64::from(pixels[place]) / 255.0, shade(self.exact[i][c]));
                expected[place] = (255.0 * exact).round() as u8;
                sums[point.sphere] += (shown - exact).abs();
                counts[point.sphere] += 1.0;
                formula += (shown - shade(self.formula[i][c])).abs();
                cube += (shade(self.formula[i][c]) - exact).abs();
                largest = largest.max((shown - exact).abs());
            }
        }
        save(&files.out.join(format!("{name}.png")), &pixels)?;
        save(&files.out.join(format!("{name}.expected.png")), &expected)?;
        let count: f64 = counts.iter().sum();
        Ok(Seen {
            pixels,
            exact: sums.iter().sum::<f64>() / count,
            spheres: std::array::from_fn(|s| sums[s] / counts[s]),
            formula: formula / count,
            cube: cube / count,
            largest,
            points: self.points,
        })
    }
}

fn save(path: &Path, pixels: &[u8]) -> Result<()> {
    let size = Extent3d { width: WIDTH as u32, height: HEIGHT as u32, depth_or_array_layers: 1 };
    let format = TextureFormat::Rgba8UnormSrgb;
    let image = Image::new(size, TextureDimension::D2, pixels.to_vec(), format, RenderAssetUsages::default());
    image.try_into_dynamic()?.to_rgb8().save(path)?;
    Ok(())
}
