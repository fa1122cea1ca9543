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
_DEPENDENT = 1e-9
_BISECTIONS = 45
_SWAP_ROUNDS = 6
_PATIENCE = 4


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

    def extended(self, supports: np.ndarray) -> np.ndarray:
        """ρ of every support with every candidate added: (n_supports, size) → (n_supports, n_candidates).

        With the support's own eigenvectors V (VᵀGV = 1, VᵀTV = diag μ) one more column borders a diagonal
        matrix; the smallest eigenvalue x of that arrow matrix is the root below min μ of

            α − x − Σ_j a_j² / (μ_j − x) = 0.

        Candidates that are in the support already get infinity.
        """
        index = np.column_stack([supports, np.full(len(supports), self.known)]).astype(int)
        pick = (index[:, :, None], index[:, None, :])
        root = np.linalg.inv(np.linalg.cholesky(self.parts[pick] + _RIDGE * np.eye(index.shape[1])))
        mu, vectors = np.linalg.eigh(root @ self.total[pick] @ root.transpose(0, 2, 1))
        mu = np.maximum(mu, _SMALLEST)  # rounding may leave it below zero
        basis = vectors.transpose(0, 2, 1) @ root
        a, b = basis @ self.total[index], basis @ self.parts[index]
        rest = np.maximum(1.0 - (b**2).sum(axis=1), _DEPENDENT)  # what the new column adds to the parts
        alpha = np.diag(self.total) - 2.0 * (a * b).sum(axis=1) + (mu[:, :, None] * b**2).sum(axis=1)
        squares = (a - mu[:, :, None] * b) ** 2 / rest[:, None, :]
        ratios = _smallest_root(alpha / rest, squares, mu)
        np.put_along_axis(ratios, index, np.inf, axis=1)
        return ratios[:, : self.known]


def _smallest_root(alpha: np.ndarray, squares: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """Root of α − x − Σ_j s_j / (μ_j − x) in (0, min μ), where it falls from positive to −∞, by bisection."""
    low = np.zeros_like(alpha)
    high = np.broadcast_to(mu[:, :1], alpha.shape).copy()
    for _ in range(_BISECTIONS):
        x = 0.5 * (low + high)
        gap = np.maximum(mu[:, :, None] - x[:, None, :], 1e-300)
        above = alpha - x - (squares / gap).sum(axis=1) > 0.0
        low, high = np.where(above, x, low), np.where(above, high, x)
    return np.maximum(high, _SMALLEST)


def beam_search(
    gram: WeakGram, penalty: float, n_rows: float, max_size: int, width: int = 8
) -> list[list[Support]]:
    """The best supports of each size 1, 2, …, best first.

    Grows every kept support by one candidate, then swaps single members while that helps.  Ends when four
    more terms have not improved n_rows · log ρ + penalty · size.
    """
    scaled = _Scaled(gram)
    kept: list[Support] = [Support((), np.inf)]
    levels: list[list[Support]] = []
    best, since = np.inf, 0
    for size in range(1, min(max_size, scaled.known) + 1):
        kept = _best_extensions(scaled, {s.members for s in kept}, width)
        for _ in range(_SWAP_ROUNDS):
            smaller = {s.members[:m] + s.members[m + 1 :] for s in kept[: width // 2] for m in range(size)}
            swapped = _best_extensions(scaled, smaller, width)
            merged = sorted({s.members: s for s in [*swapped, *kept]}.values(), key=lambda s: s.ratio)[:width]
            improved = merged[0].ratio < kept[0].ratio * (1 - 1e-6)
            kept = merged
            if not improved:
                break
        levels.append(kept)
        value = n_rows * np.log(kept[0].ratio) + penalty * size
        best, since = (value, 0) if value < best else (best, since + 1)
        if since == _PATIENCE:
            break
    return levels


def _best_extensions(scaled: _Scaled, supports: set[tuple[int, ...]], width: int) -> list[Support]:
    """The best distinct supports that have one candidate more than those given."""
    base = np.array(sorted(supports), dtype=int).reshape(len(supports), -1)
    ratios = scaled.extended(base)
    size = base.shape[1] + 1
    found: dict[tuple[int, ...], Support] = {}
    # the same support is reached from each of its parts
    for flat in np.argsort(ratios, axis=None, kind="stable")[: width * size]:
        row, k = divmod(int(flat), ratios.shape[1])
        if not np.isfinite(ratios[row, k]) or len(found) == width:
            break
        members = tuple(sorted((*(int(m) for m in base[row]), k)))
        found.setdefault(members, Support(members, float(ratios[row, k])))
    return list(found.values())


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
