#!/bin/bash
# The main job against a daemon of its own: upload, progress, results, table.
# Usage: demo.sh BUILD_FOLDER OUT_FOLDER [CLOUD [RATIO]]
# SPDX-License-Identifier: GPL-3.0-or-later
set -euo pipefail

build=$1 out=$2 cloud=${3:-} ratio=${4:-0.1}
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
daemon=
finish() {
    if [ -n "$daemon" ]; then
        kill -TERM "$daemon" 2>/dev/null || true
        wait "$daemon" 2>/dev/null || true
    fi
    rm -rf "$work"
}
trap finish EXIT

if [ -z "$cloud" ]; then
    "$here/scan.sh" armadillo "$work/armadillo.xyz"
    cloud=$work/armadillo.xyz
fi
[ -r "$cloud" ] || { echo "demo: can't read $cloud" >&2; exit 1; }

"$build/whittled" --listen 127.0.0.1:0 --data "$work/data" >"$work/listening" 2>"$work/log" &
daemon=$!
until url=$(grep -osm1 'http://127.0.0.1:[0-9]*' "$work/listening"); do
    kill -0 "$daemon" 2>/dev/null || { cat "$work/log" >&2; exit 1; }
    sleep 0.05
done

echo "whittled is at $url"
echo "POST $url/v1/jobs?ratio=$ratio&outputs=cloud,mesh,report  <  $(basename "$cloud")"
job=$(curl -sS --fail-with-body -X POST -T "$cloud" "$url/v1/jobs?ratio=$ratio&outputs=cloud,mesh,report" | jq -r '.links[] | select(.rel=="self").href') ||
    { echo "demo: the job was refused" >&2; exit 1; }

while :; do
    doc=$(curl -sS -H 'Prefer: wait=1' "$url$job")
    status=$(jq -r .status <<<"$doc")
    printf '\r%-10s %-12s %3s %%  ' "$status" "$(jq -r '.stage // ""' <<<"$doc")" "$(jq -r '.progress // 0' <<<"$doc")"
    case $status in successful | failed | dismissed) break ;; esac
    sleep 0.1
done
echo
[ "$status" = successful ] || { jq .problem <<<"$doc" >&2; exit 1; }

mkdir -p "$out"
for name in cloud.ply mesh.ply report.json; do
    curl -sS --fail-with-body -o "$out/$name" "$url$job/outputs/$name"
done

jq -r '
  def sci: if . == null then "-" else (. * 1e4 * 1000 | round / 1000 | tostring) + "e-4" end;
  def row(name; value): "  " + (name + " " * 34)[:34] + (value | tostring);
  row("points in"; .points_in), row("points out"; .points_out),
  row("mesh vertices"; .mesh.vertices), row("triangles"; .mesh.triangles), row("watertight"; .mesh.watertight),
  (.error | row("error, mean / diagonal"; .mean_rel | sci), row("error, RMS / diagonal"; .rms_rel | sci),
            row("error, maximum / diagonal"; .max_rel | sci)),
  (.timings_ms | to_entries[] | row("time, " + .key; (.value * 10 | round / 10 | tostring) + " ms"))
' "$out/report.json"
ls -l "$out"/cloud.ply "$out"/mesh.ply "$out"/report.json
