"""Scores against cases with a known answer, and tables against records made for the purpose."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import leastaction as la
from leastaction import systems
from reproduction import scoring
from reproduction._further_tables import is_right, speed, without_candidates
from reproduction._results import Group, Results, store_of
from reproduction._tables import ablation, experiments, group_tables, number
from reproduction.collate import HERE, findings, main, mixed_settings
from reproduction.problem import Answer, Case, pose
from reproduction.scoring import score

PAPER = json.loads((HERE / "paper.json").read_text())
GROUP = Group("relative", "compact", 5)


@cache
def problem(system="cart_spring_pendulum", noise=0.1, library="compact"):
    return pose(Case(system, noise, "ours", trajectories=1, library=library))


def found(coefficients, acceleration=None, **more):
    return score(problem(), Answer(coefficients, acceleration, **more))


class TestScore:
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

    @pytest.mark.parametrize("name", ["blow-up", "stiff", "nan", "raises"])
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
