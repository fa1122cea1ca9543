"""Reads figures back: the corners of their paths and where their texts are, in pixels."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np

_NUMBER = r"-?(?:\d+\.?\d*|\.\d+)"
_COMMAND = re.compile(rf"([Mmlhvz])((?:\s*{_NUMBER})*)")


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
