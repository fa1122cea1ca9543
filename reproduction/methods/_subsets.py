"""Best supports of a linear least-squares problem, one size after another, from its normal equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Normal", "best_supports"]

_RIDGE = 1e-13  # relative; keeps nearly singular supports solvable
_AT_ONCE = 4096  # supports solved in one go


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations of ``columns @ x = target``; those of several data sets can be added.

    Attributes
    ----------
    gram : (n, n) array
    moment : (n,) array
        ``columns.T @ target``.
    square : float
        ``target @ target``.
    """

    gram: np.ndarray
    moment: np.ndarray
    square: float

    @classmethod
    def of(cls, columns: np.ndarray, target: np.ndarray) -> Normal:
        return cls(columns.T @ columns, columns.T @ target, float(target @ target))

    def __add__(self, other: Normal) -> Normal:
        return Normal(self.gram + other.gram, self.moment + other.moment, self.square + other.square)

    def misfit(self, x: np.ndarray) -> float:
        """Squared residual as a share of the squared target."""
        return float((self.square - 2.0 * x @ self.moment + x @ self.gram @ x) / self.square)

    def solve(self, support: tuple[int, ...]) -> np.ndarray:
        """Least-squares x that is zero outside the support."""
        x = np.zeros(len(self.moment))
        x[list(support)] = self._solutions(np.array([support]))[0]
        return x

    def gains(self, supports: np.ndarray) -> np.ndarray:
        """By how much each row of supports, (n_supports, size), lowers the squared residual."""
        parts = [supports[k : k + _AT_ONCE] for k in range(0, len(supports), _AT_ONCE)]
        return np.concatenate([np.sum(self._solutions(p) * self.moment[p], axis=1) for p in parts])

    def _solutions(self, supports: np.ndarray) -> np.ndarray:
        gram = self.gram[supports[:, :, None], supports[:, None, :]]
        diagonal = np.arange(supports.shape[1])
        gram[:, diagonal, diagonal] *= 1.0 + _RIDGE
        return np.linalg.solve(gram, self.moment[supports][..., None])[..., 0]


def best_supports(normal: Normal, max_size: int, width: int) -> list[tuple[int, ...]]:
    """Search the best support of each size from 1 on: the better of growing and of pruning.

    Parameters
    ----------
    normal : Normal
    max_size : int
    width : int
        How many supports of each size are kept to add a term to.
    """
    pairs = zip(_grown(normal, max_size, width), _pruned(normal)[:max_size], strict=True)
    return [max(pair, key=lambda support: normal.gains(np.array([support]))[0]) for pair in pairs]


def _grown(normal: Normal, max_size: int, width: int) -> list[tuple[int, ...]]:
    n_terms = len(normal.moment)
    beam: list[tuple[int, ...]] = [()]
    best = []
    for _ in range(min(max_size, n_terms)):
        children = {tuple(sorted((*s, k))) for s in beam for k in range(n_terms) if k not in s}
        supports = np.array(sorted(children))
        ranked = np.argsort(-normal.gains(supports), kind="stable")[:width]
        beam = [tuple(int(k) for k in supports[r]) for r in ranked]
        best.append(beam[0])
    return best


def _pruned(normal: Normal) -> list[tuple[int, ...]]:
    """From all terms down to one; the smallest comes first."""
    support = tuple(range(len(normal.moment)))
    path = [support]
    while len(support) > 1:
        children = np.array([[k for k in support if k != out] for out in support])
        support = tuple(int(k) for k in children[np.argmax(normal.gains(children))])
        path.append(support)
    return path[::-1]
