//! The stages of a bake, and what each takes. The library reads no clock.

use std::cell::RefCell;

use gdibl_baker::job::Stage;
use gdibl_baker::job::records::{QuarterRecord, StageRecord, StageSeconds, StatisticsRecord};

use crate::progress::Clock;

/// The stages so far, and what they took.
pub struct Stages {
    clock: Clock,
    /// Each with the seconds at which it began.
    begun: RefCell<Vec<(&'static str, StageSeconds)>>,
}

impl Stages {
    /// The first one begins.
    pub fn begin(name: &'static str) -> Stages {
        let begun = RefCell::new(vec![(name, StageSeconds { wall: 0.0, cpu: 0.0 })]);
        Stages { clock: Clock::start(), begun }
    }

    fn now(&self) -> StageSeconds {
        StageSeconds { wall: self.clock.wall_seconds(), cpu: self.clock.cpu_seconds() }
    }

    /// The next one begins.
    pub fn next(&self, name: &'static str) {
        self.begun.borrow_mut().push((name, self.now()));
    }

    /// Puts in what all stages took, rays as they are known, and what the bake takes with a share of the directions.
    pub fn fill(&self, statistics: &mut StatisticsRecord) {
        self.fill_stages(&mut statistics.stages);
        fill_quarters(&mut statistics.quarters, &statistics.stages);
    }

    fn fill_stages(&self, records: &mut Vec<StageRecord>) {
        let begun = self.begun.borrow();
        let ends = begun.iter().skip(1).map(|(_, seconds)| *seconds).chain([self.now()]);
        let stage = |((name, start), end): (&(&str, StageSeconds), StageSeconds)| StageRecord {
            stage: (*name).into(),
            rays: records.iter().find(|record| record.stage == *name).map_or(0, |record| record.rays),
            seconds: Some(StageSeconds { wall: end.wall - start.wall, cpu: end.cpu - start.cpu }),
        };
        let filled = begun.iter().zip(ends).map(stage).collect();
        *records = filled;
    }

    /// Wall and CPU seconds so far.
    pub fn total(&self) -> (f64, f64) {
        let StageSeconds { wall, cpu } = self.now();
        (wall, cpu)
    }
}

/// The stage that samples nodes takes time in proportion to the directions; the others are there anyway.
fn fill_quarters(quarters: &mut [QuarterRecord], stages: &[StageRecord]) {
    for quarter in quarters {
        let taken = |of: fn(&StageSeconds) -> f64| -> f64 {
            let share = |stage: &StageRecord| if stage.stage == Stage::Nodes.name() { quarter.share } else { 1.0 };
            stages.iter().map(|stage| stage.seconds.as_ref().map_or(0.0, of) * share(stage)).sum()
        };
        quarter.seconds = Some(StageSeconds { wall: taken(|seconds| seconds.wall), cpu: taken(|seconds| seconds.cpu) });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_of_the_directions_takes_a_quarter_of_one_stage_and_all_of_the_others() {
        let stage = |stage: &str, wall: f64| {
            let seconds = Some(StageSeconds { wall, cpu: 2.0 * wall });
            StageRecord { stage: stage.into(), rays: 0, seconds }
        };
        let stages = [stage("read", 3.0), stage("nodes", 8.0), stage("pack", 1.0)];
        let quarter = |share: f64| QuarterRecord { share, noise: 0.1, whole: 0.1, seconds: None };
        let mut quarters = [quarter(0.25), quarter(1.0)];
        fill_quarters(&mut quarters, &stages);
        let seconds = quarters.map(|quarter| quarter.seconds.map(|seconds| [seconds.wall, seconds.cpu]));
        assert_eq!(seconds, [Some([6.0, 12.0]), Some([12.0, 24.0])]);
    }
}
