//! Small levels and panoramas, made by the tests themselves, and the program run on them.
#![allow(dead_code, reason = "every test binary uses its own part")]

use assert_cmd::Command;
use gdibl_baker::import::image::{Pose, SampleFormat, write_exr};
use gdibl_baker::panorama::{Image, Mapping};
use gdibl_runtime::Limits;
use gdibl_runtime::format::{self, Codec, Filter, SectionEntry};
use glam::DVec3;
use serde_json::{Value, json};
use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tempfile::TempDir;

pub type Triangle = [[f32; 3]; 3];

/// How a run of the program ended.
#[derive(Debug)]
pub struct Run {
    pub code: i32,
    pub out: String,
    pub err: String,
}

impl Run {
    pub fn of(output: &std::process::Output) -> Run {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Run { code: output.status.code().unwrap_or(-1), out: text(&output.stdout), err: text(&output.stderr) }
    }
}

/// A folder with inputs, in which the program runs, and another one for its cache.
pub struct Folder(TempDir, TempDir);

impl Folder {
    pub fn new() -> Folder {
        let new = || TempDir::new().expect("a temporary folder");
        Folder(new(), new())
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> &Folder {
        std::fs::create_dir_all(self.path(name).parent().unwrap()).unwrap();
        std::fs::write(self.path(name), bytes).unwrap();
        self
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    pub fn exists(&self, name: &str) -> bool {
        self.path(name).exists()
    }

    /// Names of everything in the folder, sorted.
    pub fn names(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.0.path()).unwrap();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    /// A panorama of `width` × `width`/2 pixels of `light` by direction.
    pub fn panorama(&self, name: &str, width: usize, position: Option<[f64; 3]>, light: impl Fn(DVec3) -> [f32; 3]) {
        std::fs::create_dir_all(self.path(name).parent().unwrap()).unwrap();
        let height = (width / 2).max(1);
        let pixels = (0..width * height).map(|i| light(pixel_direction(width, height, i))).collect();
        let pose = Pose { position: position.map(DVec3::from), rotation: None };
        let image = Image::new(width, height, pixels);
        write_exr(&self.path(name), &image, &pose, Mapping::LatLong, SampleFormat::F32).unwrap();
    }

    /// A probe of constant radiance, so fine that it counts on all surfaces of a room.
    pub fn constant(&self, name: &str, position: [f64; 3], radiance: [f32; 3]) {
        self.panorama(name, 512, Some(position), |_| radiance);
    }

    /// A distant panorama of constant radiance.
    pub fn sky(&self, name: &str, radiance: [f32; 3]) {
        self.panorama(name, 16, None, |_| radiance);
    }

    pub fn run(&self, arguments: &[&str]) -> Run {
        // Against a hang, not a measurement.
        let output = Command::from_std(self.command(arguments)).timeout(Duration::from_secs(300)).output();
        Run::of(&output.expect("the program runs"))
    }

    /// The program with its arguments, in this folder.
    pub fn command(&self, arguments: &[&str]) -> std::process::Command {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_gdibl"));
        command.current_dir(self.0.path()).env("XDG_CACHE_HOME", self.1.path()).args(arguments);
        command
    }

    /// What is in the cache: paths, sorted.
    pub fn cached(&self) -> Vec<PathBuf> {
        let entries = std::fs::read_dir(self.1.path().join("gdibl")).into_iter().flatten();
        let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
        paths.sort();
        paths
    }

    /// Runs and expects success; returns standard output.
    pub fn ok(&self, arguments: &[&str]) -> String {
        let run = self.run(arguments);
        assert_eq!(run.code, 0, "gdibl {arguments:?}\n{}", run.err);
        run.out
    }

    /// `gdibl bake … --json`, which must succeed.
    pub fn bake(&self, arguments: &[&str]) -> Value {
        let out = self.ok(&[&["bake"], arguments, &["--json"]].concat());
        serde_json::from_str(&out).expect("bake --json prints JSON")
    }

    pub fn inspect(&self, volume: &str) -> Value {
        serde_json::from_str(&self.ok(&["inspect", volume, "--json"])).expect("inspect --json prints JSON")
    }

    /// E and validity at places with normals.
    pub fn irradiance(&self, volume: &str, places: &[[f64; 6]]) -> Vec<[f64; 4]> {
        self.write("places.csv", csv_of(places));
        let rows = parse_csv(&self.ok(&["sample", volume, "--at", "places.csv"]));
        assert_eq!(rows.len(), places.len(), "one row per place");
        rows.iter().map(|row| [row[6], row[7], row[8], row[9]]).collect()
    }

    /// Coefficients (`[3 * coefficient + channel]`) and, last, validity.
    pub fn coefficients(&self, volume: &str, places: &[[f64; 3]]) -> Vec<Vec<f64>> {
        self.write("places.csv", csv_of(places));
        let rows = parse_csv(&self.ok(&["sample", volume, "--at", "places.csv", "--sh"]));
        assert_eq!(rows.len(), places.len(), "one row per place");
        rows.iter().map(|row| row[3..].to_vec()).collect()
    }
}

/// Lines of numbers as CSV, with a header line as `points:` wants it.
pub fn csv_of<const N: usize>(rows: &[[f64; N]]) -> String {
    let names = ["x", "y", "z", "nx", "ny", "nz"];
    let line = |row: &[f64; N]| row.map(|v| v.to_string()).join(",") + "\n";
    names[..N].join(",") + "\n" + &rows.iter().map(line).collect::<String>()
}

fn parse_csv(text: &str) -> Vec<Vec<f64>> {
    text.lines().skip(1).map(|line| line.split(',').map(|field| field.parse().unwrap()).collect()).collect()
}

/// The direction of pixel `index`: u = 0.5 - atan2(x, z)/2π, v = 0.5 - asin(y)/π.
pub fn pixel_direction(width: usize, height: usize, index: usize) -> DVec3 {
    let longitude = 2.0 * PI * (0.5 - ((index % width) as f64 + 0.5) / width as f64);
    let latitude = PI * (0.5 - ((index / width) as f64 + 0.5) / height as f64);
    DVec3::new(longitude.sin() * latitude.cos(), latitude.sin(), longitude.cos() * latitude.cos())
}

/// 26 directions: the neighbours of a cube's centre.
pub fn normals() -> Vec<DVec3> {
    let steps = [-1.0, 0.0, 1.0];
    let all = steps.iter().flat_map(|&x| steps.iter().flat_map(move |&y| steps.map(|z| DVec3::new(x, y, z))));
    all.filter_map(DVec3::try_normalize).collect()
}

/// A level under construction: `json` may be edited freely.
#[derive(Clone)]
pub struct Level {
    pub json: Value,
    bytes: Vec<u8>,
}

impl Level {
    /// An empty level. Material 0 is dull white (albedo 1).
    pub fn new() -> Level {
        let mut level = Level { json: json!({ "asset": { "version": "2.0" } }), bytes: Vec::new() };
        level.material(json!({ "pbrMetallicRoughness": { "metallicFactor": 0.0 } }));
        level
    }

    /// The closed box as environment geometry.
    pub fn room(min: [f32; 3], max: [f32; 3]) -> Level {
        let mut level = Level::new();
        level.object(&box_of(min, max), 0, json!({}));
        level
    }

    /// Adds a material; returns its index.
    pub fn material(&mut self, material: Value) -> usize {
        push(&mut self.json, "materials", material)
    }

    /// Adds triangles as a node; `node` holds further fields of it (translation, extras …). Returns its index.
    pub fn object(&mut self, triangles: &[Triangle], material: usize, node: Value) -> usize {
        let floats: Vec<f32> = triangles.iter().flatten().flatten().copied().collect();
        let offset = self.bytes.len();
        self.bytes.extend(floats.iter().flat_map(|v| v.to_le_bytes()));
        let view = json!({ "buffer": 0, "byteOffset": offset, "byteLength": 4 * floats.len() });
        let view = push(&mut self.json, "bufferViews", view);
        let bound = |least: fn(f32, f32) -> f32| {
            let corners = || triangles.iter().flatten();
            [0, 1, 2].map(|axis| corners().map(|c| c[axis]).reduce(least).unwrap())
        };
        let accessor = json!({ "bufferView": view, "componentType": 5126, "count": 3 * triangles.len(),
            "type": "VEC3", "min": bound(f32::min), "max": bound(f32::max) });
        let accessor = push(&mut self.json, "accessors", accessor);
        let primitive = json!({ "attributes": { "POSITION": accessor }, "material": material });
        let mesh = push(&mut self.json, "meshes", json!({ "primitives": [primitive] }));
        let mut node = node;
        node["mesh"] = json!(mesh);
        self.node(node)
    }

    /// Triangles that are scene geometry.
    pub fn scene_object(&mut self, triangles: &[Triangle], material: usize) -> usize {
        self.object(triangles, material, json!({ "extras": { "gdibl_role": "scene" } }))
    }

    pub fn node(&mut self, node: Value) -> usize {
        push(&mut self.json, "nodes", node)
    }

    pub fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        if !self.bytes.is_empty() {
            json["buffers"] = json!([{ "byteLength": self.bytes.len() }]);
        }
        let mut text = json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let chunk = |kind: &[u8; 4], bytes: &[u8]| [&(bytes.len() as u32).to_le_bytes()[..], kind, bytes].concat();
        let mut chunks = chunk(b"JSON", &text);
        if !self.bytes.is_empty() {
            chunks.extend(chunk(b"BIN\0", &self.bytes));
        }
        [b"glTF", &2u32.to_le_bytes()[..], &(chunks.len() as u32 + 12).to_le_bytes(), &chunks].concat()
    }

    pub fn write(&self, folder: &Folder, name: &str) {
        folder.write(name, self.glb());
    }
}

fn push(json: &mut Value, list: &str, value: Value) -> usize {
    if json[list].is_null() {
        json[list] = json!([]);
    }
    let list = json[list].as_array_mut().unwrap();
    list.push(value);
    list.len() - 1
}

/// Twelve triangles, facing inward.
pub fn box_of(min: [f32; 3], max: [f32; 3]) -> Vec<Triangle> {
    let corner = |i: usize| [0, 1, 2].map(|axis| if i >> axis & 1 == 0 { min[axis] } else { max[axis] });
    let faces = [[0, 2, 6, 4], [1, 5, 7, 3], [0, 4, 5, 1], [2, 3, 7, 6], [0, 1, 3, 2], [4, 6, 7, 5]];
    faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]].map(|t| t.map(corner))).collect()
}

/// Twelve triangles, facing outward.
pub fn solid_of(min: [f32; 3], max: [f32; 3]) -> Vec<Triangle> {
    box_of(min, max).into_iter().map(|[a, b, c]| [a, c, b]).collect()
}

/// The square |x|, |y| <= half at the given z, facing -z.
pub fn panel(half: f32, z: f32) -> Vec<Triangle> {
    let h = half;
    vec![[[-h, -h, z], [-h, h, z], [h, h, z]], [[-h, -h, z], [h, h, z], [h, -h, z]]]
}

/// Solid angle, sr, of a square of half side `half`, seen from `distance` over its centre.
pub fn square_solid_angle(half: f64, distance: f64) -> f64 {
    4.0 * (half * half / (half * half + distance * distance)).asin()
}

/// Python, or a visible message and `None`.
pub fn python() -> Option<PathBuf> {
    let runs =
        |name: &str| std::process::Command::new(name).arg("--version").output().is_ok_and(|o| o.status.success());
    if runs("python3") {
        return Some("python3".into());
    }
    eprintln!("SKIPPED: python3 is missing, the independent reader was not run");
    None
}

/// A file of the repository.
pub fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// The same file without compression, its sections changed by their names.
pub fn with_sections(file: &[u8], mut change: impl FnMut(&[u8; 4], &mut Vec<u8>)) -> Vec<u8> {
    let directory = format::parse_header_and_sections(file).unwrap();
    let mut contents = Vec::new();
    let mut entries = Vec::new();
    for entry in &directory.sections {
        let mut bytes = directory.section_bytes(entry.id, &Limits::default()).unwrap().unwrap().into_owned();
        change(&entry.id, &mut bytes);
        entries.push(SectionEntry {
            codec: Codec::Raw,
            filter: Filter::None,
            stored_size: bytes.len() as u64,
            raw_size: bytes.len() as u64,
            crc32: format::crc32(&bytes),
            ..*entry
        });
        contents.push(bytes);
    }
    format::place_sections(&mut entries);
    let mut bytes = format::directory_to_bytes(&directory.header, &entries);
    for (entry, contents) in entries.iter().zip(&contents) {
        bytes.resize(entry.offset as usize, 0);
        bytes.extend_from_slice(contents);
    }
    bytes
}
