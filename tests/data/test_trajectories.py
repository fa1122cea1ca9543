"""Units as files state them, and trajectories."""

from __future__ import annotations

import copy
import dataclasses
import datetime
import itertools
import math
import pickle
import sys
import time
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pandas as pd
import polars as pl
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import leastaction as la
from leastaction import InputError, io
from leastaction.cli import program
from leastaction.data.formats import text as text_module
from leastaction.data.formats.units import normal, parted, parts_of_date, unit_of
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.data.trajectory import common_units
from leastaction.findings import find
from leastaction.model.term import ModelTerm

K = np.arange(6)
DEGREES = np.radians(10.0 * K)


def table(header, row, units=None, count=6):
    """A header, perhaps a row of units, and rows made of a template over k."""
    lines = [header, *([units] if units else []), *(row.format(k=k, ten=10 * k) for k in range(count))]
    return "\n".join(lines) + "\n"


def codes(runs):
    return [finding.code for finding in runs.findings]


# --- how numbers are written ------------------------------------------------------------------------


@pytest.mark.parametrize("delimiter", [";", "\t", "; "])
@pytest.mark.parametrize("quoted", [False, True])
def test_decimal_commas(file, delimiter, quoted):
    cell = '"0,{k}"' if quoted else "0,{k}"
    path = file(table(f"t{delimiter}x", f"{{k}},5{delimiter}{cell}"))
    runs = io.read(path, ["x"])
    np.testing.assert_array_equal(runs[0].t, K + 0.5)
    np.testing.assert_array_equal(runs[0].q[:, 0], K / 10)
    assert codes(runs) == ["decimal-comma"]


@pytest.mark.parametrize(
    "text",
    [
        table("t  phi", "  {k}.5   {ten}  "),
        table("# made by a script\n# t phi", "{k}.5 {ten}"),  # as numpy.savetxt writes it
        table("t phi", "{k},5     {ten}", units="s    deg"),
        table("t phi", "{k}.5\t {ten}"),
        table("t phi", "{k}.5 {ten}\n"),
    ],
)
@pytest.mark.parametrize("reader", [io.read, io.stream])
def test_columns_parted_by_spaces(file, text, reader, monkeypatch):
    monkeypatch.setattr(text_module, "_PIECE", 30)
    runs = reader(file(text), ["phi"], units={"phi": "deg"})
    np.testing.assert_array_equal(runs[0].t, K + 0.5)
    np.testing.assert_array_equal(runs[0].q[:, 0], DEGREES)


@pytest.mark.parametrize(
    ("header", "row", "name"),
    [
        ("Time,phi", "{k},{ten}", "Time"),
        ("time_s;phi", "{k};{ten}", "time_s"),
        ("Zeit [s];phi", "{k};{ten}", "Zeit [s]"),
        ("timestamp phi", "{k} {ten}", "timestamp"),
    ],
)
def test_the_column_of_the_times_may_have_another_name(file, header, row, name):
    runs = io.read(file(table(header, row)), ["phi"])
    np.testing.assert_array_equal(runs[0].t, K)
    assert runs.findings == (find("time-column", column=name),)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("Time,time,phi", r"has no column 't' \(time\), but Time, time; give one of these names in full"),
        ("clock,tick,phi", r"has no column 't' \(time\); .*tick, phi; give the name of the column"),
    ],
)
def test_the_column_of_the_times_is_not_guessed(file, header, message):
    path = file(table(header, "{k},{k},{ten}"))
    with pytest.raises(InputError, match=message):
        io.read(path, ["phi"])
    assert codes(io.read(path, ["phi"], time=header.partition(",")[0])) == []


def test_commas_in_text_are_no_decimal_commas(file):
    path = file(table("trial;t;x;note", "a,b;{k}.5;{k};1,5 volt, or so"))
    runs = io.read(path, ["x"])
    assert runs.names == ("a,b",)
    assert runs[0].t[0] == 0.5
    assert runs.findings == ()


def test_a_decimal_comma_after_whole_numbers(file):
    rows = [f"{k};{k};a,b" for k in range(3)] + [f"{k},5;-{k},25e-1;" for k in range(3, 6)]
    runs = io.read(file("\n".join(["t;x;note", *rows])), ["x"])
    np.testing.assert_allclose(runs[0].q[:, 0], [0, 1, 2, -0.325, -0.425, -0.525], rtol=1e-15)
    assert codes(runs) == ["decimal-comma"]


@given(
    st.lists(
        st.floats(-1e6, 1e6, allow_subnormal=False).map(lambda x: x + 0.0),
        min_size=5,
        max_size=9,
        unique=True,
    ),
    st.sampled_from([";", "\t"]),
)
def test_a_decimal_comma_reads_back_exactly(tmp_path_factory, values, delimiter):
    rows = [f"{k},5{delimiter}{x!r}".replace(".", ",") for k, x in enumerate(values)]
    path = tmp_path_factory.mktemp("comma") / "run.csv"
    path.write_text("\n".join([f"t{delimiter}x", *rows]) + "\n")
    assert io.read(path, ["x"])[0].q[:, 0].tolist() == values


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (table("t,x", "{k},5,0,{k}"), r"line 2: there are 4 cells.* separate the cells by semicolons"),
        (table("t;x", "{k};1.23{k},5"), r"line 2, column 'x': '1.230,5' is not a number; .*thousands"),
        (table("t;x", "{k},5;1,23{k}.5"), r"line 2, column 'x': '1,230.5' is not a number; .*thousands"),
        (table("t;x", "{k};1 23{k}"), r"'1 230' is not a number; .*thousands"),
        (table("t;x", "{k};1\N{NO-BREAK SPACE}23{k},5"), r"is not a number; .*thousands"),
        ("t;x\n0,5;0\n1.5;0\n", r"line 3, column 't': '1.5' .*the first fraction has a decimal comma"),
        ("t;x\n0.5;0\n1,5;0\n", r"line 3, column 't': '1,5' .*write a decimal point"),
        (table("t,x", '"{k},5",0'), r"'0,5' is not a number; write a decimal point"),
    ],
)
def test_numbers_written_in_several_ways(file, text, message):
    with pytest.raises(InputError, match=message):
        io.read(file(text), ["x"])


@pytest.mark.parametrize(
    ("encoding", "said"),
    [
        ("utf-8", []),
        ("utf-8-sig", []),
        ("cp1252", ["Windows-1252"]),
        ("latin-1", ["Windows-1252"]),
        ("utf-16", ["UTF-16"]),
    ],
)
@pytest.mark.parametrize("reader", [io.read, io.stream])
def test_encodings(file, encoding, said, reader, monkeypatch):
    monkeypatch.setattr(text_module, "_PIECE", 40)
    path = file(table("Zeit / s;Winkel (°);Größe", "{k};{ten};für").encode(encoding))
    runs = reader(path, {"theta": "Winkel"}, time="Zeit")
    np.testing.assert_array_equal(runs[0].q[:, 0], DEGREES)
    assert [f.values["encoding"] for f in runs.findings if f.code == "text-encoding"] == said


def test_a_stream_that_changes_its_encoding(file, monkeypatch):
    monkeypatch.setattr(text_module, "_PIECE", 40)
    path = file(table("t,x,note", "{k},{k},abc", count=30).encode() + b"30,30,\xe9\n")
    with pytest.raises(InputError, match="changes its encoding within the file"):
        io.stream(path, ["x"])
    assert io.read(path, ["x"])[0].n_times == 31


# --- units ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["time", "full"])
@pytest.mark.parametrize(
    ("header", "over"),
    [
        ("time_ms", 1e3),
        ("time [us]", 1e6),
        ("time[µs]", 1e6),
        ("time (ns)", 1e9),
        ("time / ms", 1e3),
        ("time/s", 1.0),
        ("time_s", 1.0),
        ("time in ms", 1e3),
        ("time milliseconds", 1e3),
        ("time_[ms]", 1e3),
        ("time_min", 1 / 60),
        ("time [h]", 1 / 3600),
    ],
)
def test_units_of_the_time(file, header, over, name):
    runs = io.read(file(table(f"{header};x", "{k};{k}")), ["x"], time=header if name == "full" else name)
    np.testing.assert_allclose(runs[0].t, K / over, rtol=1e-15)
    assert codes(runs) == ([] if over == 1.0 else ["time-unit"])


@pytest.mark.parametrize(
    ("header", "expected", "to"),
    [
        ("theta [deg]", DEGREES, "rad"),
        ("theta (°)", DEGREES, "rad"),
        ("theta / º", DEGREES, "rad"),
        ("theta_deg", DEGREES, "rad"),
        ("theta_DEGREES", DEGREES, "rad"),
        ("theta [rev]", 20.0 * math.pi * K, "rad"),
        ("theta_mrad", K / 100, "rad"),
        ("theta [cm]", K / 10, "m"),
        ("theta_mm", K / 100, "m"),
        ("theta (µm)", K / 1e5, "m"),
        ("theta [kN]", 1e4 * K, "N"),
        ("theta [N·mm]", K / 100, "N m"),
        ("theta [deg/s]", DEGREES, "rad/s"),
        ("theta / (mm/s²)", K / 100, "m/s2"),
        ("theta [rpm]", 2 * math.pi * 10 * K / 60, "rad/s"),
    ],
)
def test_units_of_a_coordinate(file, header, expected, to):
    path = file(table(f"t;{header}", "{k};{ten}"))
    for column in ("theta", header):
        runs = io.read(path, {"theta": column})
        np.testing.assert_allclose(runs[0].q[:, 0], expected, rtol=1e-15)
        (finding,) = runs.findings
        assert (finding.code, finding.subject, finding.severity) == ("converted-units", ("theta",), "note")
        assert finding.values["column"] == header
        assert finding.values["to"] == to
    written = io.read(path, {"theta": header}, units="as-written")
    np.testing.assert_array_equal(written[0].q[:, 0], 10.0 * K)
    assert written.findings == ()


@pytest.mark.parametrize(
    "header", ["x_cm", "theta_min", "x_ms", "x (left)", "N/mm", "counts/rev", "x_h", "x [V]", "x [s]", "deg"]
)
def test_what_may_mean_something_else_stays(file, header):
    runs = io.read(file(table(f"t,{header}", "{k},{ten}")), {"x": header})
    np.testing.assert_array_equal(runs[0].q[:, 0], 10.0 * K)
    assert runs.findings == ()


def test_forces_and_rates_have_units_too(file):
    path = file(table("t,phi_deg,tau [mNm],gyro [deg/s],acc / mm/s^2", "{k},{ten},{ten},{ten},{ten}"))
    runs = io.read(
        path, ["phi"], "t", {"phi": "tau"}, velocities={"phi": "gyro"}, accelerations={"phi": "acc"}
    )
    for values, expected in [
        (runs[0].q, DEGREES),
        (runs[0].forces, K / 100),
        (runs[0].velocities, DEGREES),
        (runs[0].accelerations, K / 100),
    ]:
        np.testing.assert_allclose(values[:, 0], expected, rtol=1e-15)
    assert [f.values["quantity"] for f in runs.findings] == ["position", "force", "velocity", "acceleration"]
    assert str(runs.findings[1]) == "force of phi was converted from mNm to N m"


@pytest.mark.parametrize("units", ["ms;deg;Nm;V", "[ms];[°];[N m];[]", "(ms);(deg);;-"])
@pytest.mark.parametrize("blank", ["", "\n"])
def test_a_row_of_units(file, units, blank):
    path = file(blank + table("t;phi;tau;u", "{k},5;{ten};{k};{k}", units=blank + units))
    runs = io.read(path, ["phi"], forces=["tau"])
    np.testing.assert_allclose(runs[0].t, (K + 0.5) / 1e3, rtol=1e-15)
    np.testing.assert_array_equal(runs[0].q[:, 0], DEGREES)
    assert codes(runs) == ["units-row", "time-unit", "converted-units", "decimal-comma"]
    with pytest.raises(InputError, match=rf"line {5 + 2 * len(blank)}, column 'phi': 'x' is not"):
        io.read(file(path.read_text().replace(";20;", ";x;")), ["phi"])


def test_a_row_of_text_is_no_row_of_units(file):
    for row in ("a,b", "-,-", "s,0.5", "abc,1e3"):
        with pytest.raises(InputError, match=r"line 2, column '.': '.*' is not a number"):
            io.read(file(table("t,x", "{k},{k}", units=row)), ["x"])


def test_what_the_user_says_wins(file):
    path = file(table("time_ms,phi [deg],tau", "{k},{ten},{ten}"))
    said = io.read(path, ["phi"], "time", ["tau"], time_unit="us", units={"phi": "rad", "tau": "Nmm"})
    np.testing.assert_allclose(said[0].t, K / 1e6, rtol=1e-15)
    np.testing.assert_array_equal(said[0].q[:, 0], 10.0 * K)
    np.testing.assert_allclose(said[0].forces[:, 0], K / 100, rtol=1e-15)
    assert [str(f) for f in said.findings] == [
        "the times in 'time_ms' were converted from us to seconds, as requested, instead of ms",
        "phi was read as rad, as requested, instead of deg",
        "force of phi was converted from Nmm to N m",
    ]
    seconds = io.read(path, {"phi": "phi [deg]"}, "time_ms", time_unit="s", units="as-written")
    np.testing.assert_array_equal(seconds[0].t, K)
    plain = file(table("t,x", "{k},{k}"), "plain.csv")
    assert io.read(plain, ["x"], time_unit="s").findings == ()
    assert io.read(plain, ["x"], time_unit="ms")[0].t[-1] == 0.005


@pytest.mark.parametrize(
    ("header", "units", "arguments", "message"),
    [
        ("t,x", None, dict(time_unit="minutes ago"), "time_unit is 'minutes ago'; expected one of s, ms, us"),
        ("t,x", None, dict(time_unit="deg"), "time_unit is 'deg'; expected one of s"),
        ("t,x", None, dict(time_unit=3), "time_unit is 3; expected"),
        ("t,x", None, dict(units="metric"), "units is 'metric'; expected 'SI', 'as-written', or a mapping"),
        ("t,x", None, dict(units=7), "units is 7; expected"),
        ("t,x", None, dict(units={"x": "parsec"}), "the unit of 'x' is 'parsec', which is not known"),
        ("t,x", None, dict(units={"x": None}), "the unit of 'x' is None"),
        ("t,x", None, dict(units={3: "m"}), "units names 3"),
        ("t,x", None, dict(units={"y": "deg"}), r"has no column 'y' \(units\)"),
        ("t,x,y", None, dict(units={"y": "deg"}), "units names 'y', which is not a column that is read"),
        ("t,x_mm", None, dict(units={"x": "mm", "x_mm": "cm"}), "names the column 'x_mm' twice, also as"),
        ("t,x", None, dict(units={"x": "ms"}), "the unit of 'x' is ms, which is a time"),
        ("t,x", None, dict(units={"t": "mm"}), "the unit of 't' is mm, which is not a time"),
        ("t,x", None, dict(units={"t": "s"}, time_unit="ms"), "given twice, in time_unit and in units"),
        ("t [m],x", None, {}, r"column 't \[m\]' is in m, which is not a unit of time"),
        ("t_ms,x", "s,m", {}, "'t_ms' is in ms by its name, but in s by the row below .*with time_unit"),
        ("t,x_mm", "s,cm", {}, "'x_mm' is in mm by its name, but in cm by the row below .*with units"),
        ("t_ms,t [us],x", None, {}, r"no column 't' \(time\), but t_ms, 't \[us\]'; give one of these"),
    ],
)
def test_units_that_are_refused(file, header, units, arguments, message):
    path = file(table(header, ",".join(["{k}"] * (header.count(",") + 1)), units=units))
    with pytest.raises(InputError, match=message):
        io.read(path, ["x"], **arguments)


def test_the_user_settles_a_contradiction(file):
    path = file(table("t_ms,x_mm", "{k},{ten}", units="s,cm"))
    runs = io.read(path, ["x"], time_unit="ms", units={"x": "cm"})
    assert runs[0].t[-1] == 0.005
    assert runs[0].q[-1, 0] == pytest.approx(0.5)
    assert io.read(path, ["x"], units="as-written")[0].q[-1, 0] == 50.0


def test_an_exact_name_comes_first(file):
    runs = io.read(file(table("t,t_ms,x,x_mm", "{k},9,{k},9")), ["x"])
    np.testing.assert_array_equal(runs[0].q[:, 0], K)
    assert runs.findings == ()


@given(st.sampled_from(["ms", "us", "ns", "s"]), st.lists(st.integers(0, 10**9), min_size=6, unique=True))
def test_decimal_fractions_of_a_second_are_exact(tmp_path_factory, unit, ticks):
    digits = {"s": 0, "ms": 3, "us": 6, "ns": 9}[unit]
    rows = [f"{tick},{k}" for k, tick in enumerate(sorted(ticks))]
    path = tmp_path_factory.mktemp("ticks") / "run.csv"
    path.write_text("\n".join([f"t_{unit},x", *rows]) + "\n")
    assert io.read(path, ["x"])[0].t.tolist() == [float(f"{tick}e-{digits}") for tick in sorted(ticks)]


def test_variables_of_arrays_and_frames(tmp_path):
    columns = {"time_ms": K, "phi_deg": 10.0 * K}
    np.savez(tmp_path / "run.npz", **columns)
    pd.DataFrame(columns).to_parquet(tmp_path / "run.parquet")
    results = [
        io.read(tmp_path / "run.npz", ["phi"], time="time"),
        io.read(tmp_path / "run.parquet", ["phi"], time="time"),
        io.stream(tmp_path / "run.parquet", ["phi"], time="time"),
        io.from_frame(pl.DataFrame(columns), ["phi"], time="time"),
    ]
    for runs in results:
        np.testing.assert_array_equal(runs[0].t, K / 1e3)
        np.testing.assert_array_equal(runs[0].q[:, 0], DEGREES)
        assert codes(runs) == ["time-unit", "converted-units"]


def test_parquet_knows_whom_a_unit_was_given_for(tmp_path):
    columns = {"t [ms]": K, "a": 10.0 * K, "b": 1.0 * K, "trial": [1] * 6}
    pd.DataFrame(columns).to_parquet(tmp_path / "run.parquet")
    for reader in (io.read, io.stream):
        runs = reader(tmp_path / "run.parquet", {"b": "a", "a": "b"}, time_unit="us", units={"b": "deg"})
        np.testing.assert_array_equal(runs[0].t, K / 1e6)
        np.testing.assert_array_equal(runs[0].q, np.column_stack([DEGREES, K]))
        assert runs.findings[0].values["instead_of"] == "ms"


def test_what_overflows_is_refused(file):
    with pytest.raises(InputError, match="infinite"):
        io.read(file(table("t,x [rev]", "{k},1e308")), ["x"])


@pytest.mark.parametrize("text", ["", " ", "[]", "()", "furlong", "s/s", "°C", "1", "MS", "nm", "deg/deg"])
def test_no_unit(text):
    assert unit_of(text) is None


PARTS = ["t", " ", "x", "ms", "deg", "/", "[", "]", "(", "_", "in", "°", "·", "^", "-1", "2", "s"]


@given(st.text(max_size=30) | st.lists(st.sampled_from(PARTS)).map("".join))
def test_any_name_can_be_parted(text):
    unit_of(text)
    for of_times in (False, True):
        name, unit = parted(text, of_times)
        assert unit is not None or name == normal(text.replace("º", "°"))


@pytest.mark.parametrize("part", [" ", "_", "/", "[", "a_", "/s", "in ", "·s-1"])
def test_long_names_take_no_time(file, part):
    name = ("a" + 100_000 * part)[:100_000]
    began = time.process_time()
    with pytest.raises(InputError, match="no column 'x'"):
        io.read(file(table(f"t;{name};y", "{k};{k};{k}", units="s;s;s")), ["x"])
    assert time.process_time() - began < 2.0


# --- dates ------------------------------------------------------------------------------------------

START = datetime.datetime(2024, 5, 1, 12, 0, 0, 250_000)
MOMENTS = [START + datetime.timedelta(seconds=0.125 * k) for k in range(6)]


@pytest.mark.parametrize("separator", ["T", " "])
@pytest.mark.parametrize("zone", ["", "Z", "+02:00", "-0530", "+02"])
@pytest.mark.parametrize("form", ["{},{}", '"{}","{}"', "{};{}"])
def test_dates_become_seconds(file, separator, zone, form):
    rows = [form.format(moment.isoformat(separator) + zone, k) for k, moment in enumerate(MOMENTS)]
    path = file("\n".join([form.format("when", "x"), *rows]) + "\n")
    runs = io.read(path, ["x"], time="when")
    np.testing.assert_array_equal(runs[0].t, 0.125 * K)
    assert codes(runs) == ["dates"]


def test_dates_have_no_unit_under_any_name(file):
    path = file("\n".join(["when [ms],x", *(f"{moment.isoformat()},1" for moment in MOMENTS)]))
    assert codes(io.read(path, ["x"], time="when")) == ["dates"]
    for said in (dict(time_unit="ms"), dict(units={"when": "s"})):
        with pytest.raises(InputError, match="are dates, which have no unit; leave out time_unit"):
            io.read(path, ["x"], time="when", **said)


def test_dates_with_decimal_commas_and_units(file):
    rows = [f"{moment.isoformat(' ').replace('.', ',')};{10 * k},0" for k, moment in enumerate(MOMENTS)]
    runs = io.read(file("\n".join(["Zeit [ms];phi [deg]", *rows])), ["phi"], time="Zeit")
    np.testing.assert_array_equal(runs[0].t, 0.125 * K)
    np.testing.assert_array_equal(runs[0].q[:, 0], DEGREES)
    assert codes(runs) == ["dates", "converted-units", "decimal-comma"]


def test_dates_count_from_the_first_of_the_file(file, monkeypatch):
    rows = [f"{'ab'[k // 6]},{(START + datetime.timedelta(seconds=k)).isoformat()},{k}" for k in range(12)]
    path = file("\n".join(["trial,t,x", *rows]))
    whole = io.read(path, ["x"])
    monkeypatch.setattr(text_module, "_PIECE", 60)
    for runs in (
        whole,
        io.stream(path, ["x"]),
        io.read([path, file(table("t,x", "{k},{k}"), "b.csv")], ["x"]),
    ):
        np.testing.assert_array_equal(runs[1].t, np.arange(6.0) + 6)


@given(st.datetimes(datetime.datetime(1900, 1, 1), datetime.datetime(2100, 1, 1)), st.integers(0, 10**12))
def test_dates_are_exact_to_a_microsecond(start, microseconds):
    later = start + datetime.timedelta(microseconds=microseconds)
    first, second = (parts_of_date(moment.isoformat())[0] for moment in (start, later))
    assert second - first == 1000 * microseconds
    assert parts_of_date(later) == (second, False)


@pytest.mark.parametrize(
    ("times", "arguments", "message"),
    [
        (["2024-05-01T12:00:00", "2024-05-01T11:59:59"], {}, r"line 3, column 't': time -1.0 goes backwards"),
        (["2024-05-01T12:00:00"] * 2, {}, r"line 3.*repeats .*fractions of a second"),
        (
            ["2024-05-01T12:00:00", "1.5"],
            {},
            r"line 3, column 't': '1.5' is not a date; .*without a time zone",
        ),
        (["2024-05-01T12:00:00Z", "2024-05-01T12:00:01"], {}, r"line 3.* is not a date; .* with a time zone"),
        (["0.5", "2024-05-01T12:00:01"], {}, r"line 3, column 't': '2024-.* is not a number; write times as"),
        (["01.05.2024 12:00:00", "01.05.2024 12:00:01"], {}, r"line 2.*all as dates in the form 2024"),
        (["12:00:00", "12:00:01"], {}, r"line 2.*all as dates in the form 2024"),
        (["20240501T120000"], {}, r"line 2.*all as dates in the form 2024"),
        (["2024-05-01T12:00:60"], {}, r"line 2, column 't': .*is not a number; write times as numbers"),
        (["2024-05-01T12:00:00", ""], {}, r"line 3, column 't': the time is missing"),
        (["2024-05-01T12:00:00"], dict(time_unit="ms"), "are dates, which have no unit; leave out time_unit"),
    ],
)
@pytest.mark.parametrize("reader", [io.read, io.stream])
def test_dates_that_are_refused(file, times, arguments, message, reader):
    with pytest.raises(InputError, match=message):
        reader(file("\n".join(["t,x", *(f"{t},1" for t in times)])), ["x"], **arguments)


def frames_of_dates():
    naive = pd.Series(MOMENTS)
    return {
        "pandas": pd.DataFrame({"t": naive, "x": K}),
        "pandas zone": pd.DataFrame({"t": naive.dt.tz_localize("Europe/Berlin"), "x": K}),
        "pandas seconds": pd.DataFrame({"t": naive.astype("datetime64[ms]"), "x": K}),
        "pandas text": pd.DataFrame({"t": [m.isoformat() for m in MOMENTS], "x": K}),
        "pandas objects": pd.DataFrame({"t": naive.astype(object), "x": K}),
        "polars": pl.DataFrame({"t": MOMENTS, "x": K}),
        "polars zone": pl.DataFrame({"t": MOMENTS, "x": K}).with_columns(
            pl.col("t").dt.replace_time_zone("UTC")
        ),
    }


@pytest.mark.parametrize("kind", list(frames_of_dates()))
def test_dates_in_frames_and_parquet(kind, tmp_path):
    frame = frames_of_dates()[kind]
    results = [io.from_frame(frame, ["x"])]
    path = tmp_path / "run.parquet"
    if kind.startswith("pandas"):
        frame.to_parquet(path)
    else:
        frame.write_parquet(path)
    results += [io.read(path, ["x"]), io.stream(path, ["x"])]
    for runs in results:
        np.testing.assert_array_equal(runs[0].t, 0.125 * K)
        assert codes(runs) == ["dates"]


def test_durations_and_days():
    frame = pd.DataFrame({"t": pd.to_timedelta(5.0 + 0.125 * K, unit="s"), "x": K})
    runs = io.from_frame(frame, ["x"])
    np.testing.assert_array_equal(runs[0].t, 5.0 + 0.125 * K)
    assert codes(runs) == ["time-unit"]
    for named in (frame, frame.rename(columns={"t": "t [ms]"})):
        with pytest.raises(InputError, match="durations, which have units of their own; leave out time_unit"):
            io.from_frame(named, ["x"], time_unit="ms")
    days = pl.DataFrame({"t": [START.date() + datetime.timedelta(days=k) for k in range(6)], "x": K})
    np.testing.assert_array_equal(io.from_frame(days, ["x"])[0].t, 86_400.0 * K)


def test_dates_in_arrays(tmp_path):
    moments = np.array(MOMENTS, dtype="datetime64[us]")
    np.savez(tmp_path / "run.npz", t=moments[:, np.newaxis], q=10.0 * K)
    runs = io.read(tmp_path / "run.npz", {"phi": "phi [deg]"})
    np.testing.assert_array_equal(runs[0].t, 0.125 * K)
    np.testing.assert_array_equal(runs[0].q[:, 0], DEGREES)
    assert codes(runs) == ["dates", "converted-units"]
    moments[2] = "NaT"
    np.savez(tmp_path / "gap.npz", t=moments, x=K)
    with pytest.raises(InputError, match=r"row 2 .*the time is missing"):
        io.read(tmp_path / "gap.npz", ["x"])
    np.savez(tmp_path / "other.npz", t=K.astype("timedelta64[ms]"), x=K)
    with pytest.raises(InputError, match=r"has type timedelta64.* times in seconds"):
        io.read(tmp_path / "other.npz", ["x"])


def test_dates_in_frames_that_are_refused():
    missing = pd.DataFrame({"t": [pd.NaT, *MOMENTS[1:]], "x": K})
    with pytest.raises(InputError, match=r"row 0 .*column 't': the time is missing"):
        io.from_frame(missing, ["x"])
    mixed = pd.DataFrame({"t": [*MOMENTS[:5], "soon"], "x": K})
    with pytest.raises(InputError, match=r"row 5 .*'soon' is not a date like the first one"):
        io.from_frame(mixed, ["x"])


# --- Excel ------------------------------------------------------------------------------------------


@pytest.fixture
def workbook(tmp_path):
    """Return a function that writes sheets, name -> rows, to run.xlsx and returns the path."""
    openpyxl = pytest.importorskip("openpyxl")

    def write(**sheets):
        book = openpyxl.Workbook()
        book.remove(book.active)
        for name, rows in sheets.items():
            sheet = book.create_sheet(name)
            for row in rows:
                sheet.append(row)
        book.save(tmp_path / "run.xlsx")
        return tmp_path / "run.xlsx"

    return write


def test_a_workbook(workbook):
    rows = [["a", 20 * k, 10.0 * k, k if k != 2 else None, str(k)] for k in range(6)]
    rows.insert(3, [None] * 5)
    head = [["# made by hand"], [None], ["trial", "t", "phi", "x_mm", "tau"], [None, "ms", "°", "mm", "Nm"]]
    path = workbook(first=[*head, *rows], second=[["t", "x"]])
    runs = io.read(path, ["phi", "x"], forces=["tau"])
    assert runs.names == ("a",)
    np.testing.assert_array_equal(runs[0].t, K / 50)
    np.testing.assert_array_equal(runs[0].q[:, 0], DEGREES)
    np.testing.assert_array_equal(runs[0].q[:, 1], np.where(K == 2, np.nan, K / 1e3))
    np.testing.assert_array_equal(runs[0].forces[:, 0], K)
    assert codes(runs) == ["first-sheet", "units-row", "time-unit", "converted-units", "converted-units"]
    assert str(runs.findings[0]) == "only the sheet 'first' was read; the others are second"


def test_dates_in_a_workbook(workbook):
    path = workbook(run=[["when", "x"], *([moment, k] for k, moment in enumerate(MOMENTS))])
    runs = io.read(path, ["x"], time="when")
    np.testing.assert_allclose(runs[0].t, 0.125 * K, atol=2e-3)  # as exactly as Excel keeps them
    assert codes(runs) == ["dates"]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([], r"the sheet 'run' is empty"),
        ([["t", "x"]], r"has a header, but no rows below it"),
        ([[0, 1], [2, 3]], r"row 1: there are numbers where the header is expected"),
        ([["t", "y"], [0, 1]], r"has no column 'x' \(coordinate x\); its columns are t, y"),
        ([["t", "x"], [0, 1], [None, None], [1, "0,5"]], r"row 4, column 'x': '0,5' is not a number"),
        ([["t", "x"], [0, True]], r"row 2, column 'x': True is not a number"),
        ([["t", "x"], [0, 1], [None, 2]], r"row 3, column 't': the time is missing"),
        ([["t", "x"], [datetime.time(12), 1]], r"row 2, column 't': .* is not a number; .*times to seconds"),
        ([["t", "x"], [MOMENTS[0], 1], ["soon", 1]], r"row 3, column 't': 'soon' is not a date"),
    ],
)
def test_workbooks_that_are_refused(workbook, rows, message):
    with pytest.raises(InputError, match=message):
        io.read(workbook(run=rows), ["x"])


def test_files_that_are_no_workbooks(tmp_path, workbook, monkeypatch):
    data = workbook(run=[["t", "x"], *([k, k] for k in range(6))]).read_bytes()
    for content, message in [
        (b"t,x\n0,1\n", "is not an Excel file in the form .xlsx; save it"),
        (b"\xd0\xcf\x11\xe0" + bytes(50), "an old one, or one with a password"),
        (data[: len(data) // 2], "is a damaged Excel file"),
        (b"", "is empty"),
    ]:
        (tmp_path / "bad.xlsx").write_bytes(content)
        with pytest.raises(InputError, match=message) as caught:
            io.read(tmp_path / "bad.xlsx", ["x"])
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="cannot be read in pieces"):
        io.stream(tmp_path / "run.xlsx", ["x"])
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(InputError, match=r"pip install 'leastaction\[excel\]', or save the sheet as CSV"):
        io.read(tmp_path / "run.xlsx", ["x"])


# --- what is said, and where it goes ----------------------------------------------------------------


def test_findings_stay_with_the_trajectories(file):
    first = io.read([file(table("t_ms,x", "{k},{k}"), f"{k}.csv") for k in range(3)], ["x"])
    second = io.read(file(table("t;x", "{k},5;{k}")), ["x"])
    assert codes(first) == ["time-unit"]
    changed = [
        first[1:],
        first.select("2"),
        first.unwrap(["x"]),
        first.without_rates(),
        first.with_forces([None] * 3),
        first.without([np.zeros((6, 1), dtype=bool)] * 3),
        la.delay.shift_forces(first, 0.0),
        pickle.loads(pickle.dumps(first)),
        la.Trajectories([first[0].rows(slice(2, None)), first[1].changed(name="b")]),
    ]
    assert all(codes(runs) == ["time-unit"] for runs in changed)
    assert codes(la.Trajectories([*first, *second])) == ["time-unit", "decimal-comma"]
    same = io.read(file(table("t,x", "0.00{k},{k}")), ["x"])
    assert first[0].t.tolist() == same[0].t.tolist()
    assert first[:1].digest() == same.digest()


def test_findings_are_checked():
    with pytest.raises(InputError, match="findings hold 'a note'; expected objects of the class Finding"):
        la.Trajectory([0.0, 1.0], [0.0, 1.0], findings=["a note"])
    note = find("decimal-comma")
    assert la.Trajectory([0.0, 1.0], [0.0, 1.0], findings=[note]).findings == (note,)


def test_a_stream_says_the_same(file, monkeypatch):
    path = file(table("trial;t_ms;phi [deg]", "a;{k},5;{k}", count=40))
    whole = io.read(path, ["phi"], time="t")
    monkeypatch.setattr(text_module, "_PIECE", 50)
    streamed = io.stream(path, ["phi"], time="t")
    assert streamed.findings == whole.findings
    assert len(whole.findings) == 3
    assert streamed.digest() == whole.digest()


def test_discover_passes_them_on(file):
    data = la.systems.generate("single_pendulum", noise=0.01, trials=2, duration=6.0, seed=0)
    rows = [
        f"{name},{1e3 * t!r},{math.degrees(q)!r},{f!r}"
        for name, run in zip(data.names, data, strict=True)
        for t, q, f in zip(run.t.tolist(), run.q[:, 0].tolist(), run.forces[:, 0].tolist(), strict=True)
    ]
    path = file("\n".join(["trial,t_ms,theta_deg,tau", *rows]))
    runs = io.read(path, ["theta"], forces=["tau"])
    model = la.discover(runs, la.systems.compact_library("single_pendulum"))
    assert [f.code for f in model.fit.findings[:2]] == ["time-unit", "converted-units"]
    assert model.fit.notes[1] == "theta was converted from deg to rad"
    plain = la.discover(data, la.systems.compact_library("single_pendulum"))
    assert {t.expression for t in model.terms} == {t.expression for t in plain.terms}


# --- the command line -------------------------------------------------------------------------------


def command(*words):
    return CliRunner().invoke(program, [str(word) for word in words])


def recording(file):
    """A pendulum in the columns that a German program writes."""
    run = la.systems.generate("single_pendulum", noise=0.01, trials=1, duration=4.0, seed=0)[0]
    rows = [
        f"{1e3 * t:.6f};{math.degrees(q):.6f};{1e3 * f:.6f}".replace(".", ",")
        for t, q, f in zip(run.t.tolist(), run.q[:, 0].tolist(), run.forces[:, 0].tolist(), strict=True)
    ]
    return file("\r\n".join(["Zeit;Winkel;Moment", "ms;°;mNm", *rows]).encode("cp1252"))


COLUMNS = ("--coordinates", "theta=Winkel", "--time", "Zeit", "--forces", "Moment")


def test_the_command_line_reads_and_says_the_same(file, tmp_path):
    path = recording(file)
    model = la.LagrangianModel(
        "theta",
        [ModelTerm("theta_dot**2", 0.5), ModelTerm("cos(theta)", 9.81)],
        noise_std=[0.01],
    )
    model.save(tmp_path / "model.json")
    plain = command("validate", tmp_path / "model.json", path, *COLUMNS, "--json", tmp_path / "a.json")
    assert plain.exit_code == 0, plain.output
    for said in (
        "note: the row below the header was read as units: ms, °, mNm",
        "note: the times in 'Zeit' were converted from ms to seconds",
        "note: theta was converted from deg to rad",
        "note: force of theta was converted from mNm to N m",
        "note: the text is not UTF-8 and was read as Windows-1252",
        "note: numbers were read with a decimal comma",
    ):
        assert said in plain.output
    asked = ("--units", "Zeit=ms, theta=deg, Moment=mNm")
    command("validate", tmp_path / "model.json", path, *COLUMNS, *asked, "--json", tmp_path / "b.json")
    assert (tmp_path / "a.json").read_text() == (tmp_path / "b.json").read_text()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--time-unit", "days"), "--time-unit is 'days'; expected one of s, ms, us, ns, min, h"),
        (("--units", "metric"), "--units: 'metric' is neither SI nor as-written, nor of the form NAME=UNIT"),
        (("--units", "theta="), "--units: 'theta=' is not of the form NAME=UNIT"),
        (("--units", "theta=deg,theta=rad"), "--units: 'theta' is given twice"),
        (("--units", "theta=parsec"), "the unit of 'theta' is 'parsec', which is not known"),
        (("--units", "Zeit=s", "--time-unit", "s"), "given twice, in --time-unit and in --units"),
    ],
)
def test_units_that_the_command_line_refuses(file, tmp_path, options, message):
    words = ("discover", recording(file), *COLUMNS, *options, "--output", tmp_path / "found")
    done = command(*words)
    assert done.exit_code == 2
    assert message in done.output
    assert done.output.count("\n") == 1


# ----------------------------------------------------------------------------------------------- trajectories
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


# ------------------------------------------------------------------------------- units that files state
@pytest.mark.parametrize(
    ("header", "units", "stated"),
    [
        (
            "x [m],a [deg],f [N],tau [Nm]",
            "SI",
            {"position": {"x": "m", "a": "rad"}, "force": {"x": "N", "a": "N m"}},
        ),
        ("x [mm],a,f [kN],tau", "SI", {"position": {"x": "m"}, "force": {"x": "N"}}),
        ("x,a,f,tau", "SI", {}),
        ("x [mm],a [deg],f,tau", "as-written", {}),
        ("x,a,f,tau", {"x": "m", "tau": "Ncm"}, {"position": {"x": "m"}, "force": {"a": "N m"}}),
    ],
)
def test_units_that_a_file_states_stay_with_its_trajectories(tmp_path, header, units, stated):
    path = tmp_path / "run.csv"
    rows = "".join(f"{0.1 * k},{k},{0.1 * k},0,0\n" for k in range(20))
    path.write_text(f"t,{header}\n{rows}", encoding="utf-8")
    options = {"forces": {"x": "f", "a": "tau"}, "units": units}
    runs = io.read_csv(path, ["x", "a"], **options)
    assert common_units(runs) == stated
    assert common_units(pickle.loads(pickle.dumps(runs))) == stated
    assert common_units(runs.unwrap(["a"]).without_rates()[:1]) == stated
    assert common_units([runs[0].rows(slice(5)), runs[0].changed(name="b")]) == stated
    assert common_units(io.stream(path, ["x", "a"], **options)) == stated
    # a file that states nothing leaves it open which unit its numbers have
    assert common_units([*runs, Trajectory(runs[0].t, runs[0].q, coordinates=["x", "a"])]) == {}
