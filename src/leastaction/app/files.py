"""Uploads, examples and downloads of the app: checked uploads, exports, and saved sessions.

A saved session is a ZIP archive of the tables, the choices and, once there is one, the model as in
``model.json``. All of it is checked when it is read, and nothing is executed. The search is not stored.
"""

from __future__ import annotations

import gzip
import io
import json
import math
import re
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from leastaction.app.candidates import Choice
from leastaction.app.jobs import derive
from leastaction.errors import DataError, InputError
from leastaction.exporters import FORMATS
from leastaction.model import file as model_file

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
_MODEL = "model.json"
_MOST_FILES = 1000
_MOST_SAID = 1_000_000  # bytes of session.json


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


@dataclass(frozen=True, eq=False)
class Saved:
    """Content of a saved session.

    Attributes
    ----------
    title : str
    tables : mapping
        Name of a file -> its content, in the given order.
    roles : mapping
        Column -> role.
    choice : Choice
    model : LagrangianModel or None
        The model that was shown.
    searched : Choice or None
        The choices with which it was found; None if they are those of `choice`, which may change later.
    """

    title: str
    tables: Mapping[str, bytes]
    roles: Mapping[str, str]
    choice: Choice
    model: LagrangianModel | None = None
    searched: Choice | None = None


def saved(session: Saved) -> bytes:
    """A session as one file. Earlier versions read it, too, without the model."""
    said = {
        "leastaction session": _VERSION,
        "title": session.title,
        "tables": list(session.tables),
        "roles": session.roles,
        "choice": asdict(session.choice),
    }
    if session.searched not in (None, session.choice):
        said["searched"] = asdict(session.searched)
    parts = {f"tables/{name}": content for name, content in session.tables.items()}
    model = b"" if session.model is None else model_file.to_text(session.model.to_dict()).encode()
    if 0 < len(model) <= model_file.MAX_BYTES:
        parts[_MODEL] = model
    return archive({"session.json": json.dumps(said, ensure_ascii=False, indent=1).encode(), **parts})


def open_saved(content: bytes) -> Saved:
    """Read a saved session; its content is checked and never executed.

    Raises
    ------
    InputError
        If it is not a session, or a damaged one.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as file:
            return _read(file)
    except InputError as error:
        reason = str(error)
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        reason = f"an entry is missing or wrong, {type(error).__name__}: {error}"
    except (zipfile.BadZipFile, zlib.error, RuntimeError, EOFError, OSError) as error:
        reason = f"it is damaged or cut short, {type(error).__name__}: {error}"
    raise InputError(
        f"this session cannot be opened ({reason}); open another copy of the file, or the tables themselves"
    )


def _read(file: zipfile.ZipFile) -> Saved:
    parts = file.infolist()
    sizes = {part.filename: part.file_size for part in parts}
    if sum(sizes.values()) > MOST_BYTES or sizes.get("session.json", 0) > _MOST_SAID:
        raise InputError(f"it holds more than {MOST_BYTES // 1_000_000} MB when it is unpacked")
    if any(part.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for part in parts):
        raise InputError("it is compressed in an unknown way")
    said = json.loads(file.read("session.json"))
    if said["leastaction session"] != _VERSION:
        raise InputError("it is of another version")
    names = _texts(said["tables"])
    if not 0 < len({*names}) == len(names) <= _MOST_FILES:
        raise InputError("its list of tables is empty, too long, or names one twice")
    return Saved(
        str(said["title"])[:200],
        {plain_name(name): file.read(f"tables/{name}") for name in names},
        {str(column): str(role) for column, role in said["roles"].items()},
        _choice(said["choice"]),
        _model(file.read(_MODEL)) if _MODEL in sizes else None,
        _choice(said["searched"]) if "searched" in said else None,
    )


def _model(content: bytes) -> LagrangianModel:
    """A model with everything that the page shows of it, so that damaged figures are noticed at once."""
    from leastaction.model.gravity import checked_lengths
    from leastaction.model.mathml import Notation
    from leastaction.model.model import LagrangianModel
    from leastaction.report.tables import coefficient_groups

    model = LagrangianModel.from_dict(model_file.parse(content, _MODEL), _MODEL)
    checked_lengths(model.provenance.get("options", {}).get("lengths", {}), model.coordinates)
    derive(model)
    _ = (
        model.fit.statements,
        coefficient_groups(model, Notation.of_fit(model.coordinates, model.fit.findings)),
    )
    return model


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
            if not math.isfinite(value):
                raise ValueError(f"{field.name} is {value!r}")
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
