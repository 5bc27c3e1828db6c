#!/usr/bin/env python3
"""Kills gdibl at random moments, and looks at what is left: no half file ever, and the same bytes in the end.

    tools/farm/kills.py GDIBL LEVEL KILLS [SEED]

LEVEL is a level or a BAKE.toml, which is baked at few nodes. KILLS are divided among bake, shard, assemble, capture, export and cut.
"""
import filecmp
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

gdibl, level, kills = str(Path(sys.argv[1]).resolve()), str(Path(sys.argv[2]).resolve()), int(sys.argv[3])
random.seed(int(sys.argv[4]) if len(sys.argv) > 4 else 0)
root = Path(tempfile.mkdtemp(prefix="gdibl-kills-"))
BAKE = ["--counts", "6,6,12", "--samples", "4096", "--seen-places", "32"]
faults = []


def children_seconds():
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def run(arguments, folder, after=None):
    """Runs, and kills after some seconds. Returns whether it ended by itself, CPU seconds, and the seconds before its end in which it kept
    nothing."""
    before, began = children_seconds(), time.time()
    environment = dict(os.environ, XDG_CACHE_HOME=str(folder / "cache"))
    process = subprocess.Popen(
        [gdibl, *arguments, "--progress", "none"], cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    try:
        _, said = process.communicate(timeout=after)
        if process.returncode not in (0, 5):
            faults.append(f"{arguments}: exit {process.returncode}: {said.decode()}")
        ended = True
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.communicate()
        ended = False
    kept = [path.stat().st_mtime for path in folder.glob("*.partial")]
    return ended, children_seconds() - before, time.time() - max([began, *kept])


def outputs(folder, pattern):
    """Output files, without journals and temporary ones."""
    found = {path.relative_to(folder): path for path in folder.glob(pattern) if path.is_file()}
    return {name: path for name, path in found.items() if not path.name.endswith((".partial", ".tmp"))}


def check(name, arguments, pattern, inputs, count, view=None):
    """Kills one verb so many times. `pattern` finds what it writes; `inputs` are files that it reads. `view` makes of an output what is
    compared: a shard has its blocks in the order in which they came."""

    def fresh(label):
        folder = root / f"{name}-{label}"
        folder.mkdir()
        for path in inputs:
            shutil.copy(path, folder / Path(path).name)
        return folder

    whole = fresh("whole")
    started = time.monotonic()
    _, cpu, _ = run(arguments, whole)
    wall = time.monotonic() - started
    expected = outputs(whole, pattern)
    if not expected:
        faults.append(f"{name}: wrote nothing that {pattern} finds")
        return

    def compare(folder, must_be_all):
        found = outputs(folder, pattern)
        for path, there in found.items():
            seen = view(there) if view else there
            if path not in expected or not filecmp.cmp(seen, view(expected[path]) if view else expected[path], shallow=False):
                faults.append(f"{name}: {there} is not what an undisturbed run writes")
        if must_be_all and found.keys() != expected.keys():
            faults.append(f"{name}: wrote {sorted(map(str, found))}, expected {sorted(map(str, expected))}")

    folder, done, ends, spent, longest, is_fresh = fresh("killed"), 0, 0, 0.0, 0.0, True
    while done < count:
        started = time.monotonic()
        ended, seconds, unkept = run(arguments, folder, random.uniform(0, 1.1 * wall))
        spent += seconds
        longest = longest if ended else max(longest, unkept)
        done += not ended
        ends += ended
        compare(folder, ended)
        if ended:
            # The machine may be less busy than it was at first: of a run that nothing went before it is known.
            wall = time.monotonic() - started if is_fresh else wall
            for path in outputs(folder, pattern).values():
                path.unlink()
            shutil.rmtree(folder / "cache", ignore_errors=True)
        is_fresh = ended
    ended, seconds, _ = run(arguments, folder)
    compare(folder, True)
    lost = (spent + seconds - (ends + 1) * cpu) / done
    print(
        f"{name:<9} {done:4} kills, {ends + 1:3} ends, undisturbed {wall:5.1f} s and {cpu:5.1f} s of CPU; {lost:5.2f} s of CPU lost per "
        f"kill, at most {longest:5.2f} s on the clock",
        flush=True,
    )
    if name in ("bake", "shard") and lost > 5:
        faults.append(f"{name}: {lost:.1f} s of CPU were lost per kill, 5 are allowed")


source = root / "source"
source.mkdir()
run(["bake", level, *BAKE, "-o", "all.gdibl"], source)
for index in (1, 2, 3):
    run(["bake", level, *BAKE, "--shard", f"{index}/3", "-o", f"{index}.shard"], source)
shards = [str(source / f"{index}.shard") for index in (1, 2, 3)]


def assembled(shard):
    """The volume that a shard gives with the others."""
    run(["assemble", shards[0], str(shard), shards[2], "-o", str(shard) + ".volume"], source)
    return str(shard) + ".volume"


verbs = [
    ("bake", ["bake", level, *BAKE, "-o", "out.gdibl"], "*.gdibl", [], 0.4),
    ("shard", ["bake", level, *BAKE, "--shard", "2/3", "-o", "out.shard"], "*.shard", [], 0.2),
    ("assemble", ["assemble", *shards, "-o", "{}/out.gdibl"], "out.gdibl", [], 0.1),
    ("capture", ["capture", level, "--auto", "--most", "3", "--width", "64", "--samples", "16", "-o", "out"], "out/*", [], 0.1),
    ("export", ["export", "all.gdibl", "--to", "json", "-o", "out.json"], "out.json", [source / "all.gdibl"], 0.1),
    ("cut", ["cut", "all.gdibl", "--tile", "1", "-o", "out"], "out/*", [source / "all.gdibl"], 0.1),
]
for name, arguments, pattern, inputs, share in verbs:
    if name == "assemble":
        # Its output is named from the folder in which it runs.
        arguments = [word.replace("{}/", "") for word in arguments]
    check(name, arguments, pattern, inputs, max(1, round(share * kills)), assembled if name == "shard" else None)
shutil.rmtree(root)
for fault in dict.fromkeys(faults):
    print("FAILED:", fault)
sys.exit(bool(faults))
