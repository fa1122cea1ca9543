"""One case: its motions, the noise of real sensors, the discovery, and what is kept of it.

Noise of study "noise" is not white Gaussian noise of one size.  Each kind gets exact positions, shape
(n_times, n_dof), the standard deviation σ of each coordinate's noise and a generator, and returns noisy
positions.  Forces are measured, too: some kinds add noise to them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.signal import lfilter

import leastaction as la
from leastaction import systems
from studies import names, shapes, unlisted
from studies.case import Case, attempt
from studies.faults import FAULTS, Question
from studies.names import COULOMB, friction_candidates

__all__ = ["FORCE_KINDS", "KINDS", "measured", "pose", "solve"]

_COLOUR = 0.8  # correlation from sample to sample
_OUTLIERS, _OUTLIER_SIZE = 0.02, 10.0  # share, and size in standard deviations
_RATIO = 10.0  # of the noises of neighbouring coordinates

Noise = Callable[[np.ndarray, np.ndarray, np.random.Generator], np.ndarray]


def _gaussian(q, sigma, rng):
    return q + sigma * rng.standard_normal(q.shape)


def _quantised(q, sigma, rng):
    """An encoder with step σ and no other noise: the error is σ/√12 where the motion crosses many steps."""
    return sigma * np.round(q / sigma)


def _outliers(q, sigma, rng):
    out = _gaussian(q, sigma, rng)
    hit = rng.random(q.shape) < _OUTLIERS
    return out + hit * _OUTLIER_SIZE * sigma * rng.choice((-1.0, 1.0), q.shape)


def _student(q, sigma, rng):
    """Student's t with three degrees of freedom, whose variance is 3."""
    return q + sigma / np.sqrt(3.0) * rng.standard_t(3, q.shape)


def _unequal(q, sigma, rng):
    """The first coordinate √10 times noisier, the next one √10 times less, and so on."""
    factor = np.sqrt(_RATIO) ** np.where(np.arange(q.shape[1]) % 2, -1.0, 1.0)
    return q + factor * sigma * rng.standard_normal(q.shape)


def _coloured(q, sigma, rng):
    """First-order autoregressive noise with the variance of the white one."""
    white = rng.standard_normal((200 + len(q), q.shape[1]))
    noise = lfilter([np.sqrt(1.0 - _COLOUR**2)], [1.0, -_COLOUR], white, axis=0)
    return q + sigma * noise[200:]


KINDS: dict[str, Noise] = {
    "gaussian": _gaussian,
    "quantised": _quantised,
    "outliers": _outliers,
    "student3": _student,
    "unequal": _unequal,
    "coloured": _coloured,
}

# White noise of the given forces beside that of the positions, relative to the rms of the forces.
FORCE_KINDS = {"forces 10 %": 0.1, "forces 30 %": 0.3, "forces 100 %": 1.0}


def measured(kind: str, truth: Sequence[systems.TrueMotion], sigma, coordinates, seed: int):
    """Return recordings of exact motions with noise of a kind, and the rms noise of each coordinate."""
    rngs = [np.random.default_rng(s) for s in np.random.SeedSequence((seed, 77)).spawn(len(truth))]
    noise = _gaussian if kind in FORCE_KINDS else KINDS[kind]
    noisy = [noise(m.q, sigma, rng) for m, rng in zip(truth, rngs, strict=True)]
    error = np.concatenate([q - m.q for q, m in zip(noisy, truth, strict=True)])
    recordings = [
        la.Trajectory(m.t, q, m.forces, coordinates, name=f"{k}")
        for k, (m, q) in enumerate(zip(truth, noisy, strict=True))
    ]
    data = la.Trajectories(recordings)
    if kind in FORCE_KINDS:
        size = FORCE_KINDS[kind] * np.sqrt(np.mean(np.concatenate([m.forces for m in truth]) ** 2, axis=0))
        pairs = zip(truth, rngs, strict=True)
        data = data.with_forces([m.forces + size * rng.standard_normal(m.q.shape) for m, rng in pairs])
    return data, np.sqrt(np.mean(error**2, axis=0))


# ------------------------------------------------- one case from the motions to what is kept of the discovery
# Studies whose tables set the error beside the Cramér–Rao bound, which takes about as long as a discovery.
_WITH_BOUND = ("structure", "single", "further")


def pose(case: Case) -> tuple[Question, np.ndarray]:
    """Return what a user would pass to discover(), and the noise of each coordinate."""
    usual, system = systems.get(case.system), _moving(case.setup, case.system)
    fault = FAULTS.get(case.setup)
    truth = systems.simulate_truth(system, case.trajectories, case.duration, case.rate, case.seed)
    sigma = systems.noise_std(system, truth, case.noise)
    if case.study == "noise":
        data, sigma = measured(case.setup, truth, sigma, system.coordinates, case.seed)
    else:
        data = systems.measure(system, truth, sigma, case.seed)
    # friction that is a fault is not among the candidates; that of a further system is
    library = systems.large_library(usual) if case.library == "large" else systems.compact_library(usual)
    if usual.dissipation:
        library = library.with_dissipation(friction_candidates(system))
    known = dict(system.known)
    if fault is None:
        return Question(system, truth, data, library, known), sigma
    known |= {text: system.lagrangian[text] for text in fault.given.get(case.system, ())}
    return fault.ask(Question(system, truth, data, library, known)), sigma


@lru_cache(maxsize=8)
def _moving(setup: str, name: str) -> systems.MechanicalSystem:
    """The system that really moves; its equations are derived once."""
    fault = FAULTS.get(setup)
    return systems.get(name) if fault is None else fault.nature(systems.get(name))


def solve(case: Case) -> dict:
    """Return everything that is kept of one discovery; an error of the user's kind is an answer too."""
    if case.study == "unlisted":
        return unlisted.solve(case)
    if case.study == "shapes":
        return shapes.solve(case)
    if case.study == "names":
        return names.solve(case)
    question, sigma = pose(case)
    model, kept = attempt(question.data, question.library, question.known)
    if model is None:
        return kept | {"exact": False}
    said = {
        "chi2_per_sample": model.fit.chi2_per_sample,
        "noise_ratio": np.divide(model.noise_std, sigma) if np.all(sigma > 0) else None,
        "knots_per_second": model.provenance.get("knots_per_second"),
    }
    return kept | said | score(case, question, model)


class _Places:
    """Place of a term in a library, however it is written; terms outside keep their text."""

    def __init__(self, library: la.Library) -> None:
        self._library = library

    def of(self, text: str, kind: str) -> str:
        if kind == "dissipation":  # |v| is smoothed by discover(), near zero velocity only
            return "ψ " + COULOMB.sub(r"abs(\1)", text).replace(" ", "")
        try:
            return self._library[self._library.index(text)].text
        except la.InputError:
            return text.replace(" ", "")


def _truth(question: Question, places: _Places) -> dict[str, float]:
    """Place → true coefficient: of the terms as the library writes them, or as the textbook does."""
    system = question.system
    try:
        found = systems.truth_for(system, question.library)
        true = {question.library[k].text: value for k, value in found.items()}
    except la.InputError:
        true = {places.of(text, "lagrangian"): value for text, value in system.lagrangian.items()}
    if question.library.dissipation:
        true |= {places.of(text, "dissipation"): value for text, value in system.dissipation.items()}
    return true


def score(case: Case, question: Question, model: la.LagrangianModel) -> dict:
    """Compare with the truth; known coefficients are left out of every score."""
    places = _Places(question.library)
    true = _truth(question, places)
    known = {places.of(text, "lagrangian") for text in question.known}
    free = {place: value for place, value in true.items() if place not in known}
    terms = [*((t, "lagrangian") for t in model.terms), *((t, "dissipation") for t in model.dissipation)]
    found = {places.of(t.expression, kind): t for t, kind in terms if not t.known}
    estimates = {place: t.coefficient for place, t in found.items()}
    out = {
        "exact": set(found) == set(free),
        "precision": la.metrics.precision(estimates, free),
        "recall": la.metrics.recall(estimates, free),
        "l2": la.metrics.l2_error(estimates, free),
        "spurious": {p: _term(found[p], 0.0) for p in found if p not in free},
        "missed": {p: v for p, v in free.items() if p not in found},
        "terms": {p: _term(found[p], v) for p, v in free.items() if p in found},
        "known": dict(question.known),
    }
    out["covered"] = sum(term["covered"] for term in out["terms"].values())
    if case.study in _WITH_BOUND and case.noise > 0:
        out["crb"] = case.noise * _bound(replace(case, noise=1.0))
        out["l2_over_crb"] = out["l2"] / out["crb"]
    return out


def _term(term, true: float) -> dict:
    error = term.standard_error
    return {
        "true": true,
        "estimate": term.coefficient,
        "standard_error": error,
        "z": (term.coefficient - true) / error if error > 0 else None,
        "covered": bool(term.lower <= true <= term.upper),
    }


@lru_cache(maxsize=256)
def _bound(case: Case) -> float:
    """√trace(F⁻¹)/‖Λ‖ at noise level 1 of the truth as this library writes it; it is linear in the level."""
    system = systems.get(case.system)
    library = systems.large_library(system) if case.library == "large" else systems.compact_library(system)
    true = {library[k].text: float(v) for k, v in systems.truth_for(system, library).items()}
    known = {library[library.index(text)].text: float(value) for text, value in system.known.items()}
    truth = systems.simulate_truth(system, case.trajectories, case.duration, case.rate, case.seed)
    written = replace(system, lagrangian=true, known=known)
    return la.metrics.cramer_rao_bound(written, truth, systems.noise_std(system, truth, 1.0)).relative
