//! `gdibl bake` of a level whose nodes place several volumes: a file each, and their list.

use std::path::Path;
use std::sync::atomic::Ordering;

use gdibl_baker::job::records::PlanRow;
use gdibl_baker::job::{Inputs, Method, Volumes, Wanted};
use gdibl_baker::pack::write_whole;
use serde::Serialize;

use super::baking::{
    self, Assembled, PlanReport, Report, assemble, likely_seconds, plan_text, report_of, rows_text, tell_made,
};
use super::unchanged::{UNCHANGED, Unchanged, unchanged};
use crate::captures::capture_missing;
use crate::config::{Config, file_name};
use crate::fault::Fault;
use crate::inputs::memory_of;
use crate::journal::{Head, Journal, remove_stale};
use crate::progress::Shown;
use crate::request::Request;
use crate::session::{Outcome, Session};
use crate::stages::Stages;
use crate::volumes::{Entry, VolumeList, list_path};

/// What the command line asks for.
pub struct Asked<'a> {
    /// Of the volumes that are to be baked; none: all.
    pub names: &'a [String],
    pub no_capture: bool,
    /// Also what is there.
    pub force: bool,
}

/// What `--json` prints of a level with several volumes.
#[derive(Serialize)]
struct SeveralReport {
    /// The list of all of the level's volumes.
    list: String,
    wall_seconds: f64,
    cpu_seconds: f64,
    /// Those that were to be baked, in its order.
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

/// The bake that finds several volumes.
pub struct Bake<'a> {
    pub config: &'a Config,
    pub stages: &'a Stages,
    pub session: &'a Session,
    pub shown: Shown,
}

/// Prepares all volumes; with their list, and which of it are to be baked.
fn prepare(
    names: &[String],
    config: &Config,
    inputs: Inputs,
    wanted: Vec<Wanted>,
) -> Result<(Volumes, VolumeList, Vec<usize>), Fault> {
    let volumes = Volumes::prepare(inputs, wanted, memory_of(&config.settings))?;
    let list = VolumeList::of(file_name(&config.level), volumes.list());
    let chosen = chosen(&list, names, &config.level)?;
    Ok((volumes, list, chosen))
}

/// What would be done.
pub fn plan(asked: &Asked, bake: &Bake, inputs: Inputs, wanted: Vec<Wanted>) -> Result<Outcome, Fault> {
    let Bake { config, stages, session, .. } = *bake;
    let (mut volumes, list, chosen) = prepare(asked.names, config, inputs, wanted)?;
    let plans = plans_of(&mut volumes, &list, &chosen, stages, session)?;
    Ok(plan_several(plans, list_path(&config.output).display().to_string()))
}

/// A volume that was baked, and how.
struct Baked {
    assembled: Assembled,
    config: Config,
    is_traced: bool,
    stages: Option<Stages>,
    /// What it would go on from if it were not written.
    journal: Journal,
}

/// Bakes the volumes of a level, one after another, but for those that are there. Files are written once all are baked, and the list
/// last: where it is, they are. `head` is that of the whole bake.
pub fn run(asked: &Asked, bake: &Bake, inputs: Inputs, wanted: Vec<Wanted>, head: &Head) -> Result<Outcome, Fault> {
    let Bake { config, stages, session, .. } = *bake;
    let path = list_path(&config.output);
    let (mut volumes, list, chosen) = prepare(asked.names, config, inputs, wanted)?;
    let mut request_of =
        |volume: usize| head.request.of_volume(&list.volumes[volume].name, &volumes.job(volume).settings);
    let heads: Vec<Head> = chosen.iter().map(|volume| Head { request: request_of(*volume), ..head.clone() }).collect();
    let mut own_config = |volume: usize| Config {
        output: path.with_file_name(&list.volumes[volume].file),
        settings: volumes.job(volume).settings.clone(),
        ..config.clone()
    };
    let configs: Vec<Config> = chosen.iter().map(|volume| own_config(*volume)).collect();

    let is_listed = std::fs::read(&path).is_ok_and(|found| found == list.to_bytes());
    let there: Vec<Option<Unchanged>> = configs
        .iter()
        .zip(&heads)
        .map(|(config, head)| (!asked.force).then(|| unchanged(config, &head.request, stages, session)).flatten())
        .collect();
    let name_of = |turn: usize| &list.volumes[chosen[turn]].name;
    let missed_before = there.iter().enumerate().find_map(|(turn, there)| {
        let text = there.as_ref()?.missed.as_ref()?;
        Some(format!("{}: {text}", name_of(turn)))
    });
    configs
        .iter()
        .zip(&there)
        .filter(|(_, there)| there.is_some())
        .for_each(|(config, _)| remove_stale(&config.output));
    let turns: Vec<usize> = (0..chosen.len()).filter(|turn| there[*turn].is_none()).collect();
    let (all, missed) = match turns.is_empty() {
        true => (Vec::new(), None),
        false => bake_all(
            asked,
            bake,
            &mut volumes,
            &list,
            &turns.iter().map(|t| (chosen[*t], &heads[*t], &configs[*t])).collect::<Vec<_>>(),
        )?,
    };
    if session.cancel.load(Ordering::Relaxed) {
        return Err(Fault::Interrupted);
    }
    for Baked { assembled, config, .. } in &all {
        write_whole(&config.output, &assembled.packed.bytes).map_err(Fault::from_writing)?;
    }
    if !is_listed {
        write_whole(&path, &list.to_bytes()).map_err(Fault::from_writing)?;
    }
    let is_unchanged = all.is_empty();

    let (mut reports, mut texts) = (Vec::new(), Vec::new());
    let mut all = all.into_iter();
    for (turn, there) in there.into_iter().enumerate() {
        let (report, text) = match there {
            Some(Unchanged { report, .. }) => {
                let text = format!("{}: {UNCHANGED}", report.output);
                (report, text)
            }
            None => {
                let Baked { assembled, config, is_traced, stages: own, journal } = all.next().expect("it was baked");
                journal.remove()?;
                report_of(assembled, &config, own.as_ref().unwrap_or(stages), is_traced)
            }
        };
        texts.push(text);
        reports.push(Named { entry: list.volumes[chosen[turn]].clone(), of: report });
    }
    let (wall_seconds, cpu_seconds) = stages.total();
    let report = SeveralReport { list: path.display().to_string(), wall_seconds, cpu_seconds, volumes: reports };
    let text = match is_unchanged {
        true => format!("{}: {} volumes {UNCHANGED}", report.list, texts.len()),
        false => format!("{}\n{}: the list of them", texts.join("\n"), report.list),
    };
    Ok(Outcome::new(report, text).missing(missed_before.or(missed)))
}

/// Bakes these volumes of the list, each by its head and its settings. Also which bound was missed first, if one was.
fn bake_all(
    asked: &Asked,
    bake: &Bake,
    volumes: &mut Volumes,
    list: &VolumeList,
    turns: &[(usize, &Head, &Config)],
) -> Result<(Vec<Baked>, Option<String>), Fault> {
    let Bake { config, stages, session, shown } = *bake;
    let first = turns[0].0;
    session.find(&volumes.job(first).inputs.findings);
    for (volume, ..) in &turns[1..] {
        volumes.job(*volume);
        session.find(volumes.own_findings());
    }
    let job = volumes.job(first);
    job.inputs.check_light(job.method())?;
    turns.iter().try_for_each(|(_, _, config)| super::check_output(&config.output))?;
    super::check_output(&list_path(&config.output))?;
    volumes.check_open(&session.cancel)?;
    let job = volumes.job(first);
    if job.wants_capture() && !asked.no_capture {
        stages.next("capture");
        let read = job.inputs.findings.len();
        capture_missing(config, &mut job.inputs, &session.cancel, shown)?;
        session.find(&job.inputs.findings[read..]);
    }
    let is_repeatable = Request::is_repeatable(config);
    let (mut all, mut missed) = (Vec::new(), None);
    for (turn, (volume, head, own)) in turns.iter().enumerate() {
        let own_stages = (turn > 0).then(|| Stages::begin("read"));
        let stages = own_stages.as_ref().unwrap_or(stages);
        let journal = Journal::open(&own.output, head, is_repeatable, &session.cancel)?;
        let job = volumes.job(*volume);
        job.inputs.request = if is_repeatable { head.request.key() } else { [0; 32] };
        let found = job.inputs.findings.len();
        let is_traced = job.method() == Method::Path;
        let made = baking::bake(job, stages, session, shown, Some(&journal));
        let made = made.map_err(|stop| Fault::from(volumes.name_stop(*volume, stop)));
        let mut made = match made {
            Ok(made) => made,
            // What was stopped goes on later; what cannot be baked never will.
            Err(fault @ (Fault::Interrupted | Fault::System(_))) => return Err(fault),
            Err(fault) => {
                let mut journals = all.into_iter().map(|baked: Baked| baked.journal).chain([journal]);
                journals.try_for_each(Journal::remove)?;
                return Err(fault);
            }
        };
        let own_missed = tell_made(&mut made, found, own, stages, session);
        let name = &list.volumes[*volume].name;
        missed = missed.or(own_missed.map(|text| format!("{name}: {text}")));
        let (assembled, config) = (assemble(made), Config::clone(own));
        all.push(Baked { assembled, config, is_traced, stages: own_stages, journal });
    }
    Ok((all, missed))
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
