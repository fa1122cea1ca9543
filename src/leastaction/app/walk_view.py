"""The trade-off curve: misfit by number of terms, with a slider."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from nicegui import html, ui

from leastaction.app.figures import walk_figure
from leastaction.app.parts import action, aside, drawn, math, panel, say, title

if TYPE_CHECKING:
    from leastaction.app.jobs import Found
    from leastaction.app.page import Page
    from leastaction.model.mathml import Notation

__all__ = ["WalkPanel"]

_NOT_STORED = (
    "A session does not store the search. Find the Lagrangian again for the trade-off curve and the report."
)


class WalkPanel:
    """Figure, slider, and differences from the chosen structure."""

    def __init__(self, page: Page, notation: Notation, refresh: Callable[[], None]) -> None:
        self.page, self.session, self.notation, self.refresh = page, page.session, notation, refresh

    def build(self) -> None:
        self.moves = len(self.session.walk.points) > 1
        with panel("walk"):
            title("How many terms?")
            if self.moves:
                self._controls()
            elif self.session.best.model.diagnostics is None:
                say(_NOT_STORED, "hint")
            else:
                say("There is only one structure.", "help")
        # Without steps, too: the forecasts of a model from a session follow.
        self.timer = ui.timer(0.2, self.page.guarded(self._follow), active=False)
        self._arrived()

    def _controls(self) -> None:
        with html.p().classes("keys"):
            say("criterion (BIC)", "key line", "span")
            say("misfit alone", "key dash", "span")
            say("chosen", "key big", "span")
        self.figure = html.div().classes("figures")
        with html.div().classes("mover"):
            action("−", self.page.guarded(lambda: self._go(-1)), "quiet", "fewer").props(
                'aria-label="Fewer terms"'
            )
            last = len(self.session.walk.points) - 1
            self.slider = ui.slider(min=0, max=last, step=1, value=self.session.place)
            self.slider.props('aria-label="Number of terms"').mark("place")
            self.slider.on("change", self.page.guarded(lambda: self._go_to(int(self.slider.value or 0))))
            action("+", self.page.guarded(lambda: self._go(1)), "quiet", "more").props(
                'aria-label="More terms"'
            )
        self.words = html.div().classes("stack").props("aria-live=polite")

    def _go(self, step: int) -> None:
        self._go_to(self.session.place + step)

    def _go_to(self, place: int) -> None:
        place = min(max(place, 0), len(self.session.walk.points) - 1)
        if place == self.session.place:
            return
        self.session.go_to(place)
        self.slider.value = place
        self.refresh()
        self._arrived()

    def _follow(self) -> None:
        self.session.collect()
        if not self.session.found or (self.moves and not self.session.walk.points):
            self.timer.deactivate()  # other data are open by now
            return
        if self._state != self.seen:  # another page of this session may have collected the result
            self.seen = self._state
            self.refresh()
            self._describe()
        elif self.moves and self.session.job is not None and self.session.waiting:
            self.progress.text = f"{self._doing()}… {self.session.job.seconds:.0f} s"
        if self.session.job is None:
            self.timer.deactivate()

    def _stay(self) -> None:
        self.session.stay()
        self.timer.deactivate()
        self.refresh()
        self._describe()

    @property
    def _state(self) -> tuple[int, Found, str | None]:
        session = self.session
        return session.place, session.current, session.faults.get(session.place)

    def _arrived(self) -> None:
        self.seen = self._state
        self._describe()
        if self.session.job is not None:
            self.timer.activate()
        if self.moves:
            ui.timer(0.01, self.page.guarded(self._draw), once=True)

    def _doing(self) -> str:
        return "Refining" if self.session.current.stage == "provisional" else "Forecasting"

    async def _draw(self) -> None:
        box = self.figure
        figure = await aside(walk_figure, self.session.walk, self.session.place)
        if not box.is_deleted:
            box.clear()
            with box:
                drawn(figure, "figure")

    def _describe(self) -> None:
        session = self.session
        if not self.moves:
            return
        self.words.clear()
        with self.words:
            walk, place = session.walk, session.place
            asked = walk.points[place].n_terms
            say(f"{asked} free term{'' if asked == 1 else 's'}. {walk.verdict(place)}")
            for text, terms in zip(("More:", "Less:"), walk.difference(place), strict=True):
                self._list(text, terms)
            model = session.current.model
            kept = sum(not term.known for term in (*model.terms, *model.dissipation))
            if kept < asked:
                say(f"{kept} of them remain; friction with a negative estimate was left out.", "hint")
            if session.waiting:
                with html.div().classes("heading"):
                    self.progress = say(f"{self._doing()}…").props("role=status")
                    action("Cancel", self.page.guarded(self._stay), "quiet", "cancel-refit")

    def _list(self, text: str, terms: list[str]) -> None:
        if terms:
            with html.p().classes("terms"):
                say(text, "help", "span")
                for term in terms:
                    math(self.notation.term(term), "term")
