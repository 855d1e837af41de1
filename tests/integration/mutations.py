#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Mutated clouds against a running service: each gets a result or a refusal, and the service lives.

    mutations.py --count 5000 --seed 1 [SCAN...]           (a short form runs as test_mutations.py)
"""
import argparse
import concurrent.futures
import json
import pathlib
import random
import sys
import tempfile

from conftest import Daemon, sphere

FIXTURES = pathlib.Path(__file__).parent.parent / "fixtures"
LONGEST_SEED = 4 << 20
NUMBERS = [b"0", b"-1", b"4294967296", b"18446744073709551615", b"1e308", b"-1e400", b"nan", b"inf", b"0x7", b"2147483648"]
OUTPUTS = ["cloud", "mesh", "report", "xyz", "dso"]


def flip(chance, data):
    for _ in range(chance.choice([1, 2, 8, 64])):
        data[chance.randrange(len(data))] = chance.randrange(256)


def cut(chance, data):
    del data[chance.randrange(len(data)):]


def remove(chance, data):
    start = chance.randrange(len(data))
    del data[start:start + chance.choice([1, 3, 12, 100])]


def repeat(chance, data):
    start, length = chance.randrange(len(data)), chance.choice([1, 12, 100, 5000])
    data[start:start] = data[start:start + length] * chance.choice([1, 3])


def swap(chance, data):
    a, b, length = chance.randrange(len(data)), chance.randrange(len(data)), chance.choice([1, 4, 12, 200])
    data[a:a + length], data[b:b + length] = data[b:b + length], data[a:a + length]


def renumber(chance, data):
    """Another number in the place of one in the first lines, where headers have their counts."""
    digits = [i for i, byte in enumerate(data[:600]) if 48 <= byte <= 57]
    if digits:
        start = chance.choice(digits)
        end = start
        while end < len(data) and 48 <= data[end] <= 57:
            end += 1
        data[start:end] = chance.choice(NUMBERS)


MUTATIONS = [flip, cut, remove, repeat, swap, renumber]


def mutate(chance, seed):
    data = bytearray(seed)
    for _ in range(chance.randint(1, 4)):
        if data:
            chance.choice(MUTATIONS)(chance, data)
    return bytes(data)


def seeds(scans):
    """Every fixture, good or bad, a sphere, and the scans given."""
    found = [path.read_bytes() for path in sorted(FIXTURES.glob("*/*/input*"))]
    found += [pathlib.Path(scan).read_bytes()[:LONGEST_SEED] for scan in scans]
    found += [sphere(n) for n in (5, 60, 700)] * (len(found) // 10 + 1)
    return [seed for seed in found if seed]


def one(daemon, output, body):
    """The status of the answer; where that couldn't be waited for, of the job's end."""
    status, _, answer = daemon.request("POST", f"/v1/simplify?ratio=0.3&output={output}", body)
    problem = json.loads(answer) if status != 200 else None
    if status == 504:
        problem = daemon.ended(problem["job"])["problem"]
        status = problem["status"] if problem else 200
    assert status == 200 or 400 <= status < 500, (status, answer[:500], body[:300])
    assert status == 200 or (problem["status"] == status and problem["detail"])
    return status


def campaign(daemon, count, seed, scans=()):
    """Returns how many were taken."""
    chance = random.Random(seed)
    pool_of_seeds = seeds(scans)
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        work = [pool.submit(one, daemon, chance.choice(OUTPUTS), mutate(chance, chance.choice(pool_of_seeds)))
                for _ in range(count)]
        taken = sum(future.result() == 200 for future in work)
    assert daemon.process.poll() is None
    return taken


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("scans", nargs="*")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        daemon = Daemon(pathlib.Path(folder), "--workers", "2", "--job-memory", "1G").start()
        try:
            taken = campaign(daemon, arguments.count, arguments.seed, arguments.scans)
        finally:
            daemon.stop()
    print(f"{arguments.count} mutated clouds: {taken} taken, the others refused; the service lives")


if __name__ == "__main__":
    sys.exit(main())
