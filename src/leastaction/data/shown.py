"""Display of trajectories: card, plot, data frame."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from leastaction.data.validation import listed
from leastaction.errors import InputError
from leastaction.findings import Finding
from leastaction.identifiers import counted, quoted, split_names, written_name
from leastaction.shown import Card, Display, Panel, Series, Shown, data_frame

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from leastaction.data.trajectories import Trajectories
    from leastaction.data.trajectory import Trajectory

__all__ = ["ShownRuns", "units_of", "written_names"]

_MOST_COORDINATES = 4  # whose ranges have a column each
_ENDINGS = {"q": "", "forces": "_force", "velocities": "_dot", "accelerations": "_ddot"}


class ShownRuns(Shown):
    """Display methods of one trajectory and of several."""

    def plot(
        self, ax: Axes | Sequence[Axes] | None = None, *, angles: Iterable[str] = (), **kwargs: Any
    ) -> Display:
        """Plot the coordinates over time, one line for each trajectory, with gaps at missing samples.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, or sequence of them, optional
            One for all coordinates, or one for each. By default a new figure.
        angles : iterable of str
            Coordinates that are angles, for the labels, in addition to those whose units were converted to
            rad by the reader, and those from which `unwrap` removed jumps.
        **kwargs
            Properties of Matplotlib's lines, such as ``color`` and ``linewidth``.

        Returns
        -------
        Display
            With ``figure_``, ``ax_``, ``axes_`` and ``lines_``.

        Raises
        ------
        InputError
            If an angle is not one of the coordinates, or the number of axes is wrong; also, as an
            ImportError too, if Matplotlib is not installed (extra ``plot``).

        Examples
        --------
        >>> import numpy as np, leastaction as la
        >>> t = np.linspace(0.0, 5.0, 251)
        >>> run = la.Trajectory(t, np.sin(t), coordinates=["theta1"])
        >>> run.plot(angles=["theta1"]).ax_.get_ylabel()
        'θ₁ (rad)'
        """
        names, runs = self._named_runs()
        units = units_of(self, angles)
        written = written_names(runs[0].coordinates)
        panels = [
            Panel(
                written[c],
                units.get(c, ""),
                [
                    Series(run.t, run.q[:, i], name if len(runs) > 1 else "")
                    for name, run in zip(names, runs, strict=True)
                ],
            )
            for i, c in enumerate(runs[0].coordinates)
        ]
        return Display(panels, names[0] if len(runs) == 1 else "").plot(ax, **kwargs)

    def to_frame(self) -> pd.DataFrame:
        """Return a data frame of pandas that `leastaction.from_frame` takes, one row for each time.

        Returns
        -------
        pandas.DataFrame
            Columns ``trial``, ``t`` and the coordinates, and, if available, known forces
            ``<coordinate>_force`` and measured rates ``<coordinate>_dot``, ``<coordinate>_ddot``, as in a CSV
            file of `write_csv`. NaN: not measured.

        Raises
        ------
        InputError
            If pandas is not installed (extra ``pandas``); it is an ImportError, too.

        Examples
        --------
        >>> import leastaction as la
        >>> run = la.Trajectory([0.0, 0.5], [1.0, 0.9], coordinates=["x"], name="a")
        >>> print(run.to_frame().to_string(index=False))
        trial   t   x
            a 0.0 1.0
            a 0.5 0.9
        """
        names, runs = self._named_runs()
        trial = [name for name, run in zip(names, runs, strict=True) for _ in range(run.n_times)]
        columns: dict[str, Any] = {"trial": trial, "t": np.concatenate([run.t for run in runs])}
        for field, ending in _ENDINGS.items():
            empty = 0.0 if field == "forces" else np.nan
            arrays = [getattr(run, field) for run in runs]
            if all(array is None for array in arrays):
                continue
            whole = np.concatenate(
                [np.full(run.q.shape, empty) if a is None else a for a, run in zip(arrays, runs, strict=True)]
            )
            columns |= {f"{c}{ending}": whole[:, i] for i, c in enumerate(runs[0].coordinates)}
        return data_frame(columns)

    def _named_runs(self) -> tuple[Sequence[str], Sequence[Trajectory]]:
        """Names and trajectories, also of a single one."""
        runs = cast("Trajectory | Trajectories", self)
        return (runs.names, tuple(runs)) if isinstance(runs, Sequence) else ((runs.name,), (runs,))

    def _card(self) -> Card:
        names, runs = self._named_runs()
        named = runs[0].coordinates[:_MOST_COORDINATES]
        rows = [("trial", "times", "duration", "interval", "missing", *(f"range of {c}" for c in named))]
        rows += [(name, *_figures(run, len(named))) for name, run in zip(names, runs, strict=True)]
        samples, seconds = sum(run.n_samples for run in runs), sum(run.duration for run in runs)
        lines = [f"{counted(samples, 'sample')}, {seconds:g} s"]
        has = [what for what, there in _extras(runs) if there]
        if has:
            lines.append(f"with {' and '.join(has)}")
        title = f"{counted(len(runs), 'trajectory', 'trajectories')} of {', '.join(runs[0].coordinates)}"
        return Card(title, lines, rows, [str(finding) for finding in _findings(runs)])


def _extras(runs: Sequence[Trajectory]) -> list[tuple[str, bool]]:
    rates = [
        (f"measured {f}", any(run.rates(f) is not None for run in runs))
        for f in ("velocities", "accelerations")
    ]
    return [("known forces", any(run.driven for run in runs)), *rates]


def _findings(runs: Sequence[Trajectory]) -> tuple[Finding, ...]:
    return tuple(dict.fromkeys(finding for run in runs for finding in run.findings))


def _figures(run: Trajectory, n: int) -> list[str]:
    """Figures of one trajectory for a row of a table."""
    step = f"{np.median(np.diff(run.t)):.4g} s" if run.n_times > 1 else ""
    missing = run.q.size - run.n_samples
    out = [str(run.n_times), f"{run.duration:g} s", step, str(missing) if missing else ""]
    for i in range(n):
        values = run.q[:, i][np.isfinite(run.q[:, i])]
        out.append(f"{values.min():.3g} … {values.max():.3g}" if values.size else "not measured")
    return out


def written_names(coordinates: Sequence[str]) -> dict[str, str]:
    """Names of coordinates for the axes of plots.

    Examples
    --------
    >>> written_names(["theta1", "x"])
    {'theta1': 'θ₁', 'x': 'x'}
    """
    return {name: written_name(*parts) for name, parts in split_names(coordinates).items()}


def units_of(data: ShownRuns, angles: Iterable[str] = ()) -> dict[str, str]:
    """Known units of coordinates.

    Raises
    ------
    InputError
        If an angle is not one of the coordinates.

    Examples
    --------
    >>> import leastaction as la
    >>> units_of(la.Trajectory([0.0, 1.0], [0.1, 0.2], coordinates=["theta"]), ["theta"])
    {'theta': 'rad'}
    """
    _, runs = data._named_runs()  # pyright: ignore[reportPrivateUsage]
    coordinates = runs[0].coordinates
    units: dict[str, str] = {}
    for finding in _findings(runs):
        if finding.code == "converted-units" and finding.values.get("quantity") == "position":
            units |= {name: str(finding.values["to"]) for name in finding.subject if name in coordinates}
    wraps: dict[str, int] = getattr(data, "wraps_removed", {})
    units |= {name: "rad" for name, n in wraps.items() if n}
    for name in (angles,) if isinstance(angles, str) else angles:
        if name not in coordinates:
            known = f"the coordinates are {listed(coordinates)}"
            raise InputError(f"angle {quoted(name)} is not a coordinate; {known}")
        units[name] = "rad"
    return units
