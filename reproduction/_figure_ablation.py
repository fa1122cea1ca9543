"""Figure 1: what the paper's J_reg, the penalty on q̈, does to the curve and its derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from scipy.interpolate import CubicSpline

import leastaction as la
from reproduction import methods
from reproduction._plots import COLOURS, STYLE, Sheet, letter
from reproduction.problem import Case, Problem, pose

__all__ = ["Ablation", "Fit", "caption", "compute", "draw", "numbers"]

SYSTEM, COORDINATE, TRAJECTORY = "chaotic_pendulum", 1, 0
# noise, and the variant that says where the curve begins
STARTS = ((0.0, ""), (0.1, ""), (0.1, "samples"))
WINDOW = (8.0, 10.0)  # seconds
# name in the code -> name in the legend
FITS = {
    "no-regularisation": r"paper's method without $J_\mathrm{reg}$",
    "adam": "paper's method",
    "ours": "leastaction",
}
_ROWS = (r"$\theta_2$ (rad)", r"$\dot\theta_2$ (rad/s)", r"$\ddot\theta_2$ (rad/s$^2$)")

Motion = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # t, q, q̇, q̈


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted curve of one trajectory, and its errors over all trajectories.

    ``errors`` holds, for q, q̇ and q̈ of the coordinate shown, the root mean square of the error over the
    standard deviation of the truth.
    """

    motion: Motion
    errors: tuple[float, float, float]
    status: str


@dataclass(frozen=True, eq=False)
class Ablation:
    """One noise level and start of the curve: the problem, and the fits by name (see `FITS`)."""

    noise: float
    start: str
    problem: Problem
    fits: dict[str, Fit]


def compute(starts: Sequence[tuple[float, str]], trial: int = 0) -> list[Ablation]:
    """Fit the same data by the paper's method with and without J_reg, and by ours."""
    return [_compare(noise, start, trial) for noise, start in starts]


def _compare(noise: float, start: str, trial: int) -> Ablation:
    fits = {}
    without = "-".join(filter(None, (start, "no-regularisation")))
    for name, variant in (("adam", start), ("no-regularisation", without)):
        problem = pose(Case(SYSTEM, noise, "adam", trial, variant=variant))
        answer, curves = methods.load("adam").solve_with_curve(problem)
        fits[name] = _fit(problem, curves, answer.status)
    problem = pose(Case(SYSTEM, noise, "ours", trial))
    model = la.discover(problem.data, problem.library, known=problem.known)
    times = [np.linspace(motion.t[0], motion.t[-1], 5 * motion.t.size - 4) for motion in problem.truth]
    derivatives = [model.diagnostics.curve(times, nu) for nu in range(3)]
    fits["ours"] = _fit(problem, list(zip(times, *derivatives, strict=True)), model.fit.status)
    return Ablation(noise, start, problem, fits)


def _fit(problem: Problem, curves: Sequence[Motion], status: str) -> Fit:
    misses, truths = [], []
    for motion, (t, *states) in zip(problem.truth, curves, strict=True):
        exact = CubicSpline(motion.t, _column(motion.q, motion.qdot, motion.qddot))(t)
        misses.append(_column(*states) - exact)
        truths.append(exact)
    errors = np.sqrt(np.mean(np.concatenate(misses) ** 2, axis=0)) / np.concatenate(truths).std(axis=0)
    return Fit(tuple(curves[TRAJECTORY]), tuple(map(float, errors)), status)


def _column(*states: np.ndarray) -> np.ndarray:
    """Return q, q̇ and q̈ of the coordinate shown, shape (n_times, 3)."""
    return np.stack([state[:, COORDINATE] for state in states], axis=1)


def numbers(ablations: Sequence[Ablation]) -> dict:
    """Return the relative errors for the record."""
    return {
        f"noise {a.noise:g}" + (f", from the {a.start}" if a.start else ""): {
            name: {**dict(zip(("q", "qdot", "qddot"), fit.errors, strict=True)), "status": fit.status}
            for name, fit in a.fits.items()
        }
        for a in ablations
    }


def caption(ablations: Sequence[Ablation]) -> str:
    levels = " and ".join(dict.fromkeys(f"{100 * a.noise:g} %" for a in ablations))
    rough = any(a.start for a in ablations)
    return (
        f"Chaotic pendulum, second angle: fitted curve and its first two derivatives against the truth, at "
        f"{levels} noise (in terms of the standard deviation of each angle; columns). Grey points: samples; "
        "thick grey line: truth. The same five trajectories of 20 s at 100 Hz went to all methods, and "
        "the paper's has its best searched settings; "
        + ("in the last column its curve begins at the samples, with β = 1e-5 or 0; " if rough else "")
        + f"{WINDOW[0]:g}–{WINDOW[1]:g} s of the first are shown. Above each panel, in the colours of the "
        "curves: root mean square of the error over all five, in per cent of the standard deviation of the "
        "truth. The scales are those of the truth: a curve that leaves a panel is cut off."
    )


def draw(ablations: Sequence[Ablation]) -> Figure:
    """Draw rows q, q̇, q̈ and one column for each noise level."""
    with matplotlib.rc_context(STYLE):
        wide, high, low, gap = max(2.8, 6.2 / len(ablations)), 1.25, 0.42, 0.28
        sheet = Sheet(0.45 + len(ablations) * (wide + gap), low + 3 * (high + 0.26) + 0.42)
        for column, ablation in enumerate(ablations):
            for row in range(3):
                ax = sheet.axes(0.55 + column * (wide + gap), low + (2 - row) * (high + 0.26), wide, high)
                _panel(ax, ablation, row)
                letter(ax, "abcdefghijkl"[row * len(ablations) + column])
                ax.tick_params(labelbottom=row == 2, labelleft=column == 0)
                if column == 0:
                    ax.set_ylabel(_ROWS[row])
                    ax.yaxis.set_label_coords(-0.42 / wide, 0.5)
                if row == 0:
                    begun = f", from the {ablation.start}" if ablation.start else ""
                    ax.set_title(f"{100 * ablation.noise:g} % noise{begun}", pad=14)
            ax.set_xlabel("time (s)")
        handles, labels = sheet.figure.axes[-3].get_legend_handles_labels()
        legend = sheet.figure.legend(handles, labels, loc="upper center", ncols=len(labels))
        legend.legend_handles[0].set_markersize(4)
    return sheet.figure


def _panel(ax, ablation: Ablation, row: int) -> None:
    truth = ablation.problem.truth[TRAJECTORY]
    seen = _inside(truth.t)
    exact = (truth.q, truth.qdot, truth.qddot)[row][seen, COORDINATE]
    if row == 0:
        data = ablation.problem.data[TRAJECTORY].q[seen, COORDINATE]
        ax.plot(truth.t[seen], data, ".", color=COLOURS["data"], ms=2.5, mew=0, label="measured")
    ax.plot(truth.t[seen], exact, color=COLOURS["truth"], lw=2.6, alpha=0.3, label="truth")
    # Ours is dashed and on top: where curves agree, the one below shows through.
    for name, legend in FITS.items():
        t, *states = ablation.fits[name].motion
        part = _inside(t)
        style = {"color": COLOURS[name], "lw": 0.9, "ls": (0, (4, 2)) if name == "ours" else "-"}
        ax.plot(t[part], states[row][part, COORDINATE], label=legend, **style)
    low, high = exact.min(), exact.max()
    ax.set_ylim(low - 0.35 * (high - low), high + 0.35 * (high - low))
    ax.set(xlim=WINDOW, xticks=np.arange(WINDOW[0], WINDOW[1] + 0.1, 0.5))
    _write_errors(ax, ablation, row)


def _write_errors(ax, ablation: Ablation, row: int) -> None:
    """Write the relative errors above the right corner of a panel, in the colours of the curves."""
    texts = [("rms error:", "black")]
    texts += [(_percent(ablation.fits[name].errors[row]), COLOURS[name]) for name in FITS]
    for k, (text, colour) in enumerate(reversed(texts)):
        place = {"xycoords": "axes fraction", "textcoords": "offset points", "ha": "right"}
        ax.annotate(text, (1, 1), (-42 * k, 3), color=colour, **place)


def _percent(share: float) -> str:
    if not np.isfinite(share):
        return "–"
    if share < 1e-4:
        return "< 0.01 %"
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"


def _inside(t: np.ndarray) -> np.ndarray:
    return (t >= WINDOW[0] - 1e-9) & (t <= WINDOW[1] + 1e-9)
