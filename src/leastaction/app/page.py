"""The page: header, steps, and the view that is open."""

from __future__ import annotations

import os
import traceback
from collections import OrderedDict
from collections.abc import Callable
from functools import wraps
from inspect import isawaitable
from pathlib import Path
from typing import Any

from nicegui import html, ui

from leastaction.app import arm_view, candidates_view, data_view, result_view
from leastaction.app.files import SESSION
from leastaction.app.parts import action, aside, say
from leastaction.app.session import Session
from leastaction.app.worker import explain, in_words

__all__ = ["Page", "close_sessions", "root"]

_MOST_SESSIONS = 6
_STEPS = {"data": "Data", "candidates": "Candidates", "result": "Result"}
_STEPS_OF_ARM = {"data": "Data", "arm": "Arm"}
_VIEWS = {
    "data": data_view.show,
    "candidates": candidates_view.show,
    "result": result_view.show,
    "arm": arm_view.show,
}
_THEMES = {None: "Light or dark as the system", False: "Light", True: "Dark"}
_HERE = Path(__file__).parent

_sessions: OrderedDict[str, Session] = OrderedDict()


async def root() -> None:
    """Build the page of a browser tab; its session persists after a reload."""
    ui.add_css(_HERE / "style.css")
    client = ui.context.client
    await client.connected(timeout=60)
    Page(_session_of(client.tab_id or client.id)).build()


def _session_of(tab: str) -> Session:
    if tab not in _sessions:
        _sessions[tab] = Session()
        if len(_sessions) > _MOST_SESSIONS:
            _sessions.popitem(last=False)[1].close()
    _sessions.move_to_end(tab)
    return _sessions[tab]


def close_sessions() -> None:
    """End all workers and remove all uploaded files."""
    while _sessions:
        _sessions.popitem()[1].close()


class Page:
    """Common parts of the views: the session, the steps, the content, and a line for errors."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.dark = ui.dark_mode(None)

    def build(self) -> None:
        """Fill the page."""
        with html.header().classes("top"):
            say("leastaction", "brand", "span")
            self.steps = html.nav().classes("steps").props('aria-label="Steps"')
            self.save = action("", self.guarded(self._save), "plain save", "save")
            with self.save.props('icon=save aria-label="Save session"'):
                say("Save session", "words", "span")
            self.theme = ui.button("\N{CIRCLE WITH LEFT HALF BLACK}", on_click=self._next_theme, color=None)
            self.theme.props("flat round dense").classes("theme")
        self._name_theme()
        # Not another <main>: the page of NiceGUI is one.
        self.main = html.div().classes("content")
        self.show(self.session.view)
        self.session.worker.warm_up()

    def show(self, view: str) -> None:
        """Open a view."""
        self.session.view = view
        self.mark_steps()
        self.main.clear()
        with self.main:
            _VIEWS[view](self)
            ui.run_javascript("window.scrollTo(0, 0)")

    def mark_steps(self) -> None:
        """Mark the available steps and the open one; offer to save what is open."""
        session = self.session
        self.save.set_visibility(session.can_be_saved)
        there = {
            "data": True,
            "candidates": session.data is not None,
            "result": bool(session.found) or session.job is not None,
            "arm": session.arm is not None,
        }
        steps = _STEPS_OF_ARM if there["arm"] else _STEPS
        self.steps.clear()
        with self.steps:
            for number, (view, name) in enumerate(steps.items(), start=1):
                button = ui.button(
                    on_click=self.guarded(lambda _=None, view=view: self.show(view)), color=None
                )
                button.props("flat no-caps no-wrap").classes("step").mark(f"step-{view}")
                with button:
                    say(str(number), "number", "span")
                    say(name, "", "span")
                button.set_enabled(there[view])
                if view == session.view:
                    button.classes("here").props('aria-current="step"')

    def words(self, error: Exception) -> str:
        """An error as one line, in the words of the page."""
        return in_words(explain(error), self.session.folder)

    def guarded(self, handler: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap a handler, so that an error becomes one line in the page."""

        @wraps(handler)
        async def run(*arguments: Any) -> None:
            try:
                result = handler(*arguments)
                if isawaitable(result):
                    await result
            except Exception as error:
                if os.environ.get("LEASTACTION_DEBUG", "0") not in ("", "0"):
                    traceback.print_exception(error)
                with self.main:
                    ui.notify(
                        self.words(error),
                        color=None,
                        classes="fault-note",
                        multi_line=True,
                        close_button="Close",
                        timeout=0,
                    )

        return run

    async def _save(self) -> None:
        name = self.session.title.partition(".")[0].replace(" ", "_")
        ui.download.content(await aside(self.session.save), f"{name}{SESSION}", "application/zip")

    def _next_theme(self) -> None:
        values = list(_THEMES)
        self.dark.value = values[(values.index(self.dark.value) + 1) % len(values)]
        self._name_theme()

    def _name_theme(self) -> None:
        text = _THEMES[self.dark.value]
        self.theme.props(f'aria-label="Colours: {text}" title="Colours: {text}"')
