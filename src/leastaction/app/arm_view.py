"""The view of a robot arm: what its log holds, the identification, its report and files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Any

from nicegui import events, html, ui

from leastaction.app.arm import ArmFound, ArmLog, ArmMotion
from leastaction.app.files import archive
from leastaction.app.parts import Stick, action, aside, choice, fault, panel, say, table, title
from leastaction.app.running_view import stage_bar
from leastaction.app.worker import Job, in_words

if TYPE_CHECKING:
    from leastaction.app.page import Page

__all__ = ["show"]

_STAGES = {
    "": "Starting",
    "read": "Reading the log",
    "fit": "Fitting motion, inertial parameters and friction",
    "links": "Making links physically consistent",
    "report": "Writing the report",
}
_BESIDE = "Add terms if more acts than links and friction: coupled motors, {}; a balancing spring, {}."
_HELD_OUT = {"20%": "the last 20 %", "": "nothing"}


def show(page: Page) -> None:
    """Fill the view."""
    ArmView(page).build()


class ArmView:
    """Elements of the view that change."""

    def __init__(self, page: Page) -> None:
        self.page, self.session = page, page.session

    def build(self) -> None:
        job = self.session.arm_job
        if job is not None and job.state == "running":
            self._running()
        elif job is not None and job.state == "done":
            self._result(job.result)
        else:
            self._log(job)

    @property
    def _arm(self) -> ArmLog:
        assert self.session.arm is not None
        return self.session.arm

    def _log(self, job: Job | None) -> None:
        arm, columns = self._arm, self._arm.columns
        title("A robot arm", "h1")
        say("Find the inertial parameters and the friction that its log shows, with intervals.", "lead")
        if job is not None and job.state == "failed":
            fault(in_words(job.message, self.session.folder))
        with panel():
            title(arm.title)
            time = columns.time + (f" in {columns.time_unit}" if columns.time_unit else "")
            say(f"The columns were recognised by their names; the column of times is {time}.", "help")
            kinds = {
                "joint": {joint: joint for joint in arm.joints},
                "position": columns.positions,
                "velocity": columns.velocities,
                "current" if columns.currents else "torque": columns.torques,
            }
            head = [(name, "") for name, column in kinds.items() if column]
            table("Columns", head, [[kind[j] for kind in kinds.values() if kind] for j in arm.joints])
            with html.div().classes("trial"):
                say("predicted, not fitted", "help", "span")
                choice("Predicted, not fitted", _HELD_OUT, arm.hold_out, lambda s: self._set(hold_out=s))
            if columns.currents:
                self._text("gains", "Torque per ampere of one joint or more", f"{arm.joints[0]}=10.5")
                say("Those of the other joints are estimated.", "help")
            if len(arm.joints) > 1:
                one, two = (f"{name}_dot" for name in arm.joints[-2:])
                say(_BESIDE.format(f"{one}*{two}", f"cos(2*{arm.joints[1]})"), "help")
                self._text("terms", "Terms of L", f"{one}*{two}")
                self._text("dissipation", "Terms of the dissipation function", f"abs({one}+{two})")
            with html.div().classes("next"):
                action("Identify the arm", self.page.guarded(self._start), "main", "identify")

    def _text(self, name: str, label: str, example: str) -> None:
        def keep(event: events.ValueChangeEventArguments) -> None:
            self._set(**{name: event.value or ""})

        box = ui.input(label, placeholder=example, value=getattr(self._arm, name), on_change=keep)
        box.props("outlined dense").mark(name)

    def _set(self, **given: Any) -> None:
        self.session.arm = replace(self._arm, **given)

    def _start(self) -> None:
        self.session.identify()
        self.page.show("arm")

    def _running(self) -> None:
        title("Identifying the arm", "h1")
        with panel("running"):
            self.bar, self.stage, self.seconds = stage_bar()
            action("Cancel", self.page.guarded(self._cancel), "plain", "cancel")
        self.timer = ui.timer(0.2, self.page.guarded(self._follow))

    def _follow(self) -> None:
        job = self.session.arm_job
        if job is None or job.state != "running":
            self.timer.deactivate()
            self.page.show("arm")
            return
        self.stage.text, self.seconds.text = _STAGES[job.stage], f"{job.seconds:.0f} s"
        self.bar.value = [*_STAGES].index(job.stage) / len(_STAGES)

    def _cancel(self) -> None:
        self.timer.deactivate()
        self.session.stop()
        self.page.show("arm")

    def _result(self, found: ArmFound) -> None:
        files = {"report.html": found.report.encode(), **found.files}
        with html.div().classes("heading"):
            with html.div():
                say(self._arm.title, "help")
                title("The arm", "h1")
            with html.div().classes("downloads"):
                for name, content in files.items():
                    self._download(name, partial(bytes, content))
                self._download("all.zip", partial(archive, files))
                action("Change", self.page.guarded(self._change), "plain", "change").props("icon=replay")
        if found.motion is not None:
            _motion(found.motion)
        # A frame, because the report has a style of its own; it has no scripts, and may run none.
        frame = f'<iframe class="report" title="Report" sandbox srcdoc="{escape(found.report)}"></iframe>'
        ui.html(frame, sanitize=False)

    def _download(self, name: str, make: Callable[[], bytes]) -> None:
        async def download(_=None) -> None:
            ui.download.content(await aside(make), name)

        action(name, self.page.guarded(download), "plain", name).props("icon=download")

    def _change(self) -> None:
        self.session.arm_job = None
        self.page.show("arm")


def _motion(motion: ArmMotion) -> None:
    shown, whole = motion.frames["t"][-1], motion.duration
    length = f"the first {shown:.3g} of {whole:.3g} s" if shown < 0.99 * whole else f"{whole:.3g} s"
    where = f"trial {motion.trial}, the longest" if motion.trial else "the log"
    with panel():
        title("The recorded motion")
        say(f"The arm moves as recorded in {where}: {length}.")
        Stick(motion.frames)
        ends = "at the origin of the base and ends at the centre of mass of the last link"
        say(f"The drawing begins {ends}.", "help")
