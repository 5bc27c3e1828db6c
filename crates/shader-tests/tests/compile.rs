//! The shaders compile: in each language, as compute, vertex and fragment shaders, for each compiler that is here.

use gdibl_shader_tests::{Stage, glsl, hlsl, skip, wgsl};
use naga::front::{glsl as glsl_front, wgsl as wgsl_front};
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use std::process::Command;

const STAGES: [Stage; 3] = [Stage::Compute, Stage::Vertex, Stage::Fragment];

/// Nothing that WebGPU has not always is used. naga counts `unpack2x16float` as a capability, since OpenGL ES 2 lacks it.
fn validate(module: &naga::Module) -> ModuleInfo {
    Validator::new(ValidationFlags::all(), Capabilities::SHADER_FLOAT16_IN_FLOAT32)
        .validate(module)
        .unwrap_or_else(|error| panic!("{error:?}"))
}

/// Where each field of the uniform buffer is, and its size.
fn uniform_layout(module: &naga::Module) -> (Vec<u32>, u32) {
    let is_uniform = |variable: &naga::GlobalVariable| variable.space == naga::AddressSpace::Uniform;
    let (_, variable) = module.global_variables.iter().find(|(_, variable)| is_uniform(variable)).unwrap();
    match &module.types[variable.ty].inner {
        naga::TypeInner::Struct { members, span } => (members.iter().map(|member| member.offset).collect(), *span),
        other => panic!("{other:?}"),
    }
}

/// As `gdibl_runtime::gpu` documents them.
const DOCUMENTED_LAYOUT: ([u32; 10], u32) = ([0, 12, 16, 28, 32, 44, 48, 52, 56, 60], 64);

fn check_layout(module: &naga::Module) {
    let (offsets, size) = uniform_layout(module);
    assert_eq!((&offsets[..], size), (&DOCUMENTED_LAYOUT.0[..], DOCUMENTED_LAYOUT.1));
}

#[test]
fn wgsl_is_valid_in_all_stages_and_lays_the_header_out_as_documented() {
    let module = wgsl_front::parse_str(&wgsl()).unwrap_or_else(|error| panic!("{}", error.emit_to_string(&wgsl())));
    assert_eq!(module.entry_points.len(), 3);
    validate(&module);
    check_layout(&module);
}

#[test]
fn glsl_is_valid_in_all_stages_and_lays_the_header_out_as_documented() {
    for stage in STAGES {
        let naga_stage = match stage {
            Stage::Compute => naga::ShaderStage::Compute,
            Stage::Vertex => naga::ShaderStage::Vertex,
            Stage::Fragment => naga::ShaderStage::Fragment,
        };
        let text = glsl("#version 450", stage);
        let module = glsl_front::Frontend::default()
            .parse(&glsl_front::Options::from(naga_stage), &text)
            .unwrap_or_else(|error| panic!("{}", error.emit_to_string(&text)));
        validate(&module);
        check_layout(&module);
    }
}

/// Runs a compiler over a file of this text; false if there is no such compiler.
fn compiles(compiler: &str, arguments: &[&str], text: &str, extension: &str) -> bool {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(format!("shader.{extension}"));
    std::fs::write(&file, text).unwrap();
    let output = Command::new(compiler).args(arguments).arg(&file).current_dir(folder.path()).output();
    let Ok(output) = output else {
        return false;
    };
    let said = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{compiler} {arguments:?}: {said}");
    true
}

fn extension(stage: Stage) -> &'static str {
    match stage {
        Stage::Compute => "comp",
        Stage::Vertex => "vert",
        Stage::Fragment => "frag",
    }
}

#[test]
fn glslang_compiles_glsl_of_all_versions_and_hlsl() {
    let embedded = "#version 310 es\nprecision highp float; precision highp int;";
    for stage in STAGES {
        let is_here = [
            compiles("glslangValidator", &[], &glsl("#version 430", stage), extension(stage)),
            compiles("glslangValidator", &[], &glsl(embedded, stage), extension(stage)),
            compiles("glslangValidator", &["-V", "-o", "out.spv"], &glsl("#version 450", stage), extension(stage)),
            compiles(
                "glslangValidator",
                &["-D", "-V", "-e", "main", "-S", extension(stage), "-o", "out.spv"],
                &hlsl(stage),
                "hlsl",
            ),
        ];
        if is_here.contains(&false) {
            return skip("GLSL and HLSL in glslang: no glslangValidator here (Debian: glslang-tools)");
        }
    }
}

#[test]
fn dxc_compiles_hlsl() {
    for (stage, target) in [(Stage::Compute, "cs_6_0"), (Stage::Vertex, "vs_6_0"), (Stage::Fragment, "ps_6_0")] {
        if !compiles("dxc", &["-T", target, "-E", "main", "-WX"], &hlsl(stage), "hlsl") {
            return skip("HLSL in Microsoft's compiler: no dxc here");
        }
    }
}
