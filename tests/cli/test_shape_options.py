"""``--term`` and ``--shape``: unknown numbers in candidates on the command line."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

import leastaction as la
from helpers import record
from leastaction.cli import program

MORSE = ["--term", "exp(-{a}*x)", "--term", "exp(-2*{a}*x)"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
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
        (["--shape", "b=0..1"], "no shape parameter of the library (it has a)"),
        (["--term", "exp(-{x}*x)"], "--term:"),
        (["--term", "{b}*x"], "{b} only scales the term"),
        (["--term", "exp(-{b*x)"], "braces hold the name of a shape parameter"),
    ],
)
def test_wrong_options_end_with_one_line(more, says):
    result = discover(*MORSE, *more)
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert says in result.stderr
    assert result.stdout == ""
