"""Display of a model in notebooks, and the plot of its coefficients."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from markupsafe import Markup

from leastaction.findings import as_given
from leastaction.model.gravity import GravityRatio, gravity_ratios
from leastaction.model.mathml import Notation
from leastaction.model.notation import coefficient_text
from leastaction.model.term import ModelTerm
from leastaction.model.text import formula, rows
from leastaction.shown import Card, Display, Panel, Series, Shown, Typeset

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from leastaction.model.model import LagrangianModel

__all__ = ["ShownModel"]

_NOT_FITTED = {"marker": "s", "markerfacecolor": "none", "linestyle": "none", "color": "0.45"}
_FITTED = {"marker": "o", "linestyle": "none", "capsize": 3}
_EQUALS = Markup('<math><mrow><mi class="q" mathvariant="normal">{}</mi><mo>=</mo></mrow></math>')


class ShownModel(Shown):
    """Display of a model in notebooks and plots, and gravity from its coefficients."""

    def gravity(self, lengths: Mapping[str, float] | None = None) -> tuple[GravityRatio, ...]:
        """Gravity over length of links, and gravity if lengths are given: a check of the time base.

        Parameters
        ----------
        lengths : mapping of str to float, optional
            Lengths of links in metres by coordinate, from joint to joint; for a single pendulum, the length
            of the equivalent simple pendulum.

        Returns
        -------
        tuple of GravityRatio
            With ``value`` (1/s²), ``standard_error``, ``gravity`` (m/s²) and ``clock``, the factor by which
            times appear to be wrong; empty if the law contains no ratio g/l.

        Raises
        ------
        InputError
            If a length is not positive, or the model has no ratio for it.

        Examples
        --------
        >>> from leastaction.model.model import LagrangianModel, ModelTerm
        >>> model = LagrangianModel("q", [ModelTerm("q_dot**2", 0.5), ModelTerm("cos(q)", 19.6, 0.1)])
        >>> (ratio,) = model.gravity({"q": 0.5})
        >>> round(ratio.value, 1), round(ratio.gravity, 1), ratio.clock
        (19.6, 9.8, None)
        """
        return gravity_ratios(cast("LagrangianModel", self), lengths)

    def plot(self, ax: Axes | Sequence[Axes] | None = None, **kwargs: Any) -> Display:
        """Plot the 95 % interval of each coefficient, in per cent of the coefficient.

        Beyond ±100 % an interval includes zero. Coefficients that were given have hollow squares. The motion
        through the data is drawn by ``model.diagnostics.plot()``, the trade-off between size and misfit by
        ``model.diagnostics.trade_off.plot()``.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            By default a new figure.
        **kwargs
            Properties of Matplotlib's lines, such as ``color``.

        Returns
        -------
        Display
            With ``figure_``, ``ax_``, ``axes_`` and ``lines_``.

        Raises
        ------
        InputError
            If `ax` holds several axes; also, as an ImportError too, if Matplotlib is not installed (extra
            ``plot``).

        Examples
        --------
        >>> from leastaction.model.model import LagrangianModel, ModelTerm
        >>> model = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -2.0, 0.02)])
        >>> [label.get_text() for label in model.plot().ax_.get_yticklabels()]
        ['0.5 · x_dot**2', '-2.000(20) · x**2']
        """
        model = cast("LagrangianModel", self)
        numbers = [shape.as_term() for shape in model.shapes]
        terms = [*model.terms, *model.dissipation, *numbers]
        reach = np.array([_reach(term) for term in terms]).T
        places, fitted = np.arange(len(terms)), reach.max(axis=0) > 0
        series = [
            Series(np.zeros(at.sum()), places[at], label, errors=errors, style=style)
            for at, label, errors, style in (
                (fitted, "95 % interval", reach[:, fitted], _FITTED),
                (~fitted, "without an error", None, _NOT_FITTED),
            )
            if at.any()
        ]
        widths = Notation.of_fit(model.coordinates, model.fit.findings).widths
        labels = [
            f"{coefficient_text(term, uncertainty=True)} · {as_given(term.written, widths)}" for term in terms
        ]
        x_label = "distance from the coefficient (% of it)"
        return Display([Panel("", "", series, x_label, rows=labels)]).plot(ax, **kwargs)

    def _card(self) -> Card:
        model = cast("LagrangianModel", self)
        notation = Notation.of_fit(model.coordinates, model.fit.findings)
        header, *body = rows(model)
        table = [header, *((Typeset(row[0], notation.term(row[0])), *row[1:]) for row in body)]
        status = f"fit: {model.fit.status}{_statements(model)}"
        kinds = {"warning": "warning: ", "note": ""}
        found = sorted(model.fit.findings, key=lambda finding: finding.severity != "warning")
        return Card(
            f"LagrangianModel of {', '.join(model.coordinates)}",
            [status, Typeset(formula(model, None, False), _formulas(model))],
            table,
            [as_given(f"{kinds[finding.severity]}{finding}", notation.widths) for finding in found],
        )


def _statements(model: LagrangianModel) -> str:
    """The statements on structure, equations and forecast that follow the status."""
    said = [f"{name}: {text}" for name, text in model.fit.statements.items()]
    return f" ({'; '.join(said)})" if said else ""


def _reach(term: ModelTerm) -> np.ndarray:
    """(2,) distances to the ends of the 95 % interval in per cent of the coefficient; 0 if there is none."""
    ends = np.array([term.coefficient - term.lower, term.upper - term.coefficient])
    if not term.coefficient or not np.all(np.isfinite(ends) & (ends > 0)):
        return np.zeros(2)
    return 100 * ends / abs(term.coefficient)


def _formulas(model: LagrangianModel) -> Markup:
    """L, and ψ if there is one, each coefficient with its error below."""
    notation = Notation.of_fit(model.coordinates, model.fit.findings)
    lines: list[Markup] = []
    for name, terms in (("L", model.terms), ("ψ", model.dissipation)):
        if terms:
            parts = Markup(" ").join([_EQUALS.format(name), *notation.addends(terms)])
            lines.append(Markup('<span class="formula">{}</span>').format(parts))
    return Markup("").join(lines)
