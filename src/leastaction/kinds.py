"""What kind of value a caller or a file has given; a type checker learns it from these functions.

`isinstance` alone leaves the types of the entries unknown, and strict checking refuses what is unknown.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

__all__ = ["is_array", "is_list", "is_mapping", "is_masked"]


def is_array(value: object) -> TypeGuard[NDArray[Any]]:
    """Whether it is an array of NumPy."""
    return isinstance(value, np.ndarray)


def is_list(value: object) -> TypeGuard[Sequence[Any]]:
    """Whether it is a list or a tuple."""
    return isinstance(value, (list, tuple))


def is_mapping(value: object) -> TypeGuard[Mapping[str, Any]]:
    """Whether it is a dictionary or the like, as read from a file: its keys are text."""
    return isinstance(value, Mapping)


def is_masked(value: object) -> TypeGuard[np.ma.MaskedArray[Any, Any]]:
    """Whether it is an array of NumPy with a mask."""
    return np.ma.isMaskedArray(value)
