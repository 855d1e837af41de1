#!/bin/sh
# Prints the version, or with --epoch the time (seconds since 1970) that everything made from this tree is dated by.
#
#   tag v1.2.3               1.2.3
#   5 commits later          1.2.3+5.gabc1234
#   no tag yet               0.0.0+87.gabc1234    (87 commits)
#   with local changes       ... .dirty
#
# A tree without git has both in the file .version, which `make dist` writes.  All are valid for Debian too.
# Usage: version.sh [--epoch]
# SPDX-License-Identifier: GPL-3.0-or-later
set -eu
cd "$(dirname "$0")/.."

described() {
    if name=$(git describe --tags --match 'v[0-9]*' --abbrev=7 2>/dev/null); then
        echo "$name" | sed -E 's/^v//; s/-([0-9]+)-g/+\1.g/'
    else
        echo "0.0.0+$(git rev-list --count HEAD).g$(git rev-parse --short=7 HEAD)"
    fi
}

if [ -e .version ]; then
    read -r version epoch <.version
elif [ -e .git ] && epoch=$(git log -1 --format=%ct 2>/dev/null); then
    version=$(described)
    [ -z "$(git status --porcelain --untracked-files=no)" ] || version=$version.dirty
else
    version=0.0.0+unknown epoch=0
fi
if [ "${1:-}" = --epoch ]; then echo "${SOURCE_DATE_EPOCH:-$epoch}"; else echo "$version"; fi
