"""Best subsets of candidates on a quadratic model of the likelihood.

About a fit λ₀ with gradient g, the curve eliminated, the cost is a quadratic in all coefficients,

    cost(λ₀ + δ) − cost(λ₀) = 2 gᵀδ + δᵀAδ.

A support S sets δ = −λ₀ outside of S, which is u, and is free to choose δ inside:

    cost(S) = 2 gᵀu + uᵀAu − r_Sᵀ A_SS⁻¹ r_S,      r = g + A u,

so thousands of supports are compared without a refit; relative to the fit itself, because the whole cost is
so large without noise that its last digits would decide.  Each free term costs log n + 2 log K
(extended BIC, Chen & Chen 2008, Biometrika 95:759), which accounts for having searched K candidates.

A local search from the present support cannot leave a group of terms that only together imitate another
group: four exponentials and the powers of their Taylor series.  A second one therefore begins where all
candidates compete at once, by automatic relevance determination (Tipping 2001, JMLR 1:211).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Choice", "QuadraticModel", "relevant", "search_subsets", "term_penalty", "trade_off"]

_RIDGE = 1e-11
_NO_BETTER = 1e-3  # in units of χ²
_VAGUE = 1e-6  # prior precision at the start; 1 is that of the data, the other coefficients held
_IRRELEVANT = 10.0
_ROUNDS = 300
_SETTLED = 1e-2


def term_penalty(n_samples: int, n_candidates: int) -> float:
    """Price of one free term in units of χ²: log n + 2 log K."""
    return float(np.log(max(n_samples, 2)) + 2.0 * np.log(max(n_candidates, 1)))


@dataclass(frozen=True)
class Choice:
    """A support (sorted candidate numbers) and its cost, relative to the fit that the model is about."""

    members: tuple[int, ...]
    cost: float

    def criterion(self, penalty: float) -> float:
        return self.cost + penalty * len(self.members)


class QuadraticModel:
    """Cost of supports from matrix A and gradient at given coefficients.

    Parameters
    ----------
    matrix : (n, n) array
        A, for the candidates that may enter.
    gradient : (n,) array
        Half gradient of the cost at ``coefficients``.
    coefficients : (n,) array
    """

    def __init__(self, matrix: np.ndarray, gradient: np.ndarray, coefficients: np.ndarray) -> None:
        scale = 1.0 / np.sqrt(np.clip(np.diag(matrix), 1e-300, None))
        self.scale = scale
        self.matrix = matrix * np.outer(scale, scale)
        self.gradient = gradient * scale
        self.here = coefficients / scale
        self.n = len(scale)

    def costs(self, supports: np.ndarray) -> np.ndarray:
        """Costs of many supports of one size, (n_supports, size)."""
        away, right = self._outside(supports)
        costs = away @ self.gradient + np.einsum("bk,bk->b", away, right)
        if supports.shape[1]:
            matrix = self.matrix[supports[:, :, None], supports[:, None, :]] + _RIDGE * np.eye(
                supports.shape[1]
            )
            inside = np.take_along_axis(right, supports, axis=1)
            costs -= np.einsum("bk,bk->b", inside, np.linalg.solve(matrix, inside[:, :, None])[:, :, 0])
        return costs

    def _outside(self, supports: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """u and r of every support, (n_supports, n) each."""
        away = np.tile(-self.here, (len(supports), 1))
        np.put_along_axis(away, supports, 0.0, axis=1)
        return away, self.gradient + away @ self.matrix

    def best(self, supports: set[tuple[int, ...]], width: int) -> list[Choice]:
        """The cheapest few of many supports of one size."""
        if not supports:
            return []
        members = np.array(sorted(supports), dtype=int).reshape(len(supports), -1)
        costs = np.concatenate(
            [self.costs(part) for part in np.array_split(members, 1 + len(members) // 4096)]
        )
        top = np.argsort(costs, kind="stable")[:width]
        return [Choice(tuple(int(m) for m in members[k]), float(costs[k])) for k in top]

    def solution(self, members: tuple[int, ...]) -> np.ndarray:
        """(n,) minimising coefficients of a support, zero elsewhere."""
        out = np.zeros(self.n)
        index = list(members)
        if index:
            _, right = self._outside(np.array([index]))
            matrix = self.matrix[np.ix_(index, index)] + _RIDGE * np.eye(len(index))
            step = np.linalg.solve(matrix, right[0, index])
            out[index] = (self.here[index] - step) * self.scale[index]
        return out


def relevant(model: QuadraticModel, penalty: float) -> tuple[int, ...]:
    """A support found from all candidates at once.

    Every coefficient has a normal prior whose precision α maximises the marginal likelihood,
    α_i ← (1 − α_i Σ_ii) / μ_i²; it grows without bound for candidates that are not needed.  Those that
    remain are dropped one by one while that lowers the criterion.
    """
    kept = np.arange(model.n)
    precision = np.full(model.n, _VAGUE)
    right = model.matrix @ model.here - model.gradient
    for _ in range(_ROUNDS):
        try:
            covariance = np.linalg.inv(model.matrix[np.ix_(kept, kept)] + np.diag(precision))
        except np.linalg.LinAlgError:
            break
        mean = covariance @ right[kept]
        determined = np.maximum(1.0 - precision * np.diag(covariance), 1e-12)
        updated = determined / np.maximum(mean**2, 1e-300)
        settled = np.all(np.abs(np.log(updated / precision)) < _SETTLED)
        stays = updated < _IRRELEVANT
        kept, precision = kept[stays], updated[stays]
        if settled or not kept.size:
            break
    here = model.best({tuple(int(k) for k in kept)}, 1)[0]
    while len(here.members) > 1:
        smaller = model.best(_neighbours(here.members, model.n, -1), 1)[0]
        if smaller.criterion(penalty) > here.criterion(penalty):
            break
        here = smaller
    return here.members


def search_subsets(
    model: QuadraticModel, start: tuple[int, ...], penalty: float, width: int = 6
) -> dict[int, list[Choice]]:
    """The best supports of each size met on local searches, best first.

    One begins at a given support, another at that of :func:`relevant`.
    """
    levels = _search_from(model, start, penalty, width)
    other = relevant(model, penalty)
    if other and all(c.members != other for c in levels.get(len(other), [])):
        for size, found in _search_from(model, other, penalty, width).items():
            merged = {c.members: c for c in (*levels.get(size, []), *found)}
            levels[size] = sorted(merged.values(), key=lambda c: c.cost)[:width]
    return levels


def _search_from(
    model: QuadraticModel, start: tuple[int, ...], penalty: float, width: int
) -> dict[int, list[Choice]]:
    """Grow and shrink a support one candidate at a time, with swaps at every size.

    Ends when two more terms (or two fewer) do not improve the criterion.
    """
    levels: dict[int, list[Choice]] = {}
    levels[len(start)] = _swap_until_best(model, model.best({tuple(sorted(start))}, width), width)
    for step in (1, -1):
        size, worse = len(start), 0
        best = levels[size][0].criterion(penalty)
        while worse < 2 and 0 <= size + step <= model.n:
            moved = {m for c in levels[size] for m in _neighbours(c.members, model.n, step)}
            known = {c.members for c in levels.get(size + step, [])}
            size += step
            found = _swap_until_best(model, model.best(moved | known, width), width)
            levels[size] = found
            value = found[0].criterion(penalty)
            worse = 0 if value < best else worse + 1
            best = min(best, value)
    return levels


def trade_off(
    model: QuadraticModel, chosen: tuple[int, ...], above: int = 6, width: int = 6
) -> dict[int, list[Choice]]:
    """The best supports of every size from one to ``above`` more than the chosen one, best first.

    On the way down from the largest, a term that stands for two others gives way to them.
    """
    levels = {len(chosen): _swap_until_best(model, model.best({chosen}, width), width)}
    top = min(len(chosen) + above, model.n)
    upwards = [(size, 1) for size in range(len(chosen) + 1, top + 1)]
    for size, step in (*upwards, *((size, -1) for size in range(top - 1, 0, -1))):
        moved = {m for c in levels[size - step] for m in _neighbours(c.members, model.n, step)}
        known = {c.members for c in levels.get(size, [])}
        levels[size] = _swap_until_best(model, model.best(moved | known, width), width)
    here = levels[len(chosen)]
    if all(c.members != chosen for c in here):
        here += model.best({chosen}, 1)
    return levels


def _neighbours(members: tuple[int, ...], n: int, step: int) -> set[tuple[int, ...]]:
    if step < 0:
        return {tuple(m for m in members if m != out) for out in members}
    return {tuple(sorted((*members, k))) for k in range(n) if k not in members}


def _swap_until_best(model: QuadraticModel, kept: list[Choice], width: int) -> list[Choice]:
    seen = {c.members for c in kept}
    while True:
        swapped = {
            tuple(sorted((*(m for m in c.members if m != out), k)))
            for c in kept[:2]
            for out in c.members
            for k in range(model.n)
            if k not in c.members
        } - seen
        seen |= swapped
        better = model.best(swapped, width)
        merged = sorted([*kept, *better], key=lambda c: c.cost)[:width]
        # Costs that are not numbers are no better either.
        if not merged[0].cost < kept[0].cost - _NO_BETTER:
            return merged
        kept = merged
