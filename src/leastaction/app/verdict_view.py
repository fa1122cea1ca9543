"""The verdict on the shown model: status, statements, warnings and notes, with names as in the formulas."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from nicegui import html, ui

from leastaction.app.parts import math, say
from leastaction.errors import InputError
from leastaction.findings import usability, with_held_out
from leastaction.report.verdict import contradictions, in_symbols, not_noise, terms_in, unlike_noise

if TYPE_CHECKING:
    from leastaction import LagrangianModel
    from leastaction.model.mathml import Notation
    from leastaction.simulation.forecast import ForecastResult

__all__ = ["gravity", "in_names", "notes", "status"]

_HEADINGS = {
    "ok": "All checks passed: the equations hold along the data.",
    "usable": "This model {does}:",
    "doubtful": "Do not trust this model yet:",
}
_CONTRADICTED = "The fit passed all checks, but its forecasts contradict it:"
_RESERVED = "The equations hold along the data, with a reservation:"


def status(model: LagrangianModel, validation: ForecastResult | None, notation: Notation) -> None:
    """Status, warnings and statements; nothing that forecasts or residuals contradict is green."""
    ok, deviating = model.fit.status == "ok", unlike_noise(model)
    against = contradictions(validation) if ok else []
    residuals = [not_noise(deviating)] if deviating else []
    warnings = [*against, *model.fit.sentences("warning", "page"), *residuals]
    heading = _HEADINGS[model.fit.status].format(does=usability(model.fit.findings))
    tone = model.fit.status
    if against:
        heading, tone = _CONTRADICTED, "doubtful"
    elif ok and deviating:
        heading, tone = _RESERVED, "usable"
    with html.div().classes(f"status {tone}"):
        with html.p():
            say(model.fit.status, "badge", "span")
            say(heading, "", "span")
        if warnings:
            with html.ul():
                for text in warnings:
                    _sentence(model, notation, text, "li")
        for name, text in with_held_out(model.fit.statements, validation).items():
            _sentence(model, notation, f"{name.capitalize()}: {text}.")


def notes(model: LagrangianModel, notation: Notation) -> None:
    """The notes of the fit, folded."""
    texts = model.fit.sentences("note", "page")
    if texts:
        with ui.expansion(f"Worth knowing ({len(texts)})").classes("formulas"), html.ul():
            for text in texts:
                _sentence(model, notation, text, "li")


def in_names(text: str, notation: Notation) -> str:
    """A plain text with the names of coordinates as in figures.

    Examples
    --------
    >>> from leastaction.model.mathml import Notation
    >>> in_names("theta1, a_1: an angle", Notation(["theta1", "a_1"], written={"a_1": "a (1)"}))
    'θ₁, a (1): an angle'
    """
    words = "|".join(sorted(map(re.escape, notation.coordinates), key=len, reverse=True))
    return re.sub(rf"(?<!\w)(?:{words})(?!\w)", lambda found: notation.text(found[0]), text)


def gravity(model: LagrangianModel, notation: Notation) -> None:
    """Gravity over length of links, or gravity where lengths are given; a wrong one is among the warnings."""
    lengths = model.provenance.get("options", {}).get("lengths", {})
    try:
        ratios = model.gravity(lengths)
    except InputError:  # no ratio for one of the lengths, which is a note of the fit
        ratios = model.gravity()
    for ratio in ratios:
        if ratio.clock is None:
            _sentence(model, notation, f"Gravity: {ratio}.", classes="help")


def _sentence(
    model: LagrangianModel, notation: Notation, text: str, tag: str = "p", classes: str = ""
) -> None:
    """A sentence with coordinates and terms as mathematics."""
    math(in_symbols(text, notation, terms_in(model, model.fit.findings)), classes, tag)
