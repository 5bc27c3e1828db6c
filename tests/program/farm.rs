//! Bakes that are killed, repeated, divided and run side by side. `tools/farm` has the tests that take minutes.

use crate::capture::lamp_room;
use crate::common::{Folder, Run, solid_of};
use serde_json::Value;
use std::process::Stdio;
use std::time::Duration;

/// Slow enough to be stopped on its way.
const SLOW: [&str; 6] = ["bake", "room.glb", "--counts", "5,4,5", "--samples", "8192"];
const QUICK: [&str; 6] = ["bake", "room.glb", "--counts", "5,3,4", "--samples", "256"];

/// Starts a bake and calls `then` once some of its nodes are kept.
fn on_the_way(folder: &Folder, arguments: &[&str], output: &str, then: impl FnOnce(&mut std::process::Child)) -> Run {
    let partial = folder.path(&format!("{output}.partial"));
    let kept = || std::fs::metadata(&partial).map_or(0, |found| found.len());
    let before = kept();
    let mut command = folder.command(&[arguments, &["-o", output]].concat());
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program runs");
    // The head, the first pass, and some nodes.
    while kept() <= before.max(24_000) && child.try_wait().unwrap().is_none() {
        std::thread::sleep(Duration::from_millis(1));
    }
    then(&mut child);
    Run::of(&child.wait_with_output().unwrap())
}

fn baked(folder: &Folder, arguments: &[&str], output: &str) -> Vec<u8> {
    folder.ok(&[arguments, &["-o", output]].concat());
    folder.read(output)
}

#[test]
fn a_bake_that_was_killed_goes_on_and_gives_the_same_bytes() {
    let folder = lamp_room(|_| {});
    let undisturbed = baked(&folder, &SLOW, "one.gdibl");
    for round in 0..3 {
        on_the_way(&folder, &SLOW, "a.gdibl", |child| child.kill().unwrap());
        assert!(!folder.exists("a.gdibl") && folder.exists("a.gdibl.partial"), "round {round}");
    }
    // A torn end is not believed.
    let mut kept = folder.read("a.gdibl.partial");
    kept.truncate(kept.len() - 7);
    folder.write("a.gdibl.partial", kept);
    let run = folder.run(&[&SLOW[..], &["-o", "a.gdibl", "--threads", "1"]].concat());
    assert!(run.code == 0 && run.err.contains("goes on from"), "{}", run.err);
    assert!(folder.read("a.gdibl") == undisturbed);
    assert!(!folder.exists("a.gdibl.partial"));
}

#[test]
fn what_is_left_of_another_bake_is_not_taken_and_it_is_said_what_differs() {
    let folder = lamp_room(|_| {});
    on_the_way(&folder, &SLOW, "a.gdibl", |child| child.kill().unwrap());
    let run = folder.run(&[&SLOW[..], &["-o", "a.gdibl", "--seed", "1"]].concat());
    assert!(run.code == 0 && run.err.contains("differs in quality.seed; starts anew"), "{}", run.err);
    assert!(folder.read("a.gdibl") == baked(&folder, &[&SLOW[..], &["--seed", "1"]].concat(), "b.gdibl"));
    for junk in [&b""[..], b"GDIBLPA1", &[0; 300]] {
        folder.write("c.gdibl.partial", junk);
        folder.ok(&[&QUICK[..], &["-o", "c.gdibl", "--force"]].concat());
    }
    assert!(folder.read("c.gdibl") == baked(&folder, &QUICK, "d.gdibl"));
}

#[test]
fn a_bake_with_a_budget_goes_on_with_the_nodes_that_it_chose() {
    let folder = lamp_room(|_| {});
    // It has time for all: 512 nodes.
    let bake = ["bake", "room.glb", "--max-nodes", "512", "--samples", "1024", "--max-seen-error", "1e-6"];
    let with_budget = [&bake[..], &["--budget", "1000"]].concat();
    on_the_way(&folder, &with_budget, "a.gdibl", |child| child.kill().unwrap());
    let run = folder.run(&[&with_budget[..], &["-o", "a.gdibl"]].concat());
    assert!(run.code == 5 && run.err.contains("goes on from"), "{}", run.err);
    let again = folder.run(&[&with_budget[..], &["-o", "a.gdibl"]].concat());
    assert!(again.code == 5 && again.out.contains("unchanged"), "{}", again.out);
    // Another budget is another bake.
    let other = folder.run(&[&bake[..], &["--budget", "2000", "-o", "a.gdibl"]].concat());
    assert!(!other.out.contains("unchanged"), "{}", other.out);
    folder.run(&[&bake[..], &["-o", "b.gdibl"]].concat());
    let nodes = |file: &str| folder.inspect(file)["statistics"]["nodes"].clone();
    assert_eq!(nodes("a.gdibl"), nodes("b.gdibl"));
}

#[cfg(unix)]
#[test]
fn a_bake_stops_when_it_is_asked_to_and_goes_on_later() {
    let folder = lamp_room(|_| {});
    for signal in ["-INT", "-TERM"] {
        let ask = |child: &mut std::process::Child| {
            std::process::Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
        };
        let run = on_the_way(&folder, &SLOW, "a.gdibl", ask);
        assert!(run.code == 130 && run.err.contains("interrupted"), "{run:?}");
    }
    let run = folder.run(&[&SLOW[..], &["-o", "a.gdibl"]].concat());
    assert!(run.code == 0 && run.err.contains("goes on from"), "{}", run.err);
    assert!(folder.read("a.gdibl") == baked(&folder, &SLOW, "one.gdibl"));
}

#[test]
fn a_second_bake_of_an_output_waits_and_has_nothing_to_do() {
    let folder = lamp_room(|_| {});
    let mut second = None;
    let first = on_the_way(&folder, &SLOW, "a.gdibl", |_| {
        second = Some(folder.run(&[&SLOW[..], &["-o", "a.gdibl"]].concat()));
    });
    let second = second.unwrap();
    assert_eq!((first.code, second.code), (0, 0), "{} {}", first.err, second.err);
    assert!(second.err.contains("this one waits") && second.out.contains("unchanged"), "{second:?}");
    assert!(!folder.exists("a.gdibl.partial"));
}

#[test]
fn what_is_unchanged_is_not_baked_again() {
    let folder = lamp_room(|_| {});
    let bake = |more: &[&str]| {
        let run = folder.run(&[&QUICK[..], &["-o", "a.gdibl"], more].concat());
        assert_eq!(run.code, 0, "{}", run.err);
        run.out.contains("unchanged")
    };
    assert!(!bake(&[]));
    let first = folder.read("a.gdibl");
    assert!(bake(&[]) && bake(&["--threads", "1"]));
    assert!(!bake(&["--force"]));
    assert!(folder.read("a.gdibl") == first);
    // Damage of any section is found.
    let mut damaged = first.clone();
    let last = damaged.len() - 1;
    damaged[last] ^= 1;
    for bytes in [&damaged[..], &first[..first.len() / 2], b""] {
        folder.write("a.gdibl", bytes);
        assert!(!bake(&[]) && folder.read("a.gdibl") == first);
    }
    // A setting, and a level of another content at the same path.
    assert!(!bake(&["--seed", "1"]) && bake(&["--seed", "1"]));
    let other = lamp_room(|level| level.json["materials"][0]["doubleSided"] = true.into());
    folder.write("room.glb", other.read("room.glb"));
    assert!(!bake(&["--seed", "1"]));
    // The report says so.
    let report: Value =
        serde_json::from_str(&folder.ok(&[&QUICK[..], &["-o", "a.gdibl", "--seed", "1", "--json"]].concat()))
            .expect("JSON");
    assert_eq!((&report["unchanged"], &report["nodes"]), (&true.into(), &60.into()));
}

#[test]
fn a_bound_that_was_missed_is_missed_of_what_is_unchanged() {
    let folder = lamp_room(|_| {});
    let bake = |more: &[&str]| folder.run(&[&QUICK[..], &["-o", "a.gdibl"], more].concat());
    for bound in [["--target-error", "1e-6"], ["--max-seen-error", "1e-6"]] {
        let (first, second) = (bake(&bound), bake(&bound));
        assert_eq!((first.code, second.code), (5, 5), "{bound:?}: {} {}", first.err, second.err);
        assert!(!first.out.contains("unchanged") && second.out.contains("unchanged"), "{bound:?}");
    }
}

#[test]
fn a_depfile_names_all_that_was_read() {
    let folder = lamp_room(|_| {});
    folder.sky("a sky.exr", [1.0; 3]);
    folder.write("BAKE.toml", "level = \"room.glb\"\ndistant = \"a sky.exr\"\noutput = \"a b.gdibl\"\n");
    for _ in 0..2 {
        folder.ok(&["bake", "BAKE.toml", "--counts", "2,2,2", "--samples", "16", "--depfile", "a.d"]);
        let text = String::from_utf8(folder.read("a.d")).unwrap();
        let words: Vec<&str> = text.split_whitespace().filter(|word| *word != "\\").collect();
        assert_eq!(words, ["a\\", "b.gdibl:", "BAKE.toml", "a\\", "sky.exr", "room.glb"], "{text}");
    }
}

#[test]
fn shards_in_any_order_give_the_bytes_of_one_bake() {
    // With an object that no probe has seen.
    let folder = lamp_room(|level| {
        let node = serde_json::json!({ "extras": { "gdibl_role": "scene" } });
        level.object(&solid_of([-0.5, 0.0, -0.5], [0.5, 0.6, 0.5]), 0, node);
    });
    folder.write("BAKE.toml", "level = \"room.glb\"\n[capture]\nwidth = 32\nsamples = 4\nmost = 2\n");
    // Captured probes and a pilot; coarse grids that tell the spacing; a sparse grid.
    for (bake, counts) in [
        ("bake BAKE.toml --counts 5,3,4 --method gdibl --target-error 0.02 --samples 2048", &[1, 3, 8][..]),
        ("bake room.glb --max-nodes 512 --samples 64", &[3]),
        ("bake room.glb --counts 9,9,9 --tolerance 0.05 --samples 64", &[2]),
    ] {
        let bake: Vec<&str> = bake.split(' ').collect();
        let one = folder.run(&[&bake[..], &["-o", "one.gdibl"]].concat());
        assert!([0, 5].contains(&one.code), "{}", one.err);
        for &count in counts {
            let names: Vec<String> = (1..=count).rev().map(|index| format!("{index}.shard")).collect();
            for (name, index) in names.iter().zip((1..=count).rev()) {
                let (shard, threads) = (format!("{index}/{count}"), ["1", "2", "7"][index % 3]);
                folder.ok(&[&bake[..], &["--shard", &shard, "-o", name, "--threads", threads]].concat());
            }
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            let all = folder.run(&[&["assemble"], &names[..], &["-o", "all.gdibl"]].concat());
            assert_eq!(all.code, one.code, "{}", all.err);
            assert!(folder.read("all.gdibl") == folder.read("one.gdibl"), "{bake:?} in {count} shards");
        }
    }
    let run = folder.run(&["bake", "room.glb", "--budget", "1", "--shard", "1/2"]);
    assert!(run.code == 2 && run.err.contains("--budget"), "{}", run.err);
}

#[test]
fn every_bad_shard_is_named() {
    let folder = lamp_room(|_| {});
    let shard = |index: u32, count: u32, more: &[&str]| {
        let (name, shard) = (format!("{index}of{count}"), format!("{index}/{count}"));
        folder.ok(&[&QUICK[..], &["--shard", &shard, "-o", &name], more].concat())
    };
    for index in 1..=3 {
        shard(index, 3, &[]);
    }
    shard(1, 2, &[]);
    let assemble = |shards: &[&str], words: &[&str]| {
        let run = folder.run(&[&["assemble", "-o", "all.gdibl"], shards].concat());
        assert!(run.code == 3 && !folder.exists("all.gdibl"), "{shards:?}: {}", run.err);
        words.iter().for_each(|word| assert!(run.err.contains(word), "{shards:?}: {word}: {}", run.err));
    };
    assemble(&["1of3", "3of3"], &["shard 2/3 is missing"]);
    assemble(&["1of3"], &["shard 2/3 is missing", "shard 3/3 is missing"]);
    folder.write("copy", folder.read("2of3"));
    assemble(&["1of3", "2of3", "copy", "3of3"], &["copy: is shard 2/3, and so is 2of3"]);
    assemble(&["1of3", "2of3", "3of3", "1of2"], &["1of2: is shard 1/2, the others are of 3"]);
    // Damage at any place.
    let whole = folder.read("2of3");
    for place in [3, 20, 46, 60, whole.len() / 2, whole.len() - 1] {
        let mut damaged = whole.clone();
        damaged[place] ^= 1;
        folder.write("2of3", damaged);
        assemble(&["1of3", "2of3", "3of3"], &["2of3: "]);
    }
    for length in [0, 30, whole.len() / 2, whole.len() - 16, whole.len() - 1] {
        folder.write("2of3", &whole[..length]);
        assemble(&["1of3", "2of3", "3of3"], &["2of3: "]);
    }
    // A rerun repairs that one, and touches no other.
    assert!(!shard(2, 3, &[]).contains("unchanged") && shard(1, 3, &[]).contains("unchanged"));
    // Of another bake.
    shard(2, 3, &["--seed", "1"]);
    assemble(&["1of3", "2of3", "3of3"], &["2of3: is of another bake, which differs in quality.seed", "2/3 is missing"]);
    shard(2, 3, &[]);
    // The level was saved after it was baked.
    let level = folder.read("room.glb");
    folder
        .write("room.glb", lamp_room(|level| level.json["materials"][0]["doubleSided"] = true.into()).read("room.glb"));
    assemble(&["1of3", "2of3", "3of3"], &["1of3: was baked from other inputs", "the level room.glb differs"]);
    folder.write("room.glb", level);
    folder.ok(&["assemble", "3of3", "1of3", "2of3", "-o", "all.gdibl"]);
    assert!(folder.read("all.gdibl") == baked(&folder, &QUICK, "one.gdibl"));
}

#[test]
fn what_shards_have_in_common_is_found_once() {
    let folder = lamp_room(|_| {});
    let before = folder.cached().len();
    folder.ok(&[&QUICK[..], &["--prepare"]].concat());
    let entries = folder.cached();
    assert_eq!(entries.len(), before + 1, "{entries:?}");
    let kept = std::fs::read(&entries[0]).unwrap();
    folder.ok(&[&QUICK[..], &["--shard", "1/1", "-o", "a.shard"]].concat());
    assert!(std::fs::read(&entries[0]).unwrap() == kept && folder.cached() == entries);
    // Damaged, it is found anew.
    std::fs::write(&entries[0], &kept[..kept.len() - 1]).unwrap();
    let run = folder.run(&[&QUICK[..], &["--shard", "1/1", "-o", "b.shard"]].concat());
    assert!(run.code == 0 && run.err.contains("damaged"), "{}", run.err);
    assert!(
        folder.read("a.shard").len() == folder.read("b.shard").len() && std::fs::read(&entries[0]).unwrap() == kept
    );
}

#[test]
fn progress_without_a_terminal_is_what_was_asked_for() {
    let folder = lamp_room(|_| {});
    let run = folder.run(&[&QUICK[..], &["-o", "a.gdibl", "--progress", "none"]].concat());
    assert!(run.code == 0 && run.err.is_empty(), "{}", run.err);
    let run = folder.run(&[&QUICK[..], &["-o", "b.gdibl", "--progress", "loud"]].concat());
    assert_eq!(run.code, 2);
    // Every line of JSON is one.
    let run = folder.run(&[&SLOW[..], &["-o", "c.gdibl", "--progress", "json"]].concat());
    for line in run.err.lines() {
        let line: Value = serde_json::from_str(line).unwrap_or_else(|error| panic!("{line}: {error}"));
        assert!(line["progress"] == "nodes" && line["total"] == 100 && line["done"].as_u64().unwrap() <= 100, "{line}");
    }
}
