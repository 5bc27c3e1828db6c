//! How few numbers hold the light at a node, and how few bytes hold those numbers, as Markdown tables.
//! `cargo run --release -p gdibl-tools --bin encoding_table -- decoders|bytes|packed FILE…`. Found, on five panoramas and on volumes
//! of `bake --method path --samples 1024 --sh L4 --precision f32`: living_room and dream-apartment under kloppenheim_05 (A,
//! noise of E 1.4 and 0.8 %), pandora and uffizi-box (B, 21 and 11 %), bytes per node where 95 % of the nodes gain <= 0.5 %:
//! * Build L2 as the log of band 0's sum, and what is left over that sum in Co and Cg in equal steps of E's coefficients,
//!   restored before nodes are blended. In 4x4x4 bricks in memory A 14.4, 12.9, B 27.2, 20.4 (f16: 54); on disk A 11.5, 10.1
//!   (delta x, zstd -19, 10 % under -3), B 24.9, 18.2 (f16: 38, 34, 52, 48). L1 of A 7.2, 6.4 and 5.7, 5.1. 16 times the
//!   samples: 11.7 becomes 8.9 on disk; twice the error saves 3. L2 itself is 6 % off in A: step by tolerance and noise.
//!   Kept as `--precision packed`, in file order without boxes: see `gdibl_runtime::packed`.
//! * Loses: ratios in RGB9E5 and 8 bits (4 more in A, misses 0.5 %, 62 % off where a channel is nearly dark); a basis fitted
//!   to the volume (A 0.4 less on disk, 452 nodes 2.4 more); fitted prediction (helps noise only, 0.8 to 1.3); Lorenzo (2 to
//!   5 more than delta x); coarser chroma (0.2 to 0.7 more).
//! * Decode L2 linearly (panoramas 4.7 % off). ZH3 7.0 % fitted, 8.0 % projected; L1 non-linear 9.3, 10.6 %, linear 24 %.
//! * `--sh auto`, per volume: L2 where it keeps 95 % of the nodes within the tolerance of L4, else L4; from 10 % on fitted ZH3
//!   first (A). L0, L1, cubes met 10 % nowhere. A choice per brick saves -19 to 18 % (38 % where L2 misses 10 % by 0.05 %).

use gdibl_baker::panorama::Panorama;
use gdibl_runtime::Volume;
use gdibl_runtime::format::{self, Encoding, RADIANCE};
use gdibl_tools::decoders::{Decoder, Light, Normals, Score};
use gdibl_tools::encodings::{Field, Predictor, Quantised, Quantiser, lit_nodes, predict, quantise};
use gdibl_tools::read_panorama;
use rayon::prelude::*;
use std::path::Path;

const USAGE: &str = "\
usage: encoding_table decoders FILE…    panoramas (.hdr, .exr), and volumes baked with --sh L4 --precision f32
       encoding_table bytes FILE.gdibl…  grids with L2 or more, best in f32
       encoding_table packed FILE.gdibl… grids of bake --precision packed, or of others

decoders  Error of E of each way to keep the light at one place in few numbers. Panoramas: 512 normals, against
          direct integration, mean over the files. Volumes: 128 normals, against the file's own L4, per node; and
          the cheapest that meets a tolerance, per volume, node and brick.
bytes     Added error of E and bytes per stored node of each way to write L2 and L1, in memory and compressed.
packed    Bytes per node of the coefficients as they are: in the file, and as shaders read them.";

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match &arguments[..] {
        [table, files @ ..] if table == "decoders" && !files.is_empty() => {
            let (volumes, panoramas): (Vec<&String>, Vec<&String>) = files.iter().partition(|f| f.ends_with(".gdibl"));
            if !panoramas.is_empty() {
                print_panoramas(&panoramas);
            }
            volumes.iter().for_each(|file| print_nodes(file));
        }
        [table, files @ ..] if table == "bytes" && !files.is_empty() => files.iter().for_each(|file| print_bytes(file)),
        [table, files @ ..] if table == "packed" && !files.is_empty() => print_packed(files),
        _ => {
            eprintln!("{USAGE}");
            std::process::exit(2);
        }
    }
}

fn percent(share: f64) -> String {
    format!("{:.2} %", share * 100.0)
}

fn name(file: &str) -> &str {
    Path::new(file).file_stem().and_then(|stem| stem.to_str()).unwrap_or(file)
}

fn read_volume(file: &str) -> Volume {
    let bytes = std::fs::read(file).unwrap_or_else(|e| panic!("{file}: {e}"));
    Volume::parse(&bytes).unwrap_or_else(|e| panic!("{file}: {e}"))
}

/// The `share` quantile, by rank; 0 of nothing.
fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or(0.0)
}

// What is kept.

fn print_packed(files: &[String]) {
    println!("| file | SH | nodes | encoding | in the file | on a GPU |");
    println!("|---|---|---|---|---|---|");
    for file in files {
        let bytes = std::fs::read(file).unwrap_or_else(|e| panic!("{file}: {e}"));
        let directory = format::parse_header_and_sections(&bytes).unwrap_or_else(|e| panic!("{file}: {e}"));
        let volume = read_volume(file);
        let buffers = match directory.header.encoding {
            Encoding::Packed => volume.gpu_buffers_packed(directory.header.scale),
            _ => volume.gpu_buffers(),
        };
        let words = buffers.unwrap_or_else(|e| panic!("{file}: {e}")).coefficients.len();
        let per_node = |bytes: usize| bytes as f64 / volume.node_count() as f64;
        let stored = directory.section(RADIANCE).expect("a volume has coefficients").stored_size as usize;
        println!(
            "| {} | L{} | {} | {:?} | {:.1} | {:.1} |",
            name(file),
            directory.header.bands,
            volume.node_count(),
            directory.header.encoding,
            per_node(stored),
            per_node(4 * words)
        );
    }
}

// Decoders on panoramas.

/// Every pixel as light from its centre.
fn light_of(panorama: &Panorama, normals: &Normals) -> Light {
    let mut samples = Vec::with_capacity(panorama.pixels().len());
    for y in 0..panorama.height() {
        let solid_angle = panorama.pixel_solid_angle(y);
        samples.extend((0..panorama.width()).map(|x| {
            let direction = panorama.pixel_direction(x, y).as_dvec3().normalize();
            (direction.to_array(), panorama.pixel(x, y).as_dvec3().to_array().map(|v| v * solid_angle))
        }));
    }
    Light::of_samples(&samples, normals)
}

fn print_panoramas(files: &[&String]) {
    let normals = Normals::new(512);
    let lights: Vec<Light> = files.iter().map(|file| light_of(&read_panorama(Path::new(file)), &normals)).collect();
    let control = light_of(&Panorama::new(128, 64, vec![[1.0; 3]; 128 * 64], None), &normals);
    let columns: Vec<&str> = files.iter().map(|file| name(file)).collect();
    println!("| decoder | numbers | relative RMSE | sMAPE | lowest E / mean | constant 1 | {} |", columns.join(" | "));
    println!("|---|---|---|---|---|---|{}", "---|".repeat(files.len()));
    for decoder in Decoder::ALL {
        let score = |light: &Light| Score::of(&decoder.decode(light, &normals), &light.irradiance);
        let scores: Vec<Score> = lights.par_iter().map(score).collect();
        let mean = |of: fn(&Score) -> f64| scores.iter().map(of).sum::<f64>() / scores.len() as f64;
        let each: Vec<String> = scores.iter().map(|s| percent(s.relative_rmse)).collect();
        println!(
            "| {} | {} | {} | {} | {:+.2} | {} | {} |",
            decoder.name(),
            decoder.numbers(),
            percent(mean(|s| s.relative_rmse)),
            percent(mean(|s| s.smape)),
            scores.iter().map(|s| s.lowest).fold(f64::INFINITY, f64::min),
            percent(score(&control).relative_rmse),
            each.join(" | ")
        );
    }
    println!();
}

// Decoders on the nodes of a volume.

/// In f16.
fn bytes_of(decoder: Decoder) -> usize {
    2 * decoder.numbers()
}

/// The cheapest of these is taken for a node, cheapest first.
const LADDER: [Decoder; 5] = [Decoder::L0, Decoder::L1NonlinearFitted, Decoder::Zh3Fitted, Decoder::L2, Decoder::L4];

fn print_nodes(file: &str) {
    let volume = read_volume(file);
    assert!(volume.header().bands == 4, "{file}: L{}; bake with --sh L4", volume.header().bands);
    let normals = Normals::new(128);
    let lit = lit_nodes(&volume);
    let nodes: Vec<usize> = (0..lit.len()).filter(|&node| lit[node]).collect();
    let scores: Vec<Vec<Score>> = nodes
        .par_iter()
        .map(|&node| {
            let light = Light::of_sh(&volume.node_sh(node), &normals);
            Decoder::ALL.map(|d| Score::of(&d.decode(&light, &normals), &light.irradiance)).to_vec()
        })
        .collect();
    let noise: Vec<f64> = nodes.iter().filter_map(|&n| volume.node_relative_error(n)).map(f64::from).collect();
    println!("{}: {} nodes, standard error of E {} (median)", name(file), nodes.len(), percent(quantile(&noise, 0.5)));
    println!();
    println!("| decoder | bytes | median node | 95th percentile | nodes with E < 0 |");
    println!("|---|---|---|---|---|");
    let errors = |place: usize| scores.iter().map(|s| s[place].relative_rmse).collect::<Vec<f64>>();
    for (place, decoder) in Decoder::ALL.iter().enumerate() {
        let negative = scores.iter().filter(|s| s[place].lowest < -1e-6).count() as f64 / nodes.len() as f64;
        println!(
            "| {} | {} | {} | {} | {} |",
            decoder.name(),
            bytes_of(*decoder),
            percent(quantile(&errors(place), 0.5)),
            percent(quantile(&errors(place), 0.95)),
            percent(negative)
        );
    }
    println!();
    let steps = LADDER.map(Decoder::name).join(" | ");
    println!("| tolerance | cheapest for the volume | bytes | {steps} | bytes by node | bytes by 4x4x4 brick |");
    println!("|---|---|---|{}---|---|", "---|".repeat(LADDER.len()));
    let bricks = bricks_of(&volume, &nodes);
    for tolerance in [0.01, 0.02, 0.05, 0.1] {
        // 95 % of a volume's nodes, or of a brick's, have to meet it.
        let p95 = |place: usize| quantile(&errors(place), 0.95);
        let meeting = (0..Decoder::ALL.len()).filter(|&place| p95(place) <= tolerance);
        let cheapest = meeting
            .min_by(|&a, &b| bytes_of(Decoder::ALL[a]).cmp(&bytes_of(Decoder::ALL[b])).then(p95(a).total_cmp(&p95(b))));
        let cheapest = Decoder::ALL[cheapest.expect("L4 is the truth")];
        let serves = |of: &[usize]| {
            let meets = |decoder: &Decoder| {
                let place = Decoder::ALL.iter().position(|d| d == decoder).expect("one of all");
                let errors: Vec<f64> = of.iter().map(|&i| scores[i][place].relative_rmse).collect();
                quantile(&errors, 0.95) <= tolerance
            };
            LADDER.iter().position(meets).expect("L4 is the truth")
        };
        let by_node: Vec<usize> = (0..nodes.len()).map(|i| serves(&[i])).collect();
        let by_brick: Vec<usize> = bricks.iter().map(|brick| serves(brick)).collect();
        let shares: Vec<String> = (0..LADDER.len())
            .map(|step| {
                let share = |of: &[usize]| of.iter().filter(|&&s| s == step).count() as f64 / of.len() as f64 * 100.0;
                format!("{:.0} % of nodes, {:.0} % of bricks", share(&by_node), share(&by_brick))
            })
            .collect();
        let bytes = |step: usize| bytes_of(LADDER[step]);
        let node_bytes: usize = by_node.iter().map(|&step| bytes(step)).sum();
        let brick_bytes: usize = by_brick.iter().zip(&bricks).map(|(&step, brick)| bytes(step) * brick.len()).sum();
        println!(
            "| {:.0} % | {} | {} | {} | {:.1} | {:.1} |",
            tolerance * 100.0,
            cheapest.name(),
            bytes_of(cheapest),
            shares.join(" | "),
            node_bytes as f64 / nodes.len() as f64,
            brick_bytes as f64 / nodes.len() as f64
        );
    }
    println!();
}

/// Places in `nodes` of those of each brick of 4x4x4 that has any.
fn bricks_of(volume: &Volume, nodes: &[usize]) -> Vec<Vec<usize>> {
    let [nx, ny, _] = volume.header().counts.map(|count| count as usize);
    let mut bricks = std::collections::BTreeMap::<[usize; 3], Vec<usize>>::new();
    for (place, node) in nodes.iter().enumerate() {
        bricks.entry([node % nx / 4, node / nx % ny / 4, node / nx / ny / 4]).or_default().push(place);
    }
    bricks.into_values().collect()
}

// Bytes.

/// Added error of E that 95 % of the nodes must not exceed to be as good as unquantised.
const ADDED_ERROR: f64 = 0.005;

/// Bytes per node: must and aim compressed, must and aim in memory.
fn limits(bands: u32) -> ([f64; 2], [f64; 2]) {
    if bands == 2 { ([12.0, 6.0], [20.0, 12.0]) } else { ([5.0, 5.0], [10.0, 10.0]) }
}

/// With the coarsest steps of 2^(1/4) that keep the added error.
fn coarsest(field: &Field, added_error: f64, with_step: impl Fn(f64) -> Quantiser) -> Quantiser {
    let steps = (0..40).map(|i| 0.08 * (-0.25 * f64::from(i)).exp2());
    let mut quantisers = steps.map(with_step);
    let fine = |q: &Quantiser| quantile(&quantise(field, q).errors, 0.95) <= added_error;
    quantisers.find(fine).expect("steps of 5e-5 are fine enough")
}

fn print_bytes(file: &str) {
    let volume = read_volume(file);
    for bands in [2, 1] {
        let field = Field::of_volume(&volume, bands);
        println!("{}, L{bands}: {} nodes stored", name(file), field.stored());
        println!();
        println!(
            "| encoding | median node | 95th percentile | worst | relative RMSE | in memory | in bricks \
             | zstd -3 | delta x | Lorenzo | fitted | best, -19 | entropy | meets |"
        );
        println!("|{}", "---|".repeat(14));
        let mut quantisers = vec![Quantiser::half(&field)];
        quantisers.extend([8, 9, 10, 11].map(|bits| Quantiser::ratio(&field, bits)));
        quantisers.push(coarsest(&field, ADDED_ERROR, |step| Quantiser::Opponent { step, chroma: 2.0 }));
        // And what twice and four times the error would save.
        for added_error in [ADDED_ERROR, 2.0 * ADDED_ERROR, 4.0 * ADDED_ERROR] {
            quantisers.push(coarsest(&field, added_error, |step| Quantiser::Opponent { step, chroma: 1.0 }));
            quantisers.push(coarsest(&field, added_error, |step| Quantiser::fitted(&field, step)));
        }
        for quantiser in quantisers {
            print_encoding(&field, &quantiser, bands);
        }
        println!();
    }
}

fn print_encoding(field: &Field, quantiser: &Quantiser, bands: u32) {
    let quantised: Quantised = quantise(field, quantiser);
    let per_node = |bytes: f64| (bytes + quantised.side_bytes as f64) / field.stored() as f64;
    let streams = Predictor::ALL.map(|predictor| predict(field, &quantised, predictor));
    let zstd = |bytes: &[u8], level: i32| {
        per_node(zstd::bulk::compress(bytes, level).expect("zstd compresses into memory").len() as f64)
    };
    let quick = streams.each_ref().map(|stream| zstd(&stream.bytes, 3));
    let thorough = streams.iter().map(|stream| zstd(&stream.bytes, 19)).fold(f64::INFINITY, f64::min);
    let least_disk = quick.iter().copied().fold(thorough, f64::min);
    let entropy = streams.iter().map(|stream| per_node(stream.entropy)).fold(f64::INFINITY, f64::min);
    let p95 = quantile(&quantised.errors, 0.95);
    let bricks = per_node(quantised.bytes_in_bricks * field.stored() as f64);
    let least_memory = bricks.min(quantised.bytes_in_memory as f64);
    let ([disk, disk_aim], [memory, memory_aim]) = limits(bands);
    let met = [
        (least_disk <= disk, format!("disk {disk}")),
        (least_disk <= disk_aim && disk_aim < disk, format!("disk {disk_aim}")),
        (least_memory <= memory, format!("memory {memory}")),
        (least_memory <= memory_aim && memory_aim < memory, format!("memory {memory_aim}")),
    ];
    let met: Vec<String> =
        met.into_iter().filter(|(met, _)| *met && p95 <= ADDED_ERROR).map(|(_, what)| what).collect();
    println!(
        "| {} | {} | {} | {} | {} | {} | {bricks:.1} | {} | {thorough:.1} | {entropy:.1} | {} |",
        quantiser.name(),
        percent(quantile(&quantised.errors, 0.5)),
        percent(p95),
        percent(quantile(&quantised.errors, 1.0)),
        percent(quantised.relative_rmse),
        quantised.bytes_in_memory,
        quick.map(|bytes| format!("{bytes:.1}")).join(" | "),
        if met.is_empty() { "-".into() } else { met.join(", ") }
    );
}

#[cfg(test)]
mod tests {
    use super::quantile;

    #[test]
    fn quantile_is_the_least_value_that_the_share_does_not_exceed() {
        let values: Vec<f64> = (1..=20).rev().map(f64::from).collect();
        assert_eq!(quantile(&values, 0.95), 19.0);
        assert_eq!(quantile(&values, 1.0), 20.0);
        assert_eq!(quantile(&values, 0.0), 1.0);
        assert_eq!(quantile(&[], 0.5), 0.0);
    }
}
