"""Search for supports by a scale-free ratio on the Gram matrices of the weak form.

A support S is judged by

    ρ(S) = min over λ of ‖(I + V) λ‖² / ½ (‖I λ‖² + ‖V λ‖²),

the smallest generalised eigenvalue of two small matrices.  The ratio cannot be made small by letting
candidates cancel a known term, because that lowers numerator and denominator alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leastaction._weak import WeakGram

__all__ = ["Support", "beam_search", "solve_support"]

_RIDGE = 1e-12
_SMALLEST = 1e-13


@dataclass(frozen=True)
class Support:
    """A set of free columns and its ratio ρ."""

    members: tuple[int, ...]
    ratio: float


class _Scaled:
    """Gram matrices with unit diagonal of the parts, so that a ridge means the same for every column."""

    def __init__(self, gram: WeakGram) -> None:
        scale = 1.0 / np.sqrt(np.clip(np.diag(gram.parts), 1e-300, None))
        self.scale = scale
        self.total = gram.total * np.outer(scale, scale)
        self.parts = gram.parts * np.outer(scale, scale)
        self.known = self.total.shape[0] - 1

    def ratios(self, supports: np.ndarray) -> np.ndarray:
        """ρ of many supports of one size, (n_supports, size) → (n_supports,)."""
        full = np.column_stack([supports, np.full(len(supports), self.known)])
        index = (full[:, :, None], full[:, None, :])
        parts = self.parts[index] + _RIDGE * np.eye(full.shape[1])
        root = np.linalg.inv(np.linalg.cholesky(parts))
        values = np.linalg.eigvalsh(root @ self.total[index] @ root.transpose(0, 2, 1))[:, 0]
        return np.maximum(values, _SMALLEST)  # rounding may leave it below zero


def beam_search(gram: WeakGram, max_size: int, width: int = 8) -> list[list[Support]]:
    """The best supports of each size 1, 2, …, max_size, best first.

    Grows every kept support by one candidate, then swaps single members while that helps.
    """
    scaled = _Scaled(gram)
    n = scaled.known
    kept: list[tuple[int, ...]] = [()]
    levels = []
    for size in range(1, min(max_size, n) + 1):
        grown = {tuple(sorted((*s, k))) for s in kept for k in range(n) if k not in s}
        best = _best(scaled, grown, width)
        seen = set(grown)
        while size < n:
            swapped = {
                tuple(sorted((*(m for m in s.members if m != out), k)))
                for s in best[: max(1, width // 2)]
                for out in s.members
                for k in range(n)
                if k not in s.members
            } - seen
            if not swapped:
                break
            seen |= swapped
            better = _best(scaled, swapped, width)
            merged = sorted([*best, *better], key=lambda s: s.ratio)[:width]
            improved = merged[0].ratio < best[0].ratio * (1 - 1e-9)
            best = merged
            if not improved:
                break
        levels.append(best)
        kept = [s.members for s in best]
    return levels


def _best(scaled: _Scaled, supports: set[tuple[int, ...]], width: int) -> list[Support]:
    candidates = np.array(sorted(supports))
    ratios = np.concatenate([scaled.ratios(block) for block in np.array_split(candidates, 1 + len(candidates) // 4096)])
    top = np.argsort(ratios, kind="stable")[:width]
    return [Support(tuple(int(m) for m in candidates[k]), float(ratios[k])) for k in top]


def solve_support(gram: WeakGram, members: tuple[int, ...]) -> np.ndarray:
    """Coefficients of the free columns for a support, scaled so that the known column has weight one.

    Falls back to least squares on the weak form when the smallest eigenvector leaves the known column out.
    """
    scaled = _Scaled(gram)
    index = np.array([*members, scaled.known])
    parts = scaled.parts[np.ix_(index, index)] + _RIDGE * np.eye(index.size)
    root = np.linalg.inv(np.linalg.cholesky(parts))
    _, vectors = np.linalg.eigh(root @ scaled.total[np.ix_(index, index)] @ root.T)
    vector = root.T @ vectors[:, 0] * scaled.scale[index]
    weight = vector[-1] / scaled.scale[scaled.known]
    out = np.zeros(scaled.known)
    if abs(weight) > 1e-6 * np.abs(root.T @ vectors[:, 0]).max():
        out[list(members)] = vector[:-1] / vector[-1]
    else:
        total = gram.total[np.ix_(index, index)]
        out[list(members)] = -np.linalg.lstsq(total[:-1, :-1], total[:-1, -1], rcond=1e-10)[0]
    return out
