# SPDX-License-Identifier: GPL-3.0-or-later
"""The short form of the crash campaign (crash.py; the long one is `make test-crash`)."""
import pytest

from crash import campaign


@pytest.mark.parametrize("seed", [1, 2])
def test_kills_at_named_and_random_moments(tmp_path, seed):
    campaign(tmp_path, 8, seed)
