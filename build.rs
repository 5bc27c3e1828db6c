//! Tells the program the commit of its source, where git knows it: files record it. And a hash of the source itself: a program that
//! was changed does not take what another one baked for its own.

use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::Command;

fn main() {
    let log = Path::new(".git/logs/HEAD");
    if log.exists() {
        println!("cargo::rerun-if-changed={}", log.display());
        let commit = Command::new("git").args(["rev-parse", "--short=12", "HEAD"]).output().ok();
        if let Some(commit) = commit.filter(|output| output.status.success()) {
            println!("cargo::rustc-env=GDIBL_COMMIT={}", String::from_utf8_lossy(&commit.stdout).trim());
        }
    } else {
        println!("cargo::rerun-if-changed=build.rs");
    }
    let mut hasher = DefaultHasher::new();
    for folder in ["crates/cli", "crates/baker/src", "crates/runtime/src"] {
        println!("cargo::rerun-if-changed={folder}");
        hash(Path::new(folder), &mut hasher);
    }
    println!("cargo::rerun-if-changed=Cargo.lock");
    std::fs::read("Cargo.lock").unwrap_or_default().hash(&mut hasher);
    println!("cargo::rustc-env=GDIBL_SOURCE={:016x}", hasher.finish());
}

/// Names and contents of all files in a folder, in the order of their names.
fn hash(folder: &Path, hasher: &mut impl Hasher) {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    paths.sort();
    for path in paths {
        path.file_name().hash(hasher);
        match path.is_dir() {
            true => hash(&path, hasher),
            false => std::fs::read(&path).unwrap_or_default().hash(hasher),
        }
    }
}
