# SPDX-License-Identifier: GPL-3.0-or-later
"""All widths of vectors compute the same bits: programs that have one form of each kernel alone, beside the one that
chooses between two."""
import fcntl
import os
import pathlib
import subprocess

import pytest

from test_parameters import files, make_scans  # noqa: F401  the scans are a fixture

ROOT = pathlib.Path(__file__).resolve().parents[2]
WHITTLE = os.path.join(os.environ.get("WHITTLE_BUILD", "build/release"), "whittle")


@pytest.fixture(name="other", scope="module", params=["narrow", "scalar"])
def make_other(request):
    config, folder = request.param, ROOT / "build"
    with open(folder / f"{config}.lock", "w", encoding="ascii") as lock:  # tests run beside each other
        fcntl.flock(lock, fcntl.LOCK_EX)
        made = subprocess.run(["make", "-C", str(ROOT), f"config={config}", f"build/{config}/whittle"],
                              capture_output=True, text=True, check=False,
                              env={k: v for k, v in os.environ.items() if k != "MAKEFLAGS"})
    assert made.returncode == 0, made.stderr
    return str(folder / config / "whittle")


def is_wide(program):
    return "_avx2" in subprocess.run(["nm", program], capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("scan, options", [
    ("torus", {"outputs": "cloud,mesh,dso,error,report"}),
    ("torus", {"outputs": "mesh,report", "placement": "optimal"}),
    ("torus", {"outputs": "mesh,report", "levels": "0.5,0.1", "reconstruction": "literal"}),
    ("noisy", {"outputs": "cloud,mesh,report", "denoise": "full"}),
    ("open", {"outputs": "mesh,report", "boundary": "keep"})])
def test_the_same_bits_for_all_widths(scan, options, scans, other, tmp_path):
    if "avx2" not in pathlib.Path("/proc/cpuinfo").read_text(encoding="utf-8"):
        pytest.skip("this processor has no AVX2, so that form of the kernels isn't run")
    if pathlib.Path(WHITTLE).parent.name != "release":
        pytest.skip("only config=release chooses between two forms of the kernels")
    assert is_wide(WHITTLE)
    assert not is_wide(other)
    assert files(scans[scan], tmp_path / "wide", options) == files(scans[scan], tmp_path / "other", options, other)
