"""The trade-off curve: misfit by number of terms, with a slider."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from nicegui import html, ui

from leastaction.app.figures import walk_figure
from leastaction.app.parts import action, aside, drawn, math, panel, say, title

if TYPE_CHECKING:
    from leastaction.app.page import Page
    from leastaction.model.mathml import Notation

__all__ = ["WalkPanel"]


class WalkPanel:
    """Figure, slider, and differences from the chosen structure."""

    def __init__(self, page: Page, notation: Notation, refresh: Callable[[], None]) -> None:
        self.page, self.session, self.notation, self.refresh = page, page.session, notation, refresh

    def build(self) -> None:
        walk = self.session.walk
        with panel("walk"):
            title("How many terms?")
            if len(walk.points) < 2:
                say("There is only one structure.", "help")
                return
            with html.p().classes("keys"):
                say("criterion (BIC)", "key line", "span")
                say("misfit alone", "key dash", "span")
                say("chosen", "key big", "span")
            self.figure = html.div().classes("figures")
            with html.div().classes("mover"):
                action("−", self.page.guarded(lambda: self._go(-1)), "quiet", "fewer").props(
                    'aria-label="Fewer terms"'
                )
                self.slider = ui.slider(min=0, max=len(walk.points) - 1, step=1, value=self.session.place)
                self.slider.props('aria-label="Number of terms"').mark("place")
                self.slider.on("change", self.page.guarded(lambda: self._go_to(int(self.slider.value or 0))))
                action("+", self.page.guarded(lambda: self._go(1)), "quiet", "more").props(
                    'aria-label="More terms"'
                )
            self.words = html.div().classes("stack").props("aria-live=polite")
        self.timer = ui.timer(0.2, self.page.guarded(self._follow), active=False)
        self._arrived()

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
        changed = self.session.collect()
        if changed:
            self.refresh()
            self._describe()
        elif self.session.job is not None and self.session.waiting:
            self.progress.text = f"{self._doing()}… {self.session.job.seconds:.0f} s"
        if self.session.job is None:
            self.timer.deactivate()

    def _stay(self) -> None:
        self.session.stay()
        self.timer.deactivate()
        self.refresh()
        self._describe()

    def _arrived(self) -> None:
        self._describe()
        if self.session.job is not None:
            self.timer.activate()
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
