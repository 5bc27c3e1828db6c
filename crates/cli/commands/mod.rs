//! One file per verb, and what they share.

pub mod assemble;
pub mod bake;
mod baking;
pub mod capture;
pub mod compare;
pub mod cut;
pub mod export;
pub mod inspect;
pub mod probes;
pub mod render;
pub mod sample;
mod several;
pub mod study;
mod unchanged;

use gdibl_baker::job::records::{
    DeringingRecord, ErrorSummary, PackingRecord, QuarterRecord, Record, SeenErrors, SeenRecord, SeenSet, SparseLevel,
    SparseRecord, StageRecord, StandingRecord, StatisticsRecord, SunRecord, WallsRecord, decode,
};
use gdibl_runtime::format::{Directory, Limits};
use std::path::Path;

use crate::fault::Fault;
use crate::volumes::{VolumeList, is_list};

/// An output that cannot be written is found out before hours of work.
pub fn check_output(output: &Path) -> Result<(), Fault> {
    if output.is_dir() {
        return Err(Fault::Usage(format!("{}: is a folder; name a file", output.display())));
    }
    let folder = output.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let probe = tempfile::Builder::new().prefix(".gdibl-").suffix(".tmp").tempfile_in(folder);
    probe.map(drop).map_err(|error| Fault::writing(output, &error))
}

/// The bytes of a volume, or of a list of volumes.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>, Fault> {
    std::fs::read(path).map_err(|error| Fault::reading(path, &error))
}

/// The bytes of a volume, for a verb that takes one. A list is refused with the files that it names.
pub fn read_volume_bytes(path: &Path) -> Result<Vec<u8>, Fault> {
    let bytes = read_bytes(path)?;
    if is_list(&bytes) {
        let list = VolumeList::parse(path, &bytes)?;
        let files: Vec<&str> = list.volumes.iter().map(|entry| entry.file.as_str()).collect();
        let path = path.display();
        return Err(Fault::Usage(format!("{path}: is a list of volumes; give one of them: {}", files.join(", "))));
    }
    Ok(bytes)
}

/// What the runtime said of a file, as an exit code.
pub fn volume_fault(path: &Path, error: &gdibl_runtime::Error) -> Fault {
    Fault::of_volume(path, error)
}

/// A small record of a volume; `None` where it holds none.
pub fn record<T: Record>(directory: &Directory, path: &Path, id: [u8; 4]) -> Result<Option<T>, Fault> {
    let bytes = directory.section_bytes(id, &Limits::default()).map_err(|error| volume_fault(path, &error))?;
    let name = String::from_utf8_lossy(&id);
    bytes.map(|bytes| decode(&bytes, path, &name)).transpose().map_err(Fault::from)
}

/// Where the nodes stand that have no light of their own, or have it from a place beside; and walls between nodes.
pub fn standing_text(standing: &StandingRecord, walls: Option<&WallsRecord>) -> String {
    let StandingRecord { uncovered, solid, outside, moved } = standing;
    let walls = match walls {
        Some(WallsRecord { cells, planes }) => format!("{cells} cells with walls, cut by {planes} planes"),
        None => "no wall between nodes".into(),
    };
    format!("{solid} in solids, {outside} outside, {uncovered} that no probe covers; {moved} stepped aside; {walls}")
}

/// The cells of a sparse grid, and how right light is between nodes, in words.
pub fn sparse_lines(sparse: &SparseRecord) -> Vec<String> {
    let rows = sparse.levels.iter().enumerate().filter(|(_, level)| level.cells > 0 || level.checked > 0);
    let text = |(level, row): (usize, &SparseLevel)| {
        let error = row.error.map_or("not checked".into(), |error| {
            let [median, p95] = [error.median, error.p95].map(|e| e * 100.0);
            format!("off by {median:.2} % median, {p95:.2} % 95th percentile at {} places between nodes", row.checked)
        });
        format!("{} cells {} wide, {error}", row.cells, 1 << level)
    };
    rows.map(text).collect()
}

/// The error that people see, in words: its name and a line each.
pub fn seen_lines(seen: &SeenRecord) -> Vec<(&'static str, String)> {
    let sets = [("seen", "in the air", &seen.air), ("", "on surfaces", &seen.surfaces)];
    let known = sets.into_iter().filter_map(|(name, place, set)| set.as_ref().map(|set| (name, place, set)));
    known
        .flat_map(|(name, place, set)| seen_set_lines(place, set).into_iter().zip([name, ""]))
        .map(|(l, n)| (n, l))
        .collect()
}

fn seen_set_lines(place: &str, set: &SeenSet) -> [String; 2] {
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let SeenErrors { median, p95, p99, max } = set.error;
    let [x, y, z] = set.worst;
    let parts = &set.parts;
    let systematic = match parts.systematic {
        0.0 => String::new(),
        share => format!(", and beside it bias {}", percent(share)),
    };
    [
        format!(
            "{place}, {} places: {} median, {} 95th percentile, {} 99th, {} worst at {x:.2} {y:.2} {z:.2}",
            set.places,
            percent(median),
            percent(p95),
            percent(p99),
            percent(max)
        ),
        format!(
            "  of it noise {}, between nodes {}, bands {}, numbers {} (root mean squares){systematic}; relative to at \
             least 18 % of the mean: {} median, {} 95th percentile",
            percent(parts.noise),
            percent(parts.between),
            percent(parts.bands),
            percent(parts.packing),
            percent(set.error_in_grey.median),
            percent(set.error_in_grey.p95),
        ),
    ]
}

/// The sun that an engine adds, in words.
pub fn sun_text(sun: &SunRecord) -> String {
    let SunRecord { direction: [x, y, z], irradiance: [r, g, b], angular_diameter_degrees: diameter } = sun;
    format!(
        "left out: toward {x:.4} {y:.4} {z:.4}, irradiance {r:.4} {g:.4} {b:.4} on a surface facing it, {diameter:.2}° wide"
    )
}

/// What packing did, in words.
pub fn packing_text(packing: &PackingRecord) -> String {
    let PackingRecord { step, added_error } = packing;
    let [median, p95, max] = [added_error.median, added_error.p95, added_error.max].map(|e| e * 100.0);
    format!(
        "{median:.2} % median, {p95:.2} % 95th percentile, {max:.2} % worst added to the error of E, by steps of {step:.5}"
    )
}

/// What de-ringing did, in words.
pub fn deringing_text(deringing: &DeringingRecord) -> String {
    let [median, max] = [deringing.relative_change.median, deringing.relative_change.max].map(|e| e * 100.0);
    format!("{} nodes; their irradiance changed by {median:.2} % median, {max:.2} % worst node", deringing.nodes)
}

/// What each stage took, in words.
pub fn stages_text(stages: &[StageRecord]) -> String {
    let text = |stage: &StageRecord| match stage.seconds {
        Some(seconds) => format!("{} {:.2} s", stage.stage, seconds.wall),
        None => format!("{} {:.1} M rays", stage.stage, stage.rays as f64 / 1e6),
    };
    stages.iter().map(text).collect::<Vec<_>>().join(", ")
}

/// Noise of the bake, in words.
fn noise_text(statistics: &StatisticsRecord) -> String {
    match &statistics.relative_error {
        Some(error) => format!("{} (standard error of irradiance)", summary_text(error)),
        None => "not measured: that takes at least two samples per node".into(),
    }
}

/// What more directions do not take away, in words; nothing where nothing tells.
pub fn systematic_text(statistics: &StatisticsRecord) -> Option<String> {
    let error = statistics.systematic_error.filter(|error| error.max > 0.0)?;
    Some(format!("{} (beside noise: what probes show wrongly, and what nobody sees)", summary_text(&error)))
}

/// The median node's error on the way, in words, and whether more directions would help; nothing where nothing tells.
pub fn quarter_lines(statistics: &StatisticsRecord) -> Vec<String> {
    let [_, half, _, all] = &statistics.quarters[..] else { return Vec::new() };
    let percent = |error: f64| format!("{:.2} %", error * 100.0);
    let text = |(quarter, name): (&QuarterRecord, &str)| {
        let time = quarter.seconds.as_ref().map_or_else(String::new, |seconds| format!(" ({:.1} s)", seconds.wall));
        format!("{} with {name}{time}", percent(quarter.whole))
    };
    let names = ["1/4 of the directions", "1/2", "3/4", "all"];
    let way = statistics.quarters.iter().zip(names).map(text).collect::<Vec<_>>().join(", ");
    // Noise falls again as it fell from half of the directions to all; what is left of the whole does not.
    let left = (all.whole.powi(2) - all.noise.powi(2)).max(0.0).sqrt();
    let next = (all.noise * (all.noise / half.noise).min(1.0)).hypot(left);
    let time = match (&half.seconds, &all.seconds) {
        (Some(half), Some(all)) => format!(" ({:.1} s)", all.wall + 2.0 * (all.wall - half.wall)),
        _ => String::new(),
    };
    let mut verdict = match next > 0.9 * all.whole {
        true => format!("more directions hardly help: {} would be left with twice as many{time}", percent(next)),
        false => format!("twice as many directions would leave about {}{time}", percent(next)),
    };
    let sets = statistics.seen.iter().flat_map(|seen| [seen.air, seen.surfaces]).flatten();
    let between = sets.map(|set| set.parts.between).fold(0.0, f64::max);
    if between > 2.0 * all.noise {
        verdict += &format!(
            "; light between nodes is off by {} (root mean square): closer nodes (--spacing) help more",
            percent(between)
        );
    }
    vec![format!("median node off by {way}"), verdict]
}

fn summary_text(error: &ErrorSummary) -> String {
    let [median, p95, max] = [error.median, error.p95, error.max].map(|e| e * 100.0);
    format!("{median:.2} % median, {p95:.2} % 95th percentile, {max:.2} % worst node")
}
