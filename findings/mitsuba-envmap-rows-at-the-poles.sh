#!/usr/bin/env bash
# Mitsuba 3.9.1, `envmap`: the first and the last row of the image lie on the poles, row k at v = k / (H - 1). In OpenEXR's lat-long
# mapping, which the images come in, a row has an area and its centre lies at v = (k + 1/2) / H. So in a sky of four rows, of which
# the top one is 1, Mitsuba reads 0.625 where that row's centre is, and 1 at the pole alone.
#
# Seen with the variant scalar_rgb, Python 3.11:
#   v = 0.000: 1.000     v = 0.125 (centre of row 0): 0.625     v = 0.250: 0.250     v = 0.375 (centre of row 1): 0.000
#
# What it does to a bake: irradiance of a sky of 512 rows with a sun high up differs by about a per cent from that of a renderer that
# reads rows by their centres. Whoever compares the two resamples the sky first, or compares their own mapping.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" -q install mitsuba==3.9.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import sys
import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
rows = np.zeros((4, 8, 3), np.float32)
rows[0] = 1.0
sky = mi.load_dict({"type": "scene", "sky": {"type": "envmap", "bitmap": mi.Bitmap(rows)}}).environment()


def radiance(v):
    place = mi.SurfaceInteraction3f()
    theta = np.pi * v
    place.wi = mi.ScalarVector3f(0.0, -float(np.cos(theta)), -float(np.sin(theta)))
    return float(np.array(sky.eval(place))[0])


expected = {0.0: 1.0, 0.125: 0.625, 0.25: 0.25, 0.375: 0.0}
found = {v: radiance(v) for v in expected}
for v, value in found.items():
    print(f"v = {v:.3f}: {value:.3f}")
if any(abs(found[v] - expected[v]) > 1e-3 for v in expected):
    sys.exit("changed: rows are no longer at v = k / (H - 1)")
PYTHON
