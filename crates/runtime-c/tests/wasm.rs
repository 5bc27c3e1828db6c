//! The WebAssembly module, run in Node by `integrations/web`, says what the Rust runtime says. Needs Node and a Rust with
//! the target wasm32-unknown-unknown.

mod common;

use common::*;
use gdibl_runtime::{Kind, Volume};
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

const TARGET: &str = "wasm32-unknown-unknown";

/// Whether the compiler that cargo takes has the target's core library.
fn has_target() -> bool {
    let rustc = std::env::var_os("RUSTC").unwrap_or("rustc".into());
    let output = Command::new(rustc).args(["--print", "target-libdir", "--target", TARGET]).output();
    output.is_ok_and(|output| Path::new(String::from_utf8_lossy(&output.stdout).trim()).is_dir())
}

fn build_module() -> PathBuf {
    // All three kinds of library at once go without link-time optimisation.
    let kind = ["--crate-type", "cdylib"];
    let built = build_library(
        "rustc",
        &[&kind[..], &["--target", TARGET, "--profile", "wasm", "--no-default-features"]].concat(),
    );
    with_extension(&built, &["wasm"])
}

#[test]
fn the_module_agrees_with_rust_in_node() {
    let name = "the_module_agrees_with_rust_in_node";
    if !has_target() {
        return skip(name, &format!("no target {TARGET} (rustup target add {TARGET})"));
    }
    if !is_there("node") {
        return skip(name, "no Node (`node`)");
    }
    let module = build_module();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../integrations/web/check.mjs");
    let folder = TempDir::new().unwrap();
    let [volume, numbers] = ["volume.gdibl", "queries"].map(|name| folder.path().join(name));
    for form in FORMS {
        let bytes = form.bytes();
        let parsed = Volume::parse(&bytes).unwrap();
        let (positions, normals): (Vec<_>, Vec<_>) = queries().into_iter().unzip();
        let truth = queries().into_iter().map(|(position, normal)| parsed.irradiance(position, normal)).collect();
        let all: Vec<u8> =
            [positions, normals, truth].concat().as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect();
        std::fs::write(&volume, &bytes).unwrap();
        std::fs::write(&numbers, all).unwrap();

        let mut command = Command::new("node");
        command.arg(&script).args([&module, &volume, &numbers]).arg(form.tolerance().to_string());
        let output = command.output().unwrap();
        let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        assert!(output.status.success(), "{form:?}: {out}\n{err}");
        println!("{form:?}: {out}");
        let said: serde_json::Value = serde_json::from_str(&out).unwrap();
        assert_eq!(said["queries"], QUERIES);
        assert_eq!(said["nodes"], 60);
        let kind = ["grid", "points", "vertices"][form.kind as usize];
        let counts = if form.kind == Kind::Grid { [5, 4, 3] } else { [60, 1, 1] };
        let header = serde_json::json!({
            "kind": kind, "counts": counts, "bands": form.bands, "isDeringed": false,
            "min": [-1.0, 0.5, 2.0], "max": [3.0, 2.0, 5.0],
        });
        // JavaScript writes 2 where Rust writes 2.0.
        assert_eq!(said["header"].to_string(), header.to_string().replace(".0", ""));
    }
}
