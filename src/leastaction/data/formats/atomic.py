"""Atomic writing: a file is either unchanged or complete."""

from __future__ import annotations

import os
import secrets
import shutil
from contextlib import suppress
from pathlib import Path

from leastaction.errors import InputError
from leastaction.identifiers import quoted

__all__ = ["StrPath", "check_path", "read_bytes", "replace_file", "write_bytes", "write_text"]

StrPath = str | os.PathLike[str]


def check_path(path: str | bytes | os.PathLike[str] | os.PathLike[bytes]) -> Path:
    """Return `path` as a Path, or raise InputError if it is not a path."""
    try:
        text = os.fspath(path)
    except TypeError:
        raise InputError(f"a path is expected, not {quoted(path)}") from None
    if not isinstance(text, str) or not text or "\0" in text:
        raise InputError(f"{quoted(text)} is not the path of a file")
    return Path(text)


def read_bytes(path: Path, n_bytes: int = -1) -> bytes:
    """Return the content of a file, or its first `n_bytes`; a missing or empty file is an InputError."""
    try:
        with path.open("rb") as file:
            data = file.read(n_bytes)
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; check the path") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a directory; give the path of a file in it") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from None
    if not data:
        raise InputError(f"{path} is empty; a file with data is expected")
    return data


def replace_file(path: Path, data: bytes) -> None:
    """Write `data` to a new file beside `path` and move it there in one step.

    Missing directories are created. If `path` is a link, its target is replaced. A path that is not a regular
    file, such as ``/dev/stdout``, is written directly.

    Raises
    ------
    InputError
        If the file cannot be written; the old one is then untouched.
    """
    try:
        target = Path(os.path.realpath(path))
        if target.exists() and not target.is_file():
            if target.is_dir():
                raise InputError(f"{path} is a directory; give the path of a file to write")
            with target.open("wb") as stream:
                stream.write(data)
            return
        target.parent.mkdir(parents=True, exist_ok=True)
        _write_beside(target, data)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            f"{path} cannot be written: {reason}; choose another place or free this one"
        ) from None


def write_text(path: str | os.PathLike[str], text: str) -> Path:
    """Write text to a file as UTF-8, all or nothing; see `write_bytes`.

    Parameters
    ----------
    path : path
        File to write.
    text : str
        Its content; line ends are written as they are.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    InputError
        If the file cannot be written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     write_text(f"{folder}/new/note.txt", "hello").read_text()
    'hello'
    """
    return write_bytes(path, text.encode("utf-8"))


def write_bytes(path: str | os.PathLike[str], data: bytes) -> Path:
    """Write a file all or nothing: under another name in the same directory, then move it into place.

    Parameters
    ----------
    path : path
        File to write, replaced in one step if it exists. Missing directories are created.
    data : bytes
        Its content.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    InputError
        If the file cannot be written. An existing file is then unchanged.
    """
    target = check_path(path)
    replace_file(target, data)
    return target


def _write_beside(target: Path, data: bytes) -> None:
    temporary = target.with_name(f".{target.name[:100]}.{secrets.token_hex(6)}.tmp")
    # 0o666 less the umask, as for any new file; the tempfile module would make it private.
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if target.exists():
            if not os.access(target, os.W_OK):
                raise PermissionError(None, "the file is write-protected")
            shutil.copymode(target, temporary)
        os.replace(temporary, target)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise
