"""A model as people read it: summary line, table, LaTeX, HTML."""

from __future__ import annotations

import html
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from leastaction.errors import InputError, MissingPackageError
from leastaction.identifiers import quoted
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
    import sympy as sp

    from leastaction.model.model import LagrangianModel
    from leastaction.model.term import ModelTerm

__all__ = ["frame", "html_table", "latex", "rows", "summary", "table"]

_HEADER = ("term", "kind", "coefficient", "std. error", "95 % interval", "z")


def rows(model: LagrangianModel) -> list[tuple[str, ...]]:
    """Header and one row of text for each term."""
    out: list[tuple[str, ...]] = [_HEADER]
    for kind, term in _estimates(model):
        error = f"{term.standard_error:.2g}" if term.standard_error > 0 else "known" if term.known else ""
        z = "" if kind == "shape" else z_text(term.z)
        out.append((term.written, kind, coefficient_text(term), error, interval_text(term), z))
    return out


def _estimates(model: LagrangianModel) -> Iterator[tuple[str, ModelTerm]]:
    """Terms and shape parameters with their kinds, in the sequence of a table."""
    yield from (("lagrangian", term) for term in model.terms)
    yield from (("dissipation", term) for term in model.dissipation)
    yield from (("shape", shape.as_term()) for shape in model.shapes)


def table(model: LagrangianModel) -> str:
    """Table of the terms, the status of the fit and its warnings."""
    cells = rows(model)
    width = [max(len(row[i]) for row in cells) for i in range(len(_HEADER))]
    lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, width, strict=True)).rstrip() for row in cells]
    return "\n".join([*lines, f"fit: {model.fit.status}", *(f"warning: {w}" for w in model.fit.warnings)])


def summary(model: LagrangianModel) -> str:
    """The model on one line."""
    total = plain_sum(model.terms, model.expressions)
    if model.dissipation:
        total += f", psi = {plain_sum(model.dissipation, model.dissipation_expressions)}"
    for shape in model.shapes:
        total += f", {{{shape.name}}} = {rounded(shape.value, shape.standard_error)}"
    return f"<LagrangianModel of {', '.join(model.coordinates)}: L = {total}; fit {model.fit.status}>"


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
        # Four terms a line: more would run out of the page.
        parts = [" ".join(pieces[i : i + 4]) for i in range(0, len(pieces), 4)]
        lines += [f"{name} &= {part}" if i == 0 else rf"&\quad {part}" for i, part in enumerate(parts)]
    for shape in model.shapes:
        number = rounded(shape.value, shape.standard_error, digits, uncertainty)
        lines.append(f"{symbols[shape_symbol(shape.name)]} &= {latex_number(number)}")
    if len(lines) == 1:
        return lines[0].replace("&=", "=")
    return "\\begin{aligned}\n" + " \\\\\n".join(lines) + "\n\\end{aligned}"


def _written(model: LagrangianModel, term: ModelTerm, expr: sp.Expr) -> sp.Expr:
    """The expression of a term with its shape parameters as symbols."""
    names = [*model.coordinates, *(f"{c}_dot" for c in model.coordinates)]
    return parse_expression(term.template, names, shapes=True) if term.template else expr


def html_table(model: LagrangianModel) -> str:
    """Table of the terms, the status of the fit and its warnings as HTML; all text is escaped."""

    def line(cells: tuple[str, ...], tag: str) -> str:
        return f"<tr>{''.join(f'<{tag}>{html.escape(cell)}</{tag}>' for cell in cells)}</tr>"

    header, *body = rows(model)
    notes = "".join(f"<li>{html.escape(w)}</li>" for w in model.fit.warnings)
    lines = "".join(line(row, "td") for row in body)
    return (
        f"<table><thead>{line(header, 'th')}</thead><tbody>{lines}</tbody></table>"
        f"<p>fit: {model.fit.status}</p>{f'<ul>{notes}</ul>' if notes else ''}"
    )


def frame(model: LagrangianModel) -> pd.DataFrame:
    """Coefficients with their errors, as a data frame of pandas."""
    try:
        import pandas as pd
    except ImportError:
        instead = "use format_table(), or terms and dissipation"
        raise MissingPackageError("table()", "pandas", "pandas", instead) from None

    names = ("standard_error", "lower", "upper")
    found = [
        (
            *(t.written, kind, t.coefficient),
            *(getattr(t, name) for name in names),
            *(math.nan if kind == "shape" else t.z, t.known),
        )
        for kind, t in _estimates(model)
    ]
    columns = ("expression", "kind", "coefficient", *names, "z", "known")
    return pd.DataFrame(found, columns=list(columns)).set_index("expression")
