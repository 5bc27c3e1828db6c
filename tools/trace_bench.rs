//! Measures tracing against its peers: million rays per second on one thread, closest hit and any hit.
//!
//! `cargo run --release -p gdibl-tools --bin trace_bench -- [--embree libembree4.so] [--rounds N] LEVEL.glb…`
//!
//! Scenes: the levels given, and a generated hall full of things (262 000 triangles). Rays: 4096 free points × 256
//! directions of the sphere, those of a point sorted by octant and octahedral Morton order. "Any" asks for a hit within a
//! quarter of the scene's diagonal. Everything traces the same rays in the same run: the rays go
//! through in slices, all tracers in turn on each, and of each slice the best of the rounds counts, so that a busy machine
//! slows all alike.
//!
//! "portable" is gdibl as it traces where there is no AVX2. obvhs' own wide tree, whose triangle test leaks at edges, is
//! measured always. `--embree` measures Embree 4 as well, one ray at a time (`rtcIntersect1`, `rtcOccluded1`), built with
//! quality HIGH: with ROBUST, which is watertight, and without. The library is in the wheel that
//! `pip download --no-deps embreex` brings: unzip it, and take `embreex.libs/libembree4-….so.4`, which finds its own libraries
//! beside it.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use gdibl_baker::sampling::{Sampler, Stream, uniform_sphere};
use gdibl_baker::trace::{Frame, Tree};
use gdibl_tools::read_scene;
use glam::{DVec3, Vec2, Vec3, Vec3A};

/// Places rays start from.
const POINTS: u32 = 4096;
/// Rays from each.
const DIRECTIONS: u32 = 256;
/// Rays of a slice.
const SLICE: usize = 1 << 15;
/// Any-hit rays end after this share of the scene's diagonal.
const ANY_REACH: f32 = 0.25;

fn main() {
    let mut levels: Vec<PathBuf> = Vec::new();
    let mut library = None;
    let mut rounds = 7;
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().unwrap_or_else(|| panic!("{argument} needs a value"));
        match argument.as_str() {
            "--embree" => library = Some(value()),
            "--rounds" => rounds = value().parse().expect("--rounds: a number"),
            _ => levels.push(argument.into()),
        }
    }
    let embree = library.map(|path| embree::Library::open(Path::new(&path)));
    if let Some(embree) = &embree {
        println!("Embree {}, BVH of quality HIGH, one ray at a time.\n", embree.version());
    }
    println!("Million rays per second, one thread; best of {rounds} rounds. Robust and fast: Embree.\n");
    let columns = "scene triangles query hits gdibl portable obvhs robust fast gdibl/robust gdibl/fast";
    println!("| {} |", columns.replace(' ', " | "));
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    let mut notes = String::new();
    for level in &levels {
        let name = level.file_stem().expect("a file").to_string_lossy().into_owned();
        measure(&name, &level_triangles(level), embree.as_ref(), rounds, &mut notes);
    }
    measure("generated hall", &hall(), embree.as_ref(), rounds, &mut notes);
    println!("\n{notes}");
}

/// Triangles of a level as the baker traces them.
fn level_triangles(path: &Path) -> Vec<[Vec3; 3]> {
    let scene = read_scene(path);
    let frame = Frame::of_scene(&scene);
    let corner = |position: &DVec3| frame.to_trace(*position);
    let of_mesh = |mesh: &gdibl_baker::scene::Mesh| {
        mesh.triangles.iter().map(|ids| ids.map(|i| corner(&mesh.positions[i as usize]))).collect::<Vec<_>>()
    };
    scene.meshes.iter().flat_map(of_mesh).collect()
}

/// A hall of 1000 × 300 × 600 units with columns, spheres and crates, deterministic.
fn hall() -> Vec<[Vec3; 3]> {
    let mut triangles = Vec::new();
    let size = Vec3::new(1000.0, 300.0, 600.0);
    let mut grid = |at: &dyn Fn(f32, f32) -> Vec3, across: u32, along: u32| {
        let place = |i: u32, j: u32| at(i as f32 / across as f32, j as f32 / along as f32);
        for (i, j) in (0..across).flat_map(|i| (0..along).map(move |j| (i, j))) {
            let [a, b, c, d] = [place(i, j), place(i + 1, j), place(i + 1, j + 1), place(i, j + 1)];
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    };
    let random = |thing: u32, pair: u32| Stream::new(Sampler::Random, 11, u64::from(thing), 0).point(0, pair);
    // Walls, floor and ceiling of an outer and an inner corner each.
    for axis in 0..3 {
        for side in [0.0, 1.0] {
            let wall = |u: f32, v: f32| {
                let mut unit = Vec3::ZERO;
                (unit[axis], unit[(axis + 1) % 3], unit[(axis + 2) % 3]) = (side, u, v);
                unit * size
            };
            grid(&wall, 32, 32);
        }
    }
    let turn = |angle: f32| Vec2::from_angle(angle * std::f32::consts::TAU);
    for column in 0..32 {
        let center = Vec3::new((column % 8) as f32 * 120.0 + 80.0, 0.0, (column / 8) as f32 * 150.0 + 75.0);
        let shaft = |u: f32, v: f32| {
            let around = turn(u) * (12.0 + 3.0 * (v * 40.0).sin());
            center + Vec3::new(around.x, v * size.y, around.y)
        };
        grid(&shaft, 24, 48);
    }
    for ball in 0..48 {
        let ([x, y], [z, radius]) = (random(ball, 0), random(ball, 1));
        let (center, radius) = (Vec3::new(x, y, z) * size, 8.0 + 24.0 * radius);
        let sphere = |u: f32, v: f32| {
            let (around, height) = (turn(u), turn(v * 0.5));
            center + radius * Vec3::new(around.x * height.y, height.x, around.y * height.y)
        };
        grid(&sphere, 44, 22);
    }
    for crate_ in 100..7068 {
        let ([x, y], [z, s], [a, h]) = (random(crate_, 0), random(crate_, 1), random(crate_, 2));
        let (center, half) = (Vec3::new(x, y * y * y, z) * size, 2.0 + 6.0 * s * s);
        let angle = turn(a);
        for side in 0..6u32 {
            let face = |u: f32, v: f32| {
                let mut p = Vec3::ZERO;
                let axis = side as usize / 2;
                (p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3]) =
                    (if side % 2 == 0 { 1.0 } else { -1.0 }, 2.0 * u - 1.0, 2.0 * v - 1.0);
                let turned = angle.rotate(Vec2::new(p.x, p.z));
                center + half * Vec3::new(turned.x, p.y * (0.5 + 2.0 * h), turned.y)
            };
            grid(&face, 1, 1);
        }
    }
    triangles
}

#[derive(Debug, Clone, Copy)]
struct Ray {
    origin: Vec3,
    direction: Vec3,
}

/// What a tracer says of a ray: t and triangle.
type Answer = (f32, u32);
const NOTHING: Answer = (f32::INFINITY, u32::MAX);
/// Of any hit.
const SOMETHING: Answer = (0.0, u32::MAX);

/// Rays from places that stand free in the scene.
fn rays(tree: &Tree, triangles: &[[Vec3; 3]]) -> (Vec<Ray>, f32) {
    let corners = || triangles.iter().flatten();
    let min = corners().fold(Vec3::INFINITY, |m, c| m.min(*c));
    let max = corners().fold(Vec3::NEG_INFINITY, |m, c| m.max(*c));
    let diagonal = (max - min).length();
    let signs = |i: u32| Vec3::new((i % 3) as f32, (i / 3 % 3) as f32, (i / 9) as f32) - 1.0;
    // Free: nothing near, and more fronts than backs around it.
    let is_free = |place: Vec3| {
        let mut fronts = 0;
        for direction in (0..27).filter(|i| *i != 13).map(signs) {
            let Some(hit) = tree.closest(place, direction, 0.0, f32::INFINITY, |_| true) else { continue };
            if hit.t * direction.length() < 0.002 * diagonal {
                return false;
            }
            let [a, b, c] = triangles[hit.triangle as usize];
            fronts += if (b - a).cross(c - a).dot(direction) < 0.0 { 1 } else { -1 };
        }
        fronts != 0
    };
    let mut rays = Vec::new();
    let place = |i: u64| {
        let stream = Stream::new(Sampler::Random, 5, i, 0);
        let ([x, y], [z, _]) = (stream.point(0, 0), stream.point(0, 1));
        min + Vec3::new(x, y, z) * (max - min)
    };
    for (i, origin) in (0..1 << 20).map(|i| (i, place(i))).filter(|(_, p)| is_free(*p)).take(POINTS as usize) {
        let stream = Stream::new(Sampler::Random, 6, i, 0);
        let mut directions: Vec<Vec3> = (0..DIRECTIONS).map(|d| uniform_sphere(stream.point(d, 0))).collect();
        directions.sort_by_key(|d| order(*d));
        rays.extend(directions.into_iter().map(|direction| Ray { origin, direction }));
    }
    (rays, ANY_REACH * diagonal)
}

/// Octant, then Morton order in the octahedral map.
fn order(direction: Vec3) -> u32 {
    let octant = (0..3).fold(0, |octant, axis| octant << 1 | u32::from(direction[axis] < 0.0));
    let flat = direction.abs() / direction.abs().element_sum();
    let spread = |x: f32| (0..12).fold(0u32, |m, bit| m | ((x * 4095.0) as u32 >> bit & 1) << (2 * bit));
    octant << 24 | spread(flat.x) << 1 | spread(flat.y)
}

/// Traces rays one after the other.
type Tracer<'a> = Box<dyn Fn(&[Ray], &mut Vec<Answer>) + 'a>;

/// Million rays per second of every tracer, and its answers.
fn race(rays: &[Ray], rounds: u32, tracers: &[Tracer]) -> Vec<(f64, Vec<Answer>)> {
    let mut seconds = vec![0.0; tracers.len()];
    let mut answers = vec![Vec::with_capacity(rays.len()); tracers.len()];
    for slice in rays.chunks(SLICE) {
        let mut best = vec![f64::INFINITY; tracers.len()];
        for round in 0..rounds {
            for (i, tracer) in tracers.iter().enumerate() {
                if round > 0 {
                    let before = answers[i].len() - slice.len();
                    answers[i].truncate(before);
                }
                let start = Instant::now();
                tracer(slice, &mut answers[i]);
                best[i] = best[i].min(start.elapsed().as_secs_f64());
            }
        }
        seconds.iter_mut().zip(best).for_each(|(sum, best)| *sum += best);
    }
    let speeds = seconds.into_iter().map(|seconds| rays.len() as f64 * 1e-6 / seconds);
    speeds.zip(answers).collect()
}

/// What is asked of a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Query {
    Closest,
    /// Is there a hit before this t?
    Any(f32),
}

/// gdibl.
fn of_tree(tree: &Tree, query: Query) -> Tracer<'_> {
    match query {
        Query::Closest => Box::new(|rays, answers| {
            answers.extend(rays.iter().map(|ray| {
                let hit = tree.closest(ray.origin, ray.direction, 0.0, f32::INFINITY, |_| true);
                hit.map_or(NOTHING, |hit| (hit.t, hit.triangle))
            }));
        }),
        Query::Any(reach) => Box::new(move |rays, answers| {
            answers.extend(rays.iter().map(|ray| {
                if tree.is_hit(ray.origin, ray.direction, 0.0, reach, u32::MAX) { SOMETHING } else { NOTHING }
            }));
        }),
    }
}

/// obvhs, with its own tree and triangles.
struct Obvhs {
    tree: obvhs::cwbvh::CwBvh,
    triangles: Vec<obvhs::triangle::Triangle>,
}

impl Obvhs {
    fn build(triangles: &[[Vec3; 3]]) -> Obvhs {
        let of_corners = |corners: &[Vec3; 3]| {
            let [v0, v1, v2] = corners.map(Vec3A::from);
            obvhs::triangle::Triangle { v0, v1, v2 }
        };
        let triangles: Vec<_> = triangles.iter().map(of_corners).collect();
        let settings = obvhs::BvhBuildParams::very_slow_build();
        let tree = obvhs::cwbvh::builder::build_cwbvh_from_tris(&triangles, settings, &mut Default::default());
        Obvhs { tree, triangles }
    }

    fn tracer(&self, query: Query) -> Tracer<'_> {
        let id = |primitive: usize| self.tree.primitive_indices[primitive];
        let test = move |ray: &obvhs::ray::Ray, primitive: usize| self.triangles[id(primitive) as usize].intersect(ray);
        // Adding zero turns -0.0 into 0.0: with it, obvhs misses everything.
        let ray =
            |ray: &Ray, reach: f32| obvhs::ray::Ray::new(ray.origin.into(), (ray.direction + 0.0).into(), 0.0, reach);
        match query {
            Query::Closest => Box::new(move |rays, answers| {
                answers.extend(rays.iter().map(|r| {
                    let mut hit = obvhs::ray::RayHit::none();
                    let found = self.tree.ray_traverse(ray(r, f32::INFINITY), &mut hit, test);
                    if found { (hit.t, id(hit.primitive_id as usize)) } else { NOTHING }
                }));
            }),
            Query::Any(reach) => {
                Box::new(move |rays, answers| {
                    answers.extend(
                        rays.iter().map(|r| {
                            if self.tree.ray_traverse_miss(ray(r, reach), test) { NOTHING } else { SOMETHING }
                        }),
                    );
                })
            }
        }
    }
}

fn of_embree<'a>(scene: &'a embree::Scene, query: Query) -> Tracer<'a> {
    match query {
        Query::Closest => Box::new(|rays, answers| {
            answers.extend(rays.iter().map(|ray| scene.closest(ray.origin, ray.direction).unwrap_or(NOTHING)));
        }),
        Query::Any(reach) => Box::new(move |rays, answers| {
            answers.extend(
                rays.iter().map(
                    |ray| {
                        if scene.occluded(ray.origin, ray.direction, reach) { SOMETHING } else { NOTHING }
                    },
                ),
            );
        }),
    }
}

/// Prints the two rows of a scene, and notes how it was built and where the tracers disagree.
fn measure(name: &str, triangles: &[[Vec3; 3]], embree: Option<&embree::Library>, rounds: u32, notes: &mut String) {
    let start = Instant::now();
    let tree = Tree::build(triangles);
    let built = start.elapsed().as_secs_f64();
    writeln!(notes, "{name}: built in {built:.2} s on one thread, {:.1} MB", tree.bytes() as f64 * 1e-6).unwrap();
    let twin = Tree::build(triangles).portable();
    let obvhs = Obvhs::build(triangles);
    let scenes = embree.map(|embree| [true, false].map(|robust| embree.scene(triangles, robust)));
    let (rays, reach) = rays(&tree, triangles);
    for (label, query) in [("closest", Query::Closest), ("any", Query::Any(reach))] {
        let mut tracers = vec![of_tree(&tree, query), of_tree(&twin, query), obvhs.tracer(query)];
        tracers.extend(scenes.iter().flatten().map(|scene| of_embree(scene, query)));
        let results = race(&rays, rounds, &tracers);
        let share = |count: usize| 100.0 * count as f64 / rays.len() as f64;
        let hits = share(results[0].1.iter().filter(|answer| **answer != NOTHING).count());
        print!("| {name} | {} | {label} | {hits:.1} % |", triangles.len());
        results.iter().for_each(|(speed, _)| print!(" {speed:.2} |"));
        match results[..] {
            [(ours, _), .., (robust, _), (fast, _)] if embree.is_some() => {
                println!(" {:.2} | {:.2} |", ours / robust, ours / fast)
            }
            _ => println!(" | | | |"),
        }
        for (tracer, (_, theirs)) in ["portable", "obvhs", "Embree robust", "Embree fast"].iter().zip(&results[1..]) {
            let pairs = || results[0].1.iter().zip(theirs);
            let alike = pairs().filter(|(a, b)| a.0 == b.0 || (a.0 - b.0).abs() <= 1e-4 * a.0.max(1.0)).count();
            write!(
                notes,
                "{name}, {label}: {tracer} finds a hit at the same t, or none, on {:.4} % of the rays",
                share(alike)
            )
            .unwrap();
            if query == Query::Closest {
                let same = share(pairs().filter(|(a, b)| a.1 == b.1).count());
                write!(notes, ", and the same triangle on {same:.4} %").unwrap();
            }
            notes.push('\n');
        }
    }
}

/// Embree 4 by `dlopen`: what is needed of `rtcore.h`.
#[allow(unsafe_code, reason = "calls into a C library; see the proof at each block")]
mod embree {
    use std::ffi::{c_char, c_int, c_uint, c_void};
    use std::path::Path;
    use std::ptr;

    use glam::Vec3;
    use libloading::Library as Dynamic;

    type Handle = *mut c_void;

    /// `RTCRay`.
    #[repr(C, align(16))]
    #[derive(Clone, Copy)]
    struct RtcRay {
        origin: [f32; 3],
        t_near: f32,
        direction: [f32; 3],
        time: f32,
        t_far: f32,
        mask: u32,
        id: u32,
        flags: u32,
    }

    /// `RTCRayHit` with `RTCHit` written out; as long as with every compile-time option of Embree 4.
    #[repr(C, align(16))]
    struct RtcRayHit {
        ray: RtcRay,
        normal: [f32; 3],
        u: f32,
        v: f32,
        triangle: u32,
        geometry: u32,
        instance: [u32; 2],
        spare: [u32; 7],
    }

    /// Values of `rtcore.h`.
    const TYPE_TRIANGLE: c_int = 0;
    const BUFFER_INDEX: c_int = 0;
    const BUFFER_VERTEX: c_int = 1;
    const FORMAT_UINT3: c_int = 0x5003;
    const FORMAT_FLOAT3: c_int = 0x9003;
    const SCENE_ROBUST: c_int = 1 << 2;
    const QUALITY_HIGH: c_int = 2;
    const PROPERTY_VERSION: c_int = 0;
    const INVALID: u32 = u32::MAX;

    /// The functions, valid as long as the library stays open.
    #[derive(Clone, Copy)]
    struct Functions {
        new_scene: unsafe extern "C" fn(Handle) -> Handle,
        set_scene_flags: unsafe extern "C" fn(Handle, c_int),
        set_scene_build_quality: unsafe extern "C" fn(Handle, c_int),
        new_geometry: unsafe extern "C" fn(Handle, c_int) -> Handle,
        set_new_geometry_buffer: unsafe extern "C" fn(Handle, c_int, c_uint, c_int, usize, usize) -> *mut c_void,
        commit_geometry: unsafe extern "C" fn(Handle),
        attach_geometry: unsafe extern "C" fn(Handle, Handle) -> c_uint,
        release_geometry: unsafe extern "C" fn(Handle),
        commit_scene: unsafe extern "C" fn(Handle),
        release_scene: unsafe extern "C" fn(Handle),
        intersect: unsafe extern "C" fn(Handle, *mut RtcRayHit, *mut c_void),
        occluded: unsafe extern "C" fn(Handle, *mut RtcRay, *mut c_void),
        get_device_property: unsafe extern "C" fn(Handle, c_int) -> isize,
    }

    /// The open library and a device. Lives to the end of the tool.
    pub struct Library {
        _dynamic: Dynamic,
        functions: Functions,
        device: Handle,
    }

    impl Library {
        /// The library, or the end of the tool.
        pub fn open(path: &Path) -> Library {
            // Safe as far as the file is Embree 4, which is what the caller vouches for: its initialisers are harmless,
            // and the types above are those of its headers.
            unsafe {
                let dynamic = Dynamic::new(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
                macro_rules! function {
                    ($name:literal) => {
                        *dynamic.get($name).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
                    };
                }
                let new_device: unsafe extern "C" fn(*const c_char) -> Handle = function!(b"rtcNewDevice");
                let functions = Functions {
                    new_scene: function!(b"rtcNewScene"),
                    set_scene_flags: function!(b"rtcSetSceneFlags"),
                    set_scene_build_quality: function!(b"rtcSetSceneBuildQuality"),
                    new_geometry: function!(b"rtcNewGeometry"),
                    set_new_geometry_buffer: function!(b"rtcSetNewGeometryBuffer"),
                    commit_geometry: function!(b"rtcCommitGeometry"),
                    attach_geometry: function!(b"rtcAttachGeometry"),
                    release_geometry: function!(b"rtcReleaseGeometry"),
                    commit_scene: function!(b"rtcCommitScene"),
                    release_scene: function!(b"rtcReleaseScene"),
                    intersect: function!(b"rtcIntersect1"),
                    occluded: function!(b"rtcOccluded1"),
                    get_device_property: function!(b"rtcGetDeviceProperty"),
                };
                let device = new_device(ptr::null());
                assert!(!device.is_null(), "Embree made no device");
                let library = Library { _dynamic: dynamic, functions, device };
                assert!(library.version().starts_with("4."), "Embree {} is not 4", library.version());
                library
            }
        }

        /// Major, minor, patch.
        pub fn version(&self) -> String {
            // The device is valid.
            let version = unsafe { (self.functions.get_device_property)(self.device, PROPERTY_VERSION) };
            format!("{}.{}.{}", version / 10000, version / 100 % 100, version % 100)
        }

        /// A tree of quality HIGH over the triangles.
        pub fn scene(&self, triangles: &[[Vec3; 3]], robust: bool) -> Scene<'_> {
            let f = &self.functions;
            // The handles are made here and valid; the buffers that Embree hands out hold as many elements as are
            // written, and geometry lives on in its scene.
            unsafe {
                let scene = (f.new_scene)(self.device);
                (f.set_scene_flags)(scene, if robust { SCENE_ROBUST } else { 0 });
                (f.set_scene_build_quality)(scene, QUALITY_HIGH);
                let geometry = (f.new_geometry)(self.device, TYPE_TRIANGLE);
                let count = triangles.len();
                let buffer = f.set_new_geometry_buffer;
                let vertices = buffer(geometry, BUFFER_VERTEX, 0, FORMAT_FLOAT3, 12, 3 * count).cast::<[f32; 3]>();
                let indices = buffer(geometry, BUFFER_INDEX, 0, FORMAT_UINT3, 12, count).cast::<[u32; 3]>();
                assert!(!vertices.is_null() && !indices.is_null(), "Embree has no memory");
                for (i, triangle) in triangles.iter().enumerate() {
                    for (corner, position) in triangle.iter().enumerate() {
                        vertices.add(3 * i + corner).write(position.to_array());
                    }
                    indices.add(i).write([0, 1, 2].map(|corner| 3 * i as u32 + corner));
                }
                (f.commit_geometry)(geometry);
                (f.attach_geometry)(scene, geometry);
                (f.release_geometry)(geometry);
                (f.commit_scene)(scene);
                Scene { library: self, scene }
            }
        }
    }

    /// Triangles, built.
    pub struct Scene<'a> {
        library: &'a Library,
        scene: Handle,
    }

    fn ray(origin: Vec3, direction: Vec3, t_max: f32) -> RtcRay {
        let (origin, direction) = (origin.to_array(), direction.to_array());
        RtcRay { origin, t_near: 0.0, direction, time: 0.0, t_far: t_max, mask: u32::MAX, id: 0, flags: 0 }
    }

    impl Scene<'_> {
        /// t and triangle of the nearest hit.
        pub fn closest(&self, origin: Vec3, direction: Vec3) -> Option<(f32, u32)> {
            let mut hit = RtcRayHit {
                ray: ray(origin, direction, f32::INFINITY),
                normal: [0.0; 3],
                u: 0.0,
                v: 0.0,
                triangle: INVALID,
                geometry: INVALID,
                instance: [INVALID; 2],
                spare: [0; 7],
            };
            // The scene is committed, the ray of the layout Embree expects; no arguments means its defaults.
            unsafe { (self.library.functions.intersect)(self.scene, &mut hit, ptr::null_mut()) };
            (hit.geometry != INVALID).then_some((hit.ray.t_far, hit.triangle))
        }

        /// Whether anything is hit before `t_max`.
        pub fn occluded(&self, origin: Vec3, direction: Vec3, t_max: f32) -> bool {
            let mut ray = ray(origin, direction, t_max);
            // As above.
            unsafe { (self.library.functions.occluded)(self.scene, &mut ray, ptr::null_mut()) };
            ray.t_far == f32::NEG_INFINITY
        }
    }

    impl Drop for Scene<'_> {
        fn drop(&mut self) {
            // Made by this library, released once.
            unsafe { (self.library.functions.release_scene)(self.scene) };
        }
    }
}
