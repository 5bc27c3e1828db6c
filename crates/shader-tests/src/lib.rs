//! Tests of the shaders in `crates/runtime/shaders`: `tests/compile.rs` compiles them in every language and stage,
//! `tests/run.rs` runs them on a GPU, one in software will do, and compares what they say with the CPU.
//!
//! Here is what both have in common: the shaders' text, completed by entry points.

/// The text of `gdibl.wgsl`.
pub const WGSL: &str = include_str!("../../runtime/shaders/gdibl.wgsl");
/// The text of `gdibl.glsl`.
pub const GLSL: &str = include_str!("../../runtime/shaders/gdibl.glsl");
/// The text of `gdibl.hlsl`.
pub const HLSL: &str = include_str!("../../runtime/shaders/gdibl.hlsl");

/// Positions per workgroup of the compute shaders.
pub const WORKGROUP: usize = 64;

/// `gdibl.wgsl` with a compute shader that answers queries (binding 4: position, normal, each in a vec4) in binding 5, and
/// with a vertex and a fragment shader. The entry points are `compute`, `vertex`, `fragment`.
pub fn wgsl() -> String {
    let entries = "
        @group(0) @binding(4) var<storage, read> queries: array<vec4<f32>>;
        @group(0) @binding(5) var<storage, read_write> results: array<vec4<f32>>;
        @compute @workgroup_size(64) fn compute(@builtin(global_invocation_id) id: vec3<u32>) {
            let irradiance = gdibl_irradiance(queries[2u * id.x].xyz, queries[2u * id.x + 1u].xyz);
            results[id.x] = vec4<f32>(irradiance, 0.0);
        }
        struct Vertex {
            @builtin(position) clip: vec4<f32>,
            @location(0) color: vec3<f32>,
        }
        @vertex fn vertex(@location(0) position: vec3<f32>, @location(1) normal: vec3<f32>) -> Vertex {
            return Vertex(vec4<f32>(position, 1.0), gdibl_irradiance(position, normal));
        }
        @fragment fn fragment(@location(0) position: vec3<f32>, @location(1) normal: vec3<f32>) -> @location(0) vec4<f32> {
            return vec4<f32>(gdibl_irradiance(position, normalize(normal)), 1.0);
        }";
    format!("{WGSL}{entries}")
}

/// What a shader is for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stage {
    /// Answers queries as in [`wgsl`].
    Compute,
    /// Lights vertices.
    Vertex,
    /// Lights pixels.
    Fragment,
}

/// `gdibl.glsl` as a whole shader with the entry point `main`; `head` is the line with the version, and what else comes first.
pub fn glsl(head: &str, stage: Stage) -> String {
    let entry = match stage {
        Stage::Compute => {
            "
            layout(local_size_x = 64) in;
            layout(std430, binding = 4) readonly buffer Queries { vec4 queries[]; };
            layout(std430, binding = 5) buffer Results { vec4 results[]; };
            void main() {
                uint i = gl_GlobalInvocationID.x;
                results[i] = vec4(gdibl_irradiance(queries[2u * i].xyz, queries[2u * i + 1u].xyz), 0.0);
            }"
        }
        Stage::Vertex => {
            "
            layout(location = 0) in vec3 position;
            layout(location = 1) in vec3 normal;
            layout(location = 0) out vec3 color;
            void main() {
                gl_Position = vec4(position, 1.0);
                color = gdibl_irradiance(position, normal);
            }"
        }
        Stage::Fragment => {
            "
            layout(location = 0) in vec3 position;
            layout(location = 1) in vec3 normal;
            layout(location = 0) out vec4 color;
            void main() {
                color = vec4(gdibl_irradiance(position, normalize(normal)), 1.0);
            }"
        }
    };
    format!("{head}\n{GLSL}{entry}")
}

/// `gdibl.hlsl` as a whole shader with the entry point `main`. The registers' numbers are the bindings of the others, since
/// Vulkan has one row of them for all kinds.
pub fn hlsl(stage: Stage) -> String {
    let registers = "
        #define GDIBL_VOLUME b0
        #define GDIBL_COEFFICIENTS t1
        #define GDIBL_MARKS t2
        #define GDIBL_WALLS t3
        ";
    let entry = match stage {
        Stage::Compute => {
            "
            StructuredBuffer<float4> queries : register(t4);
            RWStructuredBuffer<float4> results : register(u5);
            [numthreads(64, 1, 1)] void main(uint3 id : SV_DispatchThreadID) {
                float3 irradiance = gdibl_irradiance(queries[2u * id.x].xyz, queries[2u * id.x + 1u].xyz);
                results[id.x] = float4(irradiance, 0.0);
            }"
        }
        Stage::Vertex => {
            "
            struct Vertex { float4 clip : SV_Position; float3 color : COLOR; };
            Vertex main(float3 position : POSITION, float3 normal : NORMAL) {
                Vertex vertex;
                vertex.clip = float4(position, 1.0);
                vertex.color = gdibl_irradiance(position, normal);
                return vertex;
            }"
        }
        Stage::Fragment => {
            "
            float4 main(float3 position : POSITION, float3 normal : NORMAL) : SV_Target {
                return float4(gdibl_irradiance(position, normalize(normal)), 1.0);
            }"
        }
    };
    format!("{registers}{HLSL}{entry}")
}

/// Says what is not tested, past the test harness, which shows only what failing tests print.
pub fn skip(what: &str) {
    use std::io::Write;
    // Nobody reads it: no reason to fail.
    let _ = writeln!(std::io::stderr(), "SKIPPED: {what}");
}
