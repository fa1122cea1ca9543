"""Conversion of arrays or trajectories to `Trajectories`, and selections of their coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import issparse

from leastaction.data.trajectories import Trajectories
from leastaction.data.trajectory import FIELDS, Trajectory
from leastaction.data.validation import FloatArray
from leastaction.errors import InputError
from leastaction.identifiers import quoted
from leastaction.kinds import is_array, is_list

__all__ = ["arranged", "gather", "joined", "one_each"]


def gather(
    q: Any, t: Any, forces: Any, coordinates: Sequence[str] | None, t_otherwise: Any = None
) -> Trajectories:
    """Convert the arguments of `SparseLagrangian.fit` to trajectories.

    `t_otherwise` replaces a `t` that is needed and missing.

    Raises
    ------
    InputError
    """
    runs, single = _runs(q)
    if any(isinstance(run, Trajectory) for run in runs):
        if not (t is None and forces is None):
            raise InputError("a Trajectory has its own times and forces; give t and forces with arrays only")
        return Trajectories(runs)
    t = t_otherwise if t is None else t
    if t is None:
        raise InputError(
            "t is missing; give the sampling interval in seconds, the times, or Trajectory objects, which "
            "have their own (scikit-learn passes the t of fit on to score only if all trajectories share it)"
        )
    times = [t] if single else _each("t", t, len(runs))
    pushes = [forces] if single else _each("forces", forces, len(runs))
    return Trajectories(
        Trajectory(_times(a, x), x, f, coordinates) for x, a, f in zip(runs, times, pushes, strict=True)
    )


def one_each(values: Any, shared: int = 1) -> bool:
    """Whether there is an entry for each trajectory, rather than an array of `shared` axes for all."""
    if is_array(values):
        return values.ndim > shared or values.dtype == object
    return is_list(values) and any(v is None or np.ndim(v) > 0 for v in values)


def _runs(q: Any) -> tuple[list[Any], bool]:
    """One entry per trajectory, and whether it was a single array."""
    if isinstance(q, Trajectory):
        return [q], True
    runs: Any = q
    if not isinstance(q, (Trajectories, list, tuple)):
        if issparse(q):
            raise InputError(
                "q is a sparse matrix; sparse data are not supported: expected an array of numbers"
            )
        runs = np.asarray(q)
        if np.iscomplexobj(runs):
            raise InputError("Complex data not supported: q must be real numbers")
        if not (runs.ndim == 3 or (runs.dtype == object and runs.ndim == 1)):
            return [runs], True
    if len(runs) == 0:
        raise InputError("q is empty; expected an array of coordinates, or a sequence of them")
    return list(runs), False


def _each(label: str, values: Any, count: int) -> list[Any]:
    """One entry per trajectory: those given, or the same one for all."""
    if not one_each(values, 1 if label == "t" else 2):
        return [values] * count
    if len(values) != count:
        raise InputError(
            f"{label} has {len(values)} entries for {count} trajectories; give one for each, or one array"
        )
    return list(values)


def _times(t: Any, q: Any) -> Any:
    if np.ndim(t) > 0:
        return t
    step = float(t) if np.asarray(t).dtype.kind in "fiu" else 0.0
    if not 0.0 < step < np.inf:
        raise InputError(f"t is {quoted(t)}; expected a positive sampling interval in seconds, or the times")
    return step * np.arange(len(np.atleast_1d(q)))


def arranged(trajectories: Trajectories, coordinates: Sequence[str]) -> Trajectories:
    """Return the trajectories with the given coordinates, in this sequence.

    A coordinate that they do not have is NaN everywhere, and no force acts on it.

    Examples
    --------
    >>> runs = Trajectories([Trajectory([0.0, 1.0], [0.1, 0.2], coordinates=["x"])])
    >>> arranged(runs, ["x", "y"])[0].q.tolist()
    [[0.1, nan], [0.2, nan]]
    """
    names = tuple(coordinates)
    if names == trajectories.coordinates:
        return trajectories
    places = [trajectories.coordinates.index(n) if n in trajectories.coordinates else -1 for n in names]
    named = zip(trajectories, trajectories.names, strict=True)
    items = [_arranged(item, places, names).changed(name=name) for item, name in named]
    removed = trajectories.wraps_removed  # only their sum over the trajectories is used
    wraps = [tuple(removed.get(n, 0) for n in names), *((0,) * len(names) for _ in items[1:])]
    return Trajectories.with_wraps(items, wraps)


def joined(some: Trajectories, whole: Trajectories) -> Trajectories:
    """Return ``whole`` without the samples that are missing in ``some``, with part of its coordinates."""
    if some is whole:
        return whole
    places = [whole.coordinates.index(name) for name in some.coordinates]
    masks: list[np.ndarray] = []
    for part, item in zip(some, whole, strict=True):
        lost = np.zeros(item.q.shape, dtype=bool)
        lost[:, places] = np.isnan(part.q)
        masks.append(lost)
    return whole.without(masks)


def _arranged(item: Trajectory, places: list[int], names: tuple[str, ...]) -> Trajectory:
    arrays: dict[str, FloatArray] = {}
    for field in FIELDS[1:]:
        given = getattr(item, field)
        if given is None:
            continue
        fill = 0.0 if field == "forces" else np.nan
        columns = [given[:, p] if p >= 0 else np.full(item.n_times, fill) for p in places]
        arrays[field] = np.stack(columns, axis=1)
    return item.changed(**arrays, coordinates=names)
