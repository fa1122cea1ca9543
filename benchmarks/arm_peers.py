"""Other ways to identify an arm from a torque log, as models that compare with ours.

Textbook least squares: Butterworth filter, differences, viscous and dry friction, offsets, rotors.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfiltfilt

import leastaction as la
from leastaction import arms

CUTS = (5.0, 10.0, 20.0)  # Hz


def filtered_states(run: la.Trajectory, cut: float) -> tuple[list[np.ndarray], np.ndarray]:
    """q, q̇, q̈ and torques behind a filter of ``cut`` Hz, (n_times, n_dof) each, every 5 ms."""
    step = float(np.median(np.diff(run.t)))
    times = np.arange(run.t[0], run.t[-1], step)
    low = butter(4, 2.0 * cut * step, output="sos")

    def filtered(values: np.ndarray) -> np.ndarray:
        even = np.stack([np.interp(times, run.t, column) for column in values.T], axis=1)
        return sosfiltfilt(low, even, axis=0)

    q, torques = filtered(run.q), filtered(run.forces)
    qdot = np.gradient(q, step, axis=0)
    inside = slice(round(0.3 / step), -round(0.3 / step), max(1, round(0.005 / step)))
    return [a[inside] for a in (q, qdot, np.gradient(qdot, step, axis=0))], torques[inside]


def like(tree: arms.KinematicTree) -> arms.ArmModel:
    """A model with the parameters of the textbook, whatever their values."""
    n = len(tree)
    unit = dict.fromkeys(("rotor", "offset", "viscous", "dry"), np.ones(n))
    return arms.ArmModel.of_tree(tree.with_inertias(np.ones((n, 10))), unit, width=1e-2)


def textbook(
    run: la.Trajectory, tree: arms.KinematicTree, cut: float, *, weighted: bool = True
) -> arms.ArmModel:
    """Least squares on filtered differences; ``weighted`` by the errors of each joint."""
    states, torques = filtered_states(run, cut)
    n, model = len(tree), like(tree)
    columns = model.columns(*states)
    design, target = columns.reshape(len(columns), -1).T, torques.T.ravel()
    weights, values = np.ones(n), np.zeros(len(columns))
    for _ in range(4 if weighted else 1):
        rows = np.repeat(weights, len(states[0]))
        scale = np.linalg.norm(rows[:, None] * design, axis=0)
        values = np.linalg.lstsq(rows[:, None] * design / scale, rows * target, rcond=1e-9)[0] / scale
        weights = 1.0 / (target - design @ values).reshape(n, -1).std(axis=1)
    return arms.ArmModel(tree, model.base, values, np.eye(values.size), model.reference, model.facts)


def least_squares(run: la.Trajectory, tree: arms.KinematicTree) -> dict[str, arms.ArmModel]:
    """Weighted least squares behind each filter."""
    return {f"least squares, {cut:g} Hz": textbook(run, tree, cut) for cut in CUTS}
