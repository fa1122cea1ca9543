"""Figure 3: basins of attraction of the damped magnetic pendulum, of the true L and of discovered ones.

At which magnet does a mass released at rest end? All starts are followed at once by the classical Runge–Kutta
method with a fixed step. A motion is settled, for certain, once its energy is below that of every point at
which it could cross from one magnet's sector into another's: damping only takes energy away.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import matplotlib
import numpy as np
import sympy as sp
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from sympy.printing.numpy import NumPyPrinter

from reproduction._plots import COLOURS, STYLE, Sheet, label, solved
from reproduction.problem import Answer, Case, Problem, pose

# -------------------------------------------------------------------------------- motions, and where they end
Progress = Callable[[float], None]

# positions (x, y), on the unit circle at 0 and ±120 degrees
MAGNETS = np.array([[1.0, 0.0], [-0.5, np.sqrt(0.75)], [-0.5, -np.sqrt(0.75)]])
UNDECIDED = -1
_AT_ONCE = 8192  # motions in the working set: their arrays stay in the processor's cache
_LOOK = 0.1  # seconds between two looks at the energy
_LONGEST = 60.0  # seconds after which a motion is given up as undecided


@dataclass(frozen=True)
class Field:
    """What a motion in the plane needs: ``acceleration(x, y, vx, vy)`` -> (ax, ay), and its ``energy``."""

    acceleration: Callable[..., tuple[np.ndarray, np.ndarray]]
    energy: Callable[..., np.ndarray]


@dataclass(frozen=True, eq=False)
class Basins:
    """Where motions end.

    Attributes
    ----------
    magnet : (n, n) int array
        Row: y, rising; column: x.  Index into `MAGNETS`, or -1 where the motion did not settle.
    time : (n, n) array
        Seconds until the motion is captured.
    extent : float
        The starts are the centres of n × n square pixels that fill (-extent, extent)².
    step : float
        Of the integration, in seconds.
    """

    magnet: np.ndarray
    time: np.ndarray
    extent: float
    step: float


def damping(problem: Problem, strength: float) -> sp.Expr:
    """Return ψ = ½ · strength · Σ q̇², a friction of the same strength along all coordinates."""
    return sp.Float(strength) / 2 * sp.Add(*(v**2 for v in problem.system.symbols[1]))


def lagrangian_of(problem: Problem, answer: Answer) -> sp.Expr:
    """Return the L that a method found, the known terms included."""
    if answer.coefficients is None:
        raise ValueError(f"{problem.case.method} gave no Lagrangian for {problem.case.system}")
    coefficients = {**problem.known, **answer.coefficients}
    return sp.Add(*(sp.Float(c, 17) * problem.system.parse(term) for term, c in coefficients.items()))


def field_of(lagrangian: sp.Expr, dissipation: sp.Expr, problem: Problem) -> Field:
    """Derive and compile the equations of motion M q̈ = ∂L/∂q − ∂ψ/∂q̇ − (∂²L/∂q̇∂q) q̇ of two coordinates."""
    q, v = problem.system.symbols
    momentum = [sp.diff(lagrangian, s) for s in v]
    mass = sp.Matrix(2, 2, lambda i, j: sp.diff(momentum[i], v[j]))
    right = sp.Matrix(
        [
            sp.diff(lagrangian, q[i])
            - sp.diff(dissipation, v[i])
            - sum(sp.diff(momentum[i], q[j]) * v[j] for j in range(2))
            for i in range(2)
        ]
    )
    solved = mass.adjugate() * right / mass.det()
    energy = sp.expand_mul(sum(p * s for p, s in zip(momentum, v, strict=True)) - lagrangian)
    printer = _Printer({"fully_qualified_modules": False, "inline": True, "allow_unknown_functions": True})
    compiled = (sp.lambdify([*q, *v], e, "numpy", printer=printer, cse=True) for e in (tuple(solved), energy))
    return Field(*compiled)


class _Printer(NumPyPrinter):
    """NumPy code with whole powers as products: NumPy's own are many times slower."""

    def _print_Pow(self, expr, rational=False):
        power = int(expr.exp) if expr.exp.is_Integer else 0
        if not 2 <= abs(power) <= 8:
            return super()._print_Pow(expr, rational)
        product = "*".join([f"({self._print(expr.base)})"] * abs(power))
        return f"({product})" if power > 0 else f"(1.0/({product}))"


def capture_level(field: Field, reach: float = 4.0) -> float:
    """Return the lowest energy at which a mass can stand on a border between two magnets' sectors.

    The sector of a magnet is where it is the nearest one; the borders run from the middle outwards.
    """
    radius = np.linspace(0.0, reach, 4001)
    angle = np.radians([60.0, 180.0, 300.0])[:, None]
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return float(np.min(field.energy(x, y, 0.0 * x, 0.0 * y)))


def nearest_magnet(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the index of the magnet next to each point."""
    # All three are at the same distance from the middle: the nearest is the one most in line.
    return np.argmax(MAGNETS @ np.stack([x, y]), axis=0)


def centres(pixels: int, extent: float) -> np.ndarray:
    """Return the coordinates of the pixels' centres along one side."""
    return extent * ((2 * np.arange(pixels) + 1) / pixels - 1)


def map_basins(
    field: Field, pixels: int, extent: float = 2.0, step: float = 0.01, progress: Progress | None = None
) -> Basins:
    """Release a mass at rest in the centre of each of pixels × pixels squares and see where it ends.

    Parameters
    ----------
    field : Field
        With damping.
    pixels : int
    extent : float
        Half the side of the square of starts.
    step : float
        Of the integration, in seconds; 0.1 s must be a whole multiple of it.
    progress : callable, optional
        Called with the share of the motions that have settled.
    """
    side = centres(pixels, extent)
    x0, y0 = (grid.ravel() for grid in np.meshgrid(side, side))
    magnet = np.full(x0.size, UNDECIDED, dtype=np.int8)
    time = np.full(x0.size, np.inf)
    level = capture_level(field)
    states, looks, who = np.empty((4, 0)), np.empty(0, dtype=int), np.empty(0, dtype=int)
    started = 0
    while True:
        # New motions take the places of settled ones, each with its own clock.
        new = np.arange(started, min(started + _AT_ONCE - who.size, x0.size))
        started += new.size
        fresh = np.stack([x0[new], y0[new], 0.0 * x0[new], 0.0 * y0[new]])
        states = np.hstack([states, fresh])
        looks, who = np.append(looks, np.zeros_like(new)), np.append(who, new)
        if not who.size:
            return Basins(magnet.reshape(pixels, -1), time.reshape(pixels, -1), extent, step)
        settled = field.energy(*states) < level
        magnet[who[settled]] = nearest_magnet(*states[:2, settled])
        time[who[settled]] = _LOOK * looks[settled]
        # A state that is not a number never settles.
        going = ~settled & (_LOOK * looks < _LONGEST) & np.isfinite(states).all(axis=0)
        states, looks, who = states[:, going], looks[going] + 1, who[going]
        states = _advance(field, states, step, round(_LOOK / step))
        if progress is not None:
            progress((started - who.size) / x0.size)


def _advance(field: Field, states: np.ndarray, step: float, times: int) -> np.ndarray:
    """Take several steps of the classical Runge–Kutta method of degree 4."""
    x, y, vx, vy = states
    half, sixth = step / 2, step / 6
    with np.errstate(all="ignore"):
        for _ in range(times):
            ax0, ay0 = field.acceleration(x, y, vx, vy)
            vx1, vy1 = vx + half * ax0, vy + half * ay0
            ax1, ay1 = field.acceleration(x + half * vx, y + half * vy, vx1, vy1)
            vx2, vy2 = vx + half * ax1, vy + half * ay1
            ax2, ay2 = field.acceleration(x + half * vx1, y + half * vy1, vx2, vy2)
            vx3, vy3 = vx + step * ax2, vy + step * ay2
            ax3, ay3 = field.acceleration(x + step * vx2, y + step * vy2, vx3, vy3)
            # The stage velocities in terms of the accelerations: fewer operations than the textbook form.
            x = x + step * (vx + sixth * (ax0 + ax1 + ax2))
            y = y + step * (vy + sixth * (ay0 + ay1 + ay2))
            vx = vx + sixth * (ax0 + 2.0 * (ax1 + ax2) + ax3)
            vy = vy + sixth * (ay0 + 2.0 * (ay1 + ay2) + ay3)
    return np.stack([x, y, vx, vy])


def agreement(one: Basins, other: Basins) -> float:
    """Return the fraction of the starts that settle, in both maps, at the same magnet."""
    return float(np.mean((one.magnet == other.magnet) & (one.magnet != UNDECIDED)))


# ------------------------------------------------------------------------------------------------- the figure
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
