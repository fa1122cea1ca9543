"""The errors that leastaction raises on purpose; all are ``ValueError``. And one that users may raise."""

from __future__ import annotations

__all__ = ["DataError", "DataWarning", "InputError", "MissingPackageError", "StopSearch"]


class InputError(ValueError):
    """Wrong use or bad input. The message names the value, what was expected, and the cure."""


class DataError(ValueError):
    """The input is well formed, but the data cannot support any model. The message says why."""


class DataWarning(UserWarning):
    """Something was done to the data on the user's behalf; the text says what."""


class StopSearch(Exception):
    """Raise this in the ``progress`` function of `discover` to end the search with the best law so far.

    Examples
    --------
    >>> import time, leastaction as la
    >>> began = time.monotonic()
    >>> def progress(stage, details):
    ...     if time.monotonic() > began + 60.0:
    ...         raise la.StopSearch
    """

    fit: object = None  # what the search had found when it was stopped, where only its caller knows


class MissingPackageError(InputError, ImportError):
    """A package is not installed that only some uses need; the text says how to install it.

    Parameters
    ----------
    use : str
        What was asked for.
    package, extra : str
        The package, and the extra of leastaction that brings it.
    instead : str
        What would do without the package.
    """

    def __init__(self, use: str, package: str, extra: str, instead: str = "") -> None:
        other = f", or {instead}" if instead else ""
        super().__init__(f"{use} needs {package}; install it with: pip install 'leastaction[{extra}]'{other}")

    def __reduce__(self) -> tuple[type[InputError], tuple[object, ...]]:
        # As InputError: the text is all there is, and unpickling must not ask for the four parts.
        return (InputError, self.args)
