#!/bin/bash
# Runs a command with an S3 store of its own, Ceph's, on one machine: a monitor, a manager, one object store in memory
# and the gateway, in a folder of their own, on free ports of loopback.  WHITTLE_BLOBS is the URL of a bucket; the keys are in
# AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY.  Without Ceph's programs the command runs without a store.
# Usage: with_s3.sh COMMAND ...
# SPDX-License-Identifier: GPL-3.0-or-later
set -eu
for program in ceph-mon ceph-mgr ceph-osd radosgw radosgw-admin ceph-authtool monmaptool; do
    command -v "$program" > /dev/null || exec "$@"
done
folder=$(mktemp -d "${TMPDIR:-/tmp}/ceph.XXXXXX")
pids=()
finish() {
    [ ${#pids[@]} = 0 ] || kill -KILL "${pids[@]}" 2> /dev/null || true
    wait 2> /dev/null || true
    rm -rf "$folder"
}
trap finish EXIT
trap 'exit 1' INT TERM
read -r mon2 mon1 http < <(python3 -c '
import socket
sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(3)]
print(*(s.getsockname()[1] for s in sockets))')
address="[v2:127.0.0.1:$mon2/0,v1:127.0.0.1:$mon1/0]"
fsid=$(cat /proc/sys/kernel/random/uuid)
export CEPH_CONF=$folder/ceph.conf
cat > "$CEPH_CONF" << EOF
[global]
fsid = $fsid
mon host = $address
mon initial members = a
auth cluster required = cephx
auth service required = cephx
auth client required = cephx
keyring = $folder/keyring
run dir = $folder
admin socket = $folder/\$name.asok
log file = $folder/\$name.log
mon cluster log file = $folder/cluster.log
pid file = $folder/\$name.pid
mon data = $folder/mon
mgr data = $folder/mgr
osd data = $folder/osd
osd objectstore = memstore
memstore device bytes = 2147483648
osd pool default size = 1
osd pool default min size = 1
osd pool default pg num = 8
osd pool default pgp num = 8
osd crush chooseleaf type = 0
mon allow pool size one = true
mon max pg per osd = 500
mon warn on pool no redundancy = false
public addr = 127.0.0.1
cluster addr = 127.0.0.1
rgw frontends = beast endpoint=127.0.0.1:$http tcp_nodelay=1
rgw dns name = localhost
rgw data = $folder/rgw
debug ms = 0
EOF
mkdir -p "$folder"/{mon,mgr,osd,rgw}
{
    ceph-authtool --create-keyring "$folder/keyring" --gen-key -n mon. --cap mon 'allow *'
    ceph-authtool "$folder/keyring" --gen-key -n client.admin --cap mon 'allow *' --cap osd 'allow *' --cap mgr 'allow *'
    ceph-authtool "$folder/keyring" --gen-key -n mgr.x --cap mon 'allow *' --cap osd 'allow *' --cap mds 'allow *'
    ceph-authtool "$folder/keyring" --gen-key -n osd.0 --cap mon 'allow profile osd' --cap osd 'allow *' --cap mgr 'allow profile osd'
    ceph-authtool "$folder/keyring" --gen-key -n client.rgw --cap mon 'allow *' --cap osd 'allow *' --cap mgr 'allow *'
    monmaptool --create --fsid "$fsid" --addv a "$address" "$folder/monmap"
    ceph-mon --mkfs -i a --monmap "$folder/monmap" --keyring "$folder/keyring"
    cp "$folder/keyring" "$folder/mon/keyring"
} > "$folder/setup.log" 2>&1 || { cat "$folder/setup.log" >&2; exit 1; }
start() {
    "$@" > "$folder/$1.out" 2>&1 &
    pids+=($!)
}
start ceph-mon -f -i a
start ceph-mgr -f -i x
osd=$(cat /proc/sys/kernel/random/uuid)
timeout 60 ceph --connect-timeout 30 osd new "$osd" 0 >> "$folder/setup.log" 2>&1 || { cat "$folder"/setup.log >&2; exit 1; }
ceph-osd --mkfs -i 0 --osd-uuid "$osd" --monmap "$folder/monmap" --keyring "$folder/keyring" >> "$folder/setup.log" 2>&1 ||
    { cat "$folder/setup.log" >&2; exit 1; }
cp "$folder/keyring" "$folder/osd/keyring"
start ceph-osd -f -i 0
start radosgw -f -n client.rgw
export AWS_ACCESS_KEY_ID=whittle AWS_SECRET_ACCESS_KEY=a-key-for-tests-alone
timeout 90 radosgw-admin -n client.rgw user create --uid whittle --display-name whittle --access-key "$AWS_ACCESS_KEY_ID" \
    --secret "$AWS_SECRET_ACCESS_KEY" >> "$folder/setup.log" 2>&1 || { tail -20 "$folder/setup.log" >&2; exit 1; }
# The first bucket makes the store's pools, which takes seconds.
for _ in $(seq 120); do
    code=$(curl -s -o /dev/null -w '%{http_code}' --aws-sigv4 aws:amz:us-east-1:s3 -X PUT \
        --user "$AWS_ACCESS_KEY_ID:$AWS_SECRET_ACCESS_KEY" -H 'x-amz-content-sha256: UNSIGNED-PAYLOAD' \
        "http://127.0.0.1:$http/whittle" || true)
    [ "$code" != 200 ] || break
    sleep 0.5
done
[ "$code" = 200 ] || { echo "the store doesn't take a bucket: $code" >&2; tail -5 "$folder"/*.out >&2; exit 1; }
export WHITTLE_BLOBS="s3://whittle/tests?endpoint=http://127.0.0.1:$http"
"$@"
