"""discover(): from trajectories and candidates to a model, in one call."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from importlib.metadata import PackageNotFoundError, version
from typing import NamedTuple

import numpy as np

from leastaction.curve.smoothing import Smooth
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.diagnosis.rates import doubts_about_rates
from leastaction.diagnosis.verdict import Verdict, verify
from leastaction.errors import DataError, InputError
from leastaction.estimation.adam_options import AdamOptions
from leastaction.estimation.joint import Weights
from leastaction.estimation.workspace import Workspace
from leastaction.findings import find
from leastaction.library import Library
from leastaction.mechanics.euler_lagrange import Points
from leastaction.model.diagnostics import Diagnostics, PathPoint
from leastaction.model.model import LagrangianModel
from leastaction.model.term import FitSummary, ModelTerm
from leastaction.selection.coarse_restart import improve_coarse, search_coarse
from leastaction.selection.descent import select_by_descent
from leastaction.selection.force_bias import Drift
from leastaction.selection.knots import Progress
from leastaction.selection.prepare import Prepared, prepare
from leastaction.selection.select import Selection, confirm_structure, select_structure

__all__ = ["discover"]

_ENOUGH = 50_000  # samples to search on; longer recordings enter when the structure is confirmed
_DEGREES = {"gauss-newton": 5, "adam": 3}  # of the splines, by method


def discover(
    trajectories: Trajectory | Trajectories | Iterable[Trajectory],
    library: Library | Iterable[str],
    known: Mapping[str, float] | None = None,
    dissipation: Iterable[str] = (),
    *,
    method: str = "gauss-newton",
    angles: Iterable[str] | None = None,
    force_offset: Iterable[str] | Mapping[str, float] = (),
    prescribed: Iterable[str] = (),
    robust: bool = True,
    degree: int | None = None,
    relevance: float = 0.05,
    seed: int = 0,
    options: AdamOptions | Mapping[str, object] | None = None,
    progress: Progress | None = None,
) -> LagrangianModel:
    r"""Find a sparse Lagrangian, and friction, from measured coordinates.

    Solves for L = Σ λ_k φ_k and ψ = Σ c_k ψ_k in

    .. math:: \frac{d}{dt}\frac{\partial L}{\partial \dot q_i} - \frac{\partial L}{\partial q_i}
              + \frac{\partial \psi}{\partial \dot q_i} = f_i

    by maximum likelihood for the curve q(t) and the coefficients together (Zhang & Sun 2026, solved as a
    banded nonlinear least-squares problem), with the terms chosen by a search on the weak form and the
    extended BIC.

    Parameters
    ----------
    trajectories : Trajectory, Trajectories or iterable of Trajectory
        Times in seconds, coordinates (NaN = missing), known generalised forces; measured velocities and
        accelerations, if any, are fitted too, each with a noise of its own.
    library : Library or iterable of str
        Candidates of L.
    known : mapping of str to float, optional
        Coefficients that are known. A system without known forces needs at least one: it sets the scale
        of L.
    dissipation : iterable of str
        Candidates ψ of the dissipation function; force −∂ψ/∂q̇. ``abs(x_dot)`` (Coulomb friction) is
        smoothed near zero velocity.
    method : {"gauss-newton", "adam"}
        ``"adam"`` is the paper's own method, gradient descent with thresholding, for comparison: slower,
        less accurate, with thresholds that depend on units, and without standard errors (NaN).
    angles : iterable of str, optional
        Coordinates from which jumps of 2π are removed; default: those of the library.
    force_offset : iterable of str, or mapping of str to float, optional
        Coordinates on which a force of unknown size may act beside the known ones, such as the bias of an
        actuator or of its sensor.  Constant: each adds the coordinate itself as a candidate of L, whose
        coefficient is the force.  A mapping gives the seconds within which the force may change (infinite:
        constant); it is then found in each trajectory as a cubic spline with knots so far apart
        (``diagnostics.force_offset``).  Choose them longer than a few periods of the motion.
    prescribed : iterable of str
        Coordinates that are measured, but moved by forces nobody knows: a trolley under its drive, a support
        that is shaken, a joint without a torque sensor. Their own equations are not used, and what only they
        contain (the trolley's mass) is not found; of the others everything is. In the model, the force on
        such a coordinate is its acceleration.
    robust : bool
        Leave out samples that are more than five standard deviations off a smooth motion and alone there
        (glitches of a camera, lost counts); a note says how many. Noise with heavy tails, more than 5 % of it
        out there, is kept. Without outliers nothing changes. ``method="adam"`` keeps every sample.
    degree : int
        Degree of the splines, at least 3; by default 5, and 3 for ``method="adam"`` as in the paper.
    relevance : float
        Share of the equation error's variance that a term must remove to stay. It matters on real hardware
        only, where the library is never exact and every candidate would become significant with enough
        data; 0 asks for significance alone.
    seed : int
        Of the simulated noise that the search weighs supports with; of the collocation times with adam.
    options : AdamOptions or mapping, optional
        Settings of ``method="adam"``; the default method has none.
    progress : callable, optional
        Called as ``progress(stage, details)``; where a stage has an intermediate law, ``details`` holds its
        ``"coefficients"`` (term → value) and the number of free ``"terms"``.

    Returns
    -------
    LagrangianModel
        With ``fit.status`` "ok" or "doubtful"; numerical failure never raises.

    Raises
    ------
    InputError
        Wrong arguments (a ValueError).
    DataError
        The data cannot support any model (a ValueError).

    Notes
    -----
    Not guaranteed: that the truth is in the library; that two structures can be told apart by these data.
    Intervals assume white Gaussian noise and a white equation error; where a machine moves in ways that the
    library cannot explain, those of free runs take their place (`fit` is doubtful then, and a note says so).

    Examples
    --------
    >>> from leastaction import discover, systems
    >>> data = systems.generate("cart_spring_pendulum", noise=0.01, trials=2, duration=10.0, seed=0)
    >>> cart = systems.get("cart_spring_pendulum")
    >>> model = discover(data, cart.library, known=cart.known)
    >>> sorted(term.expression for term in model.terms if not term.known)
    ['theta_dot**2', 'x', 'x**2', 'x_dot**2', 'x_dot*theta_dot*cos(theta)']
    >>> model.fit.status
    'ok'
    """
    if method not in _DEGREES:
        raise InputError(f"method {method!r} is unknown; choose one of {', '.join(map(repr, _DEGREES))}")
    if options is not None and method != "adam":
        raise InputError(f"method {method!r} has no options; options are for method='adam'")
    settings = AdamOptions.of(options)
    degree = _DEGREES[method] if degree is None else degree
    if not 0.0 <= relevance < 1.0:
        raise InputError(f"relevance is {relevance!r}; expected a share between 0 and 1, such as 0.05")
    clock = _Clock(progress)
    clock.start("prepare")
    dissipation = [dissipation] if isinstance(dissipation, str) else list(dissipation)
    trajectories = Trajectories.coerce(trajectories)
    prescribed = [prescribed] if isinstance(prescribed, str) else list(prescribed)
    constant, slow = _offsets(force_offset, trajectories.coordinates, prescribed)
    descent = method == "adam"
    if descent and slow:
        raise InputError(
            "method 'adam' takes forces as they are: a force_offset that changes needs the default"
        )
    # the slow force is wanted at all times, not on pieces
    most = None if descent or slow else _ENOUGH
    robust = robust and not descent
    unused = trajectories.rates if descent else ()
    if unused:
        trajectories = trajectories.without_rates()
    prepared = prepare(
        trajectories, library, known, dissipation, angles, degree, most, constant, robust, prescribed
    )
    doubts = doubts_about_rates(prepared.searched, prepared.knots.smooth)
    notes = [find("rates-unused")] if unused else []
    prepared = replace(prepared, findings=(*prepared.findings, *doubts, *notes))
    drift = Drift(prepared.trajectories, slow)
    workspace = prepared.workspace(prepared.euler_lagrange)
    _check_columns(workspace, prepared)
    if descent:
        clock.start("descent")
        smoothed = prepared.knots.smooth
        selection, smoothed = select_by_descent(workspace, smoothed, settings, clock.report, seed)
    else:
        workspace, selection, smoothed = _search(prepared, workspace, drift, clock, relevance, seed)
    if selection.structure.fit.status == "not finite":
        raise DataError(
            "no combination of these candidates can be followed along the data: the library may "
            "lack a kinetic term of a coordinate, a known value be far off, or a candidate such as log or "
            "1/x may be undefined there; begin with Library.mechanical or --library auto"
        )
    clock.start("verify")
    verdict = verify(workspace, selection, smoothed, prepared.knots.period)
    if not descent:
        better, notes = improve_coarse(prepared, workspace, selection.structure, clock.report)
        selection = replace(selection, structure=better)
        verdict = replace(verdict, findings=(*verdict.findings, *notes))
    clock.stop()
    given = {
        "method": method,
        "degree": degree,
        "relevance": float(relevance),
        "seed": int(seed),
        "known": {str(k): float(v) for k, v in (known or {}).items()},
        "dissipation": [t.text for t in prepared.library.dissipation],
        "angles": list(prepared.library.angles if angles is None else angles),
        "robust": robust,
        "force_offset": {**dict.fromkeys(constant), **drift.seconds_of},
        "prescribed": [prepared.library.coordinates[i] for i in prepared.prescribed],
    }
    if descent:
        given["adam"] = asdict(settings)
    return _model(prepared, workspace, selection, verdict, given, clock.timings, drift)


class _Found(NamedTuple):
    """A selection, the workspace of its knots, and the smooth curve before it."""

    workspace: Workspace
    selection: Selection
    smoothed: Smooth


def _search(
    prepared: Prepared, workspace: Workspace, drift: Drift, clock: _Clock, relevance: float, seed: int
) -> _Found:
    """Select a structure, with the forces that drift where some are asked for."""
    # data at fault: searching longer does not help
    thorough = not any(finding.severity == "warning" for finding in prepared.findings)
    found = _search_once(prepared, workspace, clock, relevance, seed, thorough and not drift.seconds)
    while drift.follow(found.workspace, found.selection.structure):
        clock.report("drift", drift.size)
        prepared = prepared.pushed(drift.forces)
        workspace = prepared.workspace(workspace.columns)
        found = _search_once(prepared, workspace, clock, relevance, seed, thorough)
    return _Found(*drift.settle(found.workspace, found.selection), found.smoothed)


def _search_once(
    prepared: Prepared, workspace: Workspace, clock: _Clock, relevance: float, seed: int, thorough: bool
) -> _Found:
    """Select a structure, on pieces of long recordings first."""
    clock.start("search")
    smoothed = prepared.knots.smooth
    selection = select_structure(workspace, smoothed, clock.report, relevance, seed, thorough)
    if thorough:
        coarse = prepared.knots.coarse
        workspace, selection = search_coarse(workspace, selection, coarse, clock.report, relevance, seed)
    share = prepared.searched.n_samples / prepared.trajectories.n_samples
    if share < 1.0 and selection.structure.fit.converged:
        clock.start("confirm")
        workspace, smoothed = prepared.whole_workspace(workspace.columns, workspace.knots_per_second)
        selection = confirm_structure(workspace, smoothed, selection, clock.report, relevance)
    return _Found(workspace, selection, smoothed)


def _offsets(
    given: Iterable[str] | Mapping[str, float], coordinates: tuple[str, ...], prescribed: list[str]
) -> tuple[list[str], dict[int, float]]:
    """Coordinates with a constant force, and numbers of those with a slow one → seconds."""
    if isinstance(given, str):
        given = [given]
    if not isinstance(given, Mapping):
        given = dict.fromkeys(given, np.inf)
    for name, seconds in given.items():
        if name not in coordinates:
            raise InputError(
                f"force_offset names {name!r}, which is not a coordinate; the coordinates are "
                f"{', '.join(coordinates)}"
            )
        if name in prescribed:
            raise InputError(
                f"force_offset names {name!r}, which is prescribed: any force may act there; leave out one "
                "of the two"
            )
        if isinstance(seconds, bool) or not isinstance(seconds, (int, float)) or not seconds > 0.0:
            raise InputError(
                f"force_offset of {name!r} is {seconds!r}; expected the seconds within which the force may "
                "change, infinite for a constant one"
            )
    slow = {coordinates.index(name): float(x) for name, x in given.items() if x < np.inf}
    return [name for name, x in given.items() if x == np.inf], slow


class _Clock:
    """Seconds of each stage, passed on to the user's progress display."""

    def __init__(self, progress: Progress | None) -> None:
        self.timings: dict[str, float] = {}
        self._progress = progress
        self._stage, self._since = "", 0.0

    def start(self, stage: str) -> None:
        self.stop()
        self._stage, self._since = stage, time.perf_counter()
        if self._progress:
            self._progress(stage, {})

    def report(self, stage: str, details: dict) -> None:
        if stage != self._stage:
            self.stop()
            self._stage, self._since = stage, time.perf_counter()
        if self._progress:
            self._progress(stage, details)

    def stop(self) -> None:
        if self._stage:
            spent = time.perf_counter() - self._since
            self.timings[self._stage] = self.timings.get(self._stage, 0.0) + spent
        self._stage = ""


def _check_columns(workspace: Workspace, prepared: Prepared) -> None:
    """Refuse candidates that are undefined along the data, by name."""
    states = workspace.grid.at_quadrature(prepared.knots.smooth.control_points)
    values = workspace.columns.strong(Points(*(s[:, 0] for s in states)))
    bad = [t.text for t, v in zip(prepared.columns, values, strict=True) if not np.isfinite(v).all()]
    if bad:
        raise DataError(
            f"the candidate {bad[0]} is undefined somewhere along the data (log, sqrt or division outside "
            "its domain); leave it out or shift the coordinate"
        )


def _model(
    prepared: Prepared, workspace: Workspace, selection: Selection, verdict: Verdict, options, timings, drift
):
    structure = selection.structure
    weights = structure.fit.weights
    rate_noise = _rate_noise(workspace, weights)
    findings = (
        *prepared.findings,
        *verdict.findings,
        *drift.findings(),
        *(find("rate-noise", name, quantity=quantity, noise=x) for (quantity, name), x in rate_noise.items()),
    )
    status = "doubtful" if any(finding.severity == "warning" for finding in findings) else "ok"
    members = dict(zip(structure.members, structure.standard_errors, strict=True))
    parts: dict[str, list[ModelTerm]] = {"lagrangian": [], "dissipation": []}
    for k, term in enumerate(prepared.columns):
        is_known = not np.isnan(prepared.known[k])
        if is_known or k in members:
            error = 0.0 if is_known else float(members[k])
            value = float(structure.coefficients[k])
            parts[term.kind].append(ModelTerm(term.text, value, error, is_known))
    density = weights.physics.copy()
    density[list(prepared.prescribed)] = np.nan
    diagnostics = Diagnostics(
        workspace.trajectories,
        workspace.grid,
        structure.fit.control_points,
        weights.position_std,
        density,
        verdict.equation_error,
        _path(prepared, selection),
        prepared.library.dropped,
        timings=timings,
        rate_noise_std={f"{quantity} of {name}": x for (quantity, name), x in rate_noise.items()},
        force_offset=drift.found(),
    )
    return LagrangianModel(
        prepared.library.coordinates,
        tuple(parts["lagrangian"]),
        tuple(parts["dissipation"]),
        None if np.isnan(structure.fit.covariance).any() else structure.fit.covariance,
        weights.position_std,
        FitSummary(status, verdict.chi2_per_sample, density.tolist(), findings=findings),
        {
            "version": _version(),
            "options": options,
            "data": prepared.trajectories.digest(),
            "n_samples": int(workspace.observations.counts.sum()),
            "n_candidates": len(prepared.columns),
            "knots_per_second": float(workspace.knots_per_second),
        },
        diagnostics,
    )


def _rate_noise(workspace: Workspace, weights: Weights) -> dict[tuple[str, str], float]:
    """(``"velocity"`` or ``"acceleration"``, coordinate) → noise of what was measured."""
    names = workspace.trajectories.coordinates
    noise = weights.noise_std[len(names) :].tolist()
    channels = [(rate.quantity, names[rate.coordinate]) for rate in workspace.rates]
    return dict(zip(channels, noise, strict=True))


def _path(prepared: Prepared, selection: Selection) -> tuple[PathPoint, ...]:
    """Best structure of each size, then the runners-up of the chosen size."""
    chosen = tuple(sorted(selection.structure.members))
    size = len(chosen)
    levels = selection.levels
    here = next((c for c in levels.get(size, []) if c.members == chosen), None)
    if here is None:
        return ()
    ranked = [level[0] for _, level in sorted(levels.items())] + levels[size][1:]
    return tuple(
        PathPoint(
            tuple(prepared.columns[m].text for m in c.members),
            c.cost - here.cost,
            c.criterion(selection.penalty) - here.criterion(selection.penalty),
            c.members == chosen,
        )
        for c in ranked
    )


def _version() -> str:
    try:
        return version("leastaction")
    except PackageNotFoundError:
        return "unknown"
