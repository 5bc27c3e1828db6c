//! The volumes of a level whose nodes place several boxes: a job each, over one level that is there once.
//!
//! They are baked one after another. Each is the same, byte by byte, whether others are baked beside it or not.

use std::cell::LazyCell;
use std::sync::atomic::AtomicBool;

use super::settings::{GridSettings, ROWS, Row, Settings};
use super::stop::Stop;
use super::text::NodeKind;
use super::{Inputs, Job, Memory, Own, prepare_light};
use crate::bake::{Nodes, Shells, any_open, widest_spacing};
use crate::radiance::path::{Path, PathSettings};
use crate::scene::{Scene, VolumeMarker};

/// A box that a node places, and the settings of its volume.
#[derive(Debug, Clone)]
pub struct Wanted {
    /// The box.
    pub marker: VolumeMarker,
    /// With those of the node.
    pub settings: Settings,
}

/// A volume of a list: what an engine has to know of it beside its file.
#[derive(Debug, Clone, PartialEq)]
pub struct Listed {
    /// Name of the node, and of the file without its ending.
    pub name: String,
    /// Lowest corner of the box, metres.
    pub min: [f64; 3],
    /// Highest corner.
    pub max: [f64; 3],
    /// Greatest distance between neighbours of its (finest) grid, metres.
    pub spacing: f64,
}

/// The boxes that the nodes of a level place, in its order; none where the settings give a box or want no grid. `is_given`: a
/// setting was given for this very run, and wins over those of nodes.
///
/// # Errors
/// A property of a node is no setting of a volume, or makes no sense.
pub fn wanted_of(
    scene: &Scene,
    settings: &Settings,
    is_given: impl Fn(&Row) -> bool,
    level: &str,
) -> Result<Vec<Wanted>, Stop> {
    if settings.grid.bounds.is_some() || settings.grid.nodes != NodeKind::Grid {
        return Ok(Vec::new());
    }
    let wanted = |marker: &VolumeMarker| {
        let mut own = settings.clone();
        for (name, text) in &marker.settings {
            let wrong =
                |why: &str| Stop::Invalid(format!("{level}: {}: extras.gdibl_{name} = {text}: {why}", marker.node));
            let row = ROWS.iter().find(|row| row.name == *name && row.is_of_volumes());
            let row = row.ok_or_else(|| wrong(&no_setting(name)))?;
            let mut changed = own.clone();
            changed.set(row.section, row.name, &[text]).map_err(|why| wrong(&why))?;
            changed.check().map_err(|out| wrong(&format!("found {}", out.message)))?;
            if !is_given(row) {
                own = changed;
            }
        }
        Ok(Wanted { marker: marker.clone(), settings: own })
    };
    scene.volume_markers.iter().map(wanted).collect()
}

/// Why a property is no setting of a volume.
fn no_setting(name: &str) -> String {
    match name {
        "bounds" => "the box is that of the node".into(),
        "spacing" | "max_nodes" | "max_bytes" | "budget" => "the spacing is the value of gdibl_volume".into(),
        name if ROWS.iter().any(|row| row.name == name) => {
            "this belongs to the whole level: give it as a flag, or in BAKE.toml".into()
        }
        _ => {
            let names: Vec<&str> = ROWS.iter().filter(|row| row.is_of_volumes()).map(|row| row.name).collect();
            format!("no setting of a volume is called that; there are {}", names.join(", "))
        }
    }
}

/// The volumes of a level, the finest first.
#[derive(Debug)]
pub struct Volumes {
    /// That of the volume `current`.
    job: Job,
    current: usize,
    volumes: Vec<Listed>,
    /// Nodes as messages call them.
    labels: Vec<String>,
    /// Of all volumes but the current one, whose place holds nothing.
    waiting: Vec<Option<Own>>,
    /// Where the findings of the current volume are among those of the inputs.
    own_findings: std::ops::Range<usize>,
}

impl Volumes {
    /// Prepares a job for each volume: see [`Job::prepare`]. At least one is wanted.
    ///
    /// # Errors
    /// What makes no sense, before anything long has begun; also of names and boxes beside each other.
    pub fn prepare(mut inputs: Inputs, wanted: Vec<Wanted>, memory: Memory) -> Result<Volumes, Stop> {
        assert!(!wanted.is_empty(), "no volume is wanted");
        let is_bounded =
            |grid: &GridSettings| grid.max_nodes.is_some() || grid.max_bytes.is_some() || grid.budget.is_some();
        if wanted.iter().any(|wanted| is_bounded(&wanted.settings.grid)) {
            let why = "--max-nodes, --max-bytes and --budget choose a spacing, and the nodes' gdibl_volume says it: leave them \
                       out, or choose a box with --bounds";
            return Err(Stop::Usage(format!("{}: {why}", inputs.level)));
        }
        check_names(&wanted).and_then(|()| check_boxes(&wanted)).map_err(|why| {
            let level = &inputs.level;
            Stop::Invalid(format!("{level}: {why}"))
        })?;
        let light = prepare_light(&mut inputs, &wanted[0].settings)?;
        let scene = &inputs.scene;
        let shells = LazyCell::new(|| Shells::of(scene));
        let mut all = Vec::new();
        for Wanted { marker, settings } in wanted {
            let own = Own::place(&inputs, settings, std::slice::from_ref(&marker), &shells, memory);
            let own = own.map_err(|stop| of_volume(stop, &marker.node))?;
            all.push((listed(&marker, &own.nodes), marker.node, own));
        }
        // Stable: those of one spacing stay in the level's order.
        all.sort_by(|a, b| a.0.spacing.total_cmp(&b.0.spacing));
        let (mut volumes, mut labels, mut waiting) = (Vec::new(), Vec::new(), Vec::new());
        for (listed, label, own) in all {
            volumes.push(listed);
            labels.push(label);
            waiting.push(Some(own));
        }
        let first = waiting[0].take().expect("it was just put there");
        let own_findings = inputs.findings.len()..inputs.findings.len() + first.findings.len();
        let job = Job::of(inputs, light, first, memory);
        Ok(Volumes { job, current: 0, volumes, labels, waiting, own_findings })
    }

    /// What each is, in the order of the list.
    pub fn list(&self) -> &[Listed] {
        &self.volumes
    }

    /// The job of a volume. What is changed in its inputs changes in those of all.
    pub fn job(&mut self, volume: usize) -> &mut Job {
        if volume != self.current {
            let next = self.waiting[volume].take().expect("only the current one is elsewhere");
            let Own { settings, nodes, is_open, bounds, sealed, findings } = next;
            let job = &mut self.job;
            let end = self.own_findings.start + findings.len();
            let last = Own {
                settings: std::mem::replace(&mut job.settings, settings),
                nodes: std::mem::replace(&mut job.nodes, nodes),
                is_open: std::mem::replace(&mut job.is_open, is_open),
                bounds: std::mem::replace(&mut job.bounds, bounds),
                sealed: std::mem::replace(&mut job.sealed, sealed),
                findings: job.inputs.findings.splice(self.own_findings.clone(), findings).collect(),
            };
            self.own_findings.end = end;
            self.waiting[self.current] = Some(last);
            self.current = volume;
        }
        &mut self.job
    }

    /// The findings of the current volume alone.
    pub fn own_findings(&self) -> &[crate::Finding] {
        &self.job.inputs.findings[self.own_findings.clone()]
    }

    /// A volume without a node in the open is refused before the first is baked.
    ///
    /// # Errors
    /// The volume's node, or the caller cancelled.
    pub fn check_open(&mut self, cancel: &AtomicBool) -> Result<(), Stop> {
        for volume in 0..self.volumes.len() {
            self.job(volume);
            let Job { inputs, nodes, .. } = &self.job;
            let function = Path::sharing(&inputs.trees, &inputs.scene, None, PathSettings::default());
            if !any_open(nodes, &function, cancel)? {
                let message = "no node in the box of its gdibl_volume is in the open: all stand in solids, or behind the \
                               level's surfaces; move or enlarge it";
                let message = format!("{}: {}: {message}", inputs.level, self.labels[volume]);
                return Err(Stop::Invalid(message));
            }
        }
        Ok(())
    }

    /// Says of which volume an error is.
    pub fn name_stop(&self, volume: usize, stop: Stop) -> Stop {
        of_volume(stop, &self.labels[volume])
    }
}

/// What stopped the job of one volume, with its node in front.
fn of_volume(stop: Stop, node: &str) -> Stop {
    let named = |message: String| format!("{node}: {message}");
    match stop {
        Stop::Usage(message) => Stop::Usage(named(message)),
        Stop::Invalid(message) => Stop::Invalid(named(message)),
        Stop::Memory(message) => Stop::Memory(named(message)),
        Stop::Nothing(message) => Stop::Nothing(named(message)),
        Stop::Interrupted => Stop::Interrupted,
    }
}

fn listed(marker: &VolumeMarker, nodes: &Nodes) -> Listed {
    let (min, max) = marker.bounds();
    let spacing = match nodes {
        Nodes::Grid(grid) => widest_spacing(grid),
        _ => 0.0,
    };
    // One node has no neighbour.
    let spacing = if spacing > 0.0 { spacing } else { marker.spacing };
    Listed { name: marker.name.clone(), min: min.to_array(), max: max.to_array(), spacing }
}

/// Bytes of a name: with an ending it fits into every file system.
const LONGEST_NAME: usize = 200;

/// Names are those of files, on every system, and no two are the same.
fn check_names(wanted: &[Wanted]) -> Result<(), String> {
    for (index, Wanted { marker, .. }) in wanted.iter().enumerate() {
        let VolumeMarker { name, node, .. } = marker;
        if let Some(why) = no_file_name(name) {
            return Err(format!("{node}: a volume's file has the name of its node, and {why}; rename the node"));
        }
        // Two files to one system may be one to another.
        let is_same = |other: &&Wanted| other.marker.name.to_lowercase() == name.to_lowercase();
        if let Some(other) = wanted[..index].iter().find(is_same) {
            let (other, other_name) = (&other.marker.node, &other.marker.name);
            return Err(format!(
                "{other} and {node}: two volumes are called '{other_name}' and '{name}', and each writes a file of its name \
                 (capitals do not count); rename one"
            ));
        }
    }
    Ok(())
}

/// Why a name cannot be that of a file.
fn no_file_name(name: &str) -> Option<String> {
    const DEVICES: [&str; 4] = ["con", "prn", "aux", "nul"];
    const PORTS: [&str; 2] = ["com", "lpt"];
    let stem = name.split('.').next().unwrap_or_default().trim_end().to_ascii_lowercase();
    let is_port = PORTS.iter().filter_map(|port| stem.strip_prefix(port)).any(|number| {
        let mut digits = number.chars();
        digits.next().is_some_and(|digit| matches!(digit, '0'..='9' | '¹' | '²' | '³')) && digits.next().is_none()
    });
    let odd = name.chars().find(|c| c.is_control() || r#"/\:*?"<>|"#.contains(*c));
    match () {
        () if name.is_empty() => Some("it has none".into()),
        () if odd.is_some() => Some(format!("'{}' holds {:?}", name.escape_debug(), odd.unwrap_or_default())),
        () if name.starts_with([' ', '.']) || name.ends_with([' ', '.']) => {
            Some(format!("'{name}' begins or ends with a space or a dot"))
        }
        () if DEVICES.contains(&&*stem) || is_port => Some(format!("'{name}' is a device on Windows")),
        () if name.len() > LONGEST_NAME => Some(format!("it is longer than {LONGEST_NAME} bytes")),
        () => None,
    }
}

/// Of two volumes with one box the second would never be read.
fn check_boxes(wanted: &[Wanted]) -> Result<(), String> {
    for (index, Wanted { marker, .. }) in wanted.iter().enumerate() {
        if let Some(other) = wanted[..index].iter().find(|other| other.marker.bounds() == marker.bounds()) {
            let (other, node) = (&other.marker.node, &marker.node);
            return Err(format!(
                "{other} and {node}: two volumes have the same box, so one of them would never be read; remove one"
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_files_on_every_system() {
        for name in ["hall", "Volume.001", "Diele (oben)", "控制室", "console", "com", "com10"] {
            assert_eq!(no_file_name(name), None, "{name}");
        }
        let long = "x".repeat(LONGEST_NAME + 1);
        let odd = [
            "",
            ".",
            "..",
            ".hall",
            "hall.",
            " hall",
            "hall ",
            "a/b",
            "a\\b",
            "c:",
            "a*",
            "why?",
            "a\"",
            "<",
            "a|b",
            "a\nb",
            "con",
            "NUL",
            "Com1",
            "lpt9.txt",
            "aux.gdibl",
            &long,
        ];
        for name in odd {
            assert!(no_file_name(name).is_some(), "{name:?}");
        }
    }
}
