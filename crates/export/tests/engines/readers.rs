//! Second readers: from the formats' documentation and the engines' shaders, without the writers' code.

use gdibl_export::{Engine, Export};
use half::f16;
use serde_json::Value;
use std::collections::HashMap;
use std::f64::consts::PI;

use crate::volumes::file;

/// What an engine makes of an export: E at a place.
pub type Lit = Box<dyn Fn([f64; 3], [f32; 3]) -> [f64; 3]>;

pub fn read(engine: Engine, export: &Export) -> Lit {
    match engine {
        Engine::Bevy => bevy(export, "room.main"),
        Engine::Three => three(file(export, "room.main")),
        Engine::Godot => godot(file(export, "room.main")).lit(),
        Engine::Unity => unity(file(export, "room.main")),
        Engine::Exr => exr(file(export, "room.main")),
        Engine::Json => json(file(export, "room.main")),
    }
}

/// Between eight values, from corner to corner: place in units of nodes.
fn between(counts: [usize; 3], place: [f64; 3], value: impl Fn([usize; 3]) -> [f64; 3]) -> [f64; 3] {
    let place: [f64; 3] = std::array::from_fn(|k| place[k].clamp(0.0, (counts[k] - 1) as f64));
    let low = place.map(|p| p.floor() as usize);
    let high: [usize; 3] = std::array::from_fn(|k| (low[k] + 1).min(counts[k] - 1));
    let t: [f64; 3] = std::array::from_fn(|k| place[k] - low[k] as f64);
    let mix = |a: [f64; 3], b: [f64; 3], t: f64| -> [f64; 3] { std::array::from_fn(|c| a[c] * (1.0 - t) + b[c] * t) };
    let along_x = |y, z| mix(value([low[0], y, z]), value([high[0], y, z]), t[0]);
    let along_y = |z| mix(along_x(low[1], z), along_x(high[1], z), t[1]);
    mix(along_y(low[2]), along_y(high[2]), t[2])
}

/// `irradiance_volume_light` of Bevy, times π. The texture by the `ktx2` crate, as in Bevy.
pub fn bevy(export: &Export, texture: &str) -> Lit {
    let sidecar: Value = serde_json::from_slice(file(export, "room.json")).unwrap();
    let vector = |name: &str| -> [f64; 3] { std::array::from_fn(|k| sidecar[name][k].as_f64().unwrap()) };
    let (translation, scale) = (vector("translation"), vector("scale"));
    let intensity = sidecar["intensity"].as_f64().unwrap();
    let reader = ktx2::Reader::new(file(export, texture)).unwrap();
    let header = reader.header();
    assert_eq!((header.level_count, header.face_count, header.layer_count), (1, 1, 0));
    assert_eq!(header.supercompression_scheme, None);
    let size = [header.pixel_width, header.pixel_height, header.pixel_depth].map(|n| n as usize);
    let counts = [size[0], size[1] / 2, size[2] / 3];
    let level = reader.levels().next().unwrap().data.to_vec();
    let texels: Vec<[f64; 3]> = match header.format {
        Some(ktx2::Format::E5B9G9R9_UFLOAT_PACK32) => {
            level.as_chunks::<4>().0.iter().map(|b| shared_exponent(*b)).collect()
        }
        Some(ktx2::Format::R16G16B16A16_SFLOAT) => level.as_chunks::<8>().0.iter().map(|b| halves(*b)).collect(),
        other => panic!("format {other:?}"),
    };
    assert_eq!(texels.len(), size.iter().product::<usize>());
    Box::new(move |position, normal| {
        let unit: [f64; 3] = std::array::from_fn(|k| (position[k] - translation[k]) / scale[k]);
        if unit.iter().any(|u| u.abs() > 0.5) {
            return [0.0; 3];
        }
        let place = std::array::from_fn(|k| (unit[k] + 0.5) * counts[k] as f64 - 0.5);
        let mut sum = [0.0; 3];
        for axis in 0..3 {
            let [nx, ny] = [size[0], counts[1]];
            let down = if normal[axis] < 0.0 { ny } else { 0 };
            let rgb =
                between(counts, place, |[x, y, z]| texels[x + nx * (y + down) + nx * size[1] * (z + axis * counts[2])]);
            for c in 0..3 {
                sum[c] += rgb[c] * f64::from(normal[axis]).powi(2) * intensity * PI;
            }
        }
        sum
    })
}

fn shared_exponent(bytes: [u8; 4]) -> [f64; 3] {
    let bits = u32::from_le_bytes(bytes);
    let exponent = f64::from(bits >> 27) - 24.0;
    [bits & 511, bits >> 9 & 511, bits >> 18 & 511].map(|mantissa| f64::from(mantissa) * exponent.exp2())
}

fn halves(bytes: [u8; 8]) -> [f64; 3] {
    [0, 2, 4].map(|at| f16::from_le_bytes([bytes[at], bytes[at + 1]]).to_f64())
}

fn words<const N: usize>(bytes: &[u8], at: usize) -> [[u8; 4]; N] {
    std::array::from_fn(|k| bytes[at + 4 * k..at + 4 * k + 4].try_into().unwrap())
}

/// `getLightProbeGridIrradiance` of three.js r187; nothing outside its box.
pub fn three(bytes: &[u8]) -> Lit {
    assert_eq!(&bytes[..8], b"gdiblLPG");
    let [version, nx, ny, nz] = words(bytes, 8).map(|w| u32::from_le_bytes(w) as usize);
    assert_eq!(version, 1);
    let counts = [nx, ny, nz];
    let first = words::<3>(bytes, 24).map(|w| f64::from(f32::from_le_bytes(w)));
    let last = words::<3>(bytes, 36).map(|w| f64::from(f32::from_le_bytes(w)));
    let atlas: Vec<f64> = bytes[48..].as_chunks::<2>().0.iter().map(|b| f16::from_le_bytes(*b).to_f64()).collect();
    assert_eq!(atlas.len(), 4 * nx * ny * 7 * (nz + 2));
    // The slices at both ends of a block repeat their neighbours.
    let slice = |block: usize, slice: usize| {
        let start = 4 * nx * ny * (block * (nz + 2) + slice);
        &atlas[start..start + 4 * nx * ny]
    };
    for block in 0..7 {
        assert_eq!(slice(block, 0), slice(block, 1));
        assert_eq!(slice(block, nz + 1), slice(block, nz));
    }
    Box::new(move |position, normal| {
        let spacing: [f64; 3] = std::array::from_fn(|k| (last[k] - first[k]) / (counts[k] - 1) as f64);
        let place: [f64; 3] =
            std::array::from_fn(|k| (position[k] - first[k]) / spacing[k] + 0.5 * f64::from(normal[k]));
        if (0..3).any(|k| !(-0.51..=counts[k] as f64 - 0.49).contains(&place[k])) {
            return [0.0; 3];
        }
        let coefficient = |i: usize| {
            between(counts, place, |[x, y, z]| {
                std::array::from_fn(|c| {
                    let value = 3 * i + c;
                    let texel = x + nx * (y + ny * ((value / 4) * (nz + 2) + z + 1));
                    atlas[4 * texel + value % 4]
                })
            })
        };
        evaluate(&std::array::from_fn(coefficient), normal).map(|e| e.max(0.0))
    })
}

/// E of radiance coefficients as three.js and Godot write it.
fn evaluate(c: &[[f64; 3]; 9], normal: [f32; 3]) -> [f64; 3] {
    let [x, y, z] = normal.map(f64::from);
    std::array::from_fn(|k| {
        0.429043 * c[8][k] * (x * x - y * y) + 0.743125 * c[6][k] * z * z + 0.886227 * c[0][k] - 0.247708 * c[6][k]
            + 2.0 * 0.429043 * (c[4][k] * x * y + c[7][k] * x * z + c[5][k] * y * z)
            + 2.0 * 0.511664 * (c[3][k] * x + c[1][k] * y + c[2][k] * z)
    })
}

/// The arrays of a `LightmapGIData`.
pub struct Godot {
    pub bounds: Vec<f64>,
    pub points: Vec<[f64; 3]>,
    pub sh: Vec<[f64; 4]>,
    pub tetrahedra: Vec<[usize; 4]>,
    /// Plane, over, under.
    pub bsp: Vec<([f32; 4], i32, i32)>,
}

/// Reads a `.tres` file: a header in brackets, then `name = value`, of which one is a dictionary.
pub fn godot(bytes: &[u8]) -> Godot {
    let text = std::str::from_utf8(bytes).unwrap();
    let (head, rest) = text.split_once("\n\n[resource]\n").unwrap();
    assert_eq!(head, "[gd_resource type=\"LightmapGIData\" format=3]");
    let inner = rest.strip_prefix("probe_data = {\n").unwrap().strip_suffix("\n}\n").unwrap();
    let entries: HashMap<&str, &str> =
        inner.split(",\n").map(|line| line.strip_prefix('"').unwrap().split_once("\": ").unwrap()).collect();
    let mut names: Vec<&str> = entries.keys().copied().collect();
    names.sort_unstable();
    let expected = ["baked_exposure", "bounds", "bsp", "interior", "lightprobe_hash", "points", "sh", "tetrahedra"];
    assert_eq!(names, expected);
    assert_eq!((entries["baked_exposure"], entries["interior"]), ("1.0", "false"));
    let numbers = |name: &str, constructor: &str| -> Vec<f64> {
        let call = entries[name].strip_prefix(constructor).unwrap();
        let inner = call.strip_prefix('(').unwrap().strip_suffix(')').unwrap();
        inner.split(", ").map(|n| n.parse().unwrap()).collect()
    };
    let points = numbers("points", "PackedVector3Array").as_chunks().0.to_vec();
    let sh = numbers("sh", "PackedColorArray").as_chunks().0.to_vec();
    let tetrahedra = numbers("tetrahedra", "PackedInt32Array");
    let bsp = numbers("bsp", "PackedInt32Array");
    // `set_capture_data` refuses others.
    assert_eq!(sh.len(), 9 * points.len());
    assert!(tetrahedra.len() % 4 == 0 && bsp.len() % 6 == 0);
    let branch = |b: &[f64; 6]| (std::array::from_fn(|k| f32::from_bits(b[k] as i32 as u32)), b[4] as i32, b[5] as i32);
    Godot {
        bounds: numbers("bounds", "AABB"),
        points,
        sh,
        tetrahedra: tetrahedra.as_chunks::<4>().0.iter().map(|t| t.map(|n| n as usize)).collect(),
        bsp: bsp.as_chunks::<6>().0.iter().map(branch).collect(),
    }
}

impl Godot {
    /// The tetrahedron that the tree finds, as `lightmap_tap_sh_light` walks it in a debug build.
    pub fn find(&self, position: [f64; 3]) -> usize {
        let p = position.map(|v| v as f32);
        let mut node = 0_i32;
        while node >= 0 {
            let ([x, y, z, d], over, under) = self.bsp[node as usize];
            let next = if x * p[0] + y * p[1] + z * p[2] > d { over } else { under };
            assert!(next < 0 || next > node, "a child comes after its parent");
            node = next;
        }
        assert_ne!(node, i32::MIN, "an empty leaf");
        (-1 - node) as usize
    }

    /// Weights of the corners, by Cramer's rule.
    pub fn weights(&self, tetrahedron: usize, p: [f64; 3]) -> [f64; 4] {
        let corners = self.tetrahedra[tetrahedron].map(|n| self.points[n]);
        let volume = |q: [[f64; 3]; 4]| {
            let e: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|k| q[i + 1][k] - q[0][k]));
            e[0][0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1]) - e[0][1] * (e[1][0] * e[2][2] - e[1][2] * e[2][0])
                + e[0][2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0])
        };
        let whole = volume(corners);
        std::array::from_fn(|i| {
            let mut part = corners;
            part[i] = p;
            volume(part) / whole
        })
    }

    fn lit(self) -> Lit {
        Box::new(move |position, normal| {
            let tetrahedron = self.find(position);
            let mut c = [[0.0; 3]; 9];
            for (&node, weight) in self.tetrahedra[tetrahedron].iter().zip(self.weights(tetrahedron, position)) {
                for (i, sum) in c.iter_mut().enumerate() {
                    for (sum, value) in sum.iter_mut().zip(self.sh[9 * node + i]) {
                        *sum += value * weight.clamp(0.0, 1.0);
                    }
                }
            }
            // E/π comes out.
            evaluate(&c, normal).map(|e| e * PI)
        })
    }
}

/// Probes in Unity's axes: position, and coefficients by channel.
pub fn unity_probes(bytes: &[u8]) -> Vec<([f64; 3], [[f64; 9]; 3])> {
    let json: Value = serde_json::from_slice(bytes).unwrap();
    assert_eq!((json["format"].as_str(), json["version"].as_u64()), (Some("gdibl light probes"), Some(1)));
    let numbers =
        |name: &str| -> Vec<f64> { json[name].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect() };
    let (positions, coefficients) = (numbers("positions"), numbers("coefficients"));
    assert_eq!(positions.len() * 9, coefficients.len());
    let probes = positions.as_chunks::<3>().0.iter().zip(coefficients.as_chunks::<27>().0);
    probes.map(|(p, c)| (*p, std::array::from_fn(|k| std::array::from_fn(|i| c[9 * k + i])))).collect()
}

/// E/π as Unity documents `SphericalHarmonicsL2.Evaluate`.
pub fn unity_polynomial(c: &[f64; 9], [x, y, z]: [f64; 3]) -> f64 {
    (c[0] - c[6])
        + c[1] * y
        + c[2] * z
        + c[3] * x
        + c[4] * x * y
        + c[5] * y * z
        + 3.0 * c[6] * z * z
        + c[7] * x * z
        + c[8] * (x * x - y * y)
}

/// Light of glTF's axes through Unity's: between the four corners of the path that the place lies on in its cell.
fn unity(bytes: &[u8]) -> Lit {
    let json: Value = serde_json::from_slice(bytes).unwrap();
    let counts: [usize; 3] = std::array::from_fn(|k| json["counts"][k].as_u64().unwrap() as usize);
    let probes = unity_probes(bytes);
    Box::new(move |position, normal| {
        let mirror = |[x, y, z]: [f64; 3]| [-x, y, z];
        let p = mirror(position);
        let (first, last) = (probes[0].0, probes[probes.len() - 1].0);
        let place: [f64; 3] = std::array::from_fn(|k| {
            let last_node = (counts[k] - 1) as f64;
            ((p[k] - first[k]) / (last[k] - first[k]) * last_node).clamp(0.0, last_node)
        });
        let mut node: [usize; 3] = std::array::from_fn(|k| (place[k] as usize).min(counts[k] - 2));
        let share: [f64; 3] = std::array::from_fn(|k| place[k] - node[k] as f64);
        let mut axes = [0, 1, 2];
        axes.sort_by(|&a, &b| share[b].total_cmp(&share[a]));
        let normal = mirror(normal.map(f64::from));
        let at = |n: [usize; 3]| -> [f64; 3] {
            let (_, c) = &probes[n[0] + counts[0] * (n[1] + counts[1] * n[2])];
            std::array::from_fn(|k| PI * unity_polynomial(&c[k], normal))
        };
        let mut e = at(node);
        for axis in axes {
            let before = at(node);
            node[axis] += 1;
            let after = at(node);
            for k in 0..3 {
                e[k] += share[axis] * (after[k] - before[k]);
            }
        }
        e.map(|e| e.max(0.0))
    })
}

/// Layers of an image, slice above slice.
fn exr(bytes: &[u8]) -> Lit {
    use exr::prelude::*;
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_buffered(std::io::Cursor::new(bytes.to_vec()))
        .unwrap();
    let AttributeValue::Text(text) = &image.layer_data.attributes.other[&Text::from("gdibl:grid")] else {
        panic!("no text")
    };
    let numbers: Vec<f64> = text.to_string().split(' ').map(|n| n.parse().unwrap()).collect();
    let [counts, min, max] = *numbers.as_chunks::<3>().0 else { panic!("{numbers:?}") };
    let counts = counts.map(|n| n as usize);
    let layer = &image.layer_data;
    assert_eq!((layer.size.0, layer.size.1), (counts[0], counts[1] * counts[2]));
    let channels: HashMap<String, Vec<f32>> = layer
        .channel_data
        .list
        .iter()
        .map(|channel| (channel.name.to_string(), channel.sample_data.values_as_f32().collect()))
        .collect();
    assert!(channels["validity"].iter().all(|v| (0.0..=1.0).contains(v)));
    let planes: Vec<[Vec<f32>; 3]> =
        (0..9).map(|i| ["R", "G", "B"].map(|c| channels[&format!("sh{i}.{c}")].clone())).collect();
    corners(min, max, counts, planes)
}

/// A reader that interpolates between all nodes.
fn corners(min: [f64; 3], max: [f64; 3], counts: [usize; 3], planes: Vec<[Vec<f32>; 3]>) -> Lit {
    Box::new(move |position, normal| {
        let place = std::array::from_fn(|k| (position[k] - min[k]) / (max[k] - min[k]) * (counts[k] - 1) as f64);
        let coefficient = |i: usize| {
            between(counts, place, |[x, y, z]| {
                [0, 1, 2].map(|c| f64::from(planes[i][c][x + counts[0] * (y + counts[1] * z)]))
            })
        };
        evaluate(&std::array::from_fn(coefficient), normal).map(|e| e.max(0.0))
    })
}

fn json(bytes: &[u8]) -> Lit {
    let json: Value = serde_json::from_slice(bytes).unwrap();
    assert_eq!(json["kind"], "grid");
    let vector = |name: &str| -> [f64; 3] { std::array::from_fn(|k| json[name][k].as_f64().unwrap()) };
    let nodes = json["radiance"].as_array().unwrap();
    let counts = vector("counts").map(|n| n as usize);
    assert_eq!(nodes.len(), counts.iter().product::<usize>());
    let planes =
        (0..9).map(|i| [0, 1, 2].map(|c| nodes.iter().map(|n| n[i][c].as_f64().unwrap() as f32).collect())).collect();
    corners(vector("min"), vector("max"), counts, planes)
}
