"""Slowly changing forces beside the known ones, found together with the terms: the bias of an actuator.

Least squares along the curve of a first fit gives the forces; they join the known ones and the terms are
searched again, until nothing changes.  At the end curve, coefficients and forces are fitted together, so that
the standard errors know that the forces are not known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from leastaction.data.trajectories import Trajectories
from leastaction.estimation.force_splines import fit_with_forces, slow_forces
from leastaction.estimation.weights import Start
from leastaction.estimation.workspace import StructureFit, Workspace
from leastaction.findings import Finding, find
from leastaction.selection.select import Refiner, Selection

__all__ = ["Drift"]

_SETTLED = 0.02
_STALLED = 0.5
_MOST_ROUNDS = 4
_MOST_FITS = 12
_NONE = 1.5  # standard errors


class Drift:
    """The slow forces found so far.

    Parameters
    ----------
    trajectories : Trajectories
    seconds : mapping of int to float
        Number of a coordinate → spacing of the knots of its force; empty: there is nothing to find.
    """

    def __init__(self, trajectories: Trajectories, seconds: Mapping[int, float]) -> None:
        self.trajectories, self.seconds = trajectories, dict(seconds)
        self._sum = [np.zeros(t.q.shape) for t in trajectories]
        self._errors = dict.fromkeys(self.seconds, np.nan)
        self._rounds, self._last = 0, np.full(trajectories.n_dof, np.inf)

    @property
    def forces(self) -> list[np.ndarray]:
        """(n_times, n_dof) known and slow forces together, one for each trajectory."""
        given = (0.0 if t.forces is None else t.forces for t in self.trajectories)
        return [known + slow for known, slow in zip(given, self._sum, strict=True)]

    @property
    def seconds_of(self) -> dict[str, float]:
        """Coordinate → seconds within which its force may change."""
        return {self.trajectories.coordinates[i]: every for i, every in self.seconds.items()}

    @property
    def size(self) -> dict[str, float]:
        """Coordinate → root mean square of its slow force."""
        rms = _rms(self._sum)
        return {self.trajectories.coordinates[i]: float(rms[i]) for i in self.seconds}

    def follow(self, workspace: Workspace, structure: StructureFit) -> bool:
        """Add what the equations of a fit lack; False once that changes nothing any more."""
        if not self.seconds or self._rounds == _MOST_ROUNDS or not structure.fit.converged:
            return False
        more = slow_forces(workspace, structure, self.seconds)
        change = _rms(more)
        # a change that is hardly smaller than the one before follows the noise
        done = (change <= _SETTLED * _rms(self._sum)) | (change > _STALLED * self._last)
        if self._rounds and np.all(done):
            return False
        self._last = change
        self._add(more)
        self._rounds += 1
        return True

    def settle(self, workspace: Workspace, selection: Selection) -> tuple[Workspace, Selection]:
        """Fit terms and slow forces together, without the terms that are then no longer significant."""
        structure = selection.structure
        if not self.seconds or not structure.fit.converged:
            return workspace, selection
        for _ in range(_MOST_FITS):
            fit, more, self._errors = fit_with_forces(workspace, structure, self.seconds)
            if not fit.converged:
                return workspace, selection
            self._add(more)
            workspace = self._pushed(workspace)
            members = structure.members
            covariance = fit.covariance[: len(members), : len(members)]
            z = fit.coefficients[: len(members)] / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
            coefficients = np.zeros_like(structure.coefficients)
            _, index = workspace.physics(members)
            coefficients[index] = fit.coefficients[: len(index)]
            settled = np.all(_rms(more) <= _SETTLED * _rms(self._sum))
            if settled and len(members) > 1 and np.min(z**2) < selection.penalty:
                # fitted next together with the forces, which may be what the term stood for
                weakest = members[int(np.argmin(z**2))]
                coefficients[weakest] = 0.0
                members = tuple(m for m in members if m != weakest)
                structure = StructureFit(members, coefficients, structure.fit, structure.evidence)
                continue
            start = Start(fit.control_points, coefficients, structure.fit.weights)
            structure = workspace.fit(members, start)
            if settled:
                structure = replace(structure, fit=replace(structure.fit, covariance=covariance))
                break
        levels = Refiner(workspace, lambda stage, details: None).levels(structure)
        return workspace, replace(selection, structure=structure, levels=levels)

    def _add(self, more: list[np.ndarray]) -> None:
        self._sum = [total + part for total, part in zip(self._sum, more, strict=True)]

    def _pushed(self, workspace: Workspace) -> Workspace:
        """The same grid with the forces found so far."""
        pushed = workspace.trajectories.with_forces(self.forces)
        return Workspace(
            pushed, workspace.columns, workspace.known, workspace.knots_per_second, workspace.degree
        )

    def found(self) -> dict[str, tuple[np.ndarray, ...]]:
        """Coordinate → slow force at the samples of each trajectory."""
        return {
            self.trajectories.coordinates[i]: tuple(part[:, i].copy() for part in self._sum)
            for i in self.seconds
        }

    def findings(self) -> list[Finding]:
        """What was found."""
        out = []
        for i, (name, parts) in zip(self.seconds, self.found().items(), strict=True):
            low, high, error = min(map(np.min, parts)), max(map(np.max, parts)), self._errors[i]
            figures = {"seconds": self.seconds[i], "lowest": low, "highest": high, "standard_error": error}
            none = bool(_rms(list(parts)) < _NONE * error)
            out.append(find("slow-force", name, hardly_any=none, **figures))
        return out


def _rms(parts: list[np.ndarray]) -> np.ndarray:
    return np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0))
