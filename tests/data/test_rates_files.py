"""Measured velocities and accelerations in files, frames, bags and on the command line."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from helpers import with_rates
from leastaction import InputError, Trajectories, Trajectory, io, systems
from leastaction.cli import program
from leastaction.data.formats.bags import read_mcap

CSV = "t,a,b,gyro,acc\n" + "\n".join(f"{k},{k / 8},{-k},{0.125 if k != 2 else ''},{k * k}" for k in range(6))
GIVEN = {"velocities": {"a": "gyro"}, "accelerations": {"b": "acc"}}


def check(item: Trajectory) -> None:
    assert item.velocities is not None
    assert item.accelerations is not None
    np.testing.assert_array_equal(item.velocities[:, 0], [0.125, 0.125, np.nan, 0.125, 0.125, 0.125])
    np.testing.assert_array_equal(item.accelerations[:, 1], np.arange(6.0) ** 2)
    assert np.isnan(item.velocities[:, 1]).all()
    assert np.isnan(item.accelerations[:, 0]).all()
    assert item.forces is None


@pytest.fixture
def table() -> pd.DataFrame:
    from io import StringIO

    return pd.read_csv(StringIO(CSV))


def test_every_kind_of_file_and_frame(tmp_path, table):
    (tmp_path / "run.csv").write_text(CSV)
    table.to_parquet(tmp_path / "run.parquet")
    np.savez(tmp_path / "run.npz", **{name: table[name].to_numpy() for name in table})
    savemat = pytest.importorskip("scipy.io").savemat
    savemat(tmp_path / "run.mat", {name: table[name].to_numpy() for name in table})
    for suffix in ("csv", "parquet", "npz", "mat"):
        path = tmp_path / f"run.{suffix}"
        reader = getattr(io, f"read_{suffix}")
        for read in (reader, io.read, io.read_many):
            check(read(path, ["a", "b"], **GIVEN)[0])
    check(io.from_frame(table, ["a", "b"], **GIVEN)[0])
    # in the sequence of the coordinates, as forces are given
    check(io.from_frame(table, ["a", "b"], velocities=["gyro"], accelerations=[None, "acc"])[0])
    assert io.read_csv(tmp_path / "run.csv", ["a"])[0].velocities is None


def test_matrix_of_coordinates_beside_vectors_of_rates(tmp_path, table):
    q = table[["a", "b"]].to_numpy()
    np.savez(tmp_path / "run.npz", t=table["t"], q=q, gyro=table["gyro"], acc=table["acc"])
    check(io.read_npz(tmp_path / "run.npz", ["a", "b"], **GIVEN)[0])


def test_several_files_and_trials(tmp_path):
    for name in ("one", "two"):
        (tmp_path / f"{name}.csv").write_text(CSV)
    for item in io.read([tmp_path / "one.csv", tmp_path / "two.csv"], ["a", "b"], angles=["b"], **GIVEN):
        check(item)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (dict(velocities={"c": "gyro"}), "velocity of 'c' belongs to no coordinate"),
        (dict(velocities=["gyro", "acc", "t"]), "3 velocity columns for 2 coordinate"),
        (dict(velocities=7), "velocities must be names of columns"),
        (dict(accelerations={"a": 7}), "acceleration of a must be the name of a column"),
        (dict(velocities={"a": "gyr"}), r"no column 'gyr' \(velocity of a\).*did you mean 'gyro'"),
        (dict(velocities={"a": "b"}), "'b' is used twice, as coordinate b and as velocity of a"),
        (dict(velocities=["gyro", "gyro"]), "'gyro' is used twice, as velocity of a and as velocity of b"),
        (
            dict(velocities=["gyro"], accelerations=["gyro"]),
            "'gyro' is used twice, as velocity of a and as acceleration of a",
        ),
        (dict(forces={"a": "acc"}, accelerations={"b": "acc"}), "as force on a and as acceleration of b"),
    ],
)
def test_wrong_columns_are_refused(tmp_path, given, text):
    (tmp_path / "run.csv").write_text(CSV)
    with pytest.raises(InputError, match=text):
        io.read_csv(tmp_path / "run.csv", ["a", "b"], **given)


def test_infinite_samples_are_refused_where_they_stand(tmp_path):
    (tmp_path / "run.csv").write_text(CSV.replace("3,0.375,-3,0.125", "3,0.375,-3,inf"))
    with pytest.raises(
        InputError, match=r"line 5, column 'gyro': the value is infinite.*leave the cell empty"
    ):
        io.read_csv(tmp_path / "run.csv", ["a", "b"], **GIVEN)


def test_what_is_written_reads_back(tmp_path):
    t = np.linspace(0.0, 1.0, 7)
    rates = np.column_stack([np.cos(t), np.full(7, np.nan)])
    one = Trajectory(t, np.sin([t, 2 * t]).T, np.ones((7, 2)), ["a", "b"], "one", velocities=rates)
    two = Trajectory(t, np.sin([t, 2 * t]).T, None, ["a", "b"], "two", accelerations=rates[:, ::-1])
    path = io.write_csv(tmp_path / "run.csv", [one, two])
    header = path.read_text().splitlines()[0]
    assert header == "trial,t,a,b,a_force,b_force,a_dot,b_ddot"
    forces, given = ["a_force", "b_force"], {"velocities": ["a_dot"], "accelerations": {"b": "b_ddot"}}
    again = io.read_csv(path, ["a", "b"], forces=forces, **given)
    assert again.digest() == Trajectories([one, two.changed(forces=np.zeros((7, 2)))]).digest()
    assert again[1].velocities is not None  # a column of empty cells
    assert np.isnan(again[1].velocities).all()


# ------------------------------------------------------------------------------ command line
@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    """A file with positions, velocities and accelerations; and the folder."""
    folder = tmp_path_factory.mktemp("rates")
    system = systems.get("single_pendulum")
    truth = systems.simulate_truth(system, trials=2, duration=5.0, seed=0)
    data = with_rates(system, truth, 0.05, velocity=0.01, acceleration=0.05)
    io.write_csv(folder / "run.csv", data)
    (folder / "terms.txt").write_text("theta_dot**2\ncos(theta)")
    return folder


def invoke(*arguments) -> tuple[int, str]:
    result = CliRunner().invoke(program, [str(a) for a in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.output


def test_discover_and_validate_take_rates(pendulum):
    common = [pendulum / "run.csv", "--coordinates", "theta", "--forces", "theta_force"]
    rates = ["--velocity", "theta=theta_dot", "--acceleration", "theta=theta_ddot"]
    found = pendulum / "found"
    code, text = invoke("discover", *common, *rates, "--library", pendulum / "terms.txt", "--output", found)
    assert code == 0, text
    assert "note: velocity of theta: noise 0.0" in text
    assert "note: acceleration of theta: noise 0." in text
    report = re.sub("<[^>]*>", "", (found / "report.html").read_text(encoding="utf-8"))
    assert "velocity of θ: noise 0.0" in report
    code, text = invoke("validate", found / "model.json", *common, *rates)
    assert code == 0, text


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--velocity", "phi=theta_dot"], "--velocity: 'phi' is not a coordinate"),
        (["--velocity", "theta_dot"], "--velocity: 'theta_dot' is not of the form NAME=COLUMN"),
        (["--velocity", "theta=a", "--velocity", "theta=b"], "--velocity: 'theta' is given twice"),
        (["--acceleration", "theta=nowhere"], "no column 'nowhere' (acceleration of theta)"),
    ],
)
def test_wrong_options_end_with_one_line(pendulum, options, text):
    code, output = invoke(
        "discover", pendulum / "run.csv", "--coordinates", "theta", *options, "--output", pendulum / "not"
    )
    assert code == 2
    assert text in " ".join(output.split())
    assert len(output.strip().splitlines()) == 1


# -------------------------------------------------------------------------------------- bags
rosbags = pytest.importorskip("rosbags")


def write_bag(folder, velocities):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    types, kind = get_typestore(Stores.ROS2_HUMBLE), "sensor_msgs/msg/JointState"
    make = types.types
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/joint_states", kind, typestore=types)
        for k, velocity in enumerate(velocities):
            stamp = 1_700_000_000_000_000_000 + 10_000_000 * k
            header = make["std_msgs/msg/Header"](
                make["builtin_interfaces/msg/Time"](*divmod(stamp, 1_000_000_000)), ""
            )
            arrays = [np.array(x, dtype=float) for x in ([k / 10, -k], velocity, [1.0, 2.0])]
            message = make[kind](header, ["a", "b"], *arrays)
            writer.write(connection, stamp, types.serialize_cdr(message, kind))
    return next(path for path in folder.iterdir() if path.suffix == ".mcap")


def test_velocities_of_joint_states_are_used_when_asked_for(tmp_path):
    bag = write_bag(tmp_path / "bag", [[k, 2.0 * k] if k != 3 else [] for k in range(8)])
    assert read_mcap(bag, joints=["a", "b"])[0].velocities is None
    expected = np.array([[k, 2.0 * k] if k != 3 else [np.nan] * 2 for k in range(8)])
    all_of_them = read_mcap(bag, joints=["a", "b"], velocities="velocity", forces="effort")[0]
    np.testing.assert_array_equal(all_of_them.velocities, expected)
    np.testing.assert_array_equal(all_of_them.forces, [[1.0, 2.0]] * 8)
    crossed = read_mcap(bag, coordinates={"u": "b"}, velocities={"u": "a.velocity"})[0]
    np.testing.assert_array_equal(crossed.velocities, expected[:, :1])
    by_suffix = io.read(bag, ["a"], velocities={"a": "/joint_states:a.velocity"})[0]
    np.testing.assert_array_equal(by_suffix.velocities, expected[:, :1])


def test_what_a_bag_does_not_hold(tmp_path):
    bag = write_bag(tmp_path / "bag", [[]] * 8)
    with pytest.raises(InputError, match=r"there is no velocity in column 'a\.velocity'"):
        read_mcap(bag, joints=["a"], velocities="velocity")
    with pytest.raises(InputError, match=r"which is not a velocity; write 'a\.velocity'"):
        read_mcap(bag, joints=["a"], velocities={"a": "a.effort"})
    with pytest.raises(InputError, match="joint states hold no accelerations"):
        io.read(bag, ["a"], accelerations={"a": "a.velocity"})
    odd = write_bag(tmp_path / "odd", [[1.0, 2.0, 3.0]] * 8)
    assert read_mcap(odd, joints=["a"])[0].n_times == 8
    with pytest.raises(InputError, match="message 0: there are 3 values of velocity for 2 joint"):
        read_mcap(odd, joints=["a"], velocities="velocity")
