"""Settings and fixtures shared by all tests."""

from __future__ import annotations

import linecache
import os
from collections.abc import Callable
from pathlib import Path

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


@pytest.fixture
def file(tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes text or bytes to a file, run.csv by default, and returns the path."""

    def write(content: str | bytes, name: str = "run.csv") -> Path:
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write
