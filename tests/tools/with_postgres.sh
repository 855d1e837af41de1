#!/bin/sh
# Runs a command with a PostgreSQL server of its own, in a folder of its own, on a socket there and on no address:
# WHITTLE_CATALOG is its URL.  Without the server's programs the command runs without it, and says what it skips.
# POSTGRES_OPTIONS are more of its settings, such as -c max_connections=500.
# Usage: with_postgres.sh COMMAND ...
# SPDX-License-Identifier: GPL-3.0-or-later
set -eu
programs=${POSTGRES_BIN:-/usr/lib/postgresql/15/bin}
[ -x "$programs/initdb" ] || exec "$@"
folder=$(mktemp -d "${TMPDIR:-/tmp}/postgres.XXXXXX")
# The server doesn't run as root: root becomes the package's account for it.
as=
[ "$(id -u)" != 0 ] || { as="setpriv --reuid postgres --regid postgres --clear-groups"; chown postgres "$folder"; }
chmod 0755 "$folder"
(cd "$folder" && $as "$programs/initdb" -D data -U whittle -A trust --no-sync > initdb.log 2>&1) ||
    { cat "$folder/initdb.log" >&2; rm -rf "$folder"; exit 1; }
cd "$folder"
# What is lost with the machine is a test's: it doesn't wait for the disk, unless asked to.
$as "$programs/postgres" -D data -k "$folder" -c listen_addresses= -c "fsync=${POSTGRES_FSYNC:-off}" \
    -c max_connections=200 ${POSTGRES_OPTIONS:-} > server.log 2>&1 &
server=$!
cd "$OLDPWD"
finish() {
    kill -INT "$server" 2> /dev/null || true
    wait "$server" 2> /dev/null || true
    rm -rf "$folder"
}
trap finish EXIT
trap 'exit 1' INT TERM
until "$programs/pg_isready" -q -h "$folder"; do
    kill -0 "$server" 2> /dev/null || { cat "$folder/server.log" >&2; exit 1; }
    sleep 0.05
done
export WHITTLE_CATALOG="postgresql://whittle@/postgres?host=$folder"
"$@"
