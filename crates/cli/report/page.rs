//! The page of `gdibl inspect -o`, `bake --report` and `compare -o`: one file, which opens from disk without a network.
//!
//! Its program is built from `integrations/report`; here the data are put beside it: one JSON object, and blobs in base64.
//! Nothing of what a file says becomes part of the page's markup: the JSON holds no `<`, and the program writes it as text.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use half::f16;
use serde::Serialize;
use serde_json::{Value, json};
use std::path::Path;

use gdibl_baker::analyse::{Figure, walled_boxes};
use gdibl_baker::drawn::{DrawnLevel, thumbnail};
use gdibl_baker::job::Inputs;
use gdibl_baker::pack::write_whole;
use gdibl_baker::panorama::Panorama;
use gdibl_baker::render::tone;

use super::{Inspected, WORST};
use crate::config::file_name;
use crate::fault::Fault;

/// The program with its styles; `DATA` in it is where the data go.
const TEMPLATE: &str = include_str!("../../../integrations/report/bundle/report.html");
const DATA: &str = "<!-- DATA -->";

/// Triangles of a level that a page draws.
const MOST_TRIANGLES: usize = 200_000;
/// Width of the pictures of probes, pixels.
const THUMBNAIL: usize = 192;

/// What a page may show beside volumes.
#[derive(Default)]
pub struct Surroundings {
    name: String,
    level: DrawnLevel,
    probes: Vec<Thumbnail>,
}

/// A small picture of a probe.
struct Thumbnail {
    name: String,
    position: Option<[f64; 3]>,
    width: usize,
    height: usize,
    pixels: Vec<[u8; 3]>,
}

impl Surroundings {
    /// Of the level and the probes that a bake reads.
    pub fn of(inputs: &Inputs) -> Surroundings {
        let probe = |probe: &gdibl_baker::radiance::gdibl::Probe| {
            Thumbnail::of(&probe.name, Some(probe.position.to_array()), &probe.panorama)
        };
        let distant = inputs.distant.iter().map(|distant| Thumbnail::of(&distant.name, None, &distant.panorama));
        Surroundings {
            name: file_name(Path::new(&inputs.level)),
            level: DrawnLevel::of(&inputs.scene, MOST_TRIANGLES),
            probes: inputs.probes.iter().map(probe).chain(distant).collect(),
        }
    }
}

impl Thumbnail {
    fn of(name: &str, position: Option<[f64; 3]>, panorama: &Panorama) -> Thumbnail {
        let image = thumbnail(panorama, THUMBNAIL);
        let pixels = tone::display(&image, tone::automatic_exposure_stops(&image));
        Thumbnail { name: name.into(), position, width: image.width, height: image.height, pixels }
    }
}

/// A volume that a page shows: what is told of it, and the bytes of its file.
pub struct Shown {
    pub inspected: Inspected,
    pub bytes: Vec<u8>,
}

/// The data of a page.
#[derive(Default)]
struct Data {
    blobs: Vec<Vec<u8>>,
}

impl Data {
    /// The number of a blob, by which the JSON names it.
    fn blob(&mut self, bytes: Vec<u8>) -> usize {
        self.blobs.push(bytes);
        self.blobs.len() - 1
    }

    fn floats<'a>(&mut self, values: impl IntoIterator<Item = &'a f32>) -> usize {
        self.blob(values.into_iter().flat_map(|value| value.to_le_bytes()).collect())
    }

    fn halves<'a>(&mut self, values: impl IntoIterator<Item = &'a f32>) -> usize {
        self.blob(values.into_iter().flat_map(|value| f16::from_f32(*value).to_le_bytes()).collect())
    }

    fn volume(&mut self, shown: &Shown) -> Value {
        let Shown { inspected, bytes } = shown;
        let Inspected { report, volume, figures, seen } = inspected;
        let figures: serde_json::Map<String, Value> = Figure::ALL
            .into_iter()
            .filter_map(|figure| Some((figure.name().to_owned(), self.halves(figures.of(figure)?).into())))
            .collect();
        let walls: Vec<f32> = walled_boxes(volume).as_flattened().as_flattened().iter().map(|c| *c as f32).collect();
        json!({
            "name": file_name(Path::new(&report.file)),
            "report": report,
            "bytes": self.blob(bytes.clone()),
            "figures": figures,
            "walls": self.floats(&walls),
            "seen": seen,
        })
    }

    fn level(&mut self, name: &str, level: &DrawnLevel) -> Value {
        // Of square roots, so that dark colours keep their shades.
        let bytes = |colours: &[[f32; 3]]| {
            colours.as_flattened().iter().map(|c| (c.max(0.0).sqrt() * 255.0).round() as u8).collect()
        };
        json!({
            "name": name,
            "origin": level.origin,
            "trianglesOfLevel": level.triangles_of_level,
            "triangles": self.blob(level.triangles.as_flattened().iter().flat_map(|index| index.to_le_bytes()).collect()),
            "positions": self.floats(level.positions.as_flattened()),
            "normals": self.blob(level.normals.as_flattened().iter().map(|n| (n * 127.0).round() as i8 as u8).collect()),
            "albedo": self.blob(bytes(&level.albedo)),
            "emission": (!level.emission.is_empty()).then(|| self.halves(level.emission.as_flattened())),
        })
    }

    fn thumbnail(&mut self, probe: &Thumbnail) -> Value {
        let Thumbnail { name, position, width, height, pixels } = probe;
        let pixels = self.blob(pixels.as_flattened().to_vec());
        json!({ "name": name, "position": position, "width": width, "height": height, "pixels": pixels })
    }
}

/// The page of some volumes; `comparison`: what `gdibl compare` says of the first against the second.
pub fn html(volumes: &[Shown], surroundings: &Surroundings, comparison: Option<&(impl Serialize + ?Sized)>) -> String {
    let mut data = Data::default();
    let level = &surroundings.level;
    let object = json!({
        "volumes": volumes.iter().map(|volume| data.volume(volume)).collect::<Vec<_>>(),
        "level": (!level.triangles.is_empty()).then(|| data.level(&surroundings.name, level)),
        "probes": surroundings.probes.iter().map(|probe| data.thumbnail(probe)).collect::<Vec<_>>(),
        "comparison": comparison,
    });
    let mut text = format!("<script type=\"application/json\" id=\"data\">{}</script>\n", inert(&object));
    for (number, blob) in data.blobs.iter().enumerate() {
        text += &format!("<script type=\"application/octet-stream\" id=\"blob-{number}\">");
        STANDARD.encode_string(blob, &mut text);
        text += "</script>\n";
    }
    let (before, after) = TEMPLATE.split_once(DATA).expect("the template has a place for data");
    [before, &text, after].concat()
}

/// Writes the page, whole or not at all.
pub fn write(
    path: &Path,
    volumes: &[Shown],
    surroundings: &Surroundings,
    comparison: Option<&(impl Serialize + ?Sized)>,
) -> Result<(), Fault> {
    write_whole(path, html(volumes, surroundings, comparison).as_bytes()).map_err(Fault::from_writing)
}

/// The page of a volume that was just written.
pub fn write_of_file(path: &Path, volume: &Path, surroundings: &Surroundings) -> Result<(), Fault> {
    let bytes = crate::commands::read_volume_bytes(volume)?;
    let inspected = Inspected::of(volume, &bytes, WORST)?;
    write(path, &[Shown { inspected, bytes }], surroundings, None::<&()>)
}

/// JSON that HTML takes for text, whatever names it holds.
fn inert(value: &Value) -> String {
    let text = value.to_string();
    // These stand in strings alone, where JSON may write any character by its number.
    text.replace('<', "\\u003c").replace('>', "\\u003e").replace('&', "\\u0026")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_from_files_do_not_become_markup() {
        let name = "</script><script>alert(\"1\")</script><!-- & ' \u{1} \u{2028}";
        let text = inert(&json!({ "name": name }));
        assert!(!text.contains(['<', '>', '&', '\u{1}']), "{text}");
        assert_eq!(serde_json::from_str::<Value>(&text).unwrap()["name"], name);
    }

    #[test]
    fn the_bundle_has_one_place_for_data_and_asks_for_nothing_else() {
        assert_eq!(TEMPLATE.matches(DATA).count(), 1);
        assert!(TEMPLATE.len() <= 2 << 20, "{} bytes", TEMPLATE.len());
        for outside in ["src=\"http", "href=\"http", "@import", "url(http"] {
            assert!(!TEMPLATE.contains(outside), "{outside}");
        }
    }
}
