"""How much an effect matters: its share of the forces, and of what the equations leave unexplained.

On a machine that obeys its law to some tenths of a per cent, long recordings show effects far below that:
significant, and of no consequence.  They are worth a note, not a doubt.  Of terms whose forces cancel, the
opposite holds: each is large, and together they do little.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.estimation.fit import Fit
from leastaction.findings import Finding, find
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points

__all__ = ["Effects", "compared_accelerations", "gain_of_terms", "is_minor", "signs_of_imitation"]

_STATES = 2000  # along the motion, at which an effect is computed
_COMPARED = 400  # along the motion, at which accelerations are compared
_SERIES = 3  # powers of a coordinate that make a series


def is_minor(fit: Fit, gain: float) -> bool:
    """Whether what lowers −2 log likelihood by ``gain`` explains a small part of the equation error."""
    return gain < fit.relevant_gain(DIAGNOSIS.part_of_error)


def gain_of_terms(fit: Fit, members: Collection[int]) -> float:
    """By how much terms lower −2 log likelihood, on the quadratic model: their squared distance from zero."""
    at = [k for k, member in enumerate(fit.structure) if member in members]
    covariance = fit.covariance[np.ix_(at, at)]
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    z = fit.estimates[at] / scale
    return float(z @ np.linalg.lstsq(covariance / np.outer(scale, scale), z, rcond=None)[0])


def compared_accelerations(fit: Fit) -> tuple[Points, np.ndarray]:
    """States along the motion at which laws are compared, and the size of q̈ there, (n_dof,), never zero."""
    points, n = fit.points(_COMPARED), fit.problem.candidates.n_dof
    size = np.sqrt(np.mean(np.stack(points.columns[2 * n : 3 * n]) ** 2, axis=1))
    return points, np.maximum(size, 1e-300)


@dataclass(frozen=True, eq=False)
class Effects:
    """What the forces of each equation amount to, and how much of them is unexplained.

    Attributes
    ----------
    fit : Fit
    size : (n_dof,) array
        Root mean square of the terms of each equation; NaN where a coordinate has none.
    left : (n_dof,) array
        Equation error relative to them.
    """

    fit: Fit
    size: np.ndarray
    left: np.ndarray

    def of_force(self, rms: np.ndarray) -> float:
        """Largest share of a generalised force with these root mean squares in an equation."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return float(np.nan_to_num(rms / self.size, nan=0.0, posinf=np.inf).max())

    def of_terms(self, columns: EulerLagrange, coefficients: np.ndarray) -> float:
        """Largest share of a sum of terms."""
        with np.errstate(over="ignore", invalid="ignore"):
            push = np.tensordot(coefficients, columns.strong(self.fit.points(_STATES)), 1)
            return self.of_force(np.sqrt(np.square(push).mean(axis=1)))

    def minor(self, members: Sequence[int]) -> bool:
        """Whether terms of the structure explain little of what is unexplained, and are smaller than that.

        Their size, too: where the scale of L is open, no term changes the likelihood by much.
        """
        columns = self.fit.problem.candidates.subset(list(members))
        share = self.of_terms(columns, self.fit.coefficients[list(members)])
        return share <= float(self.left.max()) and is_minor(self.fit, gain_of_terms(self.fit, members))

    def slight(self, share: float, gain: float) -> bool:
        """Whether an effect is too small to matter, or explains little of what is unexplained."""
        return share <= DIAGNOSIS.slight or is_minor(self.fit, gain)


def signs_of_imitation(fit: Fit) -> list[Finding]:
    """What imitations by polynomials often have: terms that cancel, and powers up to the highest offered."""
    return [*_cancelling(fit), *_highest_powers(fit)] if not fit.problem.candidates.grouped else []


def _cancelling(fit: Fit) -> Iterator[Finding]:
    """Potentials whose forces nearly cancel along the motion, so that hardly any of them is left.

    Only terms of the same coordinates are compared: those of a stiff spring between two bodies, x², x y and
    y², cancel in a true law.
    """
    problem, points = fit.problem, fit.points(_STATES)
    alike: dict[frozenset[str], list[int]] = {}
    for k in (*fit.structure, *np.flatnonzero(problem.is_known).tolist()):
        variables = frozenset(str(symbol) for symbol in problem.terms[k].expr.free_symbols)
        if problem.terms[k].kind == "lagrangian" and variables <= {*problem.coordinates}:
            alike.setdefault(variables, []).append(k)
    for members in alike.values():
        columns = problem.candidates.subset(members)
        forces = fit.coefficients[members, None, None] * columns.strong(points)
        swings, whole = forces.std(axis=2), forces.sum(axis=0).std(axis=1)
        factors = swings.max(axis=0) / np.maximum(whole, 1e-300)
        i = int(np.argmax(factors))
        if factors[i] > DIAGNOSIS.cancelling:
            large = [k for k, swing in zip(members, swings[:, i], strict=True) if swing > whole[i]]
            yield find("cancelling-terms", [problem.terms[k].offered for k in large], factor=factors[i])


def _highest_powers(fit: Fit) -> Iterator[Finding]:
    """Powers that end a series of a coordinate because no higher one was offered."""
    terms = fit.problem.terms
    powers = [(k, *term.expr.as_base_exp()) for k, term in enumerate(terms) if term.kind == "lagrangian"]
    for name in fit.problem.coordinates:
        offered = {float(n): k for k, base, n in powers if str(base) == name and not n.free_symbols}
        used = [n for n, k in offered.items() if k in fit.structure]
        if len(used) >= _SERIES and max(used) == max(offered):
            yield find("highest-power", [terms[offered[max(used)]].offered])
