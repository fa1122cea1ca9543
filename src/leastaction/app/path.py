"""The trade-off curve as something to walk along: one structure of each size."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from leastaction import LagrangianModel
    from leastaction.model.diagnostics import PathPoint

__all__ = ["Walk"]


@dataclass(frozen=True)
class Walk:
    """The best structure of each size, in rising size; the chosen one stands for its own."""

    points: tuple[PathPoint, ...]

    @classmethod
    def of(cls, model: LagrangianModel) -> Walk:
        """Take from a model's path what was computed and has a term of L; nothing without diagnostics."""
        best: dict[int, PathPoint] = {}
        friction = model.provenance.get("options", {}).get("dissipation", ())
        moves = any(term.known for term in model.terms)
        for point in model.diagnostics.path if model.diagnostics else ():
            usable = math.isfinite(point.bic) and math.isfinite(point.cost)
            usable = usable and (moves or any(text not in friction for text in point.expressions))
            if usable and (point.chosen or point.n_terms not in best):
                best[point.n_terms] = point
        return cls(tuple(best[size] for size in sorted(best)))

    @property
    def chosen(self) -> int:
        """Place of the chosen structure."""
        return next((k for k, point in enumerate(self.points) if point.chosen), 0)

    def difference(self, place: int) -> tuple[list[str], list[str]]:
        """Terms that a structure has more, and less, than the chosen one."""
        here, there = self.points[place].expressions, self.points[self.chosen].expressions
        return [e for e in here if e not in there], [e for e in there if e not in here]

    def verdict(self, place: int) -> str:
        """What the criterion says about a structure, in words."""
        point = self.points[place]
        if point.chosen:
            return "This is the structure that leastaction chose."
        size = f"{abs(point.bic):.3g}"
        if point.bic >= 0:
            return f"The criterion prefers the chosen structure by {size}; 10 is already a strong preference."
        return (
            f"The criterion alone prefers this one by {size}. It was not chosen because each further term "
            "takes away less than 5 % of the equation error: on hardware such terms mimic what is missing."
        )
