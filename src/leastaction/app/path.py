"""The trade-off curve as something to walk along: one structure of each size."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from leastaction.findings import because

if TYPE_CHECKING:
    from leastaction import LagrangianModel
    from leastaction.model.diagnostics import PathPoint

__all__ = ["Walk"]


@dataclass(frozen=True)
class Walk:
    """The best structure of each size, in rising size; the chosen one stands for its own.

    Attributes
    ----------
    points : tuple of PathPoint
    relevance : float or None
        Share of the equation error that a term had to remove to stay.
    """

    points: tuple[PathPoint, ...]
    relevance: float | None = None

    @classmethod
    def of(cls, model: LagrangianModel) -> Walk:
        """The curve of a model that was discovered; without points if there are no diagnostics."""
        best: dict[int, PathPoint] = {}
        for point in model.diagnostics.path if model.diagnostics else ():
            finite = math.isfinite(point.bic) and math.isfinite(point.cost)
            if finite and (point.chosen or point.n_terms not in best):
                best[point.n_terms] = point
        relevance = model.provenance.get("options", {}).get("relevance")
        return cls(tuple(best[size] for size in sorted(best)), relevance)

    @property
    def chosen(self) -> int:
        """Place of the chosen structure."""
        return next((k for k, point in enumerate(self.points) if point.chosen), 0)

    def difference(self, place: int) -> tuple[list[str], list[str]]:
        """Terms that a structure has more, and less, than the chosen one."""
        here, there = self.points[place].written, self.points[self.chosen].written
        return [e for e in here if e not in there], [e for e in there if e not in here]

    def verdict(self, place: int) -> str:
        """What the criterion says about a structure, and why it was not chosen, in words."""
        point = self.points[place]
        if point.chosen:
            return "This is the structure that leastaction chose."
        size, why = f"{abs(point.bic):.3g}", because(point.reason, self.relevance)
        if point.bic >= 0:
            text = f"The criterion prefers the chosen structure by {size}; 10 is already a strong preference."
        else:
            text = f"The criterion alone prefers this one by {size}."
        if not why:
            return text
        hint = " On hardware such terms mimic what is missing." if point.reason == "irrelevant" else ""
        return f"{text} It was not chosen because {why}.{hint}"
