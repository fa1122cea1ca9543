"""Output that is complete or not there: checked before the work begins, moved into place at its end."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from leastaction.cli.text import shown
from leastaction.errors import InputError

__all__ = ["check_file", "check_folder", "write_together"]


def check_folder(path: str, names: tuple[str, ...] = ()) -> Path:
    """Return the path of a directory to write `names` into, if that can work; nothing is made yet.

    Raises
    ------
    InputError
        If it is a file, or cannot be written to.
    """
    folder = _checked(path)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{shown(path)} is a file; give a directory for the output")
    _check_writable(folder, path)
    for name in names:
        if (folder / name).is_dir():
            raise InputError(f"{shown(folder / name)} is a directory; remove it or choose another --output")
    return folder


def check_file(path: str) -> Path:
    """Return the path of a file to write, if that can work.

    Raises
    ------
    InputError
        If it is a directory, or cannot be written.
    """
    file = _checked(path)
    if file.is_dir():
        raise InputError(f"{shown(path)} is a directory; give the path of a file to write")
    if file.exists() and not os.access(file, os.W_OK):
        raise InputError(f"{shown(path)} is write-protected; choose another file")
    if not file.exists() or file.is_file():
        _check_writable(file.resolve().parent, path)
    return file


def write_together(folder: Path, writers: Mapping[str, Callable[[Path], object]]) -> None:
    """Write files into a directory so that all of them appear, or none.

    Parameters
    ----------
    folder : Path
        Made if it is missing, and removed again if the writing fails.
    writers : mapping
        Name of a file -> function that writes it to the path given.
    """
    missing = [p for p in (folder, *folder.parents) if not p.exists()]
    try:
        temporary = folder / f".leastaction-{secrets.token_hex(6)}.tmp"
        with _named(folder):
            temporary.mkdir(parents=True)
        try:
            for name, write in writers.items():
                write(temporary / name)
            with _named(folder):
                for name in writers:
                    os.replace(temporary / name, folder / name)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    except BaseException:
        for path in missing:
            with suppress(OSError):
                path.rmdir()
        raise


@contextmanager
def _named(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{shown(folder)} cannot be written: {reason}; choose another --output") from None


def _checked(path: str) -> Path:
    if not path or "\0" in path:
        raise InputError("the output path is empty; give the path to write to")
    return Path(path)


def _check_writable(folder: Path, path: str) -> None:
    """Look at the nearest directory that exists."""
    try:
        place = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    except OSError as error:
        raise InputError(f"{shown(path)} cannot be written: {error.strerror}; choose another place") from None
    if not place.is_dir():
        raise InputError(f"{shown(path)} cannot be written: {shown(place)} is a file; choose another place")
    if not os.access(place, os.W_OK | os.X_OK):
        raise InputError(
            f"{shown(path)} cannot be written: no right to write to {shown(place)}; choose another place"
        )
