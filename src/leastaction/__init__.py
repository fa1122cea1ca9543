"""leastaction: the Lagrangian of a mechanical system from noisy measured coordinates.

The names below are public, and only these.  They are loaded when first used, so that
``leastaction --help`` does not wait for SymPy.  What needs an extra is public too, but not in ``__all__``, so
that ``from leastaction import *`` works without: `SparseLagrangian`, `casadi` and `control`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from leastaction import _delay as delay  # noqa: F401
    from leastaction import _metrics as metrics
    from leastaction import _units as units  # noqa: F401
    from leastaction import casadi as casadi
    from leastaction import control as control
    from leastaction import io, systems
    from leastaction._discover import discover
    from leastaction._errors import DataError, InputError
    from leastaction._estimator import SparseLagrangian as SparseLagrangian
    from leastaction._euler_lagrange import euler_lagrange
    from leastaction._export._write import export
    from leastaction._fit.adam_options import AdamOptions
    from leastaction._library import Library
    from leastaction._model import LagrangianModel, load
    from leastaction._report import write_report
    from leastaction._simulate import SimulationResult
    from leastaction._smooth_motion import smooth
    from leastaction._trajectory import Trajectories, Trajectory
    from leastaction.io import from_frame, read, read_csv, read_mat, read_npz, read_parquet, write_csv

_HOMES = {
    "AdamOptions": "_fit.adam_options",
    "DataError": "_errors",
    "InputError": "_errors",
    "LagrangianModel": "_model",
    "Library": "_library",
    "SimulationResult": "_simulate",
    "SparseLagrangian": "_estimator",
    "Trajectories": "_trajectory",
    "Trajectory": "_trajectory",
    "discover": "_discover",
    "euler_lagrange": "_euler_lagrange",
    "export": "_export._write",
    "from_frame": "io",
    "load": "_model",
    "read": "io",
    "read_csv": "io",
    "read_mat": "io",
    "read_npz": "io",
    "read_parquet": "io",
    "smooth": "_smooth_motion",
    "write_csv": "io",
    "write_report": "_report",
}

# Modules for particular needs are reached by their name, but are not in the list below.
_MODULES = {
    "casadi": "casadi",
    "control": "control",
    "delay": "_delay",
    "io": "io",
    "metrics": "_metrics",
    "systems": "systems",
    "units": "_units",
}

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
    "systems",
    "write_csv",
    "write_report",
]


def __getattr__(name: str):
    if name in _MODULES:
        return import_module(f"leastaction.{_MODULES[name]}")
    if name in _HOMES:
        return getattr(import_module(f"leastaction.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'leastaction' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
