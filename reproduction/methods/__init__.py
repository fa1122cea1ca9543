"""The methods; each has TITLE, REFERENCE and ``solve(problem) -> Answer``. Variants may share a file."""

from __future__ import annotations

from importlib import import_module
from typing import Any

__all__ = ["NAMES", "load"]

# in the sequence of the tables' columns
NAMES = (
    "ours",
    "adam",
    "xlsindy_exact",
    "xlsindy_positions",
    "energy",
    "sindy",
    "sindy_pi",
    "sindy_weak",
    "rk4_sindy",
    "operon",
    "udsr",
)
_HOMES = {"xlsindy_exact": "xlsindy", "xlsindy_positions": "xlsindy", "sindy_weak": "sindy"}


def load(name: str) -> Any:
    """Import the file of a method; its packages are needed only then."""
    if name not in NAMES:
        raise ValueError(f"method {name!r} is unknown; choose one of {', '.join(NAMES)}")
    home = import_module(f"reproduction.methods.{_HOMES.get(name, name)}")
    return getattr(home, name) if name in _HOMES else home
