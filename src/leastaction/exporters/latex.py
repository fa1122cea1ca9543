"""A model as a formula."""

from __future__ import annotations

from leastaction.model.model import LagrangianModel

__all__ = ["write"]


def write(model: LagrangianModel) -> str:
    """Return the text."""
    return f"% Written by leastaction; needs amsmath.\n\\[\n{model.latex()}\n\\]\n"
