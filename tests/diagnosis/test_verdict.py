"""What a result says of itself when the question was wrong: the likely cause, by name and by number."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import leastaction as la
from helpers import PENDULUM_LIBRARY, _pendulum, changed, findings_of, pendulum, record
from leastaction import systems
from leastaction.diagnosis import verdict
from leastaction.diagnosis.effects import Effects, gain_of_terms, is_minor
from leastaction.diagnosis.forces import exchanged_forces
from leastaction.diagnosis.missing_terms import common_terms
from leastaction.diagnosis.wider_search import begun_anew, perhaps_degrees
from leastaction.estimation.build import Request, build_problem
from leastaction.estimation.grid import Grid
from leastaction.findings import Finding
from leastaction.mechanics.euler_lagrange import EulerLagrange
from leastaction.selection.forecast_error import Followed, forecast_error
from leastaction.selection.search import find_structure
from leastaction.selection.search_state import begin_search
from leastaction.selection.settings import SELECTION
from leastaction.selection.weak_proposals import unexplained
from leastaction.selection.weak_search import kinetic_bases


class Doubts:
    """The warnings of a model that must not be ok."""

    def __init__(self, data, library, **options) -> None:
        model = la.discover(data, library, **options)
        assert model.fit.status != "ok"
        self.findings = [finding for finding in model.fit.findings if finding.severity == "warning"]
        self.codes = [finding.code for finding in self.findings]

    def all(self, code: str) -> list[Finding]:
        return [finding for finding in self.findings if finding.code == code]

    def one(self, code: str) -> Finding:
        (found,) = self.all(code)
        return found


def driven(name: str = "double_pendulum", **change):
    data = systems.generate(name, noise=0.01, trials=2, duration=6.0, rate=50.0, seed=3)
    return la.Trajectories([change_one(t, **change) for t in data]), systems.compact_library(name)


def change_one(t, delay: float = 0.0, scale: float = 1.0, swap: bool = False):
    forces = scale * np.stack([np.interp(t.t + delay, t.t, f) for f in t.forces.T], axis=1)
    return la.Trajectory(t.t, t.q, forces[:, ::-1] if swap else forces, t.coordinates)


def test_the_undisturbed_question_is_answered():
    assert la.discover(*driven()).fit.status == "ok"


def test_delayed_forces():
    # recorded 30 ms before they act
    late = Doubts(*driven(delay=0.03)).one("late-forces")
    assert 0.02 <= late.values["delay"] <= 0.04


@pytest.mark.thorough
def test_a_delay_is_not_named_again_as_negative_friction():
    """20 ms feed energy in as friction of the wrong sign would."""
    data = _pendulum(6, pushed=0.4, noise=1e-4)
    data = [t.changed(forces=np.interp(t.t + 0.02, t.t, t.forces[:, 0])[:, None]) for t in data]
    doubts = Doubts(la.Trajectories(data), ["theta_dot**2", "cos(theta)"], dissipation="auto")
    assert set(doubts.codes) == {"equations-off", "late-forces"}


def test_a_delay_too_small_to_matter_is_a_note():
    """1 ms of 20 between samples: plain in the likelihood, and of no consequence."""
    data = systems.generate("double_pendulum", noise=0.001, trials=2, duration=6.0, rate=50.0, seed=3)
    data = la.Trajectories([change_one(t, delay=1e-3) for t in data])
    model = la.discover(data, systems.compact_library("double_pendulum"))
    (late,) = findings_of(model, "slight-delay")
    assert (model.fit.status, late.severity) == ("ok", "note")
    assert late.values["delay"] == pytest.approx(1e-3, rel=0.2)
    assert late.values["share"] < 3e-4


def test_scaled_forces():
    doubts = Doubts(*driven(scale=0.7), known={"theta1_dot**2": 1.0})
    wrong = doubts.all("wrong-known-coefficient")
    if wrong:  # the forces, or the coefficient that sets their scale
        assert wrong[0].subject == ("theta1_dot**2",)
        assert wrong[0].values["estimate"] == wrong[0].values["force_factor"] == pytest.approx(0.7, rel=0.05)
    else:
        assert doubts.one("scaled-forces").values["factor"] == pytest.approx(1.0 / 0.7, rel=0.1)


@pytest.mark.thorough
def test_exchanged_forces():
    doubts = Doubts(*driven(swap=True))
    assert [finding.subject for finding in doubts.all("equations-off")] == [("theta1",), ("theta2",)]
    assert doubts.one("swapped-forces").subject == ("theta1", "theta2")


@pytest.mark.parametrize("name", ["double_pendulum", "spherical_pendulum"])
def test_exchanged_forces_leave_more_of_the_weak_form(name):
    """Friction that nobody offered leaves something, too, but no exchange leaves less."""
    system = systems.get(name).with_dissipation({f"{v}**2/2": 0.05 for v in systems.get(name).velocities})
    truth = systems.simulate_truth(system, 2, 6.0, 50.0, 5)
    data = systems.measure(system, truth, systems.noise_std(system, truth, 0.01), seed=5)
    grid = Grid.lay(build_problem(data, Request(systems.compact_library(name))).problem, 20.0)
    exchanged = grid.pushed([t.forces[:, ::-1] for t in data])
    curve = grid.smooth()
    assert np.all(unexplained(grid, curve) < unexplained(exchanged, curve))


def test_a_force_recorded_as_zero_is_no_exchange():
    data, library = driven()
    data = [t.changed(forces=t.forces * [1.0, 0.0]) for t in data[:2]]
    search = find_structure(begin_search(build_problem(la.Trajectories(data), Request(library))))
    assert search.found.equation_error()[0][1] > 0.01
    assert exchanged_forces(search) == []


@pytest.mark.parametrize(
    ("name", "lacking", "noise"),
    [
        ("single_pendulum", "cos(theta)", 0.01),
        ("single_pendulum", "cos(theta)", 0.1),
        ("double_pendulum", "theta1_dot*theta2_dot*cos(theta1-theta2)", 0.1),
        ("cart_spring_pendulum", "x_dot*theta_dot*cos(theta)", 0.01),
    ],
)
@pytest.mark.thorough
def test_a_common_term_that_is_no_candidate_is_named(name, lacking, noise):
    # imitators follow a pendulum without cos(theta) to a tenth of a per cent
    trials, duration = {0.01: (2, 5.0), 0.1: (3, 8.0)}[noise]
    data = systems.generate(name, noise=noise, trials=trials, duration=duration, rate=50.0, seed=2)
    texts = [t.text for t in systems.compact_library(name).terms if t.text != lacking]
    library = la.Library(texts, data.coordinates, angles=systems.get(name).angles)
    doubts = Doubts(data, library, known=systems.get(name).known)
    assert (lacking,) in [finding.subject for finding in doubts.all("missing-term")]


@pytest.mark.parametrize("n", [1, 3, 5, 11])
def test_common_terms_that_are_tried(n):
    names = [f"q{i}" for i in range(n)]
    library = la.Library([*(f"{q}_dot**2" for q in names), *(f"cos({q})" for q in names)], names)
    tried = {t.text for t in common_terms(EulerLagrange(library.terms, library.coordinates), "compact")}
    assert {"q0_dot**2*cos(q0)", "sin(q0)"} <= tried
    assert not tried & {t.text for t in library.terms}
    assert len(tried) < 130


def test_generated_libraries_lack_nothing_common():
    library = la.Library.mechanical(["x", "theta"], angles=["theta"], gyroscopic=True)
    assert not common_terms(EulerLagrange(library.terms, library.coordinates), "standard")


def measured(acceleration, names: list[str], noise: float, drive: float = 0.0) -> la.Trajectories:
    """Three recordings of q̈ = acceleration(q, q̇, f), with forces of two tones each if there is a drive."""
    rng, shape = np.random.default_rng(5), (3, 2, len(names))
    starts, pace, phase = rng.normal(size=shape), rng.uniform(0.5, 3.0, shape), rng.uniform(0.0, 6.0, shape)

    def force(k, t):
        return drive * np.sin(np.multiply.outer(t, pace[k]) + phase[k]).sum(axis=1)

    forcing = force if drive else None
    return record(acceleration, list(starts), names, duration=10.0, noise=noise, forcing=forcing)


def two_masses(q, v, f):
    """A relative damper of 0.4 between masses of 1 and 0.5."""
    spring = 2.0 * (q[0] - q[1]) + 0.4 * (v[0] - v[1])
    return np.array([f[0] - 3.0 * q[0] - spring, 2.0 * (f[1] + spring)])


@pytest.mark.parametrize("offered", [(), ("x_dot**2/2", "y_dot**2/2")])
@pytest.mark.thorough
def test_a_damper_between_two_coordinates_is_named(offered):
    library = la.Library.mechanical(["x", "y"], size="compact")
    doubts = Doubts(measured(two_masses, ["x", "y"], 0.03, 0.8), library, dissipation=offered)
    friction = doubts.one("unmodelled-friction")
    assert friction.subject == ("(x_dot-y_dot)**2/2",)
    assert friction.values["velocities"] == ("x_dot", "y_dot")
    assert friction.values["coefficient"] == pytest.approx(0.4, rel=0.1)


def in_water(q, v, f):
    return f - 9.81 * np.sin(q) - 0.3 * v * np.abs(v)


@pytest.mark.parametrize(
    "offered", [(), pytest.param(("theta_dot**2/2", "abs(theta_dot)"), marks=pytest.mark.thorough)]
)
def test_drag_is_named(offered):
    doubts = Doubts(measured(in_water, ["theta"], 0.03, 2.0), PENDULUM_LIBRARY, dissipation=offered)
    assert doubts.one("unmodelled-friction").subject == ("abs(theta_dot)**3/3",)
    assert not {"late-forces", "scaled-forces", "swapped-forces"} & {*doubts.codes}


@pytest.mark.parametrize(
    ("damping", "code", "status"),
    [(1e-3, "slight-friction", "ok"), (1e-2, "unmodelled-friction", "usable")],
)
def test_friction_too_small_to_matter_is_a_note(damping, code, status):
    """A viscous force of 0.02 % of the forces, and one of 0.2 % of them."""
    data = measured(lambda q, v, f: f - 9.81 * np.sin(q) - damping * v, ["theta"], 0.003, 2.0)
    model = la.discover(data, PENDULUM_LIBRARY)
    (friction,) = findings_of(model, code)
    assert model.fit.status == status
    assert friction.subject == ("theta_dot**2/2",)
    assert friction.values["coefficient"] == pytest.approx(damping, rel=0.1)
    # the share by another way: along the samples, whose velocities are differences
    velocity = [np.gradient(t.q[:, 0], t.t) for t in data]
    size = [
        np.sqrt((np.gradient(v, t.t) ** 2 + (9.81 * np.sin(t.q[:, 0])) ** 2 + t.forces[:, 0] ** 2).mean())
        for v, t in zip(velocity, data, strict=True)
    ]
    share = damping * np.sqrt(np.mean(np.square(velocity))) / np.sqrt(np.mean(np.square(size)))
    assert friction.values["share"] == pytest.approx(share, rel=0.3)


def test_what_explains_little_of_an_equation_error_is_minor():
    data = pendulum(driven=False, viscous=0.05)
    setup = build_problem(data, Request(la.Library(PENDULUM_LIBRARY, ["theta"]), {"theta_dot**2": 0.5}))
    fit = find_structure(begin_search(setup)).found
    whole = float(fit.weights.slack.sum())
    assert is_minor(fit, 0.2 * whole)
    assert not is_minor(fit, 0.3 * whole)
    for k, member in enumerate(fit.structure):
        assert gain_of_terms(fit, [member]) == pytest.approx(fit.z[k] ** 2)
    expected = fit.estimates @ np.linalg.solve(fit.covariance, fit.estimates)
    assert gain_of_terms(fit, fit.structure) == pytest.approx(expected, rel=1e-6)


def test_terms_that_make_the_law_are_never_minor():
    """Where the scale of L is open no term changes the likelihood, and yet they are the forces."""
    data = pendulum(driven=False, viscous=0.05)
    setup = build_problem(data, Request(la.Library(PENDULUM_LIBRARY, ["theta"]), {"theta_dot**2": 0.5}))
    fit = find_structure(begin_search(setup)).found
    rough = replace(fit, weights=replace(fit.weights, slack=np.array([1e12])))
    left, rms = rough.equation_error()
    members = [m for m in fit.structure if fit.problem.terms[m].text == "cos(theta)"]
    assert is_minor(rough, gain_of_terms(rough, members))
    assert not Effects(rough, rms / left, left).minor(members)
    faint = replace(rough, coefficients=1e-6 * rough.coefficients)
    assert Effects(faint, rms / left, left).minor(members)


def test_a_constant_force_is_named():
    def pushed(q, v, f):
        return 0.4 - 9.81 * np.sin(q)

    data = measured(pushed, ["theta"], 0.03)
    doubts = Doubts(data, ["theta_dot**2", "cos(theta)"], known={"theta_dot**2": 0.5})
    missing = doubts.one("missing-term")
    assert (missing.subject, missing.values["free_terms"]) == (("theta",), 2)
    assert missing.values["constant_force"] == "theta"
    assert (
        "the term theta in L is a constant force on that coordinate (force_offset=['theta'])"
        in missing.remedy
    )


def in_a_magnetic_field(q, v, f):
    """L = ½(ẋ² + ẏ²) + 1.5 x ẏ − 2 x² − 3 y² − ½ x⁴."""
    return np.array([1.5 * v[1] - 4.0 * q[0] - 2.0 * q[0] ** 3, -1.5 * v[0] - 6.0 * q[1]])


@pytest.mark.thorough
def test_what_is_linear_in_the_velocities_is_named_where_it_lacks():
    # no structure of the others is near enough to the law for one more term to lead there
    data = measured(in_a_magnetic_field, ["x", "y"], 0.05)
    texts = ["x_dot**2", "y_dot**2", "x_dot*y_dot", "x**2", "y**2", "x*y", "x**4", "y**4"]
    given = {"x_dot**2": 0.5}
    missing = Doubts(data, texts, known=given).one("missing-term")
    assert (missing.subject, missing.values["free_terms"]) == (("x*y_dot",), 5)
    model = la.discover(data, [*texts, "x*y_dot"], known=given)
    assert model.fit.status == "ok"
    found = {t.expression: t for t in model.terms}
    assert set(found) == {"x_dot**2", "y_dot**2", "x**2", "y**2", "x**4", "x*y_dot"}
    assert abs(found["x*y_dot"].coefficient - 1.5) < 4.0 * found["x*y_dot"].standard_error


@pytest.mark.thorough
def test_nothing_lacks_where_no_common_term_is_needed():
    data = systems.generate("double_well", noise=0.05, trials=4, duration=20.0, seed=2)
    library = ["x_dot**2", "x_dot**4", "x**4", "x**2", "x**6"]  # compact libraries stop at x**2
    model = la.discover(data, library, dissipation=["x_dot**2/2", "abs(x_dot)"])
    assert model.fit.status == "ok", model.fit.warnings


@pytest.mark.parametrize("wrong", [0.55, *(pytest.param(x, marks=pytest.mark.thorough) for x in (0.6, 1.0))])
def test_wrong_known_coefficient_is_given_its_value(wrong):
    doubts = Doubts(pendulum(driven=True, viscous=0.0), PENDULUM_LIBRARY, known={"theta_dot**2": wrong})
    found = doubts.one("wrong-known-coefficient")
    assert (found.subject, found.values["given"]) == (("theta_dot**2",), wrong)
    assert found.values["estimate"] == pytest.approx(0.5, rel=0.05)


@pytest.mark.parametrize("rest", [0.0, 3.0])
def test_powers_of_a_coordinate_far_from_its_zero_cancel(rest):
    powers = ["x", "x**2", "x**3", "x**4"]
    starts = [([rest + 1.0], [0.5]), ([rest - 0.4], [1.0])]
    data = record(lambda q, v, f: -(q - rest) - 2.0 * (q - rest) ** 3, starts, ["x"], noise=1e-4)
    model = la.discover(data, la.Library(["x_dot**2", *powers], ["x"]), {"x_dot**2": 0.5})
    assert model.fit.status == "ok"
    cancelling, highest = (findings_of(model, code) for code in ("cancelling-terms", "highest-power"))
    if not rest:
        assert not [*cancelling, *highest]
        return
    # V = (x − 3)²/2 + (x − 3)⁴/2, in powers of x
    expected = {"x": 57.0, "x**2": -27.5, "x**3": 6.0, "x**4": -0.5}
    found = {term.expression: term.coefficient for term in model.terms if not term.known}
    assert found == pytest.approx(expected, rel=0.05)
    q = data[0].q[:, 0]
    swings = [np.std(n * expected[p] * q ** (n - 1)) for n, p in enumerate(powers, start=1)]
    whole = np.std((q - rest) + 2.0 * (q - rest) ** 3)
    assert [f.subject for f in cancelling] == [("x**2", "x**3", "x**4")]
    assert cancelling[0].values["factor"] == pytest.approx(max(swings) / whole, rel=0.3)
    assert [f.subject for f in highest] == [("x**4",)]


def geared(ripple: float):
    """A pendulum behind a gear of twelve teeth."""
    return lambda q, v, f: f - 9.81 * np.sin(q) + ripple * np.sin(12.0 * q + 1.0)


def test_a_machine_whose_equations_hold_to_some_per_cent_is_usable():
    data = measured(geared(0.4), ["theta"], 0.003, 2.0)
    model = la.discover(data, PENDULUM_LIBRARY)
    assert model.fit.status == "usable"
    assert {f.code for f in model.fit.findings if f.severity == "warning"} == {"equations-off"}
    (found,) = findings_of(model, "forecasts")
    result = model.validate(data, horizon=found.values["horizon"])
    assert found.values["error"] == pytest.approx(float(result.rms_over_std.max()), rel=0.3)
    worst = max(float(part.rms[0] / result.std[0]) for part in result.by_trial().values())
    assert found.values["worst"] == pytest.approx(worst, rel=0.3)
    assert found.values["horizon"] <= 0.4 * min(t.duration for t in data)
    again = la.LagrangianModel.from_dict(model.to_dict())
    assert again.fit == model.fit


@pytest.mark.thorough
def test_the_error_of_trials_left_out_is_that_of_fits_without_them():
    data = measured(geared(0.4), ["theta"], 0.003, 2.0)
    model = la.discover(data, PENDULUM_LIBRARY)
    (found,) = findings_of(model, "forecasts")
    horizon, terms = found.values["horizon"], [t.expression for t in model.terms]
    window = max(SELECTION.window * horizon, 8 * data.sampling_interval)
    errors = []
    for name in data.names:
        rest = la.discover(data.select([other for other in data.names if other != name]), terms)
        assert [t.expression for t in rest.terms] == terms
        result = rest.validate(data.select(name), horizon=horizon, window=window)
        errors.append(float(result.rms_over_std[0]))
    assert found.values["worst_left_out"] == pytest.approx(max(errors), rel=0.3)
    assert found.values["left_out"] == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=0.3)


@pytest.mark.parametrize(("error", "code"), [(0.19, "forecasts"), (0.21, "forecasts-fail")])
def test_the_error_of_trials_left_out_decides_and_is_stated(monkeypatch, error, code):
    monkeypatch.setattr(verdict, "followed", lambda *_: Followed(0.5, 0.02, 0.03, 3))
    monkeypatch.setattr(verdict, "left_out", lambda *_: (error, 0.4))
    (found,) = verdict._forecasts(None, 1.0)
    assert found.code == code
    assert f"left out of the fit are off by {100 * error:.0f} % of the spread" in str(found)


@pytest.mark.thorough
def test_a_machine_that_free_runs_do_not_follow_is_doubtful():
    model = la.discover(measured(geared(6.0), ["theta"], 0.003, 2.0), PENDULUM_LIBRARY)
    assert model.fit.status == "doubtful"
    assert not findings_of(model, "forecasts")


@pytest.mark.thorough
def test_slow_sampling():
    data = systems.generate("double_pendulum", noise=0.01, trials=3, duration=20.0, rate=3.0, seed=3)
    assert "looks-like-noise" in Doubts(data, systems.compact_library("double_pendulum")).codes


def test_an_angle_that_was_not_declared():
    t = np.linspace(0.0, 20.0, 2001)
    turning = 5.0 * t + np.sin(t)
    wrapped = (turning + np.pi) % (2 * np.pi) - np.pi
    data = la.Trajectory(t, wrapped, coordinates=["theta"])
    doubts = Doubts(data, ["theta_dot**2", "cos(theta)"], known={"theta_dot**2": 0.5})
    turning = doubts.one("undeclared-angle")
    assert turning.subject == ("theta",)
    assert turning.values["jumps"] == np.sum(np.abs(np.diff(wrapped)) > np.pi)


@pytest.mark.thorough
def test_angles_that_were_taken_for_positions():
    t = np.arange(0.0, 12.0, 0.02)
    swing = solve_ivp(lambda _, y: [y[1], -9.81 * np.sin(y[0])], (0, 12), [2.9, 0.0], t_eval=t, rtol=1e-9)
    noisy = swing.y[0] + 0.01 * np.random.default_rng(3).standard_normal(t.size)
    candidates, known = ["theta_dot**2", "theta**2", "theta**4"], {"theta_dot**2": 0.5}
    model = la.discover(la.Trajectory(t, noisy, coordinates=["theta"]), candidates, known)
    found = {finding.code: finding for finding in model.fit.findings}
    assert found["missing-term"].subject == ("cos(theta)",)
    assert found["missing-term"].values["angles"] == ("theta",)
    assert found["missing-term"].remedy.endswith("; or, if theta is an angle, declare it: angles=['theta']")
    assert found["perhaps-angle"].subject == ("theta",)
    assert found["perhaps-angle"].severity == "note"
    # another name is no reason to think of an angle, and an angle that was declared none either
    for name, texts in (("x", ["x_dot**2", "x**2", "x**4"]), ("theta", ["theta_dot**2", "cos(theta)"])):
        other = la.discover(la.Trajectory(t, noisy, coordinates=[name]), texts, {texts[0]: 0.5})
        assert "perhaps-angle" not in [finding.code for finding in other.fit.findings]


def test_an_angle_that_turns_no_term_is_not_asked_about_if_it_was_declared() -> None:
    """The angle of an orbit occurs in no candidate, and that of small swings in no cosine."""
    t = np.arange(0.0, 8.0, 0.02)
    q = 0.1 * np.cos(3.0 * t) + 1e-3 * np.random.default_rng(0).standard_normal(t.size)
    data = la.Trajectory(t, q, coordinates=["phi"])
    for angles, asked in (([], True), (["phi"], False)):
        library = la.Library(["phi_dot**2", "phi**2"], ["phi"], angles=angles)
        model = la.discover(data, library, {"phi_dot**2": 0.5})
        assert ("perhaps-angle" in {finding.code for finding in model.fit.findings}) is asked


def test_an_angle_in_degrees():
    data = changed(pendulum(driven=False), q=np.rad2deg)
    degrees = Doubts(data, PENDULUM_LIBRARY, known={"theta_dot**2": 0.5}).one("angle-in-degrees")
    assert degrees.subject == ("theta",)
    assert degrees.values["span"] == pytest.approx(max(np.ptp(t.q) for t in data), rel=0.05)


def test_a_wheel_that_turns_is_not_in_degrees_if_its_simulations_follow():
    """Many turns alone do not tell; the pendulum above in degrees is not followed."""
    t = np.arange(0.0, 8.0, 0.02)
    noise = np.random.default_rng(0).normal(0.0, 1e-3, t.size)
    wheel = la.Trajectory(t, t**2 + noise, forces=np.full(t.size, 2.0), coordinates=["phi"])
    library = la.Library(["phi_dot**2", "cos(phi)"], ["phi"], angles=["phi"])
    search = find_structure(begin_search(build_problem(wheel, Request(library))))
    assert np.ptp(wheel.q) > 4.0 * np.pi
    assert perhaps_degrees(search.found, 2.0, np.array([0.01]), []) == []
    # an equation that is off by more than its forces explains nothing, whatever a simulation does
    assert [f.code for f in perhaps_degrees(search.found, 2.0, np.array([1.5]), [])] == ["angle-in-degrees"]


def test_small_swings_in_degrees_nearly_have_the_law_of_a_spring():
    t = np.arange(0.0, 6.0, 0.02)
    swing = 40.0 * np.cos(2.0 * t) + np.random.default_rng(0).normal(0.0, 0.1, t.size)
    library = la.Library(["phi_dot**2", "phi**2", "cos(phi)"], ["phi"], angles=["phi"])
    data = la.Trajectory(t, swing, coordinates=["phi"])
    found = find_structure(
        begin_search(build_problem(data, Request(library, known={"phi_dot**2": 0.5})))
    ).found
    (degrees,) = perhaps_degrees(found, np.pi, np.array([0.02]), [])
    assert (degrees.code, degrees.subject) == ("angle-in-degrees", ("phi",))
    # with another cause, the law may be that of a real spring
    assert perhaps_degrees(found, np.pi, np.array([0.02]), [degrees]) == []


def test_rivals_come_with_the_experiment_that_separates_them():
    data = changed(pendulum(driven=False), q=lambda q: 0.02 * q)
    library = ["theta_dot**2", "cos(theta)", "cos(2*theta)", "theta**2"]
    rival = Doubts(data, library, known={"theta_dot**2": 0.5}).all("competing-structures")[0]
    assert rival.subject != rival.values["others"] != ()
    assert {*rival.subject, *rival.values["others"]} <= {*library}
    state = dict(zip(rival.values["at_names"], rival.values["at_values"], strict=True))
    assert list(state) == ["theta", "theta_dot"]
    reach = max(np.abs(t.q).max() for t in data)
    assert abs(state["theta"]) > 1.5 * reach  # farther out than recorded


def test_kinetic_bases_hold_every_coordinate():
    data = systems.generate("spherical_pendulum", noise=0.0, trials=2, duration=5.0, seed=0)
    library = systems.large_library("spherical_pendulum")
    setup = build_problem(data, Request(library))
    grid = Grid.lay(setup.problem, setup.scales.per_second)
    bases = kinetic_bases(grid, setup.scales.smooth)
    texts = [{setup.problem.terms[int(setup.problem.free[m])].text for m in base} for base in bases]
    assert {"theta_dot**2", "phi_dot**2*sin(theta)**2"} in texts
    assert all(
        any("theta_dot**2" in t for t in base) and any("phi_dot**2" in t for t in base) for base in texts
    )


def test_free_runs_tell_a_right_model_from_a_wrong_one():
    data = pendulum(driven=False)
    setup = build_problem(data, Request(la.Library(PENDULUM_LIBRARY, ["theta"]), {"theta_dot**2": 0.5}))
    found = find_structure(begin_search(setup)).found
    right = forecast_error(found, 1.0)
    wrong = found.coefficients * np.where(setup.problem.is_known, 1.0, 0.5)
    assert forecast_error(replace(found, coefficients=wrong), 1.0) > 3.0 * right


@pytest.mark.parametrize("more", [-10.0, -2.0, 10.0])
def test_a_search_begun_anew_has_to_find_something_likelier(more):
    setup = build_problem(pendulum(viscous=0.0), Request(la.Library(PENDULUM_LIBRARY, ["theta"])))
    search = find_structure(begin_search(setup))
    before = replace(search.found, evidence=search.found.evidence + more)
    assert (begun_anew(search.now(before), before.grid) is None) == (more > -5.0)  # 2 is chance


@pytest.mark.parametrize(
    ("candidates", "known", "named", "not_named"),
    [
        (["cos(theta1)", "cos(theta2)"], {"theta1_dot**2": 2.0}, "wrong-known-coefficient", "missing-term"),
        (["cos(theta1)"], {"theta1_dot**2": 1.0}, "missing-term", "wrong-known-coefficient"),
    ],
)
@pytest.mark.thorough
def test_the_likelier_of_a_wrong_coefficient_and_a_missing_term_is_named(candidates, known, named, not_named):
    data = systems.generate("double_pendulum", noise=0.01, trials=2, duration=6.0, rate=50.0, seed=0)
    kinetic = [t.text for t in systems.compact_library("double_pendulum") if "_dot" in t.text]
    doubts = Doubts(data, [*kinetic, *candidates], known=known)
    subject = {"missing-term": "cos(theta2)", "wrong-known-coefficient": "theta1_dot**2"}[named]
    assert doubts.one(named).subject == (subject,)
    assert not_named not in doubts.codes


# ------------------------------------------------------------- scales of the modes of a linear motion
CHAIN = np.array([[20.0, -10.0, 0.0], [-10.0, 20.0, -10.0], [0.0, -10.0, 20.0]])  # three masses between walls


def chain(n: int, forces=None, **known: float):
    """Findings and law of springs and unit masses, with every quadratic term as a candidate."""
    names = ["x", "y", "z"][:n]
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    texts = [f"{a}{dot}**2" for dot in ("_dot", "") for a in names] + [f"{a}**4" for a in names]
    texts += [f"{a}{dot}*{b}{dot}" for dot in ("_dot", "") for a, b in pairs]

    def pull(q, v, f):
        return -CHAIN[:n, :n] @ q + (0.0 if f is None else f)

    rng = np.random.default_rng(5)
    starts = [(rng.uniform(-1.0, 1.0, n), rng.uniform(-1.0, 1.0, n)) for _ in range(3)]
    data = record(pull, starts, names, forcing=forces)
    return la.discover(data, la.Library(texts, names), known={f"{k}**2": c for k, c in known.items()})


def push(k, t):
    return 3.0 * np.sin(2.1 * t + k) + 3.0 * np.cos(3.7 * t - k) + 2.0 * np.sin(5.5 * t)


@pytest.mark.parametrize(
    ("n", "along", "known", "scales"),
    [
        (2, None, {"x_dot": 0.5}, 1),  # a known coefficient fixes one of the two
        (2, None, {"x_dot": 0.5, "y_dot": 0.5}, 0),
        pytest.param(3, None, {"x_dot": 0.5}, 2, marks=pytest.mark.thorough),
        # a force on one mass drives all modes, in the middle of the chain two of them
        pytest.param(3, [1.0, 0.0, 0.0], {}, 0, marks=pytest.mark.thorough),
        pytest.param(3, [0.0, 1.0, 0.0], {}, 1, marks=pytest.mark.thorough),
        (2, [1.0, 1.0], {}, 1),  # forces on both, in the direction of one mode
    ],
)
def test_scales_of_modes_that_nothing_fixes(n, along, known, scales):
    forces = None if along is None else lambda k, t: np.outer(push(k, t), along)
    model = chain(n, forces, **known)
    found = findings_of(model, "mode-scale")
    assert [(f.severity, f.values["open"], f.values["modes"]) for f in found] == [("note", scales, n)] * (
        scales > 0
    )
    # whichever law it is, the frequencies are right
    modes = model.linearise(np.zeros(n)).modes
    truth = np.sqrt(np.linalg.eigvalsh(CHAIN[:n, :n]))
    frequencies = [mode.natural_frequency for mode in modes]
    np.testing.assert_allclose([f.value for f in frequencies], truth, rtol=2e-3)
    assert all(abs(f.value - w) < 4.5 * f.standard_error for f, w in zip(frequencies, truth, strict=True))


@pytest.mark.parametrize(("size", "is_open"), [(0.05, True), (1.0, False)])
def test_large_motions_fix_the_scales(size, is_open):
    system = systems.get("double_pendulum")
    rng = np.random.default_rng(1)
    starts = [(size * rng.uniform(-1.0, 1.0, 2), size * rng.uniform(-1.0, 1.0, 2)) for _ in range(3)]
    still = np.zeros(2)
    data = record(
        lambda q, v, f: system.acceleration(q, v, still),
        starts,
        system.coordinates,
        noise=0.01 * size,
        rate=100.0,
    )
    known = {"cos(theta1)": system.lagrangian["cos(theta1)"]}
    model = la.discover(data, systems.compact_library("double_pendulum"), known=known)
    assert bool(findings_of(model, "mode-scale")) is is_open
