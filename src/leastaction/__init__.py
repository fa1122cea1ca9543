"""leastaction: the Lagrangian of a mechanical system from noisy measured coordinates.

The names below are public, and only these.  They are loaded when first used, so that
``leastaction --help`` does not wait for SymPy.  What needs an extra is public too, but not in ``__all__``, so
that ``from leastaction import *`` works without: `SparseLagrangian`, `casadi` and `control`.  `StopSearch` is
for those who follow a search.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from leastaction import casadi as casadi
    from leastaction import control as control
    from leastaction import delay as delay
    from leastaction import io, metrics, systems
    from leastaction import units as units
    from leastaction.api import discover
    from leastaction.curve.motion import smooth
    from leastaction.data.trajectories import Trajectories, Trajectory
    from leastaction.errors import DataError, InputError
    from leastaction.errors import StopSearch as StopSearch
    from leastaction.estimation.adam_options import AdamOptions
    from leastaction.exporters.write import export
    from leastaction.io import from_frame, read, read_csv, read_mat, read_npz, read_parquet, stream, write_csv
    from leastaction.library import Library
    from leastaction.mechanics.euler_lagrange import euler_lagrange
    from leastaction.model.file import load
    from leastaction.model.model import LagrangianModel
    from leastaction.report import write_report
    from leastaction.simulation.integrate import SimulationResult
    from leastaction.sklearn import SparseLagrangian as SparseLagrangian

_HOMES = {
    "AdamOptions": "estimation.adam_options",
    "DataError": "errors",
    "InputError": "errors",
    "LagrangianModel": "model.model",
    "Library": "library",
    "SimulationResult": "simulation.integrate",
    "SparseLagrangian": "sklearn",
    "StopSearch": "errors",
    "Trajectories": "data.trajectories",
    "Trajectory": "data.trajectories",
    "discover": "api",
    "euler_lagrange": "mechanics.euler_lagrange",
    "export": "exporters.write",
    "from_frame": "io",
    "load": "model.file",
    "read": "io",
    "read_csv": "io",
    "read_mat": "io",
    "read_npz": "io",
    "read_parquet": "io",
    "smooth": "curve.motion",
    "stream": "io",
    "write_csv": "io",
    "write_report": "report",
}

# Modules for particular needs are reached by their name, but are not in the list below.
_MODULES = frozenset({"casadi", "control", "delay", "io", "metrics", "systems", "units"})

__all__ = [
    "AdamOptions",
    "DataError",
    "InputError",
    "LagrangianModel",
    "Library",
    "SimulationResult",
    "Trajectories",
    "Trajectory",
    "discover",
    "euler_lagrange",
    "export",
    "from_frame",
    "io",
    "load",
    "metrics",
    "read",
    "read_csv",
    "read_mat",
    "read_npz",
    "read_parquet",
    "smooth",
    "stream",
    "systems",
    "write_csv",
    "write_report",
]


def __getattr__(name: str):
    if name in _MODULES:
        return import_module(f"leastaction.{name}")
    if name in _HOMES:
        return getattr(import_module(f"leastaction.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'leastaction' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
