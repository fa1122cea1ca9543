"""Diagnostics of a discovery: fitted curve, selection path, dropped candidates and timings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, overload

import numpy as np

from leastaction.curve.bspline import SplineGrid
from leastaction.data.shown import units_of, written_names
from leastaction.data.trajectories import Trajectories
from leastaction.findings import Finding, as_given, smoothing_widths
from leastaction.identifiers import counted
from leastaction.library import Dropped, Kind
from leastaction.shown import Card, Display, Panel, Series, Shown, data_frame

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

__all__ = ["Diagnostics", "HiddenMotion", "PathPoint", "TradeOff", "pareto"]

_NOT_BORNE_OUT = ("no-fit", "fit-is-worse")
_MEASURED = {"color": "0.55", "marker": ".", "markersize": 3, "linestyle": "none"}
_STRUCTURES = {"marker": "o", "linestyle": "none"}
_Z95 = 1.96  # standard errors: half of a 95 % interval
_CHOSEN = {"marker": "D", "markersize": 9, "markerfacecolor": "none", "linestyle": "none"}


@dataclass(frozen=True)
class PathPoint:
    """One structure on the selection path.

    Attributes
    ----------
    expressions : tuple of str
        Free terms of the structure.
    cost : float
        −2 log likelihood, relative to the best structure seen.
    bic : float
        ``cost`` + (number of free terms) · log(number of samples), relative to the chosen structure.
    chosen : bool
    reason : str
        Reason why it was not chosen; see `leastaction.selection.alternatives.Alternative`.
    coefficients, standard_errors : tuple of float
        Values of the expressions' coefficients, predicted by the quadratic model around the chosen structure.
    kinds : tuple of {"lagrangian", "dissipation"}
        Of the expressions.
    length : float
        Description length of the expressions in bits; NaN if the library has none.
    templates : tuple of str
        The expressions with shape parameters in braces, "" for one without. Empty: no shape parameters.
    shapes : tuple of (str, float)
        Shape parameters of the structure and of known terms, with their values in the expressions.
    """

    expressions: tuple[str, ...]
    cost: float
    bic: float
    chosen: bool = False
    reason: str = ""
    coefficients: tuple[float, ...] = ()
    standard_errors: tuple[float, ...] = ()
    kinds: tuple[Kind, ...] = ()
    length: float = math.nan
    templates: tuple[str, ...] = ()
    shapes: tuple[tuple[str, float], ...] = ()

    @property
    def written(self) -> tuple[str, ...]:
        """The expressions for display, with shape parameters by name."""
        pairs = zip(self.expressions, self.templates, strict=True) if self.templates else ()
        return tuple(template or expression for expression, template in pairs) or self.expressions

    @property
    def n_terms(self) -> int:
        """Number of free terms."""
        return len(self.expressions)


def pareto(points: Sequence[PathPoint]) -> tuple[PathPoint, ...]:
    """Structures that no shorter one fits equally well, in rising length, and the chosen one.

    Empty without description lengths. Structures that their own fit does not confirm are left out.

    Examples
    --------
    >>> points = [PathPoint(("x",), 9.0, 9.0, length=3.0), PathPoint(("y",), 12.0, 12.0, length=5.0),
    ...           PathPoint(("x", "y"), 0.0, 0.0, chosen=True, length=8.0)]
    >>> [point.length for point in pareto(points)]
    [3.0, 8.0]
    """
    usable = [p for p in points if math.isfinite(p.length) and math.isfinite(p.cost)]
    ranked = sorted(usable, key=lambda p: (p.length, p.cost, not p.chosen))
    kept: list[PathPoint] = []
    lowest = math.inf
    for point in ranked:
        better = point.cost < lowest and point.reason not in _NOT_BORNE_OUT
        if better or point.chosen:
            kept.append(point)
            lowest = min(lowest, point.cost)
    return tuple(kept)


class TradeOff(Shown, Sequence[PathPoint]):
    """Size of structures against misfit: a sequence of `PathPoint`.

    Parameters
    ----------
    points : iterable of PathPoint
    widths : sequence of float
        Widths in which absolute values of velocities were smoothed; these are shown as abs().

    Examples
    --------
    >>> curve = TradeOff([PathPoint(("x",), 9.0, 4.0), PathPoint(("x", "y"), 0.0, 0.0, chosen=True)])
    >>> len(curve), curve[-1].chosen, curve.measure
    (2, True, 'terms')
    """

    def __init__(self, points: Iterable[PathPoint], widths: Sequence[float] = ()) -> None:
        self._points = tuple(points)
        self._widths = tuple(widths)

    def __len__(self) -> int:
        return len(self._points)

    @overload
    def __getitem__(self, key: int) -> PathPoint: ...
    @overload
    def __getitem__(self, key: slice) -> tuple[PathPoint, ...]: ...
    def __getitem__(self, key: int | slice) -> PathPoint | tuple[PathPoint, ...]:
        return self._points[key]

    def __repr__(self) -> str:
        return f"<TradeOff of {counted(len(self), 'structure')}>"

    @property
    def measure(self) -> str:
        """Unit of the size: ``"bits"`` if the library has description lengths, else ``"terms"``."""
        return "bits" if self and all(math.isfinite(p.length) for p in self) else "terms"

    def plot(self, ax: Axes | Sequence[Axes] | None = None, **kwargs: Any) -> Display:
        """Plot −2 log likelihood against size, and mark the chosen structure.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            By default a new figure.
        **kwargs
            Properties of Matplotlib's lines, such as ``color``.

        Returns
        -------
        Display
            With ``figure_``, ``ax_``, ``axes_`` and ``lines_``: all structures, then the chosen one.

        Raises
        ------
        InputError
            If `ax` holds several axes; also, as an ImportError too, if Matplotlib is not installed (extra
            ``plot``).

        Examples
        --------
        >>> curve = TradeOff([PathPoint(("x",), 9.0, 4.0), PathPoint(("x", "y"), 0.0, 0.0, chosen=True)])
        >>> curve.plot().ax_.get_xlabel()
        'free terms'
        """
        sizes = [p.length if self.measure == "bits" else p.n_terms for p in self]
        chosen = [k for k, p in enumerate(self) if p.chosen]
        marked = [sizes[k] for k in chosen], [self[k].cost for k in chosen]
        series = [
            Series(sizes, [p.cost for p in self], "structures", style=_STRUCTURES),
            Series(*marked, "chosen", style=_CHOSEN),
        ]
        x_label = "description length (bits)" if self.measure == "bits" else "free terms"
        return Display([Panel("−2 Δ log likelihood", "", series, x_label, "symlog")]).plot(ax, **kwargs)

    def to_frame(self) -> pd.DataFrame:
        """Return a pandas data frame, one row per structure.

        Returns
        -------
        pandas.DataFrame
            Columns ``terms`` (separated by semicolons), ``n_terms``, ``cost``, ``bic``, ``length``,
            ``chosen`` and ``reason``, as in `PathPoint`.

        Raises
        ------
        InputError
            If pandas is not installed (extra ``pandas``); it is an ImportError, too.
        """
        texts = [as_given("; ".join(p.written), self._widths) for p in self]
        columns: dict[str, Any] = {"terms": texts}
        names = ("n_terms", "cost", "bic", "length", "chosen", "reason")
        return data_frame(columns | {name: [getattr(p, name) for p in self] for name in names})

    def _card(self) -> Card:
        rows = [(self.measure, "−2 Δ log likelihood", "structure")]
        for p in self:
            size = f"{p.length:.1f}" if self.measure == "bits" else str(p.n_terms)
            terms = as_given(", ".join(p.written), self._widths)
            rows.append((size, f"{p.cost:.4g}", f"{terms}{' (chosen)' if p.chosen else ''}"))
        return Card(f"Trade-off of {counted(len(self), 'structure')}", rows=rows)


class HiddenMotion(NamedTuple):
    """Estimated motion of a coordinate without a sensor, in one trajectory.

    Attributes
    ----------
    t : (n_times,) array
        Times of the samples, in seconds.
    q : (n_times,) array
        The coordinate.
    standard_error : (n_times,) array
        Of ``q``, for the given structure; the choice of the sign or zero of the coordinate is not included.
    """

    t: np.ndarray
    q: np.ndarray
    standard_error: np.ndarray

    @property
    def reach(self) -> np.ndarray:
        """Half of the 95 % band, 1.96 standard errors."""
        return _Z95 * self.standard_error


@dataclass(frozen=True, eq=False, repr=False)
class Diagnostics(Shown):
    """Results of a discovery that the report shows and the model file does not store.

    Attributes
    ----------
    trajectories : Trajectories
        The fitted data, angles unwrapped.
    grid, control_points
        The fitted curve; see :meth:`curve`.
    noise_std, physics_weight, equation_error : (n_dof,) arrays
        σ_i; w_i, the inverse spectral density of the equation error; root mean square of the equation
        residual in the units of a generalised force.
    path : tuple of PathPoint
        Best structure of each size, by increasing size, then the runners-up of the chosen size.
    pareto : tuple of PathPoint
        For libraries with description lengths (`Library.symbolic`): structures that no shorter one fits
        equally well, by increasing length, and the chosen one.
    dropped : tuple of Dropped
        Candidates removed before the fit, with reasons.
    findings : tuple of Finding
        Findings of the fit; set by the model.
    prepared : tuple of Finding
        Findings about data and library, made before any fit.
    timings : dict
        Stage → seconds.
    rate_noise_std : dict
        Measured velocity or acceleration, ``"velocity of theta"`` → its noise.
    force_offset : dict
        Coordinate → estimated slow force, one (n_times,) array per trajectory at its times, if requested by
        ``discover(force_offset={coordinate: seconds})``.
    angles : tuple of str
        Coordinates that are angles.
    hidden_motion : dict
        Coordinate without a sensor → its estimated motion, one `HiddenMotion` per trajectory.
    """

    trajectories: Trajectories
    grid: SplineGrid
    control_points: np.ndarray
    noise_std: np.ndarray
    physics_weight: np.ndarray
    equation_error: np.ndarray
    path: tuple[PathPoint, ...] = ()
    dropped: tuple[Dropped, ...] = ()
    timings: dict[str, float] = field(default_factory=dict[str, float])
    rate_noise_std: dict[str, float] = field(default_factory=dict[str, float])
    force_offset: dict[str, tuple[np.ndarray, ...]] = field(default_factory=dict[str, tuple[np.ndarray, ...]])
    findings: tuple[Finding, ...] = ()
    prepared: tuple[Finding, ...] = ()
    pareto: tuple[PathPoint, ...] = ()
    angles: tuple[str, ...] = ()
    hidden_motion: dict[str, tuple[HiddenMotion, ...]] = field(
        default_factory=dict[str, tuple[HiddenMotion, ...]]
    )

    @property
    def positions(self) -> list[np.ndarray]:
        """(n_times, n_dof) samples of every trajectory, with the estimated motion of hidden coordinates."""
        out = [trajectory.q.copy() for trajectory in self.trajectories]
        for name, motions in self.hidden_motion.items():
            for q, motion in zip(out, motions, strict=True):
                q[:, self.trajectories.coordinates.index(name)] = motion.q
        return out

    @property
    def trade_off(self) -> TradeOff:
        """`pareto`, or `path` without description lengths, as an object with `plot`."""
        return TradeOff(self.pareto or self.path, smoothing_widths((*self.findings, *self.prepared)))

    def plot(
        self, ax: Axes | Sequence[Axes] | None = None, *, trial: str | int = 0, **kwargs: Any
    ) -> Display:
        """Plot one trial: measured samples, and the fitted curve through them.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, or sequence of them, optional
            One for all coordinates, or one for each. By default a new figure.
        trial : str or int
            Name or number of the trial; by default the first.
        **kwargs
            Properties of Matplotlib's lines, such as ``linewidth``, for samples and curve.

        Returns
        -------
        Display
            With ``figure_``, ``ax_``, ``axes_`` and ``lines_``: the samples first.

        Raises
        ------
        InputError
            If there is no such trial, or the number of axes is wrong; also, as an ImportError too, if
            Matplotlib is not installed (extra ``plot``).
        """
        chosen = self.trajectories.select(trial)
        (name,), run = chosen.names, chosen[0]
        curve = self.curve()[self.trajectories.names.index(name)]
        units, written = units_of(self.trajectories, self.angles), written_names(run.coordinates)
        panels: list[Panel] = []
        for i, c in enumerate(run.coordinates):
            series = [Series(run.t, curve[:, i], "fitted")]
            if c not in self.hidden_motion:
                series.insert(0, Series(run.t, run.q[:, i], "measured", style=_MEASURED))
            panels.append(Panel(written[c], units.get(c, ""), series))
        return Display(panels, name).plot(ax, **kwargs)

    def _card(self) -> Card:
        data = self.trajectories
        rows = [("coordinate", "noise", "equation error")]
        numbers = zip(data.coordinates, self.noise_std.tolist(), self.equation_error.tolist(), strict=True)
        rows += [(name, f"{noise:.3g}", f"{error:.3g}") for name, noise, error in numbers]
        took = f"{sum(self.timings.values()):.1f} s, {counted(len(self.path), 'structure')} on the path"
        left = f"{counted(len(self.dropped), 'candidate')} left out before the fit" if self.dropped else ""
        return Card(f"Diagnostics of {', '.join(data.coordinates)}", list(filter(None, (took, left))), rows)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes as sentences: changes made to data and library, and further information."""
        widths = smoothing_widths(self.findings)
        return tuple(
            as_given(str(finding), widths) for finding in self.findings if finding.severity == "note"
        )

    def curve(self, times: Sequence[np.ndarray] | None = None, nu: int = 0) -> list[np.ndarray]:
        """Derivative ``nu`` of the fitted curve, one (n_times, n_dof) array per trajectory.

        By default, ``times`` are those of the samples.
        """
        times = [trajectory.t for trajectory in self.trajectories] if times is None else times
        return self.grid.evaluate(self.control_points, times, nu)
