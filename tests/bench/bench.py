#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the time goes, and how much of it there is.

Usage: bench.py BUILD_FOLDER [--large] [--peers] [--save FILE | --compare FILE]

Prints, for Horse and Venus where ../shared/data is there and for synthetic scans of 100 thousand and 1 million points
(and 10 million with --large): time of each stage, points per second, bytes per point at the peak, for clouds and for
meshes; what a second thread gains; how the time for each point grows; and the time of a whole job over HTTP on Horse
at 10 % with mesh and error, from POST to outputs ready. --peers adds the most exact peers that pick points, CGAL's
WLOP and Open3D's farthest-point sampling (which looks at all points for each that it picks: minutes for a million): a
tenth of the points, and whittle at the same count; errors against the same points by the same tool after the same
reconstruction (CGAL's advancing front). WLOP moves points, which averages noise; so on the synthetic scan it is
compared with denoise=full, too, and errors are also against the scan without its noise. Machines differ and are
noisy: compare ratios within one run. --save writes the figures as JSON, --compare prints the ratios against such a
file. Ratios within a run, which other machines have much the same (each stage's share of a million points, how the
time for each point grows), are always compared with tests/bench/ratios.json; a figure over MORE times its old one is
told. --save-ratios stores them.
"""
import argparse
import json
import pathlib
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "peers"))
import models  # noqa: E402
from programs import Failed, Made, Programs, best, processor_ms  # noqa: E402

SHARED = pathlib.Path("../shared/data")
RATIOS = pathlib.Path(__file__).with_name("ratios.json")
MORE, LEAST_SHARE = 1.25, 0.02
# The most exact peers that pick points: their program, and whether they move what they pick.
PEERS = {"wlop": ("points_cgal", True), "farthest": ("open3d", False)}
LONG = 10**5  # points; a peer runs once on more
SYNTHETIC = {"100k": 10**5, "1M": 10**6, "10M": 10**7}


def run(*arguments, **options):
    done = subprocess.run([str(a) for a in arguments], capture_output=True, check=False, **options)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, arguments))}\n{done.stderr.decode()}")
    return done.stdout


def whittle(build, cloud, folder, *extra, repeat=3):
    """The report, and wall and processor time in seconds, file to file, of the fastest of some runs."""
    runs = []
    for _ in range(repeat):
        before, start = processor_ms(), time.monotonic()
        run(build / "whittle", cloud, "-o", folder, "-q", *extra)
        wall = time.monotonic() - start
        runs.append((wall, (processor_ms() - before) / 1e3, json.loads((folder / "report.json").read_text())))
    wall, _, report = min(runs, key=lambda one: one[0])
    return report, wall, min(one[1] for one in runs)


def print_run(name, report, wall, processor):
    points = report["points_in"]
    stages = "  ".join(f"{k} {v:.0f} ({v / points * 1e6:.0f})" for k, v in report["timings_ms"].items()
                       if k != "total" and v >= 0.5)
    print(f"{name:34s} {wall:8.3f} s  {processor:8.3f} s of processors  {points / wall / 1e6:6.2f} M points/s  "
          f"{report['peak_rss_bytes'] / points:6.0f} B/point   ms (ns for each point): {stages}", flush=True)


def job_over_http(build, cloud, folder):
    """Seconds from POST to the outputs ready, the fastest of five."""
    daemon = subprocess.Popen([build / "whittled", "--listen", "127.0.0.1:0", "--data", folder / "data"],
                              stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        url = next(word for word in daemon.stdout.readline().split() if word.startswith("http://")).rstrip("/")
        best = None
        for attempt in range(5):
            start = time.monotonic()
            query = f"ratio=0.1&outputs=cloud,mesh,report&label=bench{attempt}&seed={attempt}"
            job = json.loads(run("curl", "-fsS", "-X", "POST", "-T", cloud, f"{url}/v1/jobs?{query}"))
            while job["status"] in ("accepted", "running"):
                job = json.loads(run("curl", "-fsS", "-H", "Prefer: wait=10", f"{url}/v1/jobs/{job['id']}"))
            if job["status"] != "successful":
                sys.exit(f"the job failed: {job['problem']}")
            wall = time.monotonic() - start
            best = wall if best is None else min(best, wall)
        return best
    finally:
        daemon.terminate()
        daemon.wait()


def beside_peers(build, folder, clouds, figures):
    """Time and error of the peers that pick points, divided by whittle's at the same count."""
    programs = Programs(build, folder / "peers")
    for label, cloud in clouds:
        measured = measured_against(build, folder, label, cloud)
        plain = measured[0]
        points = models.count_of(cloud)
        for method, (program, moves) in PEERS.items():
            if not (build / "tests/peers" / program).exists():
                print(f"skipped: {method}, for {program} isn't built (make peers builds it)")
                continue
            try:
                repeat = 1 if points > LONG else 3
                made = best(lambda: programs.peer(program, method, Made(plain), points // 10), repeat)
                errors = errors_of(programs, made, measured)
                print_made(f"{label}, {method}", made, errors)
                for options in [(), ("--denoise", "full")][:2 if moves and len(measured) > 1 else 1]:
                    own = best(lambda: programs.kept(cloud, "--points", made.points, *options), 3)
                    name = " ".join(("whittle", *options))
                    key = ".".join((label, method, *options[1:]))
                    print_beside(f"{label}, {method}", name, made, own, errors, errors_of(programs, own, measured))
                    figures[f"{key}.ratio"] = made.ms / own.ms
                    figures[f"{key}.processor-ratio"] = made.processor_ms / own.processor_ms
            except Failed as failure:
                print(f"{label}, {method}: {failure}")


def measured_against(build, folder, label, cloud):
    """The cloud as peers read it, and, of a synthetic scan, the same points without noise."""
    paths = [folder / f"{label}.plain.ply"]
    models.to_plain(cloud, paths[0])
    if label in SYNTHETIC:
        exact = folder / f"{label}.exact.ply"
        exact.write_bytes(run(build / "tests/bench/make_scan", SYNTHETIC[label], 1, 0))
        paths.append(folder / f"{label}.exact.plain.ply")
        models.to_plain(exact, paths[1])
    return paths


def errors_of(programs, made, clouds):
    """The mean distances of clouds' points to CGAL's front through those that were picked."""
    front = programs.peer("surface_cgal", "front", made, 0)
    return [json.loads(run(programs.build / "whittle", "measure", front.path, cloud, "--json"))["forward"]["mean_rel"]
            for cloud in clouds]


def print_made(name, made, errors):
    exact = "".join(f", without noise {1e4 * e:.3f}e-4" for e in errors[1:])
    print(f"{name:34s} {made.ms / 1e3:8.3f} s  {made.processor_ms / 1e3:8.3f} s of processors  {made.points} points, "
          f"mean distance to the mesh {1e4 * errors[0]:.3f}e-4{exact}", flush=True)


def print_beside(label, name, made, own, errors, own_errors):
    print_made(f"{label}: {name}", own, own_errors)
    shares = ", without noise ".join(f"{e / o:.2f}" for e, o in zip(errors, own_errors))
    print(f"{f'{label} / {name}':34s} {made.ms / own.ms:8.2f}    {made.processor_ms / own.processor_ms:8.2f} of the "
          f"processors' time   {shares} of the error", flush=True)


def compare_ratios(figures, save):
    now = {k: round(v, 4) for k, v in figures.items() if k.endswith((".share", ".growth"))}
    before = json.loads(RATIOS.read_text()) if RATIOS.exists() else {}
    for key in sorted(now.keys() & before.keys()):
        if now[key] > LEAST_SHARE and now[key] > MORE * before[key]:
            print(f"{key:34s} {now[key]:6.3f}, was {before[key]:.3f}: MORE")
    if save:
        RATIOS.write_text(json.dumps({**before, **now}, indent=1, sort_keys=True) + "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--peers", action="store_true")
    parser.add_argument("--save-ratios", action="store_true")
    parser.add_argument("--save", type=pathlib.Path)
    parser.add_argument("--compare", type=pathlib.Path)
    options = parser.parse_args()
    build, figures, each = options.build, {}, {}
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        clouds = [(p, SHARED / f"{p}.points.ply") for p in ("horse", "venus") if (SHARED / f"{p}.points.ply").exists()]
        if not clouds:
            print("skipped: Horse and Venus, for ../shared/data isn't there")
        for label, count in SYNTHETIC.items():
            if label == "10M" and not options.large:
                continue
            path = folder / f"{label}.ply"
            with open(path, "wb") as out:
                subprocess.run([build / "tests/bench/make_scan", str(count)], stdout=out, check=True)
            clouds.append((label, path))
        for label, path in clouds:
            heavy = label == "10M"
            report, wall, processor = whittle(build, path, folder / "out", "--ratio", "0.1", repeat=1 if heavy else 3)
            print_run(f"{label}, cloud at 10 %", report, wall, processor)
            figures[f"{label}.cloud"] = wall
            figures[f"{label}.processor"] = processor
            each[label] = processor / report["points_in"]
            figures.update({f"{label}.{k}": v / 1e3 for k, v in report["timings_ms"].items()})
            if label == "1M":
                stages = report["timings_ms"]
                figures.update({f"1M.{k}.share": v / stages["total"] for k, v in stages.items() if k != "total"})
                _, one, _ = whittle(build, path, folder / "out", "--ratio", "0.1", "--threads", "1")
                print(f"{'1M, one thread against all':34s} {one / wall:8.2f} times the time")
                figures["1M.one-thread-ratio"] = one / wall
            if label in ("horse", "venus", "100k"):
                report, wall, processor = whittle(build, path, folder / "out", "--ratio", "0.1", "--outputs",
                                                  "cloud,mesh,report")
                print_run(f"{label}, mesh and error at 10 %", report, wall, processor)
                figures[f"{label}.mesh"] = wall
        for label in [x for x in ("1M", "10M") if x in each]:
            print(f"{label + ', a point against 100k':34s} {each[label] / each['100k']:8.2f} times the time of processors")
            figures[f"{label}.growth"] = each[label] / each["100k"]
        if options.peers:
            beside_peers(build, folder, [c for c in clouds if c[0] in ("horse", "1M")], figures)
        if clouds[0][0] == "horse" and (build / "whittled").exists():
            wall = job_over_http(build, clouds[0][1].resolve(), folder)
            print(f"{'horse, job over HTTP at 10 %':34s} {wall:8.3f} s  from POST to outputs ready, mesh and error included")
            figures["horse.job"] = wall
    compare_ratios(figures, options.save_ratios)
    if options.save:
        options.save.write_text(json.dumps(figures, indent=1, sort_keys=True) + "\n")
    if options.compare:
        before = json.loads(options.compare.read_text())
        for key in sorted(figures.keys() & before.keys()):
            if before[key] > 1e-3:
                print(f"{key:34s} {figures[key] / before[key]:6.2f} times what it was")


main()
