"""Search for redundant candidates: null terms, and linear combinations of others.

Each candidate is a column: E_i[φ] = Σ_j φ_{q̇i q̇j} q̈_j + Σ_j φ_{q̇i qj} q̇_j − φ_{qi} (or ∂ψ/∂q̇_i) at
random states.  Double precision proposes zero and dependent columns. Arithmetic with 60 digits at new states
decides, so that nearly collinear candidates are never dropped.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import sympy

from leastaction.library.jets import Jets, Points
from leastaction.library.term import Dropped, Term

__all__ = ["find_redundant", "same_functions"]

_PROPOSE = 1e-6  # relative residual of a proposed column: far above rounding; the exact check decides
_DIGITS = 60
_ZERO = 1e-40
_CONFIRM = 1e-30
_MANY_DIGITS = 400  # a hundred smooth functions of one variable can agree with another one to 1e-60
_CONFIRM_MANY = mpmath.mpf("1e-200")
_EXTRA_POINTS = 20
_MIN_POINTS = 400
_MARGIN = 5
_FEW = 8
_SOME = 64  # a product of sums of four rates has 10 parts or more
_FEW_POINTS = 12
_MAX_SUMMANDS = 6


@np.errstate(all="ignore")  # states outside the domain of a term are left out of its columns
def find_redundant(
    terms: Sequence[Term],
    coordinates: Sequence[str],
    keep: Collection[int] = (),
    prescribed: Collection[int] = (),
    seed: int = 0,
) -> dict[int, Dropped]:
    """Find the terms to leave out: null terms, multiples of another term, and sums of others.

    Parameters
    ----------
    terms
        Candidates, of the Lagrangian and of the dissipation function.
    coordinates
        Names of the coordinates.
    keep
        Indices of terms that stay if there is a choice; otherwise earlier terms stay.
    prescribed
        Indices of coordinates whose equations are ignored.
    seed
        Seed of the random states; the result does not depend on it.

    Returns
    -------
    dict
        Index of each redundant term → description.

    Examples
    --------
    >>> from leastaction.library.term import make_term
    >>> terms = [make_term(text, ["x", "x_dot"]) for text in ("x_dot**2", "x*x_dot", "2+x", "x")]
    >>> for index, dropped in find_redundant(terms, ["x"]).items():
    ...     print(index, dropped.reason, "|", dropped.because)
    1 null | total time derivative
    3 duplicate | equals 2+x up to a null term
    """
    return _Search(terms, coordinates, prescribed, seed).run(set(keep))


@np.errstate(all="ignore")
def same_functions(wanted: sympy.Expr, others: Sequence[sympy.Expr], coordinates: Sequence[str]) -> list[int]:
    """Return the indices of the expressions that are the same function as the first one.

    Examples
    --------
    >>> x = sympy.Symbol("x", real=True)
    >>> same_functions(1 - sympy.cos(x) ** 2, [x, sympy.sin(x) ** 2], ["x"])
    [1]
    """
    points = Points.draw(np.random.default_rng(7), len(coordinates), 24)
    jets = Jets(coordinates, points)
    value = jets.jet(wanted)[0]
    close: list[int] = []
    for k, other in enumerate(others):
        candidate = jets.jet(other)[0]
        finite = np.isfinite(value)
        if finite.any() and np.array_equal(finite, np.isfinite(candidate)):
            scale = 1e-9 * (1 + np.max(np.abs(value[finite])))
            if np.max(np.abs(value[finite] - candidate[finite])) <= scale:
                close.append(k)
    if not close:
        return []
    exact = Jets(coordinates, points[np.flatnonzero(np.isfinite(value))[:_FEW_POINTS]].with_digits(_DIGITS))
    value = exact.jet(wanted)[0]
    limit = _CONFIRM * (1 + max(abs(value)))
    return [k for k in close if max(abs(exact.jet(others[k])[0] - value)) <= limit]


class _Search:
    """One analysis: the columns in double precision, and the exact check behind it."""

    def __init__(
        self, terms: Sequence[Term], coordinates: Sequence[str], prescribed: Collection[int], seed: int
    ) -> None:
        self.terms, self.prescribed = terms, prescribed
        self.found: dict[int, Dropped] = {}
        rng = np.random.default_rng(seed)
        n_dof, n_points = len(coordinates), max(_MIN_POINTS, 3 * (len(terms) + _EXTRA_POINTS))
        self.pool = Points.draw(rng, n_dof, n_points)
        weights = rng.normal(size=(n_dof - len(prescribed), n_points))
        jets = Jets(coordinates, self.pool, prescribed)
        self.effects = np.empty((len(terms), *weights.shape))
        self.finite = np.empty((len(terms), n_points), dtype=bool)
        self.scales: list[float] = []
        for k, term in enumerate(terms):
            jet = jets.fresh(term.expr)  # whole terms do not recur, so only parts are cached
            self.effects[k] = jets.effect_of(jet, term)
            self.finite[k] = np.isfinite(self.effects[k]).all(axis=0) & np.isfinite(jet.sum(axis=0))
            self.scales.append(_size(jet))
        # one random combination of the equations at each state, as in the exact check
        self.mixtures = np.einsum("kip,ip->kp", self.effects, weights)
        self.exact = _ExactColumns(terms, coordinates, prescribed, self.pool, weights)

    def run(self, keep: set[int]) -> dict[int, Dropped]:
        order = [*sorted(keep), *(k for k in range(len(self.terms)) if k not in keep)]
        order = [k for k in order if self.finite[k].any() and not self._is_null(k)]
        while order:
            narrow: list[int] = []
            rows = np.flatnonzero(self.finite[order].all(axis=0))
            while len(rows) < len(order) + _MARGIN and len(order) > 1:
                # Domains that hardly overlap: the narrowest one is examined separately later.
                narrow.append(min(order, key=lambda k: self.finite[k].sum()))
                order.remove(narrow[-1])
                rows = np.flatnonzero(self.finite[order].all(axis=0))
            self.exact.forget()
            self._eliminate(order, rows)
            order = [k for k in sorted(narrow) if k in keep] + [k for k in sorted(narrow) if k not in keep]
        return dict(sorted(self.found.items()))

    def _inside(self, involved: list[int]) -> np.ndarray:
        return np.flatnonzero(self.finite[involved].all(axis=0))[-_FEW_POINTS:]

    def _is_null(self, k: int) -> bool:
        inside = self._inside([k])
        if _size(self.effects[k]) > _PROPOSE * self.scales[k]:
            return False
        if not self.exact.is_null(k, inside):
            return False
        term = self.terms[k]
        if self.exact.is_constant(k, inside):
            because = "constant"
        elif self.prescribed:
            because = "no effect on the equations of the coordinates that are not prescribed"
        elif term.kind == "dissipation":
            because = "no force: it does not depend on a velocity"
        else:
            because = "total time derivative"
        self.found[k] = Dropped(term, "null", because)
        return True

    def _eliminate(self, order: list[int], rows: np.ndarray) -> None:
        """Take the columns one by one; a column that is nearly a sum of earlier ones gets the exact check."""
        basis = np.zeros((len(rows), len(order)), order="F")
        triangle = np.zeros((len(order), len(order)))
        accepted: list[int] = []
        for k in order:
            column = self.mixtures[k, rows]
            if not column.any():
                continue  # it acts only at other states, so no column here can replace it
            m, left = len(accepted), column / np.abs(column).max()
            left /= np.linalg.norm(left)
            weights = np.zeros(m)
            for _ in range(2):  # two passes give orthogonality to rounding
                step = basis[:, :m].T @ left
                left = left - basis[:, :m] @ step
                weights += step
            size = float(np.linalg.norm(left))
            if size < _PROPOSE:
                coefficients = self._confirm(k, accepted, triangle[:m, :m], weights, rows)
                if coefficients is not None:
                    if self._holds_elsewhere(k, coefficients):
                        self._note(k, coefficients)
                    continue
            basis[:, m] = left / (size or 1.0)
            triangle[:m, m], triangle[m, m] = weights, size or 1.0
            accepted.append(k)

    def _confirm(
        self, k: int, accepted: list[int], triangle: np.ndarray, weights: np.ndarray, rows: np.ndarray
    ) -> dict[int, Any] | None:
        """Coefficients of term k as a sum of accepted ones, in high precision, or None.

        The double precision coefficients only select the terms to try first.
        """
        guess = np.abs(np.linalg.solve(triangle, weights)) if accepted else np.zeros(0)
        for threshold in (1e-4, 1e-8):
            support = [a for a, size in zip(accepted, guess, strict=True) if size > threshold * guess.max()]
            if not 0 < len(support) <= _SOME:
                continue
            few = len(support) <= _FEW
            attempt = self.exact.coefficients_of_few if few else self.exact.coefficients_of_some
            coefficients = attempt(k, support, rows)
            if coefficients is not None:
                return coefficients
        return self.exact.coefficients_of_all(k, accepted, rows)

    def _holds_elsewhere(self, k: int, coefficients: dict[int, Any]) -> bool:
        """Check in double precision wherever these terms are defined: |x| equals x on one side only."""
        involved = [k, *coefficients]
        inside = self.finite[involved].all(axis=0)
        parts = [self.effects[k], *(-float(c) * self.effects[a] for a, c in coefficients.items())]
        scale = np.sum([np.abs(part[:, inside]) for part in parts], axis=0)
        return bool(np.all(np.abs(sum(part[:, inside] for part in parts)) <= 1e-6 * (scale + scale.mean())))

    def _note(self, k: int, coefficients: dict[int, Any]) -> None:
        text = _combination([(_nice(c), self.terms[a]) for a, c in coefficients.items()])
        kinds = {self.terms[a].kind for a in (k, *coefficients)}
        if len(kinds) > 1:
            because = f"gives the same equations as {text}"
        elif self.exact.same_value(k, coefficients, self._inside([k, *coefficients])):
            because = f"equals {text}"
        else:
            because = f"equals {text} up to a null term"
        reason = "duplicate" if len(coefficients) == 1 else "dependent"
        combination = tuple((float(c), self.terms[a]) for a, c in coefficients.items())
        self.found[k] = Dropped(self.terms[k], reason, because, combination)


class _ExactColumns:
    """Columns in 60-digit arithmetic: one random combination of the equations at each state."""

    def __init__(
        self,
        terms: Sequence[Term],
        coordinates: Sequence[str],
        prescribed: Collection[int],
        pool: Points,
        weights: np.ndarray,
    ) -> None:
        self.terms, self.coordinates, self.prescribed = terms, coordinates, prescribed
        self.pool, self.weights = pool, weights
        self._jets: dict[tuple[bytes, int], Jets] = {}
        self.forget()

    def forget(self) -> None:
        """Start a new set of accepted terms."""
        self._all = _Elimination(_CONFIRM_MANY)

    def _at(self, rows: np.ndarray, digits: int = _DIGITS) -> Jets:
        key = rows.tobytes(), digits
        if key not in self._jets:
            self._jets[key] = Jets(self.coordinates, self.pool[rows].with_digits(digits), self.prescribed)
        return self._jets[key]

    def _column(self, k: int, rows: np.ndarray, digits: int) -> np.ndarray:
        jets = self._at(rows, digits)
        return (jets.effect(self.terms[k]) * jets.lift(self.weights[:, rows])).sum(axis=0)

    def is_null(self, k: int, rows: np.ndarray) -> bool:
        jets = self._at(rows)
        scale = np.max(np.abs(jets.jet(self.terms[k].expr)))
        return np.max(np.abs(jets.effect(self.terms[k]))) <= _CONFIRM * scale

    def is_constant(self, k: int, rows: np.ndarray) -> bool:
        jet = self._at(rows).jet(self.terms[k].expr)
        return np.max(np.abs(jet[1:])) <= _CONFIRM * np.max(np.abs(jet))

    def same_value(self, k: int, coefficients: dict[int, Any], rows: np.ndarray) -> bool:
        jets = self._at(rows)
        parts = [jets.jet(self.terms[k].expr)[0]]
        parts += [-c * jets.jet(self.terms[a].expr)[0] for a, c in coefficients.items()]
        total = sum(parts[1:], parts[0])
        return max(np.abs(total)) <= _CONFIRM * max(max(abs(part)) for part in parts)

    def coefficients_of_few(self, k: int, support: list[int], rows: np.ndarray) -> dict[int, Any] | None:
        """Return c with column_k = Σ c_a column_a over a small support, or None if there is no such c."""
        return self._solve(_Elimination(_CONFIRM), k, support, rows[-_FEW_POINTS:], _DIGITS)

    def coefficients_of_some(self, k: int, support: list[int], rows: np.ndarray) -> dict[int, Any] | None:
        """The same with the digits and tolerance of the check over all terms, over the relevant ones."""
        n_rows = -(-(len(support) + _MARGIN) // _FEW_POINTS) * _FEW_POINTS  # few different sets of states
        return self._solve(_Elimination(_CONFIRM_MANY), k, support, rows[-n_rows:], _MANY_DIGITS)

    def coefficients_of_all(self, k: int, accepted: list[int], rows: np.ndarray) -> dict[int, Any] | None:
        """The same over all accepted terms; later calls reuse the elimination."""
        return self._solve(self._all, k, accepted, rows[-(len(self.terms) + _MARGIN) :], _MANY_DIGITS)

    def _solve(
        self, elimination: _Elimination, k: int, support: list[int], rows: np.ndarray, digits: int
    ) -> dict[int, Any] | None:
        for a in support[elimination.n_taken :]:
            elimination.add(a, self._column(a, rows, digits))
        return elimination.solve(self._column(k, rows, digits))


class _Elimination:
    """Gaussian elimination, column by column; `tolerance` is relative."""

    def __init__(self, tolerance: Any) -> None:
        self.tolerance = tolerance
        self.n_taken = 0
        self.labels: list[int] = []
        self._columns: list[np.ndarray] = []
        self._pivots: list[int] = []
        self._factors: list[list[Any]] = []

    def _reduce(self, column: np.ndarray) -> tuple[np.ndarray, list[Any]]:
        factors: list[Any] = []
        for pivot, eliminated in zip(self._pivots, self._columns, strict=True):
            factors.append(column[pivot])
            column = column - column[pivot] * eliminated
        return column, factors

    def add(self, label: int, column: np.ndarray) -> None:
        left, factors = self._reduce(column)
        self.n_taken += 1
        if max(abs(left)) <= self.tolerance * max(abs(column)):
            return  # independent of the others only at states outside these rows
        pivot = int(np.argmax(np.abs(left)))
        self.labels.append(label)
        self._columns.append(left / left[pivot])
        self._pivots.append(pivot)
        self._factors.append([*factors, left[pivot]])

    def solve(self, column: np.ndarray) -> dict[int, Any] | None:
        left, wanted = self._reduce(column)
        if max(abs(left)) > self.tolerance * max(abs(column)):
            return None
        solution: list[Any] = [0] * len(wanted)
        for j in reversed(range(len(wanted))):
            later = sum(solution[i] * self._factors[i][j] for i in range(j + 1, len(wanted)))
            solution[j] = (wanted[j] - later) / self._factors[j][j]
        # The rounding error of a zero coefficient is far below any coefficient of an identity.
        return {a: c for a, c in zip(self.labels, solution, strict=True) if abs(c) > _ZERO}


def _size(values: np.ndarray) -> float:
    """Return the largest finite absolute value."""
    return float(np.max(np.abs(values), where=np.isfinite(values), initial=0.0))


def _nice(value: Any) -> Fraction | float:
    """Return a high-precision number as a short fraction if it is one."""
    fraction = Fraction(str(value)).limit_denominator(10**6)
    return fraction if abs(fraction - Fraction(str(value))) < Fraction(1, 10**20) else float(value)


def _combination(parts: list[tuple[Fraction | float, Term]]) -> str:
    text = ""
    for factor, term in parts[:_MAX_SUMMANDS]:
        body = f"({term.text})" if term.expr.is_Add and (factor != 1 or len(parts) > 1) else term.text
        size = abs(factor)
        if isinstance(size, Fraction) and size.denominator > 1:
            body = f"({size})*{body}"
        elif size != 1:
            body = f"{float(size):.6g}*{body}"
        sign = ("- " if factor < 0 else "+ ") if text else ("-" if factor < 0 else "")
        text += f" {sign}{body}" if text else f"{sign}{body}"
    return text + (" + ..." if len(parts) > _MAX_SUMMANDS else "")
