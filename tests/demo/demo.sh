#!/bin/bash
# The main job against a daemon of its own: upload, progress, results, table.
# Usage: demo.sh BUILD_FOLDER OUT_FOLDER [CLOUD [RATIO]]
# SPDX-License-Identifier: GPL-3.0-or-later
set -euo pipefail

build=$1 out=$2 cloud=${3:-} ratio=${4:-0.1} front=()
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
    cloud=$work/armadillo.xyz front=(--url-query preview_azimuth=200) # its file has its back where a front usually is
fi
[ -r "$cloud" ] || { echo "demo: can't read $cloud" >&2; exit 1; }

"$build/whittled" --listen 127.0.0.1:0 --data "$work/data" >"$work/listening" 2>"$work/log" &
daemon=$!
until url=$(grep -osm1 'http://127.0.0.1:[0-9]*' "$work/listening"); do
    kill -0 "$daemon" 2>/dev/null || { cat "$work/log" >&2; exit 1; }
    sleep 0.05
done

echo "whittled is at $url"
echo "POST $url/v1/jobs?ratio=$ratio&outputs=cloud,mesh,preview.png,report${front[1]:+&${front[1]}}  <  $(basename "$cloud")"
# The query is encoded by curl, whatever the ratio is.
reply=$(curl -s --show-error --fail-with-body -X POST -T "$cloud" --url-query "ratio=$ratio" \
    --url-query outputs=cloud,mesh,preview.png,report "${front[@]}" "$url/v1/jobs" 2>"$work/curl") || {
    jq -er '"demo: the job was refused: " + .title + ": " + .detail' <<<"$reply" >&2 2>/dev/null || cat "$work/curl" >&2
    exit 1
}
job=$(jq -r '.links[] | select(.rel=="self").href' <<<"$reply")

while :; do
    doc=$(curl -sS -H 'Prefer: wait=1' "$url$job")
    status=$(jq -r .status <<<"$doc")
    printf '\r%-10s %-12s %3s %%  ' "$status" "$(jq -r '.stage // ""' <<<"$doc")" "$(jq -r '.progress // 0' <<<"$doc")"
    case $status in successful | failed | dismissed) break ;; esac
    sleep 0.1
done
echo
[ "$status" = successful ] || { jq -r '"demo: the job \(.status): " + (.problem.detail // "no reason given")' <<<"$doc" >&2; exit 1; }

mkdir -p "$out"
for name in cloud.ply mesh.ply preview.png report.json; do
    curl -sS --fail-with-body -o "$out/$name" "$url$job/outputs/$name"
done

jq -r '
  def sci(value): if value == null then "-" else (value * 1e4 * 1000 | round / 1000 | tostring) + "e-4" end;
  def num(value): if value == 0 then "0" else pow(10; 3 - (value | log10 | floor)) as $p | value * $p | round / $p | tostring end;
  def row(name; value): "  " + (name + " " * 34)[:34] + (value | tostring);
  row("points in"; .points_in), row("points out"; .points_out),
  row("mesh vertices"; .mesh.vertices), row("triangles"; .mesh.triangles), row("watertight"; .mesh.watertight),
  (.error | to_entries[] | select(.key | IN("input_to_mesh", "mesh_to_input", "symmetric")) | .key as $way | .value |
    row($way + ", mean"; num(.mean) + ", / diagonal " + sci(.mean_rel)),
    row($way + ", RMS"; num(.rms) + ", / diagonal " + sci(.rms_rel)),
    row($way + ", maximum"; num(.max) + ", / diagonal " + sci(.max_rel))),
  (.warnings[] | row("warning"; .)),
  (.timings_ms | to_entries[] | row("time, " + .key; (.value * 10 | round / 10 | tostring) + " ms"))
' "$out/report.json"
ls -l "$out"/cloud.ply "$out"/mesh.ply "$out"/preview.png "$out"/report.json
