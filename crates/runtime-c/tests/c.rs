//! The C example, compiled by the system's C compiler, prints what the Rust runtime says.

mod common;

use common::*;
use gdibl_runtime::Volume;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use tempfile::TempDir;

const CC: &str = "cc";
const CXX: &str = "c++";

fn in_package(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

fn compiler(name: &str) -> Command {
    let mut command = Command::new(name);
    command.args(["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I"]).arg(in_package("include"));
    command
}

#[track_caller]
fn run(command: &mut Command) -> Output {
    let output = command.output().unwrap();
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{command:?}: {}\n{out}\n{err}", output.status);
    output
}

/// The example, linked with one of the libraries.
fn compile_example(folder: &TempDir, library: &Path) -> PathBuf {
    let program = folder.path().join(format!("sample_{}", library.extension().unwrap().display()));
    let mut command = compiler(CC);
    command.args(["-std=c99"]).arg(in_package("examples/sample.c")).arg(library);
    command.arg(format!("-Wl,-rpath,{}", library.parent().unwrap().display()));
    // What Rust's standard library asks of the system; the shared library brings it itself.
    run(command.args(["-lpthread", "-ldl", "-lm", "-o"]).arg(&program));
    program
}

#[test]
fn the_c_example_agrees_with_rust_linked_either_way() {
    if cfg!(windows) || !is_there(CC) {
        return skip("the_c_example_agrees_with_rust_linked_either_way", "no C compiler `cc`");
    }
    let folder = TempDir::new().unwrap();
    let built = build_library("build", &[]);
    for library in [with_extension(&built, &["a"]), with_extension(&built, &["so", "dylib"])] {
        let program = compile_example(&folder, &library);
        for form in FORMS {
            let bytes = form.bytes();
            let path = folder.path().join("volume.gdibl");
            std::fs::write(&path, &bytes).unwrap();
            let (found, err) = ask(&folder, &program, &path);
            let truth = Answers::of(&Volume::parse(&bytes).unwrap());

            let what = format!("{} {form:?}", library.display());
            let largest = assert_near(&what, &found.irradiance, &truth.irradiance, form.tolerance());
            println!("{what}: {largest:e}");
            assert!(found.validity == truth.validity, "{what}: validity");
            assert_eq!(err.matches("outside the volume").count(), truth.outside, "{what}");
            let about = format!("60 nodes, L{}, from -1 0.5 2 to 3 2 5\n", form.bands);
            assert!(err.contains(&about), "{what}: {err}");
        }
    }
}

/// What is said to all queries.
struct Answers {
    irradiance: Vec<[f32; 3]>,
    validity: Vec<f32>,
    outside: usize,
}

impl Answers {
    fn of(volume: &Volume) -> Answers {
        let samples: Vec<_> = queries().into_iter().map(|(position, normal)| volume.sample(position, normal)).collect();
        let normals = queries().into_iter().map(|(_, normal)| normal);
        Answers {
            irradiance: samples.iter().zip(normals).map(|(s, normal)| s.sh.convolve().evaluate(normal)).collect(),
            validity: samples.iter().map(|sample| sample.validity).collect(),
            outside: samples.iter().filter(|sample| !sample.inside).count(),
        }
    }
}

fn ask(folder: &TempDir, program: &Path, volume: &Path) -> (Answers, String) {
    let mut lines = String::new();
    for (position, normal) in queries() {
        // All digits, for C reads doubles.
        let [[x, y, z], [nx, ny, nz]] = [position, normal].map(|vector| vector.map(f64::from));
        writeln!(lines, "{x},{y},{z},{nx},{ny},{nz}").unwrap();
    }
    let input = folder.path().join("queries.csv");
    std::fs::write(&input, lines).unwrap();
    let input = Stdio::from(std::fs::File::open(input).unwrap());
    let output = run(Command::new(program).arg(volume).stdin(input));
    let mut answers = Answers { irradiance: Vec::new(), validity: Vec::new(), outside: 0 };
    for line in String::from_utf8(output.stdout).unwrap().lines() {
        let numbers: Vec<f32> = line.split(',').map(|number| number.parse().unwrap()).collect();
        let [r, g, b, validity] = numbers[..] else { panic!("{line}") };
        answers.irradiance.push([r, g, b]);
        answers.validity.push(validity);
    }
    (answers, String::from_utf8(output.stderr).unwrap())
}

#[test]
fn the_c_example_says_what_is_wrong() {
    if cfg!(windows) || !is_there(CC) {
        return skip("the_c_example_says_what_is_wrong", "no C compiler `cc`");
    }
    let folder = TempDir::new().unwrap();
    let program = compile_example(&folder, &with_extension(&build_library("build", &[]), &["so", "dylib"]));
    let path = folder.path().join("volume.gdibl");
    let whole = FORMS[0].bytes();
    std::fs::write(&path, &whole).unwrap();
    let output = run(Command::new(&program).arg(&path).args(["1", "1", "3", "0", "1", "0"]));
    assert_eq!(String::from_utf8(output.stdout).unwrap().lines().count(), 1);

    let output = Command::new(&program).arg(&path).args(["1", "1", "3", "0", "1", "up"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    std::fs::write(&path, &whole[..whole.len() - 1]).unwrap();
    let output = Command::new(&program).arg(&path).output().unwrap();
    assert_eq!(output.status.code(), Some(3));
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(message.contains("invalid volume") && message.contains("expected"), "{message}");
}

#[test]
fn the_header_is_cpp_too() {
    if cfg!(windows) || !is_there(CXX) {
        return skip("the_header_is_cpp_too", "no C++ compiler `c++`");
    }
    let folder = TempDir::new().unwrap();
    let source = folder.path().join("header.cpp");
    std::fs::write(&source, "#include \"gdibl.h\"\nint main() { return gdibl_node_count(nullptr) != 0; }\n").unwrap();
    run(compiler(CXX).args(["-std=c++11", "-fsyntax-only"]).arg(source));
}
