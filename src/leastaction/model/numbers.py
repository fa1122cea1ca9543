"""The numbers of a law: their values, their covariance, and the law as a function of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import sympy as sp

from leastaction.identifiers import names_in_terms
from leastaction.library import make_term, shape_symbol
from leastaction.mechanics.equations import Mechanics
from leastaction.simulation.law import Openness, Spectrum

if TYPE_CHECKING:
    from leastaction.model.model import LagrangianModel

__all__ = ["covariance_of", "openness_of", "principal", "values_of"]


def values_of(model: LagrangianModel) -> np.ndarray:
    """Coefficients of L and of ψ, then the shape parameters."""
    terms = [term.coefficient for term in (*model.terms, *model.dissipation)]
    return np.array([*terms, *(shape.value for shape in model.shapes)])


def covariance_of(model: LagrangianModel) -> np.ndarray:
    """Covariance of coefficients and shape parameters, zero for known ones; by default diagonal."""
    both = (*model.terms, *model.dissipation)
    errors = np.array([*(t.standard_error for t in both), *(s.standard_error for s in model.shapes)])
    out = np.diag(np.nan_to_num(errors) ** 2)
    if model.covariance is not None:
        free = [k for k, term in enumerate(both) if not term.known]
        free += range(len(both), len(errors))
        out[np.ix_(free, free)] = model.covariance
    return out


def principal(covariance: np.ndarray) -> np.ndarray:
    """Columns d such that Σ d dᵀ is the covariance."""
    sizes = np.sqrt(np.diag(covariance))
    scale = np.where(sizes > 0.0, sizes, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    kept = values > 1e-12
    return scale[:, None] * vectors[:, kept] * np.sqrt(values[kept])


def openness_of(model: LagrangianModel) -> Openness | None:
    """Uncertainty from standard errors and physics weights; None if the model has none of them."""
    both = (*model.terms, *model.dissipation)
    weights = np.array(model.fit.physics_weight)
    free = [i for i, name in enumerate(model.coordinates) if name not in model.prescribed]
    if len(weights) != model.n_dof or not (weights[free] > 0.0).all():
        return None
    if np.isnan([x.standard_error for x in (*both, *model.shapes) if not getattr(x, "known", False)]).any():
        return None
    density = np.zeros(model.n_dof)
    density[free] = 1.0 / weights[free]
    law = _parametric(model)
    rows = np.array(model.fit.error_spectrum)
    spectrum = Spectrum(rows[:, 0], rows[:, 1:]) if rows.size else Spectrum.white(density)
    return Openness(law.acceleration, values_of(model), principal(covariance_of(model)), spectrum)


def _parametric(model: LagrangianModel) -> Mechanics:
    """The law with symbols for coefficients and shape parameters, in the sequence of `values_of`."""
    names, both = names_in_terms(model.coordinates), (*model.terms, *model.dissipation)
    swap = {shape_symbol(s.name): sp.Symbol(f"s_{k}", real=True) for k, s in enumerate(model.shapes)}
    coefficients = [sp.Symbol(f"c_{k}", real=True) for k in range(len(both))]
    parts: list[sp.Expr] = [sp.Integer(0), sp.Integer(0)]
    for k, (term, coefficient) in enumerate(zip(both, coefficients, strict=True)):
        expr = make_term(term.template or term.expression, names).expr.xreplace(swap)
        parts[k >= len(model.terms)] += coefficient * expr
    fixed = [model.coordinates.index(name) for name in model.prescribed]
    return Mechanics(parts[0], parts[1], model.coordinates, [*coefficients, *swap.values()], fixed)
