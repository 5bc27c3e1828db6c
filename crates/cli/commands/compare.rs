//! `gdibl compare`: error of a volume against another one, or against a reference.

use std::path::{Path, PathBuf};

use gdibl_baker::Finding;
use gdibl_baker::analyse::{
    Answer, CompareSettings, Comparison, Found, IrradianceError, NoiseUnknown, Truth, choose_sets, compare,
};
use gdibl_baker::import::reference::{is_json, parse_reference};
use gdibl_baker::job::records::SettingsRecord;
use gdibl_runtime::format::{self, MAGIC};
use gdibl_runtime::{Volume, VolumeSet};
use serde::Serialize;

use crate::fault::Fault;
use crate::report::page::{self, Shown};
use crate::report::{Inspected, WORST};
use crate::session::{Outcome, Session};
use crate::volumes::{VolumeList, is_list, set_of};

#[derive(clap::Args)]
pub struct Arguments {
    /// The volume to judge, or a list of volumes
    #[arg(value_name = "A")]
    found: PathBuf,
    /// What it should be: a volume, a list of volumes, or a JSON of places with their light (assets/uffizi-box/reference.json is one).
    /// The comparison is at its places
    #[arg(value_name = "B")]
    truth: PathBuf,
    /// Compare with this set of the JSON alone; repeatable [default: all sets of SH]
    #[arg(long = "set", value_name = "NAME")]
    sets: Vec<String>,
    /// End with exit code 5 when the relative RMSE of irradiance is over this (0.01 is 1 %)
    #[arg(long, value_name = "F")]
    tolerance: Option<f64>,
    /// Write a page to look at both: cameras move together, surfaces and slices show where they differ
    #[arg(short, long, value_name = "DIFF.html")]
    output: Option<PathBuf>,
    /// The level that the page shows: LEVEL.glb, LEVEL.gltf or BAKE.toml
    #[arg(long, value_name = "LEVEL", requires = "output")]
    level: Option<PathBuf>,
}

#[derive(Serialize)]
struct Report {
    found: String,
    truth: String,
    /// Nodes that rang were windowed in it.
    found_deringed: bool,
    truth_deringed: bool,
    #[serde(flatten)]
    comparison: Comparison,
    tolerance: Option<f64>,
    within_tolerance: Option<bool>,
}

/// A file of either kind.
pub struct Input {
    pub light: Kind,
    /// Of a volume.
    pub seed: Option<u64>,
    /// File name of the level that a volume was baked from; empty where it is not known.
    pub level: String,
    pub deringed: bool,
}

pub enum Kind {
    Volume(Box<Volume>),
    /// With the names of its volumes.
    Set(VolumeSet, Vec<String>),
    Reference(Vec<Truth>),
}

impl Input {
    /// Its sets that have one of these names.
    pub fn truths(self, sets: &[String], path: &Path) -> Result<Vec<Truth>, Fault> {
        let truths = match self.light {
            Kind::Volume(volume) => vec![Truth { level: self.level, ..Truth::of_volume(&volume) }],
            Kind::Set(set, names) => {
                let named = |(truth, name)| Truth { name, level: self.level.clone(), ..truth };
                Truth::of_set(&set).into_iter().zip(names).map(named).collect()
            }
            Kind::Reference(truths) => truths,
        };
        chosen(truths, sets, path)
    }
}

pub fn run(arguments: Arguments, session: &Session) -> Result<Outcome, Fault> {
    let Arguments { found: found_path, truth: truth_path, sets, tolerance, output, level: drawn } = &arguments;
    if let Some(tolerance) = tolerance.filter(|tolerance| !(*tolerance >= 0.0 && tolerance.is_finite())) {
        return Err(Fault::Usage(format!("--tolerance {tolerance}: must be a share, at least 0 (0.01 is 1 %)")));
    }
    let (found, truth) = (read(found_path)?, read(truth_path)?);
    let settings = CompareSettings { common_seed: found.seed.is_some() && found.seed == truth.seed };
    let (found_deringed, truth_deringed) = (found.deringed, truth.deringed);
    let level = found.level.clone();
    let found = match &found.light {
        Kind::Volume(volume) => Found::Volume(volume),
        Kind::Set(set, _) => Found::Set(set),
        Kind::Reference(_) => {
            return Err(Fault::Invalid(format!(
                "{}: is a reference; the volume comes first: gdibl compare VOLUME.gdibl REFERENCE.json",
                found_path.display()
            )));
        }
    };
    let truths = truth.truths(sets, truth_path)?;
    let comparison = compare(found, &truths, &settings)
        .map_err(|nothing| Fault::Invalid(format!("{}: {nothing}", found_path.display())))?;
    session.find(&other_levels(&found_path.display().to_string(), &level, &truths));
    let relative_rmse = comparison.all.relative_rmse;
    let within_tolerance = tolerance.map(|tolerance| relative_rmse <= tolerance);
    let [found, truth] = [found_path, truth_path].map(|path| path.display().to_string());
    let report =
        Report { found, truth, found_deringed, truth_deringed, comparison, tolerance: *tolerance, within_tolerance };
    if let Some(output) = output {
        write_page(output, [found_path, truth_path], drawn.as_deref(), &report, session)?;
    }
    let missed = tolerance.filter(|_| within_tolerance == Some(false)).map(|tolerance| {
        let (path, found) = (found_path.display(), percent(relative_rmse));
        format!("{path}: relative RMSE of irradiance is {found}, over --tolerance {tolerance}")
    });
    let text = text(&report);
    Ok(Outcome::new(report, text).missing(missed))
}

/// The page of two volumes. Everything is read before anything is written.
fn write_page(
    output: &Path,
    paths: [&PathBuf; 2],
    level: Option<&Path>,
    report: &Report,
    session: &Session,
) -> Result<(), Fault> {
    super::check_output(output)?;
    let mut shown = Vec::new();
    for path in paths {
        let bytes = super::read_volume_bytes(path)?;
        if is_json(&bytes) {
            let path = path.display();
            return Err(Fault::Usage(format!("{path}: is a reference, and a page shows two volumes: leave out -o")));
        }
        shown.push(Shown { inspected: Inspected::of(path, &bytes, WORST)?, bytes });
    }
    let surroundings =
        level.map(|level| super::inspect::surroundings_of(level, session)).transpose()?.unwrap_or_default();
    page::write(output, &shown, &surroundings, Some(report))
}

/// The file's first bytes tell what it is.
pub fn read(path: &Path) -> Result<Input, Fault> {
    let bytes = super::read_bytes(path)?;
    if is_list(&bytes) {
        return read_list(VolumeList::parse(path, &bytes)?, path);
    }
    if is_json(&bytes) {
        let light = Kind::Reference(parse_reference(path, &bytes)?);
        return Ok(Input { light, seed: None, level: String::new(), deringed: false });
    }
    if !bytes.starts_with(&MAGIC) {
        return Err(Fault::Invalid(format!(
            "{}: first bytes: found {:02x?}, expected a .gdibl volume or a reference JSON",
            path.display(),
            &bytes[..bytes.len().min(MAGIC.len())]
        )));
    }
    let volume = Volume::parse(&bytes).map_err(|error| super::volume_fault(path, &error))?;
    let settings = settings_of(&bytes, path)?;
    Ok(Input {
        deringed: volume.header().is_deringed(),
        light: Kind::Volume(Box::new(volume)),
        seed: settings.as_ref().map(|settings| settings.seed),
        level: settings.map(|settings| settings.level).unwrap_or_default(),
    })
}

fn settings_of(bytes: &[u8], path: &Path) -> Result<Option<SettingsRecord>, Fault> {
    let directory = format::parse_header_and_sections(bytes).map_err(|error| super::volume_fault(path, &error))?;
    super::record(&directory, path, format::SETTINGS)
}

/// The volumes of a list as one.
fn read_list(list: VolumeList, path: &Path) -> Result<Input, Fault> {
    let level = list.level.clone();
    let listings = list.open(path)?;
    let set = set_of(&listings, path)?;
    let seeds = listings.iter().map(|own| Ok(settings_of(&own.bytes, &own.path)?.map(|settings| settings.seed)));
    let seeds: Vec<Option<u64>> = seeds.collect::<Result<_, Fault>>()?;
    let deringed = set.volumes().any(|volume| volume.header().is_deringed());
    Ok(Input {
        deringed,
        light: Kind::Set(set, listings.into_iter().map(|own| own.entry.name).collect()),
        // Of different seeds none is that of all.
        seed: seeds[0].filter(|_| seeds.iter().all(|seed| *seed == seeds[0])),
        level,
    })
}

/// Truth of a level by another name than that of `who`: the difference is then that of the levels, too. Names are all
/// that both keep.
pub fn other_levels(who: &str, level: &str, truths: &[Truth]) -> Vec<Finding> {
    let differs = |truth: &&Truth| !level.is_empty() && !truth.level.is_empty() && truth.level != level;
    let said = |truth: &Truth| {
        let Truth { name, level: other, .. } = truth;
        let message =
            format!("{who} is of {level}, and '{name}' of {other}: the error holds what differs between the levels");
        Finding::new("other-level", 1, message)
    };
    truths.iter().filter(differs).map(said).collect()
}

fn chosen(truths: Vec<Truth>, names: &[String], path: &Path) -> Result<Vec<Truth>, Fault> {
    let there = truths.iter().map(|truth| truth.name.clone()).collect::<Vec<_>>().join(", ");
    choose_sets(truths, names)
        .map_err(|name| Fault::Usage(format!("--set {name}: {} has no such set; it has {there}", path.display())))
}

fn text(report: &Report) -> String {
    let Report { found, truth, comparison, .. } = report;
    let Comparison { all, places, .. } = comparison;
    let mut lines = vec![format!("{found} against {truth}")];
    let mut row = |name: &str, text: String| lines.push(format!("  {name:<11} {text}").trim_end().into());
    row("places", format!("{} of {} compared", places.compared, places.truth));
    for (count, why) in [
        (places.invalid, format!("left out: not valid in {truth}")),
        (places.outside, format!("left out: outside the box of {found}")),
        (places.not_held, format!("left out: not among the points or vertices of {found}")),
        (places.filled, format!("compared, but filled in {found} from its neighbours")),
    ] {
        if count > 0 {
            row("", format!("{count} {why}"));
        }
    }
    row("light", bands_text(comparison, found, truth));
    for (deringed, name) in [(report.found_deringed, found), (report.truth_deringed, truth)] {
        if deringed {
            row("", format!("{name} is de-ringed: not the raw projection"));
        }
    }
    row("error", error_text(all.relative_rmse, all.rmse, all.bias, all.mean_difference));
    for (name, of) in ["red", "green", "blue"].iter().zip(&all.channels) {
        row(name, error_text(of.relative_rmse, of.rmse, of.bias, of.mean_difference));
    }
    for of in &all.bands {
        row(
            &format!("band {}", of.band),
            format!("{} of irradiance, {} of radiance", percent(of.irradiance), percent(of.radiance)),
        );
    }
    match (all.noise, all.systematic, all.systematic_by_chance) {
        (Some(noise), Some(systematic), Some(chance)) => {
            row("noise", format!("{} expected from the standard errors of both", percent(noise)));
            row(
                "systematic",
                format!("{} beside the noise (chance gives up to {})", percent(systematic), percent(chance)),
            );
        }
        _ => row("noise", format!("not known: {}", noise_unknown_text(comparison, found, truth))),
    }
    row("per node", per_node_text(all));
    for (i, worst) in comparison.worst.iter().enumerate() {
        let [x, y, z] = worst.position;
        let place = format!("{} {} ({x:.3} {y:.3} {z:.3})", worst.set, worst.node);
        row(if i == 0 { "worst" } else { "" }, format!("{} at {place}", percent(worst.relative_error)));
    }
    for set in &comparison.sets {
        let how = match set.answer {
            Answer::SameNodes => "node against node",
            Answer::Interpolated => "interpolated",
            Answer::Held => "at places held",
        };
        let error = &set.error;
        let bias = error.bias * 100.0;
        row("set", format!("{}: {} places, {how}", set.name, error.nodes));
        if comparison.sets.len() > 1 {
            let noise = error.noise.map_or(String::new(), |noise| format!(", noise {}", percent(noise)));
            row("", format!("{} relative RMSE, bias {bias:+.2} %{noise}", percent(error.relative_rmse)));
            row("", per_node_text(error));
        }
    }
    lines.join("\n")
}

fn bands_text(comparison: &Comparison, found: &str, truth: &str) -> String {
    let bands = comparison.bands;
    match bands.truth {
        None => format!("irradiance at normals; {found} holds L{}", bands.found),
        Some(other) if other == bands.found => format!("radiance to L{other}"),
        Some(other) => {
            let lower = other.min(bands.found);
            format!("radiance to L{lower}: {found} holds L{}, {truth} L{other}, the lower counts", bands.found)
        }
    }
}

fn noise_unknown_text(comparison: &Comparison, found: &str, truth: &str) -> String {
    let reason = |reason: &NoiseUnknown| match reason {
        NoiseUnknown::Found => format!("{found} holds no standard errors"),
        NoiseUnknown::Truth => format!("{truth} holds no standard errors"),
        NoiseUnknown::CommonSeed => "both have the same --seed, so the same noise; bake one with another".into(),
    };
    comparison.noise_unknown.iter().map(reason).collect::<Vec<_>>().join("; ")
}

fn error_text(relative_rmse: f64, rmse: f64, bias: f64, mean_difference: f64) -> String {
    format!(
        "{} relative RMSE of E, bias {:+.2} % (RMSE {rmse:.3e}, mean difference {mean_difference:+.3e})",
        percent(relative_rmse),
        bias * 100.0
    )
}

fn per_node_text(error: &IrradianceError) -> String {
    let [median, p95, max] = [error.per_node.median, error.per_node.p95, error.per_node.max].map(percent);
    format!("{median} median, {p95} 95th percentile, {max} worst")
}

fn percent(share: f64) -> String {
    format!("{:.2} %", share * 100.0)
}
