"""Records of runs, one JSON document a line, one file a part (``<folder>/<part>.jsonl``) or one in all.

A record is added at the end of its file by one write that is forced to the disk. A runner that is killed
loses only the runs under way: an unfinished last line, which has no newline, is dropped. Each start and each
end of a runner sorts the lines by the names of their cases and writes the file anew, all or nothing. The last
of several lines of one case holds.

Adding and sorting lock the file, so that any number of runners may share a folder: none loses a record of
another, but they may make the same run twice. Without ``flock`` (Windows), use one runner at a time.
"""

from __future__ import annotations

import errno
import json
import math
import os
import sys
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Protocol, TypeVar

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

import leastaction as la
from leastaction import InputError

__all__ = ["Case", "RecordError", "Store", "carry_out", "open_cases", "say", "to_line"]

try:
    import fcntl
except ImportError:
    fcntl = None


class RecordError(ValueError):
    """A file or a line is not the record of a run."""


class Case(Protocol):
    """One run: its name, which no other run of the folder has, and the part that it belongs to."""

    @property
    def key(self) -> str: ...

    @property
    def part(self) -> str: ...


def _say(text: str) -> None:
    print(text, file=sys.stderr)


@dataclass(frozen=True)
class Store:
    """The records of a folder.

    Attributes
    ----------
    folder : Path
    case : callable
        ``case(config)`` returns the case of a record's configuration.
    say : callable
        Is given the message that an unfinished line has been left out.
    single : str
        Name of the one file that holds all parts, without its ending; "": each part has a file of its own.
    """

    folder: Path
    case: Callable[[Mapping], Case]
    say: Callable[[str], object] = _say
    single: str = ""

    def path(self, part: str) -> Path:
        """Return the file to which records of a part are added."""
        return self.folder / f"{self.single or part}.jsonl"

    def key(self, record: Mapping) -> str:
        return self.case(record["config"]).key

    def _part(self, record: Mapping) -> str:
        return self.case(record["config"]).part

    def read(self, *parts: str) -> list[dict]:
        """Return the records of these parts, by default of all, sorted by the names of their cases.

        Folders of former layouts are read too: one ``<key>.json`` a run; with `single`, one file a part. A
        line comes before such a file, and a line of the one file before the others.

        Raises
        ------
        RecordError
            Names a file, and its line, that is not the record of a run.
        """
        found = {}
        for path in self._former(parts):
            key, record = self._parsed(path.read_bytes(), str(path))
            found[key] = record
        for path in self._files(parts):
            found |= {key: record for key, record, _ in self._lines(path, "is left out")}
        return [found[key] for key in sorted(found) if not parts or self._part(found[key]) in parts]

    def append(self, record: Mapping) -> None:
        """Add a record; it is on the disk when this returns."""
        path = self.path(self._part(record))
        line = to_line(record).encode() + b"\n"
        path.parent.mkdir(parents=True, exist_ok=True)
        with _locked(path), path.open("r+b", buffering=0) as file:
            self._drop_unfinished(file, path)
            end = file.seek(0, os.SEEK_END)
            try:
                if file.write(line) != len(line):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
                os.fsync(file.fileno())
            except OSError:
                file.truncate(end)
                raise

    def tidy(self, *parts: str) -> None:
        """Sort the files of these parts and drop unfinished lines and those that a later one replaces."""
        for path in dict.fromkeys(map(self.path, parts)):
            if not path.exists():
                continue
            with _locked(path):
                lines = {
                    key: line for key, _, line in self._lines(path, "is dropped; that run is made again")
                }
                text = b"".join(lines[key] + b"\n" for key in sorted(lines))
                for left in self.folder.glob(
                    f".{path.name}.*.tmp"
                ):  # by one that was killed in the next line
                    left.unlink()
                if text != path.read_bytes():
                    la.io.write_text(path, text.decode())

    def _files(self, parts: tuple[str, ...]) -> list[Path]:
        """Files of lines that are there; the one of all parts is the last, because a later line holds."""
        paths = {self.folder / f"{part}.jsonl" for part in parts} or set(self.folder.glob("*.jsonl"))
        paths |= {self.path(self.single)} if self.single else set()
        return sorted(
            (path for path in paths if path.exists()), key=lambda path: (path.stem == self.single, path)
        )

    def _former(self, parts: tuple[str, ...]) -> list[Path]:
        """Files of single records: ``<key>.json``, where the key begins with the part."""
        patterns = [f"{part}{rest}.json" for part in parts for rest in ("-*", "/*/*")] or [
            "*.json",
            "*/*/*.json",
        ]
        return sorted(path for pattern in patterns for path in self.folder.glob(pattern))

    def _lines(self, path: Path, what: str) -> Iterator[tuple[str, dict, bytes]]:
        """Yield key, record and text of every line; say `what` happens to an unfinished last one."""
        *whole, rest = path.read_bytes().split(b"\n")
        for number, line in enumerate(whole, 1):
            yield *self._parsed(line, f"{path}, line {number},"), line
        if rest:
            self.say(f"{path}: its last line is unfinished and {what}")

    def _parsed(self, text: bytes, place: str) -> tuple[str, dict]:
        try:
            record = json.loads(text)
            key, _ = self.key(record), record["result"]["finished"]
        except (ValueError, KeyError, TypeError) as error:
            raise RecordError(
                f"{place} is not the record of a run: {error!r}; remove it and run again"
            ) from None
        return key, record

    def _drop_unfinished(self, file: BinaryIO, path: Path) -> None:
        """Cut off what a runner that was killed while it wrote has left."""
        size = file.seek(0, os.SEEK_END)
        if not size:
            return
        file.seek(size - 1)
        if file.read(1) != b"\n":
            file.truncate(path.read_bytes().rfind(b"\n") + 1)
            self.say(f"{path}: its last line is unfinished and is dropped; that run is made again")


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Keep others from changing the file, which is made if it is not there."""
    if fcntl is None:
        path.touch()
        yield
        return
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            if _is_at(descriptor, path):  # else another has sorted it while this one waited: begin anew
                yield
                return
        finally:
            os.close(descriptor)


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def to_line(document: Mapping) -> str:
    """JSON text without line breaks; numbers that are not finite become null.

    The sequence of names is kept: that of a model's terms has a meaning.
    """
    return json.dumps(_plain(document), ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def _plain(value):
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if hasattr(value, "tolist"):  # NumPy arrays and scalars
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, (str, int, float, bool, type(None))) else str(value)


# --------------------------- from cases to records: what is done already, what is run, and what is said of it
C = TypeVar("C", bound=Case)
Outcomes = Generator[tuple[C, dict], None, None]  # a case and its record


def say(console: Console, text: str) -> None:
    """Print a line as it is: without colours, in one piece."""
    console.print(text, markup=False, highlight=False, soft_wrap=True)


def open_cases(cases: Sequence[C], store: Store, retry_failed: bool = False) -> list[C]:
    """Return the cases without a record, or, if wished, also those whose record is of a failure."""
    parts = dict.fromkeys(case.part for case in cases)
    records = store.read(*parts) if parts else []
    done = {store.key(r) for r in records if r["result"]["finished"] or not retry_failed}
    return [case for case in cases if case.key not in done]


def carry_out(
    cases: Sequence[C],
    store: Store,
    outcomes: Callable[[list[C]], Outcomes],
    line: Callable[[C, dict], str],
    console: Console,
    retry_failed: bool = False,
    dry_run: bool = False,
) -> list[dict]:
    """Run the cases that are open, keep their records as they come, and return them.

    Parameters
    ----------
    outcomes : callable
        Runs cases and yields each with its record when it has ended; when closed, ends those under way.
    line : callable
        ``line(case, result)`` is printed of each run.
    dry_run : bool
        Only print the names of the open cases.

    An interrupt and a disk that cannot be written end the program, with exit codes 130 and 2.
    """
    try:
        if not dry_run:
            store.tidy(*dict.fromkeys(case.part for case in cases))
        wanted = open_cases(cases, store, retry_failed)
        console.print(f"{len(cases)} cases, {len(cases) - len(wanted)} of them done already")
        if dry_run:
            for case in wanted:
                say(console, case.key)
            return []
        records = _kept(wanted, store, outcomes, line, console)
    except KeyboardInterrupt:
        left = len(open_cases(cases, store, retry_failed))
        console.print(f"interrupted; {left} cases are left: the same command goes on")
        sys.exit(130)
    except (OSError, InputError) as error:
        say(console, f"the runs have ended early: {error}; the same command goes on")
        sys.exit(2)
    except RecordError as error:
        raise click.ClickException(str(error)) from None
    failed = sum(not r["result"]["finished"] for r in records)
    say(console, f"{len(records) - failed} finished, {failed} failed; records in {store.folder}")
    return records


def _kept(
    wanted: list[C],
    store: Store,
    outcomes: Callable[[list[C]], Outcomes],
    line: Callable[[C, dict], str],
    console: Console,
) -> list[dict]:
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), "left", TimeRemainingColumn())
    records = []
    try:
        with (
            Progress(*columns, console=console, speed_estimate_period=3600.0) as progress,
            closing(outcomes(wanted)) as ended,
        ):
            task = progress.add_task("", total=len(wanted))
            for case, record in ended:
                store.append(record)
                records.append(record)
                say(progress.console, line(case, record["result"]))
                progress.advance(task)
    finally:
        store.tidy(*dict.fromkeys(case.part for case in wanted))
    return records
