"""CSV files and what all readers share; other kinds of files are in test_io_formats.py."""

import gzip
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leastaction import io
from leastaction.data.formats import csv as _csv
from leastaction.data.formats import text as _text
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
            r"line 8, column 'trial': trial 'a' goes on",
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
