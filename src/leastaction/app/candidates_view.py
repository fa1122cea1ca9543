"""Second step: candidates, friction, known coefficients, forces, and held-out trials."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from nicegui import html, ui

from leastaction.app.candidates import (
    FAMILIES,
    faults,
    friction_choices,
    lines,
    shown_names,
    split_trials,
)
from leastaction.app.columns import written_names
from leastaction.app.parts import action, fault, math, panel, say, title
from leastaction.errors import InputError
from leastaction.identifiers import counted

if TYPE_CHECKING:
    from leastaction import Library
    from leastaction.app.page import Page

__all__ = ["show"]

_MOST_FAULTS = 4
_WORDS = {
    "compact": "enough for most pendulums and carts",
    "chain": "for planar links in a row, with the angles in the order from the base on",
    "standard": "also sines of sums and differences, higher powers",
    "large": "also inverse powers, logarithms and gyroscopic terms; for coordinates that stay positive",
}


def show(page: Page) -> None:
    """Fill the view."""
    if page.session.data is None:
        fault("There are no data yet; open a file or an example first.")
        return
    CandidatesView(page).build()


class CandidatesView:
    """Elements of the view that change; every change is checked at once."""

    def __init__(self, page: Page) -> None:
        assert page.session.data is not None
        self.page, self.choice, self.data = page, page.session.choice, page.session.data

    def build(self) -> None:
        title("Which terms may the Lagrangian contain?", "h1")
        with html.div().classes("halves"):
            with panel():
                self._candidates()
            with panel("stack"):
                self.friction = html.div().classes("stack")
                self._friction()
                self._known()
                self._lengths()
                self._hidden()
                self._forces()
                if len(self.data) > 1:
                    self._held_out()
        with html.div().classes("run") as self.bar:
            self.summary = html.div().classes("summary").props("aria-live=polite")
            self.button = action("Find the Lagrangian", self.page.guarded(self._start), "main", "discover")
        self._check()

    @property
    def names(self) -> tuple[str, ...]:
        """Coordinates of the law; those without a sensor if their names are valid."""
        try:
            return (*self.data.coordinates, *self.choice.unseen(self.data.coordinates))
        except InputError:
            return self.data.coordinates

    @property
    def angles(self) -> list[str]:
        unseen = self.names[len(self.data.coordinates) :]
        return [*self.page.session.angles, *(unseen if self.choice.hidden_angles else ())]

    @property
    def written(self) -> dict[str, str]:
        """Coordinate -> name of its column, where they differ."""
        return written_names(self.page.session.moving)

    def _candidates(self) -> None:
        title("Candidates")
        toggle = ui.toggle({False: "Generated", True: "Written by hand"}, value=self.choice.written)
        toggle.props("no-caps unelevated spread toggle-text-color=on-accent").classes("toggle").mark(
            "written"
        )
        toggle.on_value_change(self.page.guarded(lambda e: self._set_written(e.value)))
        self.source = html.div().classes("stack")
        self._show_source()

    def _set_written(self, written: bool) -> None:
        if written and not self.choice.text.strip():
            generated = self.choice.generated(self.names, self.angles)
            self.choice.text = "\n".join(term.text for term in generated)
        self.choice.written = written
        self._show_source()
        self._check()

    def _show_source(self) -> None:
        self.source.clear()
        with self.source:
            if self.choice.written:
                self._written()
            else:
                self._sizes()

    def _sizes(self) -> None:
        names, angles, gyroscopic = self.names, self.angles, self.choice.gyroscopic
        sizes = self.choice.sizes(names, angles)
        options = {size: f"{size}: {counted(count, 'candidate')}" for size, count in sizes.items()}
        say("Generated from the kinds of your coordinates: products of velocities, and potentials.", "help")
        radio = ui.radio(options, value=self.choice.size_for(names, angles)).classes("sizes").mark("size")
        radio.on_value_change(self.page.guarded(lambda e: self._set(size=e.value)))
        self.size_words = say("", "help")
        if len(names) > 1:
            box = ui.checkbox("also terms linear in the velocities", value=gyroscopic).props("dense")
            box.mark("gyroscopic").on_value_change(self.page.guarded(lambda e: self._set_gyroscopic(e.value)))
            say("For spinning rotors, rotating frames and charges in magnetic fields.", "help")
        with ui.expansion("The candidates as formulas").classes("formulas"):
            self.formulas = html.div().classes("terms")

    def _set_gyroscopic(self, gyroscopic: bool) -> None:
        self.choice.gyroscopic = gyroscopic
        self._show_source()
        self._check()

    def _written(self) -> None:
        say(
            "One expression a line; # starts a comment. You may use + − * / **, sin cos tan exp log sqrt "
            f"abs, pi, the coordinates and their velocities, such as {self.data.coordinates[0]}_dot.",
            "help",
        )
        area = self._area(self.choice.text, "text", "Candidates, one expression a line", rows=14)
        area.mark("text")
        self.text_faults = html.div().classes("faults").props("aria-live=polite")

    def _area(self, value: str, name: str, label: str, rows: int) -> ui.textarea:
        area = ui.textarea(value=value)
        area.props(
            f'outlined debounce=300 rows={rows} spellcheck=false autocapitalize=off aria-label="{label}"'
        )
        area.classes("code").on_value_change(self.page.guarded(lambda e: self._set(**{name: e.value or ""})))
        return area

    def _friction(self) -> None:
        self.friction.clear()
        words = "Tick every kind that may exist; absent friction is not selected."
        with self.friction, _field("Friction", words):
            self._boxes("friction", friction_choices(self.names, self.written))
            more = bool(self.choice.more_friction or self.choice.families)
            with ui.expansion("Other friction", value=more).classes("formulas"):
                say("In every coordinate:", "help")
                self._boxes("families", FAMILIES)
                say("Rayleigh functions ψ, one a line; the force is −∂ψ/∂q̇.", "help")
                self._area(self.choice.more_friction, "more_friction", "Other friction terms", rows=2)

    def _boxes(self, name: str, options: Iterable[tuple[str, str]]) -> None:
        """A box for each option of a list of the choice: its label, and its value in the list."""
        with html.div().classes("checks"):
            for words, item in options:
                box = ui.checkbox(words, value=item in getattr(self.choice, name)).props("dense")
                box.mark(f"{name}-{item}")
                box.on_value_change(self.page.guarded(lambda e, i=item: self._tick(name, i, e.value)))

    def _tick(self, name: str, item: str, on: bool) -> None:
        others = [i for i in getattr(self.choice, name) if i != item]
        self._set(**{name: others + ([item] if on else [])})

    def _known(self) -> None:
        if self.data.driven:
            first = self.data.coordinates[0]
            words = f"Optional: known forces set the scale. One a line, as in {first}_dot**2 = 0.5."
        else:
            words = (
                "Without known forces, L and 2 L describe the same motion, so one coefficient must be given. "
                "It sets the scale of the others. One a line."
            )
        with _field("Known coefficients", words):
            self._area(self.choice.known, "known", "Known coefficients", rows=2).mark("known")

    def _lengths(self) -> None:
        if not self.angles:
            return
        words = (
            "Optional, in metres: from joint to joint, or of the equivalent simple pendulum. The result then "
            f"states g, which shows whether the units are right. One a line, as in {self.angles[0]} = 0.3."
        )
        with _field("Lengths of links", words):
            self._area(self.choice.lengths, "lengths", "Lengths of links", rows=2).mark("lengths")

    def _hidden(self) -> None:
        words = (
            "Names, separated by commas. Their motion is estimated with the law. Offer few candidates: "
            "compact, or written by hand."
        )
        with _field("Coordinates without a sensor", words):
            entry = ui.input(value=self.choice.hidden).classes("code").mark("hidden")
            entry.props('outlined dense debounce=300 aria-label="Coordinates without a sensor"')
            entry.on_value_change(self.page.guarded(lambda e: self._rename(hidden=e.value or "")))
            box = ui.checkbox("they are angles", value=self.choice.hidden_angles).props("dense")
            box.mark("hidden-angles")
            box.on_value_change(self.page.guarded(lambda e: self._rename(hidden_angles=e.value)))

    def _rename(self, **values: str | bool) -> None:
        """Other coordinates have other candidates and other friction."""
        for name, value in values.items():
            setattr(self.choice, name, value)
        self._show_source()
        self._friction()
        self._check()

    def _forces(self) -> None:
        names = [(text, c) for c, text in shown_names(self.data.coordinates, self.written).items()]
        if self.data.driven:
            words = (
                "How much later they act than recorded; half a sampling interval if a controller holds them "
                "between samples."
            )
            with _field("Delay of the forces", words):
                self._number(
                    "delay", 1e3 * self.choice.delay, "Milliseconds", lambda ms: 1e-3 * ms, suffix="ms"
                )
        with _field(
            "Unknown constant force", "The bias of a sensor, or a load on one side. It is estimated."
        ):
            self._boxes("offsets", names)
        if len(names) > 1:
            words = "By a motor, a hand or the ground. Only the equations of the other coordinates are used."
            with _field("Moved by unmeasured forces", words):
                self._boxes("prescribed", names)

    def _number(
        self, name: str, value: float, label: str, convert: Callable[[float], float], **limits
    ) -> None:
        number = ui.number(value=value, **limits)
        number.props(f'outlined dense aria-label="{label}"').classes("number").mark(name)
        number.on_value_change(self.page.guarded(lambda e: self._set(**{name: convert(e.value or 0)})))

    def _held_out(self) -> None:
        with _field("Trials held out", "They are not fitted but forecast, as a test of the result."):
            if self.choice.every_third:
                say("Every third trial, as in the published comparison.")
                return
            most = len(self.data) - 1
            label = "Number of trials held out"
            self._number("held_out", self.choice.held_out, label, int, min=0, max=most, step=1, format="%d")

    def _set(self, **values) -> None:
        for name, value in values.items():
            setattr(self.choice, name, value)
        self._check()

    def _check(self) -> None:
        """Show a summary of the choice, or its first error."""
        choice, data = self.choice, self.data
        bad: list[str] = []
        if choice.written:
            bad = faults(choice.text, self.names)
            self._show_faults(bad)
        else:
            size = choice.size_for(self.names, self.angles)
            self.size_words.text = f"{size.capitalize()}: {_WORDS[size]}."
        text, problem = "", _problem(bad)
        try:
            library = choice.library(data.coordinates, self.page.session.angles)
            if not choice.written:
                self._show_formulas(library)
            choice.known_terms(library, data.driven)
            choice.links(library.coordinates)
            choice.forces(data)
            fitted, held_out = split_trials(data, choice.held_out, choice.every_third)
            text = (
                f"{counted(len(library), 'candidate')}, {len(library.dissipation) or 'none'} for friction; "
                f"{counted(len(fitted), 'trial')} fitted"
                + (f", {len(held_out)} held out" if held_out is not None else "")
            )
        except InputError as error:
            problem = problem or self.page.words(error)
        self.summary.clear()
        with self.summary:
            if problem:
                fault(problem)
            else:
                say(text)
        self.button.set_enabled(not problem)

    def _show_faults(self, found: list[str]) -> None:
        self.text_faults.clear()
        with self.text_faults:
            for text in found[:_MOST_FAULTS]:
                fault(text)
            if len(found) > _MOST_FAULTS:
                say(f"and {len(found) - _MOST_FAULTS} more", "help")
            if not found:
                say(f"{counted(len(lines(self.choice.text)), 'expression')}, all readable", "fine")

    def _show_formulas(self, library: Library) -> None:
        from leastaction.model.mathml import Notation

        notation = Notation(library.coordinates, written=self.written)
        self.formulas.clear()
        with self.formulas:
            for term in library:
                math(notation.term(term.text), "term")

    def _start(self) -> None:
        self.page.session.discover()
        self.page.show("result")


def _problem(bad: list[str]) -> str:
    """A short message; the lines with errors are listed below the text."""
    return (
        f"{counted(len(bad), 'line')} among the candidates cannot be read; see below the text" if bad else ""
    )


def _field(label: str, help_text: str = "") -> ui.element:
    """A labelled part of a form."""
    box = html.div().classes("field")
    with box:
        say(label, "label", "h3")
        if help_text:
            say(help_text, "help")
    return box
