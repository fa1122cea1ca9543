"""Other structures of a model's trade-off curve as models of their own.

A point of the curve has coefficients from the quadratic model of the likelihood about the chosen fit

    cost(λ) ≈ cost(λ*) + ½ (λ − λ*)ᵀ A (λ − λ*),

so that a provisional model costs nothing.  Its refit needs no search: the structure is known, the grid is
that of the chosen fit, and so are data, outliers, and forces.  Shape parameters are fitted again, from the
numbers of the curve on; the quadratic model holds them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from leastaction.assembly import assemble_model
from leastaction.curve.knots import Knots, excerpt, lay_knots
from leastaction.data.coerce import arranged
from leastaction.diagnosis.verdict import verify
from leastaction.errors import DataError, InputError
from leastaction.estimation.build import ENOUGH_SAMPLES, Setup, states_along
from leastaction.estimation.fit import Fit
from leastaction.estimation.force_bias import no_bias
from leastaction.estimation.grid import Grid
from leastaction.estimation.hidden import knots_of_all
from leastaction.estimation.problem import Problem, Structure
from leastaction.estimation.profile import profiled
from leastaction.estimation.shape_ranges import ShapeRange, shape_ranges
from leastaction.estimation.shapes import fit_shapes
from leastaction.findings import Finding, find
from leastaction.identifiers import names_in_terms
from leastaction.library import Kind, Library, Term, make_term, shape_names
from leastaction.mechanics.euler_lagrange import EulerLagrange
from leastaction.model.checks import angles_in
from leastaction.model.diagnostics import Diagnostics, PathPoint
from leastaction.model.model import LagrangianModel
from leastaction.model.term import FitSummary, ModelTerm, ShapeParameter
from leastaction.selection.progress import Clock, Progress
from leastaction.selection.search_state import Search
from leastaction.selection.strategies import exact_equations, simulation_error
from leastaction.selection.strategies.feeding_friction import negative_friction
from leastaction.threads import single_threaded

__all__ = ["provisional", "refit"]


def provisional(model: LagrangianModel, point: PathPoint) -> LagrangianModel:
    """A structure of a model's trade-off curve, with the coefficients that the quadratic model expects.

    Parameters
    ----------
    model : LagrangianModel
        As `discover` has returned it.
    point : PathPoint
        One of ``model.diagnostics.path``.

    Returns
    -------
    LagrangianModel
        Known terms as in `model`; without covariance, diagnostics, and verdict. Shape parameters have the
        numbers of the curve, without errors.

    Raises
    ------
    InputError
        If the point has no coefficients, or no number for a shape parameter, or they make no model.
    """
    terms = _terms(model, point)
    return LagrangianModel(
        model.coordinates,
        tuple(term for kind, term in terms if kind == "lagrangian"),
        tuple(term for kind, term in terms if kind == "dissipation"),
        noise_std=model.noise_std,
        fit=FitSummary("doubtful"),
        provenance=_provenance(model, point),
        shapes=tuple(ShapeParameter(*pair) for pair in _numbers(model, point, terms).items()),
    )


@single_threaded()
def refit(model: LagrangianModel, point: PathPoint, progress: Progress | None = None) -> LagrangianModel:
    """Fit a structure of a model's trade-off curve to the model's data, on its grid.

    Slow forces that were found with the model stay as they are. Causes of an equation error are not looked
    for: what a smaller structure lacks is on the curve.

    Parameters
    ----------
    model : LagrangianModel
        As `discover` has returned it, with diagnostics.
    point : PathPoint
        One of ``model.diagnostics.path``.
    progress : callable, optional
        As for `discover`.

    Returns
    -------
    LagrangianModel
        With the trade-off curve of `model`, and shape parameters with standard errors and profiles. Friction
        that comes out negative is left out.

    Raises
    ------
    InputError
        If the model has no diagnostics, or the point no coefficients, or no number for a shape parameter.
    DataError
        If the fit of the structure does not converge, or its equations cannot be solved then.
    """
    before = model.diagnostics
    if before is None:
        raise InputError("the model has no diagnostics: a model from a file cannot be refitted")
    if model.calibration is not None:
        raise InputError(
            "a model with calibrated columns cannot be refitted; call discover with the terms of this point"
        )
    clock = Clock(progress)
    clock.start("prepare")
    setup = _setup(model, before, point)
    clock.start("refit")
    fit, feeding = _fit(setup, model, before, point)
    search = Search(
        setup.problem,
        setup.searched,
        setup.scales,
        fit.grid,
        setup.scales.smooth,
        no_bias(setup.problem.trajectories, {}),
        fit,
        knots_settled=all(finding.code != "knots-not-settled" for finding in model.fit.findings),
        feeding=feeding,
        findings=(*_by_hand(model, point), *_slow_forces(model)),
    )
    search = _with_shapes(exact_equations.run(search.at(fit.problem.shape_values)))
    search = simulation_error.run(search)
    clock.start("verify")
    search = search.now(profiled(search.found))
    verdict = verify(search, (), look_for_causes=False)
    clock.stop()
    found = assemble_model(setup, search, verdict, (), _lengths(model), clock.timings)
    assert found.diagnostics is not None
    # of the whole curve, not of this structure alone
    after = replace(
        found.diagnostics, path=before.path, dropped=before.dropped, force_offset=before.force_offset
    )
    return replace(found, provenance=_provenance(model, point), diagnostics=after)


def _terms(model: LagrangianModel, point: PathPoint) -> list[tuple[Kind, ModelTerm]]:
    """Kind and term: known ones, and those of the point; those of the model first, as it has them."""
    if (
        not len(point.expressions)
        == len(point.kinds)
        == len(point.coefficients)
        == len(point.standard_errors)
    ):
        raise InputError("this point of the trade-off curve has no coefficients")
    own: list[tuple[Kind, ModelTerm]] = []
    own.extend(("lagrangian", term) for term in model.terms)
    own.extend(("dissipation", term) for term in model.dissipation)
    place = {(kind, term.expression): k for k, (kind, term) in enumerate(own)}
    terms: list[tuple[Kind, ModelTerm]] = [(kind, term) for kind, term in own if term.known]
    numbers = zip(point.expressions, point.coefficients, point.standard_errors, strict=True)
    templates = point.templates or ("",) * point.n_terms
    terms.extend(
        (kind, ModelTerm(*term, template=template))
        for kind, term, template in zip(point.kinds, numbers, templates, strict=True)
    )
    return sorted(terms, key=lambda pair: place.get((pair[0], pair[1].expression), len(own)))


def _numbers(
    model: LagrangianModel, point: PathPoint, terms: Sequence[tuple[Kind, ModelTerm]]
) -> dict[str, float]:
    """The numbers of the shape parameters in these terms."""
    found = {shape.name: shape.value for shape in model.shapes} | dict(point.shapes)
    names = names_in_terms(model.coordinates)
    used = shape_names([make_term(t.template, names, kind=kind) for kind, t in terms if t.template])
    for name in used:
        if name not in found:
            raise InputError(
                f"this point of the trade-off curve has no number for the shape parameter {name!r}"
            )
    return {name: found[name] for name in used}


def _by_hand(model: LagrangianModel, point: PathPoint) -> tuple[Finding, ...]:
    """What is to be said of a structure that the search did not choose."""
    if point.chosen:
        return ()
    return (find("another-structure", reason=point.reason, bic=point.bic, relevance=_relevance(model)),)


def _slow_forces(model: LagrangianModel) -> tuple[Finding, ...]:
    return tuple(finding for finding in model.fit.findings if finding.code == "slow-force")


def _relevance(model: LagrangianModel) -> float | None:
    options = model.provenance.get("options", {})
    return options.get("relevance") if isinstance(options, Mapping) else None


def _lengths(model: LagrangianModel) -> dict:
    """The options of a discovery that findings on its result need."""
    return {"lengths": model.provenance.get("options", {}).get("lengths", {})}


def _provenance(model: LagrangianModel, point: PathPoint) -> dict:
    """That of the model, with the structure that was asked for."""
    return {**model.provenance, "structure": list(point.expressions)}


def _setup(model: LagrangianModel, before: Diagnostics, point: PathPoint) -> Setup:
    """The problem of the model with the candidates of one structure."""
    names = names_in_terms(model.coordinates)
    terms: dict[Kind, list[ModelTerm]] = {"lagrangian": [], "dissipation": []}
    pairs = _terms(model, point)
    for kind, term in pairs:
        terms[kind].append(term)
    numbers = _numbers(model, point, pairs)
    parsed = {kind: [_candidate(t, kind, names, numbers) for t in group] for kind, group in terms.items()}
    library = Library(parsed["lagrangian"], model.coordinates, dissipation=parsed["dissipation"])
    places = [model.coordinates.index(name) for name in model.prescribed]
    candidates = EulerLagrange((*library.terms, *library.dissipation), model.coordinates, places)
    known = np.array([t.coefficient if t.known else np.nan for group in terms.values() for t in group])
    data, degree = before.trajectories, before.grid.spaces[0].degree
    hidden = tuple(k for k, name in enumerate(model.coordinates) if name in before.hidden_motion)
    searched = data if hidden else excerpt(data, ENOUGH_SAMPLES)
    measured = [name for name in model.coordinates if name not in before.hidden_motion]
    scales = knots_of_all(lay_knots(arranged(searched, measured), degree), hidden)
    ranges = _ranges(model, candidates.terms, scales)
    angles = tuple(angles_in(model.coordinates, model.provenance))
    problem = Problem(data, candidates, known, degree, ranges=ranges, hidden=hidden, angles=angles)
    return Setup(problem, problem.on(searched), library, scales, before.prepared)


def _candidate(term: ModelTerm, kind: Kind, names: Sequence[str], numbers: Mapping[str, float]) -> Term:
    """A term of the curve with its very text, of which a parsed one would change the blanks."""
    parsed = make_term(term.template or term.expression, names, kind=kind)
    return replace(replace(parsed, text=term.written).at(numbers), text=term.expression)


def _ranges(model: LagrangianModel, terms: Sequence[Term], scales: Knots) -> dict[str, ShapeRange]:
    """Where the shape parameters were looked for in the discovery; the bounds of the user hold again."""
    whole = [term.template.term for term in terms if term.template is not None]
    if not whole:
        return {}
    options = model.provenance.get("options", {})
    given = options.get("shapes", {}) if isinstance(options, Mapping) else {}
    held = {name: ends for name, ends in given.items() if name in shape_names(whole)}
    return shape_ranges(whole, states_along(model.coordinates, scales), held)


def _fit(
    setup: Setup, model: LagrangianModel, before: Diagnostics, point: PathPoint
) -> tuple[Fit, tuple[int, ...]]:
    """The fit of the structure, and the friction that had to be left out of it."""
    problem = setup.problem
    numbers = dict(zip(zip(point.kinds, point.expressions, strict=True), point.coefficients, strict=True))
    coefficients = np.array([numbers.get((term.kind, term.text), 0.0) for term in problem.terms])
    grid = Grid.lay(problem, float(model.provenance["knots_per_second"]))
    structure = Structure(problem.free)
    noise = np.where(np.isin(np.arange(model.n_dof), problem.hidden), 1.0, before.noise_std)
    start = grid.start(structure, before.control_points, coefficients, noise)
    # the curve obeys its equations better than the data prove: weights come down to those of the chosen fit
    weights = replace(start.weights, physics=np.fmin(start.weights.physics, before.physics_weight))
    start = replace(start, weights=weights)
    fit, feeding = fit_shapes(grid.fit(structure, start)), ()
    while fit.usable and (negative := negative_friction(fit)):
        feeding += tuple(negative)
        grid = grid.posed(fit.problem.excluding(list(negative)))
        fit = fit_shapes(grid.fit(fit.structure.without(negative), fit.start))
    if not fit.converged:
        raise DataError(f"the fit of this structure does not converge ({fit.status})")
    if not np.isfinite(fit.evidence):
        raise DataError("fitted, the equations of this structure cannot be solved along the motion")
    return fit, feeding


def _with_shapes(search: Search) -> Search:
    """The search with its shape parameters fitted at the weights that it has now."""
    fit = fit_shapes(search.found)
    return search.now(fit).at(fit.problem.shape_values)
