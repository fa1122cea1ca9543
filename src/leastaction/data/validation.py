"""Checks of the arrays of a trajectory: real float64 numbers, shapes, increasing times; and unwrapping."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from numbers import Integral, Real
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from leastaction.errors import InputError
from leastaction.identifiers import quoted
from leastaction.kinds import is_masked

__all__ = [
    "FloatArray",
    "check_forces",
    "check_name",
    "check_rates",
    "check_samples",
    "check_times",
    "close_match",
    "fill_names",
    "listed",
    "position_of",
    "real_array",
    "time_fault",
    "unwrap_in_place",
]

FloatArray = NDArray[np.float64]

_NOISY_STEP = 0.5  # rad from sample to sample: six times as much is pi
_TREND = 16
# A jump must exceed pi by this much; otherwise rounding could reverse a jump of exactly pi repeatedly.
_WRAP_TOLERANCE = 1e-9


def real_array(value: ArrayLike, label: str) -> FloatArray:
    """Return a C-ordered float64 copy of `value`; None and masked entries become NaN.

    Raises
    ------
    InputError
        If `value` is ragged, or holds text, complex numbers, truth values or dates.
    """
    try:
        array = np.asarray(value)
    except (ValueError, TypeError):
        raise InputError(
            f"{label} is not a rectangular array of numbers; check the lengths of its rows"
        ) from None
    if is_masked(value):
        # The data under a mask may be anything.
        array = array.astype(object)
        array[np.ma.getmaskarray(value)] = None
    if array.dtype.kind == "O":
        _check_objects(array, label)
    elif array.dtype.kind not in "iuf":
        raise InputError(
            f"{label} has type {array.dtype}; real numbers are expected{_cure(array.dtype.kind)}"
        )
    try:
        return np.array(array, dtype=np.float64, order="C")
    except (ValueError, TypeError, OverflowError):
        raise InputError(f"{label} cannot be converted to float64 numbers") from None


def check_name(name: object) -> str:
    """Return the name of a trajectory as plain text, or raise InputError if it is not text."""
    if not isinstance(name, str):
        raise InputError(f"the name of a trajectory must be text, not {quoted(name)}")
    return str(name)


def check_times(t: FloatArray, where: str) -> FloatArray:
    """Return `t`, one-dimensional, not empty, finite and strictly increasing, or raise InputError."""
    if t.ndim != 1:
        raise InputError(
            f"{where}t has shape {t.shape}; one-dimensional times of shape (n_times,) are expected"
        )
    if t.size == 0:
        raise InputError(f"{where}t is empty; a trajectory needs at least one sample")
    if not np.isfinite(t).all():
        index = int(np.flatnonzero(~np.isfinite(t))[0])
        raise InputError(f"{where}t[{index}] is {t[index]}; every time must be a finite number")
    fault = time_fault(t)
    if fault is not None:
        index, kind = fault
        if kind == "repeated":
            what, cure = "repeats the previous time", "keep one sample per time"
        else:
            what = f"goes backwards from t[{index - 1}] = {float(t[index - 1])!r}"
            cure = "sort the samples, or make separate trajectories of separate runs"
        raise InputError(f"{where}t[{index}] = {float(t[index])!r} {what}; times must increase: {cure}")
    return t


def check_samples(q: FloatArray, n_times: int, where: str) -> FloatArray:
    """Return `q` with shape (n_times, n_dof), no value infinite, or raise InputError."""
    q = _check_matrix(q, n_times, f"{where}q")
    bad = np.argwhere(np.isinf(q))
    if bad.size:
        row, column = bad[0]
        raise InputError(f"{where}q[{row}, {column}] is infinite; use NaN for a missing sample")
    return q


def _check_matrix(q: FloatArray, n_times: int, label: str) -> FloatArray:
    if q.ndim == 1:
        q = q[:, np.newaxis]
    if q.ndim != 2:
        raise InputError(
            f"{label} has shape {q.shape}; (n_times, n_dof) is expected: make one Trajectory of each trial"
        )
    if q.shape[0] != n_times:
        transposed = "; it looks transposed: pass its transpose" if q.shape[1] == n_times else ""
        raise InputError(
            f"{label} has {q.shape[0]} rows, but t has {n_times} times; they must be equal{transposed}"
        )
    if q.shape[1] == 0:
        raise InputError(f"{label} has no columns; at least one coordinate is needed")
    return q


def check_forces(forces: FloatArray, shape: tuple[int, ...], where: str) -> FloatArray:
    """Return `forces` with the given shape (n_times, n_dof) and all finite, or raise InputError."""
    forces = _check_matrix(forces, shape[0], f"{where}forces")
    if forces.shape != shape:
        raise InputError(
            f"{where}forces has {forces.shape[1]} column(s), but q has {shape[1]}; "
            "give one column for each coordinate, with zeros where a coordinate is not driven"
        )
    bad = np.argwhere(~np.isfinite(forces))
    if bad.size:
        row, column = bad[0]
        raise InputError(
            f"{where}forces[{row}, {column}] is {forces[row, column]}; forces must be finite "
            "(zero where a coordinate is not driven)"
        )
    return forces


def check_rates(rates: FloatArray, shape: tuple[int, ...], label: str) -> FloatArray:
    """Return velocities or accelerations with the given shape, none infinite, or raise InputError."""
    rates = _check_matrix(rates, shape[0], label)
    if rates.shape != shape:
        raise InputError(
            f"{label} has {rates.shape[1]} column(s), but q has {shape[1]}; "
            "give one column for each coordinate, with NaN where nothing is measured"
        )
    bad = np.argwhere(np.isinf(rates))
    if bad.size:
        row, column = bad[0]
        raise InputError(f"{label}[{row}, {column}] is infinite; use NaN for a missing sample")
    return rates


def time_fault(t: FloatArray) -> tuple[int, str] | None:
    """Return index and kind ("repeated" or "backwards") of the first time that does not increase."""
    bad = np.flatnonzero(t[1:] <= t[:-1])
    if not bad.size:
        return None
    index = int(bad[0]) + 1
    return index, "repeated" if t[index] == t[index - 1] else "backwards"


def listed(names: Iterable[str], limit: int = 20) -> str:
    """Return the names as one line, quoted if needed; at most `limit` of them."""
    every = list(names)
    shown = [name if name.isidentifier() and len(name) <= 40 else quoted(name) for name in every[:limit]]
    return ", ".join(shown) + (f", ... ({len(every)} in all)" if len(every) > limit else "")


def close_match(name: str, names: Sequence[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the name most like `name`, or an empty string."""
    folded = {other.casefold(): other for other in reversed(names)}
    close = get_close_matches(name.casefold(), list(folded), n=1)
    return f"; did you mean {quoted(folded[close[0]])}?" if close else ""


def fill_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names with a number, from 0, for each empty one; raise InputError if one occurs twice."""
    taken: set[str] = set()
    for name in filter(None, names):
        if name in taken:
            raise InputError(f"two trajectories are called {quoted(name)}; give each its own name")
        taken.add(name)
    filled: list[str] = []
    for position, name in enumerate(names):
        if not name:
            name = str(position)
            while name in taken:
                name += "'"
            taken.add(name)
        filled.append(name)
    return tuple(filled)


def position_of(key: object, names: Sequence[str]) -> int:
    """Return the position of a trajectory given by name or number, or raise InputError."""
    if isinstance(key, str):
        if key in names:
            return names.index(key)
        known = f"there are {listed(names)}{close_match(key, names)}"
        raise InputError(f"no trajectory is called {quoted(key)}; {known}")
    if not isinstance(key, bool) and isinstance(key, Integral):
        if -len(names) <= int(key) < len(names):
            return int(key) % len(names)
        raise InputError(f"there is no trajectory number {key}; there are {len(names)}, counted from 0")
    raise InputError(f"select trajectories by name or number, not by {quoted(key)}")


def unwrap_in_place(angle: FloatArray) -> int:
    """Unwrap one coordinate in place and return the number of jumps removed."""
    valid = np.flatnonzero(np.isfinite(angle))
    if valid.size < 2:
        return 0
    samples = angle[valid]
    jumps = np.diff(samples)
    # The rounding error of large angles is included; otherwise a second call could find a jump of pi again.
    limit = np.pi + _WRAP_TOLERANCE + 16 * np.finfo(np.float64).eps * np.abs(samples).max()
    turns = np.where(np.abs(jumps) > limit, np.round(jumps / (2 * np.pi)), 0.0)
    wrapped = jumps - 2 * np.pi * np.round(jumps / (2 * np.pi))
    # steps of white noise, from their differences: a fast rotation is not noise
    noise = (
        1.4826 * float(np.median(np.abs(np.diff(wrapped)))) / np.sqrt(3.0) if wrapped.size > _TREND else 0.0
    )
    if noise > _NOISY_STEP and turns.any():
        if np.ptp(samples) > 2 * np.pi * (1 + 1e-9):  # a wrapped angle stays within one turn
            return 0
        turns = np.diff(_turns_from_trend(samples), prepend=0.0)[1:]
    samples[1:] -= 2 * np.pi * np.cumsum(turns)
    angle[valid] = samples
    return int(np.count_nonzero(turns))


def _turns_from_trend(samples: FloatArray) -> FloatArray:
    """Turns to subtract from each sample so that it is nearest to the trend of the previous samples.

    Noise of more than half a radian causes steps of more than pi by itself, which would accumulate.
    """
    turns = np.zeros(samples.size)
    past = np.full(_TREND, samples[0])
    for k in range(1, samples.size):
        half = min(k, _TREND) // 2
        recent = past[-half:].mean() if half else past[-1]
        before = past[-2 * half : -half].mean() if half else recent
        predicted = recent + (0.5 * (half + 1) / half * (recent - before) if half > 2 else 0.0)
        turns[k] = np.round((samples[k] - predicted) / (2 * np.pi))
        past[:-1] = past[1:]
        past[-1] = samples[k] - 2 * np.pi * turns[k]
    return turns


def _check_objects(array: NDArray[np.object_], label: str) -> None:
    for index, item in np.ndenumerate(array):
        if item is not None and (isinstance(item, bool) or not isinstance(item, Real)):
            place = ", ".join(map(str, index))
            raise InputError(f"{label}[{place}] is {quoted(item)}; a real number is expected")


def _cure(kind: str) -> str:
    if kind in "mM":
        return ", times in seconds"
    return ": convert text to numbers first" if kind in "US" else ""


def plain_bytes(array: np.ndarray) -> bytes:
    """Bytes with a single bit pattern each for NaN and zero, so that equal data have equal bytes."""
    plain = np.where(np.isnan(array), np.nan, array + 0.0)
    return np.ascontiguousarray(plain, dtype="<f8").tobytes()


_TO_HOLD_OUT = "give how many of the last ones (2), a share ('20%'), or names ('a,b')"


def share_held_out(given: object) -> float | None:
    """Return the share of ``"20%"``; None if it is not a share.

    Examples
    --------
    >>> share_held_out("20%"), share_held_out("a,b")
    (0.2, None)
    """
    if not isinstance(given, str) or not given.strip().endswith("%"):
        return None
    try:
        share = float(given.strip()[:-1]) / 100.0
    except ValueError:
        return None
    if not 0.0 < share < 1.0:
        raise InputError(f"{quoted(given)} is not a share; give more than 0% and less than 100%, e.g. '20%'")
    return share


def rows_held_out(t: FloatArray, share: float) -> NDArray[np.bool_]:
    """Return a mask of the samples in the last share of the time.

    Examples
    --------
    >>> rows_held_out(np.arange(5.0), 0.5).tolist()
    [False, False, False, True, True]
    """
    late = t > t[-1] - share * (t[-1] - t[0])
    if late.sum() < 2 or (~late).sum() < 2:
        raise InputError(f"{100 * share:g} % of {t.size} samples leave too few on one side")
    return late


def names_held_out(given: object, share: float | None, names: Sequence[str]) -> list[str]:
    """Return the names of the trajectories to hold out; at least one must remain.

    Examples
    --------
    >>> [names_held_out(given, None, ["a", "b", "7"]) for given in (1, "2", "a, b", "7,", ["7"])]
    [['7'], ['b', '7'], ['a', 'b'], ['7'], ['7']]
    >>> names_held_out("60%", 0.6, ["a", "b", "c"])
    ['b', 'c']
    """
    text = given.strip() if isinstance(given, str) else ""
    if share is not None:
        given = min(max(round(share * len(names)), 1), len(names) - 1)
    elif text.isascii() and text.isdigit():
        given = int(text[:9])
    if not isinstance(given, bool) and isinstance(given, Integral):
        count = int(given)
        if not 0 < count < len(names):
            raise InputError(
                f"{count} of {len(names)} trajectories; hold out at least 1 and leave at least 1 to fit"
            )
        return list(names[len(names) - count :])
    if isinstance(given, str):
        given = [part.strip() for part in text.removesuffix(",").split(",")]
    if isinstance(given, bytes) or not isinstance(given, Iterable):
        raise InputError(f"{quoted(given)} cannot be held out; {_TO_HOLD_OUT}")
    held = [names[position_of(key, names)] for key in cast("Iterable[object]", given)]
    if set(held) >= set(names):
        raise InputError("all trajectories are held out; leave at least 1 to fit")
    return held
