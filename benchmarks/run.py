"""Time and peak memory of discover(): cold and warm, stage by stage, against data length and library size.

    python benchmarks/run.py                 # everything but the longest recordings
    python benchmarks/run.py --longest 1e6   # up to a million samples

Every case runs in a process of its own, so that peak memory is its own; "cold" is the first call in that
process, "warm" the median of the following ones.  The peer, for scale, is a smoothing spline of SciPy
through the same samples in the same process.

    python benchmarks/run.py workers                        # 10⁵ and 10⁶ samples, one and two workers
    python benchmarks/run.py workers --samples 1e7 --workers 1
    python -m benchmarks.run workers --pass                 # one Gauss–Newton pass alone
    python -m benchmarks.run workers --arm 20 --arm 120     # logs of a seven-joint arm at 1 kHz, in s
    python -m benchmarks.run imitation                      # share of the imitation test, warm
    python -m benchmarks.run first-minute                   # what a new user waits for

``workers`` compares one worker with more on long recordings: the driven double pendulum at 100 Hz, 20 s a
trial, with 10 % noise and the compact library, written to a file by a process of its own.  Wall time tells of
workers only on a machine that does nothing else, and two cores of a virtual machine are often less than twice
as fast as one: ``--pass`` shows the ratio of two processes that share nothing beside that of two workers.
``main_s`` is the processor time of the thread that hands out the work, which no worker can take over;
``peak_mb`` is the memory of the program itself, and each worker takes some 150 MB beside it.

``first-minute`` measures the core install in this environment (bytecode as far as it is compiled), fresh
processes of commands, and pages in Chromium with an empty cache.  "Python alone" runs the ``.pth`` files of
all packages that are installed, and is part of each command.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from importlib import metadata
from importlib.util import cache_from_source, find_spec
from itertools import chain
from pathlib import Path
from typing import Any

import click
import numpy as np

from leastaction.io import write_text

_SAMPLES = (2_000, 5_000, 10_000, 20_000, 50_000, 100_000, 200_000, 500_000, 1_000_000)


@click.group(invoke_without_command=True)
@click.option("--longest", default=1e5, show_default=True, help="Largest number of rows.")
@click.option("--warm", default=3, show_default=True, help="Warm calls a case.")
@click.option("--case", help="Run one case, given as JSON, in this process (used by the program itself).")
@click.option("--output", type=click.Path(path_type=Path), default=Path("benchmarks/results/speed.json"))
@click.pass_context
def main(context: click.Context, longest: float, warm: int, case: str | None, output: Path) -> None:
    """Print the tables and write them as JSON."""
    if context.invoked_subcommand is not None:
        return
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


# ------------------------------------------------------------- long recordings, one worker and more
_SYSTEM, _TRIAL, _RATE = "double_pendulum", 20.0, 100.0
_BATCH = 500  # trials simulated at once: the simulation must not take more memory than the search


@main.command("workers")
@click.option("--samples", multiple=True, type=float, help="Rows; may be given several times.")
@click.option("--workers", multiple=True, type=int, help="May be given several times.")
@click.option("--pass", "one_pass", is_flag=True, help="One Gauss–Newton pass alone.")
@click.option("--arm", "logs", multiple=True, type=float, help="Seconds of a log of an arm, instead.")
@click.option("--case", help="Run one case, given as JSON, in this process (used by the program itself).")
@click.option("--output", type=click.Path(path_type=Path), default=Path("benchmarks/results/long.jsonl"))
def compare_workers(
    samples: tuple[float, ...],
    workers: tuple[int, ...],
    one_pass: bool,
    logs: tuple[float, ...],
    case: str | None,
    output: Path,
) -> None:
    """Print a table; write one line of JSON a case."""
    if case is not None:
        click.echo(json.dumps(measure_long(**json.loads(case))))
        return
    if one_pass:
        from benchmarks.scaling import compare_passes

        compare_passes()
        return
    for seconds in logs:
        from benchmarks.scaling import compare_on_an_arm

        compare_on_an_arm(seconds)
    if logs:
        return
    output.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for count in samples or (1e5, 1e6):
            path = Path(folder) / f"{int(count)}.npz"
            in_another_process({"make": str(path), "samples": int(count)})
            for number in workers or (1, 2):
                record = in_another_process({"make": None, "path": str(path), "workers": number})
                record = {"samples": int(count), "workers": number, **record}
                with output.open("a") as file:
                    file.write(json.dumps(record, sort_keys=True) + "\n")
                click.echo(
                    f"{record['samples']:>9} samples  {number} workers  wall {record['wall_s']:>7.1f} s  "
                    f"processor {record['cpu_s']:>7.1f} s ({record['main_s']:.1f} s in the main thread)  "
                    f"peak {record['peak_mb']:>5} MB  {record['status']}"
                )


def in_another_process(config: dict) -> dict:
    """Run one case with one BLAS thread, so that time and memory are its own."""
    threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    command = [sys.executable, __file__, "workers", "--case", json.dumps(config)]
    done = subprocess.run(command, env={**os.environ, **threads}, capture_output=True, text=True)
    if done.returncode:
        raise click.ClickException(done.stderr.strip().splitlines()[-1])
    return json.loads(done.stdout.splitlines()[-1])


def measure_long(make: str | None, samples: int = 0, path: str = "", workers: int = 1) -> dict:
    """Simulate, or discover once."""
    import leastaction as la
    from leastaction import systems

    if make is not None:
        trials = max(1, round(samples / (_TRIAL * _RATE)))
        parts = [
            systems.generate(_SYSTEM, noise=0.1, trials=min(_BATCH, trials - a), duration=_TRIAL, seed=a)
            for a in range(0, trials, _BATCH)
        ]
        columns = {"t": [x.t for p in parts for x in p], "q": [x.q for p in parts for x in p]}
        np.savez(make, **columns, forces=[x.forces for p in parts for x in p])
        return {}
    data = recording(path, systems.get(_SYSTEM).coordinates)
    used, begun, alone = time.process_time(), time.perf_counter(), time.thread_time()
    model = la.discover(data, systems.compact_library(_SYSTEM), workers=workers)
    return {
        "wall_s": round(time.perf_counter() - begun, 2),
        "cpu_s": round(time.process_time() - used, 2),
        "main_s": round(time.thread_time() - alone, 2),
        "peak_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0),
        "status": model.fit.status,
        "terms": len(model.terms),
        "stages_s": {k: round(v, 2) for k, v in model.diagnostics.timings.items()},
    }


def recording(path: str, names: tuple[str, ...]):
    """The trials of a file; nothing else of it stays in memory."""
    import leastaction as la

    with np.load(path) as file:
        columns = zip(file["t"], file["q"], file["forces"], strict=True)
        return la.Trajectories([la.Trajectory(t, q, forces, names) for t, q, forces in columns])


# -------------------------------------------------------------------------- share of the imitation test
@main.command("imitation")
@click.option("--noise", default=0.01, show_default=True)
def share_of_imitation_test(noise: float) -> None:
    """Print the processor time of the imitation test and of the rest of a discovery, once warm."""
    import leastaction as la
    from leastaction import systems
    from leastaction.diagnosis import verdict

    spent: list[float] = []
    test = verdict._form

    def timed(*arguments: Any, **options: Any):
        begun = time.process_time()
        try:
            return test(*arguments, **options)
        finally:
            spent.append(time.process_time() - begun)

    verdict._form = timed
    for make in (systems.compact_library, systems.large_library):
        for name in systems.names():
            data = systems.generate(name, noise=noise, trials=5, duration=20.0, rate=100.0, seed=0)
            for _ in range(2):  # the first warms
                spent.clear()
                begun = time.process_time()
                status = la.discover(data, make(name), systems.get(name).known).fit.status
                total = time.process_time() - begun
            rest = total - sum(spent)
            click.echo(
                f"{name:<28} {len(make(name)):>3} candidates  fit {rest:6.2f} s  test {sum(spent):6.2f} s  "
                f"{sum(spent) / rest:5.0%}  {status}"
            )


# ------------------------------------------------------------------------- the first minute of a new user
_PROCESSES = 10  # fresh ones of each command
_VISITS = 5  # of each page, each with an empty cache
_LIMITS = {  # what the program promises; the other rows have none
    "core install, MB": 350.0,
    "core install with bytecode, MB": 350.0,
    "leastaction --help, ms": 100.0,
    "first paint of the report, s": 0.3,
    "first paint of the app, s": 1.0,
    "step along the trade-off curve, s": 0.3,
}
_IMPORT = "from time import *; a = perf_counter(); import leastaction; print(perf_counter() - a)"


@main.command("first-minute")
@click.option("--output", type=click.Path(path_type=Path), default=Path("benchmarks/results/first.json"))
def first_minute(output: Path) -> None:
    """Print medians of sizes and waiting times beside their limits, and write all of them as JSON."""
    figures: dict[str, list[float] | str] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, values in chain(installed(), commands(Path(folder)), pages(Path(folder) / "report.html")):
            figures[name] = values
            click.echo(figure_row(name, values))
    write_text(output, json.dumps({"cores": os.cpu_count(), "figures": figures}, indent=1))


def figure_row(name: str, values: list[float] | str) -> str:
    if isinstance(values, str):
        return f"{name:<36} left out: {values}"
    limit = f"  limit {_LIMITS[name]:g}" if name in _LIMITS else ""
    times = f"  {min(values):.3g} to {max(values):.3g} in {len(values)}" if len(values) > 1 else ""
    return f"{name:<36} {np.median(values):>6.3g}{limit:<12}{times}".rstrip()


def core_distributions() -> list[metadata.Distribution]:
    """leastaction and all that it needs without its extras."""
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    found: dict[str, metadata.Distribution] = {}
    waiting = ["leastaction"]
    while waiting:
        name = canonicalize_name(waiting.pop())
        if name not in found:
            found[name] = metadata.distribution(name)
            needs = map(Requirement, found[name].requires or ())
            waiting += [n.name for n in needs if n.marker is None or n.marker.evaluate({"extra": ""})]
    return list(found.values())


def installed() -> Iterator[tuple[str, list[float] | str]]:
    """Size of the core install."""
    import leastaction

    names = [name for name in _LIMITS if name.startswith("core")]
    if find_spec("packaging") is None:
        yield from ((name, "needs the package packaging") for name in names)
        return
    files = [Path(leastaction.__file__).parent.rglob("*")]  # an editable install lists but a link to it
    for it in core_distributions():
        if it.name != "leastaction":
            files.append(Path(str(it.locate_file(file))) for file in it.files or ())
    own = [path for path in chain(*files) if path.is_file() and path.suffix != ".pyc"]
    code = [Path(cache_from_source(str(path))) for path in own if path.suffix == ".py"]
    size, more = (sum(path.stat().st_size for path in paths if path.exists()) / 1e6 for paths in (own, code))
    yield from zip(names, ([size], [size + more]), strict=True)


def commands(folder: Path) -> Iterator[tuple[str, list[float] | str]]:
    """Wall times of fresh processes; the report of the demonstration is then in the folder."""

    def wall(*arguments: str) -> float:
        begun = time.perf_counter()
        subprocess.run([sys.executable, *arguments], capture_output=True, check=True, cwd=folder)
        return time.perf_counter() - begun

    for name, arguments in (
        ("Python alone, ms", "-c pass"),
        ("leastaction --help, ms", "-m leastaction --help"),
    ):
        wall(*arguments.split())  # files are in the cache of the system afterwards
        yield name, [1e3 * wall(*arguments.split()) for _ in range(_PROCESSES)]
    importing = [subprocess.check_output([sys.executable, "-c", _IMPORT]) for _ in range(_PROCESSES)]
    yield "import leastaction, ms", [1e3 * float(seconds) for seconds in importing]
    yield "leastaction demo, s", [wall("-m", "leastaction", "demo", "--output", str(folder))]
    made = "generate single_pendulum --noise 0.1 --trials 2 --duration 10 --output run.csv"
    found = "discover run.csv --coordinates theta --angles theta --forces theta_force --output found"
    wall("-m", "leastaction", *made.split())
    yield "leastaction discover, one angle, s", [wall("-m", "leastaction", *found.split()) for _ in range(3)]


def pages(report: Path) -> Iterator[tuple[str, list[float] | str]]:
    """Seconds to the first paint, and from a click to the law of a structure with fewer terms."""
    sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
    import page_helpers

    names = [name for name in _LIMITS if "paint" in name or "step" in name]
    if not (page_helpers.chromium() and find_spec("playwright") and find_spec("nicegui")):
        yield from ((name, "needs Chromium, playwright and nicegui") for name in names)
        return
    with (
        tempfile.TemporaryDirectory() as folder,
        page_helpers.running_app(Path(folder)) as address,
        page_helpers.browser() as browser,
    ):
        for name, where in zip(names, (report.as_uri(), address), strict=False):
            yield name, [page_helpers.seconds_to_paint(browser, where) for _ in range(_VISITS)]
        yield names[-1], page_helpers.steps_along_the_curve(browser, address)


if __name__ == "__main__":
    main()
