"""Short windows of the measured motion, and the motions of laws that fit it best in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leastaction.curve.smoothing import Smooth
from leastaction.estimation.forces import curve_between
from leastaction.estimation.problem import Problem
from leastaction.hidden.settings import HIDDEN

__all__ = ["Solutions", "Windows", "cut_windows"]


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of one length along the smoothed motion.

    Attributes
    ----------
    trial : (n_windows,) int array
        Trajectory of each window.
    begin : (n_windows,) array
        Start of each window, in seconds.
    nodes : (n_nodes,) array
        Seconds since the start of a window, at which motions are integrated and compared.
    q, qdot : (n_windows, n_nodes, n_dof) arrays
        The smoothed motion; meaningless for hidden coordinates.
    measured, hidden : tuple of int
        Measured and hidden coordinates.
    scale : (n_dof,) array
        Unit of the deviations of measured coordinates; one for hidden coordinates.
    forces : (2 n_nodes - 1, n_windows, n_dof) array or None
        Known forces at the nodes and between them.
    """

    trial: np.ndarray
    begin: np.ndarray
    nodes: np.ndarray
    q: np.ndarray
    qdot: np.ndarray
    measured: tuple[int, ...]
    hidden: tuple[int, ...]
    scale: np.ndarray
    forces: np.ndarray | None

    def __len__(self) -> int:
        return self.begin.size

    @property
    def seconds(self) -> float:
        """Length of a window."""
        return float(self.nodes[-1])

    def until(self, share: float) -> Windows:
        """The same windows, up to a share of their length."""
        count = 1 + max(1, round(share * (self.nodes.size - 1)))
        forces = None if self.forces is None else self.forces[: 2 * count - 1]
        q, qdot = self.q[:, :count], self.qdot[:, :count]
        return replace(self, nodes=self.nodes[:count], q=q, qdot=qdot, forces=forces)

    def backward(self) -> Windows:
        """The same windows from their ends to their starts; nodes are negative."""
        begin, forces = self.begin + self.seconds, None if self.forces is None else self.forces[::-1]
        q, qdot = self.q[:, ::-1], self.qdot[:, ::-1]
        return replace(self, begin=begin, nodes=-self.nodes, q=q, qdot=qdot, forces=forces)


@dataclass(frozen=True, eq=False)
class Solutions:
    """Sets of coefficients, each with the initial states that fit best.

    Attributes
    ----------
    coefficients : (n_sets, n_members) array
    states : (n_sets, n_windows, 2 n_dof) array
    deviation : (n_sets, n_windows) array
        χ_w², the mean squared deviation from the measured motion (see `shooting`).
    """

    coefficients: np.ndarray
    states: np.ndarray
    deviation: np.ndarray

    def __len__(self) -> int:
        return len(self.coefficients)

    @property
    def cost(self) -> np.ndarray:
        """(n_sets,) Σ_w log(1 + χ_w²), by which sets are ranked."""
        if not self.deviation.shape[1]:
            return np.zeros(len(self.coefficients))
        return np.log1p(self.deviation).mean(axis=1)

    @property
    def typical(self) -> np.ndarray:
        """(n_sets,) median deviations of the windows, in units of deviations."""
        return np.sqrt(np.median(self.deviation, axis=1))

    def following(self, closely: float) -> Solutions:
        """The sets that typically deviate by at most so much."""
        kept = self.typical <= closely
        return Solutions(self.coefficients[kept], self.states[kept], self.deviation[kept])

    def alike(self, columns: Sequence[int]) -> np.ndarray:
        """Which sets have the same motion as the first one, up to the unit and direction of these states.

        Initial states are correlated where both sets follow as closely as usual, in more than half the
        windows. The columns are those of rates, which do not depend on the zero of a coordinate.
        """
        usual = self.deviation <= HIDDEN.usual * np.median(self.deviation, axis=1, keepdims=True)
        both = usual & usual[:1]
        own = self.states[..., list(columns)]
        first = np.broadcast_to(own[:1], own.shape)
        (x, y), xy = (np.einsum("sw,swi->si", both, z**2) for z in (first, own)), first * own
        same = np.abs(np.einsum("sw,swi->si", both, xy)) >= HIDDEN.same * np.sqrt(x * y)
        return np.all(same, axis=1) & (2 * both.sum(axis=1) > both.shape[1])

    def of_windows(self, n_windows: int, kept: int = 1) -> Solutions:
        """The best solutions of each window, where there are more."""
        n_sets = len(self.coefficients)
        deviation = self.deviation.reshape(n_sets, n_windows, -1)
        first = np.argsort(deviation, axis=-1, kind="stable")[..., :kept]
        states = self.states.reshape(*deviation.shape, -1)
        states = np.take_along_axis(states, first[..., None], axis=2).reshape(n_sets, -1, states.shape[-1])
        deviation = np.take_along_axis(deviation, first, axis=2).reshape(n_sets, -1)
        return Solutions(self.coefficients, states, deviation)

    def beside(self, other: Solutions, n_windows: int) -> Solutions:
        """Several solutions of each window, and those of another, of the same coefficients."""

        def joined(one: np.ndarray, two: np.ndarray) -> np.ndarray:
            parts = [part.reshape(len(part), n_windows, -1, *part.shape[2:]) for part in (one, two)]
            return np.concatenate(parts, axis=2).reshape(len(one), -1, *one.shape[2:])

        states, deviation = joined(self.states, other.states), joined(self.deviation, other.deviation)
        return Solutions(self.coefficients, states, deviation)

    def joined(self, other: Solutions) -> Solutions:
        """These sets and others, fitted in the same windows."""
        return Solutions(
            np.concatenate([self.coefficients, other.coefficients]),
            np.concatenate([self.states, other.states]),
            np.concatenate([self.deviation, other.deviation]),
        )

    def best(self, count: int) -> Solutions:
        """The sets of the lowest cost."""
        first = np.argsort(self.cost, kind="stable")[:count]
        return Solutions(self.coefficients[first], self.states[first], self.deviation[first])


def cut_windows(problem: Problem, smooth: Smooth, seconds: float, step: float, most: int | None) -> Windows:
    """Cut the smoothed motion into windows.

    Parameters
    ----------
    problem : Problem
    smooth : Smooth
        Of all coordinates; hidden ones are not used.
    seconds : float
        Length; shorter where a trajectory is shorter.
    step : float
        Longest step of the integration, in seconds.
    most : int or None
        Number of windows, spread evenly over the data. None: as many as cover every trajectory from its start
        to its end.
    """
    spans = [(space.breakpoints[0], space.breakpoints[-1]) for space in smooth.grid.spaces]
    longest = max(b - a for a, b in spans)
    short = [most is not None and b - a < min(seconds, longest) for a, b in spans]  # may be left out
    seconds = min([seconds, *(b - a for (a, b), out in zip(spans, short, strict=True) if not out)])
    counts = [
        0 if out else max(1, int(np.ceil((b - a) / seconds - 1e-9)))
        for (a, b), out in zip(spans, short, strict=True)
    ]
    begins = [
        np.linspace(a, b - seconds, n) if n > 1 else np.full(n, a)
        for (a, b), n in zip(spans, counts, strict=False)
    ]
    trial, begin = np.repeat(np.arange(len(counts)), counts), np.concatenate(begins)
    if most is not None and begin.size > most:
        kept = np.linspace(0, begin.size - 1, most).round().astype(int)
        trial, begin = trial[kept], begin[kept]
    nodes = np.linspace(0.0, seconds, max(HIDDEN.fewest_steps, int(np.ceil(seconds / step))) + 1)
    n_dof, hidden = problem.trajectories.n_dof, problem.hidden
    q, qdot = (np.zeros((begin.size, nodes.size, n_dof)) for _ in range(2))
    half = np.linspace(0.0, seconds, 2 * nodes.size - 1)
    moved = problem.trajectories.driven or problem.prescribed
    forces = np.zeros((half.size, begin.size, n_dof)) if moved else None
    for k, points in enumerate(smooth.grid.split(smooth.control_points)):
        own, space = trial == k, smooth.grid.spaces[k]
        times = np.minimum(begin[own][:, None] + nodes, spans[k][1])
        q[own], qdot[own] = space.evaluate(points, times), space.evaluate(points, times, 1)
        if forces is not None and own.any():
            at = np.minimum(half[:, None] + begin[own], spans[k][1])
            given = problem.trajectories[k]
            if given.forces is not None:
                forces[:, own] = curve_between(given.t, given.forces, problem.between)(at)
            for i in problem.prescribed:  # its force is its acceleration
                forces[:, own, i] = space.evaluate(points, at, 2)[..., i]
    measured = tuple(i for i in range(n_dof) if i not in hidden)
    spread = np.sqrt(np.mean([np.var(part, axis=0) for part in q], axis=0)) + np.std(q.mean(axis=1), axis=0)
    scale = np.maximum(smooth.noise_std, HIDDEN.counted * spread)
    scale[list(hidden)] = 1.0
    return Windows(trial, begin, nodes, q, qdot, measured, hidden, scale, forces)
