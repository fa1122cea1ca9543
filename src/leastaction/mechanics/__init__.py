"""Equations of motion of candidate terms and of whole models, and the states at which they are computed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
import sympy as sp

__all__ = ["Columns", "Points"]


class Points:
    """States at many points, with cached values of functions that several candidates contain.

    Parameters
    ----------
    q, qdot, qddot : (n_points, n_dof) arrays
        ``qddot`` may be omitted if no strong form is needed.
    times : (n_points,) array or function that returns it, optional
        In seconds; used only by candidates that contain the time.
    intervals : slice, optional
        Knot intervals of these quadrature points: the first point of each interval, then the second point of
        each, …; or the first point of each alone.
    """

    def __init__(
        self,
        q: np.ndarray,
        qdot: np.ndarray,
        qddot: np.ndarray | None = None,
        times: np.ndarray | Callable[[], np.ndarray] | None = None,
        *,
        intervals: slice | None = None,
    ) -> None:
        self.intervals = intervals
        self._times = times
        self.n_points: int = q.shape[0]
        self.n_dof: int = q.shape[1]
        blocks = [q, qdot] if qddot is None else [q, qdot, qddot]
        self.columns: list[np.ndarray] = [
            np.ascontiguousarray(block[:, i]) for block in blocks for i in range(self.n_dof)
        ]
        self._cache: dict[tuple[sp.Basic, tuple[float, ...]], np.ndarray] = {}
        self._kept: dict[int, tuple[object, Any]] = {}

    @property
    def times(self) -> np.ndarray:
        """(n_points,) seconds."""
        if self._times is None:
            raise ValueError("a candidate depends on time, and these points have none")
        if callable(self._times):
            self._times = self._times()
        return self._times

    def value(
        self, atom: sp.Basic, function: Callable[..., Any], timed: bool, numbers: tuple[float, ...] = ()
    ) -> np.ndarray:
        """Value of a function such as sin(θ) or √(…), computed once for all candidates.

        ``numbers`` are the values of the shape parameters. The function takes them after the state and, if it
        is ``timed``, the time.
        """
        key = (atom, numbers)
        if key not in self._cache:
            # a candidate may be undefined at some points (log of a negative number): NaN is checked later
            with np.errstate(all="ignore"):
                clock = (self.times,) if timed else ()
                values = function(*self.columns[: 2 * self.n_dof], *clock, *numbers)
            self._cache[key] = np.broadcast_to(values, self.n_points)
        return self._cache[key]

    def kept(self, owner: object, make: Callable[[], Any]) -> Any:
        """A value that an owner, such as a kinematic tree, computes once from these states."""
        if id(owner) not in self._kept:
            self._kept[id(owner)] = owner, make()  # keeps the owner alive: its id stays unique
        return self._kept[id(owner)][1]


class Columns(Protocol):
    """Interface of candidates to a fit: functions of the state, symbolic or numeric.

    The equations of motion are Σ_k λ_k E_ik(q, q̇, q̈) = f_i, with one column E_k for each candidate; see
    :mod:`leastaction.mechanics.euler_lagrange` and :mod:`leastaction.mechanics.arm_columns`.
    """

    prescribed: tuple[int, ...]

    def __len__(self) -> int: ...

    def strong(self, points: Points, select: Sequence[int] | None = None) -> np.ndarray:
        """(n_selected, n_dof, n_points): E_ik."""
        ...

    def jacobian(self, points: Points, coefficients: np.ndarray) -> dict[tuple[int, int, int], np.ndarray]:
        """(nu, i, j) → Σ_k λ_k ∂E_ik/∂q_j^{(nu)}; missing entries are zero."""
        ...

    def mass_matrix(self, points: Points, coefficients: np.ndarray) -> np.ndarray:
        """(n_points, n_dof, n_dof)."""
        ...

    def masses(self, points: Points) -> tuple[list[int], np.ndarray]:
        """The columns with kinetic energy, and (n_points, n_of_them, n_dof, n_dof) mass matrices of each."""
        ...

    def subset(self, select: Sequence[int]) -> Columns:
        """Some of the columns, in the given sequence."""
        ...

    def within(self, intervals: slice) -> Columns:
        """The columns for a part of a motion, given by its knot intervals."""
        ...
