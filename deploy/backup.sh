#!/bin/sh
# Backs up the data folder of whittled, which may be running: one tar file, readable by its owner alone.
#
# The database comes first, as one consistent state; every file that it names was complete before its row was, so the
# files copied after it hold all of them.  Those that are newer have no row, and the next start moves them to lost+found,
# which is itself not backed up.  A job that was running is queued again by then.
# Usage: backup.sh DATA_FOLDER BACKUP.tar
# SPDX-License-Identifier: GPL-3.0-or-later
set -eu
[ $# = 2 ] && [ -e "$1/whittled.db" ] || { echo "usage: backup.sh DATA_FOLDER BACKUP.tar" >&2; exit 2; }
umask 077
data=$(cd "$1" && pwd)
part=$2.part
work=$(mktemp -d)
trap 'rm -rf "$work" "$part"' EXIT

sqlite3 -batch "$data/whittled.db" ".timeout 10000" ".backup '$work/whittled.db'"
[ "$(sqlite3 -batch "$work/whittled.db" 'PRAGMA integrity_check')" = ok ] || {
    echo "backup: the database is damaged" >&2
    exit 1
}
# Status 1 of tar: a file grew or went away meanwhile, which a log and a deleted job do.
tar -cf "$part" -C "$work" whittled.db
tar -rf "$part" -C "$data" --warning=no-file-changed --warning=no-file-removed --anchored --exclude='./tmp/*' \
    --exclude='./whittled.db*' --exclude='./lost+found*' --exclude=./lock --ignore-failed-read . || [ $? = 1 ]
sync "$part"
mv "$part" "$2"
