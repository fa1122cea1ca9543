"""A model as a system of the python-control package; needs ``pip install 'leastaction[control]'``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from leastaction.errors import InputError, MissingPackageError
from leastaction.identifiers import quoted
from leastaction.model.checks import checked_start
from leastaction.model.model import LagrangianModel

if TYPE_CHECKING:
    import control

__all__ = ["linearize", "state_space"]


def state_space(
    model: LagrangianModel, actuated: Sequence[str] | None = None, name: str | None = None
) -> control.NonlinearIOSystem:
    """Nonlinear system ẋ = (q̇, q̈) with the state x = (q, q̇).

    Parameters
    ----------
    model : LagrangianModel
    actuated : sequence of str, optional
        Coordinates whose generalised force is an input; by default all of them.
    name : str, optional
        Name of the system.

    Returns
    -------
    control.NonlinearIOSystem
        Inputs ``<coordinate>_force``; states and outputs ``<coordinate>`` ... and ``<coordinate>_dot`` ....

    Raises
    ------
    InputError
        If python-control is not installed, or an actuated coordinate is not in the model.

    Examples
    --------
    >>> from leastaction.model.model import LagrangianModel, ModelTerm
    >>> spring = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -2.0)])
    >>> system = state_space(spring)
    >>> system.input_labels, system.output_labels
    (['x_force'], ['x', 'x_dot'])
    >>> system.dynamics(0.0, [1.0, 0.0], [3.0]).tolist()
    [0.0, -1.0]
    """
    control, columns = _prepared(model, actuated)
    n, mechanics = model.n_dof, model.mechanics

    def rates(t, x, u, params):
        forces = np.zeros(n)
        forces[columns] = u
        q, qdot = np.split(np.asarray(x, dtype=float), 2)
        return np.concatenate([qdot, mechanics.acceleration(q, qdot, forces, t)])

    return control.NonlinearIOSystem(rates, lambda t, x, u, params: x, name=name, **_labels(model, columns))


def linearize(
    model: LagrangianModel,
    q: ArrayLike,
    qdot: ArrayLike | None = None,
    forces: ArrayLike | None = None,
    actuated: Sequence[str] | None = None,
    name: str | None = None,
    t: float | None = None,
) -> control.StateSpace:
    r"""Linear system of small deviations from a state, from exact derivatives.

    With M q̈ = r + f, a deviation δ of q or q̇ changes the acceleration by
    M⁻¹ (∂r/∂x − (∂M/∂x) q̈) δ, and one of the forces by M⁻¹ δf.

    Parameters
    ----------
    model : LagrangianModel
    q : array_like, shape (n_dof,)
        State at which to linearise, usually an equilibrium.
    qdot, forces : array_like, shape (n_dof,), optional
        Zero by default. Include a force that holds the system in place.
    actuated, name
        As for `state_space`.
    t : float, optional
        Instant in seconds, for a law that depends on time.

    Returns
    -------
    control.StateSpace
        With the inputs, states and outputs of `state_space`.

    Raises
    ------
    InputError
        As for `state_space`; if shapes are wrong; if the mass matrix is singular there or a function is not
        defined.

    Examples
    --------
    >>> from leastaction.model.model import LagrangianModel, ModelTerm
    >>> pendulum = LagrangianModel("theta", [ModelTerm("theta_dot**2", 0.5), ModelTerm("cos(theta)", 9.81)])
    >>> linearize(pendulum, [np.pi]).A.round(9).tolist()
    [[0.0, 1.0], [9.81, 0.0]]
    """
    control, columns = _prepared(model, actuated)
    n = model.n_dof
    given = {"q": q, "qdot": qdot, "forces": forces}
    state = [checked_start(model.coordinates, np.zeros(n) if x is None else x, k) for k, x in given.items()]
    mass = model.mass_matrix(state[0], state[1], t)
    qddot = model.acceleration(*state, t=t)
    slopes = model.mechanics.slopes(state[0], state[1], qddot, t)
    if not (np.isfinite(qddot).all() and np.isfinite(slopes).all()):
        raise InputError(
            f"the equations cannot be linearised at q = {quoted(state[0].tolist())}: the mass matrix is "
            "singular or a function is not defined there; choose another state"
        )
    a = np.block([[np.zeros((n, n)), np.eye(n)], [np.linalg.solve(mass, slopes)]])
    b = np.concatenate([np.zeros((n, n)), np.linalg.inv(mass)])[:, columns]
    c, d = np.eye(2 * n), np.zeros((2 * n, len(columns)))
    return control.StateSpace(a, b, c, d, name=name, **_labels(model, columns))


def _prepared(model: LagrangianModel, actuated: Sequence[str] | None):
    """The package, and the places of the coordinates with an input; arguments are checked."""
    try:
        import control
    except ImportError:
        raise MissingPackageError("leastaction.control", "python-control", "control") from None
    if not isinstance(model, LagrangianModel):
        raise InputError(f"model is of type {type(model).__name__}; expected a LagrangianModel")
    names = model.coordinates if actuated is None else (actuated,) if isinstance(actuated, str) else actuated
    for name in names:
        if name not in model.coordinates:
            known = ", ".join(model.coordinates)
            raise InputError(f"actuated: {quoted(name)} is not a coordinate of the model; it has {known}")
    return control, [model.coordinates.index(name) for name in dict.fromkeys(names)]


def _labels(model: LagrangianModel, columns: list[int]) -> dict[str, list[str]]:
    states = [*model.coordinates, *(f"{c}_dot" for c in model.coordinates)]
    return {"inputs": [f"{model.coordinates[k]}_force" for k in columns], "states": states, "outputs": states}
