//! `gdibl`: bakes irradiance volumes from a glTF level and a few HDR light probes, and tells and shows what is in them.

mod cache;
mod captures;
mod commands;
mod config;
mod fault;
mod flags;
mod hashes;
mod inputs;
mod journal;
mod locks;
mod progress;
mod read_once;
mod report;
mod request;
mod say;
mod session;
mod stages;
mod study;
mod volumes;

use clap::{Parser, Subcommand};
use std::process::ExitCode;

use progress::Shown;
use session::{Session, finish};

/// Bakes irradiance volumes by Geometrically Derived Image Based Lighting.
///
/// Exit codes: 0 done; 1 the system (disk, memory); 2 usage; 3 invalid input; 4 unsupported input; 5 done, but a
/// requested bound was not met; 130 interrupted.
#[derive(Parser)]
#[command(version, max_term_width = 100)]
struct Arguments {
    /// Print the result as one JSON object, also of a run that fails
    #[arg(long, global = true)]
    json: bool,
    /// How progress is shown: plain is a line every 10 s or 5 % [default: bar in a terminal, else plain]
    #[arg(long, global = true, value_name = "HOW", hide_possible_values = true)]
    progress: Option<Shown>,
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Subcommand)]
enum Verb {
    /// Bake an irradiance volume from a level (.glb, .gltf) or a BAKE.toml
    Bake(Box<commands::bake::Arguments>),
    /// Put the shards of a bake together: the bytes of one bake
    Assemble(commands::assemble::Arguments),
    /// Make light probes from a level's own lights, by path tracing
    Capture(Box<commands::capture::Arguments>),
    /// Tell what probes have seen of a level, and where further ones should stand
    Probes(Box<commands::probes::Arguments>),
    /// Tell what is in a volume: sections, grid, validity, error, coverage, settings, plan
    Inspect(commands::inspect::Arguments),
    /// Irradiance, or SH coefficients, at the places of a CSV file
    Sample(commands::sample::Arguments),
    /// Take a picture of a level in the light of its probes, of a volume, or by path tracing
    Render(Box<commands::render::Arguments>),
    /// Convert a volume for an engine: Bevy, three.js, Godot, Unity, or as OpenEXR or JSON, and tell what that loses
    Export(commands::export::Arguments),
    /// Cut smaller volumes out of one: coarser, in tiles, with fewer bands; and tell what that loses
    Cut(commands::cut::Arguments),
    /// Error of a volume against another volume or a reference JSON
    Compare(commands::compare::Arguments),
    /// Error against run time, over methods and budgets: a page to read, CSV, JSON and SVG
    Study(Box<commands::study::Arguments>),
}

impl Verb {
    fn name(&self) -> &'static str {
        match self {
            Verb::Bake(_) => "bake",
            Verb::Assemble(_) => "assemble",
            Verb::Capture(_) => "capture",
            Verb::Probes(_) => "probes",
            Verb::Inspect(_) => "inspect",
            Verb::Sample(_) => "sample",
            Verb::Render(_) => "render",
            Verb::Export(_) => "export",
            Verb::Cut(_) => "cut",
            Verb::Compare(_) => "compare",
            Verb::Study(_) => "study",
        }
    }
}

fn main() -> ExitCode {
    let Arguments { json, progress, verb } = Arguments::parse();
    let session = Session::new(verb.name(), progress);
    let done = match verb {
        Verb::Bake(arguments) => commands::bake::run(*arguments, &session),
        Verb::Assemble(arguments) => commands::assemble::run(arguments, &session),
        Verb::Capture(arguments) => commands::capture::run(*arguments, &session),
        Verb::Probes(arguments) => commands::probes::run(*arguments, &session),
        Verb::Inspect(arguments) => commands::inspect::run(arguments, &session),
        Verb::Sample(arguments) => commands::sample::run(arguments, &session),
        Verb::Render(arguments) => commands::render::run(*arguments, &session),
        Verb::Export(arguments) => commands::export::run(arguments),
        Verb::Cut(arguments) => commands::cut::run(arguments),
        Verb::Compare(arguments) => commands::compare::run(arguments, &session),
        Verb::Study(arguments) => commands::study::run(*arguments, &session),
    };
    ExitCode::from(finish(&session, done, json))
}
