"""Measured coordinates and rates on a spline grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from leastaction.curve.bspline import SplineGrid
from leastaction.curve.smoothing import banded_gram
from leastaction.data.trajectories import Rate
from leastaction.estimation.elimination import NormalEquations, trace_product

__all__ = ["Observations", "counts_and_floors"]

RELATIVE_FLOOR = 1e-6  # noise over spread, of noiseless samples


@dataclass(frozen=True, eq=False)
class _Channel:
    """Valid samples of one coordinate, or of one of its derivatives, and the basis at their times."""

    coordinate: int
    design: sp.csr_array
    gram: np.ndarray
    y: np.ndarray


class Observations:
    """Measured coordinates and rates on a spline grid; NaN samples are left out channel by channel.

    Attributes
    ----------
    counts : (n_channels,) int array
        Samples of each channel: positions of the coordinates in order, then ``rates``.
    coordinates : (n_channels,) int array
        The coordinate of each channel.
    floors, noise_floor : (n_channels,) and (n_dof,) arrays
        Smallest noise: a millionth of the range of a sensor. Below this, rounding and integration errors of
        the data would count as physics.
    calibration : None
        These channels have no calibration numbers.
    """

    calibration: np.ndarray | None = None

    def __init__(
        self,
        grid: SplineGrid,
        times: Sequence[np.ndarray],
        values: Sequence[np.ndarray],
        rates: Sequence[Rate] = (),
        floors: np.ndarray | None = None,
    ) -> None:
        stacked = np.concatenate(values)
        self.grid: SplineGrid = grid
        self.n_dof: int = stacked.shape[1]
        measured = [(i, 0, column) for i, column in enumerate(stacked.T)]
        measured += [(r.coordinate, r.derivative, np.concatenate(r.values)) for r in rates]
        designs = {nu: grid.design(times, nu) for nu in dict.fromkeys(nu for _, nu, _ in measured)}
        whole: dict[int, _Channel] = {}  # complete columns share basis and Gram matrix, by derivative
        self._channels: list[_Channel] = []
        for i, nu, y in measured:
            keep = np.isfinite(y)
            complete = bool(keep.all())
            if complete and nu in whole:
                self._channels.append(replace(whole[nu], coordinate=i, y=y[keep]))
                continue
            design = designs[nu] if complete else designs[nu][keep]
            gram = banded_gram(design, grid.degree)
            self._channels.append(_Channel(i, design, gram, y[keep]))
            if complete:
                whole[nu] = self._channels[-1]
        self.counts: np.ndarray = np.array([c.y.size for c in self._channels])
        self.coordinates: np.ndarray = np.array([c.coordinate for c in self._channels])
        self.floors: np.ndarray = counts_and_floors(values, rates)[1] if floors is None else floors
        self.noise_floor: np.ndarray = self.floors[: self.n_dof]

    def residuals(self, control_points: np.ndarray) -> list[np.ndarray]:
        """y − N P for each channel, valid samples only."""
        return [
            c.y - c.design @ np.ascontiguousarray(control_points[:, c.coordinate]) for c in self._channels
        ]

    def gradient(self, control_points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """−Nᵀ(y − N P), (n_ctrl, n_channels), and Σ (y − N P)² of each channel."""
        residuals = Observations.residuals(self, control_points)  # of these channels alone
        gradient = [-(c.design.T @ r) for c, r in zip(self._channels, residuals, strict=True)]
        return np.stack(gradient, axis=1), np.array([r @ r for r in residuals])

    def at(self, control_points: np.ndarray, calibration: np.ndarray | None = None) -> Observations:
        """Itself: the samples are linear in the control points and have no calibration numbers."""
        return self

    def joined(self, normal: NormalEquations, noise_std: np.ndarray) -> NormalEquations:
        """The normal equations, unchanged: there are no calibration numbers."""
        return normal

    def gram(self, channel: int) -> np.ndarray:
        """NᵀN of a channel in lower banded storage, (degree + 1, n_ctrl)."""
        return self._channels[channel].gram

    def traces(self, inverse_rows: np.ndarray, noise_std: np.ndarray) -> np.ndarray:
        """(n_channels,) degrees of freedom that each channel uses: tr(H⁻¹NᵀN) / σ²."""
        pairs = zip(self._channels, noise_std, strict=True)
        return np.array([trace_product(inverse_rows, c.coordinate, c.gram) / sigma**2 for c, sigma in pairs])

    def add_gram(self, rows: np.ndarray, noise_std: np.ndarray) -> None:
        """Add NᵀN / σ² of every channel to (n_ctrl, n_dof, …) block rows."""
        for c, sigma in zip(self._channels, noise_std, strict=True):
            rows[:, c.coordinate, c.coordinate :: self.n_dof] += c.gram.T / sigma**2


def counts_and_floors(
    values: Sequence[np.ndarray], rates: Sequence[Rate] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """(n_channels,) samples of each channel, and a millionth of its spread, trial by trial."""
    channels: list[Sequence[np.ndarray]] = [[q[:, i] for q in values] for i in range(values[0].shape[1])]
    channels += [rate.values for rate in rates]
    counts, floors = np.zeros(len(channels), dtype=int), np.zeros(len(channels))
    for k, parts in enumerate(channels):
        counts[k] = sum(int(np.isfinite(part).sum()) for part in parts)
        mean = sum(float(part[np.isfinite(part)].sum()) for part in parts) / max(counts[k], 1)
        squares = sum(float(((part[np.isfinite(part)] - mean) ** 2).sum()) for part in parts)
        # constant samples have no noise; one is arbitrary, and its logarithm is zero
        floors[k] = RELATIVE_FLOOR * np.sqrt(squares / max(counts[k], 1)) or 1.0
    return counts, floors
