#!/bin/sh
# Backs up what hosts of whittled share, which may be running: the database, as one consistent state.  The bytes that its
# rows name are complete by then, and stay in the bucket, whose versioning keeps what is removed later (bucket.py keep).
# Usage: backup.sh CATALOG_URL BACKUP.dump            the URL is that of whittled's setting `catalog`
# SPDX-License-Identifier: GPL-3.0-or-later
set -eu
[ $# = 2 ] || { echo "usage: backup.sh CATALOG_URL BACKUP.dump" >&2; exit 2; }
umask 077
trap 'rm -f "$2.part"' EXIT
pg_dump --format=custom --no-owner --no-privileges --file="$2.part" --dbname="$1"
sync "$2.part"
mv "$2.part" "$2"
