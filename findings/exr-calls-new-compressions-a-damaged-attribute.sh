#!/usr/bin/env bash
# The crate exr 1.74.2 and a file of OpenEXR 3.5.3: a valid image with one of OpenEXR 3.5's new compressions (ZSTD) is reported as
# invalid, "missing or invalid compression attribute", not as unsupported. A program that tells damaged files from those it cannot read
# by the kind of that error tells its user that the file is broken. The number of the compression (13) is in the header, and has to be
# looked up there.
#
# Seen: Invalid("missing or invalid compression attribute"), where ZIP of the same image reads.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" -q install OpenEXR==3.5.3 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import sys
import numpy as np
import OpenEXR

pixels = np.ones((4, 8, 3), np.float32)
for name, compression in [("zip", OpenEXR.ZIP_COMPRESSION), ("zstd", OpenEXR.ZSTD_COMPRESSION)]:
    header = {"compression": compression, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": pixels}).write(f"{sys.argv[1]}/{name}.exr")
PYTHON
mkdir -p "$folder/reader/src"
cat > "$folder/reader/Cargo.toml" <<'TOML'
[package]
name = "reader"
version = "0.0.0"
edition = "2021"
[dependencies]
exr = "=1.74.2"
[workspace]
TOML
cat > "$folder/reader/src/main.rs" <<'RUST'
use exr::error::Error;
use exr::meta::MetaData;

fn main() {
    let folder = std::env::args().nth(1).expect("a folder");
    let read = |name: &str| MetaData::read_from_file(format!("{folder}/{name}.exr"), false);
    assert!(read("zip").is_ok(), "ZIP reads");
    match read("zstd") {
        Err(Error::Invalid(text)) => println!("Invalid({text:?})"),
        Err(Error::NotSupported(text)) => panic!("changed: NotSupported({text:?})"),
        other => panic!("changed: {other:?}"),
    }
}
RUST
cargo run -q --manifest-path "$folder/reader/Cargo.toml" -- "$folder" | tee "$folder/said"
grep -q 'Invalid("missing or invalid compression attribute")' "$folder/said"
