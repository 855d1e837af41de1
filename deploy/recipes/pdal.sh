#!/bin/sh
# PDAL before whittle: what PDAL's filters leave of a survey is simplified, without a file in between but one.
#
#     pdal.sh in.laz out.laz [--ratio 0.1 ...]
#
# SPDX-License-Identifier: GPL-3.0-or-later
set -eu
in=$1 out=$2
shift 2
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
pdal pipeline --stdin <<PIPELINE
["$in",
 {"type": "filters.smrf"},
 {"type": "filters.range", "limits": "Classification[2:2]"},
 {"type": "writers.las", "filename": "$folder/ground.las", "extra_dims": "all", "forward": "all"}]
PIPELINE
"${WHITTLE:-whittle}" "$folder/ground.las" --quiet "$@" -o "$out"
