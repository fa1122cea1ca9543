"""discover(): from trajectories and candidates to a model, in one call."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from leastaction.assembly import assemble_model
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.diagnosis.rates import doubts_about_rates
from leastaction.diagnosis.verdict import verify
from leastaction.errors import DataError, InputError
from leastaction.estimation.adam import AdamOptions
from leastaction.estimation.build import ENOUGH_SAMPLES, Request, Setup, build_problem
from leastaction.estimation.crew import employ
from leastaction.estimation.fit import Fit
from leastaction.estimation.grid import Grid
from leastaction.estimation.groups import Grouping
from leastaction.estimation.intervals import first_points
from leastaction.estimation.profile import profiled
from leastaction.findings import doubtful, find
from leastaction.library import Library
from leastaction.model.gravity import checked_lengths
from leastaction.model.model import LagrangianModel
from leastaction.selection.alternatives import find_alternatives
from leastaction.selection.descent import run_descent
from leastaction.selection.groups import search_groups
from leastaction.selection.progress import Clock, Progress
from leastaction.selection.search import run_search
from leastaction.selection.search_state import Search, begin_search
from leastaction.threads import single_threaded

__all__ = ["discover"]

_LARGEST = 1e120  # of a column: weighted products of two columns, summed over the data, remain finite
_DEGREES = {"gauss-newton": 5, "adam": 3}  # of the splines, by method


@single_threaded()
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
    hidden: Iterable[str] = (),
    measure: Iterable[str] = (),
    robust: bool = True,
    degree: int | None = None,
    relevance: float = 0.05,
    seed: int = 0,
    shapes: Mapping[str, tuple[float, float]] | None = None,
    groups: Mapping[str, object] | Iterable[object] | None = None,
    lengths: Mapping[str, float] | None = None,
    options: AdamOptions | Mapping[str, object] | None = None,
    progress: Progress | None = None,
    workers: int | Any = None,
) -> LagrangianModel:
    r"""Find a sparse Lagrangian, and friction, from measured coordinates.

    Solves for L = Σ λ_k φ_k and ψ = Σ c_k ψ_k in

    .. math:: \frac{d}{dt}\frac{\partial L}{\partial \dot q_i} - \frac{\partial L}{\partial q_i}
              + \frac{\partial \psi}{\partial \dot q_i} = f_i

    by maximum likelihood for the curve q(t) and the coefficients jointly (Zhang & Sun 2026, solved as a
    banded nonlinear least-squares problem). A search on the weak form and the extended BIC select the terms.

    Parameters
    ----------
    trajectories : Trajectory, Trajectories or iterable of Trajectory
        Times in seconds, coordinates (NaN = missing) and known generalised forces. Measured velocities and
        accelerations, if any, are fitted too; the noise of each is estimated.
    library : Library or iterable of str
        Candidates of L.
    known : mapping of str to float, optional
        Known coefficients. A system without known forces needs at least one, which sets the scale of L.
    dissipation : iterable of str
        Candidates ψ of the dissipation function; force −∂ψ/∂q̇. ``abs(x_dot)`` (Coulomb friction) is
        smoothed near zero velocity. ``"auto"`` offers viscous and dry friction of every coordinate, and
        between neighbouring angles and lengths. Other families: ``"viscous"``, ``"dry"``, ``"stribeck"``,
        ``"quadratic"``, ``"load"``, ``"asymmetric"``; see `Library`.
    method : {"gauss-newton", "adam"}
        ``"adam"`` is the paper's own method, gradient descent with thresholding, for comparison. It is slower
        and less accurate, its thresholds depend on units, and it gives no standard errors (NaN).
    angles : iterable of str, optional
        Coordinates from which jumps of 2π are removed; default: those of the library.
    force_offset : iterable of str, or mapping of str to float, optional
        Coordinates on which an additional force of unknown size may act, such as the bias of an actuator or
        of its sensor. By name, the force is constant: the coordinate itself becomes a candidate of L, and its
        coefficient is the force. A mapping gives the time in seconds within which the force may change
        (infinite: constant). It is then estimated in each trajectory as a cubic spline with this knot spacing
        (``diagnostics.force_offset``). Choose a time longer than a few periods of the motion.
    prescribed : iterable of str
        Coordinates that are measured but moved by unknown forces: a trolley under its drive, a shaken
        support, a joint without a torque sensor. Their own equations are not used, so terms that occur only
        there (the trolley's mass) are not found. In the model, the force on such a coordinate is its
        acceleration.
    hidden : iterable of str
        Coordinates without a sensor. Their names occur in the candidates, and the data have no samples of
        them. Their motion is estimated together with the coefficients (``diagnostics.hidden_motion``). Offer
        few candidates, and fix by a known coefficient what the choice of such a coordinate leaves open (the
        finding ``hidden-gauge`` reports it). See :doc:`/hidden`.
    measure : iterable of str
        Columns that are functions of the coordinates, such as ``"u = {s}*(x + {l}*sin(theta)) + {u0}"``: a
        column, and an expression in coordinates, velocities ``x_dot``, accelerations ``x_ddot``, and
        calibration numbers in braces. These are estimated (``model.calibration``). ``{s=800}`` gives a start
        value, `shapes` a range. Such a column is not a coordinate; coordinates without a column of their own
        are those of the library, or `hidden`. See :doc:`/measure`.
    robust : bool
        Leave out isolated samples more than five standard deviations off a smooth motion (glitches of a
        camera, lost counts); a note says how many. Heavy-tailed noise, with more than 5 % of the samples out
        there, is kept. ``method="adam"`` keeps every sample.
    degree : int
        Degree of the splines, at least 3; by default 5, and 3 for ``method="adam"`` as in the paper.
    relevance : float
        Share of the equation error's variance that a term must remove in order to stay. It matters on real
        hardware only, where the library is never exact and every candidate becomes significant with enough
        data. With 0, significance alone decides.
    seed : int
        Seed of the simulated noise in the search, or of the collocation times of ``method="adam"``.
    shapes : mapping of str to (float, float), optional
        Ranges of shape parameters: unknown numbers inside candidates, named in braces, as in
        ``exp(-{a}*x)`` or ``sqrt((x-{p})**2+(y-{r})**2)``. A parameter stays within its range. Without one,
        the data suggest where to search. Several terms may share a parameter.
    groups : iterable, or mapping of str, optional
        The group of each trajectory, in order or by the trajectories' names: recordings with and without a
        payload, at several temperatures, with other springs. The discovery finds which coefficients differ
        between groups, and by how much (``model.groups``); all others are shared. ``model`` has the
        coefficients of the group that is named first, ``model.of_group(name)`` those of another. Groups
        exclude a trade-off curve, slow forces, shape parameters and ``method="adam"``.
    lengths : mapping of str to float, optional
        Metres of links, by coordinate: from joint to joint, or of a simple pendulum. A wrong time base or
        unit of length then shows: gravity is not that of the Earth (the finding ``gravity-off``).
    options : AdamOptions or mapping, optional
        Settings of ``method="adam"``. The default method has none.
    progress : callable, optional
        Called as ``progress(stage, details)`` with plain numbers in ``details``. If a stage has an
        intermediate law, they include its ``"coefficients"`` (term → value) and the number of free
        ``"terms"``. Raise `leastaction.StopSearch` to end a long search; the best law so far is then
        returned, with the finding ``stopped-early``.
    workers : int or distributed.Client, optional
        Number of additional processes, or a client of a Dask cluster. By default, everything runs in this
        thread. Processes share the trials of recordings with more than 100,000 measured values, and need no
        ``if __name__ == "__main__":``. A cluster also shares shorter ones. The result is the same, even if a
        worker is lost.

    Returns
    -------
    LagrangianModel
        With ``fit.status`` "ok", "usable" or "doubtful". A numerical failure never raises.

    Raises
    ------
    InputError
        Wrong arguments (a ValueError).
    DataError
        The data cannot support any model (a ValueError).

    Notes
    -----
    Not guaranteed: that the truth is in the library, and that the data distinguish two structures. Intervals
    assume white Gaussian noise and a white equation error. For machines whose equations hold only to a few
    per cent, intervals for misspecified models may replace them (a note says so).

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
    settings = _checked(method, options, relevance)
    descent = method == "adam"
    clock = Clock(progress)
    clock.start("prepare")
    trajectories = Trajectories.coerce(trajectories)
    grouping = None if groups is None else Grouping.of(groups, trajectories)
    prescribed, hidden, measure = _texts(prescribed), _texts(hidden), _texts(measure)
    constant, slow = _offsets(force_offset, trajectories.coordinates, prescribed)
    _refuse_together(slow, grouping, descent, hidden, measure)
    request = Request(
        library,
        known or {},
        _texts(dissipation),
        None if angles is None else _texts(angles),
        _DEGREES[method] if degree is None else degree,
        constant,
        prescribed,
        robust=robust and not descent,
        shapes=dict(shapes or {}),
        hidden=hidden,
        measure=measure,
        lengths=checked_lengths(lengths or {}, (*trajectories.coordinates, *hidden)),
    )
    with employ(workers) as crew:
        setup = _set_up(trajectories, request, descent, bool(slow)).computed_by(crew)
        search = begin_search(
            setup,
            slow,
            relevance=relevance,
            seed=seed,
            thorough=not doubtful(setup.findings),  # where data are at fault, a longer search does not help
            report=clock.report,
        )
        _check_columns(setup, search.grid)
        search = _search(setup, search, grouping, settings if descent else None)
        given = _given(method, request, setup, search, settings if descent else None, grouping)
        return _concluded(setup, search, given, clock)


def _search(setup: Setup, search: Search, grouping: Grouping | None, descent: AdamOptions | None) -> Search:
    """Find a structure by the method that was asked for."""
    if grouping is not None:
        search = search_groups(setup, search, grouping)
    else:
        search = run_search(search) if descent is None else run_descent(search, descent)
    _refuse_nothing(search.found)
    return search


def _concluded(setup: Setup, search: Search, given: dict[str, Any], clock: Clock) -> LagrangianModel:
    """The model of a search that has ended, with its verdict."""
    clock.start("verify")
    search = search if search.stopped else search.now(profiled(search.found))
    alternatives, curvature = (), None
    if search.found.converged and given["method"] != "adam" and not search.stopped:
        alternatives, curvature = find_alternatives(search.found, search.relevance)
    verdict = verify(search, alternatives, curvature)
    clock.stop()
    shown = () if "groups" in given else alternatives
    return assemble_model(setup, search, verdict, shown, given, clock.timings)


def _set_up(trajectories: Trajectories, request: Request, descent: bool, slow: bool) -> Setup:
    """The problem, and what is to be said of it and its data before any search.

    Descent takes positions alone.  Pieces of long recordings are not enough for it, for a slow force, which
    is wanted at all times, and for coordinates without a column.
    """
    read = trajectories.findings
    unused = trajectories.rates if descent else ()
    if descent:
        trajectories = trajectories.without_rates()
    whole = bool(descent or slow or request.hidden or request.measure)
    setup = build_problem(trajectories, request, None if whole else ENOUGH_SAMPLES)
    findings = doubts_about_rates(setup.searched.trajectories, setup.scales.smooth)
    if unused:
        findings.append(find("rates-unused"))
    return replace(setup, findings=(*read, *setup.findings, *findings))


def _refuse_together(
    slow: Mapping[int, float],
    grouping: Grouping | None,
    descent: bool,
    hidden: Sequence[str],
    measure: Sequence[str],
) -> None:
    """Refuse arguments that no method takes together."""
    others = {
        "method 'adam'": descent,
        "groups": grouping is not None,
        "a force_offset that changes": bool(slow),
    }
    given = [what for what, there in others.items() if there]
    if hidden and given:
        raise InputError(f"hidden coordinates cannot be estimated with {given[0]}; leave one of the two out")
    if measure and given:
        raise InputError(f"measurement functions do not go with {given[0]}; leave one of the two out")
    if grouping is not None and len(given) > 1:
        what = next(other for other in given if other != "groups")
        raise InputError(f"groups cannot be compared with {what}; leave one of the two out")
    if descent and slow:
        raise InputError(
            "method 'adam' takes forces as they are: a force_offset that changes needs the default"
        )


def _refuse_nothing(fit: Fit) -> None:
    if fit.status == "not finite":
        raise DataError(
            "no combination of these candidates can be followed along the data: the library may "
            "lack a kinetic term of a coordinate, a known value be far off, or a candidate such as log or "
            "1/x may be undefined there; begin with Library.mechanical or --library auto"
        )


def _given(
    method: str,
    request: Request,
    setup: Setup,
    search: Search,
    descent: AdamOptions | None,
    grouping: Grouping | None,
) -> dict[str, Any]:
    """What the user asked for, as the model's provenance keeps it."""
    angles = setup.library.angles if request.angles is None else request.angles
    return {
        "method": method,
        "degree": request.degree,
        "relevance": float(search.relevance),
        "seed": int(search.seed),
        "known": {str(k): float(v) for k, v in request.known.items()},
        "dissipation": [t.text for t in setup.library.dissipation],
        "angles": list(angles),
        "robust": request.robust,
        "force_offset": {**dict.fromkeys(request.force_offset), **search.bias.seconds_of},
        "prescribed": [setup.problem.coordinates[i] for i in setup.problem.prescribed],
        **(
            {"hidden": [setup.problem.coordinates[i] for i in setup.problem.hidden]}
            if setup.problem.hidden
            else {}
        ),
        **({"measure": list(request.measure)} if setup.problem.sensors else {}),
        "shapes": {name: list(map(float, ends)) for name, ends in request.shapes.items()},
        **({"lengths": dict(request.lengths)} if request.lengths else {}),
        **({} if descent is None else {"adam": asdict(descent)}),
        **({} if grouping is None else {"groups": [grouping.names[place] for place in grouping.places]}),
    }


def _checked(method: str, options, relevance: float) -> AdamOptions:
    """The settings of adam, after checking what has no other owner."""
    if method not in _DEGREES:
        raise InputError(f"method {method!r} is unknown; choose one of {', '.join(map(repr, _DEGREES))}")
    if options is not None and method != "adam":
        raise InputError(f"method {method!r} has no options; options are for method='adam'")
    if not 0.0 <= relevance < 1.0:
        raise InputError(f"relevance is {relevance!r}; expected a share between 0 and 1, such as 0.05")
    return AdamOptions.of(options)


def _texts(given: Iterable[str]) -> list[str]:
    return [given] if isinstance(given, str) else list(given)


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


def _check_columns(setup: Setup, grid: Grid) -> None:
    """Refuse candidates that are undefined along the data, or whose squares overflow, by name."""
    along = first_points(grid.spline, setup.scales.smooth.control_points)
    values = setup.problem.candidates.strong(along)
    bad = [t.text for t, v in zip(setup.problem.terms, values, strict=True) if not np.isfinite(v).all()]
    if bad:
        raise DataError(
            f"the candidate {bad[0]} is undefined somewhere along the data (log, sqrt or division outside "
            "its domain); leave it out or shift the coordinate"
        )
    scale = np.where(setup.problem.is_known, np.abs(setup.problem.known), 1.0)
    sizes = scale * np.abs(values).max(axis=(1, 2))
    if sizes.max() > _LARGEST:
        worst = int(np.argmax(sizes))
        raise DataError(
            f"the candidate {setup.problem.terms[worst].text} reaches {sizes[worst]:.1g} along the data, and "
            "its square overflows; leave it out or use another unit"
        )
