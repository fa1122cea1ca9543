"""Settings and fixtures shared by all tests."""

from __future__ import annotations

import linecache
import os

os.environ.setdefault("MPLBACKEND", "Agg")  # before anything imports matplotlib: no display is needed

import numpy as np
import pytest
from hypothesis import settings

# No deadline: first calls compile expressions. In CI the same examples every time.
settings.register_profile("local", deadline=None, print_blob=True)
settings.register_profile("ci", deadline=None, derandomize=True, database=None)
settings.load_profile("ci" if os.environ.get("CI") else "local")


_check = linecache.checkcache


def _check_again(filename: str | None = None) -> None:
    """Check the cache of source lines, which loses entries meanwhile.

    SymPy removes the lines of a compiled function when that is collected, and doctest checks the cache
    while collection may happen: a KeyError then, once in thousands of tests.
    """
    try:
        _check(filename)
    except KeyError:
        _check_again(filename)


linecache.checkcache = _check_again


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a generator that starts from the same state in every test."""
    return np.random.default_rng(20260101)
