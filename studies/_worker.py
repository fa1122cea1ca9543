"""A process that runs one case after another: lines of JSON come in, one line of JSON goes back for each.

Importing SymPy takes a second, so a process serves many runs. It ends when its input does, also in the
middle of a run: then the process that started it is gone.
"""

from __future__ import annotations

import gc
import json
import os
import queue
import sys
import threading
import traceback
from pathlib import Path

from runner.machine import failure
from runner.store import to_line
from studies.case import Case

__all__ = ["main"]


def _read(lines: queue.SimpleQueue) -> None:
    """Pass lines on, and end the process when there are no more."""
    kept = b""
    # not sys.stdin: its lock would be held when the interpreter ends
    while chunk := os.read(0, 65536):
        *whole, kept = (kept + chunk).split(b"\n")
        for line in whole:
            lines.put(line)
    os._exit(0)


def _run(case: Case) -> dict:
    from studies.solve import solve

    try:
        return {"finished": True, **solve(case)}
    except Exception as error:  # whatever a discovery raises is worth a record
        frames = traceback.extract_tb(error.__traceback__)
        where = [f"{Path(f.filename).name}:{f.lineno}" for f in frames]
        return failure("failed", f"{type(error).__name__}: {error}") | {"where": where}


def main() -> None:
    """Serve cases until the input ends; what a run prints goes to the error stream."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    lines: queue.SimpleQueue = queue.SimpleQueue()
    threading.Thread(target=_read, args=(lines,), daemon=True).start()
    while True:
        case = Case(**json.loads(lines.get()))
        print(f"case {case.key}", file=sys.stderr, flush=True)
        answers.write(to_line(_run(case)) + "\n")
        answers.flush()
        gc.collect()


if __name__ == "__main__":
    main()
