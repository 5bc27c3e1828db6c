//! All that a volume holds as JSON: for scripts, and for kinds of volume that no engine's own format has.

use serde::Serialize;

use gdibl_runtime::sh::coefficient_count;
use gdibl_runtime::volume::VertexSet;
use gdibl_runtime::{Grid, Kind, RadianceSh, Volume};

use crate::light::{Least, Light};
use crate::loss::Truth;
use crate::{Error, Export, File, Report, Settings, exr};

#[derive(Serialize)]
struct Document {
    format: &'static str,
    version: u32,
    kind: &'static str,
    /// Nodes per axis of a grid; of points and vertices: how many, 1, 1.
    counts: [u32; 3],
    /// The box, metres.
    min: [f64; 3],
    max: [f64; 3],
    /// The highest band.
    bands: u32,
    /// Of each node, metres.
    positions: Vec<[f64; 3]>,
    /// Of each vertex.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    normals: Vec<[f32; 3]>,
    /// Which nodes are the vertices of which primitive.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    vertex_sets: Vec<Set>,
    /// Of each node, of each coefficient l(l+1)+m: radiance, RGB.
    radiance: Vec<Vec<[f32; 3]>>,
    /// Of each node: the share that was baked.
    validity: Vec<f32>,
    /// Of each node: the share of what it sees that some probe has seen. Absent: all of it, everywhere.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    coverage: Vec<f32>,
    /// Of each node: one standard error of irradiance, relative. Absent: not measured.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    relative_error: Vec<f32>,
}

/// Nodes `first` to `first + count - 1` are the vertices of a primitive, in the level's order.
#[derive(Serialize)]
struct Set {
    /// glTF indices.
    node: u32,
    mesh: u32,
    primitive: u32,
    first: u32,
    count: u32,
}

pub(crate) fn export(volume: &Volume, settings: &Settings) -> Result<Export, Error> {
    if volume.grid().is_some() {
        grid(volume, settings)
    } else if settings.counts.is_some() {
        Err(Error::Settings("--counts: a volume of points or vertices is written as it is".into()))
    } else {
        Ok(places(volume, settings))
    }
}

fn grid(volume: &Volume, settings: &Settings) -> Result<Export, Error> {
    let light = Light::of_volume(volume, settings.counts, Least::One)?;
    let truth = Truth::of_volume(volume);
    let error = truth.loss(|position, normal| exr::irradiance(&light, position, normal));
    let Grid { min, max, counts } = light.grid;
    let places: Vec<[f64; 3]> = (0..light.nodes.len()).map(|i| light.grid.node_position(i)).collect();
    let document = Document {
        kind: "grid",
        counts,
        min,
        max,
        positions: places.clone(),
        radiance: light.nodes.iter().map(coefficients).collect(),
        validity: light.validity,
        coverage: coverage(places.iter().map(|place| between(volume, *place, |node| volume.node_coverage(node)))),
        relative_error: match volume.node_relative_error(0) {
            None => Vec::new(),
            Some(_) => {
                let error = |node: usize| volume.node_relative_error(node).unwrap_or(0.0);
                places.iter().map(|place| between(volume, *place, error)).collect()
            }
        },
        ..empty(volume)
    };
    let report = Report {
        counts,
        bands_of_volume: document.bands,
        bands: Some(document.bands),
        error,
        variants: Vec::new(),
        negative: truth.negative("kept"),
        notes: light.notes,
    };
    Ok(Export { files: files(&document, settings), report })
}

/// Points and vertices. Nothing is interpolated, so that light is compared at their own places.
fn places(volume: &Volume, settings: &Settings) -> Export {
    let nodes = 0..volume.node_count();
    let normal = |i: usize| volume.node_normal(i).unwrap_or(crate::sample_normal(i));
    let document = Document {
        kind: if volume.header().kind == Kind::Points { "points" } else { "vertices" },
        positions: nodes.clone().map(|i| volume.node_position(i)).collect(),
        normals: nodes.clone().filter_map(|i| volume.node_normal(i)).collect(),
        vertex_sets: volume
            .vertex_sets()
            .iter()
            .map(|&VertexSet { node, mesh, primitive, first, count }| Set { node, mesh, primitive, first, count })
            .collect(),
        radiance: nodes.clone().map(|i| coefficients(&volume.node_sh(i))).collect(),
        validity: nodes.clone().map(|i| if volume.is_valid(i) { 1.0 } else { 0.0 }).collect(),
        coverage: coverage(nodes.clone().map(|i| volume.node_coverage(i))),
        relative_error: nodes.clone().filter_map(|i| volume.node_relative_error(i)).collect(),
        ..empty(volume)
    };
    let truth = Truth::at(volume, nodes.map(|i| (volume.node_position(i), normal(i))).collect());
    let report = Report {
        counts: document.counts,
        bands_of_volume: document.bands,
        bands: Some(document.bands),
        error: truth.loss(|position, normal| {
            let node = volume.nearest_node(position, normal).unwrap_or(0);
            let mut sh = RadianceSh::zero(document.bands);
            sh.coefficients[..document.radiance[node].len()].copy_from_slice(&document.radiance[node]);
            sh.convolve().evaluate(normal).map(|e| f64::from(e.max(0.0)))
        }),
        variants: Vec::new(),
        negative: truth.negative("kept"),
        notes: Vec::new(),
    };
    Export { files: files(&document, settings), report }
}

fn empty(volume: &Volume) -> Document {
    let header = volume.header();
    Document {
        format: "gdibl volume",
        version: 1,
        kind: "",
        counts: header.counts,
        min: header.min,
        max: header.max,
        bands: header.bands,
        positions: Vec::new(),
        normals: Vec::new(),
        vertex_sets: Vec::new(),
        radiance: Vec::new(),
        validity: Vec::new(),
        coverage: Vec::new(),
        relative_error: Vec::new(),
    }
}

/// What baked nodes around a place say; where none is near, what the filled ones do.
fn between(volume: &Volume, place: [f64; 3], of: impl Fn(usize) -> f32) -> f32 {
    let Some(cell) = volume.cell(place) else { return 0.0 };
    let around = cell.nodes.iter().map(|node| *node as usize).zip(cell.weights);
    let mean = |around: &mut dyn Iterator<Item = (usize, f32)>| {
        let (sum, total) = around.fold((0.0, 0.0), |(sum, total), (node, w)| (sum + w * of(node), total + w));
        (total > 0.0).then(|| sum / total)
    };
    let baked = mean(&mut around.clone().filter(|(node, _)| volume.is_valid(*node)));
    baked.or_else(|| mean(&mut around.clone())).unwrap_or(0.0)
}

/// Empty where all is covered.
fn coverage(values: impl Iterator<Item = f32>) -> Vec<f32> {
    let values: Vec<f32> = values.collect();
    if values.iter().all(|value| *value == 1.0) { Vec::new() } else { values }
}

fn coefficients(sh: &RadianceSh) -> Vec<[f32; 3]> {
    sh.coefficients[..coefficient_count(sh.bands)].to_vec()
}

fn files(document: &Document, settings: &Settings) -> Vec<File> {
    vec![File { name: settings.name.clone(), bytes: serde_json::to_vec(document).expect("plain data") }]
}
