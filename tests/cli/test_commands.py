"""The command line: what the commands write and print."""

from __future__ import annotations

import gzip
import io
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import zipfile
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

import leastaction as la
from helpers import record
from leastaction import systems
from leastaction.cli import demo as _demo
from leastaction.cli import generate as _generate
from leastaction.cli import options as _options
from leastaction.cli import program
from leastaction.cli import show as _show
from leastaction.cli import text as _text
from leastaction.cli import values as _values
from leastaction.findings import Finding, find
from leastaction.model.term import FitSummary, ModelTerm

COMMANDS = (
    *("app", "arm", "completion", "discover", "linkage", "show", "simulate", "validate", "export"),
    *("generate", "demo"),
)
FILES = [("model", "json"), ("report", "html")]
LIBRARY = "theta_dot**2  # kinetic energy\n\ncos(theta)\nsin(theta)\ntheta*theta_dot\n"


def run(*args, code: int = 0):
    result = CliRunner().invoke(program, [str(a) for a in args])
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output
    return result


def shell(*args, **options):
    # Whatever the caller's terminal is, the output must not depend on it.
    env = {k: v for k, v in os.environ.items() if k not in ("FORCE_COLOR", "COLUMNS", "LEASTACTION_DEBUG")}
    return subprocess.run(
        [sys.executable, "-m", "leastaction", *map(str, args)],
        capture_output=True, text=True, encoding="utf-8", env=env, timeout=60, **options,
    )  # fmt: skip


def model_file(path, terms, coordinates=("x",), **fit):
    model = la.LagrangianModel(coordinates, [ModelTerm(*term) for term in terms], **fit)
    model.save(path)
    return path


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """Data of a driven pendulum, and what discover makes of them."""
    folder = tmp_path_factory.mktemp("cli")
    data = systems.generate("single_pendulum", noise=0.02, trials=3, duration=4.0, seed=0)
    la.write_csv(folder / "run.csv", data)
    (folder / "library.txt").write_text(LIBRARY, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def found(work):
    """Output and directory of one discovery."""
    result = run(
        "discover", work / "run.csv", "--coordinates", "theta", "--forces", "theta_force",
        "--library", work / "library.txt", "--angles", "theta", "--hold-out", 1,
        "--output", work / "deep" / "found",
    )  # fmt: skip
    return result, work / "deep" / "found"


@pytest.fixture
def model(found):
    return found[1] / "model.json"


def test_discover_writes_model_and_report(found):
    result, folder = found
    assert sorted(p.name for p in folder.iterdir()) == ["model.json", "report.html"]
    document = json.loads((folder / "model.json").read_text(encoding="utf-8"))
    assert document["schema"] == 2
    assert document["fit"]["status"] == "ok"
    values = {term["expression"]: term["coefficient"] for term in document["terms"]}
    assert values == pytest.approx({"theta_dot**2": 0.5, "cos(theta)": 9.81}, rel=0.03)
    report = (folder / "report.html").read_text(encoding="utf-8")
    assert "leastaction discover" in report
    assert result.stderr == ""


def test_discover_prints_the_table(found):
    result, folder = found
    lines = result.stdout.splitlines()
    assert lines[0].startswith("L = ")
    assert float(lines[0].split()[2].partition("*")[0]) == pytest.approx(0.5, rel=0.01)
    header = next(line for line in lines if line.startswith("term"))
    assert header.split() == ["term", "coefficient", "95", "%", "interval", "z"]
    row = next(line for line in lines if line.startswith("theta_dot**2"))
    assert re.fullmatch(r"theta_dot\*\*2 +0\.\d+ ± 0\.0\d+ +0\.\d+ … 0\.\d+ +\d+", row)
    assert "fit: ok" in result.stdout
    assert lines[lines.index("structure: determined") + 1].startswith("equations: hold to ")
    assert "left out before the fit: 1 candidate (1 without effect)" in result.stdout
    assert "in 1 trial, 0 diverged" in result.stdout
    assert "forecast: held-out trials are off by" in result.stdout  # and not: not tested
    assert lines[-2:] == [f"model: {folder / 'model.json'}", f"report: {folder / 'report.html'}"]
    assert "\x1b" not in result.output


def test_discover_is_the_same_through_the_shell(work, found):
    result = shell(
        "discover", "run.csv", "--coordinates", "theta", "--forces", "theta=theta_force",
        "--library", "library.txt", "--angles", "theta", "--hold-out", "single_pendulum-2",
        "--output", "again", cwd=work,
    )  # fmt: skip
    assert (result.returncode, result.stderr) == (0, "")
    models = [json.loads((p / "model.json").read_text(encoding="utf-8")) for p in (found[1], work / "again")]
    assert models[0] == models[1]
    assert result.stdout.splitlines()[:-2] == found[0].stdout.splitlines()[:-2]


def test_what_discover_prints_is_chosen(work, found, tmp_path):
    again = [
        "discover", work / "run.csv", "--coordinates", "theta", "--forces", "theta_force",
        "--library", work / "library.txt", "--angles", "theta", "--hold-out", 1, "--output", tmp_path,
    ]  # fmt: skip
    result = run(*again, "--json", "-v")
    document = json.loads(result.stdout)
    assert document["files"] == {name: str(tmp_path / f"{name}.{end}") for name, end in FILES}
    assert document["model"] == json.loads((found[1] / "model.json").read_text(encoding="utf-8"))
    assert document["forecast"]["n_diverged"] == 0
    steps = result.stderr.splitlines()
    assert steps[0] == "preparing"
    assert any(
        re.match(r"choosing terms: 2 terms, evidence [0-9.]+, 0\.\d+ theta_dot", step) for step in steps
    )
    quiet = run(*again, "--quiet")
    assert quiet.stdout.splitlines() == [f"{name}: {tmp_path / name}.{end}" for name, end in FILES]
    assert quiet.stderr == ""


def test_show_prints_what_discover_printed(found, model):
    """But the forecast, and what takes the recording: what was left out, and where the motion went."""
    but = ("symmetry", "equilibrium", "left out", "forecast: ")
    lines, printed = (
        [line for line in text.splitlines() if not line.startswith(but)]
        for text in (run("show", model).stdout, found[0].stdout)
    )
    assert len(lines) > 8
    assert printed[: len(lines)] == lines
    assert run("show", model, "--group", "a", code=2).stderr.startswith("error: --group: ")


def test_discover_replaces_an_earlier_result_and_keeps_other_files(work, tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    for name in ("model.json", "report.html", "notes.txt"):
        (folder / name).write_text("old", encoding="utf-8")
    # The columns have other names than the coordinate; friction and a known term; two files.
    frame = pd.read_csv(work / "run.csv").rename(columns={"theta": "Angle (rad)"})
    for k in range(2):
        frame[frame.trial == f"single_pendulum-{k}"].to_csv(tmp_path / f"{k}.csv", index=False)
    result = run(
        "discover", tmp_path / "0.csv", tmp_path / "1.csv", "--coordinates", "theta=Angle (rad)", "--forces",
        "theta_force", "--angles", "theta", "--known", "cos(theta) = 9.81", "--dissipation",
        "theta_dot**2/2, abs(theta_dot)", "--seed", 3, "--output", folder,
    )  # fmt: skip
    assert (folder / "notes.txt").read_text(encoding="utf-8") == "old"
    loaded = la.load(folder / "model.json")
    assert {t.expression: t.coefficient for t in loaded.terms if t.known} == {"cos(theta)": 9.81}
    assert "cos(theta)    9.81 (known)" in result.stdout
    assert "old" not in (folder / "report.html").read_text(encoding="utf-8")[:10]


def test_notes_do_not_repeat_the_statements_or_the_law(capsys):
    smoothed = find("friction-smoothed", ("x_dot",), widths=[0.02])
    follows, *left = (find("forecasts", horizon=1.0, error=0.03),
                      *(find("equation-error", name, equation_error=0.004) for name in "xy"))  # fmt: skip
    for friction, expected in (("x_dot**2/2", 1), ("sqrt(x_dot**2+1/2500)", 2)):
        model = la.LagrangianModel(
            ("x",), [ModelTerm("x_dot**2", 0.5, 0.1, False)], [ModelTerm(friction, 0.1, 0.01, False)],
            noise_std=[0.01], fit=FitSummary("ok", 1.0, findings=(smoothed, follows, *left)),
        )  # fmt: skip
        assert len([*_show._notes(model)]) == expected
        _show.show_fit(model)
        assert (
            "forecast: simulations over 1 s of fitted trials are off by 3 % of the spread"
            in capsys.readouterr().out
        )


def test_show_writes_dry_friction_as_it_was_given(tmp_path):
    findings = [
        find("friction-smoothed", ("x_dot",), widths=[0.02]),
        Finding("other", "warning", (), {}, "sqrt(x_dot**2 + 1/2500) is hardly determined"),
    ]
    root = ModelTerm("sqrt(x_dot**2 + 1/2500)", 0.1, 0.01)
    model = la.LagrangianModel(
        ["x"], [ModelTerm("x_dot**2", 0.5, known=True)], [root], noise_std=[0.01],
        fit=FitSummary("doubtful", 1.0, findings=findings),
    )  # fmt: skip
    model.save(tmp_path / "model.json")
    shown = run("show", tmp_path / "model.json")
    assert "psi = 0.100*abs(x_dot)" in shown.stdout
    assert any(line.startswith("abs(x_dot)  ") for line in shown.stdout.splitlines())
    assert "WARNING: abs(x_dot) is hardly determined" in shown.stdout
    assert "abs(x_dot) is hardly determined" in shown.stderr
    assert "sqrt" not in shown.stdout + shown.stderr
    assert la.load(tmp_path / "model.json").dissipation[0].expression == root.expression


def test_discover_shows_a_doubtful_model(work, tmp_path):
    result = run(
        "discover", work / "run.csv", "--coordinates", "theta", "--forces", "theta_force",
        "--library", work / "library.txt", "--known", "cos(theta)=1", "--angles", "theta",
        "--output", tmp_path / "out",
    )  # fmt: skip
    # The known coefficient is too small by a factor of ten, so no inertia fits the known force.
    assert la.load(tmp_path / "out" / "model.json").fit.status == "doubtful"
    assert "fit: DOUBTFUL" in result.stdout
    assert "\nWARNING: " in result.stdout
    assert result.stderr.startswith("warning: the fit is doubtful: ")


@pytest.fixture(scope="module")
def payload(tmp_path_factory):
    """Six recordings in one table, every other one with twice the mass, and what discover makes of them."""
    folder, empty = tmp_path_factory.mktemp("groups"), systems.get("single_pendulum")
    loaded = replace(empty, lagrangian={k: 2.0 * value for k, value in empty.lagrangian.items()})
    parts = [systems.generate(s, 0.01, trials=3, duration=6.0, seed=k) for k, s in enumerate((empty, loaded))]
    frames = [
        pd.DataFrame(
            {"t": r.t, "theta": r.q[:, 0], "tau": r.forces[:, 0], "trial": f"{k}{name}", "load": f"{name} kg"}
        )
        for k in range(3)
        for name, r in enumerate(part[k] for part in parts)
    ]
    pd.concat(frames).assign(day="monday").to_csv(folder / "runs.csv", index=False)
    (folder / "library.txt").write_text(LIBRARY, encoding="utf-8")
    return folder


def grouped(folder, *more, code=0):
    return run(
        "discover", folder / "runs.csv", "--coordinates", "theta", "--forces", "tau", "--library",
        folder / "library.txt", "--output", folder / "out", *more, code=code,
    )  # fmt: skip


def test_groups_of_trials_are_told_apart_by_a_column(payload):
    result = grouped(payload, "--group", "load", "--hold-out", 2)
    assert "differences of 1 kg from 0 kg:" in result.output
    assert "differ between the groups 0 kg, 1 kg" in result.output
    model = la.load(payload / "out" / "model.json")
    assert set(model.groups.terms) == {"theta_dot**2", "cos(theta)"}
    assert model.groups.trials == ("0 kg", "1 kg") * 2
    # what was held out is forecast by the law of its group
    errors = re.search(r"^theta +(\S+) +(\S+)", result.output[result.output.index("forecasts over") :], re.M)
    assert float(errors[1]) < 2.0 * float(errors[2])
    page = (payload / "out" / "report.html").read_text(encoding="utf-8")
    assert "differences of 1 kg from 0 kg" in page


def test_the_law_of_one_group_is_simulated_exported_and_validated(payload):
    grouped(payload, "--group", "load")
    file = payload / "out" / "model.json"
    law = la.load(file).of_group("1 kg")
    run("export", file, "--format", "python", "-o", payload / "law.py", "--group", "1 kg")
    assert repr(law.terms[0].coefficient)[:8] in (payload / "law.py").read_text(encoding="utf-8")
    start = ["--initial", "theta=1", "--duration", 2, "--rate", 50, "-o", payload / "law.csv"]
    run("simulate", file, *start, "--group", "1 kg")
    expected = law.simulate([1.0], [0.0], np.arange(101) / 50).q[:, 0]
    np.testing.assert_array_equal(pd.read_csv(payload / "law.csv")["theta"], expected)
    data = ["validate", file, payload / "runs.csv", "--forces", "tau", "--json", payload / "errors.json"]
    run(*data, "--group", "load")
    errors = json.loads((payload / "errors.json").read_text(encoding="utf-8"))
    assert errors["rms"][0] < 1.5 * errors["expected_rms"][0]
    assert "no group '2 kg'" in run("simulate", file, *start, "--group", "2 kg", code=2).output


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--group", "weight"], "no column 'weight'"),
        (["--group", "tau"], "the group changes from"),
        (["--group", "load", "--hold-out", "01,11,21"], "no trial of the group '1 kg' is left to fit"),
        (["--group", "day"], "every trial is in the group 'monday'"),
    ],
)
def test_wrong_groups_are_named(payload, options, says):
    assert says in grouped(payload, *options, code=2).output


def test_hold_out_takes_the_last_trials_or_names(work):
    from leastaction.cli.discover import _split

    data = la.read(work / "run.csv", ["theta"])
    names = data.names
    for texts, held in (
        (["2"], names[1:]),
        ([f"{names[0]}, {names[2]}"], (names[0], names[2])),
        ([f"{names[1]},"], names[1:2]),
        ([names[0], f"{names[2]},"], (names[0], names[2])),
        (["30%"], names[2:]),
    ):
        fitted, out = _split(data, texts)
        assert out is not None
        assert out.names == held
        assert set(fitted.names) == set(names) - set(held)
    assert _split(data, []) == (data, None)


def test_a_forecast_that_fails_does_not_cost_the_model(work, tmp_path, monkeypatch):
    def refuse(self, trajectories, **options):
        raise la.InputError("too short")

    monkeypatch.setattr(la.LagrangianModel, "validate", refuse)
    result = run(
        "discover", work / "run.csv", "--coordinates", "theta", "--forces", "theta_force",
        "--library", work / "library.txt", "--hold-out", 1, "--output", tmp_path / "out",
    )  # fmt: skip
    assert result.stderr == "warning: no forecast of the trials held out: too short\n"
    assert (tmp_path / "out" / "report.html").exists()


@pytest.mark.parametrize("suffix", ["csv", "csv.gz"])
def test_simulate(tmp_path, suffix):
    spring = model_file(tmp_path / "spring.json", [("x_dot**2", 0.5), ("x**2", -2.0)])
    out = tmp_path / f"run.{suffix}"
    result = run("simulate", spring, "--initial", "x = 1", "--duration", "0.3", "--rate", 10, "-o", out)
    assert result.stderr == "note: x_dot not given in --initial: 0\n"
    assert result.stdout == f"4 samples over 0.3 s: {out}\n"
    text = (gzip.decompress(out.read_bytes()) if suffix.endswith("gz") else out.read_bytes()).decode()
    assert text.splitlines()[0] == "t,x,x_dot"
    frame = pd.read_csv(out)
    t = np.arange(4) / 10
    np.testing.assert_array_equal(frame["t"], t)
    np.testing.assert_allclose(frame["x"], np.cos(2 * t), atol=1e-8)
    np.testing.assert_allclose(frame["x_dot"], -2 * np.sin(2 * t), atol=1e-8)


def test_simulate_writes_nothing_when_the_motion_stops(tmp_path):
    runaway = model_file(tmp_path / "runaway.json", [("x_dot**2", 0.5), ("x**4", 1.0)])
    result = run(
        "simulate", runaway, "--initial", "x=1, x_dot=0", "--duration", 50, "--rate", 10,
        "-o", tmp_path / "a" / "b.csv", code=1,
    )  # fmt: skip
    assert "the motion stops: " in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["runaway.json"]


def test_simulate_says_that_a_model_is_doubtful(tmp_path):
    fit = FitSummary("doubtful", warnings=("no match",))
    path = model_file(tmp_path / "spring.json", [("x_dot**2", 0.5), ("x**2", -2.0)], fit=fit)
    result = run(
        "simulate", path, "--initial", "x=1,x_dot=0", "--duration", 1, "--rate", 10, "-o", tmp_path / "r.csv"
    )
    assert result.stderr == "warning: the model is doubtful: no match\n"


def test_validate(work, model, tmp_path):
    result = run(
        "validate",
        model,
        work / "run.csv",
        "--forces",
        "theta_force",
        "--horizon",
        0.5,
        "--json",
        tmp_path / "e.json",
    )
    assert result.stdout.startswith("forecasts over 0.5 s: ")
    document = json.loads((tmp_path / "e.json").read_text(encoding="utf-8"))
    assert document["horizon"] == 0.5
    assert document["coordinates"] == ["theta"]
    assert document["rms_over_noise"][0] < 2
    # Forces that are known but not given make the model look bad.
    without = run(
        "validate", model, work / "run.csv", "--coordinates", "theta", "--time", "t", "--trial", "trial"
    )
    assert "theta" in without.stdout
    assert "without --forces, none act in the forecast" in without.stderr
    assert "without --forces" not in result.stderr


def test_validate_says_that_angles_are_in_degrees(model, work, tmp_path):
    table = np.genfromtxt(work / "run.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    table["theta"] *= 180.0 / np.pi
    names, file = table.dtype.names, tmp_path / "degrees.csv"
    lines = [",".join(map(str, row)) for row in table.tolist()]
    file.write_text("\n".join([",".join(names), *lines]) + "\n", encoding="utf-8")
    options = ("--forces", "theta_force", "--horizon", 0.5)
    wrong = run("validate", model, file, *options)
    assert "give --units theta=deg" in wrong.stderr
    right = run("validate", model, file, *options, "--units", "theta=deg")
    assert "deg" not in right.stderr
    pushed = run("validate", model, work / "run.csv", "--coordinates", "theta", "--trial", "trial")
    assert "deg" not in pushed.stderr


def test_validate_needs_no_column_of_every_coordinate(tmp_path):
    data = systems.generate("cart_spring_pendulum", noise=0.01, trials=1, duration=6.0, seed=4)
    system = systems.get("cart_spring_pendulum")
    terms = list(system.lagrangian.items())
    given = {"noise_std": [0.01, 0.01], "provenance": {"options": {"angles": ["theta"]}}}
    path = model_file(tmp_path / "model.json", terms, system.coordinates, **given)
    la.write_csv(tmp_path / "run.csv", data)
    result = run("validate", path, tmp_path / "run.csv", "--coordinates", "theta")
    assert "note: x has no column: the motion follows from the other columns" in result.stdout
    rows = [line.split() for line in result.stdout.splitlines() if line.startswith("theta")]
    assert float(rows[0][1]) < 1.5 * float(rows[0][2])


def _data_options(data, coordinates, forces, angles=None, force_delay=None):
    given = {"data": [str(data)], "coordinates": coordinates, "forces": forces, "angles": angles}
    others = {"time": "t", "trial": None, "velocity": (), "acceleration": ()}
    return _options.DataOptions.of({**given, **others, "force_delay": force_delay})


def test_linkage_prints_the_command_that_finds_the_law(tmp_path):
    starts = [([1.2], [0.0]), ([0.4], [2.0])]
    swings = record(lambda q, v, f: -9.81 / 0.5 * np.sin(q), starts, ["theta"], noise=0.0)
    rng, rows = np.random.default_rng(3), ["run,t,Marker X,Marker Y"]
    for name, swing in enumerate(swings):
        track = np.column_stack([0.5 * np.sin(swing.q[:, 0]), 0.5 * np.cos(swing.q[:, 0])])
        track += rng.normal(0.0, 1e-3, track.shape)
        rows += [f"{name},{t},{x},{y}" for t, (x, y) in zip(swing.t, track, strict=True)]
    table, terms = tmp_path / "markers.csv", tmp_path / "terms.txt"
    table.write_text("\n".join(rows), encoding="utf-8")
    terms.write_text("theta_dot**2\ncos(theta)\nsin(theta)\n", encoding="utf-8")
    said = run("linkage", table, "--trial", "run", "--point", "u=Marker X,v=Marker Y").output
    assert re.search(r"\(u, v\) stays 0\.(500|499)\d* from a fixed point", said)
    _, command = said.split("leastaction ", 1)
    filled = command.replace("TERMS.txt", str(terms)).replace("TERM=VALUE", '"theta_dot**2=0.5"')
    run(*shlex.split(filled.replace("\\\n", " ")), "--output", tmp_path / "out")
    model = la.load(tmp_path / "out" / "model.json")
    found = {term.expression: term.coefficient for term in model.terms}
    assert found["cos(theta)"] == pytest.approx(9.81 / 0.5, rel=0.01)


def test_force_delay_shifts_the_forces(work):
    def options(delay):
        return _data_options(work / "run.csv", "theta", "theta_force", force_delay=delay).read()

    shifted = la.delay.shift_forces(options(None), 0.02)
    for ours, theirs in zip(options("0.02"), shifted, strict=True):
        assert np.array_equal(ours.t, theirs.t)
        assert np.array_equal(ours.forces, theirs.forces)


def test_validate_puts_coordinates_in_the_order_of_the_model():
    options = _data_options("f.csv", "b, a = col", "tau_b").in_order_of(("a", "b"))
    assert list(options.coordinates.items()) == [("a", "col"), ("b", "b")]
    assert options.forces == {"b": "tau_b"}


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("sympy", "lagrangian = "),
        ("latex", r"\dot{\theta}"),
        ("python", "def acceleration"),
        ("c", "math.h"),
        ("casadi", "import casadi"),
        ("matlab", "function model = out()"),
    ],
)
def test_export(model, tmp_path, kind, text):
    run("export", model, "--format", kind, "--output", tmp_path / "sub" / "out.m")
    assert text in (tmp_path / "sub" / "out.m").read_text(encoding="utf-8")


@pytest.mark.skipif(not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler")
@pytest.mark.parametrize("kind", ["fmu2", "fmu3"])
def test_export_of_an_fmu(model, tmp_path, kind):
    result = run("export", model, "--format", kind, "--output", tmp_path / "pendulum.fmu")
    assert result.stdout.startswith(f"{kind}: ")
    assert zipfile.ZipFile(tmp_path / "pendulum.fmu").testzip() is None


def test_generate_and_the_command_that_it_proposes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    args = ("generate", "single_pendulum", "--trials", 2, "--duration", 4, "--noise", 0.02, "--seed", 5, "-o")
    result = run(*args, "a.csv.gz")
    run(*args, "b.csv.gz")
    assert (tmp_path / "a.csv.gz").read_bytes() == (tmp_path / "b.csv.gz").read_bytes()
    read = la.read("a.csv.gz", ["theta"], forces={"theta": "theta_force"})
    made = systems.generate("single_pendulum", noise=0.02, trials=2, duration=4.0, seed=5)
    assert read.digest() == made.digest()
    command = shlex.split(result.stdout.splitlines()[-1].removeprefix("next: "))
    assert command[0] == "leastaction"
    run(*command[1:])
    assert (tmp_path / "found" / "model.json").exists()


def test_generate_passes_its_options_on(tmp_path):
    options = ("--noise", 0.01, "--noise-convention", "absolute", "--missing", "10%", "--irregular")
    result = run(
        "generate",
        "cart_spring_pendulum",
        "--trials",
        1,
        "--duration",
        1,
        "--rate",
        50,
        *options,
        "-o",
        tmp_path / "c.csv",
    )
    made = systems.generate(
        "cart_spring_pendulum", noise=0.01, noise_convention="absolute", trials=1, duration=1.0, rate=50.0,
        missing=0.1, irregular=True,
    )  # fmt: skip
    assert la.read(tmp_path / "c.csv", ["x", "theta"]).digest() == made.digest()
    assert "--known 'cos(theta)=9.81'" in result.stdout


def test_generate_names_all_systems():
    assert (systems.names(), systems.further_names()) == (_generate.SYSTEMS, _generate.FURTHER)
    text = " ".join(run("generate", "--help").stdout.split())
    assert all(name in text for name in (*systems.names(), *systems.further_names()))


@pytest.mark.thorough
def test_demo(tmp_path):
    result = run("demo", "--system", "single", "--output", tmp_path / "demo")
    rows = {line.split("  ")[0]: line for line in result.stdout.splitlines()}
    assert "-128.58" in rows["cos(theta)"]
    assert "%" in rows["cos(theta)"]
    errors = [float(rows[name].split()[2]) for name in ("found model", "published model")]
    assert errors[0] < errors[1]
    assert result.stdout.splitlines()[-1] == f"report: {tmp_path / 'demo' / 'report.html'}"
    assert float(rows["abs(theta_dot)"].split()[1]) > 0
    # its authors fitted viscous friction alone, ours is divided between viscous and dry
    assert "%" not in rows["theta_dot**2/2"]
    assert "single coefficients of friction do not compare" in result.stdout
    assert {p.name for p in (tmp_path / "demo").iterdir()} == {"model.json", "report.html"}
    assert "forecast" in (tmp_path / "demo" / "report.html").read_text(encoding="utf-8").lower()


@pytest.mark.parametrize("name", ["double", "single"])
def test_demo_data_and_published_models(name):
    demo = _demo.DEMOS[name]
    data = _demo.load_demo_data(demo)
    held = data[_demo.HELD_OUT]
    assert 0 < len(held) <= len(data) / 3
    m1, m2, a1, a2, l1, g = 0.0938440, 0.137596, 0.108565, 0.116779, 0.172719, 9.80858
    double = np.array(
        [
            (4.37529e-4 + m1 * a1**2 + m2 * l1**2) / 2,
            (1.268829e-3 + m2 * a2**2) / 2,
            m2 * l1 * a2,
            -(m1 * a1 + m2 * l1) * g,
            -m2 * a2 * g,
        ]
    )
    expected = double / double[0] if name == "double" else [1, -128.58]
    np.testing.assert_allclose(list(demo.published.values()), expected, rtol=3e-5)
    assert set(demo.published) <= set(demo.candidates)
    assert set(demo.published_dissipation) <= set(demo.dissipation)
    assert set(demo.known) <= set(demo.candidates)
    library = la.Library(demo.candidates, demo.coordinates, dissipation=demo.dissipation)
    assert not library.reduced(keep=[library[0]]).dropped
    # Hanging at rest is where the published model has its stable equilibrium.
    like = la.LagrangianModel(demo.coordinates, [ModelTerm(demo.candidates[0], 1.0)])
    published = _demo.published_model(demo, like)
    hanging = np.full(len(demo.coordinates), np.pi)
    pulled = published.acceleration(hanging + 0.1, 0 * hanging)
    assert np.abs(published.acceleration(hanging, 0 * hanging)).max() < 1e-9
    assert pulled[0] < 0


def test_help_is_fast_and_has_examples():
    script = """
import sys
from leastaction.cli import program
for args in (["--help"], ["--version"], *([name, "--help"] for name in sys.argv[1:])):
    try:
        program.main(args)
    except SystemExit as end:
        assert end.code == 0, args
heavy = {"numpy", "scipy", "sympy", "pandas", "matplotlib", "jinja2", "rich"} & set(sys.modules)
assert not heavy, heavy
"""
    done = subprocess.run(
        [sys.executable, "-c", script, *COMMANDS], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("Example:\n    leastaction ") == len(COMMANDS) + 1
    assert set(program.commands) == set(COMMANDS)


def test_functions_of_sensors_need_no_numerical_library():
    script = """
import sys
from leastaction.measure import camera, imu
camera(["theta"], [("u", "v")]), imu("theta", gyroscope="gyro")
heavy = {"numpy", "scipy", "sympy"} & set(sys.modules)
assert not heavy, heavy
from leastaction.measure import *
assert Linkage().coordinates == ()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_examples_in_the_help_parse():
    for name in COMMANDS:
        text = run(name, "--help").stdout.split("Example:\n")[1].strip().replace("\\\n", " ")
        words = shlex.split(text)
        assert words[:2] == ["leastaction", name]
        program.commands[name].make_context(name, words[2:])


def test_no_arguments_show_the_help_and_version_is_that_of_the_package():
    from importlib.metadata import version

    assert run().stdout == run("-h").stdout
    assert run("--version").stdout == f"leastaction {version('leastaction')}\n"
    assert shell("--version").stdout == f"leastaction {version('leastaction')}\n"


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["exp"], ["plain,export"]),
        (["discover", "--hold"], ["plain,--hold-out"]),
        (["discover", "--size", "c"], ["plain,compact", "plain,chain"]),
        (["discover", "ru"], ["file,ru"]),
        (["discover", "--output", ""], ["dir,"]),
        (["export", "model.json", "--format", "fmu"], ["plain,fmu2", "plain,fmu3"]),
        (["generate", "single_p"], ["plain,single_pendulum"]),
    ],
)
def test_the_program_answers_the_shell_that_completes(words, offered):
    line = {"COMP_WORDS": "\n".join(["leastaction", *words]), "COMP_CWORD": str(len(words))}
    asked = {**os.environ, **line, "_LEASTACTION_COMPLETE": "bash_complete"}
    command = [sys.executable, "-m", "leastaction"]
    done = subprocess.run(command, env=asked, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == offered


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_completions_is_printed(shell, monkeypatch):
    monkeypatch.setenv("PATH", "")  # without that shell, too
    script = run("completion", shell)
    assert f"_LEASTACTION_COMPLETE={shell}_complete" in script.stdout
    assert script.stderr == ""


def test_completion_is_for_three_shells():
    assert "'tcsh' is not one of 'bash', 'zsh', 'fish'" in run("completion", "tcsh", code=2).stderr


@pytest.mark.skipif(os.name == "nt" or not shutil.which("bash"), reason="no bash")
def test_the_script_completes_in_bash(tmp_path):
    program_file = tmp_path / "leastaction"
    program_file.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m leastaction "$@"\n', encoding="utf-8")
    program_file.chmod(0o755)
    (tmp_path / "script").write_text(run("completion", "bash").stdout, encoding="utf-8")
    typed = """source ./script
COMP_WORDS=(leastaction discover --hold) COMP_CWORD=2
_leastaction_completion ./leastaction
echo "${COMPREPLY[@]}"
complete -p leastaction
"""
    done = subprocess.run(["bash", "-c", typed], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.stderr == ""
    assert done.stdout.splitlines()[0] == "--hold-out"
    assert done.stdout.endswith("-F _leastaction_completion leastaction\n")


@pytest.mark.skipif(os.name == "nt", reason="signals are different there")
def test_interrupt_leaves_nothing_behind(tmp_path):
    command = [sys.executable, "-m", "leastaction", "demo", "--output", "out"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=tmp_path, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()  # the discovery begins now, and takes seconds
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors == "interrupted: nothing was written\n"
    assert list(tmp_path.iterdir()) == []


class Terminal(io.StringIO):
    def isatty(self):
        return True


ROWS = [
    ("term", "coefficient", "95 % interval", "z"),
    ("theta1_dot*theta2_dot*cos(theta1 - theta2)*[red]", "0.98408 ± 0.00018", "0.98373 … 0.98443", "5359"),
    ("x", "1 (known)", "", ""),
]


@pytest.mark.parametrize("width", [20, 40, 62, 80, 200])
def test_table_in_a_terminal_never_cuts_a_number(monkeypatch, width):
    out = Terminal()
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("TERM", "xterm")
    _show.show_table(ROWS, {2: "friction"})
    text = re.sub(r"\x1b\[[0-9;]*m", "", out.getvalue())
    for cell in ROWS[1][1:]:
        assert cell in text
    assert "".join(c for c in ROWS[1][0] if c != " ") in re.sub(r"\s+", "", text) or width in (62, 80)
    if width >= 62:
        assert max(map(len, text.splitlines())) <= width


def test_table_in_a_pipe_is_plain(capsys):
    _show.show_table(ROWS, {2: "friction"})
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].startswith(ROWS[1][0] + "  0.98408 ± 0.00018  0.98373 … 0.98443  5359")
    assert lines[2] == "friction"
    assert all(line == line.rstrip() for line in lines)


def test_progress_shows_in_a_terminal_only(monkeypatch, capsys):
    with _show.live_progress("prepare") as report:
        report("select", {"terms": 5})
    assert capsys.readouterr().err == ""
    err = Terminal()
    monkeypatch.setattr(sys, "stderr", err)
    monkeypatch.setenv("TERM", "xterm")
    with _show.live_progress("prepare") as report:
        report("search", {"terms": 4, "evidence": -np.inf})
        report("select", {"terms": 5, "evidence": 12.34})
    assert "choosing terms: 5 terms, evidence 12.3" in err.getvalue()


def test_describe_knows_the_stages_of_discover():
    said = [
        _show.describe(stage, details)
        for stage, details in (
            ("prepare", {}), ("search", {"terms": 1, "evidence": 1.0}), ("knots", {"knots_per_second": 16.2}),
            ("verify", {}), ("other", {"loss": "0.1"}), ("drift", {"theta": 0.123456789}),
            ("coarse", {"forecast_error": 0.0123, "before": 0.5}),
        )
    ]  # fmt: skip
    assert said == [
        "preparing", "searching the weak form: 1 term, evidence 1.0", "refining knots: 16 knots per second",
        "verifying", "other: loss 0.1", "following drifting forces: theta 0.1235",
        "comparing with a coarser spline: forecasts off by 0.012 of the spread, 0.5 before",
    ]  # fmt: skip


def test_errors_of_coefficients_end_at_their_second_digit():
    Term = ModelTerm
    shown = [
        _show.with_error(term)
        for term in (
            Term("x", 0.557712, 0.0012),
            Term("x", -117.71, 0.2),
            Term("x", 2.0, known=True),
            Term("x", 2.0, np.nan),
        )
    ]
    assert shown == ["0.5577 ± 0.0012", "-117.71 ± 0.20", "2 (known)", "2"]


def test_parsers_of_options():
    assert _values.name_list(" a, b ") == ["a", "b"]
    assert _values.column_map("tau1,,tau3") == ["tau1", "", "tau3"]
    assert _values.column_map("a=tau 1, b = x=y") == {"a": "tau 1", "b": "x=y"}
    assert _values.assignments("theta=1, theta_dot=-.5e1") == {"theta": 1.0, "theta_dot": -5.0}
    assert _values.known_coefficients(["cos(theta)=9.81", "x = 2"]) == {"cos(theta)": 9.81, "x": 2.0}
    options = _data_options("f.csv", "a,b", ",tau", "b")
    assert (options.forces, options.angles) == ({"b": "tau"}, ("b",))
    assert _text.shown("a\x1bb\n") == "a?b?"


def test_the_first_interrupt_keeps_the_best_law_and_the_second_gives_up(capsys):
    import signal

    from leastaction.cli.failures import stoppable

    before, stages = signal.getsignal(signal.SIGINT), []

    def interrupted_twice() -> None:
        with stoppable(lambda stage, details: stages.append(stage)) as progress:
            progress("select", {})
            signal.raise_signal(signal.SIGINT)
            progress("verify", {})  # too late to stop a search
            try:
                progress("select", {})
            except la.StopSearch:
                signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        interrupted_twice()
    assert stages == ["select", "verify"]
    assert "best law so far" in capsys.readouterr().err
    assert signal.getsignal(signal.SIGINT) is before


# ---------------------------------------------------------------------------------------- --term and --shape
MORSE = ["--term", "exp(-{a}*x)", "--term", "exp(-2*{a}*x)"]


@pytest.fixture
def morse(tmp_path, monkeypatch):
    """Work in a directory with two short recordings in a Morse potential, D = 2, a = 0.8."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("LEASTACTION_DEBUG", raising=False)

    def acceleration(q, v, f):
        return -3.2 * (np.exp(-0.8 * q) - np.exp(-1.6 * q))

    starts = [([2.0], [0.0]), ([0.0], [1.2])]
    data = record(acceleration, starts, ["x"], duration=7.0, rate=25.0, noise=0.01, seed=3)
    la.write_csv("run.csv", data)
    (tmp_path / "lib.txt").write_text("x_dot**2\nx**2\n", encoding="utf-8")


def discover(*more: str):
    options = ["--coordinates", "x", "--trial", "trial", "--known", "x_dot**2=0.5", "--library", "lib.txt"]
    return CliRunner().invoke(program, ["discover", "run.csv", *options, "--output", "out", *more])


def test_a_column_is_calibrated(tmp_path):
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 8.0, 401)
    y = 3.0 + 2.0 * np.cos(1.5 * t) + 0.01 * rng.standard_normal(t.size)  # x'' = -2.25 x
    file, terms, out = (tmp_path / name for name in ("run.csv", "terms.txt", "out"))
    file.write_text("t,y\n" + "\n".join(f"{a},{b}" for a, b in zip(t, y, strict=True)))
    terms.write_text("x_dot**2\nx**2\n")
    options = ["--coordinates", "y", "--hidden", "x", "--library", terms, "--known", "x_dot**2=0.5"]
    measure = ["--measure", "y = 2*x + {b}"]
    result = run("discover", file, *options, *measure, "--output", out)
    assert "calibration numbers:" in result.output
    (number,) = json.loads((out / "model.json").read_text())["calibration"]["numbers"]
    assert abs(number["value"] - 3.0) < 4.0 * number["standard_error"]
    many = run("discover", file, *options[:4], "--known", "z=1", "--output", out, code=2)
    assert "warning: with --hidden, 32 candidates may take long" in many.output
    wrong = run("discover", file, *options, "--measure", "z = x", "--output", out, code=2)
    assert "--measure" in wrong.output
    assert "has no column" in wrong.output


def test_forces_act_on_a_coordinate_that_columns_measure(tmp_path):
    """x'' = -2.25 x + sin t: the force sets the scale of L, and validate takes it, too."""
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 8.0, 401)
    y = 3.0 + 2.0 * (np.cos(1.5 * t) + np.sin(t) / 1.25) + 0.01 * rng.standard_normal(t.size)
    file, terms, out = (tmp_path / name for name in ("run.csv", "terms.txt", "out"))
    file.write_text("t,y,u\n" + "\n".join(f"{a},{b},{np.sin(a)}" for a, b in zip(t, y, strict=True)))
    terms.write_text("x_dot**2\nx**2\n")
    options = ["--coordinates", "y", "--hidden", "x", "--library", terms, "--measure", "y = 2*x + {b}"]
    run("discover", file, *options, "--forces", "x=u", "--output", out)
    kinetic, potential = la.load(out / "model.json").terms
    assert abs(kinetic.coefficient - 0.5) < 4.0 * kinetic.standard_error
    assert abs(potential.coefficient + 1.125) < 4.0 * potential.standard_error
    assert "without --forces" not in run("validate", out / "model.json", file, "--forces", "u").output
    wrong = run("discover", file, *options, "--forces", "y=u", "--output", out, code=2)
    assert "--forces: 'y' is not a coordinate; the coordinates are x" in wrong.output
    wrong = run("discover", file, *options, "--angles", "z", "--output", out, code=2)
    assert "name coordinates without a column in --hidden" in wrong.output


@pytest.mark.thorough
@pytest.mark.usefixtures("morse")
def test_a_number_is_found_and_shown():
    result = discover(*MORSE, "--shape", "a=0.1..10")
    assert result.exit_code == 0, result.output
    assert "shape parameters:" in result.stdout
    (line,) = [line for line in result.stdout.splitlines() if line.split()[:1] == ["{a}"]]
    assert "±" in line
    model = la.load("out/model.json")
    assert {term.written for term in model.terms} == {"x_dot**2", "exp(-{a}*x)", "exp(-2*{a}*x)"}
    (rate,) = model.shapes
    assert abs(rate.value - 0.8) <= 4.0 * rate.standard_error
    assert model.provenance["options"]["shapes"] == {"a": [0.1, 10.0]}


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--shape", "a"], "--shape: 'a' is no range; expected NAME=LOW..HIGH"),
        (["--shape", "a=1"], "--shape: 'a=1' is no range"),
        (["--shape", "a=one..two"], "'one'"),
        (["--shape", "a=2..1"], "low < high"),
        (["--shape", "a=0..1", "--shape", "a=1..2"], "a has two ranges; give one"),
        (["--shape", "b=0..1"], "not a shape parameter of the library (it has a)"),
        (["--term", "exp(-{x}*x)"], "--term:"),
        (["--term", "{b}*x"], "{b} only scales the term"),
        (["--term", "exp(-{b*x)"], "braces hold the name of a shape parameter"),
    ],
)
@pytest.mark.usefixtures("morse")
def test_wrong_options_end_with_one_line(more, says):
    result = discover(*MORSE, *more)
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert says in result.stderr
    assert result.stdout == ""


def test_simulate_states_the_error_of_the_motion(model, tmp_path):
    start = ["--initial", "theta=1", "--duration", 1, "--rate", 20, "-o", tmp_path / "run.csv"]
    run("simulate", model, *start, "--initial-std", "theta=0.01")
    table = pd.read_csv(tmp_path / "run.csv")
    assert [*table] == ["t", "theta", "theta_dot", "theta_std"]
    assert 0.008 < table["theta_std"][0] < 0.012
    refused = run("simulate", model, *start, "--initial-std", "x=0.01", code=2)
    assert "--initial-std: 'x' is not in the model" in refused.output
