"""Shape parameters: where they are looked for, and the joint fit of them and the coefficients."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import leastaction as la
from helpers import free_motions, interpolate, record, terms
from leastaction.diagnosis.shapes import doubts_about_shapes
from leastaction.errors import InputError
from leastaction.estimation import profile
from leastaction.estimation.fit import Fit, ShapeEstimate
from leastaction.estimation.gauss_newton import fit_joint
from leastaction.estimation.grid import Grid
from leastaction.estimation.problem import Problem
from leastaction.estimation.shape_ranges import ShapeRange, shape_ranges
from leastaction.estimation.shapes import fit_shapes
from leastaction.estimation.structure import Structure
from leastaction.estimation.weights import evidence
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
        (2.0, 0.999999, ["shape-undetermined"], "exp(-0.8*x)"),
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
        assert rise > 6.0
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
