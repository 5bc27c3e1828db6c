#!/usr/bin/env bash
# Bakes one volume in shards by Slurm: what shards share, an array of shards, and their assembly, which depends on all of them.
# Run it again after a failure: shards that are whole are not baked again.
#
#   tools/farm/slurm.sh LEVEL OUTPUT SHARDS WORK [arguments of gdibl bake]
#
# WORK is a folder that all machines reach. GDIBL names the program, SBATCH_ARGUMENTS what else sbatch is to be told (a partition,
# processors, memory). Prints the number of the job that assembles; --wait waits for it: SBATCH_WAIT=1.
set -euo pipefail
[ $# -ge 4 ] || { sed -n '2,9p' "$0" >&2; exit 2; }
level=$(realpath "$1"); output=$(realpath -m "$2"); shards=$3; work=$(realpath -m "$4"); shift 4
gdibl=$(command -v "${GDIBL:-gdibl}")
read -ra more <<<"${SBATCH_ARGUMENTS:-}"
mkdir -p "$work"
bake=$(printf '%q ' "$gdibl" bake "$level" "$@" --cache "$work/cache")
files=""
for ((i = 1; i <= shards; i++)); do files+="$(printf '%q ' "$work/$i.shard")"; done

# A job whose shards failed can never run: it is to end, and not to wait for ever.
submit() { sbatch --parsable --kill-on-invalid-dep=yes --output "$work/%x-%A_%a.log" "${more[@]}" "$@"; }
prepare=$(submit --job-name gdibl-prepare --wrap "exec $bake --prepare")
array=$(submit --job-name gdibl-shard --array "1-$shards" --dependency "afterok:$prepare" \
  --wrap "exec $bake --shard \$SLURM_ARRAY_TASK_ID/$shards -o $(printf '%q' "$work")/\$SLURM_ARRAY_TASK_ID.shard")
submit --job-name gdibl-assemble --dependency "afterok:$array" ${SBATCH_WAIT:+--wait} \
  --wrap "exec $(printf '%q' "$gdibl") assemble $files -o $(printf '%q' "$output")"
