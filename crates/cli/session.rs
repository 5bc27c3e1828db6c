//! What a run of the program tells: findings as they come, and at its end one report, as text or as JSON.

use serde::Serialize;
use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, PoisonError};

use gdibl_baker::Finding;

use crate::fault::Fault;
use crate::progress::{Shown, cancel_on_interrupt};
pub use crate::say::say;

/// Version of what `--json` prints: it grows by fields; a field that goes or changes makes a new one.
const SCHEMA: u32 = 1;

/// What all verbs share.
pub struct Session {
    /// Name of the verb.
    pub verb: &'static str,
    /// Set by Ctrl-C.
    pub cancel: Arc<AtomicBool>,
    progress: Shown,
    findings: Mutex<Vec<Finding>>,
}

impl Session {
    pub fn new(verb: &'static str, progress: Option<Shown>) -> Session {
        let progress = progress.unwrap_or_else(Shown::usual);
        Session { verb, cancel: cancel_on_interrupt(), progress, findings: Mutex::default() }
    }

    /// How progress is shown.
    pub fn shown(&self, quiet: bool) -> Shown {
        if quiet { Shown::None } else { self.progress }
    }

    /// Findings for the report, and as lines on stderr.
    pub fn find(&self, findings: &[Finding]) {
        for finding in findings {
            say(&format!("{}: {}", finding.id, finding.message));
        }
        self.note(findings);
    }

    /// Findings for the report alone.
    pub fn note(&self, findings: &[Finding]) {
        self.findings.lock().unwrap_or_else(PoisonError::into_inner).extend_from_slice(findings);
    }
}

/// What a verb came to.
pub struct Outcome {
    json: Box<dyn FnOnce(&Head) -> String>,
    text: String,
    missed: Option<String>,
}

impl Outcome {
    /// `report` is printed with `--json`, `text` without. Text that ends with a line break is printed as it is.
    pub fn new(report: impl Serialize + 'static, text: String) -> Outcome {
        let json = move |head: &Head| pretty(&Whole { head, report: Some(&report) });
        Outcome { json: Box::new(json), text, missed: None }
    }

    /// All was done, but a bound that was asked for was missed.
    pub fn missing(self, missed: Option<String>) -> Outcome {
        Outcome { missed, ..self }
    }
}

/// What every JSON report begins with.
#[derive(Serialize)]
pub struct Head {
    schema: String,
    exit: u8,
    error: Option<String>,
    findings: Vec<Finding>,
}

#[derive(Serialize)]
struct Whole<'a, R> {
    #[serde(flatten)]
    head: &'a Head,
    #[serde(flatten)]
    report: Option<&'a R>,
}

fn pretty(value: &impl Serialize) -> String {
    serde_json::to_string_pretty(value).expect("reports are plain data")
}

/// Prints what a verb came to; returns the exit code.
pub fn finish(session: &Session, done: Result<Outcome, Fault>, is_json: bool) -> u8 {
    let (outcome, fault) = match done {
        Ok(mut outcome) => {
            let missed = outcome.missed.take().map(Fault::Bound);
            (Some(outcome), missed)
        }
        Err(fault) => (None, Some(fault)),
    };
    let exit = fault.as_ref().map_or(0, Fault::exit_code);
    let error = fault.map(|fault| fault.to_string());
    let findings = std::mem::take(&mut *session.findings.lock().unwrap_or_else(PoisonError::into_inner));
    let head = Head { schema: format!("gdibl-{}-{SCHEMA}", session.verb), exit, error: error.clone(), findings };
    let text = match outcome {
        Some(outcome) if is_json => (outcome.json)(&head),
        Some(outcome) => outcome.text,
        // A command line that makes no sense has no report.
        None if is_json && exit != 2 => pretty(&Whole::<()> { head: &head, report: None }),
        None => String::new(),
    };
    let printed = print(&text);
    if let Some(error) = error {
        say(&error);
    }
    match printed {
        Err(error) => {
            say(&format!("cannot write to standard output: {error}"));
            1
        }
        Ok(()) => exit,
    }
}

/// Text on stdout. A reader that went away (`gdibl … | head`) is not an error.
fn print(text: &str) -> std::io::Result<()> {
    if text.is_empty() {
        return Ok(());
    }
    let end = if text.ends_with('\n') { "" } else { "\n" };
    let mut out = std::io::stdout().lock();
    match write!(out, "{text}{end}").and_then(|()| out.flush()) {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}
