"""Figures of the pages: inline SVG in the colours of the style sheet, for wide and for narrow windows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import count
from typing import TYPE_CHECKING

from markupsafe import Markup

from leastaction.report.axes import Axes, thin_line
from leastaction.report.captions import estimate_title
from leastaction.report.figures_model import draw_forecast, draw_path, path_axes

if TYPE_CHECKING:
    from leastaction import Trajectory
    from leastaction.app.jobs import Motion, Walk
    from leastaction.curve.motion import SmoothMotion

__all__ = ["data_figure", "forecast_figure", "unseen_words", "walk_figure"]

_numbers = count()


def _both(
    draw: Callable[[tuple[float, float]], Axes],
    wide: tuple[float, float],
    narrow: tuple[float, float],
    title: str,
    alt: str,
) -> Markup:
    """The same figure in two shapes, of which the style sheet shows one, so that text keeps its size."""
    parts = []
    for name, size in (("wide", wide), ("narrow", narrow)):
        svg = draw(size).svg(f"figure{next(_numbers)}", title, alt)
        parts.append(f'<div class="{name}">{svg}</div>')
    return Markup("".join(parts))


def data_figure(run: Trajectory, smooth: SmoothMotion | None, i: int, name: str, unit: str) -> Markup:
    """Samples of a coordinate, and the smoothing spline as a line when it is available."""

    def draw(size: tuple[float, float]) -> Axes:
        axes = Axes(size)
        axes.samples(run.t, run.q[:, i], 4.4)
        if smooth is not None:
            axes.line(*thin_line(smooth.t, smooth.q[:, i], 1400), "fit", 1.4)
        axes.label("t", name, "s", unit)
        return axes

    line = ", the smoothing spline as a line" if smooth is not None else ""
    return _both(draw, (1080, 190), (350, 200), f"{name} over time", f"every sample{line}")


def forecast_figure(motion: Motion, i: int, name: str, unit: str) -> Markup:
    """Measured samples of a coordinate, or its estimated motion, and the free run of the model."""
    estimate = motion.estimated.get(i)

    def draw(size: tuple[float, float]) -> Axes:
        axes = Axes(size)
        draw_forecast(axes, motion.t, motion.measured[:, i], motion.forecast[:, i], estimate)
        axes.label("t", name, "s", unit)
        return axes

    alt = "the forecast as a line"
    if i not in motion.unseen:
        alt = f"measured samples, {alt}"
    elif estimate is not None:
        alt = f"the estimated motion with its 95 % band, {alt}"
    return _both(draw, (560, 210), (350, 200), f"forecast of {name}", alt)


def unseen_words(motion: Motion, names: Sequence[str], searched: bool) -> str:
    """What is shown of coordinates without a sensor; names of all, and whether a search has just ended."""
    parts: list[str] = []
    for i in motion.unseen:
        if i in motion.estimated:
            parts.append(f"{estimate_title(motion.estimated[i], names[i])}, in trials of the fit only.")
        else:
            why = "" if searched else ", because a session does not store its estimated motion"
            parts.append(f"{names[i]}: not measured. Only its forecast is drawn{why}.")
    return " ".join(parts)


def walk_figure(walk: Walk, place: int) -> Markup:
    """Criterion and misfit of each size, with the chosen structure and the one shown."""

    def draw(size: tuple[float, float]) -> Axes:
        axes = path_axes(size)
        axes.column(walk.points[place].n_terms, 14.0)
        draw_path(axes, walk.points)
        axes.label("number of free terms", "worse than chosen by")
        return axes

    alt = (
        "Criterion and misfit of the best structure of each size; the chosen one and the one shown are marked"
    )
    return _both(draw, (560, 260), (350, 240), "Number of terms against misfit", alt)
