"""Elements of the pages."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Hashable, Iterable, Mapping, Sequence
from typing import Any, TypeVar, cast

from markupsafe import Markup
from nicegui import events, html, run, ui

__all__ = [
    "Stick",
    "action",
    "aside",
    "choice",
    "disclosure",
    "drawn",
    "fault",
    "math",
    "panel",
    "say",
    "scroll",
    "table",
    "title",
]


R = TypeVar("R")
V = TypeVar("V", bound=Hashable)


async def aside(function: Callable[..., R], *arguments: Any) -> R:
    """Call a function in a thread, so that the page stays alive."""
    return cast(R, await run.io_bound(function, *arguments))


def say(text: str, classes: str = "", tag: str = "p") -> ui.label:
    """A line of text, which is never parsed as HTML."""
    line = ui.label(text).classes(classes)
    line.tag = tag
    return line


def title(text: str, tag: str = "h2") -> ui.label:
    """A heading."""
    return say(text, "", tag)


def panel(classes: str = "") -> ui.element:
    """A part of the page with a border."""
    return html.section().classes(f"panel {classes}")


def scroll(name: str) -> ui.element:
    """A box that scrolls by itself, also with the keyboard."""
    return html.div().classes("scroll").props(f'tabindex=0 role=region aria-label="{name}"')


def table(name: str, head: Sequence[tuple[str, str]], rows: Iterable[Sequence[str]]) -> ui.element:
    """A table that scrolls by itself; headings with the class of their column, cells of text or of markup."""
    box = scroll(name)
    with box, html.table():
        with html.thead(), html.tr():
            for text, side in head:
                say(text, side, "th")
        with html.tbody():
            for row in rows:
                with html.tr():
                    for cell, (_, side) in zip(row, head, strict=True):
                        if isinstance(cell, Markup):
                            with html.td().classes(side):
                                math(cell)
                        else:
                            say(cell, side, "td")
    return box


def choice(
    name: str, options: Mapping[V, str], value: V, on_change: Callable[[V], Awaitable[Any] | Any]
) -> ui.element:
    """A list to choose from: the element of the browser, which keyboards and screen readers know."""
    values = list(options)
    box = html.select().classes("choice").props(f'aria-label="{name}"')
    with box:
        for key, text in options.items():
            option = say(text, "", "option")
            if key == value:
                option.props("selected")

    def changed(event: events.GenericEventArguments) -> Awaitable[Any] | Any:
        return on_change(values[int(event.args)])

    box.on("change", changed, js_handler="(event) => emit(event.target.selectedIndex)")
    return box


def disclosure(name: str, mark: str) -> ui.element:
    """A list of buttons that a button opens; a click in it, a click elsewhere and Escape close it."""
    box = html.details().classes("disclosure").mark(mark)
    with box:
        html.summary(name).classes("action plain")
        # With a tab index, a click on a button keeps the focus inside in Safari, too.
        inside = html.div().classes("choices").props("tabindex=-1")
    box.on("click", js_handler="(e) => { if (e.target.closest('button')) e.currentTarget.open = false }")
    box.on(
        "focusout",
        js_handler="(e) => { const box = e.currentTarget; "
        "if (!box.contains(e.relatedTarget)) box.open = false }",
    )
    box.on(
        "keydown.esc",
        js_handler="(e) => { const box = e.currentTarget; box.open = false; "
        "box.querySelector('summary').focus() }",
    )
    return inside


def fault(text: str) -> ui.label:
    """One line with an error and its cure."""
    return say(text, "fault").props("role=alert")


def drawn(markup: Markup, classes: str = "") -> ui.element:
    """A figure or formula made by this package, with all user text escaped."""
    return ui.html(str(markup), sanitize=False).classes(classes)


def math(markup: Markup, classes: str = "", tag: str = "span") -> ui.element:
    """A formula within a line, or a sentence that contains some."""
    return ui.html(str(markup), sanitize=False, tag=tag).classes(classes)


def action(
    text: str, on_click: Callable[[], Awaitable[Any] | Any], kind: str = "plain", mark: str = ""
) -> ui.button:
    """A button: "main" for the next step, "plain" for others, "quiet" for small ones."""
    button = (
        ui.button(text, on_click=on_click, color=None)
        .props("no-caps unelevated no-wrap")
        .classes(f"action {kind}")
    )
    return button.mark(mark) if mark else button


class Stick(ui.element, component="stick.js"):
    """An animation, with play, pause, pace and a slider for the time; stick.js draws it.

    Parameters
    ----------
    frames : dict
        As from `leastaction.app.motion.frames` or `leastaction.app.arm.motion_of`.
    """

    def __init__(self, frames: dict[str, Any]) -> None:
        super().__init__()
        self._props["frames"] = frames
        self.classes(f"stick stick-{frames['kind']}")
