"""Figure 3: basins of attraction of the damped magnetic pendulum, of the true L and of discovered ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import matplotlib
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from reproduction._plots import COLOURS, STYLE, Sheet, label, solved
from reproduction.basins import (
    MAGNETS,
    UNDECIDED,
    Basins,
    Field,
    agreement,
    damping,
    field_of,
    lagrangian_of,
    map_basins,
)
from reproduction.problem import Case, pose

__all__ = ["Study", "caption", "compute", "dpi", "draw", "numbers"]

SYSTEM = "magnetic_pendulum"
MODELS = (("ours", 0.01), ("ours", 0.1), ("adam", 0.1))  # method and noise level, a column each
DAMPING, OTHER_DAMPINGS = 0.15, (0.1, 0.2)  # N s/m
STEP = 0.01  # seconds
_PANEL = 1.6  # inches, the side of a map
_SHADES = 60
_SLOW = 99.0  # percentile of the times that is drawn darkest


@dataclass(frozen=True, eq=False)
class Study:
    """Maps of the truth and of each model, with the fractions of equal pixels.

    ``halved`` is the share of pixels of the true map that change when the step is halved; ``others`` holds,
    for other strengths of the damping, the fractions of the models in the same order.
    """

    truth: Basins
    models: list[tuple[str, float]]
    maps: list[Basins]
    equal: list[float]
    halved: float
    strength: float = DAMPING
    others: dict[float, list[float]] = field(default_factory=dict)


def compute(
    pixels: int,
    others: Sequence[float],
    models: Sequence[tuple[str, float]] = MODELS,
    progress: Callable[[str], None] | None = None,
) -> Study:
    """Discover the undamped L by each method, add the same known damping to all, and map the basins."""
    say = progress or (lambda text: None)
    exact = pose(Case(SYSTEM, 0.0, "ours"))
    found = [exact.system.lagrangian_expression]
    for name, noise in models:
        say(f"{label(name, noise)}: discovering")
        found.append(lagrangian_of(*solved(Case(SYSTEM, noise, name))))
    names = ["truth", *(label(*model) for model in models)]
    equal: dict[float, list[float]] = {}
    for strength in (DAMPING, *others):
        fields = [field_of(lagrangian, damping(exact, strength), exact) for lagrangian in found]
        maps = [
            map_basins(f, pixels, step=STEP, progress=_reporter(say, f"damping {strength:g}, {name}"))
            for f, name in zip(fields, names, strict=True)
        ]
        equal[strength] = [agreement(maps[0], other) for other in maps[1:]]
        for name, share in zip(names[1:], equal[strength], strict=True):
            say(f"damping {strength:g}, {name}: {100 * share:.2f} % of the pixels equal")
        if strength == DAMPING:
            shown, halved = maps, _change_at_half_step(fields[0], maps[0], say)
    return Study(
        shown[0], list(models), shown[1:], equal[DAMPING], halved, others={s: equal[s] for s in others}
    )


def _change_at_half_step(field: Field, basins: Basins, say: Callable[[str], None]) -> float:
    finer = map_basins(
        field, len(basins.magnet), basins.extent, basins.step / 2, _reporter(say, "truth, half the step")
    )
    share = 1.0 - agreement(basins, finer)
    say(f"truth, step {basins.step:g} s halved: {100 * share:.4f} % of the pixels change")
    return share


def _reporter(say: Callable[[str], None], name: str) -> Callable[[float], None]:
    """Return a function that reports a map's progress at every quarter."""
    reached = 0

    def report(share: float) -> None:
        nonlocal reached
        if int(4 * share) > reached:
            reached = int(4 * share)
            say(f"{name}: {100 * share:.0f} % of the starts settled")

    return report


def numbers(study: Study) -> dict:
    """Return fractions and settings for the record."""
    names = [label(*model) for model in study.models]
    return {
        "pixels": len(study.truth.magnet),
        "extent_m": study.truth.extent,
        "step_s": study.truth.step,
        "changed_at_half_step": study.halved,
        "undecided": [float(np.mean(b.magnet == UNDECIDED)) for b in (study.truth, *study.maps)],
        "damping": study.strength,
        "equal": dict(zip(names, study.equal, strict=True)),
        "equal_at_other_damping": {
            f"{strength:g}": dict(zip(names, shares, strict=True))
            for strength, shares in study.others.items()
        },
    }


def caption(study: Study) -> str:
    n, extent = len(study.truth.magnet), study.truth.extent
    shares = "; ".join(
        f"{label(*model)}: {100 * share:.1f} %"
        for model, share in zip(study.models, study.equal, strict=True)
    )
    others = " ".join(
        f"With damping {strength:g} they are {', '.join(f'{100 * share:.1f} %' for share in values)}."
        for strength, values in study.others.items()
    )
    return (
        f"Magnetic pendulum with a known friction ψ = ½ · {study.strength:g} · (ẋ² + ẏ²) added to the true L "
        "and to each L that was discovered from five trajectories without friction. "
        f"Each of the {n} × {n} pixels is a mass released at rest there, within ±{extent:g} m. "
        "Upper row: the colour tells at which magnet (crosses) it ends, the shade when its energy becomes "
        "too low to leave that magnet. Lower row, black: pixels that end at another magnet than with the "
        f"true L. Equal pixels: {shares}. {others} Halving the integration step of {study.truth.step:g} s "
        f"changes {100 * study.halved:.2f} % of the pixels of the true map."
    )


def dpi(pixels: int) -> float:
    """Return the resolution at which one start is one pixel of the image, or several in a coarse map."""
    return max(pixels, 400) / _PANEL


def draw(study: Study) -> Figure:
    """Draw the maps above, where they differ below, and the key at the lower left."""
    with matplotlib.rc_context(STYLE):
        left, low, gap, rise = 0.45, 0.42, 0.12, _PANEL + 0.32
        sheet = Sheet(left + (1 + len(study.maps)) * (_PANEL + gap), low + rise + _PANEL + 0.25)
        slowest = float(np.percentile(study.truth.time[np.isfinite(study.truth.time)], _SLOW))
        for column, basins in enumerate((study.truth, *study.maps)):
            ax = sheet.axes(left + column * (_PANEL + gap), low + rise, _PANEL, _PANEL)
            _image(ax, _colours(basins.magnet, basins.time / slowest), study.truth.extent)
            ax.plot(*MAGNETS.T, "x", color="white", ms=4.5, mew=1.8)
            ax.plot(*MAGNETS.T, "x", color="black", ms=4, mew=0.8)
            if column == 0:
                ax.set(title="true L", ylabel="y (m)", xlabel="x (m)")
                continue
            ax.set_title(label(*study.models[column - 1]))
            ax.tick_params(labelbottom=False, labelleft=False)
            below = sheet.axes(left + column * (_PANEL + gap), low, _PANEL, _PANEL)
            differs = (basins.magnet != study.truth.magnet) | (basins.magnet == UNDECIDED)
            grey = np.where(differs, 0.0, 0.94)
            _image(below, np.repeat(grey[..., None], 3, axis=2), study.truth.extent)
            below.set(title=f"{100 * study.equal[column - 1]:.1f} % of pixels equal", xlabel="x (m)")
            if column == 1:
                below.set_ylabel("y (m)")
            below.tick_params(labelleft=column == 1)
        _key(sheet.axes(left, low + 0.45, 1.15, 0.6), slowest)
    return sheet.figure


def _image(ax, colours: np.ndarray, extent: float) -> None:
    ax.imshow(colours, origin="lower", extent=(-extent, extent) * 2, interpolation="nearest")
    ax.set(xticks=(-1, 0, 1), yticks=(-1, 0, 1))


def _colours(magnet: np.ndarray, slowness: np.ndarray) -> np.ndarray:
    """Return colours (..., 3): a light tint of the magnet's for quick motions, a dark one for slow ones."""
    base = np.array([to_rgb(c) for c in COLOURS["magnets"]])[np.clip(magnet, 0, None)]
    # A file holds 256 colours: three scales of these steps, and greys for text.
    slow = np.round(_SHADES * np.clip(slowness, 0.0, 1.0))[..., None] / _SHADES
    colours = (1 - slow) * (base + 0.65 * (1 - base)) + slow * 0.4 * base
    return np.where((magnet == UNDECIDED)[..., None], 0.5, colours)


def _key(ax, slowest: float) -> None:
    """Draw the three colours against the time."""
    ramp = np.broadcast_to(np.linspace(0, 1, _SHADES + 1), (3, _SHADES + 1))
    names = np.broadcast_to(np.arange(3)[:, None], ramp.shape)
    ax.imshow(_colours(names, ramp), aspect="auto", extent=(0, slowest, 2.5, -0.5), interpolation="nearest")
    ax.hlines([0.5, 1.5], 0, slowest, color="white", lw=1.5)
    for k, (x, y) in enumerate(MAGNETS):
        ax.text(0.03 * slowest, k, f"({x:.2g}, {y:.2g})".replace("-", "−"), va="center", fontsize=6.5)
    ax.set(yticks=[], xlabel=f"time to capture (s),\ndarkest: {slowest:.0f} s or more")
    ax.set_title("magnet where it ends\nx, y (m)", fontsize=7.5)
    ax.spines[["left", "bottom"]].set_visible(False)
