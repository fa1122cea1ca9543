import copy
import dataclasses
import itertools
import pickle
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import InputError

NAN = float("nan")


def make(n_times=6, n_dof=2, start=0.0, name="", forces=None, seed=0):
    rng = np.random.default_rng(seed)
    t = start + np.cumsum(rng.uniform(0.01, 1.0, n_times))
    return Trajectory(t, rng.normal(size=(n_times, n_dof)), forces, [f"x{i}" for i in range(n_dof)], name)


# --- one trajectory ---------------------------------------------------------------------------------


def test_arrays_are_read_only_float64_copies():
    t, q, forces = np.arange(4), np.arange(8, dtype=np.float32).reshape(4, 2), [[0, 1]] * 4
    trajectory = Trajectory(t, q, forces)
    for array in (trajectory.t, trajectory.q, trajectory.forces):
        assert array.dtype == np.float64
        assert array.flags.c_contiguous
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 5.0
    t[0] = q[0, 0] = 99
    assert trajectory.t[0] == 0.0
    assert trajectory.q[0, 0] == 0.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        trajectory.t = t


def test_properties_and_defaults():
    trajectory = Trajectory([0.0, 0.5, 2.0], [[1.0, NAN], [2.0, 3.0], [NAN, NAN]])
    assert (trajectory.n_times, trajectory.n_dof, trajectory.duration) == (3, 2, 2.0)
    assert trajectory.coordinates == ("q1", "q2")
    assert trajectory.name == ""
    assert trajectory.forces is None
    assert trajectory.n_samples == 3
    assert not trajectory.driven
    assert not dataclasses.replace(trajectory, forces=np.zeros((3, 2))).driven
    assert dataclasses.replace(trajectory, forces=np.eye(3, 2)).driven


def test_one_dimension_is_one_coordinate():
    trajectory = Trajectory([0, 1], [0.1, 0.2], [1.0, 2.0], coordinates=["θ"])
    assert trajectory.q.shape == trajectory.forces.shape == (2, 1)


@pytest.mark.parametrize(
    "q",
    [
        [None, 1.0, 2],
        [Fraction(1, 2), 1.0, np.float32(2)],
        np.ma.masked_array([7.0, 1.0, 2.0], mask=[True, False, False]),
        np.ma.masked_array([7, 1, 2], mask=[True, False, False]),
        pd.Series([NAN, 1.0, 2.0]),
    ],
)
def test_other_containers_of_numbers(q):
    trajectory = Trajectory([0, 1, 2], q)
    np.testing.assert_array_equal(trajectory.q[1:, 0], [1.0, 2.0])


def test_pickle_and_copy_keep_everything_read_only():
    original = make(forces=np.ones((6, 2)), name="run")
    for twin in (pickle.loads(pickle.dumps(original)), copy.deepcopy(original)):
        assert not twin.q.flags.writeable
        assert twin.name == "run"
        assert Trajectories([twin]).digest() == Trajectories([original]).digest()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (dict(t=[]), "t is empty"),
        (dict(t=[[0, 1, 2]]), "t has shape"),
        (dict(t=3.0), "t has shape"),
        (dict(t=[0, 1, NAN]), r"t\[2\] is nan"),
        (dict(t=[0, np.inf, 2]), r"t\[1\] is inf"),
        (dict(t=[0, 1, 1]), r"t\[2\] = 1.0 repeats"),
        (dict(t=[0, 2, 1]), r"t\[2\] = 1.0 goes backwards from t\[1\] = 2.0"),
        (dict(t=["0", "1", "2"]), "convert text"),
        (dict(t=np.array(["2024-01-01", "2024-01-02", "2024-01-03"], "M8[D]")), "times in seconds"),
        (dict(t=[0, 1, Decimal(2)]), r"t\[2\] is Decimal\('2'\); a real number"),
        (dict(t=[0, 1, 10**400]), "cannot be converted"),
        (dict(q=[1, 2]), "q has 2 rows, but t has 3 times"),
        (dict(q=[[1, 2, 3], [4, 5, 6]]), "looks transposed"),
        (dict(q=np.zeros((3, 1, 1))), "q has shape"),
        (dict(q=np.zeros((3, 0))), "no columns"),
        (dict(q=[[1, 2], [3], [4]]), "rectangular"),
        (dict(q=[0, np.inf, 1]), r"q\[1, 0\] is infinite; use NaN"),
        (dict(q=[0, 1j, 1]), "complex128; real numbers"),
        (dict(q=[True, False, True]), "bool; real numbers"),
        (dict(q=[0.0, "x", None]), "real number"),
        (dict(q=np.array([0.0, True, 1], dtype=object)), r"q\[1\] is True"),
        (dict(forces=[1, NAN, 1]), r"forces\[1, 0\] is nan; forces must be finite"),
        (dict(forces=[1, 2]), "forces has 2 rows"),
        (dict(forces=np.zeros((3, 2))), r"forces has 2 column\(s\), but q has 1"),
        (dict(coordinates=["a", "b"]), r"q has 1 column\(s\), but there are 2 coordinate"),
        (dict(coordinates=["sin"]), "function"),
        (dict(coordinates=[]), "is empty"),
        (dict(name=3), "name of a trajectory"),
    ],
)
def test_bad_input_is_refused_in_one_line(arguments, message):
    good = dict(t=[0, 1, 2], q=[0.0, 0.1, 0.2])
    with pytest.raises(InputError, match=message) as caught:
        Trajectory(**(good | arguments))
    assert "\n" not in str(caught.value)


def test_messages_name_the_trajectory():
    with pytest.raises(InputError, match=r"trajectory 'run 7': t\[1\] = 0.0 repeats"):
        Trajectory([0, 0], [1, 2], name="run 7")


# --- several ----------------------------------------------------------------------------------------


def test_sequence_of_different_lengths():
    runs = Trajectories([make(6, name="a"), make(9, start=50.0, seed=1, name="b"), make(5, seed=2)])
    assert len(runs) == runs.n_trajectories == 3
    assert runs.names == ("a", "b", "2")
    assert [item.n_times for item in runs] == [6, 9, 5]
    assert runs[-1].n_times == 5
    assert runs.coordinates == ("x0", "x1")
    assert runs.n_dof == 2
    assert runs.n_samples == 40
    assert runs.duration == pytest.approx(sum(item.duration for item in runs))
    assert isinstance(runs[1:], Trajectories)
    assert runs[1:].names == ("b", "2")
    assert not runs.driven
    assert Trajectories([runs[0], make(forces=np.eye(6, 2), name="c")]).driven


def test_numbered_names_do_not_clash():
    assert Trajectories([make(name="1"), make(seed=1)]).names == ("1", "1'")


def test_coerce():
    one = make()
    runs = Trajectories.coerce(one)
    assert Trajectories.coerce(runs) is runs
    assert list(Trajectories.coerce((one,))) == [one]
    for bad in (None, 3, (one.t, one.q), {"a": one}):
        with pytest.raises(InputError, match="Trajectory"):
            Trajectories.coerce(bad)
    with pytest.raises(InputError, match="at least one"):
        Trajectories.coerce([])


def test_different_coordinates_and_equal_names_are_refused():
    with pytest.raises(InputError, match="trajectory 1 has the coordinates x0, but trajectory 0 has x0, x1"):
        Trajectories([make(), make(n_dof=1)])
    with pytest.raises(InputError, match="two trajectories are called 'a'"):
        Trajectories([make(name="a"), make(name="a")])


@pytest.mark.parametrize(
    ("what", "held"),
    [
        (1, "d"), ("2", "cd"), ("25%", "d"), ("1%", "d"), ("60%", "cd"), ("99%", "bcd"), ("a", "a"),
        (" a, c", "ac"), (["b", -1], "bd"), (slice(1, None, 2), None), (0, None), (4, None), ("0", None),
        ("0%", None), ("100%", None), ("nan%", None), ("a,a", None), ("e", None), ("", None), ("abc", None),
        ("a,b,c,d", None), ([], None), (0.25, None), (True, None), (None, None), (b"a", None),
    ],
)  # fmt: skip
def test_hold_out(what, held):
    runs = Trajectories([Trajectory([0.0, 1.0], [0.0, k], name=name) for k, name in enumerate("abcd")])
    if held is None:
        with pytest.raises(InputError):
            runs.hold_out(what)
        return
    fitted, out = runs.hold_out(what)
    assert out.names == tuple(held)
    assert fitted.names == tuple(name for name in "abcd" if name not in held)
    assert out[0] is runs.select(held[0])[0]


def test_the_end_of_a_single_trajectory_is_held_out():
    t = np.arange(101.0)
    angle = np.mod(0.1 * t, 2.0 * np.pi)
    run = Trajectories([Trajectory(t, angle, forces=t, coordinates=["x"], name="run")]).unwrap(["x"])
    fitted, out = run.hold_out("20%")
    assert (fitted.names, out.names) == (("run",), ("run (end)",))
    assert (fitted[0].n_times, out[0].n_times) == (81, 20)
    np.testing.assert_array_equal(np.concatenate([fitted[0].t, out[0].t]), t)
    np.testing.assert_array_equal(np.concatenate([fitted[0].forces, out[0].forces])[:, 0], t)
    assert fitted.wraps_removed == run.wraps_removed
    with pytest.raises(InputError, match="leave too few"):
        run.hold_out("1%")


def test_select():
    runs = Trajectories([make(name=name, seed=k) for k, name in enumerate(("run-a", "run-b", ""))])
    assert runs.select(["run-b", 0]).names == ("run-b", "run-a")
    assert runs.select(-1).names == ("2",)
    assert runs.select("2")[0] is runs[2]
    assert runs.select(np.array([1, 0])).names == ("run-b", "run-a")
    for bad, message in [
        ("run_a", "did you mean 'run-a'"),
        (3, "no trajectory number 3"),
        (-4, "no trajectory number -4"),
        ([0, "run-a"], "selected twice"),
        ([], "no trajectory selected"),
        ([1.0], "by name or number"),
        ([True], "by name or number"),
    ]:
        with pytest.raises(InputError, match=message):
            runs.select(bad)


def test_digest_depends_on_the_data_only():
    base = make(name="a")
    digest = Trajectories([base]).digest()
    assert Trajectories([make(name="b")]).digest() == digest
    assert Trajectories([make(forces=np.zeros((6, 2)))]).digest() == digest
    others = [
        dataclasses.replace(base, t=base.t + 1.0),
        dataclasses.replace(base, q=base.q * 2.0),
        dataclasses.replace(base, forces=np.ones((6, 2))),
        dataclasses.replace(base, coordinates=("x0", "y")),
    ]
    digests = {Trajectories([other]).digest() for other in others} | {Trajectories([base, make()]).digest()}
    assert len(digests | {digest}) == 6


def test_digest_knows_one_nan_and_one_zero():
    odd = np.array([np.float64(NAN), 0.0]).view(np.uint64)
    odd[0] |= np.uint64(1)
    a = Trajectory([0, 1], odd.view(np.float64))
    b = Trajectory([0, 1], [-NAN, -0.0])
    assert Trajectories([a]).digest() == Trajectories([b]).digest()


# --- unwrapping -------------------------------------------------------------------------------------


def test_unwrap_restores_a_whirling_angle_with_gaps():
    t = np.linspace(0.0, 20.0, 400)
    true = 2.0 * t + np.sin(3 * t)
    wrapped = (true + np.pi) % (2 * np.pi) - np.pi
    other = np.cos(t) * 10.0
    wrapped[[0, 50, 51, 52, 399]] = NAN
    runs = Trajectories([Trajectory(t, np.column_stack([wrapped, other]), coordinates=["theta", "x"])])
    assert runs.wraps_removed == {"theta": 0, "x": 0}
    result = runs.unwrap("theta")
    valid = np.isfinite(wrapped)
    np.testing.assert_allclose(result[0].q[valid, 0], true[valid], atol=1e-12)
    np.testing.assert_array_equal(np.isnan(result[0].q[:, 0]), ~valid)
    np.testing.assert_array_equal(result[0].q[:, 1], other)
    assert result.wraps_removed == {"theta": 6, "x": 0}
    assert runs.wraps_removed["theta"] == 0


def test_wraps_are_counted_per_trajectory_and_survive_selection():
    angle = [3.0, -3.0, 3.0]
    runs = Trajectories([Trajectory([0, 1, 2], angle, name="a"), Trajectory([0, 1], [0.0, 1.0], name="b")])
    result = runs.unwrap(["q1"])
    assert result.wraps_removed == {"q1": 2}
    assert result.select("b").wraps_removed == {"q1": 0}
    assert result[:1].wraps_removed == {"q1": 2}
    assert result.unwrap(["q1"]).wraps_removed == {"q1": 2}
    assert result.unwrap([]).wraps_removed == {"q1": 2}


@pytest.mark.parametrize(
    ("jump", "count"), [(3.0, 0), (np.pi, 0), (-np.pi, 0), (3.2, 1), (-3.2, 1), (13.0, 1)]
)
def test_jumps_larger_than_pi_are_wraps(jump, count):
    result = Trajectories([Trajectory([0, 1], [0.5, 0.5 + jump])]).unwrap(["q1"])
    assert result.wraps_removed == {"q1": count}
    assert abs(np.diff(result[0].q[:, 0])[0]) <= np.pi + 1e-12


def test_unwrap_names_unknown_angles():
    runs = Trajectories([make()])
    with pytest.raises(InputError, match="angle 'theta' is not a coordinate; the coordinates are x0, x1"):
        runs.unwrap(["theta"])
    with pytest.raises(InputError, match="occurs twice"):
        runs.unwrap(["x0", "x0"])


angles = st.floats(-1e4, 1e4) | st.sampled_from([0.0, np.pi, -np.pi, 2 * np.pi, 3 * np.pi, NAN])


@given(arrays(np.float64, st.integers(1, 40), elements=angles))
def test_unwrapping_is_idempotent_and_changes_by_full_turns(angle):
    once = Trajectories([Trajectory(np.arange(angle.size), angle)]).unwrap(["q1"])
    twice = once.unwrap(["q1"])
    assert twice.digest() == once.digest()
    assert twice.wraps_removed == once.wraps_removed
    turns = (once[0].q[:, 0] - angle) / (2 * np.pi)
    valid = np.isfinite(turns)
    np.testing.assert_allclose(turns[valid], np.round(turns[valid]), atol=1e-9)
    np.testing.assert_array_equal(valid, np.isfinite(angle))
    if valid.sum() <= 16:  # longer ones may be noisy, see test_noise_is_no_wrap
        assert np.all(np.abs(np.diff(once[0].q[valid, 0])) <= np.pi + 1e-8)


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=30))
def test_times_are_accepted_exactly_when_they_increase(times):
    increasing = all(b > a for a, b in itertools.pairwise(times))
    if increasing:
        assert Trajectory(times, np.zeros(len(times))).n_times == len(times)
    else:
        with pytest.raises(InputError, match=r"repeats|backwards"):
            Trajectory(times, np.zeros(len(times)))


@pytest.mark.parametrize("noise", [0.3, 0.9])
def test_noise_is_no_wrap(noise):
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 20.0, 2001)
    slow, turning = 1.5 * np.sin(t), 3.0 * t
    for truth, wrapped in ((slow, False), (turning, False), (turning, noise < 0.5)):
        angle = truth + noise * rng.standard_normal(t.size)
        stored = (angle + np.pi) % (2 * np.pi) - np.pi if wrapped else angle
        found = Trajectories([Trajectory(t, stored, coordinates=["theta"])]).unwrap("theta")[0].q[:, 0]
        assert np.abs(found - angle).max() < 1e-9
