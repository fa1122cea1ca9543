"""Search for supports on the weak form, by how well noise explains what is left.

A support S is judged by

    ρ(S) = min over λ of λᵀ R λ / λᵀ (N + ε S) λ,

the smallest generalised eigenvalue of two small matrices: R is the sum of squared row residuals, N what the
measurement noise makes of that sum on average, and ε the squared relative size of the equation error.
For the true support ρ is about one, whatever the units and the noise; λ is the total-least-squares
estimate, free of the bias that noisy columns give to plain least squares.  The ratio cannot be made small
by letting candidates cancel a known term: their noise remains.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import islice

import numpy as np
import sympy as sp

from leastaction.curve.smoothing import Smooth
from leastaction.data.validation import FloatArray
from leastaction.estimation.grid import Grid
from leastaction.estimation.intervals import first_points
from leastaction.selection.weak_form import WeakGram

__all__ = [
    "Option",
    "ScaledGram",
    "Support",
    "beam_search",
    "best_extensions",
    "cheapest_combinations",
    "choose",
    "grow_bases",
    "inverse_root",
    "kinetic_bases",
    "noise_ratio",
    "solve_support",
    "support_score",
]

_RIDGE = 1e-12  # relative to a unit diagonal
_SMALLEST = 1e-13  # ratio that rounding leaves
_DEPENDENT = 1e-9  # of a column that others can write
_BISECTIONS = 45  # to rounding
_STEPS = 7  # of the root finder; six settle nearly all
_SETTLED = 1e-9  # relative step of the root finder
_SWAP_ROUNDS = 6  # through all members, at most
_WIDE = 64  # supports kept of those that are not complete
_PATIENCE = 4  # sizes in turn without a better score


@dataclass(frozen=True)
class Support:
    """A set of free columns and its ratio ρ."""

    members: tuple[int, ...]
    ratio: float


class ScaledGram:
    """Both matrices with unit diagonal of the reference, so that a ridge means the same for every column."""

    def __init__(self, gram: WeakGram, error: float) -> None:
        reference = gram.noise + error * gram.size
        scale = 1.0 / np.sqrt(np.clip(np.diag(reference), 1e-300, None))
        self.scale = scale
        self.residual: np.ndarray = gram.residual * np.outer(scale, scale)
        self.reference: np.ndarray = reference * np.outer(scale, scale)
        self.known: int = self.residual.shape[0] - 1

    def ratio(self, members: tuple[int, ...]) -> float:
        """ρ of one support."""
        index = np.array([*members, self.known])
        root = inverse_root(self.reference[np.ix_(index, index)])
        return max(
            float(np.linalg.eigvalsh(root @ self.residual[np.ix_(index, index)] @ root.T)[0]), _SMALLEST
        )

    def extended(self, supports: np.ndarray) -> np.ndarray:
        """ρ of every support with every candidate added: (n_supports, size) → (n_supports, n_candidates).

        With the support's own eigenvectors V (VᵀNV = 1, VᵀRV = diag μ) one more column borders a diagonal
        matrix; the smallest eigenvalue x of that arrow matrix is the root below min μ of

            α − x − Σ_j a_j² / (μ_j − x) = 0.

        Candidates that are in the support already get infinity.
        """
        index = np.column_stack([supports, np.full(len(supports), self.known)]).astype(int)
        pick = (index[:, :, None], index[:, None, :])
        root = inverse_root(self.reference[pick])
        mu, vectors = np.linalg.eigh(root @ self.residual[pick] @ root.transpose(0, 2, 1))
        mu = np.maximum(mu, _SMALLEST)  # rounding may leave it below zero
        basis = vectors.transpose(0, 2, 1) @ root
        a, b = basis @ self.residual[index], basis @ self.reference[index]
        rest = np.maximum(1.0 - (b**2).sum(axis=1), _DEPENDENT)  # what the new column adds
        alpha = np.diag(self.residual) - 2.0 * (a * b).sum(axis=1) + (mu[:, :, None] * b**2).sum(axis=1)
        squares = (a - mu[:, :, None] * b) ** 2 / rest[:, None, :]
        ratios = _smallest_root(alpha / rest, squares, mu)
        # a column that depends on the support adds nothing but rounding errors
        ratios = np.where(rest > _DEPENDENT, ratios, mu[:, :1])
        np.put_along_axis(ratios, index, np.inf, axis=1)
        return ratios[:, : self.known]


def inverse_root(matrices: np.ndarray) -> np.ndarray:
    """R with R G Rᵀ = 1 for symmetric matrices G of unit diagonal, which rounding may leave indefinite."""
    ridge = _RIDGE
    while True:
        try:
            return np.linalg.inv(np.linalg.cholesky(matrices + ridge * np.eye(matrices.shape[-1])))
        except np.linalg.LinAlgError:
            if ridge > 1.0:
                raise
            ridge *= 100.0


def _smallest_root(alpha: FloatArray, squares: FloatArray, mu: FloatArray) -> FloatArray:
    """Root of f = α − x − Σ_j s_j / (μ_j − x) in (0, min μ), where f falls from positive to −∞.

    Each step keeps the nearest pole and takes a tangent of the rest.  The rest is concave, so the root of
    the model lies above that of f, and the steps fall to it quadratically.  Where they have not settled
    (poles that coincide), bisection follows.
    """
    first, least = mu[:, :1], 1e-15 * mu[:, :1]
    pole, others, rest = squares[:, 0], mu[:, 1:, None], squares[:, 1:]
    x: FloatArray = np.broadcast_to(0.5 * first, alpha.shape)
    moved = np.full(alpha.shape, np.inf)
    for _ in range(_STEPS):
        gap = np.maximum(others - x[:, None, :], least[:, :, None])
        part = rest / gap
        slope: FloatArray = 1.0 + (part / gap).sum(axis=1)
        offset: FloatArray = alpha - x - part.sum(axis=1) - slope * (first - x)
        root: FloatArray = np.sqrt(offset**2 + 4.0 * slope * pole)
        above: FloatArray = 2.0 * pole / np.maximum(offset + root, 1e-300)
        distance = np.where(offset > 0.0, above, (root - offset) / (2.0 * slope))
        new = np.clip(first - distance, 0.0, first)
        x, moved = new, np.abs(new - x)
    row, k = np.nonzero(moved > _SETTLED * (x + least))
    if row.size:
        x[row, k] = _bisect(alpha[row, k], squares[row, :, k], mu[row])
    return np.maximum(x, _SMALLEST)


def _bisect(alpha: np.ndarray, squares: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """The same root, one row a problem."""
    low, high = np.zeros_like(alpha), mu[:, 0].copy()
    for _ in range(_BISECTIONS):
        x = 0.5 * (low + high)
        gap = np.maximum(mu - x[:, None], 1e-300)
        above = alpha - x - (squares / gap).sum(axis=1) > 0.0
        low, high = np.where(above, x, low), np.where(above, high, x)
    return high


def beam_search(
    gram: WeakGram, error: float, penalty: float, n_rows: float, width: int = 8
) -> list[list[Support]]:
    """The best supports of each size 1, 2, …, best first.

    Grows every kept support by one candidate, then swaps single members while that helps.  Ends when four
    more terms have not improved :func:`support_score`.

    Parameters
    ----------
    error : float
        ε, the squared size of the equation error relative to the rows.
    """
    scaled = ScaledGram(gram, error)
    kept: list[Support] = [Support((), np.inf)]
    levels: list[list[Support]] = []
    best, since = np.inf, 0
    for size in range(1, scaled.known + 1):
        # two terms often make sense together only: all pairs are tried
        kept = best_extensions(scaled, {s.members for s in kept}, scaled.known if size == 1 else width)
        kept = _swapped(scaled, kept, width) if size > 2 else kept
        levels.append(kept)
        value = support_score(kept[0], penalty, n_rows)
        best, since = (value, 0) if value < best else (best, since + 1)
        if since == _PATIENCE:
            break
    return levels


def choose(
    scaled: ScaledGram, base: tuple[int, ...], kinds: Sequence[tuple[range, int]], width: int = 8
) -> list[Support]:
    """The best supports of some columns and, of each kind of others, as many as it says; best first."""
    kept = [Support(base, np.inf)]
    *others, last = [columns for columns, count in kinds for _ in range(count)]
    for columns in others:  # often only both together improve the fit
        kept = best_extensions(scaled, {s.members for s in kept}, _WIDE, columns)
    kept = best_extensions(scaled, {s.members for s in kept}, width, last)
    return _swapped(scaled, kept, width, [columns for columns, _ in kinds]) if others else kept


def _swapped(
    scaled: ScaledGram, kept: list[Support], width: int, kinds: Sequence[range] | None = None
) -> list[Support]:
    """Supports in which single members were swapped for others of their kind while that helps."""
    for _ in range(_SWAP_ROUNDS):
        best = kept[: width // 2]
        swapped = list[Support]()
        for kind in kinds or [range(scaled.known)]:
            smaller = {tuple(k for k in s.members if k != m) for s in best for m in s.members if m in kind}
            swapped += best_extensions(scaled, smaller, width, kind)
        merged = sorted({s.members: s for s in [*swapped, *kept]}.values(), key=lambda s: s.ratio)[:width]
        improved = merged[0].ratio < kept[0].ratio * (1 - 1e-6)
        kept = merged
        if not improved:
            break
    return kept


def grow_bases(
    gram: WeakGram,
    error: float,
    penalty: float,
    n_rows: float,
    bases: list[tuple[int, ...]],
    width: int = 3,
) -> list[list[Support]]:
    """Supports grown from each of several bases, which stay in them; all sizes, best first in each.

    Ends when no base has been improved by four more terms. A base of all candidates is a support itself.
    """
    scaled = ScaledGram(gram, error)
    kept = [{base} for base in bases]
    best, since = np.full(len(bases), np.inf), 0
    whole = [Support(base, scaled.ratio(base)) for base in bases if len(base) >= scaled.known]
    levels: list[list[Support]] = [whole] if whole else []
    while since < _PATIENCE:
        level: list[Support] = []
        values = np.full(len(bases), np.inf)
        for b, supports in enumerate(kept):
            if max(map(len, supports)) >= scaled.known:
                continue
            found = best_extensions(scaled, supports, width)
            kept[b] = {support.members for support in found}
            values[b] = support_score(found[0], penalty, n_rows)
            level += found
        if not level:
            break
        levels.append(sorted({s.members: s for s in level}.values(), key=lambda s: s.ratio))
        since = 0 if np.any(values < best) else since + 1
        best = np.minimum(best, values)
    return levels


def support_score(support: Support, penalty: float, n_rows: float, noise: float = 1.0) -> float:
    """n_rows · log ρ/noise + penalty · size, with ρ below the noise counted as noise: less is not better.

    Parameters
    ----------
    noise : float
        ρ that noise alone leaves: one, or what `noise_ratio` finds.
    """
    return n_rows * float(np.log(max(support.ratio / noise, 1.0))) + penalty * len(support.members)


def noise_ratio(full: float, n_candidates: int, n_rows: float) -> float:
    """What ρ of the law is where the noise of the rows is overestimated, from ρ of the whole library.

    A library that holds the law leaves noise less one row a candidate; one that does not leaves more than
    noise, and one remains the limit.  Where rows are fewer than two a candidate, nothing can be told.
    """
    left = 1.0 - n_candidates / n_rows
    return min(1.0, full / left) if left > 0.5 else 1.0


def best_extensions(
    scaled: ScaledGram, supports: set[tuple[int, ...]], width: int, columns: range | None = None
) -> list[Support]:
    """The best distinct supports that have one candidate more than those given, of some columns."""
    base = np.array(sorted(supports), dtype=int).reshape(len(supports), -1)
    ratios = scaled.extended(base)
    if columns is not None:
        ratios[:, : columns.start] = ratios[:, columns.stop :] = np.inf
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


def solve_support(gram: WeakGram, error: float, members: tuple[int, ...]) -> np.ndarray:
    """Coefficients of the free columns for a support, scaled so that the known column has weight one.

    Falls back to least squares on the weak form when the smallest eigenvector leaves the known column out.
    """
    scaled = ScaledGram(gram, error)
    index = np.array([*members, scaled.known])
    root = inverse_root(scaled.reference[np.ix_(index, index)])
    _, vectors = np.linalg.eigh(root @ scaled.residual[np.ix_(index, index)] @ root.T)
    vector = root.T @ vectors[:, 0] * scaled.scale[index]
    weight = vector[-1] / scaled.scale[scaled.known]
    out = np.zeros(scaled.known)
    if abs(weight) > 1e-6 * np.abs(root.T @ vectors[:, 0]).max():
        out[list(members)] = vector[:-1] / vector[-1]
    else:
        total = gram.residual[np.ix_(index, index)]
        out[list(members)] = -np.linalg.lstsq(total[:-1, :-1], total[:-1, -1], rcond=1e-10)[0]
    return out


# ------------------------------------------------------------------ kinetic energies to grow a support from
Option = tuple[int, tuple[int, ...]]
"""Number of operations of an expression, and the position of its column (none if a known term serves)."""

_MOST_BASES = 60  # each with a beam of its own
_MOST_EACH = 8  # candidates for the mass of one coordinate
_POINTS = 400  # along the motion
_TINY = 1e-9  # relative: rounding


def kinetic_bases(grid: Grid, smooth: Smooth) -> list[tuple[int, ...]]:
    """Positions among the free columns, the simplest expressions first; at least the empty set.

    A kinetic energy is positive whatever the velocities, so its mass matrix has a positive diagonal; nearly
    every Lagrangian of mechanics therefore holds, for each coordinate, a candidate q̇_i² g(q) with g ≥ 0.
    """
    problem = grid.problem
    stride = max(1, grid.spline.n_intervals // _POINTS)
    points = first_points(grid.spline, smooth.control_points, slice(None, None, stride))
    n = problem.trajectories.n_dof
    options: list[list[Option]] = [[] for _ in range(n)]
    fixed = problem.completed(0.0)
    given = problem.candidates.mass_matrix(points, fixed)
    for i in range(n):
        if np.all(given[:, i, i] > 0.0):  # a known term already makes it positive
            options[i].append((0, ()))
    velocities = {sp.Symbol(f"{name}_dot", real=True) for name in problem.coordinates}
    for position, k in enumerate(problem.free):
        if velocities.isdisjoint(problem.terms[int(k)].expr.free_symbols):
            continue  # a potential has no mass
        mass = problem.candidates.mass_of(int(k), points)
        size = np.abs(mass).max(axis=0)
        (touched,) = np.nonzero(np.diag(size) > _TINY * size.max(initial=1e-300))
        diagonal = size.sum() - np.trace(size) <= _TINY * size.sum()
        if len(touched) == 1 and diagonal:
            values = mass[:, touched[0], touched[0]]
            if values.min() >= -_TINY * values.max():
                operations = int(problem.terms[int(k)].expr.count_ops())
                options[int(touched[0])].append((operations, (position,)))
    options = [sorted(each)[:_MOST_EACH] or [(0, ())] for each in options]
    return [tuple(sorted(members)) for members in islice(cheapest_combinations(options), _MOST_BASES)]


def cheapest_combinations(options: Sequence[Sequence[Option]]) -> Iterator[tuple[int, ...]]:
    """Yield the members of all combinations, one option of each coordinate, the cheapest first.

    Best-first: each combination but the first has one parent, in which its last option that is not a cheapest
    one is the option before.  No child is cheaper than its parent, so a heap that holds the children of what
    was yielded has the next one on top: seven coordinates cost no more than two.

    Parameters
    ----------
    options
        For each coordinate, in rising sequence; none empty.

    Examples
    --------
    >>> list(cheapest_combinations([[(1, (0,)), (3, (1,))], [(1, (2,)), (2, (3,))]]))
    [(0, 2), (0, 3), (1, 2), (1, 3)]
    """

    def entry(choice: tuple[int, ...]) -> tuple[int, tuple[int, ...], tuple[int, ...]]:
        parts = [each[c] for each, c in zip(options, choice, strict=True)]
        return sum(cost for cost, _ in parts), sum((m for _, m in parts), ()), choice

    heap = [entry((0,) * len(options))]
    while heap:
        _, members, choice = heappop(heap)
        yield members
        last = max((i for i, c in enumerate(choice) if c), default=0)
        for i in range(last, len(options)):
            if choice[i] + 1 < len(options[i]):
                heappush(heap, entry((*choice[:i], choice[i] + 1, *choice[i + 1 :])))
