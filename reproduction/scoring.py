"""The only place where a score is computed: coefficients, accelerations and forecasts against the truth.

Coefficients: ‖Λ̂ − Λ‖/‖Λ‖, precision and recall over the terms of the library, the known ones left out.
Accelerations: relative rms error along test motions that no method has seen.
Forecasts: how long a free run from an exact initial state stays near those motions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.integrate import DOP853

import leastaction as la
from leastaction import systems
from reproduction.problem import DURATION, RATE, Answer, Problem

__all__ = ["fresh_motions", "score"]

N_TEST_MOTIONS = 2
TEST_SEED = 9000  # plus the trial; far from the seeds of the data
TOLERANCE = 0.1  # of each coordinate's standard deviation, where a forecast ends
NEAR_BEST = 1.05  # times the smallest error: counts as reached
_ACCURACY = 1e-9  # of the integrator, relative and absolute
_MAX_CALLS = 60_000  # of the acceleration in one free run; the true models need 3 000 to 11 000


def score(problem: Problem, answer: Answer) -> dict:
    """Return every score of an answer; None stands for what does not apply.

    Parameters
    ----------
    problem : Problem
    answer : Answer

    Returns
    -------
    dict
        ``l2``, ``precision``, ``recall``, ``exact``; ``crb``, ``l2_over_crb`` (Cramér–Rao bound of the
        true terms of this library; None without noise); ``covered`` of ``intervals`` 95 % intervals hold
        the true value; ``best_l2``, ``seconds_at_best``, ``seconds_to_best`` (first within 5 % of the best)
        and ``course`` ([seconds, ℓ2] each time that ℓ2 had fallen by another 5 %) of the history;
        ``equation_error``, ``undefined`` (share of the test points without a finite prediction),
        ``forecast_horizon`` in seconds.

    Raises
    ------
    ValueError
        If a coefficient is not a finite number: such an answer is a failure, not a poor score.
    """
    terms = _Terms(problem)
    return {
        **_coefficients(problem, answer, terms),
        **_history(answer, terms),
        **_motions(problem, answer),
    }


class _Terms:
    """Places of terms in a library, however they are written, and their true values."""

    def __init__(self, problem: Problem) -> None:
        self._library = problem.library
        self._places: dict[str, int | str] = {}
        self._known = {self._place(text) for text in problem.known}
        self.true = self.values(problem.true_coefficients)

    def _place(self, text: str) -> int | str:
        if text not in self._places:
            try:
                self._places[text] = self._library.index(text)
            except la.InputError:
                self._places[text] = text  # outside the library: a wrong term like any other
        return self._places[text]

    def values(self, coefficients: Mapping[str, float]) -> dict[int | str, float]:
        """Return place → value of the terms that are there and not known."""
        out: dict[int | str, float] = {}
        for text, value in coefficients.items():
            place = self._place(text)
            if place not in self._known and value != 0.0:
                out[place] = out.get(place, 0.0) + float(value)
        return out


def _coefficients(problem: Problem, answer: Answer, terms: _Terms) -> dict:
    names = ("l2", "precision", "recall", "exact", "crb", "l2_over_crb", "covered", "intervals")
    scores = dict.fromkeys(names)
    if answer.coefficients is None:
        return scores
    found = terms.values(answer.coefficients)
    if not np.isfinite(list(found.values())).all():
        raise ValueError("the method returned coefficients that are not finite")
    scores["l2"] = la.metrics.l2_error(found, terms.true)
    scores["precision"] = la.metrics.precision(found, terms.true)
    scores["recall"] = la.metrics.recall(found, terms.true)
    scores["exact"] = la.metrics.exact_support(found, terms.true)
    if problem.case.noise > 0:
        scores["crb"] = _bound(problem)
        scores["l2_over_crb"] = scores["l2"] / scores["crb"]
    if answer.errors is not None:
        errors = terms.values(answer.errors)
        inside = [
            abs(found[k] - v) <= 1.96 * errors[k] for k, v in terms.true.items() if k in found and k in errors
        ]
        scores |= {"covered": int(sum(inside)), "intervals": len(inside)}
    return scores


def _bound(problem: Problem) -> float:
    """√trace(F⁻¹)/‖Λ‖ of the truth as this library writes it, which may take more terms than the textbook."""
    system = replace(problem.system, lagrangian=dict(problem.true_coefficients), known=dict(problem.known))
    bound = la.metrics.cramer_rao_bound(system, problem.truth, problem.noise_std, observed=problem.data)
    return bound.relative


def _history(answer: Answer, terms: _Terms) -> dict:
    course: list[tuple[float, float]] = []
    for moment, coefficients in answer.history:
        values = terms.values(coefficients)
        if np.isfinite(list(values.values())).all():
            course.append((float(moment), la.metrics.l2_error(values, terms.true)))
    if not course:
        return {"best_l2": None, "seconds_at_best": None, "seconds_to_best": None, "course": None}
    at_best, best = min(course, key=lambda step: step[1])
    falls = course[:1]
    for seconds, error in course:
        if error * NEAR_BEST <= falls[-1][1]:
            falls.append((seconds, error))
    return {
        "best_l2": best,
        "seconds_at_best": at_best,
        "seconds_to_best": next(seconds for seconds, error in course if error <= NEAR_BEST * best),
        "course": falls,
    }


def fresh_motions(problem: Problem) -> tuple[systems.TrueMotion, ...]:
    """Return motions of the system that are in nobody's data: other starts, other forcing."""
    seed = TEST_SEED + problem.case.trial
    return systems.simulate_truth(problem.system, N_TEST_MOTIONS, DURATION, RATE, seed)


def _motions(problem: Problem, answer: Answer) -> dict:
    names = ("equation_error", "undefined", "forecast_horizon", "acceleration_failure")
    scores = dict.fromkeys(names)
    if answer.acceleration is None:
        return scores
    motions = fresh_motions(problem)
    tolerance = systems.noise_std(problem.system, motions, TOLERANCE)  # angles wrapped, as for the noise
    try:
        with np.errstate(all="ignore"):
            scores["equation_error"], scores["undefined"] = _equation_error(answer.acceleration, motions)
            horizons = [_horizon(answer.acceleration, motion, tolerance) for motion in motions]
        scores["forecast_horizon"] = float(np.mean(horizons))
    except Exception as error:  # somebody else's model may fail in any way; its coefficients still count
        scores["acceleration_failure"] = f"{type(error).__name__}: {error}"
    return scores


def _equation_error(acceleration, motions) -> tuple[float, float]:
    """Relative rms error of q̈, each coordinate in units of its own rms, and the share left undefined.

    Where the prediction is not finite it counts as zero, which is an error of the size of the truth.
    """
    q, qdot, true = (np.concatenate([getattr(m, k) for m in motions]) for k in ("q", "qdot", "qddot"))
    forces = None if motions[0].forces is None else np.concatenate([m.forces for m in motions])
    predicted = np.array(acceleration(q, qdot, forces), dtype=float).reshape(true.shape)
    lost = ~np.isfinite(predicted).all(axis=1)
    predicted[lost] = 0.0
    relative = np.mean((predicted - true) ** 2, axis=0) / np.mean(true**2, axis=0)
    return float(np.sqrt(relative.mean())), float(lost.mean())


class _TooLong(Exception):
    """A free run has used up its calls."""


def _horizon(acceleration, motion: systems.TrueMotion, tolerance: np.ndarray) -> float:
    """Seconds until a free run from the exact start is off by more than the tolerance."""
    path = _free_run(acceleration, motion, tolerance)
    return la.metrics.forecast_horizon(motion.t, path, motion.q, tolerance)


def _free_run(acceleration, motion: systems.TrueMotion, tolerance: np.ndarray) -> np.ndarray:
    """Integrate until the end, the first time off the truth, a blow-up or the limit of calls."""
    n = motion.q.shape[1]
    calls = 0

    def rates(time: float, state: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += 1
        if calls > _MAX_CALLS:
            raise _TooLong
        forces = None if motion.drive is None else np.reshape(motion.drive(time), (1, n))
        qddot = acceleration(state[None, :n], state[None, n:], forces)
        return np.concatenate([state[n:], np.reshape(qddot, n)])

    path = [motion.q[:1]]
    start = np.concatenate([motion.q[0], motion.qdot[0]])
    try:
        if not np.isfinite(rates(motion.t[0], start)).all():
            return path[0]  # the solver would look for its first step until the calls are used up
        solver = DOP853(rates, motion.t[0], start, motion.t[-1], rtol=_ACCURACY, atol=_ACCURACY)
        while solver.status == "running":
            solver.step()
            if solver.status == "failed":
                break
            new = (motion.t > solver.t_old) & (motion.t <= solver.t)
            path.append(solver.dense_output()(motion.t[new]).T[:, :n])
            if not (np.abs(path[-1] - motion.q[new]) <= tolerance).all():
                break
    except (_TooLong, ArithmeticError, np.linalg.LinAlgError):
        pass  # it ends here: a model that cannot be integrated on predicts nothing more
    return np.concatenate(path)
