//! `gdibl bake` of a level whose nodes place several volumes: a file each, and their list.

use std::path::Path;
use std::sync::atomic::Ordering;

use gdibl_baker::job::records::PlanRow;
use gdibl_baker::job::{Inputs, Method, Volumes, Wanted};
use gdibl_baker::pack::write_whole;
use serde::Serialize;

use super::baking::{
    Assembled, PlanReport, Report, assemble, bake, likely_seconds, plan_text, report_of, rows_text, tell_made,
};
use crate::captures::capture_missing;
use crate::config::{Config, file_name};
use crate::fault::Fault;
use crate::inputs::memory_of;
use crate::progress::Shown;
use crate::session::{Outcome, Session};
use crate::stages::Stages;
use crate::volumes::{Entry, VolumeList, list_path};

/// What the command line asks for.
pub struct Asked<'a> {
    /// Of the volumes that are to be baked; none: all.
    pub names: &'a [String],
    /// The plan alone.
    pub plan: bool,
    pub no_capture: bool,
    pub shown: Shown,
}

/// What `--json` prints of a level with several volumes.
#[derive(Serialize)]
struct SeveralReport {
    /// The list of all of the level's volumes.
    list: String,
    wall_seconds: f64,
    cpu_seconds: f64,
    /// Those that were baked, in its order.
    volumes: Vec<Named<Report>>,
}

/// What `--plan --json` prints of a level with several volumes.
#[derive(Serialize)]
struct SeveralPlans {
    list: String,
    volumes: Vec<Named<PlanReport>>,
}

/// A volume of a list, and what is said of it.
#[derive(Serialize)]
struct Named<T> {
    #[serde(flatten)]
    entry: Entry,
    #[serde(flatten)]
    of: T,
}

/// Bakes the volumes of a level, one after another. Files are written once all are baked, and the list last: where it is, they are.
pub fn run(
    asked: &Asked,
    config: &Config,
    inputs: Inputs,
    wanted: Vec<Wanted>,
    stages: &Stages,
    session: &Session,
) -> Result<Outcome, Fault> {
    let path = list_path(&config.output);
    let mut volumes = Volumes::prepare(inputs, wanted, memory_of(&config.settings))?;
    let list = VolumeList::of(file_name(&config.level), volumes.list());
    let chosen = chosen(&list, asked.names, &config.level)?;
    if asked.plan {
        let plans = plans_of(&mut volumes, &list, &chosen, stages, session)?;
        return Ok(plan_several(plans, path.display().to_string()));
    }
    session.find(&volumes.job(chosen[0]).inputs.findings);
    for volume in &chosen[1..] {
        volumes.job(*volume);
        session.find(volumes.own_findings());
    }
    let job = volumes.job(chosen[0]);
    job.inputs.check_light(job.method())?;
    chosen.iter().try_for_each(|volume| super::check_output(&path.with_file_name(&list.volumes[*volume].file)))?;
    super::check_output(&path)?;
    volumes.check_open(&session.cancel)?;
    let job = volumes.job(chosen[0]);
    if job.wants_capture() && !asked.no_capture {
        stages.next("capture");
        let read = job.inputs.findings.len();
        capture_missing(config, &mut job.inputs, &session.cancel, asked.shown)?;
        session.find(&job.inputs.findings[read..]);
    }

    let (mut all, mut missed) = (Vec::new(), None);
    for (turn, volume) in chosen.iter().enumerate() {
        let own_stages = (turn > 0).then(|| Stages::begin("read"));
        let stages = own_stages.as_ref().unwrap_or(stages);
        let job = volumes.job(*volume);
        let found = job.inputs.findings.len();
        let is_traced = job.method() == Method::Path;
        let output = path.with_file_name(&list.volumes[*volume].file);
        let config = Config { output, settings: job.settings.clone(), ..config.clone() };
        let made = bake(job, stages, session, asked.shown, None);
        let mut made = made.map_err(|stop| Fault::from(volumes.name_stop(*volume, stop)))?;
        let name = &list.volumes[*volume].name;
        let own_missed = tell_made(&mut made, found, &config, stages, session);
        missed = missed.or(own_missed.map(|text| format!("{name}: {text}")));
        all.push((assemble(made), config, is_traced, own_stages));
    }
    if session.cancel.load(Ordering::Relaxed) {
        return Err(Fault::Interrupted);
    }
    for (Assembled { packed, .. }, config, ..) in &all {
        write_whole(&config.output, &packed.bytes).map_err(Fault::from_writing)?;
    }
    write_whole(&path, &list.to_bytes()).map_err(Fault::from_writing)?;

    let (mut reports, mut texts) = (Vec::new(), Vec::new());
    for (volume, (assembled, config, is_traced, own_stages)) in chosen.into_iter().zip(all) {
        let (report, text) = report_of(assembled, &config, own_stages.as_ref().unwrap_or(stages), is_traced);
        texts.push(text);
        reports.push(Named { entry: list.volumes[volume].clone(), of: report });
    }
    let (wall_seconds, cpu_seconds) = stages.total();
    let report = SeveralReport { list: path.display().to_string(), wall_seconds, cpu_seconds, volumes: reports };
    let text = format!("{}\n{}: the list of them", texts.join("\n"), report.list);
    Ok(Outcome::new(report, text).missing(missed))
}

/// The places in the list of the volumes that are to be baked: all, or those of these names.
fn chosen(list: &VolumeList, names: &[String], level: &Path) -> Result<Vec<usize>, Fault> {
    let all = || list.volumes.iter().map(|entry| entry.name.as_str());
    if let Some(name) = names.iter().find(|name| all().all(|other| other != *name)) {
        let there: Vec<&str> = all().collect();
        let level = level.display();
        return Err(Fault::Usage(format!("--volume {name}: {level} has no such volume; it has {}", there.join(", "))));
    }
    let is_chosen = |name: &str| names.is_empty() || names.iter().any(|chosen| chosen == name);
    Ok(all().enumerate().filter(|(_, name)| is_chosen(name)).map(|(place, _)| place).collect())
}

fn plans_of(
    volumes: &mut Volumes,
    list: &VolumeList,
    chosen: &[usize],
    stages: &Stages,
    session: &Session,
) -> Result<Vec<Named<PlanReport>>, Fault> {
    let plan_of = |volume: &usize| {
        let job = volumes.job(*volume);
        let (plan, likely_seconds) = (job.plan(), likely_seconds(job, stages, session)?);
        Ok(Named { entry: list.volumes[*volume].clone(), of: PlanReport { plan, likely_seconds } })
    };
    chosen.iter().map(plan_of).collect()
}

/// A row for each volume, then what will be done for all alike, and then what for each.
fn plan_several(plans: Vec<Named<PlanReport>>, path: String) -> Outcome {
    let is_common = |row: &PlanRow| plans.iter().all(|plan| plan.of.plan.contains(row));
    let head = |Named { entry, of }: &Named<PlanReport>| {
        let [x, y, z] = [0, 1, 2].map(|k| entry.max[k] - entry.min[k]);
        let nodes = of.plan.iter().find(|row| row.stage == "nodes").map_or("", |row| &row.why);
        PlanRow::new(&format!("'{}'", entry.name), true, format!("{x:.3} x {y:.3} x {z:.3} m, {nodes}"))
    };
    let mut rows: Vec<PlanRow> = plans.iter().map(head).collect();
    rows.extend(plans[0].of.plan.iter().filter(|row| is_common(row)).cloned());
    let mut text = rows_text(&rows);
    for Named { entry, of } in &plans {
        let own: Vec<PlanRow> = of.plan.iter().filter(|row| !is_common(row)).cloned().collect();
        text += &format!("\n\n'{}', to {}\n{}", entry.name, entry.file, plan_text(&own, of.likely_seconds));
    }
    Outcome::new(SeveralPlans { list: path, volumes: plans }, text)
}
