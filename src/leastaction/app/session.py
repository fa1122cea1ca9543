"""State of one browser tab: data, choices and results, independent of the views."""

from __future__ import annotations

import copy
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from leastaction.app import columns, files
from leastaction.app.arm import ROBOTS, ArmLog, identify
from leastaction.app.candidates import Choice, Task
from leastaction.app.jobs import Found, Walk, forecast, refine, search
from leastaction.app.worker import Job, Worker, in_words
from leastaction.errors import DataError, InputError
from leastaction.refit import provisional

if TYPE_CHECKING:
    from leastaction import LagrangianModel, Trajectories
    from leastaction.curve.motion import SmoothMotion

__all__ = ["Session"]

_PATIENCE = 2.0  # seconds: time to restart a stopped process


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
        As read with these roles; None if that failed, with the reason in `fault`.
    hint : str
    choice : Choice
    task, job : Task or None, Job or None
        The last discovery; once there is a model, the job is that of a refit or a forecast.
    searched : Choice
        The choices of that discovery.
    found : dict
        Position on the trade-off curve -> its model, at any stage.
    faults : dict
        Position -> reason why its model is not refined further.
    kept : Found or None
        The model for comparisons.
    walk, place
        The trade-off curve, and the position that is shown.
    arm, arm_job : ArmLog or None, Job or None
        The log of a robot arm, if one is open, and its identification.
    """

    view: str = "data"
    title: str = ""
    columns: columns.Columns | None = None
    roles: dict[str, str] = field(default_factory=dict)
    data: Trajectories | None = None
    fault: str = ""
    hint: str = ""
    shown: int = 0
    choice: Choice = field(default_factory=Choice)
    task: Task | None = None
    searched: Choice = field(default_factory=Choice)
    job: Job | None = None
    found: dict[int, Found] = field(default_factory=dict)
    faults: dict[int, str] = field(default_factory=dict)
    kept: Found | None = None
    walk: Walk = field(default_factory=lambda: Walk(()))
    place: int = 0
    arm: ArmLog | None = None
    arm_job: Job | None = None

    def __post_init__(self) -> None:
        self.folder: Path = Path(tempfile.mkdtemp(prefix="leastaction-app-"))
        self.worker: Worker = Worker()
        self._paths: list[Path] = []
        self._job_place: int | None = None
        self._smooth: dict[int, SmoothMotion] = {}

    def close(self) -> None:
        """End the worker and remove the files."""
        self.worker.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    @property
    def moving(self) -> list[str]:
        """Columns that are coordinates."""
        return columns.moving_columns(self.roles)

    @property
    def angles(self) -> list[str]:
        """Coordinates of the table that are angles."""
        names = columns.coordinate_names(self.moving)
        return [name for column, name in names.items() if self.roles[column] != columns.COORDINATE]

    def open_uploads(self, given: Sequence[tuple[str, bytes]]) -> None:
        """Store uploaded files in the temporary folder and read their columns.

        Several tables are trials of one system and have the same columns. With a file that describes a robot
        arm, they are its log.

        Raises
        ------
        InputError
            If one is too large, of an unknown kind, or not a table; the previous data then stay open.
        """
        if len(given) == 1 and given[0][0].lower().endswith(files.SESSION):
            files.check_size(*given[0])
            self._open_saved(files.open_saved(given[0][1]))
            return
        if any(name.lower().endswith(ROBOTS) for name, _ in given):
            self._open_arm(given)
            return
        paths = self._kept(given)
        self._open(paths, files.title_of(paths), None)

    def _open_arm(self, given: Sequence[tuple[str, bytes]]) -> None:
        """Open the log of an arm; its table may have been open before."""
        robots = [pair for pair in given if pair[0].lower().endswith(ROBOTS)]
        tables = [pair for pair in given if pair not in robots]
        if len(robots) > 1 or not (tables or self._paths):
            raise InputError(
                "for a robot arm, give its URDF or MuJoCo file and the table of its log: choose both at once"
            )
        ((name, content),) = robots
        files.check_size(name, content)
        stem, _, suffix = name.rpartition(".")
        robot = self.folder / f"{files.plain_name(stem)}.{suffix.lower()}"
        robot.write_bytes(content)
        arm = ArmLog.of(self._kept(tables) if tables else self._paths, robot)
        self.stop()
        self.arm, self.arm_job = arm, None

    def identify(self) -> None:
        """Start the identification of the arm."""
        self.arm_job = self.worker.start(identify, self.arm)

    def _kept(self, given: Sequence[tuple[str, bytes]]) -> list[Path]:
        """The files in the folder, under unique names."""
        named: dict[str, bytes] = {}
        for name, content in sorted(given, key=lambda pair: files.by_number(pair[0])):
            suffix = files.kind_of(name)
            files.check_size(name, content)
            # The original name is for display; only safe characters reach the disk.
            stem, number = files.plain_name(name[: -len(suffix)]), 2
            free = stem
            while free + suffix in named:
                free, number = f"{stem}_{number}", number + 1
            named[free + suffix] = content
        for name, content in named.items():
            (self.folder / name).write_bytes(content)
        return [self.folder / name for name in named]

    def _open_saved(self, saved: files.Saved) -> None:
        paths = self._kept(list(saved.tables.items()))
        self._open(paths, saved.title, saved.choice, saved.roles)
        if saved.model is None or self.data is None:
            self.hint = "Data and choices are restored; find the Lagrangian to see a result."
            return
        self.searched = saved.searched or saved.choice
        self._show_saved(saved.model, self.data)

    def _show_saved(self, model: LagrangianModel, data: Trajectories) -> None:
        """Show a model of a file and begin its forecasts, which are not stored."""
        self.found = {0: Found(model, "fitted")}
        try:
            task = self.searched.task(data, self.angles)
            if task.library.coordinates != model.coordinates:
                of_model, of_data = map(", ".join, (model.coordinates, task.library.coordinates))
                raise InputError(f"the model of this session is of {of_model}, but its data are of {of_data}")
        except InputError as error:
            self.task, self.faults = None, {0: str(error)}
        else:
            self.task = task
        self._advance()

    @property
    def can_be_saved(self) -> bool:
        """Whether there is something to save: a table that is not the log of an arm."""
        return self.columns is not None and self.arm is None

    def save(self) -> bytes:
        """The session as one file: tables, roles of the columns, choices, and the model if there is one."""
        tables = {path.name: path.read_bytes() for path in self._paths}
        content = files.Saved(self.title, tables, self.roles, self.choice)
        if self.found:
            shown = self.best if self.current.stage == "provisional" else self.current
            content = replace(content, model=shown.model, searched=self.searched)
        return files.saved(content)

    def open_example(self, key: str) -> None:
        """Open one of the measured pendulums of the package, with the candidates of the demonstration."""
        from importlib import resources

        from leastaction.cli.demo import DEMOS

        demo = DEMOS[key]
        with resources.as_file(resources.files("leastaction") / "datasets" / demo.file) as source:
            path = self.folder / demo.file
            shutil.copyfile(source, path)
        choice = Choice(
            written=True,
            text="\n".join(demo.candidates),
            friction=list(demo.dissipation),
            known="\n".join(f"{text} = {value:g}" for text, value in demo.known.items()),
            every_third=True,
        )
        self._open([path], files.EXAMPLES[key][0], choice)

    def _open(
        self, paths: Sequence[Path], title: str, choice: Choice | None, roles: Mapping[str, str] | None = None
    ) -> None:
        table = columns.peek(paths[0])
        for other in paths[1:]:
            if columns.peek(other).header != table.header:
                raise InputError(
                    f"{other.name} has other columns than {paths[0].name}; files opened together must be "
                    "trials of one system with the same header"
                )
        self.stop()
        self.arm = self.arm_job = None
        self._paths, self.title, self.columns, self.hint = list(paths), title, table, ""
        self.roles = columns.guess_roles(table)
        if roles is not None:
            self.roles |= {column: role for column, role in roles.items() if column in self.roles}
        self.read()
        if choice is not None:
            self.choice = choice

    def read(self) -> None:
        """Read the table with the present roles; resets the candidates if they no longer apply."""
        before = None if self.data is None else (self.data.coordinates, self.data.driven)
        try:
            self.data, self.fault = columns.read(self._paths, self.roles), ""
        except (InputError, DataError) as error:
            self.data, self.fault = None, in_words(str(error), self.folder)
        self.shown, self._smooth = 0, {}
        self.forget()
        if self.data is not None and (self.data.coordinates, self.data.driven) != before:
            self.choice, self.kept = Choice.default(self.data), None

    def smooth(self) -> SmoothMotion:
        """The smoothing spline of the displayed trial."""
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
        self.task, self.searched = self.choice.task(self.data, self.angles), copy.deepcopy(self.choice)
        self.forget()
        self.job = self.worker.start(search, self.task)
        return self.job

    def go_to(self, place: int) -> Job | None:
        """Move along the trade-off curve; a provisional model is available at once.

        Returns the job that refines it; None if it is already refined.
        """
        if place not in self.found:
            model = provisional(self.best.model, self.walk.points[place])
            self.found[place] = Found(model, "provisional")
        self.place = place
        self.faults.pop(place, None)
        self._advance()
        return self.job

    def collect(self) -> bool:
        """Store the result of a finished job; returns whether the page must be updated."""
        job, place = self.job, self._job_place
        if job is None or job.state == "cancelled":
            return False
        if job.state == "running":
            if place is not None:
                self._advance()
            return False
        if place is None:
            if job.state == "failed":
                return False  # the job stays: the page shows its error
            self.walk = Walk.of(job.result.model)
            place = self.place = self.walk.chosen
        self.job = None
        if job.state == "done":
            self.found[place] = job.result
        else:
            self.faults[place] = job.message
        self._advance()
        return place == self.place

    def _advance(self) -> None:
        """Start the next stage of the shown model; a nearly finished job for another may finish first."""
        job = self.job
        if job is not None and job.state == "running":
            if self._job_place == self.place or job.seconds < _PATIENCE:
                return
            self.worker.cancel()
        self.job = None
        if not self.waiting:
            return
        if self.current.stage == "provisional":
            self.job = self.worker.start(refine, self.best.model, self.walk.points[self.place])
        else:
            self.job = self.worker.start(forecast, self.task, self.current.model)
        self._job_place = self.place

    def stay(self) -> None:
        """Stop refining the shown model."""
        self.worker.cancel()
        self.job = None
        self.faults[self.place] = "it was cancelled"

    @property
    def waiting(self) -> bool:
        """Whether a job for the shown model is still to finish."""
        return self.current.stage != "forecast" and self.place not in self.faults

    @property
    def current(self) -> Found:
        """The result that the page shows."""
        return self.found[self.place]

    @property
    def best(self) -> Found:
        """The result of the discovery."""
        return self.found[self.walk.chosen]

    def stop(self) -> None:
        """Cancel the running job."""
        self.worker.cancel()

    def forget(self) -> None:
        """Drop results, which belong to other data or candidates."""
        self.stop()
        self.job, self._job_place, self.found, self.faults = None, None, {}, {}
        self.walk, self.place = Walk(()), 0

    def write_report(self) -> str:
        """The report on the shown model, as HTML."""
        import leastaction as la

        path = self.folder / "report.html"
        current, names = self.current, columns.written_names(self.moving)
        la.write_report(current.model, path, validation=current.validation, names=names)
        return path.read_text(encoding="utf-8")

    def write_model(self) -> str:
        """The shown model, as JSON."""
        path = self.folder / "model.json"
        self.current.model.save(path)
        return path.read_text(encoding="utf-8")

    def write_everything(self) -> bytes:
        """Model, every export and, after a search, the report of the shown model, in one archive."""
        texts = {"model.json": self.write_model()}
        if self.current.model.diagnostics is not None:
            texts["report.html"] = self.write_report()
        return files.everything(self.current.model, texts)
