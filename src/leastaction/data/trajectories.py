"""Trajectories: measured coordinates over time, checked on creation."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from typing import overload

import numpy as np

from leastaction.data.shown import ShownRuns
from leastaction.data.trajectory import RATES, Rate, Trajectory, check_items
from leastaction.data.validation import (
    fill_names,
    listed,
    names_held_out,
    plain_bytes,
    position_of,
    rows_held_out,
    share_held_out,
    unwrap_in_place,
)
from leastaction.errors import InputError
from leastaction.findings import Finding
from leastaction.identifiers import check_coordinate_names, quoted

__all__ = ["Rate", "Trajectories", "Trajectory"]


class Trajectories(ShownRuns, Sequence[Trajectory]):
    """Several trajectories of one system with the same coordinates. Lengths and times may differ.

    Parameters
    ----------
    trajectories : iterable of Trajectory
        At least one. Names must differ. Trajectories without a name are numbered in `names`.

    Raises
    ------
    InputError
        If there is none, one is not a Trajectory, the coordinates differ, or a name occurs twice.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 2.0, 201)
    >>> a = Trajectory(t, np.cos(t), coordinates=["theta"], name="a")
    >>> b = Trajectory(t[:101], np.sin(t[:101]), coordinates=["theta"], name="b")
    >>> both = Trajectories([a, b])
    >>> both.n_trajectories, both.n_samples, both.duration, both.driven
    (2, 302, 3.0, False)
    >>> both.select("b")[0].n_times
    101
    """

    def __init__(self, trajectories: Iterable[Trajectory]) -> None:
        items = check_items(trajectories)
        self._items = items
        self._wraps = tuple((0,) * items[0].n_dof for _ in items)
        self._names = fill_names([item.name for item in items])

    @classmethod
    def coerce(cls, x: Trajectory | Trajectories | Iterable[Trajectory]) -> Trajectories:
        """Return `x` as Trajectories.

        Parameters
        ----------
        x : Trajectory, Trajectories or iterable of Trajectory

        Returns
        -------
        Trajectories
            `x` itself if it is already of this class.

        Raises
        ------
        InputError
            If `x` is anything else.

        Examples
        --------
        >>> Trajectories.coerce(Trajectory([0.0, 1.0], [0.1, 0.2])).n_trajectories
        1
        """
        if isinstance(x, Trajectories):
            return x
        return cls([x] if isinstance(x, Trajectory) else x)

    def __len__(self) -> int:
        return len(self._items)

    @overload
    def __getitem__(self, index: int) -> Trajectory: ...
    @overload
    def __getitem__(self, index: slice) -> Trajectories: ...
    def __getitem__(self, index: int | slice) -> Trajectory | Trajectories:
        if isinstance(index, slice):
            return self.select(range(len(self))[index])
        return self._items[index]

    def __iter__(self) -> Iterator[Trajectory]:
        return iter(self._items)

    def __repr__(self) -> str:
        driven = ", driven" if self.driven else ""
        runs = f"{len(self)} {'trajectory' if len(self) == 1 else 'trajectories'}"
        return (
            f"<Trajectories of {', '.join(self.coordinates)}: {runs}, "
            f"{self.n_samples} samples, {self.duration:g} s{driven}>"
        )

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return self._items[0].coordinates

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the trajectories, all different. One without a name gets its number, from 0."""
        return self._names

    @property
    def n_dof(self) -> int:
        """Number of coordinates."""
        return self._items[0].n_dof

    @property
    def n_trajectories(self) -> int:
        """Number of trajectories."""
        return len(self._items)

    @property
    def n_samples(self) -> int:
        """Number of measured values: finite entries of `q`, over all coordinates and trajectories."""
        return sum(item.n_samples for item in self._items)

    @property
    def duration(self) -> float:
        """Sum of the durations, in seconds."""
        return float(sum(item.duration for item in self._items))

    @property
    def sampling_interval(self) -> float:
        """Median time between samples, in seconds."""
        return float(np.median(np.concatenate([np.diff(item.t) for item in self._items])))

    @property
    def driven(self) -> bool:
        """Whether any known force is not zero."""
        return any(item.driven for item in self._items)

    @property
    def rates(self) -> tuple[Rate, ...]:
        """Measured quantities other than positions: velocities by coordinate, then accelerations."""
        out: list[Rate] = []
        for derivative, field in enumerate(RATES, start=1):
            arrays = [item.rates(field) for item in self._items]
            for i in range(self.n_dof):
                values = tuple(
                    np.full(item.n_times, np.nan) if array is None else array[:, i]
                    for item, array in zip(self._items, arrays, strict=True)
                )
                if any(np.isfinite(v).any() for v in values):
                    out.append(Rate(i, derivative, values))
        return tuple(out)

    @property
    def wraps_removed(self) -> dict[str, int]:
        """For each coordinate, the number of jumps that `unwrap` has removed so far."""
        totals = np.sum(self._wraps, axis=0)
        return {name: int(total) for name, total in zip(self.coordinates, totals, strict=True)}

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Changes that the reader made to the data. `discover` adds these findings to those of the fit.

        Slices, selections and other sets of the same trajectories keep them.

        Examples
        --------
        >>> from leastaction import from_frame
        >>> frame = {"time_ms": [0, 10, 20, 30, 40], "x": [0.0, 0.1, 0.3, 0.2, 0.1]}
        >>> import pandas as pd
        >>> for finding in from_frame(pd.DataFrame(frame), ["x"], time="time").findings:
        ...     print(finding.code, finding.values["unit"])
        time-unit ms
        """
        return tuple(dict.fromkeys(finding for item in self._items for finding in item.findings))

    def unwrap(self, angles: Iterable[str] | str) -> Trajectories:
        """Remove jumps by multiples of 2 pi from wrapped angles.

        A jump of more than pi between successive measured samples (not NaN) of a trajectory counts as a wrap.
        The nearest multiple of 2 pi is subtracted from all later samples. Repeating this changes nothing. If
        noise alone causes such steps (more than half a radian), an angle that spans more than 2 pi is left as
        it is, and any other is compared with the trend of the previous samples.

        Parameters
        ----------
        angles : iterable of str, or str
            Coordinates that are angles, in radians.

        Returns
        -------
        Trajectories
            New trajectories; `wraps_removed` has the number of jumps removed.

        Raises
        ------
        InputError
            If a name is not one of the coordinates.

        Examples
        --------
        >>> wrapped = Trajectories([Trajectory([0, 1, 2], [3.0, -3.0, -2.5], coordinates=["theta"])])
        >>> unwrapped = wrapped.unwrap(["theta"])
        >>> unwrapped[0].q[:, 0].round(3).tolist(), unwrapped.wraps_removed
        ([3.0, 3.283, 3.783], {'theta': 1})
        """
        columns = self._angle_columns(angles)
        items: list[Trajectory] = []
        wraps: list[tuple[int, ...]] = []
        for item, counted in zip(self._items, self._wraps, strict=True):
            q, count = item.q.copy(), list(counted)
            for column in columns:
                count[column] += unwrap_in_place(q[:, column])
            items.append(item if tuple(count) == counted else item.changed(q=q))
            wraps.append(tuple(count))
        return self._with(items, wraps, self._names)

    @classmethod
    def with_wraps(cls, items: Iterable[Trajectory], wraps: Iterable[tuple[int, ...]]) -> Trajectories:
        """Create trajectories with a record of the jumps removed before, per trajectory and coordinate.

        Examples
        --------
        >>> Trajectories.with_wraps([Trajectory([0, 1], [0.1, 0.2])], [(3,)]).wraps_removed
        {'q1': 3}
        """
        items = tuple(items)
        return cls._with(items, wraps, fill_names([item.name for item in items]))

    def select(self, names_or_indices: str | int | Iterable[str | int]) -> Trajectories:
        """Return some of the trajectories, in the given order.

        Parameters
        ----------
        names_or_indices : str, int, or iterable of them
            Names (see `names`) or numbers, from 0; negative numbers count from the end.

        Returns
        -------
        Trajectories

        Raises
        ------
        InputError
            If there is no such trajectory, none is selected, or one is selected twice.

        Examples
        --------
        >>> runs = Trajectories([Trajectory([0, 1], [0, k], name=f"run{k}") for k in range(3)])
        >>> runs.select(["run2", 0]).names
        ('run2', 'run0')
        """
        if isinstance(names_or_indices, (str, int, np.integer)):
            names_or_indices = [names_or_indices]  # type: ignore[list-item]
        chosen = [position_of(key, self._names) for key in names_or_indices]
        if not chosen:
            raise InputError(f"no trajectory selected; choose among {listed(self._names)}")
        if len(set(chosen)) < len(chosen):
            twice = next(self._names[i] for i in chosen if chosen.count(i) > 1)
            raise InputError(f"trajectory {quoted(twice)} is selected twice; select each one once")
        return self._with(
            [self._items[i] for i in chosen],
            [self._wraps[i] for i in chosen],
            [self._names[i] for i in chosen],
        )

    def hold_out(self, what: int | str | Iterable[str | int]) -> tuple[Trajectories, Trajectories]:
        """Return the trajectories to fit, and those to forecast.

        Parameters
        ----------
        what : int, str, or iterable of names and numbers
            ``2``: the last two. ``"20%"``: the last fifth, at least one; for a single trajectory, its end.
            ``"a,b"`` or ``["a", "b"]``: by name. The same as ``--hold-out`` on the command line.

        Raises
        ------
        InputError
            If there is no such trajectory, or nothing is left to fit or to forecast.

        Examples
        --------
        >>> runs = Trajectories([Trajectory([0, 1], [0, k], name=f"run{k}") for k in range(3)])
        >>> [part.names for part in runs.hold_out("20%")]
        [('run0', 'run1'), ('run2',)]
        """
        share = share_held_out(what)
        if share is not None and len(self) == 1:
            late = rows_held_out(self._items[0].t, share)
            parts = [self._items[0].rows(rows) for rows in (~late, late)]
            named = zip(parts, (self._names[0], f"{self._names[0]} (end)"), strict=True)
            fitted, held = (self._with([part], self._wraps, [name]) for part, name in named)
            return fitted, held
        held = self.select(names_held_out(what, share, self._names))
        return self.select([name for name in self._names if name not in held.names]), held

    def with_forces(self, forces: Iterable[np.ndarray | None]) -> Trajectories:
        """Return the same trajectories with other known forces, (n_times, n_dof) or None for each.

        Examples
        --------
        >>> run = Trajectory([0.0, 1.0], [0.1, 0.2])
        >>> Trajectories([run]).with_forces([np.ones((2, 1))]).driven
        True
        """
        items = [item.changed(forces=f) for item, f in zip(self._items, forces, strict=True)]
        return self._with(items, self._wraps, self._names)

    def without_rates(self) -> Trajectories:
        """Return the same trajectories with positions and forces only.

        Examples
        --------
        >>> run = Trajectory([0.0, 1.0], [0.1, 0.2], velocities=[0.1, 0.1])
        >>> Trajectories([run]).without_rates()[0].velocities is None
        True
        """
        items = [item.changed(**dict.fromkeys(RATES)) for item in self._items]
        return self._with(items, self._wraps, self._names)

    def digest(self) -> str:
        """Return the SHA-256 of the data: coordinates, times, samples, forces and rates, not names of trials.

        Returns
        -------
        str
            64 hexadecimal digits, the same on every machine. Absent forces count as zero forces, and absent
            velocities or accelerations as missing ones.

        Examples
        --------
        >>> Trajectories([Trajectory([0.0, 1.0], [0.1, 0.2])]).digest()[:12]
        '43c279b833a9'
        """
        digest = hashlib.sha256("\0".join(self.coordinates).encode())
        for item in self._items:
            digest.update(f"|{item.n_times},{item.n_dof},{item.driven}|".encode())
            for array in (item.t, item.q, item.forces if item.driven else None):
                if array is not None:
                    digest.update(plain_bytes(array))
            for field in RATES:
                rates = item.rates(field)
                if rates is not None:
                    digest.update(f"|{field}|".encode() + plain_bytes(rates))
        return digest.hexdigest()

    def without(self, masks: Sequence[np.ndarray]) -> Trajectories:
        """Mark samples as missing.

        Parameters
        ----------
        masks : sequence of (n_times, n_dof) bool arrays
            One for each trajectory; true samples become NaN.

        Returns
        -------
        Trajectories

        Examples
        --------
        >>> data = Trajectories([Trajectory([0, 1, 2], [0.1, 9.0, 0.3], coordinates=["x"])])
        >>> data.without([np.array([[False], [True], [False]])]).n_samples
        2
        """
        items = [
            t.changed(q=np.where(mask, np.nan, t.q)) if mask.any() else t
            for t, mask in zip(self._items, masks, strict=True)
        ]
        return self._with(items, self._wraps, self._names)

    @classmethod
    def _with(
        cls, items: Iterable[Trajectory], wraps: Iterable[tuple[int, ...]], names: Iterable[str]
    ) -> Trajectories:
        new = cls(items)
        new._wraps, new._names = tuple(wraps), tuple(names)
        return new

    def _angle_columns(self, angles: Iterable[str] | str) -> list[int]:
        given = (angles,) if isinstance(angles, str) else tuple(angles)
        names = check_coordinate_names(given) if given else ()
        for name in names:
            if name not in self.coordinates:
                known = f"the coordinates are {listed(self.coordinates)}"
                raise InputError(f"angle {quoted(name)} is not a coordinate; {known}")
        return [self.coordinates.index(name) for name in names]
