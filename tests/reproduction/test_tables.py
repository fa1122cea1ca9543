"""The methods of reproduction/ and its tables."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
import textwrap
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import leastaction as la
from leastaction import systems
from reproduction import scoring
from reproduction._execute import execute
from reproduction._further_tables import is_right, speed, without_candidates
from reproduction._results import Group, Results, store_of
from reproduction._tables import ablation, experiments, group_tables, number
from reproduction.collate import HERE, findings, main, mixed_settings
from reproduction.methods import _symbolic, adam, load, xlsindy
from reproduction.methods.energy import Normal, best_supports
from reproduction.methods.rk4_sindy import Dictionary
from reproduction.problem import Answer, Case, acceleration_of, pose
from reproduction.run import main as run
from reproduction.scoring import score

PAPER = json.loads((HERE / "paper.json").read_text())
GROUP = Group("relative", "compact", 5)


@cache
def problem(system="cart_spring_pendulum", noise=0.1, library="compact"):
    return pose(Case(system, noise, "ours", trajectories=1, library=library))


def found(coefficients, acceleration=None, **more):
    return score(problem(), Answer(coefficients, acceleration, **more))


class TestScore:
    @pytest.mark.thorough
    def test_truth_has_no_error(self):
        scores = found(problem().true_coefficients, problem().system.acceleration)
        assert (scores["l2"], scores["l2_over_crb"], scores["equation_error"]) == (0.0, 0.0, 0.0)
        assert (scores["precision"], scores["recall"], scores["exact"]) == (1.0, 1.0, True)
        assert scores["forecast_horizon"] == 20.0
        assert scores["undefined"] == 0.0
        assert scores["covered"] is None

    def test_known_term_counts_for_nothing_and_any_spelling_will_do(self):
        free = {k: v for k, v in problem().true_coefficients.items() if k not in problem().known}
        other = {"cos(theta)*theta_dot*x_dot" if "cos" in k else k: v for k, v in free.items()}
        assert set(other) != set(free)
        assert found(other) == found(free) == found({**free, "cos(theta)": 1e6})
        assert found(free)["l2"] == 0.0

    def test_numbers(self):
        # truth: 1.5 ẋ² + ẋθ̇cos θ + 0.5 θ̇² − 5 x² + 5 x
        scores = found(
            {"x_dot**2": 1.5, "theta_dot**2": 0.5, "x**2": -5.0, "x": 4.0, "x**3": 2.0, "sin(x)": 1.0}
        )
        size = np.sqrt(1.5**2 + 1 + 0.5**2 + 25 + 25)
        assert scores["l2"] == pytest.approx(np.sqrt(1 + 1 + 4 + 1) / size)
        assert scores["precision"] == pytest.approx(4 / 6)
        assert scores["recall"] == pytest.approx(4 / 5)
        assert not scores["exact"]
        p = problem()
        bound = la.metrics.cramer_rao_bound(p.system, p.truth, p.noise_std, observed=p.data).relative
        assert scores["l2_over_crb"] == pytest.approx(scores["l2"] / bound)

    def test_nothing_found(self):
        scores = found({})
        assert (scores["l2"], scores["precision"], scores["recall"]) == (1.0, 0.0, 0.0)

    def test_intervals(self):
        free = {k: v for k, v in problem().true_coefficients.items() if k not in problem().known}
        estimate = {k: v + 0.1 for k, v in free.items()} | {"x**3": 0.1}
        errors = dict.fromkeys(estimate, 0.04) | {"x": 0.06, "x**2": 0.0511}
        scores = found(estimate, errors=errors)
        assert (scores["covered"], scores["intervals"]) == (2, 5)

    def test_history(self):
        true = problem().true_coefficients
        off = [100.0, 0.104, float("nan"), 0.1, 0.5]
        history = [(k + 1.0, true | {"x**3": error}) for k, error in enumerate(off)]
        scores = found(true, history=history)
        assert (scores["seconds_to_best"], scores["seconds_at_best"]) == (2.0, 4.0)
        size = np.sqrt(1.5**2 + 1 + 0.5**2 + 50)
        assert scores["best_l2"] == pytest.approx(0.1 / size)
        # 0.1 is less than another 5 % below 0.104
        assert scores["course"] == [(1.0, pytest.approx(100 / size)), (2.0, pytest.approx(0.104 / size))]

    def test_coefficients_that_are_not_finite_are_a_failure(self):
        with pytest.raises(ValueError, match="not finite"):
            found({"x": float("nan")})

    def test_no_lagrangian(self):
        scores = found(None, problem().system.acceleration)
        assert scores["l2"] is None
        assert scores["exact"] is None
        assert scores["equation_error"] == 0.0

    def test_no_bound_without_noise(self):
        p = problem("single_pendulum", 0.0)
        scores = score(p, Answer(p.true_coefficients, None))
        assert scores["l2_over_crb"] is None
        assert scores["l2"] == 0.0

    @pytest.mark.thorough
    def test_bound_in_a_library_that_splits_a_true_term(self):
        p = problem("double_pendulum", 0.1, "large")
        assert set(p.true_coefficients) != set(p.system.lagrangian)
        textbook = la.metrics.cramer_rao_bound(p.system, p.truth, p.noise_std).relative
        crb = score(p, Answer(p.true_coefficients, None))["crb"]
        assert crb != pytest.approx(textbook)
        assert crb == pytest.approx(textbook, rel=0.3)

    def test_equation_error_is_relative_and_unknown_places_count(self):
        right = problem().system.acceleration
        assert found(None, lambda q, v, f: 1.1 * right(q, v, f))["equation_error"] == pytest.approx(0.1)

        def gaps(q, v, f):
            return np.where(np.arange(len(q))[:, None] % 4 == 0, np.nan, right(q, v, f))

        scores = found(None, gaps)
        assert scores["undefined"] == pytest.approx(0.25, abs=1e-3)
        assert scores["equation_error"] == pytest.approx(0.5, rel=0.1)

    @pytest.mark.thorough
    def test_test_motions_are_not_in_the_data(self):
        p = problem()
        starts = [tuple(m.q[0]) for m in (*p.truth, *scoring.fresh_motions(p))]
        assert len(set(starts)) == len(starts) == 3
        later = pose(Case(p.case.system, 0.1, "ours", trial=1, trajectories=1))
        assert not np.array_equal(scoring.fresh_motions(later)[0].q, scoring.fresh_motions(p)[0].q)


class TestHorizon:
    def test_slightly_wrong_model_loses_the_motion(self):
        right = problem().system.acceleration
        horizons = [
            found(None, lambda q, v, f, e=error: (1 + e) * right(q, v, f))["forecast_horizon"]
            for error in (1e-1, 1e-2)
        ]
        assert 0 < horizons[0] < horizons[1] <= 20

    def test_first_departure_counts(self):
        p = problem()
        motion = scoring.fresh_motions(p)[0]
        tolerance = systems.noise_std(p.system, [motion], 0.1)
        straight = motion.q[0] + np.outer(motion.t, motion.qdot[0])
        off = np.flatnonzero((np.abs(straight - motion.q) > tolerance).any(axis=1))[0]
        horizon = scoring._horizon(lambda q, v, f: 0 * q, motion, tolerance)
        assert horizon == pytest.approx(motion.t[off - 1])

    @pytest.mark.parametrize(
        "name", ["blow-up", pytest.param("stiff", marks=pytest.mark.thorough), "nan", "raises"]
    )
    def test_bad_models_do_not_hang(self, name):
        wrong = {
            "blow-up": lambda q, v, f: 1e3 * v**3,
            "stiff": lambda q, v, f: -1e9 * v - 1e12 * q,
            "nan": lambda q, v, f: np.full_like(q, np.nan),
        }

        def fails(q, v, f):
            raise RuntimeError("outside its domain")

        scores = found({}, wrong.get(name, fails))
        assert scores["l2"] == 1.0
        if name == "raises":
            assert scores["acceleration_failure"] == "RuntimeError: outside its domain"
            assert scores["forecast_horizon"] is None
        else:
            assert 0 <= scores["forecast_horizon"] < 2

    def test_model_undefined_at_the_start_is_asked_once(self):
        motion, asked = scoring.fresh_motions(problem())[0], []
        scoring._horizon(lambda q, v, f: asked.append(1) or np.full_like(q, np.nan), motion, np.ones(1))
        assert len(asked) == 1


def record(method="ours", l2=0.01, trial=0, system="single_pendulum", noise=0.1, finished=True, **other):
    """Return a record; names of `other` may be of the configuration or of the result."""
    case = Case(system, noise, method, trial)
    config = case.as_dict() | {k: v for k, v in other.items() if hasattr(case, k)}
    result = {"finished": finished, "status": "ok", "l2": l2, "precision": 1.0, "recall": 1.0, "exact": True}
    result |= {"l2_over_crb": l2 and 100 * l2, "equation_error": 0.1, "forecast_horizon": 5.0, "wall_s": 2.0}
    result |= {"peak_mb": 100.0, "covered": 2, "intervals": 2, "seconds_to_best": None, "best_l2": None}
    if not finished:
        result = {"finished": False, "status": "timed out", "reason": "no result after 9 s"}
    result |= {k: v for k, v in other.items() if not hasattr(case, k)}
    result.setdefault("cpu_s", result.get("wall_s"))
    return {
        "config": config,
        "result": result,
        "method": {"title": {"ours": "Ours", "adam": "Paper's"}.get(method, method), "reference": ""},
        "versions": {"python": "3.11.1", "numpy": "2.0"},
        "machine": {"processor": "P", "cores": 2, "system": "Linux", "parallel_runs": 1},
        "commit": "a" * 40,
        "date": f"2026-01-0{trial + 1}T00:00:00+00:00",
    }


def table(title, records):
    tables = group_tables(Results(records), GROUP, PAPER)
    return next(t for t in tables if t.title.startswith(title))


class TestTables:
    def test_means_best_and_published_numbers(self):
        records = [
            record(l2=0.01),
            record(l2=0.03, trial=1),
            record("adam", 0.5),
            record("adam", 0.1, trial=1),
        ]
        accuracy = table("Accuracy", records)
        assert accuracy.head[2:4] == ["Ours", "Paper's"]
        assert accuracy.head[4:] == [f"{n}, published" for n in ("xL-SINDy", "the paper's method", "uDSR")]
        (row,) = accuracy.rows
        assert [cell.text for cell in row] == [
            "single pendulum",
            "10 %",
            "2.00",
            "30.0",
            "26.72",
            "10.94",
            "159.66",
        ]
        assert [cell.best for cell in row[2:]] == [True, False, False, False, False]
        assert row[2].detail == "100/100"
        assert row[6].detail == "33.33/100"

    def test_published_number_can_be_the_best(self):
        (row,) = table("Accuracy", [record(l2=0.5)]).rows
        assert [cell.best for cell in row[2:]] == [False, False, True, False]

    def test_failures_are_counted_and_never_the_best(self):
        records = [record(l2=0.02), record(l2=0.02, trial=1), record("adam", 1e-9)]
        (row,) = table("Accuracy", [*records, record("adam", trial=1, finished=False)]).rows
        assert (row[2].best, row[3].best) == (True, False)
        assert row[3].detail == "100/100; 1 of 2 runs"
        only = table("Accuracy", [records[0], record("adam", finished=False)]).rows[0][3]
        assert (only.text, only.detail) == ("timed out", "0 of 1 runs")
        runs = table("Runs", [*records, record("adam", trial=1, finished=False)])
        assert [cell.text for cell in runs.rows[1]] == [
            "Paper's",
            "2",
            "1",
            "1",
            "0",
            "timed out: no result after 9 s",
        ]
        partial = table("Accuracy", records).rows[0][3]  # its second trial has not been run yet
        assert (partial.detail, partial.best) == ("100/100; 1 of 2 runs", False)

    def test_ratio_to_the_bound_is_a_root_mean_square(self):
        bound = table(
            "Error relative", [record(l2_over_crb=1.0), record(trial=1, l2_over_crb=7.0, exact=False)]
        )
        (row,) = bound.rows
        assert (row[2].text, row[2].detail) == ("5.00", "1/2 exact")

    def test_longest_horizon_is_the_best_and_equal_ones_share(self):
        records = [
            record(),
            record("adam", forecast_horizon=20.0),
            record("sindy", None, forecast_horizon=20.0),
        ]
        assert [c.best for c in table("Forecast", records).rows[0][2:]] == [False, True, True]
        assert [c.best for c in table("Wall", records).rows[0][2:]] == [True, True, True]

    def test_methods_without_coefficients_are_in_the_other_tables(self):
        records = [record(), record("sindy", None, precision=None, recall=None)]
        assert "sindy" not in table("Accuracy", records).head
        assert table("Equation error", records).head[2:] == ["Ours", "sindy"]
        assert table("Accuracy", [*records, record("operon", finished=False)]).head[3] == "operon"

    def test_second_table(self):
        plain = [record(noise=0.0), record("adam", noise=0.0)]
        assert ablation(Results(plain), GROUP, PAPER) is None
        more = [
            record(noise=0.0, missing=0.05, l2=0.02),
            record("adam", noise=0.0, variant="no-regularisation", l2=0.5),
        ]
        second = ablation(Results([*plain, *more, record("sindy")]), GROUP, PAPER)
        assert second.head[2:] == [
            "Ours: A",
            "Ours: B",
            "Paper's: A",
            "Paper's: C",
            *(f"published: {p}" for p in "ABC"),
        ]
        (row,) = second.rows
        assert [c.text for c in row[2:]] == ["1.00", "2.00", "1.00", "50.0", "0.41", "0.41", "12.36"]
        first = table("Accuracy", [*plain, *more])
        assert len(first.rows) == 1
        assert "no-regularisation" not in " ".join(first.head)

    def test_runs_of_other_tasks_do_not_compete(self):
        plain = [record(), record("adam", 0.3), record("operon", None, cpu_s=4.0)]
        others = [record("udsr", None), record("udsr", None, variant="repaired")]
        others += [record("ours", 1e-9, variant="names"), record("operon", None, variant="given-rates")]
        assert group_tables(Results([*plain, *others]), GROUP, PAPER) == group_tables(
            Results(plain), GROUP, PAPER
        )
        assert speed(Results([*plain, *others])) == speed(Results(plain)) != []

    def test_those_without_candidates_are_compared_on_the_same_trials(self):
        good = {"equation_error": 0.0005, "forecast_horizon": 12.0, "noise": 0.0}
        plain = [record(trial=k, noise=0.0, equation_error=0.0001 + k, exact=bool(k)) for k in (0, 1)]
        assert without_candidates(Results(plain), GROUP, PAPER) == []
        law = {"expression": "theta_ddot = " + "sin(theta) + " * 20, "coefficients": None, "exact": None}
        asked = [record("udsr", None, variant="repaired", **law, **good)]
        asked += [record(variant="names", coefficients={"theta_dot**2": 0.5, "cos(theta)": -2.0}, **good)]
        asked += [record("udsr", finished=False, noise=0.0), record("udsr", None, **law, missing=0.05)]
        errors, cost, found = without_candidates(Results([*plain, *asked]), GROUP, PAPER)
        assert errors.head[2:6] == [
            "leastaction, compact candidates",
            "leastaction, names alone",
            "uDSR as released",
            "uDSR repaired",
        ]
        assert [(c.text, c.detail, c.best) for c in errors.rows[0][2:]] == [
            ("1.0e−4", "5.00 s", True),  # of the first trial alone
            ("5.0e−4", "right form, 12.0 s", False),
            ("timed out", "", False),
            ("5.0e−4", "right form, 12.0 s", False),
            ("162.44", "40/100", False),
        ]
        assert [c.text for c in errors.rows[-1]] == [
            "right form",
            "",
            "0 of 1",
            "1 of 1",
            "0 of 1",
            "1 of 1",
            "",
        ]
        assert [c.text for c in cost.rows[0][2:]] == ["2.00", "2.00", "–", "2.00"]
        assert [row[2].text[:30] for row in found.rows] == [
            "L = 0.5*theta_dot**2 -2*cos(th",
            "timed out",
            "theta_ddot = sin(theta) + sin(",
        ]
        assert found.rows[-1][2].text.endswith(f"… ({len(law['expression'])} characters)")

    @pytest.mark.parametrize(
        ("exact", "error", "noise", "right"),
        [
            (True, 0.1, 0.1, True),
            (False, 1e-9, 0.0, False),
            (None, 0.0009, 0.0, True),
            (None, 0.001, 0.0, False),
            (None, None, 0.0, False),
            (None, 1e-9, 0.01, None),
        ],
    )
    def test_form_is_judged_by_terms_or_without_noise(self, exact, error, noise, right):
        runs = [record(noise=noise, trial=k, exact=exact, equation_error=error) for k in (0, 1)]
        assert is_right(Results(runs)) is right
        assert is_right(Results([*runs, record(finished=False, noise=noise)])) is False

    def test_experiments_are_no_competitors(self):
        plain = [record(), record("adam", 0.3), record("adam", 0.3, system="double_pendulum")]
        assert experiments(Results(plain), GROUP, PAPER) is None
        told = [record("adam", 1e-9, variant="true-terms", wall_s=1e-9)]
        tried = experiments(Results([*plain, *told]), GROUP, PAPER)
        assert tried.head[2:] == ["as in the tables", "true-terms", "published"]
        assert [[c.text for c in row[2:]] for row in tried.rows] == [["30.0", "1.0e−7", "10.94"]]
        assert table("Accuracy", [*plain, *told]) == table("Accuracy", plain)
        assert speed(Results([*plain, *told])) == speed(Results(plain))

    def test_speed_is_a_geometric_mean_of_pairs_from_one_machine(self):
        records = [record(), record(trial=1), record(noise=0.0, system="magnetic_pendulum", wall_s=1.0)]
        records += [record("adam", wall_s=99.0, seconds_to_best=4.0), record("adam", trial=1, wall_s=16.0)]
        records += [
            record("adam", noise=0.0, system="magnetic_pendulum", wall_s=16.0),
            record("adam", trial=2),
        ]
        other = record("adam", trial=0, wall_s=1e9)
        other["machine"] = other["machine"] | {"cores": 64}
        (table,) = speed(Results([*records, other]))
        rows = table.rows
        assert [[c.text for c in row] for row in rows] == [
            ["single pendulum", "4.00"],  # of 2 and 8
            ["magnetic pendulum", "16.0"],
            ["geometric mean", "8.00"],
        ]
        assert [row[1].detail for row in rows] == ["2 pairs", "1 pair", "3 pairs"]

    def test_speed_until_ours_is_as_good(self):
        course = [[0.5, 2.0], [1.0, 0.104], [2.0, 0.01]]
        records = [record(trial=k, course=course) for k in range(3)]
        records += [
            record("adam", 0.3, best_l2=0.1, seconds_to_best=16.0, wall_s=30.0, cpu_s=15.0),  # ours after 1 s
            record("adam", 0.01, trial=1, wall_s=4.0),  # after 2 s
            record("adam", 1e-9, trial=2),  # never
            record("sindy", None),  # has no such error
        ]
        table = speed(Results(records))[1]
        assert table.head == ["system", "Paper's"]
        assert [[c.text for c in row] for row in table.rows] == [
            ["single pendulum", "4.00"],  # of 8 and 2
            ["geometric mean", "4.00"],
        ]
        assert table.rows[0][1].detail == "2 of 3 pairs"

    @pytest.mark.parametrize(
        ("value", "text"),
        [
            (None, "–"),
            (0.0, "0.00"),
            (0.31, "0.310"),
            (26.72, "26.7"),
            (162.4, "162"),
            (2.84e-7, "2.8e−7"),
            (5e5, "5.0e5"),
        ],
    )
    def test_number(self, value, text):
        assert number(value) == text


class TestFindings:
    def found(self, *records, remarks=None):
        return findings(Results(records), GROUP, PAPER, remarks or {})

    def test_nothing_to_say(self):
        assert self.found(record(l2=0.01), record("adam", 0.2)) == []  # published: 0.1094

    def test_beaten_and_missed(self):
        ours, papers = self.found(record(l2=0.5), record("adam", 0.25))
        assert ours.key == "ours/single_pendulum/0.1/relative/compact/5"
        assert "Single pendulum, 10 % noise: Ours with ℓ2 50.0 × 10⁻²" in ours.text
        assert "the paper's method (published) has ℓ2 10.9 × 10⁻², 4.57 times less" in ours.text
        assert "run here, is 2.29 times the published 10.94 × 10⁻²" in papers.text

    def test_runs_that_arrived_are_counted_beside_those_that_did_not(self):
        (papers,) = self.found(
            record("adam", 0.05), record("adam", 0.9, trial=1), record("adam", 0.06, trial=2)
        )
        assert "is 3.08 times the published" in papers.text
        assert "Median of the runs 6.00 × 10⁻², smallest 5.00 × 10⁻²; 2 of 3 runs are within 2" in papers.text

    def test_what_the_true_terms_alone_give_is_said(self):
        told = record("adam", 0.02, variant="true-terms")
        (papers,) = self.found(record("adam", 0.5), told)
        assert papers.text.endswith("With the true terms as its only candidates: 2.00 × 10⁻² (1 run).")
        assert self.found(record("adam", 0.2), told) == []

    def test_failed_runs_are_said(self):
        ours, papers = self.found(record(finished=False), record("adam", finished=False))
        assert "Ours has an answer in 0 of 1 runs (timed out: no result after 9 s)" in ours.text
        assert "Paper's has an answer in 0 of 1 runs" in papers.text

    def test_remarks_by_key_or_its_beginning(self):
        remarks = {"ours": "x", "ours/single_pendulum/0.1": "Because.", "adam/double_pendulum": "y"}
        ours, papers = self.found(record(l2=0.5), record("adam", 0.25), remarks=remarks)
        assert (ours.remark, papers.remark) == ("Because.", "")


def test_published_numbers_are_complete():
    table1, table2 = PAPER["table1"]["methods"], PAPER["table2"]["parts"]
    assert all(tuple(rows) == systems.names() for rows in (*table1.values(), *table2.values()))
    assert all(np.shape(list(rows.values())) == (7, 3, 3) for rows in table1.values())
    assert all(np.shape(list(rows.values())) == (7, 3) for rows in table2.values())
    for name, row in table2["A"].items():  # the same runs as in the first table
        assert row == table1["the paper's method"][name][0]


def test_collate_writes_the_tables(tmp_path):
    records = [record(l2=0.5), record("adam", 0.2), record("adam", variant="no-regularisation", l2=0.9)]
    records.append(record(library="large", l2=0.1))
    store = store_of(tmp_path)
    for document in records:
        store.append(document)
    (tmp_path / "notes").mkdir()
    remarks = tmp_path / "notes" / "remarks.json"
    remarks.write_text(json.dumps({"ours/single_pendulum": "A remark <by hand>."}))
    options = ["--results", str(tmp_path), "--output", str(tmp_path / "out"), "--remarks", str(remarks)]
    answer = CliRunner().invoke(main, options)
    assert answer.exit_code == 0, answer.output
    text = (tmp_path / "out" / "tables.md").read_text()
    for part in (
        "Compact library",
        "Large library",
        "Second table",
        "Speed",
        "Origin",
        "aaaaaaaaaaaa (4 runs)",
    ):
        assert part in text
    assert "A remark <by hand>." in text
    assert "P, 2 cores, Linux, one run at a time (4 runs)" in text
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert all(line.count("|") > 2 for line in rows)


def test_runs_with_old_settings_are_named():
    searched = {"threshold": 0.1, "start_coefficients": "regression"}
    old = searched | {"threshold": 0.2}
    records = [record("adam", settings=searched), record("adam", trial=1, settings=dict(searched))]
    records += [record("xlsindy_exact", settings=searched), record("xlsindy_exact", trial=1, settings=old)]
    assert mixed_settings(Results(records)) == []
    late = record("adam", missing=0.05, settings=old)
    assert mixed_settings(Results([*records, late])) == ["adam single_pendulum 0.1"]


def test_collate_names_a_file_that_is_no_record(tmp_path):
    path = Path(tmp_path) / "half.json"
    path.write_text('{"config": ')
    answer = CliRunner().invoke(main, ["--results", str(tmp_path), "--output", str(tmp_path / "out")])
    assert answer.exit_code == 1
    assert "half.json is not the record of a run" in answer.output
    path.write_text(json.dumps(record()))
    (tmp_path / "ours.jsonl").write_text(json.dumps(record()) + "\n{}\n")
    answer = CliRunner().invoke(main, ["--results", str(tmp_path), "--output", str(tmp_path / "out")])
    assert answer.exit_code == 1
    assert "ours.jsonl, line 2, is not the record of a run" in answer.output
    (tmp_path / "ours.jsonl").unlink()
    path.unlink()
    assert "no records" in CliRunner().invoke(main, ["--results", str(tmp_path)]).output


# ------------------------------------------------------------------------------------------------ the methods
def posed(method, system="single_pendulum", noise=0.0, **options):
    options.setdefault("trajectories", 2)
    return pose(Case(system, noise, method, **options))


def true_states(problem):
    motion = problem.truth[0]
    return motion.q, motion.qdot, motion.forces, motion.qddot


def l2(problem, found):
    free = {k: v for k, v in problem.true_coefficients.items() if k not in problem.known}
    difference = [free.get(k, 0.0) - found.get(k, 0.0) for k in {*free, *found}]
    return np.linalg.norm(difference) / np.linalg.norm(list(free.values()))


@pytest.fixture
def brief(monkeypatch):
    monkeypatch.setattr(xlsindy, "EPOCHS", 100)
    monkeypatch.setattr(xlsindy, "PENALTIES", (1e-4, 1e-2))
    monkeypatch.setattr(xlsindy, "THRESHOLDS", (0.1,))


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["double_pendulum", "cart_spring_pendulum"])
def test_acceleration_of_true_coefficients(name):
    problem = posed("energy", name)
    q, qdot, forces, qddot = true_states(problem)
    acceleration = acceleration_of(problem.library, problem.true_coefficients)
    assert acceleration(q, qdot, forces) == pytest.approx(qddot, rel=1e-8, abs=1e-8)


def test_acceleration_is_nan_only_where_the_mass_matrix_is_singular():
    library = la.Library(["x_dot**2*x", "x**2"], ["x"])
    acceleration = acceleration_of(library, {"x_dot**2*x": 1.0, "x**2": -1.0})
    found = acceleration([[0.0], [2.0], [np.inf]], [[1.0], [0.0], [0.0]], None)
    # 2 x ẍ + ẋ² + 2 x = 0
    assert np.isnan(found[[0, 2]]).all()
    assert found[1] == pytest.approx(-1.0)
    empty = acceleration_of(library, {})
    assert np.isnan(empty([[1.0]], [[1.0]])).all()


@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize(
    "name", ["single_pendulum", pytest.param("magnetic_pendulum", marks=pytest.mark.thorough)]
)
def test_xlsindy_finds_exact_motions_exactly(name):
    problem = posed("xlsindy_exact", name)
    answer = load("xlsindy_exact").solve(problem)
    assert set(answer.coefficients) | set(problem.known) == set(problem.true_coefficients)
    assert l2(problem, answer.coefficients) < 3e-3
    q, qdot, forces, qddot = true_states(problem)
    error = answer.acceleration(q, qdot, forces) - qddot
    assert np.linalg.norm(error) < 1e-2 * np.linalg.norm(qddot)


@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize("name", ["xlsindy_positions", "ours"])
def test_history_ends_in_the_answer(name):
    answer = load(name).solve(posed(name))
    seconds = [t for t, _ in answer.history]
    assert len(seconds) > 3
    assert seconds == sorted(seconds)
    assert answer.history[-1][1] == answer.coefficients
    assert answer.history[0][1] != answer.coefficients


@pytest.mark.usefixtures("brief")
@pytest.mark.thorough
def test_xlsindy_ends_in_least_squares():
    problem = posed("xlsindy_exact", "magnetic_pendulum", noise=0.02)
    states = load("xlsindy_exact").states(problem)
    answer = load("xlsindy_exact").solve(problem)
    columns = np.concatenate([la.euler_lagrange(problem.library, *s.swapaxes(0, 1)) for s, _ in states])
    columns = columns.reshape(-1, len(problem.library))
    kept = [problem.library.index(text) for text in answer.coefficients]
    (known,) = problem.known.items()
    target = -known[1] * columns[:, problem.library.index(known[0])]
    expected = np.linalg.lstsq(columns[:, kept], target, rcond=None)[0]
    assert list(answer.coefficients.values()) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("convention", ["relative", "absolute"])
def test_xlsindy_exact_is_given_noise_of_the_level_on_all_channels(convention):
    problem = posed("xlsindy_exact", "double_pendulum", 0.05, noise_convention=convention, missing=0.1)
    states = np.concatenate([s for s, _ in load("xlsindy_exact").states(problem)])
    kept = [np.isfinite(measured.q).all(axis=1) for measured in problem.data]
    for place, name in ((1, "qdot"), (2, "qddot")):
        exact = [getattr(motion, name) for motion in problem.truth]
        spread = np.concatenate(exact).std(axis=0) if convention == "relative" else 1.0
        exact = np.concatenate([e[k] for e, k in zip(exact, kept, strict=True)])
        assert (states[:, place] - exact).std(axis=0) == pytest.approx(0.05 * spread * np.ones(2), rel=0.05)
    assert np.isfinite(states).all()


def test_best_supports_match_an_exhaustive_search():
    rng = np.random.default_rng(3)
    columns = rng.standard_normal((80, 6)) @ (np.eye(6) + 0.3 * rng.standard_normal((6, 6)))
    target = columns[:, [1, 4]] @ [1.0, -2.0] + 0.3 * rng.standard_normal(80)
    normal = Normal.of(columns[:40], target[:40]) + Normal.of(columns[40:], target[40:])
    for size, found in enumerate(best_supports(normal, 4, width=20), 1):

        def misfit(support):
            x = np.linalg.lstsq(columns[:, support], target, rcond=None)[0]
            return np.sum((columns[:, support] @ x - target) ** 2) / np.sum(target**2)

        best = min(itertools.combinations(range(6), size), key=lambda s: misfit(list(s)))
        assert found == best
        assert normal.misfit(normal.solve(found)) == pytest.approx(misfit(list(best)))


@pytest.mark.parametrize(
    "name", [pytest.param("double_pendulum", marks=pytest.mark.thorough), "cart_spring_pendulum"]
)
def test_energy_finds_exact_motions_exactly(name):
    problem = posed("energy", name)
    answer = load("energy").solve(problem)
    assert set(answer.coefficients) | set(problem.known) == set(problem.true_coefficients)
    assert l2(problem, answer.coefficients) < 1e-3
    q, qdot, forces, qddot = true_states(problem)
    assert answer.acceleration(q, qdot, forces) == pytest.approx(qddot, abs=2e-2)


def test_energy_balances_the_true_energy_against_the_work():
    problem = posed("energy", "double_pendulum")
    module = load("energy")
    texts, pieces, scale = module._balances(problem)
    true = np.array([problem.true_coefficients.get(text, 0.0) for text in texts]) / scale
    for columns, target in pieces:
        assert columns @ true == pytest.approx(target, abs=1e-2)
    motion = problem.truth[0]
    energies = np.stack([f(*motion.q.T, *motion.qdot.T) for f in module._energies(problem.library)], axis=1)
    weights = [problem.true_coefficients.get(term.text, 0.0) for term in problem.library]
    assert energies @ weights == pytest.approx(problem.system.energy(motion.q, motion.qdot))


@pytest.mark.thorough
def test_energy_cannot_see_terms_linear_in_the_velocities():
    texts, _, _ = load("energy")._balances(posed("energy", "magnetic_pendulum"))
    assert "x*y_dot" not in texts
    assert "x_dot*y_dot" in texts


def test_rk4_sindy_finds_the_pendulum():
    problem = posed("rk4_sindy")
    answer = load("rk4_sindy").solve(problem)
    assert answer.coefficients is None
    assert answer.settings["terms"] == 2
    assert "sin(theta)" in answer.expression
    assert "f_theta" in answer.expression
    q, qdot, forces, qddot = true_states(problem)
    assert answer.acceleration(q, qdot, forces) == pytest.approx(qddot, abs=1e-3)
    unforced = systems.get("single_pendulum").acceleration([[0.4]], [[0.0]])
    assert answer.acceleration(np.array([[0.4]]), np.zeros((1, 1)), None) == pytest.approx(unforced, abs=1e-3)


def test_rk4_sindy_steps_as_the_classical_formula():
    """ẍ = −x: one step of the stages equals the Taylor polynomial of degree four."""
    module, h = load("rk4_sindy"), 0.3
    dictionary = Dictionary(["x"], [], False, 1, 1)
    xi = np.zeros((len(dictionary), 1))
    xi[dictionary.names.index("x")] = -1.0
    x, v = np.array([[0.7]]), np.array([[-0.2]])
    steps = module.Steps(x, v, x, v, (None, None, None), np.array([[h]]))
    found = module._mean_features(dictionary, steps, xi, np.arange(len(dictionary))) @ xi
    taylor = (v * (-(h**2) / 2 + h**4 / 24) - x * (h - h**3 / 6)) / h
    assert found == pytest.approx(taylor, rel=1e-12)


def test_dictionary_values_agree_with_their_names():
    coordinates = ["theta", "phi", "x"]
    dictionary = Dictionary(coordinates, ["theta", "phi"], True, 2, 2)
    assert len(set(dictionary.names)) == len(dictionary)
    assert {"1", "x*x", "f_phi", "x_dot*x_dot*sin(theta-phi)"} <= set(dictionary.names)
    q, qdot, forces = np.random.default_rng(0).standard_normal((3, 1, 3))
    values = dictionary(q, qdot, forces)[0]
    names = [*coordinates, *(f"{c}_dot" for c in coordinates), *(f"f_{c}" for c in coordinates)]
    state = dict(zip(names, np.concatenate([q, qdot, forces], axis=1)[0], strict=True))
    for name, value in zip(dictionary.names, values, strict=True):
        expected = eval(name, {"sin": np.sin, "cos": np.cos}, state)
        assert value == pytest.approx(expected), name


def test_variants_of_the_paper_s_method(monkeypatch):
    def asked(variant):  # candidates and options
        posed = pose(Case("single_pendulum", 0.1, "adam", variant=variant, trajectories=1))
        calls = []
        monkeypatch.setattr(adam.la, "discover", lambda *a, **more: calls.append((*a, more["options"])))
        adam.discover(posed, adam.settings_for(posed), None)
        (data, library, options) = calls[0]
        assert data is posed.data
        return [term.text for term in library], options

    texts, plain = asked("")
    assert len(texts) > 2
    assert asked("true-terms") == (["theta_dot**2", "cos(theta)"], plain)
    assert asked("from-truth")[1].start_coefficients == {"theta_dot**2": 0.5, "cos(theta)": 9.81}
    assert asked("no-regularisation") == (texts, replace(plain, curvature_weight=0.0))
    assert asked("short")[1].iterations == plain.iterations // 10
    with pytest.raises(ValueError, match="variant 'other' is unknown; use no-regularisation, from-truth"):
        asked("other")


# --------------------------- uDSR behind its adapter: a stand-in for its package, and the package where it is

# A stand-in for the package: each step uses the processor for a while and adds programs, the true law among
# them only if variation changes the tokens of an individual.
FAKE = {
    "__init__.py": """
        import time
        import numpy as np
        from dso.gp.utils import Individual
        from dso.program import Program, Token

        class Trainer:
            done, nevals, p_r_best = False, 0, None

        class DeepSymbolicOptimizer:
            def __init__(self, config):
                self.config = config

            def setup(self):
                X, y = self.config["task"]["dataset"]
                assert X.ndim == 2 and y.shape == (len(X),)
                assert self.config["training"]["epsilon"] == 0.05 and self.config["gp_meld"]["run_gp_meld"]
                assert "sin" in self.config["task"]["function_set"]
                self.trainer = Trainer()

            def train_one_step(self):
                end = time.process_time() + 0.3
                while time.process_time() < end:
                    pass
                if self.config["experiment"]["seed"] == 1002:
                    raise ValueError("no luck")
                f, theta = Token("x3", 2), Token("x1", 0)
                law = [Token("sub"), f, Token("mul"), Token("const", value=[9.81]), Token("sin"), theta]
                cubic = Token("poly", exponents=[(0, 0, 0), (1, 0, 2)], coef=np.array([1.0, 2.0]))
                poor = [Token("mul"), cubic, f]
                programs = [Program([f], 1, 0.3), Program(poor, 3, 0.2), Program(poor, 9, 0.99, invalid=True)]
                programs += [Program(poor, 4, 0.4), Program(law, 5, None)]
                if Individual().tokenized_repr == "varied":
                    programs.append(Program(law, 6, 0.9))
                Program.cache.update(enumerate(programs))
                rated = [p for p in programs if "r" in p.__dict__ and not p.invalid]
                self.trainer.p_r_best = max(rated, key=lambda p: p.r)
                self.trainer.nevals += len(programs)
        """,
    "config.py": """
        from collections import Mapping  # as the released code does

        def load_config(config):
            assert isinstance(config, Mapping)
            parts = ("task", "training", "gp_meld", "experiment")
            return {part: {"epsilon": 0.05, **config.get(part, {})} for part in parts}
        """,
    "program.py": """
        class Token:
            def __init__(self, name, input_var=None, **more):
                self.name, self.input_var = name, input_var
                self.__dict__.update(more)

        class Program:
            cache = {}

            def __init__(self, traversal, complexity, r, invalid=False):
                self.traversal, self.complexity, self.invalid = traversal, complexity, invalid
                if r is not None:
                    self.r = r
        """,
    "gp/__init__.py": "",
    "gp/utils.py": """
        class Individual:
            tokenized_repr = "as it was made"

        def DEAP_to_tokens(individual):
            return "varied"
        """,
}


@pytest.fixture
def udsr(tmp_path, monkeypatch):
    """The adapter, with a Python that has the stand-in."""
    for name, text in FAKE.items():
        path = tmp_path / "dso" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(textwrap.dedent(text))
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nPYTHONPATH="{tmp_path}" exec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    return loaded(monkeypatch, str(python))


def loaded(monkeypatch, python: str | None):
    monkeypatch.delitem(sys.modules, "reproduction.methods.udsr", raising=False)
    if python is None:
        monkeypatch.delenv("UDSR_PYTHON", raising=False)
    else:
        monkeypatch.setenv("UDSR_PYTHON", python)
    return load("udsr")


def pendulum(variant: str = "", **more):
    return pose(Case("single_pendulum", 0.0, "udsr", variant=variant, **{"trajectories": 2, **more}))


def test_the_repaired_variant_finds_what_variation_finds(udsr):
    answers = {variant: udsr.solve(pendulum(variant), seconds=0.1) for variant in ("", "repaired")}
    assert answers["repaired"].expression == "theta_ddot = (f_theta - (9.81 * sin(theta)))"
    assert answers["repaired"].settings["held_out_error"] == pytest.approx([0.0], abs=1e-12)
    assert answers[""].settings["held_out_error"][0] > 0.5
    motion = pendulum().truth[0]
    found = answers["repaired"].acceleration(motion.q, motion.qdot, motion.forces)
    assert found == pytest.approx(motion.qddot, abs=1e-12)
    lost = answers["repaired"].acceleration(np.array([[np.nan]]), np.zeros((1, 1)), np.zeros((1, 1)))
    assert np.isnan(lost).all()
    assert answers[""].coefficients is None


def test_training_goes_on_for_the_seconds_given(udsr):
    (inputs, targets), _ = _symbolic.samples(pendulum(), given=True)
    done = [udsr._regress(inputs, targets[:, 0], udsr._settings(pendulum(), s)) for s in (0.1, 0.5)]
    assert [d["steps"] for d in done] == [1, 2]  # of 0.3 s each
    assert [member["reward"] for member in done[0]["front"]] == [0.3, 0.4]
    assert done[0]["front"][0]["tokens"] == [{"input": 2}]
    assert done[0]["best"] == done[0]["front"][-1]
    assert done[0]["versions"]["python"] == sys.version.split()[0]


def test_time_and_memory_of_the_child_are_counted(udsr, monkeypatch):
    monkeypatch.setattr(udsr, "solve", lambda problem, solve=udsr.solve: solve(problem, 0.1))
    result = execute(Case("single_pendulum", 0.0, "udsr", trajectories=1), udsr)["result"]
    assert result["finished"]
    assert result["cpu_s"] > 0.3
    assert result["peak_mb"] > result["start_mb"] + 10
    assert result["equation_error"] > 0.1
    assert result["l2"] is None


def test_a_failure_has_the_last_words_of_the_child(udsr):
    with pytest.raises(RuntimeError, match="uDSR: the process ended with exit code 1: ValueError: no luck"):
        udsr.solve(pendulum(trial=2), seconds=0.1)
    with pytest.raises(ValueError, match="variant 'other' is unknown; use repaired, poly, repaired-poly"):
        udsr.solve(pendulum("other"))


@pytest.mark.thorough
def test_functions_follow_the_variant_and_the_library(udsr):
    assert udsr._settings(pendulum(), 1.0)["config"]["task"]["function_set"] == list(udsr.FUNCTIONS)
    magnets = pose(Case("magnetic_pendulum", 0.0, "udsr", variant="repaired-poly", trajectories=1))
    settings = udsr._settings(magnets, 1.0)
    assert settings["config"]["task"]["function_set"] == [*udsr.FUNCTIONS, "sqrt", "poly"]
    assert settings["repair"]
    assert settings["config"]["experiment"]["seed"] == 1000


def test_expressions_are_evaluated_and_written(udsr):
    x, y = np.random.default_rng(0).uniform(1, 2, (2, 5))
    inputs, labels = np.stack([x, y], axis=1), ["x", "y"]
    polynomial = {"exponents": [[0, 0], [2, 1]], "coefficients": [0.5, -3.0]}
    tokens = ["add", "div", "sqrt", {"input": 0}, "cos", {"input": 1}, "sin", polynomial]
    expected = np.sqrt(x) / np.cos(y) + np.sin(0.5 - 3 * x**2 * y)
    assert udsr.evaluate(tokens, inputs) == pytest.approx(expected)
    assert udsr.infix(tokens, labels) == "((sqrt(x) / cos(y)) + sin((0.5 + -3*x**2*y)))"
    assert udsr.evaluate([2.5], inputs).tolist() == [2.5] * 5
    assert not np.isfinite(udsr.evaluate(["div", 1.0, "sub", {"input": 0}, {"input": 0}], inputs)).any()


def test_a_worker_ends_with_the_process_that_started_it(udsr, tmp_path):
    waits = "import time\n\ndef load_config(config):\n    (open('began', 'w')).close()\n    time.sleep(600)\n"
    (tmp_path / "dso" / "config.py").write_text(waits)
    np.savez(tmp_path / "task.npz", X=np.zeros((3, 1)), y=np.zeros(3))
    (tmp_path / "settings.json").write_text('{"repair": false}')
    command = [udsr.PYTHON, str(udsr.WORKER), str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, cwd=tmp_path) as process:
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait(60) == 1


def test_it_is_left_out_where_it_is_not_installed(monkeypatch):
    for python, reason in ((None, "names no Python with uDSR"), ("/nowhere/python", "names no Python")):
        with pytest.raises(ImportError, match=reason):
            loaded(monkeypatch, python)
    bare = Path(sys.executable)
    with pytest.raises(
        ImportError, match=f"the Python that UDSR_PYTHON names, {bare.name}, has no package dso"
    ):
        loaded(monkeypatch, str(bare))
    said = CliRunner().invoke(run, ["--method", "udsr", "--trials", "1", "--noise", "0", "--dry-run"]).output
    assert "udsr is left out: the Python that UDSR_PYTHON names" in said
    assert "0 cases" in said


@pytest.mark.skipif(not os.environ.get("UDSR_PYTHON"), reason="UDSR_PYTHON names no Python with uDSR")
def test_the_package_itself_finds_the_pendulum(monkeypatch):
    real = loaded(monkeypatch, os.environ["UDSR_PYTHON"])
    answer = real.solve(pendulum("repaired", trajectories=5), seconds=30.0)
    assert answer.settings["held_out_error"][0] < 1e-3
    assert (
        "torch" in answer.settings["runs"][0]["versions"]
        or "tensorflow" in answer.settings["runs"][0]["versions"]
    )


# ------------------------------------------------------------------------------------------ what is given


def test_given_rates_are_exact_without_noise():
    problem = pose(Case("double_pendulum", 0.0, "udsr", trajectories=2))
    (inputs, targets), (unseen, wanted) = _symbolic.samples(problem, given=True)
    first, last = problem.truth
    assert inputs == pytest.approx(np.hstack([first.q, first.qdot, first.forces])[:: _symbolic.STRIDE])
    assert targets == pytest.approx(first.qddot[:: _symbolic.STRIDE])
    assert unseen == pytest.approx(np.hstack([last.q, last.qdot, last.forces]))
    assert wanted == pytest.approx(last.qddot)
    assert _symbolic.names(problem)[-1] == "f_theta2"
    assert len(_symbolic.names(problem)) == inputs.shape[1] == 6


def test_a_single_trajectory_is_judged_by_its_last_fifth():
    problem = pose(Case("single_pendulum", 0.1, "udsr", trajectories=1))
    for given in (False, True):
        (inputs, targets), (unseen, wanted) = _symbolic.samples(problem, given)
        assert len(unseen) == len(wanted) == pytest.approx(0.2 * len(problem.truth[0].t), abs=1)
        assert len(inputs) == len(targets) == -(-(len(problem.truth[0].t) - len(unseen)) // _symbolic.STRIDE)


def test_the_shortest_of_the_best_is_chosen():
    target = np.array([0.0, 1.0, 2.0])
    predictions = [target + 0.5, target + 0.1, target + 0.1005, np.full(3, np.nan)]
    assert _symbolic.choose(predictions, [1, 5, 3, 2], target)[0] == 2
    assert _symbolic.choose(predictions, [1, 5, 7, 2], target) == (1, pytest.approx(0.1 / target.std()))


def test_ours_from_names_alone():
    problem = pose(Case("single_pendulum", 0.01, "ours", variant="names", trajectories=1))
    answer = load("ours").solve(problem)
    assert set(answer.coefficients) == set(problem.true_coefficients)
    with pytest.raises(ValueError, match="variant 'other' is unknown; use names"):
        load("ours").solve(pose(Case("single_pendulum", 0.01, "ours", variant="other", trajectories=1)))
