//! Files of older and newer programs: records with more fields, and with fewer.

use crate::common::{Folder, Level, with_sections};

/// The same file with other bytes in one section.
fn with_section(file: &[u8], id: &[u8; 4], change: impl Fn(&mut Vec<u8>)) -> Vec<u8> {
    let mut changed = 0;
    let bytes = with_sections(file, |found, bytes| {
        if found == id {
            change(bytes);
            changed += 1;
        }
    });
    assert_eq!(changed, 1, "the file has the section");
    bytes
}

fn baked() -> Folder {
    let folder = Folder::new();
    Level::room([-2.0; 3], [2.0; 3]).write(&folder, "room.glb");
    folder.constant("a.exr", [0.0; 3], [1.0; 3]);
    folder.bake(&["room.glb", "--probes", "a.exr", "--counts", "3,3,3", "--samples", "64"]);
    folder
}

fn all_verbs_read(folder: &Folder, file: &str) {
    folder.inspect(file);
    folder.ok(&["compare", file, "room.gdibl"]);
    folder.ok(&["cut", file, "--coarser", "1", "-o", "small.gdibl"]);
    folder.ok(&["export", file, "--to", "json", "-o", "light.json"]);
}

#[test]
fn files_with_one_more_field_in_each_record_are_read() {
    let folder = baked();
    let mut file = folder.read("room.gdibl");
    for id in [b"SETT", b"PLAN", b"PROB", b"STAT"] {
        file = with_section(&file, id, |bytes| bytes.extend([1; 9]));
    }
    folder.write("newer.gdibl", file);
    all_verbs_read(&folder, "newer.gdibl");
    for part in ["settings", "plan", "probes", "statistics"] {
        assert_eq!(folder.inspect("newer.gdibl")[part], folder.inspect("room.gdibl")[part], "{part}");
    }
}

#[test]
fn files_whose_records_end_after_the_fields_of_the_first_version_are_read() {
    let folder = baked();
    let text = |bytes: &[u8], at: usize| 8 + u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
    let file = with_section(&folder.read("room.gdibl"), b"SETT", |bytes| {
        // Six texts, a number, an option and a number.
        let mut end = (0..6).fold(0, |at, _| at + text(bytes, at)) + 8;
        end += if bytes[end] == 0 { 1 } else { 9 };
        bytes.truncate(end + 8);
    });
    // No finding, then the stages.
    let file = with_section(&file, b"STAT", |bytes| {
        let name = bytes.windows(5).position(|window| window == b"nodes").expect("the first stage");
        bytes.truncate(name - 16);
    });
    folder.write("older.gdibl", file);
    all_verbs_read(&folder, "older.gdibl");
    let found = folder.inspect("older.gdibl");
    assert_eq!(found["settings"]["quality.samples"], 64, "{}", found["settings"]);
    assert_eq!((&found["statistics"]["nodes"], &found["statistics"]["stages"]), (&27.into(), &serde_json::json!([])));
}

#[test]
fn records_that_end_within_a_field_are_damaged() {
    let folder = baked();
    for id in [b"SETT", b"PLAN", b"PROB", b"STAT"] {
        let file = with_section(&folder.read("room.gdibl"), id, |bytes| bytes.truncate(bytes.len() - 1));
        folder.write("cut.gdibl", file);
        let run = folder.run(&["inspect", "cut.gdibl"]);
        assert_eq!(run.code, 3, "{}", run.err);
        assert!(run.err.contains(std::str::from_utf8(id).unwrap()), "{}", run.err);
    }
}
