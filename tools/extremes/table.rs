//! Prints its rows as they come, each with the seconds since the row before it.

use cpu_time::ProcessTime;
use std::time::Instant;

/// Most that all rows together may take: wall seconds on two cores, and bytes.
const MOST_SECONDS: f64 = 600.0;
const MOST_BYTES: f64 = 4e9;

/// The rows so far.
pub struct Table {
    area: &'static str,
    failed: u32,
    skipped: u32,
    started: (Instant, ProcessTime),
    since: Instant,
}

impl Table {
    /// Prints the head.
    pub fn begin() -> Table {
        println!("| area | case | must hold | measured | s | holds |");
        println!("|---|---|---|---|---|---|");
        let now = Instant::now();
        Table { area: "", failed: 0, skipped: 0, started: (now, ProcessTime::now()), since: now }
    }

    /// An area begins.
    pub fn enter(&mut self, area: &'static str) {
        self.area = area;
        self.since = Instant::now();
    }

    pub fn row(&mut self, case: &str, must: &str, measured: &str, holds: bool) {
        self.failed += u32::from(!holds);
        self.print(case, must, measured, if holds { "yes" } else { "NO" });
    }

    /// A row whose measure is one number.
    pub fn at_most(&mut self, case: &str, what: &str, bound: f64, measured: f64) {
        self.row(case, &format!("{what} ≤ {bound}"), &format!("{measured:.1e}"), measured <= bound);
    }

    /// A row that this machine cannot run.
    pub fn skip(&mut self, case: &str, must: &str, why: &str) {
        self.skipped += 1;
        self.print(case, must, why, "SKIPPED");
    }

    fn print(&mut self, case: &str, must: &str, measured: &str, verdict: &str) {
        let seconds = self.since.elapsed().as_secs_f64();
        println!("| {} | {case} | {must} | {measured} | {seconds:.1} | {verdict} |", self.area);
        self.since = Instant::now();
    }

    /// The last row: time and memory of all. CPU time counts as if two cores shared it, because other work may slow the wall
    /// clock. Returns how many rows do not hold.
    pub fn end(mut self) -> u32 {
        self.enter("all");
        let (wall, cpu) = (self.started.0.elapsed().as_secs_f64(), self.started.1.elapsed().as_secs_f64());
        let bytes = most_memory();
        let told = bytes.map_or("memory not known here".into(), |bytes| format!("{:.2} GB", bytes / 1e9));
        self.row(
            "all rows above",
            "≤ 10 minutes on two cores (CPU / 2), ≤ 4 GB",
            &format!("{:.0} s (CPU {cpu:.0} s, wall {wall:.0} s), {told}; {} skipped", cpu / 2.0, self.skipped),
            cpu / 2.0 <= MOST_SECONDS && bytes.is_none_or(|bytes| bytes <= MOST_BYTES),
        );
        self.failed
    }
}

/// Most bytes that this process has held, as Linux tells it.
fn most_memory() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.trim().trim_end_matches(" kB").parse::<f64>().ok()? * 1024.0)
}
