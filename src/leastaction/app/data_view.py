"""First step: a table, the roles of its columns, and plots of its trials."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import takewhile
from typing import TYPE_CHECKING

import numpy as np
from nicegui import events, html, ui

from leastaction.app import columns
from leastaction.app.arm import ROBOTS
from leastaction.app.figures import data_figure
from leastaction.app.files import EXAMPLES, MOST_BYTES, SESSION, SUFFIXES
from leastaction.app.parts import action, aside, choice, drawn, fault, math, panel, say, title
from leastaction.findings import sentence
from leastaction.identifiers import counted
from leastaction.model.mathml import Notation
from leastaction.report.verdict import in_symbols

if TYPE_CHECKING:
    from leastaction.app.page import Page

__all__ = ["labels", "show"]

_MOST_DRAWN = 6


def show(page: Page) -> None:
    """Fill the view."""
    DataView(page).build()


class DataView:
    """Elements of the view that change."""

    def __init__(self, page: Page) -> None:
        self.page, self.session = page, page.session

    def build(self) -> None:
        if self.session.title:
            title("The data", "h1")
        else:
            title("Find the law behind a motion", "h1")
            say(
                "Give a table of measured angles or positions over time. leastaction finds a short "
                "Lagrangian that explains them, with error bars, and warns if it should not be trusted.",
                "lead",
            )
        with html.div().classes("sources small" if self.session.title else "sources"):
            self._drop_zone()
            self._examples()
        self.message = html.div().classes("message")
        self.table = html.div().classes("stack")
        self.plots = html.div().classes("stack")
        self._show_table()

    def _drop_zone(self) -> None:
        upload = self.upload = ui.upload(
            auto_upload=True,
            multiple=True,
            max_file_size=MOST_BYTES,
            max_files=None,
            on_multi_upload=self.page.guarded(self._uploaded),
            on_rejected=self._rejected,
        )
        upload.props(f'accept="{",".join((*SUFFIXES, *ROBOTS))},.gz,{SESSION}"').classes("uploader").mark(
            "upload"
        )
        get = f"getElement({upload.id}).$refs.qRef"
        with panel("drop") as zone:
            title("Another table" if self.session.title else "Your table")
            say("Drop a CSV or Excel file here: a header, a column of times, a column for each coordinate.")
            say(
                "Several files with the same columns are trials of one system. A saved session opens, too.",
                "help",
            )
            say(
                "For a robot arm: the log of joint angles and torques together with its URDF or MJCF.", "help"
            )
            button = ui.button("Choose files", color=None).props("no-caps unelevated").classes("action main")
            # In the browser, because only a click may open the file dialog.
            button.on("click", js_handler=f"() => {get}.pickFiles()")
            say("It stays on this computer.", "help")
        zone.on("dragover", js_handler="(e) => { e.preventDefault(); e.currentTarget.classList.add('over') }")
        zone.on("dragleave", js_handler="(e) => e.currentTarget.classList.remove('over')")
        zone.on(
            "drop",
            js_handler="(e) => { e.preventDefault(); e.currentTarget.classList.remove('over'); "
            f"{get}.reset(); {get}.addFiles(e.dataTransfer.files) }}",
        )

    def _examples(self) -> None:
        with panel("examples"):
            title("Or a measured example")
            for key, (name, what) in EXAMPLES.items():
                with html.button().classes("example").mark(f"example-{key}") as button:
                    say(name, "name", "span")
                    say(what, "help", "span")
                button.on("click", self.page.guarded(lambda _=None, key=key: self._open_example(key)))
            say("Laboratory recordings by Kaheman et al., MIT licence.", "help")

    async def _uploaded(self, event: events.MultiUploadEventArguments) -> None:
        self._begin()
        try:
            if sum(file.size() for file in event.files) > MOST_BYTES:
                raise columns.InputError(f"the files are larger than {MOST_BYTES // 1_000_000} MB")
            given = [(file.name, await file.read()) for file in event.files]
            await aside(self.session.open_uploads, given)
        except Exception as error:
            self._show_table()
            self._fail(self.page.words(error))
            self.upload.reset()
        else:
            self._loaded()

    def _rejected(self) -> None:
        self._fail(
            f"this file was not taken: give one table ({', '.join(SUFFIXES[:5])}, text also with .gz) of at "
            f"most {MOST_BYTES // 1_000_000} MB; the command line reads larger files and other formats"
        )

    async def _open_example(self, key: str) -> None:
        self._begin()
        try:
            await aside(self.session.open_example, key)
        except Exception as error:
            self._show_table()
            self._fail(self.page.words(error))
        else:
            self._loaded()

    def _begin(self) -> None:
        """Remove the old table while the new one is read."""
        self.table.clear()
        self.plots.clear()
        self._tell("Reading…")

    def _loaded(self) -> None:
        self.page.show("arm" if self.session.arm else "result" if self.session.found else "data")

    def _tell(self, text: str) -> None:
        self.message.clear()
        with self.message:
            say(text, "help").props("role=status")

    def _fail(self, text: str) -> None:
        self.message.clear()
        with self.message:
            fault(text)

    def _show_table(self) -> None:
        session = self.session
        self.table.clear()
        self.plots.clear()
        if session.columns is None:
            return
        with self.table, panel():
            title(session.title)
            say(
                "The meaning of each column was guessed from its name and values. Correct wrong ones.", "help"
            )
            self._roles()
            if session.fault:
                fault(session.fault)
        if session.data is not None:
            with self.plots:
                self._summary()
                # Here, because the list whose change led here may be deleted by now.
                ui.timer(0.01, self.page.guarded(self._draw), once=True)

    def _roles(self) -> None:
        session = self.session
        assert session.columns is not None
        moving = columns.moving_columns(session.roles)
        names, written = columns.coordinate_names(moving), columns.written_names(moving)
        options = [*columns.TIMES, columns.COORDINATE, columns.ANGLE, columns.DEGREES, columns.TRIAL]
        kinds = (columns.FORCE, columns.VELOCITY, columns.ACCELERATION)
        options += [kind + name for kind in kinds for name in names.values()] + [columns.UNUSED]
        with html.div().classes("roles"):
            for column in session.columns.header:
                role = session.roles[column]
                with html.div().classes("role" + (" unused" if role == columns.UNUSED else "")):
                    with html.div().classes("column"):
                        say(column or "(no name)", "name", "span")
                        if names.get(column, column) != column:
                            say(f"called {names[column]} where you write formulas", "help", "span")
                        say(f"{session.columns.sample(column)} …", "help values", "span")
                    there = {o: _in_words(o, written) for o in dict.fromkeys([*options, role])}
                    set_role = self.page.guarded(lambda new, c=column: self._set_role(c, new))
                    choice(f"Meaning of {_plain(column)}", there, role, set_role)

    async def _set_role(self, column: str, role: str) -> None:
        self.session.roles[column] = role
        self.plots.clear()  # also removes the button to the candidates, because the data change
        self._tell("Reading…")
        await aside(self.session.read)
        if self.table.is_deleted:
            return
        self.message.clear()
        self.page.mark_steps()
        self._show_table()

    def _summary(self) -> None:
        data, session = self.session.data, self.session
        assert data is not None
        with panel():
            with html.div().classes("heading"):
                title("What was measured")
                if len(data) > 1:
                    with html.div().classes("trial"):
                        say("trial shown", "help", "span")
                        options = dict(enumerate(labels(data.names)))
                        choice("Trial shown", options, session.shown, self.page.guarded(self._show_trial))
            with html.dl().classes("facts"):
                for name, value in _facts(data):
                    with html.div():
                        say(name, "", "dt")
                        say(value, "", "dd")
            notation = Notation(data.coordinates, written=columns.written_names(session.moving))
            for finding in data.findings:
                math(in_symbols(f"{sentence(finding, 'page')}.", notation), "help", "p").mark("read")
            if session.hint:
                say(session.hint, "hint")
            wild = _not_radians(self.session)
            if wild:
                say(wild, "hint")
            with html.p().classes("keys"):
                say("measured", "key dots", "span")
                say("smoothing spline", "key line", "span")
            self.figures = html.div().classes("figures")
            with self.figures:
                say("Smoothing…", "help")
            with html.div().classes("next"):
                go_on = self.page.guarded(lambda _=None: self.page.show("candidates"))
                action("Continue to the candidates", go_on, "main", "continue")

    async def _show_trial(self, place: int) -> None:
        self.session.shown = place
        await self._draw()

    async def _draw(self) -> None:
        session = self.session
        data = session.data
        if data is None:
            return
        units = ["rad" if name in session.angles else "" for name in data.coordinates]
        try:
            smooth, hint = await aside(session.smooth), ""
        except Exception as error:
            smooth, hint = None, self.page.words(error)
        if session.data is not data or self.figures.is_deleted:
            return
        notation = Notation(data.coordinates, written=columns.written_names(session.moving))
        names = [notation.text(name) for name in data.coordinates]
        figures = []
        for i in range(min(data.n_dof, _MOST_DRAWN)):
            figures.append(await aside(data_figure, data[session.shown], smooth, i, names[i], units[i]))
        if self.figures.is_deleted:
            return
        self.figures.clear()
        with self.figures:
            if hint:
                fault(hint)
            for figure in figures:
                drawn(figure, "figure")


def labels(names: Sequence[str]) -> list[str]:
    """Names without their common beginning and end, cut at separators of words.

    Examples
    --------
    >>> labels(["2024-05-01_swing_small.csv", "2024-05-01_swing_large.csv"])
    ['small', 'large']
    >>> labels(["id-0", "id-10"]), labels(["a", "b"]), labels(["run_1/x", "run_1/y"])
    (['0', '10'], ['a', 'b'], ['x', 'y'])
    """

    def shared(columns: Iterable[tuple[str, ...]]) -> int:
        same = takewhile(lambda signs: len(set(signs)) == 1, columns)
        return max((k for k, signs in enumerate(same, 1) if not signs[0].isalnum()), default=0)

    start, stop = (shared(zip(*some, strict=False)) for some in (names, [name[::-1] for name in names]))
    short = [name[start : len(name) - stop] for name in names]
    return short if all(short) and len(set(short)) == len(names) else list(names)


def _in_words(role: str, written: Mapping[str, str]) -> str:
    """A role with the name of its coordinate as the user wrote it."""
    kind = next(
        (k for k in (columns.FORCE, columns.VELOCITY, columns.ACCELERATION) if role.startswith(k)), role
    )
    name = role.removeprefix(kind)
    return kind + written.get(name, name)


def _plain(text: str) -> str:
    return "".join(c for c in text if c.isalnum() or c in " _-")


def _facts(data) -> list[tuple[str, str]]:
    steps = np.concatenate([np.diff(run.t) for run in data])
    step = float(np.median(steps))
    even = bool(np.ptp(steps) < 0.02 * step)
    missing = sum(run.q.size for run in data) - data.n_samples
    facts = [
        ("recording", f"{counted(len(data), 'trial')}, {data.duration:.4g} s"),
        ("samples", f"{data.n_samples:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")),
        ("sampling", f"{1 / step:.4g} Hz" + ("" if even else ", uneven")),
        ("known forces", "yes" if data.driven else "none"),
    ]
    if missing:
        facts.append(("missing", str(missing)))
    wraps = sum(data.wraps_removed.values())
    if wraps:
        facts.append(("jumps of 2π removed", str(wraps)))
    return facts


def _not_radians(session) -> str:
    """A hint if a column marked as an angle in radians appears to be in degrees."""
    for column in columns.moving_columns(session.roles):
        if session.roles[column] == columns.ANGLE:
            values = session.columns.numbers(column)
            if values is not None and np.nanmax(np.abs(values)) > 30:
                return (
                    f"{column} reaches {np.nanmax(np.abs(values)):.0f}: if these are degrees, mark it above."
                )
    return ""
