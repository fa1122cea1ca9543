"""What is kept of a run."""

from __future__ import annotations

import os
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache

from runner.origin import commit, machine, versions
from studies.case import Case

__all__ = ["record"]

_CODE = ":(glob)studies/*.py"


@cache
def _origin() -> dict:
    # of the moment when the first run ended: a study should not be run while its code is being changed
    return {"versions": versions(), "machine": machine(), "commit": commit(_CODE)}


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
