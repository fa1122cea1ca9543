"""The command line on bad input: the right exit code, one readable line, and nothing written."""

from __future__ import annotations

import errno
import inspect
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

import leastaction
from leastaction import systems
from leastaction.cli import failures, program

LINES = [f"{k / 50!r},{np.cos(k / 9):.6f},{np.sin(k / 20):.6f}" for k in range(100)]
SPRING = {
    "schema": 2,
    "coordinates": ["x"],
    "terms": [
        {"expression": "x_dot**2", "coefficient": 0.5, "standard_error": 0.0, "known": True},
        {"expression": "x**2", "coefficient": -2.0, "standard_error": 0.1, "known": False},
    ],
    "dissipation": [],
    "noise_std": [0.01],
    "fit": {"status": "ok", "chi2_per_sample": 1.0, "physics_weight": [1.0], "findings": [], "warnings": []},
    "provenance": {},
}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Work in an empty directory that holds good data, a library and a model."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("LEASTACTION_DEBUG", raising=False)
    table(LINES)
    (tmp_path / "lib.txt").write_text("x_dot**2\nx**2\n", encoding="utf-8")
    (tmp_path / "model.json").write_text(json.dumps(SPRING), encoding="utf-8")
    return tmp_path


def table(lines, name="run.csv", header="t,x,tau"):
    with open(name, "w", encoding="utf-8") as file:
        file.write("\n".join([header, *lines]) + "\n")
    return name


def snapshot(folder):
    return {p: p.read_bytes() if p.is_file() else None for p in folder.rglob("*")}


def fails(code, *args, says=()):
    """Run a command that must fail, and return its message."""
    folder = os.getcwd()
    before = snapshot(Path(folder))
    result = CliRunner().invoke(program, [str(a) for a in args])
    assert result.exit_code == code, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert len(result.stderr) < 600
    assert result.stderr[:-1].isprintable()
    for text in (says,) if isinstance(says, str) else says:
        assert text in result.stderr
    assert snapshot(Path(folder)) == before
    return result.stderr


def discover(code, *more, data="run.csv", coordinates="x", says=()):
    """Run a discovery that must fail; later options replace earlier ones."""
    options = [
        "--coordinates",
        coordinates,
        "--known",
        "x_dot**2=0.5",
        "--library",
        "lib.txt",
        "--output",
        "out",
    ]
    return fails(code, "discover", data, *options, *more, says=says)


def test_the_good_input_is_good():
    args = [
        "run.csv",
        "--coordinates",
        "x",
        "--library",
        "lib.txt",
        "--known",
        "x_dot**2=0.5",
        "--output",
        "out",
    ]
    result = CliRunner().invoke(program, ["discover", *args])
    assert result.exit_code == 0, result.output


def test_file_is_missing():
    discover(2, data="none.csv", says=("none.csv", "no such file"))
    discover(2, data=".", says="directory")
    discover(2, data="model.json", says=("model.json", "suffix"))


@pytest.mark.parametrize(
    ("coordinates", "more", "says"),
    [
        ("theta", (), ("run.csv", "'theta'", "x")),
        ("x", ("--time", "time"), ("run.csv", "'time'")),
        ("x", ("--trial", "nr"), ("run.csv", "'nr'")),
        ("x", ("--forces", "tau2"), ("run.csv", "'tau2'", "'tau'")),
        ("x=X", (), ("run.csv", "'X'")),
    ],
)
def test_column_is_missing(coordinates, more, says):
    discover(2, *more, coordinates=coordinates, says=says)


@pytest.mark.parametrize(
    ("hidden", "says"),
    [
        ("x", ("--hidden", "'x'", "has a column")),
        ("y", ("'y'", "occurs in no candidate")),
        ("y z", ("--hidden", "y z")),
    ],
)
def test_a_hidden_coordinate_makes_no_sense(hidden, says):
    discover(2, "--hidden", hidden, says=says)


def test_text_in_a_number():
    discover(2, data=table([*LINES[:7], "0.14,abc,0", *LINES[8:]]), says=("run.csv", "line 9", "'x'", "abc"))


def test_empty_file_and_header_only():
    Path("empty.csv").touch()
    discover(2, data="empty.csv", says=("empty.csv", "empty"))
    discover(2, data=table([], "header.csv"), says=("header.csv", "no data"))


T, X = np.arange(100) / 50, 1.2 * np.cos(np.arange(100) / 9)
ROWS = [f"{t:.2f},{x:.5f}" for t, x in zip(T, X, strict=True)]
CSV = "\n".join(["t,x", *ROWS]) + "\n"
GERMAN = CSV.replace(",", ";").replace(".", ",")
MILLI = [f"{1000 * t:.0f},{x:.5f}" for t, x in zip(T, X, strict=True)]
PLAIN = GERMAN.replace(",", ".").replace(";", " ")
LONG = "\n".join(["t,x", *(f"{k / 1000:.3f},{np.sin(k / 300):.4f}" for k in range(60_000))])
DATES = [f"2026-11-25T10:00:{t:06.3f}Z,{x:.5f}" for t, x in zip(T, X, strict=True)]
NOT_READ = leastaction.DataError("stop here")


def in_excel(path):
    pd.DataFrame({"t": T, "x": X}).to_excel(path, index=False)


@pytest.mark.parametrize(
    ("name", "content", "options", "says"),
    [
        # read as meant: the codes of the notes
        ("comma.csv", GERMAN, (), ["decimal-comma"]),
        ("tabs.txt", GERMAN.replace(";", "\t"), (), ["decimal-comma"]),
        ("spaces.dat", PLAIN.replace(" ", "    "), (), []),
        ("latin.csv", ("# gemessen für x\n" + CSV).encode("latin-1"), (), ["text-encoding"]),
        ("german.csv", GERMAN.replace("t;x", "Zeit [s];Länge [cm]").encode("cp1252"),
         ("--coordinates", "x=Länge"), ["converted-units", "time-column", "text-encoding", "decimal-comma"]),
        ("book.xlsx", in_excel, (), []),
        ("dates.csv", "\n".join(["t,x", *DATES]), (), ["dates"]),
        ("row.csv", CSV.replace("t,x", "t,x\ns,mm"), (), ["units-row", "converted-units"]),
        ("degrees.csv", CSV.replace("x", "x [deg]"), ("--angles", "x"), ["converted-units"]),
        ("ms.csv", "\n".join(["t,x", *MILLI]), (), ["long-time-step"]),
        ("gaps.csv", re.sub(r"(0\.2.),.*", r"\1,NaN", CSV), (), []),
        ("long.csv", LONG, (), []),
        # refused: what is wrong, and the cure
        ("headers.csv", CSV.replace("t,x", "Zeit,Weg"), (), ("no column 'x'", '--coordinates "x=Weg"')),
        ("when.csv", CSV.replace("t,x", "wann,x"), (), ("no column 't'", "(--time)")),
        ("junk.csv", bytes(range(256)) * 9, (), ("binary data", "save the table as CSV")),
        ("book.csv", b"PK\x03\x04" + bytes(500), (), ("binary data", "name it .xlsx")),
        ("print.csv", b"%PDF-1.7\n" + bytes(500), (), ("it is a PDF", "save the table as CSV")),
        ("page.csv", "<!DOCTYPE html>\n<p>Sign in, please</p>\n", (), ("is a web page", "download")),
        ("export.csv", '{"t": [0, 1], "x": [1, 2]}', (), ("is JSON", "save the table itself as CSV")),
        ("logger.csv", "Logger;7\nHz;50\n\n" + GERMAN, (), ("line 4 ('t', 'x')", "delete the lines")),
        ("grouped.csv", CSV + '"1,000",0\n', (), ("'1,000' is not a number", "if it separates thousands")),
        ("cut.xlsx", b"PK\x03\x04" + bytes(500), (), ("damaged Excel file", "save it again")),
        ("twice.csv", CSV.replace("t,x", "x,x"), (), ("two columns are called 'x'", "its own name")),
        ("one.csv", "x\n1\n2\n", (), ("only the column 'x'", "separate columns by")),
        ("empty.csv", "", (), ("is empty", "expected")),
        ("cell.csv", CSV.replace("0.20,", "0.20,o"), (), ("line 12", "not a number", "leave the cell empty")),
        ("back.csv", "\n".join(["t,x", *ROWS[::-1]]), (), ("line 3", "goes backwards", "sort the rows")),
        ("numbers.csv", "\n".join(ROWS), (), ("line 1", "add a first line")),
        ("old.xls", b"\xd0\xcf\x11\xe0" + bytes(500), (), ("'.xls' is not known", ".xlsx")),
    ],
)  # fmt: skip
def test_files_as_people_have_them(name, content, options, says, monkeypatch):
    """Each is read, with a note of what was done to it, or refused in one line with the cure."""
    found = []

    def refuse(data, library, **options):
        found.append(data)
        raise NOT_READ

    monkeypatch.setattr(leastaction, "discover", refuse, raising=False)
    if callable(content):
        content(name)
    else:
        Path(name).write_bytes(content.encode() if isinstance(content, str) else content)
    if isinstance(says, tuple):
        discover(2, *options, data=name, says=(name, *says))
        return
    discover(1, *options, data=name, says="stop here")
    assert [finding.code for finding in found[0].findings] == says
    expected, scale = T, {"german.csv": 0.01, "row.csv": 0.001, "degrees.csv": np.pi / 180}.get(name, 1.0)
    if name == "long.csv":
        assert found[0][0].t[-1] == 59.999
        return
    np.testing.assert_allclose(found[0][0].t, expected * (1000 if name == "ms.csv" else 1), atol=1e-9)
    there = np.isfinite(found[0][0].q[:, 0])
    assert there.sum() == (95 if name == "gaps.csv" else 100)
    np.testing.assert_allclose(found[0][0].q[there, 0], scale * X[there], atol=1e-5 * scale)


def test_times():
    discover(2, data=table([*LINES[:5], LINES[7], LINES[6]]), says=("line 8", "'t'", "backwards", "--trial"))
    discover(2, data=table([*LINES[:5], LINES[4]]), says=("line 7", "'t'", "repeats"))


def test_infinity():
    discover(2, data=table([*LINES[:5], "0.1,inf,0", *LINES[6:]]), says=("line 7", "'x'", "infinite"))
    discover(2, data=table([*LINES[:5], "nan,1,0", *LINES[6:]]), says=("line 7", "'t'", "missing"))


def test_data_that_support_no_model():
    discover(1, data=table([f"{k},1.5,0" for k in range(50)]), says=("'x'", "constant"))
    discover(1, data=table(LINES[:4]), says=("run.csv", "4 sample"))
    discover(1, data=table(LINES[:12]), says="at least 20")


def test_undefined_candidate_is_the_fault_of_the_data():
    Path("root.txt").write_text("x_dot**2\nx**2\nsqrt(x - 5)", encoding="utf-8")
    discover(1, "--library", "root.txt", says="sqrt(x-5)")


def test_numerical_failure(monkeypatch):
    def singular(*args, **options):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(leastaction, "discover", singular, raising=False)
    discover(1, says=("LinAlgError", "Singular matrix"))

    def greedy(*args, **options):
        raise MemoryError

    monkeypatch.setattr(leastaction, "discover", greedy, raising=False)
    discover(1, says="memory")


def test_lengths_of_arrays_differ():
    np.savez("run.npz", t=np.arange(50.0), x=np.ones(49))
    discover(2, data="run.npz", says=("run.npz", "49", "50"))


def test_a_column_whose_name_no_coordinate_can_have_gets_another():
    Path("german.csv").write_text(CSV.replace("t,x", "Zeit [s],Winkel im Gelenk"), encoding="utf-8")
    given = {"data": "german.csv", "coordinates": "Winkel im Gelenk"}
    discover(2, **given, says=("--coordinates: ", 'write "theta1=Winkel im Gelenk"'))


@pytest.mark.parametrize(
    ("points", "says"),
    [
        (["x"], ("'x' is not a point", "two columns")),
        (["x,nothing"], ("no column 'nothing'", "its columns are")),
    ],
)
def test_points_that_cannot_be_read(points, says):
    options = [part for point in points for part in ("--point", point)]
    message = fails(2, "linkage", "run.csv", *options, says=("--point: ", *says))
    assert "--coordinates" not in message


def test_same_file_twice():
    fails(2, "discover", "run.csv", "run.csv", "--coordinates", "x", "--library", "lib.txt",
          "--known", "x**2=1", "--output", "out", says="twice")  # fmt: skip


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("sinh(x)", "sinh"),
        ("y**2", "'y'"),
        ("x +", "cannot read"),
        ("x = 1", "not an equation"),
        ("x.__class__", "column 2"),
        ("__import__('os').system('touch hacked')", "cannot read"),
        ("(lambda: x)()", "cannot read"),
        ("x[0]", "cannot read"),
        ("cos(x, x)", "one argument"),
        ("x**1000000000", "cannot read"),
        ("9**9**9**9**9", "cannot read"),
        ("x**(2**40)", "cannot read"),
        ("(" * 5000 + "x" + ")" * 5000, "at most 2000"),
        ("-" * 1500 + "x", "cannot read"),
        ("cos(" * 200 + "x" + ")" * 200, "cannot read"),
        ("x\x00y", "cannot read"),
    ],
)
def test_hostile_library(line, says):
    Path("bad.txt").write_text(f"x_dot**2\n# comment\n{line}\n", encoding="utf-8")
    message = discover(2, "--library", "bad.txt", says="--library: bad.txt:3: ")
    assert says in message
    if len(line) < 1000:
        discover(2, "--known", f"{line}=1", says="--known: ")


def test_gyroscopic_terms_are_generated_ones(monkeypatch):
    discover(2, "--gyroscopic", says=("--gyroscopic", "--library auto", "x*y_dot"))
    asked = []

    def refuse(data, library, **options):
        asked.append({term.text for term in library})
        raise leastaction.DataError("no")

    monkeypatch.setattr(leastaction, "discover", refuse, raising=False)
    Path("xy.csv").write_text("t,x,y\n" + "\n".join(f"{k},{k**2},{k}" for k in range(30)), encoding="utf-8")
    options = ["--library", "auto"]
    for more in ([], ["--gyroscopic"]):
        discover(1, *options, *more, data="xy.csv", coordinates="x,y", says="no")
    assert asked[1] - asked[0] == {"x*y_dot"}


def test_size_and_relevance_reach_the_search(monkeypatch):
    discover(2, "--size", "compact", "--library", "some.txt", says=("--size", "--library auto"))
    asked, real = [], leastaction.discover

    def refuse(data, library, **options):
        asked.append((len(library), options.get("relevance")))
        raise leastaction.DataError("no")

    monkeypatch.setattr(leastaction, "discover", refuse, raising=False)
    Path("xy.csv").write_text("t,x,y\n" + "\n".join(f"{k},{k**2},{k}" for k in range(30)), encoding="utf-8")
    options = ["--library", "auto"]
    sizes = ("compact", "chain", "standard", "large")
    for size in sizes:
        discover(
            1, *options, "--size", size, "--relevance", "0.02", data="xy.csv", coordinates="x,y", says="no"
        )
    wanted = [(leastaction.Library.mechanical_size(["x", "y"], size=size), 0.02) for size in sizes]
    assert asked == wanted
    for more in ((), ("--size", "auto")):
        discover(1, *options, *more, data="xy.csv", coordinates="x,y", says="no")
    # without the options the defaults of the library and of discover count
    usual = inspect.signature(real).parameters["relevance"].default
    assert asked[len(sizes) :] == [(wanted[2][0], usual)] * 2


def test_library_file():
    discover(2, "--library", "none.txt", says=("--library", "none.txt", "check the path"))
    Path("empty.txt").write_text("# nothing\n", encoding="utf-8")
    discover(2, "--library", "empty.txt", says=("empty.txt", "no expressions"))
    Path("bytes.txt").write_bytes(b"x_dot**2\n\xff\xfe\n")
    discover(2, "--library", "bytes.txt", says=("bytes.txt:2", "UTF-8"))
    discover(2, "--library", ".", says="--library")


def test_library_of_null_terms():
    Path("null.txt").write_text("3\nx*x_dot\nx_dot\n", encoding="utf-8")
    options = ["--coordinates", "x", "--forces", "tau", "--library", "null.txt", "--output", "out"]
    fails(2, "discover", "run.csv", *options, says="no term of the library has an effect")
    discover(2, "--library", "null.txt", "--known", "x_dot=1", says="--known")


@pytest.mark.parametrize(
    "name",
    [
        "__class__",
        "a;b",
        "x y",
        "sin",
        "pi",
        "x_dot",
        "lambda",
        "1x",
        "x" * 100,
        "x\x1b[31m",
        "x\u0301",
        "",
        "x,",
        ",x",
    ],
)
def test_hostile_names_of_coordinates(name):
    discover(2, coordinates=name, says="--coordinates: ")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--known", "x**3=1"), ("--known: 'x**3' is not among", "near matches", "x**2")),
        (("--known", "x**2"), ("--known", "EXPR=VALUE")),
        (("--known", "x**2="), ("--known", "EXPR=VALUE")),
        (("--known", "x**2=abc"), ("--known", "'abc'")),
        (("--known", "x**2=inf"), ("--known", "'inf'")),
        (("--known", "x**2=1e999"), ("--known", "'1e999'")),
        (("--known", "x**2=1_0"), ("--known", "'1_0'")),
        (("--known", "x_dot**2=1"), ("--known", "twice")),
        (("--dissipation", "x_dot**2/2,"), ("--dissipation", "empty")),
        (("--dissipation", "evil(x)"), ("--dissipation", "evil")),
        (("--forces", "tau,tau"), ("--forces", "2 columns")),
        (("--forces", "y=tau"), ("--forces", "'y'")),
        (("--forces", "x="), ("--forces", "is not of the form name=column")),
        (("--angles", "y"), ("--angles", "'y'")),
        (("--force-delay", "0.01"), ("--force-delay", "--forces")),
        (("--force-delay", "10 ms", "--forces", "tau"), ("--force-delay", "'10 ms'")),
        (("--force-delay", "nan", "--forces", "tau"), ("--force-delay", "'nan'")),
        (("--force-delay", "60", "--forces", "tau"), ("--force-delay", "leaves nothing of trial")),
        (("--coordinates", "x,x"), ("--coordinates", "twice")),
        (("--coordinates", "x=a,x=b"), ("--coordinates", "twice")),
        (("--coordinates", "x="), ("--coordinates", "missing")),
        (("--forces", "x=tau,tau"), ("--forces", "mixes")),
        (("--method", "magic"), ("'magic'", "gauss-newton")),
        (("--size", "huge"), ("--size", "'huge'", "'standard'", "discover --help")),
        (("--relevance", "1"), ("--relevance", "'1'", "below 1")),
        (("--relevance", "-0.1"), ("--relevance", "'-0.1'")),
        (("--relevance", "nan"), ("--relevance", "'nan'", "finite")),
        (("--relevance", "5%"), ("--relevance", "'5%'")),
        (("--seed", "-1"), ("--seed", "discover --help")),
        (("--seed", "one"), ("--seed", "discover --help")),
        (("--hold-out", "0"), ("--hold-out", "at least 1")),
        (("--hold-out", "1"), ("--hold-out", "at least 1")),
        (("--hold-out", "99999999999999999999"), "--hold-out"),
        (("--hold-out", "second"), ("--hold-out", "'second'")),
        (("--hold-out", "run"), ("--hold-out", "all trajectories")),
        (("--hold-out", "100%"), ("--hold-out", "'100%'", "less than 100%")),
        (("--hold-out", "1%"), ("--hold-out", "1 % of 100 samples")),
        (("--hold-out", "x%"), ("--hold-out", "'x%'")),
        (("--hold-out", "a", "--hold-out", "1"), ("--hold-out", "'a'")),
        (("--frobnicate",), ("--frobnicate", "discover --help")),
    ],
)
def test_options_of_discover(options, says):
    discover(2, *options, says=says)


def test_passive_system_needs_a_known_term():
    args = ["run.csv", "--coordinates", "x", "--library", "lib.txt", "--output", "out"]
    fails(2, "discover", *args, says=("no force acts", '--known "x_dot**2=1"', "--forces"))


def test_options_that_are_missing():
    fails(2, "discover", "--output", "out", "--coordinates", "x", says=("DATA", "--help"))
    fails(2, "discover", "run.csv", "--output", "out", says="--coordinates")
    fails(2, "discover", "run.csv", "--coordinates", "x", says="--output")
    fails(2, "discovr", says=("discovr", "leastaction --help"))
    fails(2, "simulate", "model.json", says="--initial")


def test_output_is_a_file_or_below_one():
    discover(2, "--output", "lib.txt", says=("lib.txt is a file", "directory"))
    discover(2, "--output", "lib.txt/out", says=("lib.txt/out", "is a file"))
    discover(2, "--output", "", says="output path is empty")
    Path("there/report.html").mkdir(parents=True)
    discover(2, "--output", "there", says=("report.html", "is a directory"))
    for args in (
        ("generate", "single_pendulum", "--duration", 1),
        ("simulate", "model.json", "--initial", "x=1", "--duration", 1, "--rate", 10),
        ("export", "model.json", "--format", "c"),
    ):
        fails(2, *args, "--output", "there", says=("there", "is a directory"))
        fails(2, *args, "--output", "lib.txt/file", says="lib.txt")
    fails(2, "validate", "model.json", "run.csv", "--json", "there", says="is a directory")


def test_output_without_the_right_to_write(monkeypatch):
    if os.name != "nt" and os.geteuid() != 0:
        Path("locked").mkdir(mode=0o500)
    else:  # an administrator may write anywhere
        Path("locked").mkdir()
        allowed = os.access
        monkeypatch.setattr(
            os, "access", lambda path, mode: "locked" not in str(path) and allowed(path, mode)
        )
    discover(2, "--output", "locked", says=("locked", "no right to write", "choose another"))
    fails(
        2, "generate", "single_pendulum", "--duration", 1, "-o", "locked/a.csv", says=("locked", "no right")
    )


def test_disk_is_full_at_the_end(monkeypatch):
    def full(*args):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    discover(2, "--forces", "tau", "--output", "new/out", says=("cannot be written", "No space left"))


def test_other_errors_of_the_system(monkeypatch):
    def refuse(*args, **options):
        raise PermissionError(errno.EACCES, "Permission denied", "secret.csv")

    monkeypatch.setattr(systems, "generate", refuse)
    fails(2, "generate", "single_pendulum", "-o", "a.csv", says="secret.csv: Permission denied")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"schema": 3}, ("schema", "newer version")),
        ({"schema": "1"}, "schema"),
        ({"coordinates": ["__class__"]}, "__class__"),
        ({"coordinates": "x"}, "coordinates"),
        ({"terms": []}, "terms is empty"),
        (
            {"terms": [{**SPRING["terms"][0], "expression": "__import__('os').system('touch hacked')"}]},
            "terms[0]",
        ),
        ({"terms": [{**SPRING["terms"][0], "expression": "x**99999999"}]}, "terms[0]"),
        ({"terms": [{**SPRING["terms"][0], "expression": "(" * 1900 + "x" + ")" * 1900}]}, "terms[0]"),
        ({"terms": [{**SPRING["terms"][0], "coefficient": "0.5"}]}, "terms[0].coefficient"),
        ({"terms": [{**SPRING["terms"][0], "coefficient": 10**400}]}, "terms[0].coefficient"),
        ({"noise_std": [[0.1]]}, "noise_std"),
        ({"fit": None}, "fit"),
        ({"extra": 1}, "extra"),
    ],
)
def test_hostile_model(change, says):
    Path("model.json").write_text(json.dumps({**SPRING, **change}), encoding="utf-8")
    fails(
        2,
        "export",
        "model.json",
        "--format",
        "c",
        "-o",
        "m.c",
        says=("model.json", *((says,) if isinstance(says, str) else says)),
    )


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (json.dumps(SPRING)[:200], "cut short"),
        ("", "empty"),
        ("[1, 2]", "not a leastaction model"),
        ("[" * 100_000, "nested"),
        ('{"schema": NaN}', "NaN"),
        ("\xff", ""),
        (json.dumps({k: v for k, v in SPRING.items() if k != "fit"}), "'fit'"),
    ],
)
def test_model_that_is_no_model(content, says):
    Path("model.json").write_bytes(content.encode("latin-1"))
    for args in (
        ("simulate", "model.json", "--initial", "x=1", "--duration", 1, "--rate", 10, "-o", "r.csv"),
        ("validate", "model.json", "run.csv"),
        ("export", "model.json", "--format", "c", "-o", "m.c"),
    ):
        fails(2, *args, says=("model.json", says))
    fails(2, "export", "none.json", "--format", "c", "-o", "m.c", says=("none.json", "no such file"))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--initial", "x"), "name=number"),
        (("--initial", "x=1,,"), "name=number"),
        (("--initial", ""), "name=number"),
        (("--initial", "x=1,x=2"), "twice"),
        (("--initial", "y=1"), ("'y'", "x, x_dot")),
        (("--initial", "x=1 2"), "'1 2'"),
        (("--initial", "x=1e400"), "finite"),
        (("--initial", "x=__import__('os')"), "not a finite number"),
        (("--duration", "ten"), ("--duration", "'ten'")),
        (("--duration", "-1"), ("--duration", "positive")),
        (("--duration", "0.001"), "second sample"),
        (("--rate", "0"), ("--rate", "positive")),
        (("--rate", "1e300"), "samples"),
    ],
)
def test_options_of_simulate(options, says):
    given = {"--initial": "x=1", "--duration": "1", "--rate": "10", **dict([options])}
    fails(2, "simulate", "model.json", *(w for pair in given.items() for w in pair), "-o", "r.csv", says=says)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--horizon", "-1"), "--horizon"),
        (("--horizon", "soon"), "--horizon"),
        (("--horizon", "1000"), "horizon"),
        (("--coordinates", "tau"), ("--coordinates", "the model has x")),
        (("--coordinates", "x,tau"), ("--coordinates", "the model has x")),
    ],
)
def test_options_of_validate(options, says):
    fails(2, "validate", "model.json", "run.csv", *options, says=says)


def test_model_of_other_columns():
    fails(2, "validate", "model.json", table(LINES, "other.csv", "t,y,tau"), says=("other.csv", "'x'"))


def test_unknown_format_and_system():
    fails(2, "export", "model.json", "--format", "fortran", "-o", "m.f", says=("'fortran'", "latex"))
    fails(2, "export", "model.json", "--format", "fmu", "-o", "m.fmu", says="did you mean 'fmu")
    assert not Path("m.fmu").exists()


def test_file_names_that_matlab_cannot_call():
    for name in ("model.txt", "my-model.m", "end.m"):
        fails(2, "export", "model.json", "--format", "matlab", "-o", name, says=(name, "MATLAB"))
        assert not Path(name).exists()


def test_fmu_without_a_compiler(monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr("leastaction.exporters.fmu.find_spec", lambda name: None)
    fails(2, "export", "model.json", "--format", "fmu2", "-o", "m.fmu", says=("no C compiler", "install one"))
    assert not Path("m.fmu").exists()
    fails(
        2, "generate", "quadruple_pendulum", "-o", "a.csv", says=("'quadruple_pendulum'", "double_pendulum")
    )
    fails(2, "demo", "--system", "triple", says=("triple", "double"))


@pytest.mark.parametrize(
    "options",
    [
        ("--noise", "loud"), ("--noise", "-1"), ("--noise-convention", "odd"), ("--trials", "0"),
        ("--trials", "1e3"), ("--duration", "0"), ("--duration", "1e12"), ("--rate", "-5"),
        ("--missing", "1"), ("--missing", "nan"), ("--seed", "-1"), ("--noise", "%"), ("--rate", "5%"),
        ("--missing", "100%"), ("--noise", "1%", "--noise-convention", "absolute"),
    ],
)  # fmt: skip
def test_options_of_generate(options):
    message = fails(2, "generate", "magnetic_pendulum", *options, "-o", "a.csv")
    assert options[0].strip("-").replace("-convention", "") in message


def test_hostile_file_name_is_shown_without_control_characters():
    discover(2, data="evil\x1b[2J\n.csv", says="no such file")


def test_unexpected_exception(monkeypatch):
    def burst(*args, **options):
        raise RuntimeError("boom\nsecond line")

    monkeypatch.setattr(systems, "generate", burst)
    message = fails(70, "generate", "single_pendulum", "-o", "a.csv", says="RuntimeError: boom second line")
    assert "report" in message
    monkeypatch.setenv("LEASTACTION_DEBUG", "1")
    result = CliRunner().invoke(program, ["generate", "single_pendulum", "-o", "a.csv"])
    assert result.exit_code == 70
    assert "Traceback" in result.stderr


def test_interrupt(monkeypatch):
    def interrupt(*args, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(leastaction, "discover", interrupt, raising=False)
    options = ["--coordinates", "x", "--known", "x_dot**2=1", "--library", "lib.txt", "--output", "out"]
    result = CliRunner().invoke(program, ["discover", "run.csv", *options])
    assert (result.exit_code, result.stdout) == (130, "")
    assert result.stderr == "interrupted: nothing was written\n"
    assert not Path("out").exists()


# -------------------------------------------------------------------------------------------- exit codes
DISCOVER = ["--coordinates", "x", "--library", "lib.txt", "--known", "x_dot**2=0.5", "--output", "out"]


def raising(error):
    def call(*args, **options):
        raise error

    return call


def stopped(data, library, known, *, progress, **options):
    """A search that the user ends by one Ctrl-C before there is a law; a second one would do the same."""
    signal.raise_signal(signal.SIGINT)
    progress("search", {})


@pytest.mark.parametrize(
    ("args", "search", "code"),
    [
        (["--version"], None, failures.DONE),
        (["discover", "run.csv", *DISCOVER, "--forces", "tau"], None, failures.DONE),  # doubtful
        (["discover", "still.csv", *DISCOVER], None, failures.NO_MODEL),
        (["discover", "run.csv", *DISCOVER], raising(MemoryError()), failures.NO_MODEL),
        (["discover", "run.csv", *DISCOVER, "--frob"], None, failures.WRONG_USE),
        (["discover", "none.csv", *DISCOVER], None, failures.WRONG_USE),
        (["discover", "binary.csv", *DISCOVER], None, failures.WRONG_USE),
        (["discover", "run.csv", *DISCOVER], raising(RuntimeError("boom")), failures.FAULT),
        (["discover", "run.csv", *DISCOVER], raising(KeyboardInterrupt()), failures.INTERRUPTED),
        (["discover", "run.csv", *DISCOVER], stopped, failures.INTERRUPTED),
    ],
)
def test_exit_codes(args, search, code, monkeypatch):
    table([f"{k},1.5,0" for k in range(50)], "still.csv")
    Path("binary.csv").write_bytes(bytes(range(256)) * 40)
    if search is not None:
        monkeypatch.setattr(leastaction, "discover", search, raising=False)
    result = CliRunner().invoke(program, args)
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output
    if "tau" in args:
        assert leastaction.load("out/model.json").fit.status == "doubtful"


def test_exit_code_when_nobody_reads_on():
    command = [sys.executable, "-m", "leastaction", "show", "model.json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.close()
        errors = process.stderr.read()
        assert (process.wait(timeout=60), errors) == (failures.PIPE_CLOSED, "")


def test_exit_codes_are_documented():
    page = (Path(__file__).parents[2] / "docs" / "cli.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([0-9]+) \| (.+) \|$", page.split("## Exit codes")[1].split("## ")[0], re.M)
    assert {int(code): meaning for code, meaning in rows} == failures.EXIT_CODES
    said = " ".join(CliRunner().invoke(program, ["--help"]).stdout.split())
    assert all(f"{code} {meaning}" in said for code, meaning in failures.EXIT_CODES.items())


@pytest.mark.parametrize(
    ("args", "code"),
    [
        (["discover", "none.csv", "--coordinates", "x", "--known", "x=1", "--output", "out"], 2),
        (["--frob"], 2),
    ],
)
def test_through_the_shell(args, code):
    done = subprocess.run(
        [sys.executable, "-m", "leastaction", *args], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stdout) == (code, "")
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
