//! Pages to look at: what goes into them, what may not, and whether their program is what its sources build.

use crate::common::{Folder, Level, repository};
use gdibl_runtime::format::crc32;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// A room, a probe in it, and its volume.
fn baked() -> Folder {
    let folder = Folder::new();
    Level::room([-2.0; 3], [2.0; 3]).write(&folder, "room.glb");
    folder.panorama("probe.exr", 16, Some([0.5, 0.0, 0.0]), |d| [1.0 + d.x.max(0.0) as f32; 3]);
    folder.bake(&["room.glb", "--probes", "probe.exr", "--counts", "3,3,3", "--samples", "64"]);
    folder
}

/// The text of an element of a page.
fn element<'a>(page: &'a str, id: &str) -> &'a str {
    let start = page.find(&format!("id=\"{id}\">")).unwrap_or_else(|| panic!("no element {id}"));
    let text = &page[start + id.len() + 6..];
    &text[..text.find("</script>").expect("it ends")]
}

fn data(page: &str) -> Value {
    serde_json::from_str(element(page, "data")).expect("the page's data are JSON")
}

fn page(folder: &Folder, name: &str) -> String {
    String::from_utf8(folder.read(name)).expect("pages are UTF-8")
}

/// The bytes of base64.
fn bytes_of(text: &str) -> Vec<u8> {
    let alphabet = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut bytes = Vec::new();
    for four in text.as_bytes().chunks(4) {
        let digits = four.iter().filter_map(|c| alphabet.iter().position(|a| a == c));
        let word = digits.clone().fold(0, |word, digit| word << 6 | digit) << (6 * (4 - digits.clone().count()));
        bytes.extend([16, 8, 0].map(|shift| (word >> shift) as u8).into_iter().take(digits.count() - 1));
    }
    bytes
}

#[test]
fn a_page_holds_the_volume_byte_for_byte_and_what_inspect_says() {
    let folder = baked();
    folder.ok(&["inspect", "room.gdibl", "room.glb", "-o", "report.html"]);
    let page = page(&folder, "report.html");
    let data = data(&page);
    let volume = &data["volumes"][0];
    assert!(bytes_of(element(&page, &format!("blob-{}", volume["bytes"]))) == folder.read("room.gdibl"));
    let said: Value = serde_json::from_str(&folder.ok(&["inspect", "room.gdibl", "--json"])).unwrap();
    for name in ["file", "bytes", "sections", "volume", "worst_nodes", "worst_seen", "settings", "command"] {
        assert_eq!(volume["report"][name], said[name], "{name}");
    }
    assert_eq!(data["level"]["trianglesOfLevel"], 12);
    assert_eq!(bytes_of(element(&page, &format!("blob-{}", data["level"]["triangles"]))).len(), 12 * 3 * 4);
}

#[test]
fn a_bake_writes_its_page_with_pictures_of_its_probes() {
    let folder = baked();
    let line = "bake room.glb --probes probe.exr --counts 3,3,3 --samples 64 -o again.gdibl --report again.html";
    folder.ok(&line.split(' ').collect::<Vec<_>>());
    let data = data(&page(&folder, "again.html"));
    assert_eq!(data["volumes"][0]["name"], "again.gdibl");
    assert_eq!((&data["probes"][0]["name"], &data["probes"][0]["width"]), (&"probe.exr".into(), &16.into()));
    // And the volume is that of a bake without a page.
    assert!(folder.read("again.gdibl") == folder.read("room.gdibl"));
}

#[test]
fn a_comparison_has_both_volumes() {
    let folder = baked();
    folder.bake(&["room.glb", "--probes", "probe.exr", "--counts", "3,3,3", "--samples", "32", "-o", "b.gdibl"]);
    folder.ok(&["compare", "room.gdibl", "b.gdibl", "--level", "room.glb", "-o", "diff.html"]);
    let data = data(&page(&folder, "diff.html"));
    let names: Vec<&Value> = data["volumes"].as_array().unwrap().iter().map(|volume| &volume["name"]).collect();
    assert_eq!(names, ["room.gdibl", "b.gdibl"]);
    assert!(data["comparison"]["all"]["relative_rmse"].as_f64().unwrap() > 0.0);
}

#[test]
fn names_of_files_do_not_become_markup() {
    let folder = baked();
    let name = "<script>alert(1)<!--\"'&\u{1}";
    folder.write(&format!("{name}.glb"), folder.read("room.glb"));
    let volume = format!("{name}.gdibl");
    folder.ok(&["bake", &format!("{name}.glb"), "--probes", "probe.exr", "--counts", "2,2,2", "--samples", "16"]);
    folder.ok(&["inspect", &volume, &format!("{name}.glb"), "-o", "report.html"]);
    let page = page(&folder, "report.html");
    assert!(!page.contains(name) && !page.contains("<script>alert"));
    assert_eq!(data(&page)["volumes"][0]["name"], volume.as_str());
    // The template's own, and no more.
    let template = std::fs::read_to_string(repository("integrations/report/bundle/report.html")).unwrap();
    assert_eq!(page.matches("<script>").count(), template.matches("<script>").count());
}

#[test]
fn what_makes_no_page_is_refused_and_leaves_nothing_behind() {
    let folder = baked();
    let volume = folder.read("room.gdibl");
    folder.write("cut.gdibl", &volume[..volume.len() - 10]);
    let mut changed = volume;
    let middle = changed.len() / 2;
    changed[middle] ^= 1;
    folder.write("changed.gdibl", changed);
    let before = folder.names();
    for (line, code, words) in [
        ("inspect cut.gdibl -o a.html", 3, "cut.gdibl"),
        ("inspect room.gdibl changed.gdibl -o a.html", 3, "changed.gdibl"),
        ("inspect probe.exr -o a.html", 3, "probe.exr"),
        ("inspect room.gdibl missing.glb -o a.html", 3, "missing.glb"),
        ("inspect room.gdibl room.glb room.glb -o a.html", 2, "one level"),
        ("inspect room.gdibl room.glb", 2, "-o"),
        ("inspect room.gdibl room.gdibl", 2, "one volume"),
        ("inspect room.gdibl -o missing/a.html", 1, "missing/a.html"),
        ("compare room.gdibl cut.gdibl -o a.html", 3, "cut.gdibl"),
        ("bake room.glb --probes probe.exr --report missing/a.html -o b.gdibl", 1, "missing/a.html"),
    ] {
        let run = folder.run(&line.split(' ').collect::<Vec<_>>());
        assert_eq!(run.code, code, "{line}: {}", run.err);
        assert!(run.err.contains(words), "{line}: {}", run.err);
        assert_eq!(folder.names(), before, "{line} left something behind");
    }
}

#[test]
fn inspect_names_the_worst_places_and_how_to_bake_it_again() {
    let folder = baked();
    let text = folder.ok(&["inspect", "room.gdibl", "--worst", "2"]);
    for words in ["gdibl bake room.glb --probes probe.exr ", " --counts 3,3,3 --samples 64 "] {
        assert!(text.contains(words), "{words}: {text}");
    }
    let said: Value = serde_json::from_str(&folder.ok(&["inspect", "room.gdibl", "--worst", "2", "--json"])).unwrap();
    let noise = &said["worst_nodes"][0];
    assert_eq!((&noise["figure"], noise["nodes"].as_array().unwrap().len()), (&"noise".into(), 2));
    assert_eq!(noise["nodes"][0]["value"], said["volume"]["relative_error"]["max"], "the worst comes first");
    let command = said["command"].as_str().unwrap().split(' ').skip(1);
    folder.ok(&command.chain(["-o", "again.gdibl"]).collect::<Vec<_>>());
    assert_eq!(
        folder.irradiance("again.gdibl", &[[0.3, 0.2, 0.1, 0.0, 1.0, 0.0]]),
        folder.irradiance("room.gdibl", &[[0.3, 0.2, 0.1, 0.0, 1.0, 0.0]])
    );
}

#[test]
fn a_table_has_every_node_in_one_of_its_rows() {
    let folder = baked();
    let text = folder.ok(&["inspect", "room.gdibl", "--csv"]);
    let mut rows = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let head = rows.next().unwrap();
    let column = |name: &str| head.iter().position(|column| *column == name).expect("a column");
    let nodes: u32 = rows.clone().map(|row| row[column("nodes")].parse::<u32>().unwrap()).sum();
    assert_eq!(nodes, 27);
    for row in rows {
        assert_eq!(row.len(), head.len());
        let [median, max] = ["noise_median", "noise_max"].map(|name| row[column(name)].parse::<f64>().unwrap());
        assert!(median <= max, "{row:?}");
    }
}

/// All files of a file or folder, by name.
fn files_of(path: &str, files: &mut Vec<String>) {
    let place = repository(path);
    if place.is_file() {
        return files.push(path.into());
    }
    for entry in std::fs::read_dir(&place).unwrap_or_else(|error| panic!("{path}: {error}")) {
        files_of(&format!("{path}/{}", entry.unwrap().file_name().to_string_lossy()), files);
    }
}

/// As `integrations/report/build.mjs` has it.
fn checksum(sources: &[&str]) -> String {
    let mut files = Vec::new();
    sources.iter().for_each(|source| files_of(source, &mut files));
    files.sort();
    let mut all = Vec::new();
    for file in &files {
        all.extend(file.bytes().chain([0]));
        all.extend(std::fs::read::<PathBuf>(repository(file)).unwrap());
        all.push(0);
    }
    format!("{:08x}", crc32(&all))
}

#[test]
fn the_pages_program_is_what_its_sources_build() {
    let page = [
        "integrations/report/src",
        "integrations/report/build.mjs",
        "integrations/report/package-lock.json",
        "integrations/web/gdibl.mjs",
    ];
    let module =
        ["crates/runtime/src", "crates/runtime/Cargo.toml", "crates/runtime-c/src", "crates/runtime-c/Cargo.toml"];
    let bundle = std::fs::read_to_string(Path::new(&repository("integrations/report/bundle/report.html"))).unwrap();
    let expected = format!("from sources: page {}, module {} -->", checksum(&page), checksum(&module));
    assert!(
        bundle.contains(&expected),
        "integrations/report/bundle/report.html is not built from its sources as they are ({expected}): run `npm ci && \
         node build.mjs` in integrations/report"
    );
}
