#!/usr/bin/env bash
# The farm and kill tests: shards by hand, by Open Job Description and by Slurm give the bytes of one bake; a failed shard ends clearly
# and is repaired; kills leave no half file; a full or read-only disk is said. SKIPPED lines tell what this machine lacks.
#
#   tools/farm/check.sh [GDIBL]        LEVELS="assets/uffizi-box/uffizi-box.bake.toml …" KILLS=200 SHARDS=8 SAMPLES=1024 NODES=1000000
set -uo pipefail
here=$(cd "$(dirname "$0")" && pwd); root=$(dirname "$(dirname "$here")")
gdibl=$(realpath "${1:-$root/target/release/gdibl}")
levels=${LEVELS:-$root/assets/uffizi-box/uffizi-box.bake.toml}
shards=${SHARDS:-8} samples=${SAMPLES:-1024}
work=$(mktemp -d); failed=0; slurm=""
export XDG_CACHE_HOME=$work/cache
trap '[ -z "$slurm" ] || "$here/slurm_local.sh" stop "$work/slurm"; umount "$work/full" 2>/dev/null; rm -rf "$work"' EXIT
fail() { echo "FAILED: $*"; failed=1; }
skip() { echo "SKIPPED: $*"; }
same() { if cmp -s "$1" "$2"; then echo "ok: $3"; else fail "$3: other bytes than one bake, or none"; fi; }
# CPU seconds of a command.
cpu() {
  local TIMEFORMAT='%U %S' code=0
  { time "$@" >"$work/out" 2>"$work/err" || code=$?; } 2>"$work/time"
  # It runs in a subshell.
  [ $code -eq 0 ] || { cat "$work/err" >&2; echo "FAILED: exit $code: $*" >&2; touch "$work/failed"; }
  awk '{ print $1 + $2 }' "$work/time"
}

number=0
for level in $levels; do
  number=$((number + 1)); name=$(basename "$(dirname "$level")")/$(basename "$level")
  arguments=(--samples "$samples" --quiet)
  one=$work/one$number.gdibl
  seconds=$(cpu "$gdibl" bake "$level" "${arguments[@]}" -o "$one")

  # By hand, each with other threads; what it costs.
  for count in 1 3 "$shards"; do
    list=(); total=0; shared=$(cpu "$gdibl" bake "$level" "${arguments[@]}" --cache "$work/c$number" --prepare)
    for i in $(seq "$count" -1 1); do
      list+=("$work/$count-$i.shard")
      threads=$((i % 3 == 0 ? 7 : i % 3))
      more=$(cpu "$gdibl" bake "$level" "${arguments[@]}" --cache "$work/c$number" --threads $threads --shard "$i/$count" -o "$work/$count-$i.shard")
      total=$(awk "BEGIN { print $total + $more }")
    done
    more=$(cpu "$gdibl" assemble "${list[@]}" -o "$work/all.gdibl" --quiet)
    same "$one" "$work/all.gdibl" "$name in $count shards by hand"
    awk "BEGIN { printf \"    %d shards: CPU of one bake %.1f s, of what they share %.1f s, of shards %.1f s, of the assembly %.1f s\n\", $count, $seconds, $shared, $total, $more }"
  done

  # One fails: it is named, and a rerun bakes it alone.
  victim=$work/$shards-2.shard
  truncate -s -100 "$victim"
  said=$("$gdibl" assemble "${list[@]}" -o "$work/never.gdibl" --quiet 2>&1); code=$?
  if [ $code -eq 3 ] && [[ $said == *"$victim"* ]] && [ ! -e "$work/never.gdibl" ]; then echo "ok: $name: a damaged shard is named"; else fail "$name: a damaged shard: exit $code: $said"; fi
  again=0
  for i in $(seq "$shards"); do
    "$gdibl" bake "$level" "${arguments[@]}" --cache "$work/c$number" --shard "$i/$shards" -o "$work/$shards-$i.shard" | grep -q unchanged || again=$((again + 1))
  done
  [ $again -eq 1 ] && echo "ok: $name: a rerun repairs it alone" || fail "$name: a rerun baked $again shards"

  # Other processors.
  if command -v qemu-x86_64 >/dev/null; then
    for processor in Nehalem Haswell; do
      few=(--counts 3,3,4 --samples 64 --seen-places 8 --quiet --force)
      "$gdibl" bake "$level" "${few[@]}" -o "$work/here.gdibl" >/dev/null 2>&1
      qemu-x86_64 -cpu $processor "$gdibl" bake "$level" "${few[@]}" --shard 1/2 -o "$work/q1.shard" >/dev/null 2>&1
      "$gdibl" bake "$level" "${few[@]}" --shard 2/2 -o "$work/q2.shard" >/dev/null 2>&1
      qemu-x86_64 -cpu $processor "$gdibl" assemble "$work/q1.shard" "$work/q2.shard" -o "$work/there.gdibl" --quiet >/dev/null 2>&1
      same "$work/here.gdibl" "$work/there.gdibl" "$name: one shard and the assembly on a $processor"
    done
  else
    skip "no qemu-x86_64: other processors were not tried (Debian: qemu-user)"
  fi

  if command -v openjd >/dev/null; then
    if openjd run "$here/gdibl.openjd.yaml" --step Assemble --run-dependencies -p Level="$(realpath "$level")" -p Output="$work/openjd$number.gdibl" \
      -p Work="$work/openjd$number" -p Shards="$shards" -p Arguments="${arguments[*]}" -p Gdibl="$gdibl" >"$work/openjd.log" 2>&1; then
      same "$one" "$work/openjd$number.gdibl" "$name in $shards shards by Open Job Description"
    else
      tail -20 "$work/openjd.log"; fail "$name by Open Job Description"
    fi
    # A shard that cannot be written fails the job.
    mkdir -p "$work/openjd-bad/2.shard"
    if openjd run "$here/gdibl.openjd.yaml" --step Assemble --run-dependencies -p Level="$(realpath "$level")" -p Output="$work/openjd-bad.gdibl" \
      -p Work="$work/openjd-bad" -p Shards=2 -p Arguments="--counts 2,2,2 ${arguments[*]}" -p Gdibl="$gdibl" >"$work/openjd.log" 2>&1 || [ -e "$work/openjd-bad.gdibl" ]; then
      fail "$name: Open Job Description went on after a failed shard"
    else
      echo "ok: $name: a failed shard ends the job of Open Job Description"
    fi
  else
    skip "no openjd: the template of Open Job Description was not run (PyPI: openjd-cli)"
  fi

  if command -v slurmctld >/dev/null && command -v slurmd >/dev/null && command -v munged >/dev/null && [ "$(id -u)" -eq 0 ]; then
    if [ -z "$slurm" ]; then
      slurm=started
      eval "$("$here/slurm_local.sh" start "$work/slurm" 2>"$work/slurm.log")" || { cat "$work/slurm.log"; fail "Slurm does not start"; }
    fi
    if SBATCH_WAIT=1 GDIBL=$gdibl "$here/slurm.sh" "$level" "$work/slurm$number.gdibl" "$shards" "$work/slurm$number" "${arguments[@]}" >"$work/slurm.log" 2>&1; then
      same "$one" "$work/slurm$number.gdibl" "$name in $shards shards by Slurm, $(sinfo -h -o %D) nodes"
    else
      cat "$work/slurm.log" "$work/slurm$number"/*.log | tail -20; fail "$name by Slurm"
    fi
    mkdir -p "$work/slurm-bad/2.shard"
    if SBATCH_WAIT=1 GDIBL=$gdibl timeout 300 "$here/slurm.sh" "$level" "$work/slurm-bad.gdibl" 2 "$work/slurm-bad" --counts 2,2,2 "${arguments[@]}" >"$work/slurm.log" 2>&1 || [ -e "$work/slurm-bad.gdibl" ]; then
      fail "$name: Slurm went on after a failed shard"
    else
      echo "ok: $name: a failed shard ends the jobs of Slurm"
      rmdir "$work/slurm-bad/2.shard"
      SBATCH_WAIT=1 GDIBL=$gdibl timeout 300 "$here/slurm.sh" "$level" "$work/slurm-bad.gdibl" 2 "$work/slurm-bad" --counts 2,2,2 "${arguments[@]}" >"$work/slurm.log" 2>&1
      [ -s "$work/slurm-bad.gdibl" ] && [ "$(cat "$work"/slurm-bad/*.log | grep -c unchanged)" -eq 1 ] && echo "ok: $name: a rerun by Slurm repairs it alone" \
        || fail "$name: a rerun by Slurm"
    fi
  else
    skip "no Slurm, or not root: its jobs were not run (Debian: slurmctld slurmd slurm-client munge)"
  fi
done

level=${levels%% *}
few=(--counts 4,4,6 --samples 256 --seen-places 8 --quiet)
"$gdibl" bake "$level" "${few[@]}" -o "$work/few.gdibl" >/dev/null 2>&1
# Four bakes on one cache at once, which capture the same probes.
glb=$(dirname "$level")/uffizi-box.glb
if [ -e "$glb" ]; then
  captured=(bake "$glb" --distant 1,1,1 --method gdibl "${few[@]}")
  for i in 1 2 3 4; do "$gdibl" "${captured[@]}" --cache "$work/four" -o "$work/four$i.gdibl" >/dev/null 2>"$work/four$i.err" & done; wait
  "$gdibl" "${captured[@]}" --cache "$work/alone" -o "$work/alone.gdibl" >/dev/null 2>&1
  for i in 1 2 3 4; do same "$work/alone.gdibl" "$work/four$i.gdibl" "bake $i of four on one cache"; done
  [ "$(cat "$work"/four?.err | grep -c 'captured .* probes')" -eq 1 ] && echo "ok: one of four captured" || fail "of four bakes on one cache not one captured: $(cat "$work"/four?.err)"
fi
# A disk that is full, at several moments; and one that cannot be written.
mkdir "$work/full"
if mount -t tmpfs -o size=256k none "$work/full" 2>/dev/null; then
  for fill in 250 200 150 100 50 0; do
    head -c ${fill}k /dev/zero >"$work/full/ballast"
    said=$("$gdibl" bake "$level" "${few[@]}" -o "$work/full/out.gdibl" 2>&1 >/dev/null); code=$?
    if [ $code -eq 0 ]; then cmp -s "$work/few.gdibl" "$work/full/out.gdibl" && echo "ok: disk with $((256 - fill)) KB free: whole" || fail "a full disk: other bytes"
    elif [ $code -eq 1 ] && [ ! -e "$work/full/out.gdibl" ] && [[ $said == *"out.gdibl"* ]]; then echo "ok: disk with $((256 - fill)) KB free: exit 1, ${said##*: }"
    else fail "a full disk: exit $code: $said"; fi
    rm -f "$work/full/"*
  done
  mount -o remount,ro "$work/full"
  said=$("$gdibl" bake "$level" "${few[@]}" -o "$work/full/out.gdibl" 2>&1 >/dev/null); code=$?
  [ $code -eq 1 ] && [[ $said == *"out.gdibl"* ]] && echo "ok: read-only disk: exit 1, ${said##*: }" || fail "a read-only disk: exit $code: $said"
  umount "$work/full"
else
  skip "no mount: full and read-only disks were not tried (needs root)"
fi

# Many nodes: their shards are put together in little memory, 1 GB for 10 million.
if command -v python3 >/dev/null; then
  side=$(awk "BEGIN { print int(${NODES:-1000000} ^ (1 / 3) + 0.999) }")
  many=("$root/assets/uffizi-box/empty-box.glb" --distant 1,1,1 --counts "$side,$side,$side" --samples 2 --quiet --cache "$work/many-cache")
  for i in 1 2; do "$gdibl" bake "${many[@]}" --shard $i/2 -o "$work/many$i.shard" >/dev/null || fail "many nodes: shard $i"; done
  most=$((200 + side * side * side / 12500))
  found=$(python3 -c 'import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss // 1024)' "$gdibl" assemble "$work"/many[12].shard -o "$work/many.gdibl" --quiet)
  if [ "${found:-999999}" -le $most ]; then echo "ok: $((side * side * side)) nodes are put together in $found MB, $most are allowed"
  else fail "$((side * side * side)) nodes are put together in ${found:-no} MB, $most are allowed"; fi
  rm -rf "$work"/many*
else
  skip "no python3: the memory of an assembly was not measured"
fi

if command -v python3 >/dev/null; then
  python3 "$here/kills.py" "$gdibl" "$level" "${KILLS:-200}" || failed=1
else
  skip "no python3: nothing was killed"
fi
[ ! -e "$work/failed" ] || failed=1
exit $failed
