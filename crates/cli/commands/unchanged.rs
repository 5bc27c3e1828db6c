//! What is there already, of the same inputs, settings and program: it is not made again.

use gdibl_baker::job::records::{ErrorSummary, SettingsRecord, StatisticsRecord};
use gdibl_baker::pack::Precision;
use gdibl_runtime::format::{self, Limits, SectionEntry};

use super::baking::{Report, ShardReport, seen_text};
use crate::config::Config;
use crate::journal::{Shard, scan};
use crate::request::{PRECISION, Request};
use crate::session::{Outcome, Session};
use crate::stages::Stages;

/// A volume that is there.
pub struct Unchanged {
    pub report: Report,
    /// A bound that it misses, as it did when it was baked.
    pub missed: Option<String>,
}

/// Said of files to which nothing was done.
pub const UNCHANGED: &str =
    "unchanged: inputs, settings and program are those that it was baked by; --force bakes it again";

impl From<Unchanged> for Outcome {
    fn from(Unchanged { report, missed }: Unchanged) -> Outcome {
        let text = format!("{}: {UNCHANGED}", report.output);
        Outcome::new(report, text).missing(missed)
    }
}

/// The shard is there already, whole.
pub fn unchanged_shard(config: &Config, request: &Request, shard: Shard, stages: &Stages) -> Option<Outcome> {
    let mut file = config.output.is_file().then(|| std::fs::File::open(&config.output).ok())??;
    let found = scan(&mut file).ok().filter(|found| found.is_whole)?;
    if found.head.request != *request || found.head.shard != Some(shard) {
        return None;
    }
    let output = config.output.display().to_string();
    let text = format!("{output}: unchanged: it is shard {shard} of this bake; --force bakes it again");
    let (wall_seconds, cpu_seconds) = stages.total();
    let bytes = file.metadata().ok()?.len();
    let report = ShardReport {
        output: Some(output),
        shard: Some(shard.to_string()),
        wall_seconds,
        cpu_seconds,
        bytes,
        unchanged: true,
    };
    Some(Outcome::new(report, text))
}

/// The output is there already: whole, and made from an equal request.
pub fn unchanged(config: &Config, request: &Request, stages: &Stages, session: &Session) -> Option<Unchanged> {
    let path = &config.output;
    // A device may have no end.
    let bytes = path.is_file().then(|| std::fs::read(path).ok())??;
    let directory = format::parse_header_and_sections(&bytes).ok()?;
    let settings: SettingsRecord = super::record(&directory, path, format::SETTINGS).ok()??;
    if settings.request != request.key() {
        return None;
    }
    // Every section is as it was written.
    let is_whole = |entry: &SectionEntry| directory.section_bytes(entry.id, &Limits::default()).is_ok();
    if !directory.sections.iter().all(is_whole) {
        return None;
    }
    let mut statistics: StatisticsRecord = super::record(&directory, path, format::STATISTICS).ok()??;
    let plan = super::record(&directory, path, format::PLAN).ok()??;
    // The file says the precision in force: that which was asked for, or which follows from its noise.
    let precision = match config.settings.quality.precision {
        Precision::Packed { error: None } => {
            let error = Precision::packed_error(statistics.relative_error.map(|error| error.median));
            Precision::Packed { error: Some(error) }
        }
        asked => asked,
    };
    let recorded = settings.settings.iter().find(|setting| setting.name == PRECISION)?;
    if recorded.value != Some(precision.to_string()) {
        return None;
    }
    // A bound that was missed is missed. Where the record does not tell, it is baked again.
    let missed = match config.settings.quality.target_error {
        None => None,
        Some(target) => {
            let most = |error: Option<ErrorSummary>| error.map(|error| error.max);
            let noise = most(statistics.relative_error)?;
            let systematic = most(statistics.systematic_error).unwrap_or(0.0);
            let text =
                format!("some nodes miss the target error of {} %; the volume is unchanged", (target * 100.0) as f32);
            match () {
                () if noise.hypot(systematic) <= target => None,
                () if noise.max(systematic) > target => Some(text),
                () => return None,
            }
        }
    };
    let wrong = seen_text(&statistics, config);
    session.note(&std::mem::take(&mut statistics.findings));
    if settings.method == "path" {
        // Null in JSON.
        statistics.coverage = f64::NAN;
    }
    let (wall_seconds, cpu_seconds) = stages.total();
    let report = Report {
        output: path.display().to_string(),
        wall_seconds,
        cpu_seconds,
        sh: format!("L{}", directory.header.bands),
        bytes: bytes.len() as u64,
        seed: config.settings.quality.seed,
        unchanged: true,
        plan,
        truncation: Vec::new(),
        exposure: None,
        statistics,
    };
    Some(Unchanged { report, missed: missed.or(wrong) })
}
