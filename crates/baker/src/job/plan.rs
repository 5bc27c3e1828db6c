//! What a bake does and what it leaves out, decided from the inputs before the first ray, with the reason.

use gdibl_runtime::sh::MAX_BANDS;

use super::bands::Truncation;
use super::inputs::Inputs;
use super::records::{PlanRow, SparseRecord};
use super::settings::Settings;
use super::text::Method;
use crate::air::{Air, LeftOut};
use crate::bake::{Baked, Nodes, Walls, levels_of, memory_needed, widest_spacing};
use crate::exposure::ExposureMatch;
use crate::pack::Precision;
use crate::radiance::RadianceFunction;
use crate::radiance::gdibl::{Gdibl, SceneHit};
use crate::radiance::path::Path;
use crate::radiance::unseen::UnseenChoice;
use crate::scene::{Role, Scene};

/// Which method is in force, and who chose it.
pub fn method(asked: Method, chosen: Method, inputs: &Inputs) -> PlanRow {
    let name = if chosen == Method::Path { "path tracing" } else { "gdibl" };
    let why = match (asked, inputs.probes.len()) {
        (Method::Auto, 0) => "no probe is given".to_owned(),
        (Method::Auto, 1) => "one probe is given".to_owned(),
        (Method::Auto, n) => format!("{n} probes are given"),
        _ => "asked for".to_owned(),
    };
    PlanRow::new("method", true, format!("{name}: {why}"))
}

/// Parts that the plan names at most.
const NAMED: usize = 3;

/// The default box of a grid.
pub fn bounds(air: &Air, scene: &Scene) -> PlanRow {
    let row = |kept, why: String| PlanRow::new("bounds", kept, why);
    if !air.is_standable {
        return row(false, "one can stand hardly anywhere: the box of all triangles".into());
    }
    if air.bounds == air.all {
        return row(false, "the air above floors fills the box of all triangles".into());
    }
    let [x, y, z] = (air.bounds.1 - air.bounds.0).to_array().map(digits);
    let name = |part: &LeftOut| {
        let kind = if part.is_plane { "a plane" } else { "surroundings" };
        format!("{kind} of {} (mesh {})", length(part.size), scene.meshes[part.mesh as usize].mesh)
    };
    let mut left_out: Vec<String> = air.left_out.iter().take(NAMED).map(name).collect();
    if air.left_out.len() > NAMED {
        left_out.push(format!("{} more parts", air.left_out.len() - NAMED));
    }
    let left_out = if left_out.is_empty() { String::new() } else { format!("; left out: {}", left_out.join(", ")) };
    let share = digits(100.0 * air.share());
    row(
        true,
        format!("the box of the air above floors: {x} x {y} x {z} m, {share} % of the box of all triangles{left_out}"),
    )
}

/// No box of a level is looked for.
pub fn bounds_given(why: &str) -> PlanRow {
    PlanRow::new("bounds", false, why)
}

/// Bytes of a value and of a node's figures in a file, about: packed numbers take what their noise takes.
const BYTES_PACKED: f64 = 0.5;
const BYTES_OF_FIGURES: f64 = 3.0;

/// How many nodes, and what they will take. `is_at_most`: light may need fewer. `is_paged`: what is large is in a file.
pub fn nodes(nodes: &Nodes, is_at_most: bool, settings: &Settings, is_paged: bool) -> PlanRow {
    let bake = settings.bake();
    let what = match nodes {
        Nodes::Grid(grid) => {
            let [x, y, z] = grid.counts;
            let most = if is_at_most { "at most " } else { "" };
            format!("{most}{} nodes, a grid of {x} x {y} x {z}, {} apart", nodes.len(), length(widest_spacing(grid)))
        }
        _ => format!("{} nodes", nodes.len()),
    };
    let values = 3 * gdibl_runtime::sh::coefficient_count(bake.bands);
    let per_value = match settings.quality.precision {
        Precision::F32 => 4.0,
        Precision::F16 => 2.0,
        Precision::Packed { .. } => BYTES_PACKED,
    };
    let count = nodes.len() as u64;
    let bytes = count as f64 * (values as f64 * per_value + BYTES_OF_FIGURES);
    PlanRow::new(
        "nodes",
        true,
        format!(
            "{what}; {:.1} M directions, a file of about {:.2} MB, at most {:.2} GiB of memory beside the level",
            bake.directions(count) as f64 / 1e6,
            bytes / 1e6,
            memory_needed(count, &bake, is_paged) as f64 / f64::from(1 << 30)
        ),
    )
}

/// A length with three digits.
pub(super) fn length(metres: f64) -> String {
    format!("{} m", digits(metres))
}

/// Three digits of a number.
pub(super) fn digits(number: f64) -> f64 {
    format!("{number:.2e}").parse().unwrap_or(number)
}

/// Whether probes are captured from the level.
pub fn capture(inputs: &Inputs, method: Method) -> PlanRow {
    let row = |kept, why: String| PlanRow::new("capture", kept, why);
    match inputs.probes.len() {
        _ if method == Method::Path => row(false, "path tracing needs no probe".into()),
        n if inputs.captured => row(true, format!("no probe is given: {n} captured from the level")),
        0 if inputs.lacks_probes() => row(true, "no probe is given: they are captured from the level".into()),
        0 => row(false, "no environment geometry that a probe could see".into()),
        _ => row(false, "probes are given".into()),
    }
}

/// Stages that the probes decide about.
const BY_PROBES: [&str; 4] = ["lines-of-sight", "blending", "surface-light", "bright-regions"];

/// The plan of a job whose probes are still to be captured: what they decide about is not decided yet.
pub fn before_capture(mut rows: Vec<PlanRow>) -> Vec<PlanRow> {
    for row in rows.iter_mut().filter(|row| BY_PROBES.contains(&row.stage.as_str())) {
        *row = PlanRow::new(&row.stage, true, "decided once the probes are captured");
    }
    rows
}

/// The plan of a GDIBL bake.
pub fn plan(scene: &Scene, function: &Gdibl) -> Vec<PlanRow> {
    let environment = scene.triangle_count(Role::Environment);
    let objects = scene.triangle_count(Role::Scene);
    let probes = function.probe_count();
    let textures = scene.textures.len();
    vec![
        match textures {
            0 => PlanRow::new("textures", false, "no material that light depends on has one"),
            n => PlanRow::new("textures", true, format!("{n} decoded: alpha, scene geometry, or what it shades")),
        },
        match environment {
            0 => PlanRow::new("environment", false, "no triangle: plain image based lighting"),
            n => PlanRow::new("environment", true, format!("{n} triangles carry the probes' light")),
        },
        match (environment, probes, function.sees_all_count()) {
            (0, _, _) => PlanRow::new("lines-of-sight", false, "no environment geometry could block one"),
            (_, 0, _) => PlanRow::new("lines-of-sight", false, "no probe"),
            (_, n, 0) => PlanRow::new("lines-of-sight", true, format!("from surfaces to {n} probes")),
            (_, 1, 1) => PlanRow::new("lines-of-sight", false, "the probe sees all of the environment"),
            (_, n, all) if n == all => {
                PlanRow::new("lines-of-sight", false, format!("each of {n} probes sees all of the environment"))
            }
            (_, n, all) => {
                let why = format!("from surfaces to {} of {n} probes: the others see all of the environment", n - all);
                PlanRow::new("lines-of-sight", true, why)
            }
        },
        match probes {
            0 => PlanRow::new("blending", false, "no probe"),
            1 => PlanRow::new("blending", false, "one probe: its pixels count alone"),
            n => PlanRow::new("blending", true, format!("{} of {n} probes", function.blend_rule())),
        },
        match function.remembered_count() {
            _ if environment == 0 || probes == 0 => PlanRow::new("surface-light", false, "no probe shows a surface"),
            _ if !function.blend_rule().is_seamless() => PlanRow::new(
                "surface-light",
                false,
                format!("by {} it differs from node to node", function.blend_rule()),
            ),
            0 => PlanRow::new("surface-light", false, "no surface is hit often enough to remember its light"),
            n => PlanRow::new("surface-light", true, format!("what probes show of {n} triangles is remembered")),
        },
        unseen(function.unseen(), probes),
        match (function.has_distant(), probes) {
            (true, _) => PlanRow::new("distant", true, "rays that hit nothing read the distant panorama"),
            (false, 0) => PlanRow::new("distant", false, "no distant panorama and no probe"),
            (false, _) => PlanRow::new("distant", false, "no distant panorama: rays that hit nothing ask the probes"),
        },
        match (objects, function.scene_hit()) {
            (0, _) => PlanRow::new("recursion", false, "no scene geometry"),
            (n, SceneHit::Recurse(depth)) => PlanRow::new(
                "recursion",
                true,
                format!("{n} triangles reflect, up to {depth} in a row, and shade the environment"),
            ),
            (n, SceneHit::Occlude) => {
                PlanRow::new("recursion", false, format!("{n} triangles only occlude (asked for)"))
            }
        },
        emitters(function.guide().emissive_count()),
        match function.region_count() {
            _ if environment == 0 || probes == 0 => PlanRow::new("bright-regions", false, "no probe shows a surface"),
            0 => PlanRow::new("bright-regions", false, "no probe shows a small lamp or the like on a surface"),
            n => PlanRow::new("bright-regions", true, format!("rays are sent to {n} that probes show on surfaces")),
        },
        transparency(scene),
    ]
}

/// What is done where no probe sees a surface finely enough.
fn unseen(choice: &UnseenChoice, probes: usize) -> PlanRow {
    let share = 100.0 * choice.unseen_share;
    let why = &choice.why;
    match (probes, choice.traced) {
        (0, _) => PlanRow::new("unseen", false, "no probe"),
        (_, true) => {
            let gain = match choice.gain {
                [1.0, 1.0, 1.0] => String::new(),
                [r, g, b] => format!("; traced light is multiplied by {r:.3} {g:.3} {b:.3} to fit the probes"),
            };
            PlanRow::new(
                "unseen",
                true,
                format!("{share:.1} % of what nodes see is traced, not finely seen: {why}{gain}"),
            )
        }
        (_, false) => {
            PlanRow::new("unseen", false, format!("{share:.1} % of what nodes see is filled, not finely seen: {why}"))
        }
    }
}

/// A distant panorama that no node can see is left out of the bake.
pub fn sealed_distant(name: &str) -> PlanRow {
    PlanRow::new("distant", false, format!("every node stands in a closed shell: nothing of {name} gets in"))
}

/// Matching the exposures of probes, where it was asked for.
pub fn match_exposure(matched: &ExposureMatch) -> PlanRow {
    let row = |kept, why: String| PlanRow::new("match-exposure", kept, why);
    match (matched.probes.len(), matched.matched_count()) {
        (0, _) => row(false, "no probe is given".into()),
        (1, _) => row(false, "one probe: there is none to match it with".into()),
        (n, 0) => row(false, format!("no lit surface is shared by two of {n} probes")),
        (n, m) => {
            row(true, format!("{m} of {n} probes, by {} surface points that two of them show", matched.point_count()))
        }
    }
}

/// The plan of a bake by path tracing.
pub fn plan_path(scene: &Scene, path: &Path) -> Vec<PlanRow> {
    let triangles = scene.triangle_count(Role::Environment) + scene.triangle_count(Role::Scene);
    vec![
        match scene.textures.len() {
            0 => PlanRow::new("textures", false, "no material has one"),
            n => PlanRow::new("textures", true, format!("{n} decoded: base colours, emission, alpha")),
        },
        match triangles {
            0 => PlanRow::new("bounces", false, "no triangle to bounce from"),
            n => match path.bounces() {
                None => PlanRow::new("bounces", true, format!("{n} triangles reflect; walks end by chance alone")),
                Some(most) => PlanRow::new("bounces", true, format!("{n} triangles reflect, up to {most} in a row")),
            },
        },
        match path.guide().to_sky() {
            true => PlanRow::new("distant", true, "every surface asks the distant panorama"),
            false => PlanRow::new("distant", false, "no distant panorama, or a black one"),
        },
        emitters(path.guide().emissive_count()),
        match scene.lights.len() {
            0 => PlanRow::new("punctual", false, "no punctual light"),
            n => PlanRow::new("punctual", true, format!("every surface asks one of {n} punctual lights")),
        },
        transparency(scene),
    ]
}

/// Walls between nodes, as far as is known: what was baked tells the rest.
pub fn walls(nodes: &Nodes, scene: &Scene, baked: Option<&Baked>) -> PlanRow {
    let between = matches!(nodes, Nodes::Grid(_) | Nodes::Sparse(_)) && nodes.len() > 1;
    match baked.map(|baked| &baked.walls) {
        _ if !between => PlanRow::new("walls", false, "nothing is read between nodes"),
        _ if scene.meshes.iter().all(|mesh| mesh.triangles.is_empty()) => PlanRow::new("walls", false, "no triangle"),
        None => PlanRow::new("walls", true, "what stands between nodes is looked for"),
        Some(None) => PlanRow::new("walls", false, "none stands between two nodes"),
        Some(Some(Walls { cells, planes, .. })) => {
            PlanRow::new("walls", true, format!("{} cells are cut by {} planes", cells.len(), planes.len()))
        }
    }
}

/// A sparse grid, as far as is known: what was baked tells the rest. `tolerance` is what was asked for.
pub fn sparse(nodes: &Nodes, tolerance: Option<f64>, record: Option<&SparseRecord>) -> PlanRow {
    let row = |kept, why: String| PlanRow::new("sparse", kept, why);
    let percent = tolerance.unwrap_or_default() * 100.0;
    match (nodes, tolerance, record) {
        (Nodes::Points(_) | Nodes::Vertices { .. }, _, _) => row(false, "nothing is read between nodes".into()),
        (_, None, _) => row(false, "no --tolerance is given: every place of the grid is a node".into()),
        (Nodes::Grid(grid), Some(_), None) => match levels_of(grid) {
            0 => row(false, "the grid is too small for coarser cells".into()),
            levels => row(true, format!("cells up to {0} wide where light is even to {percent} %", 1 << levels)),
        },
        (Nodes::Grid(_), _, Some(record)) if nodes.len() == 1 => {
            row(true, format!("light is the same all over to {percent} %: one node for {} places", record.places))
        }
        (Nodes::Grid(_), _, Some(_)) => {
            row(false, format!("light is nowhere even to {percent} %: every place is a node"))
        }
        (Nodes::Sparse(_), _, _) => {
            let places = record.map_or(0, |record| record.places);
            row(true, format!("light is even to {percent} % between {} nodes of {places} places", nodes.len()))
        }
    }
}

/// The bands that `--sh auto` keeps, with what fewer would lose.
pub fn bands(truncations: &[Truncation], tolerance: f64, kept: u32) -> PlanRow {
    let lost: Vec<String> = truncations.iter().map(|t| format!("L{} {:.2} %", t.bands, 100.0 * t.error.p95)).collect();
    let lost = if lost.is_empty() { "nothing is known".into() } else { lost.join(", ") };
    let why = format!("is right to {} % at 95 % of the nodes, against L4; there loses {lost}", 100.0 * tolerance);
    PlanRow::new("bands", kept == MAX_BANDS, format!("L{kept} {why}"))
}

fn emitters(count: usize) -> PlanRow {
    match count {
        0 => PlanRow::new("emitters", false, "no emissive triangle stands out"),
        n => PlanRow::new("emitters", true, format!("rays are sent to {n} emissive triangles too")),
    }
}

fn transparency(scene: &Scene) -> PlanRow {
    let clear = |mesh: &&crate::scene::Mesh| scene.materials[mesh.material as usize].lets_light_through();
    match scene.meshes.iter().filter(clear).count() {
        0 => PlanRow::new("transparency", false, "every material is opaque"),
        n => PlanRow::new("transparency", true, format!("{n} meshes have holes or let light through")),
    }
}
