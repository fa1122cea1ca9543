"""Checks of a result that need no reference solution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from leastaction.diagnosis.competing import rival_warnings
from leastaction.diagnosis.differing_trials import differences, differing_trials
from leastaction.diagnosis.effects import Effects, signs_of_imitation
from leastaction.diagnosis.families import lacking_family, named_family, simpler_form
from leastaction.diagnosis.forces import exchanged_forces, scaled_forces
from leastaction.diagnosis.friction import feeding_friction, hidden_friction, late_forces, wrong_known
from leastaction.diagnosis.hidden import about_hidden, about_sensors
from leastaction.diagnosis.missing_terms import lacking_terms
from leastaction.diagnosis.mode_scales import free_scales
from leastaction.diagnosis.settings import DIAGNOSIS
from leastaction.diagnosis.shapes import doubts_about_shapes
from leastaction.diagnosis.smooth_changes import doubts_about_the_form
from leastaction.diagnosis.time_dependence import time_dependence
from leastaction.diagnosis.unmeasured_part import unmeasured_part
from leastaction.diagnosis.wider_search import (
    MOST_SAMPLES,
    perhaps_angles,
    perhaps_degrees,
    search_afresh,
    undeclared_angles,
)
from leastaction.estimation.fit import Fit
from leastaction.estimation.groups import GroupedColumns, GroupTerm, laws
from leastaction.estimation.settings import ESTIMATION
from leastaction.findings import Finding, doubtful, find, inexact
from leastaction.library import time_symbol
from leastaction.selection.alternatives import Alternative
from leastaction.selection.forecast_error import followed, left_out
from leastaction.selection.search_state import Search
from leastaction.selection.settings import SELECTION

__all__ = ["Verdict", "verify"]

_NOTHING = 1e-8  # of a standard error
_OPEN = ("competing-structures", "hardly-determined", "scale-open")  # a consequence of undetermined scales


@dataclass(frozen=True, eq=False)
class Verdict:
    """Warnings and notes on a fit."""

    findings: tuple[Finding, ...]
    chi2_per_sample: float
    equation_error: np.ndarray


def verify(
    search: Search,
    alternatives: Sequence[Alternative],
    curvature: np.ndarray | None = None,
    *,
    look_for_causes: bool = True,
) -> Verdict:
    """Run every check on what a search has found: the very numbers that are returned.

    ``curvature``, (n_free, n_free), is that of the cost in the free candidates about the fit, if it is known.
    Without ``look_for_causes`` nothing is tested that is not in the structure: missing terms, friction, wrong
    coefficients and forces.
    """
    fit, smooth, period = search.found, search.curve, search.scales.period
    names = fit.problem.coordinates
    floor = fit.grid.observations.noise_floor
    sensors = fit.problem.sensors
    own, columns = (smooth.noise_std, ()) if sensors is None else (sensors.direct_std, sensors.noise_std)
    noise = np.maximum(own, floor)
    every = np.maximum([*own, *smooth.rate_std, *columns], fit.grid.observations.floors)
    counts = fit.grid.observations.counts
    chi2 = fit.linearisation.squares / np.maximum(counts, 1) / every**2
    share, rms = fit.equation_error()
    size = rms / np.maximum(share, 1e-300)
    share = np.maximum(share, _behind_noise(fit, size, period))
    effects = Effects(fit, size, share)
    samples_per_period = period / fit.problem.trajectories.sampling_interval
    needed = DIAGNOSIS.few_samples
    found: list[Finding] = []
    if not fit.converged:
        found.append(find("not-converged", reason=fit.status, calibrated=sensors is not None))
    excused = (share > SELECTION.holds) & _as_forces_are(fit)
    unexplained = [
        i
        for i in range(len(names))
        if (share[i] > SELECTION.holds and not excused[i]) or chi2[i] > DIAGNOSIS.noise_ratio**2
    ]
    off = any(share[i] > SELECTION.holds for i in unexplained)
    mass, imitation = _mass_matrix(fit), signs_of_imitation(fit)
    # large terms that cancel hide the error of the equations
    suspect = not fit.converged or bool(mass) or any(sign.code == "cancelling-terms" for sign in imitation)
    causes = _likely_causes(search, effects, off, suspect) if look_for_causes else []
    found += [_equation_off(fit, i, share[i], chi2[i], bool(causes)) for i in unexplained]
    found += _unexplained_rates(fit, chi2) + causes
    if (unexplained or excused.any()) and samples_per_period >= needed:
        found += _looks_like_noise(fit, noise)
    if unexplained and not any(cause.code == "trials-differ" for cause in causes):
        found += perhaps_degrees(fit, period, share, causes)
    found += _unexplained_little(names, share, excused, unexplained)
    if samples_per_period < needed:
        found.append(find("slow-sampling", samples_per_period=samples_per_period, needed=needed))
    found += _signal(fit) + _identifiability(effects) + doubts_about_shapes(fit)
    found += rival_warnings(effects, alternatives, search.others) + imitation
    found += _open_scales(fit) + mass
    found += feeding_friction(effects, search.feeding)
    found += _whiteness(fit) + _zero_offsets(fit) + _between_groups(fit) + _perhaps_angles(fit)
    if not search.knots_settled and fit.converged:
        found.append(find("knots-not-settled"))
    found += about_sensors(fit, np.sqrt(chi2))
    found += about_hidden(search) if fit.problem.hidden else []
    to_its_end = look_for_causes and not search.stopped and not fit.problem.hidden
    if to_its_end and (not doubtful(found) or inexact(found)):
        found += _form(search, exact=not doubtful(found))
    if to_its_end and not doubtful(f for f in found if f.code not in _OPEN):
        found += [] if fit.problem.candidates.grouped else free_scales(fit, curvature)
    if not search.stopped and inexact(found):
        found += _forecasts(fit, period)
    return Verdict(tuple(found), float(np.mean(chi2[counts > 0])), rms)


def _equation_off(fit: Fit, i: int, share: float, chi2: float, cause_named: bool) -> Finding:
    """One equation that does not hold, or whose residuals are more than noise."""
    names = fit.problem.coordinates
    return find(
        "equations-off",
        names[i],
        equation_error=share,
        residual_ratio=np.sqrt(chi2),
        cause_named=cause_named,
        may_be_prescribed=len(names) - len(fit.problem.candidates.prescribed) >= 2,
    )


def _likely_causes(search: Search, effects: Effects, off: bool, suspect: bool) -> list[Finding]:
    """What was left out or is wrong, by tests on the fit, or by a new search where the equations are off."""
    if search.stopped:
        return []
    fit, relevance = search.found, search.relevance
    usable = fit.converged and np.isfinite(fit.evidence)
    known = wrong_known(fit) if usable else []
    found: list[Finding] = []
    short = fit.problem.trajectories.n_samples <= MOST_SAMPLES
    # a new search has one law for all trials, and takes every coordinate as measured
    again = short and not fit.problem.candidates.grouped and not fit.problem.hidden
    if off and again and not any(cause.holds for cause in known):
        found = _by_search(search, suspect)
    elif again and suspect:
        found = unmeasured_part(search, suspect)
    if found or not usable:
        return found + [cause.finding for cause in known]
    # Terms imitate each other and wrong coefficients: name the more likely cause of the two.
    lacking = lacking_terms(fit, relevance)
    likelier = max(known, lacking, key=lambda causes: max((cause.gain for cause in causes), default=0.0))
    found += [cause.finding for cause in likelier]
    for check in (hidden_friction, late_forces):
        found += check(effects, relevance)
    # the remainder of another cause may look like wrong forces
    if not found and np.any(effects.left > DIAGNOSIS.worth_knowing):
        found = scaled_forces(fit)
    return found


def _by_search(search: Search, suspect: bool) -> list[Finding]:
    """What a new search finds; causes that need no further term come first."""
    differing = differing_trials(search)
    if differing:  # where a family is imitated, motions of other amplitudes need other coefficients
        return lacking_family(search) or differing
    problem = search.found.problem
    # first those with the name of an angle; without any, whichever it may be comes after the families
    named = perhaps_angles(problem)
    return (
        exchanged_forces(search)
        or search_afresh(search)
        or undeclared_angles(search, named)
        or lacking_family(search)
        or undeclared_angles(search, () if named else problem.coordinates)
        or time_dependence(search)
        or unmeasured_part(search, suspect)
    )


def _form(search: Search, exact: bool) -> list[Finding]:
    """Whether the law is imitated, or its form open.

    On a machine any form explains some of what is left, and leaves accelerations open by as much; of a law
    that is imitated it explains much.
    """
    relevance = search.relevance if exact else max(search.relevance, DIAGNOSIS.part_of_error)
    doubts = doubts_about_the_form(search.found, relevance, exact=exact)
    imitated = [d for d in doubts if d.code == "form-imitated"]
    if not search.found.problem.candidates.grouped:  # a search for a family has one law for all trials
        imitated = [named_family(d, search) for d in imitated]
        imitated = imitated or (simpler_form(search) if exact and not doubts else [])
    return imitated or (doubts if exact else [])


def _forecasts(fit: Fit, period: float) -> list[Finding]:
    """How well equations that hold to some per cent follow the data, and those left out of the fit."""
    runs = followed(fit, period)
    if not runs.error <= DIAGNOSIS.follows:
        return []
    new = left_out(fit, period)
    figures = {} if new is None else {"left_out": new[0], "worst_left_out": new[1]}
    if new is not None and new[0] > DIAGNOSIS.follows:
        return [find("forecasts-fail", **runs._asdict(), **figures)]
    return [find("forecasts", **runs._asdict(), **figures)]


def _behind_noise(fit: Fit, size: np.ndarray, period: float) -> np.ndarray:
    """Equation error that the fitted curve does not show, relative to the terms of each equation.

    Within the noise a curve bends to wrong equations.  The weights know better: 1/w_i is the spectral density
    of the error, which in a band about the motion amounts to this.  Not with dry friction: no spline follows
    its kinks, and what it misses there counts as equation error, too.
    """
    friction = [t for t in map(fit.problem.terms.__getitem__, fit.structure) if t.kind == "dissipation"]
    if any(power.exp == sp.Rational(1, 2) for t in friction for power in t.expr.atoms(sp.Pow)):
        return np.zeros(size.size)
    weights = fit.weights
    rms = np.sqrt(2.0 * DIAGNOSIS.band / period / weights.physics)
    # an equation without terms has no scale
    visible = (weights.slack > ESTIMATION.slack_left) & (size > 0.0)
    return np.divide(rms, size, out=np.zeros(size.size), where=visible)


def _as_forces_are(fit: Fit) -> np.ndarray:
    """(n_dof,) whether the equation error is what the scatter of the given forces accounts for.

    1/w_i is the spectral density of the one; what no curve can follow shows that of the other.
    """
    return fit.weights.physics * fit.grid.force_density * DIAGNOSIS.of_forces > 1.0


def _unexplained_little(
    names: Sequence[str], share: np.ndarray, excused: np.ndarray, unexplained: list[int]
) -> list[Finding]:
    """Notes on small equation errors."""
    notes: list[Finding] = []
    for i in range(len(names)):
        if i in unexplained:
            continue
        if excused[i]:
            notes.append(find("scatter-of-forces", names[i], equation_error=share[i]))
        elif share[i] > DIAGNOSIS.worth_knowing:
            notes.append(find("equation-error", names[i], equation_error=share[i]))
    return notes


def _looks_like_noise(fit: Fit, noise: np.ndarray) -> list[Finding]:
    """Motion that is too fast for the sampling rate is taken for noise."""
    spread = np.sqrt(np.mean([np.var(curve, axis=0) for curve in fit.curves()], axis=0))
    noise = np.where(np.isnan(fit.position_std), 0.0, noise)
    return [
        find("looks-like-noise", name, share=part)
        for name, part in zip(fit.problem.trajectories.coordinates, noise / spread, strict=True)
        if part > DIAGNOSIS.much_noise
    ]


def _perhaps_angles(fit: Fit) -> list[Finding]:
    named = perhaps_angles(fit.problem)
    return [find("perhaps-angle", named)] if named else []


def _signal(fit: Fit) -> list[Finding]:
    """Coordinates whose motion barely exceeds the noise: any equations hold along it."""
    spread = np.sqrt(np.mean([np.var(curve, axis=0) for curve in fit.curves()], axis=0))
    return [
        find("motion-in-noise", name, motion=size, noise=noise)
        for name, size, noise in zip(
            fit.problem.trajectories.coordinates, spread, fit.position_std, strict=True
        )
        if size < DIAGNOSIS.visible * noise
    ]


def _identifiability(effects: Effects) -> list[Finding]:
    """The combination of coefficients that the data determine least."""
    fit = effects.fit
    covariance = fit.covariance
    if not np.isfinite(covariance).all():
        return []
    # a coefficient far below its standard error is undetermined
    size = np.maximum(np.abs(fit.estimates), np.maximum(_NOTHING * fit.standard_errors, 1e-150))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    relative = fit.standard_errors / size
    texts = [fit.problem.terms[m].offered for m in fit.structure]
    members = [m for m, r in zip(fit.structure, relative, strict=True) if r > DIAGNOSIS.indistinct]
    if not members:
        return []
    loose = [fit.problem.terms[m].offered for m in members]
    if effects.minor(members):
        return [find("slight-terms", loose)]
    # eigenvector of relative changes: the terms that move together
    weakest = vectors[:, -1] / np.abs(vectors[:, -1]).max()
    moving = [k for k in np.argsort(-np.abs(weakest)) if abs(weakest[k]) > DIAGNOSIS.part_of_it]
    together = len(moving) == len(texts) > 1 and np.all(weakest[moving] * weakest[moving[0]] > 0.5)
    signs = ["+" if weakest[k] * weakest[moving[0]] > 0 else "-" for k in moving]
    parts = [f"{s} {texts[k]}" for s, k in zip(signs, moving, strict=True)] if len(moving) > 1 else []
    size_open = np.sqrt(values[-1])
    figures = {"scale_open": bool(together), "combination": parts, "open": size_open}
    return [find("hardly-determined", loose, **figures)]


def _mass_matrix(fit: Fit) -> list[Finding]:
    n = fit.grid.spline.n_intervals
    diagonal = np.sqrt(
        sum(np.abs(np.diagonal(mass, axis1=1, axis2=2)).sum(axis=0) for mass in fit.mass_matrices()) / n
    )
    if not np.isfinite(diagonal).all() or not all(np.isfinite(mass).all() for mass in fit.mass_matrices()):
        return [find("mass-matrix-not-finite")]
    scale = np.where(diagonal > 0, diagonal, 1.0)
    bad = 0.0
    for mass in fit.mass_matrices():
        lowest = np.linalg.eigvalsh(mass / np.outer(scale, scale))[:, 0]
        bad += np.count_nonzero(lowest <= 1e-9) / n
    if bad == 0.0:
        return []
    return [find("mass-matrix-not-positive", share=bad)]


def _open_scales(fit: Fit) -> list[Finding]:
    """Coordinates that the terms found couple to nothing known: their part of L has any scale."""
    names = fit.problem.unreached(fit.structure)
    return [find("scale-open", list(names))] if names else []


def _between_groups(fit: Fit) -> list[Finding]:
    """What differs between groups of trials, and what it is relative to where no force is known."""
    problem, columns = fit.problem, fit.problem.candidates
    if not isinstance(columns, GroupedColumns):
        return []
    differing, figures = differences(fit)
    out = [find("groups-differ", differing, **figures) if differing else find("groups-alike", **figures)]
    known = [
        term.text for term, value in zip(problem.terms, np.nan_to_num(problem.known), strict=True) if value
    ]
    parts = [problem.trajectories.select(trials) for trials, *_ in laws(fit)]
    passive = [name for name, part in zip(columns.names, parts, strict=True) if not part.driven]
    return [*out, find("groups-known", known, groups=passive)] if known and passive else out


def _zero_offsets(fit: Fit) -> list[Finding]:
    """a g cos u + b g sin u with a small b is a g cos(u − b/a): the zero of an angle is off."""
    notes: list[Finding] = []
    present = [*fit.structure, *(int(k) for k in np.flatnonzero(fit.problem.is_known))]
    found = [(fit.problem.terms[k], float(fit.coefficients[k])) for k in present]
    found = [(term, coefficient) for term, coefficient in found if not isinstance(term, GroupTerm)]
    terms = {term.expr: coefficient for term, coefficient in found}
    for term, coefficient in found:
        expression = term.expr
        for cosine in expression.atoms(sp.cos):
            if time_symbol in cosine.free_symbols:  # a phase, not the zero of an angle
                continue
            beside = terms.get(expression.subs(cosine, sp.sin(cosine.args[0])))
            if beside is not None and abs(beside) < DIAGNOSIS.small_offset * abs(coefficient):
                angle, offset = str(cosine.args[0]), beside / coefficient
                notes.append(find("zero-offset", angle, term=term.text, offset=offset))
    return notes


def _unexplained_rates(fit: Fit, chi2: np.ndarray) -> list[Finding]:
    names, rates = fit.problem.trajectories.coordinates, fit.problem.trajectories.rates
    return [
        find(
            "rate-unexplained", names[rate.coordinate], quantity=rate.quantity, residual_ratio=np.sqrt(value)
        )
        for rate, value in zip(rates, chi2[len(names) : len(names) + len(rates)], strict=True)
        if value > DIAGNOSIS.noise_ratio**2
    ]


def _whiteness(fit: Fit) -> list[Finding]:
    notes: list[Finding] = []
    observations, names = fit.grid.observations, fit.problem.trajectories.coordinates
    # an unconstrained curve follows the noise
    loose = [names[i] for i in fit.problem.prescribed]
    channels = [(name, "position") for name in names]
    sensors = fit.problem.sensors
    channels += [(names[rate.coordinate], rate.quantity) for rate in fit.problem.trajectories.rates]
    channels += [(name, "position") for name in (sensors.functions.columns if sensors else ())]
    numbers = fit.residuals(), observations.floors, fit.weights.noise_std
    for (name, quantity), r, least, sigma in zip(channels, *numbers, strict=True):
        if r.size < 3:  # a hidden coordinate leaves no residuals
            continue
        lag = float(r[1:] @ r[:-1] / max(r @ r, 1e-300))
        visible = abs(lag) > DIAGNOSIS.lag_one + 4.0 / np.sqrt(r.size) and sigma > 1.01 * least
        if visible and not (name in loose and quantity == "position"):
            notes.append(find("correlated-residuals", name, quantity=quantity, correlation=lag))
    return notes
