// Samples a gdibl irradiance volume (a grid, sparse or not): irradiance at a position, trilinear between nodes, with validity and walls.
//
//     let irradiance = gdibl_irradiance(world_position - volume_min, normal);
//     let diffuse = albedo / 3.14159265 * max(irradiance, vec3<f32>(0.0));    // here is the 1/pi
//
// Paste this file before your own, and upload what `Volume::gpu_buffers` of the crate gdibl-runtime returns. The same in
// GLSL and HLSL lies beside it. What it computes is said in FORMAT.md, "Light at a position", "Sparse grids", "Walls" and "From
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
    counts: vec3<u32>,          // nodes per axis; node (x, y, z) is x + counts.x * (y + counts.y * z). Of a sparse grid places
    bands: u32,                 // 0, 1, 2: 1, 4, 9 coefficients per channel
    extent: vec3<f32>,          // max - min of the box, metres
    bias: f32,                  // metres along the normal: a surface in a wall's plane falls to the side that it faces
    marked: u32,                // 0: every node is valid and there are no walls
    levels: u32,                // 0: a grid. Else a sparse one, its largest cells 2^levels places wide
    valid_at: u32,              // sparse: where in gdibl_marks the bits of valid nodes begin
    step: f32,                  // of packed coefficients; 0: they are f16
}

// Change the group and the bindings to yours.
@group(0) @binding(0) var<uniform> gdibl_volume: GdiblVolume;

// Radiance coefficients as pairs of f16, 2, 6 or 14 words per node: red, green, blue of coefficient 0, then of 1, ...
// Or packed, where the volume has a step: per 64 nodes a head of 3 C + 3 words (C = 1, 4, 9), then rows of bits; see gdibl_packed.
@group(0) @binding(1) var<storage, read> gdibl_coefficients: array<u32>;

// Grid: 3 words per 32 nodes: bits of valid nodes; bits of nodes which are the lowest corner of a cell with walls; where in
// gdibl_walls the record of the first of these cells is.
// Sparse grid: 38 words per brick of 8 x 8 x 8 places: its first node; where the record of its first cell with walls is; the
// nodes before each z, 16 bits each; 16 words of bits of nodes, two per z; as many of lowest corners of cells with walls.
@group(0) @binding(2) var<storage, read> gdibl_marks: array<u32>;

// First the planes: unit normal and distance, as bits of floats. Then the cells:
//     x  indices of planes 0 and 1, 16 bits each      y  index of plane 2; from bit 16 on the corners where walls end
//     z, w  8 masks of 8 bits: the corners that count in each part of the cell
@group(0) @binding(3) var<storage, read> gdibl_walls: array<vec4<u32>>;

// Weights that add up to less than this are those of nobody.
const GDIBL_LEAST: f32 = 1e-6;
const GDIBL_NO_PLANE: u32 = 0xffffu;
// No node, no record.
const GDIBL_NONE: u32 = 0xffffffffu;

// The next number of a row: what is over the least of its 64 nodes, in as many bits as that takes. `place` is that of its words
// in the head, and of its first bit in the rows; both move on.
fn gdibl_number(rows: u32, place: ptr<function, vec2<u32>>) -> i32 {
    let head = gdibl_coefficients[(*place).x];
    let width = head >> 16u;
    let word = rows + ((*place).y >> 5u);
    let shift = (*place).y & 31u;
    var bits = gdibl_coefficients[word] >> shift;
    if shift + width > 32u {
        bits |= gdibl_coefficients[word + 1u] << (32u - shift);
    }
    *place += vec2<u32>(1u, width);
    return (bitcast<i32>(head << 16u) >> 16u) + i32(bits & ((1u << width) - 1u));
}

// Irradiance of one node in packed coefficients. Its numbers q are steps of irradiance's coefficients in M, which is the first of
// all in an orthonormal basis of colour: (r + g + b) / sqrt(3), (r - b) / sqrt(2), (2 g - r - b) / sqrt(6). The constants are
// those of the basis functions.
fn gdibl_packed(node: u32, normal: vec3<f32>) -> vec3<f32> {
    let n = normal;
    var functions = array<f32, 9>(
        0.28209479,
        0.48860251 * n.y, 0.48860251 * n.z, 0.48860251 * n.x,
        1.0925484 * n.x * n.y, 1.0925484 * n.y * n.z, 0.31539157 * (3.0 * n.z * n.z - 1.0), 1.0925484 * n.x * n.z,
        0.54627422 * (n.x * n.x - n.y * n.y)
    );
    let count = (gdibl_volume.bands + 1u) * (gdibl_volume.bands + 1u);
    let head = (node >> 6u) * (3u * count + 3u);
    let rows = gdibl_coefficients[head];
    var place = vec2<u32>(head + 2u, (node & 63u) * gdibl_coefficients[head + 1u]);
    let code = gdibl_number(rows, &place);
    if code < 1 {
        return vec3<f32>(0.0);
    }
    let m = exp2(f32(code - 16384) / 256.0);
    var k = vec3<f32>(0.0);
    for (var i = 0u; i < count; i++) {
        let q0 = gdibl_number(rows, &place);
        let q1 = gdibl_number(rows, &place);
        let q2 = gdibl_number(rows, &place);
        k += functions[i] * vec3<f32>(f32(q0), f32(q1), f32(q2));
    }
    k = gdibl_volume.step * k + vec3<f32>(functions[0], 0.0, 0.0);
    k *= m * vec3<f32>(0.57735027, 0.70710678, 0.40824829);
    return vec3<f32>(k.x + k.y - k.z, k.x + 2.0 * k.z, k.x - k.y - k.z);
}

// Irradiance of one node over `scale`, for a surface with this normal: sum of A_l L_lm Y_lm(normal), A = pi, 2 pi/3, pi/4.
// The constants are A_l times that of the basis function.
fn gdibl_node_irradiance(node: u32, normal: vec3<f32>) -> vec3<f32> {
    if gdibl_volume.step > 0.0 {
        return gdibl_packed(node, normal);
    }
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

// Where in gdibl_marks the brick that holds a place begins.
fn gdibl_brick(place: vec3<u32>) -> u32 {
    let bricks = (gdibl_volume.counts + 7u) >> vec3<u32>(3u);
    let brick = place >> vec3<u32>(3u);
    return 38u * (brick.x + bricks.x * (brick.y + bricks.y * brick.z));
}

// Which of a brick's words of bits a place is in, and which bit it is.
fn gdibl_bit(place: vec3<u32>) -> vec2<u32> {
    let within = place & vec3<u32>(7u);
    return vec2<u32>(2u * within.z + (within.y >> 2u), within.x + 8u * (within.y & 3u));
}

// The node at a place of a sparse grid.
fn gdibl_node_at(place: vec3<u32>) -> u32 {
    let brick = gdibl_brick(place);
    let at = gdibl_bit(place);
    let bits = gdibl_marks[brick + 6u + at.x];
    if ((bits >> at.y) & 1u) == 0u {
        return GDIBL_NONE;
    }
    let before = gdibl_marks[brick + 2u + (at.x >> 2u)] >> (8u * (at.x & 2u));
    var node = gdibl_marks[brick] + (before & 0xffffu) + countOneBits(bits & ((1u << at.y) - 1u));
    if (at.x & 1u) == 1u {
        node += countOneBits(gdibl_marks[brick + 5u + at.x]);
    }
    return node;
}

// The nodes and weights of the cell of a sparse grid that holds `place`, which is in `lowest` of the finest. Returns where
// its record is if walls go through it.
fn gdibl_sparse_cell(
    place: vec3<f32>,
    lowest: vec3<u32>,
    nodes: ptr<function, array<u32, 8>>,
    weights: ptr<function, array<f32, 8>>,
) -> u32 {
    let wide = select(vec3<u32>(0u), vec3<u32>(1u), gdibl_volume.counts > vec3<u32>(1u));
    let brick = gdibl_brick(lowest);
    // From the largest cells downward: a cell is divided if its middle is a node.
    var level = gdibl_volume.levels;
    var origin = lowest;
    loop {
        origin = (lowest >> vec3<u32>(level)) << vec3<u32>(level);
        let at = gdibl_bit(origin + ((1u << level) >> 1u) * wide);
        if level == 0u || ((gdibl_marks[brick + 6u + at.x] >> at.y) & 1u) == 0u {
            break;
        }
        level -= 1u;
    }
    let width = 1u << level;
    let share = (place - vec3<f32>(origin)) / f32(width);
    // The corner that is the larger cell's, too.
    let upper = (origin >> vec3<u32>(level)) & vec3<u32>(1u);
    let shared_corner = upper.x | (upper.y << 1u) | (upper.z << 2u);
    // A corner that is no node lies in the middle of the larger cell's edge or face: its far end takes the place.
    var hanging = 0u;
    for (var k = 0u; k < 8u; k++) {
        let high = (vec3<u32>(k) >> vec3<u32>(0u, 1u, 2u)) & vec3<u32>(1u);
        let along = select(1.0 - share, share, high == vec3<u32>(1u));
        (*weights)[k] = along.x * along.y * along.z;
        let corner = origin + width * high * wide;
        var node = gdibl_node_at(corner);
        if node == GDIBL_NONE {
            hanging |= 1u << k;
            let is_middle = ((corner >> vec3<u32>(level)) & vec3<u32>(1u)) == vec3<u32>(1u);
            let beyond = select(corner + width, corner - width, upper == vec3<u32>(1u));
            node = gdibl_node_at(select(corner, beyond, is_middle));
        }
        (*nodes)[k] = node;
    }
    // Edges: half of the weight stays, half is that of the shared corner.
    for (var axis = 0u; axis < 3u; axis++) {
        let k = shared_corner ^ (1u << axis);
        if ((hanging >> k) & 1u) == 1u {
            (*weights)[k] *= 0.5;
            (*weights)[shared_corner] += (*weights)[k];
        }
    }
    // Faces, across each axis: a quarter stays, a quarter each is that of the others in the larger cell's face.
    for (var axis = 0u; axis < 3u; axis++) {
        let one = 1u << ((axis + 1u) % 3u);
        let two = 1u << ((axis + 2u) % 3u);
        let k = shared_corner ^ one ^ two;
        if ((hanging >> k) & 1u) == 1u {
            (*weights)[k] *= 0.25;
            (*weights)[shared_corner] += (*weights)[k];
            (*weights)[shared_corner ^ one] += (*weights)[k];
            (*weights)[shared_corner ^ two] += (*weights)[k];
        }
    }
    let at = gdibl_bit(origin);
    let walled = gdibl_marks[brick + 22u + at.x];
    if ((walled >> at.y) & 1u) == 0u {
        return GDIBL_NONE;
    }
    var record = gdibl_marks[brick + 1u] + countOneBits(walled & ((1u << at.y) - 1u));
    for (var word = 0u; word < at.x; word++) {
        record += countOneBits(gdibl_marks[brick + 22u + word]);
    }
    return record;
}

fn gdibl_is_valid(node: u32) -> f32 {
    let word = select(3u * (node >> 5u), gdibl_volume.valid_at + (node >> 5u), gdibl_volume.levels > 0u);
    return f32((gdibl_marks[word] >> (node & 31u)) & 1u);
}

fn gdibl_irradiance(position: vec3<f32>, normal: vec3<f32>) -> vec3<f32> {
    let counts = gdibl_volume.counts;
    // The position in units of nodes, held within the grid; the cell around it, and the share of its higher nodes.
    let biased = position + gdibl_volume.bias * normal;
    let place = clamp(biased * gdibl_volume.nodes_per_metre, vec3<f32>(0.0), vec3<f32>(counts - 1u));
    let lowest = min(vec3<u32>(place), max(counts, vec3<u32>(2u)) - 2u);
    var nodes: array<u32, 8>;
    var weights: array<f32, 8>;
    // Of the cell's walls, in gdibl_walls.
    var record_at = GDIBL_NONE;
    if gdibl_volume.levels > 0u {
        record_at = gdibl_sparse_cell(place, lowest, &nodes, &weights);
    } else {
        // Corner k is the higher one in x, y, z where bit 0, 1, 2 of k is set. With one node on an axis both are the same.
        let share = place - vec3<f32>(lowest);
        let strides = vec3<u32>(1u, counts.x, counts.x * counts.y);
        let steps = select(vec3<u32>(0u), strides, counts > vec3<u32>(1u));
        let first = dot(lowest, strides);
        for (var k = 0u; k < 8u; k++) {
            let high = (vec3<u32>(k) >> vec3<u32>(0u, 1u, 2u)) & vec3<u32>(1u);
            let along = select(1.0 - share, share, high == vec3<u32>(1u));
            nodes[k] = first + dot(high, steps);
            weights[k] = along.x * along.y * along.z;
        }
        if gdibl_volume.marked != 0u {
            let block = 3u * (first >> 5u);
            let walled = gdibl_marks[block + 1u];
            let bit = 1u << (first & 31u);
            if (walled & bit) != 0u {
                record_at = gdibl_marks[block + 2u] + countOneBits(walled & (bit - 1u));
            }
        }
    }

    if gdibl_volume.marked != 0u {
        // Of valid nodes alone.
        var valid: array<f32, 8>;
        var valid_sum = 0.0;
        for (var k = 0u; k < 8u; k++) {
            valid[k] = weights[k] * gdibl_is_valid(nodes[k]);
            valid_sum += valid[k];
        }
        // Of those, what is seen from here.
        var seen: array<f32, 8>;
        var seen_sum = 0.0;
        if record_at != GDIBL_NONE {
            let held = clamp(biased, vec3<f32>(0.0), gdibl_volume.extent);
            var shares = gdibl_shares(gdibl_walls[record_at], held, weights);
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
