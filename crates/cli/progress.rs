//! Ctrl-C, the clock, and the progress bar on stderr.

use cpu_time::ProcessTime;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Set by the first Ctrl-C (or SIGTERM); the second one ends the program at once.
pub fn cancel_on_interrupt() -> Arc<AtomicBool> {
    let cancel = Arc::new(AtomicBool::new(false));
    let seen = cancel.clone();
    let handler = move || {
        if seen.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
    };
    // Only fails when a handler is set twice.
    ctrlc::set_handler(handler).expect("one interrupt handler");
    cancel
}

/// Wall and CPU seconds since it was started.
pub struct Clock {
    wall: Instant,
    cpu: ProcessTime,
}

impl Clock {
    pub fn start() -> Clock {
        Clock { wall: Instant::now(), cpu: ProcessTime::now() }
    }

    pub fn wall_seconds(&self) -> f64 {
        self.wall.elapsed().as_secs_f64()
    }

    pub fn cpu_seconds(&self) -> f64 {
        self.cpu.elapsed().as_secs_f64()
    }
}

/// Work done, rate and time left; silent when `quiet` or when stderr is not a terminal.
pub struct Progress {
    bar: ProgressBar,
    rays: AtomicU64,
}

impl Progress {
    /// `unit`: nodes or pixels, of which there are `total`.
    pub fn new(unit: &str, total: u64, quiet: bool) -> Progress {
        let bar = ProgressBar::with_draw_target(
            Some(total),
            if quiet { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr_with_hz(8) },
        );
        let style = format!(
            "{{elapsed_precise}} {{wide_bar}} {{human_pos}}/{{human_len}} {unit}  {{msg}}  {{eta_precise}} left"
        );
        bar.set_style(ProgressStyle::with_template(&style).expect("a valid template"));
        bar.enable_steady_tick(Duration::from_millis(250));
        Progress { bar, rays: AtomicU64::new(0) }
    }

    pub fn advance(&self, nodes: u64, rays: u64) {
        let rays = self.rays.fetch_add(rays, Ordering::Relaxed) + rays;
        if !self.bar.is_hidden() {
            let rate = rays as f64 / self.bar.elapsed().as_secs_f64().max(1e-3) / 1e6;
            self.bar.set_message(format!("{rate:.1} M rays/s"));
        }
        self.bar.inc(nodes);
    }

    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}
