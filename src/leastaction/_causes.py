"""What the residual of the equations looks like: friction, a late force, a wrong known coefficient.

The residual r of a fit is regressed on the signature of every cause, after both have been freed of what the
terms of the model could take up.  A signature that takes a large share of Σ w_i ∫ r_i² names the cause.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leastaction._euler_lagrange import Points
from leastaction._fit.workspace import StructureFit, Workspace

__all__ = ["Cause", "likely_cause"]

_SHARE = 0.3  # of the residual's sum of squares
_NULL = 1e-6


@dataclass(frozen=True)
class Cause:
    """A sentence, and the share of the residual that it explains."""

    text: str
    share: float


def likely_cause(workspace: Workspace, structure: StructureFit) -> Cause | None:
    """The cause that explains most of the residual; None if none explains much of it."""
    residual, members, states = _residual(workspace, structure)
    basis, _ = np.linalg.qr(members.T)
    total = float(residual @ residual)
    best: Cause | None = None
    for text, signature in _signatures(workspace, structure, states):
        column = signature.ravel()
        norm = float(np.linalg.norm(column))
        column = column - basis @ (basis.T @ column)
        free = float(column @ column)
        if free <= _NULL * norm**2:  # the model's own terms can imitate it
            continue
        amount = float(column @ residual) / free
        share = amount**2 * free / total
        if share > max(_SHARE, best.share if best else 0.0):
            said = text(amount)
            best = Cause(said, share) if said else best
    return best


def _residual(workspace: Workspace, structure: StructureFit):
    """Residual of all equations, (n_dof · n_points,), the free members' columns, and the states."""
    root = np.sqrt(structure.fit.weights.physics)[:, None]
    q, qdot, qddot = (s[:, 0] for s in workspace.grid.at_quadrature(structure.fit.control_points))
    strong = workspace.columns.strong(Points(q, qdot, qddot))
    residual = np.tensordot(structure.coefficients, strong, 1)
    if workspace.forces is not None:
        residual -= workspace.forces[:, 0].T
    members = (strong[list(structure.members)] * root).reshape(len(structure.members), -1)
    return (root * residual).ravel(), members, (q, qdot, strong)


def _signatures(workspace: Workspace, structure: StructureFit, states):
    """(text of the amount, weighted residual that a unit of the cause leaves), cause by cause."""
    q, qdot, strong = states
    root = np.sqrt(structure.fit.weights.physics)[:, None]
    names, n = workspace.trajectories.coordinates, q.shape[1]

    def only(i: int, values: np.ndarray) -> np.ndarray:
        out = np.zeros((n, len(values)))
        out[i] = values
        return root * out

    for i, name in enumerate(names):
        rate = qdot[:, i]
        soft = np.tanh(rate / max(0.02 * float(np.sqrt(np.mean(rate**2))), 1e-300))
        yield _friction_text(f"viscous friction of {name}", f"{name}_dot**2"), only(i, rate)
        yield _friction_text(f"dry friction of {name}", f"abs({name}_dot)"), only(i, soft)
        for j in range(i):
            text = f"viscous friction between {names[j]} and {name}", f"({name}_dot-{names[j]}_dot)**2"
            yield _friction_text(*text), only(i, rate - qdot[:, j]) - only(j, rate - qdot[:, j])
    known = np.flatnonzero(~np.isnan(workspace.known))
    if workspace.forces is not None:
        yield from _force_signatures(workspace, root, bool(known.size))
    if workspace.forces is not None or known.size > 1:
        for k in known:
            yield _known_text(workspace, int(k)), root * strong[k]


def _force_signatures(workspace: Workspace, root: np.ndarray, scaled: bool):
    forces = workspace.forces[:, 0].T  # type: ignore[index]
    names = workspace.trajectories.coordinates
    rates = np.empty_like(forces)
    for k, trajectory in enumerate(workspace.trajectories):
        own = workspace.grid.owner == k
        points, step = workspace.grid.points[own, 0], 0.5 * float(np.median(np.diff(trajectory.t)))
        begin, end = points - step, points + step
        rates[:, own] = ((workspace.force_at(k, end) - workspace.force_at(k, begin)) / (2.0 * step)).T
    yield _delay_text, root * rates
    if scaled:
        yield (
            (lambda a: f"the forces seem to be {1.0 + a:.2g} times those given: check their units"),
            root * forces,
        )
    for i in range(len(forces)):
        for j in range(i):
            swap = np.zeros_like(forces)
            swap[i], swap[j] = forces[j] - forces[i], forces[i] - forces[j]
            text = f"the forces on {names[j]} and {names[i]} seem to be swapped"
            yield (lambda a, text=text: text if a > 0.5 else ""), root * swap


def _friction_text(what: str, term: str):
    # friction adds −c q̇ to the motion; its absence leaves the residual −c q̇
    return lambda amount: (
        f"{what} seems to be missing: give {term} as a candidate for dissipation"
        if amount < 0.0
        else f"energy is fed in as by a negative {what}: check the sign of forces and known coefficients"
    )


def _delay_text(amount: float) -> str:
    when = "later" if amount < 0.0 else "earlier"
    return f"the forces seem to act {1e3 * abs(amount):.2g} ms {when} than recorded: check the clocks"


def _known_text(workspace: Workspace, k: int):
    term, value = workspace.columns.terms[k].text, float(workspace.known[k])
    return lambda amount: (
        f"the known coefficient of {term} may be wrong: {value - amount:.3g} would fit better than "
        f"{value:.3g}"
    )
