"""The measured data in the package are whole and are what their README says."""

from __future__ import annotations

from importlib.resources import as_file, files

import numpy as np
import pandas as pd
import pytest

DATA = files("leastaction") / "datasets"


@pytest.mark.parametrize(
    ("name", "coordinates", "n_trials", "n_times"),
    [
        ("double_pendulum", ["theta1", "theta2"], 26, 1334),
        ("single_pendulum", ["theta"], 4, 4584),
    ],
)
def test_measured_pendulum(name, coordinates, n_trials, n_times):
    with as_file(DATA / f"{name}.csv.gz") as path:
        frame = pd.read_csv(path)
    assert list(frame.columns) == ["trial", "t", *coordinates]
    assert frame["trial"].unique().tolist() == [f"id-{k}" for k in range(n_trials)]
    for _, trial in frame.groupby("trial"):
        assert len(trial) == n_times
        np.testing.assert_allclose(np.diff(trial["t"]), 0.002, rtol=0, atol=1e-9)
        angles = trial[coordinates].to_numpy()
        # Zero is upright, so a swing stays around π; a jump between samples would be a wrapped angle.
        assert abs(angles.mean() - np.pi) < 0.1
        assert np.abs(np.diff(angles, axis=0)).max() < 0.1


def test_licence_is_beside_the_data():
    assert "dynamicslab" in (DATA / "LICENSE-MultiArm-Pendulum").read_text(encoding="utf-8")
