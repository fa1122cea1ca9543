"""Text of a model: summary line, formula, table, LaTeX."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, cast

import sympy as sp

from leastaction.errors import InputError, MissingPackageError
from leastaction.findings import as_given
from leastaction.identifiers import names_in_terms, quoted
from leastaction.library import parse_expression, shape_symbol
from leastaction.model.notation import (
    coefficient_text,
    interval_text,
    latex_number,
    latex_sum,
    latex_symbols,
    plain_sum,
    rounded,
    shape_symbols,
    z_text,
)

if TYPE_CHECKING:
    import pandas as pd

    from leastaction.model.constants import SimpleConstants
    from leastaction.model.model import LagrangianModel
    from leastaction.model.symmetries import Symmetry
    from leastaction.model.term import ModelTerm

__all__ = [
    "CONSERVED",
    "Written",
    "agreement",
    "formula",
    "frame",
    "latex",
    "outcome",
    "reach",
    "resting_lines",
    "rows",
    "shown_quantity",
    "simple_lines",
    "smoothing_notes",
    "summary",
    "symmetry_lines",
    "table",
    "weighted_sum",
]

_HEADER = ("term", "kind", "coefficient", "std. error", "95 % interval", "z")


class Written:
    """Text, tables and formulas of a model."""

    @property
    def _whole(self) -> LagrangianModel:
        return cast("LagrangianModel", self)

    def table(self) -> pd.DataFrame:
        """Coefficients with standard errors, shape parameters, and differences between groups of trials.

        Shape parameters have their names in braces, and differences read ``x_dot**2 in payload``.

        Returns
        -------
        pandas.DataFrame
            Index ``expression``, as it was given; columns ``kind`` ("lagrangian", "dissipation", "shape" or
            "difference"), ``coefficient``, ``standard_error``, ``lower`` and ``upper`` (95 % interval), ``z``
            (NaN if known), ``known``.

        Raises
        ------
        InputError
            If pandas is not installed (extra ``pandas``); it is also an ImportError.
        """
        return frame(self._whole)

    def to_frame(self) -> pd.DataFrame:
        """Return `table`; trajectories, simulations and forecasts have a method of the same name."""
        return frame(self._whole, "to_frame()")

    def formula(self, digits: int | None = None, uncertainty: bool = False) -> str:
        """L, and psi if there is friction, as plain text with rounded numbers.

        For computation, `lagrangian` has all digits, and the root that smooths abs() of a velocity.

        Parameters
        ----------
        digits : int, optional
            Significant digits of the coefficients. By default each ends at the second digit of its
            standard error, and has six digits if it has none.
        uncertainty : bool
            Append the error to the number, as in 0.5577(12).

        Returns
        -------
        str
            One line for L and one for psi.

        Raises
        ------
        InputError
            If `digits` is not a whole number of at least 1.

        Examples
        --------
        >>> from leastaction.model.model import LagrangianModel, ModelTerm
        >>> LagrangianModel("x", [ModelTerm("x_dot**2", 0.50123, 0.002)]).formula(uncertainty=True)
        'L = 0.5012(20)*x_dot**2'
        """
        return formula(self._whole, digits, uncertainty)

    def format_rows(self) -> list[tuple[str, ...]]:
        """Rows of text for a table, starting with the header; numbers are rounded to their errors."""
        return rows(self._whole)

    def format_table(self) -> str:
        """Table of the terms, the status of the fit and its warnings, as plain text."""
        return table(self._whole)

    def latex(self, digits: int | None = None, uncertainty: bool = False) -> str:
        r"""L, and ψ if there is one, as LaTeX for math mode, with velocities as ``\dot{\theta}_{1}``.

        Parameters
        ----------
        digits : int, optional
            Significant digits of the coefficients. By default each ends at the second digit of its
            standard error, and has six digits if it has none.
        uncertainty : bool
            Append the error to the number, as in 0.5577(12).

        Examples
        --------
        >>> from leastaction.model.model import LagrangianModel, ModelTerm
        >>> LagrangianModel("x", [ModelTerm("x_dot**2", 0.50123, 0.002)]).latex(uncertainty=True)
        'L = 0.5012(20) \\, \\dot{x}^{2}'
        """
        return latex(self._whole, digits, uncertainty)

    def __repr__(self) -> str:
        return summary(self._whole)

    def __str__(self) -> str:
        return table(self._whole)

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {self.latex()}$"


def rows(model: LagrangianModel) -> list[tuple[str, ...]]:
    """Header and one row of text for each term."""
    out: list[tuple[str, ...]] = [_HEADER]
    widths = model.fit.smoothing_widths
    for kind, term in _estimates(model):
        error = f"{term.standard_error:.2g}" if term.standard_error > 0 else "known" if term.known else ""
        z = "" if kind in ("shape", "calibration") else z_text(term.z)
        out.append(
            (as_given(term.written, widths), kind, coefficient_text(term), error, interval_text(term), z)
        )
    return out


def _estimates(model: LagrangianModel) -> Iterator[tuple[str, ModelTerm]]:
    """Terms and shape parameters with their kinds, in the sequence of a table."""
    yield from (("lagrangian", term) for term in model.terms)
    yield from (("dissipation", term) for term in model.dissipation)
    yield from (("shape", shape.as_term()) for shape in model.shapes)
    yield from (
        ("calibration", n.as_term()) for n in (model.calibration.numbers if model.calibration else ())
    )
    yield from (("difference", d.as_term()) for d in (model.groups.differences if model.groups else ()))


def table(model: LagrangianModel) -> str:
    """Table of the terms, the status of the fit and its warnings."""
    cells = rows(model)
    width = [max(len(row[i]) for row in cells) for i in range(len(_HEADER))]
    lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, width, strict=True)).rstrip() for row in cells]
    lines += [f"fit: {model.fit.status}", *(f"warning: {w}" for w in model.fit.warnings)]
    return "\n".join([*lines, *(f"note: {text}" for text in smoothing_notes(model))])


def smoothing_notes(model: LagrangianModel) -> list[str]:
    """The note on the width in which abs() of velocities is smoothed; empty if the law has no such term."""
    widths = model.fit.smoothing_widths
    smooth = any(as_given(t.written, widths) != t.written for t in (*model.terms, *model.dissipation))
    return [str(f) for f in model.fit.findings if smooth and f.code == "friction-smoothed"]


def summary(model: LagrangianModel) -> str:
    """The model on one line."""
    law = ", ".join(formula(model, None, False).splitlines())
    return f"<LagrangianModel of {', '.join(model.coordinates)}: {law}; fit {model.fit.status}>"


def formula(model: LagrangianModel, digits: int | None, uncertainty: bool) -> str:
    """L, and psi if there is one, as plain text."""
    _check_digits(digits)
    how = digits, uncertainty, model.fit.smoothing_widths
    lines = [f"L = {plain_sum(model.terms, model.expressions, *how)}"]
    if model.dissipation:
        friction = plain_sum(model.dissipation, model.dissipation_expressions, *how)
        lines.append(f"psi = {friction}")
    for shape in model.shapes:
        lines.append(f"{{{shape.name}}} = {rounded(shape.value, shape.standard_error, digits, uncertainty)}")
    return "\n".join(lines)


def _check_digits(digits: object) -> None:
    if digits is not None and (isinstance(digits, bool) or not isinstance(digits, int) or digits < 1):
        raise InputError(f"digits is {quoted(digits)}; expected a whole number of at least 1")


def latex(model: LagrangianModel, digits: int | None, uncertainty: bool) -> str:
    """L, and ψ if there is one, for math mode."""
    _check_digits(digits)
    symbols = latex_symbols(model.coordinates) | shape_symbols(model.shapes)
    lines: list[str] = []
    groups = (
        ("L", model.terms, model.expressions),
        (r"\psi", model.dissipation, model.dissipation_expressions),
    )
    for name, terms, expressions in groups:
        shown = [_written(model, t, e) for t, e in zip(terms, expressions, strict=True)]
        pieces = latex_sum(terms, shown, symbols, digits, uncertainty) if terms else []
        # Four terms a line fit on a page.
        parts = [" ".join(pieces[i : i + 4]) for i in range(0, len(pieces), 4)]
        lines += [f"{name} &= {part}" if i == 0 else rf"&\quad {part}" for i, part in enumerate(parts)]
    for shape in model.shapes:
        number = rounded(shape.value, shape.standard_error, digits, uncertainty)
        lines.append(f"{symbols[shape_symbol(shape.name)]} &= {latex_number(number)}")
    if len(lines) == 1:
        return lines[0].replace("&=", "=")
    return "\\begin{aligned}\n" + " \\\\\n".join(lines) + "\n\\end{aligned}"


def _written(model: LagrangianModel, term: ModelTerm, expr: sp.Expr) -> sp.Expr:
    """The expression of a term as it was given: shape parameters as symbols, absolute values not smoothed."""
    text = as_given(term.written, model.fit.smoothing_widths)
    if text == term.expression:
        return expr
    return parse_expression(text, names_in_terms(model.coordinates), shapes=True)


CONSERVED = {
    "cyclic": "momentum",
    "translation": "momentum",
    "rotation": "angular momentum",
    "time translation": "energy",
}
_OBSTACLES = {"friction": "friction", "forces": "the known forces", "prescribed": "the prescribed motion"}
_MOST_RESTS = 6  # equilibria that are listed
_LONGEST = 80  # characters of an energy in a line of text


def reach(symmetry: Symmetry) -> str:
    """The sense in which a symmetry holds.

    Examples
    --------
    >>> from leastaction.model.symmetries import Symmetry
    >>> reach(Symmetry("rotation", ("x", "y"), "turn of (x, y)", "within errors", 1, 0.4, 0.0031))
    'within the error bars (0.31 %)'
    """
    if symmetry.holds == "within errors":
        return f"within the error bars ({_small_share(symmetry.precision)})"
    return "in form" if symmetry.holds == "in form" else "with the given coefficients"


def outcome(symmetry: Symmetry) -> str:
    """Whether the quantity is conserved, or the symmetry broken.

    Examples
    --------
    >>> from leastaction.model.symmetries import Symmetry
    >>> outcome(Symmetry("time reversal", ("x",), "t -> -t", "in form", obstacles=("friction",)))
    'broken by friction'
    """
    obstacles = " and ".join(_OBSTACLES[name] for name in symmetry.obstacles)
    name = CONSERVED.get(symmetry.kind)
    if name is None:
        return f"broken by {obstacles}" if obstacles else ""
    if obstacles:
        return f"not conserved because of {obstacles}"
    if math.isnan(symmetry.drift):
        return "conserved if no force acts along it"
    return f"conserved to {_small_share(symmetry.drift)} along the recording"


def _small_share(share: float) -> str:
    return f"{100 * share:.2g} %" if share >= 1e-4 else "less than 0.01 %"


def shown_quantity(symmetry: Symmetry) -> str:
    """The conserved quantity with rounded numbers; empty for a long energy, which only repeats L."""
    long = symmetry.kind == "time translation" and len(symmetry.written) > _LONGEST
    return "" if long else symmetry.written


def symmetry_lines(model: LagrangianModel) -> list[str]:
    """One line for each symmetry.

    Examples
    --------
    >>> from leastaction import LagrangianModel
    >>> from leastaction.model.term import ModelTerm
    >>> free = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5)])
    >>> symmetry_lines(free)[0]
    'cyclic coordinate x, in form: momentum x_dot, conserved if no force acts along it'
    """
    lines: list[str] = []
    widths = model.fit.smoothing_widths
    for symmetry in model.symmetries:
        name = " ".join(filter(None, (CONSERVED.get(symmetry.kind), shown_quantity(symmetry))))
        what = ", ".join(filter(None, (name, outcome(symmetry))))
        lines.append(as_given(f"{symmetry.name}, {reach(symmetry)}{f': {what}' if what else ''}", widths))
    return lines


def resting_lines(model: LagrangianModel) -> list[str]:
    """One line for each equilibrium, with its frequencies and damping ratios.

    Examples
    --------
    >>> from leastaction import LagrangianModel
    >>> from leastaction.model.term import ModelTerm
    >>> pendulum = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5), ModelTerm("cos(x)", 9.81, 0.04)],
    ...                            [ModelTerm("x_dot**2/2", 0.1, 0.002)])
    >>> for line in resting_lines(pendulum): print(line)
    x = 0, stable: 0.4985(10) Hz, damping ratio 0.01596(32)
    x = 3.14159, unstable
    """
    lines: list[str] = []
    for rest, system in model.small_motions[:_MOST_RESTS]:
        modes = () if system is None or rest.stability == "unstable" else system.modes
        line = f"{rest.place(model.coordinates)}, {rest.standing}"
        lines.append(f"{line}: {'; '.join(mode.pace for mode in modes)}" if modes else line)
    more = len(model.small_motions) - _MOST_RESTS
    return [*lines, f"and {more} more"] if more > 0 else lines


def simple_lines(model: LagrangianModel) -> list[str]:
    """One line for each proposed simple number, and one for all of them together.

    Examples
    --------
    >>> from leastaction import LagrangianModel
    >>> from leastaction.model.term import ModelTerm
    >>> simple_lines(LagrangianModel("x", [ModelTerm("x_dot**2", 0.5003, 0.0004)]))
    ['simple number: x_dot**2 = 0.50030(40): 1/2']
    """
    found = model.simple_constants
    widths = model.fit.smoothing_widths
    lines = [as_given(f"simple number: {offer}", widths) for offer in found.offers]
    return [*lines, f"simple numbers together: {agreement(found)}"] if len(lines) > 1 else lines


def agreement(found: SimpleConstants) -> str:
    """Whether all proposed numbers are compatible with the estimates.

    Examples
    --------
    >>> from leastaction.model.constants import SimpleConstants
    >>> agreement(SimpleConstants((), 1.25, 3, True))
    'chi2 1.2 for 3 of them: compatible'
    """
    fits = "compatible" if found.compatible else "incompatible, so not all of them are true"
    return f"chi2 {found.chi2:.2g} for {found.freedom} of them: {fits}"


def frame(model: LagrangianModel, use: str = "table()") -> pd.DataFrame:
    """Coefficients with their errors, as a data frame of pandas."""
    try:
        import pandas as pd
    except ImportError:
        instead = "use format_table(), or terms and dissipation"
        raise MissingPackageError(use, "pandas", "pandas", instead) from None

    names, widths = ("standard_error", "lower", "upper"), model.fit.smoothing_widths
    found = [
        (
            *(as_given(t.written, widths), kind, t.coefficient),
            *(getattr(t, name) for name in names),
            *(math.nan if kind == "shape" else t.z, t.known),
        )
        for kind, t in _estimates(model)
    ]
    columns = ("expression", "kind", "coefficient", *names, "z", "known")
    return pd.DataFrame(found, columns=list(columns)).set_index("expression")


def weighted_sum(terms: Sequence[ModelTerm], expressions: Sequence[sp.Expr]) -> sp.Expr:
    """Σ coefficient · expression."""
    return sp.Add(*(sp.Float(t.coefficient) * e for t, e in zip(terms, expressions, strict=True)))
