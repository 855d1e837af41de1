#!/bin/sh
# Shows why tests of a program were skipped; fails where the reason matches no line of tests/unit/skips.txt, or is
# missing.  A test that skips prints "skipped: REASON" before.
# Usage: skipped.sh LOG
# SPDX-License-Identifier: GPL-3.0-or-later
set -eu
reasons=$(sed -n 's/^.*skipped: //p' "$1")
printf '%s\n' "${reasons:-no reason given}" | sort -u | sed "s|^|  skipped in $(basename "$1" .log): |"
# cmocka names each skipped test where it stands and once more at the end.
tests=$(grep '^\[  SKIPPED \]' "$1" | grep -v 'test(s)' | sort -u | wc -l)
[ "$(printf '%s' "$reasons" | grep -c '')" -ge "$tests" ] ||
    { echo "$(basename "$1" .log): a test is skipped without a reason" >&2; exit 1; }
allowed=$(dirname "$0")/skips.txt
if unexpected=$(printf '%s\n' "$reasons" | grep -vxf "$allowed"); then
    echo "$(basename "$1" .log): may not be skipped: $unexpected" >&2
    exit 1
fi
