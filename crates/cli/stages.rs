//! The stages of a bake, and what each takes. The library reads no clock.

use std::cell::RefCell;

use gdibl_baker::job::records::{StageRecord, StageSeconds};

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

    /// All stages with their seconds; rays as they are known.
    pub fn fill(&self, records: &mut Vec<StageRecord>) {
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
