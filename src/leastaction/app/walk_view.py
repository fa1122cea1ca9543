"""The trade-off curve: how much each further term explains, and a way to walk along it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from nicegui import html, ui

from leastaction.app.figures import walk_figure
from leastaction.app.parts import action, aside, drawn, fault, math, panel, say, title
from leastaction.app.session import in_words
from leastaction.report.mathml import Notation

if TYPE_CHECKING:
    from leastaction.app.page import Page

__all__ = ["WalkPanel"]


class WalkPanel:
    """Figure, slider, and what the structure has more and less than the chosen one."""

    def __init__(self, page: Page, refresh: Callable[[], None]) -> None:
        self.page, self.session, self.refresh = page, page.session, refresh

    def build(self) -> None:
        walk = self.session.walk
        with panel("walk"):
            title("How many terms?")
            if len(walk.points) < 2:
                say("There is only one structure, so there is nothing to choose.", "help")
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
        if self.session.job is not None and self.session.job.state == "running":
            self._describe()
            self.timer.activate()
        else:
            self._stay()
        ui.timer(0.01, self.page.guarded(self._draw), once=True)

    def _go(self, step: int) -> None:
        self._go_to(self.session.wanted + step)

    def _go_to(self, place: int) -> None:
        place = min(max(place, 0), len(self.session.walk.points) - 1)
        if place == self.session.wanted:
            return
        self.slider.value = place
        if self.session.go_to(place) is None:
            self._arrived()
        else:
            self._describe()
            self.timer.activate()

    def _follow(self) -> None:
        job = self.session.job
        if job is not None and job.state == "running":
            self.progress.text = f"Fitting {self._size()}… {job.seconds:.0f} s"
            return
        self.timer.deactivate()
        if job is not None and job.state == "failed":
            message = in_words(job.message, self.session.folder)
            self._stay()
            with self.words:
                fault(f"There is no model of that size: {message}")
        elif self.session.collect():
            self._arrived()

    def _cancel(self) -> None:
        self.session.stop()
        self.timer.deactivate()
        self._stay()

    def _stay(self) -> None:
        self.session.job = None
        self.session.wanted = self.session.place
        self.slider.value = self.session.place
        self._describe()

    def _arrived(self) -> None:
        self._describe()
        self.refresh()
        ui.timer(0.01, self.page.guarded(self._draw), once=True)

    async def _draw(self) -> None:
        box = self.figure
        figure = await aside(walk_figure, self.session.walk, self.session.place)
        if not box.is_deleted:
            box.clear()
            with box:
                drawn(figure, "figure")

    def _size(self) -> str:
        count = self.session.walk.points[self.session.wanted].n_terms
        return f"{count} free term{'' if count == 1 else 's'}"

    def _describe(self) -> None:
        session = self.session
        self.words.clear()
        with self.words:
            if session.job is not None and session.job.state == "running":
                with html.div().classes("heading"):
                    self.progress = say(f"Fitting {self._size()}…").props("role=status")
                    action("Cancel", self.page.guarded(self._cancel), "quiet", "cancel-refit")
                return
            walk, place = session.walk, session.place
            say(f"{self._size().capitalize()}. {walk.verdict(place)}")
            for text, terms in zip(("More:", "Less:"), walk.difference(place), strict=True):
                self._list(text, terms)
            kept = [
                t for t in (*session.current.model.terms, *session.current.model.dissipation) if not t.known
            ]
            asked = walk.points[place].n_terms
            if len(kept) < asked:
                say(
                    f"Of these {asked} terms the data support {len(kept)}; the others were dropped again.",
                    "hint",
                )

    def _list(self, text: str, terms: list[str]) -> None:
        if terms:
            notation = Notation(self.session.current.model.coordinates)
            with html.p().classes("terms"):
                say(text, "help", "span")
                for term in terms:
                    math(notation.term(term), "term")
