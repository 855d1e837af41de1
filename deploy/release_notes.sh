#!/bin/sh
# Prints what a release says of itself: the part of the list of changes that has the version as its heading, or where
# there is none the first one, which is of what comes with the next tag.
# Usage: release_notes.sh VERSION
# SPDX-License-Identifier: GPL-3.0-or-later
set -eu
cd "$(dirname "$0")/.."
[ $# = 1 ] || { echo "usage: release_notes.sh VERSION" >&2; exit 64; }
changes=.github/CHANGELOG.md
heading=$(grep -m1 -Fx -e "## $1" "$changes" || grep -m1 '^## ' "$changes")
awk -v heading="$heading" '/^## / { inside = $0 == heading; next } inside' "$changes"
