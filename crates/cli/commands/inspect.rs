//! `gdibl inspect`: what is in a volume, what is wrong with it, and where: as text, as JSON, as a table, as a page.

use std::path::{Path, PathBuf};

use gdibl_baker::analyse::{Region, regions};
use gdibl_baker::import::gltf::TextureNeeds;
use gdibl_runtime::format::MAGIC;
use serde::Serialize;

use crate::config::{Config, FileFlags, LightFlags};
use crate::fault::Fault;
use crate::inputs::read_inputs;
use crate::report::page::{self, Shown, Surroundings};
use crate::report::text::text;
use crate::report::{Inspected, Report, WORST};
use crate::session::{Outcome, Session};
use crate::volumes::{Listing, VolumeList, is_list, set_of};

#[derive(clap::Args)]
pub struct Arguments {
    /// The volume; with -o one or more, and the level that they are of: LEVEL.glb, LEVEL.gltf or BAKE.toml
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Write a page to look at, in any browser and without a network: the level in the volume's light, nodes, slices, where
    /// it is worst
    #[arg(short, long, value_name = "REPORT.html")]
    output: Option<PathBuf>,
    /// How many of the worst places of each kind are told
    #[arg(long, value_name = "N", default_value_t = WORST)]
    worst: usize,
    /// Print a table instead: a row for each part of the volume, with its nodes, light and errors
    #[arg(long, conflicts_with = "output")]
    csv: bool,
}

pub fn run(arguments: Arguments, session: &Session) -> Result<Outcome, Fault> {
    let Arguments { files, output, worst, csv } = &arguments;
    if let ([list], None, false) = (&files[..], output, csv) {
        let bytes = super::read_bytes(list)?;
        if is_list(&bytes) {
            return inspect_list(VolumeList::parse(list, &bytes)?, list, *worst);
        }
    }
    let (volumes, levels) = read(files)?;
    let Some(((first, first_bytes), more)) = volumes.split_first() else {
        return Err(not_a_volume(&files[0]));
    };
    let inspected = Inspected::of(first, first_bytes, *worst)?;
    let Some(output) = output else {
        return match (more, &levels[..]) {
            ([], []) if *csv => {
                let text = csv_of(&regions(&inspected.volume, &inspected.figures));
                Ok(Outcome::new(inspected.report, text))
            }
            ([], []) => {
                let said = text(&inspected);
                Ok(Outcome::new(inspected.report, said))
            }
            ([(other, _), ..], _) => Err(Fault::Usage(format!("{}: one volume at a time, or -o", other.display()))),
            ([], [level, ..]) if level.extension().is_some_and(|end| end == "gdibl") => Err(not_a_volume(level)),
            ([], [level, ..]) => Err(Fault::Usage(format!("{}: a level is shown on a page: -o", level.display()))),
        };
    };
    if let [_, level, ..] = &levels[..] {
        return Err(Fault::Usage(format!("{}: one level at a time", level.display())));
    }
    // Everything is read and refused before anything is written.
    super::check_output(output)?;
    let said = format!("{}\n  page        {}", text(&inspected), output.display());
    let mut shown = vec![Shown { inspected, bytes: first_bytes.clone() }];
    for (path, bytes) in more {
        shown.push(Shown { inspected: Inspected::of(path, bytes, *worst)?, bytes: bytes.clone() });
    }
    let surroundings = levels.first().map(|level| surroundings_of(level, session)).transpose()?.unwrap_or_default();
    page::write(output, &shown, &surroundings, None::<&()>)?;
    Ok(Outcome::new(shown.swap_remove(0).inspected.report, said))
}

/// What `--json` prints of a list.
#[derive(Serialize)]
struct ListReport {
    list: String,
    /// File name of the level.
    level: String,
    /// In the order of the list, the finest first.
    volumes: Vec<ListedReport>,
}

#[derive(Serialize)]
struct ListedReport {
    name: String,
    #[serde(flatten)]
    report: Report,
}

/// Each volume of a list, one after another.
fn inspect_list(list: VolumeList, path: &Path, worst: usize) -> Result<Outcome, Fault> {
    let level = list.level.clone();
    let listings = list.open(path)?;
    // They fit together.
    set_of(&listings, path)?;
    let mut said = format!("{}: {} volumes of {level}, the finest first", path.display(), listings.len());
    let mut volumes = Vec::new();
    for Listing { entry, path, bytes } in listings {
        let inspected = Inspected::of(&path, &bytes, worst)?;
        said += &format!("\n\n'{}', blended over {:.3} m\n{}", entry.name, entry.spacing, text(&inspected));
        volumes.push(ListedReport { name: entry.name, report: inspected.report });
    }
    Ok(Outcome::new(ListReport { list: path.display().to_string(), level, volumes }, said))
}

/// A volume's path, and its bytes.
type VolumeFile = (PathBuf, Vec<u8>);

/// Volumes, and other files. The first bytes tell.
fn read(files: &[PathBuf]) -> Result<(Vec<VolumeFile>, Vec<PathBuf>), Fault> {
    let (mut volumes, mut levels) = (Vec::new(), Vec::new());
    for path in files {
        let bytes = super::read_bytes(path)?;
        match bytes.starts_with(&MAGIC) {
            true => volumes.push((path.clone(), bytes)),
            false => levels.push(path.clone()),
        }
    }
    Ok((volumes, levels))
}

/// What the runtime says of a file that is none.
fn not_a_volume(path: &Path) -> Fault {
    let parsed = super::read_volume_bytes(path).map(|bytes| Inspected::of(path, &bytes, 0));
    match parsed {
        Ok(Err(fault)) | Err(fault) => fault,
        Ok(Ok(_)) => Fault::Usage(format!("{}: name a volume", path.display())),
    }
}

/// The level that a page draws, and the probes that its BAKE.toml names.
pub fn surroundings_of(level: &Path, session: &Session) -> Result<Surroundings, Fault> {
    let config = Config::new(FileFlags::of(level, LightFlags::default()), &[])?;
    let inputs = read_inputs(&config, TextureNeeds::All)?;
    session.find(&inputs.findings);
    Ok(Surroundings::of(&inputs))
}

/// One row for each part of the volume.
fn csv_of(regions: &[Region]) -> String {
    let mut text = "x0,y0,z0,x1,y1,z1,nodes,nodes_valid,r,g,b,noise_median,noise_p95,noise_max,systematic_median,\
                    systematic_p95,systematic_max,coverage_min\n"
        .to_owned();
    for region in regions {
        let mut row: Vec<String> = [region.min, region.max].as_flattened().iter().map(f64::to_string).collect();
        row.extend([region.nodes, region.nodes_valid].map(|count| count.to_string()));
        row.extend(region.irradiance.map(|e| (e as f32).to_string()));
        for error in [&region.noise, &region.systematic] {
            match error {
                Some(error) => row.extend([error.median, error.p95, error.max].map(|e| (e as f32).to_string())),
                None => row.extend([const { String::new() }; 3]),
            }
        }
        row.push((region.coverage as f32).to_string());
        text += &row.join(",");
        text.push('\n');
    }
    text
}
