"""Find the Lagrangian of a mechanical system from noisy measured coordinates.

You give recorded angles or positions, and forces where there are motors; you get a short formula for L and
for the friction, each coefficient with its error, and a verdict on whether to trust it. A pendulum:

>>> import leastaction as la
>>> runs = la.systems.generate("single_pendulum", noise=0.01, trials=3, duration=6.0, seed=0)
>>> runs.coordinates, runs.n_trajectories  # of your own: la.read("runs.csv", ["theta"])
(('theta',), 3)
>>> candidates = ["theta_dot**2", "cos(theta)", "sin(theta)", "theta**2"]
>>> model = la.discover(runs[:2], candidates, angles=["theta"])
>>> model.fit.status
'ok'
>>> print(model.formula())  # doctest: +SKIP
L = 0.4992*theta_dot**2 + 9.791*cos(theta)
>>> forecast = model.validate(runs[2:])  # a recording that was not used
>>> bool(forecast.rms_over_std[0] < 0.05)
True

What to do next:

* Look: ``la.show(model)`` in a terminal, or ``model`` alone in a notebook; ``.plot()`` and ``.to_frame()`` of
  models, trajectories, simulations and forecasts (they need Matplotlib and pandas).
* Read data: `read`, `read_csv`, `from_frame`, `stream`; or make `Trajectories` of arrays.
* Choose candidates: ``la.Library.mechanical(["x", "theta"], angles=["theta"])`` generates them.
* Use the law: ``model.simulate``, ``model.equations_of_motion``, ``model.equilibria``, `export` to C, Python,
  MATLAB, CasADi or an FMU.
* Keep it: ``model.save(path)`` and `load`; `write_report` writes one HTML page with figures.
* Without code: ``leastaction demo``, ``leastaction app`` and ``leastaction --help`` in a terminal.

``help(la.discover)`` and every other help text hold shapes, units, errors and an example. The documentation
begins with ``docs/start.md``.
"""
# The names in __all__ are public, and only these.  They are loaded when first used, so that
# ``leastaction --help`` does not wait for SymPy.  What needs an extra is public too, but not in __all__, so
# that ``from leastaction import *`` works without: SparseLagrangian, casadi and control.  StopSearch is for
# those who follow a search.

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from leastaction import arms as arms
    from leastaction import casadi as casadi
    from leastaction import control as control
    from leastaction import delay as delay
    from leastaction import experiment as experiment
    from leastaction import io, metrics, systems
    from leastaction import measure as measure
    from leastaction import units as units
    from leastaction.api import discover
    from leastaction.curve.motion import smooth
    from leastaction.data.trajectories import Trajectories, Trajectory
    from leastaction.errors import DataError, InputError
    from leastaction.errors import StopSearch as StopSearch
    from leastaction.estimation.adam import AdamOptions
    from leastaction.exporters.write import export
    from leastaction.io import from_frame, read, read_csv, read_mat, read_npz, read_parquet, stream, write_csv
    from leastaction.library import Library
    from leastaction.mechanics.euler_lagrange import euler_lagrange
    from leastaction.model.file import load
    from leastaction.model.model import LagrangianModel
    from leastaction.report import write_arm_report, write_report
    from leastaction.shown import show
    from leastaction.simulation.results import SimulationResult
    from leastaction.sklearn import SparseLagrangian as SparseLagrangian

_HOMES = {
    "AdamOptions": "estimation.adam",
    "DataError": "errors",
    "InputError": "errors",
    "LagrangianModel": "model.model",
    "Library": "library",
    "SimulationResult": "simulation.results",
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
    "show": "shown",
    "smooth": "curve.motion",
    "stream": "io",
    "write_arm_report": "report",
    "write_csv": "io",
    "write_report": "report",
}

# Modules for particular needs are reached by their name, but are not in the list below.
_MODULES = frozenset(
    {"arms", "casadi", "control", "delay", "experiment", "io", "measure", "metrics", "systems", "units"}
)

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
    "show",
    "smooth",
    "stream",
    "systems",
    "write_arm_report",
    "write_csv",
    "write_report",
]


if not TYPE_CHECKING:  # a type checker, which reads the imports above, then reports misspelt names

    def __getattr__(name: str):
        if name in _MODULES:
            return import_module(f"leastaction.{name}")
        if name in _HOMES:
            return getattr(import_module(f"leastaction.{_HOMES[name]}"), name)
        raise AttributeError(f"module 'leastaction' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
