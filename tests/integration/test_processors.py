# SPDX-License-Identifier: GPL-3.0-or-later
"""All widths of vectors compute the same bits: programs that have one form of each kernel alone, beside the one that
chooses between two."""
import os
import pathlib
import subprocess

import pytest

from test_parameters import files, make_scans  # noqa: F401  the scans are a fixture

ROOT = pathlib.Path(__file__).resolve().parents[2]
WHITTLE = os.path.join(os.environ.get("WHITTLE_BUILD", "build/release"), "whittle")


@pytest.fixture(name="forms")
def find_forms():
    """The folder of whittle as config=narrow and config=scalar build it: `make tests` links release's objects again, but
    for those in which these differ."""
    if "avx2" not in pathlib.Path("/proc/cpuinfo").read_text(encoding="utf-8"):
        pytest.skip("this processor has no AVX2, so that form of the kernels isn't run")
    if pathlib.Path(WHITTLE).parent.name != "release":
        pytest.skip("only config=release chooses between two forms of the kernels")
    return pathlib.Path(WHITTLE).parent / "forms"


@pytest.fixture(name="other", params=["narrow", "scalar"])
def make_other(forms, request):
    return str(forms / request.param / "whittle")


def objects_with_vectors(folder):
    """What was compiled of sources that include core/math/simd.h, by way of other headers too."""
    found = {path.relative_to(folder).with_suffix("") for path in (folder / "core").rglob("*.d")
             if len(path.suffixes) == 1 and "core/math/simd.h" in path.read_text(encoding="utf-8")}
    return {name for name in found if (ROOT / name.with_suffix(".c")).exists()}


def test_whatever_has_vectors_is_compiled_again_without(forms):
    assert len(objects_with_vectors(forms.parent)) > 10
    assert objects_with_vectors(forms.parent) == objects_with_vectors(forms / "scalar")


def is_wide(program):
    return "_avx2" in subprocess.run(["nm", program], capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("scan, options", [
    ("torus", {"outputs": "cloud,mesh,dso,error,report"}),
    ("torus", {"outputs": "mesh,report", "placement": "optimal"}),
    ("torus", {"outputs": "mesh,report", "levels": "0.5,0.1", "reconstruction": "literal"}),
    ("noisy", {"outputs": "cloud,mesh,report", "denoise": "full"}),
    ("open", {"outputs": "mesh,report", "boundary": "keep"})])
def test_the_same_bits_for_all_widths(scan, options, scans, other, tmp_path):
    assert is_wide(WHITTLE)
    assert not is_wide(other)
    assert files(scans[scan], tmp_path / "wide", options) == files(scans[scan], tmp_path / "other", options, other)
