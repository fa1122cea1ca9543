"""Third step: the running discovery, and its result."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING

import numpy as np
from nicegui import html, ui

from leastaction.app.columns import written_names
from leastaction.app.data_view import labels
from leastaction.app.figures import forecast_figure, unseen_words
from leastaction.app.files import exported
from leastaction.app.motion import frames, stick_kind, stick_words
from leastaction.app.parts import (
    Stick,
    action,
    aside,
    disclosure,
    drawn,
    fault,
    math,
    panel,
    say,
    scroll,
    table,
    title,
)
from leastaction.app.remedies import Offer, offers, take
from leastaction.app.running_view import Running, ended
from leastaction.app.verdict_view import gravity, in_names, notes, status
from leastaction.app.walk_view import WalkPanel
from leastaction.app.worker import in_words
from leastaction.exporters import FORMATS
from leastaction.model.mathml import Notation
from leastaction.report import captions
from leastaction.report.tables import coefficient_groups, motion_rows, simple_rows, symmetry_rows
from leastaction.report.text import percent, plain

if TYPE_CHECKING:
    from leastaction import LagrangianModel
    from leastaction.app.jobs import Found
    from leastaction.app.page import Page

__all__ = ["show"]

_MOST_DRAWN = 4
_TAGS = {"ψ": "friction", "": "shape parameter"}


def show(page: Page) -> None:
    """Fill the view."""
    session = page.session
    session.collect()
    if session.found:
        ResultView(page).build()
    elif session.job is not None and session.job.state == "running":
        Running(page).build()
    else:
        ended(page)


class ResultView:
    """The model at the current position on the trade-off curve."""

    def __init__(self, page: Page) -> None:
        self.page, self.session = page, page.session
        # The widths of smoothed friction belong to the candidates, which all models of the curve share.
        chosen = self.session.best.model
        self.notation = Notation.of_fit(
            chosen.coordinates, chosen.fit.findings, written_names(self.session.moving)
        )

    @property
    def _angles(self) -> list[str]:
        """Coordinates of the law that are angles, including those without a sensor."""
        task = self.session.task
        return self.session.angles if task is None else list(task.library.angles)

    def build(self) -> None:
        self._heading()
        self.model = html.div().classes("stack follows")
        with html.div().classes("halves uneven"):
            self.table = panel("follows")
            WalkPanel(self.page, self.notation, self.refresh).build()
        self.compared = html.div().classes("stack follows")
        self.symmetries = html.div().classes("stack follows")
        self.motion = html.div().classes("stack follows")
        self.refresh()

    def refresh(self) -> None:
        """Show the model at the current position."""
        found = self.session.current
        self._enable(found)
        for box in (self.model, self.table, self.compared, self.symmetries, self.motion):
            box.clear()
        notation = self.notation
        with self.model:
            self._formula(found, notation)
        with self.table:
            _coefficients(found, notation)
            if found.stage != "provisional":  # both need standard errors
                _simple_numbers(found.model, notation)
        if found.stage != "provisional":
            with self.compared:
                self._compare(found, notation)
            with self.symmetries:
                _symmetries(found.model, notation)
                _small_motions(found.model, notation)
        with self.motion:
            self._forecast(found, notation)

    def _heading(self) -> None:
        """Title and downloads. They stay when the model changes: a click or an open list must not be lost."""
        with html.div().classes("heading"):
            with html.div():
                say(self.session.title, "help")
                title("The Lagrangian", "h1")
            with html.div().classes("downloads"):
                self.report = self._download("report.html", self._report)
                self.json = self._download("model.json", self._model)
                self.all = self._download("all.zip", self._everything)
                self.exports = html.div()
                with self.exports:
                    self._exports()
                self.no_exports = action("Export", lambda: None, "plain", "export")
                self.no_exports.set_enabled(False)

    def _download(self, name: str, make: Callable[[], Awaitable[None]]) -> ui.button:
        button = action(name, self.page.guarded(make), "plain", name.partition(".")[0])
        return button.props("icon=download")

    def _enable(self, found: Found) -> None:
        """Offer the downloads that this model has."""
        fitted = found.stage != "provisional"
        self.json.set_enabled(fitted)
        self.all.set_enabled(fitted and not self.session.waiting)
        self.report.set_enabled(self.all.enabled and found.model.diagnostics is not None)
        self.exports.set_visibility(fitted)
        self.no_exports.set_visibility(not fitted)

    def _formula(self, found: Found, notation: Notation) -> None:
        model = found.model
        if found.stage == "provisional":
            self._provisional()
        else:
            status(model, found.validation, notation)
            notes(model, notation)
            self._remedies(notation)
        with panel("equations"):
            for name, terms in (("L", model.terms), ("ψ", model.dissipation)):
                if not terms:
                    continue
                with html.p().classes("formula"):
                    say(f"{name} =", "name", "span")
                    for addend in notation.addends(terms):
                        math(addend)
            if any("sqrt" in term.expression and "_dot" in term.expression for term in model.dissipation):
                say("|velocity| is dry friction; near rest it is smoothed.", "help")

    def _provisional(self) -> None:
        why = self.session.faults.get(self.session.place)
        with html.div().classes("status doubtful"):
            with html.p().props("role=status"):
                say("provisional", "badge", "span")
                say(
                    "These numbers are from the quadratic model of the likelihood about the chosen structure"
                    + ("; refining…" if why is None else "."),
                    "",
                    "span",
                )
            if why is not None:
                say(f"Refining them failed: {in_words(why, self.session.folder)}.").props("role=alert")

    def _no_forecast(self, found: Found) -> None:
        """Show why there is no forecast of this model."""
        if self.session.waiting:
            say("It follows when the model is refined." if found.stage == "provisional" else "Forecasting…")
        elif found.stage == "provisional":
            say("Only refined models are forecast.", "help")
        else:
            why = found.motion_fault or self.session.faults[self.session.place]
            fault(f"There is no forecast: {in_words(why, self.session.folder)}")

    def _forecast(self, found: Found, notation: Notation) -> None:
        motion, model = found.motion, found.model
        with panel():
            title("Forecast")
            if motion is None:
                self._no_forecast(found)
                return
            kind = "which was held out of the fit" if motion.held_out else "which is part of the fit"
            names = self.session.data.names if self.session.data else ()
            short = dict(zip(names, labels(names), strict=True)).get(motion.trial, motion.trial)
            where = f"trial {short}" if short else "the data"
            length = motion.t[-1] - motion.t[0]
            holds = f"agrees for {motion.valid_time:.3g} s"
            if motion.valid_time > 0.99 * length:
                holds = "agrees to the end"
            elif motion.valid_time <= 0:
                holds = "is off from the start"
            say(
                f"Simulated for {length:.3g} s along {where}, {kind}, the model {holds}."
                + (f" It ends early: {motion.note}." if motion.note else "")
            )
            with html.p().classes("keys"):
                say("measured", "key dots", "span")
                if motion.estimated:
                    say("estimated, no sensor", "key dash estimate", "span")
                say("forecast", "key line forecast", "span")
            if motion.unseen:
                names = [notation.text(name) for name in model.coordinates]
                say(unseen_words(motion, names, model.diagnostics is not None), "help")
            kind = stick_kind(model, self._angles)
            with html.div().classes("halves" if kind else "stack"):
                with html.div():
                    data = frames(motion, model, kind=kind) if kind else {}
                    if kind:
                        Stick(data)
                    say(stick_words(kind, model, data), "help")
                self.figures = html.div().classes("figures" if kind else "figures side")
        ui.timer(
            0.01, self.page.guarded(lambda box=self.figures: self._draw(box, found, notation)), once=True
        )

    async def _draw(self, box: ui.element, found: Found, notation: Notation) -> None:
        model, motion = found.model, found.motion
        assert motion is not None
        for i, name in enumerate(model.coordinates[:_MOST_DRAWN]):
            unit = "rad" if name in self._angles else ""
            figure = await aside(forecast_figure, motion, i, notation.text(name), unit)
            if box.is_deleted:
                return
            with box:
                drawn(figure, "figure")

    async def _report(self) -> None:
        text = await aside(self.session.write_report)
        ui.download.content(text.encode(), "report.html", "text/html")

    def _remedies(self, notation: Notation) -> None:
        """Buttons that change the choices and start the search again."""
        found = offers(self.session)
        if found:
            with html.div().classes("heading offers"):
                say("Search again with one change:", "help")
                for offer in found:
                    ask = self.page.guarded(lambda _=None, offer=offer: self._again(offer))
                    action(in_names(offer.words, notation), ask, "quiet").props("icon=replay").mark("remedy")

    def _compare(self, found: Found, notation: Notation) -> None:
        """A comparison with the kept model, and a button to keep the present one."""
        kept = self.session.kept
        if kept is None or kept is found or kept.model.coordinates != found.model.coordinates:
            with html.div().classes("heading offers"):
                if kept is found:
                    say("Kept: the next result will be compared with this one.", "help")
                else:
                    action("Keep for comparison", self.page.guarded(self._keep), "quiet", "keep")
            return
        with panel("compared"):
            with html.div().classes("heading"):
                title("Compared with the kept model")
                action("Keep this one instead", self.page.guarded(self._keep), "quiet", "keep")
            head = (("", ""), ("this model", "n"), ("kept", "n"))
            table("This model and the kept one", head, compared(found, kept, notation))

    def _keep(self) -> None:
        self.session.kept = self.session.current
        self.refresh()

    def _again(self, offer: Offer) -> None:
        take(self.session, offer)
        self.page.show("result")

    def _exports(self) -> None:
        """The formats with their descriptions, behind a button."""
        # Not the menu of Quasar: that lies outside the landmarks of the page.
        with disclosure("Export", "export"):
            for name, what in FORMATS.items():
                with html.button().classes("format").mark(f"export-{name}") as button:
                    say(name, "name", "span")
                    say(what, "help", "span")
                button.on("click", self.page.guarded(lambda _=None, name=name: self._export(name)))

    async def _export(self, format: str) -> None:
        name, content = await aside(exported, self.session.current.model, format)
        ui.download.content(content, name)

    async def _everything(self) -> None:
        ui.download.content(await aside(self.session.write_everything), "leastaction.zip", "application/zip")

    async def _model(self) -> None:
        text = await aside(self.session.write_model)
        ui.download.content(text.encode(), "model.json", "application/json")


def compared(one: Found, other: Found, notation: Notation) -> list[tuple[str, str, str]]:
    """Rows for two models of the same coordinates: verdict, forecasts, and every term of either."""

    def numbers(found: Found) -> dict[str, str]:
        return {
            row["text"]: row["value"] + (f" ± {row['error']}" if row["error"] else "")
            for group in coefficient_groups(found.model, notation)
            for row in group["rows"]
        }

    def forecast(found: Found) -> str:
        if found.validation is None or np.isnan(found.validation.rms_over_std).all():
            return "–"
        return f"{percent(float(np.nanmax(found.validation.rms_over_std)))} of the spread"

    here, there = numbers(one), numbers(other)
    rows = [
        ("verdict", one.model.fit.status, other.model.fit.status),
        ("error of forecasts of held-out trials", forecast(one), forecast(other)),
        ("χ² per sample", *(plain(found.model.fit.chi2_per_sample) for found in (one, other))),
    ]
    return rows + [
        (notation.term(text), here.get(text, "–"), there.get(text, "–")) for text in {**here, **there}
    ]


def _coefficients(found: Found, notation: Notation) -> None:
    model = found.model
    title("Coefficients")
    if found.stage == "provisional":
        say("Provisional: from the quadratic model.", "hint")
    with scroll("Table of coefficients"), html.table():
        with html.thead(), html.tr():
            for text, side in (("term", ""), ("coefficient", "n"), ("95 % interval", "n"), ("z", "n")):
                say(text, side, "th")
        with html.tbody():
            groups = coefficient_groups(model, notation)
            for symbol, row in [(group["symbol"], row) for group in groups for row in group["rows"]]:
                with html.tr().classes("known" if row["known"] else ""):
                    with html.td():
                        math(row["term"])
                        if symbol in _TAGS:
                            say(_TAGS[symbol], "tag", "span")
                    error = f" ± {row['error']}" if row["error"] else " (known)" if row["known"] else ""
                    say(row["value"] + error, "n", "td")
                    say(row["interval"], "n", "td")
                    say(row["z"], "n", "td")
    say(
        "z is the coefficient over its standard error; a term with z above 4 is hardly due to chance.", "help"
    )


def _simple_numbers(model: LagrangianModel, notation: Notation) -> None:
    rows = simple_rows(model, notation)
    if rows:
        title(captions.SIMPLE_TITLE, "h3")
        columns = ("subject", "value", "number", "chance")
        table(captions.SIMPLE_TITLE, captions.SIMPLE_HEAD, [[row[name] for name in columns] for row in rows])
        say(captions.simple_note(model.simple_constants), "help")


def _symmetries(model: LagrangianModel, notation: Notation) -> None:
    rows = symmetry_rows(model, notation)
    with panel("symmetries"):
        title(captions.SYMMETRY_TITLE)
        if not rows:
            say(captions.NO_SYMMETRIES, "help")
            return
        columns = ("name", "reach", "quantity", "outcome")
        table(
            "Table of symmetries", captions.SYMMETRY_HEAD, [[row[name] for name in columns] for row in rows]
        )
        say(captions.symmetry_note(model.symmetries), "help")


def _small_motions(model: LagrangianModel, notation: Notation) -> None:
    rows = motion_rows(model, notation)
    with panel("motions"):
        title(captions.MOTION_TITLE)
        if not rows:
            say(captions.NO_MOTIONS, "help")
            return
        summary = captions.motion_summary(model.small_motions, notation)
        if summary:
            say(summary)
        cells = [
            (row["place"], row["standing"], *("; ".join(mode[k] for mode in row["modes"]) for k in (0, 1)))
            for row in rows
        ]
        table("Table of equilibria", captions.MOTION_HEAD, cells)
        left_out = next((system.left_out for _, system in model.small_motions if system is not None), ())
        math(captions.motion_note(left_out, notation), "help", "p")
        gravity(model, notation)
