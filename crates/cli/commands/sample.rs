//! `gdibl sample`: light at the places of a CSV file.

use std::path::PathBuf;

use gdibl_baker::Finding;
use gdibl_baker::import::files::Disk;
use gdibl_runtime::{Sample, sh};
use serde::Serialize;

use crate::fault::Fault;
use crate::inputs::{Places, read_places};
use crate::session::{Outcome, Session};
use crate::volumes::Light;

#[derive(clap::Args)]
pub struct Arguments {
    /// The volume, or a list of volumes
    file: PathBuf,
    /// CSV of places: x,y,z or x,y,z,nx,ny,nz, world metres and unit normals; a header line may come first; - is stdin
    #[arg(long, value_name = "FILE.csv")]
    at: PathBuf,
    /// Print radiance coefficients sh0r,sh0g,sh0b,sh1r … instead of irradiance
    #[arg(long)]
    sh: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Report {
    /// One object per place, by column names.
    samples: Vec<serde_json::Map<String, serde_json::Value>>,
}

pub fn run(arguments: Arguments, session: &Session) -> Result<Outcome, Fault> {
    let light = Light::read(&arguments.file)?;
    if light.is_deringed() {
        let file = arguments.file.display();
        let message = format!("{file} is de-ringed: coefficients of nodes that rang are not the raw projection");
        session.find(&[Finding::new("deringed", 1, message)]);
    }
    let places = read_places(&Disk, &arguments.at)?;
    if places.normals.is_empty() && !arguments.sh {
        return Err(Fault::Invalid(format!(
            "{}: has no normals, and irradiance needs them: add columns nx,ny,nz, or ask for --sh",
            arguments.at.display()
        )));
    }
    let samples: Vec<Sample> =
        (0..places.positions.len()).map(|i| light.sample_f64(places.positions[i].into(), places.normal(i))).collect();
    let outside = samples.iter().filter(|s| !s.inside).count();
    if outside > 0 {
        let all = samples.len();
        let message = format!("{outside} of {all} places are outside the volume's box; they get its nearest light");
        session.find(&[Finding::new("outside", outside as u64, message)]);
    }
    let bands = light.bands();
    let rows = samples.iter().enumerate().map(|(i, sample)| row(&places, i, sample, bands, arguments.sh));
    let rows: Vec<Vec<f64>> = rows.collect();
    let names = column_names(&places, bands, arguments.sh);
    let text = csv_of(&names, &rows);
    let object = |row: &Vec<f64>| names.iter().cloned().zip(row.iter().map(|value| (*value).into())).collect();
    Ok(Outcome::new(Report { samples: rows.iter().map(object).collect() }, text))
}

/// The columns that came in, then the answer.
fn row(places: &Places, index: usize, sample: &Sample, bands: u32, coefficients: bool) -> Vec<f64> {
    let mut row: Vec<f64> = places.positions[index].to_array().into();
    if !places.normals.is_empty() {
        row.extend(places.normals[index].to_array().map(f64::from));
    }
    if coefficients {
        let count = sh::coefficient_count(bands);
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

fn csv_of(names: &[String], rows: &[Vec<f64>]) -> String {
    // Shortest text that reads back as the same number; coefficients are f32.
    let leading = names.iter().take_while(|n| n.len() < 3 && !matches!(n.as_str(), "r" | "g" | "b")).count();
    let mut text = names.join(",") + "\n";
    for row in rows {
        let number = |(i, v): (usize, &f64)| if i < leading { v.to_string() } else { (*v as f32).to_string() };
        text += &row.iter().enumerate().map(number).collect::<Vec<_>>().join(",");
        text.push('\n');
    }
    text
}
