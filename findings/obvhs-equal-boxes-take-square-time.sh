#!/usr/bin/env bash
# The crate obvhs 0.4.0 builds a tree over n boxes that are all equal in a time that grows with the square of n: each round of its
# clustering joins few of the pairs that are equally near. Of boxes that differ, as many take next to no time. Levels have equal boxes
# where things were pasted twice, or a mesh is instanced many times in one place.
#
# Seen: 8000 equal boxes take about 6 s, 4000 take 1.3 s, and 8000 different ones some milliseconds. What counts below is the growth:
# twice the boxes, at least three times the time.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
mkdir "$folder/src"
cat > "$folder/Cargo.toml" <<'TOML'
[package]
name = "equal-boxes"
version = "0.0.0"
edition = "2021"
[dependencies]
glam = "=0.34.2"
obvhs = { version = "=0.4.0", default-features = false }
[workspace]
TOML
cat > "$folder/src/main.rs" <<'RUST'
use std::time::Instant;

use glam::Vec3A;
use obvhs::{BvhBuildParams, aabb::Aabb, bvh2::builder::build_bvh2};

fn main() {
    let seconds = |apart: f32, count: usize| {
        let corner = |i: usize| Vec3A::new((i % 90) as f32, (i / 90) as f32, 0.0) * apart;
        let boxes: Vec<Aabb> = (0..count).map(|i| Aabb::new(corner(i), corner(i) + Vec3A::ONE)).collect();
        let begun = Instant::now();
        build_bvh2(&boxes, BvhBuildParams::medium_build(), &mut Default::default());
        begun.elapsed().as_secs_f64()
    };
    let (half, whole, different) = (seconds(0.0, 4000), seconds(0.0, 8000), seconds(2.0, 8000));
    println!("4000 equal boxes {half:.2} s, 8000 equal boxes {whole:.2} s, 8000 different ones {different:.3} s");
    assert!(whole > 3.0 * half && whole > 50.0 * different, "changed");
}
RUST
cargo run -q --release --manifest-path "$folder/Cargo.toml"
