"""Best subsets of candidates on a quadratic model of the likelihood.

About a fit λ₀ with gradient g, the curve eliminated, the cost is a quadratic in all coefficients,

    cost(λ₀ + δ) − cost(λ₀) = 2 gᵀδ + δᵀAδ.

A support S sets δ = −λ₀ outside of S, which is u, and is free to choose δ inside:

    cost(S) = 2 gᵀu + uᵀAu − r_Sᵀ A_SS⁻¹ r_S,      r = g + A u,

so thousands of supports are compared without a refit; relative to the fit itself, because the whole cost is
so large without noise that its last digits would decide.  Each free term costs log n + 2 log K
(extended BIC, Chen & Chen 2008, Biometrika 95:759), which accounts for having searched K candidates; where
the candidates have description lengths ℓ, log n + 2 ℓ, of which 2 (ℓ − log K) is in the cost of a support.

One inverse P = A_SS⁻¹ prices every step to a neighbour.  With h = g + A δ at the optimum of S, c = λ₀ + δ,
W = A_{·S} P and s_k = A_kk − W_k A_Sk,

    add k:        −h_k² / s_k
    drop j:       c_j² / P_jj
    j gives way to k:  c_j² / P_jj − (h_k − W_kj c_j / P_jj)² / (s_k + W_kj² / P_jj),

which costs n |S|² operations for all swaps instead of n |S|⁴; the best of them are then solved one by one.

A local search from the present support cannot leave a group of terms that only together imitate another
group: four exponentials and the powers of their Taylor series.  A second one therefore begins where all
candidates compete at once, by automatic relevance determination (Tipping 2001, JMLR 1:211).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from leastaction.selection.settings import SELECTION

__all__ = ["Choice", "QuadraticModel", "relevant", "search_subsets", "term_penalty", "trade_off"]

_RIDGE = 1e-11  # relative to a unit diagonal
_NO_BETTER = 1e-3  # in units of χ²
_VAGUE = 1e-6  # prior precision at the start, relative to that of the data with the other coefficients fixed
_ROUNDS = 300  # of relevance determination, at most
_SETTLED = 1e-2  # relative change of every prior precision
_LARGEST = 1e150  # whose square is still a number
_SPARE = 18  # neighbours solved in addition, since rounding may reorder near-ties


def term_penalty(n_samples: int, n_candidates: int) -> float:
    """Price of one free term in units of χ²: log n + 2 log K."""
    return float(np.log(max(n_samples, 2)) + 2.0 * np.log(max(n_candidates, 1)))


@dataclass(frozen=True)
class Choice:
    """A support (sorted candidate numbers) and its cost, relative to the fit that the model is about.

    The surcharges of its members are in the cost.
    """

    members: tuple[int, ...]
    cost: float

    def criterion(self, penalty: float) -> float:
        return self.cost + penalty * len(self.members)


class Neighbours(NamedTuple):
    """Costs of the supports one step from ``members``.

    Attributes
    ----------
    added : (n,) array
        With one candidate more; infinite for members.
    removed : (n_members,) array
        Without each member.
    swapped : (n_members, n) array
        With a candidate in the place of each member; infinite for members.
    """

    members: tuple[int, ...]
    added: np.ndarray
    removed: np.ndarray
    swapped: np.ndarray

    def larger(self, count: int) -> set[tuple[int, ...]]:
        """The cheapest supports with one candidate more."""
        return {tuple(sorted((*self.members, k))) for k in _lowest(self.added, count)}

    def smaller(self, count: int) -> set[tuple[int, ...]]:
        """The cheapest supports with one member fewer."""
        return {self.members[:j] + self.members[j + 1 :] for j in _lowest(self.removed, count)}

    def exchanged(self, count: int) -> set[tuple[int, ...]]:
        """The cheapest supports with one member exchanged."""
        n = self.swapped.shape[1]
        pairs = (divmod(flat, n) for flat in _lowest(self.swapped.ravel(), count))
        return {tuple(sorted((*self.members[:j], *self.members[j + 1 :], k))) for j, k in pairs}


def _lowest(costs: np.ndarray, count: int) -> list[int]:
    """Places of the lowest finite costs; where none is a number, places of the first."""
    if count < costs.size:
        places = np.argpartition(costs, count)[:count]
    else:
        places = np.arange(costs.size)
    return [int(k) for k in places if costs[k] != np.inf]


class QuadraticModel:
    """Cost of supports from matrix A and gradient at given coefficients.

    Parameters
    ----------
    matrix : (n, n) array
        A, for the candidates that may enter.
    gradient : (n,) array
        Half gradient of the cost at ``coefficients``.
    coefficients : (n,) array
    surcharges : (n,) array, optional
        What each candidate costs beyond the price of a term.
    """

    def __init__(
        self,
        matrix: np.ndarray,
        gradient: np.ndarray,
        coefficients: np.ndarray,
        surcharges: np.ndarray | None = None,
    ) -> None:
        scale = 1.0 / np.sqrt(np.clip(np.diag(matrix), 1e-300, None))
        self.scale = scale
        self.matrix: np.ndarray = matrix * np.outer(scale, scale)
        self.gradient: np.ndarray = gradient * scale
        self.here: np.ndarray = coefficients / scale
        self.n: int = len(scale)
        self.surcharges: np.ndarray = np.zeros(self.n) if surcharges is None else surcharges

    def among(self, columns: Sequence[int]) -> QuadraticModel:
        """The model of some columns, in scaled coefficients; those of the others are held."""
        kept = list(columns)
        matrix = self.matrix[np.ix_(kept, kept)]
        return QuadraticModel(matrix, self.gradient[kept], self.here[kept], self.surcharges[kept])

    def costs(self, supports: np.ndarray) -> np.ndarray:
        """Costs of many supports of one size, (n_supports, size)."""
        away, right = self._outside(supports)
        costs = away @ self.gradient + np.einsum("bk,bk->b", away, right)
        costs += self.surcharges[supports].sum(axis=1)
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

    def neighbours(self, members: tuple[int, ...]) -> Neighbours:
        """Costs of all supports that differ from one by a candidate more, one fewer, or one exchanged."""
        index = np.array(members, dtype=int)
        away, right = (part[0] for part in self._outside(index[None]))
        border = self.matrix[:, index]
        inverse = np.linalg.inv(border[index] + _RIDGE * np.eye(len(index)))
        inside = -inverse @ right[index]
        cost = away @ self.gradient + away @ right + inside @ right[index] + self.surcharges[index].sum()
        gradient = right + border @ inside
        turned = border @ inverse
        pivot = np.maximum(np.diag(self.matrix) + _RIDGE - np.einsum("kj,kj->k", turned, border), _RIDGE)
        # the ridge holds the steps δ_S: a candidate that enters brings its own, one that leaves takes it
        held = _RIDGE * self.here**2 + self.surcharges
        pull = gradient - _RIDGE * self.here
        added = cost - pull**2 / pivot + held
        step = (self.here[index] + inside) / np.diag(inverse)
        removed = cost + (self.here[index] + inside) * step - held[index]
        moved = (pull - (turned * step).T) ** 2 / (pivot + (turned**2 / np.diag(inverse)).T)
        swapped = removed[:, None] - moved + held
        added[index], swapped[:, index] = np.inf, np.inf
        return Neighbours(members, added, removed, swapped)

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
        mean = np.clip(covariance @ right[kept], -_LARGEST, _LARGEST)
        # Between 0 and 1 but for rounding, which a singular matrix makes large.
        determined = np.clip(1.0 - precision * np.diag(covariance), 1e-12, 1.0)
        updated = determined / np.maximum(mean**2, 1e-300)
        settled = np.all(np.abs(np.log(updated) - np.log(precision)) < _SETTLED)
        stays = updated < SELECTION.irrelevant
        kept, precision = kept[stays], updated[stays]
        if settled or not kept.size:
            break
    here = model.best({tuple(int(k) for k in kept)}, 1)[0]
    while len(here.members) > 1:
        smaller = model.best(model.neighbours(here.members).smaller(1 + _SPARE), 1)[0]
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
            moved = _resized(model, levels[size], step, width)
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
        moved = _resized(model, levels[size - step], step, width)
        known = {c.members for c in levels.get(size, [])}
        levels[size] = _swap_until_best(model, model.best(moved | known, width), width)
    here = levels[len(chosen)]
    if all(c.members != chosen for c in here):
        here += model.best({chosen}, 1)
    return levels


def _resized(model: QuadraticModel, kept: list[Choice], step: int, width: int) -> set[tuple[int, ...]]:
    """The cheapest supports with one candidate more, or fewer, than those kept."""
    found: set[tuple[int, ...]] = set()
    for choice in kept:
        near = model.neighbours(choice.members)
        found |= near.larger(width + _SPARE) if step > 0 else near.smaller(width + _SPARE)
    return found


def _swap_until_best(model: QuadraticModel, kept: list[Choice], width: int) -> list[Choice]:
    tried: set[tuple[int, ...]] = set()
    while True:
        swapped: set[tuple[int, ...]] = set()
        for choice in kept[:2]:
            if choice.members not in tried:
                swapped |= model.neighbours(choice.members).exchanged(2 * width + _SPARE)
        tried |= {choice.members for choice in kept[:2]}
        swapped -= {choice.members for choice in kept}
        better = model.best(swapped, width)
        merged = sorted([*kept, *better], key=lambda c: c.cost)[:width]
        # A cost that is not a number is not an improvement.
        if not merged[0].cost < kept[0].cost - _NO_BETTER:
            return merged
        kept = merged
