//! Small volumes, random queries, and cargo run for libraries of this package.

#![allow(dead_code, reason = "each test file uses its part")]

use gdibl_runtime::format::{
    Codec, Encoding, Filter, MESHES, NORMALS, POSITIONS, RADIANCE, SectionEntry, Units, VALIDITY, crc32,
    directory_to_bytes, place_sections,
};
use gdibl_runtime::{Header, Kind, packed};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Queries of a comparison.
pub const QUERIES: usize = 10_000;

/// A volume of 60 nodes, every seventh filled.
#[derive(Clone, Copy, Debug)]
pub struct Form {
    pub kind: Kind,
    pub encoding: Encoding,
    pub bands: u32,
}

pub const FORMS: [Form; 5] = [
    Form { kind: Kind::Grid, encoding: Encoding::F32, bands: 2 },
    Form { kind: Kind::Grid, encoding: Encoding::F16, bands: 2 },
    Form { kind: Kind::Grid, encoding: Encoding::Packed, bands: 2 },
    Form { kind: Kind::Points, encoding: Encoding::F16, bands: 4 },
    Form { kind: Kind::Vertices, encoding: Encoding::F32, bands: 1 },
];

impl Form {
    /// How far another build of the runtime may be from this one, in the units of E.
    pub fn tolerance(self) -> f32 {
        match self.encoding {
            Encoding::F32 => 1e-4,
            Encoding::F16 | Encoding::Packed => 1e-3,
        }
    }

    /// The file.
    pub fn bytes(self) -> Vec<u8> {
        let counts = if self.kind == Kind::Grid { [5, 4, 3] } else { [60, 1, 1] };
        let scale = match self.encoding {
            Encoding::F32 => 1.0,
            Encoding::F16 => 0.25,
            Encoding::Packed => 0.005,
        };
        let (min, max) = ([-1.0, 0.5, 2.0], [3.0, 2.0, 5.0]);
        let header = Header {
            kind: self.kind,
            counts,
            bands: self.bands,
            encoding: self.encoding,
            scale,
            units: Units::Radiance,
            min,
            max,
        };
        let mut random = Random(7);
        let mut contents = Vec::new();
        let (values, nodes) = (header.values_per_node(), header.node_count());
        let planes: Vec<f32> = (0..values * nodes)
            .map(|place| random.between(-1.0, 1.0) + if place / nodes < 3 { 3.0 } else { 0.0 })
            .collect();
        let radiance = match self.encoding {
            Encoding::F32 => planes.iter().flat_map(|value| value.to_le_bytes()).collect(),
            Encoding::F16 => planes.iter().flat_map(|value| half::f16::from_f32(value / scale).to_le_bytes()).collect(),
            Encoding::Packed => packed::numbers_to_bytes(nodes, values + 1, |node, numbers| {
                let values: Vec<f32> = (0..values).map(|plane| planes[plane * nodes + node]).collect();
                packed::quantise_node(&values, scale, numbers);
            }),
        };
        contents.push((RADIANCE, radiance));
        contents.push((VALIDITY, (0..60).map(|node| u8::from(node % 7 != 0)).collect()));
        if self.kind != Kind::Grid {
            let sizes = [4.0, 1.5, 3.0];
            let places = (0..60).flat_map(|_| sizes.map(|size| random.between(0.0, size).to_le_bytes()));
            contents.push((POSITIONS, places.collect::<Vec<_>>().concat()));
        }
        if self.kind == Kind::Vertices {
            let normals = (0..60).flat_map(|_| random.direction().map(f32::to_le_bytes));
            contents.push((NORMALS, normals.collect::<Vec<_>>().concat()));
            let sets: [[u32; 5]; 2] = [[3, 1, 0, 0, 40], [3, 1, 1, 40, 20]];
            contents.push((MESHES, sets.as_flattened().iter().flat_map(|word| word.to_le_bytes()).collect()));
        }
        file(&header, &contents)
    }
}

fn file(header: &Header, contents: &[([u8; 4], Vec<u8>)]) -> Vec<u8> {
    let mut entries: Vec<SectionEntry> = contents
        .iter()
        .map(|(id, bytes)| SectionEntry {
            id: *id,
            codec: Codec::Raw,
            filter: Filter::None,
            offset: 0,
            stored_size: bytes.len() as u64,
            raw_size: bytes.len() as u64,
            crc32: crc32(bytes),
        })
        .collect();
    place_sections(&mut entries);
    let mut file = directory_to_bytes(header, &entries);
    for (entry, (_, bytes)) in entries.iter().zip(contents) {
        file.resize(entry.offset as usize, 0);
        file.extend(bytes);
    }
    file
}

/// Where to ask, and the way the surface faces.
pub type Query = ([f32; 3], [f32; 3]);

/// [`QUERIES`] random ones, some outside the box of every [`Form`].
pub fn queries() -> Vec<Query> {
    let mut random = Random(1);
    (0..QUERIES)
        .map(|_| {
            let position = [random.between(-1.5, 3.5), random.between(0.3, 2.2), random.between(1.7, 5.3)];
            (position, random.direction())
        })
        .collect()
}

/// The largest difference, which must be within the tolerance.
#[track_caller]
pub fn assert_near(what: &str, found: &[[f32; 3]], truth: &[[f32; 3]], tolerance: f32) -> f32 {
    assert_eq!(found.len(), truth.len(), "{what}");
    assert!(!truth.is_empty(), "{what}: nothing to compare");
    let mut largest = 0.0;
    for (index, (found, truth)) in found.iter().zip(truth).enumerate() {
        for (value, expected) in found.iter().zip(truth) {
            let difference = (value - expected).abs();
            assert!(difference <= tolerance, "{what}, query {index}: found {found:?}, expected {truth:?}");
            largest = difference.max(largest);
        }
    }
    largest
}

/// Numerical Recipes' generator: enough to spread queries.
pub struct Random(u32);

impl Random {
    pub fn between(&mut self, low: f32, high: f32) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        low + (high - low) * ((self.0 >> 8) as f32 / (1 << 24) as f32)
    }

    /// A unit vector.
    pub fn direction(&mut self) -> [f32; 3] {
        loop {
            let v = [(); 3].map(|()| self.between(-1.0, 1.0));
            let length = v.iter().map(|x| x * x).sum::<f32>().sqrt();
            if (0.1..1.0).contains(&length) {
                return v.map(|x| x / length);
            }
        }
    }
}

/// Says why a test did not run, past the capturing of its output.
#[expect(clippy::explicit_write, reason = "eprintln is captured in a test that passes")]
pub fn skip(test: &str, why: &str) {
    writeln!(std::io::stderr(), "\n{test}: SKIPPED: {why}").unwrap();
}

/// Builds the library of this package with a command of cargo (`build`, `rustc`), into the target folder that this test is in, and returns the
/// files. Where they are only cargo knows (profile, target folder, name on the platform), and whether a test run made
/// them, too.
pub fn build_library(command: &str, arguments: &[&str]) -> Vec<PathBuf> {
    let cargo = std::env::var_os("CARGO").unwrap_or("cargo".into());
    let target_folder = Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap();
    let output = Command::new(cargo)
        .args([command, "--package", "gdibl-runtime-c", "--lib", "--message-format", "json", "--target-dir"])
        .arg(target_folder)
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .stderr(Stdio::inherit())
        .output()
        .unwrap();
    assert!(output.status.success(), "cargo {command} {arguments:?}: {}", output.status);
    let lines = String::from_utf8(output.stdout).unwrap();
    let mut messages = lines.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
    let is_library = |message: &serde_json::Value| {
        message["reason"] == "compiler-artifact" && message["target"]["name"] == "gdibl_runtime_c"
    };
    let artifact = messages.find(is_library).expect("cargo names what it built");
    let files = artifact["filenames"].as_array().unwrap();
    files.iter().map(|file| file.as_str().unwrap().into()).collect()
}

/// The one of these files with that ending.
pub fn with_extension(files: &[PathBuf], extensions: &[&str]) -> PathBuf {
    let found =
        files.iter().find(|file| extensions.iter().any(|&wanted| file.extension().is_some_and(|e| e == wanted)));
    found.unwrap_or_else(|| panic!("{extensions:?} among {files:?}")).clone()
}

/// Whether a program is there: it is asked for its version.
pub fn is_there(program: &str) -> bool {
    let asked = Command::new(program).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    asked.is_ok_and(|status| status.success())
}
