"""The two errors that leastaction raises on purpose; both are ``ValueError``."""

from __future__ import annotations

__all__ = ["DataError", "InputError"]


class InputError(ValueError):
    """Wrong use or bad input: the text names the value, what was expected and the cure."""


class DataError(ValueError):
    """The input is well formed, but the data cannot support any model; the text says why."""
