"""What the tests of the app share: files, a server, and functions that a worker process can import."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import urlsplit

import leastaction as la

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
