"""discover(method="adam"): the gradient descent of the paper, instead of the search and the joint fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from leastaction.errors import InputError
from leastaction.estimation.adam import AdamFit, AdamOptions, AdamProblem, descend
from leastaction.estimation.fit import Fit
from leastaction.estimation.gauss_newton import JointFit
from leastaction.estimation.grid import Grid, greville_sites
from leastaction.estimation.joint import Physics, Weights
from leastaction.estimation.problem import Problem, Structure
from leastaction.estimation.protocols import linearise
from leastaction.selection.search_state import Search

__all__ = ["run_descent"]

_REST = 1e-3  # not zero, since zero marks a removed term


def run_descent(search: Search, options: AdamOptions) -> Search:
    """Run the paper's method, which has neither a covariance nor a path of structures."""
    grid, curve = search.grid, search.curve
    if options.knots_per_second is not None:
        grid = Grid.lay(search.problem, options.knots_per_second)
        curve = grid.smooth()
    problem, rng = grid.problem, np.random.default_rng(search.seed)
    physics = Physics(problem.candidates, ~problem.is_known, None)
    force = grid.force_at if grid.forces is not None else None
    values = [trajectory.q for trajectory in problem.trajectories]
    descent = AdamProblem(grid.spline, grid.times, values, physics, force, options, rng)
    points = curve.control_points if options.start_curve == "smooth" else _through_samples(grid)
    if options.pin_ends:
        points = points.copy()
        points[descent.ends] = _through_samples(grid)[descent.ends]
    coefficients = _start(problem, descent, options, points)

    def report(details: dict[str, Any]) -> None:
        search.report("descent", {**details, "coefficients": problem.named(details["coefficients"])})

    found = descend(descent, points, coefficients, rng, report)
    return replace(search.now(_fit(grid, found)), curve=curve, knots_settled=True)


def _start(problem: Problem, descent: AdamProblem, options: AdamOptions, points: np.ndarray) -> np.ndarray:
    """Coefficients to begin with; known ones in place."""
    given = options.start_coefficients
    coefficients = problem.completed(1.0)
    if given == "regression":
        return descent.regress(points, coefficients)
    if isinstance(given, Mapping):
        places = {term.text: k for k, term in enumerate(problem.terms)}
        coefficients[~problem.is_known] = _REST
        for text, value in given.items():
            if text not in places:
                raise InputError(
                    f"start_coefficients: {text!r} is not a candidate; write it as the library does"
                )
            if not problem.is_known[places[text]]:
                coefficients[places[text]] = float(value)
    return coefficients


def _fit(grid: Grid, found: AdamFit) -> Fit:
    """The result in the form of a fit without covariance."""
    structure = Structure(k for k in grid.problem.free if found.coefficients[k] != 0.0)
    physics, index = grid.physics(structure)
    observations = grid.observations
    at = linearise(observations, physics, found.control_points, found.coefficients[index])
    noise_std = np.sqrt(at.squares / np.maximum(observations.counts, 1))
    unknown = np.full(observations.n_dof, np.nan)
    status = "converged" if found.converged else "step limit"
    if not np.isfinite(found.loss):
        status = "not finite"
    solution = JointFit(
        found.control_points,
        found.coefficients[index],
        np.full((len(structure), len(structure)), np.nan),
        at,
        np.nan,
        Weights(np.maximum(noise_std, observations.floors), unknown, 0.0 * unknown),
        status,
        found.iterations,
    )
    return Fit.of(grid, structure, found.coefficients, solution, np.nan)


def _through_samples(grid: Grid) -> np.ndarray:
    """Control points read off the samples at the knot averages, the ends at the first and last sample."""
    columns: list[np.ndarray] = []
    for space, trajectory in zip(grid.spline.spaces, grid.problem.trajectories, strict=True):
        sites = greville_sites(space.knots, grid.problem.degree)
        t = trajectory.t
        samples = [(t[np.isfinite(c)], c[np.isfinite(c)]) for c in trajectory.q.T]
        inside: list[np.ndarray] = [np.interp(sites, at, c) for at, c in samples]
        columns.append(np.column_stack(inside))
    return np.concatenate(columns)
