"""Candidate functions of (q, q̇, f) for the accelerations of a mechanical system."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations_with_replacement, product

import numpy as np

__all__ = ["Dictionary"]


class Dictionary:
    """Products of harmonics of the angles and monomials of everything else.

    Harmonics are 1, cos(n·θ) and sin(n·θ) for whole numbers n with Σ|nᵢ| ≤ ``max_harmonic``, so that
    differences of angles are among them.  Monomials are those of the other coordinates and the velocities up
    to ``max_degree``, quadratic in the velocities at most, and each force alone.

    Parameters
    ----------
    coordinates, angles : sequence of str
    forced : bool
        Whether forces act.
    max_harmonic, max_degree : int
    """

    def __init__(
        self,
        coordinates: Sequence[str],
        angles: Sequence[str],
        forced: bool,
        max_harmonic: int,
        max_degree: int,
    ) -> None:
        self.coordinates = tuple(coordinates)
        self._angles = [i for i, c in enumerate(coordinates) if c in angles]
        others = [i for i in range(len(coordinates)) if i not in self._angles]
        self._waves = _whole_numbers(len(self._angles), max_harmonic)
        n = len(coordinates)
        # places in (q, q̇, f)
        rates = [n + i for i in range(n)]
        self._monomials: list[tuple[int, ...]] = []
        for fast in (w for k in range(3) for w in combinations_with_replacement(rates, k)):
            for k in range(max(max_degree - len(fast), 0) + 1):
                self._monomials += [(*m, *fast) for m in combinations_with_replacement(others, k)]
        if forced:
            self._monomials += [(2 * n + i,) for i in range(n)]
        n_harmonics = 1 + 2 * len(self._waves)
        self._pairs = np.array(list(product(range(n_harmonics), range(len(self._monomials)))))
        self.names = tuple(self._name(h, m) for h, m in self._pairs)

    def __len__(self) -> int:
        return len(self._pairs)

    def __call__(self, q, qdot, forces=None, select: np.ndarray | None = None) -> np.ndarray:
        """Values of the selected candidates, (n_times, n_selected)."""
        pairs = self._pairs if select is None else self._pairs[select]
        state = [*np.transpose(q), *np.transpose(qdot)]
        state += [*np.transpose(np.zeros_like(qdot) if forces is None else forces)]
        phases = [sum(n * state[i] for n, i in zip(w, self._angles, strict=True)) for w in self._waves]
        one = np.ones(len(q))
        harmonics = [one, *(f(phase) for phase in phases for f in (np.cos, np.sin))]
        used = dict.fromkeys(pairs[:, 1].tolist(), one)
        for m in used:
            for place in self._monomials[m]:
                used[m] = used[m] * state[place]
        out = np.empty((len(q), len(pairs)), order="F")
        for column, (h, m) in enumerate(pairs):
            np.multiply(harmonics[h], used[m], out=out[:, column])
        return out

    def _name(self, harmonic: int, monomial: int) -> str:
        names = [*self.coordinates, *(f"{c}_dot" for c in self.coordinates)]
        names += [f"f_{c}" for c in self.coordinates]
        factors = [names[place] for place in self._monomials[monomial]]
        if harmonic:
            wave = self._waves[(harmonic - 1) // 2]
            terms = [f"{n:+d}*{names[i]}" for n, i in zip(wave, self._angles, strict=True) if n]
            phase = "".join(terms).replace("1*", "").removeprefix("+")
            factors.append(f"{'cos' if harmonic % 2 else 'sin'}({phase})")
        return "*".join(factors) or "1"


def _whole_numbers(n: int, limit: int) -> list[tuple[int, ...]]:
    """Tuples with sum of absolute values from 1 to limit, one of each pair ±w."""
    every = product(range(-limit, limit + 1), repeat=n)
    return [w for w in every if 0 < sum(map(abs, w)) <= limit and next(k for k in w if k) > 0]
