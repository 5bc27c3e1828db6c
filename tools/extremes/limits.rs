//! One sample, 2^24, and requests past the memory.

use crate::level::*;
use crate::shared::*;
use crate::table::Table;
use gdibl_baker::bake::{BakeSettings, Nodes, memory_needed};
use gdibl_runtime::grid::Grid;
use std::path::Path;

pub fn rows(table: &mut Table) {
    let (scene, probes) = (room_with_pillar(), coloured_probes());
    let function = gdibl(&scene, &probes, None);
    let one = bake_points(&function, &places(), &BakeSettings { samples: 1, ..SMALL });
    let finite = one.sh.to_vec().iter().all(|v| v.is_finite());
    let unknown = one.valid_nodes().all(|node| one.relative_error[node] == f32::INFINITY);
    table.row(
        "1 sample",
        "finite; the error is said to be unknown",
        &format!("{}; {}", if finite { "finite" } else { "not finite" }, if unknown { "unknown" } else { "a number" }),
        finite && unknown,
    );
    let started = std::time::Instant::now();
    let most = bake_points(&function, &places()[..1], &BakeSettings { samples: 1 << 24, ..SMALL });
    let seconds = started.elapsed().as_secs_f64();
    let fewer = bake_points(&function, &places()[..1], &BakeSettings { samples: 1 << 18, seed: 8, ..SMALL });
    let difference = error_of(&fewer, |node| sh_of(&most, node)).relative_rmse;
    let (claimed, more) = (f64::from(fewer.relative_error[0]), f64::from(most.relative_error[0]));
    table.row(
        "2^24 samples on one node",
        "finite; 2^18 differ by ≤ 3.18 of their standard errors",
        &format!("{difference:.1e} for a standard error of {claimed:.1e}, then {more:.1e}; {seconds:.0} s"),
        most.sh.to_vec().iter().all(|v| v.is_finite()) && difference <= 3.18 * claimed && more < claimed,
    );
    let settings = BakeSettings { samples: 4096, target_error: Some(1e-6), ..SMALL };
    let capped = bake_points(&function, &places(), &settings);
    table.row(
        "target 1e-6 under a cap of 4096",
        "ends at the cap; all missed nodes counted",
        &format!("{} samples at {} nodes, {} missed", capped.samples, places().len(), capped.missed),
        capped.samples == 4096 * places().len() as u64 && capped.missed == places().len() as u64,
    );
    let lonely = Grid { min: [-1.0, 0.0, 0.0], max: [1.0, 1.0, 1.0], counts: [1; 3] };
    let volume = volume_of(&Nodes::Grid(lonely), &function, &USUAL);
    let [here, far] = [[0.0, 0.5, 0.5], [-9.0, 0.2, 3.0]].map(|p| volume.sample_f64(p, [0.0, 1.0, 0.0]).sh);
    let alike = here == far && strength(&here) > 0.1 && volume.node_count() == 1;
    table.row("a grid of 1 node", "baked, and the same light everywhere", if alike { "so" } else { "not so" }, alike);
    program(table, &BakeSettings::default());
}

/// What only the command itself decides.
fn program(table: &mut Table, settings: &BakeSettings) {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    let folder = Folder::new();
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let run = |arguments: &str| {
        let mut command = std::process::Command::new(&cargo);
        command.current_dir(root).args(["run", "--release", "--quiet", "--bin", "gdibl", "--", "bake"]);
        command.arg("assets/uffizi-box/empty-box.glb");
        (0..3).for_each(|i| {
            command.args(["--probes", &format!("assets/uffizi-box/probe_{i}.exr")]);
        });
        command.args(["--distant", "assets/uffizi-box/distant.exr", "-o"]).arg(folder.0.join("out.gdibl"));
        let output = command.args(arguments.split(' ')).output().expect("cargo runs");
        let text = String::from_utf8_lossy(&output.stderr).lines().last().unwrap_or_default().to_string();
        (output.status.code(), text, folder.0.join("out.gdibl").exists())
    };
    let gib = |nodes: u64| memory_needed(nodes, settings, true) as f64 / f64::from(1 << 30);
    for (case, arguments, nodes) in [
        ("1e8 nodes, --max-memory 8", "--counts 500,500,400 --max-memory 8", 100_000_000),
        ("1e12 nodes", "--counts 10000,10000,10000", 1_000_000_000_000),
    ] {
        let (code, said, written) = run(arguments);
        let holds = code == Some(1) && said.contains("GiB") && !written && gib(nodes) > 8.0;
        let measured = format!("exit {}: {}", code.unwrap_or(-1), said.replace('|', "/"));
        table.row(
            case,
            &format!("memory said ({:.0} GiB), refused with exit 1, nothing written", gib(nodes)),
            &measured,
            holds,
        );
    }
    let (code, said, written) = run("--counts 2,2,2 --target-error 1e-6 --samples 4096");
    table.row(
        "the command: target 1e-6 under a cap of 4096",
        "exit 5, missed nodes counted, volume written",
        &format!("exit {}: {}", code.unwrap_or(-1), said.replace('|', "/")),
        code == Some(5) && written,
    );
}
