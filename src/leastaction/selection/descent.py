"""discover(method="adam"): the paper's gradient descent in the place of the search and the joint fit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from leastaction.curve.smoothing import Smooth, smooth
from leastaction.errors import InputError
from leastaction.estimation.adam import AdamFit, AdamProblem, descend
from leastaction.estimation.adam_options import AdamOptions
from leastaction.estimation.gauss_newton import JointFit
from leastaction.estimation.joint import Physics, Weights, linearise
from leastaction.estimation.workspace import StructureFit, Workspace, greville_sites
from leastaction.selection.knots import Progress
from leastaction.selection.select import Selection

__all__ = ["select_by_descent"]

_REST = 1e-3  # not zero, which would mean: removed


def select_by_descent(
    workspace: Workspace, smoothed: Smooth, options: AdamOptions, progress: Progress, seed: int = 0
) -> tuple[Selection, Smooth]:
    """Run the paper's method; the workspace ends with the knots of the result, and so does the smooth curve.

    There is no covariance and no selection path: the method has none.
    """
    if options.knots_per_second is not None:
        workspace.set_knots(options.knots_per_second)
        smoothed = smooth(workspace.grid, workspace.times, workspace.values)
    rng = np.random.default_rng(seed)
    is_free = np.isnan(workspace.known)
    physics = Physics(workspace.columns, is_free, None)
    force = workspace.force_at if workspace.forces is not None else None
    problem = AdamProblem(workspace.grid, workspace.times, workspace.values, physics, force, options, rng)
    points = smoothed.control_points if options.start_curve == "smooth" else _through_samples(workspace)
    if options.pin_ends:
        points = points.copy()
        points[problem.ends] = _through_samples(workspace)[problem.ends]
    coefficients = _start(workspace, problem, options, points)

    def report(details: dict) -> None:
        progress("descent", {**details, "coefficients": workspace.named(details["coefficients"])})

    fit = descend(problem, points, coefficients, rng, report)
    return Selection(_structure(workspace, fit), {}, np.nan, True), smoothed


def _start(
    workspace: Workspace, problem: AdamProblem, options: AdamOptions, points: np.ndarray
) -> np.ndarray:
    """Coefficients to begin with; known ones in place."""
    is_known, given = ~np.isnan(workspace.known), options.start_coefficients
    coefficients = np.where(is_known, workspace.known, 1.0)
    if given == "regression":
        return problem.regress(points, coefficients)
    if isinstance(given, Mapping):
        places = {term.text: k for k, term in enumerate(workspace.columns.terms)}
        coefficients[~is_known] = _REST
        for text, value in given.items():
            if text not in places:
                raise InputError(
                    f"start_coefficients: {text!r} is not a candidate; write it as the library does"
                )
            if not is_known[places[text]]:
                coefficients[places[text]] = float(value)
    return coefficients


def _structure(workspace: Workspace, found: AdamFit) -> StructureFit:
    """The result in the form of a joint fit without covariance."""
    members = tuple(int(k) for k in workspace.free if found.coefficients[k] != 0.0)
    physics, index = workspace.physics(members)
    at = linearise(workspace.observations, physics, found.control_points, found.coefficients[index])
    noise_std = np.sqrt(at.squares / np.maximum(workspace.observations.counts, 1))
    unknown = np.full(workspace.observations.n_dof, np.nan)
    status = "converged" if found.converged else "step limit"
    if not np.isfinite(found.loss):
        status = "not finite"
    fit = JointFit(
        found.control_points,
        found.coefficients[index],
        np.full((len(members), len(members)), np.nan),
        at,
        np.nan,
        Weights(np.maximum(noise_std, workspace.observations.floors), unknown, 0.0 * unknown),
        status,
        found.iterations,
    )
    return StructureFit(members, found.coefficients, fit, np.nan)


def _through_samples(workspace: Workspace) -> np.ndarray:
    """Control points read off the samples at the knot averages, the ends at the first and last sample."""
    columns = []
    for space, t, q in zip(workspace.grid.spaces, workspace.times, workspace.values, strict=True):
        sites = greville_sites(space.knots, workspace.degree)
        samples = [(t[np.isfinite(c)], c[np.isfinite(c)]) for c in q.T]
        columns.append(np.column_stack([np.interp(sites, at, c) for at, c in samples]))
    return np.concatenate(columns)
