"""The slowly changing forces that were found beside the known ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leastaction.data.trajectories import Trajectories
from leastaction.estimation.fit import Fit
from leastaction.estimation.force_splines import slow_forces
from leastaction.estimation.settings import ESTIMATION
from leastaction.findings import Finding, find

__all__ = ["ForceBias", "no_bias"]

_MOST_ROUNDS = 4  # each a search


@dataclass(frozen=True, eq=False)
class ForceBias:
    """Slow forces at the samples of the trajectories; make the first by :func:`no_bias`.

    Attributes
    ----------
    trajectories : Trajectories
        With the forces that are known.
    seconds : mapping of int to float
        Number of a coordinate → spacing of the knots of its force; empty: there is nothing to find.
    added : tuple of (n_times, n_dof) arrays
        The slow forces, one for each trajectory.
    errors : mapping of int to float
        Number of a coordinate → standard error of its slow force.
    rounds : int
        How often they have been found and the terms searched again.
    last : (n_dof,) array
        By how much they changed the last time, root mean square.
    """

    trajectories: Trajectories
    seconds: Mapping[int, float]
    added: tuple[np.ndarray, ...]
    errors: Mapping[int, float]
    rounds: int
    last: np.ndarray

    @property
    def forces(self) -> list[np.ndarray]:
        """(n_times, n_dof) known and slow forces together, one for each trajectory."""
        given = (0.0 if t.forces is None else t.forces for t in self.trajectories)
        return [known + slow for known, slow in zip(given, self.added, strict=True)]

    @property
    def seconds_of(self) -> dict[str, float]:
        """Coordinate → seconds within which its force may change."""
        return {self.trajectories.coordinates[i]: every for i, every in self.seconds.items()}

    @property
    def size(self) -> dict[str, float]:
        """Coordinate → root mean square of its slow force."""
        rms = _rms(self.added) if self.seconds else np.zeros(0)
        return {self.trajectories.coordinates[i]: float(rms[i]) for i in self.seconds}

    def followed(self, fit: Fit) -> ForceBias | None:
        """With what the equations of a fit lack; None once that changes nothing any more."""
        if not self.seconds or self.rounds == _MOST_ROUNDS or not fit.converged:
            return None
        more = slow_forces(fit, self.seconds)
        change = _rms(more)
        # a change that is hardly smaller than the one before follows the noise
        small = change <= ESTIMATION.bias_settled * _rms(self.added)
        done = small | (change > ESTIMATION.bias_stalled * self.last)
        if self.rounds and np.all(done):
            return None
        return replace(self.adding(more, self.errors), rounds=self.rounds + 1, last=change)

    def adding(self, more: Sequence[np.ndarray], errors: Mapping[int, float]) -> ForceBias:
        """With further forces, and new standard errors."""
        added = tuple(total + part for total, part in zip(self.added, more, strict=True))
        return replace(self, added=added, errors=dict(errors))

    def settled(self, more: Sequence[np.ndarray]) -> bool:
        """Whether forces just added are small beside all of them."""
        return bool(np.all(_rms(more) <= ESTIMATION.bias_settled * _rms(self.added)))

    def found(self) -> dict[str, tuple[np.ndarray, ...]]:
        """Coordinate → slow force at the samples of each trajectory."""
        names = self.trajectories.coordinates
        return {names[i]: tuple(part[:, i].copy() for part in self.added) for i in self.seconds}

    def findings(self) -> list[Finding]:
        """What was found."""
        out: list[Finding] = []
        for i, (name, parts) in zip(self.seconds, self.found().items(), strict=True):
            low, high, error = min(map(np.min, parts)), max(map(np.max, parts)), self.errors[i]
            figures = {"seconds": self.seconds[i], "lowest": low, "highest": high, "standard_error": error}
            none = bool(_rms(list(parts)) < ESTIMATION.no_bias * error)
            out.append(find("slow-force", name, hardly_any=none, **figures))
        return out


def no_bias(trajectories: Trajectories, seconds: Mapping[int, float]) -> ForceBias:
    """Nothing found yet."""
    added = tuple(np.broadcast_to(0.0, t.q.shape) for t in trajectories)  # takes no memory
    errors = dict.fromkeys(seconds, np.nan)
    return ForceBias(trajectories, dict(seconds), added, errors, 0, np.full(trajectories.n_dof, np.inf))


def _rms(parts: Sequence[np.ndarray]) -> np.ndarray:
    return np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0))
