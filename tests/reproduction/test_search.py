"""The search for the settings of the paper's method."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from reproduction import search_adam


def test_more_tries_keep_those_before():
    few, many = search_adam.draws(9), search_adam.draws(14)
    assert many[:9] == few
    assert len({repr(draw) for draw in many}) == 14


def record(options, l2, trial=500, system="single_pendulum"):
    return {
        "config": {"system": system, "noise": 0.1, "trial": trial},
        "options": options,
        "result": {"l2": l2},
    }


def test_best_is_the_smallest_geometric_mean_over_data_sets():
    steady, lucky = {"threshold": 0.1}, {"threshold": 0.2}
    found = search_adam.best(
        [record(steady, 0.02), record(lucky, 0.001), record(steady, 0.02, 501), record(lucky, 1.0, 501)]
    )
    entry = found["single_pendulum"]["0.1"]
    assert entry["options"] == steady
    assert entry["l2"] == pytest.approx(0.02)
    assert (entry["tries"], entry["data_sets"]) == (2, 2)


def test_search_resumes_and_keeps_the_settings_of_other_cells(tmp_path, monkeypatch):
    settings, runs = tmp_path / "settings.json", []
    settings.write_text(
        json.dumps({"double_pendulum": {"0": {"l2": 1.0}}, "single_pendulum": {"0": {"l2": 2.0}}})
    )

    def attempt(case, options):
        runs.append(options)
        error = abs(options.threshold - 0.15) + (0.1 if options.knots_per_second else 0.2)
        return {"l2": error, "exact": False, "status": "ok", "wall_s": 0.0}

    monkeypatch.setattr(search_adam, "SETTINGS", settings)
    monkeypatch.setattr(search_adam, "attempt", attempt)
    monkeypatch.setattr(search_adam, "_default_knots", lambda system, noise: 10.0)
    for tries in (4, 6):
        arguments = [
            "--tries",
            str(tries),
            "--data-sets",
            "2",
            "--system",
            "single_pendulum",
            "--noise",
            "0.1",
        ]
        done = CliRunner().invoke(search_adam.main, [*arguments, "--folder", str(tmp_path / "tries")])
        assert done.exit_code == 0, done.output
    assert len(runs) == 12
    found = json.loads(settings.read_text())
    assert found["double_pendulum"] == {"0": {"l2": 1.0}}
    assert set(found["single_pendulum"]) == {"0", "0.1"}
    chosen = found["single_pendulum"]["0.1"]["options"]
    assert (chosen["threshold"], chosen["knots_per_second"]) == (0.15, 20.0)
