//! `gdibl export`: a volume in an engine's own format, and what that loses.

use std::path::{Path, PathBuf};

use gdibl_baker::pack::write_whole;
use gdibl_export::{Engine, Error, Export, Loss, Settings, export};
use gdibl_runtime::Volume;
use serde::Serialize;

use crate::config::file_name;
use crate::fault::Fault;
use crate::session::Outcome;
use crate::volumes::{VolumeList, is_list, set_of};

#[derive(clap::Args)]
pub struct Arguments {
    /// The volume, or a list of volumes: engines take one each
    file: PathBuf,
    /// For whom: bevy (KTX2), three (LightProbeGrid), godot (LightmapGIData .tres), unity (light probes as JSON), exr
    /// (coefficients as layers) or json
    #[arg(long, value_name = "ENGINE")]
    to: Target,
    /// The file to write; files that come with it go beside it. Of a list one is written for each volume, its name behind a
    /// dash: OUT-NAME
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Grid nodes per axis: X,Y,Z, sampled from the volume; more of them lessen what three, godot and unity lose
    /// [default: the volume's own nodes]
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_counts)]
    counts: Option<[u32; 3]>,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Target {
    Bevy,
    Three,
    Godot,
    Unity,
    Exr,
    Json,
}

impl Target {
    fn engine(self) -> Engine {
        match self {
            Target::Bevy => Engine::Bevy,
            Target::Three => Engine::Three,
            Target::Godot => Engine::Godot,
            Target::Unity => Engine::Unity,
            Target::Exr => Engine::Exr,
            Target::Json => Engine::Json,
        }
    }
}

/// What `--json` prints.
#[derive(Serialize)]
struct Report {
    volume: String,
    /// In the order written; the one asked for first.
    files: Vec<FileReport>,
    /// Nodes that rang were windowed in the volume.
    deringed: bool,
    #[serde(flatten)]
    export: gdibl_export::Report,
}

#[derive(Serialize)]
struct FileReport {
    path: String,
    bytes: usize,
}

/// What `--json` prints of a list.
#[derive(Serialize)]
struct ListReport {
    list: String,
    /// In the order of the list, the finest first.
    volumes: Vec<ListedReport>,
}

#[derive(Serialize)]
struct ListedReport {
    name: String,
    #[serde(flatten)]
    report: Report,
}

pub fn run(arguments: Arguments) -> Result<Outcome, Fault> {
    let Arguments { file, to, output, counts } = &arguments;
    let bytes = super::read_bytes(file)?;
    if !is_list(&bytes) {
        let volume = Volume::parse(&bytes).map_err(|error| super::volume_fault(file, &error))?;
        let (report, text) = export_one(&volume, file, *to, output, *counts)?;
        return Ok(Outcome::new(report, text));
    }
    let listings = VolumeList::parse(file, &bytes)?.open(file)?;
    set_of(&listings, file)?;
    let (mut volumes, mut texts) = (Vec::new(), Vec::new());
    for listing in listings {
        let (name, path) = (&listing.entry.name, &listing.path);
        let (report, text) = export_one(&listing.parse()?, path, *to, &with_name(output, name), *counts)?;
        texts.push(text);
        volumes.push(ListedReport { name: name.clone(), report });
    }
    Ok(Outcome::new(ListReport { list: file.display().to_string(), volumes }, texts.join("\n")))
}

/// The output of one volume of a list.
fn with_name(output: &Path, name: &str) -> PathBuf {
    let stem = output.file_stem().unwrap_or_default().to_string_lossy();
    let ending = output.extension().map_or_else(String::new, |ending| format!(".{}", ending.to_string_lossy()));
    output.with_file_name(format!("{stem}-{name}{ending}"))
}

fn export_one(
    volume: &Volume,
    file: &Path,
    to: Target,
    output: &Path,
    counts: Option<[u32; 3]>,
) -> Result<(Report, String), Fault> {
    super::check_output(output)?;
    let settings = Settings { name: file_name(output), counts };
    let Export { files, report } = export(volume, to.engine(), &settings).map_err(|error| match error {
        Error::Unsupported(message) => Fault::Unsupported(format!("{}: {message}", file.display())),
        Error::Settings(message) => Fault::Usage(message),
    })?;
    // The one asked for last: where it is, the others are.
    let paths: Vec<PathBuf> = files.iter().map(|file| output.with_file_name(&file.name)).collect();
    for (path, file) in paths.iter().zip(&files).rev() {
        write_whole(path, &file.bytes).map_err(Fault::from_writing)?;
    }
    let files = paths.iter().zip(&files);
    let report = Report {
        volume: file.display().to_string(),
        files: files
            .map(|(path, file)| FileReport { path: path.display().to_string(), bytes: file.bytes.len() })
            .collect(),
        deringed: volume.header().is_deringed(),
        export: report,
    };
    let text = text(&report, file);
    Ok((report, text))
}

fn parse_counts(text: &str) -> Result<[u32; 3], String> {
    let numbers: Result<Vec<u32>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    let counts = numbers.ok().and_then(|numbers| <[u32; 3]>::try_from(numbers).ok());
    counts.filter(|counts| !counts.contains(&0)).ok_or("expected three whole numbers, 1 or more: 16,8,24".into())
}

fn text(report: &Report, volume: &Path) -> String {
    let export = &report.export;
    let mut lines = vec![report.files[0].path.clone()];
    let mut row = |name: &str, text: String| lines.push(format!("  {name:<10} {text}"));
    for (i, file) in report.files.iter().enumerate() {
        row(if i == 0 { "files" } else { "" }, format!("{} ({} bytes)", file.path, file.bytes));
    }
    let [x, y, z] = export.counts;
    row("nodes", format!("{x} x {y} x {z}"));
    let bands = export.bands.map_or("ambient cubes".into(), |bands| format!("L{bands}"));
    let how = if report.deringed { ", de-ringed" } else { "" };
    row("light", format!("{bands}, from L{} of {}{how}", export.bands_of_volume, volume.display()));
    row("error", loss_text(&export.error));
    for variant in &export.variants {
        let written = if variant.written { " (written)" } else { "" };
        row("", format!("{}{written}: {}", variant.name, loss_text(&variant.error)));
    }
    let negative = &export.negative;
    if negative.share > 0.0 {
        row(
            "negative",
            format!(
                "E is below 0 at {:.2} % of places, by {:.2} % of its RMS at most; {}",
                negative.share * 100.0,
                -negative.least * 100.0,
                negative.engine
            ),
        );
    }
    for note in &export.notes {
        row("note", note.message.clone());
    }
    lines.join("\n")
}

fn loss_text(loss: &Loss) -> String {
    let Loss { relative_rmse, bias, p95, max } = loss;
    format!(
        "{} relative RMSE of E, bias {:+.2} %, {} 95th percentile, {} worst",
        percent(*relative_rmse),
        bias * 100.0,
        percent(*p95),
        percent(*max)
    )
}

fn percent(share: f64) -> String {
    format!("{:.2} %", share * 100.0)
}
