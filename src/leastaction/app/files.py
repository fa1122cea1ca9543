"""Uploads, examples and downloads of the app: checked uploads, exports, and saved sessions.

A saved session is a ZIP archive of the tables and the choices. It contains no results, because loading them
would execute content of a file. They are computed again from the same choices.
"""

from __future__ import annotations

import gzip
import io
import json
import re
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from leastaction.app.candidates import Choice
from leastaction.errors import DataError, InputError
from leastaction.exporters import FORMATS

if TYPE_CHECKING:
    from leastaction import LagrangianModel

__all__ = [
    "ENDINGS",
    "EXAMPLES",
    "MOST_BYTES",
    "SESSION",
    "SUFFIXES",
    "Saved",
    "archive",
    "by_number",
    "check_size",
    "everything",
    "exported",
    "kind_of",
    "open_saved",
    "plain_name",
    "saved",
    "title_of",
]

MOST_BYTES = 200_000_000
"""Largest upload, and largest table inside a compressed one."""
SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".xlsx", ".csv.gz", ".tsv.gz", ".txt.gz", ".dat.gz")
SESSION = ".leastaction"
"""Suffix of a saved session."""
ENDINGS = {
    "sympy": "_sympy.py",
    "latex": ".tex",
    "python": ".py",
    "c": ".c",
    "casadi": "_casadi.py",
    "jax": "_jax.py",
    "julia": ".jl",
    "modelica": ".mo",
    "mjcf": "_mjcf.xml",
    "urdf": ".urdf",
    "matlab": ".m",
    "fmu2": "_fmi2.fmu",
    "fmu3": "_fmi3.fmu",
}
"""Format of an export -> suffix of its file."""
EXAMPLES = {
    "single": (
        "Single pendulum",
        "4 trials of 9.2 s, one angle; swings freely: dry friction, and an encoder whose zero is 1 mrad off",
    ),
    "double": (
        "Double pendulum",
        "26 trials of 2.7 s, two angles; dry friction in the first joint, which the published model lacks",
    ),
}
"""Name of a measured example -> its title and description."""
_VERSION = 1
_MOST_FILES = 1000
_MOST_SAID = 100_000  # bytes of session.json


def exported(model: LagrangianModel, format: str) -> tuple[str, bytes]:
    """Name and content of an export.

    Raises
    ------
    InputError
        If a requirement of the format is missing, such as a C compiler.
    """
    import leastaction as la

    content = la.export(model, format)
    return f"leastaction_model{ENDINGS[format]}", content.encode() if isinstance(content, str) else content


def everything(model: LagrangianModel, more: Mapping[str, str]) -> bytes:
    """A ZIP archive of every export, of `more` texts by name, and of a list of the contents."""
    members = {name: text.encode() for name, text in more.items()}
    lines = ["Written by leastaction: one model, for several programs.", ""]
    for format, what in FORMATS.items():
        try:
            name, content = exported(model, format)
        except (InputError, DataError) as error:
            lines.append(f"{format}: left out, {error}")
        else:
            members[name] = content
            lines.append(f"{name}: {what}")
    return archive({**members, "README.txt": ("\n".join(lines) + "\n").encode()})


def archive(members: Mapping[str, bytes]) -> bytes:
    """A ZIP archive of files by name."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return out.getvalue()


class Saved:
    """Content of a saved session.

    Attributes
    ----------
    title : str
    tables : dict
        Name of a file -> its content, in the given order.
    roles : dict
        Column -> role.
    choice : Choice
    """

    def __init__(
        self, title: str, tables: Mapping[str, bytes], roles: Mapping[str, str], choice: Choice
    ) -> None:
        self.title, self.tables, self.roles, self.choice = title, dict(tables), dict(roles), choice


def saved(session: Saved) -> bytes:
    """A session as one file."""
    said = {
        "leastaction session": _VERSION,
        "title": session.title,
        "tables": list(session.tables),
        "roles": session.roles,
        "choice": asdict(session.choice),
    }
    tables = {f"tables/{name}": content for name, content in session.tables.items()}
    return archive({"session.json": json.dumps(said, ensure_ascii=False, indent=1).encode(), **tables})


def open_saved(content: bytes) -> Saved:
    """Read a saved session; its content is checked and never executed.

    Raises
    ------
    InputError
        If it is not a session, or a damaged one.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as file:
            sizes = {part.filename: part.file_size for part in file.infolist()}
            if sum(sizes.values()) > MOST_BYTES or sizes.get("session.json", 0) > _MOST_SAID:
                raise InputError(
                    f"this session holds more than {MOST_BYTES // 1_000_000} MB when it is unpacked"
                )
            said = json.loads(file.read("session.json"))
            names = _texts(said["tables"])
            tables = {plain_name(name): file.read(f"tables/{name}") for name in names}
            roles = {str(column): str(role) for column, role in said["roles"].items()}
            if said["leastaction session"] != _VERSION or not names or len(names) > _MOST_FILES:
                raise ValueError("of another version")
            return Saved(str(said["title"])[:200], tables, roles, _choice(said["choice"]))
    except (zipfile.BadZipFile, KeyError, TypeError, ValueError, AttributeError, zlib.error) as error:
        raise InputError(f"this session cannot be opened ({type(error).__name__}: {error})") from None


def _choice(said: Mapping[str, Any]) -> Choice:
    """The choices, each checked against the type of its default."""
    default, out = Choice(), {}
    for field in fields(Choice):
        like = getattr(default, field.name)
        value = said.get(field.name, like)  # sessions of earlier versions have fewer entries
        if isinstance(like, list):
            value = _texts(value)
        elif isinstance(like, float):
            value = float(value)
        elif type(value) is not type(like):
            raise ValueError(f"{field.name} is {value!r}")
        out[field.name] = value
    return Choice(**out)


def _texts(value: Any) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise ValueError(f"{str(value)[:40]!r} is not a list of texts")
    return value


def plain_name(name: str) -> str:
    r"""A safe file name: the given one without folders, and without characters that a system may refuse.

    Examples
    --------
    >>> plain_name("C:\\data\\swing (2).csv"), plain_name("../../etc/a<b>?.csv"), plain_name("..")
    ('swing (2).csv', 'a_b__.csv', 'table')
    """
    last = name.replace("\\", "/").rstrip("/").rpartition("/")[2]
    safe = "".join(c if c.isprintable() and c not in '<>:"|?*' else "_" for c in last)
    return safe.strip("._ ")[:60].rstrip(". ") or "table"


def title_of(paths: Sequence[Path]) -> str:
    """Name of a table, or of the first of several.

    Examples
    --------
    >>> title_of([Path("a.csv")]), title_of([Path("a.csv"), Path("b.csv")])
    ('a.csv', 'a.csv and 1 more')
    """
    first, *others = paths
    return f"{first.name} and {len(others)} more" if others else first.name


def by_number(name: str) -> list[tuple[int, str]]:
    """Sort key that places run2 before run10.

    Examples
    --------
    >>> sorted(["run10.csv", "run2.csv"], key=by_number)
    ['run2.csv', 'run10.csv']
    """
    parts = re.split(r"(\d+)", plain_name(name))
    return [(int(part), "") if part.isdecimal() else (0, part) for part in parts]


def kind_of(name: str) -> str:
    """The suffix of a table that can be read.

    Raises
    ------
    InputError
        If it is of another kind.
    """
    suffix = next((s for s in sorted(SUFFIXES, key=len, reverse=True) if name.lower().endswith(s)), None)
    if suffix is None:
        raise InputError(f"{plain_name(name)} is not a table; give a file with one of {', '.join(SUFFIXES)}")
    return suffix


def check_size(name: str, content: bytes) -> None:
    """Refuse files that are too large, also after unpacking.

    Raises
    ------
    InputError
    """
    limit = f"{MOST_BYTES // 1_000_000} MB"
    if len(content) > MOST_BYTES:
        raise InputError(
            f"{plain_name(name)} is larger than {limit}; leave out columns or use the command line"
        )
    measures: Sequence[tuple[bytes, Callable[[bytes], int]]] = (
        (b"PK", _size_of_workbook),
        (b"\x1f\x8b", _size_of_gzip),
    )
    for mark, measure in measures:
        if content[:2] == mark and measure(content) > MOST_BYTES:
            raise InputError(
                f"{plain_name(name)} holds more than {limit} when it is unpacked; use the command line"
            )


def _size_of_gzip(content: bytes) -> int:
    total = 0
    try:
        with gzip.open(io.BytesIO(content)) as stream:
            while total <= MOST_BYTES and (chunk := stream.read(1 << 20)):
                total += len(chunk)
    except (OSError, EOFError, zlib.error):
        return 0  # damaged: the reader says so
    return total


def _size_of_workbook(content: bytes) -> int:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as book:
            return sum(part.file_size for part in book.infolist())
    except zipfile.BadZipFile:
        return 0  # damaged: the reader says so
