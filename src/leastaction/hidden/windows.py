"""Short windows of the measured motion, in which motions of a law are compared with it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from leastaction.curve.smoothing import Smooth
from leastaction.estimation.forces import curve_between
from leastaction.estimation.problem import Problem
from leastaction.hidden.settings import HIDDEN

__all__ = ["Windows", "cut_windows"]


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
