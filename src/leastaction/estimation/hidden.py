"""Checks and placeholders of hidden coordinates, before a problem is built."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from leastaction.curve.knots import Knots
from leastaction.data.coerce import arranged
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import InputError
from leastaction.identifiers import check_coordinate_names, quoted
from leastaction.library import Library

__all__ = [
    "anchored",
    "check_hidden_terms",
    "knots_of_all",
    "lacking",
    "refuse_prescribed",
    "with_every_sensor",
    "with_hidden",
]


def with_hidden(
    trajectories: Trajectories, names: Iterable[str], library: Library | Iterable[str]
) -> tuple[Trajectories, tuple[int, ...]]:
    """The trajectories with a column for every hidden coordinate, and the indices of these.

    Columns are in the sequence of the library if it gives one; otherwise hidden ones come last.

    Raises
    ------
    InputError
        If a name is not allowed, or has samples; if nothing is measured; if the library does not know it.
    """
    hidden = check_coordinate_names([names] if isinstance(names, str) else list(names)) if names else ()
    if not hidden:
        return trajectories, ()
    for i, name in enumerate(trajectories.coordinates):
        count = sum(int(np.isfinite(t.q[:, i]).sum()) for t in trajectories)
        if name in hidden and count:
            raise InputError(
                f"hidden names {quoted(name)}, which has {count} samples; leave its column out, or do not "
                "call it hidden (missing samples may be NaN)"
            )
    measured = [name for name in trajectories.coordinates if name not in hidden]
    if not measured:
        raise InputError(
            "every coordinate is hidden, so that nothing is measured; name only those without a sensor"
        )
    names = (*measured, *hidden)
    if isinstance(library, Library) and set(library.coordinates) == set(names):
        names = library.coordinates
    return arranged(trajectories, names), tuple(i for i, name in enumerate(names) if name in hidden)


def check_hidden_terms(library: Library, names: Sequence[str]) -> None:
    """Refuse hidden coordinates that no candidate of L holds.

    Raises
    ------
    InputError
    """
    if names and library.shapes:
        raise InputError(
            f"shape parameters ({', '.join(library.shapes)}) cannot be estimated with hidden "
            "coordinates; give them numbers"
        )
    used = {symbol.name for term in library.terms for symbol in term.expr.free_symbols}
    for name in names:
        if not used & {name, f"{name}_dot"}:
            raise InputError(
                f"hidden names {quoted(name)}, which occurs in no candidate of L; add terms with it, such as "
                f"{name}_dot**2 and one that holds a measured coordinate, too"
            )


def refuse_prescribed(names: Sequence[str], hidden: Sequence[int], prescribed: Sequence[int]) -> None:
    """Refuse a hidden coordinate that is prescribed: its motion could not be estimated.

    Raises
    ------
    InputError
    """
    for i in hidden:
        if i in prescribed:
            raise InputError(
                f"{quoted(names[i])} is hidden and prescribed: without a sensor and without an equation "
                "its motion cannot be estimated; leave one of the two out"
            )


def anchored(trajectories: Trajectories, library: Library, hidden: Sequence[int]) -> Trajectories:
    """The trajectories; a coordinate without samples is zero at the start if candidates hold only its rate.

    The zero of such a coordinate is arbitrary. Without this choice, the normal matrix of the curve would be
    singular.
    """
    terms = (*library.terms, *library.dissipation)
    used = {symbol.name for term in terms for symbol in term.expr.free_symbols}
    cyclic = {i for i, name in enumerate(trajectories.coordinates) if name not in used}
    if not any(cyclic & {*hidden, *lacking(item)} for item in trajectories):
        return trajectories
    items: list[Trajectory] = []
    for item in trajectories:
        q = item.q.copy()
        q[0, list(cyclic & set(lacking(item)))] = 0.0
        items.append(item.changed(q=q))
    return Trajectories(items)


def lacking(item: Trajectory) -> tuple[int, ...]:
    """Coordinates without samples in a trajectory; a single one only fixes a zero, see `anchored`."""
    return tuple(np.flatnonzero(np.isfinite(item.q).sum(axis=0) <= 1).tolist())


def with_every_sensor(trajectories: Trajectories) -> Trajectories:
    """The trajectories in which every coordinate has samples; all, if there are none."""
    whole = [item for item in trajectories if not lacking(item)]
    return trajectories if len(whole) in (0, len(trajectories)) else Trajectories(whole)


def knots_of_all(measured: Knots, hidden: Sequence[int]) -> Knots:
    """Time scales of measured coordinates as those of all; the curve of a hidden one is a placeholder."""
    if not hidden:
        return measured
    smooth, count = measured.smooth, len(measured.rates) + len(hidden)
    places = [i for i in range(count) if i not in hidden]

    def widened(values: np.ndarray, fill: float) -> np.ndarray:
        out = np.full((*values.shape[:-1], count), fill)
        out[..., places] = values
        return out

    curve = replace(
        smooth,
        control_points=widened(smooth.control_points, 1.0),
        noise_std=widened(smooth.noise_std, 1.0),
        penalty=widened(smooth.penalty, 1.0),
    )
    return measured._replace(smooth=curve, rates=widened(measured.rates, float(measured.rates.mean())))
