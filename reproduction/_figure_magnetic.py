"""Figure 2: motions of the magnetic pendulum forecast by discovered models, against the true motion."""

from __future__ import annotations

from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

import leastaction as la
from leastaction import systems
from reproduction._figure_basins import MAGNETS
from reproduction._plots import COLOURS, STYLE, TITLES, Sheet, letter, solved
from reproduction.problem import RATE, Acceleration, Case
from reproduction.scoring import TEST_SEED, TOLERANCE

__all__ = ["Forecast", "caption", "compute", "draw", "follow", "numbers"]

SYSTEM, NOISE = "magnetic_pendulum", 0.1
SHORT, LONG = 5.0, 30.0  # seconds


@dataclass(frozen=True, eq=False)
class Forecast:
    """One true motion and its forecasts by name of the methods, all (n_times, 2); NaN where one broke off.

    ``horizons`` are the seconds for which each stays within `tolerance` (2,) of the truth.
    """

    t: np.ndarray
    truth: np.ndarray
    forecasts: dict[str, np.ndarray]
    tolerance: np.ndarray
    horizons: dict[str, float]
    statuses: dict[str, str]
    noise: float = NOISE


def compute(duration: float, trial: int = 0) -> Forecast:
    """Discover the Lagrangian by each method, and follow it from the exact start of a motion not seen."""
    system = systems.get(SYSTEM)
    start = systems.simulate_truth(system, 1, duration, RATE, TEST_SEED + trial)[0]
    t = start.t
    truth = follow(system.acceleration, start.q[0], start.qdot[0], t)
    tolerance = TOLERANCE * truth.std(axis=0)
    answers = {name: solved(Case(SYSTEM, NOISE, name, trial))[1] for name in TITLES}
    forecasts = {name: follow(a.acceleration, start.q[0], start.qdot[0], t) for name, a in answers.items()}
    horizons = {
        name: la.metrics.forecast_horizon(t, path, truth, tolerance) for name, path in forecasts.items()
    }
    statuses = {name: a.status for name, a in answers.items()}
    return Forecast(t, truth, forecasts, tolerance, horizons, statuses)


def follow(acceleration: Acceleration | None, q0: np.ndarray, qdot0: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Integrate one free motion by DOP853; NaN from where that fails, or where there is no model."""
    path = np.full((t.size, q0.size), np.nan)
    path[0] = q0
    if acceleration is None:
        return path

    n = q0.size

    def rates(_, state):
        return np.append(state[n:], acceleration(state[None, :n], state[None, n:], None)[0])

    def lost(_, state):
        return 100.0 - np.abs(state).max()

    lost.terminal = True
    if not np.isfinite(rates(t[0], np.append(q0, qdot0))).all():
        return path
    run = solve_ivp(rates, t[[0, -1]], np.append(q0, qdot0), "DOP853", t, rtol=1e-11, atol=1e-12, events=lost)
    path[: run.t.size] = run.y[:n].T
    return path


def numbers(forecast: Forecast) -> dict:
    """Return horizons and errors for the record."""
    short = forecast.t <= SHORT
    return {
        "noise": forecast.noise,
        "duration_s": float(forecast.t[-1]),
        "tolerance_m": forecast.tolerance.tolist(),
        "models": {
            name: {
                "horizon_s": forecast.horizons[name],
                f"largest_error_first_{SHORT:g}_s_m": float(np.max(_distance(forecast, name)[short])),
                "status": forecast.statuses[name],
            }
            for name in forecast.forecasts
        },
    }


def _distance(forecast: Forecast, name: str) -> np.ndarray:
    return np.hypot(*(forecast.forecasts[name] - forecast.truth).T)


def caption(forecast: Forecast) -> str:
    held = ", ".join(_held(forecast, name) for name in forecast.forecasts)
    return (
        f"Magnetic pendulum: a motion that was in nobody's data, and what the models found from five "
        f"trajectories at {100 * forecast.noise:g} % noise forecast from its exact start "
        "(the paper's method with its best searched settings). "
        f"(a–d) Path in the plane over the first {SHORT:g} s and over {forecast.t[-1]:g} s; dot: start, "
        "crosses: magnets; a forecast is drawn pale after its horizon. (e, f) The coordinates against time. "
        "(g) Distance between forecast and truth. The motion is chaotic: any error of a model grows about "
        f"exponentially. A forecast holds while each coordinate is within {TOLERANCE:g} of its standard "
        f"deviation of the truth ({held}); the dashed lines mark where that ends."
    )


def _held(forecast: Forecast, name: str) -> str:
    horizon = forecast.horizons[name]
    return f"{TITLES[name]} holds for {'all ' if horizon >= forecast.t[-1] else ''}{horizon:.1f} s"


def draw(forecast: Forecast) -> Figure:
    """Draw the paths at the left, a column for each model, and the coordinates and errors at the right."""
    with matplotlib.rc_context(STYLE):
        columns, side, gap, low = len(forecast.forecasts), 1.55, 0.1, 0.42
        right = 0.5 + columns * (side + gap) + 0.5
        sheet = Sheet(right + 2.65, 2 * side + 1.35)
        letters = iter("abcdefghijkl")
        for row, until in enumerate((SHORT, forecast.t[-1])):
            for column, name in enumerate(forecast.forecasts):
                ax = sheet.axes(0.5 + column * (side + gap), low + (1 - row) * (side + 0.3), side, side)
                _plane(ax, forecast, name, until)
                letter(ax, next(letters))
                above = f"{TITLES[name]}\n" if row == 0 else ""
                ax.set_title(f"{above}first {until:g} s")
                ax.set_xlabel("x (m)" if row == 1 else "")
                ax.set_ylabel("y (m)" if column == 0 else "")
                ax.tick_params(labelbottom=row == 1, labelleft=column == 0)
        height = (2 * side + 0.3 - 2 * 0.24) / 3
        series = [sheet.axes(right, low + (2 - k) * (height + 0.24), 2.55, height) for k in range(3)]
        _series(series, forecast)
        for ax in series:
            letter(ax, next(letters))
        handles, labels = series[0].get_legend_handles_labels()
        sheet.figure.legend(handles, labels, loc="upper center", ncols=len(labels))
    return sheet.figure


def _plane(ax, forecast: Forecast, name: str, until: float) -> None:
    seen = forecast.t <= until + 1e-9
    width = 1.0 if until <= SHORT else 0.7
    ax.plot(*forecast.truth[seen].T, color=COLOURS["truth"], lw=2.2 * width, alpha=0.3)
    for part, alpha in _parts(forecast, name):
        ax.plot(*forecast.forecasts[name][seen & part].T, color=COLOURS[name], lw=0.9 * width, alpha=alpha)
    ax.plot(*MAGNETS.T, "x", color=COLOURS["truth"], ms=4, mew=1.0)
    ax.plot(*forecast.truth[0], "o", color=COLOURS["truth"], ms=3)
    ax.set_aspect("equal")
    reach = _reach(forecast)
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach), xticks=(-1, 0, 1), yticks=(-1, 0, 1))


def _parts(forecast: Forecast, name: str) -> list[tuple[np.ndarray, float]]:
    """Return when the forecast holds and when not, each with its opacity."""
    horizon = forecast.horizons[name]
    return [(forecast.t >= horizon - 1e-9, 0.4), (forecast.t <= horizon + 1e-9, 1.0)]


def _reach(forecast: Forecast) -> float:
    """Return a range that holds all paths, unless one has gone far astray."""
    largest = max(float(np.nanmax(np.abs(path))) for path in (forecast.truth, *forecast.forecasts.values()))
    return 1.06 * min(largest, 1.5 * float(np.abs(forecast.truth).max()))


def _series(axes, forecast: Forecast) -> None:
    t, reach = forecast.t, _reach(forecast)
    for i, ax in enumerate(axes[:2]):
        ax.plot(t, forecast.truth[:, i], color=COLOURS["truth"], lw=2.0, alpha=0.3, label="truth")
        ax.set(ylim=(-reach, reach), yticks=(-1, 0, 1), ylabel=f"{'xy'[i]} (m)")
    for name, path in forecast.forecasts.items():
        for part, alpha in _parts(forecast, name):
            style = {"color": COLOURS[name], "lw": 0.8, "alpha": alpha}
            for i in range(2):
                axes[i].plot(
                    t[part], path[part, i], label=_held(forecast, name) if alpha == 1 else None, **style
                )
            later = part & (t > 0)
            axes[2].plot(t[later], _distance(forecast, name)[later], **style)
        for ax in axes if forecast.horizons[name] < t[-1] else ():
            ax.axvline(forecast.horizons[name], color=COLOURS[name], lw=0.8, ls=(0, (2, 2)))
    axes[2].set(yscale="log", ylim=(1e-4, 10), yticks=(1e-4, 1e-2, 1), ylabel="distance (m)")
    axes[2].set_xlabel("time (s)")
    for ax in axes:
        ax.set_xlim(0, t[-1])
        ax.tick_params(labelbottom=ax is axes[2])
