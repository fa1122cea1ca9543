r"""Recorded torques: delays, gains of motor currents, and friction of joints that rest when a run begins.

A value u recorded the time d after the torque τ acts, by a drive with the gain k (torque per unit of u), is

.. math:: u(t) = \tau(t - d) / k.

Delays and gains are estimated with the parameters.  The log is converted to torques with the present d and k.
A change of d adds −Δd dτ/dt to these torques, and a relative change of k adds −(Δk/k) τ.  Both columns use τ
as the model predicts it: noise in the recorded torque would bias the estimates towards zero.

If all torques are multiplied by one factor, so are all parameters.  Currents therefore determine only ratios
of gains, through links that act on several joints (Gautier & Briot 2014, Journal of Dynamic Systems,
Measurement, and Control 136:051025).  One gain must be known.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.stats import norm
from scipy.stats import t as t_distribution

from leastaction.arms.regression import Acting, Choice, Regression, Solution, reweighted
from leastaction.curve.bspline import SplineGrid
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import InputError
from leastaction.estimation.forces import forces_on
from leastaction.estimation.gauss_newton import symmetric_inverse
from leastaction.identifiers import quoted
from leastaction.library.tree import KinematicTree
from leastaction.mechanics.arm_columns import remembered
from leastaction.mechanics.arm_terms import ArmTerm

__all__ = ["Recording", "Signals", "bounded_starts", "idle_notes", "predicted", "starts"]

_FAR = 0.1  # of a sampling interval, or of a gain: after a larger step the columns are computed again
_LARGEST = 0.5  # largest relative change of a gain in one step
_CHANCE = 0.01  # probability that a delay is reported for an arm without any
_FARTHEST = 5.0  # sampling intervals, the largest change of a delay in one step
_REST = 0.02  # s at the beginning of a run, from which on a joint rests
_MOST_STARTS = 100  # joints that rest when a run begins, in all runs


@dataclass(frozen=True, eq=False)
class Recording:
    """How a log records torques.

    Attributes
    ----------
    gains : mapping of str to float, optional
        The log holds motor currents, or torques in other units: joint → torque per unit of the log, for the
        joints whose gain is known. At least one must be. The gains of the other joints are estimated. By
        default the log holds torques.
    delays : bool, optional
        Whether to estimate the delay of the recorded torque in each joint. By default, delays are estimated
        if their mean over the joints is significant.
    unmeasured : sequence of str
        Joints whose torque the log does not hold. Their motion is used, and what the log holds as their force
        is not. Parameters that act only in their equations, such as their friction, stay unknown.

    Examples
    --------
    A log of currents; the first motor gives 8.5 N m per ampere:

    >>> from leastaction import arms
    >>> arms.Recording(gains={"q1": 8.5}).gains
    {'q1': 8.5}
    """

    gains: Mapping[str, float] | None = None
    delays: bool | None = None
    unmeasured: Sequence[str] = ()

    def places(self, tree: KinematicTree) -> tuple[int, ...]:
        """Indices of the unmeasured joints.

        Raises
        ------
        InputError
            If a name is not a joint, or no torque is left.
        """
        for name in self.unmeasured:
            if name not in tree.coordinates:
                raise InputError(
                    f"unmeasured holds {quoted(name)}; expected joints of the tree: "
                    f"{', '.join(tree.coordinates)}"
                )
        if len(set(self.unmeasured)) == len(tree):
            raise InputError("no joint has a measured torque; leave at least one out of unmeasured")
        return tuple(i for i, name in enumerate(tree.coordinates) if name in self.unmeasured)


@dataclass(frozen=True, eq=False)
class Signals:
    """Estimated delays and gains of a log.

    Attributes
    ----------
    delays : (n_dof,) array
        In s.
    gains : (n_dof,) array
        Torque per unit of the log.
    late : bool
        Whether delays are estimated.
    unknown : tuple of int
        Joints whose gain is unknown.
    unmeasured : tuple of int
        Joints whose torque the log does not hold.
    errors : pair of (n_dof,) arrays, optional
        Standard errors of delays and gains, zero where they were given.
    """

    delays: np.ndarray
    gains: np.ndarray
    late: bool
    unknown: tuple[int, ...]
    unmeasured: tuple[int, ...] = ()
    errors: tuple[np.ndarray, np.ndarray] | None = None

    @classmethod
    def of(cls, tree: KinematicTree, recording: Recording) -> Signals:
        """Start values: no delay, and gains of one where they are unknown.

        Raises
        ------
        InputError
            If a gain belongs to no joint or to an unmeasured one, or is not a number; if none is given; or if
            an unmeasured joint is unknown.
        """
        n, late, gains = len(tree), recording.delays is not False, recording.gains
        none = recording.places(tree)
        if gains is None:
            return cls(np.zeros(n), np.ones(n), late, (), none)
        names = tree.coordinates
        for name, value in gains.items():
            if name not in names:
                raise InputError(
                    f"gains hold {quoted(name)}; expected joints of the tree: {', '.join(names)}"
                )
            if name in recording.unmeasured:
                raise InputError(f"gains and unmeasured both hold {quoted(name)}; leave it out of one")
            if not np.isfinite(value) or value == 0.0:
                raise InputError(f"the gain of {name} is {value}; give the torque per unit of the log")
        if not gains:
            raise InputError(
                "no gain is given, and currents determine only ratios of gains and parameters; give the "
                f"torque per ampere of one joint, e.g. gains={{{names[0]!r}: 10.0}}, or give 1.0, identify "
                "a known payload, and use the ratio of its mass to the mass found"
            )
        unknown = tuple(i for i, name in enumerate(names) if name not in gains and i not in none)
        known = np.array([gains.get(name, 1.0) for name in names], float)
        return cls(np.zeros(n), known, late, unknown, none)

    @property
    def open(self) -> list[tuple[int, str]]:
        """Joints with an unknown delay or gain, and which of the two."""
        late = [i for i in range(len(self.gains)) if self.late and i not in self.unmeasured]
        return [(i, "delay") for i in late] + [(i, "gain") for i in self.unknown]

    def terms(self, tree: KinematicTree) -> tuple[ArmTerm, ...]:
        """Columns of the remaining errors of what is `open`."""
        return tuple(ArmTerm(f"{kind}[{tree.coordinates[i]}]", kind, i) for i, kind in self.open)

    def torques(self, data: Trajectories) -> Trajectories:
        """The log with torques in place of recorded values."""
        if not self.delays.any() and (self.gains == 1.0).all():
            return data
        return Trajectories([self._torques(run) for run in data])

    def _torques(self, run: Trajectory) -> Trajectory:
        assert run.forces is not None
        curve = CubicSpline(run.t, run.forces)
        at = np.clip(run.t[:, None] + self.delays, run.t[0], run.t[-1])
        moved = np.stack([curve(times)[:, i] for i, times in enumerate(at.T)], axis=1)
        return run.changed(forces=self.gains * moved)

    def first_gains(self, regression: Regression) -> Signals:
        """Unknown gains by least squares with recorded values as columns; their noise biases them to zero."""
        if not self.unknown:
            return self
        n, members = len(self.gains), [*regression.fixed, *regression.always]
        total = regression.grams.sum(axis=0)
        m, size = len(members), len(members) + len(self.unknown) + 1
        local = np.zeros((n, size, size))
        for i in range(n):
            last = m + self.unknown.index(i) if i in self.unknown else size - 1
            sign = np.array([*np.ones(m), -1.0 if i in self.unknown else 1.0])
            part = total[i][np.ix_([*members, -1], [*members, -1])] * np.outer(sign, sign)
            local[i][np.ix_([*range(m), last], [*range(m), last])] = part
        gains = self.gains.copy()
        gains[list(self.unknown)] = reweighted(local, np.ones(n), 1e-300).values[m:]
        return replace(self, gains=gains)

    def changes(self, choice: Choice) -> np.ndarray:
        """(2, n_intervals, n_quadrature, n_dof) derivatives of the torques in delay and log gain."""
        regression = choice.regression
        tau = predicted(choice)
        out, stop = np.zeros((2, *tau.shape)), 0
        for k, space in enumerate(regression.grid.spaces):
            own = slice(stop, stop := stop + space.n_intervals)
            times = regression.grid.points_of(k).ravel()
            rate = CubicSpline(times, tau[own].reshape(times.size, -1))(times, 1)
            out[0, own] = -rate.reshape(tau[own].shape)
        out[1] = -tau
        return out

    def steps(self, choice: Choice, changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Least squares steps of what is `open`, estimated with the parameters, and standard errors."""
        regression = choice.regression
        whole = replace(regression, histories=np.concatenate([regression.histories, changes]))
        whole = replace(whole, grams=whole.summed())
        first = len(regression.histories)
        acting = [*choice.dry, *((i, first + int(kind == "gain")) for i, kind in self.open)]
        own = slice(len(choice.members) + len(choice.dry), None)
        solution = whole.solved(choice.members, acting)
        return solution.values[own], _standard_errors(whole, choice.members, acting, solution)[own]

    def common(self, steps: np.ndarray, errors: np.ndarray) -> bool:
        """Whether the mean delay of the joints is significant.

        Effects that the model lacks appear as delays of single joints, larger than their standard errors. The
        mean is therefore tested against the variance among the joints (DerSimonian & Laird 1986, Controlled
        Clinical Trials 7:177).
        """
        n = len(self.open) - len(self.unknown)
        delays, variance = steps[:n], errors[:n] ** 2
        weights = 1.0 / variance
        mean = weights @ delays / weights.sum()
        excess = float(weights @ (delays - mean) ** 2) - (n - 1)
        among = max(excess / max(float(weights.sum() - (weights**2).sum() / weights.sum()), 1e-300), 0.0)
        weights = 1.0 / (variance + (among if n > 1 else 0.0))
        ratio = float(weights @ delays) / np.sqrt(weights.sum())
        cut = t_distribution.isf(_CHANCE / 2.0, n - 1) if n > 1 else norm.isf(_CHANCE / 2.0)
        return bool(abs(ratio) > cut)

    def moved(self, steps: np.ndarray, interval: float) -> Signals:
        """The signals after a step, which is limited."""
        delays, gains = self.delays.copy(), self.gains.copy()
        for (i, kind), step in zip(self.open, steps.tolist(), strict=True):
            if kind == "gain":
                gains[i] *= 1.0 + float(np.clip(step, -_LARGEST, _LARGEST))
            else:
                delays[i] += float(np.clip(step, -_FARTHEST * interval, _FARTHEST * interval))
        return replace(self, delays=delays, gains=gains)

    def far(self, steps: Sequence[float] | np.ndarray, interval: float) -> bool:
        """Whether a step is too long for the columns, which are linear in it."""
        scale = np.array([1.0 if kind == "gain" else interval for _, kind in self.open])
        return bool(np.any(np.abs(steps) > _FAR * scale))

    def found(self, terms: Sequence[ArmTerm], coefficients: np.ndarray, covariance: np.ndarray) -> Signals:
        """The signals after the last, small step by the joint fit, with standard errors."""
        delays, gains = self.delays.copy(), self.gains.copy()
        errors = np.zeros_like(delays), np.zeros_like(gains)
        for k, term in enumerate(terms):
            error = float(np.sqrt(covariance[k, k]))
            if term.kind == "delay":
                delays[term.place] += coefficients[k]
                errors[0][term.place] = error
            if term.kind == "gain":
                gains[term.place] *= 1.0 + coefficients[k]
                errors[1][term.place] = error * abs(gains[term.place])
        return replace(self, delays=delays, gains=gains, errors=errors)

    def facts(self, tree: KinematicTree) -> dict[str, Any]:
        """Values of `FitFacts`."""
        assert self.errors is not None
        without = tuple(tree.coordinates[i] for i in self.unmeasured)
        values = (self.delays, self.errors[0], self.gains, self.errors[1])
        names = ("delays", "delay_errors", "gains", "gain_errors")
        found = {name: tuple(part.tolist()) for name, part in zip(names, values, strict=True)}
        return {**found, "unmeasured": without}

    def notes(self, tree: KinematicTree) -> list[str]:
        """Sentences on unmeasured torques, significant delays, and estimated gains."""
        assert self.errors is not None
        cut = float(norm.isf(_CHANCE / 2.0 / len(tree)))
        late = [
            f"{name} {1e3 * value:.3g} ± {1e3 * error:.1g}"
            for name, value, error in zip(tree.coordinates, self.delays, self.errors[0], strict=True)
            if abs(value) > cut * error > 0.0
        ]
        gains = [f"{tree.coordinates[i]} {self.gains[i]:.4g} ± {self.errors[1][i]:.1g}" for i in self.unknown]
        without = ", ".join(tree.coordinates[i] for i in self.unmeasured)
        notes = {
            f"the torque of {without} is not measured: friction and rotor there stay unknown": without,
            f"delays of the recorded torques in ms, which were corrected: {', '.join(late)}": late,
            f"torque per unit of the log: {', '.join(gains)}": gains,
        }
        return [note for note, any_ in notes.items() if any_]


def predicted(choice: Choice) -> np.ndarray:
    """(n_intervals, n_quadrature, n_dof) torques of the regression."""
    regression, values = choice.regression, choice.solution.values
    whole = np.zeros(len(regression.columns))
    whole[choice.members] = values[: len(choice.members)]
    out = regression.torques(whole)
    for (i, d), value in zip(choice.dry, values[len(choice.members) :], strict=True):
        out[:, :, i] += value * regression.histories[d, :, :, i]
    return out


def _standard_errors(
    regression: Regression, members: Sequence[int], dry: Acting, solution: Solution
) -> np.ndarray:
    """(n,) standard errors of the coefficients; only independent residuals count."""
    information = np.zeros((solution.values.size,) * 2)
    for i, total in enumerate(regression.grams.sum(axis=0)):
        places, numbers = regression.own(members, dry, i)
        own = total[np.ix_(numbers[:-1], numbers[:-1])]
        information[np.ix_(places[:-1], places[:-1])] += regression.counts[i] / solution.squares[i] * own
    return np.sqrt(np.clip(np.diag(symmetric_inverse(information)), 0.0, None))


def starts(
    grid: SplineGrid, control_points: np.ndarray, data: Trajectories, friction: Iterable[ArmTerm]
) -> tuple[list[ArmTerm], np.ndarray]:
    """Friction of joints that rest when a run begins, and what is left of it along the motion.

    It holds the joint, so that it has any size up to that of dry friction, and it is forgotten over the
    distance of dry friction.

    Returns
    -------
    list of ArmTerm
        Of kind "start", those that last longest.
    (2, n_intervals, n_quadrature, n_dof) array
        Histories of `ArmColumns`: what is left, and the number of the run.
    """
    times = [t.t for t in data]
    dry = [term for term in friction if term.kind == "dry" and term.distance > 0.0]
    motion = grid.evaluate(control_points, times)
    left = [np.zeros_like(q) for q in motion]
    found: list[tuple[float, ArmTerm]] = []
    for k, q in enumerate(motion):
        for term in dry:
            left[k][:, term.place] = along = remembered(q[:, term.place], term.distance)[0]
            name = f"start[{data.coordinates[term.place]}, {k + 1}]"
            lasts = float(np.trapezoid(along**2, times[k]))
            found.append((lasts, ArmTerm(name, "start", term.place, k)))
    longest = sorted((pair for pair in found if pair[0] > _REST), key=lambda pair: -pair[0])
    remains = forces_on(grid, times, left)
    assert remains is not None
    runs = np.broadcast_to(grid.owner[:, None, None].astype(float), remains.values.shape)
    terms = [term for _, term in longest[:_MOST_STARTS]]
    return terms, np.array([remains.values, runs])


def idle_notes(data: Trajectories, tree: KinematicTree, unmeasured: Sequence[int]) -> list[str]:
    """Joints whose torque is zero throughout, as where a log lacks it."""
    used = np.any([np.any(run.forces, axis=0) for run in data], axis=0)
    idle = [name for i, name in enumerate(tree.coordinates) if not used[i] and i not in unmeasured]
    if not idle:
        return []
    return [
        f"the torque of {', '.join(idle)} is zero in the whole log; if it was not measured, give "
        f"Recording(unmeasured={idle!r}) or --unmeasured {','.join(idle)}"
    ]


def bounded_starts(
    terms: Sequence[ArmTerm], coefficients: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients and covariance if dry friction bounds the friction at the start of a run.

    A value between −dry and dry, all equally probable, has the variance dry²/3. Without this prior, the
    friction may absorb other slow errors in the first part of a log.
    """
    dry = {t.place: c for t, c in zip(terms, coefficients.tolist(), strict=True) if t.kind == "dry"}
    rows = [k for k, term in enumerate(terms) if term.kind == "start"]
    prior = np.diag([dry[terms[k].place] ** 2 / 3.0 for k in rows])
    gain = np.linalg.solve(covariance[np.ix_(rows, rows)] + prior, covariance[rows]).T
    return coefficients - gain @ coefficients[rows], covariance - gain @ covariance[rows]
