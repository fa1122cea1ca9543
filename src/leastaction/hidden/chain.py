"""From motions in single windows to one motion along every trajectory.

Every window has several solutions, on different branches of the hidden coordinate. The path through the
windows minimises the sum of log(1 + χ²) and log(1 + jump²), so that it fits and is continuous. Dynamic
programming finds it (Viterbi 1967, IEEE Trans. Inf. Theory 13:260).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from leastaction.hidden.draws import Scales
from leastaction.hidden.shooting import Shooter
from leastaction.hidden.windows import Solutions, Windows

__all__ = ["Chained", "chain", "continued", "preceding"]

_SMALL = 0.02  # of a scale: smaller jumps between windows are ignored


@dataclass(frozen=True, eq=False)
class Chained:
    """Hidden coordinates at the samples of every trajectory.

    Attributes
    ----------
    values : list of (n_times, n_hidden) arrays
    jumps : list of (n_windows - 1,) arrays
        Jumps between neighbouring windows, in scales of the hidden state.
    chosen : Solutions
        The solution of every window that is on the path.
    """

    values: list[np.ndarray]
    jumps: list[np.ndarray]
    chosen: Solutions

    @property
    def jump(self) -> float:
        """The largest jump."""
        return max((float(own.max()) for own in self.jumps if own.size), default=0.0)


@np.errstate(all="ignore")  # motions may diverge: their states are huge or not finite, and on no path
def chain(shooter: Shooter, found: Solutions, scales: Scales, times: list[np.ndarray]) -> Chained:
    """Choose a solution of every window and return the hidden coordinates.

    Parameters
    ----------
    shooter : Shooter
        Its windows cover every trajectory.
    found : Solutions
        One set of coefficients, with several solutions of each window.
    scales : Scales
    times : list of (n_times,) arrays
        Samples of each trajectory.
    """
    windows, hidden = shooter.windows, list(shooter.windows.hidden)
    motions = _motions(shooter, found)[..., [*hidden, *(shooter.n_dof + i for i in hidden)]]
    kept = motions.shape[1]
    misfit = np.log1p(found.deviation[0]).reshape(len(windows), kept)
    period = np.select([scales.cyclic, scales.angular], [0.0, 2.0 * np.pi], np.inf)[hidden]
    jump = partial(_jumps, unit=scales.unit[[*hidden, *(shooter.n_dof + i for i in hidden)]], period=period)
    values: list[np.ndarray] = []
    jumps: list[np.ndarray] = []
    places = np.empty(len(windows), dtype=int)
    for k, t in enumerate(times):
        rows = np.flatnonzero(windows.trial == k)
        begin = windows.begin[rows]
        links = [
            jump(_at(windows.nodes, motions[rows[j]], begin[j + 1] - begin[j]), motions[rows[j + 1], :, 0])
            for j in range(rows.size - 1)
        ]
        path = _cheapest(misfit[rows], links)
        jumps.append(np.sqrt([link[a, b] for link, a, b in zip(links, path, path[1:], strict=False)]))
        places[rows] = kept * rows + path
        values.append(_read(motions[rows, path], begin, windows.nodes, t, period))
    chosen = Solutions(found.coefficients, found.states[:, places], found.deviation[:, places])
    return Chained(values, jumps, chosen)


@np.errstate(all="ignore")
def continued(shooter: Shooter, found: Solutions, rounds: int) -> Solutions:
    """Solutions of windows that follow from those of the window before.

    They are fitted from the states to which those lead. The first window of a trajectory starts from its own
    solutions.

    Parameters
    ----------
    shooter : Shooter
    found : Solutions
        One set of coefficients, with several solutions of each window.
    rounds : int
        Steps of the fit.
    """
    windows, motions = shooter.windows, _motions(shooter, found)
    states = motions[:, :, 0].copy()
    for k in _with_next(windows):
        ends = _at(windows.nodes, motions[k], windows.begin[k + 1] - windows.begin[k])
        states[k + 1] = _where_finite(ends, states[k + 1])
    states, owner = _in_rows(states)
    return shooter.fit_states(found.coefficients, states[None], owner, rounds)


@np.errstate(all="ignore")
def preceding(shooter: Shooter, found: Solutions, rounds: int, doublings: int) -> Solutions:
    """Solutions of windows that lead to those of the window after.

    They are fitted backward in time from their ends, over a horizon that doubles until it is the whole
    window. The last window of a trajectory starts from the ends of its own solutions.

    Parameters
    ----------
    shooter, found
        As for `continued`.
    rounds, doublings : int
        As for `Shooter.screen`.
    """
    windows, motions = shooter.windows, _motions(shooter, found)
    ends = motions[:, :, -1].copy()
    for k in _with_next(windows):
        late = windows.begin[k] + windows.seconds - windows.begin[k + 1]
        ends[k] = _where_finite(_at(windows.nodes, motions[k + 1], late), ends[k])
    states, owner = _in_rows(ends)
    backward = shooter.on(windows.backward())
    fitted = replace(found, states=states[None])
    for further in range(doublings, -1, -1):
        part = backward.on(backward.windows.until(0.5**further))
        fitted = part.fit_states(found.coefficients, fitted.states, owner, rounds)
    given = np.repeat(found.coefficients, owner.size, axis=0).T
    return replace(fitted, states=backward.motions(fitted.states[0], given, owner)[None, -1])


def _with_next(windows: Windows) -> list[int]:
    """Windows after which another one of the same trajectory begins."""
    return np.flatnonzero(np.diff(windows.trial) == 0).tolist()


def _where_finite(states: np.ndarray, others: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(states).all(axis=1, keepdims=True), states, others)


def _in_rows(states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n_windows · n_solutions, n) states of (n_windows, n_solutions, n), and their windows."""
    owner = np.repeat(np.arange(len(states)), states.shape[1])
    return states.reshape(-1, states.shape[-1]), owner


def _motions(shooter: Shooter, found: Solutions) -> np.ndarray:
    """(n_windows, n_solutions, n_nodes, 2 n_dof) motions of one set of coefficients."""
    kept = found.deviation.shape[1] // len(shooter.windows)
    owner = np.repeat(np.arange(len(shooter.windows)), kept)
    given = np.repeat(found.coefficients, owner.size, axis=0).T
    motions = np.moveaxis(shooter.motions(found.states[0], given, owner), 0, 1)
    return motions.reshape(len(shooter.windows), kept, *motions.shape[1:])


def _jumps(ends: np.ndarray, begins: np.ndarray, unit: np.ndarray, period: np.ndarray) -> np.ndarray:
    """(n_ends, n_begins) squared distances between states."""
    step = begins[None] - ends[:, None]
    step[..., : period.size] -= _turns(step[..., : period.size], period)
    return (step**2 / unit**2).mean(axis=-1)


def _turns(step: np.ndarray, period: np.ndarray) -> np.ndarray:
    """The part of a step to ignore: whole periods, or all of it where the period is zero."""
    whole = np.where(np.isfinite(period) & (period > 0.0), period, 1.0)
    turns = np.where(np.isfinite(period), whole * np.round(step / whole), 0.0)
    return np.where(period > 0.0, turns, step)


def _cheapest(misfit: np.ndarray, links: list[np.ndarray]) -> list[int]:
    """The path of least cost; ``misfit`` is (n_windows, n_solutions)."""
    total, origins = misfit[0], []
    for own, link in zip(misfit[1:], links, strict=True):
        through = total[:, None] + np.log1p(np.nan_to_num(link, nan=np.inf) / _SMALL**2)
        origins.append(through.argmin(axis=0))
        total = own + through.min(axis=0)
    path = [int(total.argmin())]
    for origin in reversed(origins):
        path.append(int(origin[path[-1]]))
    return path[::-1]


def _at(nodes: np.ndarray, motions: np.ndarray, time: float) -> np.ndarray:
    """(n_solutions, n) of (n_solutions, n_nodes, n) at a time between nodes."""
    k = int(np.clip(np.searchsorted(nodes, time) - 1, 0, nodes.size - 2))
    u = (time - nodes[k]) / (nodes[k + 1] - nodes[k])
    return (1.0 - u) * motions[:, k] + u * motions[:, k + 1]


def _read(
    chosen: np.ndarray, begin: np.ndarray, nodes: np.ndarray, times: np.ndarray, period: np.ndarray
) -> np.ndarray:
    """Hidden coordinates at the samples, from the window that began last, without jumps by whole periods."""
    out = np.empty((times.size, period.size))
    place = np.clip(np.searchsorted(begin, times, side="right") - 1, 0, begin.size - 1)
    shift = np.zeros(period.size)
    for j, motion in enumerate(chosen):
        if j:
            end = _at(nodes, chosen[None, j - 1], begin[j] - begin[j - 1])[0, : period.size] + shift
            shift = _turns(end - motion[0, : period.size], period)
        own = place == j
        for i in range(period.size):
            out[own, i] = np.interp(times[own] - begin[j], nodes, motion[:, i]) + shift[i]
    return out
