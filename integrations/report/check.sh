#!/usr/bin/env bash
# The report page in a headless Chromium: builds the bundle anew and compares it, then runs check.mjs.
# Says SKIPPED, and exits with 0, where Node, Chromium or the npm packages cannot be had.
# usage: integrations/report/check.sh     (after cargo build --release; GDIBL_INPUTS: see check.mjs)
set -euo pipefail
cd "$(dirname "$0")"
skip() { echo "SKIPPED  the report page: $1"; exit 0; }

command -v node > /dev/null && command -v npm > /dev/null || skip "no Node (node, npm)"
browser=${CHROMIUM:-/usr/bin/chromium}
if [ ! -x "$browser" ] && command -v apt-get > /dev/null && [ "$(id -u)" = 0 ]; then
  { apt-get update && apt-get install -y chromium; } > /dev/null 2>&1 || true
fi
[ -x "$browser" ] || skip "no Chromium ($browser)"
npm ci --no-audit --no-fund > /dev/null 2>&1 || skip "npm packages cannot be had"
if rustc --print target-libdir --target wasm32-unknown-unknown 2> /dev/null | xargs -r test -d; then
  node build.mjs --check
else
  echo "SKIPPED  the WebAssembly module of the bundle: no target wasm32-unknown-unknown"
  node build.mjs --check --keep-module
fi
CHROMIUM=$browser node check.mjs
CHROMIUM=$browser node study.mjs
