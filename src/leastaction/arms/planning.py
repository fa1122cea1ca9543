"""Motions of least uncertainty within limits: the objective of `leastaction.experiment.excite`.

Every joint moves along a Fourier series that starts and ends at rest. The objective is the log volume

    -log det(YᵀWY + P) / 2,

with the columns Y of the base parameters, the weights W of the torques, and weak priors P. Its gradient needs
the derivatives of the columns with respect to each coordinate, velocity and acceleration; their number does
not depend on the number of coefficients. Limits enter as penalties. The final motion is scaled down until it
keeps all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize

from leastaction.arms.base import BaseParameters, find_base, inertial_prior
from leastaction.arms.collisions import Collisions
from leastaction.data.trajectories import Trajectory
from leastaction.errors import InputError
from leastaction.library.tree import KinematicTree
from leastaction.mechanics import Points
from leastaction.mechanics.arm_columns import ArmColumns
from leastaction.mechanics.arm_terms import JointScales, parameter_terms
from leastaction.mechanics.rigid_bodies import Motion, inverse_dynamics

__all__ = ["Bounds", "Excitation", "Limits", "Plan", "Series", "positive"]

_ACTING = ("rotor", "viscous", "dry", "offset")
_UNIT = 1.0  # prior of friction and constant torques, in SI units
_ROTOR = 0.3  # kg m², prior of a rotor
_MASS, _SIZE = 3.0, 0.15  # kg and m, assumed for a link without inertia in the tree
_SLOW = 0.02  # of the greatest speed, below which dry friction reverses
_SAMPLES = 6  # in a period of the fastest wave, along which the volume is computed
_FINE = 8  # times as many samples for the check of limits
_ITERATIONS = 40  # for each weight of the penalties
_MARGIN = 0.03  # of a limit, kept as a reserve
_NEAR = 0.1  # m, of which a lack of distance is a share
_STEP = 1e-6
_UNSEEN = 0.5  # of its prior: if the error of a parameter is larger, the motion does not determine it
_SMALLEST = 0.02  # smallest useful scale of a motion


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of a motion; None: no limit.

    Attributes
    ----------
    angle : (2, n_dof) array_like
        Lowest and highest coordinate of each joint, in rad or m.
    speed, acceleration, torque : (n_dof,) array_like or number
        Greatest absolute values. Torques are computed from the inertias of the tree, without friction.
    inside : (2, 3) array_like
        Corners of a box in the frame of the base, in m, in which the tool must stay.
    outside : sequence of (2, 3) array_like
        Boxes that neither the tool nor the origin of any link may enter.
    tool : (3,) array_like
        A point in the frame of the last link, in m.
    collisions : Collisions, optional
        Links that must not meet.
    """

    angle: ArrayLike
    speed: ArrayLike
    acceleration: ArrayLike | None = None
    torque: ArrayLike | None = None
    inside: ArrayLike | None = None
    outside: Sequence[ArrayLike] = ()
    tool: ArrayLike = (0.0, 0.0, 0.0)
    collisions: Collisions | None = None

    @classmethod
    def of_tree(cls, tree: KinematicTree, **others: Any) -> Limits:
        """The limits in the file of the tree, and others.

        Raises
        ------
        InputError
            If the file states no limits of angle or speed.
        """
        given = dict(others)
        lower, upper, speed, torque = tree.limits.T
        given.setdefault("angle", np.stack([lower, upper]))
        given.setdefault("speed", speed)
        for name in ("angle", "speed"):
            if not np.isfinite(np.asarray(given[name], dtype=float)).all():
                raise InputError(
                    f"the tree states no limits of {name} for every joint; give Limits({name}=...)"
                )
        if np.isfinite(torque).all() and not np.isnan(tree.inertias).any():
            given.setdefault("torque", torque)
        return cls(**given)


@dataclass(frozen=True, eq=False)
class Excitation:
    """A motion for an experiment, and the errors to expect from it.

    Attributes
    ----------
    tree : KinematicTree
    t : (n_times,) array
        In s.
    q, qdot, qddot : (n_times, n_dof) arrays
    base : BaseParameters
        Combinations of parameters that torques depend on.
    errors, priors : (n_base,) arrays
        Expected standard error of each base parameter after the experiment, and its prior standard deviation.
    condition, log_volume : tuple of two floats
        Before and after the optimisation: condition number of the information, each parameter in units of its
        prior, and logarithm of the volume of the region of uncertainty. Before the optimisation, the motion
        is the start, as large as the limits allow, or unscaled if its middle breaks one.
    """

    tree: KinematicTree
    t: np.ndarray
    q: np.ndarray
    qdot: np.ndarray
    qddot: np.ndarray
    base: BaseParameters
    errors: np.ndarray
    priors: np.ndarray
    condition: tuple[float, float]
    log_volume: tuple[float, float]

    @property
    def unseen(self) -> tuple[str, ...]:
        """Base parameters that this motion does not determine: errors above half of their priors."""
        rows = np.flatnonzero(self.errors > _UNSEEN * self.priors).tolist()
        return tuple(self.base.text(row) for row in rows)

    @cached_property
    def trajectory(self) -> Trajectory:
        """The motion; ``la.write_csv`` writes it."""
        return Trajectory(self.t, self.q, coordinates=self.tree.coordinates, velocities=self.qdot)

    def __str__(self) -> str:
        (before, after), (wide, narrow) = self.condition, self.log_volume
        lines = [
            f"{self.t[-1] - self.t[0]:.4g} s, {len(self.tree)} joints; condition {before:.3g} -> "
            f"{after:.3g}, log volume {wide:.1f} -> {narrow:.1f}",
            f"{len(self.errors) - len(self.unseen)} of {len(self.errors)} base parameters are shown",
        ]
        for text in self.unseen:
            lines.append(f"not shown: {text}; allow faster or wider motion of the joints that carry it")
        return "\n".join(lines)


class Bounds(NamedTuple):
    """Limits as arrays; infinite where there are none."""

    angle: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray
    inside: np.ndarray | None
    outside: list[np.ndarray]
    tool: np.ndarray
    collisions: Collisions | None

    @classmethod
    def of(cls, limits: Limits, tree: KinematicTree) -> Bounds:
        """Checked limits of a tree."""
        n = len(tree)
        angle = _array(limits.angle, (2, n), "angle")
        if not (angle[0] < angle[1]).all():
            raise InputError("the lowest angle of a joint is not below its highest; give (lowest, highest)")
        sizes = [
            np.full(n, np.inf) if value is None else positive(value, n, name)
            for name, value in (
                ("speed", limits.speed),
                ("acceleration", limits.acceleration),
                ("torque", limits.torque),
            )
        ]
        if np.isfinite(sizes[2]).any() and np.isnan(tree.inertias).any():
            raise InputError(
                "limits of torque need the inertias of all links; give tree.with_inertias(...), or limits "
                "of acceleration instead"
            )
        boxes = [_array(box, (2, 3), "a box") for box in limits.outside]
        inside = None if limits.inside is None else _array(limits.inside, (2, 3), "inside")
        speed, acceleration, torque = sizes
        tool = _array(limits.tool, (3,), "tool")
        return cls(angle, speed, acceleration, torque, inside, boxes, tool, limits.collisions)


class Series:
    """Fourier series of one period that start and end at rest; the first function is constant."""

    def __init__(self, period: float, harmonics: int) -> None:
        self.period = period
        self.frequencies: np.ndarray = 2.0 * np.pi / period * np.arange(1, harmonics + 1)
        at_rest = np.stack([self._waves(np.zeros(1), nu)[:, 0] for nu in (1, 2)])
        scaled = at_rest / np.linalg.norm(at_rest, axis=1, keepdims=True)
        # at rest at both ends
        self.mix: np.ndarray = np.linalg.qr(scaled.T, mode="complete")[0][:, len(scaled) :]
        self.size: int = 1 + len(self.mix.T)

    def _waves(self, t: np.ndarray, nu: int) -> np.ndarray:
        """(2 n_harmonics, n_times) derivatives of waves of unit speed."""
        angle = self.frequencies[:, None] * t + nu * np.pi / 2.0
        return np.concatenate([np.sin(angle), np.cos(angle)]) * np.tile(self.frequencies, 2)[:, None] ** (
            nu - 1
        )

    def functions(self, t: np.ndarray) -> np.ndarray:
        """(3, size, n_times) and their derivatives."""
        first = [np.full((1, t.size), float(nu == 0)) for nu in range(3)]
        waves = [self.mix.T @ self._waves(t, nu) for nu in range(3)]
        return np.stack([np.concatenate(pair) for pair in zip(first, waves, strict=True)])

    def states(self, coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
        """(3, n_times, n_dof)."""
        return np.einsum("vkt,jk->vtj", self.functions(t), coefficients)

    def grid(self, fineness: int = 1) -> np.ndarray:
        """Times of one period."""
        count = _SAMPLES * fineness * len(self.frequencies)
        return np.arange(count) * (self.period / count)


@dataclass(frozen=True, eq=False)
class Plan:
    """Volume and penalties of a motion, with gradients."""

    tree: KinematicTree
    bounds: Bounds
    series: Series
    base: BaseParameters
    columns: ArmColumns
    priors: np.ndarray
    weights: np.ndarray
    times: np.ndarray = field(repr=False)
    functions: np.ndarray = field(repr=False)

    @classmethod
    def of(
        cls, tree: KinematicTree, bounds: Bounds, series: Series, noise: np.ndarray, n_samples: float
    ) -> Plan:
        """The plan for torques with given noise and number of samples."""
        speed = bounds.speed
        scales = JointScales(_SLOW * speed, speed, np.zeros(len(tree)))
        terms = parameter_terms(tree, _ACTING, scales)
        base = find_base(tree, terms)
        members = [terms[k] for k in base.members]
        _, spreads = inertial_prior(tree, 1.0)
        ball = _MASS * np.array([1.0, *[_SIZE] * 3, *[_SIZE**2] * 6])
        spreads = np.where(np.isfinite(spreads), spreads, ball)
        acting = {"rotor": _ROTOR}
        priors = [
            float(spreads[t.place, t.component]) if t.kind == "inertia" else acting.get(t.kind, _UNIT)
            for t in members
        ]
        times = series.grid()
        weights = n_samples / times.size / noise**2
        columns = ArmColumns(tree, members)
        return cls(
            tree, bounds, series, base, columns, np.array(priors), weights, times, series.functions(times)
        )

    def start(self, rng: np.random.Generator) -> np.ndarray:
        """(n_dof, size) coefficients: random waves about the middle of the angles."""
        low, high = self.bounds.angle
        out = rng.normal(size=(len(self.tree), self.series.size))
        out[:, 0] = (low + high) / 2.0
        q, qdot, _ = self.series.states(out, self.times)
        room = np.minimum(
            0.5 * (high - low) / 2.0 / np.abs(q - out[:, 0]).max(axis=0),
            0.5 * self.bounds.speed / np.abs(qdot).max(axis=0),
        )
        out[:, 1:] *= room[:, None]
        return out

    def information(self, coefficients: np.ndarray) -> np.ndarray:
        """(n_base, n_base), each parameter in units of its prior."""
        columns = self._design(np.einsum("vkt,jk->vtj", self.functions, coefficients))
        return np.einsum("ait,i,bit->ab", columns, self.weights, columns, optimize=True)

    def _design(self, states: np.ndarray) -> np.ndarray:
        return self.priors[:, None, None] * self.columns.strong(Points(*states))

    def improved(self, coefficients: np.ndarray, weight: float) -> np.ndarray:
        """The motion after some steps with penalties of this weight."""
        done = minimize(
            lambda x: self._value(x.reshape(coefficients.shape), weight),
            coefficients.ravel(),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": _ITERATIONS, "maxcor": 20},
        )
        return done.x.reshape(coefficients.shape)

    def _value(self, coefficients: np.ndarray, weight: float) -> tuple[float, np.ndarray]:
        """Log volume with penalties, and its gradient in the coefficients."""
        n, count = len(self.tree), self.times.size
        states = np.einsum("vkt,jk->vtj", self.functions, coefficients)
        moved = np.tile(states[:, None], (1, 3 * n + 1, 1, 1))  # (nu, change, time, joint)
        steps = np.array([_STEP, _STEP, 100.0 * _STEP])
        for nu in range(3):
            for j in range(n):
                moved[nu, 1 + nu * n + j, :, j] += steps[nu]
        flat = moved.reshape(3, -1, n)
        columns = self._design(flat).reshape(len(self.priors), n, 3 * n + 1, count)
        here = columns[:, :, 0]
        gram: np.ndarray = np.eye(len(here))
        gram = gram + np.einsum("ait,i,bit->ab", here, self.weights, here, optimize=True)
        solved = np.einsum("ab,bit,i->ait", np.linalg.inv(gram), here, self.weights, optimize=True)
        over = self._excess(flat).reshape(-1, 3 * n + 1, count)
        penalty = weight * float(np.sum(over[:, 0] ** 2)) / count
        slopes = np.repeat(steps, n)
        rise = -np.einsum("ait,aist->st", solved, columns[:, :, 1:] - here[:, :, None], optimize=True)
        pushed = np.einsum("ct,cst->st", over[:, 0], over[:, 1:] - over[:, :1])
        gradient = (rise + 2.0 * weight / count * pushed) / slopes[:, None]
        by_state = gradient.reshape(3, n, count)
        if self.bounds.collisions is not None:
            near, slope = self.bounds.collisions.excess(states[0], _MARGIN * _NEAR)
            penalty += weight * float(np.sum(near**2)) / count / _NEAR**2
            by_state[0] += 2.0 * weight / count / _NEAR**2 * np.einsum("pt,pjt->jt", near, slope)
        value = -0.5 * float(np.linalg.slogdet(gram)[1]) + penalty
        return value, np.einsum("vjt,vkt->jk", by_state, self.functions).ravel()

    def _excess(self, states: np.ndarray, margin: float = _MARGIN) -> np.ndarray:
        """(n_limits, n_times) relative excess over each limit."""
        q, qdot, qddot = states
        low, high = self.bounds.angle
        shares = [np.abs(2.0 * q - low - high) / (high - low), np.abs(qdot) / self.bounds.speed]
        shares.append(np.abs(qddot) / self.bounds.acceleration)
        motion = Motion.at(self.tree, q, qdot, qddot)
        if np.isfinite(self.bounds.torque).any():
            torques = inverse_dynamics(motion, self.tree.inertias).T
            shares.append(np.abs(torques) / self.bounds.torque)
        rows = [part.T - (1.0 - margin) for part in shares]
        tool = motion.origins[-1] + np.einsum("pij,j->pi", motion.rotations[-1], self.bounds.tool)
        if self.bounds.inside is not None:
            corner, far = self.bounds.inside
            rows.append(np.abs(2.0 * tool - corner - far).T / (far - corner)[:, None] - (1.0 - margin))
        for corner, far in self.bounds.outside:
            for point in (tool, *motion.origins):
                # inside where all three shares are below one
                share = np.abs(2.0 * point - corner - far) / (far - corner)
                rows.append((1.0 + margin - share.max(axis=1))[None])
        return np.maximum(np.concatenate(rows), 0.0)

    def shrunk(self, coefficients: np.ndarray) -> np.ndarray | None:
        """The motion, scaled about its middle until it keeps the limits; None if even small ones fail."""
        functions = self.series.functions(self.series.grid(_FINE))

        def fits(share: float) -> bool:
            states = np.einsum("vkt,jk->vtj", functions, _scaled(coefficients, share))
            return not (self._excess(states, margin=0.0).any() or self._collides(states[0]))

        share = _largest(fits)
        return None if share is None else _scaled(coefficients, share)

    def _collides(self, q: np.ndarray) -> bool:
        check = self.bounds.collisions
        return check is not None and bool((check.distances(q) < check.clearance).any())


def _scaled(coefficients: np.ndarray, share: float) -> np.ndarray:
    return np.concatenate([coefficients[:, :1], share * coefficients[:, 1:]], axis=1)


def _largest(fits: Callable[[float], bool]) -> float | None:
    """The largest share up to one that fits, to within a thousandth."""
    if fits(1.0):
        return 1.0
    low, high = 0.0, 1.0
    while high - low > 1e-3:
        middle = (low + high) / 2.0
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low if low > _SMALLEST else None


def _array(values: ArrayLike, shape: tuple[int, ...], name: str) -> np.ndarray:
    try:
        out = np.broadcast_to(np.asarray(values, dtype=float), shape)
    except (TypeError, ValueError):
        raise InputError(f"{name} does not have the shape {shape}; give one number for each") from None
    if not np.isfinite(out).all():
        raise InputError(f"{name} holds a value that is not finite; give numbers")
    return out


def positive(values: ArrayLike, n_dof: int, name: str) -> np.ndarray:
    """(n_dof,) numbers above zero."""
    out = _array(values, (n_dof,), name)
    if not (out > 0.0).all():
        raise InputError(f"{name} must be positive for every joint; {out.min():g} is not")
    return out
