r"""What a log's torques are: late, and in units of a drive.

A torque that is recorded the time d after it acts, in units of which k make one newton metre, is

.. math:: u(t) = \tau(t - d) / k.

Both are found beside the parameters.  With torques made from the log by the present d and k, a change of d
adds −Δd dτ/dt to them, and a relative change of k adds −(Δk/k) τ; τ is taken from the law, not from the
log, so that noise of the log does not make them small.

Torques that are all multiplied by one factor belong to an arm whose parameters are: currents alone tell
ratios of gains, because links act on several joints (Gautier & Briot 2014, Journal of Dynamic Systems,
Measurement, and Control 136:051025).  One gain must be known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.stats import norm
from scipy.stats import t as t_distribution

from leastaction.arms.regression import Choice, Regression
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import InputError
from leastaction.estimation.gauss_newton import symmetric_inverse
from leastaction.identifiers import quoted
from leastaction.library.tree import KinematicTree
from leastaction.mechanics.arm_columns import ArmTerm

__all__ = ["Signals"]

_ROUNDS = 4  # of the weights, for first gains
_FAR = 0.1  # sampling intervals, or relative change of a gain, beyond which columns are taken anew
_LARGEST = 0.5  # relative change of a gain in one step
_CHANCE = 0.01  # that a delay of an arm without one is reported
_FARTHEST = 5.0  # sampling intervals that a delay changes in one step


@dataclass(frozen=True, eq=False)
class Signals:
    """Delays and gains of a log.

    Attributes
    ----------
    delays : (n_dof,) array
        In s.
    gains : (n_dof,) array
        Torque per unit of what was recorded.
    late : bool
        Whether delays are unknown.
    unknown : tuple of int
        Joints whose gain is unknown.
    errors : pair of (n_dof,) arrays, optional
        Standard errors of delays and gains, zero where they were given.
    """

    delays: np.ndarray
    gains: np.ndarray
    late: bool
    unknown: tuple[int, ...]
    errors: tuple[np.ndarray, np.ndarray] | None = None

    @classmethod
    def asked(cls, tree: KinematicTree, gains: Mapping[str, float] | None, *, late: bool) -> Signals:
        """What a call of `identify` asks for.

        Raises
        ------
        InputError
            If a gain belongs to no joint or is not a number, or if none is given.
        """
        n = len(tree)
        if gains is None:
            return cls(np.zeros(n), np.ones(n), late, ())
        names = tree.coordinates
        for name, value in gains.items():
            if name not in names:
                raise InputError(
                    f"gains hold {quoted(name)}; expected joints of the tree: {', '.join(names)}"
                )
            if not np.isfinite(value) or value == 0.0:
                raise InputError(f"the gain of {name} is {value}; give the torque per unit of the log")
        if not gains:
            raise InputError(
                "no gain is given: currents tell only the ratios of gains and parameters; give the torque "
                f"per ampere of one joint, such as gains={{{names[0]!r}: 10.0}}; or give 1.0, find a known "
                "payload, and give its true mass over the mass found"
            )
        unknown = tuple(i for i, name in enumerate(names) if name not in gains)
        return cls(np.zeros(n), np.array([gains.get(name, 1.0) for name in names], float), late, unknown)

    @property
    def open(self) -> list[tuple[int, str]]:
        """Joints, and whether a delay or a gain is unknown there."""
        late = range(len(self.gains) if self.late else 0)
        return [(i, "delay") for i in late] + [(i, "gain") for i in self.unknown]

    def torques(self, data: Trajectories) -> Trajectories:
        """The log with torques in place of what was recorded."""
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
        """Unknown gains by least squares with the recorded values as columns: shrunk by their noise."""
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
        weights, values = np.ones(n), np.zeros(size - 1)
        for _ in range(_ROUNDS):
            summed = np.tensordot(weights, local, 1)
            values = symmetric_inverse(summed[:-1, :-1]) @ summed[:-1, -1]
            residual = np.append(values, -1.0)
            weights = 1.0 / np.maximum(np.einsum("a,iab,b->i", residual, local, residual), 1e-300)
        gains = self.gains.copy()
        gains[list(self.unknown)] = values[m:]
        return replace(self, gains=gains)

    def columns(self, choice: Choice) -> np.ndarray:
        """(2, n_intervals, n_quadrature, n_dof): what a change of delay and gain adds to the torques."""
        regression = choice.regression
        tau = regression.predicted(choice.members, choice.dry, choice.solution.values)
        out, stop = np.zeros((2, *tau.shape)), 0
        for k, space in enumerate(regression.grid.spaces):
            own = slice(stop, stop := stop + space.n_intervals)
            times = regression.grid.points_of(k).ravel()
            rate = CubicSpline(times, tau[own].reshape(times.size, -1))(times, 1)
            out[0, own] = -rate.reshape(tau[own].shape)
        out[1] = -tau
        return out

    def steps(self, choice: Choice, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Changes of what is `open`, by least squares beside the parameters, and their standard errors."""
        regression = choice.regression
        whole = replace(regression, histories=np.concatenate([regression.histories, columns]))
        whole = replace(whole, grams=whole.summed())
        first = len(regression.histories)
        acting = [*choice.dry, *((i, first + int(kind == "gain")) for i, kind in self.open)]
        own = slice(len(choice.members) + len(choice.dry), None)
        solution = whole.solved(choice.members, acting)
        return solution.values[own], whole.standard_errors(choice.members, acting, solution)[own]

    def common(self, steps: np.ndarray, errors: np.ndarray) -> bool:
        """Whether the delays of the joints have a mean that is not zero.

        Joints differ by more than their errors where something acts that the law does not hold. The variance
        among them is estimated, too, and their mean compared with it (DerSimonian & Laird 1986, Controlled
        Clinical Trials 7:177).
        """
        n = len(self.gains)
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
        """After a step."""
        delays, gains = self.delays.copy(), self.gains.copy()
        for (i, kind), step in zip(self.open, steps.tolist(), strict=True):
            if kind == "gain":
                gains[i] *= 1.0 + float(np.clip(step, -_LARGEST, _LARGEST))
            else:
                delays[i] += float(np.clip(step, -_FARTHEST * interval, _FARTHEST * interval))
        return replace(self, delays=delays, gains=gains)

    def far(self, steps: Sequence[float] | np.ndarray, interval: float) -> bool:
        """Whether a step is too long for columns that are linear in it."""
        scale = np.array([1.0 if kind == "gain" else interval for _, kind in self.open])
        return bool(np.any(np.abs(steps) > _FAR * scale))

    def found(self, terms: Sequence[ArmTerm], coefficients: np.ndarray, covariance: np.ndarray) -> Signals:
        """After the last, small steps of the joint fit, with standard errors."""
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

    def facts(self) -> dict[str, tuple[float, ...]]:
        """For `FitFacts`."""
        assert self.errors is not None
        values = (self.delays, self.errors[0], self.gains, self.errors[1])
        names = ("delays", "delay_errors", "gains", "gain_errors")
        return {name: tuple(part.tolist()) for name, part in zip(names, values, strict=True)}

    def notes(self, tree: KinematicTree) -> list[str]:
        """Delays that are no accident, and gains, in words."""
        assert self.errors is not None
        cut = float(norm.isf(_CHANCE / 2.0 / len(tree)))
        late = [
            f"{name} {1e3 * value:.3g} ± {1e3 * error:.1g}"
            for name, value, error in zip(tree.coordinates, self.delays, self.errors[0], strict=True)
            if abs(value) > cut * error > 0.0
        ]
        said = [f"torques are recorded later than they act, in ms: {', '.join(late)}; they were shifted"]
        gains = [f"{tree.coordinates[i]} {self.gains[i]:.4g} ± {self.errors[1][i]:.1g}" for i in self.unknown]
        return (said if late else []) + ([f"torque per unit of the log: {', '.join(gains)}"] if gains else [])
