"""Backward search on the weak form: from the whole library, leaving out one term after the other.

A forward search has to pass supports that explain nearly nothing, and may end among them: of four driven
links it takes 2 to 17 terms instead of 18.  The whole library holds the law from the beginning.  With

    λᵀ R λ / λᵀ N λ,    R V = N V diag μ,    Vᵀ N V = 1,

taking out term k leaves the smallest eigenvalue x between μ_1 and μ_2 with

    [(R − x N)⁻¹]_kk = Σ_j V_kj² / (μ_j − x) = 0,

so one eigenproblem a support judges every term in it.  From n candidates to one that is n small eigenproblems
times the width of the beam.

The whole library has to leave noise and no less, so rows must outnumber the candidates.
"""

from __future__ import annotations

import numpy as np

from leastaction.selection.weak_form import WeakGram
from leastaction.selection.weak_search import ScaledGram, Support, best_extensions, inverse_root

__all__ = ["backward_search"]

_BISECTIONS = 45  # to rounding
_ONE_BY_ONE = 120  # candidates; from larger libraries, several are removed at once
_AT_ONCE = 10  # at most one member in ten is removed at once


def backward_search(
    gram: WeakGram, error: float, penalty: float, n_rows: float, width: int = 4
) -> list[list[Support]]:
    """The best supports of the sizes 1, 2, … on the way down from all candidates, best first in each.

    After each step down, the term that helps most is added to what the next step down would leave, and kept
    where that is a better support of the same size: so a term that was left out early can come back.

    Parameters
    ----------
    gram, error, penalty, n_rows
        As for `beam_search`.  The price of a term decides only how many of more than 120 candidates go at
        once: as many as together raise the cost by less than half their price, at most a tenth.
    width : int
        Supports that are kept of each size.

    Examples
    --------
    >>> rows = np.random.default_rng(0).standard_normal((200, 4))
    >>> rows[:, 3] = -(rows[:, 0] + 2.0 * rows[:, 2]) + 0.01 * rows[:, 3]
    >>> matrix = rows.T @ rows
    >>> gram = WeakGram(matrix, np.zeros((4, 4)), np.diag(np.diag(matrix)), 200)
    >>> backward_search(gram, 1e-4, 5.0, 200.0)[1][0].members
    (0, 2)
    """
    scaled = ScaledGram(gram, error)
    everything = tuple(range(scaled.known))
    kept = [Support(everything, scaled.ratio(everything))]
    levels = [kept]
    while len(kept[0].members) > _ONE_BY_ONE:
        kept = [_without_many(scaled, kept[0], penalty / n_rows)]
        levels.append(kept)
    while len(kept[0].members) > 1:
        smaller = _reductions(scaled, kept, width)
        if len(smaller[0].members) > 1:
            base = {s.members for s in _reductions(scaled, smaller[:1], width)}
            again = best_extensions(scaled, base, width)
            smaller = sorted({s.members: s for s in [*again, *smaller]}.values(), key=lambda s: s.ratio)[
                :width
            ]
        levels.append(smaller)
        kept = smaller
    return levels[::-1]


def _without_many(scaled: ScaledGram, support: Support, price: float) -> Support:
    """The support without its least valuable terms, as many as the price of a term allows at once."""
    count = min(len(support.members) // _AT_ONCE, len(support.members) - _ONE_BY_ONE)
    sequence = _reductions(scaled, [support], max(count, 1))
    out = [next(iter({*support.members}.difference(s.members))) for s in sequence]
    while len(out) > 1:
        members = tuple(m for m in support.members if m not in out)
        ratio = scaled.ratio(members)
        if np.log(ratio / support.ratio) < 0.5 * price * len(out):
            return Support(members, ratio)
        out = out[: len(out) // 2]
    return sequence[0]


@np.errstate(over="ignore", invalid="ignore")  # at a pole a term is infinite, and decides
def _reductions(scaled: ScaledGram, supports: list[Support], width: int) -> list[Support]:
    """The best distinct supports that have one member less than those given."""
    index = np.array([(*s.members, scaled.known) for s in supports])
    pick = (index[:, :, None], index[:, None, :])
    root = inverse_root(scaled.reference[pick])
    mu, vectors = np.linalg.eigh(root @ scaled.residual[pick] @ root.transpose(0, 2, 1))
    squares = (root.transpose(0, 2, 1) @ vectors)[:, :-1] ** 2  # the known column stays
    low = np.broadcast_to(mu[:, :1], squares.shape[:2]).copy()
    high = np.broadcast_to(mu[:, 1:2], squares.shape[:2]).copy()
    for _ in range(_BISECTIONS):  # the sum rises from −∞ at μ_1 to ∞ at μ_2
        x = 0.5 * (low + high)
        gap = mu[:, None, :] - x[:, :, None]
        gap[gap == 0.0] = 1e-300
        below = (squares / gap).sum(axis=2) < 0.0
        low, high = np.where(below, x, low), np.where(below, high, x)
    found: dict[tuple[int, ...], Support] = {}
    for flat in np.argsort(high, axis=None, kind="stable"):
        row, k = divmod(int(flat), high.shape[1])
        members = supports[row].members
        rest = (*members[:k], *members[k + 1 :])
        found.setdefault(rest, Support(rest, max(float(high[row, k]), 1e-13)))
        if len(found) == width:
            break
    return list(found.values())
