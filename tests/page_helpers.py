"""What the tests of app and report share: files, a server, functions of a worker, readers of pages."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from html.parser import HTMLParser
from http.client import HTTPConnection
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from xml.etree import ElementTree

import numpy as np

import leastaction as la
from leastaction import LagrangianModel, Trajectories, Trajectory
from leastaction.curve.bspline import SplineGrid, uniform_space
from leastaction.model.diagnostics import Diagnostics, PathPoint
from leastaction.model.term import FitSummary, ModelTerm

SOCKET = "_nicegui_ws/socket.io/?EIO=4&transport="
UPGRADE = {
    "connection": "Upgrade",
    "upgrade": "websocket",
    "sec_websocket_version": "13",
    "sec_websocket_key": "MDEyMzQ1Njc4OWFiY2RlZg==",
}
# What the app answers, and to what kind of request.
ASKED = [
    ("", "GET", {}),
    ("anything", "GET", {}),
    ("favicon.ico", "GET", {}),
    ("_nicegui/client/1/upload/2", "POST", {}),
    (f"{SOCKET}polling", "GET", {}),
    (f"{SOCKET}polling", "POST", {}),
    (f"{SOCKET}polling", "OPTIONS", {}),
    (f"{SOCKET}websocket", "GET", UPGRADE),
]


def count_to(progress, last: int) -> int:
    for k in range(last):
        progress("count", {"terms": float(k)})
    return last


def sleep(progress, seconds: float) -> None:
    progress("asleep", {})
    time.sleep(seconds)


def fail(progress, text: str) -> None:
    raise la.InputError(text)


def break_down(progress) -> None:
    raise KeyError("a fault of ours")


def die(progress) -> None:
    os._exit(3)


def driven_pendulum(path: Path, trials: int = 3) -> Path:
    """A driven pendulum as a user may have recorded it: times, angle, torque, trial."""
    data = la.systems.generate("single_pendulum", noise=0.01, trials=trials, duration=5.0, rate=50.0, seed=0)
    rows = ["run,time,theta,tau"] + [
        f"{run.name},{t!r},{q!r},{f!r}"
        for run in data
        for t, q, f in zip(run.t.tolist(), run.q[:, 0].tolist(), run.forces[:, 0].tolist(), strict=True)
    ]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


@contextmanager
def running_app(folder: Path) -> Iterator[str]:
    """The app as a user starts it; yields the address that it prints, with the token.

    It prints nothing else, and leaves nothing behind in the folder where it was started.
    """
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    log = folder / "log.txt"
    source = str(Path(la.__file__).parents[1])
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("NICEGUI", "PYTEST"))}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, [source, environment.get("PYTHONPATH")]))
    with log.open("w") as stream:
        command = [sys.executable, "-m", "leastaction", "app", "--no-browser", "--port", str(port)]
        process = subprocess.Popen(command, cwd=folder, env=environment, stdout=stream, stderr=stream)
    try:
        end = time.monotonic() + 60
        while True:
            try:
                socket.create_connection(("127.0.0.1", port), timeout=5).close()
                break
            except OSError:
                assert process.poll() is None, log.read_text()
                assert time.monotonic() < end, log.read_text()
                time.sleep(0.2)
        line = rf"leastaction app: (http://127\.0\.0\.1:{port}/\?token=[\w-]{{43}}) \(end it with Ctrl-C\)\n"
        printed = re.fullmatch(line, log.read_text())
        assert printed, log.read_text()
        yield printed[1]
    finally:
        process.terminate()
        process.wait(30)
    assert re.fullmatch(line, log.read_text()), log.read_text()
    assert [path.name for path in folder.iterdir()] == ["log.txt"]


def ask(
    address: str, method: str = "GET", body: bytes | None = None, **headers: str
) -> tuple[int, dict[str, str], str]:
    """Status, headers in small letters, and text; a redirection is not followed.

    An underscore in the name of a header stands for its hyphen.
    """
    place = urlsplit(address)
    connection = HTTPConnection(place.netloc, timeout=20)
    try:
        path = f"{place.path or '/'}?{place.query}" if place.query else place.path or "/"
        connection.request(method, path, body, {k.replace("_", "-"): v for k, v in headers.items()})
        answer = connection.getresponse()
        names = {name.lower(): value for name, value in answer.getheaders()}
        return answer.status, names, answer.read().decode(errors="replace")
    finally:
        connection.close()


def cookie_for(address: str) -> str:
    """What a browser gets for the address with the token, and sends from then on."""
    status, headers, _ = ask(address)
    assert status == 303
    return headers["set-cookie"].partition(";")[0]


def parts_of(address: str) -> tuple[str, str, str]:
    """Address without the token, cookie, and path of a static file."""
    home, cookie = address.partition("?")[0], cookie_for(address)
    text = ask(home, cookie=cookie)[2]
    (script, *_) = re.findall(r'src="/([^"]+)"', text)
    return home, cookie, script


def axe_source() -> str | None:
    """The accessibility checker axe-core, from npm or from the Python package that carries it; or None.

    ``npm install axe-core`` in the repository or ``pip install axe-playwright-python`` brings it.
    """
    root = Path(__file__).parents[1]
    places = [root / "node_modules" / "axe-core" / "axe.min.js"]
    if "AXE_CORE" in os.environ:
        places.insert(0, Path(os.environ["AXE_CORE"]))
    carrier = find_spec("axe_playwright_python")
    if carrier is not None and carrier.origin is not None:
        places.append(Path(carrier.origin).with_name("axe.min.js"))
    return next((path.read_text(encoding="utf-8") for path in places if path.is_file()), None)


# ------------------------------------------------------------------------------------- a real browser
_CHROMIUM = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome", "chrome")
CHROMIUM_OPTIONS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


def chromium() -> str | None:
    """Path of the browser, if there is one."""
    return next(filter(None, map(shutil.which, _CHROMIUM)), None)


@contextmanager
def browser() -> Iterator[Any]:
    """Chromium, by Playwright."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=chromium(), args=CHROMIUM_OPTIONS)
        yield found
        found.close()


def seconds_to_paint(browser: Any, address: str) -> float:
    """From the request of a page to its first text or picture, with an empty cache."""
    context = browser.new_context()
    page = context.new_page()
    page.goto(address)
    milliseconds = page.evaluate(
        """() => new Promise((done) => new PerformanceObserver((seen) => {
          for (const paint of seen.getEntriesByName('first-contentful-paint')) done(paint.startTime)
        }).observe({type: 'paint', buffered: true}))"""
    )
    context.close()
    return milliseconds / 1000


def seconds_to_the_law_after(page: Any, button: str) -> float:
    """From a click on a step along the curve to another law on the page, at most ten."""
    return page.evaluate(
        """(name) => new Promise((done) => {
          const law = () => [...document.querySelectorAll('.formula')].map((p) => p.textContent).join()
          const before = law(), start = performance.now()
          const see = () => {
            const seconds = (performance.now() - start) / 1000
            if ((law() && law() !== before) || seconds > 10) done(seconds)
            else requestAnimationFrame(see)
          }
          document.querySelector(`button[aria-label="${name}"]`).click()
          see()
        })""",
        button,
    )


def steps_along_the_curve(browser: Any, address: str, most: int = 5) -> list[float]:
    """Seconds to another law after each step to fewer terms, from that of the measured double pendulum on."""
    page = browser.new_page()
    page.goto(address)
    for name in ("Double pendulum", "Continue to the candidates", "Find the Lagrangian"):
        page.get_by_role("button", name=name).first.click()
    page.get_by_text("How many terms?").wait_for(timeout=300_000)
    place = page.get_by_role("slider", name="Number of terms").get_attribute("aria-valuenow")
    seconds = [seconds_to_the_law_after(page, "Fewer terms") for _ in range(min(int(place), most))]
    page.close()
    return seconds


_NUMBER = r"-?(?:\d+\.?\d*|\.\d+)"
_COMMAND = re.compile(rf"([Mmlhvz])((?:\s*{_NUMBER})*)")
_VOID = {"meta", "br", "img", "link", "input", "hr"}


@dataclass(eq=False)
class Node:
    """An element of the page."""

    tag: str
    attributes: dict[str, str | None]
    parent: Node | None = None
    children: list[Node | str] = field(default_factory=list)

    @property
    def text(self) -> str:
        return "".join(c if isinstance(c, str) else c.text for c in self.children)

    @property
    def ancestors(self) -> Iterator[Node]:
        node = self.parent
        while node is not None:
            yield node
            node = node.parent

    def elements(self) -> Iterator[Node]:
        for child in self.children:
            if isinstance(child, Node):
                yield child
                yield from child.elements()

    def all(self, *tags: str, **attributes: str) -> list[Node]:
        """Elements below this one with one of these tags, and with these attributes; class_ is one class."""
        kind = attributes.pop("class_", None)
        return [
            e
            for e in self.elements()
            if (not tags or e.tag in tags)
            and all(e.attributes.get(k) == v for k, v in attributes.items())
            and (kind is None or kind in (e.attributes.get("class") or "").split())
        ]

    def one(self, *tags: str, **attributes: str) -> Node:
        (found,) = self.all(*tags, **attributes)
        return found


class Page(HTMLParser):
    """Checks nesting; holds the tree, all tags with their attributes, and the text."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.root = self._at = Node("", {})
        self.text = ""
        self.feed(source)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        node = self._add(tag, attrs)
        if tag not in _VOID:
            self.open.append(tag)
            self._at = node

    def handle_startendtag(self, tag, attrs):
        self._add(tag, attrs)

    def _add(self, tag, attrs) -> Node:
        self.tags.append((tag, dict(attrs)))
        node = Node(tag, dict(attrs), self._at)
        self._at.children.append(node)
        return node

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        assert self._at.parent is not None
        self._at = self._at.parent

    def handle_data(self, data):
        self.text += data
        self._at.children.append(data)

    def by_id(self, name: str) -> Node:
        return self.root.one(id=name)

    def attributes(self, name: str) -> list[str]:
        return [
            value or "" for _, attributes in self.tags for key, value in attributes.items() if key == name
        ]


def pieces(d: str) -> list[np.ndarray]:
    """Corners of each piece of a path, (n, 2); a dot is a piece with the same corner twice."""
    assert re.fullmatch(rf"(?:[Mmlhvz](?:\s*{_NUMBER})*)*", d), d
    found: list[list[np.ndarray]] = []
    at = np.zeros(2)
    for letter, rest in _COMMAND.findall(d):
        numbers = [float(n) for n in re.findall(_NUMBER, rest)]
        if letter == "z":
            found[-1].append(found[-1][0])
            continue
        if letter in "hv":
            (along,) = numbers
            steps = [[along, 0.0] if letter == "h" else [0.0, along]]
        else:
            steps = np.reshape(numbers, (-1, 2)).tolist()
        for step in steps:
            at = np.array(step) if letter == "M" else at + step
            if letter in "Mm":
                found.append([])
            found[-1].append(at)
    return [np.array(piece) for piece in found]


class Figure:
    """An ``<svg>``, read as XML: it must be well formed."""

    def __init__(self, source: str) -> None:
        self.root = ElementTree.fromstring(source)
        self.box = [float(n) for n in self.root.attrib["viewBox"].split()]

    def paths(self, *words: str) -> list[list[np.ndarray]]:
        """Paths whose style has all these words, in the order of drawing."""
        found = [e for e in self.root.iter("path") if all(w in e.attrib["style"] for w in words)]
        return [pieces(e.attrib["d"]) for e in found]

    def path(self, *words: str) -> list[np.ndarray]:
        (found,) = self.paths(*words)
        return found

    def texts(self, kind: str, anchor: str = "start") -> list[tuple[float, float, str]]:
        """Place and words of the texts of one class."""
        return [
            (float(e.attrib["x"]), float(e.attrib["y"]), e.text or "")
            for e in self.root.iter("text")
            if e.attrib["class"] == kind and e.get("text-anchor", "start") == anchor
        ]

    @property
    def clip(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of what is not cut off."""
        (box,) = self.root.iter("clipPath")
        (rect,) = box
        x, y, width, height = (float(rect.attrib[key]) for key in ("x", "y", "width", "height"))
        return x, y, x + width, y + height


def spring(
    friction: float = 0.0, name: str = "run", sigma: float = 0.01, seconds: float = 6.0
) -> LagrangianModel:
    """Oscillator whose fitted curve is its exact motion: fast, and everything about it is known."""
    rng = np.random.default_rng(1)
    space = uniform_space(0.0, seconds, 20.0)
    t = np.linspace(0.0, seconds, round(50 * seconds) + 1)
    rate = np.sqrt(4.0 - friction**2)

    def motion(t):
        return np.exp(-friction * t) * np.cos(rate * t)

    points = np.linalg.lstsq(space.basis(t).toarray(), motion(t)[:, None], rcond=None)[0]
    q = motion(t) + sigma * rng.standard_normal(t.size)
    diagnostics = Diagnostics(
        Trajectories([Trajectory(t, q, coordinates=["x"], name=name)]),
        SplineGrid([space]),
        points,
        np.array([sigma]),
        np.array([1e6]),
        np.array([1e-3]),
        (
            PathPoint(("x_dot**2",), 900.0, 893.0),
            PathPoint(("x_dot**2", "x**2"), 0.0, 0.0, True),
            PathPoint(("x_dot**2", "x**2", "x**4"), -1.5, 5.5),
            PathPoint(("x_dot**2", "x**4"), 400.0, 400.0),
        ),
        timings={"search": 0.2, "verify": 0.0},
    )
    dissipation = [ModelTerm("x_dot**2", friction / 2, 0.001)] if friction else []
    return LagrangianModel(
        ["x"],
        [ModelTerm("x_dot**2", 0.25, known=True), ModelTerm("x**2", -1.0, 0.002)],
        dissipation,
        noise_std=[sigma],
        fit=FitSummary("ok", 1.0, [1e6]),
        provenance={
            "version": "1.2.3",
            "options": {"known": {"x_dot**2": 0.25}, "angles": ["x"]},
            "data": "ab12",
        },
        diagnostics=diagnostics,
    )


def upload(session, name: str, content: bytes) -> None:
    """Open one file in a session of the app."""
    session.open_uploads([(name, content)])


ROBOT = """<?xml version="1.0"?>
<robot name="two">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="2"/>
    <inertia ixx="0.03" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.01"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0 0 0.15"/><mass value="1"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.2"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="9" velocity="3"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
    <origin xyz="0 0 0.4"/><axis xyz="0 1 0"/></joint>
</robot>
"""


def arm_log(folder: Path, *, quantity: str = "tau") -> tuple[Path, Path]:
    """The log of an arm with two joints, and its URDF, whose masses are 20 % too large."""
    from leastaction import arms

    robot, log = folder / "two.urdf", folder / "log.csv"
    robot.write_text(ROBOT, encoding="utf-8")
    tree = arms.read_urdf(robot)
    true = arms.ArmModel.of_tree(tree.with_inertias(tree.inertias / 1.2), {"viscous": [0.3, 0.1]})
    t = np.arange(0.0, 6.0, 0.005)
    rates, rng = np.array([[1.3], [2.9]]), np.random.default_rng(3)
    q, v, a = (
        np.sum(
            [
                np.sin((k + 1) * rates * t + k + turn) * ((k + 1) * rates) ** turned / (k + 1)
                for k in range(3)
            ],
            0,
        ).T
        for turn, turned in ((0.0, 0), (np.pi / 2, 1), (np.pi, 2))
    )
    torques = true.torques(q, v, a) + 0.02 * rng.normal(size=q.shape)
    head = f"time,q1,q2,{quantity}1,{quantity}2"
    np.savetxt(log, np.column_stack([t, q, torques]), delimiter=",", header=head, comments="")
    return log, robot
