"""Settings and fixtures shared by all tests."""

from __future__ import annotations

import os

os.environ.setdefault("MPLBACKEND", "Agg")  # before anything imports matplotlib: no display is needed

import numpy as np
import pytest
from hypothesis import settings

# No deadline: first calls compile expressions. In CI the same examples every time.
settings.register_profile("local", deadline=None, print_blob=True)
settings.register_profile("ci", deadline=None, derandomize=True, database=None)
settings.load_profile("ci" if os.environ.get("CI") else "local")


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a generator that starts from the same state in every test."""
    return np.random.default_rng(20260101)
