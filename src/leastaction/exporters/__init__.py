"""Export of models to other programs: `write.export` and one module for each format, all named here."""

from __future__ import annotations

from difflib import get_close_matches

from leastaction.errors import InputError
from leastaction.identifiers import quoted

__all__ = ["FORMATS", "check_format"]

FORMATS = {
    "sympy": "Python script that defines L and the dissipation function with SymPy",
    "latex": "L and the dissipation function as a displayed formula",
    "python": "Python module without dependencies: acceleration and energy",
    "c": "C99 file, needs only math.h: acceleration and energy",
    "casadi": "Python module that creates CasADi functions: acceleration, energy, mass matrix",
    "jax": "Python module for JAX: acceleration, state derivative, energy, mass matrix",
    "julia": "Julia module without packages: acceleration, state derivative for ODEProblem, energy",
    "modelica": "Modelica package: mass matrix, right side, energy, and a model of the motion",
    "mjcf": "MuJoCo model of a chain of links in a plane, if the law is one",
    "urdf": "robot description of a chain of links in a plane, if the law is one",
    "matlab": "MATLAB or Octave function file: acceleration, state derivative for ode45, energy",
    "fmu2": "FMU for co-simulation, FMI 2.0: C sources and compiled code",
    "fmu3": "FMU for co-simulation, FMI 3.0: C sources and compiled code",
}
"""Name -> one line."""


def check_format(format: str) -> None:
    """Refuse an unknown format.

    Raises
    ------
    InputError
    """
    if not isinstance(format, str) or format not in FORMATS:
        near = get_close_matches(str(format)[:40].lower(), FORMATS, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise InputError(f"format is {quoted(format)}; expected one of {', '.join(FORMATS)}{hint}")
