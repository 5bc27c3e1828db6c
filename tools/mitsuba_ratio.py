#!/usr/bin/env python3
"""Milliseconds per node of a bake and of Mitsuba's path tracing at equal error: one run, one core, the same nodes.

usage: python3 tools/mitsuba_ratio.py EMPTY_BOX.glb LIGHTING_FOLDER [--sky IMAGE] [--gdibl target/release/gdibl]
                                      [--core 0] [--repeats 4]
needs: pip install mitsuba numpy; LLVM 16 or later, named by DRJIT_LIBLLVM_PATH where Dr.Jit does not find it (LLVM 14 and
15 do not compile its kernels)

LIGHTING_FOLDER holds distant.exr, probe_0..2.exr and reference.json, as assets/uffizi-box does. --sky is the panorama that
the reference was traced with, for Mitsuba (of `stiff`: kloppenheim_05_1k.hdr); without it Mitsuba takes distant.exr. The bake
takes the three probes and distant.exr.

Mitsuba's `envmap` has its first and last row on the poles; in the images a row's centre lies half a row from them
(findings/mitsuba-envmap-rows-at-the-poles.sh). So it is given the same sky in 4 H + 1 rows, row k at v = k / 4H: between these it
reads what gdibl reads. How far off E of the sky would be without that is printed. The truth of `stiff` was traced without: its
sky is off by as much.

Both sides estimate radiance SH to L2 at the reference's nodes, with several budgets, and repeats that differ in their seeds.
E is compared in 26 directions and three channels, as `gdibl compare` does:

    error of a node = sqrt(mean d² / mean E²)        relative RMSE: the same over all nodes at once
    noise²  = mean over repeats of (E_r - Ē)², times R / (R - 1)
    floor²  = mean (Ē - E)² - noise²/R - the reference's own noise²

Time is CPU time of all threads, pinned to one core, and of estimating alone: without reading, trees, tables of importance,
compiling kernels; Mitsuba's without its projection onto SH, too. What GDIBL sets up before it bakes is printed beside it.

Mitsuba's estimator, in the way that is fastest for it. Radiance at a node is what surfaces send and what the sky sends:

    surfaces: `path` in scalar_rgb with hidden emitters, through six square cameras of 90 degrees; stratified over pixels
              and within them (`multijitter`); a pixel counts as the integral of Y_lm over it
              (with 4 paths per pixel E of `stiff` was 0.6 % too dark by `multijitter`, by `independent` right; with 64
              it was right, with less noise)
    sky:      1/n sum L(ω) Y(ω) V(ω) / p(ω) by `sample_emitter_direction` in llvm_ad_rgb, one thread, jittered: the sun
              is met by uniform directions once in 100 000
"""

import argparse, json, os, struct, subprocess, sys, tempfile, time
from pathlib import Path

arguments = argparse.ArgumentParser(usage=__doc__.replace("%", "%%"))
arguments.add_argument("level", type=Path)
arguments.add_argument("lighting", type=Path)
arguments.add_argument("--sky", type=Path)
arguments.add_argument("--gdibl", default="target/release/gdibl")
arguments.add_argument("--core", type=int, default=0)
arguments.add_argument("--repeats", type=int, default=4)
options = arguments.parse_args()
# Before libraries count cores; children inherit it.
all_cores = os.sched_getaffinity(0)
os.sched_setaffinity(0, {options.core})
os.environ["RAYON_NUM_THREADS"] = "1"

import mitsuba as mi
import numpy as np

level, lighting = options.level.resolve(), options.lighting.resolve()
SETS = ["grid", "scattered"]
PROBES = [(0, 1, 2.999), (0, 1, 0), (0, 1, -2.999)]
BUDGETS = [512, 1024, 2048, 4096, 16384]
# Pixels along a side of a face. 16 beat 32 and 64 with as many paths: more strata within the pixel.
FACE = 16
PATHS_PER_PIXEL = [4, 16, 64]
# Paths per sample of the sky: with more the sky decides the noise, with less the time.
SKY_SHARE = 2
TARGET = 0.01

# --- spherical harmonics, the reference, errors


def basis(x, y, z):
    """Y_lm to L2 in gdibl's order: orthonormal, without the Condon-Shortley sign."""
    return [0.28209479 + 0 * x, 0.4886025 * y, 0.4886025 * z, 0.4886025 * x, 1.0925484 * x * y, 1.0925484 * y * z,
            0.31539157 * (3 * z * z - 1), 1.0925484 * x * z, 0.5462742 * (x * x - y * y)]


def fibonacci_sphere(count):
    i = np.arange(count) + 0.5
    z, angle = 1 - 2 * i / count, np.pi * (3 - 5**0.5) * i
    r = np.sqrt(1 - z * z)
    return r * np.cos(angle), r * np.sin(angle), z


cosine = np.pi * np.array([1] + [2 / 3] * 3 + [1 / 4] * 5)
to_irradiance = np.array(basis(*fibonacci_sphere(26))).T * cosine
irradiance_of = lambda sh: np.einsum("dk,nkc->ndc", to_irradiance, sh)
reference = json.loads((lighting / "reference.json").read_text())
joined = lambda key: np.concatenate([np.array(reference[name][key]) for name in SETS])
nodes, truth = joined("position"), irradiance_of(joined("sh"))
square_truth = (truth**2).mean()
reference_variance = np.einsum("dk,nkc->ndc", to_irradiance**2, joined("standard_error") ** 2).mean() / square_truth


def errors(repeats):
    """Of estimates of E by several seeds: what one of them is off by, and what of it is noise. Shares."""
    found = np.array(repeats)
    square = (found - truth) ** 2
    per_node = np.sqrt(square.mean((2, 3)) / (truth**2).mean((1, 2)))
    noise_square = found.var(0, ddof=1).mean() / square_truth
    mean = found.mean(0)
    floor_square = ((mean - truth) ** 2).mean() / square_truth - noise_square / len(found) - reference_variance
    return {"rmse": np.sqrt(square.mean() / square_truth), "median": np.median(per_node, 1).mean(),
            "noise": np.sqrt(noise_square), "floor": np.sqrt(max(0, floor_square)),
            "bias": mean.mean() / truth.mean() - 1,
            "bias_error": np.std(found.mean((1, 2, 3)), ddof=1) / len(found) ** 0.5 / truth.mean()}


def cost_at(rows, key, target):
    """Milliseconds per node at an error: on the line of logarithms between the two rows around it, or by 1/sqrt(n) from the
    last, marked. None: the error stands still."""
    for a, b in zip(rows, rows[1:]):
        if a[key] > target >= b[key]:
            share = np.log(a[key] / target) / np.log(a[key] / b[key])
            return a["ms"] * (b["ms"] / a["ms"]) ** share, ""
    last = rows[-1]
    if last[key] < target or last[key] > 2 * target or last["floor"] > 0.5 * target and key == "rmse":
        return None, ""
    return last["ms"] * (last[key] / target) ** 2, " (extrapolated)"


# --- the bake


def run(*command):
    done = subprocess.run([str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}: exit code {done.returncode}: {done.stderr.strip()}")
    return json.loads(done.stdout)


def measure_bake(folder):
    """Times by `gdibl study`, which holds the clock around the bake alone; values by `gdibl bake` with the same nodes."""
    toml = folder / "box.bake.toml"
    probes = [f'[[probe]]\nimage = "{lighting}/probe_{i}.exr"\nposition = {list(map(float, position))}\n'
              for i, position in enumerate(PROBES)]
    toml.write_text(f'level = "{level}"\ndistant = "{lighting}/distant.exr"\n' + "".join(probes))
    sets = [word for name in SETS for word in ("--set", name)]
    one_thread = ["--threads", 1, "--json", "--quiet"]
    study = run(options.gdibl, "study", toml, "--reference", lighting / "reference.json", *sets, *one_thread, "--methods",
                "gdibl", "--budgets", ",".join(map(str, BUDGETS)), "--repeats", options.repeats, "-o", folder / "study")
    points = next(method["points"] for method in study["study"]["methods"] if method["name"] == "gdibl")
    csv = folder / "nodes.csv"
    csv.write_text("x,y,z\n" + "".join(f"{x!r},{y!r},{z!r}\n" for x, y, z in nodes.tolist()))
    rows = []
    for point in points:
        found = []
        for seed in range(options.repeats):
            volume, exported = folder / "a.gdibl", folder / "a.json"
            run(options.gdibl, "bake", toml, "--nodes", f"points:{csv}", "--samples", point["budget"], "--seed", seed + 1,
                "--precision", "f32", *one_thread, "-o", volume)
            export = [options.gdibl, "export", volume, "--to", "json", "-o", exported]
            subprocess.run(export, check=True, capture_output=True)
            found.append(irradiance_of(read_sh(exported)))
        rows.append({"n": point["budget"], "ms": point["milliseconds_per_node"]["middle"], "setup": point["setup_seconds"],
                     **errors(found)})
    return rows


def read_sh(path):
    exported = json.loads(path.read_text())
    off = abs(np.array(exported["positions"]) - nodes).max()
    assert off < 1e-5, f"{path}: a node is {off} m from its place"
    return np.array(exported["radiance"], float).reshape(len(nodes), 9, 3)


# --- Mitsuba


def write_meshes(folder):
    """The level's meshes as PLY, with their albedo."""
    data = level.read_bytes()
    size = struct.unpack("<I", data[12:16])[0]
    gltf, binary = json.loads(data[20:20 + size]), data[28 + size:]

    def read(index):
        accessor = gltf["accessors"][index]
        view = gltf["bufferViews"][accessor["bufferView"]]
        width, kind = {"VEC3": 3, "SCALAR": 1}[accessor["type"]], {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        return np.frombuffer(binary, kind, accessor["count"] * width, start)

    meshes = []
    for i, node in enumerate(gltf["nodes"]):
        primitive = gltf["meshes"][node["mesh"]]["primitives"][0]
        positions = read(primitive["attributes"]["POSITION"])
        faces = np.empty(read(primitive["indices"]).size // 3, dtype=[("count", "u1"), ("corners", "<i4", 3)])
        faces["count"], faces["corners"] = 3, read(primitive["indices"]).reshape(-1, 3)
        header = ["ply", "format binary_little_endian 1.0", f"element vertex {positions.size // 3}"]
        header += [f"property float {axis}" for axis in "xyz"] + [f"element face {len(faces)}"]
        header += ["property list uchar int vertex_indices", "end_header\n"]
        path = folder / f"mesh_{i}.ply"
        path.write_bytes("\n".join(header).encode() + positions.tobytes() + faces.tobytes())
        albedo = gltf["materials"][primitive["material"]]["pbrMetallicRoughness"]["baseColorFactor"][:3]
        meshes.append((str(path), albedo))
    return meshes


def read_sky(folder):
    """The sky as a file that Mitsuba reads as gdibl does, and how far E of it would be off without that.

    Converted by a process of its own on all cores: on one core Mitsuba waits for ever when it reads an EXR."""
    image, copy = folder / "image.npy", folder / "sky.pfm"
    convert = ("import sys, numpy as np, mitsuba as mi; mi.set_variant('scalar_rgb'); np.save(sys.argv[2], np.array(mi.Bitmap"
               "(sys.argv[1]).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False)))")
    free = lambda: os.sched_setaffinity(0, all_cores)
    sky = (options.sky or lighting / "distant.exr").resolve()
    subprocess.run([sys.executable, "-c", convert, str(sky), str(image)], check=True, timeout=60, preexec_fn=free)
    rows = np.load(image).astype(float)
    height = len(rows)
    by_centres = lambda v: rows_at(rows, v * height - 0.5)
    by_poles = lambda v: rows_at(rows, v * (height - 1))
    resampled = by_centres(np.arange(4 * height + 1) / (4 * height))
    # PFM, from the lowest row up.
    copy.write_bytes(f"PF\n{rows.shape[1]} {len(resampled)}\n-1\n".encode() + resampled[::-1].astype("<f4").tobytes())
    true, naive = (irradiance_of_sky(reading) for reading in (by_centres, by_poles))
    return str(copy), np.sqrt(((naive - true) ** 2).mean() / (true**2).mean())


def rows_at(rows, place):
    """Rows between rows, which are numbered from 0 on; none lies outside."""
    place = np.clip(place, 0, len(rows) - 1)
    lower = np.minimum(place.astype(int), len(rows) - 2)
    share = (place - lower)[:, None, None]
    return rows[lower] * (1 - share) + rows[lower + 1] * share


def irradiance_of_sky(reading, count=4096):
    """E in 26 directions under a sky of which `reading` tells rows by v."""
    v = (np.arange(count) + 0.5) / count
    light, sine = reading(v), np.sin(np.pi * v)
    width = light.shape[1]
    longitude = 2 * np.pi * (0.5 - (np.arange(width) + 0.5) / width)
    latitude = np.pi * (0.5 - v)[:, None]
    x, y, z = np.sin(longitude) * np.cos(latitude), np.sin(latitude) + 0 * longitude, np.cos(longitude) * np.cos(latitude)
    weight = sine[:, None] * (2 * np.pi / width) * (np.pi / count)
    sh = np.stack([np.einsum("rw,rwc->c", value * weight, light) for value in basis(x, y, z)])
    return irradiance_of(sh[None])


def load_scene(variant, meshes, sky_file):
    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    # As many bounces as the reference's; the sky's own axes are glTF's. Roulette from the path's default on.
    scene = {"type": "scene", "sky": {"type": "envmap", "filename": sky_file},
             "integrator": {"type": "path", "max_depth": 65, "hide_emitters": True}}
    for i, (path, albedo) in enumerate(meshes):
        diffuse = {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}}
        scene[f"mesh_{i}"] = {"type": "ply", "filename": path, "bsdf": {"type": "twosided", "side": diffuse}}
    return mi.load_dict(scene)


FACES = [((1, 0, 0), (0, 1, 0)), ((-1, 0, 0), (0, 1, 0)), ((0, 1, 0), (0, 0, 1)), ((0, -1, 0), (0, 0, 1)),
         ((0, 0, 1), (0, 1, 0)), ((0, 0, -1), (0, 1, 0))]


def pixel_integrals(forward, up, within=8):
    """The integral of Y_lm over every pixel of a face: `within` x `within` points each."""
    forward, up = np.array(forward, float), np.array(up, float)
    left = np.cross(up, forward)
    place = (np.arange(FACE * within) + 0.5) / (FACE * within) * 2 - 1
    x, y = np.meshgrid(place, place)
    direction = forward - y[..., None] * up - x[..., None] * left
    length = np.linalg.norm(direction, axis=-1)
    solid_angle = (2 / (FACE * within)) ** 2 / length**3
    values = np.stack(basis(*np.moveaxis(direction / length[..., None], -1, 0)), -1) * solid_angle[..., None]
    return values.reshape(FACE, within, FACE, within, 9).sum((1, 3))


integrals = [pixel_integrals(*face) for face in FACES]


def surfaces(scene, per_pixel, seed):
    """Light of surfaces: SH, and CPU seconds of rendering."""
    sh, seconds = np.zeros((len(nodes), 9, 3)), 0.0
    film = {"type": "hdrfilm", "width": FACE, "height": FACE, "rfilter": {"type": "box"}, "pixel_format": "rgb",
            "component_format": "float32"}
    for node, origin in enumerate(nodes):
        for face, (forward, up) in enumerate(FACES):
            look = mi.ScalarTransform4f().look_at(origin=origin.tolist(), target=(origin + forward).tolist(), up=up)
            sensor = mi.load_dict({"type": "perspective", "fov": 90, "to_world": look, "near_clip": 1e-3, "film": film,
                                   "sampler": {"type": "multijitter", "sample_count": per_pixel}})
            start = time.process_time()
            image = mi.render(scene, sensor=sensor, spp=per_pixel, seed=(seed * len(nodes) + node) * 6 + face)
            seconds += time.process_time() - start
            sh[node] += np.einsum("ijk,ijc->kc", integrals[face], np.array(image))
    return sh, seconds


def llvm_batch(count, seed):
    """`count` rays of every node, as one wavefront: nodes' positions, and two random numbers each."""
    import drjit as dr
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, len(nodes) * count)
    ray = dr.arange(mi.UInt32, len(nodes) * count)
    origin = dr.gather(mi.Point3f, mi.Point3f(nodes.T.astype(np.float32)), ray // count)
    return dr, sampler, ray % count, origin


def project(dr, direction, radiance, count):
    values = basis(direction.x, direction.y, direction.z)
    sums = [dr.block_reduce(dr.ReduceOp.Add, radiance[c] * value, count) for value in values for c in range(3)]
    dr.eval(sums)
    return np.array([np.array(value) for value in sums], float).T.reshape(len(nodes), 9, 3) / count


def sky(scene, side, seed):
    """Light of the sky that a node sees: side² directions by its radiance."""
    start = time.process_time()
    dr, sampler, ray, origin = llvm_batch(side * side, seed)
    place = dr.zeros(mi.SurfaceInteraction3f, dr.width(ray))
    place.p = origin
    uniform = (sampler.next_2d() + mi.Point2f(mi.Float(ray % side), mi.Float(ray // side))) / side
    sample, weight = scene.sample_emitter_direction(place, uniform, True)
    sh = project(dr, sample.d, weight, side * side)
    return sh, time.process_time() - start


def llvm_paths(scene, count, seed):
    """Seconds of `count` paths per node by llvm_ad_rgb: the other way to trace them."""
    start = time.process_time()
    dr, sampler, _, origin = llvm_batch(count, seed)
    direction = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    radiance, *_ = scene.integrator().sample(scene, sampler, mi.RayDifferential3f(origin, direction))
    project(dr, direction, radiance, count)
    return time.process_time() - start


def measure_mitsuba(folder):
    import drjit
    meshes = write_meshes(folder)
    sky_file, off_at_poles = read_sky(folder)
    scene, rows, light = load_scene("scalar_rgb", meshes, sky_file), [], []
    for per_pixel in PATHS_PER_PIXEL:
        light.append([surfaces(scene, per_pixel, seed) for seed in range(options.repeats)])
    scene = load_scene("llvm_ad_rgb", meshes, sky_file)
    drjit.set_thread_count(1)
    for per_pixel, of_surfaces in zip(PATHS_PER_PIXEL, light):
        paths = 6 * FACE * FACE * per_pixel
        side = max(8, round((paths / SKY_SHARE) ** 0.5))
        sky(scene, side, 1)  # compiles
        of_sky = [sky(scene, side, 100 + seed) for seed in range(options.repeats)]
        per_node = lambda parts: 1e3 * float(np.median([seconds for _, seconds in parts])) / len(nodes)
        found = [irradiance_of(a + b) for (a, _), (b, _) in zip(of_surfaces, of_sky)]
        sky_variance = np.array([irradiance_of(sh) for sh, _ in of_sky]).var(0, ddof=1).mean() / square_truth
        rows.append({"n": paths, "ms": per_node(of_surfaces) + per_node(of_sky), "sky_ms": per_node(of_sky),
                     "sky_n": side * side, "sky_noise": sky_variance**0.5, **errors(found)})
    llvm_paths(scene, 256, 1)  # compiles
    by_llvm = 1e6 * llvm_paths(scene, 256, 2) / len(nodes) / 256
    by_scalar = 1e3 * (rows[-1]["ms"] - rows[-1]["sky_ms"]) / rows[-1]["n"]
    return rows, by_scalar, by_llvm, off_at_poles


# --- both


percent = lambda share: f"{100 * share:.2f} %"
with tempfile.TemporaryDirectory() as name:
    bake = measure_bake(Path(name))
    mitsuba, by_scalar, by_llvm, off_at_poles = measure_mitsuba(Path(name))
print(f"{lighting.name}, {len(nodes)} nodes, one thread on one core, {options.repeats} repeats. "
      f"The reference's own noise, left in errors, not in floors: {percent(reference_variance**0.5)}\n")
columns = "directions per node, ms per node, median node, relative RMSE, of which noise, floor, mean signed difference"
print(f"| | {columns.replace(', ', ' | ')} |")
print("|---|---|---|---|---|---|---|---|")
for who, rows in (("gdibl", bake), (f"Mitsuba {mi.__version__}", mitsuba)):
    for row in rows:
        count = f"{row['n']} + {row['sky_n']}" if "sky_n" in row else row["n"]
        shares = " | ".join(percent(row[key]) for key in ("median", "rmse", "noise", "floor"))
        print(f"| {who} | {count} | {row['ms']:.2f} | {shares} | "
              f"{100 * row['bias']:+.2f} ± {100 * row['bias_error']:.2f} % |")
last = mitsuba[-1]
print(f"\nMitsuba's path: {by_scalar:.2f} µs by scalar_rgb, which counts; {by_llvm:.1f} by llvm_ad_rgb. "
      f"Its samples of the sky take {last['sky_ms']:.1f} of {last['ms']:.1f} ms, their noise is {percent(last['sky_noise'])}.")
print(f"Mitsuba's sky is resampled to 4 H + 1 rows; without that E of the sky alone would be off by {percent(off_at_poles)}.")
print(f"gdibl before it bakes: {1e3 * bake[-1]['setup']:.0f} ms, once.\n")
print("| at | gdibl, ms per node | Mitsuba, ms per node | ratio |")
print("|---|---|---|---|")
targets = [("noise of", "noise", TARGET), ("median node off by", "median", TARGET), ("relative RMSE of", "rmse", 2 * TARGET)]
for words, key, target in targets:
    (a, how_a), (b, how_b) = cost_at(bake, key, target), cost_at(mitsuba, key, target)
    cell = lambda value, how: "does not come to it" if value is None else f"{value:.2f}{how}"
    print(f"| {words} {percent(target)} | {cell(a, how_a)} | {cell(b, how_b)} | {f'{b / a:.0f}' if a and b else '-'} |")
