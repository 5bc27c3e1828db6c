//! `gdibl sample`: light at the places of a CSV file.

use std::io::Write;
use std::path::{Path, PathBuf};

use gdibl_runtime::{Sample, Volume, sh};

use crate::fault::Fault;
use crate::inputs::{Places, read_places};

#[derive(clap::Args)]
pub struct Arguments {
    /// The volume
    file: PathBuf,
    /// CSV of places: x,y,z or x,y,z,nx,ny,nz, world metres and unit normals; a header line may come first; - is stdin
    #[arg(long, value_name = "FILE.csv")]
    at: PathBuf,
    /// Print radiance coefficients sh0r,sh0g,sh0b,sh1r … instead of irradiance
    #[arg(long)]
    sh: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: Arguments) -> Result<(), Fault> {
    let bytes = super::read_volume_bytes(&arguments.file)?;
    let volume = Volume::parse(&bytes).map_err(|error| super::volume_fault(&arguments.file, &error))?;
    if volume.header().is_deringed() {
        eprintln!(
            "gdibl: {} is de-ringed: coefficients of nodes that rang are not the raw projection",
            arguments.file.display()
        );
    }
    let places = read_places(&arguments.at)?;
    if places.normals.is_empty() && !arguments.sh {
        return Err(Fault::Invalid(format!(
            "{}: has no normals, and irradiance needs them: add columns nx,ny,nz, or ask for --sh",
            arguments.at.display()
        )));
    }
    let samples: Vec<Sample> =
        (0..places.positions.len()).map(|i| volume.sample_f64(places.positions[i].into(), places.normal(i))).collect();
    let outside = samples.iter().filter(|s| !s.inside).count();
    if outside > 0 {
        eprintln!(
            "gdibl: {outside} of {} places are outside the volume's box; they get its nearest light",
            samples.len()
        );
    }
    let rows: Vec<Vec<f64>> = samples.iter().enumerate().map(|(i, s)| row(&places, i, s, arguments.sh)).collect();
    let names = column_names(&places, volume.header().bands, arguments.sh);
    let written = if arguments.json { write_json(&names, &rows) } else { write_csv(&names, &rows) };
    match written {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Fault::writing(Path::new("stdout"), &error))
        }
        _ => Ok(()),
    }
}

/// The columns that came in, then the answer.
fn row(places: &Places, index: usize, sample: &Sample, coefficients: bool) -> Vec<f64> {
    let mut row: Vec<f64> = places.positions[index].to_array().into();
    if !places.normals.is_empty() {
        row.extend(places.normals[index].to_array().map(f64::from));
    }
    if coefficients {
        let count = sh::coefficient_count(sample.sh.bands);
        row.extend(sample.sh.coefficients[..count].iter().flatten().map(|&c| f64::from(c)));
    } else {
        row.extend(sample.sh.convolve().evaluate(places.normal(index)).map(f64::from));
    }
    row.push(f64::from(sample.validity));
    row
}

fn column_names(places: &Places, bands: u32, coefficients: bool) -> Vec<String> {
    let mut names: Vec<String> = ["x", "y", "z"].map(String::from).into();
    if !places.normals.is_empty() {
        names.extend(["nx", "ny", "nz"].map(String::from));
    }
    if coefficients {
        let channels = ["r", "g", "b"];
        names.extend((0..sh::coefficient_count(bands)).flat_map(|i| channels.map(|c| format!("sh{i}{c}"))));
    } else {
        names.extend(["r", "g", "b"].map(String::from));
    }
    names.push("validity".into());
    names
}

fn write_csv(names: &[String], rows: &[Vec<f64>]) -> std::io::Result<()> {
    let mut out = csv::Writer::from_writer(std::io::stdout().lock());
    out.write_record(names)?;
    for row in rows {
        // Shortest text that reads back as the same number; coefficients are f32.
        let leading = names.iter().take_while(|n| n.len() < 3 && !matches!(n.as_str(), "r" | "g" | "b")).count();
        let text = |(i, v): (usize, &f64)| if i < leading { v.to_string() } else { (*v as f32).to_string() };
        out.write_record(row.iter().enumerate().map(text))?;
    }
    out.flush()
}

fn write_json(names: &[String], rows: &[Vec<f64>]) -> std::io::Result<()> {
    let objects: Vec<serde_json::Map<String, serde_json::Value>> =
        rows.iter().map(|row| names.iter().cloned().zip(row.iter().map(|v| (*v).into())).collect()).collect();
    let mut out = std::io::stdout().lock();
    serde_json::to_writer_pretty(&mut out, &objects)?;
    writeln!(out)
}
