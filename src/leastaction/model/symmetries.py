r"""Symmetries of a law, and the conserved quantity of each (Noether 1918).

A change of the coordinates, δq = ξ(q), that leaves L unchanged up to dF/dt conserves

.. math:: Σ_i ξ_i ∂L/∂q̇_i − F

if neither friction nor a force acts along ξ. The conditions of a symmetry on the coefficients are linear,
A λ = 0 (`leastaction.library.invariance`). The statistic (A λ)ᵀ (A Σ Aᵀ)⁻¹ A λ, with the covariance Σ, is
tested against χ² at the false-alarm rate of `leastaction.selection.significance`. There is no correction for
the number of symmetries, which would make it easier to claim one. Shape parameters are fixed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
import sympy as sp

from leastaction.errors import InputError
from leastaction.library import Term, format_expression
from leastaction.library.invariance import Change, Invariance, exchanges, reversal, translations, turns
from leastaction.library.jets import Jets
from leastaction.mechanics.equations import state_symbols
from leastaction.model.checks import angles_in
from leastaction.model.notation import latex_number, latex_symbols
from leastaction.model.numbers import covariance_of
from leastaction.selection.significance import chi_square_cutoff, normal_cutoff

if TYPE_CHECKING:
    from leastaction.model.model import LagrangianModel

__all__ = ["Symmetry", "find_symmetries"]

Kind = Literal["cyclic", "translation", "rotation", "exchange", "time reversal", "time translation"]

_EXACT = 1e-9  # relative: difference of coefficients that are given as equal
_DIGITS = 5  # of coefficients of a conserved quantity, for display
_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+(?:e[-+]?\d+)?|e[-+]?\d+)")
_FRACTION = re.compile(r"(?<![\w.])(\d+)(\*[\w*]+)?/(\d{4,})(?![\w.])")  # a long one, such as 12345*x/15625
_MOST_TRIALS, _MOST_TIMES = 60, 2000  # for which the drift is computed


@dataclass(frozen=True)
class Symmetry:
    """A change of variables that leaves L unchanged, and the conserved quantity.

    Attributes
    ----------
    kind : str
        "cyclic" (L does not depend on a coordinate, up to a total derivative), "translation" (of several
        coordinates together), "rotation", "exchange", "time reversal" or "time translation".
    coordinates : tuple of str
        Coordinates that it changes: planes (x, y), (z, w), … of a rotation, or all for a change of time.
    change : str
        The change, such as ``"x1 + c, x2 + c"``, ``"turn of (x, y)"`` or ``"x1 <-> x2"``.
    holds : {"in form", "in numbers", "within errors"}
        For any coefficients; because the given coefficients satisfy its conditions; or because the estimated
        ones satisfy them within their errors.
    conditions : int
        Number of combinations of coefficients that must vanish and have a standard error.
    chi2 : float
        Test statistic of these combinations, with `conditions` degrees of freedom.
    precision : float
        Relative standard error of the least precise of them: a smaller violation is undetectable.
    quantity : str
        Expression of the conserved quantity; empty if there is none (exchange, time reversal) or it could not
        be expressed. `written` is the same with rounded numbers.
    latex : str
        The same for math mode, with rounded numbers.
    obstacles : tuple of str
        Why the quantity is not conserved, or the motion not symmetric: "friction", "forces" (known forces act
        along it in the recording) or "prescribed" (unknown forces act).
    drift : float
        Rms deviation of the quantity from its mean along the fitted curve of the worst trial, relative to the
        mean sum of the magnitudes of its terms. NaN with obstacles or without a curve.

    Examples
    --------
    >>> from leastaction import LagrangianModel
    >>> from leastaction.model.term import ModelTerm
    >>> orbit = LagrangianModel(["r", "phi"], [ModelTerm("r_dot**2", 0.5), ModelTerm("r**2*phi_dot**2", 0.5),
    ...                                        ModelTerm("1/r", 4.0)])
    >>> for symmetry in orbit.symmetries: print(symmetry.kind, "|", symmetry.change, "|", symmetry.quantity)
    cyclic | phi + c | phi_dot*r**2
    time reversal | t -> -t |
    time translation | t + c | 0.5*phi_dot**2*r**2 + 0.5*r_dot**2 - 4.0/r
    """

    kind: Kind
    coordinates: tuple[str, ...]
    change: str
    holds: Literal["in form", "in numbers", "within errors"]
    conditions: int = 0
    chi2: float = 0.0
    precision: float = 0.0
    quantity: str = ""
    latex: str = ""
    obstacles: tuple[str, ...] = ()
    drift: float = math.nan

    @property
    def name(self) -> str:
        """Its name for display, with its coordinates."""
        if self.kind == "cyclic":
            return f"cyclic coordinate {self.coordinates[0]}"
        if self.kind == "rotation":
            return f"rotation{self.change.removeprefix('turn')}"
        return self.kind if self.kind.startswith("time") else f"{self.kind} {self.change}"

    @property
    def written(self) -> str:
        """The quantity with numbers of five digits."""
        text = _FRACTION.sub(lambda f: f"{int(f[1]) / int(f[3])!r}{f[2] or ''}", self.quantity)
        return _NUMBER.sub(lambda found: f"{float(found[0]):.{_DIGITS}g}", text)


def find_symmetries(model: LagrangianModel) -> tuple[Symmetry, ...]:
    """The symmetries of a model: of its coordinates, of bodies, of the time.

    Translations, rotations and exchanges that follow from others are left out.  A law that depends on time is
    not searched.
    """
    if model.timed:
        return ()
    return tuple(_Search(model).run())


@dataclass(frozen=True)
class _Verdict:
    """Test of the coefficients against the conditions of a symmetry."""

    holds: Literal["in form", "in numbers", "within errors"]
    conditions: int = 0
    chi2: float = 0.0
    precision: float = 0.0


class _Search:
    """The search for all symmetries of a model."""

    def __init__(self, model: LagrangianModel) -> None:
        self.model = model
        names = model.coordinates
        self.q, self.v, _ = state_symbols(names)
        self.terms = [Term(t.expression, e) for t, e in zip(model.terms, model.expressions, strict=True)]
        self.friction = [
            Term(t.expression, e, "dissipation")
            for t, e in zip(model.dissipation, model.dissipation_expressions, strict=True)
        ]
        self.invariance = Invariance(self.terms, names)
        self.coefficients = np.array([term.coefficient for term in model.terms])
        self.strengths = np.array([term.coefficient for term in model.dissipation])
        covariance, n = covariance_of(model), len(model.terms)
        self.covariance = covariance[:n, :n]
        self.friction_covariance = covariance[n : n + len(model.dissipation), n : n + len(model.dissipation)]
        self.pushed = _pushed(model)

    def run(self) -> Iterator[Symmetry]:
        model = self.model
        free = [name for name in model.coordinates if name not in model.prescribed]
        angles = angles_in(model.coordinates, model.provenance)
        positions = [name for name in free if name not in angles]
        groups = [group for group in (positions, [n for n in free if n in angles]) if group]
        fields: list[np.ndarray] = []
        planes: list[set[frozenset[str]]] = []
        for change in translations(model.coordinates, groups):
            found = self._continuous("cyclic" if len(change.names) == 1 else "translation", change, fields)
            if found:
                yield found
        for change in turns(model.coordinates, positions):
            found = self._continuous("rotation", change, fields)
            if found:
                planes.append(_pairs(found.coordinates))
                yield found
        yield from self._exchanges(groups, planes)
        back = reversal(model.coordinates)
        verdict = self._verdict(back)
        if verdict:
            yield _symmetry("time reversal", back, verdict, obstacles=("friction",) * bool(self.friction))
        yield self._energy()

    def _continuous(self, kind: Kind, change: Change, fields: list[np.ndarray]) -> Symmetry | None:
        """A translation or rotation, unless it follows from the fields of those found before."""
        if np.linalg.matrix_rank(np.array([*fields, change.field])) <= len(fields):
            return None
        verdict = self._verdict(change)
        if verdict is None:
            return None
        fields.append(change.field)
        quantity = self._momentum(change)
        touched = [i for i, name in enumerate(self.model.coordinates) if name in change.names]
        obstacles = ("friction",) * self._rubs(change) + ("forces",) * bool(self.pushed.intersection(touched))
        return self._with_quantity(kind, change, verdict, quantity, obstacles)

    def _exchanges(
        self, groups: Sequence[Sequence[str]], planes: Sequence[set[frozenset[str]]]
    ) -> Iterator[Symmetry]:
        """Exchanges that do not follow from rotations or from other exchanges."""
        equal = {name: name for name in self.model.coordinates}  # name → representative of its class
        friction = Invariance(self.friction, self.model.coordinates) if self.friction else None
        for change in exchanges(self.model.coordinates, groups):
            pairs = _pairs(change.names)
            if pairs in planes or all(len({equal[name] for name in pair}) == 1 for pair in pairs):
                continue
            verdict = self._verdict(change)
            if verdict is None:
                continue
            if len(pairs) == 1:
                one, other = (equal[name] for name in change.names)
                equal = {name: one if same == other else same for name, same in equal.items()}
            rows = friction.conditions(change) if friction else np.zeros((0, 0))
            alike = rows is not None and _judge(rows, self.strengths, self.friction_covariance) is not None
            yield _symmetry("exchange", change, verdict, obstacles=() if alike else ("friction",))

    def _energy(self) -> Symmetry:
        model = self.model
        parts = [v * sp.diff(model.lagrangian, v) for v in self.v]
        acting = {"friction": self.friction, "forces": self.pushed, "prescribed": model.prescribed}
        obstacles = tuple(name for name, present in acting.items() if present)
        still = reversal(model.coordinates)
        change = Change("t + c", model.coordinates, still.matrix, still.shift, still.turn, still.direction)
        quantity = sp.expand_mul(sp.Add(*parts) - model.lagrangian)
        return self._with_quantity("time translation", change, _Verdict("in form"), quantity, obstacles)

    def _verdict(self, change: Change) -> _Verdict | None:
        rows = self.invariance.conditions(change)
        return None if rows is None else _judge(rows, self.coefficients, self.covariance)

    def _field(self, change: Change) -> list[sp.Expr]:
        """ξ over the symbols of the coordinates."""
        turned = [sp.Add(*(int(a) * x for a, x in zip(row, self.q, strict=True))) for row in change.turn]
        return [part + int(b) for part, b in zip(turned, change.direction, strict=True)]

    def _momentum(self, change: Change) -> sp.Expr | None:
        """Σ ξ_i ∂L/∂q̇_i − F; None if F cannot be expressed."""
        field, law = self._field(change), self.model.lagrangian
        momentum = sp.Add(*(x * sp.diff(law, v) for x, v in zip(field, self.v, strict=True)))
        gained = self._potential_of(field)
        return None if gained is None else sp.expand(momentum - gained)

    def _potential_of(self, field: list[sp.Expr]) -> sp.Expr | None:
        """F such that dF/dt is the change of L, from its addends a_i(q) q̇_i with polynomials a_i."""
        still = dict.fromkeys(self.v, sp.Integer(0))
        momenta = [sp.diff(self.model.lagrangian, v).subs(still) for v in self.v]  # linear in the velocities
        out: sp.Expr = sp.Integer(0)
        for j, x in enumerate(self.q):
            slope = sp.Add(
                *(xi * sp.diff(momenta[j], y) for xi, y in zip(field, self.q, strict=True)),
                *(p * sp.diff(xi, x) for xi, p in zip(field, momenta, strict=True)),
            )
            out += x * slope
        out = sp.expand(out)
        if not out.is_polynomial(*self.q):
            return None
        parts = sp.Poly(out, *self.q).terms()
        return sp.Add(
            *(
                c / sum(powers) * sp.Mul(*(x**n for x, n in zip(self.q, powers, strict=True)))
                for powers, c in parts
                if sum(powers)
            )
        )

    def _rubs(self, change: Change) -> bool:
        """Whether friction acts along the field: Σ_i ξ_i ∂ψ/∂q̇_i does not vanish."""
        if not self.friction:
            return False
        points = self.invariance.points
        jets = Jets(self.model.coordinates, points)
        field = change.turn @ points.q + change.direction[:, None]
        parts = np.array(
            [c * (field * jets.effect(term)) for c, term in zip(self.strengths, self.friction, strict=True)]
        )
        inside = parts[:, :, np.isfinite(parts).all(axis=(0, 1))]
        return bool(np.abs(inside.sum(axis=(0, 1))).max() > _EXACT * np.abs(inside).sum(axis=(0, 1)).max())

    def _with_quantity(
        self,
        kind: Kind,
        change: Change,
        verdict: _Verdict,
        quantity: sp.Expr | None,
        obstacles: tuple[str, ...],
    ) -> Symmetry:
        if quantity is None or quantity == 0:  # an ignored coordinate has no momentum
            return _symmetry(kind, change, verdict, obstacles=obstacles)
        try:
            text, latex = _written(quantity, latex_symbols(self.model.coordinates))
        except InputError:  # a derivative of |u| is not in the grammar
            text = latex = ""
        drift = math.nan if obstacles else _drift(self.model, quantity)
        return _symmetry(kind, change, verdict, text, latex, obstacles, drift)


def _pairs(names: Sequence[str]) -> set[frozenset[str]]:
    """Names that stand next to each other, as unordered pairs."""
    return {frozenset(names[k : k + 2]) for k in range(0, len(names), 2)}


def _symmetry(
    kind: Kind,
    change: Change,
    verdict: _Verdict,
    quantity: str = "",
    latex: str = "",
    obstacles: tuple[str, ...] = (),
    drift: float = math.nan,
) -> Symmetry:
    what = kind, change.names, change.text, verdict.holds
    figures = verdict.conditions, verdict.chi2, verdict.precision
    return Symmetry(*what, *figures, quantity, latex, obstacles, drift)


def _written(quantity: sp.Expr, symbols: dict[sp.Symbol, str]) -> tuple[str, str]:
    """A sum as text with all digits of its coefficients, and as LaTeX with rounded ones."""
    text = latex = ""
    for part in quantity.as_ordered_terms():
        number, factor = part.as_coeff_Mul()
        size, name = abs(float(number)), format_expression(factor)
        lead = ("+ " if text else "") if float(number) > 0 else "- " if text else "-"
        short = latex_number(f"{size:.{_DIGITS}g}")
        body = name if size == 1.0 else f"{size!r}{name[1:] if name.startswith('1/') else '*' + name}"
        text += f" {lead}{body}" if text else f"{lead}{body}"
        long = [n for n in factor.atoms(sp.Number) if getattr(n, "q", 1000) > 999]
        brief = factor.xreplace({n: sp.Float(float(n), _DIGITS) for n in long})
        latex += f" {lead}" if latex else lead
        latex += ("" if short == "1" else rf"{short} \, ") + sp.latex(brief, symbol_names=symbols)
    return text, latex


def _judge(rows: np.ndarray, coefficients: np.ndarray, covariance: np.ndarray) -> _Verdict | None:
    """The test of A λ = 0 within the errors; None if it fails, or if the errors are too large to decide.

    Combinations of given coefficients have no errors and must vanish exactly.
    """
    if not len(rows):
        return _Verdict("in form")
    variances, along = np.linalg.eigh(rows @ covariance @ rows.T)
    parts = (along.T @ rows) * coefficients  # addends of each independent combination
    sizes, values = np.linalg.norm(parts, axis=1), parts.sum(axis=1)
    errors = np.sqrt(np.maximum(variances, 0.0))
    exact = errors <= _EXACT * sizes
    if np.any(np.abs(values[exact]) > _EXACT * sizes[exact]):
        return None
    values, errors, sizes = values[~exact], errors[~exact], sizes[~exact]
    if not values.size:
        return _Verdict("in numbers")
    chi2, precision = float(np.sum((values / errors) ** 2)), float(np.max(errors / sizes))
    # a combination whose addends could all be zero has no power
    if chi2 > chi_square_cutoff(values.size) or precision > 1.0 / normal_cutoff():
        return None
    return _Verdict("within errors", values.size, chi2, precision)


def _pushed(model: LagrangianModel) -> set[int]:
    """Coordinates on which known forces act in the recording."""
    if model.diagnostics is None:
        return set()
    pushed = {model.coordinates.index(name) for name in model.diagnostics.force_offset}
    for trial in model.diagnostics.trajectories:
        if trial.forces is not None:
            pushed |= set(np.flatnonzero(np.nan_to_num(trial.forces).any(axis=0)).tolist())
    return pushed


def _drift(model: LagrangianModel, quantity: sp.Expr) -> float:
    """Deviation of a quantity from its mean along the fitted curves, relative to its addends; NaN without."""
    diagnostics = model.diagnostics
    if diagnostics is None:
        return math.nan
    points = diagnostics.grid.split(diagnostics.control_points)
    departures: list[float] = []
    sizes: list[float] = []
    for k in model.own_trials(len(diagnostics.trajectories))[:_MOST_TRIALS]:
        trial = diagnostics.trajectories[k]
        t = np.linspace(float(trial.t[0]), float(trial.t[-1]), min(_MOST_TIMES, 4 * trial.n_times))
        q, qdot = (diagnostics.grid.spaces[k].evaluate(points[k], t, nu) for nu in (0, 1))
        parts = model.mechanics.evaluate(sp.Add.make_args(quantity), q, qdot, t)
        departures.append(float(np.std(parts.sum(axis=0))))
        sizes.append(float(np.abs(parts).sum(axis=0).mean()))
    scale = float(np.mean(sizes))
    return max(departures) / scale if scale > 0 else math.nan
