#!/usr/bin/env bash
# Bakes (levels) or reads (images) every file under a folder and prints one Markdown row for each: exit code and what was said.
# usage: tools/verdicts.sh FOLDER SKY_IMAGE [GDIBL]
set -u
folder=$1 sky=$2 gdibl=${3:-target/release/gdibl}
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
echo "| file | exit | verdict |"
echo "|---|---|---|"
find "$folder" -type f \( -name '*.glb' -o -name '*.gltf' -o -name '*.hdr' -o -name '*.exr' -o -path '*exr/damaged/*' \) | sort | while read -r file; do
  case "$file" in
    *.glb | *.gltf) arguments=("$file" --distant "$sky" --bounds=-1,-1,-1,1,1,1 --counts 3,3,3) ;;
    *) arguments=("$out/empty.gltf" --distant "$file" --bounds 0,0,0,1,1,1 --counts 1,1,1)
       echo '{"asset":{"version":"2.0"}}' > "$out/empty.gltf" ;;
  esac
  text=$(timeout 120 "$gdibl" bake "${arguments[@]}" --force --samples 256 --json --quiet -o "$out/x.gdibl" 2> "$out/stderr")
  code=$?
  if [ $code = 0 ]; then
    verdict=$(echo "$text" | python3 -c 'import json,sys; r=json.load(sys.stdin); p={x["stage"]:x for x in r["plan"]}; e=p["bounces"]; print((e["why"].split(" ")[0] if e["kept"] else "0")+" triangles reflect; "+", ".join(f["id"]+" "+str(f["count"]) for f in r["findings"]))')
  else
    verdict=$(tail -n 1 "$out/stderr" | sed "s|$folder/||g; s|$out/||g" | cut -c1-200)
  fi
  echo "| ${file#"$folder"/} | $code | $verdict |"
done
