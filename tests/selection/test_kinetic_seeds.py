"""Combinations of kinetic terms, the cheapest first."""

from __future__ import annotations

import time
from itertools import islice, product

import numpy as np
import pytest

from leastaction.selection.kinetic_seeds import cheapest_combinations


def some_options(seed: int, n: int, most: int):
    """Costs with many ties; some coordinates are held up by a known term, which costs nothing."""
    rng = np.random.default_rng(seed)
    free = iter(rng.permutation(n * most).tolist())
    out = []
    for _ in range(n):
        each = [(int(rng.integers(1, 4)), (next(free),)) for _ in range(int(rng.integers(1, most + 1)))]
        out.append(sorted(each + [(0, ())] * int(rng.integers(0, 2))))
    return out


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_sequence_is_that_of_sorting_all(seed, n):
    options = some_options(seed, n, 5)
    everything = sorted(
        (sum(cost for cost, _ in parts), sum((m for _, m in parts), ())) for parts in product(*options)
    )
    assert list(cheapest_combinations(options)) == [members for _, members in everything]


def test_ten_coordinates_cost_little():
    """8**10 combinations: sorting them all is out of the question."""
    options = [[(1 + c // 2, (8 * i + c,)) for c in range(8)] for i in range(10)]
    begin = time.process_time()
    first = list(islice(cheapest_combinations(options), 60))
    assert time.process_time() - begin < 1.0
    assert len(set(first)) == 60
    assert first[0] == tuple(range(0, 80, 8))
    costs = [sum(1 + m % 8 // 2 for m in members) for members in first]
    assert costs == sorted(costs)
    assert costs[-1] == 10  # 2**10 combinations have the lowest cost
