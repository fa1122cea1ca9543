"""Values that pass between processes as files of a temporary folder."""

from __future__ import annotations

import itertools
import pickle
import weakref
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any

import numpy as np

__all__ = ["Folder", "Held", "Shelf", "opened", "read", "write"]


@dataclass(frozen=True, eq=False)
class Held:
    """A value that many tasks take. It is sent as the name of a file, in a tenth of the time.

    Attributes
    ----------
    value : object
    path : Path
        Of the file.
    """

    value: Any
    path: Path

    @classmethod
    def write(cls, value: Any, path: Path) -> Held:
        """Write the file."""
        write(value, path)
        held = cls(value, path)
        weakref.finalize(held, path.unlink, missing_ok=True)
        return held

    def __reduce__(self) -> tuple[Any, ...]:
        return read, (self.path,)  # the receiver gets the value itself


class Folder:
    """A temporary folder, made with its first file and removed with this value or when it is closed."""

    def __init__(self) -> None:
        self._names = itertools.count()
        self._path: Path | None = None
        self._remove: weakref.finalize[..., Any] | None = None

    def new_path(self) -> Path:
        """A name that no other file of the folder has."""
        if self._path is None:
            self._path = Path(mkdtemp(prefix="leastaction-"))
            self._remove = weakref.finalize(self, rmtree, self._path, ignore_errors=True)
        return self._path / str(next(self._names))

    def close(self) -> None:
        """Remove it with its files."""
        if self._remove is not None:
            self._remove()
        self._path = self._remove = None


@dataclass(frozen=True, eq=False)
class Shelf:
    """A file for an array that a task computes in any process and that this process may read.

    Attributes
    ----------
    path : Path
    """

    path: Path

    @classmethod
    def of(cls, path: Path) -> Shelf:
        """A shelf whose file is removed with it; copies in other processes remove nothing."""
        shelf = cls(path)
        weakref.finalize(shelf, path.unlink, missing_ok=True)
        return shelf

    def put(self, array: np.ndarray) -> bool:
        """Write the array; False where the disk is full."""
        try:
            with self.path.open("wb") as file:
                np.save(file, array, allow_pickle=False)
        except OSError:
            return False
        return True

    def array(self) -> np.ndarray:
        """The array in the file."""
        return np.load(self.path, allow_pickle=False)


def opened(value: Any) -> Any:
    """The value itself; in another process it has been unpickled already."""
    return value.value if isinstance(value, Held) else value


def write(value: Any, path: Path) -> None:
    """Write any value."""
    with path.open("wb") as file:
        pickle.dump(value, file, pickle.HIGHEST_PROTOCOL)


def read(path: Path) -> Any:
    """Read a value that this program has written in its own folder."""
    with path.open("rb") as file:
        return pickle.load(file)
