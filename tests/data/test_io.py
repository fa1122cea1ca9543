"""CSV files, what all readers share, and measured rates; other kinds of files are in test_io_formats.py."""

from __future__ import annotations

import gzip
import re
import time

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from helpers import with_rates
from leastaction import Trajectories, Trajectory, io, systems
from leastaction.cli import program
from leastaction.data.formats import csv as _csv
from leastaction.data.formats import text as _text
from leastaction.data.formats.bags import read_mcap
from leastaction.data.formats.layout import Layout
from leastaction.errors import DataError, InputError

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
