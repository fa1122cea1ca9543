"""What the tests of the app share: files, and functions that a worker process can import."""

from __future__ import annotations

import os
import time
from pathlib import Path

import leastaction as la


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
