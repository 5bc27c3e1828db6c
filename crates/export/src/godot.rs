//! Godot 4's `LightmapGIData`, as a `.tres` text resource: points, their SH, tetrahedra between them, and a tree of
//! planes that finds the tetrahedron around an object.
//!
//! ```text
//! LightmapGI at the origin, unturned, light_data = this resource
//! points      nodes, metres            sh   nine colours each: radiance coefficients over π
//! tetrahedra  four points each         bsp  plane normal, d (bits of f32), over, under: 0 and up a node of the tree,
//!                                           -1 and down tetrahedron -1 - i; a child comes after its parent
//! ```
//! Godot's axes are glTF's. It looks one place up per object, the middle of its bounding box, and only for meshes whose
//! global illumination mode is Dynamic. The shader's constants contain A_l; E/π comes out, which Godot multiplies by the
//! surface's colour.
//!
//! Based on: Godot 4.5, `scene/3d/lightmap_gi.cpp` (`_set_probe_data`), `light_storage.cpp` (`lightmap_tap_sh_light`),
//! `core/math/plane.h`, `scene_forward_clustered.glsl` (`lightmap_captures`).

use std::f64::consts::PI;
use std::fmt::{Display, Write};

use gdibl_runtime::Volume;

use crate::light::{Least, Light, text};
use crate::loss::Truth;
use crate::tetrahedra::{MAX_PROBES, PATHS, tetrahedra};
use crate::{Error, Export, File, Note, Report, Settings};

pub(crate) fn export(volume: &Volume, settings: &Settings) -> Result<Export, Error> {
    let mut light = Light::of_volume(volume, settings.counts, Least::Two)?.truncated();
    if light.nodes.len() > MAX_PROBES {
        return Err(Error::Unsupported(format!(
            "{} are {} nodes; a .tres holds up to {MAX_PROBES} (some 60 MB of text): give fewer --counts",
            text(light.grid.counts),
            light.nodes.len()
        )));
    }
    let data = ProbeData::encode(&light);
    let truth = Truth::of_volume(volume);
    let error = truth.loss(|position, normal| data.irradiance(position, normal));
    light.notes.push(Note::new(
        "per-object",
        "Godot looks light up once per object, at the middle of its bounding box; the error is that of a small object",
    ));
    light.notes.push(Note::new(
        "outside",
        "an object whose middle is outside the box gets too much light, since Godot clamps each weight by itself: let \
         the box hold all places where objects go",
    ));
    Ok(Export {
        files: vec![File { name: settings.name.clone(), bytes: data.file(&light).into_bytes() }],
        report: Report {
            counts: light.grid.counts,
            bands_of_volume: volume.header().bands,
            bands: Some(crate::light::ENGINE_BANDS),
            error,
            variants: Vec::new(),
            negative: truth.negative("not clamped: it takes away from other ambient light"),
            notes: light.notes,
        },
    })
}

/// The arrays of the resource.
struct ProbeData {
    points: Vec<[f32; 3]>,
    /// Nine per point.
    sh: Vec<[f32; 3]>,
    tetrahedra: Vec<[u32; 4]>,
    bsp: Vec<Branch>,
}

/// A node of the tree.
#[derive(Clone, Copy)]
struct Branch {
    normal: [f32; 3],
    d: f32,
    over: i32,
    under: i32,
}

impl ProbeData {
    fn encode(light: &Light) -> ProbeData {
        let positions = (0..light.nodes.len()).map(|i| light.grid.node_position(i).map(|v| v as f32));
        let coefficients = light.nodes.iter().flat_map(|sh| &sh.coefficients[..9]);
        let points: Vec<[f32; 3]> = positions.collect();
        let bsp = Tree::build(light.counts(), &points);
        ProbeData {
            points,
            sh: coefficients.map(|c| c.map(|v| (f64::from(v) / PI) as f32)).collect(),
            tetrahedra: tetrahedra(light.counts()),
            bsp,
        }
    }

    fn file(&self, light: &Light) -> String {
        let (min, max) = (light.grid.min.map(|v| v as f32), light.grid.max.map(|v| v as f32));
        let bounds: Vec<f32> = min.into_iter().chain((0..3).map(|k| max[k] - min[k])).collect();
        let colours = self.sh.iter().flat_map(|&[r, g, b]| [r, g, b, 1.0]);
        let branches = self.bsp.iter().flat_map(|branch| {
            let [x, y, z] = branch.normal.map(|v| v.to_bits() as i32);
            [x, y, z, branch.d.to_bits() as i32, branch.over, branch.under]
        });
        let mut file = String::from("[gd_resource type=\"LightmapGIData\" format=3]\n\n[resource]\nprobe_data = {\n");
        // Writing to a string cannot fail.
        let mut entry = |name: &str, value: String| writeln!(file, "\"{name}\": {value},").unwrap_or_default();
        entry("baked_exposure", "1.0".into());
        entry("bounds", call("AABB", bounds));
        entry("bsp", call("PackedInt32Array", branches));
        entry("interior", "false".into());
        entry("lightprobe_hash", "0".into());
        entry("points", call("PackedVector3Array", self.points.as_flattened()));
        entry("sh", call("PackedColorArray", colours));
        entry("tetrahedra", call("PackedInt32Array", self.tetrahedra.as_flattened()));
        // No comma after the last entry.
        file.truncate(file.len() - 2);
        file + "\n}\n"
    }

    /// E: `lightmap_tap_sh_light`, then the shader's sum, times π. Positions in f32, as the engine has them.
    fn irradiance(&self, position: [f64; 3], normal: [f32; 3]) -> [f64; 3] {
        let p = position.map(|v| v as f32);
        let mut node = 0;
        while node >= 0 {
            let branch = self.bsp[node as usize];
            let [x, y, z] = branch.normal;
            node = if x * p[0] + y * p[1] + z * p[2] > branch.d { branch.over } else { branch.under };
        }
        let nodes = self.tetrahedra[(node.unsigned_abs() - 1) as usize].map(|n| n as usize);
        let weights = barycentric(nodes.map(|n| self.points[n].map(f64::from)), p.map(f64::from));
        let [x, y, z] = normal.map(f64::from);
        let factors = [
            0.886227,
            1.023327 * y,
            1.023327 * z,
            1.023327 * x,
            0.858086 * x * y,
            0.858086 * y * z,
            0.247708 * (3.0 * z * z - 1.0),
            0.858086 * x * z,
            0.429043 * (x * x - y * y),
        ];
        std::array::from_fn(|c| {
            let at = |n: usize| (0..9).map(|i| f64::from(self.sh[9 * n + i][c]) * factors[i]).sum::<f64>();
            PI * nodes.iter().zip(weights).map(|(&n, weight)| at(n) * weight.clamp(0.0, 1.0)).sum::<f64>()
        })
    }
}

/// `tetrahedron_get_barycentric_coords`: shares of the volume, by triple products.
fn barycentric([a, b, c, d]: [[f64; 3]; 4], p: [f64; 3]) -> [f64; 4] {
    let from = |o: [f64; 3], q: [f64; 3]| -> [f64; 3] { std::array::from_fn(|k| q[k] - o[k]) };
    let triple = |u: [f64; 3], v: [f64; 3], w: [f64; 3]| {
        u[0] * (v[1] * w[2] - v[2] * w[1]) + u[1] * (v[2] * w[0] - v[0] * w[2]) + u[2] * (v[0] * w[1] - v[1] * w[0])
    };
    let (ab, ac, ad) = (from(a, b), from(a, c), from(a, d));
    let (ap, bp, bc, bd) = (from(a, p), from(b, p), from(b, c), from(b, d));
    let whole = triple(ab, ac, ad);
    [triple(bp, bd, bc), triple(ap, ac, ad), triple(ap, ad, ab), triple(ap, ab, ac)].map(|part| part / whole)
}

/// A tree of planes over a grid: halves along the axis with most cells, down to one cell; then which coordinate within
/// the cell is larger, pair by pair.
struct Tree<'a> {
    counts: [usize; 3],
    points: &'a [[f32; 3]],
    branches: Vec<Branch>,
}

impl Tree<'_> {
    fn build(counts: [usize; 3], points: &[[f32; 3]]) -> Vec<Branch> {
        let mut tree = Tree { counts, points, branches: Vec::new() };
        tree.cells([0; 3], counts.map(|count| count - 1));
        tree.branches
    }

    /// A branch for cells `low` to, but without, `high`.
    fn cells(&mut self, low: [usize; 3], high: [usize; 3]) -> i32 {
        let extent: [usize; 3] = std::array::from_fn(|k| high[k] - low[k]);
        let Some(axis) = (0..3).max_by_key(|&k| extent[k]).filter(|&k| extent[k] > 1) else {
            return self.cell(low);
        };
        let middle = low[axis] + extent[axis] / 2;
        let mut normal = [0.0; 3];
        normal[axis] = 1.0;
        let mut plane = low;
        plane[axis] = middle;
        let d = self.points[self.index(plane)][axis];
        self.branch(
            normal,
            d,
            |tree| tree.cells(plane, high),
            |tree| {
                let mut end = high;
                end[axis] = middle;
                tree.cells(low, end)
            },
        )
    }

    /// Branches within one cell. Each asks for two axes whose coordinate is the larger one, until one order is left.
    fn cell(&mut self, cell: [usize; 3]) -> i32 {
        let [cx, cy, _] = self.counts.map(|count| count - 1);
        let first = 6 * (cell[0] + cx * (cell[1] + cy * cell[2]));
        let leaf = move |path: [usize; 3]| {
            let place = PATHS.iter().position(|&other| other == path).expect("all orders are listed");
            -1 - (first + place) as i32
        };
        self.compare(
            cell,
            0,
            1,
            |tree| {
                tree.compare(
                    cell,
                    1,
                    2,
                    |_| leaf([0, 1, 2]),
                    |tree| tree.compare(cell, 0, 2, |_| leaf([0, 2, 1]), |_| leaf([2, 0, 1])),
                )
            },
            |tree| {
                tree.compare(
                    cell,
                    0,
                    2,
                    |_| leaf([1, 0, 2]),
                    |tree| tree.compare(cell, 1, 2, |_| leaf([1, 2, 0]), |_| leaf([2, 1, 0])),
                )
            },
        )
    }

    /// Over: the coordinate along `a` is larger than that along `b`, both in cells from the cell's corner.
    fn compare(
        &mut self,
        cell: [usize; 3],
        a: usize,
        b: usize,
        over: impl FnOnce(&mut Self) -> i32,
        under: impl FnOnce(&mut Self) -> i32,
    ) -> i32 {
        let corner = self.points[self.index(cell)].map(f64::from);
        let far = self.points[self.index(cell.map(|k| k + 1))].map(f64::from);
        let mut normal = [0.0; 3];
        normal[a] = 1.0 / (far[a] - corner[a]);
        normal[b] = -1.0 / (far[b] - corner[b]);
        let length = normal.iter().map(|v| v * v).sum::<f64>().sqrt();
        let normal = normal.map(|v| v / length);
        let d: f64 = (0..3).map(|k| normal[k] * corner[k]).sum();
        self.branch(normal.map(|v| v as f32), d as f32, over, under)
    }

    /// Children get higher numbers than their parent, as the engine's walk demands.
    fn branch(
        &mut self,
        normal: [f32; 3],
        d: f32,
        over: impl FnOnce(&mut Self) -> i32,
        under: impl FnOnce(&mut Self) -> i32,
    ) -> i32 {
        let place = self.branches.len();
        self.branches.push(Branch { normal, d, over: 0, under: 0 });
        let (over, under) = (over(self), under(self));
        self.branches[place] = Branch { normal, d, over, under };
        place as i32
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        x + self.counts[0] * (y + self.counts[1] * z)
    }
}

/// `Name(1, 2, 3)`.
fn call<T: Display>(name: &str, values: impl IntoIterator<Item = T>) -> String {
    let values: Vec<String> = values.into_iter().map(|value| value.to_string()).collect();
    format!("{name}({})", values.join(", "))
}
