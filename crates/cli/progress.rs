//! Ctrl-C, the clock, and progress on stderr.

use cpu_time::ProcessTime;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::fault::Fault;
use crate::say::say;

/// A run that does not stop by itself in this time after the first Ctrl-C is stopped: within a second in any case.
const PATIENCE: Duration = Duration::from_millis(700);

/// Set by the first Ctrl-C (or SIGTERM). A run that is busy with what cannot be stopped ends soon after all the same, and the second
/// one ends it at once: files are whole or not there at any moment.
pub fn cancel_on_interrupt() -> Arc<AtomicBool> {
    let cancel = Arc::new(AtomicBool::new(false));
    let seen = cancel.clone();
    let handler = move || {
        if seen.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        std::thread::spawn(|| {
            std::thread::sleep(PATIENCE);
            say(&Fault::Interrupted.to_string());
            std::process::exit(130);
        });
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

/// How progress is shown, on stderr.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Shown {
    /// A line every 10 s or 5 %.
    Plain,
    /// A bar that moves.
    Bar,
    /// The line as JSON.
    Json,
    /// Not at all.
    None,
}

impl Shown {
    /// A bar for a person, lines for a log.
    pub fn usual() -> Shown {
        if std::io::stderr().is_terminal() { Shown::Bar } else { Shown::Plain }
    }
}

/// A line at least so often, and after this share; but never sooner than after the last of these.
const EVERY: Duration = Duration::from_secs(10);
const SHARE: f64 = 0.05;
const LEAST: Duration = Duration::from_secs(1);
/// Once this share is done, the whole time is told.
const TOLD: f64 = 0.1;

/// Work done, rate and time left.
pub struct Progress {
    shown: Shown,
    unit: &'static str,
    total: u64,
    bar: ProgressBar,
    done: AtomicU64,
    rays: AtomicU64,
    started: Instant,
    /// What all this is for, to be told with the whole time it takes once that is known.
    aim: Mutex<Option<String>>,
    /// When the last line was written, and what was done by then.
    last: Mutex<(Instant, u64)>,
}

/// A line of `--progress json`.
#[derive(Serialize)]
struct Line<'a> {
    progress: &'a str,
    done: u64,
    total: u64,
    rays: u64,
    seconds: f64,
    seconds_left: Option<f64>,
}

impl Progress {
    /// `unit`: nodes or pixels, of which there are `total`.
    pub fn new(unit: &'static str, total: u64, shown: Shown) -> Progress {
        let is_bar = shown == Shown::Bar;
        let target = if is_bar { ProgressDrawTarget::stderr_with_hz(8) } else { ProgressDrawTarget::hidden() };
        let bar = ProgressBar::with_draw_target(Some(total), target);
        let style = format!(
            "{{prefix}}{{elapsed_precise}} {{wide_bar}} {{human_pos}}/{{human_len}} {unit}  {{msg}}  {{eta_precise}} left"
        );
        bar.set_style(ProgressStyle::with_template(&style).expect("a valid template"));
        if is_bar {
            bar.enable_steady_tick(Duration::from_millis(250));
        }
        let started = Instant::now();
        let last = Mutex::new((started, 0));
        let (done, rays) = (AtomicU64::new(0), AtomicU64::new(0));
        Progress { shown, unit, total, bar, done, rays, started, aim: Mutex::new(None), last }
    }

    /// The first line of a log says how long it will take to come to `aim`; a bar has it in front.
    pub fn toward(self, aim: Option<String>) -> Progress {
        if let Some(aim) = &aim {
            self.bar.set_prefix(format!("{aim}  "));
        }
        Progress { aim: Mutex::new(aim), ..self }
    }

    pub fn advance(&self, nodes: u64, rays: u64) {
        let rays = self.rays.fetch_add(rays, Ordering::Relaxed) + rays;
        let done = self.done.fetch_add(nodes, Ordering::Relaxed) + nodes;
        match self.shown {
            Shown::None => {}
            Shown::Bar => {
                let rate = rays as f64 / self.bar.elapsed().as_secs_f64().max(1e-3) / 1e6;
                self.bar.set_message(format!("{rate:.1} M rays/s"));
                self.bar.inc(nodes);
            }
            Shown::Plain | Shown::Json => self.line(done, rays),
        }
    }

    /// Writes a line, if it is time for one.
    fn line(&self, done: u64, rays: u64) {
        // Who writes one already writes it for all.
        let Ok(mut last) = self.last.try_lock() else { return };
        let since = last.0.elapsed();
        let is_much = done.saturating_sub(last.1) as f64 >= SHARE * self.total as f64;
        if since < LEAST || (since < EVERY && !is_much) {
            return;
        }
        // By the pace since the last line: what was kept of an earlier run came at once.
        let pace = done.saturating_sub(last.1) as f64 / since.as_secs_f64();
        let left = self.total.saturating_sub(done) as f64 / pace;
        let left = left.is_finite().then_some(left);
        *last = (Instant::now(), done);
        let seconds = self.started.elapsed().as_secs_f64();
        let Progress { unit, total, .. } = *self;
        if self.shown == Shown::Json {
            let line = Line { progress: unit, done, total, rays, seconds, seconds_left: left };
            eprintln!("{}", serde_json::to_string(&line).expect("a line is plain data"));
            return;
        }
        let percent = 100.0 * done as f64 / total.max(1) as f64;
        let rate = rays as f64 / seconds / 1e6;
        if done as f64 >= TOLD * total as f64
            && let Some(aim) = self.aim.lock().expect("no line panics").take()
        {
            let all = seconds * total as f64 / done as f64;
            say(&format!("{aim} about {} in all, {} to go", time_text(all), time_text(all - seconds)));
        }
        let left = left.map_or("time left not known".into(), |left| format!("about {} left", time_text(left)));
        say(&format!("{done} of {total} {unit} ({percent:.0} %), {rate:.1} M rays/s, {left}"));
    }

    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

/// 75 s, 12 min, 3.5 h.
fn time_text(seconds: f64) -> String {
    match seconds {
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}
