"""Shape parameters in the joint fit, and long recordings that are streamed."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import tracemalloc
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loky.backend.queues import Queue
from scipy.integrate import solve_ivp

import leastaction as la
from helpers import (
    MORE,
    SMALL,
    TERMS,
    VALUES,
    WEIGHTS,
    Cluster,
    assert_same,
    close,
    euler_lagrange,
    free_motions,
    interpolate,
    linearised_alike,
    motion,
    problem,
    record,
    terms,
    uniform_grid,
)
from leastaction import systems
from leastaction.diagnosis.friction import _Late
from leastaction.diagnosis.shapes import doubts_about_shapes
from leastaction.errors import InputError
from leastaction.estimation import profile, recipes, streamed
from leastaction.estimation.blocks import observe
from leastaction.estimation.candidates import score
from leastaction.estimation.crew import DaskCrew, ProcessCrew, employ
from leastaction.estimation.files import Held
from leastaction.estimation.fit import Fit, ShapeEstimate
from leastaction.estimation.forces import WithPushes
from leastaction.estimation.gauss_newton import fit_joint
from leastaction.estimation.grid import Grid
from leastaction.estimation.joint import Physics
from leastaction.estimation.observations import Observations
from leastaction.estimation.problem import Problem, Structure
from leastaction.estimation.protocols import linearise
from leastaction.estimation.shape_ranges import ShapeRange, shape_ranges
from leastaction.estimation.shapes import fit_shapes
from leastaction.estimation.streamed import StreamedObservations
from leastaction.estimation.weights import evidence
from leastaction.library import make_term
from leastaction.mechanics.euler_lagrange import EulerLagrange, Points

# ------------------------ where they are looked for: the part that each plays, and what the user says
COORDINATES = ["x", "y"]


def states(size: float = 1.0, shift: float = 0.0) -> dict[str, np.ndarray]:
    """x between shift ± size, y between ± 3."""
    t = np.linspace(0.0, 40.0, 400)
    return {
        "x": shift + size * np.sin(t),
        "y": 3.0 * np.cos(0.7 * t),
        "x_dot": size * np.cos(t),
        "y_dot": -2.1 * np.sin(0.7 * t),
    }


def range_of(text: str, data=None, given=None) -> ShapeRange:
    found = shape_ranges(terms([text], COORDINATES), data or states(), given or {})
    return next(iter(found.values()))


@pytest.mark.parametrize("size", [0.01, 1.0, 300.0])
@pytest.mark.parametrize("text", ["exp(-{a}*x)", "cos({a}*x)", "x_dot**2*sin({a}*x)"])
def test_a_rate_is_compared_with_one_over_the_coordinate(text, size):
    found = range_of(text, states(size))
    assert found.spacing == "log"
    assert not found.bounded
    assert found.high / found.low == pytest.approx(100.0)
    assert np.sqrt(found.low * found.high) * size == pytest.approx(np.sqrt(2.0), rel=0.3)


@pytest.mark.parametrize("shift", [-40.0, 0.0, 7.0])
@pytest.mark.parametrize(("text", "sign"), [("(x-{p})**3", 1), ("cos(x+{p})", -1), ("1/(1+({p}-x)**2)", 1)])
def test_a_location_is_looked_for_where_the_coordinate_is(text, sign, shift):
    found = range_of(text, states(2.0, shift))
    assert found.spacing == "linear"
    assert not found.bounded
    assert (found.low, found.high) == pytest.approx((sign * shift - 4.0, sign * shift + 4.0), abs=0.05)


def test_the_coordinates_of_a_point_have_a_range_each():
    found = shape_ranges(terms(["sqrt((x-{p})**2+(y-{r})**2)"], COORDINATES), states(1.0, 5.0), {})
    assert (found["p"].low, found["p"].high) == pytest.approx((3.0, 7.0), abs=0.05)
    assert (found["r"].low, found["r"].high) == pytest.approx((-6.0, 6.0), abs=0.05)


@pytest.mark.parametrize("size", [0.02, 1.0, 50.0])
@pytest.mark.parametrize("text", ["sqrt(x**2+{h}**2)", "1/(x**2+{h}**2)"])
def test_a_length_in_squares_is_no_longer_than_the_coordinate(text, size):
    found = range_of(text, states(size))
    assert found.spacing == "log"
    assert found.high == pytest.approx(size, rel=0.15)
    assert 0.0 < found.low < 0.1 * found.high


@pytest.mark.parametrize("text", ["x**{n}", "(x**2+y**2)**(-{n}/2)", "x_dot**2*x**{n}"])
def test_an_exponent_is_an_exponent(text):
    found = range_of(text, states(0.2, 1.0))
    assert found.low < -6.0 < 6.0 <= found.high or found.spacing == "log"
    if text == "x**{n}":
        assert found.spacing == "exponent"
        assert {-6.0, -12.0, -1.0, 3.0} <= {*found.starts(5).tolist()}


def test_a_range_of_the_user_is_a_bound():
    found = range_of("exp(-{a}*x)", given={"a": (0.1, 10)})
    assert (found.low, found.high, found.spacing, found.bounded) == (0.1, 10.0, "log", True)
    assert range_of("exp(-{a}*x)", given={"a": (-1, 1)}).spacing == "linear"
    assert range_of("exp(-{a}*x)", given={"a": (2, 3)}).spacing == "linear"
    assert range_of("x**{n}", given={"n": (-3, 2)}).starts(9).tolist() == [
        -3.0,
        -2.5,
        -2.0,
        -1.5,
        -1.0,
        -0.5,
        0.5,
        1.5,
    ]
    narrow = range_of("x**{n}", given={"n": (1.6, 2.2)})
    assert np.all((narrow.starts(4) > 1.6) & (narrow.starts(4) < 2.2))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"b": (0, 1)}, r"shapes names 'b', which is not a shape parameter of the library \(it has a\)"),
        ({"a": (1, 0)}, "expected \\(low, high\\) with low < high"),
        ({"a": (1, 1)}, "low < high"),
        ({"a": (0, np.inf)}, "low < high"),
        ({"a": (0, np.nan)}, "low < high"),
        ({"a": 3.0}, "low < high"),
        ({"a": (1, 2, 3)}, "low < high"),
        ({"a": ("one", "two")}, "low < high"),
    ],
)
def test_what_is_no_range_is_refused(given, message):
    with pytest.raises(InputError, match=message):
        range_of("exp(-{a}*x)", given=given)


def test_exponents_beyond_what_an_expression_may_have_are_refused():
    with pytest.raises(
        InputError, match="range of the exponent 'n' is -40 to 3; expected exponents of at most ±32"
    ):
        range_of("x**{n}", given={"n": (-40, 3)})
    far = range_of("abs(x)**{n}")
    assert [far.stepped(30.0, 10.0), far.stepped(-30.0, -10.0)] == [32.0, -32.0]


def test_a_library_without_shapes_says_how_to_write_one():
    with pytest.raises(InputError, match=r"it has none; write one as exp\(-\{a\}\*x\)"):
        shape_ranges(terms(["x**2"], COORDINATES), states(), {"a": (0, 1)})
    assert shape_ranges(terms(["x**2"], COORDINATES), states(), {}) == {}


RANGES = [
    ShapeRange(0.1, 10.0, "log"),
    ShapeRange(-2.0, 5.0, "linear"),
    ShapeRange(-12.0, 6.0, "exponent"),
    ShapeRange(0.1, 10.0, "log", bounded=True),
    ShapeRange(-2.0, 5.0, "linear", bounded=True),
]


@pytest.mark.parametrize("where", RANGES, ids=str)
@settings(max_examples=30)
@given(share=st.floats(0.0, 1.0), step=st.floats(-1e6, 1e6))
def test_starts_shares_and_steps(where, share, step):
    starts = where.starts(9)
    assert np.all(np.diff(starts) > 0.0)
    slack = 1e-12 * (where.high - where.low)
    assert where.low - slack <= starts.min() <= starts.max() <= where.high + slack
    value = where.at(share)
    assert where.low - 1e-9 <= value <= where.high + 1e-9
    moved = where.stepped(value, step)
    if where.bounded:
        assert where.low <= moved <= where.high
    if where.spacing == "log":
        assert moved > 0.0  # a positive number stays positive
    if where.spacing == "exponent":
        make_term(f"abs(x)**({moved!r})", ["x"])  # a model can be written and read
    assert abs(moved - value) <= max(abs(value), 0.25 * (where.high - where.low)) + 1e-9
    assert where.stepped(value, 1e-9) == pytest.approx(value, abs=1e-8)


# ----------------------------------- the joint fit on a Morse potential, L = ½ẋ² − D (1 − exp(−a x))²
DEPTH, RATE = 2.0, 0.8
MORSE = ["x_dot**2", "exp(-{a}*x)", "exp(-2*{a}*x)"]
TRUTH = np.array([0.5, 2 * DEPTH, -DEPTH])
FREE = ShapeRange(0.05, 5.0, "log")


@cache
def data(seed: int, noise: float):
    def acceleration(q, v, f):
        return -2.0 * DEPTH * RATE * (np.exp(-RATE * q) - np.exp(-2.0 * RATE * q))

    starts = [([1.6], [0.0]), ([0.5], [1.0])]
    return record(acceleration, starts, ["x"], duration=6.0, rate=30.0, noise=noise, seed=seed)


def plain_fit(at: float, seed: int = 0, noise: float = 0.01, where=FREE, texts=(), coefficients=None) -> Fit:
    """A fit of the coefficients with the rate held."""
    put = [term.at({"a": at, "b": at}) for term in terms(texts or MORSE, ["x"])]
    known = np.full(len(put), np.nan)
    known[0] = 0.5
    trajectories = data(seed, noise)
    grid = Grid.lay(
        Problem(trajectories, EulerLagrange(put, ["x"]), known, 5, ranges={"a": where, "b": FREE}), 5.0
    )
    curves = [lambda t, run=run: np.interp(t, run.t, run.q[:, 0])[:, None] for run in trajectories]
    control = interpolate(grid.spline, curves)
    members = Structure(range(1, len(put)))
    truth = TRUTH if coefficients is None else np.asarray(coefficients)
    return grid.fit(members, grid.start(members, control, truth, np.array([max(noise, 1e-6)])))


def test_the_start_does_not_matter():
    there = fit_shapes(plain_fit(RATE))
    assert there.shapes is not None
    assert there.shapes.settled
    for start in (0.5, 1.15):
        fit = fit_shapes(plain_fit(start))
        assert fit.shapes is not None
        assert fit.shapes.names == ("a",)
        assert fit.shapes.settled
        apart = fit.shapes.values - there.shapes.values
        assert np.abs(apart) <= 0.05 * there.shapes.standard_errors
        np.testing.assert_array_less(np.abs(fit.estimates - there.estimates), 0.05 * there.standard_errors)
        np.testing.assert_allclose(fit.shapes.covariance, there.shapes.covariance, rtol=0.05)
        assert fit.problem.shape_values == {"a": pytest.approx(float(fit.shapes.values[0]))}


def test_a_law_that_is_imitated_settles_too():
    """Where the equation error is large its weight follows the number, and steps that free it turn back."""
    texts, guess = ["x_dot**2", "abs(x)**{a}", "x**2"], [0.5, 0.1, 0.1]
    fits = [fit_shapes(plain_fit(start, texts=texts, coefficients=guess)) for start in (0.5, 2.0)]
    for fit in fits:
        assert fit.shapes is not None
        assert fit.shapes.settled
    assert fits[0].evidence == pytest.approx(fits[1].evidence, abs=0.01)
    apart = fits[0].shapes.values - fits[1].shapes.values
    assert np.abs(apart) <= 0.05 * fits[0].shapes.standard_errors


def test_exact_data_give_exact_numbers():
    fit = fit_shapes(plain_fit(0.7, noise=0.0))
    assert fit.shapes is not None
    assert fit.shapes.values == pytest.approx([RATE], rel=2e-3)
    np.testing.assert_allclose(fit.coefficients, TRUTH, rtol=5e-3)


def test_errors_cover_the_truth():
    """z of two coefficients and the rate over 12 noise seeds: about normal with unit spread."""
    z = []
    for seed in range(12):
        fit = fit_shapes(plain_fit(RATE, seed, 0.02))
        assert fit.shapes is not None
        off = np.concatenate([fit.estimates - TRUTH[1:], fit.shapes.values - RATE])
        z.append(off / np.sqrt(np.diag(fit.shapes.covariance)))
        np.testing.assert_array_equal(fit.covariance, fit.shapes.covariance[:2, :2])
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    assert np.all((rms > 0.5) & (rms < 1.6)), rms
    assert np.abs(np.mean(z, axis=0)).max() < 1.0


def test_free_numbers_widen_the_errors_of_coefficients():
    held = plain_fit(RATE)
    fit = fit_shapes(held)
    assert np.all(fit.standard_errors > held.standard_errors)


def test_a_bounded_number_ends_at_its_bound_and_says_so():
    fit = fit_shapes(plain_fit(1.2, where=ShapeRange(1.0, 2.0, "linear", bounded=True)))
    assert fit.shapes is not None
    assert fit.shapes.values.tolist() == [1.0]
    (finding,) = doubts_about_shapes(fit)
    assert finding.code == "shape-at-bound"
    assert finding.subject == ("a",)
    assert finding.values == {"value": 1.0, "low": 1.0, "high": 2.0}


def test_beside_a_number_at_its_bound_the_others_settle():
    """They end where they would with that number typed."""
    bounded = ShapeRange(0.9, 2.0, "linear", bounded=True)
    fit = fit_shapes(plain_fit(1.0, where=bounded, texts=["x_dot**2", "exp(-{a}*x)", "exp(-2*{b}*x)"]))
    typed = fit_shapes(plain_fit(1.0, texts=["x_dot**2", "exp(-0.9*x)", "exp(-2*{b}*x)"]))
    assert fit.shapes is not None
    assert typed.shapes is not None
    assert fit.shapes.settled
    assert fit.shapes.values[0] == 0.9
    assert fit.shapes.standard_errors[0] == 0.0
    assert abs(fit.shapes.values[1] - typed.shapes.values[0]) <= 0.05 * typed.shapes.standard_errors[0]
    np.testing.assert_allclose(fit.shapes.standard_errors[1], typed.shapes.standard_errors[0], rtol=0.05)
    assert [(d.code, d.subject) for d in doubts_about_shapes(fit)] == [("shape-at-bound", ("a",))]


def test_a_number_that_is_found_raises_no_doubt():
    assert doubts_about_shapes(fit_shapes(plain_fit(RATE))) == []
    assert doubts_about_shapes(plain_fit(RATE)) == []


def test_too_few_steps_are_not_settled():
    fit = fit_shapes(plain_fit(0.5), most_steps=1)
    assert fit.shapes is not None
    assert not fit.shapes.settled
    assert [d.code for d in doubts_about_shapes(fit)] == ["shape-not-settled"]


@pytest.mark.parametrize(
    ("error", "together", "codes", "partner"),
    [
        (0.01, 0.0, [], None),
        (2.0, 0.5, ["shape-undetermined"], ""),
        (2.0, 0.999999, ["shape-undetermined"], "exp(-{a}*x)"),
        (np.nan, 0.0, ["shape-undetermined"], ""),
    ],
)
def test_a_number_as_large_as_its_error_is_undetermined(error, together, codes, partner):
    fit = plain_fit(RATE)
    spread = np.array([1.0, 1.0, error])
    mixed = np.eye(3)
    mixed[0, 2] = mixed[2, 0] = together
    estimate = ShapeEstimate(("a",), np.array([RATE]), mixed * np.outer(spread, spread), True)
    found = doubts_about_shapes(replace(fit, shapes=estimate))
    assert [finding.code for finding in found] == codes
    if partner is not None:
        assert found[0].values["with_it"] == partner
        assert partner in found[0].remedy


@pytest.mark.parametrize("settled", [True, False])
def test_a_number_far_from_the_data_is_named_as_such(settled):
    """exp(−a x) of a vanishing a is 1 − a x: only the product of a and its coefficient is known."""
    fit = plain_fit(RATE)
    value = 1e-4 * fit.problem.ranges["a"].low
    fit = replace(fit, grid=fit.grid.posed(fit.problem.at({"a": value})))
    covariance = np.diag([1.0, 1.0, value**2])
    estimate = ShapeEstimate(("a",), np.array([value]), covariance, settled)
    (finding,) = doubts_about_shapes(replace(fit, shapes=estimate))
    assert finding.code == "shape-undetermined"
    assert finding.values["low"] == fit.problem.ranges["a"].low
    assert "powers" in finding.message
    assert "powers" in finding.remedy


def test_nothing_to_fit_gives_the_fit_back():
    put = ["x_dot**2", "exp(-0.8*x)", "exp(-1.6*x)"]
    fit = plain_fit(RATE, texts=put)
    assert fit_shapes(fit) is fit


def test_a_number_at_zero_is_no_error():
    """A step may end at the end of a range: 1/0 is infinite, as it is of an array."""
    term, points = terms(["exp(-((x-{p})/{w})**2)+x**2/{w}"], "x")[0], np.ones((3, 1))
    columns = EulerLagrange([term.at({"p": 0.0, "w": 0.0})], ["x"])
    assert not np.isfinite(columns.strong(Points(points, points, points))).any()


# --------------------------------------------------------------------------------------- profile likelihoods
def _fitted(noise: float, terms: list[str], force, starts) -> Fit:
    """The fit whose profiles a model has."""
    held: list[Fit] = []
    real = profile.profiled
    runs = free_motions(force, starts, noise=noise)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("leastaction.api.profiled", lambda fit: (held.append(real(fit)), held[0])[1])
        model = la.discover(runs, ["x_dot**2", *terms], known={"x_dot**2": 0.5})
    assert [shape.profile for shape in model.shapes] == list(held[0].shapes.profiles)
    return held[0]


def _morse(x: float) -> float:
    return 6.0 * (np.exp(-2.4 * x) - np.exp(-1.2 * x))


@pytest.fixture(scope="module")
def morse() -> Fit:
    return _fitted(0.01, ["exp(-{a}*x)", "exp(-2*{a}*x)"], _morse, (0.5, 0.9, 1.3))


def test_it_is_a_parabola_where_the_data_are_many(morse):
    places, rise = np.array(morse.shapes.profiles[0]).T
    z = (places - morse.shapes.values[0]) / morse.shapes.standard_errors[0]
    assert z[0] < -2.0
    assert z[-1] > 2.0
    np.testing.assert_allclose(rise, z**2, atol=0.1)


def _held(fit: Fit, values: dict[str, float]) -> float:
    """The highest log likelihood with all numbers held, at the weights of a fit."""
    grid = fit.grid.posed(fit.problem.at(values))
    physics, index = grid.physics(fit.structure)
    start = fit.control_points, fit.problem.completed(fit.coefficients)[index]
    return evidence(
        grid.observations, fit_joint(grid.observations, physics, fit.weights, *start, tolerance=1e-4)
    )


@pytest.mark.thorough
def test_it_is_the_loss_of_likelihood_with_the_number_held():
    """The other number is found by trying many, without tangents."""
    terms = ["1/sqrt((x-{p})**2+{h}**2)"]
    fit = _fitted(0.05, terms, lambda x: -0.8 * x / (x * x + 0.09) ** 1.5, (0.25, 0.4))
    h, p = (fit.shapes.names.index(name) for name in "hp")
    near = fit.shapes.values[p] + np.linspace(-1.0, 1.0, 9) * fit.shapes.standard_errors[p]
    best = max(_held(fit, {"h": float(fit.shapes.values[h]), "p": float(x)}) for x in near)
    for place, rise in fit.shapes.profiles[h][:: len(fit.shapes.profiles[h]) - 1]:
        there = max(_held(fit, {"h": place, "p": float(x)}) for x in near)
        assert rise > 4.0
        assert 2.0 * (best - there) == pytest.approx(rise, abs=0.1)


def test_the_other_parameters_follow():
    """Where two numbers nearly make up for each other the profile is far below the cost of moving one."""
    terms = ["exp(-{a}*x)", "exp(-{b}*x)"]
    fit = _fitted(0.01, terms, _morse, (0.5, 0.9, 1.3))
    assert len(fit.shapes.names) == 2
    place, rise = fit.shapes.profiles[0][-1]
    alone = dict(zip(fit.shapes.names, fit.shapes.values.tolist(), strict=True)) | {
        fit.shapes.names[0]: place
    }
    other = fit.grid.posed(fit.problem.at(alone)).fit(fit.structure, fit.start)
    assert 2.0 * (fit.evidence - other.evidence) > 3.0 * rise


def test_nothing_is_profiled_where_errors_come_from_elsewhere(morse):
    bare = replace(morse, shapes=replace(morse.shapes, profiles=()))
    assert profile.profiled(replace(bare, covariance=2.0 * bare.covariance)).shapes.profiles == ()
    unsettled = replace(bare, shapes=replace(bare.shapes, settled=False))
    assert profile.profiled(unsettled).shapes.profiles == ()
    assert len(profile.profiled(bare).shapes.profiles) == 1


# ---------------------------------------------------------------------------------------- streamed recordings
@pytest.fixture(scope="module")
def processes():
    crew = ProcessCrew(2)
    yield crew
    crew.close()


@pytest.fixture(params=["alone", "two processes"])
def crew(request, monkeypatch, processes):
    """Whoever computes; every recording is long, and a block holds one trial or two."""
    monkeypatch.setattr(streamed, "_LONG", 1)
    monkeypatch.setattr(recipes, "_NUMBERS", SMALL)
    return None if request.param == "alone" else processes


def both(crew):
    """The same data in one piece and streamed, the physics, and a curve."""
    grid, data, physics, control = problem()
    parts = observe(grid, *data, crew)
    assert isinstance(parts, StreamedObservations)
    assert 2 <= len(parts.points) <= len(grid.spaces)
    return Observations(grid, *data), parts, physics, control


def test_a_stream_gives_the_sums_of_the_whole(crew):
    whole, parts, physics, control = both(crew)
    for name in ("counts", "coordinates"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    for name in ("floors", "noise_floor"):
        close(getattr(parts, name), getattr(whole, name), 1e-12)
    linearised_alike(whole, parts, physics, control)


@pytest.mark.parametrize("damping", [0.0, 0.01])
@pytest.mark.parametrize("foreseen", [True, False])
def test_a_stream_takes_the_step_of_the_whole(crew, damping, foreseen):
    whole, parts, physics, control = both(crew)
    at = linearise(parts, physics, control, VALUES, WEIGHTS if foreseen else None)
    found = at.normal(WEIGHTS).eliminate(damping)
    expected = linearise(whole, physics, at.control_points, VALUES).normal(WEIGHTS).eliminate(damping)
    for name in ("gradient", "matrix", "held"):
        close(getattr(found, name), getattr(expected, name))
    assert found.factor.logdet == pytest.approx(expected.factor.logdet, abs=1e-9)
    step = np.array([0.1, -0.2, 0.3, 0.4])
    shift = expected.curve_step(step)
    close(found.curve_step(step), shift, 1e-6)  # in single precision
    assert found.predicted(-shift, step) == pytest.approx(expected.predicted(-shift, step), rel=1e-8)
    right = np.linspace(-1.0, 1.0, shift.size)
    close(found.factor.solve(right), expected.factor.solve(right), 1e-8)


class Ramp:
    """A push that differs from interval to interval."""

    def __init__(self, begin: int = 0) -> None:
        self.begin = begin

    def __len__(self):
        return 1

    def on(self, intervals, n_dof):
        one = self.begin + np.arange(intervals.start, intervals.stop, dtype=float)
        return np.tile(one, (1, n_dof, 2))

    def within(self, intervals):
        return Ramp(self.begin + intervals.start)


@pytest.mark.parametrize("pushed", [False, True])
def test_a_stream_scores_candidates_as_the_whole(crew, pushed):
    whole, parts, physics, control = both(crew)
    more = euler_lagrange(MORE, ["x", "y"])
    step = np.arange(7.0)
    if pushed:
        more, step = WithPushes(more, Ramp()), np.arange(8.0)
    expected, found = (
        linearise(seen, physics, control, VALUES).scored(score, WEIGHTS, more) for seen in (whole, parts)
    )
    close(found.schur, expected.schur)
    close(found.volume.slope, expected.volume.slope)
    close(found.volume.corner, expected.volume.corner)
    close(found.curve_gradient, expected.curve_gradient)
    close(found.border(step), expected.border(step))
    assert found.factor.logdet == pytest.approx(expected.factor.logdet, abs=1e-9)
    right = expected.curve_gradient + expected.border(step)
    close(found.factor.solve(right), expected.factor.solve(right), 1e-8)


def test_a_fit_is_the_same_and_does_not_depend_on_who_computes(crew):
    whole, parts, physics, control = both(crew)
    near = fit_joint(whole, physics, WEIGHTS, control, VALUES)
    start = near.control_points, 1.05 * near.coefficients
    expected, found = (fit_joint(seen, physics, WEIGHTS, *start) for seen in (whole, parts))
    assert found.converged
    close(found.coefficients, expected.coefficients, 1e-5)
    close(found.covariance, expected.covariance, 1e-5)
    again = fit_joint(observe(parts.grid, *problem()[1]), physics, WEIGHTS, *start)
    np.testing.assert_array_equal(again.coefficients, found.coefficients)
    np.testing.assert_array_equal(again.control_points, found.control_points)


def test_a_curve_far_from_the_equations_is_led_on_by_itself(crew):
    whole, parts, physics, control = both(crew)
    held = Physics(physics.columns, np.zeros_like(physics.free), physics.forces)
    expected = fit_joint(whole, held, WEIGHTS, control, VALUES, tolerance=1e-8)
    cost = linearise(whole, held, control, VALUES).cost(WEIGHTS)
    reached = expected.linearisation.cost(WEIGHTS)
    assert expected.converged
    assert cost > reached + 0.5 * whole.counts.sum()
    for each in (physics, held):
        found = linearise(parts, each, control, VALUES, WEIGHTS)
        again = linearise(whole, each, found.control_points, VALUES)
        assert found.cost(WEIGHTS) == pytest.approx(reached, abs=0.05)
        assert again.cost(WEIGHTS) == pytest.approx(found.cost(WEIGHTS), rel=1e-12)
    np.testing.assert_array_equal(
        linearise(parts, physics, found.control_points, VALUES, WEIGHTS).control_points, found.control_points
    )


@pytest.mark.parametrize("seed", [10, 26, 33])
def test_a_curve_that_noise_has_bent_finds_to_equations_that_hold_exactly(crew, seed):
    """Near its upper equilibrium a pendulum falls either way: half a radian of noise hides which."""
    rng = np.random.default_rng(seed)
    angle, rate = 3.0 + 0.1 * rng.standard_normal(), 0.3 * rng.standard_normal()
    t = np.arange(0.0, 10.0, 0.02)
    swing = solve_ivp(
        lambda _, y: [y[1], -9.81 * np.sin(y[0])],
        (0.0, 10.0),
        [angle, rate],
        t_eval=t,
        rtol=1e-10,
        atol=1e-10,
    )
    noisy = swing.y[0][:, None] + 0.5 * rng.standard_normal((t.size, 1))
    grid = uniform_grid([10.0], 25.0, 5, 1)
    basis, rough = grid.design([t], 0), np.diff(np.eye(grid.n_ctrl), 3, axis=0)
    start = np.linalg.solve((basis.T @ basis).toarray() + 0.1 * rough.T @ rough, basis.T @ noisy)
    physics = Physics(euler_lagrange(["theta_dot**2", "cos(theta)"], ["theta"]), np.zeros(2, bool), None)
    seen = observe(grid, [t], [noisy], crew=crew)
    weights = WEIGHTS.__class__(np.array([0.5]), np.array([1e8]), np.array([1e-3]))
    law = np.array([0.5, 9.81])
    assert linearise(seen, physics, start, law, weights).cost(weights) < 1.2 * t.size


def test_a_stream_whose_curve_nothing_holds_fails_as_the_whole(crew):
    _, parts, physics, control = both(crew)
    broken = WEIGHTS.__class__(WEIGHTS.noise_std, np.array([np.nan, 1.0]), WEIGHTS.slack)
    for foreseen in (None, broken):
        at = linearise(parts, physics, control, VALUES, foreseen)
        with pytest.raises(np.linalg.LinAlgError):
            at.normal(broken).eliminate()
    assert fit_joint(parts, physics, broken, control, VALUES).status == "not finite"


def step_of(crew):
    """Quadratic part and step of the curve, at the same place for every crew."""
    grid, data, physics, control = problem()
    at = linearise(observe(grid, *data, crew), physics, control, VALUES, WEIGHTS)
    quadratic = at.normal(WEIGHTS).eliminate()
    return quadratic.matrix, quadratic.curve_step(np.ones(4))


@pytest.mark.parametrize("crew", ["alone"], indirect=True)
@pytest.mark.thorough
def test_children_that_are_killed_cost_time_and_not_the_result(crew):
    expected = step_of(crew)
    doomed = ProcessCrew(2)
    for _ in range(4):  # more often than children are started again
        doomed.results([doomed.task(_die_in_a_child, os.getpid())])
        for one, other in zip(step_of(doomed), expected, strict=True):
            np.testing.assert_array_equal(one, other)
    assert doomed.results([doomed.task(os.getpid)]) == [os.getpid()]
    doomed.close()
    for one, other in zip(step_of(doomed), expected, strict=True):
        np.testing.assert_array_equal(one, other)


def _die_in_a_child(parent: int) -> None:
    if os.getpid() != parent:
        os.kill(os.getpid(), signal.SIGKILL)


def test_what_is_held_travels_as_a_name_and_goes_with_its_last_user(tmp_path):
    held = Held.write(np.arange(10_000.0), tmp_path / "one")
    sent = pickle.dumps(held)
    assert len(sent) < 500
    np.testing.assert_array_equal(pickle.loads(sent), held.value)
    del held
    assert not any(tmp_path.iterdir())


def test_a_crew_leaves_no_files(monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with employ(2) as crew:
        held = crew.held(np.arange(3.0))
        assert crew.results([crew.task(np.sum, held), crew.task(sum, (1, 2))]) == [3.0, 3]
        assert any(tmp_path.iterdir())
    assert not any(tmp_path.iterdir())
    assert crew.held(1) == 1


def files_in(folder) -> list:
    return [path for path in folder.rglob("*") if path.is_file()]


@pytest.mark.parametrize("crew", ["alone"], indirect=True)
def test_solutions_wait_on_disk_until_the_step_is_taken(crew, monkeypatch, tmp_path):
    expected = step_of(crew)[1]
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    _, parts, physics, control = both(crew)
    quadratic = linearise(parts, physics, control, VALUES, WEIGHTS).normal(WEIGHTS).eliminate()
    assert len(files_in(tmp_path)) == len(parts.points)
    np.testing.assert_array_equal(quadratic.curve_step(np.ones(4)), expected)
    del quadratic
    assert not files_in(tmp_path)
    del parts
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("crew", ["alone"], indirect=True)
def test_where_the_disk_is_full_solutions_stay_in_memory(crew, monkeypatch):
    expected = step_of(crew)[1]

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "save", full)
    np.testing.assert_array_equal(step_of(crew)[1], expected)


def test_of_late_forces_a_block_gets_its_own_part():
    late = WithPushes(euler_lagrange(TERMS, ["x", "y"]), _Late(np.ones((1000, 2, 2))))
    assert len(pickle.dumps(late.within(slice(0, 10)))) < 0.1 * len(pickle.dumps(late))


def test_what_fails_in_a_child_fails_here(processes):
    with pytest.raises(ZeroDivisionError):
        processes.results([processes.task(divmod, 1, 0)])


def test_no_thread_of_a_crew_outlives_it(monkeypatch):
    feed = Queue._feed

    def late(*args):
        feed(*args)
        time.sleep(0.3)

    monkeypatch.setattr(Queue, "_feed", staticmethod(late))
    before = set(threading.enumerate())
    with employ(2) as crew:
        assert crew is not None
        crew.results([crew.task(abs, x) for x in range(4)])
    assert set(threading.enumerate()) <= before


def test_a_program_needs_no_guard_for_its_children(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(
        "import math\n"
        "from leastaction.estimation.crew import employ\n"
        "print('begun')\n"
        "with employ(2) as crew:\n"
        "    print(*crew.results([crew.task(math.sqrt, x) for x in (4.0, 9.0)]))\n"
    )
    done = subprocess.run([sys.executable, str(program)], capture_output=True, text=True, timeout=60)
    assert (done.stdout.split(), done.stderr) == (["begun", "2.0", "3.0"], "")


def test_children_end_with_a_program_that_is_killed(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(
        "import os, time\n"
        "from leastaction.estimation.crew import employ\n"
        "with employ(2) as crew:\n"
        "    first = crew.results([crew.task(os.getpid)])[0]\n"
        "    print(first, flush=True)\n"
        "    time.sleep(600)\n"
    )
    running = subprocess.Popen([sys.executable, program], stdout=subprocess.PIPE, text=True)
    assert running.stdout is not None
    child = int(running.stdout.readline())
    os.kill(child, 0)  # it is there
    running.kill()
    running.communicate()
    deadline = time.monotonic() + 60.0
    while _is_running(child) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not _is_running(child)


def _is_running(pid: int) -> bool:
    """Whether the process is there; one that has ended may still wait for whoever asks how."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def counted_looks(monkeypatch) -> list[int]:
    """First knot intervals of blocks, each time that one is laid on its splines."""
    looked: list[int] = []
    observe_block = recipes.Recipe.observe

    def counted(recipe):
        looked.append(recipe.intervals.start)
        return observe_block(recipe)

    monkeypatch.setattr(recipes.Recipe, "observe", counted)
    return looked


def test_a_cluster_keeps_its_blocks(monkeypatch):
    """They are laid on the splines once, and the numbers are those of a stream."""
    monkeypatch.setattr(streamed, "_LONG", 1)
    monkeypatch.setattr(recipes, "_NUMBERS", SMALL)
    grid, data, physics, control = problem()
    alone = fit_joint(observe(grid, *data), physics, WEIGHTS, control, 1.05 * VALUES)
    looked = counted_looks(monkeypatch)
    parts = observe(grid, *data, DaskCrew(Cluster(10**9)))
    away = fit_joint(parts, physics, WEIGHTS, control, 1.05 * VALUES)
    assert sorted(looked) == [intervals.start for intervals in parts.intervals]
    np.testing.assert_array_equal(away.coefficients, alone.coefficients)
    np.testing.assert_array_equal(away.control_points, alone.control_points)


@pytest.mark.parametrize("crew", ["alone"], indirect=True)
def test_the_basis_of_fewer_samples_is_kept(crew, monkeypatch):
    """It is formed once, and the numbers are those of a stream."""
    _, kept, physics, control = both(crew)
    looked = counted_looks(monkeypatch)
    one = linearise(kept, physics, control, VALUES, WEIGHTS).cost(WEIGHTS)
    assert looked == []
    monkeypatch.setattr(streamed, "_KEPT", 0)
    _, parts, physics, control = both(crew)
    assert linearise(parts, physics, control, VALUES, WEIGHTS).cost(WEIGHTS) == one
    assert looked


@pytest.mark.parametrize("crew", ["alone"], indirect=True)
def test_a_step_is_one_pass(crew, monkeypatch):
    """What a step needs of the weights that are foreseen comes from one look at every block."""
    monkeypatch.setattr(streamed, "_KEPT", 0)
    _, parts, physics, control = both(crew)
    looked = counted_looks(monkeypatch)
    at = linearise(parts, physics, control, VALUES, WEIGHTS)
    quadratic = at.normal(WEIGHTS).eliminate()
    quadratic.predicted(quadratic.curve_step(np.ones(4)), np.ones(4))
    assert np.isfinite(at.cost(WEIGHTS))
    assert sorted(looked) == [intervals.start for intervals in parts.intervals]


@pytest.mark.parametrize("crew", ["alone"], indirect=True)
def test_a_block_is_damped_where_its_step_promises_what_the_cost_does_not_keep(crew, monkeypatch):
    """Its curve cannot be improved, but its own step should lower the cost. Other weights damp it, too."""
    whole, parts, physics, control = both(crew)
    monkeypatch.setattr(streamed, "_FAR", 0.0)
    monkeypatch.setattr(streamed, "nearer", lambda at, weights: None)
    monkeypatch.setattr(streamed, "_HELD", 10.0)
    at = [linearise(seen, physics, control, VALUES, WEIGHTS) for seen in (whole, parts)]
    for weights in (WEIGHTS, replace(WEIGHTS, physics=2.0 * WEIGHTS.physics)):
        expected, found = at[0].normal(weights).eliminate(10.0), at[1].normal(weights).eliminate()
        np.testing.assert_allclose(found.matrix, expected.matrix, rtol=1e-9)
        steps = [quadratic.curve_step(np.ones(4)) for quadratic in (found, expected)]
        np.testing.assert_allclose(*steps, rtol=1e-4, atol=1e-6)


def peak_of(run) -> int:
    """Most bytes that a call holds at once beyond what there was before."""
    tracemalloc.start()
    try:
        run()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_of_a_pass_does_not_grow_with_the_number_of_trials(monkeypatch):
    monkeypatch.setattr(streamed, "_LONG", 1)
    monkeypatch.setattr(recipes, "_NUMBERS", 2**14)
    weights = WEIGHTS.__class__(WEIGHTS.noise_std[:2], WEIGHTS.physics, WEIGHTS.slack)
    physics = Physics(euler_lagrange(MORE[:5], ["x", "y"]), np.ones(5, dtype=bool), None)
    peaks = []
    for count in (2, 6):  # the trials, and what a grid lays out for them, are there before
        times = [np.linspace(0.0, 160.0, 3201)] * count
        grid = uniform_grid([160.0] * count, 10.0, 5, 2)
        parts = observe(grid, times, [motion(t) for t in times])
        assert len(parts.points) == count
        near = linearise(parts, physics, np.ones((grid.n_ctrl, 2)), VALUES, weights).control_points
        run = partial(linearise, parts, physics, near, VALUES, weights)
        run()  # what is made once and stays
        peaks.append(peak_of(run))
    of_x = near.size // count * 6 * 4  # bytes of X of a trial: a column for the gradient and for each term
    assert peaks[0] > 40 * of_x  # what the work on a trial holds at once
    assert (peaks[1] - peaks[0]) / 4 < 0.5 * of_x


def test_a_long_recording_is_smoothed_in_runs_as_in_one_piece(monkeypatch):
    rng = np.random.default_rng(3)
    times = [np.sort(rng.uniform(0.0, 5.0, 120)) for _ in range(7)]
    q = [motion(t) + 0.02 * rng.standard_normal((t.size, 2)) for t in times]
    q[2][40:50, 1] = np.nan
    items = [la.Trajectory(t, x, coordinates=["x", "y"]) for t, x in zip(times, q, strict=True)]
    columns = euler_lagrange(TERMS, ["x", "y"])
    grid = Grid.lay(Problem(la.Trajectories(items), columns, np.full(5, np.nan)), 6.0)
    expected = grid.smooth()
    monkeypatch.setattr(streamed, "_LONG", 1)
    monkeypatch.setattr("leastaction.estimation.grid._SMOOTHED", 200)
    found = grid.smooth(expected.penalty)
    close(found.control_points, expected.control_points, 1e-7)
    close(found.noise_std, expected.noise_std, 1e-7)
    one, other = (s.replicates(2, np.random.default_rng(1), np.zeros(2)) for s in (expected, found))
    close(np.array(other), np.array(one), 1e-6)


# ------------------------------------------------------------------------------------- discover()
@pytest.fixture(scope="module")
def just_too_long():
    """A recording that is just too long to be searched in one piece, and its law found by this thread."""
    data = systems.generate("single_pendulum", noise=0.1, trials=6, duration=20.0, seed=0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(streamed, "_LONG", data.n_samples - 1)
        patch.setattr("leastaction.api.ENOUGH_SAMPLES", data.n_samples // 2)
        patch.setattr(recipes, "_NUMBERS", 2**11)
        yield data, la.discover(data, systems.compact_library("single_pendulum"))


@pytest.mark.thorough
@pytest.mark.parametrize("workers", [2, Cluster(10**9)])
def test_the_law_of_a_long_recording_does_not_depend_on_who_computes(workers, just_too_long):
    data, model = just_too_long
    assert "confirm" in model.diagnostics.timings
    again = la.discover(data, systems.compact_library("single_pendulum"), workers=workers)
    assert_same(model, again, 1e-9)
