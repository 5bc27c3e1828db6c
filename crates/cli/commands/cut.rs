//! `gdibl cut`: smaller volumes out of a baked one, and what that loses.

use std::path::{Path, PathBuf};

use gdibl_baker::cut::{Part, Tile, coarser, difference, tiles, whole};
use gdibl_baker::job::Bands;
use gdibl_baker::job::bands;
use gdibl_baker::job::records::PlanRow;
use gdibl_baker::job::records::{ErrorSummary, Records};
use gdibl_baker::pack::{PackSettings, Precision, pack, volume_of, write_whole};
use gdibl_runtime::Volume;
use gdibl_runtime::format::{self, Codec, Directory, Encoding, Header};
use serde::Serialize;

use crate::config::file_name;
use crate::fault::Fault;
use crate::session::Outcome;

/// Places at which a cut is compared with the volume.
const PLACES: u32 = 10_000;
/// The list of the tiles in a folder.
const LIST: &str = "tiles.json";

#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("what").required(true).multiple(true).args(["coarser", "tile", "sh", "precision"]))]
pub struct Arguments {
    /// The volume: a grid, sparse or not
    file: PathBuf,
    /// The file to write; with --tile the folder for the tiles
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Level of detail: cells 2^STEPS times as wide, for small devices and for what is far away
    #[arg(long, value_name = "STEPS", value_parser = clap::value_parser!(u32).range(1..=8))]
    coarser: Option<u32>,
    /// In tiles about so wide, for an engine to load and drop: X_Y_Z.gdibl, and tiles.json, which lists them
    #[arg(long, value_name = "METRES", value_parser = parse_width)]
    tile: Option<f64>,
    /// With bands up to this one: L0 to L4
    #[arg(long, value_name = "BANDS", value_parser = parse_whole_bands)]
    sh: Option<u32>,
    /// f16, f32, packed or packed:ERROR [default: as the volume]
    #[arg(long, value_name = "PRECISION")]
    precision: Option<Precision>,
    /// Compress sections with zstd [default: as the volume]
    #[arg(long)]
    zstd: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Report {
    volume: String,
    /// Of the volume.
    bytes: usize,
    nodes: usize,
    /// What was written.
    files: Vec<FileReport>,
    /// Of E at places where the volume has light of its own: what was written against it, over the larger of the volume's own E and
    /// a tenth of its median. `None` where it has none.
    difference: Option<ErrorSummary>,
}

/// A volume that was written, in `tiles.json`, too.
#[derive(Serialize)]
struct FileReport {
    file: String,
    bytes: usize,
    nodes: usize,
    min: [f64; 3],
    max: [f64; 3],
}

#[derive(Serialize)]
struct List<'a> {
    tiles: &'a [FileReport],
}

pub fn run(arguments: Arguments) -> Result<Outcome, Fault> {
    let Arguments { file, output, .. } = &arguments;
    let bytes = super::read_volume_bytes(file)?;
    let fault = |error: gdibl_runtime::Error| super::volume_fault(file, &error);
    let directory = format::parse_header_and_sections(&bytes).map_err(fault)?;
    let volume = Volume::parse(&bytes).map_err(fault)?;
    let no_grid =
        || Fault::Unsupported(format!("{}: points, vertices, and single nodes cannot be cut", file.display()));
    if volume.grid().is_none_or(|grid| grid.counts == [1; 3]) {
        return Err(no_grid());
    }
    match arguments.tile {
        Some(_) => std::fs::create_dir_all(output).map_err(|error| Fault::writing(output, &error))?,
        None => super::check_output(output)?,
    }

    let records = records(&directory, file)?;
    let packing = packing(&directory, &arguments);
    let base = match arguments.coarser {
        None => volume.clone(),
        Some(steps) => coarser(&volume, steps).map(|part| volume_of(&part.nodes, &part.baked)).ok_or_else(no_grid)?,
    };
    let mut files = Vec::new();
    let mut parts = Vec::new();
    let mut write = |path: &Path, name: String, Part { nodes, mut baked }: Part| -> Result<(), Fault> {
        if let Some(bands) = arguments.sh {
            bands::truncate(&mut baked, bands.min(volume.header().bands));
        }
        let part = Part { nodes, baked };
        let mut records = part.records(records.clone());
        records.plan.push(plan_row(&arguments, &file_name(file), volume.node_count()));
        let bytes = pack(&part.nodes, &part.baked, records, packing).bytes;
        write_whole(path, &bytes).map_err(Fault::from_writing)?;
        let part = Volume::parse(&bytes).expect("what was packed parses");
        let header = part.header();
        let (nodes, min, max) = (part.node_count(), header.min, header.max);
        files.push(FileReport { file: name, bytes: bytes.len(), nodes, min, max });
        parts.push(part);
        Ok(())
    };
    match arguments.tile {
        None => write(output, output.display().to_string(), whole(&base).ok_or_else(no_grid)?)?,
        Some(width) => {
            for Tile { index: [x, y, z], part } in tiles(&base, width).ok_or_else(no_grid)? {
                let name = format!("{x}_{y}_{z}.gdibl");
                write(&output.join(&name), name, part)?;
            }
            let list = serde_json::to_string_pretty(&List { tiles: &files }).expect("lists are plain data");
            write_whole(&output.join(LIST), list.as_bytes()).map_err(Fault::from_writing)?;
        }
    }
    let report = Report {
        volume: file.display().to_string(),
        bytes: bytes.len(),
        nodes: volume.node_count(),
        difference: difference(&volume, &parts, PLACES),
        files,
    };
    let text = text(&report, &arguments);
    Ok(Outcome::new(report, text))
}

/// All that the volume knows of how it was baked.
fn records(directory: &Directory, path: &Path) -> Result<Records, Fault> {
    Ok(Records {
        settings: super::record(directory, path, format::SETTINGS)?,
        plan: super::record(directory, path, format::PLAN)?.unwrap_or_default(),
        probes: super::record(directory, path, format::PROBES)?.unwrap_or_default(),
        statistics: super::record(directory, path, format::STATISTICS)?,
    })
}

/// As the volume is packed, where nothing else is asked for.
fn packing(directory: &Directory, arguments: &Arguments) -> PackSettings {
    let Header { encoding, scale, .. } = directory.header;
    let precision = arguments.precision.unwrap_or(match encoding {
        Encoding::F16 => Precision::F16,
        Encoding::F32 => Precision::F32,
        Encoding::Packed => Precision::PACKED,
    });
    let step = (arguments.precision.is_none() && encoding == Encoding::Packed).then_some(scale);
    let is_compressed = directory.sections.iter().any(|section| section.codec == Codec::Zstd);
    PackSettings { precision, zstd: arguments.zstd || is_compressed, dering: false, step }
}

fn plan_row(arguments: &Arguments, volume: &str, nodes: usize) -> PlanRow {
    let Arguments { coarser, tile, sh, .. } = arguments;
    let parts = [
        coarser.map(|steps| format!("cells {} times as wide", 1 << steps)),
        tile.map(|width| format!("a tile about {width} m wide")),
        sh.map(|bands| format!("bands up to L{bands}")),
    ];
    let parts: Vec<String> = parts.into_iter().flatten().collect();
    PlanRow::new("cut", true, format!("from {nodes} nodes of {volume}: {}", parts.join(", ")))
}

fn parse_width(text: &str) -> Result<f64, String> {
    let width = text.parse().ok().filter(|width: &f64| *width > 0.0 && width.is_finite());
    width.ok_or("expected a width in metres, above 0".into())
}

fn parse_whole_bands(text: &str) -> Result<u32, String> {
    match text.parse() {
        Ok(Bands::To(bands)) => Ok(bands),
        _ => Err("expected L0, L1, L2, L3 or L4".into()),
    }
}

fn text(report: &Report, arguments: &Arguments) -> String {
    let mut lines = vec![arguments.output.display().to_string()];
    let mut row = |name: &str, text: String| lines.push(format!("  {name:<10} {text}"));
    if arguments.tile.is_some() {
        row("tiles", format!("{}, listed in {LIST}", report.files.len()));
    }
    let [nodes, bytes]: [usize; 2] =
        [report.files.iter().map(|file| file.nodes).sum(), report.files.iter().map(|file| file.bytes).sum()];
    let share = |part: usize, whole: usize| 100.0 * part as f64 / whole as f64;
    row("nodes", format!("{nodes}, {:.1} % of {}", share(nodes, report.nodes), report.nodes));
    row("bytes", format!("{bytes}, {:.1} % of {}", share(bytes, report.bytes), report.bytes));
    if let Some(ErrorSummary { median, p95, max }) = report.difference {
        let [median, p95, max] = [median, p95, max].map(|e| e * 100.0);
        row(
            "off by",
            format!("{median:.2} % median, {p95:.2} % 95th percentile, {max:.2} % worst, of E against the volume"),
        );
    }
    lines.join("\n")
}
