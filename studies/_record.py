"""What is kept of a run, and how it is written: the same as in reproduction/, of which it uses the pieces."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache

from reproduction._execute import ROOT, commit, failure, machine, to_json, versions, write
from studies.case import Case

__all__ = ["ROOT", "failure", "one_line", "record", "to_json", "write"]

_CODE = ("src", ":(glob)studies/*.py")


@cache
def _origin() -> dict:
    # of the moment when the first run ended: a study should not be run while its code is being changed
    return {"versions": versions(), "machine": machine(), "commit": commit(_CODE)}


def one_line(document: Mapping) -> str:
    """JSON without line breaks; numbers that are not finite become null."""
    return json.dumps(json.loads(to_json(document)), ensure_ascii=False)


def record(case: Case, result: Mapping, parallel: int) -> dict:
    """Return what is kept of a run."""
    origin = _origin()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        "config": case.as_dict(),
        "result": dict(result),
        **origin,
        "machine": origin["machine"] | {"parallel_runs": parallel, "load_after": load},
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }
