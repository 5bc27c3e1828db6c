//! `gdibl assemble`: the shards of a bake in, its volume out.

use clap::Parser;
use std::fs::File;
use std::path::{Path, PathBuf};

use super::bake;
use crate::fault::Fault;
use crate::journal::{Head, Scanned, Shard, ShardBlocks, scan};
use crate::progress::Shown;
use crate::session::{Outcome, Session};

#[derive(clap::Args)]
pub struct Arguments {
    /// All shards of one bake, in any order
    #[arg(required = true, value_name = "SHARDS")]
    shards: Vec<PathBuf>,
    /// The volume to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Write the files that the volume depends on as a rule for Make and Ninja
    #[arg(long, value_name = "FILE")]
    depfile: Option<PathBuf>,
    /// Worker threads; the result does not depend on it [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    threads: Option<u32>,
    /// No progress
    #[arg(long)]
    quiet: bool,
}

/// The command line of a bake, as it was given.
#[derive(clap::Parser)]
struct CommandLine {
    #[arg(long, global = true)]
    json: bool,
    #[arg(long, global = true)]
    progress: Option<Shown>,
    #[command(subcommand)]
    verb: Verb,
}

#[derive(clap::Subcommand)]
enum Verb {
    Bake(Box<bake::Arguments>),
}

pub fn run(arguments: Arguments, session: &Session) -> Result<Outcome, Fault> {
    let absolute = |path: &Path| std::path::absolute(path).map_err(|error| Fault::reading(path, &error));
    let output = absolute(&arguments.output)?;
    let depfile = arguments.depfile.as_deref().map(absolute).transpose()?;
    let (head, shards) = read_shards(&arguments.shards)?;
    // Inputs are named as they were to the shards. On a machine that has no such folder they may lie in the own one.
    if head.folder.is_dir() {
        std::env::set_current_dir(&head.folder).map_err(|error| Fault::reading(&head.folder, &error))?;
    }
    let line = std::iter::once("gdibl").chain(head.arguments.iter().map(String::as_str));
    let CommandLine { verb: Verb::Bake(bake), .. } = CommandLine::try_parse_from(line).map_err(|_| {
        Fault::Invalid(format!("{}: its command line is of another version of gdibl", arguments.shards[0].display()))
    })?;
    let bake = bake.of_assembly(output, depfile, arguments.threads, arguments.quiet);
    bake::work(bake, head.arguments, Some((head.request, shards)), session)
}

/// The head that all shards share, and their blocks. Every shard that is missing, there twice, damaged or of another bake is named.
fn read_shards(paths: &[PathBuf]) -> Result<(Head, Vec<ShardBlocks>), Fault> {
    let mut faults = Vec::new();
    let mut damaged: Vec<u32> = Vec::new();
    let mut all: Vec<(PathBuf, Shard, Head, File, Scanned)> = Vec::new();
    for path in paths {
        let mut file = File::open(path).map_err(|error| Fault::reading(path, &error))?;
        match scan(&mut file) {
            Ok(found) => match found.head.shard {
                Some(shard) if found.is_whole => all.push((path.clone(), shard, found.head.clone(), file, found)),
                Some(shard) => {
                    damaged.push(shard.index);
                    faults.push(format!("{}: shard {shard} is damaged or cut off; bake it again", path.display()));
                }
                None => faults.push(format!("{}: is the rest of a bake, and no shard", path.display())),
            },
            Err(why) => faults.push(format!("{}: {why}; expected a shard of `gdibl bake --shard`", path.display())),
        }
    }
    // What most shards are of is the bake; of as many, the one that was named first.
    let count_of = |head: &Head, shard: &Shard| {
        let is_same = |(_, other, found, ..): &&(PathBuf, Shard, Head, File, Scanned)| {
            found.request == head.request && other.count == shard.count
        };
        all.iter().filter(is_same).count()
    };
    let most = all.iter().rev().max_by_key(|(_, shard, head, ..)| count_of(head, shard));
    let Some((head, count)) = most.map(|(_, shard, head, ..)| (head.clone(), shard.count)) else {
        return Err(Fault::Invalid(faults.join("\n")));
    };
    let mut found: Vec<Option<PathBuf>> = vec![None; count as usize];
    for (path, shard, own, ..) in &all {
        if own.request != head.request {
            let what = own.request.difference(&head.request);
            faults.push(format!("{}: is of another bake, which differs in {what}", path.display()));
        } else if shard.count != count {
            faults.push(format!("{}: is shard {shard}, the others are of {count}", path.display()));
        } else if let Some(first) = &found[shard.index as usize - 1] {
            faults.push(format!(
                "{}: is shard {shard}, and so is {}; give one of them",
                path.display(),
                first.display()
            ));
        } else {
            found[shard.index as usize - 1] = Some(path.clone());
        }
    }
    for (index, path) in (1..).zip(&found) {
        if path.is_none() && !damaged.contains(&index) {
            faults.push(format!("shard {index}/{count} is missing: bake it with --shard {index}/{count}"));
        }
    }
    if !faults.is_empty() {
        return Err(Fault::Invalid(faults.join("\n")));
    }
    let shards = all.into_iter().map(|(path, _, _, file, found)| ShardBlocks { path, file, blocks: found.blocks });
    Ok((head, shards.collect()))
}
