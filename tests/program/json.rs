//! What `--json` prints is one object that `docs/json.schema.json` describes, on every exit but 2.

use crate::common::{Folder, Level, Run, repository};
use serde_json::Value;

fn schema() -> jsonschema::Validator {
    let text = std::fs::read_to_string(repository("docs/json.schema.json")).expect("the schema");
    let schema: Value = serde_json::from_str(&text).expect("the schema is JSON");
    jsonschema::validator_for(&schema).expect("a JSON Schema")
}

fn inputs() -> Folder {
    let folder = Folder::new();
    Level::room([-2.0; 3], [2.0; 3]).write(&folder, "room.glb");
    // Not even: even light has no noise at all.
    folder.panorama("a.exr", 16, Some([0.0; 3]), |d| [1.0 + d.y.max(0.0) as f32; 3]);
    folder.panorama("b.exr", 16, Some([0.5, 0.0, 0.0]), |d| [1.0 + d.x.max(0.0) as f32; 3]);
    folder.sky("sky.exr", [1.0; 3]);
    folder.write("places.csv", "0,0,0,0,1,0\n");
    folder.write("cut.exr", &folder.read("a.exr")[..100]);
    let mut exotic = Level::room([-2.0; 3], [2.0; 3]);
    exotic.json["extensionsRequired"] = serde_json::json!(["EXT_lights_of_tomorrow"]);
    exotic.write(&folder, "exotic.glb");
    folder
}

fn report(validator: &jsonschema::Validator, run: &Run, line: &str) -> Value {
    let value: Value = serde_json::from_str(&run.out).unwrap_or_else(|error| panic!("{line}: {error}\n{}", run.out));
    let errors: Vec<String> =
        validator.iter_errors(&value).map(|error| format!("{}: {error}", error.instance_path())).collect();
    assert!(errors.is_empty(), "{line}: {}\n{}", errors.join("\n"), run.out);
    assert_eq!(value["exit"], run.code, "{line}");
    value
}

#[test]
fn every_verb_prints_what_the_schema_describes() {
    let (folder, validator) = (inputs(), schema());
    let bake = "bake room.glb --probes a.exr --counts 2,2,2 --samples 64";
    for (line, code) in [
        (bake.to_owned(), 0),
        (bake.to_owned(), 0), // unchanged
        (format!("{bake} --plan"), 0),
        (format!("{bake} --shard 1/1 -o all.shard"), 0),
        (format!("{bake} --prepare"), 0),
        ("assemble all.shard -o all.gdibl".into(), 0),
        (format!("{bake} --target-error 1e-9"), 5),
        ("inspect room.gdibl".into(), 0),
        ("sample room.gdibl --at places.csv".into(), 0),
        ("compare room.gdibl room.gdibl".into(), 0),
        ("cut room.gdibl --sh L1 -o small.gdibl".into(), 0),
        ("export room.gdibl --to json -o light.json".into(), 0),
        ("render room.glb --probes a.exr --size 8x8 --samples 1 -o a.png".into(), 0),
        ("probes suggest room.glb --most 1".into(), 0),
        ("probes coverage room.glb --probes a.exr".into(), 0),
        ("capture exotic.glb --auto".into(), 4),
        (
            "study room.glb --probes a.exr --reference room.gdibl --counts 2,2,2 --budgets 8,16 --repeats 2 -o s"
                .into(),
            0,
        ),
        // Nothing is written, and still it says why.
        ("bake missing.glb".into(), 3),
        ("bake room.glb --probes cut.exr".into(), 3),
        ("bake exotic.glb".into(), 4),
        ("bake room.glb".into(), 5),
        ("bake room.glb --probes a.exr --counts 400,400,400 --max-memory 0.1".into(), 1),
        ("inspect a.exr".into(), 3),
    ] {
        let words: Vec<&str> = line.split(' ').chain(["--json"]).collect();
        let run = folder.run(&words);
        assert_eq!(run.code, code, "{line}: {}", run.err);
        let value = report(&validator, &run, &line);
        let verb = line.split(' ').next().unwrap();
        assert_eq!(value["schema"], format!("gdibl-{verb}-1"));
        if code != 0 {
            assert!(run.err.contains(value["error"].as_str().unwrap()), "{line}: {}", run.err);
        }
    }
}

#[test]
fn a_missed_target_is_an_error_and_a_finding() {
    let (folder, validator) = (inputs(), schema());
    let line = "bake room.glb --probes b.exr --probes a.exr --counts 2,2,2 --samples 64 --target-error 1e-9 --json";
    let run = folder.run(&line.split(' ').collect::<Vec<_>>());
    assert_eq!(run.code, 5, "{}", run.err);
    let value = report(&validator, &run, line);
    let findings = value["findings"].as_array().unwrap();
    assert!(findings.iter().any(|finding| finding["id"] == "missed-target"), "{findings:?}");
    // The volume was written, and its report is there.
    assert_eq!(value["nodes"], 8);
    assert!(folder.exists("room.gdibl"));
}

#[test]
fn a_command_line_that_makes_no_sense_prints_no_object() {
    let folder = inputs();
    for line in ["bake room.glb --json --samples 0", "bake room.glb --json --nonsense"] {
        let run = folder.run(&line.split(' ').collect::<Vec<_>>());
        assert_eq!((run.code, run.out.as_str()), (2, ""), "{line}");
    }
}
