//! What goes wrong, and what the program says: exit code, file, and words that help.

mod common;

use common::{Folder, Level, csv_of};
use serde_json::json;
use std::process::{Command, Stdio};

/// A folder with a level, a probe, and damaged versions of both.
fn inputs() -> Folder {
    let folder = Folder::new();
    let level = Level::room([-2.0; 3], [2.0; 3]);
    level.write(&folder, "room.glb");
    Level::new().write(&folder, "empty.glb");
    folder.write("cut.glb", &level.glb()[..700]);
    let mut exotic = level.clone();
    exotic.json["extensionsRequired"] = json!(["EXT_lights_of_tomorrow"]);
    exotic.write(&folder, "exotic.glb");
    folder.write("garbage.glb", "this is no level\n");
    folder.write("picture.glb", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\x01\xff");
    folder.constant("probe.exr", [0.0, 0.5, 0.0], [1.0; 3]);
    folder.sky("no_place.exr", [1.0; 3]);
    folder.panorama("nan.exr", 16, Some([0.0; 3]), |d| if d.y > 0.95 { [1.0, f32::NAN, 1.0] } else { [1.0; 3] });
    folder.panorama("negative.exr", 16, Some([0.0; 3]), |d| if d.y > 0.95 { [-1.0, 1.0, 1.0] } else { [1.0; 3] });
    let probe = folder.read("probe.exr");
    folder.write("cut.exr", &probe[..probe.len() * 2 / 3]);
    folder.write("picture.exr", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR");
    folder.write("good.csv", csv_of(&[[0.0, 0.0, 0.0, 0.0, 1.0, 0.0]]));
    folder.write("no_normals.csv", csv_of(&[[0.0, 0.0, 0.0]]));
    folder.write("bad_line.csv", "x,y,z,nx,ny,nz\n0,0,0,0,1,0\n0,0,zero,0,1,0\n");
    folder.write("zero_normal.csv", "0,0,0,0,0,0\n");
    folder.write("infinite.csv", "0,0,inf,0,1,0\n");
    folder.write("empty.csv", "");
    folder
}

/// Runs every case: (arguments, exit code, words that the message holds), and expects no output file.
fn expect(folder: &Folder, cases: &[(&str, i32, &[&str])]) {
    let before = folder.names();
    for (line, code, words) in cases {
        let arguments: Vec<&str> = line.split_whitespace().collect();
        let run = folder.run(&arguments);
        assert_eq!(run.code, *code, "gdibl {line}\n{}", run.err);
        for word in *words {
            assert!(run.err.contains(word), "gdibl {line}: no '{word}' in\n{}", run.err);
        }
        assert!(!run.err.contains("panicked"), "gdibl {line}\n{}", run.err);
        assert_eq!(folder.names(), before, "gdibl {line} left something behind");
    }
}

#[test]
fn levels_that_cannot_be_read_are_named_with_what_was_found() {
    expect(
        &inputs(),
        &[
            ("bake missing.glb --probes probe.exr", 3, &["missing.glb", "No such file"]),
            ("bake picture.glb --probes probe.exr", 3, &["picture.glb", "glTF"]),
            ("bake garbage.glb --probes probe.exr", 3, &["garbage.glb"]),
            ("bake cut.glb --probes probe.exr", 3, &["cut.glb", "bytes"]),
            ("bake exotic.glb --probes probe.exr", 4, &["exotic.glb", "EXT_lights_of_tomorrow"]),
            ("bake . --probes probe.exr", 3, &["."]),
            ("bake room.glb --probes probe.exr --environment missing.glb", 3, &["missing.glb"]),
            ("bake empty.glb --probes probe.exr", 2, &["empty.glb", "--bounds"]),
            ("bake empty.glb --probes probe.exr --nodes vertices", 3, &["empty.glb", "no vertices"]),
        ],
    );
}

#[test]
fn probes_that_cannot_be_read_are_named_with_what_was_found() {
    let folder = inputs();
    std::fs::create_dir(folder.path("nothing")).unwrap();
    expect(
        &folder,
        &[
            ("bake room.glb --probes missing.exr", 3, &["missing.exr"]),
            ("bake room.glb --probes no_place.exr", 3, &["no_place.exr", "no position", "[[probe]]"]),
            ("bake room.glb --probes nan.exr", 3, &["nan.exr", "--repair-pixels"]),
            ("bake room.glb --probes negative.exr", 3, &["negative.exr", "--repair-pixels"]),
            ("bake room.glb --probes cut.exr", 3, &["cut.exr"]),
            ("bake room.glb --probes picture.exr", 4, &["picture.exr", "PNG", "OpenEXR"]),
            ("bake room.glb --probes room.glb", 4, &["room.glb", "a glTF file", "OpenEXR"]),
            ("bake room.glb --probes nothing", 3, &["nothing", "EXR"]),
            ("bake room.glb --probes probe.exr --distant missing.hdr", 3, &["missing.hdr"]),
            ("bake room.glb --probes probe.exr --distant nan.exr", 3, &["nan.exr"]),
        ],
    );
}

#[test]
fn bad_pixels_are_repaired_on_request_and_the_repair_is_reported() {
    let folder = inputs();
    for image in ["nan.exr", "negative.exr"] {
        let arguments = ["room.glb", "--probes", image, "--repair-pixels", "--counts", "2,2,2", "--samples", "64"];
        let report = folder.bake(&[&arguments[..], &["--bounds", "-1,-1,-1,1,1,1"]].concat());
        assert!(report["findings"].to_string().contains("repaired-pixels"), "{}", report["findings"]);
        let light = folder.irradiance("room.gdibl", &[[0.0, 0.0, 0.0, 0.0, 1.0, 0.0]])[0];
        assert!(light.iter().all(|e| e.is_finite() && *e > 0.5), "{light:?}");
    }
}

#[test]
fn grids_and_settings_without_sense_are_usage_errors() {
    expect(
        &inputs(),
        &[
            ("bake room.glb --probes probe.exr --counts 0,1,1", 2, &["--counts", "empty grid"]),
            ("bake room.glb --probes probe.exr --counts 1,1", 2, &["--counts", "X,Y,Z"]),
            ("bake room.glb --probes probe.exr --counts 1,1,1.5", 2, &["--counts", "1.5"]),
            ("bake room.glb --probes probe.exr --counts 99999999999,1,1", 2, &["--counts"]),
            ("bake room.glb --probes probe.exr --bounds 1,0,0,0,1,1", 2, &["--bounds", "lower"]),
            ("bake room.glb --probes probe.exr --bounds 0,0,0,1,1", 2, &["--bounds", "x0,y0,z0,x1,y1,z1"]),
            ("bake room.glb --probes probe.exr --bounds 0,0,0,1,1,nan", 2, &["--bounds", "finite"]),
            ("bake room.glb --probes probe.exr --bounds 0,0,0,1,1,inf", 2, &["--bounds", "finite"]),
            ("bake room.glb --probes probe.exr --spacing 1 --counts 2,2,2", 2, &["spacing", "counts"]),
            ("bake room.glb --probes probe.exr --spacing 0", 2, &["--spacing 0", "above 0"]),
            ("bake room.glb --probes probe.exr --spacing=-1", 2, &["--spacing -1", "above 0"]),
            ("bake room.glb --probes probe.exr --spacing NaN", 2, &["--spacing NaN"]),
            ("bake room.glb --probes probe.exr --spacing inf", 2, &["--spacing inf"]),
            ("bake room.glb --probes probe.exr --nodes vertices --spacing 1", 2, &["--nodes grid"]),
            ("bake room.glb --probes probe.exr --nodes everywhere", 2, &["everywhere", "points:FILE.csv"]),
            ("bake room.glb --probes probe.exr --samples 0", 2, &["--samples 0"]),
            ("bake room.glb --probes probe.exr --target-error 0", 2, &["--target-error 0"]),
            ("bake room.glb --probes probe.exr --target-error=-1", 2, &["--target-error -1"]),
            ("bake room.glb --probes probe.exr --target-error nan", 2, &["--target-error NaN"]),
            ("bake room.glb --probes probe.exr --threads 0", 2, &["--threads 0"]),
            ("bake room.glb --probes probe.exr --sh L5", 2, &["L5", "L4"]),
            ("bake room.glb --probes probe.exr --precision f8", 2, &["f8", "f16", "packed"]),
            ("bake room.glb --probes probe.exr --precision packed:0.001", 2, &["packed:0.001", "0.002 to 0.1"]),
            ("bake room.glb --probes probe.exr --precision packed:nan", 2, &["packed:nan", "0.002 to 0.1"]),
            ("bake room.glb --probes probe.exr --precision packed:", 2, &["0.002 to 0.1"]),
            ("bake room.glb --probes probe.exr --blend best", 2, &["best", "footprint:k"]),
            ("bake room.glb --probes probe.exr --blend footprint:-1", 2, &["footprint:-1"]),
            ("bake room.glb --probes probe.exr --scene mirror", 2, &["mirror", "occlude"]),
            ("bake room.glb --probes probe.exr --scene recurse:999", 2, &["recurse:DEPTH"]),
            ("bake room.glb --probes probe.exr --magic", 2, &["--magic"]),
            ("bake", 2, &["<INPUT>"]),
            ("frobnicate", 2, &["frobnicate"]),
            ("sample room.glb", 2, &["--at"]),
        ],
    );
}

#[test]
fn absurd_grids_are_refused_before_memory_is_taken() {
    // A thousand gigabytes, then more nodes than a volume can hold.
    expect(
        &inputs(),
        &[
            ("bake room.glb --probes probe.exr --counts 1600,1600,1600 --max-memory 8", 1, &["GiB", "--spacing"]),
            ("bake room.glb --probes probe.exr --counts 500,500,400 --max-memory 8", 1, &["100000000 nodes", "GiB"]),
            ("bake room.glb --probes probe.exr --counts 10000,10000,10000", 1, &["GiB", "--spacing"]),
            ("bake room.glb --probes probe.exr --spacing 1e-30", 1, &["GiB", "--spacing"]),
            ("bake room.glb --probes probe.exr --counts 20,20,20 --max-memory 0.001", 1, &["GiB", "--max-memory"]),
        ],
    );
}

#[test]
fn outputs_that_cannot_be_written_are_found_out_before_baking() {
    // 2^31 samples per node: a bake that began would not end.
    expect(
        &inputs(),
        &[
            ("bake room.glb --probes probe.exr --samples 2147483648 -o missing/x.gdibl", 1, &["missing/x.gdibl"]),
            ("bake room.glb --probes probe.exr --samples 2147483648 -o room.glb/x.gdibl", 1, &["room.glb/x.gdibl"]),
            ("bake room.glb --probes probe.exr --samples 2147483648 -o .", 2, &["folder"]),
        ],
    );
}

#[test]
fn volumes_and_places_that_cannot_be_read_are_named_with_the_line() {
    let folder = inputs();
    folder.bake(&["room.glb", "--probes", "probe.exr", "--counts", "2,2,2", "--samples", "16", "-o", "v.gdibl"]);
    let volume = folder.read("v.gdibl");
    folder.write("cut.gdibl", &volume[..volume.len() - 10]);
    folder.write("longer.gdibl", [&volume[..], b"more"].concat());
    let mut newer = volume.clone();
    newer[8] = 9;
    folder.write("newer.gdibl", newer);
    let mut flipped = volume;
    let middle = flipped.len() / 2;
    flipped[middle] ^= 1;
    folder.write("flipped.gdibl", flipped);
    expect(
        &folder,
        &[
            ("sample missing.gdibl --at good.csv", 3, &["missing.gdibl"]),
            ("sample room.glb --at good.csv", 3, &["room.glb"]),
            ("sample cut.gdibl --at good.csv", 3, &["cut.gdibl"]),
            ("sample longer.gdibl --at good.csv", 3, &["longer.gdibl"]),
            ("sample flipped.gdibl --at good.csv", 3, &["flipped.gdibl"]),
            ("sample newer.gdibl --at good.csv", 4, &["newer.gdibl", "version"]),
            ("inspect cut.gdibl", 3, &["cut.gdibl"]),
            ("inspect probe.exr --json", 3, &["probe.exr"]),
            ("sample v.gdibl --at missing.csv", 3, &["missing.csv"]),
            ("sample v.gdibl --at bad_line.csv", 3, &["bad_line.csv", "line 3", "zero"]),
            ("sample v.gdibl --at no_normals.csv", 3, &["no_normals.csv", "--sh"]),
            ("sample v.gdibl --at zero_normal.csv", 3, &["zero_normal.csv", "line 1"]),
            ("sample v.gdibl --at infinite.csv", 3, &["infinite.csv", "line 1", "finite"]),
            ("sample v.gdibl --at empty.csv", 3, &["empty.csv"]),
            ("bake room.glb --probes probe.exr --nodes points:bad_line.csv", 3, &["bad_line.csv", "line 3"]),
            ("bake room.glb --probes probe.exr --nodes points:missing.csv", 3, &["missing.csv"]),
        ],
    );
}

#[test]
fn truth_that_cannot_be_compared_with_is_named_with_what_was_found() {
    let folder = inputs();
    let bake = ["room.glb", "--probes", "probe.exr", "--samples", "16"];
    folder.bake(&[&bake[..], &["--counts", "2,2,2", "-o", "v.gdibl"]].concat());
    folder.bake(&[&bake[..], &["--nodes", "points:no_normals.csv", "-o", "point.gdibl"]].concat());
    let volume = folder.read("v.gdibl");
    folder.write("cut.gdibl", &volume[..volume.len() - 10]);
    let truth = json!({ "far": { "position": [[9, 9, 9]], "sh": [[[1, 1, 1]]] },
                        "skin": { "position": [[1, 1, 1]], "normal": [[0, 1, 0]], "irradiance": [[1, 1, 1]] } });
    folder.write("truth.json", truth.to_string());
    folder.write("cut.json", &truth.to_string()[..60]);
    folder.write("short.json", truth.to_string().replace("[[9,9,9]]", "[[9,9,9],[8,8,8]]"));
    folder.write("null.json", truth.to_string().replace("[[[1,1,1]]]", "[[[1,null,1]]]"));
    folder.write("other.json", r#"{"level": "x.glb"}"#);
    expect(
        &folder,
        &[
            ("compare missing.gdibl v.gdibl", 3, &["missing.gdibl"]),
            ("compare v.gdibl missing.json", 3, &["missing.json"]),
            ("compare cut.gdibl v.gdibl", 3, &["cut.gdibl"]),
            ("compare v.gdibl cut.json", 3, &["cut.json", "line 1", "JSON"]),
            ("compare v.gdibl short.json", 3, &["short.json", "'far'", "sh", "a list of 1", "2 places"]),
            ("compare v.gdibl null.json", 3, &["null.json", "'far'", "sh of place 0, coefficient 0", "[1,null,1]"]),
            ("compare v.gdibl other.json", 3, &["other.json", "no set", "'position'"]),
            ("compare v.gdibl probe.exr", 3, &["probe.exr", ".gdibl", "JSON"]),
            ("compare truth.json v.gdibl", 3, &["truth.json", "comes first"]),
            ("compare v.gdibl truth.json", 3, &["v.gdibl", "1 are outside", "--bounds"]),
            ("compare point.gdibl v.gdibl", 3, &["point.gdibl", "8 are not among", "--nodes points:FILE.csv"]),
            ("compare v.gdibl truth.json --set dark", 2, &["--set dark", "far, skin"]),
            ("compare v.gdibl v.gdibl --set far", 2, &["--set far", "nodes"]),
            ("compare v.gdibl v.gdibl --tolerance=-1", 2, &["--tolerance -1"]),
            ("compare v.gdibl v.gdibl --tolerance nan", 2, &["--tolerance NaN"]),
            ("compare v.gdibl", 2, &["<B>"]),
        ],
    );
}

#[cfg(unix)]
#[test]
fn interrupted_bake_ends_with_130_and_leaves_only_what_the_next_goes_on_from() {
    let folder = inputs();
    let before = folder.names();
    // Hours of work on one node, and on many.
    for samples in ["2147483648", "1000000"] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_gdibl"))
            .args(["bake", "room.glb", "--probes", "probe.exr", "--spacing", "0.1", "--samples", samples])
            .current_dir(folder.path(""))
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        std::thread::sleep(std::time::Duration::from_millis(1500));
        assert!(child.try_wait().unwrap().is_none(), "it should still be baking");
        let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
        assert!(killed.success());
        let output = child.wait_with_output().unwrap();
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(130), "{message}");
        assert!(message.contains("interrupted"), "{message}");
        let mut names = folder.names();
        names.retain(|name| name != "room.gdibl.partial");
        assert_eq!(names, before);
    }
}

/// Runs with standard output on a full disk.
#[cfg(target_os = "linux")]
fn run_on_full_disk(folder: &Folder, arguments: &[&str]) -> (Option<i32>, String) {
    let full = std::fs::File::options().write(true).open("/dev/full").expect("/dev/full");
    let mut command = Command::new(env!("CARGO_BIN_EXE_gdibl"));
    let output = command.args(arguments).current_dir(folder.path("")).stdout(full).output().unwrap();
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[cfg(target_os = "linux")]
#[test]
fn full_disk_under_standard_output_is_a_system_error() {
    let folder = inputs();
    let bake = ["bake", "room.glb", "--probes", "probe.exr", "--counts", "2,2,2", "--samples", "16"];
    folder.ok(&bake);
    let render = ["render", "room.glb", "--probes", "probe.exr", "--size", "8x8", "--samples", "1"];
    let verbs: [&[&str]; 10] = [
        &render,
        &[&render[..], &["--json"]].concat(),
        &["sample", "room.gdibl", "--at", "good.csv"],
        &["sample", "room.gdibl", "--at", "good.csv", "--json"],
        &["inspect", "room.gdibl"],
        &["inspect", "room.gdibl", "--json"],
        &["compare", "room.gdibl", "room.gdibl"],
        &["compare", "room.gdibl", "room.gdibl", "--json"],
        &bake,
        &[&bake[..], &["--json"]].concat(),
    ];
    for arguments in verbs {
        let (code, message) = run_on_full_disk(&folder, arguments);
        assert_eq!(code, Some(1), "{arguments:?}\n{message}");
        assert!(message.contains("space") && !message.contains("panicked"), "{arguments:?}\n{message}");
    }
}

#[cfg(unix)]
#[test]
fn reader_that_goes_away_is_no_error() {
    let folder = inputs();
    let bake = ["bake", "room.glb", "--probes", "probe.exr", "--counts", "2,2,2", "--samples", "16"];
    folder.ok(&bake);
    let verbs: [&[&str]; 4] = [
        &["sample", "room.gdibl", "--at", "good.csv"],
        &["inspect", "room.gdibl"],
        &["compare", "room.gdibl", "room.gdibl"],
        &bake,
    ];
    for arguments in verbs {
        let mut command = Command::new(env!("CARGO_BIN_EXE_gdibl"));
        command.args(arguments).current_dir(folder.path("")).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}\n{message}");
    }
}
