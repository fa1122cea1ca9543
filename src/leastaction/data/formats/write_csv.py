"""Trajectories to CSV text that reads back exactly."""

from __future__ import annotations

import csv
import io

import numpy as np

from leastaction.data.trajectories import Trajectories
from leastaction.errors import InputError
from leastaction.identifiers import quoted

__all__ = ["csv_bytes"]


def csv_bytes(trajectories: Trajectories) -> bytes:
    """Return the table ``trial,t,<coordinates>[,<coordinate>_force ...][,<coordinate>_dot ...]`` as UTF-8.

    Floats are written with as few digits as give the same float again; NaN is an empty cell.

    Raises
    ------
    InputError
        If two columns would have the same name, or a trial's name would not read back.
    """
    names = trajectories.coordinates
    forces = tuple(f"{name}_force" for name in names) if trajectories.driven else ()
    rates = trajectories.rates
    rated = tuple(f"{names[rate.coordinate]}_{'d' * rate.derivative}ot" for rate in rates)
    header = ("trial", "t", *names, *forces, *rated)
    for column in header:
        if header.count(column) > 1:
            raise InputError(
                f"two columns of the CSV file would be called {quoted(column)}; rename the coordinate"
            )
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    for k, (trial, item) in enumerate(zip(trajectories.names, trajectories, strict=True)):
        if trial != trial.strip() or "\r" in trial or "\0" in trial:
            raise InputError(
                f"the trial name {quoted(trial)} cannot stand in a CSV file; remove spaces around it"
            )
        columns = [item.t[:, np.newaxis], item.q]
        if forces:
            columns.append(np.zeros_like(item.q) if item.forces is None else item.forces)
        columns += [rate.values[k][:, np.newaxis] for rate in rates]
        # The csv module writes a float as its repr, the shortest text that gives the same float.
        rows = np.hstack(columns).tolist()
        writer.writerows([trial, *("" if value != value else value for value in row)] for row in rows)
    return stream.getvalue().encode("utf-8")
