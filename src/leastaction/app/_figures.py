"""Figures of the pages: inline SVG in the colours of the style sheet, for wide and for narrow windows."""

from __future__ import annotations

import threading
from collections.abc import Callable
from itertools import count
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from leastaction._report._figures_model import folded, frame_path
from leastaction._report._series import legible_samples, thin_line, thin_points
from leastaction._report._svg import COLOURS, dots, drawing, inline, label, panel

if TYPE_CHECKING:
    from leastaction import Trajectory
    from leastaction._smooth_motion import SmoothMotion
    from leastaction.app._jobs import Motion
    from leastaction.app._path import Walk

__all__ = ["DRAWING", "data_figure", "forecast_figure", "walk_figure"]

DRAWING = threading.Lock()
"""Matplotlib's settings belong to the process: one drawing at a time."""

_numbers = count()


def _both(
    draw: Callable[[Axes], None], wide: tuple[int, int], narrow: tuple[int, int], title: str, alt: str
) -> Markup:
    """The same figure in two shapes, of which the style sheet shows one: text keeps its size."""
    parts = []
    with DRAWING, drawing():
        for name, size in (("wide", wide), ("narrow", narrow)):
            axes = panel(size)
            draw(axes)
            parts.append(f'<div class="{name}">{inline(axes, f"figure{next(_numbers)}", title, alt)}</div>')
    return Markup("".join(parts))


def data_figure(run: Trajectory, smooth: SmoothMotion | None, i: int, name: str, unit: str) -> Markup:
    """Samples of a coordinate as dots, with the smoothing spline as a line once it is there."""

    def draw(axes: Axes) -> None:
        if smooth is None:
            dots(axes, *thin_points(run.t, run.q[:, i]), "measured", 2.8)
        else:
            t, q, quiet = legible_samples(run.t, run.q[:, i], float(smooth.noise_std[i]))
            dots(axes, t, q, "measured", 4.2 if quiet else 2.8, above=quiet)
            axes.plot(*thin_line(smooth.t, smooth.q[:, i], 1400), color=COLOURS["fit"], lw=1.4)
        label(axes, "t", name, "s", unit)

    line = ", the smoothing spline as a line" if smooth is not None else ""
    return _both(draw, (1080, 190), (350, 200), f"{name} over time", f"samples as dots{line}")


def forecast_figure(motion: Motion, i: int, noise_std: float, name: str, unit: str) -> Markup:
    """Measured samples of a coordinate and the free run of the model."""

    def draw(axes: Axes) -> None:
        measured, run = motion.measured[:, i], motion.forecast[:, i]
        t, q, quiet = legible_samples(motion.t, measured, noise_std)
        dots(axes, t, q, "measured", 4.5 if quiet else 3.0, above=quiet)
        there, seen = np.isfinite(run), measured[np.isfinite(measured)]
        if seen.size:
            # A run that leaves the data must not flatten them.
            reach = max(float(np.ptp(seen)), 1e-12)
            there &= (run > seen.min() - 20 * reach) & (run < seen.max() + 20 * reach)
            low, high = seen.min() - reach, seen.max() + reach
            ends = np.concatenate([seen, np.clip(run[there], low, high)])
            pad = 0.06 * max(float(np.ptp(ends)), 1e-12)
            axes.set_ylim(ends.min() - pad, ends.max() + pad)
        axes.plot(*thin_line(motion.t[there], run[there]), color=COLOURS["forecast"])
        axes.set_xlim(motion.t[0], motion.t[-1])
        label(axes, "t", name, "s", unit)

    return _both(
        draw,
        (560, 210),
        (350, 200),
        f"forecast of {name}",
        "measured samples as dots, the forecast as a line",
    )


def walk_figure(walk: Walk, place: int) -> Markup:
    """What each size costs: the criterion and the misfit, the chosen structure, and where one stands."""
    sizes = np.array([point.n_terms for point in walk.points])
    cost, bic = (folded(np.array([getattr(p, key) for p in walk.points])) for key in ("cost", "bic"))

    def draw(axes: Axes) -> None:
        axes.axvline(sizes[place], color=COLOURS["shade"], lw=14, zorder=0, solid_capstyle="butt")
        axes.plot(sizes, cost, color=COLOURS["measured"], lw=1.2, dashes=(4, 3))
        dots(axes, sizes, cost, "measured", 6.0)
        axes.plot(sizes, bic, color=COLOURS["fit"], lw=1.5)
        dots(axes, sizes, bic, "fit", 7.0)
        chosen = walk.chosen
        dots(axes, sizes[chosen : chosen + 1], bic[chosen : chosen + 1], "forecast", 12.0, above=True)
        frame_path(axes, sizes, np.concatenate([cost, bic]), 6)
        label(axes, "number of free terms", "worse than the chosen structure by")

    alt = (
        "Criterion and misfit of the best structure of each size; the chosen one and the one shown are marked"
    )
    return _both(draw, (560, 260), (350, 240), "Number of terms against misfit", alt)
