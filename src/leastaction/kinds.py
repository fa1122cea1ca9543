"""What kind of value a caller or a file has given; a type checker learns it from these functions.

`isinstance` alone leaves the types of the entries unknown, and strict checking refuses what is unknown.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

__all__ = ["is_array", "is_collection", "is_list", "is_mapping", "is_masked", "is_number", "is_scalar"]


def is_array(value: object) -> TypeGuard[NDArray[Any]]:
    """Whether it is an array of NumPy."""
    return isinstance(value, np.ndarray)


def is_list(value: object) -> TypeGuard[Sequence[Any]]:
    """Whether it is a list or a tuple."""
    return isinstance(value, (list, tuple))


def is_collection(value: object) -> TypeGuard[Collection[Any]]:
    """Whether it is a list, a tuple or a set."""
    return isinstance(value, (list, tuple, set, frozenset))


def is_mapping(value: object) -> TypeGuard[Mapping[Any, Any]]:
    """Whether it is a dictionary or the like."""
    return isinstance(value, Mapping)


def is_number(value: object) -> TypeGuard[float]:
    """Whether it is a real number of Python or NumPy; truth values are none."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def is_scalar(value: object) -> TypeGuard[np.generic[Any]]:
    """Whether it is a scalar of NumPy."""
    return isinstance(value, np.generic)


def is_masked(value: object) -> TypeGuard[np.ma.MaskedArray[Any, Any]]:
    """Whether it is an array of NumPy with a mask."""
    return np.ma.isMaskedArray(value)
