"""Files of every format, from CSV to ROS 2 bags; what all readers share; measured rates."""

from __future__ import annotations

import datetime
import gzip
import os
import pickle
import re
import stat
import sys
import time
import tracemalloc
import warnings

import h5py
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

import leastaction as la
from helpers import with_rates
from leastaction import DataError, InputError, Trajectories, Trajectory, io, systems
from leastaction.cli import program
from leastaction.data.formats import csv as _csv
from leastaction.data.formats import text as _text
from leastaction.data.formats import text as text_module
from leastaction.data.formats.bags import read_mcap
from leastaction.data.formats.layout import Layout
from leastaction.errors import DataWarning

NAN = float("nan")
PLAIN = "t,theta,tau\n" + "".join(f"{k / 10},{k},{-k}\n" for k in range(6))


def table(*lines, header="t,theta"):
    return "\n".join([header, *lines]) + "\n"


def rows(*replaced):
    """Six good lines ``k,k/8``, with some replaced: pairs of (index, text)."""
    lines = [f"{k},{k / 8}" for k in range(6)]
    for index, text in replaced:
        lines[index] = text
    return table(*lines)


# --- CSV that is read -------------------------------------------------------------------------------


def test_columns_forces_and_name(file):
    runs = io.read_csv(file(PLAIN), ["theta"], forces={"theta": "tau"})
    assert runs.names == ("run",)
    np.testing.assert_array_equal(runs[0].t, np.arange(6) / 10)
    np.testing.assert_array_equal(runs[0].q[:, 0], np.arange(6))
    np.testing.assert_array_equal(runs[0].forces[:, 0], -np.arange(6.0))
    assert io.read_csv(str(file(PLAIN)), "theta")[0].forces is None


@pytest.mark.parametrize("delimiter", [",", ";", "\t", ", "])
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize(
    "change", ["", "bom", "no end", "blank lines", "comment", "quotes", "savetxt", "gzip"]
)
def test_dialects_give_the_same(file, delimiter, newline, change):
    text = PLAIN
    if change == "no end":
        text = text.rstrip("\n")
    elif change == "blank lines":
        text = "\n" + text.replace("\n", "\n\n  \n")
    elif change == "comment":
        text = "# measured, by hand; 2024\n#\n" + text
    elif change == "quotes":
        text = text.replace("t,theta,tau", '"t","theta","tau"').replace("0.1,", '"0.1",')
    elif change == "savetxt":
        text = "# " + text
    data = (
        text.replace(",", delimiter)
        .replace("\n", newline)
        .encode("utf-8-sig" if change == "bom" else "utf-8")
    )
    path = file(gzip.compress(data) if change == "gzip" else data)
    expected = io.read_csv(file(PLAIN, "plain.csv"), ["theta"], forces=["tau"])
    assert io.read_csv(path, ["theta"], forces=["tau"]).digest() == expected.digest()


def test_missing_samples_are_nan(file):
    cells = ["", "NaN", "nan", "NA", " ", "1", "2", "3", "4", "5"]
    runs = io.read_csv(file(table(*[f"{k},{cell}" for k, cell in enumerate(cells)])), ["theta"])
    np.testing.assert_array_equal(runs[0].q[:, 0], [NAN] * 5 + [1, 2, 3, 4, 5])
    assert runs.n_samples == 5


def test_numpy_savetxt(tmp_path):
    data = np.column_stack([np.arange(7.0), np.random.default_rng(3).normal(size=7)])
    np.savetxt(tmp_path / "run.dat", data, delimiter="\t", header="t\ttheta")
    assert np.array_equal(io.read(tmp_path / "run.dat", ["theta"])[0].q[:, 0], data[:, 1])


def test_trials_in_order_with_times_that_restart_or_run_on(file):
    lines = [
        f"{name},{t + offset},{t}" for name, offset in (("b", 0), ("10", 0), ("NA", 9)) for t in range(5)
    ]
    runs = io.read_csv(file(table(*lines, header="trial,t,theta")), ["theta"])
    assert runs.names == ("b", "10", "NA")
    assert [item.t[0] for item in runs] == [0.0, 0.0, 9.0]
    renamed = file(table(*lines, header="Run No,Time / s,angle (rad)"))
    again = io.read_csv(renamed, {"theta": "angle (rad)"}, time="Time / s", trial="Run No")
    assert again.names == runs.names
    assert again.digest() == runs.digest()


def test_forces_for_some_coordinates(file):
    path = file("t,a,b,u\n" + "".join(f"{k},0,1,{k}\n" for k in range(5)))
    for forces in ({"b": "u"}, [None, "u"]):
        runs = io.read_csv(path, ["a", "b"], forces=forces)
        np.testing.assert_array_equal(runs[0].forces, np.column_stack([np.zeros(5), np.arange(5)]))
    both = io.read_csv(path, ["a", "b"], forces={"a": "u", "b": "u"})
    np.testing.assert_array_equal(both[0].forces[:, 0], both[0].forces[:, 1])
    first = io.read_csv(path, ["a", "b"], forces="u")
    assert not first[0].forces[:, 1].any()
    assert not io.read_csv(path, ["a", "b"], forces=[]).driven


def test_forces_act_on_a_coordinate_without_a_column(file):
    path = file("t,a [mm],u [mN]\n" + "".join(f"{k},{k},{2 * k}\n" for k in range(5)))
    (run,) = io.read_csv(path, {"b": None, "a": "a"}, forces={"b": "u"})
    assert run.coordinates == ("a", "b")
    np.testing.assert_allclose(run.q, np.column_stack([1e-3 * np.arange(5), np.full(5, NAN)]))
    np.testing.assert_allclose(run.forces, np.column_stack([np.zeros(5), 2e-3 * np.arange(5)]))


def test_angles_are_unwrapped(file):
    path = file(table("0,3", "1,", "2,-3", "3,-2", "4,-1", "5,0"))
    runs = io.read_csv(path, ["theta"], angles=["theta"])
    assert runs.wraps_removed == {"theta": 1}
    assert runs[0].q[-1, 0] == pytest.approx(2 * np.pi)


def test_unicode_names_match_in_any_normal_form(file):
    path = file(table(*[f"{k},1" for k in range(5)], header="t,ϑ"))
    assert io.read_csv(path, ["θ"]).coordinates == ("θ",)
    assert io.read_csv(path, ["ϑ"], angles="ϑ").coordinates == ("θ",)


def test_a_million_lines_take_less_than_three_seconds(tmp_path):
    n = 1_000_000
    line = "0.12345678901,-1.2345678901,\n"
    times = "\n".join(f"{k}," + line[:-1] for k in range(n))
    (tmp_path / "long.csv").write_text("t,a,b,c\n" + times)
    start = time.process_time()
    runs = io.read_csv(tmp_path / "long.csv", ["a", "b"])
    assert time.process_time() - start < 3.0
    assert runs[0].n_times == n


# --- CSV that is refused ----------------------------------------------------------------------------

BAD = {
    "text": (rows((2, "2,abc")), r"run.csv, line 4, column 'theta': 'abc' is not a number"),
    "comma": (rows((2, '2,"0,5"')), r"line 4.*write a decimal point"),
    "underscore": (rows((2, "2,1_0")), r"line 4.*'1_0' is not a number"),
    "truth": (table(*[f"{k},True" for k in range(6)]), r"line 2.*'True' is not a number"),
    "html": (rows((5, "5,<b>")), r"line 7.*'<b>' is not a number"),
    "inf": (rows((2, "2,inf")), r"line 4, column 'theta': the value is infinite"),
    "overflow": (rows((2, "2,1e999")), r"line 4, column 'theta': the value is infinite"),
    "inf time": (rows((5, "inf,1")), r"line 7, column 't': the value is infinite"),
    "no time": (rows((2, ",1")), r"line 4, column 't': the time is missing; remove the row"),
    "nan time": (rows((2, "nan,1")), r"line 4, column 't': the time is missing"),
    "repeated": (rows((2, "1,1")), r"line 4, column 't': time 1.0 repeats .*trial=\.\.\."),
    "backwards": (rows((2, "0.5,1")), r"line 4, column 't': time 0.5 goes backwards, from 1.0; sort"),
    "few cells": (rows((2, "2")), r"line 4: there are 1 cells, but the header has 2"),
    "many cells": (rows((2, "2,1,1")), r"line 4: there are 3 cells, but the header has 2"),
    "both": (rows((2, "2,1,1"), (3, "3")), r"line 4: there are 3 cells"),
    "open quote": (rows((2, '2,"1')), r"line \d: .*check the quotes"),
    "empty": ("", r"is empty"),
    "blank": (" \n\n", r"no header line"),
    "header only": ("t,theta\n", r"has a header, but no data lines"),
    "no header": (rows().split("\n", 1)[1], r"line 1: there are numbers where the header is expected"),
    "one column": ("t:theta\n0:1\n", r"line 1: there is only the column 't:theta'; separate columns by"),
    "words": ("hello world\nnot a table\n", r"line 1: there is only the column 'hello world'; separate"),
    "few words": (rows((2, "2")).replace(",", "  "), r"line 4: there are 1 cells, but the header has 2"),
    "no words": (rows().replace(",", "  ").split("\n", 1)[1], r"line 1: there are numbers where the header"),
    "missing": (
        rows().replace("theta", "Theta1"),
        r"no column 'theta' \(coordinate theta\).*t, Theta1; did you",
    ),
    "twice": (rows().replace("t,", "theta,", 1), r"two columns are called 'theta'"),
    "latin": (rows().encode() + b"6,\xb5\n", r"line 8, column 'theta': 'µ' is not a number"),
    "no text": (rows().encode() + b"6,\x81\n", r"line 8: byte 0x81 is neither UTF-8 text nor Windows-1252"),
    "binary": (b"t,theta\n\x00\x01\x02", r"line 2: the file holds binary data"),
    "gzip": (gzip.compress(rows().encode())[:-9], r"damaged gzip"),
    "empty gzip": (gzip.compress(b""), r"is empty"),
}


@pytest.mark.parametrize("case", BAD)
@pytest.mark.parametrize("newline", [b"\n", b"\r\n"])
def test_bad_csv_names_file_line_and_column(file, case, newline):
    content, message = BAD[case]
    data = content if isinstance(content, bytes) else content.encode().replace(b"\n", newline)
    with pytest.raises(InputError, match=message) as caught:
        io.read_csv(file(data), ["theta"])
    assert "run.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_lines_are_counted_with_comments_and_blanks(file):
    text = "# one\n\n" + rows((3, "3,x")).replace("1,0.125\n", "1,0.125\n\n\n")
    with pytest.raises(InputError, match=r"line 9, column 'theta': 'x'"):
        io.read_csv(file(text), ["theta"])
    with pytest.raises(InputError, match=r"line 9, column 't': time 2.0 repeats"):
        io.read_csv(file(text.replace("3,x", "2,1")), ["theta"])


@pytest.mark.parametrize(
    ("lines", "error", "message"),
    [
        (
            [f"a,{k},0" for k in range(5)] + ["b,0,0", "a,5,0"],
            InputError,
            r"line 8, column 'trial': trial 'a' continues",
        ),
        (
            [f"a,{k},0" for k in range(5)] + [",5,0"],
            InputError,
            r"line 7, column 'trial': the name .* missing",
        ),
        (
            [f"a,{k % 3},0" for k in range(5)],
            InputError,
            r"line 5, column 't': .* goes backwards.* in trial 'a'; sort",
        ),
        ([f"a,{k},0" for k in range(4)], DataError, r"trial 'a': there are only 4 sample"),
        (
            [f"a,{k},{'NA' if k % 2 else 0}" for k in range(8)],
            DataError,
            r"trial 'a': theta has only 4 measured",
        ),
    ],
)
def test_bad_trials(file, lines, error, message):
    with pytest.raises(error, match=message):
        io.read_csv(file(table(*lines, header="trial,t,theta")), ["theta"])


def test_missing_force_is_an_error(file):
    with pytest.raises(InputError, match=r"line 3, column 'tau': the force is missing; put 0"):
        io.read_csv(file(PLAIN.replace(",-1\n", ",\n")), ["theta"], forces=["tau"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (dict(coordinates=["theta_dot"]), "velocity"),
        (dict(coordinates=[]), "is empty"),
        (dict(coordinates=7), "sequence of names"),
        (dict(coordinates={"theta": 3}), "column of coordinate theta must be a name"),
        (dict(coordinates={"theta": None}), "no coordinate has a column"),
        (dict(coordinates=["theta", "theta"]), "occurs twice"),
        (dict(coordinates={"a": "theta", "b": "theta"}), "used twice, as coordinate a and as coordinate b"),
        (dict(time="theta"), "used twice, as time and as coordinate theta"),
        (dict(time=0), "time must be the name"),
        (dict(trial="t"), "used twice"),
        (dict(trial="run"), r"no column 'run' \(trial\)"),
        (dict(forces=["tau", "tau"]), r"2 force columns for 1 coordinate\(s\) \(theta\)"),
        (dict(forces={"thta": "tau"}), "belongs to no coordinate; .* did you mean 'theta'"),
        (dict(forces={"theta": "torque"}), r"no column 'torque' \(force on theta\)"),
        (dict(forces={"theta": None}), "must be the name of a column"),
        (dict(forces={"theta": "theta"}), "used twice, as coordinate theta and as force"),
        (dict(forces=5), "forces must be names"),
        (dict(angles=["phi"]), "angle 'phi' is not a coordinate"),
    ],
)
def test_bad_arguments(file, arguments, message):
    with pytest.raises(InputError, match=message):
        io.read_csv(file(PLAIN), **(dict(coordinates=["theta"]) | arguments))


def test_bad_paths(tmp_path):
    for path, message in [
        (tmp_path / "none.csv", "there is no such file"),
        (tmp_path, "is a directory"),
        ("", "not the path"),
        ("a\0b", "not the path"),
        (3, "a path is expected"),
        (tmp_path / "a.csv" / "b.csv", "no such file"),
    ]:
        with pytest.raises(InputError, match=message):
            io.read_csv(path, ["theta"])
    with pytest.raises(InputError, match=r"suffix '\.xls' is not known"):
        io.read(tmp_path / "run.xls", ["theta"])
    with pytest.raises(InputError, match="is a directory"):
        io.read(tmp_path, ["theta"])


cells = (
    st.floats(-1e3, 1e3).map(repr)
    | st.sampled_from(
        ["", "NA", "nan", " 1.5 ", "1.", "+.5", "1e5", "1E-5", "0", "1", "True", "false", "inf", "-Infinity"]
    )
    | st.sampled_from(
        ["1_0", "x", "0x1", "1e", "--1", "1 2", "\t1", "1\x0b", "é", "١", "#1", "-nan", "1d5", "-"]
    )
)


@given(
    st.lists(st.tuples(cells, cells, st.sampled_from(["a", "b", "", " a ", "NA", "1.0"])), max_size=4),
    st.data(),
)
def test_fast_and_slow_reader_agree(lines, data):
    body = "".join(",".join(line) + data.draw(st.sampled_from(["\n", "\n\n"])) for line in lines)
    text = _text.Text("run.csv", body, 2, ",", ("t", "x", "trial"))
    layout = Layout.of(["x"], "t", None, "trial", ())
    fast = _csv._read_fast(text, layout) if body else None
    try:
        slow = _csv._read_slowly(text, layout)
    except InputError:
        assert fast is None
        return
    if fast is not None:
        assert list(fast.trials) == list(slow.trials)
        for name in ("t", "x"):
            np.testing.assert_array_equal(fast.numbers[name], slow.numbers[name])
        places = [[table.place(k) for k in range(len(slow.trials))] for table in (fast, slow)]
        assert places[0] == places[1]


@given(st.binary(max_size=200))
def test_junk_gives_one_readable_error(tmp_path_factory, junk):
    path = tmp_path_factory.mktemp("junk") / "run.csv"
    path.write_bytes(junk)
    with pytest.raises((InputError, DataError)) as caught:
        io.read_csv(path, ["theta"])
    assert "\n" not in str(caught.value)


# --- several files ----------------------------------------------------------------------------------


def test_read_many_names_the_trials_after_the_files(tmp_path, file):
    (tmp_path / "sub").mkdir()
    trials = "trial," + "\n".join(
        ("x," if k else "") + line for k, line in enumerate(PLAIN.strip().split("\n"))
    )
    paths = [file(PLAIN, "a.csv"), file(trials, "b.csv"), file(PLAIN, "sub/a.csv")]
    runs = io.read_many(paths, ["theta"], forces=["tau"])
    assert runs.names == ("a", "b/x", "a-2")
    assert runs.driven
    assert io.read_many(paths[1:2], ["theta"]).names == ("x",)
    assert io.read_many(paths[0], ["theta"]).names == ("a",)
    assert io.read_many(reversed(paths), ["theta"]).names == ("a", "b/x", "a-2")
    with pytest.raises(InputError, match="given twice"):
        io.read_many([paths[0], tmp_path / "sub" / ".." / "a.csv"], ["theta"])
    with pytest.raises(InputError, match="at least one path"):
        io.read_many([], ["theta"])


def test_every_reader_takes_several_files(tmp_path, file):
    """Lengths and grids may differ, and so may the sequence of the columns."""
    other = "theta;t\n" + "".join(f"{k};{k / 7 + 0.01 * (k % 3)}\n" for k in range(9))
    paths = [file(PLAIN, "monday.csv"), file(other, "tuesday.txt")]
    for reader in (io.read, io.read_csv):
        runs = reader(paths, ["theta"])
        assert runs.names == ("monday", "tuesday")
        assert [run.n_times for run in runs] == [6, 9]
        np.testing.assert_array_equal(runs[1].q[:, 0], np.arange(9))
        assert reader(iter(paths[:1]), ["theta"]).names == ("monday",)
    arrays = [tmp_path / "a.npz", tmp_path / "b.npz"]
    for path in arrays:
        np.savez(path, t=np.arange(6.0), x=np.arange(6.0))
    assert io.read_npz(arrays, ["x"]).names == ("a", "b")
    np.savez(tmp_path / "c.npz", t=np.arange(6.0), theta=np.arange(6.0))
    assert io.read([paths[0], tmp_path / "c.npz"], ["theta"]).names == ("monday", "c")


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ("t,phi\n0,1\n", r"bad\.csv has no column 'theta'"),
        ("t,theta\n" + "0,1\n" * 6, r"bad\.csv, line 3, column 't': time 0.0 repeats"),
        ("t,theta\n0,1\n1,x\n", r"bad\.csv, line 3, column 'theta': 'x' is not a number"),
    ],
)
def test_errors_of_several_files_name_the_file(file, bad, message):
    with pytest.raises(InputError, match=message):
        io.read([file(PLAIN, "good.csv"), file(bad, "bad.csv")], ["theta"])
    with pytest.raises(DataError, match=r"short\.csv: there are only 2 sample"):
        io.read([file(PLAIN, "good.csv"), file(table("0,1", "1,2"), "short.csv")], ["theta"])
    with pytest.raises(InputError, match=r"none\.csv: there is no such file"):
        io.read([file(PLAIN, "good.csv"), "none.csv"], ["theta"])


def test_read_many_counts_wraps_of_all_files(file):
    text = table("0,3", "1,-3", "2,3", "3,3", "4,3")
    runs = io.read_many([file(text, "a.csv"), file(text, "b.csv")], ["theta"], angles=["theta"])
    assert runs.wraps_removed == {"theta": 4}


# ----------------------- measured velocities and accelerations in every kind of file, and on the command line
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
def measured() -> pd.DataFrame:
    from io import StringIO

    return pd.read_csv(StringIO(CSV))


def test_every_kind_of_file_and_frame(tmp_path, measured):
    (tmp_path / "run.csv").write_text(CSV)
    measured.to_parquet(tmp_path / "run.parquet")
    np.savez(tmp_path / "run.npz", **{name: measured[name].to_numpy() for name in measured})
    savemat = pytest.importorskip("scipy.io").savemat
    savemat(tmp_path / "run.mat", {name: measured[name].to_numpy() for name in measured})
    for suffix in ("csv", "parquet", "npz", "mat"):
        path = tmp_path / f"run.{suffix}"
        reader = getattr(io, f"read_{suffix}")
        for read in (reader, io.read, io.read_many):
            check(read(path, ["a", "b"], **GIVEN)[0])
    check(io.from_frame(measured, ["a", "b"], **GIVEN)[0])
    # in the sequence of the coordinates, as forces are given
    check(io.from_frame(measured, ["a", "b"], velocities=["gyro"], accelerations=[None, "acc"])[0])
    assert io.read_csv(tmp_path / "run.csv", ["a"])[0].velocities is None


def test_matrix_of_coordinates_beside_vectors_of_rates(tmp_path, measured):
    q = measured[["a", "b"]].to_numpy()
    np.savez(tmp_path / "run.npz", t=measured["t"], q=q, gyro=measured["gyro"], acc=measured["acc"])
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
    assert "acceleration of theta: noise 0." in text
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


NAN = float("nan")
T = np.arange(12) / 10
COLUMNS = {
    "t": np.tile(T[:6], 2),
    "a": np.sin(COLUMN := np.arange(12.0)),
    "b": np.where(COLUMN == 3, NAN, COLUMN),
    "u": COLUMN % 3,
    "trial": np.repeat([4, 2], 6),
}


@pytest.fixture(scope="module")
def expected():
    return io.from_frame(pd.DataFrame(COLUMNS), ["a", "b"], forces={"b": "u"})


def check_runs(runs, expected):
    assert runs.names == expected.names == ("4", "2")
    assert runs.digest() == expected.digest()
    assert runs[0].forces[:, 0].tolist() == [0.0] * 6


def frames(columns):
    """The same table in several libraries; a missing sample as NaN, null and pandas.NA."""
    table = pd.DataFrame(columns)
    nullable = table.assign(b=table["b"].astype("Int64"), trial=table["trial"].astype(str))
    objects = table.assign(b=table["b"].astype(object).where(table["b"].notna(), None))
    lists = {name: [None if x != x else x for x in values.tolist()] for name, values in columns.items()}
    return {
        "pandas": table,
        "pandas nullable": nullable,
        "pandas object": objects,
        "pandas index": table.set_index(table.index[::-1]),
        "pandas float trials": table.assign(trial=table["trial"].astype(float)),
        "pandas categories": nullable.assign(trial=nullable["trial"].astype("category")),
        "polars": pl.DataFrame(lists),
        "polars lazy": pl.DataFrame(columns).lazy(),
        "polars float32": pl.DataFrame(lists).with_columns(pl.col("b").cast(pl.Float32)),
        "arrow": pa.table(lists),
    }


@pytest.mark.parametrize("kind", list(frames(COLUMNS)))
def test_data_frames(kind, expected):
    check_runs(io.from_frame(frames(COLUMNS)[kind], ["a", "b"], forces={"b": "u"}), expected)


def without(**changes):
    columns = {name: list(values) for name, values in COLUMNS.items()} | changes
    return {name: values for name, values in columns.items() if values is not None}


@pytest.mark.parametrize("library", [pd.DataFrame, pl.DataFrame])
@pytest.mark.parametrize(
    ("columns", "error", "message"),
    [
        (
            without(a=None),
            InputError,
            r"data frame has no column 'a' \(coordinate a\); its columns are t, b, u",
        ),
        (without(a=["1"] * 12), InputError, r"row 0 .*column 'a': '1' is not a number"),
        (without(a=[True] * 12), InputError, r"column 'a': True is not a number"),
        (without(a=[datetime.datetime(2024, 1, 1)] * 12), InputError, "times to seconds"),
        (
            without(t=[datetime.datetime(2024, 1, 1)] * 12),
            InputError,
            r"row 1 .*repeats .*fractions of a second",
        ),
        (without(t=[None, *T[1:]]), InputError, r"row 0 .*column 't': the time is missing"),
        (without(u=[0.0] * 11 + [None]), InputError, r"row 11 .*column 'u': the force is missing"),
        (without(a=[0.0] * 5 + [np.inf] * 7), InputError, r"row 5 .*infinite"),
        (without(trial=[None] * 12), InputError, r"row 0 .*name of the trial is missing"),
        (without(trial=[1] * 5 + [2] * 6 + [1]), InputError, r"row 6 .*|row 11 .*continues"),
        (without(trial=None), InputError, r"row 6 .*time 0.0 goes backwards"),
        (without(t=list(T), trial=[1] * 8 + [2] * 4), DataError, "trial '2': there are only 4"),
        ({name: [] for name in COLUMNS}, InputError, "has no data"),
    ],
)
def test_bad_data_frames(library, columns, error, message):
    with pytest.raises(error, match=message):
        io.from_frame(library(columns), ["a", "b"], forces={"b": "u"})


def test_frames_with_odd_columns():
    table = pd.DataFrame([[0.0] * 3] * 6, columns=["t", "a", "a"])
    with pytest.raises(InputError, match="two columns are called 'a'"):
        io.from_frame(table, ["a"])
    with pytest.raises(InputError, match="it has no named columns"):
        io.from_frame(pd.DataFrame([[0.0] * 3] * 6), ["a"])
    for bad in (None, {"t": [1]}, [1, 2], "run.csv", pl.Series([1.0])):
        with pytest.raises(InputError, match="is not a"):
            io.from_frame(bad, ["a"])


# --- Parquet ----------------------------------------------------------------------------------------


def test_parquet(tmp_path, expected):
    pd.DataFrame(COLUMNS | {"no number": ["x"] * 12}).to_parquet(tmp_path / "run.parquet")
    check_runs(io.read(tmp_path / "run.parquet", ["a", "b"], forces=[None, "u"]), expected)
    single = pd.DataFrame(COLUMNS).drop(columns="trial").iloc[:6].rename(columns={"a": "angle.a"})
    single.to_parquet(tmp_path / "one.PARQUET")
    assert io.read(tmp_path / "one.PARQUET", {"a": "angle.a"}).names == ("one",)


def test_bad_parquet(tmp_path):
    path = tmp_path / "run.parquet"
    parquet.write_table(pa.table(COLUMNS), path)
    with pytest.raises(InputError, match=r"run.parquet has no column 'c'"):
        io.read_parquet(path, ["c"])
    data = path.read_bytes()
    for content, message in [
        (b"", "is empty"),
        (b"t,a\n0,1\n", "not a Parquet file"),
        (data[:-20], "damaged"),
        (data[:4] + bytes(200) + data[204:], "damaged"),
    ]:
        path.write_bytes(content)
        with pytest.raises(InputError, match=message):
            io.read_parquet(path, ["a"])
    with pytest.raises(InputError, match="no such file"):
        io.read_parquet(tmp_path / "none.parquet", ["a"])


@pytest.mark.parametrize(
    ("module", "suffix", "extra"), [("pyarrow.parquet", "parquet", "parquet"), ("h5py", "mat", "mat73")]
)
def test_missing_extras_are_named(tmp_path, monkeypatch, module, suffix, extra):
    path = tmp_path / f"run.{suffix}"
    path.write_bytes(b"PAR1" if suffix == "parquet" else b"MATLAB 7.3 MAT-file")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=rf"pip install 'leastaction\[{extra}\]'"):
        io.read(path, ["a"])


# --- NPZ and MAT ------------------------------------------------------------------------------------


def write_npz(path, variables):
    np.savez_compressed(path, **variables)


def write_mat(path, variables):
    savemat(path, variables, oned_as="column")


def write_mat73(path, variables):
    """As MATLAB does: every array two-dimensional and transposed, a class beside it."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            array = np.atleast_2d(np.asarray(value))
            if array.dtype.kind in "OU":
                texts = [
                    file.create_dataset(f"#refs#/{name}{k}", data=[[ord(c)] for c in x])
                    for k, x in enumerate(value)
                ]
                for text in texts:
                    text.attrs["MATLAB_class"] = np.bytes_("char")
                item = file.create_dataset(name, data=[[text.ref for text in texts]], dtype=h5py.ref_dtype)
                item.attrs["MATLAB_class"] = np.bytes_("cell")
            else:
                item = file.create_dataset(name, data=array if np.ndim(value) < 2 else array.T)
                item.attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: PCWIN64".ljust(124) + b"\0\2IM")


WRITERS = {"npz": write_npz, "mat": write_mat, "mat73": write_mat73}


@pytest.fixture(params=list(WRITERS))
def save(request, tmp_path):
    """Return a function that writes variables to a file of one kind and returns its path."""

    def write(variables):
        path = tmp_path / f"run.{request.param[:3]}"
        WRITERS[request.param](path, variables)
        return path

    return write


@pytest.mark.parametrize("texts", [False, True])
def test_variables(save, expected, texts):
    trials = np.array([str(x) for x in COLUMNS["trial"]], dtype=object if texts else str)
    variables = COLUMNS | {
        "trial": trials.astype(str) if texts else COLUMNS["trial"],
        "other": np.zeros((2, 3)),
    }
    check_runs(io.read(save(variables), ["a", "b"], forces={"b": "u"}), expected)


def test_rows_and_columns_are_vectors(save):
    path = save({"time": T[:, np.newaxis], "x": T[np.newaxis, :] ** 2})
    runs = io.read(path, ["x"], time="time")
    assert runs.names == ("run",)
    np.testing.assert_array_equal(runs[0].q[:, 0], T**2)


def test_matrix_q(save):
    q = np.column_stack([T, T**2])
    path = save({"t": T, "q": q, "u": T})
    runs = io.read(path, ["x", "y"], forces=["u"])
    np.testing.assert_array_equal(runs[0].q, q)
    np.testing.assert_array_equal(runs[0].forces[:, 0], T)
    with pytest.raises(InputError, match=r"variable 'q': it has shape \(12, 2\), but .* \(12, 3\)"):
        io.read(path, ["x", "y", "z"])
    path = save({"t": T, "q": q.T})
    with pytest.raises(InputError, match="looks transposed"):
        io.read(path, ["x", "y"])
    assert io.read(save({"t": T, "q": T}), ["x"])[0].n_dof == 1
    assert io.read(save({"t": T, "q": T}), ["q"])[0].n_dof == 1


def test_one_trial_name_for_all(save):
    assert io.read(save({"t": T, "x": T, "trial": np.array([7])}), ["x"]).names == ("7",)


@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ({"t": T}, r"has no variable 'x' \(coordinate x\); its variables are t"),
        ({"t": T, "x": T[:-1]}, r"variable 'x': it has 11 values, but the time 't' has 12"),
        ({"t": T, "x": T, "trial": T[:-1]}, "variable 'trial': it has 11 values"),
        ({"t": T, "x": np.ones((3, 4))}, r"variable 'x': it has shape \([34], [34]\)"),
        ({"t": T[::-1], "x": T}, r"row 1 .*column 't': time 1.0 goes backwards"),
        ({"t": T, "x": np.full(12, np.inf)}, "row 0 .*infinite"),
        ({"t": T, "x": np.array(["a"] * 12)}, "variable 'x'"),
        ({"t": np.full(12, NAN), "x": T}, "time is missing"),
    ],
)
def test_bad_variables(save, variables, message):
    path = save(variables)
    with pytest.raises(InputError, match=message) as caught:
        io.read(path, ["x"])
    assert path.name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_complex_numbers_are_refused(tmp_path):
    for suffix, write in (("npz", write_npz), ("mat", write_mat)):
        write(tmp_path / f"run.{suffix}", {"t": T, "x": T + 1j})
        with pytest.raises(InputError, match="variable 'x' has type complex128"):
            io.read(tmp_path / f"run.{suffix}", ["x"])


def test_few_samples(save):
    with pytest.raises(DataError, match="only 4 sample"):
        io.read(save({"t": T[:4], "x": T[:4]}), ["x"])


def test_pickled_objects_are_not_loaded(tmp_path):
    np.savez(tmp_path / "run.npz", t=T, x=np.array([{}] * 12, dtype=object))
    with pytest.raises(InputError, match="variable 'x': it holds pickled objects"):
        io.read(tmp_path / "run.npz", ["x"])


def test_damaged_files(save):
    path = save({"t": T, "x": T})
    data = path.read_bytes()
    for content in (b"", b"junk" * 100, data[: len(data) // 2], data[:200]):
        path.write_bytes(content)
        with pytest.raises(InputError, match=path.name) as caught:
            io.read(path, ["x"])
        assert "\n" not in str(caught.value)


def test_npy_file_is_no_npz(tmp_path):
    np.save(tmp_path / "run.npy", T)
    (tmp_path / "run.npy").rename(tmp_path / "run.npz")
    with pytest.raises(InputError, match="not an NPZ file"):
        io.read_npz(tmp_path / "run.npz", ["x"])


# --- writing ----------------------------------------------------------------------------------------

values = arrays(np.float64, (7, 2), elements=st.floats(allow_infinity=False, allow_nan=False))


@given(
    values,
    values,
    st.booleans(),
    st.sampled_from(["run", "NA", "a,b", 'say "x"', "zwei\nZeilen", "θ", "007"]),
)
def test_written_csv_reads_back_exactly(tmp_path_factory, q, forces, driven, name):
    q = q.copy()
    q[0, 0] = NAN
    t = np.cumsum(np.random.default_rng(1).uniform(size=7))
    runs = Trajectories(
        [
            Trajectory(t, q, forces if driven else None, ["x", "y"], name),
            Trajectory(t[:6] - 7.0, q[:6], None, ["x", "y"]),
        ]
    )
    path = io.write_csv(tmp_path_factory.mktemp("rt") / "run.csv", runs)
    names = {"x": "x_force", "y": "y_force"} if runs.driven else None
    again = io.read_csv(path, ["x", "y"], forces=names)
    assert again.digest() == runs.digest()
    assert again.names == runs.names == (name, "1")
    assert ("x_force" in path.read_text(encoding="utf-8")) == runs.driven


def test_write_csv_compressed_and_reproducible(tmp_path):
    run = Trajectory(np.arange(5), np.arange(5), coordinates=["x"], name="a")
    first = io.write_csv(tmp_path / "a.csv.gz", run).read_bytes()
    assert first == io.write_csv(tmp_path / "b.csv.gz", [run]).read_bytes()
    assert io.read(tmp_path / "a.csv.gz", ["x"]).names == ("a",)


def test_write_csv_refuses_names_that_would_not_read_back(tmp_path):
    run = Trajectory([0, 1], np.zeros((2, 2)), np.ones((2, 2)), ["x", "x_force"])
    with pytest.raises(InputError, match="called 'x_force'"):
        io.write_csv(tmp_path / "a.csv", run)
    with pytest.raises(InputError, match="called 'trial'"):
        io.write_csv(tmp_path / "a.csv", Trajectory([0, 1], [0, 1], coordinates=["trial"]))
    with pytest.raises(InputError, match="cannot stand"):
        io.write_csv(tmp_path / "a.csv", Trajectory([0, 1], [0, 1], name=" a"))
    assert not list(tmp_path.iterdir())


def test_write_replaces_keeps_mode_and_leaves_nothing_behind(tmp_path):
    path = tmp_path / "new" / "deep" / "a.txt"
    assert io.write_text(path, "eins\r\nθ") == path
    assert path.read_bytes() == "eins\r\nθ".encode()
    assert stat.S_IMODE(path.stat().st_mode) & 0o400
    path.chmod(0o640)
    io.write_bytes(path, b"zwei")
    assert path.read_bytes() == b"zwei"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert os.listdir(path.parent) == ["a.txt"]


def test_write_goes_through_links(tmp_path):
    target, link = tmp_path / "target.txt", tmp_path / "link.txt"
    target.write_text("old")
    link.symlink_to(target)
    io.write_text(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"


def test_failed_write_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    io.write_text(path, "old")

    def fail(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(InputError, match=r"a.txt cannot be written: No space left on device"):
        io.write_text(path, "new")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_write_to_bad_places(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="is a directory"):
        io.write_text(tmp_path, "x")
    with pytest.raises(InputError, match="cannot be written"):
        io.write_text(tmp_path / "file" / "a.txt", "x")
    with pytest.raises(InputError, match="cannot be written"):
        io.write_text(tmp_path / ("a" * 300), "x")
    io.write_text(os.devnull, "x")


# --------------- long files in pieces: the same trajectories as from the whole, from a file instead of memory
def runs(trials: int = 5, rows: int = 40) -> la.Trajectories:
    rng = np.random.default_rng(0)
    items = []
    for k in range(trials):
        t = np.sort(rng.uniform(0.0, 4.0, rows + k))
        q = np.column_stack([3.0 * np.sin(t), rng.standard_normal(t.size)])
        forces = np.cos(q)
        q[k, 1] = np.nan
        items.append(la.Trajectory(t, q, forces, ["a", "b"], f"run {k}", velocities=2.0 * q))
    return la.Trajectories(items)


LAYOUT = {
    "forces": {"a": "a_force", "b": "b_force"},
    "velocities": {"a": "a_dot", "b": "b_dot"},
}


def same(one: la.Trajectories, other: la.Trajectories) -> None:
    assert one.digest() == other.digest()
    assert one.names == other.names
    assert one.wraps_removed == other.wraps_removed


@pytest.fixture(params=["csv", "csv.gz", "parquet"])
def long_file(request, tmp_path, monkeypatch):
    """The runs in a file whose pieces end anywhere."""
    data = runs()
    path = io.write_csv(tmp_path / f"runs.{request.param.replace('parquet', 'csv')}", data)
    monkeypatch.setattr(text_module, "_PIECE", 1000)
    if request.param == "parquet":
        import pandas as pd

        path = tmp_path / "runs.parquet"
        table = pa.Table.from_pandas(pd.read_csv(tmp_path / "runs.csv"))
        parquet.write_table(table, path, row_group_size=33)
    return path


def test_a_stream_is_the_same_as_the_file_read_whole(long_file):
    streamed = la.stream(long_file, ["a", "b"], **LAYOUT)
    same(streamed, la.read(long_file, ["a", "b"], **LAYOUT))
    turned = la.stream(long_file, ["a", "b"], angles=["a"], **LAYOUT)
    same(turned, la.read(long_file, ["a", "b"], angles=["a"], **LAYOUT))


def test_the_samples_are_in_a_file_and_stay_as_they_are(long_file):
    streamed = la.stream(long_file, ["a", "b"], **LAYOUT)
    held = streamed[2].q
    while isinstance(held, np.ndarray):
        assert not held.flags.writeable
        held = held.base
    assert type(held).__name__ in ("mmap", "memoryview")
    assert la.Trajectories(list(pickle.loads(pickle.dumps(streamed)))).digest() == streamed.digest()
    last = streamed[4].rows(slice(5, None))
    del streamed
    assert np.isfinite(last.q[:, 0]).all()


def test_several_files_are_trials_of_one_system(tmp_path):
    data = runs(3)
    first = io.write_csv(tmp_path / "first.csv", data[:2])
    second = io.write_csv(tmp_path / "second.csv", data[2:])
    same(la.stream([first, second], ["a", "b"]), la.read([first, second], ["a", "b"]))


def test_a_file_without_trials_is_one(tmp_path, monkeypatch):
    monkeypatch.setattr(text_module, "_PIECE", 50)
    rows = "".join(f"\n{k},{np.sin(k)}" for k in range(30))
    (tmp_path / "one.csv").write_text("# made by hand\nt,x" + rows)
    same(la.stream(tmp_path / "one.csv", ["x"]), la.read(tmp_path / "one.csv", ["x"]))


def test_a_cell_may_hold_line_ends_and_a_piece_does_not_cut_it(tmp_path, monkeypatch):
    monkeypatch.setattr(text_module, "_PIECE", 40)
    rows = "".join(f'\n{k},{k / 7},"a note\nof two lines"' for k in range(12))
    (tmp_path / "one.csv").write_text("t,x,note" + rows)
    same(la.stream(tmp_path / "one.csv", ["x"]), la.read(tmp_path / "one.csv", ["x"]))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["a,0,1"] * 5, r"line 3, column 't': time 0.0 repeats"),
        ([f"{'aabab'[k // 6]},{k},1" for k in range(30)], "continues after another trial .it started at"),
        (
            [f"{'ab'[k // 6]},{k},{'x' if k == 11 else 1}" for k in range(12)],
            r"line 13, column 'x': 'x'",
        ),
        ([f"a,{k},{k}" for k in range(8)] + ["b,8"], r"line 10: there are 2 cells"),
        ([], "no data lines"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(tmp_path, monkeypatch, lines, message):
    monkeypatch.setattr(text_module, "_PIECE", 20)
    (tmp_path / "run.csv").write_text("\n".join(["trial,t,x", *lines]) + "\n")
    with pytest.raises(InputError, match=message):
        la.stream(tmp_path / "run.csv", ["x"])


def test_files_that_cannot_be_streamed(tmp_path):
    with pytest.raises(InputError, match="cannot be read in pieces"):
        la.stream(tmp_path / "run.npz", ["x"])
    with pytest.raises(InputError, match="no such file"):
        la.stream(tmp_path / "run.csv", ["x"])
    (tmp_path / "run.csv").write_text("trial,t,x" + "".join(f"\na,{k},1" for k in range(3)))
    with pytest.raises(DataError, match="only 3 sample"):
        la.stream(tmp_path / "run.csv", ["x"])
    (tmp_path / "run.csv.gz").write_bytes(gzip.compress(b"t,x\n" + b"0,1\n" * 50)[:-12])
    with pytest.raises(InputError, match="cannot be read to its end"):
        la.stream(tmp_path / "run.csv.gz", ["x"])
    (tmp_path / "latin.csv").write_bytes(b"t,x\n0,\xe9\n")
    with pytest.raises(InputError, match="line 2, column 'x': 'é' is not a number"):
        la.stream(tmp_path / "latin.csv", ["x"])


def test_memory_does_not_grow_with_the_file(tmp_path, monkeypatch):
    monkeypatch.setattr(text_module, "_PIECE", 20_000)
    peaks = []
    for trials in (5, 40):
        path = io.write_csv(tmp_path / f"{trials}.csv", runs(trials, 400))
        la.stream(path, ["a", "b"], **LAYOUT)  # what is imported on the way
        tracemalloc.start()
        la.stream(path, ["a", "b"], **LAYOUT)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0]


@pytest.mark.thorough
def test_a_law_is_found_on_a_stream(tmp_path, monkeypatch):
    data = la.systems.generate("single_pendulum", noise=0.05, trials=4, duration=10.0, seed=0)
    path = io.write_csv(tmp_path / "pendulum.csv", data)
    monkeypatch.setattr("leastaction.estimation.streamed._LONG", 1)
    monkeypatch.setattr("leastaction.api.ENOUGH_SAMPLES", data.n_samples // 2)
    options = {"library": la.systems.compact_library("single_pendulum")}
    streamed = la.stream(path, ["theta"], forces={"theta": "theta_force"})
    one, other = la.discover(data, **options), la.discover(streamed, **options)
    assert [t.expression for t in one.terms] == [t.expression for t in other.terms]
    assert [t.coefficient for t in one.terms] == [t.coefficient for t in other.terms]


TYPES = get_typestore(Stores.ROS2_HUMBLE)
STATE, STRING = "sensor_msgs/msg/JointState", "std_msgs/msg/String"
START = 1_700_000_000_000_000_000  # ns since 1970
TEN_MS = 10_000_000


def state(stamp, names, position, effort=()):
    make = TYPES.types
    time = make["builtin_interfaces/msg/Time"](*divmod(stamp, 1_000_000_000))
    header = make["std_msgs/msg/Header"](time, "base")
    arrays = (np.asarray(values, dtype=float) for values in (position, [], effort))
    return make[STATE](header, list(names), *arrays)


def plain(k):
    """Sample k of a bag in which nothing is odd."""
    return state(START + k * TEN_MS, ["a", "b"], [k / 10, -k], [1.0, 2.0 + k])


@pytest.fixture
def bag(tmp_path):
    """Return a function that writes messages, by topic, into a bag, and returns the file."""

    def write(messages, name="run", plugin=StoragePlugin.MCAP, compression=False):
        folder = tmp_path / name
        writer = Writer(folder, version=9, storage_plugin=plugin)
        if compression:
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        topics = messages if isinstance(messages, dict) else {"/joint_states": messages}
        with writer:
            for topic, items in topics.items():
                kind = items[0].__msgtype__ if items else STATE
                connection = writer.add_connection(topic, kind, typestore=TYPES)
                for k, message in enumerate(items):
                    data = TYPES.serialize_cdr(message, message.__msgtype__)
                    # Recorded 3 ms late, more or less.
                    writer.write(connection, START + k * TEN_MS + 3_000_000 + (k % 3) * 500_000, data)
        return next(path for path in folder.iterdir() if path.suffix in (".mcap", ".db3"))

    return write


@pytest.mark.parametrize("plugin", list(StoragePlugin))
@pytest.mark.parametrize("compression", [False, True])
@pytest.mark.parametrize("directory", [False, True])
def test_file_and_directory_of_either_kind(bag, plugin, compression, directory):
    if compression and plugin is not StoragePlugin.MCAP:
        pytest.skip("SQLite bags are compressed as whole files, which need their directory")
    path = bag([plain(k) for k in range(20)], plugin=plugin, compression=compression)
    path = path.parent if directory else path
    runs = io.read(path, {"theta": "b", "phi": "a"}, forces={"theta": "effort"})
    assert runs.names == ("run",)
    np.testing.assert_allclose(runs[0].t, np.arange(20) / 100, atol=1e-12)
    np.testing.assert_array_equal(runs[0].q, np.column_stack([-np.arange(20.0), np.arange(20) / 10]))
    np.testing.assert_array_equal(runs[0].forces, np.column_stack([2.0 + np.arange(20), np.zeros(20)]))


def test_ways_to_name_joints_and_efforts(bag):
    path = bag([plain(k) for k in range(8)])
    all_of_them = dict(coordinates={"a": "a", "b": "b"}, forces={"a": "a.effort", "b": "b.effort"})
    expected = io.read_mcap(path, **all_of_them).digest()
    assert io.read_mcap(path, joints=["a", "b"], forces="effort").digest() == expected
    assert io.read_mcap(path, coordinates=["a", "b"], forces=["effort", "b.effort"]).digest() == expected
    assert io.read(path, ["a", "b"], forces=["effort", "effort"]).digest() == expected
    swapped = io.read_mcap(path, coordinates=["x"], joints="b", forces={"x": "a.effort"})
    np.testing.assert_array_equal(swapped[0].forces[:, 0], np.ones(8))
    assert io.read_mcap(path, joints=["a"])[0].forces is None
    # Of two bags the second one is a trial of its own, which also starts at zero.
    later = bag([plain(k + 100) for k in range(9)], "later")
    runs = io.read_mcap([path, later], joints=["a"])
    assert runs.names == ("run", "later")
    assert runs[1].t[0] == 0.0
    with pytest.raises(InputError, match="leave out joints"):
        io.read_mcap(path, joints=["a"], coordinates={"x": "a"})
    with pytest.raises(InputError, match="1 joints for 2 coordinates"):
        io.read_mcap(path, joints=["a"], coordinates=["x", "y"])
    with pytest.raises(InputError, match="name the joints"):
        io.read_mcap(path)


def test_time_of_recording(bag):
    path = bag([plain(k) for k in range(9)])
    runs = io.read_mcap(path, joints=["a"], time="log")
    np.testing.assert_allclose(runs[0].t, np.arange(9) / 100 + 0.0005 * (np.arange(9) % 3), atol=1e-12)
    unstamped = bag([state(0, ["a"], [k]) for k in range(9)], "unstamped")
    with pytest.warns(DataWarning, match="no stamps; times are those of recording"):
        fallen_back = io.read_mcap(unstamped, joints=["a"])
    np.testing.assert_array_equal(fallen_back[0].t, runs[0].t)
    # A simulated clock starts at zero.
    simulated = bag([state(k * TEN_MS, ["a"], [k]) for k in range(9)], "simulated")
    np.testing.assert_allclose(io.read_mcap(simulated, joints=["a"])[0].t, np.arange(9) / 100)
    some = bag(
        [state(0 if k == 4 else plain(k).header.stamp.sec * 10**9, ["a"], [k]) for k in range(9)], "some"
    )
    with pytest.raises(InputError, match="message 4: the header has no stamp, but others have"):
        io.read_mcap(some, joints=["a"])


def test_sequence_of_joints_and_joints_that_are_lacking(bag):
    messages = []
    for k in range(12):
        names, values, effort = ["a", "b", "gripper"], [k, -k, 7.0], [1.0 + k, 5.0, 0.0]
        kept = [0, 2] if k == 5 else [2] if k == 6 else [2, 1, 0] if k % 2 else [0, 1, 2]
        pick = [[sequence[i] for i in kept] for sequence in (names, values, effort)]
        messages.append(state(START + k * TEN_MS, *pick))
    path = bag(messages)
    runs = io.read_mcap(path, joints=["a", "b"])
    k = np.array([0, 1, 2, 3, 4, 5, 7, 8, 9, 10, 11.0])  # message 6 has neither
    np.testing.assert_allclose(runs[0].t, k / 100)
    np.testing.assert_array_equal(runs[0].q, np.column_stack([k, np.where(k == 5, np.nan, -k)]))
    with pytest.warns(DataWarning, match=r"1 of 12 values of a\.effort are missing and were interpolated"):
        driven = io.read_mcap(path, joints=["a"], forces="effort")
    np.testing.assert_allclose(driven[0].forces[:, 0], 1.0 + k)


def test_controllers_with_joints_of_their_own(bag):
    """Two controllers report in turn, with the same stamps or with stamps between."""
    for shift in (0, TEN_MS // 2):
        messages = []
        for k in range(10):
            messages.append(state(START + k * TEN_MS, ["a"], [k], [k]))
            messages.append(state(START + k * TEN_MS + shift, ["b"], [-k], [3.0]))
        path = bag(messages, f"run{shift}")
        q = io.read_mcap(path, joints=["a", "b"])[0].q
        assert q.shape == ((10, 2) if shift == 0 else (20, 2))
        for column, sign in ((0, 1), (1, -1)):
            np.testing.assert_array_equal(q[np.isfinite(q[:, column]), column], sign * np.arange(10.0))


def test_repeated_and_late_messages(bag):
    repeated = [plain(k) for k in (0, 1, 1, 2, 3, 5, 4, 6, 7)]
    path = bag(repeated)
    runs = io.read_mcap(path, joints=["a"])
    np.testing.assert_allclose(runs[0].t, np.arange(8) / 100)
    np.testing.assert_array_equal(runs[0].q[:, 0], np.arange(8) / 10)
    repeated[2] = state(START + TEN_MS, ["a"], [9.0])
    with pytest.warns(DataWarning, match=r"1 message\(s\) repeat a time with other values"):
        runs = io.read_mcap(bag(repeated, "conflict"), joints=["a"])
    np.testing.assert_array_equal(runs[0].q[:, 0], np.arange(8) / 10)
    reset = [*(plain(k) for k in range(500, 510)), *(plain(k) for k in range(8))]
    with pytest.raises(InputError, match=r"message 10: the stamp is 5.09 s before .* clock was set back"):
        io.read_mcap(bag(reset, "reset"), joints=["a"])


def test_topics(bag):
    states = [plain(k) for k in range(8)]
    text = [TYPES.types[STRING]("hello")]
    path = bag({"/left/joint_states": states, "/right/joint_states": states[:6], "/log": text})
    with pytest.raises(InputError, match=r"in the topics '?/left/joint_states'?, .*name one"):
        io.read(path, ["a"])
    assert io.read_mcap(path, joints=["a"], topic="/right/joint_states")[0].n_times == 6
    qualified = io.read(path, {"a": "/left/joint_states:a"}, forces={"a": "/left/joint_states:b.effort"})
    assert qualified[0].n_times == 8
    np.testing.assert_array_equal(qualified[0].forces[:, 0], 2.0 + np.arange(8))
    with pytest.raises(InputError, match="take those of one topic"):
        io.read(path, {"a": "/left/joint_states:a", "b": "/right/joint_states:b"})
    with pytest.raises(InputError, match="no topic '/middle'; with joint states it has"):
        io.read_mcap(path, joints=["a"], topic="/middle")
    with pytest.raises(InputError, match="topic '/log' is of type std_msgs/msg/String"):
        io.read_mcap(path, joints=["a"], topic="/log")
    with pytest.raises(InputError, match=r"has no topic of type .*; its topics are"):
        io.read(bag({"/log": text}, "text"), ["a"])
    with pytest.raises(InputError, match="there is no message"):
        io.read(bag({"/joint_states": []}, "empty"), ["a"])


def test_what_cannot_be_used_is_named(bag, monkeypatch):
    path = bag([plain(k) for k in range(8)])
    with pytest.raises(
        InputError, match=r"no column 'c' .*; its columns are t, log, a, b, 'a\.effort', 'b\.effort'"
    ):
        io.read(path, ["c"])
    with pytest.raises(
        InputError, match=r"on a is the column 'b', which is not an effort; write 'b\.effort'"
    ):
        io.read(path, ["a"], forces=["b"])
    no_effort = bag([state(START + k * TEN_MS, ["a"], [k]) for k in range(8)], "none")
    with pytest.raises(InputError, match=r"there is no effort in column 'a\.effort'"):
        io.read_mcap(no_effort, joints=["a"], forces="effort")
    odd = bag([plain(0), state(START + 1, ["a", "b"], [1.0])], "odd")
    with pytest.raises(InputError, match=r"message 1: there are 1 values of position for 2 joint\(s\)"):
        io.read_mcap(odd, joints=["a"])
    twice = bag([state(START, ["a", "a"], [1.0, 2.0])], "twice")
    with pytest.raises(InputError, match="message 0: a joint is named twice"):
        io.read_mcap(twice, joints=["a"])
    with pytest.raises(DataError, match="only 3"):
        io.read_mcap(bag([plain(k) for k in range(3)], "short"), joints=["a"])
    velocities_only = bag([state(START + k * TEN_MS, ["a"], []) for k in range(8)], "speed")
    with pytest.raises((InputError, DataError), match=r"speed\.mcap"):
        io.read_mcap(velocities_only, joints=["a"])
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(ImportError, match=r"pip install 'leastaction\[ros\]'"):
        io.read(path, ["a"])


def one_line(path):
    with pytest.raises((InputError, DataError)) as caught:
        io.read(path, ["a"])
    text = str(caught.value)
    assert path.name in text
    assert "\n" not in text
    assert len(text) < 600
    return text


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_damaged_bags_give_one_readable_line(bag, tmp_path, plugin):
    path = bag([plain(k) for k in range(200)], plugin=plugin)
    data = path.read_bytes()
    for part in (1, 8, 50, len(data) // 2, len(data) - 1):
        cut = tmp_path / f"cut{path.suffix}"
        cut.write_bytes(data[:part])
        try:
            io.read(cut, ["a"])
        except (InputError, DataError):
            assert "cut" in one_line(cut)
        else:
            # SQLite does not look at its last byte.
            assert (plugin, part) == (StoragePlugin.SQLITE3, len(data) - 1)
    for content in (b"", b"t,a\n0,1\n", bytes(5000)):
        other = tmp_path / f"other{path.suffix}"
        other.write_bytes(content)
        one_line(other)
    assert "no such file" in one_line(tmp_path / f"none{path.suffix}")
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "metadata.yaml").write_text("rosbag2_bagfile_information: [")
    one_line(tmp_path / "broken")


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=8))
def test_flipped_bytes_never_escape(bag, tmp_path, flips):
    path = tmp_path / "good.mcap"
    if not path.exists():
        path.write_bytes(bag([plain(k) for k in range(30)]).read_bytes())
    data = bytearray(path.read_bytes())
    for place, value in flips:
        data[int(place * len(data))] = value
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        try:
            io.read(bad, ["a"])
        except (InputError, DataError):
            one_line(bad)


def test_command_line(bag, tmp_path):
    t = np.arange(800) * TEN_MS
    messages = [state(int(k), ["joint"], [np.cos(2e-9 * k)]) for k in t]
    path = bag(messages)
    command = ["discover", str(path), "--coordinates", "x=joint", "--known", "x_dot**2=1", "--output"]
    (tmp_path / "library.txt").write_text("x_dot**2\nx**2\nx**4")
    command += [str(tmp_path / "found"), "--library", str(tmp_path / "library.txt")]
    done = CliRunner().invoke(program, command)
    assert not done.exit_code, done.stderr
    assert "x**2" in done.stdout
    assert "x**4" not in done.stdout
    unstamped = bag([state(0, ["joint"], [0.1 * k]) for k in range(9)], "unstamped")
    done = CliRunner().invoke(
        program,
        ["validate", str(tmp_path / "found" / "model.json"), str(unstamped), "--coordinates", "x=joint"],
    )
    assert "the headers have no stamps" in done.stderr.partition("warning: ")[2]
