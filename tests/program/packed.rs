//! Packed volumes, the default: the error they state is what `compare` finds, the file is small, and every verb reads it.

use crate::common::{Folder, repository};
use gdibl_runtime::format::{RADIANCE, parse_header_and_sections};
use gdibl_runtime::{RadianceSh, Volume};
use serde_json::Value;

const BOX: [&str; 4] = ["--counts", "7,7,13", "--samples", "2048"];

fn bake_box(folder: &Folder, volume: &str, more: &[&str]) -> Value {
    let project = repository("assets/uffizi-box/uffizi-box.bake.toml").display().to_string();
    folder.bake(&[&[project.as_str(), "-o", volume], &BOX[..], more].concat())
}

/// What E of each baked node is off by: root mean square over normals and channels, over that of E; in ascending order.
fn errors(found: &Volume, truth: &Volume) -> Vec<f64> {
    let square = |sh: &RadianceSh| -> f64 {
        sh.convolve().coefficients.as_flattened().iter().map(|&e| f64::from(e) * f64::from(e)).sum()
    };
    let error = |node: usize| {
        let (found, truth) = (found.node_sh(node), truth.node_sh(node));
        let mut difference = found;
        for (d, t) in difference.coefficients.as_flattened_mut().iter_mut().zip(truth.coefficients.as_flattened()) {
            *d -= t;
        }
        (square(&difference) / square(&truth)).sqrt()
    };
    let mut errors: Vec<f64> = (0..truth.node_count()).filter(|&node| truth.is_valid(node)).map(error).collect();
    errors.sort_by(f64::total_cmp);
    errors
}

#[test]
fn packed_box_keeps_the_stated_error_in_a_third_of_the_bytes() {
    let folder = Folder::new();
    bake_box(&folder, "exact.gdibl", &["--precision", "f32"]);
    bake_box(&folder, "half.gdibl", &["--precision", "f16"]);
    let exact = Volume::parse(&folder.read("exact.gdibl")).unwrap();
    let stored = |volume: &str| {
        let bytes = folder.read(volume);
        parse_header_and_sections(&bytes).unwrap().section(RADIANCE).unwrap().stored_size as f64
    };
    let mut last = stored("half.gdibl");
    for (flags, asked) in [(&[][..], None), (&["--precision", "packed:0.02"][..], Some(0.02))] {
        let report = bake_box(&folder, "packed.gdibl", flags);
        // A third of the noise, if nothing is asked for. The file says what it came to.
        let noise = report["relative_error"]["median"].as_f64().unwrap();
        let asked = asked.unwrap_or((noise / 3.0 * 1e5).floor() / 1e5);
        let precision = format!("packed:{asked}");
        assert_eq!(folder.inspect("packed.gdibl")["settings"]["quality.precision"], precision);
        let errors = errors(&Volume::parse(&folder.read("packed.gdibl")).unwrap(), &exact);
        let quantile = |share: f64| errors[(share * errors.len() as f64).ceil() as usize - 1];
        assert!(quantile(0.95) <= asked && quantile(0.95) > 0.95 * asked, "{precision}: {}", quantile(0.95));
        assert!(quantile(1.0) <= 1.6 * asked, "{precision}: {}", quantile(1.0));
        for (key, share) in [("median", 0.5), ("p95", 0.95), ("max", 1.0)] {
            let stated = report["packing"]["added_error"][key].as_f64().unwrap();
            assert!((stated - quantile(share)).abs() < 2e-5, "{precision}, {key}: {stated}");
        }
        let bytes = stored("packed.gdibl");
        println!("{precision}: {:.1} bytes per node, before {:.1}", bytes / 637.0, last / 637.0);
        assert!(bytes < last * if flags.is_empty() { 0.34 } else { 0.8 }, "{precision}: {bytes} bytes");
        last = bytes;
        // What the file says in its settings repeats it; with zstd no section is larger.
        bake_box(&folder, "again.gdibl", &["--precision", &precision]);
        assert_eq!(folder.read("again.gdibl"), folder.read("packed.gdibl"));
        bake_box(&folder, "small.gdibl", &["--precision", &precision, "--zstd"]);
        assert!(stored("small.gdibl") <= bytes);
        assert!(folder.read("small.gdibl").len() < folder.read("packed.gdibl").len());
        let found = folder.inspect("packed.gdibl");
        assert_eq!(found["precision"], "packed");
        assert_eq!(found["statistics"]["packing"], report["packing"]);
    }
    let text = folder.ok(&["inspect", "packed.gdibl"]);
    assert!(text.contains("L2 in packed, in steps of") && text.contains("added to the error of E"), "{text}");
    let compared: Value =
        serde_json::from_str(&folder.ok(&["compare", "packed.gdibl", "exact.gdibl", "--json", "--tolerance", "0.02"]))
            .unwrap();
    assert_eq!(compared["within_tolerance"], true);
    folder.ok(&["export", "packed.gdibl", "--to", "json", "-o", "packed.json"]);
}

#[test]
fn packed_file_is_the_same_on_any_number_of_threads() {
    let folder = Folder::new();
    bake_box(&folder, "one.gdibl", &["--precision", "packed", "--threads", "1"]);
    bake_box(&folder, "two.gdibl", &["--precision", "packed", "--threads", "3"]);
    assert_eq!(folder.read("one.gdibl"), folder.read("two.gdibl"));
}
