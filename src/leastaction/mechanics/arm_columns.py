"""Columns of a kinematic tree: inertial parameters of its links, and torques in its joints.

The equations of motion of an arm are linear in

* the ten inertial parameters of each link (:mod:`leastaction.mechanics.rigid_bodies`),
* the inertia of each rotor seen through its gear, as a mass on the joint's own acceleration,
* friction: viscous q̇, dry s(q̇), Stribeck s(q̇) exp(−(q̇/v_s)²), load-dependent |τ| s(q̇), quadratic q̇|q̇|,
* friction that differs between the directions of motion: |q̇|,
* springs q, and constant torques,
* the coefficients of expressions that the tree adds to L or to the dissipation function
  (:mod:`leastaction.mechanics.euler_lagrange`),

with s(v) = v/√(v² + ε²), a smoothed sign.  After a reversal, gears and seals yield before they slide. Dry
friction then reverses over a distance δ, z′ = (1 − z sgn q̇)/δ along the path (Dahl 1968, Aerospace
Corporation TOR-158), and depends on the motion, not on the state alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import sympy as sp

from leastaction.library.tree import INERTIAL, KinematicTree
from leastaction.mechanics import Points
from leastaction.mechanics.arm_terms import EXTRA, HISTORIES, ArmTerm
from leastaction.mechanics.euler_lagrange import EulerLagrange
from leastaction.mechanics.rigid_bodies import (
    Motion,
    inverse_dynamics,
    mass_columns,
    mass_matrix,
    regressor,
    slopes,
)

__all__ = [
    "Acting",
    "ArmColumns",
    "ArmParts",
    "dry_history",
    "entries",
    "presliding",
    "remembered",
    "smooth_sign",
]

_N = len(INERTIAL)
_FIRST = len(HISTORIES) + 1  # history of an expression


def presliding(q: np.ndarray, distance: float) -> np.ndarray:
    """(2, n_times): dry friction of Dahl along a motion q of one joint, and its derivative in log δ.

    dz = (1 − z sgn q̇) |dq| / δ sgn q̇ in units of full friction, exact between samples that move in one
    direction; it starts at zero.  Between two reversals, with the path p since the first of them,

        z = s + (z₀ − s) exp(−p/δ),    s = sgn q̇.
    """
    steps = np.diff(q)
    path = np.concatenate([[0.0], np.cumsum(np.abs(steps))]) / distance
    moving = np.flatnonzero(steps)
    turns = moving[np.flatnonzero(np.diff(np.sign(steps[moving]), prepend=0.0))].tolist()
    out, z, slope = np.zeros((2, q.size)), 0.0, 0.0
    for begin, end in pairwise([*turns, q.size - 1]):
        sign, way = float(np.sign(steps[begin])), path[begin + 1 : end + 1] - path[begin]
        stay = np.exp(-way)
        out[0, begin + 1 : end + 1] = sign + (z - sign) * stay
        out[1, begin + 1 : end + 1] = (slope + (z - sign) * way) * stay
        z, slope = out[:, end].tolist()
    return out


def remembered(q: np.ndarray, distance: float) -> np.ndarray:
    """(2, n_times): what is left of the friction with which a motion begins, and its derivative in log δ.

    It is exp(−path/δ).
    """
    path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q)))]) / distance
    left = np.exp(-path)
    return np.array([left, left * path])


def smooth_sign(v: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """s(v) = v/√(v² + ε²), and its derivatives in log ε and in v."""
    size = np.sqrt(v * v + width * width)
    share = (width / size) ** 2
    sign = v / size
    return sign, -sign * share, share / size


def dry_history(terms: Iterable[ArmTerm], q: np.ndarray, qdot: np.ndarray) -> np.ndarray:
    """(2, n_times, 1, n_dof): dry friction of each joint along a motion, as a history of `ArmColumns`.

    A motion that begins at some speed begins with the friction of that direction.
    """
    out = np.zeros((2, len(q), 1, q.shape[1]))
    for term in terms:
        if term.kind != "dry":
            continue
        i, way = term.place, term.distance
        out[:, :, 0, i] = smooth_sign(qdot[:, i], term.width)[:2]
        if way:
            out[:, :, 0, i] = presliding(q[:, i], way) + out[0, 0, 0, i] * remembered(q[:, i], way)
    return out


class _Local(NamedTuple):
    """A torque in one joint that depends on this joint alone, and its derivatives in q, q̇, q̈."""

    value: Any
    slope: tuple[Any, Any, Any]


def _local(term: ArmTerm, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> _Local:
    if term.kind == "rotor":
        return _Local(a, (0.0, 0.0, 1.0))
    if term.kind == "viscous":
        return _Local(v, (0.0, 1.0, 0.0))
    if term.kind == "spring":
        return _Local(q, (1.0, 0.0, 0.0))
    if term.kind == "offset":
        return _Local(np.ones_like(q), (0.0, 0.0, 0.0))
    width = term.width
    size = np.sqrt(v * v + width * width)
    sign, narrow, steep = smooth_sign(v, width)
    if term.kind == "turn":
        return _Local(narrow, (0.0, steep * (3.0 * sign * sign - 1.0), 0.0))
    if term.kind == "stribeck":
        fall = np.exp(-((v / term.speed) ** 2))
        return _Local(sign * fall, (0.0, fall * (steep - 2.0 * v / term.speed**2 * sign), 0.0))
    if term.kind == "quadratic":
        return _Local(v * size, (0.0, size + v * sign, 0.0))
    if term.kind == "asymmetric":
        return _Local(size, (0.0, sign, 0.0))
    return _Local(sign, (0.0, steep, 0.0))  # dry, and load before it is multiplied


class ArmColumns:
    """The columns of an arm; see :class:`leastaction.mechanics.Columns`.

    Parameters
    ----------
    tree : KinematicTree
    terms : sequence of ArmTerm
    reference : (n_links, 10) array, optional
        Inertial parameters from which the load of load-dependent friction is computed.
    prescribed : sequence of int
        Joints whose equations are not used.
    history : (n, n_intervals, n_quadrature, n_dof) array, optional
        Columns that depend on the motion, at the quadrature points, of the first n `HISTORIES`: dry friction
        and its derivative in log δ, see `presliding`, the changes of the torque with delays and gains, what
        is left of the friction at the start of a run, see `remembered`, and the number of the run. Without
        it, dry friction follows the sign of the velocity at once. Then the torques of each expression of the
        tree, which replace those that jump.
    """

    def __init__(
        self,
        tree: KinematicTree,
        terms: Sequence[ArmTerm],
        reference: np.ndarray | None = None,
        prescribed: Sequence[int] = (),
        history: np.ndarray | None = None,
    ) -> None:
        self.tree: KinematicTree = tree
        self.terms: tuple[ArmTerm, ...] = tuple(terms)
        self.reference: np.ndarray | None = reference
        self.prescribed: tuple[int, ...] = tuple(prescribed)
        self.history: np.ndarray | None = history
        self.coordinates: tuple[str, ...] = tree.coordinates
        self.n_dof: int = len(tree)

    def __len__(self) -> int:
        return len(self.terms)

    @cached_property
    def _inertial(self) -> tuple[list[int], list[int]]:
        """Which columns are inertial parameters, and which ones of all links in one row."""
        found = [(k, t.place * _N + t.component) for k, t in enumerate(self.terms) if t.kind == "inertia"]
        return [k for k, _ in found], [flat for _, flat in found]

    def parameters(self, coefficients: np.ndarray) -> np.ndarray:
        """(n_links, 10) inertial parameters."""
        out = np.zeros(self.n_dof * _N)
        columns, flat = self._inertial
        out[flat] = coefficients[columns]
        return out.reshape(self.n_dof, _N)

    def _others(self) -> list[tuple[int, ArmTerm]]:
        return [(k, term) for k, term in enumerate(self.terms) if term.kind not in ("inertia", *EXTRA)]

    @cached_property
    def _extra(self) -> tuple[list[int], EulerLagrange]:
        """Which columns are expressions, and these."""
        found = [k for k, term in enumerate(self.terms) if term.kind in EXTRA]
        expressions = [self.tree.extra[self.terms[k].place] for k in found]
        return found, EulerLagrange(expressions, self.coordinates)

    def _locals(self, points: Points) -> list[tuple[int, ArmTerm, _Local]]:
        n, columns = self.n_dof, points.columns
        found: list[tuple[int, ArmTerm, _Local]] = []
        for k, term in self._others():
            state = (columns[term.place + nu * n] for nu in range(3))
            local = _local(term, *state)
            if term.kind == "load":
                load = self._load(points)[term.place]
                local = _Local(local.value * load, (0.0, local.slope[1] * load, 0.0))
            elif term.kind in HISTORIES and self.history is not None:
                assert points.intervals is not None
                row = HISTORIES.index(term.kind)
                way = self.history[row, points.intervals, :, term.place].T.ravel()
                if term.kind == "start":
                    run = self.history[row + 1, points.intervals, :, term.place].T.ravel()
                    way = np.where(run == term.component, way, 0.0)
                local = _Local(way, (0.0, 0.0, 0.0))  # its slope is neglected, too
            found.append((k, term, local))
        return found

    def _jumps(self, points: Points) -> Iterator[tuple[int, np.ndarray]]:
        """The columns of expressions with a kink, such as |v|, in the history."""
        history = self.history
        if history is None:
            return
        for k in self._extra[0]:
            row, expression = _FIRST + self.terms[k].place, self.tree.extra[self.terms[k].place].expr
            if row < len(history) and expression.has(sp.Abs):
                assert points.intervals is not None
                yield k, history[row, points.intervals].T.reshape(self.n_dof, -1)

    def _load(self, points: Points) -> np.ndarray:
        """(n_dof, n_points) absolute torques of the reference; derivatives neglect their slope."""
        assert self.reference is not None
        reference = self.reference
        return points.kept(
            reference, lambda: np.abs(inverse_dynamics(Motion.of(self.tree, points), reference))
        )

    def strong(self, points: Points, select: Sequence[int] | None = None) -> np.ndarray:
        """(n_selected, n_dof, n_points)."""
        if select is not None:
            return self.subset(select).strong(points)
        out = np.zeros((len(self), self.n_dof, points.n_points))
        columns, flat = self._inertial
        if columns:
            motion = Motion.of(self.tree, points)
            every = regressor(motion).reshape(self.n_dof * _N, self.n_dof, -1)
            out[columns] = every[flat]
        for k, term, local in self._locals(points):
            out[k, term.place] = local.value
        extra, expressions = self._extra
        if extra:
            out[extra] = expressions.strong(points)
        for k, way in self._jumps(points):
            out[k] = way
        out[:, self.prescribed] = 0.0
        return out

    def jacobian(self, points: Points, coefficients: np.ndarray) -> dict[tuple[int, int, int], np.ndarray]:
        """(nu, i, j) → Σ_k λ_k ∂E_ik/∂q_j^{(nu)}."""
        out = slopes(Motion.of(self.tree, points), self.parameters(coefficients))
        for k, term, local in self._locals(points):
            for nu, slope in enumerate(local.slope):
                key = nu, term.place, term.place
                out[key] = out[key] + coefficients[k] * slope
        extra, expressions = self._extra
        for key, value in expressions.jacobian(points, coefficients[extra]).items():
            out[key] = out.get(key, 0.0) + value
        return {key: value for key, value in out.items() if key[1] not in self.prescribed}

    def mass_matrix(self, points: Points, coefficients: np.ndarray) -> np.ndarray:
        """(n_points, n_dof, n_dof)."""
        out = mass_matrix(Motion.of(self.tree, points), self.parameters(coefficients))
        for k, term in self._others():
            if term.kind == "rotor":
                out[:, term.place, term.place] += coefficients[k]
        extra, expressions = self._extra
        if extra:
            out += expressions.mass_matrix(points, coefficients[extra])
        out[:, self.prescribed] = out[:, :, self.prescribed] = 0.0
        out[:, self.prescribed, self.prescribed] = 1.0
        return out

    def masses(self, points: Points) -> tuple[list[int], np.ndarray]:
        """The columns with kinetic energy, and (n_points, n_of_them, n_dof, n_dof) mass matrices of each."""
        columns, flat = self._inertial
        each = mass_columns(Motion.of(self.tree, points))[:, flat]
        rotors = [(k, term.place) for k, term in enumerate(self.terms) if term.kind == "rotor"]
        more = np.zeros((len(each), len(rotors), self.n_dof, self.n_dof))
        for row, (_, place) in enumerate(rotors):
            more[:, row, place, place] = 1.0
        extra, expressions = self._extra
        moving, further = expressions.masses(points)
        out = np.concatenate([each, more, further], axis=1)
        out[:, :, self.prescribed] = out[:, :, :, self.prescribed] = 0.0
        return [*columns, *(k for k, _ in rotors), *(extra[k] for k in moving)], out

    def subset(self, select: Sequence[int]) -> ArmColumns:
        """Some of the columns."""
        return self.of([self.terms[k] for k in select])

    def of(self, terms: Sequence[ArmTerm]) -> ArmColumns:
        """Other terms for the same arm."""
        return ArmColumns(self.tree, terms, self.reference, self.prescribed, self.history)

    def within(self, intervals: slice) -> ArmColumns:
        """The columns for a part of a motion, given by its knot intervals."""
        part = None if self.history is None else self.history[:, intervals]
        return ArmColumns(self.tree, self.terms, self.reference, self.prescribed, part)


class Acting(NamedTuple):
    """What acts in one joint of an arm: kind, number of the joint, coefficient, ε and v_s."""

    kind: str
    joint: int
    value: float
    width: float
    speed: float


class ArmParts(NamedTuple):
    """What the torques of an arm consist of.

    Attributes
    ----------
    tree : KinematicTree
    inertial : (n_links, 10) array
        Inertial parameters, or base parameters in their place.
    local : sequence of Acting
    law, loss : sequence of Expr
        Torques of the terms that the tree adds to L and to the dissipation function, for each joint; in the
        symbols of `entries`.
    """

    tree: KinematicTree
    inertial: np.ndarray
    local: Sequence[Acting]
    law: Sequence[sp.Expr]
    loss: Sequence[sp.Expr]


def entries(array: str, n_dof: int) -> list[sp.Symbol]:
    """Symbols for the entries of an array, written as in code: ``q[0]``, ``q[1]``, …"""
    return [sp.Symbol(f"{array}[{k}]", real=True) for k in range(n_dof)]
