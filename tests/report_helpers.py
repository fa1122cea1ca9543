"""What the tests of the report share: a parser that checks nesting, and a model that needs no discovery."""

from __future__ import annotations

from html.parser import HTMLParser

import numpy as np

from leastaction import (
    LagrangianModel,
    Trajectories,
    Trajectory,
)
from leastaction._diagnostics import Diagnostics, PathPoint
from leastaction._model_parts import FitSummary, ModelTerm
from leastaction._spline import SplineGrid, uniform_space

_VOID = {"meta", "br", "img", "link", "input", "hr"}


class Page(HTMLParser):
    """Checks nesting; collects tags with their attributes, and the text."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(source)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in _VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data

    def attributes(self, name: str) -> list[str]:
        return [
            value or "" for _, attributes in self.tags for key, value in attributes.items() if key == name
        ]


def spring(
    friction: float = 0.0, name: str = "run", sigma: float = 0.01, seconds: float = 6.0
) -> LagrangianModel:
    """Oscillator whose fitted curve is its exact motion: fast, and everything about it is known."""
    rng = np.random.default_rng(1)
    space = uniform_space(0.0, seconds, 20.0)
    t = np.linspace(0.0, seconds, round(50 * seconds) + 1)
    rate = np.sqrt(4.0 - friction**2)

    def motion(t):
        return np.exp(-friction * t) * np.cos(rate * t)

    points = np.linalg.lstsq(space.basis(t).toarray(), motion(t)[:, None], rcond=None)[0]
    q = motion(t) + sigma * rng.standard_normal(t.size)
    diagnostics = Diagnostics(
        Trajectories([Trajectory(t, q, coordinates=["x"], name=name)]),
        SplineGrid([space]),
        points,
        np.array([sigma]),
        np.array([1e6]),
        np.array([1e-3]),
        (
            PathPoint(("x_dot**2",), 900.0, 893.0),
            PathPoint(("x_dot**2", "x**2"), 0.0, 0.0, True),
            PathPoint(("x_dot**2", "x**2", "x**4"), -1.5, 5.5),
            PathPoint(("x_dot**2", "x**4"), 400.0, 400.0),
        ),
        timings={"search": 0.2, "verify": 0.0},
    )
    dissipation = [ModelTerm("x_dot**2", friction / 2, 0.001)] if friction else []
    return LagrangianModel(
        ["x"],
        [ModelTerm("x_dot**2", 0.25, known=True), ModelTerm("x**2", -1.0, 0.002)],
        dissipation,
        noise_std=[sigma],
        fit=FitSummary("ok", 1.0, [1e6]),
        provenance={
            "version": "1.2.3",
            "options": {"known": {"x_dot**2": 0.25}, "angles": ["x"]},
            "data": "ab12",
        },
        diagnostics=diagnostics,
    )
