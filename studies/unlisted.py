"""What a generated library makes of a law that it does not hold: one case, and what is kept of it.

A result is wrong if its accelerations are off by more than 5 % where the motion was recorded.  The terms do
not count: no choice of them is right.
"""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np

import leastaction as la
from leastaction import systems
from studies.case import Case
from studies.laws import LAWS, error_of_acceleration, motions

__all__ = ["OFF", "is_wrong", "pose", "solve"]

OFF = 0.05


def pose(case: Case) -> tuple[tuple[systems.TrueMotion, ...], la.Trajectories, la.Library]:
    """Return the motions, their recordings, and the candidates of ``--library auto``.

    Who knows that there is friction gives it as a candidate, as by ``--dissipation "x_dot**2/2"``.
    """
    law = LAWS[case.system]
    truth = motions(law, case.trajectories, case.duration, case.rate, case.seed)
    data = systems.measure(law, truth, systems.noise_std(law, truth, case.noise), case.seed)
    library = la.Library.mechanical(law.coordinates, law.angles, dissipation=law.dissipation)
    return truth, data, library


def solve(case: Case) -> dict:
    """Return what is kept of one discovery; an error of the user's kind is an answer too."""
    law = LAWS[case.system]
    truth, data, library = pose(case)
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        model = la.discover(data, library, known=dict(law.known))
    except (la.InputError, la.DataError) as error:
        said = {"status": "no model", "reason": str(error), "findings": []}
        return said | {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    cost = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    errors = error_of_acceleration(law, model, truth)
    error = float(np.max(errors))
    return {
        "status": model.fit.status,
        "findings": [finding.to_dict() for finding in model.fit.findings],
        # no number for what is not finite: a mass that vanishes, say
        "acceleration_error": error if np.isfinite(error) else None,
        "terms": {t.expression: _written(t) for t in model.terms},
        "dissipation": {t.expression: _written(t) for t in model.dissipation},
        "chi2_per_sample": model.fit.chi2_per_sample,
        "n_candidates": model.provenance.get("n_candidates"),
        "seconds": model.diagnostics.timings if model.diagnostics else None,
        **cost,
    }


def _written(term) -> dict:
    if term.known:
        return {"coefficient": term.coefficient, "known": True}
    return {"coefficient": term.coefficient, "standard_error": term.standard_error}


def is_wrong(result: Mapping) -> bool:
    """Tell whether the accelerations of a model are off by more than 5 %.

    >>> is_wrong({"status": "ok", "acceleration_error": 0.01}), is_wrong({"acceleration_error": None})
    (False, True)
    """
    error = result["acceleration_error"]
    return error is None or error > OFF
