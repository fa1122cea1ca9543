"""Figures of the model: selection path, energy, forecasts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator

from leastaction._diagnostics import PathPoint
from leastaction._forecast import ForecastTrace
from leastaction._report._series import Energy, legible_samples, thin_line
from leastaction._report._svg import COLOURS, dots, inline, label, panel

__all__ = ["energy_of_trial", "energy_of_trials", "folded", "forecast_panel", "path_figure", "unfolded"]

_LINEAR = 10.0  # the axis of the path is linear within this and logarithmic beyond
_MOST_TRIALS = 60


def path_figure(path: Sequence[PathPoint]) -> Markup:
    """ΔBIC and −2 Δ log likelihood against the number of terms."""
    axes = panel(500, 300)
    chosen = next(p for p in path if p.chosen)
    best: dict[int, PathPoint] = {}
    for point in path:
        best.setdefault(point.n_terms, point)
    best[chosen.n_terms] = chosen
    sizes = np.array(sorted(best))
    cost, bic = (folded(np.array([getattr(best[n], key) for n in sizes])) for key in ("cost", "bic"))
    rest = [p for p in path if p is not best[p.n_terms]]
    axes.plot(sizes, cost, color=COLOURS["measured"], lw=1.2, dashes=(4, 3))
    dots(axes, sizes, cost, "measured", 6.0)
    axes.plot(sizes, bic, color=COLOURS["fit"], lw=1.5)
    dots(axes, sizes, bic, "fit", 7.0)
    dots(axes, np.array([p.n_terms for p in rest]), folded(np.array([p.bic for p in rest])), "fit", 4.0, 0.55)
    dots(axes, np.array([chosen.n_terms]), np.zeros(1), "forecast", 12.0, above=True)
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    axes.set_xlim(sizes[0] - 0.5, sizes[-1] + 0.5)
    low, high = float(min(cost.min(), bic.min())), float(max(cost.max(), bic.max()))
    ticks = range(int(np.floor(low)), int(np.ceil(high)) + 1)
    every = max(1, len(ticks) // 7)
    axes.yaxis.set_major_locator(FixedLocator([k for k in ticks if k % every == 0]))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: unfolded(round(v))))
    axes.set_ylim(low - 0.3, high + 0.3)
    label(axes, "number of free terms", "difference from the chosen structure")
    return inline(
        axes, "path", "BIC and likelihood of the best structure of each size; the chosen one is marked"
    )


def folded(value: np.ndarray) -> np.ndarray:
    """±1 for ±10, ±2 for ±100, …; linear in between."""
    size = np.abs(value)
    return np.sign(value) * np.where(
        size <= _LINEAR, size / _LINEAR, 1.0 + np.log10(np.maximum(size, _LINEAR) / _LINEAR)
    )


def unfolded(level: int) -> str:
    if abs(level) <= 3:
        return f"{'−' if level < 0 else ''}{10 ** abs(level) if level else 0}"
    return (
        f"{'−' if level < 0 else ''}10{str(abs(level)).translate(str.maketrans('0123456789', '⁰¹²³⁴⁵⁶⁷⁸⁹'))}"
    )


def energy_of_trial(energy: Energy, balance: bool) -> Markup:
    """Kinetic and potential energy and their sum, counted from the lowest potential energy."""
    axes = panel(510, 270)
    floor = float(energy.potential.min())
    for values, colour, width in (
        (energy.kinetic, "kinetic", 1.1),
        (energy.potential - floor, "potential", 1.1),
        (energy.total - floor, "fit", 2.2),
    ):
        axes.plot(*thin_line(energy.t, values), color=COLOURS[colour], lw=width)
    if balance:
        axes.plot(*thin_line(energy.t, energy.expected - floor), color=COLOURS["ink"], lw=1.4, dashes=(2, 4))
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    label(axes, "t (s)", "energy (units of L)")
    alt = "Kinetic, potential and total energy along the fitted curve of one trial"
    return inline(axes, "energy", alt)


def energy_of_trials(energies: Sequence[Energy], shown: int) -> Markup:
    """Total energy of every trial; the one of the other panel in full colour."""
    axes = panel(510, 270)
    floor = min(float(e.potential.min()) for e in energies)
    for k, energy in enumerate(energies[:_MOST_TRIALS]):
        t, total = thin_line(energy.t - energy.t[0], energy.total - floor, 400)
        axes.plot(
            t, total, color=COLOURS["fit"], lw=2.2 if k == shown else 1.1, alpha=1.0 if k == shown else 0.5
        )
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    label(axes, "time from the start of the trial (s)", "total energy (units of L)")
    return inline(axes, "energies", "Total energy along the fitted curves of all trials")


def forecast_panel(trace: ForecastTrace, i: int, noise_std: float, name: str, unit: str, key: str) -> Markup:
    """Measured samples and the free run of one coordinate."""
    axes = panel()
    t_seen, some, quiet = legible_samples(trace.t, trace.measured[:, i], noise_std)
    dots(axes, t_seen, some, "measured", 4.5 if quiet else 3.2, above=quiet)
    run = trace.forecast[:, i]
    there = np.isfinite(run)
    seen = trace.measured[np.isfinite(trace.measured[:, i]), i]
    if seen.size:
        # A run that leaves the data must not flatten them.
        low, high = seen.min(), seen.max()
        reach = 1.0 * max(high - low, 1e-12)
        there &= (run > low - 20 * reach) & (run < high + 20 * reach)
        ends = np.concatenate([seen, np.clip(run[there], low - reach, high + reach)])
        pad = 0.06 * max(float(np.ptp(ends)), 1e-12)
        axes.set_ylim(ends.min() - pad, ends.max() + pad)
    axes.plot(*thin_line(trace.t[there], run[there]), color=COLOURS["forecast"])
    axes.set_xlim(trace.t[0], trace.t[-1])
    label(axes, "t (s)", name, y_unit=unit)
    return inline(axes, key, f"{name}: measured samples as dots, the forecast as a line")
