//! Reading and writing panoramas, on files that the tests make themselves.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Layer, Layers, write::WritableImage};
use exr::math::Vec2;
use exr::meta::attribute::{AttributeValue, EnvironmentMap, IntegerBounds, LineOrder, Text};
use exr::meta::header::{ImageAttributes, LayerAttributes};
use exr::prelude::{Blocks, Compression, SmallVec};
use gdibl_baker::Error;
use gdibl_baker::import::image::{Image, Imported, Pose, ReadOptions, SampleFormat, read_image, write_exr};
use gdibl_baker::panorama::Mapping;
use glam::{DQuat, DVec3};
use half::f16;

const STRICT: ReadOptions = ReadOptions { repair_pixels: false, layer: None };
const REPAIR: ReadOptions = ReadOptions { repair_pixels: true, layer: None };

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Folder(tempfile::tempdir().unwrap())
    }
    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(name);
        fs::write(&path, bytes).unwrap();
        path
    }
}

#[track_caller]
fn assert_invalid(result: Result<Imported, Error>, parts: &[&str]) {
    match result {
        Err(Error::Invalid { ref message, .. }) => {
            for part in parts {
                assert!(message.contains(part), "{message:?} lacks {part:?}");
            }
        }
        other => panic!("expected Invalid, got {other:?}"),
    }
}

#[track_caller]
fn assert_unsupported(result: Result<Imported, Error>, parts: &[&str]) {
    match result {
        Err(Error::Unsupported { ref message, .. }) => {
            for part in parts {
                assert!(message.contains(part), "{message:?} lacks {part:?}");
            }
        }
        other => panic!("expected Unsupported, got {other:?}"),
    }
}

fn finding(imported: &Imported, id: &str) -> Option<u64> {
    imported.findings.iter().find(|finding| finding.id == id).map(|finding| finding.count)
}

/// An image with as many different values as it has samples, over 12 orders of magnitude.
fn varied(width: usize, height: usize, with_distance: bool) -> Image {
    let value = |i: usize| 10f32.powf((i * 7 % 25) as f32 / 2.0 - 6.0) * (1.0 + i as f32 * 1e-3);
    let pixels = (0..width * height).map(|i| [value(3 * i), value(3 * i + 1), value(3 * i + 2)]).collect();
    let metres = |i: usize| if i.is_multiple_of(5) { f32::INFINITY } else { value(i) };
    let distance = with_distance.then(|| (0..width * height).map(metres).collect());
    Image { width, height, pixels, distance }
}

// ---- what write_exr writes, read_image reads ----

#[test]
fn exr_returns_what_was_written() {
    let folder = Folder::new();
    let path = folder.path("probe.exr");
    let pose = Pose {
        position: Some(DVec3::new(1.5, -2.0, 1024.25)),
        rotation: Some(DQuat::from_rotation_y(0.5) * DQuat::from_rotation_x(-0.25)),
    };
    for (width, height) in [(1, 1), (2, 1), (1, 2), (3, 5), (17, 16), (33, 67), (512, 256)] {
        for with_distance in [false, true] {
            let image = varied(width, height, with_distance);
            assert!(write_exr(&path, &image, &pose, Mapping::LatLong, SampleFormat::F32).unwrap().is_empty());
            let imported = read_image(&path, &STRICT).unwrap();
            assert_eq!(imported.image, image);
            assert_eq!(imported.mapping, Some(Mapping::LatLong));
            assert!(imported.findings.is_empty(), "{:?}", imported.findings);
            assert_eq!(imported.pose.position, pose.position);
            assert!(imported.pose.rotation.unwrap().dot(pose.rotation.unwrap()) > 1.0 - 1e-12);
        }
    }
    let cube = varied(4, 24, false);
    write_exr(&path, &cube, &Pose::default(), Mapping::CubeExr, SampleFormat::F32).unwrap();
    let imported = read_image(&path, &STRICT).unwrap();
    assert_eq!((imported.mapping, imported.pose), (Some(Mapping::CubeExr), Pose::default()));
    assert_eq!(imported.image, cube);
    let angular = varied(8, 8, true);
    let pose = Pose { position: Some(DVec3::ONE), rotation: None };
    write_exr(&path, &angular, &pose, Mapping::AngularMap, SampleFormat::F32).unwrap();
    let imported = read_image(&path, &STRICT).unwrap();
    assert_eq!((imported.mapping, imported.pose), (Some(Mapping::AngularMap), pose));
    assert_eq!(imported.image, angular);
}

#[test]
fn exr_as_half_floats_rounds_and_says_where_it_clips() {
    let folder = Folder::new();
    let path = folder.path("half.exr");
    let mut image = varied(9, 7, true);
    image.pixels.iter_mut().flatten().for_each(|v| *v = v.clamp(1e-3, 1e3));
    image.pixels[10] = [1e6, 1.0, 1.0];
    image.pixels[11] = [65504.0, 2.0, 70000.0];
    let written = write_exr(&path, &image, &Pose::default(), Mapping::LatLong, SampleFormat::F16).unwrap();
    assert_eq!((written[0].id.as_str(), written[0].count), ("half-float-clipping", 2));
    let imported = read_image(&path, &STRICT).unwrap();
    assert_eq!(finding(&imported, "half-float-clipping"), Some(2));
    assert_eq!(imported.image.distance, image.distance, "Z stays exact");
    for (found, expected) in imported.image.pixels.iter().flatten().zip(image.pixels.iter().flatten()) {
        assert_eq!(*found, f16::from_f32(expected.min(65504.0)).to_f32());
    }
}

#[test]
fn exr_bytes_depend_on_the_arguments_alone() {
    let folder = Folder::new();
    let pose = Pose { position: Some(DVec3::ONE), rotation: Some(DQuat::IDENTITY) };
    let bytes: Vec<Vec<u8>> = (0..8)
        .map(|i| {
            let path = folder.path(&format!("{i}.exr"));
            write_exr(&path, &varied(64, 32, true), &pose, Mapping::LatLong, SampleFormat::F32).unwrap();
            fs::read(path).unwrap()
        })
        .collect();
    assert!(bytes.iter().all(|b| *b == bytes[0]));
    // The attributes are in the file as documented: name, type, size, little-endian floats.
    let find = |needle: &[u8]| bytes[0].windows(needle.len()).any(|window| window == needle);
    let one = 1f32.to_le_bytes();
    assert!(find(&[&b"gdibl:position\0v3f\0\x0c\0\0\0"[..], &one, &one, &one].concat()));
    assert!(find(&[&b"gdibl:rotation\0v4f\0\x10\0\0\0"[..], &[0; 12], &one].concat()));
    // Nothing but the files themselves is left in the folder.
    assert_eq!(fs::read_dir(folder.path("")).unwrap().count(), 8);
}

#[test]
fn write_exr_replaces_whole_files_only() {
    let folder = Folder::new();
    let path = folder.write("old.exr", "old");
    let image = varied(2, 2, false);
    let turned = Pose { rotation: Some(DQuat::IDENTITY), position: None };
    let refused = write_exr(&path, &image, &turned, Mapping::AngularMap, SampleFormat::F32);
    assert!(matches!(refused, Err(Error::Unsupported { .. })), "{refused:?}");
    assert_eq!(fs::read(&path).unwrap(), b"old");
    let missing = write_exr(&folder.path("no/x.exr"), &image, &Pose::default(), Mapping::LatLong, SampleFormat::F32);
    assert!(matches!(missing, Err(Error::Io { .. })), "{missing:?}");
    write_exr(&path, &image, &Pose::default(), Mapping::LatLong, SampleFormat::F32).unwrap();
    assert_eq!(read_image(&path, &STRICT).unwrap().image, image);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&path), mode(&folder.write("plain", "")), "permissions of an ordinary file");
    }
}

// ---- EXR files of other programs ----

struct ExrFile {
    size: (usize, usize),
    channels: Vec<(&'static str, FlatSamples)>,
    compression: Compression,
    blocks: Blocks,
    attributes: LayerAttributes,
    display: Option<IntegerBounds>,
    shared: Vec<(&'static str, AttributeValue)>,
}

impl ExrFile {
    fn new(size: (usize, usize), channels: &[(&'static str, FlatSamples)]) -> Self {
        ExrFile {
            size,
            channels: channels.to_vec(),
            compression: Compression::ZIP16,
            blocks: Blocks::ScanLines,
            attributes: LayerAttributes::default(),
            display: None,
            shared: Vec::new(),
        }
    }

    fn layer(&self) -> Layer<AnyChannels<FlatSamples>> {
        let channels: SmallVec<[AnyChannel<FlatSamples>; 4]> =
            self.channels.iter().map(|(name, samples)| AnyChannel::new(*name, samples.clone())).collect();
        let encoding =
            Encoding { compression: self.compression, blocks: self.blocks, line_order: LineOrder::Increasing };
        Layer::new(self.size, self.attributes.clone(), encoding, AnyChannels::sort(channels))
    }

    fn write(&self, folder: &Folder) -> PathBuf {
        let path = folder.path("made.exr");
        let mut image = exr::image::Image::from_layer(self.layer());
        if let Some(display) = self.display {
            image.attributes.display_window = display;
        }
        for (name, value) in &self.shared {
            image.attributes.other.insert(Text::from(*name), value.clone());
        }
        image.write().to_file(&path).unwrap();
        path
    }

    fn read(&self, options: &ReadOptions) -> Result<Imported, Error> {
        let folder = Folder::new();
        read_image(&self.write(&folder), options)
    }
}

fn f32s(values: &[f32]) -> FlatSamples {
    FlatSamples::F32(values.to_vec())
}

fn rgb(values: [&[f32]; 3]) -> Vec<(&'static str, FlatSamples)> {
    vec![("R", f32s(values[0])), ("G", f32s(values[1])), ("B", f32s(values[2]))]
}

/// 2 × 1 pixels: (1, 2, 3) and (4, 5, 6).
fn two_pixels() -> Vec<(&'static str, FlatSamples)> {
    rgb([&[1.0, 4.0], &[2.0, 5.0], &[3.0, 6.0]])
}

const TWO_PIXELS: [[f32; 3]; 2] = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]];

#[test]
fn exr_channels_are_found_by_name() {
    let z = f32s(&[7.0, f32::INFINITY]);
    let other = f32s(&[0.5, 0.5]);
    let named = |names: [&'static str; 3]| -> Vec<(&'static str, FlatSamples)> {
        names.into_iter().zip(two_pixels()).map(|(name, (_, samples))| (name, samples)).collect()
    };
    let with = |channels: Vec<(&'static str, FlatSamples)>, more: &[(&'static str, FlatSamples)]| {
        [channels, more.to_vec()].concat()
    };
    for (channels, has_distance) in [
        (named(["R", "G", "B"]), false),
        (with(named(["R", "G", "B"]), &[("A", other.clone()), ("Z", z.clone())]), true),
        (named(["r", "g", "b"]), false),
        (with(named(["beauty.R", "beauty.G", "beauty.B"]), &[("beauty.Z", z.clone())]), true),
        (with(named(["beauty.R", "beauty.G", "beauty.B"]), &[("depth.Z", z.clone())]), true),
        (with(named(["View.Combined.R", "View.Combined.G", "View.Combined.B"]), &[("View.Depth.Z", z.clone())]), true),
        // The picture itself comes before a layer of the same names.
        (
            with(named(["R", "G", "B"]), &[("aa.R", other.clone()), ("aa.G", other.clone()), ("aa.B", other.clone())]),
            false,
        ),
        // A layer that has no colour is passed over.
        (with(named(["mm.R", "mm.G", "mm.B"]), &[("aa.X", other.clone()), ("aa.Y2", other.clone())]), false),
    ] {
        let names: Vec<&str> = channels.iter().map(|c| c.0).collect();
        let imported = ExrFile::new((2, 1), &channels).read(&STRICT).unwrap();
        assert_eq!(imported.image.pixels, TWO_PIXELS, "{names:?}");
        assert_eq!(imported.image.distance, has_distance.then(|| vec![7.0, f32::INFINITY]), "{names:?}");
    }
    // Luminance is grey.
    let grey = ExrFile::new((2, 1), &[("Y", f32s(&[1.5, 2.5]))]).read(&STRICT).unwrap();
    assert_eq!(grey.image.pixels, [[1.5; 3], [2.5; 3]]);
    let chroma = [("Y", f32s(&[1.0, 1.0])), ("RY", other.clone()), ("BY", other.clone())];
    assert_unsupported(ExrFile::new((2, 1), &chroma).read(&STRICT), &["luminance-chroma", "R, G and B"]);
    let strange = [("U", other.clone()), ("V", other)];
    assert_unsupported(ExrFile::new((2, 1), &strange).read(&STRICT), &["found U, V"]);
}

#[test]
fn exr_sample_types_and_compressions_agree() {
    // Multiples of 1/4 below 64 are exact in every type but u32.
    let (width, height) = (40, 37);
    let values: Vec<f32> = (0..width * height).map(|i| (i % 256) as f32 / 4.0).collect();
    let expected: Vec<[f32; 3]> = values.iter().map(|v| [*v, 2.0, v.floor()]).collect();
    let channels = [
        ("R", FlatSamples::F16(values.iter().map(|v| f16::from_f32(*v)).collect())),
        ("G", f32s(&vec![2.0; values.len()])),
        ("B", FlatSamples::U32(values.iter().map(|v| *v as u32).collect())),
        ("Z", FlatSamples::F16(values.iter().map(|v| f16::from_f32(*v)).collect())),
    ];
    for compression in [
        Compression::Uncompressed,
        Compression::RLE,
        Compression::ZIP1,
        Compression::ZIP16,
        Compression::PIZ,
        Compression::PXR24,
    ] {
        for blocks in [Blocks::ScanLines, Blocks::Tiles(Vec2(16, 8)), Blocks::Tiles(Vec2(64, 64))] {
            let mut file = ExrFile::new((width, height), &channels);
            (file.compression, file.blocks) = (compression, blocks);
            let imported = file.read(&STRICT).unwrap();
            assert!(imported.image.pixels == expected, "{compression:?} {blocks:?}");
            assert_eq!(imported.image.distance.as_ref(), Some(&values), "{compression:?} {blocks:?}");
        }
    }
    // Lossy: near, on a smooth picture.
    let smooth: Vec<f32> =
        (0..width * height).map(|i| 8.0 + ((i % width) as f32 / 10.0).sin() + (i / width) as f32 / 9.0).collect();
    let halves = FlatSamples::F16(smooth.iter().map(|v| f16::from_f32(*v)).collect());
    let channels = [("R", halves.clone()), ("G", halves.clone()), ("B", halves)];
    for compression in [Compression::B44, Compression::B44A, Compression::DWAA(None), Compression::DWAB(None)] {
        let mut file = ExrFile::new((width, height), &channels);
        file.compression = compression;
        let imported = file.read(&STRICT).unwrap();
        let errors = imported.image.pixels.iter().zip(&smooth).map(|(pixel, v)| (pixel[1] / v - 1.0).abs());
        let worst = errors.fold(0.0, f32::max);
        assert!(worst < 0.03, "{compression:?}: {worst}");
    }
}

#[test]
fn exr_of_many_parts_gives_the_first_with_colour() {
    let folder = Folder::new();
    let path = folder.path("parts.exr");
    let part = |name: &str, channels: &[(&'static str, FlatSamples)]| {
        let mut file = ExrFile::new((2, 1), channels);
        file.attributes.layer_name = Some(Text::from(name));
        file.layer()
    };
    let layers: Layers<AnyChannels<FlatSamples>> = [
        part("depth", &[("Z", f32s(&[1.0, 2.0]))]),
        part("left", &two_pixels()),
        part("right", &rgb([&[9.0, 9.0], &[9.0, 9.0], &[9.0, 9.0]])),
    ]
    .into_iter()
    .collect();
    let image = exr::image::Image { attributes: ImageAttributes::with_size((2, 1)), layer_data: layers };
    image.write().to_file(&path).unwrap();
    let imported = read_image(&path, &STRICT).unwrap();
    assert_eq!(imported.image.pixels, TWO_PIXELS);
    assert_eq!(imported.image.distance, Some(vec![1.0, 2.0]), "the depth of the part beside it");
}

#[test]
fn exr_shows_what_the_display_window_frames() {
    let bounds = |x: i32, y: i32, w: usize, h: usize| IntegerBounds { position: Vec2(x, y), size: Vec2(w, h) };
    let values: Vec<f32> = (0..12).map(|i| i as f32).collect();
    let channels = [rgb([&values; 3]), vec![("Z", f32s(&[5.0; 12]))]].concat();
    let mut file = ExrFile::new((4, 3), &channels);
    file.attributes.layer_position = Vec2(-1, 2);
    // Inside the data: cropped.
    file.display = Some(bounds(0, 3, 2, 2));
    let cropped = file.read(&STRICT).unwrap();
    assert_eq!(cropped.image.pixels, [5.0, 6.0, 9.0, 10.0].map(|v| [v; 3]));
    assert_eq!(finding(&cropped, "display-window"), Some(0));
    // Around it: black, and nothing there.
    file.display = Some(bounds(-2, 1, 6, 5));
    let framed = file.read(&STRICT).unwrap();
    assert_eq!((framed.image.width, framed.image.height), (6, 5));
    assert_eq!(finding(&framed, "display-window"), Some(30 - 12));
    for (i, pixel) in framed.image.pixels.iter().enumerate() {
        let (x, y) = (i % 6, i / 6);
        let inside = (1..5).contains(&x) && (1..4).contains(&y);
        assert_eq!(*pixel, [if inside { ((y - 1) * 4 + x - 1) as f32 } else { 0.0 }; 3]);
        assert_eq!(framed.image.distance.as_ref().unwrap()[i], if inside { 5.0 } else { f32::INFINITY });
    }
    // Beside it, or so far around it that next to nothing has data: the data is the picture.
    for display in [bounds(100, 0, 4, 3), bounds(-1, 2, 4, 3 * 17), bounds(-1, 2, 1 << 29, 1 << 29)] {
        file.display = Some(display);
        let data = file.read(&STRICT).unwrap();
        assert_eq!((data.image.width, data.image.height), (4, 3));
        assert_eq!(data.image.pixels[11], [11.0; 3]);
        assert!(data.findings[0].message.contains("the data window was read"), "{:?}", data.findings);
    }
    // Environment maps are defined over the data window.
    file.attributes.environment_map = Some(EnvironmentMap::LatitudeLongitude);
    let environment = file.read(&STRICT).unwrap();
    assert_eq!(environment.image.pixels.len(), 12);
    assert!(environment.findings.is_empty());
}

#[test]
fn exr_pose_comes_from_our_attributes_then_from_the_camera() {
    let mut file = ExrFile::new((2, 1), &two_pixels());
    // A camera at (1, 2, 3) looking along -Z of the world.
    file.attributes.world_to_camera = Some([1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., -1., -2., -3., 1.]);
    let pose = file.read(&STRICT).unwrap().pose;
    assert_eq!(pose.position, Some(DVec3::new(1.0, 2.0, 3.0)));
    assert!((pose.rotation.unwrap() * DVec3::Z - DVec3::NEG_Z).length() < 1e-6, "the image centre looks along -Z");

    // Ours wins, each for itself.
    file.shared = vec![("gdibl:position", AttributeValue::FloatVec3((7.0, 8.0, 9.0)))];
    let mixed = file.read(&STRICT).unwrap().pose;
    assert_eq!((mixed.position, mixed.rotation), (Some(DVec3::new(7.0, 8.0, 9.0)), pose.rotation));

    // Other types that hold the numbers.
    let custom = |kind: &str, bytes: Vec<u8>| AttributeValue::Custom { kind: Text::from(kind), bytes: bytes.into() };
    let doubles = [1e6 + 0.125, -2.0, 3.0].into_iter().flat_map(f64::to_le_bytes).collect();
    let text = AttributeValue::Text(Text::from("0 0.6, 0 -0.8"));
    file.shared = vec![("gdibl:position", custom("v3d", doubles)), ("gdibl:rotation", text)];
    let pose = file.read(&STRICT).unwrap().pose;
    assert_eq!(pose.position, Some(DVec3::new(1e6 + 0.125, -2.0, 3.0)));
    assert!((pose.rotation.unwrap().dot(DQuat::from_xyzw(0.0, 0.6, 0.0, -0.8)) - 1.0).abs() < 1e-12);

    for (name, value) in [
        ("gdibl:position", AttributeValue::FloatVec3((f32::NAN, 0.0, 0.0))),
        ("gdibl:position", AttributeValue::F32(1.0)),
        ("gdibl:position", AttributeValue::Text(Text::from("1 2"))),
        ("gdibl:rotation", AttributeValue::Text(Text::from("0 0 0 0"))),
        ("gdibl:rotation", AttributeValue::Text(Text::from("0 0 0 x"))),
        ("gdibl:rotation", custom("v4f", vec![0; 15])),
        ("gdibl:rotation", custom("v4f", vec![0xff; 16])),
        ("gdibl:rotation", custom("other", 1f32.to_le_bytes().repeat(4))),
    ] {
        file.shared = vec![(name, value)];
        assert_invalid(file.read(&STRICT), &[name, "expected"]);
    }

    // A matrix that is no camera is not the end.
    let mut file = ExrFile::new((2, 1), &two_pixels());
    file.attributes.world_to_camera = Some([0.0; 16]);
    let imported = file.read(&STRICT).unwrap();
    assert_eq!(imported.pose, Pose::default());
    assert_eq!(finding(&imported, "world-to-camera"), Some(1));
}

// ---- samples that are not light ----

#[test]
fn unusable_samples_are_refused_with_their_place() {
    let mut g = vec![1.0f32; 15];
    (g[7], g[9], g[11]) = (f32::NAN, f32::NEG_INFINITY, -0.5);
    let ones = vec![1.0f32; 15];
    let file = ExrFile::new((5, 3), &rgb([&ones, &g, &ones]));
    assert_invalid(
        file.read(&STRICT),
        &["channel G", "x 2, y 1", "NaN", "3 samples", "1 NaN, 1 infinite, 1 negative", "--repair-pixels"],
    );
    g[7] = 1.0;
    assert_invalid(ExrFile::new((5, 3), &rgb([&ones, &g, &ones])).read(&STRICT), &["x 4, y 1", "-inf"]);
    g[9] = 1.0;
    assert_invalid(ExrFile::new((5, 3), &rgb([&ones, &g, &ones])).read(&STRICT), &["x 1, y 2", "-0.5"]);
    g[11] = -0.0;
    assert!(ExrFile::new((5, 3), &rgb([&ones, &g, &ones])).read(&STRICT).is_ok());
    // The name is the file's own.
    let layer = [("l.R", f32s(&[1.0])), ("l.G", f32s(&[1.0])), ("l.B", f32s(&[f32::INFINITY]))];
    assert_invalid(ExrFile::new((1, 1), &layer).read(&STRICT), &["channel l.B", "inf"]);
}

#[test]
fn repair_takes_neighbours_and_clamps_negatives() {
    let nan = f32::NAN;
    #[rustfmt::skip]
    let r = [
        1.0, 2.0, 3.0, -4.0,
        1.0, nan, 3.0, f32::INFINITY,
        1.0, 2.0, 3.0, 8.0,
    ];
    let ones = [1.0; 12];
    let imported = ExrFile::new((4, 3), &rgb([&r, &ones, &ones])).read(&REPAIR).unwrap();
    let red: Vec<f32> = imported.image.pixels.iter().map(|p| p[0]).collect();
    assert_eq!(red[3], 0.0, "negative");
    assert_eq!(red[5], 16.0 / 8.0, "mean of the eight around it");
    assert_eq!(red[7], (3.0 + 0.0 + 3.0 + 3.0 + 8.0) / 5.0, "mean of the five at the border");
    assert_eq!((red[0], red[6], red[11]), (1.0, 3.0, 8.0), "others untouched");
    assert!(imported.image.pixels.iter().all(|p| p[1] == 1.0 && p[2] == 1.0));
    assert_eq!(finding(&imported, "repaired-pixels"), Some(3));
    assert_eq!(finding(&ExrFile::new((2, 1), &two_pixels()).read(&REPAIR).unwrap(), "repaired-pixels"), None);
}

#[test]
fn repair_grows_into_large_holes() {
    let (w, h) = (31, 21);
    // One valid pixel.
    let mut values = vec![f32::NAN; w * h];
    values[10 * w + 3] = 6.0;
    let one = ExrFile::new((w, h), &rgb([&values; 3])).read(&REPAIR).unwrap();
    assert!(one.image.pixels.iter().flatten().all(|v| (*v - 6.0).abs() < 1e-4));
    // None.
    let none = ExrFile::new((w, h), &rgb([&vec![f32::NAN; w * h]; 3])).read(&REPAIR).unwrap();
    assert!(none.image.pixels.iter().flatten().all(|v| *v == 0.0));
    assert_eq!(finding(&none, "repaired-pixels"), Some((3 * w * h) as u64));
    // Huge values do not overflow on the way.
    let huge = ExrFile::new((3, 1), &rgb([&[f32::MAX, f32::NAN, f32::MAX]; 3])).read(&REPAIR).unwrap();
    assert_eq!(huge.image.pixels[1], [f32::MAX; 3]);
}

#[test]
fn distances_must_be_distances() {
    let with = |z: [f32; 2]| ExrFile::new((2, 1), &[two_pixels(), vec![("Z", f32s(&z))]].concat());
    assert_eq!(with([0.0, f32::INFINITY]).read(&STRICT).unwrap().image.distance, Some(vec![0.0, f32::INFINITY]));
    assert_invalid(with([1.0, f32::NAN]).read(&STRICT), &["channel Z", "x 1, y 0", "NaN"]);
    assert_invalid(with([-1.0, 1.0]).read(&STRICT), &["channel Z", "x 0, y 0", "-1"]);
    assert_invalid(with([f32::NEG_INFINITY, 1.0]).read(&STRICT), &["channel Z", "-inf"]);
    let repaired = with([f32::NAN, -2.0]).read(&REPAIR).unwrap();
    assert_eq!(repaired.image.distance, Some(vec![f32::INFINITY; 2]));
    assert_eq!(finding(&repaired, "repaired-distances"), Some(2));
    assert_eq!(finding(&repaired, "repaired-pixels"), None);
    let far = with([1e10, 9e8]).read(&STRICT).unwrap();
    assert_eq!(far.image.distance, Some(vec![f32::INFINITY, 9e8]));
    assert_eq!(finding(&far, "far-distance-escapes"), Some(1));
}

#[test]
fn half_floats_at_their_end_are_a_finding() {
    let halves = |v: [f32; 2]| FlatSamples::F16(v.map(f16::from_f32).to_vec());
    let channels = [("R", halves([65504.0, 1.0])), ("G", halves([1.0, 65472.0])), ("B", f32s(&[1.0, 1e9]))];
    let imported = ExrFile::new((2, 1), &channels).read(&STRICT).unwrap();
    assert_eq!(finding(&imported, "half-float-clipping"), Some(1), "B is not half, 65472 is not the end");
}

// ---- .hdr ----

/// A `.hdr` of flat RGBE pixels (no run-length coding) under the given header lines.
fn hdr(lines: &str, resolution: &str, pixels: &[[u8; 4]]) -> Vec<u8> {
    [format!("{lines}\n\n{resolution}\n").as_bytes(), pixels.as_flattened()].concat()
}

/// 1, 2 and 0.5 as RGBE: mantissas over 256, exponent 130 = 2².
const RGBE: [u8; 4] = [64, 128, 32, 130];

fn read_bytes(name: &str, bytes: impl AsRef<[u8]>, options: &ReadOptions) -> Result<Imported, Error> {
    let folder = Folder::new();
    read_image(&folder.write(name, bytes), options)
}

fn read_hdr(lines: &str) -> Result<Imported, Error> {
    read_bytes("x.hdr", hdr(lines, "-Y 1 +X 1", &[RGBE]), &STRICT)
}

#[test]
fn hdr_exposure_and_colour_correction_are_taken_out() {
    let pixel = |lines: &str| read_hdr(lines).unwrap().image.pixels[0];
    assert_eq!(pixel("#?RADIANCE\nFORMAT=32-bit_rle_rgbe"), [1.0, 2.0, 0.5]);
    assert_eq!(pixel("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2"), [0.5, 1.0, 0.25]);
    assert_eq!(pixel("#?RADIANCE\nEXPOSURE=2\nFORMAT=32-bit_rle_rgbe\nEXPOSURE= 0.25 "), [2.0, 4.0, 1.0]);
    assert_eq!(pixel("#?RADIANCE\nCOLORCORR=2 4 0.5\nEXPOSURE=2\nCOLORCORR= 1 1 2"), [0.25, 0.25, 0.25]);
    // Comments and strangers are not settings.
    assert_eq!(pixel("#?RADIANCE\n# EXPOSURE=4\n#EXPOSURE=4\nSOFTWARE=x=EXPOSURE=4\nVIEW= -vtv"), [1.0, 2.0, 0.5]);
    for (line, part) in [
        ("EXPOSURE=0", "EXPOSURE=0"),
        ("EXPOSURE=-1", "EXPOSURE=-1"),
        ("EXPOSURE=nan", "EXPOSURE=nan"),
        ("EXPOSURE=1 2", "EXPOSURE=1 2"),
        ("EXPOSURE=", "EXPOSURE="),
        ("COLORCORR=1 2", "COLORCORR=1 2"),
        ("COLORCORR=1 2 x", "COLORCORR=1 2 x"),
        ("EXPOSURE=1e200\nEXPOSURE=1e200", "multiply to"),
    ] {
        assert_invalid(read_hdr(&format!("#?RADIANCE\n{line}")), &[part]);
    }
    // So small an exposure that light overflows: refused like any infinite sample.
    assert_invalid(read_hdr("#?RADIANCE\nEXPOSURE=1e-39"), &["channel R", "inf"]);
}

#[test]
fn hdr_headers_of_other_programs_are_read() {
    for start in ["#?RGBE", "#?RADIANCE", "#?AUTOPANO"] {
        assert_eq!(read_hdr(start).unwrap().image.pixels, [[1.0, 2.0, 0.5]], "{start}");
    }
    let crlf = [&b"#?RADIANCE\r\nEXPOSURE=2\r\n\r\n-Y 1 +X 1\r\n"[..], &RGBE].concat();
    assert_eq!(read_bytes("x", crlf, &STRICT).unwrap().image.pixels, [[0.5, 1.0, 0.25]]);
    assert_unsupported(read_hdr("#?RADIANCE\nFORMAT=raw"), &["FORMAT=raw", "32-bit_rle_rgbe"]);
    assert_eq!(finding(&read_hdr("#?RADIANCE\nGAMMA=2.2").unwrap(), "hdr-gamma"), Some(1));
    assert_eq!(finding(&read_hdr("#?RADIANCE\nGAMMA=1.0").unwrap(), "hdr-gamma"), None);
}

#[test]
fn hdr_rows_and_sizes_are_checked() {
    let read = |resolution: &str, count: usize| {
        read_bytes("x.hdr", hdr("#?RADIANCE", resolution, &vec![RGBE; count]), &STRICT)
    };
    for (w, h) in [(1, 1), (2, 1), (1, 2), (3, 5), (9, 2), (40, 7)] {
        let image = read(&format!("-Y {h} +X {w}"), w * h).unwrap().image;
        assert_eq!((image.width, image.height, image.pixels.len()), (w, h, w * h));
        assert!(image.pixels.iter().all(|p| *p == [1.0, 2.0, 0.5]));
    }
    for flipped in ["+Y 1 +X 1", "-Y 1 -X 1", "+X 1 -Y 1", "-X 1 +Y 1"] {
        assert_unsupported(read(flipped, 1), &[flipped, "-Y", "pflip"]);
    }
    for nonsense in ["", "-Y 1", "-Y 1 +X", "-Y a +X 1", "-Y -1 +X 1", "-Y 1 +Y 1", "+Z 1 +X 1", "-Y 1 +X 1 +Z 1"] {
        assert_invalid(read(nonsense, 1), &["-Y height +X width"]);
    }
    assert_invalid(read("-Y 0 +X 1", 1), &["1 x 0"]);
    assert_invalid(read("-Y 1 +X 0", 1), &["0 x 1"]);
    assert_invalid(read("-Y 3 +X 2", 5), &["cut off"]);
    assert_invalid(read("-Y 3 +X 2", 1), &["cut off"]);
    assert_unsupported(read("-Y 99999 +X 99999", 5), &["99999 x 99999"]);
    assert_unsupported(read("-Y 18446744073709551615 +X 18446744073709551615", 5), &["at most"]);
    for cut in ["#?RADIANCE", "#?RADIANCE\n", "#?RADIANCE\n\n", "#?RADIANCE\nEXPOSURE=1", "#?RADIANCE\n\n-Y 1 +X 1"] {
        assert_invalid(read_bytes("x", cut, &STRICT), &["header does not end"]);
    }
    assert_invalid(read_bytes("x", [b"#?".to_vec(), vec![b'a'; 3 << 20]].concat(), &STRICT), &["does not end"]);
}

// ---- files that are no images ----

#[test]
fn files_are_told_by_their_first_bytes_not_by_their_names() {
    let folder = Folder::new();
    let path = folder.path("really-exr.hdr");
    write_exr(&path, &varied(3, 2, false), &Pose::default(), Mapping::LatLong, SampleFormat::F32).unwrap();
    assert_eq!(read_image(&path, &STRICT).unwrap().image, varied(3, 2, false));
    let hdr = read_bytes("really-hdr.exr", hdr("#?RADIANCE", "-Y 1 +X 1", &[RGBE]), &STRICT);
    assert_eq!(hdr.unwrap().image.pixels, [[1.0, 2.0, 0.5]]);
    assert_unsupported(read_bytes("x.exr", b"\x89PNG\r\n\x1a\n", &STRICT), &["PNG", "OpenEXR"]);
    assert_unsupported(read_bytes("x.exr", b"\xff\xd8\xff\xe0", &STRICT), &["JPEG"]);
    assert_invalid(read_bytes("x.exr", b"hello", &STRICT), &["68 65 6c 6c 6f", "OpenEXR"]);
    assert_invalid(read_bytes("x.exr", b"", &STRICT), &["empty"]);
    assert_invalid(read_bytes("x.exr", b"\x76\x2f\x31\x01", &STRICT), &["header"]);
    let missing = read_image(&folder.path("missing.exr"), &STRICT);
    assert!(matches!(missing, Err(Error::Io { ref path, .. }) if path.ends_with("missing.exr")), "{missing:?}");
    assert_invalid(read_image(&folder.path(""), &STRICT), &["folder", "expected"]);
}

// ---- hostile files ----

/// Replaces the value of an attribute in an EXR header.
fn patch(bytes: &mut [u8], name_type: &[u8], value: &[u8]) {
    let at = bytes.windows(name_type.len()).position(|window| window == name_type).unwrap();
    let start = at + name_type.len() + 4;
    bytes[start..start + value.len()].copy_from_slice(value);
}

#[test]
fn exr_headers_that_claim_too_much_are_refused_before_memory_is_taken() {
    let folder = Folder::new();
    let path = folder.path("x.exr");
    write_exr(&path, &varied(4, 4, false), &Pose::default(), Mapping::LatLong, SampleFormat::F32).unwrap();
    let original = fs::read(&path).unwrap();
    let window = |x: i32, y: i32| [0, 0, x, y].into_iter().flat_map(i32::to_le_bytes).collect::<Vec<u8>>();
    for (x, y) in [(16383, 8191), (3, 1 << 24), (1 << 26, 1), (40000, 40000), (i32::MAX, i32::MAX), (-i32::MAX, 5)] {
        let mut bytes = original.clone();
        patch(&mut bytes, b"dataWindow\0box2i\0", &window(x, y));
        let result = read_image(&folder.write("x.exr", &bytes), &STRICT);
        assert!(matches!(result, Err(Error::Invalid { .. } | Error::Unsupported { .. })), "({x}, {y}): {result:?}");
    }
    // A tile as large as the sky.
    let mut file = ExrFile::new((2, 1), &two_pixels());
    file.blocks = Blocks::Tiles(Vec2(16, 16));
    let mut bytes = fs::read(file.write(&folder)).unwrap();
    patch(&mut bytes, b"tiles\0tiledesc\0", &[0xff, 0xff, 0xff, 0x3f, 0xff, 0xff, 0xff, 0x3f, 0]);
    let result = read_image(&folder.write("x.exr", &bytes), &STRICT);
    assert!(matches!(result, Err(Error::Invalid { .. } | Error::Unsupported { .. })), "{result:?}");
}

#[test]
fn exr_cut_off_anywhere_is_invalid() {
    let folder = Folder::new();
    let path = folder.path("x.exr");
    write_exr(&path, &varied(5, 40, true), &Pose::default(), Mapping::LatLong, SampleFormat::F32).unwrap();
    let bytes = fs::read(&path).unwrap();
    for length in 0..bytes.len() {
        let result = read_image(&folder.write("cut.exr", &bytes[..length]), &STRICT);
        assert!(matches!(result, Err(Error::Invalid { .. })), "{length} of {}: {result:?}", bytes.len());
    }
}

#[test]
fn exr_blocks_must_each_come_once() {
    let folder = Folder::new();
    let mut file = ExrFile::new((2, 3), &rgb([&[1.0; 6]; 3]));
    file.compression = Compression::Uncompressed; // one line per block
    let mut bytes = fs::read(file.write(&folder)).unwrap();
    // The table of three offsets is followed by the blocks: y, size, 2 × 3 × 4 bytes.
    let block = 8 + 24;
    let table = bytes.len() - 3 * block - 24;
    let first = bytes[table..table + 8].to_vec();
    bytes[table + 8..table + 16].copy_from_slice(&first);
    assert_invalid(read_image(&folder.write("x.exr", &bytes), &STRICT), &["table of blocks"]);
}

/// Found by mutating: the decoder takes as much memory as these counters say, and its failure to get it ends the
/// program.
#[test]
fn exr_dwa_blocks_that_claim_petabytes_are_invalid() {
    let folder = Folder::new();
    let values: Vec<f32> = (0..96).map(|i| (i * i % 31) as f32).collect();
    for blocks in [Blocks::ScanLines, Blocks::Tiles(Vec2(16, 16))] {
        for compression in [Compression::DWAA(None), Compression::DWAB(None)] {
            let mut file = ExrFile::new((8, 12), &[rgb([&values; 3]), vec![("A", f32s(&values))]].concat());
            (file.compression, file.blocks) = (compression, blocks);
            let original = fs::read(file.write(&folder)).unwrap();
            assert!(read_image(&folder.write("x.exr", &original), &REPAIR).is_ok());
            // One block: y, size or x, y, level x, level y, size; then the counters. They begin with version 2.
            let counters = original.windows(8).rposition(|window| window == 2u64.to_le_bytes()).unwrap();
            for counter in [1, 6, 7, 8, 9] {
                for claim in [1u64 << 50, 1 << 32, i64::MAX as u64] {
                    let mut bytes = original.clone();
                    bytes[counters + 8 * counter..][..8].copy_from_slice(&claim.to_le_bytes());
                    assert_invalid(read_image(&folder.write("x.exr", &bytes), &STRICT), &["claims to hold"]);
                }
            }
        }
    }
}

fn mutate(original: &[u8], state: &mut u64) -> Vec<u8> {
    let mut random = || {
        *state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (*state >> 33) as usize
    };
    let mut bytes = original.to_vec();
    for _ in 0..1 + random() % 3 {
        let at = random() % bytes.len();
        match random() % 4 {
            0 => bytes[at] = random() as u8,
            1 => bytes[at] ^= 1 << (random() % 8),
            2 => bytes[at] = [0, 0xff, 0x7f, 0x80][random() % 4],
            _ => {
                // A whole number.
                let value = [0u32, 1, u32::MAX, 1 << 31, 1 << 30, 65536][random() % 6].to_le_bytes();
                let end = (at + 4).min(bytes.len());
                bytes[at..end].copy_from_slice(&value[..end - at]);
            }
        }
    }
    bytes
}

/// Thousands of damaged files: none may end the program, and what opens is usable.
#[test]
fn mutated_files_never_panic() {
    let folder = Folder::new();
    let small = |compression: Compression, blocks: Blocks| {
        let values: Vec<f32> = (0..96).map(|i| (i * i % 31) as f32).collect();
        let channels = [rgb([&values; 3]), vec![("Z", f32s(&values))]].concat();
        let mut file = ExrFile::new((8, 12), &channels);
        (file.compression, file.blocks) = (compression, blocks);
        file.attributes.world_to_camera = Some([1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.]);
        fs::read(file.write(&folder)).unwrap()
    };
    let run_length = [
        &b"#?RADIANCE\nEXPOSURE=1\n\n-Y 2 +X 9\n"[..],
        &[2, 2, 0, 9],
        &[137, 64, 137, 128, 137, 32, 137, 130],
        &[2, 2, 0, 9],
        &[9, 1, 2, 3, 4, 5, 6, 7, 8, 9, 137, 128, 137, 32, 137, 130],
    ]
    .concat();
    assert!(read_bytes("x.hdr", &run_length, &STRICT).is_ok());
    let originals = [
        ("zip", small(Compression::ZIP16, Blocks::ScanLines)),
        ("zip tiles", small(Compression::ZIP1, Blocks::Tiles(Vec2(4, 4)))),
        ("rle", small(Compression::RLE, Blocks::ScanLines)),
        ("piz", small(Compression::PIZ, Blocks::ScanLines)),
        ("pxr24", small(Compression::PXR24, Blocks::ScanLines)),
        ("b44", small(Compression::B44, Blocks::ScanLines)),
        ("dwaa", small(Compression::DWAA(None), Blocks::ScanLines)),
        ("uncompressed", small(Compression::Uncompressed, Blocks::ScanLines)),
        ("hdr", run_length),
        ("flat hdr", hdr("#?RGBE\nCOLORCORR=1 1 1", "-Y 2 +X 3", &[RGBE; 6])),
    ];
    let mut state = 7;
    for (name, original) in &originals {
        let mut counts = [0; 4];
        for _ in 0..500 {
            let path = folder.write("mutated", mutate(original, &mut state));
            let start = Instant::now();
            let result = read_image(&path, &REPAIR);
            assert!(start.elapsed() < Duration::from_secs(5), "{name} took {:?}: {result:?}", start.elapsed());
            match result {
                Ok(Imported { image, .. }) => {
                    counts[0] += 1;
                    assert_eq!(image.pixels.len(), image.width * image.height);
                    assert!(image.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0));
                    assert!(image.distance.iter().flatten().all(|v| *v >= 0.0));
                }
                Err(error) => {
                    assert!(!matches!(error, Error::Io { .. }), "{error}");
                    counts[1] += 1;
                    counts[2] += usize::from(error.to_string().contains("gave up"));
                    counts[3] += usize::from(matches!(error, Error::Unsupported { .. }));
                }
            }
        }
        let [ok, refused, panics, unsupported] = counts;
        eprintln!(
            "{name}: {ok} opened, {refused} refused ({unsupported} as unsupported, {panics} by the decoder's panic)"
        );
        assert!(ok > 0 && refused > 0);
    }
}
