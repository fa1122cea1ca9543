"""What a law says beyond its terms: symmetries, constants, simple numbers; equilibria and modes."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from scipy.linalg import eigh

import leastaction as la
from helpers import MODELS, record
from leastaction import InputError, LagrangianModel, Trajectories, discover, load, systems
from leastaction.findings import find
from leastaction.library import parse_expression
from leastaction.model.constants import Offer
from leastaction.model.diagnostics import Diagnostics
from leastaction.model.gravity import gravity_findings
from leastaction.model.linear import Linearisation
from leastaction.model.modes import Estimate
from leastaction.model.term import FitSummary, ModelTerm, ShapeParameter
from leastaction.model.text import outcome, simple_lines, symmetry_lines
from page_helpers import spring

ALL = (*systems.names(), *systems.further_names())
PHI = ("cyclic", "phi + c")
SPINNING = ("spherical_pendulum", "spherical_spring_pendulum", "robot_arm", "rotary_pendulum")
SPATIAL = dict.fromkeys((*SPINNING, "kepler_orbit", "morse_molecule"), (PHI,))


def law(coordinates, terms, dissipation=(), sigma=None, **fields):
    """A model with the coefficients of `terms`, their errors independent."""
    made = [
        ModelTerm(text, c, 0.0 if sigma is None else sigma[k]) for k, (text, c) in enumerate(terms.items())
    ]
    covariance = None if sigma is None else np.diag(np.square(sigma))
    return LagrangianModel(
        coordinates, made, [ModelTerm(*item) for item in dict(dissipation).items()], covariance, **fields
    )


def true_law(name, friction=True):
    system = systems.get(name)
    return law(
        system.coordinates,
        system.lagrangian,
        system.dissipation if friction else {},
        provenance={"options": {"angles": list(system.angles)}},
    )


def named(model):
    return [(s.kind, s.change) for s in model.symmetries]


def along(model, symmetry, q, qdot):
    """The conserved quantity, from its text."""
    names = [*model.coordinates, *(f"{c}_dot" for c in model.coordinates)]
    expr = parse_expression(symmetry.quantity, names)
    function = sp.lambdify([sp.Symbol(n, real=True) for n in names], expr, "numpy")
    return np.broadcast_to(function(*q.T, *qdot.T), len(q))


def assert_conserved(model, q0, qdot0, seconds=5.0):
    run = model.simulate(q0, qdot0, np.linspace(0.0, seconds, 200), rtol=1e-11, atol=1e-12)
    assert run.complete
    for symmetry in model.symmetries:
        if symmetry.quantity:
            values = along(model, symmetry, run.q, run.qdot)
            assert np.ptp(values) < 1e-7 * (1.0 + np.abs(values).max()), symmetry.change


@pytest.mark.parametrize("name", ALL)
def test_true_laws_have_their_symmetries_and_no_others(name, rng):
    model = true_law(name, friction=False)
    expected = [*SPATIAL.get(name, ()), ("time reversal", "t -> -t"), ("time translation", "t + c")]
    assert named(model) == expected
    assert {s.holds for s in model.symmetries} == {"in form"}
    assert_conserved(model, *systems.get(name).initial(rng), seconds=2.0)


@pytest.mark.parametrize("name", ["robot_arm", "rotary_pendulum", "double_well"])
def test_friction_conserves_nothing_that_it_acts_on(name):
    for symmetry in true_law(name).symmetries:
        assert symmetry.obstacles == ("friction",)
        assert "friction" in outcome(symmetry)


BODIES = ["x1", "y1", "x2", "y2"]
TWO = {"x1_dot**2+y1_dot**2": 0.5, "x2_dot**2+y2_dot**2": 0.5, "1/sqrt((x1-x2)**2+(y1-y2)**2)": 1.0}


def test_two_bodies():
    model = law(BODIES, TWO)
    expected = ["translation x1 + c, x2 + c", "translation y1 + c, y2 + c"]
    expected += ["rotation of (x1, y1) and of (x2, y2)", "exchange x1 <-> x2, y1 <-> y2"]
    assert [s.name for s in model.symmetries[:4]] == expected
    assert_conserved(model, [-0.5, 0.0, 0.5, 0.1], [0.1, -0.7, 0.0, 0.8])
    unequal = law(BODIES, {**TWO, "x2_dot**2+y2_dot**2": 0.7})
    assert [s.name for s in unequal.symmetries[:4]] == [*expected[:3], "time reversal"]


def test_friction_between_two_bodies_keeps_their_momentum_but_not_their_angular_momentum():
    model = law(BODIES, TWO, {"(x1_dot-x2_dot)**2": 0.1, "(y1_dot-y2_dot)**2": 0.1})
    found = {s.kind: s.obstacles for s in model.symmetries}
    assert found["translation"] == found["exchange"] == ()
    assert found["rotation"] == found["time translation"] == found["time reversal"] == ("friction",)
    run = model.simulate([-0.5, 0.0, 0.5, 0.1], [0.1, -0.7, 0.0, 0.8], np.linspace(0.0, 3.0, 50))
    values = [np.ptp(along(model, s, run.q, run.qdot)) for s in model.symmetries if s.quantity]
    assert max(values[:2]) < 1e-7
    assert min(values[2:]) > 1e-3
    one_sided = replace(model, dissipation=(ModelTerm("x1_dot**2", 0.1),))
    assert {s.kind: s.obstacles for s in one_sided.symmetries}["exchange"] == ("friction",)


def test_more_bodies_and_spaces():
    chain = {
        **{f"x{k}_dot**2": 0.5 for k in range(1, 7)},
        **{f"(x{k}-x{k + 1})**4": -1.0 for k in range(1, 6)},
    }
    model = law([f"x{k}" for k in range(1, 7)], chain)
    mirror = "exchange x1 <-> x6, x2 <-> x5, x3 <-> x4"
    shift = "translation " + ", ".join(f"x{k} + c" for k in range(1, 7))
    assert [s.name for s in model.symmetries] == [shift, mirror, "time reversal", "time translation"]
    space = law(["x", "y", "z"], {"x_dot**2+y_dot**2+z_dot**2": 0.5, "1/sqrt(x**2+y**2+z**2)": 1.0})
    planes = ["rotation of (x, y)", "rotation of (x, z)", "rotation of (y, z)"]
    assert [s.name for s in space.symmetries[:-2]] == planes
    assert_conserved(space, [1.0, 0.2, -0.1], [0.1, 0.9, 0.3])
    relative = law(["u", "v"], {"u_dot**2": 0.5, "v_dot**2": 0.5, "cos(u+v)": 2.0})
    assert [s.name for s in relative.symmetries[:-2]] == ["translation u + c, v - c", "exchange u <-> v"]
    assert_conserved(relative, [0.3, 0.4], [0.5, -0.1])


@pytest.mark.parametrize("gauge", [{"x*y_dot": 2.0}, {"x_dot*y": -2.0}, {"x*y_dot": 1.0, "x_dot*y": -1.0}])
def test_a_shift_in_a_magnetic_field_adds_a_total_derivative(gauge):
    charge = law(["x", "y"], {"x_dot**2": 0.5, "y_dot**2": 0.5, **gauge})
    assert [s.name for s in charge.symmetries] == [
        *("cyclic coordinate x", "cyclic coordinate y", "rotation of (x, y)", "time translation")
    ]
    assert_conserved(charge, [0.3, -0.2], [1.0, 0.5])
    trap = law(["x", "y"], {"x_dot**2+y_dot**2": 0.5, "x**2+y**2": -0.4, **gauge})
    assert named(trap) == [("rotation", "turn of (x, y)"), ("time translation", "t + c")]
    assert_conserved(trap, [0.3, -0.2], [1.0, 0.5])


def test_a_shift_along_gravity_is_none():
    falling = law(["x", "z"], {"x_dot**2": 0.5, "z_dot**2": 0.5, "z": -9.81})
    assert named(falling)[:-2] == [("cyclic", "x + c")]


ORBIT = {"x_dot**2": 0.5, "y_dot**2": 0.5, "1/sqrt(x**2+y**2)": 4.0}
SIGMA = (0.001, 0.002, 0.01)


def rotates(terms, sigma=SIGMA, **fields):
    (found,) = [
        s for s in law(["x", "y"], terms, sigma=sigma, **fields).symmetries if s.kind == "rotation"
    ] or [None]
    return found


def test_coefficients_that_are_equal_within_their_errors():
    step = math.hypot(*SIGMA[:2])
    found = rotates({**ORBIT, "y_dot**2": 0.5 + 1.5 * step})
    assert (found.holds, found.conditions) == ("within errors", 1)
    assert found.chi2 == pytest.approx(1.5**2, rel=1e-6)
    assert found.precision == pytest.approx(step / math.hypot(0.5, 0.5 + 1.5 * step), rel=1e-6)
    assert rotates({**ORBIT, "y_dot**2": 0.5 + 5.0 * step}) is None
    assert rotates({**ORBIT, "y_dot**2": 0.5}, sigma=None).holds == "in numbers"
    assert rotates({**ORBIT, "y_dot**2": 0.5001}, sigma=None) is None


@pytest.mark.parametrize("broken", [0, 1, 2])
def test_nothing_is_claimed_that_is_broken_by_five_standard_errors(broken, rng):
    terms = {
        "x_dot**2": 0.5,
        "y_dot**2": 0.5,
        "x**2": -2.0,
        "y**2": -2.0,
        "x**4": -0.3,
        "x**2*y**2": -0.6,
        "y**4": -0.3,
    }
    sigma = np.array([0.002, 0.003, 0.01, 0.02, 0.003, 0.006, 0.004])
    law_of = lambda c: rotates(dict(zip(terms, c, strict=True)), sigma)  # noqa: E731
    true = np.array(list(terms.values()))
    assert law_of(true).conditions == 4
    pair = ((0, 1), (2, 3), (4, 6))[broken]
    off = true.copy()
    off[pair[1]] += 5.0 * math.hypot(*sigma[list(pair)])
    assert law_of(off) is None


def test_a_common_error_of_scale_does_not_hide_a_difference():
    # both coefficients are uncertain by 5 %, their ratio is not
    scale = np.array([0.5, 0.5, 4.0])
    covariance = 0.05**2 * np.outer(scale, scale) + np.diag([1e-8, 1e-8, 1e-6])
    model = law(["x", "y"], {**ORBIT, "y_dot**2": 0.501}, sigma=np.sqrt(np.diag(covariance)))
    assert "rotation" in {s.kind for s in model.symmetries}
    assert "rotation" not in {s.kind for s in replace(model, covariance=covariance).symmetries}
    terms = [replace(t, coefficient=c) for t, c in zip(model.terms, (0.53, 0.53, 4.2), strict=True)]
    alike = replace(model, terms=terms, covariance=covariance)
    assert "rotation" in {s.kind for s in alike.symmetries}


@pytest.mark.thorough
def test_true_symmetries_are_missed_as_rarely_as_the_level_says(rng):
    draws = rng.normal(size=(200, 3)) * SIGMA + list(ORBIT.values())
    found = [rotates(dict(zip(ORBIT, map(float, draw), strict=True))) for draw in draws]
    assert sum(f is None for f in found) <= 2  # a fifth of one is expected
    chi2 = [f.chi2 for f in found if f]
    assert np.mean(chi2) == pytest.approx(1.0, abs=0.3)


def test_what_is_hardly_known_claims_nothing():
    assert rotates(ORBIT, sigma=(0.2, 0.4, 0.01)) is None
    wide = {**ORBIT, "x**2": 0.01}  # it would have to vanish, and could be anything
    assert rotates(wide, sigma=(*SIGMA, 0.01)) is None


@pytest.mark.thorough
def test_a_found_law_says_what_is_conserved_in_its_recording(tmp_path):
    system = systems.get("kepler_orbit")
    data = systems.generate("kepler_orbit", noise=0.02, trials=2, duration=6.0, seed=4)
    model = discover(data, system.library, angles=["phi"], known=system.known)
    cyclic, back, energy = model.symmetries
    assert (cyclic.kind, back.kind, energy.kind) == ("cyclic", "time reversal", "time translation")
    assert cyclic.drift < 1e-3
    assert energy.drift < 1e-3
    assert "conserved to" in symmetry_lines(model)[0]
    model.save(tmp_path / "model.json")
    again = load(tmp_path / "model.json").symmetries
    assert [s.quantity for s in again] == [s.quantity for s in model.symmetries]
    assert outcome(again[0]) == "conserved if no force acts along it"
    assert math.isnan(again[0].drift)


def with_forces(model: LagrangianModel, forces) -> LagrangianModel:
    diagnostics = model.diagnostics
    assert isinstance(diagnostics, Diagnostics)
    (trial,) = diagnostics.trajectories
    driven = Trajectories([replace(trial, forces=forces(trial.t)[:, None])])
    return replace(model, diagnostics=replace(diagnostics, trajectories=driven))


def test_drift_and_known_forces():
    free = spring()
    (energy,) = [s for s in free.symmetries if s.kind == "time translation"]
    assert energy.drift < 1e-3  # the curve of that model is its exact motion
    wrong = replace(free, terms=(free.terms[0], replace(free.terms[1], coefficient=-0.5)))
    assert {s.kind: s.drift for s in wrong.symmetries}["time translation"] > 0.1
    driven = {s.kind: s for s in with_forces(free, np.sin).symmetries}["time translation"]
    assert driven.obstacles == ("forces",)
    assert math.isnan(driven.drift)
    assert outcome(driven) == "not conserved because of the known forces"
    assert {s.kind: s.obstacles for s in with_forces(free, np.zeros_like).symmetries}[
        "time translation"
    ] == ()
    damped = {s.kind: s for s in with_forces(spring(friction=0.1), np.sin).symmetries}["time translation"]
    assert outcome(damped) == "not conserved because of friction and the known forces"


def test_a_prescribed_coordinate_has_no_momentum_and_gives_energy():
    options = {"options": {"prescribed": ["x"]}}
    crane = law(
        ["x", "theta"],
        {"theta_dot**2": 0.5, "x_dot*theta_dot*cos(theta)": 1.0, "cos(theta)": 9.8},
        **{"provenance": options},
    )
    assert named(crane) == [("time reversal", "t -> -t"), ("time translation", "t + c")]
    assert crane.symmetries[-1].obstacles == ("prescribed",)


def test_unusual_terms_do_no_harm():
    still = law(["x", "y"], {"x_dot**2": 0.5})  # y does not occur at all
    assert [(s.change, s.quantity) for s in still.symmetries[:2]] == [("x + c", "x_dot"), ("y + c", "")]
    odd = law(
        ["x", "y"], {"x_dot**2": 0.5, "y_dot**2": 0.5, "log(x)": 1.0, "abs(y)": -1.0, "sqrt(y_dot**2+1)": 0.1}
    )
    assert named(odd) == [("time reversal", "t -> -t"), ("time translation", "t + c")]
    assert odd.symmetries[-1].latex.startswith("0.5")
    assert odd.symmetries[-1].written.count("0.5*") == 2


# simple numbers inside intervals: offered where they are true, hardly ever by chance


def measured(terms, errors, covariance=None, coordinates=("x", "y"), **fields):
    made = [ModelTerm(text, c, e, known=e == 0.0) for (text, c), e in zip(terms.items(), errors, strict=True)]
    return LagrangianModel(coordinates, made, covariance=covariance, **fields)


def offered(model) -> dict[str, str]:
    found = model.simple_constants.offers
    return {f"{o.subject} : {o.reference}" if o.reference else o.subject: o.text for o in found}


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.5001, "1/2"),
        (-2.0002, "-2"),
        (6.2829, "2*pi"),
        (-1.41433, "-sqrt(2)"),
        (0.33335, "1/3"),
        (0.51, None),
    ],
)
def test_a_simple_number_is_offered_and_the_estimate_stays(value, text):
    model = measured({"x_dot**2": value}, [2e-4 * abs(value)], coordinates=["x"])
    assert list(offered(model).values()) == ([] if text is None else [text])
    assert model.terms[0].coefficient == value
    for offer in model.simple_constants.offers:
        assert offer.lower < offer.number < offer.upper
        assert offer.chance < 0.025


def test_a_wide_interval_offers_nothing():
    narrow = measured({"x_dot**2": 2.0}, [0.002], coordinates=["x"])
    wide = measured({"x_dot**2": 2.0}, [0.02], coordinates=["x"])
    assert offered(narrow) == {"x_dot**2": "2"}
    assert offered(wide) == {}
    (offer,) = narrow.simple_constants.offers
    near = [4 / 3, 3 / 2, 2, 3, math.pi / 2, math.pi, math.sqrt(2)]
    assert offer.chance == pytest.approx(len(near) * math.log(offer.upper / offer.lower) / math.log(4))


def test_numbers_without_meaning_are_rarely_offered(rng):
    found = 0
    for _ in range(400):
        values = np.exp(rng.uniform(-1.5, 2.5, 6)) * rng.choice([-1.0, 1.0], 6)
        errors = np.abs(values) * 10.0 ** rng.uniform(-5.0, -2.0, 6)
        names = ("x_dot**2", "y_dot**2", "x**2", "y**2", "x**4", "exp(-x)")
        found += bool(offered(measured(dict(zip(names, values.tolist(), strict=True)), errors)))
    assert found <= 20  # 5 %; 1.9 % of 3000 are


def test_ratios_do_not_depend_on_the_scale_of_the_law():
    errors = np.array([0.0137, 0.0274, 0.05])
    sizes = np.array([1.37, 2.74, 4.7])
    terms = dict(zip(("x_dot**2", "y_dot**2", "x**2"), sizes.tolist(), strict=True))
    common = np.outer(sizes, sizes) * 0.01**2 + np.diag(1e-8 * sizes**2)  # one per cent of scale in common
    model = measured(terms, np.sqrt(np.diag(common)), common)
    assert offered(model) == {"y_dot**2 : x_dot**2": "2"}
    assert model.simple_constants.freedom == 1
    assert offered(measured(terms, errors)) == {}
    known = measured({**terms, "x_dot**2": 1.37}, [0.0, 0.0003, 0.05])
    assert offered(known) == {"y_dot**2 : x_dot**2": "2"}
    assert offered(measured({"x_dot**2": 0.5, "y_dot**2": 1.0001}, [0.0, 1e-4])) == {"y_dot**2": "1"}


@pytest.mark.parametrize(
    ("one", "other"), [("x_dot**2", "x**2"), ("exp(-x)", "exp(-2*x)"), ("x**2", "x**3"), ("x", "cos(y)")]
)
def test_terms_of_other_units_have_no_ratio(one, other):
    assert offered(measured({"x_dot**2+y_dot**2": 0.77, one: 1.37, other: 2.74}, [1e-4] * 3)) == {}


def test_angles_have_no_unit():
    options = {"provenance": {"options": {"angles": ["x", "y"]}}}
    terms = {"x_dot**2": 1.37, "x_dot*y_dot*cos(x-y)": 2.74}
    assert offered(measured(terms, [1e-4] * 2, **options)) == {"x_dot**2 : x_dot*y_dot*cos(x-y)": "1/2"}


def test_offers_that_exclude_each_other_are_said_to():
    terms = {"x_dot**2": 1.0004, "y_dot**2": 0.9996}
    close = 0.00021**2 * np.array([[1.0, 0.999], [0.999, 1.0]])  # their difference is known far better
    found = measured(terms, np.sqrt(np.diag(close)), close).simple_constants
    assert {o.text for o in found.offers} == {"1"}
    assert not found.compatible
    assert found.chi2 > 100.0
    assert "incompatible" in simple_lines(measured(terms, np.sqrt(np.diag(close)), close))[-1]
    apart = measured(terms, [0.00021] * 2).simple_constants
    assert apart.compatible
    assert apart.chi2 == pytest.approx(2 * (4 / 2.1) ** 2, rel=1e-6)


def test_shape_parameters():
    terms = [
        ModelTerm("x_dot**2", 0.77, 0.001),
        ModelTerm("abs(x)**3.0006", -2.31, 0.004, template="abs(x)**{n}"),
    ]
    shapes = [ShapeParameter("n", 3.0006, 0.0008)]
    model = LagrangianModel("x", terms, shapes=shapes)
    (offer,) = model.simple_constants.offers
    assert str(offer) == "{n} = 3.00060(80): 3"
    at_zero = LagrangianModel("x", terms, shapes=[ShapeParameter("n", 1e-5, 0.0008)])
    assert at_zero.simple_constants.offers == ()


def test_no_errors_no_offers():
    system = systems.get("kepler_orbit")
    exact = LagrangianModel(system.coordinates, [ModelTerm(k, c) for k, c in system.lagrangian.items()])
    assert exact.simple_constants.offers == ()
    assert simple_lines(exact) == []
    vague = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5, math.nan)])
    assert vague.simple_constants.offers == ()


@pytest.mark.thorough
def test_a_found_law():
    system = systems.get("double_pendulum")
    data = systems.generate("double_pendulum", noise=0.01, trials=3, duration=8.0, seed=1)
    model = discover(data, system.library, angles=system.angles)
    assert {o.text for o in model.simple_constants.offers} <= {"1", "2", "1/2"}
    assert "cos(theta1) : cos(theta2)" in offered(model)
    assert model.simple_constants.compatible
    assert all(isinstance(o, Offer) for o in model.simple_constants.offers)


# ------------------------------------------------------------------------ gravity from a law and a length
def _hanging(relative: bool, clock: float = 1.0, up: bool = False) -> LagrangianModel:
    """Three links with the lengths 0.3, 0.2, 0.1 m; a second of the recording lasts ``clock`` seconds."""
    masses, lengths, names = (1.0, 0.7, 0.4), (0.3, 0.2, 0.1), ("a", "b", "c")
    q, v = zip(*((sp.Symbol(n, real=True), sp.Symbol(f"{n}_dot", real=True)) for n in names), strict=True)
    angle = [sum(q[: i + 1]) if relative else q[i] for i in range(3)]
    rate = [sum(v[: i + 1]) if relative else v[i] for i in range(3)]
    law = sp.Integer(0)
    for i, j in itertools.product(range(3), repeat=2):
        behind = sum(masses[max(i, j) :])
        law += behind * lengths[i] * lengths[j] * rate[i] * rate[j] * sp.cos(angle[i] - angle[j]) / 2
    sign = -1 if up else 1
    law += sign * 9.81 * clock**2 * sum(sum(masses[i:]) * lengths[i] * sp.cos(angle[i]) for i in range(3))
    parts = sp.expand(law).as_coefficients_dict()
    return LagrangianModel(names, [ModelTerm(str(term), float(k)) for term, k in parts.items()])


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("up", [False, True])
def test_lengths_of_links_from_gravity(relative, up):
    found = _hanging(relative, up=up).gravity()
    assert [ratio.link for ratio in found] == ["a", "b"]  # nothing hangs on the last
    assert [9.81 / ratio.value for ratio in found] == pytest.approx([0.3, 0.2])


@pytest.mark.parametrize("clock", [1.0, 1e-3, 60.0])
def test_a_length_shows_the_clock(clock):
    ratio, _ = _hanging(True, clock).gravity({"a": 0.3})
    assert ratio.gravity == pytest.approx(9.81 * clock**2)
    assert ratio.clock == (None if clock == 1.0 else pytest.approx(clock, rel=1e-3))
    assert ("not that of the Earth" in str(ratio)) == (clock != 1.0)
    unit = {1e-3: "times may be in milliseconds", 60.0: "times may be in minutes"}.get(clock, "")
    assert ratio.unit == unit
    assert unit in str(ratio)


@pytest.mark.parametrize(
    ("length", "said"), [(300.0, "millimetres"), (30.0, "centimetres"), (11.8, "inches"), (0.6, "inclined")]
)
def test_a_length_in_another_unit_is_named(length, said):
    ratio, _ = _hanging(True).gravity({"a": length})
    assert said in str(ratio)


def test_a_ratio_knows_its_error():
    terms = [ModelTerm("q_dot**2", 0.5, 0.01), ModelTerm("cos(q)", 20.0, 0.3)]
    covariance = [[1e-4, 0.01 * 0.3 * 0.9], [0.01 * 0.3 * 0.9, 0.09]]
    (ratio,) = LagrangianModel("q", terms, covariance=covariance).gravity()
    share = np.hypot(0.02, 0.015), 2 * 0.9 * 0.02 * 0.015
    assert ratio.standard_error / ratio.value == pytest.approx(np.sqrt(share[0] ** 2 - share[1]))


def test_what_gravity_says_of_the_clock_is_a_finding():
    def said(clock, lengths):
        return {f.code: f for f in gravity_findings(_hanging(True, clock), lengths)}

    off = said(1e-3, {"a": 0.3, "c": 0.1})
    assert [*off] == ["gravity-off", "length-implausible", "length-unused"]
    assert off["gravity-off"].values["clock"] == pytest.approx(1e-3, rel=1e-3)
    assert "milliseconds" in off["gravity-off"].remedy
    assert off["length-implausible"].subject == ("b",)
    assert off["length-unused"].subject == ("c",)
    assert not said(1.0, {"a": 0.3})
    assert not said(1.0, {})
    assert "inclined" in said(0.8, {"a": 0.3})["gravity-off"].remedy


@pytest.mark.parametrize("lengths", [{"c": 0.1}, {"a": -1.0}, {"a": True}, {"z": 1.0}])
def test_lengths_that_say_nothing_are_refused(lengths):
    with pytest.raises(InputError, match="length"):
        _hanging(False).gravity(lengths)


# ----------------------------------------------------------------------- equilibria, linear systems and modes
def law_of(coordinates, terms, dissipation=(), covariance=None, **fields):
    """A model with the coefficients of `terms`; errors are those of the covariance."""
    both = [*dict(terms).items(), *dict(dissipation).items()]
    errors = np.zeros(len(both)) if covariance is None else np.sqrt(np.diag(covariance))[: len(both)]
    made = [ModelTerm(text, c, error) for (text, c), error in zip(both, errors.tolist(), strict=True)]
    n = len(dict(terms))
    return LagrangianModel(coordinates, made[:n], made[n:], covariance, **fields)


def true_law_of(name, **fields):
    system = systems.get(name)
    return law_of(system.coordinates, system.lagrangian, system.dissipation, **fields)


def spread(rng, values, relative=1e-4):
    """A covariance with correlations, small enough for the delta method."""
    mixed = rng.normal(size=(len(values), len(values))) * relative
    return np.outer(values, values) * (mixed @ mixed.T)


def errors_of(system: Linearisation):
    """Every number of the modes, and the standard error of each."""
    numbers, errors = [], []
    for mode in system.modes:
        for found in (mode.natural_frequency, mode.frequency, mode.damping_ratio):
            numbers.append(found.value)
            errors.append(found.standard_error)
        for part in (np.real, np.imag):
            numbers += part(mode.shape).tolist()
            errors += part(mode.shape_standard_error).tolist()
    return np.array(numbers), np.array(errors)


def drawn(rng, values, covariance, modes, number=4000):
    """Standard deviations of what `modes` makes of drawn coefficients."""
    draws = rng.multivariate_normal(values, covariance, number, method="eigh")
    return np.std([modes(draw) for draw in draws], axis=0)


def assert_errors(system, values, errors):
    found, estimated = errors_of(system)
    np.testing.assert_allclose(found, values, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(estimated, errors, rtol=0.07, atol=1e-9)


SPRINGS = {"x_dot**2": 0.5, "y_dot**2": 1.0, "x_dot*y_dot": 0.2, "x**2": -4.0, "(x-y)**2": -3.0}


def spring_modes(c):
    """By hand, without friction."""
    mass = np.array([[2 * c[0], c[2]], [c[2], 2 * c[1]]])
    stiffness = -2 * np.array([[c[3] + c[4], -c[4]], [-c[4], c[4]]])
    squares, shapes = eigh(stiffness, mass)
    out = []
    for square, shape in zip(squares, shapes.T, strict=True):
        shape = shape / shape[np.argmax(np.abs(shape))]
        out += [np.sqrt(square), np.sqrt(square) / (2 * np.pi), 0.0, *shape, 0.0, 0.0]
    return np.array(out)


def test_errors_of_springs_are_those_of_drawn_coefficients(rng):
    values = np.array([*SPRINGS.values()])
    covariance = spread(rng, values)
    system = law_of(["x", "y"], SPRINGS, covariance=covariance).linearise([0.0, 0.0])
    assert_errors(system, spring_modes(values), drawn(rng, values, covariance, spring_modes))
    assert system.stability == "stable"


# a spring that hangs, damped: the exponential moves the equilibrium, and so the stiffness
HANGING = {"x_dot**2": 0.5, "y_dot**2": 0.7, "exp({a}*x)": -1.0, "x": 2.0, "(x-y)**2": -3.0, "y*x_dot": 0.8}
DAMPED = {"x_dot**2/2": 0.3, "(x_dot-y_dot)**2/2": 0.2}


def hanging_modes(c):
    """By hand: exp(a x) pulls with −c₂ a exp(a x) = c₃, where x − y = 0."""
    a = c[8]
    mass = np.diag([2 * c[0], 2 * c[1]])
    pull = a * c[3]  # −∂²L/∂x² of the exponential, at the equilibrium
    stiffness = np.array([[pull - 2 * c[4], 2 * c[4]], [2 * c[4], -2 * c[4]]])
    friction = np.array([[c[6] + c[7], -c[7]], [-c[7], c[7]]])
    turning = c[5] * np.array([[0.0, 1.0], [-1.0, 0.0]])  # of y ẋ: d/dt y − 0 and −ẋ
    inverse = np.linalg.inv(mass)
    whole = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ stiffness, -inverse @ (friction + turning)]])
    poles, vectors = np.linalg.eig(whole)
    out = []
    for k in sorted(np.flatnonzero(poles.imag > 0), key=lambda k: abs(poles[k])):
        shape = vectors[:2, k] / vectors[np.argmax(np.abs(vectors[:2, k])), k]
        out += [abs(poles[k]), abs(poles[k]) / (2 * np.pi), -poles[k].real / abs(poles[k])]
        out += [*shape.real, *shape.imag]
    return np.array(out)


def hanging(covariance):
    shapes = [ShapeParameter("a", 0.9, float(np.sqrt(covariance[-1, -1])))]
    model = law_of(
        ["x", "y"],
        {k.format(a=0.9): c for k, c in HANGING.items()},
        DAMPED,
        np.diag(np.diag(covariance)[:-1]),
    )
    first = replace(model.terms[2], template="exp({a}*x)")
    return replace(
        model, terms=(*model.terms[:2], first, *model.terms[3:]), covariance=covariance, shapes=shapes
    )


def test_errors_with_friction_rotation_and_a_shape_parameter_are_those_of_drawn_numbers(rng):
    values = np.array([*HANGING.values(), *DAMPED.values(), 0.9])
    covariance = spread(rng, values)
    model = hanging(covariance)
    (rest,) = model.equilibria(within={"x": (-3.0, 3.0), "y": (-3.0, 3.0)})
    x = np.log(2.0 / 0.9) / 0.9
    np.testing.assert_allclose(rest.q, [x, x], rtol=1e-10)
    assert (rest.stability, rest.isolated, rest.recorded) == ("stable", True, None)
    system = model.linearise(rest.q)
    assert_errors(system, hanging_modes(values), drawn(rng, values, covariance, hanging_modes))
    places = drawn(rng, values, covariance, lambda c: np.log(-c[3] / (c[8] * c[2])) / c[8])
    np.testing.assert_allclose(system.standard_error, [places, places], rtol=0.07)


def test_small_motions_are_those_of_the_modes():
    model = hanging(np.zeros((9, 9)))
    system = model.linearise([np.log(2.0 / 0.9) / 0.9] * 2)
    t = np.linspace(0.0, 4.0, 41)
    for mode in system.modes:
        assert np.abs(mode.shape.imag).max() > 0.1  # rotation: the coordinates are out of step
        expected = 1e-5 * (mode.shape * np.exp(mode.pole * t)[:, None]).real
        speed = 1e-5 * (mode.pole * mode.shape).real
        run = model.simulate(system.q + expected[0], speed, t, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(run.q - system.q, expected, atol=2e-9)


@pytest.mark.parametrize("factor", [-3.0, 0.01])
def test_the_scale_of_the_law_does_not_matter(rng, factor):
    values = np.array([*SPRINGS.values(), 0.1, 0.2])
    covariance = spread(rng, values)
    friction = {"x_dot**2/2": 0.1, "(x_dot-y_dot)**2/2": 0.2}
    one = law_of(["x", "y"], SPRINGS, friction, covariance).linearise([0.0, 0.0])
    scaled = [{k: factor * c for k, c in part.items()} for part in (SPRINGS, friction)]
    other = law_of(["x", "y"], *scaled, factor**2 * covariance).linearise([0.0, 0.0])
    np.testing.assert_allclose(errors_of(other), errors_of(one), rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(other.mass, factor * one.mass)


def test_scales_of_modes_do_not_matter(rng):
    mass, stiffness = np.array([[1.0, 0.2], [0.2, 2.0]]), np.array([[14.0, -6.0], [-6.0, 6.0]])
    shapes = eigh(stiffness, mass)[1]
    other = mass @ shapes @ np.diag([1.0, 3.0]) @ np.linalg.inv(shapes)  # S M with S M = M Φ diag Φ⁻¹
    more = stiffness @ shapes @ np.diag([1.0, 3.0]) @ np.linalg.inv(shapes)

    def model(m, k):
        terms = {"x_dot**2": m[0, 0] / 2, "y_dot**2": m[1, 1] / 2, "x_dot*y_dot": m[0, 1]}
        return law_of(["x", "y"], {**terms, "x**2": -k[0, 0] / 2, "y**2": -k[1, 1] / 2, "x*y": -k[0, 1]})

    one, two = model(mass, stiffness).linearise([0, 0]), model(other, more).linearise([0, 0])
    assert np.abs(one.mass - two.mass).max() > 0.5
    np.testing.assert_allclose(errors_of(two)[0], errors_of(one)[0], rtol=1e-9, atol=1e-12)


def test_a_passive_system_has_the_same_modes_whatever_is_known():
    def pull(q, v, f):
        return np.stack([-8.0 * q[0] + 3.0 * q[1], 3.0 * q[0] - 3.0 * q[1]]) - 0.1 * v

    data = record(pull, [([1.0, -0.5], [0.0, 0.0]), ([0.2, 1.0], [1.0, 0.0])], ["x", "y"])
    library = la.Library(["x_dot**2", "y_dot**2", "x**2", "y**2", "x*y"], ["x", "y"], dissipation=FRICTION)
    one, other = (la.discover(data, library, known={"x_dot**2": c}) for c in (0.5, 40.0))
    found = [model.linearise([0.0, 0.0]) for model in (one, other)]
    first, second = (errors_of(system) for system in found)
    np.testing.assert_allclose(second[0], first[0], rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(second[1], first[1], rtol=0.02, atol=1e-6)
    poles = np.linalg.eigvals([[0, 0, 1, 0], [0, 0, 0, 1], [-8, 3, -0.1, 0], [3, -3, 0, -0.1]])
    truth = np.sort(np.abs(poles))[::2]
    for mode, value in zip(found[0].modes, truth, strict=True):
        assert abs(mode.natural_frequency.value - value) < 4.0 * mode.natural_frequency.standard_error
        assert mode.natural_frequency.standard_error < 0.01 * value
        ratio = 0.05 / value
        assert abs(mode.damping_ratio.value - ratio) < 4.0 * mode.damping_ratio.standard_error
    (rest,) = one.equilibria()
    assert (rest.q.tolist(), rest.recorded, rest.stability) == ([0.0, 0.0], True, "stable")


FRICTION = ["x_dot**2/2", "y_dot**2/2"]


def test_a_damped_pendulum():
    model = law_of(["theta"], {"theta_dot**2": 0.5, "cos(theta)": 9.81}, {"theta_dot**2/2": 0.4})
    below, above = model.equilibria()
    np.testing.assert_allclose([below.q, above.q], [[0.0], [np.pi]])
    assert [below.stability, above.stability] == ["stable", "unstable"]
    (mode,) = model.linearise([0.0]).modes
    assert mode.natural_frequency.value == pytest.approx(np.sqrt(9.81))
    assert mode.damping_ratio.value == pytest.approx(0.2 / np.sqrt(9.81))
    falling = model.linearise([3.1416])  # π, as people write it
    assert falling.q[0] == pytest.approx(np.pi, rel=1e-12)
    np.testing.assert_allclose([mode.pole for mode in falling.modes], np.roots([1.0, 0.4, -9.81])[::-1])
    assert [mode.damping_ratio.value for mode in falling.modes] == [-1.0, 1.0]
    np.testing.assert_allclose(falling.poles, [mode.pole for mode in falling.modes])


def test_a_double_pendulum():
    model = true_law_of("double_pendulum")
    found = {tuple((rest.q / np.pi).round(9)): rest.stability for rest in model.equilibria()}
    assert found == {(0, 0): "stable", (1, 0): "unstable", (0, 1): "unstable", (1, 1): "unstable"}
    frequencies = [mode.natural_frequency.value for mode in model.linearise([0.0, 0.0]).modes]
    np.testing.assert_allclose(np.square(frequencies), 9.81 * np.array([2 - np.sqrt(2), 2 + np.sqrt(2)]))
    shapes = np.array([mode.shape for mode in model.linearise([0.0, 0.0]).modes])
    np.testing.assert_allclose(shapes, [[np.sqrt(0.5), 1.0], [-np.sqrt(0.5), 1.0]], atol=1e-12)


def test_equilibria_by_symmetry_have_no_error():
    """Not even what rounding leaves of one."""
    terms = [("q1_dot**2", 0.0697), ("q1_dot**2*cos(q2)", 0.03613), ("q1_dot*q2_dot", 0.02536)]
    terms += [("q1_dot*q2_dot*cos(q2)", 0.03584), ("q2_dot**2", 0.0143)]
    terms += [("cos(q1)", 3.514), ("cos(q1+q2)", 1.159)]
    model = la.LagrangianModel(["q1", "q2"], [ModelTerm(text, c, 0.02 * c) for text, c in terms])
    rests = model.equilibria()
    assert len(rests) == 4
    for rest in rests:
        assert all(x == 0.0 or x == pytest.approx(np.pi) for x in rest.q)
        np.testing.assert_array_equal(rest.standard_error, 0.0)


def test_wells_and_saddles_between_magnets():
    model = true_law_of("magnetic_pendulum")
    found = model.equilibria(within={"x": (-5.0, 5.0), "y": (-5.0, 5.0)})
    wells = np.array([rest.q for rest in found if rest.stability == "stable"])
    assert (len(found), len(wells)) == (7, 3)
    for rest in found:  # the magnets stand at the corners of a triangle
        turned = [[-0.5, -np.sqrt(0.75)], [np.sqrt(0.75), -0.5]] @ rest.q
        assert np.abs([other.q - turned for other in found]).max(axis=1).min() < 1e-9


def test_a_force_moves_the_equilibrium():
    model = law_of(["theta"], {"theta_dot**2": 0.5, "cos(theta)": 9.81}, covariance=np.diag([0.0, 1e-4]))
    lower, upper = model.equilibria(forces=[5.0])
    np.testing.assert_allclose([lower.q[0], upper.q[0]], [np.arcsin(5 / 9.81), np.pi - np.arcsin(5 / 9.81)])
    system = model.linearise(lower.q, forces=[5.0])
    assert system.modes[0].pole.imag == pytest.approx((9.81**2 - 25.0) ** 0.25)
    # sin θ = f/k: dθ = −f dk/(k² cos θ)
    assert system.standard_error[0] == pytest.approx(5.0 * 0.01 / (9.81**2 * np.cos(lower.q[0])), rel=1e-5)
    assert model.equilibria(forces=[12.0]) == ()


def test_wells_are_looked_for_where_asked():
    model = law_of(["x"], {"x_dot**2": 0.5, "x**2": 0.5, "x**4": -0.25})
    everywhere = model.equilibria(within={"x": (-2.0, 2.0)})
    assert [round(float(rest.q[0]), 9) for rest in everywhere] == [-1.0, 0.0, 1.0]
    assert [rest.stability for rest in everywhere] == ["stable", "unstable", "stable"]
    assert [rest.q[0] for rest in model.equilibria(within={"x": (0.5, 2.0)})] == pytest.approx([1.0])


def test_lines_of_equilibria_give_one():
    pair = law_of(["x", "y"], {"x_dot**2": 0.5, "y_dot**2": 0.5, "(x-y)**2": -2.0})
    (rest,) = pair.equilibria(within={"x": (-1.0, 1.0), "y": (-1.0, 1.0)})
    assert (rest.isolated, rest.stability) == (False, "neutral")
    assert np.isnan(rest.standard_error).all()
    assert rest.q[0] == pytest.approx(rest.q[1])
    free, swing = pair.linearise(rest.q).modes
    assert (free.natural_frequency.value, swing.natural_frequency.value) == (0.0, pytest.approx(np.sqrt(8.0)))
    hat = law_of(["x", "y"], {"x_dot**2+y_dot**2": 0.5, "x**2+y**2": 1.0, "(x**2+y**2)**2": -0.5})
    found = hat.equilibria(within={"x": (-2.0, 2.0), "y": (-2.0, 2.0)})
    assert sorted((round(float(np.hypot(*r.q)), 6), r.isolated) for r in found) == [(0.0, True), (1.0, False)]
    drifting = law_of(["x", "phi"], {"x_dot**2": 0.5, "phi_dot**2": 0.5, "x**2": -1.0})
    (rest,) = drifting.equilibria(within={"x": (-1.0, 1.0)})
    np.testing.assert_array_equal(rest.q, [0.0, 0.0])
    np.testing.assert_array_equal(np.isnan(rest.standard_error), [False, True])


def test_where_the_coordinates_fail_nothing_is_decided():
    model = true_law_of("spherical_pendulum")
    assert {rest.stability for rest in model.equilibria()} == {"undecided"}
    with pytest.raises(InputError, match="mass matrix is singular"):
        model.linearise([0.0, 0.0])


def test_equal_modes_have_no_shape_of_their_own():
    bowl = law_of(["x", "y"], {"x_dot**2+y_dot**2": 0.5, "x**2+y**2": -2.0}, covariance=np.diag([1e-6, 1e-6]))
    for mode in bowl.linearise([0.0, 0.0]).modes:
        # ω² = k/m: half of both relative errors
        assert mode.natural_frequency.standard_error == pytest.approx(np.hypot(2e-3, 0.5e-3), rel=1e-6)
        assert np.isnan(mode.shape_standard_error).any()
    # here the errors part the frequencies, and each is the lower one or the upper one
    terms = {"x_dot**2": 0.5, "y_dot**2": 0.5, "x**2": -2.0, "y**2": -2.0}
    apart = law_of(["x", "y"], terms, covariance=1e-6 * np.eye(4))
    assert np.isnan([m.natural_frequency.standard_error for m in apart.linearise([0.0, 0.0]).modes]).all()
    critical = law_of(["x"], {"x_dot**2": 0.5, "x**2": -0.5}, {"x_dot**2/2": 2.0}, 1e-6 * np.eye(3))
    assert np.isnan([m.natural_frequency.standard_error for m in critical.linearise([0.0]).modes]).all()


def test_a_mode_at_rest_is_listed_once():
    """Its pole at zero is double where nothing damps it."""
    terms = {"x_dot**2": 0.3, "y_dot**2": 0.2, "x_dot*z_dot*cos(z)": 0.1, "z_dot**2": 0.2, "z**2": -1.0}
    for friction, free in (({"z_dot**2/2": 0.02}, 2), ({"x_dot**2/2": 0.02, "z_dot**2/2": 0.02}, 2)):
        system = law_of(["x", "y", "z"], terms, friction).linearise([0.0, 0.0, 0.0])
        paces = [mode.pace for mode in system.modes]
        assert paces.count("moves freely") == free
        assert len(system.poles) == 6
        assert sum(pace.endswith("1/s") for pace in paces) == len(friction) - 1


def test_without_errors_there_are_none():
    terms = [ModelTerm("x_dot**2", 0.5, known=True), ModelTerm("x**2", -2.0, float("nan"))]
    (mode,) = LagrangianModel("x", terms).linearise([0.0]).modes
    assert mode.natural_frequency.value == 2.0
    assert np.isnan([mode.natural_frequency.standard_error, mode.damping_ratio.standard_error]).all()
    assert str(Estimate(2.0, float("nan"))) == "2"


DRY = {"theta_dot**2/2 + abs(theta_dot)": 0.4, "abs(theta_dot)*theta_dot**2/3": 0.2}


def test_dry_friction_is_left_out():
    terms = {"theta_dot**2": 0.5, "cos(theta)": 9.81}
    system = law_of(["theta"], terms, DRY).linearise([0.0])
    assert system.left_out == ("theta_dot**2/2 + abs(theta_dot)",)
    assert system.damping.tolist() == [[0.4]]  # drag has none at rest
    rounded_off = {"sqrt(theta_dot**2 + 1/10000)": 0.2}
    noted = FitSummary(findings=[find("friction-smoothed", ["theta_dot"], widths=[0.01])])
    assert law_of(["theta"], terms, rounded_off, fit=noted).linearise([0.0]).left_out == ("abs(theta_dot)",)
    written = law_of(["theta"], terms, rounded_off).linearise([0.0])  # nobody says what it stands for
    assert (written.left_out, written.damping.tolist()) == ((), [[pytest.approx(20.0)]])


def test_a_kink_of_the_potential_is_refused():
    model = law_of(["x"], {"x_dot**2": 0.5, "abs(x)": -1.0, "abs(x-1)**3": -1.0})
    with pytest.raises(InputError, match=r"abs\(x\) has a kink"):
        model.linearise([0.0])
    wedge = law_of(["x"], {"x_dot**2": 0.5, "abs(x)": -1.0, "x**2": -1.0})
    assert [rest.stability for rest in wedge.equilibria(within={"x": (-1.0, 1.0)})] == ["undecided"]
    smooth = law_of(["x"], {"x_dot**2": 0.5, "abs(x)**3": -1.0})
    assert smooth.linearise([0.0]).stiffness.tolist() == [[0.0]]


def test_prescribed_coordinates_are_held():
    model = true_law_of("cart_spring_pendulum", provenance={"options": {"prescribed": ["x"]}})
    rests = model.equilibria(inputs={"x": 0.3})
    assert [rest.q.round(9).tolist() for rest in rests] == [[0.3, 0.0], [0.3, round(np.pi, 9)]]
    system = model.linearise([0.3, 0.0])
    assert system.coordinates == ("theta",)
    assert system.modes[0].pole == pytest.approx(1j * np.sqrt(9.81))
    with pytest.raises(InputError, match="expected the positions of x"):
        model.equilibria()
    with pytest.raises(InputError, match="x, which was prescribed and is held; expected 0"):
        model.linearise([0.3, 0.0], forces=[1.0, 0.0])


@pytest.mark.parametrize("name", ["driven", "magnetic", "swapped", "single"])
def test_state_matrices_are_those_of_the_control_package(name):
    pytest.importorskip("control")
    model = MODELS[name]()
    rest = np.zeros(model.n_dof)
    system, other = model.linearise(rest), la.control.linearize(model, rest)
    np.testing.assert_allclose(system.a, other.A, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(system.b, other.B, rtol=1e-12, atol=1e-12)
    expected = np.linalg.eigvals(other.A)
    assert np.abs(expected[:, None] - system.poles).min(axis=0).max() < 1e-7


def test_wrong_use():
    model = law_of(["x", "y"], {**SPRINGS, "x": 1.0})
    with pytest.raises(InputError, match=r"is not an equilibrium; equilibria\(\).*forces = \[-1.0, 0.0\]"):
        model.linearise([0.0, 0.0])
    np.testing.assert_allclose(model.linearise([0.0, 0.0], forces=[-1.0, 0.0]).q, 0.0, atol=1e-12)
    with pytest.raises(InputError, match=r"the range of x is unknown.*give within=\{'x': \(low, high\)\}"):
        model.equilibria()
    with pytest.raises(InputError, match="'z' is not a coordinate; expected x, y"):
        model.equilibria(within={"z": (0.0, 1.0)})
    with pytest.raises(InputError, match="expected two rising numbers"):
        model.equilibria(within={"x": (1.0, 0.0)})
    with pytest.raises(InputError, match="expected nothing: no coordinate is prescribed"):
        model.equilibria(within={"x": (0, 1), "y": (0, 1)}, inputs={"x": 0.0})
    with pytest.raises(InputError, match="expected 2 finite number"):
        model.linearise([0.0])
    timed = law_of(["x"], {"x_dot**2": 0.5, "x*cos(t)": 1.0})
    for ask in (timed.equilibria, lambda: timed.linearise([0.0])):
        with pytest.raises(InputError, match=r"depends on time.*control\.linearize"):
            ask()
