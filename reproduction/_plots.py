"""What the figures share: cases solved once, how they look, and how they are written.

The same numbers give the same bytes.
"""

from __future__ import annotations

import io
from functools import lru_cache
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from reproduction import methods
from reproduction.problem import Answer, Case, Problem, pose

__all__ = ["COLOURS", "STYLE", "TITLES", "Sheet", "label", "letter", "solved", "write_png", "write_svg"]

TITLES = {"ours": "leastaction", "adam": "paper's method"}

# Colours that stay apart for all kinds of colour vision: Okabe & Ito, Color Universal Design (2008).
COLOURS = {
    "truth": "#000000",
    "ours": "#0072B2",
    "adam": "#D55E00",
    "no-regularisation": "#009E73",
    "data": "#8C8C8C",
    "magnets": ("#0072B2", "#E69F00", "#009E73"),
}

STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 7.5,
    "axes.titlesize": 8.0,
    "axes.labelsize": 7.5,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "lines.linewidth": 1.0,
    "lines.solid_capstyle": "round",
    "mathtext.fontset": "dejavusans",
    "figure.facecolor": "white",
    "svg.hashsalt": "reproduction",
}


@lru_cache(maxsize=8)
def solved(case: Case) -> tuple[Problem, Answer]:
    """Pose a case and solve it by its method."""
    problem = pose(case)
    return problem, methods.load(case.method).solve(problem)


def label(method: str, noise: float) -> str:
    return f"{TITLES[method]}, {100 * noise:g} % noise"


class Sheet:
    """A figure whose axes are placed in inches from its lower left corner."""

    def __init__(self, width: float, height: float) -> None:
        self.size = np.array([width, height])
        self.figure = Figure(figsize=(width, height))

    def axes(self, left: float, bottom: float, width: float, height: float) -> Axes:
        return self.figure.add_axes(
            (*(np.array([left, bottom]) / self.size), *(np.array([width, height]) / self.size))
        )

    def text(self, left: float, bottom: float, text: str, **style) -> None:
        self.figure.text(*(np.array([left, bottom]) / self.size), text, **style)


def letter(ax: Axes, text: str) -> None:
    """Name a panel, in bold, above its left corner."""
    ax.annotate(
        text, (0, 1), (0, 4), xycoords="axes fraction", textcoords="offset points", weight="bold", size=8.0
    )


def write_svg(figure: Figure, path: Path) -> None:
    with matplotlib.rc_context(STYLE):
        figure.savefig(path, format="svg", metadata={"Date": None, "Creator": None})


def write_png(figure: Figure, path: Path, dpi: float) -> None:
    """Write an image of 256 colours at most, which is a third of the size and looks the same."""
    buffer = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(buffer, format="png", dpi=dpi)
    image = Image.open(buffer).convert("RGB").quantize(256, dither=Image.Dither.NONE)
    image.save(path, optimize=True, dpi=(dpi, dpi))
