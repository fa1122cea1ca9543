"""What one browser tab has loaded, chosen and found; knows nothing of how it is shown."""

from __future__ import annotations

import gzip
import io
import re
import shutil
import tempfile
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from leastaction.app import columns
from leastaction.app.candidates import Choice, Task
from leastaction.app.jobs import Found, search
from leastaction.app.path import Walk
from leastaction.app.worker import Job, Worker, explain
from leastaction.errors import DataError, InputError

if TYPE_CHECKING:
    from leastaction import Trajectories
    from leastaction.curve.motion import SmoothMotion

__all__ = ["EXAMPLES", "MOST_BYTES", "SUFFIXES", "Session", "in_words"]

MOST_BYTES = 200_000_000
"""Largest upload, and largest table inside a compressed one."""

SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".csv.gz", ".tsv.gz", ".txt.gz", ".dat.gz")

EXAMPLES = {
    "single": ("Single pendulum", "4 trials of 9.2 s, one angle; swings freely, a little friction"),
    "double": (
        "Double pendulum",
        "26 trials of 2.7 s, two angles; the smallest terms show the encoders' zeros",
    ),
}
"""Name of a measured example -> its title, and what it is."""


@dataclass(eq=False)
class Session:
    """State of a tab.

    Attributes
    ----------
    title : str
        Name of the file or example; empty as long as there is none.
    columns, roles
        Header and first rows of the table; column -> role.
    data : Trajectories or None
        As read with these roles; None if that failed, then `fault` says why.
    choice : Choice
    task, job : Task or None, Job or None
        The discovery that runs or ran last.
    found : dict
        Expressions of a structure -> its model; the one that was discovered has the key of the chosen point.
    walk, place
        The trade-off curve, and where on it the page stands.
    """

    view: str = "data"
    title: str = ""
    columns: columns.Columns | None = None
    roles: dict[str, str] = field(default_factory=dict)
    data: Trajectories | None = None
    fault: str = ""
    shown: int = 0
    choice: Choice = field(default_factory=Choice)
    task: Task | None = None
    job: Job | None = None
    wanted: int = 0
    found: dict[tuple[str, ...], Found] = field(default_factory=dict)
    walk: Walk = field(default_factory=lambda: Walk(()))
    place: int = 0

    def __post_init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="leastaction-app-"))
        self.worker = Worker()
        self._path = self.folder / "none"
        self._smooth: dict[int, SmoothMotion] = {}

    def close(self) -> None:
        """End the worker and remove the files."""
        self.worker.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    @property
    def angles(self) -> list[str]:
        """Coordinates that are angles."""
        names = columns.coordinate_names(columns.moving_columns(self.roles))
        return [name for column, name in names.items() if self.roles[column] != columns.COORDINATE]

    def open_upload(self, name: str, content: bytes) -> None:
        """Keep an uploaded file in the temporary folder and look at its columns.

        Raises
        ------
        InputError
            If it is too large, of an unknown kind, or no table; what was open before is then still open.
        """
        suffix = next((s for s in sorted(SUFFIXES, key=len, reverse=True) if name.lower().endswith(s)), None)
        if suffix is None:
            raise InputError(f"{_safe(name)} is no text table; give a file with one of {', '.join(SUFFIXES)}")
        _check_size(name, content)
        # The name is for people; only letters, digits and the like reach the disk.
        path = self.folder / (_safe(name[: -len(suffix)]) + suffix)
        path.write_bytes(content)
        self._open(path, path.name, None)

    def open_example(self, key: str) -> None:
        """Open one of the measured pendulums of the package, with the candidates of the demonstration."""
        from importlib.resources import as_file, files

        from leastaction.cli.demo import DEMOS

        demo = DEMOS[key]
        with as_file(files("leastaction") / "datasets" / demo.file) as source:
            path = self.folder / demo.file
            shutil.copyfile(source, path)
        choice = Choice(
            written=True,
            text="\n".join(demo.candidates),
            friction=list(demo.dissipation),
            known="\n".join(f"{text} = {value:g}" for text, value in demo.known.items()),
            every_third=True,
        )
        self._open(path, EXAMPLES[key][0], choice)

    def _open(self, path: Path, title: str, choice: Choice | None) -> None:
        table = columns.peek(path)
        self.stop()
        self._path, self.title, self.columns = path, title, table
        self.roles = columns.guess_roles(table)
        self.read()
        if choice is not None:
            self.choice = choice

    def read(self) -> None:
        """Read the table with the present roles; the candidates begin anew if they no longer fit."""
        before = None if self.data is None else (self.data.coordinates, self.data.driven)
        try:
            self.data, self.fault = columns.read(self._path, self.roles), ""
        except (InputError, DataError) as error:
            self.data, self.fault = None, in_words(str(error), self.folder)
        self.shown, self._smooth = 0, {}
        self.forget()
        if self.data is not None and (self.data.coordinates, self.data.driven) != before:
            self.choice = Choice.default(self.data)

    def smooth(self) -> SmoothMotion:
        """The smoothing spline of the trial that is shown."""
        import leastaction as la

        assert self.data is not None
        if self.shown not in self._smooth:
            (self._smooth[self.shown],) = la.smooth(self.data.select(self.shown))
        return self._smooth[self.shown]

    def discover(self) -> Job:
        """Start a discovery with the present choice.

        Raises
        ------
        InputError
            If the choice is incomplete.
        """
        if self.data is None:
            raise InputError("there are no data yet; open a file or an example first")
        self.task = self.choice.task(self.data, self.angles)
        self.forget()
        self.job = self.worker.start(search, self.task)
        return self.job

    def go_to(self, place: int) -> Job | None:
        """Move along the trade-off curve; returns the job of the refit, or None where one has been there."""
        assert self.task is not None
        if self.job is not None and self.job.state == "running":
            self.worker.cancel()
        self.wanted = place
        key = self.walk.points[place].expressions
        if key in self.found:
            self.place, self.job = place, None
            return None
        friction = self.best.model.provenance["options"]["dissipation"]
        self.job = self.worker.start(search, self.task.restricted(key, friction))
        return self.job

    def collect(self) -> bool:
        """Take over the result of a job that is done; whether there was one."""
        job = self.job
        if job is None or job.state != "done":
            return False
        found: Found = job.result
        self.job = None
        if self.walk.points:
            self.found[self.walk.points[self.wanted].expressions] = found
            self.place = self.wanted
        else:
            self.walk = Walk.of(found.model)
            self.place = self.wanted = self.walk.chosen
            self.found = {self._key(): found}
        return True

    def _key(self) -> tuple[str, ...]:
        return self.walk.points[self.place].expressions if self.walk.points else ()

    @property
    def current(self) -> Found:
        """What the page shows."""
        return self.found[self._key()]

    @property
    def best(self) -> Found:
        """What was discovered."""
        return next(iter(self.found.values()))

    def stop(self) -> None:
        """Cancel what runs."""
        self.worker.cancel()

    def forget(self) -> None:
        """Drop results: they belong to other data or candidates."""
        self.stop()
        self.job, self.found, self.walk, self.place, self.wanted = None, {}, Walk(()), 0, 0

    def write_report(self) -> str:
        """The report on the model that is shown, as HTML."""
        import leastaction as la

        path = self.folder / "report.html"
        la.write_report(self.current.model, path, validation=self.current.validation)
        return path.read_text(encoding="utf-8")

    def write_model(self) -> str:
        """The model that is shown, as JSON."""
        path = self.folder / "model.json"
        self.current.model.save(path)
        return path.read_text(encoding="utf-8")


def in_words(text: str, folder: Path | None = None) -> str:
    """Put messages, which name files and Python arguments, in terms of the page.

    Examples
    --------
    >>> in_words("/tmp/x/a.csv, line 3: sort the rows, or give the column (trial=...)", Path("/tmp/x"))
    'a.csv, line 3: sort the rows, or give the column (as the trial)'
    """
    if folder is not None:
        text = text.replace(f"{folder}/", "").replace(f"{folder}\\", "")
    text = text.replace("(trial=...)", "(as the trial)")
    return explain(InputError(text))


def _safe(name: str) -> str:
    return re.sub(r"[^\w.+-]+", "_", Path(name.replace("\\", "/")).name).strip("._")[:80] or "table"


def _check_size(name: str, content: bytes) -> None:
    limit = f"{MOST_BYTES // 1_000_000} MB"
    if len(content) > MOST_BYTES:
        raise InputError(f"{_safe(name)} is larger than {limit}; leave out columns or use the command line")
    if content[:2] != b"\x1f\x8b":
        return
    total = 0
    try:
        with gzip.open(io.BytesIO(content)) as stream:
            while chunk := stream.read(1 << 20):
                total += len(chunk)
                if total > MOST_BYTES:
                    raise InputError(
                        f"{_safe(name)} holds more than {limit} when it is unpacked; use the command line"
                    )
    except (OSError, EOFError, zlib.error):
        return  # damaged: the reader says so
