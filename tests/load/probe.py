# SPDX-License-Identifier: GPL-3.0-or-later
"""Asks for /healthz again and again, each time over a connection of its own, until its standard input ends.

Usage: probe.py PORT      prints the times in milliseconds, one a line.  A process of its own, so that the clients of the
load don't slow it down.
"""
import select
import socket
import sys
import time


def ask(port):
    start = time.monotonic()
    with socket.create_connection(("127.0.0.1", port), timeout=60) as connection:
        connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        if not connection.recv(12).startswith(b"HTTP/1.1 200"):
            raise RuntimeError("not healthy")
    return (time.monotonic() - start) * 1e3


def main():
    times = []
    while not select.select([sys.stdin], [], [], 0.02)[0]:
        times.append(ask(int(sys.argv[1])))
    print("\n".join(f"{ms:.3f}" for ms in times))


main()
