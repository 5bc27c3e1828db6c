//! Where a level's light goes, by path tracing: emitted = absorbed + escaped, as a Markdown table.
//!
//! `cargo run --release -p gdibl-tools --bin energy_balance -- LEVEL.glb… [PLACES]`

use gdibl_baker::Control;
use gdibl_baker::analyse::energy_balance;
use gdibl_baker::import::gltf::{GltfOptions, TextureNeeds, read_level};
use gdibl_baker::radiance::path::PathSettings;
use std::path::Path;
use std::sync::atomic::AtomicBool;

fn main() {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let places = arguments.last().and_then(|last| last.parse().ok());
    arguments.truncate(arguments.len() - usize::from(places.is_some()));
    if arguments.is_empty() {
        eprintln!("usage: energy_balance LEVEL.glb… [PLACES]");
        std::process::exit(2);
    }
    println!("| level | absorbed | escaped | absorbed + escaped - emitted | standard error |");
    println!("|---|---|---|---|---|");
    for level in &arguments {
        let path = Path::new(level);
        let options = GltfOptions { textures: TextureNeeds::All, ..GltfOptions::default() };
        let scene = read_level(path, &options).unwrap_or_else(|e| panic!("{e}"));
        let control = Control { cancel: &AtomicBool::new(false), progress: &|_, _| {}, blocks: None };
        // Bounces enough that what is cut off does not count, even between white walls.
        let settings = PathSettings::default();
        let balance =
            energy_balance(&scene, settings, places.unwrap_or(1 << 22), &control).expect("nobody interrupts a tool");
        let percent = |part: glam::DVec3| 100.0 * part.element_sum() / balance.emitted.element_sum();
        println!(
            "| {} | {:.2} % | {:.2} % | {:+.2} % | {:.2} % |",
            path.file_name().unwrap_or_default().to_string_lossy(),
            percent(balance.absorbed),
            percent(balance.escaped),
            100.0 * balance.imbalance(),
            percent(balance.standard_error)
        );
    }
}
