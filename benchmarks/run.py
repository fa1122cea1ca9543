"""Time and peak memory of discover(): cold and warm, stage by stage, against data length and library size.

    python benchmarks/run.py                 # everything but the longest recordings
    python benchmarks/run.py --longest 1e6   # up to a million samples

Every case runs in a process of its own, so that peak memory is its own; "cold" is the first call in that
process, "warm" the median of the following ones.  The peer, for scale, is a smoothing spline of SciPy
through the same samples in the same process.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import click
import numpy as np

from leastaction.io import write_text

_SAMPLES = (2_000, 5_000, 10_000, 20_000, 50_000, 100_000, 200_000, 500_000, 1_000_000)


@click.command()
@click.option("--longest", default=1e5, show_default=True, help="Largest number of rows.")
@click.option("--warm", default=3, show_default=True, help="Warm calls a case.")
@click.option("--case", help="Run one case, given as JSON, in this process (used by the program itself).")
@click.option("--output", type=click.Path(path_type=Path), default=Path("benchmarks/results/speed.json"))
def main(longest: float, warm: int, case: str | None, output: Path) -> None:
    """Print the tables and write them as JSON."""
    if case is not None:
        click.echo(json.dumps(measure(**json.loads(case))))
        return
    records = []
    size_of = [{"library": lib, "rows": 10_000, "warm": warm} for lib in ("compact", "large")]
    length_of = [
        {"library": "compact", "rows": n, "warm": 1 if n > 50_000 else warm} for n in _SAMPLES if n <= longest
    ]
    for config in [*size_of, *length_of]:
        command = [sys.executable, __file__, "--case", json.dumps(config)]
        answer = subprocess.run(command, capture_output=True, text=True, check=True)
        records.append({"config": config, "result": json.loads(answer.stdout.splitlines()[-1])})
        click.echo(row(records[-1]))
    records.append({"command_line": command_line()})
    click.echo(f"command line, 51 candidates, cold: {records[-1]['command_line']}")
    write_text(output, json.dumps({"cores": os.cpu_count(), "records": records}, indent=1))


def measure(library: str, rows: int, warm: int) -> dict:
    """Time one case in this process."""
    begun = time.perf_counter()
    import leastaction as la
    from leastaction import systems

    systems_ready = time.perf_counter()
    trials = max(1, round(rows / 2000))
    shape = {"trials": trials, "duration": rows / trials / 100.0, "rate": 100.0, "seed": 0}
    data = systems.generate("double_pendulum", noise=0.1, **shape)
    make = systems.large_library if library == "large" else systems.compact_library
    candidates = make("double_pendulum")
    seconds, cpu, stages = [], [], {}
    for _ in range(1 + warm):
        started, used = time.perf_counter(), time.process_time()
        model = la.discover(data, candidates)
        seconds.append(time.perf_counter() - started)
        cpu.append(time.process_time() - used)
        stages = model.diagnostics.timings
    return {
        "import_s": systems_ready - begun,
        "cold_s": seconds[0],
        "cold_cpu_s": cpu[0],  # on a busy machine the better measure; one thread, see OMP_NUM_THREADS
        "warm_s": float(np.median(seconds[1:] or seconds)),
        "peer_s": smoothing_spline(data),
        "stages_s": {k: round(v, 3) for k, v in stages.items()},
        "terms": len(model.terms),
        "candidates": len(candidates),
        "samples": data.n_samples,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "status": model.fit.status,
    }


def smoothing_spline(data) -> float:
    """Seconds that SciPy needs for a smoothing spline through every coordinate."""
    from scipy.interpolate import make_smoothing_spline

    started = time.perf_counter()
    for trajectory in data:
        for i in range(trajectory.n_dof):
            make_smoothing_spline(trajectory.t, trajectory.q[:, i], lam=1e-6)
    return time.perf_counter() - started


def command_line() -> dict:
    """Wall time and peak memory of the command line on 51 candidates, from a CSV to model and report."""
    import tempfile

    from leastaction import systems
    from leastaction.io import write_csv

    with tempfile.TemporaryDirectory() as folder:
        data, library = Path(folder) / "run.csv", Path(folder) / "library.txt"
        write_csv(data, systems.generate("double_pendulum", noise=0.1, seed=0))
        write_text(library, "\n".join(term.text for term in systems.large_library("double_pendulum").terms))
        command = [sys.executable, "-m", "leastaction", "discover", str(data)]
        command += ["--coordinates", "theta1,theta2", "--forces", "theta1_force,theta2_force"]
        command += ["--library", str(library), "--output", str(Path(folder) / "out")]
        started = time.perf_counter()
        done = subprocess.run(command, capture_output=True, text=True)
        wall = time.perf_counter() - started
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0
    return {"wall_s": wall, "peak_mb_of_all_children": peak, "exit": done.returncode}


def row(record: dict) -> str:
    config, r = record["config"], record["result"]
    return (
        f"{config['rows']:>9} rows {r['candidates']:>3} candidates: cold {r['cold_s']:.2f} s, "
        f"warm {r['warm_s']:.2f} s ({r['warm_s'] / r['peer_s']:.0f} × a smoothing spline), "
        f"{r['peak_mb']:.0f} MB, {r['terms']} terms, "
        f"{r['status']}, {r['stages_s']}"
    )


if __name__ == "__main__":
    main()
