"""Third step while the discovery runs: stages, the law so far, and the button to cancel."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

from nicegui import html, ui

from leastaction.app.columns import written_names
from leastaction.app.parts import action, fault, math, panel, say, title
from leastaction.app.worker import in_words
from leastaction.model.mathml import Notation

if TYPE_CHECKING:
    from leastaction.app.page import Page

__all__ = ["Running", "ended", "stage_bar", "stage_words"]

_STAGES = {
    "": "Starting",
    "prepare": "Preparing the data and the candidates",
    "search": "Searching for structures on the weak form",
    "shapes": "Searching for shape parameters",
    "select": "Choosing terms",
    "knots": "Refining the spline",
    "coarse": "Comparing with a coarser spline",
    "confirm": "Confirming on the whole recording",
    "drift": "Following drifting forces",
    "verify": "Verifying",
    "forecast": "Forecasting",
}
_SEQUENCE = ("prepare", "search", "select", "knots", "verify", "forecast")
"""Stages of every discovery; others may come between."""
_MOST_TERMS = 12  # of the law so far


def stage_words(stage: str, details: dict) -> str:
    """A stage in words.

    Examples
    --------
    >>> stage_words("select", {"terms": 5.0, "evidence": 12.0})
    'Choosing terms: 5 so far'
    """
    text = _STAGES.get(stage, stage)
    if "terms" in details:
        text += f": {int(details['terms'])} so far"
    elif "knots_per_second" in details:
        text += f": {details['knots_per_second']:.0f} knots per second"
    return text


def stage_bar() -> tuple[ui.linear_progress, ui.label, ui.label]:
    """A bar for the stages done, and lines for the present stage and the time."""
    bar = ui.linear_progress(0.0, show_value=False).classes("bar")
    bar.props('rounded aria-label="Stages done"')
    with html.div().classes("now").props("role=status"):
        return bar, say("", "stage"), say("", "seconds")


class Running:
    """Stages, the law so far and time of a discovery, and the button that cancels it."""

    def __init__(self, page: Page) -> None:
        self.page = page

    def build(self) -> None:
        title("Searching", "h1")
        with panel("running"):
            self.bar, self.stage, self.seconds = stage_bar()
            self.law = html.div().classes("stack sofar")
            self.past = html.ol().classes("past")
            action("Cancel", self.page.guarded(self._cancel), "plain", "cancel")
        self._seen: tuple[int, dict] = (-1, {})
        self.timer = ui.timer(0.2, self.page.guarded(self._follow))

    def _follow(self) -> None:
        job = self.page.session.job
        if job is None or job.state != "running":
            self.timer.deactivate()
            self.page.show("result")
            return
        details, stages = job.details, list(job.stages)
        self.stage.text = stage_words(job.stage, details)
        self.seconds.text = f"{job.seconds:.0f} s"
        law = details.get("coefficients") or self._seen[1]
        if law != self._seen[1]:
            self._show_law(law)
        if len(stages) != self._seen[0]:
            self._show_stages(stages)
        self._seen = len(stages), law

    def _show_stages(self, stages: list[tuple[str, float]]) -> None:
        """Finished stages with their times, and the remaining stages of every discovery."""
        begun = [name for name, _ in stages]
        last = max((_SEQUENCE.index(name) for name in begun if name in _SEQUENCE), default=-1)
        self.bar.value = (last + 0.5) / len(_SEQUENCE) if begun else 0.0
        self.past.clear()
        with self.past:
            for (name, start), (_, end) in pairwise(stages):
                say(f"{_STAGES.get(name, name)}: {end - start:.1f} s", "done", "li")
            for name in _SEQUENCE[last + 1 :]:
                say(_STAGES[name], "to-come", "li")

    def _show_law(self, law: dict[str, float]) -> None:
        """The best terms so far, which may change."""
        data = self.page.session.data
        self.law.clear()
        if data is None:
            return
        notation = Notation(data.coordinates, written=written_names(self.page.session.moving))
        with self.law:
            say("Terms so far", "help")
            with html.p().classes("formula"):
                for k, (text, value) in enumerate(list(law.items())[:_MOST_TERMS]):
                    number = float(f"{value:.3g}")
                    math(notation.addend(text, number, 0.0, "", k == 0))
            if len(law) > _MOST_TERMS:
                say(f"and {len(law) - _MOST_TERMS} more", "help")

    def _cancel(self) -> None:
        self.timer.deactivate()
        self.page.session.stop()
        self.page.show("result")


def ended(page: Page) -> None:
    """A discovery without a result: cancelled, failed, or not started."""
    job = page.session.job
    with panel():
        if job is not None and job.state == "failed":
            title("No model", "h1")
            fault(in_words(job.message, page.session.folder))
        elif job is not None and job.state == "cancelled":
            title("Cancelled", "h1")
            say(f"Stopped after {job.seconds:.0f} s. Data and candidates are unchanged.")
        else:
            title("Nothing found yet", "h1")
            say("Choose the candidates and start the search.")
        with html.div().classes("next"):
            back = page.guarded(lambda _=None: page.show("candidates"))
            action("Back to the candidates", back, "main", "back")
