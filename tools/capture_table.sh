#!/usr/bin/env bash
# Bakes levels by probes captured from them, and by path tracing with as many directions, and compares both with path
# tracing with 16 times as many: one Markdown row per level.
# usage: tools/capture_table.sh LEVELS_FOLDER SKY_IMAGE [GDIBL]
set -eu
levels=$1 sky=$2 gdibl=${3:-target/release/gdibl}
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
directions=4096
# seconds of a bake, and the rest of what it says, as JSON
bake() { "$gdibl" bake "$@" --force --cache "$out/cache" --quiet --json 2> /dev/null; }
row() {
  local name=$1 level=$levels/$2
  shift 2
  bake "$level" "$@" --method gdibl --samples $directions -o "$out/a.gdibl" > "$out/cold.json"
  bake "$level" "$@" --method gdibl --samples $directions -o "$out/a.gdibl" > "$out/warm.json"
  bake "$level" "$@" --samples $directions --method path --seed 1 -o "$out/path.gdibl" > "$out/path.json"
  bake "$level" "$@" --samples $((16 * directions)) --method path --seed 2 -o "$out/truth.gdibl" > "$out/truth.json"
  for volume in a path; do "$gdibl" compare "$out/$volume.gdibl" "$out/truth.gdibl" --json > "$out/$volume.compare.json"; done
  python3 - "$name" "$out" << 'PYTHON'
import json, sys
name, out = sys.argv[1:]
read = lambda file: json.load(open(f"{out}/{file}.json"))
cold, warm, path = read("cold"), read("warm"), read("path")
probes = next(row["why"] for row in cold["plan"] if row["stage"] == "capture").split(": ")[1].split()[0]
def error(volume):
    all = read(volume + ".compare")["all"]
    return f'{100 * all["relative_rmse"]:.1f} %', f'{100 * all["per_node"]["median"]:.1f} %', f'{100 * all["noise"]:.1f} %'
(rmse, median, noise), (path_rmse, path_median, _) = error("a"), error("path")
capture = cold["wall_seconds"] - warm["wall_seconds"]
print(f'| {name} | {probes} in {capture:.0f} s | {warm["wall_seconds"]:.1f} s | {100 * cold["coverage"]:.0f} % '
      f'| {rmse} | {noise} | {median} | {path["wall_seconds"]:.1f} s | {path_rmse} | {path_median} |')
PYTHON
  rm -rf "$out"/cache
}
echo "| level | probes captured | bake | coverage | error | of which noise | median node | path tracing | error | median node |"
echo "|---|---|---|---|---|---|---|---|---|---|"
row "Cornell box (Bevy)" bevy/CornellBox/CornellBox.glb --bounds=-520,30,-520,-40,500,-40 --counts 8,8,8
row "Cornell box (nvpro)" nvpro-cornell/cornellBox.gltf --bounds=-4.5,-4.5,-4.5,4.5,3.5,4.5 --counts 8,8,8
row "living room, sky" godot/living_room.glb --distant "$sky" --bounds=-4.5,0.2,-2,4.5,3.5,11 --counts 10,4,13
row "apartment, sky" dream-apartment-plain/dream-apartment.glb --distant "$sky" --bounds=3,0.3,-9,10,2.4,-1 --counts 9,4,9
row "pandora (game map)" cube2/sauerbraten_pandora.glb --bounds=-20,4,-16,20,18,16 --counts 11,5,9
