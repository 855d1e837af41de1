#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the catalog of several hosts costs PostgreSQL.

Usage: with_postgres.sh catalog.py BUILD_FOLDER [--waiting 10000] [--jobs 100] [--hosts 100] [--seconds 20]

The time of a statement is without that of its COMMIT, which is the disk's.  First part: --waiting jobs of 40 principals wait, one real host runs --jobs of them.  Prints the database's own time for
each statement (pg_stat_statements: calls, mean), and their sums for a claim, for a report and for all that one job
causes, in milliseconds.  Before that, what a GET of the first, the middle and the last one takes to say how many are
ahead.

Second part: --hosts real hosts (--roles http) that nobody asks anything.  Prints the processor time of all of the
server's processes over --seconds, in parts of a core, and its connections.

The server is that of WHITTLE_CATALOG, started with pg_stat_statements; everything else is in a temporary folder, and
ends with this program.
"""
import argparse
import contextlib
import http.client
import json
import os
import pathlib
import re
import signal
import subprocess
import tempfile
import time

POSTGRES = pathlib.Path(os.environ.get("POSTGRES_BIN", "/usr/lib/postgresql/15/bin"))
SERVER = os.environ["WHITTLE_CATALOG"]
PRINCIPALS = 40
# A waiting job for each number, as the one whose id is given: its rows are copied but for id, principal and time.
FILL = """
CREATE TEMP TABLE model AS SELECT * FROM jobs WHERE id = '{model}';
INSERT INTO jobs (id, state, sequence, attempt, created, started, finished, updated, expires, label, cloud, input_bytes,
    input_points, input_format, params, principal, priority, result, memory, due)
SELECT substr(id, 1, 24) || lpad(to_hex(n), 12, '0'), 0, created, 0, created, 0, 0, updated, 0, label, cloud,
    input_bytes, input_points, input_format, params, 'p' || (n % {principals}), 0, '', memory, due + n
    FROM model, generate_series(1, {waiting}) AS n;
ANALYZE;
"""
CLAIM = ("pg_advisory_xact_lock", "UPDATE usage SET served")
REPORT = ("FOR UPDATE", "UPDATE jobs SET state", "INSERT INTO outputs", "UPDATE outbox")


def sql(text, url):
    done = subprocess.run([POSTGRES / "psql", "-X", "-q", "-A", "-t", "-F", "\t", "-v", "ON_ERROR_STOP=1", "-f", "-", url],
                          input=text, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stderr)
    return done.stdout.strip()


@contextlib.contextmanager
def database(build, name):
    url = re.sub(r"/\w+\?", f"/{name}?", SERVER)
    sql(f"CREATE DATABASE {name}", SERVER)
    try:
        subprocess.run([build / "whittled", "migrate", "--catalog", url], check=True)
        yield url
    finally:
        sql(f"DROP DATABASE {name} WITH (FORCE)", SERVER)


@contextlib.contextmanager
def hosts(build, folder, url, count, *flags):
    """The ports of so many."""
    running, ports = [], []
    try:
        for n in range(count):
            log = open(folder / f"log{n}", "wb")
            running.append(subprocess.Popen(
                [build / "whittled", "--listen", "127.0.0.1:0", "--admin-listen", "off", "--data", folder / f"data{n}",
                 "--catalog", url, "--blobs", f"file:{folder / 'blobs'}", *flags],
                stdout=subprocess.PIPE, stderr=log, text=True))
            log.close()
        for process in running:
            ports.append(int(process.stdout.readline().rsplit(":", 1)[1]))
        yield ports
    finally:
        for process in running:
            process.send_signal(signal.SIGTERM)
        for process in running:
            process.wait()


def request(port, method, path, body=None):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=120)
    connection.request(method, path, body=body)
    reply = connection.getresponse()
    document = json.loads(reply.read())
    connection.close()
    assert reply.status < 300, document
    return document


def statements(url):
    """(text, calls, mean ms, all ms) of each, since they were reset."""
    rows = sql("SELECT replace(query, E'\\n', ' '), calls, mean_exec_time, total_exec_time FROM pg_stat_statements s "
               "JOIN pg_database d ON d.oid = s.dbid WHERE d.datname = current_database() "
               "ORDER BY total_exec_time DESC", url)
    return [(text, int(calls), float(mean), float(total)) for text, calls, mean, total in
            (line.split("\t") for line in rows.splitlines())]


def is_claim(text):
    return "attempt = attempt" in text or any(part in text for part in CLAIM)


def is_report(text):
    return not is_claim(text) and any(part in text for part in REPORT)


def measure_jobs(build, folder, waiting, jobs):
    with database(build, "bench_claims") as url:
        cloud = "".join(f"{n % 7} {n % 11} {n % 13}\n" for n in range(300)).encode()
        with hosts(build, folder, url, 1, "--roles", "http", "--max-queue", "100000") as (port,):
            model = request(port, "POST", "/v1/jobs", cloud)["id"]
            sql(FILL.format(model=model, principals=PRINCIPALS, waiting=waiting), url)
            ids = sql("SELECT id FROM jobs WHERE state = 0 ORDER BY due, id", url).splitlines()
            sql("CREATE EXTENSION IF NOT EXISTS pg_stat_statements", url)
            for place in (0, len(ids) // 2, len(ids) - 1):
                sql("SELECT pg_stat_statements_reset()", url)
                for _ in range(20):
                    ahead = request(port, "GET", f"/v1/jobs/{ids[place]}")["queue"]["ahead"]
                found = [row for row in statements(url) if "MATERIALIZED" in row[0]]
                print(f"{ahead:6} ahead: {sum(row[3] for row in found) / 20:8.2f} ms of the database for a GET of the job")
        sql("SELECT pg_stat_statements_reset()", url)
        with hosts(build, folder, url, 1, "--workers", "2", "--max-queue", "100000"):
            while int(sql("SELECT count(*) FROM jobs WHERE state > 1", url)) < jobs:
                time.sleep(0.2)
        done = int(sql("SELECT count(*) FROM jobs WHERE state > 1", url))
        left = int(sql("SELECT count(*) FROM jobs WHERE state = 0", url))
        rows = statements(url)
        print(f"\n{done} jobs run, {left} still wait; the database's time:\n  calls  mean ms  statement")
        for text, calls, mean, _ in rows[:12]:
            print(f"{calls:7} {mean:8.3f}  {text[:100]}")
        claims = next(calls for text, calls, _, _ in rows if "UPDATE usage SET served" in text)
        waits = sum(total for text, _, _, total in rows if CLAIM[0] in text)
        claim = sum(total for text, _, _, total in rows if is_claim(text)) - waits
        report = sum(total for text, _, _, total in rows if is_report(text))
        print(f"a claim {claim / claims:.2f} ms, a report {report / done:.2f} ms, both "
              f"{claim / claims + report / done:.2f} ms; all statements of a job {sum(r[3] for r in rows) / done:.2f} ms "
              f"(of it waiting for the turn to claim {waits / done:.2f} ms)")


def server_ticks(root):
    """Processor time of the server's processes, those that have ended too."""
    def fields(pid):
        return pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    total = sum(map(int, fields(root)[11:15]))
    for child in pathlib.Path(f"/proc/{root}/task/{root}/children").read_text().split():
        with contextlib.suppress(OSError):
            total += sum(map(int, fields(child)[11:13]))
    return total


def measure_idle(build, folder, count, seconds):
    with database(build, "bench_idle") as url:
        data = sql("SHOW data_directory", url)
        postmaster = int(pathlib.Path(data, "postmaster.pid").read_text().split()[0])
        with hosts(build, folder, url, count, "--roles", "http"):
            time.sleep(12)  # a period of everything that is done by the clock
            sql("CREATE EXTENSION IF NOT EXISTS pg_stat_statements; SELECT pg_stat_statements_reset()", url)
            before, began = server_ticks(postmaster), time.monotonic()
            time.sleep(seconds)
            used = (server_ticks(postmaster) - before) / os.sysconf("SC_CLK_TCK") / (time.monotonic() - began)
            connections = sql("SELECT count(*) FROM pg_stat_activity WHERE datname = current_database()", url)
            rows = statements(url)
        print(f"\n{count} idle hosts ({connections} connections): {used:.3f} of a core, "
              f"{sum(row[1] for row in rows) / seconds:.0f} statements a second")
        for text, calls, mean, _ in rows[:6]:
            print(f"{calls / seconds:7.1f}/s {mean:8.3f} ms  {text[:100]}")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("build", type=lambda path: pathlib.Path(path).resolve())
    parser.add_argument("--waiting", type=int, default=10000)
    parser.add_argument("--jobs", type=int, default=100)
    parser.add_argument("--hosts", type=int, default=100)
    parser.add_argument("--seconds", type=int, default=20)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if options.jobs:
            measure_jobs(options.build, pathlib.Path(folder), options.waiting, options.jobs)
    with tempfile.TemporaryDirectory() as folder:
        if options.hosts:
            measure_idle(options.build, pathlib.Path(folder), options.hosts, options.seconds)


if __name__ == "__main__":
    main()
