#!/bin/sh
# Puts a backup of backup.sh back: into an empty database, and in the bucket what was removed since.  No host may run.
# Then every row and every byte are compared.  What is newer than the backup stays in the bucket, as blobs of nothing.
# Usage: restore.sh BACKUP.dump CATALOG_URL BLOBS_URL
# SPDX-License-Identifier: GPL-3.0-or-later
set -eu
[ $# = 3 ] && [ -r "$1" ] || { echo "usage: restore.sh BACKUP.dump CATALOG_URL BLOBS_URL" >&2; exit 2; }
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
pg_restore --exit-on-error --single-transaction --no-owner --no-privileges --dbname="$2" "$1"
psql -XAtq --dbname="$2" -v ON_ERROR_STOP=1 > "$work/names" -c "
    SELECT 'clouds/' || sha256 FROM clouds UNION SELECT 'clouds/' || cloud FROM jobs
    UNION SELECT 'jobs/' || id || '/' FROM jobs"
python3 "$(dirname "$0")/bucket.py" undelete "$3" < "$work/names"
"${WHITTLED:-whittled}" check --data "$work/scratch" --catalog "$2" --blobs "$3"
