"""What the tests of the report share: readers of pages and figures, a model that needs no discovery."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np

from leastaction import (
    LagrangianModel,
    Trajectories,
    Trajectory,
)
from leastaction.curve.bspline import SplineGrid, uniform_space
from leastaction.model.diagnostics import Diagnostics, PathPoint
from leastaction.model.term import FitSummary, ModelTerm

_NUMBER = r"-?(?:\d+\.?\d*|\.\d+)"
_COMMAND = re.compile(rf"([Mmlhvz])((?:\s*{_NUMBER})*)")
_VOID = {"meta", "br", "img", "link", "input", "hr"}


@dataclass(eq=False)
class Node:
    """An element of the page."""

    tag: str
    attributes: dict[str, str | None]
    parent: Node | None = None
    children: list[Node | str] = field(default_factory=list)

    @property
    def text(self) -> str:
        return "".join(c if isinstance(c, str) else c.text for c in self.children)

    @property
    def ancestors(self) -> Iterator[Node]:
        node = self.parent
        while node is not None:
            yield node
            node = node.parent

    def elements(self) -> Iterator[Node]:
        for child in self.children:
            if isinstance(child, Node):
                yield child
                yield from child.elements()

    def all(self, *tags: str, **attributes: str) -> list[Node]:
        """Elements below this one with one of these tags, and with these attributes; class_ is one class."""
        kind = attributes.pop("class_", None)
        return [
            e
            for e in self.elements()
            if (not tags or e.tag in tags)
            and all(e.attributes.get(k) == v for k, v in attributes.items())
            and (kind is None or kind in (e.attributes.get("class") or "").split())
        ]

    def one(self, *tags: str, **attributes: str) -> Node:
        (found,) = self.all(*tags, **attributes)
        return found


class Page(HTMLParser):
    """Checks nesting; holds the tree, all tags with their attributes, and the text."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.root = self._at = Node("", {})
        self.text = ""
        self.feed(source)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        node = self._add(tag, attrs)
        if tag not in _VOID:
            self.open.append(tag)
            self._at = node

    def handle_startendtag(self, tag, attrs):
        self._add(tag, attrs)

    def _add(self, tag, attrs) -> Node:
        self.tags.append((tag, dict(attrs)))
        node = Node(tag, dict(attrs), self._at)
        self._at.children.append(node)
        return node

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        assert self._at.parent is not None
        self._at = self._at.parent

    def handle_data(self, data):
        self.text += data
        self._at.children.append(data)

    def by_id(self, name: str) -> Node:
        return self.root.one(id=name)

    def attributes(self, name: str) -> list[str]:
        return [
            value or "" for _, attributes in self.tags for key, value in attributes.items() if key == name
        ]


def pieces(d: str) -> list[np.ndarray]:
    """Corners of each piece of a path, (n, 2); a dot is a piece with the same corner twice."""
    assert re.fullmatch(rf"(?:[Mmlhvz](?:\s*{_NUMBER})*)*", d), d
    found: list[list[np.ndarray]] = []
    at = np.zeros(2)
    for letter, rest in _COMMAND.findall(d):
        numbers = [float(n) for n in re.findall(_NUMBER, rest)]
        if letter == "z":
            found[-1].append(found[-1][0])
            continue
        if letter in "hv":
            (along,) = numbers
            steps = [[along, 0.0] if letter == "h" else [0.0, along]]
        else:
            steps = np.reshape(numbers, (-1, 2)).tolist()
        for step in steps:
            at = np.array(step) if letter == "M" else at + step
            if letter in "Mm":
                found.append([])
            found[-1].append(at)
    return [np.array(piece) for piece in found]


class Figure:
    """An ``<svg>``, read as XML: it must be well formed."""

    def __init__(self, source: str) -> None:
        self.root = ElementTree.fromstring(source)
        self.box = [float(n) for n in self.root.attrib["viewBox"].split()]

    def paths(self, *words: str) -> list[list[np.ndarray]]:
        """Paths whose style has all these words, in the order of drawing."""
        found = [e for e in self.root.iter("path") if all(w in e.attrib["style"] for w in words)]
        return [pieces(e.attrib["d"]) for e in found]

    def path(self, *words: str) -> list[np.ndarray]:
        (found,) = self.paths(*words)
        return found

    def texts(self, kind: str, anchor: str = "start") -> list[tuple[float, float, str]]:
        """Place and words of the texts of one class."""
        return [
            (float(e.attrib["x"]), float(e.attrib["y"]), e.text or "")
            for e in self.root.iter("text")
            if e.attrib["class"] == kind and e.get("text-anchor", "start") == anchor
        ]

    @property
    def clip(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of what is not cut off."""
        (box,) = self.root.iter("clipPath")
        (rect,) = box
        x, y, width, height = (float(rect.attrib[key]) for key in ("x", "y", "width", "height"))
        return x, y, x + width, y + height


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
