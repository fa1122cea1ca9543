"""The element that moves the links of a pendulum; the drawing is done in the browser by stick.js."""

from __future__ import annotations

from typing import Any

from nicegui import ui

__all__ = ["Stick"]


class Stick(ui.element, component="stick.js"):
    """Measured and forecast links, with play, pause, pace and a slider for the time."""

    def __init__(self, frames: dict[str, Any]) -> None:
        super().__init__()
        self._props["frames"] = frames
        self.classes("stick")
