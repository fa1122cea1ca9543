"""export(): a model in one of the formats."""

from __future__ import annotations

import os
from typing import Literal, TypeAlias, overload

from leastaction.data.formats.atomic import check_path
from leastaction.errors import InputError
from leastaction.exporters import c, casadi, chains, check_format, fmu, julia, matlab, python
from leastaction.io import write_bytes
from leastaction.model.model import LagrangianModel
from leastaction.model.text import smoothing_notes

__all__ = ["export"]

_Path: TypeAlias = "str | os.PathLike[str] | None"


def _latex(model: LagrangianModel) -> str:
    head = ["Written by leastaction; needs amsmath.", *smoothing_notes(model)]
    return "".join(f"% {line}\n" for line in head) + f"\\[\n{model.latex()}\n\\]\n"


_PLAIN = {
    "sympy": python.write_sympy,
    "latex": _latex,
    "python": python.write,
    "c": c.write,
    "casadi": casadi.write,
    "jax": python.write_jax,
    "julia": julia.write_julia,
    "modelica": julia.write_modelica,
    "mjcf": chains.write_mjcf,
    "urdf": chains.write_urdf,
}


@overload
def export(model: LagrangianModel, format: Literal["fmu2", "fmu3"], path: _Path = None) -> bytes: ...
@overload
def export(
    model: LagrangianModel,
    format: Literal[
        "sympy", "latex", "python", "c", "casadi", "jax", "julia", "modelica", "mjcf", "urdf", "matlab"
    ],
    path: _Path = None,
) -> str: ...
@overload
def export(model: LagrangianModel, format: str, path: _Path = None) -> str | bytes: ...
def export(model, format, path=None):
    """Write a model as a text or file that does not need leastaction.

    ==============  =========================================================================================
    format          content
    ==============  =========================================================================================
    ``"sympy"``     a Python script that defines ``lagrangian`` and ``dissipation_function`` with SymPy, over
                    real symbols with the names of the coordinates and ``<coordinate>_dot``, with all digits
    ``"latex"``     L and ψ as a displayed formula (needs the package amsmath), rounded to their errors
    ``"python"``    a module that imports only `math`: ``acceleration(q, qdot, forces=None)`` -> list and
                    ``energy(q, qdot)`` -> float of plain sequences
    ``"c"``         C99 that needs only ``math.h``: ``void leastaction_acceleration(q, qdot, forces,
                    qddot)``, ``double leastaction_energy(q, qdot)`` of arrays; ``forces`` may be ``NULL``
    ``"casadi"``    a Python module that imports `casadi` and defines three ``casadi.Function``:
                    ``acceleration(q, qdot, forces)``, ``energy(q, qdot)``, ``mass_matrix(q, qdot)``; without
                    a file, `leastaction.casadi.functions` returns the same
    ``"jax"``       a Python module that imports `jax.numpy`: ``acceleration(q, qdot, forces=None)``,
                    ``state_derivative(t, x, forces=None)``, ``energy(q, qdot)``, ``mass_matrix(q, qdot)`` of
                    one state, to be mapped, differentiated and compiled; double precision must be enabled
                    in JAX
    ``"julia"``     a module ``LeastactionModel`` that needs only `LinearAlgebra`: ``acceleration(q, qdot,
                    forces)``, ``energy(q, qdot)``, ``mass_matrix(q, qdot)``, and ``state_derivative!(dx, x,
                    p, t)`` for ``ODEProblem``
    ``"modelica"``  a package ``LeastactionModel`` with the functions ``mass_matrix``, ``right_side`` and
                    ``energy``, and the model ``Motion`` with ``forces`` as inputs
    ``"mjcf"``      a MuJoCo model, if the law is that of a chain of links in a plane: masses, centres,
                    inertias and lengths that give this L up to a constant (they are not unique). Joint
                    angles are relative to the previous link. Friction that a joint cannot have is left out
                    and named in the file
    ``"urdf"``      the same as a robot description
    ``"matlab"``    a function file for MATLAB and Octave; it returns a structure of function handles:
                    ``acceleration(q, qdot, forces)``, ``state_derivative(t, x, forces)`` with x = [q; qdot]
                    for ``ode45``, ``energy(q, qdot)``, ``mass_matrix(q, qdot)``. The function has the name
                    of the file
    ``"fmu2"``      an FMU for co-simulation (FMI 2.0) with its C sources, compiled for this computer by the
                    C compiler on the PATH, and with the extra ``fmu`` also for Windows, Linux and macOS.
                    Inputs ``<coordinate>_force``; outputs ``<coordinate>``,
                    ``<coordinate>_dot``, ``<coordinate>_dot_dot`` and ``energy``; the start values of the
                    first two are the initial state. Parameters: the coefficients, ``lagrangian_1`` ... and
                    ``dissipation_1`` ..., and ``max_step``, the longest internal step of the RK4 method (1 ms
                    or a tenth of a knot interval of the discovery, halved until another halving changes 100
                    steps by less than 1e-8 of the motion). Inputs are constant during a communication step.
                    Times and angles have units
    ``"fmu3"``      the same for FMI 3.0
    ==============  =========================================================================================

    If the law depends on time, ``t`` follows q and qdot as an argument in Python, C, CasADi, JAX, Julia and
    MATLAB. An FMU and Modelica's ``Motion`` use the time of the simulation, and the script for SymPy has a
    symbol ``t``.

    If the mass matrix is exactly singular, the accelerations are not finite; MATLAB also warns, an FMU
    rejects the step, and Julia and Modelica stop with their own message. If a function is undefined
    (logarithm of a negative number), C, CasADi and JAX return NaN, Python raises the exception of `math`, and
    MATLAB, Julia and Modelica stop with their own message.

    Parameters
    ----------
    model : LagrangianModel
    format : str
        One of the formats above.
    path : path, optional
        File to write. For MATLAB and for an FMU, it also gives the name of the function or model, which is
        ``leastaction_model`` without a path.

    Returns
    -------
    str or bytes
        The content: text, and bytes for an FMU.

    Raises
    ------
    InputError
        If there is no such format, the file cannot be written or, for MATLAB, has a name that is not a valid
        function; for an FMU, if there is no C compiler; for MJCF and URDF, if the law is not a chain of
        links.

    Examples
    --------
    >>> from leastaction.model.model import LagrangianModel, ModelTerm
    >>> spring = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -2.0)])
    >>> print(export(spring, "sympy"))
    # Written by leastaction.
    import sympy
    <BLANKLINE>
    x, x_dot = sympy.symbols("x x_dot", real=True)
    lagrangian = -2.0*x**2 + 0.5*x_dot**2
    dissipation_function = sympy.Integer(0)
    <BLANKLINE>
    >>> namespace = {}
    >>> exec(export(spring, "python"), namespace)
    >>> namespace["acceleration"]([1.0], [0.0], [3.0])
    [-1.0]
    """
    if not isinstance(model, LagrangianModel):
        raise InputError(f"model is of type {type(model).__name__}; expected a LagrangianModel")
    check_format(format)
    file = None if path is None else check_path(path).name
    if format in _PLAIN:
        content = _PLAIN[format](model)
    elif format == "matlab":
        content = matlab.write(model, file)
    else:
        content = fmu.write(model, version=int(format[-1]), file=file)
    if path is not None:
        write_bytes(path, content if isinstance(content, bytes) else content.encode("utf-8"))
    return content
