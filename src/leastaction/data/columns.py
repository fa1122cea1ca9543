"""Selection, order and completion of the coordinates of a recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from leastaction.data.trajectories import Trajectories
from leastaction.data.trajectory import FIELDS, Trajectory
from leastaction.data.validation import FloatArray

__all__ = ["arranged", "joined"]


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
