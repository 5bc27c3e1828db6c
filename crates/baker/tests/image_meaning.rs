//! What the numbers of an image file mean: which layer is the picture, in which colour space it is, and by which
//! mapping it shows directions. The files are made here; right values come from the specifications' formulas.

use std::fs;
use std::path::{Path, PathBuf};

use exr::image::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image as ExrImage, Layer, Layers, write::WritableImage,
};
use exr::math::Vec2;
use exr::meta::attribute::{AttributeValue, Chromaticities, Text};
use exr::meta::header::{ImageAttributes, LayerAttributes};
use exr::prelude::SmallVec;
use gdibl_baker::Error;
use gdibl_baker::import::image::{Image, Imported, Pose, ReadOptions, SampleFormat, is_image, read_image, write_exr};
use gdibl_baker::import::sky::{SkyOptions, SkySource, read_sky};
use gdibl_baker::panorama::Mapping;
use glam::{DMat3, DVec3};

const SIZE: (usize, usize) = (4, 2);
const COUNT: usize = SIZE.0 * SIZE.1;
/// The picture, and what must not be taken for it.
const LIGHT: [f32; 3] = [1.0, 2.0, 3.0];
const WRONG: [f32; 3] = [0.25, 0.5, 0.75];

/// A part of an EXR file.
#[derive(Clone, Default)]
struct Part {
    name: Option<&'static str>,
    view: Option<&'static str>,
    channels: Vec<(String, f32)>,
    attributes: Vec<(&'static str, AttributeValue)>,
    size: Option<(usize, usize)>,
}

impl Part {
    fn new(layers: &[(&str, [f32; 3])]) -> Part {
        let mut part = Part::default();
        layers.iter().for_each(|(prefix, rgb)| part.add(prefix, ["R", "G", "B"], rgb));
        part
    }

    fn add(&mut self, prefix: &str, names: [&str; 3], values: &[f32; 3]) {
        self.channels.extend(names.iter().zip(values).map(|(name, v)| (format!("{prefix}{name}"), *v)));
    }

    fn with(mut self, channel: &str, value: f32) -> Part {
        self.channels.push((channel.into(), value));
        self
    }

    fn named(self, name: &'static str) -> Part {
        Part { name: Some(name), ..self }
    }

    fn text(mut self, name: &'static str, value: &str) -> Part {
        self.attributes.push((name, AttributeValue::Text(Text::from(value))));
        self
    }

    fn layer(&self) -> Layer<AnyChannels<FlatSamples>> {
        let size = self.size.unwrap_or(SIZE);
        let samples = |value: f32| FlatSamples::F32(vec![value; size.0 * size.1]);
        let channels: SmallVec<[AnyChannel<FlatSamples>; 4]> =
            self.channels.iter().map(|(name, v)| AnyChannel::new(name.as_str(), samples(*v))).collect();
        let mut attributes = LayerAttributes {
            layer_name: self.name.map(Text::from),
            view_name: self.view.map(Text::from),
            ..LayerAttributes::default()
        };
        attributes.other.extend(self.attributes.iter().map(|(name, value)| (Text::from(*name), value.clone())));
        Layer::new(size, attributes, Encoding::FAST_LOSSLESS, AnyChannels::sort(channels))
    }
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Folder {
        Folder(tempfile::tempdir().unwrap())
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.0.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    }

    fn exr(&self, parts: &[Part], chromaticities: Option<Chromaticities>) -> PathBuf {
        let path = self.0.path().join("made.exr");
        let layers: Layers<AnyChannels<FlatSamples>> = parts.iter().map(Part::layer).collect();
        let mut attributes = ImageAttributes::with_size(SIZE);
        attributes.chromaticities = chromaticities;
        ExrImage { attributes, layer_data: layers }.write().to_file(&path).unwrap();
        path
    }
}

fn read(parts: &[Part], layer: Option<&str>) -> Result<Imported, Error> {
    let folder = Folder::new();
    let options = ReadOptions { layer: layer.map(String::from), ..ReadOptions::default() };
    read_image(&folder.exr(parts, None), &options)
}

fn finding<'a>(imported: &'a Imported, id: &str) -> Option<&'a str> {
    imported.findings.iter().find(|finding| finding.id == id).map(|finding| finding.message.as_str())
}

#[track_caller]
fn assert_refused(result: Result<Imported, Error>, words: &[&str]) {
    match result {
        Err(Error::Unsupported { message, .. }) => {
            words.iter().for_each(|word| assert!(message.contains(word), "{message:?} lacks {word:?}"));
        }
        other => panic!("expected Unsupported, got {other:?}"),
    }
}

// ---- layers ----

#[test]
fn picture_is_taken_and_what_is_no_light_never() {
    for picture in
        ["", "RGBA.", "rgba.", "beauty.", "Combined.", "ViewLayer.Combined.", "Composite.Combined.", "Ci.", "mm."]
    {
        for other in [
            "AO.",
            "ViewLayer.AO.",
            "ViewLayer.Denoising Albedo.",
            "ViewLayer.DiffCol.",
            "albedo.",
            "Normal.",
            "N.",
            "P.",
            "Position.",
            "CryptoObject00.",
            "crypto_asset.",
            "Ambient Occlusion.",
            "diffuse.",
            "ViewLayer.Emit.",
            "UV.",
        ] {
            let parts = [Part::new(&[(other, WRONG), (picture, LIGHT)])];
            let imported = read(&parts, None).unwrap();
            assert_eq!(imported.image.pixels, [LIGHT; COUNT], "{picture} beside {other}");
            // The same as parts of their own.
            let names = [other, picture].map(|layer| layer.trim_end_matches('.').to_string());
            let [a, b] = names.map(|name| Box::leak(name.into_boxed_str()) as &'static str);
            if !b.is_empty() {
                let parts = [Part::new(&[("", WRONG)]).named(a), Part::new(&[("", LIGHT)]).named(b)];
                assert_eq!(read(&parts, None).unwrap().image.pixels, [LIGHT; COUNT], "part {b} beside {a}");
                // And as Blender 5 names them: the layer in the part's name, and again in its channels'.
                let parts = [Part::new(&[(other, WRONG)]).named(a), Part::new(&[(picture, LIGHT)]).named(b)];
                assert_eq!(read(&parts, None).unwrap().image.pixels, [LIGHT; COUNT], "part {b} beside {a}, twice");
            }
        }
    }
}

#[test]
fn lower_case_and_words_are_channels_too() {
    for names in [["r", "g", "b"], ["red", "green", "blue"], ["Red", "Green", "Blue"]] {
        for prefix in ["", "beauty."] {
            let mut part = Part::new(&[("AO.", WRONG)]);
            part.add(prefix, names, &LIGHT);
            assert_eq!(read(&[part], None).unwrap().image.pixels, [LIGHT; COUNT], "{prefix}{names:?}");
        }
    }
}

#[test]
fn several_pictures_are_told_and_another_can_be_asked_for() {
    let parts = [Part::new(&[("RGBA_key.", [5.0; 3]), ("beauty.", [7.0; 3]), ("rgba.", LIGHT), ("diffuse.", WRONG)])];
    let imported = read(&parts, None).unwrap();
    assert_eq!(imported.image.pixels, [LIGHT; COUNT]);
    let said = finding(&imported, "exr-layer").expect("it says what was taken");
    for word in ["rgba was taken", "beauty", "RGBA_key", "diffuse", "--layer"] {
        assert!(said.contains(word), "{said}");
    }
    for (asked, expected) in [("beauty", [7.0; 3]), ("BEAUTY", [7.0; 3]), ("diffuse", WRONG), ("RGBA_key", [5.0; 3])] {
        let asked_for = read(&parts, Some(asked)).unwrap();
        assert_eq!(asked_for.image.pixels, [expected; COUNT], "{asked}");
        assert_eq!(finding(&asked_for, "exr-layer"), None, "{asked}: who asks knows");
    }
    assert_refused(read(&parts, Some("nothing")), &["nothing", "beauty", "rgba", "diffuse (a share of the light)"]);
    // The end of a name, where it is but one's.
    let views = [Part::new(&[("A.Combined.", LIGHT), ("B.Combined.", WRONG), ("B.AO.", WRONG)])];
    assert_eq!(read(&views, Some("AO")).unwrap().image.pixels, [WRONG; COUNT]);
    assert_refused(read(&views, Some("Combined")), &["several", "A.Combined", "B.Combined"]);
    // The picture without a name needs no word; nor does a picture beside what is none.
    assert_eq!(finding(&read(&[Part::new(&[("", LIGHT), ("diffuse.", WRONG)])], None).unwrap(), "exr-layer"), None);
    assert_eq!(finding(&read(&[Part::new(&[("beauty.", LIGHT), ("N.", WRONG)])], None).unwrap(), "exr-layer"), None);
    // A name that says nothing is taken, with a word.
    assert!(finding(&read(&[Part::new(&[("mm.", LIGHT)])], None).unwrap(), "exr-layer").is_some());
    // A file with one picture without a name has no layer to choose.
    assert_eq!(read(&[Part::new(&[("", LIGHT)])], Some("beauty")).unwrap().image.pixels, [LIGHT; COUNT]);
}

#[test]
fn files_without_the_whole_light_are_refused_with_their_layers() {
    for layers in [&["Normal."][..], &["AO.", "albedo."], &["ViewLayer.DiffCol.", "CryptoObject00."]] {
        let parts: Vec<(&str, [f32; 3])> = layers.iter().map(|layer| (*layer, WRONG)).collect();
        let words: Vec<&str> = layers.iter().map(|layer| layer.trim_end_matches('.')).collect();
        assert_refused(read(&[Part::new(&parts)], None), &[&words[..], &["no light", "--layer"]].concat());
    }
    assert_refused(read(&[Part::new(&[("diffuse.", WRONG), ("specular.", WRONG)])], None), &["share of the light"]);
    // Coordinates are no luminance.
    for prefix in ["N.", "Normal.", "mm.", ""] {
        let mut part = Part::default();
        part.add(prefix, ["X", "Y", "Z"], &WRONG);
        assert_refused(read(&[part], None), &["R, G and B", &format!("{prefix}Y")]);
    }
}

#[test]
fn part_that_says_data_is_no_picture_beside_one_that_does_not() {
    let data = Part::new(&[("", WRONG)]).named("first").text("colorInteropID", "data");
    let imported = read(&[data, Part::new(&[("", LIGHT)]).named("second")], None).unwrap();
    assert_eq!(imported.image.pixels, [LIGHT; COUNT]);
}

// ---- distance ----

#[test]
fn distance_is_found_in_a_part_beside_the_picture() {
    let colour = |name| Part::new(&[("", LIGHT)]).named(name);
    let blender = || Part::new(&[("ViewLayer.Combined.", LIGHT)]).named("ViewLayer.Combined");
    let far = |name, channel: &str| Part::default().named(name).with(channel, 7.0);
    for (parts, expected) in [
        (vec![blender(), far("ViewLayer.Depth", "ViewLayer.Depth.Z")], Some(7.0)),
        (vec![far("ViewLayer.Depth", "ViewLayer.Depth.Z"), blender()], Some(7.0)),
        (vec![colour("beauty"), far("depth", "Z")], Some(7.0)),
        (vec![colour("rgba_left"), far("depth_right", "Z"), far("depth_left", "Z").with("A", 1.0)], Some(7.0)),
        // Of another view layer, of the other eye, for denoising; a coordinate.
        (vec![blender(), far("Other.Depth", "Other.Depth.Z")], None),
        (vec![colour("rgba_left"), far("depth_right", "Z")], None),
        (vec![blender(), far("ViewLayer.Denoising Depth", "ViewLayer.Denoising Depth.Z")], None),
        (vec![blender(), far("ViewLayer.Normal", "Z").with("X", 1.0).with("Y", 1.0)], None),
    ] {
        let names: Vec<_> = parts.iter().map(|part| part.name).collect();
        let imported = read(&parts, None).unwrap();
        assert_eq!(imported.image.pixels, [LIGHT; COUNT], "{names:?}");
        assert_eq!(imported.image.distance, expected.map(|metres| vec![metres; COUNT]), "{names:?}");
    }
    // Blender's "nothing hit" is known wherever it stands.
    let escaping = read(&[blender(), Part::default().named("ViewLayer.Depth").with("ViewLayer.Depth.Z", 1e10)], None);
    assert!(finding(&escaping.unwrap(), "far-distance-escapes").is_some());
    // By views.
    let mut parts = [colour("a"), far("z", "Z"), far("depth", "Z")];
    (parts[0].view, parts[1].view, parts[2].view) = (Some("left"), Some("right"), Some("left"));
    parts[1].channels[0].1 = 9.0;
    assert_eq!(read(&parts, None).unwrap().image.distance, Some(vec![7.0; COUNT]));
}

#[test]
fn distances_of_other_pixels_are_not_read_and_told() {
    let mut parts = [Part::new(&[("", LIGHT)]).named("beauty"), Part::default().named("depth").with("Z", 7.0)];
    parts[1].size = Some((2, 2));
    let imported = read(&parts, None).unwrap();
    assert_eq!(imported.image.distance, None);
    assert!(finding(&imported, "distance-not-read").is_some_and(|said| said.contains("depth")));
}

#[test]
fn bad_distances_of_a_part_beside_are_named_by_their_channel() {
    let parts = [Part::new(&[("", LIGHT)]).named("beauty"), Part::default().named("depth").with("depth.Z", -1.0)];
    let message = read(&parts, None).unwrap_err().to_string();
    assert!(message.contains("channel depth.Z at x 0, y 0"), "{message}");
}

// ---- colour spaces ----

type Space = [[f64; 2]; 4];
const D65: [f64; 2] = [0.3127, 0.3290];
const ACES_WHITE: [f64; 2] = [0.32168, 0.33767];
const REC709: Space = [[0.64, 0.33], [0.30, 0.60], [0.15, 0.06], D65];
const REC2020: Space = [[0.708, 0.292], [0.170, 0.797], [0.131, 0.046], D65];
const P3: Space = [[0.680, 0.320], [0.265, 0.690], [0.150, 0.060], D65];
const ADOBE: Space = [[0.64, 0.33], [0.21, 0.71], [0.15, 0.06], D65];
const AP0: Space = [[0.7347, 0.2653], [0.0, 1.0], [0.0001, -0.0770], ACES_WHITE];
const AP1: Space = [[0.713, 0.293], [0.165, 0.830], [0.128, 0.044], ACES_WHITE];
const XYZ: Space = [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [1.0 / 3.0, 1.0 / 3.0]];

fn xyz_of([x, y]: [f64; 2]) -> DVec3 {
    DVec3::new(x / y, 1.0, (1.0 - x - y) / y)
}

/// SMPTE RP 177, section 3.3: NPM = P · diag(P⁻¹ W), P being the primaries' (x, y, z) as columns and W the white's XYZ.
fn to_xyz(space: Space) -> DMat3 {
    let [r, g, b, white] = space;
    let p = DMat3::from_cols_array_2d(&[r, g, b].map(|[x, y]| [x, y, 1.0 - x - y]));
    p * DMat3::from_diagonal(p.inverse() * xyz_of(white))
}

/// Bradford, as in ICC.1:2022, annex E.
fn adapted(xyz: DVec3, from: [f64; 2], to: [f64; 2]) -> DVec3 {
    let bradford = DMat3::from_cols_array(&[0.8951, 0.2664, -0.1614, -0.7502, 1.7135, 0.0367, 0.0389, -0.0685, 1.0296])
        .transpose();
    let ratio = (bradford * xyz_of(to)) / (bradford * xyz_of(from));
    bradford.inverse() * (ratio * (bradford * xyz))
}

fn rec709_of(space: Space, colour: DVec3) -> DVec3 {
    to_xyz(REC709).inverse() * adapted(to_xyz(space) * colour, space[3], D65)
}

#[track_caller]
fn assert_light(imported: &Imported, expected: DVec3) {
    for pixel in &imported.image.pixels {
        let found = DVec3::from_array(pixel.map(f64::from));
        assert!((found - expected).length() < 1e-5 * expected.length(), "{found} for {expected}");
    }
}

fn chromaticities(space: Space) -> Chromaticities {
    let [red, green, blue, white] = space.map(|[x, y]| Vec2(x as f32, y as f32));
    Chromaticities { red, green, blue, white }
}

fn of_space(part: &Part, space: Option<Space>) -> Imported {
    let folder = Folder::new();
    read_image(&folder.exr(std::slice::from_ref(part), space.map(chromaticities)), &ReadOptions::default()).unwrap()
}

/// Inside of Rec.709 for every space that is tried here.
const COLOUR: [f32; 3] = [2.0, 2.5, 3.0];

fn colour() -> DVec3 {
    DVec3::from_array(COLOUR.map(f64::from))
}

fn plain() -> Part {
    Part::new(&[("", COLOUR)])
}

#[test]
fn chromaticities_are_converted_and_told() {
    for space in [REC2020, P3, ADOBE, AP0, AP1, XYZ] {
        let imported = of_space(&plain(), Some(space));
        assert_light(&imported, rec709_of(space, colour()));
        assert!(finding(&imported, "chromaticities").is_some(), "{space:?}");
        // White stays white.
        let white = of_space(&Part::new(&[("", [2.0; 3])]), Some(space));
        assert_light(&white, DVec3::splat(2.0));
    }
}

#[test]
fn color_interop_ids_are_converted_and_told() {
    for (id, space) in [
        ("lin_ap1_scene", AP1),
        ("lin_ap0_scene", AP0),
        ("lin_rec2020_scene", REC2020),
        ("lin_p3d65_scene", P3),
        ("lin_adobergb_scene", ADOBE),
    ] {
        let imported = of_space(&plain().text("colorInteropID", id), None);
        assert_light(&imported, rec709_of(space, colour()));
        assert!(finding(&imported, "color-interop-id").is_some_and(|said| said.contains(id)), "{id}");
    }
    // XYZ in which D65 is white needs no adaptation.
    let xyz = of_space(&plain().text("colorInteropID", "lin_ciexyzd65_scene"), None);
    assert_light(&xyz, to_xyz(REC709).inverse() * colour());
    // Its channels may be called so.
    let mut part = Part::default().text("colorInteropID", "lin_ciexyzd65_scene");
    part.add("", ["X", "Y", "Z"], &COLOUR);
    let xyz = of_space(&part, None);
    assert_light(&xyz, to_xyz(REC709).inverse() * colour());
    assert_eq!(xyz.image.distance, None, "Z is a coordinate");
}

#[test]
fn encoded_light_is_decoded_or_refused_by_name() {
    let encoded = [0.5f32, 0.6, 0.7];
    let srgb = |v: f64| if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) };
    let values = DVec3::from_array(encoded.map(f64::from));
    for (id, light) in [
        ("srgb_rec709_scene", DVec3::from_array(values.to_array().map(srgb))),
        ("g22_rec709_scene", DVec3::from_array(values.to_array().map(|v| v.powf(2.2)))),
        ("g18_rec709_scene", DVec3::from_array(values.to_array().map(|v| v.powf(1.8)))),
        ("srgb_p3d65_scene", rec709_of(P3, DVec3::from_array(values.to_array().map(srgb)))),
        ("g22_ap1_scene", rec709_of(AP1, DVec3::from_array(values.to_array().map(|v| v.powf(2.2))))),
    ] {
        let imported = of_space(&Part::new(&[("", encoded)]).text("colorInteropID", id), None);
        assert_light(&imported, light);
        assert!(finding(&imported, "color-interop-id").is_some_and(|said| said.contains(id)), "{id}");
    }
    for id in ["srgb_rec709_display", "pq_rec2020_display", "ocio:acescct_ap1_scene"] {
        assert_refused(read(&[plain().text("colorInteropID", id)], None), &[id, "lin_rec709_scene"]);
    }
    // Luminance is decoded, too, and has no colour to convert.
    let grey = Part::default().with("Y", 0.5).text("colorInteropID", "srgb_ap1_scene");
    assert_light(&of_space(&grey, None), DVec3::splat(srgb(0.5)));
}

#[test]
fn what_is_rec709_or_says_nothing_keeps_its_bits() {
    let folder = Folder::new();
    let exact = |part: &Part, space: Option<Space>| {
        let imported = of_space(part, space);
        assert_eq!(imported.image.pixels, [COLOUR; COUNT]);
        imported
    };
    let rounded: Space = [[0.6400, 0.3300], [0.2998, 0.6003], [0.1500, 0.0600], [0.31271, 0.32902]];
    for space in [None, Some(REC709), Some(rounded)] {
        for id in [None, Some("lin_rec709_scene"), Some("unknown"), Some("")] {
            let part = id.iter().fold(plain(), |part, id| part.text("colorInteropID", id));
            assert!(exact(&part, space).findings.is_empty(), "{space:?} {id:?}");
        }
    }
    // No colour, or one that is not known: as it is, and told.
    for id in ["data", "studio:mine", "lin_awg3_scene"] {
        assert!(finding(&exact(&plain().text("colorInteropID", id), None), "color-interop-id").is_some(), "{id}");
    }
    // Zeros say nothing either; a line is no triangle, and told.
    assert!(exact(&plain(), Some([[0.0; 2]; 4])).findings.is_empty());
    let nowhere: Space = [[0.1; 2], [0.2; 2], [0.3; 2], D65];
    assert!(finding(&exact(&plain(), Some(nowhere)), "chromaticities").is_some());
    // What this program writes comes back bit for bit, with a distance and with a pose.
    let pixels: Vec<[f32; 3]> = (0..COUNT).map(|i| [1e-3 * i as f32, 1.0 / (1.0 + i as f32), 1e4 * i as f32]).collect();
    let image = Image { width: SIZE.0, height: SIZE.1, pixels, distance: Some(vec![2.5; COUNT]) };
    let path = folder.0.path().join("probe.exr");
    let pose = Pose { position: Some(DVec3::ONE), rotation: None };
    write_exr(&path, &image, &pose, Mapping::LatLong, SampleFormat::F32).unwrap();
    let imported = read_image(&path, &ReadOptions::default()).unwrap();
    assert!(imported.image == image && imported.findings.is_empty(), "{:?}", imported.findings);
}

#[test]
fn contradictions_are_decided_for_the_id_and_told() {
    let part = plain().text("colorInteropID", "lin_ap1_scene");
    let contradicting = of_space(&part, Some(REC709));
    assert_light(&contradicting, rec709_of(AP1, colour()));
    assert!(finding(&contradicting, "color-space-conflict").is_some_and(|said| said.contains("Rec.709")));
    let agreeing = of_space(&part, Some(AP1));
    assert_light(&agreeing, rec709_of(AP1, colour()));
    assert_eq!(finding(&agreeing, "color-space-conflict"), None);
    let other = of_space(&plain().text("colorInteropID", "lin_rec709_scene"), Some(REC2020));
    assert_eq!(other.image.pixels, [COLOUR; COUNT]);
    assert!(finding(&other, "color-space-conflict").is_some());
    // An ID that says nothing, or nothing that is known, leaves it to the chromaticities.
    for id in ["unknown", "lin_awg3_scene"] {
        assert_light(&of_space(&plain().text("colorInteropID", id), Some(AP1)), rec709_of(AP1, colour()));
    }
    // An ACES container is AP0 whatever else it says (SMPTE ST 2065-4).
    let mut aces = plain().text("colorInteropID", "lin_rec709_scene");
    aces.attributes.push(("acesImageContainerFlag", AttributeValue::I32(1)));
    assert_light(&of_space(&aces, None), rec709_of(AP0, colour()));
}

#[test]
fn colours_outside_of_rec709_lose_their_negative_channels_and_are_told() {
    let green = of_space(&Part::new(&[("", [0.0, 1.0, 0.0])]), Some(REC2020));
    let expected = rec709_of(REC2020, DVec3::Y);
    assert!(expected.x < 0.0 && expected.z < 0.0);
    assert_light(&green, DVec3::new(0.0, expected.y, 0.0));
    let count = green.findings.iter().find(|finding| finding.id == "outside-gamut").map(|finding| finding.count);
    assert_eq!(count, Some(COUNT as u64));
    // Light beyond all floats is refused, not written as infinity.
    let folder = Folder::new();
    let bright = folder.exr(&[Part::new(&[("", [f32::MAX, 0.0, 0.0])])], Some(chromaticities(REC2020)));
    let message = read_image(&bright, &ReadOptions::default()).unwrap_err().to_string();
    assert!(message.contains("x 0, y 0"), "{message}");
}

// ---- .hdr ----

/// Pixels of (1, 2, 0.5) as RGBE: mantissas over 256, exponent 130 = 2².
fn hdr(lines: &str) -> Result<Imported, Error> {
    let pixels = [64u8, 128, 32, 130].repeat(2);
    let bytes = [format!("#?RADIANCE\n{lines}\n\n-Y 1 +X 2\n").as_bytes(), &pixels].concat();
    read_image(&Folder::new().write("x.hdr", bytes), &ReadOptions::default())
}

const HDR: DVec3 = DVec3::new(1.0, 2.0, 0.5);

fn line_of(space: Space) -> String {
    let numbers: Vec<String> = space.as_flattened().iter().map(ToString::to_string).collect();
    format!("PRIMARIES= {}", numbers.join(" "))
}

#[test]
fn hdr_primaries_are_converted_and_told() {
    for space in [REC2020, P3, AP1] {
        let imported = hdr(&line_of(space)).unwrap();
        let expected = rec709_of(space, HDR).max(DVec3::ZERO);
        assert_light(&imported, expected);
        assert!(finding(&imported, "hdr-primaries").is_some_and(|said| said.contains("PRIMARIES")), "{space:?}");
    }
    let own = hdr(&line_of(REC709)).unwrap();
    assert!(own.image.pixels == [[1.0, 2.0, 0.5]; 2] && own.findings.is_empty());
    // The last line counts; EXPOSURE is taken out before.
    let twice = hdr(&format!("{}\nEXPOSURE=2\n{}", line_of(AP1), line_of(P3))).unwrap();
    assert_light(&twice, rec709_of(P3, HDR / 2.0).max(DVec3::ZERO));
    for wrong in ["PRIMARIES=0.64 0.33", "PRIMARIES=a b c d e f g h", "PRIMARIES="] {
        assert!(matches!(hdr(wrong), Err(Error::Invalid { message, .. }) if message.contains(wrong)), "{wrong}");
    }
    let zeros = hdr(&line_of([[0.0; 2]; 4])).unwrap();
    assert!(zeros.image.pixels == [[1.0, 2.0, 0.5]; 2] && zeros.findings.is_empty());
    let line = hdr(&line_of([[0.1; 2], [0.2; 2], [0.3; 2], D65])).unwrap();
    assert!(finding(&line, "hdr-primaries").is_some());
}

#[test]
fn hdr_in_xyz_is_converted_and_lumens_become_watts() {
    let format = "FORMAT=32-bit_rle_xyze";
    let expected = rec709_of(XYZ, HDR).max(DVec3::ZERO);
    let plain = hdr(format).unwrap();
    assert_light(&plain, expected);
    assert!(finding(&plain, "hdr-xyz").is_some());
    assert_eq!(finding(&plain, "hdr-lumens"), None);
    // As ra_xyze writes it: XYZ in lumens, 179 per watt, said by EXPOSURE.
    let radiance = hdr(&format!("ra_xyze a.hdr\nEXPOSURE={}\n{format}", 1.0 / 179.0)).unwrap();
    assert_light(&radiance, expected);
    assert!(finding(&radiance, "hdr-lumens").is_some());
    // With -o it writes lumens themselves.
    assert_light(&hdr(&format!("ra_xyze -o a.hdr\n{format}")).unwrap(), expected / 179.0);
}

#[test]
fn hdr_lines_of_the_pictures_that_it_was_made_of_are_no_settings() {
    let imported = hdr(&format!("a.hdr:\n\tEXPOSURE=4\n\t{}\npcomb a.hdr", line_of(AP1))).unwrap();
    assert!(imported.image.pixels == [[1.0, 2.0, 0.5]; 2] && imported.findings.is_empty());
}

// ---- mappings ----

#[test]
fn shapes_that_are_not_lat_long_are_refused_with_the_guess() {
    let path = Path::new("sky.exr");
    let folder = Folder::new();
    for (w, h, guess) in [
        (8, 8, "angular"),
        (16, 12, "cube-cross-horizontal"),
        (12, 16, "cube-cross-vertical"),
        (24, 4, "cube-strip"),
        (4, 24, "cube-exr"),
        (10, 7, "no mapping"),
        (9, 4, "no mapping"),
    ] {
        let part = Part { size: Some((w, h)), ..Part::new(&[("", LIGHT)]) };
        let mut attributes = ImageAttributes::with_size((w, h));
        attributes.chromaticities = None;
        let file = folder.0.path().join("made.exr");
        ExrImage { attributes, layer_data: Layers::from_iter([part.layer()]) }.write().to_file(&file).unwrap();
        let imported = read_image(&file, &ReadOptions::default()).unwrap();
        let message = imported.layout(path, None).unwrap_err().to_string();
        for word in ["sky.exr", &format!("{w} x {h}"), guess, "mapping"] {
            assert!(message.contains(word), "{message} lacks {word}");
        }
        // Who says it is lat-long has the last word; and what the file says is believed.
        assert_eq!(imported.layout(path, Some(Mapping::LatLong)).unwrap(), Mapping::LatLong);
        let said = Imported { mapping: Some(Mapping::LatLong), ..imported };
        assert_eq!(said.layout(path, None).unwrap(), Mapping::LatLong);
    }
    let imported = read(&[Part::new(&[("", LIGHT)])], None).unwrap();
    assert_eq!(imported.layout(path, None).unwrap(), Mapping::LatLong);
    assert!(imported.layout(path, Some(Mapping::AngularMap)).is_err(), "4 x 2 is no angular map");
}

#[test]
fn sky_options_reach_the_sky() {
    let folder = Folder::new();
    let file = folder.exr(&[Part::new(&[("", LIGHT), ("AO.", WRONG)])], None);
    let read = ReadOptions { layer: Some("AO".into()), ..ReadOptions::default() };
    let options = SkyOptions { read, yaw_degrees: -90.0, exposure_stops: 2.0, ..SkyOptions::default() };
    let (sky, _) = read_sky(&SkySource::Image(file), &options).unwrap();
    assert_eq!((sky.name.as_str(), sky.exposure_stops), ("made.exr", 2.0));
    assert_eq!(sky.panorama.pixels().next(), Some(WRONG));
    assert!((sky.rotation * glam::Vec3::Z - glam::Vec3::NEG_X).length() < 1e-6);
}

// ---- files that are not read ----

#[test]
fn compressions_that_are_not_decoded_are_refused_by_name() {
    let folder = Folder::new();
    let bytes = fs::read(folder.exr(&[plain()], None)).unwrap();
    let of_parts = fs::read(folder.exr(&[plain().named("a"), plain().named("b")], None)).unwrap();
    let needle = b"compression\0compression\0\x01\0\0\0";
    for original in [&bytes, &of_parts] {
        let places: Vec<usize> =
            (0..original.len() - needle.len()).filter(|&at| original[at..].starts_with(needle)).collect();
        for (number, name) in
            [(10, "HTJ2K256"), (11, "HTJ2K32"), (12, "LJ2K"), (13, "ZSTD"), (14, "number 14"), (255, "255")]
        {
            let mut other = original.clone();
            places.iter().for_each(|at| other[at + needle.len()] = number);
            let path = folder.write("other.exr", &other);
            assert_refused(read_image(&path, &ReadOptions::default()), &[name, "ZIP"]);
        }
        // Cut off before its compression, it is damaged and no more is known.
        let cut = folder.write("cut.exr", &original[..places[0]]);
        assert!(matches!(read_image(&cut, &ReadOptions::default()), Err(Error::Invalid { .. })));
    }
}

#[test]
fn other_image_files_are_refused_by_name() {
    let folder = Folder::new();
    let iso = |brands: &[u8]| [&[0, 0, 0, 32][..], b"ftyp", brands].concat();
    let head = |bytes: &[u8]| [bytes, &[0; 32]].concat();
    for (bytes, name) in [
        (iso(b"avif\0\0\0\0avifmif1miaf"), "AVIF"),
        (iso(b"avis\0\0\0\0avifmsf1"), "AVIF"),
        (iso(b"mif1\0\0\0\0mif1avifmiaf"), "AVIF"),
        (iso(b"heic\0\0\0\0mif1heic"), "HEIF"),
        (iso(b"jp2 \0\0\0\0jp2 "), "JPEG 2000"),
        (head(b"\0\0\0\x0cjP  \r\n\x87\n"), "JPEG 2000"),
        (head(b"\xff\x4f\xff\x51"), "JPEG 2000"),
        (head(b"\xff\x0a"), "JPEG XL"),
        (head(b"GIF89a"), "GIF"),
        (head(b"\x89PNG\r\n\x1a\n"), "PNG"),
    ] {
        // Whatever it is called.
        let path = folder.write("sky.exr", bytes);
        assert_refused(read_image(&path, &ReadOptions::default()), &[name, "OpenEXR", "linear"]);
        assert!(!is_image(&path).unwrap());
    }
    assert!(is_image(&folder.exr(&[plain()], None)).unwrap());
    assert!(is_image(&folder.write("sky.jpg", "#?RADIANCE\n")).unwrap());
}
