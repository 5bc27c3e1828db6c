// Samples a gdibl irradiance volume (a grid): irradiance at a position, trilinear between nodes, with validity and walls.
//
//     let irradiance = gdibl_irradiance(world_position - volume_min, normal);
//     let diffuse = albedo / 3.14159265 * max(irradiance, vec3<f32>(0.0));    // here is the 1/pi
//
// Paste this file before your own, and upload what `Volume::gpu_buffers` of the crate gdibl-runtime returns. The same in
// GLSL and HLSL lies beside it. What it computes is said in FORMAT.md, "Light at a position", "Walls" and "From
// coefficients to irradiance"; the CPU's twin is src/sample.rs, and a test compares the two.
//
// position  metres, RELATIVE TO THE BOX'S MIN, so that an f32 is enough however far the level is from the origin: subtract
//           `GpuBuffers::min` where you have f64. Outside the box the answer is that of the nearest position in it. Finite.
// normal    unit length, the level's axes: right-handed, Y up.
// Returns   linear Rec.709 irradiance. Few bands ring beside bright lights, so it may be slightly negative: clamp it where
//           you shade, not where you still add lights up.
//
// Bands 0 to 2. Band 3 adds nothing to irradiance, and band 4 nearly nothing.

struct GdiblVolume {
    nodes_per_metre: vec3<f32>, // per axis; 0 on an axis with one node: nothing varies along it
    scale: f32,                 // coefficient = f16 * scale
    counts: vec3<u32>,          // nodes per axis; node (x, y, z) is x + counts.x * (y + counts.y * z)
    bands: u32,                 // 0, 1, 2: 1, 4, 9 coefficients per channel
    extent: vec3<f32>,          // max - min of the box, metres
    bias: f32,                  // metres along the normal: a surface in a wall's plane falls to the side that it faces
    marked: u32,                // 0: every node is valid and there are no walls
    zero_0: u32,
    zero_1: u32,
    zero_2: u32,
}

// Change the group and the bindings to yours.
@group(0) @binding(0) var<uniform> gdibl_volume: GdiblVolume;

// Radiance coefficients as pairs of f16, 2, 6 or 14 words per node: red, green, blue of coefficient 0, then of 1, ...
@group(0) @binding(1) var<storage, read> gdibl_coefficients: array<u32>;

// 3 words per 32 nodes: bits of valid nodes; bits of nodes which are the lowest corner of a cell with walls; where in
// gdibl_walls the record of the first of these cells is.
@group(0) @binding(2) var<storage, read> gdibl_marks: array<u32>;

// First the planes: unit normal and distance, as bits of floats. Then the cells:
//     x  indices of planes 0 and 1, 16 bits each      y  index of plane 2; from bit 16 on the corners where walls end
//     z, w  8 masks of 8 bits: the corners that count in each part of the cell
@group(0) @binding(3) var<storage, read> gdibl_walls: array<vec4<u32>>;

// Weights that add up to less than this are those of nobody.
const GDIBL_LEAST: f32 = 1e-6;
const GDIBL_NO_PLANE: u32 = 0xffffu;

// Irradiance of one node over `scale`, for a surface with this normal: sum of A_l L_lm Y_lm(normal), A = pi, 2 pi/3, pi/4.
// The constants are A_l times that of the basis function.
fn gdibl_node_irradiance(node: u32, normal: vec3<f32>) -> vec3<f32> {
    let n = normal;
    // Band 0.
    let at = node * select(select(14u, 6u, gdibl_volume.bands == 1u), 2u, gdibl_volume.bands == 0u);
    let a0 = unpack2x16float(gdibl_coefficients[at]);
    let a1 = unpack2x16float(gdibl_coefficients[at + 1u]);
    var sum = 0.88622693 * vec3<f32>(a0, a1.x);
    if gdibl_volume.bands == 0u {
        return sum;
    }
    // Band 1: y, z, x.
    let a2 = unpack2x16float(gdibl_coefficients[at + 2u]);
    let a3 = unpack2x16float(gdibl_coefficients[at + 3u]);
    let a4 = unpack2x16float(gdibl_coefficients[at + 4u]);
    let a5 = unpack2x16float(gdibl_coefficients[at + 5u]);
    sum += 1.0233267 * (n.y * vec3<f32>(a1.y, a2) + n.z * vec3<f32>(a3, a4.x) + n.x * vec3<f32>(a4.y, a5));
    if gdibl_volume.bands == 1u {
        return sum;
    }
    // Band 2: xy, yz, 3zz - 1, xz, xx - yy.
    let a6 = unpack2x16float(gdibl_coefficients[at + 6u]);
    let a7 = unpack2x16float(gdibl_coefficients[at + 7u]);
    let a8 = unpack2x16float(gdibl_coefficients[at + 8u]);
    let a9 = unpack2x16float(gdibl_coefficients[at + 9u]);
    let a10 = unpack2x16float(gdibl_coefficients[at + 10u]);
    let a11 = unpack2x16float(gdibl_coefficients[at + 11u]);
    let a12 = unpack2x16float(gdibl_coefficients[at + 12u]);
    let a13 = unpack2x16float(gdibl_coefficients[at + 13u]);
    sum += 0.8580855 * (n.x * n.y * vec3<f32>(a6, a7.x) + n.y * n.z * vec3<f32>(a7.y, a8));
    sum += 0.24770796 * (3.0 * n.z * n.z - 1.0) * vec3<f32>(a9, a10.x);
    sum += 0.8580855 * n.x * n.z * vec3<f32>(a10.y, a11);
    sum += 0.42904275 * (n.x * n.x - n.y * n.y) * vec3<f32>(a12, a13.x);
    return sum;
}

// What each corner of a cell with walls counts at a position in it: 1 if it is seen from there, less if not.
// `record` is the cell's, `weights` are its trilinear ones. Corners: see gdibl_irradiance.
fn gdibl_shares(record: vec4<u32>, position: vec3<f32>, weights: array<f32, 8>) -> array<f32, 8> {
    // Which part of the cell: one bit for each plane that the position lies above.
    let planes = vec3<u32>(record.x & 0xffffu, record.x >> 16u, record.y & 0xffffu);
    var part = 0u;
    for (var k = 0u; k < 3u; k++) {
        if planes[k] != GDIBL_NO_PLANE {
            let plane = bitcast<vec4<f32>>(gdibl_walls[planes[k]]);
            part |= select(0u, 1u << k, dot(plane.xyz, position) > plane.w);
        }
    }
    let mask = (select(record.z, record.w, part >= 4u) >> (8u * (part & 3u))) & 0xffu;
    // Toward the corners where walls end the hidden corners fade in, so that nothing jumps where the next cell has no wall.
    var corner_weights = weights; // a variable, so that k may index it
    var at_ends = 0.0;
    for (var k = 0u; k < 8u; k++) {
        at_ends += corner_weights[k] * f32((record.y >> (16u + k)) & 1u);
    }
    let hidden = max(0.0, 2.0 * at_ends - 1.0);
    var shares: array<f32, 8>;
    for (var k = 0u; k < 8u; k++) {
        shares[k] = select(hidden, 1.0, ((mask >> k) & 1u) == 1u);
    }
    return shares;
}

fn gdibl_irradiance(position: vec3<f32>, normal: vec3<f32>) -> vec3<f32> {
    let counts = gdibl_volume.counts;
    // The position in units of nodes, held within the grid; the cell around it, and the share of its higher nodes.
    let biased = position + gdibl_volume.bias * normal;
    let place = clamp(biased * gdibl_volume.nodes_per_metre, vec3<f32>(0.0), vec3<f32>(counts - 1u));
    let lowest = min(vec3<u32>(place), max(counts, vec3<u32>(2u)) - 2u);
    let share = place - vec3<f32>(lowest);

    // Corner k is the higher one in x, y, z where bit 0, 1, 2 of k is set. With one node on an axis both are the same.
    let strides = vec3<u32>(1u, counts.x, counts.x * counts.y);
    let steps = select(vec3<u32>(0u), strides, counts > vec3<u32>(1u));
    let first = dot(lowest, strides);
    var nodes: array<u32, 8>;
    var weights: array<f32, 8>;
    for (var k = 0u; k < 8u; k++) {
        let high = (vec3<u32>(k) >> vec3<u32>(0u, 1u, 2u)) & vec3<u32>(1u);
        let along = select(1.0 - share, share, high == vec3<u32>(1u));
        nodes[k] = first + dot(high, steps);
        weights[k] = along.x * along.y * along.z;
    }

    if gdibl_volume.marked != 0u {
        // Of valid nodes alone.
        var valid: array<f32, 8>;
        var valid_sum = 0.0;
        for (var k = 0u; k < 8u; k++) {
            let bits = gdibl_marks[3u * (nodes[k] >> 5u)];
            valid[k] = weights[k] * f32((bits >> (nodes[k] & 31u)) & 1u);
            valid_sum += valid[k];
        }
        // Of those, what is seen from here.
        var seen: array<f32, 8>;
        var seen_sum = 0.0;
        let block = 3u * (first >> 5u);
        let walled = gdibl_marks[block + 1u];
        let bit = 1u << (first & 31u);
        if (walled & bit) != 0u {
            let record = gdibl_walls[gdibl_marks[block + 2u] + countOneBits(walled & (bit - 1u))];
            let held = clamp(biased, vec3<f32>(0.0), gdibl_volume.extent);
            var shares = gdibl_shares(record, held, weights);
            for (var k = 0u; k < 8u; k++) {
                seen[k] = valid[k] * shares[k];
                seen_sum += seen[k];
            }
        }
        // Weights add up to 1 again. Where no node is seen, all valid ones count; where none is valid, all do.
        for (var k = 0u; k < 8u; k++) {
            if seen_sum >= GDIBL_LEAST {
                weights[k] = seen[k] / seen_sum;
            } else if valid_sum >= GDIBL_LEAST {
                weights[k] = valid[k] / valid_sum;
            }
        }
    }

    var sum = vec3<f32>(0.0);
    for (var k = 0u; k < 8u; k++) {
        // Nodes without weight are not read.
        if weights[k] > 0.0 {
            sum += weights[k] * gdibl_node_irradiance(nodes[k], normal);
        }
    }
    return gdibl_volume.scale * sum;
}
